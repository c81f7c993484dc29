//! The values of variables: of runs, which are compared, and values that tests set, the same in every
//! run.

use anyhow::{Result, bail};
use fmu_description::value::real;
use fmu_description::{Causality, FmiVersion, ModelDescription, Type, Value, XmlVariable};
use fmu_file::text::quote;
use fmu_host::{Instance, Success};

use crate::rules::{is_clocked, is_continuous};

/// Maximum number of values that a run records; longer runs record fewer points.
const MAX_VALUES: usize = 1 << 21;
/// Maximum number of elements of an array that is tested, and of those of an input that change in a run.
pub const MAX_ELEMENTS: usize = 1 << 16;
const MAX_EXCITED: usize = 1000;

/// Gets `n` values of variables of one type. A Boolean that is neither 0 nor 1 stays a number.
pub fn get(
    instance: &mut Instance,
    of_type: Type,
    references: &[u32],
    n: usize,
) -> fmu_host::Result<Vec<Value>> {
    if of_type == Type::Boolean {
        let given = instance.read(n, |i, values| i.get_boolean(references, values))?;
        let value = |given| match given {
            0 | 1 => Value::Boolean(given == 1),
            _ => Value::Int32(given),
        };
        return Ok(given.into_iter().map(value).collect());
    }
    let mut values = vec![Value::Boolean(false); n];
    instance.get_values(of_type, references, &mut values)?;
    Ok(values)
}

/// Whether two values are the same, real numbers up to this difference.
pub fn is_near(a: &Value, b: &Value, difference: f64) -> bool {
    match (a.as_real(), b.as_real()) {
        (Some(a), Some(b)) => a == b || (a - b).abs() <= difference || a.is_nan() && b.is_nan(),
        // The item of an Enumeration is accessed as a number.
        _ => a == b || a.as_whole().is_some() && a.as_whole() == b.as_whole(),
    }
}

/// The size of a finite real number.
pub fn size(value: &Value) -> f64 {
    let number = value.as_real().filter(|number| number.is_finite());
    number.map_or(0.0, f64::abs)
}

/// A value for messages.
pub fn shown(value: &Value) -> String {
    match value {
        Value::Float32(value) => value.to_string(),
        Value::Float64(value) => value.to_string(),
        other => exact(other),
    }
}

pub fn references(variables: &[&XmlVariable<'_>]) -> Vec<u32> {
    variables.iter().map(|v| v.reference).collect()
}

/// The name of an element of a variable, in quotes.
pub fn element_name(variable: &XmlVariable<'_>, element: usize) -> String {
    quote(&variable.element_name(&variable.name, element))
}

/// The values of the observed variables at one time.
pub type Row = Vec<Value>;
/// The rows of a run, with their times.
pub type Trajectory = Vec<(f64, Row)>;

/// Variables that are read together, one call for each type.
pub struct Observed<'a> {
    variables: Vec<&'a XmlVariable<'a>>,
    /// The value references and the number of elements of the variables of each type.
    parts: Vec<(Type, Vec<u32>, usize)>,
}

/// The first difference of an element between two runs.
pub struct Difference<'a> {
    pub variable: &'a XmlVariable<'a>,
    time: f64,
    /// Describes it.
    pub text: String,
}

impl<'a> Observed<'a> {
    pub fn of(variables: impl Iterator<Item = &'a XmlVariable<'a>>, version: FmiVersion) -> Self {
        let accessed = |v: &&XmlVariable<'_>| v.of_type.accessed_as(version) as u8;
        let mut variables: Vec<_> = variables.collect();
        variables.sort_by_key(accessed);
        let parts = variables.chunk_by(|a, b| accessed(a) == accessed(b));
        let parts = parts.map(|part| {
            let count = part.iter().map(|v| v.element_count()).sum();
            (part[0].of_type, references(part), count)
        });
        Self { parts: parts.collect(), variables }
    }

    pub fn variables(&self) -> impl DoubleEndedIterator<Item = &'a XmlVariable<'a>> {
        self.variables.iter().copied()
    }

    /// The variables and the indices of their elements, in the order of a row.
    pub fn elements(&self) -> impl Iterator<Item = (&'a XmlVariable<'a>, usize)> {
        let elements =
            |v: &'a XmlVariable<'a>| (0..v.element_count()).map(move |element| (v, element));
        self.variables().flat_map(elements)
    }

    /// Every how many steps a run of this many steps is recorded, so that it fits into memory.
    pub fn stride(&self, steps: usize) -> usize {
        let values: usize = self.parts.iter().map(|(_, _, n)| n).sum();
        (steps.saturating_mul(values) / MAX_VALUES).max(1)
    }

    pub fn read(&self, instance: &mut Instance) -> Result<Row> {
        let mut row = Row::new();
        for (of_type, references, n) in &self.parts {
            row.append(&mut get(instance, *of_type, references, *n)?);
        }
        Ok(row)
    }

    /// Sets the variables to the values of a row, those of one type in one call.
    pub fn write(&self, instance: &mut Instance, row: &Row) -> fmu_host::Result {
        let mut at = 0;
        for (of_type, references, n) in &self.parts {
            instance.set_values(*of_type, references, &row[at..at + n])?;
            at += n;
        }
        Ok(Success::Ok)
    }

    /// The first difference of each element between two runs at the same times. Real numbers may differ by the
    /// tolerance, relative to their largest value in the rows, also in those that only one run has. `when` tells what the actual run does, `like` what
    /// the expected run has done.
    pub fn differences(
        &self,
        actual: &[(f64, Row)],
        expected: &[(f64, Row)],
        tolerance: f64,
        [when, like]: [&str; 2],
    ) -> Vec<Difference<'a>> {
        let first = |(at, (variable, element)): (usize, (&'a XmlVariable<'a>, usize))| {
            let rows = actual.iter().chain(expected);
            let sizes = rows.map(|(_, row)| row.get(at).map_or(0.0, size));
            let difference = tolerance * sizes.fold(1e-9, f64::max);
            let mut pairs = actual.iter().zip(expected);
            pairs.find_map(|((time, a), (_, b))| {
                let (a, b) = (a.get(at)?, b.get(at)?);
                let is = || match (element_name(variable, element), exact(a), exact(b)) {
                    (name, actual, expected) if variable.dimensions.is_empty() => {
                        format!(
                            "{when}, {name} at t = {time} s is {actual}, expected {expected}{like}"
                        )
                    }
                    (name, _, expected) => {
                        format!("{name} has another value {when}, expected {expected}{like}")
                    }
                };
                (!is_near(a, b, difference)).then(|| Difference {
                    variable,
                    time: *time,
                    text: is(),
                })
            })
        };
        self.elements().enumerate().filter_map(first).collect()
    }

    /// Checks that two runs are the same, as [`Observed::differences`].
    pub fn ensure_same(
        &self,
        actual: &[(f64, Row)],
        expected: &[(f64, Row)],
        tolerance: f64,
        how: [&str; 2],
    ) -> Result<()> {
        match Difference::first(&self.differences(actual, expected, tolerance, how)) {
            Some(difference) => bail!("{}", difference.text),
            None => Ok(()),
        }
    }
}

impl Difference<'_> {
    /// The one that is seen first.
    pub fn first(all: &[Self]) -> Option<&Self> {
        all.iter().min_by(|a, b| a.time.total_cmp(&b.time))
    }
}

/// A value with all digits, so that it reads back exactly.
fn exact(value: &Value) -> String {
    match value {
        Value::String(text) => quote(text),
        other => other.to_string(),
    }
}

/// How strongly inputs are excited: by this fraction of their start or nominal value. Models may refuse values
/// outside their range of validity, which their XML need not tell; weaker excitations are then tried. Only the
/// first one changes inputs that are not real numbers, and the last one none.
pub const EXCITATIONS: [f64; 3] = [0.5, 0.02, 0.0];

/// Whether the tests read and set a variable as a scalar: not arrays, Binaries, clocks and structural
/// parameters.
pub fn is_tested(variable: &XmlVariable<'_>) -> bool {
    variable.dimensions.is_empty()
        && !matches!(variable.of_type, Type::Binary | Type::Clock)
        && variable.causality != Causality::StructuralParameter
        && !is_clocked(variable)
}

/// Whether the tests read a variable: a scalar, or an array of numbers or Booleans that is not too large.
pub fn is_readable(variable: &XmlVariable<'_>) -> bool {
    let is_other = matches!(variable.of_type, Type::String | Type::Binary | Type::Clock);
    let is_array = !variable.dimensions.is_empty()
        && variable.element_count() <= MAX_ELEMENTS
        && !is_other
        && variable.causality != Causality::StructuralParameter
        && !is_clocked(variable);
    is_tested(variable) || is_array
}

/// An input, and how its value changes.
pub struct Input<'a> {
    pub variable: &'a XmlVariable<'a>,
    index: u64,
    /// Of its elements, the first ones of a large array.
    signals: Vec<Signal>,
}

enum Signal {
    /// A real number: its start value, and the size of its changes.
    Real(f64, f64),
    /// Values that follow each other, each for this number of points.
    Choice(Vec<Value>, usize),
}

/// The inputs of a model.
pub fn inputs<'a>(model: &'a ModelDescription<'a>) -> Vec<Input<'a>> {
    let inputs = model.variables().map(|(_, v)| v);
    let inputs = inputs.filter(|v| v.causality == Causality::Input && is_readable(v));
    let inputs = inputs.zip(0..).map(|(variable, index)| {
        let elements = 0..variable.element_count().min(MAX_EXCITED);
        let signals = elements.map(|element| Signal::of(variable, element, index)).collect();
        Input { variable, index, signals }
    });
    inputs.collect()
}

impl Signal {
    /// How an element of a variable changes, which is one of several inputs.
    fn of(variable: &XmlVariable<'_>, element: usize, index: u64) -> Self {
        let start = variable.start_of(element).cloned();
        match variable.of_type {
            Type::Float32 | Type::Float64 => {
                let start = start.and_then(|start| start.as_real()).unwrap_or(0.0);
                Self::Real(start, usual_change(variable, start))
            }
            Type::Boolean => {
                let start = start.unwrap_or(Value::Boolean(false));
                Self::Choice(near(variable, &start), 11)
            }
            Type::String => Self::Choice(Vec::new(), 1),
            whole => {
                let start = start.or_else(|| Value::whole(whole, 0));
                let mut values = start.map_or(Vec::new(), |start| near(variable, &start));
                let first = (index as usize + element).checked_rem(values.len());
                values.rotate_left(first.unwrap_or_default());
                Self::Choice(values, 7)
            }
        }
    }

    fn value(
        &self,
        of: &XmlVariable<'_>,
        excitation: f64,
        key: u64,
        point: usize,
    ) -> Option<Value> {
        match self {
            Self::Real(start, size) if excitation > 0.0 => {
                let value = start + excitation * size * signal(key, point);
                let (min, max) = real_range(of);
                // Not `clamp`, since the XML may be wrong about which is larger.
                Value::real(of.of_type, value.max(min).min(max))
            }
            Self::Choice(values, points) if excitation == EXCITATIONS[0] => {
                values.get((point / points).checked_rem(values.len())?).cloned()
            }
            _ => None,
        }
    }
}

/// How far a real number with a start value may usually move.
pub fn usual_change(variable: &XmlVariable<'_>, start: f64) -> f64 {
    let (min, max) = real_range(variable);
    let nominal = variable.inherited("nominal").and_then(real).unwrap_or(1.0);
    let usual = start.abs().max(nominal.abs());
    let is_narrow = max - min < 1e3 * usual;
    if is_narrow { (max - min) / 2.0 } else { usual }
}

impl Input<'_> {
    /// The values at a communication point with one of [`EXCITATIONS`]; `None` if the input keeps its start values.
    pub fn values(&self, excitation: f64, seed: u64, point: usize) -> Option<Vec<Value>> {
        let elements = (0..).zip(&self.signals).map(|(element, signal)| {
            let key = seed << 32 | self.index | element << 16;
            signal.value(self.variable, excitation, key, point)
        });
        let excited: Vec<Value> = elements.collect::<Option<_>>()?;
        let others = (excited.len()..self.variable.element_count())
            .map(|k| self.variable.start_of(k).cloned());
        let others: Option<Vec<Value>> = others.collect();
        Some([excited, others?].concat())
    }

    /// Whether a host may set it in continuous-time mode.
    pub fn is_continuous(&self) -> bool {
        self.variable.of_type.is_float() && is_continuous(self.variable)
    }
}

pub fn real_range(variable: &XmlVariable<'_>) -> (f64, f64) {
    let bound = |bound: &Option<Value>| bound.as_ref()?.as_real();
    (
        bound(&variable.min).unwrap_or(f64::NEG_INFINITY),
        bound(&variable.max).unwrap_or(f64::INFINITY),
    )
}

/// Whether the XML allows a value: a number in its range, or that of an item.
pub fn allows(variable: &XmlVariable<'_>, value: &Value) -> bool {
    let mut items = variable.items().iter();
    match value.as_whole() {
        Some(number) if variable.of_type == Type::Enumeration => {
            items.len() == 0 || items.any(|item| i128::from(item.value) == number)
        }
        _ => variable.allows(value),
    }
}

/// Values of a scalar that the XML allows: all items of an Enumeration; of others, the start value and those
/// around it.
fn near(variable: &XmlVariable<'_>, start: &Value) -> Vec<Value> {
    let of_type = variable.of_type;
    let mut near: Vec<Value> = match (start, start.as_real(), start.as_whole()) {
        (Value::Boolean(start), ..) => [*start, !start].map(Value::Boolean).into(),
        (Value::String(_), ..) => vec![start.clone(), Value::String("another text".into())],
        (Value::Enumeration(_), ..) => {
            let items = variable.items().iter();
            items.map(|item| Value::Enumeration(item.value)).collect()
        }
        (_, Some(x), _) => [x, 1.01 * x, 0.99 * x, x + 0.01, x - 0.01]
            .iter()
            .filter_map(|x| Value::real(of_type, *x))
            .collect(),
        (_, _, whole) => whole
            .iter()
            .flat_map(|n| [*n, n + 1, n - 1])
            .filter_map(|n| Value::whole(of_type, n))
            .collect(),
    };
    near.retain(|value| allows(variable, value));
    near
}

/// The start values of the elements of a variable.
pub fn starts(variable: &XmlVariable<'_>) -> Option<Vec<Value>> {
    (0..variable.element_count()).map(|element| variable.start_of(element).cloned()).collect()
}

/// Another value of a scalar than its start value, which must be in the XML.
pub fn other(variable: &XmlVariable<'_>) -> Option<Value> {
    others(variable).into_iter().next()?.pop()
}

/// Other values of a variable than its start values. Those of an array differ in each element that may have another one.
pub fn others(variable: &XmlVariable<'_>) -> Vec<Vec<Value>> {
    let Some(starts) = starts(variable) else { return Vec::new() };
    let others = |start: &Value| {
        let mut others = near(variable, start);
        others.retain(|near| near != start);
        others
    };
    let of_elements: Vec<Vec<Value>> = starts.iter().map(others).collect();
    let most = of_elements.iter().map(Vec::len).max().unwrap_or(0);
    let row = |k: usize| {
        let pairs = of_elements.iter().zip(&starts);
        pairs.map(|(others, start)| others.get(k).unwrap_or(start).clone()).collect()
    };
    (0..most).map(row).collect()
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
            assert!((0..4).all(|key| signal(key, point).abs() <= 1.0));
            assert!(signal(1, point) != signal(2, point));
        }
        let mean = (0..10_000).map(|point| noise(1, point)).sum::<f64>() / 1e4;
        assert!(mean.abs() < 0.02, "{mean}");
    }
}
