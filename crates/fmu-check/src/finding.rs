//! The findings of the checks, grouped by rule.

use std::fmt;

use fmu_description::xml::Element;
use fmu_description::{FmiVersion, XmlVariable};
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_file::text::{plain, quote};
use serde::Serialize;

use crate::rule::{Rule, Severity};

/// Where in the FMU a finding is.
#[derive(Debug, Clone, Serialize)]
pub struct Location {
    /// The file or folder in the FMU; `archive` for the FMU as a whole.
    pub file: String,
    /// The line in the model description.
    pub line: Option<u32>,
    /// The variable.
    pub variable: Option<String>,
}

impl From<&str> for Location {
    fn from(file: &str) -> Self {
        Self {
            // The name may quote the FMU.
            file: plain(file, Findings::MAX_LENGTH),
            line: None,
            variable: None,
        }
    }
}

impl From<String> for Location {
    fn from(file: String) -> Self {
        Self::from(file.as_str())
    }
}

impl Location {
    /// The line of a variable, and its name.
    pub fn of_variable(element: &Element<'_>) -> Self {
        let name = element.attribute("name");
        Self { variable: name.map(|name| plain(name, Findings::MAX_LENGTH)), ..element.into() }
    }

    /// The line of an element in a file.
    pub fn in_file(file: &str, element: &Element<'_>) -> Self {
        Self { line: Some(element.line), ..file.into() }
    }
}

impl From<&Element<'_>> for Location {
    fn from(element: &Element<'_>) -> Self {
        Self::in_file(MODEL_DESCRIPTION, element)
    }
}

impl From<&XmlVariable<'_>> for Location {
    fn from(variable: &XmlVariable<'_>) -> Self {
        Self::of_variable(variable.element)
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        match &self.variable {
            Some(variable) => write!(f, ": {}", quote(variable)),
            None => Ok(()),
        }
    }
}

/// One problem of an FMU.
#[derive(Debug, Serialize)]
pub struct Finding {
    /// Where in the FMU it is.
    #[serde(flatten)]
    pub location: Location,
    /// What was found and what was expected.
    pub text: String,
}

/// The findings of one rule.
#[derive(Debug)]
pub struct Group {
    /// The rule that the FMU violates.
    pub rule: &'static Rule,
    /// Where the rule is written, for the version of the FMU.
    pub source: &'static str,
    /// The first findings.
    pub kept: Vec<Finding>,
    /// Number of all findings.
    pub count: usize,
}

impl Group {
    /// Number of findings that were not kept.
    pub fn left_out(&self) -> usize {
        self.count - self.kept.len()
    }
}

/// The findings on one FMU, by rule. All are counted, but only the first ones of each rule are kept: a
/// broken exporter may break thousands of variables alike, which must not hide other findings.
#[derive(Debug)]
pub struct Findings {
    groups: Vec<Group>,
    hints: Vec<String>,
    /// Maximum number kept of each rule.
    keep: usize,
    version: FmiVersion,
}

impl Default for Findings {
    fn default() -> Self {
        Self::keeping(Self::FEW)
    }
}

impl Findings {
    /// Number of findings of each rule that are kept by default.
    pub const FEW: usize = 3;
    /// Number that are kept in total if all are to be shown, to limit the memory.
    pub const ALL: usize = 200_000;
    /// Maximum length of a location or text.
    const MAX_LENGTH: usize = 1000;

    /// Keeps the first `keep` findings of each rule.
    pub fn keeping(keep: usize) -> Self {
        Self { groups: Vec::new(), hints: Vec::new(), keep, version: FmiVersion::Fmi2 }
    }

    /// The version of FMI whose rules apply.
    pub fn version(&self) -> FmiVersion {
        self.version
    }

    /// Says which version's rules apply from now on.
    pub(crate) fn set_version(&mut self, version: FmiVersion) {
        self.version = version;
    }

    /// Adds a finding of a rule.
    pub fn add(
        &mut self,
        rule: &'static Rule,
        location: impl Into<Location>,
        text: impl AsRef<str>,
    ) {
        let all_kept: usize = self.groups.iter().map(|group| group.kept.len()).sum();
        let mut groups = self.groups.iter();
        let index = groups.position(|group| group.rule.id == rule.id);
        let index = index.unwrap_or_else(|| {
            self.groups.push(Group {
                rule,
                source: rule.source_in(self.version),
                kept: Vec::new(),
                count: 0,
            });
            self.groups.len() - 1
        });
        let group = &mut self.groups[index];
        group.count += 1;
        let kept = group.kept.len();
        if kept < self.keep && (kept < Self::FEW || all_kept < Self::ALL) {
            group.kept.push(Finding {
                location: location.into(),
                // The text may quote the FMU.
                text: plain(text.as_ref(), Self::MAX_LENGTH),
            });
        }
    }

    /// The rules with findings, in the order of their first findings.
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// Adds a hint.
    pub(crate) fn add_hint(&mut self, text: &str) {
        // The text may quote the FMU.
        self.hints.push(plain(text, Self::MAX_LENGTH));
    }

    /// What is right, but may be another way than the user of some tool wants it.
    pub fn hints(&self) -> &[String] {
        &self.hints
    }

    /// Number of errors.
    pub fn errors(&self) -> usize {
        self.number_of(Severity::Error)
    }

    /// Number of warnings.
    pub fn warnings(&self) -> usize {
        self.number_of(Severity::Warning)
    }

    fn number_of(&self, severity: Severity) -> usize {
        let groups = self.groups.iter();
        let groups = groups.filter(|group| group.rule.severity == severity);
        groups.map(|group| group.count).sum()
    }
}

/// Adds a finding: `find!(findings, "rule" at place, "min is {min}, expected 0")`.
macro_rules! find {
    ($findings:expr, $rule:literal at $place:expr, $($text:tt)+) => {
        $findings.add($crate::rule::rule!($rule), $place, format!($($text)+))
    };
}
pub(crate) use find;

/// Adds a finding unless a condition holds: `require!(findings, "rule" at place, min == 0, "min is {min},
/// expected 0")`.
macro_rules! require {
    ($findings:expr, $rule:literal at $place:expr, $condition:expr, $($text:tt)+) => {
        match $condition {
            true => {}
            false => $crate::finding::find!($findings, $rule at $place, $($text)+),
        }
    };
}
pub(crate) use require;
