//! The three calls of every step, without a [`Result`] in the usual case: the compiler keeps nothing of it but a
//! comparison.

use std::ffi::c_int;
use std::ops::Range;

use fmi_abi::Version;
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
}

/// What every step of an instance accesses.
pub(crate) struct Quick {
    set: Access<*const f64>,
    get: Access<*mut f64>,
}

impl Quick {
    pub(crate) const NOTHING: Self = Self { set: Access::NOTHING, get: Access::NOTHING };
}

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
            let Access { listed, fmi2, fmi3 } = &self.quick.$access;
            let (references, instance) = (&listed.references, self.pointer);
            if listed.place.end > values.len() {
                return slow(self, values);
            }
            // SAFETY: the standard gives the types, the functions are those of the library of this instance, which is
            // not freed, and every pointer is valid for the length passed with it, by the check. The rest depends on
            // the foreign binary, as described in the crate documentation.
            let status = unsafe {
                let (first, to) = (references.as_ptr(), values.$pointer().add(listed.place.start));
                match (fmi2, fmi3) {
                    (Some(call), _) => call(instance, first, listed.scalars, to).0,
                    (_, Some(call)) => call(instance, first, references.len(), to, listed.place.len()).0,
                    _ => return slow(self, values),
                }
            };
            self.unusual(&$functions, status)
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
        self.quick = Quick {
            set: Access::new(set, fmi2.fmi2SetReal, fmi3.fmi3SetFloat64),
            get: Access::new(get, fmi2.fmi2GetReal, fmi3.fmi3GetFloat64),
        };
    }

    access! {
        set_at_step(&[f64] as as_ptr) = set by set_float64, ["fmi2SetReal", "fmi3SetFloat64"];
        get_at_step(&mut [f64] as as_mut_ptr) = get by get_float64, ["fmi2GetReal", "fmi3GetFloat64"];
    }

    /// [`Instance::do_step`] for steps.
    #[inline(always)]
    pub fn do_step_quickly(&mut self, time: f64, step: f64) -> Unusual {
        match (self.library.fmi2.fmi2DoStep, self.version) {
            (Some(do_step), _) => {
                // SAFETY: as above.
                let status =
                    unsafe { do_step(self.pointer, time, step, (!self.is_saved).into()).0 };
                self.unusual(&["fmi2DoStep"; 2], status)
            }
            (_, Version::Fmi3) => self.step_to_the_end(time, step),
            _ => {
                let no_set_state = !self.is_saved;
                slowly(Fmi2Instance(self).do_step(time, step, no_set_state))
            }
        }
    }

    /// Whether [`Instance::cycle`] is possible: in components of `fmu-export`, unless calls are traced.
    pub fn has_cycle(&self) -> bool {
        #[cfg(feature = "sandbox")]
        let has = self.component.as_ref().is_some_and(|component| component.has_cycle());
        #[cfg(not(feature = "sandbox"))]
        let has = false;
        has && !self.library.is_traced()
    }

    /// Makes the calls of a step in one, with inputs in a list of their own or that of the outputs: sets variables, takes
    /// the step and gets variables, until one is not plainly successful. Returns how many were made, and the result of
    /// the last one.
    #[cfg_attr(not(feature = "sandbox"), expect(unused_variables, reason = "no instance has it"))]
    pub fn cycle(
        &mut self,
        inputs: Option<&[f64]>,
        time: f64,
        step: f64,
        outputs: &mut [f64],
    ) -> (usize, Unusual) {
        #[cfg(feature = "sandbox")]
        if let Some(component) = &mut self.component {
            let how = (time, step, !self.is_saved);
            if let Some((calls, status, stepped)) = component.cycle(inputs, how, outputs) {
                let function = ["fmi3SetFloat64", "fmi3DoStep", "fmi3GetFloat64"][calls - 1];
                let unusual = match self.library.outcome(function, status.0) {
                    Ok(done) if calls == 2 => crate::instance::at_the_end(done, stepped),
                    other => slowly(other),
                };
                return (calls, unusual);
            }
        }
        (0, None)
    }

    /// The names are passed as one static reference, so that nothing must be kept across the call.
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
