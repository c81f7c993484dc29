//! A component in one run: the calls of its FMU, and the transfer of values between its variables and the store. Runs in
//! the worker process.

use std::borrow::Borrow;
use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use fmu_description::{Causality, Type, Value};
use fmu_host::{Cause, Instance, InterfaceType, NotOk, Status, StepVariables, Success};
use fmu_worker::Function;

use crate::access_list::{AccessList, accessor};
use crate::component_clocks::ComponentClocks;
use crate::components::LoadedComponent;
use crate::event_mode::EventMode;
use crate::integrator::Integrator;
use crate::recorded_instance::{IntegrationError, IntegrationResult, RecordedInstance, functions};
use crate::start::ComponentStarts;
use crate::store::{Place, Store, Transfer, number};
use crate::table::excerpt;
use crate::table_inputs::TableInputs;
use crate::table_parameters::TableParameters;
use crate::wiring::{FeedingOutputs, VariableGroup};
use crate::{FailedCall, Fmu, Messages, RunError};

/// The outcome of a call.
pub(crate) type CallResult<T = ()> = Result<T, Box<RunError>>;

/// A component in one run. The groups of its variables are described in [`wiring`](crate::wiring).
pub(crate) struct ComponentInstance<'a> {
    /// Must be dropped before the FMU, which removes its files.
    pub(crate) recorded: RecordedInstance,
    pub(crate) fmu: Arc<Fmu>,
    /// Present once a component of model exchange is initialized.
    pub(crate) integrator: Option<Box<Integrator<'a>>>,
    /// Present once a component of co-simulation with event mode is initialized.
    pub(crate) event_mode: Option<Box<EventMode>>,
    /// Present once a component with clocks is initialized.
    pub(crate) clocks: Option<Box<ComponentClocks>>,
    do_step: Option<Function>,
    /// The function that sets its Float64 inputs, and the one that gets its direct outputs.
    set: Option<Function>,
    get: Option<Function>,
    /// The groups whose outputs are not got directly into the store.
    distributed: &'a [VariableGroup],
    /// The Float64 inputs whose values are copied from the store to `reals`.
    copied: &'a [Transfer],
    groups: &'a [VariableGroup],
    /// The values of its inputs of the type Float64, and of each other type; elements that are not connected keep
    /// their start values.
    reals: Vec<f64>,
    others: Vec<Vec<Value>>,
    /// Its tunable parameters that have values from a table.
    pub(crate) parameters: Option<TableParameters<'a>>,
    /// How long it has taken in this step, if that is measured.
    pub(crate) duration: Option<Duration>,
}

impl<'a> ComponentInstance<'a> {
    /// Instantiates a component; elements of inputs that are not connected have these start values.
    pub(crate) fn new(
        index: usize,
        component: &LoadedComponent,
        groups: &'a [VariableGroup],
        starts: &ComponentStarts<'_>,
        messages: &Messages,
    ) -> Result<Self> {
        let LoadedComponent { name, fmu, .. } = component;
        let mut inputs = groups.iter().map(|group| starts.initial(&group.inputs, fmu));
        let reals = inputs.next().unwrap_or_default();
        let mut instance = fmu.instantiate((index, name), component.event_mode, messages)?;
        // An FMU that is stepped by hand has no groups.
        let floats = groups.first();
        if let Some(VariableGroup { inputs, direct_inputs, direct_outputs, .. }) = floats {
            let set_at_steps = direct_inputs.clone().unwrap_or_else(|| inputs.placed_at(0));
            let get_at_steps =
                direct_outputs.clone().unwrap_or_else(|| StepVariables::new(&[], 0..0));
            instance.access_at_steps(set_at_steps, get_at_steps);
        }
        let are_outputs_direct = floats.is_some_and(|group| group.direct_outputs.is_some());
        let copied = floats.filter(|group| group.direct_inputs.is_none());
        Ok(Self {
            set: floats.and_then(|g| g.set.filter(|_| !g.inputs.references.is_empty())),
            get: floats.and_then(|g| g.get.filter(|_| are_outputs_direct)),
            distributed: &groups[usize::from(are_outputs_direct)..],
            copied: copied.map_or(&[], |group| &*group.copied_inputs),
            recorded: RecordedInstance {
                instance,
                calls: messages.record().calls(index),
                functions: functions(fmu.version),
                messages: messages.clone(),
                name: name.clone(),
                version: fmu.version,
            },
            integrator: None,
            event_mode: None,
            clocks: None,
            do_step: Function::performing(fmu.version, "do_step"),
            reals: reals.iter().map(number).collect(),
            others: inputs.collect(),
            parameters: None,
            duration: None,
            fmu: fmu.clone(),
            groups,
        })
    }

    /// Calls the function that performs an operation; `what` describes the purpose of the call to the user.
    pub(crate) fn call(
        &mut self,
        operation: &str,
        what: impl Display,
        call: impl FnOnce(&mut Instance) -> fmu_host::Result,
    ) -> CallResult {
        self.recorded.calls.begin(Function::performing(self.fmu.version, operation));
        let outcome = call(&mut self.recorded.instance);
        self.check(outcome, || what.to_string())
    }

    /// Sets up the experiment from the start to the stop time (s), and sets the start values: first those of structural
    /// parameters.
    pub(crate) fn set_up(
        &mut self,
        (start, stop): (f64, Option<f64>),
        tolerance: Option<f64>,
        starts: &ComponentStarts<'_>,
    ) -> CallResult {
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
            self.set_starts(starts, is_size)?;
            self.call(
                "exit_configuration_mode",
                "end of the configuration",
                Instance::exit_configuration_mode,
            )?;
        }
        self.set_starts(starts, |scalar| !is_size(scalar))
    }

    pub(crate) fn enter_initialization(&mut self) -> CallResult {
        self.call(
            "enter_initialization_mode",
            "start of the initialization",
            Instance::enter_initialization_mode,
        )
    }

    pub(crate) fn exit_initialization(&mut self) -> CallResult {
        self.call(
            "exit_initialization_mode",
            "end of the initialization",
            Instance::exit_initialization_mode,
        )
    }

    /// Handles a warning or an error of a call.
    #[cold]
    #[inline(never)]
    pub(crate) fn check(
        &mut self,
        outcome: fmu_host::Result,
        what: impl FnOnce() -> String,
    ) -> CallResult {
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
    pub(crate) fn step<const PLAIN: bool>(&mut self, time: f64, step: f64) -> CallResult {
        if !PLAIN && let Some(integrator) = &mut self.integrator {
            let stepped = integrator.step(&mut self.recorded, time, step);
            if stepped.is_ok() {
                self.recorded.calls.begin(None);
            }
            return stepped
                .map_err(|error| self.integration_error(error, format!("step of {step:?} s")));
        }
        if !PLAIN && let Some(event_mode) = &mut self.event_mode {
            let stepped = event_mode.step(&mut self.recorded, time, step);
            return stepped
                .map_err(|error| self.integration_error(error, format!("step of {step:?} s")));
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

    /// Enters event mode before its inputs for a step from a time (s) are set, if it must be in it.
    pub(crate) fn prepare_inputs(&mut self, time: f64, step: f64) -> CallResult {
        let Some(event_mode) = &mut self.event_mode else { return Ok(()) };
        let prepared = event_mode.prepare(&mut self.recorded, time, step);
        prepared.map_err(|error| self.integration_error(error, "event".to_owned()))
    }

    /// Sets its inputs, takes a step and gets its outputs, in a plain system.
    #[inline(always)]
    pub(crate) fn cycle(&mut self, outputs: &mut Store, time: f64, step: f64) -> CallResult {
        match self.copied.is_empty() {
            true => self.cycle_from::<false>(outputs, time, step),
            false => self.cycle_from_copies(outputs, time, step),
        }
    }

    #[inline(never)]
    fn cycle_from_copies(&mut self, outputs: &mut Store, time: f64, step: f64) -> CallResult {
        self.copy(outputs);
        self.cycle_from::<true>(outputs, time, step)
    }

    /// [`ComponentInstance::cycle`] with inputs that are `COPIED`, or set directly from the store.
    #[inline(always)]
    fn cycle_from<const COPIED: bool>(
        &mut self,
        outputs: &mut Store,
        time: f64,
        step: f64,
    ) -> CallResult {
        let RecordedInstance { instance, calls, .. } = &mut self.recorded;
        let functions = [self.set, self.do_step, self.get];
        let begin = |call: usize| calls.continue_call(functions[call]);
        let inputs = COPIED.then_some(&*self.reals);
        match instance.cycle(inputs, time, step, &mut outputs.reals, begin) {
            (3, None) => Ok(()),
            (done, outcome) => self.end_cycle(done, outcome, outputs, time, step),
        }
    }

    /// Makes the rest of the calls of a cycle after `done` calls, of which the last one has this outcome.
    #[cold]
    #[inline(never)]
    fn end_cycle(
        &mut self,
        done: usize,
        outcome: NotOk,
        outputs: &mut Store,
        time: f64,
        step: f64,
    ) -> CallResult {
        match (done, outcome) {
            (_, None) => {}
            (1, Some(outcome)) => self.check_writing_reals(*outcome, outputs)?,
            (2, Some(outcome)) => self.check_step(*outcome, time, step)?,
            (_, Some(outcome)) => self.check_reading(*outcome, &self.groups[0].outputs)?,
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

    /// Begins after the initialization: the integration of a component of model exchange, or event mode.
    pub(crate) fn begin(
        &mut self,
        inputs: Option<TableInputs<'a>>,
        planned: &LoadedComponent,
        times: (f64, f64),
    ) -> CallResult {
        if self.fmu.interface_type == InterfaceType::ModelExchange {
            let (fmu, groups) = (self.fmu.clone(), self.groups);
            let method = (planned.solver, planned.tolerance);
            let begun = Integrator::begin(&mut self.recorded, &fmu, groups, inputs, method, times);
            let begun =
                begun.map_err(|error| self.integration_error(error, "first event".to_owned()))?;
            self.integrator = Some(Box::new(begun));
        }
        if planned.event_mode && !planned.is_clocked() {
            let (start, _) = times;
            let begun = EventMode::begin(&mut self.recorded, &self.fmu, self.groups, start);
            let begun =
                begun.map_err(|error| self.integration_error(error, "first event".to_owned()))?;
            self.event_mode = Some(Box::new(begun));
        }
        Ok(())
    }

    /// The failure of an integration.
    #[cold]
    pub(crate) fn integration_error(
        &mut self,
        error: IntegrationError,
        what: String,
    ) -> Box<RunError> {
        let (failure, what) = match error {
            IntegrationError::Call(failure, place) if place.is_empty() => (failure, what),
            IntegrationError::Call(failure, place) => (failure, format!("{place}, {what}")),
            IntegrationError::Equations { reason, advice, .. } => {
                return Box::new(RunError { advice, ..self.error("", what, reason) });
            }
        };
        self.call_error(failure, what)
    }

    /// Handles a warning or an error of a step. Whether a discarded step of FMI 2.0 ends the simulation is asked
    /// for, as few FMUs can tell.
    #[cold]
    pub(crate) fn check_step(
        &mut self,
        outcome: fmu_host::Result,
        time: f64,
        step: f64,
    ) -> CallResult {
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

    /// Gets its outputs into the store, each once; in a `PLAIN` system, all are direct.
    #[inline(always)]
    pub(crate) fn read<const PLAIN: bool>(&mut self, outputs: &mut Store) -> CallResult {
        self.recorded.calls.continue_call(self.get);
        if let Some(outcome) = self.recorded.instance.get_at_step(&mut outputs.reals) {
            self.check_reading(*outcome, &self.groups[0].outputs)?;
        }
        if PLAIN { Ok(()) } else { self.read_others(outputs) }
    }

    #[inline(never)]
    fn read_others(&mut self, outputs: &mut Store) -> CallResult {
        for group in self.distributed {
            if !group.is_accessible(self.ticking()) {
                continue;
            }
            let values = self.get(group.access_type, group.get, &group.outputs)?;
            for (index, value) in values.into_iter().enumerate() {
                outputs.set(group.first_output.plus(index), value);
            }
        }
        Ok(())
    }

    /// The clocks that tick now, by value reference.
    fn ticking(&self) -> &[u32] {
        self.clocks.as_ref().map_or(&[], |clocks| clocks.active())
    }

    /// Gets scalars of one type, which may be some elements of arrays.
    pub(crate) fn get(
        &mut self,
        access_type: Type,
        get: Option<Function>,
        scalars: &AccessList,
    ) -> CallResult<Vec<Value>> {
        if scalars.references.is_empty() {
            return Ok(Vec::new());
        }
        let mut all = vec![Value::Boolean(false); scalars.elements];
        self.recorded.calls.begin(get);
        let outcome =
            (self.recorded.instance).get_values(access_type, &scalars.references, &mut all);
        if outcome != Ok(Success::Ok) {
            self.check_reading(outcome, scalars)?;
        }
        if scalars.is_complete {
            return Ok(all);
        }
        // An element may feed several inputs.
        Ok(scalars.positions.iter().map(|position| all[*position].clone()).collect())
    }

    #[cold]
    pub(crate) fn check_reading(
        &mut self,
        outcome: fmu_host::Result,
        scalars: &AccessList,
    ) -> CallResult {
        let names = scalars.scalars.iter().map(|scalar| self.fmu.name(*scalar));
        let what = Vec::from_iter(names).join(", ");
        self.check(outcome, || what)
    }

    /// Sets its inputs from the store; in a `PLAIN` system, all are direct or copied.
    #[inline(always)]
    pub(crate) fn write<const PLAIN: bool>(&mut self, outputs: &Store) -> CallResult {
        let mut values = &outputs.reals;
        if !PLAIN && self.groups[0].direct_inputs.is_none() {
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

    /// Sets its inputs during the initialization, in which it is called again and again.
    pub(crate) fn write_initially(&mut self, outputs: &Store) -> CallResult {
        self.recorded.calls.begin(None);
        self.write::<false>(outputs)
    }

    /// Copies the values of its Float64 inputs as they are.
    #[inline(always)]
    fn copy(&mut self, outputs: &Store) {
        for &Transfer { from, to } in self.copied {
            self.reals[to] = outputs.reals[from];
        }
    }

    /// Collects the values of its Float64 inputs, with conversions.
    #[inline(never)]
    fn collect(&mut self, outputs: &Store) {
        let VariableGroup { inputs, sources, .. } = &self.groups[0];
        for (position, source) in inputs.positions.iter().zip(sources) {
            let value = outputs.number(source.place);
            let converted = source.conversion.map(|conversion| conversion.apply(value));
            self.reals[*position] = converted.unwrap_or(value);
        }
    }

    #[inline(never)]
    fn write_others(&mut self, outputs: &Store) -> CallResult {
        for (index, group) in self.groups[1..].iter().enumerate() {
            let inputs = &group.inputs;
            if inputs.references.is_empty() || !group.is_accessible(self.ticking()) {
                continue;
            }
            let mut own = std::mem::take(&mut self.others[index]);
            let sources = inputs.positions.iter().zip(&group.sources);
            for (position, source) in sources.clone() {
                if source.conversion.is_some() || matches!(source.place, Place::Real(_)) {
                    let value = outputs.number(source.place);
                    let converted = source.conversion.map(|conversion| conversion.apply(value));
                    own[*position] = Value::Float64(converted.unwrap_or(value));
                }
            }
            // The others are set from where they are, which may be large.
            let mut values = Vec::from_iter(&own);
            for (position, source) in sources {
                if let (None, Place::Other(place)) = (source.conversion, source.place) {
                    values[*position] = &outputs.others[place];
                }
            }
            if group.access_type == Type::Binary {
                self.check_sizes(group, &values)?;
            }
            self.set(group.access_type, group.set, inputs, &values)?;
            self.others[index] = own;
        }
        Ok(())
    }

    /// Checks that no Binary is larger than its input allows.
    fn check_sizes(&self, group: &VariableGroup, values: &[&Value]) -> CallResult {
        let AccessList { scalars, positions, .. } = &group.inputs;
        for ((scalar, position), source) in scalars.iter().zip(positions).zip(&group.sources) {
            let checked = self.fmu.variable(*scalar).check_size(values[*position]);
            if let (Some(connection), Err(found)) = (&source.sized, checked) {
                let error = self.error("", connection.clone(), "the Binary is too large".into());
                return Err(Box::new(RunError { reason: Some(found), ..error }));
            }
        }
        Ok(())
    }

    /// Sets variables of one type, with the values of all elements.
    pub(crate) fn set(
        &mut self,
        access_type: Type,
        set: Option<Function>,
        scalars: &AccessList,
        values: &[impl Borrow<Value>],
    ) -> CallResult {
        self.recorded.calls.begin(set);
        let outcome = self.recorded.instance.set_values(access_type, &scalars.references, values);
        match outcome {
            Ok(Success::Ok) => Ok(()),
            _ => self.check_writing(outcome, scalars, values),
        }
    }

    #[cold]
    fn check_writing_reals(&mut self, outcome: fmu_host::Result, outputs: &Store) -> CallResult {
        let values = match &self.groups[0].direct_inputs {
            Some(direct) => &outputs.reals[direct.place()],
            None => &*self.reals,
        };
        let values = Vec::from_iter(values.iter().map(|value| Value::Float64(*value)));
        self.check_writing(outcome, &self.groups[0].inputs, &values)
    }

    #[cold]
    pub(crate) fn check_writing(
        &mut self,
        outcome: fmu_host::Result,
        inputs: &AccessList,
        values: &[impl Borrow<Value>],
    ) -> CallResult {
        let pairs = inputs.scalars.iter().zip(&inputs.positions);
        let texts = pairs.map(|(scalar, position)| {
            let name = self.fmu.name(*scalar);
            match values[*position].borrow() {
                Value::String(text) => format!("{name} = {text:?}"),
                Value::Binary(bytes) => format!("{name} = {}", excerpt(bytes)),
                value => format!("{name} = {value}"),
            }
        });
        let what = Vec::from_iter(texts).join(", ");
        self.check(outcome, || what)
    }

    /// Sets the tunable parameters whose values from a table change at a communication point (s): in event mode, if it is a
    /// component of model exchange.
    pub(crate) fn set_parameters(&mut self, time: f64) -> CallResult {
        let Some(mut parameters) = self.parameters.take() else { return Ok(()) };
        let changed = parameters.change(time);
        if !changed.is_empty() {
            self.in_event(time, |component| {
                for (parameter, values) in &changed {
                    let set = accessor("set", component.fmu.version, parameter.access_type);
                    component.set(parameter.access_type, set, &parameter.scalars, values)?;
                }
                Ok(())
            })?;
        }
        self.parameters = Some(parameters);
        Ok(())
    }

    /// Sets inputs and tunable parameters at a communication point (s).
    pub(crate) fn change_starts(&mut self, starts: &ComponentStarts<'_>, time: f64) -> CallResult {
        match starts.scalars().next() {
            Some(_) => self.in_event(time, |component| component.set_starts(starts, |_| true)),
            None => Ok(()),
        }
    }

    /// Sets something in event mode, if it is a component of model exchange, or of co-simulation with event mode.
    fn in_event(&mut self, time: f64, set: impl FnOnce(&mut Self) -> CallResult) -> CallResult {
        let is_event = self.integrate(Integrator::enter_event_mode)?.unwrap_or(false);
        if let Some(event_mode) = &mut self.event_mode {
            let entered = event_mode.enter(&mut self.recorded);
            entered.map_err(|error| self.integration_error(error, "event".to_owned()))?;
        }
        if let Some(clocks) = &mut self.clocks {
            clocks.is_due = true;
        }
        self.enter_event_mode()?;
        set(self)?;
        // Else the next step begins with the event.
        if is_event {
            self.integrate(|integrator, recorded| integrator.leave_event_mode(recorded, time))?;
        }
        Ok(())
    }

    /// Calls functions for the event in which parameters change, if it is a component of model exchange.
    fn integrate<T>(
        &mut self,
        call: impl FnOnce(&mut Integrator<'a>, &mut RecordedInstance) -> IntegrationResult<T>,
    ) -> CallResult<Option<T>> {
        let Some(integrator) = &mut self.integrator else { return Ok(None) };
        let called = call(integrator, &mut self.recorded).map(Some);
        called.map_err(|error| {
            self.integration_error(error, "event of new values of parameters".to_owned())
        })
    }

    /// Sets the start values of the scalars that are wanted, those of an array by one call.
    fn set_starts(
        &mut self,
        starts: &ComponentStarts<'_>,
        is_wanted: impl Fn(&usize) -> bool,
    ) -> CallResult {
        let fmu = self.fmu.clone();
        // A clock ticks; its start value is for the master.
        let is_variable = |scalar: &usize| fmu.access_type(*scalar) != Type::Clock;
        let given = Vec::from_iter(starts.scalars().filter(is_variable).filter(is_wanted));
        for same in given.chunk_by(|a, b| fmu.array(*a) == fmu.array(*b)) {
            let access_type = fmu.access_type(same[0]);
            let list = AccessList::new(&fmu, same.iter().copied());
            let values = starts.initial(&list, &fmu);
            let set = match self.groups.iter().find(|group| group.access_type == access_type) {
                Some(group) => group.set,
                None => accessor("set", fmu.version, access_type),
            };
            self.set(access_type, set, &list, &values)?;
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

/// Gets the outputs that feed a component into the store, and only these, as not every recorded variable can be read
/// during the initialization.
pub(crate) fn get_feeding_outputs(
    components: &mut [ComponentInstance<'_>],
    feeding: &[FeedingOutputs],
    outputs: &mut Store,
) -> CallResult<Vec<Value>> {
    let mut all = Vec::new();
    for FeedingOutputs { component, access_type, get, outputs: list, places } in feeding {
        let values = components[*component].get(*access_type, *get, list)?;
        for (place, value) in places.iter().zip(&values) {
            outputs.set(*place, value.clone());
        }
        all.extend(values);
    }
    Ok(all)
}
