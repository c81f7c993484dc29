//! Model exchange: integrates the equations over a communication step by the solver of the master, with error control,
//! and handles the events of the FMU.

use std::fmt::Arguments;

use anyhow::{Error, Result};
use fmu_description::{Causality, Value, XmlVariable};
use fmu_host::{Cause, Failure, Instance, Status};
use ode_methods::solver::{self, Advanced, DormandPrince, Events, OdeSystem, Step, Workspace};

use crate::binary::run::{EVENT_EVERY, MAX_ROUNDS, Position, Run};
use crate::rules::is_continuous;

/// The largest relative tolerance of the solver.
const TOLERANCE: f64 = 1e-4;

/// Why an integration has stopped.
enum StepError {
    /// A call has failed.
    Call(Error),
    /// The equations cannot be integrated, though shorter steps may succeed if they are discarded.
    Equations { reason: String, is_discarded: bool },
    /// The FMU has ended the run.
    Ended,
}

impl From<Error> for StepError {
    fn from(error: Error) -> Self {
        Self::Call(error)
    }
}

impl From<Failure> for StepError {
    fn from(failure: Failure) -> Self {
        Self::Call(failure.into())
    }
}

impl solver::SolverError for StepError {
    fn discard(reason: Arguments<'_>) -> Self {
        Self::Equations { reason: reason.to_string(), is_discarded: true }
    }

    fn is_discarded(&self) -> bool {
        match self {
            Self::Call(error) => error
                .downcast_ref::<Failure>()
                .is_some_and(|failure| failure.cause == Cause::Returned(Status::Discard)),
            Self::Equations { is_discarded, .. } => *is_discarded,
            Self::Ended => false,
        }
    }

    fn with_prefix(self, prefix: Arguments<'_>) -> Self {
        match self {
            Self::Equations { reason, is_discarded } => {
                Self::Equations { reason: format!("{prefix}: {reason}"), is_discarded }
            }
            // The run tells where it is.
            other => other,
        }
    }
}

impl Run<'_> {
    /// Integrates over a communication step. Equations that cannot be integrated end the run.
    pub fn integrate(&mut self, begin: f64, step: f64) -> Result<()> {
        self.position.now = begin;
        if self.position.point % EVENT_EVERY == EVENT_EVERY - 1 {
            self.instance.enter_event_mode()?;
            self.set_inputs(|_| true)?;
            self.trigger(begin);
            self.iterate()?;
        } else {
            let before = signs(&self.event_indicators()?);
            self.set_inputs(|input| input.is_continuous())?;
            if signs(&self.event_indicators()?) != before {
                self.instance.enter_event_mode()?;
                self.iterate()?;
            }
        }
        let parts = self.setup.parts;
        for part in 0..parts {
            let size = step / parts as f64;
            if !self.ended {
                let tolerance = self.subject.model.experiment("tolerance").filter(|t| *t > 0.0);
                let tolerance = tolerance.unwrap_or(TOLERANCE).min(TOLERANCE);
                self.integrate_to_ticks(begin + part as f64 * size, size, tolerance)?;
            }
        }
        Ok(())
    }

    /// As [`Run::integrate_part`], with the events of the clocks that tick meanwhile.
    fn integrate_to_ticks(&mut self, time: f64, size: f64, tolerance: f64) -> Result<()> {
        let (end, mut begin, mut rest) = (time + size, time, size);
        for _ in 0..MAX_ROUNDS {
            let tick = self.tick_before(end);
            self.integrate_part(begin, tick.map_or(rest, |tick| tick - begin), tolerance)?;
            if !self.ended && !self.due().is_empty() {
                self.instance.enter_event_mode()?;
                self.iterate()?;
            }
            if self.ended || tick.is_none() {
                return Ok(());
            }
            (begin, rest) = (self.position.now, end - self.position.now);
        }
        self.end_as_ticks_are_too_many();
        Ok(())
    }

    /// Integrates from `time` with inputs that keep their values.
    pub fn integrate_part(&mut self, time: f64, size: f64, tolerance: f64) -> Result<()> {
        let (states, indicators) = (self.states(), self.subject.indicators);
        let workspace = self.solver.workspace.take();
        let mut workspace = workspace.unwrap_or_else(|| Workspace::new(states, indicators));
        // The events that inputs cause were handled when the inputs were set.
        self.solver.indicators = self.event_indicators()?;
        let Position { handled, restarts, .. } = self.position;
        let (longest, event, events) = (size, None, Events::Here);
        let step = Step { time, size, tolerance, longest, events, handled, event, restarts };
        let advanced =
            solver::advance::<DormandPrince, _>(&mut Equations(self), &mut workspace, &step);
        self.solver.workspace = Some(workspace);
        match advanced {
            Ok(Advanced { handled, restarts, .. }) => {
                let position = &mut self.position;
                (position.now, position.handled, position.restarts) =
                    (time + size, handled, restarts);
            }
            Err(StepError::Ended) => self.ended = true,
            Err(StepError::Call(error)) => return Err(error),
            Err(StepError::Equations { reason, .. }) => {
                (self.ended, self.stuck) = (true, Some(reason));
            }
        }
        Ok(())
    }
}

impl Run<'_> {
    /// Sets an input or a tunable parameter between two steps, and handles the event that this is. A continuous input is
    /// set in continuous-time mode, where it causes an event only if an indicator changes its sign, which need not be
    /// noticed. Returns whether it does.
    pub fn jump(
        &mut self,
        variable: &XmlVariable<'_>,
        values: &[Value],
        notices: bool,
    ) -> Result<bool> {
        if variable.causality == Causality::Input
            && variable.of_type.is_float()
            && is_continuous(variable)
        {
            let before = signs(&self.event_indicators()?);
            self.set(variable, values)?;
            let is_event = signs(&self.event_indicators()?) != before;
            if is_event && notices {
                self.instance.enter_event_mode()?;
                self.iterate()?;
            }
            return Ok(is_event);
        }
        self.instance.enter_event_mode()?;
        self.set(variable, values)?;
        self.iterate()?;
        Ok(true)
    }
}

fn signs(indicators: &[f64]) -> Vec<bool> {
    indicators.iter().map(|indicator| *indicator > 0.0).collect()
}

/// The equations of the FMU, as the solver sees them.
struct Equations<'a, 'b>(&'a mut Run<'b>);

impl OdeSystem for Equations<'_, '_> {
    type Error = StepError;

    fn nominal(&self, state: usize) -> f64 {
        self.0.solver.nominals.get(state).map_or(1.0, |nominal| nominal.abs())
    }

    fn states(&mut self, states: &mut [f64]) -> Result<(), StepError> {
        states.copy_from_slice(&self.0.continuous_states()?);
        Ok(())
    }

    fn evaluate(&mut self, time: f64, states: &[f64]) -> Result<bool, StepError> {
        let run = &mut *self.0;
        // The time of an event differs by rounding from that of the step in which it is.
        run.instance.set_time(time.max(run.position.handled))?;
        if !states.is_empty() {
            run.instance.set_continuous_states(states)?;
        }
        run.solver.derivatives = run.derivatives()?;
        run.solver.indicators = run.event_indicators()?;
        let values = run.solver.derivatives.iter().chain(&run.solver.indicators);
        Ok(values.copied().all(f64::is_finite))
    }

    fn derivatives(&mut self, derivatives: &mut [f64]) {
        derivatives.copy_from_slice(&self.0.solver.derivatives);
    }

    fn event_indicator(&mut self, indicator: usize) -> f64 {
        self.0.solver.indicators[indicator]
    }

    fn not_finite(&mut self) -> StepError {
        let reason = "a derivative or an event indicator became NaN or infinite".to_owned();
        StepError::Equations { reason, is_discarded: false }
    }

    fn completed(&mut self, time: f64) -> Result<bool, StepError> {
        let completed = self.0.instance.completed_integrator_step()?;
        self.0.check_written("fmi2CompletedIntegratorStep", completed.is_written);
        self.0.position.now = time;
        match completed.terminate {
            true => Err(StepError::Ended),
            false => Ok(completed.enter_event_mode),
        }
    }

    fn event(&mut self, time: f64) -> Result<(), StepError> {
        let run = &mut *self.0;
        if time > run.position.handled {
            run.instance.set_time(time)?;
        }
        run.position.now = time;
        run.instance.enter_event_mode()?;
        run.iterate()?;
        if run.ended { Err(StepError::Ended) } else { Ok(()) }
    }

    fn next_event(&self, time: f64) -> Option<f64> {
        self.0.position.next_event.filter(|next| *next > time)
    }
}

impl Run<'_> {
    /// Reads the nominal values of the states.
    pub fn read_nominals(&mut self) -> Result<()> {
        let n = self.states();
        if n > 0 {
            let read = Instance::get_nominals_of_continuous_states;
            self.solver.nominals = self.instance.read(n, read)?;
        }
        Ok(())
    }
}
