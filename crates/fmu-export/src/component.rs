//! What FMI requires of every slave: the state machine, checks and the panic guard.

use std::any::Any;
use std::ffi::{CStr, CString};
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::lifecycle::Lifecycle;
use crate::log::{Category, Log};
use crate::model::{Kind, ModelError, Start};
use crate::panics;
use crate::phase::{self, Call, Phase};
use crate::reason::{Reason, reason};
use crate::resources::Folder;
use crate::slave::Slave;
use crate::snapshot::Snapshot;
use crate::values::{self, FmiType, Given};

/// The outcome of a call, numbered like `fmi2Status`, so that converting it is free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub(crate) enum Outcome {
    Ok = 0,
    Discard = 2,
    Error = 3,
    Fatal = 4,
}

/// Why a call failed.
pub(crate) enum Failure {
    /// The call was invalid and changed nothing.
    Refused(Reason),
    /// The step was not taken, and the model is unchanged.
    Discarded(Reason),
    /// The model cannot continue.
    Broken(Reason),
}

impl From<Reason> for Failure {
    fn from(reason: Reason) -> Self {
        Self::Refused(reason)
    }
}

/// An instance of a model; `S` is its [`Slave`].
pub(crate) struct Component<S: ?Sized = dyn Slave> {
    log: Log,
    resources: Folder,
    /// The texts that the last call returned, which live until the next one.
    pub(crate) texts: Vec<CString>,
    pub(crate) lifecycle: Lifecycle,
    pub(crate) slave: S,
}

impl<S> Component<S> {
    pub(crate) fn new(log: Log, resources: Folder, slave: S) -> Self {
        Self {
            log,
            resources,
            texts: Vec::new(),
            lifecycle: Lifecycle::NEW,
            slave,
        }
    }
}

impl Component {
    /// Runs `work` if the call is allowed in the current state, and logs failures.
    pub(crate) fn call(
        &mut self,
        call: &Call,
        work: impl FnOnce(&mut Self) -> Result<(), Failure>,
    ) -> Outcome {
        let mut work = Some(work);
        self.guard(call, &mut |c| work.take().map_or(Ok(()), |work| work(c)))
    }

    /// The code of [`call`](Self::call) that all calls share.
    #[inline(never)]
    fn guard(
        &mut self,
        call: &Call,
        work: &mut dyn FnMut(&mut Self) -> Result<(), Failure>,
    ) -> Outcome {
        if !call.is_allowed(self.lifecycle.phase) {
            return self.refuse_in_phase(call);
        }
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(Ok(())) => Outcome::Ok,
            Ok(Err(failure)) => self.fail(call.name, failure),
            Err(panic) => self.fail_by_panic(call.name, panic),
        }
    }

    /// Logs why a call failed and returns [`Outcome::Error`].
    pub(crate) fn refuse(&self, name: &str, reason: impl Into<Reason>) -> Outcome {
        self.log.send(Category::Error, || {
            format!("{name}: {}", reason.into().text())
        });
        Outcome::Error
    }

    #[cold]
    fn refuse_in_phase(&self, call: &Call) -> Outcome {
        self.log.send(Category::Error, || {
            format!(
                "{} is not allowed in the state \"{}\"; it is allowed in: {}",
                call.name,
                self.lifecycle.phase.name(),
                call.allowed_names()
            )
        });
        match self.lifecycle.phase {
            Phase::Fatal => Outcome::Fatal,
            _ => Outcome::Error,
        }
    }

    /// Logs why a step failed, and enters the state that follows.
    #[cold]
    #[inline(never)]
    pub(crate) fn fail_step(&mut self, error: ModelError, time: f64, step: f64) -> Outcome {
        let kind = error.kind();
        let reason = reason!("from t = {time:?} s by {step:?} s: {}", error.reason());
        let failure = match kind {
            Kind::Refused => Failure::Refused(reason),
            Kind::Discarded => Failure::Discarded(reason),
            Kind::Broken => Failure::Broken(reason),
        };
        self.fail(phase::DO_STEP.name, failure)
    }

    #[cold]
    #[inline(never)]
    fn fail(&mut self, name: &str, failure: Failure) -> Outcome {
        match failure {
            Failure::Refused(reason) => self.refuse(name, reason),
            Failure::Discarded(reason) => {
                self.enter(Phase::StepFailed);
                self.log
                    .send(Category::Discard, || format!("{name}: {}", reason.text()));
                Outcome::Discard
            }
            Failure::Broken(reason) => {
                self.enter(Phase::Error);
                self.refuse(name, reason)
            }
        }
    }

    #[cold]
    #[inline(never)]
    pub(crate) fn fail_by_panic(&mut self, name: &str, panic: Box<dyn Any + Send>) -> Outcome {
        self.lifecycle.phase = Phase::Fatal;
        let text = panic
            .downcast_ref::<&str>()
            .copied()
            .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
            .unwrap_or("no message");
        let place = panics::take_place();
        self.log.send(Category::Fatal, || {
            format!("{name}: {place}the model panicked and is dead: {text}")
        });
        Outcome::Fatal
    }

    fn enter(&mut self, phase: Phase) {
        self.lifecycle.phase = phase;
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
                return Err(reason!("the start time is {start}; expected a finite number").into());
            }
            if let Some(stop) = stop
                && !(stop.is_finite() && stop >= start)
            {
                return Err(reason!(
                    "the stop time is {stop}; expected a finite number, at least the start time {start}"
                )
                .into());
            }
            c.lifecycle.start_time = start;
            c.lifecycle.stop_time = stop.unwrap_or(f64::MAX);
            c.lifecycle.stale = true;
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
            c.lifecycle = Lifecycle::NEW;
            c.enter(Phase::Instantiated);
            Ok(())
        })
    }

    /// Checks a step. Returns the outcome of the call if no step is to be taken.
    #[cold]
    #[inline(never)]
    pub(crate) fn refuse_step(&mut self, time: f64, step: f64) -> Option<Outcome> {
        let mut due = false;
        let outcome = self.call(&phase::DO_STEP, |c| {
            c.lifecycle.check_step(time, step, &c.log)?;
            due = step != 0.0; // some hosts iterate events with steps of 0
            Ok(())
        });
        (!due).then_some(outcome)
    }

    /// Reads the values with the given references.
    pub(crate) fn get<T: FmiType>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &mut [T],
    ) -> Outcome {
        self.call(call, |c| {
            if c.lifecycle.phase == Phase::Initialization && c.lifecycle.stale {
                c.refresh()?;
            }
            Ok(values::get(&mut c.slave, references, values)?)
        })
    }

    /// Reads Strings to [`texts`](Self::texts).
    pub(crate) fn get_texts(&mut self, call: &Call, references: &[u32]) -> Outcome {
        let mut values = vec![String::new(); references.len()];
        let outcome = self.get(call, references, &mut values);
        // C strings end at a zero byte.
        let texts = values.into_iter().map(|text| text.replace('\0', " "));
        self.texts = texts.filter_map(|text| CString::new(text).ok()).collect();
        outcome
    }

    /// Writes all values or none.
    pub(crate) fn set<'a, T: Into<Given<'a>> + Copy>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &[T],
    ) -> Outcome {
        self.call(call, |c| {
            let running = c.lifecycle.phase == Phase::StepComplete;
            values::set(&mut c.slave, references, values, running)?;
            c.lifecycle.stale |= !running;
            Ok(())
        })
    }

    /// Sets the first time derivatives of inputs for the next step, all or none.
    pub(crate) fn set_input_derivatives(
        &mut self,
        references: &[u32],
        orders: &[i32],
        values: &[f64],
    ) -> Outcome {
        self.call(&phase::INPUT_DERIVATIVES, |c| {
            let slave = &mut c.slave;
            values::set_input_derivatives(slave, references, orders, values)?;
            c.lifecycle.has_input_derivatives |= !references.is_empty();
            Ok(())
        })
    }

    /// Computes directional derivatives of outputs with respect to inputs.
    pub(crate) fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivative: &mut [f64],
    ) -> Outcome {
        self.call(&phase::DIRECTIONAL_DERIVATIVE, |c| {
            let slave = &mut c.slave;
            Ok(values::directional_derivative(
                slave, unknowns, knowns, direction, derivative,
            )?)
        })
    }

    /// The complete state of the instance.
    pub(crate) fn snapshot(&self) -> Snapshot {
        Snapshot::new(self.lifecycle, &self.slave)
    }

    /// Restores a snapshot of this or another instance of the model.
    pub(crate) fn restore(&mut self, snapshot: &Snapshot) -> Result<(), Reason> {
        self.lifecycle = snapshot.restore(&mut self.slave)?;
        Ok(())
    }

    pub(crate) fn slave(&self) -> &dyn Slave {
        &self.slave
    }

    /// Computes the outputs from the start values and inputs.
    fn refresh(&mut self) -> Result<(), Failure> {
        let start = Start {
            time: self.lifecycle.start_time,
            resources: self.resources.clone(),
        };
        self.slave
            .initialize(&start)
            .map_err(|error: ModelError| Reason::new(move || error.reason().to_owned()))?;
        self.lifecycle.stale = false;
        Ok(())
    }
}
