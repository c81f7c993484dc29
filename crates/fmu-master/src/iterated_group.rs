//! Groups of components that feed each other in a loop and are iterated, as a plan finds them.
//!
//! In a group, the inputs from components that are not listed before take guesses of their outputs. The group is iterated
//! until these outputs equal the guesses, within a tolerance; `simulation/iteration.rs` has the details.

use anyhow::{Result, bail, ensure};
use fmu_description::{Type, Value};

use crate::algebraic_loop::{self, strongly_connected};
use crate::clocked_stage::ClockedStage;
use crate::components::{LoadedComponent, ScalarId};
use crate::connections::ResolvedConnection;
use crate::store::Place;
use crate::wiring::{FeedingOutputs, Wiring};
use crate::{AlgebraicLoops, Description, Order};

/// What steps in turn, or at once in parallel order.
pub(crate) enum Stage {
    /// A component, by its index.
    Component(usize),
    /// A group, by its index.
    Group(usize),
    /// The components with clocks.
    Clocked,
}

/// The turns of stepping, and the groups.
#[derive(Default)]
pub(crate) struct Schedule {
    pub(crate) stages: Vec<Stage>,
    pub(crate) groups: Vec<IteratedGroup>,
    pub(crate) clocked: Option<ClockedStage>,
}

/// Components that feed each other.
pub(crate) struct IteratedGroup {
    /// Their indices, in their order.
    pub(crate) components: Vec<usize>,
    /// The outputs that are guessed.
    pub(crate) guesses: Vec<Guess>,
    /// The guessed outputs, as they are read during the initialization.
    pub(crate) guessed: Vec<FeedingOutputs>,
    /// For each component, the places in the store from which its inputs take guesses, and the indices of these.
    pub(crate) entries: Vec<Vec<(Place, usize)>>,
    /// Whether the loop is closed at communication points, by setting inputs and getting outputs. Else the components
    /// repeat their steps.
    pub(crate) is_at_points: bool,
    /// How derivatives pass through the components, if all provide them.
    pub(crate) derivatives: Option<Vec<ComponentDerivatives>>,
    /// The relative tolerance, and the largest number of evaluations.
    pub(crate) tolerance: f64,
    pub(crate) limit: u32,
}

/// An output that is guessed.
pub(crate) struct Guess {
    pub(crate) name: String,
    pub(crate) place: Place,
    pub(crate) of_type: Type,
    /// The size of its values, if it is a real number.
    pub(crate) scale: Option<f64>,
}

impl Guess {
    /// A guess of a real number, in the type of the output.
    pub(crate) fn typed(&self, number: f64) -> Value {
        match self.of_type {
            Type::Float32 => Value::Float32(number as f32),
            _ => Value::Float64(number),
        }
    }
}

/// The derivatives of the outputs of a component of a group with respect to its inputs. Signals are the guesses that are
/// real numbers, then outputs.
pub(crate) struct ComponentDerivatives {
    pub(crate) component: usize,
    /// The inputs that other signals feed, these signals, and the factors of the connections.
    pub(crate) knowns: Vec<u32>,
    pub(crate) sources: Vec<(usize, f64)>,
    /// The outputs, and the first of the signals that they are.
    pub(crate) unknowns: Vec<u32>,
    pub(crate) first: usize,
    /// The guesses of outputs, by their numbers among the real ones and the signals that they must equal.
    pub(crate) guessed: Vec<(usize, usize)>,
}

/// The relative tolerance of iterated loops.
const TOLERANCE: f64 = 1e-6;
/// The largest number of evaluations in one iteration.
const LIMIT: u32 = 50;

impl Schedule {
    /// Finds the groups that a system iterates.
    ///
    /// # Errors
    /// There is an algebraic loop that must not be, or a component of a group cannot repeat a step.
    pub(crate) fn new(
        description: &Description,
        components: &[LoadedComponent],
        connections: &[ResolvedConnection],
        clocked: Option<ClockedStage>,
        wiring: &Wiring,
    ) -> Result<Self> {
        let loops = description.algebraic_loops()?;
        let is_member = |component: usize| components[component].is_clocked();
        // Among components with clocks, values pass at ticks.
        let is_outside =
            |c: &&ResolvedConnection| !(is_member(c.from.component) && is_member(c.to.component));
        let connections = &*Vec::from_iter(connections.iter().filter(is_outside).cloned());
        let Description { order, loop_tolerance, loop_iterations, .. } = *description;
        crate::components::check_tolerance("loop_tolerance", loop_tolerance)?;
        ensure!(loop_iterations != Some(0), "loop_iterations = 0, expected at least 1");
        if order == Order::Parallel {
            ensure!(
                loops != AlgebraicLoops::Iterate,
                "algebraic_loops = \"iterate\" and order = \"parallel\", expected another order, as parallel order delays all loops by one step"
            );
            let others = (0..components.len()).filter(|index| !is_member(*index));
            let of_clocks = clocked.iter().map(|_| Stage::Clocked);
            let stages = others.map(Stage::Component).chain(of_clocks).collect();
            return Ok(Self { stages, groups: Vec::new(), clocked });
        }
        let on_loops = algebraic_loop::on_loops(components, connections);
        let all = connections.iter().zip(&on_loops);
        let is_iterated = |(connection, on_loop): (&ResolvedConnection, &Option<usize>)| {
            (order == Order::Implicit && !components[connection.to.component].sampled)
                || (loops == AlgebraicLoops::Iterate && on_loop.is_some())
        };
        if loops == AlgebraicLoops::Refuse {
            let open = all.clone().filter(|pair| !is_iterated(*pair));
            let open = Vec::from_iter(open.filter_map(|(_, on_loop)| *on_loop));
            let refused = all.clone().filter(|(_, l)| l.is_some_and(|l| open.contains(&l)));
            let refused = Vec::from_iter(refused.map(|(connection, _)| connection.clone()));
            algebraic_loop::check(components, &refused)?;
        }
        let mut fed = vec![Vec::new(); components.len()];
        for (connection, _) in all.filter(|pair| is_iterated(*pair)) {
            fed[connection.from.component].push(connection.to.component);
        }
        let parts = strongly_connected(&fed);
        let mut members = vec![Vec::new(); components.len()];
        parts.iter().enumerate().for_each(|(component, part)| members[*part].push(component));
        let mut schedule = Self { clocked, ..Self::default() };
        for (component, part) in parts.iter().enumerate() {
            let members = &members[*part];
            if let Some(member) = members.iter().find(|member| is_member(**member)) {
                ensure!(
                    members.len() == 1,
                    "{} has clocks and is in an algebraic loop with components without clocks, which cannot be iterated",
                    components[*member].name
                );
                if schedule.stages.iter().all(|stage| !matches!(stage, Stage::Clocked)) {
                    schedule.stages.push(Stage::Clocked);
                }
            } else if members.len() == 1 && !fed[component].contains(&component) {
                schedule.stages.push(Stage::Component(component));
            } else if members[0] == component {
                schedule.stages.push(Stage::Group(schedule.groups.len()));
                let group =
                    IteratedGroup::new(members, description, components, connections, wiring)?;
                schedule.groups.push(group);
            }
        }
        Ok(schedule)
    }
}

impl IteratedGroup {
    fn new(
        members: &[usize],
        description: &Description,
        components: &[LoadedComponent],
        connections: &[ResolvedConnection],
        wiring: &Wiring,
    ) -> Result<Self> {
        let inner = connections.iter().filter(|connection| {
            let ends = [connection.from.component, connection.to.component];
            ends.iter().all(|end| members.binary_search(end).is_ok())
        });
        let inner = Vec::from_iter(inner);
        let is_back = |c: &&&ResolvedConnection| c.from.component >= c.to.component;
        let mut ids = Vec::from_iter(inner.iter().filter(is_back).map(|c| c.from));
        ids.sort_by_key(|id| (id.component, id.scalar));
        ids.dedup();
        let guesses = ids.iter().map(|id| {
            let of_type = id.access_type(components);
            let scale = of_type.is_float().then(|| id.fmu(components).nominal(id.scalar));
            Guess { name: id.name(components), place: wiring.output_places[id], of_type, scale }
        });
        let guesses = Vec::from_iter(guesses);
        let mut guessed = Vec::new();
        for (id, guess) in ids.iter().zip(&guesses) {
            let outputs = FeedingOutputs::entry(&mut guessed, components, *id);
            outputs.outputs.push(id.fmu(components), id.scalar);
            outputs.places.push(guess.place);
        }
        let entries = members.iter().map(|&to| {
            let feeding = wiring.feeding[to].iter().filter(|feeding| feeding.component >= to);
            let pairs = feeding.flat_map(|feeding| {
                let outputs = feeding.outputs.scalars.iter().zip(&feeding.places);
                outputs.filter_map(|(&scalar, &place)| {
                    let id = ScalarId { component: feeding.component, scalar };
                    Some((place, ids.iter().position(|known| *known == id)?))
                })
            });
            pairs.collect()
        });
        let is_faulty = inner.iter().any(|connection| !connection.faults.is_empty());
        let integrates = members.iter().all(|member| components[*member].integrates());
        let group = Self {
            entries: entries.collect(),
            guessed,
            is_at_points: description.order != Order::Implicit && integrates && !is_faulty,
            derivatives: match is_faulty {
                true => None,
                false => ComponentDerivatives::of_group(members, components, &inner, &ids),
            },
            components: members.to_vec(),
            guesses,
            tolerance: description.loop_tolerance.unwrap_or(TOLERANCE),
            limit: description.loop_iterations.unwrap_or(LIMIT),
        };
        for member in members {
            let LoadedComponent { name, fmu, rate, .. } = &components[*member];
            ensure!(
                rate.every == 1,
                "{name} has a step of {:?} s, expected at most the communication step to iterate {}",
                rate.step,
                group.name()
            );
            ensure!(
                wiring.extrapolation.inputs[*member].is_empty(),
                "{name} extrapolates its inputs, expected inputs = \"held\" to iterate {}",
                group.name()
            );
            if group.is_at_points {
                continue;
            }
            if let Some(reason) = fmu.unsavable() {
                bail!(
                    "{name} ({}) cannot repeat a step to iterate {}: {reason}",
                    fmu.file_name(),
                    group.name()
                );
            }
        }
        Ok(group)
    }

    /// What the group is called.
    pub(crate) fn name(&self) -> String {
        let names = Vec::from_iter(self.guesses.iter().map(|guess| &*guess.name));
        format!("the loop of {}", names.join(", "))
    }

    /// The scales of the real numbers among the guesses.
    pub(crate) fn scales(&self) -> Vec<f64> {
        self.guesses.iter().filter_map(|guess| guess.scale).collect()
    }
}

impl ComponentDerivatives {
    /// The derivatives in a group, if all of its FMUs provide them for its connections.
    fn of_group(
        members: &[usize],
        components: &[LoadedComponent],
        inner: &[&ResolvedConnection],
        guessed: &[ScalarId],
    ) -> Option<Vec<Self>> {
        let is_scalar = |id: ScalarId| {
            let variable = id.variable(components);
            variable.of_type.is_float() && variable.element_count() == 1
        };
        let reals = || guessed.iter().filter(|id| id.access_type(components).is_float());
        let is_known = inner.iter().flat_map(|c| [c.from, c.to]).all(is_scalar)
            && members.iter().all(|member| components[*member].fmu.is_directional);
        if !is_known {
            return None;
        }
        // The signals of outputs that were passed.
        let mut passed: Vec<ScalarId> = Vec::new();
        let count = reals().count();
        let mut all = Vec::new();
        for &component in members {
            let fed = inner.iter().filter(|connection| connection.to.component == component);
            let (knowns, sources) = fed
                .map(|ResolvedConnection { from, to, conversion, .. }| {
                    let signal = match from.component >= component {
                        true => reals().position(|id| id == from),
                        false => passed.iter().position(|id| id == from).map(|i| count + i),
                    };
                    let factor = conversion.map_or(1.0, |conversion| conversion.factor);
                    Some((to.variable(components).reference, (signal?, factor)))
                })
                .collect::<Option<(Vec<_>, Vec<_>)>>()?;
            let first = count + passed.len();
            let mut outputs = Vec::from_iter(inner.iter().map(|connection| connection.from));
            outputs.retain(|id| id.component == component);
            outputs.sort_by_key(|id| id.scalar);
            outputs.dedup();
            let own = reals().enumerate().filter(|(_, id)| id.component == component);
            let signal = |id: &ScalarId| outputs.iter().position(|output| output == id);
            let guessed = own.filter_map(|(i, id)| Some((i, first + signal(id)?))).collect();
            let unknowns = outputs.iter().map(|id| id.variable(components).reference).collect();
            passed.extend(outputs);
            all.push(Self { component, knowns, sources, unknowns, first, guessed });
        }
        Some(all)
    }
}
