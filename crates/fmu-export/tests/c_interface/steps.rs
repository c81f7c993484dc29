//! Steps of co-simulation: the experiment and the steps it allows, failures, samples, events, integration,
//! intermediate updates, and ramps of inputs.

use std::cell::RefCell;
use std::ptr::null_mut;
use std::rc::Rc;

use fmu_description::Type;
use fmu_export::{fmi2::*, fmi3::*};

use crate::driver::*;
use crate::models::*;

const H: f64 = 0.001;
const NAN: f64 = f64::NAN;
const INFINITE: f64 = f64::INFINITY;
const STEPPED: [Kind; 3] = [PLAIN[0], PLAIN[1], EVENTS];

/// A ball whose first step has ended at `start` + 0.25.
fn stepped(kind: Kind, start: f64, stop: Option<f64>) -> Instance {
    let instance = Instance::of(kind, BALL);
    instance.start(start, stop);
    assert!(kind != EVENTS || instance.enter_step_mode() == OK);
    instance.steps(start, 0.25);
    instance
}

// --- the experiment -----------------------------------------------------------------------------

#[test]
fn invalid_experiments_are_refused() {
    for kind in PLAIN {
        for (start, stop) in [
            (NAN, None),
            (INFINITE, None),
            (-INFINITE, None),
            (0.0, Some(NAN)),
            (0.0, Some(INFINITE)),
            (1.0, Some(0.5)),
        ] {
            let instance = Instance::of(kind, BALL);
            instance.refuses("expected a finite number", |f| f.enter(start, stop, None));
        }
        Instance::of(kind, BALL).start(0.0, Some(0.0));
    }
    let instance = Instance::of(PLAIN[0], EVERY);
    assert_eq!(instance.setup(3.0, Some(3.0)), OK);
    instance.start(7.0, None);
    assert_eq!(instance.get([Y]), [7.0], "the last experiment applies");
    instance.steps(7.0, 50.0);
}

#[test]
fn invalid_steps_are_refused_and_change_nothing() {
    for kind in STEPPED {
        let instance = stepped(kind, 0.0, Some(2.0));
        for (time, step, words) in [
            (NAN, 0.25, "the communication point is NaN"),
            (INFINITE, 0.25, "the communication point is inf"),
            (0.25, NAN, "the communication step is NaN"),
            (0.25, INFINITE, "the communication step is inf"),
            (0.25, -0.25, "the communication step is -0.25"),
            (0.25, -1e-300, "the communication step is -1e-300"),
            (0.25, 2.0, "the step ends at 2.25, past the stop time 2.0"),
            (
                0.5,
                0.25,
                "is 0.5; expected 0.25, where the last step ended",
            ),
            (0.0, 0.25, "expected 0.25"),
        ] {
            instance.refuses(words, |f| {
                let (status, found) = f.step_to(time, step);
                assert!(kind.0 == Fmi2 || found == results(false, false, 0.25));
                status
            });
        }
        let before = instance.snapshot();
        for step in [0.0, -0.0] {
            assert_eq!(instance.steps(0.25, step), results(false, false, 0.25));
            assert_eq!(instance.snapshot(), before, "nothing to do");
        }
        // Up to rounding.
        assert_eq!(instance.steps(0.25 + 1e-10, 1.75 + 1e-10).time, 2.0 + 2e-10);
        instance.steps(2.0, 0.0);
        instance.refuses("stop time", |f| f.step(2.0, H));
        let instance = Instance::of(kind, BALL).run(0.0);
        instance.steps(0.0, 0.0);
        let after = instance.step(H, H);
        assert!(
            kind == EVENTS || after == OK,
            "a step of zero is no first step"
        );
    }
}

#[test]
fn steps_continue_at_the_end_of_the_last_one_up_to_rounding() {
    for (kind, start) in STEPPED
        .into_iter()
        .flat_map(|kind| [0.0, 1e6, -3.0].map(|t| (kind, t)))
    {
        for side in [-1.0, 1.0] {
            let (instance, end) = (stepped(kind, start, None), start + 0.25);
            let tolerance = side * (1e-6 * H + 1e-9 * (1.0 + end.abs()));
            let words = format!("expected {end}");
            instance.refuses(&words, |f| f.step(end + 3.0 * tolerance, H));
            instance.steps(end + 0.3 * tolerance, H);
        }
    }
}

#[test]
fn the_first_step_may_start_one_step_late_with_a_warning() {
    for kind in PLAIN {
        let instance = Instance::of(kind, BALL).run(2.0);
        for gap in [-0.5, -0.01, 1.01, 2.0, 1000.0] {
            instance.refuses("expected the start time 2", |f| f.step(2.0 + gap * H, H));
        }
        for (gap, warnings) in [(1e-7, 0), (0.5, 1), (1.0, 1)] {
            let instance = Instance::of(kind, BALL).run(2.0);
            instance.steps(2.0 + gap * H, H);
            instance.steps(2.0 + (gap + 1.0) * H, H);
            let messages = instance.messages();
            assert_eq!(messages.len(), warnings);
            for message in messages {
                assert_eq!(
                    (&*message.category, message.status),
                    ("logStatusWarning", WARNING)
                );
            }
        }
    }
}

#[test]
fn the_status_of_fmi_2_has_the_last_successful_time() {
    let instance = Instance::of(PLAIN[0], BALL).run(3.0);
    let (mut ended, mut time) = (7, 7.0);
    for now in [3.0, 3.25, 3.5] {
        assert_eq!(instance.real_status(fmi2LastSuccessfulTime, &mut time), OK);
        assert_eq!((time, instance.step(now, NAN)), (now, ERROR));
        instance.steps(now, 0.25);
    }
    assert_eq!(
        (instance.boolean_status(fmi2Terminated, &mut ended), ended),
        (OK, 0)
    );
    (ended, time) = (7, 7.0);
    for kind in [0, 1, 99, -1] {
        instance.refuses("fmi2GetRealStatus", |f| f.real_status(kind, &mut time));
        instance.refuses("fmi2GetBooleanStatus", |f| {
            f.boolean_status(kind, &mut ended)
        });
    }
    instance.refuses("asynchronous steps only", |f| {
        f.real_status(fmi2Terminated, &mut time)
    });
    let kind = fmi2LastSuccessfulTime;
    instance.refuses("asynchronous steps only", |f| {
        f.boolean_status(kind, &mut ended)
    });
    assert_eq!((ended, time), (7, 7.0));
    // SAFETY: the instance lives; NULL is the case under test.
    unsafe {
        instance.refuses("NULL", |f| {
            Status(fmi2GetRealStatus(f.c, kind, null_mut()).0)
        });
        instance.refuses("NULL", |f| {
            Status(fmi2GetBooleanStatus(f.c, fmi2Terminated, null_mut()).0)
        });
    }
}

#[test]
fn results_of_fmi_3_that_the_host_does_not_want_may_be_null() {
    for kind in [PLAIN[1], EVENTS] {
        let (instance, n) = (Instance::running(kind, BALL), null_mut());
        // SAFETY: the instance lives.
        let status = unsafe { fmi3DoStep(instance.c, 0.0, 0.25, 1, n, n, n, null_mut()) };
        assert_eq!(
            (status, instance.get([Ball::TIME])),
            (fmi3Status(0), [0.25])
        );
    }
}

// --- failures -----------------------------------------------------------------------------------

#[test]
fn a_failed_step_leads_to_the_state_that_its_error_names() {
    for kind in STEPPED {
        for (fault, status, next, words) in [
            (REFUSE, ERROR, OK, "refused"),
            (DISCARD, DISCARDED, ERROR, "discarded"),
            (BREAK, ERROR, ERROR, "broken"),
        ] {
            let instance = stepped(kind, 0.0, None);
            let before = instance.snapshot();
            let values = instance.get([Ball::H, Ball::V]);
            assert_eq!(instance.set(Ball::FAULT, fault), OK);
            let end = results(false, false, 0.25);
            assert_eq!(instance.step_to(0.25, 0.125), (status, end));
            let message = instance.messages().pop().unwrap();
            assert_eq!(message.status, status);
            let is_discarded = message.category == "logStatusDiscard";
            assert_eq!(is_discarded, status == DISCARDED);
            instance.says(&format!("from t = 0.25 s by 0.125 s: {words} by the model"));
            assert_eq!(instance.get([Ball::H, Ball::V]), values);
            // A refused step may be followed by another.
            assert_eq!(instance.set(Ball::FAULT, 0.0), next);
            assert_eq!(instance.step(0.25, 0.125), next);
            assert_eq!(instance.resume(&before).steps(0.25, 0.125).time, 0.375);
            if next == ERROR {
                instance.set(Ball::FAULT, fault);
                instance.step(0.375, 0.125);
                assert_eq!(instance.reset(), OK);
                instance.start(0.0, None);
            }
        }
    }
}

#[test]
fn outputs_that_are_not_finite_are_errors_that_name_them() {
    for kind in PLAIN {
        let instance = Instance::running(kind, EVERY);
        assert_eq!(instance.set(TROUBLE, DIVERGE), OK);
        assert_eq!(instance.step(0.0, 0.25), ERROR);
        instance.says("from t = 0.0 s by 0.25 s: parts[2] became inf: the simulation diverges");
        assert_eq!(instance.step(0.0, 0.25), ERROR);
        let sampled = Instance::running(kind, SAMPLED);
        assert_eq!(sampled.set(Sampled::U, 0.0), OK);
        assert_eq!(sampled.step(0.0, 0.5), ERROR);
        sampled.says("y became inf");
    }
}

#[test]
fn a_failed_initialization_can_be_repeated() {
    for (kind, trouble) in KINDS
        .into_iter()
        .flat_map(|kind| [DIVERGE, BREAK, DISCARD].map(|t| (kind, t)))
    {
        let is_stepped = kind.1 == Stepped;
        let (model, reference) = if is_stepped {
            (EVERY, TROUBLE)
        } else {
            (BALL, Ball::TROUBLE)
        };
        let words = match (trouble, is_stepped) {
            (DIVERGE, true) => "at t = 0.0 s: parts[2] became inf",
            (DIVERGE, false) => "at t = 0.0 s: der(v) became NaN",
            (BREAK, _) => "broken by the model",
            _ => "discarded by the model",
        };
        let instance = Instance::of(kind, model);
        assert_eq!(instance.set(reference, trouble), OK);
        assert_eq!(instance.enter(0.0, None, None), OK);
        instance.refuses(words, Fmu::exit_initialization_mode);
        let output = if is_stepped { Y } else { Ball::ENERGY };
        instance.refuses(words, |f| f.get_f64(&[output], &mut [0.0]));
        if kind.1 == Exchanged {
            instance.refuses(words, |f| f.get_derivatives(&mut [0.0; 2]));
        }
        assert_eq!(instance.set(reference, 0.0), OK);
        assert_eq!(instance.exit_initialization_mode(), OK);
    }
}

#[test]
fn every_initialization_starts_from_fresh_fields() {
    for kind in PLAIN {
        let instance = Instance::of(kind, EVERY);
        assert_eq!(instance.enter(1.0, None, None), OK);
        for u in [0.25, -1.0, 0.5] {
            assert_eq!(instance.set(U, u), OK);
            assert_eq!(instance.get([SUM]), [1.0], "one value in the history");
            assert_eq!(
                instance.texts(&[REPORT], 1),
                [c"2".to_owned()],
                "one tick and one use"
            );
        }
        assert_eq!(instance.exit_initialization_mode(), OK);
        let new = Instance::of(kind, EVERY);
        assert_eq!(new.set(U, 0.5), OK);
        new.start(1.0, None);
        assert_eq!(instance.snapshot(), new.snapshot());
    }
}

// --- samples and events -------------------------------------------------------------------------

/// The number of samples, and the times of the last three.
fn samples(f: &Instance) -> (f64, Vec<f64>) {
    let [count] = f.read(Type::Int32, [Sampled::SAMPLES]);
    let times: Vec<u32> = match f.kind.0 {
        Fmi2 => (Sampled::TIMES..).take(3).collect(),
        Fmi3 => vec![Sampled::TIMES],
    };
    (count, f.get_all(Type::Float64, &times, 3).1)
}

#[test]
fn samples_are_taken_at_their_instants_whatever_the_communication_step() {
    for kind in PLAIN {
        for (steps, size, times) in [
            (1, 0.5, [0.0, 0.0, 0.0]),
            (3, 0.5, [0.0, 0.5, 1.0]),
            (8, 0.125, [0.0, 0.0, 0.5]),
            (2, 0.75, [0.0, 0.5, 1.0]),
            (1, 2.5, [1.0, 1.5, 2.0]),
        ] {
            let instance = Instance::running(kind, SAMPLED);
            assert_eq!(samples(&instance).0, 0.0, "none at the initialization");
            for k in 0..steps {
                instance.steps(f64::from(k) * size, size);
            }
            let count = (f64::from(steps) * size / 0.5).ceil();
            assert_eq!(
                samples(&instance),
                (count, times.to_vec()),
                "{steps} steps of {size} s"
            );
        }
        let late = Instance::of(kind, SAMPLED).run(0.25);
        late.steps(0.25, 1.25);
        assert_eq!(
            samples(&late).1,
            [0.25, 0.75, 1.25],
            "they count from the start time"
        );
        let instance = Instance::running(kind, SAMPLED);
        instance.steps(0.0, 0.75);
        let bytes = instance.snapshot();
        for instance in [instance, Instance::of(kind, SAMPLED)] {
            instance.resume(&bytes).steps(0.75, 0.125);
            assert_eq!(samples(&instance).0, 2.0, "no instant in this step");
            instance.steps(0.875, 0.25);
            assert_eq!(samples(&instance).1, [0.0, 0.5, 1.0]);
        }
    }
}

#[test]
fn failures_in_samples_and_of_the_sample_time() {
    for kind in PLAIN {
        let one = || {
            let instance = Instance::running(kind, SAMPLED);
            instance.steps(0.0, 0.5);
            instance
        };
        let fail = |f: &Instance, number, how| {
            assert_eq!(f.set_i32(&[Sampled::FAILS_AT], &[number]), OK);
            assert_eq!(f.set(Sampled::FAILURE, how), OK);
        };
        let (instance, before) = (one(), one().snapshot());
        assert_eq!(instance.step(0.5, 1e9), DISCARDED);
        instance.says("contains 2000000000 sample instants, more than the maximum of 100000000");
        assert_eq!(samples(&instance).0, 1.0);
        instance.resume(&before).steps(0.5, 0.5);
        assert_eq!(samples(&instance).0, 2.0);
        // In the first sample of a step, nothing is changed.
        let instance = one();
        fail(&instance, 2, REFUSE);
        let words = "from t = 0.5 s by 0.5 s: refused by the model";
        instance.refuses(words, |f| f.step(0.5, 0.5));
        fail(&instance, 0, REFUSE);
        instance.steps(0.5, 0.5);
        fail(&instance, 3, DISCARD);
        assert_eq!(instance.step(1.0, 0.5), DISCARDED);
        assert_eq!(samples(&instance), (2.0, vec![0.0, 0.0, 0.5]));
        // A later one breaks the instance.
        for failure in [DISCARD, REFUSE, BREAK] {
            let instance = one();
            fail(&instance, 4, failure);
            assert_eq!(instance.step(0.5, 2.0), ERROR, "{failure}");
            instance.refuses("\"error\"", |f| f.step(0.5, 2.0));
            assert_eq!(instance.reset(), OK);
            instance.start(0.0, None);
            instance.steps(0.0, 2.0);
        }
        for ts in [0.0, -0.5, 1e-320] {
            let instance = Instance::of(kind, SAMPLED);
            assert_eq!(instance.set(Sampled::TS, ts), OK);
            assert_eq!(instance.enter(0.0, None, None), OK);
            let words = format!("the sample time is {ts} s; expected a positive number");
            instance.refuses(&words, Fmu::exit_initialization_mode);
            assert_eq!(instance.set(Sampled::TS, 0.25), OK);
            assert_eq!(instance.exit_initialization_mode(), OK);
            instance.steps(0.0, 0.5);
            assert_eq!(samples(&instance).0, 2.0);
        }
    }
}

/// An instance with event mode after the event at the start, or without.
fn eventful(mode: Mode, model: usize, early_return: bool, ts: f64) -> Instance {
    let arguments = Arguments::of((Fmi3, mode), model);
    let instance = Instance::with(&Arguments {
        early_return,
        ..arguments
    });
    assert!(model != SAMPLED || instance.set(Sampled::TS, ts) == OK);
    instance.run(0.0)
}

/// Handles an event after a step; returns the time of the next.
#[track_caller]
fn handle(instance: &Instance) -> Option<f64> {
    assert_eq!(instance.enter_event_mode(), OK);
    let (_, next) = instance.update();
    assert_eq!(instance.enter_step_mode(), OK);
    next
}

#[test]
fn a_step_returns_early_exactly_at_each_sample() {
    let early = eventful(Events, SAMPLED, true, 0.1);
    assert_eq!(samples(&early).0, 1.0, "the sample at the start");
    let ends = [false, true].map(|early_return| eventful(Events, SAMPLED, early_return, 0.1));
    let (mut time, mut sum) = (0.0, 0.0);
    for k in 1..200 {
        let instant = f64::from(k) * 0.1;
        assert_eq!(early.steps(time, 0.25), results(true, true, instant));
        assert_eq!(
            early.get([Sampled::COUNT]),
            [instant],
            "the independent variable"
        );
        assert_eq!(
            samples(&early).0,
            k.into(),
            "the sample is taken in event mode"
        );
        assert_eq!(handle(&early), Some(f64::from(k + 1) * 0.1));
        assert_eq!(
            (samples(&early).0, samples(&early).1[2]),
            ((k + 1).into(), instant)
        );
        time = instant;
        // A step that ends at a sample ends where the host wants it: adding up has another rounding error.
        let end = sum + 0.1;
        for instance in &ends {
            assert_eq!(instance.steps(sum, 0.1), results(true, false, end));
            handle(instance);
            assert_eq!(samples(instance).0, (k + 1).into());
        }
        sum = end;
    }
}

#[test]
fn without_early_return_samples_are_taken_within_the_step() {
    for (size, n) in [(0.75, 4), (2.25, 2), (0.125, 30), (0.3, 11), (0.5, 6)] {
        let plain = eventful(Stepped, SAMPLED, false, 0.5);
        let events = eventful(Events, SAMPLED, false, 0.5);
        for k in 0..n {
            let time = f64::from(k) * size;
            let end = plain.steps(time, size).time;
            // A sample at the end of the step is left to event mode; in plain co-simulation, it belongs to
            // the next step.
            let ends_at_sample = (end * 2.0 - (end * 2.0).round()).abs() < 1e-9;
            assert_eq!(
                events.steps(time, size),
                results(ends_at_sample, false, end),
                "{size} {k}"
            );
            assert_eq!(samples(&events), samples(&plain), "{size} {k}");
            if ends_at_sample {
                handle(&events);
                plain.steps(end, 1e-3);
                events.steps(end, 1e-3);
                assert_eq!(samples(&events), samples(&plain));
                break;
            }
        }
    }
    // A host that ignores events gets them again.
    let instance = eventful(Events, SAMPLED, true, 0.5);
    assert_eq!(instance.steps(0.0, 1.0), results(true, true, 0.5));
    let bytes = instance.snapshot();
    assert_eq!(instance.steps(0.5, 1.0), results(true, true, 0.5));
    handle(&instance);
    assert_eq!(instance.steps(0.5, 1.0), results(true, true, 1.0));
    let late = eventful(Events, SAMPLED, false, 0.5);
    assert_eq!(late.steps(0.0, 0.5), results(true, false, 0.5));
    assert_eq!(
        late.steps(0.5, 0.25),
        results(false, false, 0.75),
        "within the step"
    );
    assert_eq!(samples(&late).0, 2.0);
    // A saved state continues there; early return is no part of it.
    late.resume(&bytes);
    handle(&late);
    assert_eq!(late.steps(0.5, 0.75), results(false, false, 1.25));
    // Steps end though the rounding of time exceeds the sample time.
    let late = Instance::of(EVENTS, SAMPLED);
    assert_eq!(late.set(Sampled::TS, 0.001), OK);
    let late = late.run(1e9);
    assert_eq!(late.steps(1e9, 0.125).time, 1e9 + 0.125);
    assert!((120.0..=127.0).contains(&samples(&late).0));
}

#[test]
fn the_events_of_a_continuous_model_are_those_that_it_announces() {
    let instance = eventful(Events, BALL, true, 0.0);
    assert_eq!(instance.steps(0.0, 0.25), results(false, false, 0.25));
    assert_eq!(instance.steps(0.25, 1.0), results(true, true, Ball::KICK));
    let [v] = instance.get([Ball::V]);
    assert_eq!(instance.enter_event_mode(), OK);
    // What step mode does not compute is up to date in event mode.
    assert_eq!(instance.get([Ball::H_DOT]), [v]);
    assert_eq!(instance.update(), (true, None));
    // It is below the ground, too, and bounces.
    assert_eq!(instance.get([Ball::V, Ball::H_DOT]), [-v / 2.0 + 1.0; 2]);
    assert_eq!(instance.update(), (false, None));
    assert_eq!(instance.enter_step_mode(), OK);
    assert_eq!(instance.steps(Ball::KICK, 1.0), results(false, false, 1.5));
    // Inputs that change in step mode count in event mode.
    assert_eq!(instance.set(Ball::DRIVE, 4.0), OK);
    assert_eq!(instance.enter_event_mode(), OK);
    assert_eq!(instance.get([Ball::V_DOT]), [4.0 - Ball::G]);
    // Step mode begins with the outputs of event mode.
    assert_eq!(
        instance.set_f64(&[Ball::DRIVE, Ball::TROUBLE], &[8.0, DIVERGE]),
        OK
    );
    assert_eq!(instance.enter_step_mode(), ERROR);
    instance.says("der(v) became NaN");
    // A failed event can be repeated.
    for (trouble, status) in [(DISCARD, DISCARDED), (REFUSE, ERROR)] {
        assert_eq!(instance.set(Ball::TROUBLE, trouble), OK);
        assert_eq!(instance.try_update(&mut (false, None)), status);
    }
    assert_eq!(instance.set(Ball::TROUBLE, 0.0), OK);
    assert_eq!(instance.enter_step_mode(), OK);
    let [h, v] = instance.get([Ball::H, Ball::V]);
    assert_eq!(
        instance.get([Ball::ENERGY]),
        [Ball::G * h + v * v / 2.0 + 1.0]
    );

    let within = eventful(Events, BALL, false, 0.0);
    assert_eq!(within.steps(0.0, 1.0), results(false, false, 1.0));
    assert_eq!(
        within.read(Type::Int32, [Ball::EVENTS]),
        [2.0],
        "at the start and in the step"
    );
    let plain = eventful(Stepped, BALL, false, 0.0);
    plain.steps(0.0, 1.0);
    assert_eq!(
        plain.get([Ball::V]),
        [-Ball::G],
        "without events, over the time event"
    );
}

#[test]
fn a_failure_after_a_part_of_a_step_reports_how_far_it_came() {
    // The kick at 0.5 s divides the step; steps after 0.15 s fail.
    for (fault, status) in [(REFUSE, DISCARDED), (DISCARD, DISCARDED), (BREAK, ERROR)] {
        let instance = eventful(Events, BALL, false, 0.0);
        assert_eq!(instance.set(Ball::FAULT, fault), OK);
        let before = instance.snapshot();
        let end = results(false, false, Ball::KICK);
        assert_eq!(instance.step_to(0.0, 1.0), (status, end));
        assert_eq!(instance.get([Ball::TIME]), [Ball::KICK]);
        assert_eq!(instance.step(Ball::KICK, 0.25), ERROR);
        assert_eq!(instance.resume(&before).set(Ball::FAULT, 0.0), OK);
        instance.steps(0.0, 1.0);
    }
    let instance = eventful(Events, SAMPLED, false, 0.5);
    assert_eq!(instance.set(Sampled::FAILURE, DISCARD), OK);
    assert_eq!(instance.set_i32(&[Sampled::FAILS_AT], &[3]), OK);
    let (status, found) = instance.step_to(0.0, 2.0);
    assert_eq!(
        (status, found.time),
        (DISCARDED, 1.0),
        "the sample at 1 s is discarded"
    );
    assert_eq!(samples(&instance).0, 2.0);
}

// --- integration --------------------------------------------------------------------------------

const LENGTH_OF_RUN: f64 = 3.0;

/// The time of the first contact, and the closed form of all others, until it rests.
fn contacts() -> Vec<f64> {
    let (mut time, mut v) = ((2.0 / Hopper::G).sqrt(), (2.0 * Hopper::G).sqrt());
    let mut contacts = vec![time];
    while 0.5 * v >= 0.1 {
        v *= 0.5;
        time += 2.0 * v / Hopper::G;
        contacts.push(time);
    }
    contacts
}

/// States, whether it rests, counts and times of events.
fn values(f: &Instance) -> [f64; 7] {
    let [h, v, bounced, changed] = f.get([Hopper::H, Hopper::V, Hopper::BOUNCED, Hopper::CHANGED]);
    let [bounces, changes] = f.read(Type::Int32, [Hopper::BOUNCES, Hopper::CHANGES]);
    let [rests] = f.read(Type::Boolean, [Hopper::RESTS]);
    [h, v, rests, bounces, bounced, changes, changed]
}

/// Takes `n` steps of size `h` from `time`.
fn run(f: &Instance, time: f64, h: f64, n: u32) -> [f64; 7] {
    for k in 0..n {
        f.steps(time + f64::from(k) * h, h);
    }
    values(f)
}

#[test]
fn bounces_happen_at_the_times_of_the_closed_form_whatever_the_step() {
    let contacts = contacts();
    for (n, kind) in [
        (1, PLAIN[0]),
        (7, PLAIN[1]),
        (30, PLAIN[0]),
        (300, PLAIN[1]),
    ] {
        let (instance, mut k) = (Instance::running(kind, HOPPER), 0);
        let h = LENGTH_OF_RUN / f64::from(n);
        for step in 0..n {
            let [height, v, _, bounces, bounced, ..] = run(&instance, f64::from(step) * h, h, 1);
            let now = f64::from(step + 1) * h;
            let expected = contacts.iter().filter(|contact| **contact <= now).count();
            assert_eq!(bounces, expected as f64, "at {now}");
            if expected > k {
                k = expected;
                assert!((bounced - contacts[k - 1]).abs() < 1e-7, "{bounced} {k}");
            }
            let part = if k < contacts.len() {
                0.25f64.powi(k as i32)
            } else {
                0.0
            };
            let energy = Hopper::G * height + v * v / 2.0;
            assert!(
                height > -1e-9 && (energy - part * Hopper::G).abs() < 1e-5,
                "{energy}"
            );
        }
        assert_eq!(k, contacts.len());
        let [.., changes, changed] = values(&instance);
        assert_eq!(changes, 10.0);
        assert!(
            (changed - LENGTH_OF_RUN).abs() < 1e-9,
            "at the end of the last step"
        );
    }
}

#[test]
fn both_versions_and_all_modes_integrate_alike() {
    let expected = run(&Instance::running(PLAIN[0], HOPPER), 0.0, 0.1, 29);
    for (kind, early_return, intermediate) in [
        (PLAIN[1], false, None),
        (PLAIN[1], true, Some(&[Hopper::H][..])),
        (EVENTS, false, None),
        (EVENTS, true, None),
        (EVENTS, true, Some(&[Hopper::H])),
    ] {
        let instance = Instance::with(&Arguments {
            early_return,
            intermediate,
            ..Arguments::of(kind, HOPPER)
        });
        let instance = instance.run(0.0);
        let (mut announced, mut time) = (0, 0.0f64);
        while time < 2.9 - 1e-9 {
            let size = ((time + 1e-9) / 0.1).floor() * 0.1 + 0.1 - time;
            let results = instance.steps(time, size);
            time = results.time;
            if results.event {
                announced += 1;
                assert!((handle(&instance).unwrap() - time - 0.3).abs() < 1e-9);
            }
        }
        // Time events are announced in event mode, and handled once.
        assert_eq!(announced, if kind == EVENTS { 9 } else { 0 });
        for (found, expected) in values(&instance).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-7, "{found} {expected}");
        }
    }
}

#[test]
fn a_restored_or_reset_instance_is_integrated_with_the_same_bits_and_without_allocating() {
    for kind in PLAIN {
        let (instance, other) = (Instance::running(kind, HOPPER), Instance::of(kind, HOPPER));
        for k in 0..20 {
            let (time, bytes) = (f64::from(k) * 0.13, instance.snapshot());
            run(&instance, time, 0.13, 1);
            other.resume(&bytes).steps(time, 0.13);
            assert_eq!(other.snapshot(), instance.snapshot());
        }
        assert_eq!(instance.reset(), OK);
        instance.start(0.0, None);
        let allocations = allocation_counter::measure(|| {
            for k in 0..20 {
                instance.steps(f64::from(k) * 0.13, 0.13);
            }
        });
        assert_eq!(allocations.count_total, 0);
        assert_eq!(instance.snapshot(), other.snapshot());
    }
}

#[test]
fn a_step_that_fails_after_events_changes_nothing() {
    for kind in PLAIN {
        let instance = Instance::running(kind, HOPPER);
        instance.steps(0.0, 0.25);
        for (trouble, status, words) in [
            (REFUSE, ERROR, "the integration stopped at t = 0."),
            (DISCARD, DISCARDED, "discarded by the model"),
            (BREAK, ERROR, "broken by the model"),
            (DIVERGE, ERROR, "der(v) became NaN"),
            (BUG, FATAL, "the bug shows"),
        ] {
            // After a bounce and a change of the lamp.
            assert_eq!(
                instance.set_f64(&[Hopper::TROUBLE, Hopper::TROUBLE_TIME], &[trouble, 0.7]),
                OK
            );
            let before = (instance.snapshot(), values(&instance));
            assert_eq!(instance.step(0.25, 0.75), status);
            instance.says(words);
            let message = instance.last_message();
            assert!(trouble != REFUSE || instance.snapshot() == before.0);
            if trouble != BUG {
                let stopped = message.split("stopped at t = ").nth(1).unwrap();
                let time: f64 = stopped.split(' ').next().unwrap().parse().unwrap();
                assert!((0.6..=0.7).contains(&time), "{message}");
                assert_eq!(values(&instance), before.1);
                instance.resume(&before.0);
            }
        }
        // Events at the start are handled at the initialization; there may be too many in a step.
        let instance = Instance::of(kind, HOPPER);
        assert_eq!(instance.set(Hopper::PERIOD, 0.0), OK);
        instance.start(2.0, None);
        assert_eq!(values(&instance)[5..], [1.0, 2.0]);
        let instance = Instance::of(kind, HOPPER);
        assert_eq!(instance.set(Hopper::PERIOD, 1e-5), OK);
        instance.start(0.0, None);
        instance.steps(0.0, 0.005);
        let before = instance.snapshot();
        assert_eq!(instance.step(0.005, 0.1), DISCARDED);
        instance.says("the integration stopped at t = 0.015");
        instance.says("more than 1000 events");
        instance.resume(&before);
        assert_eq!(run(&instance, 0.005, 0.005, 1)[5], 1000.0);
    }
}

#[test]
fn the_host_sets_the_tolerance_and_inputs_are_constant_during_a_step() {
    for kind in PLAIN {
        // A fall with drag: v = -w tanh(g t / w).
        let terminal = (Hopper::G / 20.0).sqrt();
        let exact = -terminal * (Hopper::G * 0.2 / terminal).tanh();
        let fall = |tolerance: Option<f64>| {
            let instance = Instance::of(kind, HOPPER);
            assert_eq!(instance.set(Hopper::DRAG, 20.0), OK);
            assert_eq!(instance.enter(0.0, None, tolerance), OK);
            if instance.exit_initialization_mode() != OK {
                instance.says("expected a positive number");
                return None;
            }
            instance.steps(0.0, 0.2);
            Some((instance.get([Hopper::V])[0] - exact).abs())
        };
        let errors = [1e-2, 1e-6, 1e-10].map(|tolerance| fall(Some(tolerance)).unwrap());
        let is_better = errors[0] > 30.0 * errors[1] && errors[1] > 1e3 * errors[2];
        assert!(is_better && errors[1] < 1e-5, "{errors:?}");
        assert_eq!(fall(None), Some(errors[1]), "the default is 1e-6");
        assert!(
            fall(Some(1e-300)).unwrap() < 1e-11,
            "more than rounding errors allow"
        );
        for tolerance in [NAN, 0.0, -1e-6, INFINITE] {
            assert_eq!(fall(Some(tolerance)), None);
        }
        let instance = Instance::running(kind, HOPPER);
        for (k, (drive, expected)) in [(0.0, [1.0, 0.0]), (2.0, [1.25, 1.0])]
            .into_iter()
            .enumerate()
        {
            assert_eq!(instance.set(Hopper::DRIVE, Hopper::G + drive), OK);
            let [h, v, ..] = run(&instance, 0.5 * k as f64, 0.5, 1);
            assert!(
                (h - expected[0]).abs() < 1e-14 && (v - expected[1]).abs() < 1e-14,
                "{h} {v}"
            );
        }
    }
}

// --- intermediate updates -----------------------------------------------------------------------

/// A ball in step mode, with the callback for these variables; the step of its default experiment is 0.1 s.
fn updating(kind: Kind, early_return: bool, variables: &[u32]) -> Instance {
    let instance = Instance::with(&Arguments {
        early_return,
        intermediate: Some(variables),
        ..Arguments::of(kind, BALL)
    });
    instance.run(0.0)
}

#[test]
fn the_host_is_called_at_equal_parts_of_the_step() {
    for kind in [PLAIN[1], EVENTS] {
        let instance = updating(kind, true, &[Ball::H]);
        instance.steps(0.0, 0.25);
        let expected = [1, 2, 3].map(|k| Intermediate {
            time: 0.25 * (f64::from(k) / 3.0),
            set_requested: k < 3,
            get_allowed: true,
            step_finished: true,
            can_return: k < 3,
        });
        assert_eq!(instance.host.updates.take(), expected);
        instance.steps(0.25, 0.1);
        assert_eq!(instance.update_times(), [0.25 + 0.1]);
        // An internal point at an event, which is handled without early return.
        let instance = updating(kind, false, &[]);
        instance.steps(0.0, 0.25);
        instance.update_times();
        instance.steps(0.25, 0.5);
        let times = instance.update_times();
        assert_eq!((times.len(), times[4]), (5, 0.75));
        assert!(times.is_sorted());
    }
    let sampled = Instance::with(&Arguments {
        intermediate: Some(&[]),
        ..Arguments::of(PLAIN[1], SAMPLED)
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
    let instance = updating(PLAIN[1], false, &[Ball::DRIVE, Ball::H, Ball::V]);
    let rows = Rc::new(RefCell::new(Vec::new()));
    let found = rows.clone();
    instance.on_update(move |fmu, _| {
        let [h, v] = fmu.get([Ball::H, Ball::V]);
        let slopes = fmu.two(|f, to| f.get_output_derivatives(&[Ball::H, Ball::V], &[1, 1], to));
        found.borrow_mut().push((h, v, slopes));
        assert_eq!(fmu.set(Ball::DRIVE, 2.0 * Ball::G), OK);
        None
    });
    instance.steps(0.0, 0.2);
    // Falls for 0.1 s, and is then accelerated upwards for 0.1 s.
    let expected = [
        (1.0 - Ball::G * 0.005, -Ball::G * 0.1),
        (1.0 - Ball::G * 0.01, 0.0),
    ];
    for (k, (h, v, slopes)) in rows.borrow().iter().enumerate() {
        assert!(
            (h - expected[k].0).abs() < 1e-12 && (v - expected[k].1).abs() < 1e-12,
            "{h} {v}"
        );
        assert_eq!(*slopes, [*v, [-Ball::G, Ball::G][k]]);
    }
    assert_eq!(
        (rows.borrow().len(), instance.get([Ball::DRIVE])),
        (2, [2.0 * Ball::G])
    );
}

/// The status of a call in the first update of a step.
fn in_update(variables: &[u32], call: impl Fn(Fmu) -> Status + 'static) -> (Status, Instance) {
    let instance = updating(PLAIN[1], false, variables);
    let status = Rc::new(RefCell::new(None));
    let found = status.clone();
    instance.on_update(move |fmu, _| {
        found.borrow_mut().get_or_insert_with(|| call(fmu));
        None
    });
    instance.steps(0.0, 0.2);
    (status.take().unwrap(), instance)
}

#[test]
fn only_announced_continuous_variables_are_accessible_in_an_update() {
    let announced = [Ball::DRIVE, Ball::H, Ball::RESTITUTION, Ball::SWITCH];
    const REQUIRED: &str = "only the required intermediate variables";
    type Call = fn(Fmu) -> Status;
    let calls: [(&str, Call); 5] = [
        (REQUIRED, |f| f.get_f64(&[Ball::H, Ball::V], &mut [0.0; 2])),
        (REQUIRED, |f| {
            f.set_f64(&[Ball::DRIVE, Ball::TROUBLE], &[0.0; 2])
        }),
        (REQUIRED, |f| {
            f.get_output_derivatives(&[Ball::V], &[1], &mut [0.0])
        }),
        ("restitution is not a continuous input", |f| {
            f.set(Ball::RESTITUTION, 0.25)
        }),
        ("drive = NaN is refused", |f| f.set(Ball::DRIVE, NAN)),
    ];
    let untouched = updating(PLAIN[1], false, &[]);
    untouched.steps(0.0, 0.2);
    for (words, call) in calls {
        let (status, instance) = in_update(&announced, call);
        assert_eq!(status, ERROR);
        instance.says(words);
        assert_eq!(instance.snapshot(), untouched.snapshot());
    }
    for call in [
        |f: Fmu| f.get_f64(&[Ball::H, Ball::RESTITUTION], &mut [0.0; 2]),
        |f: Fmu| f.get_i32(&[Ball::SWITCH], &mut [0]),
    ] {
        assert_eq!(in_update(&announced, call).0, OK);
    }
    // After the callback, all variables are accessible again.
    assert_eq!(untouched.get([Ball::V]), [-Ball::G * 0.1 - Ball::G * 0.1]);
    // A discarded evaluation is refused, and the step goes on.
    let (status, instance) = in_update(&[Ball::TROUBLE, Ball::V_DOT], |fmu| {
        assert_eq!(fmu.set(Ball::TROUBLE, DISCARD), OK);
        let status = fmu.get_f64(&[Ball::V_DOT], &mut [0.0]);
        assert_eq!(fmu.set(Ball::TROUBLE, 0.0), OK);
        status
    });
    assert_eq!((status, instance.get([Ball::TIME])), (ERROR, [0.2]));
    instance.says("discarded by the model");
}

#[test]
fn the_host_may_request_an_early_return() {
    for (kind, request, expected) in [
        (PLAIN[1], 0.0, 0.1),
        (PLAIN[1], 0.1, 0.1),
        (PLAIN[1], 0.13, 0.13),
        (EVENTS, 0.35, 0.35),
        (PLAIN[1], -INFINITE, 0.4),
        (PLAIN[1], NAN, 0.4),
        (EVENTS, 7.0, 0.4),
    ] {
        let instance = updating(kind, true, &[]);
        instance.on_update(move |_, update| update.can_return.then_some(request));
        assert_eq!(
            instance.steps(0.0, 0.4),
            results(false, expected < 0.4, expected),
            "{request}"
        );
        assert_eq!(instance.get([Ball::TIME]), [expected]);
        assert_eq!(
            instance.update_times().pop(),
            Some(expected),
            "the last update is at the end"
        );
        // It continues there, also from a saved state.
        let bytes = instance.snapshot();
        instance.on_update(|_, _| None);
        let after = [(); 2].map(|()| {
            instance.resume(&bytes).steps(expected, 0.1);
            instance.snapshot()
        });
        assert_eq!(after[0], after[1]);
        assert_eq!(instance.get([Ball::TIME]), [expected + 0.1]);
    }
    let instance = updating(PLAIN[1], false, &[]);
    instance.on_update(|_, update| {
        assert!(!update.can_return);
        Some(0.1)
    });
    assert_eq!(
        instance.steps(0.0, 0.4),
        results(false, false, 0.4),
        "not allowed"
    );
    let instance = updating(EVENTS, true, &[]);
    instance.on_update(|_, update| update.can_return.then_some(Ball::KICK));
    assert_eq!(
        instance.steps(0.0, 1.0),
        results(true, true, Ball::KICK),
        "an event there"
    );
}

#[test]
fn a_panic_or_an_error_in_a_callback_ends_the_step() {
    for kind in [PLAIN[1], EVENTS] {
        for (trouble, status, next) in [(BUG, FATAL, FATAL), (BREAK, ERROR, OK)] {
            let instance = updating(kind, false, &[Ball::TROUBLE, Ball::V_DOT]);
            instance.on_update(move |fmu, update| {
                if update.time < 0.15 {
                    assert_eq!(fmu.set(Ball::TROUBLE, trouble), OK);
                    assert_eq!(fmu.get_f64(&[Ball::V_DOT], &mut [0.0]), status);
                }
                None
            });
            let (found, results) = instance.step_to(0.0, 0.4);
            assert_eq!((found, results.time), (status, 0.1));
            assert_eq!(instance.update_times(), [0.1]);
            assert_eq!((instance.step(0.1, 0.1), instance.reset()), (status, next));
        }
    }
}

// --- ramps of FMI 2.0 ---------------------------------------------------------------------------

#[test]
fn a_ramp_applies_to_the_next_step_only() {
    for phase in 0..3 {
        let instance = Instance::of(PLAIN[0], EVERY);
        let set = |f: &Instance| {
            assert_eq!(f.set(U, 3.0), OK);
            assert_eq!(f.set_input_derivatives(&[U], &[1], &[8.0]), OK);
        };
        let ramps = |f: &Instance, now| {
            now == phase && {
                set(f);
                true
            }
        };
        ramps(&instance, 0);
        assert_eq!(instance.enter(0.0, None, None), OK);
        ramps(&instance, 1);
        assert_eq!(instance.exit_initialization_mode(), OK);
        ramps(&instance, 2);
        assert_eq!(instance.step(0.0, 0.0), OK, "does not consume the ramp");
        assert_eq!(instance.step(0.0, -1.0), ERROR, "nor does this");
        let bytes = instance.snapshot();
        instance.steps(0.0, 0.5);
        // 2 (3 h + 8 h²/2)
        assert_eq!(instance.get([Y]), [5.0]);
        instance.steps(0.5, 0.5);
        assert_eq!(instance.get([Y]), [8.0], "the force is constant again");
        instance.resume(&bytes).steps(0.0, 0.5);
        assert_eq!(instance.get([Y]), [5.0], "a state includes the ramp");
        set(&instance);
        assert_eq!(instance.reset(), OK);
        instance.start(0.0, None);
        instance.steps(0.0, 1.0);
        assert_eq!(instance.get([Y]), [0.0], "a reset clears it");
    }
}

#[test]
fn invalid_input_derivatives_are_refused() {
    let instance = Instance::running(PLAIN[0], EVERY);
    for (reference, order, slope, words) in [
        (U, 0, 1.0, "the derivative of u is of order 0; expected 1"),
        (U, 2, 1.0, "of order 2"),
        (U, -1, 1.0, "of order -1"),
        (U, 1, NAN, "the derivative of u = NaN is refused"),
        (U, 1, -INFINITE, "u = -inf"),
        (V, 1, 1.0, "the host cannot set the input derivative of v"),
        (Y, 1, 1.0, "derivative of y"),
        (LAW, 1, 1.0, "derivative of law"),
        (COUNT, 1, 1.0, "is unknown"),
    ] {
        instance.refuses(words, |f| {
            f.set_input_derivatives(&[U, reference], &[1, order], &[1.0, slope])
        });
    }
    let (u, order, slope, n) = (
        &raw const U_OF,
        &raw const ONE,
        &raw const SLOPE,
        std::ptr::null(),
    );
    for (u, order, slope) in [
        (n, order, slope),
        (u, n.cast(), slope),
        (u, order, n.cast()),
    ] {
        // SAFETY: the instance lives, and arrays are NULL or have one element.
        let call =
            |f: Fmu| Status(unsafe { fmi2SetRealInputDerivatives(f.c, u, 1, order, slope).0 });
        instance.refuses("NULL", call);
    }
}

static U_OF: u32 = U;
static ONE: i32 = 1;
static SLOPE: f64 = 1.0;
