//! Integration of models with equations by the exporter: accuracy, state events, and failures within a step.

use fmu_description::Type;

use crate::driver::*;
use crate::models::*;
use crate::samples::handle;

const NAN: f64 = f64::NAN;
const INFINITE: f64 = f64::INFINITY;
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
        let arguments = Arguments::new(kind, HOPPER);
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
            let it = Arguments::new(EVENTS, model).make(|a| a.early_return = early_return);
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
        let (it, other) = (Instance::running(kind, HOPPER), Instance::new(kind, HOPPER));
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
        // Events at the start are handled at the initialization. A step may have any number.
        let it = Instance::new(kind, HOPPER);
        ok([it.set(Hopper::PERIOD, 0.0)]);
        it.start(2.0, None);
        assert_eq!(values(&it)[5..], [1.0, 2.0]);
        let it = Instance::new(kind, HOPPER);
        ok([it.set(Hopper::PERIOD, 1e-5)]);
        it.start(0.0, None);
        assert_eq!(run(&it, 0.0, 0.100005, 1)[5], 10000.0);
        let it = Instance::new(kind, HOPPER);
        ok([it.set(Hopper::PERIOD, 1e-9)]);
        it.start(0.0, None);
        assert_eq!(run(&it, 0.0, 1e-8, 1)[5], 10.0);
        assert_eq!(run(&it, 1e-8, 1e-4, 1)[5], 100_010.0);
    }
}

#[test]
fn the_host_sets_the_tolerance_and_inputs_are_constant_during_a_step() {
    for kind in PLAIN {
        // A fall with drag: v = -w tanh(g t / w).
        let terminal = (Hopper::G / 20.0).sqrt();
        let exact = -terminal * (Hopper::G * 0.2 / terminal).tanh();
        let fall = |tolerance: Option<f64>| {
            let it = Instance::new(kind, HOPPER);
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
        let it = Instance::new(EVENTS, BALL);
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
