//! Functions that the model description declares as unsupported. Importers bind them anyway, so each
//! returns `fmi3Error` and logs the reason.

use super::{
    fmi3Boolean, fmi3Clock, fmi3ClockUpdateCallback, fmi3DependencyKind, fmi3Float64, fmi3Instance,
    fmi3InstanceEnvironment, fmi3IntervalQualifier, fmi3LogMessageCallback, fmi3PreemptionCallback,
    fmi3Status, fmi3String, fmi3UInt64, fmi3ValueReference, logger, with,
};
use crate::log::{Category, Log};

const CLOCKS: &str = "the model has no clocks";
const SCHEDULED: &str =
    "the FMU is not for scheduled execution; expected model exchange or co-simulation";
const DEPENDENCIES: &str =
    "providesPerElementDependencies is false; the model description has the dependencies";
const EVALUATE: &str = "providesEvaluateDiscreteStates is false";

macro_rules! unsupported {
    ($($function:ident($($argument:ty),*): $reason:expr;)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(
                instance: fmi3Instance,
                $(_: $argument),*
            ) -> fmi3Status {
                // SAFETY: the caller's promise.
                unsafe { with(instance, |component| component.refuse(stringify!($function), $reason)) }
            }
        )*
    };
}

type References = *const fmi3ValueReference;

unsupported! {
    fmi3GetClock(References, usize, *mut fmi3Clock): CLOCKS;
    fmi3SetClock(References, usize, *const fmi3Clock): CLOCKS;
    fmi3GetIntervalDecimal(References, usize, *mut fmi3Float64, *mut fmi3IntervalQualifier): CLOCKS;
    fmi3GetIntervalFraction(
        References,
        usize,
        *mut fmi3UInt64,
        *mut fmi3UInt64,
        *mut fmi3IntervalQualifier
    ): CLOCKS;
    fmi3GetShiftDecimal(References, usize, *mut fmi3Float64): CLOCKS;
    fmi3GetShiftFraction(References, usize, *mut fmi3UInt64, *mut fmi3UInt64): CLOCKS;
    fmi3SetIntervalDecimal(References, usize, *const fmi3Float64): CLOCKS;
    fmi3SetIntervalFraction(References, usize, *const fmi3UInt64, *const fmi3UInt64): CLOCKS;
    fmi3SetShiftDecimal(References, usize, *const fmi3Float64): CLOCKS;
    fmi3SetShiftFraction(References, usize, *const fmi3UInt64, *const fmi3UInt64): CLOCKS;
    fmi3ActivateModelPartition(fmi3ValueReference, fmi3Float64): SCHEDULED;
    fmi3EvaluateDiscreteStates(): EVALUATE;
    fmi3GetNumberOfVariableDependencies(fmi3ValueReference, *mut usize): DEPENDENCIES;
    fmi3GetVariableDependencies(
        fmi3ValueReference,
        *mut usize,
        *mut fmi3ValueReference,
        *mut usize,
        *mut fmi3DependencyKind,
        usize
    ): DEPENDENCIES;
}

/// `fmi3InstantiateScheduledExecution`, which logs that it is not supported and returns NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3InstantiateScheduledExecution(
    _instance_name: fmi3String,
    _instantiation_token: fmi3String,
    _resource_path: fmi3String,
    _visible: fmi3Boolean,
    _logging_on: fmi3Boolean,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
    _clock_update: Option<fmi3ClockUpdateCallback>,
    _lock_preemption: Option<fmi3PreemptionCallback>,
    _unlock_preemption: Option<fmi3PreemptionCallback>,
) -> fmi3Instance {
    let log = Log::new(logger::sink(environment, log_message), false);
    log.send(Category::Error, || {
        format!("fmi3InstantiateScheduledExecution: {SCHEDULED}")
    });
    std::ptr::null_mut()
}
