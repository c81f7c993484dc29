//! The inputs that all controllers share.

use fmu_export::prelude::*;

/// The inputs of a controller.
#[derive(Clone, Copy, Variables)]
pub struct Signals {
    /// Set-point of the angle
    #[input(unit = "rad", terminal = "reference.r")]
    pub r: f64,
    /// Measured angle
    #[input(unit = "rad", terminal = "loop.y")]
    pub y: f64,
    /// Disturbance, added to the measured angle
    #[input(unit = "rad", terminal = "reference.d")]
    pub d: f64,
}
