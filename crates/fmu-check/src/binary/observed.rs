//! The variables that tests read, and the comparison of their values in two runs.

use std::collections::HashSet;

use anyhow::{Result, bail};
use fmu_description::{
    Causality, FmiVersion, ModelDescription, Type, Value, Variability, XmlVariable,
};
use fmu_file::text::quote;
use fmu_host::{Instance, Success};

use crate::rules::is_clocked;

/// Maximum number of values that a run records; longer runs record fewer points.
const MAX_VALUES: usize = 1 << 21;
/// Maximum number of elements of an array that is tested, and of elements of an input that change in a run.
pub const MAX_ELEMENTS: usize = 1 << 16;

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
    /// Clocked variables, whose values are those that were read at the last ticks of their clocks.
    held: Vec<&'a XmlVariable<'a>>,
}

/// The first difference of an element between two runs.
pub struct Difference<'a> {
    pub variable: &'a XmlVariable<'a>,
    time: f64,
    /// Describes it.
    pub text: String,
}

impl<'a> Observed<'a> {
    pub fn new(variables: impl Iterator<Item = &'a XmlVariable<'a>>, version: FmiVersion) -> Self {
        let accessed = |v: &&XmlVariable<'_>| v.of_type.accessed_as(version) as u8;
        let mut variables: Vec<_> = variables.collect();
        variables.sort_by_key(accessed);
        let parts = variables.chunk_by(|a, b| accessed(a) == accessed(b));
        let parts = parts.map(|part| {
            let count = part.iter().map(|v| v.element_count()).sum();
            (part[0].of_type, references(part), count)
        });
        Self { parts: parts.collect(), variables, held: Vec::new() }
    }

    pub fn variables(&self) -> impl DoubleEndedIterator<Item = &'a XmlVariable<'a>> {
        self.variables.iter().copied()
    }

    /// The variables and the indices of their elements, in the order of a row.
    pub fn elements(&self) -> impl Iterator<Item = (&'a XmlVariable<'a>, usize)> {
        let elements =
            |v: &'a XmlVariable<'a>| (0..v.element_count()).map(move |element| (v, element));
        self.variables().chain(self.held()).flat_map(elements)
    }

    /// The clocked variables among them.
    pub fn held(&self) -> impl Iterator<Item = &'a XmlVariable<'a>> {
        self.held.iter().copied()
    }

    /// The values of the clocked variables before the first ticks of their clocks.
    pub fn neutral(&self) -> Row {
        self.held().flat_map(neutral).collect()
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

    /// Sets the variables to the values of a row, with one call for each type.
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
    /// The difference that is seen first.
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

/// Whether the tests read or set a variable at the ticks of its clocks.
pub fn is_held(variable: &XmlVariable<'_>) -> bool {
    let is_list = matches!(variable.of_type, Type::String | Type::Binary);
    is_clocked(variable)
        && variable.of_type != Type::Clock
        && !variable.is_parameter()
        && (variable.dimensions.is_empty() || !is_list)
        && variable.element_count() <= MAX_ELEMENTS
}

/// Values that a variable may have.
fn neutral(variable: &XmlVariable<'_>) -> Vec<Value> {
    let of_type = variable.of_type;
    let bound = |bound: &Option<Value>| bound.clone();
    let zero = match of_type {
        Type::Boolean => Some(Value::Boolean(false)),
        Type::String => Some(Value::String(String::new())),
        Type::Binary => Some(Value::Binary(Vec::new())),
        Type::Enumeration => variable.items().first().map(|item| Value::Enumeration(item.value)),
        _ => Value::real(of_type, 0.0).or_else(|| Value::whole(of_type, 0)),
    };
    let zero = zero.filter(|zero| variable.allows(zero)).or_else(|| bound(&variable.min));
    let zero = zero.or_else(|| bound(&variable.max)).unwrap_or(Value::Boolean(false));
    (0..variable.element_count()).map(|k| variable.start_of(k).unwrap_or(&zero).clone()).collect()
}

/// The variables that an FMU computes and that can be compared between runs, without those that are named.
pub fn observed<'a>(model: &'a ModelDescription<'a>, without: &HashSet<String>) -> Observed<'a> {
    use Causality::{CalculatedParameter, Local, Output};
    let computed = readable(model, without)
        .filter(|v| matches!(v.causality, Output | Local | CalculatedParameter));
    let held = model.variables().map(|(_, v)| v).filter(|v| {
        is_held(v) && matches!(v.causality, Output | Local) && !without.contains(&v.name)
    });
    Observed { held: held.collect(), ..Observed::new(computed, model.version) }
}

/// Whether a variable changes at events only.
pub fn is_discrete(variable: &XmlVariable<'_>) -> bool {
    let is_output = variable.causality == Causality::Output;
    variable.variability == Variability::Discrete || !variable.of_type.is_float() && is_output
}

/// The variables of a model that the tests read, without those that are named.
pub fn readable<'a>(
    model: &'a ModelDescription<'a>,
    without: &HashSet<String>,
) -> impl Iterator<Item = &'a XmlVariable<'a>> {
    let all = model.variables().map(|(_, v)| v);
    all.filter(move |v| is_readable(v) && !without.contains(&v.name))
}
