//! Loaded libraries, and the functions that do not need an instance.

use std::error::Error;
use std::ffi::{c_int, c_void};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use std::{fmt, ptr};

use fmi_abi::{
    FmiVersion, FunctionGroup, InterfaceType, fmi2, fmi2_functions, fmi3, fmi3_functions,
};

use crate::logger::text;
use crate::observed::{CallObserver, ObservedCall};
use crate::outcome::{Cause, Failure, Result, Status, Success};
use crate::resources::{resource_path, uri};
#[cfg(feature = "sandbox")]
use crate::sandbox::{self, CompiledComponent};

/// An FMU binary of one version of FMI, or a WebAssembly component. It is unloaded when neither the caller nor an instance uses it.
pub struct Library {
    pub(crate) binary: Binary,
    pub(crate) version: FmiVersion,
    /// The functions of the version. All are empty if calls are observed, so that a call which is not has no overhead.
    pub(crate) fmi2: fmi2::Functions,
    pub(crate) fmi3: fmi3::Functions,
    pub(crate) observed: Option<Box<Observed>>,
    pub(crate) lost: AtomicBool,
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

/// The functions of a library whose calls are observed.
pub(crate) struct Observed {
    pub(crate) fmi2: fmi2::Functions,
    pub(crate) fmi3: fmi3::Functions,
    /// Who observes the calls that have no other observer.
    pub(crate) observer: Arc<dyn CallObserver>,
}

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
        let binary = open(file)?;
        let (fmi2, fmi3) = functions(&binary, version);
        Ok(Arc::new(Self { fmi2, fmi3, ..Self::new(binary, version) }))
    }

    /// Like [`Library::load`]; `observer` observes the loading, and the calls of each function and of instances that
    /// have no observer of their own.
    ///
    /// # Errors
    /// The dynamic loader's reason.
    pub fn load_observed(
        file: &Path,
        version: FmiVersion,
        observer: Arc<dyn CallObserver>,
    ) -> std::result::Result<Arc<Self>, LoadError> {
        let call = ObservedCall { function: ObservedCall::LOADING, arguments: &[] };
        observer.begin(&call);
        let begun = Instant::now();
        let binary = open(file)?;
        observer.end(&call, None, begun.elapsed());
        let (fmi2, fmi3) = functions(&binary, version);
        Ok(Arc::new(Self::new(binary, version).observed_by(observer, fmi2, fmi3)))
    }

    pub(crate) fn observed_by(
        self,
        observer: Arc<dyn CallObserver>,
        fmi2: fmi2::Functions,
        fmi3: fmi3::Functions,
    ) -> Self {
        Self { observed: Some(Box::new(Observed { fmi2, fmi3, observer })), ..self }
    }

    pub(crate) fn new(binary: Binary, version: FmiVersion) -> Self {
        Self {
            binary,
            version,
            fmi2: fmi2::Functions::default(),
            fmi3: fmi3::Functions::default(),
            observed: None,
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
            InterfaceType::ScheduledExecution => FunctionGroup::ScheduledExecution,
        };
        let functions = self.version.functions().iter().map(|(call, _)| call);
        functions
            .filter(|call| {
                matches!(call.group, FunctionGroup::All | FunctionGroup::Clocks)
                    || call.group == own
            })
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

    /// All functions of the version, observed or not.
    pub(crate) fn functions(&self) -> (&fmi2::Functions, &fmi3::Functions) {
        match &self.observed {
            Some(observed) => (&observed.fmi2, &observed.fmi3),
            None => (&self.fmi2, &self.fmi3),
        }
    }

    /// Who observes the calls of an instance without an observer of its own.
    pub(crate) fn observer(&self) -> Option<&Arc<dyn CallObserver>> {
        self.observed.as_ref().map(|observed| &observed.observer)
    }

    /// Makes a call that is of no instance, or in its own way.
    pub(crate) fn observe<T>(&self, function: &'static str, call: impl FnOnce() -> T) -> T {
        let Some(observer) = self.observer() else { return call() };
        let observed = ObservedCall { function, arguments: &[] };
        observer.begin(&observed);
        let begun = Instant::now();
        let result = call();
        observer.end(&observed, None, begun.elapsed());
        result
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
            if cause == Cause::Trapped {
                self.observer().iter().for_each(|observer| observer.trapped());
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
        let (fmi2, fmi3) = self.functions();
        let functions = match self.version {
            FmiVersion::Fmi2 => vec![
                ("fmi2GetVersion", fmi2.fmi2GetVersion),
                ("fmi2GetTypesPlatform", fmi2.fmi2GetTypesPlatform),
            ],
            FmiVersion::Fmi3 => vec![("fmi3GetVersion", fmi3.fmi3GetVersion)],
        };
        let texts = functions.into_iter().map(|(name, found)| {
            let function = found.ok_or_else(|| Failure::new(name, Cause::Missing))?;
            // SAFETY: all functions that return a string have this type; a foreign binary is trusted to
            // terminate it, as described in the crate documentation.
            let text = self.observe(name, || unsafe { text(function()) });
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
        let (name, free) = self.free_function()?;
        // SAFETY: the type follows the standard, which allows NULL.
        self.observe(name, || unsafe { free(ptr::null_mut()) });
        Ok(())
    }

    /// The function that frees an instance, with its name, which has the same type in both versions.
    pub(crate) fn free_function(
        &self,
    ) -> Result<(&'static str, unsafe extern "C" fn(*mut c_void))> {
        let (fmi2, fmi3) = self.functions();
        let (found, name) = match self.version {
            FmiVersion::Fmi2 => (fmi2.fmi2FreeInstance, "fmi2FreeInstance"),
            FmiVersion::Fmi3 => (fmi3.fmi3FreeInstance, "fmi3FreeInstance"),
        };
        let free = found.ok_or_else(|| Failure::new(name, Cause::Missing))?;
        Ok((name, free))
    }
}

/// The functions of a binary.
fn functions(binary: &Binary, version: FmiVersion) -> (fmi2::Functions, fmi3::Functions) {
    match version {
        FmiVersion::Fmi2 => (fmi2_functions!(look_up! fmi2 binary), Default::default()),
        FmiVersion::Fmi3 => (Default::default(), fmi3_functions!(look_up! fmi3 binary)),
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
    unsafe { load(file) }.map_err(|error| {
        let reason = error.source().map(ToString::to_string);
        LoadError(reason.unwrap_or_else(|| error.to_string()))
    })
}

/// Loads a library whose calls of its own functions of FMI reach these, also if a host has made functions of the same names
/// visible to all libraries, such as those of a container with this master inside.
///
/// # Safety
/// It may run any code.
#[cfg(target_os = "linux")]
unsafe fn load(file: &Path) -> std::result::Result<libloading::Library, libloading::Error> {
    use libloading::os::unix::{Library, RTLD_LAZY, RTLD_LOCAL};
    const RTLD_DEEPBIND: c_int = 8;
    let everywhere = Library::this();
    let is_visible = |name: &str| {
        // SAFETY: the symbol is looked up but not used.
        unsafe { everywhere.get::<*const c_void>(name) }.is_ok()
    };
    let own = if ["fmi2GetVersion", "fmi3GetVersion"].into_iter().any(is_visible) {
        RTLD_DEEPBIND
    } else {
        0
    };
    // SAFETY: the caller's promise.
    unsafe { Library::open(Some(file), RTLD_LAZY | RTLD_LOCAL | own) }.map(Into::into)
}

/// As on Linux; elsewhere, a library finds its own functions first.
///
/// # Safety
/// It may run any code.
#[cfg(not(target_os = "linux"))]
unsafe fn load(file: &Path) -> std::result::Result<libloading::Library, libloading::Error> {
    // SAFETY: the caller's promise.
    unsafe { libloading::Library::new(file) }
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
