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
    Decoded {
        text: text.into_owned(),
        faults,
    }
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

    fn document(encoding: &str) -> Vec<u8> {
        format!("<?xml version=\"1.0\" encoding='{encoding}'?>\n<a b=\"").into_bytes()
    }

    #[test]
    fn utf_8_has_no_faults() {
        for start in ["", "\u{feff}", "<?xml version='1.0' encoding='utf-8'?>"] {
            let decoded = decode(format!("{start}<a b='ü'/>").as_bytes());
            assert!(decoded.text.ends_with("<a b='ü'/>"), "{decoded:?}");
            assert_eq!(decoded.faults, [""; 0]);
        }
    }

    #[test]
    fn declared_encodings_are_decoded() {
        for (name, bytes, text) in [
            ("ISO-8859-1", b"\xfc\"/>".as_slice(), "ü\"/>"),
            ("windows-1252", b"\x80\"/>", "€\"/>"),
            ("US-ASCII", b"u\"/>", "u\"/>"),
            ("Shift_JIS", b"\x83\x65\"/>", "テ\"/>"),
            // Not the true encoding.
            ("UTF-16", "ü\"/>".as_bytes(), "ü\"/>"),
            ("no such", b"\xfc\"/>", "ü\"/>"),
        ] {
            let decoded = decode(&[&document(name), bytes].concat());
            assert!(decoded.text.ends_with(text), "{decoded:?}");
            let expected = format!("the encoding is \"{name}\", expected UTF-8");
            assert_eq!(decoded.faults, [expected]);
        }
    }

    #[test]
    fn utf_16_is_decoded() {
        let text = "<a b='ü'/>";
        for mark in ["\u{feff}", ""] {
            let units = || mark.encode_utf16().chain(text.encode_utf16());
            let little: Vec<u8> = units().flat_map(u16::to_le_bytes).collect();
            let big: Vec<u8> = units().flat_map(u16::to_be_bytes).collect();
            for bytes in [little, big] {
                let decoded = decode(&bytes);
                assert_eq!(decoded.text, text);
                assert_eq!(decoded.faults.len(), 1, "{decoded:?}");
            }
        }
    }

    #[test]
    fn bytes_that_cannot_be_decoded_are_replaced() {
        let decoded = decode(b"<a>\n<b c='\xfc'/></a>");
        assert_eq!(decoded.text, "<a>\n<b c='\u{fffd}'/></a>");
        assert_eq!(
            decoded.faults,
            ["line 2 has bytes that are not UTF-8, expected valid text"]
        );
    }
}
