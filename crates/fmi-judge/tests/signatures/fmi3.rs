//! The 75 functions of FMI 3.0.

use std::ffi::c_uint;

use fmi::fmi3::binding as headers;
use fmu_export::fmi3 as ours;
use fmu_source::{fmi3InstantiateCoSimulation, fmi3InstantiateModelExchange};
use ours::*;

use crate::*;

impl Like<c_uint> for ours::fmi3Status {}
// A `bool`, which is declared here as an integer to accept any value.
impl Like<bool> for ours::fmi3Boolean {}
impl Like<*mut bool> for *mut ours::fmi3Boolean {}
impl Like<*const bool> for *const ours::fmi3Boolean {}
// The callbacks are compared below.
impl Like<headers::fmi3LogMessageCallback> for Option<ours::fmi3LogMessageCallback> {}
impl Like<headers::fmi3IntermediateUpdateCallback>
    for Option<ours::fmi3IntermediateUpdateCallback>
{
}

macro_rules! proofs {
    ($($check:ident $function:ident $official:ident;)*) => {
        const FUNCTIONS: &[&str] = &[$(stringify!($function)),*];
        $(const _: () = $check($function, None as headers::$official);)*
        // Never called: compiling it is the proof.
        const _: fn(&fmu_host::Functions3) = |host| {
            $($check(host.$function.unwrap(), None as headers::$official);)*
        };
    };
}

proofs! {
    alike0 fmi3GetVersion fmi3GetVersionTYPE;
    alike4 fmi3SetDebugLogging fmi3SetDebugLoggingTYPE;
    alike7 fmi3InstantiateModelExchange fmi3InstantiateModelExchangeTYPE;
    alike12 fmi3InstantiateCoSimulation fmi3InstantiateCoSimulationTYPE;
    alike10 fmi3InstantiateScheduledExecution fmi3InstantiateScheduledExecutionTYPE;
    alike1 fmi3FreeInstance fmi3FreeInstanceTYPE;
    alike6 fmi3EnterInitializationMode fmi3EnterInitializationModeTYPE;
    alike1 fmi3ExitInitializationMode fmi3ExitInitializationModeTYPE;
    alike1 fmi3EnterEventMode fmi3EnterEventModeTYPE;
    alike1 fmi3Terminate fmi3TerminateTYPE;
    alike1 fmi3Reset fmi3ResetTYPE;
    alike5 fmi3GetFloat32 fmi3GetFloat32TYPE;
    alike5 fmi3GetFloat64 fmi3GetFloat64TYPE;
    alike5 fmi3GetInt8 fmi3GetInt8TYPE;
    alike5 fmi3GetUInt8 fmi3GetUInt8TYPE;
    alike5 fmi3GetInt16 fmi3GetInt16TYPE;
    alike5 fmi3GetUInt16 fmi3GetUInt16TYPE;
    alike5 fmi3GetInt32 fmi3GetInt32TYPE;
    alike5 fmi3GetUInt32 fmi3GetUInt32TYPE;
    alike5 fmi3GetInt64 fmi3GetInt64TYPE;
    alike5 fmi3GetUInt64 fmi3GetUInt64TYPE;
    alike5 fmi3GetBoolean fmi3GetBooleanTYPE;
    alike5 fmi3GetString fmi3GetStringTYPE;
    alike6 fmi3GetBinary fmi3GetBinaryTYPE;
    alike4 fmi3GetClock fmi3GetClockTYPE;
    alike5 fmi3SetFloat32 fmi3SetFloat32TYPE;
    alike5 fmi3SetFloat64 fmi3SetFloat64TYPE;
    alike5 fmi3SetInt8 fmi3SetInt8TYPE;
    alike5 fmi3SetUInt8 fmi3SetUInt8TYPE;
    alike5 fmi3SetInt16 fmi3SetInt16TYPE;
    alike5 fmi3SetUInt16 fmi3SetUInt16TYPE;
    alike5 fmi3SetInt32 fmi3SetInt32TYPE;
    alike5 fmi3SetUInt32 fmi3SetUInt32TYPE;
    alike5 fmi3SetInt64 fmi3SetInt64TYPE;
    alike5 fmi3SetUInt64 fmi3SetUInt64TYPE;
    alike5 fmi3SetBoolean fmi3SetBooleanTYPE;
    alike5 fmi3SetString fmi3SetStringTYPE;
    alike6 fmi3SetBinary fmi3SetBinaryTYPE;
    alike4 fmi3SetClock fmi3SetClockTYPE;
    alike3 fmi3GetNumberOfVariableDependencies fmi3GetNumberOfVariableDependenciesTYPE;
    alike7 fmi3GetVariableDependencies fmi3GetVariableDependenciesTYPE;
    alike2 fmi3GetFMUState fmi3GetFMUStateTYPE;
    alike2 fmi3SetFMUState fmi3SetFMUStateTYPE;
    alike2 fmi3FreeFMUState fmi3FreeFMUStateTYPE;
    alike3 fmi3SerializedFMUStateSize fmi3SerializedFMUStateSizeTYPE;
    alike4 fmi3SerializeFMUState fmi3SerializeFMUStateTYPE;
    alike4 fmi3DeserializeFMUState fmi3DeserializeFMUStateTYPE;
    alike9 fmi3GetDirectionalDerivative fmi3GetDirectionalDerivativeTYPE;
    alike9 fmi3GetAdjointDerivative fmi3GetAdjointDerivativeTYPE;
    alike1 fmi3EnterConfigurationMode fmi3EnterConfigurationModeTYPE;
    alike1 fmi3ExitConfigurationMode fmi3ExitConfigurationModeTYPE;
    alike5 fmi3GetIntervalDecimal fmi3GetIntervalDecimalTYPE;
    alike6 fmi3GetIntervalFraction fmi3GetIntervalFractionTYPE;
    alike4 fmi3GetShiftDecimal fmi3GetShiftDecimalTYPE;
    alike5 fmi3GetShiftFraction fmi3GetShiftFractionTYPE;
    alike4 fmi3SetIntervalDecimal fmi3SetIntervalDecimalTYPE;
    alike5 fmi3SetIntervalFraction fmi3SetIntervalFractionTYPE;
    alike4 fmi3SetShiftDecimal fmi3SetShiftDecimalTYPE;
    alike5 fmi3SetShiftFraction fmi3SetShiftFractionTYPE;
    alike1 fmi3EvaluateDiscreteStates fmi3EvaluateDiscreteStatesTYPE;
    alike7 fmi3UpdateDiscreteStates fmi3UpdateDiscreteStatesTYPE;
    alike1 fmi3EnterContinuousTimeMode fmi3EnterContinuousTimeModeTYPE;
    alike4 fmi3CompletedIntegratorStep fmi3CompletedIntegratorStepTYPE;
    alike2 fmi3SetTime fmi3SetTimeTYPE;
    alike3 fmi3SetContinuousStates fmi3SetContinuousStatesTYPE;
    alike3 fmi3GetContinuousStateDerivatives fmi3GetContinuousStateDerivativesTYPE;
    alike3 fmi3GetEventIndicators fmi3GetEventIndicatorsTYPE;
    alike3 fmi3GetContinuousStates fmi3GetContinuousStatesTYPE;
    alike3 fmi3GetNominalsOfContinuousStates fmi3GetNominalsOfContinuousStatesTYPE;
    alike2 fmi3GetNumberOfEventIndicators fmi3GetNumberOfEventIndicatorsTYPE;
    alike2 fmi3GetNumberOfContinuousStates fmi3GetNumberOfContinuousStatesTYPE;
    alike1 fmi3EnterStepMode fmi3EnterStepModeTYPE;
    alike6 fmi3GetOutputDerivatives fmi3GetOutputDerivativesTYPE;
    alike8 fmi3DoStep fmi3DoStepTYPE;
    alike3 fmi3ActivateModelPartition fmi3ActivateModelPartitionTYPE;
}

const _: fn(
    ours::fmi3LogMessageCallback,
    ours::fmi3IntermediateUpdateCallback,
    ours::fmi3ClockUpdateCallback,
    ours::fmi3PreemptionCallback,
) = |log, update, clock, preemption| {
    alike4(log, None as headers::fmi3LogMessageCallback);
    alike8(update, None as headers::fmi3IntermediateUpdateCallback);
    alike1(clock, None as headers::fmi3ClockUpdateCallback);
    alike0(preemption, None as headers::fmi3LockPreemptionCallback);
    alike0(preemption, None as headers::fmi3UnlockPreemptionCallback);
};

const _: () = {
    assert!(size_of::<ours::fmi3Status>() == size_of::<headers::fmi3Status>());
    assert!(size_of::<ours::fmi3Boolean>() == size_of::<headers::fmi3Boolean>());
    assert!(fmi3Status::fmi3OK as u32 == headers::fmi3Status_fmi3OK);
    assert!(fmi3Status::fmi3Warning as u32 == headers::fmi3Status_fmi3Warning);
    assert!(fmi3Status::fmi3Discard as u32 == headers::fmi3Status_fmi3Discard);
    assert!(fmi3Status::fmi3Error as u32 == headers::fmi3Status_fmi3Error);
    assert!(fmi3Status::fmi3Fatal as u32 == headers::fmi3Status_fmi3Fatal);
    assert!(ours::fmi3Independent as u32 == headers::fmi3DependencyKind_fmi3Independent);
    assert!(ours::fmi3Constant as u32 == headers::fmi3DependencyKind_fmi3Constant);
    assert!(ours::fmi3Fixed as u32 == headers::fmi3DependencyKind_fmi3Fixed);
    assert!(ours::fmi3Tunable as u32 == headers::fmi3DependencyKind_fmi3Tunable);
    assert!(ours::fmi3Discrete as u32 == headers::fmi3DependencyKind_fmi3Discrete);
    assert!(ours::fmi3Dependent as u32 == headers::fmi3DependencyKind_fmi3Dependent);
};

#[test]
fn all_75_functions_are_covered() {
    let mut names = FUNCTIONS.to_vec();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 75);
}
