//! Runs of an FMU, for the tests.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::Listed;
use fmu_file::text::quote;
use fmu_host::{Cause, Failure, Instance, Kind, Status};

use super::inputs::{Input, other};
use super::rules::EVENTS;
use super::subject::{Setup, Subject};
use super::values::{Row, Trajectory, Value, get, set};

/// Maximum number of calls of `fmi2NewDiscreteStates` in one event iteration.
const MAX_ROUNDS: usize = 1000;
/// In model exchange, every how many steps there is an event.
const EVENT_EVERY: usize = 10;

/// A running simulation.
pub struct Run<'a> {
    subject: &'a Subject<'a>,
    /// What differs from other runs.
    pub setup: Setup<'a>,
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
    /// Instantiates.
    pub fn instantiate(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
        Ok(Self {
            subject,
            setup,
            instance: subject.instantiate(&setup)?,
            place: Place {
                point: 0,
                now: subject.start(),
                next_event: None,
            },
            ended: false,
            has_unwritten: false,
        })
    }

    /// Instantiates and enters initialization mode.
    pub fn initializing(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
        let mut run = Self::instantiate(subject, setup)?;
        run.enter_initialization()?;
        Ok(run)
    }

    /// Instantiates and initializes.
    pub fn begin(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
        let mut run = Self::instantiate(subject, setup)?;
        run.initialize()?;
        Ok(run)
    }

    /// A usual run after some steps, fewer if the FMU is slow.
    pub fn after(subject: &'a Subject<'a>, steps: usize) -> Result<Self> {
        let mut run = Self::begin(subject, subject.setup())?;
        run.advance_by(subject.task.steps.min(steps))?;
        Ok(run)
    }

    /// The rows of a short run.
    pub fn recorded(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Trajectory> {
        Self::begin(subject, setup)?.record()
    }

    /// Resets the instance, which then needs to be initialized with the usual setup.
    pub fn reset(mut self) -> Result<Self> {
        self.instance.reset()?;
        self.setup = self.subject.setup();
        Ok(self)
    }

    /// Simulation time.
    pub fn time(&self) -> f64 {
        let (start, step) = (self.subject.start(), self.subject.step());
        match self.setup.summed_times {
            true => (0..self.place.point).fold(start, |time, _| time + step),
            false => start + self.place.point as f64 * step,
        }
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
            let parameters = self.subject.settable().filter(|v| v.is_parameter());
            for variable in parameters.filter(|v| v.of_type.is_float()) {
                if let Some(value) = other(variable) {
                    self.set(variable, &[value])?;
                }
            }
        }
        let tolerance = self.subject.model.experiment("tolerance");
        let (start, stop) = (self.subject.start(), self.setup.stop);
        self.instance.setup_experiment(start, stop, tolerance)?;
        self.instance.enter_initialization_mode()?;
        Ok(())
    }

    /// Initializes an instance that is new or was reset.
    pub fn initialize(&mut self) -> Result<()> {
        self.enter_initialization()?;
        self.set_inputs(|_| true)?;
        self.instance.exit_initialization_mode()?;
        let is_exchange = self.subject.kind == Kind::ModelExchange;
        if is_exchange || self.setup.event_mode {
            self.iterate()?;
        }
        let n = self.states();
        if n > 0 && !self.ended {
            let nominals = (self.instance).read(n, Instance::get_nominals_of_continuous_states)?;
            ensure!(
                nominals.iter().all(|n| n.is_finite() && *n != 0.0),
                "fmi2GetNominalsOfContinuousStates gave {nominals:?}, expected finite numbers other than 0"
            );
        }
        Ok(())
    }

    /// Reads the elements of a variable.
    pub fn read(&mut self, variable: &Listed<'_>) -> Result<Vec<Value>> {
        self.read_elements(variable, variable.count())
    }

    /// Reads this number of elements of a variable.
    pub fn read_elements(&mut self, variable: &Listed<'_>, n: usize) -> Result<Vec<Value>> {
        let of_type = (variable.of_type, self.subject.model.version);
        get(&mut self.instance, of_type, &[variable.reference], n)
            .with_context(|| format!("{} cannot be read", quote(&variable.name)))
    }

    /// Reads a scalar.
    pub fn value(&mut self, variable: &Listed<'_>) -> Result<Value> {
        self.read(variable)?.pop().context("it has no elements")
    }

    /// Sets the elements of a variable.
    pub fn set(&mut self, variable: &Listed<'_>, values: &[Value]) -> fmu_host::Result {
        let of_type = (variable.of_type, self.subject.model.version);
        set(&mut self.instance, of_type, variable.reference, values)
    }

    /// Reads Float64 scalars.
    pub fn reals(&mut self, references: &[u32]) -> fmu_host::Result<Vec<f64>> {
        let get = |i: &mut Instance, values: &mut [f64]| i.get_float64(references, values);
        self.instance.read(references.len(), get)
    }

    /// Number of continuous states that the host sees.
    fn states(&self) -> usize {
        match self.subject.kind {
            Kind::ModelExchange => self.subject.states(),
            Kind::CoSimulation => 0,
        }
    }

    /// The continuous states.
    pub fn continuous_states(&mut self) -> fmu_host::Result<Vec<f64>> {
        let n = self.states();
        self.instance.read(n, Instance::get_continuous_states)
    }

    /// The derivatives of the continuous states.
    pub fn derivatives(&mut self) -> fmu_host::Result<Vec<f64>> {
        let n = self.states();
        self.instance
            .read(n, Instance::get_continuous_state_derivatives)
    }

    fn set_inputs(&mut self, which: impl Fn(&Input<'_>) -> bool) -> Result<()> {
        let Setup { level, seed, .. } = self.setup;
        for input in self.subject.inputs.iter().filter(|input| which(input)) {
            if let Some(value) = input.value(level, seed, self.place.point) {
                self.set(input.variable, &[value])?;
            }
        }
        Ok(())
    }

    /// Iterates in event mode until no new discrete states are needed.
    fn iterate(&mut self) -> Result<()> {
        let (has_states, time) = (self.states() > 0, self.place.now);
        let states = |run: &mut Self| match has_states {
            true => run.continuous_states(),
            false => Ok(Vec::new()),
        };
        let before = states(self)?;
        let mut may_change = false;
        for _ in 0..MAX_ROUNDS {
            let update = self.instance.update_discrete_states()?;
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
            if !may_change {
                let after = states(self)?;
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
                for fraction in self.setup.fractions {
                    self.step(begin + passed * step, fraction * step)?;
                    passed += fraction;
                }
            }
            Kind::ModelExchange => self.integrate(begin, step)?,
        }
        self.place.point += 1;
        Ok(())
    }

    /// Advances by this number of steps.
    pub fn advance_by(&mut self, steps: usize) -> Result<()> {
        (0..steps).try_for_each(|_| self.advance())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<()> {
        if self.ended {
            return Ok(());
        }
        let at = || format!("the step from t = {time} s");
        if self.setup.event_mode {
            return self.step_with_events(time, step).with_context(at);
        }
        match self.instance.do_step(time, step) {
            Ok(_) => Ok(()),
            // By fmi2Discard, an FMU may also tell that it has reached the end of its simulation.
            Err(failure)
                if failure.cause == Cause::Terminated
                    || failure.cause == Cause::Returned(Status::Discard)
                        && self.instance.is_terminated() == Ok(true) =>
            {
                self.ended = true;
                Ok(())
            }
            Err(failure) => Err(failure).with_context(at),
        }
    }

    /// Takes a step and handles the event at its end, if the FMU needs that.
    fn step_with_events(&mut self, time: f64, step: f64) -> Result<()> {
        let (_, stepped) = self.instance.step(time, step, true)?;
        if stepped.terminate {
            self.ended = true;
            return Ok(());
        }
        self.place.now = stepped.last_successful_time;
        ensure!(
            !stepped.early_return,
            "it has ended early, at {} s, though that is not allowed",
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
                self.euler(end)?;
            }
        }
        Ok(())
    }

    /// Integrates to each time event up to the end of a part of a step, and handles it.
    fn handle_time_events(&mut self, end: f64, part: f64) -> Result<()> {
        for _ in 0..MAX_ROUNDS {
            let event = self.place.next_event;
            let Some(event) = event.filter(|event| *event <= end + 1e-9 * part) else {
                return Ok(());
            };
            if self.ended {
                return Ok(());
            }
            self.euler(event)?;
            if !self.ended {
                self.instance.enter_event_mode()?;
                self.iterate()?;
            }
        }
        bail!("there are more than {MAX_ROUNDS} time events up to t = {end} s")
    }

    /// Takes an Euler step from the last one to this time.
    fn euler(&mut self, end: f64) -> Result<()> {
        let step = end - self.place.now;
        self.place.now = end;
        if self.states() > 0 {
            let mut states = self.continuous_states()?;
            for (state, derivative) in states.iter_mut().zip(self.derivatives()?) {
                *state += step * derivative;
            }
            self.instance.set_time(end)?;
            // Stiff models need another method than ours.
            if states.iter().any(|x| x.is_nan() || x.abs() > 1e100) {
                self.ended = true;
                return Ok(());
            }
            self.instance.set_continuous_states(&states)?;
        } else {
            self.instance.set_time(end)?;
        }
        self.event_indicators()?;
        let completed = self.instance.completed_integrator_step()?;
        self.check_written("fmi2CompletedIntegratorStep", completed.is_written);
        if completed.enter_event_mode {
            self.instance.enter_event_mode()?;
            self.iterate()?;
        }
        Ok(())
    }

    /// The event indicators, if there are any.
    pub fn event_indicators(&mut self) -> Result<Vec<f64>> {
        let n = self.subject.indicators();
        ensure!(
            n <= 1 << 20,
            "numberOfEventIndicators is {n}, which is more than can be tested"
        );
        Ok(match n {
            0 => Vec::new(),
            _ => self.instance.read(n, Instance::get_event_indicators)?,
        })
    }

    /// The values of the observed variables.
    pub fn observe(&mut self) -> Result<Row> {
        self.subject.observed.read(&mut self.instance)
    }

    /// Takes the steps of a short run and records the values at each communication point.
    pub fn record(&mut self) -> Result<Trajectory> {
        self.record_by(Self::advance)
    }

    /// Like [`Run::record`]; `advance` takes each step.
    pub fn record_by(
        &mut self,
        mut advance: impl FnMut(&mut Self) -> Result<()>,
    ) -> Result<Trajectory> {
        let steps = self.subject.task.steps;
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

    /// Takes steps to the end of the default experiment, or until a time limit; `observe` receives the time
    /// and the values at each communication point. Returns how many steps were taken.
    pub fn run_for(
        &mut self,
        limit: Duration,
        mut observe: impl FnMut(f64, &Row),
    ) -> Result<usize> {
        let begin = Instant::now();
        let steps = self.subject.all_steps();
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

/// Whether an error is a refusal of the FMU: it returned fmi2Error, fmi2Discard or fmi2Fatal.
pub fn is_refusal(error: &anyhow::Error) -> bool {
    use Status::{Discard, Error, Fatal};
    error
        .downcast_ref::<Failure>()
        .is_some_and(|failure| matches!(failure.cause, Cause::Returned(Error | Discard | Fatal)))
}
