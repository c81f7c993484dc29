//! What two model descriptions differ in.

use std::collections::HashSet;

use crate::text::{plain, quote};
use fmu_description::xml::Element;

/// Attributes of the root that tell of an export, not of the model.
const OF_THE_EXPORT: [&str; 2] = ["generationTool", "generationDateAndTime"];
/// Elements of the tool that wrote them, which have no meaning to others.
const OF_A_TOOL: [&str; 2] = ["VendorAnnotations", "Annotations"];

/// The comparison stops after this many.
const MAX_DIFFERENCES: usize = 100;
/// No text is longer than this.
const MAX_LENGTH: usize = 300;

/// An attribute or element that is not the same in two model descriptions.
#[derive(Debug, PartialEq)]
pub struct Difference {
    /// What differs: the elements that lead to it, and its name.
    pub path: String,
    /// What each has there, if it has anything.
    pub values: [Option<String>; 2],
    /// Whether the FMUs are of one version of a model all the same.
    pub is_harmless: bool,
}

impl Difference {
    fn new(path: String, values: [Option<String>; 2]) -> Self {
        Self {
            is_harmless: OF_THE_EXPORT.contains(&path.as_str()),
            path: plain(&path, MAX_LENGTH),
            values: values.map(|value| value.map(|value| plain(&value, MAX_LENGTH))),
        }
    }
}

/// The first differences of two model descriptions, in their order.
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
                compare(&below(path, &label), left, right, found);
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
            // They stand in another order: those that follow are not each other's partners.
            (_, labels) => {
                found.push(Difference::new(parent.to_owned(), labels));
                return;
            }
        };
        found.push(Difference::new(parent.to_owned(), labels));
    }
}

/// Adds the attributes that differ. Their order has no meaning.
fn attributes(path: &str, left: &Element<'_>, right: &Element<'_>, found: &mut Vec<Difference>) {
    let names = [left, right].map(|element| element.attributes.iter().map(|(name, _)| *name));
    let [of_left, of_right] = names;
    let of_right_alone = of_right.filter(|name| left.attribute(name).is_none());
    for name in of_left.chain(of_right_alone) {
        let values = [left, right].map(|element| element.attribute(name));
        if values[0] != values[1] {
            let values = values.map(|value| value.map(quote));
            found.push(Difference::new(below(path, name), values));
        }
    }
}

/// The path of what lies at a path; that of the root is empty.
fn below(path: &str, name: &str) -> String {
    if path.is_empty() {
        name.to_owned()
    } else {
        format!("{path}/{name}")
    }
}

fn children<'a, 'b>(element: &'a Element<'b>) -> impl Iterator<Item = &'a Element<'b>> {
    let of_the_model = |child: &&Element<'_>| !OF_A_TOOL.contains(&child.name);
    element.children.iter().filter(of_the_model)
}

/// The name of an element, with what it names.
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
    fn form_and_order_of_attributes_make_no_difference() {
        let left = "<?xml version='1.0'?><r a='1' b='&lt;'><v name='x'><Real/></v></r>";
        let right = "<r b=\"<\" a='1'>\r\n<!-- c --><v name='x'><Real></Real></v></r>";
        assert_eq!(found(left, &right.replace("\"<\"", "'&#60;'")), []);
    }

    #[test]
    fn what_tools_write_for_themselves_makes_no_difference() {
        let left = "<r><VendorAnnotations><T/></VendorAnnotations><v name='x'/></r>";
        let right = "<r><v name='x'><Annotations><T/></Annotations></v></r>";
        assert_eq!(found(left, right), []);
    }

    #[test]
    fn attributes_are_named_with_their_place_and_values() {
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
    fn elements_without_a_partner_are_named() {
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
    fn a_list_is_compared_up_to_where_its_order_differs() {
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
    fn only_what_tells_of_the_export_is_harmless() {
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
    fn differences_without_end_are_cut() {
        let long = |value: &str| {
            let variables: String = (0..1000)
                .map(|i| format!("<v name='{i}' a='{value}'/>"))
                .collect();
            format!("<r>{variables}</r>")
        };
        assert_eq!(found(&long("1"), &long("2")).len(), MAX_DIFFERENCES);
    }
}
