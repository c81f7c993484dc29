//! The outputs of the blocks are those of closed forms.

use std::f64::consts::{PI, TAU};

use control_blocks::*;

fn assert_close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found}, expected {expected}");
}

/// The gain of a filter at the frequency with three samples in a period.
fn gain_at_a_third(mut update: impl FnMut(f64) -> f64) -> f64 {
    let (mut sine, mut cosine) = (0.0, 0.0);
    for k in 0..900 {
        let angle = TAU * f64::from(k) / 3.0;
        let y = update(angle.sin());
        if k >= 600 {
            (sine, cosine) = (sine + y * angle.sin() / 150.0, cosine + y * angle.cos() / 150.0);
        }
    }
    f64::hypot(sine, cosine)
}

#[test]
fn a_pi_controller_sums_the_error() {
    let mut pid = Pid { kp: 3.0, ki: 2.0, ..Pid::default() };
    for k in 0..50 {
        assert_close(pid.update(1.0, 0.0, 0.1), 3.0 + 2.0 * 0.1 * f64::from(k), 1e-12);
    }
    assert_close(pid.integral, 10.0, 1e-12);
}

#[test]
fn the_derivative_of_a_ramp_has_its_slope_and_the_time_constant() {
    let (dt, tf) = (0.01, 0.1);
    let mut pid = Pid { kp: 0.0, kd: 2.0, tf, ..Pid::default() };
    for k in 0..100 {
        let expected = -2.0 * 5.0 * (1.0 - (tf / (tf + dt)).powi(k));
        assert_close(pid.update(0.0, 5.0 * dt * f64::from(k), dt), expected, 1e-10);
    }
}

#[test]
fn set_point_weights_act_on_the_set_point_only() {
    let mut pid = Pid { kp: 2.0, kd: 1.0, b: 0.25, c: 0.5, ..Pid::default() };
    assert_eq!(pid.update(0.0, 1.0, 0.5), -2.0);
    assert_eq!(pid.update(4.0, 1.0, 0.5), 2.0 * (0.25 * 4.0 - 1.0) + 0.5 * 4.0 / 0.5);
}

#[test]
fn back_calculation_tracks_the_limit_with_its_time_constant() {
    // While limited, dI/dt = ki e + (u_max - kp e - I)/tt, so I goes to u_max - kp e + tt ki e.
    let mut pid = Pid { kp: 2.0, ki: 3.0, tt: 0.5, u_max: 1.0, ..Pid::default() };
    for _ in 0..10_000 {
        assert_eq!(pid.update(1.0, 0.0, 0.001), 1.0);
    }
    assert_close(pid.integral, 1.0 - 2.0 + 0.5 * 3.0, 1e-3);
    // The rule for the tracking time of a PI controller, kp/ki, makes this u_max.
    let mut pid = Pid { kp: 2.0, ki: 3.0, u_max: 1.0, ..Pid::default() };
    (0..10_000).for_each(|_| _ = pid.update(1.0, 0.0, 0.001));
    assert_close(pid.integral, 1.0, 1e-3);
}

#[test]
fn a_limit_behind_the_controller_counts_as_its_own() {
    let mut inside = Pid { kp: 2.0, ki: 3.0, kd: 0.1, tf: 0.1, u_max: 1.0, ..Pid::default() };
    let mut outside = Pid { u_max: 1e30, ..inside };
    for k in 0..300 {
        let y = (0.02 * f64::from(k)).sin();
        let expected = inside.update(1.5, y, 0.01);
        let applied = outside.update(1.5, y, 0.01).min(1.0);
        outside.back_calculate(applied, 0.01);
        assert_close(applied, expected, 1e-12);
        assert_close(outside.integral, inside.integral, 1e-12);
    }
}

#[test]
fn a_controller_without_integral_action_does_not_wind_up() {
    let mut pid = Pid { kp: 2.0, u_max: 1.0, ..Pid::default() };
    assert_eq!(pid.update(10.0, 0.0, 0.1), 1.0);
    assert_eq!(pid.update(0.25, 0.0, 0.1), 0.5);
    pid.kp = 4.0;
    assert_eq!(pid.update(0.125, 0.0, 0.1), 0.5);
}

#[test]
fn step_responses_of_filters_are_those_of_tustins_rule() {
    let (dt, t) = (0.1, 0.7_f64);
    // With the trapezoid rule, the remainder of a step shrinks by this factor.
    let factor = (2.0 * t - dt) / (2.0 * t + dt);
    let mut low = FirstOrder { gain: 3.0, time_constant: t, ..FirstOrder::default() };
    let mut high = HighPass { gain: 3.0, time_constant: t, ..HighPass::default() };
    let mut lead = LeadLag { gain: 3.0, lead: 1.5 * t, lag: t, ..LeadLag::default() };
    for k in 0..100 {
        let left = 2.0 * t / (2.0 * t + dt) * factor.powi(k);
        assert_close(low.update(1.0, dt), 3.0 * (1.0 - left), 1e-12);
        assert_close(high.update(1.0, dt), 3.0 * left, 1e-12);
        assert_close(lead.update(1.0, dt), 3.0 * (1.0 + 0.5 * left), 1e-12);
    }
}

#[test]
fn prewarped_filters_have_the_exact_gain_at_one_frequency() {
    let dt = 0.1;
    let w = TAU / (3.0 * dt);
    let gain = 1.0 / 5.0_f64.sqrt(); // of a first-order filter with the time constant 2/w
    let mut first = FirstOrder { time_constant: 2.0 / w, prewarp: w, ..FirstOrder::default() };
    assert_close(gain_at_a_third(|u| first.update(u, dt)), gain, 1e-9);
    let mut high = HighPass { time_constant: 2.0 / w, prewarp: w, ..HighPass::default() };
    assert_close(gain_at_a_third(|u| high.update(u, dt)), 2.0 * gain, 1e-9);
    let mut lead = LeadLag { lead: 4.0 / w, lag: 2.0 / w, prewarp: w, ..LeadLag::default() };
    assert_close(gain_at_a_third(|u| lead.update(u, dt)), 17.0_f64.sqrt() * gain, 1e-9);
    let mut second =
        SecondOrder { natural_frequency: w, damping: 0.2, prewarp: w, ..SecondOrder::default() };
    assert_close(gain_at_a_third(|u| second.update(u, dt)), 1.0 / 0.4, 1e-9);
    // Without prewarping, the gain is that at the frequency tan(w dt/2) 2/dt.
    let mut plain = FirstOrder { time_constant: 2.0 / w, ..FirstOrder::default() };
    let warped = 2.0 / dt * (w * dt / 2.0).tan();
    let expected = 1.0 / (2.0 / w * warped).hypot(1.0);
    assert_close(gain_at_a_third(|u| plain.update(u, dt)), expected, 1e-9);
}

#[test]
fn a_second_order_filter_rings_as_its_differential_equation() {
    let (w, damping, dt) = (2.0, 0.3, 1e-3);
    let mut filter = SecondOrder { natural_frequency: w, damping, gain: 2.0, ..Default::default() };
    filter.settle(0.0);
    let damped = w * (1.0 - damping * damping).sqrt();
    for k in 0..5000 {
        let y = filter.update(1.0, dt);
        let t = dt * (f64::from(k) + 0.5); // the step of the input is seen half a step early
        let decay = (-damping * w * t).exp();
        let sines = (damped * t).cos() + damping * w / damped * (damped * t).sin();
        assert_close(y, 2.0 * (1.0 - decay * sines), 1e-5);
    }
}

#[test]
fn filters_accept_steps_of_different_length() {
    let mut filter = FirstOrder { time_constant: 0.5, ..FirstOrder::default() };
    filter.settle(1.0);
    filter.update(0.0, 1e-9); // the input drops to 0
    let (mut t, mut y) = (0.0, 1.0);
    for k in 0..1000 {
        let dt = if k % 3 == 0 { 2e-3 } else { 5e-4 };
        (y, t) = (filter.update(0.0, dt), t + dt);
    }
    assert_close(y, (-t / 0.5_f64).exp(), 1e-6);
}

#[test]
fn parameters_at_the_ends_of_their_ranges_give_finite_outputs() {
    let mut first = FirstOrder { time_constant: 0.0, gain: 2.0, ..FirstOrder::default() };
    assert_eq!(first.update(3.0, 0.1), 6.0);
    let mut high = HighPass { time_constant: 0.0, ..HighPass::default() };
    assert_eq!(high.update(3.0, 0.1), 0.0);
    let mut still = SecondOrder { natural_frequency: 0.0, ..SecondOrder::default() };
    assert_eq!(still.update(3.0, 0.1), 0.0);
    // From the Nyquist frequency on, there is nothing to prewarp for.
    let mut fast = FirstOrder { prewarp: 100.0, ..FirstOrder::default() };
    let mut plain = FirstOrder::default();
    assert_eq!(fast.update(1.0, 0.1), plain.update(1.0, 0.1));
    let contradiction = Saturation { lower: 1.0, upper: -1.0 };
    assert_eq!(contradiction.value(0.0), -1.0);
    assert!(Saturation::default().value(f64::NAN).is_nan());
}

#[test]
fn tables_have_their_points_and_straight_lines_between() {
    let mut table = Table1 { x: [-1.0, 0.5, 4.0], y: [2.0, 0.1, 0.3], ..Table1::default() };
    for (x, y) in [(-1.0, 2.0), (0.5, 0.1), (4.0, 0.3), (-9.0, 2.0), (9.0, 0.3)] {
        assert_eq!(table.value(x), y);
    }
    assert_close(table.value(2.25), 0.2, 1e-15);
    table.extrapolation = Extrapolation::Linear;
    assert_close(table.value(7.5), 0.5, 1e-15);
    assert_close(table.value(-2.5), 3.9, 1e-15);
    assert!(table.value(f64::NAN).is_nan());
    let one = Table1 { x: [3.0], y: [7.0], ..Table1::default() };
    assert_eq!([-1.0, 3.0, 9.0].map(|x| one.value(x)), [7.0; 3]);
}

#[test]
fn a_table_of_two_axes_is_bilinear() {
    let f = |x: f64, y: f64| 2.0 + 3.0 * x - y + 0.5 * x * y;
    let (x, y) = ([0.0, 1.0, 5.0], [-2.0, 0.0, 3.0, 4.0]);
    let z = x.map(|x| y.map(|y| f(x, y)));
    let mut table = Table2 { x, y, z, ..Table2::default() };
    for (a, b) in [(0.3, -1.0), (4.0, 3.7), (1.0, 0.0), (5.0, 4.0)] {
        assert_close(table.value(a, b), f(a, b), 1e-14);
    }
    assert_eq!(table.value(9.0, -9.0), f(5.0, -2.0));
    table.extrapolation = Extrapolation::Linear;
    assert_close(table.value(9.0, -9.0), f(9.0, -9.0), 1e-12);
}

#[test]
fn an_axis_out_of_order_is_named_and_gives_finite_values() {
    let table = Table1 { x: [0.0, 2.0, 2.0, 1.0], y: [0.0, 1.0, 2.0, 3.0], ..Table1::default() };
    let error = table.check().unwrap_err();
    let text = "table: x[3] = 2; expected more than 2, the point before it";
    assert_eq!(error.to_string(), text);
    assert!((-10..20).all(|x| table.value(f64::from(x) / 4.0).is_finite()));
    let table = Table2::<2, 2> { y: [1.0, f64::NAN], ..Table2::default() };
    assert_eq!(table.check().unwrap_err().axis, "y");
}

#[test]
fn a_state_space_system_is_the_same_as_its_filter() {
    let (w, damping, dt) = (3.0, 0.4, 0.05);
    let continuous = StateSpace::<2, 1, 1> {
        a: [[0.0, 1.0], [-w * w, -2.0 * damping * w]],
        b: [[0.0], [w * w]],
        c: [[1.0, 0.0]],
        ..StateSpace::default()
    };
    let mut system = continuous.tustin(dt).unwrap();
    let mut filter = SecondOrder { natural_frequency: w, damping, ..SecondOrder::default() };
    for k in 0..200 {
        let u = (0.1 * f64::from(k * k)).sin();
        assert_close(system.update([u])[0], filter.update(u, dt), 1e-12);
    }
    let singular = StateSpace::<1, 1, 1> { a: [[2.0 / dt]], ..StateSpace::default() };
    assert!(singular.tustin(dt).is_none());
}

#[test]
fn matrices_are_rows_of_numbers() {
    let mut system = StateSpace::<2, 1, 2> {
        a: [[1.0, 2.0], [0.0, 1.0]],
        b: [[0.0], [1.0]],
        c: [[1.0, 0.0], [1.0, 10.0]],
        d: [[0.0], [0.5]],
        ..StateSpace::default()
    };
    system.settle([1.0, 3.0]);
    assert_eq!(system.update([2.0]), [1.0, 32.0]);
    assert_eq!(system.x, [7.0, 5.0]);
}

#[test]
fn the_gain_of_a_kalman_filter_solves_the_riccati_equation() {
    // For x(k+1) = x(k) + w, y = x + v, the covariance before the correction is (q + sqrt(q^2 + 4 q r))/2.
    let (q, r) = (0.5_f64, 2.0);
    let mut filter = Kalman::<1, 1, 1> { c: [[1.0]], q: [[q]], r: [[r]], ..Kalman::default() };
    for _ in 0..200 {
        filter.update([0.0], [1.0]).unwrap();
    }
    let before = (q + (q * q + 4.0 * q * r).sqrt()) / 2.0;
    assert_close(filter.covariance[0][0], before * r / (before + r), 1e-12);
    assert_close(filter.x[0], 1.0, 1e-9);
}

#[test]
fn a_kalman_filter_finds_the_state_of_a_system_without_noise() {
    let dt = 0.1;
    let mut filter = Kalman::<2, 1, 1> {
        a: [[1.0, dt], [0.0, 1.0]],
        b: [[dt * dt / 2.0], [dt]],
        c: [[1.0, 0.0]],
        r: [[1e-6]],
        p0: [[100.0, 0.0], [0.0, 100.0]],
        ..Kalman::default()
    };
    let (mut position, mut speed) = (3.0, -1.0);
    for k in 0..50 {
        filter.correct([position]).unwrap();
        let u = (0.3 * f64::from(k)).cos();
        filter.predict([u]);
        (position, speed) = (position + dt * speed + dt * dt / 2.0 * u, speed + dt * u);
    }
    assert_close(filter.x[0], position, 1e-6);
    assert_close(filter.x[1], speed, 1e-6);
}

#[test]
fn a_kalman_filter_without_covariances_refuses_the_correction() {
    let mut filter = Kalman::<1, 1, 1> { c: [[1.0]], r: [[0.0]], p0: [[0.0]], ..Kalman::default() };
    assert_eq!(filter.correct([1.0]), Err(NotPositiveDefinite));
    assert_eq!(filter.x, [0.0]);
}

#[test]
fn signals_jump_at_the_sample_at_the_latest() {
    let step = Step { start_time: 0.3, amplitude: 2.0, offset: 1.0 };
    assert_eq!([0.2, 0.1 + 0.2, 0.3, 0.4].map(|t| step.value(t)), [1.0, 3.0, 3.0, 3.0]);
    let square = Square { frequency: 2.5, duty: 0.75, ..Square::default() };
    // Periods of 0.4 s, of which 0.3 s are above.
    let found = [0, 1, 2, 3, 4, 5, 6, 7].map(|k| square.value(0.1 * f64::from(k)));
    assert_eq!(found, [1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0, -1.0]);
    for duty in [0.0, 1.0] {
        let constant = Square { duty, ..square };
        assert!((0..100).all(|k| constant.value(0.01 * f64::from(k)) == 2.0 * duty - 1.0));
    }
    let ramp = Ramp { start_time: 1.0, duration: 4.0, amplitude: -2.0, offset: 1.0 };
    assert_eq!([0.0, 1.0, 3.0, 5.0, 9.0].map(|t| ramp.value(t)), [1.0, 1.0, 0.0, -1.0, -1.0]);
    let sine = Sine { frequency: 0.25, phase: PI / 2.0, ..Sine::default() };
    assert_close(sine.value(2.0), -1.0, 1e-15);
}

#[test]
fn the_frequency_of_a_chirp_sweeps_and_stays() {
    for logarithmic in [false, true] {
        let chirp = Chirp { duration: 5.0, end_frequency: 2.0, logarithmic, ..Chirp::default() };
        // The frequency is that of the oscillation y'' = -(2 pi f)^2 y, where y has its extremes.
        let h = 1e-4;
        for (t, expected) in [(5.0 + 2.0, 2.0), (5.0 + 9.0, 2.0)] {
            let [before, now, after] = [t - h, t, t + h].map(|t| chirp.value(t));
            let curvature = (before - 2.0 * now + after) / (h * h);
            assert_close((-curvature / now).sqrt() / TAU, expected, 1e-3);
        }
        assert_close(chirp.value(5.0 - 1e-9), chirp.value(5.0 + 1e-9), 1e-6);
    }
}

#[test]
fn pseudo_random_sequences_have_their_full_period() {
    for order in 2..=16 {
        let mut prbs = Prbs { order, bit_time: 1.0, ..Prbs::default() };
        let period = (1_usize << order) - 1;
        let bits: Vec<f64> = (0..2 * period).map(|k| prbs.value(k as f64)).collect();
        assert_eq!(bits[..period], bits[period..], "{order}");
        // Each pattern of as many bits as the register has occurs once, but not zeros alone.
        let mut seen = vec![false; period + 1];
        for k in 0..period {
            let pattern =
                (0..order as usize).fold(0, |p, i| 2 * p + usize::from(bits[k + i] > 0.0));
            assert!(pattern > 0 && !std::mem::replace(&mut seen[pattern], true), "{order}");
        }
    }
}

#[test]
fn a_pseudo_random_sequence_depends_on_the_time_alone() {
    let mut fine = Prbs { bit_time: 0.1, seed: 77, ..Prbs::default() };
    let mut coarse = fine;
    let of_fine: Vec<f64> = (0..3000).map(|k| fine.value(0.01 * f64::from(k))).collect();
    for k in (0..3000).step_by(70) {
        assert_eq!(coarse.value(0.01 * k as f64), of_fine[k]);
    }
    fine.reset();
    assert_eq!(fine.value(0.0), of_fine[0]);
}
