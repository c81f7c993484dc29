//! The three calls of every step, without a [`Result`] in the usual case: the compiler keeps nothing of it but a
//! comparison.

use std::ffi::c_int;

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

impl Instance {
    /// [`Instance::get_float64`] for steps.
    #[inline(always)]
    pub fn get_float64_quickly(&mut self, references: &[u32], values: &mut [f64]) -> Unusual {
        let (library, instance) = (&*self.library, self.pointer);
        let (from, n) = (references.as_ptr(), references.len());
        let (to, count) = (values.as_mut_ptr(), values.len());
        // SAFETY: the standard gives the types, the instance is not freed, and every pointer is valid for the
        // length passed with it. The rest depends on the foreign binary, as described in the crate documentation.
        let status = unsafe {
            match (library.fmi2.fmi2GetReal, library.fmi3.fmi3GetFloat64) {
                (Some(get), _) => get(instance, from, n.min(count), to).0,
                (_, Some(get)) => get(instance, from, n, to, count).0,
                _ => return slowly(self.get_float64(references, values)),
            }
        };
        self.unusual(&["fmi2GetReal", "fmi3GetFloat64"], status)
    }

    /// [`Instance::set_float64`] for steps.
    #[inline(always)]
    pub fn set_float64_quickly(&mut self, references: &[u32], values: &[f64]) -> Unusual {
        let (library, instance) = (&*self.library, self.pointer);
        let (to, n) = (references.as_ptr(), references.len());
        let (from, count) = (values.as_ptr(), values.len());
        // SAFETY: as above.
        let status = unsafe {
            match (library.fmi2.fmi2SetReal, library.fmi3.fmi3SetFloat64) {
                (Some(set), _) => set(instance, to, n.min(count), from).0,
                (_, Some(set)) => set(instance, to, n, from, count).0,
                _ => return slowly(self.set_float64(references, values)),
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
