//! The experiment and the communication steps it allows.

use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Error, fmi2OK, fmi2Warning};

use crate::host::Slave;
use crate::models::*;

const H: f64 = 0.001;

/// An instance whose first step has ended at `start` + 0.25.
fn running(start: f64, stop: Option<f64>) -> Slave {
    let mut slave = Slave::new();
    assert_eq!(slave.start(start, stop).step(start, 0.25), fmi2OK);
    slave
}

#[test]
fn invalid_experiments_are_rejected() {
    let (nan, infinite) = (f64::NAN, f64::INFINITY);
    for (start, stop) in [
        (nan, None),
        (infinite, None),
        (-infinite, None),
        (0.0, Some(nan)),
        (0.0, Some(infinite)),
        (1.0, Some(0.5)),
    ] {
        Slave::new().refuses(&["fmi2SetupExperiment"], |s| s.setup(start, stop));
    }
}

#[test]
fn the_last_experiment_before_initialization_applies() {
    let mut slave = Slave::new();
    assert_eq!(slave.setup(3.0, Some(3.0)), fmi2OK);
    slave.start(7.0, None);
    assert_eq!(
        slave.get([Y]),
        [7.0],
        "the model is initialized at the start time"
    );
    assert_eq!(
        slave.step(7.0, 50.0),
        fmi2OK,
        "without a stop time there is no end"
    );
}

#[test]
fn a_step_of_zero_changes_nothing() {
    let mut slave = running(0.0, None);
    let before = slave.snapshot();
    for step in [0.0, -0.0] {
        assert_eq!(slave.step(0.25, step), fmi2OK);
        assert_eq!(slave.snapshot(), before);
    }
    assert_eq!(slave.reset(), fmi2OK);
    assert_eq!(slave.start(0.0, None).step(0.0, 0.0), fmi2OK);
    assert_eq!(slave.step(H, H), fmi2OK, "a step of zero is no first step");
}

#[test]
fn negative_and_non_finite_steps_are_rejected() {
    let mut slave = running(0.0, None);
    let (nan, infinite) = (f64::NAN, f64::INFINITY);
    for step in [nan, infinite, -infinite, -H, -1e-300] {
        slave.refuses(&["fmi2DoStep", "step"], |s| s.step(0.25, step));
    }
    for time in [nan, infinite, -infinite] {
        slave.refuses(&["fmi2DoStep", "communication point"], |s| s.step(time, H));
    }
    assert_eq!(slave.step(0.25, H), fmi2OK);
}

#[test]
fn steps_continue_at_the_end_of_the_last_one_up_to_rounding() {
    for start in [0.0, 1e6, -3.0] {
        for side in [-1.0, 1.0] {
            let mut slave = running(start, None);
            let end = start + 0.25;
            let tolerance = side * (1e-6 * H + 1e-9 * (1.0 + end.abs()));
            let words = ["fmi2DoStep", &format!("expected {end}")];
            slave.refuses(&words, |s| s.step(end + 3.0 * tolerance, H));
            assert_eq!(slave.step(end + 0.3 * tolerance, H), fmi2OK);
        }
    }
}

#[test]
fn the_first_step_may_start_one_step_late_with_a_warning() {
    for gap in [-0.5, -0.01, 1.01, 2.0, 1000.0] {
        let mut slave = Slave::new();
        let words = ["fmi2DoStep", "expected the start time 2"];
        slave
            .start(2.0, None)
            .refuses(&words, |s| s.step(2.0 + gap * H, H));
        assert_eq!(slave.step(2.0, H), fmi2OK);
    }
    for (gap, warnings) in [(1e-7, 0), (0.5, 1), (1.0, 1)] {
        let mut slave = Slave::new();
        assert_eq!(slave.start(2.0, None).step(2.0 + gap * H, H), fmi2OK);
        assert_eq!(slave.step(2.0 + (gap + 1.0) * H, H), fmi2OK);
        let messages = slave.messages();
        assert_eq!(messages.len(), warnings);
        for message in messages {
            assert_eq!(message.category, "logStatusWarning");
            assert_eq!(message.status, fmi2Warning);
        }
    }
}

#[test]
fn steps_do_not_pass_the_stop_time_up_to_rounding() {
    let mut slave = running(0.0, Some(0.26));
    slave.refuses(&["fmi2DoStep", "stop time 0.26"], |s| s.step(0.25, 0.011));
    assert_eq!(slave.step(0.25, 0.01 + 1e-10), fmi2OK);
    assert_eq!(slave.step(0.26, 0.0), fmi2OK);
    slave.refuses(&["stop time"], |s| s.step(0.26, H));
}

#[test]
fn the_last_successful_time_is_the_end_of_the_last_step() {
    let mut slave = Slave::new();
    slave.start(3.0, None);
    for (k, time) in [3.0, 3.25, 3.5].into_iter().enumerate() {
        let mut last = f64::NAN;
        assert_eq!(slave.real_status(fmi2LastSuccessfulTime, &mut last), fmi2OK);
        assert_eq!(last, time, "{k} steps");
        assert_eq!(slave.step(time, f64::NAN), fmi2Error);
        assert_eq!(slave.step(time, 0.25), fmi2OK);
    }
}

#[test]
fn other_status_kinds_are_rejected_and_terminated_is_false() {
    let mut slave = running(0.0, None);
    let (mut ended, mut time) = (7, 7.0);
    assert_eq!(slave.boolean_status(fmi2Terminated, &mut ended), fmi2OK);
    assert_eq!(ended, 0);
    for kind in [0, 1, 3, 99, -1] {
        slave.refuses(&["fmi2GetRealStatus"], |s| s.real_status(kind, &mut time));
    }
    for kind in [0, 1, 2, 99, -1] {
        slave.refuses(&["fmi2GetBooleanStatus"], |s| {
            s.boolean_status(kind, &mut ended)
        });
    }
    assert_eq!((ended, time), (0, 7.0));
    let null = std::ptr::null_mut();
    // SAFETY: the instance lives; NULL is the case under test.
    slave.refuses(&["NULL"], |s| unsafe {
        fmi2GetRealStatus(s.c, fmi2LastSuccessfulTime, null)
    });
    let null = std::ptr::null_mut();
    // SAFETY: as above.
    slave.refuses(&["NULL"], |s| unsafe {
        fmi2GetBooleanStatus(s.c, fmi2Terminated, null)
    });
}
