//! Quotes untrusted text safely in messages.

use std::path::Path;

use anyhow::{Error, anyhow};
pub use fmu_description::xml::quote;

/// Maximum length of a reason.
const MAX_LENGTH: usize = 1000;

/// Adds the file to an error whose reason may quote untrusted text.
pub fn about(file: &Path, error: &Error) -> Error {
    let reason = plain(&format!("{error:#}"), MAX_LENGTH);
    anyhow!("{}: {reason}", file.display())
}

/// The text on one line, without terminal control characters, and truncated to a length.
pub fn plain(text: &str, max_length: usize) -> String {
    let controls = |c: char| {
        c.is_control()
            || matches!(c, '\u{200e}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    // A character has at least one byte.
    let end = if text.len() > max_length { text.char_indices().nth(max_length) } else { None };
    let (kept, rest) = end.map_or((text, ""), |(end, _)| (&text[..end], "..."));
    // Nearly all texts are printable ASCII, which is copied much faster.
    let is_plain = kept.bytes().all(|byte| matches!(byte, b' '..=b'~'));
    let kept = if is_plain { kept.to_owned() } else { kept.replace(controls, " ") };
    kept + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_text_has_no_terminal_control_characters() {
        assert_eq!(plain("a\n\u{9b}31m\u{202e}b", 9), "a  31m b");
        assert_eq!(plain(&"ä".repeat(100_000), 200).chars().count(), 203);
    }
}
