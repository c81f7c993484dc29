//! Samples and time events of co-simulation, with and without event mode.

use fmu_description::Type;
use fmu_export::prelude::*;
use fmu_export::testing::Driver;

use crate::driver::*;
use crate::models::*;
use crate::updates::updating;

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
        let late = Instance::new(kind, SAMPLED).run(0.25);
        late.steps(0.25, 1.25);
        assert_eq!(samples(&late).1, [0.25, 0.75, 1.25], "from the start time");
        let it = Instance::running(kind, SAMPLED);
        it.steps(0.0, 0.75);
        let bytes = it.snapshot();
        for it in [it, Instance::new(kind, SAMPLED)] {
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
        let it = Instance::new(kind, SAMPLED);
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
    let arguments = Arguments::new((Fmi3, mode), model);
    let it = arguments.make(|a| a.early_return = early_return);
    assert!(model != SAMPLED || it.set(Sampled::TS, ts) == OK);
    it.run(0.0)
}

/// Handles an event after a step; returns the time of the next.
#[track_caller]
pub fn handle(it: &Instance) -> Option<f64> {
    ok([it.enter_event_mode()]);
    let (_, next) = it.update();
    it.end_event_mode();
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
    let late = Instance::new(EVENTS, SAMPLED);
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
        let it = Instance::new(EVENTS, HOPPER);
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
