//! The XML schemas of FMI 2.0.5 and FMI 3.0.2, and the validation of a document against them.

mod grammar;

use std::sync::LazyLock;

use fmu_description::xml::Element;
use fmu_file::text::quote;

use crate::finding::{Findings, Location, find, require};
use crate::rule::rules;
use grammar::{Content, Part, Schema, Type};

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

macro_rules! schemas {
    ($($name:ident = $file:literal;)*) => {
        $(
            #[doc = concat!("The schema in `", $file, "`.")]
            pub static $name: LazyLock<Schema> = LazyLock::new(|| Schema::new(include_str!($file)));
        )*
    };
}
schemas! {
    MODEL_2 = "modelDescription2.txt";
    MODEL_3 = "modelDescription3.txt";
    TERMINALS = "terminalsAndIcons.txt";
    BUILD = "buildDescription.txt";
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
        return find!(findings, ROOT_ELEMENT at Location::of(file, root),
            "the root is {}, expected {}", quote(root.name), schema.root);
    }
    let mut document = Document {
        file,
        schema,
        findings,
    };
    document.element(root, schema.root);
}

impl Document<'_> {
    fn element(&mut self, element: &Element<'_>, of: &str) {
        let Some(of) = self.schema.of(of) else {
            return;
        };
        let (at, name) = (|| Location::of(self.file, element), element.name);
        match &of.content {
            Content::Everything => return,
            Content::One => {
                let number = element.children.len();
                require!(self.findings, ONE_ANNOTATION at at(), number <= 1,
                    "{name} holds {number} elements, expected at most one");
            }
            _ => {}
        }
        let may_have_text = matches!(of.content, Content::Mixed);
        require!(self.findings, NO_TEXT at at(), may_have_text || !element.has_text,
            "{name} holds text, expected elements only");
        self.attributes(element, of);
        if let Content::Sequence(parts) = &of.content {
            self.children(element, parts);
        }
    }

    fn attributes(&mut self, element: &Element<'_>, of: &Type) {
        let (at, of_element) = (|| Location::of(self.file, element), element.name);
        for known in &of.attributes {
            let name = known.name;
            match element.attribute(name) {
                None => require!(self.findings, ATTRIBUTE_REQUIRED at at(), !known.is_required,
                    "{of_element} has no attribute {name}, expected one"),
                Some(value) => {
                    require!(self.findings, ATTRIBUTE_VALUE at at(), known.form.fits(value),
                    "{name} is {}, expected {}", quote(value), known.form.expected())
                }
            }
        }
        for (name, _) in &element.attributes {
            // Namespaces and schema locations may appear in any element.
            let special = *name == "xmlns"
                || ["xmlns:", "xml:", "xsi:"]
                    .iter()
                    .any(|p| name.starts_with(p));
            let is_known = of.attributes.iter().any(|known| known.name == *name);
            if special || is_known || of.has_more && name.contains(':') {
                continue;
            }
            let rule = match of.has_more {
                true => &INTERFACE_ATTRIBUTE,
                false => &ATTRIBUTE_KNOWN,
            };
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
            let (at, name) = (Location::of(self.file, child), child.name);
            let found = parts.iter().enumerate().find_map(|(index, part)| {
                let (_, of) = part.choice.iter().find(|(choice, _)| *choice == name)?;
                Some((index, *of))
            });
            let Some((index, of)) = found else {
                find!(self.findings, ELEMENT_KNOWN at at,
                    "{parent_name} holds {}, expected {}", quote(name), names(parts));
                continue;
            };
            require!(self.findings, ELEMENT_ORDER at at.clone(), index >= reached,
                "{name} comes after {}, expected it before", parts[reached].choice[0].0);
            reached = reached.max(index);
            counts[index] += 1;
            let at_most = parts[index].at_most;
            require!(self.findings, ELEMENT_ONCE at at, counts[index].checked_sub(1) != Some(at_most),
                "{parent_name} holds too many {name}, expected {at_most} at most");
            self.element(child, of);
        }
        for (part, count) in parts.iter().zip(counts) {
            require!(self.findings, ELEMENT_REQUIRED at Location::of(self.file, parent),
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
