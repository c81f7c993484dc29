//! XML to be written, as a tree.

use anyhow::{Result, ensure};
use quick_xml::escape::escape;

/// An element.
pub struct Element {
    name: &'static str,
    attributes: Vec<(&'static str, String)>,
    children: Vec<Element>,
}

impl Element {
    /// An empty element, with the prefix of its namespace.
    pub fn new(name: &'static str) -> Self {
        Self {
            name,
            attributes: Vec::new(),
            children: Vec::new(),
        }
    }

    /// With an attribute.
    pub fn with(mut self, name: &'static str, value: impl ToString) -> Self {
        self.attributes.push((name, value.to_string()));
        self
    }

    /// With an attribute, if there is a value.
    pub fn with_some(self, name: &'static str, value: Option<impl ToString>) -> Self {
        match value {
            Some(value) => self.with(name, value),
            None => self,
        }
    }

    /// With an element in it.
    pub fn holding(self, child: Element) -> Self {
        self.holding_all([child])
    }

    /// With elements in it.
    pub fn holding_all(mut self, children: impl IntoIterator<Item = Element>) -> Self {
        self.children.extend(children);
        self
    }

    /// With a list of elements in it, unless that is empty: the standard has no empty lists.
    pub fn listing(self, list: &'static str, items: Vec<Element>) -> Self {
        if items.is_empty() {
            return self;
        }
        self.holding(Element::new(list).holding_all(items))
    }

    /// The document with this root, indented.
    ///
    /// # Errors
    /// A text holds what XML cannot.
    pub fn document(&self) -> Result<String> {
        let mut xml = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
        self.write(&mut xml, 0)?;
        Ok(xml)
    }

    fn write(&self, xml: &mut String, depth: usize) -> Result<()> {
        let indent = "  ".repeat(depth);
        *xml += &format!("{indent}<{}", self.name);
        for (name, value) in &self.attributes {
            *xml += &format!(" {name}=\"{}\"", attribute(value)?);
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

/// A text as it stands in an attribute; as it is, a reader would take a line break for a space.
fn attribute(text: &str) -> Result<String> {
    let is_forbidden =
        |c: char| (c < ' ' && !"\t\n\r".contains(c)) || "\u{fffe}\u{ffff}".contains(c);
    ensure!(
        !text.contains(is_forbidden),
        "{text:?} has a character that XML cannot hold"
    );
    Ok(escape(text)
        .replace('\t', "&#9;")
        .replace('\n', "&#10;")
        .replace('\r', "&#13;"))
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

    #[test]
    fn any_text_is_read_back_as_it_was() {
        let text = "<&>\"' \u{e9}\u{1f600}";
        let xml = Element::new("a").with("x", text).document().unwrap();
        assert_eq!(
            fmu_file::xml::parse(&xml).unwrap().attribute("x"),
            Some(text)
        );
        let xml = Element::new("a").with("x", "1\n2\t3\r").document().unwrap();
        assert!(xml.contains("x=\"1&#10;2&#9;3&#13;\""));
    }

    #[test]
    fn a_character_that_xml_cannot_hold_is_refused() {
        for text in ["\u{0}", "a\u{1b}", "\u{ffff}"] {
            assert!(Element::new("a").with("x", text).document().is_err());
        }
    }
}
