//! Models whose descriptions are under test.
#![allow(dead_code, reason = "only the tables are under test")]

use fmu_export::prelude::*;

macro_rules! does_nothing {
    ($($model:ty)*) => {
        $(
            impl Simulate for $model {
                fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
                    Ok(())
                }
            }
        )*
    };
}
does_nothing!(Reservoir Sizes Lists Fan Twins);

/// A tank with two valves
#[derive(Model)]
#[model(name = "Tank", stop_time = 60, step_size = 0.5, tolerance = 1e-6, sample_time = self.ts)]
pub struct Reservoir {
    /// inflow & leakage
    #[input(unit = "m3/s", start = 0.25, min = 0, derivative = self.slope)]
    inflow: f64,
    slope: f64,
    /// openings of the valves
    #[input(start = [[10, 20]], max = 100, unit = "%", terminal = "pipe.opening")]
    opening: [[f64; 2]; 1],
    /// flow through the valves
    #[output(
        unit = "m3/s",
        initially_from("opening", "pump.head"),
        derivative_by(inflow = 1.0),
        terminal = "pipe.flow"
    )]
    flow: f64,
    /// flow through each valve
    #[output(name = "valve.flow", unit = "m3/s", initially_from("opening"))]
    flows: [[f64; 2]; 1],
    #[nested]
    pump: Pump,
    #[nested(prefix = "spare.pump")]
    spare: Pump,
    /// sample time
    #[parameter(start = 0.5, unit = "s")]
    ts: f64,
    /// levels that count as full
    #[constant(start = [3, -3])]
    levels: [i32; 2],
    /// number of overflows
    #[local]
    overflows: i32,
    /// level of a float
    #[local(unit = "mm")]
    level: f64,
}

/// A pump.
#[derive(Variables)]
pub struct Pump {
    /// its head
    #[parameter(tunable, start = -1.5, unit = "m")]
    head: f64,
    /// speed
    #[parameter(start = 2, min = 1, max = 4)]
    speed: i32,
    /// which file has its curve
    #[parameter(start = "a < b & c.csv")]
    curve: String,
    /// whether it runs
    #[input(start = true)]
    on: bool,
    /// how it is controlled
    #[output(initially_from("head"))]
    mode: Mode,
}

/// How a pump is "controlled"
#[derive(Clone, Copy, Choice)]
#[choice(name = "PumpMode")]
pub enum Mode {
    /// by hand
    ByHand = -1,
    /// by level
    #[choice(name = "level")]
    Level = 7,
}

/// A mass on a spring that can hit a wall
#[derive(Model)]
#[model(continuous)]
pub struct Spring {
    /// force
    #[input(unit = "N", nominal = 50, terminal = "mass.f")]
    f: f64,
    #[nested]
    mass: Mass,
    /// power of the force
    #[output(unit = "W", derivative_by(f = self.mass.v), start = 1e-9)]
    power: f64,
    /// number of hits
    #[output]
    hits: i32,
}

/// A mass: two states in another order than their derivatives.
#[derive(Variables)]
pub struct Mass {
    /// speed
    #[local(state, unit = "m/s")]
    v: f64,
    #[derivative(of = x, unit = "m/s", derivative_by(v = 1.0))]
    der_x: f64,
    /// position
    #[output(state, nominal = 0.001, unit = "m", start = 0.5)]
    x: f64,
    #[derivative(of = v, unit = "m/s2", derivative_by(x = -1.0, v = -0.1))]
    der_v: f64,
    /// angles
    #[local(state, unit = "rad", start = [0.1, 0.2])]
    angles: [f64; 2],
    #[derivative(of = angles, unit = "rad/s")]
    rates: [f64; 2],
    /// distance to the wall
    #[event_indicator(unit = "degC")]
    gap: f64,
}

impl Continuous for Spring {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// One variable of each size
#[derive(Model)]
pub struct Sizes {
    /// single precision
    #[input(start = 0.1, min = 0, max = 0.7, unit = "N")]
    single: f32,
    /// signed bytes
    #[parameter(start = [[-128, 127]])]
    signed: [[i8; 2]; 1],
    /// unsigned words
    #[input(max = 500)]
    unsigned: [u16; 2],
    /// the largest number
    #[parameter(start = u64::MAX)]
    largest: u64,
    /// the smallest number
    #[parameter(start = -9223372036854775808, max = -1)]
    smallest: i64,
    /// a picture
    #[parameter(start = b"\x00\xff", mime_type = "image/png")]
    picture: Vec<u8>,
    /// packets
    #[input(start = [b"a", b"bc"])]
    packets: [Vec<u8>; 2],
    /// sum
    #[output(initially_from("smallest", "picture"))]
    sum: f32,
}

/// Two arrays of variable size
#[derive(Model)]
pub struct Lists {
    /// offset
    #[input]
    offset: f64,
    #[nested]
    net: Net,
    /// sum
    #[output(initially_from("offset"))]
    sum: f64,
}

#[derive(Variables)]
pub struct Net {
    /// number of nodes
    #[structural_parameter(start = 2, min = 1, max = 3, tunable)]
    nodes: u64,
    /// weights
    #[parameter(start = [1, 2, 3], size = nodes)]
    w: [f64; 3],
    /// names
    #[parameter(size = "nodes", start = ["a", "b", "c"])]
    names: [String; 3],
    /// levels
    #[output(size = "nodes", initially_from("w", "nodes"))]
    levels: [f64; 3],
}

/// Two gauges whose connection cannot be saved, with a log
#[derive(Model)]
pub struct Gauges {
    #[nested]
    gauge: [Gauge; 2],
    #[log]
    log: Log,
}

/// Structs can be written by macros, which pass types and values in groups.
macro_rules! gauge {
    ($name:ident, $of:ty, $start:expr) => {
        #[derive(Variables)]
        struct $name {
            /// levels
            #[output(unit = "m", start = $start)]
            levels: $of,
            #[unsaved]
            connection: Option<std::fs::File>,
        }
    };
}
gauge!(Gauge, [[f64; 2]; 1], [[1, 2]]);

impl Simulate for Gauges {
    fn step(&mut self, time: f64, _step: f64) -> Result<(), ModelError> {
        self.gauge[1].levels[0][1] = time;
        Ok(())
    }
}

/// A fan whose values are displayed in units of one's choice
#[derive(Model)]
pub struct Fan {
    /// speed of the motor
    #[output(unit = "rad/s", display = "rpm")]
    motor: f64,
    /// speed of the wheel, in the customary unit
    #[output(unit = "rad/s")]
    wheel: f64,
    /// temperatures
    #[output(unit = "K", display = "degC", start = [300, 310])]
    temperatures: [f64; 2],
    /// angle, in its own unit
    #[output(unit = "rad", display = "rad")]
    angle: f64,
}

/// A model whose variables have other names than before
#[derive(Model)]
#[model(continuous)]
pub struct Renamed {
    /// force
    #[input(unit = "N", alias = "u", start = 1)]
    force: f64,
    #[nested]
    mass: RenamedMass,
    /// power
    #[output(unit = "W", alias("p_out", "P"))]
    power: f64,
    /// gains
    #[parameter(tunable, alias = "k", start = [2, 3])]
    gains: [f64; 2],
    /// number of gears
    #[parameter(start = 4, deprecated = "use gains")]
    gears: i32,
    /// number of poles
    #[constant(start = 2, alias = "p")]
    #[deprecated(since = "2.0.0", note = "it is always 2")]
    poles: i32,
}

#[derive(Variables)]
pub struct RenamedMass {
    /// position
    #[output(state, unit = "m", start = 0.5, alias = "s")]
    x: f64,
    #[derivative(of = x, unit = "m/s", derivative_by(x = -1.0))]
    der_x: f64,
}

impl Continuous for Renamed {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Two names that are equal without their structure
#[derive(Model)]
#[model(naming = "flat")]
pub struct Twins {
    /// gain
    #[parameter(name = "pid.kp")]
    nested: f64,
    /// gains
    #[parameter(name = "pid_w")]
    gains: [f64; 2],
    /// another gain
    #[parameter(name = "pid.w_2")]
    other: f64,
}

/// Has a log category of its own, and a field that cannot be serialized
#[derive(Model)]
pub struct Sensor {
    /// measured value
    #[output]
    y: f64,
    /// values that are limited
    #[log(category = "sensor.limits")]
    limits: Log,
    #[copied]
    device: Device,
}

#[derive(Clone, Default)]
struct Device;

impl Simulate for Sensor {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        let Device = self.device;
        self.limits.info(self.y);
        Ok(())
    }
}
