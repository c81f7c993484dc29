//! Values as the user writes them, and their conversion to the types of variables.

use std::fmt;

use anyhow::{Context, Result};
use fmu_description::{Type, Value, Variable};
use serde::Deserialize;

/// A value as the user writes it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a number, true, false or a quoted string"
)]
pub enum Written {
    /// `true` or `false`.
    Boolean(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Real(f64),
    /// The name of an enumeration item, a string, or any of the above as text.
    Text(String),
}

impl fmt::Display for Written {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Boolean(value) => value.fmt(f),
            Self::Integer(value) => value.fmt(f),
            Self::Real(value) => write!(f, "{value:?}"),
            Self::Text(value) => write!(f, "{value:?}"),
        }
    }
}

impl Written {
    /// The value in the type of a variable, which is shown to the user as `name`.
    ///
    /// # Errors
    /// The value does not fit the type.
    pub(crate) fn typed(&self, variable: &Variable, name: &str) -> Result<Value> {
        let typed = match (variable.of_type, self) {
            (Type::Boolean, Self::Boolean(value)) => Some(Value::Boolean(*value)),
            (Type::Boolean, Self::Text(text)) => text.parse().ok().map(Value::Boolean),
            (Type::String, Self::Text(text)) => {
                (!text.contains('\0')).then(|| Value::String(text.clone()))
            }
            (Type::Enumeration, Self::Text(text)) => variable.value(text),
            (Type::Enumeration, Self::Integer(number)) => variable.value(&number.to_string()),
            (kind, _) if kind.is_float() => self.real().and_then(|real| Value::real(kind, real)),
            (kind, Self::Integer(number)) => Value::whole(kind, (*number).into()),
            (kind, Self::Text(text)) => text.parse().ok().and_then(|n| Value::whole(kind, n)),
            _ => None,
        };
        typed.with_context(|| {
            let expected = expected(variable);
            format!("{name} = {self} is invalid; expected {expected}")
        })
    }

    fn real(&self) -> Option<f64> {
        match self {
            Self::Real(value) => Some(*value),
            Self::Integer(value) => Some(*value as f64),
            Self::Text(text) => text.parse().ok(),
            Self::Boolean(_) => None,
        }
    }
}

fn expected(variable: &Variable) -> String {
    match variable.of_type {
        kind @ (Type::Binary | Type::Clock) => {
            format!("nothing, as a {} cannot be set", kind.as_str())
        }
        _ => variable.expected(),
    }
}

/// A value as the user would write it, for messages.
pub(crate) fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => format!("{text:?}"),
        value => value.to_string(),
    }
}
