//! A model that is too large for tables by value reference: it behaves as any other.

use std::ffi::CString;
use std::thread;

use fmu_description::Type;
use fmu_export::prelude::*;
use fmu_export::{Entry, interface, table_size};

use crate::driver::*;

/// Sums products
#[derive(Model)]
struct Large {
    /// factors
    #[input(max = 10)]
    u: [f64; 60_000],
    /// number of weights
    #[structural_parameter(start = 30_000, max = 40_000)]
    n: u64,
    /// weights
    #[parameter(tunable, size = "n", start = 2)]
    w: [f64; 40_000],
    /// sum
    #[output]
    y: f64,
}

const U: u32 = 0;
const N: u32 = 60_000;
const W: u32 = 60_001;
const Y: u32 = 100_001;

impl Simulate for Large {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.y = self.u.iter().zip(&self.w[..self.n as usize]).map(|(u, w)| u * w).sum();
        Ok(())
    }
}

const SIZE: usize = table_size::<Large>();
static ENTRIES: [Entry; 1] = [Entry::new::<Large, SIZE>(interface::<Large, SIZE>(None), &[])];

/// Runs a test with a stack on which an unoptimized program can move the model.
fn with_stack(test: fn(Kind)) {
    thread::scope(|scope| {
        for kind in PLAIN {
            let stack = thread::Builder::new().stack_size(64 << 20);
            stack.spawn_scoped(scope, move || test(kind)).unwrap();
        }
    });
}

fn instance(kind: Kind) -> Instance {
    let token = Some(CString::new(ENTRIES[0].guid()).unwrap());
    Arguments::new(kind, 0).make(|a| (a.models, a.token) = (&ENTRIES, token))
}

#[test]
fn a_hundred_thousand_scalars_are_got_and_set() {
    with_stack(|kind| {
        let it = instance(kind).run(0.0);
        let (u, w): (Vec<u32>, Vec<u32>) = match kind.0 {
            Fmi2 => ((U..N).collect(), (W..W + 30_000).collect()),
            Fmi3 => (vec![U], vec![W]),
        };
        let all = |references: &[u32], n| it.get_all(Type::Float64, references, n);
        assert_eq!(all(&w, 30_000), (OK, vec![2.0; 30_000]));
        let values: Vec<f64> = (0..60_000).map(|i| f64::from(i % 10)).collect();
        ok([it.set_f64(&u, &values), it.step(0.0, 0.1)]);
        assert_eq!(all(&u, 60_000), (OK, values));
        // 2 (0 + 1 + ... + 9) for ten of the weights.
        assert_eq!(it.get([Y]), [270_000.0]);
        if kind.0 == Fmi2 {
            ok([it.set_f64(&[W + 29_999, 9], &[3.0, 10.0]), it.step(0.1, 0.1)]);
            // One weight with the factor 9 is 3, and one factor 10.
            assert_eq!(it.get([Y, W + 29_999, 9]), [270_011.0, 3.0, 10.0]);
            it.refuses("w[30001] is not available in FMI 2.0", |f| f.set(W + 30_000, 1.0));
        }
    });
}

#[test]
fn wrong_values_and_references_are_refused() {
    with_stack(|kind| {
        let it = instance(kind).run(0.0);
        let mut values = vec![1.0; 60_000];
        values[59_999] = 11.0;
        let references: Vec<u32> = if kind.0 == Fmi2 { (U..N).collect() } else { vec![U] };
        it.refuses("u[60000] = 11 is refused", |f| f.set_f64(&references, &values));
        let zeros = (OK, vec![0.0; 60_000]);
        assert_eq!(it.get_all(Type::Float64, &references, 60_000), zeros);
        it.refuses("is unknown", |f| f.get_f64(&[Y + 2], &mut [0.0]));
        it.refuses("is an output", |f| f.set(Y, 0.0));
        if kind.0 == Fmi3 {
            let words = "expected 60000, the number of elements";
            it.refuses(words, |f| f.get_f64(&[U], &mut [0.0; 2]));
        }
    });
}

/// A cell of a battery
#[derive(Variables)]
struct Cell {
    /// temperatures
    #[input(start = 20)]
    temperature: [f64; 300],
    /// current
    #[input]
    current: f64,
    /// capacity
    #[parameter(tunable, start = 3, min = 0)]
    capacity: f64,
    /// open-circuit voltage
    #[parameter(tunable, start = 4)]
    source: f64,
    /// resistance
    #[parameter(tunable, start = 0.5)]
    resistance: f64,
    /// limit of the current
    #[parameter(start = 10)]
    max_current: f64,
    /// whether it is connected
    #[input(start = true)]
    is_connected: bool,
    /// number of cycles
    #[local]
    cycles: i32,
    /// voltage
    #[output]
    voltage: f64,
    /// mean temperature
    #[output]
    mean: f64,
}

/// A battery of many cells
#[derive(Model)]
struct Battery {
    /// the cells
    #[nested]
    cells: [Cell; 40],
    /// voltage
    #[output(initially_from("cells[40].source"))]
    voltage: f64,
}

impl Simulate for Battery {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        for cell in &mut self.cells {
            cell.voltage = cell.source - cell.resistance * cell.current;
            cell.mean = cell.temperature.iter().sum::<f64>() / 300.0;
        }
        self.voltage = self.cells.iter().map(|cell| cell.voltage).sum();
        Ok(())
    }
}

const CELLS: usize = table_size::<Battery>();
#[allow(long_running_const_eval, reason = "it has many variables")]
static BATTERY: [Entry; 1] = [Entry::new::<Battery, CELLS>(interface::<Battery, CELLS>(None), &[])];

/// The compiler finds 400 variables by their names without comparing all with each other, which would take it minutes.
#[test]
fn an_array_of_structs_with_hundreds_of_variables_compiles_and_works() {
    with_stack(|kind| {
        // The scalars of a cell are 300 temperatures and nine others, of which the current is the first.
        let [current, source, voltage] = [300, 302, 307].map(|of_first| of_first + 39 * 309);
        let token = Some(CString::new(BATTERY[0].guid()).unwrap());
        let it = Arguments::new(kind, 0).make(|a| (a.models, a.token) = (&BATTERY, token));
        let it = it.run(0.0);
        ok([it.set(current, 2.0), it.set(source, 5.0), it.step(0.0, 0.1)]);
        // 5 V - 0.5 ohm * 2 A, and 39 cells with 4 V.
        assert_eq!(it.get([voltage, 40 * 309]), [4.0, 160.0]);
        assert_eq!(it.get([voltage + 1]), [20.0]);
    });
}
