//! The error of this crate.

use std::fmt;
use std::path::Path;

/// A message that names the file or variable, what was found and what was expected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Error(String);

impl Error {
    pub(crate) fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }

    /// For `map_err`: an action that failed on a file, and the cause.
    pub(crate) fn file<E: fmt::Display>(action: &str, file: &Path) -> impl FnOnce(E) -> Self {
        move |cause| Self(format!("cannot {action} {}: {cause}", file.display()))
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}
