//! Loaded libraries, and the functions that do not need an instance.

use std::error::Error;
use std::ffi::{CString, c_int, c_void};
use std::fmt;
use std::path::Path;
use std::ptr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use fmu_types::fmi2::fmi2String;
use fmu_types::fmi3::fmi3LogMessageCallback;

use crate::functions::{
    CO_SIMULATION, CO_SIMULATION_3, COMMON, COMMON_3, Functions, Functions3, MODEL_EXCHANGE,
    MODEL_EXCHANGE_3,
};
use crate::logger::{OnIntermediate, Registered, intermediate_update, log_3, text};
use crate::trampoline::logger;
use crate::{Cause, Failure, Instance, Logged, Result, Status, Success, Version};

/// The two kinds of FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The host integrates the model.
    ModelExchange,
    /// The FMU integrates the model.
    CoSimulation,
}

/// A loaded FMU binary. It is unloaded when neither the caller nor an instance uses it.
pub struct Library {
    library: libloading::Library,
    /// Empty if calls are traced, which then take the slow path, so that the fast path has no overhead.
    functions: Functions,
    functions_3: Functions3,
    trace: Option<Box<Trace>>,
    lost: AtomicBool,
}

/// Receives the name of each function before it is called.
type Trace = dyn Fn(&'static str) + Send + Sync;

/// The dynamic loader's reason why a library cannot be loaded.
#[derive(Debug, Clone)]
pub struct LoadError(String);

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "it cannot be loaded: {}", self.0)
    }
}

impl Error for LoadError {}

/// The arguments that [`Library::instantiate`] passes to the FMU.
#[derive(Debug, Clone, Copy)]
pub struct Instantiation<'a> {
    /// Name of the instance.
    pub name: &'a str,
    /// Kind of the instance.
    pub kind: Kind,
    /// The GUID of the model description, or the instantiation token of FMI 3.0.
    pub guid: &'a str,
    /// The folder `resources`: its URI, from [`uri`](crate::uri); for FMI 3.0 its path, from
    /// [`resource_path`](crate::resource_path).
    pub resources: &'a str,
    /// Whether the FMU also logs messages other than errors.
    pub logging_on: bool,
}

/// How [`Library::instantiate_as`] treats the arguments. All but the first test an FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Treatment {
    /// All arguments are given, and stay valid until the instance is freed.
    #[default]
    Usual,
    /// The strings are overwritten after the call; FMUs must copy what they need.
    ShortLivedStrings,
    /// The logger is NULL.
    NoLogger,
    /// The location of the resources is NULL.
    NoResources,
}

/// What only FMI 3.0 lets the host choose; by default nothing is used or allowed.
#[derive(Default)]
pub struct Options<'a> {
    /// How the arguments are treated.
    pub treatment: Treatment,
    /// `eventModeUsed`
    pub event_mode_used: bool,
    /// `earlyReturnAllowed`
    pub early_return_allowed: bool,
    /// `requiredIntermediateVariables`
    pub intermediate_variables: &'a [u32],
    /// Receives intermediate updates. It is called during a step, on the thread of the step.
    pub on_intermediate: Option<OnIntermediate>,
}

impl Library {
    /// Loads a binary, which runs its code; see the [crate](crate) about untrusted binaries.
    ///
    /// # Errors
    /// The dynamic loader's reason.
    pub fn load(file: &Path) -> std::result::Result<Arc<Self>, LoadError> {
        let library = open(file)?;
        let functions = (Functions::of(&library), Functions3::of(&library));
        Ok(Self::new(library, functions, None))
    }

    /// Like [`Library::load`]; `trace` receives the name of each function before it is called.
    ///
    /// # Errors
    /// The dynamic loader's reason.
    pub fn load_traced(
        file: &Path,
        trace: impl Fn(&'static str) + Send + Sync + 'static,
    ) -> std::result::Result<Arc<Self>, LoadError> {
        trace("loading it");
        let library = open(file)?;
        let trace: Box<Trace> = Box::new(trace);
        Ok(Self::new(library, Default::default(), Some(trace)))
    }

    fn new(
        library: libloading::Library,
        (functions, functions_3): (Functions, Functions3),
        trace: Option<Box<Trace>>,
    ) -> Arc<Self> {
        Arc::new(Self {
            library,
            functions,
            functions_3,
            trace,
            lost: AtomicBool::new(false),
        })
    }

    /// The functions of FMI 2.0 required for an FMU of this kind that the library does not have.
    pub fn missing(&self, kind: Kind) -> Vec<&'static str> {
        self.missing_of(Version::Fmi2, kind)
    }

    /// The functions required for an FMU of this version and kind that the library does not have.
    pub fn missing_of(&self, version: Version, kind: Kind) -> Vec<&'static str> {
        let (common, own) = match (version, kind) {
            (Version::Fmi2, Kind::ModelExchange) => (COMMON, MODEL_EXCHANGE),
            (Version::Fmi2, Kind::CoSimulation) => (COMMON, CO_SIMULATION),
            (Version::Fmi3, Kind::ModelExchange) => (COMMON_3, MODEL_EXCHANGE_3),
            (Version::Fmi3, Kind::CoSimulation) => (COMMON_3, CO_SIMULATION_3),
        };
        let is_missing = |name: &str| {
            // SAFETY: the symbol is looked up but not used.
            unsafe { self.library.get::<*const c_void>(name) }.is_err()
        };
        let all = common.iter().chain(own);
        all.filter(|name| is_missing(name)).copied().collect()
    }

    /// The functions of FMI 2.0 of the library; all `None` if calls are traced.
    #[inline]
    pub fn functions(&self) -> &Functions {
        &self.functions
    }

    /// The functions of FMI 3.0 of the library; all `None` if calls are traced.
    #[inline]
    pub fn functions_3(&self) -> &Functions3 {
        &self.functions_3
    }

    /// Whether a call returned a status after which the FMU must not be called again, not even to free
    /// its instances, which then leak: a fatal error, which corrupts all instances; fmi2Pending, as the
    /// FMU is still running; or a value that is not a status.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }

    /// Returns the function to call, looked up again if needed.
    ///
    /// # Safety
    /// `F` is the type of the function of this name in the standard.
    #[inline]
    pub(crate) unsafe fn function<F: Copy>(
        &self,
        found: Option<F>,
        name: &'static str,
    ) -> Result<F> {
        match found {
            Some(function) => Ok(function),
            // SAFETY: the caller's promise.
            None => unsafe { self.look_up(name) },
        }
    }

    /// # Safety
    /// As for [`Library::function`].
    #[cold]
    unsafe fn look_up<F: Copy>(&self, name: &'static str) -> Result<F> {
        // SAFETY: the caller's promise.
        let function = unsafe { self.library.get::<F>(name) };
        let function = function.map_err(|_| Failure::new(name, Cause::Missing))?;
        if let Some(trace) = &self.trace {
            trace(name);
        }
        Ok(*function)
    }

    /// The outcome of a call.
    #[inline]
    pub(crate) fn outcome(
        &self,
        version: Version,
        function: &'static str,
        status: c_int,
    ) -> Result {
        match status {
            0 => Ok(Success::Ok),
            other => self.not_ok(function, Status::of(version, other)),
        }
    }

    #[cold]
    fn not_ok(&self, function: &'static str, status: Status) -> Result {
        match status {
            Status::Ok => return Ok(Success::Ok),
            Status::Warning => return Ok(Success::Warning(function)),
            Status::Discard | Status::Error => {}
            Status::Fatal | Status::Pending | Status::Unknown(_) => {
                self.lost.store(true, Ordering::Relaxed);
            }
        }
        Err(Failure::new(function, Cause::Returned(status)))
    }

    /// `fmi2GetVersion`
    ///
    /// # Errors
    /// The function is missing or returned NULL.
    pub fn version(&self) -> Result<String> {
        self.text(self.functions.fmi2GetVersion, "fmi2GetVersion")
    }

    /// `fmi3GetVersion`
    ///
    /// # Errors
    /// The function is missing or returned NULL.
    pub fn version_3(&self) -> Result<String> {
        self.text(self.functions_3.fmi3GetVersion, "fmi3GetVersion")
    }

    /// `fmi2GetTypesPlatform`
    ///
    /// # Errors
    /// The function is missing or returned NULL.
    pub fn types_platform(&self) -> Result<String> {
        let found = self.functions.fmi2GetTypesPlatform;
        self.text(found, "fmi2GetTypesPlatform")
    }

    fn text(
        &self,
        found: Option<unsafe extern "C" fn() -> fmi2String>,
        name: &'static str,
    ) -> Result<String> {
        // SAFETY: all functions that return a string have this type; a foreign binary is trusted to
        // terminate it, as described in the crate documentation.
        let text = unsafe { text(self.function(found, name)?()) };
        text.ok_or_else(|| Failure::new(name, Cause::Broke("returned NULL")))
    }

    /// `fmi2Instantiate`; `None` if it returns NULL. `sink` receives the log messages of the instance,
    /// possibly on a thread that the FMU has started.
    ///
    /// # Errors
    /// The function is missing, or an argument contains a zero byte.
    pub fn instantiate(
        self: &Arc<Self>,
        arguments: &Instantiation<'_>,
        sink: impl Fn(Logged) + Send + Sync + 'static,
    ) -> Result<Option<Instance>> {
        self.instantiate_as(arguments, Treatment::Usual, sink)
    }

    /// Like [`Library::instantiate`], with another treatment of the arguments.
    ///
    /// # Errors
    /// As for [`Library::instantiate`].
    pub fn instantiate_as(
        self: &Arc<Self>,
        arguments: &Instantiation<'_>,
        treatment: Treatment,
        sink: impl Fn(Logged) + Send + Sync + 'static,
    ) -> Result<Option<Instance>> {
        const NAME: &str = "fmi2Instantiate";
        let strings = Strings::of(arguments, treatment, NAME)?;
        let [name, guid, resources] = strings.pointers();
        let logger = (treatment != Treatment::NoLogger).then(logger);
        let registered = Registered::new(Arc::new(sink));
        // SAFETY: the type is that of the standard; the instance keeps the strings and the callbacks
        // until it is freed.
        let instance = unsafe {
            let instantiate = self.function(self.functions.fmi2Instantiate, NAME)?;
            Instance::of_fmi_2(self, registered, logger, |callbacks| {
                instantiate(
                    name,
                    arguments.kind as c_int,
                    guid,
                    resources,
                    callbacks,
                    0,
                    arguments.logging_on.into(),
                )
            })
        };
        Ok(instance.map(|instance| instance.keeping(strings)))
    }

    /// `fmi3InstantiateModelExchange` or `fmi3InstantiateCoSimulation`, as [`Library::instantiate`] for
    /// FMI 3.0.
    ///
    /// # Errors
    /// As for [`Library::instantiate`].
    pub fn instantiate_3(
        self: &Arc<Self>,
        arguments: &Instantiation<'_>,
        options: Options<'_>,
        sink: impl Fn(Logged) + Send + Sync + 'static,
    ) -> Result<Option<Instance>> {
        let function = match arguments.kind {
            Kind::ModelExchange => "fmi3InstantiateModelExchange",
            Kind::CoSimulation => "fmi3InstantiateCoSimulation",
        };
        let strings = Strings::of(arguments, options.treatment, function)?;
        let [name, token, resources] = strings.pointers();
        let logging_on = arguments.logging_on.into();
        let logger: Option<fmi3LogMessageCallback> = match options.treatment {
            Treatment::NoLogger => None,
            _ => Some(log_3),
        };
        let update = options.on_intermediate.is_some();
        let registered = Registered::with(Arc::new(sink), options.on_intermediate);
        let environment = registered.environment();
        // SAFETY: the types are those of the standard; the instance keeps the strings until it is
        // freed, and the FMU copies the value references.
        let instance = unsafe {
            match arguments.kind {
                Kind::ModelExchange => {
                    let found = self.functions_3.fmi3InstantiateModelExchange;
                    let instantiate = self.function(found, function)?;
                    instantiate(name, token, resources, 0, logging_on, environment, logger)
                }
                Kind::CoSimulation => {
                    let found = self.functions_3.fmi3InstantiateCoSimulation;
                    let instantiate = self.function(found, function)?;
                    instantiate(
                        name,
                        token,
                        resources,
                        0,
                        logging_on,
                        options.event_mode_used.into(),
                        options.early_return_allowed.into(),
                        options.intermediate_variables.as_ptr(),
                        options.intermediate_variables.len(),
                        environment,
                        logger,
                        update.then_some(intermediate_update),
                    )
                }
            }
        };
        let instance = Instance::of_fmi_3(self, registered, instance);
        Ok(instance.map(|instance| instance.keeping(strings)))
    }

    /// `fmi2FreeInstance` with NULL, which does nothing by the standard.
    ///
    /// # Errors
    /// The function is missing.
    pub fn free_null(&self) -> Result<()> {
        self.free_null_of(Version::Fmi2)
    }

    /// `fmi2FreeInstance`, `fmi3FreeInstance` with NULL, which does nothing by the standard.
    ///
    /// # Errors
    /// The function is missing.
    pub fn free_null_of(&self, version: Version) -> Result<()> {
        // SAFETY: the type is that of the standard, which allows NULL.
        unsafe { self.free_function(version)?(ptr::null_mut()) };
        Ok(())
    }

    /// The function that frees an instance, which has the same type in both versions.
    pub(crate) fn free_function(
        &self,
        version: Version,
    ) -> Result<unsafe extern "C" fn(*mut c_void)> {
        let (found, name) = match version {
            Version::Fmi2 => (self.functions.fmi2FreeInstance, "fmi2FreeInstance"),
            Version::Fmi3 => (self.functions_3.fmi3FreeInstance, "fmi3FreeInstance"),
        };
        // SAFETY: the type is that of the standard.
        unsafe { self.function(found, name) }
    }
}

/// The strings that an FMU is instantiated with: name, GUID and location of the resources.
pub(crate) struct Strings {
    texts: [Vec<u8>; 3],
    treatment: Treatment,
}

impl Strings {
    fn of(
        arguments: &Instantiation<'_>,
        treatment: Treatment,
        function: &'static str,
    ) -> Result<Self> {
        let text = |text: &str| {
            let text = CString::new(text).map_err(|_| Failure::new(function, Cause::ZeroByte))?;
            Ok(text.into_bytes_with_nul())
        };
        let texts = [
            text(arguments.name)?,
            text(arguments.guid)?,
            text(arguments.resources)?,
        ];
        Ok(Self { texts, treatment })
    }

    /// What is passed to the FMU.
    fn pointers(&self) -> [fmi2String; 3] {
        let [name, guid, resources] = self.texts.each_ref().map(|text| text.as_ptr().cast());
        match self.treatment {
            Treatment::NoResources => [name, guid, ptr::null()],
            _ => [name, guid, resources],
        }
    }

    /// What is kept once the FMU is instantiated.
    pub(crate) fn kept(mut self) -> [Vec<u8>; 3] {
        if self.treatment == Treatment::ShortLivedStrings {
            for text in self.texts.iter_mut().flat_map(|text| text.iter_mut()) {
                *text = if *text == 0 { 0 } else { b'#' };
            }
        }
        self.texts
    }
}

fn open(file: &Path) -> std::result::Result<libloading::Library, LoadError> {
    match dlopen(file) {
        Err(LoadError(reason)) if needs_python(&reason) && load_python() => dlopen(file),
        other => other,
    }
}

fn dlopen(file: &Path) -> std::result::Result<libloading::Library, LoadError> {
    // SAFETY: a foreign library may run any code when it is loaded; the crate documentation leaves
    // this to the caller.
    unsafe { libloading::Library::new(file) }.map_err(|error| {
        let reason = error.source().map(ToString::to_string);
        LoadError(reason.unwrap_or_else(|| error.to_string()))
    })
}

/// Whether a library cannot be loaded since it expects a host that is written in Python, as the FMUs of
/// PythonFMU do.
fn needs_python(reason: &str) -> bool {
    let symbol = reason.split_once("undefined symbol: ");
    symbol.is_some_and(|(_, name)| name.starts_with("Py") || name.starts_with("_Py"))
}

/// Loads the interpreter of an installed Python for all libraries that are loaded later, for good.
#[cfg(target_os = "linux")]
fn load_python() -> bool {
    use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_LAZY};
    let names = (8..20)
        .rev()
        .map(|minor| format!("libpython3.{minor}.so.1.0"));
    names.into_iter().any(|name| {
        // SAFETY: it is the interpreter that the FMU would find in a host in Python.
        match unsafe { Library::open(Some(name), RTLD_LAZY | RTLD_GLOBAL) } {
            Ok(python) => {
                std::mem::forget(python);
                true
            }
            Err(_) => false,
        }
    })
}

#[cfg(not(target_os = "linux"))]
fn load_python() -> bool {
    false
}
