//! Generates model descriptions from the interface of a model.

mod fmi2;
mod fmi3;
mod terminals;
#[cfg(test)]
mod tests;

use anyhow::{Result, anyhow, ensure};

use crate::table::indexed;
use crate::unit::{self, Unit};
use crate::xml::Element;
use crate::{Causality, Dynamics, Initial, IntegerKind, LOG_CATEGORIES, Variability};

/// The interface of a model, read from its binary; see [`read_interfaces`](crate::read_interfaces).
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// Name of the model and its `modelIdentifier`: a C identifier.
    pub name: String,
    /// Description of the model.
    pub description: String,
    /// GUID of the interface.
    pub guid: String,
    /// Whether it has a sample time.
    pub is_sampled: bool,
    /// Whether it is described by differential or algebraic equations, which a host can solve.
    pub is_continuous: bool,
    /// Stop time and step size of the default experiment (s), which starts at 0.
    pub default_experiment: (f64, f64),
    /// Relative tolerance of its integrator; 0 if it has none.
    pub tolerance: f64,
    /// The variables.
    pub variables: Vec<VariableDescription>,
}

/// A variable; see [`Variable`](crate::Variable).
#[derive(Debug, Clone, PartialEq)]
pub struct VariableDescription {
    /// Full name, without an index.
    pub name: String,
    /// A short description.
    pub description: String,
    /// What determines its value.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// Whether the host may set its time derivative.
    pub has_input_derivative: bool,
    /// Its part in the differential equations; a derivative has the value reference of its state.
    pub dynamics: Dynamics<usize>,
    /// Numbers of elements of an array; empty for a scalar.
    pub dimensions: Vec<usize>,
    /// Value reference of the structural parameter that is the number of elements in use, the first ones
    /// of an array; `None` if all are.
    pub size: Option<usize>,
    /// Value references of the variables that its value after initialization depends on; of an array,
    /// that of the first element.
    pub initially_from: Vec<usize>,
    /// Value references of the inputs and states with respect to which its derivatives are known, and on
    /// no others of which it depends; of an array, that of the first element.
    pub depends_on: Vec<usize>,
    /// Its terminal, and its name there, as `terminal.member`; empty if it is in none.
    pub terminal: String,
    /// Type, start values and bounds.
    pub of_type: Type,
}

/// The type of a variable; see [`Domain`](crate::Domain).
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "as in `Domain`")]
pub enum Type {
    Real {
        single: bool,
        min: f64,
        max: f64,
        unit: String,
        start: Vec<f64>,
    },
    Integer {
        kind: IntegerKind,
        min: i128,
        max: i128,
        start: Vec<i128>,
    },
    Boolean {
        start: Vec<bool>,
    },
    String {
        start: Vec<String>,
    },
    Binary {
        mime_type: String,
        start: Vec<Vec<u8>>,
    },
    Enumeration {
        name: String,
        description: String,
        /// Number, name and description of each item.
        items: Vec<(i32, String, String)>,
        start: Vec<i32>,
    },
}

/// A version of FMI.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
#[allow(missing_docs, reason = "their names say it")]
pub enum FmiVersion {
    #[default]
    Fmi2,
    Fmi3,
}

impl FmiVersion {
    /// All versions.
    pub const ALL: [Self; 2] = [Self::Fmi2, Self::Fmi3];

    /// The version of a model description; `None` if it is another one. All versions 3.x have the same
    /// interface (FMI 3.0.2, section 2.4.1).
    pub fn of(root: &Element<'_>) -> Option<Self> {
        match root.attribute("fmiVersion") {
            None | Some("2.0") => Some(Self::Fmi2),
            Some(version) => version.starts_with("3.").then_some(Self::Fmi3),
        }
    }

    /// Its number.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Fmi2 => "2.0",
            Self::Fmi3 => "3.0",
        }
    }
}

impl Type {
    /// Keeps the first start values.
    fn truncate(&mut self, count: usize) {
        match self {
            Self::Real { start, .. } => start.truncate(count),
            Self::Integer { start, .. } => start.truncate(count),
            Self::Boolean { start } => start.truncate(count),
            Self::String { start } => start.truncate(count),
            Self::Binary { start, .. } => start.truncate(count),
            Self::Enumeration { start, .. } => start.truncate(count),
        }
    }
}

/// Where a model comes from.
#[derive(Debug, Clone, Default)]
pub struct Origin {
    /// Version of the model.
    pub version: String,
    /// Authors, separated by commas.
    pub author: Option<String>,
    /// Copyright notice.
    pub copyright: Option<String>,
    /// SPDX expression.
    pub license: Option<String>,
    /// The tool that generated the FMU.
    pub generation_tool: String,
}

impl VariableDescription {
    /// Number of scalar variables it represents.
    pub fn count(&self) -> usize {
        self.dimensions.iter().product()
    }

    /// The name of an element, such as `w[1,2]` or `der(x[2])`.
    pub fn element_name(&self, element: usize) -> String {
        indexed(&self.name, &self.dimensions, element)
    }

    fn is_output(&self) -> bool {
        self.causality == Causality::Output
    }

    /// Whether it is a continuous state. Events may change any, which the attribute `reinit` tells.
    fn is_state(&self) -> bool {
        matches!(self.dynamics, Dynamics::State { .. })
    }

    fn is_derivative(&self) -> bool {
        matches!(self.dynamics, Dynamics::Derivative { .. })
    }

    fn is_event_indicator(&self) -> bool {
        self.dynamics == Dynamics::EventIndicator
    }

    /// Whether it is an output that may change at any time.
    fn is_continuous_output(&self) -> bool {
        self.is_output() && self.variability == Variability::Continuous
    }

    /// Whether what is computed during initialization may depend on it.
    fn is_initially_known(&self) -> bool {
        matches!(self.causality, Causality::Input | Causality::Parameter)
            || self.is_state() && self.initial() == Some(Initial::Exact)
    }

    /// Whether it is computed during initialization and listed as an initial unknown.
    fn is_initial_unknown(&self) -> bool {
        self.initial() == Some(Initial::Calculated)
            && (self.is_output() || self.is_state() || self.is_derivative())
    }

    fn has_start(&self) -> bool {
        match &self.of_type {
            Type::Real { start, .. } => !start.is_empty(),
            Type::Integer { start, .. } => !start.is_empty(),
            Type::Enumeration { start, .. } => !start.is_empty(),
            Type::Boolean { start } => !start.is_empty(),
            Type::String { start } => !start.is_empty(),
            Type::Binary { start, .. } => !start.is_empty(),
        }
    }

    /// The attribute `initial`; inputs have none.
    fn initial(&self) -> Option<Initial> {
        match Initial::default_for(self.causality, self.variability) {
            Some(Initial::Calculated) if self.has_start() => Some(Initial::Exact),
            initial => initial,
        }
    }
}

/// Builds the definition of an enumeration from its name, its description and its items.
type Definition = fn(&str, &str, Vec<Element<'static>>) -> Element<'static>;

/// A scalar variable: its value reference, its variable, and the index of the element.
type Scalar<'a> = (usize, &'a VariableDescription, usize);

impl Description {
    /// The scalar variables; their positions are their value references.
    pub fn scalars(&self) -> impl Iterator<Item = Scalar<'_>> {
        let elements = |v| (0..VariableDescription::count(v)).map(move |element| (v, element));
        let scalars = self.variables.iter().flat_map(elements);
        scalars
            .enumerate()
            .map(|(reference, (v, element))| (reference, v, element))
    }

    /// The number of elements of a variable that are in use by default: the start value of its
    /// structural parameter.
    pub fn elements(&self, v: &VariableDescription) -> usize {
        let size = v.size.and_then(|size| self.scalars().nth(size));
        match size.map(|(_, parameter, _)| &parameter.of_type) {
            Some(Type::Integer { start, .. }) => {
                let size = start.first().and_then(|size| usize::try_from(*size).ok());
                size.map_or(v.count(), |size| size.min(v.count()))
            }
            _ => v.count(),
        }
    }

    /// The variable of a value reference, and the index of the element.
    pub(crate) fn variable_mut(
        &mut self,
        reference: usize,
    ) -> Option<(&mut VariableDescription, usize)> {
        let mut element = reference;
        for variable in &mut self.variables {
            let count = variable.count();
            if element < count {
                return Some((variable, element));
            }
            element -= count;
        }
        None
    }

    /// Generates the model description of a version of FMI.
    ///
    /// # Errors
    /// See [`to_xml`](Self::to_xml) and [`to_xml_fmi3`](Self::to_xml_fmi3).
    pub fn to_xml_of(&self, version: FmiVersion, origin: &Origin) -> Result<Element<'static>> {
        match version {
            FmiVersion::Fmi2 => self.to_xml(origin),
            FmiVersion::Fmi3 => self.to_xml_fmi3(origin),
        }
    }

    /// The root element; `token` is the name of the attribute with the GUID.
    fn root(&self, version: FmiVersion, token: &'static str, origin: &Origin) -> Element<'static> {
        Element::new("fmiModelDescription")
            .with("fmiVersion", version.as_str())
            .with("modelName", &self.name)
            .with(token, &self.guid)
            .with("description", &self.description)
            .with_some("author", origin.author.as_ref())
            .with("version", &origin.version)
            .with_some("copyright", origin.copyright.as_ref())
            .with_some("license", origin.license.as_ref())
            .with("generationTool", &origin.generation_tool)
            .with("variableNamingConvention", "structured")
    }

    fn experiment(&self) -> Element<'static> {
        let (stop, step) = self.default_experiment;
        let tolerance = (self.tolerance > 0.0).then(|| format!("{:?}", self.tolerance));
        Element::new("DefaultExperiment")
            .with("startTime", 0)
            .with("stopTime", stop)
            .with_some("tolerance", tolerance)
            .with("stepSize", step)
    }

    fn units(&self) -> Result<Vec<Element<'static>>> {
        let mut definitions = Vec::new();
        for variable in &self.variables {
            if let Type::Real { unit, .. } = &variable.of_type
                && !unit.is_empty()
            {
                let definition = unit_definition(unit)?;
                if !definitions.contains(&definition) {
                    definitions.push(definition);
                }
            }
        }
        Ok(definitions)
    }

    /// The definitions of enumerations, from their name, description and items.
    fn types(&self, definition: Definition) -> Result<Vec<Element<'static>>> {
        let mut definitions: Vec<Element<'static>> = Vec::new();
        for variable in &self.variables {
            if let Type::Enumeration {
                name,
                description,
                items,
                ..
            } = &variable.of_type
            {
                let definition = definition(name, description, items.iter().map(item).collect());
                let other = definitions
                    .iter()
                    .find(|d| d.attribute("name") == Some(name));
                ensure!(
                    other.is_none_or(|other| *other == definition),
                    "two enumerations of {} have the name {name}; expected different names",
                    self.name
                );
                if other.is_none() {
                    definitions.push(definition);
                }
            }
        }
        Ok(definitions)
    }

    /// Whether a host can solve the model by model exchange: by its equations, or at its sample instants.
    fn is_for_model_exchange(&self) -> bool {
        self.is_continuous || self.is_sampled
    }

    /// Value references of the inputs and states that a scalar depends on at a communication point or an
    /// event, in ascending order; `None` if it may depend on all. Of an array, that of the first element.
    ///
    /// Outputs of a model without equations change in steps and at sample instants only, and never
    /// depend on an input at the same instant, so that importers see no false algebraic loops.
    fn dependencies(&self, &(reference, v, _): &Scalar<'_>) -> Option<Vec<usize>> {
        let is_held = !self.is_continuous || v.variability != Variability::Continuous;
        match v.dynamics {
            Dynamics::State { .. } => Some(vec![reference]),
            _ if v.is_output() && is_held => Some(Vec::new()),
            _ => known(&v.depends_on),
        }
    }

    /// Value references of the variables that determine a scalar's value after the initialization;
    /// `None` if all may do. Of an array, that of the first element.
    fn initial_dependencies(&self, (_, v, _): &Scalar<'_>) -> Option<Vec<usize>> {
        match self.is_continuous && v.initially_from.is_empty() {
            true => None,
            false => Some(sorted(&v.initially_from)),
        }
    }

    /// Whether the derivatives of all that a host integrates are known: those of the state derivatives and
    /// the continuous outputs.
    fn has_all_derivatives(&self) -> bool {
        let is_unknown = |v: &&VariableDescription| {
            v.is_derivative() || v.is_continuous_output() && !v.is_state()
        };
        let mut unknowns = self.variables.iter().filter(is_unknown).peekable();
        self.is_continuous
            && unknowns.peek().is_some()
            && unknowns.all(|v| !v.depends_on.is_empty())
    }

    /// Whether derivatives of an output are known.
    fn has_output_derivatives(&self) -> bool {
        (self.variables.iter()).any(|v| v.is_output() && !v.depends_on.is_empty())
    }

    /// Order of the time derivatives of outputs that a slave provides: the derivatives of states are
    /// known.
    fn max_output_derivative_order(&self) -> u32 {
        let mut outputs = (self.variables.iter())
            .filter(|v| v.is_continuous_output())
            .peekable();
        let is_known = outputs.peek().is_some() && outputs.all(VariableDescription::is_state);
        u32::from(self.is_continuous && is_known)
    }
}

fn unit_definition(name: &str) -> Result<Element<'static>> {
    let unit = Unit::parse(name).map_err(|error| anyhow!("the unit {name:?}: {error}"))?;
    let base = unit::BASE
        .into_iter()
        .zip(unit.exponents)
        .filter(|(_, exponent)| *exponent != 0)
        .fold(Element::new("BaseUnit"), |base, (name, exponent)| {
            base.with(name, exponent)
        })
        .with_some("factor", (unit.factor != 1.0).then_some(unit.factor))
        .with_some("offset", (unit.offset != 0.0).then_some(unit.offset));
    let display = Unit::display(name).map(|(name, factor)| {
        Element::new("DisplayUnit")
            .with("name", name)
            .with("factor", factor)
    });
    Ok(Element::new("Unit")
        .with("name", name)
        .holding(base)
        .holding_all(display))
}

fn item((value, name, description): &(i32, String, String)) -> Element<'static> {
    Element::new("Item")
        .with("name", name)
        .with("value", value)
        .with("description", description)
}

fn log_categories() -> Element<'static> {
    Element::new("LogCategories").holding_all(LOG_CATEGORIES.map(log_category))
}

fn log_category((name, description): (&std::ffi::CStr, &str)) -> Element<'static> {
    Element::new("Category")
        .with("name", name.to_string_lossy())
        .with("description", description)
}

/// The nominal value of a state that differs from the default.
fn nominal(dynamics: &Dynamics<usize>) -> Option<f64> {
    match dynamics {
        Dynamics::State { nominal } if *nominal != 1.0 => Some(*nominal),
        _ => None,
    }
}

/// The value reference of the state of a derivative; of arrays, that of the first element.
fn state(dynamics: &Dynamics<usize>) -> Option<usize> {
    match dynamics {
        Dynamics::Derivative { of } => Some(*of),
        _ => None,
    }
}

/// A real number as text; one of single precision in the fewest digits that give it back.
fn real(value: f64, single: bool) -> String {
    match single {
        true => (value as f32).to_string(),
        false => value.to_string(),
    }
}

/// A list as the value of an attribute.
fn list<T: ToString>(items: &[T]) -> String {
    let items: Vec<_> = items.iter().map(T::to_string).collect();
    items.join(" ")
}

/// The value references, if any are given.
fn known(references: &[usize]) -> Option<Vec<usize>> {
    (!references.is_empty()).then(|| sorted(references))
}

fn sorted(references: &[usize]) -> Vec<usize> {
    let mut sorted = references.to_vec();
    sorted.sort_unstable();
    sorted.dedup();
    sorted
}
