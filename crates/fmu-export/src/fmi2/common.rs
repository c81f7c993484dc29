//! Functions common to both kinds of FMU (FMI 2.0.5, section 2.1): version, lifecycle, logging.

use std::ffi::CStr;
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::{
    calls, fmi2Boolean, fmi2Component, fmi2False, fmi2Real, fmi2Status, fmi2String,
    instance::Functions, slice, text, with,
};
use crate::instance::functions;
use crate::phase::Phase;

/// `fmi2GetTypesPlatform`
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetTypesPlatform() -> fmi2String {
    c"default".as_ptr()
}

/// `fmi2GetVersion`
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetVersion() -> fmi2String {
    c"2.0".as_ptr()
}

/// `fmi2FreeInstance`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeInstance(c: fmi2Component) {
    // SAFETY: the caller's promise: NULL or an instance that is not freed.
    if let Some(functions) = unsafe { functions::<Functions>(c) } {
        // If the model's destructor panics, its memory leaks, but the host keeps running.
        // SAFETY: the functions are those of the instance.
        let _ = catch_unwind(AssertUnwindSafe(|| unsafe { (functions.common.free)(c) }));
    }
}

/// `fmi2SetDebugLogging`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetDebugLogging(
    c: fmi2Component,
    logging_on: fmi2Boolean,
    n: usize,
    categories: *const fmi2String,
) -> fmi2Status {
    // SAFETY: the caller's promise: `n` texts, or NULL.
    let names: Option<Vec<&CStr>> = unsafe { slice(categories, n) }
        .and_then(|names| names.iter().map(|&name| unsafe { text(name) }).collect());
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| match names {
            Some(names) => component.set_debug_logging(
                &calls::SET_DEBUG_LOGGING,
                logging_on != fmi2False,
                &names,
            ),
            None => component.refuse(calls::SET_DEBUG_LOGGING.name, "a category is NULL"),
        })
    }
}

/// `fmi2SetupExperiment`. A model that is not integrated here keeps its own tolerance: "An FMU for
/// Co-Simulation might ignore this argument" (FMI 2.0.5, section 2.1.6).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetupExperiment(
    c: fmi2Component,
    tolerance_defined: fmi2Boolean,
    tolerance: fmi2Real,
    start_time: fmi2Real,
    stop_time_defined: fmi2Boolean,
    stop_time: fmi2Real,
) -> fmi2Status {
    let stop = (stop_time_defined != fmi2False).then_some(stop_time);
    let tolerance = (tolerance_defined != fmi2False).then_some(tolerance);
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.setup_experiment(&calls::SETUP_EXPERIMENT, start_time, stop, tolerance)
        })
    }
}

/// `fmi2EnterInitializationMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2EnterInitializationMode(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.enter_initialization_mode(&calls::ENTER_INITIALIZATION_MODE)
        })
    }
}

/// `fmi2ExitInitializationMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2ExitInitializationMode(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.exit_initialization_mode(&calls::EXIT_INITIALIZATION_MODE)
        })
    }
}

/// `fmi2Terminate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Terminate(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.change_to(&calls::TERMINATE, Phase::Terminated)
        })
    }
}

/// `fmi2Reset`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Reset(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe { with(c, |component| component.reset(&calls::RESET)) }
}
