//! Differences between two model descriptions.

use std::collections::HashSet;

use crate::text::{plain, quote};
use fmu_description::xml::Element;

/// Attributes of the root element that describe the export, not the model.
const EXPORT_ATTRIBUTES: [&str; 2] = ["generationTool", "generationDateAndTime"];
/// Tool-specific elements, which have no meaning for other tools.
const TOOL_ELEMENTS: [&str; 2] = ["VendorAnnotations", "Annotations"];

/// Maximum number of differences.
const MAX_DIFFERENCES: usize = 100;
/// Maximum length of a text.
const MAX_LENGTH: usize = 300;

/// An attribute or element that differs between two model descriptions.
#[derive(Debug, PartialEq)]
pub struct Difference {
    /// Path of the attribute or element.
    pub path: String,
    /// The value in each model description; `None` if missing.
    pub values: [Option<String>; 2],
    /// Whether the FMUs can be the same version of the same model nevertheless.
    pub is_harmless: bool,
}

impl Difference {
    fn new(path: String, values: [Option<String>; 2]) -> Self {
        Self {
            is_harmless: EXPORT_ATTRIBUTES.contains(&path.as_str()),
            path: plain(&path, MAX_LENGTH),
            values: values.map(|value| value.map(|value| plain(&value, MAX_LENGTH))),
        }
    }
}

/// The first differences between two model descriptions, in order.
pub fn differences(left: &Element<'_>, right: &Element<'_>) -> Vec<Difference> {
    let mut found = Vec::new();
    compare("", left, right, &mut found);
    found
}

fn compare(path: &str, left: &Element<'_>, right: &Element<'_>, found: &mut Vec<Difference>) {
    attributes(path, left, right, found);
    let parent = if path.is_empty() { left.name } else { path };
    let [in_left, in_right] =
        [left, right].map(|element| children(element).map(label).collect::<HashSet<_>>());
    let (mut of_left, mut of_right) = (children(left).peekable(), children(right).peekable());
    while found.len() < MAX_DIFFERENCES {
        let next = [of_left.peek(), of_right.peek()].map(Option::<&&_>::copied);
        let labels = next.map(|element| element.map(label));
        let labels = match (next, labels) {
            ([None, None], _) => return,
            ([Some(left), Some(right)], [Some(label), Some(other)]) if label == other => {
                compare(&child_path(path, &label), left, right, found);
                of_left.next();
                of_right.next();
                continue;
            }
            (_, [Some(left), _]) if !in_right.contains(&left) => {
                of_left.next();
                [Some(left), None]
            }
            (_, [_, Some(right)]) if !in_left.contains(&right) => {
                of_right.next();
                [None, Some(right)]
            }
            // The order differs, so the elements that follow cannot be paired.
            (_, labels) => {
                found.push(Difference::new(parent.to_owned(), labels));
                return;
            }
        };
        found.push(Difference::new(parent.to_owned(), labels));
    }
}

/// Compares attributes; their order is irrelevant.
fn attributes(path: &str, left: &Element<'_>, right: &Element<'_>, found: &mut Vec<Difference>) {
    let names = [left, right].map(|element| element.attributes.iter().map(|(name, _)| *name));
    let [of_left, of_right] = names;
    let of_right_alone = of_right.filter(|name| left.attribute(name).is_none());
    for name in of_left.chain(of_right_alone) {
        let values = [left, right].map(|element| element.attribute(name));
        if values[0] != values[1] {
            let values = values.map(|value| value.map(quote));
            found.push(Difference::new(child_path(path, name), values));
        }
    }
}

/// The path of a child or attribute; the path of the root is empty.
fn child_path(path: &str, name: &str) -> String {
    if path.is_empty() {
        name.to_owned()
    } else {
        format!("{path}/{name}")
    }
}

fn children<'a, 'b>(element: &'a Element<'b>) -> impl Iterator<Item = &'a Element<'b>> {
    let of_the_model = |child: &&Element<'_>| !TOOL_ELEMENTS.contains(&child.name);
    element.children.iter().filter(of_the_model)
}

/// The name of an element, with its attribute `name`.
fn label(element: &Element<'_>) -> String {
    match element.attribute("name") {
        Some(name) => format!("{} {}", element.name, quote(name)),
        None => element.name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use fmu_description::xml;

    use super::*;

    fn found(left: &str, right: &str) -> Vec<(String, Option<String>, Option<String>)> {
        let (left, right) = (xml::parse(left).unwrap(), xml::parse(right).unwrap());
        differences(&left, &right)
            .into_iter()
            .map(|Difference { path, values, .. }| {
                let [left, right] = values;
                (path, left, right)
            })
            .collect()
    }

    fn difference(
        path: &str,
        left: Option<&str>,
        right: Option<&str>,
    ) -> (String, Option<String>, Option<String>) {
        (path.into(), left.map(Into::into), right.map(Into::into))
    }

    #[test]
    fn syntax_and_order_of_attributes_are_irrelevant() {
        let left = "<?xml version='1.0'?><r a='1' b='&lt;'><v name='x'><Real/></v></r>";
        let right = "<r b=\"<\" a='1'>\r\n<!-- c --><v name='x'><Real></Real></v></r>";
        assert_eq!(found(left, &right.replace("\"<\"", "'&#60;'")), []);
    }

    #[test]
    fn tool_specific_elements_are_ignored() {
        let left = "<r><VendorAnnotations><T/></VendorAnnotations><v name='x'/></r>";
        let right = "<r><v name='x'><Annotations><T/></Annotations></v></r>";
        assert_eq!(found(left, right), []);
    }

    #[test]
    fn differing_attributes_have_a_path_and_values() {
        let left = "<r guid='1'><V><v name='x'><Real start='0'/></v></V></r>";
        let right = "<r guid='2'><V><v name='x' c='d'><Real/></v></V></r>";
        assert_eq!(
            found(left, right),
            [
                difference("guid", Some("\"1\""), Some("\"2\"")),
                difference("V/v \"x\"/c", None, Some("\"d\"")),
                difference("V/v \"x\"/Real/start", Some("\"0\""), None),
            ]
        );
    }

    #[test]
    fn unpaired_elements_are_reported() {
        let left = "<r><T/><V><v name='x'/><v name='y'/><v name='z'/></V></r>";
        let right = "<r><V><v name='x'/><v name='z' a='1'/><v name='w'/></V></r>";
        assert_eq!(
            found(left, right),
            [
                difference("r", Some("T"), None),
                difference("V", Some("v \"y\""), None),
                difference("V/v \"z\"/a", None, Some("\"1\"")),
                difference("V", None, Some("v \"w\"")),
            ]
        );
    }

    #[test]
    fn a_list_is_compared_until_its_order_differs() {
        let left = "<r><V><v name='x'/><v name='y'/></V><O><u i='1'/></O></r>";
        let right = "<r><V><v name='y'/><v name='x'/></V><O><u i='1'/><u i='2'/></O></r>";
        assert_eq!(
            found(left, right),
            [
                difference("V", Some("v \"x\""), Some("v \"y\"")),
                difference("O", None, Some("u")),
            ]
        );
    }

    #[test]
    fn only_export_attributes_are_harmless() {
        let left = "<r generationTool='a' generationDateAndTime='1' version='1'><s generationTool='a'/></r>";
        let right = "<r generationTool='b' version='2'><s generationTool='b'/></r>";
        let (left, right) = (xml::parse(left).unwrap(), xml::parse(right).unwrap());
        let harmless: Vec<bool> = differences(&left, &right)
            .iter()
            .map(|difference| difference.is_harmless)
            .collect();
        assert_eq!(harmless, [true, true, false, false]);
    }

    #[test]
    fn the_number_of_differences_is_limited() {
        let long = |value: &str| {
            let variables: String = (0..1000)
                .map(|i| format!("<v name='{i}' a='{value}'/>"))
                .collect();
            format!("<r>{variables}</r>")
        };
        assert_eq!(found(&long("1"), &long("2")).len(), MAX_DIFFERENCES);
    }
}
