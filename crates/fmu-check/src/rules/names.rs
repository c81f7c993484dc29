//! Rules for variable names (FMI 2.0.5, section 2.2.9).

use std::collections::HashSet;

use fmu_file::text::quote;

use super::{Kind, Model};
use crate::finding::Findings;
use crate::rule::rules;

rules! {
    /// Names of variables.
    pub NAMES {
        UNIQUE_VARIABLE_NAMES: Error, "variable-unique", Standard("section 2.2.7", "section 2.4.7.4"),
            "The names of variables, and of their aliases in FMI 3.0, are unique.";
        VARIABLE_NAME_GIVEN: Error, "variable-named", Standard("section 2.2.7", "section 2.4.7.4"),
            "A variable has a name.";
        STRUCTURED_NAMES: Error, "structured-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Names follow the grammar of the naming convention structured, if the FMU declares it.";
        FLAT_NAMES: Error, "flat-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Names have no line breaks and tabs.";
        DERIVATIVE_NAMES: Error, "derivative-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Structured names der(...) are those of Reals, in FMI 3.0 Float32 or Float64.";
    }
}

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    let structured = model.root.attribute("variableNamingConvention") == Some("structured");
    let mut names = HashSet::new();
    for (variable, name) in model.variables().flat_map(|(_, variable)| {
        let aliases = variable.element.children("Alias");
        let aliases = aliases.filter_map(|alias| alias.attribute("name"));
        [variable.name]
            .into_iter()
            .chain(aliases)
            .map(move |name| (variable, name))
    }) {
        if !names.insert(name) {
            findings.add(
                &UNIQUE_VARIABLE_NAMES,
                variable,
                format!(
                    "two variables have the name {}, expected each once",
                    quote(name)
                ),
            );
        }
        if name.trim().is_empty() {
            findings.add(
                &VARIABLE_NAME_GIVEN,
                variable,
                "the name is empty, expected a string",
            );
        } else if structured && !is_structured(name) {
            findings.add(
                &STRUCTURED_NAMES,
                variable,
                "the name is not structured, expected a form such as a.b[1,2].c or der(a.b)",
            );
        } else if structured && name.starts_with("der(") && variable.kind != Kind::Float {
            let text = format!(
                "the name is that of a derivative, expected a {}, not {}",
                model.float(),
                variable.value.name
            );
            findings.add(&DERIVATIVE_NAMES, variable, text);
        }
        if !structured && name.contains(['\r', '\n', '\t']) {
            let text = "the name has a line break or tab, expected none";
            findings.add(&FLAT_NAMES, variable, text);
        }
    }
}

/// Whether a name has the form of the naming convention `structured`.
fn is_structured(name: &str) -> bool {
    let whole = |text: &str| identifier(text).is_some_and(str::is_empty);
    match name
        .strip_prefix("der(")
        .and_then(|rest| rest.strip_suffix(')'))
    {
        None => whole(name),
        Some(inner) => match inner.rsplit_once(',') {
            // The comma may also separate indices.
            Some((inner, order)) if is_number(order) => whole(inner),
            _ => whole(inner),
        },
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// The rest of a text after its leading identifier: names with indices, separated by dots.
fn identifier(mut text: &str) -> Option<&str> {
    loop {
        text = match text.strip_prefix('\'') {
            Some(rest) => quoted(rest)?,
            None => plain(text)?,
        };
        if let Some(rest) = text.strip_prefix('[') {
            let (indices, rest) = rest.split_once(']')?;
            if !indices.split(',').all(is_number) {
                return None;
            }
            text = rest;
        }
        match text.strip_prefix('.') {
            Some(rest) => text = rest,
            None => return Some(text),
        }
    }
}

/// The rest of a text after a name of letters, digits and underscores.
fn plain(text: &str) -> Option<&str> {
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let rest = text.trim_start_matches(is_name);
    let starts_well = text.starts_with(|c: char| is_name(c) && !c.is_ascii_digit());
    starts_well.then_some(rest)
}

/// The rest of a text after a quoted name, whose opening quote has been read.
fn quoted(text: &str) -> Option<&str> {
    let mut characters = text.char_indices();
    while let Some((at, character)) = characters.next() {
        match character {
            '\'' => return (at > 0).then(|| &text[at + 1..]),
            '\\' => {
                let (_, escaped) = characters.next()?;
                if !"'\"?\\abfnrtv".contains(escaped) {
                    return None;
                }
            }
            ' '..='~' => {}
            _ => return None,
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structured_names_have_the_form_of_the_standard() {
        for good in [
            "a",
            "_a1",
            "a.b.c",
            "rbf.w[1]",
            "a[1,2].b[3]",
            "der(a)",
            "der(a.b[1])",
            "der(a[1,2])",
            "der(a,2)",
            "'a b'.c",
            "'it\\'s'",
            "a.'[x]'[2]",
            "der('a,b')",
        ] {
            assert!(is_structured(good), "{good}");
        }
        for bad in [
            "", "1a", "a.", ".a", "a..b", "a[", "a[]", "a[x]", "a[1", "a b", "a-b", "ä", "der(",
            "der()", "der(a", "a)", "''", "'a", "'a\\x'", "a[1,]", "der(a,)", "a[1]b",
        ] {
            assert!(!is_structured(bad), "{bad}");
        }
    }
}
