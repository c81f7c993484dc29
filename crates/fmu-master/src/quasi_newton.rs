//! A quasi-Newton method for equations `G(x) = x`, which also converges where repeating `G` does not.
//!
//! The Jacobian matrix of the residual `G(x) - x` is minus the identity at first, so that the first step repeats `G`.
//! Broyden's formula improves it with each evaluation; it is kept from one solution to the next. If the residual
//! decreases slowly, the matrix is computed anew: from derivatives, if they are known exactly, else by differences. (C. T.
//! Kelley, *Solving Nonlinear Equations with Newton's Method*, SIAM 2003, chapters 1, 2 and 4; MINPACK's `hybrd`
//! computes the matrix anew in the same way.)

use ode_methods::solver::lu;

/// Equations `G(x) = x`. Besides the numbers `x`, there may be others, such as Booleans, which are only repeated.
pub(crate) trait Equations {
    type Error;

    /// Computes `G(x)`.
    fn evaluate(&mut self, x: &[f64], result: &mut [f64]) -> Result<(), Self::Error>;

    /// Whether the other values that the last evaluation has computed are those that it began with; if not, the next
    /// evaluation begins with the computed ones.
    fn settle(&mut self) -> bool;

    /// What is known of the derivatives of `G` without further evaluations.
    fn knowledge(&self) -> Knowledge;

    /// Computes what is known of them where `G` was evaluated last: row by row, one for each result.
    fn derivatives(&mut self, matrix: &mut [f64]) -> Result<(), Self::Error>;
}

/// What is known of the derivatives of equations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Knowledge {
    Nothing,
    /// Good enough for a first matrix.
    Estimate,
    Exact,
}

/// A residual decreases slowly if it is more than this part of the last one.
const SLOW: f64 = 0.5;
/// So many slow decreases in a row make differences worth their evaluations.
const PATIENCE: u32 = 2;
/// The relative size of differences, which the rounding of an FMU with a solver of its own leaves meaningful.
const DIFFERENCE: f64 = 1e-4;

/// The solver of some equations, whose memory is reused.
#[derive(Default)]
pub(crate) struct QuasiNewton {
    /// The relative error of the solution; a number smaller than its scale counts as large as that.
    tolerance: f64,
    scales: Vec<f64>,
    /// The largest number of evaluations, besides those for differences.
    limit: u32,
    /// The Jacobian matrix of the residual, row by row, whether it was computed, and whether it has changed at all.
    matrix: Vec<f64>,
    is_computed: bool,
    is_known: bool,
    /// The points with the smallest residual and of the last evaluation.
    best: Point,
    last: Point,
    direction: Vec<f64>,
    factors: Vec<f64>,
    pivots: Vec<usize>,
}

/// A point at which the equations were evaluated.
#[derive(Default)]
struct Point {
    x: Vec<f64>,
    residual: Vec<f64>,
}

impl Point {
    fn new(n: usize) -> Self {
        Self { x: vec![0.0; n], residual: vec![0.0; n] }
    }

    fn copy_from(&mut self, other: &Self) {
        self.x.copy_from_slice(&other.x);
        self.residual.copy_from_slice(&other.residual);
    }
}

/// The outcome of a solution.
#[derive(Debug, PartialEq)]
pub(crate) enum Solution {
    /// It was found in the last evaluation.
    Found,
    /// It was not found; the residual is largest for this number, and has this value.
    NotFound { index: usize, residual: f64 },
    /// Numbers are found, but not the others.
    NotSettled,
}

impl QuasiNewton {
    /// A solver with a relative tolerance, for numbers with these scales.
    pub(crate) fn new(tolerance: f64, limit: u32, scales: Vec<f64>) -> Self {
        let n = scales.len();
        let mut matrix = vec![0.0; n * n];
        (0..n).for_each(|i| matrix[i * n + i] = -1.0);
        Self {
            tolerance,
            scales,
            limit,
            factors: matrix.clone(),
            pivots: vec![0; n],
            matrix,
            is_computed: false,
            is_known: false,
            best: Point::new(n),
            last: Point::new(n),
            direction: vec![0.0; n],
        }
    }

    /// Solves the equations from a first guess. If the solution is found, the last evaluation was there, so that all that
    /// it computed belongs to the solution.
    ///
    /// # Errors
    /// An evaluation fails.
    pub(crate) fn solve<E: Equations>(
        &mut self,
        equations: &mut E,
        guess: impl IntoIterator<Item = f64>,
    ) -> Result<Solution, E::Error> {
        self.last.x.iter_mut().zip(guess).for_each(|(x, guess)| *x = guess);
        let (mut slow, mut rejected) = (0, 0);
        let mut is_settled = true;
        for evaluation in 0..self.limit {
            self.evaluate(equations)?;
            is_settled = equations.settle();
            let norm = self.norm(&self.last, &self.last);
            if norm <= 1.0 && is_settled && (self.is_known || norm == 0.0) {
                self.best.copy_from(&self.last);
                self.turn();
                if self.error() <= 1.0 {
                    return Ok(Solution::Found);
                }
            }
            let is_first = evaluation == 0;
            if is_first {
                self.best.copy_from(&self.last);
            }
            let [norm, best] = [&self.last, &self.best]
                .map(|point| self.norm(point, &self.last).min(self.norm(point, &self.best)));
            let is_slow = !is_first && norm > SLOW * best;
            if !is_first && is_settled {
                self.learn();
            }
            // A change of other values changes the equations.
            let is_accepted = is_first || !is_settled || norm < best;
            if is_accepted {
                self.best.copy_from(&self.last);
            }
            rejected = if is_accepted { 0 } else { rejected + 1 };
            slow = if is_slow { slow + 1 } else { 0 };
            let knowledge = equations.knowledge();
            let patience = if knowledge == Knowledge::Exact { 1 } else { PATIENCE };
            let begins = !self.is_computed && knowledge != Knowledge::Nothing;
            if slow >= patience || begins {
                self.compute(equations, is_accepted, begins || knowledge == Knowledge::Exact)?;
                slow = 0;
            }
            self.turn();
            // The first rejected step has improved the matrix, unless it was infinite.
            let halvings = if norm.is_finite() { rejected - rejected.min(1) } else { rejected };
            let part = 0.5_f64.powi(halvings);
            let moved = self.last.x.iter_mut().zip(&self.best.x).zip(&self.direction);
            moved.for_each(|((x, best), direction)| *x = best + part * direction);
        }
        let relative = |i: &usize| self.relative(&self.best, &self.best, *i);
        let worst =
            (0..self.scales.len()).reduce(|a, b| if relative(&b) > relative(&a) { b } else { a });
        Ok(match worst {
            Some(index) if is_settled || relative(&index) > 1.0 => {
                Solution::NotFound { index, residual: self.best.residual[index] }
            }
            _ => Solution::NotSettled,
        })
    }

    /// Evaluates the equations at the last point.
    fn evaluate<E: Equations>(&mut self, equations: &mut E) -> Result<(), E::Error> {
        let Point { x, residual } = &mut self.last;
        equations.evaluate(x, residual)?;
        residual.iter_mut().zip(x).for_each(|(residual, x)| *residual -= *x);
        Ok(())
    }

    /// A residual of a point, relative to the one that is allowed for the size of a number at another one; infinite if it
    /// is not a number.
    fn relative(&self, point: &Point, other: &Point, index: usize) -> f64 {
        let allowed = self.tolerance * other.x[index].abs().max(self.scales[index]);
        let relative = (point.residual[index] / allowed).abs();
        if relative.is_nan() { f64::INFINITY } else { relative }
    }

    /// The largest of these residuals.
    fn norm(&self, point: &Point, other: &Point) -> f64 {
        (0..self.scales.len()).map(|index| self.relative(point, other, index)).fold(0.0, f64::max)
    }

    /// The error of the best point, relative to the one that is allowed, as the direction estimates it: it is larger than
    /// the residual if the matrix is almost singular.
    fn error(&self) -> f64 {
        let Self { best, direction, scales, tolerance, .. } = self;
        let errors = direction
            .iter()
            .zip(&best.x)
            .zip(scales)
            .map(|((direction, x), scale)| direction.abs() / (tolerance * x.abs().max(*scale)));
        errors.fold(0.0, f64::max)
    }

    /// What a solution that was found is, by the last direction, even more precisely: a first guess of the next one.
    pub(crate) fn refined(&self) -> impl Iterator<Item = f64> {
        self.best.x.iter().zip(&self.direction).map(|(x, direction)| x + direction)
    }

    /// Improves the matrix by Broyden's formula with the step from the best point to `x`, in which numbers count by their
    /// scales.
    fn learn(&mut self) {
        let Self { matrix, last, best, scales, direction: step, .. } = self;
        step.iter_mut().zip(&last.x).zip(&best.x).for_each(|((step, x), best)| *step = x - best);
        let squares =
            step.iter().zip(&*scales).map(|(step, scale)| (step / scale) * (step / scale));
        let square: f64 = squares.sum();
        if !(square > 0.0 && square.is_finite()) {
            return;
        }
        let residuals = last.residual.iter().zip(&best.residual);
        for (row, (last, best)) in matrix.chunks_exact_mut(scales.len()).zip(residuals) {
            let expected: f64 = row.iter().zip(&*step).map(|(a, step)| a * step).sum();
            let change = last - best - expected;
            if !change.is_finite() {
                continue;
            }
            for (a, (step, scale)) in row.iter_mut().zip(step.iter().zip(&*scales)) {
                *a += change * (step / (scale * scale)) / square;
            }
        }
        self.is_known = true;
    }

    /// Computes the matrix at the best point: by what is known of derivatives, or by differences. Whether the point was
    /// evaluated last is known.
    fn compute<E: Equations>(
        &mut self,
        equations: &mut E,
        is_last: bool,
        by_derivatives: bool,
    ) -> Result<(), E::Error> {
        let n = self.scales.len();
        self.last.x.copy_from_slice(&self.best.x);
        if by_derivatives {
            if !is_last {
                self.evaluate(equations)?;
            }
            equations.derivatives(&mut self.matrix)?;
            (0..n).for_each(|i| self.matrix[i * n + i] -= 1.0);
        } else {
            for j in 0..n {
                let size = DIFFERENCE * self.best.x[j].abs().max(self.scales[j]);
                self.last.x[j] += size;
                self.evaluate(equations)?;
                for i in 0..n {
                    let change = self.last.residual[i] - self.best.residual[i];
                    self.matrix[i * n + j] = change / size;
                }
                self.last.x[j] = self.best.x[j];
            }
        }
        (self.is_computed, self.is_known) = (true, true);
        Ok(())
    }

    /// Turns the direction to the solution, as seen from the best point.
    fn turn(&mut self) {
        self.factors.copy_from_slice(&self.matrix);
        let negative = self.direction.iter_mut().zip(&self.best.residual);
        negative.for_each(|(direction, residual)| *direction = -residual);
        let is_regular = lu::factorize(&mut self.factors, &mut self.pivots);
        if is_regular {
            lu::solve(&self.factors, &self.pivots, &mut self.direction);
        }
        if !is_regular || self.direction.iter().any(|value| !value.is_finite()) {
            // Without a direction, `G` is repeated.
            self.direction.copy_from_slice(&self.best.residual);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    /// Equations with or without derivatives, and the number of their evaluations.
    struct Counted<G, D> {
        results: G,
        derivatives: Option<D>,
        evaluations: usize,
        last: Vec<f64>,
    }

    impl<G: Fn(&[f64]) -> Vec<f64>, D: Fn(&[f64]) -> Vec<f64>> Equations for Counted<G, D> {
        type Error = Infallible;

        fn evaluate(&mut self, x: &[f64], result: &mut [f64]) -> Result<(), Infallible> {
            self.evaluations += 1;
            self.last = x.to_vec();
            result.copy_from_slice(&(self.results)(x));
            Ok(())
        }

        fn settle(&mut self) -> bool {
            true
        }

        fn knowledge(&self) -> Knowledge {
            if self.derivatives.is_some() { Knowledge::Exact } else { Knowledge::Nothing }
        }

        fn derivatives(&mut self, matrix: &mut [f64]) -> Result<(), Infallible> {
            matrix.copy_from_slice(&self.derivatives.as_ref().unwrap()(&self.last));
            Ok(())
        }
    }

    type Derivatives = fn(&[f64]) -> Vec<f64>;

    fn counted<G: Fn(&[f64]) -> Vec<f64>>(results: G) -> Counted<G, Derivatives> {
        Counted { results, derivatives: None, evaluations: 0, last: Vec::new() }
    }

    /// The solution from zeros, if it is found.
    fn solve<E: Equations<Error = Infallible>>(
        equations: &mut E,
        solver: &mut QuasiNewton,
    ) -> Option<Vec<f64>> {
        let zeros = vec![0.0; solver.scales.len()];
        let Ok(solution) = solver.solve(equations, zeros);
        (solution == Solution::Found).then(|| solver.last.x.clone())
    }

    #[test]
    fn a_linear_loop_of_any_gain_is_solved() {
        for gain in [-1e6, -20.0, -1.0, -0.5, 0.0, 0.99, 1.01, 3.0, 1e6] {
            let mut equations = counted(|x| vec![gain * x[0] + 2.0]);
            let mut solver = QuasiNewton::new(1e-9, 50, vec![1.0]);
            let x = solve(&mut equations, &mut solver).unwrap_or_else(|| panic!("{gain}"))[0];
            let expected = 2.0 / (1.0 - gain);
            assert!((x - expected).abs() <= 1e-8 * expected.abs().max(1.0), "{gain}: {x}");
            assert!(equations.evaluations <= 5, "{gain}: {} evaluations", equations.evaluations);
            // The matrix is kept for the next solution: one step, and one evaluation to see that it is there.
            equations.evaluations = 0;
            assert!(solve(&mut equations, &mut solver).is_some());
            assert!(equations.evaluations <= 2, "{gain}: {} evaluations", equations.evaluations);
        }
    }

    #[test]
    fn linear_loops_of_several_numbers_are_solved() {
        // x = M x + b with eigenvalues inside and outside of the unit circle, and rotations.
        let m = [[3.0, -1.0, 0.5], [2.0, 0.1, -4.0], [1.0, 5.0, -2.0]];
        let b = [1.0, -2.0, 0.5];
        let mut equations = counted(|x| {
            let row = |i: usize| b[i] + (0..3).map(|j| m[i][j] * x[j]).sum::<f64>();
            vec![row(0), row(1), row(2)]
        });
        let x = solve(&mut equations, &mut QuasiNewton::new(1e-10, 50, vec![1.0; 3])).unwrap();
        for i in 0..3 {
            let result = b[i] + (0..3).map(|j| m[i][j] * x[j]).sum::<f64>();
            assert!((result - x[i]).abs() < 1e-9, "{x:?}");
        }
    }

    #[test]
    fn newtons_method_converges_quadratically_with_derivatives() {
        // The solution of x = 4 cos(x) nearest to zero, from a table of roots: bisected to 1e-15.
        let (mut low, mut high) = (1.0_f64, 1.5_f64);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if 4.0 * middle.cos() > middle { low = middle } else { high = middle }
        }
        let derivatives = |x: &[f64]| vec![-4.0 * x[0].sin()];
        let mut equations = Counted {
            results: |x: &[f64]| vec![4.0 * x[0].cos()],
            derivatives: Some(derivatives),
            evaluations: 0,
            last: Vec::new(),
        };
        let mut solver = QuasiNewton::new(1e-12, 50, vec![1.0]);
        let Ok(solution) = solver.solve(&mut equations, [1.0]);
        assert_eq!(solution, Solution::Found);
        assert!((solver.last.x[0] - low).abs() < 1e-11, "{} {low}", solver.last.x[0]);
        assert!(equations.evaluations <= 8, "{}", equations.evaluations);
    }

    #[test]
    fn a_step_into_the_undefined_is_shortened() {
        // The square root is NaN beyond 5; the solution is (sqrt(21) - 1) / 2 = 1.791...
        let mut equations = counted(|x| vec![(5.0 - x[0]).sqrt()]);
        let mut solver = QuasiNewton::new(1e-10, 50, vec![1.0]);
        let Ok(solution) = solver.solve(&mut equations, [-40.0]);
        assert_eq!(solution, Solution::Found);
        assert!(
            (solver.last.x[0] - 0.5 * (21_f64.sqrt() - 1.0)).abs() < 1e-9,
            "{}",
            solver.last.x[0]
        );
    }

    #[test]
    fn a_loop_without_a_solution_has_a_residual() {
        let mut equations = counted(|x| vec![x[0] + 1.0, 0.5 * x[1]]);
        let mut solver = QuasiNewton::new(1e-6, 20, vec![1.0; 2]);
        let Ok(solution) = solver.solve(&mut equations, [0.0; 2]);
        assert_eq!(solution, Solution::NotFound { index: 0, residual: 1.0 });
        assert!(equations.evaluations <= 20 + 2 * 20);
    }

    #[test]
    fn an_error_that_is_larger_than_the_residual_counts() {
        let mut equations = counted(|x| vec![0.9999 * x[0] + 1e-4]);
        let mut solver = QuasiNewton::new(1e-6, 50, vec![1.0]);
        let Ok(solution) = solver.solve(&mut equations, [0.995]);
        assert_eq!(solution, Solution::Found);
        assert!((solver.last.x[0] - 1.0).abs() < 2e-6, "{}", solver.last.x[0]);
    }

    #[test]
    fn small_numbers_are_solved_as_precisely_as_their_scale_says() {
        let mut equations = counted(|x| vec![-3.0 * x[0] + 4e-9]);
        let mut solver = QuasiNewton::new(1e-6, 50, vec![1e-9]);
        let x = solve(&mut equations, &mut solver).unwrap()[0];
        assert!((x - 1e-9).abs() < 1e-15, "{x}");
    }
}
