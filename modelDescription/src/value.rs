//! The simple types of the XML schema: syntax of attribute values in a model description.

use std::str::FromStr;

/// A simple type.
#[derive(Debug, Clone, Copy)]
pub enum Form {
    /// Any text.
    Text,
    /// `xs:double`
    Real,
    /// `xs:int`
    Integer,
    /// `xs:unsignedInt`
    Unsigned,
    /// `xs:boolean`
    Boolean,
    /// `xs:dateTime`
    DateTime,
    /// One of these words.
    Word(&'static [&'static str]),
    /// A space-separated list of `xs:unsignedInt`.
    Unsigneds,
    /// A space-separated list of these words.
    Words(&'static [&'static str]),
}

impl Form {
    /// Whether the text is valid.
    pub fn fits(self, text: &str) -> bool {
        match self {
            Self::Text => true,
            Self::Real => real(text).is_some(),
            Self::Integer => integer(text).is_some(),
            Self::Unsigned => unsigned(text).is_some(),
            Self::Boolean => boolean(text).is_some(),
            Self::DateTime => is_date_time(trim(text)),
            Self::Word(words) => words.contains(&text),
            Self::Unsigneds => unsigneds(text).is_some(),
            Self::Words(words) => items(text).all(|item| words.contains(&item)),
        }
    }

    /// The expected value, for error messages.
    pub fn expected(self) -> String {
        match self {
            Self::Text => "a text".into(),
            Self::Real => "a number".into(),
            Self::Integer => "a whole number of 32 bits".into(),
            Self::Unsigned => "a whole number from 0 to 4294967295".into(),
            Self::Boolean => "true, false, 1 or 0".into(),
            Self::DateTime => "a date and time such as 2026-01-31T12:00:00Z".into(),
            Self::Word(words) => words.join(" or "),
            Self::Unsigneds => "whole numbers separated by spaces".into(),
            Self::Words(words) => format!("{}, separated by spaces", words.join(" or ")),
        }
    }
}

/// Trims white space, which the schema ignores around numbers.
fn trim(text: &str) -> &str {
    text.trim_matches([' ', '\t', '\r', '\n'])
}

/// The items of a space-separated list.
pub fn items(text: &str) -> impl Iterator<Item = &str> {
    text.split([' ', '\t', '\r', '\n'])
        .filter(|item| !item.is_empty())
}

/// Parses an `xs:double`.
pub fn real(text: &str) -> Option<f64> {
    match trim(text) {
        "INF" => Some(f64::INFINITY),
        "-INF" => Some(f64::NEG_INFINITY),
        "NaN" => Some(f64::NAN),
        // Rust also parses inf, infinity and nan.
        text if text.contains(|c: char| !matches!(c, '0'..='9' | '+' | '-' | '.' | 'e' | 'E')) => {
            None
        }
        text => text.parse().ok(),
    }
}

/// Parses an `xs:int`.
pub fn integer(text: &str) -> Option<i32> {
    whole(text)
}

/// Parses a whole number of any of the types.
pub fn whole<T: FromStr>(text: &str) -> Option<T> {
    trim(text).parse().ok()
}

/// Parses an `xs:unsignedInt`.
pub fn unsigned(text: &str) -> Option<u32> {
    trim(text).parse().ok()
}

/// Parses a space-separated list of `xs:unsignedInt`.
pub fn unsigneds(text: &str) -> Option<Vec<u32>> {
    items(text).map(|item| item.parse().ok()).collect()
}

/// Parses an `xs:boolean`.
pub fn boolean(text: &str) -> Option<bool> {
    match trim(text) {
        "true" | "1" => Some(true),
        "false" | "0" => Some(false),
        _ => None,
    }
}

/// `YYYY-MM-DDThh:mm:ss` with an optional fraction and time zone.
fn is_date_time(text: &str) -> bool {
    let digits = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    let within = |part: &str, max: u32| {
        part.len() == 2 && digits(part) && part.parse().is_ok_and(|number: u32| number <= max)
    };
    let clock = |hour: &str, minute: &str| within(hour, 24) && within(minute, 59);
    let Some((date, time)) = text.split_once('T') else {
        return false;
    };
    let date: Vec<&str> = date.trim_start_matches('-').split('-').collect();
    let [year, month, day] = date[..] else {
        return false;
    };
    let (time, zone) = match time.find(['Z', '+', '-']) {
        Some(at) => time.split_at(at),
        None => (time, ""),
    };
    let zone_fits = matches!(zone, "" | "Z")
        || zone
            .trim_start_matches(['+', '-'])
            .split_once(':')
            .is_some_and(|(hour, minute)| clock(hour, minute));
    let (time, fraction) = time.split_once('.').unwrap_or((time, "0"));
    let time: Vec<&str> = time.split(':').collect();
    let [hour, minute, second] = time[..] else {
        return false;
    };
    year.len() >= 4
        && digits(year)
        && within(month, 12)
        && month != "00"
        && within(day, 31)
        && day != "00"
        && clock(hour, minute)
        && within(second, 59)
        && digits(fraction)
        && zone_fits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_follow_the_schema() {
        for good in [
            "0", "-1.5e-3", " 7 ", "INF", "-INF", "NaN", "1E5", ".5", "+1",
        ] {
            assert!(real(good).is_some(), "{good}");
        }
        for bad in ["", "inf", "nan", "1,5", "0x1", "1 2", "e", "1e", "infinity"] {
            assert!(real(bad).is_none(), "{bad}");
        }
        assert_eq!(integer(" -7"), Some(-7));
        assert_eq!(integer("2147483648"), None);
        assert_eq!(unsigned("-1"), None);
        assert_eq!(unsigneds(" 1  2 "), Some(vec![1, 2]));
        assert_eq!(unsigneds(""), Some(vec![]));
        assert_eq!(boolean("True"), None);
    }

    #[test]
    fn dates_follow_the_schema() {
        for good in [
            "2026-01-31T12:00:00Z",
            "2026-01-31T12:00:00",
            "2026-01-31T12:00:00.25Z",
            "2026-01-31T12:00:00+01:00",
            "2026-01-31T12:00:00-11:30",
        ] {
            assert!(is_date_time(good), "{good}");
        }
        for bad in [
            "",
            "T",
            "today",
            "2026-01-31",
            "2026-13-01T12:00:00Z",
            "2026-00-01T12:00:00Z",
            "26-01-31T12:00:00Z",
            "2026-01-31T12:00Z",
            "2026-01-31T12:60:00Z",
            "2026-01-31 12:00:00Z",
            "2026-01-31T12:00:00.Z",
            "2026-01-31T12:00:00ZZ",
            "2026-01-31T12:00:00+0100",
        ] {
            assert!(!is_date_time(bad), "{bad}");
        }
    }
}
