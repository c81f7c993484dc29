//! The three calls of every step, without a [`Result`] in the usual case: the compiler keeps nothing of it but a
//! comparison.

use std::ffi::c_int;
use std::ops::Range;

use fmi_abi::FmiVersion;
use fmi_abi::fmi2::{fmi2Component, fmi2Status};
use fmi_abi::fmi3::{fmi3Instance, fmi3Status};

use crate::instance::{Fmi2 as Fmi2Instance, Instance};
use crate::library::Library;
use crate::outcome::{Result, Success};

/// Nothing after plain success, else the result of the call.
pub type Unusual = Option<Box<Result>>;

/// The result of a call that is not quick, as of a WebAssembly component.
fn slowly(result: Result) -> Unusual {
    match result {
        Ok(Success::Ok) => None,
        other => Some(Box::new(other)),
    }
}

/// Variables of the type Float64 that are accessed at every step, and the place of their values in a longer list.
#[derive(Debug, Clone)]
pub struct Listed {
    references: Vec<u32>,
    /// The number of variables that have an element each, as all do in FMI 2.0.
    scalars: usize,
    place: Range<usize>,
}

impl Listed {
    const NOTHING: Self = Self { references: Vec::new(), scalars: 0, place: 0..0 };

    /// The variables of these value references, whose elements are at this place.
    pub fn new(references: &[u32], place: Range<usize>) -> Self {
        let scalars = references.len().min(place.len());
        let place = place.start..place.end.max(place.start);
        Self { references: references.to_vec(), scalars, place }
    }

    #[cfg(feature = "sandbox")]
    pub(crate) fn references(&self) -> &[u32] {
        &self.references
    }

    /// The place of the elements.
    pub fn place(&self) -> Range<usize> {
        self.place.clone()
    }
}

/// The variables that every step of an instance sets or gets, and the function that does it, unless each call looks
/// it up, as of a WebAssembly component.
struct Access<V> {
    listed: Listed,
    fmi2: Option<Fmi2<V>>,
    fmi3: Option<Fmi3<V>>,
}

type Fmi2<V> = unsafe extern "C" fn(fmi2Component, *const u32, usize, V) -> fmi2Status;
type Fmi3<V> = unsafe extern "C" fn(fmi3Instance, *const u32, usize, V, usize) -> fmi3Status;

impl<V> Access<V> {
    const NOTHING: Self = Self { listed: Listed::NOTHING, fmi2: None, fmi3: None };

    fn new(listed: Listed, fmi2: Option<Fmi2<V>>, fmi3: Option<Fmi3<V>>) -> Self {
        match listed.references[..] {
            [] => Self::NOTHING,
            _ => Self { listed, fmi2, fmi3 },
        }
    }

    /// The end of the values in their list; `usize::MAX` if the function is not known.
    fn end(&self) -> usize {
        let is_known = self.is_nothing() || self.fmi2.is_some() || self.fmi3.is_some();
        if is_known { self.listed.place.end } else { usize::MAX }
    }

    /// Whether there is nothing to access.
    #[inline(always)]
    fn is_nothing(&self) -> bool {
        self.listed.references.is_empty()
    }

    /// Calls the function, if it is known, and returns the status.
    ///
    /// # Safety
    /// The function is one of the library of this instance, and the pointer is valid for the values that are listed.
    #[inline(always)]
    unsafe fn call(&self, instance: fmi2Component, values: V) -> Option<c_int> {
        let Listed { references, scalars, place } = &self.listed;
        let first = references.as_ptr();
        // SAFETY: the standard gives the types, and every pointer is valid for the length passed with it, by the
        // caller's promise. The rest depends on the foreign binary, as described in the crate documentation.
        unsafe {
            match (self.fmi2, self.fmi3) {
                (Some(call), _) => Some(call(instance, first, *scalars, values).0),
                (_, Some(call)) => {
                    Some(call(instance, first, references.len(), values, place.len()).0)
                }
                _ => None,
            }
        }
    }
}

/// What every step of an instance accesses.
pub(crate) struct Quick {
    set: Access<*const f64>,
    get: Access<*mut f64>,
    /// The number of values in a list that has those of both; `usize::MAX` if a function is not known.
    values: usize,
}

impl Quick {
    pub(crate) const NOTHING: Self =
        Self { set: Access::NOTHING, get: Access::NOTHING, values: usize::MAX };
}

/// The names of a function in both versions.
type Functions = [&'static str; 2];

const SET: &Functions = &["fmi2SetReal", "fmi3SetFloat64"];
const GET: &Functions = &["fmi2GetReal", "fmi3GetFloat64"];

/// Defines the access at steps.
macro_rules! access {
    ($($name:ident(&$($mut:ident)? [f64] as $pointer:ident) = $access:ident by $slow:ident, $functions:expr;)*) => { $(
        #[doc = concat!("[`Instance::", stringify!($slow), "`] of the variables of [`Instance::access_at_steps`].")]
        ///
        /// # Panics
        /// The list of values is too short.
        #[inline(always)]
        pub fn $name(&mut self, values: &$($mut)? [f64]) -> Unusual {
            #[cold]
            #[inline(never)]
            fn slow(instance: &mut Instance, values: &$($mut)? [f64]) -> Unusual {
                let Listed { references, place, .. } = instance.quick.$access.listed.clone();
                let values = &$($mut)? values[place];
                if references.is_empty() { None } else { slowly(instance.$slow(&references, values)) }
            }
            let access = &self.quick.$access;
            let Range { start, end } = access.listed.place;
            if end > values.len() {
                return slow(self, values);
            }
            // SAFETY: the function is one of this instance, and the values are there, by the check.
            match unsafe { access.call(self.pointer, values.$pointer().add(start)) } {
                Some(status) => self.unusual($functions, status),
                None => slow(self, values),
            }
        }
    )* };
}

impl Instance {
    /// Says which variables every step sets and gets.
    pub fn access_at_steps(&mut self, set: Listed, get: Listed) {
        #[cfg(feature = "sandbox")]
        if let Some(component) = &mut self.component {
            component.access_at_steps(&set, &get);
        }
        let Library { fmi2, fmi3, .. } = &*self.library;
        let set = Access::new(set, fmi2.fmi2SetReal, fmi3.fmi3SetFloat64);
        let get = Access::new(get, fmi2.fmi2GetReal, fmi3.fmi3GetFloat64);
        let values = set.end().max(get.end());
        self.quick = Quick { set, get, values };
    }

    access! {
        set_at_step(&[f64] as as_ptr) = set by set_float64, SET;
        get_at_step(&mut [f64] as as_mut_ptr) = get by get_float64, GET;
    }

    /// [`Instance::do_step`] for steps.
    #[inline(always)]
    pub fn do_step_quickly(&mut self, time: f64, step: f64) -> Unusual {
        match (self.library.fmi2.fmi2DoStep, self.version) {
            (Some(do_step), _) => {
                // SAFETY: the function is one of the library of this instance, which is not freed.
                let status =
                    unsafe { do_step(self.pointer, time, step, (!self.is_saved).into()).0 };
                self.unusual(&["fmi2DoStep"; 2], status)
            }
            (_, FmiVersion::Fmi3) => self.step_to_the_end(time, step),
            _ => {
                let no_set_state = !self.is_saved;
                slowly(Fmi2Instance(self).do_step(time, step, no_set_state))
            }
        }
    }

    /// Makes the calls of a step, with inputs in a list of their own or that of the outputs: sets variables, takes the
    /// step and gets variables, until one is not plainly successful. Calls `begin` with the number of each, from 0,
    /// before it. Returns how many were made, and the result of the last one: none if the lists are too short or a
    /// function must be looked up.
    #[inline(always)]
    pub fn cycle(
        &mut self,
        inputs: Option<&[f64]>,
        time: f64,
        step: f64,
        outputs: &mut [f64],
        begin: impl Fn(usize),
    ) -> (usize, Unusual) {
        let Quick { set, get, values } = &self.quick;
        let is_long = match inputs {
            None => outputs.len() >= *values,
            Some(inputs) => inputs.len() >= set.end() && outputs.len() >= get.end(),
        };
        if !is_long {
            #[cfg(feature = "sandbox")]
            {
                begin(1);
                return self.cycle_of_component(inputs, time, step, outputs);
            }
            #[cfg(not(feature = "sandbox"))]
            return (0, None);
        }
        if !set.is_nothing() {
            let values = inputs.unwrap_or(outputs).as_ptr();
            begin(0);
            // SAFETY: the function is one of this instance, and the values are there, by the check.
            let status = unsafe { set.call(self.pointer, values.add(set.listed.place.start)) };
            if let Some(unusual) = self.unusual(SET, status.unwrap_or_default()) {
                return (1, Some(unusual));
            }
        }
        begin(1);
        if let Some(unusual) = self.do_step_quickly(time, step) {
            return (2, Some(unusual));
        }
        let Quick { get, .. } = &self.quick;
        if get.is_nothing() {
            return (3, None);
        }
        begin(2);
        // SAFETY: as above.
        let status =
            unsafe { get.call(self.pointer, outputs.as_mut_ptr().add(get.listed.place.start)) };
        (3, self.unusual(GET, status.unwrap_or_default()))
    }

    /// [`Instance::cycle`] of a component of `fmu-export`, in one call, unless calls are traced.
    #[cfg(feature = "sandbox")]
    #[inline(never)]
    fn cycle_of_component(
        &mut self,
        inputs: Option<&[f64]>,
        time: f64,
        step: f64,
        outputs: &mut [f64],
    ) -> (usize, Unusual) {
        let is_traced = self.library.is_traced();
        let how = (time, step, !self.is_saved);
        let component = self.component.as_mut().filter(|c| !is_traced && c.has_cycle());
        let Some((calls, status, stepped)) = component.and_then(|c| c.cycle(inputs, how, outputs))
        else {
            return (0, None);
        };
        let function = ["fmi3SetFloat64", "fmi3DoStep", "fmi3GetFloat64"][calls - 1];
        let unusual = match self.library.outcome(function, status.0) {
            Ok(done) if calls == 2 => crate::instance::at_the_end(done, stepped),
            other => slowly(other),
        };
        (calls, unusual)
    }

    /// The names are passed as one static reference, so that nothing must be kept across the call.
    #[inline(always)]
    fn unusual(&self, functions: &'static Functions, status: c_int) -> Unusual {
        match status {
            0 => None,
            _ => Some(self.boxed(functions, status)),
        }
    }

    #[cold]
    fn boxed(&self, functions: &'static Functions, status: c_int) -> Box<Result> {
        Box::new(self.library.outcome(functions[self.version as usize], status))
    }
}
