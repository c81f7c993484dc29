//! The integration of equations over communication steps, with error control and the location of events, by an
//! explicit or an implicit [`Method`].
//!
//! It remembers nothing between steps but what [`Advanced`] returns, so that a state is saved with a few numbers. All
//! memory is in a [`Workspace`].

mod explicit;
mod implicit;
mod linearization;
pub mod lu;

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use core::any::Any;
use core::fmt::Arguments;
use core::marker::PhantomData;

use self::linearization::Linearization;
use crate::dormand_prince::{MAX_SHRINKAGE, STAGES, factor};

pub use self::explicit::DormandPrince;
pub use self::implicit::Rodas5p;

/// Maximum number of internal steps between two events; more would take seconds to compute.
const MAX_STEPS: u32 = 100_000;
/// Maximum number of events that follow each other without an internal step between them: they are chattering.
const MAX_EVENTS: u32 = 1000;
/// Smallest relative tolerance that is kept, above rounding errors.
const MIN_TOLERANCE: f64 = 1e-12;
/// Size of the first internal step after an event that leaves an indicator close to zero, in units of the resolution
/// of its time: so short that the indicator is seen to return to its former sign, or to leave zero, before it changes
/// again.
const RESTART: f64 = 1e4;

/// An error of a system, or of the integration.
pub trait SolverError: Sized {
    /// The step cannot be computed: it takes too many internal steps or events, or too short ones.
    fn discard(reason: Arguments<'_>) -> Self;
    /// The step takes too many internal steps of an explicit method, perhaps because the equations are stiff.
    fn too_many_steps(reason: Arguments<'_>) -> Self {
        Self::discard(reason)
    }
    /// Whether shorter internal steps may succeed.
    fn is_discarded(&self) -> bool;
    /// The same error with a message that begins by saying where it happened.
    fn with_prefix(self, prefix: Arguments<'_>) -> Self;
}

/// What is integrated. Times are in s.
pub trait OdeSystem {
    /// Why a call has failed.
    type Error: SolverError;
    /// The order of magnitude of a state.
    fn nominal(&self, state: usize) -> f64;
    /// Reads the states.
    ///
    /// # Errors
    /// They cannot be read.
    fn states(&mut self, states: &mut [f64]) -> Result<(), Self::Error>;
    /// Sets the states, and computes derivatives, event indicators and outputs. Returns false if one of
    /// them is not finite.
    ///
    /// # Errors
    /// The system cannot be evaluated.
    fn evaluate(&mut self, time: f64, states: &[f64]) -> Result<bool, Self::Error>;
    /// Reads the derivatives of the states.
    fn derivatives(&mut self, derivatives: &mut [f64]);
    /// Multiplies the Jacobian of the derivatives with respect to the states by a direction of the states, where the
    /// system was last evaluated. Returns false if the system cannot, so that an implicit method takes differences.
    ///
    /// # Errors
    /// The product cannot be computed.
    fn directional_derivative(
        &mut self,
        _direction: &[f64],
        _product: &mut [f64],
    ) -> Result<bool, Self::Error> {
        Ok(false)
    }
    /// The value of an event indicator when the system was last evaluated.
    fn event_indicator(&mut self, indicator: usize) -> f64;
    /// The error that names what is not finite.
    fn not_finite(&mut self) -> Self::Error;
    /// Called at the end of each internal step, where the system is evaluated. Returns whether an event is to
    /// be handled there.
    ///
    /// # Errors
    /// The integration is not to go on.
    fn completed(&mut self, _time: f64) -> Result<bool, Self::Error> {
        Ok(false)
    }
    /// Handles an event.
    ///
    /// # Errors
    /// The event cannot be handled.
    fn event(&mut self, time: f64) -> Result<(), Self::Error>;
    /// The first event after `time` that is known.
    fn next_event(&self, time: f64) -> Option<f64>;
}

/// A communication step.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Its start (s).
    pub time: f64,
    /// Its size (s).
    pub size: f64,
    /// Relative tolerance of an internal step.
    pub tolerance: f64,
    /// Maximum size of an internal step (s), if there are event indicators.
    pub longest: f64,
    /// Who handles the events.
    pub events: Events,
    /// The time until which events are handled (s).
    pub handled: f64,
    /// The time of an event with which it begins (s). Without, it begins with an event if the system has an event
    /// indicator of another sign than when it was last evaluated: new inputs have caused an event.
    pub event: Option<f64>,
    /// Whether the step before ended with an event that left an indicator close to zero.
    pub restarts: bool,
}

/// Who handles the events in a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Events {
    /// The solver.
    Here,
    /// The caller: the step ends just after the first state event.
    EndStep,
    /// The caller, after the step.
    Wait,
}

/// How far a step came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Advanced {
    /// The time that was integrated (s).
    pub reached: f64,
    /// The time until which events are handled (s).
    pub handled: f64,
    /// Whether there is a state event for the caller.
    pub has_event: bool,
    /// Whether it ended with an event that left an indicator close to zero.
    pub restarts: bool,
}

/// The memory for a step.
#[derive(Default)]
pub struct Workspace {
    /// The states at the start of an internal step.
    states: Vec<f64>,
    /// The states at its end.
    next: Vec<f64>,
    /// The states at another point, or before an event.
    point: Vec<f64>,
    /// Derivatives at the stages of an internal step: the first at its start, the last at its end.
    slopes: [Vec<f64>; STAGES],
    /// Whether each event indicator is positive at the start of an internal step, or before an event.
    signs: Vec<bool>,
    /// What a method needs besides, whose type programs without the method need not know.
    more: Option<Box<dyn Any + Send + Sync>>,
}

impl Clone for Workspace {
    fn clone(&self) -> Self {
        let Self { states, next, point, slopes, signs, more } = self;
        let linearization = more.as_ref().and_then(|more| more.downcast_ref::<Linearization>());
        Self {
            states: states.clone(),
            next: next.clone(),
            point: point.clone(),
            slopes: slopes.clone(),
            signs: signs.clone(),
            more: linearization.map(|of_method| Box::new(of_method.clone()) as _),
        }
    }
}

impl Workspace {
    /// Memory for a number of states and of event indicators.
    pub fn new(states: usize, indicators: usize) -> Self {
        let zeros = || vec![0.0; states];
        Self {
            states: zeros(),
            next: zeros(),
            point: zeros(),
            slopes: core::array::from_fn(|_| zeros()),
            signs: vec![false; indicators],
            more: None,
        }
    }

    /// The same for an implicit method. `dependencies` has the states on which each derivative depends; without, each
    /// depends on all. Two matrices have the square of the number of states as elements.
    pub fn implicit(states: usize, indicators: usize, dependencies: Option<&[Vec<usize>]>) -> Self {
        let linearization = Box::new(Linearization::new(states, dependencies));
        Self { more: Some(linearization), ..Self::new(states, indicators) }
    }

    /// The bytes that this memory has besides, without what an allocator adds.
    pub const fn implicit_size(states: usize) -> usize {
        let vectors = crate::rodas5p::STAGES + 3;
        size_of::<Linearization>() + (2 * states + vectors) * states * size_of::<f64>()
    }
}

/// A one-step method that estimates the error of a step, and interpolates within it.
pub trait Method: Sized {
    /// Whether it is for stiff equations.
    const IS_IMPLICIT: bool;
    /// Takes an internal step of size `h` that ends at `to`: the states and their derivatives at its end.
    ///
    /// # Errors
    /// The system cannot be evaluated, and no shorter step may succeed.
    fn try_step<E: SolverError>(
        run: &mut IntegrationRun<'_, E, Self>,
        h: f64,
        to: f64,
    ) -> Result<Trial<E>, E>;
    /// Computes the states at a fraction of an internal step of size `h`.
    fn interpolate(w: &mut Workspace, fraction: f64, h: f64);
    /// Estimates the size of the first internal step.
    ///
    /// # Errors
    /// As for [`Method::try_step`].
    fn estimate_size<E: SolverError>(
        run: &mut IntegrationRun<'_, E, Self>,
        remaining: f64,
    ) -> Result<f64, E>;
    /// Times that differ less are equal.
    fn resolution<E>(run: &IntegrationRun<'_, E, Self>) -> f64;
    /// Forgets what it knows of the point at which the last internal step started.
    fn leave(_w: &mut Workspace) {}
}

/// Integrates over a communication step by a method, or to an event that ends it.
///
/// Afterwards, the system is evaluated at the end of the step; if it fails, at any point.
///
/// # Errors
/// The errors of the system, and a discarded step, if it would take too many internal steps or events.
pub fn advance<M: Method, E: SolverError>(
    system: &mut dyn OdeSystem<Error = E>,
    workspace: &mut Workspace,
    step: &Step,
) -> Result<Advanced, E> {
    let mut run = IntegrationRun::<_, M>::new(system, workspace, step);
    run.begin()?;
    while let Some((end, event)) = run.next_event() {
        run.integrate(end)?;
        run.event(event, EventCause::Time)?;
    }
    run.integrate(step.size)?;
    let IntegrationRun { reached, handled, has_event, restarts, .. } = run;
    Ok(Advanced { reached, handled, has_event, restarts })
}

/// A step that is being taken. Times are relative to its start, unless they are called absolute.
pub struct IntegrationRun<'a, E, M> {
    system: &'a mut dyn OdeSystem<Error = E>,
    w: &'a mut Workspace,
    step: &'a Step,
    reached: f64,
    /// Size of the next internal step; 0 if it is to be estimated.
    size: f64,
    /// Number of internal steps since the last event.
    steps: u32,
    /// Number of events since the last internal step, and the time of the first of them.
    events: u32,
    counted_from: f64,
    /// The absolute time until which events are handled.
    handled: f64,
    /// Whether there is a state event for the caller.
    has_event: bool,
    /// Whether the last event has left an indicator close to zero, and no internal step was taken since.
    restarts: bool,
    method: PhantomData<M>,
}

/// What causes an event.
#[derive(Clone, Copy, PartialEq)]
enum EventCause {
    /// The caller, at the beginning of the step.
    Inputs,
    /// The time is reached.
    Time,
    /// An event indicator has changed its sign.
    State,
    /// The system, at the end of an internal step.
    Step,
}

/// The outcome of an internal step.
pub enum Trial<E> {
    /// The error relative to the tolerance; not finite if the equations have no values somewhere.
    Error(f64),
    /// The model discards a point.
    Discarded(E),
}

impl<'a, E: SolverError, M: Method> IntegrationRun<'a, E, M> {
    fn new(system: &'a mut dyn OdeSystem<Error = E>, w: &'a mut Workspace, step: &'a Step) -> Self {
        Self {
            system,
            w,
            step,
            reached: 0.0,
            size: 0.0,
            steps: 0,
            events: 0,
            counted_from: 0.0,
            handled: step.handled,
            has_event: false,
            restarts: step.restarts,
            method: PhantomData,
        }
    }

    /// Begins the step, with an event if the caller or new inputs have caused one.
    fn begin(&mut self) -> Result<(), E> {
        // The indicators have the values of the last evaluation, at the end of the step before.
        self.keep_signs();
        if let Some(time) = self.step.event {
            return self.event(time, EventCause::Inputs);
        }
        self.evaluate_here()?;
        let has_crossed = self.has_crossed();
        self.keep_signs();
        if has_crossed && self.step.events == Events::Here {
            return self.event(self.now(), EventCause::Inputs);
        }
        self.has_event = has_crossed;
        self.shorten_first_step();
        Ok(())
    }

    /// Evaluates the equations at the current time and states, which an event may have changed.
    fn evaluate_here(&mut self) -> Result<(), E> {
        self.system.states(&mut self.w.states)?;
        let evaluated = self.system.evaluate(self.now(), &self.w.states);
        if !evaluated.map_err(|error| self.stopped(error))? {
            let error = self.system.not_finite();
            return Err(self.stopped(error));
        }
        self.system.derivatives(&mut self.w.slopes[0]);
        M::leave(self.w);
        Ok(())
    }

    /// Makes the next internal step short if an indicator is close to zero.
    fn shorten_first_step(&mut self) {
        if self.restarts && !self.w.signs.is_empty() {
            let longest = self.step.longest.min(self.step.size);
            self.size = RESTART * (1e-12 * longest).max(self.resolution());
        }
    }

    fn keep_signs(&mut self) {
        for (indicator, sign) in self.w.signs.iter_mut().enumerate() {
            *sign = self.system.event_indicator(indicator) > 0.0;
        }
    }

    /// Whether an event indicator has another sign than at the start of the internal step.
    fn has_crossed(&mut self) -> bool {
        let mut signs = self.w.signs.iter().enumerate();
        signs.any(|(indicator, sign)| (self.system.event_indicator(indicator) > 0.0) != *sign)
    }

    /// Whether an event indicator is zero, which it may leave to either side.
    fn is_at_zero(&mut self) -> bool {
        (0..self.w.signs.len()).any(|indicator| self.system.event_indicator(indicator) == 0.0)
    }

    /// The next time event in the step: where to integrate to, and its absolute time. One at the end of
    /// the step belongs to it, though hosts compute its time with rounding errors.
    fn next_event(&self) -> Option<(f64, f64)> {
        if self.step.events != Events::Here {
            return None;
        }
        let event = self.system.next_event(self.handled).filter(|event| *event > self.handled)?;
        let (end, size) = (self.step.time + self.step.size, self.step.size);
        let tolerance = self.rounding();
        if event > end + tolerance {
            None
        } else if event >= end - tolerance {
            Some((size, event.max(end)))
        } else {
            Some(((event - self.step.time).max(self.reached), event))
        }
    }

    /// The rounding errors of the times of hosts.
    fn rounding(&self) -> f64 {
        1e-6 * self.step.size + 8.0 * f64::EPSILON * self.step.time.abs()
    }

    /// Integrates to `end`, or to an event that ends the step.
    fn integrate(&mut self, end: f64) -> Result<(), E> {
        let ends_early = self.step.events == Events::EndStep;
        while self.reached < end && !(ends_early && self.has_event) {
            self.take_internal_step(end)?;
        }
        Ok(())
    }

    /// Takes an internal step that ends at an event indicator's change of sign, or at `end` at the latest.
    fn take_internal_step(&mut self, end: f64) -> Result<(), E> {
        let remaining = end - self.reached;
        if self.size == 0.0 {
            self.size = M::estimate_size(self, remaining)?.max(self.resolution());
        }
        loop {
            self.steps += 1;
            if self.steps > MAX_STEPS {
                let reason =
                    format_args!("it takes more than {MAX_STEPS} internal steps to get further");
                return Err(match M::IS_IMPLICIT {
                    true => self.discard(reason),
                    false => self.stopped(E::too_many_steps(reason)),
                });
            }
            // The last step is a little longer, so that none remains that is very short.
            let is_last = 1.01 * self.longest() >= remaining;
            let (h, to) = match is_last {
                true => (remaining, end),
                false => (self.longest(), self.reached + self.longest()),
            };
            let mut trial = M::try_step(self, h, to)?;
            if let Trial::Error(error) = trial
                && error <= 1.0
            {
                let has_crossed = self.has_crossed();
                self.has_event |= has_crossed && self.step.events == Events::Wait;
                if !has_crossed || self.step.events == Events::Wait {
                    self.size = h * factor(error);
                    self.accept(to);
                    return match self.system.completed(self.now())? {
                        true => self.event(self.now(), EventCause::Step),
                        false => Ok(()),
                    };
                }
                match self.locate(h, to)? {
                    None => return Ok(()),
                    Some(failed) => trial = failed,
                }
            }
            self.size = h * match &trial {
                Trial::Error(error) if *error > 1.0 => factor(*error),
                _ => MAX_SHRINKAGE,
            };
            if self.size <= self.resolution() {
                return Err(self.stuck(trial));
            }
        }
    }

    /// The size of the next internal step, if the end is far away.
    fn longest(&self) -> f64 {
        match self.w.signs.len() {
            0 => self.size,
            _ => self.size.min(self.step.longest),
        }
    }

    /// Times that differ less are equal.
    fn resolution(&self) -> f64 {
        M::resolution(self)
    }

    /// Ends an internal step, at whose end the system is evaluated.
    fn accept(&mut self, to: f64) {
        self.reached = to;
        core::mem::swap(&mut self.w.states, &mut self.w.next);
        self.w.slopes.swap(0, 6);
        self.keep_signs();
        M::leave(self.w);
        (self.restarts, self.events) = (false, 0);
    }

    /// Locates the first change of an indicator's sign in an internal step, by bisection, and handles the
    /// event just after it. Returns what failed if the equations have no values at a point of the step.
    fn locate(&mut self, h: f64, to: f64) -> Result<Option<Trial<E>>, E> {
        let (mut before, mut after) = (0.0, 1.0);
        let resolution = (1e-12 * h).max(self.resolution());
        while (after - before) * h > resolution {
            let middle = 0.5 * (before + after);
            if let Some(failed) = self.evaluate_within(middle, h)? {
                return Ok(Some(failed));
            }
            if self.has_crossed() { after = middle } else { before = middle }
        }
        if let Some(failed) = self.evaluate_within(after, h)? {
            return Ok(Some(failed));
        }
        self.reached = if after == 1.0 { to } else { self.reached + after * h };
        self.system.completed(self.now())?;
        if self.step.events == Events::EndStep {
            (self.has_event, self.restarts) = (true, true);
            return Ok(None);
        }
        self.event(self.now(), EventCause::State)?;
        Ok(None)
    }

    /// Evaluates the equations at a fraction of an internal step.
    fn evaluate_within(&mut self, fraction: f64, h: f64) -> Result<Option<Trial<E>>, E> {
        M::interpolate(self.w, fraction, h);
        let time = self.now() + fraction * h;
        let evaluated = self.system.evaluate(time, &self.w.point);
        self.judge(evaluated)
    }

    /// Handles an event at an absolute time.
    fn event(&mut self, time: f64, cause: EventCause) -> Result<(), E> {
        self.count_event()?;
        let handled = self.system.event(time);
        handled
            .map_err(|error| error.with_prefix(format_args!("in the event at t = {time:?} s")))?;
        self.handled = self.handled.max(time);
        // The states before the event, and their derivatives, if the equations were evaluated there.
        core::mem::swap(&mut self.w.states, &mut self.w.point);
        self.w.slopes.swap(0, 1);
        self.evaluate_here()?;
        let has_crossed = self.has_crossed();
        self.keep_signs();
        let is_continued = matches!(cause, EventCause::Time | EventCause::Step) && !has_crossed;
        if is_continued && self.w.states == self.w.point && self.w.slopes[0] == self.w.slopes[1] {
            return Ok(()); // nothing has changed for the solver
        }
        self.size = 0.0;
        self.restarts = match cause {
            EventCause::State => true,
            EventCause::Step => has_crossed,
            EventCause::Inputs | EventCause::Time => has_crossed || self.is_at_zero(),
        };
        self.shorten_first_step();
        Ok(())
    }

    /// Counts an event, and discards the step if events follow each other without progress.
    fn count_event(&mut self) -> Result<(), E> {
        if self.events == 0 {
            self.counted_from = self.reached;
        }
        (self.steps, self.events) = (0, self.events + 1);
        if self.events > MAX_EVENTS {
            let progress = self.reached - self.counted_from;
            return Err(self.discard(format_args!(
                "there are more than {MAX_EVENTS} events within {progress:.1e} s"
            )));
        }
        Ok(())
    }

    #[cold]
    fn discard(&self, reason: core::fmt::Arguments<'_>) -> E {
        self.stopped(E::discard(reason))
    }

    /// The error of an internal step that cannot be made any shorter.
    #[cold]
    fn stuck(&mut self, trial: Trial<E>) -> E {
        match trial {
            Trial::Discarded(error) => self.stopped(error),
            Trial::Error(error) if error.is_finite() => self.discard(format_args!(
                "the internal steps became too short, the states change too fast"
            )),
            Trial::Error(_) => {
                let error = self.system.not_finite();
                self.stopped(error)
            }
        }
    }
}

/// What methods use of a step that is being taken.
impl<E: SolverError, M> IntegrationRun<'_, E, M> {
    /// The absolute time.
    fn now(&self) -> f64 {
        self.step.time + self.reached
    }

    /// What failed in an evaluation, if a shorter internal step may succeed.
    fn judge(&self, evaluated: Result<bool, E>) -> Result<Option<Trial<E>>, E> {
        match evaluated {
            Ok(true) => Ok(None),
            Ok(false) => Ok(Some(Trial::Error(f64::INFINITY))),
            Err(error) if error.is_discarded() => Ok(Some(Trial::Discarded(error))),
            Err(error) => Err(self.stopped(error)),
        }
    }

    /// The error of a state that is tolerated where its magnitude is `value`.
    fn scale(&self, state: usize, value: f64) -> f64 {
        self.step.tolerance.max(MIN_TOLERANCE) * (self.system.nominal(state) + value)
    }

    /// The root mean square of a number for each state.
    fn norm(&self, of: impl Fn(usize) -> f64) -> f64 {
        // A sum, not a maximum: `max` would hide a NaN.
        let sum: f64 = (0..self.w.states.len()).map(|i| of(i) * of(i)).sum();
        libm::sqrt(sum / self.w.states.len().max(1) as f64)
    }

    /// The error after which the integration cannot go on from the current time.
    #[cold]
    fn stopped(&self, error: E) -> E {
        error.with_prefix(format_args!("the integration stopped at t = {:?} s", self.now()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;
    use std::string::{String, ToString};

    #[derive(Debug)]
    struct Reason {
        text: String,
        is_discarded: bool,
    }

    impl SolverError for Reason {
        fn discard(reason: Arguments<'_>) -> Self {
            Self { text: reason.to_string(), is_discarded: true }
        }

        fn is_discarded(&self) -> bool {
            self.is_discarded
        }

        fn with_prefix(self, prefix: Arguments<'_>) -> Self {
            Self { text: format!("{prefix}: {}", self.text), ..self }
        }
    }

    type Indicators<const N: usize> = fn(&[f64; N]) -> Vec<f64>;
    type Product<const N: usize> = fn(&[f64; N], &[f64; N]) -> [f64; N];

    /// A system of `N` states, with what it was evaluated at last.
    struct Equations<const N: usize> {
        right: fn(f64, &[f64; N]) -> [f64; N],
        indicators: Indicators<N>,
        /// The next time event after a time.
        time_event: fn(f64) -> Option<f64>,
        /// What an event does with the states, and whether each internal step ends with one.
        jump: fn(&mut [f64; N]),
        ends_with_events: bool,
        states: [f64; N],
        slopes: [f64; N],
        /// The products with the Jacobian, if the system has them.
        product: Option<Product<N>>,
        evaluations: u32,
        events: Vec<f64>,
    }

    impl<const N: usize> OdeSystem for Equations<N> {
        type Error = Reason;

        fn nominal(&self, _state: usize) -> f64 {
            1.0
        }

        fn states(&mut self, states: &mut [f64]) -> Result<(), Reason> {
            states.copy_from_slice(&self.states);
            Ok(())
        }

        fn evaluate(&mut self, time: f64, states: &[f64]) -> Result<bool, Reason> {
            self.evaluations += 1;
            self.states.copy_from_slice(states);
            self.slopes = (self.right)(time, &self.states);
            Ok(self.slopes.iter().all(|slope| slope.is_finite()))
        }

        fn derivatives(&mut self, derivatives: &mut [f64]) {
            derivatives.copy_from_slice(&self.slopes);
        }

        fn directional_derivative(
            &mut self,
            direction: &[f64],
            product: &mut [f64],
        ) -> Result<bool, Reason> {
            let direction = direction.try_into().unwrap();
            let known = self.product.map(|multiply| multiply(&self.states, direction));
            known.iter().for_each(|known| product.copy_from_slice(known));
            Ok(known.is_some())
        }

        fn event_indicator(&mut self, indicator: usize) -> f64 {
            (self.indicators)(&self.states)[indicator]
        }

        fn not_finite(&mut self) -> Reason {
            Reason { text: "a slope became NaN".to_string(), is_discarded: false }
        }

        fn completed(&mut self, _time: f64) -> Result<bool, Reason> {
            Ok(self.ends_with_events)
        }

        fn event(&mut self, time: f64) -> Result<(), Reason> {
            self.events.push(time);
            (self.jump)(&mut self.states);
            Ok(())
        }

        fn next_event(&self, time: f64) -> Option<f64> {
            (self.time_event)(time)
        }
    }

    /// Equations without events.
    fn system<const N: usize>(
        right: fn(f64, &[f64; N]) -> [f64; N],
        states: [f64; N],
    ) -> Equations<N> {
        Equations {
            right,
            indicators: |_| Vec::new(),
            time_event: |_| None,
            jump: |_| {},
            ends_with_events: false,
            states,
            slopes: [0.0; N],
            product: None,
            evaluations: 0,
            events: Vec::new(),
        }
    }

    fn oscillator() -> Equations<2> {
        system(|_, [x, v]| [*v, -x], [1.0, 0.5])
    }

    const STEP: Step = Step {
        time: 0.0,
        size: 0.0,
        tolerance: 1e-6,
        longest: 0.1,
        events: Events::Here,
        handled: f64::NEG_INFINITY,
        event: None,
        restarts: false,
    };

    fn run<const N: usize>(
        system: &mut Equations<N>,
        size: f64,
        end: f64,
        tolerance: f64,
    ) -> Result<[f64; N], Reason> {
        run_by::<DormandPrince, N>(system, size, end, tolerance)
    }

    /// Takes steps of this size until `end`. Returns the states at the end.
    fn run_by<M: Method, const N: usize>(
        system: &mut Equations<N>,
        size: f64,
        end: f64,
        tolerance: f64,
    ) -> Result<[f64; N], Reason> {
        let indicators = (system.indicators)(&system.states).len();
        let mut workspace = Workspace::new(N, indicators);
        let mut step = Step { size, tolerance, ..STEP };
        while step.time < end - 1e-9 {
            let advanced = advance::<M, _>(system, &mut workspace, &step)?;
            (step.handled, step.restarts) = (advanced.handled, advanced.restarts);
            step.time += size; // with rounding errors that add up
        }
        Ok(system.states)
    }

    /// Takes a step that fails. Returns whether it is discarded, its message and the time that it names.
    fn fail<const N: usize>(mut system: Equations<N>, size: f64) -> (bool, String, f64) {
        let error = run(&mut system, size, size, 1e-6).unwrap_err();
        let text = error.text.clone();
        let time = text.split("t = ").nth(1).and_then(|rest| rest.split(' ').next());
        (error.is_discarded(), text.clone(), time.unwrap().parse().unwrap())
    }

    #[test]
    fn the_error_falls_with_the_tolerance_and_the_work_grows_as_its_fifth_root() {
        let errors = [1e-4, 1e-6, 1e-8, 1e-10].map(|tolerance| {
            let mut oscillator = Equations { states: [1.0, 0.0], ..oscillator() };
            let [x, v] = run(&mut oscillator, 20.0, 20.0, tolerance).unwrap();
            let error = (x - libm::cos(20.0)).abs() + (v + libm::sin(20.0)).abs();
            assert!(error < 50.0 * tolerance, "{error} for {tolerance}");
            (error, f64::from(oscillator.evaluations))
        });
        for pair in errors.windows(2) {
            let (gain, cost) = (pair[0].0 / pair[1].0, pair[1].1 / pair[0].1);
            assert!((30.0..300.0).contains(&gain), "{errors:?}");
            assert!((1.8..2.9).contains(&cost), "{errors:?}");
        }
        // A short step takes one internal step: at the start, at the probe, and at the stages.
        let mut oscillator = oscillator();
        run(&mut oscillator, 1e-3, 1e-3, 1e-6).unwrap();
        assert_eq!(oscillator.evaluations, 8);
    }

    #[test]
    fn the_dense_output_is_of_fourth_order() {
        fn order<M: Method>() -> f64 {
            let error = |h: f64| {
                let (mut oscillator, mut w) = (oscillator(), Workspace::new(2, 0));
                let step = Step { size: h, tolerance: 1.0, ..STEP };
                let mut run = IntegrationRun::<_, M>::new(&mut oscillator, &mut w, &step);
                run.begin().unwrap();
                M::try_step(&mut run, h, h).ok().unwrap();
                let [start, within, end] = [0.0, 0.3, 1.0].map(|fraction| {
                    M::interpolate(run.w, fraction, h);
                    let (sin, cos) = libm::sincos(fraction * h);
                    (run.w.point[0] - cos - 0.5 * sin).abs()
                });
                assert!(start == 0.0 && end < 1e-5 * h);
                within
            };
            libm::log2(error(0.2) / error(0.1))
        }
        for order in [order::<DormandPrince>(), order::<Rodas5p>()] {
            assert!((order - 5.0).abs() < 0.5, "local order {order}");
        }
    }

    #[test]
    fn the_implicit_method_is_of_fifth_order_also_where_time_is_explicit() {
        // x = 1 / (1 + sin t).
        let error = |steps: u32| {
            let mut swing = system(|t, [x]| [-x * x * libm::cos(t)], [1.0]);
            let (h, mut w) = (2.0 / f64::from(steps), Workspace::implicit(1, 0, None));
            for k in 0..steps {
                let step = Step { time: f64::from(k) * h, size: h, ..STEP };
                let mut run = IntegrationRun::<_, Rodas5p>::new(&mut swing, &mut w, &step);
                run.begin().unwrap();
                Rodas5p::try_step(&mut run, h, h).ok().unwrap();
            }
            (swing.states[0] - 1.0 / (1.0 + libm::sin(2.0))).abs()
        };
        let order = libm::log2(error(20) / error(40));
        assert!((order - 5.0).abs() < 0.5, "order {order}");
    }

    #[test]
    fn stiff_equations_take_many_internal_steps_or_are_discarded() {
        // x' = -rate (x - cos t).
        let mut stiff = system(|time, [x]| [-1e3 * (x - libm::cos(time))], [0.0]);
        let [x] = run(&mut stiff, 1.0, 2.0, 1e-6).unwrap();
        assert!((x - libm::cos(2.0 - 1e-3)).abs() < 1e-5);
        let stiffer = system(|time, [x]| [-1e9 * (x - libm::cos(time))], [0.0]);
        let (is_discarded, text, time) = fail(stiffer, 1.0);
        assert!(is_discarded);
        assert!(text.contains("more than 100000 internal steps"), "{text}");
        assert!((1e-5..1e-2).contains(&time), "{text}");
    }

    #[test]
    fn a_solution_that_ends_is_an_error_that_names_the_time() {
        // x = 1 / (1 - t) is infinite at 1 s.
        let (is_discarded, text, time) = fail(system(|_, [x]| [x * x], [1.0]), 3.0);
        assert!(is_discarded, "{text}");
        assert!((time - 1.0).abs() < 1e-4, "{text}");
        // x = (1 - t / 2)^2 ends at 2 s.
        let emptied = |x| system(|_, [x]| [-libm::sqrt(*x)], [x]);
        let [x] = run(&mut emptied(1.0), 1.9, 1.9, 1e-8).unwrap();
        assert!((x - 0.0025).abs() < 1e-8);
        let (is_discarded, text, time) = fail(emptied(1.0), 3.0);
        assert!(text.ends_with("a slope became NaN"), "{text}");
        assert!(!is_discarded);
        assert!((time - 2.0).abs() < 1e-2, "{text}");
        assert_eq!(fail(emptied(-1.0), 1.0).2, 0.0);
    }

    #[test]
    fn indicators_that_change_together_are_one_event_just_after_it() {
        for size in [0.01, 0.3, 3.0] {
            let mut phases = Equations {
                indicators: |[x]| vec![x - 2.0, x - 1.0, x - 1.0],
                ..system(|_, _| [1.0], [0.0])
            };
            run(&mut phases, size, 3.0, 1e-6).unwrap();
            let [first, second] = phases.events[..] else {
                panic!("{:?}", phases.events);
            };
            assert!(first > 1.0 - 1e-15 && first < 1.0 + 1e-12, "{first:e}");
            assert!(second > 2.0 - 1e-15 && second < 2.0 + 1e-12, "{second:e}");
        }
    }

    #[test]
    fn a_time_event_at_the_end_of_a_step_belongs_to_it_up_to_rounding() {
        let mut clock = Equations { time_event: |_| Some(1.0), ..system(|_, _| [1.0], [0.0]) };
        // Ten steps end at 0.9999999999999999 s.
        run(&mut clock, 0.1, 1.0, 1e-6).unwrap();
        assert_eq!(clock.events, [1.0]);
    }

    #[test]
    fn events_after_each_internal_step_do_not_shorten_the_steps() {
        // x' = -x, with an indicator that is zero or far from it; the second event projects the state.
        let jumps: [fn(&mut [f64; 1]); 2] = [|_| {}, |[x]| *x *= 1.0 + 1e-13];
        let indicators: [Indicators<1>; 3] = [|_| Vec::new(), |_| vec![0.0], |_| vec![1.0]];
        for (jump, indicators) in jumps.into_iter().flat_map(|j| indicators.map(|i| (j, i))) {
            let mut decay = Equations {
                indicators,
                jump,
                ends_with_events: true,
                ..system(|_, [x]| [-x], [1.0])
            };
            let [x] = run(&mut decay, 1.0, 1.0, 1e-6).unwrap();
            assert!((x - libm::exp(-1.0)).abs() < 1e-6, "{x}");
            assert!(decay.events.len() < 100, "{}", decay.events.len());
        }
    }

    #[test]
    fn a_step_may_have_many_events_but_not_without_end() {
        const PERIOD: f64 = 5e-5;
        let next = |time: f64| Some((libm::floor(time.max(0.0) / PERIOD + 1e-6) + 1.0) * PERIOD);
        let indicators: [Indicators<1>; 2] = [|_| Vec::new(), |[x]| vec![x + 1.0]];
        for indicators in indicators {
            let counter = system(|_, _| [1.0], [0.0]);
            let mut counter = Equations { time_event: next, indicators, ..counter };
            run(&mut counter, 1.0, 1.0, 1e-6).unwrap();
            assert_eq!(counter.events.len(), 20_000);
        }
        // The state slides along zero.
        let mut sliding = Equations {
            indicators: |[x, _]| vec![*x],
            jump: |[x, side]| *side = if *x > 0.0 { -1.0 } else { 1.0 },
            ..system(|_, [_, side]| [*side, 0.0], [-0.5, 1.0])
        };
        let error = run(&mut sliding, 1.0, 1.0, 1e-6).unwrap_err();
        assert!(error.is_discarded);
        assert!(error.text.contains("t = 0.5"), "{}", error.text);
        assert!(error.text.contains("more than 1000 events within"), "{}", error.text);
    }

    /// Robertson's reaction, whose slowest part takes 1e11 s.
    fn robertson() -> Equations<3> {
        let right = |_, [a, b, c]: &[f64; 3]| {
            let (slow, fast) = (0.04 * a - 1e4 * b * c, 3e7 * b * b);
            [-slow, slow - fast, fast]
        };
        system(right, [1.0, 0.0, 0.0])
    }

    /// Its Jacobian times a direction.
    fn robertson_product([_, b, c]: &[f64; 3], [da, db, dc]: &[f64; 3]) -> [f64; 3] {
        let (slow, fast) = (0.04 * da - 1e4 * (db * c + b * dc), 6e7 * b * db);
        [-slow, slow - fast, fast]
    }

    #[test]
    fn robertson_s_reaction_has_its_published_concentrations() {
        // To four digits at 40 s in the documentation of LSODE, and at 1e11 s in the Test Set for Initial Value Problem
        // Solvers (Mazzia and Magherini, 2008).
        let late = [0.2083340149701255e-7, 0.8333360770334713e-13, 0.999999979166505];
        let published = [(40.0, 1e-8, [7.158e-1, 9.186e-6, 2.842e-1]), (1e11, 1e-11, late)];
        for (end, tolerance, expected) in published {
            let differences = (end == 40.0).then_some(None);
            let product: Product<3> = robertson_product;
            for product in differences.into_iter().chain([Some(product)]) {
                // In one step, whose size says nothing of the reaction.
                let mut reaction = Equations { product, ..robertson() };
                let found = run_by::<Rodas5p, 3>(&mut reaction, end, end, tolerance).unwrap();
                for (found, expected) in found.iter().zip(expected) {
                    assert!((found - expected).abs() < 2e-4 * expected, "{found:e} at {end:e}");
                }
            }
        }
    }

    #[test]
    fn an_oscillator_with_relaxation_has_its_published_solution() {
        // Van der Pol's equation with mu = 1000 at 2000 s (Test Set for Initial Value Problem Solvers).
        let right = |_, [x, v]: &[f64; 2]| [*v, 1e3 * (1.0 - x * x) * v - x];
        let mut oscillator = system(right, [2.0, 0.0]);
        let [x, v] = run_by::<Rodas5p, 2>(&mut oscillator, 2000.0, 2000.0, 1e-9).unwrap();
        assert!((x - 1.706167732170469).abs() < 1e-6, "{x}");
        assert!((v + 0.8928097010248125e-3).abs() < 1e-8, "{v}");
    }

    #[test]
    fn stiff_equations_take_few_steps_of_the_implicit_method() {
        // x' = -rate (x - cos t) - sin t, whose solution is cos t.
        let right = |t, [x]: &[f64; 1]| [-1e9 * (x - libm::cos(t)) - libm::sin(t)];
        for start in [1.0, 0.0] {
            let mut stiff = system(right, [start]);
            let [x] = run_by::<Rodas5p, 1>(&mut stiff, 10.0, 10.0, 1e-6).unwrap();
            assert!((x - libm::cos(10.0)).abs() < 1e-5, "{x}");
            assert!(stiff.evaluations < 1000, "{}", stiff.evaluations);
        }
    }

    #[test]
    fn a_stiff_contact_is_located_by_the_dense_output() {
        // A mass falls from 1 m onto a spring of 1e8 N/m with the damping 1e6 N.s/m; the indicator is its height.
        let right = |_, [x, v]: &[f64; 2]| {
            let contact = if *x < 0.0 { -1e8 * x - 1e6 * v } else { 0.0 };
            [*v, contact - 9.81]
        };
        let mut mass = Equations { indicators: |[x, _]| vec![*x], ..system(right, [1.0, 0.0]) };
        let [x, _] = run_by::<Rodas5p, 2>(&mut mass, 2.0, 2.0, 1e-8).unwrap();
        let contact = libm::sqrt(2.0 / 9.81);
        assert!((mass.events[0] - contact).abs() < 1e-9, "{:?}", mass.events);
        assert!((x + 9.81e-8).abs() < 1e-9, "{x:e}");
    }

    #[test]
    fn events_with_time_between_them_have_no_limit() {
        // The state goes up and down by 1e-6 in 1e-6 s until there were 3000 events, in a step of 1000 s.
        let mut saw = Equations {
            indicators: |[x, _, _]| vec![*x, 1e-6 - x],
            jump: |[x, side, count]| {
                *side = if *x > 0.5e-6 { -1.0 } else { 1.0 };
                *count += 1.0;
                if *count >= 3000.0 {
                    (*x, *side) = (0.5e-6, 0.0);
                }
            },
            ..system(|_, [_, side, _]| [*side, 0.0, 0.0], [0.5e-6, 1.0, 0.0])
        };
        run(&mut saw, 1e3, 1e3, 1e-6).unwrap();
        assert_eq!(saw.events.len(), 3000);
        assert!(saw.events[2999] < 2e-3);
    }
}
