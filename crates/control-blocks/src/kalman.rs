//! The Kalman filter.

use core::error::Error;
use core::fmt;

use nalgebra::{SMatrix, SVector};

use crate::state_space::{matrix, rows};

/// Kalman filter for a system with `N` states, `M` inputs and `P` measured values.
///
/// ```text
/// x(k+1) = A x(k) + B u(k) + w,   cov(w) = Q
/// y(k) = C x(k) + v,              cov(v) = R
///
/// predict:  x = A x + B u,   V = A V A' + Q
/// correct:  K = V C' (C V C' + R)^-1,   x = x + K (y - C x),   V = (I - K C) V (I - K C)' + K R K'
/// ```
///
/// R. E. Kalman, *A New Approach to Linear Filtering and Prediction Problems* (Journal of Basic Engineering 82, 1960).
/// The covariance V of the estimate is corrected by the formula of Joseph, with which it stays symmetric and positive
/// semidefinite: D. Simon, *Optimal State Estimation* (Wiley, 2006), chapter 5. The matrices are arrays of rows, for the
/// sample time. A system without inputs has one whose column of B is 0.
///
/// At each sample, call [`correct`](Self::correct) with the measured values, compute the input of the system, and call
/// [`predict`](Self::predict) with it; if nothing was measured, leave out `correct`. [`update`](Self::update) does both
/// for systems whose input is already known.
///
/// ```
/// use control_blocks::Kalman;
///
/// // A constant that is measured with noise: the estimate is the mean.
/// let mut filter = Kalman::<1, 1, 1> { c: [[1.0]], p0: [[1e9]], ..Kalman::default() };
/// for y in [1.0, 3.0, 5.0] {
///     filter.update([0.0], [y])?;
/// }
/// assert!((filter.x[0] - 3.0).abs() < 1e-6);
/// # Ok::<(), control_blocks::NotPositiveDefinite>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Kalman<const N: usize, const M: usize, const P: usize> {
    /// System matrix A.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable, start = identity()))]
    pub a: [[f64; N]; N],
    /// Input matrix B.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub b: [[f64; M]; N],
    /// Output matrix C.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub c: [[f64; N]; P],
    /// Covariance Q of the noise of the system.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub q: [[f64; N]; N],
    /// Covariance R of the noise of the measurement, positive definite.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable, start = identity()))]
    pub r: [[f64; P]; P],
    /// Estimate of the state before the first measurement.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter)]
    pub x0: [f64; N],
    /// Covariance of the first estimate.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(start = identity()))]
    pub p0: [[f64; N]; N],
    /// State: the estimate of the state of the system.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    pub x: [f64; N],
    /// State: the covariance of the estimate.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    pub covariance: [[f64; N]; N],
    /// State: whether there was a sample, after which `x0` and `p0` have no influence.
    pub has_started: bool,
}

/// The identity matrix.
const fn identity<const N: usize>() -> [[f64; N]; N] {
    let (mut rows, mut i) = ([[0.0; N]; N], 0);
    while i < N {
        rows[i][i] = 1.0;
        i += 1;
    }
    rows
}

impl<const N: usize, const M: usize, const P: usize> Default for Kalman<N, M, P> {
    fn default() -> Self {
        Self {
            a: identity(),
            b: [[0.0; M]; N],
            c: [[0.0; N]; P],
            q: [[0.0; N]; N],
            r: identity(),
            x0: [0.0; N],
            p0: identity(),
            x: [0.0; N],
            covariance: identity(),
            has_started: false,
        }
    }
}

impl<const N: usize, const M: usize, const P: usize> Kalman<N, M, P> {
    /// The estimate with the measured values `y`, after the system had the inputs `u` since the last sample; the first
    /// call ignores `u`.
    ///
    /// # Errors
    /// As [`correct`](Self::correct).
    pub fn update(&mut self, u: [f64; M], y: [f64; P]) -> Result<[f64; N], NotPositiveDefinite> {
        if self.has_started {
            self.predict(u);
        }
        self.correct(y)
    }

    /// The estimate with the measured values `y`.
    ///
    /// # Errors
    /// C V C' + R is not positive definite; then nothing changes.
    pub fn correct(&mut self, y: [f64; P]) -> Result<[f64; N], NotPositiveDefinite> {
        let (x, v) = self.start();
        let (c, r) = (matrix(&self.c), matrix(&self.r));
        let innovation = c * v * c.transpose() + r;
        let factor = innovation.cholesky().ok_or(NotPositiveDefinite)?;
        let gain = factor.solve(&(c * v)).transpose();
        let rest = SMatrix::identity() - gain * c;
        let v = rest * v * rest.transpose() + gain * r * gain.transpose();
        Ok(self.set(x + gain * (SVector::from(y) - c * x), v))
    }

    /// The estimate for the next sample, if the system has the inputs `u` until then.
    pub fn predict(&mut self, u: [f64; M]) -> [f64; N] {
        let ((x, v), a) = (self.start(), matrix(&self.a));
        let x = a * x + matrix(&self.b) * SVector::from(u);
        self.set(x, a * v * a.transpose() + matrix(&self.q))
    }

    /// Forgets all samples; parameters stay.
    pub fn reset(&mut self) {
        self.has_started = false;
    }

    /// The present estimate and its covariance.
    fn start(&mut self) -> (SVector<f64, N>, SMatrix<f64, N, N>) {
        if !self.has_started {
            (self.x, self.covariance, self.has_started) = (self.x0, self.p0, true);
        }
        (self.x.into(), matrix(&self.covariance))
    }

    /// Sets the estimate, with a covariance that is symmetric in spite of rounding.
    fn set(&mut self, x: SVector<f64, N>, v: SMatrix<f64, N, N>) -> [f64; N] {
        (self.x, self.covariance) = (x.into(), rows(&((v + v.transpose()) * 0.5)));
        self.x
    }
}

/// The covariance of what a measurement is expected to be has no inverse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NotPositiveDefinite;

impl fmt::Display for NotPositiveDefinite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Kalman filter: C V C' + R is not positive definite; expected a positive definite covariance R of the measurement")
    }
}

impl Error for NotPositiveDefinite {}
