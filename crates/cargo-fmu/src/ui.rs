//! The words and the look of the command line: colours, tables, counts, notes, advice and errors.

use std::fmt;
use std::io::{self, Write};

use anstyle::{AnsiColor, Style};
use anyhow::Error;
use fmu_master::{Advice, Note, NoteOptions};
use indicatif::ProgressStyle;
use textwrap::{Options, WordSplitter};

/// Failures.
pub const ERROR: Style = AnsiColor::Red.on_default().bold();
/// Warnings.
pub const WARNING: Style = AnsiColor::Yellow.on_default().bold();
/// Success.
pub const OK: Style = AnsiColor::Green.on_default().bold();

/// Lines that are longer are hard to read (columns).
const WIDEST: usize = 100;

/// Prints a line for people to the standard error output, which may be closed.
pub fn message(line: fmt::Arguments<'_>) {
    let width = terminal_size::terminal_size_of(io::stderr()).map(|(width, _)| width.0.into());
    let width = width.map(|width: usize| width.min(WIDEST));
    let _ = writeln!(anstream::stderr(), "{}", filled(&line.to_string(), width, "  "));
}

/// The width of the terminal, if the standard output is one.
pub fn width() -> Option<usize> {
    terminal_size::terminal_size_of(io::stdout()).map(|(width, _)| width.0.into())
}

/// A line for the standard output, wrapped at words if that is a terminal.
pub fn wrapped(line: &str) -> String {
    filled(line, width().map(|width| width.min(WIDEST)), "  ")
}

/// A text that is wrapped at words to a width, with an indent of all lines but the first. Texts of several lines have
/// a layout of their own.
pub fn filled(text: &str, width: Option<usize>, indent: &str) -> String {
    match width {
        Some(width) if !text.trim_end().contains('\n') => {
            let options = Options::new(width.max(40)).subsequent_indent(indent);
            // What can be copied, such as a path or an option, stays whole.
            let options = options.break_words(false).word_splitter(WordSplitter::NoHyphenation);
            textwrap::fill(text, options)
        }
        _ => text.to_owned(),
    }
}

/// The style of a progress bar, which leaves the place for its message.
///
/// # Errors
/// Its template is invalid.
pub fn bar() -> Result<ProgressStyle, Error> {
    Ok(ProgressStyle::with_template("[{wide_bar}] {msg}")?.progress_chars("=> "))
}

/// Prints a warning.
pub fn warn(text: &str) {
    message(format_args!("{WARNING}warning:{WARNING:#} {text}"));
}

/// Prints an error with its advice.
pub fn error(error: &Error) {
    let advice = Advice::in_error(error).map(advice).unwrap_or_default();
    let text = format!("{error:#}{advice}");
    // Messages of the TOML parser already end with a line feed.
    message(format_args!("{ERROR}error:{ERROR:#} {}", text.trim_end()));
}

/// A note in a line.
pub fn note(note: &Note) -> String {
    const OPTIONS: NoteOptions =
        NoteOptions { record_before: "use --sampled false", record: "--output can record" };
    let text = note.text(&OPTIONS);
    match note {
        Note::RecordedAfterStep(_) | Note::Deprecated { .. } | Note::ParametersIgnored { .. } => {
            format!("note: {text}")
        }
        _ => text,
    }
}

/// The end of an error with this advice.
pub fn advice(advice: &Advice) -> String {
    match advice {
        Advice::ListVariables(fmu) => format!("`cargo fmu info {fmu}` lists its variables"),
        Advice::Compile => {
            "--compile compiles them, and `cargo fmu build` adds the binary to the FMU".to_owned()
        }
        Advice::SolveImplicitly => {
            "; if the equations are stiff, --solver implicit needs fewer".to_owned()
        }
        Advice::Simulate => "`cargo fmu simulate`".to_owned(),
        Advice::Sweep => "`cargo fmu sweep`".to_owned(),
        Advice::AnotherTable => "another --out".to_owned(),
    }
}

/// A number of things, such as `1 row` or `2 rows`.
pub fn count(number: impl ToString, thing: &str) -> String {
    let number = number.to_string();
    let ending = if number == "1" { "" } else { "s" };
    format!("{number} {thing}{ending}")
}

/// The lines of rows, each column as wide as its widest cell; the first is left-aligned, and the others too if
/// `left`.
pub fn lines<const N: usize>(rows: &[[String; N]], left: bool) -> impl Iterator<Item = String> {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max();
    let widths: [usize; N] = std::array::from_fn(|column| width(column).unwrap_or(0));
    rows.iter().map(move |row| {
        let cells = row.iter().zip(widths).enumerate();
        let cells = cells.map(|(column, (cell, width))| {
            if left || column == 0 { format!("{cell:width$}") } else { format!("{cell:>width$}") }
        });
        Vec::from_iter(cells).join("  ").trim_end().to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_wrap_at_words_and_keep_what_can_be_copied_whole() {
        let path = "a/folder-with-a-long-name/and-another-one/file.toml";
        let text = format!("{WARNING}warning:{WARNING:#} {path} is older than its sources");
        let lines = filled(&text, Some(60), "  ");
        let visible = "warning: ".len() + path.len();
        assert_eq!(visible, 60);
        assert_eq!(
            lines,
            format!("{WARNING}warning:{WARNING:#} {path}\n  is older than its sources")
        );
        assert_eq!(filled(&text, None, "  "), text);
        let layout = "expected a number\n  |\n1 | a = b";
        assert_eq!(filled(layout, Some(40), "  "), layout);
    }
}
