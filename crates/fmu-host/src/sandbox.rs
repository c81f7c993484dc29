//! WebAssembly components, run by wasmtime: the interface of the draft FMI-LS-WASM, which `component.wit` of the
//! crate `fmu-build` lists.
//!
//! Each operation of FMI 3.0 is here a method, made from the rows of `fmi-abi`, with the arguments of the function in C
//! as slices. It calls the method of the component that performs the operation. Each instance has a component of its
//! own, with its own memory.

mod abi;
mod cycle;
mod host;
mod link;

use std::ffi::{CStr, CString, c_int, c_void};
use std::fs;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::{Once, OnceLock};
use std::time::Duration;

use fmi_abi::fmi3::*;
use fmi_abi::{InterfaceType, fmi3_functions};
use wasmtime::{Config, Engine, Module, ResourceLimiter, Store, Trap};

use self::abi::{Answer, Fault, Given};
use self::cycle::{Cycle, Cycling};
use self::link::{Function, Linked, Parts};
use crate::logger::{self, LogMessage};
use crate::outcome::{Cause, Failure, Result, Status};
use crate::types::{FmuState as Saved, Instantiation, Treatment};

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
    engine: &'static Engine,
    parts: Parts,
}

/// What the functions that a component imports need.
#[derive(Default)]
struct Data {
    /// The key of the callbacks.
    callbacks: usize,
    has_logger: bool,
    resources: PathBuf,
    memory: Memory,
    /// The start of a line that the component prints, and its status if there is one.
    printed: Vec<u8>,
    unended: Option<Status>,
    /// Handles that components have borrowed from each other, with their tables; `None` where a call began.
    borrowed: Vec<Option<(i32, i32)>>,
}

/// The memory that an instance may still take in bytes, with that of its tables.
#[derive(Default)]
struct Memory(usize);

impl Memory {
    /// Takes memory for something that grows, if its own maximum allows that.
    fn grow(
        &mut self,
        (from, to, maximum): (usize, usize, Option<usize>),
        (what, unit): (&str, usize),
    ) -> wasmtime::Result<bool> {
        if maximum.is_some_and(|maximum| to > maximum) {
            return Ok(false);
        }
        let rest = self.0.checked_sub((to - from).saturating_mul(unit));
        self.0 = rest.ok_or_else(|| {
            wasmtime::Error::msg(format!("it exceeds its memory limit by growing {what}"))
        })?;
        Ok(true)
    }
}

impl ResourceLimiter for Memory {
    fn memory_growing(
        &mut self,
        from: usize,
        to: usize,
        maximum: Option<usize>,
    ) -> wasmtime::Result<bool> {
        self.grow((from, to, maximum), ("memory", 1))
    }

    fn table_growing(
        &mut self,
        from: usize,
        to: usize,
        maximum: Option<usize>,
    ) -> wasmtime::Result<bool> {
        self.grow((from, to, maximum), ("table", size_of::<usize>()))
    }

    // A component has one or two of each.
    fn memories(&self) -> usize {
        10
    }

    fn tables(&self) -> usize {
        10
    }
}

/// An instance of a component.
pub(crate) struct Instance {
    store: Store<Data>,
    /// By operation.
    methods: Vec<Method>,
    /// What the component calls the instance.
    handle: u32,
    /// The function that ends the instance.
    end: Option<Function>,
    cycle: Option<Cycle>,
    /// Whether a call has trapped, so that there are no more calls.
    is_over: bool,
    /// The time that a call has, in periods of [`TICK`].
    ticks: u64,
    limit: Option<Duration>,
    /// What the host has a pointer to until the next call.
    texts: Vec<CString>,
    bytes: Vec<Vec<u8>>,
}

/// Its methods, what the component calls it, the function that ends it, and the one that makes the calls of a step.
type Made = (Vec<Method>, u32, Option<Function>, Option<Cycling>);

/// Interval at which the time of calls is measured.
const TICK: Duration = Duration::from_millis(10);
/// More ticks than there will be.
const FOREVER: u64 = 1 << 60;
/// The length at which lines that a component prints are cut.
const LINE: usize = 8192;

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
            Ok(Self { engine, parts: Parts::of(&bytes, |module| compiled(engine, module))? })
        };
        load().map_err(|error| format!("{error:#}"))
    }

    /// Creates an instance; `None` if the FMU refuses.
    pub(crate) fn instantiate(
        &self,
        arguments: &Instantiation<'_>,
        callbacks: *mut c_void,
    ) -> Result<Option<Box<Instance>>> {
        let function = match arguments.interface_type {
            InterfaceType::ModelExchange => "fmi3InstantiateModelExchange",
            InterfaceType::CoSimulation => "fmi3InstantiateCoSimulation",
        };
        let data = Data {
            callbacks: callbacks.addr(),
            has_logger: arguments.treatment != Treatment::NoLogger,
            resources: arguments.resources.into(),
            memory: Memory(arguments.limits.memory.unwrap_or(usize::MAX)),
            ..Data::default()
        };
        let mut store = Store::new(self.engine, data);
        store.limiter(|data| &mut data.memory);
        let limit = arguments.limits.call;
        let ticks = limit.map_or(FOREVER, |limit| {
            tick(self.engine);
            (limit.div_duration_f64(TICK) as u64).clamp(1, FOREVER)
        });
        store.set_epoch_deadline(ticks);
        match self.create(&mut store, arguments) {
            Ok(Some((methods, handle, end, cycle))) => {
                let cycle = cycle.zip(methods[Operation::set_float64 as usize].function.as_ref());
                let cycle = cycle.and_then(|(function, set)| Cycle::new(function, set));
                let (texts, bytes, is_over) = Default::default();
                Ok(Some(Box::new(Instance {
                    store,
                    methods,
                    handle,
                    end,
                    cycle,
                    is_over,
                    ticks,
                    limit,
                    texts,
                    bytes,
                })))
            }
            Err(Fault::Trap(error)) => {
                store.data_mut().log_fatal(&error, limit);
                Err(Failure::new(function, Cause::Trapped))
            }
            Ok(None) | Err(Fault::Status(_)) => Ok(None),
        }
    }

    fn create(
        &self,
        store: &mut Store<Data>,
        arguments: &Instantiation<'_>,
    ) -> std::result::Result<Option<Made>, Fault> {
        let kind = name(arguments.interface_type);
        let linked = Linked::new(&self.parts, store)?;
        let interface = format!("{PACKAGE}/{kind}@3.0.0");
        let create = format!("[static]{kind}-instance.instantiate-{kind}");
        let create = linked.find(store, &interface, &create)?;
        let create = create.ok_or_else(|| wasmtime::Error::msg(format!("it has no {kind}")))?;
        let methods = OPERATIONS.iter().map(|operation| {
            let method = format!("[method]{kind}-instance.{}", operation.replace('_', "-"));
            let function = linked.find(store, &interface, &method)?;
            Ok(Method { function, is_checked: false })
        });
        let methods = methods.collect::<wasmtime::Result<_>>()?;
        let end = linked.find(store, &interface, &format!("{kind}-instance"))?;
        let Instantiation { name, guid, logging_on, event_mode_used, .. } = *arguments;
        let (early, variables) = (arguments.early_return_allowed, arguments.intermediate_variables);
        let (mut types, mut given) = ("string,string", vec![Given::text(name), Given::text(guid)]);
        // Until commit 77277f4 of the draft, there is a path of resources, which components cannot read.
        if create.signature.starts_with("string,string,string") {
            types = "string,string,string";
            given.push(Given::text(""));
        }
        given.extend([false.into(), logging_on.into()]);
        let mut more = "bool,bool";
        if arguments.interface_type == InterfaceType::CoSimulation {
            more = "bool,bool,bool,bool,list<u32>";
            given.extend([event_mode_used.into(), early.into(), Given::list(variables)]);
        }
        if *create.signature != *format!("{types},{more}->option<own>") {
            return Err(mistyped().into());
        }
        // SAFETY: the types were checked.
        let handle = unsafe { abi::call(store, &create, None, &given, |answer| answer.option()) };
        Ok(handle?.map(|handle| (methods, handle, end, linked.cycle)))
    }

    /// The result of `fmi3GetVersion`.
    pub(crate) fn version(&self) -> Result<String> {
        let get = || {
            let mut store = Store::new(self.engine, Data::default());
            store.set_epoch_deadline(FOREVER);
            let linked = Linked::new(&self.parts, &mut store)?;
            let get = linked.find(&mut store, "fmi:fmi3/common@3.0.0", "get-version")?;
            let get = get.filter(|get| &*get.signature == "->string").ok_or_else(mistyped)?;
            // SAFETY: the types were checked.
            unsafe {
                abi::call(&mut store, &get, None, &[], |answer| Ok(answer.text()?.to_owned()))
            }
        };
        get().map_err(|_: Fault| Failure::new("fmi3GetVersion", Cause::Trapped))
    }
}

fn mistyped() -> wasmtime::Error {
    wasmtime::Error::msg("a function is missing, or is not of its type")
}

const PACKAGE: &str = "fmi:fmi3";
fn name(interface_type: InterfaceType) -> &'static str {
    match interface_type {
        InterfaceType::ModelExchange => "model-exchange",
        InterfaceType::CoSimulation => "co-simulation",
    }
}

/// Compiles a module. The compiled code is kept in a file that is named by the hash of the module.
fn compiled(engine: &Engine, bytes: &[u8]) -> wasmtime::Result<Module> {
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
        if let Ok(module) = unsafe { Module::deserialize_file(engine, file) } {
            return Ok(module);
        }
    }
    let module = Module::from_binary(engine, bytes)?;
    if let (Some(file), Ok(code)) = (file, module.serialize()) {
        // A cache that cannot be written costs time only.
        let _ = keep(&file, &code);
    }
    Ok(module)
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

impl Data {
    fn log(&self, message: LogMessage) {
        if self.has_logger {
            logger::deliver(ptr::without_provenance_mut(self.callbacks), || message);
        }
    }

    /// Logs what the component prints, line by line. A line may come in parts.
    fn print(&mut self, status: Status, bytes: &[u8]) {
        for byte in bytes {
            let is_end = *byte == b'\n';
            if !is_end {
                self.printed.push(*byte);
            }
            if is_end || self.printed.len() == LINE {
                self.end_line(status);
            }
        }
        self.unended = (!self.printed.is_empty()).then_some(status);
    }

    /// Logs a line that has no end.
    fn flush(&mut self) {
        if let Some(status) = self.unended.take() {
            self.end_line(status);
        }
    }

    fn end_line(&mut self, status: Status) {
        let text = String::from_utf8_lossy(&self.printed).trim_end().to_owned();
        self.printed.clear();
        self.log(LogMessage { instance: None, status, category: Some("output".to_owned()), text });
    }

    /// Says why a call did not return.
    fn log_fatal(&mut self, error: &wasmtime::Error, limit: Option<Duration>) {
        self.flush();
        let text = match (error.downcast_ref(), limit) {
            (Some(Trap::Interrupt), Some(limit)) => {
                format!("not done after {} s", limit.as_secs_f64())
            }
            (Some(trap), _) => trap.to_string(),
            (None, _) => error.root_cause().to_string(),
        };
        let category = Some("logStatusFatal".to_owned());
        self.log(LogMessage { instance: None, status: Status::Fatal, category, text });
    }
}

/// A method of a component.
struct Method {
    function: Option<Function>,
    /// Whether it has the types that it is called with.
    is_checked: bool,
}

impl Instance {
    /// Calls a method of a type that returns a status.
    #[inline(always)]
    fn order(&mut self, operation: Operation, of: &'static str, given: &[Given<'_>]) -> Called {
        self.call(operation, of, given, |answer| answer.status())
    }

    /// Calls a method of a type.
    #[inline(always)]
    fn call<R>(
        &mut self,
        operation: Operation,
        of: &'static str,
        given: &[Given<'_>],
        read: impl FnOnce(Answer<'_>) -> std::result::Result<R, Fault>,
    ) -> Called<R> {
        let method = &mut self.methods[operation as usize];
        let function = method.function.as_ref().ok_or(TYPE)?;
        if !method.is_checked {
            if &*function.signature != of {
                return Err(TYPE);
            }
            method.is_checked = true;
        }
        if self.is_over {
            return Err(TRAPPED);
        }
        self.store.set_epoch_deadline(self.ticks);
        // SAFETY: the types were checked, and each method is called by one function below.
        let called =
            unsafe { abi::call(&mut self.store, function, Some(self.handle), given, read) };
        called.map_err(|fault| match fault {
            Fault::Status(status) => status,
            Fault::Trap(error) => self.trapped(&error),
        })
    }

    #[cold]
    fn trapped(&mut self, error: &wasmtime::Error) -> fmi3Status {
        self.store.data_mut().log_fatal(error, self.limit);
        self.is_over = true;
        TRAPPED
    }
}

type Called<T = ()> = std::result::Result<T, fmi3Status>;

/// A Boolean of a record or a list.
fn boolean(byte: u8) -> fmi3Boolean {
    (byte != 0).into()
}

fn status(called: Called) -> fmi3Status {
    called.err().unwrap_or(fmi3OK)
}

/// Copies values.
fn copy<T: Copy>(values: &[T], to: &mut [T]) -> Called {
    if values.len() != to.len() {
        return Err(LENGTH);
    }
    to.copy_from_slice(values);
    Ok(())
}

/// Defines the methods, in the forms that the rows tell. The others follow.
macro_rules! methods {
    (
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident $arguments:tt => $operation:ident in $($states:ident)|+;)* })*
    ) => {
        #[allow(non_camel_case_types, dead_code, reason = "the host does not call all of them")]
        #[derive(Clone, Copy)]
        enum Operation { $($($operation),*),* }

        const OPERATIONS: &[&str] = &[$($(stringify!($operation)),*),*];

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
    (fmi3Terminate $($rest:tt)*) => {};
    ($name:ident(
        references: [in u32; n], n: [len], values: [out $type:ident; n_values], n_values: [len]
    ) $operation:ident) => {
        method!(@get $operation(references: u32) $type);
    };
    ($name:ident(values: [out f64; n], n: [len]) $operation:ident) => {
        method!(@get $operation() f64);
    };
    ($name:ident(
        unknowns: [in u32; $_0:ident], $_1:ident: [len], knowns: [in u32; $_2:ident], $_3:ident: [len],
        seed: [in f64; $_4:ident], $_5:ident: [len], sensitivity: [out f64; $_6:ident], $_7:ident: [len]
    ) $operation:ident) => {
        method!(@get $operation(unknowns: u32, knowns: u32, seed: f64) f64);
    };
    (@get $operation:ident($($arg:ident: $of:ident),*) $type:ident) => {
        pub(crate) fn $operation(&mut self, $($arg: &[$of],)* values: &mut [$type]) -> fmi3Status {
            let of = concat!(
                "borrow" $(, ",list<", wit!($of), ">")*, "->result<list<", wit!($type), ">,status>"
            );
            let given = [$(Given::list($arg)),*];
            status(self.call(Operation::$operation, of, &given, |answer| answer.copy(values, LENGTH)))
        }
    };
    ($name:ident(
        references: [in u32; n], n: [len], values: [in $type:ident; n_values], n_values: [len]
    ) $operation:ident) => {
        method!(@set $operation(references: u32, values: $type));
    };
    ($name:ident(states: [in f64; n], n: [len]) $operation:ident) => {
        method!(@set $operation(states: f64));
    };
    ($name:ident() $operation:ident) => {
        method!(@set $operation());
    };
    (@set $operation:ident($($arg:ident: $of:ident),*)) => {
        pub(crate) fn $operation(&mut self $(, $arg: &[$of])*) -> fmi3Status {
            let of = concat!("borrow" $(, ",list<", wit!($of), ">")*, "->status");
            let given = [$(Given::list($arg)),*];
            status(self.order(Operation::$operation, of, &given))
        }
    };
    ($name:ident($arg:ident: f64) $operation:ident) => {
        pub(crate) fn $operation(&mut self, $arg: f64) -> fmi3Status {
            let given = [Given::Float($arg)];
            status(self.order(Operation::$operation, "borrow,f64->status", &given))
        }
    };
    ($name:ident(n: [out usize]) $operation:ident) => {
        pub(crate) fn $operation(&mut self, n: &mut usize) -> fmi3Status {
            let of = "borrow->result<u64,status>";
            let got = self.call(Operation::$operation, of, &[], |answer| answer.result(8));
            status(got.map(|got| *n = usize::try_from(u64::from_le_bytes(got)).unwrap_or(usize::MAX)))
        }
    };
    ($($other:tt)*) => {};
}

/// The name of a type in WIT.
macro_rules! wit {
    (i8) => {
        "s8"
    };
    (i16) => {
        "s16"
    };
    (i32) => {
        "s32"
    };
    (i64) => {
        "s64"
    };
    ($type:ident) => {
        stringify!($type)
    };
}

fmi3_functions!(methods!);

/// The texts of the host.
fn strings(texts: &[fmi3String]) -> Vec<String> {
    // SAFETY: the pointers of the host are valid, and its texts are terminated by zero.
    let text = |text: &fmi3String| unsafe { CStr::from_ptr(*text) };
    texts.iter().map(|t| text(t).to_string_lossy().into_owned()).collect()
}

impl Instance {
    pub(crate) fn get_boolean(&mut self, r: &[u32], values: &mut [fmi3Boolean]) -> fmi3Status {
        let of = "borrow,list<u32>->result<list<bool>,status>";
        status(self.call(Operation::get_boolean, of, &[Given::list(r)], |answer| {
            answer.copy(values, LENGTH)?;
            values.iter_mut().for_each(|value| *value = boolean(*value));
            Ok(())
        }))
    }

    pub(crate) fn set_boolean(&mut self, r: &[u32], values: &[fmi3Boolean]) -> fmi3Status {
        let values = Vec::from_iter(values.iter().map(|value| boolean(*value)));
        let given = [Given::list(r), Given::list(&values)];
        status(self.order(Operation::set_boolean, "borrow,list<u32>,list<bool>->status", &given))
    }

    pub(crate) fn set_debug_logging(&mut self, on: bool, categories: &[fmi3String]) -> fmi3Status {
        let texts = strings(categories);
        let texts = Vec::from_iter(texts.iter().map(String::as_bytes));
        let given = [on.into(), Given::Lists(&texts)];
        let of = "borrow,bool,list<string>->status";
        status(self.order(Operation::set_debug_logging, of, &given))
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
        let ([a, b], [c, d]) = (Given::option(tolerance), Given::option(stop));
        let given = [a, b, Given::Float(start), c, d];
        let of = "borrow,option<f64>,f64,option<f64>->status";
        status(self.order(Operation::enter_initialization_mode, of, &given))
    }

    pub(crate) fn get_string(&mut self, r: &[u32], values: &mut [fmi3String]) -> fmi3Status {
        let of = "borrow,list<u32>->result<list<string>,status>";
        let given = [Given::list(r)];
        let got = self.call(Operation::get_string, of, &given, |answer| {
            let texts = answer.lists()?.into_iter();
            let texts = texts.map(|bytes| Ok(CString::new(abi::text(bytes)?)));
            Ok(texts.collect::<wasmtime::Result<std::result::Result<Vec<_>, _>>>()?)
        });
        let got = got.and_then(|texts| texts.map_err(|_| ZERO_BYTE));
        status(got.and_then(|texts| {
            self.texts = texts;
            copy(&Vec::from_iter(self.texts.iter().map(|text| text.as_ptr())), values)
        }))
    }

    pub(crate) fn set_string(&mut self, r: &[u32], values: &[fmi3String]) -> fmi3Status {
        let texts = strings(values);
        let texts = Vec::from_iter(texts.iter().map(String::as_bytes));
        let given = [Given::list(r), Given::Lists(&texts)];
        status(self.order(Operation::set_string, "borrow,list<u32>,list<string>->status", &given))
    }

    pub(crate) fn get_binary(
        &mut self,
        r: &[u32],
        sizes: &mut [usize],
        values: &mut [fmi3Binary],
    ) -> fmi3Status {
        let of = "borrow,list<u32>->result<list<list<u8>>,status>";
        let given = [Given::list(r)];
        let got = self.call(Operation::get_binary, of, &given, |answer| {
            Ok(answer.lists()?.into_iter().map(<[u8]>::to_vec).collect())
        });
        status(got.and_then(|bytes| {
            self.bytes = bytes;
            copy(&Vec::from_iter(self.bytes.iter().map(Vec::len)), sizes)?;
            copy(&Vec::from_iter(self.bytes.iter().map(|bytes| bytes.as_ptr())), values)
        }))
    }

    pub(crate) fn get_output_derivatives(
        &mut self,
        r: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> fmi3Status {
        let requests = r.iter().zip(orders).flat_map(|(r, order)| [*r, order.cast_unsigned()]);
        let requests = Vec::from_iter(requests);
        let given = [Given::pairs(&requests)];
        let of = "borrow,list<tuple<u32,u32>>->result<list<f64>,status>";
        status(self.call(Operation::get_output_derivatives, of, &given, |answer| {
            answer.copy(values, LENGTH)
        }))
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
        let [time, step] = [time, step].map(Given::Float);
        let given = [time, step, no_set_state.into()];
        let of = "borrow,f64,f64,bool->result<record<f64,bool,bool,bool>,status>";
        status(self.call(Operation::do_step, of, &given, |answer| {
            let [time @ .., a, b, c] = answer.result::<11>(8)?;
            *last_successful_time = f64::from_le_bytes(time);
            [*event_handling_needed, *terminate, *early_return] = [a, b, c].map(boolean);
            Ok(())
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
        let of = "borrow->result<record<bool,bool,bool,bool,bool,f64>,status>";
        status(self.call(Operation::update_discrete_states, of, &[], |answer| {
            let [a, b, c, d, e, _, _, _, time @ ..] = answer.result::<16>(8)?;
            [*again, *terminate, *nominals_changed, *states_changed, *next_event_defined] =
                [a, b, c, d, e].map(boolean);
            *next_event = f64::from_le_bytes(time);
            Ok(())
        }))
    }

    pub(crate) fn completed_integrator_step(
        &mut self,
        no_set_state: bool,
        enter_event_mode: &mut fmi3Boolean,
        terminate: &mut fmi3Boolean,
    ) -> fmi3Status {
        let given = [no_set_state.into()];
        let of = "borrow,bool->result<record<bool,bool>,status>";
        status(self.call(Operation::completed_integrator_step, of, &given, |answer| {
            [*enter_event_mode, *terminate] = answer.result(1)?.map(boolean);
            Ok(())
        }))
    }

    pub(crate) fn terminate(&mut self) -> fmi3Status {
        let terminated = self.order(Operation::terminate, "borrow->status", &[]);
        self.store.data_mut().flush();
        status(terminated)
    }

    pub(crate) fn get_fmu_state(&mut self, state: &mut Saved) -> fmi3Status {
        let of = "borrow->result<list<u8>,status>";
        status(self.call(Operation::get_fmu_state, of, &[], |answer| {
            state.replace(Some(answer.list(1)?.to_vec()));
            Ok(())
        }))
    }

    pub(crate) fn set_fmu_state(&mut self, state: &Saved) -> fmi3Status {
        let Some(bytes) = state.bytes() else { return fmi3Error };
        let given = [Given::list(bytes)];
        status(self.order(Operation::set_fmu_state, "borrow,list<u8>->status", &given))
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
        // A component that has trapped cannot free anything.
        if let Some(end) = self.end.as_ref().filter(|_| !self.is_over) {
            // SAFETY: the function ends a resource, for which it gets what the handle stands for.
            let _ = unsafe { abi::call(&mut self.store, end, Some(self.handle), &[], |_| Ok(())) };
        }
        self.store.data_mut().flush();
    }
}
