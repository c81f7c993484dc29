//! The type of a clock: when it ticks.

use crate::IntervalVariability;

/// When a clock ticks (FMI 3.0.2, sections 2.2.9 and 2.4.5): what a table, or the `Clock` element of a model description and
/// its declared type, say.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[cfg_attr(feature = "xml", derive(serde::Deserialize))]
pub struct ClockType {
    /// The kind of the clock.
    pub interval_variability: IntervalVariability,
    /// The interval between ticks (s), if it is known before the simulation; the host may set it of a fixed or tunable
    /// clock.
    pub interval: Option<f64>,
    /// The time from the start to the first tick (s), as far as it is known before the simulation.
    pub shift: f64,
    /// In how many units the second is divided by counters, if there are any.
    pub resolution: Option<u64>,
    /// Whether the interval and the shift can be read and set as fractions.
    pub supports_fraction: bool,
    /// The priority in scheduled execution, if one is given; 0 is the highest.
    pub priority: Option<u32>,
    /// Whether the host may deactivate it.
    pub can_be_deactivated: bool,
}

impl ClockType {
    /// Whether the FMU tells its interval: the host asks for it.
    pub const fn is_asked_for(&self) -> bool {
        use IntervalVariability::{Calculated, Changing, Countdown, Tunable};
        match self.interval_variability {
            Calculated | Changing | Countdown => true,
            Tunable => self.interval.is_none(),
            _ => false,
        }
    }

    /// A time (s) as a number of units of the resolution, if there is one.
    pub fn counter(&self, time: f64) -> Option<u64> {
        Some((time * self.resolution? as f64).round() as u64)
    }
}
