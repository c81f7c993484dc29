//! The FMU under test, and runs of it, in the child process.

use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value::{boolean, whole};
use fmu_description::xml::Element;
use fmu_description::{
    Causality, FmiVersion, ModelDescription, Type, Unknown, Value, Variability, XmlVariable,
};
use fmu_file::text::quote;
use fmu_host::{
    Cause, Failure, Instance, Instantiation, InterfaceType, Library, Status, Treatment,
};
use fmu_worker::{Calls, Function, Record, Service};

use super::exchange::Solver;
use super::values::{
    EXCITATIONS, Input, Observed, Row, Trajectory, get, inputs, is_readable, is_tested, others,
    starts,
};
use super::{FMU, Reply, Task, logged};
use crate::rule::{Rule, rule};
use crate::rules::is_continuous;

/// Maximum number of calls of `fmi2NewDiscreteStates` in one event iteration.
const MAX_ROUNDS: usize = 1000;
/// In model exchange, every how many steps there is an event.
pub const EVENT_EVERY: usize = 10;

/// Reports a finding unless a condition holds: `check!(subject, "memory": bytes == 0, "{bytes} are left")`.
macro_rules! check {
    ($subject:expr, $rule:literal: $condition:expr, $($text:tt)+) => {
        match $condition {
            true => {}
            false => $subject.report.find($crate::rule::rule!($rule), format!($($text)+)),
        }
    };
}
pub(super) use check;

/// The flag of an FMU of which a process has one instance at most.
pub const ONLY_ONCE: &str = "canBeInstantiatedOnlyOncePerProcess";

/// Ends a test without a finding: `set.ok().context(SKIP)?`.
pub const SKIP: &str = "the FMU refuses what it may refuse";

/// Where findings and the progress of the test go.
pub struct Report {
    version: FmiVersion,
    interface_type: InterfaceType,
    record: Record,
    calls: Mutex<Calls>,
    service: Mutex<Service>,
}

impl Report {
    pub fn new(service: Service, version: FmiVersion, interface_type: InterfaceType) -> Self {
        Self {
            version,
            interface_type,
            calls: service.record().calls(0).into(),
            record: service.record().clone(),
            service: service.into(),
        }
    }

    pub fn call(&self, name: &str) {
        lock(&self.calls).begin(Function::named(name).or(Some(Function::LOADING)));
    }

    /// Records what the test is about to do, such as `after fmi2Reset`.
    pub fn stage(&self, text: impl AsRef<str>) {
        self.record.stage(&self.in_version(text.as_ref()));
    }

    pub fn find(&self, rule: &Rule, text: impl AsRef<str>) {
        let text = self.in_version(text.as_ref()).replace(['\n', '\r'], " ");
        self.reply(&Reply::Found(rule.id.to_owned(), text));
    }

    /// Reports the failure of a test, with its stage and the message logged last.
    pub fn fail(&self, rule: &Rule, text: &str) {
        let (text, last) = (self.in_version(text), self.record.snapshot());
        let stage = match last.stage.as_str() {
            stage if text.contains(stage) => String::new(),
            stage => format!(" {stage}"),
        };
        // Once more in this version, it would be wrong.
        let text = format!("{text}{stage}{}", logged(&last.message)).replace(['\n', '\r'], " ");
        self.reply(&Reply::Found(rule.id.to_owned(), text));
    }

    pub fn reply(&self, reply: &Reply) {
        lock(&self.service).reply(reply);
    }

    /// A text with the names of the functions that were called.
    fn in_version(&self, text: &str) -> String {
        in_version(text, self.version, self.interface_type)
    }
}

pub fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The names of FMI 2.0 in a text, as they are in a version of FMI for a kind of instance. What is in quotes is the
/// FMU's.
fn in_version(text: &str, version: FmiVersion, interface_type: InterfaceType) -> String {
    let instantiate = match interface_type {
        InterfaceType::ModelExchange => "fmi3InstantiateModelExchange",
        InterfaceType::CoSimulation => "fmi3InstantiateCoSimulation",
    };
    let names: [[&str; 2]; 14] = [
        ["fmi2Instantiate", instantiate],
        ["fmi2GetRealOutputDerivatives", "fmi3GetOutputDerivatives"],
        ["fmi2GetReal", "fmi3GetFloat64"],
        ["fmi2SetReal", "fmi3SetFloat64"],
        ["fmi2GetInteger", "fmi3GetInt32"],
        ["fmi2SetInteger", "fmi3SetInt32"],
        ["fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"],
        ["fmi2NewDiscreteStates", "fmi3UpdateDiscreteStates"],
        ["fmi2SetupExperiment", "fmi3EnterInitializationMode"],
        ["FMUstate", "FMUState"],
        ["DeSerialize", "Deserialize"],
        ["providesDirectionalDerivative", "providesDirectionalDerivatives"],
        ["the GUID", "the instantiationToken"],
        ["fmi2", "fmi3"],
    ];
    if version == FmiVersion::Fmi2 {
        return text.to_owned();
    }
    let rename = |text: String, [old, new]: &[&str; 2]| text.replace(old, new);
    let mut is_quoted = false;
    let parts = text.split_inclusive('"').map(|part| {
        let renamed = match is_quoted {
            true => part.to_owned(),
            false => names.iter().fold(part.to_owned(), rename),
        };
        let before = part.trim_end_matches('"');
        let escapes = before.len() - before.trim_end_matches('\\').len();
        is_quoted = !is_quoted || escapes % 2 == 1;
        renamed
    });
    parts.collect()
}

#[test]
fn names_of_functions_are_those_of_the_version_but_not_in_quotes() {
    let text = r#"fmi2SetReal for "fmi2\" and "a\"fmi2", fmi2Reset"#;
    assert_eq!(in_version(text, FmiVersion::Fmi2, InterfaceType::CoSimulation), text);
    let expected = r#"fmi3SetFloat64 for "fmi2\" and "a\"fmi2", fmi3Reset"#;
    assert_eq!(in_version(text, FmiVersion::Fmi3, InterfaceType::CoSimulation), expected);
    let of_exchange = in_version("fmi2Instantiate", FmiVersion::Fmi3, InterfaceType::ModelExchange);
    assert_eq!(of_exchange, "fmi3InstantiateModelExchange");
}

/// The FMU under test.
pub struct Subject<'a> {
    pub task: &'a Task,
    pub model: &'a ModelDescription<'a>,
    pub library: &'a Arc<Library>,
    pub interface_type: InterfaceType,
    pub element: &'a Element<'a>,
    resources: String,
    /// Of the default experiment: its start and its stop, if it has one, in s.
    pub start: f64,
    pub stop: Option<f64>,
    /// Its duration, which is 1 s if it has no stop time.
    pub span: f64,
    /// Its step size in s; if there is none, the one that FMPy would choose.
    pub step: f64,
    /// Relative differences up to this come from the FMU's solver, which has its tolerance.
    pub tolerance: f64,
    /// Where findings and the progress of the test go.
    pub report: &'a Arc<Report>,
    /// The variables that the FMU computes and that can be compared between runs.
    pub observed: Observed<'a>,
    pub inputs: Vec<Input<'a>>,
    /// Numbers of continuous states and of event indicators.
    pub states: usize,
    pub indicators: usize,
    /// The usual run, once it was made.
    usual: OnceLock<Trajectory>,
    /// Whether an instance was made.
    is_used: AtomicBool,
    /// Whether the FMU has clocks, and whether the host must let some of them tick, which no test does.
    has_clocks: bool,
    pub needs_ticks: bool,
    pub logged: Arc<Mutex<Logged>>,
    /// The only log category that the FMU is to use, if one was chosen.
    pub chosen: Arc<Mutex<Option<String>>>,
    /// Number of intermediate updates.
    pub updates: Arc<AtomicUsize>,
}

/// How many messages were logged.
#[derive(Debug, Clone, Copy, Default)]
pub struct Logged {
    pub uncategorized: usize,
    /// Messages with a category that the XML does not list, though it lists some.
    pub undeclared: usize,
    /// Messages with status fmi2OK of a category that the XML lists, but that is not the chosen one.
    pub unchosen: usize,
    /// Messages with a number that is not a status.
    pub invalid: usize,
    pub ok: usize,
    /// Messages with the name of another instance.
    pub misnamed: usize,
}

/// What varies between runs of the same FMU.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    pub name: &'a str,
    pub logging: bool,
    pub stop: Option<f64>,
    /// How the arguments of `fmi2Instantiate` are passed.
    pub treatment: Treatment,
    /// How strongly inputs are excited, one of [`EXCITATIONS`].
    pub excitation: f64,
    /// Selects one of many signals.
    pub seed: u64,
    /// Whether parameters are changed by a little.
    pub parameters: bool,
    /// Whether times are sums of step sizes, with rounding errors that add up, instead of products.
    pub summed_times: bool,
    /// In co-simulation, the parts of a communication step, as fractions of its size.
    pub fractions: &'static [f64],
    /// In model exchange, the parts of a communication step in which the solver starts anew.
    pub parts: usize,
    /// In co-simulation, whether event mode is used, and whether the host allows steps to return early and
    /// receives intermediate updates.
    pub event_mode: bool,
    pub early_return: bool,
}

impl Setup<'_> {
    pub fn with(mut self, change: impl FnOnce(&mut Self)) -> Self {
        change(&mut self);
        self
    }
}

impl<'a> Subject<'a> {
    pub fn new(
        task: &'a Task,
        model: &'a ModelDescription<'a>,
        library: &'a Arc<Library>,
        report: &'a Arc<Report>,
    ) -> Result<Self> {
        let element = model.root.child(&task.interface);
        let start = model.experiment("startTime").filter(|t| t.is_finite());
        let start = start.unwrap_or(0.0);
        let stop = model.experiment("stopTime");
        let stop = stop.filter(|stop| stop.is_finite() && *stop > start);
        let span = stop.map_or(1.0, |stop| stop - start);
        let step = model.experiment("stepSize");
        let step = step.filter(|step| *step > 0.0 && *step <= span);
        let tolerance = model.experiment("tolerance").filter(|t| *t > 0.0);
        let in_2 = model.root.attribute("numberOfEventIndicators");
        let in_2 = in_2.and_then(whole::<u32>).unwrap_or(0) as usize;
        let variables = model.variables().map(|(_, v)| v);
        let clocks: Vec<_> = variables.filter(|v| v.of_type == Type::Clock).collect();
        let is_triggered =
            |v: &XmlVariable<'_>| v.inherited("intervalVariability") == Some("triggered");
        Ok(Self {
            start,
            stop,
            span,
            step: step.unwrap_or_else(|| 10_f64.powf(span.log10().round() - 3.0)),
            tolerance: tolerance.map_or(1e-6, |t| (10.0 * t).clamp(1e-6, 1e-2)),
            task,
            model,
            library,
            interface_type: task.interface_type(),
            element: element.context("it is not of this kind")?,
            resources: library.location(&task.session.join(FMU).join("resources")),
            report,
            observed: observed(model, &task.ignored),
            inputs: inputs(model),
            states: count(model, &model.derivatives),
            indicators: in_2.max(count(model, &model.event_indicators)),
            usual: task.usual.clone().map_or_else(OnceLock::new, OnceLock::from),
            is_used: AtomicBool::new(false),
            has_clocks: !clocks.is_empty(),
            needs_ticks: clocks.iter().any(|v| v.causality == Causality::Input && !is_triggered(v)),
            logged: Arc::default(),
            chosen: Arc::default(),
            updates: Arc::default(),
        })
    }

    /// The same FMU with its resources in another folder.
    pub fn with_resources(&self, folder: &Path) -> Result<Self> {
        let moved = Self::new(self.task, self.model, self.library, self.report)?;
        Ok(Self { resources: self.library.location(folder), ..moved })
    }

    /// Whether a flag of the interface type, named as in FMI 2.0, is true.
    pub fn claims(&self, flag: &str) -> bool {
        claims(self.element, flag, self.model.version)
    }

    /// Whether a process may have one instance only: the FMU says so, or its instances share state, which has been
    /// reported.
    pub fn is_alone(&self) -> bool {
        self.task.is_alone
    }

    /// The usual setup. FMUs with clocks need event mode (FMI 3.0.2, section 2.3.1).
    pub fn setup(&self) -> Setup<'static> {
        let is_exchange = self.interface_type == InterfaceType::ModelExchange;
        Setup {
            name: "instance",
            logging: self.task.logging,
            stop: self.stop,
            treatment: Treatment::Usual,
            excitation: EXCITATIONS[self.task.excitation],
            seed: 1,
            parameters: false,
            summed_times: false,
            fractions: &[1.0],
            parts: 1,
            event_mode: self.has_clocks && !is_exchange && self.claims("hasEventMode"),
            early_return: false,
        }
    }

    /// The usual setup, with inputs that keep their start values.
    pub fn still(&self) -> Setup<'static> {
        self.setup().with(|s| s.excitation = 0.0)
    }

    /// The setup of another instance, with another excitation than the usual one.
    pub fn other(&self) -> Setup<'static> {
        self.setup().with(|s| (s.name, s.seed) = ("other", 3))
    }

    pub fn instantiate(&self, setup: &Setup<'_>) -> Result<Instance> {
        let instance = self.try_instantiate(setup, self.model.token())?;
        instance.with_context(|| {
            let tool = match self.claims("needsExecutionTool") {
                true => "; needsExecutionTool is true: is its tool installed?",
                false => "",
            };
            format!(
                "fmi2Instantiate returned NULL for the GUID of the XML, expected an instance{tool}"
            )
        })
    }

    /// Creates an instance with this GUID; `None` if the FMU rejects it. The test ends if the process would have
    /// more instances than the FMU allows.
    pub fn try_instantiate(&self, setup: &Setup<'_>, guid: &str) -> Result<Option<Instance>> {
        ensure!(!self.is_used.swap(true, Relaxed) || !self.is_alone(), SKIP);
        let arguments = Instantiation {
            name: setup.name,
            interface_type: self.interface_type,
            guid,
            resources: &self.resources,
            logging_on: setup.logging,
            event_mode_used: setup.event_mode,
            early_return_allowed: setup.early_return,
            on_intermediate: setup.early_return.then(|| {
                let updates = Arc::clone(&self.updates);
                Arc::new(move || {
                    updates.fetch_add(1, Relaxed);
                }) as fmu_host::OnIntermediate
            }),
            treatment: setup.treatment,
            ..Instantiation::default()
        };
        let (report, logged) = (Arc::clone(self.report), Arc::clone(&self.logged));
        let (name, chosen) = (setup.name.to_owned(), Arc::clone(&self.chosen));
        let categories = self.model.root.list("LogCategories", "Category");
        let categories = categories.filter_map(|category| category.attribute("name"));
        let categories: HashSet<String> = categories.map(str::to_owned).collect();
        let sink = move |message: fmu_host::Logged| {
            let (category, is_ok) = (message.category.as_ref(), message.status == Status::Ok);
            let is_known = |category| categories.is_empty() || categories.contains(category);
            let mut count = lock(&logged);
            count.misnamed += usize::from(message.instance.is_some_and(|of| of != name));
            count.uncategorized += usize::from(category.is_none());
            count.undeclared += usize::from(!category.is_none_or(is_known));
            let is_chosen = |category: &String| {
                lock(&chosen).as_ref().is_none_or(|chosen| chosen == category)
                    || !categories.contains(category)
            };
            count.unchosen += usize::from(is_ok && !category.is_none_or(is_chosen));
            count.invalid += usize::from(matches!(message.status, Status::Unknown(_)));
            count.ok += usize::from(is_ok);
            if !is_ok {
                report.record.log(&message.text.replace(['\n', '\r'], " "));
            }
        };
        Ok(self.library.instantiate(&arguments, sink)?)
    }

    /// Number of communication steps of the default experiment.
    pub fn all_steps(&self) -> usize {
        // Rounding may put the last point just past the stop time.
        (self.span / self.step + 1e-6).floor() as usize
    }

    /// All variables that can be read, arrays included.
    pub fn readable(&self) -> impl Iterator<Item = &'a XmlVariable<'a>> {
        readable(self.model, &self.task.ignored)
    }

    /// The variables of a causality that can be read.
    pub fn variables(&self, causality: Causality) -> impl Iterator<Item = &'a XmlVariable<'a>> {
        self.readable().filter(move |v| v.causality == causality)
    }

    /// The variables that the host sets: parameters and inputs.
    pub fn settable(&self) -> impl Iterator<Item = &'a XmlVariable<'a>> {
        self.readable().filter(|v| matches!(v.causality, Causality::Parameter | Causality::Input))
    }

    /// The Float64 scalars of a causality that can be read.
    pub fn reals(&self, causality: Causality) -> Vec<&'a XmlVariable<'a>> {
        let all = self.variables(causality);
        all.filter(|v| v.of_type == Type::Float64 && is_tested(v)).collect()
    }

    /// Of [`Subject::reals`], the continuous ones.
    pub fn continuous(&self, causality: Causality) -> Vec<&'a XmlVariable<'a>> {
        let mut reals = self.reals(causality);
        reals.retain(|v| is_continuous(v));
        reals
    }

    /// The names of what can be read in initialization mode, as only that is computed then: outputs, initial unknowns,
    /// states and their derivatives (FMI 2.0.5, section 3.2.3).
    pub fn known_initially(&self) -> HashSet<&'a str> {
        let model = self.model;
        let unknowns = model.initial_unknowns.iter().chain(&model.derivatives);
        let listed = unknowns.filter_map(|unknown| model.variable(unknown.index));
        let derivatives = model.derivatives.iter().filter_map(|u| model.variable(u.index));
        let states = derivatives.filter_map(|v| model.referred(v.value, "derivative"));
        let outputs = self.readable().filter(|v| v.causality == Causality::Output);
        listed.chain(states).chain(outputs).map(|v| v.name.as_str()).collect()
    }

    pub fn group(&self, variables: impl Iterator<Item = &'a XmlVariable<'a>>) -> Observed<'a> {
        Observed::of(variables, self.model.version)
    }

    /// The usual run, which others are compared with.
    pub fn usual(&'a self) -> Result<&'a Trajectory> {
        if let Some(usual) = self.usual.get() {
            return Ok(usual);
        }
        let usual = Run::recorded(self, self.setup())?;
        Ok(self.usual.get_or_init(|| usual))
    }
}

/// Number of elements of the variables in a list.
fn count(model: &ModelDescription<'_>, unknowns: &[Unknown<'_>]) -> usize {
    let variables = unknowns.iter().map(|u| model.variable(u.index));
    variables.map(|v| v.map_or(1, |v| v.element_count())).sum()
}

/// Whether an interface type declares a flag, named as in FMI 2.0.
pub fn claims(element: &Element<'_>, flag: &str, version: FmiVersion) -> bool {
    let flag = element.attribute(&in_version(flag, version, InterfaceType::default()));
    flag.and_then(boolean) == Some(true)
}

/// The variables that an FMU computes and that can be compared between runs, without those that are named.
pub fn observed<'a>(model: &'a ModelDescription<'a>, without: &HashSet<String>) -> Observed<'a> {
    use Causality::{CalculatedParameter, Local, Output};
    let computed = readable(model, without)
        .filter(|v| matches!(v.causality, Output | Local | CalculatedParameter));
    Observed::of(computed, model.version)
}

/// Whether a variable changes at events only.
pub fn is_discrete(variable: &XmlVariable<'_>) -> bool {
    let is_output = variable.causality == Causality::Output;
    variable.variability == Variability::Discrete || !variable.of_type.is_float() && is_output
}

/// The variables of a model that the tests read, without those that are named.
pub fn readable<'a>(
    model: &'a ModelDescription<'a>,
    without: &HashSet<String>,
) -> impl Iterator<Item = &'a XmlVariable<'a>> {
    let all = model.variables().map(|(_, v)| v);
    all.filter(move |v| is_readable(v) && !without.contains(&v.name))
}

pub struct Run<'a> {
    pub(crate) subject: &'a Subject<'a>,
    /// What differs from other runs.
    pub setup: Setup<'a>,
    pub instance: Instance,
    pub place: Place,
    pub is_initialized: bool,
    /// Whether the FMU has ended the run, or the default experiment or the equations do not go on.
    pub ended: bool,
    /// Why the equations could not be integrated.
    pub stuck: Option<String>,
    pub solver: Solver,
    /// The rules with findings that steps have reported.
    reported: HashSet<&'static str>,
}

/// A point of a simulation, to which a restored state goes back.
#[derive(Debug, Clone, Copy, Default)]
pub struct Place {
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
}

impl<'a> Run<'a> {
    pub fn instantiate(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
        Ok(Self {
            subject,
            setup,
            instance: subject.instantiate(&setup)?,
            place: Place::default(),
            is_initialized: false,
            ended: false,
            stuck: None,
            solver: Solver::default(),
            reported: HashSet::new(),
        })
    }

    pub fn initializing(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
        let mut run = Self::instantiate(subject, setup)?;
        run.enter_initialization()?;
        Ok(run)
    }

    pub fn begin(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
        let mut run = Self::instantiate(subject, setup)?;
        run.initialize()?;
        Ok(run)
    }

    /// A run after its first step; the test ends if the FMU ends the run in it.
    pub fn stepped(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
        let mut run = Self::begin(subject, setup)?;
        run.advance()?;
        ensure!(!run.ended, SKIP);
        Ok(run)
    }

    /// A run that was terminated after its first step.
    pub fn terminated(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Self> {
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
    pub fn recorded(subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Trajectory> {
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
            true => (0..self.place.point).fold(start, |time, _| time + step),
            false => start + self.place.point as f64 * step,
        }
    }

    /// Puts an instance that is new or was reset into initialization mode.
    pub fn enter_initialization(&mut self) -> Result<()> {
        let start = self.subject.start;
        self.place = Place { now: start, handled: start, ..Place::default() };
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
        self.exit_initialization()?;
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
            if let Some(values) = others(variable).first() {
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
            InterfaceType::CoSimulation => 0,
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
        let Setup { excitation, seed, .. } = self.setup;
        for input in self.subject.inputs.iter().filter(|input| which(input)) {
            if let Some(values) = input.values(excitation, seed, self.place.point) {
                self.set(input.variable, &values)?;
            }
        }
        Ok(())
    }

    /// Iterates in event mode until no new discrete states are needed.
    pub fn iterate(&mut self) -> Result<()> {
        let time = self.place.now;
        let before = self.continuous_states()?;
        let (mut may_change, mut nominals_changed) = (false, false);
        for _ in 0..MAX_ROUNDS {
            let update = self.instance.update_discrete_states()?;
            may_change |= update.states_changed;
            nominals_changed |= update.nominals_changed;
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
                let after = self.continuous_states()?;
                ensure!(
                    after == before,
                    "an event has changed the states from {before:?} to {after:?}, but valuesOfContinuousStatesChanged is false"
                );
            }
            (self.place.next_event, self.place.handled) = (update.next_event, time);
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
        bail!(
            "fmi2NewDiscreteStates still needs new discrete states after {MAX_ROUNDS} calls, expected the event iteration to end"
        )
    }

    /// Reports the first finding of a rule in this run, unless a condition holds.
    fn expect(&mut self, rule: &'static Rule, condition: bool, text: impl FnOnce() -> String) {
        if !condition && self.reported.insert(rule.id) {
            self.subject.report.find(rule, text());
        }
    }

    pub fn check_written(&mut self, function: &str, is_written: bool) {
        self.expect(rule!("event-iteration"), is_written, || {
            format!("{function} did not write all of its results, expected it to write all")
        });
    }

    /// Takes a communication step, unless the run has ended; it ends with the default experiment.
    pub fn advance(&mut self) -> Result<()> {
        self.ended |= self.place.point >= self.subject.all_steps();
        if self.ended {
            return Ok(());
        }
        let (begin, step) = (self.time(), self.subject.step);
        self.subject.report.record.at(begin);
        match self.subject.interface_type {
            InterfaceType::CoSimulation => {
                // With event mode, discrete inputs are set at events only.
                let event_mode = self.setup.event_mode;
                self.set_inputs(|input| !event_mode || input.is_continuous())?;
                let mut passed = 0.0;
                for fraction in self.setup.fractions {
                    self.step(begin + passed * step, fraction * step)?;
                    passed += fraction;
                }
            }
            InterfaceType::ModelExchange => self.integrate(begin, step)?,
        }
        self.place.point += 1;
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
        let (mut begin, mut size) = (time, step);
        for _ in 0..MAX_ROUNDS {
            if self.ended || !self.step_once(begin, size)? {
                return Ok(());
            }
            (begin, size) = (self.place.now, end - self.place.now);
        }
        bail!("the step from t = {time} s has returned early {MAX_ROUNDS} times")
    }

    /// Takes a step; returns whether it has returned early.
    fn step_once(&mut self, time: f64, step: f64) -> Result<bool> {
        let Setup { event_mode, early_return, .. } = self.setup;
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
        self.place.now = last;
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
        if event_mode && needed {
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
        Ok(vec![(self.time(), variables.read(&mut self.instance)?)])
    }

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
