//! The FMU under test, in the child process.

use std::collections::HashSet;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, OnceLock};

use anyhow::{Context, Result, bail};
use fmu_description::value::unsigned;
use fmu_description::xml::Element;
use fmu_description::{Causality, Listed, ModelDescription, Type, Unknown, Variability};
use fmu_host::{Instance, Instantiation, Kind, Library, Status, Treatment};

use super::child::{Report, Task};
use super::inputs::{Input, Level, inputs, is_tested};
use super::probes::claims;
use super::run::Run;
use super::values::{MAX_ELEMENTS, Observed, Row, Trajectory};

/// The FMU under test.
pub struct Subject<'a> {
    /// The task.
    pub task: &'a Task,
    /// Its model description.
    pub model: &'a ModelDescription<'a>,
    /// Its binary.
    pub library: &'a Arc<Library>,
    /// The interface type under test.
    pub kind: Kind,
    /// The XML element of that type.
    pub element: &'a Element<'a>,
    /// The location of the folder `resources`.
    resources: String,
    /// Where findings and the progress of the test go.
    pub report: &'a Arc<Report>,
    /// The variables that the FMU computes and that can be compared between runs.
    pub observed: Observed<'a>,
    /// The inputs.
    pub inputs: Vec<Input<'a>>,
    /// The usual run, once it was made.
    usual: OnceLock<Trajectory>,
    /// How many messages were logged.
    pub logged: Arc<Logged>,
}

/// Counts of log messages.
#[derive(Default)]
pub struct Logged {
    /// Messages without a category.
    pub uncategorized: AtomicUsize,
    /// Messages with a category that the XML does not list, though it lists some.
    pub undeclared: AtomicUsize,
    /// Messages with a number that is not a status.
    pub invalid: AtomicUsize,
    /// Messages with the status OK.
    pub ok: AtomicUsize,
    /// Messages with the name of another instance.
    pub misnamed: AtomicUsize,
}

/// What varies between runs of the same FMU.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// Name of the instance.
    pub name: &'a str,
    /// Whether logging is on.
    pub logging: bool,
    /// The stop time passed to the FMU.
    pub stop: Option<f64>,
    /// How the arguments of `fmi2Instantiate` are passed.
    pub treatment: Treatment,
    /// How strongly inputs are excited.
    pub level: Level,
    /// Selects one of many excitations.
    pub seed: u64,
    /// Whether parameters are changed by a little.
    pub parameters: bool,
    /// Whether times are sums of step sizes, with rounding errors that add up, instead of products.
    pub summed_times: bool,
    /// In co-simulation, the parts of a communication step, as fractions of its size.
    pub fractions: &'static [f64],
    /// In model exchange, steps of an explicit Euler method in a communication step.
    pub parts: usize,
    /// In co-simulation, whether event mode is used.
    pub event_mode: bool,
}

impl Setup<'_> {
    /// The setup with a change.
    pub fn with(mut self, change: impl FnOnce(&mut Self)) -> Self {
        change(&mut self);
        self
    }
}

impl<'a> Subject<'a> {
    /// The FMU in the library, for a task.
    pub fn new(
        task: &'a Task,
        model: &'a ModelDescription<'a>,
        library: &'a Arc<Library>,
        report: &'a Arc<Report>,
    ) -> Result<Self> {
        let element = model.root.child(&task.interface);
        Ok(Self {
            task,
            model,
            library,
            kind: match task.interface.as_str() {
                "ModelExchange" => Kind::ModelExchange,
                _ => Kind::CoSimulation,
            },
            element: element.context("it is not of this kind")?,
            resources: library.location(&task.folder.join("resources")),
            report,
            observed: observed(model, &task.ignored),
            inputs: inputs(model),
            usual: OnceLock::new(),
            logged: Arc::default(),
        })
    }

    /// Whether a flag of the XML, named as in FMI 2.0, is true.
    pub fn claims(&self, flag: &str) -> bool {
        claims(self.element, flag, self.model.version)
    }

    /// The usual setup.
    pub fn setup(&self) -> Setup<'static> {
        Setup {
            name: "instance",
            logging: self.task.logging,
            stop: self.stop(),
            treatment: Treatment::Usual,
            level: self.task.level,
            seed: 1,
            parameters: false,
            summed_times: false,
            fractions: &[1.0],
            parts: 10,
            event_mode: false,
        }
    }

    /// The usual setup, with inputs that keep their start values.
    pub fn still(&self) -> Setup<'static> {
        self.setup().with(|s| s.level = Level::Still)
    }

    /// The setup of another instance, with another excitation than the usual one.
    pub fn other(&self) -> Setup<'static> {
        self.setup().with(|s| (s.name, s.seed) = ("other", 3))
    }

    /// Creates an instance.
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

    /// Creates an instance with this GUID; `None` if the FMU rejects it.
    pub fn try_instantiate(&self, setup: &Setup<'_>, guid: &str) -> Result<Option<Instance>> {
        let arguments = Instantiation {
            name: setup.name,
            kind: self.kind,
            guid,
            resources: &self.resources,
            logging_on: setup.logging,
            event_mode_used: setup.event_mode,
            treatment: setup.treatment,
            ..Instantiation::default()
        };
        let (report, logged) = (Arc::clone(self.report), Arc::clone(&self.logged));
        let name = setup.name.to_owned();
        let categories = self.model.root.list("LogCategories", "Category");
        let categories = categories.filter_map(|category| category.attribute("name"));
        let categories: HashSet<String> = categories.map(str::to_owned).collect();
        let sink = move |message: fmu_host::Logged| {
            let is_undeclared =
                |name: &String| !categories.is_empty() && !categories.contains(name);
            let is_ok = message.status == Status::Ok;
            for (count, applies) in [
                (
                    &logged.misnamed,
                    message.instance.is_some_and(|of| of != name),
                ),
                (&logged.uncategorized, message.category.is_none()),
                (
                    &logged.undeclared,
                    message.category.as_ref().is_some_and(is_undeclared),
                ),
                (
                    &logged.invalid,
                    matches!(message.status, Status::Unknown(_)),
                ),
                (&logged.ok, is_ok),
            ] {
                count.fetch_add(applies.into(), Relaxed);
            }
            if !is_ok {
                report.log(&message.text);
            }
        };
        Ok(self.library.instantiate(&arguments, sink)?)
    }

    /// Start time of the default experiment.
    pub fn start(&self) -> f64 {
        let start = self.model.experiment("startTime");
        start.filter(|t| t.is_finite()).unwrap_or(0.0)
    }

    /// Stop time of the default experiment.
    pub fn stop(&self) -> Option<f64> {
        let stop = self.model.experiment("stopTime");
        stop.filter(|stop| stop.is_finite() && *stop > self.start())
    }

    /// Duration of the default experiment, which is 1 s if it has no stop time.
    fn span(&self) -> f64 {
        self.stop().map_or(1.0, |stop| stop - self.start())
    }

    /// Step size of the default experiment; if there is none, the one that FMPy would choose.
    pub fn step(&self) -> f64 {
        let step = self.model.experiment("stepSize");
        step.filter(|step| *step > 0.0 && *step <= self.span())
            .unwrap_or_else(|| 10_f64.powf(self.span().log10().round() - 3.0))
    }

    /// Number of steps to the end of the default experiment.
    pub fn all_steps(&self) -> usize {
        // Rounding may put the last point just past the stop time.
        (self.span() / self.step() + 1e-6).floor() as usize
    }

    /// Relative differences up to this come from the FMU's solver, which has the tolerance of the
    /// default experiment.
    pub fn tolerance(&self) -> f64 {
        let tolerance = self.model.experiment("tolerance").filter(|t| *t > 0.0);
        tolerance.map_or(1e-6, |tolerance| (10.0 * tolerance).clamp(1e-6, 1e-2))
    }

    /// All variables that can be read, arrays included.
    pub fn readable(&self) -> impl Iterator<Item = &'a Listed<'a>> {
        readable(self.model, &self.task.ignored)
    }

    /// All scalars that can be read.
    pub fn all(&self) -> impl Iterator<Item = &'a Listed<'a>> {
        self.readable().filter(|v| is_tested(v))
    }

    /// The scalars of a causality that can be read.
    pub fn variables(&self, causality: Causality) -> impl Iterator<Item = &'a Listed<'a>> {
        self.all().filter(move |v| v.causality == causality)
    }

    /// The scalars that the host sets: parameters and inputs.
    pub fn settable(&self) -> impl Iterator<Item = &'a Listed<'a>> {
        self.all()
            .filter(|v| matches!(v.causality, Causality::Parameter | Causality::Input))
    }

    /// The Float64 scalars of a causality that can be read.
    pub fn reals(&self, causality: Causality) -> Vec<&'a Listed<'a>> {
        let all = self.variables(causality);
        all.filter(|v| v.of_type == Type::Float64).collect()
    }

    /// Of [`Subject::reals`], the continuous ones.
    pub fn continuous(&self, causality: Causality) -> Vec<&'a Listed<'a>> {
        let mut reals = self.reals(causality);
        reals.retain(|v| v.variability == Variability::Continuous);
        reals
    }

    /// Number of continuous states.
    pub fn states(&self) -> usize {
        self.count(&self.model.derivatives)
    }

    /// Number of event indicators.
    pub fn indicators(&self) -> usize {
        let indicators = self.model.root.attribute("numberOfEventIndicators");
        let in_2 = indicators.and_then(unsigned).unwrap_or(0) as usize;
        in_2.max(self.count(&self.model.event_indicators))
    }

    /// Number of elements of the variables in a list.
    fn count(&self, unknowns: &[Unknown<'_>]) -> usize {
        let variables = unknowns.iter().map(|u| self.model.variable(u.index));
        variables.map(|v| v.map_or(1, |v| v.count())).sum()
    }

    /// Whether a process may have only one instance.
    pub fn is_only_once(&self) -> bool {
        self.claims("canBeInstantiatedOnlyOncePerProcess")
    }

    /// The usual run, which others are compared with.
    pub fn usual(&'a self) -> Result<&'a Trajectory> {
        if let Some(usual) = self.usual.get() {
            return Ok(usual);
        }
        let usual = Run::recorded(self, self.setup())?;
        Ok(self.usual.get_or_init(|| usual))
    }

    /// Checks that two runs are the same up to a tolerance, relative to the largest value of each variable.
    /// `when` tells what the actual run does, `like` what the expected run has done.
    pub fn ensure_same(
        &self,
        actual: &Trajectory,
        expected: &[(f64, Row)],
        tolerance: f64,
        when: &str,
        like: &str,
    ) -> Result<()> {
        match self.observed.difference(actual, expected, tolerance) {
            Some(difference) => bail!(difference.told(when, like)),
            None => Ok(()),
        }
    }
}

/// The variables that an FMU computes and that can be compared between runs, without those that are named.
pub fn observed<'a>(model: &'a ModelDescription<'a>, without: &HashSet<String>) -> Observed<'a> {
    use Causality::{CalculatedParameter, Local, Output};
    let computed = readable(model, without)
        .filter(|v| matches!(v.causality, Output | Local | CalculatedParameter));
    Observed::of(computed, model.version)
}

/// The variables of a model that the tests read, without those that are named.
pub fn readable<'a>(
    model: &'a ModelDescription<'a>,
    without: &HashSet<String>,
) -> impl Iterator<Item = &'a Listed<'a>> {
    let is_array = |v: &Listed<'_>| {
        let is_other = matches!(v.of_type, Type::String | Type::Binary | Type::Clock);
        let is_clocked = v.element.attribute("clocks").is_some();
        !v.dimensions.is_empty() && v.count() <= MAX_ELEMENTS && !is_other && !is_clocked
    };
    let all = model.variables().map(|(_, v)| v);
    all.filter(move |v| (is_tested(v) || is_array(v)) && !without.contains(&v.name))
}
