//! The matrix exponential minus the identity.
//!
//! nalgebra's own needs `std`, and its bits depend on the platform through `log2` and `powf`. This one
//! uses arithmetic only; the tests compare it with nalgebra's.

use nalgebra::SMatrix;

/// `exp(a) - I` by scaling and squaring: the Taylor series of `a` halved until its norm is at most
/// 1/2, then doubled by `exp(2 a) - I = 2 d + d^2` with `d = exp(a) - I`, which keeps every digit of
/// a small `a`.
///
/// Returns NaN if `a` is not finite.
pub(super) fn expm1<const N: usize>(a: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    /// 0.5^DEGREE / DEGREE! is below the rounding error of an f64.
    const DEGREE: u32 = 14;
    let norm = a.row_iter().map(|row| row.lp_norm(1)).fold(0.0, f64::max);
    if !a.iter().all(|entry| entry.is_finite()) || !norm.is_finite() {
        return SMatrix::repeat(f64::NAN);
    }
    let mut scale = 1.0;
    let mut doublings = 0;
    while norm * scale > 0.5 {
        scale *= 0.5;
        doublings += 1;
    }
    let a = a * scale;
    let mut series = SMatrix::identity();
    for n in (2..=DEGREE).rev() {
        series = SMatrix::identity() + a * series / f64::from(n);
    }
    let mut d = a * series;
    for _ in 0..doublings {
        d = d * 2.0 + d * d;
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Matrix3};

    #[test]
    fn equals_the_exponential_of_nalgebra() {
        let a = Matrix3::new(0.1, 2.0, -0.3, 0.4, -0.5, 1.6, -0.7, 0.8, 0.9);
        for scale in [1e-6, 1e-3, 0.1, 1.0, 10.0] {
            let a = a * scale;
            let expected = a.exp();
            let error = expm1(&a) + Matrix3::identity() - expected;
            assert!(error.amax() < 1e-13 * expected.amax(), "{scale}: {error}");
        }
    }

    #[test]
    fn keeps_the_digits_of_a_small_step() {
        let d = expm1(&Matrix2::new(1e-9, 0.0, 0.0, -1e-12));
        assert_eq!(d[(0, 0)], libm::expm1(1e-9));
        assert_eq!(d[(1, 1)], libm::expm1(-1e-12));
    }

    #[test]
    fn non_finite_input_gives_a_non_finite_result() {
        for entry in [f64::NAN, f64::INFINITY, 1e308] {
            assert!(!expm1(&Matrix2::repeat(entry))[(0, 0)].is_finite());
        }
    }
}
