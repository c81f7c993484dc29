//! The state machine of a co-simulation slave (FMI 2.0.4, section 4.2.4): which call is allowed in
//! which state.

/// The state of a slave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Phase {
    /// Made; start values and the experiment may be set.
    Instantiated = 1 << 0,
    /// In initialization mode.
    Initialization = 1 << 1,
    /// Ready for the next step ("slaveInitialized", "step complete").
    StepComplete = 1 << 2,
    /// The simulation is over.
    Terminated = 1 << 3,
    /// A step failed: only looking, reset and free are left.
    Error = 1 << 4,
    /// A panic was stopped: only free is left.
    Fatal = 1 << 5,
}

const PHASES: [(Phase, &str); 6] = [
    (Phase::Instantiated, "instantiated"),
    (Phase::Initialization, "initialization mode"),
    (Phase::StepComplete, "step complete"),
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

    /// The states in which the call is allowed, for people.
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
const TERMINATED: u8 = Phase::Terminated as u8;
const ERROR: u8 = Phase::Error as u8;
/// Every state but fatal.
const ALIVE: u8 = INSTANTIATED | INITIALIZATION | STEP_COMPLETE | TERMINATED | ERROR;
const SETTABLE: u8 = INSTANTIATED | INITIALIZATION | STEP_COMPLETE;

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
    TERMINATE fmi2Terminate: STEP_COMPLETE;
    RESET fmi2Reset: ALIVE;
    GET_REAL fmi2GetReal: ALIVE;
    GET_INTEGER fmi2GetInteger: ALIVE;
    GET_BOOLEAN fmi2GetBoolean: ALIVE;
    GET_STRING fmi2GetString: ALIVE;
    SET_REAL fmi2SetReal: SETTABLE;
    SET_INTEGER fmi2SetInteger: SETTABLE;
    SET_BOOLEAN fmi2SetBoolean: SETTABLE;
    SET_STRING fmi2SetString: SETTABLE;
    DO_STEP fmi2DoStep: STEP_COMPLETE;
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
    fn the_allowed_states_are_named() {
        assert_eq!(DO_STEP.allowed_names(), "step complete");
        assert_eq!(
            SET_REAL.allowed_names(),
            "instantiated, initialization mode, step complete"
        );
    }
}
