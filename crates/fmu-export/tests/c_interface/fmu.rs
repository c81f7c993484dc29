//! An FMU as its host calls it: a method for each operation, which calls the linked function of the instance's version.
//! Methods of one version fail for the other.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr::{null, null_mut};

use fmu_description::Type;
pub use fmu_export::abi::FmiVersion::{self, Fmi2, Fmi3};
use fmu_export::abi::{fmi2_functions, fmi3_functions};
use fmu_export::{fmi2::*, fmi3::*};

use crate::models::number;

/// What an instance is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    Stepped,
    /// Co-simulation with event mode.
    Events,
    Exchanged,
    /// Scheduled execution.
    Scheduled,
}
pub use Mode::*;

/// The edge and the mode of an instance.
pub type Kind = (FmiVersion, Mode);
pub const PLAIN: [Kind; 2] = [(Fmi2, Stepped), (Fmi3, Stepped)];
pub const EXCHANGED: [Kind; 2] = [(Fmi2, Exchanged), (Fmi3, Exchanged)];
pub const EVENTS: Kind = (Fmi3, Events);
pub const SCHEDULED: Kind = (Fmi3, Scheduled);
/// Without scheduled execution, for which only models with clocks are.
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

/// The host's pointer to an instance.
#[derive(Debug, Clone, Copy)]
pub struct Fmu {
    pub kind: Kind,
    pub c: *mut c_void,
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
    activate(clock: c_int, time: f64) = activate_model_partition;
    get_intervals(clocks: &[u32], to: &mut [f64], qualifiers: &mut [c_int]) = get_interval_decimal;
    get_interval_fractions(
        clocks: &[u32], counters: &mut [u64], resolutions: &mut [u64], qualifiers: &mut [c_int]
    ) = get_interval_fraction;
    get_shifts(clocks: &[u32], to: &mut [f64]) = get_shift_decimal;
    get_shift_fractions(clocks: &[u32], counters: &mut [u64], resolutions: &mut [u64]) = get_shift_fraction;
    set_intervals(clocks: &[u32], intervals: &[f64]) = set_interval_decimal;
    set_interval_fractions(clocks: &[u32], counters: &[u64], resolutions: &[u64]) = set_interval_fraction;
    set_shifts(clocks: &[u32], shifts: &[f64]) = set_shift_decimal;
    set_shift_fractions(clocks: &[u32], counters: &[u64], resolutions: &[u64]) = set_shift_fraction;
    get_clocks(clocks: &[u32], to: &mut [u8]) = get_clock;
    set_clocks(clocks: &[u32], values: &[u8]) = set_clock;
    evaluate() = evaluate_discrete_states;
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
    pub fn try_end_event_mode(self) -> Status {
        match self.kind.1 {
            Exchanged => self.enter_continuous_time_mode(),
            _ => self.enter_step_mode(),
        }
    }

    #[track_caller]
    pub fn end_event_mode(self) {
        ok([self.try_end_event_mode()]);
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
