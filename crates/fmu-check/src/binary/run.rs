//! Runs of the FMU under test, in the worker process.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Value, XmlVariable};
use fmu_file::text::quote;
use fmu_host::{Cause, Failure, Instance, InterfaceType, Status};
use ode_methods::solver::Workspace;

use crate::binary::clock_updates::ClockUpdates;
use crate::binary::excitation::{Input, other_values, starts};
use crate::binary::observed::{Observed, Row, Trajectory, get, is_discrete};
use crate::binary::schedule::Schedule;
use crate::binary::subject::{RunSetup, SKIP, Subject};
use crate::rule::{Rule, rule};

/// Maximum number of calls of `fmi2NewDiscreteStates` in one event iteration.
pub const MAX_ROUNDS: usize = 1000;
/// In model exchange, every how many steps there is an event.
pub const EVENT_EVERY: usize = 10;

/// The memory of the solver, apart from the state of the run.
#[derive(Default)]
pub struct Solver {
    pub workspace: Option<Workspace>,
    pub derivatives: Vec<f64>,
    pub indicators: Vec<f64>,
    pub nominals: Vec<f64>,
    /// Whether an event has changed them.
    pub has_new_nominals: bool,
}

pub struct Run<'a> {
    pub(crate) subject: &'a Subject<'a>,
    /// How the run differs from the usual run.
    pub setup: RunSetup<'a>,
    pub instance: Instance,
    pub position: Position,
    pub is_initialized: bool,
    /// Whether the FMU has ended the run, or the default experiment or the equations do not go on.
    pub ended: bool,
    /// Why the equations could not be integrated.
    pub stuck: Option<String>,
    pub solver: Solver,
    /// In scheduled execution, what the FMU tells while it updates its clocks.
    pub updates: Option<Arc<ClockUpdates>>,
    /// The rules with findings that steps have reported.
    reported: HashSet<&'static str>,
}

/// A point of a simulation, to which a restored state goes back.
#[derive(Debug, Clone, Default)]
pub struct Position {
    /// Number of communication points passed.
    pub point: usize,
    /// In model exchange, the time of the last step of the integration; with event mode, of the last
    /// step.
    pub now: f64,
    /// In model exchange, the time of the next time event, and the time until which events are handled.
    pub next_event: Option<f64>,
    pub handled: f64,
    /// Whether the last event has left an event indicator close to zero, and nothing was integrated since.
    pub restarts: bool,
    /// When its clocks tick.
    pub schedule: Schedule,
}

impl<'a> Run<'a> {
    pub fn instantiate(subject: &'a Subject<'a>, setup: RunSetup<'a>) -> Result<Self> {
        let mut instance = subject.instantiate(&setup)?;
        let clocks = &subject.clocks;
        let updates = (subject.interface_type == InterfaceType::ScheduledExecution)
            .then(|| ClockUpdates::of(&mut instance, &clocks.inputs, &clocks.outputs));
        Ok(Self {
            subject,
            setup,
            instance,
            updates,
            position: Position::default(),
            is_initialized: false,
            ended: false,
            stuck: None,
            solver: Solver::default(),
            reported: HashSet::new(),
        })
    }

    pub fn initializing(subject: &'a Subject<'a>, setup: RunSetup<'a>) -> Result<Self> {
        let mut run = Self::instantiate(subject, setup)?;
        run.enter_initialization()?;
        Ok(run)
    }

    pub fn begin(subject: &'a Subject<'a>, setup: RunSetup<'a>) -> Result<Self> {
        let mut run = Self::instantiate(subject, setup)?;
        run.initialize()?;
        Ok(run)
    }

    /// A run after its first step; the test ends if the FMU ends the run in it.
    pub fn stepped(subject: &'a Subject<'a>, setup: RunSetup<'a>) -> Result<Self> {
        let mut run = Self::begin(subject, setup)?;
        run.advance()?;
        ensure!(!run.ended, SKIP);
        Ok(run)
    }

    /// A run that was terminated after its first step.
    pub fn terminated(subject: &'a Subject<'a>, setup: RunSetup<'a>) -> Result<Self> {
        let mut run = Self::stepped(subject, setup)?;
        run.instance.terminate()?;
        Ok(run)
    }

    /// A usual run after some steps, fewer if the FMU is slow; the test ends if the FMU ends it.
    pub fn after(subject: &'a Subject<'a>, steps: usize) -> Result<Self> {
        let mut run = Self::begin(subject, subject.setup())?;
        run.advance_by(subject.task.steps.min(steps))?;
        ensure!(!run.ended, SKIP);
        Ok(run)
    }

    /// The rows of a short run.
    pub fn recorded(subject: &'a Subject<'a>, setup: RunSetup<'a>) -> Result<Trajectory> {
        Self::begin(subject, setup)?.record()
    }

    /// Resets the instance, which then needs to be initialized with the usual setup.
    pub fn reset(mut self) -> Result<Self> {
        self.instance.reset()?;
        self.setup = self.subject.setup();
        Ok(self)
    }

    pub fn time(&self) -> f64 {
        let (start, step) = (self.subject.start, self.subject.step);
        match self.setup.summed_times {
            true => (0..self.position.point).fold(start, |time, _| time + step),
            false => start + self.position.point as f64 * step,
        }
    }

    /// Puts an instance that is new or was reset into initialization mode.
    pub fn enter_initialization(&mut self) -> Result<()> {
        let start = self.subject.start;
        self.position = Position { now: start, handled: start, ..Position::default() };
        (self.is_initialized, self.ended, self.stuck) = (false, false, None);
        if self.setup.parameters {
            let parameters = self.subject.settable().filter(|v| v.is_parameter());
            self.change(parameters.filter(|v| v.of_type.is_float()))?;
        }
        let tolerance = self.subject.model.experiment("tolerance");
        let (start, stop) = (self.subject.start, self.setup.stop);
        self.instance.setup_experiment(start, stop, tolerance)?;
        self.instance.enter_initialization_mode()?;
        Ok(())
    }

    pub fn exit_initialization(&mut self) -> Result<()> {
        self.instance.exit_initialization_mode()?;
        self.is_initialized = true;
        Ok(())
    }

    /// Initializes an instance that is new or was reset.
    pub fn initialize(&mut self) -> Result<()> {
        self.enter_initialization()?;
        self.set_inputs(|_| true)?;
        self.schedule()?;
        self.exit_initialization()?;
        if self.subject.interface_type == InterfaceType::ScheduledExecution {
            self.activate_until(self.subject.start)?;
        }
        let is_exchange = self.subject.interface_type == InterfaceType::ModelExchange;
        if is_exchange || self.setup.event_mode {
            self.iterate()?;
        }
        if !self.ended {
            self.read_nominals()?;
            let nominals = &self.solver.nominals;
            ensure!(
                nominals.iter().all(|n| n.is_finite() && *n > 0.0),
                "fmi2GetNominalsOfContinuousStates gave {nominals:?}, expected finite numbers above 0"
            );
        }
        Ok(())
    }

    pub fn read(&mut self, variable: &XmlVariable<'_>) -> Result<Vec<Value>> {
        self.read_elements(variable, variable.element_count())
    }

    /// Reads this number of elements of a variable.
    pub fn read_elements(&mut self, variable: &XmlVariable<'_>, n: usize) -> Result<Vec<Value>> {
        let references = [variable.reference];
        let values = get(&mut self.instance, variable.of_type, &references, n);
        values.with_context(|| format!("{} cannot be read", quote(&variable.name)))
    }

    pub fn value(&mut self, variable: &XmlVariable<'_>) -> Result<Value> {
        self.read(variable)?.pop().context("it has no elements")
    }

    /// The values of a variable that the host sets. They cannot be read in initialization mode, in which it has its start
    /// values until a test changes them.
    pub fn setting(&mut self, variable: &XmlVariable<'_>) -> Result<Vec<Value>> {
        match self.is_initialized {
            true => self.read(variable),
            false => starts(variable).context(SKIP),
        }
    }

    pub fn set(&mut self, variable: &XmlVariable<'_>, values: &[Value]) -> fmu_host::Result {
        self.instance.set_values(variable.of_type, &[variable.reference], values)
    }

    /// Sets variables to other values than their start values; the test ends if the FMU refuses one.
    pub fn change<'b>(
        &mut self,
        variables: impl Iterator<Item = &'b XmlVariable<'b>>,
    ) -> Result<()> {
        for variable in variables {
            if let Some(values) = other_values(variable).first() {
                self.set(variable, values).ok().context(SKIP)?;
            }
        }
        Ok(())
    }

    pub fn reals(&mut self, references: &[u32]) -> fmu_host::Result<Vec<f64>> {
        if references.is_empty() {
            return Ok(Vec::new());
        }
        let get = |i: &mut Instance, values: &mut [f64]| i.get_float64(references, values);
        self.instance.read(references.len(), get)
    }

    /// Number of continuous states that the host sees.
    pub fn states(&self) -> usize {
        match self.subject.interface_type {
            InterfaceType::ModelExchange => self.subject.states,
            _ => 0,
        }
    }

    pub fn continuous_states(&mut self) -> fmu_host::Result<Vec<f64>> {
        match self.states() {
            0 => Ok(Vec::new()),
            n => self.instance.read(n, Instance::get_continuous_states),
        }
    }

    pub fn derivatives(&mut self) -> fmu_host::Result<Vec<f64>> {
        match self.states() {
            0 => Ok(Vec::new()),
            n => self.instance.read(n, Instance::get_continuous_state_derivatives),
        }
    }

    /// Takes a step without what belongs to it; time and size are in steps since the start.
    pub fn do_step(&mut self, time: f64, size: f64) -> fmu_host::Result {
        let Subject { start, step, .. } = *self.subject;
        self.instance.do_step(start + time * step, size * step)
    }

    pub fn set_inputs(&mut self, which: impl Fn(&Input<'_>) -> bool) -> Result<()> {
        let RunSetup { excitation, seed, .. } = self.setup;
        for input in self.subject.inputs.iter().filter(|input| which(input)) {
            if let Some(values) = input.values(excitation, seed, self.position.point) {
                self.set(input.variable, &values)?;
            }
        }
        Ok(())
    }

    /// Iterates in event mode until no new discrete states are needed.
    pub fn iterate(&mut self) -> Result<()> {
        let time = self.position.now;
        let before = self.continuous_states()?;
        let (mut may_change, mut nominals_changed, mut ticks) = (false, false, false);
        for _ in 0..MAX_ROUNDS {
            let ticked = self.tick()?;
            let update = self.instance.update_discrete_states()?;
            may_change |= update.states_changed;
            nominals_changed |= update.nominals_changed;
            self.check_written("fmi2NewDiscreteStates", update.is_written);
            if update.terminate {
                self.ended = true;
                return Ok(());
            }
            let ticks_again = self.reschedule(&ticked, !update.again)?;
            if self.ended {
                return Ok(());
            }
            if update.again || ticks_again {
                ticks = ticks_again && !update.again;
                continue;
            }
            if let Some(next) = update.next_event {
                ensure!(
                    next > time,
                    "fmi2NewDiscreteStates gave {next} s for nextEventTime at t = {time} s, expected a later time"
                );
            }
            if !may_change {
                let after = self.continuous_states()?;
                ensure!(
                    after == before,
                    "an event has changed the states from {before:?} to {after:?}, but valuesOfContinuousStatesChanged is false"
                );
            }
            (self.position.next_event, self.position.handled) = (update.next_event, time);
            if nominals_changed {
                self.read_nominals()?;
                self.solver.has_new_nominals = true;
            }
            match self.setup.event_mode {
                true => self.instance.enter_step_mode()?,
                false => self.instance.enter_continuous_time_mode()?,
            };
            return Ok(());
        }
        ensure!(
            !ticks,
            "a clock ticks at t = {time} s for the {MAX_ROUNDS}th time, expected it to wait for a later time"
        );
        bail!(
            "fmi2NewDiscreteStates still needs new discrete states after {MAX_ROUNDS} calls, expected the event iteration to end"
        )
    }

    /// Reports the first finding of a rule in this run, unless a condition holds.
    pub fn expect(&mut self, rule: &'static Rule, condition: bool, text: impl FnOnce() -> String) {
        if !condition && self.reported.insert(rule.id) {
            self.subject.report.add_finding(rule, text());
        }
    }

    pub fn check_written(&mut self, function: &str, is_written: bool) {
        self.expect(rule!("event-iteration"), is_written, || {
            format!("{function} did not write all of its results, expected it to write all")
        });
    }

    /// Takes a communication step, unless the run has ended; it ends with the default experiment.
    pub fn advance(&mut self) -> Result<()> {
        self.ended |= self.position.point >= self.subject.all_steps();
        if self.ended {
            return Ok(());
        }
        let (begin, step) = (self.time(), self.subject.step);
        self.subject.report.at(begin);
        match self.subject.interface_type {
            InterfaceType::ModelExchange => self.integrate(begin, step)?,
            InterfaceType::ScheduledExecution => {
                self.trigger(begin + step);
                self.activate_until(begin + step)?;
            }
            InterfaceType::CoSimulation => {
                // With event mode, discrete inputs are set at events only.
                let event_mode = self.setup.event_mode;
                if event_mode && self.trigger(begin) {
                    self.at_event(|_| Ok(()))?;
                }
                self.set_inputs(|input| !event_mode || input.is_continuous())?;
                let mut passed = 0.0;
                for fraction in self.setup.fractions {
                    self.step(begin + passed * step, fraction * step)?;
                    passed += fraction;
                }
            }
        }
        self.position.point += 1;
        Ok(())
    }

    /// Does in event mode what hosts with event mode may do there only, and elsewhere what it is between steps.
    pub fn at_event(&mut self, act: impl FnOnce(&mut Self) -> Result<()>) -> Result<()> {
        if !self.setup.event_mode || !self.is_initialized {
            return act(self);
        }
        self.instance.enter_event_mode()?;
        act(self)?;
        self.iterate()
    }

    pub fn advance_by(&mut self, steps: usize) -> Result<()> {
        (0..steps).try_for_each(|_| self.advance())
    }

    /// Takes a step, and handles the events in it and at its end in event mode, if the FMU needs that.
    pub fn step(&mut self, time: f64, step: f64) -> Result<()> {
        let end = time + step;
        let (mut begin, mut size, mut early) = (time, step, 0);
        // In other FMUs, clocks tick at the ends of steps.
        let splits =
            self.setup.event_mode && self.subject.claims("canHandleVariableCommunicationStepSize");
        if splits {
            self.position.now = begin;
        }
        for _ in 0..MAX_ROUNDS {
            let tick = self.tick_before(end).filter(|_| splits);
            let part = tick.map_or(size, |tick| tick - begin);
            let is_early = !self.ended && self.step_once(begin, part)?;
            if self.ended || !is_early && tick.is_none() {
                return Ok(());
            }
            early += usize::from(is_early);
            (begin, size) = (self.position.now, end - self.position.now);
        }
        if early < MAX_ROUNDS {
            self.end_as_ticks_are_too_many();
            return Ok(());
        }
        bail!("the step from t = {time} s has returned early {MAX_ROUNDS} times")
    }

    /// Takes a step; returns whether it has returned early.
    fn step_once(&mut self, time: f64, step: f64) -> Result<bool> {
        let RunSetup { event_mode, early_return, .. } = self.setup;
        let discrete = self.subject.observed.variables().filter(|v| event_mode && is_discrete(v));
        let discrete = self.subject.group(discrete);
        let before = self.row(&discrete)?;
        let stepped = match self.instance.step(time, step, true) {
            Ok((_, stepped)) => stepped,
            // By fmi2Discard, an FMU may also tell that it has reached the end of its simulation.
            Err(failure)
                if failure.cause == Cause::Returned(Status::Discard)
                    && self.instance.is_terminated() == Ok(true) =>
            {
                self.ended = true;
                return Ok(false);
            }
            failure => failure.with_context(|| format!("the step from t = {time} s"))?.1,
        };
        self.ended = stepped.terminate;
        if self.ended {
            return Ok(false);
        }
        let (last, end) = (stepped.last_successful_time, time + step);
        self.position.now = last;
        let usual = self.subject.step;
        let slack = 1e-6 * usual + 1e-9 * end.abs();
        // A step that returns for an event at its end is complete.
        let is_early = stepped.early_return && end - last > slack;
        let might = "mightReturnEarlyFromDoStep";
        ensure!(
            !is_early || early_return && last > time,
            "the step from t = {time} s has ended early, at {last} s, though that is not allowed"
        );
        self.expect(rule!("early-return-flag"), !is_early || self.subject.claims(might), || {
            format!("{might} is false, but the step from t = {time} s to {end} s ended at {last} s")
        });
        // Other steps need not end where the solver of an FMU does.
        let is_usual = (step - usual).abs() <= slack
            && self.subject.element.attribute("fixedInternalStepSize").is_none();
        let is_at_end = (last - end).abs() <= slack;
        self.expect(
            rule!("last-successful-time"),
            last <= end + slack || !stepped.early_return,
            || "a step has returned early, but lastSuccessfulTime is after its end".into(),
        );
        let is_right = stepped.early_return || !is_usual || is_at_end;
        self.expect(rule!("last-successful-time"), is_right, || {
            format!("lastSuccessfulTime is {:.3e} s off the end of a step of {usual} s", last - end)
        });
        let needed = stepped.event_handling_needed;
        self.expect(rule!("events-signalled"), event_mode || !needed, || {
            "eventHandlingNeeded is true after a step without event mode".into()
        });
        let how = ["inside a step with event mode", " as before, until fmi3UpdateDiscreteStates"];
        let changed = discrete.ensure_same(&self.row(&discrete)?, &before, 0.0, how);
        self.expect(rule!("events-signalled"), changed.is_ok(), || {
            format!("{:#}", changed.unwrap_err())
        });
        if event_mode && (needed || !self.due().is_empty()) {
            self.instance.enter_event_mode()?;
            self.iterate()?;
        }
        Ok(is_early)
    }

    pub fn event_indicators(&mut self) -> Result<Vec<f64>> {
        let n = self.subject.indicators;
        ensure!(n <= 1 << 20, "numberOfEventIndicators is {n}, which is more than can be tested");
        Ok(match n {
            0 => Vec::new(),
            _ => self.instance.read(n, Instance::get_event_indicators)?,
        })
    }

    /// The values of some variables, as a run of one point.
    pub fn row(&mut self, variables: &Observed<'_>) -> Result<Trajectory> {
        let read = variables.read(&mut self.instance)?;
        Ok(vec![(self.time(), self.with_held(variables, read))])
    }

    pub fn observe(&mut self) -> Result<Row> {
        let read = self.subject.observed.read(&mut self.instance)?;
        Ok(self.with_held(&self.subject.observed, read))
    }

    /// A row with the values of its clocked variables.
    fn with_held(&self, variables: &Observed<'_>, mut row: Row) -> Row {
        if variables.held().next().is_some() {
            row.extend(self.position.schedule.held.iter().cloned());
        }
        row
    }

    /// Takes the steps of a short run and records the values at each communication point.
    pub fn record(&mut self) -> Result<Trajectory> {
        self.record_by(Self::advance)
    }

    /// Like [`Run::record`]; `advance` takes each step.
    pub fn record_by(
        &mut self,
        advance: impl FnMut(&mut Self) -> Result<()>,
    ) -> Result<Trajectory> {
        let mut rows = Trajectory::new();
        let steps = self.subject.task.steps;
        let stride = self.subject.observed.stride(steps);
        self.take((steps, stride), Duration::MAX, advance, |time, row| {
            rows.push((time, row));
        })?;
        Ok(rows)
    }

    /// Takes steps to the end of the default experiment, or until a time limit; `observe` receives the time
    /// and the values at each communication point. Returns how many steps were taken.
    pub fn run_for(&mut self, limit: Duration, observe: impl FnMut(f64, Row)) -> Result<usize> {
        let steps = self.subject.all_steps();
        self.take((steps, 1), limit, Self::advance, observe)
    }

    /// Takes steps, and observes every few of them and the last.
    fn take(
        &mut self,
        (steps, stride): (usize, usize),
        limit: Duration,
        mut advance: impl FnMut(&mut Self) -> Result<()>,
        mut observe: impl FnMut(f64, Row),
    ) -> Result<usize> {
        let begin = Instant::now();
        observe(self.time(), self.observe()?);
        for k in 1..=steps {
            if begin.elapsed() > limit {
                return Ok(k - 1);
            }
            advance(self)?;
            if self.ended {
                return Ok(k - 1);
            }
            if k % stride == 0 || k == steps {
                observe(self.time(), self.observe()?);
            }
        }
        Ok(steps)
    }
}

/// Whether an error is a refusal of the FMU: it returned fmi2Error, fmi2Discard or fmi2Fatal.
pub fn is_refusal(error: &anyhow::Error) -> bool {
    use Status::{Discard, Error, Fatal};
    let failure = error.downcast_ref::<Failure>();
    failure.is_some_and(|f| matches!(f.cause, Cause::Returned(Error | Discard | Fatal)))
}

impl<'a> Subject<'a> {
    /// The usual run, with which the other runs are compared.
    pub fn usual(&'a self) -> Result<&'a Trajectory> {
        if let Some(usual) = self.usual.get() {
            return Ok(usual);
        }
        let usual = Run::recorded(self, self.setup())?;
        Ok(self.usual.get_or_init(|| usual))
    }
}
