//! The XML schemas of FMI 2.0.5 and FMI 3.0.2 as tables, and the validation of a document against them.

pub mod build;
mod fmi2;
mod fmi3;
mod form;
pub mod terminals;

use fmu_description::FmiVersion;
use fmu_description::xml::Element;
use fmu_file::text::quote;

use super::finding::{Findings, Location};
use super::rule::{Rule, rules};
use form::Form;

rules! {
    /// What the XML schema requires.
    pub SCHEMA {
        ROOT_ELEMENT: Error, "root-element", Standard("section 2.2.1", "section 2.4.1"),
            "The root element of a file is the one of its schema.";
        NO_TEXT: Error, "no-text", Standard("section 2.2", "section 2.4"),
            "Elements hold other elements, but no text.";
        ATTRIBUTE_REQUIRED: Error, "attribute-required", Standard("section 2.2", "section 2.4"),
            "Required attributes are given.";
        ATTRIBUTE_VALUE: Error, "attribute-value", Standard("section 2.2", "section 2.4"),
            "The value of an attribute has the form that the schema requires.";
        ATTRIBUTE_KNOWN: Error, "attribute-known", Standard("section 2.2", "section 2.4"),
            "An element has no attributes but those of the schema.";
        ELEMENT_KNOWN: Error, "element-known", Standard("section 2.2", "section 2.4"),
            "An element holds no elements but those of the schema.";
        ELEMENT_ORDER: Error, "element-order", Standard("section 2.2", "section 2.4"),
            "Elements are in the order of the schema.";
        ELEMENT_ONCE: Error, "element-once", Standard("section 2.2", "section 2.4"),
            "An element appears at most as often as the schema allows.";
        ELEMENT_REQUIRED: Error, "element-required", Standard("section 2.2", "section 2.4"),
            "Required elements are given.";
        ONE_ANNOTATION: Warning, "one-annotation", Fmi2("section 2.2.6"),
            "The annotation of a tool is one element.";
        INTERFACE_ATTRIBUTE: Warning, "interface-attribute",
            Practice("the schema allows them for layered standards only, which use namespaces"),
            "An interface type has no attributes without namespace but those of FMI.";
    }
}

/// An attribute of an element: name, form, whether it is required.
type Attribute = (&'static str, Form, bool);

const REQUIRED: bool = true;
const OPTIONAL: bool = false;

/// The attributes and children that an element may have.
struct Type {
    /// Attributes that it shares with other types.
    shared: &'static [&'static [Attribute]],
    attributes: &'static [Attribute],
    /// Whether it may have further attributes.
    has_more: bool,
    content: Content,
}

enum Content {
    /// Elements in this order.
    Sequence(&'static [Part]),
    /// At most one element, of any kind.
    Anything,
    /// Any children and text.
    Mixed,
    /// Any children and attributes.
    Open,
}

/// A part of a sequence: the elements allowed there, and how many.
struct Part {
    choice: &'static [(&'static str, &'static Type)],
    at_least: usize,
    at_most: usize,
}

const fn one(choice: &'static [(&'static str, &'static Type)]) -> Part {
    part(choice, 1, 1)
}

const fn optional(choice: &'static [(&'static str, &'static Type)]) -> Part {
    part(choice, 0, 1)
}

const fn some(choice: &'static [(&'static str, &'static Type)]) -> Part {
    part(choice, 1, usize::MAX)
}

const fn part(
    choice: &'static [(&'static str, &'static Type)],
    at_least: usize,
    at_most: usize,
) -> Part {
    Part {
        choice,
        at_least,
        at_most,
    }
}

const fn leaf(attributes: &'static [Attribute]) -> Type {
    sequence(attributes, &[])
}

const fn list(content: &'static [Part]) -> Type {
    sequence(&[], content)
}

const fn sequence(attributes: &'static [Attribute], content: &'static [Part]) -> Type {
    extending(&[], attributes, content)
}

/// A sequence with further attributes, which other types have, too.
const fn extending(
    shared: &'static [&'static [Attribute]],
    attributes: &'static [Attribute],
    content: &'static [Part],
) -> Type {
    Type {
        shared,
        attributes,
        has_more: false,
        content: Content::Sequence(content),
    }
}

/// An XML schema.
pub struct Schema {
    /// Name of the root element.
    root: &'static str,
    of: &'static Type,
}

impl Schema {
    /// The schema of `modelDescription.xml`.
    pub fn of_model(version: FmiVersion) -> Self {
        Self {
            root: "fmiModelDescription",
            of: match version {
                FmiVersion::Fmi2 => &fmi2::ROOT,
                FmiVersion::Fmi3 => &fmi3::ROOT,
            },
        }
    }
}

/// A document that is checked against a schema.
struct Document<'a> {
    file: &'a str,
    findings: &'a mut Findings,
}

/// Checks a file of an FMU against its schema.
pub fn check(file: &str, root: &Element<'_>, schema: &Schema, findings: &mut Findings) {
    let mut document = Document { file, findings };
    if root.name == schema.root {
        document.element(root, schema.of);
    } else {
        let (found, expected) = (quote(root.name), schema.root);
        let text = format!("the root is {found}, expected {expected}");
        document.add(&ROOT_ELEMENT, root, text);
    }
}

impl Document<'_> {
    fn add(&mut self, rule: &'static Rule, element: &Element<'_>, text: String) {
        self.findings
            .add(rule, Location::of(self.file, element), text);
    }

    fn element(&mut self, element: &Element<'_>, of: &Type) {
        if let Content::Open = of.content {
            return;
        }
        self.attributes(element, of);
        if element.has_text && !matches!(of.content, Content::Mixed) {
            let text = format!("{} holds text, expected elements only", element.name);
            self.add(&NO_TEXT, element, text);
        }
        match of.content {
            Content::Sequence(parts) => self.children(element, parts),
            Content::Anything if element.children.len() > 1 => {
                let (name, number) = (element.name, element.children.len());
                let text = format!("{name} holds {number} elements, expected at most one");
                self.add(&ONE_ANNOTATION, element, text);
            }
            Content::Anything | Content::Mixed | Content::Open => {}
        }
    }

    fn attributes(&mut self, element: &Element<'_>, of: &Type) {
        let known = || of.shared.iter().copied().flatten().chain(of.attributes);
        for (name, form, required) in known() {
            match element.attribute(name) {
                None if *required => {
                    let text = format!("{} has no attribute {name}, expected one", element.name);
                    self.add(&ATTRIBUTE_REQUIRED, element, text);
                }
                Some(value) if !form.fits(value) => {
                    let (value, expected) = (quote(value), form.expected());
                    let text = format!("{name} is {value}, expected {expected}");
                    self.add(&ATTRIBUTE_VALUE, element, text);
                }
                _ => {}
            }
        }
        for (name, _) in &element.attributes {
            // Namespaces and schema locations may appear in any element.
            let special = *name == "xmlns"
                || ["xmlns:", "xml:", "xsi:"]
                    .iter()
                    .any(|p| name.starts_with(p));
            if special || known().any(|(known, _, _)| known == name) {
                continue;
            }
            let rule = match of.has_more {
                true if name.contains(':') => continue,
                true => &INTERFACE_ATTRIBUTE,
                false => &ATTRIBUTE_KNOWN,
            };
            let (at, name, version) = (element.name, quote(name), self.findings.version().as_str());
            let text =
                format!("{at} has the attribute {name}, which FMI {version} does not define");
            self.add(rule, element, text);
        }
    }

    /// Checks that the elements of a sequence are known and in the order of the parts.
    fn children(&mut self, parent: &Element<'_>, parts: &[Part]) {
        let mut counts = vec![0_usize; parts.len()];
        let mut reached = 0;
        for child in &parent.children {
            let found = parts.iter().enumerate().find_map(|(index, part)| {
                let (_, of) = part.choice.iter().find(|(name, _)| *name == child.name)?;
                Some((index, *of))
            });
            let Some((index, of)) = found else {
                let (at, name, expected) = (parent.name, quote(child.name), names(parts));
                let text = format!("{at} holds {name}, expected {expected}");
                self.add(&ELEMENT_KNOWN, child, text);
                continue;
            };
            if index < reached {
                let (name, later) = (child.name, parts[reached].choice[0].0);
                let text = format!("{name} comes after {later}, expected it before");
                self.add(&ELEMENT_ORDER, child, text);
            }
            reached = reached.max(index);
            counts[index] += 1;
            let at_most = parts[index].at_most;
            if counts[index] > at_most && counts[index] <= at_most + 1 {
                let (at, name) = (parent.name, child.name);
                let text = format!("{at} holds too many {name}, expected {at_most} at most");
                self.add(&ELEMENT_ONCE, child, text);
            }
            self.element(child, of);
        }
        for (part, count) in parts.iter().zip(counts) {
            if count < part.at_least {
                let (at, name) = (parent.name, names(std::slice::from_ref(part)));
                self.add(
                    &ELEMENT_REQUIRED,
                    parent,
                    format!("{at} holds no {name}, expected one"),
                );
            }
        }
    }
}

fn names(parts: &[Part]) -> String {
    let names: Vec<_> = parts
        .iter()
        .flat_map(|part| part.choice)
        .map(|(name, _)| *name)
        .collect();
    if names.is_empty() {
        "nothing".into()
    } else {
        names.join(" or ")
    }
}
