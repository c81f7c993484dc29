//! The states of an instance, and the calls that they allow: FMI 2.0.5, sections 3.2.3 and 4.2.4; FMI 3.0.2, sections
//! 2.3, 3.2 and 4.2.

use fmu_export::abi::state::State;

use crate::driver::*;

/// The letters that stand for the states below, in the order of [`State::ALL`].
const LETTERS: &str = "IGNECSFUAKRVWTX!";

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
        (Fmi3, Scheduled) => "IGNAWTX!",
    }
}

/// The name of a state.
pub fn name(state: char) -> &'static str {
    named().find(|(letter, _)| *letter == state).unwrap().1
}

/// The first letter of a state, by its name: both states of reconfiguration have one name.
pub fn letter(state: &str) -> char {
    named().find(|(_, name)| *name == state).unwrap().0
}

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
pub const FREE: &str = "get_types_platform get_version instantiate instantiate_model_exchange \
    instantiate_co_simulation instantiate_scheduled_execution free_instance";

pub fn has(operations: &str, operation: &str) -> bool {
    operations.split_whitespace().any(|one| one == operation)
}

/// What the standard says about a call.
pub enum Verdict {
    Allowed,
    /// The state does not allow it; the message.
    Forbidden(String),
    /// The FMU or the kind of instance lacks it; words of the message.
    Unsupported(&'static str),
}

/// The row of an operation that is supported.
fn row(operation: &str) -> Option<&'static (&'static str, &'static str, &'static str, usize)> {
    TABLE.iter().find(|row| has(row.0, operation))
}

/// The letters of the states that allow an operation, after those of the kinds of instances that have it.
fn allowed(version: FmiVersion, operation: &str) -> Option<&'static str> {
    let (_, in_2, in_3, _) = row(operation)?;
    let letters = if version == Fmi2 { in_2 } else { in_3 };
    assert_ne!(*letters, "-", "{operation}");
    Some(letters)
}

/// The length of the arrays of an operation.
pub fn length(operation: &str) -> usize {
    row(operation).map_or(0, |row| row.3)
}

/// Whether a version allows an operation in an intermediate update; `None` if no instance has it.
pub fn is_allowed_in_update(operation: &str) -> Option<bool> {
    allowed(Fmi3, operation).map(|letters| letters.contains('U'))
}

/// Whether instances of a kind may call an operation in a state.
pub fn verdict(kind: Kind, state: char, operation: &str) -> Verdict {
    let Some(letters) = allowed(kind.0, operation) else {
        let row = UNSUPPORTED.iter().find(|row| has(row.0, operation));
        return Verdict::Unsupported(row.expect(operation).1);
    };
    match (letters.chars().next(), kind.1) {
        (Some('m'), Stepped | Events) => {
            return Verdict::Unsupported("it is a function of model exchange");
        }
        (Some('c'), Exchanged) => {
            return Verdict::Unsupported("it is a function of co-simulation");
        }
        (Some('e'), Stepped) => return Verdict::Unsupported("eventModeUsed was false"),
        _ if letters.contains(state) => return Verdict::Allowed,
        _ => {}
    }
    let has = |state| states(kind).contains(state) || state == 'U' && kind.1 != Exchanged;
    let others = named().filter(|(state, _)| letters.contains(*state) && has(*state));
    let mut others: Vec<&str> = others.map(|(_, name)| name).collect();
    others.dedup();
    let (function, others) = (kind.0.function(operation).expect(operation), others.join(", "));
    Verdict::Forbidden(format!(
        "{function} is not allowed in the state \"{}\"; it is allowed in: {others}",
        name(state),
    ))
}

/// The state to which a successful call leads.
pub fn state_after(kind: Kind, state: char, operation: &str) -> char {
    match (operation, state) {
        ("enter_initialization_mode", _) => 'N',
        ("exit_initialization_mode", _) if kind.1 != Stepped => 'E',
        ("exit_initialization_mode" | "enter_step_mode", _) => 'S',
        ("enter_event_mode", _) => 'E',
        ("enter_continuous_time_mode", _) => 'C',
        ("terminate", _) => 'T',
        ("reset", _) => 'I',
        ("enter_configuration_mode", 'I') => 'G',
        ("enter_configuration_mode", 'S') => 'R',
        ("enter_configuration_mode", 'E') => 'V',
        ("exit_configuration_mode", 'G') => 'I',
        ("exit_configuration_mode", 'R') => 'S',
        ("exit_configuration_mode", 'V') => 'E',
        _ => state,
    }
}
