//! Checks of a table at compile time, whose panics are compile errors: of each struct where it is derived, and of a
//! model where it is exported.

use crate::ClockType;
use crate::hash::Hash;
use crate::scalar::{ScalarVariable, length, scalar_at, variable_with_hash};
use crate::table::{
    Bounds, Constant, Declaration, Dynamics, MAX_NAME, TableRow, each, have_clocks,
};

/// Checks that the maximum of a variable is not below its minimum.
#[track_caller]
pub const fn check_bounds(rows: &[TableRow], row: usize, message: &str) {
    if let TableRow::Variable(declaration) = &rows[row]
        && !declaration.bounds.have_values()
    {
        panic!("{}", message);
    }
}

/// Checks that a variable may have its start values; `message` is for those outside the bounds.
#[track_caller]
pub const fn check_start(rows: &[TableRow], row: usize, message: &str) {
    if let TableRow::Variable(declaration) = &rows[row] {
        check_start_values(declaration, message);
    }
}

#[track_caller]
pub(crate) const fn check_start_values(declaration: &Declaration, message: &str) {
    let Declaration { start, bounds, .. } = declaration;
    let mut i = 0;
    while i < start.len() && bounds.have_values() {
        let is_allowed = match start.get(i) {
            Constant::Real(value) if value.is_nan() => {
                panic!("a start value is NaN, expected a number")
            }
            Constant::Real(value) if value.is_infinite() => {
                panic!("a start value is infinite, expected a finite number")
            }
            Constant::Real(value) => bounds.contain_real(value),
            Constant::Whole(value) => bounds.contain_whole(value),
            Constant::Bytes(bytes) => bounds.contain_size(bytes.len()),
            _ => true,
        };
        if !is_allowed {
            panic!("{}", message);
        }
        i += 1;
    }
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

/// Checks that the value of an option is positive, and returns the value; otherwise panics at compile time with
/// `message` and the mistake.
#[track_caller]
pub const fn positive(value: f64, message: &str) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        fail(message, "not a positive number");
    }
    value
}

/// As [`positive`], for a value that may be 0.
#[track_caller]
pub const fn not_negative(value: f64, message: &str) -> f64 {
    if !(value >= 0.0 && value.is_finite()) {
        fail(message, "not 0 or a positive number");
    }
    value
}

/// Checks the type of a clock, as far as the macros cannot.
#[track_caller]
pub const fn check_clock(rows: &[TableRow], row: usize) {
    if let TableRow::Variable(declaration) = &rows[row]
        && let Some(clock) = declaration.start.clock()
    {
        check_counters(clock);
    }
}

/// Checks that a clock with a resolution can be told in whole numbers.
#[track_caller]
const fn check_counters(clock: &ClockType) {
    let Some(resolution) = clock.resolution else { return };
    assert!(
        resolution > 0,
        "the resolution of a clock is 0, expected the number of units in a second"
    );
    if let Some(interval) = clock.interval {
        assert!(
            is_multiple(interval, resolution) && is_multiple(clock.shift, resolution),
            "with a resolution, the interval and the shift of a clock are multiples of 1 s / `resolution`"
        );
    }
}

/// Whether a time (s) is a whole number of the units of which a second has so many, up to rounding.
const fn is_multiple(time: f64, resolution: u64) -> bool {
    let units = time * resolution as f64;
    let whole = (units + 0.5) as u64 as f64;
    (units - whole).abs() <= 1e-9 * units
}

/// Checks that a clocked model has a clock.
#[track_caller]
pub const fn has_clocks(rows: &[TableRow], message: &str) {
    if !have_clocks(rows) {
        panic!("{}", message);
    }
}

/// Checks that a nested struct of a model without ticks has no clocks.
#[track_caller]
pub const fn has_no_clocks(rows: &[TableRow], message: &str) {
    if have_clocks(rows) {
        panic!("{}", message);
    }
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

/// Panics with both texts, joined by hand: constant evaluation can format only one.
#[track_caller]
pub const fn fail(message: &str, name: &str) -> ! {
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

/// The name of a variable of the row `group` that has the full name of a variable of the row `other`.
const fn shared_name(
    rows: &'static [TableRow],
    group: usize,
    other: usize,
) -> Option<&'static str> {
    let (first, second) = (name_of_row(&rows[group]), name_of_row(&rows[other]));
    if !have_same_start(first.as_bytes(), second.as_bytes()) {
        return None;
    }
    let (group, other) = (row(rows, group), row(rows, other));
    let mut i = 0;
    while let Some(scalar) = scalar_at(group, i) {
        if variable_with_hash(other, scalar.name_hash(scalar.variable.name)).is_some() {
            return Some(scalar.variable.name);
        }
        i += scalar.variable.element_count();
    }
    None
}

/// The name of a variable, or the prefix of a group, with which the full names in the row begin.
const fn name_of_row(row: &TableRow) -> &'static str {
    match row {
        TableRow::Variable(variable) => variable.name,
        TableRow::Group { prefix, .. } => prefix,
    }
}

/// Whether one text begins with the other.
const fn have_same_start(one: &[u8], other: &[u8]) -> bool {
    match (one, other) {
        ([first, one @ ..], [second, other @ ..]) => {
            *first == *second && have_same_start(one, other)
        }
        _ => true,
    }
}

/// A single row.
const fn row(rows: &'static [TableRow], index: usize) -> &'static [TableRow] {
    rows.split_at(index).1.split_at(1).0
}

/// Fails the compilation if two variables have the same name, a name is too long, a variable depends on one that does
/// not exist, or the integrator of a model would ignore the derivative of an input. The derive macros check the rest.
#[track_caller]
pub const fn check(scalars: &[ScalarVariable], is_integrated: bool) {
    each!(i, scalar in scalars => {
        assert!(
            scalar.last_name_length(scalar.variable.name) <= MAX_NAME,
            "a variable's name has more than 63 characters"
        );
        check_aliases(i, scalars);
        assert!(
            scalar.first_of_name(scalars) == i,
            "two variables have the same name"
        );
        if let Some(names) = scalar.variable.initially_from {
            each!(name in names => {
                assert!(
                    scalar.position(name, scalars) < scalars.len(),
                    "`initially_from` names a variable that does not exist"
                );
            });
        }
        assert!(
            !(is_integrated && scalar.variable.has_input_derivative),
            "an input with the option `derivative` needs a step that uses it: #[model(continuous, step = Self::step)]"
        );
        // Of generic structs, which are not checked where they are derived.
        assert!(
            scalar.variable.bounds.have_values(),
            "the maximum of a variable is below its minimum"
        );
        check_start_values(scalar.variable, "a start value is outside the bounds of its variable");
        if let Some(clock) = scalar.variable.start.clock() {
            check_counters(clock);
        }
        assert!(
            scalar.variable.network.is_empty() || length(&scalar.group_parts()) > 0,
            "the terminal of a network has the name of its struct; expected #[nested] without `flatten` in the model"
        );
        check_dynamics(scalar, scalars);
        check_size(scalar, scalars);
    });
}

/// Fails the compilation if a former name of a variable is too long, or a name of another variable.
#[track_caller]
const fn check_aliases(variable: usize, scalars: &[ScalarVariable]) {
    let scalar = &scalars[variable];
    each!(a, alias in scalar.variable.aliases() => {
        assert!(
            scalar.last_name_length(alias) <= MAX_NAME,
            "an alias has more than 63 characters"
        );
        assert!(
            scalar.position(alias, scalars) == scalars.len(),
            "an alias is the name of a variable"
        );
        each!(i, other in scalars => {
            each!(b, other_alias in other.variable.aliases() => {
                assert!(
                    i == variable && b == a
                        || other.name_hash(other_alias) != scalar.name_hash(alias),
                    "two variables have the same alias"
                );
            });
        });
    });
}

/// Fails the compilation if the number of elements in use of an array is no structural parameter, or may
/// exceed the array.
#[track_caller]
const fn check_size(scalar: &ScalarVariable, scalars: &[ScalarVariable]) {
    let Some(size) = scalar.size_parameter(scalars) else { return };
    assert!(size < scalars.len(), "`size` names a variable that does not exist");
    assert!(
        scalars[size].offset_of_size().is_some(),
        "`size` names a variable that is not a structural parameter"
    );
    if let Bounds::Whole(_, max) = scalars[size].variable.bounds {
        assert!(
            max <= scalar.variable.element_count() as i128,
            "a structural parameter may exceed the size of an array"
        );
    }
}

/// Fails the compilation if a state has no derivative, or a derivative no state.
#[track_caller]
const fn check_dynamics(scalar: &ScalarVariable, scalars: &[ScalarVariable]) {
    match scalar.variable.dynamics {
        Dynamics::State => {
            let hash = scalar.name_hash(scalar.variable.name);
            let mut derivatives = 0;
            each!(_i, other in scalars => {
                if let Dynamics::Derivative { of } = other.variable.dynamics
                    && other.name_hash(of) == hash
                {
                    derivatives += 1;
                }
            });
            assert!(derivatives == 1, "a state needs one field with #[derivative(of = ...)]");
        }
        Dynamics::Derivative { of } => {
            let state = scalar.position(of, scalars);
            assert!(state < scalars.len(), "a derivative of no variable");
            let state = scalars[state].variable;
            assert!(
                matches!(state.dynamics, Dynamics::State),
                "a derivative of a variable that is not a state"
            );
            assert!(
                state.element_count() == scalar.variable.element_count(),
                "a derivative needs as many elements as its state"
            );
        }
        _ => {}
    }
}
