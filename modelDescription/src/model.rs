//! A typed view of a model description that tolerates invalid parts.

use std::collections::HashMap;
use std::ops::Deref;
use std::sync::Arc;

use anyhow::{Result, bail, ensure};

use crate::value::{items, real, unsigned, unsigneds, whole};
use crate::variable::{DeclaredType, Item, Variable};
use crate::xml::{Element, quote};
use crate::{Causality, FmiVersion, Initial, Type, Value, Variability};

/// A model description of FMI 2.0 or 3.0.
pub struct ModelDescription<'a> {
    /// Its root element.
    pub root: &'a Element<'a>,
    /// Its version of FMI.
    pub version: FmiVersion,
    /// The variables; `None` for an invalid one, so that indices stay correct.
    pub variables: Vec<Option<Listed<'a>>>,
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
    /// Indices from 1 by value reference; the first if several variables have the same.
    by_reference: HashMap<u32, usize>,
}

/// A variable of a model description, and its elements.
pub struct Listed<'a> {
    variable: Variable,
    /// Its element.
    pub element: &'a Element<'a>,
    /// The element that has the start value and the bounds; in FMI 3.0 its own.
    pub value: &'a Element<'a>,
    /// The element of its declared type, if defined.
    pub declared: Option<&'a Element<'a>>,
    /// Whether its dimensions are valid.
    is_sized: bool,
}

impl Deref for Listed<'_> {
    type Target = Variable;

    fn deref(&self) -> &Variable {
        &self.variable
    }
}

/// An unknown of the model structure.
pub struct Unknown<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// What it refers to a variable by: an index from 1, in FMI 3.0 a value reference.
    pub number: u32,
    /// Index of the variable from 1, if there is one.
    pub index: Option<usize>,
    /// The variables that it depends on, by numbers as its own; `None` means all.
    pub dependencies: Option<Vec<u32>>,
}

/// The defined types by name, each with the element that has its unit, bounds or items.
type Types<'a> = HashMap<&'a str, (&'a Element<'a>, Arc<DeclaredType>)>;
/// The sizes of arrays that are given by a variable, by its value reference.
type Sizes = HashMap<u32, usize>;

impl<'a> ModelDescription<'a> {
    /// Reads a model description; parts that are invalid are left out, but not variables whose dimensions
    /// are invalid.
    pub fn new(root: &'a Element<'a>) -> Self {
        let version = FmiVersion::named(root.attribute("fmiVersion")).unwrap_or_default();
        let mut model = Self {
            root,
            version,
            variables: Vec::new(),
            outputs: Vec::new(),
            derivatives: Vec::new(),
            clocked_states: Vec::new(),
            initial_unknowns: Vec::new(),
            event_indicators: Vec::new(),
            by_reference: HashMap::new(),
        };
        let types: Types<'_> = (model.types())
            .filter_map(|(defined, value)| {
                let name = defined.attribute("name")?;
                Some((name, (value, Arc::new(declared_type(defined, value)))))
            })
            .collect();
        let all = || (root.child("ModelVariables").into_iter()).flat_map(|list| &list.children);
        let sizes: Sizes = all().filter_map(size).collect();
        model.variables = all()
            .filter(|child| version == FmiVersion::Fmi3 || child.name == "ScalarVariable")
            .map(|element| Listed::read(element, version, &types, &sizes))
            .collect();
        for (index, variable) in (1..).zip(&model.variables) {
            if let Some(variable) = variable {
                let entry = model.by_reference.entry(variable.reference);
                entry.or_insert(index);
            }
        }
        let unknowns = |in_2: &str, in_3: &str| -> Vec<_> {
            let elements: Vec<_> = match (root.child("ModelStructure"), version) {
                (None, _) => Vec::new(),
                (Some(structure), FmiVersion::Fmi2) => structure.list(in_2, "Unknown").collect(),
                (Some(structure), FmiVersion::Fmi3) => structure.children(in_3).collect(),
            };
            let elements = elements.into_iter();
            elements.filter_map(|e| model.unknown(e)).collect()
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
        let mut model = Self::new(root);
        for variable in &mut model.variables {
            variable.take_if(|variable| !variable.is_sized);
        }
        Ok(model)
    }

    /// Says so if a model description is of another version of FMI.
    pub fn other_version(root: &Element<'_>) -> Option<String> {
        if root.name != "fmiModelDescription"
            || FmiVersion::named(root.attribute("fmiVersion")).is_some()
        {
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

    /// The defined types: the element with the name, and the one with the unit, the bounds or the items.
    pub fn types(&self) -> impl Iterator<Item = (&'a Element<'a>, &'a Element<'a>)> + use<'a> {
        let (root, version) = (self.root, self.version);
        let types = (root.child("TypeDefinitions").into_iter()).flat_map(|types| &types.children);
        types.filter_map(move |defined| match version {
            FmiVersion::Fmi2 => Some((defined, defined.children.first()?)),
            FmiVersion::Fmi3 => Some((defined, defined)),
        })
    }

    /// The defined enumerations.
    pub fn enumerations(&self) -> impl Iterator<Item = DeclaredType> + use<'a> {
        let types = self.types();
        let types = types.filter(|(_, value)| value.name.starts_with("Enumeration"));
        types.map(|(defined, value)| declared_type(defined, value))
    }

    /// The valid variables with their indices from 1.
    pub fn variables(&self) -> impl Iterator<Item = (usize, &Listed<'a>)> {
        (1..)
            .zip(&self.variables)
            .filter_map(|(index, v)| Some((index, v.as_ref()?)))
    }

    /// The index from 1 of the variable to which a number of the XML refers: the number itself in FMI 2.0, a
    /// value reference in FMI 3.0.
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
    pub fn variable(&self, index: impl Into<Option<usize>>) -> Option<&Listed<'a>> {
        self.variables.get(index.into()?.checked_sub(1)?)?.as_ref()
    }

    /// The variable to which an attribute refers.
    pub fn referred(&self, element: &Element<'_>, attribute: &str) -> Option<&Listed<'a>> {
        self.variable(self.index(unsigned(element.attribute(attribute)?)?))
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

impl<'a> Listed<'a> {
    fn read(
        element: &'a Element<'a>,
        version: FmiVersion,
        types: &Types<'a>,
        sizes: &Sizes,
    ) -> Option<Self> {
        let typed =
            |element: &'a Element<'a>| Some((Type::of_name(element.name, version)?, element));
        let (of_type, value) = match version {
            FmiVersion::Fmi2 => element.children.iter().find_map(typed)?,
            FmiVersion::Fmi3 => typed(element)?,
        };
        let is_3 = version == FmiVersion::Fmi3;
        let causality = match element.attribute("causality") {
            None => Causality::Local,
            Some(word) => Causality::parse(word)?,
        };
        let keeps_its_value = matches!(
            causality,
            Causality::Parameter | Causality::CalculatedParameter | Causality::StructuralParameter
        );
        let variability = match element.attribute("variability") {
            None if is_3 && keeps_its_value => Variability::Fixed,
            None if is_3 && !of_type.is_float() => Variability::Discrete,
            None => Variability::Continuous,
            Some(word) => Variability::parse(word)?,
        };
        let initial = element.attribute("initial").and_then(Initial::parse);
        let default = match causality {
            _ if of_type == Type::Clock => None,
            Causality::Input if is_3 => Some(Initial::Exact),
            _ => Initial::default_for(causality, variability),
        };
        let dimensions = match is_3 {
            true => dimensions(element, sizes),
            false => Some(Vec::new()),
        };
        let mut listed = Self {
            is_sized: dimensions.is_some(),
            variable: Variable {
                name: element.attribute("name")?.to_owned(),
                reference: unsigned(element.attribute("valueReference")?)?,
                description: element
                    .attribute("description")
                    .unwrap_or_default()
                    .to_owned(),
                of_type,
                causality,
                variability,
                initial: initial.or(default),
                dimensions: dimensions.unwrap_or_default(),
                ..Variable::default()
            },
            element,
            value,
            declared: None,
        };
        if let Some(name) = value.attribute("declaredType") {
            let defined = types.get(name);
            listed.declared = defined.map(|(value, _)| *value);
            let unknown = || {
                Arc::new(DeclaredType {
                    name: name.to_owned(),
                    ..DeclaredType::default()
                })
            };
            let of_type = defined.map_or_else(unknown, |(_, defined)| Arc::clone(defined));
            listed.variable.declared_type = Some(of_type);
        }
        let parse = |text: &str| Value::parse(of_type, text);
        let start: Option<_> = listed.starts().into_iter().map(parse).collect();
        let bound = |name| listed.inherited(name).and_then(parse);
        let (min, max) = (bound("min"), bound("max"));
        let text = |name| listed.inherited(name).map(str::to_owned);
        let (unit, mime_type) = (text("unit"), text("mimeType"));
        listed.variable = Variable {
            start: start.unwrap_or_default(),
            min,
            max,
            unit,
            mime_type,
            ..listed.variable
        };
        Some(listed)
    }

    /// The start value, as written; of an array, all or the first.
    pub fn start(&self) -> Option<&'a str> {
        match self.value.child("Start") {
            Some(start) => start.attribute("value"),
            None => self.value.attribute("start"),
        }
    }

    /// The start values of all elements, as written: one for a scalar, none if there are none.
    pub fn starts(&self) -> Vec<&'a str> {
        if self.has_start_elements() {
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
    fn has_start_elements(&self) -> bool {
        let has_own_type = std::ptr::eq(self.element, self.value);
        has_own_type && matches!(self.of_type, Type::String | Type::Binary)
    }

    /// Other names of the variable (FMI 3.0.2, section 2.4.7.6).
    pub fn aliases(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        let aliases = self.element.children("Alias");
        aliases.filter_map(|alias| alias.attribute("name"))
    }

    /// An attribute of the variable, or else of its declared type, as written.
    pub fn inherited(&self, name: &str) -> Option<&'a str> {
        let own = self.value.attribute(name);
        own.or_else(|| self.declared?.attribute(name))
    }
}

/// A defined type; `value` has its items.
fn declared_type(defined: &Element<'_>, value: &Element<'_>) -> DeclaredType {
    let text = |element: &Element<'_>, name| element.attribute(name).unwrap_or_default().to_owned();
    let items = value.children("Item").filter_map(|element| {
        Some(Item {
            name: element.attribute("name")?.to_owned(),
            value: whole(element.attribute("value")?)?,
            description: text(element, "description"),
        })
    });
    DeclaredType {
        name: text(defined, "name"),
        description: text(defined, "description"),
        items: items.collect(),
    }
}

/// Value reference and start value of what may size arrays: a structural parameter or a constant.
fn size(element: &Element<'_>) -> Option<(u32, usize)> {
    let is_constant = element.attribute("variability") == Some(Variability::Constant.as_str());
    let causality = Causality::StructuralParameter.as_str();
    if !is_constant && element.attribute("causality") != Some(causality) {
        return None;
    }
    let reference = unsigned(element.attribute("valueReference")?)?;
    Some((reference, whole(element.attribute("start")?)?))
}

/// Numbers of elements of a variable of FMI 3.0, if they and their product are valid.
fn dimensions(element: &Element<'_>, sizes: &Sizes) -> Option<Vec<usize>> {
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
            let variables: Vec<_> = model.variables().map(|(i, v)| (i, &*v.name)).collect();
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
        assert_eq!(
            (f.unit.as_deref(), &f.max),
            (Some("N"), &Some(Value::Float64(5.0)))
        );
        assert_eq!(items(w), [("left", 3)]);
        assert_eq!(w.start, [Value::Enumeration(3)]);
        assert!(model.variable(0).is_none() && model.variable(3).is_none());
    }

    fn items<'a>(v: &'a Listed<'_>) -> Vec<(&'a str, i64)> {
        let items = v.items().iter();
        items.map(|item| (&*item.name, item.value)).collect()
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
        let names: Vec<_> = model.variables().map(|(i, v)| (i, &*v.name)).collect();
        let expected = ["n", "f", "w", "", "e", "s", "b", "c"];
        let expected: Vec<_> = (1..).zip(expected).filter(|(i, _)| *i != 4).collect();
        assert_eq!(names, expected);

        let of = |index| {
            let v: &Listed<'_> = model.variable(index).unwrap();
            (v.of_type, v.causality, v.variability, v.initial)
        };
        use {Causality as C, Initial as I, Type as T, Variability as V};
        for (index, expected) in [
            (
                1,
                (T::UInt64, C::StructuralParameter, V::Fixed, Some(I::Exact)),
            ),
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
        let (f, w, e) = (variable(2), variable(3), variable(5));
        assert_eq!(
            (f.unit.as_deref(), f.inherited("max"), f.count()),
            (Some("N"), Some("9"), 1)
        );
        assert_eq!((w.dimensions.as_slice(), w.count()), ([2, 3].as_slice(), 6));
        assert_eq!(
            (w.element_name("w", 0), w.element_name("w", 5)),
            ("w[1,1]".into(), "w[2,3]".into())
        );
        assert_eq!(w.starts(), ["1", "2", "3", "4", "5", "6"]);
        assert_eq!(w.start_of(4), Some(&Value::Float32(5.0)));
        assert_eq!(w.aliases().collect::<Vec<_>>(), ["v"]);
        assert_eq!(items(e), [("far", 5_000_000_000)]);
        assert_eq!(variable(7).start, [Value::Binary(vec![0, 0xff])]);
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
                .map(|u| (u.number, u.index, u.dependencies.clone()))
                .collect()
        };
        let expected = [(10, Some(2), Some(vec![20, 99])), (99, None, None)];
        assert_eq!(of(&model.outputs), expected);
        assert_eq!(model.index(20), Some(3));
        assert_eq!(of(&model.initial_unknowns), [(10, Some(2), None)]);
        assert_eq!(of(&model.event_indicators), [(20, Some(3), None)]);
        assert!(model.derivatives.is_empty() && model.clocked_states.is_empty());
    }
}
