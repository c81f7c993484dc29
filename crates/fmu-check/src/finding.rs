//! What the checks have found.

use std::fmt;

use fmu_file::text::plain;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Some importers may reject it.
    Warning,
    /// It breaks the standard.
    Error,
}

/// One thing that is wrong.
#[derive(Debug)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// Where in the FMU it is.
    pub location: String,
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
    pub fn error(&mut self, location: impl Into<String>, text: impl Into<String>) {
        self.add(Finding {
            severity: Severity::Error,
            location: location.into(),
            text: text.into(),
        });
    }

    /// Adds a warning.
    pub fn warning(&mut self, location: impl Into<String>, text: impl Into<String>) {
        self.add(Finding {
            severity: Severity::Warning,
            location: location.into(),
            text: text.into(),
        });
    }

    /// Adds a finding.
    pub fn add(&mut self, finding: Finding) {
        match finding.severity {
            Severity::Warning => self.warnings += 1,
            Severity::Error => self.errors += 1,
        }
        if self.kept.len() < Self::MAX_KEPT {
            // Both may quote the FMU.
            self.kept.push(Finding {
                severity: finding.severity,
                location: plain(&finding.location, Self::MAX_LENGTH),
                text: plain(&finding.text, Self::MAX_LENGTH),
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
