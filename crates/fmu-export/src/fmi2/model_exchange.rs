//! Functions of model exchange (FMI 2.0.5, section 3.2).

use super::{
    NULL_ARRAY, NULL_RESULT, calls, fmi2Boolean, fmi2Component, fmi2EventInfo, fmi2False, fmi2Real,
    fmi2Status, slice, slice_mut, variable, with,
};
use crate::component::Outcome;
use crate::phase::Phase;
use crate::slave::Numbers;

/// `fmi2EnterEventMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2EnterEventMode(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.change_to(&calls::ENTER_EVENT_MODE, Phase::Event)
        })
    }
}

/// `fmi2NewDiscreteStates`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2NewDiscreteStates(
    c: fmi2Component,
    event_info: *mut fmi2EventInfo,
) -> fmi2Status {
    let call = &calls::NEW_DISCRETE_STATES;
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            let Some(info) = variable(event_info) else {
                return component.refuse(call.name, NULL_RESULT);
            };
            match component.update_discrete_states(call) {
                Ok(update) => {
                    *info = fmi2EventInfo {
                        newDiscreteStatesNeeded: fmi2False,
                        terminateSimulation: fmi2False,
                        nominalsOfContinuousStatesChanged: fmi2False,
                        valuesOfContinuousStatesChanged: update.states_changed.into(),
                        nextEventTimeDefined: update.next_event.is_some().into(),
                        nextEventTime: update.next_event.unwrap_or_default(),
                    };
                    Outcome::Ok
                }
                Err(outcome) => outcome,
            }
        })
    }
}

/// `fmi2EnterContinuousTimeMode`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2EnterContinuousTimeMode(c: fmi2Component) -> fmi2Status {
    let call = &calls::ENTER_CONTINUOUS_TIME_MODE;
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.change_to(call, Phase::ContinuousTime)
        })
    }
}

/// `fmi2CompletedIntegratorStep`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2CompletedIntegratorStep(
    c: fmi2Component,
    _no_set_fmu_state_prior_to_current_point: fmi2Boolean,
    enter_event_mode: *mut fmi2Boolean,
    terminate_simulation: *mut fmi2Boolean,
) -> fmi2Status {
    let call = &calls::COMPLETED_INTEGRATOR_STEP;
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            let results = variable(enter_event_mode).zip(variable(terminate_simulation));
            let Some((event, terminate)) = results else {
                return component.refuse(call.name, NULL_RESULT);
            };
            component.call(call, |_| {
                (*event, *terminate) = (fmi2False, fmi2False);
                Ok(())
            })
        })
    }
}

/// `fmi2SetTime`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetTime(c: fmi2Component, time: fmi2Real) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe { with(c, |component| component.set_time(&calls::SET_TIME, time)) }
}

/// `fmi2SetContinuousStates`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetContinuousStates(
    c: fmi2Component,
    states: *const fmi2Real,
    n: usize,
) -> fmi2Status {
    let call = &calls::SET_CONTINUOUS_STATES;
    // SAFETY: the caller's promise: `n` elements, or NULL.
    unsafe {
        with(c, |component| match slice(states, n) {
            Some(states) => component.set_states(call, states),
            None => component.refuse(call.name, NULL_ARRAY),
        })
    }
}

macro_rules! numbers {
    ($($function:ident = $which:ident($call:ident);)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(
                c: fmi2Component,
                values: *mut fmi2Real,
                n: usize,
            ) -> fmi2Status {
                let call = &calls::$call;
                // SAFETY: the caller's promise: `n` elements, or NULL.
                unsafe {
                    with(c, |component| match slice_mut(values, n) {
                        Some(values) => component.read(call, Numbers::$which, values),
                        None => component.refuse(call.name, NULL_ARRAY),
                    })
                }
            }
        )*
    };
}

numbers! {
    fmi2GetDerivatives = Derivatives(GET_DERIVATIVES);
    fmi2GetEventIndicators = EventIndicators(GET_EVENT_INDICATORS);
    fmi2GetContinuousStates = States(GET_CONTINUOUS_STATES);
    fmi2GetNominalsOfContinuousStates = Nominals(GET_NOMINALS);
}
