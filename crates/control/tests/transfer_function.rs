//! The difference equation (41) and the linear state-space model describe the same plant.

use pendulum_control::closed_loop::{TS, pid};
use pendulum_control::pid::Integral;
use pendulum_control::plant::{Linear, Parameters, State, TransferFunction};

/// In closed loop, rounding errors in (41) are amplified by 1/|1 + den[1] + den[2] + den[3]| = 4e8; the effect on
/// the angle stays below the last digit printed in Table 1.
#[test]
fn both_give_the_same_angle_over_20000_samples_in_closed_loop_from_any_start_state() {
    let start = State { x: 1.0, v: -0.4, theta: 0.2, omega: -0.7 };
    let (mut linear, mut state) = (Linear::new(&Parameters::PAPER), start);
    let mut difference = TransferFunction::new(&Parameters::PAPER, TS, start);
    assert_eq!(difference.theta(), start.theta);
    let mut controllers = [pid(Integral::Sum, true); 2];
    for k in 0..20_000 {
        let u = controllers[0].sample(1.0, state.theta, 0.0);
        linear.advance(&mut state, u, TS);
        let theta = difference.advance(controllers[1].sample(1.0, difference.theta(), 0.0));
        assert!((theta - state.theta).abs() < 1e-6, "k = {k}");
    }
    assert!((state.theta - 1.0).abs() < 3e-3, "the loop has settled");
}
