//! Co-simulation with event mode and early return (FMI 3.0.2, section 4.2.1).

use fmu_export::fmi3::{fmi3Discard, fmi3Error, fmi3OK};

use super::host::{Arguments, Instance, Kind, Kind::*, Results};
use crate::host::guid;
use crate::models::*;

// Value references of the model `Sampled`.
const TS: u32 = 0;
const FAILS_AT: u32 = 1;
const TIMES: u32 = 3;
const COUNT: u32 = 6;

/// An instance of a model in step mode, after the event at the start.
fn running(kind: Kind, model: usize, early_return: bool, set: impl FnOnce(&Instance)) -> Instance {
    let token = guid(model);
    let instance = Instance::with(&Arguments {
        token: Some(&token),
        early_return,
        ..Arguments::of(kind)
    });
    set(&instance);
    instance.start(0.0, None);
    if kind == Events {
        instance.update();
        assert_eq!(instance.enter_step_mode(), fmi3OK);
    }
    instance
}

/// The number of samples, and the times of the last three.
fn samples(instance: &Instance) -> (i32, [f64; 3]) {
    let (mut count, mut times) = ([0], [0.0; 3]);
    assert_eq!(instance.get_i32(&[COUNT], &mut count), fmi3OK);
    assert_eq!(instance.get_f64(&[TIMES], &mut times), fmi3OK);
    (count[0], times)
}

/// Handles an event after a step; returns the time of the next.
#[track_caller]
fn handle(instance: &Instance) -> Option<f64> {
    assert_eq!(instance.enter_event_mode(), fmi3OK);
    let (_, next) = instance.update();
    assert_eq!(instance.enter_step_mode(), fmi3OK);
    next
}

fn results(event: bool, early: bool, time: f64) -> Results {
    Results { event, early, time }
}

#[test]
fn a_step_returns_early_exactly_at_each_sample() {
    let instance = running(Events, SAMPLED, true, |i| {
        assert_eq!(i.set(TS, 0.1), fmi3OK);
    });
    assert_eq!(samples(&instance).0, 1, "the sample at the start");
    let mut time = 0.0;
    for k in 1..200 {
        let instant = f64::from(k) * 0.1;
        assert_eq!(instance.steps(time, 0.25), results(true, true, instant));
        assert_eq!(instance.get([9]), [instant], "the independent variable");
        assert_eq!(samples(&instance).0, k, "the sample is taken in event mode");
        let next = handle(&instance);
        assert_eq!(
            (samples(&instance).0, samples(&instance).1[2]),
            (k + 1, instant)
        );
        assert_eq!(next, Some(f64::from(k + 1) * 0.1));
        time = instant;
    }
}

#[test]
fn a_step_that_ends_at_a_sample_ends_where_the_host_wants_it() {
    for early_return in [false, true] {
        let instance = running(Events, SAMPLED, early_return, |i| {
            assert_eq!(i.set(TS, 0.1), fmi3OK);
        });
        let mut time = 0.0;
        for k in 1..200 {
            // Adding up has another rounding error than the multiples of 0.1.
            let end = time + 0.1;
            assert_eq!(instance.steps(time, 0.1), results(true, false, end));
            handle(&instance);
            assert_eq!(samples(&instance).0, k + 1);
            time = end;
        }
    }
}

#[test]
fn without_early_return_samples_are_taken_within_the_step() {
    for (size, n) in [(0.75, 4), (2.25, 2), (0.125, 30), (0.3, 11), (0.5, 6)] {
        let plain = running(CoSimulation, SAMPLED, false, |_| {});
        let events = running(Events, SAMPLED, false, |_| {});
        for k in 0..n {
            let time = f64::from(k) * size;
            let end = plain.steps(time, size).time;
            let found = events.steps(time, size);
            // A sample at the end of the step is left to event mode; in plain co-simulation, it belongs
            // to the next step.
            let ends_at_sample = (end * 2.0 - (end * 2.0).round()).abs() < 1e-9;
            assert_eq!(found, results(ends_at_sample, false, end), "{size} {k}");
            assert_eq!(samples(&events), samples(&plain), "{size} {k}");
            if ends_at_sample {
                let before = samples(&events).0;
                handle(&events);
                assert_eq!(samples(&events).0, before + 1);
                // The plain instance has it at the start of its next step.
                plain.steps(end, 1e-3);
                events.steps(end, 1e-3);
                assert_eq!(samples(&events), samples(&plain));
                break;
            }
        }
    }
}

#[test]
fn a_host_that_ignores_events_gets_them_again() {
    let instance = running(Events, SAMPLED, true, |_| {});
    assert_eq!(instance.steps(0.0, 1.0), results(true, true, 0.5));
    assert_eq!(instance.steps(0.5, 1.0), results(true, true, 0.5));
    handle(&instance);
    assert_eq!(instance.steps(0.5, 1.0), results(true, true, 1.0));
    let late = running(Events, SAMPLED, false, |_| {});
    assert_eq!(late.steps(0.0, 0.5), results(true, false, 0.5));
    assert_eq!(
        late.steps(0.5, 0.25),
        results(false, false, 0.75),
        "taken within the step"
    );
    assert_eq!(samples(&late).0, 2);
}

#[test]
fn the_events_of_a_continuous_model_are_those_that_it_announces() {
    let instance = running(Events, BALL, true, |_| {});
    assert_eq!(instance.steps(0.0, 0.25), results(false, false, 0.25));
    assert_eq!(instance.steps(0.25, 1.0), results(true, true, Ball::KICK));
    let [v] = instance.get([Ball::V]);
    assert_eq!(instance.enter_event_mode(), fmi3OK);
    // What step mode does not compute is up to date in event mode.
    assert_eq!(instance.get([Ball::H_DOT]), [v]);
    let (changed, next) = instance.update();
    assert_eq!((changed, next), (true, None));
    // It is below the ground, too, and bounces.
    assert_eq!(instance.get([Ball::V, Ball::H_DOT]), [-v / 2.0 + 1.0; 2]);
    assert_eq!(instance.update(), (false, None));
    assert_eq!(instance.enter_step_mode(), fmi3OK);
    assert_eq!(instance.steps(Ball::KICK, 1.0), results(false, false, 1.5));
    // Inputs that change in step mode count in event mode.
    assert_eq!(instance.set(Ball::DRIVE, 4.0), fmi3OK);
    assert_eq!(instance.enter_event_mode(), fmi3OK);
    assert_eq!(instance.get([Ball::V_DOT]), [4.0 - Ball::G]);
    assert_eq!(instance.set_i32(&[Ball::SWITCH], &[3]), fmi3OK);

    let within = running(Events, BALL, false, |_| {});
    assert_eq!(within.steps(0.0, 1.0), results(false, false, 1.0));
    let mut events = [0];
    assert_eq!(within.get_i32(&[Ball::EVENTS], &mut events), fmi3OK);
    assert_eq!(events, [2], "at the start and in the step");
}

#[test]
fn step_mode_begins_with_the_outputs_of_event_mode() {
    let instance = running(Events, BALL, true, |_| {});
    instance.steps(0.0, 0.25);
    let [h, v] = instance.get([Ball::H, Ball::V]);
    assert_eq!(instance.enter_event_mode(), fmi3OK);
    assert_eq!(instance.set(Ball::DRIVE, 8.0), fmi3OK);
    assert_eq!(instance.set(Ball::TROUBLE, DIVERGE), fmi3OK);
    assert_eq!(instance.enter_step_mode(), fmi3Error);
    assert!(instance.last_message().contains("der(v) became NaN"));
    assert_eq!(instance.set(Ball::TROUBLE, 0.0), fmi3OK);
    assert_eq!(instance.enter_step_mode(), fmi3OK);
    assert_eq!(
        instance.get([Ball::ENERGY]),
        [Ball::G * h + v * v / 2.0 + 1.0]
    );
}

#[test]
fn a_failure_after_a_part_of_a_step_reports_how_far_it_came() {
    // The kick at 0.5 s divides the step; steps after 0.15 s fail.
    for (fault, status) in [
        (REFUSE, fmi3Discard),
        (DISCARD, fmi3Discard),
        (BREAK, fmi3Error),
    ] {
        let instance = running(Events, BALL, false, |_| {});
        assert_eq!(instance.set(Ball::FAULT, fault), fmi3OK);
        let before = instance.snapshot();
        assert_eq!(
            instance.step(0.0, 1.0),
            (status, results(false, false, Ball::KICK))
        );
        assert_eq!(instance.get([Ball::TIME]), [Ball::KICK]);
        assert_eq!(instance.step(Ball::KICK, 0.25).0, fmi3Error);
        let v = instance.get([Ball::V]);
        assert_eq!(instance.resume(&before).set(Ball::FAULT, 0.0), fmi3OK);
        assert_ne!(instance.get([Ball::V]), v);
        instance.steps(0.0, 1.0);
    }
    let instance = running(Events, SAMPLED, false, |_| {});
    assert_eq!(instance.set_i32(&[FAILS_AT], &[3]), fmi3OK);
    let (status, found) = instance.step(0.0, 2.0);
    assert_eq!(
        (status, found.time),
        (fmi3Discard, 1.0),
        "the sample at 1 s is discarded"
    );
    assert_eq!(samples(&instance).0, 2);
}

#[test]
fn a_failed_event_can_be_repeated() {
    let instance = running(Events, BALL, true, |_| {});
    assert_eq!(instance.enter_event_mode(), fmi3OK);
    for (trouble, status) in [(DISCARD, fmi3Discard), (REFUSE, fmi3Error)] {
        assert_eq!(instance.set(Ball::TROUBLE, trouble), fmi3OK);
        assert_eq!(instance.try_update(&mut (false, None)), status);
    }
    assert_eq!(instance.set(Ball::TROUBLE, 0.0), fmi3OK);
    instance.update();
}

#[test]
fn a_state_saved_after_an_early_return_continues_there() {
    let instance = running(Events, SAMPLED, true, |_| {});
    assert_eq!(instance.steps(0.0, 0.75).time, 0.5);
    let bytes = instance.snapshot();
    let go_on = |instance: &Instance| {
        handle(instance);
        assert_eq!(instance.steps(0.5, 0.25), results(false, false, 0.75));
        assert_eq!(instance.steps(0.75, 0.75), results(true, true, 1.0));
        instance.snapshot()
    };
    let expected = go_on(&instance);
    let other = Instance::of(Events, SAMPLED);
    other.resume(&bytes);
    // It was created without early return, which is no part of the state.
    handle(&other);
    assert_eq!(other.steps(0.5, 0.25), results(false, false, 0.75));
    instance.resume(&bytes);
    assert_eq!(go_on(&instance), expected);
}

#[test]
fn steps_end_though_the_rounding_of_time_exceeds_the_sample_time() {
    let instance = Instance::of(Events, SAMPLED);
    assert_eq!(instance.set(TS, 0.001), fmi3OK);
    instance.start(1e9, None);
    instance.update();
    assert_eq!(instance.enter_step_mode(), fmi3OK);
    let found = instance.steps(1e9, 0.125);
    assert_eq!(found.time, 1e9 + 0.125);
    let count = samples(&instance).0;
    assert!((120..=127).contains(&count), "{count}");
}
