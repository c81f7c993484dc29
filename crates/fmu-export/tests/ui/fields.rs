//! Mistakes in the attributes of fields.

use fmu_export::prelude::*;

// Options that do not exist, or not for this role or type.

#[derive(Variables)]
struct Options {
    /** not a parameter */ #[input(tunable)] tunable: f64,
    /** misspelled */ #[output(units = "m")] unknown: f64,
    /** not a variable */ #[nested(unit = "m")] nested: Group,
    /** no member */ #[input(terminal = "loop")] terminal: f64,
    /** two roles */ #[input] #[output] both: f64,
    /** no bounds */ #[parameter(min = 0)] flag: bool,
    /** only a whole f64 has one */ #[input(derivative = self.slope)] inputs: [f64; 2],
    /** of an array */ #[output(derivative_by(tunable = 1.0))] outputs: [f64; 2],
    /** not bytes */ #[input(mime_type = "text/plain")] text: String,
    /** a word */ #[input(unit)] word: f64,
    /** an assignment */ #[parameter = 3] assigned: f64,
    /** twice */ #[input(start = 1, start = 2)] twice: f64,
    /** without a magnitude */ #[input(nominal = 2)] flags: bool,
    /** not a magnitude */ #[input(nominal = -2)] magnitude: f64,
    #[nested] groups: [[Group; 2]; 2], #[nested(flatten)] flat: [Group; 2],
    slope: f64,
}

#[derive(Variables)]
struct Group {}

/// A model
#[derive(Model)]
#[model(sampletime = 0.1)]
struct UnknownOption {}

/// A model
#[derive(Model)]
struct Tuple(f64);

/// A model
#[derive(Model)]
enum Enum {
    /** item */ Item,
}

/// Borrowed
#[derive(Model)]
struct Borrowed<'a> {
    /** gain */ #[parameter] gain: f64,
    table: &'a [f64],
}

/// Valued
#[derive(Clone, Copy, Choice)]
enum Valued {
    /** with a field */ Value(f64),
}

/// No items
#[derive(Clone, Copy, Choice)]
enum Empty {}

// Numbers of elements in use that are no structural parameters.

#[derive(Variables)]
struct Sizes {
    /** of another type */ #[structural_parameter(start = 1, max = 3)] small: u32,
    /** several numbers */ #[structural_parameter(start = 1, max = 3)] several: [u64; 2],
    /** a matrix */ #[parameter(size = "small")] matrix: [[f64; 2]; 3],
    /** a scalar */ #[input(size = "small")] scalar: f64,
    /** beyond its bounds */ #[structural_parameter(start = 4, max = 3)] start: u64,
    /** discrete */ #[structural_parameter(discrete)] discrete: u64,
}

#[derive(Variables)]
struct Missing {
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

#[derive(Variables)]
struct Parameter {
    /** no structural parameter */ #[parameter(start = 1, max = 3)] nodes: u64,
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

#[derive(Variables)]
struct TooLarge {
    /** number of nodes */ #[structural_parameter(start = 1, max = 4)] nodes: u64,
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

#[derive(Variables)]
struct Unbounded {
    /** number of nodes */ #[structural_parameter(start = 1)] nodes: u64,
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

// Types that a variable cannot have.

#[derive(Variables)]
struct Types {
    /** a size that depends on the platform */ #[input] size: usize,
    /** any number of elements */ #[input] list: Vec<f64>,
    /** too large */ #[input] count: u128,
    /** may be missing */ #[input] option: Option<f64>,
    /** borrowed */ #[parameter] text: &'static str,
    /** a tuple */ #[input] pair: (f64, f64),
    /** of an unsupported type */ #[input] array: [char; 3],
}

// Units that are unknown, or of a type that has none.

#[derive(Variables)]
struct Units {
    /** misspelled */ #[input(unit = "radians")] angle: f64,
    /** part of a product */ #[input(unit = "N.foo/s")] force: f64,
    /** no product */ #[input(unit = "Nm")] torque: f64,
    /** a count */ #[input(unit = "m")] count: i32,
    /** no text */ #[input(unit = 1)] number: f64,
}

/// What uses a type whose derive failed is not reported as well.
#[derive(Model)]
struct Plant {
    /** speed */ #[output(unit = "kmph")] speed: f64,
    #[nested] units: Units,
}

impl Simulate for Plant {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

export!(Plant);

// Start values outside the bounds.

#[derive(Variables)]
struct Literals {
    /** below */ #[parameter(start = -1, min = 0)] below: f64,
    /** above */ #[parameter(start = 11, max = 10)] above: i32,
    /** the default */ #[input(min = 1)] default: f64,
    /** an element */ #[parameter(start = [[0.5, 1.5], [0, 2]], max = 1.5)] element: [[f64; 2]; 2],
    /** bounds in the wrong order */ #[parameter(start = 1, min = 2, max = 0)] reversed: f64,
    /** needs a value */ #[constant] constant: f64,
}

#[derive(Variables)]
struct Mismatch {
    /** a text */ #[parameter(start = "2")] gain: f64,
    /** a number */ #[parameter(start = 1)] flag: bool,
    /** a fraction */ #[parameter(start = 0.5)] count: i32,
    /** too few */ #[parameter(start = [1, 2])] weights: [f64; 3],
    /** an array */ #[parameter(start = [1, 2])] scalar: f64,
    /** half an array */ #[parameter(start = [1, 2])] matrix: [[f64; 2]; 2],
    /** a number for an item */ #[parameter(start = 1)] law: Law,
    /** beyond its type */ #[parameter(start = 256)] byte: u8,
    /** an element beyond its type */ #[parameter(start = [-129, 0])] signed: [i8; 2],
    /** a bound beyond its type */ #[parameter(min = -1)] unsigned: u64,
    /** infinite */ #[parameter(start = 1e39)] single: f32,
    /** a text for bytes */ #[parameter(start = "abc")] bytes: Vec<u8>,
    /** a text as a bound */ #[parameter(min = "0")] bound: f64,
}

// Dependencies on variables that do not exist.

#[derive(Variables)]
struct Plain {
    /** at the start */ #[parameter] y0: f64,
    /** output */ #[output(initially_from("y0", "z0"))] y: f64,
}

#[derive(Variables)]
struct Derivative {
    /** input */ #[input] force: f64,
    /** not an input */ #[parameter] gain: f64,
    /** output */ #[output(derivative_by(force = 1.0, gain = 2.0))] y: f64,
}

#[derive(Variables)]
struct Constant {
    /** of nothing */ #[output(derivative_by())] y: f64,
}

fn main() {}
