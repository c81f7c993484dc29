//! Ramps of inputs: their derivatives, which a host of FMI 2.0 sets for the next step.

use crate::driver::*;
use crate::models::*;
use crate::updates::updating;

const NAN: f64 = f64::NAN;
const INFINITE: f64 = f64::INFINITY;

#[test]
fn a_ramp_applies_to_the_next_step_only() {
    for phase in 0..3 {
        let it = Instance::new(PLAIN[0], EVERY);
        let set = || ok([it.set(U, 3.0), it.set_input_derivatives(&[U], &[1], &[8.0])]);
        let calls = [|_| OK, |f: Fmu| f.enter(0.0, None, None), Fmu::exit_initialization_mode];
        for (now, call) in calls.iter().enumerate() {
            ok([call(*it)]);
            if now == phase {
                set();
            }
        }
        assert_eq!(it.step(0.0, 0.0), OK, "does not consume the ramp");
        assert_eq!(it.step(0.0, -1.0), ERROR, "nor does this");
        let bytes = it.snapshot();
        it.steps(0.0, 0.5);
        // 2 (3 h + 8 h²/2)
        assert_eq!(it.get([Y]), [5.0]);
        it.steps(0.5, 0.5);
        assert_eq!(it.get([Y]), [8.0], "the force is constant again");
        it.resume(&bytes).steps(0.0, 0.5);
        assert_eq!(it.get([Y]), [5.0], "a state includes the ramp");
        set();
        ok([it.reset()]);
        it.start(0.0, None);
        it.steps(0.0, 1.0);
        assert_eq!(it.get([Y]), [0.0], "a reset clears it");
    }
}

#[test]
fn a_step_that_the_host_sees_into_ends_the_ramp_too() {
    for (kind, early_return) in pairs(&[PLAIN[1], EVENTS], &[false, true]) {
        let it = updating(kind, early_return, &[]);
        // As components have it.
        let with_ramps = Fmu { kind: PLAIN[0], ..*it };
        ok([it.set(Ball::DRIVE, Ball::G)]);
        ok([with_ramps.set_input_derivatives(&[Ball::DRIVE], &[1], &[8.0])]);
        for time in [0.0, 0.25] {
            it.steps(time, 0.25);
            assert_eq!(it.get([Ball::V]), [0.25], "8 h²/2");
        }
    }
}

#[test]
fn an_element_of_an_array_of_structs_has_input_derivatives() {
    let it = Instance::running(PLAIN[0], DEVICE);
    ok([it.set(Device::U_1, 1.0), it.set_input_derivatives(&[Device::U_2], &[1], &[4.0])]);
    for (time, y) in [(0.0, 2.0 + 2.0 * 4.0 * 0.5), (0.5, 2.0)] {
        it.steps(time, 0.5);
        assert_eq!(it.get([Device::Y]), [y]);
    }
}

#[test]
fn invalid_input_derivatives_are_refused() {
    let it = Instance::running(PLAIN[0], EVERY);
    for (reference, order, slope, words) in [
        (U, 0, 1.0, "the derivative of u is of order 0; expected 1"),
        (U, 2, 1.0, "of order 2"),
        (U, -1, 1.0, "of order -1"),
        (U, 1, NAN, "the derivative of u = NaN is refused"),
        (U, 1, -INFINITE, "u = -inf"),
        (V, 1, 1.0, "cannot set the input derivative of v"),
        (Y, 1, 1.0, "derivative of y"),
        (LAW, 1, 1.0, "derivative of law"),
        (COUNT, 1, 1.0, "is unknown"),
    ] {
        let (of, orders, slopes) = ([U, reference], [1, order], [1.0, slope]);
        it.refuses(words, |f| f.set_input_derivatives(&of, &orders, &slopes));
    }
}
