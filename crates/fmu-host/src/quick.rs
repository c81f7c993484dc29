//! The three calls of every step, without a [`Result`] in the usual case: the compiler keeps nothing of it but a
//! comparison.

use std::ffi::c_int;
use std::ops::Range;

use fmi_abi::Version;
use fmi_abi::fmi2::{fmi2Boolean, fmi2Component, fmi2OK, fmi2Status};
use fmi_abi::fmi3::{fmi3Instance, fmi3Status};

use crate::instance::Instance;
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
    first: usize,
    end: usize,
}

impl Listed {
    const NOTHING: Self = Self { references: Vec::new(), scalars: 0, first: 0, end: 0 };

    /// The variables of these value references, whose elements are at this place.
    pub fn new(references: &[u32], place: Range<usize>) -> Self {
        let scalars = references.len().min(place.len());
        let Range { start: first, end } = place;
        Self { references: references.to_vec(), scalars, first, end: end.max(first) }
    }

    /// The place of the elements.
    pub fn place(&self) -> Range<usize> {
        self.first..self.end
    }
}

/// The variables of an instance that every step sets or gets, and the function that does it.
struct Access<V> {
    listed: Listed,
    function: Found<V>,
    /// The number of values in a list that is long enough; no list is if the function is looked up in each call, as
    /// in a WebAssembly component.
    needed: usize,
}

/// A function that was looked up before the steps.
enum Found<V> {
    Fmi2(Fmi2<V>),
    Fmi3(Fmi3<V>),
}

type Fmi2<V> = unsafe extern "C" fn(fmi2Component, *const u32, usize, V) -> fmi2Status;
type Fmi3<V> = unsafe extern "C" fn(fmi3Instance, *const u32, usize, V, usize) -> fmi3Status;

impl<V> Access<V> {
    const NOTHING: Self =
        Self { listed: Listed::NOTHING, function: Found::Fmi2(nothing), needed: 0 };

    fn new(listed: Listed, fmi2: Option<Fmi2<V>>, fmi3: Option<Fmi3<V>>) -> Self {
        let (function, needed) = match (fmi2, fmi3) {
            _ if listed.references.is_empty() => return Self::NOTHING,
            (Some(function), _) => (Found::Fmi2(function), listed.end),
            (_, Some(function)) => (Found::Fmi3(function), listed.end),
            _ => (Found::Fmi2(nothing), usize::MAX),
        };
        Self { listed, function, needed }
    }

    /// Calls the function with the elements, which begin where the pointer points.
    ///
    /// # Safety
    /// The function belongs to the instance, and the pointer is valid for the elements.
    #[inline(always)]
    unsafe fn call(&self, instance: fmi2Component, values: V) -> c_int {
        let Listed { references, scalars, .. } = &self.listed;
        // SAFETY: the standard gives the types; the caller's promise.
        unsafe {
            match self.function {
                Found::Fmi2(function) => {
                    function(instance, references.as_ptr(), *scalars, values).0
                }
                Found::Fmi3(function) => {
                    let (n, elements) = (references.len(), self.listed.place().len());
                    function(instance, references.as_ptr(), n, values, elements).0
                }
            }
        }
    }
}

/// What is called to access no variables.
unsafe extern "C" fn nothing<V>(_: fmi2Component, _: *const u32, _: usize, _: V) -> fmi2Status {
    fmi2OK
}

/// What every step of an instance accesses.
pub(crate) struct Quick {
    set: Access<*const f64>,
    get: Access<*mut f64>,
    do_step: Option<DoStep>,
}

type DoStep = unsafe extern "C" fn(fmi2Component, f64, f64, fmi2Boolean) -> fmi2Status;

impl Quick {
    pub(crate) const NOTHING: Self =
        Self { set: Access::NOTHING, get: Access::NOTHING, do_step: None };
}

impl Instance {
    /// Says which variables every step sets and gets.
    pub fn access_at_steps(&mut self, set: Listed, get: Listed) {
        let Library { fmi2, fmi3, .. } = &*self.library;
        self.quick = Quick {
            set: Access::new(set, fmi2.fmi2SetReal, fmi3.fmi3SetFloat64),
            get: Access::new(get, fmi2.fmi2GetReal, fmi3.fmi3GetFloat64),
            do_step: fmi2.fmi2DoStep,
        };
    }

    /// [`Instance::get_float64`] of the variables of [`access_at_steps`](Instance::access_at_steps).
    ///
    /// # Panics
    /// The list of values is too short.
    #[inline(always)]
    pub fn get_at_step(&mut self, values: &mut [f64]) -> Unusual {
        let access = &self.quick.get;
        if access.needed > values.len() {
            return self.get_slowly(values);
        }
        // SAFETY: the function is one of the library of this instance, which is not freed, and the pointer is
        // valid for the elements, by the check. The rest depends on the foreign binary, as described in the crate
        // documentation.
        let status =
            unsafe { access.call(self.pointer, values.as_mut_ptr().add(access.listed.first)) };
        self.unusual(&["fmi2GetReal", "fmi3GetFloat64"], status)
    }

    /// [`Instance::set_float64`] of the variables of [`access_at_steps`](Instance::access_at_steps).
    ///
    /// # Panics
    /// The list of values is too short.
    #[inline(always)]
    pub fn set_at_step(&mut self, values: &[f64]) -> Unusual {
        let access = &self.quick.set;
        if access.needed > values.len() {
            return self.set_slowly(values);
        }
        // SAFETY: as above.
        let status = unsafe { access.call(self.pointer, values.as_ptr().add(access.listed.first)) };
        self.unusual(&["fmi2SetReal", "fmi3SetFloat64"], status)
    }

    #[cold]
    #[inline(never)]
    fn get_slowly(&mut self, values: &mut [f64]) -> Unusual {
        let Listed { references, first, end, .. } = self.quick.get.listed.clone();
        slowly(self.get_float64(&references, &mut values[first..end]))
    }

    #[cold]
    #[inline(never)]
    fn set_slowly(&mut self, values: &[f64]) -> Unusual {
        let Listed { references, first, end, .. } = self.quick.set.listed.clone();
        slowly(self.set_float64(&references, &values[first..end]))
    }

    /// [`Instance::do_step`] for steps.
    #[inline(always)]
    pub fn do_step_quickly(&mut self, time: f64, step: f64) -> Unusual {
        match (self.quick.do_step, self.version) {
            (Some(do_step), _) => {
                // SAFETY: as above.
                let status =
                    unsafe { do_step(self.pointer, time, step, (!self.is_saved).into()).0 };
                self.unusual(&["fmi2DoStep"; 2], status)
            }
            (_, Version::Fmi3) => self.step_to_the_end(time, step),
            _ => Some(Box::new(self.do_step(time, step))),
        }
    }

    /// The names of the function in both versions are a reference, which no register or memory has to hold meanwhile.
    #[inline(always)]
    fn unusual(&self, functions: &'static [&'static str; 2], status: c_int) -> Unusual {
        match status {
            0 => None,
            _ => Some(self.boxed(functions, status)),
        }
    }

    #[cold]
    fn boxed(&self, functions: &'static [&'static str; 2], status: c_int) -> Box<Result> {
        Box::new(self.library.outcome(functions[self.version as usize], status))
    }
}
