//! A running FMU: its calls, and the transfer of values from outputs to inputs.

use std::fmt::Display;
use std::sync::Arc;

use anyhow::Result;
use fmu_description::{Causality, Type, Value};
use fmu_host::{Cause, Instance, InterfaceType, Listed, Status, Success, Unusual};
use fmu_worker::Function;

use crate::access_list::{AccessList, accessor};
use crate::components::LoadedComponent;
use crate::input::TableInputs;
use crate::integrator::{self, Integrator, RecordedInstance, StepError};
use crate::start::StartValues;
use crate::store::{Store, Transfer, number};
use crate::wiring::{FeedingOutputs, VariableGroup};
use crate::{FailedCall, Fmu, Messages, RunError};

/// The outcome of a call.
pub(crate) type Called<T = ()> = Result<T, Box<RunError>>;

/// A component and what is transferred from and to it.
pub(crate) struct ComponentInstance<'a> {
    /// Must be dropped before the FMU, which removes its files.
    pub(crate) recorded: RecordedInstance,
    pub(crate) fmu: Arc<Fmu>,
    /// Present once a component of model exchange is initialized.
    pub(crate) integrator: Option<Box<Integrator<'a>>>,
    do_step: Option<Function>,
    /// What sets its Float64 inputs, and what gets its Float64 outputs unless their values must be distributed.
    set: Option<Function>,
    get: Option<Function>,
    /// The outputs whose values must be distributed.
    distributed: &'a [VariableGroup],
    /// The Float64 inputs whose values are collected in `reals`, with the outputs that feed them.
    copied: &'a [Transfer],
    ports: &'a [VariableGroup],
    /// The values of its inputs of the type Float64, and of each other type; those of elements that are not
    /// connected stay.
    reals: Vec<f64>,
    others: Vec<Vec<Value>>,
}

impl<'a> ComponentInstance<'a> {
    /// Instantiates a component; `starts` are the start values that the user has given, by the indices of
    /// the scalars.
    pub(crate) fn new(
        index: usize,
        planned: &LoadedComponent,
        ports: &'a [VariableGroup],
        starts: &StartValues<'_>,
        messages: &Messages,
    ) -> Result<Self> {
        let LoadedComponent { name, fmu, .. } = planned;
        let mut inputs = ports.iter().map(|ports| starts.initial(&ports.inputs, fmu));
        let reals = inputs.next().unwrap_or_default();
        let mut instance = fmu.instantiate(index, name, messages)?;
        // An FMU that is stepped by hand has none.
        let floats = ports.first();
        if let Some(VariableGroup { inputs, run, whole, .. }) = floats {
            let set_at_steps = run.clone().unwrap_or_else(|| inputs.listed(0));
            let get_at_steps = whole.clone().unwrap_or_else(|| Listed::new(&[], 0..0));
            instance.access_at_steps(set_at_steps, get_at_steps);
        }
        let has_whole = floats.is_some_and(|ports| ports.whole.is_some());
        Ok(Self {
            set: floats.and_then(|p| p.set.filter(|_| !p.inputs.references.is_empty())),
            get: floats.and_then(|p| p.get.filter(|_| has_whole)),
            distributed: &ports[usize::from(has_whole)..],
            copied: floats.filter(|p| p.run.is_none()).map_or(&[], |p| &*p.copied),
            recorded: RecordedInstance {
                instance,
                calls: messages.record().calls(index),
                functions: integrator::functions(fmu.version),
                messages: messages.clone(),
                name: name.clone(),
                version: fmu.version,
            },
            integrator: None,
            do_step: Function::performing(fmu.version, "do_step"),
            reals: reals.iter().map(number).collect(),
            others: inputs.collect(),
            fmu: fmu.clone(),
            ports,
        })
    }

    /// Calls the function that performs an operation; `what` describes the purpose of the call to the user.
    pub(crate) fn call(
        &mut self,
        operation: &str,
        what: impl Display,
        call: impl FnOnce(&mut Instance) -> fmu_host::Result,
    ) -> Called {
        self.recorded.calls.begin(Function::performing(self.fmu.version, operation));
        let outcome = call(&mut self.recorded.instance);
        self.check(outcome, || what.to_string())
    }

    /// Sets up the experiment from the start to the stop time (s), and sets start values.
    pub(crate) fn set_up(
        &mut self,
        (start, stop): (f64, Option<f64>),
        tolerance: Option<f64>,
        starts: &StartValues<'_>,
    ) -> Called {
        self.call("setup_experiment", "set-up of the experiment", |instance| {
            instance.setup_experiment(start, stop, tolerance)
        })?;
        let fmu = self.fmu.clone();
        let is_size =
            |scalar: &usize| fmu.variable(*scalar).causality == Causality::StructuralParameter;
        if starts.scalars().any(|scalar| is_size(&scalar)) {
            self.call(
                "enter_configuration_mode",
                "start of the configuration",
                Instance::enter_configuration_mode,
            )?;
            self.start(starts, is_size)?;
            self.call(
                "exit_configuration_mode",
                "end of the configuration",
                Instance::exit_configuration_mode,
            )?;
        }
        self.start(starts, |scalar| !is_size(scalar))
    }

    pub(crate) fn enter_initialization(&mut self) -> Called {
        self.call(
            "enter_initialization_mode",
            "start of the initialization",
            Instance::enter_initialization_mode,
        )
    }

    pub(crate) fn exit_initialization(&mut self) -> Called {
        self.call(
            "exit_initialization_mode",
            "end of the initialization",
            Instance::exit_initialization_mode,
        )
    }

    /// Handles a warning or an error of a call.
    #[cold]
    #[inline(never)]
    fn check(&mut self, outcome: fmu_host::Result, what: impl FnOnce() -> String) -> Called {
        let failure = match outcome {
            Ok(Success::Ok) => return Ok(()),
            Ok(Success::Warning(function)) => {
                self.recorded.messages.warn(&self.recorded.name, function);
                return Ok(());
            }
            Err(failure) => failure,
        };
        Err(self.call_error(failure, what()))
    }

    fn call_error(&self, failure: fmu_host::Failure, what: String) -> Box<RunError> {
        let ended = match failure.cause {
            Cause::Terminated(time) => Some(time),
            _ => None,
        };
        Box::new(RunError { ended, ..self.error(failure.function, what, failure.outcome()) })
    }

    /// The error of a call of this function; empty if the master cannot integrate the equations.
    fn error(&self, function: &str, purpose: String, outcome: String) -> RunError {
        let (component, fmu) = (self.recorded.name.clone(), self.fmu.file_name());
        let call = FailedCall { component, fmu, function: function.to_owned(), purpose };
        RunError::in_call(call, outcome, self.recorded.messages.reason(function))
    }

    /// Takes a step. Whether the system is `PLAIN`, with neither model exchange nor faults, is known at compile
    /// time, so that a plain system does not ask at each step.
    #[inline(always)]
    pub(crate) fn step<const PLAIN: bool>(&mut self, time: f64, step: f64) -> Called {
        if !PLAIN && let Some(integrator) = &mut self.integrator {
            let stepped = integrator.step(&mut self.recorded, time, step);
            if stepped.is_ok() {
                self.recorded.calls.begin(None);
            }
            return stepped.map_err(|error| self.to_error(error, format!("step of {step:?} s")));
        }
        // The communication point tells calls of a plain system apart.
        match PLAIN {
            true => self.recorded.calls.continue_call(self.do_step),
            false => self.recorded.calls.begin(self.do_step),
        }
        match self.recorded.instance.do_step_quickly(time, step) {
            None => Ok(()),
            Some(outcome) => self.check_step(*outcome, time, step),
        }
    }

    /// Writes its inputs, takes a step and reads its outputs, of a plain system.
    #[inline(always)]
    pub(crate) fn cycle(&mut self, outputs: &mut Store, time: f64, step: f64) -> Called {
        match self.copied.is_empty() {
            true => self.cycle_from::<false>(outputs, time, step),
            false => self.cycle_from_copies(outputs, time, step),
        }
    }

    #[inline(never)]
    fn cycle_from_copies(&mut self, outputs: &mut Store, time: f64, step: f64) -> Called {
        self.copy(outputs);
        self.cycle_from::<true>(outputs, time, step)
    }

    /// [`ComponentInstance::cycle`] with inputs that are `COPIED`, or follow each other among the outputs that feed them.
    #[inline(always)]
    fn cycle_from<const COPIED: bool>(
        &mut self,
        outputs: &mut Store,
        time: f64,
        step: f64,
    ) -> Called {
        let RecordedInstance { instance, calls, .. } = &mut self.recorded;
        let functions = [self.set, self.do_step, self.get];
        let begin = |call: usize| calls.continue_call(functions[call]);
        let inputs = COPIED.then_some(&*self.reals);
        match instance.cycle(inputs, time, step, &mut outputs.reals, begin) {
            (3, None) => Ok(()),
            (done, outcome) => self.end_cycle(done, outcome, outputs, time, step),
        }
    }

    /// Makes the rest of the calls of a cycle after some, of which the last one has this outcome.
    #[cold]
    #[inline(never)]
    fn end_cycle(
        &mut self,
        done: usize,
        outcome: Unusual,
        outputs: &mut Store,
        time: f64,
        step: f64,
    ) -> Called {
        match (done, outcome) {
            (_, None) => {}
            (1, Some(outcome)) => self.check_writing_reals(*outcome, outputs)?,
            (2, Some(outcome)) => self.check_step(*outcome, time, step)?,
            (_, Some(outcome)) => self.check_reading(*outcome, &self.ports[0].outputs)?,
        }
        if done < 1 {
            self.write::<true>(outputs)?;
        }
        if done < 2 {
            self.step::<true>(time, step)?;
        }
        if done < 3 {
            self.read::<true>(outputs)?;
        }
        Ok(())
    }

    /// Begins the integration after the initialization, if it is a component of model exchange.
    pub(crate) fn begin(
        &mut self,
        signals: Option<TableInputs<'a>>,
        tolerance: Option<f64>,
        times: (f64, f64),
    ) -> Called {
        if self.fmu.interface_type == InterfaceType::ModelExchange {
            let (fmu, ports) = (self.fmu.clone(), self.ports);
            let begun =
                Integrator::begin(&mut self.recorded, &fmu, ports, signals, tolerance, times);
            let begun = begun.map_err(|error| self.to_error(error, "first event".to_owned()))?;
            self.integrator = Some(Box::new(begun));
        }
        Ok(())
    }

    /// The failure of an integration.
    #[cold]
    pub(crate) fn to_error(&mut self, error: StepError, what: String) -> Box<RunError> {
        let (failure, what) = match error {
            StepError::Call(failure, place) if place.is_empty() => (failure, what),
            StepError::Call(failure, place) => (failure, format!("{place}, {what}")),
            StepError::Equations { reason, .. } => {
                return Box::new(self.error("", what, reason));
            }
        };
        self.call_error(failure, what)
    }

    /// Handles a warning or an error of a step. Whether a discarded step of FMI 2.0 ends the simulation is asked
    /// for, as few FMUs can tell.
    #[cold]
    fn check_step(&mut self, outcome: fmu_host::Result, time: f64, step: f64) -> Called {
        let is_discarded =
            matches!(&outcome, Err(f) if f.cause == Cause::Returned(Status::Discard));
        let checked = self.check(outcome, || format!("step of {step:?} s"));
        checked.map_err(|mut failure| {
            self.recorded.calls.begin(Function::named("fmi2GetBooleanStatus"));
            if is_discarded && self.recorded.instance.is_terminated() == Ok(true) {
                self.recorded.calls.begin(Function::named("fmi2GetRealStatus"));
                failure.ended = Some(self.recorded.instance.last_successful_time().unwrap_or(time));
                failure.outcome = Cause::Terminated(time).to_string();
            }
            failure
        })
    }

    /// Reads its outputs, each once; if the system is `PLAIN`, all are Float64 and need not be distributed.
    #[inline(always)]
    pub(crate) fn read<const PLAIN: bool>(&mut self, outputs: &mut Store) -> Called {
        self.recorded.calls.continue_call(self.get);
        if let Some(outcome) = self.recorded.instance.get_at_step(&mut outputs.reals) {
            self.check_reading(*outcome, &self.ports[0].outputs)?;
        }
        if PLAIN { Ok(()) } else { self.read_others(outputs) }
    }

    #[inline(never)]
    fn read_others(&mut self, outputs: &mut Store) -> Called {
        for ports in self.distributed {
            let values = self.get(ports.kind, ports.get, &ports.outputs)?;
            for (index, value) in values.into_iter().enumerate() {
                outputs.set(ports.first.plus(index), value);
            }
        }
        Ok(())
    }

    /// Gets scalars of one type, which may be some elements of arrays.
    pub(crate) fn get(
        &mut self,
        kind: Type,
        get: Option<Function>,
        scalars: &AccessList,
    ) -> Called<Vec<Value>> {
        if scalars.references.is_empty() {
            return Ok(Vec::new());
        }
        let mut all = vec![Value::Boolean(false); scalars.elements];
        self.recorded.calls.begin(get);
        let outcome = (self.recorded.instance).get_values(kind, &scalars.references, &mut all);
        if outcome != Ok(Success::Ok) {
            self.check_reading(outcome, scalars)?;
        }
        if scalars.are_all {
            return Ok(all);
        }
        // An element may feed several inputs.
        Ok(scalars.positions.iter().map(|position| all[*position].clone()).collect())
    }

    #[cold]
    fn check_reading(&mut self, outcome: fmu_host::Result, scalars: &AccessList) -> Called {
        let names = scalars.scalars.iter().map(|scalar| self.fmu.name(*scalar));
        let what = Vec::from_iter(names).join(", ");
        self.check(outcome, || what)
    }

    /// Writes its inputs; if the system is `PLAIN`, all are values of Float64 outputs.
    #[inline(always)]
    pub(crate) fn write<const PLAIN: bool>(&mut self, outputs: &Store) -> Called {
        let mut values = &outputs.reals;
        if !PLAIN && self.ports[0].run.is_none() {
            self.collect(outputs);
            values = &self.reals;
        } else if !self.copied.is_empty() {
            self.copy(outputs);
            values = &self.reals;
        }
        if self.set.is_some() {
            self.recorded.calls.continue_call(self.set);
            if let Some(outcome) = self.recorded.instance.set_at_step(values) {
                self.check_writing_reals(*outcome, outputs)?;
            }
        }
        if PLAIN { Ok(()) } else { self.write_others(outputs) }
    }

    /// Writes its inputs during the initialization, in which it is called again and again.
    pub(crate) fn write_initially(&mut self, outputs: &Store) -> Called {
        self.recorded.calls.begin(None);
        self.write::<false>(outputs)
    }

    /// Copies the values of its Float64 inputs.
    #[inline(always)]
    fn copy(&mut self, outputs: &Store) {
        for &Transfer { from, to } in self.copied {
            self.reals[to] = outputs.reals[from];
        }
    }

    /// Collects the values of its Float64 inputs.
    #[inline(never)]
    fn collect(&mut self, outputs: &Store) {
        let VariableGroup { inputs, sources, .. } = &self.ports[0];
        for (position, source) in inputs.positions.iter().zip(sources) {
            let output = outputs.number(source.output);
            let conversion = source.conversion.map(|s| s.factor * output + s.offset);
            self.reals[*position] = conversion.unwrap_or(output);
        }
    }

    #[inline(never)]
    fn write_others(&mut self, outputs: &Store) -> Called {
        for (index, ports) in self.ports[1..].iter().enumerate() {
            let inputs = &ports.inputs;
            if inputs.references.is_empty() {
                continue;
            }
            let mut values = std::mem::take(&mut self.others[index]);
            for (position, source) in inputs.positions.iter().zip(&ports.sources) {
                let scaled = source
                    .conversion
                    .map(|s| Value::Float64(s.factor * outputs.number(source.output) + s.offset));
                values[*position] = scaled.unwrap_or_else(|| outputs.value(source.output));
            }
            self.set(ports.kind, ports.set, inputs, &values)?;
            self.others[index] = values;
        }
        Ok(())
    }

    /// Sets variables of one type, with the values of all elements.
    pub(crate) fn set(
        &mut self,
        kind: Type,
        set: Option<Function>,
        scalars: &AccessList,
        values: &[Value],
    ) -> Called {
        self.recorded.calls.begin(set);
        let outcome = self.recorded.instance.set_values(kind, &scalars.references, values);
        match outcome {
            Ok(Success::Ok) => Ok(()),
            _ => self.check_writing(outcome, scalars, values),
        }
    }

    #[cold]
    fn check_writing_reals(&mut self, outcome: fmu_host::Result, outputs: &Store) -> Called {
        let values = match &self.ports[0].run {
            Some(run) => &outputs.reals[run.place()],
            None => &*self.reals,
        };
        let values = Vec::from_iter(values.iter().map(|value| Value::Float64(*value)));
        self.check_writing(outcome, &self.ports[0].inputs, &values)
    }

    #[cold]
    fn check_writing(
        &mut self,
        outcome: fmu_host::Result,
        inputs: &AccessList,
        values: &[Value],
    ) -> Called {
        let pairs = inputs.scalars.iter().zip(&inputs.positions);
        let texts = pairs.map(|(scalar, position)| {
            let name = self.fmu.name(*scalar);
            match &values[*position] {
                Value::String(text) => format!("{name} = {text:?}"),
                value => format!("{name} = {value}"),
            }
        });
        let what = Vec::from_iter(texts).join(", ");
        self.check(outcome, || what)
    }

    /// Sets the start values that are wanted; those of an array together, with those that the model description
    /// has for the others.
    fn start(&mut self, starts: &StartValues<'_>, is_wanted: impl Fn(&usize) -> bool) -> Called {
        let fmu = self.fmu.clone();
        let given = Vec::from_iter(starts.scalars().filter(is_wanted));
        for same in given.chunk_by(|a, b| fmu.array(*a) == fmu.array(*b)) {
            let (kind, wired) =
                (fmu.access_type(same[0]), AccessList::of(&fmu, same.iter().copied()));
            let values = starts.initial(&wired, &fmu);
            let set = match self.ports.iter().find(|ports| ports.kind == kind) {
                Some(ports) => ports.set,
                None => accessor("set", fmu.version, kind),
            };
            self.set(kind, set, &wired, &values)?;
        }
        Ok(())
    }
}

impl Drop for ComponentInstance<'_> {
    /// Records that the FMU is about to be called; the field `recorded` frees it.
    fn drop(&mut self) {
        self.recorded.calls.begin(Function::performing(self.fmu.version, "free_instance"));
    }
}

/// Reads the outputs that feed a component, and only these, as not every recorded variable can be read
/// during the initialization.
pub(crate) fn receive(
    components: &mut [ComponentInstance<'_>],
    feeds: &[FeedingOutputs],
    outputs: &mut Store,
) -> Called<Vec<Value>> {
    let mut all = Vec::new();
    for feed in feeds {
        let values = components[feed.component].get(feed.kind, feed.get, &feed.outputs)?;
        for (place, value) in feed.places.iter().zip(&values) {
            outputs.set(*place, value.clone());
        }
        all.extend(values);
    }
    Ok(all)
}
