//! WebAssembly components, run by wasmtime: the interface of the draft FMI-LS-WASM, which `component.wit` of the
//! crate `fmu-build` lists.
//!
//! Each operation of FMI 3.0 is here a method, made from the rows of `fmi-abi`, with the arguments of the function in C
//! as slices. It calls the method of the component that performs the operation. Each instance has a component of its
//! own, with its own memory.

use std::ffi::{CStr, CString, c_int, c_void};
use std::fs;
use std::path::{Component as Part, Path, PathBuf};
use std::ptr;
use std::sync::{Once, OnceLock};
use std::time::Duration;

use fmi_abi::fmi3::*;
use fmi_abi::fmi3_functions;
use wasmtime::component::{
    Component, ComponentNamedList, ComponentType, Func, Lift, Linker, Lower, Resource, ResourceAny,
    ResourceType, Type, TypedFunc, Val, types::ComponentItem,
};
use wasmtime::{Config, Engine, Store, StoreContextMut, StoreLimits, StoreLimitsBuilder, Trap};

use crate::instance::{Instantiation, State as Saved, Treatment};
use crate::library::Kind;
use crate::logger::{self, Intermediate, Logged};
use crate::outcome::{Cause, Failure, Result, Status};

/// `status` of the draft.
#[allow(dead_code, reason = "only the component makes most of them")]
#[derive(Clone, Copy, PartialEq, ComponentType, Lift, Lower)]
#[component(enum)]
#[repr(u8)]
enum State {
    #[component(name = "ok")]
    Ok,
    #[component(name = "warning")]
    Warning,
    #[component(name = "discard")]
    Discard,
    #[component(name = "error")]
    Error,
    #[component(name = "fatal")]
    Fatal,
}

#[derive(ComponentType, Lift)]
#[component(record)]
struct DoStepResult {
    #[component(name = "last-successful-time")]
    last_successful_time: f64,
    #[component(name = "event-handling-needed")]
    event_handling_needed: bool,
    #[component(name = "terminate-simulation")]
    terminate: bool,
    #[component(name = "early-return")]
    early_return: bool,
}

#[derive(ComponentType, Lift)]
#[component(record)]
struct DiscreteStatesInfo {
    #[component(name = "new-discrete-states-needed")]
    again: bool,
    #[component(name = "terminate-simulation")]
    terminate: bool,
    #[component(name = "nominals-of-continuous-states-changed")]
    nominals_changed: bool,
    #[component(name = "values-of-continuous-states-changed")]
    states_changed: bool,
    #[component(name = "next-event-time-defined")]
    next_event_defined: bool,
    #[component(name = "next-event-time")]
    next_event: f64,
}

#[derive(ComponentType, Lift)]
#[component(record)]
struct CompletedStepResult {
    #[component(name = "enter-event-mode")]
    enter_event_mode: bool,
    #[component(name = "terminate-simulation")]
    terminate: bool,
}

/// What a method returns that has results.
type Answer<T> = std::result::Result<T, State>;

/// What is returned besides the statuses of the standard.
const TRAPPED: fmi3Status = fmi3Status(-1);
const LENGTH: fmi3Status = fmi3Status(-2);
const TYPE: fmi3Status = fmi3Status(-3);
const ZERO_BYTE: fmi3Status = fmi3Status(-4);

/// What one of these statuses means.
pub(crate) fn cause(status: c_int) -> Option<Cause> {
    match fmi3Status(status) {
        TRAPPED => Some(Cause::Trapped),
        LENGTH => Some(Cause::Broke("returned another number of values than expected")),
        TYPE => Some(Cause::Broke("is missing from the component, or is not of its type")),
        ZERO_BYTE => Some(Cause::Broke("returned a string that contains a zero byte")),
        _ => None,
    }
}

/// A compiled component.
pub(crate) struct Compiled {
    component: Component,
    linker: Linker<Data>,
}

/// What the functions that a component imports need.
struct Data {
    /// The key of the callbacks.
    callbacks: usize,
    has_logger: bool,
    resources: PathBuf,
    limits: StoreLimits,
}

/// An instance of a component.
pub(crate) struct Instance {
    store: Store<Data>,
    methods: Methods,
    handle: ResourceAny,
    /// The time that a call has, in periods of [`TICK`].
    ticks: u64,
    limit: Option<Duration>,
    /// What the host has a pointer to until the next call.
    texts: Vec<CString>,
    bytes: Vec<Vec<u8>>,
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
fn tick(engine: &Engine) {
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

impl Compiled {
    /// Compiles a component, or takes it from the cache.
    pub(crate) fn load(file: &Path) -> std::result::Result<Self, String> {
        let load = || -> wasmtime::Result<Self> {
            let engine = engine()?;
            let bytes = fs::read(file)?;
            if !bytes.starts_with(b"\0asm\x0d\0\x01\0") {
                return Err(wasmtime::Error::msg("it is not a WebAssembly component"));
            }
            let component = compiled(engine, &bytes)?;
            let mut linker = linker(engine)?;
            grant_nothing(&mut linker, &component)?;
            Ok(Self { component, linker })
        };
        load().map_err(|error| format!("{error:#}"))
    }

    /// Creates an instance; `None` if the FMU refuses.
    pub(crate) fn instantiate(
        &self,
        arguments: &Instantiation<'_>,
        callbacks: *mut c_void,
    ) -> Result<Option<Box<Instance>>> {
        let function = match arguments.kind {
            Kind::ModelExchange => "fmi3InstantiateModelExchange",
            Kind::CoSimulation => "fmi3InstantiateCoSimulation",
        };
        let mut limits = StoreLimitsBuilder::new().trap_on_grow_failure(true);
        if let Some(bytes) = arguments.limits.memory {
            // A component has one or two of each.
            limits = limits.memory_size(bytes).memories(10).tables(10);
            limits = limits.table_elements(bytes / size_of::<usize>());
        }
        let data = Data {
            callbacks: callbacks.addr(),
            has_logger: arguments.treatment != Treatment::NoLogger,
            resources: arguments.resources.into(),
            limits: limits.build(),
        };
        let mut store = Store::new(self.component.engine(), data);
        store.limiter(|data| &mut data.limits);
        let limit = arguments.limits.call;
        let ticks = limit.map_or(FOREVER, |limit| {
            tick(self.component.engine());
            (limit.div_duration_f64(TICK) as u64).clamp(1, FOREVER)
        });
        store.set_epoch_deadline(ticks);
        match self.create(&mut store, arguments) {
            Ok(Some((methods, handle))) => {
                let (texts, bytes) = Default::default();
                let instance = Instance { store, methods, handle, ticks, limit, texts, bytes };
                Ok(Some(Box::new(instance)))
            }
            Ok(None) => Ok(None),
            Err(error) => {
                store.data().log_fatal(&error, limit);
                Err(Failure::new(function, Cause::Trapped))
            }
        }
    }

    fn create(
        &self,
        store: &mut Store<Data>,
        arguments: &Instantiation<'_>,
    ) -> wasmtime::Result<Option<(Methods, ResourceAny)>> {
        let kind = name(arguments.kind);
        let instance = self.linker.instantiate(&mut *store, &self.component)?;
        let interface = format!("{PACKAGE}/{kind}@3.0.0");
        let interface = instance.get_export_index(&mut *store, None, &interface);
        let mut find = |prefix: &str, method: &str| {
            let method = format!("[{prefix}]{kind}-instance.{method}");
            let index = instance.get_export_index(&mut *store, interface.as_ref(), &method)?;
            instance.get_func(&mut *store, index)
        };
        let create = find("static", &format!("instantiate-{kind}"));
        let create = create.ok_or_else(|| wasmtime::Error::msg(format!("it has no {kind}")))?;
        let methods = Methods::find(|operation| find("method", &operation.replace('_', "-")));
        let Instantiation { name, guid, logging_on, event_mode_used, .. } = *arguments;
        let (early, variables) = (arguments.early_return_allowed, arguments.intermediate_variables);
        // An earlier draft, as in OpenModelica, has a path of resources, which components cannot read.
        let has_path = matches!(create.params(&*store).get(2), Some((_, Type::String)));
        let (handle,): (Option<ResourceAny>,) = match (arguments.kind, has_path) {
            (Kind::ModelExchange, false) => {
                let given = (name, guid, false, logging_on);
                create.typed(&*store)?.call(&mut *store, given)?
            }
            (Kind::ModelExchange, true) => {
                let given = (name, guid, "", false, logging_on);
                create.typed(&*store)?.call(&mut *store, given)?
            }
            (Kind::CoSimulation, false) => {
                let given = (name, guid, false, logging_on, event_mode_used, early, variables);
                create.typed(&*store)?.call(&mut *store, given)?
            }
            (Kind::CoSimulation, true) => {
                let given = (name, guid, "", false, logging_on, event_mode_used, early, variables);
                create.typed(&*store)?.call(&mut *store, given)?
            }
        };
        create.post_return(store)?;
        Ok(handle.map(|handle| (methods, handle)))
    }

    /// The result of `fmi3GetVersion`.
    pub(crate) fn version(&self) -> Result<String> {
        let get = || -> wasmtime::Result<String> {
            let (resources, limits) = (PathBuf::new(), StoreLimits::default());
            let data = Data { callbacks: 0, has_logger: false, resources, limits };
            let mut store = Store::new(self.component.engine(), data);
            store.set_epoch_deadline(FOREVER);
            let instance = self.linker.instantiate(&mut store, &self.component)?;
            let interface = self.component.get_export_index(None, "fmi:fmi3/common@3.0.0");
            let index = self.component.get_export_index(interface.as_ref(), "get-version");
            let index = index.ok_or_else(|| wasmtime::Error::msg("it is missing"))?;
            let get = instance.get_typed_func::<(), (String,)>(&mut store, index)?;
            Ok(get.call(&mut store, ())?.0)
        };
        get().map_err(|_| Failure::new("fmi3GetVersion", Cause::Trapped))
    }
}

const PACKAGE: &str = "fmi:fmi3";
fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::ModelExchange => "model-exchange",
        Kind::CoSimulation => "co-simulation",
    }
}

/// Compiles a component. The compiled code is kept in a file that is named by the hash of the component.
fn compiled(engine: &Engine, bytes: &[u8]) -> wasmtime::Result<Component> {
    use sha2::{Digest, Sha256};
    use std::hash::{DefaultHasher, Hash, Hasher};
    let mut settings = DefaultHasher::new();
    engine.precompile_compatibility_hash().hash(&mut settings);
    let digest = Sha256::digest(bytes).into_iter().map(|byte| format!("{byte:02x}"));
    let name = format!("{}-{:016x}", digest.collect::<String>(), settings.finish());
    let file = cache().map(|folder| folder.join(name));
    if let Some(file) = file.as_ref().filter(|file| file.exists()) {
        // SAFETY: only this function writes to the folder, which is the user's own, and files appear in it when
        // they are complete.
        if let Ok(component) = unsafe { Component::deserialize_file(engine, file) } {
            return Ok(component);
        }
    }
    let component = Component::from_binary(engine, bytes)?;
    if let (Some(file), Ok(code)) = (file, component.serialize()) {
        // A cache that cannot be written costs time only.
        let _ = keep(&file, &code);
    }
    Ok(component)
}

/// The folder of compiled components.
fn cache() -> Option<PathBuf> {
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

fn keep(file: &Path, code: &[u8]) -> std::io::Result<()> {
    let part = file.with_extension(format!("{}.part", std::process::id()));
    file.parent().map_or(Ok(()), fs::create_dir_all)?;
    fs::write(&part, code).and_then(|()| fs::rename(&part, file)).inspect_err(|_| {
        let _ = fs::remove_file(&part);
    })
}

const PRINTING: [&str; 2] =
    ["[method]output-stream.write", "[method]output-stream.blocking-write-and-flush"];

/// Lets a component import WASI, as one does that was compiled for `wasm32-wasip2`. It gets an environment without
/// anything in it, and what it prints becomes messages. A call of anything else is a trap.
fn grant_nothing(linker: &mut Linker<Data>, component: &Component) -> wasmtime::Result<()> {
    let (of, engine) = (component.component_type(), component.engine());
    for (name, item) in of.imports(engine) {
        let ComponentItem::ComponentInstance(interface) = item else { continue };
        if name.starts_with("fmi:fmi3/") {
            continue;
        }
        if !name.starts_with("wasi:") {
            return Err(wasmtime::Error::msg(format!(
                "it imports {name}, expected imports of {PACKAGE} and of WASI only"
            )));
        }
        let mut linker = linker.instance(name)?;
        for (function, item) in interface.exports(engine) {
            match item {
                ComponentItem::Resource(_) => {
                    linker.resource(function, ResourceType::host::<()>(), |_, _| Ok(()))?;
                }
                ComponentItem::ComponentFunc(_) if PRINTING.contains(&function) => {
                    linker.func_wrap(function, print)?;
                }
                ComponentItem::ComponentFunc(_) => {
                    let refusal = format!("it calls {function} of {name}, which is not granted");
                    let function = function.to_owned();
                    linker.func_new(&function.clone(), move |mut of, given, results| {
                        for value in given {
                            if let Val::Resource(handle) = value {
                                handle.resource_drop(&mut of)?;
                            }
                        }
                        let result = nothing(&function, given, of)?;
                        let result = result.ok_or_else(|| wasmtime::Error::msg(refusal.clone()))?;
                        // The component may declare another number of results, as its types are its own.
                        results.iter_mut().for_each(|to| *to = result.clone());
                        Ok(())
                    })?;
                }
                _ => {}
            }
        }
    }
    Ok(())
}

/// What a function of WASI returns to a component that is granted nothing; `None` if that cannot be said.
fn nothing(
    function: &str,
    given: &[Val],
    of: StoreContextMut<'_, Data>,
) -> wasmtime::Result<Option<Val>> {
    Ok(Some(match (function, given) {
        ("get-arguments" | "get-environment" | "get-directories", _) => Val::List(Vec::new()),
        ("initial-cwd", _) => Val::Option(None),
        ("get-terminal-stdin" | "get-terminal-stdout" | "get-terminal-stderr", _) => {
            Val::Option(None)
        }
        // Random numbers are 0, so that a run gives the same results each time.
        ("insecure-seed", _) => Val::Tuple(vec![Val::U64(0); 2]),
        ("get-random-u64" | "get-insecure-random-u64", _) => Val::U64(0),
        ("get-random-bytes" | "get-insecure-random-bytes", [Val::U64(n @ ..4096)]) => {
            Val::List(vec![Val::U8(0); *n as usize])
        }
        ("get-stdout" | "get-stderr" | "[method]output-stream.subscribe", _) => {
            Val::Resource(Resource::<()>::new_own(0).try_into_resource_any(of)?)
        }
        ("[method]output-stream.check-write", _) => Val::Result(Ok(Some(Box::new(Val::U64(4096))))),
        (
            "[method]output-stream.flush"
            | "[method]output-stream.blocking-flush"
            | "[method]pollable.block",
            _,
        ) => Val::Result(Ok(None)),
        _ => return Ok(None),
    }))
}

/// `stream-error` of WASI, which no call returns.
#[allow(dead_code, reason = "only its type is needed")]
#[derive(ComponentType, Lower)]
#[component(variant)]
enum StreamError {
    #[component(name = "last-operation-failed")]
    Failed(Resource<()>),
    #[component(name = "closed")]
    Closed,
}

/// Makes what a component prints a message.
#[allow(clippy::type_complexity, reason = "arguments and results are tuples")]
fn print(
    of: StoreContextMut<'_, Data>,
    (_, text): (Resource<()>, Vec<u8>),
) -> wasmtime::Result<(std::result::Result<(), StreamError>,)> {
    let text = String::from_utf8_lossy(&text).trim_end().to_owned();
    let (instance, category) = (None, Some("output".to_owned()));
    of.data().log(Logged { instance, status: Status::Ok, category, text });
    Ok((Ok(()),))
}

/// The functions that a component may import.
fn linker(engine: &Engine) -> wasmtime::Result<Linker<Data>> {
    type Context<'a> = StoreContextMut<'a, Data>;
    let mut linker = Linker::new(engine);
    let mut callbacks = linker.instance("fmi:fmi3/callbacks@3.0.0")?;
    callbacks.func_wrap(
        "log-message",
        |of: Context<'_>, (name, status, category, text): (String, State, String, String)| {
            let status = Status::from(c_int::from(status as u8));
            let (instance, category) = (Some(name), Some(category));
            of.data().log(Logged { instance, status, category, text });
            Ok(())
        },
    )?;
    for name in ["clock-update", "lock-preemption", "unlock-preemption"] {
        callbacks.func_wrap(name, |_: Context<'_>, (): ()| Ok(()))?;
    }
    let mut updates = linker.instance("fmi:fmi3/intermediate-update-callbacks@3.0.0")?;
    updates.func_wrap(
        "intermediate-update",
        |of: Context<'_>, flags: (f64, bool, bool, bool, bool)| {
            let (time, set_requested, get_allowed, step_finished, can_return_early) = flags;
            let update =
                Intermediate { time, set_requested, get_allowed, step_finished, can_return_early };
            let request =
                logger::update_of(ptr::without_provenance_mut(of.data().callbacks), update);
            Ok(((request.is_some(), request.unwrap_or_default()),))
        },
    )?;
    let mut resources = linker.instance("fmi:fmi3/resource-dir-callbacks@3.0.0")?;
    resources.func_wrap("read-file", |of: Context<'_>, (path,): (String,)| {
        Ok((read(&of.data().resources, &path),))
    })?;
    Ok(linker)
}

/// Reads a file in the folder of resources.
fn read(folder: &Path, path: &str) -> std::result::Result<Vec<u8>, String> {
    let is_inside = Path::new(path).components().all(|part| matches!(part, Part::Normal(_)));
    match is_inside {
        true => fs::read(folder.join(path)).map_err(|error| format!("{path}: {error}")),
        false => Err(format!("{path} is not in the folder of resources")),
    }
}

impl Data {
    fn log(&self, message: Logged) {
        if self.has_logger {
            logger::deliver(ptr::without_provenance_mut(self.callbacks), || message);
        }
    }

    /// Says why a call did not return.
    fn log_fatal(&self, error: &wasmtime::Error, limit: Option<Duration>) {
        let text = match (error.downcast_ref(), limit) {
            (Some(Trap::Interrupt), Some(limit)) => {
                format!("not done after {} s", limit.as_secs_f64())
            }
            (Some(trap), _) => trap.to_string(),
            (None, _) => error.root_cause().to_string(),
        };
        let category = Some("logStatusFatal".to_owned());
        self.log(Logged { instance: None, status: Status::Fatal, category, text });
    }
}

/// A method of a component.
struct Method {
    function: Option<Func>,
    /// Whether it has the types that it is called with.
    is_checked: bool,
}

impl Instance {
    /// Calls a method.
    fn call<P, R>(
        &mut self,
        method: fn(&mut Methods) -> &mut Method,
        arguments: P,
    ) -> Called<R::Results>
    where
        P: ComponentNamedList + Lower,
        R: Returned,
        (R,): ComponentNamedList + Lift,
    {
        let method = method(&mut self.methods);
        let function = method.function.ok_or(TYPE)?;
        if !method.is_checked {
            function.typed::<P, (R,)>(&self.store).map_err(|_| TYPE)?;
            method.is_checked = true;
        }
        // SAFETY: the types were checked, and each method is called by one function below.
        let function = unsafe { TypedFunc::<P, (R,)>::new_unchecked(function) };
        self.store.set_epoch_deadline(self.ticks);
        let called = function.call(&mut self.store, arguments).and_then(|(result,)| {
            function.post_return(&mut self.store)?;
            Ok(result)
        });
        let result = called.map_err(|error| {
            self.store.data().log_fatal(&error, self.limit);
            TRAPPED
        })?;
        result.results()
    }
}

type Called<T = ()> = std::result::Result<T, fmi3Status>;

/// What a method returns: a status, or its results.
trait Returned {
    type Results;

    fn results(self) -> Called<Self::Results>;
}

impl Returned for State {
    type Results = ();

    fn results(self) -> Called {
        match self {
            Self::Ok => Ok(()),
            state => Err(fmi3Status(state as c_int)),
        }
    }
}

impl<T> Returned for Answer<T> {
    type Results = T;

    fn results(self) -> Called<T> {
        self.map_err(|state| match state {
            // Without results.
            State::Ok | State::Warning => fmi3Error,
            state => fmi3Status(state as c_int),
        })
    }
}

/// Copies the results of a method.
fn copy<T: Copy>(values: &[T], to: &mut [T]) -> Called {
    if values.len() != to.len() {
        return Err(LENGTH);
    }
    to.copy_from_slice(values);
    Ok(())
}

fn status(called: Called) -> fmi3Status {
    called.err().unwrap_or(fmi3OK)
}

/// Defines the methods, in the forms that the rows tell. The others follow.
macro_rules! methods {
    (
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident $arguments:tt => $operation:ident in $($states:ident)|+;)* })*
    ) => {
        #[allow(dead_code, reason = "the host does not call all of them")]
        struct Methods { $($($operation: Method,)*)* }

        impl Methods {
            fn find(mut find: impl FnMut(&str) -> Option<Func>) -> Self {
                Self {
                    $($($operation: Method { function: find(stringify!($operation)), is_checked: false },)*)*
                }
            }
        }

        #[allow(dead_code, reason = "as above")]
        impl Instance {
            $($(method!($name $arguments $operation);)*)*
        }
    };
}

macro_rules! method {
    (fmi3GetBoolean $($rest:tt)*) => {};
    (fmi3SetBoolean $($rest:tt)*) => {};
    (fmi3GetString $($rest:tt)*) => {};
    (fmi3SetString $($rest:tt)*) => {};
    ($name:ident(
        references: [in u32; n], n: [len], values: [out $type:ty; n_values], n_values: [len]
    ) $operation:ident) => {
        method!(@get $operation(references: &[u32]) $type);
    };
    ($name:ident(values: [out f64; n], n: [len]) $operation:ident) => {
        method!(@get $operation() f64);
    };
    ($name:ident(
        unknowns: [in u32; $_0:ident], $_1:ident: [len], knowns: [in u32; $_2:ident], $_3:ident: [len],
        seed: [in f64; $_4:ident], $_5:ident: [len], sensitivity: [out f64; $_6:ident], $_7:ident: [len]
    ) $operation:ident) => {
        method!(@get $operation(unknowns: &[u32], knowns: &[u32], seed: &[f64]) f64);
    };
    (@get $operation:ident($($arg:ident: $of:ty),*) $type:ty) => {
        pub(crate) fn $operation(&mut self, $($arg: $of,)* values: &mut [$type]) -> fmi3Status {
            let got = self.call::<_, Answer<Vec<$type>>>(|m| &mut m.$operation, (self.handle, $($arg),*));
            status(got.and_then(|got| copy(&got, values)))
        }
    };
    ($name:ident(
        references: [in u32; n], n: [len], values: [in $type:ty; n_values], n_values: [len]
    ) $operation:ident) => {
        method!(@plain $operation(references: &[u32], values: &[$type]));
    };
    ($name:ident(states: [in f64; n], n: [len]) $operation:ident) => {
        method!(@plain $operation(states: &[f64]));
    };
    ($name:ident($($arg:ident: f64)?) $operation:ident) => {
        method!(@plain $operation($($arg: f64)?));
    };
    (@plain $operation:ident($($arg:ident: $of:ty),*)) => {
        pub(crate) fn $operation(&mut self $(, $arg: $of)*) -> fmi3Status {
            status(self.call::<_, State>(|m| &mut m.$operation, (self.handle, $($arg),*)))
        }
    };
    ($name:ident(n: [out usize]) $operation:ident) => {
        pub(crate) fn $operation(&mut self, n: &mut usize) -> fmi3Status {
            let got = self.call::<_, Answer<u64>>(|m| &mut m.$operation, (self.handle,));
            status(got.map(|got| *n = usize::try_from(got).unwrap_or(usize::MAX)))
        }
    };
    ($($other:tt)*) => {};
}

fmi3_functions!(methods!);

/// Defines methods that get and set truth values.
macro_rules! truth {
    ($($get:ident $set:ident;)*) => { $(
        pub(crate) fn $get(&mut self, references: &[u32], values: &mut [u8]) -> fmi3Status {
            let got = self.call::<_, Answer<Vec<bool>>>(|m| &mut m.$get, (self.handle, references));
            status(got.and_then(|got| copy(&Vec::from_iter(got.into_iter().map(u8::from)), values)))
        }

        pub(crate) fn $set(&mut self, references: &[u32], values: &[u8]) -> fmi3Status {
            let values = Vec::from_iter(values.iter().map(|value| *value != 0));
            let given = (self.handle, references, values.as_slice());
            status(self.call::<_, State>(|m| &mut m.$set, given))
        }
    )* };
}

/// The texts of the host.
fn strings(texts: &[fmi3String]) -> Vec<String> {
    // SAFETY: the pointers of the host are valid, and its texts are terminated by zero.
    let text = |text: &fmi3String| unsafe { CStr::from_ptr(*text) };
    texts.iter().map(|t| text(t).to_string_lossy().into_owned()).collect()
}

impl Instance {
    truth! {
        get_boolean set_boolean;
        get_clock set_clock;
    }

    pub(crate) fn set_debug_logging(&mut self, on: bool, categories: &[fmi3String]) -> fmi3Status {
        let given = (self.handle, on, &*strings(categories));
        status(self.call::<_, State>(|m| &mut m.set_debug_logging, given))
    }

    pub(crate) fn enter_initialization_mode(
        &mut self,
        has_tolerance: bool,
        tolerance: f64,
        start: f64,
        has_stop: bool,
        stop: f64,
    ) -> fmi3Status {
        let (tolerance, stop) = (has_tolerance.then_some(tolerance), has_stop.then_some(stop));
        let given = (self.handle, tolerance, start, stop);
        status(self.call::<_, State>(|m| &mut m.enter_initialization_mode, given))
    }

    pub(crate) fn get_string(&mut self, r: &[u32], values: &mut [fmi3String]) -> fmi3Status {
        let got = self.call::<_, Answer<Vec<String>>>(|m| &mut m.get_string, (self.handle, r));
        status(got.and_then(|texts| {
            let texts = texts.into_iter().map(CString::new);
            self.texts = texts.collect::<std::result::Result<_, _>>().map_err(|_| ZERO_BYTE)?;
            copy(&Vec::from_iter(self.texts.iter().map(|text| text.as_ptr())), values)
        }))
    }

    pub(crate) fn set_string(&mut self, r: &[u32], values: &[fmi3String]) -> fmi3Status {
        let given = (self.handle, r, &*strings(values));
        status(self.call::<_, State>(|m| &mut m.set_string, given))
    }

    pub(crate) fn get_binary(
        &mut self,
        r: &[u32],
        sizes: &mut [usize],
        values: &mut [fmi3Binary],
    ) -> fmi3Status {
        let got = self.call::<_, Answer<Vec<Vec<u8>>>>(|m| &mut m.get_binary, (self.handle, r));
        status(got.and_then(|bytes| {
            self.bytes = bytes;
            copy(&Vec::from_iter(self.bytes.iter().map(Vec::len)), sizes)?;
            copy(&Vec::from_iter(self.bytes.iter().map(|bytes| bytes.as_ptr())), values)
        }))
    }

    pub(crate) fn set_binary(
        &mut self,
        r: &[u32],
        sizes: &[usize],
        values: &[fmi3Binary],
    ) -> fmi3Status {
        let values = sizes.iter().zip(values).map(|(size, first)| match size {
            0 => &[][..],
            // SAFETY: the pointers of the host are valid for the sizes.
            size => unsafe { std::slice::from_raw_parts(*first, *size) },
        });
        let given = (self.handle, r, &*Vec::from_iter(values));
        status(self.call::<_, State>(|m| &mut m.set_binary, given))
    }

    pub(crate) fn get_output_derivatives(
        &mut self,
        r: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> fmi3Status {
        let requests = r.iter().zip(orders).map(|(r, order)| (*r, order.cast_unsigned()));
        let given = (self.handle, &*Vec::from_iter(requests));
        let got = self.call::<_, Answer<Vec<f64>>>(|m| &mut m.get_output_derivatives, given);
        status(got.and_then(|got| copy(&got, values)))
    }

    #[allow(clippy::too_many_arguments, reason = "as in the standard")]
    pub(crate) fn do_step(
        &mut self,
        time: f64,
        step: f64,
        no_set_state: bool,
        event_handling_needed: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
        early_return: &mut fmi3Boolean,
        last_successful_time: &mut f64,
    ) -> fmi3Status {
        let given = (self.handle, time, step, no_set_state);
        let stepped = self.call::<_, Answer<DoStepResult>>(|m| &mut m.do_step, given);
        status(stepped.map(|stepped| {
            *event_handling_needed = stepped.event_handling_needed.into();
            *terminate = stepped.terminate.into();
            *early_return = stepped.early_return.into();
            *last_successful_time = stepped.last_successful_time;
        }))
    }

    pub(crate) fn update_discrete_states(
        &mut self,
        again: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
        nominals_changed: &mut fmi3Boolean,
        states_changed: &mut fmi3Boolean,
        next_event_defined: &mut fmi3Boolean,
        next_event: &mut f64,
    ) -> fmi3Status {
        type Info = Answer<DiscreteStatesInfo>;
        let updated = self.call::<_, Info>(|m| &mut m.update_discrete_states, (self.handle,));
        status(updated.map(|info| {
            *again = info.again.into();
            *terminate = info.terminate.into();
            *nominals_changed = info.nominals_changed.into();
            *states_changed = info.states_changed.into();
            *next_event_defined = info.next_event_defined.into();
            *next_event = info.next_event;
        }))
    }

    pub(crate) fn completed_integrator_step(
        &mut self,
        no_set_state: bool,
        enter_event_mode: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
    ) -> fmi3Status {
        type Flags = Answer<CompletedStepResult>;
        let given = (self.handle, no_set_state);
        let completed = self.call::<_, Flags>(|m| &mut m.completed_integrator_step, given);
        status(completed.map(|flags| {
            *enter_event_mode = flags.enter_event_mode.into();
            *terminate = flags.terminate.into();
        }))
    }

    pub(crate) fn get_fmu_state(&mut self, state: &mut Saved) -> fmi3Status {
        let got = self.call::<_, Answer<Vec<u8>>>(|m| &mut m.get_fmu_state, (self.handle,));
        status(got.map(|bytes| state.replace(Some(bytes))))
    }

    pub(crate) fn set_fmu_state(&mut self, state: &Saved) -> fmi3Status {
        match state.bytes() {
            Some(bytes) => {
                let given = (self.handle, bytes);
                status(self.call::<_, State>(|m| &mut m.set_fmu_state, given))
            }
            None => fmi3Error,
        }
    }

    pub(crate) fn free_fmu_state(&mut self, state: &mut Saved) -> fmi3Status {
        state.replace(None);
        fmi3OK
    }

    pub(crate) fn serialized_fmu_state_size(&mut self, state: &Saved, n: &mut usize) -> fmi3Status {
        *n = state.bytes().map_or(0, <[u8]>::len);
        fmi3OK
    }

    pub(crate) fn serialize_fmu_state(&mut self, state: &Saved, bytes: &mut [u8]) -> fmi3Status {
        status(copy(state.bytes().unwrap_or_default(), bytes))
    }

    pub(crate) fn deserialize_fmu_state(&mut self, bytes: &[u8], state: &mut Saved) -> fmi3Status {
        state.replace(Some(bytes.to_vec()));
        fmi3OK
    }
}

impl Saved {
    /// The bytes of a component's state.
    fn bytes(&self) -> Option<&[u8]> {
        // SAFETY: the state of an instance of a component is NULL or from the function below.
        unsafe { self.0.cast::<Vec<u8>>().as_ref() }.map(Vec::as_slice)
    }

    fn replace(&mut self, bytes: Option<Vec<u8>>) {
        if !self.0.is_null() {
            // SAFETY: as above, and it is replaced.
            drop(unsafe { Box::from_raw(self.0.cast::<Vec<u8>>()) });
        }
        self.0 = bytes.map_or(ptr::null_mut(), |bytes| Box::into_raw(Box::new(bytes)).cast());
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.store.set_epoch_deadline(self.ticks);
        // A component that has trapped cannot drop anything.
        let _ = self.handle.resource_drop(&mut self.store);
    }
}
