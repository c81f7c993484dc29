//! The edges: the interfaces through which a host calls the instances of this crate. They turn the arguments of
//! a host into slices and values, and call the [`Instance`]; nothing behind the instance knows of them.
//!
//! [`fmi2`] and [`fmi3`] are the C interfaces. Their entry points are made from the rows of `fmi-abi`: a row
//! becomes a function that converts its arguments, checks the state, and calls the method of the instance that
//! has the name of the row's operation. Most of these methods belong to the instance itself; the edges add
//! those whose arguments are of C, in this file and in [`fmu_state`] if both versions have them. The entry points for
//! get, set and step are written out, and call the functions in [`fast`](crate::fast).
//!
//! For WebAssembly, `wasm` is the interface of components, in place of the names in C, and `sources` is what C sources
//! need besides the functions in C.

use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use fmi_abi::FmiFunction;
use fmu_description::{LogCategory, Type, Value};

use crate::entry::Entry;
use crate::error::ModelError;
use crate::fast;
use crate::instance::{Instance, Settings, Status};
use crate::lifecycle::InstanceType;
use crate::pointers::{Pointer, c_text, readable, texts};
use crate::values::HostValue;

/// Defines the entry points of a version from the rows of its functions that have an instance.
macro_rules! entries {
    (
        $instance:ident $status:ident
        Free { $($_0:tt)* }
        $($group:ident { $($rows:tt)* })*
    ) => {
        $(entries!(@ $instance $status $group $($rows)*);)*
    };
    (
        @ $instance:ident $status:ident $group:ident
        $($name:ident $arguments:tt => $operation:ident in $($states:ident)|+;)*
    ) => {
        $(entry!($instance $status $group $name $arguments $operation $($states)|+);)*
    };
}

/// Exports a function of C that belongs to a group of rows, if the binary has instances of its interface type. One for
/// scheduled execution has the functions of all types, which FMPy demands of it.
macro_rules! exported {
    (CoSimulation $($function:tt)*) => {
        #[cfg_attr(
            all(
                any(not(target_arch = "wasm32"), feature = "sources"),
                any(feature = "co-simulation", not(feature = "model-exchange"))
            ),
            unsafe(no_mangle)
        )]
        $($function)*
    };
    (ModelExchange $($function:tt)*) => {
        #[cfg_attr(
            all(
                any(not(target_arch = "wasm32"), feature = "sources"),
                any(feature = "model-exchange", not(feature = "co-simulation"))
            ),
            unsafe(no_mangle)
        )]
        $($function)*
    };
    (ScheduledExecution $($function:tt)*) => {
        #[cfg_attr(
            any(
                not(target_arch = "wasm32"),
                all(feature = "sources", feature = "scheduled-execution")
            ),
            unsafe(no_mangle)
        )]
        $($function)*
    };
    ($_:ident $($function:tt)*) => {
        #[cfg_attr(any(not(target_arch = "wasm32"), feature = "sources"), unsafe(no_mangle))]
        $($function)*
    };
}

macro_rules! entry {
    // Written out in each edge, as hosts call them at every step.
    ($i:ident $s:ident $group:ident fmi2GetReal $($row:tt)*) => {};
    ($i:ident $s:ident $group:ident fmi2SetReal $($row:tt)*) => {};
    ($i:ident $s:ident $group:ident fmi2DoStep $($row:tt)*) => {};
    ($i:ident $s:ident $group:ident fmi3GetFloat64 $($row:tt)*) => {};
    ($i:ident $s:ident $group:ident fmi3SetFloat64 $($row:tt)*) => {};
    ($i:ident $s:ident $group:ident fmi3DoStep $($row:tt)*) => {};
    // It may call back the host.
    ($i:ident $s:ident $group:ident fmi3ActivateModelPartition $($row:tt)*) => {};
    // Models with clocks have their functions, which other libraries do not contain.
    ($i:ident $s:ident Clocks $name:ident($($arg:ident: $kind:tt),*) $operation:ident $($states:ident)|+) => {
        exported! { All
            #[doc = concat!("`", stringify!($name), "`")]
            pub unsafe extern "C" fn $name(instance: $i, $($arg: c_type!($kind)),*) -> $s {
                // SAFETY: the host's promises, as for all entry points.
                unsafe {
                    match head(instance).and_then(|head| head.clock_functions) {
                        Some(functions) => (functions.$operation)(instance, $($arg),*),
                        None => $s(crate::edge::refuse(instance, &calls::$name, unsupported) as c_int),
                    }
                }
            }
        }
    };
    // Declared as unsupported by the model description. Importers bind them anyway.
    ($i:ident $s:ident $group:ident $name:ident($($arg:ident: $kind:tt),*) $operation:ident NOWHERE) => {
        exported! { $group
            #[doc = concat!("`", stringify!($name), "`, which returns an error and logs the reason")]
            pub unsafe extern "C" fn $name(instance: $i, $(_: c_type!($kind)),*) -> $s {
                // SAFETY: the host's promise: NULL or an instance.
                $s(unsafe { crate::edge::refuse(instance, &calls::$name, unsupported) } as c_int)
            }
        }
    };
    ($i:ident $s:ident $group:ident $name:ident($($arg:ident: $kind:tt),*) $operation:ident $($states:ident)|+) => {
        exported! { $group
            #[doc = concat!("`", stringify!($name), "`")]
            #[allow(unused_variables, reason = "the slices have the lengths")]
            #[allow(unused_mut, reason = "some arguments are pointers that may be NULL")]
            pub unsafe extern "C" fn $name(instance: $i, $($arg: c_type!($kind)),*) -> $s {
                perform!(instance $s $name $operation $($arg: $kind),*)
            }
        }
    };
}

/// Performs an operation with the arguments of a host, if they are valid and the state allows the call.
macro_rules! perform {
    ($instance:ident $s:ident $name:ident $operation:ident $($arg:ident: $kind:tt),*) => {{
        let call = &calls::$name;
        // SAFETY: the host's promises: NULL or an instance that is not used otherwise; pointers that are
        // NULL or valid, those to arrays for the lengths passed with them; zero-terminated texts.
        let status = unsafe {
            let arguments = || Ok::<_, &str>(($(convert!($arg $kind)?,)*));
            match arguments() {
                Ok(($(mut $arg,)*)) => crate::fast::call(
                    $instance, call, |instance| apply!(instance.$operation [] $($arg: $kind,)*)
                ),
                Err(why) => crate::fast::refuse($instance, call, why),
            }
        };
        $s(status as c_int)
    }};
}

/// Defines the functions of clocks.
macro_rules! clock_functions {
    (
        Free { $($_0:tt)* }
        All { $($_1:tt)* }
        Clocks { $($name:ident($($arg:ident: $kind:tt),*) => $operation:ident in $($_2:ident)|+;)* }
        $($_3:ident { $($_4:tt)* })*
    ) => {
        /// The functions of models with clocks.
        #[allow(unused_variables, unused_mut, reason = "as for other entry points")]
        pub(crate) static CLOCK_FUNCTIONS: ClockFunctions = ClockFunctions {
            $($operation: {
                unsafe extern "C" fn $operation(
                    instance: fmi3Instance, $($arg: c_type!($kind)),*
                ) -> fmi3Status {
                    perform!(instance fmi3Status $name $operation $($arg: $kind),*)
                }
                $operation
            },)*
            activate,
        };
    };
}

/// The argument of a host as a Rust type, or why it is refused.
macro_rules! convert {
    ($arg:ident [in? $byte:ty; $n:ident]) => {
        Ok::<_, &str>(slice($arg.cast::<u8>(), $n))
    };
    ($arg:ident [out? $byte:ty; $n:ident]) => {
        Ok::<_, &str>(slice_mut($arg.cast::<u8>(), $n))
    };
    ($arg:ident [in $type:ty; $n:ident]) => {
        slice($arg, $n).ok_or(NULL_ARRAY)
    };
    ($arg:ident [out $type:ty; $n:ident]) => {
        slice_mut($arg, $n).ok_or(NULL_ARRAY)
    };
    ($arg:ident [out? $type:ty]) => {
        Ok::<_, &str>($arg.as_mut())
    };
    ($arg:ident [out $type:ty]) => {
        $arg.as_mut().ok_or("a pointer to a result is NULL")
    };
    ($arg:ident fmi2Boolean) => {
        Ok::<_, &str>($arg != 0)
    };
    ($arg:ident fmi3Boolean) => {
        Ok::<_, &str>($arg != 0)
    };
    ($arg:ident $kind:tt) => {
        Ok::<_, &str>($arg)
    };
}

/// Calls a method with all arguments but the lengths.
macro_rules! apply {
    ($instance:ident.$method:ident [$($done:tt)*]) => { $instance.$method($($done),*) };
    ($instance:ident.$method:ident [$($done:tt)*] $n:ident: [len], $($rest:tt)*) => {
        apply!($instance.$method [$($done)*] $($rest)*)
    };
    ($instance:ident.$method:ident [$($done:tt)*] $arg:ident: [out? $($kind:tt)*], $($rest:tt)*) => {
        apply!($instance.$method [$($done)* ($arg.as_deref_mut())] $($rest)*)
    };
    ($instance:ident.$method:ident [$($done:tt)*] $arg:ident: $kind:tt, $($rest:tt)*) => {
        apply!($instance.$method [$($done)* $arg] $($rest)*)
    };
}

#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
pub(crate) mod clocks;
#[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
pub mod fmi2;
#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
pub mod fmi3;
mod fmu_state;
#[cfg(all(target_arch = "wasm32", feature = "sources"))]
pub mod sources;
#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
mod wasm;

/// Refuses a function that no instance has, for the reason that its version gives.
///
/// # Safety
/// The host's promise: NULL or an instance.
#[inline(never)]
unsafe fn refuse(
    instance: Pointer,
    call: &FmiFunction,
    reason: fn(&str) -> &'static str,
) -> Status {
    // SAFETY: the caller's promise.
    unsafe { fast::refuse(instance, call, reason(call.name)) }
}

/// Creates an instance of the model that a host chooses by name and GUID, of a type. On failure, logs the
/// reason and returns NULL.
fn instantiate(
    function: &str,
    models: &'static [Entry],
    (name, guid): (Option<&CStr>, Option<&CStr>),
    instance_type: Result<InstanceType, String>,
    settings: Settings,
) -> Pointer {
    #[cfg(not(target_arch = "wasm32"))]
    crate::log::silence_panics(crate::log::remember_place);
    let log = settings.log.clone();
    let made = catch_unwind(AssertUnwindSafe(|| {
        let version = settings.edge.version;
        let chosen = instance_type.and_then(|instance_type| {
            let entry = Entry::choose(models, name, instance_type, guid, version)?;
            entry.create(Settings { instance_type, ..settings })
        });
        chosen.unwrap_or_else(|reason| {
            log.send(LogCategory::Error, format_args!("{function}: {reason}"));
            std::ptr::null_mut()
        })
    }));
    made.unwrap_or_else(|panic| {
        log.send_panic(function, "the model panicked", panic);
        std::ptr::null_mut()
    })
}

/// The methods whose arguments are of C, for both versions.
impl Instance {
    unsafe fn set_debug_logging(
        &mut self,
        on: bool,
        categories: &[*const c_char],
    ) -> Result<(), ModelError> {
        // SAFETY: the host's promise: NULL or zero-terminated texts.
        let names: Option<Vec<&CStr>> = unsafe { texts(categories) }.into_iter().collect();
        let names = names.ok_or_else(|| ModelError::refuse("a category is NULL"))?;
        self.switch_log(on, &names)
    }

    /// Gets Booleans as 0 or 1.
    fn get_boolean<B: From<bool>>(
        &mut self,
        references: &[u32],
        values: &mut [B],
    ) -> Result<(), ModelError> {
        self.get_of_type(Type::Boolean, references, values.len(), &mut |i, value| {
            values[i] = (value == Value::Boolean(true)).into();
        })
    }

    fn set_boolean<B: Copy + Into<i32>>(
        &mut self,
        references: &[u32],
        values: &[B],
    ) -> Result<(), ModelError> {
        let given = |i: usize| {
            HostValue::Other(match values[i].into() {
                value @ (0 | 1) => Ok(Value::Boolean(value == 1)),
                other => Err(format!("{other}")), // less code than `to_string`
            })
        };
        self.set_of_type(Type::Boolean, references, values.len(), &given)
    }

    /// Hands out pointers to texts that live until the next call.
    fn get_string(
        &mut self,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Result<(), ModelError> {
        let mut texts = Vec::new();
        self.get_of_type(Type::String, references, values.len(), &mut |_, value| {
            if let Value::String(text) = value {
                texts.push(c_text(&text));
            }
        })?;
        for (value, text) in values.iter_mut().zip(&texts) {
            *value = text.as_ptr();
        }
        self.shared.texts = texts;
        Ok(())
    }

    unsafe fn set_string(
        &mut self,
        references: &[u32],
        values: &[*const c_char],
    ) -> Result<(), ModelError> {
        // SAFETY: the host's promise: NULL or zero-terminated texts.
        let values = unsafe { texts(values) };
        let given = |i: usize| {
            HostValue::Other(match values[i].map(|text| (text, text.to_str())) {
                Some((_, Ok(text))) => Ok(Value::String(text.to_owned())),
                Some((text, Err(_))) => Err(format!("\"{}\"", readable(text.to_bytes()))),
                None => Err("NULL".into()),
            })
        };
        self.set_of_type(Type::String, references, values.len(), &given)
    }

    fn completed_integrator_step<B: From<bool>>(
        &mut self,
        _no_set_state: bool,
        enter_event_mode: &mut B,
        terminate: &mut B,
    ) -> Result<(), ModelError> {
        (*enter_event_mode, *terminate) = (false.into(), false.into());
        Ok(())
    }
}
