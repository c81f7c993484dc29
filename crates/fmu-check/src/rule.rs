//! The rules that the checks apply, from the table in `rules.md`.

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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rule {
    /// Its name in machine-readable output, such as `outputs-listed`.
    pub id: &'static str,
    /// Severity of its findings.
    pub severity: Severity,
    /// The requirement, in one sentence.
    pub text: &'static str,
    /// Where it is written: in sections of FMI 2.0.5, FMI 3.0.2 or both, separated by a semicolon; or the reason for a
    /// rule that is not in the standard, such as an importer that relies on it.
    pub source: &'static str,
}

/// All rules, by the part of the FMU that they are about: the rows of the table in `rules.md`.
#[allow(long_running_const_eval, reason = "the compiler reads the table")]
pub static RULES: [Rule; COUNT] = read();

const TABLE: &str = include_str!("../rules.md");
/// The start of a row, which is ``| `id` | severity | text | source |``.
const ROW: &str = "\n| `";
const COUNT: usize = {
    let (mut count, mut rest) = (0, split(TABLE, ROW).1);
    while !rest.is_empty() {
        (count, rest) = (count + 1, split(rest, ROW).1);
    }
    count
};

impl Rule {
    /// The source for an FMU of a version.
    pub fn source_in(&self, version: FmiVersion) -> &'static str {
        let standard = match version {
            FmiVersion::Fmi2 => "FMI 2.0.5, ",
            FmiVersion::Fmi3 => "FMI 3.0.2, ",
        };
        let mut parts = self.source.split("; ");
        parts.find(|part| part.starts_with(standard)).unwrap_or(self.source)
    }

    /// The rule of this name. An unknown name leads past the end of the table, which is a compile error.
    pub(crate) const fn named(id: &str) -> &'static Self {
        let mut i = 0;
        while RULES[i].id.len() != id.len() || !is_at(RULES[i].id, 0, id) {
            i += 1;
        }
        &RULES[i]
    }
}

/// A rule by its name: `rule!("outputs-listed")`.
macro_rules! rule {
    ($id:literal) => {
        const { $crate::rule::Rule::named($id) }
    };
}
pub(crate) use rule;

const fn read() -> [Rule; COUNT] {
    let mut rules = [Rule { id: "", severity: Severity::Error, text: "", source: "" }; COUNT];
    let (mut i, mut rest) = (0, TABLE);
    while i < COUNT {
        let (id, row) = split(split(rest, ROW).1, "` | ");
        let (severity, row) = split(row, " | ");
        let (text, row) = split(row, " | ");
        let severity = match severity.as_bytes() {
            b"error" => Severity::Error,
            b"warning" => Severity::Warning,
            _ => panic!("expected error or warning"),
        };
        rules[i] = Rule { id, severity, text, source: split(row, " |\n").0 };
        (i, rest) = (i + 1, row);
    }
    rules
}

/// The parts of a text before and after a separator; all of it, and nothing, if it has none.
const fn split(text: &'static str, separator: &str) -> (&'static str, &'static str) {
    let mut at = 0;
    while at < text.len() {
        if is_at(text, at, separator) {
            return (text.split_at(at).0, text.split_at(at + separator.len()).1);
        }
        at += 1;
    }
    (text, "")
}

/// Whether a text has a part at this place.
const fn is_at(text: &str, at: usize, part: &str) -> bool {
    let mut i = 0;
    while i < part.len() && at + i < text.len() && text.as_bytes()[at + i] == part.as_bytes()[i] {
        i += 1;
    }
    i == part.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_rules_of_different_names_with_text_and_source() {
        let (_, rows) = TABLE.split_once("|---|---|---|---|\n").unwrap();
        for (row, Rule { id, severity, text, source }) in rows.lines().zip(RULES) {
            assert_eq!(row, format!("| `{id}` | {severity} | {text} | {source} |"));
            assert_eq!(RULES.iter().filter(|other| other.id == id).count(), 1, "{id}");
        }
        assert_eq!(rows.lines().count(), COUNT);
        let rule = rule!("outputs-listed");
        assert_eq!(rule.source_in(FmiVersion::Fmi2), "FMI 2.0.5, section 2.2.8");
        assert_eq!(rule.source_in(FmiVersion::Fmi3), "FMI 3.0.2, section 2.4.8");
    }
}
