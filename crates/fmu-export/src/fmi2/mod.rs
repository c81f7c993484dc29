//! The C interface of FMI 2.0.5: all 44 functions.
//!
//! The functions convert C arguments to slices and references, and call the component.
//! `fmi2Instantiate` is defined by [`export!`](crate::export), as only it depends on the models.
#![allow(
    non_snake_case,
    clippy::missing_safety_doc,
    clippy::too_many_arguments,
    reason = "names, arguments and safety requirements are defined by the standard"
)]

mod access;
mod common;
mod derivatives;
mod entry;
mod instance;
mod logger;
mod slave;
mod state;
mod unsupported;

use std::ffi::CStr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

pub use access::*;
pub use common::*;
pub use derivatives::*;
pub use entry::{Entry, interface};
pub use fmu_types::fmi2::*;
pub use slave::*;
pub use state::*;
pub use unsupported::*;

use crate::component::{Component, Outcome};
use crate::log::{Category, Log};
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
/// As [`instance::component`].
unsafe fn with(pointer: fmi2Component, call: impl FnOnce(&mut Component) -> Outcome) -> fmi2Status {
    // SAFETY: the caller's promise.
    match unsafe { instance::component(pointer) } {
        Some(component) => call(component).into(),
        None => fmi2Status::fmi2Error,
    }
}

/// The reason why [`slice`] or [`slice_mut`] returned `None`.
const NULL_ARRAY: &str = "an array is NULL though its length is not 0";

/// `n` elements behind a pointer; `None` if it is NULL although `n` is not 0.
///
/// # Safety
/// `pointer` is NULL or points to `n` elements that do not change during the slice's lifetime.
unsafe fn slice<'a, T>(pointer: *const T, n: usize) -> Option<&'a [T]> {
    if n == 0 {
        return Some(&[]);
    }
    // SAFETY: not NULL by the check, and valid for `n` elements by the caller's promise.
    (!pointer.is_null()).then(|| unsafe { std::slice::from_raw_parts(pointer, n) })
}

/// Like [`slice`], but mutable.
///
/// # Safety
/// As [`slice`], and the elements are not used otherwise during the slice's lifetime.
unsafe fn slice_mut<'a, T>(pointer: *mut T, n: usize) -> Option<&'a mut [T]> {
    if n == 0 {
        return Some(&mut []);
    }
    // SAFETY: not NULL by the check, and valid for `n` elements by the caller's promise.
    (!pointer.is_null()).then(|| unsafe { std::slice::from_raw_parts_mut(pointer, n) })
}

/// The string behind a pointer; `None` for NULL.
///
/// # Safety
/// `text` is NULL or points to a zero-terminated string that lives long enough.
unsafe fn text<'a>(text: fmi2String) -> Option<&'a CStr> {
    // SAFETY: not NULL by the check, and a C string by the caller's promise.
    (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) })
}

/// Keeps panic messages off stderr, as they go to the logger. The hook belongs to this library's own
/// copy of `std`, so the host's hook is unaffected.
fn silence_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| std::panic::set_hook(Box::new(|panic| panics::remember(panic.location()))));
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
    silence_panics();
    let made = catch_unwind(AssertUnwindSafe(|| {
        let log = Log::new(logger::sink(functions, name), logging_on != fmi2False);
        match choose(models, name, fmu_type, guid) {
            Ok(model) => {
                // SAFETY: the caller's promise: the text is NULL or valid.
                let location = unsafe { text(resource_location) };
                let resources = match location.map(CStr::to_str).transpose() {
                    Ok(location) => resources::path(location),
                    Err(_) => Err(format!("the resource location {location:?} is not UTF-8")),
                };
                Some(model.create(log, resources))
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

fn choose(
    models: &'static [Entry],
    name: Option<&CStr>,
    fmu_type: fmi2Type,
    guid: Option<&CStr>,
) -> Result<&'static Entry, String> {
    if name.is_none_or(CStr::is_empty) {
        return Err("the instance name is missing".into());
    }
    if name.is_some_and(|name| name.to_str().is_err()) {
        return Err("the instance name is not UTF-8".into());
    }
    if fmu_type != fmi2CoSimulation {
        return Err("this FMU is for co-simulation, not for model exchange".into());
    }
    let guid = guid.ok_or("the GUID is missing")?.to_string_lossy();
    models.iter().find(|m| m.guid() == guid).ok_or_else(|| {
        let known: Vec<String> = models
            .iter()
            .map(|m| format!("{} {}", m.name(), m.guid()))
            .collect();
        format!(
            "the GUID {guid} is that of another FMU or version; this binary has: {}",
            known.join(", ")
        )
    })
}
