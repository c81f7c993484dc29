//! Text of others in messages.

use std::path::Path;

use anyhow::{Error, anyhow};

/// No reason is longer than this.
const LONGEST: usize = 1000;

/// The error with the file that it is about, which its reason may quote.
pub fn about(file: &Path, error: &Error) -> Error {
    let reason = plain(&format!("{error:#}"), LONGEST);
    anyhow!("{}: {reason}", file.display())
}

/// The text in quotes, on one line and not endless.
pub fn quote(text: &str) -> String {
    const MOST: usize = 80;
    if text.chars().nth(MOST).is_none() {
        return format!("{text:?}");
    }
    let start: String = text.chars().take(MOST).collect();
    format!("{start:?}...")
}

/// The text as it is, but on one line, not endless, and without what steers a terminal.
pub fn plain(text: &str, most: usize) -> String {
    let steers = |c: char| {
        c.is_control()
            || matches!(c, '\u{200e}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    let harmless = |c| if steers(c) { ' ' } else { c };
    let mut plain: String = text.chars().take(most).map(harmless).collect();
    if text.chars().nth(most).is_some() {
        plain.push_str("...");
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_cut_and_lines_are_not_broken() {
        assert_eq!(quote("a\n\"b"), r#""a\n\"b""#);
        assert_eq!(quote(&"ä".repeat(80)).chars().count(), 82);
        assert!(quote(&"ä".repeat(100_000)).len() < 200);
    }

    #[test]
    fn plain_text_steers_no_terminal() {
        assert_eq!(plain("a\n\u{9b}31m\u{202e}b", 9), "a  31m b");
        assert_eq!(plain(&"ä".repeat(100_000), 200).chars().count(), 203);
    }
}
