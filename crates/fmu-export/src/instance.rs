//! An instance of a model: what FMI requires of every FMU, in the vocabulary of FMI 3.0. It knows nothing of
//! the C interface: an edge calls [`Instance::call`] with the function of the standard, and the work, which is
//! a method of the instance.

use std::any::Any;
use std::ffi::{CStr, CString, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::rc::Rc;

use dormand_prince::solver::{self, Advanced, Events, Workspace};
use fmi_abi::state::State;
use fmi_abi::{Call, FmiVersion};
use fmu_description::Variability;
use fmu_description::interface::GUID_LENGTH;

use crate::clock::SampleClock;
use crate::error::{ModelError, Severity, ensure, refused};
use crate::laid_out::{AnyModel, SolverVector, Variant};
use crate::lifecycle::{InstanceType, Integration, Lifecycle};
use crate::log::{Category, Log};
use crate::model::Start;
use crate::resources::Folder;

/// The status of a call, numbered like the statuses of FMI, so that converting it is free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub(crate) enum Status {
    Ok = 0,
    Discard = 2,
    Error = 3,
    Fatal = 4,
}

/// What the instance knows of the interface through which it is called.
pub(crate) struct Edge {
    /// The version whose names of types are in messages. In FMI 2.0, a value reference addresses a scalar or
    /// an element of an array; otherwise a variable with all its elements.
    pub(crate) version: FmiVersion,
    /// The functions that hosts call at every step.
    pub(crate) get_float64: Call,
    pub(crate) set_float64: Call,
    pub(crate) do_step: Call,
    /// The function that saves the state of an instance, which can be in the states that allow it.
    pub(crate) get_fmu_state: Call,
}

/// What a host says about an instance that it creates.
pub(crate) struct Settings {
    pub(crate) edge: &'static Edge,
    pub(crate) instance_type: InstanceType,
    pub(crate) log: Log,
    pub(crate) resources: Folder,
    /// Whether a step may end early.
    pub(crate) early_return_allowed: bool,
    /// Lets the host do an intermediate update, and returns the time of an early return that it requests.
    pub(crate) intermediate_update: Option<Rc<dyn Fn(IntermediateUpdate) -> Option<f64>>>,
    /// The variables that the host may access in an intermediate update.
    pub(crate) intermediate_variables: Vec<u32>,
}

impl Settings {
    pub(crate) fn new(edge: &'static Edge, log: Log, resources: Folder) -> Self {
        Self {
            edge,
            instance_type: InstanceType::CoSimulation,
            log,
            resources,
            early_return_allowed: false,
            intermediate_update: None,
            intermediate_variables: Vec::new(),
        }
    }
}

/// What an event has changed, and when the next one is due.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Update {
    /// Whether the values of states changed.
    pub(crate) states_changed: bool,
    /// The time of the next event, if it is known.
    pub(crate) next_event: Option<f64>,
}

/// A GUID as text.
pub(crate) type Guid = [u8; GUID_LENGTH];

/// An intermediate update, in which the host may call functions of the instance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IntermediateUpdate {
    pub(crate) time: f64,
    /// Whether inputs may be set, as the step goes on.
    pub(crate) set_requested: bool,
    pub(crate) can_return_early: bool,
}

/// A pointer to an instance, which begins with its [`Shared`] part.
pub(crate) type Pointer = *mut c_void;

/// Where the end of a step (s) is returned, if the host wants to know.
pub(crate) type End<'a> = Option<&'a mut f64>;

/// The functions that depend on the model. The pointer is to an instance of this model, which is not
/// used concurrently or otherwise during the call; those to arrays are NULL or valid for the lengths that
/// follow them. A binary for one version of FMI does not contain the functions of the other.
pub(crate) struct Vtable {
    /// Gets scalars and elements of arrays: `n` value references, and as many values.
    #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
    pub(crate) get_elements: unsafe extern "C" fn(Pointer, *const u32, usize, *mut f64) -> Status,
    #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
    pub(crate) set_elements: unsafe extern "C" fn(Pointer, *const u32, usize, *const f64) -> Status,
    /// Gets variables with all their elements: `n` value references, and the values.
    #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
    pub(crate) get_variables:
        unsafe extern "C" fn(Pointer, *const u32, usize, *mut f64, usize) -> Status,
    #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
    pub(crate) set_variables:
        unsafe extern "C" fn(Pointer, *const u32, usize, *const f64, usize) -> Status,
    /// Takes a step.
    pub(crate) step: unsafe extern "C" fn(Pointer, f64, f64, End) -> Status,
    /// The number of elements of variables; an unknown one counts as one.
    #[cfg(target_arch = "wasm32")]
    pub(crate) count: unsafe fn(Pointer, *const u32, usize) -> usize,
    pub(crate) instance: unsafe fn(Pointer) -> *mut Instance,
    pub(crate) free: unsafe fn(Pointer),
}

/// An instance of a model.
#[repr(C)]
pub(crate) struct Instance<M: ?Sized = dyn AnyModel> {
    pub(crate) shared: Shared,
    pub(crate) model: M,
}

/// All of a component but its model. The table of functions comes first, so that it can be found without
/// knowing the model.
#[repr(C)]
pub(crate) struct Shared {
    pub(crate) vtable: &'static Vtable,
    pub(crate) lifecycle: Lifecycle,
    pub(crate) settings: Settings,
    pub(crate) guid: &'static Guid,
    variant: Option<Variant>,
    /// Until the end of the initialization, a fresh model with the start values of outputs and local variables, if
    /// the host has set any.
    pub(crate) starts: Option<Box<dyn AnyModel>>,
    /// Whether the host sees what happens in a step, which is then taken in parts.
    pub(crate) is_stepped_in_parts: bool,
    /// The deviations from the standard of which the host was warned.
    warned: Vec<&'static str>,
    /// The texts and the binary values that the last call returned, which live until the next one.
    pub(crate) texts: Vec<CString>,
    pub(crate) binaries: Vec<Vec<u8>>,
    /// The memory for steps of a model that is integrated; empty for others.
    workspace: Workspace,
    /// The model before such a step, to which it returns if the step fails.
    before: Option<Box<dyn AnyModel>>,
}

/// Maximum number of time events in one communication step of event mode; more would take seconds to handle.
const MAX_EVENTS: u32 = 10_000_000;
impl<M: AnyModel> Instance<M> {
    pub(crate) fn new(
        settings: Settings,
        vtable: &'static Vtable,
        (guid, variant): (&'static Guid, Option<Variant>),
        mut model: M,
    ) -> Self {
        (&mut model as &mut dyn AnyModel).connect(&settings.log);
        let info = model.info();
        // providesIntermediateUpdate is false for the others.
        let intermediate_update = (settings.intermediate_update).filter(|_| info.is_continuous);
        let settings = Settings { intermediate_update, ..settings };
        // In event mode, a step of the model's own may not handle the events.
        let is_eventful =
            info.is_continuous && settings.instance_type == InstanceType::CoSimulationWithEvents;
        let workspace = match info.is_integrated || is_eventful {
            true => Workspace::new(info.states.len(), info.event_indicators.len()),
            false => Workspace::default(),
        };
        Self {
            shared: Shared {
                vtable,
                lifecycle: Lifecycle::new(settings.instance_type),
                is_stepped_in_parts: settings.instance_type != InstanceType::CoSimulation
                    || settings.intermediate_update.is_some(),
                settings,
                guid,
                variant,
                starts: None,
                warned: Vec::new(),
                texts: Vec::new(),
                binaries: Vec::new(),
                workspace,
                before: None,
            },
            model,
        }
    }
}

impl Instance {
    /// Runs `work` if the call is allowed in the current state, and logs failures.
    pub(crate) fn call(
        &mut self,
        call: &Call,
        work: impl FnOnce(&mut Self) -> Result<(), ModelError>,
    ) -> Status {
        let mut work = Some(work);
        self.guard(call, &mut |c| work.take().map_or(Ok(()), |work| work(c)))
    }

    /// The code of [`call`](Self::call) that all calls share.
    #[inline(never)]
    fn guard(
        &mut self,
        call: &Call,
        work: &mut dyn FnMut(&mut Self) -> Result<(), ModelError>,
    ) -> Status {
        let Lifecycle { instance_type, state, .. } = self.shared.lifecycle;
        if let Some(why) = instance_type.lacks(call) {
            return self.refuse(call, why);
        }
        if !call.is_allowed(state) {
            return self.refuse_in(state, call);
        }
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(Ok(())) => Status::Ok,
            Ok(Err(error)) => self.fail(call, error),
            Err(panic) => self.fail_by_panic(call, panic),
        }
    }

    /// Logs why a call failed.
    pub(crate) fn refuse(&self, call: &Call, reason: &str) -> Status {
        let name = call.name;
        let message = format_args!("{name}: {reason}");
        self.shared.settings.log.send(Category::Error, message);
        Status::Error
    }

    #[cold]
    fn refuse_in(&self, state: State, call: &Call) -> Status {
        let all = State::ALL.iter();
        let instance_type = self.shared.lifecycle.instance_type;
        let all = all.filter(|(state, _)| call.is_allowed(*state) && instance_type.has(*state));
        let mut allowed: Vec<String> = all.map(|(_, name)| (*name).to_owned()).collect();
        allowed.dedup();
        let (category, status) = match state {
            State::Fatal => (Category::Fatal, Status::Fatal),
            _ => (Category::Error, Status::Error),
        };
        self.shared.settings.log.send(
            category,
            format_args!(
                "{} is not allowed in the state \"{}\"; it is allowed in: {}",
                call.name,
                state.name(),
                allowed.join(", ")
            ),
        );
        status
    }

    /// Logs why a call failed, and enters the state that follows.
    #[cold]
    #[inline(never)]
    fn fail(&mut self, call: &Call, error: ModelError) -> Status {
        if error.severity() == Severity::Discarded {
            // The host may repeat other calls with other values.
            if *call == self.shared.settings.edge.do_step {
                self.enter(State::StepFailed);
            }
            let message = format_args!("{}: {}", call.name, error.reason());
            self.shared.settings.log.send(Category::Discard, message);
            return Status::Discard;
        }
        if error.severity() == Severity::Broken {
            self.enter(State::Error);
        }
        self.refuse(call, error.reason())
    }

    #[cold]
    #[inline(never)]
    fn fail_by_panic(&mut self, call: &Call, panic: Box<dyn Any + Send>) -> Status {
        self.shared.lifecycle.state = State::Fatal;
        let what = "the model panicked; the instance can only be freed";
        self.shared.settings.log.send_panic(call.name, what, panic);
        Status::Fatal
    }

    /// Enters a state, in which the call leaves the instance.
    pub(crate) fn enter(&mut self, state: State) {
        self.shared.lifecycle.state = state;
        let message = format_args!("state: {}", state.name());
        self.shared.settings.log.send(Category::Events, message);
    }

    pub(crate) fn switch_log(&mut self, on: bool, categories: &[&CStr]) -> Result<(), ModelError> {
        let has_log = self.model.info().has_log;
        self.shared.settings.log.switch(on, categories, has_log)
    }

    /// Sets the times of the experiment, and the relative tolerance. A model that is not integrated here keeps
    /// its own tolerance: "An FMU for Co-Simulation might ignore this argument" (FMI 2.0.5, section 2.1.6).
    pub(crate) fn set_experiment(
        &mut self,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Result<(), ModelError> {
        ensure!(start.is_finite(), "the start time is {start}; expected a finite number");
        let stop = stop.unwrap_or(f64::MAX);
        ensure!(
            stop.is_finite() && stop >= start,
            "the stop time is {stop}; expected a finite number, at least the start time {start}"
        );
        let lifecycle = &mut self.shared.lifecycle;
        lifecycle.start_time = start;
        lifecycle.stop_time = stop;
        lifecycle.tolerance = tolerance;
        Ok(())
    }

    pub(crate) fn exit_initialization_mode(&mut self) -> Result<(), ModelError> {
        self.update()?;
        self.shared.starts = None;
        let lifecycle = &mut self.shared.lifecycle;
        match lifecycle.instance_type {
            InstanceType::CoSimulation => self.enter(State::StepMode),
            InstanceType::CoSimulationWithEvents | InstanceType::ModelExchange => {
                lifecycle.time = lifecycle.start_time;
                self.enter(State::Event);
            }
        }
        Ok(())
    }

    pub(crate) fn terminate(&mut self) -> Result<(), ModelError> {
        self.enter(State::Terminated);
        Ok(())
    }

    pub(crate) fn reset(&mut self) -> Result<(), ModelError> {
        let shared = &mut self.shared;
        self.model.reset(shared.variant);
        self.model.connect(&shared.settings.log);
        shared.lifecycle = Lifecycle::new(shared.lifecycle.instance_type);
        shared.starts = None;
        self.enter(State::Instantiated);
        Ok(())
    }

    /// Accepts a call that the standard does not allow but importers make, with one warning.
    fn warn_once(&mut self, deviation: &'static str) {
        let Shared { warned, settings, .. } = &mut self.shared;
        if !warned.contains(&deviation) {
            warned.push(deviation);
            let message = format_args!("{deviation}, which the standard does not allow");
            settings.log.send(Category::Warning, message);
        }
    }

    pub(crate) fn enter_event_mode(&mut self) -> Result<(), ModelError> {
        if self.shared.lifecycle.state == State::Event {
            // As OpenModelica does right after the initialization.
            self.warn_once("event mode is entered in event mode");
            return Ok(());
        }
        let lifecycle = &mut self.shared.lifecycle;
        // In step mode, nothing is computed for event mode.
        lifecycle.stale |= lifecycle.state == State::StepMode;
        self.enter(State::Event);
        Ok(())
    }

    pub(crate) fn enter_continuous_time_mode(&mut self) -> Result<(), ModelError> {
        self.enter(State::ContinuousTime);
        Ok(())
    }

    /// Enters step mode with the outputs of event mode.
    pub(crate) fn enter_step_mode(&mut self) -> Result<(), ModelError> {
        self.update().map_err(ModelError::not_discarded)?;
        self.enter(State::StepMode);
        Ok(())
    }

    /// Enters configuration or reconfiguration mode.
    pub(crate) fn enter_configuration_mode(&mut self) -> Result<(), ModelError> {
        let (next, needed) = match self.shared.lifecycle.state {
            State::Instantiated => (State::Configuration, Variability::Fixed),
            State::Event => (State::EventReconfiguration, Variability::Tunable),
            _ => (State::StepReconfiguration, Variability::Tunable),
        };
        let (has_any, has_tunable) = self.model.info().structural_parameters;
        let is_needed = |variability| needed == variability;
        ensure!(
            has_any || !is_needed(Variability::Fixed),
            "the model has no structural parameters"
        );
        ensure!(
            has_tunable || !is_needed(Variability::Tunable),
            "the model has no tunable structural parameters"
        );
        self.enter(next);
        Ok(())
    }

    /// Returns from configuration or reconfiguration mode.
    pub(crate) fn exit_configuration_mode(&mut self) -> Result<(), ModelError> {
        let next = match self.shared.lifecycle.state {
            State::StepReconfiguration => State::StepMode,
            State::EventReconfiguration => State::Event,
            _ => State::Instantiated,
        };
        if next != State::Instantiated {
            self.model.behavior_mut().on_reconfigure()?;
        }
        self.enter(next);
        Ok(())
    }

    /// Sets the time of model exchange.
    pub(crate) fn set_time(&mut self, time: f64) -> Result<(), ModelError> {
        ensure!(time.is_finite(), "the time is {time:?}; expected a finite number");
        let lifecycle = &mut self.shared.lifecycle;
        lifecycle.stale |= time != lifecycle.time;
        lifecycle.time = time;
        Ok(())
    }

    pub(crate) fn set_continuous_states(&mut self, states: &[f64]) -> Result<(), ModelError> {
        self.check_length(SolverVector::States, states.len())?;
        if let Some(&value) = states.iter().find(|value| !value.is_finite()) {
            return refused!("a state is {value}; expected finite numbers");
        }
        if self.shared.lifecycle.state == State::Event {
            self.warn_once("states are set in event mode");
        }
        self.model.set_states(states);
        self.shared.lifecycle.stale = true;
        Ok(())
    }

    fn get_numbers(&mut self, which: SolverVector, values: &mut [f64]) -> Result<(), ModelError> {
        self.check_length(which, values.len())?;
        if which != SolverVector::Nominals {
            self.update()?;
        }
        self.model.read(which, values);
        Ok(())
    }

    fn check_length(&self, of: SolverVector, found: usize) -> Result<(), ModelError> {
        let expected = self.model.length(of);
        let what = match of {
            SolverVector::EventIndicators => "event indicators",
            _ => "continuous states",
        };
        ensure!(
            found == expected,
            "the array has {found} elements; expected {expected}, the number of {what}"
        );
        Ok(())
    }

    /// Handles what is due in event mode: samples, time events, and what has happened now.
    pub(crate) fn handle_events(&mut self) -> Result<Update, ModelError> {
        let Lifecycle { instance_type, time, .. } = self.shared.lifecycle;
        let (info, before) = (self.model.info(), self.model.states());
        if self.shared.lifecycle.stale {
            self.model.evaluate_before_event(time);
        }
        self.shared.lifecycle.stale = true;
        if info.is_sampled {
            self.take_due_samples(time)?;
        } else if instance_type == InstanceType::ModelExchange {
            self.model.behavior_mut().on_event(time)?;
            self.shared.lifecycle.integration.handled = time;
        } else {
            self.handle_past_events(time)?;
        }
        let states_changed = self.model.states() != before;
        self.shared.lifecycle.integration.restarts |= states_changed;
        Ok(Update { states_changed, next_event: self.next_event() })
    }

    fn take_due_samples(&mut self, time: f64) -> Result<(), ModelError> {
        let clock = &mut self.shared.lifecycle.clock;
        let before = *clock;
        let due = clock.due_until(time)?;
        self.take_samples(due, before)?;
        self.model.check_outputs()
    }

    /// Takes the last `due` samples that the clock has counted; `before` is the clock without them.
    fn take_samples(&mut self, due: u32, before: SampleClock) -> Result<(), ModelError> {
        let clock = &mut self.shared.lifecycle.clock;
        for remaining in (1..=due).rev() {
            let instant = clock.instant_before(remaining);
            if let Err(error) = self.model.behavior_mut().on_step(instant, clock.sample_time()) {
                if remaining < due {
                    return Err(error.with_severity(Severity::Broken)); // earlier samples have changed the model
                }
                *clock = before;
                return Err(error);
            }
        }
        Ok(())
    }

    /// Handles the time events until now, which a step without early return may have passed, and what has
    /// happened now. The end of a step reaches a time event but for rounding errors.
    fn handle_past_events(&mut self, now: f64) -> Result<(), ModelError> {
        let tolerance = 1e-6 * self.model.info().step + 8.0 * f64::EPSILON * now.abs();
        let (mut is_handled, mut events) = (false, 0);
        while let Some(event) = self.next_event().filter(|event| *event <= now + tolerance) {
            events += 1;
            if events > MAX_EVENTS {
                let reason = format_args!("more than {MAX_EVENTS} events are due");
                return Err(ModelError::new(reason));
            }
            self.model.behavior_mut().on_event(event)?;
            self.shared.lifecycle.integration.handled = event;
            is_handled = event >= now - tolerance;
        }
        if !is_handled {
            self.model.behavior_mut().on_event(now)?;
        }
        let handled = &mut self.shared.lifecycle.integration.handled;
        *handled = handled.max(now);
        Ok(())
    }

    /// The time of the next event that is not handled, if it is known.
    pub(crate) fn next_event(&self) -> Option<f64> {
        let lifecycle = &self.shared.lifecycle;
        if self.model.info().is_sampled {
            return Some(lifecycle.clock.next_instant());
        }
        let handled = lifecycle.integration.handled;
        let event = self.model.behavior().on_next_event(handled);
        event.filter(|event| *event > handled && event.is_finite())
    }

    /// Checks a step. Returns the status of the call if no step is to be taken.
    pub(crate) fn refuse_step(&mut self, time: f64, step: f64) -> Option<Status> {
        let call = &self.shared.settings.edge.do_step;
        let status = self.call(call, |c| {
            c.shared.lifecycle.check_step(call.name, time, step, &c.shared.settings.log)
        });
        // Some hosts iterate events with steps of 0.
        (status != Status::Ok || step == 0.0).then_some(status)
    }

    /// Takes any step.
    pub(crate) fn step(&mut self, time: f64, step: f64, end: End) -> Status {
        if !self.shared.lifecycle.is_next_step(time, step)
            && let Some(status) = self.refuse_step(time, step)
        {
            return self.returned(status, end);
        }
        let taken = catch_unwind(AssertUnwindSafe(|| {
            match self.model.info().is_integrated {
                true => self.integrate(time, step)?,
                false => self.take_step(time, step)?,
            }
            self.end_ramps();
            Ok(())
        }));
        self.end_step(taken, time, step, end)
    }

    /// Ends a step that the model took. It failed if the model says so or panicked, or if an output is not finite.
    #[cold]
    #[inline(never)]
    pub(crate) fn end_step(
        &mut self,
        taken: std::thread::Result<Result<(), ModelError>>,
        time: f64,
        step: f64,
        end: End,
    ) -> Status {
        let call = &self.shared.settings.edge.do_step;
        let status = match taken.map(|taken| taken.and_then(|()| self.model.check_outputs())) {
            Ok(Ok(())) => {
                self.shared.lifecycle.time = time + step;
                Status::Ok
            }
            Ok(Err(error)) => self.fail(call, error.in_step(time, step)),
            Err(panic) => self.fail_by_panic(call, panic),
        };
        self.returned(status, end)
    }

    /// Returns from a step, whose end is the current time.
    fn returned(&self, status: Status, end: End) -> Status {
        if let Some(end) = end {
            *end = self.shared.lifecycle.now();
        }
        status
    }

    /// Clears the derivatives of inputs, which are for one step.
    pub(crate) fn end_ramps(&mut self) {
        if self.shared.lifecycle.has_input_derivatives {
            self.model.clear_input_derivatives();
            self.shared.lifecycle.has_input_derivatives = false;
        }
    }

    /// Takes a step, or the samples in it, by the function of the model.
    pub(crate) fn take_step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if self.model.info().is_sampled {
            let clock = &mut self.shared.lifecycle.clock;
            let before = *clock;
            let due = clock.due(time, step)?;
            self.take_samples(due, before)?;
        } else {
            self.model.behavior_mut().on_step(time, step)?;
        }
        self.model.check_outputs()
    }

    /// Integrates the equations over a step and handles the events in it.
    pub(crate) fn integrate(&mut self, time: f64, size: f64) -> Result<(), ModelError> {
        self.integrate_to(time, size, Events::Here).map(drop)
    }

    /// Integrates the equations over a step, which changes nothing if it fails.
    #[inline(never)]
    pub(crate) fn integrate_to(
        &mut self,
        time: f64,
        size: f64,
        events: Events,
    ) -> Result<Advanced, ModelError> {
        let (model, shared) = (&mut self.model, &mut self.shared);
        let integration = &mut shared.lifecycle.integration;
        let before = shared.before.get_or_insert_with(|| model.copy());
        before.assign(model);
        // In event mode, the host handles the events that its values cause.
        let switches = match events {
            Events::Here => model.hash_of_switches(),
            Events::EndStep | Events::Wait => integration.switches,
        };
        let event = (switches != integration.switches).then_some(time);
        if event.is_some() {
            model.evaluate_before_event(time);
        }
        let step = solver::Step {
            time,
            size,
            tolerance: integration.tolerance,
            longest: model.info().step.max(1e-3 * size),
            events,
            handled: integration.handled,
            event,
            restarts: integration.restarts,
        };
        let advanced = model.advance(&mut shared.workspace, &step);
        match &advanced {
            Ok(Advanced { handled, restarts, .. }) => {
                (integration.handled, integration.restarts) = (*handled, *restarts);
                integration.switches = switches;
            }
            Err(_) => _ = model.assign(before.as_ref()),
        }
        advanced
    }

    /// Evaluates the equations between steps if the host asks for what is computed only then: derivatives and event
    /// indicators. Otherwise, computes what is not up to date. Returns the model before an evaluation, to which it
    /// is to return: outputs have the values of the last step.
    pub(crate) fn prepare(
        &mut self,
        needs_evaluation: bool,
    ) -> Result<Option<Box<dyn AnyModel>>, ModelError> {
        let Lifecycle { instance_type, state, .. } = self.shared.lifecycle;
        let is_stepped = instance_type != InstanceType::ModelExchange
            && matches!(
                state,
                State::StepMode | State::StepFailed | State::IntermediateUpdate | State::Terminated
            );
        if is_stepped && self.model.info().is_continuous && needs_evaluation {
            return self.evaluate_aside().map(Some);
        }
        self.update()?;
        Ok(None)
    }

    /// Evaluates the equations between steps, and discards nothing, as only steps are discarded. Returns the
    /// model before.
    pub(crate) fn evaluate_aside(&mut self) -> Result<Box<dyn AnyModel>, ModelError> {
        let saved = self.model.copy();
        match self.evaluate(self.shared.lifecycle.now()) {
            Ok(()) => Ok(saved),
            Err(error) => {
                self.model.assign(saved.as_ref());
                Err(error.not_discarded())
            }
        }
    }

    /// Computes what a host may read and is not up to date, before the end of the initialization, in event
    /// mode and in model exchange.
    pub(crate) fn update(&mut self) -> Result<(), ModelError> {
        let Lifecycle { instance_type, state, stale, .. } = self.shared.lifecycle;
        let is_evaluated = match state {
            _ if !stale => return Ok(()),
            State::Initialization => return self.initialize(),
            State::Event | State::ContinuousTime => true,
            State::Terminated => instance_type == InstanceType::ModelExchange,
            _ => false,
        };
        if is_evaluated {
            self.evaluate(self.shared.lifecycle.now())?;
            self.shared.lifecycle.stale = false;
        }
        Ok(())
    }

    /// Computes derivatives, event indicators and outputs from states and inputs.
    fn evaluate(&mut self, time: f64) -> Result<(), ModelError> {
        if self.model.info().is_continuous {
            self.model.behavior_mut().on_evaluate(time)?;
            let checked = self.model.check_equations();
            checked.map_err(|error| error.with_severity(Severity::Discarded))?;
        }
        Ok(())
    }

    /// Computes the outputs from the start values and inputs; nothing changes if that fails.
    pub(crate) fn initialize(&mut self) -> Result<(), ModelError> {
        let before = self.model.copy();
        let initialized = self.initialize_model();
        if initialized.is_err() {
            self.model.assign(before.as_ref());
        }
        initialized.map_err(|error| error.with_severity(Severity::Refused))
    }

    fn initialize_model(&mut self) -> Result<(), ModelError> {
        let (model, shared) = (&mut self.model, &mut self.shared);
        let (info, lifecycle) = (model.info(), &shared.lifecycle);
        let start = Start {
            time: lifecycle.start_time,
            is_model_exchange: lifecycle.instance_type == InstanceType::ModelExchange,
            resources: shared.settings.resources.clone(),
        };
        model.renew();
        if let Some(starts) = &mut shared.starts {
            model.take_starts(starts.as_mut());
        }
        model.behavior_mut().on_initialize(&start)?;
        let mut integration = Integration { handled: start.time, ..Integration::NONE };
        let is_eventful =
            info.is_continuous && lifecycle.instance_type == InstanceType::CoSimulationWithEvents;
        if (info.is_integrated || is_eventful) && !start.is_model_exchange {
            integration.tolerance = tolerance(lifecycle.tolerance, info.tolerance)?;
            // Without event mode, the instance handles the event at the start itself.
            if !is_eventful {
                model.evaluate_before_event(start.time);
                model.behavior_mut().on_event(start.time)?;
                integration.switches = model.hash_of_switches();
            }
        }
        if info.is_continuous {
            model.behavior_mut().on_evaluate(start.time)?;
        }
        let clock = match info.is_sampled {
            true => SampleClock::new(start.time, model.behavior().sample_time())?,
            false => SampleClock::UNSET,
        };
        model.check_equations().map_err(|error| {
            let reason = error.reason();
            ModelError::new(format_args!("at t = {:?} s: {reason}", start.time))
        })?;
        if info.is_integrated {
            shared.before = Some(model.copy());
        }
        let lifecycle = &mut shared.lifecycle;
        (lifecycle.clock, lifecycle.integration) = (clock, integration);
        lifecycle.stale = false;
        Ok(())
    }
}

/// Defines methods that get the numbers which a host integrates, or locates events with.
macro_rules! get_numbers {
    ($($name:ident: $which:ident;)*) => {
        impl Instance {
            $(pub(crate) fn $name(&mut self, values: &mut [f64]) -> Result<(), ModelError> {
                self.get_numbers(SolverVector::$which, values)
            })*
        }
    };
}

get_numbers! {
    get_continuous_states: States;
    get_continuous_state_derivatives: Derivatives;
    get_event_indicators: EventIndicators;
    get_nominals_of_continuous_states: Nominals;
}

/// The tolerance of the integration, as the host wants it, or as the model says.
fn tolerance(of_host: Option<f64>, of_model: f64) -> Result<f64, ModelError> {
    match of_host {
        Some(tolerance) if tolerance > 0.0 && tolerance.is_finite() => Ok(tolerance),
        Some(tolerance) => Err(ModelError::new(format_args!(
            "the tolerance is {tolerance:?}; expected a positive number"
        ))),
        // A model with a step of its own may have none.
        None if of_model == 0.0 => Ok(1e-6),
        None => Ok(of_model),
    }
}
