//! The C interface of FMI 2.0.5: all 44 functions. Those that instantiate are defined by
//! [`export!`](crate::export), as they depend on the models.
#![allow(
    non_snake_case,
    non_upper_case_globals,
    clippy::missing_safety_doc,
    clippy::too_many_arguments,
    reason = "names, arguments and safety requirements are defined by the standard"
)]

use std::borrow::BorrowMut;
use std::ffi::{CStr, c_int};

pub use fmi_abi::fmi2::*;
use fmi_abi::state::State;
use fmi_abi::{FmiVersion, c_type, fmi2_functions};

use crate::entry::Entry;
use crate::error::ModelError;
use crate::fast::{free, head};
use crate::instance::{Edge, Instance, Settings, Status};
use crate::lifecycle::InstanceType;
use crate::log::{Log, Sink};
use crate::pointers::{NULL_ARRAY, c_message, slice, slice_mut, text};
use crate::resources::Folder;

static EDGE: Edge = Edge {
    version: FmiVersion::Fmi2,
    get_float64: calls::fmi2GetReal,
    set_float64: calls::fmi2SetReal,
    do_step: calls::fmi2DoStep,
    get_fmu_state: calls::fmi2GetFMUstate,
    has_clocks: false,
};

fmi2_functions!(entries! fmi2Component fmi2Status);

/// Why a function of the model is not supported.
fn unsupported(_name: &str) -> &'static str {
    "the slave steps synchronously: canRunAsynchronuously is false"
}

/// `fmi2GetTypesPlatform`
#[cfg_attr(not(target_arch = "wasm32"), unsafe(no_mangle))]
pub extern "C" fn fmi2GetTypesPlatform() -> fmi2String {
    c"default".as_ptr()
}

/// `fmi2GetVersion`
#[cfg_attr(not(target_arch = "wasm32"), unsafe(no_mangle))]
pub extern "C" fn fmi2GetVersion() -> fmi2String {
    c"2.0".as_ptr()
}

/// Creates an instance of the model with the given GUID. On failure, logs the reason and returns NULL.
///
/// # Safety
/// The requirements of the standard on the caller of `fmi2Instantiate`.
pub unsafe fn instantiate(
    models: &'static [Entry],
    name: fmi2String,
    kind: fmi2Type,
    guid: fmi2String,
    resources: fmi2String,
    functions: *const fmi2CallbackFunctions,
    _visible: fmi2Boolean,
    logging_on: fmi2Boolean,
) -> fmi2Component {
    // SAFETY: the caller's promise: callbacks and texts are NULL or valid.
    unsafe {
        let log = Log::new(sink(functions.as_ref(), text(name)), logging_on != fmi2False);
        create(models, name, kind, guid, resources, log)
    }
}

/// Creates an instance with a log.
///
/// # Safety
/// As [`instantiate`].
pub(super) unsafe fn create(
    models: &'static [Entry],
    name: fmi2String,
    kind: fmi2Type,
    guid: fmi2String,
    resources: fmi2String,
    log: Log,
) -> fmi2Component {
    // SAFETY: the caller's promise: texts are NULL or valid.
    let [name, guid, location] = unsafe { [name, guid, resources].map(|pointer| text(pointer)) };
    let instance_type = match kind {
        fmi2ModelExchange => Ok(InstanceType::ModelExchange),
        fmi2CoSimulation => Ok(InstanceType::CoSimulation),
        other => Err(format!(
            "the type is {other}; expected fmi2ModelExchange (0) or fmi2CoSimulation (1)"
        )),
    };
    let resources = Folder::named(FmiVersion::Fmi2, location);
    let settings = Settings::new(&EDGE, log, resources);
    super::instantiate("fmi2Instantiate", models, (name, guid), instance_type, settings)
}

/// Forwards messages to the host's logger, if the host provides one.
fn sink(functions: Option<&fmi2CallbackFunctions>, name: Option<&CStr>) -> Option<Sink> {
    let environment = functions?.componentEnvironment;
    let logger = functions?.logger?;
    let instance = name.map(CStr::to_owned).unwrap_or_default();
    Some(Box::new(move |heading, message| {
        let status = fmi2Status(heading.status);
        let (category, text) = (heading.category.as_ptr(), c_message(message));
        // SAFETY: the host provides this function to be called with these C types (FMI 2.0.5, section
        // 2.1.5); all strings are zero-terminated and outlive the call; the text is an argument of the format
        // "%s", never the format itself.
        unsafe {
            let (instance, format, text) = (instance.as_ptr(), c"%s".as_ptr(), text.as_ptr());
            logger(environment, instance, status, category, format, text);
        }
    }))
}

/// `fmi2FreeInstance`
#[cfg_attr(not(target_arch = "wasm32"), unsafe(no_mangle))]
pub unsafe extern "C" fn fmi2FreeInstance(instance: fmi2Component) {
    // SAFETY: the host's promise: NULL or an instance, which is not used again.
    unsafe { free(instance) }
}

/// `fmi2GetReal`
#[cfg_attr(any(not(target_arch = "wasm32"), feature = "sources"), unsafe(no_mangle))]
pub unsafe extern "C" fn fmi2GetReal(
    instance: fmi2Component,
    references: *const u32,
    n: usize,
    values: *mut f64,
) -> fmi2Status {
    // SAFETY: the host's promises, as for all entry points.
    let status = unsafe {
        match head(instance) {
            Some(head) => (head.vtable.get_elements)(instance, references, n, values),
            None => Status::Error,
        }
    };
    fmi2Status(status as c_int)
}

/// `fmi2SetReal`
#[cfg_attr(any(not(target_arch = "wasm32"), feature = "sources"), unsafe(no_mangle))]
pub unsafe extern "C" fn fmi2SetReal(
    instance: fmi2Component,
    references: *const u32,
    n: usize,
    values: *const f64,
) -> fmi2Status {
    // SAFETY: the host's promises, as for all entry points.
    let status = unsafe {
        match head(instance) {
            Some(head) => (head.vtable.set_elements)(instance, references, n, values),
            None => Status::Error,
        }
    };
    fmi2Status(status as c_int)
}

exported! { CoSimulation
    /// `fmi2DoStep`
    pub unsafe extern "C" fn fmi2DoStep(
        instance: fmi2Component,
        time: f64,
        step: f64,
        _no_set_state: fmi2Boolean,
    ) -> fmi2Status {
        // SAFETY: the host's promises, as for all entry points.
        let status = unsafe {
            match head(instance) {
                Some(head) => (head.vtable.step)(instance, time, step, None),
                None => Status::Error,
            }
        };
        fmi2Status(status as c_int)
    }
}

/// The operations whose arguments differ between the versions.
trait Operations: BorrowMut<Instance> {
    fn enter_initialization_mode(&mut self) -> Result<(), ModelError> {
        self.borrow_mut().enter(State::Initialization);
        Ok(())
    }

    fn update_discrete_states(&mut self, info: &mut fmi2EventInfo) -> Result<(), ModelError> {
        let update = self.borrow_mut().update_instant()?;
        *info = fmi2EventInfo {
            newDiscreteStatesNeeded: fmi2False,
            terminateSimulation: fmi2False,
            nominalsOfContinuousStatesChanged: fmi2False,
            valuesOfContinuousStatesChanged: update.states_changed.into(),
            nextEventTimeDefined: update.next_event.is_some().into(),
            nextEventTime: update.next_event.unwrap_or_default(),
        };
        Ok(())
    }
}

impl Operations for Instance {}

/// The operations that only this version has.
impl Instance {
    fn setup_experiment(
        &mut self,
        tolerance_defined: bool,
        tolerance: f64,
        start: f64,
        stop_defined: bool,
        stop: f64,
    ) -> Result<(), ModelError> {
        let tolerance = tolerance_defined.then_some(tolerance);
        self.set_experiment(start, stop_defined.then_some(stop), tolerance)
    }

    fn get_status(
        &mut self,
        _kind: c_int,
        value: Option<&mut fmi2Status>,
    ) -> Result<(), ModelError> {
        answer(None, value)
    }

    fn get_real_status(&mut self, kind: c_int, value: Option<&mut f64>) -> Result<(), ModelError> {
        let now = self.shared.lifecycle.now();
        answer((kind == fmi2LastSuccessfulTime).then_some(now), value)
    }

    fn get_integer_status(
        &mut self,
        _kind: c_int,
        value: Option<&mut i32>,
    ) -> Result<(), ModelError> {
        answer(None, value)
    }

    fn get_string_status(
        &mut self,
        _kind: c_int,
        value: Option<&mut fmi2String>,
    ) -> Result<(), ModelError> {
        answer(None, value)
    }

    fn get_boolean_status(
        &mut self,
        kind: c_int,
        value: Option<&mut fmi2Boolean>,
    ) -> Result<(), ModelError> {
        answer((kind == fmi2Terminated).then_some(fmi2False), value)
    }
}

/// Returns a status value. "If a status is required which cannot be retrieved by the slave it returns fmi2Discard"
/// (FMI 2.0.5, section 4.2.3).
fn answer<T>(answer: Option<T>, value: Option<&mut T>) -> Result<(), ModelError> {
    let answer = answer.ok_or_else(|| {
        ModelError::discard(
            "this kind of status exists for asynchronous steps only, which the slave does not support",
        )
    })?;
    let value = value.ok_or_else(|| ModelError::refuse("the pointer to the value is NULL"))?;
    *value = answer;
    Ok(())
}
