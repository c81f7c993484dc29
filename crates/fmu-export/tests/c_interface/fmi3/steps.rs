//! Steps of co-simulation without events (FMI 3.0.2, section 4.2.1).

use std::ptr::null_mut;

use fmu_export::fmi3::*;
use fmu_export::fmi3::{fmi3Discard, fmi3Error, fmi3OK};

use super::host::{Instance, Kind::*, Results};
use crate::models::*;

/// The results of a step without events that ended at a time.
fn plain(time: f64) -> Results {
    Results {
        event: false,
        early: false,
        time,
    }
}

#[test]
fn a_step_returns_where_it_ended() {
    let instance = Instance::new(CoSimulation).started(0.5);
    assert_eq!(instance.steps(0.5, 0.25), plain(0.75));
    // Without events, also over the time event at 0.5 s.
    assert_eq!(instance.steps(0.75, 1.0), plain(1.75));
    let fallen = Ball::G * 1.25 * 1.25 / 2.0;
    assert_eq!(
        instance.get([Ball::H, Ball::V]),
        [1.0 - fallen, -Ball::G * 1.25]
    );
}

#[test]
fn results_that_the_host_does_not_want_may_be_null() {
    for kind in [CoSimulation, Events] {
        let instance = Instance::new(kind).started(0.0);
        let _ = instance.enter_step_mode();
        let n = null_mut();
        // SAFETY: the instance lives.
        let status = unsafe { fmi3DoStep(instance.0, 0.0, 0.25, 1, n, n, n, null_mut()) };
        assert_eq!(status, fmi3OK);
        assert_eq!(instance.get([Ball::TIME]), [0.25]);
    }
}

#[test]
fn invalid_steps_are_refused_and_change_nothing() {
    for kind in [CoSimulation, Events] {
        let instance = Instance::new(kind);
        instance.start(0.0, Some(2.0));
        let _ = instance.enter_step_mode();
        instance.steps(0.0, 0.25);
        for (time, step, word) in [
            (f64::NAN, 0.25, "the communication point is NaN"),
            (f64::INFINITY, 0.25, "the communication point is inf"),
            (0.25, f64::NAN, "the communication step is NaN"),
            (0.25, f64::INFINITY, "the communication step is inf"),
            (0.25, -0.25, "the communication step is -0.25"),
            (0.25, 2.0, "the step ends at 2.25, past the stop time 2.0"),
            (
                0.5,
                0.25,
                "the communication point is 0.5; expected 0.25, where the last step ended",
            ),
            (0.0, 0.25, "expected 0.25"),
        ] {
            instance.refuses(&["fmi3DoStep", word], |f| {
                let (status, results) = f.step(time, step);
                assert_eq!(results, plain(0.25), "{word}");
                status
            });
        }
        let before = instance.snapshot();
        assert_eq!(instance.steps(0.25, 0.0), plain(0.25), "nothing to do");
        assert_eq!(instance.snapshot(), before);
        assert_eq!(instance.steps(0.25 + 1e-10, 0.0625).time, 0.3125 + 1e-10);
    }
}

#[test]
fn invalid_times_of_the_experiment_are_refused() {
    let instance = Instance::new(CoSimulation);
    for (start, stop) in [
        (f64::NAN, None),
        (f64::NEG_INFINITY, None),
        (0.0, Some(-1.0)),
        (0.0, Some(f64::NAN)),
        (0.0, Some(f64::INFINITY)),
    ] {
        instance.refuses(
            &["fmi3EnterInitializationMode", "expected a finite number"],
            |f| f.enter_initialization_mode(start, stop),
        );
    }
    instance.start(0.0, Some(0.0));
}

#[test]
fn a_failed_step_leads_to_the_state_that_its_error_names() {
    for kind in [CoSimulation, Events] {
        for (fault, status, next) in [
            (REFUSE, fmi3Error, fmi3OK),
            (DISCARD, fmi3Discard, fmi3Error),
            (BREAK, fmi3Error, fmi3Error),
        ] {
            let instance = Instance::new(kind).started(0.0);
            let _ = instance.enter_step_mode();
            instance.steps(0.0, 0.25);
            let before = instance.snapshot();
            let values = instance.get([Ball::H, Ball::V, Ball::TIME]);
            assert_eq!(instance.set(Ball::FAULT, fault), fmi3OK);
            assert_eq!(instance.step(0.25, 0.125), (status, plain(0.25)));
            assert!(
                instance
                    .last_message()
                    .contains("from t = 0.25 s by 0.125 s")
            );
            assert_eq!(instance.get([Ball::H, Ball::V, Ball::TIME]), values);
            // A refused step may be followed by another.
            assert_eq!(instance.set(Ball::FAULT, 0.0), next);
            assert_eq!(instance.step(0.25, 0.125).0, next);
            assert_eq!(instance.resume(&before).steps(0.25, 0.125), plain(0.375));
        }
    }
}

#[test]
fn adjoint_and_directional_derivatives_are_those_of_one_matrix() {
    let exchange = Instance::new(ModelExchange);
    assert_eq!(exchange.set(Ball::DRAG, 0.5), fmi3OK);
    exchange.start(0.0, None);
    assert_eq!(exchange.enter_continuous_time_mode(), fmi3OK);
    assert_eq!(exchange.set_states(&[1.0, -3.0]), fmi3OK);
    let stepped = Instance::new(CoSimulation).started(0.0);
    stepped.steps(0.0, 0.25);
    let unknowns: [&[u32]; 2] = [
        &[
            Ball::ENERGY,
            Ball::H_DOT,
            Ball::V_DOT,
            Ball::CONTACT,
            Ball::V,
        ],
        &[Ball::ENERGY, Ball::H],
    ];
    let knowns: [&[u32]; 2] = [&[Ball::V, Ball::DRIVE, Ball::H], &[Ball::DRIVE]];
    for (instance, (unknowns, knowns)) in [exchange, stepped]
        .iter()
        .zip(unknowns.into_iter().zip(knowns))
    {
        let unit = |n: usize, k: usize| -> Vec<f64> {
            (0..n).map(|i| f64::from(u8::from(i == k))).collect()
        };
        let mut sum = 0.0;
        for (row, _) in unknowns.iter().enumerate() {
            for (column, _) in knowns.iter().enumerate() {
                let (mut forward, mut back) =
                    (vec![f64::NAN; unknowns.len()], vec![f64::NAN; knowns.len()]);
                let seed = unit(knowns.len(), column);
                assert_eq!(
                    instance.directional(unknowns, knowns, &seed, &mut forward),
                    fmi3OK
                );
                let seed = unit(unknowns.len(), row);
                assert_eq!(instance.adjoint(unknowns, knowns, &seed, &mut back), fmi3OK);
                assert_eq!(forward[row], back[column]);
                sum += forward[row].abs();
            }
        }
        assert!(sum > 0.0);
        for (unknown, known, word) in [
            (Ball::DRIVE, Ball::DRIVE, "drive is not an output"),
            (Ball::ENERGY, Ball::ENERGY, "energy is not an input"),
            (Ball::TIME, Ball::DRIVE, "is unknown"),
            (Ball::ENERGY, Ball::TIME, "is unknown"),
        ] {
            instance.refuses(&[word], |f| {
                f.directional(&[unknown], &[known], &[1.0], &mut [0.0])
            });
            instance.refuses(&[word], |f| {
                f.adjoint(&[unknown], &[known], &[1.0], &mut [0.0])
            });
        }
        let (energy, drive) = ([Ball::ENERGY], [Ball::DRIVE]);
        instance.refuses(&["the direction contains NaN"], |f| {
            f.adjoint(&energy, &drive, &[f64::NAN], &mut [0.0])
        });
        for n in [0, 2] {
            let (seed, words) = (
                &[1.0; 2][..n],
                [&*format!("there are {n} values; expected 1")],
            );
            instance.refuses(&words, |f| f.directional(&energy, &drive, seed, &mut [0.0]));
            instance.refuses(&words, |f| {
                f.adjoint(&energy, &drive, &[1.0], &mut [0.0; 2][..n])
            });
        }
    }
    let every = Instance::of(CoSimulation, EVERY).started(0.0);
    every.refuses(&["the model has no derivatives"], |f| {
        f.directional(&[Every::SUM], &[Every::SCALAR], &[1.0], &mut [0.0])
    });
}
