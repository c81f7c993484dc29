//! A parameter of a sweep, as a `[[parameter]]` in a sweep file has it, and its values.

use std::ops::Range;

use anyhow::{Context, Error, Result, bail, ensure};
use fmu_description::{Type, Value};
use serde::{Deserialize, Deserializer};

use crate::Literal;
use crate::literal::read_checked;
use crate::random::Draw;
use crate::table::expected;

/// A parameter of a sweep: one or more variables that take the same values.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Parameter {
    pub(super) variables: Vec<String>,
    values: ParameterValues,
}

#[derive(Debug, Clone, PartialEq)]
enum ParameterValues {
    List(Vec<Value>),
    /// A list for each variable.
    Together(Vec<Vec<Value>>),
    Spaced {
        from: f64,
        to: f64,
        count: u64,
        scale: Spacing,
    },
    Uniform([f64; 2]),
    LogUniform([f64; 2]),
    Normal([f64; 2]),
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Spacing {
    Linear,
    Log,
}

impl Parameter {
    /// Whether the values are drawn rather than listed or spaced.
    pub(super) fn is_random(&self) -> bool {
        !matches!(
            self.values,
            ParameterValues::List(_)
                | ParameterValues::Together(_)
                | ParameterValues::Spaced { .. }
        )
    }

    /// The number of grid positions of the parameter, at least 1.
    pub(super) fn count(&self) -> u64 {
        match &self.values {
            ParameterValues::List(values) => values.len() as u64,
            ParameterValues::Together(lists) => lists[0].len() as u64,
            ParameterValues::Spaced { count, .. } => *count,
            _ => 1,
        }
    }

    /// The positions, after the first, of all listed values or of the other end of a range.
    pub(super) fn corners(&self) -> Range<u64> {
        match &self.values {
            ParameterValues::Spaced { count, .. } => count - 1..*count,
            _ => 1..self.count(),
        }
    }

    /// The type of the values of a variable.
    pub(super) fn of_type(&self, variable: usize) -> Type {
        match &self.values {
            ParameterValues::List(values) => values[0].of_type(),
            ParameterValues::Together(lists) => lists[variable][0].of_type(),
            _ => Type::Float64,
        }
    }

    /// The value of a variable at a grid position, or the random value of a draw.
    pub(super) fn value(&self, place: u64, variable: usize, draw: &Draw) -> Value {
        Value::Float64(match self.values {
            ParameterValues::List(ref values) => return values[place as usize].clone(),
            ParameterValues::Together(ref lists) => return lists[variable][place as usize].clone(),
            // The exact ends, without the rounding of logarithms and powers.
            ParameterValues::Spaced { from, .. } if place == 0 => from,
            ParameterValues::Spaced { to, count, .. } if place == count - 1 => to,
            ParameterValues::Spaced { from, to, count, scale } => {
                let (place, last) = (place as f64, (count - 1) as f64);
                // Multiplying before dividing keeps integers exact and decimal fractions correctly rounded.
                scale.between([from, to], |a, b| (a * (last - place) + b * place) / last)
            }
            ParameterValues::Uniform(bounds) => Spacing::Linear.drawn(bounds, draw.fraction()),
            ParameterValues::LogUniform(bounds) => Spacing::Log.drawn(bounds, draw.fraction()),
            ParameterValues::Normal([mean, deviation]) => mean + deviation * draw.normal(),
        })
    }
}

impl Spacing {
    /// A weighted mean of the bounds, or of their logarithms, clamped to the bounds against rounding.
    fn between(self, [min, max]: [f64; 2], mean: impl Fn(f64, f64) -> f64) -> f64 {
        let between = match self {
            Self::Linear => mean(min, max),
            // Decimal logarithms keep powers of ten exact.
            Self::Log => libm::pow(10.0, mean(libm::log10(min), libm::log10(max))),
        };
        between.clamp(min, max)
    }

    fn drawn(self, bounds: [f64; 2], fraction: f64) -> f64 {
        self.between(bounds, |a, b| a * (1.0 - fraction) + b * fraction)
    }
}

/// A parameter as the user writes it. The values of keys are checked when they are read, so that an error
/// names its line.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    variable: Option<String>,
    variables: Option<Vec<String>>,
    #[serde(default, deserialize_with = "list")]
    values: Option<Vec<Value>>,
    #[serde(default, deserialize_with = "together")]
    together: Option<Vec<Vec<Value>>>,
    from: Option<f64>,
    to: Option<f64>,
    #[serde(default, deserialize_with = "count")]
    count: Option<u64>,
    scale: Option<Spacing>,
    #[serde(default, deserialize_with = "uniform")]
    uniform: Option<[f64; 2]>,
    #[serde(default, deserialize_with = "log_uniform")]
    log_uniform: Option<[f64; 2]>,
    #[serde(default, deserialize_with = "normal")]
    normal: Option<[f64; 2]>,
}

impl TryFrom<Keys> for Parameter {
    type Error = Error;

    fn try_from(mut keys: Keys) -> Result<Self> {
        let variables = match (keys.variable.take(), keys.variables.take()) {
            (Some(variable), None) => vec![variable],
            (None, Some(variables)) if !variables.is_empty() => variables,
            (None, Some(_)) => bail!("variables = [], expected names of variables"),
            (Some(variable), Some(_)) => {
                bail!("{variable}: both variable and variables, expected one of them")
            }
            (None, None) => bail!("a parameter without variable or variables, expected a name"),
        };
        let values = keys.values();
        let values = values.map_err(|e| Error::msg(format!("{}: {e}", variables.join(", "))))?;
        if let ParameterValues::Together(lists) = &values {
            let (lists, names) = (lists.len(), variables.join(", "));
            ensure!(lists == variables.len(), "{names}: {lists} lists, expected one for each");
        }
        Ok(Self { variables, values })
    }
}

const ONE_OF: &str = "values, or from, to and count, or uniform, log_uniform or normal";

impl Keys {
    fn values(self) -> Result<ParameterValues> {
        let spaced = match (self.from, self.to, self.count) {
            (None, None, None) if self.scale.is_none() => None,
            (Some(from), Some(to), Some(count)) => {
                let scale = self.scale.unwrap_or(Spacing::Linear);
                for (name, end) in [("from", from), ("to", to)] {
                    ensure!(
                        in_range([end; 2]),
                        "{name} = {end:?}, expected a number within ±1e290"
                    );
                }
                ensure!(
                    scale == Spacing::Linear || from > 0.0,
                    "from = {from:?}, expected more than 0 for logarithms"
                );
                ensure!(from < to, "to = {to:?}, expected more than from = {from:?}");
                Some(ParameterValues::Spaced { from, to, count, scale })
            }
            _ => bail!("part of a range, expected from, to and count"),
        };
        let all = [
            self.values.map(ParameterValues::List),
            self.together.map(ParameterValues::Together),
            spaced,
            self.uniform.map(ParameterValues::Uniform),
            self.log_uniform.map(ParameterValues::LogUniform),
            self.normal.map(ParameterValues::Normal),
        ];
        let mut given = all.into_iter().flatten();
        match (given.next(), given.next()) {
            (Some(values), None) => Ok(values),
            (None, _) => bail!("no values, expected {ONE_OF}"),
            _ => bail!("several ranges of values, expected one: {ONE_OF}"),
        }
    }
}

fn list<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<Value>>, D::Error> {
    read_checked(deserializer, |written| Ok(Some(listed(written)?)))
}

fn together<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<Vec<Vec<Value>>>, D::Error> {
    read_checked(deserializer, |lists: Vec<Vec<Literal>>| {
        let lists = lists.into_iter().map(listed).collect::<Result<Vec<_>>>()?;
        let are_same = lists.windows(2).all(|pair| pair[0].len() == pair[1].len());
        ensure!(are_same && !lists.is_empty(), "together, expected lists of the same length");
        Ok(Some(lists))
    })
}

/// Listed values. Whole numbers are real numbers, too, unless one is too large for that.
fn listed(written: Vec<Literal>) -> Result<Vec<Value>> {
    let whole = |value: &Literal| if let Literal::Integer(n) = value { Some(*n) } else { None };
    let is_real = |number: i128| (number as f64) as i128 == number;
    let are_real = written.iter().filter_map(whole).all(is_real);
    let largest = written.iter().filter_map(whole).max().unwrap_or_default();
    let kind = if i64::try_from(largest).is_ok() { Type::Int64 } else { Type::UInt64 };
    let values = written.into_iter().map(|value| match value {
        Literal::Boolean(value) => Ok(Value::Boolean(value)),
        Literal::Integer(number) if are_real => Ok(Value::Float64(number as f64)),
        Literal::Integer(number) => Value::whole(kind, number)
            .with_context(|| format!("the value {number}, expected {}", expected(kind))),
        Literal::Real(number) => Ok(Value::Float64(number)),
        Literal::Text(text) => Ok(Value::String(text)),
        Literal::Bytes(_) | Literal::Array(_) => {
            bail!("expected a number, true, false or a quoted string")
        }
    });
    let values = values.collect::<Result<Vec<_>>>()?;
    let first = values.first();
    let first = first.context("values = [], expected at least one")?;
    for value in &values {
        ensure!(
            value.of_type() == first.of_type(),
            "the value {value}, expected {} like the first one",
            expected(first.of_type())
        );
        match value {
            Value::Float64(number) if !number.is_finite() => {
                bail!("the value {number}, expected finite numbers")
            }
            Value::String(text) if text.contains(char::is_control) => {
                bail!("the value {text:?}, expected no control characters")
            }
            _ => {}
        }
    }
    Ok(values)
}

fn count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
    read_checked(deserializer, |count: u64| {
        ensure!(count >= 2, "count = {count}, expected at least 2");
        Ok(Some(count))
    })
}

fn uniform<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 2]>, D::Error> {
    pair(deserializer, "uniform")
}

fn log_uniform<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 2]>, D::Error> {
    pair(deserializer, "log_uniform")
}

fn normal<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 2]>, D::Error> {
    pair(deserializer, "normal")
}

fn pair<'de, D: Deserializer<'de>>(
    deserializer: D,
    key: &str,
) -> Result<Option<[f64; 2]>, D::Error> {
    read_checked(deserializer, |numbers: [f64; 2]| {
        let [first, second] = numbers;
        let expected = match key {
            _ if !in_range(numbers) => "numbers within ±1e290",
            "log_uniform" if first <= 0.0 => "numbers above 0",
            "normal" if second <= 0.0 => "a mean and a deviation above 0",
            "uniform" | "log_uniform" if first >= second => "the smaller one first",
            _ => return Ok(Some(numbers)),
        };
        bail!("{key} = {numbers:?}, expected {expected}")
    })
}

/// Whether no sum of the numbers overflows.
fn in_range(numbers: [f64; 2]) -> bool {
    numbers.iter().all(|number| number.abs() < 1e290)
}
