//! Steps of co-simulation: the experiment and the communication points that it allows, and failures.

use std::ptr::null_mut;

use fmu_export::fmi2::{fmi2LastSuccessfulTime, fmi2Terminated};

use crate::driver::*;
use crate::models::*;

const H: f64 = 0.001;
const NAN: f64 = f64::NAN;
const INFINITE: f64 = f64::INFINITY;
const STEPPED: [Kind; 3] = [PLAIN[0], PLAIN[1], EVENTS];

/// A ball whose first step has ended at `start` + 0.25.
fn stepped(kind: Kind, start: f64, stop: Option<f64>) -> Instance {
    let it = Instance::new(kind, BALL);
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
            let it = Instance::new(kind, BALL);
            it.refuses("expected a finite number", |f| f.enter(start, stop, None));
        }
        Instance::new(kind, BALL).start(0.0, Some(0.0));
    }
    let it = Instance::new(PLAIN[0], EVERY);
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
        let it = Instance::new(kind, BALL).run(2.0);
        for gap in [-0.5, -0.01, 1.01, 2.0, 1000.0] {
            it.refuses("expected the start time 2", |f| f.step(2.0 + gap * H, H));
        }
        for (gap, warnings) in [(1e-7, 0), (0.5, 1), (1.0, 1)] {
            let it = Instance::new(kind, BALL).run(2.0);
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
    let it = Instance::new(PLAIN[0], BALL).run(3.0);
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
        let words = "from t = 0.0 s by 0.25 s: parts[2] became inf: the simulation diverges, or a number was divided by zero";
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
        let it = Instance::new(kind, BALL);
        ok([it.set(Ball::TROUBLE, trouble), it.enter(0.0, None, None)]);
        it.refuses(words, Fmu::exit_initialization_mode);
        it.refuses(words, |f| f.get_f64(&[Ball::ENERGY], &mut [0.0]));
        if kind.1 == Exchanged {
            it.refuses(words, |f| f.get_derivatives(&mut [0.0; 2]));
        }
        ok([it.set(Ball::TROUBLE, 0.0), it.exit_initialization_mode()]);
    }
    for kind in PLAIN {
        let it = Instance::new(kind, EVERY);
        ok([it.enter(1.0, None, None)]);
        for u in [0.25, -1.0, 0.5] {
            ok([it.set(U, u)]);
            assert_eq!(it.get([SUM]), [1.0], "one value in the history");
            // One tick, and one use.
            assert_eq!(it.texts(&[REPORT], 1), [c"2".to_owned()]);
        }
        ok([it.exit_initialization_mode()]);
        let new = Instance::new(kind, EVERY);
        ok([new.set(U, 0.5)]);
        new.start(1.0, None);
        assert_eq!(it.snapshot(), new.snapshot());
    }
}
