//! The limit of the learning rate (section 3.2), by simulations on both sides of it. The report computes it from
//! the eigenvalues of the sampled closed loop.

use pendulum_control::closed_loop::{ClosedLoop, Order, ipid_rbf, pid_rbf};
use pendulum_control::{PidRbf, Target};

/// The factor by which the ringing of u at the set-point 1, without force limit, grows over three seconds.
fn growth(mut controller: PidRbf<4>, order: Order) -> f64 {
    controller.pid.u_max = f64::INFINITY;
    let mut closed_loop = ClosedLoop::new(order);
    let mut ringing = |seconds: u32| {
        let (mut last, mut before, mut largest) = (0.0, 0.0, 0.0f64);
        for k in 0..seconds * 1000 {
            let sample = closed_loop.sample(1.0, 0.0, |r, y, d| controller.sample(r, y, d));
            // The second difference is a high-pass filter: it removes the slow motion of the loop.
            if k >= 2 && k >= (seconds - 1) * 1000 {
                largest = largest.max((sample.u - 2.0 * last + before).abs());
            }
            (before, last) = (last, sample.u);
        }
        largest
    };
    let early = ringing(2);
    let late = ringing(3);
    if late.is_finite() {
        late / early
    } else {
        f64::INFINITY
    }
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
        for mut law in [
            pid_rbf(false, [0.0; 4]),
            ipid_rbf(Target::Own, [0.0; 4]).law,
        ] {
            law.pid.previous_sample_terms = previous_sample_terms;
            let [below, above] = [0.97, 1.03].map(|factor| {
                law.network.eta = factor * limit;
                growth(law, order)
            });
            assert!(below < 1.0, "{order:?} below {limit}: {below}");
            assert!(above > 10.0, "{order:?} above {limit}: {above}");
        }
    }
}
