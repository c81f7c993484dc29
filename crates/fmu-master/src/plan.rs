//! A loaded and checked system, ready to simulate.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Error, Result, bail, ensure};
use fmu_description::{Causality, Initial, Type, Value, Variability, Variable};
use fmu_host::InterfaceType;

use crate::fmu::{Sizes, similar};
use crate::input::InputTable;
use crate::store::{number, places};
use crate::table::Column;
use crate::wiring::Wiring;
use crate::{
    Component, Connection, Conversion, Description, Experiment, Fault, Fmu, Literal, Order, Place,
};

/// A system with loaded FMUs and checked connections, start values and recorded variables.
pub struct Plan {
    /// The components, in their order.
    pub components: Vec<LoadedComponent>,
    /// The recorded variables, in the order of a row.
    pub columns: Vec<Column>,
    /// The times of a run.
    pub experiment: Experiment,
    owners: Names,
    pub(crate) order: Order,
    pub(crate) links: Vec<ResolvedConnection>,
    pub(crate) input: Option<InputTable>,
    pub(crate) wiring: Wiring,
    /// The smallest and the largest value of each column that the model description allows.
    pub bounds: Vec<[Option<f64>; 2]>,
    /// Choices of the master that the user may want to override, as sentences.
    pub notes: Vec<String>,
}

/// A start value that fits its variable: of a scalar, or of all elements of an array.
#[derive(Debug, Clone)]
pub struct StartValue {
    component: usize,
    values: Vec<(usize, Value)>,
}

impl Plan {
    /// Loads the FMUs of a system, each file once, and checks that everything fits.
    ///
    /// # Errors
    /// Something does not fit; the error names it: a file, a variable, a causality, a type, a unit, a
    /// start value, the times, an algebraic loop.
    pub fn new(description: &Description) -> Result<Self> {
        Self::load(description).map_err(|error| match &description.package {
            Some(package) => package.with_package_names(&error),
            None => error,
        })
    }

    fn load(description: &Description) -> Result<Self> {
        description.experiment().steps()?;
        tolerance("tolerance", description.tolerance)?;
        ensure!(!description.components.is_empty(), "the system has no component");
        // Dots separate the names of nested systems of a package.
        let is_invalid = |c: char| c.is_control() || (c == '.' && description.package.is_none());
        let mut fmus = Fmus::new();
        let mut components: Vec<LoadedComponent> = Vec::new();
        for component in &description.components {
            let name = &component.name;
            ensure!(
                !name.is_empty() && !name.contains(is_invalid),
                "the component name {name:?} is invalid; expected a name without dots and control characters"
            );
            ensure!(
                components.iter().all(|other| other.name != *name),
                "two components have the name {name}"
            );
            tolerance(&format!("tolerance of {name}"), component.tolerance)?;
            let new = LoadedComponent::new(component, description, &mut fmus)?;
            if let Some(other) = components.iter().find(|c| c.fmu.path == new.fmu.path) {
                ensure!(
                    !new.fmu.only_once,
                    "{} allows only one instance; {} and {name} both use it",
                    new.fmu.file_name(),
                    other.name
                );
            }
            components.push(new);
        }
        if description.is_single {
            components[0].prefix.clear();
        }
        let owners = Names::new(&components);
        let link = |connection: &Connection| {
            let Connection { from, to, conversion, faults } = connection;
            let mut all = faults.iter();
            let checked = all.try_for_each(|fault| fault.check(description.step));
            checked.with_context(|| format!("{from} -> {to}"))?;
            let [from, to] = [owners.port(&components, from)?, owners.port(&components, to)?];
            Ok(ResolvedConnection { from, to, conversion: *conversion, faults: faults.clone() })
        };
        let links = description.connections.iter().map(link);
        let links = links.collect::<Result<Vec<_>>>()?;
        links_fit(&components, &links)?;
        let fed: HashSet<usize> = links.iter().map(|link| link.to.component).collect();
        for (index, planned) in components.iter_mut().enumerate() {
            // The events of an FMU that no other one feeds do not wait for the next step.
            let is_fed = fed.contains(&index);
            planned.sampled &= is_fed || !planned.is_guess || !planned.integrates();
        }
        if description.order == Order::Sequential && !description.allow_algebraic_loops {
            no_algebraic_loops(&components, &links)?;
        }
        let input = description.input.as_deref();
        let input = input.map(|file| InputTable::read(file, &components, &owners, &links));
        let input = input.transpose()?;
        let (recorded, names): (Vec<_>, Vec<_>) =
            recorded(&components, &owners, &description.outputs)?.into_iter().unzip();
        let bounds = |port: &ScalarId| {
            let Variable { min, max, .. } = port.of(&components);
            [min, max].map(|bound| bound.as_ref().map(number))
        };
        let column = |(port, name): (&ScalarId, String)| {
            let Variable { of_type, unit, .. } = port.of(&components);
            Column::new(name, unit.as_deref().unwrap_or_default(), *of_type)
        };
        Ok(Self {
            order: description.order,
            experiment: description.experiment(),
            wiring: Wiring::new(description, &components, &links, input.as_ref(), &recorded),
            columns: recorded.iter().zip(names).map(column).collect(),
            notes: notes(&components, &recorded)
                .into_iter()
                .chain(description.experiment().note()?)
                .collect(),
            bounds: recorded.iter().map(bounds).collect(),
            input,
            components,
            owners,
            links,
        })
    }

    /// Start values as text, by `component.variable`, for [`Plan::simulate`]. Those of structural parameters,
    /// which are sizes of arrays, make another plan of the description.
    ///
    /// # Errors
    /// There is no such variable, or a value has the wrong type.
    pub fn set(
        mut self,
        mut description: Description,
        sets: &[(String, String)],
    ) -> Result<(Self, Vec<StartValue>)> {
        let sizes = self.sizes(sets);
        if !sizes.is_empty() {
            for (name, value) in sizes {
                description.set_start(name, Literal::Text(value.clone()));
            }
            self = Self::new(&description)?;
        }
        let starts = self.texts(sets)?;
        Ok((self, starts))
    }

    /// The start values in a list for [`Plan::set`] that make another plan: those of structural parameters, and with
    /// them those of arrays, whose sizes may differ from the ones in the description.
    pub fn sizes<'a>(&self, sets: &'a [(String, String)]) -> Vec<&'a (String, String)> {
        if !sets.iter().any(|(name, _)| self.is_structural(name)) {
            return Vec::new();
        }
        let is_array = |value: &String| Literal::Text(value.clone()).is_array();
        sets.iter().filter(|(name, value)| self.is_structural(name) || is_array(value)).collect()
    }

    /// The other start values in such a list, for [`Plan::simulate`].
    ///
    /// # Errors
    /// As [`Plan::set`].
    pub fn texts(&self, sets: &[(String, String)]) -> Result<Vec<StartValue>> {
        let others = sets.iter().filter(|(name, _)| !self.is_structural(name));
        others.map(|(name, value)| self.start(name, &Literal::Text(value.clone()))).collect()
    }

    /// The names of the components and of their files, for [`RunError::crash`](crate::RunError::crash).
    pub fn names(&self) -> Vec<(String, String)> {
        let names = self.components.iter().map(|c| (c.name.clone(), c.fmu.file_name()));
        names.collect()
    }

    /// The place in a row of a recorded variable.
    ///
    /// # Errors
    /// It is not recorded.
    pub fn place(&self, name: &str) -> Result<Place> {
        let places = places(self.columns.iter().map(|column| column.kind));
        let mut named = self.columns.iter().zip(places);
        let place = named.find_map(|(column, place)| (column.name == name).then_some(place));
        place.with_context(|| format!("{name} is not recorded"))
    }

    /// A start value for `component.variable` that replaces the one of the description.
    ///
    /// # Errors
    /// There is no such variable, the value has the wrong type, or another value replaces it.
    pub fn start(&self, name: &str, value: &Literal) -> Result<StartValue> {
        let name = &*self.name_to_set(name);
        let (component, own) =
            resolve(&self.components, &self.owners, name, |_, own| Ok(own.to_owned()))?;
        let fmu = &self.components[component].fmu;
        let assigned = assigned(fmu, &own, name, value)?.into_iter();
        let values = assigned.map(|Assigned { scalar, name, value }| {
            self.check_free(ScalarId { component, scalar }, &name, &value)?;
            Ok((scalar, start(fmu, scalar, &name, &value)?))
        });
        Ok(StartValue { component, values: values.collect::<Result<_>>()? })
    }

    /// Checks that a start value has an effect in a single run.
    fn check_free(&self, port: ScalarId, name: &str, value: &Literal) -> Result<()> {
        let link = self.links.iter().find(|link| link.to == port);
        if let Some(ResolvedConnection { from, .. }) = link {
            let from = from.name(&self.components);
            bail!("{name} = {value} has no effect, as {from} is connected to it");
        }
        let has_column = self.input.iter().flat_map(InputTable::ports).any(|fed| fed == port);
        ensure!(
            !has_column,
            "{name} = {value} has no effect, as the table of inputs has a column for it"
        );
        ensure!(
            port.of(&self.components).causality != Causality::StructuralParameter,
            "{name} = {value} cannot be set for single runs, as it is the size of arrays; expected it in the start values of the system"
        );
        Ok(())
    }

    /// The name of a variable of which a value is set, without quotes around the name of its component, which may have
    /// an equals sign.
    fn name_to_set<'a>(&self, name: &'a str) -> Cow<'a, str> {
        let quoted = name.strip_prefix('\'').and_then(|rest| rest.split_once("'."));
        match quoted {
            Some((component, variable)) if self.owners.port(&self.components, name).is_err() => {
                format!("{component}.{variable}").into()
            }
            _ => name.into(),
        }
    }

    /// Whether a variable, `component.variable`, is a structural parameter.
    fn is_structural(&self, name: &str) -> bool {
        let port = self.owners.port(&self.components, &self.name_to_set(name));
        let causality = port.map(|port| port.of(&self.components).causality);
        causality.is_ok_and(|causality| causality == Causality::StructuralParameter)
    }

    /// The start values of a component by the indices of its variables: as in the description, unless
    /// `others` replace them.
    pub(crate) fn starts<'a>(
        &'a self,
        component: usize,
        others: &'a [StartValue],
    ) -> BTreeMap<usize, &'a Value> {
        let own = self.components[component].starts.iter();
        let others = others.iter().filter(|start| start.component == component);
        let all = own.chain(others.flat_map(|start| &start.values));
        all.map(|(scalar, value)| (*scalar, value)).collect()
    }

    /// The stop time of the FMUs: the one of the run, or one step later if there are sampled components,
    /// whose last row belongs to a step from the stop time.
    pub fn end(&self) -> f64 {
        let Experiment { stop, step, .. } = self.experiment;
        if self.steps_from_stop() { stop + step } else { stop }
    }

    /// Whether a step from the stop time is needed, because a recorded component is sampled.
    pub(crate) fn steps_from_stop(&self) -> bool {
        let after = &self.wiring.after;
        !(after.reals.is_empty() && after.others.is_empty())
    }
}

/// A component whose FMU is loaded.
pub struct LoadedComponent {
    /// Its name in the system.
    pub name: String,
    /// What the names of its variables begin with in the system: its name and a dot, or nothing.
    prefix: String,
    /// Its FMU, shared by components with the same file.
    pub fmu: Arc<Fmu>,
    pub(crate) sampled: bool,
    /// Whether that follows from its outputs, as the description does not tell.
    pub(crate) is_guess: bool,
    /// The relative tolerance of its solver.
    pub(crate) tolerance: Option<f64>,
    pub(crate) starts: Vec<(usize, Value)>,
}

/// A scalar of a component, by their indices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct ScalarId {
    pub(crate) component: usize,
    pub(crate) scalar: usize,
}

/// A resolved connection.
#[derive(Debug, Clone)]
pub(crate) struct ResolvedConnection {
    pub(crate) from: ScalarId,
    pub(crate) to: ScalarId,
    pub(crate) conversion: Option<Conversion>,
    pub(crate) faults: Vec<Fault>,
}

impl ScalarId {
    pub(crate) fn of(self, components: &[LoadedComponent]) -> &Variable {
        components[self.component].fmu.variable(self.scalar)
    }

    /// The type whose functions get and set it.
    pub(crate) fn access(self, components: &[LoadedComponent]) -> Type {
        components[self.component].fmu.access(self.scalar)
    }

    /// Its name in the system.
    pub(crate) fn name(self, components: &[LoadedComponent]) -> String {
        components[self.component].name_of(self.scalar)
    }
}

/// The opened FMUs by their files, interfaces and sizes.
type Fmus = HashMap<(PathBuf, Option<InterfaceType>, Sizes), Arc<Fmu>>;

impl LoadedComponent {
    fn new(component: &Component, system: &Description, fmus: &mut Fmus) -> Result<Self> {
        let mut open = |sizes| {
            open(component, system, sizes, fmus)
                .with_context(|| format!("component {}", component.name))
        };
        let full = |name: &str| format!("{}.{name}", component.name);
        let mut fmu = open(Sizes::new())?;
        let mut sizes = Sizes::new();
        for (name, value) in &component.start {
            // Names of other elements may exist only with these sizes.
            let Some(scalar) = fmu.scalar(name) else { continue };
            if fmu.variable(scalar).causality == Causality::StructuralParameter {
                let value = start(&fmu, scalar, &full(name), value)?;
                sizes.extend(value.as_whole().map(|size| (name.clone(), size)));
            }
        }
        if !sizes.is_empty() {
            fmu = open(sizes)?;
        }
        let mut starts = Vec::new();
        for (name, value) in &component.start {
            for Assigned { scalar, name, value } in assigned(&fmu, name, &full(name), value)? {
                starts.push((scalar, start(&fmu, scalar, &name, &value)?));
            }
        }
        Ok(Self {
            name: component.name.clone(),
            prefix: format!("{}.", component.name),
            sampled: component.sampled.unwrap_or_else(|| is_sampled(&fmu)),
            is_guess: component.sampled.is_none() && component.function.is_none(),
            tolerance: component.tolerance.or(system.tolerance).or(fmu.tolerance),
            starts,
            fmu,
        })
    }

    /// Whether the master integrates its equations.
    pub(crate) fn integrates(&self) -> bool {
        self.fmu.interface_type == InterfaceType::ModelExchange
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

    /// Checks that arrays of which elements are set can be set as a whole.
    ///
    /// # Errors
    /// An element is not set, and the FMU has no start value for it, as its description belongs to a
    /// smaller array.
    pub(crate) fn check_arrays(&self, starts: &BTreeMap<usize, &Value>) -> Result<()> {
        let is_missing = |i: &usize| self.fmu.start(*i).is_none() && !starts.contains_key(i);
        let mut checked = None;
        for scalar in starts.keys() {
            let mut array = self.fmu.array(*scalar);
            if array.len() > 1
                && checked.replace(array.start) != Some(array.start)
                && let Some(missing) = array.find(is_missing)
            {
                bail!(
                    "{} cannot be set without {}, for which the FMU has no start value",
                    self.name_of(*scalar),
                    self.name_of(missing)
                );
            }
        }
        Ok(())
    }
}

fn open(
    component: &Component,
    system: &Description,
    sizes: Sizes,
    fmus: &mut Fmus,
) -> Result<Arc<Fmu>> {
    if let Some(function) = &component.function {
        let variables = function.variables(&component.name, system.step)?;
        return Ok(Arc::new(Fmu::of_function(&component.fmu, function, variables)));
    }
    let key = (component.fmu.clone(), component.interface, sizes);
    if let Some(fmu) = fmus.get(&key) {
        return Ok(fmu.clone());
    }
    let fmu = Arc::new(Fmu::open(&component.fmu, component.interface, &key.2, system.sandbox)?);
    fmus.insert(key, fmu.clone());
    Ok(fmu)
}

/// Whether all outputs are discrete, as in a sampled controller.
fn is_sampled(fmu: &Fmu) -> bool {
    let outputs = fmu.variables.iter().filter(|v| v.causality == Causality::Output);
    let mut outputs = outputs.peekable();
    outputs.peek().is_some() && outputs.all(|v| v.variability == Variability::Discrete)
}

/// What a scalar gets, which messages show by this name.
pub(crate) struct Assigned<'a> {
    pub(crate) scalar: usize,
    pub(crate) name: Cow<'a, str>,
    pub(crate) value: Cow<'a, Literal>,
}

/// What a scalar gets, or each element of an array, by a value that messages show as one for `full`.
///
/// # Errors
/// There is no such variable, or the shapes differ.
pub(crate) fn assigned<'a>(
    fmu: &Fmu,
    name: &str,
    full: &'a str,
    value: &'a Literal,
) -> Result<Vec<Assigned<'a>>> {
    let found = |error: Error| if name == full { error } else { error.context(full.to_owned()) };
    if fmu.scalar(name).is_some() || !value.is_array() {
        let scalar = fmu.find(name).map_err(found)?;
        return Ok(vec![Assigned { scalar, name: full.into(), value: Cow::Borrowed(value) }]);
    }
    let scalars = fmu.find_all(name).map_err(found)?;
    let values = value.elements(&fmu.variable(scalars.start).dimensions, full)?;
    let element = |(scalar, value)| {
        let name = format!("{full}{}", &fmu.name(scalar)[name.len()..]);
        Assigned { scalar, name: name.into(), value: Cow::Owned(value) }
    };
    Ok(scalars.zip(values).map(element).collect())
}

fn start(fmu: &Fmu, scalar: usize, name: &str, value: &Literal) -> Result<Value> {
    if let Some(reason) = fmu.unusable(scalar) {
        bail!("{name} = {value} cannot be set: {reason}");
    }
    let variable = fmu.variable(scalar);
    let has_start = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
    ensure!(
        variable.causality == Causality::Input
            || variable.is_parameter()
            || (has_start && variable.variability != Variability::Constant),
        "{name} = {value} cannot be set: only inputs, parameters, and variables with initial exact or approx have start values"
    );
    value.typed(variable, name)
}

/// The indices of the components by what the names of their variables begin with.
pub(crate) struct Names(HashMap<String, usize>);

impl Names {
    fn new(components: &[LoadedComponent]) -> Self {
        let prefixes = components.iter().map(|component| component.prefix.clone());
        Self(prefixes.zip(0..).collect())
    }

    /// The component of a name; of several, the one with the longest name.
    fn find(&self, name: &str) -> Option<usize> {
        let mut ends = name.rmatch_indices('.').map(|(dot, _)| dot + 1).chain([0]);
        ends.find_map(|end| self.0.get(&name[..end]).copied())
    }

    /// Finds `component.variable`, or the variable of a single FMU.
    pub(crate) fn port(&self, components: &[LoadedComponent], name: &str) -> Result<ScalarId> {
        let (component, scalar) = resolve(components, self, name, Fmu::find)?;
        Ok(ScalarId { component, scalar })
    }
}

/// Finds the component of a name, and in its FMU what the name stands for.
fn resolve<T>(
    components: &[LoadedComponent],
    owners: &Names,
    name: &str,
    find: impl Fn(&Fmu, &str) -> Result<T>,
) -> Result<(usize, T)> {
    if let Some(index) = owners.find(name) {
        let LoadedComponent { prefix, fmu, .. } = &components[index];
        let found = find(fmu, &name[prefix.len()..]);
        let found = if prefix.is_empty() { found } else { found.with_context(|| name.to_owned()) };
        return Ok((index, found?));
    }
    // The end of a name, as pid.kp of controller.pid.kp.
    let end = format!(".{name}");
    let longer = all(components).map(|port| port.name(components));
    let longer = Vec::from_iter(longer.filter(|longer| longer.ends_with(&end)).take(3));
    let did_you_mean = format!("did you mean {}?", longer.join(" or "));
    let Some((component, _)) = name.split_once('.') else {
        let hint = if longer.is_empty() { String::new() } else { format!("; {did_you_mean}") };
        bail!("{name:?} is not of the form component.variable{hint}");
    };
    let names = Vec::from_iter(components.iter().map(|c| c.name.as_str()));
    let known = match similar(component, names.iter().copied()).first() {
        Some(name) => format!("did you mean {name}?"),
        None if !longer.is_empty() => did_you_mean,
        None => format!("the components are {}", names.join(", ")),
    };
    bail!("{name}: there is no component {component:?}; {known}")
}

/// Checks a tolerance, which `key` names.
fn tolerance(key: &str, tolerance: Option<f64>) -> Result<()> {
    match tolerance {
        Some(value) if !(value > 0.0 && value.is_finite()) => {
            bail!("{key} = {value} is invalid, expected a positive number")
        }
        _ => Ok(()),
    }
}

/// The recorded variables, and the names of their columns: a variable may be recorded by its name and aliases.
fn recorded(
    components: &[LoadedComponent],
    owners: &Names,
    names: &[String],
) -> Result<Vec<(ScalarId, String)>> {
    if names.is_empty() {
        // Strings and Binaries only on request.
        let is_recorded = |port: &ScalarId| {
            let variable = port.of(components);
            variable.causality == Causality::Output
                && !matches!(variable.of_type, Type::String | Type::Binary)
                && unrecordable(components, port).is_none()
        };
        let recorded = all(components).filter(is_recorded);
        return Ok(recorded.map(|port| (port, port.name(components))).collect());
    }
    let (mut ports, mut found) = (Vec::new(), HashSet::new());
    for name in names {
        let (component, scalars) = resolve(components, owners, name, Fmu::find_all)?;
        let LoadedComponent { prefix, fmu, .. } = &components[component];
        for scalar in scalars {
            let port = ScalarId { component, scalar };
            if let Some(reason) = unrecordable(components, &port) {
                bail!("{name} cannot be recorded: {reason}");
            }
            let name = format!("{prefix}{}", fmu.name_as(&name[prefix.len()..], scalar));
            ensure!(found.insert(name.clone()), "{name} is recorded twice");
            ports.push((port, name));
        }
    }
    Ok(ports)
}

/// The number of variables that a note names.
const NAMED: usize = 8;

/// Says which components were taken for sampled ones, and what could be recorded if nothing is.
fn notes(components: &[LoadedComponent], recorded: &[ScalarId]) -> Vec<String> {
    let mut notes = Vec::new();
    let is_noted = |index: usize| {
        let LoadedComponent { sampled, is_guess, .. } = &components[index];
        *sampled && *is_guess && recorded.iter().any(|port| port.component == index)
    };
    let guessed = (0..components.len()).filter(|index| is_noted(*index));
    let guessed = Vec::from_iter(guessed.map(|index| components[index].name.as_str()));
    if !guessed.is_empty() {
        notes.push(format!(
            "sampled, because all outputs are discrete: {}; --sampled false records the outputs before each step, not after it",
            guessed.join(", ")
        ));
    }
    let in_sandbox = components.iter().filter(|c| c.fmu.is_component()).map(|c| c.name.as_str());
    let in_sandbox = Vec::from_iter(in_sandbox);
    if !in_sandbox.is_empty() {
        notes.push(format!("run as WebAssembly components: {}", in_sandbox.join(", ")));
    }
    if recorded.is_empty() {
        let mut all =
            Vec::from_iter(all(components).filter(|p| unrecordable(components, p).is_none()));
        all.sort_by_key(|port| port.of(components).causality != Causality::Output);
        let names = all.iter().take(NAMED);
        let names = names.map(|port| {
            let kind = port.of(components).of_type;
            let version = components[port.component].fmu.version;
            format!("{} ({})", port.name(components), kind.name(version))
        });
        let mut names = Vec::from_iter(names);
        if all.len() > NAMED {
            names.push(format!("and {} more", all.len() - NAMED));
        }
        notes.push(match names.is_empty() {
            true => "nothing is recorded, because no variable can be recorded".to_owned(),
            false => format!(
                "nothing is recorded, because no output is a number or Boolean; --output can record {}",
                names.join(", ")
            ),
        });
    }
    notes
}

/// The variables of all components.
fn all(components: &[LoadedComponent]) -> impl Iterator<Item = ScalarId> {
    let all = components.iter().enumerate();
    all.flat_map(|(component, planned)| {
        (0..planned.fmu.scalars.len()).map(move |scalar| ScalarId { component, scalar })
    })
}

fn unrecordable(components: &[LoadedComponent], port: &ScalarId) -> Option<&'static str> {
    components[port.component].fmu.unrecordable(port.scalar)
}

/// Checks that every connection leads from an output to a matching input, and that no input is
/// connected twice.
fn links_fit(components: &[LoadedComponent], links: &[ResolvedConnection]) -> Result<()> {
    let mut fed = HashSet::new();
    for link in links {
        let fmu = |port: ScalarId| &components[port.component].fmu;
        for (port, expected) in [(link.from, Causality::Output), (link.to, Causality::Input)] {
            let name = port.name(components);
            if let Some(reason) = fmu(port).unusable(port.scalar) {
                bail!("{name} cannot be connected: {reason}");
            }
            let actual = port.of(components).causality;
            ensure!(
                actual == expected,
                "{name} is connected as {}, but is {}",
                text(expected),
                text(actual)
            );
        }
        let (from, to) = (link.from.of(components), link.to.of(components));
        let [a, b] = [link.from, link.to].map(|port| port.name(components));
        ensure!(
            class(from.of_type) == class(to.of_type),
            "{a} ({}) cannot feed {b} ({}): the types differ",
            from.of_type.name(fmu(link.from).version),
            to.of_type.name(fmu(link.to).version)
        );
        ensure!(
            from.of_type != Type::String,
            "{a} is a String; connections carry numbers and Booleans"
        );
        ensure!(
            link.conversion.is_none() || from.of_type.is_float(),
            "{a} cannot feed {b} with a factor: both must be real numbers"
        );
        ensure!(
            link.faults.is_empty() || from.of_type.is_float(),
            "{a} cannot feed {b} with faults: both must be real numbers"
        );
        if let (Some(one), Some(other), None) = (&from.unit, &to.unit, link.conversion) {
            ensure!(
                fmu(link.from).same_unit(one, fmu(link.to), other),
                "{a} [{one}] cannot feed {b} [{other}]: the units differ; give the connection a factor to convert them"
            );
        }
        ensure!(fed.insert(link.to), "{b} is connected twice");
    }
    Ok(())
}

/// The type that stands for all that a variable may feed: numbers of different size are converted.
fn class(kind: Type) -> Type {
    match kind {
        kind if kind.is_float() => Type::Float64,
        kind if kind.is_integer() || kind == Type::Enumeration => Type::Int64,
        other => other,
    }
}

pub(crate) fn text(causality: Causality) -> &'static str {
    match causality {
        Causality::Input => "an input",
        Causality::Output => "an output",
        Causality::Parameter => "a parameter",
        Causality::CalculatedParameter => "a calculated parameter",
        Causality::Local => "a local variable",
        Causality::Independent => "the time",
        Causality::StructuralParameter => "a structural parameter",
    }
}

/// Rejects loops of outputs that each depend directly on the next, which no order of stepping can
/// solve. An output without declared dependencies counts as depending on no input, since most such
/// outputs change only during a step.
fn no_algebraic_loops(components: &[LoadedComponent], links: &[ResolvedConnection]) -> Result<()> {
    // All elements of an array depend on the same inputs.
    let variable = |port: ScalarId| ScalarId {
        scalar: components[port.component].fmu.first(port.scalar),
        ..port
    };
    let mut feeding: HashMap<ScalarId, Vec<ScalarId>> = HashMap::new();
    for link in links {
        feeding.entry(variable(link.to)).or_default().push(link.from);
    }
    let sources = |output: ScalarId| {
        let known = &components[output.component].fmu.feedthrough;
        let inputs = known.get(&variable(output).scalar).into_iter().flatten();
        let inputs = inputs.map(|&scalar| ScalarId { scalar, ..output });
        let sources = inputs.filter_map(|input| feeding.get(&input)).flatten().copied();
        Vec::from_iter(sources).into_iter()
    };
    // The outputs on the way, with those that feed them and are not yet followed.
    let mut path = Vec::new();
    let (mut followed, mut settled) = (HashSet::new(), HashSet::new());
    for link in links {
        let mut next = Some(link.from);
        loop {
            if let Some(output) = next.filter(|output| !settled.contains(&variable(*output))) {
                if !followed.insert(variable(output)) {
                    let ports = path.iter().map(|(port, _)| *port);
                    let ports = ports.skip_while(|port| variable(*port) != variable(output));
                    let ports = Vec::from_iter(ports.chain([output]));
                    let names = ports.iter().rev().map(|port| port.name(components));
                    bail!(
                        "algebraic loop in which each output depends directly on the previous one: {}; parallel order breaks the loop with a delay of one step, and allow_algebraic_loops = true runs it anyway",
                        Vec::from_iter(names).join(" -> ")
                    );
                }
                path.push((output, sources(output)));
            }
            let Some((output, rest)) = path.last_mut() else { break };
            next = rest.next();
            if next.is_none() {
                settled.insert(variable(*output));
                path.pop();
            }
        }
    }
    Ok(())
}
