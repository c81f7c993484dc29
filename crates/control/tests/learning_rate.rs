//! The limit of the learning rate (section 3.2), by simulations on both sides of it. The report computes it from
//! the eigenvalues of the sampled closed loop.

use pendulum_control::closed_loop::{ClosedLoop, Order, ipid_rbf, pid_rbf};
use pendulum_control::{PidRbf, Target};

/// The ringing of u at the set-point 1, without force limit: its second difference, which is a high-pass filter
/// and removes the slow motion of the loop.
fn ringing(mut controller: PidRbf<4>, order: Order) -> Vec<f64> {
    controller.pid.u_max = f64::INFINITY;
    let mut closed_loop = ClosedLoop::new(order);
    let mut sample = || closed_loop.sample(1.0, 0.0, |r, y, d| controller.sample(r, y, d));
    let u: Vec<_> = (0..5000).map(|_| sample().u).collect();
    u.windows(3).map(|u| (u[2] - 2.0 * u[1] + u[0]).abs()).collect()
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

/// No, one and two samples of delay from measuring y to applying u to the plant.
#[test]
fn ringing_decays_below_the_limit_and_grows_above_it() {
    for (previous_sample_terms, order, limit) in [
        (false, Order::Sequential, 0.582),
        (true, Order::Sequential, 0.324),
        (false, Order::Parallel, 0.324),
        (true, Order::Parallel, 0.205),
    ] {
        for mut law in [pid_rbf(false, [0.0; 4]), ipid_rbf(Target::Own, [0.0; 4]).law] {
            law.pid.previous_sample_terms = previous_sample_terms;
            let [below, above] = [0.97, 1.03].map(|factor| {
                law.network.eta = factor * limit;
                let ringing = ringing(law, order);
                largest(&ringing[4000..]) / largest(&ringing[1000..2000])
            });
            assert!(below < 1.0, "{order:?} below {limit}: {below}");
            assert!(above > 10.0, "{order:?} above {limit}: {above}");
        }
    }
}

#[test]
fn the_rate_of_the_paper_is_unstable_with_two_samples_of_delay() {
    let ringing = ringing(pid_rbf(true, [0.0; 4]), Order::Parallel);
    let growth = largest(&ringing[2000..2100]) / largest(&ringing[1000..1100]);
    let radius = growth.powf(1.0 / 1000.0);
    assert!((radius - 1.0435).abs() < 5e-4, "{radius}");
}
