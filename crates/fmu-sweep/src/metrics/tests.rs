use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::*;

fn sample(time: f64, r: f64, y: f64) -> Sample {
    Sample {
        time,
        r,
        y,
        e: r - y,
        u: 0.0,
    }
}

fn summary(samples: impl IntoIterator<Item = Sample>) -> Summary {
    let mut metrics = Metrics::new(&Options::default());
    for sample in samples {
        metrics.push(sample);
    }
    metrics.finish()
}

/// A reference and an output sampled every 1 ms.
fn sampled(count: u32, r: impl Fn(f64) -> f64, y: impl Fn(f64) -> f64) -> Vec<Sample> {
    let times = (0..count).map(|k| 0.001 * f64::from(k));
    times.map(|time| sample(time, r(time), y(time))).collect()
}

fn decay(constant: f64) -> Vec<Sample> {
    sampled(20_000, |_| 1.0, |time| 1.0 - libm::exp(-time / constant))
}

#[test]
fn a_first_order_decay_matches_its_closed_form_integrals() {
    for constant in [0.1, 0.5, 1.0] {
        let found = summary(decay(constant));
        // The error of the rectangle rule is half a step times the drop of the integrand from 1 to 0.
        assert!((found.iae - constant - 0.0005).abs() < 1e-6, "{found:?}");
        assert!(
            (found.ise - constant / 2.0 - 0.0005).abs() < 2e-6,
            "{found:?}"
        );
        assert!((found.itae - constant * constant).abs() < 2e-6, "{found:?}");
        assert_eq!(found.overshoot, Some(0.0));
        let settling_time = -constant * libm::log(0.003);
        let late = found.settling_time.unwrap() - settling_time;
        assert!((0.0..=0.001).contains(&late), "{late}");
    }
}

#[test]
fn a_second_order_step_response_overshoots_by_its_damping() {
    for damping in [0.2f64, 0.5, 0.8] {
        let root = (1.0 - damping * damping).sqrt();
        let response = |time: f64| {
            let (sine, cosine) = libm::sincos(10.0 * root * time);
            1.0 - libm::exp(-10.0 * damping * time) * (cosine + damping / root * sine)
        };
        let expected = libm::exp(-std::f64::consts::PI * damping / root);
        for (start, end) in [(0.0, 1.0), (0.0, -0.5), (3.0, 1.0), (-1.0, 2.0)] {
            let height = end - start;
            let at_once = sampled(5000, |_| end, |time| start + height * response(time));
            let later = sampled(
                5000,
                |time| if time < 0.1 { start } else { end },
                |time| start + height * response((time - 0.1).max(0.0)),
            );
            for samples in [at_once, later] {
                let overshoot = summary(samples).overshoot.unwrap();
                assert!(
                    (overshoot - expected).abs() < 5e-5,
                    "{overshoot} {expected}"
                );
            }
        }
    }
}

#[test]
fn a_wave_overshoots_its_amplitude() {
    let sine = |time: f64| 2.0 * libm::sin(5.0 * time);
    let same = summary(sampled(2000, sine, sine));
    assert_eq!(same.overshoot, Some(0.0));
    let more = summary(sampled(2000, sine, |time| -1.25 * sine(time)));
    assert!((more.overshoot.unwrap() - 0.25).abs() < 1e-15);
    assert_eq!(more.settling_time, None);
}

#[test]
fn undershoot_is_no_overshoot() {
    let samples = [(0.0, 0.0), (0.1, -0.5), (0.2, 1.0)].map(|(time, y)| sample(time, 1.0, y));
    assert_eq!(summary(samples).overshoot, Some(0.0));
}

#[test]
fn a_step_of_zero_height_has_no_overshoot() {
    assert_eq!(summary(sampled(9, |_| 1.0, |_| 1.0)).overshoot, None);
}

#[test]
fn the_settling_time_equals_that_of_the_recorded_response() {
    for constant in [0.1, 0.5, 5.0] {
        let samples = decay(constant);
        let time: Vec<_> = samples.iter().map(|s| s.time).collect();
        let error: Vec<_> = samples.iter().map(|s| s.e).collect();
        assert_eq!(
            summary(samples).settling_time,
            settling_time(&time, &error, 0.003)
        );
    }
    assert_eq!(settling_time(&[], &[], 1.0), None);
    assert_eq!(settling_time(&[5.0, 6.0], &[1.0, -1.0], 1.0), Some(5.0));
    assert_eq!(settling_time(&[5.0, 6.0], &[0.0, f64::NAN], 1.0), None);
    assert_eq!(settling_time(&[5.0, 6.0], &[f64::NAN, 0.0], 1.0), Some(6.0));
}

#[test]
fn the_settling_time_restarts_when_the_reference_changes() {
    let settled = |samples: &[(f64, f64, f64)]| {
        summary(samples.iter().map(|&(time, r, y)| sample(time, r, y))).settling_time
    };
    assert_eq!(settled(&[(0.0, 1.0, 1.0)]), Some(0.0));
    assert_eq!(settled(&[(0.0, 1.0, 1.0), (0.1, 1.0, 1.0)]), Some(0.0));
    assert_eq!(
        settled(&[(0.0, 1.0, 1.0), (0.1, 1.0, 1.1), (0.2, 1.0, 1.0)]),
        Some(0.2)
    );
    assert_eq!(
        settled(&[(0.0, 1.0, 1.0), (0.1, 1.001, 1.0), (0.2, 1.001, 1.0)]),
        Some(0.1)
    );
    assert_eq!(settled(&[(0.0, 1.0, 1.0), (0.1, 1.001, 1.0)]), None);
    assert_eq!(settled(&[(0.0, 1.0, 1.0), (0.1, 1.0, 0.9)]), None);
}

#[test]
fn metrics_stop_at_divergence() {
    let sound = decay(0.1);
    let until = summary(sound[..50].iter().copied());
    for wrong in [
        Sample {
            time: f64::NAN,
            ..sound[50]
        },
        Sample {
            r: f64::INFINITY,
            ..sound[50]
        },
        Sample {
            y: f64::NAN,
            ..sound[50]
        },
        Sample {
            e: f64::NAN,
            ..sound[50]
        },
        Sample {
            e: -1000.1,
            ..sound[50]
        },
        Sample {
            u: f64::NEG_INFINITY,
            ..sound[50]
        },
    ] {
        let mut metrics = Metrics::new(&Options::default());
        assert!(sound[..50].iter().all(|&sample| metrics.push(sample)));
        assert!(!metrics.push(wrong));
        assert!(!metrics.push(sound[51]));
        metrics.diverge(99.0);
        let found = metrics.finish();
        assert!(found.diverged);
        let at = found.diverged_at.unwrap();
        assert!(at == wrong.time || wrong.time.is_nan());
        let expected = Summary {
            diverged: true,
            diverged_at: None,
            settling_time: None,
            ..until
        };
        assert_eq!(
            Summary {
                diverged_at: None,
                ..found
            },
            expected
        );
    }
}

#[test]
fn a_run_that_diverges_after_settling_has_no_settling_time() {
    let mut metrics = Metrics::new(&Options::default());
    metrics.push(sample(0.0, 1.0, 1.0));
    metrics.push(sample(0.1, 1.0, 1.0));
    metrics.diverge(0.2);
    let found = metrics.finish();
    assert_eq!((found.settling_time, found.diverged_at), (None, Some(0.2)));
}

#[test]
fn a_run_without_samples_has_no_error() {
    let mut metrics = Metrics::new(&Options::default());
    metrics.diverge(0.0);
    let expected = Summary {
        diverged: true,
        diverged_at: Some(0.0),
        ..Summary::default()
    };
    assert_eq!(metrics.finish(), expected);
}

#[test]
fn options_are_checked() {
    let check = |band, limit| Options { band, limit }.check().map_err(|e| e.to_string());
    assert_eq!(check(0.0, f64::INFINITY), Ok(()));
    for (band, limit, reason) in [
        (
            -0.1,
            1.0,
            "band = -0.1, expected a finite number of at least 0",
        ),
        (
            f64::NAN,
            1.0,
            "band = NaN, expected a finite number of at least 0",
        ),
        (
            f64::INFINITY,
            1.0,
            "band = inf, expected a finite number of at least 0",
        ),
        (0.1, 0.0, "limit = 0.0, expected more than 0"),
        (0.1, f64::NAN, "limit = NaN, expected more than 0"),
    ] {
        assert_eq!(check(band, limit), Err(reason.to_owned()));
    }
    assert_eq!(toml::from_str::<Options>("").unwrap(), Options::default());
    assert_eq!(toml::from_str::<Options>("band = 0").unwrap().band, 0.0);
    assert!(toml::from_str::<Options>("bnd = 0").is_err());
}

#[test]
fn columns_match_cells() {
    let cells = Summary::default().cells();
    for (column, cell) in Summary::columns().iter().zip(&cells) {
        assert_eq!(cell.is_none(), column.optional, "{}", column.name);
        assert!(cell.iter().all(|value| value.kind() == column.kind));
    }
}

/// Two hundred random runs at uneven times, with references that are constant, step or wander.
fn random_runs() -> impl Iterator<Item = Vec<Sample>> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut number = move || (random.next_u64() >> 11) as f64 * 2f64.powi(-52) - 1.0;
    (0..200).map(move |run| {
        let mut time = number();
        let mut r = number();
        let count = 2 + (30.0 * (1.0 + number())) as u64;
        let mut samples = Vec::new();
        for k in 0..count {
            time += 0.1 * (1.0 + number());
            if run % 3 == 2 || run % 3 == 1 && k == count / 2 {
                r = number();
            }
            let (y, u) = (2.0 * number(), 10.0 * number());
            let e = r - y;
            samples.push(Sample { time, r, y, e, u });
        }
        samples
    })
}

#[test]
fn integrals_are_bounded_by_one_another() {
    for samples in random_runs() {
        let found = summary(samples.iter().copied());
        let steps = samples.windows(2).map(|pair| pair[1].time - pair[0].time);
        let integral: f64 = samples.iter().zip(steps).map(|(s, step)| s.e * step).sum();
        let duration = samples[samples.len() - 1].time - samples[0].time;
        assert!(found.iae >= integral.abs() * (1.0 - 1e-12));
        assert!(found.itae <= found.iae * duration);
        // Cauchy-Schwarz inequality.
        assert!(found.iae * found.iae <= found.ise * duration * (1.0 + 1e-12));
        assert!(found.overshoot.is_none_or(|overshoot| overshoot >= 0.0));
    }
}

#[test]
fn the_sign_of_a_loop_only_changes_its_final_error() {
    for samples in random_runs() {
        let flipped = samples.iter().map(|s| Sample {
            time: s.time,
            r: -s.r,
            y: -s.y,
            e: -s.e,
            u: -s.u,
        });
        let found = summary(samples.iter().copied());
        let expected = Summary {
            final_e: found.final_e.map(|e| -e),
            ..found
        };
        assert_eq!(summary(flipped), expected);
    }
}

/// Scaling by powers of two is exact.
#[test]
fn metrics_scale_with_the_units_of_error_and_time() {
    for samples in random_runs() {
        let scaled = samples.iter().map(|s| Sample {
            time: 4.0 * s.time,
            r: 8.0 * s.r,
            y: 8.0 * s.y,
            e: 8.0 * s.e,
            u: 2.0 * s.u,
        });
        let found = summary(samples.iter().copied());
        let expected = Summary {
            iae: 8.0 * 4.0 * found.iae,
            ise: 64.0 * 4.0 * found.ise,
            itae: 8.0 * 16.0 * found.itae,
            settling_time: found.settling_time.map(|time| 4.0 * time),
            largest_u: 2.0 * found.largest_u,
            final_e: found.final_e.map(|e| 8.0 * e),
            ..found
        };
        assert_eq!(summary(scaled), expected);
    }
}

#[test]
fn integrals_of_two_parts_add_up() {
    for samples in random_runs() {
        let middle = samples.len() / 2;
        let whole = summary(samples.iter().copied());
        let first = summary(samples[..=middle].iter().copied());
        let second = summary(samples[middle..].iter().copied());
        let delay = samples[middle].time - samples[0].time;
        for (sum, whole) in [
            (first.iae + second.iae, whole.iae),
            (first.ise + second.ise, whole.ise),
            (first.itae + second.itae + delay * second.iae, whole.itae),
        ] {
            assert!((sum - whole).abs() <= 1e-13 * whole, "{sum} {whole}");
        }
        assert_eq!(first.largest_u.max(second.largest_u), whole.largest_u);
        assert_eq!(second.final_e, whole.final_e);
    }
}
