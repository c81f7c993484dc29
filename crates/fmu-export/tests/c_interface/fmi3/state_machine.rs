//! The states in which calls are allowed (FMI 3.0.2, sections 2.3, 3.2 and 4.2), cell by cell, and the
//! functions that are not supported.

use std::cell::RefCell;
use std::ptr::{null, null_mut};
use std::rc::Rc;

use fmu_export::fmi3::*;
use fmu_export::fmi3::{fmi3Discard, fmi3Error, fmi3Fatal, fmi3OK};

use super::host::{Arguments, Fmu, Instance, Kind, Kind::*};
use crate::host::guid;
use crate::models::*;

/// The states, and the letters that stand for them in the table.
const STATES: [(char, &str); 9] = [
    ('I', "instantiated"),
    ('N', "initialization mode"),
    ('E', "event mode"),
    ('C', "continuous-time mode"),
    ('S', "step complete"),
    ('F', "step failed"),
    ('T', "terminated"),
    ('X', "error"),
    ('!', "fatal"),
];

/// The states of a kind.
fn states(kind: Kind) -> impl Iterator<Item = (char, &'static str)> {
    let of_kind = match kind {
        CoSimulation => "INSFTX!",
        Events => "INESFTX!",
        ModelExchange => "INECTX!",
    };
    STATES
        .into_iter()
        .filter(move |(letter, _)| of_kind.contains(*letter))
}

/// A ball in a state. After a step, the time is 0.25.
fn bring(kind: Kind, state: char) -> Instance {
    let instance = Instance::new(kind);
    let fail_by = |value, status| match kind {
        ModelExchange => {
            enter_running(&instance);
            assert_eq!(instance.set(Ball::TROUBLE, value), fmi3OK);
            assert_eq!(instance.get_derivatives(&mut [0.0; 2]), status);
        }
        _ => {
            enter_running(&instance);
            assert_eq!(instance.set(Ball::FAULT, value), fmi3OK);
            assert_eq!(instance.step(0.25, 0.125).0, status);
        }
    };
    match state {
        'I' => {}
        'N' => assert_eq!(instance.enter_initialization_mode(0.0, None), fmi3OK),
        'E' => instance.start(0.0, None),
        'C' | 'S' => enter_running(&instance),
        'F' => fail_by(DISCARD, fmi3Discard),
        'T' => {
            enter_running(&instance);
            assert_eq!(instance.terminate(), fmi3OK);
        }
        'X' => fail_by(BREAK, fmi3Error),
        _ => fail_by(PANIC, fmi3Fatal),
    }
    instance
}

/// Goes to continuous-time mode, or to step mode after a step.
fn enter_running(instance: &Instance) {
    instance.start(0.0, None);
    if instance.enter_continuous_time_mode() != fmi3OK {
        let _ = instance.enter_step_mode();
        instance.steps(0.0, 0.25);
    }
}

/// A call with valid arguments.
type Call = fn(Fmu) -> fmi3Status;

const NONE: *const u32 = null();

macro_rules! empty {
    ($($function:ident)*) => {
        // SAFETY: nothing is accessed, so the arrays may be NULL.
        [$((stringify!($function), |f| unsafe { $function(f.0, NONE, 0, null_mut(), 0) })),*]
    };
}

const GETTERS: [(&str, Call); 12] = empty!(
    fmi3GetFloat32 fmi3GetFloat64 fmi3GetInt8 fmi3GetUInt8 fmi3GetInt16 fmi3GetUInt16 fmi3GetInt32
    fmi3GetUInt32 fmi3GetInt64 fmi3GetUInt64 fmi3GetBoolean fmi3GetString
);
const FLOAT_SETTERS: [(&str, Call); 2] = empty!(fmi3SetFloat32 fmi3SetFloat64);
const SETTERS: [(&str, Call); 10] = empty!(
    fmi3SetInt8 fmi3SetUInt8 fmi3SetInt16 fmi3SetUInt16 fmi3SetInt32 fmi3SetUInt32 fmi3SetInt64
    fmi3SetUInt64 fmi3SetBoolean fmi3SetString
);

/// Every state but fatal.
const ALIVE: &str = "INECSFTX";
const READABLE: &str = "INECSFTXU";
const EQUATIONS: &str = "NECTX";

/// The calls, the letters of the states in which they are allowed (U for an intermediate update), and
/// whether they are functions of one kind only.
#[rustfmt::skip]
const TABLE: &[(&str, &str, Option<Kind>, Call)] = &[
    ("fmi3SetDebugLogging", ALIVE, None, |f| f.switch_log(true, &[c"logAll"])),
    ("fmi3EnterInitializationMode", "I", None, |f| f.enter_initialization_mode(0.0, None)),
    ("fmi3ExitInitializationMode", "N", None, Fmu::exit_initialization_mode),
    ("fmi3Terminate", "SFEC", None, Fmu::terminate),
    ("fmi3Reset", ALIVE, None, Fmu::reset),
    ("fmi3GetBinary", READABLE, None, |f| f.get_binaries(&[], &mut [], &mut [])),
    ("fmi3SetBinary", "INES", None, |f| f.set_binaries(&[], &[], &[])),
    ("fmi3GetFMUState", ALIVE, None, save_and_free),
    ("fmi3SetFMUState", ALIVE, None, |f| with_state(f, Fmu::set_state)),
    ("fmi3FreeFMUState", ALIVE, None, |f| f.free_state(&mut null_mut())),
    ("fmi3SerializedFMUStateSize", ALIVE, None, |f| with_state(f, |f, st| f.serialized_size(st, &mut 0))),
    ("fmi3SerializeFMUState", ALIVE, None, |f| with_state(f, |f, st| f.serialize_into(st, &mut [0; 999]))),
    ("fmi3DeserializeFMUState", ALIVE, None, deserialize_and_free),
    ("fmi3GetDirectionalDerivative", "NECSFTX", None,
        |f| f.directional(&[Ball::ENERGY], &[Ball::DRIVE], &[1.0], &mut [0.0])),
    ("fmi3GetAdjointDerivative", "NECSFTX", None,
        |f| f.adjoint(&[Ball::ENERGY], &[Ball::DRIVE], &[1.0], &mut [0.0])),
    ("fmi3UpdateDiscreteStates", "E", None, |f| f.try_update(&mut (false, None))),
    ("fmi3EnterContinuousTimeMode", "E", Some(ModelExchange), Fmu::enter_continuous_time_mode),
    ("fmi3CompletedIntegratorStep", "C", Some(ModelExchange), |f| f.completed_integrator_step(&mut 0, &mut 0)),
    ("fmi3SetTime", "EC", Some(ModelExchange), |f| f.set_time(0.25)),
    ("fmi3SetContinuousStates", "C", Some(ModelExchange), |f| f.set_states(&[1.0, 2.0])),
    ("fmi3GetContinuousStateDerivatives", EQUATIONS, Some(ModelExchange), |f| f.get_derivatives(&mut [0.0; 2])),
    ("fmi3GetEventIndicators", EQUATIONS, Some(ModelExchange), |f| f.get_indicators(&mut [0.0])),
    ("fmi3GetContinuousStates", EQUATIONS, Some(ModelExchange), |f| f.get_states(&mut [0.0; 2])),
    ("fmi3GetNominalsOfContinuousStates", EQUATIONS, Some(ModelExchange), |f| f.get_nominals(&mut [0.0; 2])),
    ("fmi3GetNumberOfEventIndicators", ALIVE, Some(ModelExchange), |f| f.count_indicators(&mut 0)),
    ("fmi3GetNumberOfContinuousStates", ALIVE, Some(ModelExchange), |f| f.count_states(&mut 0)),
    ("fmi3EnterStepMode", "E", Some(CoSimulation), Fmu::enter_step_mode),
    ("fmi3GetOutputDerivatives", "SFTXU", Some(CoSimulation),
        |f| f.get_output_derivatives(&[Ball::H], &[1], &mut [0.0])),
    ("fmi3DoStep", "S", Some(CoSimulation), |f| f.step(0.25, 0.125).0),
    ("fmi3EnterEventMode", "SC", None, Fmu::enter_event_mode),
];

/// All rows.
fn table() -> Vec<(&'static str, &'static str, Option<Kind>, Call)> {
    let rows = |calls: &[(&'static str, Call)], allowed: &'static str| -> Vec<_> {
        let rows = calls
            .iter()
            .map(|&(name, call)| (name, allowed, None, call));
        rows.collect()
    };
    [
        TABLE.to_vec(),
        rows(&GETTERS, READABLE),
        rows(&FLOAT_SETTERS, "INECSU"),
        rows(&SETTERS, "INES"),
    ]
    .concat()
}

/// Functions that the model description declares as unsupported, and words of the reason.
const UNSUPPORTED: &[(&str, &str, Call)] = {
    macro_rules! unsupported {
        ($($function:ident($($argument:expr),*): $word:expr;)*) => {
            // SAFETY: these functions use the instance only.
            &[$((stringify!($function), $word, |f| unsafe { $function(f.0, $($argument),*) })),*]
        };
    }
    const CLOCKS: &str = "the model has no clocks";
    unsupported! {
        fmi3GetClock(NONE, 0, null_mut()): CLOCKS;
        fmi3SetClock(NONE, 0, null()): CLOCKS;
        fmi3GetIntervalDecimal(NONE, 0, null_mut(), null_mut()): CLOCKS;
        fmi3GetIntervalFraction(NONE, 0, null_mut(), null_mut(), null_mut()): CLOCKS;
        fmi3GetShiftDecimal(NONE, 0, null_mut()): CLOCKS;
        fmi3GetShiftFraction(NONE, 0, null_mut(), null_mut()): CLOCKS;
        fmi3SetIntervalDecimal(NONE, 0, null()): CLOCKS;
        fmi3SetIntervalFraction(NONE, 0, null(), null()): CLOCKS;
        fmi3SetShiftDecimal(NONE, 0, null()): CLOCKS;
        fmi3SetShiftFraction(NONE, 0, null(), null()): CLOCKS;
        fmi3ActivateModelPartition(0, 0.0): "not for scheduled execution";
        fmi3EvaluateDiscreteStates(): "providesEvaluateDiscreteStates is false";
        fmi3GetNumberOfVariableDependencies(0, null_mut()): "providesPerElementDependencies is false";
        fmi3GetVariableDependencies(0, null_mut(), null_mut(), null_mut(), null_mut(), 0):
            "providesPerElementDependencies is false";
    }
};

fn save_and_free(fmu: Fmu) -> fmi3Status {
    let mut state = null_mut();
    let status = fmu.get_state(&mut state);
    fmu.free_state(&mut state);
    status
}

fn deserialize_and_free(fmu: Fmu) -> fmi3Status {
    let other = Instance::new(CoSimulation);
    let (bytes, mut state) = (other.snapshot(), null_mut());
    let status = fmu.deserialize(&bytes, &mut state);
    other.free_state(&mut state);
    status
}

/// Makes a call with an FMU state of the instance, or with NULL if there is none.
fn with_state(fmu: Fmu, call: impl FnOnce(Fmu, fmi3FMUState) -> fmi3Status) -> fmi3Status {
    let mut state = fmu.save();
    let status = call(fmu, state);
    fmu.free_state(&mut state);
    status
}

#[test]
fn calls_are_allowed_according_to_the_table() {
    for kind in [CoSimulation, Events, ModelExchange] {
        for (letter, state) in states(kind) {
            for (name, allowed, only, call) in table() {
                println!("{name} in {state} of {kind:?}");
                let instance = bring(kind, letter);
                let is_foreign =
                    only.is_some_and(|only| (only == ModelExchange) != (kind == ModelExchange));
                if is_foreign {
                    let status = call(*instance);
                    assert_eq!(status, fmi3Error);
                    assert!(instance.last_message().contains("it is a function of"));
                } else if name == "fmi3EnterEventMode" && kind == CoSimulation {
                    assert_eq!(call(*instance), fmi3Error);
                    assert!(instance.last_message().contains("eventModeUsed was false"));
                } else if letter == '!' {
                    assert_eq!(call(*instance), fmi3Fatal);
                } else if allowed.contains(letter) {
                    assert_eq!(call(*instance), fmi3OK, "{:?}", instance.messages());
                } else {
                    instance.refuses(&[name, state], call);
                }
            }
        }
    }
}

#[test]
fn calls_in_an_intermediate_update_are_allowed_according_to_the_table() {
    let token = guid(BALL);
    for kind in [CoSimulation, Events] {
        let instance = || {
            let instance = Instance::with(&Arguments {
                token: Some(&token),
                intermediate: Some(&[Ball::DRIVE, Ball::H]),
                ..Arguments::of(kind)
            });
            instance.start(0.0, None);
            if kind == Events {
                assert_eq!(instance.enter_step_mode(), fmi3OK);
            }
            instance
        };
        let plain = instance();
        plain.steps(0.0, 0.25);
        for (name, allowed, _, call) in table() {
            println!("{name} in an intermediate update of {kind:?}");
            let instance = instance();
            let statuses = Rc::new(RefCell::new(Vec::new()));
            let answers = statuses.clone();
            instance.on_update(move |fmu, _| {
                answers.borrow_mut().push(call(fmu));
                None
            });
            assert_eq!(
                instance.steps(0.0, 0.25),
                super::host::Results {
                    event: false,
                    early: false,
                    time: 0.25
                }
            );
            let expected = if allowed.contains('U') {
                fmi3OK
            } else {
                fmi3Error
            };
            assert_eq!(*statuses.borrow(), [expected; 3]);
            assert_eq!(instance.snapshot(), plain.snapshot(), "nothing changed");
        }
    }
}

#[test]
fn unsupported_calls_are_refused_with_a_reason_in_every_state() {
    for kind in [CoSimulation, Events, ModelExchange] {
        for (letter, _) in states(kind) {
            for (name, word, call) in UNSUPPORTED {
                let instance = bring(kind, letter);
                match letter {
                    '!' => assert_eq!(call(*instance), fmi3Error),
                    _ => instance.refuses(&[name, word], call),
                }
            }
        }
    }
}

#[test]
fn configuration_mode_needs_a_structural_parameter() {
    let instance = Instance::new(CoSimulation);
    let words = ["fmi3EnterConfigurationMode: the model has no structural parameters"];
    instance.refuses(&words, Fmu::enter_configuration_mode);
    instance.refuses(
        &["is not allowed in the state"],
        Fmu::exit_configuration_mode,
    );
    instance.start(0.0, None);
    instance.refuses(
        &["no tunable structural parameters"],
        Fmu::enter_configuration_mode,
    );
    let events = Instance::new(Events).started(0.0);
    events.refuses(
        &["no tunable structural parameters"],
        Fmu::enter_configuration_mode,
    );
}

#[test]
fn a_null_instance_is_an_error_and_can_be_freed() {
    let null = Fmu(null_mut());
    let calls = table().into_iter().map(|(_, _, _, call)| call);
    for call in calls.chain(UNSUPPORTED.iter().map(|&(_, _, call)| call)) {
        assert_eq!(call(null), fmi3Error);
    }
    assert_eq!(null.enter_configuration_mode(), fmi3Error);
    assert_eq!(null.exit_configuration_mode(), fmi3Error);
    // SAFETY: NULL is ignored.
    unsafe { fmi3FreeInstance(null.0) };
}

#[test]
fn the_tests_know_all_75_functions() {
    let others = [
        "fmi3GetVersion",
        "fmi3InstantiateModelExchange",
        "fmi3InstantiateCoSimulation",
        "fmi3InstantiateScheduledExecution",
        "fmi3FreeInstance",
        "fmi3EnterConfigurationMode",
        "fmi3ExitConfigurationMode",
    ];
    let mut names: Vec<&str> = table().into_iter().map(|(name, ..)| name).collect();
    names.extend(UNSUPPORTED.iter().map(|(name, ..)| name));
    names.extend(others);
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 75);
}

#[test]
fn a_reset_equals_a_fresh_instance() {
    for kind in [CoSimulation, Events, ModelExchange] {
        let fresh = Instance::new(kind).snapshot();
        for (letter, state) in states(kind).filter(|(letter, _)| *letter != '!') {
            let instance = bring(kind, letter);
            assert_eq!(instance.reset(), fmi3OK);
            assert_eq!(instance.snapshot(), fresh, "{state} of {kind:?}");
        }
    }
}

/// Every call that runs code of the model.
#[test]
fn panics_are_caught_at_every_entry_point() {
    let dies = |instance: &Instance, call: Call| {
        assert_eq!(call(**instance), fmi3Fatal);
        assert!(
            instance
                .last_message()
                .contains("the model panicked and is dead")
        );
        assert_eq!(instance.reset(), fmi3Fatal);
    };
    let calls: [(Kind, char, Call); 14] = [
        (CoSimulation, 'N', Fmu::exit_initialization_mode),
        (CoSimulation, 'N', |f| f.get_f64(&[Ball::H], &mut [0.0])),
        (CoSimulation, 'S', |f| f.get_f64(&[Ball::V_DOT], &mut [0.0])),
        (CoSimulation, 'S', |f| {
            f.get_output_derivatives(&[Ball::H], &[1], &mut [0.0])
        }),
        (Events, 'E', |f| f.try_update(&mut (false, None))),
        (Events, 'E', |f| f.get_i32(&[Ball::EVENTS], &mut [0])),
        (Events, 'S', |f| f.step(0.25, 0.5).0),
        (ModelExchange, 'N', |f| f.get_states(&mut [0.0; 2])),
        (ModelExchange, 'E', |f| f.try_update(&mut (false, None))),
        (ModelExchange, 'C', |f| f.get_derivatives(&mut [0.0; 2])),
        (ModelExchange, 'C', |f| f.get_indicators(&mut [0.0])),
        (ModelExchange, 'C', |f| f.get_states(&mut [0.0; 2])),
        (ModelExchange, 'C', |f| f.get_i32(&[Ball::EVENTS], &mut [0])),
        (ModelExchange, 'C', |f| {
            f.adjoint(&[Ball::ENERGY], &[Ball::H], &[1.0], &mut [0.0])
        }),
    ];
    for (kind, state, call) in calls {
        let instance = bring(kind, state);
        assert_eq!(instance.set(Ball::TROUBLE, PANIC), fmi3OK);
        dies(&instance, call);
    }
}
