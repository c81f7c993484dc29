//! Directional derivatives and input derivatives.

use std::ptr::{null, null_mut};

use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Error, fmi2OK};

use crate::host::Slave;
use crate::models::*;

/// An instance ready for its first step; y' = 2 u.
fn running() -> Slave {
    let mut slave = Slave::new();
    slave.start(0.0, None);
    assert_eq!(slave.set(U, 3.0), fmi2OK);
    slave
}

/// The derivative of y with respect to u.
fn derivative(slave: &mut Slave) -> f64 {
    let mut derivative = [f64::NAN];
    assert_eq!(
        slave.directional_derivative(&[Y], &[U], &[1.0], &mut derivative),
        fmi2OK
    );
    derivative[0]
}

fn ramp(slave: &mut Slave, slope: f64) -> fmi2Status {
    slave.set_input_derivatives(&[U], &[1], &[slope])
}

#[test]
fn the_derivative_refers_to_the_last_step_despite_values_set_since() {
    let mut slave = running();
    assert_eq!(derivative(&mut slave), 0.0);
    assert_eq!(slave.step(0.0, 0.25), fmi2OK);
    let bytes = slave.snapshot();
    assert_eq!(derivative(&mut slave), 0.5);
    assert_eq!(slave.snapshot(), bytes, "reading changes nothing");
    assert_eq!(slave.set(U, 7.0), fmi2OK);
    assert_eq!(slave.step(0.25, 0.0), fmi2OK);
    assert_eq!(derivative(&mut slave), 0.5);
    assert_eq!(slave.step(0.25, 2.0), fmi2OK);
    assert_eq!(derivative(&mut slave), 4.0);
    assert_eq!(derivative(slave.resume(&bytes)), 0.5);
    assert_eq!(slave.terminate(), fmi2OK);
    assert_eq!(derivative(&mut slave), 0.5);
    assert_eq!(slave.reset(), fmi2OK);
    assert_eq!(derivative(slave.start(0.0, None)), 0.0);
}

#[test]
fn seeds_scale_and_add_up() {
    let mut slave = running();
    assert_eq!(slave.step(0.0, 0.25), fmi2OK);
    let mut derivatives = [f64::NAN; 3];
    let seeds = [2.0, -8.0, 100.0];
    let status = slave.directional_derivative(&[Y, 12, Y], &[U, U, V], &seeds, &mut derivatives);
    assert_eq!(
        (status, derivatives),
        (fmi2OK, [-3.0, 0.0, -3.0]),
        "an omitted input counts as zero"
    );
    let mut derivative = [f64::NAN];
    assert_eq!(
        slave.directional_derivative(&[Y], &[], &[], &mut derivative),
        fmi2OK
    );
    assert_eq!(derivative, [0.0]);
    assert_eq!(
        slave.directional_derivative(&[], &[U], &[1.0], &mut []),
        fmi2OK
    );
}

#[test]
fn invalid_directional_derivatives_are_rejected() {
    let (mut slave, mut result) = (running(), [7.0; 2]);
    for (unknown, known, seed, word) in [
        (U, U, 1.0, "u is not an output"),
        (GAIN, U, 1.0, "gain is not an output"),
        (LAW, U, 1.0, "law is not an output"),
        (COUNT, U, 1.0, "value reference 45 is unknown"),
        (Y, Y, 1.0, "y is not an input"),
        (Y, LIMIT, 1.0, "limit is not an input"),
        (Y, u32::MAX, 1.0, "is unknown"),
        (Y, U, f64::NAN, "NaN"),
        (Y, U, f64::INFINITY, "inf"),
    ] {
        slave.refuses(&["fmi2GetDirectionalDerivative", word], |s| {
            s.directional_derivative(&[Y, unknown], &[U, known], &[1.0, seed], &mut result)
        });
    }
    let (y, u, one, c) = (&Y, &U, &1.0, slave.c);
    let place = result.as_mut_ptr();
    // SAFETY: the instance lives, and arrays are NULL or have one element.
    for status in unsafe {
        [
            fmi2GetDirectionalDerivative(c, null(), 1, u, 1, one, place),
            fmi2GetDirectionalDerivative(c, y, 1, null(), 1, one, place),
            fmi2GetDirectionalDerivative(c, y, 1, u, 1, null(), place),
            fmi2GetDirectionalDerivative(c, y, 1, u, 1, one, null_mut()),
        ]
    } {
        assert_eq!(status, fmi2Error);
    }
    assert_eq!(result, [7.0; 2]);
}

#[test]
fn a_ramp_applies_to_the_next_step_only() {
    for phase in 0..3 {
        let mut slave = Slave::new();
        let set =
            |slave: &mut Slave| assert_eq!((slave.set(U, 3.0), ramp(slave, 8.0)), (fmi2OK, fmi2OK));
        if phase == 0 {
            set(&mut slave);
        }
        assert_eq!(slave.enter_initialization_mode(), fmi2OK);
        if phase == 1 {
            set(&mut slave);
        }
        assert_eq!(slave.exit_initialization_mode(), fmi2OK);
        if phase == 2 {
            set(&mut slave);
        }
        assert_eq!(slave.step(0.0, 0.0), fmi2OK, "does not consume the ramp");
        assert_eq!(slave.step(0.0, -1.0), fmi2Error, "nor does this");
        let bytes = slave.snapshot();
        assert_eq!(slave.step(0.0, 0.5), fmi2OK);
        // 2 (3 h + 8 h²/2)
        assert_eq!(slave.get([Y]), [5.0]);
        assert_eq!(slave.step(0.5, 0.5), fmi2OK);
        assert_eq!(slave.get([Y]), [8.0], "the force is constant again");
        assert_eq!(Slave::new().resume(&bytes).step(0.0, 0.5), fmi2OK);
        assert_eq!(slave.resume(&bytes).step(0.0, 0.5), fmi2OK);
        assert_eq!(slave.get([Y]), [5.0], "a state includes the ramp");
        assert_eq!((ramp(&mut slave, 8.0), slave.reset()), (fmi2OK, fmi2OK));
        assert_eq!(slave.start(0.0, None).step(0.0, 1.0), fmi2OK);
        assert_eq!(slave.get([Y]), [0.0], "a reset clears it");
    }
}

#[test]
fn invalid_input_derivatives_are_rejected() {
    let mut slave = running();
    for (reference, order, slope, word) in [
        (U, 0, 1.0, "the derivative of u is of order 0; expected 1"),
        (U, 2, 1.0, "of order 2"),
        (U, -1, 1.0, "of order -1"),
        (U, 1, f64::NAN, "the derivative of u = NaN is refused"),
        (U, 1, f64::NEG_INFINITY, "u = -inf"),
        (V, 1, 1.0, "the host cannot set the input derivative of v"),
        (Y, 1, 1.0, "derivative of y"),
        (LAW, 1, 1.0, "derivative of law"),
        (COUNT, 1, 1.0, "value reference 45 is unknown"),
    ] {
        slave.refuses(&["fmi2SetRealInputDerivatives", word], |s| {
            s.set_input_derivatives(&[U, reference], &[1, order], &[1.0, slope])
        });
    }
    let (u, order, slope, c) = (&U, &1, &1.0, slave.c);
    // SAFETY: the instance lives, and arrays are NULL or have one element.
    unsafe {
        slave.refuses(&["NULL"], |_| {
            fmi2SetRealInputDerivatives(c, null(), 1, order, slope)
        });
        slave.refuses(&["NULL"], |_| {
            fmi2SetRealInputDerivatives(c, u, 1, null(), slope)
        });
        slave.refuses(&["NULL"], |_| {
            fmi2SetRealInputDerivatives(c, u, 1, order, null())
        });
        assert_eq!(
            fmi2SetRealInputDerivatives(c, null(), 0, null(), null()),
            fmi2OK
        );
    }
}

#[test]
fn models_without_derivatives_report_it() {
    let mut wide = Slave::of(WIDE);
    wide.start(0.0, None);
    wide.refuses(
        &["fmi2GetDirectionalDerivative", "has no derivatives"],
        |s| s.directional_derivative(&[8], &[0], &[1.0], &mut [0.0]),
    );
    wide.refuses(&["fmi2SetRealInputDerivatives", "u0"], |s| ramp(s, 1.0));
}
