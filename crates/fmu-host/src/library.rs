//! A loaded library, and the functions that need no instance.

use std::error::Error;
use std::ffi::{CString, c_int, c_void};
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use fmu_types::fmi2::fmi2String;

use crate::functions::{CO_SIMULATION, COMMON, Functions, MODEL_EXCHANGE};
use crate::logger::{Registered, text};
use crate::{Cause, Failure, Instance, Logged, Result, Status, Success};

/// The two kinds of FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The host integrates.
    ModelExchange,
    /// The FMU integrates.
    CoSimulation,
}

/// A loaded FMU binary. It is unloaded when neither the caller nor an instance needs it any more.
pub struct Library {
    library: libloading::Library,
    /// Empty if calls are traced: then each call goes the slow way, and the fast one has no overhead.
    functions: Functions,
    trace: Option<Box<Trace>>,
    lost: AtomicBool,
}

/// Gets the name of each function before it is called.
type Trace = dyn Fn(&'static str) + Send + Sync;

/// Why a library cannot be loaded: the dynamic loader's reason.
#[derive(Debug, Clone)]
pub struct LoadError(String);

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "it cannot be loaded: {}", self.0)
    }
}

impl Error for LoadError {}

/// What [`Library::instantiate`] passes to the FMU.
#[derive(Debug, Clone, Copy)]
pub struct Instantiation<'a> {
    /// Name of the instance.
    pub name: &'a str,
    /// The kind that it is to be.
    pub kind: Kind,
    /// The GUID of the model description.
    pub guid: &'a str,
    /// URI of the folder `resources`, as [`uri`](crate::uri) makes it.
    pub resources: &'a str,
    /// Whether the FMU logs what is not an error, too.
    pub logging_on: bool,
}

impl Library {
    /// Loads a binary, which runs its code: see the [crate](crate) for where that may be done.
    ///
    /// # Errors
    /// The dynamic loader's reason.
    pub fn load(file: &Path) -> std::result::Result<Arc<Self>, LoadError> {
        let library = open(file)?;
        let functions = Functions::of(&library);
        Ok(Self::new(library, functions, None))
    }

    /// As [`Library::load`]; `trace` gets the name of each function before it is called.
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
        Ok(Self::new(library, Functions::default(), Some(trace)))
    }

    fn new(
        library: libloading::Library,
        functions: Functions,
        trace: Option<Box<Trace>>,
    ) -> Arc<Self> {
        Arc::new(Self {
            library,
            functions,
            trace,
            lost: AtomicBool::new(false),
        })
    }

    /// The functions that an FMU of this kind must have and this one has not.
    pub fn missing(&self, kind: Kind) -> Vec<&'static str> {
        let own = match kind {
            Kind::ModelExchange => MODEL_EXCHANGE,
            Kind::CoSimulation => CO_SIMULATION,
        };
        let is_missing = |name: &str| {
            // SAFETY: the symbol is looked up and not used.
            unsafe { self.library.get::<*const c_void>(name) }.is_err()
        };
        let all = COMMON.iter().chain(own);
        all.filter(|name| is_missing(name)).copied().collect()
    }

    /// The functions as they were looked up, all `None` if calls are traced.
    #[inline]
    pub fn functions(&self) -> &Functions {
        &self.functions
    }

    /// Whether a call has ended in a way after which nothing of the FMU may be called any more, not
    /// even to free its instances, which are then kept in memory: fmi2Fatal, which corrupts all
    /// instances; fmi2Pending, as the FMU is still at work; or no status of FMI at all.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }

    /// The function that is to be called.
    ///
    /// # Safety
    /// `F` is the type that the standard gives the function of this name.
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

    /// How a call ended.
    #[inline]
    pub(crate) fn outcome(&self, function: &'static str, status: c_int) -> Result {
        match status {
            0 => Ok(Success::Ok),
            other => self.not_ok(function, other.into()),
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
    /// It is missing or returned NULL.
    pub fn version(&self) -> Result<String> {
        self.text(self.functions.fmi2GetVersion, "fmi2GetVersion")
    }

    /// `fmi2GetTypesPlatform`
    ///
    /// # Errors
    /// It is missing or returned NULL.
    pub fn types_platform(&self) -> Result<String> {
        let found = self.functions.fmi2GetTypesPlatform;
        self.text(found, "fmi2GetTypesPlatform")
    }

    fn text(
        &self,
        found: Option<unsafe extern "C" fn() -> fmi2String>,
        name: &'static str,
    ) -> Result<String> {
        // SAFETY: both functions that return a text have this type; a foreign one is trusted to end
        // it in zero, as the crate says.
        let text = unsafe { text(self.function(found, name)?()) };
        text.ok_or_else(|| Failure::new(name, Cause::Broke("returned NULL")))
    }

    /// `fmi2Instantiate`: none if it returns NULL. `sink` gets what the instance logs, maybe from a
    /// thread that the FMU has started.
    ///
    /// # Errors
    /// It is missing, or an argument contains a zero byte.
    pub fn instantiate(
        self: &Arc<Self>,
        arguments: &Instantiation<'_>,
        sink: impl Fn(Logged) + Send + Sync + 'static,
    ) -> Result<Option<Instance>> {
        const NAME: &str = "fmi2Instantiate";
        let text = |text: &str| CString::new(text).map_err(|_| Failure::new(NAME, Cause::ZeroByte));
        let (name, guid) = (text(arguments.name)?, text(arguments.guid)?);
        let resources = text(arguments.resources)?;
        let registered = Registered::new(Arc::new(sink));
        // SAFETY: the type is that of the standard; the strings are valid during the call, and the
        // callbacks until the instance is freed.
        unsafe {
            let instantiate = self.function(self.functions.fmi2Instantiate, NAME)?;
            Ok(Instance::new(self, registered, |callbacks| {
                instantiate(
                    name.as_ptr(),
                    arguments.kind as c_int,
                    guid.as_ptr(),
                    resources.as_ptr(),
                    callbacks,
                    0,
                    arguments.logging_on.into(),
                )
            }))
        }
    }
}

fn open(file: &Path) -> std::result::Result<libloading::Library, LoadError> {
    // SAFETY: what a foreign library does when it is loaded is beyond this program; the crate's
    // documentation passes that on to the caller.
    unsafe { libloading::Library::new(file) }.map_err(|error| {
        let reason = error.source().map(ToString::to_string);
        LoadError(reason.unwrap_or_else(|| error.to_string()))
    })
}
