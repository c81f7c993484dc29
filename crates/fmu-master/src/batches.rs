//! Which components may step at the same time: the batches of a communication step.

use crate::Order;
use crate::connections::ResolvedConnection;
use crate::iterated_group::Stage;

/// The batches of a communication step, whose components do not depend on each other's steps. One by one, a component
/// steps after those before it that feed it, and not before those before it that it feeds, as these get its outputs before
/// its step. There are none if loops are iterated, or components have clocks.
pub(crate) fn batches(
    order: Order,
    turns: &[Stage],
    connections: &[ResolvedConnection],
) -> Vec<Vec<usize>> {
    let turns = turns.iter().map(|turn| match turn {
        Stage::Component(index) => Some(*index),
        Stage::Group(_) | Stage::Clocked => None,
    });
    let turns: Option<Vec<usize>> = turns.collect();
    let Some(turns) = turns else { return Vec::new() };
    if order == Order::Parallel {
        let mut all = turns;
        all.sort_unstable();
        return vec![all];
    }
    let mut place = vec![0; turns.len()];
    turns.iter().enumerate().for_each(|(turn, component)| place[*component] = turn);
    let feeds = connections.iter().map(|c| (place[c.from.component], place[c.to.component]));
    let mut feeds = Vec::from_iter(feeds.filter(|(from, to)| from != to));
    feeds.sort_unstable_by_key(|(from, to)| *from.max(to));
    // The batch of each turn.
    let mut batch = vec![0; turns.len()];
    for (from, to) in feeds {
        let least = if from < to { batch[from] + 1 } else { batch[to] };
        let later = from.max(to);
        batch[later] = least.max(batch[later]);
    }
    let count = batch.iter().max().map_or(0, |last| last + 1);
    let mut batches = vec![Vec::new(); count];
    turns.iter().zip(batch).for_each(|(component, batch)| batches[batch].push(*component));
    batches
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::components::ScalarId;

    /// The batches of components that are connected from one to another.
    fn of(order: Order, turns: &[usize], feeds: &[(usize, usize)]) -> Vec<Vec<usize>> {
        let id = |component| ScalarId { component, scalar: 0 };
        let connections = feeds.iter().map(|(from, to)| ResolvedConnection {
            from: id(*from),
            to: id(*to),
            conversion: None,
            faults: Vec::new(),
        });
        let turns = Vec::from_iter(turns.iter().map(|index| Stage::Component(*index)));
        batches(order, &turns, &Vec::from_iter(connections))
    }

    #[test]
    fn a_component_steps_after_those_before_it_that_feed_it() {
        use Order::{Parallel, Sequential};
        let feeds = [(0, 2), (1, 2), (2, 3), (3, 0), (3, 1)];
        assert_eq!(of(Parallel, &[0, 1, 2, 3], &feeds), [vec![0, 1, 2, 3]]);
        assert_eq!(of(Sequential, &[0, 1, 2, 3], &feeds), [vec![0, 1], vec![2], vec![3]]);
        assert_eq!(of(Sequential, &[0, 1, 2], &[]), [vec![0, 1, 2]]);
        // Component 1 feeds 0, which gets the output of the last step: they may step at the same time.
        assert_eq!(of(Sequential, &[0, 1], &[(1, 0)]), [vec![0, 1]]);
        assert_eq!(of(Sequential, &[1, 0], &[(1, 0)]), [vec![1], vec![0]]);
        // Component 2 must not step before 1 has got its output, which steps after 0.
        assert_eq!(of(Sequential, &[0, 1, 2], &[(0, 1), (2, 1)]), [vec![0], vec![1, 2]]);
        assert_eq!(of(Sequential, &[0], &[(0, 0)]), [vec![0]]);
    }

    #[test]
    fn loops_that_are_iterated_have_no_batches() {
        assert!(batches(Order::Implicit, &[Stage::Group(0)], &[]).is_empty());
    }
}
