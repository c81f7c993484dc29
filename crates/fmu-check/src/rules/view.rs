//! What the rules see of a model description, whatever its version; invalid parts are left out.

use std::collections::HashMap;

use fmu_description::value::{items, real, unsigned, unsigneds};
use fmu_description::xml::Element;
use fmu_description::{Causality, FmiVersion, Initial, Variability};

/// A model description.
pub struct Model<'a> {
    pub root: &'a Element<'a>,
    pub version: FmiVersion,
    /// The variables; `None` for an invalid one, so that indices stay correct.
    pub variables: Vec<Option<Variable<'a>>>,
    /// Indices from 1 by value reference; for FMI 3.0, whose references are unique.
    by_reference: HashMap<u32, usize>,
    pub outputs: Vec<Unknown<'a>>,
    pub derivatives: Vec<Unknown<'a>>,
    pub clocked_states: Vec<Unknown<'a>>,
    pub initial_unknowns: Vec<Unknown<'a>>,
    pub event_indicators: Vec<Unknown<'a>>,
}

/// A variable.
pub struct Variable<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// The element with the start value and the bounds, which is the same in FMI 3.0.
    pub value: &'a Element<'a>,
    /// The element of its declared type that has the bounds, if defined.
    pub declared: Option<&'a Element<'a>>,
    pub name: &'a str,
    pub kind: Kind,
    pub reference: u32,
    /// A structural parameter counts as a parameter, for which the same rules apply.
    pub causality: Causality,
    pub variability: Variability,
    /// The attribute, or the default of the standard; `None` for clocks.
    pub initial: Option<Initial>,
}

/// The type of a variable, without the size of numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    Float,
    Integer,
    Boolean,
    String,
    Binary,
    Enumeration,
    Clock,
}

/// An unknown of the model structure.
pub struct Unknown<'a> {
    pub element: &'a Element<'a>,
    /// The index or value reference of the variable.
    pub number: u32,
    /// Index of the variable from 1, if there is one.
    pub index: Option<usize>,
    /// Indices or value references of the variables that it depends on; `None` means all.
    pub dependencies: Option<Vec<u32>>,
}

impl Kind {
    /// The kind of a variable with an element of this name.
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "Real" | "Float32" | "Float64" => Self::Float,
            "Integer" | "Int8" | "UInt8" | "Int16" | "UInt16" | "Int32" | "UInt32" | "Int64"
            | "UInt64" => Self::Integer,
            "Boolean" => Self::Boolean,
            "String" => Self::String,
            "Binary" => Self::Binary,
            "Enumeration" => Self::Enumeration,
            "Clock" => Self::Clock,
            _ => return None,
        })
    }
}

impl<'a> Model<'a> {
    /// Reads a model description.
    pub fn new(root: &'a Element<'a>, version: FmiVersion) -> Self {
        let mut model = Self {
            root,
            version,
            variables: Vec::new(),
            by_reference: HashMap::new(),
            outputs: Vec::new(),
            derivatives: Vec::new(),
            clocked_states: Vec::new(),
            initial_unknowns: Vec::new(),
            event_indicators: Vec::new(),
        };
        let types: HashMap<_, _> = (model.types())
            .filter_map(|(defined, value)| Some((defined.attribute("name")?, value)))
            .collect();
        model.variables = (root.child("ModelVariables").into_iter())
            .flat_map(|list| &list.children)
            .filter(|child| version == FmiVersion::Fmi3 || child.name == "ScalarVariable")
            .map(|element| Variable::read(element, version, &types))
            .collect();
        for (index, variable) in (1..).zip(&model.variables) {
            if let Some(variable) = variable {
                model
                    .by_reference
                    .entry(variable.reference)
                    .or_insert(index);
            }
        }
        let structure = root.child("ModelStructure");
        let unknowns = |in_2: &str, in_3: &str| -> Vec<_> {
            let elements: Vec<_> = match (structure, version) {
                (None, _) => Vec::new(),
                (Some(structure), FmiVersion::Fmi2) => structure.list(in_2, "Unknown").collect(),
                (Some(structure), FmiVersion::Fmi3) => structure.children(in_3).collect(),
            };
            let unknowns = elements.into_iter();
            unknowns
                .filter_map(|element| model.unknown(element))
                .collect()
        };
        let lists = [
            unknowns("Outputs", "Output"),
            unknowns("Derivatives", "ContinuousStateDerivative"),
            unknowns("", "ClockedState"),
            unknowns("InitialUnknowns", "InitialUnknown"),
            unknowns("", "EventIndicator"),
        ];
        [
            model.outputs,
            model.derivatives,
            model.clocked_states,
            model.initial_unknowns,
            model.event_indicators,
        ] = lists;
        model
    }

    /// The types: the element with the name, and the one with the bounds.
    pub fn types(&self) -> impl Iterator<Item = (&'a Element<'a>, &'a Element<'a>)> + use<'a> {
        let version = self.version;
        let types = self.root.child("TypeDefinitions");
        (types.into_iter().flat_map(|types| &types.children)).filter_map(move |defined| {
            match version {
                FmiVersion::Fmi2 => Some((defined, defined.children.first()?)),
                FmiVersion::Fmi3 => Some((defined, defined)),
            }
        })
    }

    /// The valid variables with their indices from 1.
    pub fn variables(&self) -> impl Iterator<Item = (usize, &Variable<'a>)> {
        (1..)
            .zip(&self.variables)
            .filter_map(|(index, v)| Some((index, v.as_ref()?)))
    }

    /// The elements of the valid variables.
    pub fn elements(&self) -> impl Iterator<Item = &'a Element<'a>> {
        self.variables().map(|(_, variable)| variable.element)
    }

    /// The index from 1 of the variable with an index or value reference.
    pub fn index(&self, number: u32) -> Option<usize> {
        match self.version {
            FmiVersion::Fmi2 => {
                let index = number as usize;
                (1..=self.variables.len()).contains(&index).then_some(index)
            }
            FmiVersion::Fmi3 => self.by_reference.get(&number).copied(),
        }
    }

    /// The variable with the given index, from 1.
    pub fn variable(&self, index: Option<usize>) -> Option<&Variable<'a>> {
        self.variables.get(index?.checked_sub(1)?)?.as_ref()
    }

    /// The variable that an attribute refers to.
    pub fn referred(&self, element: &Element<'_>, attribute: &str) -> Option<&Variable<'a>> {
        self.variable(self.index(unsigned(element.attribute(attribute)?)?))
    }

    /// What variables are referred to by, for messages.
    pub fn expected(&self) -> String {
        match self.version {
            FmiVersion::Fmi2 => format!("the index of a variable, 1 to {}", self.variables.len()),
            FmiVersion::Fmi3 => "the value reference of a variable".into(),
        }
    }

    /// Names of the types of real numbers, for messages.
    pub fn float(&self) -> &'static str {
        match self.version {
            FmiVersion::Fmi2 => "Real",
            FmiVersion::Fmi3 => "Float32 or Float64",
        }
    }

    /// A numeric attribute of the default experiment.
    pub fn experiment(&self, name: &str) -> Option<f64> {
        real(self.root.child("DefaultExperiment")?.attribute(name)?)
    }

    fn unknown(&self, element: &'a Element<'a>) -> Option<Unknown<'a>> {
        let name = match self.version {
            FmiVersion::Fmi2 => "index",
            FmiVersion::Fmi3 => "valueReference",
        };
        let number = unsigned(element.attribute(name)?)?;
        Some(Unknown {
            element,
            number,
            index: self.index(number),
            dependencies: element.attribute("dependencies").and_then(unsigneds),
        })
    }
}

impl<'a> Variable<'a> {
    fn read(
        element: &'a Element<'a>,
        version: FmiVersion,
        types: &HashMap<&str, &'a Element<'a>>,
    ) -> Option<Self> {
        let value = match version {
            FmiVersion::Fmi2 => {
                (element.children.iter()).find(|child| Kind::of(child.name).is_some())?
            }
            FmiVersion::Fmi3 => element,
        };
        let kind = Kind::of(value.name)?;
        let causality = match element.attribute("causality") {
            None => Causality::Local,
            Some("structuralParameter") if version == FmiVersion::Fmi3 => Causality::Parameter,
            Some(word) => Causality::parse(word)?,
        };
        let variability = match element.attribute("variability") {
            None if version == FmiVersion::Fmi2 => Variability::Continuous,
            None if is_parameter(causality) => Variability::Fixed,
            None if kind != Kind::Float => Variability::Discrete,
            None => Variability::Continuous,
            Some(word) => Variability::parse(word)?,
        };
        let initial = match element.attribute("initial").and_then(Initial::parse) {
            Some(initial) => Some(initial),
            None if kind == Kind::Clock => None,
            None if version == FmiVersion::Fmi3 && causality == Causality::Input => {
                Some(Initial::Exact)
            }
            None => Initial::default_for(causality, variability),
        };
        Some(Self {
            element,
            value,
            declared: value
                .attribute("declaredType")
                .and_then(|name| types.get(name).copied()),
            name: element.attribute("name")?,
            kind,
            reference: unsigned(element.attribute("valueReference")?)?,
            causality,
            variability,
            initial,
        })
    }

    /// The start value, or all of an array, as written; of FMI 3.0, texts and bytes are elements.
    pub fn start(&self) -> Option<&'a str> {
        match self.value.child("Start") {
            Some(start) => Some(start.attribute("value").unwrap_or_default()),
            None => self.value.attribute("start"),
        }
    }

    /// The items of its start value, which is one if it is a scalar.
    pub fn starts(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        items(self.value.attribute("start").unwrap_or_default())
    }

    /// Its unit or that of its declared type.
    pub fn unit(&self) -> Option<&'a str> {
        self.inherited("unit")
    }

    /// An attribute of the variable, or else of its declared type.
    pub fn inherited(&self, name: &str) -> Option<&'a str> {
        let own = self.value.attribute(name);
        own.or_else(|| self.declared?.attribute(name))
    }

    /// Whether it is tied to clocks.
    pub fn is_clocked(&self) -> bool {
        self.element.attribute("clocks").is_some()
    }
}

/// Whether a variable keeps its value in a simulation, unless a host changes it.
fn is_parameter(causality: Causality) -> bool {
    matches!(
        causality,
        Causality::Parameter | Causality::CalculatedParameter
    )
}
