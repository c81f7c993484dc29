//! Initialization: the model at the start time, from the values that the host has set.

use fmi_abi::state::State;
use fmu_description::Number;

use crate::clock::{RateClocks, SampleClock};
use crate::error::{ModelError, Severity};
use crate::instance::Instance;
use crate::lifecycle::{InstanceType, IntegrationState};
use crate::model::Start;

impl Instance {
    /// Computes the outputs from the start values and inputs; nothing changes if that fails.
    pub(crate) fn initialize(&mut self) -> Result<(), ModelError> {
        let before = self.model.copy();
        let initialized = self.initialize_model().and_then(|()| match self.shared.clocks() {
            Some(clocks) => clocks.initialize(self),
            None => Ok(()),
        });
        if initialized.is_err() {
            self.model.assign(before.as_ref());
            self.shared.lifecycle.stale = true;
        }
        initialized.map_err(|error| error.with_severity(Severity::Refused))
    }

    fn initialize_model(&mut self) -> Result<(), ModelError> {
        let (model, shared) = (&mut self.model, &mut self.shared);
        model.renew();
        if let Some(starts) = &mut shared.starts {
            model.take_starts(starts.as_mut());
        }
        if let Some(clocks) = shared.clocks() {
            clocks.prepare(self);
        }
        let (model, shared) = (&mut self.model, &mut self.shared);
        let (info, lifecycle) = (model.info(), &shared.lifecycle);
        let start = Start {
            time: lifecycle.start_time,
            is_model_exchange: lifecycle.instance_type.is_model_exchange(),
            resources: shared.settings.resources.clone(),
        };
        model.behavior_mut().on_initialize(&start)?;
        let mut integration = IntegrationState { handled: start.time, ..IntegrationState::NONE };
        let is_eventful =
            info.is_continuous && lifecycle.instance_type == InstanceType::CoSimulationWithEvents;
        if (info.is_integrated || is_eventful) && !start.is_model_exchange {
            integration.tolerance = tolerance(lifecycle.tolerance, info.tolerance)?;
            // Without event mode, the instance handles the event at the start itself.
            if !is_eventful {
                model.evaluate_before_event(start.time);
                model.behavior_mut().on_event(start.time)?;
                integration.switches = model.hash_of_switches();
            }
        }
        if info.is_continuous {
            model.behavior_mut().on_evaluate(start.time)?;
        }
        let clocks = match info.rates {
            0 => None,
            _ => Some(RateClocks::new(start.time, &model.behavior().rates())?),
        };
        let clock = match info.is_sampled && clocks.is_none() {
            true => SampleClock::new(start.time, model.behavior().sample_time())?,
            false => SampleClock::UNSET,
        };
        model.check_equations().map_err(|error| {
            let reason = error.reason();
            ModelError::new(format_args!("at t = {:?} s: {reason}", Number(start.time)))
        })?;
        if info.is_integrated {
            shared.before = Some(model.copy());
        }
        if let Some(clocks) = clocks {
            shared.rate_clocks = clocks;
        }
        let lifecycle = &mut shared.lifecycle;
        (lifecycle.clock, lifecycle.integration) = (clock, integration);
        lifecycle.stale = false;
        Ok(())
    }
    pub(crate) fn exit_initialization_mode(&mut self) -> Result<(), ModelError> {
        if self.shared.lifecycle.stale {
            self.initialize()?;
        }
        self.shared.starts = None;
        let lifecycle = &mut self.shared.lifecycle;
        match lifecycle.instance_type {
            InstanceType::CoSimulation => self.enter(State::StepMode),
            InstanceType::CoSimulationWithEvents | InstanceType::ModelExchange => {
                lifecycle.time = lifecycle.start_time;
                self.enter(State::Event);
            }
            InstanceType::ScheduledExecution => self.enter(State::ClockActivation),
        }
        Ok(())
    }
}

/// The tolerance of the integration, as the host wants it, or as the model says.
fn tolerance(of_host: Option<f64>, of_model: f64) -> Result<f64, ModelError> {
    match of_host {
        Some(tolerance) if tolerance > 0.0 && tolerance.is_finite() => Ok(tolerance),
        Some(tolerance) => Err(ModelError::new(format_args!(
            "the tolerance is {:?}; expected a positive number",
            Number(tolerance)
        ))),
        // A model with a step of its own may have none.
        None if of_model == 0.0 => Ok(1e-6),
        None => Ok(of_model),
    }
}
