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
