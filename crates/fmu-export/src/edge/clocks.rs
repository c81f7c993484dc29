//! The C functions of models with clocks. Libraries without such models do not contain them.

use std::ffi::c_int;

use fmi_abi::fmi3::*;
use fmi_abi::{c_type, fmi3_functions};

use crate::clock_functions::ClockFunctions;
use crate::fast::{self, call};
use crate::instance::{Instance, Status, UPDATES_AFTERWARDS};
use crate::pointers::{NULL_ARRAY, slice, slice_mut};

fmi3_functions!(clock_functions!);

/// Ends an update of clocks, also if the instance has failed in it.
fn end_clock_update(instance: &mut Instance) -> Status {
    instance.end_clock_update();
    Status::Ok
}

/// Computes a model partition, and tells the host of news about clocks.
///
/// # Safety
/// The host's promises, as for all entry points.
unsafe fn activate(instance: fmi3Instance, clock: u32, time: f64) -> fmi3Status {
    let (operation, mut update) = (&calls::fmi3ActivateModelPartition, None);
    // SAFETY: the caller's promises.
    unsafe {
        let status = call(instance, operation, |instance| {
            if UPDATES_AFTERWARDS {
                instance.end_clock_update();
            }
            instance.activate_model_partition(clock, time)?;
            update = instance.begin_clock_update();
            Ok(())
        });
        // The host may call functions of the instance, which no call uses now.
        if let Some(update) = update {
            fast::call_back(instance, || update());
            if !UPDATES_AFTERWARDS {
                fast::use_instance(instance, operation, end_clock_update);
            }
        }
        fmi3Status(status as c_int)
    }
}
