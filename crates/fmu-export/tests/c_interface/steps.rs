//! Steps of co-simulation: the experiment and the steps it allows, failures, samples, events, integration,
//! intermediate updates, and ramps of inputs.

use std::cell::RefCell;
use std::ptr::null_mut;
use std::rc::Rc;

use fmu_description::Type;
use fmu_export::fmi2::{fmi2LastSuccessfulTime, fmi2Terminated};
use fmu_export::prelude::*;
use fmu_export::testing::Driver;

use crate::driver::*;
use crate::models::*;

const H: f64 = 0.001;
const NAN: f64 = f64::NAN;
const INFINITE: f64 = f64::INFINITY;
const STEPPED: [Kind; 3] = [PLAIN[0], PLAIN[1], EVENTS];

/// A ball whose first step has ended at `start` + 0.25.
fn stepped(kind: Kind, start: f64, stop: Option<f64>) -> Instance {
    let it = Instance::of(kind, BALL);
    it.start(start, stop);
    assert!(kind != EVENTS || it.enter_step_mode() == OK);
    it.steps(start, 0.25);
    it
}

// --- the experiment -----------------------------------------------------------------------------

#[test]
fn invalid_experiments_are_refused() {
    for kind in PLAIN {
        let starts = [NAN, INFINITE, -INFINITE].map(|start| (start, None));
        let stops = [NAN, INFINITE, 0.5].map(|stop| (1.0, Some(stop)));
        for (start, stop) in starts.into_iter().chain(stops) {
            let it = Instance::of(kind, BALL);
            it.refuses("expected a finite number", |f| f.enter(start, stop, None));
        }
        Instance::of(kind, BALL).start(0.0, Some(0.0));
    }
    let it = Instance::of(PLAIN[0], EVERY);
    ok([it.setup(false, NAN, 3.0, true, 3.0)]);
    it.start(7.0, None);
    assert_eq!(it.get([Y]), [7.0], "the last experiment applies");
    it.steps(7.0, 50.0);
}

#[test]
fn invalid_steps_are_refused_and_change_nothing() {
    for kind in STEPPED {
        let it = stepped(kind, 0.0, Some(2.0));
        for (time, step, words) in [
            (NAN, 0.25, "the communication point is NaN"),
            (INFINITE, 0.25, "the communication point is inf"),
            (0.25, NAN, "the communication step is NaN"),
            (0.25, INFINITE, "the communication step is inf"),
            (0.25, -0.25, "the communication step is -0.25"),
            (0.25, -1e-300, "the communication step is -1e-300"),
            (0.25, 2.0, "the step ends at 2.25, past the stop time 2.0"),
            (0.5, 0.25, "expected 0.25, where the last step ended"),
            (0.0, 0.25, "is 0.0; expected 0.25"),
        ] {
            it.refuses(words, |f| {
                let (status, found) = f.step_to(time, step);
                assert!(kind.0 == Fmi2 || found == results(false, false, 0.25));
                status
            });
        }
        ok([it.set(Ball::FAULT, REFUSE)]);
        let before = it.snapshot();
        for step in [0.0, -0.0] {
            assert_eq!(it.steps(0.25, step), results(false, false, 0.25));
            assert_eq!(it.snapshot(), before, "nothing to do");
        }
        ok([it.set(Ball::FAULT, 0.0)]);
        // Up to rounding.
        assert_eq!(it.steps(0.25 + 1e-10, 1.75 + 1e-10).time, 2.0 + 2e-10);
        it.steps(2.0, 0.0);
        it.refuses("stop time", |f| f.step(2.0, H));
        // A step of zero is no first step.
        let it = Instance::running(kind, BALL);
        it.steps(0.0, 0.0);
        assert!(it.step(H, H) == OK || kind == EVENTS);
    }
}

#[test]
fn steps_continue_at_the_end_of_the_last_one_up_to_rounding() {
    for ((kind, start), side) in
        pairs(&STEPPED, &[0.0, 1e6, -3.0]).flat_map(|pair| [(pair, -1.0), (pair, 1.0)])
    {
        let (it, end) = (stepped(kind, start, None), start + 0.25);
        let tolerance = side * (1e-6 * H + 1e-9 * (1.0 + end.abs()));
        let words = format!("expected {end}");
        it.refuses(&words, |f| f.step(end + 3.0 * tolerance, H));
        it.steps(end + 0.3 * tolerance, H);
    }
}

#[test]
fn the_first_step_may_start_one_step_late_with_a_warning() {
    for kind in PLAIN {
        let it = Instance::of(kind, BALL).run(2.0);
        for gap in [-0.5, -0.01, 1.01, 2.0, 1000.0] {
            it.refuses("expected the start time 2", |f| f.step(2.0 + gap * H, H));
        }
        for (gap, warnings) in [(1e-7, 0), (0.5, 1), (1.0, 1)] {
            let it = Instance::of(kind, BALL).run(2.0);
            it.steps(2.0 + gap * H, H);
            it.steps(2.0 + (gap + 1.0) * H, H);
            assert_eq!(it.messages().len(), warnings);
            for message in it.messages() {
                assert_eq!(message.kind(), ("logStatusWarning", WARNING));
            }
        }
    }
}

#[test]
fn the_status_of_fmi_2_has_the_last_successful_time() {
    let it = Instance::of(PLAIN[0], BALL).run(3.0);
    let (mut ended, mut time, last) = (7, 7.0, fmi2LastSuccessfulTime);
    for now in [3.0, 3.25, 3.5] {
        ok([it.real_status(last, &mut time)]);
        assert_eq!((time, it.step(now, NAN)), (now, ERROR));
        it.steps(now, 0.25);
    }
    ok([it.boolean_status(fmi2Terminated, &mut ended)]);
    assert_eq!(ended, 0);
    (ended, time) = (7, 7.0);
    let words = "asynchronous steps only";
    for kind in [0, 1, 99, -1] {
        let (real, boolean) = if kind == 0 { (fmi2Terminated, last) } else { (kind, kind) };
        it.fails(DISCARDED, words, |f| f.real_status(real, &mut time));
        it.fails(DISCARDED, words, |f| f.boolean_status(boolean, &mut ended));
        for operation in ["get_status", "get_integer_status", "get_string_status"] {
            let arguments = [kind.into(), (&raw mut ended).into()];
            it.fails(DISCARDED, words, |f| f.call(operation, &arguments));
        }
    }
    it.steps(3.75, 0.25);
    assert_eq!((ended, time), (7, 7.0));
    it.refuses("NULL", |f| f.real_status(last, null_mut()));
    it.refuses("NULL", |f| f.boolean_status(fmi2Terminated, null_mut()));
    // What a host of FMI 3.0 does not want may be NULL.
    for kind in [PLAIN[1], EVENTS] {
        let (it, none) = (Instance::running(kind, BALL), null_mut::<u8>().into());
        let arguments = [0.0.into(), 0.25.into(), true.into(), none, none, none, none];
        assert_eq!(it.call("do_step", &arguments), OK);
        assert_eq!(it.get([Ball::TIME]), [0.25]);
    }
}

// --- failures -----------------------------------------------------------------------------------

#[test]
fn outputs_that_are_not_finite_are_errors_that_name_them() {
    for kind in PLAIN {
        let it = Instance::running(kind, EVERY);
        ok([it.set(TROUBLE, DIVERGE)]);
        let words = "from t = 0.0 s by 0.25 s: parts[2] became inf: the simulation diverges";
        it.fails(ERROR, words, |f| f.step(0.0, 0.25));
        assert_eq!(it.step(0.0, 0.25), ERROR);
        let sampled = Instance::running(kind, SAMPLED);
        ok([sampled.set(Sampled::U, 0.0)]);
        sampled.fails(ERROR, "y became inf", |f| f.step(0.0, 0.5));
        // Large ones are accepted, though their sum overflows.
        let it = Instance::running(kind, EVERY);
        ok([it.set_f64(&[LIMIT, U], &[1.5e308, 1.5e308])]);
        it.steps(0.0, 1.0);
        assert_eq!(it.get([Y]), [1.5e308]);
    }
}

#[test]
fn a_failed_initialization_can_be_repeated_and_starts_from_fresh_fields() {
    let troubles = [
        (DIVERGE, "at t = 0.0 s: der(v) became NaN"),
        (BREAK, "broken by the model"),
        (DISCARD, "discarded by the model"),
    ];
    for (kind, (trouble, words)) in pairs(&KINDS, &troubles) {
        let it = Instance::of(kind, BALL);
        ok([it.set(Ball::TROUBLE, trouble), it.enter(0.0, None, None)]);
        it.refuses(words, Fmu::exit_initialization_mode);
        it.refuses(words, |f| f.get_f64(&[Ball::ENERGY], &mut [0.0]));
        if kind.1 == Exchanged {
            it.refuses(words, |f| f.get_derivatives(&mut [0.0; 2]));
        }
        ok([it.set(Ball::TROUBLE, 0.0), it.exit_initialization_mode()]);
    }
    for kind in PLAIN {
        let it = Instance::of(kind, EVERY);
        ok([it.enter(1.0, None, None)]);
        for u in [0.25, -1.0, 0.5] {
            ok([it.set(U, u)]);
            assert_eq!(it.get([SUM]), [1.0], "one value in the history");
            // One tick, and one use.
            assert_eq!(it.texts(&[REPORT], 1), [c"2".to_owned()]);
        }
        ok([it.exit_initialization_mode()]);
        let new = Instance::of(kind, EVERY);
        ok([new.set(U, 0.5)]);
        new.start(1.0, None);
        assert_eq!(it.snapshot(), new.snapshot());
    }
}

// --- samples and events -------------------------------------------------------------------------

/// Makes a sample fail.
fn fail(f: Fmu, number: i32, how: f64) {
    let number = f.set_i32(&[Sampled::FAILS_AT], &[number]);
    ok([number, f.set(Sampled::FAILURE, how)]);
}

/// The number of samples, and the times of the last three.
fn samples(f: &Instance) -> (f64, Vec<f64>) {
    let [count] = f.read(Type::Int32, [Sampled::SAMPLES]);
    let n = if f.kind.0 == Fmi2 { 3 } else { 1 };
    let times: Vec<u32> = (Sampled::TIMES..).take(n).collect();
    (count, f.get_all(Type::Float64, &times, 3).1)
}

#[test]
fn samples_are_taken_at_their_instants_whatever_the_communication_step() {
    for kind in PLAIN {
        for (steps, size, times) in [
            (1, 0.5, [0.0, 0.0, 0.0]),
            (8, 0.125, [0.0, 0.0, 0.5]),
            (2, 0.75, [0.0, 0.5, 1.0]),
            (1, 2.5, [1.0, 1.5, 2.0]),
        ] {
            let it = Instance::running(kind, SAMPLED);
            assert_eq!(samples(&it).0, 0.0, "none at the initialization");
            (0..steps).for_each(|k| _ = it.steps(f64::from(k) * size, size));
            let count = (f64::from(steps) * size / 0.5).ceil();
            assert_eq!(samples(&it), (count, times.to_vec()), "{steps} of {size} s");
        }
        let late = Instance::of(kind, SAMPLED).run(0.25);
        late.steps(0.25, 1.25);
        assert_eq!(samples(&late).1, [0.25, 0.75, 1.25], "from the start time");
        let it = Instance::running(kind, SAMPLED);
        it.steps(0.0, 0.75);
        let bytes = it.snapshot();
        for it in [it, Instance::of(kind, SAMPLED)] {
            it.resume(&bytes).steps(0.75, 0.125);
            assert_eq!(samples(&it).0, 2.0, "no instant in this step");
            it.steps(0.875, 0.25);
            assert_eq!(samples(&it).1, [0.0, 0.5, 1.0]);
        }
    }
}

#[test]
fn failures_in_samples_and_of_the_sample_time() {
    for kind in PLAIN {
        let one = || {
            let it = Instance::running(kind, SAMPLED);
            it.steps(0.0, 0.5);
            it
        };
        let (it, before) = (one(), one().snapshot());
        let words = "contains 2000000000 sample instants, more than the maximum of 100000000";
        it.fails(DISCARDED, words, |f| f.step(0.5, 1e9));
        assert_eq!(samples(&it).0, 1.0);
        it.resume(&before).steps(0.5, 0.5);
        assert_eq!(samples(&it).0, 2.0);
        // In the first sample of a step, nothing is changed.
        let it = one();
        fail(*it, 2, REFUSE);
        let words = "from t = 0.5 s by 0.5 s: refused by the model";
        it.refuses(words, |f| f.step(0.5, 0.5));
        fail(*it, 0, REFUSE);
        it.steps(0.5, 0.5);
        fail(*it, 3, DISCARD);
        assert_eq!(it.step(1.0, 0.5), DISCARDED);
        assert_eq!(samples(&it), (2.0, vec![0.0, 0.0, 0.5]));
        // A later one breaks the instance.
        for failure in [DISCARD, REFUSE, BREAK] {
            let it = one();
            fail(*it, 4, failure);
            assert_eq!(it.step(0.5, 2.0), ERROR, "{failure}");
            it.refuses("\"error\"", |f| f.step(0.5, 2.0));
            ok([it.reset()]);
            it.start(0.0, None);
            it.steps(0.0, 2.0);
        }
        let it = Instance::of(kind, SAMPLED);
        ok([it.set(Sampled::TS, -0.5), it.enter(0.0, None, None)]);
        let words = "the sample time is -0.5 s; expected a positive number";
        it.refuses(words, Fmu::exit_initialization_mode);
        ok([it.set(Sampled::TS, 0.25), it.exit_initialization_mode()]);
        it.steps(0.0, 0.5);
        assert_eq!(samples(&it).0, 2.0);
    }
}

/// Changes its sample time in each sample
#[derive(Model)]
#[model(sample_time = self.ts)]
struct Tuned {
    /// sample time
    #[parameter(start = 0.5, tunable)]
    ts: f64,
    /// time and length of the last sample
    #[output]
    last: [f64; 2],
}

impl Simulate for Tuned {
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        (self.last, self.ts) = ([time, step], 7.0);
        Ok(())
    }
}

#[test]
fn the_sample_time_is_that_of_the_initialization() {
    let mut tuned = Driver::<Tuned>::new();
    for (step, last) in [(0.5, 0.0), (0.5, 0.5), (1.5, 2.0)] {
        assert_eq!(tuned.step(step), Ok(()));
        assert_eq!(tuned.last, [last, 0.5]);
    }
}

/// An instance with event mode after the event at the start, or without.
fn eventful(mode: Mode, model: usize, early_return: bool, ts: f64) -> Instance {
    let arguments = Arguments::of((Fmi3, mode), model);
    let it = arguments.make(|a| a.early_return = early_return);
    assert!(model != SAMPLED || it.set(Sampled::TS, ts) == OK);
    it.run(0.0)
}

/// Handles an event after a step; returns the time of the next.
#[track_caller]
fn handle(it: &Instance) -> Option<f64> {
    ok([it.enter_event_mode()]);
    let (_, next) = it.update();
    it.go_on();
    next
}

#[test]
fn a_step_returns_early_exactly_at_each_sample() {
    let early = eventful(Events, SAMPLED, true, 0.1);
    assert_eq!(samples(&early).0, 1.0, "the sample at the start");
    let ends = [false, true].map(|early_return| eventful(Events, SAMPLED, early_return, 0.1));
    let (mut time, mut sum) = (0.0, 0.0);
    for k in 1..200 {
        let (instant, n) = (f64::from(k) * 0.1, f64::from(k));
        assert_eq!(early.steps(time, 0.25), results(true, true, instant));
        assert_eq!(early.get([Sampled::COUNT]), [instant], "the time");
        assert_eq!(samples(&early).0, n, "the sample is taken in event mode");
        assert_eq!(handle(&early), Some((n + 1.0) * 0.1));
        let (count, times) = samples(&early);
        assert_eq!((count, times[2]), (n + 1.0, instant));
        time = instant;
        // A step that ends at a sample ends where the host wants it: adding up has another rounding error.
        let end = sum + 0.1;
        for it in &ends {
            assert_eq!(it.steps(sum, 0.1), results(true, false, end));
            handle(it);
            assert_eq!(samples(it).0, n + 1.0);
        }
        sum = end;
    }
}

#[test]
fn without_early_return_samples_wait_for_the_end_of_the_step() {
    for (size, n) in [(0.75, 4), (2.25, 2), (0.125, 30), (0.3, 11), (0.5, 6)] {
        let events = eventful(Events, SAMPLED, false, 0.5);
        let mut before = samples(&events);
        assert_eq!(before.0, 1.0, "the sample at the start");
        for k in 0..n {
            let (time, end) = (f64::from(k) * size, f64::from(k) * size + size);
            // The samples at 0, 0.5, ... up to the end, but for rounding errors.
            let due = (end * 2.0 + 1e-9).floor() + 1.0;
            let is_due = due > before.0;
            assert_eq!(events.steps(time, size), results(is_due, false, end));
            assert_eq!(samples(&events), before, "nothing changes in a step");
            if is_due {
                assert_eq!(handle(&events), Some(due * 0.5));
                before = samples(&events);
                assert_eq!((before.0, before.1[2]), (due, (due - 1.0) * 0.5));
            }
        }
    }
    // A host that ignores events gets them again.
    let it = eventful(Events, SAMPLED, true, 0.5);
    assert_eq!(it.steps(0.0, 1.0), results(true, true, 0.5));
    let bytes = it.snapshot();
    assert_eq!(it.steps(0.5, 1.0), results(true, true, 0.5));
    handle(&it);
    assert_eq!(it.steps(0.5, 1.0), results(true, true, 1.0));
    let late = eventful(Events, SAMPLED, false, 0.5);
    assert_eq!(late.steps(0.0, 0.5), results(true, false, 0.5));
    assert_eq!(late.steps(0.5, 0.25), results(true, false, 0.75));
    assert_eq!(samples(&late).0, 1.0, "not yet");
    // A saved state continues there; early return is no part of it.
    late.resume(&bytes);
    handle(&late);
    assert_eq!(late.steps(0.5, 0.75), results(true, false, 1.25));
    // Steps end though the rounding of time exceeds the sample time.
    let late = Instance::of(EVENTS, SAMPLED);
    ok([late.set(Sampled::TS, 0.001)]);
    let late = late.run(1e9);
    assert_eq!(late.steps(1e9, 0.125), results(true, false, 1e9 + 0.125));
    handle(&late);
    assert!((120.0..=127.0).contains(&samples(&late).0));
}

#[test]
fn the_events_of_a_continuous_model_are_those_that_it_announces() {
    let it = eventful(Events, BALL, true, 0.0);
    assert_eq!(it.steps(0.0, 0.25), results(false, false, 0.25));
    assert_eq!(handle(&it), Some(Ball::KICK), "not due");
    assert_eq!(it.steps(0.25, 1.0), results(true, true, Ball::KICK));
    let [v] = it.get([Ball::V]);
    ok([it.enter_event_mode()]);
    // What step mode does not compute is up to date in event mode.
    assert_eq!(it.get([Ball::H_DOT]), [v]);
    assert_eq!(it.update(), (true, None));
    // It is below the ground, too, and bounces.
    assert_eq!(it.get([Ball::V, Ball::H_DOT]), [-v / 2.0 + 1.0; 2]);
    assert_eq!(it.update(), (false, None));
    ok([it.enter_step_mode()]);
    assert_eq!(it.steps(Ball::KICK, 1.0), results(false, false, 1.5));
    // Inputs that change in step mode count in event mode.
    ok([it.set(Ball::DRIVE, 4.0), it.enter_event_mode()]);
    assert_eq!(it.get([Ball::V_DOT]), [4.0 - Ball::G]);
    // Step mode begins with the outputs of event mode.
    ok([it.set(Ball::DRIVE, 8.0), it.set(Ball::TROUBLE, DIVERGE)]);
    it.fails(ERROR, "der(v) became NaN", Fmu::enter_step_mode);
    ok([it.set(Ball::TROUBLE, 0.0), it.enter_step_mode()]);
    let [h, v, energy] = it.get([Ball::H, Ball::V, Ball::ENERGY]);
    assert_eq!(energy, Ball::G * h + v * v / 2.0 + 1.0);

    let within = eventful(Events, BALL, false, 0.0);
    assert_eq!(within.steps(0.0, 1.0), results(true, false, 1.0));
    near(within.get([Ball::H, Ball::V]), [1.0 - Ball::G / 2.0, -Ball::G], 1e-12);
    assert_eq!(within.read(Type::Int32, [Ball::EVENTS]), [1.0], "at the start only");
    handle(&within);
    assert_eq!(within.read(Type::Int32, [Ball::EVENTS]), [3.0], "the kick, and the end");
    let plain = eventful(Stepped, BALL, false, 0.0);
    plain.steps(0.0, 1.0);
    assert_eq!(plain.get([Ball::V]), [-Ball::G], "over the time event");
    assert_eq!(plain.read(Type::Int32, [Ball::EVENTS]), [0.0]);
}

#[test]
fn a_failure_after_a_part_of_a_step_reports_how_far_it_came() {
    // Internal points divide the step; parts after 0.15 s fail.
    let cases = [(REFUSE, DISCARDED), (DISCARD, DISCARDED), (BREAK, ERROR)];
    for (kind, (fault, status)) in pairs(&[PLAIN[1], EVENTS], &cases) {
        let it = updating(kind, true, &[]);
        ok([it.set(Ball::FAULT, fault)]);
        let before = it.snapshot();
        let end = results(false, false, 0.2);
        assert_eq!(it.step_to(0.0, 0.4), (status, end));
        assert_eq!(it.get([Ball::TIME]), [0.2]);
        assert_eq!(it.step(0.2, 0.1), ERROR);
        ok([it.resume(&before).set(Ball::FAULT, 0.0)]);
        it.steps(0.0, 0.4);
    }
    // Samples that fail in event mode.
    let it = eventful(Events, SAMPLED, false, 0.5);
    let before = it.snapshot();
    it.fails(DISCARDED, "more than the maximum", |f| f.step(0.0, 0.5e12));
    fail(it.resume(&before), 3, DISCARD);
    it.steps(0.0, 2.0);
    ok([it.enter_event_mode()]);
    assert_eq!(it.try_update().0, ERROR);
    assert_eq!(samples(&it).0, 2.0, "the one at 0.5 s was taken");
    let it = eventful(Events, SAMPLED, true, 0.5);
    ok([it.set(Sampled::U, 0.0)]);
    it.steps(0.0, 0.5);
    ok([it.enter_event_mode()]);
    it.fails(ERROR, "y became inf", |f| f.try_update().0);
}

#[test]
fn events_that_a_step_passed_are_handled_after_it_up_to_a_limit() {
    for (period, step, status, changes) in [
        (2e-5, 0.20001, OK, 10000.0),
        (2e-8, 0.3, ERROR, 1e7),
        // The end of a step reaches an event up to rounding, and no more.
        (0.3, 0.3 - 1e-8, OK, 1.0),
        (0.3, 0.3 - 1e-6, OK, 0.0),
    ] {
        let it = Instance::of(EVENTS, HOPPER);
        ok([it.set(Hopper::PERIOD, period)]);
        let it = it.run(0.0);
        it.steps(0.0, step);
        ok([it.enter_event_mode()]);
        assert_eq!(it.try_update().0, status);
        assert!(status == OK || it.last_message().contains("more than 10000000 events are due"));
        assert!(status != OK || it.read(Type::Int32, [Hopper::CHANGES]) == [changes], "{step}");
    }
    let it = eventful(Events, BALL, false, 0.0);
    it.steps(0.0, Ball::KICK + 1e-8);
    handle(&it);
    assert_eq!(it.read(Type::Int32, [Ball::EVENTS]), [2.0], "at the start and the kick, once");
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
    (0..n).for_each(|k| _ = f.steps(time + f64::from(k) * h, h));
    values(f)
}

#[test]
fn bounces_happen_at_the_times_of_the_closed_form_whatever_the_step() {
    let contacts = contacts();
    for (n, version) in [(1, 0), (7, 1), (30, 0), (300, 1)] {
        let (it, mut k) = (Instance::running(PLAIN[version], HOPPER), 0);
        let h = LENGTH_OF_RUN / f64::from(n);
        for step in 0..n {
            let [height, v, _, bounces, bounced, ..] = run(&it, f64::from(step) * h, h, 1);
            let now = f64::from(step + 1) * h;
            let expected = contacts.iter().filter(|contact| **contact <= now).count();
            assert_eq!(bounces, expected as f64, "at {now}");
            if expected > k {
                k = expected;
                near([bounced], [contacts[k - 1]], 1e-7);
            }
            let is_moving = f64::from(k < contacts.len());
            let energy = is_moving * 0.25f64.powi(k as i32) * Hopper::G;
            near([Hopper::G * height + v * v / 2.0], [energy], 1e-5);
            assert!(height > -1e-9);
        }
        assert_eq!(k, contacts.len());
        // The last one at the end of the last step.
        let [.., changes, changed] = values(&it);
        near([changes, changed], [10.0, LENGTH_OF_RUN], 1e-9);
    }
}

#[test]
fn both_versions_and_all_modes_integrate_alike() {
    let expected = run(&Instance::running(PLAIN[0], HOPPER), 0.0, 0.1, 29);
    for (kind, early_return, intermediate) in [
        (PLAIN[1], false, None),
        (PLAIN[1], true, Some(&[Hopper::H][..])),
        (EVENTS, true, None),
        (EVENTS, true, Some(&[Hopper::H])),
    ] {
        let arguments = Arguments::of(kind, HOPPER);
        let it =
            arguments.make(|a| (a.early_return, a.intermediate) = (early_return, intermediate));
        let it = it.run(0.0);
        let (mut announced, mut time) = (0.0, 0.0f64);
        let discrete = |f: &Instance| f.read(Type::Int32, [Hopper::BOUNCES, Hopper::CHANGES]);
        while time < 2.9 - 1e-9 {
            let size = ((time + 1e-9) / 0.1).floor() * 0.1 + 0.1 - time;
            let before = discrete(&it);
            let results = it.steps(time, size);
            time = results.time;
            if results.event {
                assert_eq!(discrete(&it), before, "nothing discrete changes in a step");
                let next = handle(&it).unwrap();
                near([next], [it.get([Hopper::CHANGED])[0] + 0.3], 1e-9);
                announced += discrete(&it).iter().sum::<f64>() - before.iter().sum::<f64>();
            }
        }
        // All events are announced in event mode, and handled once.
        let [.., bounces, _, changes, _] = values(&it);
        assert_eq!(announced, if kind == EVENTS { bounces + changes } else { 0.0 });
        near(values(&it), expected, 1e-7);
    }
}

#[test]
fn in_event_mode_state_events_end_the_step_or_wait_for_its_end() {
    let first = contacts()[0];
    for model in [HOPPER, VALVE] {
        let (at, discrete) = match model {
            HOPPER => (first, (Type::Int32, Hopper::BOUNCES)),
            _ => (1.0, (Type::Boolean, Valve::CLOSED)),
        };
        for early_return in [true, false] {
            let it = Arguments::of(EVENTS, model).make(|a| a.early_return = early_return);
            assert!(model == VALVE || it.set(Hopper::PERIOD, 1e3) == OK);
            let it = it.run(0.0);
            assert_eq!(it.steps(0.0, 0.4), results(false, false, 0.4));
            let end = it.steps(0.4, 0.8);
            assert_eq!((end.event, end.early), (true, early_return));
            near([end.time], [if early_return { at } else { 1.2 }], 1e-9);
            assert_eq!(it.read(discrete.0, [discrete.1]), [0.0], "not in the step");
            let (reference, level) = match model {
                HOPPER => (Hopper::H, 1.0 - Hopper::G / 2.0 * end.time * end.time),
                _ => (Valve::LEVEL, end.time),
            };
            near(it.get([reference]), [level], 1e-9);
            handle(&it);
            assert_eq!(it.read(discrete.0, [discrete.1]), [1.0]);
        }
    }
    let plain = Instance::running(PLAIN[1], VALVE);
    plain.steps(0.0, 1.2);
    assert_eq!(plain.read(Type::Boolean, [Valve::CLOSED]), [1.0], "by its own step");
}

#[test]
fn a_restored_or_reset_instance_is_integrated_with_the_same_bits_and_without_allocating() {
    for kind in PLAIN {
        let (it, other) = (Instance::running(kind, HOPPER), Instance::of(kind, HOPPER));
        for k in 0..20 {
            let (time, bytes) = (f64::from(k) * 0.13, it.snapshot());
            run(&it, time, 0.13, 1);
            other.resume(&bytes).steps(time, 0.13);
            assert_eq!(other.snapshot(), it.snapshot());
        }
        ok([it.reset()]);
        it.start(0.0, None);
        let steps = || (0..20).for_each(|k| _ = it.steps(f64::from(k) * 0.13, 0.13));
        assert_eq!(allocation_counter::measure(steps).count_total, 0);
        assert_eq!(it.snapshot(), other.snapshot());
    }
}

#[test]
fn a_step_that_fails_after_events_changes_nothing() {
    for kind in PLAIN {
        let it = Instance::running(kind, HOPPER);
        it.steps(0.0, 0.25);
        for (trouble, status, words) in [
            (REFUSE, ERROR, "the integration stopped at t = 0."),
            (DISCARD, DISCARDED, "discarded by the model"),
            (BREAK, ERROR, "broken by the model"),
            (DIVERGE, ERROR, "der(v) became NaN"),
            (BUG, FATAL, "the bug shows"),
        ] {
            // After a bounce and a change of the lamp.
            let references = [Hopper::TROUBLE, Hopper::TROUBLE_TIME];
            ok([it.set_f64(&references, &[trouble, 0.7])]);
            let before = (it.snapshot(), values(&it));
            it.fails(status, words, |f| f.step(0.25, 0.75));
            let message = it.last_message();
            assert!(trouble != REFUSE || it.snapshot() == before.0);
            if trouble != BUG {
                let stopped = message.split("stopped at t = ").nth(1).unwrap();
                let time: f64 = stopped.split(' ').next().unwrap().parse().unwrap();
                assert!((0.6..=0.7).contains(&time), "{message}");
                assert_eq!(values(&it), before.1);
                it.resume(&before.0);
            }
        }
        // Events at the start are handled at the initialization. In a step, there may be many, but not without end.
        let it = Instance::of(kind, HOPPER);
        ok([it.set(Hopper::PERIOD, 0.0)]);
        it.start(2.0, None);
        assert_eq!(values(&it)[5..], [1.0, 2.0]);
        let it = Instance::of(kind, HOPPER);
        ok([it.set(Hopper::PERIOD, 1e-5)]);
        it.start(0.0, None);
        assert_eq!(run(&it, 0.0, 0.100005, 1)[5], 10000.0);
        let it = Instance::of(kind, HOPPER);
        ok([it.set(Hopper::PERIOD, 1e-9)]);
        it.start(0.0, None);
        it.steps(0.0, 1e-8);
        let before = it.snapshot();
        it.fails(DISCARDED, "more than 1000 events within 1.0e-6 s", |f| f.step(1e-8, 0.1));
        it.says("the integration stopped at t = 1.01");
        it.resume(&before);
        assert_eq!(run(&it, 1e-8, 1e-8, 1)[5], 20.0);
    }
}

#[test]
fn the_host_sets_the_tolerance_and_inputs_are_constant_during_a_step() {
    for kind in PLAIN {
        // A fall with drag: v = -w tanh(g t / w).
        let terminal = (Hopper::G / 20.0).sqrt();
        let exact = -terminal * (Hopper::G * 0.2 / terminal).tanh();
        let fall = |tolerance: Option<f64>| {
            let it = Instance::of(kind, HOPPER);
            ok([it.set(Hopper::DRAG, 20.0), it.enter(0.0, None, tolerance)]);
            if it.exit_initialization_mode() != OK {
                it.says("expected a positive number");
                return None;
            }
            it.steps(0.0, 0.2);
            Some((it.get([Hopper::V])[0] - exact).abs())
        };
        let errors = [1e-2, 1e-6, 1e-10].map(|tolerance| fall(Some(tolerance)).unwrap());
        let is_better = errors[0] > 30.0 * errors[1] && errors[1] > 1e3 * errors[2];
        assert!(is_better && errors[1] < 1e-5, "{errors:?}");
        assert_eq!(fall(None), Some(errors[1]), "the default is 1e-6");
        // More than rounding errors allow.
        assert!(fall(Some(1e-300)).unwrap() < 1e-11);
        for tolerance in [NAN, 0.0, -1e-6, INFINITE] {
            assert_eq!(fall(Some(tolerance)), None);
        }
        let it = Instance::of(EVENTS, BALL);
        ok([it.enter(0.0, None, Some(-1.0))]);
        it.refuses("expected a positive number", Fmu::exit_initialization_mode);
        let it = Instance::running(kind, HOPPER);
        for (time, drive, expected) in [(0.0, 0.0, [1.0, 0.0]), (0.5, 2.0, [1.25, 1.0])] {
            ok([it.set(Hopper::DRIVE, Hopper::G + drive)]);
            let [h, v, ..] = run(&it, time, 0.5, 1);
            near([h, v], expected, 1e-14);
        }
    }
}

// --- intermediate updates -----------------------------------------------------------------------

/// A ball in step mode, with the callback for these variables; the step of its default experiment is 0.1 s.
fn updating(kind: Kind, early_return: bool, variables: &[u32]) -> Instance {
    let (intermediate, arguments) = (Some(variables), Arguments::of(kind, BALL));
    let it = arguments.make(|a| (a.early_return, a.intermediate) = (early_return, intermediate));
    it.run(0.0)
}

#[test]
fn the_host_is_called_at_equal_parts_of_the_step() {
    for kind in [PLAIN[1], EVENTS] {
        let it = updating(kind, true, &[Ball::H]);
        it.steps(0.0, 0.25);
        let expected = [1, 2, 3].map(|k| Intermediate {
            time: 0.25 * (f64::from(k) / 3.0),
            set_requested: k < 3,
            get_allowed: true,
            step_finished: true,
            can_return: k < 3,
        });
        assert_eq!(it.host.updates.take(), expected);
        it.steps(0.25, 0.1);
        assert_eq!(it.update_times(), [0.25 + 0.1]);
        // Without early return, an event changes nothing.
        let it = updating(kind, false, &[]);
        it.steps(0.0, 0.25);
        it.update_times();
        it.steps(0.25, 0.5);
        near(it.update_times()[..4].try_into().unwrap(), [0.35, 0.45, 0.55, 0.65], 1e-9);
    }
    let (intermediate, arguments) = (Some(&[][..]), Arguments::of(PLAIN[1], SAMPLED));
    let sampled = arguments.make(|a| a.intermediate = intermediate).run(0.0);
    sampled.steps(0.0, 2.0);
    let times = sampled.update_times();
    assert!(times.is_empty(), "providesIntermediateUpdate is false");
}

#[test]
fn the_host_reads_outputs_and_sets_inputs_at_internal_points() {
    let it = updating(PLAIN[1], false, &[Ball::DRIVE, Ball::H, Ball::V]);
    let rows = Rc::new(RefCell::new(Vec::new()));
    let found = rows.clone();
    it.on_update(move |f, _| {
        let [h, v] = f.get([Ball::H, Ball::V]);
        let slopes = f.two(|f, to| f.get_output_derivatives(&[Ball::H, Ball::V], &[1, 1], to));
        found.borrow_mut().push([h, v, slopes[0] - v, slopes[1]]);
        ok([f.set(Ball::DRIVE, 2.0 * Ball::G)]);
        None
    });
    it.steps(0.0, 0.2);
    // Falls for 0.1 s, and is then accelerated upwards for 0.1 s.
    let g = Ball::G;
    let (rows, height) = (rows.borrow(), 1.0 - g * 0.005);
    near(rows[0], [height, -g * 0.1, 0.0, -g], 1e-12);
    near(rows[1], [1.0 - g * 0.01, 0.0, 0.0, g], 1e-12);
    assert_eq!((rows.len(), it.get([Ball::DRIVE])), (2, [2.0 * g]));
}

/// The status of a call in the first update of a step.
fn in_update(variables: &[u32], call: impl Fn(Fmu) -> Status + 'static) -> (Status, Instance) {
    let it = updating(PLAIN[1], false, variables);
    let status = Rc::new(RefCell::new(None));
    let found = status.clone();
    it.on_update(move |f, _| {
        found.borrow_mut().get_or_insert_with(|| call(f));
        None
    });
    it.steps(0.0, 0.2);
    (status.take().unwrap(), it)
}

#[test]
fn only_announced_continuous_variables_are_accessible_in_an_update() {
    const DRIVE: u32 = Ball::DRIVE;
    const PART: u32 = Ball::RESTITUTION;
    let announced = [DRIVE, Ball::H, PART, Ball::SWITCH];
    const REQUIRED: &str = "only the required intermediate variables";
    type Call = fn(Fmu) -> Status;
    let calls: [(&str, Call); 5] = [
        (REQUIRED, |f| f.get_f64(&[Ball::H, Ball::V], &mut [0.0; 2])),
        (REQUIRED, |f| f.set_f64(&[DRIVE, Ball::TROUBLE], &[0.0; 2])),
        (REQUIRED, |f| f.slopes(&[(Ball::V, 1)])),
        ("restitution is not a continuous", |f| f.set(PART, 0.5)),
        ("drive = NaN is refused", |f| f.set(DRIVE, NAN)),
    ];
    let untouched = updating(PLAIN[1], false, &[]);
    untouched.steps(0.0, 0.2);
    for (words, call) in calls {
        let (status, it) = in_update(&announced, call);
        it.says(words);
        assert_eq!((status, it.snapshot()), (ERROR, untouched.snapshot()));
    }
    ok([
        in_update(&announced, |f| f.get_f64(&[Ball::H, PART], &mut [0.0; 2])).0,
        in_update(&announced, |f| f.get_i32(&[Ball::SWITCH], &mut [0])).0,
    ]);
    // After the callback, all variables are accessible again.
    assert_eq!(untouched.get([Ball::V]), [-Ball::G * 0.1 - Ball::G * 0.1]);
    // A discarded evaluation is refused, and the step goes on.
    let (status, it) = in_update(&[Ball::TROUBLE, Ball::V_DOT], |f| {
        ok([f.set(Ball::TROUBLE, DISCARD)]);
        let status = f.get_f64(&[Ball::V_DOT], &mut [0.0]);
        ok([f.set(Ball::TROUBLE, 0.0)]);
        status
    });
    assert_eq!((status, it.get([Ball::TIME])), (ERROR, [0.2]));
    it.says("discarded by the model");
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
        let it = updating(kind, true, &[]);
        it.on_update(move |_, update| update.can_return.then_some(request));
        let end = results(false, expected < 0.4, expected);
        assert_eq!(it.steps(0.0, 0.4), end, "{request}");
        assert_eq!(it.get([Ball::TIME]), [expected]);
        let last = it.update_times().pop();
        assert_eq!(last, Some(expected), "at the end");
        // It continues there, also from a saved state.
        let bytes = it.snapshot();
        it.on_update(|_, _| None);
        let after = [(); 2].map(|()| {
            it.resume(&bytes).steps(expected, 0.1);
            it.snapshot()
        });
        assert_eq!(after[0], after[1]);
        assert_eq!(it.get([Ball::TIME]), [expected + 0.1]);
    }
    let it = updating(PLAIN[1], false, &[]);
    it.on_update(|_, update| Some(0.1).filter(|_| !update.can_return));
    // It is not allowed.
    assert_eq!(it.steps(0.0, 0.4), results(false, false, 0.4));
    let it = updating(EVENTS, true, &[]);
    it.on_update(|_, update| update.can_return.then_some(Ball::KICK));
    let end = results(true, true, Ball::KICK);
    assert_eq!(it.steps(0.0, 1.0), end, "an event there");
}

#[test]
fn a_panic_or_an_error_in_a_callback_ends_the_step() {
    let cases = [(BUG, FATAL, FATAL), (BREAK, ERROR, OK)];
    for (kind, (trouble, status, next)) in pairs(&[PLAIN[1], EVENTS], &cases) {
        let it = updating(kind, false, &[Ball::TROUBLE, Ball::V_DOT]);
        it.on_update(move |f, update| {
            if update.time < 0.15 {
                ok([f.set(Ball::TROUBLE, trouble)]);
                assert_eq!(f.get_f64(&[Ball::V_DOT], &mut [0.0]), status);
            }
            None
        });
        let (found, results) = it.step_to(0.0, 0.4);
        assert_eq!((found, results.time), (status, 0.1));
        assert_eq!(it.update_times(), [0.1]);
        assert_eq!((it.step(0.1, 0.1), it.reset()), (status, next));
    }
}

// --- ramps of FMI 2.0 ---------------------------------------------------------------------------

#[test]
fn a_ramp_applies_to_the_next_step_only() {
    for phase in 0..3 {
        let it = Instance::of(PLAIN[0], EVERY);
        let set = || ok([it.set(U, 3.0), it.set_input_derivatives(&[U], &[1], &[8.0])]);
        let calls = [|_| OK, |f: Fmu| f.enter(0.0, None, None), Fmu::exit_initialization_mode];
        for (now, call) in calls.iter().enumerate() {
            ok([call(*it)]);
            if now == phase {
                set();
            }
        }
        assert_eq!(it.step(0.0, 0.0), OK, "does not consume the ramp");
        assert_eq!(it.step(0.0, -1.0), ERROR, "nor does this");
        let bytes = it.snapshot();
        it.steps(0.0, 0.5);
        // 2 (3 h + 8 h²/2)
        assert_eq!(it.get([Y]), [5.0]);
        it.steps(0.5, 0.5);
        assert_eq!(it.get([Y]), [8.0], "the force is constant again");
        it.resume(&bytes).steps(0.0, 0.5);
        assert_eq!(it.get([Y]), [5.0], "a state includes the ramp");
        set();
        ok([it.reset()]);
        it.start(0.0, None);
        it.steps(0.0, 1.0);
        assert_eq!(it.get([Y]), [0.0], "a reset clears it");
    }
}

#[test]
fn a_step_that_the_host_sees_into_ends_the_ramp_too() {
    for (kind, early_return) in pairs(&[PLAIN[1], EVENTS], &[false, true]) {
        let it = updating(kind, early_return, &[]);
        // As components have it.
        let with_ramps = Fmu { kind: PLAIN[0], ..*it };
        ok([it.set(Ball::DRIVE, Ball::G)]);
        ok([with_ramps.set_input_derivatives(&[Ball::DRIVE], &[1], &[8.0])]);
        for time in [0.0, 0.25] {
            it.steps(time, 0.25);
            assert_eq!(it.get([Ball::V]), [0.25], "8 h²/2");
        }
    }
}

#[test]
fn an_element_of_an_array_of_structs_has_input_derivatives() {
    let it = Instance::running(PLAIN[0], DEVICE);
    ok([it.set(Device::U_1, 1.0), it.set_input_derivatives(&[Device::U_2], &[1], &[4.0])]);
    for (time, y) in [(0.0, 2.0 + 2.0 * 4.0 * 0.5), (0.5, 2.0)] {
        it.steps(time, 0.5);
        assert_eq!(it.get([Device::Y]), [y]);
    }
}

#[test]
fn invalid_input_derivatives_are_refused() {
    let it = Instance::running(PLAIN[0], EVERY);
    for (reference, order, slope, words) in [
        (U, 0, 1.0, "the derivative of u is of order 0; expected 1"),
        (U, 2, 1.0, "of order 2"),
        (U, -1, 1.0, "of order -1"),
        (U, 1, NAN, "the derivative of u = NaN is refused"),
        (U, 1, -INFINITE, "u = -inf"),
        (V, 1, 1.0, "cannot set the input derivative of v"),
        (Y, 1, 1.0, "derivative of y"),
        (LAW, 1, 1.0, "derivative of law"),
        (COUNT, 1, 1.0, "is unknown"),
    ] {
        let (of, orders, slopes) = ([U, reference], [1, order], [1.0, slope]);
        it.refuses(words, |f| f.set_input_derivatives(&of, &orders, &slopes));
    }
}

// --- the driver of authors ------------------------------------------------------------------------

#[test]
fn a_driver_computes_the_bits_of_the_fmu_and_refuses_what_it_refuses() {
    // Steps that samples and events do not divide.
    let (mut sampled, mut hopper) = (Driver::<Sampled>::new(), Driver::<Hopper>::new());
    let (other, its) = (Instance::running(PLAIN[0], SAMPLED), Instance::of(PLAIN[0], HOPPER));
    ok([its.set(Hopper::DRIVE, 1.5)]);
    its.start(0.0, None);
    assert_eq!(hopper.set("drive", 1.5), Ok(()));
    let bits = |values: [f64; 4]| values.map(f64::to_bits);
    for k in 0..40 {
        for (driven, it) in [(sampled.step(0.3), &other), (hopper.step(0.3), &its)] {
            assert_eq!(driven, Ok(()));
            it.steps(f64::from(k) * 0.3, 0.3);
        }
        // Three times, count, y; h, v, rests, bounces, bounced.
        let (found, its_found) = (sampled.outputs(), hopper.outputs());
        let times = [Sampled::TIMES, Sampled::TIMES + 1, Sampled::TIMES + 2, Sampled::Y];
        assert_eq!(
            [found[0], found[1], found[2], found[4]].map(f64::to_bits),
            bits(other.get(times))
        );
        let reals = [Hopper::H, Hopper::V, Hopper::BOUNCED, Hopper::CHANGED];
        let found = [its_found[0], its_found[1], its_found[4], its_found[6]];
        assert_eq!(bits(found), bits(its.get(reals)));
    }
    let (rests, count) = (hopper.get("rests"), sampled.get("count"));
    assert_eq!((rests, count, hopper.time()), (Ok(true.into()), Ok(24.into()), 12.0));

    assert_eq!(sampled.set("failure", REFUSE).and(sampled.set("fails_at", 26)), Ok(()));
    assert_eq!(sampled.step(0.5), Ok(()));
    let words = "step: from t = 12.5 s by 0.5 s: refused by the model";
    assert_eq!(sampled.step(0.5), Err(ModelError::refuse(words)));
    for (name, words) in [
        ("h", "set: h is an output, which only the model sets"),
        ("drag", "set: drag is a fixed parameter, which cannot be set after the initialization"),
        ("trouble", "set: trouble = -1 is refused; expected a finite number from 0 to 5"),
        ("hight", "there is no variable \"hight\"; expected one of drive, trouble, "),
    ] {
        let refused = hopper.set(name, -1).unwrap_err();
        assert!(refused.reason().starts_with(words), "{refused:?}");
    }
}

#[test]
fn a_driver_returns_the_outputs_at_communication_points_from_any_start() {
    let mut sampled = Driver::<Sampled>::new().with_resources(std::env::temp_dir());
    assert!(sampled.set("ts", -1.0).is_ok() && sampled.initialize(2.0).is_err());
    assert_eq!(sampled.set("ts", 0.25).and(sampled.initialize(2.0)), Ok(()));
    let rows = sampled.run(3.0, 0.5).unwrap();
    // Three times, count, y, sum, gain and changes.
    assert_eq!(rows[0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
    assert_eq!(rows[2], [2.25, 2.5, 2.75, 4.0, 1.0, 0.0, 3.0, 0.0]);
    assert_eq!((rows.len(), sampled.time()), (3, 3.0));
    assert!(sampled.initialize(5.0).is_err(), "it is running");
    for (stop, size) in [(4.0, 0.0), (4.0, -1.0), (4.0, NAN), (4.0, INFINITE), (INFINITE, 1.0)] {
        assert!(sampled.run(stop, size).unwrap_err().reason().starts_with("the run is to "));
    }
    assert!(sampled.step(NAN).is_err() && sampled.step(INFINITE).is_err());
    assert_eq!(sampled.time(), 3.0);
    let refused = sampled.set("n", 2).unwrap_err();
    let words = "set: n is not available in FMI 2.0, where the sizes of arrays are fixed";
    assert_eq!(refused.reason(), words);
}
