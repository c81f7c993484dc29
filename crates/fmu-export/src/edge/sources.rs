//! The interface of C sources. The library becomes one module of WebAssembly for one model, which `fmu-build` translates
//! to C; the C functions of the standard, in C as well, call it.
//!
//! The module exports the C functions of one version of FMI, from the rows of `fmi-abi`, except those that create and
//! free instances: `fmu_instantiate` and `fmu_free` have no pointers to functions of the host. An instance of the
//! module has one instance of the model, in a memory of its own, whose size is known from the start.
//!
//! A panic ends the instance with a trap, after a message to the host.

#![allow(clippy::too_many_arguments, reason = "as in the C interface")]

use std::alloc::{GlobalAlloc, Layout};
use std::cell::RefCell;
use std::ffi::{CStr, c_char, c_int};
use std::mem::MaybeUninit;
use std::panic::PanicHookInfo;
use std::ptr::null_mut;

use fmu_description::LogCategory;
use talc::wasm::{WasmArenaTalc, new_wasm_arena_allocator};

#[cfg(feature = "fmi2")]
use super::fmi2;
#[cfg(not(feature = "fmi2"))]
use super::fmi3::*;
use crate::entry::Entry;
use crate::fast::free;
#[cfg(not(feature = "fmi2"))]
use crate::fast::instance_at;
#[cfg(feature = "fmi2")]
use crate::log::{Log, Sink};
use crate::log::{silence_panics, text_of_panic};
#[cfg(not(feature = "fmi2"))]
use crate::pointers::slice;
use crate::pointers::{Pointer, c_message};
use crate::source_host;

/// The bytes that an instance of the only model may allocate: what its interface needs, and what the exporter adds, as
/// digits.
pub const fn heap(models: &[Entry], added: Option<&str>) -> usize {
    let (mut added, mut sum) = (
        match added {
            Some(added) => added.as_bytes(),
            None => &[],
        },
        0,
    );
    while let [digit, rest @ ..] = added {
        sum = 10 * sum + (*digit - b'0') as usize;
        added = rest;
    }
    match models {
        [model, ..] => model.needs.heap + sum,
        [] => 0,
    }
}

/// Allocates in a block of fixed size.
pub struct Allocator(WasmArenaTalc);

impl Allocator {
    /// # Safety
    /// Nothing else uses the block.
    pub const unsafe fn new<const SIZE: usize>(block: *mut [MaybeUninit<u8>; SIZE]) -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { new_wasm_arena_allocator(block) })
    }
}

// SAFETY: as the allocator inside.
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise.
        found(unsafe { self.0.alloc(layout) })
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { self.0.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller's promise.
        found(unsafe { self.0.realloc(pointer, layout, size) })
    }
}

/// Tells the host if there is no memory.
fn found(memory: *mut u8) -> *mut u8 {
    if memory.is_null() {
        let message = c"the instance needs more memory than it has; expected sources that are exported with a larger --heap";
        send(LogCategory::Error.status(), LogCategory::Error.name(), message);
    }
    memory
}

/// Memory for the arguments and results of calls.
struct Arguments {
    /// What the host asked for first. It stays where it is, so the host may use it for any call.
    first: Vec<u64>,
    /// For a call that needs more.
    large: Vec<u64>,
}

thread_local! {
    static ARGUMENTS: RefCell<Arguments> =
        const { RefCell::new(Arguments { first: Vec::new(), large: Vec::new() }) };
}

/// Memory for the arguments and results of a call; NULL if there is not enough. What the first call of this function
/// returns can always be used, the rest until the next call of this function.
#[unsafe(no_mangle)]
extern "C" fn fmu_arguments(size: usize) -> *mut u64 {
    let length = size.div_ceil(size_of::<u64>());
    ARGUMENTS.with_borrow_mut(|Arguments { first, large }| {
        let is_first = first.is_empty() || length <= first.len();
        let area = if is_first { first } else { large };
        match length <= area.len() || enlarge(area, length) {
            true => area.as_mut_ptr(),
            false => null_mut(),
        }
    })
}

/// Enlarges memory whose content is not needed. Returns whether this succeeded.
fn enlarge(area: &mut Vec<u64>, length: usize) -> bool {
    *area = Vec::new();
    let is_there = area.try_reserve_exact(length).is_ok();
    if is_there {
        area.resize(length, 0);
    }
    is_there
}

/// Creates the instance of a module, of type 0 (model exchange), 1 (co-simulation) or 2 (scheduled execution, whose locks
/// are around the calls of the module). The host has a callback for intermediate updates, or for updates of clocks. On
/// failure, logs the reason and returns NULL.
///
/// # Safety
/// Texts are NULL or zero-terminated; the array is NULL or has its length.
pub unsafe fn instantiate(
    models: &'static [Entry],
    name: *const c_char,
    token: *const c_char,
    resources: *const c_char,
    instance_type: c_int,
    logging_on: c_int,
    event_mode_used: c_int,
    early_return_allowed: c_int,
    intermediate_variables: *const u32,
    n: usize,
    has_update: c_int,
) -> Pointer {
    silence_panics(report_panic);
    #[cfg(feature = "fmi2")]
    let instance = {
        let _ = (event_mode_used, early_return_allowed, intermediate_variables, n);
        let _ = has_update;
        let sink: Sink = Box::new(|heading, message| {
            send(heading.status, heading.category, &c_message(message));
        });
        let log = Log::new(Some(sink), logging_on != 0);
        // SAFETY: the caller's promise.
        unsafe { fmi2::create(models, name, instance_type, token, resources, log) }
    };
    #[cfg(not(feature = "fmi2"))]
    let instance = {
        let needs = models.first().map(|model| model.needs).filter(|_| has_update != 0);
        let call_back = needs.and_then(|needs| needs.intermediate_update);
        let (visible, logging_on) = (fmi3False, (logging_on != 0).into());
        let (event_mode_used, early) = (event_mode_used != 0, early_return_allowed != 0);
        let (variables, log) = (intermediate_variables, Some(log_message as _));
        // SAFETY: the caller's promise.
        unsafe {
            match instance_type {
                0 => instantiate_model_exchange(
                    models,
                    name,
                    token,
                    resources,
                    visible,
                    logging_on,
                    null_mut(),
                    log,
                ),
                #[cfg(feature = "scheduled-execution")]
                2 => instantiate_scheduled_execution::<true>(
                    models,
                    name,
                    token,
                    resources,
                    visible,
                    logging_on,
                    null_mut(),
                    log,
                    needs.and_then(|needs| needs.clock_update),
                    None,
                    None,
                ),
                _ => instantiate_co_simulation(
                    models,
                    name,
                    token,
                    resources,
                    visible,
                    logging_on,
                    event_mode_used.into(),
                    early.into(),
                    variables,
                    n,
                    null_mut(),
                    log,
                    call_back,
                ),
            }
        }
    };
    if let [model, ..] = models {
        let length = model.needs.arguments.div_ceil(size_of::<u64>());
        ARGUMENTS.with_borrow_mut(|arguments| enlarge(&mut arguments.large, length));
    }
    instance
}

/// The number of elements of variables; an unknown one counts as one. The host reads no more values than this,
/// whatever length its caller passes.
///
/// # Safety
/// The host's promise: an instance, and an array of this length.
#[cfg(not(feature = "fmi2"))]
#[unsafe(no_mangle)]
unsafe extern "C" fn fmu_count_elements(
    instance: Pointer,
    references: *const u32,
    n: usize,
) -> usize {
    // SAFETY: the caller's promise.
    let (instance, references) = unsafe { (instance_at(instance), slice(references, n)) };
    let (Some(instance), Some(references)) = (instance, references) else { return 0 };
    let counts = references.iter().map(|&reference| instance.model.elements_in_use(reference));
    counts.map(|count| count.unwrap_or(1)).sum()
}

/// Frees the instance.
///
/// # Safety
/// The host's promise: NULL or the instance, which is not used again.
#[unsafe(no_mangle)]
unsafe extern "C" fn fmu_free(instance: Pointer) {
    // SAFETY: the caller's promise.
    unsafe { free(instance) }
}

fn send(status: c_int, category: &CStr, message: &CStr) {
    // SAFETY: the host provides this function; the texts outlive the call.
    unsafe { source_host::log(status, category.as_ptr(), message.as_ptr()) };
}

/// The callback of FMI 3.0 for messages.
#[cfg(not(feature = "fmi2"))]
unsafe extern "C" fn log_message(
    _environment: fmi3InstanceEnvironment,
    status: c_int,
    category: fmi3String,
    message: fmi3String,
) {
    // SAFETY: the caller's promise: zero-terminated texts.
    unsafe { source_host::log(status, category, message) };
}

/// Tells the host of a panic, after which the instance can only be freed.
fn report_panic(panic: &PanicHookInfo<'_>) {
    let place = panic.location().map_or_else(String::new, |place| format!("{place}: "));
    let text = text_of_panic(panic.payload());
    let message =
        c_message(&format!("{place}the model panicked; the instance can only be freed: {text}"));
    send(LogCategory::Fatal.status(), LogCategory::Fatal.name(), &message);
}
