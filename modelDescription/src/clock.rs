//! Clocks: the type of an author's field, and what a model description says of when they tick.

use serde_core::{Deserialize, Deserializer, Serialize, Serializer};

/// A clock of a model (FMI 3.0.2, section 2.2.9): a variable that ticks at instants. An input ticks when the host says
/// so, an output when the model assigns [`Clock::TICK`] to it. Before the next instant, all clocks are inactive again.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Clock {
    is_active: bool,
    interval: Option<f64>,
    /// Whether the host has not heard of the interval.
    is_new: bool,
    /// The time from the start to the first tick (s) that the host has set.
    shift: Option<f64>,
}

impl Clock {
    /// The value of an output clock that ticks now.
    pub const TICK: Self = Self { is_active: true, interval: None, is_new: false, shift: None };

    /// The value of an input clock of kind `changing` or `countdown` that ticks so many seconds from now, which may be 0.
    ///
    /// To a `changing` clock, it is assigned in `initialize` and at each of its ticks. To a `countdown` clock, it may be
    /// assigned at any tick; the clock then ticks no more at the time that was assigned before.
    ///
    /// An assignment replaces the whole clock, so [`is_active`](Self::is_active) is false afterwards, also at its own
    /// tick: ask first.
    pub const fn after(seconds: f64) -> Self {
        Self { is_active: false, interval: Some(seconds), is_new: true, shift: None }
    }

    /// Whether the clock ticks now.
    #[inline]
    pub const fn is_active(&self) -> bool {
        self.is_active
    }

    /// The interval (s): of a clock of kind `changing` or `countdown`, the one that was last assigned by
    /// [`after`](Self::after), if there is one; of a clock of kind `fixed` or `tunable` with an interval that the host
    /// may set, the one in force. `None` for other clocks.
    #[inline]
    pub const fn interval(&self) -> Option<f64> {
        self.interval
    }

    /// Says whether the clock ticks now.
    #[doc(hidden)]
    #[inline]
    pub const fn set_active(&mut self, is_active: bool) {
        self.is_active = is_active;
    }

    /// Sets the interval (s), and whether the host has not heard of it.
    #[doc(hidden)]
    #[inline]
    pub const fn set_interval(&mut self, interval: Option<f64>, is_new: bool) {
        self.interval = interval;
        self.is_new = is_new;
    }

    /// Whether the host has not heard of the interval.
    #[doc(hidden)]
    #[inline]
    pub const fn is_new(&self) -> bool {
        self.is_new
    }

    /// The time from the start to the first tick (s) that the host has set.
    #[doc(hidden)]
    #[inline]
    pub const fn shift(&self) -> Option<f64> {
        self.shift
    }

    /// Sets the time from the start to the first tick (s).
    #[doc(hidden)]
    #[inline]
    pub const fn set_shift(&mut self, shift: f64) {
        self.shift = Some(shift);
    }
}

impl Serialize for Clock {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.is_active, self.interval, self.is_new, self.shift).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Clock {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (is_active, interval, is_new, shift) = Deserialize::deserialize(deserializer)?;
        Ok(Self { is_active, interval, is_new, shift })
    }
}

/// The interval and the shift (s) of a clock, as a model calculates them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// The time between ticks.
    pub interval: f64,
    /// The time from the start to the first tick.
    pub shift: f64,
}
