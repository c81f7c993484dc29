//! The components and connections of nested systems, on one level.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::Element;
use fmu_description::{MimeType, Type};
use fmu_file::archive;

use super::vocabulary::{self, COMPONENT, SYSTEM};
use super::{arrays, document};
use crate::declarations::{Declarations, DeclaredLength, DeclaredVariable, Units};
use crate::package::StructureFile;
use crate::{Component, Connection, Conversion, InterfaceType, Literal};

/// The path of the element of a connector, which is empty for the outermost system, and the name of the connector.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectorPath {
    pub element: String,
    pub name: String,
}

impl ConnectorPath {
    pub fn new(element: impl Into<String>, name: impl Into<String>) -> Self {
        Self { element: element.into(), name: name.into() }
    }

    /// The path with the name.
    pub fn full(&self) -> String {
        join(&self.element, &self.name)
    }
}

/// What feeds a connector, and how its value is converted.
#[derive(Default)]
pub struct IncomingConnection {
    pub from: ConnectorPath,
    pub conversion: Option<Conversion>,
    /// Whether units are not converted.
    pub is_plain: bool,
}

/// A value on its way through connectors: its unit, and the conversions so far.
#[derive(Clone, Default)]
pub struct Passage {
    pub unit: Option<DefinedUnit>,
    pub conversion: Option<Conversion>,
}

/// A unit and its definition in base units.
#[derive(Clone)]
pub struct DefinedUnit {
    pub name: String,
    pub definition: Option<Vec<(String, f64)>>,
}

struct Connector {
    /// Whether values leave its element here.
    is_output: bool,
    unit: Option<DefinedUnit>,
    /// The stated MIME type of a Binary.
    mime_type: Option<String>,
    /// The stated lengths of its dimensions.
    dimensions: Vec<Option<usize>>,
}

/// An end of a connection.
struct End {
    /// Whether values come from it.
    is_source: bool,
    /// Whether it is a clock of a component that the master ticks, and others with it.
    is_time_based: bool,
    port: ConnectorPath,
    /// The dimensions of what is connected, as far as they are known.
    dimensions: Vec<Option<usize>>,
}

/// The elements read so far. Their paths are names separated by dots.
pub struct FlatSystem<'a> {
    /// The opened packages and structures; the paths that are read belong to the one with this index.
    pub opened: &'a mut Vec<StructureFile>,
    pub current: usize,
    pub units: Units,
    pub components: Vec<Component>,
    /// The FMUs of the components; `None` if one cannot be read, which is reported when it is loaded.
    pub models: Vec<Option<Declarations>>,
    /// All elements by their paths: the indices of components, and `None` for systems.
    pub elements: HashMap<String, Option<usize>>,
    /// What feeds each connector.
    links: BTreeMap<ConnectorPath, IncomingConnection>,
    /// The connectors that a connector of a system feeds.
    fed: HashMap<ConnectorPath, BTreeSet<ConnectorPath>>,
    pub warnings: Vec<String>,
    /// Warnings of units that are not defined, and are taken as none.
    pub undefined: RefCell<BTreeSet<String>>,
    /// The files outside of packages.
    pub sources: Vec<PathBuf>,
    connectors: HashMap<ConnectorPath, Connector>,
}

impl<'a> FlatSystem<'a> {
    pub fn new(opened: &'a mut Vec<StructureFile>, units: Units) -> Self {
        Self {
            opened,
            current: 0,
            units,
            components: Vec::new(),
            models: Vec::new(),
            elements: HashMap::new(),
            links: BTreeMap::new(),
            fed: HashMap::new(),
            warnings: Vec::new(),
            undefined: RefCell::default(),
            sources: Vec::new(),
            connectors: HashMap::new(),
        }
    }

    /// Adds a component, or a system with all that it contains. Bindings of outer systems come later, so that
    /// their values replace the values of inner ones.
    pub fn add(&mut self, element: &Element<'_>, path: &str) -> Result<()> {
        let of_type = element.attribute("type").unwrap_or(vocabulary::FMU_TYPE);
        let is_file = element.name == COMPONENT && vocabulary::SYSTEM_TYPES.contains(&of_type);
        let index = match element.name {
            COMPONENT if !is_file => Some(self.add_component(element, path)?),
            COMPONENT | SYSTEM => None,
            other => bail!("line {}: {other} is not supported", element.line),
        };
        let is_new = self.elements.insert(path.to_owned(), index).is_none();
        ensure!(is_new, "line {}: two elements have the name {path}", element.line);
        if is_file {
            let source = element.attribute("source").unwrap_or_default();
            self.add_file(source, path)
                .with_context(|| format!("{}: component {path}", line(element)))?;
        }
        self.add_parts(element, path)
    }

    /// Adds the system of another package or structure.
    fn add_file(&mut self, source: &str, path: &str) -> Result<()> {
        const MOST: usize = 100;
        ensure!(self.opened.len() <= MOST, "there are more than {MOST} packages in packages");
        let opened = StructureFile::open(&self.path(source)?).with_context(|| source.to_owned())?;
        let text = opened.structure();
        self.opened.push(opened);
        let current = std::mem::replace(&mut self.current, self.opened.len() - 1);
        let add = || {
            let text = text?;
            let root = document::document(&text, vocabulary::STRUCTURE)?;
            let units = std::mem::replace(&mut self.units, document::defined_units(&root));
            self.add_parts(document::outermost_system(&root)?, path)?;
            self.units = units;
            anyhow::Ok(())
        };
        add().with_context(|| source.to_owned())?;
        self.current = current;
        Ok(())
    }

    /// The path of the file at a URI, in the package or structure that is being read.
    fn path(&mut self, uri: &str) -> Result<PathBuf> {
        let files = &self.opened[self.current];
        let path = files.path(uri)?;
        if !files.is_package() && path.exists() {
            self.sources.push(path.clone());
        }
        Ok(path)
    }

    /// The text of the XML file at a URI.
    pub fn text(&mut self, uri: &str) -> Result<String> {
        archive::read_ssp(&self.path(uri)?).with_context(|| uri.to_owned())
    }

    fn add_parts(&mut self, element: &Element<'_>, path: &str) -> Result<()> {
        for connector in element.list(vocabulary::CONNECTORS, vocabulary::CONNECTOR) {
            self.add_connector(connector, path).with_context(|| line(connector))?;
        }
        for child in element.child(vocabulary::ELEMENT_LIST).iter().flat_map(|l| &l.children) {
            let name = child.attribute("name").filter(|name| !name.is_empty());
            // A reference to a signal dictionary, which is refused, has a name, too.
            let name = name.with_context(|| format!("line {}: no name", child.line))?;
            self.add(child, &join(path, name))?;
        }
        for connection in element.list(vocabulary::CONNECTIONS, vocabulary::CONNECTION) {
            self.add_connection(connection, path).with_context(|| line(connection))?;
        }
        for binding in element.list(vocabulary::BINDINGS, vocabulary::BINDING) {
            self.bind(binding, path).with_context(|| line(binding))?;
        }
        Ok(())
    }

    fn add_component(&mut self, element: &Element<'_>, path: &str) -> Result<usize> {
        let mut read = || {
            let of_type = element.attribute("type").unwrap_or(vocabulary::FMU_TYPE);
            ensure!(
                of_type == vocabulary::FMU_TYPE,
                "the type {of_type:?} is not supported, expected {}",
                vocabulary::FMU_TYPE
            );
            let interface = match element.attribute("implementation").unwrap_or("any") {
                "any" => None,
                "CoSimulation" => Some(InterfaceType::CoSimulation),
                "ModelExchange" => Some(InterfaceType::ModelExchange),
                "ScheduledExecution" => Some(InterfaceType::ScheduledExecution),
                other => bail!("the implementation {other:?} is not supported"),
            };
            Ok((self.path(element.attribute("source").unwrap_or_default())?, interface))
        };
        let read: Result<_> = read();
        let (fmu, interface) =
            read.with_context(|| format!("{}: component {path}", line(element)))?;
        self.models.push(Declarations::read(&fmu).ok());
        let name = path.to_owned();
        self.components.push(Component { name, fmu, interface, ..Component::default() });
        Ok(self.components.len() - 1)
    }

    fn add_connector(&mut self, element: &Element<'_>, path: &str) -> Result<()> {
        let name = element.attribute("name").unwrap_or_default();
        let is_output = match element.attribute("kind").unwrap_or_default() {
            "input" | "parameter" | "structuralParameter" => false,
            "output" | "calculatedParameter" | "constant" | "local" => true,
            kind => bail!("the kind {kind:?} of the connector {name} is not supported"),
        };
        self.check_clocks(element, path, name)?;
        let dimensions = arrays::dimensions(element)
            .with_context(|| format!("the connector {}", join(path, name)))?;
        let real = vocabulary::REALS.iter().find_map(|real| element.child(real));
        let unit = real.and_then(|real| real.attribute("unit"));
        let unit = self.stated_unit(unit, &self.units, &join(path, name));
        // A component that is a package repeats the connectors of its system.
        let port = ConnectorPath::new(path, name);
        let binary = element.child(vocabulary::BINARY);
        let mime_type = binary.and_then(|b| b.attribute("mime-type")).map(str::to_owned);
        let connector = Connector { is_output, unit, mime_type, dimensions };
        self.connectors.entry(port).or_insert(connector);
        Ok(())
    }

    /// Checks that a connector of a component is a clock, or belongs to clocks, as in its FMU, which decides.
    fn check_clocks(&self, element: &Element<'_>, path: &str, name: &str) -> Result<()> {
        let Some(variable) = self.variable(&ConnectorPath::new(path, name)) else { return Ok(()) };
        let is_clock = element.child(vocabulary::CLOCK).is_some();
        ensure!(
            !is_clock || variable.of_type == Type::Clock,
            "the connector {} is a Clock, but a {} in its FMU",
            join(path, name),
            variable.of_type.as_str()
        );
        let clocks = element.children(vocabulary::CLOCK_OF_CONNECTOR);
        for clock in clocks.map(|clock| clock.attribute("name").unwrap_or_default()) {
            ensure!(
                variable.clocks.iter().any(|own| own == clock),
                "the connector {} belongs to the clock {clock}, but not in its FMU",
                join(path, name)
            );
        }
        Ok(())
    }

    /// Start and end do not say in which direction values flow, but the kinds of the connectors. Arrays are connected
    /// element by element.
    fn add_connection(&mut self, element: &Element<'_>, path: &str) -> Result<()> {
        let start = self.end(element, path, ["startElement", "startConnector", "startIndices"])?;
        let end = self.end(element, path, ["endElement", "endConnector", "endIndices"])?;
        let (from, to) = match (start, end) {
            (from @ End { is_source: true, .. }, to @ End { is_source: false, .. })
            | (to @ End { is_source: false, .. }, from @ End { is_source: true, .. }) => (from, to),
            // The master ticks one of two input clocks, and the other one with it.
            (one, other) if !one.is_source && one.is_time_based != other.is_time_based => {
                if one.is_time_based { (one, other) } else { (other, one) }
            }
            (End { is_source, port: a, .. }, End { port: b, .. }) => {
                let what = if is_source { "give" } else { "take" };
                let (a, b) = (a.full(), b.full());
                bail!("{a} and {b} are connected, but both {what} values")
            }
        };
        let names = || (from.port.full(), to.port.full());
        if let (Some(one), Some(other)) = (self.mime_type(&from.port), self.mime_type(&to.port)) {
            let (a, b) = names();
            ensure!(
                MimeType::fits(one, other),
                "{a} ({one}) and {b} ({other}) are connected, but their MIME types differ"
            );
        }
        let dimensions = arrays::common(&from.dimensions, &to.dimensions).with_context(|| {
            let ((a, b), [of_a, of_b]) =
                (names(), [&from, &to].map(|end| arrays::shown(&end.dimensions)));
            format!("{a} ({of_a}) and {b} ({of_b}) are connected, but their dimensions differ")
        })?;
        let dimensions: Option<Vec<usize>> = dimensions.into_iter().collect();
        let dimensions = dimensions.with_context(|| {
            let (a, b) = names();
            format!("{a} and {b} are connected, but neither has the size of all its dimensions")
        })?;
        arrays::count(&dimensions)?;
        let sources = arrays::element_names(&from.port.name, &dimensions);
        let targets = arrays::element_names(&to.port.name, &dimensions);
        for (source, target) in sources.into_iter().zip(targets) {
            let source = ConnectorPath::new(&from.port.element, source);
            let target = ConnectorPath::new(&to.port.element, target);
            let link = IncomingConnection::new(source, element)?;
            if !self.is_component(&link.from.element) {
                self.fed.entry(link.from.clone()).or_default().insert(target.clone());
            }
            let name = target.full();
            ensure!(self.links.insert(target, link).is_none(), "{name} is connected twice");
        }
        Ok(())
    }

    /// The end of a connection with these attributes: a connector, or an element of it.
    fn end(&self, connection: &Element<'_>, path: &str, attributes: [&str; 3]) -> Result<End> {
        let [of, name, indices] = attributes.map(|name| connection.attribute(name));
        let of = of.filter(|of| !of.is_empty());
        let owner = of.map_or_else(|| path.to_owned(), |of| join(path, of));
        let mut port = ConnectorPath::new(owner, name.unwrap_or_default());
        let connector = self.connectors.get(&port);
        let connector =
            connector.with_context(|| format!("there is no connector {}", port.full()))?;
        let mut dimensions = self.dimensions(&port, connector)?;
        if let Some(text) = indices {
            let indices = text.split_ascii_whitespace().map(|index| index.parse().ok());
            let indices: Option<Vec<usize>> = indices.collect();
            let indices = indices.filter(|indices| {
                let mut of = indices.iter().zip(&dimensions);
                indices.len() == dimensions.len()
                    && of.all(|(index, length)| *index > 0 && length.is_none_or(|l| *index <= l))
            });
            let indices = indices.with_context(|| {
                let (name, shape) = (port.full(), arrays::shown(&dimensions));
                format!("{name} ({shape}) has no element with the indices {text:?}")
            })?;
            port.name = arrays::element_name(&port.name, &indices)?;
            dimensions.clear();
        }
        // Seen from inside, an input of the system itself is a source.
        let is_source = connector.is_output == of.is_some();
        let is_time_based = self.variable(&port).is_some_and(|variable| variable.is_time_based);
        Ok(End { is_source, is_time_based, port, dimensions })
    }

    /// The dimensions of a connector, as far as they are known: of the variable of its FMU, else as stated.
    fn dimensions(
        &self,
        port: &ConnectorPath,
        connector: &Connector,
    ) -> Result<Vec<Option<usize>>> {
        let stated = &connector.dimensions;
        let Some(variable) = self.model(&port.element).and_then(|m| m.variables.get(&port.name))
        else {
            return Ok(stated.clone());
        };
        let start = self.elements[&port.element].map(|index| &self.components[index].start);
        let length = |length: &DeclaredLength| {
            let set = length.parameter.as_ref().and_then(|name| start?.get(name));
            match set {
                Some(Literal::Integer(set)) => usize::try_from(*set).ok(),
                _ => Some(length.default),
            }
        };
        let declared = Vec::from_iter(variable.dimensions.iter().map(length));
        ensure!(
            stated.is_empty() || arrays::common(stated, &declared).is_some(),
            "the dimensions of {} are {}, but {} in its FMU",
            port.full(),
            arrays::shown(stated),
            arrays::shown(&declared)
        );
        Ok(declared)
    }

    /// The connections between components. What is connected to an open connector of the outermost system
    /// is not connected.
    pub fn connections(&self) -> Result<Vec<Connection>> {
        let mut connections = Vec::new();
        for (to, link) in self.links.iter().filter(|(_, l)| self.is_component(&l.from.element)) {
            let from = link.from.full();
            let passage = Passage { unit: self.connector_unit(&link.from), conversion: None };
            let mut targets = Vec::new();
            self.follow(passage, link, to, &mut targets)?;
            connections.extend(targets.into_iter().map(|(to, conversion)| Connection {
                from: from.clone(),
                to: to.full(),
                conversion,
                faults: Vec::new(),
            }));
        }
        Ok(connections)
    }

    /// Passes a value to a connector, and on to the components to which a connector of a system leads.
    pub fn follow(
        &self,
        passage: Passage,
        link: &IncomingConnection,
        to: &ConnectorPath,
        targets: &mut Vec<(ConnectorPath, Option<Conversion>)>,
    ) -> Result<()> {
        let mut rest = vec![(passage, link, to)];
        while let Some((passage, link, port)) = rest.pop() {
            let passage = self.convert(passage, link, port)?;
            if self.is_component(&port.element) {
                targets.push((port.clone(), passage.conversion));
                continue;
            }
            for next in self.fed.get(port).into_iter().flatten().rev() {
                // One connector feeds each other one, so only the first can be met again.
                ensure!(next != to, "{} feeds itself", to.full());
                rest.push((passage.clone(), &self.links[next], next));
            }
        }
        Ok(())
    }

    pub fn is_component(&self, path: &str) -> bool {
        self.elements.get(path).is_some_and(Option::is_some)
    }

    /// The connector, or the array that has it as an element.
    fn connector(&self, port: &ConnectorPath) -> Option<&Connector> {
        self.connectors.get(port).or_else(|| {
            let array = arrays::array_name(&port.name)?;
            self.connectors.get(&ConnectorPath::new(&port.element, array))
        })
    }

    /// Whether there is such a connector of a system.
    pub fn has_connector(&self, port: &ConnectorPath) -> bool {
        self.connector(port).is_some() && !self.is_component(&port.element)
    }

    /// The FMU of a component.
    pub fn model(&self, path: &str) -> Option<&Declarations> {
        self.models[(*self.elements.get(path)?)?].as_ref()
    }

    /// The variable of a connector of a component, or the array of which it is an element.
    fn variable(&self, port: &ConnectorPath) -> Option<&DeclaredVariable> {
        let variables = &self.model(&port.element)?.variables;
        let array = || variables.get(&arrays::array_name(&port.name)?);
        variables.get(&port.name).or_else(array)
    }

    /// The MIME type of a connector: as stated, or by default of the variable.
    fn mime_type(&self, port: &ConnectorPath) -> Option<&str> {
        let stated = self.connector(port).and_then(|connector| connector.mime_type.as_deref());
        stated.or_else(|| self.variable(port)?.mime_type.as_deref())
    }

    /// The unit of this name for what `of` names; an empty one is none.
    pub fn stated_unit(&self, unit: Option<&str>, units: &Units, of: &str) -> Option<DefinedUnit> {
        let unit = unit?;
        if unit.is_empty() {
            self.warn_undefined(unit, of);
            return None;
        }
        let definition = units.get(unit).or_else(|| self.units.get(unit)).cloned();
        Some(DefinedUnit { name: unit.to_owned(), definition })
    }

    /// Warns of a unit.
    fn warn_undefined(&self, unit: &str, of: &str) {
        let text = format!("the unit {unit:?} of {of} is not defined, and is taken as none");
        self.undefined.borrow_mut().insert(text);
    }

    /// The unit of a connector; by default, or if it is not defined, the unit of the variable.
    fn connector_unit(&self, port: &ConnectorPath) -> Option<DefinedUnit> {
        let model = self.model(&port.element);
        let defined = |name: &String, definition: &Option<_>| DefinedUnit {
            definition: definition.clone().or_else(|| model?.units.get(name).cloned()),
            name: name.clone(),
        };
        let connector = self.connector(port).and_then(|connector| connector.unit.as_ref());
        let stated = connector.map(|unit| defined(&unit.name, &unit.definition));
        if stated.as_ref().is_some_and(|unit| unit.definition.is_some()) {
            return stated;
        }
        let of_variable = self.variable(port).and_then(|variable| variable.unit.as_ref());
        let of_variable = of_variable.map(|name| defined(name, &self.units.get(name).cloned()));
        if let (Some(DefinedUnit { name, .. }), Some(other)) = (&stated, &of_variable)
            && *name != other.name
        {
            self.warn_undefined(name, &port.full());
        }
        of_variable.or(stated)
    }

    fn convert(
        &self,
        passage: Passage,
        link: &IncomingConnection,
        to: &ConnectorPath,
    ) -> Result<Passage> {
        let mut unit = self.connector_unit(to);
        let same = Some(Conversion { factor: 1.0, offset: 0.0 });
        let mut conversion = None;
        if let (Some(from), Some(into)) = (&passage.unit, &unit)
            && from.name != into.name
        {
            let name = to.full();
            if link.is_plain {
                conversion = same;
            } else if into.definition.is_none() {
                self.warn_undefined(&into.name, &name);
                conversion = same;
                unit = None;
            } else if from.definition.is_none() {
                self.warn_undefined(&from.name, &format!("what feeds {name}"));
                conversion = same;
            } else {
                let converted = from.conversion(into);
                conversion = converted.with_context(|| format!("{name} [{}]", into.name))?;
            }
        }
        // The transformation is of the value in the unit of the target.
        let conversion = combine(combine(passage.conversion, conversion), link.conversion);
        Ok(Passage { unit: unit.or(passage.unit), conversion })
    }
}

impl DefinedUnit {
    /// How a value in this unit is converted to another; `None` if they are the same.
    pub fn conversion(&self, to: &Self) -> Result<Option<Conversion>> {
        let split = |unit: &Self| {
            let parts = unit.definition.clone()?.into_iter();
            let is_exponent = |(name, _): &(String, f64)| name != "factor" && name != "offset";
            let (exponents, scale): (Vec<_>, Vec<_>) = parts.partition(is_exponent);
            let find = |name: &str| scale.iter().find(|(n, _)| n == name).map(|(_, part)| *part);
            Some((exponents, find("factor").unwrap_or(1.0), find("offset").unwrap_or(0.0)))
        };
        match (split(self), split(to)) {
            (Some((a, factor, offset)), Some((b, to_factor, to_offset))) if a == b => {
                let is_same = factor == to_factor && offset == to_offset;
                Ok((!is_same).then(|| Conversion {
                    factor: factor / to_factor,
                    offset: (offset - to_offset) / to_factor,
                }))
            }
            _ => bail!("a value in {:?} cannot be converted", self.name),
        }
    }
}

/// One conversion after another.
fn combine(first: Option<Conversion>, second: Option<Conversion>) -> Option<Conversion> {
    match (first, second) {
        (Some(a), Some(b)) => {
            Some(Conversion { factor: b.factor * a.factor, offset: b.factor * a.offset + b.offset })
        }
        (first, second) => first.or(second),
    }
}

impl IncomingConnection {
    /// The link that a connection or an entry of a mapping describes.
    pub fn new(from: ConnectorPath, element: &Element<'_>) -> Result<Self> {
        let is_other = |child: &&Element<'_>| child.name.ends_with("MappingTransformation");
        if let Some(other) = element.children.iter().find(is_other) {
            bail!("{} is not supported, expected LinearTransformation", other.name);
        }
        let conversion = element.child(vocabulary::LINEAR).map(|linear| {
            let part = |name, default| match linear.has(name) {
                true => linear.real(name).filter(|part| part.is_finite()),
                false => Some(default),
            };
            let conversion = part("factor", 1.0).zip(part("offset", 0.0));
            let conversion = conversion.map(|(factor, offset)| Conversion { factor, offset });
            conversion.context("the factor and offset of a transformation must be finite numbers")
        });
        let is_plain = element.is_true("suppressUnitConversion");
        Ok(Self { from, conversion: conversion.transpose()?, is_plain })
    }
}

pub fn join(path: &str, name: &str) -> String {
    match path {
        "" => name.to_owned(),
        path => format!("{path}.{name}"),
    }
}

fn line(element: &Element<'_>) -> String {
    format!("line {}", element.line)
}
