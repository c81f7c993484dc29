//! Algebraic loops: outputs that each depend directly on the next one through connections.

use std::collections::{HashMap, HashSet};

use anyhow::{Result, bail};

use crate::components::{LoadedComponent, ScalarId};
use crate::connections::ResolvedConnection;

/// Rejects loops of outputs that each depend directly on the next, which no order of stepping can
/// solve. An output without declared dependencies counts as depending on no input, since most such
/// outputs change only during a step.
pub(crate) fn check(
    components: &[LoadedComponent],
    connections: &[ResolvedConnection],
) -> Result<()> {
    // All elements of an array depend on the same inputs.
    let variable =
        |id: ScalarId| ScalarId { scalar: components[id.component].fmu.first(id.scalar), ..id };
    let mut feeding: HashMap<ScalarId, Vec<ScalarId>> = HashMap::new();
    for connection in connections {
        feeding.entry(variable(connection.to)).or_default().push(connection.from);
    }
    let sources = |output: ScalarId| {
        let known = &output.fmu(components).feedthrough;
        let inputs = known.get(&variable(output).scalar).into_iter().flatten();
        let inputs = inputs.map(|&scalar| ScalarId { scalar, ..output });
        let sources = inputs.filter_map(|input| feeding.get(&input)).flatten().copied();
        Vec::from_iter(sources).into_iter()
    };
    // The outputs on the way, with those that feed them and are not yet followed.
    let mut path = Vec::new();
    let (mut followed, mut settled) = (HashSet::new(), HashSet::new());
    for connection in connections {
        let mut next = Some(connection.from);
        loop {
            if let Some(output) = next.filter(|output| !settled.contains(&variable(*output))) {
                if !followed.insert(variable(output)) {
                    let ids = path.iter().map(|(id, _)| *id);
                    let ids = ids.skip_while(|id| variable(*id) != variable(output));
                    let ids = Vec::from_iter(ids.chain([output]));
                    let names = ids.iter().rev().map(|id| id.name(components));
                    bail!(
                        "algebraic loop in which each output depends directly on the previous one: {}; parallel order breaks the loop with a delay of one step, and allow_algebraic_loops = true runs it anyway",
                        Vec::from_iter(names).join(" -> ")
                    );
                }
                path.push((output, sources(output)));
            }
            let Some((output, rest)) = path.last_mut() else { break };
            next = rest.next();
            if next.is_none() {
                settled.insert(variable(*output));
                path.pop();
            }
        }
    }
    Ok(())
}
