//! An instance of an FMU, and the report of a failed call.

use std::fmt;
use std::sync::Arc;

use anyhow::Result;
use fmu_host::Success;

use crate::recorder::{Calls, Function};
use crate::{Fmu, Messages};

/// A failed call of an FMU.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Name of the component.
    pub component: String,
    /// File name of the FMU.
    pub fmu: String,
    /// The FMI function.
    pub function: &'static str,
    /// The purpose of the call: variables and values, or a step.
    pub what: String,
    /// The communication point (s), once the simulation runs.
    pub time: Option<f64>,
    /// The outcome, such as `returned fmi2Error`.
    pub outcome: String,
    /// What the FMU logged about it.
    pub message: Option<String>,
}

impl Failure {
    /// What failed, without the words of the FMU, which may differ from run to run.
    pub fn event(&self) -> String {
        let Self {
            component,
            fmu,
            what,
            function,
            outcome,
            ..
        } = self;
        let time = self.time.map(|time| format!(" at t = {time:?} s"));
        let time = time.unwrap_or_default();
        format!("{component} ({fmu}), {what}{time}: {function} {outcome}")
    }

    /// Adds the communication point.
    pub(crate) fn at(mut self: Box<Self>, time: f64) -> Box<Self> {
        self.time = Some(time);
        self
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let event = self.event();
        match &self.message {
            Some(message) => write!(f, "{event}: {message}"),
            None => write!(f, "{event}; the FMU logged no reason"),
        }
    }
}

impl std::error::Error for Failure {}

/// The outcome of a call.
pub(crate) type Called = Result<(), Box<Failure>>;

/// A running FMU.
pub(crate) struct Instance {
    name: String,
    /// Must be dropped before the FMU, which removes its files.
    slave: fmu_host::Instance,
    fmu: Arc<Fmu>,
    messages: Messages,
    calls: Calls,
}

impl Instance {
    pub(crate) fn new(
        component: usize,
        name: &str,
        fmu: &Arc<Fmu>,
        messages: &Messages,
    ) -> Result<Self> {
        Ok(Self {
            name: name.to_owned(),
            slave: fmu.instantiate(component, name, messages)?,
            fmu: fmu.clone(),
            messages: messages.clone(),
            calls: messages.recorder().calls(component, fmu.version),
        })
    }

    /// Calls a function; `what` describes the purpose of the call to the user.
    #[inline(always)]
    pub(crate) fn call(
        &mut self,
        function: Function,
        what: impl FnOnce() -> String,
        call: impl FnOnce(&mut fmu_host::Instance) -> fmu_host::Result,
    ) -> Called {
        match call(self.calling(function)) {
            Ok(Success::Ok) => Ok(()),
            outcome => self.explain(what, outcome),
        }
    }

    /// Records that a function is about to be called, and returns what to call it of. An outcome other than
    /// [`Success::Ok`] is to be explained.
    #[inline(always)]
    pub(crate) fn calling(&mut self, function: Function) -> &mut fmu_host::Instance {
        self.calls.begin(function);
        &mut self.slave
    }

    /// Handles a warning or an error of a call.
    #[cold]
    #[inline(never)]
    pub(crate) fn explain(
        &mut self,
        what: impl FnOnce() -> String,
        outcome: fmu_host::Result,
    ) -> Called {
        let failure = match outcome {
            Ok(Success::Ok) => return Ok(()),
            Ok(Success::Warning(function)) => {
                self.messages.warn(&self.name, function);
                return Ok(());
            }
            Err(failure) => failure,
        };
        Err(Box::new(Failure {
            component: self.name.clone(),
            fmu: self.fmu.file_name(),
            function: failure.function,
            what: what(),
            time: None,
            outcome: failure.outcome(),
            message: self.messages.reason(failure.function),
        }))
    }

    pub(crate) fn fmu(&self) -> &Arc<Fmu> {
        &self.fmu
    }

    /// Sets up the experiment; FMI 3.0 has no call for it.
    pub(crate) fn set_up(&mut self, start: f64, stop: f64, tolerance: Option<f64>) -> Called {
        let what = || "set-up of the experiment".to_owned();
        self.call(Function::SetupExperiment, what, |slave| {
            slave.setup_experiment(start, Some(stop), tolerance)
        })
    }

    pub(crate) fn enter_configuration(&mut self) -> Called {
        let what = || "start of the configuration".to_owned();
        let call = fmu_host::Instance::enter_configuration_mode;
        self.call(Function::EnterConfigurationMode, what, call)
    }

    pub(crate) fn exit_configuration(&mut self) -> Called {
        let what = || "end of the configuration".to_owned();
        let call = fmu_host::Instance::exit_configuration_mode;
        self.call(Function::ExitConfigurationMode, what, call)
    }

    pub(crate) fn enter_initialization(&mut self) -> Called {
        let what = || "start of the initialization".to_owned();
        let call = fmu_host::Instance::enter_initialization_mode;
        self.call(Function::EnterInitializationMode, what, call)
    }

    pub(crate) fn exit_initialization(&mut self) -> Called {
        let what = || "end of the initialization".to_owned();
        let call = fmu_host::Instance::exit_initialization_mode;
        self.call(Function::ExitInitializationMode, what, call)
    }

    #[inline(always)]
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Called {
        match self.calling(Function::DoStep).do_step(time, step) {
            Ok(Success::Ok) => Ok(()),
            outcome => self.explain(|| format!("step of {step:?} s"), outcome),
        }
    }

    pub(crate) fn terminate(&mut self) -> Called {
        self.call(
            Function::Terminate,
            || "end".to_owned(),
            fmu_host::Instance::terminate,
        )
    }
}

impl Drop for Instance {
    /// Records that the FMU is about to be called; the field `slave` frees it.
    fn drop(&mut self) {
        self.calls.begin(Function::FreeInstance);
    }
}
