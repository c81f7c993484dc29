//! The three calls of every step, without a [`Result`] in the usual case: the compiler keeps nothing of it but a
//! comparison.

use std::ffi::c_int;
use std::ops::Range;

use fmi_abi::Version;

use crate::instance::Instance;
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
    /// The variables of these value references, whose elements are at this place.
    pub fn new(references: &[u32], place: Range<usize>) -> Self {
        let scalars = references.len().min(place.len());
        let Range { start: first, end } = place;
        Self { references: references.to_vec(), scalars, first, end: end.max(first) }
    }

    /// The value references.
    pub fn references(&self) -> &[u32] {
        &self.references
    }

    /// The place of the elements.
    pub fn place(&self) -> Range<usize> {
        self.first..self.end
    }

    /// A shorter list than expected.
    #[cold]
    fn too_short(&self, count: usize) -> ! {
        panic!("a list has {count} values, expected {}", self.end);
    }
}

impl Instance {
    /// [`Instance::get_float64`] for steps.
    ///
    /// # Panics
    /// The list of values is too short.
    #[inline(always)]
    pub fn get_float64_quickly(&mut self, listed: &Listed, values: &mut [f64]) -> Unusual {
        if listed.end > values.len() {
            listed.too_short(values.len());
        }
        let (library, instance) = (&*self.library, self.pointer);
        let (from, n, elements) = (listed.references.as_ptr(), listed.scalars, listed.place());
        // SAFETY: the standard gives the types, the instance is not freed, and every pointer is valid for the
        // length passed with it: `first <= end`, which was compared with the length of the list. The rest depends on
        // the foreign binary, as described in the crate documentation.
        let status = unsafe {
            let to = values.as_mut_ptr().add(listed.first);
            match (library.fmi2.fmi2GetReal, library.fmi3.fmi3GetFloat64) {
                (Some(get), _) => get(instance, from, n, to).0,
                (_, Some(get)) => {
                    get(instance, from, listed.references.len(), to, elements.len()).0
                }
                _ => return slowly(self.get_float64(&listed.references, &mut values[elements])),
            }
        };
        self.unusual(&["fmi2GetReal", "fmi3GetFloat64"], status)
    }

    /// [`Instance::set_float64`] for steps.
    ///
    /// # Panics
    /// The list of values is too short.
    #[inline(always)]
    pub fn set_float64_quickly(&mut self, listed: &Listed, values: &[f64]) -> Unusual {
        if listed.end > values.len() {
            listed.too_short(values.len());
        }
        let (library, instance) = (&*self.library, self.pointer);
        let (to, n, elements) = (listed.references.as_ptr(), listed.scalars, listed.place());
        // SAFETY: as above.
        let status = unsafe {
            let from = values.as_ptr().add(listed.first);
            match (library.fmi2.fmi2SetReal, library.fmi3.fmi3SetFloat64) {
                (Some(set), _) => set(instance, to, n, from).0,
                (_, Some(set)) => {
                    set(instance, to, listed.references.len(), from, elements.len()).0
                }
                _ => return slowly(self.set_float64(&listed.references, &values[elements])),
            }
        };
        self.unusual(&["fmi2SetReal", "fmi3SetFloat64"], status)
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
