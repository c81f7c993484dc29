//! The findings of the checks.

use std::fmt;

use fmu_description::ScalarVariable;
use fmu_description::xml::Element;
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_file::text::{plain, quote};

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Some importers may reject the FMU.
    Warning,
    /// The FMU violates the standard.
    Error,
}

/// Where in the FMU a finding is.
#[derive(Debug, Clone)]
pub struct Location(String);

impl From<&str> for Location {
    fn from(text: &str) -> Self {
        // The text may quote the FMU.
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

/// One problem of an FMU.
#[derive(Debug)]
pub struct Finding {
    /// Its severity.
    pub severity: Severity,
    /// Where in the FMU it is.
    pub location: Location,
    /// What was found and what was expected.
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

/// The findings on one FMU. All are counted, but only the first ones are kept.
#[derive(Debug, Default)]
pub struct Findings {
    kept: Vec<Finding>,
    errors: usize,
    warnings: usize,
}

impl Findings {
    /// Maximum number shown: a broken exporter may break thousands of variables alike.
    const MAX_KEPT: usize = 200;
    /// Maximum length of a location or text.
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
                // The text may quote the FMU.
                text: plain(text.as_ref(), Self::MAX_LENGTH),
            });
        }
    }

    /// The findings that were kept.
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

    /// Number of findings that were not kept.
    pub fn left_out(&self) -> usize {
        self.errors + self.warnings - self.kept.len()
    }
}
