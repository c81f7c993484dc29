//! A step, sine or square wave as the set-point, and a pulse as the disturbance.

use fmu_export::prelude::*;
use pendulum_control::signal;

/// Set-point of the angle, and a pulse that disturbs its measurement
#[derive(Model)]
#[model(continuous, step = Self::step)]
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
    /// The time of the last event (s), after which square wave and pulse hold until the next. Without events, in
    /// co-simulation, they jump at any time.
    event: Option<f64>,
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
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        self.evaluate(time + step)
    }
}

impl Continuous for Source {
    fn evaluate(&mut self, time: f64) -> Result<(), ModelError> {
        let form = match (self.signal, self.event) {
            (Signal::Step, _) => 1.0,
            (Signal::Sine, _) => signal::sine(self.frequency, time),
            (Signal::Square, None) => signal::square(self.frequency, time),
            (Signal::Square, Some(event)) => signal::square_after(self.frequency, event),
        };
        let Pulse { amplitude, start, duration } = self.disturbance;
        self.r = self.amplitude * form;
        self.d = amplitude * signal::pulse(start, duration, self.event.unwrap_or(time));
        Ok(())
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        self.event = Some(time);
        Ok(())
    }

    fn next_event(&self, time: f64) -> Option<f64> {
        let Pulse { start, duration, .. } = self.disturbance;
        let jump = match self.signal {
            Signal::Square => signal::next_jump(self.frequency, time),
            _ => f64::INFINITY,
        };
        let jumps = [start, start + duration, jump].into_iter();
        Some(jumps.filter(|jump| *jump > time).fold(f64::INFINITY, f64::min))
    }
}
