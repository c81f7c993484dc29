//! What the derive macros implement for a struct, besides its table.

use serde_core::Serialize;
use serde_core::de::DeserializeOwned;

use crate::clock::Timing;
use crate::scalar::scalar_count;
use crate::state::{StateError, StateReader, StateWriter};
use crate::table::{AnyChoice, Enumeration, TableRow};

/// A struct with variables, implemented by `#[derive(Variables)]` and `#[derive(Model)]`.
///
/// Variables are numbered in the order of the fields; an array and a nested struct take as many numbers
/// as they have scalars. The numbers of a model are its value references.
///
/// # Safety
/// The table has the offsets of the fields: the derive macros take them from the compiler. At the
/// offset of a variable is a value of the type that its [`TypedStart`](crate::table::TypedStart) have, or an array of them: an `f64` for a
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
    /// Whether a field has the attribute `unsaved` or `copied`.
    const IS_UNSERIALIZED: bool = false;
    /// The layout of a saved state: a hash of the names and types of all fields.
    const STATE_LAYOUT: u128;

    /// The struct with default values in all fields; start values are not set.
    fn unset() -> Self;

    /// Whether all Real outputs are finite, of arrays the elements in use.
    fn has_finite_outputs(&self) -> bool;

    /// The time derivative of an input, if the host may set it.
    fn input_derivative(&mut self, index: usize) -> Option<&mut f64>;

    /// The interval and the shift of a clock, by its number, if the model calculates them.
    fn clock_timing(&self, index: usize) -> Option<Timing>;

    /// The derivative of a variable with respect to an input or a state. That of an output with respect
    /// to an input of a model that takes steps: the input was held over the last step.
    fn directional_derivative(&self, unknown: usize, known: usize) -> f64;

    /// A copy of all fields; those that are not copied have default values.
    fn copy(&self) -> Self {
        let mut copy = Self::unset();
        copy.copy_from(self);
        copy
    }

    /// Copies all fields into this struct, whose memory is used again; not those that are `unsaved`.
    fn copy_from(&mut self, from: &Self);

    /// Saves all fields.
    ///
    /// # Errors
    /// A field cannot be serialized.
    fn save(&self, to: &mut StateWriter) -> Result<(), StateError>;

    /// Loads all fields.
    ///
    /// # Errors
    /// The bytes are not a saved struct. Some fields may be loaded.
    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError>;
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
    fn save(&self, to: &mut StateWriter) -> Result<(), StateError> {
        to.put(&self.number())
    }

    /// Loads an item.
    ///
    /// # Errors
    /// There is no such item.
    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        *self = Self::from_number(from.take()?).ok_or(StateError)?;
        Ok(())
    }
}

/// What a field that is no nested struct and no enumeration needs to be created. This trait and the next three stand for
/// one trait each that its type may lack, so that the compiler names this trait and the ways out.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Default`, which gives this field its first value",
    label = "the trait `Default` is missing",
    note = "write the value above the field, as in `#[fresh(Filter::new(0.1))]`; or make it an `Option<...>`, which is `None` until `initialize`; or derive `Default` for a type of your own"
)]
pub trait HasDefault: Sized {
    fn unset() -> Self;
}

#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Clone`, which copies this field with the state of the FMU",
    label = "the trait `Clone` is missing",
    note = "derive `Clone` for a type of your own; or write above the field `#[saved(with = module)]`, to save it by functions of a module, or `#[unsaved]`, if the state of the FMU cannot be saved"
)]
pub trait HasClone {
    fn copy_from(&mut self, from: &Self);
}

#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `serde::Serialize`, which saves this field with the state of the FMU",
    label = "the trait `Serialize` is missing",
    note = "derive it for a type of your own, or use #[derive(Variables)] and #[nested]; the crate of another type often has a feature for it, `serde`",
    note = "or write above the field `#[saved(with = module)]`, to save it by functions of a module; `#[copied]`, if copies within the process are enough; or `#[unsaved]`, if the state of the FMU cannot be saved"
)]
pub trait HasSerialize {
    fn save(&self, to: &mut StateWriter) -> Result<(), StateError>;
}

#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `serde::Deserialize`, which restores this field with the state of the FMU",
    label = "the trait `Deserialize` is missing, or only for borrowed data",
    note = "derive it for a type of your own, or use #[derive(Variables)] and #[nested]; the crate of another type often has a feature for it, `serde`",
    note = "or write above the field `#[saved(with = module)]`, to save it by functions of a module; `#[copied]`, if copies within the process are enough; or `#[unsaved]`, if the state of the FMU cannot be saved"
)]
pub trait HasDeserialize {
    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError>;
}

#[diagnostic::do_not_recommend]
impl<T: Default> HasDefault for T {
    fn unset() -> Self {
        Self::default()
    }
}

#[diagnostic::do_not_recommend]
impl<T: Clone> HasClone for T {
    fn copy_from(&mut self, from: &Self) {
        self.clone_from(from);
    }
}

#[diagnostic::do_not_recommend]
impl<T: Serialize> HasSerialize for T {
    fn save(&self, to: &mut StateWriter) -> Result<(), StateError> {
        to.put(self)
    }
}

#[diagnostic::do_not_recommend]
impl<T: DeserializeOwned> HasDeserialize for T {
    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        *self = from.take()?;
        Ok(())
    }
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
