//! The C interface of FMI 2.0.5 for co-simulation.

use std::ffi::{CStr, c_int};
use std::path::PathBuf;

pub use fmi_abi::fmi2::*;
use fmi_abi::state::State;
use fmi_abi::{FmiVersion, c_type, fmi2_functions};
use fmu_description::location::path_of;
use fmu_master::container::Stepped;

use crate::host_log::{HostLog, Sink};
use crate::instance::{Failed, Instance, Outcome, Status, free, instantiate, refused};
use crate::pointers::{NULL_ARRAY, slice, slice_mut, text};

fmi2_functions!(entries! fmi2Component fmi2Status);

/// `fmi2GetTypesPlatform`
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetTypesPlatform() -> fmi2String {
    c"default".as_ptr()
}

/// `fmi2GetVersion`
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetVersion() -> fmi2String {
    c"2.0".as_ptr()
}

/// `fmi2Instantiate`. On failure, logs the reason and returns NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Instantiate(
    name: fmi2String,
    kind: fmi2Type,
    guid: fmi2String,
    resources: fmi2String,
    functions: *const fmi2CallbackFunctions,
    _visible: fmi2Boolean,
    logging_on: fmi2Boolean,
) -> fmi2Component {
    // SAFETY: the host's promise: callbacks and texts are NULL or valid.
    let (name, guid, resources, functions) =
        unsafe { (text(name), text(guid), text(resources), functions.as_ref()) };
    let log = HostLog::new(sink(functions, name), logging_on != fmi2False);
    let folder: Result<PathBuf, String> = match (kind, resources.map(CStr::to_str)) {
        (fmi2CoSimulation, Some(Ok(location))) => path_of(location),
        (fmi2CoSimulation, _) => Err("the host passed no resource location in UTF-8".to_owned()),
        (other, _) => Err(format!("the type is {other}; expected fmi2CoSimulation (1)")),
    };
    let folder = folder.as_deref().map_err(Clone::clone);
    instantiate("fmi2Instantiate", FmiVersion::Fmi2, guid, folder, log)
}

/// Forwards messages to the host's logger, if the host provides one.
fn sink(functions: Option<&fmi2CallbackFunctions>, name: Option<&CStr>) -> Option<Sink> {
    let environment = functions?.componentEnvironment;
    let logger = functions?.logger?;
    let instance = name.map(CStr::to_owned).unwrap_or_default();
    Some(Box::new(move |category, status, message| {
        // SAFETY: the host provides this function to be called with these C types (FMI 2.0.5, section
        // 2.1.5); all strings are zero-terminated and outlive the call; the text is an argument of the format
        // "%s", never the format itself.
        unsafe {
            let (instance, format) = (instance.as_ptr(), c"%s".as_ptr());
            let status = fmi2Status(status);
            logger(environment, instance, status, category.as_ptr(), format, message.as_ptr());
        }
    }))
}

/// `fmi2FreeInstance`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeInstance(instance: fmi2Component) {
    // SAFETY: the host's promise: NULL or an instance, which is not used again.
    unsafe { free(instance) }
}

/// The operations whose arguments differ between the versions.
trait Operations {
    fn enter_initialization_mode(&mut self) -> Outcome;
    fn do_step(&mut self, time: f64, step: f64, no_set_state: bool) -> Outcome;
}

impl Operations for Instance {
    fn enter_initialization_mode(&mut self) -> Outcome {
        self.enter_initialization()
    }

    fn do_step(&mut self, time: f64, step: f64, _no_set_state: bool) -> Outcome {
        match self.container.do_step(time, step)? {
            Stepped::Done => Ok(()),
            Stepped::Ended(time) => {
                self.state = State::StepFailed;
                let reason = format!("an FMU has ended the simulation at t = {time:?} s");
                Err(Failed::Discarded(reason))
            }
        }
    }
}

/// The operations that only this version has.
impl Instance {
    fn setup_experiment(
        &mut self,
        _tolerance_defined: bool,
        _tolerance: f64,
        start: f64,
        stop_defined: bool,
        stop: f64,
    ) -> Outcome {
        self.experiment = (start, stop_defined.then_some(stop));
        Ok(())
    }

    fn set_input_derivatives(
        &mut self,
        _references: &[u32],
        _orders: &[i32],
        _values: &[f64],
    ) -> Outcome {
        Err(refused("canInterpolateInputs is false"))
    }

    fn cancel_step(&mut self) -> Outcome {
        Err(refused("canRunAsynchronuously is false"))
    }

    fn get_status(&mut self, _kind: c_int, value: Option<&mut fmi2Status>) -> Outcome {
        answer(None, value)
    }

    fn get_real_status(&mut self, kind: c_int, value: Option<&mut f64>) -> Outcome {
        let time = self.container.ended().unwrap_or(self.container.time());
        answer((kind == fmi2LastSuccessfulTime).then_some(time), value)
    }

    fn get_integer_status(&mut self, _kind: c_int, value: Option<&mut i32>) -> Outcome {
        answer(None, value)
    }

    fn get_string_status(&mut self, _kind: c_int, value: Option<&mut fmi2String>) -> Outcome {
        answer(None, value)
    }

    fn get_boolean_status(&mut self, kind: c_int, value: Option<&mut fmi2Boolean>) -> Outcome {
        let ended = self.container.ended().is_some();
        answer((kind == fmi2Terminated).then_some(ended.into()), value)
    }
}

/// Returns a status value, or discards the call (FMI 2.0.5, section 4.2.3).
fn answer<T>(answer: Option<T>, value: Option<&mut T>) -> Outcome {
    let none =
        || Failed::Discarded("this kind of status exists for asynchronous steps only".to_owned());
    let answer = answer.ok_or_else(none)?;
    *value.ok_or_else(|| refused("the pointer to the value is NULL"))? = answer;
    Ok(())
}
