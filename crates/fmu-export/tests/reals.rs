//! Sets and gets of Reals between steps: the quick way does what the checked one does, or leaves it.

use std::ffi::CString;
use std::ptr::null;

use fmu_export::fmi2::fmi2Status::{fmi2Error, fmi2Fatal, fmi2OK};
use fmu_export::fmi2::{fmi2Component, fmi2Status};
use fmu_export::{Model, ModelError, Variable};
use serde::{Deserialize, Serialize};

/// More variables than the quick way has code of its own for, of every kind.
#[derive(Default, Clone, Serialize, Deserialize)]
struct Wide {
    inputs: [f64; 6],
    fixed: f64,
    flag: bool,
    many: Vec<f64>,
    last: f64,
    fuse: f64,
}

type Row = Variable<Wide>;

const FIXED: u32 = 6;
const FLAG: u32 = 7;
const MANY: u32 = 8;
const LAST: u32 = 68;
const FUSE: u32 = 69;
const BOMB: u32 = 70;

impl Model for Wide {
    const NAME: &'static str = "Wide";
    const DESCRIPTION: &'static str = "Many variables";
    const VARIABLES: &'static [Row] = &[
        Row::input("u0", |m| &mut m.inputs[0]).about("input"),
        Row::input("u1", |m| &mut m.inputs[1])
            .at_most(10.0)
            .about("input"),
        Row::input("u2", |m| &mut m.inputs[2])
            .at_least(-1.0)
            .about("input"),
        Row::input("u3", |m| &mut m.inputs[3]).about("input"),
        Row::input("u4", |m| &mut m.inputs[4]).about("input"),
        Row::input("u5", |m| &mut m.inputs[5]).about("input"),
        Row::fixed("fixed", 1.0, |m| &mut m.fixed).about("fixed"),
        Row::flag("flag", false, |m| &mut m.flag).about("flag"),
        Row::output_array("many", 60, |m| &mut m.many).about("shorter in the model"),
        Row::tunable("last", 5.0, |m| &mut m.last).about("past the first 48"),
        Row::tunable("fuse", 0.0, |m| &mut m.fuse).about("arms the bomb"),
        Row::tunable("bomb", 0.0, |m| {
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

fmu_export::export!(Wide);

// The functions under test are those that a host finds in the library.
unsafe extern "C" {
    fn fmi2EnterInitializationMode(c: fmi2Component) -> fmi2Status;
    fn fmi2ExitInitializationMode(c: fmi2Component) -> fmi2Status;
    fn fmi2GetReal(c: fmi2Component, r: *const u32, n: usize, v: *mut f64) -> fmi2Status;
    fn fmi2SetReal(c: fmi2Component, r: *const u32, n: usize, v: *const f64) -> fmi2Status;
    fn fmi2DoStep(c: fmi2Component, time: f64, step: f64, new: i32) -> fmi2Status;
    fn fmi2FreeInstance(c: fmi2Component);
}

/// An instance between steps.
struct Slave(fmi2Component);

impl Slave {
    fn new() -> Self {
        let name = CString::new("wide").unwrap();
        let guid = CString::new(MODELS[0].guid()).unwrap();
        // SAFETY: texts end in zero and live through the call; the other pointers are NULL.
        unsafe {
            let c = fmi2Instantiate(name.as_ptr(), 1, guid.as_ptr(), null(), null(), 0, 0);
            assert_eq!(fmi2EnterInitializationMode(c), fmi2OK);
            assert_eq!(fmi2ExitInitializationMode(c), fmi2OK);
            Self(c)
        }
    }

    fn set(&self, references: &[u32], values: &[f64]) -> fmi2Status {
        assert_eq!(references.len(), values.len());
        // SAFETY: the instance lives, and both arrays have as many elements.
        unsafe { fmi2SetReal(self.0, references.as_ptr(), values.len(), values.as_ptr()) }
    }

    /// Reads into an array that held -7 before.
    fn get(&self, references: &[u32]) -> (fmi2Status, Vec<f64>) {
        let mut values = vec![-7.0; references.len()];
        // SAFETY: the instance lives, and both arrays have as many elements.
        let status = unsafe {
            fmi2GetReal(
                self.0,
                references.as_ptr(),
                values.len(),
                values.as_mut_ptr(),
            )
        };
        (status, values)
    }
}

impl Drop for Slave {
    fn drop(&mut self) {
        // SAFETY: the instance lives until here.
        unsafe { fmi2FreeInstance(self.0) };
    }
}

#[test]
fn any_number_of_values_comes_back() {
    let slave = Slave::new();
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
fn a_set_that_is_refused_changes_nothing() {
    let slave = Slave::new();
    let bad = [
        (1, 10.5),
        (2, -1.5),
        (3, f64::NAN),
        (3, f64::INFINITY),
        (3, f64::NEG_INFINITY),
        (FIXED, 1.0),
        (FLAG, 1.0),
        (MANY, 1.0),
        (71, 1.0),
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
fn bounds_belong_to_the_values_allowed() {
    let slave = Slave::new();
    let extremes = [f64::MAX, 10.0, -1.0];
    assert_eq!(slave.set(&[0, 1, 2], &extremes), fmi2OK);
    assert_eq!(slave.get(&[0, 1, 2]), (fmi2OK, extremes.to_vec()));
}

#[test]
fn a_get_that_is_refused_hands_out_nothing() {
    let slave = Slave::new();
    assert_eq!(slave.get(&[MANY + 3, MANY + 49]), (fmi2OK, vec![3.0, 49.0]));
    // The model's array ends before that of the table.
    for reference in [FLAG, MANY + 50, 71, u32::MAX] {
        assert_eq!(slave.get(&[reference]), (fmi2Error, vec![-7.0]));
        assert_eq!(slave.get(&[0, reference, 1]), (fmi2Error, vec![-7.0; 3]));
    }
}

#[test]
fn a_panic_in_the_way_to_a_value_is_stopped() {
    for get in [true, false] {
        let slave = Slave::new();
        assert_eq!(slave.get(&[BOMB]), (fmi2OK, vec![0.0]));
        assert_eq!(slave.set(&[FUSE], &[1.0]), fmi2OK);
        if get {
            assert_eq!(slave.get(&[BOMB]), (fmi2Fatal, vec![-7.0]));
        } else {
            assert_eq!(slave.set(&[BOMB], &[0.0]), fmi2Fatal);
        }
        assert_eq!(slave.get(&[0]), (fmi2Fatal, vec![-7.0]));
    }
}

#[test]
fn a_cycle_allocates_nothing() {
    let slave = Slave::new();
    let (references, values) = ([0, 1, 2], [1.0, 2.0, 0.5]);
    let mut last = [0.0];
    let allocations = allocation_counter::measure(|| {
        for k in 0..1000 {
            assert_eq!(slave.set(&references, &values), fmi2OK);
            // SAFETY: the instance lives, and the arrays have one element.
            unsafe {
                let time = f64::from(k) * 0.001;
                assert_eq!(fmi2DoStep(slave.0, time, 0.001, 1), fmi2OK);
                assert_eq!(fmi2GetReal(slave.0, &LAST, 1, last.as_mut_ptr()), fmi2OK);
            }
        }
    });
    assert_eq!(allocations.count_total, 0);
}
