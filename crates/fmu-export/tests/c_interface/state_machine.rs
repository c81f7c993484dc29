//! The table of allowed calls of FMI 2.0.5, section 4.2.4, cell by cell, and recovery from failed
//! steps.

use std::ptr::null_mut;

use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Discard, fmi2Error, fmi2Fatal, fmi2OK};

use crate::host::Slave;
use crate::models::*;

const STATES: [&str; 7] = [
    "instantiated",
    "initialization mode",
    "step complete",
    "step failed",
    "terminated",
    "error",
    "fatal",
];

/// Brings an instance to a state; after a step, the time is 0.5.
fn bring<'a>(slave: &'a mut Slave, state: &str) -> &'a mut Slave {
    let fail_by = |slave: &mut Slave, trouble| {
        slave.start(0.0, None);
        assert_eq!(slave.step(0.0, 0.5), fmi2OK);
        assert_eq!(slave.set(TROUBLE, trouble), fmi2OK);
        slave.step(0.5, 0.5)
    };
    match state {
        "instantiated" => {}
        "initialization mode" => assert_eq!(slave.enter_initialization_mode(), fmi2OK),
        "step complete" => assert_eq!(slave.start(0.0, None).step(0.0, 0.5), fmi2OK),
        "step failed" => assert_eq!(fail_by(slave, DISCARD), fmi2Discard),
        "terminated" => assert_eq!(slave.start(0.0, None).terminate(), fmi2OK),
        "error" => assert_eq!(fail_by(slave, BREAK), fmi2Error),
        _ => assert_eq!(fail_by(slave, PANIC), fmi2Fatal),
    }
    slave
}

/// A call with valid arguments.
type Call = fn(&mut Slave) -> fmi2Status;

/// The calls, and whether they are allowed (x) or not (.) in each state except the last, which allows
/// none.
#[rustfmt::skip]
const TABLE: &[(&str, &str, Call)] = &[
    ("fmi2SetDebugLogging", "xxxxxx", |s| s.switch_log(true, &[c"logAll"])),
    ("fmi2SetupExperiment", "x.....", |s| s.setup(0.0, None)),
    ("fmi2EnterInitializationMode", "x.....", Slave::enter_initialization_mode),
    ("fmi2ExitInitializationMode", ".x....", Slave::exit_initialization_mode),
    ("fmi2Terminate", "..xx..", Slave::terminate),
    ("fmi2Reset", "xxxxxx", Slave::reset),
    ("fmi2GetReal", ".xxxxx", |s| s.get_reals(&[Y], &mut [0.0])),
    ("fmi2GetInteger", ".xxxxx", |s| s.get_integers(&[ORDER], &mut [0])),
    ("fmi2GetBoolean", ".xxxxx", |s| s.get_booleans(&[LIMITED], &mut [0])),
    // SAFETY: no strings are read, so the arrays may be NULL.
    ("fmi2GetString", ".xxxxx", |s| unsafe { fmi2GetString(s.c, NONE, 0, null_mut()) }),
    ("fmi2SetReal", "xxx...", |s| s.set(U, 1.0)),
    ("fmi2SetInteger", "xxx...", |s| s.set_integers(&[], &[])),
    ("fmi2SetBoolean", "xxx...", |s| s.set_booleans(&[], &[])),
    // SAFETY: no strings are set, so the arrays may be NULL.
    ("fmi2SetString", "xxx...", |s| unsafe { fmi2SetString(s.c, NONE, 0, null_mut()) }),
    ("fmi2GetFMUstate", "xxxxxx", save_and_free),
    ("fmi2SetFMUstate", "xxxxxx", |s| with_state(s, Slave::set_state)),
    ("fmi2FreeFMUstate", "xxxxxx", |s| s.free_state(&mut null_mut())),
    ("fmi2SerializedFMUstateSize", "xxxxxx", |s| with_state(s, |s, st| s.serialized_size(st, &mut 0))),
    ("fmi2SerializeFMUstate", "xxxxxx", |s| with_state(s, |s, st| s.serialize_into(st, &mut [0; 999]))),
    ("fmi2DeSerializeFMUstate", "xxxxxx", deserialize_and_free),
    ("fmi2GetDirectionalDerivative", ".xxxxx", |s| s.directional_derivative(&[Y], &[U], &[1.0], &mut [0.0])),
    ("fmi2SetRealInputDerivatives", "xxx...", |s| s.set_input_derivatives(&[U], &[1], &[1.0])),
    // SAFETY: no derivatives are read, so the arrays may be NULL.
    ("fmi2GetRealOutputDerivatives", "..xxxx", |s| unsafe {
        fmi2GetRealOutputDerivatives(s.c, NONE, 0, std::ptr::null(), null_mut())
    }),
    ("fmi2DoStep", "..x...", |s| s.step(0.5, 0.5)),
    ("fmi2GetRealStatus", "..xxx.", |s| s.real_status(fmi2LastSuccessfulTime, &mut 0.0)),
    ("fmi2GetBooleanStatus", "..xxx.", |s| s.boolean_status(fmi2Terminated, &mut 0)),
];

fn save_and_free(slave: &mut Slave) -> fmi2Status {
    let mut state = null_mut();
    let status = slave.get_state(&mut state);
    slave.free_state(&mut state);
    status
}

fn deserialize_and_free(slave: &mut Slave) -> fmi2Status {
    let (bytes, mut state) = (Slave::new().snapshot(), null_mut());
    let status = slave.deserialize(&bytes, &mut state);
    Slave::new().free_state(&mut state);
    status
}

/// Functions that the model description declares as not supported.
const UNSUPPORTED: &[(&str, Call)] = {
    use std::ptr::null;
    macro_rules! unsupported {
        ($($function:ident($($argument:expr),*);)*) => {
            // SAFETY: these functions use the instance only.
            &[$((stringify!($function), |s| unsafe { $function(s.c, $($argument),*) })),*]
        };
    }
    unsupported! {
        fmi2CancelStep();
        fmi2GetStatus(0, null_mut());
        fmi2GetIntegerStatus(0, null_mut());
        fmi2GetStringStatus(1, null_mut());
        fmi2EnterEventMode();
        fmi2NewDiscreteStates(null_mut());
        fmi2EnterContinuousTimeMode();
        fmi2CompletedIntegratorStep(1, null_mut(), null_mut());
        fmi2SetTime(0.0);
        fmi2SetContinuousStates(null(), 0);
        fmi2GetDerivatives(null_mut(), 0);
        fmi2GetEventIndicators(null_mut(), 0);
        fmi2GetContinuousStates(null_mut(), 0);
        fmi2GetNominalsOfContinuousStates(null_mut(), 0);
    }
};

const NONE: *const fmi2ValueReference = std::ptr::null();

/// Makes a call with an FMU state of the instance, or with NULL if there is none.
fn with_state(
    slave: &mut Slave,
    call: impl FnOnce(&mut Slave, fmi2FMUstate) -> fmi2Status,
) -> fmi2Status {
    let mut state = null_mut();
    match slave.get_state(&mut state) {
        fmi2OK => {
            let status = call(slave, state);
            assert_eq!(slave.free_state(&mut state), fmi2OK);
            status
        }
        _ => call(slave, null_mut()),
    }
}

#[test]
fn calls_are_allowed_according_to_the_table() {
    for (row, &(name, allowed, call)) in TABLE.iter().enumerate() {
        for (column, state) in STATES.into_iter().enumerate() {
            println!("{name} in {state}, row {row}");
            let mut slave = Slave::new();
            bring(&mut slave, state);
            if state == "fatal" {
                slave.forget_messages();
                assert_eq!(call(&mut slave), fmi2Fatal);
                assert!(
                    slave.last_message().contains("\"fatal\""),
                    "{}",
                    slave.last_message()
                );
            } else if allowed.as_bytes()[column] == b'x' {
                assert_eq!(call(&mut slave), fmi2OK);
            } else {
                let others = STATES.iter().zip(allowed.bytes());
                let named = others.filter(|(_, allowed)| *allowed == b'x');
                let words: Vec<&str> = named
                    .map(|(state, _)| *state)
                    .chain([name, state])
                    .collect();
                slave.refuses(&words, call);
            }
        }
    }
}

#[test]
fn unsupported_calls_are_rejected_in_every_state() {
    for (name, call) in UNSUPPORTED {
        for state in &STATES[..6] {
            bring(&mut Slave::new(), state).refuses(&[name], call);
        }
        assert_eq!(call(bring(&mut Slave::new(), "fatal")), fmi2Error);
    }
}

#[test]
fn a_null_instance_is_an_error_and_can_be_freed() {
    let calls = TABLE.iter().map(|&(_, _, call)| call);
    for call in calls.chain(UNSUPPORTED.iter().map(|&(_, call)| call)) {
        assert_eq!(call(&mut Slave::null()), fmi2Error);
    }
}

#[test]
fn a_reset_equals_a_fresh_instance() {
    let fresh = Slave::new().snapshot();
    for state in &STATES[..6] {
        let mut slave = Slave::new();
        for fact in FACTS
            .iter()
            .filter(|f| f.settable(false) && f.kind == Kind::Real)
        {
            assert_eq!(slave.set(fact.reference, fact.other_value()), fmi2OK);
        }
        assert_eq!(slave.setup(5.0, Some(6.0)), fmi2OK);
        assert_eq!(bring(&mut slave, state).reset(), fmi2OK);
        assert_eq!(slave.snapshot(), fresh, "{state}");
        slave.start(0.0, None);
        assert_eq!(slave.step(0.0, 10.0), fmi2OK, "the stop time is reset, too");
    }
}

#[test]
fn a_refused_step_leaves_the_instance_unchanged() {
    let mut slave = Slave::new();
    bring(&mut slave, "step complete").set(TROUBLE, REFUSE);
    let words = [
        "fmi2DoStep",
        "from t = 0.5 s by 0.25 s",
        "such a step is never taken",
    ];
    slave.refuses(&words, |s| s.step(0.5, 0.25));
    assert_eq!(slave.set(TROUBLE, 0.0), fmi2OK);
    assert_eq!(slave.step(0.5, 0.25), fmi2OK);
}

#[test]
fn a_discarded_step_changes_no_value_and_a_restored_state_continues() {
    let mut slave = Slave::new();
    let before = bring(&mut slave, "step complete").snapshot();
    assert_eq!(slave.set(TROUBLE, DISCARD), fmi2OK);
    let values = slave.get([U, Y, 12, 13]);
    assert_eq!(slave.step(0.5, 0.25), fmi2Discard);
    let message = slave.messages().pop().unwrap();
    assert_eq!(
        (message.category.as_str(), message.status),
        ("logStatusDiscard", fmi2Discard)
    );
    assert!(
        message
            .text
            .contains("by 0.25 s: the step is too long here"),
        "{message:?}"
    );
    assert_eq!(slave.get([U, Y, 12, 13]), values);
    let mut time = f64::NAN;
    assert_eq!(slave.real_status(fmi2LastSuccessfulTime, &mut time), fmi2OK);
    assert_eq!(time, 0.5);
    assert_eq!(slave.resume(&before).step(0.5, 0.25), fmi2OK);
}

#[test]
fn a_reset_or_an_earlier_state_recovers_from_a_failed_step() {
    let mut slave = Slave::new();
    let before = bring(&mut slave, "step complete").snapshot();
    for recover in [
        |s: &mut Slave, _: &[u8]| s.reset(),
        |s: &mut Slave, bytes: &[u8]| {
            s.resume(bytes);
            fmi2OK
        },
    ] {
        slave.resume(&before);
        assert_eq!(slave.set(TROUBLE, BREAK), fmi2OK);
        assert_eq!(slave.step(0.5, 0.25), fmi2Error);
        for word in ["fmi2DoStep", "t = 0.5 s", "y became NaN"] {
            assert!(
                slave.last_message().contains(word),
                "{}",
                slave.last_message()
            );
        }
        assert_eq!(slave.step(0.5, 0.25), fmi2Error);
        assert_eq!(recover(&mut slave, &before), fmi2OK);
    }
    assert_eq!(slave.resume(&before).step(0.5, 0.25), fmi2OK);
}

#[test]
fn a_failed_initialization_can_be_retried() {
    let mut slave = Slave::new();
    assert_eq!(slave.set(TROUBLE, BREAK), fmi2OK);
    assert_eq!(slave.enter_initialization_mode(), fmi2OK);
    let words = ["the parameters do not fit together"];
    slave.refuses(&words, Slave::exit_initialization_mode);
    slave.refuses(&words, |s| s.get_reals(&[Y], &mut [0.0]));
    assert_eq!(slave.set(TROUBLE, 0.0), fmi2OK);
    assert_eq!(slave.exit_initialization_mode(), fmi2OK);
}

/// Checks that the instance can only be freed, and that another one is unaffected.
fn assert_dead(slave: &mut Slave, reason: &str, other: &mut Slave) {
    let message = slave.messages().pop().unwrap();
    assert_eq!(
        (message.category.as_str(), message.status),
        ("logStatusFatal", fmi2Fatal)
    );
    assert!(message.text.ends_with(reason), "{message:?}");
    let mut value = [7.0];
    assert_eq!(slave.get_reals(&[Y], &mut value), fmi2Fatal);
    assert_eq!(slave.step(0.0, 0.1), fmi2Fatal);
    assert_eq!(slave.reset(), fmi2Fatal);
    assert_eq!(value, [7.0]);
    assert_eq!(other.reset(), fmi2OK);
}

#[test]
fn a_panic_affects_its_instance_only() {
    let mut other = Slave::new();
    bring(&mut other, "step complete");
    let (mut slave, dead) = (
        Slave::new(),
        "the model panicked and is dead: the bug shows",
    );
    bring(&mut slave, "fatal");
    assert_dead(
        &mut slave,
        &format!("fmi2DoStep: {dead} in a step"),
        &mut other,
    );
    for call in [Slave::exit_initialization_mode, |s: &mut Slave| {
        s.get_reals(&[Y], &mut [0.0])
    }] {
        let mut slave = Slave::new();
        assert_eq!(slave.set(TROUBLE, PANIC), fmi2OK);
        assert_eq!(slave.enter_initialization_mode(), fmi2OK);
        assert_eq!(call(&mut slave), fmi2Fatal);
        assert_dead(&mut slave, &format!("{dead} early"), &mut other);
    }
}
