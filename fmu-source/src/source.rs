//! A step, sine or square wave as the set-point, and a pulse as the disturbance.

use fmu_export::unit::{HERTZ, RADIAN, SECOND};
use fmu_export::{Enumeration, Model, ModelError, Variable, finite};
use pendulum_control::signal;
use serde::{Deserialize, Serialize};

/// Set-point `r` and disturbance `d` at the current communication point.
#[derive(Default, Clone, Serialize, Deserialize)]
pub struct Source {
    r: f64,
    d: f64,
    signal: i32,
    amplitude: f64,
    frequency: f64,
    disturbance: Pulse,
}

#[derive(Default, Clone, Serialize, Deserialize)]
struct Pulse {
    amplitude: f64,
    start: f64,
    duration: f64,
}

const STEP: i32 = 1;
const SINE: i32 = 2;
const SIGNAL: Enumeration = Enumeration {
    name: "Signal",
    description: "Form of the set-point",
    items: &[
        ("step", "the amplitude, from the start on"),
        ("sine", "amplitude sin(2 pi frequency t)"),
        (
            "square",
            "amplitude sign(sin(2 pi frequency t)), 0 at t = 0",
        ),
    ],
};

type Row = Variable<Source>;

impl Source {
    fn update(&mut self, time: f64) {
        let form = match self.signal {
            STEP => 1.0,
            SINE => signal::sine(self.frequency, time),
            _ => signal::square(self.frequency, time),
        };
        let pulse = &self.disturbance;
        self.r = self.amplitude * form;
        self.d = pulse.amplitude * signal::pulse(pulse.start, pulse.duration, time);
    }
}

impl Model for Source {
    const NAME: &'static str = "Source";
    const DESCRIPTION: &'static str =
        "Set-point of the angle, and a pulse that disturbs its measurement";
    const VARIABLES: &'static [Row] = &[
        Row::output("r", |m| &mut m.r)
            .unit(RADIAN)
            .initially_from(&["signal", "amplitude", "frequency"])
            .about("set-point of the angle"),
        Row::output("d", |m| &mut m.d)
            .unit(RADIAN)
            .discrete()
            .initially_from(&[
                "disturbance.amplitude",
                "disturbance.start",
                "disturbance.duration",
            ])
            .about("disturbance of the measured angle"),
        Row::choice("signal", &SIGNAL, STEP, |m| &mut m.signal).about("form of the set-point"),
        Row::fixed("amplitude", 1.0, |m| &mut m.amplitude)
            .unit(RADIAN)
            .at_least(-1e9)
            .at_most(1e9)
            .about("amplitude of the set-point"),
        Row::fixed("frequency", 0.2, |m| &mut m.frequency)
            .unit(HERTZ)
            .at_least(0.0)
            .at_most(1e6)
            .about("frequency of sine and square wave"),
        Row::fixed("disturbance.amplitude", 0.0, |m| {
            &mut m.disturbance.amplitude
        })
        .unit(RADIAN)
        .at_least(-1e9)
        .at_most(1e9)
        .about("height of the disturbance"),
        Row::fixed("disturbance.start", 5.0, |m| &mut m.disturbance.start)
            .unit(SECOND)
            .at_least(-1e9)
            .at_most(1e9)
            .about("time at which the disturbance comes"),
        Row::fixed("disturbance.duration", 0.5, |m| &mut m.disturbance.duration)
            .unit(SECOND)
            .at_least(0.0)
            .at_most(1e9)
            .about("how long the disturbance lasts"),
    ];

    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        self.update(start_time);
        finite!("r": self.r, "d": self.d)
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        self.update(time + step);
        finite!("r": self.r, "d": self.d)
    }
}
