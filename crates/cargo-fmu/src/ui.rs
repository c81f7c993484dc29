//! The words and the look of the command line: colours, tables, counts, notes, advice and errors.

use std::fmt;
use std::io::Write;

use anstyle::{AnsiColor, Style};
use anyhow::Error;
use fmu_master::{Advice, Note, NoteOptions};

/// Failures.
pub const ERROR: Style = AnsiColor::Red.on_default().bold();
/// Warnings.
pub const WARNING: Style = AnsiColor::Yellow.on_default().bold();
/// Success.
pub const OK: Style = AnsiColor::Green.on_default().bold();

/// Prints a line for people to the standard error output, which may be closed.
pub fn message(line: fmt::Arguments<'_>) {
    let _ = writeln!(anstream::stderr(), "{line}");
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
        Note::RecordedAfterStep(_) | Note::Deprecated { .. } => format!("note: {text}"),
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
