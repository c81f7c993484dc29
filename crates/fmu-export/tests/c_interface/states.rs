//! The states in which calls are allowed, cell by cell (FMI 2.0.5, sections 3.2.3 and 4.2.4; FMI 3.0.2,
//! sections 2.3, 3.2 and 4.2), and how an instance gets from failures to other states.

use std::cell::RefCell;
use std::ptr::null_mut;
use std::rc::Rc;

use fmu_export::abi::state::State;
use fmu_export::fmi2::{fmi2LastSuccessfulTime, fmi2Terminated};

use crate::driver::*;
use crate::models::*;

/// The letters that stand for the states below, in the order of [`State::ALL`].
const LETTERS: &str = "IGNECSFURVTX!";

/// The states with their letters and names.
fn named() -> impl Iterator<Item = (char, &'static str)> {
    LETTERS.chars().zip(State::ALL.map(|(_, name)| name))
}

/// The states that a host can bring an instance to, outside of callbacks.
pub fn states(kind: Kind) -> &'static str {
    match kind {
        (Fmi2, Exchanged) => "INECTX!",
        (Fmi2, _) => "INSFTX!",
        (Fmi3, Stepped) => "IGNSFRTX!",
        (Fmi3, Events) => "IGNESFRVTX!",
        (Fmi3, Exchanged) => "IGNECVTX!",
    }
}

fn name(state: char) -> &'static str {
    named().find(|(letter, _)| *letter == state).unwrap().1
}

/// The letter of a state, by its name.
pub fn letter(state: &str) -> char {
    named().find(|(_, name)| *name == state).unwrap().0
}

/// A call with valid arguments.
type Call = fn(Fmu) -> Status;

const ALIVE_2: &str = "INESCFTX";
const ALIVE: &str = "INESCFTXGRV";
const READABLE: &str = "INESCFTXGRVU";
const COMPUTED: &str = "NESCFTX";

/// Operations, with the states that allow them in FMI 2.0 and 3.0, or "-" if a version lacks them; only in model
/// exchange with "m", in co-simulation with "c", not without events with "e". The last column is the number of
/// elements that their arrays need.
#[rustfmt::skip]
const TABLE: &[(&str, &str, &str, usize)] = &[
    ("set_debug_logging reset get_fmu_state set_fmu_state free_fmu_state serialized_fmu_state_size \
      serialize_fmu_state deserialize_fmu_state", ALIVE_2, ALIVE, 0),
    ("setup_experiment", "I", "-", 0),
    ("enter_initialization_mode", "I", "I", 0),
    ("exit_initialization_mode", "N", "N", 0),
    ("terminate", "SFEC", "SFECRV", 0),
    ("enter_configuration_mode", "-", "ISE", 0),
    ("exit_configuration_mode", "-", "GRV", 0),
    ("get_float64 get_int32 get_boolean get_string", COMPUTED, READABLE, 0),
    ("get_float32 get_int8 get_uint8 get_int16 get_uint16 get_uint32 get_int64 get_uint64 get_binary",
        "-", READABLE, 0),
    ("set_float64", "INESC", "INESCU", 0),
    ("set_float32", "-", "INESCU", 0),
    ("set_int32 set_boolean set_string", "INESC", "INESC", 0),
    ("set_int8 set_uint8 set_int16 set_uint16 set_uint32 set_int64 set_binary", "-", "INESC", 0),
    ("set_uint64", "-", "INESCGRV", 0),
    ("get_directional_derivative", COMPUTED, COMPUTED, 0),
    ("get_adjoint_derivative", "-", COMPUTED, 0),
    ("enter_event_mode", "mEC", "eSEC", 0),
    ("update_discrete_states", "mE", "E", 0),
    ("enter_continuous_time_mode", "mE", "mE", 0),
    ("completed_integrator_step", "mC", "mC", 0),
    ("set_time", "mEC", "mEC", 0),
    ("set_continuous_states", "mEC", "mC", 2),
    ("get_continuous_states get_continuous_state_derivatives", "mNECTX", "mNECTX", 2),
    ("get_nominals_of_continuous_states", "mINECTX", "mNECTX", 2),
    ("get_event_indicators", "mNECTX", "mNECTX", 0),
    ("get_number_of_event_indicators get_number_of_continuous_states", "-", "mINESCFTXGRV", 0),
    ("enter_step_mode", "-", "cE", 0),
    ("set_input_derivatives", "cINS", "-", 0),
    ("get_output_derivatives", "cSFTX", "cSFTXU", 0),
    ("do_step", "cS", "cS", 0),
    ("get_status get_real_status get_integer_status get_boolean_status get_string_status", "cSFT", "-", 0),
];

/// Operations that the model description declares as unsupported, and words of the reason.
const UNSUPPORTED: &[(&str, &str)] = &[
    ("cancel_step", "canRunAsynchronuously is false"),
    ("activate_model_partition", "the FMU is not for scheduled execution"),
    ("evaluate_discrete_states", "providesEvaluateDiscreteStates is false"),
    (
        "get_number_of_variable_dependencies get_variable_dependencies",
        "providesPerElementDependencies is false",
    ),
    (
        "get_clock set_clock get_interval_decimal get_interval_fraction get_shift_decimal get_shift_fraction \
      set_interval_decimal set_interval_fraction set_shift_decimal set_shift_fraction",
        "the model has no clocks",
    ),
];

/// Operations that are no calls of an instance.
const FREE: &str = "get_types_platform get_version instantiate instantiate_model_exchange \
    instantiate_co_simulation instantiate_scheduled_execution free_instance";

fn has(operations: &str, operation: &str) -> bool {
    operations.split_whitespace().any(|one| one == operation)
}

/// The row of a function for a version: the kind of instances that have it, the letters of its states, and the
/// length of its arrays; or why it is not supported.
pub fn row(
    version: FmiVersion,
    operation: &str,
) -> Result<(char, &'static str, usize), &'static str> {
    let Some((_, in_2, in_3, n)) = TABLE.iter().find(|row| has(row.0, operation)) else {
        let row = UNSUPPORTED.iter().find(|row| has(row.0, operation));
        return Err(row.expect(operation).1);
    };
    let letters = if version == Fmi2 { in_2 } else { in_3 };
    assert_ne!(*letters, "-", "{operation}");
    match letters.chars().next() {
        Some(kind @ ('m' | 'c' | 'e')) => Ok((kind, &letters[1..], *n)),
        _ => Ok((' ', letters, *n)),
    }
}

/// Why instances in this mode lack a function restricted to `only`; `None` if they have it.
pub fn lacks(only: char, mode: Mode) -> Option<&'static str> {
    match (only, mode) {
        ('m', Stepped | Events) => Some("it is a function of model exchange"),
        ('c', Exchanged) => Some("it is a function of co-simulation"),
        ('e', Stepped) => Some("eventModeUsed was false"),
        _ => None,
    }
}

/// Calls a function with valid arguments: with an FMU state of the instance, or with NULL if there is none.
pub fn call(f: Fmu, function: &Function, n: usize) -> Status {
    let has_state = function.operation.contains("fmu_state");
    let mut state = if has_state { f.save() } else { null_mut() };
    let status = match function.operation {
        "get_fmu_state" => f.get_state(&mut state),
        "set_fmu_state" => f.set_state(state),
        "serialized_fmu_state_size" => f.serialized_size(state, &mut 0),
        "serialize_fmu_state" => f.serialize_into(state, &mut [0; 999]),
        "deserialize_fmu_state" if state.is_null() => f.deserialize(&[], &mut state),
        "deserialize_fmu_state" => f.deserialize(&f.serialize(state), &mut state),
        "do_step" => f.step(0.25, 0.125),
        "get_real_status" => f.real_status(fmi2LastSuccessfulTime, &mut 0.0),
        "get_boolean_status" => f.boolean_status(fmi2Terminated, &mut 0),
        // The others are of asynchronous steps.
        status if status.ends_with("_status") => match function.call_with_zeros(f, n, None) {
            DISCARDED => OK,
            other => other,
        },
        _ => function.call_with_zeros(f, n, None),
    };
    if !state.is_null() {
        ok([f.free_state(&mut state)]);
    }
    status
}

/// Checks that results are never NULL, and arrays only if they are empty.
fn check_null(it: &Instance, function: &Function, n: usize) {
    let refusals = function.refusals.iter().flatten().enumerate();
    for (null, words) in refusals.filter(|(_, words)| !words.is_empty()) {
        let call = |f, n| function.call_with_zeros(f, n, Some(null));
        it.refuses(words, |f| call(f, 1));
        assert!(n > 0 || words.contains("result") || call(**it, 0) == OK);
    }
}

/// A ball in a state, or a list in a state of configuration. After a step, the time is 0.25.
fn bring(kind: Kind, state: char) -> Instance {
    let is_configured = "GRV".contains(state);
    let it = Instance::of(kind, if is_configured { SAMPLED } else { BALL });
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
        let input = if is_exchange { Ball::TROUBLE } else { Ball::FAULT };
        ok([it.set(input, trouble)]);
        let found =
            if is_exchange { it.get_derivatives(&mut [0.0; 2]) } else { it.step(0.25, 0.125) };
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
        for function in functions(kind.0) {
            let (it, operation) = (bring(kind, state), function.operation);
            println!("{operation} in {} of {kind:?}", name(state));
            let (only, letters, n) = match row(kind.0, operation) {
                Ok(row) => row,
                Err(_) if state == '!' => {
                    assert_eq!(call(*it, function, 0), ERROR);
                    continue;
                }
                Err(reason) => {
                    let words = format!("{}: ", it.name(operation));
                    it.refuses(&words, |f| call(f, function, 0));
                    it.fails(ERROR, reason, |f| call(f, function, 0));
                    continue;
                }
            };
            let has = |state| states(kind).contains(state) || state == 'U' && kind.1 != Exchanged;
            let allowed = named().filter(|(state, _)| letters.contains(*state) && has(*state));
            let mut allowed: Vec<&str> = allowed.map(|(_, name)| name).collect();
            allowed.dedup();
            let (call_name, state_name) = (it.name(operation), name(state));
            let forbidden = format!("{call_name} is not allowed in the state \"{state_name}\"; ");
            let forbidden = forbidden + "it is allowed in: " + &allowed.join(", ");
            let why = match lacks(only, kind.1) {
                Some(why) => why,
                None if !letters.contains(state) => &forbidden,
                None if operation == "enter_configuration_mode" => "structural parameters",
                None => {
                    check_null(&it, function, n);
                    assert_eq!(call(*it, function, n), OK, "{:?}", it.messages());
                    continue;
                }
            };
            match (state, why == forbidden) {
                ('!', false) => assert_eq!(call(*it, function, n), ERROR),
                ('!', true) => {
                    assert_eq!(call(*it, function, n), FATAL);
                    assert_eq!(it.last_message(), forbidden);
                }
                _ => it.refuses(why, |f| call(f, function, n)),
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
        for function in functions(Fmi3) {
            let Ok((_, letters, n)) = row(Fmi3, function.operation) else { continue };
            println!("{} in an intermediate update of {kind:?}", function.operation);
            let (it, statuses) = (new(), Rc::new(RefCell::new(Vec::new())));
            let answers = statuses.clone();
            it.on_update(move |fmu, _| {
                answers.borrow_mut().push(call(fmu, function, n));
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
fn the_tests_know_all_functions() {
    for (version, count) in [(Fmi2, 44), (Fmi3, 75)] {
        let all = version.functions().iter();
        let is_free = |(_, operation): &&(_, &str)| has(FREE, operation);
        let (free, others): (Vec<_>, Vec<_>) = all.partition(is_free);
        assert_eq!(free.len() + others.len(), count);
        let others = others.iter().map(|(_, operation)| *operation);
        let known = functions(version).iter().map(|function| function.operation);
        assert!(known.eq(others));
    }
}

#[test]
fn a_null_instance_is_an_error_and_can_be_freed() {
    for version in [Fmi2, Fmi3] {
        let (kind, c) = ((version, Stepped), null_mut());
        let null = Fmu { kind, c };
        let mut functions = functions(version).iter();
        assert!(functions.all(|function| call(null, function, 0) == ERROR));
        null.free();
    }
}

#[test]
fn a_reset_equals_a_fresh_instance() {
    for (kind, state) in all().filter(|(_, state)| *state != '!') {
        let it = bring(kind, state);
        let model = if "GRV".contains(state) { SAMPLED } else { BALL };
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
    let calls: [(char, &[Kind], Call); 12] = [
        ('N', &KINDS, Fmu::exit_initialization_mode),
        ('N', &KINDS, |f| f.get_f64(&[Ball::H], &mut [0.0])),
        ('S', &PLAIN, |f| f.get_f64(&[Ball::V_DOT], &mut [0.0])),
        ('S', &PLAIN, |f| f.slope(Ball::V_DOT, Ball::DRIVE, 1.0)),
        ('S', &PLAIN, |f| f.slopes(&[(Ball::H, 1)])),
        ('S', &[EVENTS], |f| f.step(0.25, 0.5)),
        ('E', &KINDS[2..], |f| f.try_update().0),
        ('E', &KINDS[2..], |f| f.get_i32(&[Ball::EVENTS], &mut [0])),
        ('C', &EXCHANGED, |f| f.get_derivatives(&mut [0.0; 2])),
        ('C', &EXCHANGED, |f| f.get_indicators(&mut [])),
        ('C', &EXCHANGED, |f| f.get_states(&mut [0.0; 2])),
        ('C', &EXCHANGED, |f| f.slope(Ball::ENERGY, Ball::H, 1.0)),
    ];
    for (state, kinds, call) in calls {
        for &kind in kinds {
            let it = bring(kind, state);
            assert_eq!(it.set(Ball::TROUBLE, BUG), OK);
            assert_eq!(call(*it), FATAL);
            it.says("the model panicked; the instance can only be freed: the bug");
            let message = it.messages().pop().unwrap();
            assert_eq!(message.kind(), ("logStatusFatal", FATAL));
            assert_eq!(it.reset(), FATAL);
            let mut value = [7.0];
            assert_eq!(it.get_f64(&[Ball::DRIVE], &mut value), FATAL);
            assert_eq!((value, other.set(Ball::DRIVE, 1.0)), ([7.0], OK));
        }
    }
}
