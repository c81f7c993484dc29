//! A test host: instances, their log messages, and wrappers of the C functions that take slices.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::ptr::{null, null_mut};
use std::sync::Once;

use fmu_export::Entry;
use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Error, fmi2OK};

use crate::models::{Kind, MODELS, fmi2Instantiate, number};

pub const MODEL_EXCHANGE: fmi2Type = 0;

/// The arguments of a logger call.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    pub instance: CString,
    pub status: fmi2Status,
    pub category: String,
    pub format: String,
    pub text: String,
}

type Log = RefCell<Vec<Message>>;

/// The arguments of `fmi2Instantiate`, and the models of the library.
pub struct Arguments<'a> {
    pub models: &'static [Entry],
    pub name: Option<&'a CStr>,
    pub kind: fmi2Type,
    pub guid: Option<&'a CStr>,
    pub resources: Option<&'a CStr>,
    pub debug: bool,
}

impl Default for Arguments<'_> {
    fn default() -> Self {
        Self {
            models: MODELS,
            name: Some(c"slave"),
            kind: fmi2CoSimulation,
            guid: None,
            resources: None,
            debug: false,
        }
    }
}

/// An instance, whose methods are the functions of the standard and return the status.
pub struct Slave {
    pub c: fmi2Component,
    log: Box<Log>,
}

impl Slave {
    /// A new instance of the model `Probe`.
    pub fn new() -> Self {
        Self::of(0)
    }

    /// A new instance of the model with the given index.
    pub fn of(model: usize) -> Self {
        Self::named(c"slave", model, false)
    }

    /// A new instance with the given name; with `debug`, it also logs events.
    pub fn named(name: &CStr, model: usize, debug: bool) -> Self {
        let (name, guid) = (Some(name), guid(model));
        Self::with(&Arguments {
            name,
            guid: Some(&guid),
            debug,
            ..Arguments::default()
        })
    }

    /// A new instance, which is NULL if instantiation fails.
    pub fn with(arguments: &Arguments) -> Self {
        keep_messages_of_panics();
        let log = Box::<Log>::default();
        let callbacks = fmi2CallbackFunctions {
            componentEnvironment: (&raw const *log).cast_mut().cast(),
            ..callbacks()
        };
        let text = |text: Option<&CStr>| text.map_or(null(), CStr::as_ptr);
        // SAFETY: strings and callbacks outlive the call, and the log outlives the instance.
        let c = unsafe {
            instantiate(
                arguments.models,
                text(arguments.name),
                arguments.kind,
                text(arguments.guid),
                text(arguments.resources),
                &callbacks,
                0,
                arguments.debug.into(),
            )
        };
        Self { c, log }
    }

    /// NULL in place of an instance.
    pub fn null() -> Self {
        Self {
            c: null_mut(),
            log: Box::default(),
        }
    }

    pub fn messages(&self) -> Vec<Message> {
        self.log.borrow().clone()
    }

    pub fn forget_messages(&self) {
        self.log.borrow_mut().clear();
    }

    /// The last message.
    pub fn last_message(&self) -> String {
        let messages = self.log.borrow();
        messages.last().expect("nothing was logged").text.clone()
    }

    /// Checks that a call fails with one message that contains the words and changes nothing.
    #[track_caller]
    pub fn refuses(&mut self, words: &[&str], call: impl FnOnce(&mut Self) -> fmi2Status) {
        let before = self.snapshot();
        self.forget_messages();
        assert_eq!(call(self), fmi2Error, "{words:?}");
        let messages = self.messages();
        assert_eq!(messages.len(), 1, "{words:?}: {messages:?}");
        assert_eq!(messages[0].category, "logStatusError");
        assert_eq!(messages[0].status, fmi2Error);
        for word in words {
            assert!(messages[0].text.contains(word), "{word}: {messages:?}");
        }
        assert_eq!(self.snapshot(), before, "{words:?}");
    }
}

impl Drop for Slave {
    fn drop(&mut self) {
        // SAFETY: the instance lives until here, or is NULL.
        unsafe { fmi2FreeInstance(self.c) };
    }
}

/// The GUID of the model with the given index.
pub fn guid(model: usize) -> CString {
    CString::new(MODELS[model].guid()).unwrap()
}

/// Restores the panic hook, which the library replaces at the first instance, to see failed tests.
pub fn keep_messages_of_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: NULL is allowed for all of these.
        unsafe { fmi2Instantiate(null(), 1, null(), null(), null(), 0, 0) };
        drop(std::panic::take_hook());
    });
}

fn callbacks() -> fmi2CallbackFunctions {
    type Logger = unsafe extern "C" fn(
        fmi2ComponentEnvironment,
        fmi2String,
        fmi2Status,
        fmi2String,
        fmi2String,
        fmi2String,
    );
    // SAFETY: with one pointer as the variable argument, both have the same calling convention on the
    // platforms of this test.
    let logger = unsafe { std::mem::transmute::<Logger, fmi2CallbackLogger>(receive) };
    fmi2CallbackFunctions {
        logger: Some(logger),
        allocateMemory: None,
        freeMemory: None,
        stepFinished: None,
        componentEnvironment: null_mut(),
    }
}

unsafe extern "C" fn receive(
    environment: fmi2ComponentEnvironment,
    instance: fmi2String,
    status: fmi2Status,
    category: fmi2String,
    format: fmi2String,
    text: fmi2String,
) {
    // SAFETY: the environment is the log passed by `with`, and the others are strings of the slave.
    let (log, instance, [category, format, text]) = unsafe {
        (
            &*environment.cast::<Log>(),
            CStr::from_ptr(instance),
            [category, format, text].map(|text| CStr::from_ptr(text).to_str().unwrap()),
        )
    };
    log.borrow_mut().push(Message {
        instance: instance.to_owned(),
        status,
        category: category.to_owned(),
        format: format.to_owned(),
        text: text.to_owned(),
    });
}

/// Defines methods that pass their arguments to C.
macro_rules! calls {
    ($($method:ident($($argument:ident: $type:ty),*) = $function:ident($($passed:expr),*);)*) => {
        impl Slave {
            $(
                pub fn $method(&mut self, $($argument: $type),*) -> fmi2Status {
                    // SAFETY: the instance lives or is NULL, and pointers and lengths are from slices.
                    unsafe { $function(self.c, $($passed),*) }
                }
            )*
        }
    };
}

calls! {
    enter_initialization_mode() = fmi2EnterInitializationMode();
    exit_initialization_mode() = fmi2ExitInitializationMode();
    terminate() = fmi2Terminate();
    reset() = fmi2Reset();
    step(time: f64, step: f64) = fmi2DoStep(time, step, 1);
    real_status(kind: fmi2StatusKind, value: &mut f64) = fmi2GetRealStatus(kind, value);
    boolean_status(kind: fmi2StatusKind, value: &mut i32) = fmi2GetBooleanStatus(kind, value);
    set_reals(references: &[u32], values: &[f64])
        = fmi2SetReal(references.as_ptr(), same(references, values), values.as_ptr());
    set_integers(references: &[u32], values: &[i32])
        = fmi2SetInteger(references.as_ptr(), same(references, values), values.as_ptr());
    set_booleans(references: &[u32], values: &[i32])
        = fmi2SetBoolean(references.as_ptr(), same(references, values), values.as_ptr());
    get_reals(references: &[u32], values: &mut [f64])
        = fmi2GetReal(references.as_ptr(), same(references, values), values.as_mut_ptr());
    get_integers(references: &[u32], values: &mut [i32])
        = fmi2GetInteger(references.as_ptr(), same(references, values), values.as_mut_ptr());
    get_booleans(references: &[u32], values: &mut [i32])
        = fmi2GetBoolean(references.as_ptr(), same(references, values), values.as_mut_ptr());
    set_strings(references: &[u32], values: &[fmi2String])
        = fmi2SetString(references.as_ptr(), same(references, values), values.as_ptr());
    get_strings(references: &[u32], values: &mut [fmi2String])
        = fmi2GetString(references.as_ptr(), same(references, values), values.as_mut_ptr());
    set_input_derivatives(references: &[u32], orders: &[i32], values: &[f64])
        = fmi2SetRealInputDerivatives(
            references.as_ptr(),
            same(references, orders).min(same(references, values)),
            orders.as_ptr(),
            values.as_ptr()
        );
    directional_derivative(
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivatives: &mut [f64]
    ) = fmi2GetDirectionalDerivative(
            unknowns.as_ptr(),
            same(unknowns, derivatives),
            knowns.as_ptr(),
            same(knowns, direction),
            direction.as_ptr(),
            derivatives.as_mut_ptr()
        );
    enter_event_mode() = fmi2EnterEventMode();
    new_discrete_states(info: &mut fmi2EventInfo) = fmi2NewDiscreteStates(info);
    enter_continuous_time_mode() = fmi2EnterContinuousTimeMode();
    completed_integrator_step(event: &mut i32, terminate: &mut i32)
        = fmi2CompletedIntegratorStep(1, event, terminate);
    set_time(time: f64) = fmi2SetTime(time);
    set_states(states: &[f64]) = fmi2SetContinuousStates(states.as_ptr(), states.len());
    get_derivatives(values: &mut [f64]) = fmi2GetDerivatives(values.as_mut_ptr(), values.len());
    get_indicators(values: &mut [f64])
        = fmi2GetEventIndicators(values.as_mut_ptr(), values.len());
    get_states(values: &mut [f64])
        = fmi2GetContinuousStates(values.as_mut_ptr(), values.len());
    get_nominals(values: &mut [f64])
        = fmi2GetNominalsOfContinuousStates(values.as_mut_ptr(), values.len());
    get_output_derivatives(references: &[u32], orders: &[i32], values: &mut [f64])
        = fmi2GetRealOutputDerivatives(
            references.as_ptr(),
            same(references, orders).min(same(references, values)),
            orders.as_ptr(),
            values.as_mut_ptr()
        );
    get_state(state: &mut fmi2FMUstate) = fmi2GetFMUstate(state);
    set_state(state: fmi2FMUstate) = fmi2SetFMUstate(state);
    free_state(state: &mut fmi2FMUstate) = fmi2FreeFMUstate(state);
    serialized_size(state: fmi2FMUstate, size: &mut usize) = fmi2SerializedFMUstateSize(state, size);
    serialize_into(state: fmi2FMUstate, bytes: &mut [u8])
        = fmi2SerializeFMUstate(state, bytes.as_mut_ptr().cast(), bytes.len());
    deserialize(bytes: &[u8], state: &mut fmi2FMUstate)
        = fmi2DeSerializeFMUstate(bytes.as_ptr().cast(), bytes.len(), state);
}

/// The common length of two arrays.
fn same<T, U>(one: &[T], other: &[U]) -> usize {
    assert_eq!(one.len(), other.len());
    one.len()
}

impl Slave {
    pub fn setup(&mut self, start: f64, stop: Option<f64>) -> fmi2Status {
        let (defined, stop) = (stop.is_some().into(), stop.unwrap_or(f64::NAN));
        // SAFETY: the instance lives or is NULL.
        unsafe { fmi2SetupExperiment(self.c, 0, f64::NAN, start, defined, stop) }
    }

    pub fn switch_log(&mut self, on: bool, categories: &[&CStr]) -> fmi2Status {
        let names: Vec<*const c_char> = categories.iter().map(|name| name.as_ptr()).collect();
        // SAFETY: the instance lives or is NULL, and the names live through the call.
        unsafe { fmi2SetDebugLogging(self.c, on.into(), names.len(), names.as_ptr()) }
    }

    /// Goes to "step complete" at `time`.
    pub fn start(&mut self, time: f64, stop: Option<f64>) -> &mut Self {
        assert_eq!(self.setup(time, stop), fmi2OK);
        assert_eq!(self.enter_initialization_mode(), fmi2OK);
        assert_eq!(self.exit_initialization_mode(), fmi2OK);
        self
    }

    /// Sets a Real.
    pub fn set(&mut self, reference: u32, value: f64) -> fmi2Status {
        self.set_reals(&[reference], &[value])
    }

    /// Gets Reals.
    #[track_caller]
    pub fn get<const N: usize>(&mut self, references: [u32; N]) -> [f64; N] {
        let mut values = [f64::NAN; N];
        assert_eq!(self.get_reals(&references, &mut values), fmi2OK);
        values
    }

    /// Sets variables of any kind; Strings are set to the text of the number.
    pub fn set_all(&mut self, kind: Kind, references: &[u32], values: &[f64]) -> fmi2Status {
        let integers: Vec<i32> = values.iter().map(|&value| value as i32).collect();
        match kind {
            Kind::Real => self.set_reals(references, values),
            Kind::Integer => self.set_integers(references, &integers),
            Kind::Boolean => self.set_booleans(references, &integers),
            Kind::String => {
                let texts = values.iter().map(|v| CString::new(v.to_string()).unwrap());
                let texts: Vec<_> = texts.collect();
                let texts: Vec<_> = texts.iter().map(|text| text.as_ptr()).collect();
                self.set_strings(references, &texts)
            }
        }
    }

    /// Gets variables of any kind as numbers; values that are not returned are -7.
    pub fn get_all(&mut self, kind: Kind, references: &[u32]) -> (fmi2Status, Vec<f64>) {
        let mut reals = vec![-7.0; references.len()];
        let mut integers = vec![-7; references.len()];
        let status = match kind {
            Kind::Real => self.get_reals(references, &mut reals),
            Kind::Integer => self.get_integers(references, &mut integers),
            Kind::Boolean => self.get_booleans(references, &mut integers),
            Kind::String => {
                let mut texts = vec![c"-7".as_ptr(); references.len()];
                let status = self.get_strings(references, &mut texts);
                // SAFETY: strings of the slave, valid until its next call, or the literal.
                let texts = texts.iter().map(|&text| unsafe { CStr::from_ptr(text) });
                reals = texts.map(|text| number(text.to_str().unwrap())).collect();
                status
            }
        };
        match kind {
            Kind::Real | Kind::String => (status, reals),
            _ => (status, integers.into_iter().map(f64::from).collect()),
        }
    }

    /// A new FMU state; NULL if the call fails.
    pub fn save(&mut self) -> fmi2FMUstate {
        let mut state = null_mut();
        self.get_state(&mut state);
        state
    }

    /// The bytes of an FMU state.
    #[track_caller]
    pub fn serialize(&mut self, state: fmi2FMUstate) -> Vec<u8> {
        let mut size = 0;
        assert_eq!(self.serialized_size(state, &mut size), fmi2OK);
        let mut bytes = vec![0; size];
        assert_eq!(self.serialize_into(state, &mut bytes), fmi2OK);
        bytes
    }

    /// The serialized state of the instance.
    #[track_caller]
    pub fn snapshot(&mut self) -> Vec<u8> {
        let mut state = self.save();
        let bytes = self.serialize(state);
        assert_eq!(self.free_state(&mut state), fmi2OK);
        bytes
    }

    /// Restores a serialized state.
    #[track_caller]
    pub fn resume(&mut self, bytes: &[u8]) -> &mut Self {
        let mut state = null_mut();
        assert_eq!(self.deserialize(bytes, &mut state), fmi2OK);
        assert_eq!(self.set_state(state), fmi2OK);
        assert_eq!(self.free_state(&mut state), fmi2OK);
        self
    }
}
