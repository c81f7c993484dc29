//! Signals as functions of time, for set-points, disturbances and identification.
//!
//! At a jump, signals have the value after it. Times within 1e-9 s count as the same, so that rounding of the time
//! cannot move a jump by a sample.

use core::f64::consts::TAU;

/// How far from a jump (s) times count as the jump.
fn tolerance(time: f64) -> f64 {
    1e-9 + 4.0 * f64::EPSILON * time.abs()
}

/// Step: `offset`, and from `start_time` on `offset + amplitude`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Step {
    /// Height of the step.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub amplitude: f64,
    /// Value before the step.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub offset: f64,
    /// Time of the step (s).
    #[cfg_attr(feature = "fmi", parameter(tunable, unit = "s"))]
    pub start_time: f64,
}

impl Default for Step {
    fn default() -> Self {
        Self { amplitude: 1.0, offset: 0.0, start_time: 0.0 }
    }
}

impl Step {
    /// The value at `time` (s).
    pub fn value(&self, time: f64) -> f64 {
        match time + tolerance(time) >= self.start_time {
            true => self.offset + self.amplitude,
            false => self.offset,
        }
    }
}

/// Ramp: `offset`, and from `start_time` on a change by `amplitude` within `duration`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Ramp {
    /// Change from the start to the end of the ramp.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub amplitude: f64,
    /// Value before the ramp.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub offset: f64,
    /// Start of the ramp (s).
    #[cfg_attr(feature = "fmi", parameter(tunable, unit = "s"))]
    pub start_time: f64,
    /// Duration of the ramp (s), positive.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 1e-9, unit = "s"))]
    pub duration: f64,
}

impl Default for Ramp {
    fn default() -> Self {
        Self { amplitude: 1.0, offset: 0.0, start_time: 0.0, duration: 1.0 }
    }
}

impl Ramp {
    /// The value at `time` (s).
    pub fn value(&self, time: f64) -> f64 {
        let part = crate::clip((time - self.start_time) / self.duration, 0.0, 1.0);
        self.offset + self.amplitude * part
    }
}

/// Sine: `offset + amplitude sin(2 pi frequency time + phase)`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Sine {
    /// Amplitude.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub amplitude: f64,
    /// Mean.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub offset: f64,
    /// Frequency (Hz).
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0, unit = "Hz"))]
    pub frequency: f64,
    /// Phase at the time 0 (rad).
    #[cfg_attr(feature = "fmi", parameter(tunable, unit = "rad"))]
    pub phase: f64,
}

impl Default for Sine {
    fn default() -> Self {
        Self { amplitude: 1.0, offset: 0.0, frequency: 1.0, phase: 0.0 }
    }
}

impl Sine {
    /// The value at `time` (s).
    pub fn value(&self, time: f64) -> f64 {
        self.offset + self.amplitude * libm::sin(TAU * self.frequency * time + self.phase)
    }
}

/// Square wave: `offset + amplitude` in the first part `duty` of each period from the time 0 on, then
/// `offset - amplitude`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Square {
    /// Amplitude.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub amplitude: f64,
    /// Middle between both values.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub offset: f64,
    /// Frequency (Hz).
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, min = 0, unit = "Hz"))]
    pub frequency: f64,
    /// Part of the period with the greater value.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 0.5, min = 0, max = 1, unit = "1"))]
    pub duty: f64,
}

impl Default for Square {
    fn default() -> Self {
        Self { amplitude: 1.0, offset: 0.0, frequency: 1.0, duty: 0.5 }
    }
}

impl Square {
    /// The value at `time` (s).
    pub fn value(&self, time: f64) -> f64 {
        let periods = self.frequency * (time + tolerance(time));
        match periods - libm::floor(periods) < self.duty {
            true => self.offset + self.amplitude,
            false => self.offset - self.amplitude,
        }
    }
}

/// Chirp: a sine whose frequency sweeps from `start_frequency` at the time 0 to `end_frequency` at `duration`, and
/// stays there.
///
/// ```text
/// y = offset + amplitude sin(phase(t)),   phase' = 2 pi f(t)
/// linear:      f = f0 + (f1 - f0) t/T,  phase = 2 pi (f0 t + (f1 - f0) t^2/(2 T))
/// logarithmic: f = f0 (f1/f0)^(t/T),    phase = 2 pi f0 T ((f1/f0)^(t/T) - 1)/ln(f1/f0)
/// ```
///
/// L. Ljung, *System Identification* (2nd ed., Prentice Hall, 1999), chapter 13. The phases are those of
/// `scipy.signal.chirp`, whose cosine becomes a sine by `phi=-90`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Chirp {
    /// Amplitude.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub amplitude: f64,
    /// Mean.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub offset: f64,
    /// Frequency at the time 0 (Hz), positive.
    #[cfg_attr(feature = "fmi", parameter(start = 0.1, min = 1e-9, unit = "Hz"))]
    pub start_frequency: f64,
    /// Frequency at the end of the sweep (Hz), positive.
    #[cfg_attr(feature = "fmi", parameter(start = 10, min = 1e-9, unit = "Hz"))]
    pub end_frequency: f64,
    /// Duration of the sweep (s), positive.
    #[cfg_attr(feature = "fmi", parameter(start = 10, min = 1e-9, unit = "s"))]
    pub duration: f64,
    /// Whether equal times have equal ratios of frequencies, otherwise equal differences.
    #[cfg_attr(feature = "fmi", parameter)]
    pub logarithmic: bool,
}

impl Default for Chirp {
    fn default() -> Self {
        Self {
            amplitude: 1.0,
            offset: 0.0,
            start_frequency: 0.1,
            end_frequency: 10.0,
            duration: 10.0,
            logarithmic: false,
        }
    }
}

impl Chirp {
    /// The value at `time` (s).
    pub fn value(&self, time: f64) -> f64 {
        let (f0, f1, duration) = (self.start_frequency, self.end_frequency, self.duration);
        let swept = if time < duration { time } else { duration };
        let periods = match self.logarithmic && f0 != f1 {
            true => {
                let ratio = libm::log(f1 / f0);
                f0 * duration * libm::expm1(ratio * (swept / duration)) / ratio
            }
            false => f0 * swept + (f1 - f0) * swept * swept / (2.0 * duration),
        };
        let phase = TAU * (periods + f1 * (time - swept));
        self.offset + self.amplitude * libm::sin(phase)
    }
}

/// Taps of shift registers that give sequences of maximum length, for each order from 2.
///
/// L. Ljung, *System Identification* (2nd ed., Prentice Hall, 1999), chapter 13; those of `scipy.signal.max_len_seq`.
const TAPS: [&[u32]; 19] = [
    &[1],
    &[2],
    &[3],
    &[3],
    &[5],
    &[6],
    &[7, 6, 1],
    &[5],
    &[7],
    &[9],
    &[11, 10, 4],
    &[12, 11, 8],
    &[13, 12, 2],
    &[14],
    &[15, 13, 4],
    &[14],
    &[11],
    &[18, 17, 14],
    &[17],
];

/// Pseudo-random binary sequence of maximum length: `offset + amplitude` or `offset - amplitude`, with a new bit every
/// `bit_time`.
///
/// The sequence repeats after 2^order - 1 bits and is, over this period, almost white noise: S. W. Golomb, *Shift
/// Register Sequences* (Holden-Day, 1967). With the seed 0, it is `scipy.signal.max_len_seq(order)`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Prbs {
    /// Amplitude.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub amplitude: f64,
    /// Middle between both values.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub offset: f64,
    /// Time of a bit (s), positive.
    #[cfg_attr(feature = "fmi", parameter(start = 0.1, min = 1e-6, unit = "s"))]
    pub bit_time: f64,
    /// Length of the shift register, from 2 to 20.
    #[cfg_attr(feature = "fmi", parameter(start = 7, min = 2, max = 20))]
    pub order: i32,
    /// Initial content of the shift register; 0 for ones.
    #[cfg_attr(feature = "fmi", parameter(min = 0))]
    pub seed: i32,
    /// State: the shift register; 0 before the first value.
    pub register: u32,
    /// State: the number of the bit that the register shows.
    pub bit: u64,
}

impl Default for Prbs {
    fn default() -> Self {
        let (amplitude, offset, bit_time) = (1.0, 0.0, 0.1);
        Self { amplitude, offset, bit_time, order: 7, seed: 0, register: 0, bit: 0 }
    }
}

impl Prbs {
    /// The value at `time` (s), which must not decrease from call to call.
    pub fn value(&mut self, time: f64) -> f64 {
        let order = self.order.clamp(2, 20) as u32;
        let ones = (1_u32 << order) - 1;
        if self.register == 0 {
            let seed = self.seed.cast_unsigned() & ones;
            (self.register, self.bit) = (if seed == 0 { ones } else { seed }, 0);
        }
        // A negative time is bit 0.
        let bit = libm::floor((time + tolerance(time)) / self.bit_time) as u64;
        for _ in 0..bit.saturating_sub(self.bit) % u64::from(ones) {
            let taps = TAPS[order as usize - 2].iter();
            let feedback = taps.fold(self.register, |sum, tap| sum ^ (self.register >> tap)) & 1;
            self.register = (self.register >> 1) | (feedback << (order - 1));
        }
        self.bit = self.bit.max(bit);
        match self.register & 1 {
            1 => self.offset + self.amplitude,
            _ => self.offset - self.amplitude,
        }
    }

    /// Starts the sequence anew.
    pub fn reset(&mut self) {
        (self.register, self.bit) = (0, 0);
    }
}
