//! Writes the model description of an exported model: the parts that all versions of FMI have.

use std::collections::HashMap;

use anyhow::{Context, Result, anyhow, ensure};

use crate::exported::ExportedModel;
use crate::unit::{self, Unit};
use crate::variable::Variable;
use crate::xml::Element;
use crate::{
    Causality, Dynamics, FmiVersion, Initial, LogCategory, Type, Value, Variability, fmi2, fmi3,
};

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

/// Writes the model description of a version of FMI.
struct XmlWriter<'a> {
    model: &'a ExportedModel,
    version: FmiVersion,
    /// The variables that the version lists; in FMI 2.0, their other names follow.
    variables: Vec<Variable>,
    /// The positions by value reference, from 1, in FMI 2.0.
    positions: HashMap<usize, usize>,
}

/// The lists of the model structure: their names in FMI 2.0, which has three, the elements of FMI 3.0, and what
/// they list.
type List = (&'static str, &'static str, fn(&Variable) -> bool);
const LISTS: [List; 4] = [
    ("Outputs", "Output", Variable::is_output),
    ("Derivatives", "ContinuousStateDerivative", Variable::is_derivative),
    ("InitialUnknowns", "InitialUnknown", Variable::is_initial_unknown),
    ("", "EventIndicator", Variable::is_event_indicator),
];

impl ExportedModel {
    /// Generates the model description of a version of FMI, in the order of the standard's schema. FMI 2.0
    /// has each element of an array that is in use, and leaves out the variables that it cannot express.
    ///
    /// # Errors
    /// A unit is unknown, two enumerations with different items have the same name, or a variable has the
    /// name of the independent variable of FMI 3.0.
    pub fn to_xml(&self, version: FmiVersion, origin: &Origin) -> Result<Element<'static>> {
        let (mut variables, token) = match version {
            FmiVersion::Fmi2 => (fmi2::variables(self), "guid"),
            FmiVersion::Fmi3 => (fmi3::variables(self)?, "instantiationToken"),
        };
        let positions = variables.iter().map(|v| v.reference as usize).zip(1..).collect();
        if version == FmiVersion::Fmi2 {
            let others = Vec::from_iter(variables.iter_mut().flat_map(fmi2::take_aliases));
            variables.extend(others);
        }
        let writer = XmlWriter { model: self, version, variables, positions };
        let root = Element::new("fmiModelDescription")
            .with("fmiVersion", version.as_str())
            .with("modelName", &self.name)
            .with(token, &self.guid)
            .with("description", &self.description)
            .with_some("author", origin.author.as_ref())
            .with_some("version", Some(&origin.version).filter(|version| !version.is_empty()))
            .with_some("copyright", origin.copyright.as_ref())
            .with_some("license", origin.license.as_ref())
            .with("generationTool", &origin.generation_tool)
            .with("variableNamingConvention", self.naming.as_str());
        let (stop, step) = self.default_experiment;
        // Without an integrator of its own, the model has no tolerance. Hosts that find none would integrate other
        // models with a coarse tolerance.
        let tolerance =
            if self.tolerance > 0.0 { format!("{:?}", self.tolerance) } else { "1e-6".to_owned() };
        let experiment = Element::new("DefaultExperiment")
            .with("startTime", self.start_time)
            .with("stopTime", stop)
            .with("tolerance", tolerance)
            .with("stepSize", step);
        let categories = LogCategory::of_model(self.has_log)
            .map(|category| (category.name().to_string_lossy(), category.description()));
        let own = self.log_categories.iter();
        let own = own.map(|(name, description)| (name.into(), &**description));
        let categories = categories.chain(own).map(|(name, description)| {
            Element::new("Category").with("name", name).with("description", description)
        });
        let root = match version {
            FmiVersion::Fmi2 => fmi2::interfaces(self, &writer.variables, root),
            FmiVersion::Fmi3 => fmi3::interfaces(self, root),
        };
        let variables = writer.variables.iter().map(|v| writer.variable(v));
        Ok(root
            .listing("UnitDefinitions", writer.units()?)
            .listing("TypeDefinitions", writer.types()?)
            .holding(Element::new("LogCategories").holding_all(categories))
            .holding(experiment)
            .holding(Element::new("ModelVariables").holding_all(variables))
            .holding(writer.structure()))
    }

    /// The variables that a version of FMI cannot express, so that [`to_xml`](Self::to_xml) leaves them out, and why.
    /// Structural parameters are not among them: FMI 2.0 has their start values in the number of elements.
    pub fn inexpressible(&self, version: FmiVersion) -> Vec<(&Variable, &'static str)> {
        match version {
            FmiVersion::Fmi2 => {
                let reason = |v| Some((v, fmi2::lacks(v)?));
                self.variables.iter().filter_map(reason).collect()
            }
            FmiVersion::Fmi3 => Vec::new(),
        }
    }
}

impl XmlWriter<'_> {
    fn units(&self) -> Result<Vec<Element<'static>>> {
        // Each unit, and the units to display it in.
        let mut units: Vec<(&str, Vec<&str>)> = Vec::new();
        for v in self.model.variables.iter().chain(&self.variables) {
            let Some(unit) = v.unit.as_deref() else { continue };
            let index = units.iter().position(|(known, _)| *known == unit);
            let index = index.unwrap_or_else(|| {
                units.push((unit, Vec::new()));
                units.len() - 1
            });
            let displays = &mut units[index].1;
            displays.extend(v.display_unit.as_deref().filter(|name| !displays.contains(name)));
        }
        let definition = |(unit, displays): (&str, Vec<&str>)| match self.model.units.get(unit) {
            Some(base) => Ok(Element::new("Unit")
                .with("name", unit)
                .holding_all(base_unit(base))
                .holding_all(display_units(unit, &displays)?)),
            None => unit_definition(unit, &displays),
        };
        units.into_iter().map(definition).collect()
    }

    /// The definitions of enumerations.
    fn types(&self) -> Result<Vec<Element<'static>>> {
        let mut definitions: Vec<Element<'static>> = Vec::new();
        for of_type in (self.model.variables.iter()).filter_map(|v| v.declared_type.as_ref()) {
            let named = |element: Element<'static>| {
                (element.with("name", &of_type.name)).with("description", &of_type.description)
            };
            let items = of_type.items.iter().map(|item| {
                Element::new("Item")
                    .with("name", &item.name)
                    .with("value", item.value)
                    .with("description", &item.description)
            });
            let definition = match self.version {
                FmiVersion::Fmi2 => named(Element::new("SimpleType"))
                    .holding(Element::new("Enumeration").holding_all(items)),
                FmiVersion::Fmi3 => named(Element::new("EnumerationType")).holding_all(items),
            };
            let name = Some(&*of_type.name);
            let mut others = definitions.iter();
            let other = others.find(|other| other.attribute("name") == name);
            ensure!(
                other.is_none_or(|other| *other == definition),
                "two enumerations of {} have the name {}; expected different names",
                self.model.name,
                of_type.name
            );
            if other.is_none() {
                definitions.push(definition);
            }
        }
        Ok(definitions)
    }

    /// The number by which attributes refer to a variable: its position in FMI 2.0, from 1, and its value reference
    /// in FMI 3.0.
    fn number(&self, reference: usize) -> Option<usize> {
        match self.version {
            FmiVersion::Fmi2 => self.positions.get(&reference).copied(),
            FmiVersion::Fmi3 => Some(reference),
        }
    }

    /// The element of a variable. In FMI 2.0, it holds an element for the type; in FMI 3.0, it has the attributes of both,
    /// holds the dimensions, and the start values of texts and bytes.
    fn variable(&self, v: &Variable) -> Element<'static> {
        let of_type = v.of_type.name(self.version);
        let is_2 = self.version == FmiVersion::Fmi2;
        let element = Element::new(if is_2 { "ScalarVariable" } else { of_type })
            .with("name", &v.name)
            .with("valueReference", v.reference)
            .with("description", &v.description)
            .with("causality", v.causality.as_str())
            .with("variability", v.variability.as_str())
            .with_some("clocks", (!v.clocks.is_empty()).then(|| list(&v.clocks)))
            .with_some("initial", v.initial.map(Initial::as_str));
        let starts = v.start.iter().map(text);
        let start = (!v.start.is_empty()).then(|| list(starts.clone()));
        if is_2 {
            return element.holding(self.typed(Element::new(of_type), v, start));
        }
        let is_intermediate = self.model.is_continuous
            && self.model.is_for_co_simulation()
            && v.variability == Variability::Continuous
            && matches!(v.causality, Causality::Input | Causality::Output);
        // A dimension of constant size, or the size of a structural parameter.
        let dimension = |size: &usize| match v.exported.size {
            Some(reference) => Element::new("Dimension").with("valueReference", reference),
            None => Element::new("Dimension").with("start", size),
        };
        let has_elements = matches!(v.of_type, Type::String | Type::Binary);
        let elements = starts.map(|value| Element::new("Start").with("value", value));
        let alias = |name: &String| {
            Element::new("Alias")
                .with("name", name)
                .with("description", format!("Former name of {}", v.name))
                .with_some("displayUnit", v.display_unit.as_ref())
        };
        let element = element
            .with_some("intermediateUpdate", is_intermediate.then_some(true))
            .holding_all(v.dimensions.iter().map(dimension))
            .holding_all(elements.take(if has_elements { v.start.len() } else { 0 }))
            .holding_all(v.aliases.iter().map(alias));
        let element = self.typed(element, v, start.filter(|_| !has_elements));
        match &v.clock {
            Some(clock) => fmi3::with_clock(element, clock),
            None => element,
        }
    }

    /// Adds the attributes that each version has in the element of a type.
    fn typed(
        &self,
        element: Element<'static>,
        v: &Variable,
        start: Option<String>,
    ) -> Element<'static> {
        let declared = v.declared_type.as_ref();
        let nominal = Some(v.exported.nominal).filter(|nominal| *nominal != 1.0);
        // FMI 2.0 has events in model exchange only.
        let has_events = self.version == FmiVersion::Fmi3 || self.model.is_for_model_exchange();
        let is_reinitialized = self.model.is_continuous && v.is_state() && has_events;
        let derivative = match v.exported.dynamics {
            Dynamics::Derivative { of } => self.number(of),
            _ => None,
        };
        element
            .with_some("mimeType", v.mime_type.as_ref())
            .with_some("maxSize", v.max_size)
            .with_some("declaredType", declared.map(|of_type| &of_type.name))
            .with_some("unit", v.unit.as_ref())
            .with_some("displayUnit", v.display_unit.as_ref())
            .with_some("min", v.min.as_ref().map(text))
            .with_some("max", v.max.as_ref().map(text))
            .with_some("nominal", nominal)
            .with_some("start", start)
            .with_some("derivative", derivative)
            .with_some("reinit", is_reinitialized.then_some(true))
    }

    /// `ModelStructure` (FMI 2.0.5, section 2.2.8; FMI 3.0.2, section 2.4.8), in which FMI 2.0 has the positions
    /// of variables, and FMI 3.0 their value references.
    ///
    /// Where all dependencies are the default, they are listed all the same: CasADi demands it of models with
    /// equations. All of FMI 3.0 include the independent variable. Event indicators are for model exchange only; the
    /// derivatives of states serve directional derivatives in co-simulation, too.
    fn structure(&self) -> Element<'static> {
        let is_2 = self.version == FmiVersion::Fmi2;
        let all = |is: fn(&Variable) -> bool| {
            let known = self.variables.iter().filter(|v| is(v));
            known.map(|v| v.reference as usize).collect()
        };
        let structure = Element::new("ModelStructure");
        let is_listed =
            |(_, of_3, _): &&List| *of_3 != "EventIndicator" || self.model.is_for_model_exchange();
        LISTS.iter().filter(is_listed).fold(structure, |structure, (of_2, of_3, is)| {
            let unknown = |(position, v): (usize, &Variable)| {
                let dependencies = match *of_2 == "InitialUnknowns" {
                    true => {
                        let is_listed = self.model.is_continuous;
                        let default = || is_listed.then(|| all(Variable::is_initially_known));
                        let given = v.exported.initially_from.as_deref();
                        given.map(sorted).or_else(default)
                    }
                    // A tick changes states, and thereby derivatives.
                    false if v.is_derivative() => self.dependencies(v).or_else(|| {
                        Some(all(|known| known.is_known() && known.of_type != Type::Clock))
                    }),
                    false => (self.dependencies(v)).or_else(|| Some(all(Variable::is_known))),
                };
                let number = |reference: &usize| self.number(*reference);
                let numbers = |all: Vec<_>| sorted(&Vec::from_iter(all.iter().filter_map(number)));
                let dependencies = dependencies.map(|all| list(numbers(all)));
                let unknown = match is_2 {
                    true => Element::new("Unknown").with("index", position),
                    false => Element::new(of_3).with("valueReference", v.reference),
                };
                unknown.with_some("dependencies", dependencies)
            };
            let unknowns = (1..).zip(&self.variables).filter(|(_, v)| is(v)).map(unknown);
            match (is_2, of_2.is_empty()) {
                (true, true) => structure,
                (true, false) => structure.listing(of_2, unknowns.collect()),
                (false, _) => structure.holding_all(unknowns),
            }
        })
    }

    /// Value references of the inputs and states that a variable depends on at a communication point or an
    /// event, in ascending order. An array has the one of its first element.
    ///
    /// Outputs of a model without equations change in steps and at sample instants only, and never
    /// depend on an input at the same instant, so that importers see no false algebraic loops.
    ///
    /// What a tick computes may depend on all clocks and inputs.
    fn dependencies(&self, v: &Variable) -> Option<Vec<usize>> {
        let is_of_ticks = self.model.is_clocked || v.is_of_ticks();
        let is_held = !self.model.is_continuous || v.variability != Variability::Continuous;
        match v.exported.dynamics {
            Dynamics::State => Some(vec![v.reference as usize]),
            _ if is_of_ticks => None,
            _ if v.is_output() && is_held => Some(Vec::new()),
            _ if v.exported.depends_on.is_empty() => None,
            _ => Some(sorted(&v.exported.depends_on)),
        }
    }
}

/// A value as the text of an attribute: numbers without an exponent.
pub(crate) fn text(value: &Value) -> String {
    match value {
        Value::Float32(value) => value.to_string(),
        Value::Float64(value) => value.to_string(),
        other => other.to_string(),
    }
}

/// A list as the value of an attribute.
fn list(items: impl IntoIterator<Item = impl ToString>) -> String {
    let items: Vec<_> = items.into_iter().map(|item| item.to_string()).collect();
    items.join(" ")
}

fn sorted(references: &[usize]) -> Vec<usize> {
    let mut sorted = references.to_vec();
    sorted.sort_unstable();
    sorted.dedup();
    sorted
}

fn unit_definition(name: &str, displays: &[&str]) -> Result<Element<'static>> {
    let unit = parse_unit(name)?;
    let base = unit::BASE
        .into_iter()
        .zip(unit.exponents)
        .filter(|(_, exponent)| *exponent != 0)
        .fold(Element::new("BaseUnit"), |base, (name, exponent)| base.with(name, exponent))
        .with_some("factor", (unit.factor != 1.0).then_some(unit.factor))
        .with_some("offset", (unit.offset != 0.0).then_some(unit.offset));
    let displays = display_units(name, displays)?;
    Ok(Element::new("Unit").with("name", name).holding(base).holding_all(displays))
}

fn parse_unit(name: &str) -> Result<Unit> {
    Unit::parse(name).map_err(|error| anyhow!("the unit {name:?}: {error}"))
}

/// The units to display values in.
fn display_units(name: &str, displays: &[&str]) -> Result<Vec<Element<'static>>> {
    let display = |display: &&str| {
        let conversion = parse_unit(name)?.conversion_to(&parse_unit(display)?);
        let (factor, offset) = conversion
            .with_context(|| format!("{display:?} cannot display a value in {name:?}"))?;
        let element = Element::new("DisplayUnit").with("name", display).with("factor", factor);
        Ok(element.with_some("offset", (offset != 0.0).then_some(offset)))
    };
    displays.iter().map(display).collect()
}

/// The definition of a unit that an FMU has, if there is one.
fn base_unit(parts: &[(String, f64)]) -> Option<Element<'static>> {
    let value = |name| parts.iter().find(|(known, _)| known == name).map(|(_, value)| value);
    let exponents = unit::BASE.into_iter().chain(["factor", "offset"]);
    let base = exponents.fold(Element::new("BaseUnit"), |b, name| b.with_some(name, value(name)));
    (!parts.is_empty()).then_some(base)
}
