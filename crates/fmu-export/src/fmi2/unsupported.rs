//! Functions that the model description declares as unsupported. Importers bind them anyway, so each
//! returns `fmi2Error` and logs the reason.

use super::{
    fmi2Boolean, fmi2Component, fmi2EventInfo, fmi2Integer, fmi2Real, fmi2Status, fmi2StatusKind,
    fmi2String, fmi2ValueReference, with,
};

const MODEL_EXCHANGE: &str = "this FMU is for co-simulation, not for model exchange";
const SYNCHRONOUS: &str = "the slave steps synchronously: canRunAsynchronuously is false";
const OUTPUT_DERIVATIVES: &str = "maxOutputDerivativeOrder is 0";

macro_rules! unsupported {
    ($($function:ident($($argument:ty),*): $reason:expr;)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(c: fmi2Component, $(_: $argument),*) -> fmi2Status {
                // SAFETY: the caller's promise.
                unsafe { with(c, |component| component.refuse(stringify!($function), $reason)) }
            }
        )*
    };
}

unsupported! {
    fmi2GetRealOutputDerivatives(
        *const fmi2ValueReference,
        usize,
        *const fmi2Integer,
        *mut fmi2Real
    ): OUTPUT_DERIVATIVES;
    fmi2CancelStep(): SYNCHRONOUS;
    fmi2GetStatus(fmi2StatusKind, *mut fmi2Status): SYNCHRONOUS;
    fmi2GetIntegerStatus(fmi2StatusKind, *mut fmi2Integer): SYNCHRONOUS;
    fmi2GetStringStatus(fmi2StatusKind, *mut fmi2String): SYNCHRONOUS;

    fmi2EnterEventMode(): MODEL_EXCHANGE;
    fmi2NewDiscreteStates(*mut fmi2EventInfo): MODEL_EXCHANGE;
    fmi2EnterContinuousTimeMode(): MODEL_EXCHANGE;
    fmi2CompletedIntegratorStep(fmi2Boolean, *mut fmi2Boolean, *mut fmi2Boolean): MODEL_EXCHANGE;
    fmi2SetTime(fmi2Real): MODEL_EXCHANGE;
    fmi2SetContinuousStates(*const fmi2Real, usize): MODEL_EXCHANGE;
    fmi2GetDerivatives(*mut fmi2Real, usize): MODEL_EXCHANGE;
    fmi2GetEventIndicators(*mut fmi2Real, usize): MODEL_EXCHANGE;
    fmi2GetContinuousStates(*mut fmi2Real, usize): MODEL_EXCHANGE;
    fmi2GetNominalsOfContinuousStates(*mut fmi2Real, usize): MODEL_EXCHANGE;
}
