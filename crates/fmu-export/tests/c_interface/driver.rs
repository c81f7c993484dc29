//! A driver for all edges: instances, what they call back, and a method for each operation, which calls the
//! linked function of the instance's version. Methods of one version fail for the other.

use std::cell::{Cell, RefCell};
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ops::Deref;
use std::ptr::{null, null_mut};
use std::sync::Once;

use fmu_description::Type;
pub use fmu_export::abi::Version::{self, Fmi2, Fmi3};
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
pub type Kind = (Version, Mode);
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
        Self {
            fmu,
            host,
            _callbacks: callbacks,
        }
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

/// What an update of discrete states returns: whether states changed, and the time of the next event.
pub type Discrete = (bool, Option<f64>);

/// A function of an instance, from the rows of `fmi-abi`.
pub struct Function {
    pub operation: &'static str,
    /// For each argument, why it is refused if it is NULL.
    pub refusals: &'static [Option<&'static str>],
    /// Calls it with arrays of `n` elements, where the argument at an index is NULL, and the others are zero or
    /// point to zeros.
    pub call: fn(Fmu, n: usize, null: usize) -> Status,
}

/// No argument.
pub const NONE: usize = usize::MAX;

macro_rules! functions {
    (
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident($($_2:ident: $kind:tt),*) => $operation:ident in $($_3:ident)|+;)* })*
    ) => {
        &[$($(Function {
            operation: stringify!($operation),
            refusals: &[$(refusal!($kind)),*],
            call: |f, n, null| {
                #[allow(unused, reason = "not all functions have arguments")]
                let (n, null, mut index, mut memory) = (n, null, 0..10, [0_u128; 10]);
                // SAFETY: the instance lives or is NULL; zero is a value of all types, and each pointer has
                // memory of its own, enough for two numbers or `fmi2EventInfo`.
                Status(unsafe { $name(f.c, $(argument!($kind, index.next().unwrap(), null, n, memory)),*).0 })
            },
        },)*)*]
    };
}

macro_rules! refusal {
    ([in? $($_0:tt)*]) => {
        None
    };
    ([out? $($_0:tt)*]) => {
        None
    };
    ([in $_0:ty; $_1:ident]) => {
        Some("an array is NULL though its length is not 0")
    };
    ([out $_0:ty; $_1:ident]) => {
        Some("an array is NULL though its length is not 0")
    };
    ([out $_0:ty]) => {
        Some("a pointer to a result is NULL")
    };
    ($_0:tt) => {
        None
    };
}

macro_rules! argument {
    ([len], $index:expr, $null:ident, $n:ident, $memory:ident) => {{
        $index;
        $n
    }};
    ([in $($_0:tt)*], $index:expr, $null:ident, $n:ident, $memory:ident) => {
        match $index {
            index if index == $null => null(),
            index => (&raw const $memory[index]).cast(),
        }
    };
    ([out $($_0:tt)*], $index:expr, $null:ident, $n:ident, $memory:ident) => {
        match $index {
            index if index == $null => null_mut(),
            index => (&raw mut $memory[index]).cast(),
        }
    };
    ($_0:ty, $index:expr, $null:ident, $n:ident, $memory:ident) => {{
        $index;
        std::mem::zeroed()
    }};
}

/// The functions of a version that have an instance.
pub fn functions(version: Version) -> &'static [Function] {
    match version {
        Fmi2 => fmi2_functions!(functions!),
        Fmi3 => fmi3_functions!(functions!),
    }
}

/// Defines methods that pass their arguments to the function of FMI 2.0, of FMI 3.0, or of the version.
macro_rules! calls {
    ($($method:ident $arguments:tt = $($two:ident $of_2:tt)? / $($three:ident $of_3:tt)?;)*) => {
        impl Fmu {
            $(calls!(@ $method $arguments [$($two $of_2)?] [$($three $of_3)?]);)*
        }
    };
    (@ $method:ident($($argument:ident: $type:ty),*) [$($two:ident($($a:expr),*))?] [$($three:ident($($b:expr),*))?]) => {
        pub fn $method(self, $($argument: $type),*) -> Status {
            // SAFETY: the instance lives or is NULL, and pointers and lengths are from slices.
            unsafe {
                match self.kind.0 {
                    $(Fmi2 => Status($two(self.c, $($a),*).0),)?
                    $(Fmi3 => Status($three(self.c, $($b),*).0),)?
                    #[allow(unreachable_patterns, reason = "unless one version lacks it")]
                    version => panic!("{version:?} has no {}", stringify!($method)),
                }
            }
        }
    };
}

calls! {
    exit_initialization_mode() = fmi2ExitInitializationMode() / fmi3ExitInitializationMode();
    enter_event_mode() = fmi2EnterEventMode() / fmi3EnterEventMode();
    enter_continuous_time_mode() = fmi2EnterContinuousTimeMode() / fmi3EnterContinuousTimeMode();
    enter_step_mode() = / fmi3EnterStepMode();
    enter_configuration_mode() = / fmi3EnterConfigurationMode();
    exit_configuration_mode() = / fmi3ExitConfigurationMode();
    terminate() = fmi2Terminate() / fmi3Terminate();
    reset() = fmi2Reset() / fmi3Reset();
    get_state(state: *mut *mut c_void) = fmi2GetFMUstate(state) / fmi3GetFMUState(state);
    set_state(state: *mut c_void) = fmi2SetFMUstate(state) / fmi3SetFMUState(state);
    free_state(state: *mut *mut c_void) = fmi2FreeFMUstate(state) / fmi3FreeFMUState(state);
    serialized_size(state: *mut c_void, size: *mut usize)
        = fmi2SerializedFMUstateSize(state, size) / fmi3SerializedFMUStateSize(state, size);
    serialize_to(state: *mut c_void, bytes: *mut u8, n: usize)
        = fmi2SerializeFMUstate(state, bytes.cast(), n) / fmi3SerializeFMUState(state, bytes, n);
    deserialize_from(bytes: *const u8, n: usize, state: *mut *mut c_void)
        = fmi2DeSerializeFMUstate(bytes.cast(), n, state) / fmi3DeserializeFMUState(bytes, n, state);
    set_time(time: f64) = fmi2SetTime(time) / fmi3SetTime(time);
    count_states(count: &mut usize) = / fmi3GetNumberOfContinuousStates(count);
    count_indicators(count: &mut usize) = / fmi3GetNumberOfEventIndicators(count);
    directional(unknowns: &[u32], knowns: &[u32], seed: &[f64], to: &mut [f64])
        = fmi2GetDirectionalDerivative(
            unknowns.as_ptr(), same(unknowns, to), knowns.as_ptr(), same(knowns, seed),
            seed.as_ptr(), to.as_mut_ptr())
        / fmi3GetDirectionalDerivative(
            unknowns.as_ptr(), unknowns.len(), knowns.as_ptr(), knowns.len(),
            seed.as_ptr(), seed.len(), to.as_mut_ptr(), to.len());
    adjoint(unknowns: &[u32], knowns: &[u32], seed: &[f64], to: &mut [f64])
        = / fmi3GetAdjointDerivative(
            unknowns.as_ptr(), unknowns.len(), knowns.as_ptr(), knowns.len(),
            seed.as_ptr(), seed.len(), to.as_mut_ptr(), to.len());
    set_input_derivatives(references: &[u32], orders: &[i32], values: &[f64])
        = fmi2SetRealInputDerivatives(
            references.as_ptr(), same(references, orders), orders.as_ptr(), values.as_ptr()) /;
    get_output_derivatives(references: &[u32], orders: &[i32], to: &mut [f64])
        = fmi2GetRealOutputDerivatives(
            references.as_ptr(), same(references, orders).min(same(references, to)),
            orders.as_ptr(), to.as_mut_ptr())
        / fmi3GetOutputDerivatives(
            references.as_ptr(), same(references, orders), orders.as_ptr(), to.as_mut_ptr(), to.len());
    switch(on: bool, n: usize, names: *const *const c_char)
        = fmi2SetDebugLogging(on.into(), n, names) / fmi3SetDebugLogging(on.into(), n, names);
    setup(start: f64, stop: Option<f64>)
        = fmi2SetupExperiment(0, f64::NAN, start, stop.is_some().into(), stop.unwrap_or(f64::NAN)) /;
    real_status(kind: c_int, value: &mut f64) = fmi2GetRealStatus(kind, value) /;
    boolean_status(kind: c_int, value: &mut i32) = fmi2GetBooleanStatus(kind, value) /;
    get_binaries(references: &[u32], sizes: &mut [usize], to: &mut [*const u8])
        = / fmi3GetBinary(
            references.as_ptr(), references.len(), sizes.as_mut_ptr(), to.as_mut_ptr(), to.len());
    set_binaries(references: &[u32], sizes: &[usize], values: &[*const u8])
        = / fmi3SetBinary(
            references.as_ptr(), references.len(), sizes.as_ptr(), values.as_ptr(), values.len());
}

/// The common length of two arrays.
fn same<T, U>(one: &[T], other: &[U]) -> usize {
    assert_eq!(one.len(), other.len());
    one.len()
}

/// Functions that get and set values of a type.
macro_rules! values {
    ($($get:ident($($get_2:ident)? / $get_3:ident) $set:ident($($set_2:ident)? / $set_3:ident): $type:ty;)*) => {
        calls! {
            $(
                $get(of: &[u32], to: &mut [$type])
                    = $($get_2(of.as_ptr(), same(of, to), to.as_mut_ptr()))?
                    / $get_3(of.as_ptr(), of.len(), to.as_mut_ptr(), to.len());
                $set(of: &[u32], values: &[$type])
                    = $($set_2(of.as_ptr(), same(of, values), values.as_ptr()))?
                    / $set_3(of.as_ptr(), of.len(), values.as_ptr(), values.len());
            )*
        }
    };
}

values! {
    get_f64(fmi2GetReal / fmi3GetFloat64) set_f64(fmi2SetReal / fmi3SetFloat64): f64;
    get_i32(fmi2GetInteger / fmi3GetInt32) set_i32(fmi2SetInteger / fmi3SetInt32): i32;
    get_strings(fmi2GetString / fmi3GetString) set_strings(fmi2SetString / fmi3SetString): *const c_char;
}

/// Functions of model exchange that get numbers.
macro_rules! vectors {
    ($($get:ident($get_2:ident / $get_3:ident);)*) => {
        calls! {
            $($get(to: &mut [f64])
                = $get_2(to.as_mut_ptr(), to.len()) / $get_3(to.as_mut_ptr(), to.len());)*
            set_states(states: &[f64])
                = fmi2SetContinuousStates(states.as_ptr(), states.len())
                / fmi3SetContinuousStates(states.as_ptr(), states.len());
        }
    };
}

vectors! {
    get_states(fmi2GetContinuousStates / fmi3GetContinuousStates);
    get_derivatives(fmi2GetDerivatives / fmi3GetContinuousStateDerivatives);
    get_nominals(fmi2GetNominalsOfContinuousStates / fmi3GetNominalsOfContinuousStates);
    get_indicators(fmi2GetEventIndicators / fmi3GetEventIndicators);
}

/// The numbers of FMI 3.0.
macro_rules! numbers {
    ($($get:ident($get_function:ident) $set:ident($set_function:ident): $type:ty as $name:ident;)*) => {
        values! { $($get(/ $get_function) $set(/ $set_function): $type;)* }

        impl Fmu {
            fn set_3(self, of: Type, references: &[u32], values: &[f64]) -> Status {
                match of {
                    $(Type::$name => {
                        let values: Vec<_> = values.iter().map(|value| *value as $type).collect();
                        self.$set(references, &values)
                    })*
                    _ => panic!("{of:?} is no other number"),
                }
            }

            fn get_3(self, of: Type, references: &[u32], to: &mut [f64]) -> Status {
                match of {
                    $(Type::$name => {
                        let mut values: Vec<_> = to.iter().map(|value| *value as $type).collect();
                        let status = self.$get(references, &mut values);
                        for (to, value) in to.iter_mut().zip(values) {
                            *to = value as f64;
                        }
                        status
                    })*
                    _ => panic!("{of:?} is no other number"),
                }
            }
        }
    };
}

numbers! {
    get_f32(fmi3GetFloat32) set_f32(fmi3SetFloat32): f32 as Float32;
    get_i8(fmi3GetInt8) set_i8(fmi3SetInt8): i8 as Int8;
    get_u8(fmi3GetUInt8) set_u8(fmi3SetUInt8): u8 as UInt8;
    get_i16(fmi3GetInt16) set_i16(fmi3SetInt16): i16 as Int16;
    get_u16(fmi3GetUInt16) set_u16(fmi3SetUInt16): u16 as UInt16;
    get_u32(fmi3GetUInt32) set_u32(fmi3SetUInt32): u32 as UInt32;
    get_i64(fmi3GetInt64) set_i64(fmi3SetInt64): i64 as Int64;
    get_u64(fmi3GetUInt64) set_u64(fmi3SetUInt64): u64 as UInt64;
    get_booleans(fmi3GetBoolean) set_booleans(fmi3SetBoolean): fmi3Boolean as Boolean;
}

impl Fmu {
    /// Whether the version accesses a type as another.
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
        let integers: Vec<i32> = values.iter().map(|&value| value as i32).collect();
        match (self.kind.0, self.accessed_as(of)) {
            (_, Type::Float64) => self.set_f64(references, values),
            (_, Type::Int32) => self.set_i32(references, &integers),
            (_, Type::String) => {
                let texts = values.iter().map(|v| CString::new(v.to_string()).unwrap());
                let texts: Vec<_> = texts.collect();
                let texts: Vec<_> = texts.iter().map(|text| text.as_ptr()).collect();
                self.set_strings(references, &texts)
            }
            (Fmi3, Type::Binary) => {
                let sizes: Vec<_> = values.iter().map(|&value| value as usize).collect();
                self.set_binaries(references, &sizes, &vec![[0; 256].as_ptr(); values.len()])
            }
            // SAFETY: the instance lives or is NULL.
            (Fmi2, Type::Boolean) => Status(unsafe {
                let n = same(references, values);
                fmi2SetBoolean(self.c, references.as_ptr(), n, integers.as_ptr()).0
            }),
            (_, other) => self.set_3(other, references, values),
        }
    }

    /// Gets variables of a type as numbers, see [`set_all`](Self::set_all); what is not returned is 77.
    pub fn get_all(self, of: Type, references: &[u32], n: usize) -> (Status, Vec<f64>) {
        let (mut found, mut integers) = (vec![77.0; n], vec![77; n]);
        let status = match (self.kind.0, self.accessed_as(of)) {
            (_, Type::Float64) => self.get_f64(references, &mut found),
            (_, Type::Int32) => {
                let status = self.get_i32(references, &mut integers);
                found = integers.into_iter().map(f64::from).collect();
                status
            }
            (_, Type::String) => {
                let mut texts = vec![c"77".as_ptr(); n];
                let status = self.get_strings(references, &mut texts);
                // SAFETY: strings of the FMU, valid until its next call, or the literal.
                let texts = texts.iter().map(|&text| unsafe { CStr::from_ptr(text) });
                found = texts.map(|text| number(text.to_str().unwrap())).collect();
                status
            }
            (Fmi3, Type::Binary) => {
                let mut sizes = vec![77; n];
                let status = self.get_binaries(references, &mut sizes, &mut vec![null(); n]);
                found = sizes.into_iter().map(|size| size as f64).collect();
                status
            }
            // SAFETY: the instance lives or is NULL.
            (Fmi2, Type::Boolean) => unsafe {
                let (from, to) = (references.as_ptr(), integers.as_mut_ptr());
                let status = fmi2GetBoolean(self.c, from, references.len(), to);
                found = integers.into_iter().map(f64::from).collect();
                Status(status.0)
            },
            (_, other) => self.get_3(other, references, &mut found),
        };
        (status, found)
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

    /// As [`slope`](Self::slope), in the adjoint direction.
    pub fn adjoint_slope(self, unknown: u32, known: u32, seed: f64) -> Status {
        self.adjoint(&[unknown], &[known], &[seed], &mut [0.0])
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
        let [ends, tolerated] = [stop, tolerance].map(|value| value.is_some());
        let [stop, tolerance] = [stop, tolerance].map(|value| value.unwrap_or(f64::NAN));
        // SAFETY: the instance lives or is NULL.
        #[rustfmt::skip]
        let status = unsafe {
            match self.kind.0 {
                Fmi2 => match fmi2SetupExperiment(
                    self.c, tolerated.into(), tolerance, start, ends.into(), stop,
                ) {
                    fmi2Status(0) => fmi2EnterInitializationMode(self.c).0,
                    failed => failed.0,
                },
                Fmi3 => fmi3EnterInitializationMode(
                    self.c, tolerated.into(), tolerance, start, ends.into(), stop,
                ).0,
            }
        };
        Status(status)
    }

    /// Goes to the end of the initialization.
    #[track_caller]
    pub fn start(self, time: f64, stop: Option<f64>) {
        assert_eq!(self.enter(time, stop, None), OK);
        assert_eq!(self.exit_initialization_mode(), OK);
    }

    /// Ends event mode.
    #[track_caller]
    pub fn go_on(self) {
        ok([match self.kind.1 {
            Exchanged => self.enter_continuous_time_mode(),
            _ => self.enter_step_mode(),
        }]);
    }

    pub fn switch_log(self, on: bool, categories: &[&CStr]) -> Status {
        let names: Vec<_> = categories.iter().map(|name| name.as_ptr()).collect();
        self.switch(on, names.len(), names.as_ptr())
    }

    /// Takes a step; in FMI 2.0, a failed step ends where it started.
    pub fn step_to(self, time: f64, step: f64) -> (Status, Results) {
        let (mut event, mut terminate, mut early, mut last) = (7, 7, 7, f64::NAN);
        // SAFETY: the instance lives or is NULL.
        let status = Status(unsafe {
            match self.kind.0 {
                Fmi2 => fmi2DoStep(self.c, time, step, 1).0,
                Fmi3 => {
                    let (event, terminate, early) = (&mut event, &mut terminate, &mut early);
                    fmi3DoStep(self.c, time, step, 1, event, terminate, early, &mut last).0
                }
            }
        });
        match self.kind.0 {
            Fmi2 if status == OK => (status, results(false, false, time + step)),
            Fmi2 => (status, results(false, false, time)),
            Fmi3 => {
                assert!(event <= 1 && early <= 1 && terminate == 0);
                (status, results(event == 1, early == 1, last))
            }
        }
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

    pub fn completed_step(self, flags: &mut [i32; 2]) -> Status {
        let [event, terminate] = flags;
        let mut small = [7; 2];
        let [small_event, small_terminate] = &mut small;
        // SAFETY: the instance lives or is NULL.
        Status(unsafe {
            match self.kind.0 {
                Fmi2 => fmi2CompletedIntegratorStep(self.c, 1, event, terminate).0,
                Fmi3 => {
                    let done = fmi3CompletedIntegratorStep(self.c, 1, small_event, small_terminate);
                    *flags = small.map(i32::from);
                    done.0
                }
            }
        })
    }

    /// Handles an event. After a failure, nothing is written.
    pub fn try_update(self, result: &mut Discrete) -> Status {
        let (mut flags, mut next) = ([7; 5], f64::NAN);
        let [needed, terminate, nominals, values, defined] = &mut flags;
        // SAFETY: the instance lives or is NULL.
        #[rustfmt::skip]
        let status = Status(unsafe {
            match self.kind.0 {
                Fmi2 => {
                    let mut info = fmi2EventInfo {
                        newDiscreteStatesNeeded: 7, terminateSimulation: 7, nominalsOfContinuousStatesChanged: 7,
                        valuesOfContinuousStatesChanged: 7, nextEventTimeDefined: 7, nextEventTime: next,
                    };
                    let status = fmi2NewDiscreteStates(self.c, &mut info);
                    *needed = info.newDiscreteStatesNeeded as u8;
                    *terminate = info.terminateSimulation as u8;
                    *nominals = info.nominalsOfContinuousStatesChanged as u8;
                    *values = info.valuesOfContinuousStatesChanged as u8;
                    *defined = info.nextEventTimeDefined as u8;
                    next = info.nextEventTime;
                    status.0
                }
                Fmi3 => fmi3UpdateDiscreteStates(
                    self.c, needed, terminate, nominals, values, defined, &mut next,
                ).0,
            }
        });
        if status == OK {
            assert_eq!(flags[..3], [0; 3]);
            assert!(flags[3] <= 1 && flags[4] <= 1);
            *result = (flags[3] == 1, (flags[4] == 1).then_some(next));
        } else {
            assert_eq!(flags, [7; 5], "nothing is returned");
        }
        status
    }

    #[track_caller]
    pub fn update(self) -> Discrete {
        let mut result = (false, None);
        assert_eq!(self.try_update(&mut result), OK);
        result
    }

    /// A new FMU state; NULL if the call fails.
    pub fn save(self) -> *mut c_void {
        let mut state = null_mut();
        self.get_state(&mut state);
        state
    }

    pub fn serialize_into(self, state: *mut c_void, bytes: &mut [u8]) -> Status {
        self.serialize_to(state, bytes.as_mut_ptr(), bytes.len())
    }

    pub fn deserialize(self, bytes: &[u8], state: *mut *mut c_void) -> Status {
        self.deserialize_from(bytes.as_ptr(), bytes.len(), state)
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
