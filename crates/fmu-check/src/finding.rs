//! What the checks have found.

use std::fmt;

use fmu_file::text::plain;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// An importer may stumble over it.
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
    pub place: String,
    /// What is there, and what was expected.
    pub text: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let severity = match self.severity {
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        write!(f, "{severity}: {}: {}", self.place, self.text)
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
    const MOST: usize = 200;
    /// No place and no text is longer than this.
    const LONGEST: usize = 1000;

    /// Adds an error.
    pub fn error(&mut self, place: impl Into<String>, text: impl Into<String>) {
        self.add(Finding {
            severity: Severity::Error,
            place: place.into(),
            text: text.into(),
        });
    }

    /// Adds a warning.
    pub fn warning(&mut self, place: impl Into<String>, text: impl Into<String>) {
        self.add(Finding {
            severity: Severity::Warning,
            place: place.into(),
            text: text.into(),
        });
    }

    /// Adds a finding.
    pub fn add(&mut self, finding: Finding) {
        match finding.severity {
            Severity::Warning => self.warnings += 1,
            Severity::Error => self.errors += 1,
        }
        if self.kept.len() < Self::MOST {
            // Both may quote the FMU.
            self.kept.push(Finding {
                severity: finding.severity,
                place: plain(&finding.place, Self::LONGEST),
                text: plain(&finding.text, Self::LONGEST),
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
