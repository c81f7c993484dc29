//! The list of rules, and its documentation.

use std::collections::HashSet;
use std::fmt::Write;

use fmu_check::rules;

#[test]
fn names_of_rules_are_unique() {
    let mut ids = HashSet::new();
    for rule in rules() {
        assert!(ids.insert(rule.id), "{}", rule.id);
        let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        assert!(rule.id.chars().all(fits), "{}", rule.id);
    }
}

/// Run with `SNAPSHOTS=overwrite` to write the page anew.
#[test]
fn every_rule_is_documented() {
    let mut page =
        "# Rules of the validator\n\nThe rules of `cargo fmu validate`, in the order in \
        which it applies them. Generated from the source code.\n\n\
        | Rule | Severity | What it requires | Source |\n|---|---|---|---|\n"
            .to_owned();
    for rule in rules() {
        let (id, severity, text, source) = (rule.id, rule.severity, rule.text, rule.source);
        writeln!(page, "| `{id}` | {severity} | {text} | {source} |").unwrap();
    }
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/rules.md");
    let documented = snapbox::Data::read_from(file.as_ref(), None);
    snapbox::assert_data_eq!(page, documented.raw());
}
