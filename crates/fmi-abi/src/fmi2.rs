//! FMI 2.0.5: the C types of `fmi2TypesPlatform.h` and `fmi2FunctionTypes.h` (section 2.1), and the functions
//! with the states in which they are allowed, in co-simulation (section 4.2.4) and model exchange
//! (section 3.2.3).
#![allow(
    non_camel_case_types,
    non_upper_case_globals,
    non_snake_case,
    missing_docs,
    reason = "the names of the standard"
)]

use core::ffi::{c_char, c_int, c_void};

use crate::define;

pub type fmi2Component = *mut c_void;
pub type fmi2ComponentEnvironment = *mut c_void;
pub type fmi2FMUstate = *mut c_void;
pub type fmi2Boolean = c_int;
pub type fmi2Char = c_char;
pub type fmi2String = *const fmi2Char;
pub type fmi2Byte = c_char;

pub const fmi2False: fmi2Boolean = 0;

/// An integer, because a foreign binary may return any value.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct fmi2Status(pub c_int);
pub const fmi2OK: fmi2Status = fmi2Status(0);
pub const fmi2Warning: fmi2Status = fmi2Status(1);
pub const fmi2Discard: fmi2Status = fmi2Status(2);
pub const fmi2Error: fmi2Status = fmi2Status(3);
pub const fmi2Fatal: fmi2Status = fmi2Status(4);
pub const fmi2Pending: fmi2Status = fmi2Status(5);

/// `fmi2Type`, an integer because the host may pass any value.
pub type fmi2Type = c_int;
pub const fmi2ModelExchange: fmi2Type = 0;
pub const fmi2CoSimulation: fmi2Type = 1;

/// `fmi2StatusKind`, an integer because the host may pass any value.
pub type fmi2StatusKind = c_int;
pub const fmi2DoStepStatus: fmi2StatusKind = 0;
pub const fmi2PendingStatus: fmi2StatusKind = 1;
pub const fmi2LastSuccessfulTime: fmi2StatusKind = 2;
pub const fmi2Terminated: fmi2StatusKind = 3;

/// `fmi2CallbackLogger` when it is not NULL.
pub type fmi2CallbackLogger = unsafe extern "C" fn(
    fmi2ComponentEnvironment,
    fmi2String,
    fmi2Status,
    fmi2String,
    fmi2String,
    ...
);

#[repr(C)]
pub struct fmi2CallbackFunctions {
    pub logger: Option<fmi2CallbackLogger>,
    pub allocateMemory: Option<unsafe extern "C" fn(usize, usize) -> *mut c_void>,
    pub freeMemory: Option<unsafe extern "C" fn(*mut c_void)>,
    pub stepFinished: Option<unsafe extern "C" fn(fmi2ComponentEnvironment, fmi2Status)>,
    pub componentEnvironment: fmi2ComponentEnvironment,
}

#[repr(C)]
pub struct fmi2EventInfo {
    pub newDiscreteStatesNeeded: fmi2Boolean,
    pub terminateSimulation: fmi2Boolean,
    pub nominalsOfContinuousStatesChanged: fmi2Boolean,
    pub valuesOfContinuousStatesChanged: fmi2Boolean,
    pub nextEventTimeDefined: fmi2Boolean,
    pub nextEventTime: f64,
}

/// Calls a macro with all functions of FMI 2.0; see the [crate].
#[macro_export]
macro_rules! fmi2_functions {
    ($($callback:tt)::+! $($context:tt)*) => { $($callback)::+! { $($context)*
        Free {
            fmi2GetTypesPlatform() -> fmi2String => get_types_platform;
            fmi2GetVersion() -> fmi2String => get_version;
            fmi2Instantiate(
                name: fmi2String, kind: fmi2Type, guid: fmi2String, resources: fmi2String,
                functions: [*const fmi2CallbackFunctions], visible: fmi2Boolean, logging_on: fmi2Boolean
            ) -> fmi2Component => instantiate;
            fmi2FreeInstance(instance: fmi2Component) => free_instance;
        }

        All {
            fmi2SetDebugLogging(on: fmi2Boolean, n: [len], categories: [in fmi2String; n])
                => set_debug_logging in INSTANTIATED | COMPUTED;
            fmi2SetupExperiment(
                tolerance_defined: fmi2Boolean, tolerance: f64, start: f64, stop_defined: fmi2Boolean,
                stop: f64
            ) => setup_experiment in INSTANTIATED;
            fmi2EnterInitializationMode() => enter_initialization_mode in INSTANTIATED;
            fmi2ExitInitializationMode() => exit_initialization_mode in INITIALIZATION;
            fmi2Terminate() => terminate in RUNNING;
            fmi2Reset() => reset in INSTANTIATED | COMPUTED;

            fmi2GetReal(references: [in u32; n], n: [len], values: [out f64; n])
                => get_float64 in COMPUTED;
            fmi2GetInteger(references: [in u32; n], n: [len], values: [out i32; n])
                => get_int32 in COMPUTED;
            fmi2GetBoolean(references: [in u32; n], n: [len], values: [out fmi2Boolean; n])
                => get_boolean in COMPUTED;
            fmi2GetString(references: [in u32; n], n: [len], values: [out fmi2String; n])
                => get_string in COMPUTED;
            fmi2SetReal(references: [in u32; n], n: [len], values: [in f64; n])
                => set_float64 in SETTABLE;
            fmi2SetInteger(references: [in u32; n], n: [len], values: [in i32; n])
                => set_int32 in SETTABLE;
            fmi2SetBoolean(references: [in u32; n], n: [len], values: [in fmi2Boolean; n])
                => set_boolean in SETTABLE;
            fmi2SetString(references: [in u32; n], n: [len], values: [in fmi2String; n])
                => set_string in SETTABLE;

            fmi2GetFMUstate(state: [out? fmi2FMUstate]) => get_fmu_state in INSTANTIATED | COMPUTED;
            fmi2SetFMUstate(state: fmi2FMUstate) => set_fmu_state in INSTANTIATED | COMPUTED;
            fmi2FreeFMUstate(state: [out? fmi2FMUstate]) => free_fmu_state in INSTANTIATED | COMPUTED;
            fmi2SerializedFMUstateSize(state: fmi2FMUstate, size: [out? usize])
                => serialized_fmu_state_size in INSTANTIATED | COMPUTED;
            fmi2SerializeFMUstate(state: fmi2FMUstate, bytes: [out? fmi2Byte; size], size: [len])
                => serialize_fmu_state in INSTANTIATED | COMPUTED;
            fmi2DeSerializeFMUstate(bytes: [in? fmi2Byte; size], size: [len], state: [out? fmi2FMUstate])
                => deserialize_fmu_state in INSTANTIATED | COMPUTED;
            fmi2GetDirectionalDerivative(
                unknowns: [in u32; n_unknowns], n_unknowns: [len], knowns: [in u32; n_knowns],
                n_knowns: [len], seed: [in f64; n_knowns], sensitivity: [out f64; n_unknowns]
            ) => get_directional_derivative in COMPUTED;
        }

        ModelExchange {
            fmi2EnterEventMode() => enter_event_mode in EVENT | CONTINUOUS_TIME;
            fmi2NewDiscreteStates(info: [out fmi2EventInfo]) => update_discrete_states in EVENT;
            fmi2EnterContinuousTimeMode() => enter_continuous_time_mode in EVENT;
            fmi2CompletedIntegratorStep(
                no_set_state: fmi2Boolean, enter_event_mode: [out fmi2Boolean],
                terminate: [out fmi2Boolean]
            ) => completed_integrator_step in CONTINUOUS_TIME;
            fmi2SetTime(time: f64) => set_time in EVENT | CONTINUOUS_TIME;
            // In event mode, too, though the standard does not allow it: OpenModelica calls it there.
            fmi2SetContinuousStates(states: [in f64; n], n: [len])
                => set_continuous_states in EVENT | CONTINUOUS_TIME;
            fmi2GetDerivatives(values: [out f64; n], n: [len])
                => get_continuous_state_derivatives in EQUATIONS;
            fmi2GetEventIndicators(values: [out f64; n], n: [len])
                => get_event_indicators in EQUATIONS;
            fmi2GetContinuousStates(values: [out f64; n], n: [len])
                => get_continuous_states in EQUATIONS;
            fmi2GetNominalsOfContinuousStates(values: [out f64; n], n: [len])
                => get_nominals_of_continuous_states in EQUATIONS | INSTANTIATED;
        }

        CoSimulation {
            fmi2SetRealInputDerivatives(
                references: [in u32; n], n: [len], orders: [in i32; n], values: [in f64; n]
            ) => set_input_derivatives in INSTANTIATED | INITIALIZATION | STEP_MODE;
            fmi2GetRealOutputDerivatives(
                references: [in u32; n], n: [len], orders: [in i32; n], values: [out f64; n]
            ) => get_output_derivatives in STEPPED;
            fmi2DoStep(time: f64, step: f64, no_set_state: fmi2Boolean) => do_step in STEP_MODE;
            fmi2CancelStep() => cancel_step in NOWHERE;
            fmi2GetStatus(kind: fmi2StatusKind, value: [out? fmi2Status])
                => get_status in STEP_MODE | STEP_FAILED | TERMINATED;
            fmi2GetRealStatus(kind: fmi2StatusKind, value: [out? f64])
                => get_real_status in STEP_MODE | STEP_FAILED | TERMINATED;
            fmi2GetIntegerStatus(kind: fmi2StatusKind, value: [out? i32])
                => get_integer_status in STEP_MODE | STEP_FAILED | TERMINATED;
            fmi2GetBooleanStatus(kind: fmi2StatusKind, value: [out? fmi2Boolean])
                => get_boolean_status in STEP_MODE | STEP_FAILED | TERMINATED;
            fmi2GetStringStatus(kind: fmi2StatusKind, value: [out? fmi2String])
                => get_string_status in STEP_MODE | STEP_FAILED | TERMINATED;
        }
    } };
}

fmi2_functions!(define! fmi2Component fmi2Status);
