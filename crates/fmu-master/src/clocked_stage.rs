//! The components with clocks, as a plan finds them: one stage of the schedule, which advances from tick to tick.
//!
//! Components with clocks are co-simulation FMUs of FMI 3.0 that use event mode. At an instant, a component is evaluated
//! after those that feed it. In a cycle, the one whose ticking clock has the smallest priority is first, and of equal ones
//! the one that the system lists first. `simulation/clocked.rs` has the rest.

use std::collections::{HashMap, HashSet};

use anyhow::{Result, bail, ensure};
use fmu_description::{Causality, ClockType, IntervalVariability, Value, Variability, Variable};

use crate::algebraic_loop::strongly_connected;
use crate::components::{LoadedComponent, ScalarId};
use crate::connections::ResolvedConnection;
use crate::input_table::InputTable;
use crate::rate::Inputs;
use crate::store::Place;
use crate::ticks::Ticks;
use crate::wiring::Wiring;
use crate::{Description, Note, Order};

/// The components with clocks.
pub(crate) struct ClockedStage {
    /// In the order of the system.
    pub(crate) members: Vec<Member>,
    /// The members in the order of stepping: those that may return early come first, so that the others step no further.
    pub(crate) stepping: Vec<usize>,
}

/// A component with clocks.
pub(crate) struct Member {
    pub(crate) component: usize,
    /// Whether its model partitions are activated, in scheduled execution.
    pub(crate) is_scheduled: bool,
    /// Its place in the order of evaluation; the members of a cycle have the same one.
    pub(crate) level: usize,
    pub(crate) inputs: Vec<InputClock>,
    /// The output clocks that something depends on.
    pub(crate) outputs: Vec<OutputClock>,
    /// Whether an input without clocks is not continuous, so that it is set in event mode.
    pub(crate) has_discrete_inputs: bool,
    /// The places of those of these inputs that other members feed.
    pub(crate) watched: Vec<Place>,
    /// The recorded clocks, by value reference, and their places.
    pub(crate) recorded: Vec<(u32, Place)>,
}

/// A clock that the master ticks.
pub(crate) struct InputClock {
    pub(crate) reference: u32,
    pub(crate) name: String,
    pub(crate) of_type: ClockType,
    /// Of clocks that tick at the same time, the smallest comes first.
    pub(crate) priority: u32,
    /// When the input table ticks it (s), if it is a triggered clock.
    pub(crate) given: Vec<f64>,
    /// The triggered clocks that tick with it: the number of the member, and the value reference.
    pub(crate) targets: Vec<(usize, u32)>,
}

impl InputClock {
    /// Goes on to the tick after the one that is due until a time (s).
    pub(crate) fn tick(&self, ticks: &mut Ticks, time: f64) {
        match self.given.is_empty() {
            true => ticks.tick(),
            false => {
                let next = self.given.partition_point(|given| *given <= time);
                *ticks = Ticks::Next(self.given.get(next).copied());
            }
        }
    }
}

/// A clock that the FMU ticks.
pub(crate) struct OutputClock {
    pub(crate) reference: u32,
    /// As those of an input clock.
    pub(crate) targets: Vec<(usize, u32)>,
}

impl Member {
    /// The clocks, by value reference, with the triggered clocks that tick with them.
    pub(crate) fn triggers(&self) -> impl Iterator<Item = (u32, &[(usize, u32)])> {
        let inputs = self.inputs.iter().map(|clock| (clock.reference, &*clock.targets));
        inputs.chain(self.outputs.iter().map(|clock| (clock.reference, &*clock.targets)))
    }
}

impl ClockedStage {
    /// Finds the components with clocks, if there are any, and checks their clocks. `connections` connect values, and
    /// `triggers` connect clocks.
    ///
    /// # Errors
    /// A clock would never tick, or has an invalid interval, or a component is run in a way that clocks do not support.
    pub(crate) fn new(
        description: &Description,
        components: &[LoadedComponent],
        connections: &[ResolvedConnection],
        triggers: &[ResolvedConnection],
        table: Option<&InputTable>,
        wiring: &Wiring,
    ) -> Result<Option<Self>> {
        let clocked = (0..components.len()).filter(|index| components[*index].is_clocked());
        let clocked = Vec::from_iter(clocked);
        if clocked.is_empty() {
            return Ok(None);
        }
        check_way_of_running(description, components, connections, &clocked)?;
        let number = |component: usize| clocked.binary_search(&component).ok();
        let mut edges = vec![Vec::new(); clocked.len()];
        for ResolvedConnection { from, to, .. } in connections.iter().chain(triggers) {
            if let (Some(from), Some(to)) = (number(from.component), number(to.component)) {
                edges[from].push(to);
            }
        }
        // Parts are numbered against the direction of the edges.
        let parts = strongly_connected(&edges);
        let last = parts.iter().copied().max().unwrap_or(0);
        let mut targets: HashMap<ScalarId, Vec<(usize, u32)>> = HashMap::new();
        for ResolvedConnection { from, to, .. } in triggers {
            let target = (number(to.component), to.variable(components).reference);
            targets.entry(*from).or_default().extend(target.0.map(|member| (member, target.1)));
        }
        let mut members = Vec::new();
        for (member, &component) in clocked.iter().enumerate() {
            let loaded = &components[component];
            let (inputs, outputs) = clocks(component, loaded, &targets, table, wiring)?;
            let is_scheduled = loaded.fmu.is_scheduled();
            ensure!(
                !is_scheduled || !inputs.is_empty(),
                "{} has no input clock, expected one for each model partition of scheduled execution",
                loaded.name
            );
            let is_event = |scalar: &usize| {
                let variable = loaded.fmu.variable(*scalar);
                !is_scheduled
                    && variable.clocks.is_empty()
                    && variable.variability != Variability::Continuous
            };
            let groups = &wiring.groups[component];
            let discrete = groups.iter().flat_map(|group| {
                let pairs = group.inputs.scalars.iter().zip(&group.sources);
                pairs.filter(|(scalar, _)| is_event(scalar)).map(|(_, source)| source)
            });
            let discrete = Vec::from_iter(discrete);
            let watched = discrete.iter().filter(|s| s.component.and_then(number).is_some());
            members.push(Member {
                component,
                is_scheduled,
                // Priorities decide.
                level: if is_scheduled { 0 } else { last - parts[member] },
                inputs,
                outputs,
                has_discrete_inputs: !discrete.is_empty(),
                watched: watched.map(|source| source.place).collect(),
                recorded: wiring.recorded_clocks[component].clone(),
            });
        }
        check_triggers(description, components, connections, triggers, table)?;
        let mut stepping = Vec::from_iter(0..members.len());
        stepping.sort_by_key(|member| !components[clocked[*member]].fmu.may_return_early);
        Ok(Some(Self { members, stepping }))
    }
}

/// The clocks of a component that its FMU and the master tick; `targets` are the triggered clocks that tick
/// with others.
fn clocks(
    component: usize,
    loaded: &LoadedComponent,
    targets: &HashMap<ScalarId, Vec<(usize, u32)>>,
    table: Option<&InputTable>,
    wiring: &Wiring,
) -> Result<(Vec<InputClock>, Vec<OutputClock>)> {
    // The clocks at whose ticks something is got.
    let groups = wiring.groups[component].iter();
    let got = groups.filter(|group| !group.outputs.references.is_empty());
    let mut used = HashSet::<u32>::from_iter(got.flat_map(|group| group.clocks.iter().copied()));
    used.extend(wiring.recorded_clocks[component].iter().map(|(reference, _)| *reference));
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    for scalar in 0..loaded.fmu.scalars.len() {
        let variable = loaded.fmu.variable(scalar);
        let (Some(of_type), reference) = (variable.clock, variable.reference) else { continue };
        let targets = targets.get(&ScalarId { component, scalar }).cloned();
        match variable.causality {
            Causality::Input => {
                let name = loaded.name_of(scalar);
                check_timing(&name, &of_type)?;
                let priority = of_type.priority.unwrap_or(u32::MAX);
                let given = table.map(|table| table.ticks(ScalarId { component, scalar }));
                let given = given.unwrap_or_default();
                let targets = targets.unwrap_or_default();
                inputs.push(InputClock { reference, name, of_type, priority, given, targets });
            }
            // In scheduled execution, the FMU says only once that a clock ticks.
            Causality::Output
                if loaded.fmu.is_scheduled() || targets.is_some() || used.contains(&reference) =>
            {
                outputs.push(OutputClock { reference, targets: targets.unwrap_or_default() });
            }
            _ => {}
        }
    }
    Ok((inputs, outputs))
}

/// Checks what the model description says of the ticks of an input clock.
fn check_timing(name: &str, clock: &ClockType) -> Result<()> {
    let kind = clock.interval_variability;
    ensure!(
        kind != IntervalVariability::Constant || clock.interval.is_some(),
        "{name} is a constant clock without intervalDecimal, expected a positive number of seconds"
    );
    if let Some(interval) = clock.interval.filter(|_| kind.is_periodic()) {
        ensure!(
            interval > 0.0 && interval.is_finite(),
            "{name} is a clock with the interval {interval:?} s, expected a positive number"
        );
    }
    ensure!(
        clock.shift >= 0.0 && clock.shift.is_finite(),
        "{name} is a clock with the shift {:?} s, expected 0 or a positive number",
        clock.shift
    );
    Ok(())
}

/// Checks that the system is run in a way that its components with clocks support.
fn check_way_of_running(
    description: &Description,
    components: &[LoadedComponent],
    connections: &[ResolvedConnection],
    clocked: &[usize],
) -> Result<()> {
    let name = &components[clocked[0]].name;
    let is_refused = [
        (description.order == Order::Implicit, "order = \"implicit\""),
        (description.step_tolerance.is_some(), "step_tolerance"),
        (description.save_state.is_some(), "a state that is saved"),
        (description.load_state.is_some(), "a state that is loaded"),
    ];
    if let Some((_, what)) = is_refused.into_iter().find(|(is_refused, _)| *is_refused) {
        bail!("{name} has clocks, which {what} does not support");
    }
    for index in clocked {
        let LoadedComponent { name, rate, inputs, .. } = &components[*index];
        ensure!(
            rate.is_of_system(),
            "{name} has clocks and a step of its own, {:?} s, expected none, as its steps end at ticks",
            rate.step
        );
        ensure!(
            *inputs == Inputs::Held,
            "{name} has clocks and extrapolates its inputs, expected inputs = \"held\""
        );
    }
    let are_clocked = |connection: &&ResolvedConnection| {
        let ends = [connection.from.component, connection.to.component];
        ends.iter().all(|end| clocked.binary_search(end).is_ok())
    };
    let faulty = connections.iter().filter(are_clocked).find(|c| !c.faults.is_empty());
    if let Some(ResolvedConnection { from, to, .. }) = faulty {
        let [from, to] = [from, to].map(|id| id.name(components));
        bail!("{from} -> {to} has faults, which act between components without clocks only");
    }
    Ok(())
}

/// Checks that every triggered clock of a system may tick at some time: something must tick it that does not only tick
/// because it has ticked itself. Clocks whose start value is false are meant never to tick, and so are those of terminals of
/// networks that are not connected; a single FMU may be run with such clocks.
fn check_triggers(
    description: &Description,
    components: &[LoadedComponent],
    connections: &[ResolvedConnection],
    triggers: &[ResolvedConnection],
    table: Option<&InputTable>,
) -> Result<()> {
    let unused = unused_ports(components, connections, triggers);
    let sources: HashMap<ScalarId, ScalarId> = triggers.iter().map(|t| (t.to, t.from)).collect();
    let triggered = Vec::from_iter(triggered(components));
    for id in &triggered {
        let loaded = &components[id.component];
        let start = loaded.starts.iter().rev().find(|(scalar, _)| *scalar == id.scalar);
        let is_meant = matches!(start, Some((_, Value::Clock(false))));
        ensure!(
            start.is_none() || is_meant,
            "{} = true cannot be set: a triggered clock ticks with an output clock that is connected to it or by the input table, or has the start value false to say that it never ticks",
            id.name(components)
        );
        ensure!(
            sources.contains_key(id)
                || is_given(table, id)
                || is_meant
                || unused.contains(id)
                || description.is_single,
            "nothing ticks {}: it is a triggered clock, expected a connection from an output clock, a column of the input table, or the start value false if it is never to tick",
            id.name(components)
        );
    }
    // The triggered clocks that may tick, more and more of them.
    let mut may_tick = HashSet::new();
    loop {
        let known = may_tick.len();
        for id in &triggered {
            let source = sources.get(id).copied();
            if source.is_none_or(|source| may_output_tick(components, source, &may_tick)) {
                may_tick.insert(*id);
            }
        }
        if may_tick.len() == known {
            break;
        }
    }
    let waiting = Vec::from_iter(triggered.iter().filter(|id| !may_tick.contains(*id)));
    if waiting.is_empty() {
        return Ok(());
    }
    let names = waiting.iter().filter_map(|id| {
        let source = sources.get(*id)?;
        Some(format!("{} -> {}", source.name(components), id.name(components)))
    });
    bail!(
        "cycle of triggered clocks, each of which ticks only if another one does: {}",
        Vec::from_iter(names).join(", ")
    )
}

/// The variables of the terminals of networks of which none is connected.
fn unused_ports(
    components: &[LoadedComponent],
    connections: &[ResolvedConnection],
    triggers: &[ResolvedConnection],
) -> HashSet<ScalarId> {
    let ends = connections.iter().chain(triggers).flat_map(|each| [each.from, each.to]);
    let connected = HashSet::<ScalarId>::from_iter(ends);
    let mut unused = HashSet::new();
    for (component, loaded) in components.iter().enumerate() {
        let terminals = loaded.fmu.terminals().unwrap_or_default();
        for terminal in terminals.iter().filter(|terminal| terminal.is_network()) {
            let found = terminal.variables().filter_map(|name| loaded.fmu.scalar(name).ok());
            let port = Vec::from_iter(found.map(|scalar| ScalarId { component, scalar }));
            if !port.iter().any(|id| connected.contains(id)) {
                unused.extend(port);
            }
        }
    }
    unused
}

/// The triggered clocks of the components that nothing ticks, though nothing says that they are never to tick.
pub(crate) fn note(
    components: &[LoadedComponent],
    connections: &[ResolvedConnection],
    triggers: &[ResolvedConnection],
    table: Option<&InputTable>,
) -> Option<Note> {
    let is_ticked = |id: &ScalarId| triggers.iter().any(|t| t.to == *id) || is_given(table, id);
    let is_meant = |id: &ScalarId| {
        components[id.component].starts.iter().any(|(scalar, _)| *scalar == id.scalar)
    };
    let mut idle =
        Vec::from_iter(triggered(components).filter(|id| !is_ticked(id) && !is_meant(id)));
    if !idle.is_empty() {
        let unused = unused_ports(components, connections, triggers);
        idle.retain(|id| !unused.contains(id));
    }
    let names = Vec::from_iter(idle.iter().map(|id| id.name(components)));
    (!names.is_empty()).then_some(Note::NeverTick(names))
}

/// Whether the input table ticks a clock.
fn is_given(table: Option<&InputTable>, clock: &ScalarId) -> bool {
    table.is_some_and(|table| table.scalars().any(|id| id == *clock))
}

/// The triggered clocks of the components that run with clocks.
fn triggered(components: &[LoadedComponent]) -> impl Iterator<Item = ScalarId> {
    let clocked = components.iter().enumerate().filter(|(_, loaded)| loaded.is_clocked());
    let clocks = clocked.flat_map(|(component, loaded)| {
        loaded.fmu.clocks().map(move |scalar| ScalarId { component, scalar })
    });
    clocks.filter(|id| is_triggered_input(id.variable(components)))
}

/// Whether an output clock may tick, if of the triggered clocks only these may.
fn may_output_tick(
    components: &[LoadedComponent],
    output: ScalarId,
    may_tick: &HashSet<ScalarId>,
) -> bool {
    let ScalarId { component, scalar } = output;
    let fmu = &components[component].fmu;
    let clocks_of = |scalar: usize| {
        let clocks = &fmu.variable(scalar).clocks;
        Vec::from_iter(clocks.iter().filter_map(|reference| fmu.clock(*reference)))
    };
    let clock_may = |scalar: usize| {
        let id = ScalarId { component, scalar };
        !is_triggered_input(id.variable(components)) || may_tick.contains(&id)
    };
    let may = |scalar: usize| match clocks_of(scalar) {
        clocks if clocks.is_empty() => clock_may(scalar),
        clocks => clocks.into_iter().any(clock_may),
    };
    let dependencies = match clocks_of(scalar) {
        clocks if clocks.is_empty() => fmu.feedthrough.get(&scalar).cloned().unwrap_or_default(),
        clocks => clocks,
    };
    dependencies.is_empty() || dependencies.into_iter().any(may)
}

/// Whether a variable is a clock that the master ticks with another one.
pub(crate) fn is_triggered_input(variable: &Variable) -> bool {
    variable.causality == Causality::Input
        && variable.clock.is_some_and(|clock| !clock.interval_variability.is_time_based())
}
