//! The models under test in one binary.

use fmu_export::{Enumeration, Model, ModelError, Variable, finite};
use serde::{Deserialize, Serialize};

fmu_export::export!(Probe, Wide);

/// A model with every kind of variable. The input `trouble` selects how the step fails.
#[derive(Debug, Default, Clone, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    pub u: f64,
    pub u_rate: f64,
    pub v: f64,
    pub trouble: f64,
    pub gain: f64,
    pub limit: f64,
    pub weights: [f64; 3],
    pub order: i32,
    pub limited: bool,
    pub law: i32,
    pub y: f64,
    pub y_by_u: f64,
    pub parts: [f64; 2],
}

/// Values of the input `trouble`.
pub const REFUSE: f64 = 1.0;
pub const DISCARD: f64 = 2.0;
pub const BREAK: f64 = 3.0;
pub const PANIC: f64 = 4.0;

static LAWS: Enumeration = Enumeration {
    name: "Law",
    description: "what the step does with v",
    items: &[("added", "y + v"), ("ignored", "y alone")],
};

type Row = Variable<Probe>;

impl Model for Probe {
    const NAME: &'static str = "Probe";
    const DESCRIPTION: &'static str = "Every kind of variable, and failures on demand";
    const VARIABLES: &'static [Row] = &[
        Row::input("u", |m| &mut m.u)
            .input_derivative(|m| &mut m.u_rate)
            .about("is integrated"),
        Row::input("v", |m| &mut m.v)
            .at_least(-10.0)
            .at_most(10.0)
            .about("is bounded"),
        Row::input("trouble", |m| &mut m.trouble)
            .at_least(0.0)
            .at_most(PANIC)
            .about("how the step fails"),
        Row::fixed("gain", 2.0, |m| &mut m.gain)
            .at_least(0.0)
            .about("of u"),
        Row::tunable("limit", 1e6, |m| &mut m.limit)
            .at_least(0.0)
            .about("of y"),
        Row::fixed_array("weights", &[1.0, 2.0, 3.0], |m| &mut m.weights).about("array"),
        Row::integer("order", 1, (1, 4), |m| &mut m.order).about("whole number"),
        Row::flag("limited", true, |m| &mut m.limited).about("whether y is limited"),
        Row::choice("law", &LAWS, 1, |m| &mut m.law).about("item"),
        Row::output("y", |m| &mut m.y)
            .directional_derivatives(&[("u", |m| m.y_by_u)])
            .about("integral of u"),
        Row::output_array("parts", 2, |m| &mut m.parts).about("weighted y"),
    ];

    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        assert!(self.trouble != PANIC, "the bug shows early");
        if self.trouble == BREAK {
            return Err(ModelError::new("the parameters do not fit together"));
        }
        (self.y, self.y_by_u) = (start_time, 0.0);
        self.parts = [
            self.weights[0] * self.y,
            self.weights[1] * f64::from(self.order),
        ];
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
        if self.law == 1 {
            self.y += self.v * step;
        }
        if self.limited {
            self.y = self.y.min(self.limit).max(-self.limit);
        }
        if self.trouble == BREAK {
            self.y = f64::NAN;
        }
        self.parts = [self.weights[0] * self.y, self.weights[2] * (time + step)];
        finite!("y": self.y, "parts[1]": self.parts[0])
    }
}

/// The type with which a variable is accessed from C.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    Real,
    Integer,
    Boolean,
}

/// When a variable can be set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    Always,
    BeforeSteps,
    Never,
}

/// The expected properties of a variable of [`Probe`].
pub struct Fact {
    pub reference: u32,
    pub name: &'static str,
    pub kind: Kind,
    pub role: Role,
    /// Minimum and maximum.
    pub bounds: (f64, f64),
}

/// Value references of the variables of [`Probe`].
pub const U: u32 = 0;
pub const V: u32 = 1;
pub const TROUBLE: u32 = 2;
pub const GAIN: u32 = 3;
pub const LIMIT: u32 = 4;
pub const ORDER: u32 = 8;
pub const LIMITED: u32 = 9;
pub const LAW: u32 = 10;
pub const Y: u32 = 11;
/// The number of its scalar variables.
pub const COUNT: u32 = 14;

/// The scalar variables of [`Probe`], defined independently of its table.
pub const FACTS: [Fact; COUNT as usize] = {
    use {Kind::*, Role::*};
    const ANY: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);
    const POSITIVE: (f64, f64) = (0.0, f64::INFINITY);
    const fn fact(
        reference: u32,
        name: &'static str,
        kind: Kind,
        role: Role,
        bounds: (f64, f64),
    ) -> Fact {
        Fact {
            reference,
            name,
            kind,
            role,
            bounds,
        }
    }
    [
        fact(U, "u", Real, Always, ANY),
        fact(V, "v", Real, Always, (-10.0, 10.0)),
        fact(TROUBLE, "trouble", Real, Always, (0.0, 4.0)),
        fact(GAIN, "gain", Real, BeforeSteps, POSITIVE),
        fact(LIMIT, "limit", Real, Always, POSITIVE),
        fact(5, "weights[1]", Real, BeforeSteps, ANY),
        fact(6, "weights[2]", Real, BeforeSteps, ANY),
        fact(7, "weights[3]", Real, BeforeSteps, ANY),
        fact(ORDER, "order", Integer, BeforeSteps, (1.0, 4.0)),
        fact(LIMITED, "limited", Boolean, BeforeSteps, (0.0, 1.0)),
        fact(LAW, "law", Integer, BeforeSteps, (1.0, 2.0)),
        fact(Y, "y", Real, Never, ANY),
        fact(12, "parts[1]", Real, Never, ANY),
        fact(13, "parts[2]", Real, Never, ANY),
    ]
};

impl Fact {
    /// Whether the host may set the variable; `running` is true after initialization.
    pub fn settable(&self, running: bool) -> bool {
        self.role == Role::Always || self.role == Role::BeforeSteps && !running
    }

    /// Whether the value is within the bounds.
    pub fn allows(&self, value: f64) -> bool {
        value.is_finite() && self.bounds.0 <= value && value <= self.bounds.1
    }

    /// A valid value other than the start value.
    pub fn other_value(&self) -> f64 {
        match self.reference {
            LIMITED => 0.0,
            LAW | ORDER => 2.0,
            reference => 0.125 * f64::from(1 + reference),
        }
    }
}

impl Probe {
    /// The model with its start values.
    pub fn start() -> Self {
        Self {
            gain: 2.0,
            limit: 1e6,
            weights: [1.0, 2.0, 3.0],
            order: 1,
            limited: true,
            law: 1,
            ..Self::default()
        }
    }

    /// The value of a variable.
    pub fn value(&self, reference: u32) -> f64 {
        let [w1, w2, w3] = self.weights;
        [
            self.u,
            self.v,
            self.trouble,
            self.gain,
            self.limit,
            w1,
            w2,
            w3,
            f64::from(self.order),
            f64::from(u8::from(self.limited)),
            f64::from(self.law),
            self.y,
            self.parts[0],
            self.parts[1],
        ][reference as usize]
    }

    /// Sets a variable that is not an output.
    pub fn set(&mut self, reference: u32, value: f64) {
        match reference {
            U => self.u = value,
            V => self.v = value,
            TROUBLE => self.trouble = value,
            GAIN => self.gain = value,
            LIMIT => self.limit = value,
            ORDER => self.order = value as i32,
            LIMITED => self.limited = value != 0.0,
            LAW => self.law = value as i32,
            weight => self.weights[weight as usize - 5] = value,
        }
    }
}

/// A model with more variables than the fast path is specialized for, and with bugs in their access.
#[derive(Default, Clone, Serialize, Deserialize)]
pub struct Wide {
    inputs: [f64; 6],
    fixed: f64,
    flag: bool,
    many: Vec<f64>,
    last: f64,
    fuse: f64,
}

type WideRow = Variable<Wide>;

impl Model for Wide {
    const NAME: &'static str = "Wide";
    const DESCRIPTION: &'static str = "Many variables";
    const VARIABLES: &'static [WideRow] = &[
        WideRow::input("u0", |m| &mut m.inputs[0]).about("input"),
        WideRow::input("u1", |m| &mut m.inputs[1])
            .at_most(10.0)
            .about("input"),
        WideRow::input("u2", |m| &mut m.inputs[2])
            .at_least(-1.0)
            .about("input"),
        WideRow::input("u3", |m| &mut m.inputs[3]).about("input"),
        WideRow::input("u4", |m| &mut m.inputs[4]).about("input"),
        WideRow::input("u5", |m| &mut m.inputs[5]).about("input"),
        WideRow::fixed("fixed", 1.0, |m| &mut m.fixed).about("fixed"),
        WideRow::flag("flag", false, |m| &mut m.flag).about("flag"),
        WideRow::output_array("many", 60, |m| &mut m.many).about("shorter in the model"),
        WideRow::tunable("last", 5.0, |m| &mut m.last).about("past the first 48"),
        WideRow::tunable("fuse", 0.0, |m| &mut m.fuse).about("arms the bomb"),
        WideRow::tunable("bomb", 0.0, |m| {
            assert!(m.fuse == 0.0, "the bomb is armed");
            &mut m.fuse
        })
        .about("panics when it is reached"),
    ];

    fn initialize(&mut self, _start_time: f64) -> Result<(), ModelError> {
        self.many = (0..50).map(f64::from).collect();
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
