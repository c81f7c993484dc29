//! The stability limit of the learning rate (section 3.2): eigenvalues of the sampled closed loop, and
//! simulations on both sides of the limit they give.

use nalgebra::SMatrix;
use pendulum_control::closed_loop::{ClosedLoop, Order, TS, network, pid};
use pendulum_control::pid::Integral;
use pendulum_control::plant::{Linear, Parameters, State};
use pendulum_control::{PidRbf, Rbf};

/// The delay, in samples, from measuring y to applying u to the plant.
#[derive(Clone, Copy, Debug)]
struct Delay {
    previous_sample_terms: bool,
    order: Order,
}

const NONE: Delay = Delay {
    previous_sample_terms: false,
    order: Order::Sequential,
};
const ONE: [Delay; 2] = [
    Delay {
        previous_sample_terms: true,
        ..NONE
    },
    Delay {
        order: Order::Parallel,
        ..NONE
    },
];
const TWO: Delay = Delay {
    previous_sample_terms: true,
    order: Order::Parallel,
};

/// The loop at the set-point 1 without clipping. Only the weights along h learn, so one node of equal
/// |h| replaces the network.
struct Loop {
    closed_loop: ClosedLoop,
    controller: PidRbf<1>,
}

/// One node with h = 1 at r = 1, which learns like the four along h if eta is scaled by |h|^2.
fn projected(eta: f64) -> Rbf<1> {
    let mut full = network([0.0; 4]);
    full.activate(1.0);
    let norm_squared: f64 = full.activations.iter().map(|h| h * h).sum();
    let mut one = Rbf::default();
    one.centres = [1.0];
    one.eta = eta * norm_squared;
    one.alpha = full.alpha;
    one
}

impl Loop {
    fn new(integral: Integral, delay: Delay, eta: f64) -> Self {
        let mut pid = pid(integral, delay.previous_sample_terms);
        pid.u_max = f64::INFINITY;
        Self {
            closed_loop: ClosedLoop::new(delay.order),
            controller: PidRbf {
                pid,
                network: projected(eta),
                ..PidRbf::default()
            },
        }
    }

    fn sample(&mut self) {
        let controller = |r, y, d| self.controller.sample(r, y, d);
        self.closed_loop.sample(1.0, 0.0, controller);
    }
}

/// Largest absolute eigenvalue of the loop, except the one at 1 (the plant's zero at s = 0 cancels
/// the integrator) and that of the cart's position.
///
/// The matrix is built here from the equations, so that the simulation below checks it.
fn spectral_radius(leaky: bool, delay: Delay, eta: f64) -> f64 {
    // States: v, theta, omega | e(k-1), x3(k-1), x2(k-1) | w, w before | u(k-1).
    const N: usize = 9;
    let mut plant = Linear::new(&Parameters::PAPER);
    let mut column = |v: f64, theta: f64, omega: f64, u: f64| {
        let mut s = State {
            x: 0.0,
            v,
            theta,
            omega,
        };
        plant.advance(&mut s, u, TS);
        [s.v, s.theta, s.omega]
    };
    let transition = [
        column(1.0, 0.0, 0.0, 0.0),
        column(0.0, 1.0, 0.0, 0.0),
        column(0.0, 0.0, 1.0, 0.0),
    ];
    let input = column(0.0, 0.0, 0.0, 1.0);
    let (kp, ki, kd) = (300.0, 500.0, 100.0);
    let rate = projected(eta).eta;
    let alpha = projected(eta).alpha;

    type Row = SMatrix<f64, 1, N>;
    let unit = |i: usize| Row::from_fn(|_, j| f64::from(u8::from(i == j)));
    let e = -unit(1);
    let x2 = (e - unit(3)) / TS;
    let x3 = if leaky {
        (unit(4) + e) * TS
    } else {
        unit(4) + e * TS
    };
    let u_p = if delay.previous_sample_terms {
        unit(3) * kp + unit(5) * kd + unit(4) * ki
    } else {
        e * kp + x2 * kd + x3 * ki
    };
    let u = u_p + unit(6);
    let applied = match delay.order {
        Order::Sequential => u,
        Order::Parallel => unit(8),
    };
    let mut a = SMatrix::<f64, N, N>::zeros();
    for i in 0..3 {
        let row = (0..3).fold(applied * input[i], |row, j| {
            row + unit(j) * transition[j][i]
        });
        a.set_row(i, &row);
    }
    a.set_row(3, &e);
    a.set_row(4, &x3);
    a.set_row(5, &x2);
    a.set_row(6, &(unit(6) + u_p * rate + (unit(6) - unit(7)) * alpha));
    a.set_row(7, &unit(6));
    a.set_row(8, &u);
    a.complex_eigenvalues()
        .iter()
        .filter(|z| (*z - 1.0).norm() > 1e-6)
        .map(|z| z.norm())
        .fold(0.0, f64::max)
}

/// The learning rate at which the spectral radius passes 1, by bisection.
fn limit(leaky: bool, delay: Delay) -> f64 {
    let (mut stable, mut unstable) = (0.05, 2.0);
    for _ in 0..40 {
        let middle = 0.5 * (stable + unstable);
        if spectral_radius(leaky, delay, middle) < 1.0 {
            stable = middle;
        } else {
            unstable = middle;
        }
    }
    stable
}

/// The limits 0.582, 0.324 and 0.205, the same for PID-RBF and IPID-RBF.
#[test]
fn eigenvalues_give_a_learning_rate_limit_for_each_delay() {
    for leaky in [false, true] {
        for (delay, expected) in [
            (NONE, 0.582),
            (ONE[0], 0.324),
            (ONE[1], 0.324),
            (TWO, 0.205),
        ] {
            let actual = limit(leaky, delay);
            assert!(
                (actual - expected).abs() < 1e-3,
                "leaky {leaky}, {delay:?}: {actual}"
            );
        }
    }
}

#[test]
fn the_rate_of_the_paper_exceeds_the_limit_for_two_samples_of_delay() {
    let radius = spectral_radius(false, TWO, 0.30);
    assert!((radius - 1.0435).abs() < 5e-4, "{radius}");
}

/// The factor by which the ringing of u grows over three seconds.
fn growth(integral: Integral, delay: Delay, eta: f64) -> f64 {
    let mut l = Loop::new(integral, delay, eta);
    let mut ringing = |seconds: u32| {
        let (mut last, mut before, mut largest) = (0.0, 0.0, 0.0f64);
        for k in 0..seconds * 1000 {
            l.sample();
            // The second difference is a high-pass filter: it removes the slow motion of the loop.
            if k >= 2 && k >= (seconds - 1) * 1000 {
                largest = largest.max((l.controller.pid.u - 2.0 * last + before).abs());
            }
            (before, last) = (last, l.controller.pid.u);
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

#[test]
fn ringing_decays_below_the_limit_and_grows_above_it() {
    for integral in [Integral::Sum, Integral::Leaky] {
        for delay in [NONE, ONE[0], ONE[1], TWO] {
            let limit = limit(integral == Integral::Leaky, delay);
            let below = growth(integral, delay, 0.97 * limit);
            let above = growth(integral, delay, 1.03 * limit);
            assert!(below < 1.0, "{integral:?} {delay:?} below: {below}");
            assert!(above > 10.0, "{integral:?} {delay:?} above: {above}");
        }
    }
}
