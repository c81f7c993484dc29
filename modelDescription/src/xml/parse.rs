//! Parses untrusted XML: no document types, only the predefined entities, and limits on depth and
//! size, so that a small file cannot exhaust memory.

use std::borrow::Cow;

use anyhow::{Context, Result, anyhow, bail, ensure};
use quick_xml::XmlVersion;
use quick_xml::escape::resolve_predefined_entity;
use quick_xml::events::{BytesRef, BytesStart, Event};
use quick_xml::reader::Reader;

use super::{Element, is_forbidden, quote};

/// Maximum depth of nested elements; model descriptions have six, vendor annotations may have more.
const MAX_DEPTH: usize = 64;
/// Maximum number of elements of a model description.
const MAX_ELEMENTS: usize = 1 << 20;
/// Maximum number of attributes of an element.
const MAX_ATTRIBUTES: usize = 64;

/// Parses a document, whatever encoding it declares; errors name the line.
///
/// # Errors
/// The text is not well-formed XML, or it exceeds the limits of this module.
pub fn parse(text: &str) -> Result<Element<'_>> {
    parse_up_to(MAX_ELEMENTS, text)
}

/// Parses a document as [`parse`] does, with this maximum number of elements.
///
/// # Errors
/// As [`parse`].
pub fn parse_up_to(most: usize, text: &str) -> Result<Element<'_>> {
    // The reader does not count a byte order mark in its positions.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut parser =
        Parser { text, at: 0, line: 1, open: Vec::new(), root: None, elements: 0, most };
    let mut reader = Reader::from_str(text);
    reader.config_mut().check_comments = true;
    loop {
        let start = reader.buffer_position();
        let event = reader.read_event().map_err(|error| {
            anyhow!("line {}: {error}", parser.line_of(reader.error_position()))
        })?;
        let space = match &event {
            Event::Eof => break,
            Event::Text(text) => text.len() - text.trim_ascii_start().len(),
            _ => 0,
        };
        let line = parser.line_of(start + space as u64);
        parser.take(event, line).with_context(|| format!("line {line}"))?;
    }
    ensure!(
        parser.open.is_empty(),
        "the document ends inside the element {}",
        quote(parser.open.last().map_or("", |e| e.name))
    );
    parser.root.context("the document has no root element")
}

struct Parser<'a> {
    text: &'a str,
    /// A position in the text, and its line.
    at: usize,
    line: u32,
    /// The elements that are not closed yet, the root first.
    open: Vec<Element<'a>>,
    root: Option<Element<'a>>,
    /// The number of elements, and the largest that is allowed.
    elements: usize,
    most: usize,
}

impl<'a> Parser<'a> {
    /// The line of a position after those that were asked for before.
    fn line_of(&mut self, position: u64) -> u32 {
        let position = usize::try_from(position).unwrap_or(usize::MAX);
        if let Some(passed) = self.text.as_bytes().get(self.at..position) {
            let breaks = passed.iter().filter(|byte| **byte == b'\n').count();
            let breaks = u32::try_from(breaks).unwrap_or(u32::MAX);
            self.line = self.line.saturating_add(breaks);
            self.at = position;
        }
        self.line
    }

    fn take(&mut self, event: Event<'a>, line: u32) -> Result<()> {
        match event {
            Event::Start(start) => {
                let element = self.element(&start, line)?;
                ensure!(self.open.len() < MAX_DEPTH, "elements are nested deeper than {MAX_DEPTH}");
                self.open.push(element);
            }
            Event::Empty(start) => {
                let element = self.element(&start, line)?;
                self.close(element)?;
            }
            Event::End(_) => {
                let element = self.open.pop().context("there is an end tag without a start tag")?;
                self.close(element)?;
            }
            Event::Text(text) => self.note_text(&text, line)?,
            Event::CData(text) => self.note_text(&text, line)?,
            Event::GeneralRef(reference) => self.reference(&reference, line)?,
            Event::Decl(_) => self.declaration()?,
            Event::DocType(_) => bail!(
                "a document type (DTD) is not allowed: FMI has none, and its entities may exhaust memory"
            ),
            Event::Comment(comment) => check_characters(&comment)?,
            Event::PI(_) | Event::Eof => {}
        }
        Ok(())
    }

    fn element(&mut self, start: &BytesStart<'a>, line: u32) -> Result<Element<'a>> {
        self.elements += 1;
        ensure!(self.elements <= self.most, "there are more than {} elements", self.most);
        let source = self.text;
        let mut element = Element {
            name: within(source, start.name().into_inner())?,
            line,
            ..Element::default()
        };
        for attribute in start.attributes() {
            let attribute = attribute?;
            let name = within(source, attribute.key.into_inner())?;
            ensure!(
                element.attributes.len() < MAX_ATTRIBUTES,
                "an element has more than {MAX_ATTRIBUTES} attributes"
            );
            ensure!(
                !attribute.value.contains('<'),
                "the attribute {} contains <, expected &lt;",
                quote(name)
            );
            let value = attribute
                .normalized_value(XmlVersion::Explicit1_0)
                .map_err(|error| anyhow!("the attribute {}: {error}", quote(name)))?;
            check_characters(&value)?;
            let value = match value {
                Cow::Borrowed(value) => Cow::Borrowed(within(source, value)?),
                Cow::Owned(value) => Cow::Owned(value),
            };
            element.attributes.push((name, value));
        }
        Ok(element)
    }

    fn close(&mut self, element: Element<'a>) -> Result<()> {
        match self.open.last_mut() {
            Some(parent) => parent.children.push(element),
            None => {
                ensure!(self.root.is_none(), "there is a second root element");
                self.root = Some(element);
            }
        }
        Ok(())
    }

    fn note_text(&mut self, text: &str, line: u32) -> Result<()> {
        check_characters(text)?;
        if text.trim_matches([' ', '\t', '\r', '\n']).is_empty() {
            return Ok(());
        }
        let element = self.open.last_mut().context("there is text outside the root element")?;
        element.text_line.get_or_insert(line);
        Ok(())
    }

    fn reference(&mut self, reference: &BytesRef<'_>, line: u32) -> Result<()> {
        let character = reference.resolve_char_ref()?.map(String::from);
        let text = character.as_deref().or_else(|| resolve_predefined_entity(reference));
        let text = text.with_context(|| {
            format!(
                "the entity {} is unknown, expected lt, gt, amp, quot or apos",
                quote(reference)
            )
        })?;
        self.note_text(text, line)
    }

    fn declaration(&self) -> Result<()> {
        ensure!(self.at == 0, "there is an XML declaration after the start of the document");
        Ok(())
    }
}

/// Returns `part` of `source` with the lifetime of the source, which the reader shortens.
fn within<'a>(source: &'a str, part: &str) -> Result<&'a str> {
    let start = (part.as_ptr() as usize).wrapping_sub(source.as_ptr() as usize);
    source.get(start..start.saturating_add(part.len())).context("a name could not be read")
}

fn check_characters(text: &str) -> Result<()> {
    match text.chars().find(|c| is_forbidden(*c)) {
        Some(c) => bail!("the character U+{:04X} is not allowed in XML", u32::from(c)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        format!("{:#}", parse(text).expect_err(text))
    }

    #[test]
    fn a_document_becomes_a_tree() {
        let root = parse(
            "\u{feff}<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<!-- c -->\n<a b='1 &lt;&#x41;\n2'>\n<c/>\n<d>\n x\ny</d></a>\n",
        )
        .unwrap();
        assert_eq!((root.name, root.line), ("a", 3));
        assert_eq!(root.attribute("b"), Some("1 <A 2"));
        assert_eq!(root.children.len(), 2);
        assert_eq!(root.child("c").unwrap().line, 5);
        assert_eq!([root.text_line, root.child("d").unwrap().text_line], [None, Some(7)]);
    }

    #[test]
    fn malformed_documents_are_rejected_with_the_line() {
        for text in [
            "",
            "x",
            "<a>",
            "<a></b>",
            "</a>",
            "<a/><b/>",
            "<a b='1' b='2'/>",
            "<a b=1/>",
            "<a b/>",
            "<a b='<'/>",
            "<a>&amp</a>",
            "<a>&x;</a>",
            "<a b='&x;'/>",
            "<a b='&#0;'/>",
            "<a>\u{1}</a>",
            "<a/>x",
            "<a><!-- -- --></a>",
            "<a><!-- \u{1} --></a>",
            "<a/><?xml version='1.0'?>",
            "\n<?xml version='1.0'?><a/>",
            "<!-- c --><?xml version='1.0'?><a/>",
        ] {
            error(text);
        }
        assert!(error("<a>\n\n<b></c></a>").starts_with("line 3"));
        assert!(error("<a>\n</a>\n\n\u{0}").starts_with("line 4"));
        let unknown = "line 2: the attribute \"c\": at 1..2: unrecognized entity `x`";
        assert_eq!(error("<a>\n<b c='&x;'/></a>"), unknown);
    }

    #[test]
    fn entity_bombs_and_oversized_documents_are_rejected() {
        let entities = "<!DOCTYPE a [<!ENTITY x \"ha\"><!ENTITY y \"&x;&x;\">]><a>&y;</a>";
        assert!(error(entities).contains("DTD"));
        assert!(error(&"<a>".repeat(100_000)).contains("deeper than 64"));
        let wide = format!("<a>{}</a>", "<b/>".repeat(MAX_ELEMENTS));
        assert!(error(&wide).contains("more than 1048576 elements"));
        assert!(parse_up_to(MAX_ELEMENTS + 1, &wide).is_ok());
        let attributes: String = (0..100).map(|i| format!(" a{i}=''")).collect();
        assert!(error(&format!("<a{attributes}/>")).contains("attributes"));
    }
}
