//! The calls of a step in one call.

use super::call::CURRENT;
use super::methods::DoStepResult;
use crate::edge::fmi3::*;
use crate::pointers::Pointer;

/// Variables that every step sets or gets, as they are passed to C.
#[repr(C)]
pub struct Access {
    references: *const u32,
    n: usize,
    values: *mut f64,
    n_values: usize,
}

/// The calls of a step. `fmu-host` relies on this layout.
#[repr(C)]
pub struct Cycle {
    time: f64,
    step: f64,
    no_set_state: fmi3Boolean,
    /// How many of the calls have begun.
    begun: u8,
    stepped: DoStepResult,
    set: Access,
    get: Access,
}

/// Sets variables, takes a step and gets variables, in one call of a host, which otherwise takes most of its time to
/// enter and leave the component. It stops after a call that is no plain success.
#[unsafe(no_mangle)]
unsafe extern "C" fn fmu_export_cycle(instance: Pointer, cycle: &mut Cycle) -> fmi3Status {
    CURRENT.set(instance);
    let Cycle { time, step, no_set_state, begun, stepped, set, get } = cycle;
    // SAFETY: the host's promises.
    unsafe {
        *begun = 1;
        if set.n > 0 {
            let status = fmi3SetFloat64(instance, set.references, set.n, set.values, set.n_values);
            if status != fmi3OK {
                return status;
            }
        }
        *begun = 2;
        let (event, terminate) = (&mut stepped.event_handling_needed, &mut stepped.terminate);
        let (early, last) = (&mut stepped.early_return, &mut stepped.last_successful_time);
        let status =
            fmi3DoStep(instance, *time, *step, *no_set_state, event, terminate, early, last);
        if status != fmi3OK || *terminate != fmi3False || *early != fmi3False {
            return status;
        }
        *begun = 3;
        match get.n {
            0 => fmi3OK,
            n => fmi3GetFloat64(instance, get.references, n, get.values, get.n_values),
        }
    }
}
