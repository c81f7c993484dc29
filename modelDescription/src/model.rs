//! A typed view of a model description that tolerates invalid parts.

use std::collections::HashMap;

use anyhow::{Result, bail, ensure};

use crate::value::{boolean, integer, real, unsigned, unsigneds};
use crate::xml::{Element, quote};
use crate::{Capability, Causality, Initial, Variability, VariableType};

/// A model description of FMI 2.0.
pub struct ModelDescription<'a> {
    /// Its root element.
    pub root: &'a Element<'a>,
    /// The variables; `None` for an invalid one, so that indices stay correct.
    pub variables: Vec<Option<ScalarVariable<'a>>>,
    /// `Outputs` of the model structure.
    pub outputs: Vec<Unknown<'a>>,
    /// `Derivatives` of the model structure.
    pub derivatives: Vec<Unknown<'a>>,
    /// `InitialUnknowns` of the model structure.
    pub initial_unknowns: Vec<Unknown<'a>>,
}

/// A `ScalarVariable`.
pub struct ScalarVariable<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// The element of its type, which has the start value and the bounds.
    pub value: &'a Element<'a>,
    /// The element of its declared type, if defined.
    pub declared: Option<&'a Element<'a>>,
    /// Its name.
    pub name: &'a str,
    /// Its type.
    pub kind: VariableType,
    /// Its value reference.
    pub reference: u32,
    /// What determines its value.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// How it is initialized: the attribute, or the default of the standard.
    pub initial: Option<Initial>,
}

/// An `Unknown` of the model structure.
pub struct Unknown<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// Index of the variable, from 1.
    pub index: usize,
    /// Indices of the variables that it depends on; `None` means all.
    pub dependencies: Option<Vec<u32>>,
}

impl<'a> ModelDescription<'a> {
    /// Reads a model description; parts that are invalid are left out.
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

    /// Reads a model description of FMI 2.0; parts that are invalid are left out.
    ///
    /// # Errors
    /// The document is not a model description of FMI 2.0.
    pub fn read(root: &'a Element<'a>) -> Result<Self> {
        let name = root.name;
        ensure!(
            name == "fmiModelDescription",
            "the root element is {}, expected fmiModelDescription",
            quote(name)
        );
        if let Some(version) = Self::other_version(root) {
            bail!(version);
        }
        Ok(Self::new(root))
    }

    /// Says so if a model description is of another version of FMI.
    pub fn other_version(root: &Element<'_>) -> Option<String> {
        let version = root.attribute("fmiVersion").unwrap_or("2.0");
        let is_number = version.bytes().all(|b| b.is_ascii_digit() || b == b'.');
        let shown = match is_number {
            true => version.to_owned(),
            false => quote(version),
        };
        (root.name == "fmiModelDescription" && version != "2.0")
            .then(|| format!("it is of FMI version {shown}, expected 2.0"))
    }

    /// Name of the model.
    pub fn name(&self) -> &'a str {
        self.root.attribute("modelName").unwrap_or_default()
    }

    /// The valid variables with their indices from 1.
    pub fn variables(&self) -> impl Iterator<Item = (usize, &ScalarVariable<'a>)> {
        (1..)
            .zip(&self.variables)
            .filter_map(|(index, v)| Some((index, v.as_ref()?)))
    }

    /// The variable with the given index, from 1.
    pub fn variable(&self, index: usize) -> Option<&ScalarVariable<'a>> {
        self.variables.get(index.checked_sub(1)?)?.as_ref()
    }

    /// The `CoSimulation` element, if the FMU supports co-simulation.
    pub fn co_simulation(&self) -> Option<&'a Element<'a>> {
        self.root.child("CoSimulation")
    }

    /// A numeric attribute of the default experiment.
    pub fn experiment(&self, name: &str) -> Option<f64> {
        real(self.root.child("DefaultExperiment")?.attribute(name)?)
    }
}

impl<'a> ScalarVariable<'a> {
    /// The start value, as written.
    pub fn start(&self) -> Option<&'a str> {
        self.value.attribute("start")
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

    /// Names and values of the items of an enumeration.
    pub fn items(&self) -> impl Iterator<Item = (&'a str, i32)> + use<'a> {
        let declared = self.declared.into_iter();
        declared
            .flat_map(|of_type| of_type.children("Item"))
            .filter_map(item)
    }
}

/// Name and value of an `Item` of an enumeration.
pub fn item<'a>(item: &'a Element<'a>) -> Option<(&'a str, i32)> {
    Some((item.attribute("name")?, integer(item.attribute("value")?)?))
}

impl Capability {
    /// Whether an element such as `CoSimulation` declares the capability.
    pub fn is_claimed_by(self, element: &Element<'_>) -> bool {
        let flag = element.attribute(self.as_str());
        flag.and_then(boolean).unwrap_or(false)
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
) -> Option<ScalarVariable<'a>> {
    let (kind, value) = VariableType::ALL
        .iter()
        .find_map(|kind| Some((*kind, element.child(kind.as_str())?)))?;
    let causality = match element.attribute("causality") {
        None => Causality::Local,
        Some(word) => Causality::parse(word)?,
    };
    let variability = match element.attribute("variability") {
        None => Variability::Continuous,
        Some(word) => Variability::parse(word)?,
    };
    let initial = element.attribute("initial").and_then(Initial::parse);
    Some(ScalarVariable {
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
        initial: initial.or_else(|| Initial::default_for(causality, variability)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::xml::parse;

    fn error(text: &str) -> String {
        let root = parse(text).unwrap();
        ModelDescription::read(&root).err().expect(text).to_string()
    }

    #[test]
    fn documents_that_are_not_valid_model_descriptions_are_rejected() {
        assert!(error("<a/>").contains("\"a\", expected fmiModelDescription"));
        let of_fmi_3 = "<fmiModelDescription fmiVersion='3.0'/>";
        assert_eq!(error(of_fmi_3), "it is of FMI version 3.0, expected 2.0");
        let other = "<fmiModelDescription fmiVersion='&#10;'/>";
        assert_eq!(error(other), "it is of FMI version \"\\n\", expected 2.0");
    }

    #[test]
    fn invalid_variables_are_left_out() {
        for bad in [
            "<ScalarVariable name='a' valueReference='0'/>",
            "<ScalarVariable name='a'><Real/></ScalarVariable>",
            "<ScalarVariable name='a' valueReference='-1'><Real/></ScalarVariable>",
            "<ScalarVariable name='a' valueReference='0' causality='x'><Real/></ScalarVariable>",
        ] {
            let text = format!(
                "<fmiModelDescription fmiVersion='2.0'><ModelVariables>{bad}
                <ScalarVariable name='b' valueReference='1'><Real/></ScalarVariable>
                </ModelVariables></fmiModelDescription>"
            );
            let root = parse(&text).unwrap();
            let model = ModelDescription::read(&root).unwrap();
            let variables: Vec<_> = model.variables().map(|(i, v)| (i, v.name)).collect();
            assert_eq!(variables, [(2, "b")]);
        }
    }

    #[test]
    fn variables_inherit_defaults_from_the_standard_and_their_types() {
        let text = "<fmiModelDescription fmiVersion='2.0'>
            <TypeDefinitions>
            <SimpleType name='Force'><Real unit='N' max='9'/></SimpleType>
            <SimpleType name='Way'><Enumeration><Item name='left' value='3'/></Enumeration></SimpleType>
            </TypeDefinitions><ModelVariables>
            <ScalarVariable name='f' valueReference='0'><Real declaredType='Force' max='5'/></ScalarVariable>
            <ScalarVariable name='w' valueReference='0' causality='parameter' variability='fixed'>
            <Enumeration declaredType='Way' start='3'/></ScalarVariable>
            </ModelVariables></fmiModelDescription>";
        let root = parse(text).unwrap();
        let model = ModelDescription::read(&root).unwrap();
        let (f, w) = (model.variable(1).unwrap(), model.variable(2).unwrap());
        assert_eq!(
            (f.causality, f.variability),
            (Causality::Local, Variability::Continuous)
        );
        assert_eq!(
            (f.initial, w.initial),
            (Some(Initial::Calculated), Some(Initial::Exact))
        );
        assert_eq!((f.unit(), f.inherited("max")), (Some("N"), Some("5")));
        assert_eq!(w.items().collect::<Vec<_>>(), [("left", 3)]);
        assert!(model.variable(0).is_none() && model.variable(3).is_none());
    }
}
