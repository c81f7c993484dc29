//! Access to the variables of a struct, implemented by the derive macros.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::StartValue;
use crate::table::{Domain, Enumeration, Integers, Reals, Row, count};

/// A struct with variables, implemented by `#[derive(Variables)]` and `#[derive(Model)]`.
///
/// Variables are numbered in the order of the fields; an array and a nested struct take as many numbers
/// as they have scalars. The numbers of a model are its value references.
///
/// # Safety
/// The offsets in the table are those of the fields: the derive macros take them from the compiler.
/// A field of a variable whose [`Reals`] are `Float64` is an `f64`, or an array of them, at its offset;
/// that of a structural parameter is a `u64`.
#[allow(
    unsafe_code,
    reason = "a promise of the derive macros; it has no unsafe functions"
)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` has no variables",
    label = "expected a struct with #[derive(Variables)] or #[derive(Model)]"
)]
pub unsafe trait Variables: Sized {
    /// The table.
    const ROWS: &'static [Row];
    /// Number of scalar variables.
    const COUNT: usize = count(Self::ROWS);

    /// The struct with default values in all fields; start values are not set.
    fn unset() -> Self;

    /// Sets all variables that have start values to them.
    fn set_start_values(&mut self);

    /// Copies the variables that the host may set: inputs, parameters and structural parameters.
    fn copy_settable(&mut self, from: &Self);

    /// The variable with the given number.
    fn value(&mut self, index: usize) -> Option<ValueMut<'_>>;

    /// Adds all Real outputs to a sum, which is finite only if each of them is.
    fn add_outputs(&self, sum: f64) -> f64;

    /// The time derivative of an input, if the host may set it.
    fn input_derivative(&mut self, index: usize) -> Option<&mut f64>;

    /// The derivative of a variable with respect to an input or a state. That of an output with respect
    /// to an input of a model that takes steps: the input was held over the last step.
    fn directional_derivative(&self, unknown: usize, known: usize) -> f64;

    /// A copy of all fields.
    fn copy(&self) -> Self;

    /// Copies all fields into this struct, whose memory is used again.
    fn copy_from(&mut self, from: &Self) {
        *self = from.copy();
    }

    /// Saves all fields.
    ///
    /// # Errors
    /// A field cannot be serialized.
    fn save(&self, to: &mut Saver) -> Result<(), Damaged>;

    /// Loads all fields.
    ///
    /// # Errors
    /// The bytes are not those of a saved struct.
    fn load(from: &mut Loader<'_>) -> Result<Self, Damaged>;
}

/// An enum whose variants are the items of an enumeration, implemented by `#[derive(Choice)]`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a type of an FMI variable",
    label = "expected f64, f32, i8 to i64, u8 to u64, bool, String, Vec<u8>, an enum with #[derive(Choice)], or an array such as [f64; 3]",
    note = "a type alias is not recognized; write the type itself"
)]
pub trait Choice: Copy + 'static {
    /// The items.
    const ENUMERATION: Enumeration;
    /// What to add to the discriminant of a variant to get its number.
    const BASE: i32;

    /// The number of the item.
    fn number(self) -> i32;

    /// The item with the given number.
    fn from_number(number: i32) -> Option<Self>;

    /// The first item.
    fn unset() -> Self;

    /// A copy.
    fn copy(&self) -> Self {
        *self
    }

    /// Copies another item.
    fn copy_from(&mut self, from: &Self) {
        *self = *from;
    }

    /// The item as one of any type.
    fn any(&mut self) -> &mut dyn AnyChoice {
        self
    }

    /// Saves the number of the item.
    ///
    /// # Errors
    /// Never, as numbers can be serialized.
    fn save(&self, to: &mut Saver) -> Result<(), Damaged> {
        to.put(&self.number())
    }

    /// Loads an item.
    ///
    /// # Errors
    /// There is no such item.
    fn load(from: &mut Loader<'_>) -> Result<Self, Damaged> {
        Self::from_number(from.take()?).ok_or(Damaged)
    }
}

/// A field that is no variable, or a variable that is no enumeration.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` cannot be a field of a model",
    label = "expected a type with #[derive(Default, Clone, Serialize, Deserialize)]",
    note = "all fields are reset, copied and saved with the FMU's state; a struct with #[derive(Variables)] and #[nested] needs no serde"
)]
pub trait Internal: Sized {
    fn unset() -> Self;
    fn copy(&self) -> Self;
    fn copy_from(&mut self, from: &Self);
    fn save(&self, to: &mut Saver) -> Result<(), Damaged>;
    fn load(from: &mut Loader<'_>) -> Result<Self, Damaged>;
}

#[diagnostic::do_not_recommend]
impl<T: Default + Clone + Serialize + DeserializeOwned> Internal for T {
    fn unset() -> Self {
        Self::default()
    }

    fn copy(&self) -> Self {
        self.clone()
    }

    fn copy_from(&mut self, from: &Self) {
        self.clone_from(from);
    }

    fn save(&self, to: &mut Saver) -> Result<(), Damaged> {
        to.put(self)
    }

    fn load(from: &mut Loader<'_>) -> Result<Self, Damaged> {
        from.take()
    }
}

/// A [`Choice`] of any type.
pub trait AnyChoice {
    /// The number of the item.
    fn get(&self) -> i32;

    /// Sets the item; false if there is none with this number.
    fn set(&mut self, number: i32) -> bool;
}

impl<C: Choice> AnyChoice for C {
    fn get(&self) -> i32 {
        self.number()
    }

    fn set(&mut self, number: i32) -> bool {
        match Self::from_number(number) {
            Some(item) => {
                *self = item;
                true
            }
            None => false,
        }
    }
}

/// A type of variables, except enumerations.
#[doc(hidden)]
pub trait Element: Sized {
    /// Sets the elements of a variable to its start values, if it has any.
    fn set_start_values(elements: &mut [Self], row: &'static Row);

    /// Access to an element.
    fn access(&mut self) -> ValueMut<'_>;
}

/// Implements [`Element`]: the access, and the start values.
macro_rules! elements {
    ($($access:ident($ty:ty) in $domain:pat => $start:ident;)*) => {
        $(
            impl Element for $ty {
                fn set_start_values(elements: &mut [Self], row: &'static Row) {
                    if let Row::Variable(variable) = row && let $domain = variable.domain {
                        for (element, start) in elements.iter_mut().zip($start) {
                            *element = Self::from(*start);
                        }
                    }
                }

                #[inline]
                fn access(&mut self) -> ValueMut<'_> {
                    ValueMut::$access(self)
                }
            }
        )*
    };
}

elements! {
    Real(f64) in Domain::Real { start: Reals::Float64(start), .. } => start;
    Float32(f32) in Domain::Real { start: Reals::Float32(start), .. } => start;
    Int8(i8) in Domain::Integer { start: Integers::Int8(start), .. } => start;
    UInt8(u8) in Domain::Integer { start: Integers::UInt8(start), .. } => start;
    Int16(i16) in Domain::Integer { start: Integers::Int16(start), .. } => start;
    UInt16(u16) in Domain::Integer { start: Integers::UInt16(start), .. } => start;
    Int32(i32) in Domain::Integer { start: Integers::Int32(start), .. } => start;
    UInt32(u32) in Domain::Integer { start: Integers::UInt32(start), .. } => start;
    Int64(i64) in Domain::Integer { start: Integers::Int64(start), .. } => start;
    UInt64(u64) in Domain::Integer { start: Integers::UInt64(start), .. } => start;
    Boolean(bool) in Domain::Boolean { start } => start;
    String(String) in Domain::String { start } => start;
    Binary(Vec<u8>) in Domain::Binary { start, .. } => start;
}

/// Mutable access to a scalar variable.
#[allow(missing_docs, reason = "the types of FMI 3.0")]
pub enum ValueMut<'a> {
    /// A Real, of type Float64.
    Real(&'a mut f64),
    Float32(&'a mut f32),
    Int8(&'a mut i8),
    UInt8(&'a mut u8),
    Int16(&'a mut i16),
    UInt16(&'a mut u16),
    Int32(&'a mut i32),
    UInt32(&'a mut u32),
    Int64(&'a mut i64),
    UInt64(&'a mut u64),
    Boolean(&'a mut bool),
    String(&'a mut String),
    Binary(&'a mut Vec<u8>),
    /// An item of an enumeration.
    Choice(&'a mut dyn AnyChoice),
}

/// The value of a scalar variable.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A real number.
    Real(f64),
    /// A whole number, or the number of an item of an enumeration.
    Integer(i128),
    /// A Boolean.
    Boolean(bool),
    /// A String.
    String(String),
    /// Bytes.
    Binary(Vec<u8>),
}

impl From<StartValue<'_>> for Value {
    fn from(start: StartValue<'_>) -> Self {
        match start {
            StartValue::Real(value) => Self::Real(value),
            StartValue::Integer(value) => Self::Integer(value),
            StartValue::Boolean(value) => Self::Boolean(value),
            StartValue::String(value) => Self::String(value.to_owned()),
            StartValue::Binary(hexadecimal) => Self::Binary(hexadecimal.bytes().collect()),
        }
    }
}

impl ValueMut<'_> {
    /// The value.
    pub fn get(&self) -> Value {
        match self {
            Self::Real(value) => Value::Real(**value),
            Self::Float32(value) => Value::Real(f64::from(**value)),
            Self::Int8(value) => Value::Integer((**value).into()),
            Self::UInt8(value) => Value::Integer((**value).into()),
            Self::Int16(value) => Value::Integer((**value).into()),
            Self::UInt16(value) => Value::Integer((**value).into()),
            Self::Int32(value) => Value::Integer((**value).into()),
            Self::UInt32(value) => Value::Integer((**value).into()),
            Self::Int64(value) => Value::Integer((**value).into()),
            Self::UInt64(value) => Value::Integer((**value).into()),
            Self::Boolean(value) => Value::Boolean(**value),
            Self::String(value) => Value::String((*value).clone()),
            Self::Binary(value) => Value::Binary((*value).clone()),
            Self::Choice(choice) => Value::Integer(choice.get().into()),
        }
    }

    /// Sets the value; false if it has another type, is beyond the range of the type, or is not an item.
    /// A Float32 takes the nearest value.
    pub fn set(self, value: Value) -> bool {
        match (self, value) {
            (Self::Real(variable), Value::Real(value)) => *variable = value,
            (Self::Float32(variable), Value::Real(value)) => {
                let single = value as f32;
                if single.is_finite() != value.is_finite() {
                    return false;
                }
                *variable = single;
            }
            (Self::Int8(variable), Value::Integer(value)) => return put(variable, value),
            (Self::UInt8(variable), Value::Integer(value)) => return put(variable, value),
            (Self::Int16(variable), Value::Integer(value)) => return put(variable, value),
            (Self::UInt16(variable), Value::Integer(value)) => return put(variable, value),
            (Self::Int32(variable), Value::Integer(value)) => return put(variable, value),
            (Self::UInt32(variable), Value::Integer(value)) => return put(variable, value),
            (Self::Int64(variable), Value::Integer(value)) => return put(variable, value),
            (Self::UInt64(variable), Value::Integer(value)) => return put(variable, value),
            (Self::Boolean(variable), Value::Boolean(value)) => *variable = value,
            (Self::String(variable), Value::String(value)) => *variable = value,
            (Self::Binary(variable), Value::Binary(value)) => *variable = value,
            (Self::Choice(choice), Value::Integer(value)) => {
                return i32::try_from(value).is_ok_and(|number| choice.set(number));
            }
            _ => return false,
        }
        true
    }
}

/// Sets a whole number; false if its type does not have the value.
fn put<T: TryFrom<i128>>(variable: &mut T, value: i128) -> bool {
    match T::try_from(value) {
        Ok(value) => {
            *variable = value;
            true
        }
        Err(_) => false,
    }
}

/// The bytes are not those of a saved struct, or a field cannot be saved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Damaged;

/// Collects the fields of a struct as bytes.
#[derive(Debug, Default)]
pub struct Saver(Vec<u8>);

impl Saver {
    /// Adds a field.
    ///
    /// # Errors
    /// It cannot be serialized.
    #[inline(never)] // it is small only once
    pub fn put<T: Serialize>(&mut self, field: &T) -> Result<(), Damaged> {
        let bytes = std::mem::take(&mut self.0);
        self.0 = postcard::to_extend(field, bytes).map_err(|_| Damaged)?;
        Ok(())
    }

    /// The bytes.
    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}

/// Reads the fields of a struct from bytes.
#[derive(Debug)]
pub struct Loader<'a>(&'a [u8]);

impl<'a> Loader<'a> {
    /// Reads from the start of the bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// Reads the next field.
    ///
    /// # Errors
    /// The bytes are not those of a value of this type.
    #[inline(never)]
    pub fn take<T: DeserializeOwned>(&mut self) -> Result<T, Damaged> {
        let (field, rest) = postcard::take_from_bytes(self.0).map_err(|_| Damaged)?;
        self.0 = rest;
        Ok(field)
    }

    /// Reads an array with `item`.
    ///
    /// # Errors
    /// `item` failed.
    pub fn array<T, const N: usize>(
        &mut self,
        mut item: impl FnMut(&mut Self) -> Result<T, Damaged>,
    ) -> Result<[T; N], Damaged> {
        let items: Result<Vec<T>, Damaged> = (0..N).map(|_| item(self)).collect();
        items?.try_into().map_err(|_| Damaged)
    }

    /// Whether all bytes were read.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// What the code of the derive macros uses.
#[doc(hidden)]
pub mod derive {
    pub use super::{Choice, Damaged, Element, Internal, Loader, Saver, ValueMut, Variables};
    pub use crate::Interface;
    use crate::guid::Hash;
    pub use crate::table::{Domain, Dynamics, Enumeration, Integers, Item, Reals, Row, Variable};
    use crate::table::{has_name, shared_name};
    pub use crate::vocabulary::{Causality, Variability};

    /// The elements of an array that are in use.
    #[inline(always)]
    pub fn in_use<T, const N: usize>(array: &[T; N], size: u64) -> &[T] {
        &array[..size.min(N as u64) as usize]
    }

    /// The sum of numbers, as four sums whose additions do not wait for each other.
    #[inline(always)]
    pub fn sum<T: Copy + Into<f64>>(values: &[T]) -> f64 {
        if let Ok(&[a, b, c, d]) = <&[T; 4]>::try_from(values) {
            return (a.into() + c.into()) + (b.into() + d.into()); // without the cost of loops
        }
        let mut sums = [-0.0; 4]; // the neutral element of addition
        let (blocks, rest) = values.as_chunks::<4>();
        for block in blocks {
            sums.iter_mut()
                .zip(block)
                .for_each(|(sum, value)| *sum += (*value).into());
        }
        sums.iter_mut()
            .zip(rest)
            .for_each(|(sum, value)| *sum += (*value).into());
        (sums[0] + sums[2]) + (sums[1] + sums[3])
    }

    /// Checks start values and bounds, and returns the start values; panics with `message` at compile
    /// time.
    #[track_caller]
    pub const fn reals(start: Reals, (min, max): (f64, f64), message: &str) -> Reals {
        let mut i = 0;
        while i < start.len() {
            let value = start.get(i);
            if !(min <= value && value <= max && value.is_finite()) {
                panic!("{}", message);
            }
            i += 1;
        }
        start
    }

    /// As [`reals`].
    #[track_caller]
    pub const fn integers(start: Integers, (min, max): (i128, i128), message: &str) -> Integers {
        let mut i = 0;
        while i < start.len() {
            if !(min <= start.get(i) && start.get(i) <= max) {
                panic!("{}", message);
            }
            i += 1;
        }
        start
    }

    /// Sets enumerations to their start values.
    pub fn set_choices<C>(values: &mut [C], row: &'static Row, item: fn(i32) -> Option<C>) {
        if let Row::Variable(Variable {
            domain: Domain::Enumeration { start, .. },
            ..
        }) = row
        {
            for (value, start) in values.iter_mut().zip(*start) {
                if let Some(item) = item(*start) {
                    *value = item;
                }
            }
        }
    }

    /// Checks that the variables of a group have other names than those of all other rows.
    #[track_caller]
    pub const fn unique(rows: &[Row], group: usize, message: &str) {
        let mut i = 0;
        while i < rows.len() {
            // Two groups are compared once.
            let is_due = i < group || matches!(rows[i], Row::Variable(_)) && i != group;
            if is_due && let Some(name) = shared_name(rows, group, i) {
                fail(message, name);
            }
            i += 1;
        }
    }

    /// Checks that a variable exists.
    #[track_caller]
    pub const fn exists(rows: &[Row], name: &str, message: &str) {
        if !has_name(rows, Hash::new(), Hash::new().bytes(name.as_bytes()).0) {
            panic!("{}", message);
        }
    }

    /// Panics with both texts. Constant evaluation formats one at most.
    #[track_caller]
    const fn fail(message: &str, name: &str) -> ! {
        let mut text = [b' '; 256];
        let mut i = 0;
        while i < message.len() + name.len() && i < text.len() {
            text[i] = match i < message.len() {
                true => message.as_bytes()[i],
                false => name.as_bytes()[i - message.len()],
            };
            i += 1;
        }
        match str::from_utf8(text.split_at(i).0) {
            Ok(text) => panic!("{}", text),
            Err(_) => panic!("{}", message),
        }
    }
}
