//! Models with a sample time: when they act, and what an error in a sample leaves behind.

use fmu_export::fmi2::{fmi2Discard, fmi2Error, fmi2OK, fmi2Status};

use crate::host::Slave;
use crate::models::{Kind, SAMPLED};

// Value references of the model `Sampled`.
const TS: u32 = 0;
const FAILS_AT: u32 = 1;
const FAILURE: u32 = 2;
const TIMES: [u32; 3] = [3, 4, 5];
const SAMPLES: u32 = 6;

// Items of the variable `failure`.
const DISCARD: i32 = 1;
const REFUSE: i32 = 2;
const BREAK: i32 = 3;

/// An instance with a sample time of 0.5 s.
fn running() -> Slave {
    let mut slave = Slave::of(SAMPLED);
    slave.start(0.0, None);
    slave
}

/// The number of samples.
fn samples(slave: &mut Slave) -> f64 {
    let (status, values) = slave.get_all(Kind::Integer, &[SAMPLES]);
    assert_eq!(status, fmi2OK);
    values[0]
}

/// Makes the sample with the given number fail; 0 for none.
fn fail(slave: &mut Slave, number: i32, failure: i32) {
    let status = slave.set_integers(&[FAILS_AT, FAILURE], &[number, failure]);
    assert_eq!(status, fmi2OK);
}

#[test]
fn samples_are_taken_at_their_instants_whatever_the_communication_step() {
    for (steps, size, expected) in [
        (1, 0.5, [0.0, 0.0, 0.0]),
        (3, 0.5, [0.0, 0.5, 1.0]),
        (8, 0.125, [0.0, 0.0, 0.5]),
        (2, 0.75, [0.0, 0.5, 1.0]),
        (1, 2.5, [1.0, 1.5, 2.0]),
    ] {
        let mut slave = running();
        assert_eq!(samples(&mut slave), 0.0, "none at the initialization");
        for k in 0..steps {
            assert_eq!(slave.step(f64::from(k) * size, size), fmi2OK);
        }
        let count = (f64::from(steps) * size / 0.5).ceil();
        assert_eq!(samples(&mut slave), count, "{steps} steps of {size} s");
        assert_eq!(slave.get(TIMES), expected, "{steps} steps of {size} s");
    }
}

#[test]
fn instants_count_from_the_start_time() {
    let mut slave = Slave::of(SAMPLED);
    assert_eq!(slave.start(0.25, None).step(0.25, 1.25), fmi2OK);
    assert_eq!(slave.get(TIMES), [0.25, 0.75, 1.25]);
}

#[test]
fn a_step_with_too_many_samples_is_discarded_and_changes_nothing() {
    let mut slave = running();
    assert_eq!(slave.step(0.0, 0.5), fmi2OK);
    let before = slave.snapshot();
    let values = slave.get(TIMES);
    assert_eq!(slave.step(0.5, 1e9), fmi2Discard);
    let words = "contains 2000000000 sample instants, more than the maximum of 100000000";
    assert!(
        slave.last_message().contains(words),
        "{}",
        slave.last_message()
    );
    assert_eq!(slave.get(TIMES), values);
    assert_eq!(slave.resume(&before).step(0.5, 0.5), fmi2OK);
    assert_eq!(samples(&mut slave), 2.0);
}

#[test]
fn an_invalid_sample_time_is_an_error_in_the_initialization() {
    for ts in [0.0, -0.5, 1e-320] {
        let mut slave = Slave::of(SAMPLED);
        assert_eq!(slave.set(TS, ts), fmi2OK);
        assert_eq!(slave.enter_initialization_mode(), fmi2OK);
        let reason = format!("the sample time is {ts} s; expected a positive number");
        slave.refuses(&[&reason], Slave::exit_initialization_mode);
        assert_eq!(slave.set(TS, 0.25), fmi2OK);
        assert_eq!(slave.exit_initialization_mode(), fmi2OK);
        assert_eq!(slave.step(0.0, 0.5), fmi2OK);
        assert_eq!(samples(&mut slave), 2.0);
    }
}

/// Takes one sample and makes the next step of `size` fail; returns its status.
fn failing(number: i32, failure: i32, size: f64) -> (Slave, fmi2Status) {
    let mut slave = running();
    assert_eq!(slave.step(0.0, 0.5), fmi2OK);
    fail(&mut slave, number, failure);
    let status = slave.step(0.5, size);
    (slave, status)
}

#[test]
fn a_refusal_in_the_first_sample_of_a_step_leaves_all_unchanged() {
    let (mut slave, status) = failing(2, REFUSE, 0.5);
    assert_eq!(status, fmi2Error);
    slave.refuses(&["from t = 0.5 s by 0.5 s: a sample is refused"], |s| {
        s.step(0.5, 0.5)
    });
    fail(&mut slave, 0, REFUSE);
    assert_eq!(slave.step(0.5, 0.5), fmi2OK);
    assert_eq!(slave.get(TIMES), [0.0, 0.0, 0.5]);
}

#[test]
fn a_discard_in_the_first_sample_of_a_step_leaves_all_unchanged() {
    let (mut slave, status) = failing(2, DISCARD, 0.5);
    assert_eq!(status, fmi2Discard);
    assert_eq!(samples(&mut slave), 1.0);
    let mut before = running();
    assert_eq!(before.step(0.0, 0.5), fmi2OK);
    let bytes = before.snapshot();
    assert_eq!(slave.resume(&bytes).step(0.5, 0.5), fmi2OK);
    assert_eq!(slave.get(TIMES), [0.0, 0.0, 0.5]);
}

#[test]
fn an_error_in_a_later_sample_of_a_step_breaks_the_instance() {
    for failure in [DISCARD, REFUSE, BREAK] {
        let (mut slave, status) = failing(4, failure, 2.0);
        assert_eq!(status, fmi2Error, "{failure}");
        let words = ["fmi2DoStep", "\"error\""];
        slave.refuses(&words, |s| s.step(0.5, 2.0));
        assert_eq!(slave.reset(), fmi2OK);
        assert_eq!(slave.start(0.0, None).step(0.0, 2.0), fmi2OK);
    }
}

#[test]
fn states_include_the_sample_clock() {
    let mut slave = running();
    assert_eq!(slave.step(0.0, 0.75), fmi2OK);
    let bytes = slave.snapshot();
    for slave in [&mut slave, &mut Slave::of(SAMPLED)] {
        assert_eq!(slave.resume(&bytes).step(0.75, 0.125), fmi2OK);
        assert_eq!(samples(slave), 2.0, "no instant in this step");
        assert_eq!(slave.step(0.875, 0.25), fmi2OK);
        assert_eq!(slave.get(TIMES), [0.0, 0.5, 1.0]);
    }
}
