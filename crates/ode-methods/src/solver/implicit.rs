//! The implicit method Rodas5P, for stiff equations.

use alloc::boxed::Box;

use super::linearization::Linearization;
use super::{IntegrationRun, Method, SolverError, Trial, Workspace};
use crate::rodas5p::{
    GAMMA, NODES, STAGE_WEIGHTS, STAGES, STATE_WEIGHTS, TIME_WEIGHTS, interpolate, weighted,
};

/// The implicit method of order 5(4) of Steinebach, see [`rodas5p`](crate::rodas5p). The Jacobian is computed anew for each
/// internal step: by directional derivatives if the system has them, else by differences.
#[derive(Debug, Clone, Copy)]
pub struct Rodas5p;

impl Method for Rodas5p {
    const IS_IMPLICIT: bool = true;

    fn try_step<E: SolverError>(
        run: &mut IntegrationRun<'_, E, Self>,
        h: f64,
        to: f64,
    ) -> Result<Trial<E>, E> {
        let states = run.w.states.len();
        let known = run.w.more.take().and_then(|more| more.downcast::<Linearization>().ok());
        let mut linearization = known.unwrap_or_else(|| Box::new(Linearization::new(states, None)));
        let tried = run.try_stages(&mut linearization, h, to);
        run.w.more = Some(linearization);
        tried
    }

    fn interpolate(w: &mut Workspace, fraction: f64, _h: f64) {
        let Workspace { more: Some(more), states, next, point, .. } = w else { return };
        if let Some(Linearization { stages, .. }) = more.downcast_ref() {
            for (i, point) in point.iter_mut().enumerate() {
                *point = interpolate(fraction, (states[i], next[i]), stages, i);
            }
        }
    }

    /// The time in which the states change by a hundredth of their magnitude. A second derivative would say how fast
    /// stiff equations leave a solution to which they return.
    fn estimate_size<E: SolverError>(
        run: &mut IntegrationRun<'_, E, Self>,
        remaining: f64,
    ) -> Result<f64, E> {
        let w = &run.w;
        let magnitude = |i: usize| run.system.nominal(i) + w.states[i].abs();
        let slope = run.norm(|i| w.slopes[0][i] / magnitude(i));
        Ok(remaining.min(0.01 / slope.max(f64::MIN_POSITIVE)))
    }

    /// The errors of times at the current one, so that a step may be much longer than what happens at its beginning.
    fn resolution<E>(run: &IntegrationRun<'_, E, Self>) -> f64 {
        let times = run.step.time.abs() + run.reached.abs();
        (4.0 * f64::EPSILON * times).max(f64::MIN_POSITIVE)
    }

    fn leave(w: &mut Workspace) {
        if let Some(Linearization { is_current, .. }) =
            w.more.as_mut().and_then(|more| more.downcast_mut())
        {
            *is_current = false;
        }
    }
}

impl<E: SolverError> IntegrationRun<'_, E, Rodas5p> {
    /// Takes the stages of an internal step of size `h` that ends at `to`.
    fn try_stages(&mut self, l: &mut Linearization, h: f64, to: f64) -> Result<Trial<E>, E> {
        if !l.is_current {
            if let Some(failed) = self.linearize(l, h)? {
                return Ok(failed);
            }
            l.is_current = true;
        }
        if !l.factorize(1.0 / (GAMMA * h)) {
            return Ok(Trial::Error(f64::INFINITY));
        }
        for stage in 0..STAGES {
            let mut slopes = 0;
            if stage > 0 {
                for i in 0..self.w.states.len() {
                    let change = weighted(STATE_WEIGHTS[stage], &l.stages, i);
                    self.w.next[i] = self.w.states[i] + change;
                }
                if let Some(failed) = self.evaluate_next(NODES[stage], h, to)? {
                    return Ok(failed);
                }
                slopes = 1;
                self.system.derivatives(&mut self.w.slopes[slopes]);
            }
            for i in 0..self.w.states.len() {
                let stages = weighted(STAGE_WEIGHTS[stage], &l.stages, i) / h;
                let by_time = h * TIME_WEIGHTS[stage] * l.by_time[i];
                l.stages[stage][i] = self.w.slopes[slopes][i] + stages + by_time;
            }
            l.solve(stage);
        }
        let error = &l.stages[STAGES - 1];
        self.w.next.iter_mut().zip(error).for_each(|(next, error)| *next += error);
        if let Some(failed) = self.evaluate_next(1.0, h, to)? {
            return Ok(failed);
        }
        self.system.derivatives(&mut self.w.slopes[6]);
        let w = &self.w;
        Ok(Trial::Error(self.norm(|i| {
            let largest = w.states[i].abs().max(w.next[i].abs());
            error[i] / self.scale(i, largest)
        })))
    }

    /// Evaluates the system at a node of an internal step.
    fn evaluate_next(&mut self, node: f64, h: f64, to: f64) -> Result<Option<Trial<E>>, E> {
        let time = if node == 1.0 { to } else { self.reached + node * h };
        let evaluated = self.system.evaluate(self.step.time + time, &self.w.next);
        self.judge(evaluated)
    }

    /// Computes the derivatives by states and time at the current point, where the system was evaluated last. Returns what
    /// failed.
    fn linearize(&mut self, l: &mut Linearization, h: f64) -> Result<Option<Trial<E>>, E> {
        for group in 0..l.group_count() {
            if !self.differentiate(l, group)?
                && let Some(failed) = self.subtract(l, group)?
            {
                return Ok(Some(failed));
            }
        }
        self.differentiate_by_time(l, h)
    }

    /// Sets the columns of a group by a directional derivative, if the system has them.
    fn differentiate(&mut self, l: &mut Linearization, group: usize) -> Result<bool, E> {
        let mut direction = core::mem::take(&mut l.direction);
        direction.fill(0.0);
        l.group(group).for_each(|state| direction[state] = 1.0);
        let product = self.system.directional_derivative(&direction, &mut self.w.slopes[1]);
        l.direction = direction;
        let is_known = product.map_err(|error| self.stopped(error))?;
        if is_known {
            l.set_columns(group, |row| self.w.slopes[1][row]);
        }
        Ok(is_known)
    }

    /// Sets the columns of a group by differences: forward, or backward if the equations have no values there.
    fn subtract(&mut self, l: &mut Linearization, group: usize) -> Result<Option<Trial<E>>, E> {
        let mut failed = None;
        for sign in [1.0, -1.0] {
            self.w.point.copy_from_slice(&self.w.states);
            let mut direction = core::mem::take(&mut l.direction);
            for state in l.group(group) {
                let value = self.w.states[state];
                self.w.point[state] = value + sign * self.difference(state, value.abs());
                direction[state] = self.w.point[state] - value; // without its rounding error
            }
            l.direction = direction;
            let evaluated = self.system.evaluate(self.now(), &self.w.point);
            failed = self.judge(evaluated)?;
            if failed.is_none() {
                self.system.derivatives(&mut self.w.slopes[1]);
                l.set_columns(group, |row| self.w.slopes[1][row] - self.w.slopes[0][row]);
                break;
            }
        }
        Ok(failed)
    }

    /// The change of a state of this magnitude for a difference: relative to it if it is large, and less and less so
    /// down to a part of its nominal value (as in RADAU5 of Hairer and Wanner).
    fn difference(&self, state: usize, magnitude: f64) -> f64 {
        const RELATIVE: f64 = 1.5e-8; // the square root of the rounding error
        let nominal = self.system.nominal(state);
        match magnitude > nominal {
            true => RELATIVE * magnitude,
            false => RELATIVE * nominal * libm::sqrt((magnitude / nominal).max(1e-5)),
        }
    }

    /// Sets the derivatives by time by a difference within the next internal step.
    fn differentiate_by_time(
        &mut self,
        l: &mut Linearization,
        h: f64,
    ) -> Result<Option<Trial<E>>, E> {
        let now = self.now();
        let later = now + (1.5e-8 * h).max(1e4 * f64::EPSILON * now.abs()).min(h);
        let evaluated = self.system.evaluate(later, &self.w.states);
        let failed = self.judge(evaluated)?;
        if failed.is_none() {
            self.system.derivatives(&mut self.w.slopes[1]);
            for (i, by_time) in l.by_time.iter_mut().enumerate() {
                let change = self.w.slopes[1][i] - self.w.slopes[0][i];
                // Two times may be too close to be told apart.
                *by_time = if later > now { change / (later - now) } else { 0.0 };
            }
        }
        Ok(failed)
    }
}
