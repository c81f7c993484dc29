//! Linear systems in state space.

use nalgebra::{SMatrix, SVector};

/// Rows of numbers as a matrix.
pub(crate) fn matrix<const R: usize, const C: usize>(rows: &[[f64; C]; R]) -> SMatrix<f64, R, C> {
    SMatrix::from_fn(|row, column| rows[row][column])
}

/// A matrix as rows of numbers.
pub(crate) fn rows<const R: usize, const C: usize>(matrix: &SMatrix<f64, R, C>) -> [[f64; C]; R] {
    matrix.transpose().into()
}

/// Discrete-time linear system with `N` states, `M` inputs and `P` outputs.
///
/// ```text
/// y(k) = C x(k) + D u(k)
/// x(k+1) = A x(k) + B u(k)
/// ```
///
/// K. J. Astrom and B. Wittenmark, *Computer-Controlled Systems* (3rd ed., Prentice Hall, 1997), chapter 2. The matrices
/// are arrays of rows, for the sample time at which `update` is called; [`tustin`](Self::tustin) finds them for a system
/// of continuous time.
///
/// ```
/// use control_blocks::StateSpace;
///
/// // An integrator, x' = u, y = x, sampled every 0.1 s.
/// let integrator = StateSpace::<1, 1, 1> { b: [[1.0]], c: [[1.0]], ..StateSpace::default() };
/// let mut discrete = integrator.tustin(0.1).unwrap();
/// assert_eq!(discrete.update([2.0]), [0.1]);
/// assert!((discrete.update([2.0])[0] - 0.3).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct StateSpace<const N: usize, const M: usize, const P: usize> {
    /// System matrix A.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub a: [[f64; N]; N],
    /// Input matrix B.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub b: [[f64; M]; N],
    /// Output matrix C.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub c: [[f64; N]; P],
    /// Feedthrough matrix D.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub d: [[f64; M]; P],
    /// State x.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    pub x: [f64; N],
}

impl<const N: usize, const M: usize, const P: usize> Default for StateSpace<N, M, P> {
    fn default() -> Self {
        Self { a: [[0.0; N]; N], b: [[0.0; M]; N], c: [[0.0; N]; P], d: [[0.0; M]; P], x: [0.0; N] }
    }
}

impl<const N: usize, const M: usize, const P: usize> StateSpace<N, M, P> {
    /// The outputs for the inputs `u` of this sample; the state advances to the next one.
    pub fn update(&mut self, u: [f64; M]) -> [f64; P] {
        let (x, u) = (SVector::from(self.x), SVector::from(u));
        self.x = (matrix(&self.a) * x + matrix(&self.b) * u).into();
        (matrix(&self.c) * x + matrix(&self.d) * u).into()
    }

    /// Sets the state x.
    pub fn settle(&mut self, x: [f64; N]) {
        self.x = x;
    }

    /// Sets the state to 0.
    pub fn reset(&mut self) {
        self.x = [0.0; N];
    }

    /// The discrete-time system for the sample time `dt` (s), in the state 0, of the continuous-time system x' = A x + B
    /// u, y = C x + D u with these matrices, by Tustin's rule. `None` if A has the eigenvalue 2/dt.
    ///
    /// ```text
    /// E = (I - dt/2 A)^-1,   A' = E (I + dt/2 A),   B' = E dt B,   C' = C E,   D' = D + C B'/2
    /// ```
    ///
    /// The system is that of `scipy.signal.cont2discrete(..., method="bilinear")`. G. F. Franklin, J. D. Powell and M.
    /// Workman, *Digital Control of Dynamic Systems* (3rd ed., Addison-Wesley, 1998), chapter 6.
    pub fn tustin(&self, dt: f64) -> Option<Self> {
        let [a, identity] = [matrix(&self.a) * (dt / 2.0), SMatrix::identity()];
        let inverse = (identity - a).try_inverse()?;
        let (b, c) = (inverse * matrix(&self.b) * dt, matrix(&self.c));
        Some(Self {
            a: rows(&(inverse * (identity + a))),
            b: rows(&b),
            c: rows(&(c * inverse)),
            d: rows(&(matrix(&self.d) + c * b * 0.5)),
            x: [0.0; N],
        })
    }
}
