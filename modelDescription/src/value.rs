//! Values of variables, each in the type of its variable, and their syntax in a model description.

use std::fmt;
use std::str::FromStr;

use crate::{Number, Type};

/// Defines the values of all types.
macro_rules! values {
    (
        $($real:ident: $real_type:ty),*; $($whole:ident: $whole_type:ty),*; $($other:ident: $other_type:ty),*
    ) => {
        /// The value of a scalar variable, or of an element of an array.
        #[derive(Debug, Clone, PartialEq, PartialOrd)]
        #[cfg_attr(feature = "xml", derive(serde::Serialize, serde::Deserialize))]
        #[allow(missing_docs, reason = "the types of FMI 3.0")]
        pub enum Value {
            $($real($real_type),)*
            $($whole($whole_type),)*
            $($other($other_type),)*
            /// The number of an item.
            Enumeration(i64),
            /// Whether it ticks.
            Clock(bool),
        }

        impl Value {
            /// Its type.
            pub const fn of_type(&self) -> Type {
                match self {
                    $(Self::$real(_) => Type::$real,)*
                    $(Self::$whole(_) => Type::$whole,)*
                    $(Self::$other(_) => Type::$other,)*
                    Self::Enumeration(_) => Type::Enumeration,
                    Self::Clock(_) => Type::Clock,
                }
            }

            /// A whole number as a value of a type of whole numbers, or the number of an item; `None` if the
            /// type does not have it.
            pub fn whole(of_type: Type, number: i128) -> Option<Self> {
                Some(match of_type {
                    $(Type::$whole => Self::$whole(number.try_into().ok()?),)*
                    Type::Enumeration => Self::Enumeration(number.try_into().ok()?),
                    _ => return None,
                })
            }

            /// The whole number, or the number of the item; `None` for other types.
            pub fn as_whole(&self) -> Option<i128> {
                match self {
                    $(Self::$whole(value) => Some((*value).into()),)*
                    Self::Enumeration(value) => Some((*value).into()),
                    _ => None,
                }
            }
        }

        from!($($real: $real_type,)* $($whole: $whole_type,)* $($other: $other_type,)*);

        impl Type {
            /// The smallest and the largest whole number, or number of an item, which is an Int64; for other types,
            /// a range without numbers.
            pub const fn range(self) -> (i128, i128) {
                match self {
                    $(Self::$whole => (<$whole_type>::MIN as i128, <$whole_type>::MAX as i128),)*
                    Self::Enumeration => (i64::MIN as i128, i64::MAX as i128),
                    _ => (1, 0),
                }
            }
        }
    };
}

macro_rules! from {
    ($($name:ident: $type:ty,)*) => { $(
        impl From<$type> for Value {
            fn from(value: $type) -> Self {
                Self::$name(value)
            }
        }
    )* };
}
crate::types!(values!);

impl Value {
    /// A real number as a value of a type of real numbers, rounded for a Float32; `None` for other types,
    /// and if rounding makes it infinite.
    pub fn real(of_type: Type, number: f64) -> Option<Self> {
        match of_type {
            Type::Float32 if (number as f32).is_finite() != number.is_finite() => None,
            Type::Float32 => Some(Self::Float32(number as f32)),
            Type::Float64 => Some(Self::Float64(number)),
            _ => None,
        }
    }

    /// The real number; `None` for other types.
    pub fn as_real(&self) -> Option<f64> {
        match self {
            Self::Float32(value) => Some((*value).into()),
            Self::Float64(value) => Some(*value),
            _ => None,
        }
    }

    /// The value 0, false, or nothing of a type.
    pub fn zero(of_type: Type) -> Self {
        let number = Self::whole(of_type, 0).or_else(|| Self::real(of_type, 0.0));
        number.unwrap_or_else(|| match of_type {
            Type::String => Self::String(String::new()),
            Type::Binary => Self::Binary(Vec::new()),
            _ => Self::Boolean(false),
        })
    }

    /// Parses a value as a model description has it: an item by its number, bytes as hexadecimal digits.
    pub fn parse(of_type: Type, text: &str) -> Option<Self> {
        match of_type {
            Type::Float32 | Type::Float64 => Self::real(of_type, real(text)?),
            Type::Boolean => boolean(text).map(Self::Boolean),
            Type::String => Some(Self::String(text.to_owned())),
            Type::Binary => bytes(text).map(Self::Binary),
            whole_number => Self::whole(whole_number, whole(text)?),
        }
    }
}

/// A whole number of any of the types, to be shown with less code than an `i128`.
pub struct Whole(pub i128);

impl fmt::Display for Whole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        write!(f, "{sign}{}", self.0.unsigned_abs() as u64)
    }
}

/// Shows it as a text that reads back exactly: bytes as hexadecimal digits, an item as its number.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Float32(value) => fmt::Debug::fmt(&Number(*value), f),
            Self::Float64(value) => fmt::Debug::fmt(&Number(*value), f),
            Self::Boolean(value) | Self::Clock(value) => value.fmt(f),
            Self::String(text) => f.write_str(text),
            Self::Binary(bytes) => bytes.iter().try_for_each(|byte| write!(f, "{byte:02x}")),
            number => Whole(number.as_whole().unwrap_or_default()).fmt(f),
        }
    }
}

/// Trims white space, which XML schemas ignore around numbers.
fn trim(text: &str) -> &str {
    text.trim_matches([' ', '\t', '\r', '\n'])
}

/// The items of a space-separated list.
pub fn items(text: &str) -> impl Iterator<Item = &str> {
    text.split([' ', '\t', '\r', '\n']).filter(|item| !item.is_empty())
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

/// Parses a whole number of any of the types.
pub fn whole<T: FromStr>(text: &str) -> Option<T> {
    trim(text).parse().ok()
}

/// Parses a space-separated list of `xs:unsignedInt`.
pub fn unsigneds(text: &str) -> Option<Vec<u32>> {
    items(text).map(whole).collect()
}

/// Parses an `xs:boolean`.
pub fn boolean(text: &str) -> Option<bool> {
    match trim(text) {
        "true" | "1" => Some(true),
        "false" | "0" => Some(false),
        _ => None,
    }
}

/// Parses an `xs:hexBinary`.
pub fn bytes(text: &str) -> Option<Vec<u8>> {
    let (pairs, rest) = trim(text).as_bytes().as_chunks();
    let digit = |c: u8| char::from(c).to_digit(16).map(|digit| digit as u8);
    let byte = |[high, low]: &[u8; 2]| Some(digit(*high)? << 4 | digit(*low)?);
    rest.is_empty().then(|| pairs.iter().map(byte).collect())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_follow_the_schema() {
        for good in ["0", "-1.5e-3", " 7 ", "INF", "-INF", "NaN", "1E5", ".5", "+1"] {
            assert!(real(good).is_some(), "{good}");
        }
        for bad in ["", "inf", "nan", "1,5", "0x1", "1 2", "e", "1e", "infinity"] {
            assert!(real(bad).is_none(), "{bad}");
        }
        assert_eq!(whole(" -7"), Some(-7));
        assert_eq!(whole::<i32>("2147483648"), None);
        assert_eq!(whole::<u32>("-1"), None);
        assert_eq!(unsigneds(" 1  2 "), Some(vec![1, 2]));
        assert_eq!(unsigneds(""), Some(vec![]));
        assert_eq!(boolean("True"), None);
    }

    #[test]
    fn values_keep_their_type_and_all_digits() {
        for (of_type, text, shown) in [
            (Type::Float64, "1e-9", "1e-9"),
            (Type::Float64, " 3", "3.0"),
            (Type::Float32, "0.1", "0.1"),
            (Type::Int64, "9007199254740993", "9007199254740993"),
            (Type::UInt64, "18446744073709551615", "18446744073709551615"),
            (Type::Int8, "-128", "-128"),
            (Type::Enumeration, "5000000000", "5000000000"),
            (Type::Boolean, "1", "true"),
            (Type::String, " a", " a"),
            (Type::Binary, "00Ff", "00ff"),
        ] {
            let value = Value::parse(of_type, text).unwrap();
            assert_eq!((value.of_type(), &*value.to_string()), (of_type, shown));
            assert_eq!(Value::parse(of_type, shown), Some(value));
        }
        for (of_type, text) in [
            (Type::Float32, "1e39"),
            (Type::Int8, "128"),
            (Type::UInt64, "-1"),
            (Type::Int32, "1.5"),
            (Type::Boolean, "yes"),
            (Type::Binary, "f"),
            (Type::Binary, "0g"),
            (Type::Binary, "+1"),
            (Type::Binary, "\u{e9}"),
            (Type::Clock, "true"),
        ] {
            assert_eq!(Value::parse(of_type, text), None, "{text}");
        }
    }
}
