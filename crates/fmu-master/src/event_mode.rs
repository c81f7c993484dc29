//! Event mode in co-simulation (FMI 3.0.2, section 4.2): the master handles the events of a component where they happen.
//!
//! A step ends early at an event, and before the next time event that the FMU has announced; the master then handles the
//! event, and takes the rest of the step. Inputs that are not continuous are set in event mode, at each step. An event at
//! the end of a step waits for the inputs of that communication point, if they come from other components, as in model
//! exchange.

use fmu_description::Variability;
use fmu_host::Instance;
use serde::{Deserialize, Serialize};

use crate::Fmu;
use crate::recorded_instance::{IntegrationError, IntegrationResult, Operation, RecordedInstance};
use crate::wiring::VariableGroup;

/// Maximum number of times that discrete states are updated in one event, or that steps end without progress.
const MAX_REPETITIONS: u32 = 1000;

/// A component with event mode between two steps.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct EventMode {
    /// The next time event (s).
    next: Option<f64>,
    /// Whether an input comes from another component, and whether one is not continuous.
    is_fed: bool,
    is_discrete: bool,
    /// Whether an event at the end of the last step is not handled yet.
    is_pending: bool,
    is_entered: bool,
}

/// How far equal times may be apart in a step (s).
fn rounding(time: f64, size: f64) -> f64 {
    1e-6 * size + 8.0 * f64::EPSILON * time.abs()
}

/// A failure without a call that has returned an error.
fn failure(reason: String) -> IntegrationError {
    IntegrationError::Equations { reason, is_discarded: false, advice: None }
}

impl EventMode {
    /// Handles the first event, after the initialization (s).
    pub(crate) fn begin(
        recorded: &mut RecordedInstance,
        fmu: &Fmu,
        groups: &[VariableGroup],
        start: f64,
    ) -> IntegrationResult<Self> {
        let mut scalars = groups.iter().flat_map(|group| &group.inputs.scalars);
        let mut event_mode = Self {
            next: None,
            is_fed: groups.iter().any(|g| g.sources.iter().any(|s| s.component.is_some())),
            is_discrete: scalars.any(|s| fmu.variable(*s).variability != Variability::Continuous),
            is_pending: false,
            is_entered: true,
        };
        event_mode.handle(recorded, start)?;
        Ok(event_mode)
    }

    /// Enters event mode before the inputs for a step from a time (s) are set, if an event is due or an input is not
    /// continuous. The step handles the event.
    pub(crate) fn prepare(
        &mut self,
        recorded: &mut RecordedInstance,
        time: f64,
        size: f64,
    ) -> IntegrationResult {
        let is_due = self.next.is_some_and(|next| next <= time + rounding(time, size));
        match self.is_pending || self.is_discrete || is_due {
            true => self.enter(recorded),
            false => Ok(()),
        }
    }

    /// Enters event mode.
    pub(crate) fn enter(&mut self, recorded: &mut RecordedInstance) -> IntegrationResult {
        if !self.is_entered {
            recorded.call_with_warning(Operation::EventMode, Instance::enter_event_mode)?;
            self.is_entered = true;
        }
        Ok(())
    }

    /// Handles an event at a time (s), and returns to step mode.
    fn handle(&mut self, recorded: &mut RecordedInstance, time: f64) -> IntegrationResult {
        self.enter(recorded)?;
        for _ in 0..MAX_REPETITIONS {
            let operation = Operation::Update;
            let update = recorded.call(operation, Instance::update_discrete_states)?;
            if update.terminate {
                return Err(recorded.terminated(operation, time));
            }
            if !update.again {
                recorded.call_with_warning(Operation::StepMode, Instance::enter_step_mode)?;
                (self.is_entered, self.is_pending) = (false, false);
                // One that is past would come again and again.
                self.next = update.next_event.filter(|next| *next > time);
                return Ok(());
            }
        }
        Err(failure(format!(
            "the event at t = {time:?} s needs more than {MAX_REPETITIONS} updates of discrete states"
        )))
    }

    /// Takes a step from a time (s), and handles its events.
    pub(crate) fn step(
        &mut self,
        recorded: &mut RecordedInstance,
        time: f64,
        size: f64,
    ) -> IntegrationResult {
        if self.is_entered {
            self.handle(recorded, time)?;
        }
        let (end, same) = (time + size, rounding(time, size));
        let (mut now, mut stalled) = (time, 0);
        loop {
            let next = self.next.filter(|next| *next < end - same);
            let target = next.map_or(end, |next| next.max(now));
            let rest = if (now, target) == (time, end) { size } else { target - now };
            let operation = Operation::DoStep;
            let (success, stepped) =
                recorded.call(operation, |instance| instance.do_step_to_event(now, rest))?;
            recorded.warn(success);
            let reached = match stepped.early_return || stepped.terminate {
                true => stepped.last_successful_time,
                false => target,
            };
            if stepped.terminate {
                return Err(recorded.terminated(operation, reached));
            }
            if !(now - same..=target + same).contains(&reached) {
                return Err(failure(format!(
                    "fmi3DoStep returned early with lastSuccessfulTime = {reached:?} s in a step from {now:?} s to {target:?} s"
                )));
            }
            stalled = if reached > now { 0 } else { stalled + 1 };
            if stalled > MAX_REPETITIONS {
                return Err(failure(format!(
                    "fmi3DoStep returned {MAX_REPETITIONS} times at t = {reached:?} s, without progress"
                )));
            }
            now = reached;
            let is_end = now >= end - same;
            let is_due = self.next.is_some_and(|next| next <= now + same);
            if stepped.event_handling_needed || is_due {
                if is_end && self.is_fed {
                    self.is_pending = true;
                } else {
                    self.handle(recorded, now)?;
                }
            }
            if is_end {
                return Ok(());
            }
        }
    }
}
