//! The arguments and the results of functions of FMI in Rust.

use std::ffi::c_void;
use std::sync::Arc;
use std::time::Duration;

use fmi_abi::InterfaceType;

use crate::logger::OnIntermediate;
use crate::observed::{CallObserver, Element, ToElement};
use crate::outcome::{Cause, Failure, Success};
use crate::quick::NotOk;

/// The arguments that [`Library::instantiate`](crate::Library::instantiate) passes to the FMU. FMI 2.0 has those up to `logging_on`.
#[derive(Clone, Default)]
pub struct Instantiation<'a> {
    /// Name of the instance.
    pub name: &'a str,
    /// How the host simulates the instance.
    pub interface_type: InterfaceType,
    /// The GUID of the model description, or the instantiation token of FMI 3.0.
    pub guid: &'a str,
    /// The location of the folder `resources`, as [`Library::location`](crate::Library::location) returns it.
    pub resources: &'a str,
    /// Whether the FMU also logs messages other than errors.
    pub logging_on: bool,
    /// `eventModeUsed`
    pub event_mode_used: bool,
    /// `earlyReturnAllowed`
    pub early_return_allowed: bool,
    /// `requiredIntermediateVariables`
    pub intermediate_variables: &'a [u32],
    /// Receives intermediate updates, during a step and on its thread.
    pub on_intermediate: Option<OnIntermediate>,
    /// Who observes the calls of the instance, if the library is observed.
    pub observer: Option<Arc<dyn CallObserver>>,
    /// How the arguments are treated.
    pub treatment: Treatment,
    /// The limits of an instance of a WebAssembly component.
    pub limits: Limits,
}

/// The limits of an instance of a WebAssembly component; a call that exceeds one ends with a trap.
#[derive(Debug, Clone, Copy, Default)]
pub struct Limits {
    /// The time of each call.
    pub call: Option<Duration>,
    /// The memory in bytes, of all memories and tables together.
    pub memory: Option<usize>,
}

/// How [`Library::instantiate`](crate::Library::instantiate) treats the arguments. All but the first test an FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Treatment {
    /// All arguments are given, and stay valid until the instance is freed.
    #[default]
    Usual,
    /// The strings are overwritten after the call; FMUs must copy what they need.
    ShortLivedStrings,
    /// The logger is NULL.
    NoLogger,
    /// The location of the resources is NULL.
    NoResources,
}

/// A saved FMU state, to be freed with [`Instance::free_fmu_state`](crate::Instance::free_fmu_state).
#[repr(transparent)]
pub struct FmuState(pub(crate) *mut c_void);

// SAFETY: only the functions of the instance use the pointer, which any thread may call, as for `Instance`.
unsafe impl Send for FmuState {}

impl ToElement for FmuState {
    fn element(&self) -> Element {
        Element::State(self.0.addr())
    }
}

impl From<&FmuState> for *mut c_void {
    fn from(state: &FmuState) -> Self {
        state.0
    }
}

/// The results of a step (FMI 3.0.2, section 4.2.1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepResult {
    /// `eventHandlingNeeded`
    pub event_handling_needed: bool,
    /// `terminateSimulation`
    pub terminate: bool,
    /// `earlyReturn`
    pub early_return: bool,
    /// `lastSuccessfulTime` (s)
    pub last_successful_time: f64,
}

/// The result of a step of FMI 3.0 that must not end early.
pub(crate) fn at_the_end(done: Success, stepped: StepResult) -> NotOk {
    let cause = match stepped {
        StepResult { terminate: true, .. } => Cause::Terminated(stepped.last_successful_time),
        StepResult { early_return: true, .. } => Cause::ReturnedEarly(stepped.last_successful_time),
        _ if done == Success::Ok => return None,
        _ => return Some(Box::new(Ok(done))),
    };
    Some(Box::new(Err(Failure::new("fmi3DoStep", cause))))
}

/// The result of an update of discrete states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscreteStatesUpdate {
    /// `discreteStatesNeedUpdate`
    pub again: bool,
    /// `terminateSimulation`
    pub terminate: bool,
    /// `nominalsOfContinuousStatesChanged`
    pub nominals_changed: bool,
    /// `valuesOfContinuousStatesChanged`
    pub states_changed: bool,
    /// `nextEventTime`, if it is defined.
    pub next_event: Option<f64>,
    /// Whether the FMU has written all of them.
    pub is_written: bool,
}

/// The result of a completed integrator step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CompletedStep {
    /// `enterEventMode`
    pub enter_event_mode: bool,
    /// `terminateSimulation`
    pub terminate: bool,
    /// Whether the FMU has written its results.
    pub is_written: bool,
}
