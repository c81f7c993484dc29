//! How values go from outputs to inputs and into rows, prepared once for all runs of a plan.
//!
//! The outputs of all components that are connected or recorded are in one [`Store`](crate::store::Store). A component
//! has a [`VariableGroup`] for each type, because a function of FMI gets or sets variables of one type. For example, let
//! a source have the output `r`, a controller the inputs `r` and `y` and the output `u`, and a plant the input `u` and
//! the output `theta`, all Float64, and let `theta` be recorded:
//!
//! | group | in the store | at each step |
//! |---|---|---|
//! | source | outputs `[0]` | gets `r` directly into place 0 (`direct_outputs`) |
//! | controller | inputs `[0, 2]`, outputs `[1]` | copies places 0 and 2 (`copied_inputs`), sets them, gets `u` into place 1 |
//! | plant | inputs `[1]`, outputs `[2]` | sets `u` directly from place 1 (`direct_inputs`), gets `theta` into place 2 |
//! | row | | copies place 2 into column 0 (`recorded_before`) |
//!
//! A system in which all groups are Float64, and values go only in these ways, is *plain*, and steps fastest.

use std::collections::{HashMap, HashSet};

use fmu_description::{FmiVersion, Type};
use fmu_host::StepVariables;
use fmu_worker::Function;

use crate::access_list::{AccessList, accessor};
use crate::components::{LoadedComponent, ScalarId};
use crate::connections::ResolvedConnection;
use crate::extrapolation::Extrapolation;
use crate::fault::{FaultState, FaultyConnection};
use crate::input_table::InputTable;
use crate::store::{Place, RecordedSignals, Transfer};
use crate::{Column, Conversion, Description, Row};

/// The ways of all values between the components and into rows.
pub(crate) struct Wiring {
    /// The groups of each component: the Float64 group, then groups of other types, which are rare.
    pub(crate) groups: Vec<Vec<VariableGroup>>,
    /// The outputs that feed each component, as they are read during the initialization.
    pub(crate) feeding: Vec<Vec<FeedingOutputs>>,
    /// The number of values in the store: of the type Float64, and of other types.
    pub(crate) counts: [usize; 2],
    /// The recorded signals of continuous components, whose values before a step are recorded.
    pub(crate) recorded_before: RecordedSignals,
    /// The recorded signals of sampled components, whose values after a step are recorded.
    pub(crate) recorded_after: RecordedSignals,
    /// The recorded signals of components with clocks, whose values after the ticks at a communication point are recorded.
    pub(crate) recorded_at_ticks: RecordedSignals,
    /// The recorded clocked variables.
    pub(crate) clocked_columns: Vec<ClockedColumn>,
    /// The recorded clocks of each component, by value reference, and their places.
    pub(crate) recorded_clocks: Vec<Vec<(u32, Place)>>,
    /// The outputs of continuous components that feed components with clocks, and the places where their values are held
    /// over a communication step.
    pub(crate) held: Vec<(Place, Place)>,
    /// Whether a sampled component feeds one with clocks.
    pub(crate) samples_at_ticks: bool,
    /// The inputs that clocked outputs feed, and the places that have no value before the first tick.
    pub(crate) unset: Vec<(ScalarId, Place, Option<Conversion>)>,
    /// The connections with faults that lead to each component.
    pub(crate) faulty_connections: Vec<Vec<FaultyConnection>>,
    pub(crate) extrapolation: Extrapolation,
    /// The places in the store of the outputs.
    pub(crate) output_places: HashMap<ScalarId, Place>,
    /// The places in the store of the columns of the input table.
    pub(crate) table_places: Vec<Place>,
    /// The places in the store of the inputs that a host sets.
    pub(crate) host_places: Vec<Place>,
    /// Whether every value that is transferred at a step is a Float64 that is not changed on its way.
    pub(crate) is_plain: bool,
}

/// A recorded clocked variable, whose value is absent in a row since whose last one none of its clocks has ticked.
pub(crate) struct ClockedColumn {
    pub(crate) component: usize,
    /// The clocks, by value reference.
    pub(crate) clocks: Vec<u32>,
    /// The place of the value, and the index of the column among the others in a row.
    pub(crate) from: Place,
    pub(crate) to: usize,
}

/// The connected and recorded variables of one component and one type.
pub(crate) struct VariableGroup {
    /// The clocks at whose ticks alone the variables are got and set, by value reference; none if at any time.
    pub(crate) clocks: Vec<u32>,
    /// The type whose functions get and set the variables, and these functions.
    pub(crate) access_type: Type,
    pub(crate) get: Option<Function>,
    pub(crate) set: Option<Function>,
    /// The connected inputs, and the source of each.
    pub(crate) inputs: AccessList,
    pub(crate) sources: Vec<InputSource>,
    /// The values of all inputs in the store, if they follow each other there as Float64 and need no conversion: they
    /// are set directly from the store.
    pub(crate) direct_inputs: Option<StepVariables>,
    /// The Float64 values in the store that inputs take without a conversion, and the positions of these inputs.
    pub(crate) copied_inputs: Vec<Transfer>,
    /// The outputs, once each, and the place of the first in the store; the others follow.
    pub(crate) outputs: AccessList,
    pub(crate) first_output: Place,
    /// The values of all outputs in the store, if they are Float64 and all elements: they are got directly into the
    /// store.
    pub(crate) direct_outputs: Option<StepVariables>,
}

/// The source of the value of an input.
pub(crate) struct InputSource {
    /// The component of the output; `None` for a column of the input table, and for an input that a host
    /// sets.
    pub(crate) component: Option<usize>,
    /// The place in the store of the output, the column, or the value that a connection with faults delivers.
    pub(crate) place: Place,
    pub(crate) conversion: Option<Conversion>,
    /// The names of the ends of the connection, or of the input alone, if the input is a Binary with a largest size.
    pub(crate) sized: Option<String>,
}

/// Outputs of one component and type that feed another component.
pub(crate) struct FeedingOutputs {
    pub(crate) component: usize,
    /// The type whose functions get the outputs, and this function.
    pub(crate) access_type: Type,
    pub(crate) get: Option<Function>,
    pub(crate) outputs: AccessList,
    /// The places in the store from which the inputs take the values.
    pub(crate) places: Vec<Place>,
}

impl FeedingOutputs {
    /// The outputs of the component and the type of an output, which are added if there are none yet.
    pub(crate) fn entry<'a>(
        all: &'a mut Vec<Self>,
        components: &[LoadedComponent],
        output: ScalarId,
    ) -> &'a mut Self {
        let (component, access_type) = (output.component, output.access_type(components));
        // Connections come in the order of the components that feed, so only the last ones can be the same.
        let mut same = all.iter().enumerate().rev().take_while(|(_, f)| f.component == component);
        let index = same.find_map(|(index, f)| (f.access_type == access_type).then_some(index));
        let index = index.unwrap_or_else(|| {
            let get = accessor("get", output.fmu(components).version, access_type);
            let (outputs, places) = (AccessList::default(), Vec::new());
            all.push(Self { component, access_type, get, outputs, places });
            all.len() - 1
        });
        &mut all[index]
    }
}

impl VariableGroup {
    fn new(version: FmiVersion, access_type: Type, clocks: &[u32]) -> Self {
        Self {
            clocks: clocks.to_vec(),
            access_type,
            get: accessor("get", version, access_type),
            set: accessor("set", version, access_type),
            inputs: AccessList::default(),
            sources: Vec::new(),
            direct_inputs: None,
            copied_inputs: Vec::new(),
            outputs: AccessList::default(),
            first_output: Place::Other(0),
            direct_outputs: None,
        }
    }

    /// The group of a scalar, which is added if there is none yet.
    fn entry<'a>(
        groups: &'a mut [Vec<Self>],
        components: &[LoadedComponent],
        id: ScalarId,
    ) -> &'a mut Self {
        let (groups, access_type) = (&mut groups[id.component], id.access_type(components));
        let clocks = id.clocks(components);
        let is_same = |group: &Self| group.access_type == access_type && group.clocks == clocks;
        let found = groups.iter().position(is_same);
        let index = found.unwrap_or_else(|| {
            groups.push(Self::new(id.fmu(components).version, access_type, clocks));
            groups.len() - 1
        });
        &mut groups[index]
    }

    /// Whether the variables can be got and set when these clocks tick.
    pub(crate) fn is_accessible(&self, ticking: &[u32]) -> bool {
        self.clocks.is_empty() || self.clocks.iter().any(|clock| ticking.contains(clock))
    }

    /// Finds which Float64 values go directly to and from the store, and which are copied.
    fn find_direct_values(&mut self) {
        let pairs = self.sources.iter().zip(&self.inputs.positions);
        let copied = pairs.filter_map(|(source, position)| match source.place {
            Place::Real(from) if source.conversion.is_none() => {
                Some(Transfer { from, to: *position })
            }
            _ => None,
        });
        self.copied_inputs = copied.collect();
        if let [Transfer { from: first, .. }, ..] = self.copied_inputs[..]
            && let ends = self.copied_inputs.iter().map(|copied| (copied.from, copied.to))
            && (first..).zip(0..self.inputs.elements).eq(ends)
        {
            self.direct_inputs = Some(self.inputs.placed_at(first));
        }
        self.direct_outputs = match self.first_output {
            Place::Real(first) if self.outputs.is_complete => Some(self.outputs.placed_at(first)),
            _ => None,
        };
    }

    /// Whether all values go directly or are only copied.
    fn is_plain(&self) -> bool {
        let are_distributed = self.direct_outputs.is_none() && !self.outputs.references.is_empty();
        self.copied_inputs.len() == self.sources.len() && !are_distributed
    }
}

impl Wiring {
    pub(crate) fn new(
        description: &Description,
        components: &[LoadedComponent],
        connections: &[ResolvedConnection],
        input: Option<&InputTable>,
        host_inputs: &[ScalarId],
        (recorded, columns): (&[ScalarId], &[Column]),
    ) -> Self {
        let reals = |component: &LoadedComponent| {
            vec![VariableGroup::new(component.fmu.version, Type::Float64, &[])]
        };
        let mut groups = Vec::from_iter(components.iter().map(reals));

        // The places of all outputs that are read.
        let mut seen = HashSet::new();
        let connected = connections.iter().map(|connection| connection.from);
        let mut outputs = Vec::from_iter(recorded.iter().copied().chain(connected));
        outputs.retain(|id| seen.insert(*id));
        outputs.sort_by_key(|id| {
            (id.component, id.access_type(components) as u8, id.clocks(components))
        });
        let mut counts = [0; 2];
        let mut recorded_clocks = vec![Vec::new(); components.len()];
        let add = |id: ScalarId| {
            if id.access_type(components) == Type::Clock {
                let place = Place::next(Type::Clock, &mut counts);
                let clocks: &mut Vec<_> = &mut recorded_clocks[id.component];
                clocks.push((id.variable(components).reference, place));
                return (id, place);
            }
            let group = VariableGroup::entry(&mut groups, components, id);
            let place = Place::next(group.access_type, &mut counts);
            if group.outputs.references.is_empty() {
                group.first_output = place;
            }
            group.outputs.push(id.fmu(components), id.scalar);
            (id, place)
        };
        let output_places: HashMap<ScalarId, Place> = outputs.into_iter().map(add).collect();

        let [mut recorded_before, mut recorded_after, mut recorded_at_ticks] =
            [(); 3].map(|()| RecordedSignals::default());
        let mut clocked_columns = Vec::new();
        for ((id, column), place) in recorded.iter().zip(columns).zip(Row::places(columns)) {
            let component = &components[id.component];
            if let (true, Place::Other(to)) = (column.optional, place) {
                let (component, clocks) = (id.component, id.clocks(components).to_vec());
                let from = output_places[id];
                clocked_columns.push(ClockedColumn { component, clocks, from, to });
                continue;
            }
            let signals = match component.sampled {
                _ if component.is_clocked() => &mut recorded_at_ticks,
                true => &mut recorded_after,
                false => &mut recorded_before,
            };
            signals.add(output_places[id], place);
        }

        let mut extrapolation = Extrapolation::new(components, connections, &mut counts);
        let mut connections = Vec::from_iter(connections);
        connections.sort_by_key(|connection| connection.from.component);
        let mut faulty_connections = vec![Vec::new(); components.len()];
        let mut feeding = Vec::from_iter(components.iter().map(|_| Vec::new()));
        let mut ranks = 0..;
        let (mut held, mut unset, mut samples_at_ticks) = (Vec::new(), Vec::new(), false);
        for connection in connections {
            let ResolvedConnection { from, to, conversion, faults } = connection;
            let mut place = output_places[from];
            let (feeds, is_fed) = (&components[from.component], &components[to.component]);
            samples_at_ticks |= is_fed.is_clocked() && feeds.sampled;
            if is_fed.is_clocked() && !feeds.is_clocked() && !feeds.sampled {
                let to = Place::next(from.access_type(components), &mut counts);
                held.push((place, to));
                place = to;
            }
            if !faults.is_empty() {
                let (experiment, seed) = (description.experiment(), description.seed);
                let faults = faults.iter().zip(&mut ranks);
                let faults =
                    faults.map(|(fault, rank)| FaultState::new(fault, seed, rank, &experiment));
                let faults = faults.collect();
                let faulty = FaultyConnection { from: place, to: counts[0], faults };
                faulty_connections[to.component].push(faulty);
                place = Place::next(Type::Float64, &mut counts);
            }
            let extrapolated =
                extrapolation.extrapolate(components, connection, place, &mut counts);
            place = extrapolated.unwrap_or(place);
            let component = Some(from.component);
            let group = VariableGroup::entry(&mut groups, components, *to);
            group.inputs.push(to.fmu(components), to.scalar);
            let connection = || format!("{} -> {}", from.name(components), to.name(components));
            let sized = to.variable(components).max_size.map(|_| connection());
            group.sources.push(InputSource { component, place, conversion: *conversion, sized });
            if from.is_clocked(components) {
                unset.push((*to, place, *conversion));
            }
            if from.is_clocked(components) || to.is_clocked(components) {
                continue;
            }
            let feeding = FeedingOutputs::entry(&mut feeding[to.component], components, *from);
            feeding.outputs.push(from.fmu(components), from.scalar);
            feeding.places.push(place);
        }
        let mut feed = |id: ScalarId| {
            let group = VariableGroup::entry(&mut groups, components, id);
            let place = Place::next(group.access_type, &mut counts);
            group.inputs.push(id.fmu(components), id.scalar);
            let sized = id.variable(components).max_size.map(|_| id.name(components));
            group.sources.push(InputSource { component: None, place, conversion: None, sized });
            place
        };
        let table = input.iter().flat_map(|input| &input.inputs).map(|column| column.to);
        let table_places = table.map(&mut feed).collect();
        let host_places = host_inputs.iter().copied().map(feed).collect();
        groups.iter_mut().for_each(|groups| groups[0].find_direct_values());
        let is_plain = input.is_none()
            && faulty_connections.iter().all(Vec::is_empty)
            && extrapolation.is_empty()
            && recorded_before.others.is_empty()
            && recorded_after.others.is_empty()
            && held.is_empty()
            && groups.iter().all(|groups| groups.len() == 1 && groups[0].is_plain());
        Self {
            groups,
            feeding,
            counts,
            recorded_before,
            recorded_after,
            recorded_at_ticks,
            clocked_columns,
            recorded_clocks,
            held,
            samples_at_ticks,
            unset,
            faulty_connections,
            extrapolation,
            output_places,
            table_places,
            host_places,
            is_plain,
        }
    }
}
