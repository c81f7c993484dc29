//! Functions common to all kinds of FMU (FMI 3.0.2, sections 2.2 and 2.3): version, lifecycle, logging,
//! events, configuration.

use std::ffi::CStr;
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::instance::Functions;
use super::{
    NULL_RESULT, calls, fmi3Boolean, fmi3False, fmi3Float64, fmi3Instance, fmi3Status, fmi3String,
    slice, text, variable, with,
};
use crate::component::Outcome;
use crate::instance::{Functions as _, functions};
use crate::lifecycle::Mode;
use crate::phase::Phase;

/// `fmi3GetVersion`
#[unsafe(no_mangle)]
pub extern "C" fn fmi3GetVersion() -> fmi3String {
    c"3.0".as_ptr()
}

/// `fmi3FreeInstance`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3FreeInstance(instance: fmi3Instance) {
    // SAFETY: the caller's promise: NULL or an instance that is not freed.
    if let Some(functions) = unsafe { functions::<Functions>(instance) } {
        let free = functions.common().free;
        // If the model's destructor panics, its memory leaks, but the host keeps running.
        // SAFETY: the functions are those of the instance.
        let _ = catch_unwind(AssertUnwindSafe(|| unsafe { free(instance) }));
    }
}

/// `fmi3SetDebugLogging`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetDebugLogging(
    instance: fmi3Instance,
    logging_on: fmi3Boolean,
    n_categories: usize,
    categories: *const fmi3String,
) -> fmi3Status {
    let call = &calls::SET_DEBUG_LOGGING;
    // SAFETY: the caller's promise: so many texts, or NULL.
    let names: Option<Vec<&CStr>> = unsafe { slice(categories, n_categories) }
        .and_then(|names| names.iter().map(|&name| unsafe { text(name) }).collect());
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |component| match names {
            Some(names) => component.set_debug_logging(call, logging_on != fmi3False, &names),
            None => component.refuse(call.name, "a category is NULL"),
        })
    }
}

/// `fmi3EnterInitializationMode`. A model that is not integrated here keeps its own tolerance.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3EnterInitializationMode(
    instance: fmi3Instance,
    tolerance_defined: fmi3Boolean,
    tolerance: fmi3Float64,
    start_time: fmi3Float64,
    stop_time_defined: fmi3Boolean,
    stop_time: fmi3Float64,
) -> fmi3Status {
    let stop = (stop_time_defined != fmi3False).then_some(stop_time);
    let tolerance = (tolerance_defined != fmi3False).then_some(tolerance);
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |component| {
            component.call(&calls::ENTER_INITIALIZATION_MODE, |c| {
                c.set_experiment(start_time, stop, tolerance)?;
                c.enter(Phase::Initialization);
                Ok(())
            })
        })
    }
}

macro_rules! changes {
    ($($function:ident: $call:ident -> $phase:ident;)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(instance: fmi3Instance) -> fmi3Status {
                // SAFETY: the caller's promise.
                unsafe { with(instance, |c| c.change_to(&calls::$call, Phase::$phase)) }
            }
        )*
    };
}

changes! {
    fmi3Terminate: TERMINATE -> Terminated;
    fmi3EnterContinuousTimeMode: ENTER_CONTINUOUS_TIME_MODE -> ContinuousTime;
}

/// `fmi3ExitInitializationMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3ExitInitializationMode(instance: fmi3Instance) -> fmi3Status {
    let call = &calls::EXIT_INITIALIZATION_MODE;
    // SAFETY: the caller's promise.
    unsafe { with(instance, |c| c.exit_initialization_mode(call)) }
}

/// `fmi3EnterStepMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3EnterStepMode(instance: fmi3Instance) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe { with(instance, |c| c.enter_step_mode(&calls::ENTER_STEP_MODE)) }
}

/// `fmi3Reset`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3Reset(instance: fmi3Instance) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe { with(instance, |c| c.reset(&calls::RESET)) }
}

/// `fmi3EnterEventMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3EnterEventMode(instance: fmi3Instance) -> fmi3Status {
    const NOT_USED: &str = "the instance was created without event mode: eventModeUsed was false";
    let call = &calls::ENTER_EVENT_MODE;
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |c| match c.lifecycle.mode {
            Mode::CoSimulation => c.refuse(call.name, NOT_USED),
            Mode::CoSimulationWithEvents | Mode::ModelExchange => c.call(call, |c| {
                // In step mode, nothing is computed for event mode.
                c.lifecycle.stale |= c.lifecycle.phase == Phase::StepComplete;
                c.enter(Phase::Event);
                Ok(())
            }),
        })
    }
}

/// `fmi3UpdateDiscreteStates`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3UpdateDiscreteStates(
    instance: fmi3Instance,
    discrete_states_need_update: *mut fmi3Boolean,
    terminate_simulation: *mut fmi3Boolean,
    nominals_of_continuous_states_changed: *mut fmi3Boolean,
    values_of_continuous_states_changed: *mut fmi3Boolean,
    next_event_time_defined: *mut fmi3Boolean,
    next_event_time: *mut fmi3Float64,
) -> fmi3Status {
    let call = &calls::UPDATE_DISCRETE_STATES;
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |component| {
            let flags = [
                discrete_states_need_update,
                terminate_simulation,
                nominals_of_continuous_states_changed,
                values_of_continuous_states_changed,
                next_event_time_defined,
            ];
            if flags.iter().any(|flag| flag.is_null()) || next_event_time.is_null() {
                return component.refuse(call.name, NULL_RESULT);
            }
            match component.update_discrete_states(call) {
                Ok(update) => {
                    let values = [
                        false,
                        false,
                        false,
                        update.states_changed,
                        update.next_event.is_some(),
                    ];
                    for (flag, value) in flags.into_iter().zip(values) {
                        flag.write(value.into());
                    }
                    next_event_time.write(update.next_event.unwrap_or_default());
                    Outcome::Ok
                }
                Err(outcome) => outcome,
            }
        })
    }
}

/// `fmi3EnterConfigurationMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3EnterConfigurationMode(instance: fmi3Instance) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |c| {
            c.enter_configuration_mode(&calls::ENTER_CONFIGURATION_MODE)
        })
    }
}

/// `fmi3ExitConfigurationMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3ExitConfigurationMode(instance: fmi3Instance) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |c| {
            c.exit_configuration_mode(&calls::EXIT_CONFIGURATION_MODE)
        })
    }
}

/// The numbers that a host asks for by a function with one result.
macro_rules! lengths {
    ($($function:ident = $which:ident($call:ident);)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(
                instance: fmi3Instance,
                length: *mut usize,
            ) -> fmi3Status {
                let call = &calls::$call;
                // SAFETY: the caller's promise.
                unsafe {
                    with(instance, |component| match variable(length) {
                        Some(length) => component.call(call, |c| {
                            *length = c.slave().length(crate::slave::Numbers::$which);
                            Ok(())
                        }),
                        None => component.refuse(call.name, NULL_RESULT),
                    })
                }
            }
        )*
    };
}

lengths! {
    fmi3GetNumberOfEventIndicators = EventIndicators(GET_NUMBER_OF_EVENT_INDICATORS);
    fmi3GetNumberOfContinuousStates = States(GET_NUMBER_OF_STATES);
}
