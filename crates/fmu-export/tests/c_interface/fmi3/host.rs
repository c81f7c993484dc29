//! A test host of FMI 3.0: instances, their messages and callbacks, and wrappers of the C functions.

use std::cell::{Cell, RefCell};
use std::ffi::{CStr, CString, c_char, c_int};
use std::ops::Deref;
use std::ptr::{null, null_mut};

use fmu_export::fmi3::*;
use fmu_export::fmi3::{fmi3Error, fmi3OK};

use crate::host::guid;
use crate::models::{BALL, fmi3InstantiateCoSimulation, fmi3InstantiateModelExchange};

/// The kinds of instances.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    CoSimulation,
    /// Co-simulation with event mode.
    Events,
    ModelExchange,
}

/// The arguments of the functions that instantiate.
pub struct Arguments<'a> {
    pub kind: Kind,
    pub name: Option<&'a CStr>,
    pub token: Option<&'a CStr>,
    pub resources: Option<&'a CStr>,
    pub debug: bool,
    pub has_logger: bool,
    pub early_return: bool,
    /// The required intermediate variables; without, there is no callback.
    pub intermediate: Option<&'a [u32]>,
}

impl Arguments<'_> {
    pub fn of(kind: Kind) -> Self {
        Self {
            kind,
            name: Some(c"instance"),
            token: None,
            resources: None,
            debug: false,
            has_logger: true,
            early_return: false,
            intermediate: None,
        }
    }
}

/// The arguments of a call of the logger.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    pub status: c_int,
    pub category: String,
    pub text: String,
}

/// The arguments of a call of the callback for intermediate updates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Update {
    pub time: f64,
    pub set_requested: bool,
    pub get_allowed: bool,
    pub step_finished: bool,
    pub can_return: bool,
}

/// What a host does in an intermediate update; it may request an early return at a time.
pub type OnUpdate = Box<dyn FnMut(Fmu, Update) -> Option<f64>>;

/// What the callbacks use.
#[derive(Default)]
pub struct Host {
    instance: Cell<fmi3Instance>,
    messages: RefCell<Vec<Message>>,
    pub updates: RefCell<Vec<Update>>,
    pub on_update: RefCell<Option<OnUpdate>>,
}

/// The host's pointer to an instance, whose methods are the functions of the standard.
#[derive(Clone, Copy)]
pub struct Fmu(pub fmi3Instance);

/// An instance that is freed at its end.
pub struct Instance {
    fmu: Fmu,
    pub host: Box<Host>,
}

impl Deref for Instance {
    type Target = Fmu;

    fn deref(&self) -> &Fmu {
        &self.fmu
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // SAFETY: the instance lives until here, or is NULL.
        unsafe { fmi3FreeInstance(self.fmu.0) };
    }
}

impl Instance {
    /// A new instance of the ball.
    pub fn new(kind: Kind) -> Self {
        Self::of(kind, BALL)
    }

    pub fn of(kind: Kind, model: usize) -> Self {
        let token = guid(model);
        Self::with(&Arguments {
            token: Some(&token),
            ..Arguments::of(kind)
        })
    }

    /// A new instance, which is NULL if instantiation fails.
    pub fn with(arguments: &Arguments) -> Self {
        crate::host::keep_messages_of_panics();
        let host = Box::<Host>::default();
        let environment = (&raw const *host).cast_mut().cast();
        let text = |text: Option<&CStr>| text.map_or(null(), CStr::as_ptr);
        let [name, token, resources] =
            [arguments.name, arguments.token, arguments.resources].map(text);
        let (debug, log) = (
            arguments.debug.into(),
            arguments
                .has_logger
                .then_some(receive as fmi3LogMessageCallback),
        );
        let variables = arguments.intermediate.unwrap_or_default();
        let update = arguments
            .intermediate
            .map(|_| update as fmi3IntermediateUpdateCallback);
        // SAFETY: the strings outlive the call, and the host outlives the instance.
        let instance = unsafe {
            match arguments.kind {
                Kind::ModelExchange => {
                    fmi3InstantiateModelExchange(name, token, resources, 0, debug, environment, log)
                }
                kind => fmi3InstantiateCoSimulation(
                    name,
                    token,
                    resources,
                    0,
                    debug,
                    (kind == Kind::Events).into(),
                    arguments.early_return.into(),
                    variables.as_ptr(),
                    variables.len(),
                    environment,
                    log,
                    update,
                ),
            }
        };
        host.instance.set(instance);
        Self {
            fmu: Fmu(instance),
            host,
        }
    }

    /// Goes to the end of the initialization at `time`: to step mode, event mode with events, or
    /// continuous-time mode.
    #[track_caller]
    pub fn started(self, time: f64) -> Self {
        self.start(time, None);
        self
    }

    pub fn messages(&self) -> Vec<Message> {
        self.host.messages.borrow().clone()
    }

    pub fn forget_messages(&self) {
        self.host.messages.borrow_mut().clear();
    }

    #[track_caller]
    pub fn last_message(&self) -> String {
        let messages = self.host.messages.borrow();
        messages.last().expect("nothing was logged").text.clone()
    }

    /// Checks that a call fails with one message that contains the words and changes nothing.
    #[track_caller]
    pub fn refuses(&self, words: &[&str], call: impl FnOnce(Fmu) -> fmi3Status) {
        let before = self.snapshot();
        self.forget_messages();
        assert_eq!(call(self.fmu), fmi3Error, "{words:?}");
        let messages = self.messages();
        assert_eq!(messages.len(), 1, "{words:?}: {messages:?}");
        assert_eq!(messages[0].category, "logStatusError");
        assert_eq!(messages[0].status, fmi3Error.0);
        for word in words {
            assert!(messages[0].text.contains(word), "{word}: {messages:?}");
        }
        assert_eq!(self.snapshot(), before, "{words:?}");
    }

    /// What the host does in intermediate updates.
    pub fn on_update(&self, act: impl FnMut(Fmu, Update) -> Option<f64> + 'static) {
        *self.host.on_update.borrow_mut() = Some(Box::new(act));
    }

    /// The times of the intermediate updates since the last call.
    pub fn update_times(&self) -> Vec<f64> {
        let updates = self.host.updates.take();
        updates.iter().map(|update| update.time).collect()
    }
}

pub unsafe extern "C" fn receive(
    environment: fmi3InstanceEnvironment,
    status: c_int,
    category: fmi3String,
    text: fmi3String,
) {
    // SAFETY: the environment is the host passed by `with`, and the others are strings of the FMU.
    let (host, category, text) = unsafe {
        (
            &*environment.cast::<Host>(),
            CStr::from_ptr(category),
            CStr::from_ptr(text),
        )
    };
    host.messages.borrow_mut().push(Message {
        status,
        category: category.to_str().unwrap().to_owned(),
        text: text.to_str().unwrap().to_owned(),
    });
}

unsafe extern "C" fn update(
    environment: fmi3InstanceEnvironment,
    time: fmi3Float64,
    set_requested: fmi3Boolean,
    get_allowed: fmi3Boolean,
    step_finished: fmi3Boolean,
    can_return: fmi3Boolean,
    requested: *mut fmi3Boolean,
    return_time: *mut fmi3Float64,
) {
    // SAFETY: the environment is the host passed by `with`.
    let host = unsafe { &*environment.cast::<Host>() };
    let update = Update {
        time,
        set_requested: set_requested == fmi3True,
        get_allowed: get_allowed == fmi3True,
        step_finished: step_finished == fmi3True,
        can_return: can_return == fmi3True,
    };
    host.updates.borrow_mut().push(update);
    let act = host.on_update.borrow_mut().take();
    if let Some(mut act) = act {
        if let Some(end) = act(Fmu(host.instance.get()), update) {
            // SAFETY: the pointers are those of the FMU.
            unsafe { (*requested, *return_time) = (fmi3True, end) };
        }
        *host.on_update.borrow_mut() = Some(act);
    }
}

/// What `fmi3DoStep` returns besides its status.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Results {
    pub event: bool,
    pub early: bool,
    pub time: f64,
}

/// What `fmi3UpdateDiscreteStates` returns: whether states changed, and the time of the next event.
pub type Discrete = (bool, Option<f64>);

macro_rules! calls {
    ($($method:ident($($argument:ident: $type:ty),*) = $function:ident($($passed:expr),*);)*) => {
        impl Fmu {
            $(
                pub fn $method(self, $($argument: $type),*) -> fmi3Status {
                    // SAFETY: the instance lives or is NULL, and pointers and lengths are from slices.
                    unsafe { $function(self.0, $($passed),*) }
                }
            )*
        }
    };
}

calls! {
    exit_initialization_mode() = fmi3ExitInitializationMode();
    enter_event_mode() = fmi3EnterEventMode();
    enter_step_mode() = fmi3EnterStepMode();
    enter_continuous_time_mode() = fmi3EnterContinuousTimeMode();
    enter_configuration_mode() = fmi3EnterConfigurationMode();
    exit_configuration_mode() = fmi3ExitConfigurationMode();
    terminate() = fmi3Terminate();
    reset() = fmi3Reset();
    get_state(state: &mut fmi3FMUState) = fmi3GetFMUState(state);
    set_state(state: fmi3FMUState) = fmi3SetFMUState(state);
    free_state(state: &mut fmi3FMUState) = fmi3FreeFMUState(state);
    serialized_size(state: fmi3FMUState, size: &mut usize) = fmi3SerializedFMUStateSize(state, size);
    serialize_into(state: fmi3FMUState, bytes: &mut [u8])
        = fmi3SerializeFMUState(state, bytes.as_mut_ptr(), bytes.len());
    deserialize(bytes: &[u8], state: &mut fmi3FMUState)
        = fmi3DeserializeFMUState(bytes.as_ptr(), bytes.len(), state);
    set_time(time: f64) = fmi3SetTime(time);
    set_states(states: &[f64]) = fmi3SetContinuousStates(states.as_ptr(), states.len());
    get_states(values: &mut [f64]) = fmi3GetContinuousStates(values.as_mut_ptr(), values.len());
    get_derivatives(values: &mut [f64])
        = fmi3GetContinuousStateDerivatives(values.as_mut_ptr(), values.len());
    get_nominals(values: &mut [f64])
        = fmi3GetNominalsOfContinuousStates(values.as_mut_ptr(), values.len());
    get_indicators(values: &mut [f64])
        = fmi3GetEventIndicators(values.as_mut_ptr(), values.len());
    count_states(count: &mut usize) = fmi3GetNumberOfContinuousStates(count);
    count_indicators(count: &mut usize) = fmi3GetNumberOfEventIndicators(count);
    completed_integrator_step(event: &mut u8, terminate: &mut u8)
        = fmi3CompletedIntegratorStep(fmi3True, event, terminate);
    get_output_derivatives(references: &[u32], orders: &[i32], values: &mut [f64])
        = fmi3GetOutputDerivatives(
            references.as_ptr(),
            { assert_eq!(references.len(), orders.len()); orders.len() },
            orders.as_ptr(),
            values.as_mut_ptr(),
            values.len()
        );
    directional(unknowns: &[u32], knowns: &[u32], seed: &[f64], sensitivity: &mut [f64])
        = fmi3GetDirectionalDerivative(
            unknowns.as_ptr(), unknowns.len(), knowns.as_ptr(), knowns.len(),
            seed.as_ptr(), seed.len(), sensitivity.as_mut_ptr(), sensitivity.len()
        );
    adjoint(unknowns: &[u32], knowns: &[u32], seed: &[f64], sensitivity: &mut [f64])
        = fmi3GetAdjointDerivative(
            unknowns.as_ptr(), unknowns.len(), knowns.as_ptr(), knowns.len(),
            seed.as_ptr(), seed.len(), sensitivity.as_mut_ptr(), sensitivity.len()
        );
    get_binaries(references: &[u32], sizes: &mut [usize], values: &mut [fmi3Binary])
        = fmi3GetBinary(
            references.as_ptr(), references.len(),
            sizes.as_mut_ptr(),
            values.as_mut_ptr(),
            { assert_eq!(sizes.len(), values.len()); values.len() }
        );
    set_binaries(references: &[u32], sizes: &[usize], values: &[fmi3Binary])
        = fmi3SetBinary(
            references.as_ptr(), references.len(),
            sizes.as_ptr(),
            values.as_ptr(),
            { assert_eq!(sizes.len(), values.len()); values.len() }
        );
}

macro_rules! accesses {
    ($($get:ident($get_function:ident) $set:ident($set_function:ident): $type:ty;)*) => {
        impl Fmu {
            $(
                pub fn $get(self, references: &[u32], values: &mut [$type]) -> fmi3Status {
                    let (n, m) = (references.len(), values.len());
                    // SAFETY: the instance lives or is NULL, and pointers and lengths are from slices.
                    unsafe { $get_function(self.0, references.as_ptr(), n, values.as_mut_ptr(), m) }
                }

                pub fn $set(self, references: &[u32], values: &[$type]) -> fmi3Status {
                    let (n, m) = (references.len(), values.len());
                    // SAFETY: as above.
                    unsafe { $set_function(self.0, references.as_ptr(), n, values.as_ptr(), m) }
                }
            )*
        }
    };
}

accesses! {
    get_f64(fmi3GetFloat64) set_f64(fmi3SetFloat64): f64;
    get_f32(fmi3GetFloat32) set_f32(fmi3SetFloat32): f32;
    get_i8(fmi3GetInt8) set_i8(fmi3SetInt8): i8;
    get_u8(fmi3GetUInt8) set_u8(fmi3SetUInt8): u8;
    get_i16(fmi3GetInt16) set_i16(fmi3SetInt16): i16;
    get_u16(fmi3GetUInt16) set_u16(fmi3SetUInt16): u16;
    get_i32(fmi3GetInt32) set_i32(fmi3SetInt32): i32;
    get_u32(fmi3GetUInt32) set_u32(fmi3SetUInt32): u32;
    get_i64(fmi3GetInt64) set_i64(fmi3SetInt64): i64;
    get_u64(fmi3GetUInt64) set_u64(fmi3SetUInt64): u64;
    get_booleans(fmi3GetBoolean) set_booleans(fmi3SetBoolean): fmi3Boolean;
    get_strings(fmi3GetString) set_strings(fmi3SetString): fmi3String;
}

impl Fmu {
    pub fn enter_initialization_mode(self, start: f64, stop: Option<f64>) -> fmi3Status {
        let (defined, stop) = (stop.is_some().into(), stop.unwrap_or(f64::NAN));
        // SAFETY: the instance lives or is NULL.
        unsafe { fmi3EnterInitializationMode(self.0, 0, f64::NAN, start, defined, stop) }
    }

    pub fn switch_log(self, on: bool, categories: &[&CStr]) -> fmi3Status {
        let names: Vec<*const c_char> = categories.iter().map(|name| name.as_ptr()).collect();
        // SAFETY: the instance lives or is NULL, and the names live through the call.
        unsafe { fmi3SetDebugLogging(self.0, on.into(), names.len(), names.as_ptr()) }
    }

    /// See [`Instance::started`].
    #[track_caller]
    pub fn start(self, time: f64, stop: Option<f64>) {
        assert_eq!(self.enter_initialization_mode(time, stop), fmi3OK);
        assert_eq!(self.exit_initialization_mode(), fmi3OK);
    }

    /// Takes a step; results that are not returned are NaN.
    pub fn step(self, time: f64, step: f64) -> (fmi3Status, Results) {
        let (mut event, mut terminate, mut early, mut last) = (7, 7, 7, f64::NAN);
        // SAFETY: the instance lives or is NULL.
        let status = unsafe {
            fmi3DoStep(
                self.0,
                time,
                step,
                fmi3True,
                &mut event,
                &mut terminate,
                &mut early,
                &mut last,
            )
        };
        if !self.0.is_null() {
            assert!(event <= 1 && early <= 1 && terminate == 0);
        }
        let results = Results {
            event: event == 1,
            early: early == 1,
            time: last,
        };
        (status, results)
    }

    /// Takes a step that succeeds.
    #[track_caller]
    pub fn steps(self, time: f64, step: f64) -> Results {
        let (status, results) = self.step(time, step);
        assert_eq!(status, fmi3OK);
        results
    }

    pub fn try_update(self, result: &mut Discrete) -> fmi3Status {
        let (mut flags, mut next) = ([7; 5], f64::NAN);
        let [needed, terminate, nominals, values, defined] = &mut flags;
        // SAFETY: the instance lives or is NULL.
        let status = unsafe {
            fmi3UpdateDiscreteStates(
                self.0, needed, terminate, nominals, values, defined, &mut next,
            )
        };
        if status == fmi3OK {
            assert_eq!(flags[..3], [0; 3]);
            assert!(flags[3] <= 1 && flags[4] <= 1);
            *result = (flags[3] == 1, (flags[4] == 1).then_some(next));
        } else {
            assert_eq!(flags, [7; 5], "nothing is returned");
        }
        status
    }

    /// Handles an event.
    #[track_caller]
    pub fn update(self) -> Discrete {
        let mut result = (false, None);
        assert_eq!(self.try_update(&mut result), fmi3OK);
        result
    }

    pub fn set(self, reference: u32, value: f64) -> fmi3Status {
        self.set_f64(&[reference], &[value])
    }

    /// Gets scalars of type Float64.
    #[track_caller]
    pub fn get<const N: usize>(self, references: [u32; N]) -> [f64; N] {
        let mut values = [f64::NAN; N];
        assert_eq!(self.get_f64(&references, &mut values), fmi3OK);
        values
    }

    /// Reads two numbers by one of the functions of model exchange.
    #[track_caller]
    pub fn two(self, read: fn(Self, &mut [f64]) -> fmi3Status) -> [f64; 2] {
        let mut values = [f64::NAN; 2];
        assert_eq!(read(self, &mut values), fmi3OK);
        values
    }

    /// A new FMU state; NULL if the call fails.
    pub fn save(self) -> fmi3FMUState {
        let mut state = null_mut();
        self.get_state(&mut state);
        state
    }

    /// The bytes of an FMU state.
    #[track_caller]
    pub fn serialize(self, state: fmi3FMUState) -> Vec<u8> {
        let mut size = 0;
        assert_eq!(self.serialized_size(state, &mut size), fmi3OK);
        let mut bytes = vec![0; size];
        assert_eq!(self.serialize_into(state, &mut bytes), fmi3OK);
        bytes
    }

    /// The serialized state of the instance.
    #[track_caller]
    pub fn snapshot(self) -> Vec<u8> {
        let mut state = self.save();
        let bytes = self.serialize(state);
        assert_eq!(self.free_state(&mut state), fmi3OK);
        bytes
    }

    /// Restores a serialized state.
    #[track_caller]
    pub fn resume(self, bytes: &[u8]) -> Self {
        let mut state = null_mut();
        assert_eq!(self.deserialize(bytes, &mut state), fmi3OK);
        assert_eq!(self.set_state(state), fmi3OK);
        assert_eq!(self.free_state(&mut state), fmi3OK);
        self
    }

    /// Reads Strings.
    #[track_caller]
    pub fn texts(self, references: &[u32], n: usize) -> Vec<CString> {
        let mut values = vec![null(); n];
        assert_eq!(self.get_strings(references, &mut values), fmi3OK);
        // SAFETY: strings of the FMU, valid until its next call.
        let texts = values
            .into_iter()
            .map(|text| unsafe { CStr::from_ptr(text) });
        texts.map(CStr::to_owned).collect()
    }
}
