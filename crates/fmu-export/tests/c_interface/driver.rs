//! Instances whose logs and callbacks the tests see.

use std::cell::{Cell, RefCell};
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ops::Deref;
use std::ptr::null;
use std::sync::Once;

use fmu_export::{Entry, fmi2::*, fmi3::*};

pub use crate::fmu::*;
use crate::models::{MODELS, fmi2Instantiate};

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
    pub fn new(kind: Kind, model: usize) -> Self {
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

/// What a host does in `clockUpdate`.
type OnClockUpdate = Box<dyn FnMut(Fmu)>;

/// What a host does in an intermediate update; it may request an early return at a time.
type OnUpdate = Box<dyn FnMut(Fmu, Intermediate) -> Option<f64>>;

/// What the callbacks use.
#[derive(Default)]
pub struct Host {
    instance: Cell<Option<Fmu>>,
    messages: RefCell<Vec<Message>>,
    pub updates: RefCell<Vec<Intermediate>>,
    on_update: RefCell<Option<OnUpdate>>,
    on_clock_update: RefCell<Option<OnClockUpdate>>,
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

unsafe extern "C" fn clock_update(host: *mut c_void) {
    // SAFETY: the host comes from `Instance::with`.
    let host = unsafe { &*host.cast::<Host>() };
    if let Some(act) = host.on_clock_update.borrow_mut().as_mut() {
        act(host.instance.get().unwrap());
    }
}

thread_local! {
    /// How often the calls of this thread have locked and unlocked preemption, and what it does when it is locked.
    pub static LOCKS: Cell<[usize; 2]> = const { Cell::new([0; 2]) };
}

unsafe extern "C" fn lock() {
    LOCKS.set([LOCKS.get()[0] + 1, LOCKS.get()[1]]);
}

unsafe extern "C" fn unlock() {
    LOCKS.set([LOCKS.get()[0], LOCKS.get()[1] + 1]);
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
    pub fn new(kind: Kind, model: usize) -> Self {
        Self::with(&Arguments::new(kind, model))
    }

    /// An instance that runs, from 0 s: in step mode or continuous-time mode.
    #[track_caller]
    pub fn running(kind: Kind, model: usize) -> Self {
        Self::new(kind, model).run(0.0)
    }

    #[track_caller]
    pub fn run(self, time: f64) -> Self {
        self.start(time, None);
        if !matches!(self.kind.1, Stepped | Scheduled) {
            self.update();
            self.end_event_mode();
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
                (Fmi3, Scheduled) => instantiate_scheduled_execution::<true>(
                    models, name, token, path, 0, debug.into(), environment, log, Some(clock_update), Some(lock),
                    Some(unlock),
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

    /// What the host does in `clockUpdate`.
    pub fn on_clock_update(&self, act: impl FnMut(Fmu) + 'static) {
        *self.host.on_clock_update.borrow_mut() = Some(Box::new(act));
    }

    /// The times of the intermediate updates since the last call.
    pub fn update_times(&self) -> Vec<f64> {
        let updates = self.host.updates.take();
        updates.iter().map(|update| update.time).collect()
    }
}
