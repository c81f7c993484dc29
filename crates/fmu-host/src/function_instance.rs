//! Functions of this program as instances of FMI 3.0, which a host steps as it steps FMUs.

use std::ffi::{CStr, CString, c_void};
use std::slice;
use std::sync::Arc;

use fmi_abi::FmiVersion;
use fmi_abi::fmi3::*;
use fmu_description::Value;

use crate::instance::Instance;
use crate::library::{Binary, Library};
use crate::logger::{LogMessage, Registered, deliver};
use crate::observed::CallObserver;
use crate::outcome::Status;

/// What an instance does in a step: it receives the time, the size of the step (s) and the values of all
/// variables, of which it changes the outputs. An error is a log message, and fails the step.
pub type StepFunction = Box<dyn FnMut(f64, f64, &mut [Value]) -> Result<(), String> + Send>;

/// An instance whose step is a function.
struct Running {
    /// The values of the variables, which are Float64, Int64, Boolean, String or Binary; a value reference is an index.
    values: Vec<Value>,
    /// The strings that were got last.
    strings: Vec<CString>,
    step: StepFunction,
    environment: *mut c_void,
}

impl Instance {
    /// An instance of FMI 3.0 for co-simulation whose step is a function, with the start values of its variables,
    /// which are Float64, Int64, Boolean, String or Binary. The value reference of a variable is its index. `sink` receives the
    /// errors; `observer` observes the calls. Other functions than those that a master needs are missing.
    pub fn of_function(
        values: Vec<Value>,
        step: StepFunction,
        sink: impl Fn(LogMessage) + Send + Sync + 'static,
        observer: Option<Arc<dyn CallObserver>>,
    ) -> Self {
        let functions = Functions {
            fmi3EnterInitializationMode: Some(enter_initialization_mode),
            fmi3ExitInitializationMode: Some(done),
            fmi3GetFloat64: Some(get_float64),
            fmi3SetFloat64: Some(set_float64),
            fmi3GetInt64: Some(get_int64),
            fmi3SetInt64: Some(set_int64),
            fmi3GetBoolean: Some(get_boolean),
            fmi3SetBoolean: Some(set_boolean),
            fmi3GetString: Some(get_string),
            fmi3SetString: Some(set_string),
            fmi3GetBinary: Some(get_binary),
            fmi3SetBinary: Some(set_binary),
            fmi3DoStep: Some(do_step),
            fmi3Terminate: Some(done),
            fmi3FreeInstance: Some(free_instance),
            ..Functions::default()
        };
        let library = Library::new(Binary::Function, FmiVersion::Fmi3);
        let library = match &observer {
            None => Library { fmi3: functions, ..library },
            Some(observer) => {
                library.observed_by(Arc::clone(observer), Default::default(), functions)
            }
        };
        let registered = Registered::new(Arc::new(sink), None);
        let environment = registered.environment();
        let running = Running { values, strings: Vec::new(), step, environment };
        let mut instance = Self::new(&Arc::new(library), registered, None);
        instance.handle.observer = observer;
        instance.handle.pointer = Box::into_raw(Box::new(running)).cast();
        instance
    }
}

unsafe extern "C" fn done(_: fmi3Instance) -> fmi3Status {
    fmi3OK
}

unsafe extern "C" fn enter_initialization_mode(
    _: fmi3Instance,
    _: fmi3Boolean,
    _: f64,
    _: f64,
    _: fmi3Boolean,
    _: f64,
) -> fmi3Status {
    fmi3OK
}

/// Defines how variables of a type are read and written.
macro_rules! access {
    ($($get:ident $set:ident $value:ident: $read:path, $write:path as $type:ty;)*) => { $(
        /// # Safety
        /// The instance is one of a function, and both arrays have `n` elements.
        unsafe extern "C" fn $get(
            instance: fmi3Instance,
            references: *const u32,
            n: usize,
            values: *mut $type,
            _: usize,
        ) -> fmi3Status {
            // SAFETY: the caller's promise.
            let (running, references, values) = unsafe {
                let values = slice::from_raw_parts_mut(values, n);
                (&*instance.cast::<Running>(), slice::from_raw_parts(references, n), values)
            };
            for (to, reference) in values.iter_mut().zip(references) {
                if let Some(Value::$value(value)) = running.values.get(*reference as usize) {
                    *to = $read(*value);
                }
            }
            fmi3OK
        }

        /// # Safety
        /// As above.
        unsafe extern "C" fn $set(
            instance: fmi3Instance,
            references: *const u32,
            n: usize,
            values: *const $type,
            _: usize,
        ) -> fmi3Status {
            // SAFETY: the caller's promise.
            let (running, references, values) = unsafe {
                let values = slice::from_raw_parts(values, n);
                (&mut *instance.cast::<Running>(), slice::from_raw_parts(references, n), values)
            };
            for (from, reference) in values.iter().zip(references) {
                if let Some(Value::$value(value)) = running.values.get_mut(*reference as usize) {
                    *value = $write(*from);
                }
            }
            fmi3OK
        }
    )* };
}

access! {
    get_float64 set_float64 Float64: f64::from, f64::from as f64;
    get_int64 set_int64 Int64: i64::from, i64::from as i64;
    get_boolean set_boolean Boolean: fmi3Boolean::from, is_true as fmi3Boolean;
}

/// # Safety
/// The instance is one of a function, and both arrays have `n` elements.
unsafe extern "C" fn get_string(
    instance: fmi3Instance,
    references: *const u32,
    n: usize,
    values: *mut fmi3String,
    _: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    let (running, references, values) = unsafe {
        let values = slice::from_raw_parts_mut(values, n);
        (&mut *instance.cast::<Running>(), slice::from_raw_parts(references, n), values)
    };
    let text = |reference: &u32| match running.values.get(*reference as usize) {
        Some(Value::String(text)) => CString::new(text.as_str()).unwrap_or_default(),
        _ => CString::default(),
    };
    running.strings = references.iter().map(text).collect();
    for (to, text) in values.iter_mut().zip(&running.strings) {
        *to = text.as_ptr();
    }
    fmi3OK
}

/// # Safety
/// As above; the strings end with a null byte.
unsafe extern "C" fn set_string(
    instance: fmi3Instance,
    references: *const u32,
    n: usize,
    values: *const fmi3String,
    _: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    let (running, references, values) = unsafe {
        let values = slice::from_raw_parts(values, n);
        (&mut *instance.cast::<Running>(), slice::from_raw_parts(references, n), values)
    };
    for (from, reference) in values.iter().zip(references) {
        if let Some(Value::String(value)) = running.values.get_mut(*reference as usize) {
            // SAFETY: the caller's promise.
            *value = unsafe { CStr::from_ptr(*from) }.to_string_lossy().into_owned();
        }
    }
    fmi3OK
}

/// # Safety
/// The instance is one of a function, and the arrays have `n` elements.
unsafe extern "C" fn get_binary(
    instance: fmi3Instance,
    references: *const u32,
    n: usize,
    sizes: *mut usize,
    values: *mut fmi3Binary,
    _: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    let (running, references, sizes, values) = unsafe {
        let (sizes, values) =
            (slice::from_raw_parts_mut(sizes, n), slice::from_raw_parts_mut(values, n));
        (&*instance.cast::<Running>(), slice::from_raw_parts(references, n), sizes, values)
    };
    for ((to, size), reference) in values.iter_mut().zip(sizes).zip(references) {
        if let Some(Value::Binary(bytes)) = running.values.get(*reference as usize) {
            (*to, *size) = (bytes.as_ptr(), bytes.len());
        }
    }
    fmi3OK
}

/// # Safety
/// As above; each value has as many bytes as its size says.
unsafe extern "C" fn set_binary(
    instance: fmi3Instance,
    references: *const u32,
    n: usize,
    sizes: *const usize,
    values: *const fmi3Binary,
    _: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    let (running, references, sizes, values) = unsafe {
        let (sizes, values) = (slice::from_raw_parts(sizes, n), slice::from_raw_parts(values, n));
        (&mut *instance.cast::<Running>(), slice::from_raw_parts(references, n), sizes, values)
    };
    for ((from, size), reference) in values.iter().zip(sizes).zip(references) {
        if let Some(Value::Binary(value)) = running.values.get_mut(*reference as usize) {
            value.clear();
            if *size > 0 {
                // SAFETY: the caller's promise.
                value.extend_from_slice(unsafe { slice::from_raw_parts(*from, *size) });
            }
        }
    }
    fmi3OK
}

fn is_true(value: fmi3Boolean) -> bool {
    value != fmi3False
}

/// # Safety
/// The instance is one of a function, and the results can be written.
unsafe extern "C" fn do_step(
    instance: fmi3Instance,
    time: f64,
    step: f64,
    _: fmi3Boolean,
    _: *mut fmi3Boolean,
    _: *mut fmi3Boolean,
    _: *mut fmi3Boolean,
    last_successful_time: *mut f64,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    let (running, last) = unsafe { (&mut *instance.cast::<Running>(), &mut *last_successful_time) };
    match (running.step)(time, step, &mut running.values) {
        Ok(()) => {
            *last = time + step;
            fmi3OK
        }
        Err(text) => {
            deliver(running.environment, || LogMessage {
                instance: None,
                status: Status::Error,
                category: None,
                text,
            });
            fmi3Error
        }
    }
}

/// # Safety
/// The instance is one of a function, and is not used again.
unsafe extern "C" fn free_instance(instance: fmi3Instance) {
    // SAFETY: the caller's promise; it comes from a box.
    drop(unsafe { Box::from_raw(instance.cast::<Running>()) });
}
