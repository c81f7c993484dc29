//! A typed view of a model description that tolerates invalid parts.

use std::collections::HashMap;

use anyhow::{Result, bail, ensure};

use crate::table::indexed;
use crate::value::{boolean, items, real, unsigned, unsigneds, whole};
use crate::xml::{Element, quote};
use crate::{Capability, Causality, FmiVersion, Initial, Variability, VariableType};

/// A model description of FMI 2.0 or 3.0.
pub struct ModelDescription<'a> {
    /// Its root element.
    pub root: &'a Element<'a>,
    /// Its version of FMI.
    pub version: FmiVersion,
    /// The variables; `None` for an invalid one, so that indices stay correct.
    pub variables: Vec<Option<ScalarVariable<'a>>>,
    /// `Outputs` of the model structure; in FMI 3.0 `Output`.
    pub outputs: Vec<Unknown<'a>>,
    /// `Derivatives` of the model structure; in FMI 3.0 `ContinuousStateDerivative`.
    pub derivatives: Vec<Unknown<'a>>,
    /// `ClockedState` of the model structure of FMI 3.0.
    pub clocked_states: Vec<Unknown<'a>>,
    /// `InitialUnknowns` of the model structure; in FMI 3.0 `InitialUnknown`.
    pub initial_unknowns: Vec<Unknown<'a>>,
    /// `EventIndicator` of the model structure of FMI 3.0.
    pub event_indicators: Vec<Unknown<'a>>,
}

/// A `ScalarVariable`, or a variable of FMI 3.0, which may be an array.
pub struct ScalarVariable<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// The element of its type, which has the start value and the bounds; in FMI 3.0 its own.
    pub value: &'a Element<'a>,
    /// The element of its declared type, if defined.
    pub declared: Option<&'a Element<'a>>,
    /// Its name.
    pub name: &'a str,
    /// Its type.
    pub kind: VariableType,
    /// Its value reference.
    pub reference: u32,
    /// What determines its value; that of a structural parameter is `Parameter`.
    pub causality: Causality,
    /// Whether it is a structural parameter, which sizes arrays (FMI 3.0.2, section 2.4.7.5).
    pub is_structural: bool,
    /// When it may change.
    pub variability: Variability,
    /// How it is initialized: the attribute, or the default of the standard; `None` for clocks.
    pub initial: Option<Initial>,
    /// Numbers of elements of an array, with structural parameters at their start values; empty for a
    /// scalar.
    pub dimensions: Vec<usize>,
}

/// An unknown of the model structure.
pub struct Unknown<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// Index of the variable, from 1, also in FMI 3.0, whose model structure has value references.
    pub index: usize,
    /// Indices of the variables that it depends on; `None` means all.
    pub dependencies: Option<Vec<u32>>,
}

impl<'a> ModelDescription<'a> {
    /// Reads a model description; parts that are invalid are left out.
    pub fn new(root: &'a Element<'a>) -> Self {
        let version = FmiVersion::of(root).unwrap_or_default();
        let list = |name| (root.child(name).into_iter()).flat_map(|list| &list.children);
        let types: HashMap<_, _> = list("TypeDefinitions")
            .filter_map(|defined| {
                let value = match version {
                    FmiVersion::Fmi2 => defined.children.first()?,
                    FmiVersion::Fmi3 => defined,
                };
                Some((defined.attribute("name")?, value))
            })
            .collect();
        let sizes: HashMap<_, _> = list("ModelVariables").filter_map(size).collect();
        let variables: Vec<_> = list("ModelVariables")
            .filter(|child| version == FmiVersion::Fmi3 || child.name == "ScalarVariable")
            .map(|element| variable(element, version, &types, &sizes))
            .collect();
        let indices = (1..)
            .zip(&variables)
            .filter_map(|(index, v)| Some((v.as_ref()?.reference, index)));
        let indices: HashMap<u32, usize> = indices.collect();
        let unknowns = |in_2: &str, in_3: &str| -> Vec<_> {
            let structure = root.child("ModelStructure").into_iter();
            match version {
                FmiVersion::Fmi2 => structure
                    .flat_map(|structure| structure.list(in_2, "Unknown"))
                    .filter_map(by_index)
                    .collect(),
                FmiVersion::Fmi3 => structure
                    .flat_map(|structure| structure.children(in_3))
                    .filter_map(|element| by_reference(element, &indices))
                    .collect(),
            }
        };
        Self {
            root,
            version,
            outputs: unknowns("Outputs", "Output"),
            derivatives: unknowns("Derivatives", "ContinuousStateDerivative"),
            clocked_states: unknowns("", "ClockedState"),
            initial_unknowns: unknowns("InitialUnknowns", "InitialUnknown"),
            event_indicators: unknowns("", "EventIndicator"),
            variables,
        }
    }

    /// Reads a model description of FMI 2.0 or 3.0; parts that are invalid are left out.
    ///
    /// # Errors
    /// The document is not a model description of FMI 2.0 or 3.0.
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
        if root.name != "fmiModelDescription" || FmiVersion::of(root).is_some() {
            return None;
        }
        let version = root.attribute("fmiVersion").unwrap_or_default();
        let is_number = version.bytes().all(|b| b.is_ascii_digit() || b == b'.');
        let shown = match is_number {
            true => version.to_owned(),
            false => quote(version),
        };
        Some(format!("it is of FMI version {shown}, expected 2.0 or 3.0"))
    }

    /// The GUID, which is the instantiation token in FMI 3.0.
    pub fn token(&self) -> &'a str {
        let name = match self.version {
            FmiVersion::Fmi2 => "guid",
            FmiVersion::Fmi3 => "instantiationToken",
        };
        self.root.attribute(name).unwrap_or_default()
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

    /// The `ModelExchange` element, if the FMU supports model exchange.
    pub fn model_exchange(&self) -> Option<&'a Element<'a>> {
        self.root.child("ModelExchange")
    }

    /// The `ScheduledExecution` element, if the FMU supports it; FMI 3.0 only.
    pub fn scheduled_execution(&self) -> Option<&'a Element<'a>> {
        self.root.child("ScheduledExecution")
    }

    /// A numeric attribute of the default experiment.
    pub fn experiment(&self, name: &str) -> Option<f64> {
        real(self.root.child("DefaultExperiment")?.attribute(name)?)
    }
}

impl<'a> ScalarVariable<'a> {
    /// The start value, as written; of an array, all or the first.
    pub fn start(&self) -> Option<&'a str> {
        match self.value.child("Start") {
            Some(start) => start.attribute("value"),
            None => self.value.attribute("start"),
        }
    }

    /// The start values of all elements, as written: one for a scalar, none if there are none.
    pub fn starts(&self) -> Vec<&'a str> {
        if self.is_element_type() {
            let starts = self.value.children("Start");
            return starts.filter_map(|s| s.attribute("value")).collect();
        }
        match self.start() {
            None => Vec::new(),
            Some(start) if self.dimensions.is_empty() => vec![start],
            Some(start) => items(start).collect(),
        }
    }

    /// Whether its start values are elements rather than an attribute.
    fn is_element_type(&self) -> bool {
        let has_own_type = std::ptr::eq(self.element, self.value);
        has_own_type && matches!(self.kind, VariableType::String | VariableType::Binary)
    }

    /// Number of elements; 1 for a scalar.
    pub fn count(&self) -> usize {
        self.dimensions.iter().product()
    }

    /// The name of an element of an array, such as `w[1,2]`, from its name or an alias.
    pub fn element_name(&self, name: &str, element: usize) -> String {
        indexed(name, &self.dimensions, element)
    }

    /// Other names of the variable (FMI 3.0.2, section 2.4.7.6).
    pub fn aliases(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        let aliases = self.element.children("Alias");
        aliases.filter_map(|alias| alias.attribute("name"))
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
    pub fn items(&self) -> impl Iterator<Item = (&'a str, i64)> + use<'a> {
        let declared = self.declared.into_iter();
        declared
            .flat_map(|of_type| of_type.children("Item"))
            .filter_map(item)
    }
}

/// Name and value of an `Item` of an enumeration.
pub fn item<'a>(item: &'a Element<'a>) -> Option<(&'a str, i64)> {
    Some((item.attribute("name")?, whole(item.attribute("value")?)?))
}

impl Capability {
    /// Whether an element such as `CoSimulation` declares the capability.
    pub fn is_claimed_by(self, element: &Element<'_>) -> bool {
        let flag = element.attribute(self.as_str());
        flag.and_then(boolean).unwrap_or(false)
    }
}

fn by_index<'a>(element: &'a Element<'a>) -> Option<Unknown<'a>> {
    Some(Unknown {
        element,
        index: unsigned(element.attribute("index")?)? as usize,
        dependencies: element.attribute("dependencies").and_then(unsigneds),
    })
}

/// An unknown of FMI 3.0; value references that no variable has are left out.
fn by_reference<'a>(
    element: &'a Element<'a>,
    indices: &HashMap<u32, usize>,
) -> Option<Unknown<'a>> {
    let dependencies = element.attribute("dependencies").and_then(unsigneds);
    let indices_of = |references: Vec<u32>| {
        let known = references.iter().filter_map(|r| indices.get(r));
        known.map(|index| *index as u32).collect()
    };
    Some(Unknown {
        element,
        index: *indices.get(&unsigned(element.attribute("valueReference")?)?)?,
        dependencies: dependencies.map(indices_of),
    })
}

/// Value reference and start value of a structural parameter.
fn size<'a>(element: &'a Element<'a>) -> Option<(u32, usize)> {
    if element.attribute("causality") != Some(STRUCTURAL) {
        return None;
    }
    let reference = unsigned(element.attribute("valueReference")?)?;
    Some((reference, whole(element.attribute("start")?)?))
}

/// Numbers of elements of a variable of FMI 3.0, if they and their product are valid.
fn dimensions(element: &Element<'_>, sizes: &HashMap<u32, usize>) -> Option<Vec<usize>> {
    let sizes: Option<Vec<usize>> = (element.children("Dimension"))
        .map(|dimension| match dimension.attribute("start") {
            Some(start) => whole(start),
            None => {
                let reference = unsigned(dimension.attribute("valueReference")?)?;
                sizes.get(&reference).copied()
            }
        })
        .collect();
    let sizes = sizes?;
    let mut all = sizes.iter();
    all.try_fold(1_usize, |count, size| count.checked_mul(*size))?;
    Some(sizes)
}

const STRUCTURAL: &str = "structuralParameter";

fn variable<'a>(
    element: &'a Element<'a>,
    version: FmiVersion,
    types: &HashMap<&str, &'a Element<'a>>,
    sizes: &HashMap<u32, usize>,
) -> Option<ScalarVariable<'a>> {
    let (kind, value) = match version {
        FmiVersion::Fmi2 => VariableType::of(version)
            .find_map(|kind| Some((kind, element.child(kind.as_str())?)))?,
        FmiVersion::Fmi3 => {
            let kind = VariableType::of(version).find(|kind| kind.as_str() == element.name);
            (kind?, element)
        }
    };
    let is_3 = version == FmiVersion::Fmi3;
    let word = element.attribute("causality");
    let is_structural = is_3 && word == Some(STRUCTURAL);
    let causality = match word {
        None => Causality::Local,
        Some(_) if is_structural => Causality::Parameter,
        Some(word) => Causality::parse(word)?,
    };
    let is_parameter = matches!(
        causality,
        Causality::Parameter | Causality::CalculatedParameter
    );
    let variability = match element.attribute("variability") {
        None if is_3 && is_parameter => Variability::Fixed,
        None if is_3 && !kind.is_float() => Variability::Discrete,
        None => Variability::Continuous,
        Some(word) => Variability::parse(word)?,
    };
    let initial = element.attribute("initial").and_then(Initial::parse);
    let default = match causality {
        _ if kind == VariableType::Clock => None,
        Causality::Input if is_3 => Some(Initial::Exact),
        _ => Initial::default_for(causality, variability),
    };
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
        is_structural,
        variability,
        initial: initial.or(default),
        dimensions: match version {
            FmiVersion::Fmi2 => Vec::new(),
            FmiVersion::Fmi3 => dimensions(element, sizes)?,
        },
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
        for (version, shown) in [
            ("1.0", "1.0"),
            ("30", "30"),
            ("4.0", "4.0"),
            ("3", "3"),
            ("&#10;", "\"\\n\""),
        ] {
            assert_eq!(
                error(&format!("<fmiModelDescription fmiVersion='{version}'/>")),
                format!("it is of FMI version {shown}, expected 2.0 or 3.0")
            );
        }
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

    const OF_FMI_3: &str = "<fmiModelDescription fmiVersion='3.0.2' instantiationToken='{1}'>
        <CoSimulation modelIdentifier='M'/>
        <TypeDefinitions>
        <Float64Type name='Force' unit='N' max='9'/>
        <EnumerationType name='Way'><Item name='far' value='5000000000'/></EnumerationType>
        </TypeDefinitions><ModelVariables>
        <UInt64 name='n' valueReference='7' causality='structuralParameter' start='3'/>
        <Float64 name='f' valueReference='10' causality='output' declaredType='Force'/>
        <Float32 name='w' valueReference='20' causality='input' start='1 2 3  4 5 6'>
        <Dimension start='2'/><Dimension valueReference='7'/><Alias name='v'/></Float32>
        <Real name='r' valueReference='11'/>
        <Enumeration name='e' valueReference='30' declaredType='Way' causality='parameter' start='5000000000'/>
        <String name='s' valueReference='31'><Start value='a b'/></String>
        <Binary name='b' valueReference='32'><Start value='00fF'/></Binary>
        <Clock name='c' valueReference='33' causality='input' intervalVariability='triggered'/>
        <Float64 name='x' valueReference='34'><Dimension valueReference='8'/></Float64>
        <Float64 name='y' valueReference='34'><Dimension start='5000000000'/><Dimension start='5000000000'/></Float64>
        </ModelVariables><ModelStructure>
        <Output valueReference='10' dependencies='20 99'/>
        <Output valueReference='99'/>
        <InitialUnknown valueReference='10'/>
        <EventIndicator valueReference='20'/>
        </ModelStructure></fmiModelDescription>";

    #[test]
    fn variables_of_fmi_3_have_their_own_types_defaults_and_dimensions() {
        let root = parse(OF_FMI_3).unwrap();
        let model = ModelDescription::read(&root).unwrap();
        assert_eq!((model.version, model.token()), (FmiVersion::Fmi3, "{1}"));
        assert!(model.co_simulation().is_some() && model.model_exchange().is_none());
        // Real is of FMI 2.0; x is sized by nothing, and the size of y overflows.
        let names: Vec<_> = model.variables().map(|(i, v)| (i, v.name)).collect();
        let expected = ["n", "f", "w", "", "e", "s", "b", "c"];
        let expected: Vec<_> = (1..).zip(expected).filter(|(i, _)| *i != 4).collect();
        assert_eq!(names, expected);

        let of = |index| {
            let v: &ScalarVariable<'_> = model.variable(index).unwrap();
            (v.kind, v.causality, v.variability, v.initial)
        };
        use {Causality as C, Initial as I, Variability as V, VariableType as T};
        for (index, expected) in [
            (1, (T::UInt64, C::Parameter, V::Fixed, Some(I::Exact))),
            (
                2,
                (T::Float64, C::Output, V::Continuous, Some(I::Calculated)),
            ),
            (3, (T::Float32, C::Input, V::Continuous, Some(I::Exact))),
            (5, (T::Enumeration, C::Parameter, V::Fixed, Some(I::Exact))),
            (6, (T::String, C::Local, V::Discrete, Some(I::Calculated))),
            (8, (T::Clock, C::Input, V::Discrete, None)),
        ] {
            assert_eq!(of(index), expected, "{index}");
        }
        let variable = |index| model.variable(index).unwrap();
        assert!(variable(1).is_structural && !variable(5).is_structural);
        let (f, w, e) = (variable(2), variable(3), variable(5));
        assert_eq!(
            (f.unit(), f.inherited("max"), f.count()),
            (Some("N"), Some("9"), 1)
        );
        assert_eq!((w.dimensions.as_slice(), w.count()), ([2, 3].as_slice(), 6));
        assert_eq!(
            (w.element_name("w", 0), w.element_name("w", 5)),
            ("w[1,1]".into(), "w[2,3]".into())
        );
        assert_eq!(w.starts(), ["1", "2", "3", "4", "5", "6"]);
        assert_eq!(w.aliases().collect::<Vec<_>>(), ["v"]);
        assert_eq!(e.items().collect::<Vec<_>>(), [("far", 5_000_000_000)]);
        assert_eq!(
            (variable(6).starts(), variable(7).starts()),
            (vec!["a b"], vec!["00fF"])
        );
        assert!(f.starts().is_empty());
    }

    #[test]
    fn unknowns_of_fmi_3_have_the_indices_of_their_value_references() {
        let root = parse(OF_FMI_3).unwrap();
        let model = ModelDescription::read(&root).unwrap();
        let of = |list: &[Unknown<'_>]| -> Vec<_> {
            list.iter()
                .map(|u| (u.index, u.dependencies.clone()))
                .collect()
        };
        assert_eq!(of(&model.outputs), [(2, Some(vec![3]))]);
        assert_eq!(of(&model.initial_unknowns), [(2, None)]);
        assert_eq!(of(&model.event_indicators), [(3, None)]);
        assert!(model.derivatives.is_empty() && model.clocked_states.is_empty());
    }
}
