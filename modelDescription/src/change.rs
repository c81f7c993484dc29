//! Changes of variables of a nested struct by the struct that contains it, such as another start value or a unit.

use crate::checks::{check_start_values, fail};
use crate::table::{Bounds, Declaration, TableRow, TypedStart, each};

/// What a variable has instead.
#[derive(Debug, Clone, Copy)]
pub enum Change {
    /// The unit.
    Unit(&'static str),
    /// The minimum.
    Min(f64),
    /// The maximum.
    Max(f64),
    /// Start values of an `f64`, and a single one of an `i32`.
    Numbers(&'static [f64], &'static [i32]),
    /// Start values.
    Booleans(&'static [bool]),
    /// Start values.
    Texts(&'static [&'static str]),
}

/// The `N` rows of a struct with changes of its variables. Those that [`check_change`] refuses have no effect.
pub const fn changed<const N: usize>(
    rows: &'static [TableRow],
    changes: &[(&str, Change)],
) -> [TableRow; N] {
    let Some(rows) = rows.first_chunk() else { panic!("there are not so many rows") };
    let mut rows = *rows;
    each!(change in changes => {
        if let Some(place) = place(&rows, change.0)
            && let TableRow::Variable(mut variable) = rows[place]
            && apply(&mut variable, &change.1).is_ok()
        {
            rows[place] = TableRow::Variable(variable);
        }
    });
    rows
}

/// Checks that the struct has the variable of a change, that the type allows the change, and that the start value is
/// within the bounds after all changes.
#[track_caller]
pub const fn check_change(rows: &'static [TableRow], changes: &[(&str, Change)], index: usize) {
    let name = changes[index].0;
    let Some(place) = place(rows, name) else {
        fail("the nested struct has no variable of its own with the name ", name)
    };
    let TableRow::Variable(mut variable) = rows[place] else { return };
    each!(i, change in changes => {
        if is_equal(change.0.as_bytes(), name.as_bytes())
            && let Err(mistake) = apply(&mut variable, &change.1)
            && i == index
        {
            panic!("{}", mistake);
        }
    });
    check_start_values(&variable, "the start value is outside the bounds of the variable");
}

/// Applies a change, or returns what is wrong.
const fn apply(variable: &mut Declaration, change: &Change) -> Result<(), &'static str> {
    let (count, has_start) = (variable.element_count(), !variable.start.is_empty());
    let given = match (*change, &mut variable.start, &mut variable.bounds) {
        (Change::Unit(unit), TypedStart::Float64(_) | TypedStart::Float32(_), _) => {
            (variable.unit, variable.display_unit) = (unit, "");
            return Ok(());
        }
        (Change::Unit(_), ..) => return Err("only an f64 or f32 has a unit"),
        (Change::Min(bound), _, Bounds::Real(min, _)) => {
            *min = bound;
            return Ok(());
        }
        (Change::Max(bound), _, Bounds::Real(_, max)) => {
            *max = bound;
            return Ok(());
        }
        (Change::Min(_) | Change::Max(_), ..) => return Err("expected a variable of type f64"),
        _ if !has_start => {
            return Err("the variable has no start value, since the model computes it");
        }
        (Change::Numbers(values, _), TypedStart::Float64(start), _) => {
            *start = values;
            values.len()
        }
        (Change::Numbers([number], whole @ [value]), TypedStart::Int32(start), _)
            if *number == *value as f64 =>
        {
            *start = whole;
            1
        }
        (Change::Booleans(values), TypedStart::Boolean(start), _) => {
            *start = values;
            values.len()
        }
        (Change::Texts(values), TypedStart::String(start), _) => {
            *start = values;
            values.len()
        }
        _ => return Err("the variable is of another type; expected an f64, i32, bool or String"),
    };
    if given == count { Ok(()) } else { Err("expected a start value for each element") }
}

/// The index of the row of a variable.
const fn place(rows: &[TableRow], name: &str) -> Option<usize> {
    let mut i = 0;
    while i < rows.len() {
        if let TableRow::Variable(variable) = &rows[i]
            && is_equal(variable.name.as_bytes(), name.as_bytes())
        {
            return Some(i);
        }
        i += 1;
    }
    None
}

const fn is_equal(one: &[u8], other: &[u8]) -> bool {
    match (one, other) {
        ([first, one @ ..], [second, other @ ..]) => *first == *second && is_equal(one, other),
        _ => one.is_empty() && other.is_empty(),
    }
}
