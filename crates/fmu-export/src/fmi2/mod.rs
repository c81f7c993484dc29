//! The C interface of FMI 2.0.5: all 44 functions.
//!
//! The functions convert C arguments to slices and references, and call the component.
//! `fmi2Instantiate` is defined by [`export!`](crate::export), as only it depends on the models.
#![allow(
    non_snake_case,
    non_upper_case_globals,
    clippy::missing_safety_doc,
    clippy::too_many_arguments,
    reason = "names, arguments and safety requirements are defined by the standard"
)]

mod access;
pub(crate) mod calls;
mod co_simulation;
mod common;
mod derivatives;
mod instance;
mod logger;
mod model_exchange;
mod state;
mod unsupported;

use std::ffi::CStr;
use std::panic::{AssertUnwindSafe, catch_unwind};

pub use access::*;
pub use co_simulation::*;
pub use common::*;
pub use derivatives::*;
pub use fmu_types::fmi2::*;
pub(crate) use instance::create;
pub use model_exchange::*;
pub use state::*;
pub use unsupported::*;

use crate::component::{Component, Outcome};
use crate::entry::Entry;
use crate::lifecycle::Mode;
use crate::log::{Category, Log};
use crate::pointers::{NULL_ARRAY, NULL_RESULT, slice, slice_mut, text, variable};
use crate::{panics, resources};

impl From<Outcome> for fmi2Status {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Ok => Self::fmi2OK,
            Outcome::Discard => Self::fmi2Discard,
            Outcome::Error => Self::fmi2Error,
            Outcome::Fatal => Self::fmi2Fatal,
        }
    }
}

/// Calls the component behind the host's pointer. NULL has no logger, so it only returns an error.
///
/// # Safety
/// As [`component`](crate::instance::component).
unsafe fn with(pointer: fmi2Component, call: impl FnOnce(&mut Component) -> Outcome) -> fmi2Status {
    // SAFETY: the caller's promise.
    match unsafe { crate::instance::component::<instance::Functions>(pointer) } {
        Some(component) => call(component).into(),
        None => fmi2Status::fmi2Error,
    }
}

/// Creates an instance of the model with the given GUID. On failure, logs the reason and returns NULL.
///
/// # Safety
/// The requirements of the standard on the caller of `fmi2Instantiate`.
pub unsafe fn instantiate(
    models: &'static [Entry],
    instance_name: fmi2String,
    fmu_type: fmi2Type,
    guid: fmi2String,
    resource_location: fmi2String,
    functions: *const fmi2CallbackFunctions,
    _visible: fmi2Boolean,
    logging_on: fmi2Boolean,
) -> fmi2Component {
    // SAFETY: the caller's promise: callbacks and texts are NULL or valid.
    let (functions, name, guid) = unsafe { (functions.as_ref(), text(instance_name), text(guid)) };
    panics::silence();
    let made = catch_unwind(AssertUnwindSafe(|| {
        let log = Log::new(logger::sink(functions, name), logging_on != fmi2False);
        let mode = match fmu_type {
            fmi2ModelExchange => Ok(Mode::ModelExchange),
            fmi2CoSimulation => Ok(Mode::CoSimulation),
            other => Err(format!(
                "the type is {other}; expected fmi2ModelExchange (0) or fmi2CoSimulation (1)"
            )),
        };
        let model = mode.and_then(|mode| Ok((mode, Entry::choose(models, name, mode, guid)?)));
        match model {
            Ok((mode, model)) => {
                // SAFETY: the caller's promise: the text is NULL or valid.
                let location = unsafe { text(resource_location) };
                let resources = match location.map(CStr::to_str).transpose() {
                    Ok(location) => resources::path(location),
                    Err(_) => Err(format!("the resource location {location:?} is not UTF-8")),
                };
                Some(model.create_fmi2(mode, log, resources))
            }
            Err(reason) => {
                log.send(Category::Error, || format!("fmi2Instantiate: {reason}"));
                None
            }
        }
    }));
    match made {
        Ok(Some(instance)) => instance,
        _ => std::ptr::null_mut(),
    }
}
