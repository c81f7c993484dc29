//! A typed view of a model description that tolerates invalid parts.

use std::collections::HashMap;
use std::ops::Deref;
use std::sync::Arc;

use anyhow::{Result, bail, ensure};

use crate::value::{boolean, items, real, unsigneds, whole};
use crate::variable::{DeclaredType, EnumerationItem, Variable};
use crate::words::{is_reserved_in_modelica, modelica_name};
use crate::xml::{Element, quote};
use crate::{
    Causality, ClockType, FmiVersion, Initial, IntervalVariability, Type, Value, Variability,
};

/// A model description of FMI 2.0 or 3.0.
pub struct ModelDescription<'a> {
    /// Its root element.
    pub root: &'a Element<'a>,
    /// Its version of FMI.
    pub version: FmiVersion,
    /// The variables; `None` for an invalid one, so that indices stay correct.
    pub variables: Vec<Option<XmlVariable<'a>>>,
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
pub struct XmlVariable<'a> {
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

impl Deref for XmlVariable<'_> {
    type Target = Variable;

    fn deref(&self) -> &Variable {
        &self.variable
    }
}

/// An unknown of the model structure.
pub struct Unknown<'a> {
    /// Its element.
    pub element: &'a Element<'a>,
    /// The number by which it refers to a variable: an index from 1, in FMI 3.0 a value reference.
    pub number: u32,
    /// Index of the variable from 1, if there is one.
    pub index: Option<usize>,
    /// The variables on which it depends, by numbers of the same kind; `None` means all.
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
        let types: Types<'_> = types(root, version)
            .filter_map(|(defined, value)| {
                let name = defined.attribute("name")?;
                Some((name, (value, Arc::new(declared_type(defined, value)))))
            })
            .collect();
        let all = || (root.child("ModelVariables").into_iter()).flat_map(|list| &list.children);
        let sizes: Sizes = all().filter_map(size).collect();
        let variables: Vec<_> = all()
            .filter(|child| version == FmiVersion::Fmi3 || child.name == "ScalarVariable")
            .map(|element| XmlVariable::read(element, version, &types, &sizes))
            .collect();
        // The first of several with the same value reference is collected last.
        let indices = variables.iter().enumerate().rev();
        let by_reference = indices.filter_map(|(i, v)| Some((v.as_ref()?.reference, i + 1)));
        let mut model = Self {
            root,
            version,
            by_reference: by_reference.collect(),
            variables,
            outputs: Vec::new(),
            derivatives: Vec::new(),
            clocked_states: Vec::new(),
            initial_unknowns: Vec::new(),
            event_indicators: Vec::new(),
        };
        model.outputs = model.unknowns("Outputs", "Output");
        model.derivatives = model.unknowns("Derivatives", "ContinuousStateDerivative");
        model.clocked_states = model.unknowns("", "ClockedState");
        model.initial_unknowns = model.unknowns("InitialUnknowns", "InitialUnknown");
        model.event_indicators = model.unknowns("", "EventIndicator");
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

    /// The error message if a model description is not of FMI 2.0 or 3.0.
    pub fn other_version(root: &Element<'_>) -> Option<String> {
        if root.name != "fmiModelDescription"
            || FmiVersion::named(root.attribute("fmiVersion")).is_some()
        {
            return None;
        }
        let version = root.attribute("fmiVersion").unwrap_or_default();
        let is_number = version.bytes().all(|b| b.is_ascii_digit() || b == b'.');
        let shown = if is_number { version.to_owned() } else { quote(version) };
        let needed = match version.starts_with("1.") {
            true => "; export the model again for one of these versions",
            false => "",
        };
        Some(format!("it is of FMI version {shown}, expected 2.0 or 3.0{needed}"))
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

    /// The defined types: the element with the name, and the element with the unit, the bounds or the items.
    pub fn types(&self) -> impl Iterator<Item = (&'a Element<'a>, &'a Element<'a>)> + use<'a> {
        types(self.root, self.version)
    }

    /// The defined enumerations.
    pub fn enumerations(&self) -> impl Iterator<Item = DeclaredType> + use<'a> {
        let types = self.types();
        let types = types.filter(|(_, value)| value.name.starts_with("Enumeration"));
        types.map(|(defined, value)| declared_type(defined, value))
    }

    /// The valid variables with their indices from 1.
    pub fn variables(&self) -> impl Iterator<Item = (usize, &XmlVariable<'a>)> {
        (1..).zip(&self.variables).filter_map(|(index, v)| Some((index, v.as_ref()?)))
    }

    /// The variables with names that tools for Modelica cannot import as they are, and the reasons: keywords, `time` if
    /// it is not the independent variable, and names that differ only in characters that become `_`.
    pub fn unimportable(&self) -> Vec<(&XmlVariable<'a>, String)> {
        let mut known: HashMap<String, &str> = HashMap::new();
        let mut found = Vec::new();
        for (_, variable) in self.variables() {
            for name in variable.names() {
                let is_time = name == "time";
                if is_reserved_in_modelica(name)
                    && !(is_time && variable.causality == Causality::Independent)
                {
                    let what = if is_time { "the time" } else { "a keyword" };
                    found.push((
                        variable,
                        format!("the name {} is {what} in Modelica", quote(name)),
                    ));
                }
                let written = modelica_name(name);
                let other = *known.entry(written).or_insert(name);
                if other != name {
                    let names = format!("{} and {}", quote(other), quote(name));
                    found.push((variable, format!("the names {names} become equal in Modelica")));
                }
            }
        }
        found
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
    pub fn variable(&self, index: impl Into<Option<usize>>) -> Option<&XmlVariable<'a>> {
        self.variables.get(index.into()?.checked_sub(1)?)?.as_ref()
    }

    /// The variable to which an attribute refers.
    pub fn referred(&self, element: &Element<'_>, attribute: &str) -> Option<&XmlVariable<'a>> {
        self.variable(self.index(whole(element.attribute(attribute)?)?))
    }

    /// The unknowns in a list of FMI 2.0, or of this name in FMI 3.0.
    fn unknowns(&self, in_2: &str, in_3: &str) -> Vec<Unknown<'a>> {
        let (parent, list, item, number) = match self.version {
            FmiVersion::Fmi2 => (self.root.child("ModelStructure"), in_2, "Unknown", "index"),
            FmiVersion::Fmi3 => (Some(self.root), "ModelStructure", in_3, "valueReference"),
        };
        let elements = (parent.into_iter()).flat_map(|parent| parent.list(list, item));
        let unknown = |element: &'a Element<'a>| {
            let number = whole(element.attribute(number)?)?;
            Some(Unknown {
                element,
                number,
                index: self.index(number),
                dependencies: element.attribute("dependencies").and_then(unsigneds),
            })
        };
        elements.filter_map(unknown).collect()
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

impl<'a> XmlVariable<'a> {
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
        let dimensions = if is_3 { dimensions(element, sizes) } else { Some(Vec::new()) };
        let type_name = value.attribute("declaredType");
        let defined = type_name.and_then(|name| types.get(name));
        let declared_type = type_name.map(|name| match defined {
            Some((_, defined)) => Arc::clone(defined),
            None => Arc::new(DeclaredType { name: name.to_owned(), ..DeclaredType::default() }),
        });
        let mut listed = Self {
            is_sized: dimensions.is_some(),
            variable: Variable {
                name: element.attribute("name")?.to_owned(),
                // FMI 3.0.2, section 2.4.7.6.
                aliases: (element.children("Alias"))
                    .filter_map(|alias| Some(alias.attribute("name")?.to_owned()))
                    .collect(),
                reference: whole(element.attribute("valueReference")?)?,
                description: text(element, "description"),
                of_type,
                causality,
                variability,
                initial: initial.or(default),
                dimensions: dimensions.unwrap_or_default(),
                declared_type,
                ..Variable::default()
            },
            element,
            value,
            declared: defined.map(|(value, _)| *value),
        };
        let parse = |text: &str| Value::parse(of_type, text);
        let start: Option<_> = listed.starts().into_iter().map(parse).collect();
        let [min, max] = ["min", "max"].map(|name| listed.inherited(name).and_then(parse));
        let [unit, display_unit, mime_type] = ["unit", "displayUnit", "mimeType"]
            .map(|name| listed.inherited(name).map(str::to_owned));
        let clocks = element.attribute("clocks").filter(|_| is_3).and_then(unsigneds);
        listed.variable = Variable {
            clocks: clocks.unwrap_or_default(),
            max_size: listed.inherited("maxSize").and_then(whole),
            clock: (of_type == Type::Clock).then(|| listed.clock()),
            start: start.unwrap_or_default(),
            min,
            max,
            unit,
            display_unit,
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

    /// When the clock ticks, by its attributes, or else those of its declared type. Invalid parts are left out.
    fn clock(&self) -> ClockType {
        use IntervalVariability::{Calculated, Fixed};
        let number = |name| self.inherited(name).and_then(real).filter(|it| it.is_finite());
        let is_true = |name| self.inherited(name).and_then(boolean) == Some(true);
        let resolution: Option<u64> = self.inherited("resolution").and_then(whole);
        let resolution = resolution.filter(|resolution| *resolution > 0);
        let fraction = |name| {
            let counter: u64 = whole(self.inherited(name)?)?;
            Some(counter as f64 / resolution? as f64)
        };
        let kind = self.inherited("intervalVariability").and_then(IntervalVariability::parse);
        let interval = number("intervalDecimal").or_else(|| fraction("intervalCounter"));
        let shift = number("shiftDecimal").or_else(|| fraction("shiftCounter"));
        ClockType {
            interval_variability: match kind.unwrap_or_default() {
                Fixed if interval.is_none() => Calculated,
                kind => kind,
            },
            interval,
            shift: shift.unwrap_or(0.0),
            resolution,
            supports_fraction: is_true("supportsFraction"),
            priority: self.inherited("priority").and_then(whole),
            can_be_deactivated: is_true("canBeDeactivated"),
        }
    }

    /// Whether its start values are elements rather than an attribute.
    fn has_start_elements(&self) -> bool {
        let has_own_type = std::ptr::eq(self.element, self.value);
        has_own_type && matches!(self.of_type, Type::String | Type::Binary)
    }

    /// An attribute of the variable, or else of its declared type, as written.
    pub fn inherited(&self, name: &str) -> Option<&'a str> {
        let own = self.value.attribute(name);
        own.or_else(|| self.declared?.attribute(name))
    }
}

/// The defined types: the element with the name, and the element with the unit, the bounds or the items.
fn types<'a>(
    root: &'a Element<'a>,
    version: FmiVersion,
) -> impl Iterator<Item = (&'a Element<'a>, &'a Element<'a>)> {
    let types = (root.child("TypeDefinitions").into_iter()).flat_map(|types| &types.children);
    types.filter_map(move |defined| match version {
        FmiVersion::Fmi2 => Some((defined, defined.children.first()?)),
        FmiVersion::Fmi3 => Some((defined, defined)),
    })
}

/// An attribute as a text, empty if it is missing.
fn text(element: &Element<'_>, name: &str) -> String {
    element.attribute(name).unwrap_or_default().to_owned()
}

/// A defined type; `value` has its items.
fn declared_type(defined: &Element<'_>, value: &Element<'_>) -> DeclaredType {
    let items = value.children("Item").filter_map(|element| {
        Some(EnumerationItem {
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

/// Value reference and start value of a variable that may size arrays: a structural parameter or a constant.
fn size(element: &Element<'_>) -> Option<(u32, usize)> {
    let is_constant = element.attribute("variability") == Some(Variability::Constant.as_str());
    let causality = Causality::StructuralParameter.as_str();
    if !is_constant && element.attribute("causality") != Some(causality) {
        return None;
    }
    let reference = whole(element.attribute("valueReference")?)?;
    Some((reference, whole(element.attribute("start")?)?))
}

/// Numbers of elements of a variable of FMI 3.0, if they and their product are valid.
fn dimensions(element: &Element<'_>, sizes: &Sizes) -> Option<Vec<usize>> {
    let sizes: Option<Vec<usize>> = (element.children("Dimension"))
        .map(|dimension| match dimension.attribute("start") {
            Some(start) => whole(start),
            None => {
                let reference = whole(dimension.attribute("valueReference")?)?;
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

    #[test]
    fn documents_that_are_not_valid_model_descriptions_are_rejected() {
        for (document, expected) in [
            ("<a/>", "the root element is \"a\", expected fmiModelDescription"),
            (
                "1.0",
                "it is of FMI version 1.0, expected 2.0 or 3.0; export the model again for one of these versions",
            ),
            ("30", "it is of FMI version 30, expected 2.0 or 3.0"),
            ("4.0", "it is of FMI version 4.0, expected 2.0 or 3.0"),
            ("3", "it is of FMI version 3, expected 2.0 or 3.0"),
            ("&#10;", "it is of FMI version \"\\n\", expected 2.0 or 3.0"),
        ] {
            let of_version = format!("<fmiModelDescription fmiVersion='{document}'/>");
            let document = if document.starts_with('<') { document } else { &of_version };
            let root = parse(document).unwrap();
            let error = ModelDescription::read(&root).err().expect(document);
            assert_eq!(error.to_string(), expected);
        }
    }

    /// The valid variables of a document: index, name, type, causality, variability, initial, dimensions, start values
    /// as written and parsed, unit, bounds, items and aliases.
    fn variables(document: &str) -> String {
        let root = parse(document).unwrap();
        let model = ModelDescription::read(&root).unwrap();
        let line = |(index, v): (usize, &XmlVariable<'_>)| {
            let items = v.items().iter().map(|item| (&item.name, item.value));
            let items: Vec<_> = items.collect();
            let (starts, aliases) = (v.starts(), &v.aliases);
            format!(
                "{index} {}: {:?} {:?} {:?} {:?} {:?} {starts:?} {:?} {:?} {:?} {:?} {items:?} {aliases:?}\n",
                v.name,
                v.of_type,
                v.causality,
                v.variability,
                v.initial,
                v.dimensions,
                v.start,
                v.unit,
                v.min,
                v.max,
            )
        };
        model.variables().map(line).collect()
    }

    #[test]
    fn variables_of_fmi_2_inherit_from_their_types_and_invalid_ones_are_left_out() {
        let found = variables(
            "<fmiModelDescription fmiVersion='2.0'><TypeDefinitions>
            <SimpleType name='Force'><Real unit='N' max='9'/></SimpleType>
            <SimpleType name='Way'><Enumeration><Item name='left' value='3'/></Enumeration></SimpleType>
            </TypeDefinitions><ModelVariables>
            <ScalarVariable name='a' valueReference='0'/>
            <ScalarVariable name='a'><Real/></ScalarVariable>
            <ScalarVariable name='a' valueReference='-1'><Real/></ScalarVariable>
            <ScalarVariable name='a' valueReference='0' causality='x'><Real/></ScalarVariable>
            <ScalarVariable name='f' valueReference='0'><Real declaredType='Force' max='5'/></ScalarVariable>
            <ScalarVariable name='w' valueReference='0' causality='parameter' variability='fixed'>
            <Enumeration declaredType='Way' start='3'/></ScalarVariable>
            </ModelVariables></fmiModelDescription>",
        );
        assert_eq!(
            found,
            "5 f: Float64 Local Continuous Some(Calculated) [] [] [] Some(\"N\") None Some(Float64(5.0)) [] []\n\
            6 w: Enumeration Parameter Fixed Some(Exact) [] [\"3\"] [Enumeration(3)] None None None [(\"left\", 3)] []\n"
        );
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

    /// Real is of FMI 2.0; x is sized by nothing, and the size of y overflows.
    #[test]
    fn variables_of_fmi_3_have_their_own_types_defaults_and_dimensions() {
        let expected = [
            "1 n: UInt64 StructuralParameter Fixed Some(Exact) [] [\"3\"] [UInt64(3)] None None None [] []",
            "2 f: Float64 Output Continuous Some(Calculated) [] [] [] Some(\"N\") None Some(Float64(9.0)) [] []",
            "3 w: Float32 Input Continuous Some(Exact) [2, 3] [\"1\", \"2\", \"3\", \"4\", \"5\", \"6\"] \
            [Float32(1.0), Float32(2.0), Float32(3.0), Float32(4.0), Float32(5.0), Float32(6.0)] None None None [] [\"v\"]",
            "5 e: Enumeration Parameter Fixed Some(Exact) [] [\"5000000000\"] [Enumeration(5000000000)] None None None \
            [(\"far\", 5000000000)] []",
            "6 s: String Local Discrete Some(Calculated) [] [\"a b\"] [String(\"a b\")] None None None [] []",
            "7 b: Binary Local Discrete Some(Calculated) [] [\"00fF\"] [Binary([0, 255])] None None None [] []",
            "8 c: Clock Input Discrete None [] [] [] None None None [] []\n",
        ];
        assert_eq!(variables(OF_FMI_3), expected.join("\n"));
        let root = parse(OF_FMI_3).unwrap();
        let model = ModelDescription::read(&root).unwrap();
        assert_eq!((model.version, model.token()), (FmiVersion::Fmi3, "{1}"));
        assert!(model.co_simulation().is_some() && model.model_exchange().is_none());
        assert!(model.variable(0).is_none() && model.variable(9).is_none());
        let w = model.variable(3).unwrap();
        let names = [0, 5].map(|element| w.element_name("w", element));
        assert_eq!(names, ["w[1,1]", "w[2,3]"]);
        assert_eq!(w.start_of(4), Some(&Value::Float32(5.0)));
    }

    #[test]
    fn unknowns_of_fmi_3_have_the_indices_of_their_value_references() {
        let root = parse(OF_FMI_3).unwrap();
        let model = ModelDescription::read(&root).unwrap();
        let of = |list: &[Unknown<'_>]| -> Vec<_> {
            list.iter().map(|u| (u.number, u.index, u.dependencies.clone())).collect()
        };
        let expected = [(10, Some(2), Some(vec![20, 99])), (99, None, None)];
        assert_eq!(of(&model.outputs), expected);
        assert_eq!(of(&model.initial_unknowns), [(10, Some(2), None)]);
        assert_eq!(of(&model.event_indicators), [(20, Some(3), None)]);
        assert!(model.derivatives.is_empty() && model.clocked_states.is_empty());
    }
}
