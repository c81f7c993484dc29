//! The rules that the checks apply: a name for machines, a severity, and the source of each.

use std::fmt;

use fmu_description::FmiVersion;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Some importers may reject the FMU.
    Warning,
    /// The FMU violates the standard.
    Error,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Warning => "warning",
            Self::Error => "error",
        })
    }
}

/// A rule for FMUs.
#[derive(Debug, PartialEq, Eq)]
pub struct Rule {
    /// Its name in machine-readable output, such as `outputs-listed`.
    pub id: &'static str,
    /// Severity of its findings.
    pub severity: Severity,
    /// What it requires, in one sentence.
    pub text: &'static str,
    /// Where it is written.
    pub source: Source,
}

/// Where a rule is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// In sections of FMI 2.0.5 and FMI 3.0.2.
    Standard(&'static str, &'static str),
    /// In a section of FMI 2.0.5; the rule is not for FMI 3.0.
    Fmi2(&'static str),
    /// In a section of FMI 3.0.2; the rule is not for FMI 2.0.
    Fmi3(&'static str),
    /// Not in the standard: the reason for the rule, such as an importer that relies on it.
    Practice(&'static str),
}

impl Source {
    /// The source for an FMU of this version.
    pub fn of(self, version: FmiVersion) -> Self {
        match (self, version) {
            (Self::Standard(section, _), FmiVersion::Fmi2) => Self::Fmi2(section),
            (Self::Standard(_, section), FmiVersion::Fmi3) => Self::Fmi3(section),
            (source, _) => source,
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Standard(in_2, in_3) => write!(f, "{}; {}", Self::Fmi2(in_2), Self::Fmi3(in_3)),
            Self::Fmi2(section) => write!(f, "FMI 2.0.5, {section}"),
            Self::Fmi3(section) => write!(f, "FMI 3.0.2, {section}"),
            Self::Practice(reason) => write!(f, "not in the standard, but {reason}"),
        }
    }
}

/// Defines rules, and a list of them:
///
/// ```ignore
/// rules! {
///     /// Rules for names.
///     pub NAMES {
///         UNIQUE_NAMES: Error, "unique-names", Standard("section 2.2.7", "section 2.4.7.4"), "Each variable has a name of its own.";
///     }
/// }
/// ```
macro_rules! rules {
    ($($(#[$about:meta])* $visibility:vis $group:ident {
        $($name:ident: $severity:ident, $id:literal, $source:ident($($where:literal),+), $text:literal;)*
    })*) => {
        $(
            $(
                #[doc = $text]
                $visibility const $name: $crate::rule::Rule = $crate::rule::Rule {
                    id: $id,
                    severity: $crate::rule::Severity::$severity,
                    text: $text,
                    source: $crate::rule::Source::$source($($where),+),
                };
            )*

            $(#[$about])*
            $visibility const $group: &[$crate::rule::Rule] = &[$($name),*];
        )*
    };
}
pub(crate) use rules;
