//! A step, sine or square wave as the set-point, and a pulse as the disturbance.

use fmu_export::prelude::*;
use pendulum_control::signal;

/// Set-point of the angle, and a pulse that disturbs its measurement
#[derive(Model)]
pub struct Source {
    /// Set-point of the angle
    #[output(
        unit = "rad",
        initially_from("signal", "amplitude", "frequency"),
        terminal = "reference.r"
    )]
    r: f64,
    /// Disturbance of the measured angle
    #[output(
        unit = "rad",
        discrete,
        initially_from("disturbance.amplitude", "disturbance.start", "disturbance.duration"),
        terminal = "reference.d"
    )]
    d: f64,
    /// Form of the set-point
    #[parameter]
    signal: Signal,
    /// Amplitude of the set-point
    #[parameter(start = 1, min = -1e9, max = 1e9, unit = "rad")]
    amplitude: f64,
    /// Frequency of sine and square wave
    #[parameter(start = 0.2, min = 0, max = 1e6, unit = "Hz")]
    frequency: f64,
    #[nested]
    disturbance: Pulse,
}

/// Form of the set-point
#[derive(Clone, Copy, Choice)]
enum Signal {
    /// The amplitude, from the start on
    Step,
    /// Amplitude sin(2 pi frequency t)
    Sine,
    /// Amplitude sign(sin(2 pi frequency t)), 0 at t = 0
    Square,
}

#[derive(Variables)]
struct Pulse {
    /// Height of the disturbance
    #[parameter(min = -1e9, max = 1e9, unit = "rad")]
    amplitude: f64,
    /// Time at which the disturbance comes
    #[parameter(start = 5, min = -1e9, max = 1e9, unit = "s")]
    start: f64,
    /// How long the disturbance lasts
    #[parameter(start = 0.5, min = 0, max = 1e9, unit = "s")]
    duration: f64,
}

impl Source {
    fn update(&mut self, time: f64) {
        let form = match self.signal {
            Signal::Step => 1.0,
            Signal::Sine => signal::sine(self.frequency, time),
            Signal::Square => signal::square(self.frequency, time),
        };
        let pulse = &self.disturbance;
        self.r = self.amplitude * form;
        self.d = pulse.amplitude * signal::pulse(pulse.start, pulse.duration, time);
    }
}

impl Simulate for Source {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        self.update(start.time);
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        self.update(time + step);
        Ok(())
    }
}
