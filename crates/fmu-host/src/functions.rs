//! The functions of FMI 2.0 with their types, and looking them up in a library.

use std::ffi::{c_char, c_int};

use fmu_types::fmi2::{
    fmi2Boolean, fmi2CallbackFunctions, fmi2Component, fmi2EventInfo, fmi2FMUstate, fmi2Integer,
    fmi2Real, fmi2StatusKind, fmi2String, fmi2Type, fmi2ValueReference,
};

/// `fmi2Status`, an integer because a foreign binary may return any value.
type Status = c_int;
type References = *const fmi2ValueReference;

macro_rules! functions {
    ($($(#[$about:meta])* $group:ident { $($name:ident($($type:ty),*) $(-> $result:ty)?;)* })*) => {
        $($(#[$about])* pub(crate) const $group: &[&str] = &[$(stringify!($name)),*];)*

        /// The functions of a library, under their names in the standard.
        #[derive(Default)]
        #[allow(non_snake_case, missing_docs, reason = "the names of the standard")]
        pub struct Functions {
            $($(pub $name: Option<unsafe extern "C" fn($($type),*) $(-> $result)?>,)*)*
        }

        impl Functions {
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
