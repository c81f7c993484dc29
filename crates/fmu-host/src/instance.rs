//! Instances, and the functions common to both kinds of FMU.

use std::ffi::{CString, c_void};
use std::ptr;
use std::sync::Arc;

use fmu_types::fmi2::{
    fmi2CallbackFunctions, fmi2CallbackLogger, fmi2Component, fmi2FMUstate, fmi2String,
};
use fmu_types::fmi3::fmi3Instance;

use crate::library::Strings;
use crate::logger::Registered;
use crate::{Cause, Failure, Library, Result, Success, Version};

/// Calls a function of FMI 2.0 of an instance that returns a status: `call!(self.fmi2DoStep(time))`.
macro_rules! call {
    ($instance:ident.$name:ident($($value:expr),* $(,)?)) => {
        $crate::instance::call_of!($instance, Fmi2, functions, $name($($value),*))
    };
}

/// As `call!`, for FMI 3.0.
macro_rules! call_3 {
    ($instance:ident.$name:ident($($value:expr),* $(,)?)) => {
        $crate::instance::call_of!($instance, Fmi3, functions_3, $name($($value),*))
    };
}

macro_rules! call_of {
    ($instance:ident, $version:ident, $functions:ident, $name:ident($($value:expr),*)) => {{
        const NAME: &str = stringify!($name);
        if $instance.version != $crate::Version::$version {
            return Err($crate::Failure::new(NAME, $crate::Cause::OtherVersion));
        }
        // SAFETY: the type is that of the standard, the instance is one of its version and not freed,
        // and every pointer is valid for the length passed with it. The rest depends on the foreign
        // binary, as described in the crate documentation.
        let status = unsafe {
            let library = &*$instance.library;
            let function = library.function(library.$functions().$name, NAME)?;
            function($instance.component $(, $value)*)
        };
        $instance.library.outcome($crate::Version::$version, NAME, status)
    }};
}

/// Calls a function that both versions have, without or with the same arguments.
macro_rules! call_either {
    ($instance:ident.$name_2:ident / $name_3:ident($($value:expr),* $(,)?)) => {
        match $instance.version {
            $crate::Version::Fmi2 => $crate::instance::call!($instance.$name_2($($value),*)),
            $crate::Version::Fmi3 => $crate::instance::call_3!($instance.$name_3($($value),*)),
        }
    };
}
pub(crate) use {call, call_3, call_either, call_of};

/// An instance of an FMU, which is freed on drop. It keeps its library loaded.
pub struct Instance {
    pub(crate) library: Arc<Library>,
    /// What the version of FMI calls a component or an instance.
    pub(crate) component: fmi2Component,
    pub(crate) version: Version,
    /// The FMU keeps a pointer to them. Allocated as a box, and freed with the instance. FMI 3.0 has none.
    callbacks: Option<*mut fmi2CallbackFunctions>,
    /// The arguments of [`Instance::setup_experiment`], which FMI 3.0 passes with the next call.
    experiment: Experiment,
    /// The strings of the instantiation, to which some FMUs keep pointers although they must not.
    strings: [Vec<u8>; 3],
    _registered: Registered,
}

// SAFETY: FMI allows any thread to call the functions of an instance, but not concurrently, which
// `&mut self` ensures.
unsafe impl Send for Instance {}

/// Start and stop time (s), and the relative tolerance.
type Experiment = (f64, Option<f64>, Option<f64>);

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
    pub(crate) unsafe fn of_fmi_2(
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
            version: Version::Fmi2,
            callbacks: Some(callbacks),
            experiment: Experiment::default(),
            strings: Default::default(),
            _registered: registered,
        })
    }

    /// An instance of FMI 3.0; `None` if it is NULL.
    pub(crate) fn of_fmi_3(
        library: &Arc<Library>,
        registered: Registered,
        instance: fmi3Instance,
    ) -> Option<Self> {
        (!instance.is_null()).then(|| Self {
            library: Arc::clone(library),
            component: instance,
            version: Version::Fmi3,
            callbacks: None,
            experiment: Experiment::default(),
            strings: Default::default(),
            _registered: registered,
        })
    }

    /// Keeps the strings of the instantiation until the instance is freed.
    pub(crate) fn keeping(mut self, strings: Strings) -> Self {
        self.strings = strings.kept();
        self
    }

    /// Its version of FMI.
    pub fn version(&self) -> Version {
        self.version
    }

    /// `fmi2SetDebugLogging`, `fmi3SetDebugLogging`
    pub fn set_debug_logging(&mut self, on: bool, categories: &[CString]) -> Result {
        let names: Vec<fmi2String> = categories.iter().map(|name| name.as_ptr()).collect();
        let (count, names) = (names.len(), names.as_ptr());
        call_either!(self.fmi2SetDebugLogging / fmi3SetDebugLogging(on.into(), count, names))
    }

    /// `fmi2SetupExperiment`: start and stop time in s, and the relative tolerance. FMI 3.0 passes them
    /// when [`Instance::enter_initialization_mode`] is called.
    ///
    /// # Errors
    /// As for every call: the function is missing or returned a failure status.
    pub fn setup_experiment(
        &mut self,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Result {
        if self.version == Version::Fmi3 {
            self.experiment = (start, stop, tolerance);
            return Ok(Success::Ok);
        }
        call!(self.fmi2SetupExperiment(
            tolerance.is_some().into(),
            tolerance.unwrap_or_default(),
            start,
            stop.is_some().into(),
            stop.unwrap_or_default(),
        ))
    }

    /// `fmi2EnterInitializationMode`, `fmi3EnterInitializationMode`
    pub fn enter_initialization_mode(&mut self) -> Result {
        let (start, stop, tolerance) = self.experiment;
        match self.version {
            Version::Fmi2 => call!(self.fmi2EnterInitializationMode()),
            Version::Fmi3 => call_3!(self.fmi3EnterInitializationMode(
                tolerance.is_some().into(),
                tolerance.unwrap_or_default(),
                start,
                stop.is_some().into(),
                stop.unwrap_or_default(),
            )),
        }
    }

    /// `fmi2ExitInitializationMode`, `fmi3ExitInitializationMode`
    pub fn exit_initialization_mode(&mut self) -> Result {
        call_either!(self.fmi2ExitInitializationMode / fmi3ExitInitializationMode())
    }

    /// `fmi2Terminate`, `fmi3Terminate`
    pub fn terminate(&mut self) -> Result {
        call_either!(self.fmi2Terminate / fmi3Terminate())
    }

    /// `fmi2Reset`, `fmi3Reset`
    pub fn reset(&mut self) -> Result {
        call_either!(self.fmi2Reset / fmi3Reset())
    }

    /// `fmi3EnterConfigurationMode`
    pub fn enter_configuration_mode(&mut self) -> Result {
        call_3!(self.fmi3EnterConfigurationMode())
    }

    /// `fmi3ExitConfigurationMode`
    pub fn exit_configuration_mode(&mut self) -> Result {
        call_3!(self.fmi3ExitConfigurationMode())
    }

    /// `fmi2GetFMUstate`, `fmi3GetFMUState`
    pub fn state(&mut self) -> Result<State> {
        let mut state = State(ptr::null_mut());
        self.save_to(&mut state)?;
        if state.0.is_null() {
            let cause = Cause::Broke("returned success and no state");
            return Err(Failure::new(
                self.either("fmi2GetFMUstate", "fmi3GetFMUState"),
                cause,
            ));
        }
        Ok(state)
    }

    /// `fmi2GetFMUstate`, `fmi3GetFMUState` with a state that is overwritten.
    pub fn save_to(&mut self, state: &mut State) -> Result {
        call_either!(self.fmi2GetFMUstate / fmi3GetFMUState(&raw mut state.0))
    }

    /// `fmi2SetFMUstate`, `fmi3SetFMUState`
    pub fn set_state(&mut self, state: &State) -> Result {
        call_either!(self.fmi2SetFMUstate / fmi3SetFMUState(state.0))
    }

    /// `fmi2FreeFMUstate`, `fmi3FreeFMUState`
    pub fn free_state(&mut self, mut state: State) -> Result {
        let freed = call_either!(self.fmi2FreeFMUstate / fmi3FreeFMUState(&raw mut state.0))?;
        if state.0.is_null() {
            Ok(freed)
        } else {
            let cause = Cause::Broke("did not set the state to NULL");
            Err(Failure::new(
                self.either("fmi2FreeFMUstate", "fmi3FreeFMUState"),
                cause,
            ))
        }
    }

    /// `fmi2FreeFMUstate`, `fmi3FreeFMUState` with a pointer to NULL, which does nothing by the standard.
    pub fn free_null_state(&mut self) -> Result {
        self.free_state(State(ptr::null_mut()))
    }

    /// `fmi2SerializedFMUstateSize` and `fmi2SerializeFMUstate`, `fmi3SerializedFMUStateSize` and
    /// `fmi3SerializeFMUState`; an error if there are more than `max` bytes.
    pub fn serialize(&mut self, state: &State, max: usize) -> Result<Vec<u8>> {
        let mut size = 0;
        call_either!(
            self.fmi2SerializedFMUstateSize / fmi3SerializedFMUStateSize(state.0, &raw mut size)
        )?;
        if size > max {
            let function = self.either("fmi2SerializedFMUstateSize", "fmi3SerializedFMUStateSize");
            return Err(Failure::new(function, Cause::TooLarge(size)));
        }
        // An FMU that writes more than it announced damages these bytes only.
        const GUARD: [u8; 64] = [0xa5; 64];
        let mut bytes = vec![0_u8; size];
        bytes.extend_from_slice(&GUARD);
        call_either!(
            self.fmi2SerializeFMUstate
                / fmi3SerializeFMUState(state.0, bytes.as_mut_ptr().cast(), size)
        )?;
        if bytes[size..] != GUARD {
            let function = self.either("fmi2SerializeFMUstate", "fmi3SerializeFMUState");
            let cause = Cause::Broke("wrote more bytes than the size that it returned before");
            return Err(Failure::new(function, cause));
        }
        bytes.truncate(size);
        Ok(bytes)
    }

    /// `fmi2DeSerializeFMUstate`, `fmi3DeserializeFMUState`
    pub fn deserialize(&mut self, bytes: &[u8]) -> Result<State> {
        let mut state = State(ptr::null_mut());
        let (size, bytes) = (bytes.len(), bytes.as_ptr());
        call_either!(
            self.fmi2DeSerializeFMUstate
                / fmi3DeserializeFMUState(bytes.cast(), size, &raw mut state.0)
        )?;
        Ok(state)
    }

    /// The name of a function in the version of the instance.
    pub(crate) fn either(&self, name_2: &'static str, name_3: &'static str) -> &'static str {
        match self.version {
            Version::Fmi2 => name_2,
            Version::Fmi3 => name_3,
        }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.library.is_lost() {
            // No code of the FMU may run, including its destructors, so it is never unloaded.
            std::mem::forget(Arc::clone(&self.library));
            return;
        }
        if let Ok(free) = self.library.free_function(self.version) {
            // SAFETY: the instance is not used again; the callbacks are from a box, and the FMU does not
            // use them after this call.
            unsafe {
                free(self.component);
                if let Some(callbacks) = self.callbacks {
                    drop(Box::from_raw(callbacks));
                }
            }
        }
    }
}
