//! The transfer of values from outputs to inputs and into rows.

use std::collections::BTreeMap;
use std::ffi::CString;
use std::fmt::Debug;

use fmu_description::VariableType;
use fmu_host::Success;

use crate::instance::{Called, Instance};
use crate::recorder::Function;
use crate::value::Typed;
use crate::wiring::{ByStore, Ports, Record, Source, Transfers, Wired};
use crate::{Failure, Scale, Variable, access};

/// Real numbers, or all others as whole numbers, of the type of FMI that `access` gives.
pub(crate) trait Type {
    type Value: Copy + Default + PartialEq + Debug;
    fn get(
        slave: &mut fmu_host::Instance,
        access: VariableType,
        references: &[u32],
        values: &mut [Self::Value],
    ) -> fmu_host::Result;
    fn set(
        slave: &mut fmu_host::Instance,
        access: VariableType,
        references: &[u32],
        values: &[Self::Value],
    ) -> fmu_host::Result;
    fn number(value: Self::Value) -> f64;
    /// The value of an input whose output has this value; only real numbers are scaled.
    fn scaled(value: Self::Value, _scale: Scale) -> Self::Value {
        value
    }
    /// The value of a start value.
    fn start(start: &Typed) -> Option<Self::Value>;
}

pub(crate) struct Real;

impl Type for Real {
    type Value = f64;

    #[inline(always)]
    fn get(
        slave: &mut fmu_host::Instance,
        access: VariableType,
        references: &[u32],
        values: &mut [f64],
    ) -> fmu_host::Result {
        access::get_reals(slave, access, references, values)
    }

    #[inline(always)]
    fn set(
        slave: &mut fmu_host::Instance,
        access: VariableType,
        references: &[u32],
        values: &[f64],
    ) -> fmu_host::Result {
        access::set_reals(slave, access, references, values)
    }

    #[inline]
    fn number(value: f64) -> f64 {
        value
    }

    #[inline]
    fn scaled(value: f64, Scale { factor, offset }: Scale) -> f64 {
        factor * value + offset
    }

    fn start(start: &Typed) -> Option<f64> {
        match start {
            Typed::Real(value) => Some(*value),
            _ => None,
        }
    }
}

pub(crate) struct Whole;

impl Type for Whole {
    type Value = i128;

    fn get(
        slave: &mut fmu_host::Instance,
        access: VariableType,
        references: &[u32],
        values: &mut [i128],
    ) -> fmu_host::Result {
        access::get_wholes(slave, access, references, values)
    }

    fn set(
        slave: &mut fmu_host::Instance,
        access: VariableType,
        references: &[u32],
        values: &[i128],
    ) -> fmu_host::Result {
        access::set_wholes(slave, access, references, values)
    }

    fn number(value: i128) -> f64 {
        value as f64
    }

    fn start(start: &Typed) -> Option<i128> {
        match start {
            Typed::Integer(value) => Some(*value),
            Typed::Boolean(value) => Some((*value).into()),
            _ => None,
        }
    }
}

/// Values of each type.
pub(crate) struct Values {
    reals: Vec<f64>,
    wholes: Vec<i128>,
}

/// A component and what is transferred from and to it.
pub(crate) struct Component<'a> {
    pub(crate) instance: Instance,
    transfers: &'a Transfers,
    /// The values of its inputs; those of elements that are not connected stay.
    reals: Vec<f64>,
    others: Vec<Inputs>,
}

/// Values of inputs of other types than `f64`.
enum Inputs {
    Singles(Vec<f64>),
    Wholes(Vec<i128>),
}

impl Values {
    /// This many zeros.
    pub(crate) fn zeros(count: &ByStore<usize>) -> Self {
        Self {
            reals: vec![0.0; count.reals],
            wholes: vec![0; count.wholes],
        }
    }

    /// Copies recorded variables to a row.
    #[inline]
    pub(crate) fn record(&self, records: &ByStore<Vec<Record>>, others: bool, row: &mut [f64]) {
        record::<Real>(&self.reals, &records.reals, row);
        if others {
            self.record_others(records, row);
        }
    }

    #[inline(never)]
    fn record_others(&self, records: &ByStore<Vec<Record>>, row: &mut [f64]) {
        record::<Whole>(&self.wholes, &records.wholes, row);
    }
}

#[inline]
fn record<T: Type>(values: &[T::Value], records: &[Record], row: &mut [f64]) {
    for Record { column, output } in records {
        row[*column] = T::number(values[*output]);
    }
}

impl<'a> Component<'a> {
    /// `starts` are the start values that the user has given, by the indices of the variables.
    pub(crate) fn new(
        instance: Instance,
        transfers: &'a Transfers,
        starts: &BTreeMap<usize, &Typed>,
    ) -> Self {
        let variables = &instance.fmu().variables;
        let of = |ports: &Ports| match ports.access.is_float() {
            true => Inputs::Singles(initial::<Real>(&ports.inputs, variables, starts)),
            false => Inputs::Wholes(initial::<Whole>(&ports.inputs, variables, starts)),
        };
        Self {
            reals: initial::<Real>(&transfers.reals.inputs, variables, starts),
            others: transfers.others.iter().map(of).collect(),
            instance,
            transfers,
        }
    }

    /// Reads its outputs, each once.
    #[inline(always)]
    pub(crate) fn read(&mut self, outputs: &mut Values) -> Called {
        read::<Real>(
            &mut self.instance,
            &self.transfers.reals,
            &mut outputs.reals,
        )?;
        match self.transfers.others.is_empty() {
            true => Ok(()),
            false => self.read_others(outputs),
        }
    }

    #[inline(never)]
    fn read_others(&mut self, outputs: &mut Values) -> Called {
        let instance = &mut self.instance;
        (self.transfers.others.iter()).try_for_each(|ports| match ports.access.is_float() {
            true => read::<Real>(instance, ports, &mut outputs.reals),
            false => read::<Whole>(instance, ports, &mut outputs.wholes),
        })
    }

    /// Writes its inputs.
    #[inline(always)]
    pub(crate) fn write(&mut self, outputs: &Values) -> Called {
        let (ports, values) = (&self.transfers.reals, &mut self.reals);
        write::<Real>(&mut self.instance, ports, &outputs.reals, values)?;
        match self.transfers.others.is_empty() {
            true => Ok(()),
            false => self.write_others(outputs),
        }
    }

    #[inline(never)]
    fn write_others(&mut self, outputs: &Values) -> Called {
        let instance = &mut self.instance;
        let mut others = self.transfers.others.iter().zip(&mut self.others);
        others.try_for_each(|(ports, values)| match values {
            Inputs::Singles(values) => write::<Real>(instance, ports, &outputs.reals, values),
            Inputs::Wholes(values) => write::<Whole>(instance, ports, &outputs.wholes, values),
        })
    }
}

/// The values of inputs before any is connected: of arrays, the start values, since an array is set as a
/// whole.
fn initial<T: Type>(
    inputs: &Wired,
    variables: &[Variable],
    starts: &BTreeMap<usize, &Typed>,
) -> Vec<T::Value> {
    let mut values = vec![T::Value::default(); inputs.elements];
    let mut last = None;
    for (index, position) in inputs.variables.iter().zip(&inputs.positions) {
        let variable = &variables[*index];
        let (array, first) = (index - variable.element, position - variable.element);
        if last.replace(first) == Some(first) {
            continue;
        }
        for (value, index) in values[first..][..variable.count].iter_mut().zip(array..) {
            let start = starts.get(&index).copied();
            let start = start.or(variables[index].start.as_ref());
            *value = start.and_then(T::start).unwrap_or_default();
        }
    }
    values
}

/// Reads the outputs that feed a component, and writes its inputs; returns whether one has changed.
pub(crate) fn propagate(
    components: &mut [Component<'_>],
    fed: usize,
    outputs: &mut Values,
) -> Result<bool, Box<Failure>> {
    let transfers = components[fed].transfers;
    let mut changed = false;
    for ports in [&transfers.reals].into_iter().chain(&transfers.others) {
        changed |= match ports.access.is_float() {
            true => read_sources::<Real>(components, ports, &mut outputs.reals)?,
            false => read_sources::<Whole>(components, ports, &mut outputs.wholes)?,
        };
    }
    components[fed].write(outputs)?;
    Ok(changed)
}

#[inline(always)]
fn read<T: Type>(instance: &mut Instance, ports: &Ports, outputs: &mut [T::Value]) -> Called {
    let references = ports.outputs.references.as_slice();
    if references.is_empty() {
        return Ok(());
    }
    let values = &mut outputs[ports.first..][..ports.outputs.positions.len()];
    if !ports.outputs.are_all {
        return read_some::<T>(instance, ports.access, &ports.outputs, values);
    }
    let access = ports.access;
    // The closure that explains a failure is made after the call, so that nothing is stored for it before.
    match T::get(instance.calling(ports.get), access, references, values) {
        Ok(Success::Ok) => Ok(()),
        outcome => instance.explain(|| ports.outputs.names.join(", "), outcome),
    }
}

/// Reads some elements of arrays.
#[inline(never)]
fn read_some<T: Type>(
    instance: &mut Instance,
    access: VariableType,
    variables: &Wired,
    values: &mut [T::Value],
) -> Called {
    let mut all = vec![T::Value::default(); variables.elements];
    let (function, what) = (Function::get(access), || variables.names.join(", "));
    instance.call(function, what, |s| {
        T::get(s, access, &variables.references, &mut all)
    })?;
    for (value, position) in values.iter_mut().zip(&variables.positions) {
        *value = all[*position];
    }
    Ok(())
}

/// Reads the outputs that feed a component, and only these, as not every recorded variable can be read
/// during the initialization. Returns whether one has changed.
fn read_sources<T: Type>(
    components: &mut [Component<'_>],
    fed: &Ports,
    outputs: &mut [T::Value],
) -> Result<bool, Box<Failure>> {
    let mut changed = false;
    let same = |a: &Source, b: &Source| (a.component, a.access) == (b.component, b.access);
    for sources in fed.sources.chunk_by(same) {
        let Source {
            component, access, ..
        } = sources[0];
        let instance = &mut components[component].instance;
        let mut read = Wired::default();
        for Source { variable, .. } in sources {
            read.push(&instance.fmu().variables[*variable], *variable);
        }
        let mut values = vec![T::Value::default(); sources.len()];
        read_some::<T>(instance, access, &read, &mut values)?;
        for (source, value) in sources.iter().zip(values) {
            changed |= outputs[source.output] != value;
            outputs[source.output] = value;
        }
    }
    Ok(changed)
}

#[inline(always)]
fn write<T: Type>(
    instance: &mut Instance,
    ports: &Ports,
    outputs: &[T::Value],
    values: &mut [T::Value],
) -> Called {
    let references = ports.inputs.references.as_slice();
    if references.is_empty() {
        return Ok(());
    }
    let values = match ports.run {
        Some(first) => &outputs[first..][..ports.inputs.elements],
        None => gather::<T>(ports, outputs, values),
    };
    let access = ports.access;
    match T::set(instance.calling(ports.set), access, references, values) {
        Ok(Success::Ok) => Ok(()),
        outcome => instance.explain(|| assignments::<T>(&ports.inputs, values), outcome),
    }
}

/// Collects the values of inputs.
#[inline]
fn gather<'v, T: Type>(
    ports: &Ports,
    outputs: &[T::Value],
    values: &'v mut [T::Value],
) -> &'v [T::Value] {
    for (position, source) in ports.inputs.positions.iter().zip(&ports.sources) {
        let output = outputs[source.output];
        values[*position] = source
            .scale
            .map_or(output, |scale| T::scaled(output, scale));
    }
    values
}

/// Describes variables and their values.
fn assignments<T: Type>(inputs: &Wired, values: &[T::Value]) -> String {
    let pairs = inputs.names.iter().zip(&inputs.positions);
    let texts: Vec<_> = pairs
        .map(|(name, position)| format!("{name} = {:?}", values[*position]))
        .collect();
    texts.join(", ")
}

/// Sets start values; those of an array together, with those that the model description has for the others.
pub(crate) fn start(instance: &mut Instance, starts: &BTreeMap<usize, &Typed>) -> Called {
    let fmu = instance.fmu().clone();
    let mut given = starts.iter().peekable();
    while let Some((&index, &value)) = given.next() {
        let variable = &fmu.variables[index];
        let array = index - variable.element..index - variable.element + variable.count;
        let mut names = vec![format!("{} = {value}", variable.name)];
        let mut wired = Wired::default();
        wired.push(variable, index);
        while let Some((other, value)) = given.next_if(|(other, _)| array.contains(other)) {
            names.push(format!("{} = {value}", fmu.variables[*other].name));
        }
        let what = names.join(", ");
        match value {
            Typed::Real(_) => {
                let values = initial::<Real>(&wired, &fmu.variables, starts);
                set::<Real>(instance, variable, what, &values)?;
            }
            Typed::Integer(_) | Typed::Boolean(_) => {
                let values = initial::<Whole>(&wired, &fmu.variables, starts);
                set::<Whole>(instance, variable, what, &values)?;
            }
            Typed::String(_) => {
                let texts: Vec<CString> = array
                    .map(|index| match starts.get(&index).copied() {
                        Some(Typed::String(text)) => text.clone(),
                        _ => match &fmu.variables[index].start {
                            Some(Typed::String(text)) => text.clone(),
                            _ => CString::default(),
                        },
                    })
                    .collect();
                let function = Function::SetString;
                let reference = [variable.reference];
                instance.call(function, || what, |s| s.set_string(&reference, &texts))?;
            }
        }
    }
    Ok(())
}

fn set<T: Type>(
    instance: &mut Instance,
    variable: &Variable,
    what: String,
    values: &[T::Value],
) -> Called {
    let (access, reference) = (variable.access, [variable.reference]);
    instance.call(
        Function::set(access),
        || what,
        |s| T::set(s, access, &reference, values),
    )
}
