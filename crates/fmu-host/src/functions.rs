//! The functions of FMI 2.0 and 3.0 with their types, and looking them up in a library.

use std::ffi::{c_char, c_int};

use fmu_types::fmi2::{
    fmi2Boolean, fmi2CallbackFunctions, fmi2Component, fmi2EventInfo, fmi2FMUstate, fmi2Integer,
    fmi2Real, fmi2StatusKind, fmi2String, fmi2Type, fmi2ValueReference,
};
use fmu_types::fmi3::{
    fmi3Binary, fmi3Boolean, fmi3Byte, fmi3Clock, fmi3ClockUpdateCallback, fmi3DependencyKind,
    fmi3FMUState, fmi3Float32, fmi3Float64, fmi3Instance, fmi3InstanceEnvironment, fmi3Int8,
    fmi3Int16, fmi3Int32, fmi3Int64, fmi3IntermediateUpdateCallback, fmi3IntervalQualifier,
    fmi3LogMessageCallback, fmi3PreemptionCallback, fmi3String, fmi3UInt8, fmi3UInt16, fmi3UInt32,
    fmi3UInt64, fmi3ValueReference,
};

/// `fmi2Status` or `fmi3Status`, an integer because a foreign binary may return any value.
type Status = c_int;
/// Value references of FMI 2.0 and 3.0, which are the same integers.
type References = *const fmi2ValueReference;

macro_rules! functions {
    ($(#[$whole:meta])* $table:ident: $($(#[$about:meta])* $group:ident { $($name:ident($($type:ty),*) $(-> $result:ty)?;)* })*) => {
        $($(#[$about])* pub(crate) const $group: &[&str] = &[$(stringify!($name)),*];)*

        $(#[$whole])*
        #[derive(Default)]
        #[allow(non_snake_case, missing_docs, reason = "the names of the standard")]
        pub struct $table {
            $($(pub $name: Option<unsafe extern "C" fn($($type),*) $(-> $result)?>,)*)*
        }

        impl $table {
            /// Looks up all functions.
            pub(crate) fn of(library: &libloading::Library) -> Self {
                // SAFETY: the types are those of the standard; whoever loads the library trusts it
                // to follow the standard.
                unsafe {
                    Self {
                        $($($name: library.get(stringify!($name)).ok().map(|found| *found),)*)*
                    }
                }
            }
        }
    };
}

functions! {
    /// The functions of FMI 2.0 of a library, under their names in the standard.
    Functions:

    /// Functions of both kinds of FMU (FMI 2.0.5, section 2.1).
    COMMON {
        fmi2GetTypesPlatform() -> fmi2String;
        fmi2GetVersion() -> fmi2String;
        fmi2SetDebugLogging(fmi2Component, fmi2Boolean, usize, *const fmi2String) -> Status;
        fmi2Instantiate(
            fmi2String, fmi2Type, fmi2String, fmi2String, *const fmi2CallbackFunctions, fmi2Boolean,
            fmi2Boolean
        ) -> fmi2Component;
        fmi2FreeInstance(fmi2Component);
        fmi2SetupExperiment(
            fmi2Component, fmi2Boolean, fmi2Real, fmi2Real, fmi2Boolean, fmi2Real
        ) -> Status;
        fmi2EnterInitializationMode(fmi2Component) -> Status;
        fmi2ExitInitializationMode(fmi2Component) -> Status;
        fmi2Terminate(fmi2Component) -> Status;
        fmi2Reset(fmi2Component) -> Status;
        fmi2GetReal(fmi2Component, References, usize, *mut fmi2Real) -> Status;
        fmi2GetInteger(fmi2Component, References, usize, *mut fmi2Integer) -> Status;
        fmi2GetBoolean(fmi2Component, References, usize, *mut fmi2Boolean) -> Status;
        fmi2GetString(fmi2Component, References, usize, *mut fmi2String) -> Status;
        fmi2SetReal(fmi2Component, References, usize, *const fmi2Real) -> Status;
        fmi2SetInteger(fmi2Component, References, usize, *const fmi2Integer) -> Status;
        fmi2SetBoolean(fmi2Component, References, usize, *const fmi2Boolean) -> Status;
        fmi2SetString(fmi2Component, References, usize, *const fmi2String) -> Status;
        fmi2GetFMUstate(fmi2Component, *mut fmi2FMUstate) -> Status;
        fmi2SetFMUstate(fmi2Component, fmi2FMUstate) -> Status;
        fmi2FreeFMUstate(fmi2Component, *mut fmi2FMUstate) -> Status;
        fmi2SerializedFMUstateSize(fmi2Component, fmi2FMUstate, *mut usize) -> Status;
        fmi2SerializeFMUstate(fmi2Component, fmi2FMUstate, *mut c_char, usize) -> Status;
        fmi2DeSerializeFMUstate(fmi2Component, *const c_char, usize, *mut fmi2FMUstate) -> Status;
        fmi2GetDirectionalDerivative(
            fmi2Component, References, usize, References, usize, *const fmi2Real, *mut fmi2Real
        ) -> Status;
    }

    /// Functions for model exchange (section 3.2).
    MODEL_EXCHANGE {
        fmi2EnterEventMode(fmi2Component) -> Status;
        fmi2NewDiscreteStates(fmi2Component, *mut fmi2EventInfo) -> Status;
        fmi2EnterContinuousTimeMode(fmi2Component) -> Status;
        fmi2CompletedIntegratorStep(
            fmi2Component, fmi2Boolean, *mut fmi2Boolean, *mut fmi2Boolean
        ) -> Status;
        fmi2SetTime(fmi2Component, fmi2Real) -> Status;
        fmi2SetContinuousStates(fmi2Component, *const fmi2Real, usize) -> Status;
        fmi2GetDerivatives(fmi2Component, *mut fmi2Real, usize) -> Status;
        fmi2GetEventIndicators(fmi2Component, *mut fmi2Real, usize) -> Status;
        fmi2GetContinuousStates(fmi2Component, *mut fmi2Real, usize) -> Status;
        fmi2GetNominalsOfContinuousStates(fmi2Component, *mut fmi2Real, usize) -> Status;
    }

    /// Functions for co-simulation (section 4.2).
    CO_SIMULATION {
        fmi2SetRealInputDerivatives(
            fmi2Component, References, usize, *const fmi2Integer, *const fmi2Real
        ) -> Status;
        fmi2GetRealOutputDerivatives(
            fmi2Component, References, usize, *const fmi2Integer, *mut fmi2Real
        ) -> Status;
        fmi2DoStep(fmi2Component, fmi2Real, fmi2Real, fmi2Boolean) -> Status;
        fmi2CancelStep(fmi2Component) -> Status;
        fmi2GetStatus(fmi2Component, fmi2StatusKind, *mut Status) -> Status;
        fmi2GetRealStatus(fmi2Component, fmi2StatusKind, *mut fmi2Real) -> Status;
        fmi2GetIntegerStatus(fmi2Component, fmi2StatusKind, *mut fmi2Integer) -> Status;
        fmi2GetBooleanStatus(fmi2Component, fmi2StatusKind, *mut fmi2Boolean) -> Status;
        fmi2GetStringStatus(fmi2Component, fmi2StatusKind, *mut fmi2String) -> Status;
    }
}

functions! {
    /// The functions of FMI 3.0 of a library, under their names in the standard.
    Functions3:

    /// Functions of all interface types (FMI 3.0.2, section 2.2).
    COMMON_3 {
        fmi3GetVersion() -> fmi3String;
        fmi3SetDebugLogging(fmi3Instance, fmi3Boolean, usize, *const fmi3String) -> Status;
        fmi3InstantiateModelExchange(
            fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean, fmi3InstanceEnvironment,
            Option<fmi3LogMessageCallback>
        ) -> fmi3Instance;
        fmi3InstantiateCoSimulation(
            fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean, fmi3Boolean, fmi3Boolean,
            References, usize, fmi3InstanceEnvironment, Option<fmi3LogMessageCallback>,
            Option<fmi3IntermediateUpdateCallback>
        ) -> fmi3Instance;
        fmi3InstantiateScheduledExecution(
            fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean, fmi3InstanceEnvironment,
            Option<fmi3LogMessageCallback>, Option<fmi3ClockUpdateCallback>,
            Option<fmi3PreemptionCallback>, Option<fmi3PreemptionCallback>
        ) -> fmi3Instance;
        fmi3FreeInstance(fmi3Instance);
        fmi3EnterInitializationMode(
            fmi3Instance, fmi3Boolean, fmi3Float64, fmi3Float64, fmi3Boolean, fmi3Float64
        ) -> Status;
        fmi3ExitInitializationMode(fmi3Instance) -> Status;
        fmi3EnterEventMode(fmi3Instance) -> Status;
        fmi3Terminate(fmi3Instance) -> Status;
        fmi3Reset(fmi3Instance) -> Status;
        fmi3GetFloat32(fmi3Instance, References, usize, *mut fmi3Float32, usize) -> Status;
        fmi3SetFloat32(fmi3Instance, References, usize, *const fmi3Float32, usize) -> Status;
        fmi3GetFloat64(fmi3Instance, References, usize, *mut fmi3Float64, usize) -> Status;
        fmi3SetFloat64(fmi3Instance, References, usize, *const fmi3Float64, usize) -> Status;
        fmi3GetInt8(fmi3Instance, References, usize, *mut fmi3Int8, usize) -> Status;
        fmi3SetInt8(fmi3Instance, References, usize, *const fmi3Int8, usize) -> Status;
        fmi3GetUInt8(fmi3Instance, References, usize, *mut fmi3UInt8, usize) -> Status;
        fmi3SetUInt8(fmi3Instance, References, usize, *const fmi3UInt8, usize) -> Status;
        fmi3GetInt16(fmi3Instance, References, usize, *mut fmi3Int16, usize) -> Status;
        fmi3SetInt16(fmi3Instance, References, usize, *const fmi3Int16, usize) -> Status;
        fmi3GetUInt16(fmi3Instance, References, usize, *mut fmi3UInt16, usize) -> Status;
        fmi3SetUInt16(fmi3Instance, References, usize, *const fmi3UInt16, usize) -> Status;
        fmi3GetInt32(fmi3Instance, References, usize, *mut fmi3Int32, usize) -> Status;
        fmi3SetInt32(fmi3Instance, References, usize, *const fmi3Int32, usize) -> Status;
        fmi3GetUInt32(fmi3Instance, References, usize, *mut fmi3UInt32, usize) -> Status;
        fmi3SetUInt32(fmi3Instance, References, usize, *const fmi3UInt32, usize) -> Status;
        fmi3GetInt64(fmi3Instance, References, usize, *mut fmi3Int64, usize) -> Status;
        fmi3SetInt64(fmi3Instance, References, usize, *const fmi3Int64, usize) -> Status;
        fmi3GetUInt64(fmi3Instance, References, usize, *mut fmi3UInt64, usize) -> Status;
        fmi3SetUInt64(fmi3Instance, References, usize, *const fmi3UInt64, usize) -> Status;
        fmi3GetBoolean(fmi3Instance, References, usize, *mut fmi3Boolean, usize) -> Status;
        fmi3SetBoolean(fmi3Instance, References, usize, *const fmi3Boolean, usize) -> Status;
        fmi3GetString(fmi3Instance, References, usize, *mut fmi3String, usize) -> Status;
        fmi3SetString(fmi3Instance, References, usize, *const fmi3String, usize) -> Status;
        fmi3GetBinary(
            fmi3Instance, References, usize, *mut usize, *mut fmi3Binary, usize
        ) -> Status;
        fmi3SetBinary(
            fmi3Instance, References, usize, *const usize, *const fmi3Binary, usize
        ) -> Status;
        fmi3GetClock(fmi3Instance, References, usize, *mut fmi3Clock) -> Status;
        fmi3SetClock(fmi3Instance, References, usize, *const fmi3Clock) -> Status;
        fmi3GetNumberOfVariableDependencies(
            fmi3Instance, fmi3ValueReference, *mut usize
        ) -> Status;
        fmi3GetVariableDependencies(
            fmi3Instance, fmi3ValueReference, *mut usize, *mut fmi3ValueReference, *mut usize,
            *mut fmi3DependencyKind, usize
        ) -> Status;
        fmi3GetFMUState(fmi3Instance, *mut fmi3FMUState) -> Status;
        fmi3SetFMUState(fmi3Instance, fmi3FMUState) -> Status;
        fmi3FreeFMUState(fmi3Instance, *mut fmi3FMUState) -> Status;
        fmi3SerializedFMUStateSize(fmi3Instance, fmi3FMUState, *mut usize) -> Status;
        fmi3SerializeFMUState(fmi3Instance, fmi3FMUState, *mut fmi3Byte, usize) -> Status;
        fmi3DeserializeFMUState(
            fmi3Instance, *const fmi3Byte, usize, *mut fmi3FMUState
        ) -> Status;
        fmi3GetDirectionalDerivative(
            fmi3Instance, References, usize, References, usize, *const fmi3Float64, usize,
            *mut fmi3Float64, usize
        ) -> Status;
        fmi3GetAdjointDerivative(
            fmi3Instance, References, usize, References, usize, *const fmi3Float64, usize,
            *mut fmi3Float64, usize
        ) -> Status;
        fmi3EnterConfigurationMode(fmi3Instance) -> Status;
        fmi3ExitConfigurationMode(fmi3Instance) -> Status;
        fmi3GetIntervalDecimal(
            fmi3Instance, References, usize, *mut fmi3Float64, *mut fmi3IntervalQualifier
        ) -> Status;
        fmi3GetIntervalFraction(
            fmi3Instance, References, usize, *mut fmi3UInt64, *mut fmi3UInt64,
            *mut fmi3IntervalQualifier
        ) -> Status;
        fmi3GetShiftDecimal(fmi3Instance, References, usize, *mut fmi3Float64) -> Status;
        fmi3GetShiftFraction(
            fmi3Instance, References, usize, *mut fmi3UInt64, *mut fmi3UInt64
        ) -> Status;
        fmi3SetIntervalDecimal(fmi3Instance, References, usize, *const fmi3Float64) -> Status;
        fmi3SetIntervalFraction(
            fmi3Instance, References, usize, *const fmi3UInt64, *const fmi3UInt64
        ) -> Status;
        fmi3SetShiftDecimal(fmi3Instance, References, usize, *const fmi3Float64) -> Status;
        fmi3SetShiftFraction(
            fmi3Instance, References, usize, *const fmi3UInt64, *const fmi3UInt64
        ) -> Status;
        fmi3EvaluateDiscreteStates(fmi3Instance) -> Status;
        fmi3UpdateDiscreteStates(
            fmi3Instance, *mut fmi3Boolean, *mut fmi3Boolean, *mut fmi3Boolean, *mut fmi3Boolean,
            *mut fmi3Boolean, *mut fmi3Float64
        ) -> Status;
    }

    /// Functions for model exchange (section 3.2).
    MODEL_EXCHANGE_3 {
        fmi3EnterContinuousTimeMode(fmi3Instance) -> Status;
        fmi3CompletedIntegratorStep(
            fmi3Instance, fmi3Boolean, *mut fmi3Boolean, *mut fmi3Boolean
        ) -> Status;
        fmi3SetTime(fmi3Instance, fmi3Float64) -> Status;
        fmi3SetContinuousStates(fmi3Instance, *const fmi3Float64, usize) -> Status;
        fmi3GetContinuousStateDerivatives(fmi3Instance, *mut fmi3Float64, usize) -> Status;
        fmi3GetEventIndicators(fmi3Instance, *mut fmi3Float64, usize) -> Status;
        fmi3GetContinuousStates(fmi3Instance, *mut fmi3Float64, usize) -> Status;
        fmi3GetNominalsOfContinuousStates(fmi3Instance, *mut fmi3Float64, usize) -> Status;
        fmi3GetNumberOfEventIndicators(fmi3Instance, *mut usize) -> Status;
        fmi3GetNumberOfContinuousStates(fmi3Instance, *mut usize) -> Status;
    }

    /// Functions for co-simulation (section 4.2).
    CO_SIMULATION_3 {
        fmi3EnterStepMode(fmi3Instance) -> Status;
        fmi3GetOutputDerivatives(
            fmi3Instance, References, usize, *const fmi3Int32, *mut fmi3Float64, usize
        ) -> Status;
        fmi3DoStep(
            fmi3Instance, fmi3Float64, fmi3Float64, fmi3Boolean, *mut fmi3Boolean,
            *mut fmi3Boolean, *mut fmi3Boolean, *mut fmi3Float64
        ) -> Status;
    }

    /// Functions for scheduled execution (section 5.2).
    #[cfg_attr(not(test), expect(dead_code, reason = "no instances of this interface are made"))]
    SCHEDULED_EXECUTION_3 {
        fmi3ActivateModelPartition(fmi3Instance, fmi3ValueReference, fmi3Float64) -> Status;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fmi_3_has_75_functions() {
        let groups = [
            COMMON_3,
            MODEL_EXCHANGE_3,
            CO_SIMULATION_3,
            SCHEDULED_EXECUTION_3,
        ];
        assert_eq!(groups.iter().map(|group| group.len()).sum::<usize>(), 75);
    }
}
