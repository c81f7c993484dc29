//! What the derive macros implement for a struct, besides its table.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::table::{Enumeration, TableRow, scalar_count};

/// A struct with variables, implemented by `#[derive(Variables)]` and `#[derive(Model)]`.
///
/// Variables are numbered in the order of the fields; an array and a nested struct take as many numbers
/// as they have scalars. The numbers of a model are its value references.
///
/// # Safety
/// The table has the offsets of the fields: the derive macros take them from the compiler. At the
/// offset of a variable is a value of the type that its [`StartValues`](crate::table::StartValues) have, or an array of them: an `f64` for a
/// `Float64`, a `String` for a `String`, and a value of the enum for an `Enumeration`.
#[allow(unsafe_code, reason = "a promise of the derive macros; it has no unsafe functions")]
#[diagnostic::on_unimplemented(
    message = "`{Self}` has no variables",
    label = "expected a struct with #[derive(Variables)] or #[derive(Model)]"
)]
pub unsafe trait Variables: Sized {
    /// The table.
    const ROWS: &'static [TableRow];
    /// Number of scalar variables.
    const COUNT: usize = scalar_count(Self::ROWS);
    /// Whether a field has the attribute `unsaved`.
    const IS_UNSAVED: bool = false;

    /// The struct with default values in all fields; start values are not set.
    fn unset() -> Self;

    /// Whether all Real outputs are finite, of arrays the elements in use.
    fn has_finite_outputs(&self) -> bool;

    /// The time derivative of an input, if the host may set it.
    fn input_derivative(&mut self, index: usize) -> Option<&mut f64>;

    /// The derivative of a variable with respect to an input or a state. That of an output with respect
    /// to an input of a model that takes steps: the input was held over the last step.
    fn directional_derivative(&self, unknown: usize, known: usize) -> f64;

    /// A copy of all fields; those that are not saved have default values.
    fn copy(&self) -> Self {
        let mut copy = Self::unset();
        copy.copy_from(self);
        copy
    }

    /// Copies all fields that are saved into this struct, whose memory is used again.
    fn copy_from(&mut self, from: &Self);

    /// Saves all fields.
    ///
    /// # Errors
    /// A field cannot be serialized.
    fn save(&self, to: &mut Saver) -> Result<(), Damaged>;

    /// Loads all fields.
    ///
    /// # Errors
    /// The bytes are not a saved struct. Some fields may be loaded.
    fn load(&mut self, from: &mut Loader<'_>) -> Result<(), Damaged>;
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

    /// Copies another item.
    fn copy_from(&mut self, from: &Self) {
        *self = *from;
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
    fn load(&mut self, from: &mut Loader<'_>) -> Result<(), Damaged> {
        *self = Self::from_number(from.take()?).ok_or(Damaged)?;
        Ok(())
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
    fn copy_from(&mut self, from: &Self);
    fn save(&self, to: &mut Saver) -> Result<(), Damaged>;
    fn load(&mut self, from: &mut Loader<'_>) -> Result<(), Damaged>;
}

#[diagnostic::do_not_recommend]
impl<T: Default + Clone + Serialize + DeserializeOwned> Internal for T {
    fn unset() -> Self {
        Self::default()
    }

    fn copy_from(&mut self, from: &Self) {
        self.clone_from(from);
    }

    fn save(&self, to: &mut Saver) -> Result<(), Damaged> {
        to.put(self)
    }

    fn load(&mut self, from: &mut Loader<'_>) -> Result<(), Damaged> {
        *self = from.take()?;
        Ok(())
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
        let item = Self::from_number(number);
        item.map(|item| *self = item).is_some()
    }
}

/// The bytes are not a saved struct, or a field cannot be saved.
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
    /// The bytes are not a value of this type.
    #[inline(never)]
    pub fn take<T: DeserializeOwned>(&mut self) -> Result<T, Damaged> {
        let (field, rest) = postcard::take_from_bytes(self.0).map_err(|_| Damaged)?;
        self.0 = rest;
        Ok(field)
    }

    /// Whether all bytes were read.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// What the code of the derive macros uses.
#[doc(hidden)]
pub mod derive {
    use super::AnyChoice;
    pub use super::{Choice, Damaged, Internal, Loader, Saver, Variables};
    pub use crate::Interface;
    use crate::hash::Hash;
    pub use crate::table::{
        Bounds, Declaration, Dynamics, Enumeration, Item, StartValues, TableRow,
    };
    use crate::table::{Constant, each, scalar_count, shared_name, variable_with_hash};
    pub use crate::vocabulary::{Causality, Variability};

    /// The elements of an array that are in use.
    #[inline(always)]
    pub fn in_use<T, const N: usize>(array: &[T; N], size: u64) -> &[T] {
        &array[..size.min(N as u64) as usize]
    }

    /// Whether a number is finite: its exponent, without the sign before it, is not the largest. Compared as a
    /// whole number, since the result of a comparison of floating-point numbers is known later.
    #[inline(always)]
    pub fn is_finite<T: Copy + Into<f64>>(number: &T) -> bool {
        (*number).into().to_bits() << 1 < f64::INFINITY.to_bits() << 1
    }

    /// Whether all numbers are finite; of few, as networks have, without the cost of a loop.
    #[inline(always)]
    pub fn are_finite<T: Copy + Into<f64>>(numbers: &[T]) -> bool {
        match <&[T; 4]>::try_from(numbers) {
            Ok(few) => few.iter().all(is_finite),
            Err(_) => numbers.iter().all(is_finite),
        }
    }

    /// The number of the first scalar of a row.
    pub const fn first(rows: &[TableRow], row: usize) -> usize {
        scalar_count(rows.split_at(row).0)
    }

    /// A pointer to an item as one to an item of any type.
    pub fn item<C: Choice>(item: *mut u8) -> *mut dyn AnyChoice {
        item.cast::<C>()
    }

    /// Checks that start values are within bounds, and returns them; panics at compile time with `message` and what is
    /// wrong.
    #[track_caller]
    pub const fn checked(start: StartValues, bounds: Bounds, message: &str) -> StartValues {
        let has_values = match bounds {
            Bounds::Real(min, max) => min <= max,
            Bounds::Whole(min, max) => min <= max,
            Bounds::None => true,
        };
        if !has_values {
            fail(message, "impossible, expected a maximum of at least the minimum");
        }
        let mut i = 0;
        while i < start.len() {
            let is_within = match (bounds, start.get(i)) {
                (Bounds::Real(..), Constant::Real(value)) if value.is_nan() => {
                    fail(message, "NaN, expected a number")
                }
                (Bounds::Real(..), Constant::Real(value)) if value.is_infinite() => {
                    fail(message, "infinite, expected a finite number")
                }
                (Bounds::Real(min, max), Constant::Real(value)) => min <= value && value <= max,
                (Bounds::Whole(min, max), Constant::Whole(value)) => min <= value && value <= max,
                _ => true,
            };
            if !is_within {
                fail(message, "outside its bounds");
            }
            i += 1;
        }
        start
    }

    /// Checks that the variables of a group have other names than all other rows.
    #[track_caller]
    pub const fn unique(rows: &'static [TableRow], group: usize, message: &str) {
        each!(i, row in rows => {
            // Two groups are compared once.
            let is_due = i < group || matches!(row, TableRow::Variable(_)) && i != group;
            if is_due && let Some(name) = shared_name(rows, group, i) {
                fail(message, name);
            }
        });
    }

    /// Checks that a variable exists.
    #[track_caller]
    pub const fn exists(rows: &'static [TableRow], name: &str, message: &str) {
        if variable_with_hash(rows, Hash::new().bytes(name.as_bytes()).0).is_none() {
            panic!("{}", message);
        }
    }

    /// Checks that an option is positive, and returns it; panics at compile time with `message` and what is wrong.
    #[track_caller]
    pub const fn positive(value: f64, message: &str) -> f64 {
        if !(value > 0.0 && value.is_finite()) {
            fail(message, "not a positive number");
        }
        value
    }

    /// The number of an item.
    #[track_caller]
    pub const fn number(number: i128) -> i32 {
        assert!(
            i32::MIN as i128 <= number && number <= i32::MAX as i128,
            "the number of an item has more than 32 bits"
        );
        number as i32
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
