//! The transfer function (11) and its difference equation (41).

use nalgebra::{Matrix3, Matrix4, Vector3};

use super::{Linear, Parameters, State, exponential::expm1};

/// The plant as the difference equation (41), for theta only and a fixed sample time.
///
/// ```text
/// theta(k) = -den[1] theta(k-1) - den[2] theta(k-2) - den[3] theta(k-3)
///            + num[1] u(k-1) + num[2] u(k-2) + num[3] u(k-3)
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TransferFunction {
    num: [f64; 4],
    den: [f64; 4],
    /// theta(k-1), theta(k-2), theta(k-3), newest first.
    theta: [f64; 3],
    /// u(k-1), u(k-2), newest first, before the current step.
    u: [f64; 2],
}

/// Coefficients of `G(s) = gain s / (s^3 + a[0] s^2 + a[1] s + a[2])`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Continuous {
    /// `m l / q`.
    pub gain: f64,
    /// Denominator coefficients from s^2 down.
    pub a: [f64; 3],
}

impl Continuous {
    /// The transfer function (11) with the pole and the zero at s = 0 cancelled.
    pub fn new(parameters: &Parameters) -> Self {
        let p = parameters;
        let (ml, q) = (p.ml(), p.q());
        Self {
            gain: ml / q,
            a: [p.b * p.inertia() / q, -(p.M + p.m) * ml * p.g / q, -p.b * ml * p.g / q],
        }
    }

    /// Numerator and denominator of (41): zero-order hold with the sample time `ts` (s).
    ///
    /// The characteristic polynomial is built in delta = z - 1 (Faddeev-LeVerrier), where its
    /// coefficients are small: in z, nine digits cancel at 1 ms.
    pub fn discretize(&self, ts: f64) -> ([f64; 4], [f64; 4]) {
        // Controllable canonical form; the output is gain times the second state.
        #[rustfmt::skip]
        let a = Matrix3::new(
            0.0, 1.0, 0.0,
            0.0, 0.0, 1.0,
            -self.a[2], -self.a[1], -self.a[0],
        );
        let mut generator = Matrix4::zeros();
        generator.fixed_view_mut::<3, 3>(0, 0).copy_from(&a);
        generator[(2, 3)] = 1.0;
        let hold = expm1(&(generator * ts));
        let d: Matrix3<f64> = hold.fixed_view::<3, 3>(0, 0).into();
        let input: Vector3<f64> = hold.fixed_view::<3, 1>(0, 3).into();

        let a2 = -d.trace();
        let r1 = d + Matrix3::identity() * a2;
        let a1 = -(d * r1).trace() / 2.0;
        let r0 = d * r1 + Matrix3::identity() * a1;
        let a0 = -(d * r0).trace() / 3.0;
        let b2 = self.gain * input[1];
        let b1 = self.gain * (r1 * input)[1];
        // The zero of G at s = 0 is a zero at z = 1, so the last coefficient in delta vanishes.
        (
            [0.0, b2, b1 - 2.0 * b2, b2 - b1],
            [1.0, a2 - 3.0, 3.0 - 2.0 * a2 + a1, a2 - 1.0 - a1 + a0],
        )
    }
}

impl TransferFunction {
    /// Creates the plant with the sample time `ts` (s) in the state `start`, after moving without force.
    pub fn new(parameters: &Parameters, ts: f64, start: State) -> Self {
        let (num, den) = Continuous::new(parameters).discretize(ts);
        let mut plant = Linear::new(parameters);
        let mut past = start;
        let mut theta = [start.theta; 3];
        for theta in &mut theta[1..] {
            plant.advance(&mut past, 0.0, -ts);
            *theta = past.theta;
        }
        Self { num, den, theta, u: [0.0; 2] }
    }

    /// The angle (rad) at the current sample.
    pub fn theta(&self) -> f64 {
        self.theta[0]
    }

    /// Advances by one sample time under the constant force `u` (N) and returns the new angle (rad).
    pub fn advance(&mut self, u: f64) -> f64 {
        let [y1, y2, y3] = self.theta;
        let [u2, u3] = self.u;
        let theta = -self.den[1] * y1 - self.den[2] * y2 - self.den[3] * y3
            + self.num[1] * u
            + self.num[2] * u2
            + self.num[3] * u3;
        self.theta = [theta, y1, y2];
        self.u = [u, u2];
        theta
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (40) to the printed digits (its second s^3 should be s^2; one s is cancelled).
    #[test]
    fn the_transfer_function_matches_the_paper() {
        let g = Continuous::new(&Parameters::PAPER);
        let values = [g.gain, g.a[0], g.a[1], g.a[2]];
        let printed = [2.3566, 0.0883, -27.8285, -2.3094];
        for (value, printed) in values.into_iter().zip(printed) {
            assert!((value - printed).abs() < 0.5e-4 * 1.001, "{value}");
        }
    }

    /// (41) at 1 ms. Reference: zero-order hold computed to 50 digits (mpmath).
    #[test]
    fn the_difference_equation_is_the_zero_order_hold() {
        let (num, den) = Continuous::new(&Parameters::PAPER).discretize(0.001);
        let num_reference =
            [0.0, 1.178_244_519_421_022e-6, -3.468_576_509_902_101e-11, -1.178_209_833_655_923e-6];
        let den_reference =
            [1.0, -2.999_939_515_737_814_4, 2.999_851_200_642_168_4, -0.999_911_687_213_679_3];
        for k in 0..4 {
            assert!((num[k] - num_reference[k]).abs() < 2e-21, "{num:?}");
            assert!((den[k] - den_reference[k]).abs() < 1e-15, "{den:?}");
        }
    }
}
