//! The variables that every step of an instance accesses, and the functions for them, looked up once.

use std::ffi::c_int;
use std::ops::Range;

use fmi_abi::fmi2::{fmi2Component, fmi2Status};
use fmi_abi::fmi3::{fmi3Instance, fmi3Status};

use crate::outcome::Result;

/// The result of a call, unless it is plain success: a warning or a failure.
pub type NotOk = Option<Box<Result>>;

/// Variables of the type Float64 that are accessed at every step, and the place of their values in a longer list.
#[derive(Debug, Clone)]
pub struct StepVariables {
    pub(crate) references: Vec<u32>,
    /// The number of variables that have an element each, as all do in FMI 2.0.
    scalars: usize,
    pub(crate) place: Range<usize>,
}

impl StepVariables {
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
pub(crate) struct Access<V> {
    pub(crate) listed: StepVariables,
    fmi2: Option<AccessFmi2<V>>,
    fmi3: Option<AccessFmi3<V>>,
}

pub(crate) type AccessFmi2<V> =
    unsafe extern "C" fn(fmi2Component, *const u32, usize, V) -> fmi2Status;
pub(crate) type AccessFmi3<V> =
    unsafe extern "C" fn(fmi3Instance, *const u32, usize, V, usize) -> fmi3Status;

impl<V> Access<V> {
    const NOTHING: Self = Self { listed: StepVariables::NOTHING, fmi2: None, fmi3: None };

    pub(crate) fn new(
        listed: StepVariables,
        fmi2: Option<AccessFmi2<V>>,
        fmi3: Option<AccessFmi3<V>>,
    ) -> Self {
        match listed.references[..] {
            [] => Self::NOTHING,
            _ => Self { listed, fmi2, fmi3 },
        }
    }

    /// The end of the values in their list; `usize::MAX` if the function is not known.
    pub(crate) fn end(&self) -> usize {
        let is_known = self.is_nothing() || self.fmi2.is_some() || self.fmi3.is_some();
        if is_known { self.listed.place.end } else { usize::MAX }
    }

    /// Whether there is nothing to access.
    #[inline(always)]
    pub(crate) fn is_nothing(&self) -> bool {
        self.listed.references.is_empty()
    }

    /// Calls the function, if it is known, and returns the status.
    ///
    /// # Safety
    /// The function is one of the library of this instance, and the pointer is valid for the values that are listed.
    #[inline(always)]
    pub(crate) unsafe fn call(&self, instance: fmi2Component, values: V) -> Option<c_int> {
        let StepVariables { references, scalars, place } = &self.listed;
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

/// The variables that every step of an instance accesses.
pub(crate) struct Quick {
    pub(crate) set: Access<*const f64>,
    pub(crate) get: Access<*mut f64>,
    /// The number of values in a list of both inputs and outputs; `usize::MAX` if a function is not known.
    pub(crate) values: usize,
}

impl Quick {
    pub(crate) const NOTHING: Self =
        Self { set: Access::NOTHING, get: Access::NOTHING, values: usize::MAX };
}
