//! The states of an instance, in the vocabulary of FMI 3.0, and sets of them: the unions of their bits.
//!
//! FMI 2.0 has other names for some: "slaveInitialized" and "step complete" are step mode. Its states
//! "error" and "fatal" also exist here for FMI 3.0, where a failed instance can be read, restored or reset.

/// The state of an instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum State {
    /// Instantiated; start values and the experiment may be set.
    Instantiated = 1 << 0,
    /// In initialization mode.
    Initialization = 1 << 1,
    /// Co-simulation: ready for the next step.
    StepMode = 1 << 2,
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
    /// Scheduled execution: ready for the next activation of a model partition.
    ClockActivation = 1 << 13,
    /// Scheduled execution: the host is called back in a model partition, as clocks tick or have new intervals.
    ClockUpdate = 1 << 14,
    /// Scheduled execution: structural parameters may be set during a simulation, which continues in clock activation
    /// mode.
    ClockReconfiguration = 1 << 15,
}

impl State {
    /// All states with their names in messages, in the order of a simulation.
    pub const ALL: [(Self, &'static str); 16] = [
        (Self::Instantiated, "instantiated"),
        (Self::Configuration, "configuration mode"),
        (Self::Initialization, "initialization mode"),
        (Self::Event, "event mode"),
        (Self::ContinuousTime, "continuous-time mode"),
        (Self::StepMode, "step complete"),
        (Self::StepFailed, "step failed"),
        (Self::IntermediateUpdate, "intermediate update mode"),
        (Self::ClockActivation, "clock activation mode"),
        (Self::ClockUpdate, "clock update mode"),
        (Self::StepReconfiguration, "reconfiguration mode"),
        (Self::EventReconfiguration, "reconfiguration mode"),
        (Self::ClockReconfiguration, "reconfiguration mode"),
        (Self::Terminated, "terminated"),
        (Self::Error, "error"),
        (Self::Fatal, "fatal"),
    ];

    /// Its name in messages.
    pub fn name(self) -> &'static str {
        let mut all = Self::ALL.iter();
        all.find(|(state, _)| *state == self).map_or("", |(_, name)| name)
    }
}

/// Defines a constant for each set of states.
macro_rules! sets {
    ($($(#[$about:meta])* $name:ident = $($part:expr),+;)*) => {
        $(
            $(#[$about])*
            #[allow(missing_docs, reason = "a set of one state has its name")]
            pub const $name: u16 = $($part as u16)|+;
        )*
    };
}

sets! {
    /// In no state: the function belongs to an ability that these FMUs do not have.
    NOWHERE = 0;
    INSTANTIATED = State::Instantiated;
    INITIALIZATION = State::Initialization;
    STEP_MODE = State::StepMode;
    STEP_FAILED = State::StepFailed;
    EVENT = State::Event;
    CONTINUOUS_TIME = State::ContinuousTime;
    CONFIGURATION = State::Configuration;
    /// All states of reconfiguration.
    RECONFIGURATION = State::StepReconfiguration, State::EventReconfiguration, State::ClockReconfiguration;
    INTERMEDIATE_UPDATE = State::IntermediateUpdate;
    CLOCK_ACTIVATION = State::ClockActivation;
    CLOCK_UPDATE = State::ClockUpdate;
    TERMINATED = State::Terminated;
    /// A simulation is terminated or has failed.
    ENDED = State::Terminated, State::Error;
    /// Between initialization and termination, but for callbacks.
    RUNNING = STEP_MODE, STEP_FAILED, EVENT, CONTINUOUS_TIME, CLOCK_ACTIVATION;
    /// Where outputs are computed.
    COMPUTED = INITIALIZATION, RUNNING, ENDED;
    /// Every state but a fatal error, outside of callbacks; `INSTANTIATED | COMPUTED` in FMI 2.0.
    ALIVE = INSTANTIATED, CONFIGURATION, RECONFIGURATION, COMPUTED;
    /// Where a host gets values of FMI 3.0.
    READABLE = ALIVE, INTERMEDIATE_UPDATE, CLOCK_UPDATE;
    /// Where a host sets values; in continuous-time mode, it sets discrete inputs only to their present values.
    SETTABLE = INSTANTIATED, INITIALIZATION, STEP_MODE, EVENT, CONTINUOUS_TIME, CLOCK_ACTIVATION;
    /// Where a host sets values of continuous inputs.
    CONTINUOUS = SETTABLE, INTERMEDIATE_UPDATE;
    /// Where a host sets structural parameters and other values of their type.
    STRUCTURAL = SETTABLE, CONFIGURATION, RECONFIGURATION;
    /// Where the host asks for the intervals of clocks.
    CLOCK_TIMES = INITIALIZATION, EVENT, CLOCK_ACTIVATION;
    /// Where the equations of model exchange hold.
    EQUATIONS = INITIALIZATION, EVENT, CONTINUOUS_TIME, ENDED;
    /// Where a host gets the results of a step.
    STEPPED = STEP_MODE, STEP_FAILED, ENDED;
}
