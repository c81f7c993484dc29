//! What the checks have found.

use std::fmt;

use fmu_description::ScalarVariable;
use fmu_description::xml::Element;
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_file::text::{plain, quote};

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Some importers may reject it.
    Warning,
    /// It breaks the standard.
    Error,
}

/// Where in the FMU a finding is.
#[derive(Debug, Clone)]
pub struct Location(String);

impl From<&str> for Location {
    fn from(text: &str) -> Self {
        // It may quote the FMU.
        Self(plain(text, Findings::MAX_LENGTH))
    }
}

impl From<String> for Location {
    fn from(text: String) -> Self {
        Self::from(text.as_str())
    }
}

impl From<&Element<'_>> for Location {
    fn from(element: &Element<'_>) -> Self {
        Self(format!("{MODEL_DESCRIPTION}:{}", element.line))
    }
}

impl From<&ScalarVariable<'_>> for Location {
    fn from(variable: &ScalarVariable<'_>) -> Self {
        let Self(line) = variable.element.into();
        Self(format!("{line}: {}", quote(variable.name)))
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// One thing that is wrong.
#[derive(Debug)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// Where in the FMU it is.
    pub location: Location,
    /// What is there, and what was expected.
    pub text: String,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Warning => "warning",
            Self::Error => "error",
        })
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.severity, self.location, self.text)
    }
}

/// All findings on one FMU. The first of them are kept, all are counted.
#[derive(Debug, Default)]
pub struct Findings {
    kept: Vec<Finding>,
    errors: usize,
    warnings: usize,
}

impl Findings {
    /// No more than this are shown: a broken tool breaks each of a thousand variables.
    const MAX_KEPT: usize = 200;
    /// No location and no text is longer than this.
    const MAX_LENGTH: usize = 1000;

    /// Adds an error.
    pub fn error(&mut self, location: impl Into<Location>, text: impl AsRef<str>) {
        self.errors += 1;
        self.keep(Severity::Error, location, text);
    }

    /// Adds a warning.
    pub fn warning(&mut self, location: impl Into<Location>, text: impl AsRef<str>) {
        self.warnings += 1;
        self.keep(Severity::Warning, location, text);
    }

    fn keep(&mut self, severity: Severity, location: impl Into<Location>, text: impl AsRef<str>) {
        if self.kept.len() < Self::MAX_KEPT {
            self.kept.push(Finding {
                severity,
                location: location.into(),
                // It may quote the FMU.
                text: plain(text.as_ref(), Self::MAX_LENGTH),
            });
        }
    }

    /// The findings that are kept.
    pub fn kept(&self) -> &[Finding] {
        &self.kept
    }

    /// Number of errors.
    pub fn errors(&self) -> usize {
        self.errors
    }

    /// Number of warnings.
    pub fn warnings(&self) -> usize {
        self.warnings
    }

    /// Number of findings that are not kept.
    pub fn left_out(&self) -> usize {
        self.errors + self.warnings - self.kept.len()
    }
}
