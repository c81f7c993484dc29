//! Instances of components, with a method for each operation of FMI 3.0.

use std::ffi::{CStr, CString};
use std::time::Duration;
use std::{ptr, slice};

use fmi_abi::fmi3::*;
use fmi_abi::fmi3_functions;
use wasmtime::Store;

use super::abi::{self, Argument, CallError, ComponentFunction, Returned};
use super::cycle::Cycle;
use super::host_state::HostState;
use super::outcome::{LENGTH, TRAPPED, TYPE, ZERO_BYTE};
use crate::quick::StepVariables;
use crate::types::{FmuState as Saved, StepResult};

/// An instance of a component.
pub(crate) struct ComponentInstance {
    store: Store<HostState>,
    created: Created,
    /// Whether a call has trapped, so that there are no more calls.
    is_over: bool,
    /// The time that a call has, in periods of the engine.
    ticks: u64,
    limit: Option<Duration>,
    /// What the host has a pointer to until the next call.
    texts: Vec<CString>,
    bytes: Vec<Vec<u8>>,
}

/// An instance that a component has created, and the functions that the host calls for it.
pub(super) struct Created {
    /// By operation.
    pub(super) methods: Vec<Method>,
    /// What the component calls the instance.
    pub(super) handle: u32,
    /// The function that ends the instance.
    pub(super) end: Option<ComponentFunction>,
    pub(super) cycle: Option<Cycle>,
}

/// A method of a component.
pub(super) struct Method {
    pub(super) function: Option<ComponentFunction>,
    /// Whether it has the types that it is called with.
    is_checked: bool,
}

impl Method {
    pub(super) fn new(function: Option<ComponentFunction>) -> Self {
        Self { function, is_checked: false }
    }
}

impl ComponentInstance {
    pub(super) fn new(
        store: Store<HostState>,
        created: Created,
        ticks: u64,
        limit: Option<Duration>,
    ) -> Self {
        let (texts, bytes, is_over) = Default::default();
        Self { store, created, is_over, ticks, limit, texts, bytes }
    }

    /// Calls a method of a type that returns a status.
    #[inline(always)]
    fn call_for_status(
        &mut self,
        operation: Operation,
        signature: &'static str,
        given: &[Argument<'_>],
    ) -> CallResult {
        self.call(operation, signature, given, |returned| returned.status())
    }

    /// Calls a method of a type.
    #[inline(always)]
    fn call<R>(
        &mut self,
        operation: Operation,
        signature: &'static str,
        given: &[Argument<'_>],
        read: impl FnOnce(Returned<'_>) -> std::result::Result<R, CallError>,
    ) -> CallResult<R> {
        let method = &mut self.created.methods[operation as usize];
        let function = method.function.as_ref().ok_or(TYPE)?;
        if !method.is_checked {
            if &*function.signature != signature {
                return Err(TYPE);
            }
            method.is_checked = true;
        }
        if self.is_over {
            return Err(TRAPPED);
        }
        self.store.set_epoch_deadline(self.ticks);
        // SAFETY: the types were checked, and each method is called by one function below.
        let called =
            unsafe { abi::call(&mut self.store, function, Some(self.created.handle), given, read) };
        called.map_err(|error| match error {
            CallError::Status(status) => status,
            CallError::Trap(error) => self.trapped(&error),
        })
    }

    /// Says which variables every step sets and gets.
    pub(crate) fn access_at_steps(&mut self, set: &StepVariables, get: &StepVariables) {
        if let Some(cycle) = &mut self.created.cycle {
            cycle.set_lists(&mut self.store, [set, get]);
        }
    }

    /// Whether [`ComponentInstance::cycle`] is possible.
    pub(crate) fn has_cycle(&self) -> bool {
        self.created.cycle.as_ref().is_some_and(Cycle::is_ready)
    }

    /// Sets variables, takes a step and gets variables. Their limit of time is that of one call.
    pub(crate) fn cycle(
        &mut self,
        inputs: Option<&[f64]>,
        step: (f64, f64, bool),
        outputs: &mut [f64],
    ) -> Option<(usize, fmi3Status, StepResult)> {
        let cycle = self.created.cycle.as_ref().filter(|_| !self.is_over)?;
        self.store.set_epoch_deadline(self.ticks);
        let (calls, called, stepped) =
            cycle.call(&mut self.store, self.created.handle, inputs, step, outputs)?;
        let status = called.unwrap_or_else(|error| self.trapped(&error));
        Some((calls, status, stepped))
    }

    #[cold]
    fn trapped(&mut self, error: &wasmtime::Error) -> fmi3Status {
        self.store.data_mut().log_fatal(error, self.limit);
        self.is_over = true;
        TRAPPED
    }
}

type CallResult<T = ()> = std::result::Result<T, fmi3Status>;

/// A Boolean of a record or a list.
fn boolean(byte: u8) -> fmi3Boolean {
    (byte != 0).into()
}

fn status(called: CallResult) -> fmi3Status {
    called.err().unwrap_or(fmi3OK)
}

/// Copies values.
fn copy<T: Copy>(values: &[T], to: &mut [T]) -> CallResult {
    if values.len() != to.len() {
        return Err(LENGTH);
    }
    to.copy_from_slice(values);
    Ok(())
}

/// Defines the methods, in the forms that the rows tell. The others follow.
macro_rules! methods {
    (
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident $arguments:tt => $operation:ident in $($states:ident)|+;)* })*
    ) => {
        #[allow(non_camel_case_types, dead_code, reason = "the host does not call all of them")]
        #[derive(Clone, Copy)]
        pub(super) enum Operation { $($($operation),*),* }

        pub(super) const OPERATIONS: &[&str] = &[$($(stringify!($operation)),*),*];

        #[allow(dead_code, reason = "as above")]
        impl ComponentInstance {
            $($(method!($name $arguments $operation);)*)*
        }
    };
}

macro_rules! method {
    (fmi3GetBoolean $($rest:tt)*) => {};
    (fmi3GetShiftDecimal $($rest:tt)*) => {
        method!(@get get_shift_decimal(references: u32) f64);
    };
    (fmi3SetIntervalDecimal $($rest:tt)*) => {
        method!(@set set_interval_decimal(references: u32, intervals: f64));
    };
    (fmi3SetShiftDecimal $($rest:tt)*) => {
        method!(@set set_shift_decimal(references: u32, shifts: f64));
    };
    (fmi3SetBoolean $($rest:tt)*) => {};
    (fmi3GetString $($rest:tt)*) => {};
    (fmi3SetString $($rest:tt)*) => {};
    (fmi3Terminate $($rest:tt)*) => {};
    ($name:ident(
        references: [in u32; n], n: [len], values: [out $type:ident; n_values], n_values: [len]
    ) $operation:ident) => {
        method!(@get $operation(references: u32) $type);
    };
    ($name:ident(values: [out f64; n], n: [len]) $operation:ident) => {
        method!(@get $operation() f64);
    };
    ($name:ident(
        unknowns: [in u32; $_0:ident], $_1:ident: [len], knowns: [in u32; $_2:ident], $_3:ident: [len],
        seed: [in f64; $_4:ident], $_5:ident: [len], sensitivity: [out f64; $_6:ident], $_7:ident: [len]
    ) $operation:ident) => {
        method!(@get $operation(unknowns: u32, knowns: u32, seed: f64) f64);
    };
    (@get $operation:ident($($arg:ident: $of:ident),*) $type:ident) => {
        pub(crate) fn $operation(&mut self, $($arg: &[$of],)* values: &mut [$type]) -> fmi3Status {
            let signature = concat!(
                "borrow" $(, ",list<", wit!($of), ">")*, "->result<list<", wit!($type), ">,status>"
            );
            let given = [$(Argument::list($arg)),*];
            status(self.call(Operation::$operation, signature, &given, |returned| returned.copy(values, LENGTH)))
        }
    };
    ($name:ident(
        references: [in u32; n], n: [len], values: [in $type:ident; n_values], n_values: [len]
    ) $operation:ident) => {
        method!(@set $operation(references: u32, values: $type));
    };
    ($name:ident(states: [in f64; n], n: [len]) $operation:ident) => {
        method!(@set $operation(states: f64));
    };
    ($name:ident() $operation:ident) => {
        method!(@set $operation());
    };
    (@set $operation:ident($($arg:ident: $of:ident),*)) => {
        pub(crate) fn $operation(&mut self $(, $arg: &[$of])*) -> fmi3Status {
            let signature = concat!("borrow" $(, ",list<", wit!($of), ">")*, "->status");
            let given = [$(Argument::list($arg)),*];
            status(self.call_for_status(Operation::$operation, signature, &given))
        }
    };
    ($name:ident($arg:ident: f64) $operation:ident) => {
        pub(crate) fn $operation(&mut self, $arg: f64) -> fmi3Status {
            let given = [Argument::Float($arg)];
            status(self.call_for_status(Operation::$operation, "borrow,f64->status", &given))
        }
    };
    ($name:ident(n: [out usize]) $operation:ident) => {
        pub(crate) fn $operation(&mut self, n: &mut usize) -> fmi3Status {
            let signature = "borrow->result<u64,status>";
            let got = self.call(Operation::$operation, signature, &[], |returned| returned.result(8));
            status(got.map(|got| *n = usize::try_from(u64::from_le_bytes(got)).unwrap_or(usize::MAX)))
        }
    };
    ($($other:tt)*) => {};
}

/// The name of a type in WIT.
macro_rules! wit {
    (i8) => {
        "s8"
    };
    (i16) => {
        "s16"
    };
    (i32) => {
        "s32"
    };
    (i64) => {
        "s64"
    };
    ($type:ident) => {
        stringify!($type)
    };
}

fmi3_functions!(methods!);

/// The texts of the host.
fn strings(texts: &[fmi3String]) -> Vec<String> {
    // SAFETY: the pointers of the host are valid, and its texts are terminated by zero.
    let text = |text: &fmi3String| unsafe { CStr::from_ptr(*text) };
    texts.iter().map(|t| text(t).to_string_lossy().into_owned()).collect()
}

impl ComponentInstance {
    fn get_flags(&mut self, by: Operation, r: &[u32], values: &mut [u8]) -> fmi3Status {
        let signature = "borrow,list<u32>->result<list<bool>,status>";
        status(self.call(by, signature, &[Argument::list(r)], |returned| {
            returned.copy(values, LENGTH)?;
            values.iter_mut().for_each(|value| *value = boolean(*value));
            Ok(())
        }))
    }

    fn set_flags(&mut self, by: Operation, r: &[u32], values: &[u8]) -> fmi3Status {
        let values = Vec::from_iter(values.iter().map(|value| boolean(*value)));
        let given = [Argument::list(r), Argument::list(&values)];
        status(self.call_for_status(by, "borrow,list<u32>,list<bool>->status", &given))
    }

    pub(crate) fn get_boolean(&mut self, r: &[u32], values: &mut [fmi3Boolean]) -> fmi3Status {
        self.get_flags(Operation::get_boolean, r, values)
    }

    pub(crate) fn set_boolean(&mut self, r: &[u32], values: &[fmi3Boolean]) -> fmi3Status {
        self.set_flags(Operation::set_boolean, r, values)
    }

    pub(crate) fn get_clock(&mut self, r: &[u32], values: &mut [fmi3Clock]) -> fmi3Status {
        self.get_flags(Operation::get_clock, r, values)
    }

    pub(crate) fn set_clock(&mut self, r: &[u32], values: &[fmi3Clock]) -> fmi3Status {
        self.set_flags(Operation::set_clock, r, values)
    }

    pub(crate) fn activate_model_partition(&mut self, clock: u32, time: f64) -> fmi3Status {
        let given = [Argument::Whole(clock), Argument::Float(time)];
        let by = Operation::activate_model_partition;
        status(self.call_for_status(by, "borrow,u32,f64->status", &given))
    }

    /// Gets records of `N` numbers, each of which takes 8 bytes.
    fn get_records<const N: usize>(
        &mut self,
        by: Operation,
        signature: &'static str,
        r: &[u32],
    ) -> CallResult<Vec<[u64; N]>> {
        self.call(by, signature, &[Argument::list(r)], |returned| {
            let (numbers, _) = returned.list(8 * N)?.as_chunks();
            let (records, _) = numbers.as_chunks::<N>();
            match records.len() == r.len() {
                true => Ok(records.iter().map(|record| record.map(u64::from_le_bytes)).collect()),
                false => Err(CallError::Status(LENGTH)),
            }
        })
    }

    pub(crate) fn get_interval_decimal(
        &mut self,
        r: &[u32],
        intervals: &mut [f64],
        qualifiers: &mut [fmi3IntervalQualifier],
    ) -> fmi3Status {
        let signature = "borrow,list<u32>->result<list<tuple<f64,interval-qualifier>>,status>";
        status(self.get_records(Operation::get_interval_decimal, signature, r).map(|records| {
            let places = intervals.iter_mut().zip(qualifiers);
            for ([interval, qualifier], place) in records.into_iter().zip(places) {
                (*place.0, *place.1) = (f64::from_bits(interval), (qualifier as u8).into());
            }
        }))
    }

    pub(crate) fn get_interval_fraction(
        &mut self,
        r: &[u32],
        counters: &mut [u64],
        resolutions: &mut [u64],
        qualifiers: &mut [fmi3IntervalQualifier],
    ) -> fmi3Status {
        let signature =
            "borrow,list<u32>->result<list<tuple<record<u64,u64>,interval-qualifier>>,status>";
        status(self.get_records(Operation::get_interval_fraction, signature, r).map(|records| {
            let places = counters.iter_mut().zip(resolutions).zip(qualifiers);
            for ([counter, resolution, qualifier], (place, of_qualifier)) in
                records.into_iter().zip(places)
            {
                (*place.0, *place.1) = (counter, resolution);
                *of_qualifier = (qualifier as u8).into();
            }
        }))
    }

    pub(crate) fn get_shift_fraction(
        &mut self,
        r: &[u32],
        counters: &mut [u64],
        resolutions: &mut [u64],
    ) -> fmi3Status {
        let signature = "borrow,list<u32>->result<list<record<u64,u64>>,status>";
        status(self.get_records(Operation::get_shift_fraction, signature, r).map(|records| {
            let places = counters.iter_mut().zip(resolutions);
            for ([counter, resolution], place) in records.into_iter().zip(places) {
                (*place.0, *place.1) = (counter, resolution);
            }
        }))
    }

    fn set_fractions(
        &mut self,
        by: Operation,
        r: &[u32],
        counters: &[u64],
        resolutions: &[u64],
    ) -> fmi3Status {
        let fractions = counters.iter().zip(resolutions).flat_map(|(c, r)| [*c, *r]);
        let fractions = Vec::from_iter(fractions);
        let given = [Argument::list(r), Argument::pairs(&fractions)];
        let signature = "borrow,list<u32>,list<record<u64,u64>>->status";
        status(self.call_for_status(by, signature, &given))
    }

    pub(crate) fn set_interval_fraction(
        &mut self,
        r: &[u32],
        counters: &[u64],
        resolutions: &[u64],
    ) -> fmi3Status {
        self.set_fractions(Operation::set_interval_fraction, r, counters, resolutions)
    }

    pub(crate) fn set_shift_fraction(
        &mut self,
        r: &[u32],
        counters: &[u64],
        resolutions: &[u64],
    ) -> fmi3Status {
        self.set_fractions(Operation::set_shift_fraction, r, counters, resolutions)
    }

    pub(crate) fn set_debug_logging(&mut self, on: bool, categories: &[fmi3String]) -> fmi3Status {
        let texts = strings(categories);
        let texts = Vec::from_iter(texts.iter().map(String::as_bytes));
        let given = [on.into(), Argument::Lists(&texts)];
        let signature = "borrow,bool,list<string>->status";
        status(self.call_for_status(Operation::set_debug_logging, signature, &given))
    }

    pub(crate) fn enter_initialization_mode(
        &mut self,
        has_tolerance: bool,
        tolerance: f64,
        start: f64,
        has_stop: bool,
        stop: f64,
    ) -> fmi3Status {
        let (tolerance, stop) = (has_tolerance.then_some(tolerance), has_stop.then_some(stop));
        let ([a, b], [c, d]) = (Argument::option(tolerance), Argument::option(stop));
        let given = [a, b, Argument::Float(start), c, d];
        let signature = "borrow,option<f64>,f64,option<f64>->status";
        status(self.call_for_status(Operation::enter_initialization_mode, signature, &given))
    }

    pub(crate) fn get_string(&mut self, r: &[u32], values: &mut [fmi3String]) -> fmi3Status {
        let signature = "borrow,list<u32>->result<list<string>,status>";
        let given = [Argument::list(r)];
        let got = self.call(Operation::get_string, signature, &given, |returned| {
            let texts = returned.lists()?.into_iter();
            let texts = texts.map(|bytes| Ok(CString::new(abi::text(bytes)?)));
            Ok(texts.collect::<wasmtime::Result<std::result::Result<Vec<_>, _>>>()?)
        });
        let got = got.and_then(|texts| texts.map_err(|_| ZERO_BYTE));
        status(got.and_then(|texts| {
            self.texts = texts;
            copy(&Vec::from_iter(self.texts.iter().map(|text| text.as_ptr())), values)
        }))
    }

    pub(crate) fn set_string(&mut self, r: &[u32], values: &[fmi3String]) -> fmi3Status {
        let texts = strings(values);
        let texts = Vec::from_iter(texts.iter().map(String::as_bytes));
        let given = [Argument::list(r), Argument::Lists(&texts)];
        status(self.call_for_status(
            Operation::set_string,
            "borrow,list<u32>,list<string>->status",
            &given,
        ))
    }

    pub(crate) fn get_binary(
        &mut self,
        r: &[u32],
        sizes: &mut [usize],
        values: &mut [fmi3Binary],
    ) -> fmi3Status {
        let signature = "borrow,list<u32>->result<list<list<u8>>,status>";
        let given = [Argument::list(r)];
        let got = self.call(Operation::get_binary, signature, &given, |returned| {
            Ok(returned.lists()?.into_iter().map(<[u8]>::to_vec).collect())
        });
        status(got.and_then(|bytes| {
            self.bytes = bytes;
            copy(&Vec::from_iter(self.bytes.iter().map(Vec::len)), sizes)?;
            copy(&Vec::from_iter(self.bytes.iter().map(|bytes| bytes.as_ptr())), values)
        }))
    }

    pub(crate) fn set_binary(
        &mut self,
        r: &[u32],
        sizes: &[usize],
        values: &[fmi3Binary],
    ) -> fmi3Status {
        let bytes = values.iter().zip(sizes).map(|(value, size)| match size {
            0 => &[][..],
            // SAFETY: the pointers of the host are valid for the sizes passed with them.
            _ => unsafe { slice::from_raw_parts(*value, *size) },
        });
        let given = [Argument::list(r), Argument::Lists(&Vec::from_iter(bytes))];
        let signature = "borrow,list<u32>,list<list<u8>>->status";
        status(self.call_for_status(Operation::set_binary, signature, &given))
    }

    pub(crate) fn get_output_derivatives(
        &mut self,
        r: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> fmi3Status {
        let requests = r.iter().zip(orders).flat_map(|(r, order)| [*r, order.cast_unsigned()]);
        let requests = Vec::from_iter(requests);
        let given = [Argument::pairs(&requests)];
        let signature = "borrow,list<tuple<u32,u32>>->result<list<f64>,status>";
        status(self.call(Operation::get_output_derivatives, signature, &given, |returned| {
            returned.copy(values, LENGTH)
        }))
    }

    #[allow(clippy::too_many_arguments, reason = "as in the standard")]
    pub(crate) fn do_step(
        &mut self,
        time: f64,
        step: f64,
        no_set_state: bool,
        event_handling_needed: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
        early_return: &mut fmi3Boolean,
        last_successful_time: &mut f64,
    ) -> fmi3Status {
        let [time, step] = [time, step].map(Argument::Float);
        let given = [time, step, no_set_state.into()];
        let signature = "borrow,f64,f64,bool->result<record<f64,bool,bool,bool>,status>";
        status(self.call(Operation::do_step, signature, &given, |returned| {
            let [time @ .., a, b, c] = returned.result::<11>(8)?;
            *last_successful_time = f64::from_le_bytes(time);
            [*event_handling_needed, *terminate, *early_return] = [a, b, c].map(boolean);
            Ok(())
        }))
    }

    pub(crate) fn update_discrete_states(
        &mut self,
        again: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
        nominals_changed: &mut fmi3Boolean,
        states_changed: &mut fmi3Boolean,
        next_event_defined: &mut fmi3Boolean,
        next_event: &mut f64,
    ) -> fmi3Status {
        let signature = "borrow->result<record<bool,bool,bool,bool,bool,f64>,status>";
        status(self.call(Operation::update_discrete_states, signature, &[], |returned| {
            let [a, b, c, d, e, _, _, _, time @ ..] = returned.result::<16>(8)?;
            [*again, *terminate, *nominals_changed, *states_changed, *next_event_defined] =
                [a, b, c, d, e].map(boolean);
            *next_event = f64::from_le_bytes(time);
            Ok(())
        }))
    }

    pub(crate) fn completed_integrator_step(
        &mut self,
        no_set_state: bool,
        enter_event_mode: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
    ) -> fmi3Status {
        let given = [no_set_state.into()];
        let signature = "borrow,bool->result<record<bool,bool>,status>";
        status(self.call(Operation::completed_integrator_step, signature, &given, |returned| {
            [*enter_event_mode, *terminate] = returned.result(1)?.map(boolean);
            Ok(())
        }))
    }

    pub(crate) fn terminate(&mut self) -> fmi3Status {
        let terminated = self.call_for_status(Operation::terminate, "borrow->status", &[]);
        self.store.data_mut().flush();
        status(terminated)
    }

    pub(crate) fn get_fmu_state(&mut self, state: &mut Saved) -> fmi3Status {
        let signature = "borrow->result<list<u8>,status>";
        status(self.call(Operation::get_fmu_state, signature, &[], |returned| {
            state.replace(Some(returned.list(1)?.to_vec()));
            Ok(())
        }))
    }

    pub(crate) fn set_fmu_state(&mut self, state: &Saved) -> fmi3Status {
        let Some(bytes) = state.bytes() else { return fmi3Error };
        let given = [Argument::list(bytes)];
        status(self.call_for_status(Operation::set_fmu_state, "borrow,list<u8>->status", &given))
    }

    pub(crate) fn free_fmu_state(&mut self, state: &mut Saved) -> fmi3Status {
        state.replace(None);
        fmi3OK
    }

    pub(crate) fn serialized_fmu_state_size(&mut self, state: &Saved, n: &mut usize) -> fmi3Status {
        *n = state.bytes().map_or(0, <[u8]>::len);
        fmi3OK
    }

    pub(crate) fn serialize_fmu_state(&mut self, state: &Saved, bytes: &mut [u8]) -> fmi3Status {
        status(copy(state.bytes().unwrap_or_default(), bytes))
    }

    pub(crate) fn deserialize_fmu_state(&mut self, bytes: &[u8], state: &mut Saved) -> fmi3Status {
        state.replace(Some(bytes.to_vec()));
        fmi3OK
    }
}

impl Saved {
    /// The bytes of a component's state.
    fn bytes(&self) -> Option<&[u8]> {
        // SAFETY: the state of an instance of a component is NULL or from the function below.
        unsafe { self.0.cast::<Vec<u8>>().as_ref() }.map(Vec::as_slice)
    }

    fn replace(&mut self, bytes: Option<Vec<u8>>) {
        if !self.0.is_null() {
            // SAFETY: as above, and it is replaced.
            drop(unsafe { Box::from_raw(self.0.cast::<Vec<u8>>()) });
        }
        self.0 = bytes.map_or(ptr::null_mut(), |bytes| Box::into_raw(Box::new(bytes)).cast());
    }
}

impl Drop for ComponentInstance {
    fn drop(&mut self) {
        self.store.set_epoch_deadline(self.ticks);
        // A component that has trapped cannot free anything.
        if let Some(end) = self.created.end.as_ref().filter(|_| !self.is_over) {
            // SAFETY: the function ends a resource, for which it gets what the handle stands for.
            let _ = unsafe {
                abi::call(&mut self.store, end, Some(self.created.handle), &[], |_| Ok(()))
            };
        }
        self.store.data_mut().flush();
    }
}
