//! Decodes documents. FMI demands UTF-8, but many tools write another encoding.

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};

use super::quote;

/// A decoded document.
#[derive(Debug)]
pub struct Decoded {
    /// Its text; bytes that could not be decoded are replaced by U+FFFD.
    pub text: String,
    /// How it differs from UTF-8.
    pub faults: Vec<String>,
}

/// Decodes a document by its byte order mark, or else by its XML declaration.
pub fn decode(bytes: &[u8]) -> Decoded {
    let mut faults = Vec::new();
    let (encoding, declared) = match Encoding::for_bom(bytes) {
        Some((encoding, _)) => (encoding, None),
        None => declared(bytes),
    };
    let name = declared.unwrap_or_else(|| encoding.name().to_owned());
    if encoding != UTF_8 || !name.eq_ignore_ascii_case("UTF-8") {
        faults.push(format!("the encoding is {}, expected UTF-8", quote(&name)));
    }
    let (text, encoding, has_errors) = encoding.decode(bytes);
    if has_errors {
        // As far as it is valid, the text has as many lines as its replacement.
        let end = text.find('\u{fffd}').unwrap_or(text.len());
        let line = 1 + text[..end].matches('\n').count();
        faults.push(format!(
            "line {line} has bytes that are not {}, expected valid text",
            encoding.name()
        ));
    }
    Decoded { text: text.into_owned(), faults }
}

/// The encoding without a byte order mark, and the name that the XML declaration gives it.
fn declared(bytes: &[u8]) -> (&'static Encoding, Option<String>) {
    /// An XML declaration is shorter.
    const MAX_LENGTH: usize = 256;
    if bytes.starts_with(b"<\0") {
        return (UTF_16LE, None);
    }
    if bytes.starts_with(b"\0<") {
        return (UTF_16BE, None);
    }
    let start = &bytes[..bytes.len().min(MAX_LENGTH)];
    let Some(name) = declared_name(&String::from_utf8_lossy(start)) else {
        return (UTF_8, None);
    };
    let encoding = match Encoding::for_label(name.as_bytes()) {
        // The declaration could be read as ASCII, so the document is not UTF-16.
        Some(encoding) if encoding.is_ascii_compatible() => encoding,
        _ if std::str::from_utf8(bytes).is_ok() => UTF_8,
        _ => WINDOWS_1252,
    };
    (encoding, Some(name))
}

fn declared_name(start: &str) -> Option<String> {
    let (declaration, _) = start.strip_prefix("<?xml")?.split_once("?>")?;
    let (_, rest) = declaration.split_once("encoding")?;
    let value = rest.trim_start().strip_prefix('=')?.trim_start();
    let quotation = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    let (name, _) = value[1..].split_once(quotation)?;
    Some(name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Decodes a document and checks the end of its text.
    #[track_caller]
    fn assert_decoded(document: &[u8], end: &str, faults: &[&str]) {
        let decoded = decode(document);
        assert!(decoded.text.ends_with(end), "{decoded:?}");
        assert_eq!(decoded.faults, faults, "{decoded:?}");
    }

    #[test]
    fn declared_encodings_are_decoded() {
        for (name, bytes, text, is_utf_8) in [
            ("utf-8", "ü\"/>".as_bytes(), "ü\"/>", true),
            ("ISO-8859-1", b"\xfc\"/>", "ü\"/>", false),
            ("windows-1252", b"\x80\"/>", "€\"/>", false),
            ("US-ASCII", b"u\"/>", "u\"/>", false),
            ("Shift_JIS", b"\x83\x65\"/>", "テ\"/>", false),
            // Not the true encoding.
            ("UTF-16", "ü\"/>".as_bytes(), "ü\"/>", false),
            ("no such", b"\xfc\"/>", "ü\"/>", false),
        ] {
            let start = format!("<?xml version=\"1.0\" encoding='{name}'?>\n<a b=\"");
            let fault: &[_] = &[&*format!("the encoding is \"{name}\", expected UTF-8")];
            let faults = if is_utf_8 { &[] } else { fault };
            assert_decoded(&[start.as_bytes(), bytes].concat(), text, faults);
        }
    }

    #[test]
    fn utf_8_and_utf_16_need_no_declaration() {
        let text = "<a b='ü'/>";
        for mark in ["\u{feff}", ""] {
            assert_decoded(format!("{mark}{text}").as_bytes(), text, &[]);
            let units = || mark.encode_utf16().chain(text.encode_utf16());
            let little: Vec<u8> = units().flat_map(u16::to_le_bytes).collect();
            let big: Vec<u8> = units().flat_map(u16::to_be_bytes).collect();
            let fault = |name| format!("the encoding is \"UTF-16{name}\", expected UTF-8");
            assert_decoded(&little, text, &[&fault("LE")]);
            assert_decoded(&big, text, &[&fault("BE")]);
        }
    }

    #[test]
    fn bytes_that_cannot_be_decoded_are_replaced() {
        let fault = "line 2 has bytes that are not UTF-8, expected valid text";
        let replaced = "<a>\n<b c='\u{fffd}'/></a>";
        assert_decoded(b"<a>\n<b c='\xfc'/></a>", replaced, &[fault]);
    }
}
