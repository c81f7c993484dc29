//! XML as a tree of elements, to build and write, or to read within limits.

mod encoding;
mod parse;

use std::borrow::Cow;

use anyhow::{Result, ensure};
pub use quick_xml::escape::escape;
use quick_xml::escape::partial_escape;

use crate::value;

pub use encoding::{Decoded, decode};
pub use parse::{parse, parse_up_to};

/// An element.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Element<'a> {
    /// Its name, including a namespace prefix.
    pub name: &'a str,
    /// Names and values, with references resolved and line breaks normalized to spaces.
    pub attributes: Vec<(&'a str, Cow<'a, str>)>,
    /// Its child elements, in order.
    pub children: Vec<Element<'a>>,
    /// The line of its first text other than white space. The text is not kept, as FMI has none.
    pub text_line: Option<u32>,
    /// The line on which it starts, from 1; 0 if it was not parsed.
    pub line: u32,
}

/// Reading.
impl<'a> Element<'a> {
    /// The value of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        let (_, value) = self.attributes.iter().find(|(n, _)| *n == name)?;
        Some(value)
    }

    /// Whether it has an attribute.
    pub fn has(&self, name: &str) -> bool {
        self.attribute(name).is_some()
    }

    /// The value of an attribute that is an `xs:double`.
    pub fn real(&self, name: &str) -> Option<f64> {
        value::real(self.attribute(name)?)
    }

    /// Whether an attribute is an `xs:boolean` that is true.
    pub fn is_true(&self, name: &str) -> bool {
        self.attribute(name).and_then(value::boolean) == Some(true)
    }

    /// The first child with the given name.
    pub fn child(&self, name: &str) -> Option<&Element<'a>> {
        self.children(name).next()
    }

    /// The children with the given name.
    pub fn children(&self, name: &str) -> impl Iterator<Item = &Element<'a>> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// The children named `item` of its first child named `list`.
    pub fn list(&self, list: &str, item: &str) -> impl Iterator<Item = &Element<'a>> {
        self.child(list).into_iter().flat_map(move |list| list.children(item))
    }
}

/// Building and writing.
impl<'a> Element<'a> {
    /// Creates an element without attributes and children.
    pub fn new(name: &'a str) -> Self {
        Self { name, ..Self::default() }
    }

    /// Adds an attribute.
    pub fn with(mut self, name: &'a str, value: impl ToString) -> Self {
        self.attributes.push((name, value.to_string().into()));
        self
    }

    /// Adds an attribute if there is a value.
    pub fn with_some(self, name: &'a str, value: Option<impl ToString>) -> Self {
        match value {
            Some(value) => self.with(name, value),
            None => self,
        }
    }

    /// Adds a child.
    pub fn holding(self, child: Self) -> Self {
        self.holding_all([child])
    }

    /// Adds children.
    pub fn holding_all(mut self, children: impl IntoIterator<Item = Self>) -> Self {
        self.children.extend(children);
        self
    }

    /// Adds a child that lists elements, unless there are none: the standards forbid empty lists.
    pub fn listing(self, list: &'a str, items: Vec<Self>) -> Self {
        if items.is_empty() {
            return self;
        }
        self.holding(Self::new(list).holding_all(items))
    }

    /// The document with this root, indented.
    ///
    /// # Errors
    /// An attribute has a character that is not allowed in XML.
    pub fn document(&self) -> Result<String> {
        let mut xml = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
        self.write(&mut xml, 0)?;
        Ok(xml)
    }

    fn write(&self, xml: &mut String, depth: usize) -> Result<()> {
        let indent = "  ".repeat(depth);
        *xml += &format!("{indent}<{}", self.name);
        for (name, value) in &self.attributes {
            *xml += &format!(" {name}=\"");
            write_value(xml, value)?;
            xml.push('"');
        }
        if self.children.is_empty() {
            *xml += "/>\n";
            return Ok(());
        }
        *xml += ">\n";
        for child in &self.children {
            child.write(xml, depth + 1)?;
        }
        *xml += &format!("{indent}</{}>\n", self.name);
        Ok(())
    }
}

/// Writes a text as the value of an attribute, so that a parser returns it unchanged. White space is
/// written as references because parsers normalize it to spaces.
fn write_value(xml: &mut String, text: &str) -> Result<()> {
    ensure!(
        !text.contains(is_forbidden),
        "{} has a character that is not allowed in XML",
        quote(text)
    );
    let others = [("\"", "&quot;"), ("\t", "&#9;"), ("\n", "&#10;"), ("\r", "&#13;")];
    let escaped = partial_escape(text).into_owned();
    *xml += &others.iter().fold(escaped, |text, (from, to)| text.replace(from, to));
    Ok(())
}

/// Whether a character is not allowed in XML 1.0.
fn is_forbidden(c: char) -> bool {
    matches!(c, '\0'..='\u{8}' | '\u{b}' | '\u{c}' | '\u{e}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}')
}

/// Quotes untrusted text safely: on one line, and truncated if it is long.
pub fn quote(text: &str) -> String {
    const MAX_LENGTH: usize = 80;
    if text.chars().nth(MAX_LENGTH).is_none() {
        return format!("{text:?}");
    }
    let start: String = text.chars().take(MAX_LENGTH).collect();
    format!("{start:?}...")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_text_round_trips() {
        let text = "<&>\"' \u{e9}\u{1f600} 1\n2\t3\r";
        let xml = Element::new("a").with("x", text).document().unwrap();
        assert_eq!(parse(&xml).unwrap().attribute("x"), Some(text));
    }

    #[test]
    fn characters_not_allowed_in_xml_are_rejected() {
        for text in ["\u{0}", "a\u{1b}", "\u{ffff}"] {
            assert!(Element::new("a").with("x", text).document().is_err());
        }
    }

    #[test]
    fn quoted_text_is_truncated_and_on_one_line() {
        assert_eq!(quote("a\n\"b"), r#""a\n\"b""#);
        assert_eq!(quote(&"ä".repeat(80)).chars().count(), 82);
        assert!(quote(&"ä".repeat(100_000)).len() < 200);
    }
}
