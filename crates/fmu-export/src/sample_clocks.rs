//! Scheduled execution of a model with one or several sample times: each is the interval of a clock, at whose ticks the
//! host activates the sample.

use fmi_abi::state::State;
use fmu_description::references::first_sample_clock;

use crate::clock::SampleClock;
use crate::error::{ModelError, ensure, refused};
use crate::instance::{Clocks, Instance, Interval};

/// The clocks of a model with sample times, which are no variables of its author.
pub(crate) struct SampleClocks;

impl SampleClocks {
    /// The number of a clock, in the order of the rates, by its value reference.
    fn number(instance: &Instance, clock: u32) -> Result<usize, ModelError> {
        let info = instance.model.info();
        let first = first_sample_clock(info.time as usize, info.end as usize);
        let count = info.rates.max(1);
        let number = (clock as usize).checked_sub(first).filter(|number| *number < count);
        number.ok_or_else(|| {
            let last = first + count - 1;
            ModelError::refuse(format_args!(
                "value reference {clock} is not a clock; expected {first} to {last}"
            ))
        })
    }

    /// A clock, and whether it is one of several.
    fn at(instance: &mut Instance, number: usize) -> &mut SampleClock {
        match instance.model.info().rates {
            0 => &mut instance.shared.lifecycle.clock,
            _ => instance.shared.rate_clocks.at(number),
        }
    }
}

impl Clocks for SampleClocks {
    /// Takes the sample as co-simulation does at this instant. A rounding error of the host's time makes no difference.
    fn activate(&self, instance: &mut Instance, clock: u32, time: f64) -> Result<(), ModelError> {
        let number = Self::number(instance, clock)?;
        let lifecycle = &instance.shared.lifecycle;
        let stop = lifecycle.stop_time;
        ensure!(
            time <= stop + 1e-6 * (stop.abs() + 1.0),
            "the activation time {time:?} is past the stop time {stop:?}"
        );
        let at = Self::at(instance, number);
        let before = *at;
        let has_gap = at.tick_at(time)?;
        let (instant, sample_time) = (at.instant_before(1), at.sample_time());
        if has_gap {
            instance.warn_once("a tick of a periodic clock is left out");
        }
        let rates = instance.model.info().rates;
        let behavior = instance.model.behavior_mut();
        let taken = match rates {
            0 => behavior.on_step(instant, sample_time),
            _ => behavior.on_tick(number, instant, sample_time),
        };
        if let Err(error) = taken {
            *Self::at(instance, number) = before;
            return Err(error.with_prefix(format_args!("at t = {time:?} s")));
        }
        instance.shared.lifecycle.time = time;
        let checked = instance.model.check_outputs();
        checked.map_err(|error| error.with_prefix(format_args!("at t = {time:?} s")))
    }

    /// The sample time, which is known after the initialization and stays the same.
    fn interval(&self, instance: &mut Instance, clock: u32) -> Result<Interval, ModelError> {
        let number = Self::number(instance, clock)?;
        instance.bring_up_to_date()?;
        let sample_time = Self::at(instance, number).sample_time();
        Ok(match instance.shared.lifecycle.state {
            State::Initialization => Interval::Changed(sample_time),
            _ => Interval::Unchanged(sample_time),
        })
    }

    /// The first sample is at the start time.
    fn shift(&self, instance: &mut Instance, clock: u32) -> Result<f64, ModelError> {
        Self::number(instance, clock).map(|_| 0.0)
    }

    fn fraction(
        &self,
        _instance: &mut Instance,
        _clock: u32,
        _time: f64,
    ) -> Result<(u64, u64), ModelError> {
        refused!("supportsFraction is false")
    }
}
