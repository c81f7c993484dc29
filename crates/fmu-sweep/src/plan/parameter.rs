//! A swept parameter: its variables and the values they take.

use std::ops::Range;

use serde::Deserialize;

use super::draw::Draw;
use crate::{Error, Kind, Value};

/// A parameter of a sweep: one or more variables that take the same values.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "Description")]
pub struct Parameter {
    variables: Vec<String>,
    values: Values,
}

#[derive(Debug, Clone, PartialEq)]
enum Values {
    List(Vec<Value>),
    Spaced {
        from: f64,
        to: f64,
        count: u64,
        scale: Scale,
    },
    Uniform([f64; 2]),
    LogUniform([f64; 2]),
    Normal([f64; 2]),
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Scale {
    Linear,
    Log,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    variable: Option<String>,
    variables: Option<Vec<String>>,
    values: Option<List>,
    from: Option<f64>,
    to: Option<f64>,
    count: Option<Count>,
    scale: Option<Scale>,
    uniform: Option<Uniform>,
    log_uniform: Option<LogUniform>,
    normal: Option<Normal>,
}

// The values of keys are checked when they are read, so that an error names its line.

#[derive(Deserialize)]
#[serde(try_from = "Vec<Value>")]
struct List(Vec<Value>);

#[derive(Deserialize)]
#[serde(try_from = "u64")]
struct Count(u64);

#[derive(Deserialize)]
#[serde(try_from = "[f64; 2]")]
struct Uniform([f64; 2]);

#[derive(Deserialize)]
#[serde(try_from = "[f64; 2]")]
struct LogUniform([f64; 2]);

#[derive(Deserialize)]
#[serde(try_from = "[f64; 2]")]
struct Normal([f64; 2]);

/// Bound on the numbers of ranges and distributions, so that no sum of them overflows.
const TOO_LARGE: f64 = 1e290;

impl Parameter {
    /// The variables, at least one.
    #[must_use]
    pub fn variables(&self) -> &[String] {
        &self.variables
    }

    /// The type of its values.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match &self.values {
            Values::List(values) => values[0].kind(),
            _ => Kind::Number,
        }
    }

    /// Whether the values are drawn rather than listed or spaced.
    #[must_use]
    pub fn is_random(&self) -> bool {
        !matches!(self.values, Values::List(_) | Values::Spaced { .. })
    }

    /// The number of grid positions of the parameter, at least 1.
    #[must_use]
    pub fn count(&self) -> u64 {
        match &self.values {
            Values::List(values) => values.len() as u64,
            Values::Spaced { count, .. } => *count,
            _ => 1,
        }
    }

    /// The positions, after the first, of all listed values or of the other end of a range.
    pub(super) fn corners(&self) -> Range<u64> {
        match &self.values {
            Values::Spaced { count, .. } => count - 1..*count,
            _ => 1..self.count(),
        }
    }

    /// The value at a grid position, or the random value of a draw.
    pub(super) fn value(&self, place: u64, draw: impl FnOnce() -> Draw) -> Value {
        Value::Number(match self.values {
            Values::List(ref values) => return values[place as usize].clone(),
            // The exact ends, without the rounding of logarithms and powers.
            Values::Spaced { from, .. } if place == 0 => from,
            Values::Spaced { to, count, .. } if place == count - 1 => to,
            Values::Spaced {
                from,
                to,
                count,
                scale,
            } => {
                let (place, last) = (place as f64, (count - 1) as f64);
                // Multiplying before dividing keeps integers exact and decimal fractions correctly rounded.
                scale.between([from, to], |a, b| (a * (last - place) + b * place) / last)
            }
            Values::Uniform(bounds) => {
                let fraction = draw().fraction();
                Scale::Linear.between(bounds, |a, b| a * (1.0 - fraction) + b * fraction)
            }
            Values::LogUniform(bounds) => {
                let fraction = draw().fraction();
                Scale::Log.between(bounds, |a, b| a * (1.0 - fraction) + b * fraction)
            }
            Values::Normal([mean, deviation]) => mean + deviation * draw().normal(),
        })
    }
}

impl Scale {
    /// A weighted mean of the bounds, or of their logarithms, clamped to the bounds against rounding.
    fn between(self, [min, max]: [f64; 2], mean: impl Fn(f64, f64) -> f64) -> f64 {
        let between = match self {
            Self::Linear => mean(min, max),
            // Decimal logarithms keep powers of ten exact.
            Self::Log => libm::pow(10.0, mean(libm::log10(min), libm::log10(max))),
        };
        between.clamp(min, max)
    }
}

impl TryFrom<Description> for Parameter {
    type Error = Error;

    fn try_from(mut description: Description) -> Result<Self, Error> {
        let variables = match (description.variable.take(), description.variables.take()) {
            (Some(variable), None) => vec![variable],
            (None, Some(variables)) if !variables.is_empty() => variables,
            (None, Some(_)) => {
                return Err(Error::new("variables = [], expected names of variables"));
            }
            (Some(variable), Some(_)) => {
                return Err(Error::new(format!(
                    "{variable}: both variable and variables, expected one of them"
                )));
            }
            (None, None) => {
                return Err(Error::new(
                    "a parameter without variable or variables, expected a name",
                ));
            }
        };
        let values = description
            .values()
            .map_err(|problem| Error::new(format!("{}: {problem}", variables.join(", "))))?;
        Ok(Self { variables, values })
    }
}

impl Description {
    fn values(self) -> Result<Values, String> {
        let spaced = match (self.from, self.to, self.count) {
            (None, None, None) if self.scale.is_none() => None,
            (Some(from), Some(to), Some(count)) => {
                let scale = self.scale.unwrap_or(Scale::Linear);
                Some((from, to, count, scale))
            }
            _ => return Err("part of a range, expected from, to and count".into()),
        };
        match (
            self.values,
            spaced,
            self.uniform,
            self.log_uniform,
            self.normal,
        ) {
            (Some(List(values)), None, None, None, None) => Ok(Values::List(values)),
            (None, Some((from, to, Count(count), scale)), None, None, None) => {
                ordered("from", from, "to", to, scale)?;
                Ok(Values::Spaced {
                    from,
                    to,
                    count,
                    scale,
                })
            }
            (None, None, Some(Uniform(bounds)), None, None) => Ok(Values::Uniform(bounds)),
            (None, None, None, Some(LogUniform(bounds)), None) => Ok(Values::LogUniform(bounds)),
            (None, None, None, None, Some(Normal(numbers))) => Ok(Values::Normal(numbers)),
            (None, None, None, None, None) => Err(format!("no values, expected {ONE_OF}")),
            _ => Err(format!("several ranges of values, expected one: {ONE_OF}")),
        }
    }
}

const ONE_OF: &str = "values, or from, to and count, or uniform, log_uniform or normal";

impl TryFrom<Vec<Value>> for List {
    type Error = String;

    fn try_from(values: Vec<Value>) -> Result<Self, String> {
        let kind = values
            .first()
            .ok_or("values = [], expected at least one")?
            .kind();
        for value in &values {
            match value {
                Value::Number(number) if !number.is_finite() => {
                    return Err(format!("the value {number}, expected finite numbers"));
                }
                Value::Text(text) if text.contains(char::is_control) => {
                    return Err(format!(
                        "the value {text:?}, expected no control characters"
                    ));
                }
                _ if value.kind() != kind => {
                    return Err(format!(
                        "the value {value}, expected {kind} like the first one"
                    ));
                }
                _ => {}
            }
        }
        Ok(Self(values))
    }
}

impl TryFrom<u64> for Count {
    type Error = String;

    fn try_from(count: u64) -> Result<Self, String> {
        if count < 2 {
            return Err(format!("count = {count}, expected at least 2"));
        }
        Ok(Self(count))
    }
}

impl TryFrom<[f64; 2]> for Uniform {
    type Error = String;

    fn try_from(bounds: [f64; 2]) -> Result<Self, String> {
        expect("uniform", bounds, in_range, "numbers within ±1e290")?;
        expect("uniform", bounds, is_ascending, "the smaller one first")?;
        Ok(Self(bounds))
    }
}

impl TryFrom<[f64; 2]> for LogUniform {
    type Error = String;

    fn try_from(bounds: [f64; 2]) -> Result<Self, String> {
        expect("log_uniform", bounds, in_range, "numbers within ±1e290")?;
        expect(
            "log_uniform",
            bounds,
            |[min, _]| min > 0.0,
            "numbers above 0",
        )?;
        expect("log_uniform", bounds, is_ascending, "the smaller one first")?;
        Ok(Self(bounds))
    }
}

impl TryFrom<[f64; 2]> for Normal {
    type Error = String;

    fn try_from(numbers: [f64; 2]) -> Result<Self, String> {
        expect("normal", numbers, in_range, "numbers within ±1e290")?;
        let is_positive = |[_, deviation]: [f64; 2]| deviation > 0.0;
        expect(
            "normal",
            numbers,
            is_positive,
            "a mean and a deviation above 0",
        )?;
        Ok(Self(numbers))
    }
}

fn expect(
    key: &str,
    numbers: [f64; 2],
    is_met: impl Fn([f64; 2]) -> bool,
    expected: &str,
) -> Result<(), String> {
    match is_met(numbers) {
        true => Ok(()),
        false => Err(format!("{key} = {numbers:?}, expected {expected}")),
    }
}

fn in_range(numbers: [f64; 2]) -> bool {
    numbers.iter().all(|number| number.abs() < TOO_LARGE)
}

fn is_ascending([min, max]: [f64; 2]) -> bool {
    min < max
}

fn finite(name: &str, number: f64) -> Result<(), String> {
    if number.abs() < TOO_LARGE {
        return Ok(());
    }
    Err(format!(
        "{name} = {number:?}, expected a number within ±{TOO_LARGE:e}"
    ))
}

/// Checks that the ends of a range are ordered.
fn ordered(first: &str, min: f64, last: &str, max: f64, scale: Scale) -> Result<(), String> {
    finite(first, min)?;
    finite(last, max)?;
    if scale == Scale::Log && min <= 0.0 {
        return Err(format!(
            "{first} = {min:?}, expected more than 0 for logarithms"
        ));
    }
    if min >= max {
        return Err(format!(
            "{last} = {max:?}, expected more than {first} = {min:?}"
        ));
    }
    Ok(())
}
