//! Co-simulation of models with equations and without a step of their own, in FMI 2.0 and 3.0.

use fmu_export::fmi2::fmi2SetupExperiment;
use fmu_export::fmi2::{fmi2Discard, fmi2Error, fmi2Fatal, fmi2OK};
use fmu_export::fmi3::fmi3OK;

use crate::fmi3::host::{Arguments, Instance, Kind as Kind3};
use crate::host::{Slave, guid};
use crate::models::*;

const LENGTH: f64 = 3.0;

/// The time of the first contact, the closed form of all others, and when it rests.
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

/// What is compared: states, whether it rests, counts and times of events.
fn values(slave: &mut Slave) -> [f64; 7] {
    let [h, v, bounced, changed] =
        slave.get([Hopper::H, Hopper::V, Hopper::BOUNCED, Hopper::CHANGED]);
    let (_, counts) = slave.get_all(Kind::Integer, &[Hopper::BOUNCES, Hopper::CHANGES]);
    let (_, rests) = slave.get_all(Kind::Boolean, &[Hopper::RESTS]);
    [h, v, rests[0], counts[0], bounced, counts[1], changed]
}

fn values_of(fmu: &Instance) -> [f64; 7] {
    let [h, v, bounced, changed] =
        fmu.get([Hopper::H, Hopper::V, Hopper::BOUNCED, Hopper::CHANGED]);
    let (mut counts, mut rests) = ([0; 2], [0; 1]);
    let references = [Hopper::BOUNCES, Hopper::CHANGES];
    assert_eq!(fmu.get_i32(&references, &mut counts), fmi3OK);
    assert_eq!(fmu.get_booleans(&[Hopper::RESTS], &mut rests), fmi3OK);
    let [bounces, changes] = counts.map(f64::from);
    let rests = f64::from(rests[0]);
    [h, v, rests, bounces, bounced, changes, changed]
}

fn hopper() -> Slave {
    let mut slave = Slave::of(HOPPER);
    slave.start(0.0, None);
    slave
}

/// Takes `n` steps of size `h` from `time`.
fn run(slave: &mut Slave, time: f64, h: f64, n: u32) -> [f64; 7] {
    for k in 0..n {
        assert_eq!(slave.step(time + f64::from(k) * h, h), fmi2OK, "{k}");
    }
    values(slave)
}

#[test]
fn bounces_happen_at_the_times_of_the_closed_form_whatever_the_step() {
    let contacts = contacts();
    for n in [1, 7, 30, 300] {
        let mut slave = hopper();
        let mut k = 0;
        let h = LENGTH / f64::from(n);
        for step in 0..n {
            run(&mut slave, f64::from(step) * h, h, 1);
            let [height, v, _, bounces, bounced, ..] = values(&mut slave);
            let now = f64::from(step + 1) * h;
            let expected = contacts.iter().filter(|contact| **contact <= now).count();
            assert_eq!(bounces, expected as f64, "at {now}");
            if expected > k {
                k = expected;
                assert!((bounced - contacts[k - 1]).abs() < 1e-7, "{bounced} {k}");
            }
            assert!(height > -1e-9);
            let energy = Hopper::G * height + v * v / 2.0;
            let exact = Hopper::G
                * if k < contacts.len() {
                    0.25f64.powi(k as i32)
                } else {
                    0.0
                };
            assert!((energy - exact).abs() < 1e-5, "{energy} {exact}");
        }
        assert_eq!(k, contacts.len());
        let [.., changes, changed] = values(&mut slave);
        assert_eq!(changes, 10.0);
        assert!(
            (changed - LENGTH).abs() < 1e-9,
            "at the end of the last step"
        );
    }
}

#[test]
fn the_event_at_the_start_is_handled_at_the_initialization() {
    let mut slave = Slave::of(HOPPER);
    assert_eq!(slave.set(Hopper::PERIOD, 0.0), fmi2OK);
    slave.start(2.0, None);
    assert_eq!(values(&mut slave)[5..], [1.0, 2.0]);
}

#[test]
fn too_many_events_in_a_step_are_discarded_and_change_nothing() {
    let mut slave = Slave::of(HOPPER);
    assert_eq!(slave.set(Hopper::PERIOD, 1e-5), fmi2OK);
    slave.start(0.0, None);
    run(&mut slave, 0.0, 0.005, 1);
    let before = (slave.snapshot(), values(&mut slave));
    assert_eq!(slave.step(0.005, 0.1), fmi2Discard);
    let message = slave.last_message();
    let words = "the integration stopped at t = 0.015";
    assert!(
        message.contains(words) && message.contains("more than 1000 events"),
        "{message}"
    );
    assert_eq!(values(&mut slave), before.1);
    assert_eq!(run(slave.resume(&before.0), 0.005, 0.005, 1)[5], 1000.0);
}

#[test]
fn both_versions_and_all_modes_agree() {
    let mut slave = hopper();
    let expected = run(&mut slave, 0.0, 0.1, 29);
    let token = guid(HOPPER);
    for kind in [Kind3::CoSimulation, Kind3::Events] {
        for (early_return, intermediate) in [(false, None), (true, None), (true, Some(&[3][..]))] {
            let fmu = Instance::with(&Arguments {
                token: Some(&token),
                early_return,
                intermediate,
                ..Arguments::of(kind)
            });
            fmu.start(0.0, None);
            let has_events = kind == Kind3::Events;
            let handle = || {
                let next = fmu.update().1;
                assert_eq!(fmu.enter_step_mode(), fmi3OK);
                next
            };
            if has_events {
                handle();
            }
            let (mut announced, mut time) = (0, 0.0f64);
            while time < 2.9 - 1e-9 {
                let size = ((time + 1e-9) / 0.1).floor() * 0.1 + 0.1 - time;
                let results = fmu.steps(time, size);
                time = results.time;
                if results.event {
                    announced += 1;
                    assert_eq!(fmu.enter_event_mode(), fmi3OK);
                    let next = handle().unwrap();
                    assert!((next - time - 0.3).abs() < 1e-9);
                }
            }
            // Time events are announced in event mode, and handled once.
            assert_eq!(announced, if has_events { 9 } else { 0 });
            let found = values_of(&fmu);
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-7, "{found} {expected}");
            }
        }
    }
}

#[test]
fn a_restored_instance_continues_with_the_same_bits() {
    let mut slave = hopper();
    let mut other = Slave::of(HOPPER);
    for k in 0..20 {
        let time = f64::from(k) * 0.13;
        let bytes = slave.snapshot();
        let expected = run(&mut slave, time, 0.13, 1);
        let found = run(other.resume(&bytes), time, 0.13, 1);
        assert_eq!(found.map(f64::to_bits), expected.map(f64::to_bits));
        assert_eq!(other.snapshot(), slave.snapshot());
    }
    assert_eq!(slave.reset(), fmi2OK);
    let again = run(slave.start(0.0, None), 0.0, 0.13, 20);
    assert_eq!(
        again.map(f64::to_bits),
        values(&mut other).map(f64::to_bits)
    );
}

#[test]
fn a_step_that_fails_after_events_changes_nothing() {
    let mut slave = hopper();
    slave.step(0.0, 0.25);
    for (trouble, status, words) in [
        (REFUSE, fmi2Error, "the integration stopped at t = 0."),
        (DISCARD, fmi2Discard, "discarded by the ball"),
        (BREAK, fmi2Error, "broken by the ball"),
        (DIVERGE, fmi2Error, "der(v) became NaN"),
        (PANIC, fmi2Fatal, "the bug shows"),
    ] {
        // After a bounce and a change of the lamp.
        assert_eq!(slave.set(Hopper::TROUBLE, trouble), fmi2OK);
        assert_eq!(slave.set(Hopper::TROUBLE_TIME, 0.7), fmi2OK);
        let before = (slave.snapshot(), values(&mut slave));
        assert_eq!(slave.step(0.25, 0.75), status);
        let message = slave.last_message();
        assert!(message.contains(words), "{message}");
        if trouble == REFUSE {
            assert_eq!(slave.snapshot(), before.0);
        }
        if trouble != PANIC {
            let stopped = message.split("stopped at t = ").nth(1).unwrap();
            let time: f64 = stopped.split(' ').next().unwrap().parse().unwrap();
            assert!((0.6..=0.7).contains(&time), "{message}");
            assert_eq!(values(&mut slave), before.1);
            slave.resume(&before.0);
        }
    }
}

#[test]
fn the_host_sets_the_tolerance() {
    // A fall with drag: v = -w tanh(g t / w).
    let terminal = (Hopper::G / 20.0).sqrt();
    let exact = -terminal * (Hopper::G * 0.2 / terminal).tanh();
    let fall = |tolerance: Option<f64>| {
        let mut slave = Slave::of(HOPPER);
        assert_eq!(slave.set(Hopper::DRAG, 20.0), fmi2OK);
        let (defined, tolerance) = (tolerance.is_some().into(), tolerance.unwrap_or(f64::NAN));
        // SAFETY: the instance lives.
        let status = unsafe { fmi2SetupExperiment(slave.c, defined, tolerance, 0.0, 0, 0.0) };
        assert_eq!(status, fmi2OK);
        assert_eq!(slave.enter_initialization_mode(), fmi2OK);
        if slave.exit_initialization_mode() != fmi2OK {
            let message = slave.last_message();
            assert!(message.contains("expected a positive number"), "{message}");
            return None;
        }
        run(&mut slave, 0.0, 0.2, 1);
        Some((slave.get([Hopper::V])[0] - exact).abs())
    };
    let errors = [1e-2, 1e-6, 1e-10].map(|tolerance| fall(Some(tolerance)).unwrap());
    assert!(
        errors[0] > 30.0 * errors[1] && errors[1] > 1e3 * errors[2],
        "{errors:?}"
    );
    assert!(errors[1] < 1e-5, "{errors:?}");
    assert_eq!(fall(None), Some(errors[1]), "the default is 1e-6");
    assert!(
        fall(Some(1e-300)).unwrap() < 1e-11,
        "more than rounding errors allow"
    );
    for tolerance in [f64::NAN, 0.0, -1e-6, f64::INFINITY] {
        assert_eq!(fall(Some(tolerance)), None);
    }
}

#[test]
fn inputs_are_constant_during_a_step() {
    let mut slave = hopper();
    assert_eq!(slave.set(Hopper::DRIVE, Hopper::G), fmi2OK);
    run(&mut slave, 0.0, 0.5, 1);
    assert_eq!(slave.get([Hopper::H, Hopper::V]), [1.0, 0.0]);
    assert_eq!(slave.set(Hopper::DRIVE, Hopper::G + 2.0), fmi2OK);
    run(&mut slave, 0.5, 0.5, 1);
    let [h, v] = slave.get([Hopper::H, Hopper::V]);
    assert!(
        (h - 1.25).abs() < 1e-14 && (v - 1.0).abs() < 1e-14,
        "{h} {v}"
    );
}

#[test]
fn a_step_does_not_allocate() {
    let mut slave = hopper();
    let allocations = allocation_counter::measure(|| {
        for k in 0..30 {
            assert_eq!(slave.step(f64::from(k) * 0.1, 0.1), fmi2OK);
        }
    });
    assert_eq!(allocations.count_total, 0);
    assert_eq!(values(&mut slave)[3], contacts().len() as f64);
}
