//! The difference equation (41) and the linear state-space model describe the same plant.

use pendulum_control::closed_loop::{TS, pid};
use pendulum_control::pid::Integral;
use pendulum_control::plant::{Linear, Parameters, State, TransferFunction};

#[test]
fn both_give_the_same_angle_over_20000_samples_in_closed_loop() {
    let mut linear = Linear::new(&Parameters::PAPER);
    let mut state = State::default();
    let mut difference = TransferFunction::new(&Parameters::PAPER, TS, state);
    let mut controllers = [pid(Integral::Sum, true); 2];
    let mut max_error = 0.0f64;
    for _ in 0..20_000 {
        let u = controllers[0].sample(1.0, state.theta, 0.0);
        linear.advance(&mut state, u, TS);
        let u = controllers[1].sample(1.0, difference.theta(), 0.0);
        difference.advance(u);
        max_error = max_error.max((state.theta - difference.theta()).abs());
    }
    // In closed loop, rounding errors in (41) are amplified by 1/|1 + den[1] + den[2] + den[3]| = 4e8;
    // the effect on the angle stays below the last digit printed in Table 1.
    assert!(max_error < 1e-6, "{max_error}");
    assert!((state.theta - 1.0).abs() < 3e-3, "the loop has settled");
}
