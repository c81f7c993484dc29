//! The Jacobian of a system, and the memory of an implicit method. States of which no two change the same derivative
//! form a group, whose columns one evaluation gives (A. R. Curtis, M. J. D. Powell and J. K. Reid, On the estimation of
//! sparse Jacobian matrices, J. Inst. Maths Applics 13, 1974).

use alloc::vec;
use alloc::vec::Vec;

use super::lu;
use crate::rodas5p::STAGES;

/// What an implicit method remembers of a point, and its memory for a step.
#[derive(Clone)]
pub(super) struct Linearization {
    /// Whether the derivatives are those of the point from which the next internal step starts.
    pub(super) is_current: bool,
    /// The derivatives by the states, row by row, and by the time.
    jacobian: Vec<f64>,
    pub(super) by_time: Vec<f64>,
    /// The groups of states; empty if each state is a group.
    groups: Vec<Group>,
    /// A direction of the states, and the change of each of them.
    pub(super) direction: Vec<f64>,
    pub(super) stages: [Vec<f64>; STAGES],
    factors: Vec<f64>,
    pivots: Vec<usize>,
}

/// States of which no two change the same derivative.
#[derive(Clone, Default)]
struct Group {
    states: Vec<usize>,
    /// The elements of the Jacobian: rows and columns.
    elements: Vec<(usize, usize)>,
}

impl Linearization {
    /// Memory for a number of states. `dependencies` has the states on which each derivative depends; without, each
    /// depends on all.
    pub(super) fn new(states: usize, dependencies: Option<&[Vec<usize>]>) -> Self {
        let zeros = |count| vec![0.0; count];
        Self {
            is_current: false,
            jacobian: zeros(states * states),
            by_time: zeros(states),
            groups: dependencies.map_or_else(Vec::new, |rows| groups(states, rows)),
            direction: zeros(states),
            stages: core::array::from_fn(|_| zeros(states)),
            factors: zeros(states * states),
            pivots: vec![0; states],
        }
    }

    /// The number of evaluations that give the Jacobian.
    pub(super) fn group_count(&self) -> usize {
        if self.groups.is_empty() { self.pivots.len() } else { self.groups.len() }
    }

    /// The states of a group.
    pub(super) fn group(&self, index: usize) -> impl Iterator<Item = usize> + use<'_> {
        let single = self.groups.is_empty().then_some(index);
        let states = self.groups.get(index).map_or(&[][..], |group| &group.states);
        single.into_iter().chain(states.iter().copied())
    }

    /// Sets the columns of a group from what its direction, with a change for each of its states, does to the
    /// derivatives.
    pub(super) fn set_columns(&mut self, index: usize, change: impl Fn(usize) -> f64) {
        let n = self.pivots.len();
        let Self { jacobian, direction, groups, .. } = self;
        let mut set = |row: usize, column: usize| {
            jacobian[row * n + column] = change(row) / direction[column];
        };
        match groups.get(index) {
            Some(group) => group.elements.iter().for_each(|(row, column)| set(*row, *column)),
            None => (0..n).for_each(|row| set(row, index)),
        }
    }

    /// Prepares to solve equations with the matrix `diagonal` on the diagonal, minus the Jacobian. Returns false if it
    /// is singular.
    pub(super) fn factorize(&mut self, diagonal: f64) -> bool {
        let n = self.pivots.len();
        let negated = self.factors.iter_mut().zip(&self.jacobian);
        negated.for_each(|(factor, element)| *factor = -element);
        (0..n).for_each(|i| self.factors[i * n + i] += diagonal);
        lu::factorize(&mut self.factors, &mut self.pivots)
    }

    /// Solves the equations of a stage, which has their right side.
    pub(super) fn solve(&mut self, stage: usize) {
        lu::solve(&self.factors, &self.pivots, &mut self.stages[stage]);
    }
}

/// Puts each state into the first group in which it changes no derivative that another one changes.
fn groups(states: usize, dependencies: &[Vec<usize>]) -> Vec<Group> {
    let mut rows_of = vec![Vec::new(); states];
    for (row, columns) in dependencies.iter().enumerate() {
        columns.iter().for_each(|column| rows_of[*column].push(row));
    }
    let (mut groups, mut changed): (Vec<Group>, Vec<Vec<bool>>) = Default::default();
    for (state, rows) in rows_of.iter().enumerate() {
        let free = changed.iter().position(|changed| rows.iter().all(|row| !changed[*row]));
        let index = free.unwrap_or_else(|| {
            groups.push(Group::default());
            changed.push(vec![false; states]);
            changed.len() - 1
        });
        groups[index].states.push(state);
        groups[index].elements.extend(rows.iter().map(|row| (*row, state)));
        rows.iter().for_each(|row| changed[index][*row] = true);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_groups_are_enough_for_neighbours_in_a_line() {
        let neighbours = |i: usize| Vec::from_iter(i.saturating_sub(1)..(i + 2).min(100));
        let dependencies = Vec::from_iter((0..100).map(neighbours));
        let mut linearization = Linearization::new(100, Some(&dependencies));
        assert_eq!(linearization.group_count(), 3);
        assert_eq!(Linearization::new(100, None).group_count(), 100);
        // f[i] = (i + 1) (x[i - 1] + x[i] + x[i + 1]), by differences of 1e-3 times the number of the state.
        for group in 0..3 {
            let mut change = vec![0.0; 100];
            for state in linearization.group(group) {
                change[state] = 1e-3 * (state + 1) as f64;
            }
            linearization.direction.clone_from(&change);
            let sum = |i: usize| neighbours(i).iter().map(|j| change[*j]).sum::<f64>();
            linearization.set_columns(group, |row| (row + 1) as f64 * sum(row));
        }
        for (row, columns) in dependencies.iter().enumerate() {
            for column in 0..100 {
                let expected = if columns.contains(&column) { (row + 1) as f64 } else { 0.0 };
                let found = linearization.jacobian[row * 100 + column];
                assert!((found - expected).abs() < 1e-12 * expected.max(1.0), "{row}, {column}");
            }
        }
    }
}
