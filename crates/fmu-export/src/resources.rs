//! The folder of the resources: in FMI 2.0, from a URI (FMI 2.0.5, section 2.1.5). A WebAssembly component has none: its
//! host reads them, as for C sources.

use std::ffi::{CStr, CString};

#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
use std::mem::MaybeUninit;
#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
use std::path::Path;
use std::path::PathBuf;

use fmi_abi::FmiVersion;
use fmu_description::location::path_of;

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
    fn a_location_is_a_path_or_an_error() {
        for (location, expected) in [
            (None, "no resource location"),
            (Some(""), "no resource location"),
            (Some("http://host/a"), "http://host/a"),
        ] {
            let error = path(location).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert_eq!(path(Some("file:///tmp/a%20b")), Ok("/tmp/a b".into()));
    }
}
