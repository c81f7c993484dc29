//! Which components of a system take adaptive steps, and how their errors are measured.

use std::collections::{HashMap, HashSet};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::Variability;

use crate::components::{LoadedComponent, ScalarId, check_tolerance};
use crate::connections::ResolvedConnection;
use crate::iterated_group::{Schedule, Stage};
use crate::wiring::Wiring;
use crate::{Description, Order, Place};

/// Adaptive steps, as a plan finds them.
pub(crate) struct AdaptivePlan {
    pub(crate) smallest: f64,
    pub(crate) tolerance: f64,
    /// The components that are not sampled, in their order.
    pub(crate) components: Vec<usize>,
    /// The places of their outputs that are measured, and their nominal values.
    pub(crate) outputs: Vec<(Place, f64)>,
}

/// The inputs, or the first elements of arrays, that get outputs from before a step.
fn late_inputs(
    order: Order,
    components: &[LoadedComponent],
    connections: &[ResolvedConnection],
    schedule: &Schedule,
) -> HashSet<ScalarId> {
    let mut turns: HashMap<usize, (usize, bool)> = HashMap::new();
    for (turn, stage) in schedule.stages.iter().enumerate() {
        match stage {
            Stage::Component(index) => drop(turns.insert(*index, (turn, false))),
            // Refused with adaptive steps.
            Stage::Clocked => {}
            Stage::Group(number) => {
                let members = &schedule.groups[*number].components;
                turns.extend(members.iter().map(|member| (*member, (turn, true))));
            }
        }
    }
    let is_late = |connection: &&ResolvedConnection| {
        let [from, to] = [connection.from, connection.to].map(|id| turns.get(&id.component));
        let is_iterated = from == to && to.is_some_and(|(_, is_iterated)| *is_iterated);
        order == Order::Parallel || (from >= to && !is_iterated)
    };
    let late = connections.iter().filter(is_late).map(|connection| connection.to);
    late.map(|id| ScalarId { scalar: id.fmu(components).first(id.scalar), ..id }).collect()
}

/// The smallest step, relative to the communication step.
const SMALLEST: f64 = 1e-6;

impl AdaptivePlan {
    /// The adaptive steps of a system, if it has a tolerance for them.
    ///
    /// # Errors
    /// A component cannot repeat a step, or has a step of its own.
    pub(crate) fn new(
        description: &Description,
        components: &[LoadedComponent],
        connections: &[ResolvedConnection],
        schedule: &Schedule,
        wiring: &Wiring,
    ) -> Result<Option<Self>> {
        let Description { step, step_tolerance, min_step, .. } = *description;
        check_tolerance("step_tolerance", step_tolerance)?;
        ensure!(
            min_step.is_none_or(|smallest| smallest > 0.0 && smallest <= step),
            "min_step = {:?}, expected a positive number up to step = {step:?}",
            min_step.unwrap_or_default()
        );
        let Some(tolerance) = step_tolerance else { return Ok(None) };
        let all = components.iter().enumerate();
        let adaptive = all.filter(|(_, component)| !component.sampled);
        let adaptive = Vec::from_iter(adaptive.map(|(index, _)| index));
        for component in adaptive.iter().map(|index| &components[*index]) {
            let name = &component.name;
            let savable = component.check_savable(false);
            savable.with_context(|| format!("{name} cannot take adaptive steps"))?;
            ensure!(
                component.rate.is_of_system(),
                "{name} has a step of its own, {:?} s, expected none with a step_tolerance",
                component.rate.step
            );
        }
        for stage in &schedule.stages {
            let Stage::Group(number) = stage else { continue };
            let group = &schedule.groups[*number];
            let mut sampled = group.components.iter().filter(|index| components[**index].sampled);
            if let Some(sampled) = sampled.next() {
                let (name, group) = (&components[*sampled].name, group.name());
                bail!(
                    "{name} is sampled and in {group}, expected a loop without samples with a step_tolerance"
                );
            }
        }
        let late = late_inputs(description.order, components, connections, schedule);
        let is_late = |id: &ScalarId| {
            let fmu = id.fmu(components);
            let inputs = fmu.feedthrough.get(&fmu.first(id.scalar)).into_iter().flatten();
            inputs.into_iter().any(|&scalar| late.contains(&ScalarId { scalar, ..*id }))
        };
        let continuous = wiring.output_places.iter().filter(|(id, _)| {
            let variable = id.variable(components);
            adaptive.binary_search(&id.component).is_ok()
                && variable.of_type.is_float()
                && variable.variability == Variability::Continuous
        });
        let continuous = Vec::from_iter(continuous);
        // An output that follows a late input at once is as late: its error is that of the output that feeds the input.
        let has_others = continuous.iter().any(|(id, _)| !is_late(id));
        let measured = continuous.iter().filter(|(id, _)| !(has_others && is_late(id)));
        let measured = measured.map(|(id, place)| (**place, id.fmu(components).nominal(id.scalar)));
        let outputs = measured.collect();
        let smallest = min_step.unwrap_or(SMALLEST * step);
        Ok(Some(Self { smallest, tolerance, components: adaptive, outputs }))
    }
}
