//! The state machine of an instance: its states, and sets of them in which a call is allowed. The calls
//! of each version of FMI are in `fmi2/calls.rs` and `fmi3/calls.rs`.

use serde::{Deserialize, Serialize};

use crate::lifecycle::Mode;

/// The state of an instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u16)]
pub(crate) enum Phase {
    /// Instantiated; start values and the experiment may be set.
    Instantiated = 1 << 0,
    /// In initialization mode.
    Initialization = 1 << 1,
    /// Co-simulation: ready for the next step ("slaveInitialized", "step complete", "Step Mode").
    StepComplete = 1 << 2,
    /// Co-simulation: a step was discarded and changed nothing. The host may restore a state or terminate.
    StepFailed = 1 << 3,
    /// The simulation is terminated.
    Terminated = 1 << 4,
    /// A step failed: values can be read, and the instance can be restored, reset or freed.
    Error = 1 << 5,
    /// The model panicked: the instance can only be freed.
    Fatal = 1 << 6,
    /// In event mode.
    Event = 1 << 7,
    /// Model exchange: in continuous-time mode.
    ContinuousTime = 1 << 8,
    /// FMI 3.0: structural parameters may be set before initialization.
    Configuration = 1 << 9,
    /// FMI 3.0: structural parameters may be set during a simulation, which continues in step mode.
    StepReconfiguration = 1 << 10,
    /// FMI 3.0: structural parameters may be set during a simulation, which continues in event mode.
    EventReconfiguration = 1 << 11,
    /// FMI 3.0: the host is called back in a step.
    IntermediateUpdate = 1 << 12,
}

const PHASES: [(Phase, &str); 13] = [
    (Phase::Instantiated, "instantiated"),
    (Phase::Configuration, "configuration mode"),
    (Phase::Initialization, "initialization mode"),
    (Phase::Event, "event mode"),
    (Phase::ContinuousTime, "continuous-time mode"),
    (Phase::StepComplete, "step complete"),
    (Phase::StepFailed, "step failed"),
    (Phase::IntermediateUpdate, "intermediate update mode"),
    (Phase::StepReconfiguration, "reconfiguration mode"),
    (Phase::EventReconfiguration, "reconfiguration mode"),
    (Phase::Terminated, "terminated"),
    (Phase::Error, "error"),
    (Phase::Fatal, "fatal"),
];

impl Phase {
    /// Whether instances of this mode can be in the state.
    pub(crate) const fn is_of(self, mode: Mode) -> bool {
        match self {
            Self::StepComplete | Self::StepFailed | Self::StepReconfiguration => {
                !matches!(mode, Mode::ModelExchange)
            }
            Self::Event | Self::EventReconfiguration => !matches!(mode, Mode::CoSimulation),
            Self::ContinuousTime => matches!(mode, Mode::ModelExchange),
            _ => true,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        PHASES
            .iter()
            .find(|(phase, _)| *phase == self)
            .map_or("", |(_, name)| name)
    }
}

/// A call, and the states in which it is allowed, as a set of [`Phase`] bits, with
/// [`ONLY_MODEL_EXCHANGE`] or [`ONLY_CO_SIMULATION`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Call {
    pub(crate) name: &'static str,
    pub(crate) allowed: u16,
}

impl Call {
    pub(crate) const fn is_allowed(&self, phase: Phase) -> bool {
        self.allowed & phase as u16 != 0
    }

    /// Why the call does not exist for an instance of this mode; `None` if it does.
    pub(crate) const fn wrong_mode(&self, mode: Mode) -> Option<&'static str> {
        match mode {
            Mode::ModelExchange if self.allowed & ONLY_CO_SIMULATION != 0 => {
                Some("it is a function of co-simulation, but the instance is for model exchange")
            }
            Mode::CoSimulation | Mode::CoSimulationWithEvents
                if self.allowed & ONLY_MODEL_EXCHANGE != 0 =>
            {
                Some("it is a function of model exchange, but the instance is for co-simulation")
            }
            _ => None,
        }
    }

    /// The names of the states in which the call is allowed.
    pub(crate) fn allowed_names(&self) -> String {
        let mut names: Vec<&str> = PHASES
            .iter()
            .filter(|(phase, _)| self.is_allowed(*phase))
            .map(|(_, name)| *name)
            .collect();
        names.dedup();
        names.join(", ")
    }
}

pub(crate) const INSTANTIATED: u16 = Phase::Instantiated as u16;
pub(crate) const INITIALIZATION: u16 = Phase::Initialization as u16;
pub(crate) const STEP_COMPLETE: u16 = Phase::StepComplete as u16;
pub(crate) const STEP_FAILED: u16 = Phase::StepFailed as u16;
pub(crate) const TERMINATED: u16 = Phase::Terminated as u16;
pub(crate) const ERROR: u16 = Phase::Error as u16;
pub(crate) const EVENT: u16 = Phase::Event as u16;
pub(crate) const CONTINUOUS_TIME: u16 = Phase::ContinuousTime as u16;
pub(crate) const CONFIGURATION: u16 = Phase::Configuration as u16;
pub(crate) const RECONFIGURATION: u16 =
    Phase::StepReconfiguration as u16 | Phase::EventReconfiguration as u16;
pub(crate) const INTERMEDIATE_UPDATE: u16 = Phase::IntermediateUpdate as u16;
/// A call of model exchange only.
pub(crate) const ONLY_MODEL_EXCHANGE: u16 = 1 << 14;
/// A call of co-simulation only.
pub(crate) const ONLY_CO_SIMULATION: u16 = 1 << 15;
/// The states of a simulation between initialization and termination, but for callbacks.
pub(crate) const RUNNING: u16 = STEP_COMPLETE | STEP_FAILED | EVENT | CONTINUOUS_TIME;

/// Defines a constant for each function: the call with the states in which it is allowed.
macro_rules! calls {
    ($($constant:ident $name:ident: $allowed:expr;)*) => {
        $(
            #[doc = concat!("`", stringify!($name), "`")]
            pub(crate) const $constant: $crate::phase::Call = $crate::phase::Call {
                name: stringify!($name),
                allowed: $allowed,
            };
        )*
    };
}
pub(crate) use calls;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fmi2::calls::{DO_STEP, GET_REAL, RESET, SET_DEBUG_LOGGING, SET_REAL};

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
            "instantiated, initialization mode, event mode, continuous-time mode, step complete"
        );
    }
}
