//! What FMI asks of any slave, whatever its version: the state machine, checks, the panic guard.

use std::any::Any;
use std::ffi::CStr;
use std::panic::{AssertUnwindSafe, catch_unwind};

use serde::{Deserialize, Serialize};

use crate::log::{Category, Log};
use crate::model::{Kind, ModelError};
use crate::phase::{self, Call, Phase};
use crate::reason::{Reason, reason};
use crate::slave::Slave;
use crate::snapshot::Snapshot;
use crate::values::{self, Value};

/// How a call ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Ok,
    Discard,
    Error,
    Fatal,
}

/// Why a call failed.
pub(crate) enum Failure {
    /// The call was wrong, and changed nothing.
    Refused(Reason),
    /// The step was not taken, and the model is as it was.
    Discarded(Reason),
    /// The model cannot go on.
    Broken(Reason),
}

impl From<Reason> for Failure {
    fn from(reason: Reason) -> Self {
        Self::Refused(reason)
    }
}

/// Where an instance stands in its life. With the model's values, that is all of its state.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Life {
    phase: Phase,
    start_time: f64,
    stop_time: Option<f64>,
    /// The current communication point (s), once a step was taken.
    time: Option<f64>,
    /// Whether values were set since the outputs were last initialized.
    stale: bool,
    /// Whether an input has a time derivative for the next step.
    sloped: bool,
}

impl Life {
    const NEW: Self = Self {
        phase: Phase::Instantiated,
        start_time: 0.0,
        stop_time: None,
        time: None,
        stale: true,
        sloped: false,
    };

    /// Whether the state of an instance in it can be saved: a dead one answers no call.
    pub(crate) fn can_be_saved(&self) -> bool {
        self.phase != Phase::Fatal
    }
}

/// An instance of a model, as the host holds it.
pub(crate) struct Component {
    log: Log,
    life: Life,
    slave: Box<dyn Slave>,
}

impl Component {
    pub(crate) fn new(log: Log, slave: Box<dyn Slave>) -> Self {
        Self {
            log,
            life: Life::NEW,
            slave,
        }
    }

    /// Does the work of a call if the state allows it, and tells what went wrong.
    pub(crate) fn call(
        &mut self,
        call: &Call,
        work: impl FnOnce(&mut Self) -> Result<(), Failure>,
    ) -> Outcome {
        if !call.is_allowed(self.life.phase) {
            return self.refuse_in_this_phase(call);
        }
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(Ok(())) => Outcome::Ok,
            Ok(Err(failure)) => self.fail(call.name, failure),
            Err(panic) => self.die(call.name, panic.as_ref()),
        }
    }

    /// Refuses a call that no state allows, with its reason.
    pub(crate) fn refuse(&self, name: &str, reason: impl Into<Reason>) -> Outcome {
        self.log.send(Category::Error, || {
            format!("{name}: {}", reason.into().text())
        });
        Outcome::Error
    }

    #[cold]
    fn refuse_in_this_phase(&self, call: &Call) -> Outcome {
        self.log.send(Category::Error, || {
            format!(
                "{} is not allowed in the state \"{}\"; it is allowed in: {}",
                call.name,
                self.life.phase.name(),
                call.allowed_names()
            )
        });
        match self.life.phase {
            Phase::Fatal => Outcome::Fatal,
            _ => Outcome::Error,
        }
    }

    #[cold]
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
    fn die(&mut self, name: &str, panic: &(dyn Any + Send)) -> Outcome {
        self.life.phase = Phase::Fatal;
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
        self.life.phase = phase;
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
            c.life.start_time = start;
            c.life.stop_time = stop;
            c.life.stale = true;
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
            c.life = Life::NEW;
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
                let kind = error.kind();
                let reason = reason!("from t = {time:?} s by {step:?} s: {}", error.reason());
                match kind {
                    Kind::Refused => Failure::Refused(reason),
                    Kind::Discarded => Failure::Discarded(reason),
                    Kind::Broken => Failure::Broken(reason),
                }
            })?;
            c.life.time = Some(time + step);
            if c.life.sloped {
                c.slave.clear_slopes();
                c.life.sloped = false;
            }
            Ok(())
        })
    }

    fn check_step(&self, time: f64, step: f64) -> Result<(), Reason> {
        if !step.is_finite() || step < 0.0 {
            return Err(reason!(
                "the communication step is {step:?}; expected a finite number of at least 0"
            ));
        }
        if !time.is_finite() {
            return Err(reason!(
                "the communication point is {time:?}; expected a finite number"
            ));
        }
        // Hosts add up or multiply times, and differ by rounding.
        let tolerance = 1e-6 * step + 1e-9 * (1.0 + time.abs());
        match self.life.time {
            Some(end) if (time - end).abs() > tolerance => {
                return Err(reason!(
                    "the communication point is {time:?}; expected {end}, where the last step ended"
                ));
            }
            Some(_) => {}
            None => self.check_first_step(time, step, tolerance)?,
        }
        match self.life.stop_time {
            Some(stop) if time + step > stop + tolerance => Err(reason!(
                "the step ends at {:?}, past the stop time {stop:?}",
                time + step
            )),
            _ => Ok(()),
        }
    }

    /// A sampled loop may begin at its first sample instead of at the start time.
    fn check_first_step(&self, time: f64, step: f64, tolerance: f64) -> Result<(), Reason> {
        let start = self.life.start_time;
        let late = time - start;
        if late < -tolerance || late > step + tolerance {
            return Err(reason!(
                "the first communication point is {time:?}; expected the start time {start}"
            ));
        }
        if late > tolerance {
            self.log.send(Category::Warning, || {
                format!(
                    "fmi2DoStep: the first step begins at {time}, not at the start time {start}"
                )
            });
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
            if c.life.phase == Phase::Initialization && c.life.stale {
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
            let running = c.life.phase == Phase::StepComplete;
            values::set(c.slave.as_mut(), references, values, running)?;
            c.life.stale |= !running;
            Ok(())
        })
    }

    /// There are no String variables: refuses any reference to one.
    pub(crate) fn strings(&mut self, call: &Call, references: &[u32]) -> Outcome {
        self.call(call, |c| {
            Ok(values::no_string(c.slave.as_mut(), references)?)
        })
    }

    /// Gives inputs their first time derivatives for the next step, all or none.
    pub(crate) fn set_slopes(
        &mut self,
        references: &[u32],
        orders: &[i32],
        values: &[f64],
    ) -> Outcome {
        self.call(&phase::INPUT_DERIVATIVES, |c| {
            let slave = c.slave.as_mut();
            values::set_slopes(slave, references, orders, values)?;
            c.life.sloped |= !references.is_empty();
            Ok(())
        })
    }

    /// Derivatives of outputs in a direction of the inputs.
    pub(crate) fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivative: &mut [f64],
    ) -> Outcome {
        self.call(&phase::DIRECTIONAL_DERIVATIVE, |c| {
            let slave = c.slave.as_mut();
            Ok(values::directional_derivative(
                slave, unknowns, knowns, direction, derivative,
            )?)
        })
    }

    /// All that the future of the instance depends on.
    pub(crate) fn snapshot(&self) -> Snapshot {
        Snapshot::new(self.life, self.slave.as_ref())
    }

    /// Continues from a snapshot, of this or another instance of the model.
    pub(crate) fn restore(&mut self, snapshot: &Snapshot) -> Result<(), Reason> {
        self.life = snapshot.restore(self.slave.as_mut())?;
        Ok(())
    }

    pub(crate) fn slave(&self) -> &dyn Slave {
        self.slave.as_ref()
    }

    /// The end of the last step taken (s).
    pub(crate) fn time(&self) -> f64 {
        self.life.time.unwrap_or(self.life.start_time)
    }

    /// Computes the outputs from start values and inputs.
    fn refresh(&mut self) -> Result<(), Failure> {
        self.slave
            .initialize(self.life.start_time)
            .map_err(|error: ModelError| Reason::new(move || error.reason().to_owned()))?;
        self.life.stale = false;
        Ok(())
    }
}
