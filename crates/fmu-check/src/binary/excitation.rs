//! The values of variables: of runs, which are compared, and values that tests set, the same in every
//! run.

use fmu_description::value::real;
use fmu_description::{Causality, ModelDescription, Type, Value, XmlVariable};

use crate::binary::observed::{is_held, is_readable};
use crate::rules::is_continuous;

const MAX_EXCITED: usize = 1000;

/// How strongly inputs are excited: by this fraction of their start or nominal value. Models may refuse values
/// outside their range of validity, which their XML need not tell; weaker excitations are then tried. Only the
/// first one changes inputs that are not real numbers, and the last one none.
pub const EXCITATIONS: [f64; 3] = [0.5, 0.02, 0.0];

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

/// The inputs of a model, but for those with clocks.
pub fn inputs<'a>(model: &'a ModelDescription<'a>) -> Vec<Input<'a>> {
    inputs_that(model, is_readable)
}

/// The inputs of a model that can be set at the ticks of their clocks.
pub fn clocked_inputs<'a>(model: &'a ModelDescription<'a>) -> Vec<Input<'a>> {
    inputs_that(model, is_held)
}

fn inputs_that<'a>(
    model: &'a ModelDescription<'a>,
    are: impl Fn(&XmlVariable<'_>) -> bool,
) -> Vec<Input<'a>> {
    let inputs = model.variables().map(|(_, v)| v);
    let inputs = inputs.filter(|v| v.causality == Causality::Input && are(v));
    let inputs = inputs.zip(0..).map(|(variable, index)| {
        let elements = 0..variable.element_count().min(MAX_EXCITED);
        let signals = elements.map(|element| Signal::new(variable, element, index)).collect();
        Input { variable, index, signals }
    });
    inputs.collect()
}

impl Signal {
    /// How an element of a variable changes, which is one of several inputs.
    fn new(variable: &XmlVariable<'_>, element: usize, index: u64) -> Self {
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
            Type::String | Type::Binary | Type::Clock => Self::Choice(Vec::new(), 1),
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

/// Whether the XML allows a value: a number in its range, or the number of an item.
pub fn allows(variable: &XmlVariable<'_>, value: &Value) -> bool {
    let mut items = variable.items().iter();
    match value.as_whole() {
        Some(number) if variable.of_type == Type::Enumeration => {
            items.len() == 0 || items.any(|item| i128::from(item.value) == number)
        }
        _ => variable.allows(value),
    }
}

/// Values of a scalar that the XML allows: all items of an Enumeration; of other types, the start value and values
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
pub fn other_value(variable: &XmlVariable<'_>) -> Option<Value> {
    other_values(variable).into_iter().next()?.pop()
}

/// Other values of a variable than its start values. All elements of an array differ, if they may.
pub fn other_values(variable: &XmlVariable<'_>) -> Vec<Vec<Value>> {
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
