//! The FMU under test, in the worker process.

use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicUsize};
use std::sync::{Arc, Mutex, OnceLock};

use anyhow::{Context, Result, ensure};
use fmu_description::value::whole;
use fmu_description::xml::Element;
use fmu_description::{Causality, ModelDescription, Type, Unknown, XmlVariable};
use fmu_host::{Instance, Instantiation, InterfaceType, Library, Status, Treatment};

use crate::binary::excitation::{EXCITATIONS, Input, inputs};
use crate::binary::observed::{Observed, Trajectory, is_tested, observed, readable};
use crate::binary::report::{Reporter, lock};
use crate::binary::schedule::Clocks;
use crate::binary::task::{FMU, Task};
use crate::binary::vocabulary::claims;
use crate::rules::is_continuous;

/// Ends a test without a finding: `set.ok().context(SKIP)?`.
pub const SKIP: &str = "the FMU refuses what it may refuse";

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
    /// Its step size in s, or the step size that FMPy would choose.
    pub step: f64,
    /// Relative differences up to this come from the FMU's solver, which has its tolerance.
    pub tolerance: f64,
    /// Where findings and the progress of the test go.
    pub report: &'a Arc<Reporter>,
    /// The variables that the FMU computes and that can be compared between runs.
    pub observed: Observed<'a>,
    pub inputs: Vec<Input<'a>>,
    /// Numbers of continuous states and of event indicators.
    pub states: usize,
    pub indicators: usize,
    /// The usual run, once it was made.
    pub usual: OnceLock<Trajectory>,
    /// Whether an instance was made in this process.
    is_used: Arc<AtomicBool>,
    pub clocks: Clocks<'a>,
    pub logged: Arc<Mutex<LogCounts>>,
    /// The only log category that the FMU is to use, if one was chosen.
    pub chosen: Arc<Mutex<Option<String>>>,
    /// Number of intermediate updates.
    pub updates: Arc<AtomicUsize>,
}

/// How many messages were logged.
#[derive(Debug, Clone, Copy, Default)]
pub struct LogCounts {
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

/// The differences between runs of the same FMU.
#[derive(Debug, Clone, Copy)]
pub struct RunSetup<'a> {
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
    /// In event mode, whether discrete states are evaluated before they are read.
    pub evaluates: bool,
}

impl RunSetup<'_> {
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
        report: &'a Arc<Reporter>,
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
            states: element_count(model, &model.derivatives),
            indicators: in_2.max(element_count(model, &model.event_indicators)),
            usual: task.usual.clone().map_or_else(OnceLock::new, OnceLock::from),
            is_used: Arc::default(),
            clocks: Clocks::new(model),
            logged: Arc::default(),
            chosen: Arc::default(),
            updates: Arc::default(),
        })
    }

    /// The same FMU in the same process, for runs of another kind.
    pub fn again(&self) -> Result<Self> {
        let other = Self::new(self.task, self.model, self.library, self.report)?;
        Ok(Self { is_used: Arc::clone(&self.is_used), ..other })
    }

    /// The same FMU with its resources in another folder.
    pub fn with_resources(&self, folder: &Path) -> Result<Self> {
        Ok(Self { resources: self.library.location(folder), ..self.again()? })
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
    pub fn setup(&self) -> RunSetup<'static> {
        let is_exchange = self.interface_type == InterfaceType::ModelExchange;
        RunSetup {
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
            event_mode: !self.clocks.is_empty() && !is_exchange && self.claims("hasEventMode"),
            evaluates: false,
            early_return: false,
        }
    }

    /// The usual setup, with inputs that keep their start values.
    pub fn still(&self) -> RunSetup<'static> {
        self.setup().with(|s| s.excitation = 0.0)
    }

    /// The setup of another instance, with another excitation than the usual one.
    pub fn other(&self) -> RunSetup<'static> {
        self.setup().with(|s| (s.name, s.seed) = ("other", 3))
    }

    pub fn instantiate(&self, setup: &RunSetup<'_>) -> Result<Instance> {
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
    pub fn try_instantiate(&self, setup: &RunSetup<'_>, guid: &str) -> Result<Option<Instance>> {
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
        let sink = move |message: fmu_host::LogMessage| {
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
                report.log(&message.text.replace(['\n', '\r'], " "));
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
        Observed::new(variables, self.model.version)
    }
}

/// Number of elements of the variables in a list.
fn element_count(model: &ModelDescription<'_>, unknowns: &[Unknown<'_>]) -> usize {
    let variables = unknowns.iter().map(|u| model.variable(u.index));
    variables.map(|v| v.map_or(1, |v| v.element_count())).sum()
}
