//! Steps that the host sees into: with event mode, early return or intermediate updates (FMI 3.0.2, section
//! 4.2).

use dormand_prince::solver::{MAX_EVENTS, too_many_events};
use fmi_abi::state::State;

use crate::component::{Component, IntermediateUpdate, Outcome};
use crate::lifecycle::Mode;
use crate::model::ModelError;

/// What a step returns besides its outcome.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Results {
    pub(crate) event_handling_needed: bool,
    pub(crate) early_return: bool,
    pub(crate) last_successful_time: f64,
}

impl Results {
    /// Those of a step without events that ended at the given time.
    #[inline(always)]
    pub(crate) fn plain(last_successful_time: f64) -> Self {
        Self { event_handling_needed: false, early_return: false, last_successful_time }
    }
}

/// What to do next in a step.
pub(crate) enum Next {
    /// Let the host do its update, and continue with the time of an early return that it requests.
    Update(IntermediateUpdate),
    /// Return from the step.
    Return(Outcome, Results),
}

/// A step that is taken in parts. It borrows the component only while a part is taken, since the host calls
/// functions of the instance in an intermediate update.
pub(crate) struct Stepping {
    start: f64,
    size: f64,
    /// The time reached, and the time at which to end, which the host may bring forward.
    now: f64,
    end: f64,
    /// Times that differ less are equal: their rounding errors differ, and the errors of hosts add up.
    tolerance: f64,
    /// The internal points, where the host is called back, divide the step into so many equal parts.
    count: f64,
    /// The next internal point, from 1.
    k: u32,
    /// Events that were handled.
    events: u32,
}

impl Stepping {
    /// Begins a step; fails with what it returns if no step is to be taken.
    pub(crate) fn begin(
        c: &mut Component,
        time: f64,
        step: f64,
    ) -> Result<Self, (Outcome, Results)> {
        if let Some(outcome) = c.refuse_step(time, step) {
            return Err((outcome, Results::plain(c.shared.lifecycle.now())));
        }
        let call = &c.shared.settings.edge.do_step;
        // As without event mode, a step with too many samples is not begun.
        let counted = c.call(call, |c| {
            let shared = &c.shared;
            let is_whole = !shared.settings.early_return_allowed;
            if is_whole && c.model.facts().is_sampled {
                let mut clock = shared.lifecycle.clock;
                let counted = clock.due(time, step);
                counted.map_err(|error| error.in_step(time, step))?;
            }
            Ok(())
        });
        if counted != Outcome::Ok {
            return Err((counted, Results::plain(c.shared.lifecycle.now())));
        }
        /// The internal points are at most this many, and at most as far from each other as the steps of the
        /// model's default experiment.
        const MAX: f64 = 1e6;
        let facts = c.model.facts();
        let count = match c.shared.settings.intermediate_update.is_some() && facts.is_continuous {
            true => libm::ceil(step / facts.step - 1e-6).clamp(1.0, MAX),
            false => 1.0,
        };
        Ok(Self {
            start: time,
            size: step,
            now: time,
            end: time + step,
            tolerance: 1e-6 * step + 8.0 * f64::EPSILON * time.abs(),
            count,
            k: 1,
            events: 0,
        })
    }

    /// Takes parts of the step up to the next intermediate update, or the end.
    pub(crate) fn advance(&mut self, c: &mut Component) -> Next {
        match self.take_parts(c) {
            Ok(next) => next,
            Err(outcome) => {
                let now = c.shared.lifecycle.now();
                let outcome = match now > self.start {
                    true => c.fail_part(outcome),
                    false => outcome,
                };
                Next::Return(outcome, Results::plain(now))
            }
        }
    }

    fn take_parts(&mut self, c: &mut Component) -> Result<Next, Outcome> {
        let call = &c.shared.settings.edge.do_step;
        let settings = &c.shared.settings;
        let may_return = settings.early_return_allowed;
        let calls_back = settings.intermediate_update.is_some();
        let has_events = c.shared.lifecycle.mode == Mode::CoSimulationWithEvents;
        loop {
            let internal = self.start + self.size * (f64::from(self.k) / self.count);
            let is_internal = internal < self.end - self.tolerance;
            let mut to = if is_internal { internal } else { self.end };
            let mut event = None;
            let outcome = c.call(call, |c| {
                event = c.next_event(self.now).filter(|_| has_events);
                Ok(())
            });
            passed(outcome)?;
            let event = event.filter(|event| *event <= to + self.tolerance);
            if let Some(event) = event {
                // A step that ends at an event ends exactly where the host wants it.
                let is_end = event >= self.end - self.tolerance;
                to = if is_end { self.end } else { event.max(self.now) };
            }
            passed(c.call(call, |c| c.take_part(self.now, to - self.now, has_events)))?;
            self.now = to;
            let is_end = self.now >= self.end - self.tolerance;
            if event.is_some() {
                // Without early return, events within the step are handled here.
                if is_end || may_return {
                    return Ok(self.finish(true));
                }
                self.events += 1;
                let is_chattering = self.events > MAX_EVENTS;
                passed(c.call(call, |c| match c.model.facts().is_sampled {
                    false if is_chattering => Err(too_many_events()),
                    _ => c.handle_event(self.now).map(drop),
                }))?;
                if internal > self.now + self.tolerance {
                    continue;
                }
            }
            self.k += 1;
            if calls_back {
                c.enter(State::IntermediateUpdate);
                return Ok(Next::Update(IntermediateUpdate {
                    time: self.now,
                    set_requested: !is_end,
                    can_return_early: may_return && !is_end,
                }));
            }
            if is_end || self.end <= self.now + self.tolerance {
                return Ok(self.finish(false));
            }
        }
    }

    /// Continues after an intermediate update, in which the host may have requested an early return.
    pub(crate) fn resume(
        &mut self,
        c: &mut Component,
        update: IntermediateUpdate,
        requested: Option<f64>,
    ) -> Next {
        match c.shared.lifecycle.state {
            State::IntermediateUpdate => c.enter(State::StepMode),
            State::Fatal => return Next::Return(Outcome::Fatal, Results::plain(self.now)),
            _ => return Next::Return(Outcome::Error, Results::plain(self.now)),
        }
        let requested = requested.filter(|time| update.can_return_early && time.is_finite());
        if let Some(requested) = requested {
            self.end = requested.clamp(self.now, self.end);
        }
        match !update.set_requested || self.end <= self.now + self.tolerance {
            true => self.finish(false),
            false => self.advance(c),
        }
    }

    fn finish(&self, event_handling_needed: bool) -> Next {
        let results = Results {
            event_handling_needed,
            early_return: self.now < self.start + self.size - self.tolerance,
            last_successful_time: self.now,
        };
        Next::Return(Outcome::Ok, results)
    }
}

fn passed(outcome: Outcome) -> Result<(), Outcome> {
    match outcome {
        Outcome::Ok => Ok(()),
        other => Err(other),
    }
}

impl Component {
    /// Takes a part of a step. With events, samples are not taken here, and time events not handled.
    fn take_part(&mut self, time: f64, step: f64, has_events: bool) -> Result<(), ModelError> {
        let holds = has_events && self.model.facts().is_sampled;
        if step > 0.0 && !holds {
            let taken = self.take_step(time, step, !has_events);
            taken.map_err(|error| error.in_step(time, step))?;
        }
        self.shared.lifecycle.time = time + step;
        Ok(())
    }

    /// The outcome of a step of which a part was not taken, though others were: what the model refuses
    /// is discarded, as the instance is no longer where the step began.
    fn fail_part(&mut self, outcome: Outcome) -> Outcome {
        if outcome == Outcome::Error && self.shared.lifecycle.state == State::StepMode {
            self.enter(State::StepFailed);
            return Outcome::Discard;
        }
        outcome
    }
}
