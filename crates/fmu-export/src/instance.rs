//! What a host's pointer points to: a table of functions, and the component.

use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::Model;
use crate::bound::Bound;
use crate::component::{Component, Outcome};
use crate::phase::{Call, Phase};
use crate::slave::Slave;

/// An instance of a model. The table of functions `F` comes first, so that it can be found without
/// knowing the model.
#[repr(C)]
pub(crate) struct Instance<F: Functions, M, const N: usize> {
    functions: &'static F,
    options: F::Options,
    pub(crate) component: Component<Bound<M, N>>,
}

/// Functions that depend on the model and are the same in all versions of FMI. The argument is the
/// host's pointer to an instance of this model, which is not used concurrently.
pub(crate) struct Common {
    /// The component.
    pub(crate) component: unsafe fn(*mut c_void) -> *mut Component,
    /// Frees the instance.
    pub(crate) free: unsafe fn(*mut c_void),
}

/// A table of functions that includes the common ones.
pub(crate) trait Functions: 'static {
    /// What the host has said about the instance.
    type Options;

    fn common(&self) -> &Common;
}

/// The functions of the instance behind the host's pointer; `None` for NULL.
///
/// # Safety
/// `instance` is NULL or came from [`Instance::create`] with this type of functions, and is not freed.
#[inline(always)]
pub(crate) unsafe fn functions<F>(instance: *mut c_void) -> Option<&'static F> {
    // SAFETY: every instance begins with a pointer to its functions.
    unsafe { instance.cast::<&'static F>().as_ref().copied() }
}

/// The component behind the host's pointer; `None` for NULL.
///
/// # Safety
/// As [`functions`], and the instance is not used otherwise during the lifetime of the component.
#[inline(always)]
pub(crate) unsafe fn component<'a, F: Functions>(
    instance: *mut c_void,
) -> Option<&'a mut Component> {
    // SAFETY: the caller's promise; the functions are those of the instance.
    unsafe { functions::<F>(instance).map(|f| &mut *(f.common().component)(instance)) }
}

impl<F: Functions, M: Model, const N: usize> Instance<F, M, N> {
    pub(crate) const COMMON: Common = Common {
        component: Self::component,
        free: Self::free,
    };

    /// Moves a component to the heap and returns the host's pointer to it.
    pub(crate) fn create(
        functions: &'static F,
        options: F::Options,
        component: Component<Bound<M, N>>,
    ) -> *mut c_void {
        Box::into_raw(Box::new(Self {
            functions,
            options,
            component,
        }))
        .cast()
    }

    /// # Safety
    /// The pointer is that of an instance of this type, which is not used otherwise.
    #[inline(always)]
    pub(crate) unsafe fn of<'a>(instance: *mut c_void) -> &'a mut Component<Bound<M, N>> {
        // SAFETY: the caller's promise.
        unsafe { &mut (*instance.cast::<Self>()).component }
    }

    /// What the host has said about the instance.
    ///
    /// # Safety
    /// As [`of`](Self::of), but the component may be in use.
    pub(crate) unsafe fn options(instance: *mut c_void) -> *const F::Options {
        // SAFETY: the caller's promise.
        unsafe { &raw const (*instance.cast::<Self>()).options }
    }

    /// # Safety
    /// As [`of`](Self::of).
    unsafe fn component(instance: *mut c_void) -> *mut Component {
        // SAFETY: the caller's promise.
        unsafe { Self::of(instance) }
    }

    /// # Safety
    /// As [`of`](Self::of), and the pointer is not used again.
    unsafe fn free(instance: *mut c_void) {
        // SAFETY: `create` made the pointer from a box.
        drop(unsafe { Box::from_raw(instance.cast::<Self>()) });
    }
}

impl<M: Model, const N: usize> Component<Bound<M, N>> {
    /// The component without its type.
    pub(crate) fn shared(&mut self) -> &mut Component {
        self
    }

    /// Whether a get or set may take the fast path: between steps, with arrays that are not NULL.
    #[inline(always)]
    pub(crate) fn is_fast<V>(&self, references: *const u32, values: *const V) -> bool {
        self.lifecycle.phase == Phase::StepComplete && !references.is_null() && !values.is_null()
    }

    /// Takes a step, checked quickly if it is a regular one.
    #[inline(always)]
    pub(crate) fn take_step(&mut self, call: &'static Call, time: f64, step: f64) -> Outcome {
        if !self.lifecycle.is_next_step(time, step)
            && let Some(outcome) = self.shared().refuse_step(call, time, step)
        {
            return outcome;
        }
        let taken = catch_unwind(AssertUnwindSafe(|| {
            self.slave.step(time, step)?;
            if Bound::<M, N>::HAS_INPUT_DERIVATIVES && self.lifecycle.has_input_derivatives {
                self.slave.clear_input_derivatives();
                self.lifecycle.has_input_derivatives = false;
            }
            Ok(())
        }));
        match taken {
            Ok(Ok(())) => {
                self.lifecycle.time = time + step;
                Outcome::Ok
            }
            Ok(Err(error)) => self.shared().fail_step(call, error, time, step),
            Err(panic) => self.shared().fail_by_panic(call.name, panic),
        }
    }
}
