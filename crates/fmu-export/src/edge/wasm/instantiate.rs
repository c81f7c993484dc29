//! The instances of a component, and their log.

use std::ffi::CStr;
use std::ptr::{null, null_mut};
use std::rc::Rc;

use super::call::{call, report_panic};
use super::scratch::put;
use crate::canonical::{slice, text};
use crate::edge::fmi3::{EDGE, fmi3FreeInstance};
use crate::entry::Entry;
#[cfg(feature = "scheduled-execution")]
use crate::instance::Scheduling;
use crate::instance::Settings;
use crate::lifecycle::InstanceType;
use crate::log::{self, Log, Sink};
use crate::needs::new_co_simulation;
use crate::pointers::Pointer;
#[cfg(feature = "scheduled-execution")]
use crate::preemption::Preemption;
use crate::resources::Folder;

#[link(wasm_import_module = "fmi:fmi3/callbacks@3.0.0")]
unsafe extern "C" {
    #[link_name = "log-message"]
    fn log_message(
        instance: *const u8,
        instance_length: usize,
        status: i32,
        category: *const u8,
        category_length: usize,
        message: *const u8,
        message_length: usize,
    );
}

unsafe extern "Rust" {
    /// The models of the library, as [`export!`](crate::export) defines it.
    safe fn fmu_export_models() -> &'static [Entry];
}

/// An instance that the host gets, or none.
#[allow(dead_code, reason = "the host reads it")]
#[repr(C, u8)]
pub enum Handle {
    None,
    Some(u32),
}

#[unsafe(no_mangle)]
unsafe extern "C" fn instantiate_co_simulation(
    name: *const u8,
    name_length: usize,
    token: *const u8,
    token_length: usize,
    _path: *const u8,
    _path_length: usize,
    _visible: bool,
    logging_on: bool,
    event_mode_used: bool,
    early_return_allowed: bool,
    intermediate_variables: *const u32,
    n: usize,
) -> *const Handle {
    // SAFETY: the host's promises.
    let (name, token, intermediate_variables) = unsafe {
        let variables = slice(intermediate_variables, n).to_vec();
        (text(name, name_length), text(token, token_length), variables)
    };
    let instance_type = match event_mode_used {
        true => InstanceType::CoSimulationWithEvents,
        false => InstanceType::CoSimulation,
    };
    let call_back = fmu_export_models().iter().find_map(|model| model.needs.intermediate_update);
    let settings = Settings {
        early_return_allowed,
        // The host cannot call the component meanwhile, so this serves an early return only.
        intermediate_update: call_back
            .filter(|_| early_return_allowed)
            .map(|f| Rc::new(f) as Rc<_>),
        intermediate_variables,
        ..settings(&name, logging_on)
    };
    instantiate("fmi3InstantiateCoSimulation", (&name, &token), instance_type, settings, |i| {
        if InstanceType::HAS_CO_SIMULATION { new_co_simulation(i) } else { 0 }
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn instantiate_model_exchange(
    name: *const u8,
    name_length: usize,
    token: *const u8,
    token_length: usize,
    _path: *const u8,
    _path_length: usize,
    _visible: bool,
    logging_on: bool,
) -> *const Handle {
    // SAFETY: the host's promises.
    let (name, token) = unsafe { (text(name, name_length), text(token, token_length)) };
    let settings = settings(&name, logging_on);
    let new = fmu_export_models().iter().find_map(|model| model.needs.new_model_exchange);
    instantiate(
        "fmi3InstantiateModelExchange",
        (&name, &token),
        InstanceType::ModelExchange,
        settings,
        |i| new.map_or(0, |new| new(i)),
    )
}

#[cfg(feature = "scheduled-execution")]
#[unsafe(no_mangle)]
unsafe extern "C" fn instantiate_scheduled_execution(
    name: *const u8,
    name_length: usize,
    token: *const u8,
    token_length: usize,
    _path: *const u8,
    _path_length: usize,
    _visible: bool,
    logging_on: bool,
) -> *const Handle {
    // SAFETY: the host's promises.
    let (name, token) = unsafe { (text(name, name_length), text(token, token_length)) };
    let clock_update = fmu_export_models().iter().find_map(|model| model.needs.clock_update);
    // A host cannot preempt a call of a component, so there is nothing to lock.
    let settings = Settings {
        scheduling: Some(Scheduling::new(
            Preemption::new(None, None, Log::new(None, false)),
            clock_update.map(|f| Rc::new(f) as Rc<_>),
        )),
        ..settings(&name, logging_on)
    };
    instantiate(
        "fmi3InstantiateScheduledExecution",
        (&name, &token),
        InstanceType::ScheduledExecution,
        settings,
        |i| crate::needs::new_scheduled_execution(i),
    )
}

/// Defines the functions that create an instance without a path of resources, for the draft at commit 77277f4.
macro_rules! without_path {
    ($($name:ident by $with:ident($($arg:ident: $type:ty),*);)*) => { $(
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $name(
            name: *const u8, name_length: usize, token: *const u8, token_length: usize $(, $arg: $type)*
        ) -> *const Handle {
            // SAFETY: the host's promises.
            unsafe { $with(name, name_length, token, token_length, null(), 0 $(, $arg)*) }
        }
    )* };
}

without_path! {
    instantiate_co_simulation_without_path by instantiate_co_simulation(
        visible: bool, logging_on: bool, event_mode_used: bool, early_return_allowed: bool,
        intermediate_variables: *const u32, n: usize
    );
    instantiate_model_exchange_without_path by instantiate_model_exchange(
        visible: bool, logging_on: bool
    );
}

#[cfg(feature = "scheduled-execution")]
without_path! {
    instantiate_scheduled_execution_without_path by instantiate_scheduled_execution(
        visible: bool, logging_on: bool
    );
}

fn settings(name: &CStr, logging_on: bool) -> Settings {
    let log = Log::new(Some(sink(name)), logging_on);
    let folder =
        "a component has no folder of resources; expected a text read with `read_resource`";
    Settings::new(&EDGE, log, Folder::Known(Err(folder.into())))
}

/// Forwards messages to the host.
fn sink(name: &CStr) -> Sink {
    let name = name.to_owned();
    Box::new(move |heading, message| {
        // `#` introduces a value reference (FMI 3.0.2, section 2.3.1).
        let (name, message) = (name.to_bytes(), message.replace('#', "##"));
        let (status, category) = (heading.status, heading.category.to_bytes());
        // SAFETY: the host provides this function with these arguments; the texts are UTF-8 and outlive the call.
        unsafe {
            let (name, n) = (name.as_ptr(), name.len());
            let (category, of_category) = (category.as_ptr(), category.len());
            log_message(name, n, status, category, of_category, message.as_ptr(), message.len());
        }
    })
}

fn instantiate(
    function: &str,
    (name, token): (&CStr, &CStr),
    instance_type: InstanceType,
    settings: Settings,
    new: impl FnOnce(Pointer) -> u32,
) -> *const Handle {
    log::silence_panics(report_panic);
    call(null_mut(), || {
        let models = fmu_export_models();
        let made = crate::edge::instantiate(
            function,
            models,
            (Some(name), Some(token)),
            Ok(instance_type),
            settings,
        );
        put(match made.is_null() {
            true => Handle::None,
            false => Handle::Some(new(made)),
        })
    })
}

/// Frees an instance that the host drops.
#[unsafe(no_mangle)]
unsafe extern "C" fn free_instance(instance: Pointer) {
    // SAFETY: the host's promise: an instance that is not used again.
    call(null_mut(), || unsafe { fmi3FreeInstance(instance) });
}
