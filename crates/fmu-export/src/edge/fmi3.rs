//! The C interface of FMI 3.0.2: all 75 functions. Those that instantiate are defined by
//! [`export!`](crate::export), as they depend on the models.
//!
//! A variable has the value reference of its first element in FMI 2.0, and the independent variable
//! has the next one after all others.
#![allow(
    non_snake_case,
    non_upper_case_globals,
    clippy::missing_safety_doc,
    clippy::too_many_arguments,
    reason = "names, arguments and safety requirements are defined by the standard"
)]

use std::borrow::BorrowMut;
use std::ffi::c_int;
use std::rc::Rc;

pub use fmi_abi::fmi3::*;
use fmi_abi::state::State;
use fmi_abi::{FmiVersion, c_type, fmi3_functions};
use fmu_description::{LogCategory, Type, Value};

use super::instantiate;
use crate::any_model::SolverVector;
use crate::entry::Entry;
use crate::error::ModelError;
use crate::fast::{self, call, free, head, instance_at};
use crate::instance::{
    ClockUpdate, Edge, Instance, IntermediateUpdate, Scheduling, Settings, Status,
};
use crate::lifecycle::{InstanceType, NOT_SCHEDULED};
use crate::log::{Log, Sink};
use crate::pointers::{NULL_ARRAY, c_message, slice, slice_mut, text};
use crate::preemption::Preemption;
use crate::resources::Folder;
use crate::step::{Next, StepResults, Stepping};
use crate::values::HostValue;

pub(super) static EDGE: Edge = Edge {
    version: FmiVersion::Fmi3,
    get_float64: calls::fmi3GetFloat64,
    set_float64: calls::fmi3SetFloat64,
    do_step: calls::fmi3DoStep,
    get_fmu_state: calls::fmi3GetFMUState,
    has_clocks: true,
};

fmi3_functions!(entries! fmi3Instance fmi3Status);

/// Why a function of the model is not supported.
pub(super) fn unsupported(name: &str) -> &'static str {
    match name {
        "fmi3EvaluateDiscreteStates" => "providesEvaluateDiscreteStates is false",
        name if name.ends_with("Dependencies") => {
            "providesPerElementDependencies is false; the model description has the dependencies"
        }
        _ => "the model has no clocks",
    }
}

/// `fmi3GetVersion`
#[cfg_attr(not(target_arch = "wasm32"), unsafe(no_mangle))]
pub extern "C" fn fmi3GetVersion() -> fmi3String {
    c"3.0".as_ptr()
}

/// `fmi3InstantiateModelExchange`. On failure, logs the reason and returns NULL.
///
/// # Safety
/// The requirements of the standard on the caller.
pub unsafe fn instantiate_model_exchange(
    models: &'static [Entry],
    name: fmi3String,
    token: fmi3String,
    resources: fmi3String,
    _visible: fmi3Boolean,
    logging_on: fmi3Boolean,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
) -> fmi3Instance {
    let log = Log::new(sink(environment, log_message), logging_on != fmi3False);
    // SAFETY: the caller's promise.
    let [name, token, path] = unsafe { [text(name), text(token), text(resources)] };
    let settings = Settings::new(&EDGE, log, Folder::named(FmiVersion::Fmi3, path));
    let (function, instance_type) =
        ("fmi3InstantiateModelExchange", Ok(InstanceType::ModelExchange));
    instantiate(function, models, (name, token), instance_type, settings)
}

/// `fmi3InstantiateCoSimulation`. On failure, logs the reason and returns NULL.
///
/// # Safety
/// The requirements of the standard on the caller.
pub unsafe fn instantiate_co_simulation(
    models: &'static [Entry],
    name: fmi3String,
    token: fmi3String,
    resources: fmi3String,
    _visible: fmi3Boolean,
    logging_on: fmi3Boolean,
    event_mode_used: fmi3Boolean,
    early_return_allowed: fmi3Boolean,
    intermediate_variables: *const u32,
    n: usize,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
    intermediate_update: Option<fmi3IntermediateUpdateCallback>,
) -> fmi3Instance {
    let log = Log::new(sink(environment, log_message), logging_on != fmi3False);
    // SAFETY: the caller's promise.
    let ([name, token, path], variables) = unsafe {
        let texts = [text(name), text(token), text(resources)];
        (texts, slice(intermediate_variables, n))
    };
    let instance_type = match (variables, event_mode_used) {
        (None, _) => Err("requiredIntermediateVariables is NULL though its length is not 0".into()),
        (_, fmi3False) => Ok(InstanceType::CoSimulation),
        _ => Ok(InstanceType::CoSimulationWithEvents),
    };
    let settings = Settings {
        early_return_allowed: early_return_allowed != fmi3False,
        intermediate_update: intermediate_update.map(|function| {
            // SAFETY: the host provides this function for this environment.
            Rc::new(move |update| unsafe { call_back(function, environment, update) }) as Rc<_>
        }),
        intermediate_variables: variables.unwrap_or_default().to_vec(),
        ..Settings::new(&EDGE, log, Folder::named(FmiVersion::Fmi3, path))
    };
    let function = "fmi3InstantiateCoSimulation";
    instantiate(function, models, (name, token), instance_type, settings)
}

/// `fmi3InstantiateScheduledExecution`. On failure, logs the reason and returns NULL, as libraries without model
/// partitions always do.
///
/// # Safety
/// The requirements of the standard on the caller.
pub unsafe fn instantiate_scheduled_execution<const HAS_PARTITIONS: bool>(
    models: &'static [Entry],
    name: fmi3String,
    token: fmi3String,
    resources: fmi3String,
    _visible: fmi3Boolean,
    logging_on: fmi3Boolean,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
    clock_update: Option<fmi3ClockUpdateCallback>,
    lock_preemption: Option<fmi3PreemptionCallback>,
    unlock_preemption: Option<fmi3PreemptionCallback>,
) -> fmi3Instance {
    let log = || Log::new(sink(environment, log_message), logging_on != fmi3False);
    let function = "fmi3InstantiateScheduledExecution";
    if !HAS_PARTITIONS {
        log().send(LogCategory::Error, format_args!("{function}: {NOT_SCHEDULED}"));
        return std::ptr::null_mut();
    }
    // SAFETY: the caller's promise.
    let [name, token, path] = unsafe { [text(name), text(token), text(resources)] };
    let clock_update = clock_update.map(|function| {
        // SAFETY: the host provides this function for this environment.
        Rc::new(move || unsafe { function(environment) }) as ClockUpdate
    });
    let preemption = Preemption::new(lock_preemption, unlock_preemption, log());
    let settings = Settings {
        scheduling: Some(Scheduling::new(preemption, clock_update)),
        ..Settings::new(&EDGE, log(), Folder::named(FmiVersion::Fmi3, path))
    };
    let instance_type = Ok(InstanceType::ScheduledExecution);
    instantiate(function, models, (name, token), instance_type, settings)
}

/// Forwards messages to the host's logger, if the host provides one.
fn sink(
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
) -> Option<Sink> {
    let log_message = log_message?;
    Some(Box::new(move |heading, message| {
        let text = c_message(message);
        let (status, category) = (heading.status, heading.category.as_ptr());
        // SAFETY: the host provides this function to be called with these C types (FMI 3.0.2, section
        // 2.3.1); the strings are zero-terminated and outlive the call.
        unsafe { log_message(environment, status, category, text.as_ptr()) };
    }))
}

/// `fmi3FreeInstance`
#[cfg_attr(not(target_arch = "wasm32"), unsafe(no_mangle))]
pub unsafe extern "C" fn fmi3FreeInstance(instance: fmi3Instance) {
    // SAFETY: the host's promise: NULL or an instance, which is not used again.
    unsafe { free(instance) }
}

/// `fmi3GetFloat64`
#[cfg_attr(any(not(target_arch = "wasm32"), feature = "sources"), unsafe(no_mangle))]
pub unsafe extern "C" fn fmi3GetFloat64(
    instance: fmi3Instance,
    references: *const u32,
    n: usize,
    values: *mut f64,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the host's promises, as for all entry points.
    let status = unsafe {
        match head(instance) {
            Some(head) => (head.vtable.get_variables)(instance, references, n, values, n_values),
            None => Status::Error,
        }
    };
    fmi3Status(status as c_int)
}

/// `fmi3SetFloat64`
#[cfg_attr(any(not(target_arch = "wasm32"), feature = "sources"), unsafe(no_mangle))]
pub unsafe extern "C" fn fmi3SetFloat64(
    instance: fmi3Instance,
    references: *const u32,
    n: usize,
    values: *const f64,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the host's promises, as for all entry points.
    let status = unsafe {
        match head(instance) {
            Some(head) => (head.vtable.set_variables)(instance, references, n, values, n_values),
            None => Status::Error,
        }
    };
    fmi3Status(status as c_int)
}

exported! { ScheduledExecution
    /// `fmi3ActivateModelPartition`
    pub unsafe extern "C" fn fmi3ActivateModelPartition(
        instance: fmi3Instance,
        clock: u32,
        time: f64,
    ) -> fmi3Status {
        // SAFETY: the host's promises, as for all entry points.
        unsafe {
            match head(instance).and_then(|head| head.clock_functions) {
                Some(functions) => (functions.activate)(instance, clock, time),
                None => {
                    let activate = &calls::fmi3ActivateModelPartition;
                    fmi3Status(fast::refuse(instance, activate, NOT_SCHEDULED) as c_int)
                }
            }
        }
    }
}

exported! { CoSimulation
    /// `fmi3DoStep`
    pub unsafe extern "C" fn fmi3DoStep(
        instance: fmi3Instance,
        time: f64,
        step: f64,
        _no_set_state: fmi3Boolean,
        event_handling_needed: *mut fmi3Boolean,
        terminate: *mut fmi3Boolean,
        early_return: *mut fmi3Boolean,
        last_successful_time: *mut f64,
    ) -> fmi3Status {
        // SAFETY: the host's promises, as for all entry points; some hosts pass NULL for results.
        let status = unsafe {
            write_result(event_handling_needed, fmi3False);
            write_result(terminate, fmi3False);
            write_result(early_return, fmi3False);
            match head(instance) {
                _ if InstanceType::HAS_ONLY_SCHEDULED_EXECUTION => {
                    call(instance, &calls::fmi3DoStep, |_| Ok(()))
                }
                Some(head) if head.is_stepped_in_parts => {
                    let (event, early, last) =
                        (event_handling_needed, early_return, last_successful_time);
                    step_in_parts(instance, time, step, event, early, last)
                }
                Some(head) => (head.vtable.step)(instance, time, step, last_successful_time.as_mut()),
                None => Status::Error,
            }
        };
        fmi3Status(status as c_int)
    }
}

/// # Safety
/// The pointer is NULL or writable.
#[inline(always)]
unsafe fn write_result<T>(pointer: *mut T, value: T) {
    if !pointer.is_null() {
        // SAFETY: not NULL, and writable by the caller's promise.
        unsafe { pointer.write(value) };
    }
}

/// A step that the host observes.
///
/// # Safety
/// The promises of a host. Its callback may call functions of the instance, therefore no reference to the
/// instance is held meanwhile.
#[cold]
#[inline(never)]
unsafe extern "C" fn step_in_parts(
    instance: fmi3Instance,
    time: f64,
    step: f64,
    event_handling_needed: *mut fmi3Boolean,
    early_return: *mut fmi3Boolean,
    last_successful_time: *mut f64,
) -> Status {
    // SAFETY: the caller's promise.
    unsafe {
        let (status, results) = in_parts(instance, time, step);
        write_result(event_handling_needed, results.event_handling_needed.into());
        write_result(early_return, results.early_return.into());
        write_result(last_successful_time, results.last_successful_time);
        status
    }
}

/// # Safety
/// As [`step_in_parts`].
unsafe fn in_parts(instance: fmi3Instance, time: f64, step: f64) -> (Status, StepResults) {
    let pointer = instance;
    // SAFETY: the caller's promise; each reference ends before the callback.
    let borrow = || unsafe { instance_at(pointer) };
    let failed = (Status::Error, StepResults::plain(time));
    let Some(instance) = borrow() else {
        return failed;
    };
    let call_back = instance.shared.settings.intermediate_update.clone();
    let mut stepping = match Stepping::begin(instance, time, step) {
        Ok(stepping) => stepping,
        Err(returned) => return returned,
    };
    let mut next = stepping.advance(instance);
    loop {
        match next {
            Next::Return(status, results) => return (status, results),
            Next::Update(update) => {
                let requested = call_back.as_ref().and_then(|call_back| {
                    // SAFETY: as above.
                    unsafe { fast::call_back(pointer, || call_back(update)) }
                });
                let Some(instance) = borrow() else {
                    return failed;
                };
                next = stepping.resume(instance, update, requested);
            }
        }
    }
}

/// Calls the host in an intermediate update. Returns the time of an early return that it requests.
///
/// # Safety
/// The function and its environment belong to the host.
unsafe fn call_back(
    function: fmi3IntermediateUpdateCallback,
    environment: fmi3InstanceEnvironment,
    update: IntermediateUpdate,
) -> Option<f64> {
    let (mut requested, mut return_time) = (fmi3False, update.time);
    // SAFETY: the host provides this function to be called with these C types (FMI 3.0.2, section
    // 4.2.2); the pointers are valid during the call.
    unsafe {
        function(
            environment,
            update.time,
            update.set_requested.into(),
            fmi3True,
            fmi3True,
            update.can_return_early.into(),
            &raw mut requested,
            &raw mut return_time,
        );
    }
    (requested != fmi3False).then_some(return_time)
}

/// The operations whose arguments differ between the versions.
trait Operations: BorrowMut<Instance> {
    fn enter_initialization_mode(
        &mut self,
        tolerance_defined: bool,
        tolerance: f64,
        start: f64,
        stop_defined: bool,
        stop: f64,
    ) -> Result<(), ModelError> {
        let instance = self.borrow_mut();
        let tolerance = tolerance_defined.then_some(tolerance);
        instance.set_experiment(start, stop_defined.then_some(stop), tolerance)?;
        instance.enter(State::Initialization);
        Ok(())
    }

    fn update_discrete_states(
        &mut self,
        needs_update: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
        nominals_changed: &mut fmi3Boolean,
        states_changed: &mut fmi3Boolean,
        next_event_defined: &mut fmi3Boolean,
        next_event: &mut f64,
    ) -> Result<(), ModelError> {
        let update = self.borrow_mut().update_instant()?;
        (*needs_update, *terminate, *nominals_changed) = (fmi3False, fmi3False, fmi3False);
        *states_changed = update.states_changed.into();
        *next_event_defined = update.next_event.is_some().into();
        *next_event = update.next_event.unwrap_or_default();
        Ok(())
    }
}

impl Operations for Instance {}

/// The operations that only this version has.
impl Instance {
    fn get_number_of_event_indicators(&mut self, n: &mut usize) -> Result<(), ModelError> {
        *n = self.model.vector_length(SolverVector::EventIndicators);
        Ok(())
    }

    fn get_number_of_continuous_states(&mut self, n: &mut usize) -> Result<(), ModelError> {
        *n = self.model.vector_length(SolverVector::States);
        Ok(())
    }

    /// Hands out pointers to bytes that live until the next call.
    fn get_binary(
        &mut self,
        references: &[u32],
        sizes: &mut [usize],
        values: &mut [fmi3Binary],
    ) -> Result<(), ModelError> {
        let mut found = Vec::new();
        self.get_of_type(Type::Binary, references, values.len(), &mut |_, value| {
            if let Value::Binary(bytes) = value {
                found.push(bytes);
            }
        })?;
        for ((value, size), bytes) in values.iter_mut().zip(sizes).zip(&found) {
            (*value, *size) = (bytes.as_ptr(), bytes.len());
        }
        self.shared.binaries = found;
        Ok(())
    }

    unsafe fn set_binary(
        &mut self,
        references: &[u32],
        sizes: &[usize],
        values: &[fmi3Binary],
    ) -> Result<(), ModelError> {
        let each = sizes.iter().zip(values);
        // SAFETY: the host's promise: NULL, or as many bytes.
        let binaries = each.map(|(&size, &value)| unsafe { slice(value, size) });
        let binaries: Vec<Option<&[u8]>> = binaries.collect();
        let given = |i: usize| {
            let bytes = binaries[i].ok_or_else(|| "NULL".to_owned());
            HostValue::Other(bytes.map(|bytes| Value::Binary(bytes.to_owned())))
        };
        self.set_of_type(Type::Binary, references, binaries.len(), &given)
    }
}
