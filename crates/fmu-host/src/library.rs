//! A loaded library, and the functions that need no instance.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::Path;

use libloading::Symbol;

use super::{Failure, Instance, Kind, Result};
use fmu_types::fmi2::{
    fmi2Boolean, fmi2CallbackFunctions, fmi2CallbackLogger, fmi2Component,
    fmi2ComponentEnvironment, fmi2False, fmi2String,
};

/// Functions of both kinds of FMU (FMI 2.0.4, section 2.1).
const COMMON: [&str; 25] = [
    "fmi2GetTypesPlatform",
    "fmi2GetVersion",
    "fmi2SetDebugLogging",
    "fmi2Instantiate",
    "fmi2FreeInstance",
    "fmi2SetupExperiment",
    "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode",
    "fmi2Terminate",
    "fmi2Reset",
    "fmi2GetReal",
    "fmi2GetInteger",
    "fmi2GetBoolean",
    "fmi2GetString",
    "fmi2SetReal",
    "fmi2SetInteger",
    "fmi2SetBoolean",
    "fmi2SetString",
    "fmi2GetFMUstate",
    "fmi2SetFMUstate",
    "fmi2FreeFMUstate",
    "fmi2SerializedFMUstateSize",
    "fmi2SerializeFMUstate",
    "fmi2DeSerializeFMUstate",
    "fmi2GetDirectionalDerivative",
];

/// Functions for model exchange (section 3.2).
const MODEL_EXCHANGE: [&str; 10] = [
    "fmi2EnterEventMode",
    "fmi2NewDiscreteStates",
    "fmi2EnterContinuousTimeMode",
    "fmi2CompletedIntegratorStep",
    "fmi2SetTime",
    "fmi2SetContinuousStates",
    "fmi2GetDerivatives",
    "fmi2GetEventIndicators",
    "fmi2GetContinuousStates",
    "fmi2GetNominalsOfContinuousStates",
];

/// Functions for co-simulation (section 4.2).
const CO_SIMULATION: [&str; 9] = [
    "fmi2SetRealInputDerivatives",
    "fmi2GetRealOutputDerivatives",
    "fmi2DoStep",
    "fmi2CancelStep",
    "fmi2GetStatus",
    "fmi2GetRealStatus",
    "fmi2GetIntegerStatus",
    "fmi2GetBooleanStatus",
    "fmi2GetStringStatus",
];

/// A loaded FMU binary.
pub struct Library {
    library: libloading::Library,
    /// Told the name of each function before it is called.
    trace: Box<dyn Fn(&str)>,
}

impl Library {
    /// Loads a binary, which runs its code: see the [module](super) for where that may be done.
    /// `trace` is told the name of each function before it is called.
    ///
    /// # Errors
    /// The dynamic loader's reason.
    pub fn load(file: &Path, trace: impl Fn(&str) + 'static) -> Result<Self> {
        trace("loading it");
        // SAFETY: what a foreign library does when it is loaded is beyond this program; the module's
        // documentation passes that on to the caller.
        match unsafe { libloading::Library::new(file) } {
            Ok(library) => Ok(Self {
                library,
                trace: Box::new(trace),
            }),
            Err(error) => {
                let reason = std::error::Error::source(&error).map(ToString::to_string);
                let reason = reason.unwrap_or_else(|| error.to_string());
                Err(Failure(format!("it cannot be loaded: {reason}")))
            }
        }
    }

    /// The functions that an FMU of this kind must have and this one has not.
    pub fn missing(&self, kind: Kind) -> Vec<&'static str> {
        let own: &[&str] = match kind {
            Kind::ModelExchange => &MODEL_EXCHANGE,
            Kind::CoSimulation => &CO_SIMULATION,
        };
        COMMON
            .iter()
            .chain(own)
            .filter(|name| {
                // SAFETY: the symbol is looked up and not used.
                unsafe { self.library.get::<*const c_void>(**name) }.is_err()
            })
            .copied()
            .collect()
    }

    /// A function of the library, traced as called.
    ///
    /// # Safety
    /// `F` is the function's type by the standard.
    pub(super) unsafe fn function<F>(&self, name: &str) -> Result<Symbol<'_, F>> {
        // SAFETY: the caller's promise.
        let function =
            unsafe { self.library.get::<F>(name) }.map_err(|_| Failure::new(name, "is missing"))?;
        (self.trace)(name);
        Ok(function)
    }

    /// `fmi2GetVersion`
    pub fn version(&self) -> Result<String> {
        self.text("fmi2GetVersion")
    }

    /// `fmi2GetTypesPlatform`
    pub fn types_platform(&self) -> Result<String> {
        self.text("fmi2GetTypesPlatform")
    }

    fn text(&self, name: &str) -> Result<String> {
        // SAFETY: both functions that give a text have this type; a foreign one is trusted to end it
        // in zero, as the module says.
        unsafe {
            let function = self.function::<unsafe extern "C" fn() -> fmi2String>(name)?;
            text(function()).ok_or_else(|| Failure::new(name, "gave NULL"))
        }
    }

    /// `fmi2Instantiate`: none if it gives NULL.
    pub fn instantiate(
        &self,
        kind: Kind,
        guid: &str,
        resources: &str,
    ) -> Result<Option<Instance<'_>>> {
        type Instantiate = unsafe extern "C" fn(
            fmi2String,
            c_int,
            fmi2String,
            fmi2String,
            *const fmi2CallbackFunctions,
            fmi2Boolean,
            fmi2Boolean,
        ) -> fmi2Component;
        const NAME: &str = "fmi2Instantiate";
        let text = |text: &str| {
            CString::new(text)
                .map_err(|_| Failure::new(NAME, "cannot take a text with a zero in it"))
        };
        let (guid, resources) = (text(guid)?, text(resources)?);
        let callbacks = Box::new(callbacks());
        // SAFETY: the type is that of the standard; texts and callbacks are valid, and the callbacks
        // live as long as the instance.
        let component = unsafe {
            self.function::<Instantiate>(NAME)?(
                c"instance".as_ptr(),
                kind as c_int,
                guid.as_ptr(),
                resources.as_ptr(),
                &raw const *callbacks,
                fmi2False,
                fmi2False,
            )
        };
        Ok((!component.is_null()).then(|| Instance::new(self, component, callbacks)))
    }
}

/// The text behind a pointer; none for NULL.
///
/// # Safety
/// `pointer` is NULL or points to a text that ends in zero.
pub(super) unsafe fn text(pointer: *const c_char) -> Option<String> {
    if pointer.is_null() {
        return None;
    }
    // SAFETY: not NULL by the check, and a C string by the caller's promise.
    let text = unsafe { CStr::from_ptr(pointer) };
    Some(text.to_string_lossy().into_owned())
}

unsafe extern "C" {
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(memory: *mut c_void);
}

fn callbacks() -> fmi2CallbackFunctions {
    type Silent =
        unsafe extern "C" fn(fmi2ComponentEnvironment, fmi2String, c_int, fmi2String, fmi2String);
    // SAFETY: a function with a variable number of arguments cannot be written in Rust. The C calling
    // conventions of the platforms of FMI pass the named arguments alike for both, and let the caller
    // remove all; this one reads none. Many an FMU calls its logger without asking whether it is NULL.
    let logger = unsafe { std::mem::transmute::<Silent, fmi2CallbackLogger>(silent) };
    fmi2CallbackFunctions {
        logger: Some(logger),
        allocateMemory: Some(calloc),
        freeMemory: Some(free),
        stepFinished: None,
        componentEnvironment: std::ptr::null_mut(),
    }
}

/// A logger that says nothing.
unsafe extern "C" fn silent(
    _: fmi2ComponentEnvironment,
    _: fmi2String,
    _: c_int,
    _: fmi2String,
    _: fmi2String,
) {
}
