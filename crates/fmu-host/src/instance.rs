//! Instances, and the functions common to both kinds of FMU.

use std::ffi::{CString, c_void};
use std::ptr;
use std::sync::Arc;

use fmu_types::fmi2::{
    fmi2Boolean, fmi2CallbackFunctions, fmi2CallbackLogger, fmi2Component, fmi2FMUstate,
    fmi2Integer, fmi2Real, fmi2String,
};

use crate::logger::{Registered, text};
use crate::{Cause, Failure, Library, Result};

/// Calls a function of an instance that returns a status: `call!(self.fmi2DoStep(time))`.
macro_rules! call {
    ($instance:ident.$name:ident($($value:expr),* $(,)?)) => {{
        const NAME: &str = stringify!($name);
        // SAFETY: the type is that of the standard, the instance is not freed, and every pointer is
        // valid for the length passed with it. The rest depends on the foreign binary, as described
        // in the crate documentation.
        let status = unsafe {
            let library = &*$instance.library;
            let function = library.function(library.functions().$name, NAME)?;
            function($instance.component $(, $value)*)
        };
        $instance.library.outcome(NAME, status)
    }};
}
pub(crate) use call;

/// An instance of an FMU, which is freed on drop. It keeps its library loaded.
pub struct Instance {
    pub(crate) library: Arc<Library>,
    pub(crate) component: fmi2Component,
    /// The FMU keeps a pointer to them. Allocated as a box, and freed with the instance.
    callbacks: *mut fmi2CallbackFunctions,
    /// The strings of `fmi2Instantiate`, to which some FMUs keep pointers although they must not.
    strings: [Vec<u8>; 3],
    _registered: Registered,
}

// SAFETY: FMI allows any thread to call the functions of an instance, but not concurrently, which
// `&mut self` ensures.
unsafe impl Send for Instance {}

/// A saved FMU state, to be freed with [`Instance::free_state`].
pub struct State(fmi2FMUstate);

unsafe extern "C" {
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(memory: *mut c_void);
}

impl Instance {
    /// Instantiates with a closure that receives the callbacks; `None` if it returns NULL.
    ///
    /// # Safety
    /// The closure calls the library's `fmi2Instantiate`.
    pub(crate) unsafe fn new(
        library: &Arc<Library>,
        registered: Registered,
        logger: Option<fmi2CallbackLogger>,
        instantiate: impl FnOnce(*const fmi2CallbackFunctions) -> fmi2Component,
    ) -> Option<Self> {
        let callbacks = Box::into_raw(Box::new(fmi2CallbackFunctions {
            logger,
            allocateMemory: Some(calloc),
            freeMemory: Some(free),
            stepFinished: None,
            componentEnvironment: registered.environment(),
        }));
        let component = instantiate(callbacks);
        if component.is_null() {
            // SAFETY: the pointer is from a box, and there is no instance that could use it.
            drop(unsafe { Box::from_raw(callbacks) });
            return None;
        }
        Some(Self {
            library: Arc::clone(library),
            component,
            callbacks,
            strings: Default::default(),
            _registered: registered,
        })
    }

    /// Keeps the strings of `fmi2Instantiate` until the instance is freed.
    pub(crate) fn keeping(mut self, strings: [Vec<u8>; 3]) -> Self {
        self.strings = strings;
        self
    }

    /// `fmi2SetDebugLogging`
    pub fn set_debug_logging(&mut self, on: bool, categories: &[CString]) -> Result {
        let names: Vec<fmi2String> = categories.iter().map(|name| name.as_ptr()).collect();
        call!(self.fmi2SetDebugLogging(on.into(), names.len(), names.as_ptr()))
    }

    /// `fmi2SetupExperiment`: start and stop time in s, and the relative tolerance.
    ///
    /// # Errors
    /// As for every call: the function is missing or returned a failure status.
    pub fn setup_experiment(
        &mut self,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Result {
        call!(self.fmi2SetupExperiment(
            tolerance.is_some().into(),
            tolerance.unwrap_or_default(),
            start,
            stop.is_some().into(),
            stop.unwrap_or_default(),
        ))
    }

    /// `fmi2EnterInitializationMode`
    pub fn enter_initialization_mode(&mut self) -> Result {
        call!(self.fmi2EnterInitializationMode())
    }

    /// `fmi2ExitInitializationMode`
    pub fn exit_initialization_mode(&mut self) -> Result {
        call!(self.fmi2ExitInitializationMode())
    }

    /// `fmi2Terminate`
    pub fn terminate(&mut self) -> Result {
        call!(self.fmi2Terminate())
    }

    /// `fmi2Reset`
    pub fn reset(&mut self) -> Result {
        call!(self.fmi2Reset())
    }

    /// `fmi2GetString`
    pub fn get_string(&mut self, references: &[u32]) -> Result<Vec<String>> {
        let texts = self.get_string_late(references, || ())?;
        let texts: Option<_> = texts.into_iter().collect();
        texts.ok_or_else(|| {
            Failure::new("fmi2GetString", Cause::Broke("returned NULL for a string"))
        })
    }

    /// `fmi2GetString`, whose strings are copied only after `between` was called, which is not to call
    /// functions of this instance.
    pub fn get_string_late(
        &mut self,
        references: &[u32],
        between: impl FnOnce(),
    ) -> Result<Vec<Option<String>>> {
        let mut values: Vec<fmi2String> = vec![ptr::null(); references.len()];
        call!(self.fmi2GetString(references.as_ptr(), references.len(), values.as_mut_ptr()))?;
        between();
        // SAFETY: by the standard, the FMU's strings are valid until its next call.
        let texts = values.into_iter().map(|value| unsafe { text(value) });
        Ok(texts.collect())
    }

    /// `fmi2GetReal` and `fmi2SetReal` of no variables, with NULL for both arrays.
    pub fn get_and_set_nothing(&mut self) -> Result {
        call!(self.fmi2GetReal(ptr::null(), 0, ptr::null_mut()))?;
        call!(self.fmi2SetReal(ptr::null(), 0, ptr::null()))
    }

    /// `fmi2SetString`
    pub fn set_string(&mut self, references: &[u32], values: &[CString]) -> Result {
        let values: Vec<fmi2String> = values.iter().map(|value| value.as_ptr()).collect();
        let n = references.len().min(values.len());
        call!(self.fmi2SetString(references.as_ptr(), n, values.as_ptr()))
    }

    /// `fmi2GetFMUstate`
    pub fn state(&mut self) -> Result<State> {
        let mut state = State(ptr::null_mut());
        call!(self.fmi2GetFMUstate(&raw mut state.0))?;
        if state.0.is_null() {
            let cause = Cause::Broke("returned fmi2OK and no state");
            return Err(Failure::new("fmi2GetFMUstate", cause));
        }
        Ok(state)
    }

    /// `fmi2GetFMUstate` with a state that is overwritten.
    pub fn save_to(&mut self, state: &mut State) -> Result {
        call!(self.fmi2GetFMUstate(&raw mut state.0))
    }

    /// `fmi2SetFMUstate`
    pub fn set_state(&mut self, state: &State) -> Result {
        call!(self.fmi2SetFMUstate(state.0))
    }

    /// `fmi2FreeFMUstate`
    pub fn free_state(&mut self, mut state: State) -> Result {
        let freed = call!(self.fmi2FreeFMUstate(&raw mut state.0))?;
        if state.0.is_null() {
            Ok(freed)
        } else {
            let cause = Cause::Broke("did not set the state to NULL");
            Err(Failure::new("fmi2FreeFMUstate", cause))
        }
    }

    /// `fmi2FreeFMUstate` with a pointer to NULL, which does nothing by the standard.
    pub fn free_null_state(&mut self) -> Result {
        self.free_state(State(ptr::null_mut()))
    }

    /// `fmi2SerializedFMUstateSize` and `fmi2SerializeFMUstate`; an error if there are more than `max`
    /// bytes.
    pub fn serialize(&mut self, state: &State, max: usize) -> Result<Vec<u8>> {
        let mut size = 0;
        call!(self.fmi2SerializedFMUstateSize(state.0, &raw mut size))?;
        if size > max {
            let cause = Cause::TooLarge(size);
            return Err(Failure::new("fmi2SerializedFMUstateSize", cause));
        }
        // An FMU that writes more than it announced damages these bytes only.
        const GUARD: [u8; 64] = [0xa5; 64];
        let mut bytes = vec![0_u8; size];
        bytes.extend_from_slice(&GUARD);
        call!(self.fmi2SerializeFMUstate(state.0, bytes.as_mut_ptr().cast(), size))?;
        if bytes[size..] != GUARD {
            let cause = Cause::Broke("wrote more bytes than fmi2SerializedFMUstateSize returned");
            return Err(Failure::new("fmi2SerializeFMUstate", cause));
        }
        bytes.truncate(size);
        Ok(bytes)
    }

    /// `fmi2DeSerializeFMUstate`
    pub fn deserialize(&mut self, bytes: &[u8]) -> Result<State> {
        let mut state = State(ptr::null_mut());
        call!(self.fmi2DeSerializeFMUstate(bytes.as_ptr().cast(), bytes.len(), &raw mut state.0,))?;
        Ok(state)
    }

    /// `fmi2GetDirectionalDerivative` of `unknowns` with respect to `knowns` in the direction `seed`.
    pub fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
    ) -> Result<Vec<f64>> {
        let mut values = vec![0.0; unknowns.len()];
        call!(self.fmi2GetDirectionalDerivative(
            unknowns.as_ptr(),
            unknowns.len(),
            knowns.as_ptr(),
            knowns.len().min(seed.len()),
            seed.as_ptr(),
            values.as_mut_ptr(),
        ))?;
        Ok(values)
    }
}

/// Defines functions that read and write values of one type. If the slices differ in length, the rest
/// of the longer one is ignored.
macro_rules! access {
    ($($type:ty: $get:ident $fmi_get:ident $set:ident $fmi_set:ident;)*) => {
        impl Instance {
            $(
                #[doc = concat!("`", stringify!($fmi_get), "`")]
                #[inline]
                pub fn $get(&mut self, references: &[u32], values: &mut [$type]) -> Result {
                    let n = references.len().min(values.len());
                    call!(self.$fmi_get(references.as_ptr(), n, values.as_mut_ptr()))
                }

                #[doc = concat!("`", stringify!($fmi_set), "`")]
                #[inline]
                pub fn $set(&mut self, references: &[u32], values: &[$type]) -> Result {
                    let n = references.len().min(values.len());
                    call!(self.$fmi_set(references.as_ptr(), n, values.as_ptr()))
                }
            )*
        }
    };
}

access! {
    fmi2Real: get_real fmi2GetReal set_real fmi2SetReal;
    fmi2Integer: get_integer fmi2GetInteger set_integer fmi2SetInteger;
    // An integer, as a foreign FMU may return values other than 0 and 1.
    fmi2Boolean: get_boolean fmi2GetBoolean set_boolean fmi2SetBoolean;
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.library.is_lost() {
            // No code of the FMU may run, including its destructors, so it is never unloaded.
            std::mem::forget(Arc::clone(&self.library));
            return;
        }
        // SAFETY: the type is that of the standard, and the instance is not used again; the callbacks
        // are from a box, and the FMU does not use them after this call.
        unsafe {
            let found = self.library.functions().fmi2FreeInstance;
            if let Ok(free) = self.library.function(found, "fmi2FreeInstance") {
                free(self.component);
                drop(Box::from_raw(self.callbacks));
            }
        }
    }
}
