//! The functions of an instance.

use std::mem::transmute;
use std::ptr::null_mut;

use fmi_abi::{FmiFunction, fmi2, fmi3_functions};
use fmu_description::{Type, Value};

use super::call::{answer, call};
use super::scratch::{allocate, copied, put};
use crate::any_model::SolverVector;
use crate::canonical::{Answer, List, Text, Values, list, slice, texts};
use crate::edge::fmi3::*;
use crate::error::{ModelError, refused};
use crate::fast::{self, head, instance_at};
use crate::instance::Instance;
use crate::pointers::Pointer;
use crate::values::HostValue;

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
            let n_values = number_of_elements(i, references, n);
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
unsafe fn number_of_elements(instance: Pointer, references: *const u32, n: usize) -> usize {
    // SAFETY: the caller's promise.
    unsafe {
        head(instance).map_or(0, |head| (head.vtable.count_elements)(instance, references, n))
    }
}

/// Defines the functions that have the arguments of C, from the rows of `fmi-abi`.
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
    // Only libraries for scheduled execution have it.
    (fmi3ActivateModelPartition($($arg:ident: $type:ident),*) $($rest:tt)*) => {
        #[cfg(feature = "scheduled-execution")]
        method!(@ fmi3ActivateModelPartition activate_model_partition($($arg: $type),*));
    };
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
                let n = instance_at(instance).map_or(0, |instance| instance.model.vector_length(SolverVector::$which));
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
fn refuse(instance: Pointer, operation: &FmiFunction) {
    call(instance, || {
        // SAFETY: the host's promise: an instance that is not used otherwise.
        unsafe { fast::refuse(instance, operation, unsupported(operation.name)) };
    });
}

fn failed<T>() -> *const Answer<T> {
    put(Answer::Err(fmi3Error.0 as u8))
}

unsupported! {
    fmi3GetNumberOfVariableDependencies: get_number_of_variable_dependencies(u32) -> *const Answer<u64> = failed();
    fmi3GetVariableDependencies: get_variable_dependencies(u32) -> Values<u8> = failed();
}

/// The interval of a clock, and what it means.
#[repr(C)]
pub struct Qualified<T> {
    interval: T,
    qualifier: u8,
}

/// A counter and its resolution.
type Fraction = [u64; 2];

#[unsafe(no_mangle)]
unsafe extern "C" fn get_clock(instance: Pointer, clocks: *const u32, n: usize) -> Values<u8> {
    // SAFETY: the host's promises; the memory is for as many values.
    unsafe { values(instance, n, |first, n| fmi3GetClock(instance, clocks, n, first)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn get_shift_decimal(
    instance: Pointer,
    clocks: *const u32,
    n: usize,
) -> Values<f64> {
    // SAFETY: the host's promises; the memory is for as many values.
    unsafe { values(instance, n, |first, n| fmi3GetShiftDecimal(instance, clocks, n, first)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn get_interval_decimal(
    instance: Pointer,
    clocks: *const u32,
    n: usize,
) -> Values<Qualified<f64>> {
    // SAFETY: the host's promises; the memory is for as many values.
    unsafe {
        values(instance, n, |first: *mut Qualified<f64>, n| {
            let (mut intervals, mut qualifiers) = (vec![0.0; n], vec![0; n]);
            let (all, of_all) = (intervals.as_mut_ptr(), qualifiers.as_mut_ptr());
            let status = fmi3GetIntervalDecimal(instance, clocks, n, all, of_all);
            for (k, (interval, qualifier)) in intervals.into_iter().zip(qualifiers).enumerate() {
                first.add(k).write(Qualified { interval, qualifier: qualifier as u8 });
            }
            status
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn get_interval_fraction(
    instance: Pointer,
    clocks: *const u32,
    n: usize,
) -> Values<Qualified<Fraction>> {
    // SAFETY: the host's promises; the memory is for as many values.
    unsafe {
        values(instance, n, |first: *mut Qualified<Fraction>, n| {
            let (mut counters, mut resolutions) = (vec![0; n], vec![0; n]);
            let mut qualifiers = vec![0; n];
            let (all, of_all) = (counters.as_mut_ptr(), resolutions.as_mut_ptr());
            let qualified = qualifiers.as_mut_ptr();
            let status = fmi3GetIntervalFraction(instance, clocks, n, all, of_all, qualified);
            for (k, qualifier) in qualifiers.into_iter().enumerate() {
                let interval = [counters[k], resolutions[k]];
                first.add(k).write(Qualified { interval, qualifier: qualifier as u8 });
            }
            status
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn get_shift_fraction(
    instance: Pointer,
    clocks: *const u32,
    n: usize,
) -> Values<Fraction> {
    // SAFETY: the host's promises; the memory is for as many values.
    unsafe {
        values(instance, n, |first: *mut Fraction, n| {
            let (mut counters, mut resolutions) = (vec![0; n], vec![0; n]);
            let (all, of_all) = (counters.as_mut_ptr(), resolutions.as_mut_ptr());
            let status = fmi3GetShiftFraction(instance, clocks, n, all, of_all);
            for (k, shift) in counters.into_iter().zip(resolutions).enumerate() {
                first.add(k).write(shift.into());
            }
            status
        })
    }
}

/// Defines functions that set something of each clock.
macro_rules! set_clocks {
    ($($name:ident: $operation:ident($values:ident: $type:ty) by $($argument:expr),*;)*) => { $(
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $operation(
            instance: Pointer, clocks: *const u32, n: usize, values: *const $type, n_values: usize
        ) -> fmi3Status {
            // SAFETY: the host's promises.
            call(instance, || unsafe {
                if n != n_values {
                    return perform(instance, &calls::$name, |_| {
                        refused!("values passed: {n_values}; expected {n}, one for each clock")
                    });
                }
                let $values = slice(values, n);
                $name(instance, clocks, n $(, $argument.as_ptr())*)
            })
        }
    )* };
}

/// The counters, or the resolutions, of fractions.
fn parts(fractions: &[Fraction], part: usize) -> Vec<u64> {
    fractions.iter().map(|fraction| fraction[part]).collect()
}

set_clocks! {
    fmi3SetClock: set_clock(values: u8) by values;
    fmi3SetIntervalDecimal: set_interval_decimal(values: f64) by values;
    fmi3SetIntervalFraction: set_interval_fraction(values: Fraction) by parts(values, 0), parts(values, 1);
    fmi3SetShiftDecimal: set_shift_decimal(values: f64) by values;
    fmi3SetShiftFraction: set_shift_fraction(values: Fraction) by parts(values, 0), parts(values, 1);
}

#[unsafe(no_mangle)]
extern "C" fn get_version() -> *const Text {
    call(null_mut(), || put(list(b"3.0")))
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

/// Performs an operation whose arguments differ from C, by a method of the instance.
///
/// # Safety
/// The host's promise: an instance that is not used otherwise.
unsafe fn perform(
    instance: Pointer,
    operation: &FmiFunction,
    method: impl FnMut(&mut Instance) -> Result<(), ModelError>,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    fmi3Status(unsafe { fast::call(instance, operation, method) } as i32)
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
                let n_values = number_of_elements(instance, references, n);
                values(instance, n_values, |first: *mut Text, n_values| {
                    perform(instance, &calls::$get_in_c, |instance| {
                        let references = slice(references, n);
                        instance.get_of_type(Type::$name, references, n_values, &mut |i, value| {
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
                perform(instance, &calls::$set_in_c, |instance| {
                    instance.set_of_type(Type::$name, slice(references, n), n_values, &given)
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
        let status = perform(instance, &calls::fmi3GetFMUState, |instance| {
            state = copied(&instance.serialize(&instance.snapshot()?)?);
            Ok(())
        });
        answer(status, state)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn set_fmu_state(instance: Pointer, bytes: *const u8, n: usize) -> fmi3Status {
    // SAFETY: the host's promises.
    call(instance, || unsafe {
        perform(instance, &calls::fmi3SetFMUState, |instance| {
            let state = instance.deserialize(slice(bytes, n))?;
            instance.restore(&state)
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
                let n = number_of_elements(instance, $of, $n_of);
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
        let n_values = number_of_elements(instance, references.as_ptr(), n);
        let (references, orders) = (references.as_ptr(), orders.as_ptr());
        values(instance, n_values, |first, n_values| {
            fmi3GetOutputDerivatives(instance, references, n, orders, first, n_values)
        })
    }
}

/// FMI 3.0 has no such function in C, but FMI 2.0 has.
#[unsafe(no_mangle)]
unsafe extern "C" fn set_input_derivatives(
    instance: Pointer,
    pairs: *const [u32; 2],
    n: usize,
    values: *const f64,
    n_values: usize,
) -> fmi3Status {
    let operation =
        FmiFunction { name: "set-input-derivatives", ..fmi2::calls::fmi2SetRealInputDerivatives };
    // SAFETY: the host's promises.
    call(instance, || unsafe {
        let ((references, orders), values) = (orders(pairs, n), slice(values, n_values));
        perform(instance, &operation, |instance| match n == n_values {
            true => instance.set_input_derivatives(&references, &orders, values),
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
            $(pub(super) $field: $of),*
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
