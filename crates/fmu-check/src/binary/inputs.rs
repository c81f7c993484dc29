//! The inputs and parameters of test runs: steps, sines and random numbers, the same in every run.

use fmu_description::value::real;
use fmu_description::{Causality, Listed, ModelDescription, Type, Variability};
use serde::{Deserialize, Serialize};

use super::values::Value;

/// How strongly inputs are excited. Models may refuse values outside their range of validity, which
/// their XML need not tell; weaker levels are then tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Level {
    /// Inputs of every type change by half of their start or nominal value.
    Full,
    /// Real inputs change by a fiftieth.
    Gentle,
    /// Inputs keep their start values.
    Still,
}

impl Level {
    /// All levels, the strongest first.
    pub const ALL: [Self; 3] = [Self::Full, Self::Gentle, Self::Still];
}

/// Whether the tests read and set a variable as a scalar: not arrays, Binaries, clocks and structural
/// parameters.
pub fn is_tested(variable: &Listed<'_>) -> bool {
    variable.dimensions.is_empty()
        && !matches!(variable.of_type, Type::Binary | Type::Clock)
        && variable.causality != Causality::StructuralParameter
        && variable.element.attribute("clocks").is_none()
}

/// An input and the range in which it is excited.
pub struct Input<'a> {
    /// The variable.
    pub variable: &'a Listed<'a>,
    index: u64,
    signal: Signal,
}

enum Signal {
    Real {
        start: f64,
        range: (f64, f64),
        size: f64,
    },
    /// Values that follow each other, each for this number of points.
    Choice(Vec<Value>, usize),
}

/// The inputs of a model, but those that keep their start values.
pub fn inputs<'a>(model: &'a ModelDescription<'a>) -> Vec<Input<'a>> {
    let inputs = model.variables().map(|(_, v)| v);
    let inputs = inputs.filter(|v| v.causality == Causality::Input && is_tested(v));
    let inputs = inputs.zip(0..).map(|(variable, index)| Input {
        variable,
        index,
        signal: Signal::of(variable, index),
    });
    inputs.collect()
}

impl Signal {
    fn of(variable: &Listed<'_>, index: u64) -> Self {
        let start = variable.start_of(0).and_then(Value::of);
        match variable.of_type {
            Type::Float32 | Type::Float64 => {
                let start = match start {
                    Some(Value::Real(start)) => start,
                    _ => 0.0,
                };
                let (min, max) = real_range(variable);
                let nominal = variable.inherited("nominal").and_then(real).unwrap_or(1.0);
                let usual = start.abs().max(nominal.abs());
                Self::Real {
                    start,
                    range: (min, max),
                    size: match max - min < 1e3 * usual {
                        true => (max - min) / 2.0,
                        false => usual,
                    },
                }
            }
            Type::Boolean => {
                let start = start.unwrap_or(Value::Boolean(0));
                Self::Choice(near(variable, &start), 11)
            }
            Type::String => Self::Choice(Vec::new(), 1),
            _ => {
                let mut values = near(variable, &start.unwrap_or(Value::Whole(0)));
                let first = (index as usize).checked_rem(values.len());
                values.rotate_left(first.unwrap_or_default());
                Self::Choice(values, 7)
            }
        }
    }
}

impl Input<'_> {
    /// The value at a communication point; `None` if the input keeps its start value.
    pub fn value(&self, level: Level, seed: u64, point: usize) -> Option<Value> {
        match (&self.signal, level) {
            (_, Level::Still) => None,
            (Signal::Real { start, range, size }, level) => {
                let gain = if level == Level::Full { 0.5 } else { 0.02 };
                let value = start + gain * size * signal(seed << 32 | self.index, point);
                // Not `clamp`, since the XML may be wrong about which is larger.
                Some(Value::Real(value.max(range.0).min(range.1)))
            }
            (_, Level::Gentle) => None,
            (Signal::Choice(values, points), Level::Full) => {
                let at = (point / points).checked_rem(values.len())?;
                Some(values[at].clone())
            }
        }
    }

    /// Whether a host may set it in continuous-time mode.
    pub fn is_continuous(&self) -> bool {
        self.variable.of_type.is_float() && self.variable.variability == Variability::Continuous
    }
}

/// The min and max of a real number.
pub fn real_range(variable: &Listed<'_>) -> (f64, f64) {
    let bound = |bound: &Option<fmu_description::Value>| bound.as_ref()?.as_real();
    (
        bound(&variable.min).unwrap_or(f64::NEG_INFINITY),
        bound(&variable.max).unwrap_or(f64::INFINITY),
    )
}

/// Whether the XML allows a value: a real number or whole number in its range, the number of an item.
pub fn allows(variable: &Listed<'_>, value: &Value) -> bool {
    match value {
        Value::Real(value) => {
            let (min, max) = real_range(variable);
            (min..=max).contains(value)
        }
        Value::Whole(value) if variable.of_type == Type::Enumeration => {
            let items = variable.items();
            items.is_empty() || items.iter().any(|item| i128::from(item.value) == *value)
        }
        Value::Whole(value) => {
            let bound = |bound: &Option<fmu_description::Value>| bound.as_ref()?.as_whole();
            let (min, max) = variable.of_type.range();
            let (min, max) = (
                bound(&variable.min).unwrap_or(min),
                bound(&variable.max).unwrap_or(max),
            );
            (min..=max).contains(value)
        }
        Value::Boolean(_) | Value::Text(_) => true,
    }
}

/// Values of a scalar that the XML allows: all items of an Enumeration; of others, the start value and those
/// around it.
fn near(variable: &Listed<'_>, start: &Value) -> Vec<Value> {
    let items = variable.items().iter();
    let mut near: Vec<Value> = match start {
        Value::Whole(_) if variable.of_type == Type::Enumeration => {
            items.map(|item| Value::Whole(item.value.into())).collect()
        }
        Value::Whole(start) => [*start, start + 1, start - 1].map(Value::Whole).into(),
        Value::Boolean(start) => [*start, 1 - start].map(Value::Boolean).into(),
        Value::Text(_) => vec![start.clone(), Value::Text("another text".into())],
        Value::Real(start) => {
            let near = [
                *start,
                1.01 * start,
                0.99 * start,
                start + 0.01,
                start - 0.01,
            ];
            near.map(|value| of_type(variable, value)).into()
        }
    };
    near.retain(|value| allows(variable, value));
    near
}

/// A real number with the precision of a variable.
fn of_type(variable: &Listed<'_>, value: f64) -> Value {
    let single = fmu_description::Value::real(Type::Float32, value);
    let single = single.filter(|_| variable.of_type == Type::Float32);
    Value::Real(single.and_then(|single| single.as_real()).unwrap_or(value))
}

/// Another value of a scalar than its start value, which must be in the XML.
pub fn other(variable: &Listed<'_>) -> Option<Value> {
    let start = Value::of(variable.start_of(0)?)?;
    let mut near = near(variable, &start).into_iter();
    near.find(|value| *value != start)
}

/// A step, a sine and random numbers, between -1 and 1.
fn signal(key: u64, point: usize) -> f64 {
    let period = 41.0 + 7.0 * (key % 16) as f64;
    let sine = (point as f64 / period * std::f64::consts::TAU).sin();
    let step = if point >= 3 { 1.0 } else { 0.0 };
    0.4 * step + 0.3 * sine + 0.3 * noise(key, point as u64)
}

/// A random number between -1 and 1, by SplitMix64.
fn noise(key: u64, point: u64) -> f64 {
    let mut x = key
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .wrapping_add(point.wrapping_mul(0xd1b5_4a32_d192_ed03));
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^= x >> 31;
    (x >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_are_bounded_and_differ() {
        for point in 0..10_000 {
            for key in 0..4 {
                assert!(signal(key, point).abs() <= 1.0);
            }
            assert!(signal(1, point) != signal(2, point));
        }
        let mean = (0..10_000).map(|point| noise(1, point)).sum::<f64>() / 1e4;
        assert!(mean.abs() < 0.02, "{mean}");
    }
}
