//! The location of an FMU's resources: a URI for `fmi2Instantiate`, a path for `fmi3Instantiate`.

use std::path::Path;

/// The URI of a local folder.
pub fn uri(folder: &Path) -> String {
    let mut uri = String::from("file://");
    let path = folder.as_os_str().as_encoded_bytes();
    if !path.starts_with(b"/") {
        uri.push('/'); // before the drive letter of Windows
    }
    for &byte in path {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'-' | b'_' | b'.' | b'~' | b':' => {
                uri.push(char::from(byte));
            }
            b'\\' if cfg!(windows) => uri.push('/'),
            other => uri.push_str(&format!("%{other:02X}")),
        }
    }
    uri
}

/// The path of a local folder with a separator at its end (FMI 3.0.2, section 2.3.1).
pub fn resource_path(folder: &Path) -> String {
    format!("{}{}", folder.display(), std::path::MAIN_SEPARATOR)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserved_characters_are_escaped() {
        let folder = Path::new("/tmp/a b/100%#ü");
        assert_eq!(uri(folder), "file:///tmp/a%20b/100%25%23%C3%BC");
        assert_eq!(uri(Path::new("C:/fmu")), "file:///C:/fmu");
    }
}
