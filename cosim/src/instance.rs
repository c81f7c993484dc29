//! An instance of an FMU, and what is told when a call of it fails.

use std::fmt;

use anyhow::Result;
use fmi::fmi2::instance::{CoSimulation, Common, InstanceCS};
use fmi::fmi2::{Fmi2Error, Fmi2Res};

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
    /// `fmi2Discard`, `fmi2Error` or `fmi2Fatal`.
    pub status: &'static str,
    /// What the FMU said about it.
    pub message: Option<String>,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}), {}", self.component, self.fmu, self.what)?;
        if let Some(time) = self.time {
            write!(f, " at t = {time:?} s")?;
        }
        let message = self
            .message
            .as_deref()
            .unwrap_or("the FMU logged no reason");
        write!(f, ": {} returned {}: {message}", self.function, self.status)
    }
}

impl std::error::Error for Failure {}

/// How a call ended.
pub(crate) type Called = Result<(), Box<Failure>>;

/// A running FMU.
pub(crate) struct Instance {
    name: String,
    file_name: String,
    /// None after a fatal error: by the standard the FMU is then not called again, not even freed.
    slave: Option<InstanceCS>,
    time: Option<f64>,
}

impl Instance {
    pub(crate) fn new(name: &str, fmu: &Fmu) -> Result<Self> {
        Ok(Self {
            name: name.to_owned(),
            file_name: fmu.file_name(),
            slave: Some(fmu.instantiate(name)?),
            time: None,
        })
    }

    /// Calls a function; `what` says for the user what it was called for.
    #[inline]
    pub(crate) fn call(
        &mut self,
        function: &'static str,
        what: impl FnOnce() -> String,
        call: impl FnOnce(&mut InstanceCS) -> Result<Fmi2Res, Fmi2Error>,
    ) -> Called {
        let status = match &mut self.slave {
            Some(slave) => match call(slave) {
                Ok(_) => return Ok(()),
                Err(error) => error,
            },
            None => Fmi2Error::Fatal,
        };
        Err(Box::new(self.failure(function, what(), &status)))
    }

    #[cold]
    fn failure(&mut self, function: &'static str, what: String, status: &Fmi2Error) -> Failure {
        let message = messages::newest(&self.name);
        if matches!(status, Fmi2Error::Fatal) {
            std::mem::forget(self.slave.take());
        }
        Failure {
            component: self.name.clone(),
            fmu: self.file_name.clone(),
            function,
            what,
            time: self.time,
            status: match status {
                Fmi2Error::Discard => "fmi2Discard",
                Fmi2Error::Fatal => "fmi2Fatal",
                _ => "fmi2Error",
            },
            message,
        }
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
                let text = std::ffi::CString::new(text.as_str()).map_err(|_| Fmi2Error::Error)?;
                s.set_string(&reference, &[text]).map(|()| Fmi2Res::OK)
            }),
        }
    }

    pub(crate) fn enter_initialization(&mut self, start: f64) -> Called {
        self.time = Some(start);
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
        self.time = Some(time);
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
