//! Linear filters of continuous time, discretized by Tustin's rule.
//!
//! Tustin's rule replaces s by (z - 1) / (h (z + 1)), where h is half the step `dt`: it integrates by trapezoids. The
//! filters keep the values of the last step as their state, so that steps of different length and changes of parameters
//! cause no jump. With a constant step, the sequences are those of `scipy.signal.cont2discrete(..., method="bilinear")`.
//!
//! The response at a frequency w is that of the continuous filter at tan(w h)/h. For `prewarp` > 0, h is
//! tan(prewarp dt/2)/prewarp, and the responses at this frequency are equal. Source: G. F. Franklin, J. D. Powell and
//! M. Workman, *Digital Control of Dynamic Systems* (3rd ed., Addison-Wesley, 1998), chapter 6.

use core::f64::consts::PI;

/// Half the step, prewarped. A frequency that no samples can show, from the Nyquist frequency on, counts as 0.
fn half_step(dt: f64, prewarp: f64) -> f64 {
    let half_angle = prewarp * dt / 2.0;
    match half_angle > 0.0 && half_angle < PI / 2.0 {
        true => libm::tan(half_angle) / prewarp,
        false => dt / 2.0,
    }
}

/// First-order low-pass filter: `gain / (1 + time_constant s)`.
///
/// For time constants below half a step, the output overshoots; for the time constant 0, it is `gain` times the input.
///
/// ```
/// use control_blocks::FirstOrder;
///
/// let mut filter = FirstOrder { time_constant: 0.5, ..FirstOrder::default() };
/// let step_response = (0..500).map(|_| filter.update(1.0, 0.01)).last().unwrap();
/// assert!((step_response - 1.0).abs() < 1e-4);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct FirstOrder {
    /// Gain at the frequency 0.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub gain: f64,
    /// Time constant (s).
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0, unit = "s"))]
    pub time_constant: f64,
    /// Frequency of an exact response (rad/s); 0 for none.
    #[cfg_attr(feature = "fmi", parameter(tunable, min = 0, unit = "rad/s"))]
    pub prewarp: f64,
    /// State: the input.
    pub u: f64,
    /// State: the output.
    pub y: f64,
}

impl Default for FirstOrder {
    fn default() -> Self {
        Self { gain: 1.0, time_constant: 1.0, prewarp: 0.0, u: 0.0, y: 0.0 }
    }
}

impl FirstOrder {
    /// The output after a step of `dt` (s).
    pub fn update(&mut self, u: f64, dt: f64) -> f64 {
        let (h, t) = (half_step(dt, self.prewarp), self.time_constant);
        self.y = match t {
            0.0 => self.gain * u,
            _ => ((t - h) * self.y + self.gain * h * (u + self.u)) / (t + h),
        };
        self.u = u;
        self.y
    }

    /// Is at rest with the constant input `u`.
    pub fn settle(&mut self, u: f64) {
        (self.u, self.y) = (u, self.gain * u);
    }

    /// Is at rest with the input 0.
    pub fn reset(&mut self) {
        self.settle(0.0);
    }
}

/// First-order high-pass filter (washout): `gain time_constant s / (1 + time_constant s)`.
///
/// With `gain` 1/`time_constant`, it is a filtered derivative. It starts at rest with the input 0;
/// [`settle`](Self::settle) makes it start at another.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct HighPass {
    /// Gain at high frequencies.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub gain: f64,
    /// Time constant (s).
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0, unit = "s"))]
    pub time_constant: f64,
    /// Frequency of an exact response (rad/s); 0 for none.
    #[cfg_attr(feature = "fmi", parameter(tunable, min = 0, unit = "rad/s"))]
    pub prewarp: f64,
    /// State: the input.
    pub u: f64,
    /// State: the output.
    pub y: f64,
}

impl Default for HighPass {
    fn default() -> Self {
        Self { gain: 1.0, time_constant: 1.0, prewarp: 0.0, u: 0.0, y: 0.0 }
    }
}

impl HighPass {
    /// The output after a step of `dt` (s).
    pub fn update(&mut self, u: f64, dt: f64) -> f64 {
        let (h, t) = (half_step(dt, self.prewarp), self.time_constant);
        self.y = match t {
            0.0 => 0.0,
            _ => ((t - h) * self.y + self.gain * t * (u - self.u)) / (t + h),
        };
        self.u = u;
        self.y
    }

    /// Is at rest with the constant input `u`.
    pub fn settle(&mut self, u: f64) {
        (self.u, self.y) = (u, 0.0);
    }

    /// Is at rest with the input 0.
    pub fn reset(&mut self) {
        self.settle(0.0);
    }
}

/// Second-order low-pass filter: `gain w^2 / (s^2 + 2 damping w s + w^2)` with the natural frequency w.
///
/// It is also the model of a mass with spring and damper.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct SecondOrder {
    /// Gain at the frequency 0.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub gain: f64,
    /// Natural frequency (rad/s).
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0, unit = "rad/s"))]
    pub natural_frequency: f64,
    /// Damping ratio: 0.7071 for the Butterworth filter.
    #[cfg_attr(
        feature = "fmi",
        parameter(tunable, start = core::f64::consts::FRAC_1_SQRT_2, min = 0, unit = "1")
    )]
    pub damping: f64,
    /// Frequency of an exact response (rad/s); 0 for none.
    #[cfg_attr(feature = "fmi", parameter(tunable, min = 0, unit = "rad/s"))]
    pub prewarp: f64,
    /// State: the input.
    pub u: f64,
    /// State: the output.
    pub y: f64,
    /// State: the derivative of the output.
    pub rate: f64,
}

impl Default for SecondOrder {
    fn default() -> Self {
        Self {
            gain: 1.0,
            natural_frequency: 1.0,
            damping: core::f64::consts::FRAC_1_SQRT_2,
            prewarp: 0.0,
            u: 0.0,
            y: 0.0,
            rate: 0.0,
        }
    }
}

impl SecondOrder {
    /// The output after a step of `dt` (s).
    pub fn update(&mut self, u: f64, dt: f64) -> f64 {
        // Trapezoids for y' = v and v' = w^2 (gain u - y) - 2 damping w v, solved for v at the end of the step.
        let (h, w) = (half_step(dt, self.prewarp), self.natural_frequency);
        let (stiffness, friction) = (w * w, 2.0 * self.damping * w);
        let (y, v) = (self.y, self.rate);
        let pull = stiffness * (self.gain * (self.u + u) - 2.0 * y - h * v) - friction * v;
        self.rate = (v + h * pull) / (1.0 + h * (friction + h * stiffness));
        self.y = y + h * (v + self.rate);
        self.u = u;
        self.y
    }

    /// Is at rest with the constant input `u`.
    pub fn settle(&mut self, u: f64) {
        (self.u, self.y, self.rate) = (u, self.gain * u, 0.0);
    }

    /// Is at rest with the input 0.
    pub fn reset(&mut self) {
        self.settle(0.0);
    }
}

/// Lead-lag compensator: `gain (1 + lead s) / (1 + lag s)`.
///
/// A lead (`lead` > `lag`) adds phase; `lead` = 0 leaves a first-order filter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct LeadLag {
    /// Gain at the frequency 0.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub gain: f64,
    /// Time constant of the zero (s).
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0, unit = "s"))]
    pub lead: f64,
    /// Time constant of the pole (s), positive.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 1e-9, unit = "s"))]
    pub lag: f64,
    /// Frequency of an exact response (rad/s); 0 for none.
    #[cfg_attr(feature = "fmi", parameter(tunable, min = 0, unit = "rad/s"))]
    pub prewarp: f64,
    /// State: the input.
    pub u: f64,
    /// State: the output.
    pub y: f64,
}

impl Default for LeadLag {
    fn default() -> Self {
        Self { gain: 1.0, lead: 1.0, lag: 1.0, prewarp: 0.0, u: 0.0, y: 0.0 }
    }
}

impl LeadLag {
    /// The output after a step of `dt` (s).
    pub fn update(&mut self, u: f64, dt: f64) -> f64 {
        let h = half_step(dt, self.prewarp);
        let input = self.lead * (u - self.u) + h * (u + self.u);
        self.y = ((self.lag - h) * self.y + self.gain * input) / (self.lag + h);
        self.u = u;
        self.y
    }

    /// Is at rest with the constant input `u`.
    pub fn settle(&mut self, u: f64) {
        (self.u, self.y) = (u, self.gain * u);
    }

    /// Is at rest with the input 0.
    pub fn reset(&mut self) {
        self.settle(0.0);
    }
}
