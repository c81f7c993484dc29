//! The C interface of FMI 3.0.2: all 75 functions.
//!
//! As in [`fmi2`](mod@crate::fmi2), the functions convert C arguments to slices and references, and call
//! the component. The value reference of a variable is that of its first element in FMI 2.0, and the
//! independent variable has the next one after all others.
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
mod stepping;
mod unsupported;

use std::ffi::CStr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;

pub use access::*;
pub use co_simulation::*;
pub use common::*;
pub use derivatives::*;
pub use fmu_types::fmi3::*;
pub(crate) use instance::create;
pub use model_exchange::*;
pub use state::*;
pub use unsupported::*;

use crate::component::{Component, Outcome};
use crate::entry::Entry;
use crate::lifecycle::Mode;
use crate::log::{Category, Log};
use crate::panics;
use crate::pointers::{NULL_ARRAY, NULL_RESULT, slice, slice_mut, text, variable};
use crate::resources::Folder;

impl From<Outcome> for fmi3Status {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Ok => Self::fmi3OK,
            Outcome::Discard => Self::fmi3Discard,
            Outcome::Error => Self::fmi3Error,
            Outcome::Fatal => Self::fmi3Fatal,
        }
    }
}

/// What the host has said about an instance, apart from its mode.
#[derive(Debug, Clone, Default)]
pub(crate) struct Options {
    /// Whether a step may end early.
    pub(crate) early_return_allowed: bool,
    /// Called in a step, if the host asked for it.
    pub(crate) intermediate_update: Option<Callback>,
    /// The variables that the host may access in the callback.
    pub(crate) intermediate_variables: Vec<u32>,
}

/// The host's function for intermediate updates, and its environment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Callback {
    pub(crate) function: fmi3IntermediateUpdateCallback,
    pub(crate) environment: fmi3InstanceEnvironment,
}

/// Calls the component behind the host's pointer. NULL has no logger, so it only returns an error.
///
/// # Safety
/// As [`component`](crate::instance::component).
unsafe fn with(instance: fmi3Instance, call: impl FnOnce(&mut Component) -> Outcome) -> fmi3Status {
    // SAFETY: the caller's promise.
    match unsafe { crate::instance::component::<instance::Functions>(instance) } {
        Some(component) => call(component).into(),
        None => fmi3Status::fmi3Error,
    }
}

/// `fmi3InstantiateModelExchange`, which [`export!`](crate::export) defines. On failure, logs the reason
/// and returns NULL.
///
/// # Safety
/// The requirements of the standard on the caller.
pub unsafe fn instantiate_model_exchange(
    models: &'static [Entry],
    instance_name: fmi3String,
    instantiation_token: fmi3String,
    resource_path: fmi3String,
    _visible: fmi3Boolean,
    logging_on: fmi3Boolean,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
) -> fmi3Instance {
    let log = Log::new(
        logger::sink(environment, log_message),
        logging_on != fmi3False,
    );
    let function = "fmi3InstantiateModelExchange";
    // SAFETY: the caller's promise.
    unsafe {
        let texts = [instance_name, instantiation_token, resource_path];
        instantiate(
            function,
            models,
            texts,
            log,
            Mode::ModelExchange,
            Ok(Options::default()),
        )
    }
}

/// `fmi3InstantiateCoSimulation`, which [`export!`](crate::export) defines. On failure, logs the reason
/// and returns NULL.
///
/// # Safety
/// The requirements of the standard on the caller.
pub unsafe fn instantiate_co_simulation(
    models: &'static [Entry],
    instance_name: fmi3String,
    instantiation_token: fmi3String,
    resource_path: fmi3String,
    _visible: fmi3Boolean,
    logging_on: fmi3Boolean,
    event_mode_used: fmi3Boolean,
    early_return_allowed: fmi3Boolean,
    required_intermediate_variables: *const fmi3ValueReference,
    n_required_intermediate_variables: usize,
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
    intermediate_update: Option<fmi3IntermediateUpdateCallback>,
) -> fmi3Instance {
    let log = Log::new(
        logger::sink(environment, log_message),
        logging_on != fmi3False,
    );
    let mode = match event_mode_used {
        fmi3False => Mode::CoSimulation,
        _ => Mode::CoSimulationWithEvents,
    };
    // SAFETY: the caller's promise.
    let variables = unsafe {
        slice(
            required_intermediate_variables,
            n_required_intermediate_variables,
        )
    };
    let options = variables
        .map(|variables| Options {
            early_return_allowed: early_return_allowed != fmi3False,
            intermediate_update: intermediate_update.map(|function| Callback {
                function,
                environment,
            }),
            intermediate_variables: variables.to_vec(),
        })
        .ok_or_else(|| {
            "requiredIntermediateVariables is NULL though its length is not 0".to_owned()
        });
    let function = "fmi3InstantiateCoSimulation";
    // SAFETY: the caller's promise.
    unsafe {
        let texts = [instance_name, instantiation_token, resource_path];
        instantiate(function, models, texts, log, mode, options)
    }
}

/// Creates an instance of the model with the given token.
///
/// # Safety
/// The texts (name, token and resource path) are NULL or zero-terminated.
unsafe fn instantiate(
    function: &str,
    models: &'static [Entry],
    texts: [fmi3String; 3],
    log: Log,
    mode: Mode,
    options: Result<Options, String>,
) -> fmi3Instance {
    panics::silence();
    // SAFETY: the caller's promise.
    let [name, token, path] = texts.map(|pointer| unsafe { text(pointer) });
    let made = catch_unwind(AssertUnwindSafe(|| {
        let chosen = options.and_then(|options| {
            let model = Entry::choose(models, name, mode, token)?;
            Ok((model, options))
        });
        match chosen {
            Ok((model, options)) => Some(model.create_fmi3(mode, options, log, folder(path))),
            Err(reason) => {
                log.send(Category::Error, || format!("{function}: {reason}"));
                None
            }
        }
    }));
    match made {
        Ok(Some(instance)) => instance,
        _ => std::ptr::null_mut(),
    }
}

/// The folder of the resources, which is a path and not a URI in FMI 3.0.
fn folder(path: Option<&CStr>) -> Folder {
    let path = path.filter(|path| !path.is_empty());
    let path = path.ok_or("the host passed no resource path")?;
    let text = path.to_str();
    Ok(PathBuf::from(text.map_err(|_| {
        format!("the resource path {path:?} is not UTF-8")
    })?))
}
