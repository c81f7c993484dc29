//! The difference equation (41) and the linear state space are the same plant.

use control::closed_loop::{TS, pid};
use control::pid::Integral;
use control::plant::{Linear, Parameters, State, TransferFunction};

#[test]
fn both_give_the_same_angle_over_a_closed_loop_of_20000_samples() {
    let mut linear = Linear::new(&Parameters::PAPER);
    let mut state = State::default();
    let mut difference = TransferFunction::new(&Parameters::PAPER, TS, state);
    let mut controllers = [pid(Integral::Sum, true); 2];
    let mut worst = 0.0f64;
    for _ in 0..20_000 {
        let u = controllers[0].sample(1.0, state.theta, 0.0);
        linear.advance(&mut state, u, TS);
        let u = controllers[1].sample(1.0, difference.theta(), 0.0);
        difference.advance(u);
        worst = worst.max((state.theta - difference.theta()).abs());
    }
    // Rounding in (41) is amplified by 1/|1 + den[1] + den[2] + den[3]| = 4e8 within the loop's
    // band; its effect on a closed loop's angle stays below the last digit that Table 1 prints.
    assert!(worst < 1e-6, "{worst}");
    assert!((state.theta - 1.0).abs() < 3e-3, "the loop has settled");
}
