//! Start values, as written by the user and as typed for FMI.

use std::ffi::CString;

use anyhow::{Result, bail};
use fmu_description::VariableType;
use fmu_description::value::{boolean, real, whole};
use serde::Deserialize;

use crate::Variable;

/// A value as written by the user.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a number, true, false or a quoted string"
)]
pub enum Value {
    /// `true` or `false`.
    Boolean(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Real(f64),
    /// The name of an enumeration item, a string, or any of the above as text.
    Text(String),
}

/// A value with the type of its variable.
#[derive(Debug, Clone, PartialEq)]
pub enum Typed {
    /// Of a Real, Float64 or Float32.
    Real(f64),
    /// Of a whole number of any type, or the value of an Enumeration item.
    Integer(i128),
    /// Of a Boolean.
    Boolean(bool),
    /// Of a String.
    String(CString),
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Boolean(value) => value.fmt(f),
            Self::Integer(value) => value.fmt(f),
            Self::Real(value) => write!(f, "{value:?}"),
            Self::Text(value) => write!(f, "{value:?}"),
        }
    }
}

impl std::fmt::Display for Typed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Real(value) => write!(f, "{value:?}"),
            Self::Integer(value) => value.fmt(f),
            Self::Boolean(value) => value.fmt(f),
            Self::String(value) => write!(f, "{:?}", value.to_string_lossy()),
        }
    }
}

impl Typed {
    /// A start value of a model description; `None` if it is invalid.
    pub(crate) fn parse(access: VariableType, text: &str) -> Option<Self> {
        match access {
            VariableType::Boolean => boolean(text).map(Self::Boolean),
            VariableType::String => CString::new(text).ok().map(Self::String),
            kind if kind.is_float() => real(text).map(Self::Real),
            kind => kind.integer().and_then(|_| whole(text)).map(Self::Integer),
        }
    }
}

impl Value {
    /// Converts to the type of a variable, which is shown to the user as `name`.
    ///
    /// # Errors
    /// The value does not have the type of the variable.
    pub(crate) fn typed(&self, variable: &Variable, name: &str) -> Result<Typed> {
        let typed = match variable.kind {
            VariableType::Boolean => self.boolean().map(Typed::Boolean),
            VariableType::Enumeration => self.item(&variable.items).map(Typed::Integer),
            VariableType::String => match self {
                Self::Text(text) => CString::new(text.as_str()).ok().map(Typed::String),
                _ => None,
            },
            kind if kind.is_float() => self.real().map(Typed::Real),
            kind => kind.integer().and_then(|kind| {
                let (min, max) = kind.range();
                let value = self.integer()?;
                (min..=max)
                    .contains(&value)
                    .then_some(Typed::Integer(value))
            }),
        };
        match typed {
            Some(typed) => Ok(typed),
            None => bail!(
                "{name} = {self} is invalid; expected {}",
                expected(variable)
            ),
        }
    }

    fn real(&self) -> Option<f64> {
        match self {
            Self::Real(value) => Some(*value),
            Self::Integer(value) => Some(*value as f64),
            Self::Text(text) => text.parse().ok(),
            Self::Boolean(_) => None,
        }
    }

    fn integer(&self) -> Option<i128> {
        match self {
            Self::Integer(value) => Some((*value).into()),
            Self::Text(text) => text.parse().ok(),
            Self::Real(_) | Self::Boolean(_) => None,
        }
    }

    fn boolean(&self) -> Option<bool> {
        match self {
            Self::Boolean(value) => Some(*value),
            Self::Text(text) => text.parse().ok(),
            Self::Real(_) | Self::Integer(_) => None,
        }
    }

    /// The value of an enumeration item, given by name or value.
    fn item(&self, items: &[(String, i64)]) -> Option<i128> {
        let by_name = match self {
            Self::Text(text) => items.iter().find(|(name, _)| name == text),
            _ => None,
        };
        let number = by_name
            .map(|(_, number)| i128::from(*number))
            .or_else(|| self.integer())?;
        items
            .iter()
            .any(|(_, known)| i128::from(*known) == number)
            .then_some(number)
    }
}

fn expected(variable: &Variable) -> String {
    match variable.kind {
        VariableType::Integer => "a 32-bit integer".into(),
        VariableType::Boolean => "true or false".into(),
        VariableType::String => "a quoted string without null bytes".into(),
        VariableType::Enumeration => {
            let names: Vec<&str> = variable
                .items
                .iter()
                .map(|(name, _)| name.as_str())
                .collect();
            format!("one of {}", names.join(", "))
        }
        kind if kind.is_float() => "a number".into(),
        kind => match kind.integer() {
            Some(of) => {
                let (min, max) = of.range();
                format!("a whole number from {min} to {max}")
            }
            None => format!("nothing, as a {} cannot be set", kind.as_str()),
        },
    }
}
