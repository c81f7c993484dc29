//! A component with clocks in a run: the calls of its FMU at an instant.
//!
//! At an instant, the component is in event mode. In each super-dense instant in which it takes part, it is evaluated once:
//! its clocks are activated, its inputs set and its outputs got. An update of its discrete states ends the super-dense
//! instant, and the FMU tells when its clocks tick next (FMI 3.0.2, sections 2.2.9 and 2.3.5).

use std::fmt::Display;

use fmu_description::{ClockType, IntervalVariability};
use fmu_host::{Instance, IntervalQualifier};

use crate::clocked_stage::{InputClock, Member};
use crate::component_clocks::{ComponentClocks, Part, insert};
use crate::component_instance::{CallResult, ComponentInstance};
use crate::recorded_instance::{IntegrationError, Operation};
use crate::store::Store;
use crate::ticks::{Span, Ticks, rounding};

/// An error that names a clock.
fn unexpected(clock: &InputClock, what: String) -> IntegrationError {
    let reason = format!("{what} for the clock {}", clock.name);
    IntegrationError::Equations { reason, is_discarded: false, advice: None }
}

impl ComponentInstance<'_> {
    /// Calls a function for the clocks.
    fn clock_call<T>(
        &mut self,
        operation: Operation,
        what: impl Display,
        call: impl FnOnce(&mut Instance) -> fmu_host::Result<T>,
    ) -> CallResult<T> {
        let called = self.recorded.call(operation, call);
        called.map_err(|error| self.integration_error(error, what.to_string()))
    }

    /// Calls a function for the clocks, which may return a warning.
    fn clock_call_with_warning(
        &mut self,
        operation: Operation,
        what: &str,
        call: impl FnOnce(&mut Instance) -> fmu_host::Result,
    ) -> CallResult {
        let success = self.clock_call(operation, what, call)?;
        self.recorded.warn(success);
        Ok(())
    }

    /// Asks for the first ticks of the input clocks, at the end of the initialization, which is at a start time (s).
    pub(crate) fn begin_clocks(&mut self, inputs: &[InputClock], start: f64) -> CallResult {
        use IntervalVariability::{Changing, Countdown, Triggered};
        let mut ticks = Vec::with_capacity(inputs.len());
        for clock in inputs {
            let of_type = &clock.of_type;
            ticks.push(match of_type.interval_variability {
                Triggered if clock.given.is_empty() => None,
                Triggered => Some(Ticks::Next(clock.given.first().copied())),
                Changing | Countdown => {
                    let mut ticks = Ticks::Next(None);
                    if let Some(interval) = self.interval(clock)?.0 {
                        ticks.restart(start, interval);
                    }
                    Some(ticks)
                }
                _ if of_type.is_asked_for() => {
                    let interval = self.interval(clock)?.0.unwrap_or(Span::ZERO);
                    Some(Ticks::periodic(start, self.shift(clock)?, interval))
                }
                _ => {
                    let interval = known(of_type, of_type.interval.unwrap_or_default());
                    Some(Ticks::periodic(start, known(of_type, of_type.shift), interval))
                }
            });
        }
        self.clocks = Some(Box::new(ComponentClocks {
            time: start,
            ticks,
            is_due: true,
            is_entered: true,
            ..ComponentClocks::default()
        }));
        Ok(())
    }

    /// The interval of a clock to its next tick, as the FMU says, and whether it is new. A countdown clock may have none.
    pub(crate) fn interval(&mut self, clock: &InputClock) -> CallResult<(Option<Span>, bool)> {
        let (reference, what) = (clock.reference, &*clock.name);
        let (span, qualifier) = if clock.of_type.supports_fraction {
            let asked = |i: &mut Instance| i.interval_fraction(reference);
            let (fraction, qualifier) =
                self.clock_call(Operation::IntervalFraction, what, asked)?;
            (fraction.into(), qualifier)
        } else {
            let asked = |i: &mut Instance| i.interval_decimal(reference);
            let (seconds, qualifier) = self.clock_call(Operation::Interval, what, asked)?;
            (Span::Decimal(seconds), qualifier)
        };
        self.checked_interval(clock, span, qualifier)
    }

    /// The interval that the FMU says, as [`ComponentInstance::interval`].
    pub(crate) fn checked_interval(
        &mut self,
        clock: &InputClock,
        span: Span,
        qualifier: IntervalQualifier,
    ) -> CallResult<(Option<Span>, bool)> {
        let kind = clock.of_type.interval_variability;
        let is_countdown = kind == IntervalVariability::Countdown;
        let seconds = span.seconds();
        let error = match qualifier {
            IntervalQualifier::NotYetKnown if is_countdown => return Ok((None, false)),
            IntervalQualifier::NotYetKnown => {
                let kind = kind.as_str();
                format!(
                    "fmi3IntervalNotYetKnown, which only a countdown clock may be, is returned; the clock is {kind}:"
                )
            }
            _ if seconds >= 0.0
                && seconds.is_finite()
                && (seconds > 0.0 || !kind.is_periodic()) =>
            {
                return Ok((Some(span), qualifier == IntervalQualifier::Changed));
            }
            // Nobody needs the interval of a tick that is pending, so FMUs leave it out.
            IntervalQualifier::Unchanged if is_countdown => return Ok((None, false)),
            _ => {
                let positive = if kind.is_periodic() { "a" } else { "0 or a" };
                format!(
                    "the interval {seconds:?} s is returned, expected {positive} positive number,"
                )
            }
        };
        Err(self.integration_error(unexpected(clock, error), String::new()))
    }

    /// The time from the start to the first tick of a periodic clock, as the FMU says.
    fn shift(&mut self, clock: &InputClock) -> CallResult<Span> {
        let (references, what) = ([clock.reference], &*clock.name);
        let span = if clock.of_type.supports_fraction {
            let (mut counters, mut resolutions) = ([0], [0]);
            self.clock_call_with_warning(Operation::ShiftFraction, what, |instance| {
                instance.get_shift_fraction(&references, &mut counters, &mut resolutions)
            })?;
            Span::Fraction { counter: counters[0], resolution: resolutions[0] }
        } else {
            let mut shifts = [f64::NAN];
            self.clock_call_with_warning(Operation::Shift, what, |instance| {
                instance.get_shift_decimal(&references, &mut shifts)
            })?;
            Span::Decimal(shifts[0])
        };
        let seconds = span.seconds();
        if seconds >= 0.0 && seconds.is_finite() {
            return Ok(span);
        }
        let error =
            format!("the shift {seconds:?} s is returned, expected 0 or a positive number,");
        Err(self.integration_error(unexpected(clock, error), String::new()))
    }

    /// Evaluates the component at a super-dense instant: activates its clocks, sets its inputs and gets its outputs. Its
    /// output clocks that tick are active then, too.
    pub(crate) fn evaluate(&mut self, member: &Member, outputs: &mut Store) -> CallResult {
        let Some(clocks) = self.clocks.as_deref_mut() else { return Ok(()) };
        clocks.part = Part::Evaluated;
        let is_repeated = clocks.active.iter().any(|clock| clocks.ticked_in_mode.contains(clock));
        if clocks.is_entered && is_repeated {
            // A time-based clock ticks once in event mode.
            self.leave_event_mode()?;
        }
        self.enter_event_mode()?;
        self.activate(&member.inputs)?;
        self.recorded.calls.begin(None);
        self.write::<false>(outputs)?;
        if self.fmu.evaluates_discrete_states {
            let evaluate = Instance::evaluate_discrete_states;
            self.clock_call_with_warning(Operation::Evaluate, "tick", evaluate)?;
        }
        self.get_output_clocks(member)?;
        self.recorded.calls.begin(None);
        self.read::<false>(outputs)
    }

    /// Whether it has clocks and is in event mode.
    pub(crate) fn is_in_event_mode(&self) -> bool {
        self.clocks.as_ref().is_some_and(|clocks| clocks.is_entered)
    }

    /// Enters event mode, unless it is in it.
    pub(crate) fn enter_event_mode(&mut self) -> CallResult {
        let is_outside =
            |clocks: &&mut ComponentClocks| !clocks.is_entered && !clocks.is_scheduled();
        let Some(clocks) = self.clocks.as_deref_mut().filter(is_outside) else {
            return Ok(());
        };
        clocks.is_entered = true;
        self.clock_call_with_warning(Operation::EventMode, "event", Instance::enter_event_mode)
    }

    /// Returns to step mode, if it is in event mode.
    pub(crate) fn leave_event_mode(&mut self) -> CallResult {
        let Some(clocks) = self.clocks.as_deref_mut().filter(|clocks| clocks.is_entered) else {
            return Ok(());
        };
        clocks.is_entered = false;
        clocks.ticked_in_mode.clear();
        self.clock_call_with_warning(Operation::StepMode, "event", Instance::enter_step_mode)
    }

    /// Activates the input clocks that tick.
    fn activate(&mut self, inputs: &[InputClock]) -> CallResult {
        let Some(mut clocks) = self.clocks.take() else { return Ok(()) };
        let ComponentClocks { active, ticked, ticked_in_mode, references, states, .. } =
            &mut *clocks;
        references.clear();
        for clock in inputs.iter().filter(|clock| active.contains(&clock.reference)) {
            references.push(clock.reference);
            insert(ticked, clock.reference);
            if clock.of_type.interval_variability.is_time_based() {
                insert(ticked_in_mode, clock.reference);
            }
        }
        states.clear();
        states.resize(references.len(), 1);
        let activated = match references.is_empty() {
            true => Ok(()),
            false => self.clock_call_with_warning(Operation::SetClock, "tick", |instance| {
                instance.set_clock(references, states)
            }),
        };
        self.clocks = Some(clocks);
        activated
    }

    /// Finds the output clocks that tick.
    fn get_output_clocks(&mut self, member: &Member) -> CallResult {
        if member.outputs.is_empty() {
            return Ok(());
        }
        let Some(mut clocks) = self.clocks.take() else { return Ok(()) };
        let ComponentClocks { active, ticked, references, states, .. } = &mut *clocks;
        references.clear();
        references.extend(member.outputs.iter().map(|clock| clock.reference));
        states.clear();
        states.resize(references.len(), 0);
        let got = self.clock_call_with_warning(Operation::GetClock, "tick", |instance| {
            instance.get_clock(references, states)
        });
        for (reference, _) in references.iter().zip(states).filter(|(_, state)| **state != 0) {
            insert(active, *reference);
            insert(ticked, *reference);
        }
        self.clocks = Some(clocks);
        got
    }

    /// Ends the super-dense instant of a component that was evaluated at a time (s): updates its discrete states, and asks
    /// for the next ticks. It takes part in the next super-dense instant if a clock ticks or an event is due at the same
    /// time.
    pub(crate) fn end_instant(&mut self, member: &Member, time: f64, same: f64) -> CallResult {
        let operation = Operation::Update;
        let update = self.clock_call(operation, "tick", Instance::update_discrete_states)?;
        if update.terminate {
            let terminated = self.recorded.terminated(operation, time);
            return Err(self.integration_error(terminated, "tick".to_owned()));
        }
        let Some(mut clocks) = self.clocks.take() else { return Ok(()) };
        let next = self.next_ticks(&mut clocks, &member.inputs, time);
        clocks.active.clear();
        std::mem::swap(&mut clocks.active, &mut clocks.deferred);
        // One that is past would come again and again.
        clocks.next_event = update.next_event.filter(|next| *next > time);
        clocks.is_due = update.again;
        clocks.part = Part::None;
        clocks.begin_instant(&member.inputs, time, same);
        self.clocks = Some(clocks);
        next
    }

    /// Asks for the ticks after the ones of this super-dense instant, at a time (s).
    fn next_ticks(
        &mut self,
        clocks: &mut ComponentClocks,
        inputs: &[InputClock],
        time: f64,
    ) -> CallResult {
        use IntervalVariability::{Calculated, Changing};
        for (ticks, clock) in clocks.ticks.iter_mut().zip(inputs) {
            let Some(ticks) = ticks else { continue };
            let has_ticked = clocks.active.contains(&clock.reference);
            if has_ticked {
                clock.tick(ticks, time);
            }
            let kind = clock.of_type.interval_variability;
            let is_asked = match kind {
                Changing => has_ticked,
                Calculated => false,
                _ => clock.of_type.is_asked_for(),
            };
            if !is_asked {
                continue;
            }
            // A tick that is pending remains if the next interval is not yet known.
            if let (Some(interval), is_new) = self.interval(clock)?
                && (is_new || kind == Changing)
            {
                ticks.restart(time, interval);
            }
        }
        Ok(())
    }

    /// Steps to a time (s), at most; `step` is the communication step. An event there is left for the next instant.
    pub(crate) fn step_to(&mut self, target: f64, step: f64) -> CallResult {
        let Some(clocks) = self.clocks.as_deref_mut() else { return Ok(()) };
        if clocks.is_scheduled() {
            // It does nothing between activations.
            clocks.time = target;
            return Ok(());
        }
        let (time, same) = (clocks.time, rounding(target, step));
        let size = target - time;
        // The size of an undivided step is that of the system.
        let size = if (size - step).abs() <= same { step } else { size };
        let operation = Operation::DoStep;
        let called = |instance: &mut Instance| instance.do_step_to_event(time, size);
        let (success, stepped) =
            self.clock_call(operation, format_args!("step of {size:?} s"), called)?;
        self.recorded.warn(success);
        let reached = match stepped.early_return || stepped.terminate {
            true => stepped.last_successful_time,
            false => target,
        };
        let error = if stepped.terminate {
            self.recorded.terminated(operation, reached)
        } else if !(time - same..=target + same).contains(&reached) {
            let reason = format!(
                "fmi3DoStep returned early with lastSuccessfulTime = {reached:?} s in a step from {time:?} s to {target:?} s"
            );
            IntegrationError::Equations { reason, is_discarded: false, advice: None }
        } else {
            if let Some(clocks) = &mut self.clocks {
                clocks.time = reached;
                clocks.is_due |= stepped.event_handling_needed;
            }
            return Ok(());
        };
        Err(self.integration_error(error, format!("step of {size:?} s")))
    }
}

/// A time of a model description (s): a fraction, if the clock has a resolution of which it is a multiple.
fn known(clock: &ClockType, seconds: f64) -> Span {
    match (clock.counter(seconds), clock.resolution) {
        (Some(counter), Some(resolution))
            if (counter as f64 / resolution as f64 - seconds).abs() <= 1e-9 * seconds =>
        {
            Span::Fraction { counter, resolution }
        }
        _ => Span::Decimal(seconds),
    }
}
