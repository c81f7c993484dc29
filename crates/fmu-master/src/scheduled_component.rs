//! A component of scheduled execution in a run: the activation of its model partitions (FMI 3.0.2, section 5).

use fmu_description::IntervalVariability;
use fmu_host::Instance;

use crate::activations::{Activations, UpdatableClocks};
use crate::clocked_stage::{InputClock, Member};
use crate::component_instance::{CallResult, ComponentInstance};
use crate::recorded_instance::{IntegrationError, Operation};
use crate::store::Store;
use crate::ticks::Span;

impl ComponentInstance<'_> {
    /// Has the updates of clocks received, after the clocks have begun.
    pub(crate) fn begin_activations(&mut self, member: &Member) {
        let Some(clocks) = &mut self.clocks else { return };
        let numbered = member.inputs.iter().enumerate();
        let countdowns = numbered.filter(|(_, clock)| is_countdown(clock));
        let countdowns = countdowns
            .map(|(number, clock)| (number, clock.reference, clock.of_type.supports_fraction));
        let outputs = member.outputs.iter().map(|clock| clock.reference).collect();
        let activations = Activations::new(member.inputs.len());
        let updatable = UpdatableClocks { outputs, countdowns: countdowns.collect() };
        self.recorded.instance.on_clock_update(activations.receiver(updatable));
        clocks.begin_activations(activations);
    }

    /// Activates the model partition with the highest priority at a time (s): sets its inputs before and gets its outputs
    /// afterwards.
    pub(crate) fn activate_partition(
        &mut self,
        member: &Member,
        outputs: &mut Store,
        time: f64,
    ) -> CallResult {
        let Some((number, is_first)) =
            self.clocks.as_mut().and_then(|c| c.begin_activation(&member.inputs, time))
        else {
            return Ok(());
        };
        let clock = &member.inputs[number];
        if !is_first {
            let reason = format!(
                "the clock {} ticks once more at t = {time:?} s, where its model partition was activated before",
                clock.name
            );
            return Err(self.failed_activation(clock, reason));
        }
        self.recorded.calls.begin(None);
        self.write::<false>(outputs)?;
        let activate = |i: &mut Instance| i.activate_model_partition(clock.reference, time);
        let activated = self.recorded.call_with_warning(Operation::Activate, activate);
        activated.map_err(|error| self.integration_error(error, what(clock)))?;
        self.take_updates(member, clock, time)?;
        self.recorded.calls.begin(None);
        self.read::<false>(outputs)
    }

    /// Takes what the FMU has updated in an activation, and asks for the intervals that it only tells afterwards.
    fn take_updates(&mut self, member: &Member, activated: &InputClock, time: f64) -> CallResult {
        use IntervalVariability::{Changing, Tunable};
        let Some(clocks) = &mut self.clocks else { return Ok(()) };
        let updates = clocks.take_updates();
        if let Some(failure) = updates.failure {
            let error = IntegrationError::Call(failure, String::new());
            return Err(
                self.integration_error(error, format!("update of clocks, {}", what(activated)))
            );
        }
        for (number, span, qualifier) in updates.intervals {
            let clock = &member.inputs[number];
            let (interval, _) = self.checked_interval(clock, span, qualifier)?;
            self.restart(number, time, interval);
        }
        for (number, clock) in member.inputs.iter().enumerate() {
            let is_asked = match clock.of_type.interval_variability {
                Changing => clock.reference == activated.reference,
                Tunable => clock.of_type.is_asked_for(),
                _ => false,
            };
            if is_asked
                && let (Some(interval), is_new) = self.interval(clock)?
                && (is_new || clock.of_type.interval_variability == Changing)
            {
                self.restart(number, time, Some(interval));
            }
        }
        Ok(())
    }

    fn restart(&mut self, clock: usize, time: f64, interval: Option<Span>) {
        if let Some(clocks) = &mut self.clocks {
            clocks.restart(clock, time, interval);
        }
    }

    /// The error of an activation that is not made.
    fn failed_activation(&mut self, clock: &InputClock, reason: String) -> Box<crate::RunError> {
        let error = IntegrationError::Equations { reason, is_discarded: false, advice: None };
        self.integration_error(error, what(clock))
    }
}

fn what(clock: &InputClock) -> String {
    format!("tick of {}", clock.name)
}

fn is_countdown(clock: &InputClock) -> bool {
    clock.of_type.interval_variability == IntervalVariability::Countdown
}
