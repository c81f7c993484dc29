//! Runs of an FMU, for the tests.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use fmu_host::{Cause, Failure, Instance, Kind, Status};

use super::excitation::{Input, change_parameters};
use super::record::{Row, Trajectory};
use super::rules::EVENTS;
use super::subject::{Setup, Subject};

/// Maximum number of calls of `fmi2NewDiscreteStates` in one event iteration.
const MAX_ROUNDS: usize = 1000;
/// In model exchange, every how many steps there is an event.
const EVENT_EVERY: usize = 10;

/// A running simulation.
pub struct Run<'a> {
    subject: &'a Subject<'a>,
    setup: Setup<'a>,
    /// The instance.
    pub instance: Instance,
    /// How far it has got.
    pub place: Place,
    /// Whether the FMU has ended the simulation.
    pub ended: bool,
    /// Whether unwritten results were reported.
    has_unwritten: bool,
}

/// A point of a simulation, to which a restored state goes back.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Number of communication points passed.
    point: usize,
    /// In model exchange, the time of the last step of the integration; with event mode, of the last
    /// step.
    now: f64,
    /// In model exchange, the time of the next time event.
    next_event: Option<f64>,
}

impl<'a> Run<'a> {
    /// Instantiates and initializes.
    pub fn begin(subject: &'a Subject<'a>, setup: &Setup<'a>) -> Result<Self> {
        let mut run = Self::instantiate(subject, setup)?;
        run.initialize()?;
        Ok(run)
    }

    /// A usual run after some steps, fewer if the FMU is slow.
    pub fn after(subject: &'a Subject<'a>, steps: usize) -> Result<Self> {
        let mut run = Self::begin(subject, &subject.setup())?;
        for _ in 0..subject.steps.min(steps) {
            run.advance()?;
        }
        Ok(run)
    }

    /// The rows of a short run.
    pub fn recorded(subject: &'a Subject<'a>, setup: &Setup<'a>) -> Result<Trajectory> {
        Self::begin(subject, setup)?.record(subject.steps)
    }

    /// Instantiates.
    pub fn instantiate(subject: &'a Subject<'a>, setup: &Setup<'a>) -> Result<Self> {
        Ok(Self {
            subject,
            setup: *setup,
            instance: subject.instantiate(setup)?,
            place: Place {
                point: 0,
                now: subject.start(),
                next_event: None,
            },
            ended: false,
            has_unwritten: false,
        })
    }

    /// Resets the instance, which then needs to be initialized.
    pub fn reset(mut self, setup: Setup<'a>) -> Result<Self> {
        self.instance.reset()?;
        Ok(self.continuing(setup))
    }

    /// The same run with another setup from now on.
    pub fn continuing(mut self, setup: Setup<'a>) -> Self {
        self.setup = setup;
        self
    }

    /// Simulation time.
    pub fn time(&self) -> f64 {
        if self.setup.summed_times {
            return (0..self.place.point)
                .fold(self.subject.start(), |time, _| time + self.subject.step());
        }
        self.subject.start() + self.place.point as f64 * self.subject.step()
    }

    /// Puts an instance that is new or was reset into initialization mode.
    pub fn enter_initialization(&mut self) -> Result<()> {
        self.place = Place {
            point: 0,
            now: self.subject.start(),
            next_event: None,
        };
        self.ended = false;
        if self.setup.parameters {
            change_parameters(self.subject.model, &mut self.instance)?;
        }
        self.instance.setup_experiment(
            self.subject.start(),
            self.setup.stop,
            self.subject.model.experiment("tolerance"),
        )?;
        self.instance.enter_initialization_mode()?;
        Ok(())
    }

    /// Initializes an instance that is new or was reset.
    pub fn initialize(&mut self) -> Result<()> {
        self.enter_initialization()?;
        self.set_inputs(|_| true)?;
        self.instance.exit_initialization_mode()?;
        if self.setup.event_mode {
            self.iterate()?;
        } else if self.subject.kind == Kind::ModelExchange {
            self.iterate()?;
            if !self.ended && self.subject.states() > 0 {
                let nominals = self.instance.nominals(self.subject.states())?;
                ensure!(
                    nominals
                        .iter()
                        .all(|nominal| nominal.is_finite() && *nominal != 0.0),
                    "fmi2GetNominalsOfContinuousStates gave {nominals:?}, expected finite numbers other than 0"
                );
            }
        }
        Ok(())
    }

    fn set_inputs(&mut self, which: impl Fn(&Input<'_>) -> bool) -> Result<()> {
        for input in self.subject.inputs.iter().filter(|input| which(input)) {
            let Setup { level, seed, .. } = self.setup;
            input.set(&mut self.instance, level, seed, self.place.point)?;
        }
        Ok(())
    }

    /// Iterates in event mode until no new discrete states are needed.
    fn iterate(&mut self) -> Result<()> {
        let (mut n, time) = (self.subject.states(), self.place.now);
        if self.setup.event_mode {
            n = 0; // co-simulation has no functions for states
        }
        let before = if n > 0 {
            self.instance.continuous_states(n)?
        } else {
            vec![]
        };
        let mut may_change = false;
        for _ in 0..MAX_ROUNDS {
            let update = self.instance.new_discrete_states()?;
            may_change |= update.states_changed;
            self.check_written("fmi2NewDiscreteStates", update.is_written);
            if update.terminate {
                self.ended = true;
                return Ok(());
            }
            if update.again {
                continue;
            }
            if let Some(next) = update.next_event {
                ensure!(
                    next > time,
                    "fmi2NewDiscreteStates gave {next} s for nextEventTime at t = {time} s, expected a later time"
                );
            }
            if n > 0 && !may_change {
                let after = self.instance.continuous_states(n)?;
                ensure!(
                    after == before,
                    "an event has changed the states from {before:?} to {after:?}, but valuesOfContinuousStatesChanged is false"
                );
            }
            self.place.next_event = update.next_event;
            match self.setup.event_mode {
                true => self.instance.enter_step_mode()?,
                false => self.instance.enter_continuous_time_mode()?,
            };
            return Ok(());
        }
        bail!(
            "fmi2NewDiscreteStates still needs new discrete states after {MAX_ROUNDS} calls, expected the event iteration to end"
        )
    }

    fn check_written(&mut self, function: &str, is_written: bool) {
        if !is_written && !self.has_unwritten {
            self.has_unwritten = true;
            let text =
                format!("{function} did not write all of its results, expected it to write all");
            self.subject.report.find(&EVENTS, text);
        }
    }

    /// Advances to the next communication point.
    pub fn advance(&mut self) -> Result<()> {
        self.advance_in(&[1.0])
    }

    /// Advances to the next communication point in steps of these fractions of the step size, with
    /// the same inputs.
    pub fn advance_in(&mut self, fractions: &[f64]) -> Result<()> {
        if self.ended {
            return Ok(());
        }
        let (begin, step) = (self.time(), self.subject.step());
        self.subject.report.time(begin);
        match self.subject.kind {
            Kind::CoSimulation => {
                // With event mode, discrete inputs are set at events only.
                let event_mode = self.setup.event_mode;
                self.set_inputs(|input| !event_mode || input.is_continuous())?;
                let mut passed = 0.0;
                for fraction in fractions {
                    self.step(begin + passed * step, fraction * step)?;
                    passed += fraction;
                }
            }
            Kind::ModelExchange => self.integrate(begin, step)?,
        }
        self.place.point += 1;
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<()> {
        if self.ended {
            return Ok(());
        }
        if self.setup.event_mode {
            return self.step_with_events(time, step);
        }
        match self.instance.do_step(time, step) {
            Ok(_) => Ok(()),
            // By fmi2Discard, an FMU may also tell that it has reached the end of its simulation.
            Err(failure)
                if failure.cause == Cause::Terminated
                    || is_discard(&failure) && self.instance.is_terminated() == Ok(true) =>
            {
                self.ended = true;
                Ok(())
            }
            Err(failure) => Err(failure).with_context(|| format!("the step from t = {time} s")),
        }
    }

    /// Takes a step and handles the event at its end, if the FMU needs that.
    fn step_with_events(&mut self, time: f64, step: f64) -> Result<()> {
        let stepped = self.instance.step(time, step, true);
        let (_, stepped) = stepped.with_context(|| format!("the step from t = {time} s"))?;
        if stepped.terminate {
            self.ended = true;
            return Ok(());
        }
        self.place.now = stepped.last_successful_time;
        ensure!(
            !stepped.early_return,
            "the step from t = {time} s has ended early, at {} s, though that is not allowed",
            self.place.now
        );
        if stepped.event_handling_needed {
            self.instance.enter_event_mode()?;
            self.iterate()?;
        }
        Ok(())
    }

    /// Integrates by explicit Euler steps.
    fn integrate(&mut self, begin: f64, step: f64) -> Result<()> {
        if self.place.point % EVENT_EVERY == EVENT_EVERY - 1 {
            self.instance.enter_event_mode()?;
            self.set_inputs(|_| true)?;
            self.iterate()?;
        } else {
            self.set_inputs(|input| input.is_continuous())?;
        }
        self.place.now = begin;
        let parts = self.setup.parts;
        let part = step / parts as f64;
        for k in 1..=parts {
            let end = begin + k as f64 * part;
            self.handle_time_events(end, part)?;
            if self.ended {
                break;
            }
            // An event at the end may be a little later, by rounding.
            if end - self.place.now > 1e-9 * part {
                self.euler(end, end - self.place.now)?;
            }
        }
        Ok(())
    }

    /// Integrates to each time event up to the end of a part of a step, and handles it.
    fn handle_time_events(&mut self, end: f64, part: f64) -> Result<()> {
        for _ in 0..MAX_ROUNDS {
            let Some(event) = self.place.next_event else {
                return Ok(());
            };
            if self.ended || event > end + 1e-9 * part {
                return Ok(());
            }
            self.euler(event, event - self.place.now)?;
            if !self.ended {
                self.instance.enter_event_mode()?;
                self.iterate()?;
            }
        }
        bail!("there are more than {MAX_ROUNDS} time events up to t = {end} s")
    }

    fn euler(&mut self, end: f64, step: f64) -> Result<()> {
        self.place.now = end;
        let n = self.subject.states();
        if n > 0 {
            let mut states = self.instance.continuous_states(n)?;
            let derivatives = self.instance.derivatives(n)?;
            for (state, derivative) in states.iter_mut().zip(derivatives) {
                *state += step * derivative;
            }
            self.instance.set_time(end)?;
            // Stiff models need another method than ours.
            if states
                .iter()
                .any(|state| state.is_nan() || state.abs() > 1e100)
            {
                self.ended = true;
                return Ok(());
            }
            self.instance.set_continuous_states(&states)?;
        } else {
            self.instance.set_time(end)?;
        }
        let indicators = self.subject.indicators();
        ensure!(
            indicators <= 1 << 20,
            "numberOfEventIndicators is {indicators}, which is more than can be tested"
        );
        if indicators > 0 {
            self.instance.event_indicators(indicators)?;
        }
        let completed = self.instance.completed_integrator_step()?;
        self.check_written("fmi2CompletedIntegratorStep", completed.is_written);
        if completed.enter_event_mode {
            self.instance.enter_event_mode()?;
            self.iterate()?;
        }
        Ok(())
    }

    /// The values of the observed variables.
    pub fn observe(&mut self) -> Result<Row> {
        self.subject.observed.read(&mut self.instance)
    }

    /// Takes this many steps and records the values at each communication point.
    pub fn record(&mut self, steps: usize) -> Result<Trajectory> {
        self.record_in(steps, &[1.0])
    }

    /// Like [`Run::record`], with each step in parts.
    pub fn record_in(&mut self, steps: usize, fractions: &[f64]) -> Result<Trajectory> {
        self.record_by(steps, |run| run.advance_in(fractions))
    }

    /// Like [`Run::record`]; `advance` takes each step.
    pub fn record_by(
        &mut self,
        steps: usize,
        mut advance: impl FnMut(&mut Self) -> Result<()>,
    ) -> Result<Trajectory> {
        let stride = self.subject.observed.stride(steps);
        let mut rows = vec![(self.time(), self.observe()?)];
        for k in 1..=steps {
            advance(self)?;
            if self.ended {
                break;
            }
            if k % stride == 0 || k == steps {
                rows.push((self.time(), self.observe()?));
            }
        }
        Ok(rows)
    }

    /// Takes steps until the end or a time limit; `observe` receives the time and the values at each
    /// communication point. Returns how many steps were taken.
    pub fn run_for(
        &mut self,
        steps: usize,
        limit: Duration,
        mut observe: impl FnMut(f64, &Row),
    ) -> Result<usize> {
        let begin = Instant::now();
        observe(self.time(), &self.observe()?);
        for k in 0..steps {
            if begin.elapsed() > limit {
                return Ok(k);
            }
            self.advance()?;
            if self.ended {
                return Ok(k);
            }
            observe(self.time(), &self.observe()?);
        }
        Ok(steps)
    }
}

fn is_discard(failure: &Failure) -> bool {
    failure.cause == Cause::Returned(Status::Discard)
}
