//! What holds for all parameters and inputs.

use control_blocks::*;
use proptest::prelude::*;

const DT: f64 = 0.01;

fn signal() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-100.0..100.0, 1..50)
}

/// Two numbers in order.
fn ordered() -> impl Strategy<Value = (f64, f64)> {
    (-50.0..50.0, 0.0..50.0).prop_map(|(lower, width)| (lower, lower + width))
}

fn axis<const N: usize>() -> impl Strategy<Value = [f64; N]> {
    prop::array::uniform(0.01..10.0).prop_map(|mut axis: [f64; N]| {
        (1..N).for_each(|i| axis[i] += axis[i - 1]);
        axis
    })
}

/// A controller with integral action.
fn pid() -> impl Strategy<Value = Pid> {
    let gains = (0.0..10.0, 0.1..10.0, 0.0..1.0, 0.0..0.1);
    (gains, 0.0..1.0, 0.0..1.0, 0.0..1.0, ordered()).prop_map(
        |((kp, ki, kd, tf), tt, b, c, (u_min, u_max))| Pid {
            kp,
            ki,
            kd,
            tf,
            tt,
            b,
            c,
            u_min,
            u_max,
            ..Pid::default()
        },
    )
}

/// A symmetric positive definite matrix.
fn covariance<const N: usize>() -> impl Strategy<Value = [[f64; N]; N]> {
    let factor = prop::array::uniform(prop::array::uniform(-2.0..2.0));
    factor.prop_map(|f: [[f64; N]; N]| {
        let product = |i: usize, j: usize| (0..N).map(|k| f[i][k] * f[j][k]).sum::<f64>();
        std::array::from_fn(|i| {
            std::array::from_fn(|j| product(i, j) + f64::from(u8::from(i == j)) * 0.01)
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_saturated_value_is_within_its_bounds((lower, upper) in ordered(), u in -100.0..100.0) {
        let y = Saturation { lower, upper }.value(u);
        prop_assert!(lower <= y && y <= upper);
        prop_assert!(y == u || y == lower || y == upper);
        prop_assert_eq!(DeadZone { lower, upper }.value(u), u - y);
    }

    #[test]
    fn a_limited_rate_is_within_its_bounds(us in signal(), rising in 0.0..50.0, falling in 0.0..50.0) {
        let mut limiter = RateLimiter { rising, falling, ..RateLimiter::default() };
        let mut before = 0.0;
        for u in us {
            let y = limiter.update(u, DT);
            prop_assert!(y - before <= rising * DT + 1e-12 && before - y <= falling * DT + 1e-12);
            prop_assert!((before..=u).contains(&y) || (u..=before).contains(&y));
            before = y;
        }
    }

    #[test]
    fn a_relay_switches_only_at_its_levels(us in signal(), (off_below, on_above) in ordered()) {
        let mut relay = Hysteresis { on_above, off_below, ..Hysteresis::default() };
        let mut before = 0.0;
        for u in us {
            let y = relay.update(u);
            let expected = if u > on_above { 1.0 } else if u < off_below { 0.0 } else { before };
            prop_assert_eq!(y, expected);
            before = y;
        }
    }

    #[test]
    fn the_output_of_a_controller_is_within_its_limits(mut pid in pid(), us in signal()) {
        for pair in us.windows(2) {
            let u = pid.update(pair[0], pair[1], DT);
            prop_assert!(pid.u_min <= u && u <= pid.u_max);
        }
    }

    #[test]
    fn a_controller_goes_on_from_manual_without_a_jump(
        mut pid in pid(), manual in -40.0..40.0, r in -10.0..10.0, y in -10.0..10.0, before in signal(),
    ) {
        for y in before {
            pid.update(r, y, DT);
        }
        for _ in 0..2000 {
            pid.track(manual, r, y, DT);
        }
        let manual = Saturation { lower: pid.u_min, upper: pid.u_max }.value(manual);
        prop_assert!((pid.update(r, y, DT) - manual).abs() < 1e-9);
    }

    #[test]
    fn tuned_parameters_cause_no_jump(mut pid in pid(), other in pid(), r in -1.0..1.0, y in -1.0..1.0) {
        let limits = Saturation { lower: -1e30, upper: 1e30 };
        (pid.u_min, pid.u_max) = (limits.lower, limits.upper);
        for _ in 0..2000 {
            pid.update(r, y, DT);
        }
        let mut tuned = Pid { kp: other.kp, b: other.b, ki: other.ki, ..pid };
        (tuned.kd, tuned.tf, tuned.c, tuned.tt) = (other.kd, other.tf, other.c, other.tt);
        prop_assert!((tuned.update(r, y, DT) - pid.update(r, y, DT)).abs() < 1e-9);
        // Of a filter at rest with an input, the output does not jump even if the gain changes.
        let mut filter = SecondOrder { gain: 2.0, ..SecondOrder::default() };
        filter.settle(1.0);
        filter.natural_frequency = 10.0 * pid.b;
        filter.damping = other.b;
        prop_assert!((filter.update(1.0, DT) - 2.0).abs() < 1e-12);
        filter.gain = 1.0;
        prop_assert!((filter.update(1.0, DT) - 2.0).abs() < 0.01);
    }

    #[test]
    fn filters_reach_the_gain_at_frequency_0(
        gain in -5.0..5.0, t in 0.01..1.0, lead in 0.0..1.0, damping in 0.2..2.0, u in -10.0..10.0,
    ) {
        let mut first = FirstOrder { gain, time_constant: t, ..FirstOrder::default() };
        let mut second =
            SecondOrder { gain, natural_frequency: 1.0 / t, damping, ..SecondOrder::default() };
        let mut compensator = LeadLag { gain, lead, lag: t, ..LeadLag::default() };
        let mut high = HighPass { gain, time_constant: t, ..HighPass::default() };
        for _ in 0..20_000 {
            first.update(u, DT);
            second.update(u, DT);
            compensator.update(u, DT);
            high.update(u, DT);
        }
        for y in [first.y, second.y, compensator.y, high.y + gain * u] {
            prop_assert!((y - gain * u).abs() < 1e-9);
        }
        first.settle(u);
        second.settle(u);
        compensator.settle(u);
        high.settle(u);
        for y in [first.update(u, DT), second.update(u, DT), compensator.update(u, DT), high.update(u, DT) + gain * u] {
            prop_assert!((y - gain * u).abs() < 1e-12);
        }
    }

    #[test]
    fn an_average_is_between_its_samples(us in signal()) {
        let mut average = MovingAverage::<5>::default();
        for k in 0..us.len() {
            let y = average.update(us[k]);
            let last = &us[k.saturating_sub(4)..=k];
            let (min, max) = last.iter().fold((f64::MAX, f64::MIN), |(a, b), u| (a.min(*u), b.max(*u)));
            prop_assert!(min - 1e-12 <= y && y <= max + 1e-12);
        }
    }

    #[test]
    fn a_table_of_increasing_values_increases(x in axis::<6>(), y in axis::<6>(), a in 0.0..60.0, b in 0.0..60.0) {
        let table = Table1 { x, y, ..Table1::default() };
        prop_assert!(table.check().is_ok());
        let (low, high) = (f64::min(a, b), f64::max(a, b));
        prop_assert!(table.value(low) <= table.value(high) + 1e-12);
        prop_assert!(y[0] <= table.value(a) && table.value(a) <= y[5] + 1e-12);
        for i in 0..6 {
            prop_assert_eq!(table.value(x[i]), y[i]);
        }
    }

    #[test]
    fn a_table_of_two_axes_is_between_its_values(x in axis::<4>(), y in axis::<3>(), a in -5.0..50.0, b in -5.0..50.0) {
        let z = x.map(|x| y.map(|y| x * y));
        let table = Table2 { x, y, z, ..Table2::default() };
        // x y is bilinear.
        let expected = f64::clamp(a, x[0], x[3]) * f64::clamp(b, y[0], y[2]);
        prop_assert!((table.value(a, b) - expected).abs() < 1e-10);
    }

    #[test]
    fn the_covariance_of_an_estimate_is_symmetric_and_positive_semidefinite(
        a in prop::array::uniform(prop::array::uniform(-1.5..1.5)),
        c in prop::array::uniform(prop::array::uniform(-2.0..2.0)),
        q in covariance::<3>(), r in covariance::<2>(), p0 in covariance::<3>(), us in signal(),
    ) {
        let mut filter = Kalman::<3, 1, 2> { a, c, q, r, p0, ..Kalman::default() };
        for u in us {
            filter.update([u], [u, -u]).unwrap();
            let p = filter.covariance;
            let p = nalgebra::SMatrix::<f64, 3, 3>::from(p);
            prop_assert_eq!(p, p.transpose());
            let smallest = p.symmetric_eigenvalues().min();
            prop_assert!(smallest >= -1e-9 * p.norm(), "{}", smallest);
        }
    }

    #[test]
    fn measurements_make_an_estimate_more_certain(
        c in prop::array::uniform(prop::array::uniform(-2.0..2.0)),
        r in covariance::<2>(), p0 in covariance::<3>(), y in prop::array::uniform(-9.0..9.0),
    ) {
        let mut filter = Kalman::<3, 1, 2> { c, r, p0, ..Kalman::default() };
        filter.correct(y).unwrap();
        let trace = |p: [[f64; 3]; 3]| p[0][0] + p[1][1] + p[2][2];
        prop_assert!(trace(filter.covariance) <= trace(p0) * (1.0 + 1e-9));
    }

    #[test]
    fn sources_are_within_their_amplitude(t in 0.0..1e4, amplitude in 0.0..10.0, offset in -5.0..5.0) {
        let mut prbs = Prbs { amplitude, offset, ..Prbs::default() };
        let values = [
            Sine { amplitude, offset, ..Sine::default() }.value(t),
            Square { amplitude, offset, ..Square::default() }.value(t),
            Chirp { amplitude, offset, ..Chirp::default() }.value(t),
            Ramp { amplitude, offset, ..Ramp::default() }.value(t),
            Step { amplitude, offset, ..Step::default() }.value(t),
            prbs.value(t),
        ];
        for value in values {
            prop_assert!((value - offset).abs() <= amplitude + 1e-12);
        }
    }

    #[test]
    fn no_text_is_a_panic_of_the_reader(text in "[-0-9.,;x#\n ]{0,60}") {
        let _ = Table1::<3>::default().read_csv("a.csv", &text);
        let _ = Table2::<2, 2>::default().read_csv("a.csv", &text);
    }
}
