//! Events: event mode, and the samples and time events that are due.

use fmi_abi::state::State;

use crate::clock::{Due, SampleClock};
use crate::error::{ModelError, Severity};
use crate::instance::{EventUpdate, Instance};
use crate::lifecycle::Lifecycle;

/// Maximum number of time events in one communication step of event mode; more would take seconds to handle.
const MAX_EVENTS: u32 = 10_000_000;
impl Instance {
    pub(crate) fn enter_event_mode(&mut self) -> Result<(), ModelError> {
        if self.shared.lifecycle.state == State::Event {
            // As OpenModelica does right after the initialization.
            self.warn_once("event mode is entered in event mode");
            return Ok(());
        }
        let lifecycle = &mut self.shared.lifecycle;
        // In step mode, nothing is computed for event mode.
        lifecycle.stale |= lifecycle.state == State::StepMode;
        if let Some(clocks) = self.shared.clocks() {
            clocks.begin(self);
        }
        self.enter(State::Event);
        Ok(())
    }

    pub(crate) fn enter_continuous_time_mode(&mut self) -> Result<(), ModelError> {
        self.check_instant_ended()?;
        self.enter(State::ContinuousTime);
        Ok(())
    }

    /// Enters step mode with the outputs of event mode.
    pub(crate) fn enter_step_mode(&mut self) -> Result<(), ModelError> {
        self.check_instant_ended()?;
        self.bring_up_to_date().map_err(ModelError::not_discarded)?;
        self.enter(State::StepMode);
        Ok(())
    }

    fn check_instant_ended(&mut self) -> Result<(), ModelError> {
        self.shared.clocks().map_or(Ok(()), |clocks| clocks.check_ended(self))
    }

    /// Ends an instant of event mode.
    pub(crate) fn update_instant(&mut self) -> Result<EventUpdate, ModelError> {
        match self.shared.clocks() {
            Some(clocks) => clocks.update(self),
            None => self.handle_events(),
        }
    }

    fn handle_events(&mut self) -> Result<EventUpdate, ModelError> {
        let states_changed = self.take_events()?;
        Ok(EventUpdate { states_changed, next_event: self.next_event() })
    }

    /// Handles what is due in event mode: samples, time events, and what has happened now. Returns whether states
    /// changed.
    pub(crate) fn take_events(&mut self) -> Result<bool, ModelError> {
        let Lifecycle { instance_type, time, .. } = self.shared.lifecycle;
        let (info, before) = (self.model.info(), self.model.states());
        if self.shared.lifecycle.stale {
            self.model.evaluate_before_event(time);
        }
        self.shared.lifecycle.stale = true;
        if info.is_sampled {
            self.take_due_samples(time)?;
        } else if instance_type.is_model_exchange() {
            self.model.behavior_mut().on_event(time)?;
            self.shared.lifecycle.integration.handled = time;
        } else {
            self.handle_past_events(time)?;
        }
        let states_changed = self.model.states() != before;
        self.shared.lifecycle.integration.restarts |= states_changed;
        Ok(states_changed)
    }

    fn take_due_samples(&mut self, time: f64) -> Result<(), ModelError> {
        if self.model.info().rates > 0 {
            self.take_ticks(time, Due::Until(time))?;
            return self.model.check_outputs();
        }
        let clock = &mut self.shared.lifecycle.clock;
        let before = *clock;
        let due = clock.count_due_until(time)?;
        self.take_samples(due, before)?;
        self.model.check_outputs()
    }

    /// Takes the last `due` samples that the clock has counted; `before` is the clock without them.
    pub(crate) fn take_samples(&mut self, due: u32, before: SampleClock) -> Result<(), ModelError> {
        let clock = &mut self.shared.lifecycle.clock;
        for remaining in (1..=due).rev() {
            let instant = clock.instant_before(remaining);
            if let Err(error) = self.model.behavior_mut().on_step(instant, clock.sample_time()) {
                if remaining < due {
                    return Err(error.with_severity(Severity::Broken)); // earlier samples have changed the model
                }
                *clock = before;
                return Err(error);
            }
        }
        Ok(())
    }

    /// Takes what is due at the rates of the model, in the order of time.
    pub(crate) fn take_ticks(&mut self, time: f64, due: Due) -> Result<(), ModelError> {
        self.shared.rate_clocks.check_count(time, due)?;
        let mut is_changed = false;
        while let Some(tick) = self.shared.rate_clocks.next_tick(time, due) {
            let behavior = self.model.behavior_mut();
            let taken = behavior.on_tick(tick.rate, tick.time, tick.sample_time);
            taken.map_err(|error| match is_changed {
                true => error.with_severity(Severity::Broken), // earlier samples have changed the model
                false => error,
            })?;
            self.shared.rate_clocks.advance(tick);
            is_changed = true;
        }
        Ok(())
    }

    /// Handles the time events until now, which a step without early return may have passed, and what has
    /// happened now. The end of a step reaches a time event but for rounding errors.
    fn handle_past_events(&mut self, now: f64) -> Result<(), ModelError> {
        let tolerance = 1e-6 * self.model.info().step + 8.0 * f64::EPSILON * now.abs();
        let (mut is_handled, mut events) = (false, 0);
        while let Some(event) = self.next_event().filter(|event| *event <= now + tolerance) {
            events += 1;
            if events > MAX_EVENTS {
                let reason = format_args!("more than {MAX_EVENTS} events are due");
                return Err(ModelError::new(reason));
            }
            self.model.behavior_mut().on_event(event)?;
            self.shared.lifecycle.integration.handled = event;
            is_handled = event >= now - tolerance;
        }
        if !is_handled {
            self.model.behavior_mut().on_event(now)?;
        }
        let handled = &mut self.shared.lifecycle.integration.handled;
        *handled = handled.max(now);
        Ok(())
    }

    /// The time of the next event that is not handled, if it is known.
    pub(crate) fn next_event(&self) -> Option<f64> {
        let lifecycle = &self.shared.lifecycle;
        let info = self.model.info();
        if info.is_sampled {
            return Some(match info.rates {
                0 => lifecycle.clock.next_instant(),
                _ => self.shared.rate_clocks.next_instant(),
            });
        }
        let handled = lifecycle.integration.handled;
        let event = self.model.behavior().on_next_event(handled);
        event.filter(|event| *event > handled && event.is_finite())
    }
}
