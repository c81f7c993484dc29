//! The models under test in one binary.

use std::cell::Cell;
use std::f64::consts;

use fmu_description::{Value, ValueMut};
use fmu_export::prelude::*;

fmu_export::export!(
    Probe, Wide, Sampled, Reader, Sizes, Ball, Every, Lists, Hopper
);

// Indices of the models.
pub const PROBE: usize = 0;
pub const WIDE: usize = 1;
pub const SAMPLED: usize = 2;
pub const READER: usize = 3;
pub const SIZES: usize = 4;
pub const BALL: usize = 5;
pub const EVERY: usize = 6;
pub const LISTS: usize = 7;
pub const HOPPER: usize = 8;

/// Every type and role, and failures on demand
#[derive(Debug, Clone, Model)]
pub struct Probe {
    /// is integrated
    #[input(derivative = self.u_rate)]
    pub u: f64,
    pub u_rate: f64,
    /// is bounded
    #[input(min = -10, max = 10)]
    pub v: f64,
    /// how the step fails
    #[input(min = 0, max = PANIC)]
    pub trouble: f64,
    /// of u
    #[parameter(start = 2, min = 0)]
    gain: f64,
    /// of y
    #[parameter(tunable, start = 1e6, min = 0)]
    limit: f64,
    /// array
    #[parameter(start = [1, 2, 3])]
    weights: [f64; 3],
    /// whole number
    #[parameter(start = 1, min = 1, max = 4)]
    order: i32,
    /// whether y is limited
    #[parameter(start = true)]
    limited: bool,
    /// item
    #[parameter]
    law: Law,
    /// integral of u
    #[output(initially_from("weights"), derivative_by(u = self.y_by_u))]
    y: f64,
    /// weighted y
    #[output(unit = "N.m")]
    parts: [f64; 2],
    /// whole number
    #[input(start = 3, min = -5, max = 5)]
    mode: i32,
    /// truth
    #[input(start = true)]
    enabled: bool,
    /// text
    #[input(start = "12")]
    label: String,
    /// item
    #[input(start = Law::Ignored)]
    shape: Law,
    /// matrix
    #[parameter(tunable, start = [[1, 2, 3], [4, 5, 6.5]], unit = "kg")]
    table: [[f64; 3]; 2],
    /// texts
    #[parameter(start = ["7", "8"])]
    names: [String; 2],
    /// truths
    #[parameter(tunable, start = [false, true])]
    flags: [bool; 2],
    /// items
    #[parameter(tunable, start = [[Law::Added, Law::Ignored]])]
    laws: [[Law; 2]; 1],
    /// whole numbers
    #[input(start = -1, min = -2)]
    counts: [[i32; 2]; 2],
    #[nested]
    part: Part,
    /// number of steps and mode
    #[output]
    steps: i32,
    /// whether it is enabled
    #[output]
    done: bool,
    /// the steps as text
    #[output]
    report: String,
    /// the other item
    #[output]
    next: [Law; 2],
    /// sum of the last 40 values
    #[local]
    sum: f64,
    /// changes in steps only
    #[local(discrete)]
    label_length: i32,
    /// a number
    #[constant(start = consts::TAU)]
    tau: f64,
    /// a text
    #[constant(start = "9")]
    version: String,
    pub y_by_u: f64,
    ticks: u64,
    history: [f64; 40],
}

/// What the step does with v
#[derive(Debug, Clone, Copy, PartialEq, Choice)]
pub enum Law {
    /// y + v
    Added,
    /// y alone
    Ignored,
}

/// A nested struct
#[derive(Debug, Clone, Variables)]
pub struct Part {
    /// added to y
    #[input(start = 0.0)]
    bias: f64,
    /// multiplies the bias
    #[parameter(start = 0.5)]
    scale: f64,
    uses: u32,
}

/// Values of the input `trouble`.
pub const REFUSE: f64 = 1.0;
pub const DISCARD: f64 = 2.0;
pub const BREAK: f64 = 3.0;
/// An output becomes infinite.
pub const DIVERGE: f64 = 4.0;
pub const PANIC: f64 = 5.0;

impl Simulate for Probe {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        assert!(self.trouble != PANIC, "the bug shows early");
        if self.trouble == BREAK {
            return Err(ModelError::new("the parameters do not fit together"));
        }
        self.y = start.time;
        self.parts = [
            self.weights[0] * self.y,
            self.weights[1] * f64::from(self.order),
        ];
        // Fresh at each initialization.
        self.ticks += 1;
        self.part.uses += 1;
        self.update();
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        assert!(self.trouble != PANIC, "the bug shows in a step");
        if self.trouble == REFUSE {
            return Err(ModelError::refuse("such a step is never taken"));
        }
        if self.trouble == DISCARD {
            return Err(ModelError::discard("the step is too long here"));
        }
        self.y_by_u = self.gain * step;
        self.y += self.y_by_u * (self.u + self.u_rate * step / 2.0);
        self.y += self.part.bias * self.part.scale;
        if self.law == Law::Added {
            self.y += self.v * step;
        }
        if self.limited {
            self.y = self.y.min(self.limit).max(-self.limit);
        }
        self.parts = [self.weights[0] * self.y, self.weights[2] * (time + step)];
        self.ticks += 1;
        self.update();
        Ok(())
    }
}

impl Probe {
    fn update(&mut self) {
        if self.trouble == BREAK {
            self.y = f64::NAN;
        }
        if self.trouble == DIVERGE {
            self.parts[1] = f64::INFINITY;
        }
        self.history[self.ticks as usize % 40] = self.y;
        self.sum = self.history.iter().sum();
        self.steps = self.ticks as i32 + self.mode;
        self.done = self.enabled && self.flags[1];
        self.report = self.steps.to_string();
        let [[first, _]] = self.laws;
        self.next = match self.shape {
            Law::Added => [Law::Ignored, first],
            Law::Ignored => [Law::Added, first],
        };
        self.label_length = self.label.len() as i32;
    }
}

/// The type with which a variable is accessed from C.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    Real,
    Integer,
    Boolean,
    /// In these tests, the text of a number.
    String,
}

/// When a variable can be set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    Always,
    BeforeSteps,
    Output,
    Local,
    Constant,
}

/// The expected properties of a variable of [`Probe`].
pub struct Fact {
    pub reference: u32,
    pub name: &'static str,
    pub kind: Kind,
    pub role: Role,
    /// Minimum and maximum.
    pub bounds: (f64, f64),
    pub start: f64,
}

// Value references of the variables of `Probe`.
pub const U: u32 = 0;
pub const V: u32 = 1;
pub const TROUBLE: u32 = 2;
pub const GAIN: u32 = 3;
pub const LIMIT: u32 = 4;
pub const ORDER: u32 = 8;
pub const LIMITED: u32 = 9;
pub const LAW: u32 = 10;
pub const Y: u32 = 11;
pub const LABEL: u32 = 16;
pub const NAMES: u32 = 24;
pub const STEPS: u32 = 36;
pub const REPORT: u32 = 38;
pub const SUM: u32 = 41;
pub const TAU: u32 = 43;
pub const VERSION: u32 = 44;
/// The number of its scalar variables.
pub const COUNT: u32 = 45;

/// The scalar variables of [`Probe`], defined independently of its table.
pub const FACTS: [Fact; COUNT as usize] = {
    use {Kind::*, Role::*};
    const ANY: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);
    const POSITIVE: (f64, f64) = (0.0, f64::INFINITY);
    const INTEGER: (f64, f64) = (i32::MIN as f64, i32::MAX as f64);
    const COUNTS: (f64, f64) = (-2.0, i32::MAX as f64);
    const TRUTH: (f64, f64) = (0.0, 1.0);
    const ITEM: (f64, f64) = (1.0, 2.0);
    const fn fact(
        reference: u32,
        name: &'static str,
        kind: Kind,
        role: Role,
        bounds: (f64, f64),
        start: f64,
    ) -> Fact {
        Fact {
            reference,
            name,
            kind,
            role,
            bounds,
            start,
        }
    }
    [
        fact(U, "u", Real, Always, ANY, 0.0),
        fact(V, "v", Real, Always, (-10.0, 10.0), 0.0),
        fact(TROUBLE, "trouble", Real, Always, (0.0, PANIC), 0.0),
        fact(GAIN, "gain", Real, BeforeSteps, POSITIVE, 2.0),
        fact(LIMIT, "limit", Real, Always, POSITIVE, 1e6),
        fact(5, "weights[1]", Real, BeforeSteps, ANY, 1.0),
        fact(6, "weights[2]", Real, BeforeSteps, ANY, 2.0),
        fact(7, "weights[3]", Real, BeforeSteps, ANY, 3.0),
        fact(ORDER, "order", Integer, BeforeSteps, (1.0, 4.0), 1.0),
        fact(LIMITED, "limited", Boolean, BeforeSteps, TRUTH, 1.0),
        fact(LAW, "law", Integer, BeforeSteps, ITEM, 1.0),
        fact(Y, "y", Real, Output, ANY, 0.0),
        fact(12, "parts[1]", Real, Output, ANY, 0.0),
        fact(13, "parts[2]", Real, Output, ANY, 0.0),
        fact(14, "mode", Integer, Always, (-5.0, 5.0), 3.0),
        fact(15, "enabled", Boolean, Always, TRUTH, 1.0),
        fact(LABEL, "label", String, Always, ANY, 12.0),
        fact(17, "shape", Integer, Always, ITEM, 2.0),
        fact(18, "table[1,1]", Real, Always, ANY, 1.0),
        fact(19, "table[1,2]", Real, Always, ANY, 2.0),
        fact(20, "table[1,3]", Real, Always, ANY, 3.0),
        fact(21, "table[2,1]", Real, Always, ANY, 4.0),
        fact(22, "table[2,2]", Real, Always, ANY, 5.0),
        fact(23, "table[2,3]", Real, Always, ANY, 6.5),
        fact(NAMES, "names[1]", String, BeforeSteps, ANY, 7.0),
        fact(25, "names[2]", String, BeforeSteps, ANY, 8.0),
        fact(26, "flags[1]", Boolean, Always, TRUTH, 0.0),
        fact(27, "flags[2]", Boolean, Always, TRUTH, 1.0),
        fact(28, "laws[1,1]", Integer, Always, ITEM, 1.0),
        fact(29, "laws[1,2]", Integer, Always, ITEM, 2.0),
        fact(30, "counts[1,1]", Integer, Always, COUNTS, -1.0),
        fact(31, "counts[1,2]", Integer, Always, COUNTS, -1.0),
        fact(32, "counts[2,1]", Integer, Always, COUNTS, -1.0),
        fact(33, "counts[2,2]", Integer, Always, COUNTS, -1.0),
        fact(34, "part.bias", Real, Always, ANY, 0.0),
        fact(35, "part.scale", Real, BeforeSteps, ANY, 0.5),
        fact(STEPS, "steps", Integer, Output, INTEGER, 0.0),
        fact(37, "done", Boolean, Output, TRUTH, 0.0),
        fact(REPORT, "report", String, Output, ANY, f64::NAN),
        fact(39, "next[1]", Integer, Output, ITEM, 1.0),
        fact(40, "next[2]", Integer, Output, ITEM, 1.0),
        fact(SUM, "sum", Real, Local, ANY, 0.0),
        fact(42, "label_length", Integer, Local, INTEGER, 0.0),
        fact(TAU, "tau", Real, Constant, ANY, consts::TAU),
        fact(VERSION, "version", String, Constant, ANY, 9.0),
    ]
};

impl Fact {
    /// Whether the host may set the variable; `running` is true after initialization.
    pub fn settable(&self, running: bool) -> bool {
        self.role == Role::Always || self.role == Role::BeforeSteps && !running
    }

    /// Whether the value is within the bounds.
    pub fn allows(&self, value: f64) -> bool {
        match self.kind {
            Kind::String => true,
            _ => value.is_finite() && self.bounds.0 <= value && value <= self.bounds.1,
        }
    }

    /// A valid value other than the start value.
    pub fn other_value(&self) -> f64 {
        match (self.kind, self.bounds) {
            (Kind::Boolean, _) | (Kind::Integer, (1.0, 2.0)) => {
                self.bounds.0 + self.bounds.1 - self.start
            }
            (Kind::Integer, _) => 2.0,
            _ => 0.125 * f64::from(1 + self.reference),
        }
    }
}

impl Probe {
    /// The model with its start values, independent of its table.
    pub fn start() -> Self {
        let mut probe = Self::unset();
        for fact in FACTS.iter().filter(|fact| !fact.start.is_nan()) {
            probe.set(fact.reference, fact.start);
        }
        probe
    }

    /// The variables in the order of their value references.
    fn variables(&mut self) -> Vec<ValueMut<'_>> {
        use ValueMut::{Boolean, Enumeration, Float64, Int32, String};
        let [w1, w2, w3] = &mut self.weights;
        let [part1, part2] = &mut self.parts;
        let [[t11, t12, t13], [t21, t22, t23]] = &mut self.table;
        let [name1, name2] = &mut self.names;
        let [flag1, flag2] = &mut self.flags;
        let [[law1, law2]] = &mut self.laws;
        let [[c11, c12], [c21, c22]] = &mut self.counts;
        let [next1, next2] = &mut self.next;
        vec![
            Float64(&mut self.u),
            Float64(&mut self.v),
            Float64(&mut self.trouble),
            Float64(&mut self.gain),
            Float64(&mut self.limit),
            Float64(w1),
            Float64(w2),
            Float64(w3),
            Int32(&mut self.order),
            Boolean(&mut self.limited),
            Enumeration(&mut self.law),
            Float64(&mut self.y),
            Float64(part1),
            Float64(part2),
            Int32(&mut self.mode),
            Boolean(&mut self.enabled),
            String(&mut self.label),
            Enumeration(&mut self.shape),
            Float64(t11),
            Float64(t12),
            Float64(t13),
            Float64(t21),
            Float64(t22),
            Float64(t23),
            String(name1),
            String(name2),
            Boolean(flag1),
            Boolean(flag2),
            Enumeration(law1),
            Enumeration(law2),
            Int32(c11),
            Int32(c12),
            Int32(c21),
            Int32(c22),
            Float64(&mut self.part.bias),
            Float64(&mut self.part.scale),
            Int32(&mut self.steps),
            Boolean(&mut self.done),
            String(&mut self.report),
            Enumeration(next1),
            Enumeration(next2),
            Float64(&mut self.sum),
            Int32(&mut self.label_length),
            Float64(&mut self.tau),
            String(&mut self.version),
        ]
    }

    /// The value of a variable.
    pub fn value(&mut self, reference: u32) -> f64 {
        match self.variables()[reference as usize].get() {
            Value::Boolean(value) => f64::from(u8::from(value)),
            Value::String(text) => number(&text),
            value => (value.as_real())
                .or(value.as_whole().map(|number| number as f64))
                .unwrap(),
        }
    }

    /// Sets a variable.
    pub fn set(&mut self, reference: u32, value: f64) {
        let variable = self.variables().swap_remove(reference as usize);
        let of_type = variable.of_type();
        let value = match FACTS[reference as usize].kind {
            Kind::Real => Value::real(of_type, value),
            Kind::Integer => Value::whole(of_type, value as i128),
            Kind::Boolean => Some(Value::Boolean(value == 1.0)),
            Kind::String => Some(Value::String(value.to_string())),
        };
        assert!(value.is_some_and(|value| variable.set(value)));
    }

    /// The outcome of an initialization at `time` with the values that were set.
    pub fn initialized(&mut self, time: f64) -> Option<Self> {
        let mut fresh = Self::start();
        for fact in FACTS.iter().filter(|fact| fact.settable(false)) {
            fresh.set(fact.reference, self.value(fact.reference));
        }
        fresh.u_rate = self.u_rate;
        let outcome = fresh.initialize(&Start::new(time, "nowhere"));
        (outcome.is_ok() && fresh.is_finite()).then_some(fresh)
    }

    /// Whether all outputs are finite.
    pub fn is_finite(&self) -> bool {
        self.y.is_finite() && self.parts.iter().all(|part| part.is_finite())
    }
}

/// The number that a text of these tests stands for.
pub fn number(text: &str) -> f64 {
    text.parse().unwrap_or(f64::NAN)
}

/// Many variables, without those of other types between them
#[derive(Model)]
pub struct Wide {
    /// input
    #[input]
    u0: f64,
    /// input
    #[input(max = 10)]
    u1: f64,
    /// input
    #[input(min = -1)]
    u2: f64,
    /// input
    #[input]
    u3: f64,
    /// input
    #[input]
    u4: f64,
    /// input
    #[input]
    u5: f64,
    /// fixed
    #[parameter(start = 1)]
    fixed: f64,
    /// flag
    #[parameter]
    flag: bool,
    /// output
    #[output]
    many: [f64; 60],
    /// tunable
    #[parameter(tunable, start = 5)]
    last: f64,
}

impl Simulate for Wide {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.many = std::array::from_fn(|k| k as f64);
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

impl Wide {
    /// The value of `last` that makes the destructor panic.
    pub const LAST_BUG: f64 = 1234.5;
}

impl Drop for Wide {
    fn drop(&mut self) {
        assert!(
            self.last != Self::LAST_BUG,
            "the bug shows in the destructor"
        );
    }
}

/// Acts at its sample instants, and fails in a chosen one
#[derive(Model)]
#[model(sample_time = self.ts, stop_time = 5, step_size = 0.01)]
pub struct Sampled {
    /// sample time
    #[parameter(start = 0.5, unit = "s")]
    ts: f64,
    /// number of the sample that fails
    #[parameter(tunable)]
    fails_at: i32,
    /// how it fails
    #[parameter(tunable)]
    failure: Failure,
    /// times of the last samples
    #[output(unit = "s")]
    times: [f64; 3],
    /// number of samples
    #[output]
    count: i32,
    /// its inverse is an output
    #[input(start = 1)]
    u: f64,
    /// inverse of u
    #[output(derivative_by(u = self.slope()))]
    y: f64,
}

/// How a sample fails
#[derive(Clone, Copy, Choice)]
pub enum Failure {
    /// the step is discarded
    Discard,
    /// the step is refused
    Refuse,
    /// the model is broken
    Break,
}

impl Simulate for Sampled {
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        assert_eq!(step, self.ts);
        if self.count + 1 == self.fails_at {
            return Err(match self.failure {
                Failure::Discard => ModelError::discard("a sample is discarded"),
                Failure::Refuse => ModelError::refuse("a sample is refused"),
                Failure::Break => ModelError::new("a sample breaks"),
            });
        }
        self.count += 1;
        self.times = [self.times[1], self.times[2], time];
        self.y = 1.0 / self.u;
        Ok(())
    }
}

impl Sampled {
    fn slope(&self) -> f64 {
        assert!(self.u != 0.0, "the bug shows in a derivative");
        -1.0 / (self.u * self.u)
    }
}

/// Reads a table from a file
#[derive(Model)]
pub struct Reader {
    /// file in the resources
    #[parameter(start = "weights.txt")]
    file: String,
    /// sum of its numbers
    #[output]
    sum: f64,
}

impl Simulate for Reader {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        for line in start.read_resource(&self.file)?.lines() {
            self.sum += line.parse::<f64>()?;
        }
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Variables of types that FMI 2.0 does not have
#[derive(Model)]
pub struct Sizes {
    /// single precision
    #[input(min = 0.1, max = 16777216, start = 0.3)]
    single: f32,
    /// signed byte
    #[input]
    signed: i8,
    /// bytes
    #[parameter(tunable, start = [1, 2])]
    bytes: [u8; 2],
    /// large number
    #[input(start = 4294967295)]
    large: u64,
    /// long number
    #[output]
    long: i64,
    /// what was received
    #[output]
    message: Vec<u8>,
    /// half of the single
    #[output]
    half: f32,
}

impl Simulate for Sizes {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.long = -i64::from(self.signed) << 24;
        self.half = f32::from(self.bytes[0]) / self.single;
        Ok(())
    }
}

/// A ball that is driven, bounces, and gets a kick
#[derive(Model)]
#[model(continuous, step = Self::step, step_size = 0.1)]
pub struct Ball {
    /// acceleration by the drive
    #[input]
    drive: f64,
    /// how the equations and events fail
    #[input(min = 0, max = PANIC)]
    trouble: f64,
    /// how steps after 0.15 s fail
    #[input(min = 0, max = PANIC)]
    fault: f64,
    /// height
    #[output(state, nominal = 10, initially_from("h0"))]
    h: f64,
    /// velocity
    #[output(state)]
    v: f64,
    #[derivative(of = h, derivative_by(v = 1.0))]
    h_dot: f64,
    #[derivative(of = v, derivative_by(drive = 1.0, v = -2.0 * self.drag * self.v.abs()))]
    v_dot: f64,
    /// height of its lowest point
    #[event_indicator(derivative_by(h = 1.0))]
    contact: f64,
    /// energy
    #[output(derivative_by(h = Ball::G, v = self.v, drive = 0.125))]
    energy: f64,
    /// height at the start
    #[parameter(start = 1)]
    h0: f64,
    /// part of the velocity that a bounce keeps
    #[parameter(tunable, start = 0.5, min = 0, max = 1)]
    restitution: f64,
    /// drag
    #[parameter(start = 0)]
    drag: f64,
    /// number of events
    #[output]
    events: i32,
    /// a switch
    #[input]
    switch: i32,
    kicked: bool,
}

impl Ball {
    pub const DRIVE: u32 = 0;
    pub const TROUBLE: u32 = 1;
    pub const FAULT: u32 = 2;
    pub const H: u32 = 3;
    pub const V: u32 = 4;
    pub const H_DOT: u32 = 5;
    pub const V_DOT: u32 = 6;
    pub const CONTACT: u32 = 7;
    pub const ENERGY: u32 = 8;
    pub const RESTITUTION: u32 = 10;
    pub const DRAG: u32 = 11;
    pub const EVENTS: u32 = 12;
    pub const SWITCH: u32 = 13;
    /// The reference of the independent variable in FMI 3.0.
    pub const TIME: u32 = 14;
    /// Acceleration by gravity (m/s2).
    pub const G: f64 = 9.75;
    /// Time of the kick (s).
    pub const KICK: f64 = 0.5;

    /// Exact without drag; without events.
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if time > 0.15 {
            Self::fail(self.fault)?;
        }
        let acceleration = self.drive - Self::G;
        self.h += (self.v + acceleration * step / 2.0) * step;
        self.v += acceleration * step;
        self.energy = self.energy();
        Ok(())
    }

    fn energy(&self) -> f64 {
        Self::G * self.h + self.v * self.v / 2.0 + self.drive / 8.0
    }

    fn fail(trouble: f64) -> Result<(), ModelError> {
        assert!(trouble != PANIC, "the bug shows in the ball");
        match trouble {
            REFUSE => Err(ModelError::refuse("refused by the ball")),
            DISCARD => Err(ModelError::discard("discarded by the ball")),
            BREAK => Err(ModelError::new("broken by the ball")),
            _ => Ok(()),
        }
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
        Self::fail(self.trouble)?;
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
        Self::fail(self.trouble)?;
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
        assert!(self.trouble != PANIC, "the bug shows in the next event");
        Some(if self.kicked {
            f64::INFINITY
        } else {
            Self::KICK
        })
    }
}

/// A ball that bounces until it rests, and a lamp that switches; the layer integrates it
#[derive(Model)]
#[model(continuous, step_size = 0.1)]
pub struct Hopper {
    /// acceleration by the drive
    #[input]
    drive: f64,
    /// how the equations fail
    #[input(min = 0, max = PANIC)]
    trouble: f64,
    /// from when on
    #[parameter(tunable)]
    trouble_time: f64,
    /// height
    #[output(state, start = 1, nominal = 0.5)]
    h: f64,
    /// velocity
    #[output(state)]
    v: f64,
    #[derivative(of = h)]
    h_dot: f64,
    #[derivative(of = v)]
    v_dot: f64,
    /// its lowest point, above the ground until it rests
    #[event_indicator]
    gap: f64,
    /// part of the velocity that a bounce keeps
    #[parameter(start = 0.5, min = 0, max = 1)]
    restitution: f64,
    /// drag
    #[parameter]
    drag: f64,
    /// velocity below which it rests
    #[parameter(start = 0.1)]
    slowest: f64,
    /// time between two changes of the lamp
    #[parameter(start = 0.3)]
    period: f64,
    /// whether it rests
    #[output]
    rests: bool,
    /// number of bounces
    #[output]
    bounces: i32,
    /// time of the last bounce
    #[output]
    bounced: f64,
    /// number of changes of the lamp
    #[output]
    changes: i32,
    /// time of the last change
    #[output]
    changed: f64,
    /// memory on the heap
    #[parameter(start = "text")]
    label: String,
    log: Vec<f64>,
}

impl Hopper {
    pub const DRIVE: u32 = 0;
    pub const TROUBLE: u32 = 1;
    pub const TROUBLE_TIME: u32 = 2;
    pub const H: u32 = 3;
    pub const V: u32 = 4;
    pub const DRAG: u32 = 9;
    pub const PERIOD: u32 = 11;
    pub const RESTS: u32 = 12;
    pub const BOUNCES: u32 = 13;
    pub const BOUNCED: u32 = 14;
    pub const CHANGES: u32 = 15;
    pub const CHANGED: u32 = 16;
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
            false => (
                self.v,
                self.drive - Self::G - self.drag * self.v * self.v.abs(),
            ),
        };
        self.gap = if self.rests { -1.0 } else { self.h };
        if time >= self.trouble_time {
            Ball::fail(self.trouble)?;
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

/// Inputs of all types, and an output
#[derive(Model)]
pub struct Every {
    /// vector
    #[input(min = -10, max = 10)]
    vector: [f64; 3],
    /// f32
    #[input(max = 10)]
    f32: f32,
    /// i8
    #[input]
    i8: i8,
    /// u8
    #[input]
    u8: u8,
    /// i16
    #[input]
    i16: i16,
    /// u16
    #[input]
    u16: u16,
    /// i32
    #[input]
    i32: i32,
    /// u32
    #[input]
    u32: u32,
    /// i64
    #[input]
    i64: i64,
    /// u64
    #[input]
    u64: u64,
    /// bool
    #[input]
    bool: bool,
    /// text
    #[input(start = "text")]
    text: String,
    /// bytes
    #[input(start = b"\x00\xff")]
    bytes: Vec<u8>,
    /// matrix
    #[input(start = [[1, 2], [3, 4]])]
    matrix: [[f64; 2]; 2],
    /// flags
    #[input]
    flags: [bool; 2],
    /// texts
    #[input(start = ["a", "b"])]
    texts: [String; 2],
    /// scalar
    #[input]
    scalar: f64,
    /// fixed
    #[parameter(start = 7)]
    fixed: f64,
    /// item
    #[input]
    law: Law,
    /// sum of the vector, the matrix and the scalar
    #[output]
    sum: f64,
}

impl Every {
    pub const VECTOR: u32 = 0;
    pub const F32: u32 = 3;
    pub const BOOL: u32 = 12;
    pub const TEXT: u32 = 13;
    pub const BYTES: u32 = 14;
    pub const MATRIX: u32 = 15;
    pub const FLAGS: u32 = 19;
    pub const TEXTS: u32 = 21;
    pub const SCALAR: u32 = 23;
    pub const FIXED: u32 = 24;
    pub const LAW: u32 = 25;
    pub const SUM: u32 = 26;
}

impl Simulate for Every {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        let numbers = self.vector.iter().chain(self.matrix.iter().flatten());
        self.sum = numbers.sum::<f64>() + self.scalar;
        Ok(())
    }
}

/// Arrays whose sizes are set in configuration mode
#[derive(Model)]
#[model(sample_time = 0.5)]
pub struct Lists {
    /// number of gains
    #[structural_parameter(start = 2, min = 1, max = 3, tunable)]
    n: u64,
    /// number of names
    #[structural_parameter(start = 1, max = 2)]
    m: u64,
    /// gains
    #[input(size = "n", start = [1, 2, 4])]
    gains: [f64; 3],
    /// names
    #[parameter(size = "m", start = ["a", "b"])]
    names: [String; 2],
    /// sum of the gains
    #[output]
    sum: f64,
    /// how often the sizes changed
    #[output]
    changes: i32,
}

impl Lists {
    pub const N: u32 = 0;
    pub const M: u32 = 1;
    pub const GAINS: u32 = 2;
    pub const NAMES: u32 = 5;
    pub const SUM: u32 = 7;
    pub const CHANGES: u32 = 8;
    /// A number of gains with which the model cannot continue.
    pub const BAD: u64 = 1;
}

impl Simulate for Lists {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.sum = self.gains[..self.n as usize].iter().sum();
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.sum = self.gains[..self.n as usize].iter().sum();
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
