//! The states in which calls are allowed, cell by cell (FMI 2.0.5, sections 3.2.3 and 4.2.4; FMI 3.0.2,
//! sections 2.3, 3.2 and 4.2), and how an instance gets from failures to other states.

use std::cell::RefCell;
use std::ffi::c_void;
use std::ptr::{null, null_mut};
use std::rc::Rc;

use fmu_description::Type;
use fmu_export::{fmi2::*, fmi3::*};

use crate::driver::*;
use crate::models::*;

/// The states with the letters that stand for them below, in the order of messages.
const STATES: [(char, &str); 13] = [
    ('I', "instantiated"),
    ('G', "configuration mode"),
    ('N', "initialization mode"),
    ('E', "event mode"),
    ('C', "continuous-time mode"),
    ('S', "step complete"),
    ('F', "step failed"),
    ('U', "intermediate update mode"),
    ('R', "reconfiguration mode"), // from step mode
    ('V', "reconfiguration mode"), // from event mode
    ('T', "terminated"),
    ('X', "error"),
    ('!', "fatal"),
];

/// The states that a host can bring an instance to, outside of callbacks.
fn states(kind: Kind) -> &'static str {
    match kind {
        (Fmi2, Exchanged) => "INECTX!",
        (Fmi2, _) => "INSFTX!",
        (Fmi3, Stepped) => "IGNSFRTX!",
        (Fmi3, Events) => "IGNESFRVTX!",
        (Fmi3, Exchanged) => "IGNECVTX!",
    }
}

fn name(state: char) -> &'static str {
    let (_, name) = STATES.iter().find(|(letter, _)| *letter == state).unwrap();
    name
}

/// A call with valid arguments.
type Call = fn(Fmu) -> Status;
type Row = (&'static str, &'static str, &'static str, Call);

const ALIVE_2: &str = "INESCFTX";
const ALIVE: &str = "INESCFTXGRV";
const READABLE: &str = "INESCFTXGRVU";
const COMPUTED: &str = "NESCFTX";

/// Calls with valid arguments, by the operation: the states that allow them in FMI 2.0 and 3.0, or "-" if a
/// version lacks them. Only in model exchange with "m", in co-simulation with "c", not without events with "e".
#[rustfmt::skip]
const TABLE: &[Row] = &[
    ("set_debug_logging", ALIVE_2, ALIVE, |f| f.switch_log(true, &[c"logAll"])),
    ("setup_experiment", "I", "-", |f| f.setup(0.0, None)),
    ("enter_initialization_mode", "I", "I", |f| f.enter_only()),
    ("exit_initialization_mode", "N", "N", Fmu::exit_initialization_mode),
    ("terminate", "SFEC", "SFEC", Fmu::terminate),
    ("reset", ALIVE_2, ALIVE, Fmu::reset),
    ("enter_configuration_mode", "-", "ISE", Fmu::enter_configuration_mode),
    ("exit_configuration_mode", "-", "GRV", Fmu::exit_configuration_mode),
    ("get_float64", COMPUTED, READABLE, |f| f.get_f64(&[], &mut [])),
    ("get_float32", "-", READABLE, |f| f.get_f32(&[], &mut [])),
    ("get_int8", "-", READABLE, |f| f.get_i8(&[], &mut [])),
    ("get_uint8", "-", READABLE, |f| f.get_u8(&[], &mut [])),
    ("get_int16", "-", READABLE, |f| f.get_i16(&[], &mut [])),
    ("get_uint16", "-", READABLE, |f| f.get_u16(&[], &mut [])),
    ("get_int32", COMPUTED, READABLE, |f| f.get_i32(&[], &mut [])),
    ("get_uint32", "-", READABLE, |f| f.get_u32(&[], &mut [])),
    ("get_int64", "-", READABLE, |f| f.get_i64(&[], &mut [])),
    ("get_uint64", "-", READABLE, |f| f.get_u64(&[], &mut [])),
    ("get_boolean", COMPUTED, READABLE, |f| f.get_all(Type::Boolean, &[], 0).0),
    ("get_string", COMPUTED, READABLE, |f| f.get_strings(&[], &mut [])),
    ("get_binary", "-", READABLE, |f| f.get_binaries(&[], &mut [], &mut [])),
    ("set_float64", "INESC", "INESCU", |f| f.set_f64(&[], &[])),
    ("set_float32", "-", "INESCU", |f| f.set_f32(&[], &[])),
    ("set_int8", "-", "INES", |f| f.set_i8(&[], &[])),
    ("set_uint8", "-", "INES", |f| f.set_u8(&[], &[])),
    ("set_int16", "-", "INES", |f| f.set_i16(&[], &[])),
    ("set_uint16", "-", "INES", |f| f.set_u16(&[], &[])),
    ("set_int32", "INES", "INES", |f| f.set_i32(&[], &[])),
    ("set_uint32", "-", "INES", |f| f.set_u32(&[], &[])),
    ("set_int64", "-", "INES", |f| f.set_i64(&[], &[])),
    ("set_uint64", "-", "INESGRV", |f| f.set_u64(&[], &[])),
    ("set_boolean", "INES", "INES", |f| f.set_all(Type::Boolean, &[], &[])),
    ("set_string", "INES", "INES", |f| f.set_strings(&[], &[])),
    ("set_binary", "-", "INES", |f| f.set_binaries(&[], &[], &[])),
    ("get_fmu_state", ALIVE_2, ALIVE, save_and_free),
    ("set_fmu_state", ALIVE_2, ALIVE, |f| with_state(f, Fmu::set_state)),
    ("free_fmu_state", ALIVE_2, ALIVE, |f| f.free_state(&mut null_mut())),
    ("serialized_fmu_state_size", ALIVE_2, ALIVE, |f| with_state(f, |f, st| f.serialized_size(st, &mut 0))),
    ("serialize_fmu_state", ALIVE_2, ALIVE, |f| with_state(f, |f, st| f.serialize_into(st, &mut [0; 999]))),
    ("deserialize_fmu_state", ALIVE_2, ALIVE, deserialize),
    ("get_directional_derivative", COMPUTED, COMPUTED, |f| f.directional(&[Ball::ENERGY], &[Ball::DRIVE], &[1.0], &mut [0.0])),
    ("get_adjoint_derivative", "-", COMPUTED, |f| f.adjoint(&[Ball::ENERGY], &[Ball::DRIVE], &[1.0], &mut [0.0])),
    ("enter_event_mode", "mEC", "eSC", Fmu::enter_event_mode),
    ("update_discrete_states", "mE", "E", |f| f.try_update(&mut (false, None))),
    ("enter_continuous_time_mode", "mE", "mE", Fmu::enter_continuous_time_mode),
    ("completed_integrator_step", "mC", "mC", |f| f.completed_step(&mut [0; 2])),
    ("set_time", "mEC", "mEC", |f| f.set_time(0.25)),
    ("set_continuous_states", "mC", "mC", |f| f.set_states(&[1.0, 2.0])),
    ("get_continuous_state_derivatives", "mNECTX", "mNECTX", |f| f.get_derivatives(&mut [0.0; 2])),
    ("get_event_indicators", "mNECTX", "mNECTX", |f| f.get_indicators(&mut [0.0])),
    ("get_continuous_states", "mNECTX", "mNECTX", |f| f.get_states(&mut [0.0; 2])),
    ("get_nominals_of_continuous_states", "mINECTX", "mNECTX", |f| f.get_nominals(&mut [0.0; 2])),
    ("get_number_of_event_indicators", "-", "mINESCFTXGRV", |f| f.count_indicators(&mut 0)),
    ("get_number_of_continuous_states", "-", "mINESCFTXGRV", |f| f.count_states(&mut 0)),
    ("enter_step_mode", "-", "cE", Fmu::enter_step_mode),
    ("set_input_derivatives", "cINS", "-", |f| f.set_input_derivatives(&[], &[], &[])),
    ("get_output_derivatives", "cSFTX", "cSFTXU", |f| f.get_output_derivatives(&[Ball::H], &[1], &mut [0.0])),
    ("do_step", "cS", "cS", |f| f.step(0.25, 0.125)),
    ("get_real_status", "cSFT", "-", |f| f.real_status(fmi2LastSuccessfulTime, &mut 0.0)),
    ("get_boolean_status", "cSFT", "-", |f| f.boolean_status(fmi2Terminated, &mut 0)),
];

const NONE: *const u32 = null();

/// Functions that the model description declares as unsupported, and words of the reason.
const UNSUPPORTED: &[(&str, Version, &str, Call)] = {
    macro_rules! unsupported {
        ($($version:ident $operation:ident = $function:ident($($argument:expr),*): $words:expr;)*) => {
            // SAFETY: these functions use the instance only.
            &[$((stringify!($operation), $version, $words, |f| unsafe {
                Status($function(f.c, $($argument),*).0)
            })),*]
        };
    }
    const ASYNCHRONOUS: &str = "canRunAsynchronuously is false";
    const CLOCKS: &str = "the model has no clocks";
    const DEPENDENCIES: &str = "providesPerElementDependencies is false";
    unsupported! {
        Fmi2 cancel_step = fmi2CancelStep(): ASYNCHRONOUS;
        Fmi2 get_status = fmi2GetStatus(0, null_mut()): ASYNCHRONOUS;
        Fmi2 get_integer_status = fmi2GetIntegerStatus(0, null_mut()): ASYNCHRONOUS;
        Fmi2 get_string_status = fmi2GetStringStatus(1, null_mut()): ASYNCHRONOUS;
        Fmi3 get_clock = fmi3GetClock(NONE, 0, null_mut()): CLOCKS;
        Fmi3 set_clock = fmi3SetClock(NONE, 0, null()): CLOCKS;
        Fmi3 get_interval_decimal = fmi3GetIntervalDecimal(NONE, 0, null_mut(), null_mut()): CLOCKS;
        Fmi3 get_interval_fraction
            = fmi3GetIntervalFraction(NONE, 0, null_mut(), null_mut(), null_mut()): CLOCKS;
        Fmi3 get_shift_decimal = fmi3GetShiftDecimal(NONE, 0, null_mut()): CLOCKS;
        Fmi3 get_shift_fraction = fmi3GetShiftFraction(NONE, 0, null_mut(), null_mut()): CLOCKS;
        Fmi3 set_interval_decimal = fmi3SetIntervalDecimal(NONE, 0, null()): CLOCKS;
        Fmi3 set_interval_fraction = fmi3SetIntervalFraction(NONE, 0, null(), null()): CLOCKS;
        Fmi3 set_shift_decimal = fmi3SetShiftDecimal(NONE, 0, null()): CLOCKS;
        Fmi3 set_shift_fraction = fmi3SetShiftFraction(NONE, 0, null(), null()): CLOCKS;
        Fmi3 activate_model_partition
            = fmi3ActivateModelPartition(0, 0.0): "the FMU is not for scheduled execution";
        Fmi3 evaluate_discrete_states
            = fmi3EvaluateDiscreteStates(): "providesEvaluateDiscreteStates is false";
        Fmi3 get_number_of_variable_dependencies
            = fmi3GetNumberOfVariableDependencies(0, null_mut()): DEPENDENCIES;
        Fmi3 get_variable_dependencies = fmi3GetVariableDependencies(
            0, null_mut(), null_mut(), null_mut(), null_mut(), 0): DEPENDENCIES;
    }
};

/// Functions that are no calls of an instance.
const FREE: [&str; 7] = [
    "get_types_platform",
    "get_version",
    "instantiate",
    "instantiate_model_exchange",
    "instantiate_co_simulation",
    "instantiate_scheduled_execution",
    "free_instance",
];

/// The letters of a row for a version, after the kind of instances that have the function.
fn row(version: Version, in_2: &'static str, in_3: &'static str) -> Option<(char, &'static str)> {
    let letters = if version == Fmi2 { in_2 } else { in_3 };
    match letters.chars().next() {
        Some('-') => None,
        Some(kind @ ('m' | 'c' | 'e')) => Some((kind, &letters[1..])),
        _ => Some((' ', letters)),
    }
}

fn save_and_free(fmu: Fmu) -> Status {
    let mut state = null_mut();
    let status = fmu.get_state(&mut state);
    if status == OK {
        fmu.free_state(&mut state);
    }
    status
}

/// Makes a call with an FMU state of the instance, or with NULL if there is none.
fn with_state(fmu: Fmu, call: impl FnOnce(Fmu, *mut c_void) -> Status) -> Status {
    let mut state = fmu.save();
    let status = call(fmu, state);
    if !state.is_null() {
        assert_eq!(fmu.free_state(&mut state), OK);
    }
    status
}

fn deserialize(fmu: Fmu) -> Status {
    with_state(fmu, |fmu, state| {
        let bytes = match state.is_null() {
            true => vec![],
            false => fmu.serialize(state),
        };
        let mut copy = null_mut();
        let status = fmu.deserialize(&bytes, &mut copy);
        if status == OK {
            fmu.free_state(&mut copy);
        }
        status
    })
}

/// A ball in a state, or a list in a state of configuration. After a step, the time is 0.25.
fn bring(kind: Kind, state: char) -> Instance {
    let is_configured = "GRV".contains(state);
    let it = Instance::of(kind, if is_configured { LISTS } else { BALL });
    let run = || {
        it.start(0.0, Some(10.0));
        match kind.1 {
            Exchanged => assert_eq!(it.enter_continuous_time_mode(), OK),
            mode => {
                assert!(mode != Events || it.enter_step_mode() == OK);
                it.steps(0.0, 0.25);
            }
        }
    };
    let fail_by = |trouble, status| {
        run();
        let is_exchange = kind.1 == Exchanged;
        let input = if is_exchange {
            Ball::TROUBLE
        } else {
            Ball::FAULT
        };
        ok([it.set(input, trouble)]);
        let found = match is_exchange {
            true => it.get_derivatives(&mut [0.0; 2]),
            false => it.step(0.25, 0.125),
        };
        assert_eq!(found, status);
    };
    match state {
        'I' | 'G' => {}
        'N' => assert_eq!(it.enter(0.0, Some(10.0), None), OK),
        'E' | 'V' => it.start(0.0, Some(10.0)),
        'C' | 'S' | 'R' => run(),
        'F' => fail_by(DISCARD, DISCARDED),
        'T' => {
            run();
            assert_eq!(it.terminate(), OK);
        }
        'X' => fail_by(BREAK, ERROR),
        _ => fail_by(BUG, FATAL),
    }
    assert!(!is_configured || it.enter_configuration_mode() == OK);
    it
}

/// All kinds in all states.
fn all() -> impl Iterator<Item = (Kind, char)> {
    let of = |kind| states(kind).chars().map(move |state| (kind, state));
    KINDS.into_iter().flat_map(of)
}

#[test]
fn calls_are_allowed_according_to_the_table() {
    for (kind, state) in all() {
        for &(operation, in_2, in_3, call) in TABLE {
            let Some((only, letters)) = row(kind.0, in_2, in_3) else {
                continue;
            };
            println!("{operation} in {} of {kind:?}", name(state));
            let it = bring(kind, state);
            let allowed = STATES.iter().filter(|(state, _)| letters.contains(*state));
            let mut allowed: Vec<&str> = allowed.map(|(_, name)| *name).collect();
            allowed.dedup();
            let (call_name, state_name) = (it.name(operation), name(state));
            let forbidden = format!("{call_name} is not allowed in the state \"{state_name}\"; ");
            let forbidden = forbidden + "it is allowed in: " + &allowed.join(", ");
            let why = match (only, kind.1) {
                ('m', Stepped | Events) => "it is a function of model exchange",
                ('c', Exchanged) => "it is a function of co-simulation",
                ('e', Stepped) => "eventModeUsed was false",
                _ if !letters.contains(state) => &forbidden,
                _ if operation == "enter_configuration_mode" => "structural parameters",
                _ => {
                    assert_eq!(call(*it), OK, "{:?}", it.messages());
                    continue;
                }
            };
            match (state, why == forbidden) {
                ('!', false) => assert_eq!(call(*it), ERROR),
                ('!', true) => {
                    assert_eq!(call(*it), FATAL);
                    assert_eq!(it.last_message(), forbidden);
                }
                _ => it.refuses(why, call),
            }
        }
    }
}

#[test]
fn calls_in_an_intermediate_update_are_allowed_according_to_the_table() {
    for kind in [(Fmi3, Stepped), EVENTS] {
        let new = || {
            let variables = &[Ball::DRIVE, Ball::H];
            let it = Arguments::of(kind, BALL).make(|a| a.intermediate = Some(variables));
            it.run(0.0)
        };
        let plain = new();
        plain.steps(0.0, 0.25);
        for &(operation, in_2, in_3, call) in TABLE {
            let Some((_, letters)) = row(Fmi3, in_2, in_3) else {
                continue;
            };
            println!("{operation} in an intermediate update of {kind:?}");
            let (it, statuses) = (new(), Rc::new(RefCell::new(Vec::new())));
            let answers = statuses.clone();
            it.on_update(move |fmu, _| {
                answers.borrow_mut().push(call(fmu));
                None
            });
            assert_eq!(it.steps(0.0, 0.25), results(false, false, 0.25));
            let expected = if letters.contains('U') { OK } else { ERROR };
            assert_eq!(*statuses.borrow(), [expected; 3]);
            assert_eq!(it.snapshot(), plain.snapshot(), "nothing changed");
        }
    }
}

#[test]
fn unsupported_calls_are_refused_with_a_reason_in_every_state() {
    for (kind, state) in all() {
        for (operation, version, why, call) in UNSUPPORTED {
            let it = bring(kind, state);
            match state {
                _ if *version != kind.0 => {}
                '!' => assert_eq!(call(*it), ERROR),
                _ => it.refuses(&format!("{}: ", it.name(operation)), |fmu| {
                    let status = call(fmu);
                    it.says(why);
                    status
                }),
            }
        }
    }
}

#[test]
fn the_tests_know_all_functions() {
    for (version, count) in [(Fmi2, 44), (Fmi3, 75)] {
        let has = |line: &&Row| row(version, line.1, line.2).is_some();
        let rows = TABLE.iter().filter(has);
        let unsupported = UNSUPPORTED.iter().filter(|(_, of, ..)| *of == version);
        let known: Vec<&str> = (rows.map(|row| row.0))
            .chain(unsupported.map(|row| row.0))
            .chain(FREE)
            .filter(|operation| version.function(operation).is_some())
            .collect();
        assert_eq!(known.len(), count);
        let all = version.functions().iter();
        for (call, operation) in all {
            assert!(known.contains(operation), "{}", call.name);
        }
    }
}

#[test]
fn a_null_instance_is_an_error_and_can_be_freed() {
    for version in [Fmi2, Fmi3] {
        let (kind, c) = ((version, Stepped), null_mut());
        let null = Fmu { kind, c };
        for (_, in_2, in_3, call) in TABLE {
            assert!(row(version, in_2, in_3).is_none() || call(null) == ERROR);
        }
        for (_, of, _, call) in UNSUPPORTED {
            assert!(*of != version || call(null) == ERROR);
        }
        null.free();
    }
}

#[test]
fn a_reset_equals_a_fresh_instance() {
    for (kind, state) in all().filter(|(_, state)| *state != '!') {
        let it = bring(kind, state);
        let model = if "GRV".contains(state) { LISTS } else { BALL };
        it.set(Ball::DRIVE, 1.0);
        assert_eq!(it.reset(), OK);
        let fresh = Instance::of(kind, model).snapshot();
        assert_eq!(it.snapshot(), fresh, "{state} of {kind:?}");
        let it = it.run(20.0);
        assert!(kind.1 == Exchanged || it.step(20.0, 0.5) == OK);
    }
}

/// Every call that runs code of the model.
#[test]
fn a_panic_is_caught_and_affects_its_instance_only() {
    let other = Instance::running(PLAIN[0], BALL);
    let calls: [(char, &[Kind], Call); 11] = [
        ('N', &KINDS, Fmu::exit_initialization_mode),
        ('N', &KINDS, |f| f.get_f64(&[Ball::H], &mut [0.0])),
        ('S', &PLAIN, |f| f.get_f64(&[Ball::V_DOT], &mut [0.0])),
        ('S', &PLAIN, |f| f.slopes(&[(Ball::H, 1)])),
        ('S', &[EVENTS], |f| f.step(0.25, 0.5)),
        ('E', &KINDS[2..], |f| f.try_update(&mut (false, None))),
        ('E', &KINDS[2..], |f| f.get_i32(&[Ball::EVENTS], &mut [0])),
        ('C', &EXCHANGED, |f| f.get_derivatives(&mut [0.0; 2])),
        ('C', &EXCHANGED, |f| f.get_indicators(&mut [0.0])),
        ('C', &EXCHANGED, |f| f.get_states(&mut [0.0; 2])),
        ('C', &EXCHANGED, |f| f.slope(Ball::ENERGY, Ball::H, 1.0)),
    ];
    for (state, kinds, call) in calls {
        for &kind in kinds {
            let it = bring(kind, state);
            assert_eq!(it.set(Ball::TROUBLE, BUG), OK);
            assert_eq!(call(*it), FATAL);
            it.says("the model panicked and is dead: the bug");
            let message = it.messages().pop().unwrap();
            assert_eq!(message.kind(), ("logStatusFatal", FATAL));
            assert_eq!(it.reset(), FATAL);
            let mut value = [7.0];
            assert_eq!(it.get_f64(&[Ball::DRIVE], &mut value), FATAL);
            assert_eq!((value, other.set(Ball::DRIVE, 1.0)), ([7.0], OK));
        }
    }
    // In an expression of an attribute.
    for kind in PLAIN {
        let sampled = Instance::running(kind, SAMPLED);
        ok([sampled.set(Sampled::U, 0.0)]);
        let (y, u, mut derivative) = ([Sampled::Y], [Sampled::U], [7.0]);
        let divide = |f: Fmu| f.directional(&y, &u, &[1.0], &mut derivative);
        sampled.fails(FATAL, "the bug shows in a derivative", divide);
        assert_eq!(derivative, [7.0]);
    }
}
