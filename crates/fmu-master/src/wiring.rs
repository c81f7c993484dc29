//! Connections and recorded variables, grouped by component and type for reading and writing, and the store
//! of their values.

use std::collections::{HashMap, HashSet};

use fmu_description::{FmiVersion, Type, Value};
use fmu_host::{Listed, operation};
use fmu_worker::Function;
use serde::{Deserialize, Serialize};

use crate::fault::{FaultState, FaultyConnection};
use crate::input::InputTable;
use crate::plan::{LoadedComponent, ResolvedConnection, ScalarId};
use crate::{Conversion, Description, Fmu};

/// A place among values of the type Float64, or among the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "see above")]
pub enum Place {
    Real(usize),
    Other(usize),
}

impl Place {
    pub(crate) fn plus(self, offset: usize) -> Self {
        match self {
            Self::Real(index) => Self::Real(index + offset),
            Self::Other(index) => Self::Other(index + offset),
        }
    }

    /// The next place of a type, which is counted.
    fn next(kind: Type, [reals, others]: &mut [usize; 2]) -> Self {
        let (count, first) = match kind {
            Type::Float64 => (reals, Self::Real(0)),
            _ => (others, Self::Other(0)),
        };
        *count += 1;
        first.plus(*count - 1)
    }
}

/// The places in a row of columns of these types.
pub(crate) fn places(kinds: impl Iterator<Item = Type>) -> impl Iterator<Item = Place> {
    let mut counts = [0; 2];
    kinds.map(move |kind| Place::next(kind, &mut counts))
}

/// Values: Float64 as `f64`, which is fast, and the others.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Store {
    pub(crate) reals: Vec<f64>,
    pub(crate) others: Vec<Value>,
}

impl Store {
    /// This many values of each kind.
    pub(crate) fn new([reals, others]: [usize; 2]) -> Self {
        Self { reals: vec![0.0; reals], others: vec![Value::Boolean(false); others] }
    }

    /// A number, or a Boolean as 0 or 1; NaN for other values.
    #[inline(always)]
    pub(crate) fn number(&self, place: Place) -> f64 {
        match place {
            Place::Real(index) => self.reals[index],
            Place::Other(index) => self.other(index),
        }
    }

    /// A function of its own, which keeps the usual case short.
    #[cold]
    #[inline(never)]
    fn other(&self, index: usize) -> f64 {
        number(&self.others[index])
    }

    pub(crate) fn value(&self, place: Place) -> Value {
        match place {
            Place::Real(index) => Value::Float64(self.reals[index]),
            Place::Other(index) => self.others[index].clone(),
        }
    }

    pub(crate) fn set(&mut self, place: Place, value: Value) {
        match place {
            Place::Real(index) => self.reals[index] = number(&value),
            Place::Other(index) => self.others[index] = value,
        }
    }

    /// Copies recorded values of another store; if they are `PLAIN`, all are Float64.
    #[inline(always)]
    pub(crate) fn record<const PLAIN: bool>(&mut self, records: &RecordedSignals, from: &Self) {
        let (reals, sources) = (&mut *self.reals, &*from.reals);
        for &(source, to) in &records.reals {
            reals[to] = sources[source];
        }
        if !PLAIN {
            for &(source, to) in &records.others {
                self.others[to].clone_from(&from.others[source]);
            }
        }
    }
}

pub(crate) fn number(value: &Value) -> f64 {
    match value {
        Value::Boolean(value) => (*value).into(),
        value => {
            let whole = value.as_whole().map(|whole| whole as f64);
            whole.or(value.as_real()).unwrap_or(f64::NAN)
        }
    }
}

/// What is transferred between the components and into rows.
pub(crate) struct Wiring {
    /// The variables of each component: those of the type Float64, then those of each other type, which are
    /// rare.
    pub(crate) components: Vec<Vec<VariableGroup>>,
    /// What feeds each component during the initialization.
    pub(crate) feeds: Vec<Vec<FeedingOutputs>>,
    /// The number of outputs of all components: those of the type Float64, and the others.
    pub(crate) counts: [usize; 2],
    /// The recorded variables of continuous components, whose values before a step are recorded.
    pub(crate) before: RecordedSignals,
    /// The recorded variables of sampled components, whose values after a step are recorded.
    pub(crate) after: RecordedSignals,
    /// The connections with faults that lead to each component.
    pub(crate) faulty_connections: Vec<Vec<FaultyConnection>>,
    /// The places of the values from the input file among the outputs, in its order.
    pub(crate) fed: Vec<Place>,
    /// Whether all that is transferred at every step are values of Float64 as they are.
    pub(crate) is_plain: bool,
}

/// Recorded variables: their indices among the outputs of all components and in a row. Values are stored
/// in the same way in both.
#[derive(Default)]
pub(crate) struct RecordedSignals {
    pub(crate) reals: Vec<(usize, usize)>,
    pub(crate) others: Vec<(usize, usize)>,
}

/// Variables of one component and type.
pub(crate) struct VariableGroup {
    /// The type whose functions get and set them, and these functions.
    pub(crate) kind: Type,
    pub(crate) get: Option<Function>,
    pub(crate) set: Option<Function>,
    /// The connected inputs, and what feeds each of them.
    pub(crate) inputs: AccessList,
    pub(crate) sources: Vec<InputSource>,
    /// The inputs and the Float64 outputs that feed them, if these follow each other, none is scaled, and they
    /// are all elements: their values need not be collected.
    pub(crate) run: Option<Listed>,
    /// The Float64 outputs that feed inputs without a conversion, and the positions of these inputs.
    pub(crate) copied: Vec<(usize, usize)>,
    /// The variables that are connected or recorded, once each, and the place of the first.
    pub(crate) outputs: AccessList,
    pub(crate) first: Place,
    /// These outputs if they are Float64 and all elements: their values need not be distributed.
    pub(crate) whole: Option<Listed>,
}

/// The output, or the column of the input file, that feeds an input.
pub(crate) struct InputSource {
    /// `None` for the input file.
    pub(crate) component: Option<usize>,
    /// Its place among the outputs of all components, or the place of what a connection with faults delivers.
    pub(crate) output: Place,
    pub(crate) conversion: Option<Conversion>,
}

/// Outputs of one component and type that feed another component.
pub(crate) struct FeedingOutputs {
    pub(crate) component: usize,
    /// The type whose functions get them, and this function.
    pub(crate) kind: Type,
    pub(crate) get: Option<Function>,
    pub(crate) outputs: AccessList,
    /// The place of each among the outputs of all components.
    pub(crate) places: Vec<Place>,
}

impl FeedingOutputs {
    /// The feed from which a port is read.
    fn of<'a>(
        all: &'a mut Vec<Self>,
        components: &[LoadedComponent],
        port: ScalarId,
    ) -> &'a mut Self {
        let (component, kind) = (port.component, port.access(components));
        let found = all.iter().position(|feed| (feed.component, feed.kind) == (component, kind));
        let index = found.unwrap_or_else(|| {
            let get = accessor("get", components[component].fmu.version, kind);
            let (outputs, places) = (AccessList::default(), Vec::new());
            all.push(Self { component, kind, get, outputs, places });
            all.len() - 1
        });
        &mut all[index]
    }
}

impl VariableGroup {
    fn new(version: FmiVersion, kind: Type) -> Self {
        Self {
            kind,
            get: accessor("get", version, kind),
            set: accessor("set", version, kind),
            inputs: AccessList::default(),
            sources: Vec::new(),
            run: None,
            copied: Vec::new(),
            outputs: AccessList::default(),
            first: Place::Other(0),
            whole: None,
        }
    }

    /// Whether all values are only copied.
    fn is_plain(&self) -> bool {
        let are_distributed = self.whole.is_none() && !self.outputs.references.is_empty();
        self.copied.len() == self.sources.len() && !are_distributed
    }

    /// Those among which a port is.
    fn of<'a>(
        all: &'a mut [Vec<Self>],
        components: &[LoadedComponent],
        port: ScalarId,
    ) -> &'a mut Self {
        let (all, kind) = (&mut all[port.component], port.access(components));
        let found = all.iter().position(|ports| ports.kind == kind);
        let index = found.unwrap_or_else(|| {
            all.push(Self::new(components[port.component].fmu.version, kind));
            all.len() - 1
        });
        &mut all[index]
    }
}

impl Wiring {
    pub(crate) fn new(
        description: &Description,
        components: &[LoadedComponent],
        links: &[ResolvedConnection],
        input: Option<&InputTable>,
        recorded: &[ScalarId],
    ) -> Self {
        let reals = |planned: &LoadedComponent| {
            vec![VariableGroup::new(planned.fmu.version, Type::Float64)]
        };
        let mut wired = Vec::from_iter(components.iter().map(reals));

        // All variables that are read, and their places.
        let mut seen = HashSet::new();
        let connected = links.iter().map(|link| link.from);
        let mut outputs = Vec::from_iter(recorded.iter().copied().chain(connected));
        outputs.retain(|port| seen.insert(*port));
        outputs.sort_by_key(|port| (port.component, port.access(components) as u8));
        let mut counts = [0; 2];
        let add = |port: ScalarId| {
            let ports = VariableGroup::of(&mut wired, components, port);
            let place = Place::next(ports.kind, &mut counts);
            if ports.outputs.references.is_empty() {
                ports.first = place;
            }
            let fmu = &components[port.component].fmu;
            ports.outputs.push(fmu, port.scalar);
            (port, place)
        };
        let outputs: HashMap<ScalarId, Place> = outputs.into_iter().map(add).collect();

        let [mut before, mut after] = [RecordedSignals::default(), RecordedSignals::default()];
        let kinds = recorded.iter().map(|port| port.of(components).of_type);
        for (port, column) in recorded.iter().zip(places(kinds)) {
            let records = if components[port.component].sampled { &mut after } else { &mut before };
            match (outputs[port], column) {
                (Place::Real(from), Place::Real(to)) => records.reals.push((from, to)),
                (Place::Real(from) | Place::Other(from), Place::Real(to) | Place::Other(to)) => {
                    records.others.push((from, to));
                }
            }
        }

        let mut links = Vec::from_iter(links);
        links.sort_by_key(|link| link.from.component);
        let mut faulty_connections = vec![Vec::new(); components.len()];
        let mut feeds = Vec::from_iter(components.iter().map(|_| Vec::<FeedingOutputs>::new()));
        let mut ranks = 0..;
        for ResolvedConnection { from, to, conversion, faults } in links {
            let ports = VariableGroup::of(&mut wired, components, *to);
            ports.inputs.push(&components[to.component].fmu, to.scalar);
            let mut output = outputs[from];
            if !faults.is_empty() {
                let (experiment, seed) = (description.experiment(), description.seed);
                let faults = faults.iter().zip(&mut ranks);
                let faults =
                    faults.map(|(fault, rank)| FaultState::new(fault, seed, rank, &experiment));
                let faults = faults.collect();
                faulty_connections[to.component].push(FaultyConnection {
                    from: output,
                    to: counts[0],
                    faults,
                });
                output = Place::next(Type::Float64, &mut counts);
            }
            let ScalarId { component, scalar } = *from;
            ports.sources.push(InputSource {
                component: Some(component),
                output,
                conversion: *conversion,
            });
            let feed = FeedingOutputs::of(&mut feeds[to.component], components, *from);
            feed.outputs.push(&components[component].fmu, scalar);
            feed.places.push(output);
        }
        let mut fed = Vec::new();
        for port in input.iter().flat_map(|input| input.ports()) {
            let ports = VariableGroup::of(&mut wired, components, port);
            let output = Place::next(ports.kind, &mut counts);
            fed.push(output);
            ports.inputs.push(&components[port.component].fmu, port.scalar);
            ports.sources.push(InputSource { component: None, output, conversion: None });
        }
        for reals in wired.iter_mut().map(|all| &mut all[0]) {
            let pairs = reals.sources.iter().zip(&reals.inputs.positions);
            let copied = pairs.filter_map(|(source, position)| match source.output {
                Place::Real(from) if source.conversion.is_none() => Some((from, *position)),
                _ => None,
            });
            reals.copied = copied.collect();
            if let [(first, _), ..] = reals.copied[..]
                && (first..).zip(0..reals.inputs.elements).eq(reals.copied.iter().copied())
            {
                reals.run = Some(reals.inputs.listed(first));
            }
            reals.whole = match reals.first {
                Place::Real(first) if reals.outputs.are_all => Some(reals.outputs.listed(first)),
                _ => None,
            };
        }
        let is_plain = input.is_none()
            && faulty_connections.iter().all(Vec::is_empty)
            && before.others.is_empty()
            && after.others.is_empty()
            && wired.iter().all(|all| all.len() == 1 && all[0].is_plain());
        Self { components: wired, feeds, counts, before, after, faulty_connections, fed, is_plain }
    }
}

/// The function that gets or sets variables of a type.
pub(crate) fn accessor(verb: &str, version: FmiVersion, kind: Type) -> Option<Function> {
    Function::performing(version, &operation(verb, kind))
}

/// Scalars, and the variables with which they are got or set.
#[derive(Default)]
pub(crate) struct AccessList {
    /// The value references; an array has one for all its elements.
    pub(crate) references: Vec<u32>,
    /// Their indices in the FMU.
    pub(crate) scalars: Vec<usize>,
    /// The number of elements of all variables together.
    pub(crate) elements: usize,
    /// The positions of the scalars among these.
    pub(crate) positions: Vec<usize>,
    /// Whether they are all elements, in their order.
    pub(crate) are_all: bool,
    /// Whether they are not the first elements, in their order.
    are_mixed: bool,
    /// The first element of each array.
    arrays: HashMap<u32, usize>,
}

impl AccessList {
    /// The variables and the place of their elements in a list.
    pub(crate) fn listed(&self, first: usize) -> Listed {
        Listed::new(&self.references, first..first + self.elements)
    }

    pub(crate) fn of(fmu: &Fmu, scalars: impl IntoIterator<Item = usize>) -> Self {
        let mut wired = Self::default();
        scalars.into_iter().for_each(|scalar| wired.push(fmu, scalar));
        wired
    }

    pub(crate) fn push(&mut self, fmu: &Fmu, scalar: usize) {
        let variable = fmu.variable(scalar);
        let (reference, count) = (variable.reference, variable.element_count());
        // Aliases of scalars are accessed each on its own.
        let is_array = count > 1;
        let known = if is_array { self.arrays.get(&reference).copied() } else { None };
        let first = known.unwrap_or_else(|| {
            self.references.push(reference);
            if is_array {
                self.arrays.insert(reference, self.elements);
            }
            self.elements += count;
            self.elements - count
        });
        let position = first + fmu.scalars[scalar].element;
        self.are_mixed |= position != self.positions.len();
        self.scalars.push(scalar);
        self.positions.push(position);
        self.are_all = !self.are_mixed && self.positions.len() == self.elements;
    }
}
