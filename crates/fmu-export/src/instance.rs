//! An instance of a model: what FMI requires of every FMU, in the vocabulary of FMI 3.0. It knows nothing of
//! the C interface: an edge calls [`Instance::call`] with the function of the standard, and the operation, which is
//! a method of the instance.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, CString};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::rc::Rc;
use std::thread::{self, ThreadId};

use fmi_abi::fmi3::fmi3Clock;
use fmi_abi::state::State;
use fmi_abi::{FmiFunction, FmiVersion};
use fmu_description::interface::GUID_LENGTH;
use fmu_description::{
    LogCategory, Naming, Number, StateError, StateReader, StateWriter, Variability,
};
use ode_methods::solver::Workspace;

use crate::any_model::{AnyModel, VariantStarts};
use crate::clock::RateClocks;
use crate::clock_functions::ClockFunctions;
use crate::error::{ModelError, Severity, ensure, refused};
use crate::layout::ModelInfo;
use crate::lifecycle::{InstanceType, Lifecycle};
use crate::log::Log;
use crate::preemption::Preemption;
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
    pub(crate) get_float64: FmiFunction,
    pub(crate) set_float64: FmiFunction,
    pub(crate) do_step: FmiFunction,
    /// The function that saves the state of an instance, which can be in the states that allow it.
    pub(crate) get_fmu_state: FmiFunction,
    /// Whether the interface has clocks.
    pub(crate) has_clocks: bool,
}

/// Tells the host that it may ask for clocks.
pub(crate) type ClockUpdate = Rc<dyn Fn()>;

/// How a host computes model partitions.
pub(crate) struct Scheduling {
    /// Lets one call at a time use the instance.
    pub(crate) preemption: Rc<Preemption>,
    /// Tells the host of news about clocks during an activation.
    pub(crate) clock_update: Option<ClockUpdate>,
    /// The threads on which the host is in this callback.
    pub(crate) updating: RefCell<Vec<ThreadId>>,
}

impl Scheduling {
    pub(crate) fn new(preemption: Preemption, clock_update: Option<ClockUpdate>) -> Box<Self> {
        // With this capacity, an activation allocates nothing.
        let updating = RefCell::new(Vec::with_capacity(8));
        Box::new(Self { preemption: Rc::new(preemption), clock_update, updating })
    }
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
    /// The [`Scheduling`], whose type only binaries with model partitions need to know.
    pub(crate) scheduling: Option<Box<dyn Any>>,
    /// The [`Place`](crate::single_instance::Place) of the only instance in the process, which is given back when it is
    /// freed. Only the binaries of such models need to know its type.
    pub(crate) place: Option<Box<dyn Any>>,
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
            scheduling: None,
            place: None,
        }
    }

    /// How the host computes model partitions, in scheduled execution.
    pub(crate) fn scheduling(&self) -> Option<&Scheduling> {
        self.scheduling.as_ref()?.downcast_ref()
    }

    /// Whether the host sees what happens in a step, which is then taken in parts.
    pub(crate) fn is_stepped_in_parts(&self) -> bool {
        match self.instance_type {
            InstanceType::CoSimulation => self.intermediate_update.is_some(),
            InstanceType::CoSimulationWithEvents | InstanceType::ModelExchange => true,
            InstanceType::ScheduledExecution => false,
        }
    }
}

/// What an event has changed, and when the next one is due.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EventUpdate {
    /// Whether the values of states changed.
    pub(crate) states_changed: bool,
    /// The time of the next event, if it is known.
    pub(crate) next_event: Option<f64>,
}

/// A GUID as text.
pub(crate) type Guid = [u8; GUID_LENGTH];

/// Which model of a library an instance is of.
#[derive(Clone, Copy)]
pub(crate) struct Identity {
    pub(crate) guid: &'static Guid,
    pub(crate) variant: Option<VariantStarts>,
    pub(crate) naming: Naming,
    pub(crate) clocks: Option<&'static dyn Clocks>,
    pub(crate) clock_functions: Option<&'static ClockFunctions>,
}

/// An intermediate update, in which the host may call functions of the instance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IntermediateUpdate {
    pub(crate) time: f64,
    /// Whether inputs may be set, as the step goes on.
    pub(crate) set_requested: bool,
    pub(crate) can_return_early: bool,
}

/// Where the end of a step (s) is returned, if the host wants to know.
pub(crate) type StepEnd<'a> = Option<&'a mut f64>;

/// An instance of a model.
pub(crate) struct Instance<M: ?Sized = dyn AnyModel> {
    pub(crate) shared: Shared,
    pub(crate) model: M,
}

/// All of an instance but its model.
pub(crate) struct Shared {
    pub(crate) lifecycle: Lifecycle,
    /// The sample instants of a model with several rates.
    pub(crate) rate_clocks: RateClocks,
    clocks: Option<&'static dyn Clocks>,
    /// The present instant of a model with clocks, in event mode.
    pub(crate) instant: PresentInstant,
    pub(crate) settings: Settings,
    pub(crate) guid: &'static Guid,
    variant: Option<VariantStarts>,
    /// Until the end of the initialization, a fresh model with the start values of outputs and local variables, if
    /// the host has set any.
    pub(crate) starts: Option<Box<dyn AnyModel>>,
    /// The deviations from the standard of which the host was warned.
    warned: Vec<&'static str>,
    /// The deprecated variables of which it was warned, by their value references.
    pub(crate) deprecated: Vec<u32>,
    /// The texts and the binary values that the last call returned, which live until the next one.
    pub(crate) texts: Vec<CString>,
    pub(crate) binaries: Vec<Vec<u8>>,
    /// The memory for steps of a model that is integrated; empty for others.
    pub(crate) workspace: Workspace,
    /// The model before such a step, to which it returns if the step fails.
    pub(crate) before: Option<Box<dyn AnyModel>>,
}

impl<M: AnyModel> Instance<M> {
    pub(crate) fn new(settings: Settings, identity: Identity, mut model: M) -> Self {
        let info = model.info();
        // In event mode, a step of the model's own may not handle the events.
        let is_eventful =
            info.is_continuous && settings.instance_type == InstanceType::CoSimulationWithEvents;
        let workspace = match info.is_integrated || is_eventful {
            true => model.workspace(),
            false => Workspace::default(),
        };
        Self { shared: Shared::new(settings, identity, workspace, &mut model), model }
    }
}

impl Shared {
    #[inline(never)]
    fn new(
        settings: Settings,
        Identity { guid, variant, clocks, .. }: Identity,
        workspace: Workspace,
        model: &mut dyn AnyModel,
    ) -> Self {
        model.connect_logs(&settings.log);
        let info = model.info();
        let clocks = clocks.filter(|_| settings.edge.has_clocks);
        // providesIntermediateUpdate is false for the others.
        let intermediate_update = (settings.intermediate_update).filter(|_| info.is_continuous);
        let settings = Settings { intermediate_update, ..settings };
        Self {
            lifecycle: Lifecycle::new(settings.instance_type),
            rate_clocks: RateClocks::unset(info.rates),
            clocks,
            instant: PresentInstant::default(),
            settings,
            guid,
            variant,
            starts: None,
            warned: Vec::new(),
            deprecated: Vec::new(),
            texts: Vec::new(),
            binaries: Vec::new(),
            workspace,
            before: None,
        }
    }

    /// The clocks of a model that has some, which the compiler knows of a binary for FMI 2.0.
    pub(crate) fn clocks(&self) -> Option<&'static dyn Clocks> {
        self.clocks.filter(|_| HAS_CLOCKS)
    }
}

impl Instance {
    /// Runs the operation, once, if the call is allowed in the current state, and logs failures.
    pub(crate) fn call(
        &mut self,
        call: &FmiFunction,
        mut operation: impl FnMut(&mut Self) -> Result<(), ModelError>,
    ) -> Status {
        self.guard(call, &mut operation)
    }

    /// The code of [`call`](Self::call) that all calls share.
    #[inline(never)]
    pub(crate) fn guard(
        &mut self,
        call: &FmiFunction,
        operation: &mut dyn FnMut(&mut Self) -> Result<(), ModelError>,
    ) -> Status {
        let Lifecycle { instance_type, state, .. } = self.shared.lifecycle;
        let (lacks, state) = match self.shared.clocks() {
            Some(clocks) => (instance_type.lacks_with_clocks(call), clocks.state(self, call)),
            None => (instance_type.lacks(call), state),
        };
        if let Some(why) = lacks {
            return self.refuse(call, why);
        }
        if !call.is_allowed(state) {
            return self.refuse_in(state, call);
        }
        match catch_unwind(AssertUnwindSafe(|| operation(self))) {
            Ok(Ok(())) => Status::Ok,
            Ok(Err(error)) => self.fail(call, error),
            Err(panic) => self.fail_by_panic(call, panic),
        }
    }

    /// Logs why a call failed.
    pub(crate) fn refuse(&self, call: &FmiFunction, reason: &str) -> Status {
        let name = call.name;
        let message = format_args!("{name}: {reason}");
        self.shared.settings.log.send(LogCategory::Error, message);
        Status::Error
    }

    #[cold]
    fn refuse_in(&self, state: State, call: &FmiFunction) -> Status {
        let all = State::ALL.iter();
        let instance_type = self.shared.lifecycle.instance_type;
        let all = all.filter(|(state, _)| call.is_allowed(*state) && instance_type.has(*state));
        let mut allowed: Vec<String> = all.map(|(_, name)| (*name).to_owned()).collect();
        allowed.dedup();
        let (category, status) = match state {
            State::Fatal => (LogCategory::Fatal, Status::Fatal),
            _ => (LogCategory::Error, Status::Error),
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
    pub(crate) fn fail(&mut self, call: &FmiFunction, error: ModelError) -> Status {
        if error.severity() == Severity::Discarded {
            // The host may repeat other calls with other values.
            if *call == self.shared.settings.edge.do_step {
                self.enter(State::StepFailed);
            }
            let message = format_args!("{}: {}", call.name, error.reason());
            self.shared.settings.log.send(LogCategory::Discard, message);
            return Status::Discard;
        }
        if error.severity() == Severity::Broken {
            self.enter(State::Error);
        }
        self.refuse(call, error.reason())
    }

    #[cold]
    #[inline(never)]
    pub(crate) fn fail_by_panic(
        &mut self,
        call: &FmiFunction,
        panic: Box<dyn Any + Send>,
    ) -> Status {
        self.shared.lifecycle.state = State::Fatal;
        let what = "the model panicked; the instance can only be freed";
        self.shared.settings.log.send_panic(call.name, what, panic);
        Status::Fatal
    }

    /// Enters a state, in which the call leaves the instance.
    pub(crate) fn enter(&mut self, state: State) {
        self.shared.lifecycle.state = state;
        let message = format_args!("state: {}", state.name());
        self.shared.settings.log.send(LogCategory::Events, message);
    }

    pub(crate) fn switch_log(&mut self, on: bool, categories: &[&CStr]) -> Result<(), ModelError> {
        let ModelInfo { has_log, log_categories, .. } = *self.model.info();
        self.shared.settings.log.switch(on, categories, has_log, log_categories)
    }

    /// Sets the times of the experiment, and the relative tolerance. A model that is not integrated here keeps
    /// its own tolerance: "An FMU for Co-Simulation might ignore this argument" (FMI 2.0.5, section 2.1.6).
    pub(crate) fn set_experiment(
        &mut self,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Result<(), ModelError> {
        ensure!(start.is_finite(), "the start time is {}; expected a finite number", Number(start));
        let stop = stop.unwrap_or(f64::MAX);
        ensure!(
            stop.is_finite() && stop >= start,
            "the stop time is {}; expected a finite number, at least the start time {}",
            Number(stop),
            Number(start)
        );
        let lifecycle = &mut self.shared.lifecycle;
        lifecycle.start_time = start;
        lifecycle.stop_time = stop;
        lifecycle.tolerance = tolerance;
        Ok(())
    }

    pub(crate) fn terminate(&mut self) -> Result<(), ModelError> {
        self.enter(State::Terminated);
        Ok(())
    }

    pub(crate) fn reset(&mut self) -> Result<(), ModelError> {
        let shared = &mut self.shared;
        self.model.reset(shared.variant);
        self.model.connect_logs(&shared.settings.log);
        shared.lifecycle = Lifecycle::new(shared.lifecycle.instance_type);
        shared.rate_clocks = RateClocks::unset(self.model.info().rates);
        shared.starts = None;
        shared.instant = PresentInstant::default();
        self.enter(State::Instantiated);
        Ok(())
    }

    /// Accepts a call that the standard does not allow but importers make, with one warning.
    pub(crate) fn warn_once(&mut self, deviation: &'static str) {
        let Shared { warned, settings, .. } = &mut self.shared;
        if !warned.contains(&deviation) {
            warned.push(deviation);
            let message = format_args!("{deviation}, which the standard does not allow");
            settings.log.send(LogCategory::Warning, message);
        }
    }

    /// Enters configuration or reconfiguration mode.
    pub(crate) fn enter_configuration_mode(&mut self) -> Result<(), ModelError> {
        let (next, needed) = match self.shared.lifecycle.state {
            State::Instantiated => (State::Configuration, Variability::Fixed),
            State::Event => (State::EventReconfiguration, Variability::Tunable),
            State::ClockActivation => (State::ClockReconfiguration, Variability::Tunable),
            _ => (State::StepReconfiguration, Variability::Tunable),
        };
        let info = self.model.info();
        let is_needed = |variability| needed == variability;
        ensure!(
            info.has_structural_parameters || !is_needed(Variability::Fixed),
            "the model has no structural parameters"
        );
        ensure!(
            info.has_tunable_structural_parameters || !is_needed(Variability::Tunable),
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
            State::ClockReconfiguration => State::ClockActivation,
            _ => State::Instantiated,
        };
        if next != State::Instantiated {
            self.model.behavior_mut().on_reconfigure()?;
        }
        self.enter(next);
        Ok(())
    }
}

/// Whether the binary has clocks, which only FMI 3.0 has.
pub(crate) const HAS_CLOCKS: bool = cfg!(any(feature = "fmi3", not(feature = "fmi2")));

/// Whether the host asks for clocks after an activation, until the next one: it cannot call a component in a callback.
pub(crate) const UPDATES_AFTERWARDS: bool =
    cfg!(all(target_arch = "wasm32", not(feature = "sources")));

/// What the clocks of a model do. A model without clocks has none of it in its binary.
pub(crate) trait Clocks: Sync {
    /// Computes the model partition of a clock at a time (s), at which it has not been computed before.
    fn activate(&self, instance: &mut Instance, clock: u32, time: f64) -> Result<(), ModelError>;

    /// The interval of a clock, and what it means now.
    fn interval(&self, instance: &mut Instance, clock: u32) -> Result<Interval, ModelError>;

    /// The delay (s) of the first tick of a clock.
    fn shift(&self, instance: &mut Instance, clock: u32) -> Result<f64, ModelError>;

    /// A time of a clock (s) as a counter and its resolution.
    fn fraction(
        &self,
        instance: &mut Instance,
        clock: u32,
        time: f64,
    ) -> Result<(u64, u64), ModelError>;

    /// Whether an activation has news for the host: an output clock has ticked, or an interval is known.
    fn has_update(&self, _instance: &mut Instance) -> bool {
        false
    }

    /// The state that a call finds: on a thread whose host is in its callback, clock update mode.
    fn state(&self, instance: &Instance, call: &FmiFunction) -> State {
        let is_over = UPDATES_AFTERWARDS && call.is_allowed(State::ClockActivation);
        match instance.shared.lifecycle.state {
            State::ClockActivation if !is_over && instance.is_updating() => State::ClockUpdate,
            state => state,
        }
    }

    fn set_interval(&self, _: &mut Instance, _: u32, _interval: f64) -> Result<(), ModelError> {
        refused!("the host does not set when clocks tick")
    }

    fn set_shift(&self, _: &mut Instance, _: u32, _shift: f64) -> Result<(), ModelError> {
        refused!("the host does not set when clocks tick")
    }

    /// Says which clocks are active.
    fn get(&self, _: &mut Instance, _: &[u32], _: &mut [fmi3Clock]) -> Result<(), ModelError> {
        refused!("the model has no output clocks")
    }

    /// Activates and deactivates clocks in event mode.
    fn set(&self, _: &mut Instance, _: &[u32], _: &[fmi3Clock]) -> Result<(), ModelError> {
        refused!("clocks are not set in scheduled execution")
    }

    /// Computes what follows from active clocks, if that has not been done.
    fn evaluate(&self, _: &mut Instance) -> Result<(), ModelError> {
        Ok(())
    }

    /// Ends an instant of super-dense time.
    fn update(&self, _: &mut Instance) -> Result<EventUpdate, ModelError> {
        refused!("event mode is not for scheduled execution")
    }

    /// Checks that the last instant is ended, as event mode is left.
    fn check_ended(&self, _: &mut Instance) -> Result<(), ModelError> {
        Ok(())
    }

    /// What must be done before the host gets variables.
    fn before_get(&self, _: &mut Instance, _references: &[u32]) -> Result<(), ModelError> {
        Ok(())
    }

    /// What must be done before the host sets variables, if it may.
    fn before_set(&self, _: &mut Instance, _references: &[u32]) -> Result<(), ModelError> {
        Ok(())
    }

    /// Prepares the clocks of a model before its initialization.
    fn prepare(&self, _: &mut Instance) {}

    /// Takes and checks what the initialization says of clocks.
    fn initialize(&self, _: &mut Instance) -> Result<(), ModelError> {
        Ok(())
    }

    /// Begins an instant, as event mode is entered.
    fn begin(&self, _: &mut Instance) {}

    /// A copy of what is saved of an instant.
    fn copy(&self, _: &PresentInstant) -> PresentInstant {
        PresentInstant::default()
    }

    /// Restores it.
    fn assign(&self, _to: &mut PresentInstant, _from: &PresentInstant) {}

    /// Saves what is not in the model.
    fn save(&self, _: &PresentInstant, _: &mut StateWriter) -> Result<(), StateError> {
        Ok(())
    }

    fn load(
        &self,
        _: &dyn AnyModel,
        _: &mut StateReader<'_>,
    ) -> Result<PresentInstant, StateError> {
        Ok(PresentInstant::default())
    }
}

/// The interval of a clock (s), as the host last heard of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Interval {
    NotYetKnown,
    Unchanged(f64),
    Changed(f64),
}

impl Instance {
    /// Whether the host is in its callback for clocks on this thread.
    fn is_updating(&self) -> bool {
        let scheduling = self.shared.settings.scheduling();
        scheduling.is_some_and(|scheduling| {
            let updating = scheduling.updating.borrow();
            !updating.is_empty() && updating.contains(&thread::current().id())
        })
    }
}

/// The present instant of super-dense time: without clocks, there is none, and libraries of such models know no more of it.
#[derive(Default)]
pub(crate) struct PresentInstant(pub(crate) Option<Box<dyn Any>>);
