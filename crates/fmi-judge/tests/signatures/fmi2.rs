//! The 44 functions of FMI 2.0.

use std::mem::{align_of, offset_of, size_of};

use fmi::fmi2::binding as headers;
use fmu_export::fmi2 as ours;
use fmu_source::fmi2Instantiate;
use ours::*;

use crate::*;

impl Like<headers::fmi2Status> for ours::fmi2Status {}
impl Like<*mut headers::fmi2Status> for *mut ours::fmi2Status {}
impl Like<*const headers::fmi2CallbackFunctions> for *const ours::fmi2CallbackFunctions {}
impl Like<*mut headers::fmi2EventInfo> for *mut ours::fmi2EventInfo {}

macro_rules! proofs {
    ($($check:ident $function:ident $official:ident;)*) => {
        const FUNCTIONS: &[&str] = &[$(stringify!($function)),*];
        $(const _: () = $check($function, None as headers::$official);)*
        // Never called: compiling it is the proof.
        const _: fn(&fmu_host::Functions) = |host| {
            $($check(host.$function.unwrap(), None as headers::$official);)*
        };
    };
}

proofs! {
    alike0 fmi2GetTypesPlatform fmi2GetTypesPlatformTYPE;
    alike0 fmi2GetVersion fmi2GetVersionTYPE;
    alike4 fmi2SetDebugLogging fmi2SetDebugLoggingTYPE;
    alike7 fmi2Instantiate fmi2InstantiateTYPE;
    alike1 fmi2FreeInstance fmi2FreeInstanceTYPE;
    alike6 fmi2SetupExperiment fmi2SetupExperimentTYPE;
    alike1 fmi2EnterInitializationMode fmi2EnterInitializationModeTYPE;
    alike1 fmi2ExitInitializationMode fmi2ExitInitializationModeTYPE;
    alike1 fmi2Terminate fmi2TerminateTYPE;
    alike1 fmi2Reset fmi2ResetTYPE;
    alike4 fmi2GetReal fmi2GetRealTYPE;
    alike4 fmi2GetInteger fmi2GetIntegerTYPE;
    alike4 fmi2GetBoolean fmi2GetBooleanTYPE;
    alike4 fmi2GetString fmi2GetStringTYPE;
    alike4 fmi2SetReal fmi2SetRealTYPE;
    alike4 fmi2SetInteger fmi2SetIntegerTYPE;
    alike4 fmi2SetBoolean fmi2SetBooleanTYPE;
    alike4 fmi2SetString fmi2SetStringTYPE;
    alike2 fmi2GetFMUstate fmi2GetFMUstateTYPE;
    alike2 fmi2SetFMUstate fmi2SetFMUstateTYPE;
    alike2 fmi2FreeFMUstate fmi2FreeFMUstateTYPE;
    alike3 fmi2SerializedFMUstateSize fmi2SerializedFMUstateSizeTYPE;
    alike4 fmi2SerializeFMUstate fmi2SerializeFMUstateTYPE;
    alike4 fmi2DeSerializeFMUstate fmi2DeSerializeFMUstateTYPE;
    alike7 fmi2GetDirectionalDerivative fmi2GetDirectionalDerivativeTYPE;
    alike1 fmi2EnterEventMode fmi2EnterEventModeTYPE;
    alike2 fmi2NewDiscreteStates fmi2NewDiscreteStatesTYPE;
    alike1 fmi2EnterContinuousTimeMode fmi2EnterContinuousTimeModeTYPE;
    alike4 fmi2CompletedIntegratorStep fmi2CompletedIntegratorStepTYPE;
    alike2 fmi2SetTime fmi2SetTimeTYPE;
    alike3 fmi2SetContinuousStates fmi2SetContinuousStatesTYPE;
    alike3 fmi2GetDerivatives fmi2GetDerivativesTYPE;
    alike3 fmi2GetEventIndicators fmi2GetEventIndicatorsTYPE;
    alike3 fmi2GetContinuousStates fmi2GetContinuousStatesTYPE;
    alike3 fmi2GetNominalsOfContinuousStates fmi2GetNominalsOfContinuousStatesTYPE;
    alike5 fmi2SetRealInputDerivatives fmi2SetRealInputDerivativesTYPE;
    alike5 fmi2GetRealOutputDerivatives fmi2GetRealOutputDerivativesTYPE;
    alike4 fmi2DoStep fmi2DoStepTYPE;
    alike1 fmi2CancelStep fmi2CancelStepTYPE;
    alike3 fmi2GetStatus fmi2GetStatusTYPE;
    alike3 fmi2GetRealStatus fmi2GetRealStatusTYPE;
    alike3 fmi2GetIntegerStatus fmi2GetIntegerStatusTYPE;
    alike3 fmi2GetBooleanStatus fmi2GetBooleanStatusTYPE;
    alike3 fmi2GetStringStatus fmi2GetStringStatusTYPE;
}

/// The logger has a variable number of arguments.
const fn alike_loggers(
    _: unsafe extern "C" fn(
        ours::fmi2ComponentEnvironment,
        ours::fmi2String,
        ours::fmi2Status,
        ours::fmi2String,
        ours::fmi2String,
        ...
    ),
    _: Option<
        unsafe extern "C" fn(
            ours::fmi2ComponentEnvironment,
            ours::fmi2String,
            headers::fmi2Status,
            ours::fmi2String,
            ours::fmi2String,
            ...
        ),
    >,
) {
}

const _: fn(ours::fmi2CallbackLogger, headers::fmi2CallbackLogger) = |mine, official| {
    alike_loggers(mine, official);
};

macro_rules! same_layout {
    ($structure:ident: $($field:ident),*) => {
        const _: () = {
            type Mine = ours::$structure;
            type Official = headers::$structure;
            assert!(size_of::<Mine>() == size_of::<Official>());
            assert!(align_of::<Mine>() == align_of::<Official>());
            $(assert!(offset_of!(Mine, $field) == offset_of!(Official, $field));)*
        };
    };
}

same_layout!(fmi2CallbackFunctions:
    logger, allocateMemory, freeMemory, stepFinished, componentEnvironment);
same_layout!(fmi2EventInfo:
    newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged,
    valuesOfContinuousStatesChanged, nextEventTimeDefined, nextEventTime);

const _: () = {
    assert!(size_of::<ours::fmi2Status>() == size_of::<headers::fmi2Status>());
    assert!(fmi2Status::fmi2OK as u32 == headers::fmi2Status_fmi2OK);
    assert!(fmi2Status::fmi2Warning as u32 == headers::fmi2Status_fmi2Warning);
    assert!(fmi2Status::fmi2Discard as u32 == headers::fmi2Status_fmi2Discard);
    assert!(fmi2Status::fmi2Error as u32 == headers::fmi2Status_fmi2Error);
    assert!(fmi2Status::fmi2Fatal as u32 == headers::fmi2Status_fmi2Fatal);
    assert!(fmi2Status::fmi2Pending as u32 == headers::fmi2Status_fmi2Pending);
    assert!(ours::fmi2CoSimulation as u32 == headers::fmi2Type_fmi2CoSimulation);
    assert!(ours::fmi2LastSuccessfulTime as u32 == headers::fmi2StatusKind_fmi2LastSuccessfulTime);
    assert!(ours::fmi2Terminated as u32 == headers::fmi2StatusKind_fmi2Terminated);
    assert!(ours::fmi2False as u32 == headers::fmi2False);
};

#[test]
fn all_44_functions_are_covered() {
    let mut names = FUNCTIONS.to_vec();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 44);
}
