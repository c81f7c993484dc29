//! The folder of the resources: in FMI 2.0, from a URI (FMI 2.0.5, section 2.1.5). A WebAssembly component has none: its
//! host reads them, as for C sources.

use std::ffi::{CStr, CString};

#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
use std::mem::MaybeUninit;
#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
use std::path::Path;
use std::path::PathBuf;

use fmi_abi::FmiVersion;

#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
use crate::canonical::{Answer, Text, slice};
use crate::pointers::readable;

#[cfg(all(target_arch = "wasm32", feature = "sources"))]
pub(crate) use crate::source_host::read_resource;

/// The folder of the resources.
#[derive(Debug, Clone)]
pub(crate) enum Folder {
    /// As a host of this version of FMI names it.
    Named(FmiVersion, Option<CString>),
    /// Its path, or why it is not known.
    Known(Result<PathBuf, String>),
}

impl Folder {
    pub(crate) fn named(version: FmiVersion, text: Option<&CStr>) -> Self {
        Self::Named(version, text.map(CStr::to_owned))
    }

    /// Its path. A model that needs no resources has no code for this.
    ///
    /// # Errors
    /// It is not known, or it is no folder of this machine.
    pub(crate) fn path(&self) -> Result<PathBuf, String> {
        let (version, text) = match self {
            Self::Named(version, text) => (version, text.as_ref().filter(|text| !text.is_empty())),
            Self::Known(path) => return path.clone(),
        };
        let what = match version {
            FmiVersion::Fmi2 => "location",
            FmiVersion::Fmi3 => "path",
        };
        let text = text.ok_or_else(|| format!("the host passed no resource {what}"))?;
        let text = text.to_str().map_err(|_| {
            format!("the resource {what} \"{}\" is not UTF-8", readable(text.to_bytes()))
        })?;
        match version {
            FmiVersion::Fmi2 => path_of(text),
            FmiVersion::Fmi3 => Ok(text.into()),
        }
    }
}

/// The path of a resource location. Besides `file:///path`, hosts pass `file:/path`,
/// `file://localhost/path`, `file:////path`, `file://C:/path`, and plain paths.
///
/// # Errors
/// It is not a file.
fn path_of(location: &str) -> Result<PathBuf, String> {
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

#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
#[link(wasm_import_module = "fmi:fmi3/resource-dir-callbacks@3.0.0")]
unsafe extern "C" {
    #[link_name = "read-file"]
    fn read_file(path: *const u8, length: usize, content: *mut MaybeUninit<Answer<Text, Text>>);
}

/// Reads a resource by the host, which has the files.
#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
pub(crate) fn read_resource(path: &Path) -> Result<String, String> {
    let path = path.to_str().ok_or("its name is not UTF-8")?;
    let mut content = MaybeUninit::uninit();
    // SAFETY: the host provides this function with these arguments, and writes the answer, whose list is valid
    // until the end of the call.
    unsafe {
        read_file(path.as_ptr(), path.len(), &mut content);
        let bytes = |text: &Text| slice(text.first, text.length).to_vec();
        match content.assume_init_ref() {
            Answer::Ok(text) => String::from_utf8(bytes(text)).map_err(|error| error.to_string()),
            Answer::Err(text) => Err(String::from_utf8_lossy(&bytes(text)).into_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(location: Option<&str>) -> Result<PathBuf, String> {
        let location = location.map(|location| CString::new(location).unwrap());
        Folder::Named(FmiVersion::Fmi2, location).path()
    }

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
            assert_eq!(path(Some(location)), Ok(expected.into()), "{location}");
        }
    }

    #[test]
    fn other_locations_are_errors() {
        for (location, expected) in [
            (None, "no resource location"),
            (Some(""), "no resource location"),
            (Some("http://host/a"), "http://host/a"),
            (Some("file:///a%ff"), "not UTF-8"),
        ] {
            let error = path(location).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert_eq!(path(Some("file://host/a")).is_err(), !cfg!(windows));
    }
}
