//! Nonlinear characteristics: limits of values and rates, a dead zone, and a relay with hysteresis.
//!
//! The characteristics are those of J.-J. E. Slotine and W. Li, *Applied Nonlinear Control* (Prentice Hall, 1991),
//! chapter 5.

/// Limits a value: `y = min(max(u, lower), upper)`. NaN stays NaN.
///
/// ```
/// use control_blocks::Saturation;
///
/// let valve = Saturation { lower: 0.0, upper: 100.0 };
/// assert_eq!(valve.value(120.0), 100.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Saturation {
    /// Lower limit.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = -1))]
    pub lower: f64,
    /// Upper limit.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub upper: f64,
}

impl Default for Saturation {
    fn default() -> Self {
        Self { lower: -1.0, upper: 1.0 }
    }
}

impl Saturation {
    /// The limited value.
    pub fn value(&self, u: f64) -> f64 {
        crate::clip(u, self.lower, self.upper)
    }
}

/// Limits the rate of change: `-falling <= dy/dt <= rising`. It starts at 0, so it makes a ramp of a step.
///
/// ```
/// use control_blocks::RateLimiter;
///
/// let mut ramp = RateLimiter { rising: 2.0, falling: 1.0, ..RateLimiter::default() };
/// assert_eq!(ramp.update(1.0, 0.1), 0.2);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct RateLimiter {
    /// Largest increase per second.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0))]
    pub rising: f64,
    /// Largest decrease per second, as a positive number.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0))]
    pub falling: f64,
    /// State: the output.
    pub y: f64,
}

impl Default for RateLimiter {
    fn default() -> Self {
        Self { rising: 1.0, falling: 1.0, y: 0.0 }
    }
}

impl RateLimiter {
    /// The output after a step of `dt` (s).
    pub fn update(&mut self, u: f64, dt: f64) -> f64 {
        self.y = crate::clip(u, self.y - self.falling * dt, self.y + self.rising * dt);
        self.y
    }

    /// Starts at the value `y`.
    pub fn settle(&mut self, y: f64) {
        self.y = y;
    }

    /// Starts at 0.
    pub fn reset(&mut self) {
        self.settle(0.0);
    }
}

/// Ignores small values: 0 between `lower` and `upper`, and outside the distance from there.
///
/// ```
/// use control_blocks::DeadZone;
///
/// let zone = DeadZone { lower: -0.5, upper: 0.5 };
/// assert_eq!([0.4, 2.0, -2.0].map(|u| zone.value(u)), [0.0, 1.5, -1.5]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct DeadZone {
    /// Lower end of the dead zone.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = -1))]
    pub lower: f64,
    /// Upper end of the dead zone.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub upper: f64,
}

impl Default for DeadZone {
    fn default() -> Self {
        Self { lower: -1.0, upper: 1.0 }
    }
}

impl DeadZone {
    /// The distance from the dead zone.
    pub fn value(&self, u: f64) -> f64 {
        u - crate::clip(u, self.lower, self.upper)
    }
}

/// Relay with hysteresis: on above one value, off below another, and between them as before. It starts off.
///
/// ```
/// use control_blocks::Hysteresis;
///
/// let mut heating = Hysteresis { on_above: 1.0, off_below: -1.0, ..Hysteresis::default() };
/// let errors = [0.0, 1.5, 0.0, -1.5, 0.0];
/// assert_eq!(errors.map(|e| heating.update(e)), [0.0, 1.0, 1.0, 0.0, 0.0]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Hysteresis {
    /// Switches on above this value.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub on_above: f64,
    /// Switches off below this value.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = -1))]
    pub off_below: f64,
    /// Output if on.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub on_value: f64,
    /// Output if off.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub off_value: f64,
    /// State: whether it is on.
    pub is_on: bool,
}

impl Default for Hysteresis {
    fn default() -> Self {
        Self { on_above: 1.0, off_below: -1.0, on_value: 1.0, off_value: 0.0, is_on: false }
    }
}

impl Hysteresis {
    /// The output for the value `u`.
    pub fn update(&mut self, u: f64) -> f64 {
        self.is_on = u > self.on_above || self.is_on && u >= self.off_below;
        if self.is_on { self.on_value } else { self.off_value }
    }

    /// Switches it on or off.
    pub fn settle(&mut self, is_on: bool) {
        self.is_on = is_on;
    }

    /// Switches it off.
    pub fn reset(&mut self) {
        self.settle(false);
    }
}
