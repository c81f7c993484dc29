//! The models under test in one binary.

use std::cell::Cell;
use std::f64::consts::TAU;
use std::panic::panic_any;

use fmu_description::Type;
use fmu_export::prelude::*;

fmu_export::export!(
    Every, Sampled, Ball, Hopper, Valve, Device, Relay, Switches, Foreign, Noisy, Heir
);

// Indices of the models.
pub const EVERY: usize = 0;
pub const SAMPLED: usize = 1;
pub const BALL: usize = 2;
pub const HOPPER: usize = 3;
pub const VALVE: usize = 4;
pub const DEVICE: usize = 5;
pub const RELAY: usize = 6;
pub const SWITCHES: usize = 7;
pub const FOREIGN: usize = 8;
pub const NOISY: usize = 9;
pub const HEIR: usize = 10;

/// Defines a constant for each value reference, in order: of the first element of an array with so many.
macro_rules! references {
    ($($name:ident $(* $count:literal)?),*) => { references!(@ 0; $($name $(* $count)?),*); };
    (@ $next:expr; $name:ident $(* $count:literal)? $(, $($rest:tt)*)?) => {
        #[allow(dead_code, reason = "not every test needs all")]
        pub const $name: u32 = $next;
        references!(@ $next + 1 $(+ $count - 1)?; $($($rest)*)?);
    };
    (@ $next:expr;) => {
        /// The number of scalar variables; in FMI 3.0, the reference of the independent variable.
        #[allow(dead_code, reason = "as above")]
        pub const COUNT: u32 = $next;
    };
}

/// Every type and role, and failures on demand; see [`FACTS`]
#[derive(Model)]
#[rustfmt::skip]
pub struct Every {
    /** is integrated */ #[input(derivative = self.u_rate)] u: f64,
    u_rate: f64,
    /** is bounded */ #[input(min = -10, max = 10)] v: f64,
    /** how the step fails */ #[input(min = 0, max = BUG)] trouble: f64,
    /** of u */ #[parameter(start = 0x2, min = 0)] gain: f64,
    /** of y */ #[parameter(tunable, start = 1e6, min = 0)] limit: f64,
    /** vector */ #[input(min = -10, max = 10, unit = "kg")] vector: [f64; 3],
    /** matrix */ #[parameter(tunable, start = [[1, 2], [3, 6.5]])] matrix: [[f64; 2]; 2],
    /** fixed */ #[parameter(start = [1, 2])] weights: [f64; 2],
    /** f32 */ #[input(min = 0.1, max = 16777216, start = 0.3)] f32: f32,
    /** i8 */ #[input] i8: i8,
    /** u8 */ #[parameter(tunable, start = [1, 2])] u8: [u8; 2],
    /** i16 */ #[input(start = -1, min = -2)] i16: i16,
    /** u16 */ #[input] u16: u16,
    /** i32 */ #[input(start = size::<Option<bool>, 3>(), min = -5, max = 5)] i32: i32,
    /** u32 */ #[input] u32: u32,
    /** i64 */ #[input] i64: i64,
    /** u64 */ #[input(start = 4294967295)] u64: u64,
    /** whole number */ #[parameter(start = 1, min = 1, max = 4)] order: i32,
    /** truths */ #[parameter(tunable, start = [false, true])] flags: [bool; 2],
    /** whether y is limited */ #[parameter(start = true)] limited: bool,
    /** item */ #[parameter] law: Law,
    /** items */ #[input(start = [Law::Added, Law::Ignored])] laws: [Law; 2],
    /** text */ #[input(start = "12")] label: String,
    /** texts */ #[parameter(start = ["7", "8"])] names: [String; 2],
    /** bytes */ #[input(start = b"\x00\xff")] bytes: Vec<u8>,
    #[nested] part: Part,
    /** integral of u */ #[output(initially_from("weights"))] y: f64,
    /** weighted y */ #[output(unit = "N.m")] parts: [f64; 2],
    /** half of the f32 */ #[output] half: f32,
    /** large number */ #[output] long: i64,
    /** whether it is enabled */ #[output] done: bool,
    /** the number of steps as text */ #[output] report: String,
    /** the other item */ #[output] next: Law,
    /** sum of the last 40 values */ #[local] sum: f64,
    /** changes in steps only */ #[local(discrete)] label_length: i32,
    /** a number */ #[constant(start = TAU)] tau: f64,
    /** a text */ #[constant(start = "9")] version: String,
    ticks: u64,
    history: [f64; 40],
}

const fn size<T, const N: usize>() -> i32 {
    size_of::<[T; N]>() as i32
}

/// What the step does with v
#[derive(Clone, Copy, PartialEq, Choice)]
pub enum Law {
    /// y + v
    Added,
    /// y alone
    r#Ignored,
}

/// A nested struct
#[derive(Variables)]
#[rustfmt::skip]
pub struct Part {
    /** added to y */ #[input(start = 0.0)] bias: f64,
    /** multiplies the bias */ #[parameter(start = 0.5)] scale: f64,
    uses: u32,
}

references! {
    U, V, TROUBLE, GAIN, LIMIT, VECTOR * 3, MATRIX * 4, WEIGHTS * 2, F32, I8, U8 * 2, I16, U16, I32, U32, I64,
    U64, ORDER, FLAGS * 2, LIMITED, LAW, LAWS * 2, LABEL, NAMES * 2, BYTES, BIAS, SCALE, Y, PARTS * 2, HALF,
    LONG, DONE, REPORT, NEXT, SUM, LENGTH, TAU_OF, TEXT_OF
}

// Values of inputs that make a model fail: the step or the evaluation is refused, is discarded, breaks the
// instance, has infinite results, or panics.
pub const REFUSE: f64 = 1.0;
pub const DISCARD: f64 = 2.0;
pub const BREAK: f64 = 3.0;
pub const DIVERGE: f64 = 4.0;
pub const BUG: f64 = 5.0;

/// Fails as an input says; the first word says what.
pub fn fail(trouble: f64) -> Result<(), ModelError> {
    assert!(trouble != BUG, "the bug shows");
    match trouble {
        REFUSE => Err(ModelError::refuse("refused by the model")),
        DISCARD => Err(ModelError::discard("discarded by the model")),
        BREAK => Err(ModelError::new("broken by the model")),
        _ => Ok(()),
    }
}

impl Simulate for Every {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        fail(self.trouble)?;
        self.y = start.time;
        self.parts = [self.weights[0] * self.y, self.weights[1]];
        // Fresh at each initialization.
        self.ticks += 1;
        self.part.uses += 1;
        self.update();
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        fail(self.trouble)?;
        self.y += self.gain * step * (self.u + self.u_rate * step / 2.0);
        self.y += self.part.bias * self.part.scale;
        if self.law == Law::Added {
            self.y += self.v * step;
        }
        if self.limited {
            self.y = self.y.min(self.limit).max(-self.limit);
        }
        self.parts = [self.weights[0] * self.y, self.weights[1] * (time + step)];
        self.ticks += 1;
        self.update();
        Ok(())
    }
}

impl Every {
    /// The value of `limit` with which the destructor panics.
    pub const LAST_BUG: f64 = 1234.5;

    fn update(&mut self) {
        if self.trouble == DIVERGE {
            self.parts[1] = f64::INFINITY;
        }
        self.history[self.ticks as usize % 40] = self.y;
        self.sum = self.history.iter().sum();
        self.half = f32::from(self.u8[0]) / self.f32;
        self.long = -i64::from(self.i8) << 24;
        self.done = self.flags[1];
        self.report = (self.ticks + u64::from(self.part.uses)).to_string();
        self.next = match self.laws[0] {
            Law::Added => Law::Ignored,
            Law::Ignored => Law::Added,
        };
        self.label_length = self.label.len() as i32;
    }
}

impl Drop for Every {
    fn drop(&mut self) {
        if self.limit == Self::LAST_BUG {
            panic_any(Bomb);
        }
    }
}

/// What a panic can carry.
struct Bomb;

impl Drop for Bomb {
    fn drop(&mut self) {
        panic!("the bug shows at the end");
    }
}

/// When a host can set a variable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    Always,
    BeforeSteps,
    Output,
    Local,
    Constant,
}

/// The expected properties of a variable of [`Every`].
pub struct Fact {
    pub reference: u32,
    pub name: &'static str,
    pub of: Type,
    pub role: Role,
    /// Minimum and maximum.
    pub bounds: (f64, f64),
    /// The start values of all elements; of a String the number, of a Binary the length.
    pub start: &'static [f64],
}

/// The variables of [`Every`], defined independently of its table.
#[rustfmt::skip]
pub const FACTS: &[Fact] = {
    use {Role::*, Type::*};
    const ANY: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);
    const POSITIVE: (f64, f64) = (0.0, f64::INFINITY);
    const TEN: (f64, f64) = (-10.0, 10.0);
    const ITEM: (f64, f64) = (1.0, 2.0);
    const BIT: (f64, f64) = (0.0, 1.0);
    const fn fact(
        reference: u32, name: &'static str, of: Type, role: Role, bounds: (f64, f64), start: &'static [f64],
    ) -> Fact {
        Fact { reference, name, of, role, bounds, start }
    }
    &[
        fact(U, "u", Float64, Always, ANY, &[0.0]),
        fact(V, "v", Float64, Always, TEN, &[0.0]),
        fact(TROUBLE, "trouble", Float64, Always, (0.0, BUG), &[0.0]),
        fact(GAIN, "gain", Float64, BeforeSteps, POSITIVE, &[2.0]),
        fact(LIMIT, "limit", Float64, Always, POSITIVE, &[1e6]),
        fact(VECTOR, "vector", Float64, Always, TEN, &[0.0; 3]),
        fact(MATRIX, "matrix", Float64, Always, ANY, &[1.0, 2.0, 3.0, 6.5]),
        fact(WEIGHTS, "weights", Float64, BeforeSteps, ANY, &[1.0, 2.0]),
        fact(F32, "f32", Float32, Always, (0.1f32 as f64, 16777216.0), &[0.3f32 as f64]),
        fact(I8, "i8", Int8, Always, (-128.0, 127.0), &[0.0]),
        fact(U8, "u8", UInt8, Always, (0.0, 255.0), &[1.0, 2.0]),
        fact(I16, "i16", Int16, Always, (-2.0, 32767.0), &[-1.0]),
        fact(U16, "u16", UInt16, Always, (0.0, 65535.0), &[0.0]),
        fact(I32, "i32", Int32, Always, (-5.0, 5.0), &[3.0]),
        fact(U32, "u32", UInt32, Always, (0.0, 4294967295.0), &[0.0]),
        fact(I64, "i64", Int64, Always, ANY, &[0.0]),
        fact(U64, "u64", UInt64, Always, POSITIVE, &[4294967295.0]),
        fact(ORDER, "order", Int32, BeforeSteps, (1.0, 4.0), &[1.0]),
        fact(FLAGS, "flags", Boolean, Always, BIT, &[0.0, 1.0]),
        fact(LIMITED, "limited", Boolean, BeforeSteps, BIT, &[1.0]),
        fact(LAW, "law", Enumeration, BeforeSteps, ITEM, &[1.0]),
        fact(LAWS, "laws", Enumeration, Always, ITEM, &[1.0, 2.0]),
        fact(LABEL, "label", String, Always, ANY, &[12.0]),
        fact(NAMES, "names", String, BeforeSteps, ANY, &[7.0, 8.0]),
        fact(BYTES, "bytes", Binary, Always, ANY, &[2.0]),
        fact(BIAS, "part.bias", Float64, Always, ANY, &[0.0]),
        fact(SCALE, "part.scale", Float64, BeforeSteps, ANY, &[0.5]),
        fact(Y, "y", Float64, Output, ANY, &[0.0]),
        fact(PARTS, "parts", Float64, Output, ANY, &[0.0, 2.0]),
        fact(HALF, "half", Float32, Output, ANY, &[(1.0 / 0.3f32) as f64]),
        fact(LONG, "long", Int64, Output, ANY, &[0.0]),
        fact(DONE, "done", Boolean, Output, BIT, &[1.0]),
        fact(REPORT, "report", String, Output, ANY, &[2.0]),
        fact(NEXT, "next", Enumeration, Output, ITEM, &[2.0]),
        fact(SUM, "sum", Float64, Local, ANY, &[0.0]),
        fact(LENGTH, "label_length", Int32, Local, ANY, &[2.0]),
        fact(TAU_OF, "tau", Float64, Constant, ANY, &[TAU]),
        fact(TEXT_OF, "version", String, Constant, ANY, &[9.0]),
    ]
};

impl Fact {
    /// Whether the host may set the variable; `is_running` after the initialization.
    pub fn is_settable(&self, is_running: bool) -> bool {
        self.role == Role::Always || self.role == Role::BeforeSteps && !is_running
    }

    /// A valid value other than the start value.
    pub fn other_value(&self) -> f64 {
        match self.bounds {
            (min, max) if max - min == 1.0 => min + max - self.start[0],
            _ if self.of == Type::Float64 => 0.125 * f64::from(1 + self.reference),
            _ => 4.0,
        }
    }
}

/// The number that a text of these tests stands for.
pub fn number(text: &str) -> f64 {
    text.parse().unwrap_or(f64::NAN)
}

/// Acts at its sample instants, fails in a chosen one, reads a resource, and has arrays whose sizes are set in
/// configuration mode
#[derive(Model)]
#[model(sample_time = self.ts, stop_time = 5, step_size = 0.01)]
#[rustfmt::skip]
pub struct Sampled {
    /** sample time */ #[parameter(start = 0.5, unit = "s")] ts: f64,
    /** number of the sample that fails */ #[parameter(tunable)] fails_at: i32,
    /** how it fails */ #[parameter(tunable)] failure: f64,
    /** times of the last samples */ #[output(unit = "s")] times: [f64; 3],
    /** number of samples */ #[output] count: i32,
    /** its inverse is an output */ #[input(start = 1)] u: f64,
    /** inverse of u */ #[output] y: f64,
    /** file in the resources, if any */ #[parameter] file: String,
    /** sum of its numbers */ #[output] sum: f64,
    /** number of gains */ #[structural_parameter(start = 2, min = 1, max = 3, tunable)] n: u64,
    /** number of names */ #[structural_parameter(start = 1, max = 2)] m: u64,
    /** gains */ #[input(size = "n", start = [1, 2, 4])] gains: [f64; 3],
    /** names */ #[parameter(size = "m", start = ["a", "b"])] names: [String; 2],
    /** sum of the gains */ #[output] gain: f64,
    /** how often the sizes changed */ #[output] changes: i32,
}

impl Sampled {
    references! {
        TS, FAILS_AT, FAILURE, TIMES * 3, SAMPLES, U, Y, FILE, SUM, N, M, GAINS * 3, NAMES * 2, GAIN, CHANGES
    }
    /// A number of gains with which the model cannot continue.
    pub const BAD: u64 = 1;
}

impl Simulate for Sampled {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        if !self.file.is_empty() {
            for line in start.read_resource(&self.file)?.lines() {
                self.sum += line.parse::<f64>()?;
            }
        }
        self.gain = self.gains.iter().take(self.n as usize).sum();
        Ok(())
    }

    fn step(&mut self, time: f64, _step: f64) -> Result<(), ModelError> {
        if self.count + 1 == self.fails_at {
            fail(self.failure)?;
        }
        self.count += 1;
        self.times = [self.times[1], self.times[2], time];
        self.y = 1.0 / self.u;
        self.gain = self.gains.iter().take(self.n as usize).sum();
        Ok(())
    }

    fn reconfigure(&mut self) -> Result<(), ModelError> {
        if self.n == Self::BAD {
            return Err(ModelError::refuse("one gain is not enough"));
        }
        self.changes += 1;
        Ok(())
    }
}

/// A ball that is driven, bounces, and gets a kick
#[derive(Model)]
#[model(continuous, step = Self::step, step_size = 0.1)]
#[rustfmt::skip]
pub struct Ball {
    /** acceleration by the drive */ #[input(derivative = self.drive_rate)] drive: f64,
    drive_rate: f64,
    /** how the equations and events fail */ #[input(min = 0, max = BUG)] trouble: f64,
    /** how steps after 0.15 s fail */ #[input(min = 0, max = BUG)] fault: f64,
    /** height */ #[output(state, nominal = 10, initially_from("h0"))] h: f64,
    /** velocity */ #[output(state)] v: f64,
    #[derivative(of = h, derivative_by(v = 1.0))] h_dot: f64,
    #[derivative(of = v, derivative_by(drive = 1.0, v = -2.0 * self.drag * self.v.abs()))] v_dot: f64,
    /** height of its lowest point */ #[output(derivative_by(h = 1))] contact: f64,
    /** energy */ #[output(derivative_by(h = Ball::G, v = self.v, drive = 0.125))] energy: f64,
    /** height at the start */ #[parameter(start = 1)] h0: f64,
    /// part of the velocity that a bounce keeps
    #[parameter(tunable, start = 0.5, min = 0, max = 1)] restitution: f64,
    /** drag */ #[parameter(start = 0)] drag: f64,
    /** number of events */ #[output] events: i32,
    /** a switch */ #[input] switch: i32,
    kicked: bool,
}

impl Ball {
    references! {
        DRIVE, TROUBLE, FAULT, H, V, H_DOT, V_DOT, CONTACT, ENERGY, H0, RESTITUTION, DRAG, EVENTS, SWITCH
    }
    /// The reference of the independent variable in FMI 3.0.
    pub const TIME: u32 = Self::COUNT;
    /// Acceleration by gravity (m/s2).
    pub const G: f64 = 9.75;
    /// Time of the kick (s).
    pub const KICK: f64 = 0.5;

    /// Exact without drag, but for h on a ramp; without events.
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if time > 0.15 {
            fail(self.fault)?;
        }
        let acceleration = self.drive + self.drive_rate * step / 2.0 - Self::G;
        self.h += (self.v + acceleration * step / 2.0) * step;
        self.v += acceleration * step;
        self.contact = self.h;
        self.energy = self.energy();
        Ok(())
    }

    fn energy(&self) -> f64 {
        Self::G * self.h + self.v * self.v / 2.0 + self.drive / 8.0
    }
}

thread_local! {
    /// How often the equations of [`Ball`] were evaluated.
    pub static EVALUATIONS: Cell<u32> = const { Cell::new(0) };
}

impl Continuous for Ball {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.h = self.h0;
        Ok(())
    }

    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        EVALUATIONS.set(EVALUATIONS.get() + 1);
        fail(self.trouble)?;
        self.h_dot = self.v;
        self.v_dot = self.drive - Self::G - self.drag * self.v * self.v.abs();
        self.contact = self.h;
        self.energy = self.energy();
        if self.trouble == DIVERGE {
            self.v_dot = f64::NAN;
        }
        Ok(())
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        fail(self.trouble)?;
        self.events += 1;
        if self.h <= 0.0 && self.v < 0.0 {
            self.v *= -self.restitution;
        }
        if time >= Self::KICK && !self.kicked {
            self.v += 1.0;
            self.kicked = true;
        }
        Ok(())
    }

    fn next_event(&self, _time: f64) -> Option<f64> {
        assert!(self.trouble != BUG, "the bug shows in the next event");
        Some(if self.kicked { f64::INFINITY } else { Self::KICK })
    }
}

/// A ball that bounces until it rests, and a lamp that switches; this crate integrates it
#[derive(Model)]
#[model(continuous, step_size = 0.1)]
#[rustfmt::skip]
pub struct Hopper {
    /** acceleration by the drive */ #[input] drive: f64,
    /** how the equations fail */ #[input(min = 0, max = BUG)] trouble: f64,
    /** from when on */ #[parameter(tunable)] trouble_time: f64,
    /** height */ #[output(state, start = 1, nominal = 0.5)] h: f64,
    /** velocity */ #[output(state)] v: f64,
    #[derivative(of = h)] h_dot: f64,
    #[derivative(of = v)] v_dot: f64,
    /** its lowest point, above the ground until it rests */ #[event_indicator] gap: f64,
    /// part of the velocity that a bounce keeps
    #[parameter(start = 0.5, min = 0, max = 1)] restitution: f64,
    /** drag */ #[parameter] drag: f64,
    /** velocity below which it rests */ #[parameter(start = 0.1)] slowest: f64,
    /** time between two changes of the lamp */ #[parameter(start = 0.3)] period: f64,
    /** whether it rests */ #[output] rests: bool,
    /** number of bounces */ #[output] bounces: i32,
    /** time of the last bounce */ #[output] bounced: f64,
    /** number of changes of the lamp */ #[output] changes: i32,
    /** time of the last change */ #[output] changed: f64,
    /** memory on the heap */ #[parameter(start = "text")] label: String,
    log: Vec<f64>,
}

impl Hopper {
    references! {
        DRIVE, TROUBLE, TROUBLE_TIME, H, V, H_DOT, V_DOT, GAP, RESTITUTION, DRAG, SLOWEST, PERIOD, RESTS,
        BOUNCES, BOUNCED, CHANGES, CHANGED, LABEL
    }
    /// Acceleration by gravity (m/s2).
    pub const G: f64 = 9.75;
}

impl Continuous for Hopper {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        self.changed = start.time;
        self.log = vec![0.0; 4];
        Ok(())
    }

    fn evaluate(&mut self, time: f64) -> Result<(), ModelError> {
        (self.h_dot, self.v_dot) = match self.rests {
            true => (0.0, 0.0),
            false => (self.v, self.drive - Self::G - self.drag * self.v * self.v.abs()),
        };
        self.gap = if self.rests { -1.0 } else { self.h };
        if time >= self.trouble_time {
            fail(self.trouble)?;
            if self.trouble == DIVERGE {
                self.v_dot = f64::NAN;
            }
        }
        Ok(())
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        if self.h <= 0.0 && self.v < 0.0 && !self.rests {
            (self.bounces, self.bounced) = (self.bounces + 1, time);
            self.v *= -self.restitution;
            self.rests = self.v < self.slowest;
            if self.rests {
                self.v = 0.0;
            }
            self.log[self.bounces as usize % 4] = time;
        }
        if time >= self.changed + self.period {
            (self.changes, self.changed) = (self.changes + 1, time);
        }
        Ok(())
    }

    fn next_event(&self, _time: f64) -> Option<f64> {
        Some(self.changed + self.period)
    }
}

/// Fills a tank until it is full; its own step handles this event
#[derive(Model)]
#[model(continuous, step = Self::step, step_size = 0.1)]
#[rustfmt::skip]
pub struct Valve {
    /** level */ #[output(state)] level: f64,
    #[derivative(of = r#level)] rate: f64,
    /** what is missing */ #[event_indicator] missing: f64,
    /** whether it is closed */ #[output] closed: bool,
}

impl Valve {
    references! { LEVEL, RATE, MISSING, CLOSED }

    fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
        self.level = (self.level + step).min(1.0);
        self.closed = self.level == 1.0;
        Ok(())
    }
}

impl Continuous for Valve {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        self.rate = if self.closed { 0.0 } else { 1.0 };
        self.missing = 1.0 - self.level;
        Ok(())
    }

    fn event(&mut self, _time: f64) -> Result<(), ModelError> {
        self.closed |= self.level >= 1.0;
        Ok(())
    }
}

/// Reads a device, whose connection cannot be saved, through two filters, and writes to the log
#[derive(Model)]
#[rustfmt::skip]
pub struct Device {
    /** what it writes */ #[parameter(tunable, max = 5)] level: i32,
    #[nested] filter: [Filter; 2],
    /** sum of the filters */ #[output] y: f64,
    #[log] log: Log,
    /** what exceeds its limits */ #[log(category = "limits")] limits: Log,
    #[unsaved] connection: Connection,
}

struct Connection(Option<f64>);

thread_local! {
    /// Whether [`Device`] panics when it is created.
    pub static IS_BROKEN: Cell<bool> = const { Cell::new(false) };
}

impl Default for Connection {
    fn default() -> Self {
        assert!(!IS_BROKEN.get(), "the bug shows at the start");
        Self(None)
    }
}

/// A filter of an input whose slope the host may provide
#[derive(Variables)]
#[rustfmt::skip]
pub struct Filter {
    /** input */ #[input(derivative = self.slope)] u: f64,
    /** weights */ #[parameter(start = [1, 2])] weight: [f64; 2],
    slope: f64,
}

impl Device {
    references! { LEVEL, U_1, WEIGHT_1 * 2, U_2, WEIGHT_2 * 2, Y }
}

impl Simulate for Device {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        self.connection = Connection(Some(start.time));
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        let Connection(Some(opened)) = self.connection else {
            return Err(ModelError::new("there is no connection"));
        };
        match self.level {
            1 => self.log.info(format_args!("opened at {opened}")),
            2 => self.log.warning(format_args!("read at {time}")),
            3 => self.log.error("lost"),
            4 => self.limits.info("close"),
            5 => self.limits.warning("exceeded"),
            _ => {}
        }
        let inputs = self.filter.iter().map(|f| f.weight[1] * (f.u + f.slope * step));
        self.y = inputs.sum();
        Ok(())
    }
}

/// Keeps a state within 0.25 of a level by a relay
#[derive(Model)]
#[model(continuous, step_size = 0.1)]
#[rustfmt::skip]
pub struct Relay {
    /** set-point */ #[input] pub level: f64,
    /** rises while it is on */ #[output(state)] x: f64,
    #[derivative(of = x)] rate: f64,
    /** what is beyond the threshold */ #[event_indicator] excess: f64,
    /** how often it has switched */ #[output] switches: i32,
    on: bool,
}

impl Relay {
    references! { LEVEL, X, RATE, EXCESS, SWITCHES }
}

impl Continuous for Relay {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        let side = if self.on { 1.0 } else { -1.0 };
        self.rate = side;
        self.excess = self.x - self.level - 0.25 * side;
        Ok(())
    }

    fn event(&mut self, _time: f64) -> Result<(), ModelError> {
        // Of the inputs that hold now.
        let switches = if self.on { self.excess >= 0.0 } else { self.excess <= 0.0 };
        if switches {
            self.on = !self.on;
            self.switches += 1;
        }
        Ok(())
    }
}

/// Counts the changes of what is not continuous, and moves while it is on
#[derive(Model)]
#[model(continuous, step_size = 0.1)]
#[rustfmt::skip]
pub struct Switches {
    /** moves it */ #[input] pub on: bool,
    /** whole number */ #[input] gear: i32,
    /** real number */ #[input(discrete)] w: f64,
    /** text */ #[input(start = "12")] text: String,
    /** item */ #[input] law: Law,
    /** velocity */ #[parameter(tunable, start = 2)] limit: f64,
    /** position */ #[output(state)] x: f64,
    #[derivative(of = x)] rate: f64,
    /** how often a value was new */ #[output] changes: i32,
    seen: Option<(bool, i32, f64, String, i32, f64)>,
}

impl Switches {
    references! { ON, GEAR, W, TEXT, LAW, LIMIT, X, RATE, CHANGES }
}

impl Continuous for Switches {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        let is_on = self.seen.as_ref().is_some_and(|seen| seen.0);
        self.rate = if is_on { self.limit } else { 0.0 };
        Ok(())
    }

    fn event(&mut self, _time: f64) -> Result<(), ModelError> {
        let text = self.text.clone();
        let now = (self.on, self.gear, self.w, text, self.law as i32, self.limit);
        let Some(seen) = self.seen.replace(now) else { return Ok(()) };
        if self.seen.as_ref() != Some(&seen) {
            self.changes += 1;
        }
        if self.on && !seen.0 {
            self.x = 10.0;
        }
        Ok(())
    }
}

/// Adds up its input by types without traits, of which it says how they are made and saved
#[derive(Model)]
#[rustfmt::skip]
pub struct Foreign {
    /** added */ #[input] u: f64,
    /** sum */ #[output] y: f64,
    #[saved(with = bare)] #[fresh(Bare::new(10.0))] sum: Bare,
    #[saved(with = "bare::pair")] #[fresh([Bare::new(1.0), Bare::new(2.0)])] pair: [Bare; 2],
}

/// A number in a type without traits.
pub struct Bare(f64);

impl Bare {
    const fn new(number: f64) -> Self {
        Self(number)
    }
}

mod bare {
    use super::Bare;

    pub fn save(bare: &Bare) -> f64 {
        bare.0
    }

    pub fn load(number: f64) -> Bare {
        Bare(number)
    }

    pub mod pair {
        use super::Bare;

        pub fn save(pair: &[Bare; 2]) -> (f64, f64) {
            (pair[0].0, pair[1].0)
        }

        pub fn load((first, second): (f64, f64)) -> [Bare; 2] {
            [Bare(first), Bare(second)]
        }
    }
}

impl Foreign {
    references! { U, Y }
}

impl Simulate for Foreign {
    fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
        self.sum.0 += self.u * step;
        self.pair[1].0 += 1.0;
        self.y = self.sum.0 + self.pair[0].0 * self.pair[1].0;
        Ok(())
    }
}

/// Counts by a type that can be copied, but not serialized
#[derive(Model)]
#[rustfmt::skip]
pub struct Noisy {
    /** number of steps */ #[output] y: f64,
    #[copied] count: Counter,
}

#[derive(Clone, Default)]
struct Counter(f64);

impl Noisy {
    references! { Y }
}

impl Simulate for Noisy {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.count.0 += 1.0;
        self.y = self.count.0;
        Ok(())
    }
}

/// Has variables that hosts of earlier versions use
#[derive(Model)]
#[rustfmt::skip]
pub struct Heir {
    /** kept */ #[input] kept: f64,
    /** real number */ #[input(deprecated = "use kept")] old: f64,
    /** whole number */ #[parameter(start = 4, deprecated = "it has no effect")] order: i32,
    /** array */ #[parameter(tunable, start = [2, 3], alias = "k", deprecated = "use kept")] gains: [f64; 2],
    /** sum */ #[output] y: f64,
}

impl Heir {
    references! { KEPT, OLD, ORDER, GAINS * 2, Y }
}

impl Simulate for Heir {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.y = self.kept + self.old + self.gains.iter().sum::<f64>() + f64::from(self.order);
        Ok(())
    }
}
