//! The value references of a model: fixed ones of the author's choice, and the others around them.

use crate::checks::fail;
use crate::hash::Hash;
use crate::scalar::{ScalarVariable, scalar_count, scalars};
use crate::table::{TableRow, each};

/// A value reference that the author has fixed: of a row of the table, or of a variable in it.
#[derive(Debug, Clone, Copy)]
pub struct FixedReference {
    /// The first row.
    pub row: usize,
    /// The number of rows; the structs of an array have one each.
    pub rows: usize,
    /// The full name of a variable in the rows; empty for all their variables, which take consecutive numbers.
    pub name: &'static str,
    /// The value reference of the first scalar.
    pub reference: usize,
}

/// The value references of a model.
#[derive(Debug, Clone, Copy)]
pub struct References {
    /// The value reference of the independent variable of FMI 3.0, which comes last.
    pub time: usize,
    /// All value references of variables are smaller.
    pub end: usize,
}

/// The value reference of the first sample clock of a model: after all variables and the independent variable.
pub const fn first_sample_clock(time: usize, end: usize) -> usize {
    if time < end { end } else { time + 1 }
}

/// The largest fixed value reference of a model of so many scalar variables: tables by value reference stay small.
const fn largest(count: usize) -> usize {
    if 2 * count < 10_000 { 9_999 } else { 2 * count - 1 }
}

/// The end of the value references of a model of so many scalar variables, or a larger number.
pub const fn bound(count: usize, fixed: &[FixedReference]) -> usize {
    let mut end = 0;
    each!(one in fixed => { end = if one.reference >= end { one.reference + 1 } else { end }; });
    count + end
}

/// Gives each variable of a table its value reference, and checks those that are fixed: the others take the free numbers
/// in the order of the variables, and none comes before those that precede it.
#[track_caller]
pub const fn assign(
    scalars: &mut [ScalarVariable],
    rows: &[TableRow],
    fixed: &[FixedReference],
) -> References {
    let count = scalar_count(rows);
    if fixed.is_empty() {
        return References { time: count, end: count };
    }
    let mut i = 0;
    while i < scalars.len() {
        scalars[i].reference = FREE;
        i += 1;
    }
    // A variable with a number of its own is no part of the group that contains it.
    each!(one in fixed => { if !one.name.is_empty() { fix(scalars, rows, one); } });
    each!(one in fixed => { if one.name.is_empty() { fix(scalars, rows, one); } });
    let (mut next, mut end, mut i) = (0, 0, 0);
    while i < scalars.len() {
        let elements = scalars[i].variable.element_count();
        if scalars[i].reference == FREE {
            scalars[i].reference = first_free(scalars, next, elements);
            next = scalars[i].reference + elements;
        }
        let own_end = scalars[i].reference + elements;
        end = if own_end > end { own_end } else { end };
        i += 1;
    }
    References { time: first_free(scalars, next, 1), end }
}

/// The reference of a variable that has none yet.
const FREE: usize = usize::MAX;

/// Gives the variables of a fixed value reference consecutive numbers.
#[track_caller]
const fn fix(scalars: &mut [ScalarVariable], rows: &[TableRow], fixed: &FixedReference) {
    let first = scalar_count(rows.split_at(fixed.row).0);
    let last = first + scalar_count(rows.split_at(fixed.row).1.split_at(fixed.rows).0);
    let name = Hash::new().bytes(fixed.name.as_bytes()).0;
    let (mut next, mut i) = (fixed.reference, 0);
    while i < scalars.len() {
        let scalar = scalars[i];
        let is_inside = first <= scalar.number && scalar.number < last && scalar.reference == FREE;
        if is_inside && (fixed.name.is_empty() || name == scalar.name_hash(scalar.variable.name)) {
            let end = next + scalar.variable.element_count();
            assert!(
                end <= largest(scalar_count(rows)) + 1,
                "the value reference is too large; expected at most 9999, or less than twice the number of scalar variables"
            );
            if let Some(other) = overlapping(scalars, next, end) {
                fail("the value reference is taken by ", other.variable.name);
            }
            scalars[i].reference = next;
            next = end;
        }
        i += 1;
    }
    if next == fixed.reference && !fixed.name.is_empty() {
        fail("a value reference of no variable: ", fixed.name);
    }
}

/// The first number from `next` on from which so many are free.
const fn first_free(scalars: &[ScalarVariable], mut next: usize, elements: usize) -> usize {
    while let Some(other) = overlapping(scalars, next, next + elements) {
        next = other.reference + other.variable.element_count();
    }
    next
}

/// A variable with a value reference in a range.
const fn overlapping(
    scalars: &[ScalarVariable],
    from: usize,
    end: usize,
) -> Option<&ScalarVariable> {
    each!(other in scalars => {
        if other.reference < end && from < other.reference.saturating_add(other.variable.element_count()) {
            return Some(other);
        }
    });
    None
}

/// Checks a fixed value reference of a struct, and those before it.
#[track_caller]
pub const fn check_reference<const N: usize>(
    rows: &'static [TableRow],
    fixed: &[FixedReference],
    index: usize,
) {
    let (mut scalars, length) = scalars::<N>(rows);
    assign(scalars.split_at_mut(length).0, rows, fixed.split_at(index + 1).0);
}
