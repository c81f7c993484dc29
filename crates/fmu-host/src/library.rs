//! Loaded libraries, and the functions that do not need an instance.

use std::collections::HashMap;
use std::error::Error;
use std::ffi::{c_int, c_void};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::{fmt, mem, ptr};

use fmi_abi::{
    FmiVersion, FunctionGroup, InterfaceType, fmi2, fmi2_functions, fmi3, fmi3_functions,
};

use crate::logger::text;
use crate::outcome::{Cause, Failure, Result, Status, Success};
use crate::resources::{resource_path, uri};
#[cfg(feature = "sandbox")]
use crate::sandbox::{self, CompiledComponent};

/// An FMU binary of one version of FMI, or a WebAssembly component. It is unloaded when neither the caller nor an instance uses it.
pub struct Library {
    pub(crate) binary: Binary,
    pub(crate) version: FmiVersion,
    /// The functions of the version. All are empty if calls are traced: the calls then take the slow path, so that the
    /// fast path has no overhead.
    pub(crate) fmi2: fmi2::Functions,
    pub(crate) fmi3: fmi3::Functions,
    trace: Option<Trace>,
    lost: AtomicBool,
}

/// Where the functions of a library are.
pub(crate) enum Binary {
    Native(libloading::Library),
    /// The functions are part of this program.
    Function,
    #[cfg(feature = "sandbox")]
    Component(Box<CompiledComponent>),
}

impl Binary {
    /// The function of a name.
    ///
    /// # Safety
    /// `F` is its type.
    unsafe fn get<F: Copy>(&self, name: &str) -> Option<F> {
        // SAFETY: the caller's promise.
        unsafe {
            match self {
                Self::Native(library) => library.get(name).ok().map(|found| *found),
                Self::Function => None,
                #[cfg(feature = "sandbox")]
                Self::Component(_) => None,
            }
        }
    }
}

/// The observer of the calls of a library.
struct Trace {
    /// Receives the name of each function before it is called.
    tell: Box<dyn Fn(&'static str) + Send + Sync>,
    /// The functions called so far: to look one up takes longer than most calls.
    found: Mutex<HashMap<&'static str, Option<Untyped>>>,
}

/// A function that is called by its own type.
type Untyped = unsafe extern "C" fn();

/// The dynamic loader's reason why a library cannot be loaded.
#[derive(Debug, Clone)]
pub struct LoadError(String);

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "it cannot be loaded: {}", self.0)
    }
}

impl Error for LoadError {}

macro_rules! look_up {
    (
        $version:ident $binary:ident
        Free { $($free:ident($($_0:tt)*) $(-> $_1:ty)? => $_2:ident;)* }
        $($_3:ident { $($name:ident($($_4:tt)*) => $_5:ident in $($_6:ident)|+;)* })*
    ) => {
        // SAFETY: the types follow the standard; whoever loads the library trusts it to follow the
        // standard.
        unsafe {
            $version::Functions {
                $($free: $binary.get(stringify!($free)),)*
                $($($name: $binary.get(stringify!($name)),)*)*
            }
        }
    };
}

impl Library {
    /// Loads a binary of a version of FMI, which runs its code; see the [crate](crate) about untrusted
    /// binaries.
    ///
    /// # Errors
    /// The dynamic loader's reason.
    pub fn load(file: &Path, version: FmiVersion) -> std::result::Result<Arc<Self>, LoadError> {
        let mut library = Self::new(open(file)?, version);
        let binary = &library.binary;
        match version {
            FmiVersion::Fmi2 => library.fmi2 = fmi2_functions!(look_up! fmi2 binary),
            FmiVersion::Fmi3 => library.fmi3 = fmi3_functions!(look_up! fmi3 binary),
        }
        Ok(Arc::new(library))
    }

    /// Like [`Library::load`]; `trace` receives the name of each function before it is called. A component that
    /// traps ends the process, as native code that crashes does.
    ///
    /// # Errors
    /// The dynamic loader's reason.
    pub fn load_traced(
        file: &Path,
        version: FmiVersion,
        trace: impl Fn(&'static str) + Send + Sync + 'static,
    ) -> std::result::Result<Arc<Self>, LoadError> {
        trace("loading it");
        let trace = Trace { tell: Box::new(trace), found: Mutex::default() };
        Ok(Arc::new(Self { trace: Some(trace), ..Self::new(open(file)?, version) }))
    }

    pub(crate) fn new(binary: Binary, version: FmiVersion) -> Self {
        Self {
            binary,
            version,
            fmi2: fmi2::Functions::default(),
            fmi3: fmi3::Functions::default(),
            trace: None,
            lost: AtomicBool::new(false),
        }
    }

    /// Its version of FMI.
    pub fn version(&self) -> FmiVersion {
        self.version
    }

    /// The location of a folder of resources for [`Instantiation`](crate::Instantiation): a URI in FMI 2.0, a path in FMI 3.0.
    pub fn location(&self, resources: &Path) -> String {
        match self.version {
            FmiVersion::Fmi2 => uri(resources),
            FmiVersion::Fmi3 => resource_path(resources),
        }
    }

    /// The functions that an FMU of an interface type needs and the binary does not have. A component that lacks one
    /// cannot be instantiated.
    pub fn missing(&self, interface_type: InterfaceType) -> Vec<&'static str> {
        #[cfg(feature = "sandbox")]
        if let Binary::Component(_) = &self.binary {
            return Vec::new();
        }
        let own = match interface_type {
            InterfaceType::ModelExchange => FunctionGroup::ModelExchange,
            InterfaceType::CoSimulation => FunctionGroup::CoSimulation,
        };
        let functions = self.version.functions().iter().map(|(call, _)| call);
        functions
            .filter(|call| call.group == FunctionGroup::All || call.group == own)
            .map(|call| call.name)
            // SAFETY: the symbol is looked up but not used.
            .filter(|name| unsafe { self.binary.get::<*const c_void>(name) }.is_none())
            .collect()
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
        // SAFETY: it is only called by the type that the caller promises.
        let look_up = || unsafe { self.binary.get::<Untyped>(name) };
        let function = match &self.trace {
            Some(trace) => {
                let mut found = trace.found.lock().unwrap_or_else(PoisonError::into_inner);
                *found.entry(name).or_insert_with(look_up)
            }
            None => look_up(),
        };
        let function = function.ok_or_else(|| Failure::new(name, Cause::Missing))?;
        self.trace(name);
        // SAFETY: the caller's promise; all functions have the size of a pointer.
        Ok(unsafe { mem::transmute_copy(&function) })
    }

    #[cfg(feature = "sandbox")]
    pub(crate) fn is_traced(&self) -> bool {
        self.trace.is_some()
    }

    /// Says that a function is about to be called.
    pub(crate) fn trace(&self, name: &'static str) {
        if let Some(trace) = &self.trace {
            (trace.tell)(name);
        }
    }

    /// The outcome of a call.
    #[inline]
    pub(crate) fn outcome(&self, function: &'static str, status: c_int) -> Result {
        match status {
            0 => Ok(Success::Ok),
            other => self.not_ok(function, Status::in_version(self.version, other)),
        }
    }

    #[cold]
    fn not_ok(&self, function: &'static str, status: Status) -> Result {
        #[cfg(feature = "sandbox")]
        if let (Binary::Component(_), Status::Unknown(status)) = (&self.binary, status)
            && let Some(cause) = sandbox::cause(status)
        {
            if cause == Cause::Trapped && self.trace.is_some() {
                std::process::abort();
            }
            return Err(Failure::new(function, cause));
        }
        match status {
            Status::Ok => return Ok(Success::Ok),
            Status::Warning => return Ok(Success::Warning(function)),
            _ if matches!(self.binary, Binary::Function) => {
                return Err(Failure::new("", Cause::Raised));
            }
            Status::Discard | Status::Error => {}
            Status::Fatal | Status::Pending | Status::Unknown(_) => {
                self.lost.store(true, Ordering::Relaxed);
            }
        }
        Err(Failure::new(function, Cause::Returned(status)))
    }

    /// The names and the results of the functions that return a text: `fmi2GetVersion` and
    /// `fmi2GetTypesPlatform`, or `fmi3GetVersion`.
    ///
    /// # Errors
    /// A function is missing or returned NULL.
    pub fn texts(&self) -> Result<Vec<(&'static str, String)>> {
        #[cfg(feature = "sandbox")]
        if let Binary::Component(component) = &self.binary {
            return Ok(vec![("fmi3GetVersion", component.version()?)]);
        }
        let (fmi2, fmi3) = (&self.fmi2, &self.fmi3);
        let functions = match self.version {
            FmiVersion::Fmi2 => vec![
                ("fmi2GetVersion", fmi2.fmi2GetVersion),
                ("fmi2GetTypesPlatform", fmi2.fmi2GetTypesPlatform),
            ],
            FmiVersion::Fmi3 => vec![("fmi3GetVersion", fmi3.fmi3GetVersion)],
        };
        let texts = functions.into_iter().map(|(name, found)| {
            // SAFETY: all functions that return a string have this type; a foreign binary is trusted to
            // terminate it, as described in the crate documentation.
            let text = unsafe { text(self.function(found, name)?()) };
            let text = text.ok_or_else(|| Failure::new(name, Cause::Broke("returned NULL")))?;
            Ok((name, text))
        });
        texts.collect()
    }

    /// `fmi2FreeInstance`, `fmi3FreeInstance` with NULL, which does nothing by the standard.
    ///
    /// # Errors
    /// The function is missing.
    pub fn free_null(&self) -> Result<()> {
        #[cfg(feature = "sandbox")]
        if let Binary::Component(_) = &self.binary {
            return Ok(());
        }
        // SAFETY: the type follows the standard, which allows NULL.
        unsafe { self.free_function()?(ptr::null_mut()) };
        Ok(())
    }

    /// The function that frees an instance, which has the same type in both versions.
    pub(crate) fn free_function(&self) -> Result<unsafe extern "C" fn(*mut c_void)> {
        let (found, name) = match self.version {
            FmiVersion::Fmi2 => (self.fmi2.fmi2FreeInstance, "fmi2FreeInstance"),
            FmiVersion::Fmi3 => (self.fmi3.fmi3FreeInstance, "fmi3FreeInstance"),
        };
        // SAFETY: the type follows the standard.
        unsafe { self.function(found, name) }
    }
}

fn open(file: &Path) -> std::result::Result<Binary, LoadError> {
    if file.extension().is_some_and(|extension| extension == "wasm") {
        return open_component(file);
    }
    let opened = match dlopen(file) {
        Err(LoadError(reason)) if needs_python(&reason) && load_python() => dlopen(file),
        other => other,
    };
    opened.map(Binary::Native)
}

#[cfg(feature = "sandbox")]
fn open_component(file: &Path) -> std::result::Result<Binary, LoadError> {
    let compiled = CompiledComponent::load(file).map_err(LoadError)?;
    Ok(Binary::Component(Box::new(compiled)))
}

#[cfg(not(feature = "sandbox"))]
fn open_component(_: &Path) -> std::result::Result<Binary, LoadError> {
    let reason =
        "it is a WebAssembly component, and this program was built without the feature `sandbox`";
    Err(LoadError(reason.to_owned()))
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
    let names = (8..20).rev().map(|minor| format!("libpython3.{minor}.so.1.0"));
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
