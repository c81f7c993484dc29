//! MIME types of Binary variables, and which of them fit together.

use std::collections::BTreeMap;

/// What a Binary is of if nothing else is said: any bytes (FMI 3.0.2, `fmi3Variable.xsd`).
const ANY_BYTES: &str = "application/octet-stream";

/// A MIME type (RFC 2045, section 5.1): type and subtype in lower case, and the values of its parameters by their names
/// in lower case. Two are equal if they mean the same, however they are written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MimeType {
    kind: String,
    parameters: BTreeMap<String, String>,
}

impl MimeType {
    /// Parses a MIME type such as `application/x-frames; version="1.0"`; `None` if it is none.
    pub fn parse(text: &str) -> Option<Self> {
        let (kind, mut rest) = text.split_once(';').unwrap_or((text, ""));
        let kind = kind.trim().to_ascii_lowercase();
        let (of_type, subtype) = kind.split_once('/')?;
        let is_valid = is_token(of_type) && is_token(subtype);
        let mut parameters = BTreeMap::new();
        while !rest.trim().is_empty() {
            let (name, value);
            (name, value, rest) = parameter(rest)?;
            if parameters.insert(name, value).is_some() {
                return None;
            }
        }
        is_valid.then_some(Self { kind, parameters })
    }

    /// Whether it says nothing of the bytes.
    fn is_any(&self) -> bool {
        self.kind == ANY_BYTES && self.parameters.is_empty()
    }

    /// Whether a Binary of the type `from` may feed one of the type `to`: they mean the same, or one of them is
    /// `application/octet-stream`, which says nothing of the bytes. What is no MIME type fits the same text only.
    pub fn fits(from: &str, to: &str) -> bool {
        match [from, to].map(Self::parse) {
            [Some(from), Some(to)] => from == to || from.is_any() || to.is_any(),
            [Some(one), None] | [None, Some(one)] => one.is_any(),
            [None, None] => from.trim() == to.trim(),
        }
    }
}

/// The name and the value of the next parameter, and what follows its semicolon.
fn parameter(text: &str) -> Option<(String, String, &str)> {
    let (name, text) = text.split_once('=')?;
    let name = name.trim().to_ascii_lowercase();
    let text = text.trim_start();
    let (value, rest) = match text.strip_prefix('"') {
        Some(quoted) => unquoted(quoted)?,
        None => {
            let (token, rest) = text.split_at(text.find(';').unwrap_or(text.len()));
            let token = token.trim_end();
            (is_token(token).then(|| token.to_owned())?, rest)
        }
    };
    let rest = rest.trim_start();
    let rest = if rest.is_empty() { rest } else { rest.strip_prefix(';')? };
    is_token(&name).then_some((name, value, rest))
}

/// Whether a text is a token, as names and values of parameters are unless they are quoted.
fn is_token(text: &str) -> bool {
    let is_part = |c: char| c.is_ascii_graphic() && !"()<>@,;:\\\"/[]?=".contains(c);
    !text.is_empty() && text.chars().all(is_part)
}

/// A quoted value, of which the first quote is gone, and what follows its last quote.
fn unquoted(text: &str) -> Option<(String, &str)> {
    let (mut value, mut characters) = (String::new(), text.char_indices());
    while let Some((at, character)) = characters.next() {
        match character {
            '"' => return Some((value, &text[at + 1..])),
            '\\' => value.push(characters.next()?.1),
            other => value.push(other),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUS: &str = "application/org.fmi-standard.fmi-ls-bus.can; version=\"1.0.0\"";

    #[test]
    fn types_are_equal_however_they_are_written() {
        for same in [
            "APPLICATION/org.fmi-standard.FMI-LS-BUS.can;VERSION=1.0.0",
            " application/org.fmi-standard.fmi-ls-bus.can ;\tversion = \"1.0.\\0\" ; ",
        ] {
            assert!(MimeType::fits(BUS, same) && MimeType::fits(same, BUS), "{same}");
        }
        assert!(MimeType::fits("a/b; x=1; y=\"; \\\" =\"", "a/b; y=\"; \\\" =\"; x=1"));
        assert!(MimeType::fits(BUS, "application/octet-stream"));
        assert!(
            MimeType::fits("no type", "no type ") && MimeType::fits("", "Application/Octet-Stream")
        );
    }

    #[test]
    fn types_differ_in_kind_names_values_and_number_of_parameters() {
        for other in [
            "application/org.fmi-standard.fmi-ls-bus.can",
            "application/org.fmi-standard.fmi-ls-bus.can; version=\"1.0.1\"",
            "application/org.fmi-standard.fmi-ls-bus.can; revision=\"1.0.0\"",
            "application/org.fmi-standard.fmi-ls-bus.can; version=\"1.0.0\"; x=1",
            "application/org.fmi-standard.fmi-ls-bus.lin; version=\"1.0.0\"",
            "application/octet-stream; version=\"1.0.0\"",
            "",
        ] {
            assert!(!MimeType::fits(BUS, other) && !MimeType::fits(other, BUS), "{other}");
        }
        // Values keep their case.
        assert!(!MimeType::fits("a/b; x=RC", "a/b; x=rc"));
    }

    #[test]
    fn what_is_no_type_is_none() {
        for text in [
            "",
            "a",
            "a/",
            "/b",
            "a/b/c",
            "a b/c",
            "a/b; x",
            "a/b; =1",
            "a/b; x=\"1",
            "a/b; x=1; x=1",
            "a/b; x=\"1\" y=2",
            "a/b; x=",
            "a/b; x=1 2",
            "a/b; x=\"\\",
        ] {
            assert_eq!(MimeType::parse(text), None, "{text}");
        }
    }
}
