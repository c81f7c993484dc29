//! The instance of an FMU whose calls are recorded, and its calls for model exchange. Runs in the worker process.

use std::fmt::Arguments;
use std::sync::LazyLock;

use fmu_description::FmiVersion;
use fmu_host::{Cause, Instance, Status, Success};
use fmu_worker::{Calls, Function};
use ode_methods::solver;

use crate::access_list::accessor;
use crate::table_inputs::TableInputs;
use crate::{Advice, Messages};

/// The instance of a component, whose calls are recorded.
pub(crate) struct RecordedInstance {
    pub(crate) instance: Instance,
    pub(crate) calls: Calls,
    pub(crate) functions: &'static OperationFunctions,
    pub(crate) messages: Messages,
    pub(crate) name: String,
    pub(crate) version: FmiVersion,
}

/// Defines what is called, and the names of the functions.
macro_rules! operations {
    ($($operation:ident: $name:literal,)*) => {
        /// What is called.
        #[derive(Clone, Copy)]
        pub(crate) enum Operation { $($operation,)* }

        /// The names of the functions that perform each [`Operation`], in the same order.
        pub(crate) const OPERATIONS: [&str; [$($name),*].len()] = [$($name),*];
    };
}
operations! {
    NumberOfStates: "get_number_of_continuous_states",
    NumberOfIndicators: "get_number_of_event_indicators",
    Nominals: "get_nominals_of_continuous_states",
    SetTime: "set_time",
    SetStates: "set_continuous_states",
    States: "get_continuous_states",
    Derivatives: "get_continuous_state_derivatives",
    Directional: "get_directional_derivative",
    Indicators: "get_event_indicators",
    Completed: "completed_integrator_step",
    EventMode: "enter_event_mode",
    Update: "update_discrete_states",
    ContinuousMode: "enter_continuous_time_mode",
    StepMode: "enter_step_mode",
    DoStep: "do_step",
    SetClock: "set_clock",
    GetClock: "get_clock",
    Interval: "get_interval_decimal",
    IntervalFraction: "get_interval_fraction",
    Shift: "get_shift_decimal",
    ShiftFraction: "get_shift_fraction",
    Evaluate: "evaluate_discrete_states",
    Activate: "activate_model_partition",
}

/// The functions of a version that perform each [`Operation`].
pub(crate) type OperationFunctions = [Option<Function>; OPERATIONS.len()];

/// The functions of a version, which are looked up once, as a sweep instantiates FMUs again and again.
pub(crate) fn functions(version: FmiVersion) -> &'static OperationFunctions {
    static ALL: LazyLock<[OperationFunctions; 2]> = LazyLock::new(|| {
        [FmiVersion::Fmi2, FmiVersion::Fmi3]
            .map(|version| OPERATIONS.map(|operation| Function::performing(version, operation)))
    });
    match version {
        FmiVersion::Fmi2 => &ALL[0],
        FmiVersion::Fmi3 => &ALL[1],
    }
}

/// Why an integration has stopped.
#[derive(Debug)]
pub(crate) enum IntegrationError {
    /// A call has failed; the text tells where.
    Call(fmu_host::Failure, String),
    /// The equations cannot be integrated, though shorter steps may succeed if they are discarded.
    Equations { reason: String, is_discarded: bool, advice: Option<Advice> },
}

impl solver::SolverError for IntegrationError {
    fn discard(reason: Arguments<'_>) -> Self {
        Self::Equations { reason: reason.to_string(), is_discarded: true, advice: None }
    }

    fn too_many_steps(reason: Arguments<'_>) -> Self {
        let advice = Some(Advice::SolveImplicitly);
        Self::Equations { reason: reason.to_string(), is_discarded: true, advice }
    }

    fn is_discarded(&self) -> bool {
        match self {
            Self::Call(failure, _) => failure.cause == Cause::Returned(Status::Discard),
            Self::Equations { is_discarded, .. } => *is_discarded,
        }
    }

    fn with_prefix(self, prefix: Arguments<'_>) -> Self {
        match self {
            Self::Call(failure, place) => Self::Call(failure, format!("{prefix}{place}")),
            Self::Equations { reason, is_discarded, advice } => {
                Self::Equations { reason: format!("{prefix}: {reason}"), is_discarded, advice }
            }
        }
    }
}

pub(crate) type IntegrationResult<T = ()> = Result<T, IntegrationError>;

impl RecordedInstance {
    /// Calls the function that performs an operation.
    pub(crate) fn call<T>(
        &mut self,
        operation: Operation,
        call: impl FnOnce(&mut Instance) -> fmu_host::Result<T>,
    ) -> IntegrationResult<T> {
        self.calls.begin(self.functions[operation as usize]);
        call(&mut self.instance).map_err(|failure| IntegrationError::Call(failure, String::new()))
    }

    /// As [`RecordedInstance::call`], of a function that may return a warning.
    pub(crate) fn call_with_warning(
        &mut self,
        operation: Operation,
        call: impl FnOnce(&mut Instance) -> fmu_host::Result,
    ) -> IntegrationResult {
        let success = self.call(operation, call)?;
        self.warn(success);
        Ok(())
    }

    pub(crate) fn warn(&self, success: Success) {
        if let Success::Warning(function) = success {
            self.messages.warn(&self.name, function);
        }
    }

    /// Sets the inputs that have values from a table, before or after an event.
    pub(crate) fn set_inputs(
        &mut self,
        inputs: &TableInputs<'_>,
        time: f64,
        after: bool,
    ) -> IntegrationResult {
        for (access_type, reference, values) in inputs.values(time, after) {
            self.calls.begin(accessor("set", self.version, access_type));
            let set = self.instance.set_values(access_type, &[reference], &values);
            self.warn(set.map_err(|failure| IntegrationError::Call(failure, String::new()))?);
        }
        Ok(())
    }

    /// The error of an FMU that has asked to end the simulation.
    pub(crate) fn terminated(&self, operation: Operation, time: f64) -> IntegrationError {
        let function = self.functions[operation as usize].and_then(Function::name);
        let function = function.unwrap_or_default();
        let cause = Cause::Terminated(time);
        IntegrationError::Call(fmu_host::Failure { function, cause }, String::new())
    }
}
