//! An instance of an FMU, and what is told when a call of it fails.

use std::fmt;
use std::sync::Arc;

use anyhow::Result;
use fmi::fmi2::instance::{CoSimulation, Common, InstanceCS};
use fmi::fmi2::{Fmi2Error, Fmi2Res};

use crate::guard::guarded;
use crate::value::Typed;
use crate::{Fmu, Variable, messages};

/// A call that an FMU refused, or that failed in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Name of the component.
    pub component: String,
    /// File name of the FMU.
    pub fmu: String,
    /// The function of FMI.
    pub function: &'static str,
    /// What it was called for: variables and values, or a step.
    pub what: String,
    /// The communication point (s), once the simulation runs.
    pub time: Option<f64>,
    /// What the function did: `returned fmi2Error`.
    pub outcome: String,
    /// What the FMU said about it.
    pub message: Option<String>,
}

impl Failure {
    /// Adds the communication point.
    pub(crate) fn at(mut self: Box<Self>, time: f64) -> Box<Self> {
        self.time = Some(time);
        self
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}), {}", self.component, self.fmu, self.what)?;
        if let Some(time) = self.time {
            write!(f, " at t = {time:?} s")?;
        }
        write!(f, ": {} {}", self.function, self.outcome)?;
        match &self.message {
            Some(message) => write!(f, ": {message}"),
            None => write!(f, "; the FMU logged no reason"),
        }
    }
}

impl std::error::Error for Failure {}

/// How a call ended.
pub(crate) type Called = Result<(), Box<Failure>>;

/// A running FMU.
pub(crate) struct Instance {
    name: String,
    fmu: Arc<Fmu>,
    /// Some, until it is dropped.
    slave: Option<InstanceCS>,
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.fmu.is_lost() {
            std::mem::forget(self.slave.take());
        }
    }
}

impl Instance {
    pub(crate) fn new(name: &str, fmu: &Arc<Fmu>) -> Result<Self> {
        Ok(Self {
            name: name.to_owned(),
            slave: Some(fmu.instantiate(name)?),
            fmu: fmu.clone(),
        })
    }

    /// Calls a function; `what` says for the user what it was called for.
    #[inline(always)]
    pub(crate) fn call(
        &mut self,
        function: &'static str,
        what: impl FnOnce() -> String,
        call: impl FnOnce(&mut InstanceCS) -> Result<Fmi2Res, Fmi2Error>,
    ) -> Called {
        let slave = self.slave.as_mut().expect("it is there until the drop");
        messages::begin_call();
        match guarded(|| call(slave)) {
            Ok(Ok(Fmi2Res::OK)) => Ok(()),
            outcome => self.explain(function, what, outcome),
        }
    }

    /// What to make of a call that did not just go well.
    #[cold]
    #[inline(never)]
    fn explain(
        &mut self,
        function: &'static str,
        what: impl FnOnce() -> String,
        outcome: Result<Result<Fmi2Res, Fmi2Error>, String>,
    ) -> Called {
        let outcome = match outcome {
            Ok(Ok(Fmi2Res::Warning)) => {
                messages::warn(&self.name, function);
                return Ok(());
            }
            Ok(Ok(_)) => return Ok(()),
            Ok(Err(Fmi2Error::Discard)) => "returned fmi2Discard".to_owned(),
            Ok(Err(Fmi2Error::Fatal)) => {
                self.fmu.lose();
                "returned fmi2Fatal".to_owned()
            }
            Ok(Err(_)) => "returned fmi2Error".to_owned(),
            Err(outcome) => {
                self.fmu.lose();
                outcome
            }
        };
        Err(Box::new(Failure {
            component: self.name.clone(),
            fmu: self.fmu.file_name(),
            function,
            what: what(),
            time: None,
            outcome,
            message: messages::reason(function),
        }))
    }

    pub(crate) fn set(&mut self, variable: &Variable, value: &Typed) -> Called {
        let reference = [variable.reference];
        let what = || format!("{} = {}", variable.name, value);
        match value {
            Typed::Real(v) => self.call("fmi2SetReal", what, |s| s.set_real(&reference, &[*v])),
            Typed::Integer(v) => {
                self.call("fmi2SetInteger", what, |s| s.set_integer(&reference, &[*v]))
            }
            Typed::Boolean(v) => self.call("fmi2SetBoolean", what, |s| {
                s.set_boolean(&reference, &[i32::from(*v)])
            }),
            Typed::String(text) => self.call("fmi2SetString", what, |s| {
                let done = s.set_string(&reference, std::slice::from_ref(text));
                done.map(|()| Fmi2Res::OK)
            }),
        }
    }

    pub(crate) fn enter_initialization(&mut self, start: f64) -> Called {
        let what = || "initialization".to_owned();
        self.call("fmi2SetupExperiment", what, |s| {
            s.setup_experiment(None, start, None)
        })?;
        self.call("fmi2EnterInitializationMode", what, |s| {
            s.enter_initialization_mode()
        })
    }

    pub(crate) fn exit_initialization(&mut self) -> Called {
        self.call(
            "fmi2ExitInitializationMode",
            || "initialization".to_owned(),
            |s| s.exit_initialization_mode(),
        )
    }

    #[inline]
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Called {
        self.call(
            "fmi2DoStep",
            || format!("step of {step:?} s"),
            |s| s.do_step(time, step, true),
        )
    }

    pub(crate) fn terminate(&mut self) -> Called {
        self.call("fmi2Terminate", || "end".to_owned(), |s| s.terminate())
    }
}
