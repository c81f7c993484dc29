//! Iterated groups in a run: an evaluation sets guesses of outputs, and has the components compute these outputs.
//!
//! A group is evaluated in one of three ways. During the initialization, and at communication points of a group of model
//! exchange, inputs are set and outputs are got. Else the components step, from the state that they had before: the
//! inputs of the step are then the outputs after it, as in an implicit method.

use fmu_description::Value;

use super::{Simulation, Snapshot};
use crate::RunError;
use crate::component_instance::{CallResult, get_feeding_outputs};
use crate::iterated_group::IteratedGroup;
use crate::quasi_newton::{Equations, Knowledge, QuasiNewton, Solution};

/// What a run keeps of an iterated group.
pub(super) struct Iteration {
    solver: QuasiNewton,
    /// The state before a step, unless the group is iterated at communication points.
    before: Option<Snapshot>,
    /// The guesses.
    guesses: Vec<Value>,
    /// Whether it was solved, so that the solver knows a first guess.
    is_solved: bool,
}

/// How a group is evaluated.
#[derive(Clone, Copy)]
enum Evaluation {
    /// In initialization mode.
    Initial,
    /// At a communication point.
    AtPoint,
    /// By the step from communication point `k` at a time (s), of a size (s).
    Step { k: u64, time: f64, step: f64 },
}

impl Simulation<'_> {
    /// Prepares the iterations.
    ///
    /// # Errors
    /// The state of a component cannot be saved.
    pub(super) fn prepare_iterations(&mut self) -> anyhow::Result<()> {
        for group in &self.plan.schedule.groups {
            let before = match group.is_at_points {
                true => None,
                false => Some(self.snapshot_of(&group.components)?),
            };
            let solver = QuasiNewton::new(group.tolerance, group.limit, group.scales());
            let guesses = vec![Value::Boolean(false); group.guesses.len()];
            self.iterations.push(Iteration { solver, before, guesses, is_solved: false });
        }
        Ok(())
    }

    /// Takes the step of a group: repeats it until its inputs are the outputs after it, or closes the loop at both
    /// communication points.
    pub(super) fn advance_group(
        &mut self,
        number: usize,
        k: u64,
        time: f64,
        step: f64,
    ) -> CallResult {
        let group = &self.plan.schedule.groups[number];
        if !group.is_at_points {
            return self.iterate(number, Evaluation::Step { k, time, step });
        }
        self.iterate(number, Evaluation::AtPoint)?;
        for &index in &group.components {
            self.feed_component(index, k, time, step)?;
        }
        for &index in &group.components {
            self.step_component(index, k, time, step)?;
            self.read_component(index, k, time + step)?;
        }
        self.iterate(number, Evaluation::AtPoint)
    }

    /// Solves the equations of a group in initialization mode.
    pub(super) fn iterate_initially(&mut self, number: usize) -> CallResult {
        self.iterate(number, Evaluation::Initial)
    }

    /// Iterates a group until its outputs are the guesses.
    fn iterate(&mut self, number: usize, evaluation: Evaluation) -> CallResult {
        let group = &self.plan.schedule.groups[number];
        if let (Evaluation::Step { .. }, Some(before)) =
            (evaluation, self.iterations[number].before)
        {
            self.save(before)?;
        }
        if let Evaluation::Initial = evaluation {
            get_feeding_outputs(&mut self.components, &group.guessed, &mut self.outputs)?;
        }
        for (guess, output) in self.iterations[number].guesses.iter_mut().zip(&group.guesses) {
            *guess = self.outputs.value(output.place);
        }
        let mut solver = std::mem::take(&mut self.iterations[number].solver);
        let reals = group.guesses.iter().filter(|output| output.scale.is_some());
        let first = match std::mem::take(&mut self.iterations[number].is_solved) {
            true => Vec::from_iter(solver.refined()),
            false => reals.map(|output| self.outputs.number(output.place)).collect(),
        };
        let mut equations =
            GroupEquations { simulation: self, group, number, evaluation, is_first: true };
        let solved = solver.solve(&mut equations, first);
        self.iterations[number].solver = solver;
        let reason = match solved? {
            Solution::Found => {
                self.iterations[number].is_solved = true;
                return Ok(());
            }
            Solution::NotFound { index, residual } => {
                let mut reals = group.guesses.iter().filter(|guess| guess.scale.is_some());
                let name = reals.nth(index).map_or("", |guess| &guess.name);
                format!("{name} still differs by {residual:.3e} from its guess")
            }
            Solution::NotSettled => {
                let others = group.guesses.iter().filter(|guess| guess.scale.is_none());
                let names = Vec::from_iter(others.map(|guess| &*guess.name));
                format!("{} still changes", names.join(" or "))
            }
        };
        let (name, limit) = (group.name(), group.limit);
        let when = match evaluation {
            Evaluation::Initial => "during the initialization".to_owned(),
            Evaluation::AtPoint => "at a communication point".to_owned(),
            Evaluation::Step { time, step, .. } => {
                format!("in the step of {step:?} s from t = {time:?} s")
            }
        };
        let text = format!("{name} is not solved after {limit} iterations {when}: {reason}");
        Err(Box::new(RunError::without_call(text, None)))
    }
}

/// The equations of a group: guessed outputs, and the outputs that follow from them.
struct GroupEquations<'s, 'a> {
    simulation: &'s mut Simulation<'a>,
    group: &'a IteratedGroup,
    number: usize,
    evaluation: Evaluation,
    /// Whether there was no evaluation yet.
    is_first: bool,
}

impl GroupEquations<'_, '_> {
    fn evaluate_initially(&mut self) -> CallResult {
        let Self { simulation, group, number, .. } = self;
        let Simulation { plan, components, outputs, iterations, .. } = &mut **simulation;
        for (&index, entries) in group.components.iter().zip(&group.entries) {
            get_feeding_outputs(components, &plan.wiring.feeding[index], outputs)?;
            for (place, guess) in entries {
                outputs.set(*place, iterations[*number].guesses[*guess].clone());
            }
            components[index].write_initially(outputs)?;
        }
        get_feeding_outputs(components, &group.guessed, outputs)?;
        Ok(())
    }

    fn set_guesses(&mut self) {
        let guesses = &self.simulation.iterations[self.number].guesses;
        for (guess, output) in guesses.iter().zip(&self.group.guesses) {
            self.simulation.outputs.set(output.place, guess.clone());
        }
    }

    fn evaluate_at_point(&mut self) -> CallResult {
        self.set_guesses();
        let Simulation { components, outputs, .. } = &mut *self.simulation;
        self.group.components.iter().try_for_each(|&index| {
            components[index].write::<false>(outputs)?;
            components[index].read::<false>(outputs)
        })
    }

    fn evaluate_step(&mut self, k: u64, time: f64, step: f64) -> CallResult {
        if let Some(before) = self.simulation.iterations[self.number].before
            && !self.is_first
        {
            self.simulation.restore(before)?;
        }
        self.set_guesses();
        self.group
            .components
            .iter()
            .try_for_each(|&index| self.simulation.advance_component(index, k, time, step))
    }
}

impl Equations for GroupEquations<'_, '_> {
    type Error = Box<RunError>;

    fn evaluate(&mut self, x: &[f64], result: &mut [f64]) -> CallResult {
        let guesses = &mut self.simulation.iterations[self.number].guesses;
        let reals = self.group.guesses.iter().zip(guesses);
        let reals = reals.filter(|(output, _)| output.scale.is_some());
        reals.zip(x).for_each(|((output, guess), x)| *guess = output.typed(*x));
        match self.evaluation {
            Evaluation::Initial => self.evaluate_initially()?,
            Evaluation::AtPoint => self.evaluate_at_point()?,
            Evaluation::Step { k, time, step } => self.evaluate_step(k, time, step)?,
        }
        self.is_first = false;
        let reals = self.group.guesses.iter().filter(|output| output.scale.is_some());
        let outputs = &self.simulation.outputs;
        result.iter_mut().zip(reals).for_each(|(result, output)| {
            *result = outputs.number(output.place);
        });
        Ok(())
    }

    fn settle(&mut self) -> bool {
        let Simulation { iterations, outputs, .. } = &mut *self.simulation;
        let guesses = iterations[self.number].guesses.iter_mut().zip(&self.group.guesses);
        let mut is_settled = true;
        for (guess, output) in guesses.filter(|(_, output)| output.scale.is_none()) {
            let value = outputs.value(output.place);
            is_settled &= *guess == value;
            *guess = value;
        }
        is_settled
    }

    fn knowledge(&self) -> Knowledge {
        match (&self.group.derivatives, self.evaluation) {
            (None, _) => Knowledge::Nothing,
            // Within a step, inputs change the states, too.
            (Some(_), Evaluation::Step { .. }) => Knowledge::Estimate,
            (Some(_), _) => Knowledge::Exact,
        }
    }

    fn derivatives(&mut self, matrix: &mut [f64]) -> CallResult {
        let all = self.group.derivatives.iter().flatten();
        let n = self.group.guesses.iter().filter(|output| output.scale.is_some()).count();
        let signals = all.clone().map(|component| component.unknowns.len()).sum::<usize>() + n;
        for column in 0..n {
            let mut signals = vec![0.0; signals];
            signals[column] = 1.0;
            for part in all.clone() {
                let seed = part.sources.iter().map(|(signal, factor)| factor * signals[*signal]);
                let seed = Vec::from_iter(seed);
                let results = &mut signals[part.first..part.first + part.unknowns.len()];
                if seed.iter().any(|seed| *seed != 0.0) {
                    let component = &mut self.simulation.components[part.component];
                    component.call(
                        "get_directional_derivative",
                        "directional derivative",
                        |i| {
                            i.get_directional_derivative(
                                &part.unknowns,
                                &part.knowns,
                                &seed,
                                results,
                            )
                        },
                    )?;
                }
                for (row, signal) in &part.guessed {
                    matrix[row * n + column] = signals[*signal];
                }
            }
        }
        Ok(())
    }
}
