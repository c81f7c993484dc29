//! Literals: values of variables as the user writes them, and how one becomes a value of the type of a variable.

use std::fmt;

use anyhow::{Context, Error, Result, anyhow, ensure};
use fmu_description::{Type, Value, Variable};
use serde::de::{Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use toml::de::ValueDeserializer;

use crate::similar::similar;
use crate::table;

/// A value as the user writes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub enum Literal {
    /// `true` or `false`.
    Boolean(bool),
    /// A whole number of any type.
    Integer(i128),
    /// A number.
    Real(f64),
    /// The name of an enumeration item, a string, or any other value as text.
    Text(String),
    /// The values of an array, row by row.
    Array(Vec<Self>),
    /// Bytes, which only programs give; in files, they are a text of hexadecimal digits.
    Bytes(Vec<u8>),
}

/// Reads a value of a file and converts it, so that an error names its line.
pub(crate) fn read_checked<'de, D: Deserializer<'de>, T: Deserialize<'de>, U>(
    deserializer: D,
    convert: impl FnOnce(T) -> Result<U>,
) -> Result<U, D::Error> {
    convert(T::deserialize(deserializer)?).map_err(D::Error::custom)
}

/// The literal of a value of a sweep.
impl From<&Value> for Literal {
    fn from(value: &Value) -> Self {
        match value {
            // Integer parameters accept it, too.
            Value::Float64(n) if n.fract() == 0.0 && n.abs() < 1e30 => Self::Integer(*n as i128),
            Value::Float64(n) => Self::Real(*n),
            value => Self::Text(value.to_string()),
        }
    }
}

/// Files of the user have the value itself, messages between processes also its kind.
impl<'de> Deserialize<'de> for Literal {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match deserializer.is_human_readable() {
            true => deserializer.deserialize_any(LiteralVisitor),
            false => Self::deserialize(deserializer),
        }
    }
}

impl Serialize for Literal {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

struct LiteralVisitor;

impl<'de> Visitor<'de> for LiteralVisitor {
    type Value = Literal;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, true, false, a quoted string or an array of these")
    }

    fn visit_bool<E>(self, value: bool) -> Result<Literal, E> {
        Ok(Literal::Boolean(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Literal, E> {
        Ok(Literal::Integer(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Literal, E> {
        Ok(Literal::Integer(value.into()))
    }

    fn visit_i128<E>(self, value: i128) -> Result<Literal, E> {
        Ok(Literal::Integer(value))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Literal, E> {
        Ok(Literal::Real(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<Literal, E> {
        Ok(Literal::Text(value.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Literal, A::Error> {
        let values = std::iter::from_fn(|| values.next_element().transpose());
        values.collect::<Result<_, _>>().map(Literal::Array)
    }
}

impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Boolean(value) => value.fmt(f),
            Self::Integer(value) => value.fmt(f),
            Self::Real(value) => write!(f, "{value:?}"),
            Self::Text(value) => write!(f, "{value:?}"),
            Self::Bytes(bytes) => write!(f, "\"{}\"", table::excerpt(bytes)),
            Self::Array(values) => {
                let mut list = f.debug_list();
                for value in values.iter().take(SHOWN) {
                    list.entry(&format_args!("{value}"));
                }
                if values.len() > SHOWN { list.finish_non_exhaustive() } else { list.finish() }
            }
        }
    }
}

/// The number of values of an array that a message shows.
const SHOWN: usize = 8;

impl Literal {
    /// Whether it is an array, maybe as text.
    pub(crate) fn is_array(&self) -> bool {
        match self {
            Self::Array(_) => true,
            Self::Text(text) => text.trim_start().starts_with('['),
            _ => false,
        }
    }

    /// The values of an array with these dimensions, row by row.
    ///
    /// # Errors
    /// It has another shape; the error has both.
    pub(crate) fn elements(&self, dimensions: &[usize], name: &str) -> Result<Vec<Self>> {
        let shape =
            |lengths: &[usize]| Vec::from_iter(lengths.iter().map(usize::to_string)).join(" x ");
        let expected = shape(dimensions);
        if let Self::Text(text) = self {
            let array =
                ValueDeserializer::parse(text).and_then(<Self as Deserialize>::deserialize).ok();
            let array = array.with_context(|| {
                format!("{name} = {self} is invalid; expected an array of {expected} values")
            })?;
            return array.elements(dimensions, name);
        }
        let given = self.shape();
        let values = match &given {
            Some(given) => shape(given),
            None => "lists of different lengths".to_owned(),
        };
        let is_same = given.as_deref() == Some(dimensions);
        ensure!(is_same, "{name} = {self}: values: {values}, expected {expected}");
        let mut values = vec![self.clone()];
        for _ in dimensions {
            let lists = values.into_iter();
            values = lists.flat_map(|v| if let Self::Array(v) = v { v } else { vec![v] }).collect();
        }
        Ok(values)
    }

    /// The lengths of nested arrays; `None` if the lengths of one level differ.
    fn shape(&self) -> Option<Vec<usize>> {
        let Self::Array(values) = self else { return Some(Vec::new()) };
        let mut shapes = values.iter().map(Self::shape);
        let first = shapes.next().unwrap_or_else(|| Some(Vec::new()))?;
        let are_same = shapes.all(|shape| shape.as_ref() == Some(&first));
        are_same.then(|| [vec![values.len()], first].concat())
    }

    /// The value in the type of a variable, which is shown to the user as `name`.
    ///
    /// # Errors
    /// The value does not fit the type.
    pub(crate) fn typed(&self, variable: &Variable, name: &str) -> Result<Value> {
        let typed = match (variable.of_type, self) {
            (Type::Boolean, Self::Boolean(value)) => Some(Value::Boolean(*value)),
            (Type::Boolean, Self::Text(text)) => table::boolean(text).map(Value::Boolean),
            (Type::Clock, Self::Boolean(value)) => Some(Value::Clock(*value)),
            (Type::Clock, Self::Text(text)) => table::boolean(text).map(Value::Clock),
            (Type::String, Self::Text(text)) => {
                (!text.contains('\0')).then(|| Value::String(text.clone()))
            }
            (Type::Binary, Self::Bytes(bytes)) => Some(Value::Binary(bytes.clone())),
            (Type::Binary, Self::Text(text)) => variable.value(text),
            (Type::Enumeration, Self::Text(text)) => variable.value(text),
            (Type::Enumeration, Self::Integer(number)) => variable.value(&number.to_string()),
            (kind, _) if kind.is_float() => self.real().and_then(|real| Value::real(kind, real)),
            (kind, Self::Integer(number)) => Value::whole(kind, *number),
            (kind, Self::Text(text)) => text.parse().ok().and_then(|n| Value::whole(kind, n)),
            _ => None,
        };
        let typed = typed.ok_or_else(|| self.refusal(variable, name))?;
        variable.check_size(&typed).map_err(|found| anyhow!("{name} has {found}"))?;
        Ok(typed)
    }

    /// As [`Literal::typed`], of a value that says by itself whether it is a text: a text is no number.
    pub(crate) fn typed_strictly(&self, variable: &Variable, name: &str) -> Result<Value> {
        let takes_text = matches!(variable.of_type, Type::String | Type::Enumeration);
        match self {
            Self::Text(_) if !takes_text => Err(self.refusal(variable, name)),
            _ => self.typed(variable, name),
        }
    }

    fn refusal(&self, variable: &Variable, name: &str) -> Error {
        match (variable.of_type, self) {
            // As a name of an item would be shown.
            (Type::Enumeration, Self::Integer(_) | Self::Real(_)) => {
                refusal(variable, name, &format!("\"{self}\""), "")
            }
            _ => refusal(variable, name, &self.to_string(), self.text()),
        }
    }

    /// The text, if it is one.
    fn text(&self) -> &str {
        if let Self::Text(text) = self { text } else { "" }
    }

    fn real(&self) -> Option<f64> {
        match self {
            Self::Real(value) => Some(*value),
            Self::Integer(value) => Some(*value as f64),
            Self::Text(text) => text.parse().ok(),
            Self::Boolean(_) | Self::Array(_) | Self::Bytes(_) => None,
        }
    }
}

/// The error of a value, shown in this way, that does not fit the type of a variable. A text may mean an item.
pub(crate) fn refusal(variable: &Variable, name: &str, shown: &str, text: &str) -> Error {
    let expected = match variable.of_type {
        Type::Int32 => "a 32-bit integer".into(),
        Type::String => "a quoted string without null bytes".into(),
        Type::Enumeration => expected_item(variable, text),
        _ => variable.expected(),
    };
    anyhow!("{name} = {shown} is invalid; expected {expected}")
}

/// What is expected of an Enumeration instead of a text, with the items that may be meant.
pub(crate) fn expected_item(variable: &Variable, text: &str) -> String {
    let text = text.to_lowercase();
    let items = variable.items().iter().map(|item| &*item.name);
    let same = Vec::from_iter(items.clone().filter(|name| name.to_lowercase() == text));
    if same.len() > 1 {
        return format!("{} in its case", same.join(" or "));
    }
    let is_similar = |name: &&str| !similar(&text, [&*name.to_lowercase()].into_iter()).is_empty();
    let meant = Vec::from_iter(items.filter(is_similar).take(3)).join(" or ");
    match (variable.expected(), &*meant) {
        (expected, "") => expected,
        (expected, meant) => format!("{expected}; did you mean {meant}?"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_is_written_as_a_list_or_its_text_and_must_have_the_shape() {
        let integer = |n: i128| Literal::Integer(n);
        let text = |text: &str| Literal::Text(text.to_owned());
        let list = Literal::Array(vec![
            Literal::Array(vec![integer(1), integer(2), integer(u64::MAX.into())]),
            Literal::Array(vec![Literal::Real(4.5), Literal::Boolean(true), text("a")]),
        ]);
        let all = Vec::from_iter([1, 2, u64::MAX.into()].map(integer));
        let all = [all, vec![Literal::Real(4.5), Literal::Boolean(true), text("a")]].concat();
        let written = text("[[1, 2, 18446744073709551615], [4.5, true, 'a']]");
        for array in [&list, &written] {
            assert_eq!(array.elements(&[2, 3], "m").unwrap(), all);
        }
        let refused = |value: &Literal| value.elements(&[3, 2], "m").unwrap_err().to_string();
        assert!(refused(&list).ends_with(", \"a\"]]: values: 2 x 3, expected 3 x 2"));
        assert!(refused(&written).ends_with(", \"a\"]]: values: 2 x 3, expected 3 x 2"));
        for (value, reason) in [
            ("[1, 2, 3, 4, 5, 6]", "m = [1, 2, 3, 4, 5, 6]: values: 6, expected 3 x 2"),
            ("[]", "m = []: values: 0, expected 3 x 2"),
            ("[[1], [2, 3], 4]", "values: lists of different lengths, expected 3 x 2"),
            ("[1, 2, 3, 4, 5, 6, 7, 8, 9]", "m = [1, 2, 3, 4, 5, 6, 7, 8, ..]: values: 9,"),
            ("[1", "m = \"[1\" is invalid; expected an array of 3 x 2 values"),
        ] {
            assert!(refused(&text(value)).contains(reason), "{}", refused(&text(value)));
        }
    }

    #[test]
    fn an_item_has_its_name_in_any_case_or_its_number_and_others_are_suggested() {
        let items = [("off", 0), ("On", 1), ("ON", 2), ("linéar", 7)];
        let items = items.map(|(name, value)| {
            let description = String::new();
            fmu_description::EnumerationItem { name: name.into(), value, description }
        });
        let declared = fmu_description::DeclaredType {
            items: items.to_vec(),
            ..fmu_description::DeclaredType::default()
        };
        let variable = Variable {
            of_type: Type::Enumeration,
            declared_type: Some(declared.into()),
            ..Variable::default()
        };
        let typed = |text: &str| Literal::Text(text.into()).typed(&variable, "a");
        for (text, number) in
            [("off", 0), ("OFF", 0), ("On", 1), ("ON", 2), ("LINÉAR", 7), ("7", 7)]
        {
            assert_eq!(typed(text).unwrap(), Value::Enumeration(number));
        }
        let all = "is invalid; expected one of off, On, ON, linéar";
        for (text, reason) in [
            ("on", "a = \"on\" is invalid; expected On or ON in its case".to_owned()),
            ("3", format!("a = \"3\" {all}")),
            ("LINEARS", format!("a = \"LINEARS\" {all}; did you mean linéar?")),
        ] {
            assert_eq!(typed(text).unwrap_err().to_string(), reason);
        }
    }
}
