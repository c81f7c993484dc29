//! A running FMU: its calls, and the transfer of values from outputs to inputs.

use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::Result;
use fmu_description::Value;
use fmu_host::{Success, operation};
use fmu_worker::{Calls, Function};
use serde::{Deserialize, Serialize};

use crate::plan::Planned;
use crate::value::shown;
use crate::wiring::{Place, Ports, Source, Transfers, Wired};
use crate::{Failure, Fmu, Messages};

/// The outcome of a call.
pub(crate) type Called<T = ()> = Result<T, Box<Failure>>;

/// Values: those of the type Float64 as `f64`, which is fast, and the others.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Store {
    pub(crate) reals: Vec<f64>,
    pub(crate) others: Vec<Value>,
}

impl Store {
    /// This many values of each kind.
    pub(crate) fn new([reals, others]: [usize; 2]) -> Self {
        Self {
            reals: vec![0.0; reals],
            others: vec![Value::Boolean(false); others],
        }
    }

    /// A number, or a Boolean as 0 or 1; NaN for other values.
    #[inline(always)]
    pub(crate) fn number(&self, place: Place) -> f64 {
        match place {
            Place::Real(index) => self.reals[index],
            Place::Other(index) => number(&self.others[index]),
        }
    }

    pub(crate) fn value(&self, place: Place) -> Value {
        match place {
            Place::Real(index) => Value::Float64(self.reals[index]),
            Place::Other(index) => self.others[index].clone(),
        }
    }

    fn set(&mut self, place: Place, value: Value) {
        match place {
            Place::Real(index) => self.reals[index] = number(&value),
            Place::Other(index) => self.others[index] = value,
        }
    }
}

fn number(value: &Value) -> f64 {
    match value {
        Value::Boolean(value) => (*value).into(),
        value => {
            let whole = value.as_whole().map(|whole| whole as f64);
            whole.or(value.as_real()).unwrap_or(f64::NAN)
        }
    }
}

/// A component and what is transferred from and to it.
pub(crate) struct Component<'a> {
    name: &'a str,
    /// Must be dropped before the FMU, which removes its files.
    instance: fmu_host::Instance,
    fmu: Arc<Fmu>,
    messages: Messages,
    calls: Calls,
    do_step: Option<Function>,
    transfers: &'a Transfers,
    /// The values of its inputs; those of elements that are not connected stay.
    reals: Vec<f64>,
    others: Vec<Vec<Value>>,
}

impl<'a> Component<'a> {
    /// Instantiates a component; `starts` are the start values that the user has given, by the indices of
    /// the scalars.
    pub(crate) fn new(
        index: usize,
        planned: &'a Planned,
        transfers: &'a Transfers,
        starts: &BTreeMap<usize, &Value>,
        messages: &Messages,
    ) -> Result<Self> {
        let Planned { name, fmu, .. } = planned;
        let others = transfers.others.iter();
        let reals = initial(&transfers.reals.inputs, fmu, starts);
        Ok(Self {
            name,
            instance: fmu.instantiate(index, name, messages)?,
            messages: messages.clone(),
            calls: messages.record().calls(index),
            do_step: Function::of(fmu.version, "do_step"),
            reals: reals.iter().map(number).collect(),
            others: others.map(|o| initial(&o.inputs, fmu, starts)).collect(),
            fmu: fmu.clone(),
            transfers,
        })
    }

    /// Calls the function that performs an operation; `what` describes the purpose of the call to the user.
    pub(crate) fn call(
        &mut self,
        operation: &str,
        what: &str,
        call: impl FnOnce(&mut fmu_host::Instance) -> fmu_host::Result,
    ) -> Called {
        self.calls.begin(Function::of(self.fmu.version, operation));
        let outcome = call(&mut self.instance);
        self.explain(outcome, || what.to_owned())
    }

    /// Handles a warning or an error of a call.
    #[cold]
    #[inline(never)]
    fn explain(&mut self, outcome: fmu_host::Result, what: impl FnOnce() -> String) -> Called {
        let failure = match outcome {
            Ok(Success::Ok) => return Ok(()),
            Ok(Success::Warning(function)) => {
                self.messages.warn(self.name, function);
                return Ok(());
            }
            Err(failure) => failure,
        };
        Err(Box::new(Failure {
            component: self.name.to_owned(),
            fmu: self.fmu.file_name(),
            function: failure.function,
            what: what(),
            time: None,
            outcome: failure.outcome(),
            message: self.messages.reason(failure.function),
        }))
    }

    #[inline(always)]
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Called {
        self.calls.begin(self.do_step);
        match self.instance.do_step(time, step) {
            Ok(Success::Ok) => Ok(()),
            outcome => self.explain(outcome, || format!("step of {step:?} s")),
        }
    }

    /// Reads its outputs, each once.
    #[inline(always)]
    pub(crate) fn read(&mut self, outputs: &mut Store) -> Called {
        let Transfers { reals, others, .. } = self.transfers;
        if let (true, Place::Real(first)) = (reals.outputs.are_all, reals.first) {
            let values = &mut outputs.reals[first..][..reals.outputs.elements];
            self.calls.begin(reals.get);
            match self.instance.get_float64(&reals.outputs.references, values) {
                Ok(Success::Ok) => {}
                outcome => self.explain_reading(outcome, &reals.outputs)?,
            }
        } else {
            self.read_values(reals, outputs)?;
        }
        match others.is_empty() {
            true => Ok(()),
            false => (others.iter()).try_for_each(|ports| self.read_values(ports, outputs)),
        }
    }

    #[inline(never)]
    fn read_values(&mut self, ports: &Ports, outputs: &mut Store) -> Called {
        let values = self.get(ports, &ports.outputs)?;
        for (index, value) in values.into_iter().enumerate() {
            outputs.set(ports.first.plus(index), value);
        }
        Ok(())
    }

    /// Gets scalars of one type, which may be some elements of arrays.
    fn get(&mut self, ports: &Ports, scalars: &Wired) -> Called<Vec<Value>> {
        if scalars.references.is_empty() {
            return Ok(Vec::new());
        }
        let mut all = vec![Value::Boolean(false); scalars.elements];
        self.calls.begin(ports.get);
        let references = &scalars.references;
        let outcome = self.instance.get_values(ports.kind, references, &mut all);
        if outcome != Ok(Success::Ok) {
            self.explain_reading(outcome, scalars)?;
        }
        let positions = scalars.positions.iter();
        let take = |position: &usize| std::mem::replace(&mut all[*position], Value::Boolean(false));
        Ok(positions.map(take).collect())
    }

    #[cold]
    fn explain_reading(&mut self, outcome: fmu_host::Result, scalars: &Wired) -> Called {
        let names = scalars.scalars.iter().map(|scalar| self.fmu.name(*scalar));
        let what = Vec::from_iter(names).join(", ");
        self.explain(outcome, || what)
    }

    /// Writes its inputs.
    #[inline(always)]
    pub(crate) fn write(&mut self, outputs: &Store) -> Called {
        let Transfers { reals, others, .. } = self.transfers;
        let Wired {
            references,
            elements,
            ..
        } = &reals.inputs;
        if !references.is_empty() {
            let values = match reals.run {
                Some(first) => &outputs.reals[first..][..*elements],
                None => {
                    for (position, source) in reals.inputs.positions.iter().zip(&reals.sources) {
                        let output = outputs.number(source.output);
                        let scale = source.scale.map(|s| s.factor * output + s.offset);
                        self.reals[*position] = scale.unwrap_or(output);
                    }
                    &self.reals
                }
            };
            self.calls.begin(reals.set);
            match self.instance.set_float64(references, values) {
                Ok(Success::Ok) => {}
                outcome => {
                    let values = Vec::from_iter(values.iter().map(|value| Value::Float64(*value)));
                    self.explain_writing(outcome, &reals.inputs, &values)?;
                }
            }
        }
        match others.is_empty() {
            true => Ok(()),
            false => self.write_others(outputs),
        }
    }

    #[inline(never)]
    fn write_others(&mut self, outputs: &Store) -> Called {
        for (index, ports) in self.transfers.others.iter().enumerate() {
            let Ports {
                inputs, sources, ..
            } = ports;
            if inputs.references.is_empty() {
                continue;
            }
            let mut values = std::mem::take(&mut self.others[index]);
            for (position, source) in inputs.positions.iter().zip(sources) {
                let output = outputs.number(source.output);
                let scale = source
                    .scale
                    .map(|s| Value::Float64(s.factor * output + s.offset));
                values[*position] = scale.unwrap_or_else(|| outputs.value(source.output));
            }
            self.calls.begin(ports.set);
            let outcome = (self.instance).set_values(ports.kind, &inputs.references, &values);
            if outcome != Ok(Success::Ok) {
                self.explain_writing(outcome, inputs, &values)?;
            }
            self.others[index] = values;
        }
        Ok(())
    }

    #[cold]
    fn explain_writing(
        &mut self,
        outcome: fmu_host::Result,
        inputs: &Wired,
        values: &[Value],
    ) -> Called {
        let pairs = inputs.scalars.iter().zip(&inputs.positions);
        let texts = pairs.map(|(scalar, position)| {
            let (name, value) = (self.fmu.name(*scalar), shown(&values[*position]));
            format!("{name} = {value}")
        });
        let what = Vec::from_iter(texts).join(", ");
        self.explain(outcome, || what)
    }

    /// Sets start values; those of an array together, with those that the model description has for the
    /// others.
    pub(crate) fn start(&mut self, starts: &BTreeMap<usize, &Value>) -> Called {
        let fmu = self.fmu.clone();
        let mut given = starts.keys().copied().peekable();
        while let Some(scalar) = given.next() {
            let array = fmu.array(scalar);
            let mut wired = Wired::default();
            wired.push(&fmu, scalar);
            while let Some(other) = given.next_if(|other| array.contains(other)) {
                wired.push(&fmu, other);
            }
            let values = initial(&wired, &fmu, starts);
            let kind = fmu.access(scalar);
            self.calls
                .begin(Function::of(fmu.version, &operation("set", kind)));
            let outcome = (self.instance).set_values(kind, &wired.references, &values);
            self.explain_writing(outcome, &wired, &values)?;
        }
        Ok(())
    }

    pub(crate) fn fmu(&self) -> &Arc<Fmu> {
        &self.fmu
    }
}

impl Drop for Component<'_> {
    /// Records that the FMU is about to be called; the field `instance` frees it.
    fn drop(&mut self) {
        self.calls
            .begin(Function::of(self.fmu.version, "free_instance"));
    }
}

/// The values of inputs before any is connected: of arrays, the start values, since an array is set as a
/// whole.
fn initial(inputs: &Wired, fmu: &Fmu, starts: &BTreeMap<usize, &Value>) -> Vec<Value> {
    let mut values = vec![Value::Boolean(false); inputs.elements];
    let mut last = None;
    for (scalar, position) in inputs.scalars.iter().zip(&inputs.positions) {
        let first = position - fmu.scalars[*scalar].element;
        if last.replace(first) == Some(first) {
            continue;
        }
        for (value, scalar) in values[first..].iter_mut().zip(fmu.array(*scalar)) {
            let start = starts.get(&scalar).copied().or(fmu.start(scalar));
            *value = start.cloned().unwrap_or(Value::Boolean(false));
        }
    }
    values
}

/// Reads the outputs that feed a component, and only these, as not every recorded variable can be read
/// during the initialization; then writes its inputs. Returns whether an output has changed.
pub(crate) fn propagate(
    components: &mut [Component<'_>],
    fed: usize,
    outputs: &mut Store,
) -> Called<bool> {
    let mut changed = false;
    for ports in components[fed].transfers.all() {
        let same = |a: &Source, b: &Source| (a.component, a.kind) == (b.component, b.kind);
        for sources in ports.sources.chunk_by(same) {
            let component = &mut components[sources[0].component];
            let mut scalars = Wired::default();
            for source in sources {
                scalars.push(&component.fmu, source.scalar);
            }
            let mut all = component.transfers.all();
            let Some(from) = all.find(|ports| ports.kind == sources[0].kind) else {
                continue;
            };
            for (source, value) in sources.iter().zip(component.get(from, &scalars)?) {
                changed |= outputs.value(source.output) != value;
                outputs.set(source.output, value);
            }
        }
    }
    components[fed].write(outputs)?;
    Ok(changed)
}
