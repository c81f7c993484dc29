//! Compiled components: they are kept in a cache, and create instances.

use std::ffi::c_void;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Once, OnceLock};
use std::time::Duration;

use fmi_abi::{FmiVersion, InterfaceType};
use wasmtime::{Config, Engine, Module, Store};

use super::abi::{self, Argument, CallError};
use super::cycle::Cycle;
use super::host_state::HostState;
use super::instance::{ComponentInstance, Created, Method, OPERATIONS, Operation};
use super::link::{Linked, PACKAGE, Parts};
use crate::outcome::{Cause, Failure, Result};
use crate::types::{Instantiation, Treatment};

/// A compiled component.
pub(crate) struct CompiledComponent {
    engine: &'static Engine,
    parts: Parts,
}

/// Interval at which the time of calls is measured.
const TICK: Duration = Duration::from_millis(10);
/// More ticks than there will be.
const FOREVER: u64 = 1 << 60;

fn engine() -> wasmtime::Result<&'static Engine> {
    static ENGINE: OnceLock<Engine> = OnceLock::new();
    if let Some(engine) = ENGINE.get() {
        return Ok(engine);
    }
    let engine = Engine::new(Config::new().epoch_interruption(true))?;
    Ok(ENGINE.get_or_init(|| engine))
}

/// Lets the time of calls pass.
fn count_ticks(engine: &Engine) {
    static ONCE: Once = Once::new();
    let engine = engine.clone();
    ONCE.call_once(|| {
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(TICK);
                engine.increment_epoch();
            }
        });
    });
}

impl CompiledComponent {
    /// Compiles a component, or takes it from the cache.
    pub(crate) fn load(file: &Path) -> std::result::Result<Self, String> {
        let load = || -> wasmtime::Result<Self> {
            let engine = engine()?;
            let bytes = fs::read(file)?;
            if !bytes.starts_with(b"\0asm\x0d\0\x01\0") {
                return Err(wasmtime::Error::msg("it is not a WebAssembly component"));
            }
            Ok(Self {
                engine,
                parts: Parts::new(&bytes, |module| compile_or_load(engine, module))?,
            })
        };
        load().map_err(|error| format!("{error:#}"))
    }

    /// Creates an instance; `None` if the FMU refuses.
    pub(crate) fn instantiate(
        &self,
        arguments: &Instantiation<'_>,
        callbacks: *mut c_void,
    ) -> Result<Option<Box<ComponentInstance>>> {
        let function = arguments.interface_type.instantiation(FmiVersion::Fmi3);
        let data = HostState::new(
            callbacks,
            arguments.treatment != Treatment::NoLogger,
            arguments.resources,
            arguments.limits.memory.unwrap_or(usize::MAX),
        );
        let mut store = Store::new(self.engine, data);
        store.limiter(|data| &mut data.memory);
        let limit = arguments.limits.call;
        let ticks = limit.map_or(FOREVER, |limit| {
            count_ticks(self.engine);
            (limit.div_duration_f64(TICK) as u64).clamp(1, FOREVER)
        });
        store.set_epoch_deadline(ticks);
        match self.create(&mut store, arguments) {
            Ok(Some(created)) => {
                Ok(Some(Box::new(ComponentInstance::new(store, created, ticks, limit))))
            }
            Err(CallError::Trap(error)) => {
                store.data_mut().log_fatal(&error, limit);
                Err(Failure::new(function, Cause::Trapped))
            }
            Ok(None) | Err(CallError::Status(_)) => Ok(None),
        }
    }

    fn create(
        &self,
        store: &mut Store<HostState>,
        arguments: &Instantiation<'_>,
    ) -> std::result::Result<Option<Created>, CallError> {
        let kind = arguments.interface_type.option_name();
        let linked = Linked::new(&self.parts, store)?;
        let interface = format!("{PACKAGE}/{kind}@3.0.0");
        let create = format!("[static]{kind}-instance.instantiate-{kind}");
        let create = linked.find(store, &interface, &create)?;
        let create = create.ok_or_else(|| wasmtime::Error::msg(format!("it has no {kind}")))?;
        let methods = OPERATIONS.iter().map(|operation| {
            let method = format!("[method]{kind}-instance.{}", operation.replace('_', "-"));
            let function = linked.find(store, &interface, &method)?;
            Ok(Method::new(function))
        });
        let methods = methods.collect::<wasmtime::Result<Vec<_>>>()?;
        let end = linked.find(store, &interface, &format!("{kind}-instance"))?;
        let Instantiation { name, guid, logging_on, event_mode_used, .. } = *arguments;
        let (early, variables) = (arguments.early_return_allowed, arguments.intermediate_variables);
        let (mut types, mut given) =
            ("string,string", vec![Argument::text(name), Argument::text(guid)]);
        // Until commit 77277f4 of the draft, there is a path of resources, which components cannot read.
        if create.signature.starts_with("string,string,string") {
            types = "string,string,string";
            given.push(Argument::text(""));
        }
        given.extend([false.into(), logging_on.into()]);
        let mut more = "bool,bool";
        if arguments.interface_type == InterfaceType::CoSimulation {
            more = "bool,bool,bool,bool,list<u32>";
            given.extend([event_mode_used.into(), early.into(), Argument::list(variables)]);
        }
        if *create.signature != *format!("{types},{more}->option<own>") {
            return Err(mistyped().into());
        }
        // SAFETY: the types were checked.
        let handle =
            unsafe { abi::call(store, &create, None, &given, |returned| returned.option()) };
        let Some(handle) = handle? else { return Ok(None) };
        let set = methods[Operation::set_float64 as usize].function.as_ref();
        let cycle = linked.cycle.zip(set).and_then(|(function, set)| Cycle::new(function, set));
        Ok(Some(Created { methods, handle, end, cycle }))
    }

    /// The result of `fmi3GetVersion`.
    pub(crate) fn version(&self) -> Result<String> {
        let get = || {
            let mut store = Store::new(self.engine, HostState::default());
            store.set_epoch_deadline(FOREVER);
            let linked = Linked::new(&self.parts, &mut store)?;
            let get = linked.find(&mut store, "fmi:fmi3/common@3.0.0", "get-version")?;
            let get = get.filter(|get| &*get.signature == "->string").ok_or_else(mistyped)?;
            // SAFETY: the types were checked.
            unsafe {
                abi::call(&mut store, &get, None, &[], |returned| Ok(returned.text()?.to_owned()))
            }
        };
        get().map_err(|_: CallError| Failure::new("fmi3GetVersion", Cause::Trapped))
    }
}

fn mistyped() -> wasmtime::Error {
    wasmtime::Error::msg("a function is missing, or is not of its type")
}

/// Compiles a module. The compiled code is kept in a file that is named by the hash of the module.
fn compile_or_load(engine: &Engine, bytes: &[u8]) -> wasmtime::Result<Module> {
    use sha2::{Digest, Sha256};
    use std::hash::{DefaultHasher, Hash, Hasher};
    let mut settings = DefaultHasher::new();
    engine.precompile_compatibility_hash().hash(&mut settings);
    let digest = Sha256::digest(bytes).into_iter().map(|byte| format!("{byte:02x}"));
    let name = format!("{}-{:016x}", digest.collect::<String>(), settings.finish());
    let file = cache_folder().map(|folder| folder.join(name));
    if let Some(file) = file.as_ref().filter(|file| file.exists()) {
        // SAFETY: only this function writes to the folder, which is the user's own, and files appear in it when
        // they are complete.
        if let Ok(module) = unsafe { Module::deserialize_file(engine, file) } {
            return Ok(module);
        }
    }
    let module = Module::from_binary(engine, bytes)?;
    if let (Some(file), Ok(code)) = (file, module.serialize()) {
        // A cache that cannot be written costs time only.
        let _ = write_to_cache(&file, &code);
    }
    Ok(module)
}

/// The folder of compiled components.
fn cache_folder() -> Option<PathBuf> {
    let folder = |name: &str, rest: &str| {
        let parent = PathBuf::from(std::env::var_os(name)?);
        parent.is_absolute().then(|| parent.join(rest))
    };
    let folder = if cfg!(windows) {
        folder("LOCALAPPDATA", "")
    } else if cfg!(target_os = "macos") {
        folder("HOME", "Library/Caches")
    } else {
        folder("XDG_CACHE_HOME", "").or_else(|| folder("HOME", ".cache"))
    };
    folder.map(|folder| folder.join("cargo-fmu"))
}

fn write_to_cache(file: &Path, code: &[u8]) -> std::io::Result<()> {
    let part = file.with_extension(format!("{}.part", std::process::id()));
    file.parent().map_or(Ok(()), fs::create_dir_all)?;
    fs::write(&part, code).and_then(|()| fs::rename(&part, file)).inspect_err(|_| {
        let _ = fs::remove_file(&part);
    })
}
