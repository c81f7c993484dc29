//! FMI 3.0.2: the C types of `fmi3PlatformTypes.h` and `fmi3FunctionTypes.h` (section 2.2), and the functions
//! with the states in which they are allowed: the states that all interface types share (section 2.3) and the states of
//! model exchange (section 3.2), co-simulation (section 4.2) and scheduled execution (section 5.2).
#![allow(
    non_camel_case_types,
    non_upper_case_globals,
    non_snake_case,
    missing_docs,
    reason = "the names of the standard"
)]

use core::ffi::{c_char, c_int, c_void};

use crate::define;

pub type fmi3Instance = *mut c_void;
pub type fmi3InstanceEnvironment = *mut c_void;
pub type fmi3FMUState = *mut c_void;
pub type fmi3Float64 = f64;
/// C's `bool`, an integer because the other side may pass any value.
pub type fmi3Boolean = u8;
pub type fmi3Char = c_char;
pub type fmi3String = *const fmi3Char;
pub type fmi3Byte = u8;
pub type fmi3Binary = *const fmi3Byte;
/// C's `bool`, as [`fmi3Boolean`].
pub type fmi3Clock = u8;

pub const fmi3True: fmi3Boolean = 1;
pub const fmi3False: fmi3Boolean = 0;

/// An integer, because a foreign binary may return any value.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct fmi3Status(pub c_int);
pub const fmi3OK: fmi3Status = fmi3Status(0);
pub const fmi3Warning: fmi3Status = fmi3Status(1);
pub const fmi3Discard: fmi3Status = fmi3Status(2);
pub const fmi3Error: fmi3Status = fmi3Status(3);
pub const fmi3Fatal: fmi3Status = fmi3Status(4);

/// `fmi3DependencyKind`, an integer because the other side may pass any value.
pub type fmi3DependencyKind = c_int;
pub const fmi3Independent: fmi3DependencyKind = 0;
pub const fmi3Constant: fmi3DependencyKind = 1;
pub const fmi3Fixed: fmi3DependencyKind = 2;
pub const fmi3Tunable: fmi3DependencyKind = 3;
pub const fmi3Discrete: fmi3DependencyKind = 4;
pub const fmi3Dependent: fmi3DependencyKind = 5;

/// `fmi3IntervalQualifier`, an integer because the other side may pass any value.
pub type fmi3IntervalQualifier = c_int;
pub const fmi3IntervalNotYetKnown: fmi3IntervalQualifier = 0;
pub const fmi3IntervalUnchanged: fmi3IntervalQualifier = 1;
pub const fmi3IntervalChanged: fmi3IntervalQualifier = 2;

/// `fmi3LogMessageCallback` when it is not NULL. The status is an integer because the other side may
/// pass any value.
pub type fmi3LogMessageCallback =
    unsafe extern "C" fn(fmi3InstanceEnvironment, c_int, fmi3String, fmi3String);

/// `fmi3ClockUpdateCallback` when it is not NULL.
pub type fmi3ClockUpdateCallback = unsafe extern "C" fn(fmi3InstanceEnvironment);

/// `fmi3IntermediateUpdateCallback` when it is not NULL: instance environment, time, whether variables
/// are to be set, whether they may be read, whether the step is finished, whether the host may request
/// an early return, and the request with its time.
pub type fmi3IntermediateUpdateCallback = unsafe extern "C" fn(
    fmi3InstanceEnvironment,
    fmi3Float64,
    fmi3Boolean,
    fmi3Boolean,
    fmi3Boolean,
    fmi3Boolean,
    *mut fmi3Boolean,
    *mut fmi3Float64,
);

/// `fmi3LockPreemptionCallback` and `fmi3UnlockPreemptionCallback` when they are not NULL.
pub type fmi3PreemptionCallback = unsafe extern "C" fn();

/// Calls a macro with all functions of FMI 3.0; see the [crate].
#[macro_export]
macro_rules! fmi3_functions {
    ($($callback:tt)::+! $($context:tt)*) => { $($callback)::+! { $($context)*
        Free {
            fmi3GetVersion() -> fmi3String => get_version;
            fmi3InstantiateModelExchange(
                name: fmi3String, token: fmi3String, resources: fmi3String, visible: fmi3Boolean,
                logging_on: fmi3Boolean, environment: fmi3InstanceEnvironment,
                log_message: [Option<fmi3LogMessageCallback>]
            ) -> fmi3Instance => instantiate_model_exchange;
            fmi3InstantiateCoSimulation(
                name: fmi3String, token: fmi3String, resources: fmi3String, visible: fmi3Boolean,
                logging_on: fmi3Boolean, event_mode_used: fmi3Boolean, early_return_allowed: fmi3Boolean,
                intermediate_variables: [in u32; n], n: [len], environment: fmi3InstanceEnvironment,
                log_message: [Option<fmi3LogMessageCallback>],
                intermediate_update: [Option<fmi3IntermediateUpdateCallback>]
            ) -> fmi3Instance => instantiate_co_simulation;
            fmi3InstantiateScheduledExecution(
                name: fmi3String, token: fmi3String, resources: fmi3String, visible: fmi3Boolean,
                logging_on: fmi3Boolean, environment: fmi3InstanceEnvironment,
                log_message: [Option<fmi3LogMessageCallback>],
                clock_update: [Option<fmi3ClockUpdateCallback>],
                lock_preemption: [Option<fmi3PreemptionCallback>],
                unlock_preemption: [Option<fmi3PreemptionCallback>]
            ) -> fmi3Instance => instantiate_scheduled_execution;
            fmi3FreeInstance(instance: fmi3Instance) => free_instance;
        }

        All {
            fmi3SetDebugLogging(on: fmi3Boolean, n: [len], categories: [in fmi3String; n])
                => set_debug_logging in ALIVE;
            fmi3EnterInitializationMode(
                tolerance_defined: fmi3Boolean, tolerance: f64, start: f64, stop_defined: fmi3Boolean,
                stop: f64
            ) => enter_initialization_mode in INSTANTIATED;
            fmi3ExitInitializationMode() => exit_initialization_mode in INITIALIZATION;
            fmi3EnterEventMode() => enter_event_mode in STEP_MODE | EVENT | CONTINUOUS_TIME;
            fmi3Terminate() => terminate in RUNNING | RECONFIGURATION;
            fmi3Reset() => reset in ALIVE;
            fmi3EnterConfigurationMode()
                => enter_configuration_mode in INSTANTIATED | STEP_MODE | EVENT | CLOCK_ACTIVATION;
            fmi3ExitConfigurationMode() => exit_configuration_mode in CONFIGURATION | RECONFIGURATION;

            fmi3GetFloat32(references: [in u32; n], n: [len], values: [out f32; n_values], n_values: [len])
                => get_float32 in READABLE;
            fmi3GetFloat64(references: [in u32; n], n: [len], values: [out f64; n_values], n_values: [len])
                => get_float64 in READABLE;
            fmi3GetInt8(references: [in u32; n], n: [len], values: [out i8; n_values], n_values: [len])
                => get_int8 in READABLE;
            fmi3GetUInt8(references: [in u32; n], n: [len], values: [out u8; n_values], n_values: [len])
                => get_uint8 in READABLE;
            fmi3GetInt16(references: [in u32; n], n: [len], values: [out i16; n_values], n_values: [len])
                => get_int16 in READABLE;
            fmi3GetUInt16(references: [in u32; n], n: [len], values: [out u16; n_values], n_values: [len])
                => get_uint16 in READABLE;
            fmi3GetInt32(references: [in u32; n], n: [len], values: [out i32; n_values], n_values: [len])
                => get_int32 in READABLE;
            fmi3GetUInt32(references: [in u32; n], n: [len], values: [out u32; n_values], n_values: [len])
                => get_uint32 in READABLE;
            fmi3GetInt64(references: [in u32; n], n: [len], values: [out i64; n_values], n_values: [len])
                => get_int64 in READABLE;
            fmi3GetUInt64(references: [in u32; n], n: [len], values: [out u64; n_values], n_values: [len])
                => get_uint64 in READABLE;
            fmi3GetBoolean(
                references: [in u32; n], n: [len], values: [out fmi3Boolean; n_values], n_values: [len]
            ) => get_boolean in READABLE;
            fmi3GetString(
                references: [in u32; n], n: [len], values: [out fmi3String; n_values], n_values: [len]
            ) => get_string in READABLE;
            fmi3GetBinary(
                references: [in u32; n], n: [len], sizes: [out usize; n_values],
                values: [out fmi3Binary; n_values], n_values: [len]
            ) => get_binary in READABLE;
            fmi3SetFloat32(references: [in u32; n], n: [len], values: [in f32; n_values], n_values: [len])
                => set_float32 in CONTINUOUS;
            fmi3SetFloat64(references: [in u32; n], n: [len], values: [in f64; n_values], n_values: [len])
                => set_float64 in CONTINUOUS;
            fmi3SetInt8(references: [in u32; n], n: [len], values: [in i8; n_values], n_values: [len])
                => set_int8 in SETTABLE;
            fmi3SetUInt8(references: [in u32; n], n: [len], values: [in u8; n_values], n_values: [len])
                => set_uint8 in SETTABLE;
            fmi3SetInt16(references: [in u32; n], n: [len], values: [in i16; n_values], n_values: [len])
                => set_int16 in SETTABLE;
            fmi3SetUInt16(references: [in u32; n], n: [len], values: [in u16; n_values], n_values: [len])
                => set_uint16 in SETTABLE;
            fmi3SetInt32(references: [in u32; n], n: [len], values: [in i32; n_values], n_values: [len])
                => set_int32 in SETTABLE;
            fmi3SetUInt32(references: [in u32; n], n: [len], values: [in u32; n_values], n_values: [len])
                => set_uint32 in SETTABLE;
            fmi3SetInt64(references: [in u32; n], n: [len], values: [in i64; n_values], n_values: [len])
                => set_int64 in SETTABLE;
            fmi3SetUInt64(references: [in u32; n], n: [len], values: [in u64; n_values], n_values: [len])
                => set_uint64 in STRUCTURAL;
            fmi3SetBoolean(
                references: [in u32; n], n: [len], values: [in fmi3Boolean; n_values], n_values: [len]
            ) => set_boolean in SETTABLE;
            fmi3SetString(
                references: [in u32; n], n: [len], values: [in fmi3String; n_values], n_values: [len]
            ) => set_string in SETTABLE;
            fmi3SetBinary(
                references: [in u32; n], n: [len], sizes: [in usize; n_values],
                values: [in fmi3Binary; n_values], n_values: [len]
            ) => set_binary in SETTABLE;

            fmi3GetNumberOfVariableDependencies(reference: u32, n: [out usize])
                => get_number_of_variable_dependencies in NOWHERE;
            fmi3GetVariableDependencies(
                reference: u32, elements: [out usize; n], independents: [out u32; n],
                elements_of_independents: [out usize; n], kinds: [out fmi3DependencyKind; n], n: [len]
            ) => get_variable_dependencies in NOWHERE;
            fmi3GetFMUState(state: [out? fmi3FMUState]) => get_fmu_state in ALIVE;
            fmi3SetFMUState(state: fmi3FMUState) => set_fmu_state in ALIVE;
            fmi3FreeFMUState(state: [out? fmi3FMUState]) => free_fmu_state in ALIVE;
            fmi3SerializedFMUStateSize(state: fmi3FMUState, size: [out? usize])
                => serialized_fmu_state_size in ALIVE;
            fmi3SerializeFMUState(state: fmi3FMUState, bytes: [out? u8; size], size: [len])
                => serialize_fmu_state in ALIVE;
            fmi3DeserializeFMUState(bytes: [in? u8; size], size: [len], state: [out? fmi3FMUState])
                => deserialize_fmu_state in ALIVE;
            fmi3GetDirectionalDerivative(
                unknowns: [in u32; n_unknowns], n_unknowns: [len], knowns: [in u32; n_knowns],
                n_knowns: [len], seed: [in f64; n_seed], n_seed: [len],
                sensitivity: [out f64; n_sensitivity], n_sensitivity: [len]
            ) => get_directional_derivative in COMPUTED;
            fmi3GetAdjointDerivative(
                unknowns: [in u32; n_unknowns], n_unknowns: [len], knowns: [in u32; n_knowns],
                n_knowns: [len], seed: [in f64; n_seed], n_seed: [len],
                sensitivity: [out f64; n_sensitivity], n_sensitivity: [len]
            ) => get_adjoint_derivative in COMPUTED;
            fmi3UpdateDiscreteStates(
                needs_update: [out fmi3Boolean], terminate: [out fmi3Boolean],
                nominals_changed: [out fmi3Boolean], states_changed: [out fmi3Boolean],
                next_event_defined: [out fmi3Boolean], next_event: [out f64]
            ) => update_discrete_states in EVENT;
        }

        Clocks {
            fmi3GetClock(references: [in u32; n], n: [len], values: [out fmi3Clock; n])
                => get_clock in INITIALIZATION | EVENT | CLOCK_UPDATE;
            fmi3SetClock(references: [in u32; n], n: [len], values: [in fmi3Clock; n])
                => set_clock in EVENT;
            fmi3GetIntervalDecimal(
                references: [in u32; n], n: [len], intervals: [out f64; n],
                qualifiers: [out fmi3IntervalQualifier; n]
            ) => get_interval_decimal in CLOCK_TIMES | CLOCK_UPDATE;
            fmi3GetIntervalFraction(
                references: [in u32; n], n: [len], counters: [out u64; n], resolutions: [out u64; n],
                qualifiers: [out fmi3IntervalQualifier; n]
            ) => get_interval_fraction in CLOCK_TIMES | CLOCK_UPDATE;
            fmi3GetShiftDecimal(references: [in u32; n], n: [len], shifts: [out f64; n])
                => get_shift_decimal in INITIALIZATION;
            fmi3GetShiftFraction(
                references: [in u32; n], n: [len], counters: [out u64; n], resolutions: [out u64; n]
            ) => get_shift_fraction in INITIALIZATION;
            fmi3SetIntervalDecimal(references: [in u32; n], n: [len], intervals: [in f64; n])
                => set_interval_decimal in CLOCK_TIMES;
            fmi3SetIntervalFraction(
                references: [in u32; n], n: [len], counters: [in u64; n], resolutions: [in u64; n]
            ) => set_interval_fraction in CLOCK_TIMES;
            fmi3SetShiftDecimal(references: [in u32; n], n: [len], shifts: [in f64; n])
                => set_shift_decimal in INITIALIZATION;
            fmi3SetShiftFraction(
                references: [in u32; n], n: [len], counters: [in u64; n], resolutions: [in u64; n]
            ) => set_shift_fraction in INITIALIZATION;
            fmi3EvaluateDiscreteStates() => evaluate_discrete_states in EVENT;
        }

        ModelExchange {
            fmi3EnterContinuousTimeMode() => enter_continuous_time_mode in EVENT;
            fmi3CompletedIntegratorStep(
                no_set_state: fmi3Boolean, enter_event_mode: [out fmi3Boolean],
                terminate: [out fmi3Boolean]
            ) => completed_integrator_step in CONTINUOUS_TIME;
            fmi3SetTime(time: f64) => set_time in EVENT | CONTINUOUS_TIME;
            fmi3SetContinuousStates(states: [in f64; n], n: [len])
                => set_continuous_states in CONTINUOUS_TIME;
            fmi3GetContinuousStateDerivatives(values: [out f64; n], n: [len])
                => get_continuous_state_derivatives in EQUATIONS;
            fmi3GetEventIndicators(values: [out f64; n], n: [len])
                => get_event_indicators in EQUATIONS;
            fmi3GetContinuousStates(values: [out f64; n], n: [len])
                => get_continuous_states in EQUATIONS;
            fmi3GetNominalsOfContinuousStates(values: [out f64; n], n: [len])
                => get_nominals_of_continuous_states in EQUATIONS;
            fmi3GetNumberOfEventIndicators(n: [out usize]) => get_number_of_event_indicators in ALIVE;
            fmi3GetNumberOfContinuousStates(n: [out usize]) => get_number_of_continuous_states in ALIVE;
        }

        CoSimulation {
            fmi3EnterStepMode() => enter_step_mode in EVENT;
            fmi3GetOutputDerivatives(
                references: [in u32; n], n: [len], orders: [in i32; n], values: [out f64; n_values],
                n_values: [len]
            ) => get_output_derivatives in STEPPED | INTERMEDIATE_UPDATE;
            fmi3DoStep(
                time: f64, step: f64, no_set_state: fmi3Boolean, event_handling_needed: [out? fmi3Boolean],
                terminate: [out? fmi3Boolean], early_return: [out? fmi3Boolean],
                last_successful_time: [out? f64]
            ) => do_step in STEP_MODE;
        }

        ScheduledExecution {
            fmi3ActivateModelPartition(clock: u32, time: f64) => activate_model_partition in CLOCK_ACTIVATION;
        }
    } };
}

fmi3_functions!(define! fmi3Instance fmi3Status);
