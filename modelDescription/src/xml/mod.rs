//! XML as a tree: built and written, or read within bounds.

#[cfg(feature = "xml")]
mod parse;

use std::borrow::Cow;
use std::fmt;

#[cfg(feature = "xml")]
pub use parse::parse;

/// An element.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Element<'a> {
    /// Its name, with the prefix of its namespace.
    pub name: &'a str,
    /// Names and values, without references and with spaces for line breaks.
    pub attributes: Vec<(&'a str, Cow<'a, str>)>,
    /// The elements in it, in their order.
    pub children: Vec<Element<'a>>,
    /// Whether there is text between them, other than space. It is not kept, as FMI has none.
    pub has_text: bool,
    /// The line on which it begins, from 1; 0 if it was not read.
    pub line: u32,
}

/// Reading.
impl<'a> Element<'a> {
    /// The value of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        let (_, value) = self.attributes.iter().find(|(n, _)| *n == name)?;
        Some(value)
    }

    /// The first element of a name in it.
    pub fn child(&self, name: &str) -> Option<&Element<'a>> {
        self.children(name).next()
    }

    /// The elements of a name in it.
    pub fn children(&self, name: &str) -> impl Iterator<Item = &Element<'a>> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// The elements of one name in its first element of another name.
    pub fn list(&self, list: &str, item: &str) -> impl Iterator<Item = &Element<'a>> {
        self.child(list)
            .into_iter()
            .flat_map(move |list| list.children(item))
    }
}

/// Building and writing.
impl<'a> Element<'a> {
    /// An empty element.
    pub fn new(name: &'a str) -> Self {
        Self {
            name,
            ..Self::default()
        }
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

    /// Adds a child that lists elements, unless there are none: the standards allow no empty lists.
    pub fn listing(self, list: &'a str, items: Vec<Self>) -> Self {
        if items.is_empty() {
            return self;
        }
        self.holding(Self::new(list).holding_all(items))
    }

    /// The document with this root, indented.
    ///
    /// # Errors
    /// An attribute has a character that XML cannot hold.
    pub fn document(&self) -> Result<String, InvalidText> {
        let mut xml = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
        self.write(&mut xml, 0)?;
        Ok(xml)
    }

    fn write(&self, xml: &mut String, depth: usize) -> Result<(), InvalidText> {
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

/// Writes a text as the value of an attribute, so that a reader gets it back exactly. White space is
/// written as references, for a reader takes it for spaces otherwise.
fn write_value(xml: &mut String, text: &str) -> Result<(), InvalidText> {
    if text.contains(is_forbidden) {
        return Err(InvalidText(text.to_owned()));
    }
    for c in text.chars() {
        match c {
            '&' => *xml += "&amp;",
            '<' => *xml += "&lt;",
            '>' => *xml += "&gt;",
            '"' => *xml += "&quot;",
            '\t' => *xml += "&#9;",
            '\n' => *xml += "&#10;",
            '\r' => *xml += "&#13;",
            c => xml.push(c),
        }
    }
    Ok(())
}

/// Whether XML 1.0 cannot hold a character.
fn is_forbidden(c: char) -> bool {
    matches!(c, '\0'..='\u{8}' | '\u{b}' | '\u{c}' | '\u{e}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}')
}

/// A text with a character that XML cannot hold.
#[derive(Debug)]
pub struct InvalidText(String);

impl fmt::Display for InvalidText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = quote(&self.0);
        write!(f, "{text} has a character that XML cannot hold")
    }
}

impl std::error::Error for InvalidText {}

/// Quotes untrusted text safely: on one line, and cut if it is long.
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
    fn elements_are_indented_and_empty_lists_left_out() {
        let root = Element::new("a")
            .with("x", 1.5)
            .with_some("y", None::<&str>)
            .listing("empty", vec![])
            .listing("bs", vec![Element::new("b").with_some("z", Some(true))]);
        assert_eq!(
            root.document().unwrap(),
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<a x=\"1.5\">\n  <bs>\n    <b z=\"true\"/>\n  </bs>\n</a>\n"
        );
    }

    #[cfg(feature = "xml")]
    #[test]
    fn any_text_is_read_back_as_it_was() {
        let text = "<&>\"' \u{e9}\u{1f600} 1\n2\t3\r";
        let xml = Element::new("a").with("x", text).document().unwrap();
        assert_eq!(parse(&xml).unwrap().attribute("x"), Some(text));
    }

    #[test]
    fn a_character_that_xml_cannot_hold_is_refused() {
        for text in ["\u{0}", "a\u{1b}", "\u{ffff}"] {
            assert!(Element::new("a").with("x", text).document().is_err());
        }
    }

    #[test]
    fn quoted_texts_are_cut_and_stay_on_one_line() {
        assert_eq!(quote("a\n\"b"), r#""a\n\"b""#);
        assert_eq!(quote(&"ä".repeat(80)).chars().count(), 82);
        assert!(quote(&"ä".repeat(100_000)).len() < 200);
    }
}
