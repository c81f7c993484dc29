//! Elements of arguments as JSON: numbers as they are, the others as strings.

use std::collections::HashMap;

use fmu_host::Element;
use serde_json::{Number, Value};

/// The numbers of FMU states by their addresses, from 1.
#[derive(Debug, Default)]
pub(crate) struct States {
    numbers: HashMap<usize, u64>,
    last: u64,
}

impl States {
    /// The number of a state.
    fn number(&mut self, address: usize) -> u64 {
        *self.numbers.entry(address).or_insert_with(|| {
            self.last += 1;
            self.last
        })
    }

    /// Forgets a state that was freed, as another one may get its address.
    pub(crate) fn forget(&mut self, state: &Element) {
        if let Element::State(address) = state {
            self.numbers.remove(address);
        }
    }
}

/// An element as JSON. A number that is not finite is `"NaN"`, `"inf"` or `"-inf"`; bytes are hexadecimal.
pub(crate) fn to_json(element: Element, states: &mut States) -> Value {
    match element {
        Element::Integer(value) => Number::from_i128(value).map_or(Value::Null, Value::Number),
        Element::Float32(value) => real(value.into()),
        Element::Float64(value) => real(value),
        Element::Text(text) => text.map_or(Value::Null, Value::String),
        Element::Bytes(bytes) => bytes.map_or(Value::Null, |bytes| Value::String(hex(&bytes))),
        Element::State(0) => Value::Null,
        Element::State(address) => states.number(address).into(),
    }
}

fn real(value: f64) -> Value {
    Number::from_f64(value).map_or_else(|| Value::String(format!("{value:?}")), Value::Number)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// An element of a type of the rows of `fmi-abi`; `None` if it is of another one.
pub(crate) fn from_json(value: &Value, of_type: &str) -> Option<Element> {
    Some(match (of_type, value) {
        ("f64" | "fmi2EventInfo", Value::String(text)) => Element::Float64(text.parse().ok()?),
        ("f32", Value::String(text)) => Element::Float32(text.parse().ok()?),
        ("f64", Value::Number(number)) => Element::Float64(number.as_f64()?),
        ("f32", Value::Number(number)) => Element::Float32(number.as_f64()? as f32),
        ("fmi2FMUstate" | "fmi3FMUState", Value::Null) => Element::State(0),
        ("fmi2FMUstate" | "fmi3FMUState", Value::Number(number)) => {
            Element::State(number.as_u64()?.try_into().ok()?)
        }
        ("fmi2String" | "fmi3String", Value::Null) => Element::Text(None),
        ("fmi2String" | "fmi3String", Value::String(text)) => Element::Text(Some(text.clone())),
        (_, Value::Null) => Element::Bytes(None),
        (_, Value::String(text)) => Element::Bytes(Some(of_hex(text)?)),
        (_, Value::Number(number)) => match number.as_i128() {
            Some(whole) => Element::Integer(whole),
            None => Element::Float64(number.as_f64()?),
        },
        _ => return None,
    })
}

fn of_hex(text: &str) -> Option<Vec<u8>> {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    text.as_bytes().chunks(2).map(byte).collect()
}
