//! Blocks for controllers: PID, filters, limits, lookup tables, state space, Kalman filter and signals, each with its
//! equation and its source.
//!
//! They run on a microcontroller as well as in an FMU: `no_std`, without allocation, and with the same bits on every
//! platform, because functions such as the sine are those of `libm`.
//!
//! | block | what it does |
//! |---|---|
//! | [`Pid`] | PID controller with filtered derivative, set-point weights, anti-windup and bumpless transfer |
//! | [`FirstOrder`], [`SecondOrder`], [`HighPass`], [`LeadLag`] | filters of continuous time, by Tustin's rule |
//! | [`MovingAverage`] | mean of the last samples |
//! | [`Saturation`], [`RateLimiter`], [`DeadZone`], [`Hysteresis`] | nonlinear characteristics |
//! | [`Table1`], [`Table2`] | lookup tables, also from CSV files |
//! | [`StateSpace`], [`Kalman`] | systems and observers with matrices |
//! | [`Step`], [`Ramp`], [`Sine`], [`Square`], [`Chirp`], [`Prbs`] | signals as functions of time |
//!
//! All blocks are used alike:
//!
//! - Parameters are public fields, which may change at any time. `Default` has the start values of FMUs. The last fields
//!   of a block are its state.
//! - `update(input, dt)` advances the block by the step `dt` (s), positive, and returns the output. `dt` is missing where
//!   only the order of samples matters, and blocks without memory have `value(input)` instead; signals have
//!   `value(time)`.
//! - Blocks start at rest, as if all inputs had been 0. `reset()` starts anew, and `settle(...)` starts from another
//!   point, for example from the present input to avoid a transient. Both leave the parameters.
//!
//! ```
//! use control_blocks::{FirstOrder, Pid, RateLimiter};
//!
//! let mut ramp = RateLimiter { rising: 0.5, ..RateLimiter::default() };
//! let mut noise_filter = FirstOrder { time_constant: 0.02, ..FirstOrder::default() };
//! let mut pid = Pid { kp: 4.0, ki: 2.0, u_min: -10.0, u_max: 10.0, ..Pid::default() };
//! let dt = 0.01;
//! let mut y = 0.0;
//! for _ in 0..2000 {
//!     let u = pid.update(ramp.update(1.0, dt), noise_filter.update(y, dt), dt);
//!     y += dt * (u - y); // the plant
//! }
//! assert!((y - 1.0).abs() < 1e-3);
//! ```
//!
//! # Features
//!
//! - `fmi`: each block derives `Variables`, so that a model includes it by `#[nested]`: its parameters become parameters
//!   of the FMU, and its state is saved with the state of the FMU.
//! - `serde`: each block can be saved, so that it can also be a field of a model without attribute, whose parameters
//!   are no variables of the FMU.
//! - `std` (default): calibration files.
//! - `matrices` (default): [`StateSpace`] and [`Kalman`], for which `nalgebra` is compiled.
//!
//! # Other crates
//!
//! Matrices are those of `nalgebra`, whose matrices of fixed size use no fused multiply-add on any platform. Crates such
//! as `biquad`, `idsp`, `minikalman`, `pid` and `ndarray-interp` have good blocks, too, and are recommended for what is
//! missing here, for example other filters. They are not used here because their parameters would not be variables of
//! an FMU, their states could not be saved, or they assume a constant sample time; `pid` has neither filter,
//! back-calculation nor bumpless transfer. No reader of CDFX or DCM files on crates.io was found to be maintained.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "std")]
extern crate std;

#[cfg(feature = "serde")]
mod arrays;
#[cfg(feature = "std")]
mod calibration;
mod filter;
#[cfg(feature = "matrices")]
mod kalman;
mod limits;
mod moving_average;
mod pid;
mod source;
#[cfg(feature = "matrices")]
mod state_space;
mod table;

#[cfg(feature = "std")]
pub use calibration::CalibrationError;
pub use filter::{FirstOrder, HighPass, LeadLag, SecondOrder};
#[cfg(feature = "matrices")]
pub use kalman::{Kalman, NotPositiveDefinite};
pub use limits::{DeadZone, Hysteresis, RateLimiter, Saturation};
pub use moving_average::MovingAverage;
pub use pid::Pid;
pub use source::{Chirp, Prbs, Ramp, Sine, Square, Step};
#[cfg(feature = "matrices")]
pub use state_space::StateSpace;
pub use table::{AxisError, Extrapolation, Table1, Table2};

/// The value within the limits; the upper one if they contradict each other. NaN stays NaN.
fn clip(value: f64, lower: f64, upper: f64) -> f64 {
    // Not `f64::clamp`, which panics if the limits contradict each other.
    let value = if value < lower { lower } else { value };
    if value > upper { upper } else { value }
}
