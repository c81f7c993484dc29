//! The lifecycle of an instance, and the steps it may take.

use fmi_abi::state::State;
use fmi_abi::{FmiFunction, FunctionGroup};
use fmu_description::{LogCategory, Number};

use crate::clock::SampleClock;
use crate::error::{ModelError, ensure};
use crate::log::Log;
use crate::saved::saved;

/// Minimum tolerance (s) when comparing communication points.
const MIN_TOLERANCE: f64 = 1e-9;

/// Why a model that has no clocks has no model partitions.
pub(crate) const NOT_SCHEDULED: &str =
    "the FMU is not for scheduled execution; expected model exchange or co-simulation";

/// The communication point before the first step: no step continues from it.
const BEFORE_FIRST_STEP: f64 = f64::NEG_INFINITY;

saved! {
    /// The type of an instance, as the host chose it.
    pub(crate) enum InstanceType {
        /// Co-simulation.
        CoSimulation,
        /// Co-simulation with event mode (FMI 3.0.2, section 4.1.1).
        CoSimulationWithEvents,
        /// Model exchange.
        ModelExchange,
    } and later {
        /// Scheduled execution.
        ScheduledExecution,
    }
}

impl InstanceType {
    /// Whether the binary has instances for co-simulation.
    pub(crate) const HAS_CO_SIMULATION: bool = cfg!(any(
        feature = "co-simulation",
        not(any(feature = "model-exchange", feature = "scheduled-execution"))
    ));
    /// Whether it has instances for model exchange.
    pub(crate) const HAS_MODEL_EXCHANGE: bool = cfg!(any(
        feature = "model-exchange",
        not(any(feature = "co-simulation", feature = "scheduled-execution"))
    ));
    /// Whether it has instances for scheduled execution, which only FMI 3.0 has.
    pub(crate) const HAS_SCHEDULED_EXECUTION: bool = cfg!(all(
        any(feature = "fmi3", not(feature = "fmi2")),
        any(
            feature = "scheduled-execution",
            not(any(feature = "co-simulation", feature = "model-exchange"))
        )
    ));
    /// Whether it has no others.
    pub(crate) const HAS_ONLY_SCHEDULED_EXECUTION: bool =
        Self::HAS_SCHEDULED_EXECUTION && !Self::HAS_CO_SIMULATION && !Self::HAS_MODEL_EXCHANGE;

    /// Whether it is for model exchange, which the compiler knows of a binary for one interface type.
    pub(crate) const fn is_model_exchange(self) -> bool {
        let has_others = Self::HAS_CO_SIMULATION || Self::HAS_SCHEDULED_EXECUTION;
        Self::HAS_MODEL_EXCHANGE && (!has_others || matches!(self, Self::ModelExchange))
    }

    /// Whether it is for co-simulation.
    const fn is_co_simulation(self) -> bool {
        matches!(self, Self::CoSimulation | Self::CoSimulationWithEvents)
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::CoSimulation => "co-simulation",
            Self::CoSimulationWithEvents => "co-simulation with event mode",
            Self::ModelExchange => "model exchange",
            Self::ScheduledExecution => "scheduled execution",
        }
    }

    /// Whether instances of this type can be in a state.
    pub(crate) const fn has(self, state: State) -> bool {
        match state {
            State::StepMode
            | State::StepFailed
            | State::StepReconfiguration
            | State::IntermediateUpdate => self.is_co_simulation(),
            State::Event | State::EventReconfiguration => {
                matches!(self, Self::CoSimulationWithEvents | Self::ModelExchange)
            }
            State::ContinuousTime => self.is_model_exchange(),
            State::ClockActivation | State::ClockUpdate | State::ClockReconfiguration => {
                matches!(self, Self::ScheduledExecution)
            }
            _ => true,
        }
    }

    /// Why an instance of this type does not have a function; `None` if it does.
    pub(crate) fn lacks(self, call: &FmiFunction) -> Option<&'static str> {
        match (call.group, self) {
            (FunctionGroup::CoSimulation, Self::ModelExchange) => {
                Some("it is a function of co-simulation, but the instance is for model exchange")
            }
            (FunctionGroup::ModelExchange, Self::CoSimulation | Self::CoSimulationWithEvents) => {
                Some("it is a function of model exchange, but the instance is for co-simulation")
            }
            (FunctionGroup::All, Self::CoSimulation) if call.name.ends_with("EnterEventMode") => {
                Some("the instance was created without event mode: eventModeUsed was false")
            }
            _ => None,
        }
    }

    /// As [`lacks`](Self::lacks), for an instance of a model with clocks.
    pub(crate) fn lacks_with_clocks(self, call: &FmiFunction) -> Option<&'static str> {
        match (call.group, self) {
            (FunctionGroup::CoSimulation, Self::ScheduledExecution) => Some(
                "it is a function of co-simulation, but the instance is for scheduled execution",
            ),
            (FunctionGroup::ModelExchange, Self::ScheduledExecution) => Some(
                "it is a function of model exchange, but the instance is for scheduled execution",
            ),
            (_, Self::ScheduledExecution)
                if call.is_allowed(State::Event)
                    && !call.is_allowed(State::Initialization)
                    && !call.is_allowed(State::ClockActivation) =>
            {
                Some("it is a function of event mode, but the instance is for scheduled execution")
            }
            (_, Self::ScheduledExecution) => None,
            (FunctionGroup::ScheduledExecution, _) => {
                Some("the instance is not for scheduled execution")
            }
            _ => self.lacks(call),
        }
    }
}

saved! {
    /// The lifecycle of an instance. Together with the model's values, this is its complete state.
    pub(crate) struct Lifecycle {
        pub(crate) instance_type: InstanceType,
        pub(crate) state: State,
        pub(crate) start_time: f64,
        /// `f64::MAX` if there is none.
        pub(crate) stop_time: f64,
        /// The relative tolerance that the host wants; `None` if it left that to the model.
        pub(crate) tolerance: Option<f64>,
        /// Co-simulation: the current communication point (s); `BEFORE_FIRST_STEP` until there is one. Model
        /// exchange: the time that the host set.
        pub(crate) time: f64,
        /// Whether values were set since the outputs were last computed, other than between steps.
        pub(crate) stale: bool,
        /// Whether an input has a time derivative for the next step.
        pub(crate) has_input_derivatives: bool,
        /// The sample instants of a model with one sample time.
        pub(crate) clock: SampleClock,
        pub(crate) integration: IntegrationState,
    }

    /// How a model is integrated.
    pub(crate) struct IntegrationState {
        /// Relative tolerance.
        pub(crate) tolerance: f64,
        /// The time until which events are handled (s).
        pub(crate) handled: f64,
        /// Whether the last event has left an event indicator close to zero, and nothing was integrated since.
        pub(crate) restarts: bool,
        /// The hash of the variables that cause an event by a new value, when events were last handled.
        pub(crate) switches: u128,
    }
}

impl IntegrationState {
    /// The integration of a model that the instance does not integrate.
    pub(crate) const NONE: Self =
        Self { tolerance: 0.0, handled: 0.0, restarts: false, switches: 0 };
}

impl Lifecycle {
    pub(crate) const fn new(instance_type: InstanceType) -> Self {
        Self {
            instance_type,
            state: State::Instantiated,
            start_time: 0.0,
            stop_time: f64::MAX,
            tolerance: None,
            time: BEFORE_FIRST_STEP,
            stale: true,
            has_input_derivatives: false,
            clock: SampleClock::UNSET,
            integration: IntegrationState::NONE,
        }
    }

    /// The current time: the end of the last successful step, the time of model exchange, or the start (s).
    pub(crate) fn now(&self) -> f64 {
        match self.time {
            BEFORE_FIRST_STEP => self.start_time,
            time => time,
        }
    }

    /// Quickly checks for a regular step from the end of the last one. It implies that
    /// [`check_step`](Self::check_step) allows the step, but not the reverse.
    #[inline(always)]
    pub(crate) fn is_next_step(&self, time: f64, step: f64) -> bool {
        self.state == State::StepMode
            && 0.0 < step
            && (time - self.time).abs() <= MIN_TOLERANCE
            && time + step <= self.stop_time
    }

    /// Checks a step, and logs a warning if it is unusual.
    pub(crate) fn check_step(
        &self,
        call: &str,
        time: f64,
        step: f64,
        log: &Log,
    ) -> Result<(), ModelError> {
        ensure!(
            step.is_finite() && step >= 0.0,
            "the communication step is {:?}; expected a finite number of at least 0",
            Number(step)
        );
        ensure!(
            time.is_finite(),
            "the communication point is {:?}; expected a finite number",
            Number(time)
        );
        // Hosts accumulate or multiply times, with different rounding errors.
        let tolerance = 1e-6 * step + MIN_TOLERANCE * (1.0 + time.abs());
        let (start, end, stop) = (self.start_time, self.time, self.stop_time);
        let (is_first, late) = (end == BEFORE_FIRST_STEP, time - start);
        ensure!(
            is_first || (time - end).abs() <= tolerance,
            "the communication point is {:?}; expected {}, where the last step ended",
            Number(time),
            Number(end)
        );
        // A sampled loop may start at its first sample.
        ensure!(
            !is_first || (-tolerance <= late && late <= step + tolerance),
            "the first communication point is {:?}; expected the start time {}",
            Number(time),
            Number(start)
        );
        let step_end = time + step;
        ensure!(
            step_end <= stop + tolerance,
            "the step ends at {:?}, past the stop time {:?}",
            Number(step_end),
            Number(stop)
        );
        if is_first && late > tolerance {
            log.send(
                LogCategory::Warning,
                format_args!(
                    "{call}: the first step starts at {}, not at the start time {}",
                    Number(time),
                    Number(start)
                ),
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An instance whose last step ended at 1 s and whose stop time is 2 s.
    const RUNNING: Lifecycle = Lifecycle {
        state: State::StepMode,
        stop_time: 2.0,
        time: 1.0,
        ..Lifecycle::new(InstanceType::CoSimulation)
    };

    fn is_allowed(lifecycle: &Lifecycle, time: f64, step: f64) -> bool {
        let log = Log::new(None, false);
        lifecycle.check_step("fmi2DoStep", time, step, &log).is_ok()
    }

    #[test]
    fn regular_steps_take_the_fast_path() {
        for (time, step) in [(1.0, 1e-3), (1.0 + 1e-12, 0.5), (1.0, 1.0)] {
            assert!(RUNNING.is_next_step(time, step));
        }
    }

    #[test]
    fn every_step_on_the_fast_path_is_allowed() {
        let extremes = [0.0, 1e-300, 1e-9, 1.0, 1.0 + 1e-9, 1.1, 2.0, f64::MAX];
        let others = [f64::MIN, -1.0, BEFORE_FIRST_STEP, f64::INFINITY, f64::NAN];
        let times: Vec<f64> = extremes.into_iter().chain(others).collect();
        let states = [State::Initialization, State::StepFailed, State::Fatal];
        let ends = times.iter().flat_map(|end| [(*end, 2.0), (*end, f64::MAX)]);
        for (end, stop_time) in ends {
            let lifecycle = Lifecycle { stop_time, time: end, ..RUNNING };
            for (time, step) in times.iter().flat_map(|t| times.iter().map(|step| (*t, *step))) {
                assert!(
                    !lifecycle.is_next_step(time, step) || is_allowed(&lifecycle, time, step),
                    "{lifecycle:?} {time} {step}"
                );
                for state in states {
                    assert!(!Lifecycle { state, ..lifecycle }.is_next_step(time, step));
                }
            }
        }
        let first = Lifecycle { time: BEFORE_FIRST_STEP, ..RUNNING };
        assert!(!first.is_next_step(0.0, 0.1));
    }
}
