//! Setting and getting Reals between steps: the fast path behaves like the slow one.

use fmu_export::fmi2::{fmi2Error, fmi2OK, fmi2Status};

use crate::host;
use crate::models::{SAMPLED, WIDE};

// References of variables of the model `Wide`.
const FIXED: u32 = 6;
const FLAG: u32 = 7;
const MANY: u32 = 8;
const LAST: u32 = 68;
const COUNT: u32 = 69;

/// An instance between steps.
struct Slave(host::Slave);

impl Slave {
    fn new() -> Self {
        let mut slave = host::Slave::of(WIDE);
        slave.start(0.0, None);
        Self(slave)
    }

    fn set(&mut self, references: &[u32], values: &[f64]) -> fmi2Status {
        self.0.set_reals(references, values)
    }

    /// Reads into an array filled with -7.
    fn get(&mut self, references: &[u32]) -> (fmi2Status, Vec<f64>) {
        let mut values = vec![-7.0; references.len()];
        (self.0.get_reals(references, &mut values), values)
    }
}

#[test]
fn any_number_of_values_round_trips() {
    let mut slave = Slave::new();
    for n in 0..=6 {
        let references: Vec<u32> = (0..n).collect();
        let values: Vec<f64> = references.iter().map(|&r| f64::from(r + n)).collect();
        assert_eq!(slave.set(&references, &values), fmi2OK);
        assert_eq!(slave.get(&references), (fmi2OK, values));
    }
    assert_eq!(slave.set(&[LAST, 0], &[3.0, 4.0]), fmi2OK);
    assert_eq!(slave.get(&[0, LAST, FIXED]), (fmi2OK, vec![4.0, 3.0, 1.0]));
}

#[test]
fn a_rejected_set_changes_nothing() {
    let mut slave = Slave::new();
    let bad = [
        (1, 10.5),
        (2, -1.5),
        (3, f64::NAN),
        (3, f64::INFINITY),
        (3, f64::NEG_INFINITY),
        (FIXED, 1.0),
        (FLAG, 1.0),
        (MANY, 1.0),
        (COUNT, 1.0),
        (u32::MAX, 1.0),
    ];
    for (reference, value) in bad {
        assert_eq!(slave.set(&[reference], &[value]), fmi2Error);
        assert_eq!(slave.set(&[0, reference, 4], &[1.0, value, 1.0]), fmi2Error);
        let (five, values) = ([0, 3, 4, 5, reference], [1.0, 1.0, 1.0, 1.0, value]);
        assert_eq!(slave.set(&five, &values), fmi2Error);
        assert_eq!(
            slave.get(&[0, 3, 4, 5]),
            (fmi2OK, vec![0.0; 4]),
            "{reference}"
        );
    }
}

#[test]
fn bounds_are_inclusive() {
    let mut slave = Slave::new();
    let extremes = [f64::MAX, 10.0, -1.0];
    assert_eq!(slave.set(&[0, 1, 2], &extremes), fmi2OK);
    assert_eq!(slave.get(&[0, 1, 2]), (fmi2OK, extremes.to_vec()));
}

#[test]
fn a_rejected_get_returns_nothing() {
    let mut slave = Slave::new();
    assert_eq!(slave.get(&[MANY + 3, MANY + 59]), (fmi2OK, vec![3.0, 59.0]));
    for reference in [FLAG, COUNT, u32::MAX] {
        assert_eq!(slave.get(&[reference]), (fmi2Error, vec![-7.0]));
        assert_eq!(slave.get(&[0, reference, 1]), (fmi2Error, vec![-7.0; 3]));
    }
}

#[test]
fn a_simulation_cycle_does_not_allocate() {
    // The inputs and an output of a model without and one with a sample time.
    let cycles: [(usize, &[u32], u32); 2] = [(WIDE, &[0, 1, 2], LAST), (SAMPLED, &[7], 8)];
    for (model, references, output) in cycles {
        let mut slave = host::Slave::of(model);
        slave.start(0.0, None);
        let values = &[1.0, 2.0, 0.5][..references.len()];
        let mut last = [0.0];
        let allocations = allocation_counter::measure(|| {
            for k in 0..1000 {
                assert_eq!(slave.set_reals(references, values), fmi2OK);
                assert_eq!(slave.step(f64::from(k) * 0.001, 0.001), fmi2OK);
                assert_eq!(slave.get_reals(&[output], &mut last), fmi2OK);
            }
        });
        assert_eq!(allocations.count_total, 0);
    }
}
