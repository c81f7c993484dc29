//! Connections and recorded variables, grouped by component and type for reading and writing.

use std::collections::{HashMap, HashSet};

use fmu_description::{FmiVersion, Type};
use fmu_host::Listed;
use fmu_worker::Function;

use crate::access_list::{AccessList, accessor};
use crate::components::{LoadedComponent, ScalarId};
use crate::connections::ResolvedConnection;
use crate::fault::{FaultState, FaultyConnection};
use crate::input::InputTable;
use crate::store::{Place, RecordedSignals, Transfer, places};
use crate::{Conversion, Description};

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
    pub(crate) copied: Vec<Transfer>,
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
        let (component, kind) = (port.component, port.access_type(components));
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
        let (all, kind) = (&mut all[port.component], port.access_type(components));
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
        outputs.sort_by_key(|port| (port.component, port.access_type(components) as u8));
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
        let kinds = recorded.iter().map(|port| port.variable(components).of_type);
        for (port, column) in recorded.iter().zip(places(kinds)) {
            let records = if components[port.component].sampled { &mut after } else { &mut before };
            match (outputs[port], column) {
                (Place::Real(from), Place::Real(to)) => records.reals.push(Transfer { from, to }),
                (Place::Real(from) | Place::Other(from), Place::Real(to) | Place::Other(to)) => {
                    records.others.push(Transfer { from, to });
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
        for port in input.iter().flat_map(|input| input.scalars()) {
            let ports = VariableGroup::of(&mut wired, components, port);
            let output = Place::next(ports.kind, &mut counts);
            fed.push(output);
            ports.inputs.push(&components[port.component].fmu, port.scalar);
            ports.sources.push(InputSource { component: None, output, conversion: None });
        }
        for reals in wired.iter_mut().map(|all| &mut all[0]) {
            let pairs = reals.sources.iter().zip(&reals.inputs.positions);
            let copied = pairs.filter_map(|(source, position)| match source.output {
                Place::Real(from) if source.conversion.is_none() => {
                    Some(Transfer { from, to: *position })
                }
                _ => None,
            });
            reals.copied = copied.collect();
            if let [Transfer { from: first, .. }, ..] = reals.copied[..]
                && (first..)
                    .zip(0..reals.inputs.elements)
                    .eq(reals.copied.iter().map(|t| (t.from, t.to)))
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
