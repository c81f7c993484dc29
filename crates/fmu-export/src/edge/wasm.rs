//! The interface of WebAssembly components: the draft FMI-LS-WASM of the layered standard, whose functions
//! are listed in `component.wit` of the crate `fmu-build`.
//!
//! By the canonical ABI of the component model, a list is a pointer and a length, as in C. So most functions
//! have the arguments of the C function that performs the same operation, and call it. Those that return more
//! than a status return a pointer to an [`Answer`]. The functions have the names of their operations;
//! `fmu-build` exports them under their names in the interfaces of the component.
//!
//! A component cannot catch a panic. It ends with a trap, after a message to the host.
#![allow(
    missing_docs,
    non_upper_case_globals,
    clippy::missing_safety_doc,
    clippy::too_many_arguments,
    reason = "as in the C interface"
)]

use std::cell::Cell;
use std::ffi::{CStr, CString};
use std::mem::{MaybeUninit, transmute};
use std::panic::PanicHookInfo;
use std::path::Path;
use std::ptr::{null, null_mut};
use std::rc::Rc;

use fmi_abi::{Call, fmi2, fmi3_functions};
use fmu_description::{Type, Value};

use super::c_text;
use super::fmi3::*;
use super::scratch::{self, allocate, put};
use crate::entry::Entry;
use crate::error::{ModelError, refused};
use crate::fast::{instance_at, shared};
use crate::instance::{Instance, IntermediateUpdate, Pointer, Settings};
use crate::laid_out::SolverVector;
use crate::lifecycle::InstanceType;
use crate::log::{Category, Log, Sink};
use crate::model::Model;
use crate::values::HostValue;

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

#[link(wasm_import_module = "fmi:fmi3/intermediate-update-callbacks@3.0.0")]
unsafe extern "C" {
    #[link_name = "intermediate-update"]
    fn intermediate_update(
        time: f64,
        set_requested: bool,
        get_allowed: bool,
        step_finished: bool,
        can_return_early: bool,
        requested: *mut EarlyReturn,
    );
}

#[link(wasm_import_module = "fmi:fmi3/resource-dir-callbacks@3.0.0")]
unsafe extern "C" {
    #[link_name = "read-file"]
    fn read_file(path: *const u8, length: usize, content: *mut MaybeUninit<Answer<Text, Text>>);
}

#[link(wasm_import_module = "[export]fmi:fmi3/co-simulation@3.0.0")]
unsafe extern "C" {
    #[link_name = "[resource-new]co-simulation-instance"]
    safe fn new_co_simulation(instance: Pointer) -> u32;
}

#[link(wasm_import_module = "[export]fmi:fmi3/model-exchange@3.0.0")]
unsafe extern "C" {
    #[link_name = "[resource-new]model-exchange-instance"]
    safe fn new_model_exchange(instance: Pointer) -> u32;
}

unsafe extern "Rust" {
    /// The models of the library, as [`export!`](crate::export) defines it.
    safe fn fmu_export_models() -> &'static [Entry];
}

/// What a model needs of the host. A component imports what one of its models needs, since the linker drops the
/// others.
pub(crate) struct Needs {
    new_model_exchange: Option<extern "C" fn(Pointer) -> u32>,
    intermediate_update: Option<fn(IntermediateUpdate) -> Option<f64>>,
}

impl Needs {
    pub(crate) const fn of<M: Model>() -> Self {
        extern "C" fn new(instance: Pointer) -> u32 {
            new_model_exchange(instance)
        }
        Self {
            new_model_exchange: match M::IS_SAMPLED || M::IS_CONTINUOUS {
                true => Some(new),
                false => None,
            },
            intermediate_update: match M::IS_CONTINUOUS {
                true => Some(call_back),
                false => None,
            },
        }
    }
}

/// The result of a function that returns more than a status.
#[repr(C, u8)]
pub enum Answer<T, E = u8> {
    Ok(T),
    Err(E),
}

/// A list of arguments or results, or a text.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct List<T> {
    first: *const T,
    length: usize,
}

type Text = List<u8>;
type Values<T> = *const Answer<List<T>>;

fn list<T>(values: &[T]) -> List<T> {
    List { first: values.as_ptr(), length: values.len() }
}

/// The elements of a list of the host.
///
/// # Safety
/// The host's promise: the list is valid during the call.
unsafe fn slice<'a, T>(first: *const T, length: usize) -> &'a [T] {
    // SAFETY: the caller's promise; a list without elements may have any pointer.
    unsafe { crate::fast::slice(first, length).unwrap_or_default() }
}

/// A text of the host, as it is passed to C.
///
/// # Safety
/// As [`slice`].
unsafe fn text(first: *const u8, length: usize) -> CString {
    // SAFETY: the caller's promise.
    c_text(&String::from_utf8_lossy(unsafe { slice(first, length) }))
}

thread_local! {
    /// The instance of the current call, whose log has the message of a panic.
    static CURRENT: Cell<Pointer> = const { Cell::new(null_mut()) };
}

/// Does the work of a call.
fn call<T>(instance: Pointer, work: impl FnOnce() -> T) -> T {
    CURRENT.set(instance);
    let result = work();
    scratch::end();
    result
}

/// The answer of a function of C, which has a result if its status is good.
fn answer<T>(status: fmi3Status, result: T) -> *const Answer<T> {
    put(match status {
        fmi3OK => Answer::Ok(result),
        status => Answer::Err(status.0 as u8),
    })
}

/// Gets numbers by a function of C, which writes `n` of them.
unsafe fn values<T>(
    instance: Pointer,
    n: usize,
    get: impl FnOnce(*mut T, usize) -> fmi3Status,
) -> Values<T> {
    call(instance, || {
        let first = allocate(n);
        answer(get(first, n), List { first: first.cast_const(), length: n })
    })
}

/// A function of C that gets variables.
type Get<T> = unsafe extern "C" fn(Pointer, *const u32, usize, *mut T, usize) -> fmi3Status;

/// Gets variables by a function of C.
///
/// # Safety
/// As [`slice`].
unsafe fn get<T>(instance: Pointer, references: *const u32, n: usize, by: Get<T>) -> Values<T> {
    /// Compiled once, for values of any size.
    #[inline(never)]
    unsafe fn get(
        i: Pointer,
        references: *const u32,
        n: usize,
        size: usize,
        by: Get<u64>,
    ) -> Values<u64> {
        // SAFETY: the caller's promise; the memory is for as many values.
        unsafe {
            let n_values = count(i, references, n);
            call(i, || {
                let first = allocate(n_values.saturating_mul(size).div_ceil(size_of::<u64>()));
                let status = by(i, references, n, first, n_values);
                answer(status, List { first: first.cast_const(), length: n_values })
            })
        }
    }
    // SAFETY: the caller's promise; functions whose pointers are to other types are called in the same way.
    unsafe {
        get(instance, references, n, size_of::<T>(), transmute::<Get<T>, Get<u64>>(by)).cast()
    }
}

/// The number of elements of variables; an unknown one is left to the function that is called.
///
/// # Safety
/// As [`slice`].
unsafe fn count(instance: Pointer, references: *const u32, n: usize) -> usize {
    // SAFETY: the caller's promise.
    unsafe { shared(instance).map_or(0, |shared| (shared.vtable.count)(instance, references, n)) }
}

/// Defines the functions whose arguments are those of C, from the rows of `fmi-abi`.
macro_rules! methods {
    (
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident $arguments:tt => $operation:ident in $($states:ident)|+;)* })*
    ) => {
        $($(method!($name $arguments $operation $($states)|+);)*)*
    };
}

macro_rules! method {
    // Below, as they have texts, bytes, or other arguments than in C.
    ($name:ident $arguments:tt $operation:ident NOWHERE) => {};
    ($name:ident(state: fmi3FMUState) $($rest:tt)*) => {};
    (fmi3GetString $($rest:tt)*) => {};
    (fmi3SetString $($rest:tt)*) => {};

    ($name:ident(
        references: [in u32; n], n: [len], values: [out $type:ty; n_values], n_values: [len]
    ) $operation:ident $($states:tt)*) => {
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $operation(
            instance: Pointer, references: *const u32, n: usize
        ) -> Values<$type> {
            // SAFETY: the host's promises.
            unsafe { get(instance, references, n, $name) }
        }
    };
    ($name:ident(
        references: [in u32; n], n: [len], values: [in $type:ty; n_values], n_values: [len]
    ) $operation:ident $($states:tt)*) => {
        method!(@ $name $operation(
            references: *const u32, n: usize, values: *const $type, n_values: usize
        ));
    };
    ($name:ident(states: [in f64; n], n: [len]) $operation:ident $($states:tt)*) => {
        method!(@ $name $operation(states: *const f64, n: usize));
    };
    (fmi3GetEventIndicators $arguments:tt $operation:ident $($states:tt)*) => {
        method!(@ fmi3GetEventIndicators $operation EventIndicators);
    };
    ($name:ident(values: [out f64; n], n: [len]) $operation:ident $($states:tt)*) => {
        method!(@ $name $operation States);
    };
    (@ $name:ident $operation:ident $which:ident) => {
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $operation(instance: Pointer) -> Values<f64> {
            // SAFETY: the host's promises.
            unsafe {
                let n = instance_at(instance).map_or(0, |c| c.model.length(SolverVector::$which));
                values(instance, n, |first, n| $name(instance, first, n))
            }
        }
    };
    ($name:ident(n: [out usize]) $operation:ident $($states:tt)*) => {
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $operation(instance: Pointer) -> *const Answer<u64> {
            call(instance, || {
                let mut n = 0;
                // SAFETY: the host's promises.
                let status = unsafe { $name(instance, &mut n) };
                answer(status, n as u64)
            })
        }
    };
    ($name:ident($($arg:ident: $type:ident),*) $operation:ident $($states:tt)*) => {
        method!(@ $name $operation($($arg: $type),*));
    };
    (@ $name:ident $operation:ident($($arg:ident: $type:ty),*)) => {
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $operation(instance: Pointer $(, $arg: $type)*) -> fmi3Status {
            // SAFETY: the host's promises.
            call(instance, || unsafe { $name(instance $(, $arg)*) })
        }
    };
    ($($by_hand:tt)*) => {};
}

fmi3_functions!(methods!);

/// Defines functions of abilities that the FMUs do not have.
macro_rules! unsupported {
    ($($name:ident: $operation:ident($($type:ty),*) -> $result:ty = $failed:expr;)*) => { $(
        #[unsafe(no_mangle)]
        extern "C" fn $operation(instance: Pointer $(, _: $type)*) -> $result {
            refuse(instance, &calls::$name);
            $failed
        }
    )* };
}

#[inline(never)]
fn refuse(instance: Pointer, operation: &Call) {
    call(instance, || {
        // SAFETY: the host's promise: an instance that is not used otherwise.
        let c = unsafe { instance_at(instance) };
        c.map(|c| c.refuse(operation, unsupported(operation.name)));
    });
}

fn failed<T>() -> *const Answer<T> {
    put(Answer::Err(fmi3Error.0 as u8))
}

unsupported! {
    fmi3GetClock: get_clock(*const u32, usize) -> Values<u8> = failed();
    fmi3SetClock: set_clock(*const u32, usize, *const u8, usize) -> fmi3Status = fmi3Error;
    fmi3GetNumberOfVariableDependencies: get_number_of_variable_dependencies(u32) -> *const Answer<u64> = failed();
    fmi3GetVariableDependencies: get_variable_dependencies(u32) -> Values<u8> = failed();
    fmi3GetIntervalDecimal: get_interval_decimal(*const u32, usize) -> Values<u8> = failed();
    fmi3GetIntervalFraction: get_interval_fraction(*const u32, usize) -> Values<u8> = failed();
    fmi3GetShiftDecimal: get_shift_decimal(*const u32, usize) -> Values<f64> = failed();
    fmi3GetShiftFraction: get_shift_fraction(*const u32, usize) -> Values<u8> = failed();
    fmi3SetIntervalDecimal: set_interval_decimal(*const u32, usize, *const f64, usize) -> fmi3Status = fmi3Error;
    fmi3SetIntervalFraction: set_interval_fraction(*const u32, usize, *const u64, usize) -> fmi3Status = fmi3Error;
    fmi3SetShiftDecimal: set_shift_decimal(*const u32, usize, *const f64, usize) -> fmi3Status = fmi3Error;
    fmi3SetShiftFraction: set_shift_fraction(*const u32, usize, *const u64, usize) -> fmi3Status = fmi3Error;
    fmi3EvaluateDiscreteStates: evaluate_discrete_states() -> fmi3Status = fmi3Error;
}

#[unsafe(no_mangle)]
extern "C" fn get_version() -> *const Text {
    call(null_mut(), || put(list(b"3.0")))
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
        new_co_simulation(i)
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

fn settings(name: &CStr, logging_on: bool) -> Settings {
    let log = Log::new(Some(sink(name)), logging_on);
    let folder =
        "a component has no folder of resources; expected a text read with `read_resource`";
    Settings::new(&EDGE, log, Err(folder.into()))
}

/// Forwards messages to the host.
fn sink(name: &CStr) -> Sink {
    let name = name.to_owned();
    Box::new(move |category, message| {
        // `#` introduces a value reference (FMI 3.0.2, section 2.3.1).
        let (name, message) = (name.to_bytes(), message.replace('#', "##"));
        let (status, category) = (category.status(), category.name().to_bytes());
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
    call(null_mut(), || {
        let models = fmu_export_models();
        let made = super::instantiate(
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

/// What a host answers in an intermediate update.
#[repr(C)]
struct EarlyReturn {
    is_requested: bool,
    time: f64,
}

/// Calls the host in an intermediate update. Returns the time of an early return that it requests.
fn call_back(update: IntermediateUpdate) -> Option<f64> {
    let mut answer = EarlyReturn { is_requested: false, time: update.time };
    let IntermediateUpdate { time, set_requested, can_return_early } = update;
    // SAFETY: the host provides this function with these arguments; the pointer is valid during the call.
    unsafe { intermediate_update(time, set_requested, true, true, can_return_early, &mut answer) };
    answer.is_requested.then_some(answer.time)
}

/// Reads a resource by the host, which has the files.
pub(crate) fn read_resource(path: &Path) -> Result<String, String> {
    let path = path.to_str().ok_or("its name is not UTF-8")?;
    let mut content = MaybeUninit::uninit();
    // SAFETY: the host provides this function with these arguments, and writes the answer, whose list is valid
    // until the end of the call.
    unsafe {
        read_file(path.as_ptr(), path.len(), &mut content);
        let bytes = |text: &Text| slice(text.first, text.length).to_vec();
        match content.assume_init_ref() {
            Answer::Ok(text) => String::from_utf8(bytes(text)).map_err(|error| error.to_string()),
            Answer::Err(text) => Err(String::from_utf8_lossy(&bytes(text)).into_owned()),
        }
    }
}

/// Tells the host of a panic, after which the component ends.
pub(crate) fn report_panic(panic: &PanicHookInfo<'_>) {
    // SAFETY: the call that panicked does not continue, so the instance is not used otherwise.
    if let Some(c) = unsafe { instance_at(CURRENT.get()) } {
        let place = panic.location().map_or_else(String::new, |place| format!("{place}: "));
        let text = crate::log::text_of_panic(panic.payload());
        let message = format_args!("{place}the model panicked, and the component ends: {text}");
        c.shared.settings.log.send(Category::Fatal, message);
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn set_debug_logging(
    instance: Pointer,
    on: bool,
    categories: *const Text,
    n: usize,
) -> fmi3Status {
    // SAFETY: the host's promises.
    call(instance, || unsafe {
        let names = texts(categories, n);
        let pointers: Vec<_> = names.iter().map(|name| name.as_ptr()).collect();
        fmi3SetDebugLogging(instance, on.into(), n, pointers.as_ptr())
    })
}

/// The texts of a list of the host, as they are passed to C.
///
/// # Safety
/// As [`slice`].
unsafe fn texts(first: *const Text, n: usize) -> Vec<CString> {
    // SAFETY: the caller's promise.
    unsafe { slice(first, n).iter().map(|list| text(list.first, list.length)).collect() }
}

/// Does what has other arguments in C, by a method of the instance.
///
/// # Safety
/// The host's promise: an instance that is not used otherwise.
unsafe fn perform(
    instance: Pointer,
    operation: &Call,
    work: impl FnOnce(&mut Instance) -> Result<(), ModelError>,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    let c = unsafe { instance_at(instance) };
    c.map_or(fmi3Error, |c| fmi3Status(c.call(operation, work) as i32))
}

/// Memory with these bytes, until the next call.
fn copied(bytes: &[u8]) -> Text {
    let first = allocate::<u8>(bytes.len());
    // SAFETY: it is memory for as many bytes.
    unsafe { first.copy_from_nonoverlapping(bytes.as_ptr(), bytes.len()) };
    List { first, length: bytes.len() }
}

/// Defines the functions that get and set texts or bytes, which C has as pointers.
macro_rules! lists {
    ($($name:ident: $get:ident by $get_in_c:ident, $set:ident by $set_in_c:ident, $from:expr;)*) => { $(
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $get(
            instance: Pointer, references: *const u32, n: usize
        ) -> Values<Text> {
            // SAFETY: the host's promises; the memory is for as many values.
            unsafe {
                let n_values = count(instance, references, n);
                values(instance, n_values, |first: *mut Text, n_values| {
                    perform(instance, &calls::$get_in_c, |c| {
                        let references = slice(references, n);
                        c.get(Type::$name, references, n_values, &mut |i, value| {
                            if let Value::$name(value) = value {
                                first.add(i).write(copied(value.as_ref()));
                            }
                        })
                    })
                })
            }
        }

        #[unsafe(no_mangle)]
        unsafe extern "C" fn $set(
            instance: Pointer, references: *const u32, n: usize, values: *const Text, n_values: usize
        ) -> fmi3Status {
            // SAFETY: the host's promises.
            call(instance, || unsafe {
                let given = |i: usize| {
                    let List { first, length } = slice(values, n_values)[i];
                    HostValue::Other(Ok(Value::$name($from(slice(first, length)))))
                };
                perform(instance, &calls::$set_in_c, |c| {
                    c.set(Type::$name, slice(references, n), n_values, &given)
                })
            })
        }
    )* };
}

lists! {
    String: get_string by fmi3GetString, set_string by fmi3SetString,
        |text| String::from_utf8_lossy(text).into_owned();
    Binary: get_binary by fmi3GetBinary, set_binary by fmi3SetBinary, <[u8]>::to_vec;
}

#[unsafe(no_mangle)]
unsafe extern "C" fn get_fmu_state(instance: Pointer) -> Values<u8> {
    // SAFETY: the host's promises; the memory is for as many bytes.
    call(instance, || unsafe {
        let mut state = list(&[]);
        let status = perform(instance, &calls::fmi3GetFMUState, |c| {
            state = copied(&c.serialize(&c.snapshot()?)?);
            Ok(())
        });
        answer(status, state)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn set_fmu_state(instance: Pointer, bytes: *const u8, n: usize) -> fmi3Status {
    // SAFETY: the host's promises.
    call(instance, || unsafe {
        perform(instance, &calls::fmi3SetFMUState, |c| {
            let state = c.deserialize(slice(bytes, n))?;
            c.restore(&state)
        })
    })
}

/// Defines the functions for derivatives, of which there are as many as elements of `$of`.
macro_rules! derivatives {
    ($($name:ident: $operation:ident($($arg:ident $n:ident),*) of $of:ident $n_of:ident;)*) => { $(
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $operation(
            instance: Pointer, $($arg: *const u32, $n: usize,)* seed: *const f64, n_seed: usize
        ) -> Values<f64> {
            // SAFETY: the host's promises.
            unsafe {
                let n = count(instance, $of, $n_of);
                values(instance, n, |first, n| {
                    $name(instance, $($arg, $n,)* seed, n_seed, first, n)
                })
            }
        }
    )* };
}

derivatives! {
    fmi3GetDirectionalDerivative: get_directional_derivative(unknowns n, knowns m) of unknowns n;
    fmi3GetAdjointDerivative: get_adjoint_derivative(unknowns n, knowns m) of knowns m;
}

/// Value references and orders, from a list of pairs.
///
/// # Safety
/// As [`slice`].
unsafe fn orders(pairs: *const [u32; 2], n: usize) -> (Vec<u32>, Vec<i32>) {
    // SAFETY: the caller's promise.
    unsafe { slice(pairs, n).iter().map(|&[reference, order]| (reference, order as i32)).unzip() }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn get_output_derivatives(
    instance: Pointer,
    pairs: *const [u32; 2],
    n: usize,
) -> Values<f64> {
    // SAFETY: the host's promises.
    unsafe {
        let (references, orders) = orders(pairs, n);
        let n_values = count(instance, references.as_ptr(), n);
        let (references, orders) = (references.as_ptr(), orders.as_ptr());
        values(instance, n_values, |first, n_values| {
            fmi3GetOutputDerivatives(instance, references, n, orders, first, n_values)
        })
    }
}

/// FMI 3.0 has no such function in C; it is that of FMI 2.0.
#[unsafe(no_mangle)]
unsafe extern "C" fn set_input_derivatives(
    instance: Pointer,
    pairs: *const [u32; 2],
    n: usize,
    values: *const f64,
    n_values: usize,
) -> fmi3Status {
    let operation =
        Call { name: "set-input-derivatives", ..fmi2::calls::fmi2SetRealInputDerivatives };
    // SAFETY: the host's promises.
    call(instance, || unsafe {
        let ((references, orders), values) = (orders(pairs, n), slice(values, n_values));
        perform(instance, &operation, |c| match n == n_values {
            true => c.set_input_derivatives(&references, &orders, values),
            false => refused!("values passed: {n_values}; expected {n}, one for each request"),
        })
    })
}

/// Defines the functions that return a record, by the pointers to its fields that the C function takes.
macro_rules! records {
    ($(
        $name:ident: $operation:ident($($arg:ident: $type:ty),*) -> $record:ident {
            $($field:ident: $of:ty),*
        } by $($pointer:ident),*;
    )*) => { $(
        #[repr(C)]
        #[derive(Default)]
        pub struct $record {
            $($field: $of),*
        }

        #[unsafe(no_mangle)]
        unsafe extern "C" fn $operation(
            instance: Pointer $(, $arg: $type)*
        ) -> *const Answer<$record> {
            call(instance, || {
                let mut record = $record::default();
                // SAFETY: the host's promises.
                let status = unsafe { $name(instance $(, $arg)* $(, &mut record.$pointer)*) };
                answer(status, record)
            })
        }
    )* };
}

records! {
    fmi3DoStep: do_step(time: f64, step: f64, no_set_state: fmi3Boolean) -> DoStepResult {
        last_successful_time: f64, event_handling_needed: fmi3Boolean, terminate: fmi3Boolean,
        early_return: fmi3Boolean
    } by event_handling_needed, terminate, early_return, last_successful_time;
    fmi3CompletedIntegratorStep: completed_integrator_step(no_set_state: fmi3Boolean)
        -> CompletedStepResult { enter_event_mode: fmi3Boolean, terminate: fmi3Boolean }
        by enter_event_mode, terminate;
    fmi3UpdateDiscreteStates: update_discrete_states() -> DiscreteStatesInfo {
        needs_update: fmi3Boolean, terminate: fmi3Boolean, nominals_changed: fmi3Boolean,
        states_changed: fmi3Boolean, next_event_defined: fmi3Boolean, next_event: f64
    } by needs_update, terminate, nominals_changed, states_changed, next_event_defined, next_event;
}

/// Variables that every step sets or gets, as they are passed to C.
#[repr(C)]
pub struct Access {
    references: *const u32,
    n: usize,
    values: *mut f64,
    n_values: usize,
}

/// The calls of a step. `fmu-host` relies on this layout.
#[repr(C)]
pub struct Cycle {
    time: f64,
    step: f64,
    no_set_state: fmi3Boolean,
    /// How many of the calls have begun.
    begun: u8,
    stepped: DoStepResult,
    set: Access,
    get: Access,
}

/// Sets variables, takes a step and gets variables, in one call of a host, which otherwise takes most of its time to
/// enter and leave the component. It stops after a call that is no plain success.
#[unsafe(no_mangle)]
unsafe extern "C" fn fmu_export_cycle(instance: Pointer, cycle: &mut Cycle) -> fmi3Status {
    CURRENT.set(instance);
    let Cycle { time, step, no_set_state, begun, stepped, set, get } = cycle;
    // SAFETY: the host's promises.
    unsafe {
        *begun = 1;
        if set.n > 0 {
            let status = fmi3SetFloat64(instance, set.references, set.n, set.values, set.n_values);
            if status != fmi3OK {
                return status;
            }
        }
        *begun = 2;
        let (event, terminate) = (&mut stepped.event_handling_needed, &mut stepped.terminate);
        let (early, last) = (&mut stepped.early_return, &mut stepped.last_successful_time);
        let status =
            fmi3DoStep(instance, *time, *step, *no_set_state, event, terminate, early, last);
        if status != fmi3OK || *terminate != fmi3False || *early != fmi3False {
            return status;
        }
        *begun = 3;
        match get.n {
            0 => fmi3OK,
            n => fmi3GetFloat64(instance, get.references, n, get.values, get.n_values),
        }
    }
}
