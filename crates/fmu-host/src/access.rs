//! Access to variables of all types, by the functions of their types.

use std::borrow::Borrow;
use std::ffi::CString;

use fmu_description::{Type, Value};

use crate::instance::{Instance, Number};
use crate::outcome::{Cause, Failure, Result};

/// The operation that gets or sets variables of a type, such as `get_float64`.
pub fn operation(verb: &str, of_type: Type) -> String {
    format!("{verb}_{}", of_type.as_str().to_ascii_lowercase())
}

/// Defines the access to variables of all types.
macro_rules! access {
    ($($real:ident: $real_type:ty),*; $($whole:ident: $whole_type:ty),*; $($_0:tt)*) => {
        impl Instance {
            /// Gets the values of all elements of variables of one type. An Enumeration is accessed as a number. A
            /// Boolean is true unless it is 0.
            ///
            /// # Errors
            /// As for every call, and for Clocks, which are not supported.
            pub fn get_values(&mut self, of_type: Type, r: &[u32], values: &mut [Value]) -> Result {
                let (i, n) = (self, values.len());
                match of_type.accessed_as(i.version()) {
                    $(Type::$real => get_numbers(i, r, values, Value::$real),)*
                    $(Type::$whole => get_numbers(i, r, values, Value::$whole),)*
                    Type::Enumeration => get_numbers(i, r, values, Value::Int64),
                    Type::Boolean => {
                        let mut own = vec![0; n];
                        let got = i.get_boolean(r, &mut own)?;
                        fill(values, own, |value| Value::Boolean(value != 0));
                        Ok(got)
                    }
                    Type::String => {
                        let (got, own) = i.get_string(r, n)?;
                        fill(values, own, Value::String);
                        Ok(got)
                    }
                    Type::Binary => {
                        let (got, own) = i.get_binary(r, n)?;
                        fill(values, own, Value::Binary);
                        Ok(got)
                    }
                    kind => Err(failure(i, "get", kind, Cause::Unsupported)),
                }
            }

            /// Sets the values of all elements of variables of one type.
            ///
            /// # Errors
            /// As for every call, for Clocks, which are not supported, and if a whole number does not
            /// fit the type.
            pub fn set_values(
                &mut self,
                of_type: Type,
                r: &[u32],
                values: &[impl Borrow<Value>],
            ) -> Result {
                let (kind, i) = (of_type.accessed_as(self.version()), self);
                let values = values.iter().map(Borrow::borrow);
                match kind {
                    $(Type::$real => {
                        let own = values.map(|value| value.as_real().unwrap_or_default() as $real_type);
                        Number::set(i, r, &Vec::from_iter(own))
                    })*
                    $(Type::$whole => set_whole::<$whole_type>(i, kind, r, values),)*
                    Type::Enumeration => set_whole::<i64>(i, kind, r, values),
                    Type::Boolean => {
                        let own = values.map(|value| i32::from(*value == Value::Boolean(true)));
                        i.set_boolean(r, &Vec::from_iter(own))
                    }
                    Type::String => {
                        let own = values.map(|value| match value {
                            Value::String(text) => CString::new(text.as_str()).unwrap_or_default(),
                            _ => CString::default(),
                        });
                        i.set_string(r, &Vec::from_iter(own))
                    }
                    Type::Binary => {
                        let own = values.map(|value| match value {
                            Value::Binary(bytes) => bytes.as_slice(),
                            _ => &[],
                        });
                        i.set_binary(r, &Vec::from_iter(own))
                    }
                    kind => Err(failure(i, "set", kind, Cause::Unsupported)),
                }
            }
        }
    };
}
fmu_description::types!(access!);

fn get_numbers<T: Number>(
    i: &mut Instance,
    r: &[u32],
    values: &mut [Value],
    value: fn(T) -> Value,
) -> Result {
    let mut own = vec![T::default(); values.len()];
    let got = T::get(i, r, &mut own)?;
    fill(values, own, value);
    Ok(got)
}

fn fill<T>(values: &mut [Value], own: Vec<T>, value: impl Fn(T) -> Value) {
    for (to, own) in values.iter_mut().zip(own) {
        *to = value(own);
    }
}

fn set_whole<'a, T: Number + TryFrom<i128>>(
    i: &mut Instance,
    kind: Type,
    r: &[u32],
    values: impl Iterator<Item = &'a Value>,
) -> Result {
    let own = values.map(|value| value.as_whole().unwrap_or_default());
    let own = own.map(|value| T::try_from(value).map_err(|_| value));
    match own.collect::<std::result::Result<Vec<T>, i128>>() {
        Ok(own) => T::set(i, r, &own),
        Err(value) => Err(failure(i, "set", kind, Cause::OutOfRange(value))),
    }
}

fn failure(i: &Instance, verb: &str, kind: Type, cause: Cause) -> Failure {
    Failure::new(i.version().function(&operation(verb, kind)).unwrap_or_default(), cause)
}
