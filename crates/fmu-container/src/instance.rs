//! An instance of a container behind a pointer of a host: its state, its log, and the operations whose arguments are those
//! of C.

use std::ffi::{CStr, CString, c_char, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Once;

use fmi_abi::state::State;
use fmi_abi::{FmiFunction, FmiVersion};
use fmu_description::{LogCategory, Type, Value};
use fmu_master::container::{Container, Failure, SavedContainer, Severity};

use crate::host_log::HostLog;
use crate::pointers::{c_text, text};

/// An instance.
pub struct Instance {
    pub(crate) container: Container,
    pub(crate) state: State,
    /// The start and the stop time (s), which FMI 2.0 sets before the initialization.
    pub(crate) experiment: (f64, Option<f64>),
    log: HostLog,
    /// What the host has got by pointers, until it gets the next.
    texts: Vec<CString>,
    binaries: Vec<Vec<u8>>,
}

/// The status of a call, with its number in both versions of FMI.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Status {
    Ok = 0,
    Discard = 2,
    Error = 3,
    Fatal = 4,
}

/// Why a call has failed.
pub(crate) enum Failed {
    /// It has changed nothing, and the instance goes on as before.
    Discarded(String),
    Failure(Failure),
}

impl From<Failure> for Failed {
    fn from(failure: Failure) -> Self {
        Self::Failure(failure)
    }
}

impl From<String> for Failed {
    fn from(reason: String) -> Self {
        Self::Failure(reason.into())
    }
}

/// The outcome of an operation.
pub(crate) type Outcome = Result<(), Failed>;

/// The outcome of an operation that does not take its arguments, or is not supported.
pub(crate) fn refused(why: impl ToString) -> Failed {
    why.to_string().into()
}

/// Creates an instance of the container with these resources. On failure, logs the reason and returns NULL.
pub(crate) fn instantiate(
    function: &str,
    version: FmiVersion,
    guid: Option<&CStr>,
    resources: Result<&Path, String>,
    log: HostLog,
) -> *mut c_void {
    static SILENT: Once = Once::new();
    // Panics go to the log. The hook belongs to this library's own copy of `std`.
    SILENT.call_once(|| std::panic::set_hook(Box::new(|_| {})));
    let guid = guid.unwrap_or_default().to_string_lossy();
    let made = catch_unwind(AssertUnwindSafe(|| {
        let resources = resources?;
        Container::new(resources, &guid, version).map_err(|error| format!("{error:#}"))
    }));
    let reason = match made {
        Ok(Ok(container)) => {
            return Box::into_raw(Box::new(Instance {
                container,
                state: State::Instantiated,
                experiment: (0.0, None),
                log,
                texts: Vec::new(),
                binaries: Vec::new(),
            }))
            .cast();
        }
        Ok(Err(reason)) => reason,
        Err(_) => "the master panicked".to_owned(),
    };
    log.send(LogCategory::Error, &format!("{function}: {reason}"));
    std::ptr::null_mut()
}

/// Frees an instance.
///
/// # Safety
/// It is NULL or an instance, which is not used again.
pub(crate) unsafe fn free(instance: *mut c_void) {
    if !instance.is_null() {
        // SAFETY: the caller's promise; an instance came from a box.
        let instance = unsafe { Box::from_raw(instance.cast::<Instance>()) };
        let freed = catch_unwind(AssertUnwindSafe(|| drop(instance)));
        let _ = freed.map_err(std::mem::forget);
    }
}

impl Instance {
    /// Calls an operation, if the state allows the function; logs what the FMUs have logged, and the reason of a failure.
    pub(crate) fn call(
        &mut self,
        call: &FmiFunction,
        operation: impl FnOnce(&mut Self) -> Outcome,
    ) -> Status {
        let name = call.name;
        if !call.is_allowed(self.state) {
            let state = self.state.name();
            let text = format!("{name}: the state is {state}, which does not allow this call");
            self.log.send(LogCategory::Error, &text);
            return if self.state == State::Fatal { Status::Fatal } else { Status::Error };
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| operation(self)));
        for message in self.container.take_messages() {
            self.log.forward(&message);
        }
        let (status, category, reason) = match outcome {
            Ok(Ok(())) => return Status::Ok,
            Ok(Err(Failed::Discarded(reason))) => (Status::Discard, LogCategory::Discard, reason),
            Ok(Err(Failed::Failure(Failure { severity, reason }))) => match severity {
                Severity::Refused => (Status::Error, LogCategory::Error, reason),
                Severity::Error => {
                    self.state = State::Error;
                    (Status::Error, LogCategory::Error, reason)
                }
                Severity::Fatal => {
                    self.state = State::Fatal;
                    (Status::Fatal, LogCategory::Fatal, reason)
                }
            },
            Err(_) => {
                self.state = State::Fatal;
                (Status::Fatal, LogCategory::Fatal, "the master panicked".to_owned())
            }
        };
        self.log.send(category, &format!("{name}: {reason}"));
        status
    }

    pub(crate) fn enter_initialization(&mut self) -> Outcome {
        let (start, stop) = self.experiment;
        self.container.enter_initialization(start, stop)?;
        self.state = State::Initialization;
        Ok(())
    }

    pub(crate) fn exit_initialization_mode(&mut self) -> Outcome {
        self.container.exit_initialization()?;
        self.state = State::StepMode;
        Ok(())
    }

    pub(crate) fn terminate(&mut self) -> Outcome {
        self.container.terminate()?;
        self.state = State::Terminated;
        Ok(())
    }

    pub(crate) fn reset(&mut self) -> Outcome {
        self.container.reset();
        self.state = State::Instantiated;
        self.experiment = (0.0, None);
        Ok(())
    }

    /// # Safety
    /// The categories are NULL or zero-terminated texts.
    pub(crate) unsafe fn set_debug_logging(
        &mut self,
        on: bool,
        categories: &[*const c_char],
    ) -> Outcome {
        // SAFETY: the caller's promise.
        let names = categories.iter().map(|category| unsafe { text(*category) });
        let names: Option<Vec<&CStr>> = names.collect();
        let names = names.ok_or_else(|| refused("a category is NULL"))?;
        Ok(self.log.switch(on, &names)?)
    }

    /// Checks that there is a value for each variable: an array is one variable for each element.
    fn check_count(references: &[u32], values: usize) -> Result<(), Failed> {
        match references.len() == values {
            true => Ok(()),
            false => Err(refused(format!(
                "{values} values for {} variables, expected one for each",
                references.len()
            ))),
        }
    }

    /// Gets Booleans as 0 or 1.
    pub(crate) fn get_boolean<B: From<bool>>(
        &mut self,
        references: &[u32],
        values: &mut [B],
    ) -> Outcome {
        Self::check_count(references, values.len())?;
        Ok(self.container.get(Type::Boolean, references, |i, value| {
            values[i] = (value == Value::Boolean(true)).into();
            Ok(())
        })?)
    }

    pub(crate) fn set_boolean<B: Copy + Into<i32>>(
        &mut self,
        references: &[u32],
        values: &[B],
    ) -> Outcome {
        Self::check_count(references, values.len())?;
        Ok(self.container.set(Type::Boolean, references, |i| match values[i].into() {
            value @ (0 | 1) => Ok(Value::Boolean(value == 1)),
            other => Err(format!("{other}, expected 0 or 1")),
        })?)
    }

    /// Hands out pointers to texts that live until the next call.
    pub(crate) fn get_string(
        &mut self,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Outcome {
        Self::check_count(references, values.len())?;
        let mut texts = Vec::new();
        self.container.get(Type::String, references, |_, value| {
            if let Value::String(text) = value {
                texts.push(c_text(&text));
            }
            Ok(())
        })?;
        for (value, text) in values.iter_mut().zip(&texts) {
            *value = text.as_ptr();
        }
        self.texts = texts;
        Ok(())
    }

    /// # Safety
    /// The values are NULL or zero-terminated texts.
    pub(crate) unsafe fn set_string(
        &mut self,
        references: &[u32],
        values: &[*const c_char],
    ) -> Outcome {
        Self::check_count(references, values.len())?;
        Ok(self.container.set(Type::String, references, |i| {
            // SAFETY: the caller's promise.
            let text = unsafe { text(values[i]) }.ok_or("NULL, expected a text")?;
            let text = text.to_str().map_err(|_| format!("{text:?}, expected UTF-8"))?;
            Ok(Value::String(text.to_owned()))
        })?)
    }

    /// Hands out pointers to bytes that live until the next call.
    pub(crate) fn get_binary(
        &mut self,
        references: &[u32],
        sizes: &mut [usize],
        values: &mut [*const u8],
    ) -> Outcome {
        Self::check_count(references, values.len())?;
        let mut binaries = Vec::new();
        self.container.get(Type::Binary, references, |_, value| {
            if let Value::Binary(bytes) = value {
                binaries.push(bytes);
            }
            Ok(())
        })?;
        for ((value, size), bytes) in values.iter_mut().zip(sizes).zip(&binaries) {
            (*value, *size) = (bytes.as_ptr(), bytes.len());
        }
        self.binaries = binaries;
        Ok(())
    }

    pub(crate) fn set_binary(
        &mut self,
        references: &[u32],
        _sizes: &[usize],
        _values: &[*const u8],
    ) -> Outcome {
        Ok(self.container.set(Type::Binary, references, |_| Err("a Binary".to_owned()))?)
    }

    pub(crate) fn get_directional_derivative(
        &mut self,
        _unknowns: &[u32],
        _knowns: &[u32],
        _seed: &[f64],
        _sensitivity: &mut [f64],
    ) -> Outcome {
        Err(refused("a container provides no directional derivatives"))
    }

    pub(crate) fn get_output_derivatives(
        &mut self,
        _references: &[u32],
        _orders: &[i32],
        _values: &mut [f64],
    ) -> Outcome {
        Err(refused("maxOutputDerivativeOrder is 0"))
    }
}

/// Defines methods that get and set numbers.
macro_rules! numbers {
    ($($type:ty: $get:ident $set:ident $variant:ident $as:ident;)*) => {
        impl Instance { $(
            pub(crate) fn $get(&mut self, references: &[u32], values: &mut [$type]) -> Outcome {
                Self::check_count(references, values.len())?;
                Ok(self.container.get(Type::$variant, references, |i, value| {
                    let number = value.$as().and_then(|number| numbers!(@ $as number $type));
                    values[i] = number.ok_or_else(|| {
                        format!("= {value} is beyond the range of {}", stringify!($type))
                    })?;
                    Ok(())
                })?)
            }

            pub(crate) fn $set(&mut self, references: &[u32], values: &[$type]) -> Outcome {
                Self::check_count(references, values.len())?;
                Ok(self.container.set(Type::$variant, references, |i| Ok(Value::$variant(values[i])))?)
            }
        )* }
    };
    (@ as_real $number:ident $type:ty) => { Some($number as $type) };
    (@ as_whole $number:ident $type:ty) => { <$type>::try_from($number).ok() };
}
numbers! {
    f32: get_float32 set_float32 Float32 as_real;
    f64: get_float64 set_float64 Float64 as_real;
    i8: get_int8 set_int8 Int8 as_whole;
    u8: get_uint8 set_uint8 UInt8 as_whole;
    i16: get_int16 set_int16 Int16 as_whole;
    u16: get_uint16 set_uint16 UInt16 as_whole;
    i32: get_int32 set_int32 Int32 as_whole;
    u32: get_uint32 set_uint32 UInt32 as_whole;
    i64: get_int64 set_int64 Int64 as_whole;
    u64: get_uint64 set_uint64 UInt64 as_whole;
}

/// A saved state, and the state of the instance.
struct SavedInstance {
    container: SavedContainer,
    state: State,
    experiment: (f64, Option<f64>),
}

const SERIALIZED: &str = "canSerializeFMUState is false: a container keeps states in memory only";

/// Each is safe if the pointer to a state is NULL or a state that was not freed.
impl Instance {
    pub(crate) unsafe fn get_fmu_state(&mut self, state: Option<&mut *mut c_void>) -> Outcome {
        let state = state.ok_or_else(|| refused("a pointer is NULL"))?;
        let container = self.container.save()?;
        let old = *state;
        let new = SavedInstance { container, state: self.state, experiment: self.experiment };
        *state = Box::into_raw(Box::new(new)).cast();
        // SAFETY: the caller's promise.
        unsafe { self.drop_state(old) };
        Ok(())
    }

    pub(crate) unsafe fn set_fmu_state(&mut self, state: *mut c_void) -> Outcome {
        // SAFETY: the caller's promise.
        let saved = unsafe { state.cast::<SavedInstance>().as_ref() };
        let saved = saved.ok_or_else(|| refused("the FMU state is NULL"))?;
        self.container.restore(&saved.container)?;
        (self.state, self.experiment) = (saved.state, saved.experiment);
        Ok(())
    }

    pub(crate) unsafe fn free_fmu_state(&mut self, state: Option<&mut *mut c_void>) -> Outcome {
        if let Some(state) = state {
            // SAFETY: the caller's promise.
            unsafe { self.drop_state(std::mem::replace(state, std::ptr::null_mut())) };
        }
        Ok(())
    }

    /// # Safety
    /// It is NULL or a state, which is not used again.
    unsafe fn drop_state(&mut self, state: *mut c_void) {
        if !state.is_null() {
            // SAFETY: the caller's promise; a state came from a box.
            let saved = unsafe { Box::from_raw(state.cast::<SavedInstance>()) };
            self.container.forget(saved.container);
        }
    }

    pub(crate) fn serialized_fmu_state_size(
        &mut self,
        _state: *mut c_void,
        _size: Option<&mut usize>,
    ) -> Outcome {
        Err(refused(SERIALIZED))
    }

    pub(crate) fn serialize_fmu_state(
        &mut self,
        _state: *mut c_void,
        _bytes: Option<&mut [u8]>,
    ) -> Outcome {
        Err(refused(SERIALIZED))
    }

    pub(crate) fn deserialize_fmu_state(
        &mut self,
        _bytes: Option<&[u8]>,
        _state: Option<&mut *mut c_void>,
    ) -> Outcome {
        Err(refused(SERIALIZED))
    }
}
