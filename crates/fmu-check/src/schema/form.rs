//! The simple types of the XML schemas: what the value of an attribute may be.

use fmu_description::value::{self, boolean, items, real};

/// A simple type.
#[derive(Debug, Clone, Copy)]
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
    Word(&'static [&'static str]),
    /// Items of a form, separated by white space.
    List(&'static Form),
}

impl Form {
    /// `xs:byte`
    pub const BYTE: Self = Self::Whole(i8::MIN as i128, i8::MAX as i128);
    /// `xs:unsignedByte`
    pub const UNSIGNED_BYTE: Self = Self::Whole(0, u8::MAX as i128);
    /// `xs:short`
    pub const SHORT: Self = Self::Whole(i16::MIN as i128, i16::MAX as i128);
    /// `xs:unsignedShort`
    pub const UNSIGNED_SHORT: Self = Self::Whole(0, u16::MAX as i128);
    /// `xs:int`
    pub const INT: Self = Self::Whole(i32::MIN as i128, i32::MAX as i128);
    /// `xs:unsignedInt`
    pub const UNSIGNED: Self = Self::Whole(0, u32::MAX as i128);
    /// `xs:long`
    pub const LONG: Self = Self::Whole(i64::MIN as i128, i64::MAX as i128);
    /// `xs:unsignedLong`
    pub const UNSIGNED_LONG: Self = Self::Whole(0, u64::MAX as i128);
    /// `xs:nonNegativeInteger`
    pub const NATURAL: Self = Self::Whole(0, i128::MAX);

    /// Whether the text is valid.
    pub fn fits(self, text: &str) -> bool {
        match self {
            Self::Text => true,
            Self::Real => real(text).is_some(),
            Self::Whole(min, max) => {
                let number = trim(text).parse::<i128>();
                number.is_ok_and(|number| (min..=max).contains(&number))
            }
            Self::Boolean => boolean(text).is_some(),
            Self::DateTime => value::Form::DateTime.fits(text),
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
    pub fn expected(self) -> String {
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
        part == "0"
            || !part.is_empty()
                && !part.starts_with('0')
                && part.bytes().all(|byte| byte.is_ascii_digit())
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
    fn whole_numbers_have_the_bounds_of_their_type() {
        for (form, text, fits) in [
            (Form::BYTE, "-128", true),
            (Form::BYTE, "128", false),
            (Form::UNSIGNED_LONG, "18446744073709551615", true),
            (Form::UNSIGNED_LONG, "18446744073709551616", false),
            (Form::UNSIGNED, " +7\n", true),
            (Form::UNSIGNED, "-1", false),
            (Form::INT, "1.0", false),
            (Form::INT, "", false),
            (Form::List(&Form::SHORT), " 1  32767 ", true),
            (Form::List(&Form::SHORT), "1 32768", false),
            (Form::List(&Form::SHORT), "", true),
        ] {
            assert_eq!(form.fits(text), fits, "{text:?}");
        }
    }

    #[test]
    fn bytes_are_pairs_of_digits() {
        for (text, fits) in [("", true), ("0aFf", true), ("0", false), ("0x", false)] {
            assert_eq!(Form::Hex.fits(text), fits, "{text:?}");
        }
    }

    #[test]
    fn versions_begin_with_3() {
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
