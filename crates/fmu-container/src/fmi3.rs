//! The C interface of FMI 3.0.2 for co-simulation.

use std::ffi::{CStr, c_int};
use std::path::Path;

pub use fmi_abi::fmi3::*;
use fmi_abi::{FmiVersion, c_type, fmi3_functions};
use fmu_description::LogCategory;
use fmu_master::container::Stepped;

use crate::host_log::{HostLog, Sink};
use crate::instance::{Instance, Outcome, Status, free, instantiate, refused};
use crate::pointers::{NULL_ARRAY, slice, slice_mut, text};

fmi3_functions!(entries! fmi3Instance fmi3Status);

/// `fmi3GetVersion`
#[unsafe(no_mangle)]
pub extern "C" fn fmi3GetVersion() -> fmi3String {
    c"3.0".as_ptr()
}

/// `fmi3InstantiateCoSimulation`. On failure, logs the reason and returns NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3InstantiateCoSimulation(
    _name: fmi3String,
    token: fmi3String,
    resources: fmi3String,
    _visible: fmi3Boolean,
    logging_on: fmi3Boolean,
    event_mode_used: fmi3Boolean,
    _early_return_allowed: fmi3Boolean,
    _intermediate_variables: *const u32,
    _n: usize,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
    _intermediate_update: Option<fmi3IntermediateUpdateCallback>,
) -> fmi3Instance {
    let log = HostLog::new(sink(environment, log_message), logging_on != fmi3False);
    // SAFETY: the host's promise: texts are NULL or valid.
    let (token, resources) = unsafe { (text(token), text(resources)) };
    let folder = match resources.map(CStr::to_str) {
        _ if event_mode_used != fmi3False => {
            Err("hasEventMode is false, expected eventModeUsed = false".to_owned())
        }
        Some(Ok(path)) => Ok(Path::new(path)),
        _ => Err("the host passed no resource path in UTF-8".to_owned()),
    };
    instantiate("fmi3InstantiateCoSimulation", FmiVersion::Fmi3, token, folder, log)
}

/// `fmi3InstantiateModelExchange`, which logs that it is not supported and returns NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3InstantiateModelExchange(
    _name: fmi3String,
    _token: fmi3String,
    _resources: fmi3String,
    _visible: fmi3Boolean,
    _logging_on: fmi3Boolean,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
) -> fmi3Instance {
    unsupported("fmi3InstantiateModelExchange", sink(environment, log_message))
}

/// `fmi3InstantiateScheduledExecution`, which logs that it is not supported and returns NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3InstantiateScheduledExecution(
    _name: fmi3String,
    _token: fmi3String,
    _resources: fmi3String,
    _visible: fmi3Boolean,
    _logging_on: fmi3Boolean,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
    _clock_update: Option<fmi3ClockUpdateCallback>,
    _lock_preemption: Option<fmi3PreemptionCallback>,
    _unlock_preemption: Option<fmi3PreemptionCallback>,
) -> fmi3Instance {
    unsupported("fmi3InstantiateScheduledExecution", sink(environment, log_message))
}

fn unsupported(function: &str, sink: Option<Sink>) -> fmi3Instance {
    let text = format!("{function}: a container is for co-simulation only");
    HostLog::new(sink, false).send(LogCategory::Error, &text);
    std::ptr::null_mut()
}

/// Forwards messages to the host's logger, if the host provides one.
fn sink(
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
) -> Option<Sink> {
    let log_message = log_message?;
    Some(Box::new(move |category, status, message| {
        // SAFETY: the host provides this function to be called with these C types (FMI 3.0.2, section
        // 2.3.1); the strings are zero-terminated and outlive the call.
        unsafe { log_message(environment, status, category.as_ptr(), message.as_ptr()) };
    }))
}

/// `fmi3FreeInstance`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3FreeInstance(instance: fmi3Instance) {
    // SAFETY: the host's promise: NULL or an instance, which is not used again.
    unsafe { free(instance) }
}

/// The operations whose arguments differ between the versions.
trait Operations {
    fn enter_initialization_mode(
        &mut self,
        tolerance_defined: bool,
        tolerance: f64,
        start: f64,
        stop_defined: bool,
        stop: f64,
    ) -> Outcome;

    fn do_step(
        &mut self,
        time: f64,
        step: f64,
        no_set_state: bool,
        event_handling_needed: Option<&mut fmi3Boolean>,
        terminate: Option<&mut fmi3Boolean>,
        early_return: Option<&mut fmi3Boolean>,
        last_successful_time: Option<&mut f64>,
    ) -> Outcome;
}

impl Operations for Instance {
    fn enter_initialization_mode(
        &mut self,
        _tolerance_defined: bool,
        _tolerance: f64,
        start: f64,
        stop_defined: bool,
        stop: f64,
    ) -> Outcome {
        self.experiment = (start, stop_defined.then_some(stop));
        self.enter_initialization()
    }

    fn do_step(
        &mut self,
        time: f64,
        step: f64,
        _no_set_state: bool,
        event_handling_needed: Option<&mut fmi3Boolean>,
        terminate: Option<&mut fmi3Boolean>,
        early_return: Option<&mut fmi3Boolean>,
        last_successful_time: Option<&mut f64>,
    ) -> Outcome {
        let stepped = self.container.do_step(time, step);
        let (reached, ended) = match &stepped {
            Ok(Stepped::Ended(time)) => (*time, true),
            _ => (self.container.time(), false),
        };
        for (result, value) in
            [(event_handling_needed, false), (terminate, ended), (early_return, false)]
        {
            result.into_iter().for_each(|result| *result = value.into());
        }
        last_successful_time.into_iter().for_each(|last| *last = reached);
        Ok(stepped.map(|_| ())?)
    }
}

const CLOCKS: &str = "a container has no clocks";
const EVENTS: &str = "hasEventMode is false";
const CONFIGURATION: &str = "a container has no structural parameters";

/// Defines operations that are not supported, for a reason.
macro_rules! unsupported {
    ($($operation:ident($($kind:ty),*): $reason:expr;)*) => {
        /// The operations that only this version has, none of which a container supports.
        impl Instance { $(
            fn $operation(&mut self, $(_: $kind),*) -> Outcome {
                Err(refused($reason))
            }
        )* }
    };
}
unsupported! {
    enter_event_mode(): EVENTS;
    enter_step_mode(): EVENTS;
    evaluate_discrete_states(): EVENTS;
    update_discrete_states(
        &mut fmi3Boolean, &mut fmi3Boolean, &mut fmi3Boolean, &mut fmi3Boolean, &mut fmi3Boolean, &mut f64
    ): EVENTS;
    enter_configuration_mode(): CONFIGURATION;
    exit_configuration_mode(): CONFIGURATION;
    get_clock(&[u32], &mut [fmi3Clock]): CLOCKS;
    set_clock(&[u32], &[fmi3Clock]): CLOCKS;
    get_interval_decimal(&[u32], &mut [f64], &mut [fmi3IntervalQualifier]): CLOCKS;
    get_interval_fraction(&[u32], &mut [u64], &mut [u64], &mut [fmi3IntervalQualifier]): CLOCKS;
    get_shift_decimal(&[u32], &mut [f64]): CLOCKS;
    get_shift_fraction(&[u32], &mut [u64], &mut [u64]): CLOCKS;
    set_interval_decimal(&[u32], &[f64]): CLOCKS;
    set_interval_fraction(&[u32], &[u64], &[u64]): CLOCKS;
    set_shift_decimal(&[u32], &[f64]): CLOCKS;
    set_shift_fraction(&[u32], &[u64], &[u64]): CLOCKS;
    get_number_of_variable_dependencies(u32, &mut usize): "providesPerElementDependencies is false";
    get_variable_dependencies(
        u32, &mut [usize], &mut [u32], &mut [usize], &mut [fmi3DependencyKind]
    ): "providesPerElementDependencies is false";
    get_adjoint_derivative(&[u32], &[u32], &[f64], &mut [f64]): "a container provides no adjoint derivatives";
}
