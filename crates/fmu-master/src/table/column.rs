//! Columns of a table, and the formats of its file.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, bail};
use fmu_description::{Type, Value};
use serde::{Deserialize, Serialize};

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Column {
    /// Its name, such as `component.variable`.
    pub name: String,
    /// Its unit; empty if it has none.
    pub unit: String,
    /// The type of its values.
    pub kind: Type,
    /// Whether a value may be missing.
    pub optional: bool,
    /// The names of the items of an Enumeration; empty to write only their numbers.
    pub items: Items,
}

/// The names of items by their numbers.
pub type Items = BTreeMap<i64, String>;

/// A value, or the name of the item with this number.
pub(super) fn named(items: &Items, value: Value) -> Value {
    let number = value.as_whole().and_then(|number| i64::try_from(number).ok());
    let name = number.and_then(|number| items.get(&number));
    name.map_or(value, |name| Value::String(name.clone()))
}

/// A value of a row; `None` if it is missing.
pub type Cell = Option<Value>;

impl Column {
    /// A column without missing values.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, kind: Type) -> Self {
        let (name, unit) = (name.into(), unit.into());
        Self { name, unit, kind, optional: false, items: Items::new() }
    }

    /// The same column, in which values may be missing.
    pub fn optional(self) -> Self {
        let optional = true;
        Self { optional, ..self }
    }

    /// Whether it has a Float64 in every row.
    pub(crate) fn is_real(&self) -> bool {
        self.kind == Type::Float64 && !self.optional
    }

    /// A value as people read it: an item by its name, if it has one.
    pub fn named(&self, value: Value) -> Value {
        named(&self.items, value)
    }

    /// Its name in a table.
    pub fn title(&self) -> String {
        match self.unit.as_str() {
            "" => self.name.clone(),
            unit => format!("{} [{unit}]", self.name),
        }
    }

    /// Reads a field.
    pub(crate) fn parse(&self, field: Option<&str>) -> Result<Cell> {
        let value = field.and_then(|text| match self.kind {
            kind if kind.is_float() => Value::real(kind, text.trim().parse().ok()?),
            kind => Value::parse(kind, text).or_else(|| match kind {
                Type::Boolean => boolean(text.trim()).map(Value::Boolean),
                Type::Clock => match Value::parse(Type::Boolean, text.trim()) {
                    Some(Value::Boolean(value)) => Some(Value::Clock(value)),
                    _ => boolean(text.trim()).map(Value::Clock),
                },
                _ => None,
            }),
        });
        if value.is_none() && !(field.is_none() && self.optional) {
            let (name, found) = (&self.name, field.unwrap_or("empty"));
            bail!("{name} is {found}, expected {}", expected(self.kind));
        }
        Ok(value)
    }
}

/// The hexadecimal digits of bytes, in a message that need not have all.
pub fn excerpt(bytes: &[u8]) -> String {
    /// The number of bytes that a message shows.
    const SHOWN: usize = 16;
    match bytes.get(..SHOWN) {
        Some(first) if bytes.len() > SHOWN => {
            format!("{}... ({} bytes)", Value::Binary(first.to_vec()), bytes.len())
        }
        _ => Value::Binary(bytes.to_vec()).to_string(),
    }
}

/// What the values of a type are, in words.
pub(crate) fn expected(kind: Type) -> String {
    let (min, max) = kind.range();
    match kind {
        Type::Boolean | Type::Clock => "true or false".to_owned(),
        Type::String => "a string".to_owned(),
        Type::Binary => "hexadecimal digits".to_owned(),
        kind if kind.is_float() => "a number".to_owned(),
        _ => format!("a whole number from {min} to {max}"),
    }
}

/// A column of a table that was read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Its name, such as `component.variable`.
    pub name: String,
    /// Its unit; empty if it has none.
    pub unit: String,
    /// Its values. Values of CSV are Int64, UInt64, Float64, Boolean or String, whichever the text looks like.
    pub cells: Vec<Cell>,
    /// The names of items, if the file has both them and their numbers; the values are the names.
    pub items: Items,
}

impl Series {
    /// A column with these values.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, cells: Vec<Cell>) -> Self {
        Self { name: name.into(), unit: unit.into(), cells, items: Items::new() }
    }

    /// A column without rows; its title is a name, or a name and a unit, `controller.u [N]`.
    pub(super) fn titled(title: &str) -> Self {
        let title = title.trim();
        let parts = title.strip_suffix(']').and_then(|title| title.rsplit_once(" ["));
        let (name, unit) = parts.unwrap_or((title, ""));
        Self::new(name, unit, Vec::new())
    }

    /// The value of a row as a number, true as 1; `None` if it is missing or a text.
    pub fn number(&self, row: usize) -> Option<f64> {
        number(self.cells.get(row)?)
    }
}

/// A value as a number, true as 1; `None` if it is missing or a text.
pub(super) fn number(cell: &Cell) -> Option<f64> {
    match cell.as_ref()? {
        Value::Boolean(value) | Value::Clock(value) => Some(f64::from(*value)),
        value => value.as_real().or_else(|| value.as_whole().map(|number| number as f64)),
    }
}

/// A Boolean as this program, Python or a spreadsheet writes it.
pub(crate) fn boolean(text: &str) -> Option<bool> {
    match text {
        "true" | "True" | "TRUE" => Some(true),
        "false" | "False" | "FALSE" => Some(false),
        _ => None,
    }
}

/// The format of a table, by the name of its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "see the module of tables")]
pub enum Format {
    Csv,
    Parquet,
}

impl Format {
    /// The format of a file name, `.csv` or `.parquet`; `None` if it has another extension.
    pub fn from_name(file: &Path) -> Option<Self> {
        match &*file.extension()?.to_str()?.to_ascii_lowercase() {
            "csv" => Some(Self::Csv),
            "parquet" => Some(Self::Parquet),
            _ => None,
        }
    }
}
