//! A driver for all edges: instances, what they call back, and a method for each operation, which calls the
//! linked function of the instance's version. Methods of one version fail for the other.

use std::cell::{Cell, RefCell};
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ops::Deref;
use std::ptr::{null, null_mut};
use std::sync::Once;

use fmu_description::Type;
pub use fmu_export::abi::FmiVersion::{self, Fmi2, Fmi3};
use fmu_export::abi::{fmi2_functions, fmi3_functions};
use fmu_export::{Entry, fmi2::*, fmi3::*};

use crate::models::{MODELS, fmi2Instantiate, number};

/// What an instance is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    Stepped,
    /// Co-simulation with event mode.
    Events,
    Exchanged,
}
pub use Mode::*;

/// The edge and the mode of an instance.
pub type Kind = (FmiVersion, Mode);
pub const PLAIN: [Kind; 2] = [(Fmi2, Stepped), (Fmi3, Stepped)];
pub const EXCHANGED: [Kind; 2] = [(Fmi2, Exchanged), (Fmi3, Exchanged)];
pub const EVENTS: Kind = (Fmi3, Events);
pub const KINDS: [Kind; 5] = [PLAIN[0], PLAIN[1], EVENTS, EXCHANGED[0], EXCHANGED[1]];

/// The status that a function returned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status(pub c_int);
pub const OK: Status = Status(0);
pub const WARNING: Status = Status(1);
pub const DISCARDED: Status = Status(2);
pub const ERROR: Status = Status(3);
pub const FATAL: Status = Status(4);

/// Checks that all calls succeeded.
#[track_caller]
pub fn ok<const N: usize>(statuses: [Status; N]) {
    assert_eq!(statuses, [OK; N]);
}

/// Checks that numbers are equal up to a tolerance.
#[track_caller]
pub fn near<const N: usize>(found: [f64; N], expected: [f64; N], tolerance: f64) {
    let is_near = |(found, expected): (&f64, &f64)| (found - expected).abs() < tolerance;
    let all = found.iter().zip(&expected).all(is_near);
    assert!(all, "{found:?} {expected:?}");
}

/// All pairs of two lists.
pub fn pairs<A: Copy, B: Copy>(first: &[A], second: &[B]) -> impl Iterator<Item = (A, B)> {
    let all = |&one| second.iter().map(move |&other| (one, other));
    first.iter().flat_map(all)
}

/// The arguments of a function that instantiates, and the models of the library.
#[derive(Clone)]
pub struct Arguments<'a> {
    pub models: &'static [Entry],
    pub kind: Kind,
    pub name: Option<&'a CStr>,
    pub token: Option<CString>,
    pub resources: Option<&'a CStr>,
    pub debug: bool,
    pub has_logger: bool,
    pub early_return: bool,
    /// The required intermediate variables; without, there is no callback.
    pub intermediate: Option<&'a [u32]>,
}

impl Arguments<'_> {
    pub fn of(kind: Kind, model: usize) -> Self {
        Self {
            models: MODELS,
            kind,
            name: Some(c"instance"),
            token: Some(token(model)),
            resources: None,
            debug: false,
            has_logger: true,
            early_return: false,
            intermediate: None,
        }
    }

    /// An instance for these arguments after a change.
    pub fn make(mut self, change: impl FnOnce(&mut Self)) -> Instance {
        change(&mut self);
        Instance::with(&self)
    }
}

/// The GUID of a model.
pub fn token(model: usize) -> CString {
    CString::new(MODELS[model].guid()).unwrap()
}

/// The arguments of a call of the logger; only FMI 2.0 has the name of the instance and a format.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    pub status: Status,
    pub category: String,
    pub text: String,
    pub instance: CString,
    pub format: CString,
}

impl Message {
    pub fn kind(&self) -> (&str, Status) {
        (&self.category, self.status)
    }
}

/// The arguments of the callback for intermediate updates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intermediate {
    pub time: f64,
    pub set_requested: bool,
    pub get_allowed: bool,
    pub step_finished: bool,
    pub can_return: bool,
}

/// What a host does in an intermediate update; it may request an early return at a time.
type OnUpdate = Box<dyn FnMut(Fmu, Intermediate) -> Option<f64>>;

/// What the callbacks use.
#[derive(Default)]
pub struct Host {
    instance: Cell<Option<Fmu>>,
    messages: RefCell<Vec<Message>>,
    pub updates: RefCell<Vec<Intermediate>>,
    on_update: RefCell<Option<OnUpdate>>,
}

unsafe extern "C" fn receive_2(
    host: *mut c_void,
    instance: *const c_char,
    status: c_int,
    category: *const c_char,
    format: *const c_char,
    text: *const c_char,
) {
    // SAFETY: the host comes from `Instance::with`, and the others are strings of the FMU.
    let (host, [instance, category, format, text]) = unsafe {
        let texts = [instance, category, format, text].map(|text| CStr::from_ptr(text));
        (&*host.cast::<Host>(), texts)
    };
    host.messages.borrow_mut().push(Message {
        status: Status(status),
        category: category.to_str().unwrap().to_owned(),
        text: text.to_str().unwrap().to_owned(),
        instance: instance.to_owned(),
        format: format.to_owned(),
    });
}

pub unsafe extern "C" fn receive_3(
    host: *mut c_void,
    status: c_int,
    category: *const c_char,
    text: *const c_char,
) {
    let none = c"".as_ptr();
    // SAFETY: passed on.
    unsafe { receive_2(host, none, status, category, none, text) };
}

unsafe extern "C" fn update(
    host: *mut c_void,
    time: f64,
    set_requested: fmi3Boolean,
    get_allowed: fmi3Boolean,
    step_finished: fmi3Boolean,
    can_return: fmi3Boolean,
    requested: *mut fmi3Boolean,
    return_time: *mut f64,
) {
    // SAFETY: the host comes from `Instance::with`.
    let host = unsafe { &*host.cast::<Host>() };
    let update = Intermediate {
        time,
        set_requested: set_requested == fmi3True,
        get_allowed: get_allowed == fmi3True,
        step_finished: step_finished == fmi3True,
        can_return: can_return == fmi3True,
    };
    host.updates.borrow_mut().push(update);
    let mut act = host.on_update.borrow_mut().take();
    let fmu = host.instance.get().unwrap();
    if let Some(end) = act.as_mut().and_then(|act| act(fmu, update)) {
        // SAFETY: the pointers come from the FMU.
        unsafe { (*requested, *return_time) = (fmi3True, end) };
    }
    *host.on_update.borrow_mut() = act;
}

/// Restores the panic hook, which the library replaces at the first instance, to see failed tests.
fn keep_messages_of_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: NULL is allowed for all of these.
        unsafe { fmi2Instantiate(null(), 1, null(), null(), null(), 0, 0) };
        drop(std::panic::take_hook());
    });
}

/// The host's pointer to an instance.
#[derive(Debug, Clone, Copy)]
pub struct Fmu {
    pub kind: Kind,
    pub c: *mut c_void,
}

/// An instance that is freed at its end.
pub struct Instance {
    fmu: Fmu,
    pub host: Box<Host>,
    _callbacks: Box<fmi2CallbackFunctions>,
}

impl Deref for Instance {
    type Target = Fmu;

    fn deref(&self) -> &Fmu {
        &self.fmu
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.fmu.free();
    }
}

impl Instance {
    pub fn of(kind: Kind, model: usize) -> Self {
        Self::with(&Arguments::of(kind, model))
    }

    /// An instance that runs, from 0 s: in step mode or continuous-time mode.
    #[track_caller]
    pub fn running(kind: Kind, model: usize) -> Self {
        Self::of(kind, model).run(0.0)
    }

    #[track_caller]
    pub fn run(self, time: f64) -> Self {
        self.start(time, None);
        if self.kind.1 != Stepped {
            self.update();
            self.go_on();
        }
        self
    }

    /// A new instance, which is NULL if instantiation fails.
    pub fn with(arguments: &Arguments) -> Self {
        keep_messages_of_panics();
        type Logger = unsafe extern "C" fn(
            *mut c_void,
            fmi2String,
            c_int,
            fmi2String,
            fmi2String,
            fmi2String,
        );
        let host = Box::<Host>::default();
        let environment: *mut c_void = (&raw const *host).cast_mut().cast();
        // SAFETY: with one pointer as the variable argument, both have the same calling convention on the
        // platforms of this test.
        let logger = unsafe { std::mem::transmute::<Logger, fmi2CallbackLogger>(receive_2) };
        let callbacks = Box::new(fmi2CallbackFunctions {
            logger: arguments.has_logger.then_some(logger),
            allocateMemory: None,
            freeMemory: None,
            stepFinished: None,
            componentEnvironment: environment,
        });
        let text = |text: Option<&CStr>| text.map_or(null(), CStr::as_ptr);
        let (kind, models, debug) = (arguments.kind, arguments.models, arguments.debug);
        let (name, path) = (text(arguments.name), text(arguments.resources));
        let (token, back) = (text(arguments.token.as_deref()), &raw const *callbacks);
        let log = arguments.has_logger.then_some(receive_3 as _);
        let early = arguments.early_return.into();
        let needed = arguments.intermediate.unwrap_or_default();
        let update = arguments.intermediate.map(|_| update as _);
        let (needed, n, events) = (needed.as_ptr(), needed.len(), (kind.1 == Events).into());
        // SAFETY: strings outlive the call, and host and callbacks outlive the instance.
        #[rustfmt::skip]
        let c = unsafe {
            match kind {
                (Fmi2, mode) => instantiate(
                    models, name, (mode != Exchanged).into(), token, path, back, 0, debug.into(),
                ),
                (Fmi3, Exchanged) => instantiate_model_exchange(
                    models, name, token, path, 0, debug.into(), environment, log,
                ),
                (Fmi3, _) => instantiate_co_simulation(
                    models, name, token, path, 0, debug.into(), events, early, needed, n, environment, log, update,
                ),
            }
        };
        let fmu = Fmu { kind, c };
        host.instance.set(Some(fmu));
        Self { fmu, host, _callbacks: callbacks }
    }

    pub fn messages(&self) -> Vec<Message> {
        self.host.messages.borrow().clone()
    }

    pub fn forget_messages(&self) {
        self.host.messages.borrow_mut().clear();
    }

    /// Checks that a call fails with a status and a message that contains the words.
    #[track_caller]
    pub fn fails(&self, status: Status, words: &str, call: impl FnOnce(Fmu) -> Status) {
        assert_eq!(call(self.fmu), status, "{words}");
        self.says(words);
    }

    #[track_caller]
    pub fn last_message(&self) -> String {
        let message = self.messages().pop();
        message.expect("nothing was logged").text
    }

    /// Checks that the last message has the words.
    #[track_caller]
    pub fn says(&self, words: &str) {
        let message = self.last_message();
        assert!(message.contains(words), "{words}: {message}");
    }

    /// Checks that a call fails with one message that contains the words and changes nothing.
    #[track_caller]
    pub fn refuses(&self, words: &str, call: impl FnOnce(Fmu) -> Status) {
        let before = self.snapshot();
        self.forget_messages();
        assert_eq!(call(self.fmu), ERROR, "{words}");
        let messages = self.messages();
        assert_eq!(messages.len(), 1, "{words}: {messages:?}");
        assert_eq!(messages[0].category, "logStatusError");
        assert_eq!(messages[0].status, ERROR);
        self.says(words);
        assert_eq!(self.snapshot(), before, "{words}");
    }

    /// What the host does in intermediate updates.
    pub fn on_update(&self, act: impl FnMut(Fmu, Intermediate) -> Option<f64> + 'static) {
        *self.host.on_update.borrow_mut() = Some(Box::new(act));
    }

    /// The times of the intermediate updates since the last call.
    pub fn update_times(&self) -> Vec<f64> {
        let updates = self.host.updates.take();
        updates.iter().map(|update| update.time).collect()
    }
}

/// What `fmi3DoStep` returns besides its status; without it, the step ends where the host wants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Results {
    pub event: bool,
    pub early: bool,
    pub time: f64,
}

pub fn results(event: bool, early: bool, time: f64) -> Results {
    Results { event, early, time }
}

/// `fmi2EventInfo`: its flags, and the time of the next event.
#[repr(C)]
struct Info([i32; 5], f64);

/// What an update of discrete states returns: whether states changed, and the time of the next event.
pub type Discrete = (bool, Option<f64>);

/// An argument of a function: a number, or memory for so many elements.
#[derive(Debug, Clone, Copy)]
pub struct Argument {
    number: f64,
    memory: *mut c_void,
    length: usize,
}

impl Argument {
    pub fn number(number: impl Into<f64>) -> Self {
        Self { number: number.into(), memory: null_mut(), length: 0 }
    }

    pub fn memory<T>(memory: *const T, length: usize) -> Self {
        Self { number: 0.0, memory: memory.cast_mut().cast(), length }
    }
}

macro_rules! arguments {
    ($(<$($t:ident)?> $type:ty, $value:ident => $argument:expr;)*) => {
        $(impl<$($t)?> From<$type> for Argument {
            fn from($value: $type) -> Self {
                $argument
            }
        })*
    };
}

arguments! {
    <> f64, number => Self::number(number);
    <> c_int, number => Self::number(number);
    <> bool, number => Self::number(u8::from(number));
    <T> &[T], slice => Self::memory(slice.as_ptr(), slice.len());
    <T> &mut [T], slice => Self::memory(slice.as_mut_ptr(), slice.len());
    <T> &mut T, one => Self::memory(one, 1);
    <T> *mut T, pointer => Self::memory(pointer, 1);
}

/// A function of an instance, from the rows of `fmi-abi`.
pub struct Function {
    pub operation: &'static str,
    /// For each argument that is not a length, why it is refused if it is NULL, or nothing.
    pub refusals: &'static [Option<&'static str>],
    call: fn(Fmu, &[Argument]) -> c_int,
}

macro_rules! functions {
    (
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident($($arg:ident: $kind:tt),*) => $operation:ident in $($_2:ident)|+;)* })*
    ) => {
        &[$($(Function {
            operation: stringify!($operation),
            refusals: &[$(refusal!($kind)),*],
            call: |f, arguments| {
                let mut arguments = arguments.iter();
                $(bind!(arguments $arg $kind);)*
                assert!(arguments.next().is_none(), stringify!($name));
                // SAFETY: the instance lives or is NULL, and pointers are NULL or have memory of the lengths.
                unsafe { $name(f.c, $(argument!($arg $kind)),*).0 }
            },
        },)*)*]
    };
}

/// Why NULL is refused. Lengths are no arguments of their own, and the operation itself treats `in?` and `out?`.
#[rustfmt::skip]
macro_rules! refusal {
    ([len]) => { None };
    ([$_:tt ? $($rest:tt)*]) => { Some("") };
    ([$_:tt $type:ty; $n:ident]) => { Some("an array is NULL though its length is not 0") };
    ([$_:tt $type:ty]) => { Some("a pointer to a result is NULL") };
    ($type:ty) => { Some("") };
}

/// Takes the next argument, and the length of an array.
#[rustfmt::skip]
macro_rules! bind {
    ($from:ident $arg:ident [len]) => {};
    ($from:ident $arg:ident [$io:tt ? $type:ty; $n:ident]) => { bind!($from $arg [$io $type; $n]) };
    ($from:ident $arg:ident [$_:tt ? $type:ty]) => { let $arg = $from.next().unwrap(); };
    ($from:ident $arg:ident [$_:tt $type:ty; $n:ident]) => {
        let $arg = $from.next().unwrap();
        #[allow(unused, reason = "several arrays have one length")]
        let $n = $arg.length;
    };
    ($from:ident $arg:ident $kind:tt) => { let $arg = $from.next().unwrap(); };
}

#[rustfmt::skip]
macro_rules! argument {
    ($arg:ident [len]) => { $arg };
    ($arg:ident [$_:tt ? $($rest:tt)*]) => { $arg.memory.cast() };
    ($arg:ident [$_:tt $type:ty; $n:ident]) => {{
        assert_eq!($arg.length, $n, stringify!($arg));
        $arg.memory.cast()
    }};
    ($arg:ident [$($_:tt)*]) => { $arg.memory.cast() };
    ($arg:ident fmi2FMUstate) => { $arg.memory };
    ($arg:ident fmi3FMUState) => { $arg.memory };
    ($arg:ident $type:ty) => { $arg.number as $type };
}

/// The functions of a version that have an instance.
pub fn functions(version: FmiVersion) -> &'static [Function] {
    match version {
        Fmi2 => fmi2_functions!(functions!),
        Fmi3 => fmi3_functions!(functions!),
    }
}

impl Function {
    /// Calls it with zero, and with arrays of `n` zeros; the argument `null` is NULL.
    pub fn call_with_zeros(&self, f: Fmu, n: usize, null: Option<usize>) -> Status {
        // Enough for two numbers, or `fmi2EventInfo`.
        let mut memory = [[0_u64; 4]; 8];
        let mut given = memory.each_mut().map(|memory| Argument::memory(memory, n));
        if let Some(null) = null {
            given[null].memory = null_mut();
        }
        Status((self.call)(f, &given[..self.refusals.iter().flatten().count()]))
    }
}

/// Defines methods that call the function of an operation.
macro_rules! methods {
    ($($method:ident($($argument:ident: $type:ty),*) = $operation:ident;)*) => {
        impl Fmu {
            $(pub fn $method(self, $($argument: $type),*) -> Status {
                self.call(stringify!($operation), &[$($argument.into()),*])
            })*
        }
    };
}

methods! {
    switch(on: bool, categories: &[*const c_char]) = set_debug_logging;
    setup(has_tolerance: bool, tolerance: f64, start: f64, stops: bool, stop: f64) = setup_experiment;
    exit_initialization_mode() = exit_initialization_mode;
    enter_event_mode() = enter_event_mode;
    enter_continuous_time_mode() = enter_continuous_time_mode;
    enter_step_mode() = enter_step_mode;
    enter_configuration_mode() = enter_configuration_mode;
    exit_configuration_mode() = exit_configuration_mode;
    terminate() = terminate;
    reset() = reset;
    get_f64(references: &[u32], values: &mut [f64]) = get_float64;
    set_f64(references: &[u32], values: &[f64]) = set_float64;
    get_f32(references: &[u32], values: &mut [f32]) = get_float32;
    get_i32(references: &[u32], values: &mut [i32]) = get_int32;
    set_i32(references: &[u32], values: &[i32]) = set_int32;
    set_u64(references: &[u32], values: &[u64]) = set_uint64;
    get_strings(references: &[u32], values: &mut [*const c_char]) = get_string;
    set_strings(references: &[u32], values: &[*const c_char]) = set_string;
    get_binaries(references: &[u32], sizes: &mut [usize], values: &mut [*const u8]) = get_binary;
    set_binaries(references: &[u32], sizes: &[usize], values: &[*const u8]) = set_binary;
    get_state(state: *mut *mut c_void) = get_fmu_state;
    set_state(state: *mut c_void) = set_fmu_state;
    free_state(state: *mut *mut c_void) = free_fmu_state;
    serialized_size(state: *mut c_void, size: *mut usize) = serialized_fmu_state_size;
    serialize_into(state: *mut c_void, bytes: &mut [u8]) = serialize_fmu_state;
    deserialize(bytes: &[u8], state: *mut *mut c_void) = deserialize_fmu_state;
    directional(unknowns: &[u32], knowns: &[u32], seed: &[f64], to: &mut [f64]) = get_directional_derivative;
    adjoint(unknowns: &[u32], knowns: &[u32], seed: &[f64], to: &mut [f64]) = get_adjoint_derivative;
    set_time(time: f64) = set_time;
    set_states(states: &[f64]) = set_continuous_states;
    get_states(to: &mut [f64]) = get_continuous_states;
    get_derivatives(to: &mut [f64]) = get_continuous_state_derivatives;
    get_nominals(to: &mut [f64]) = get_nominals_of_continuous_states;
    get_indicators(to: &mut [f64]) = get_event_indicators;
    count_states(count: &mut usize) = get_number_of_continuous_states;
    count_indicators(count: &mut usize) = get_number_of_event_indicators;
    set_input_derivatives(references: &[u32], orders: &[i32], values: &[f64]) = set_input_derivatives;
    get_output_derivatives(references: &[u32], orders: &[i32], to: &mut [f64]) = get_output_derivatives;
    real_status(kind: c_int, value: *mut f64) = get_real_status;
    boolean_status(kind: c_int, value: *mut i32) = get_boolean_status;
}

/// Defines the access to numbers, in the type that a version has for them.
macro_rules! numbers {
    ($($version:pat, $name:ident: $type:ident;)*) => {
        impl Fmu {
            /// Gets or sets numbers, as the verb says.
            fn access(self, verb: &str, of: Type, references: &[u32], values: &mut [f64]) -> Status {
                let operation = format!("{verb}_{}", of.as_str().to_lowercase());
                match (self.kind.0, of) {
                    $(($version, Type::$name) => {
                        let mut own: Vec<_> = values.iter().map(|value| *value as $type).collect();
                        let status = self.call(&operation, &[references.into(), (&mut *own).into()]);
                        values.iter_mut().zip(own).for_each(|(value, own)| *value = own as f64);
                        status
                    })*
                    _ => unreachable!(),
                }
            }
        }
    };
}

numbers! {
    _, Float32: f32;
    _, Float64: f64;
    _, Int8: i8;
    _, UInt8: u8;
    _, Int16: i16;
    _, UInt16: u16;
    _, Int32: i32;
    _, UInt32: u32;
    _, Int64: i64;
    _, UInt64: u64;
    Fmi2, Boolean: c_int;
    Fmi3, Boolean: u8;
}

impl Fmu {
    /// Calls the function of an operation.
    pub fn call(self, operation: &str, arguments: &[Argument]) -> Status {
        let mut all = functions(self.kind.0).iter();
        let function = all.find(|function| function.operation == operation).expect(operation);
        Status((function.call)(self, arguments))
    }

    /// The type whose functions access a variable of this type.
    pub fn accessed_as(self, of: Type) -> Type {
        match (self.kind.0, of) {
            (Fmi2, Type::Float32) => Type::Float64,
            (Fmi2, Type::Boolean | Type::String | Type::Float64 | Type::Binary) => of,
            (Fmi2, _) => Type::Int32,
            (Fmi3, Type::Enumeration) => Type::Int64,
            (Fmi3, _) => of,
        }
    }

    /// Sets variables of a type to numbers; Strings to their texts, Binaries to as many bytes.
    pub fn set_all(self, of: Type, references: &[u32], values: &[f64]) -> Status {
        match self.accessed_as(of) {
            Type::String => {
                let texts = values.iter().map(|v| CString::new(v.to_string()).unwrap());
                let texts: Vec<_> = texts.collect();
                let texts: Vec<_> = texts.iter().map(|text| text.as_ptr()).collect();
                self.set_strings(references, &texts)
            }
            Type::Binary => {
                let sizes: Vec<_> = values.iter().map(|&value| value as usize).collect();
                self.set_binaries(references, &sizes, &vec![[0; 256].as_ptr(); values.len()])
            }
            other => self.access("set", other, references, &mut values.to_vec()),
        }
    }

    /// Gets variables of a type as numbers, see [`set_all`](Self::set_all); what is not returned is 77.
    pub fn get_all(self, of: Type, references: &[u32], n: usize) -> (Status, Vec<f64>) {
        match self.accessed_as(of) {
            Type::String => {
                let mut texts = vec![c"77".as_ptr(); n];
                let status = self.get_strings(references, &mut texts);
                // SAFETY: strings of the FMU, valid until its next call, or the literal.
                let texts = texts.iter().map(|&text| unsafe { CStr::from_ptr(text) });
                (status, texts.map(|text| number(text.to_str().unwrap())).collect())
            }
            Type::Binary => {
                let mut sizes = vec![77; n];
                let status = self.get_binaries(references, &mut sizes, &mut vec![null(); n]);
                (status, sizes.into_iter().map(|size| size as f64).collect())
            }
            other => {
                let mut values = vec![77.0; n];
                (self.access("get", other, references, &mut values), values)
            }
        }
    }

    /// The values of scalars of a type.
    #[track_caller]
    pub fn read<const N: usize>(self, of: Type, references: [u32; N]) -> [f64; N] {
        let (status, values) = self.get_all(of, &references, N);
        assert_eq!(status, OK);
        values.try_into().unwrap()
    }

    pub fn set(self, reference: u32, value: f64) -> Status {
        self.set_f64(&[reference], &[value])
    }

    /// Gets scalars of type Float64.
    #[track_caller]
    pub fn get<const N: usize>(self, references: [u32; N]) -> [f64; N] {
        self.read(Type::Float64, references)
    }

    /// Gets derivatives of outputs of some orders, and forgets them.
    pub fn slopes(self, of: &[(u32, i32)]) -> Status {
        let (of, orders): (Vec<u32>, Vec<i32>) = of.iter().copied().unzip();
        self.get_output_derivatives(&of, &orders, &mut vec![0.0; of.len()])
    }

    /// Gets the derivative of an unknown in a direction, and forgets it.
    pub fn slope(self, unknown: u32, known: u32, seed: f64) -> Status {
        self.directional(&[unknown], &[known], &[seed], &mut [0.0])
    }

    /// Reads two numbers by one of the functions of model exchange.
    #[track_caller]
    pub fn two(self, read: fn(Self, &mut [f64]) -> Status) -> [f64; 2] {
        let mut values = [f64::NAN; 2];
        assert_eq!(read(self, &mut values), OK);
        values
    }

    /// Reads Strings.
    #[track_caller]
    pub fn texts(self, references: &[u32], n: usize) -> Vec<CString> {
        let mut values = vec![null(); n];
        assert_eq!(self.get_strings(references, &mut values), OK);
        // SAFETY: strings of the FMU, valid until its next call.
        let texts = values.iter().map(|&text| unsafe { CStr::from_ptr(text) });
        texts.map(CStr::to_owned).collect()
    }

    /// The name of the function that performs an operation.
    pub fn name(self, operation: &str) -> &'static str {
        self.kind.0.function(operation).unwrap()
    }

    pub fn free(self) {
        // SAFETY: the instance lives until here, or is NULL.
        unsafe {
            match self.kind.0 {
                Fmi2 => fmi2FreeInstance(self.c),
                Fmi3 => fmi3FreeInstance(self.c),
            }
        }
    }

    /// Sets the experiment and enters initialization mode; in FMI 2.0 by two functions.
    pub fn enter(self, start: f64, stop: Option<f64>, tolerance: Option<f64>) -> Status {
        let [ends, tolerated] = [stop, tolerance].map(|value| value.is_some().into());
        let [stop, tolerance] = [stop, tolerance].map(|value| value.unwrap_or(f64::NAN).into());
        let experiment = [tolerated, tolerance, start.into(), ends, stop];
        match self.kind.0 {
            Fmi2 => match self.call("setup_experiment", &experiment) {
                OK => self.call("enter_initialization_mode", &[]),
                failed => failed,
            },
            Fmi3 => self.call("enter_initialization_mode", &experiment),
        }
    }

    /// Goes to the end of the initialization.
    #[track_caller]
    pub fn start(self, time: f64, stop: Option<f64>) {
        assert_eq!(self.enter(time, stop, None), OK);
        assert_eq!(self.exit_initialization_mode(), OK);
    }

    /// Ends event mode.
    pub fn try_go_on(self) -> Status {
        match self.kind.1 {
            Exchanged => self.enter_continuous_time_mode(),
            _ => self.enter_step_mode(),
        }
    }

    #[track_caller]
    pub fn go_on(self) {
        ok([self.try_go_on()]);
    }

    pub fn switch_log(self, on: bool, categories: &[&CStr]) -> Status {
        let names: Vec<_> = categories.iter().map(|name| name.as_ptr()).collect();
        self.switch(on, &names)
    }

    /// Takes a step; in FMI 2.0, a failed step ends where it started.
    pub fn step_to(self, time: f64, step: f64) -> (Status, Results) {
        let ([mut event, mut terminate, mut early], mut last) = ([7_u8; 3], f64::NAN);
        let [a, b, c] = [&mut event, &mut terminate, &mut early].map(Argument::from);
        let all = [time.into(), step.into(), true.into(), a, b, c, (&mut last).into()];
        let status = self.call("do_step", if self.kind.0 == Fmi2 { &all[..3] } else { &all });
        if self.kind.0 == Fmi2 {
            return (status, results(false, false, if status == OK { time + step } else { time }));
        }
        assert!(event <= 1 && early <= 1 && terminate == 0);
        (status, results(event == 1, early == 1, last))
    }

    pub fn step(self, time: f64, step: f64) -> Status {
        self.step_to(time, step).0
    }

    /// Takes a step that succeeds.
    #[track_caller]
    pub fn steps(self, time: f64, step: f64) -> Results {
        let (status, results) = self.step_to(time, step);
        assert_eq!(status, OK);
        results
    }

    /// Handles an event. After a failure, nothing is written.
    pub fn try_update(self) -> (Status, Discrete) {
        let (mut info, operation) = (Info([7; 5], f64::NAN), "update_discrete_states");
        let [a, b, c, d, e] = info.0.each_mut().map(Argument::from);
        let status = match self.kind.0 {
            Fmi2 => self.call(operation, &[(&mut info).into()]),
            Fmi3 => self.call(operation, &[a, b, c, d, e, (&mut info.1).into()]),
        };
        // In FMI 3.0, flags are bytes.
        let flags = info.0.map(|flag| flag.to_ne_bytes()[0]);
        assert!(status == OK || flags == [7; 5], "nothing is returned");
        assert!(status != OK || flags[..3] == [0; 3] && flags[3] <= 1 && flags[4] <= 1);
        (status, (flags[3] == 1, (flags[4] == 1).then_some(info.1)))
    }

    #[track_caller]
    pub fn update(self) -> Discrete {
        let (status, result) = self.try_update();
        assert_eq!(status, OK);
        result
    }

    /// A new FMU state; NULL if the call fails.
    pub fn save(self) -> *mut c_void {
        let mut state = null_mut();
        self.get_state(&mut state);
        state
    }

    #[track_caller]
    pub fn serialize(self, state: *mut c_void) -> Vec<u8> {
        let mut size = 0;
        assert_eq!(self.serialized_size(state, &mut size), OK);
        let mut bytes = vec![0; size];
        assert_eq!(self.serialize_into(state, &mut bytes), OK);
        bytes
    }

    /// The serialized state of the instance.
    #[track_caller]
    pub fn snapshot(self) -> Vec<u8> {
        let mut state = self.save();
        let bytes = self.serialize(state);
        assert_eq!(self.free_state(&mut state), OK);
        bytes
    }

    /// Restores a serialized state.
    #[track_caller]
    pub fn resume(self, bytes: &[u8]) -> Self {
        let mut state = null_mut();
        assert_eq!(self.deserialize(bytes, &mut state), OK);
        assert_eq!(self.set_state(state), OK);
        assert_eq!(self.free_state(&mut state), OK);
        self
    }
}
