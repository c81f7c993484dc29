//! The first differences between two tables with a column of times.

use anyhow::{Context, Result, ensure};
use fmu_description::Value;
use serde::{Deserialize, Serialize};

use super::column::{Cell, Series, number};
use super::read::{rounding, times};

/// How far numbers may be apart: `absolute + relative * LARGEST`, with the largest magnitude of the variable
/// in the first table.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Tolerance {
    /// In the unit of the variable.
    pub absolute: f64,
    /// Relative to the largest magnitude.
    pub relative: f64,
}

/// The first time at which a variable differs.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The name of the variable.
    pub name: String,
    /// The time in s.
    pub time: f64,
    /// The values in both tables.
    pub values: [Cell; 2],
    /// How far numbers may be apart.
    pub tolerance: f64,
}

impl Difference {
    /// The difference as a sentence without a full stop, with names of the two tables.
    pub fn describe(&self, tables: &[String; 2]) -> String {
        let Self { name, time, values, tolerance } = self;
        let value = |table: usize| match &values[table] {
            None => format!("missing in {}", tables[table]),
            Some(Value::String(text)) => format!("{text:?} in {}", tables[table]),
            Some(value) => format!("{value} in {}", tables[table]),
        };
        let tolerance = match values {
            [Some(Value::Boolean(_) | Value::String(_)), _] | [_, Some(Value::String(_))] => {
                String::new()
            }
            _ => format!("; tolerance {tolerance:.3e}"),
        };
        format!("{name} differs at t = {time} s: {}, {}{tolerance}", value(0), value(1))
    }
}

/// Compares the variables of the first table, at its times, with those of the second; returns the first
/// difference of each variable, in the order of their times.
///
/// Between two rows of the second table, numbers are interpolated. Those of a column of whole numbers in both
/// tables, or for whose name `holds` is true, keep their value until the next row, as do Booleans and texts.
///
/// # Errors
/// A tolerance is invalid, a table has no times, the first has nothing else, or the second lacks a variable, or
/// has it in another unit, or ends at another time.
pub fn compare(
    [a, b]: [&[Series]; 2],
    tolerance: Tolerance,
    holds: impl Fn(&str) -> bool,
) -> Result<Vec<Difference>> {
    for (name, value) in [("absolute", tolerance.absolute), ("relative", tolerance.relative)] {
        let fits = value.is_finite() && value >= 0.0;
        ensure!(fits, "the {name} tolerance is {value}, expected a finite number of at least 0");
    }
    let of_a = times(a).context("the first table")?;
    let of_b = times(b).context("the second table")?;
    ensure!(a.len() > 1, "the first has no variables to compare, only times");
    let ends = |times: &[f64]| (times[0], times[times.len() - 1]);
    let ((first_a, last_a), (first_b, last_b)) = (ends(&of_a), ends(&of_b));
    let same = rounding(last_a, first_a);
    ensure!(
        (first_a - first_b).abs() <= same && (last_a - last_b).abs() <= same,
        "the first is from {first_a:?} s to {last_a:?} s, the second from {first_b:?} s to {last_b:?} s"
    );
    let mut differences = Vec::new();
    for series in &a[1..] {
        let name = &series.name;
        let other = b[1..].iter().find(|other| other.name == *name);
        let other = other.with_context(|| format!("the second has no variable {name}"))?;
        ensure!(
            series.unit == other.unit || series.unit.is_empty() || other.unit.is_empty(),
            "{name} is in {} in the first, in {} in the second",
            series.unit,
            other.unit
        );
        let numbers = (0..of_a.len()).filter_map(|row| series.number(row));
        let largest = numbers.filter(|number| number.is_finite()).map(f64::abs).fold(0.0, f64::max);
        let tolerance = tolerance.absolute + tolerance.relative * largest;
        let are_booleans = [series, other].iter().any(|s| s.cells.iter().any(is_boolean));
        let is_held = holds(name) || are_booleans || (is_whole(series) && is_whole(other));
        let mut rows = of_a.iter().enumerate();
        differences.extend(rows.find_map(|(row, &time)| {
            // Of several rows at one time, the last has the values after an event.
            if of_a.get(row + 1).is_some_and(|next| next - time <= same) {
                return None;
            }
            let (value, other) = (&series.cells[row], value(other, &of_b, time, same, is_held));
            let differs = !is_equal(value, &other, tolerance);
            let values = [value.clone(), other];
            differs.then(|| Difference { name: name.clone(), time, values, tolerance })
        }));
    }
    differences.sort_by(|a, b| a.time.total_cmp(&b.time));
    Ok(differences)
}

/// Whether no value has a fraction.
fn is_whole(series: &Series) -> bool {
    !series.cells.iter().flatten().any(|value| value.as_real().is_some())
}

/// The value of a variable at a time.
fn value(series: &Series, times: &[f64], time: f64, same: f64, is_held: bool) -> Cell {
    let after = times.partition_point(|other| *other <= time + same);
    let before = after.saturating_sub(1);
    let held = || series.cells[before].clone();
    if is_held || after == times.len() || times[before] >= time - same {
        return held();
    }
    let (Some(left), Some(right)) = (series.number(before), series.number(after)) else {
        return held();
    };
    let part = (time - times[before]) / (times[after] - times[before]);
    Some(Value::Float64(left + part * (right - left)))
}

fn is_equal(a: &Cell, b: &Cell, tolerance: f64) -> bool {
    // Other programs write Booleans as numbers.
    let tolerance = if is_boolean(a) || is_boolean(b) { 0.0 } else { tolerance };
    if let (Some(a), Some(b)) = (whole(a), whole(b)) {
        return (a - b).unsigned_abs() as f64 <= tolerance;
    }
    match (number(a), number(b)) {
        (Some(a), Some(b)) => a == b || (a - b).abs() <= tolerance || (a.is_nan() && b.is_nan()),
        _ => a == b,
    }
}

/// The whole number that a value is, exactly: an `f64` has fewer digits than an Int64.
fn whole(cell: &Cell) -> Option<i128> {
    const LARGEST: f64 = 1e30;
    let value = cell.as_ref()?;
    let is_whole = |real: &f64| real.fract() == 0.0 && real.abs() < LARGEST;
    value.as_whole().or_else(|| value.as_real().filter(is_whole).map(|real| real as i128))
}

fn is_boolean(cell: &Cell) -> bool {
    matches!(cell, Some(Value::Boolean(_)))
}
