//! The transfer of values from outputs to inputs and into rows.

use std::fmt::Debug;

use fmu_host::Success;

use crate::instance::{Called, Instance};
use crate::recorder::Function;
use crate::wiring::{ByType, Ports, Record, Variables};
use crate::{Failure, Scale};

/// An FMI type with its get and set functions.
pub(crate) trait Type {
    type Value: Copy + Default + PartialEq + std::fmt::Debug;
    const GET: Function;
    const SET: Function;
    fn get(s: &mut Slave, references: &[u32], values: &mut [Self::Value]) -> fmu_host::Result;
    fn set(s: &mut Slave, references: &[u32], values: &[Self::Value]) -> fmu_host::Result;
    fn number(value: Self::Value) -> f64;
    /// The part of this type.
    fn of<P>(parts: &ByType<P>) -> &P;
    /// The value of an input whose output has this value; only Reals are scaled.
    fn scaled(value: Self::Value, _scale: Scale) -> Self::Value {
        value
    }
}

type Slave = fmu_host::Instance;

macro_rules! types {
    ($(
        $name:ident $parts:ident: $value:ty, $get:ident $recorded_get:ident, $set:ident $recorded_set:ident
        $(, $scaled:item)?;
    )*) => {
        $(
            pub(crate) struct $name;

            impl Type for $name {
                type Value = $value;
                const GET: Function = Function::$recorded_get;
                const SET: Function = Function::$recorded_set;

                #[inline]
                fn get(s: &mut Slave, references: &[u32], values: &mut [$value]) -> fmu_host::Result {
                    s.$get(references, values)
                }

                #[inline]
                fn set(s: &mut Slave, references: &[u32], values: &[$value]) -> fmu_host::Result {
                    s.$set(references, values)
                }

                #[inline]
                fn number(value: $value) -> f64 {
                    f64::from(value)
                }

                #[inline]
                fn of<P>(parts: &ByType<P>) -> &P {
                    &parts.$parts
                }

                $($scaled)?
            }
        )*
    };
}

types! {
    Real reals: f64, get_real GetReal, set_real SetReal,
        #[inline]
        fn scaled(value: f64, Scale { factor, offset }: Scale) -> f64 {
            factor * value + offset
        };
    Integer integers: i32, get_integer GetInteger, set_integer SetInteger;
    Boolean booleans: i32, get_boolean GetBoolean, set_boolean SetBoolean;
}

/// Values of each type.
pub(crate) struct Values {
    reals: Vec<f64>,
    integers: Vec<i32>,
    booleans: Vec<i32>,
}

/// A component and what is transferred from and to it.
pub(crate) struct Component<'a> {
    pub(crate) instance: Instance,
    ports: &'a ByType<Ports>,
    /// Space for the values of its inputs.
    inputs: Values,
    /// Whether other types than Real are transferred, which is rare.
    has_others: bool,
}

impl Values {
    /// This many zeros.
    pub(crate) fn zeros(count: &ByType<usize>) -> Self {
        Self {
            reals: vec![0.0; count.reals],
            integers: vec![0; count.integers],
            booleans: vec![0; count.booleans],
        }
    }

    /// Copies recorded variables to a row.
    #[inline]
    pub(crate) fn record(&self, records: &ByType<Vec<Record>>, others: bool, row: &mut [f64]) {
        record::<Real>(&self.reals, &records.reals, row);
        if others {
            self.record_others(records, row);
        }
    }

    #[inline(never)]
    fn record_others(&self, records: &ByType<Vec<Record>>, row: &mut [f64]) {
        record::<Integer>(&self.integers, &records.integers, row);
        record::<Boolean>(&self.booleans, &records.booleans, row);
    }
}

#[inline]
fn record<T: Type>(values: &[T::Value], records: &[Record], row: &mut [f64]) {
    for Record { column, output } in records {
        row[*column] = T::number(values[*output]);
    }
}

impl<'a> Component<'a> {
    pub(crate) fn new(instance: Instance, ports: &'a ByType<Ports>) -> Self {
        let inputs = Values::zeros(&ByType {
            reals: ports.reals.sources.len(),
            integers: ports.integers.sources.len(),
            booleans: ports.booleans.sources.len(),
        });
        let others = [&ports.integers, &ports.booleans];
        let is_empty =
            |ports: &&Ports| ports.sources.is_empty() && ports.outputs.references.is_empty();
        Self {
            instance,
            ports,
            inputs,
            has_others: !others.iter().all(is_empty),
        }
    }

    /// Reads its outputs, each once.
    #[inline(always)]
    pub(crate) fn read(&mut self, outputs: &mut Values) -> Called {
        let ports = &self.ports.reals;
        read::<Real>(&mut self.instance, ports, &mut outputs.reals)?;
        match self.has_others {
            false => Ok(()),
            true => self.read_others(outputs),
        }
    }

    #[inline(never)]
    fn read_others(&mut self, outputs: &mut Values) -> Called {
        let (instance, ports) = (&mut self.instance, self.ports);
        read::<Integer>(instance, &ports.integers, &mut outputs.integers)?;
        read::<Boolean>(instance, &ports.booleans, &mut outputs.booleans)
    }

    /// Writes its inputs.
    #[inline(always)]
    pub(crate) fn write(&mut self, outputs: &Values) -> Called {
        let (ports, values) = (&self.ports.reals, &mut self.inputs.reals);
        write::<Real>(&mut self.instance, ports, &outputs.reals, values)?;
        match self.has_others {
            false => Ok(()),
            true => self.write_others(outputs),
        }
    }

    #[inline(never)]
    fn write_others(&mut self, outputs: &Values) -> Called {
        let (instance, values) = (&mut self.instance, &mut self.inputs);
        let ports = &self.ports.integers;
        write::<Integer>(instance, ports, &outputs.integers, &mut values.integers)?;
        let ports = &self.ports.booleans;
        write::<Boolean>(instance, ports, &outputs.booleans, &mut values.booleans)
    }
}

/// Reads the outputs that feed a component, and writes its inputs; returns whether one has changed.
pub(crate) fn propagate(
    components: &mut [Component],
    fed: usize,
    outputs: &mut Values,
) -> Result<bool, Box<Failure>> {
    let ports = components[fed].ports;
    let mut changed = read_sources::<Real>(components, &ports.reals, &mut outputs.reals)?;
    changed |= read_sources::<Integer>(components, &ports.integers, &mut outputs.integers)?;
    changed |= read_sources::<Boolean>(components, &ports.booleans, &mut outputs.booleans)?;
    components[fed].write(outputs)?;
    Ok(changed)
}

#[inline(always)]
fn read<T: Type>(instance: &mut Instance, ports: &Ports, outputs: &mut [T::Value]) -> Called {
    let Variables { references, names } = &ports.outputs;
    let references = references.as_slice();
    if references.is_empty() {
        return Ok(());
    }
    let values = &mut outputs[ports.first..][..references.len()];
    // The closure that explains a failure is made after the call, so that nothing is stored for it before.
    match instance.try_call(T::GET, |s| T::get(s, references, values)) {
        Ok(Success::Ok) => Ok(()),
        outcome => instance.explain(|| names.join(", "), outcome),
    }
}

/// Reads the outputs that feed a component, and only these, as not every recorded variable can be read
/// during the initialization. Returns whether one has changed.
fn read_sources<T: Type>(
    components: &mut [Component],
    fed: &Ports,
    outputs: &mut [T::Value],
) -> Result<bool, Box<Failure>> {
    let mut changed = false;
    for sources in fed.sources.chunk_by(|a, b| a.component == b.component) {
        let Component {
            instance, ports, ..
        } = &mut components[sources[0].component];
        let ports = T::of(ports);
        let positions = || sources.iter().map(|source| source.output - ports.first);
        let references: Vec<_> = positions().map(|i| ports.outputs.references[i]).collect();
        let names = || positions().map(|i| ports.outputs.names[i].as_str());
        let what = || names().collect::<Vec<_>>().join(", ");
        let mut values = vec![T::Value::default(); sources.len()];
        instance.call(T::GET, what, |s| T::get(s, &references, &mut values))?;
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
    let Variables { references, names } = &ports.inputs;
    let references = references.as_slice();
    if references.is_empty() {
        return Ok(());
    }
    let values = match ports.run {
        Some(first) => &outputs[first..][..references.len()],
        None => gather::<T>(ports, outputs, values),
    };
    match instance.try_call(T::SET, |s| T::set(s, references, values)) {
        Ok(Success::Ok) => Ok(()),
        outcome => instance.explain(|| assignments(names, values), outcome),
    }
}

/// Collects the values of inputs.
#[inline]
fn gather<'v, T: Type>(
    ports: &Ports,
    outputs: &[T::Value],
    values: &'v mut [T::Value],
) -> &'v [T::Value] {
    for (value, source) in values.iter_mut().zip(&ports.sources) {
        let output = outputs[source.output];
        *value = source
            .scale
            .map_or(output, |scale| T::scaled(output, scale));
    }
    values
}

/// Describes variables and their values.
fn assignments<V: Debug>(names: &[String], values: &[V]) -> String {
    let pairs = names.iter().zip(values);
    let texts: Vec<_> = pairs
        .map(|(name, value)| format!("{name} = {value:?}"))
        .collect();
    texts.join(", ")
}
