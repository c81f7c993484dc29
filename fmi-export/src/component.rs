//! What FMI asks of any slave, whatever its version: the state machine, checks, the panic guard.

use std::any::Any;
use std::ffi::CStr;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::log::{Category, Log};
use crate::model::ModelError;
use crate::phase::{self, Call, Phase};
use crate::slave::Slave;
use crate::values::{self, Refusal, Value};

/// How a call ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Ok,
    Error,
    Fatal,
}

/// Why a call failed.
pub(crate) enum Failure {
    /// The call was wrong, and changed nothing.
    Refused(Refusal),
    /// The model cannot go on.
    Broken(String),
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

/// An instance of a model, as the host holds it.
pub(crate) struct Component {
    log: Log,
    phase: Phase,
    slave: Box<dyn Slave>,
    start_time: f64,
    /// The current communication point (s), once a step was taken.
    time: Option<f64>,
    /// Whether start values changed since the outputs were computed.
    stale: bool,
}

impl Component {
    pub(crate) fn new(log: Log, slave: Box<dyn Slave>) -> Self {
        Self {
            log,
            phase: Phase::Instantiated,
            slave,
            start_time: 0.0,
            time: None,
            stale: true,
        }
    }

    /// Does the work of a call if the state allows it, and tells what went wrong.
    pub(crate) fn call(
        &mut self,
        call: &Call,
        work: impl FnOnce(&mut Self) -> Result<(), Failure>,
    ) -> Outcome {
        if !call.is_allowed(self.phase) {
            return self.refuse_in_this_phase(call);
        }
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(Ok(())) => Outcome::Ok,
            Ok(Err(failure)) => self.fail(call.name, failure),
            Err(panic) => self.die(call.name, panic.as_ref()),
        }
    }

    /// Refuses a call that no state allows, with its reason.
    pub(crate) fn refuse(&self, name: &str, reason: &str) -> Outcome {
        self.log
            .send(Category::Error, || format!("{name}: {reason}"));
        Outcome::Error
    }

    #[cold]
    fn refuse_in_this_phase(&self, call: &Call) -> Outcome {
        self.log.send(Category::Error, || {
            format!(
                "{} is not allowed in the state \"{}\"; it is allowed in: {}",
                call.name,
                self.phase.name(),
                call.allowed_names()
            )
        });
        match self.phase {
            Phase::Fatal => Outcome::Fatal,
            _ => Outcome::Error,
        }
    }

    #[cold]
    fn fail(&mut self, name: &str, failure: Failure) -> Outcome {
        let reason = match failure {
            Failure::Refused(reason) => reason,
            Failure::Broken(reason) => {
                self.enter(Phase::Error);
                reason
            }
        };
        self.refuse(name, &reason)
    }

    #[cold]
    fn die(&mut self, name: &str, panic: &(dyn Any + Send)) -> Outcome {
        self.phase = Phase::Fatal;
        let text = panic
            .downcast_ref::<&str>()
            .copied()
            .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
            .unwrap_or("no message");
        self.log.send(Category::Fatal, || {
            format!("{name}: the model panicked and is dead: {text}")
        });
        Outcome::Fatal
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.log
            .send(Category::Events, || format!("state: {}", phase.name()));
    }

    pub(crate) fn set_debug_logging(&mut self, on: bool, categories: &[&CStr]) -> Outcome {
        self.call(&phase::SET_DEBUG_LOGGING, |c| {
            Ok(c.log.switch(on, categories)?)
        })
    }

    pub(crate) fn setup_experiment(&mut self, start: f64, stop: Option<f64>) -> Outcome {
        self.call(&phase::SETUP_EXPERIMENT, |c| {
            if !start.is_finite() {
                return Err(format!("the start time is {start}; expected a finite number").into());
            }
            if let Some(stop) = stop
                && !(stop.is_finite() && stop >= start)
            {
                return Err(format!(
                    "the stop time is {stop}; expected a finite number, at least the start time {start}"
                )
                .into());
            }
            c.start_time = start;
            c.stale = true;
            Ok(())
        })
    }

    pub(crate) fn enter_initialization_mode(&mut self) -> Outcome {
        self.call(&phase::ENTER_INITIALIZATION_MODE, |c| {
            c.enter(Phase::Initialization);
            Ok(())
        })
    }

    pub(crate) fn exit_initialization_mode(&mut self) -> Outcome {
        self.call(&phase::EXIT_INITIALIZATION_MODE, |c| {
            c.refresh()?;
            c.enter(Phase::StepComplete);
            Ok(())
        })
    }

    pub(crate) fn terminate(&mut self) -> Outcome {
        self.call(&phase::TERMINATE, |c| {
            c.enter(Phase::Terminated);
            Ok(())
        })
    }

    pub(crate) fn reset(&mut self) -> Outcome {
        self.call(&phase::RESET, |c| {
            c.slave.reset();
            c.start_time = 0.0;
            c.time = None;
            c.stale = true;
            c.enter(Phase::Instantiated);
            Ok(())
        })
    }

    pub(crate) fn do_step(&mut self, time: f64, step: f64) -> Outcome {
        self.call(&phase::DO_STEP, |c| {
            c.check_step(time, step)?;
            if step == 0.0 {
                return Ok(()); // event iterations of some hosts
            }
            c.slave.step(time, step).map_err(|error| {
                Failure::Broken(format!("from t = {time} s by {step} s: {}", error.reason()))
            })?;
            c.time = Some(time + step);
            Ok(())
        })
    }

    fn check_step(&self, time: f64, step: f64) -> Result<(), Refusal> {
        if !step.is_finite() || step < 0.0 {
            return Err(format!(
                "the communication step is {step}; expected a finite number of at least 0"
            ));
        }
        if !time.is_finite() {
            return Err(format!(
                "the communication point is {time}; expected a finite number"
            ));
        }
        if let Some(expected) = self.time {
            // Hosts add up or multiply times, and differ by rounding.
            let tolerance = 1e-6 * step + 1e-9 * (1.0 + expected.abs());
            if (time - expected).abs() > tolerance {
                return Err(format!(
                    "the communication point is {time}; expected {expected}, where the last step ended"
                ));
            }
        }
        Ok(())
    }

    /// Reads the values of the references.
    pub(crate) fn get<V: Value>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &mut [V],
    ) -> Outcome {
        self.call(call, |c| {
            if c.phase == Phase::Initialization && c.stale {
                c.refresh()?;
            }
            Ok(values::get(c.slave.as_mut(), references, values)?)
        })
    }

    /// Writes all values, or none.
    pub(crate) fn set<V: Value>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &[V],
    ) -> Outcome {
        self.call(call, |c| {
            c.stale = true;
            let running = c.phase == Phase::StepComplete;
            Ok(values::set(c.slave.as_mut(), references, values, running)?)
        })
    }

    /// There are no String variables: refuses any reference to one.
    pub(crate) fn strings(&mut self, call: &Call, references: &[u32]) -> Outcome {
        self.call(call, |c| {
            Ok(values::no_string(c.slave.as_mut(), references)?)
        })
    }

    /// The end of the last step taken (s).
    pub(crate) fn time(&self) -> f64 {
        self.time.unwrap_or(self.start_time)
    }

    /// Computes the outputs from start values and inputs.
    fn refresh(&mut self) -> Result<(), Failure> {
        self.slave
            .initialize(self.start_time)
            .map_err(|error: ModelError| error.reason().to_owned())?;
        self.stale = false;
        Ok(())
    }
}
