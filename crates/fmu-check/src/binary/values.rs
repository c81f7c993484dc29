//! The values of variables in a run, and the comparison of runs.

use std::ffi::CString;
use std::fmt;

use anyhow::{Result, bail};
use fmu_description::{FmiVersion, Listed, Type};
use fmu_file::text::quote;
use fmu_host::{Instance, Number};
use serde::{Deserialize, Serialize};

/// Maximum number of values that a run records; longer runs record fewer points.
const MAX_VALUES: usize = 1 << 21;
/// Maximum number of elements of an array that is tested.
pub const MAX_ELEMENTS: usize = 1 << 16;

/// The value of an element of a variable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Value {
    /// A Float32 or Float64.
    Real(f64),
    /// A whole number of any size, or the number of an item.
    Whole(i128),
    /// A Boolean, as the FMU gives it.
    Boolean(i32),
    /// A String.
    Text(String),
}

impl Value {
    /// A start value or bound of the XML; `None` if it is bytes.
    pub fn of(value: &fmu_description::Value) -> Option<Self> {
        use fmu_description::Value as V;
        let number = || value.as_real().map(Self::Real);
        match value {
            V::Boolean(value) => Some(Self::Boolean((*value).into())),
            V::String(text) => Some(Self::Text(text.clone())),
            _ => number().or_else(|| value.as_whole().map(Self::Whole)),
        }
    }

    /// Whether it is the same value, for real numbers up to this difference.
    pub fn is_near(&self, other: &Self, difference: f64) -> bool {
        match (self, other) {
            (Self::Real(a), Self::Real(b)) => {
                a == b || (a - b).abs() <= difference || a.is_nan() && b.is_nan()
            }
            _ => self == other,
        }
    }

    /// The size of a finite real number.
    pub fn size(&self) -> f64 {
        match self {
            Self::Real(value) if value.is_finite() => value.abs(),
            _ => 0.0,
        }
    }

    /// The value with the digits that tell it from all others.
    fn exact(&self) -> String {
        match self {
            Self::Real(value) => format!("{value:?}"),
            _ => self.to_string(),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Real(value) => write!(f, "{value}"),
            Self::Whole(value) => write!(f, "{value}"),
            Self::Boolean(0) => f.write_str("false"),
            Self::Boolean(1) => f.write_str("true"),
            Self::Boolean(value) => write!(f, "{value}, which is not a Boolean"),
            Self::Text(text) => f.write_str(&quote(text)),
        }
    }
}

/// Gets `n` values of variables of one type.
pub fn get(
    instance: &mut Instance,
    (of_type, version): (Type, FmiVersion),
    references: &[u32],
    n: usize,
) -> Result<Vec<Value>> {
    macro_rules! numbers {
        ($type:ty, $value:expr) => {{
            let get = |i: &mut Instance, values: &mut [$type]| Number::get(i, references, values);
            instance.read(n, get)?.into_iter().map($value).collect()
        }};
        ($type:ty) => {
            numbers!($type, |value| Value::Whole(value.into()))
        };
    }
    Ok(match of_type.accessed_as(version) {
        Type::Float64 => numbers!(f64, Value::Real),
        Type::Float32 => numbers!(f32, |value| Value::Real(value.into())),
        Type::Int8 => numbers!(i8),
        Type::UInt8 => numbers!(u8),
        Type::Int16 => numbers!(i16),
        Type::UInt16 => numbers!(u16),
        Type::Int32 => numbers!(i32),
        Type::UInt32 => numbers!(u32),
        Type::Int64 => numbers!(i64),
        Type::UInt64 => numbers!(u64),
        Type::Boolean => {
            let values = instance.read(n, |i, values| i.get_boolean(references, values))?;
            values.into_iter().map(Value::Boolean).collect()
        }
        Type::String => {
            let texts = instance.get_string(references, n)?;
            texts.into_iter().map(Value::Text).collect()
        }
        other => bail!("the type {} is not tested", other.as_str()),
    })
}

/// Sets all elements of a variable. A number that its type does not have becomes 0.
pub fn set(
    instance: &mut Instance,
    (of_type, version): (Type, FmiVersion),
    reference: u32,
    values: &[Value],
) -> fmu_host::Result {
    macro_rules! numbers {
        ($type:ty, $number:expr) => {{
            let numbers: Vec<$type> = values.iter().map($number).collect();
            Number::set(instance, &[reference], &numbers)
        }};
        ($type:ty) => {
            numbers!($type, |value| match value {
                Value::Whole(number) => <$type>::try_from(*number).unwrap_or_default(),
                _ => 0,
            })
        };
    }
    let real = |value: &Value| match value {
        Value::Real(number) => *number,
        _ => 0.0,
    };
    match of_type.accessed_as(version) {
        #[allow(
            clippy::cast_possible_truncation,
            reason = "the type has this precision"
        )]
        Type::Float32 => numbers!(f32, |value| real(value) as f32),
        Type::Int8 => numbers!(i8),
        Type::UInt8 => numbers!(u8),
        Type::Int16 => numbers!(i16),
        Type::UInt16 => numbers!(u16),
        Type::Int32 => numbers!(i32),
        Type::UInt32 => numbers!(u32),
        Type::Int64 => numbers!(i64),
        Type::UInt64 => numbers!(u64),
        Type::Boolean => {
            let is_true = |value: &Value| i32::from(*value == Value::Boolean(1));
            let values: Vec<i32> = values.iter().map(is_true).collect();
            instance.set_boolean(&[reference], &values)
        }
        Type::String => {
            let text = |value: &Value| match value {
                Value::Text(text) => CString::new(text.as_str()).unwrap_or_default(),
                _ => CString::default(),
            };
            let texts: Vec<CString> = values.iter().map(text).collect();
            instance.set_string(&[reference], &texts)
        }
        _ => numbers!(f64, real),
    }
}

/// The values of the observed variables at one time.
pub type Row = Vec<Value>;
/// The rows of a run, with their times.
pub type Trajectory = Vec<(f64, Row)>;

/// Variables that are read together, those of the same type in one call.
pub struct Observed<'a> {
    variables: Vec<&'a Listed<'a>>,
    version: FmiVersion,
    /// The value references and the number of elements of the variables of each type.
    parts: Vec<(Type, Vec<u32>, usize)>,
}

/// A difference between two runs.
pub struct Difference<'a> {
    /// The variable, and the index of the element.
    pub variable: &'a Listed<'a>,
    element: usize,
    time: f64,
    actual: String,
    expected: String,
}

impl<'a> Observed<'a> {
    /// Groups variables by their types.
    pub fn of(variables: impl Iterator<Item = &'a Listed<'a>>, version: FmiVersion) -> Self {
        let accessed = |v: &&Listed<'_>| v.of_type.accessed_as(version) as u8;
        let mut variables: Vec<_> = variables.collect();
        variables.sort_by_key(accessed);
        let parts = variables.chunk_by(|a, b| accessed(a) == accessed(b));
        let parts = parts.map(|part| {
            let count = part.iter().map(|v| v.count()).sum();
            (part[0].of_type, references(part), count)
        });
        Self {
            parts: parts.collect(),
            variables,
            version,
        }
    }

    /// The variables.
    pub fn variables(&self) -> impl Iterator<Item = &'a Listed<'a>> {
        self.variables.iter().copied()
    }

    /// The variables and the indices of their elements, in the order of a row.
    pub fn elements(&self) -> impl Iterator<Item = (&'a Listed<'a>, usize)> {
        let elements = |v: &'a Listed<'a>| (0..v.count()).map(move |element| (v, element));
        self.variables().flat_map(elements)
    }

    /// Every how many steps a run of this many steps is recorded, so that it fits into memory.
    pub fn stride(&self, steps: usize) -> usize {
        let values: usize = self.parts.iter().map(|(_, _, n)| n).sum();
        (steps.saturating_mul(values) / MAX_VALUES).max(1)
    }

    /// Reads the variables.
    pub fn read(&self, instance: &mut Instance) -> Result<Row> {
        let mut row = Row::new();
        for (of_type, references, n) in &self.parts {
            row.append(&mut get(
                instance,
                (*of_type, self.version),
                references,
                *n,
            )?);
        }
        Ok(row)
    }

    /// The first difference of each element between two runs at the same times. Real numbers may differ by the
    /// tolerance, relative to their largest value in the run.
    pub fn differences(
        &self,
        actual: &[(f64, Row)],
        expected: &[(f64, Row)],
        tolerance: f64,
    ) -> impl Iterator<Item = Difference<'a>> {
        self.elements()
            .enumerate()
            .filter_map(move |(at, (variable, element))| {
                let value = |(_, row): &'_ (f64, Row)| row.get(at).map_or(0.0, Value::size);
                let sizes = actual.iter().chain(expected).map(value);
                let difference = tolerance * sizes.fold(1e-9, f64::max);
                actual.iter().zip(expected).find_map(|((time, a), (_, b))| {
                    let (actual, expected) = (a.get(at)?, b.get(at)?);
                    (!actual.is_near(expected, difference)).then(|| Difference {
                        variable,
                        element,
                        time: *time,
                        actual: actual.exact(),
                        expected: expected.exact(),
                    })
                })
            })
    }

    /// The first difference between two runs, as [`Observed::differences`].
    pub fn difference(
        &self,
        actual: &[(f64, Row)],
        expected: &[(f64, Row)],
        tolerance: f64,
    ) -> Option<Difference<'a>> {
        let differences = self.differences(actual, expected, tolerance);
        differences.min_by(|a, b| a.time.total_cmp(&b.time))
    }
}

impl Difference<'_> {
    /// Describes the difference: `when` tells what the actual run does, `like` what the expected run has
    /// done.
    pub fn told(&self, when: &str, like: &str) -> String {
        let name = element_name(self.variable, self.element);
        let (time, actual, expected) = (self.time, &self.actual, &self.expected);
        match self.variable.dimensions.is_empty() {
            true => {
                format!("{when}, {name} at t = {time} s is {actual}, expected {expected}{like}")
            }
            false => format!("{name} has another value {when}, expected {expected}{like}"),
        }
    }
}

/// The value references of variables.
pub fn references(variables: &[&Listed<'_>]) -> Vec<u32> {
    variables.iter().map(|v| v.reference).collect()
}

/// The name of an element of a variable, in quotes.
pub fn element_name(variable: &Listed<'_>, element: usize) -> String {
    quote(&variable.element_name(&variable.name, element))
}
