//! The values of variables in a run, and the comparison of runs.

use std::collections::HashSet;
use std::ffi::CString;
use std::fmt::Debug;

use anyhow::{Context, Result, bail};
use fmu_description::{ScalarVariable, VariableType};
use fmu_file::text::quote;
use fmu_host::{Instance, Version};

/// Maximum number of numbers that a run records; longer runs record fewer points.
const MAX_VALUES: usize = 1 << 22;

/// Variables that are read together.
pub struct Observed<'a> {
    reals: Group<'a>,
    integers: Group<'a>,
    booleans: Group<'a>,
    strings: Group<'a>,
}

/// Variables with values of one class, those of the same type next to each other.
#[derive(Default)]
struct Group<'a> {
    variables: Vec<&'a ScalarVariable<'a>>,
    references: Vec<u32>,
}

impl Group<'_> {
    /// The variables of each type: their type, their value references and where they begin.
    fn parts(&self) -> impl Iterator<Item = (VariableType, &[u32], usize)> {
        let same = |a: &&ScalarVariable<'_>, b: &&ScalarVariable<'_>| {
            a.kind.accessed_as() == b.kind.accessed_as()
        };
        let mut begin = 0;
        self.variables.chunk_by(same).map(move |part| {
            let at = begin;
            begin += part.len();
            (part[0].kind, &self.references[at..begin], at)
        })
    }
}

/// The values of the observed variables at one time.
#[derive(Debug, Clone, Default)]
pub struct Row {
    /// The Reals.
    pub reals: Vec<f64>,
    /// The Integers of any size and the Enumerations; of a UInt64, the same bits.
    pub integers: Vec<i64>,
    /// The Booleans.
    pub booleans: Vec<i32>,
    /// The Strings.
    pub strings: Vec<String>,
}

/// The rows of a run, with their times.
pub type Trajectory = Vec<(f64, Row)>;

impl<'a> Observed<'a> {
    /// Groups variables.
    pub fn of(variables: impl Iterator<Item = &'a ScalarVariable<'a>>) -> Self {
        let mut observed = Self {
            reals: Group::default(),
            integers: Group::default(),
            booleans: Group::default(),
            strings: Group::default(),
        };
        let mut variables: Vec<_> = variables.collect();
        let place = |kind| VariableType::ALL.iter().position(|other| *other == kind);
        variables.sort_by_key(|v| place(v.kind.accessed_as()));
        for variable in variables {
            let group = match Class::of(variable.kind) {
                Class::Real => &mut observed.reals,
                Class::Integer => &mut observed.integers,
                Class::Boolean => &mut observed.booleans,
                Class::String => &mut observed.strings,
                Class::Other => continue,
            };
            group.variables.push(variable);
            group.references.push(variable.reference);
        }
        observed
    }

    fn groups(&self) -> [&Group<'a>; 4] {
        [&self.reals, &self.integers, &self.booleans, &self.strings]
    }

    /// The variables, in the order of [`Row::texts`].
    pub fn variables(&self) -> impl Iterator<Item = &'a ScalarVariable<'a>> {
        self.groups()
            .into_iter()
            .flat_map(|group| group.variables.iter().copied())
    }

    /// The Reals, in the order of [`Row::reals`].
    pub fn reals(&self) -> &[&'a ScalarVariable<'a>] {
        &self.reals.variables
    }

    /// The Integers and Enumerations, in the order of [`Row::integers`].
    pub fn integers(&self) -> &[&'a ScalarVariable<'a>] {
        &self.integers.variables
    }

    /// The Booleans, in the order of [`Row::booleans`].
    pub fn booleans(&self) -> &[&'a ScalarVariable<'a>] {
        &self.booleans.variables
    }

    /// The Strings, in the order of [`Row::strings`].
    pub fn strings(&self) -> &[&'a ScalarVariable<'a>] {
        &self.strings.variables
    }

    /// Records every how many steps, so that a run of `steps` steps fits into memory.
    pub fn stride(&self, steps: usize) -> usize {
        let values: usize = self.groups().iter().map(|g| g.references.len()).sum();
        (steps.saturating_mul(values) / MAX_VALUES).max(1)
    }

    /// Reads the variables, all of one type in one call.
    pub fn read(&self, instance: &mut Instance) -> Result<Row> {
        let mut row = Row {
            reals: vec![0.0; self.reals.references.len()],
            integers: vec![0; self.integers.references.len()],
            booleans: vec![0; self.booleans.references.len()],
            strings: vec![],
        };
        for (kind, references, at) in self.reals.parts() {
            get_reals(
                instance,
                kind,
                references,
                &mut row.reals[at..][..references.len()],
            )?;
        }
        for (kind, references, at) in self.integers.parts() {
            let values = &mut row.integers[at..][..references.len()];
            get_integers(instance, kind, references, values)?;
        }
        if !row.booleans.is_empty() {
            instance.get_boolean(&self.booleans.references, &mut row.booleans)?;
        }
        if !self.strings.references.is_empty() {
            row.strings = instance.get_string(&self.strings.references)?;
        }
        Ok(row)
    }

    /// Describes the first difference between two runs at the same times. Real numbers may differ by
    /// the tolerance, relative to their largest value in the run.
    pub fn difference(
        &self,
        actual: &[(f64, Row)],
        expected: &[(f64, Row)],
        tolerance: f64,
    ) -> Option<String> {
        let mut scales = vec![1e-9_f64; self.reals.variables.len()];
        for (_, row) in expected.iter().chain(actual) {
            for (scale, value) in scales.iter_mut().zip(&row.reals) {
                if value.is_finite() {
                    *scale = scale.max(value.abs());
                }
            }
        }
        actual.iter().zip(expected).find_map(|((time, a), (_, b))| {
            let same = |i: usize| {
                let (a, b) = (a.reals[i], b.reals[i]);
                a == b || (a - b).abs() <= tolerance * scales[i] || (a.is_nan() && b.is_nan())
            };
            let (name, actual, expected) = first(&self.reals, same, &a.reals, &b.reals)
                .or_else(|| equal(&self.integers, &a.integers, &b.integers))
                .or_else(|| equal(&self.booleans, &a.booleans, &b.booleans))
                .or_else(|| equal(&self.strings, &a.strings, &b.strings))?;
            Some(format!(
                "{} at t = {time} s is {actual}, expected {expected}",
                quote(name)
            ))
        })
    }
}

type Different<'a> = (&'a str, String, String);

fn equal<'a, T: PartialEq + Debug>(group: &Group<'a>, a: &[T], b: &[T]) -> Option<Different<'a>> {
    first(group, |i| a[i] == b[i], a, b)
}

/// The first variable that differs, with its two values.
fn first<'a, T: Debug>(
    group: &Group<'a>,
    same: impl Fn(usize) -> bool,
    a: &[T],
    b: &[T],
) -> Option<Different<'a>> {
    let at = (0..a.len().min(b.len())).find(|&i| !same(i))?;
    let name = group.variables.get(at)?.name;
    Some((name, format!("{:?}", a[at]), format!("{:?}", b[at])))
}

/// The value references of variables.
pub fn references(variables: &[&ScalarVariable<'_>]) -> Vec<u32> {
    variables.iter().map(|v| v.reference).collect()
}

/// Reads one variable.
pub fn read(instance: &mut Instance, variable: &ScalarVariable<'_>) -> Result<Value> {
    value(instance, variable.kind, &[variable.reference])
        .with_context(|| format!("{} cannot be read", quote(variable.name)))
}

/// The value of one variable.
#[derive(Debug, Clone)]
pub enum Value {
    /// Of a Real.
    Real(f64),
    /// Of an Integer of any size or of an Enumeration; of a UInt64, the same bits.
    Integer(i64),
    /// Of a Boolean.
    Boolean(i32),
    /// Of a String.
    String(String),
}

impl PartialEq for Value {
    /// Compares bits, so that NaN equals itself.
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Real(a), Self::Real(b)) => a.to_bits() == b.to_bits(),
            (Self::Integer(a), Self::Integer(b)) => a == b,
            (Self::Boolean(a), Self::Boolean(b)) => a == b,
            (Self::String(a), Self::String(b)) => a == b,
            _ => false,
        }
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Real(value) => write!(f, "{value}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Boolean(0) => write!(f, "false"),
            Self::Boolean(1) => write!(f, "true"),
            Self::Boolean(value) => write!(f, "{value}, which is not a Boolean"),
            Self::String(value) => f.write_str(&quote(value)),
        }
    }
}

fn value(instance: &mut Instance, kind: VariableType, reference: &[u32; 1]) -> Result<Value> {
    let (mut real, mut number, mut boolean) = ([0.0], [0], [0]);
    Ok(match Class::of(kind) {
        Class::Real => {
            get_reals(instance, kind, reference, &mut real)?;
            Value::Real(real[0])
        }
        Class::Integer => {
            get_integers(instance, kind, reference, &mut number)?;
            Value::Integer(number[0])
        }
        Class::Boolean => {
            instance.get_boolean(reference, &mut boolean)?;
            Value::Boolean(boolean[0])
        }
        Class::String => Value::String(instance.get_string(reference)?.concat()),
        Class::Other => bail!("the type {} is not tested", kind.as_str()),
    })
}

/// Types whose values are alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// Real numbers of any size.
    Real,
    /// Whole numbers of any size, and Enumerations.
    Integer,
    Boolean,
    String,
    /// Binaries and clocks, which are not tested.
    Other,
}

impl Class {
    /// The class of a type.
    pub fn of(kind: VariableType) -> Self {
        use VariableType as T;
        match kind {
            T::Real | T::Float32 | T::Float64 => Self::Real,
            T::Boolean => Self::Boolean,
            T::String => Self::String,
            T::Binary | T::Clock => Self::Other,
            _ => Self::Integer,
        }
    }
}

fn get_reals(
    instance: &mut Instance,
    kind: VariableType,
    references: &[u32],
    values: &mut [f64],
) -> fmu_host::Result {
    if kind != VariableType::Float32 {
        return instance.get_real(references, values);
    }
    let mut singles = vec![0.0; values.len()];
    let got = instance.get_float32(references, &mut singles)?;
    for (value, single) in values.iter_mut().zip(singles) {
        *value = single.into();
    }
    Ok(got)
}

/// The type by whose functions whole numbers are accessed; in FMI 3.0, an Enumeration is an Int64.
fn accessed_as(instance: &Instance, kind: VariableType) -> VariableType {
    match (instance.version(), kind) {
        (Version::Fmi3, VariableType::Enumeration) => VariableType::Int64,
        (_, kind) => kind,
    }
}

fn get_integers(
    instance: &mut Instance,
    kind: VariableType,
    references: &[u32],
    values: &mut [i64],
) -> fmu_host::Result {
    fn through<T: Copy + Default>(
        values: &mut [i64],
        get: impl FnOnce(&mut [T]) -> fmu_host::Result,
        widen: impl Fn(T) -> i64,
    ) -> fmu_host::Result {
        let mut own = vec![T::default(); values.len()];
        let got = get(&mut own)?;
        for (value, own) in values.iter_mut().zip(own) {
            *value = widen(own);
        }
        Ok(got)
    }
    let (i, r) = (instance, references);
    match accessed_as(i, kind) {
        VariableType::Int8 => through(values, |v| i.get_int8(r, v), i64::from),
        VariableType::UInt8 => through(values, |v| i.get_uint8(r, v), i64::from),
        VariableType::Int16 => through(values, |v| i.get_int16(r, v), i64::from),
        VariableType::UInt16 => through(values, |v| i.get_uint16(r, v), i64::from),
        VariableType::UInt32 => through(values, |v| i.get_uint32(r, v), i64::from),
        VariableType::Int64 => i.get_int64(r, values),
        VariableType::UInt64 => through(values, |v| i.get_uint64(r, v), u64::cast_signed),
        _ => through(values, |v| i.get_integer(r, v), i64::from),
    }
}

/// Sets a variable. A number that its type does not have is cut off.
pub fn set(
    instance: &mut Instance,
    variable: &ScalarVariable<'_>,
    value: &Value,
) -> fmu_host::Result {
    let reference = &[variable.reference];
    match value {
        #[allow(
            clippy::cast_possible_truncation,
            reason = "the type has this precision"
        )]
        Value::Real(value) if variable.kind == VariableType::Float32 => {
            instance.set_float32(reference, &[*value as f32])
        }
        Value::Real(value) => instance.set_real(reference, &[*value]),
        Value::Integer(value) => set_integer(instance, variable.kind, reference, *value),
        Value::Boolean(value) => instance.set_boolean(reference, &[*value]),
        Value::String(text) => {
            let text = CString::new(text.as_str()).unwrap_or_default();
            instance.set_string(reference, &[text])
        }
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "values are within the range of their type"
)]
fn set_integer(i: &mut Instance, kind: VariableType, r: &[u32; 1], value: i64) -> fmu_host::Result {
    match accessed_as(i, kind) {
        VariableType::Int8 => i.set_int8(r, &[value as i8]),
        VariableType::UInt8 => i.set_uint8(r, &[value as u8]),
        VariableType::Int16 => i.set_int16(r, &[value as i16]),
        VariableType::UInt16 => i.set_uint16(r, &[value as u16]),
        VariableType::UInt32 => i.set_uint32(r, &[value as u32]),
        VariableType::Int64 => i.set_int64(r, &[value]),
        VariableType::UInt64 => i.set_uint64(r, &[value as u64]),
        _ => i.set_integer(r, &[value as i32]),
    }
}

/// The elements of an array of numbers or Booleans, as bits: those of an `f64` or of an `i64`.
pub fn elements(
    instance: &mut Instance,
    variable: &ScalarVariable<'_>,
    n: usize,
) -> Result<Vec<u64>> {
    let reference = &[variable.reference];
    Ok(match Class::of(variable.kind) {
        Class::Real => {
            let mut values = vec![0.0; n];
            get_reals(instance, variable.kind, reference, &mut values)?;
            values.into_iter().map(f64::to_bits).collect()
        }
        Class::Integer => {
            let mut values = vec![0; n];
            get_integers(instance, variable.kind, reference, &mut values)?;
            values.into_iter().map(i64::cast_unsigned).collect()
        }
        Class::Boolean => {
            let mut values = vec![0; n];
            instance.get_boolean(reference, &mut values)?;
            values
                .into_iter()
                .map(|v| i64::from(v).cast_unsigned())
                .collect()
        }
        Class::String | Class::Other => {
            bail!(
                "arrays of the type {} are not tested",
                variable.kind.as_str()
            )
        }
    })
}

/// Names in a file of the parent, one per line; none if there is no such file.
pub fn names(file: &std::path::Path) -> HashSet<String> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

/// Running digests of all observed variables, to compare runs in different processes.
pub struct Digests(Vec<u64>);

impl Digests {
    /// Digests of nothing.
    pub fn new(observed: &Observed<'_>) -> Self {
        Self(vec![0xcbf2_9ce4_8422_2325; observed.variables().count()])
    }

    /// Adds a row.
    pub fn push(&mut self, row: &Row) {
        let reals = row.reals.iter().map(|value| value.to_bits());
        let integers = row.integers.iter().map(|value| value.cast_unsigned());
        let booleans = row.booleans.iter();
        let booleans = booleans.map(|value| u64::from(value.cast_unsigned()));
        let strings = row.strings.iter().map(|text| {
            let mut digest = Self::mix(0, text.len() as u64);
            text.bytes()
                .for_each(|byte| digest = Self::mix(digest, byte.into()));
            digest
        });
        let values = reals.chain(integers).chain(booleans).chain(strings);
        for (digest, value) in self.0.iter_mut().zip(values) {
            *digest = Self::mix(*digest, value);
        }
    }

    fn mix(digest: u64, value: u64) -> u64 {
        (digest ^ value)
            .wrapping_mul(0x0000_0100_0000_01b3)
            .rotate_left(23)
    }

    /// A line for each variable: digest, last value, name.
    pub fn lines(&self, observed: &Observed<'_>, last: &Row) -> Vec<String> {
        let values = last.texts();
        (self.0.iter().zip(values).zip(observed.variables()))
            .map(|((digest, value), variable)| format!("{digest:016x}\t{value}\t{}", variable.name))
            .collect()
    }
}

impl Row {
    /// All values as texts.
    fn texts(&self) -> Vec<String> {
        let reals = self.reals.iter().map(ToString::to_string);
        let integers = self.integers.iter().map(ToString::to_string);
        let booleans = self.booleans.iter().map(ToString::to_string);
        reals
            .chain(integers)
            .chain(booleans)
            .chain(self.strings.iter().map(|text| quote(text)))
            .collect()
    }
}
