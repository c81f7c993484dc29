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
    let variable = |id: ScalarId| variable(components, id);
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
                        "algebraic loop in which each output depends directly on the previous one: {}; parallel order breaks the loop with a delay of one step, and allow_algebraic_loops = true runs it anyway; algebraic_loops = \"iterate\" solves it in each step",
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

/// The first element of an array, whose elements all depend on the same inputs, or a scalar.
fn variable(components: &[LoadedComponent], id: ScalarId) -> ScalarId {
    ScalarId { scalar: id.fmu(components).first(id.scalar), ..id }
}

/// For each connection on an algebraic loop, the number of the loop or of loops that have outputs in common.
pub(crate) fn on_loops(
    components: &[LoadedComponent],
    connections: &[ResolvedConnection],
) -> Vec<Option<usize>> {
    let variable = |id: ScalarId| variable(components, id);
    let mut nodes = HashMap::new();
    for connection in connections {
        let next = nodes.len();
        nodes.entry(variable(connection.from)).or_insert(next);
    }
    let mut dependent: HashMap<ScalarId, Vec<usize>> = HashMap::new();
    for (output, node) in &nodes {
        let known = &output.fmu(components).feedthrough;
        for &scalar in known.get(&output.scalar).into_iter().flatten() {
            dependent.entry(ScalarId { scalar, ..*output }).or_default().push(*node);
        }
    }
    let successors = |connection: &ResolvedConnection| {
        dependent.get(&variable(connection.to)).into_iter().flatten().copied()
    };
    let mut edges = vec![Vec::new(); nodes.len()];
    for connection in connections {
        edges[nodes[&variable(connection.from)]].extend(successors(connection));
    }
    let parts = strongly_connected(&edges);
    let part = |connection: &ResolvedConnection| {
        let part = parts[nodes[&variable(connection.from)]];
        successors(connection).any(|next| parts[next] == part).then_some(part)
    };
    connections.iter().map(part).collect()
}

/// For each node of a directed graph, the number of its strongly connected part (R. Tarjan, 1972).
pub(crate) fn strongly_connected(edges: &[Vec<usize>]) -> Vec<usize> {
    /// The number of a node that was not found, and of a part that is not complete.
    const NONE: usize = usize::MAX;
    let mut found = vec![NONE; edges.len()];
    let mut lowest = vec![NONE; edges.len()];
    let mut part = vec![NONE; edges.len()];
    let (mut count, mut parts) = (0, 0);
    // The nodes on the way with the edges that were followed, and the nodes of parts that are not complete.
    let (mut path, mut open) = (Vec::new(), Vec::new());
    for root in 0..edges.len() {
        let mut next = (found[root] == NONE).then_some(root);
        while next.is_some() || !path.is_empty() {
            if let Some(node) = next.take() {
                (found[node], lowest[node]) = (count, count);
                count += 1;
                path.push((node, 0));
                open.push(node);
            }
            let Some((node, followed)) = path.last_mut() else { break };
            let node = *node;
            if let Some(&successor) = edges[node].get(*followed) {
                *followed += 1;
                match (found[successor], part[successor]) {
                    (NONE, _) => next = Some(successor),
                    (earlier, NONE) => lowest[node] = lowest[node].min(earlier),
                    _ => {}
                }
                continue;
            }
            path.pop();
            if let Some((parent, _)) = path.last() {
                lowest[*parent] = lowest[*parent].min(lowest[node]);
            }
            if lowest[node] == found[node] {
                while part[node] == NONE
                    && let Some(member) = open.pop()
                {
                    part[member] = parts;
                }
                parts += 1;
            }
        }
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_reach_each_other_are_one_part() {
        let edges =
            [vec![1], vec![2, 3], vec![0], vec![4], vec![5], vec![4], vec![6], vec![0, 6], vec![]];
        let part = strongly_connected(&edges);
        // Independently: whether each of two nodes reaches the other.
        let reaches = |from: usize, to: usize| {
            let (mut seen, mut next) = (HashSet::from([from]), vec![from]);
            while let Some(node) = next.pop() {
                next.extend(edges[node].iter().copied().filter(|node| seen.insert(*node)));
            }
            seen.contains(&to)
        };
        for a in 0..edges.len() {
            for b in 0..edges.len() {
                assert_eq!(part[a] == part[b], reaches(a, b) && reaches(b, a), "{a} {b} {part:?}");
            }
        }
    }
}
