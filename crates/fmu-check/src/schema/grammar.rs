//! A compact notation for the XML schemas of FMI.
//!
//! A line defines the type of an element; its continuation is indented:
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

use fmu_description::value::{boolean, is_date_time, items, real};

/// An XML schema.
pub struct Schema {
    /// Name of the root element.
    pub root: &'static str,
    types: HashMap<&'static str, Type>,
}

/// The attributes and children that an element may have.
#[derive(Default)]
pub struct Type {
    pub attributes: Vec<Attribute>,
    /// Whether it may have further attributes.
    pub has_more: bool,
    pub content: Content,
}

/// An attribute of an element.
#[derive(Clone)]
pub struct Attribute {
    pub name: &'static str,
    pub form: Form,
    pub is_required: bool,
}

/// What is inside an element.
pub enum Content {
    /// Elements in this order.
    Sequence(Vec<Part>),
    /// At most one element, of any kind.
    One,
    /// Any children and text.
    Mixed,
    /// Any children, text and attributes.
    Everything,
}

impl Default for Content {
    fn default() -> Self {
        Self::Sequence(Vec::new())
    }
}

/// A part of a sequence: the elements allowed there with the names of their types, and how many.
pub struct Part {
    pub choice: Vec<(&'static str, &'static str)>,
    pub at_least: usize,
    pub at_most: usize,
}

impl Schema {
    /// Reads a schema in the notation of this module.
    pub fn new(text: &'static str) -> Self {
        let mut definitions: Vec<Vec<&str>> = Vec::new();
        for line in text.lines() {
            match definitions.last_mut() {
                Some(last) if line.starts_with(' ') => last.extend(line.split_whitespace()),
                _ => definitions.push(line.split_whitespace().collect()),
            }
        }
        definitions.retain(|words| !words.is_empty());
        let mut shared: HashMap<&str, &[&'static str]> = HashMap::new();
        for words in definitions.iter().filter(|words| words[0].starts_with('@')) {
            shared.insert(words[0], &words[1..]);
        }
        let mut types = HashMap::new();
        for words in &definitions {
            types.insert(words[0], Type::of(&words[1..], &shared));
        }
        let root = definitions.first().map_or("", |words| words[0]);
        Self { root, types }
    }

    /// The type of this name.
    pub fn of(&self, name: &str) -> Option<&Type> {
        self.types.get(name)
    }
}

impl Type {
    fn of(words: &[&'static str], shared: &HashMap<&str, &[&'static str]>) -> Self {
        let mut found = Self::default();
        let mut parts = words.splitn(2, |word| *word == ">");
        for word in parts.next().unwrap_or_default() {
            match shared.get(word) {
                Some(words) => {
                    let more = Self::of(words, shared);
                    found.attributes.extend(more.attributes);
                    found.has_more |= more.has_more;
                }
                None if *word == "..." => found.has_more = true,
                None => found.attributes.push(Attribute::of(word)),
            }
        }
        found.content = match parts.next().unwrap_or_default() {
            ["one"] => Content::One,
            ["mixed"] => Content::Mixed,
            ["everything"] => Content::Everything,
            words => Content::Sequence(sequence(words)),
        };
        found
    }
}

impl Attribute {
    fn of(word: &'static str) -> Self {
        let (name, form) = word.split_once('=').unwrap_or((word, "string"));
        let required = name.strip_suffix('!');
        Self {
            name: required.unwrap_or(name),
            form: Form::of(form),
            is_required: required.is_some(),
        }
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
            parts.push(Part {
                choice: std::mem::take(&mut choice),
                at_least,
                at_most,
            });
        }
    }
    parts
}

/// A simple type of XML: what the value of an attribute may be.
#[derive(Debug, Clone)]
pub enum Form {
    /// Any text.
    Text,
    /// `xs:double` or `xs:float`
    Real,
    /// A whole number within these bounds.
    Whole(i128, i128),
    /// `xs:boolean`
    Boolean,
    /// `xs:dateTime`
    DateTime,
    /// `xs:hexBinary`
    Hex,
    /// A version of FMI 3, such as 3.0 or 3.0.2-beta.
    Version,
    /// One of these words.
    Word(Vec<&'static str>),
    /// Items of a form, separated by white space.
    List(Box<Form>),
}

impl Form {
    /// The form of a name.
    fn of(name: &'static str) -> Self {
        let list = name
            .strip_prefix('[')
            .and_then(|name| name.strip_suffix(']'));
        if let Some(item) = list {
            return Self::List(Self::of(item).into());
        }
        match name {
            "string" => Self::Text,
            "double" => Self::Real,
            "boolean" => Self::Boolean,
            "dateTime" => Self::DateTime,
            "hexBinary" => Self::Hex,
            "version" => Self::Version,
            "byte" => Self::Whole(i8::MIN.into(), i8::MAX.into()),
            "unsignedByte" => Self::Whole(0, u8::MAX.into()),
            "short" => Self::Whole(i16::MIN.into(), i16::MAX.into()),
            "unsignedShort" => Self::Whole(0, u16::MAX.into()),
            "int" => Self::Whole(i32::MIN.into(), i32::MAX.into()),
            "unsignedInt" => Self::Whole(0, u32::MAX.into()),
            "long" => Self::Whole(i64::MIN.into(), i64::MAX.into()),
            "unsignedLong" => Self::Whole(0, u64::MAX.into()),
            "nonNegativeInteger" => Self::Whole(0, i128::MAX),
            words => Self::Word(words.split('|').collect()),
        }
    }

    /// Whether the text is valid.
    pub fn fits(&self, text: &str) -> bool {
        match self {
            Self::Text => true,
            Self::Real => real(text).is_some(),
            Self::Whole(min, max) => {
                let number = trim(text).parse::<i128>();
                number.is_ok_and(|number| (min..=max).contains(&&number))
            }
            Self::Boolean => boolean(text).is_some(),
            Self::DateTime => is_date_time(text),
            Self::Hex => {
                let digits = trim(text);
                digits.len().is_multiple_of(2)
                    && digits.bytes().all(|byte| byte.is_ascii_hexdigit())
            }
            Self::Version => is_version(text),
            Self::Word(words) => words.contains(&text),
            Self::List(form) => items(text).all(|item| form.fits(item)),
        }
    }

    /// The expected value, for error messages.
    pub fn expected(&self) -> String {
        match self {
            Self::Text => "a text".into(),
            Self::Real => "a number".into(),
            Self::Whole(min, i128::MAX) => format!("a whole number from {min}"),
            Self::Whole(min, max) => format!("a whole number from {min} to {max}"),
            Self::Boolean => "true, false, 1 or 0".into(),
            Self::DateTime => "a date and time such as 2026-01-31T12:00:00Z".into(),
            Self::Hex => "pairs of hexadecimal digits".into(),
            Self::Version => "a version such as 3.0".into(),
            Self::Word(words) => words.join(" or "),
            Self::List(form) => format!("items separated by spaces, each {}", form.expected()),
        }
    }
}

/// Trims white space, which the schema ignores around numbers.
fn trim(text: &str) -> &str {
    text.trim_matches([' ', '\t', '\r', '\n'])
}

/// `3[.](0|[1-9][0-9]*)([.](0|[1-9][0-9]*))?(-.+)?`
fn is_version(text: &str) -> bool {
    let (numbers, suffix) = match text.split_once('-') {
        Some((numbers, suffix)) => (numbers, Some(suffix)),
        None => (text, None),
    };
    let is_number = |part: &str| {
        let has_digits = !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
        part == "0" || has_digits && !part.starts_with('0')
    };
    let mut parts = numbers.split('.');
    parts.next() == Some("3")
        && (1..=2).contains(&numbers.matches('.').count())
        && parts.all(is_number)
        && suffix != Some("")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_form_of_their_type() {
        for (form, good, bad) in [
            ("byte", "-128", "128"),
            (
                "unsignedLong",
                "18446744073709551615",
                "18446744073709551616",
            ),
            ("unsignedInt", " +7\n", "-1"),
            ("int", "0", "1.0"),
            ("int", "-7", ""),
            ("[short]", " 1  32767 ", "1 32768"),
            ("[short]", "", "x"),
            ("hexBinary", "", "0"),
            ("hexBinary", "0aFf", "0x"),
            ("a|b", "b", "a|b"),
        ] {
            let form = Form::of(form);
            assert!(form.fits(good), "{form:?} {good:?}");
            assert!(!form.fits(bad), "{form:?} {bad:?}");
        }
        for good in ["3.0", "3.0.2", "3.10", "3.0-beta.1", "3.0.1-rc-2"] {
            assert!(Form::Version.fits(good), "{good}");
        }
        for bad in [
            "3", "2.0", "3.", "3.00", "3.0.", "3.0.0.1", "3.0-", "3.x", " 3.0", "3-1",
        ] {
            assert!(!Form::Version.fits(bad), "{bad}");
        }
    }
}
