//! The components of a system with their loaded FMUs, and the names of their variables, `component.variable`.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Deref;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, Type, Value, Variability, Variable};
use fmu_host::InterfaceType;

use crate::fmu::Sizes;
use crate::rate::{ComponentStep, Inputs, Rate};
use crate::similar::similar;
use crate::start::{scalar_literals, sizes};
use crate::{Component, Description, Fmu, Solver};

/// A component whose FMU is loaded.
#[derive(Clone)]
pub struct LoadedComponent {
    /// Its name in the system.
    pub name: String,
    /// The beginning of the names of its variables in the system: its name and a dot; nothing for a single FMU.
    pub(crate) prefix: String,
    /// Its FMU, shared by components with the same file.
    pub fmu: Arc<Fmu>,
    /// Whether its outputs after a step belong to the sample taken at the start of the step.
    pub(crate) sampled: bool,
    /// Whether `sampled` follows from its outputs, because the description does not have it.
    pub(crate) is_guess: bool,
    /// Whether the master handles its events, in co-simulation.
    pub(crate) event_mode: bool,
    /// Its own step, and how it fits the communication step.
    pub(crate) rate: Rate,
    /// What its inputs are between communication points.
    pub(crate) inputs: Inputs,
    /// The relative tolerance of its solver.
    pub(crate) tolerance: Option<f64>,
    /// The method by which its equations are integrated.
    pub(crate) solver: Solver,
    /// The start values of the description, by the indices of scalars.
    pub(crate) starts: Vec<(usize, Value)>,
    /// The names in its parameter set that the FMU does not have.
    pub(crate) ignored: Vec<String>,
}

impl LoadedComponent {
    fn load(component: &Component, system: &Description, fmus: &mut Fmus) -> Result<Self> {
        let mut open = |sizes| {
            open(component, system, sizes, fmus)
                .with_context(|| format!("component {}", component.name))
        };
        let full_name = |name: &str| format!("{}.{name}", component.name);
        let mut fmu = open(Sizes::new())?;
        let in_component = || format!("component {}", component.name);
        let mut set = component.parameter_set().with_context(in_component)?;
        set.retain(|parameter| !component.start.contains_key(&parameter.name));
        let in_set = set.iter().map(|parameter| (parameter.name.clone(), parameter.value.clone()));
        let mut start: BTreeMap<_, _> = in_set.chain(component.start.clone()).collect();
        let sizes = sizes(&fmu, &start, full_name)?;
        if !sizes.is_empty() {
            fmu = open(sizes)?;
        }
        let rate = rate(component, &fmu, system.step);
        let rate = rate.with_context(|| format!("component {}", component.name))?;
        let mut ignored = Vec::new();
        for parameter in &set {
            match fmu.elements(&parameter.name) {
                Ok((scalars, _)) => {
                    let value =
                        parameter.in_unit_of(&fmu, scalars[0]).with_context(in_component)?;
                    start.insert(parameter.name.clone(), value);
                }
                Err(_) => ignored.extend(start.remove_entry(&parameter.name).map(|(name, _)| name)),
            }
        }
        let mut starts = Vec::new();
        for (name, literal) in &start {
            for literal in scalar_literals(&fmu, name, &full_name(name), literal)? {
                starts.push((literal.scalar, literal.start_value(&fmu)?));
            }
        }
        let event_mode = event_mode(component, system, &fmu)?;
        let is_clocked = fmu.is_scheduled() || event_mode && fmu.has_clocks;
        Ok(Self {
            name: component.name.clone(),
            prefix: if system.is_single { String::new() } else { full_name("") },
            sampled: !is_clocked && component.sampled.unwrap_or_else(|| is_sampled(&fmu)),
            is_guess: component.sampled.is_none() && component.function.is_none(),
            event_mode,
            rate,
            inputs: component.inputs,
            solver: component.solver.or(system.solver).unwrap_or_default(),
            tolerance: component.tolerance.or(system.tolerance).or(fmu.tolerance),
            starts,
            ignored,
            fmu,
        })
    }

    /// Whether the master integrates its equations.
    pub(crate) fn integrates(&self) -> bool {
        self.fmu.interface_type == InterfaceType::ModelExchange
    }

    /// Whether it has clocks.
    pub(crate) fn is_clocked(&self) -> bool {
        self.fmu.is_scheduled() || self.event_mode && self.fmu.has_clocks
    }

    /// Whether a step is one call, in each communication step.
    pub(crate) fn is_plain(&self) -> bool {
        !self.integrates()
            && !self.event_mode
            && !self.fmu.is_scheduled()
            && self.rate.is_of_system()
    }

    /// The name of a scalar in the system.
    pub(crate) fn name_of(&self, scalar: usize) -> String {
        format!("{}{}", self.prefix, self.fmu.name(scalar))
    }

    /// The start values of the description.
    pub fn starts(&self) -> impl Iterator<Item = (&Variable, &Value)> {
        let starts = self.starts.iter();
        starts.map(|(scalar, value)| (self.fmu.variable(*scalar), value))
    }
}

/// The opened FMUs by their files, interface types and sizes.
type Fmus = HashMap<(PathBuf, Option<InterfaceType>, Sizes), Arc<Fmu>>;

fn open(
    component: &Component,
    system: &Description,
    sizes: Sizes,
    fmus: &mut Fmus,
) -> Result<Arc<Fmu>> {
    if let Some(function) = &component.function {
        let step = match component.step {
            Some(ComponentStep::Size(step)) => step,
            _ => system.step,
        };
        let variables = function.variables(&component.name, step)?;
        return Ok(Arc::new(Fmu::from_function(&component.fmu, function, variables)));
    }
    let key = (component.fmu.clone(), component.interface, sizes);
    if let Some(fmu) = fmus.get(&key) {
        return Ok(fmu.clone());
    }
    let Description { sandbox, compilation, .. } = system;
    let (file, interface) = (&component.fmu, component.interface);
    let fmu = Arc::new(Fmu::open(file, interface, &key.2, *sandbox, compilation)?);
    fmus.insert(key, fmu.clone());
    Ok(fmu)
}

/// Whether the master handles the events of a component in co-simulation.
fn event_mode(component: &Component, system: &Description, fmu: &Fmu) -> Result<bool> {
    let of_all = system.event_mode.filter(|_| fmu.has_event_mode || system.is_single);
    let wanted = of_all.or(component.event_mode);
    ensure!(
        wanted != Some(true) || fmu.has_event_mode,
        "component {}: event_mode = true, but {} has no event mode in co-simulation (hasEventMode)",
        component.name,
        fmu.file_name()
    );
    if fmu.is_scheduled() {
        return Ok(false);
    }
    let needs_it = fmu.clocks().find(|clock| fmu.variable(*clock).causality == Causality::Input);
    if let (Some(false), Some(clock)) = (wanted, needs_it) {
        bail!(
            "component {}: the clock {} of {} ticks in event mode, in which it does not run: event_mode is false, or it is stepped by hand",
            component.name,
            fmu.name(clock),
            fmu.file_name()
        );
    }
    Ok(wanted.unwrap_or(fmu.has_event_mode && fmu.has_clocks))
}

/// The rate of a component in a system with this communication step (s).
fn rate(component: &Component, fmu: &Fmu, communication_step: f64) -> Result<Rate> {
    match component.step {
        None => Ok(Rate::of_system(communication_step)),
        Some(ComponentStep::Size(step)) => Rate::new(step, communication_step),
        Some(ComponentStep::DefaultExperiment) => {
            let step = fmu.step.with_context(|| {
                format!(
                    "step = \"default experiment\", but {} has no step size in it",
                    fmu.file_name()
                )
            })?;
            Rate::new(step, communication_step).context("default experiment")
        }
    }
}

/// Whether all outputs are discrete, as in a sampled controller.
fn is_sampled(fmu: &Fmu) -> bool {
    let outputs = fmu.variables.iter().filter(|v| v.causality == Causality::Output);
    let mut outputs = outputs.peekable();
    outputs.peek().is_some() && outputs.all(|v| v.variability == Variability::Discrete)
}

/// A scalar of a system, by the index of its component and its index in the FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct ScalarId {
    pub(crate) component: usize,
    pub(crate) scalar: usize,
}

impl ScalarId {
    pub(crate) fn fmu(self, components: &[LoadedComponent]) -> &Fmu {
        &components[self.component].fmu
    }

    pub(crate) fn variable(self, components: &[LoadedComponent]) -> &Variable {
        self.fmu(components).variable(self.scalar)
    }

    /// The clocks on which it depends, by value reference.
    pub(crate) fn clocks(self, components: &[LoadedComponent]) -> &[u32] {
        &self.variable(components).clocks
    }

    /// Whether it depends on clocks.
    pub(crate) fn is_clocked(self, components: &[LoadedComponent]) -> bool {
        !self.clocks(components).is_empty()
    }

    /// The type whose functions get and set it.
    pub(crate) fn access_type(self, components: &[LoadedComponent]) -> Type {
        self.fmu(components).access_type(self.scalar)
    }

    /// Its name in the system.
    pub(crate) fn name(self, components: &[LoadedComponent]) -> String {
        components[self.component].name_of(self.scalar)
    }
}

/// The components of a system, in its order.
pub struct Components {
    pub(crate) all: Vec<LoadedComponent>,
    /// The indices of the components by the prefixes of their variables.
    by_prefix: HashMap<String, usize>,
}

impl Deref for Components {
    type Target = [LoadedComponent];

    fn deref(&self) -> &[LoadedComponent] {
        &self.all
    }
}

impl Components {
    /// Loads the FMUs of a system, each file once.
    ///
    /// # Errors
    /// A name, a tolerance or a start value is invalid, or an FMU cannot be used.
    pub(crate) fn load(description: &Description) -> Result<Self> {
        ensure!(!description.components.is_empty(), "the system has no component");
        // Dots separate the names of nested systems of a package.
        let is_invalid = |c: char| c.is_control() || (c == '.' && description.package.is_none());
        let mut fmus = Fmus::new();
        let mut all: Vec<LoadedComponent> = Vec::new();
        let (mut names, mut users) = (HashSet::new(), HashMap::new());
        for component in &description.components {
            let name = &component.name;
            ensure!(
                !name.is_empty() && !name.contains(is_invalid),
                "the component name {name:?} is invalid; expected a name without dots and control characters"
            );
            ensure!(names.insert(name), "two components have the name {name}");
            check_tolerance(&format!("tolerance of {name}"), component.tolerance)?;
            let new = LoadedComponent::load(component, description, &mut fmus)?;
            if let Some(other) = users.insert(new.fmu.path.clone(), name) {
                ensure!(
                    !new.fmu.only_once,
                    "{} allows only one instance; {other} and {name} both use it",
                    new.fmu.file_name()
                );
            }
            all.push(new);
        }
        let prefixes = all.iter().map(|component| component.prefix.clone());
        Ok(Self { by_prefix: prefixes.zip(0..).collect(), all })
    }

    /// All scalars of all components.
    pub(crate) fn scalars(&self) -> impl Iterator<Item = ScalarId> {
        self.iter().enumerate().flat_map(|(component, loaded)| {
            (0..loaded.fmu.scalars.len()).map(move |scalar| ScalarId { component, scalar })
        })
    }

    /// The scalar `component.variable`, or the variable of a single FMU.
    ///
    /// # Errors
    /// There is no such scalar; the error names similar ones.
    pub(crate) fn scalar(&self, name: &str) -> Result<ScalarId> {
        let (component, scalar) = self.lookup(name, Fmu::scalar)?;
        Ok(ScalarId { component, scalar })
    }

    /// The scalar that is set by the name `component.variable`, or the variable of a single FMU.
    ///
    /// # Errors
    /// As [`Self::scalar`].
    pub(crate) fn settable(&self, name: &str) -> Result<ScalarId> {
        let (component, scalar) = self.lookup(name, Fmu::settable)?;
        Ok(ScalarId { component, scalar })
    }

    /// The component of a name, and the rest of the name, which need not be a variable of its FMU.
    ///
    /// # Errors
    /// There is no such component; the error names similar ones.
    pub(crate) fn split<'a>(&self, name: &'a str) -> Result<(usize, &'a str)> {
        // Of several components, the one with the longest name.
        let mut ends = name.rmatch_indices('.').map(|(dot, _)| dot + 1).chain([0]);
        let owner = ends.find_map(|end| Some((*self.by_prefix.get(&name[..end])?, &name[end..])));
        if let Some(owner) = owner {
            return Ok(owner);
        }
        // The end of a name, as pid.kp of controller.pid.kp.
        let end = format!(".{name}");
        let longer = self.scalars().map(|id| id.name(self));
        let longer = Vec::from_iter(longer.filter(|longer| longer.ends_with(&end)).take(3));
        let did_you_mean = format!("did you mean {}?", longer.join(" or "));
        let Some((component, _)) = name.split_once('.') else {
            let hint = if longer.is_empty() { String::new() } else { format!("; {did_you_mean}") };
            bail!("{name:?} is not of the form component.variable{hint}");
        };
        let names = Vec::from_iter(self.iter().map(|c| c.name.as_str()));
        let known = match similar(component, names.iter().copied()).first() {
            Some(name) => format!("did you mean {name}?"),
            None if !longer.is_empty() => did_you_mean,
            None => format!("the components are {}", names.join(", ")),
        };
        bail!("{name}: there is no component {component:?}; {known}")
    }

    /// The name of a variable whose start value is set, without quotes around the name of its component, which may have
    /// an equals sign.
    pub(crate) fn unquoted<'a>(&self, name: &'a str) -> Cow<'a, str> {
        let quoted = name.strip_prefix('\'').and_then(|rest| rest.split_once("'."));
        match quoted {
            Some((component, variable)) if self.scalar(name).is_err() => {
                format!("{component}.{variable}").into()
            }
            _ => name.into(),
        }
    }

    /// The component of a name, and what `find` finds in its FMU.
    pub(crate) fn lookup<T>(
        &self,
        name: &str,
        find: impl Fn(&Fmu, &str) -> Result<T>,
    ) -> Result<(usize, T)> {
        let (component, variable) = self.split(name)?;
        let LoadedComponent { prefix, fmu, .. } = &self[component];
        let found = find(fmu, variable);
        let found = if prefix.is_empty() { found } else { found.with_context(|| name.to_owned()) };
        Ok((component, found?))
    }
}

/// Checks a tolerance, which `key` names.
pub(crate) fn check_tolerance(key: &str, tolerance: Option<f64>) -> Result<()> {
    match tolerance {
        Some(value) if !(value > 0.0 && value.is_finite()) => {
            bail!("{key} = {value} is invalid, expected a positive number")
        }
        _ => Ok(()),
    }
}
