//! A model that panics ends its instance, never the host.

use std::ffi::CString;
use std::ptr::{null, null_mut};

use fmu_export::fmi2::{fmi2Component, fmi2Status};
use fmu_export::{Model, ModelError, Variable};
use serde::{Deserialize, Serialize};

/// Panics in the step, or at the initialization if it is told so.
#[derive(Default, Clone, Serialize, Deserialize)]
struct Faulty {
    at_initialization: bool,
    y: f64,
}

type Row = Variable<Faulty>;

impl Model for Faulty {
    const NAME: &'static str = "Faulty";
    const DESCRIPTION: &'static str = "A model with a bug";
    const VARIABLES: &'static [Row] = &[
        Row::output("y", |m| &mut m.y).about("output"),
        Row::flag("at_initialization", false, |m| &mut m.at_initialization).about("when"),
    ];

    fn initialize(&mut self, _start_time: f64) -> Result<(), ModelError> {
        assert!(!self.at_initialization, "the bug shows early");
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        panic!("the bug shows in a step")
    }
}

fmu_export::export!(Faulty);

// The functions under test are those that a host finds in the library.
unsafe extern "C" {
    fn fmi2EnterInitializationMode(c: fmi2Component) -> fmi2Status;
    fn fmi2ExitInitializationMode(c: fmi2Component) -> fmi2Status;
    fn fmi2DoStep(c: fmi2Component, t: f64, h: f64, discard: i32) -> fmi2Status;
    fn fmi2GetReal(c: fmi2Component, r: *const u32, n: usize, v: *mut f64) -> fmi2Status;
    fn fmi2SetBoolean(c: fmi2Component, r: *const u32, n: usize, v: *const i32) -> fmi2Status;
    fn fmi2Reset(c: fmi2Component) -> fmi2Status;
    fn fmi2FreeInstance(c: fmi2Component);
}

fn instantiate() -> fmi2Component {
    let name = CString::new("faulty").unwrap();
    let guid = CString::new(MODELS[0].guid()).unwrap();
    // SAFETY: texts end in zero and live through the call; the other pointers are NULL.
    let instance =
        unsafe { fmi2Instantiate(name.as_ptr(), 1, guid.as_ptr(), null(), null(), 0, 1) };
    assert!(!instance.is_null());
    instance
}

/// Checks that only freeing is left, and frees.
fn assert_dead(instance: fmi2Component) {
    let mut value = 7.0;
    // SAFETY: the instance lives until it is freed here; arrays have one element.
    unsafe {
        assert_eq!(fmi2Reset(instance), fmi2Status::fmi2Fatal);
        assert_eq!(
            fmi2GetReal(instance, &0, 1, &mut value),
            fmi2Status::fmi2Fatal
        );
        assert_eq!(fmi2DoStep(instance, 0.0, 0.1, 0), fmi2Status::fmi2Fatal);
        assert_eq!(value, 7.0);
        fmi2FreeInstance(instance);
    }
}

#[test]
fn a_panic_in_a_step_kills_the_instance_only() {
    let (instance, other) = (instantiate(), instantiate());
    // SAFETY: the instances live until they are freed.
    unsafe {
        for c in [instance, other] {
            assert_eq!(fmi2EnterInitializationMode(c), fmi2Status::fmi2OK);
            assert_eq!(fmi2ExitInitializationMode(c), fmi2Status::fmi2OK);
        }
        assert_eq!(fmi2DoStep(instance, 0.0, 0.1, 0), fmi2Status::fmi2Fatal);
        assert_eq!(fmi2Reset(other), fmi2Status::fmi2OK);
        fmi2FreeInstance(other);
    }
    assert_dead(instance);
}

#[test]
fn a_panic_in_the_initialization_kills_the_instance_only() {
    let instance = instantiate();
    // SAFETY: the instance lives until it is freed; arrays have one element.
    unsafe {
        assert_eq!(
            fmi2SetBoolean(instance, &1, 1, &1),
            fmi2Status::fmi2OK,
            "parameter"
        );
        assert_eq!(fmi2EnterInitializationMode(instance), fmi2Status::fmi2OK);
        assert_eq!(fmi2ExitInitializationMode(instance), fmi2Status::fmi2Fatal);
    }
    assert_dead(instance);
}

#[test]
fn null_is_an_error_and_frees_nothing() {
    // SAFETY: NULL is what the functions are asked to bear.
    unsafe {
        assert_eq!(fmi2DoStep(null_mut(), 0.0, 0.1, 0), fmi2Status::fmi2Error);
        assert_eq!(fmi2Reset(null_mut()), fmi2Status::fmi2Error);
        fmi2FreeInstance(null_mut());
    }
}
