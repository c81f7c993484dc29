//! Intermediate updates (FMI 3.0.2, section 4.2.2).

use std::cell::RefCell;
use std::rc::Rc;

use fmu_export::fmi3::{fmi3Error, fmi3Fatal, fmi3OK, fmi3Status};

use super::host::{Arguments, Fmu, Instance, Kind, Kind::*, Update};
use crate::host::guid;
use crate::models::*;

/// A ball in step mode, with the callback for these variables; the step of its default experiment is
/// 0.1 s.
fn running(kind: Kind, early_return: bool, variables: &[u32]) -> Instance {
    let token = guid(BALL);
    let instance = Instance::with(&Arguments {
        token: Some(&token),
        early_return,
        intermediate: Some(variables),
        ..Arguments::of(kind)
    });
    instance.start(0.0, None);
    if kind == Events {
        instance.update();
        assert_eq!(instance.enter_step_mode(), fmi3OK);
    }
    instance
}

#[test]
fn the_host_is_called_at_equal_parts_of_the_step() {
    for kind in [CoSimulation, Events] {
        let instance = running(kind, true, &[Ball::H]);
        instance.steps(0.0, 0.25);
        let point = |k: u32| 0.25 * (f64::from(k) / 3.0);
        let expected: Vec<_> = (1..=3)
            .map(|k| Update {
                time: point(k),
                set_requested: k < 3,
                get_allowed: true,
                step_finished: true,
                can_return: k < 3,
            })
            .collect();
        assert_eq!(instance.host.updates.take(), expected);
        instance.steps(0.25, 0.1);
        assert_eq!(instance.update_times(), [0.25 + 0.1]);
        // An internal point at an event, which is handled without early return.
        let instance = running(kind, false, &[]);
        instance.steps(0.0, 0.25);
        instance.update_times();
        instance.steps(0.25, 0.5);
        let times = instance.update_times();
        assert_eq!(times.len(), 5);
        assert_eq!(times[4], 0.75);
        assert!(times.is_sorted());
    }
    let token = guid(SAMPLED);
    let sampled = Instance::with(&Arguments {
        token: Some(&token),
        intermediate: Some(&[]),
        ..Arguments::of(CoSimulation)
    });
    sampled.start(0.0, None);
    sampled.steps(0.0, 2.0);
    assert_eq!(
        sampled.update_times(),
        [2.0],
        "a sampled model has no internal points"
    );
}

#[test]
fn the_host_reads_outputs_and_sets_inputs_at_internal_points() {
    let instance = running(CoSimulation, false, &[Ball::DRIVE, Ball::H, Ball::V]);
    let rows = Rc::new(RefCell::new(Vec::new()));
    let found = rows.clone();
    instance.on_update(move |fmu, update| {
        let [h, v] = fmu.get([Ball::H, Ball::V]);
        let mut slopes = [f64::NAN; 2];
        let status = fmu.get_output_derivatives(&[Ball::H, Ball::V], &[1, 1], &mut slopes);
        assert_eq!(status, fmi3OK);
        found.borrow_mut().push((update.time, h, v, slopes));
        assert_eq!(fmu.set(Ball::DRIVE, 2.0 * Ball::G), fmi3OK);
        None
    });
    instance.steps(0.0, 0.2);
    // Falls for 0.1 s, and is then accelerated upwards for 0.1 s.
    let rows = rows.borrow();
    assert_eq!(rows.len(), 2);
    let (h, v) = (1.0 - Ball::G * 0.005, -Ball::G * 0.1);
    let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
    assert!(near(rows[0].1, h) && near(rows[0].2, v), "{rows:?}");
    assert_eq!(rows[0].3, [rows[0].2, -Ball::G]);
    assert!(
        near(rows[1].1, 1.0 - Ball::G * 0.01) && near(rows[1].2, 0.0),
        "{rows:?}"
    );
    assert_eq!(rows[1].3, [rows[1].2, Ball::G]);
    drop(rows);
    assert_eq!(instance.get([Ball::DRIVE]), [2.0 * Ball::G]);
}

/// The status of a call in the first update of a step, and the message.
fn in_update(
    variables: &[u32],
    call: impl Fn(Fmu) -> fmi3Status + 'static,
) -> (fmi3Status, Option<String>, Instance) {
    let instance = running(CoSimulation, false, variables);
    let status = Rc::new(RefCell::new(None));
    let found = status.clone();
    instance.on_update(move |fmu, _| {
        found.borrow_mut().get_or_insert_with(|| call(fmu));
        None
    });
    instance.steps(0.0, 0.2);
    let message = instance.messages().pop().map(|message| message.text);
    let status = status.take().unwrap();
    (status, message, instance)
}

#[test]
fn only_announced_continuous_variables_are_accessible() {
    let announced = [Ball::DRIVE, Ball::H, Ball::RESTITUTION, Ball::SWITCH];
    type Call = fn(Fmu) -> fmi3Status;
    let calls: [(&str, Call); 6] = [
        ("only the required intermediate variables", |f| {
            f.get_f64(&[Ball::H, Ball::V], &mut [0.0; 2])
        }),
        ("only the required intermediate variables", |f| {
            f.set_f64(&[Ball::DRIVE, Ball::TROUBLE], &[0.0; 2])
        }),
        ("only the required intermediate variables", |f| {
            f.get_output_derivatives(&[Ball::V], &[1], &mut [0.0])
        }),
        ("restitution is not a continuous input", |f| {
            f.set(Ball::RESTITUTION, 0.25)
        }),
        ("drive = NaN is refused", |f| f.set(Ball::DRIVE, f64::NAN)),
        (
            "is not allowed in the state \"intermediate update mode\"",
            |f| f.set_i32(&[Ball::SWITCH], &[1]),
        ),
    ];
    let untouched = running(CoSimulation, false, &[]);
    untouched.steps(0.0, 0.2);
    for (word, call) in calls {
        let (status, message, instance) = in_update(&announced, call);
        assert_eq!(status, fmi3Error);
        assert!(message.as_ref().unwrap().contains(word), "{message:?}");
        assert_eq!(instance.snapshot(), untouched.snapshot());
    }
    for call in [
        |f: Fmu| f.get_f64(&[Ball::H, Ball::RESTITUTION], &mut [0.0; 2]),
        |f: Fmu| f.get_i32(&[Ball::SWITCH], &mut [0]),
    ] {
        assert_eq!(in_update(&announced, call).0, fmi3OK);
    }
    // After the callback, all variables are accessible again.
    assert_eq!(untouched.get([Ball::V]), [-Ball::G * 0.1 - Ball::G * 0.1]);
}

#[test]
fn the_host_may_request_an_early_return() {
    for (kind, request, expected) in [
        (CoSimulation, 0.0, 0.1),
        (CoSimulation, 0.1, 0.1),
        (CoSimulation, 0.13, 0.13),
        (Events, 0.35, 0.35),
        (CoSimulation, f64::NEG_INFINITY, 0.4),
        (CoSimulation, f64::NAN, 0.4),
        (Events, 7.0, 0.4),
    ] {
        let instance = running(kind, true, &[]);
        instance.on_update(move |_, update| update.can_return.then_some(request));
        let results = instance.steps(0.0, 0.4);
        assert_eq!(results.time, expected, "{request}");
        assert_eq!((results.early, results.event), (expected < 0.4, false));
        assert_eq!(instance.get([Ball::TIME]), [expected]);
        let [last] = *instance.update_times().last_chunk().unwrap();
        assert_eq!(last, expected, "the last update is at the end");
        // It continues there, also from a saved state.
        let bytes = instance.snapshot();
        instance.on_update(|_, _| None);
        assert_eq!(instance.steps(expected, 0.1).time, expected + 0.1);
        let after = instance.snapshot();
        assert_eq!(
            instance.resume(&bytes).steps(expected, 0.1).time,
            expected + 0.1
        );
        assert_eq!(instance.snapshot(), after);
    }
    let instance = running(CoSimulation, false, &[]);
    instance.on_update(|_, update| {
        assert!(!update.can_return);
        Some(0.1)
    });
    let results = instance.steps(0.0, 0.4);
    assert_eq!((results.time, results.early), (0.4, false), "not allowed");
}

#[test]
fn an_event_at_the_requested_return_is_an_early_return_with_an_event() {
    let instance = running(Events, true, &[]);
    instance.on_update(|_, update| update.can_return.then_some(Ball::KICK));
    let results = instance.steps(0.0, 1.0);
    assert_eq!(
        (results.event, results.early, results.time),
        (true, true, Ball::KICK)
    );
}

#[test]
fn a_panic_or_an_error_in_a_callback_ends_the_step() {
    for kind in [CoSimulation, Events] {
        for (trouble, status) in [(PANIC, fmi3Fatal), (BREAK, fmi3Error)] {
            let variables = [Ball::TROUBLE, Ball::V_DOT];
            let instance = running(kind, false, &variables);
            instance.on_update(move |fmu, update| {
                if update.time > 0.15 {
                    return None;
                }
                assert_eq!(fmu.set(Ball::TROUBLE, trouble), fmi3OK);
                assert_eq!(fmu.get_f64(&[Ball::V_DOT], &mut [0.0]), status);
                None
            });
            let (found, results) = instance.step(0.0, 0.4);
            assert_eq!((found, results.time), (status, 0.1));
            assert_eq!(instance.update_times(), [0.1]);
            assert_eq!(instance.step(0.1, 0.1).0, status);
            assert_eq!(
                instance.reset(),
                if status == fmi3Fatal {
                    fmi3Fatal
                } else {
                    fmi3OK
                }
            );
        }
    }
}

#[test]
fn a_discarded_evaluation_in_a_callback_is_refused_and_the_step_goes_on() {
    let (status, message, instance) = in_update(&[Ball::TROUBLE, Ball::V_DOT], |fmu| {
        assert_eq!(fmu.set(Ball::TROUBLE, DISCARD), fmi3OK);
        let status = fmu.get_f64(&[Ball::V_DOT], &mut [0.0]);
        assert_eq!(fmu.set(Ball::TROUBLE, 0.0), fmi3OK);
        status
    });
    assert_eq!(status, fmi3Error);
    assert!(message.unwrap().contains("discarded by the ball"));
    assert_eq!(instance.get([Ball::TIME]), [0.2]);
}
