//! The XML schemas of FMI 2.0.5 and FMI 3.0.2, and the validation of a document against them.
//!
//! The schemas are in a compact notation. A line defines the type of an element; its continuation is
//! indented:
//!
//! ```text
//! Type attribute attribute!=form @shared > Element? Element:Type* (One | Another)+
//! ```
//!
//! An attribute with `!` is required, and has the form of the name that follows `=`, one of several words
//! (`a|b`), or items of a form (`[form]`); by default it is any text. `...` allows further attributes. After
//! `>` are the elements in their order, each of the type of its own name by default, and how many there may
//! be: one by default, `?` at most one, `*` any number, `+` at least one, `{2}` one or two. Instead, it may
//! hold `one` element of any kind, `mixed` elements and text, or `everything`, which also means any
//! attributes. A line that starts with `@` defines shared attributes. The first line is the root.

use std::collections::HashMap;
use std::sync::LazyLock;

use fmu_description::value::{boolean, bytes, items, real};
use fmu_description::xml::Element;
use fmu_file::text::quote;
use regex_lite::Regex;

use crate::finding::{Findings, Location, find, require};
use crate::rule::rule;

macro_rules! schemas {
    ($($name:ident = $file:literal;)*) => {
        $(
            #[doc = concat!("The schema in `", $file, "`.")]
            pub static $name: LazyLock<Schema> = LazyLock::new(|| Schema::new(include_str!(concat!("schema/", $file))));
        )*
    };
}
schemas! {
    MODEL_2 = "modelDescription2.txt";
    MODEL_3 = "modelDescription3.txt";
    TERMINALS = "terminalsAndIcons.txt";
    BUILD = "buildDescription.txt";
    LAYERED = "layeredStandardManifest.txt";
}

/// A document that is checked against a schema.
struct Document<'a> {
    file: &'a str,
    schema: &'a Schema,
    findings: &'a mut Findings,
}

/// Checks a file of an FMU against its schema.
pub fn check(file: &str, root: &Element<'_>, schema: &Schema, findings: &mut Findings) {
    if root.name != schema.root {
        return find!(findings, "root-element" at Location::in_file(file, root),
            "the root is {}, expected {}", quote(root.name), schema.root);
    }
    let mut document = Document { file, schema, findings };
    document.prefixes(root, &["xml", "xmlns"]);
    document.element(root, schema.root);
}

impl Document<'_> {
    /// Checks that the prefixes of names are declared, also in annotations.
    fn prefixes(&mut self, element: &Element<'_>, around: &[&str]) {
        let names = || element.attributes.iter().map(|(name, _)| *name);
        let own = names().filter_map(|name| name.strip_prefix("xmlns:"));
        let declared: Vec<_> = own.chain(around.iter().copied()).collect();
        for name in names().chain([element.name]) {
            let is_declared =
                name.split_once(':').is_none_or(|(prefix, _)| declared.contains(&prefix));
            require!(self.findings, "prefix-declared" at Location::in_file(self.file, element), is_declared,
                "the prefix of {} is not declared, expected an attribute xmlns for it", quote(name));
        }
        for child in &element.children {
            self.prefixes(child, &declared);
        }
    }

    fn element(&mut self, element: &Element<'_>, of: &str) {
        let Some(of) = self.schema.types.get(of) else { return };
        let (at, name) = (|| Location::in_file(self.file, element), element.name);
        if of.content == "everything" {
            return;
        }
        let number = element.children.len();
        require!(self.findings, "one-annotation" at at(), of.content != "one" || number <= 1,
            "{name} holds {number} elements, expected at most one");
        if let Some(line) = element.text_line.filter(|_| of.content != "mixed") {
            find!(self.findings, "no-text" at Location { line: Some(line), ..at() },
                "{name} holds text, expected elements only");
        }
        self.attributes(element, of);
        if of.content.is_empty() {
            self.children(element, &of.sequence);
        }
    }

    fn attributes(&mut self, element: &Element<'_>, of: &Type) {
        let (at, of_element) = (|| Location::in_file(self.file, element), element.name);
        for (name, form, is_required) in &of.attributes {
            match element.attribute(name) {
                None => require!(self.findings, "attribute-required" at at(), !is_required,
                    "{of_element} has no attribute {name}, expected one"),
                Some(value) => {
                    if let Some(expected) = unfit(value, form) {
                        find!(self.findings, "attribute-value" at at(),
                            "{name} is {}, expected {expected}", quote(value));
                    }
                }
            }
        }
        for (name, value) in &element.attributes {
            // Prefixes and schema locations may appear in any element; a namespace without prefix would change it.
            let mut special = ["xmlns:", "xml:", "xsi:"].iter();
            let is_special = *name == "xmlns" && value.is_empty()
                || special.any(|prefix| name.starts_with(prefix));
            let is_known = of.attributes.iter().any(|(known, ..)| known == name);
            if is_special || is_known || of.has_more && name.contains(':') {
                continue;
            }
            let rule =
                if of.has_more { rule!("interface-attribute") } else { rule!("attribute-known") };
            let (name, version) = (quote(name), self.findings.version().as_str());
            let text = format!(
                "{of_element} has the attribute {name}, which FMI {version} does not define"
            );
            self.findings.add(rule, at(), text);
        }
    }

    /// Checks that the elements of a sequence are known and in the order of the parts.
    fn children(&mut self, parent: &Element<'_>, parts: &[Part]) {
        let parent_name = parent.name;
        let mut counts = vec![0_usize; parts.len()];
        let mut reached = 0;
        for child in &parent.children {
            let (at, name) = (Location::in_file(self.file, child), child.name);
            let found = parts.iter().enumerate().find_map(|(index, part)| {
                let (_, of) = part.choice.iter().find(|(choice, _)| *choice == name)?;
                Some((index, *of))
            });
            let Some((index, of)) = found else {
                find!(self.findings, "element-known" at at,
                    "{parent_name} holds {}, expected {}", quote(name), names(parts));
                continue;
            };
            require!(self.findings, "element-order" at at.clone(), index >= reached,
                "{name} comes after {}, expected it before", parts[reached].choice[0].0);
            reached = reached.max(index);
            counts[index] += 1;
            let at_most = parts[index].at_most;
            require!(self.findings, "element-once" at at, counts[index].checked_sub(1) != Some(at_most),
                "{parent_name} holds too many {name}, expected {at_most} at most");
            self.element(child, of);
        }
        for (part, count) in parts.iter().zip(counts) {
            require!(self.findings, "element-required" at Location::in_file(self.file, parent),
                count >= part.at_least,
                "{parent_name} holds no {}, expected one", names(std::slice::from_ref(part)));
        }
    }
}

fn names(parts: &[Part]) -> String {
    let choices = parts.iter().flat_map(|part| &part.choice);
    match &*choices.map(|(name, _)| *name).collect::<Vec<_>>() {
        [] => "nothing".into(),
        names => names.join(" or "),
    }
}

/// An XML schema.
pub struct Schema {
    /// Name of the root element.
    root: &'static str,
    types: HashMap<&'static str, Type>,
}

/// The attributes and children that an element may have.
#[derive(Default)]
struct Type {
    /// The name of each attribute, its form, and whether it is required.
    attributes: Vec<(&'static str, &'static str, bool)>,
    /// Whether it may have further attributes.
    has_more: bool,
    /// The content instead of a sequence: `one`, `mixed` or `everything`.
    content: &'static str,
    sequence: Vec<Part>,
}

/// A part of a sequence: the elements allowed there with the names of their types, and how many.
struct Part {
    choice: Vec<(&'static str, &'static str)>,
    at_least: usize,
    at_most: usize,
}

impl Schema {
    /// Reads a schema in the notation of this module.
    fn new(text: &'static str) -> Self {
        let mut definitions: Vec<Vec<&str>> = Vec::new();
        for line in text.lines() {
            match definitions.last_mut() {
                Some(last) if line.starts_with(' ') => last.extend(line.split_whitespace()),
                _ => definitions.push(line.split_whitespace().collect()),
            }
        }
        definitions.retain(|words| !words.is_empty());
        let all = definitions.iter().map(|words| (words[0], &words[1..]));
        let all: HashMap<_, _> = all.collect();
        let types = all.iter().map(|(name, words)| (*name, Type::new(words, &all)));
        Self { root: definitions.first().map_or("", |words| words[0]), types: types.collect() }
    }
}

impl Type {
    fn new(words: &[&'static str], all: &HashMap<&str, &[&'static str]>) -> Self {
        let mut found = Self::default();
        let mut parts = words.splitn(2, |word| *word == ">");
        for word in parts.next().unwrap_or_default() {
            match all.get(word).filter(|_| word.starts_with('@')) {
                Some(words) => {
                    let more = Self::new(words, all);
                    found.attributes.extend(more.attributes);
                    found.has_more |= more.has_more;
                }
                None if *word == "..." => found.has_more = true,
                None => {
                    let (name, form) = word.split_once('=').unwrap_or((word, "string"));
                    let required = name.strip_suffix('!');
                    let attribute = (required.unwrap_or(name), form, required.is_some());
                    found.attributes.push(attribute);
                }
            }
        }
        match parts.next().unwrap_or_default() {
            [content @ ("one" | "mixed" | "everything")] => found.content = content,
            words => found.sequence = sequence(words),
        }
        found
    }
}

fn sequence(words: &[&'static str]) -> Vec<Part> {
    let (mut parts, mut choice, mut is_open) = (Vec::new(), Vec::new(), false);
    for word in words.iter().filter(|word| **word != "|") {
        is_open |= word.starts_with('(');
        is_open &= !word.contains(')');
        let name = word.trim_end_matches("{2}");
        let name = name.trim_matches(['(', ')', '?', '*', '+']);
        choice.push(name.split_once(':').unwrap_or((name, name)));
        if !is_open {
            let (at_least, at_most) = match word.as_bytes().last() {
                Some(b'?') => (0, 1),
                Some(b'*') => (0, usize::MAX),
                Some(b'+') => (1, usize::MAX),
                Some(b'}') => (1, 2),
                _ => (1, 1),
            };
            let choice = std::mem::take(&mut choice);
            parts.push(Part { choice, at_least, at_most });
        }
    }
    parts
}

/// The expectation, if a text does not have the form of this name.
fn unfit(text: &str, form: &str) -> Option<String> {
    let list = form.strip_prefix('[').and_then(|form| form.strip_suffix(']'));
    if let Some(form) = list {
        let each = items(text).find_map(|item| unfit(item, form))?;
        return Some(format!("items separated by spaces, each {each}"));
    }
    let (min, max) = match form {
        "byte" => (i8::MIN.into(), i8::MAX.into()),
        "unsignedByte" => (0, u8::MAX.into()),
        "short" => (i16::MIN.into(), i16::MAX.into()),
        "unsignedShort" => (0, u16::MAX.into()),
        "int" => (i32::MIN.into(), i32::MAX.into()),
        "unsignedInt" => (0, u32::MAX.into()),
        "long" => (i64::MIN.into(), i64::MAX.into()),
        "unsignedLong" => (0, u64::MAX.into()),
        "nonNegativeInteger" => (0, i128::MAX),
        _ => (0, 0),
    };
    let trimmed = text.trim_matches([' ', '\t', '\r', '\n']);
    let (fits, expected) = match form {
        "string" => (true, ""),
        "double" => (real(text).is_some(), "a number"),
        "boolean" => (boolean(text).is_some(), "true, false, 1 or 0"),
        "dateTime" => (DATE_TIME.is_match(trimmed), "a date and time such as 2026-01-31T12:00:00Z"),
        "hexBinary" => (bytes(text).is_some(), "pairs of hexadecimal digits"),
        "version" => (VERSION.is_match(text), "a version such as 3.0"),
        _ if max > 0 => {
            let fits = trimmed.parse().is_ok_and(|number: i128| (min..=max).contains(&number));
            let to = match max {
                i128::MAX => String::new(),
                max => format!(" to {max}"),
            };
            return (!fits).then(|| format!("a whole number from {min}{to}"));
        }
        words => {
            let fits = words.split('|').any(|word| word == text);
            return (!fits).then(|| words.replace('|', " or "));
        }
    };
    (!fits).then(|| expected.into())
}

/// A regular expression of this program, which is valid and has to match the whole text.
pub fn anchored(pattern: &str) -> Regex {
    let regex = Regex::new(&format!("^(?:{pattern})$"));
    regex.unwrap_or_else(|error| unreachable!("{pattern}: {error}"))
}

static DATE_TIME: LazyLock<Regex> = LazyLock::new(|| {
    let date = "-?[0-9]{4,}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])";
    let time = "([01][0-9]|2[0-4]):[0-5][0-9]";
    let zone = format!("Z|[+-]{time}");
    anchored(&format!(r"{date}T{time}:[0-5][0-9](\.[0-9]+)?({zone})?"))
});
static VERSION: LazyLock<Regex> =
    LazyLock::new(|| anchored(r"3[.](0|[1-9][0-9]*)([.](0|[1-9][0-9]*))?(-.+)?"));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_form_of_their_type() {
        for (form, good, bad) in [
            ("byte", "-128", "128"),
            ("unsignedInt", " +7\n", "-1"),
            ("int", "0", "1.0"),
            ("int", "-7", ""),
            ("[short]", " 1  32767 ", "1 32768"),
            ("[short]", "", "x"),
            ("hexBinary", "", "0"),
            ("hexBinary", "0aFf", "0x"),
            ("a|b", "b", "a|b"),
            ("dateTime", " 2026-01-31T12:00:00Z", "today"),
            ("dateTime", "2026-01-31T12:00:00", "2026-01-31"),
            ("dateTime", "2026-01-31T12:00:00.25Z", "2026-01-31T12:00Z"),
            ("dateTime", "2026-01-31T12:00:00+01:00", "2026-01-31 12:00:00Z"),
            ("dateTime", "2026-01-31T12:00:00-11:30", "2026-13-01T12:00:00Z"),
        ] {
            assert_eq!(unfit(good, form), None, "{form} {good:?}");
            assert!(unfit(bad, form).is_some(), "{form} {bad:?}");
        }
        let bad = "3|2.0|3.|3.00|3.0.|3.0.0.1|3.0-|3.x| 3.0|3-1";
        assert!(bad.split('|').all(|bad| !VERSION.is_match(bad)));
        let good = "3.0|3.0.2|3.10|3.0-beta.1|3.0.1-rc-2";
        assert!(good.split('|').all(|good| VERSION.is_match(good)));
    }
}
