//! The terms of the control error, and the PID controller of equation (20).

use crate::clip;

/// How the error is summed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Integral {
    /// `x3 = x3 + e ts`, the rectangle rule of (20).
    #[default]
    Sum,
    /// `x3 = (x3 + e) ts`, the sum of (25), (26): it leaks so fast that it is little more than the
    /// last `e ts`, which leaves integration to the network.
    Leaky,
}

/// Gains of the PID in parallel form: `u_p = kp x1 + kd x2 + ki x3`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "fmi", derive(fmu_derive::Variables), variables(crate = fmu_description))]
pub struct Gains {
    /// Proportional gain (N/rad).
    #[cfg_attr(
        feature = "fmi",
        parameter(tunable, start = 300, min = 0, max = 1e9, unit = "N/rad")
    )]
    pub kp: f64,
    /// Integral gain (N/(rad.s)).
    #[cfg_attr(
        feature = "fmi",
        parameter(tunable, start = 500, min = 0, max = 1e9, unit = "N/(rad.s)")
    )]
    pub ki: f64,
    /// Derivative gain (N.s/rad).
    #[cfg_attr(
        feature = "fmi",
        parameter(tunable, start = 100, min = 0, max = 1e9, unit = "N.s/rad")
    )]
    pub kd: f64,
}

/// The terms of the error (21), (26): `x1 = e`, `x2 = (e - e_before)/ts`, and the sum `x3`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Terms {
    /// The error `e(k)` (rad).
    pub x1: f64,
    /// Its backward difference quotient (rad/s).
    pub x2: f64,
    /// Its sum (rad s), according to [`Integral`].
    pub x3: f64,
}

impl Terms {
    /// The terms of the next sample, with the error `e` (rad) and the sample time `ts` (s).
    #[inline(always)]
    fn next(self, e: f64, ts: f64, integral: Integral) -> Self {
        Self {
            x1: e,
            x2: (e - self.x1) / ts,
            x3: match integral {
                Integral::Sum => self.x3 + e * ts,
                Integral::Leaky => (self.x3 + e) * ts,
            },
        }
    }
}

/// The PID controller (20) with its force limited to `u_max`.
///
/// Inputs of a sample: set-point `r`, measured angle `y`, disturbance `d` of the measurement, all in
/// rad. All public fields except the outputs may be changed between samples.
///
/// ```
/// use pendulum_control::{pid::{Gains, Integral}, Pid};
///
/// let mut pid = Pid::new(Integral::Sum);
/// pid.gains = Gains { kp: 2.0, ki: 0.0, kd: 0.0 };
/// pid.ts = 0.001;
/// pid.u_max = 100.0;
/// assert_eq!(pid.sample(1.0, 0.25, 0.0), 1.5);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "fmi", derive(fmu_derive::Variables), variables(crate = fmu_description))]
pub struct Pid {
    /// Force on the cart (N), limited to `u_max`.
    #[cfg_attr(feature = "fmi", output(unit = "N", initially_from(), terminal = "loop.u"))]
    pub u: f64,
    /// The PID's part of the force (N), not limited.
    #[cfg_attr(feature = "fmi", output(unit = "N", initially_from()))]
    pub u_p: f64,
    /// Control error e = r - (y + d) of the last sample (rad).
    #[cfg_attr(feature = "fmi", output(unit = "rad", initially_from()))]
    pub e: f64,
    /// Gains.
    #[cfg_attr(feature = "fmi", nested(prefix = "pid"))]
    pub gains: Gains,
    /// Limit of the force (N), both ways.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 100, min = 0, max = 1e9, unit = "N"))]
    pub u_max: f64,
    /// Sample time (s).
    #[cfg_attr(feature = "fmi", parameter(start = 0.001, min = 1e-6, max = 1e3, unit = "s"))]
    pub ts: f64,
    /// Whether u(k) is computed from the terms of sample k-1, a delay of one sample, as in the
    /// paper's simulations of PID and PID-RBF.
    #[cfg_attr(feature = "fmi", parameter)]
    pub previous_sample_terms: bool,
    /// Whether integral windup is prevented by conditional integration (not in the paper): the sum
    /// skips a sample whose force is limited if its error would drive the force further beyond the
    /// limit.
    #[cfg_attr(feature = "fmi", parameter)]
    pub anti_windup: bool,
    integral: Integral,
    terms: Terms,
}

impl Pid {
    /// Creates a PID at rest with all parameters zero.
    pub fn new(integral: Integral) -> Self {
        Self { integral, ..Self::default() }
    }

    /// Takes one sample and returns the force u (N).
    #[inline(always)]
    pub fn sample(&mut self, r: f64, y: f64, d: f64) -> f64 {
        self.sample_with(r, y, d, -0.0) // the neutral element of float addition
    }

    /// Takes one sample and returns the force u (N), which includes another force `u_n` (N).
    #[inline(always)]
    pub(crate) fn sample_with(&mut self, r: f64, y: f64, d: f64, u_n: f64) -> f64 {
        let sum = self.terms.x3;
        let u = self.sample_limited(r, y, d, u_n);
        if self.anti_windup {
            let excess = self.u_p + u_n - u;
            if excess * self.gains.ki * self.e > 0.0 {
                self.terms.x3 = sum;
            }
        }
        u
    }

    #[inline(always)]
    fn sample_limited(&mut self, r: f64, y: f64, d: f64, u_n: f64) -> f64 {
        self.e = r - (y + d);
        let before = self.terms;
        self.terms = before.next(self.e, self.ts, self.integral);
        let x = if self.previous_sample_terms { before } else { self.terms };
        self.u_p = self.gains.kp * x.x1 + self.gains.kd * x.x2 + self.gains.ki * x.x3;
        self.u = clip(self.u_p + u_n, self.u_max);
        self.u
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closed_loop::pid;

    #[test]
    fn a_ramp_matches_the_closed_form_of_every_term() {
        // e(k) = k a: x2 = a/ts, x3 = a ts k(k+1)/2.
        let (a, ts) = (0.01, 0.001);
        let mut c = pid(Integral::Sum, false);
        c.u_max = 1e9;
        for k in 1..=1000 {
            let n = f64::from(k);
            let u = c.sample(n * a, 0.0, 0.0);
            let expected = 300.0 * n * a + 100.0 * a / ts + 500.0 * a * ts * n * (n + 1.0) / 2.0;
            assert!((u / expected - 1.0).abs() < 1e-12, "{k}: {u} {expected}");
        }
    }

    #[test]
    fn the_leaky_sum_of_a_constant_error_converges_to_its_fixed_point() {
        // x3 = (x3 + e) ts has the fixed point e ts/(1 - ts).
        let mut c = pid(Integral::Leaky, false);
        for _ in 0..10 {
            c.sample(1.0, 0.0, 0.0);
        }
        assert!((c.terms.x3 - 0.001 / 0.999).abs() < 1e-17);
    }

    #[test]
    fn previous_sample_terms_delay_the_force_by_one_sample() {
        let [mut now, mut later] = [false, true].map(|previous| pid(Integral::Sum, previous));
        let mut last = 0.0;
        for k in 0..100 {
            let r = libm::sin(0.1 * f64::from(k));
            let u = now.sample(r, 0.0, 0.0);
            assert_eq!((later.sample(r, 0.0, 0.0), later.e), (last, now.e));
            last = u;
        }
    }

    #[test]
    fn the_force_is_limited_and_nan_propagates() {
        let mut c = pid(Integral::Sum, false);
        assert_eq!(c.sample(1.0, 0.0, 0.0), 100.0);
        assert_eq!(c.sample(-1.0, 0.0, 0.0), -100.0);
        assert!(c.u_p < -100.0);
        assert!(c.sample(f64::NAN, 0.0, 0.0).is_nan());
    }

    #[test]
    fn with_anti_windup_the_sum_stops_at_the_limit_but_takes_errors_that_reduce_the_force() {
        for sign in [1.0, -1.0] {
            let mut c = pid(Integral::Sum, false);
            (c.gains.kp, c.gains.kd, c.anti_windup) = (0.0, 0.0, true);
            for _ in 0..1000 {
                c.sample(sign, 0.0, 0.0);
            }
            assert_eq!(c.u, sign * 100.0);
            // The sum stopped at most one sample (ki e ts = 0.5 N) beyond the limit.
            assert!((c.u_p.abs() - 100.0).abs() <= 0.5 + 1e-9, "{}", c.u_p);
            // A proportional term keeps the force at its limit while the integral alone would leave it.
            let mut kept = c;
            kept.gains.kp = -1e6;
            assert_eq!(kept.sample(-sign, 0.0, 0.0), sign * 100.0);
            assert!(kept.terms.x3.abs() < c.terms.x3.abs());
            c.sample(-sign, 0.0, 0.0);
            c.sample(-sign, 0.0, 0.0);
            assert!(c.u.abs() < 100.0, "{}", c.u);
        }
    }
}
