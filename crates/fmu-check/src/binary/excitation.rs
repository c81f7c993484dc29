//! The inputs and parameters of test runs: steps, sines and random numbers, the same in every run.

use std::ops::RangeInclusive;
use std::str::FromStr;

use anyhow::{Result, bail};
use fmu_description::value::{boolean, real};
use fmu_description::{
    Causality, IntegerKind, ModelDescription, ScalarVariable, Variability, VariableType,
};
use fmu_host::Instance;

use super::record::{Class, Value, set};
use super::subject::is_tested;

/// How strongly inputs are excited. Models may refuse values outside their range of validity, which
/// their XML need not tell; weaker levels are then tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Gentle => "gentle",
            Self::Still => "still",
        }
    }

    fn gain(self) -> f64 {
        match self {
            Self::Full => 0.5,
            Self::Gentle => 0.02,
            Self::Still => 0.0,
        }
    }
}

impl FromStr for Level {
    type Err = anyhow::Error;

    fn from_str(name: &str) -> Result<Self> {
        match Self::ALL.into_iter().find(|level| level.name() == name) {
            Some(level) => Ok(level),
            None => bail!("there is no level {name}"),
        }
    }
}

/// An input and the range in which it is excited.
pub struct Input<'a> {
    /// The variable.
    pub variable: &'a ScalarVariable<'a>,
    index: u64,
    signal: Signal,
}

enum Signal {
    Real {
        start: f64,
        min: f64,
        max: f64,
        size: f64,
    },
    Integer(Vec<i64>),
    Boolean(bool),
    /// A String, which keeps its start value.
    None,
}

/// The inputs of a model.
pub fn inputs<'a>(model: &'a ModelDescription<'a>) -> Vec<Input<'a>> {
    model
        .variables()
        .map(|(_, v)| v)
        .filter(|v| v.causality == Causality::Input && is_tested(v))
        .zip(0..)
        .map(|(variable, index)| Input {
            variable,
            index,
            signal: Signal::of(variable),
        })
        .collect()
}

/// The values of the items of an Enumeration.
pub fn numbers(variable: &ScalarVariable<'_>) -> impl Iterator<Item = i64> {
    variable.items().map(|(_, value)| value)
}

/// Parses a whole number.
fn whole(text: &str) -> Option<i64> {
    text.trim().parse().ok()
}

impl Signal {
    fn of(variable: &ScalarVariable<'_>) -> Self {
        let number = |name: &str| variable.inherited(name).and_then(real);
        match Class::of(variable.kind) {
            Class::Real => {
                let start = variable.start().and_then(real).unwrap_or(0.0);
                let (min, max) = (number("min"), number("max"));
                let nominal = number("nominal").unwrap_or(1.0).abs();
                let size = match (min, max) {
                    (Some(min), Some(max)) if max - min < 1e3 * start.abs().max(nominal) => {
                        (max - min) / 2.0
                    }
                    _ => start.abs().max(nominal),
                };
                Self::Real {
                    start,
                    min: min.unwrap_or(f64::NEG_INFINITY),
                    max: max.unwrap_or(f64::INFINITY),
                    size,
                }
            }
            Class::Boolean => Self::Boolean(variable.start().and_then(boolean).unwrap_or(false)),
            Class::Integer if variable.kind == VariableType::Enumeration => {
                Self::Integer(numbers(variable).collect())
            }
            Class::Integer => {
                let start = variable.start().and_then(whole).unwrap_or(0);
                let near = [start, start.saturating_add(1), start.saturating_sub(1)];
                let range = integer_range(variable);
                Self::Integer(
                    near.into_iter()
                        .filter(|value| range.contains(value))
                        .collect(),
                )
            }
            Class::String | Class::Other => Self::None,
        }
    }
}

impl Input<'_> {
    /// Sets the input to its value at a communication point.
    pub fn set(
        &self,
        instance: &mut Instance,
        level: Level,
        seed: u64,
        point: usize,
    ) -> Result<()> {
        let key = seed << 32 | self.index;
        let value = match &self.signal {
            _ if level == Level::Still => return Ok(()),
            Signal::Real {
                start,
                min,
                max,
                size,
            } => {
                let value = start + level.gain() * size * signal(key, point);
                // Not `clamp`, since the XML may be wrong about which is larger.
                Value::Real(value.max(*min).min(*max))
            }
            _ if level == Level::Gentle => return Ok(()),
            Signal::Integer(values) if values.is_empty() => return Ok(()),
            Signal::Integer(values) => {
                Value::Integer(values[(point / 7 + self.index as usize) % values.len()])
            }
            Signal::Boolean(start) => Value::Boolean((*start != ((point / 11) % 2 == 1)).into()),
            Signal::None => return Ok(()),
        };
        set(instance, self.variable, &value)?;
        Ok(())
    }

    /// Whether a host may set it in continuous-time mode.
    pub fn is_continuous(&self) -> bool {
        Class::of(self.variable.kind) == Class::Real
            && self.variable.variability == Variability::Continuous
    }
}

/// The values between the min and max of an Integer, which are those of its type by default; of a
/// UInt64, whose values are read as those of an Int64, all.
pub fn integer_range(variable: &ScalarVariable<'_>) -> RangeInclusive<i64> {
    if variable.kind == VariableType::UInt64 {
        return i64::MIN..=i64::MAX;
    }
    let kind = IntegerKind::parse(variable.kind.as_str()).unwrap_or(IntegerKind::Int32);
    let (min, max) = kind.range();
    let of_type = |bound: i128| i64::try_from(bound).unwrap_or(i64::MAX);
    let bound = |name: &str| variable.inherited(name).and_then(whole);
    bound("min").unwrap_or(of_type(min))..=bound("max").unwrap_or(of_type(max))
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

/// A value near the start value of a parameter or input, which is still inside its bounds.
fn other_real(variable: &ScalarVariable<'_>) -> Option<f64> {
    let start = variable.start().and_then(real)?;
    let number = |name: &str| variable.inherited(name).and_then(real);
    let near = [1.01 * start, 0.99 * start, start + 0.01, start - 0.01];
    let of_type = |value: f64| match variable.kind {
        #[allow(
            clippy::cast_possible_truncation,
            reason = "the type has this precision"
        )]
        VariableType::Float32 => f64::from(value as f32),
        _ => value,
    };
    near.into_iter().map(of_type).find(|value| {
        *value != start
            && number("min").is_none_or(|min| *value >= min)
            && number("max").is_none_or(|max| *value <= max)
    })
}

/// Another value of the type of a variable that its XML allows.
pub fn other(variable: &ScalarVariable<'_>) -> Option<Value> {
    Some(match Class::of(variable.kind) {
        Class::Real => Value::Real(other_real(variable)?),
        Class::Integer => {
            let start = variable.start().and_then(whole)?;
            let Signal::Integer(values) = Signal::of(variable) else {
                return None;
            };
            // A UInt64 has no negative values.
            let fits = |value: &i64| *value != start && (start < 0 || *value >= 0);
            Value::Integer(values.into_iter().find(fits)?)
        }
        Class::Boolean => Value::Boolean((!variable.start().and_then(boolean)?).into()),
        Class::String => Value::String("another text".into()),
        Class::Other => return None,
    })
}

/// Changes the Real parameters of a new instance by a little.
pub fn change_parameters(model: &ModelDescription<'_>, instance: &mut Instance) -> Result<()> {
    for (_, variable) in model.variables() {
        if variable.causality == Causality::Parameter
            && is_tested(variable)
            && Class::of(variable.kind) == Class::Real
            && let Some(value) = other(variable)
        {
            set(instance, variable, &value)?;
        }
    }
    Ok(())
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
