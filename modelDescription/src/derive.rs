//! What the code of the derive macros uses.

pub use crate::Interface;
pub use crate::change::{Change, changed, check_change};
pub use crate::checks::{
    check_bounds, check_clock, check_start, exists, has_clocks, has_no_clocks, not_negative,
    number, positive, unique,
};
pub use crate::clock::Timing;
pub use crate::clock_type::ClockType;
use crate::hash::Hash;
pub use crate::references::{FixedReference, check_reference};
use crate::scalar::scalar_count;
pub use crate::scalar::variable_count;
pub use crate::state::{StateError, StateReader, StateWriter};
use crate::table::AnyChoice;
pub use crate::table::{
    Bounds, Declaration, Dynamics, Enumeration, History, Item, TableRow, TypedStart,
};
pub use crate::variables::{Choice, HasClone, HasDefault, HasDeserialize, HasSerialize, Variables};
pub use crate::vocabulary::{Causality, IntervalVariability, Naming, OwnCategory, Variability};

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

/// The layout of a saved struct: a hash of the name and the type of each field, and of the layout of the type, if that
/// is known, else 0.
pub const fn state_layout(fields: &[(&str, &str, u128)]) -> u128 {
    let (mut hash, mut i) = (Hash::new(), 0);
    while i < fields.len() {
        let (name, type_name, layout) = fields[i];
        hash = hash.text(name).text(type_name).bytes(&layout.to_le_bytes());
        i += 1;
    }
    hash.0
}

/// The number of the first scalar of a row.
pub const fn first(rows: &[TableRow], row: usize) -> usize {
    scalar_count(rows.split_at(row).0)
}

/// A pointer to an item as a pointer to an item of any type.
pub fn item<C: Choice>(item: *mut u8) -> *mut dyn AnyChoice {
    item.cast::<C>()
}
