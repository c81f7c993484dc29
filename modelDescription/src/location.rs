//! The location of the resources of an FMU in FMI 2.0, a URI (FMI 2.0.5, section 2.1.5), as a path.

use std::path::PathBuf;

/// The path of a resource location. Besides `file:///path`, hosts pass `file:/path`,
/// `file://localhost/path`, `file:////path`, `file://C:/path`, and plain paths.
///
/// # Errors
/// It is not a file.
pub fn path_of(location: &str) -> Result<PathBuf, String> {
    let Some(rest) = strip_scheme(location)? else {
        return Ok(location.into());
    };
    let (rest, is_network) = match rest.strip_prefix("//") {
        None => (rest, false),
        Some(rest) if rest.starts_with('/') || has_drive(rest) => (rest, false),
        Some(rest) => match rest.strip_prefix("localhost") {
            Some(rest) if rest.starts_with('/') => (rest, false),
            _ => (rest, true),
        },
    };
    let path =
        decode(rest).ok_or_else(|| format!("the resource location \"{location}\" is not UTF-8"))?;
    if is_network {
        return match cfg!(windows) {
            true => Ok(format!("//{path}").into()),
            false => Err(format!("the resource location \"{location}\" is on another machine")),
        };
    }
    // file:///C:/path
    let drive = path.trim_start_matches('/');
    Ok(match has_drive(drive) {
        true => drive.into(),
        false => path.into(),
    })
}

/// The part after `file:`; `None` for a plain path.
fn strip_scheme(location: &str) -> Result<Option<&str>, String> {
    let Some((scheme, rest)) = location.split_once(':') else {
        return Ok(None);
    };
    let is_scheme =
        scheme.len() > 1 && scheme.chars().all(|c| c.is_ascii_alphanumeric() || c == '+');
    match is_scheme {
        false => Ok(None),
        true if scheme.eq_ignore_ascii_case("file") => Ok(Some(rest)),
        true => Err(format!("the resource location \"{location}\" is not a file: URI")),
    }
}

/// Whether a path starts with a drive letter of Windows.
fn has_drive(path: &str) -> bool {
    matches!(path.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic())
}

/// Replaces `%20` and the like.
fn decode(text: &str) -> Option<String> {
    let digit = |byte: &u8| (*byte as char).to_digit(16);
    let mut parts = text.split('%').map(str::as_bytes);
    let mut decoded = parts.next()?.to_vec();
    for part in parts {
        let (byte, rest) = match part {
            [high, low, rest @ ..] => match (digit(high), digit(low)) {
                (Some(high), Some(low)) => ((16 * high + low) as u8, rest),
                _ => (b'%', part),
            },
            _ => (b'%', part),
        };
        decoded.push(byte);
        decoded.extend_from_slice(rest);
    }
    String::from_utf8(decoded).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_forms_of_a_location_give_the_path() {
        for (location, expected) in [
            ("file:///tmp/a/resources", "/tmp/a/resources"),
            ("file:/tmp/a/resources", "/tmp/a/resources"),
            ("file://localhost/tmp/a", "/tmp/a"),
            ("FILE:///tmp/a/", "/tmp/a/"),
            ("file:////tmp/a", "//tmp/a"),
            ("file:///tmp/a%20b/%c3%BC%", "/tmp/a b/\u{fc}%"),
            ("file:///C:/a/b", "C:/a/b"),
            ("file://C:/a/b", "C:/a/b"),
            ("file:/C:/a/b", "C:/a/b"),
            ("/tmp/a b", "/tmp/a b"),
            ("C:\\a\\b", "C:\\a\\b"),
            ("relative/a:b", "relative/a:b"),
        ] {
            assert_eq!(path_of(location), Ok(expected.into()), "{location}");
        }
    }

    #[test]
    fn locations_that_are_no_files_are_errors() {
        for (location, expected) in
            [("http://host/a", "http://host/a"), ("file:///a%ff", "not UTF-8")]
        {
            let error = path_of(location).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert_eq!(path_of("file://host/a").is_err(), !cfg!(windows));
    }
}
