//! The state machine of a co-simulation slave (FMI 2.0.5, section 4.2.4): which calls are allowed in
//! which state.

use serde::{Deserialize, Serialize};

/// The state of a slave.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub(crate) enum Phase {
    /// Instantiated; start values and the experiment may be set.
    Instantiated = 1 << 0,
    /// In initialization mode.
    Initialization = 1 << 1,
    /// Ready for the next step ("slaveInitialized", "step complete").
    StepComplete = 1 << 2,
    /// A step was discarded and changed nothing: the host may restore a state or terminate.
    StepFailed = 1 << 3,
    /// The simulation is terminated.
    Terminated = 1 << 4,
    /// A step failed: values can be read, and the instance can be restored, reset or freed.
    Error = 1 << 5,
    /// The model panicked: the instance can only be freed.
    Fatal = 1 << 6,
}

const PHASES: [(Phase, &str); 7] = [
    (Phase::Instantiated, "instantiated"),
    (Phase::Initialization, "initialization mode"),
    (Phase::StepComplete, "step complete"),
    (Phase::StepFailed, "step failed"),
    (Phase::Terminated, "terminated"),
    (Phase::Error, "error"),
    (Phase::Fatal, "fatal"),
];

impl Phase {
    pub(crate) fn name(self) -> &'static str {
        PHASES
            .iter()
            .find(|(phase, _)| *phase == self)
            .map_or("", |(_, name)| name)
    }
}

/// A call, and the states in which it is allowed, as a set of [`Phase`] bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Call {
    pub(crate) name: &'static str,
    allowed: u8,
}

impl Call {
    pub(crate) const fn is_allowed(&self, phase: Phase) -> bool {
        self.allowed & phase as u8 != 0
    }

    /// The names of the states in which the call is allowed.
    pub(crate) fn allowed_names(&self) -> String {
        let names: Vec<&str> = PHASES
            .iter()
            .filter(|(phase, _)| self.is_allowed(*phase))
            .map(|(_, name)| *name)
            .collect();
        names.join(", ")
    }
}

const INSTANTIATED: u8 = Phase::Instantiated as u8;
const INITIALIZATION: u8 = Phase::Initialization as u8;
const STEP_COMPLETE: u8 = Phase::StepComplete as u8;
const STEP_FAILED: u8 = Phase::StepFailed as u8;
const TERMINATED: u8 = Phase::Terminated as u8;
const ERROR: u8 = Phase::Error as u8;
/// Every state except fatal.
const ALIVE: u8 = INSTANTIATED | INITIALIZATION | STEP_COMPLETE | STEP_FAILED | TERMINATED | ERROR;
const SETTABLE: u8 = INSTANTIATED | INITIALIZATION | STEP_COMPLETE;
const READABLE: u8 = INITIALIZATION | STEP_COMPLETE | STEP_FAILED | TERMINATED | ERROR;

macro_rules! calls {
    ($($constant:ident $name:ident: $allowed:expr;)*) => {
        $(
            #[doc = concat!("`", stringify!($name), "`")]
            pub(crate) const $constant: Call = Call {
                name: stringify!($name),
                allowed: $allowed,
            };
        )*
    };
}

calls! {
    SET_DEBUG_LOGGING fmi2SetDebugLogging: ALIVE;
    SETUP_EXPERIMENT fmi2SetupExperiment: INSTANTIATED;
    ENTER_INITIALIZATION_MODE fmi2EnterInitializationMode: INSTANTIATED;
    EXIT_INITIALIZATION_MODE fmi2ExitInitializationMode: INITIALIZATION;
    TERMINATE fmi2Terminate: STEP_COMPLETE | STEP_FAILED;
    RESET fmi2Reset: ALIVE;

    GET_REAL fmi2GetReal: READABLE;
    GET_INTEGER fmi2GetInteger: READABLE;
    GET_BOOLEAN fmi2GetBoolean: READABLE;
    GET_STRING fmi2GetString: READABLE;
    SET_REAL fmi2SetReal: SETTABLE;
    SET_INTEGER fmi2SetInteger: SETTABLE;
    SET_BOOLEAN fmi2SetBoolean: SETTABLE;
    SET_STRING fmi2SetString: SETTABLE;

    GET_FMU_STATE fmi2GetFMUstate: ALIVE;
    SET_FMU_STATE fmi2SetFMUstate: ALIVE;
    FREE_FMU_STATE fmi2FreeFMUstate: ALIVE;
    SERIALIZED_SIZE fmi2SerializedFMUstateSize: ALIVE;
    SERIALIZE fmi2SerializeFMUstate: ALIVE;
    DESERIALIZE fmi2DeSerializeFMUstate: ALIVE;

    DIRECTIONAL_DERIVATIVE fmi2GetDirectionalDerivative: READABLE;
    INPUT_DERIVATIVES fmi2SetRealInputDerivatives: SETTABLE;
    DO_STEP fmi2DoStep: STEP_COMPLETE;
    REAL_STATUS fmi2GetRealStatus: STEP_COMPLETE | STEP_FAILED | TERMINATED;
    BOOLEAN_STATUS fmi2GetBooleanStatus: STEP_COMPLETE | STEP_FAILED | TERMINATED;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_allowed_after_a_fatal_error() {
        for call in [RESET, GET_REAL, SET_REAL, DO_STEP, SET_DEBUG_LOGGING] {
            assert!(!call.is_allowed(Phase::Fatal), "{}", call.name);
        }
    }

    #[test]
    fn allowed_states_are_listed() {
        assert_eq!(DO_STEP.allowed_names(), "step complete");
        assert_eq!(
            SET_REAL.allowed_names(),
            "instantiated, initialization mode, step complete"
        );
    }
}
