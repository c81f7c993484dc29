//! A model description as the rules see it: what could be read, without what could not.

use std::collections::HashMap;

use crate::archive::MODEL_DESCRIPTION;
use crate::text::quote;
use crate::value::{real, unsigned, unsigneds};
use crate::xml::Element;

/// Who gives a variable its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Causality {
    /// The user, before the simulation or while it runs.
    Parameter,
    /// Computed from parameters.
    CalculatedParameter,
    /// Another model.
    Input,
    /// Computed, for other models.
    Output,
    /// Computed, for the curious.
    Local,
    /// The time.
    Independent,
}

/// When a variable may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variability {
    /// Never.
    Constant,
    /// Not after the initialization.
    Fixed,
    /// Between steps, by the user.
    Tunable,
    /// At events.
    Discrete,
    /// At any time.
    Continuous,
}

/// How a variable gets its first value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Initial {
    /// It is the start value.
    Exact,
    /// The start value is a guess.
    Approx,
    /// It is computed.
    Calculated,
}

/// The type of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// `Real`
    Real,
    /// `Integer`
    Integer,
    /// `Boolean`
    Boolean,
    /// `String`
    String,
    /// `Enumeration`
    Enumeration,
}

/// Where an element is.
pub fn place(element: &Element<'_>) -> String {
    format!("{MODEL_DESCRIPTION}:{}", element.line)
}

/// A `ScalarVariable`.
pub struct Variable<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// The element of its type.
    pub value: &'a Element<'a>,
    /// The element of its declared type, if that is defined.
    pub of_type: Option<&'a Element<'a>>,
    /// Its name.
    pub name: &'a str,
    /// Its type.
    pub kind: Kind,
    /// Its value reference.
    pub reference: Option<u32>,
    /// Who gives it its value.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// How it gets its first value: as written, or what the standard takes for it. Inputs and the
    /// independent variable have none.
    pub initial: Option<Initial>,
}

impl Variable<'_> {
    /// The start value, as written.
    pub fn start(&self) -> Option<&str> {
        self.value.attribute("start")
    }

    /// The unit, its own or that of its type.
    pub fn unit(&self) -> Option<&str> {
        let own = self.value.attribute("unit");
        own.or_else(|| self.of_type?.attribute("unit"))
    }

    /// Where it is, for a finding.
    pub fn place(&self) -> String {
        format!("{}: {}", place(self.element), quote(self.name))
    }
}

/// An `Unknown` of the model structure.
pub struct Unknown<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// Index of the variable, from 1.
    pub index: usize,
    /// Indices of the variables that it depends on; none written means all.
    pub dependencies: Option<Vec<u32>>,
}

/// A model description.
pub struct Model<'a> {
    /// Its root element.
    pub root: &'a Element<'a>,
    /// The variables; `None` in the place of one that cannot be read, so that indices stay right.
    pub variables: Vec<Option<Variable<'a>>>,
    /// `Outputs` of the model structure.
    pub outputs: Vec<Unknown<'a>>,
    /// `Derivatives` of the model structure.
    pub derivatives: Vec<Unknown<'a>>,
    /// `InitialUnknowns` of the model structure.
    pub initial_unknowns: Vec<Unknown<'a>>,
}

impl<'a> Model<'a> {
    /// Reads what can be read.
    pub fn new(root: &'a Element<'a>) -> Self {
        let unknowns = |list: &str| {
            let structure = root.child("ModelStructure");
            structure
                .into_iter()
                .flat_map(|structure| structure.list(list, "Unknown"))
                .filter_map(unknown)
                .collect()
        };
        let types: HashMap<_, _> = root
            .list("TypeDefinitions", "SimpleType")
            .filter_map(|defined| Some((defined.attribute("name")?, defined.children.first()?)))
            .collect();
        Self {
            root,
            variables: root
                .list("ModelVariables", "ScalarVariable")
                .map(|element| variable(element, &types))
                .collect(),
            outputs: unknowns("Outputs"),
            derivatives: unknowns("Derivatives"),
            initial_unknowns: unknowns("InitialUnknowns"),
        }
    }

    /// The variables that could be read, with their indices from 1.
    pub fn variables(&self) -> impl Iterator<Item = (usize, &Variable<'a>)> {
        (1..)
            .zip(&self.variables)
            .filter_map(|(index, v)| Some((index, v.as_ref()?)))
    }

    /// The variable of an index from 1.
    pub fn variable(&self, index: usize) -> Option<&Variable<'a>> {
        self.variables.get(index.checked_sub(1)?)?.as_ref()
    }

    /// A number of the default experiment.
    pub fn experiment(&self, name: &str) -> Option<f64> {
        real(self.root.child("DefaultExperiment")?.attribute(name)?)
    }
}

fn unknown<'a>(element: &'a Element<'a>) -> Option<Unknown<'a>> {
    Some(Unknown {
        element,
        index: unsigned(element.attribute("index")?)? as usize,
        dependencies: element.attribute("dependencies").and_then(unsigneds),
    })
}

fn variable<'a>(
    element: &'a Element<'a>,
    types: &HashMap<&str, &'a Element<'a>>,
) -> Option<Variable<'a>> {
    let (kind, value) = [
        ("Real", Kind::Real),
        ("Integer", Kind::Integer),
        ("Boolean", Kind::Boolean),
        ("String", Kind::String),
        ("Enumeration", Kind::Enumeration),
    ]
    .into_iter()
    .find_map(|(name, kind)| Some((kind, element.child(name)?)))?;
    let causality = match element.attribute("causality") {
        Some("parameter") => Causality::Parameter,
        Some("calculatedParameter") => Causality::CalculatedParameter,
        Some("input") => Causality::Input,
        Some("output") => Causality::Output,
        None | Some("local") => Causality::Local,
        Some("independent") => Causality::Independent,
        Some(_) => return None,
    };
    let variability = match element.attribute("variability") {
        Some("constant") => Variability::Constant,
        Some("fixed") => Variability::Fixed,
        Some("tunable") => Variability::Tunable,
        Some("discrete") => Variability::Discrete,
        None | Some("continuous") => Variability::Continuous,
        Some(_) => return None,
    };
    let initial = match element.attribute("initial") {
        Some("exact") => Some(Initial::Exact),
        Some("approx") => Some(Initial::Approx),
        Some("calculated") => Some(Initial::Calculated),
        _ => default_initial(causality, variability),
    };
    Some(Variable {
        element,
        value,
        of_type: value
            .attribute("declaredType")
            .and_then(|name| types.get(name).copied()),
        name: element.attribute("name")?,
        kind,
        reference: element.attribute("valueReference").and_then(unsigned),
        causality,
        variability,
        initial,
    })
}

/// What `initial` means when it is not written (FMI 2.0.4, section 2.2.7).
fn default_initial(causality: Causality, variability: Variability) -> Option<Initial> {
    match (causality, variability) {
        (Causality::Input | Causality::Independent, _) => None,
        (Causality::Parameter, _) | (_, Variability::Constant) => Some(Initial::Exact),
        _ => Some(Initial::Calculated),
    }
}
