//! The FMU under test, in the child process.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use fmu_description::value::{boolean, unsigned};
use fmu_description::xml::Element;
use fmu_description::{
    Capability, Causality, FmiVersion, ModelDescription, ScalarVariable, Unknown, VariableType,
};
use fmu_host::{Instance, Instantiation, Kind, Library, Options, Status, Treatment};

use super::excitation::{Input, Level};
use super::record::{Class, Observed, Row};
use super::report::{Report, in_version};

/// Whether the tests read and set a variable: scalars other than Binaries, clocks and structural
/// parameters.
pub fn is_tested(variable: &ScalarVariable<'_>) -> bool {
    variable.dimensions.is_empty()
        && Class::of(variable.kind) != Class::Other
        && !variable.is_structural
        && variable.element.attribute("clocks").is_none()
}

/// Whether a variable is a Real, in FMI 3.0 a Float64.
pub fn is_real(variable: &ScalarVariable<'_>) -> bool {
    matches!(variable.kind, VariableType::Real | VariableType::Float64)
}

/// The FMU under test.
pub struct Subject<'a> {
    /// Its model description.
    pub model: &'a ModelDescription<'a>,
    /// Its binary.
    pub library: &'a Arc<Library>,
    /// The interface type under test.
    pub kind: Kind,
    /// The XML element of that type.
    pub element: &'a Element<'a>,
    /// URI of the folder `resources`.
    pub resources: String,
    /// Where findings and the progress of the test go.
    pub report: &'a Arc<Report>,
    /// How strongly inputs are excited.
    pub level: Level,
    /// Number of steps of a short run.
    pub steps: usize,
    /// Whether logging is on in the usual setup.
    pub logging: bool,
    /// Whether wrong calls crash the FMU.
    pub is_fragile: bool,
    /// Time limit of the test.
    pub time_limit: Duration,
    /// The variables that the FMU computes and that can be compared between runs.
    pub observed: Observed<'a>,
    /// Names of variables that are not observed.
    pub ignored: HashSet<String>,
    /// The inputs.
    pub inputs: Vec<Input<'a>>,
    /// How many messages were logged without a category, and how many with status OK.
    pub logged: Arc<Logged>,
}

/// Counts of log messages.
#[derive(Default)]
pub struct Logged {
    /// Messages without a category.
    pub uncategorized: AtomicUsize,
    /// Messages with a category that the XML does not list, though it lists some.
    pub undeclared: AtomicUsize,
    /// Messages with a number that is not an `fmi2Status`.
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
    /// In model exchange, steps of an explicit Euler method in a communication step.
    pub parts: usize,
    /// In co-simulation, whether event mode is used.
    pub event_mode: bool,
}

impl<'a> Subject<'a> {
    /// The variables that are observed in runs, without those that are named.
    pub fn observed_of(model: &'a ModelDescription<'a>, without: &HashSet<String>) -> Observed<'a> {
        Observed::of(model.variables().map(|(_, v)| v).filter(|v| {
            use Causality::{CalculatedParameter, Local, Output};
            matches!(v.causality, Output | Local | CalculatedParameter)
                && is_tested(v)
                && !without.contains(v.name)
        }))
    }

    /// Whether the FMU declares a capability.
    pub fn claims(&self, capability: Capability) -> bool {
        self.has(&in_version(capability.as_str(), self.model.version))
    }

    /// Whether a flag of the XML is true.
    pub fn has(&self, flag: &str) -> bool {
        self.element.attribute(flag).and_then(boolean) == Some(true)
    }

    /// The usual setup.
    pub fn setup(&self) -> Setup<'static> {
        Setup {
            name: "instance",
            logging: self.logging,
            stop: self.stop(),
            treatment: Treatment::Usual,
            level: self.level,
            seed: 1,
            parameters: false,
            summed_times: false,
            parts: 10,
            event_mode: false,
        }
    }

    /// The usual setup, with inputs that keep their start values.
    pub fn still(&self) -> Setup<'static> {
        Setup {
            level: Level::Still,
            ..self.setup()
        }
    }

    /// Creates an instance.
    pub fn instantiate(&self, setup: &Setup<'_>) -> Result<Instance> {
        let guid = self.model.token();
        self.try_instantiate(setup, guid)?.with_context(|| {
            let tool = match self.claims(Capability::NeedsExecutionTool) {
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
        };
        let (report, logged) = (Arc::clone(self.report), Arc::clone(&self.logged));
        let name = setup.name.to_owned();
        let categories = self.model.root.list("LogCategories", "Category");
        let categories = categories.filter_map(|category| category.attribute("name"));
        let categories: HashSet<String> = categories.map(str::to_owned).collect();
        let sink = move |message: fmu_host::Logged| {
            if message.instance.is_some_and(|instance| instance != name) {
                logged.misnamed.fetch_add(1, Relaxed);
            }
            match &message.category {
                None => {
                    logged.uncategorized.fetch_add(1, Relaxed);
                }
                Some(name) if !categories.is_empty() && !categories.contains(name) => {
                    logged.undeclared.fetch_add(1, Relaxed);
                }
                Some(_) => {}
            }
            if matches!(message.status, Status::Unknown(_)) {
                logged.invalid.fetch_add(1, Relaxed);
            }
            if message.status == Status::Ok {
                logged.ok.fetch_add(1, Relaxed);
            } else {
                report.log(&message.text);
            }
        };
        if self.model.version == FmiVersion::Fmi3 {
            let options = Options {
                treatment: setup.treatment,
                event_mode_used: setup.event_mode,
                ..Options::default()
            };
            return Ok(self.library.instantiate_3(&arguments, options, sink)?);
        }
        Ok(self
            .library
            .instantiate_as(&arguments, setup.treatment, sink)?)
    }

    /// Start time of the default experiment.
    pub fn start(&self) -> f64 {
        self.model
            .experiment("startTime")
            .filter(|t| t.is_finite())
            .unwrap_or(0.0)
    }

    /// Stop time of the default experiment.
    pub fn stop(&self) -> Option<f64> {
        self.model
            .experiment("stopTime")
            .filter(|stop| stop.is_finite() && *stop > self.start())
    }

    /// Step size of the default experiment; if there is none, the one that FMPy would choose.
    pub fn step(&self) -> f64 {
        let span = self.stop().map_or(1.0, |stop| stop - self.start());
        self.model
            .experiment("stepSize")
            .filter(|step| *step > 0.0 && *step <= span)
            .unwrap_or_else(|| 10_f64.powf(span.log10().round() - 3.0))
    }

    /// Number of steps to the end of the default experiment.
    pub fn all_steps(&self) -> usize {
        let span = self.stop().map_or(1.0, |stop| stop - self.start());
        // Rounding may put the last point just past the stop time.
        (span / self.step() + 1e-6).floor() as usize
    }

    /// Relative differences up to this come from the FMU's solver, which has the tolerance of the
    /// default experiment.
    pub fn tolerance(&self) -> f64 {
        let tolerance = self.model.experiment("tolerance").filter(|t| *t > 0.0);
        tolerance.map_or(1e-6, |tolerance| (10.0 * tolerance).clamp(1e-6, 1e-2))
    }

    /// All variables that can be read.
    pub fn all(&self) -> impl Iterator<Item = &ScalarVariable<'a>> {
        let all = self.model.variables().map(|(_, v)| v);
        all.filter(|v| is_tested(v) && !self.ignored.contains(v.name))
    }

    /// The variables of a causality that can be read.
    pub fn variables(&self, causality: Causality) -> impl Iterator<Item = &ScalarVariable<'a>> {
        self.all().filter(move |v| v.causality == causality)
    }

    /// The Reals of a causality that can be read; in FMI 3.0 the Float64.
    pub fn reals(&self, causality: Causality) -> Vec<&ScalarVariable<'a>> {
        let all = self.variables(causality);
        all.filter(|v| is_real(v)).collect()
    }

    /// Number of continuous states.
    pub fn states(&self) -> usize {
        self.elements(&self.model.derivatives)
    }

    /// Number of event indicators.
    pub fn indicators(&self) -> usize {
        if self.model.version == FmiVersion::Fmi3 {
            return self.elements(&self.model.event_indicators);
        }
        let indicators = self.model.root.attribute("numberOfEventIndicators");
        indicators.and_then(unsigned).unwrap_or(0) as usize
    }

    /// Number of elements of the variables in a list.
    fn elements(&self, unknowns: &[Unknown<'_>]) -> usize {
        let variables = unknowns.iter().map(|u| self.model.variable(u.index));
        variables.map(|v| v.map_or(1, ScalarVariable::count)).sum()
    }

    /// Whether a process may have only one instance.
    pub fn is_only_once(&self) -> bool {
        self.claims(Capability::CanBeInstantiatedOnlyOncePerProcess)
    }

    /// Checks that two runs are the same up to a tolerance, relative to the largest value of each
    /// variable. `when` tells what the actual run does, `like` what the expected one has done.
    pub fn ensure_same(
        &self,
        actual: &[(f64, Row)],
        expected: &[(f64, Row)],
        tolerance: f64,
        when: &str,
        like: &str,
    ) -> Result<()> {
        match self.observed.difference(actual, expected, tolerance) {
            Some(text) => bail!("{when}, {text}{like}"),
            None => Ok(()),
        }
    }
}
