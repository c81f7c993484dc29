//! Steps that the fast path leaves to the instance: whole steps, and steps that the host observes, with event
//! mode, early return or intermediate updates (FMI 3.0.2, section 4.2).

use std::panic::{AssertUnwindSafe, catch_unwind};

use fmi_abi::state::State;
use ode_methods::solver::{self, Advanced, Events};

use crate::clock::Due;
use crate::error::ModelError;
use crate::instance::{Instance, IntermediateUpdate, Status, StepEnd};
use crate::lifecycle::InstanceType;

impl Instance {
    /// Takes any step.
    pub(crate) fn step(&mut self, time: f64, step: f64, end: StepEnd) -> Status {
        if !self.shared.lifecycle.is_next_step(time, step)
            && let Some(status) = self.refuse_step(time, step)
        {
            return self.returned(status, end);
        }
        let taken = catch_unwind(AssertUnwindSafe(|| {
            match self.model.info().is_integrated {
                true => self.integrate(time, step)?,
                false => self.take_step(time, step)?,
            }
            self.end_ramps();
            Ok(())
        }));
        self.end_step(taken, time, step, end)
    }

    /// Checks a step. Returns the status of the call if no step is to be taken.
    fn refuse_step(&mut self, time: f64, step: f64) -> Option<Status> {
        let call = &self.shared.settings.edge.do_step;
        let status = self.call(call, |instance| {
            instance.shared.lifecycle.check_step(
                call.name,
                time,
                step,
                &instance.shared.settings.log,
            )
        });
        // Some hosts iterate events with steps of 0.
        (status != Status::Ok || step == 0.0).then_some(status)
    }

    /// Takes a step, or the samples in it, by the function of the model.
    fn take_step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        let info = self.model.info();
        if info.rates > 0 {
            self.take_ticks(time, Due::Before(time + step))?;
        } else if info.is_sampled {
            let clock = &mut self.shared.lifecycle.clock;
            let before = *clock;
            let due = clock.count_due(time, step)?;
            self.take_samples(due, before)?;
        } else {
            self.model.behavior_mut().on_step(time, step)?;
        }
        self.model.check_outputs()
    }

    /// Integrates the equations over a step and handles the events in it.
    fn integrate(&mut self, time: f64, size: f64) -> Result<(), ModelError> {
        self.integrate_to(time, size, Events::Here).map(drop)
    }

    /// Integrates the equations over a step, which changes nothing if it fails.
    #[inline(never)]
    fn integrate_to(
        &mut self,
        time: f64,
        size: f64,
        events: Events,
    ) -> Result<Advanced, ModelError> {
        let (model, shared) = (&mut self.model, &mut self.shared);
        let integration = &mut shared.lifecycle.integration;
        let before = shared.before.get_or_insert_with(|| model.copy());
        before.assign(model);
        // In event mode, the host handles the events that its values cause.
        let switches = match events {
            Events::Here => model.hash_of_switches(),
            Events::EndStep | Events::Wait => integration.switches,
        };
        let event = (switches != integration.switches).then_some(time);
        if event.is_some() {
            model.evaluate_before_event(time);
        }
        let step = solver::Step {
            time,
            size,
            tolerance: integration.tolerance,
            longest: model.info().step.max(1e-3 * size),
            events,
            handled: integration.handled,
            event,
            restarts: integration.restarts,
        };
        let advanced = model.integrate(&mut shared.workspace, &step);
        match &advanced {
            Ok(Advanced { handled, restarts, .. }) => {
                (integration.handled, integration.restarts) = (*handled, *restarts);
                integration.switches = switches;
            }
            Err(_) => _ = model.assign(before.as_ref()),
        }
        advanced
    }

    /// Ends a step that the model took. It failed if the model says so or panicked, or if an output is not finite.
    #[cold]
    #[inline(never)]
    pub(crate) fn end_step(
        &mut self,
        taken: std::thread::Result<Result<(), ModelError>>,
        time: f64,
        step: f64,
        end: StepEnd,
    ) -> Status {
        let call = &self.shared.settings.edge.do_step;
        let status = match taken.map(|taken| taken.and_then(|()| self.model.check_outputs())) {
            Ok(Ok(())) => {
                self.shared.lifecycle.time = time + step;
                Status::Ok
            }
            Ok(Err(error)) => self.fail(call, error.in_step(time, step)),
            Err(panic) => self.fail_by_panic(call, panic),
        };
        self.returned(status, end)
    }

    /// Returns from a step, whose end is the current time.
    fn returned(&self, status: Status, end: StepEnd) -> Status {
        if let Some(end) = end {
            *end = self.shared.lifecycle.now();
        }
        status
    }

    /// Clears the derivatives of inputs, which are for one step.
    fn end_ramps(&mut self) {
        if self.shared.lifecycle.has_input_derivatives {
            self.model.clear_input_derivatives();
            self.shared.lifecycle.has_input_derivatives = false;
        }
    }
}

/// The results of a step besides its status.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepResults {
    pub(crate) event_handling_needed: bool,
    pub(crate) early_return: bool,
    pub(crate) last_successful_time: f64,
}

impl StepResults {
    /// The results of a step without events that ended at the given time.
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
    Return(Status, StepResults),
}

/// A step that is taken in parts. It borrows the instance only while a part is taken, since the host calls
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
    points: f64,
    /// The next internal point, from 1.
    next_point: u32,
    /// Whether an event is to be handled in event mode.
    has_event: bool,
}

impl Stepping {
    /// Begins a step; fails with the result of the call if no step is to be taken.
    pub(crate) fn begin(
        instance: &mut Instance,
        time: f64,
        step: f64,
    ) -> Result<Self, (Status, StepResults)> {
        if let Some(status) = instance.refuse_step(time, step) {
            return Err((status, StepResults::plain(instance.shared.lifecycle.now())));
        }
        let call = &instance.shared.settings.edge.do_step;
        // As without event mode, a step with too many samples is not begun.
        let counted = instance.call(call, |instance| {
            let shared = &instance.shared;
            let is_whole = !shared.settings.early_return_allowed;
            let info = instance.model.info();
            if is_whole && info.is_sampled {
                let mut clock = shared.lifecycle.clock;
                let counted = match info.rates {
                    0 => clock.count_due(time, step).map(drop),
                    _ => shared.rate_clocks.check_count(time, Due::Before(time + step)),
                };
                counted.map_err(|error| error.in_step(time, step))?;
            }
            Ok(())
        });
        if counted != Status::Ok {
            return Err((counted, StepResults::plain(instance.shared.lifecycle.now())));
        }
        /// The internal points are at most this many, and at most as far from each other as the steps of the
        /// model's default experiment.
        const MAX: f64 = 1e6;
        let info = instance.model.info();
        // A ramp of an input begins where the model's own step does, so that step is taken as a whole.
        let is_divided = instance.shared.settings.intermediate_update.is_some()
            && info.is_continuous
            && !instance.shared.lifecycle.has_input_derivatives;
        let points = match is_divided {
            true => libm::ceil(step / info.step - 1e-6).clamp(1.0, MAX),
            false => 1.0,
        };
        Ok(Self {
            start: time,
            size: step,
            now: time,
            end: time + step,
            tolerance: 1e-6 * step + 8.0 * f64::EPSILON * time.abs(),
            points,
            next_point: 1,
            has_event: false,
        })
    }

    /// Takes parts of the step up to the next intermediate update, or the end.
    pub(crate) fn advance(&mut self, instance: &mut Instance) -> Next {
        match self.take_parts(instance) {
            Ok(next) => next,
            Err(status) => {
                let now = instance.shared.lifecycle.now();
                let status = match now > self.start {
                    true => instance.fail_part(status),
                    false => status,
                };
                Next::Return(status, StepResults::plain(now))
            }
        }
    }

    fn take_parts(&mut self, instance: &mut Instance) -> Result<Next, Status> {
        let call = &instance.shared.settings.edge.do_step;
        let settings = &instance.shared.settings;
        let may_return = settings.early_return_allowed;
        let calls_back = settings.intermediate_update.is_some();
        loop {
            let internal = self.start + self.size * (f64::from(self.next_point) / self.points);
            let is_internal = internal < self.end - self.tolerance;
            let to = if is_internal { internal } else { self.end };
            passed(instance.call(call, |instance| self.take_part(instance, to)))?;
            let is_end = self.now >= self.end - self.tolerance;
            if self.has_event && (is_end || may_return) {
                return Ok(self.finish());
            }
            self.next_point += 1;
            if calls_back {
                instance.enter(State::IntermediateUpdate);
                return Ok(Next::Update(IntermediateUpdate {
                    time: self.now,
                    set_requested: !is_end,
                    can_return_early: may_return && !is_end,
                }));
            }
            if is_end || self.end <= self.now + self.tolerance {
                return Ok(self.finish());
            }
        }
    }

    /// Advances to a time, or to the first event if the step may end there. In event mode, events are the
    /// host's: nothing discrete changes in a step. Without early return, they wait for its end.
    fn take_part(&mut self, instance: &mut Instance, mut to: f64) -> Result<(), ModelError> {
        let has_events =
            instance.shared.lifecycle.instance_type == InstanceType::CoSimulationWithEvents;
        let may_return = instance.shared.settings.early_return_allowed;
        let event = if has_events { instance.next_event() } else { None };
        let event = event.filter(|event| *event <= to + self.tolerance);
        // A step that ends at an event ends exactly where the host wants it.
        let is_within = event.is_some_and(|event| event < self.end - self.tolerance);
        if let Some(event) = event.filter(|_| is_within && may_return) {
            to = event.max(self.now);
        }
        self.has_event |= event.is_some();
        let (time, step, info) = (self.now, to - self.now, instance.model.info());
        let mut reached = to;
        if step > 0.0 && !(has_events && info.is_sampled) {
            // A step of the model's own would handle its events.
            let would_handle = !info.event_indicators.is_empty() || is_within && !may_return;
            let taken = match (has_events, info.is_integrated) {
                (false, true) => instance.integrate(time, step),
                (true, is_integrated) if is_integrated || would_handle => {
                    let events = if may_return { Events::EndStep } else { Events::Wait };
                    instance.integrate_to(time, step, events).map(|advanced| {
                        let Advanced { reached: size, has_event, .. } = advanced;
                        self.has_event |= has_event;
                        if size < step {
                            reached = time + size;
                        }
                    })
                }
                _ => instance.take_step(time, step),
            };
            taken.map_err(|error| error.in_step(time, step))?;
        }
        instance.end_ramps();
        self.now = reached;
        instance.shared.lifecycle.time = reached;
        Ok(())
    }

    /// Continues after an intermediate update, in which the host may have requested an early return.
    pub(crate) fn resume(
        &mut self,
        instance: &mut Instance,
        update: IntermediateUpdate,
        requested: Option<f64>,
    ) -> Next {
        match instance.shared.lifecycle.state {
            State::IntermediateUpdate => instance.enter(State::StepMode),
            State::Fatal => return Next::Return(Status::Fatal, StepResults::plain(self.now)),
            _ => return Next::Return(Status::Error, StepResults::plain(self.now)),
        }
        let requested = requested.filter(|time| update.can_return_early && time.is_finite());
        if let Some(requested) = requested {
            // Not `clamp`, whose message brings the formatting of numbers of `std` into C sources.
            self.end = requested.max(self.now).min(self.end);
        }
        match !update.set_requested || self.end <= self.now + self.tolerance {
            true => self.finish(),
            false => self.advance(instance),
        }
    }

    fn finish(&self) -> Next {
        let results = StepResults {
            event_handling_needed: self.has_event,
            early_return: self.now < self.start + self.size - self.tolerance,
            last_successful_time: self.now,
        };
        Next::Return(Status::Ok, results)
    }
}

fn passed(status: Status) -> Result<(), Status> {
    match status {
        Status::Ok => Ok(()),
        other => Err(other),
    }
}

impl Instance {
    /// The status of a step that failed after the first of its parts. A refusal becomes a discard, as the instance is
    /// no longer where the step began.
    fn fail_part(&mut self, status: Status) -> Status {
        if status == Status::Error && self.shared.lifecycle.state == State::StepMode {
            self.enter(State::StepFailed);
            return Status::Discard;
        }
        status
    }
}
