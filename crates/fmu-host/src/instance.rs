//! Instances, with a method for each operation of FMI. The methods call the function of the instance's
//! version; a method that only one version has fails for the other.

use std::ffi::{CString, c_int, c_void};
use std::ptr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use fmi_abi::fmi2::*;
use fmi_abi::fmi3::*;
use fmi_abi::{FmiVersion, InterfaceType};

use crate::functions::{Fmi2, Fmi3, Handle};
#[cfg(feature = "sandbox")]
use crate::library::Binary;
use crate::library::Library;
use crate::logger::{
    LogMessage, Registered, clock_update, intermediate_update, log_3, logger, text,
};
use crate::observed::{Argument, CallObserver, Direction, ObservedCall, ToElement, Values};
use crate::outcome::{Cause, Failure, Result, Success};
use crate::preemption::{lock_preemption, unlock_preemption};
use crate::quick::Quick;
use crate::types::{CompletedStep, DiscreteStatesUpdate, FmuState, Instantiation, Treatment};

/// Calls the function that performs an operation: of the instance's version, or of the only version that has
/// it.
macro_rules! call {
    (both $instance:ident.$operation:ident $values:tt) => {
        match $instance.handle.version {
            FmiVersion::Fmi2 => Fmi2(&mut $instance.handle).$operation $values,
            FmiVersion::Fmi3 => Fmi3(&mut $instance.handle).$operation $values,
        }
    };
    ($version:ident $instance:ident.$operation:ident $values:tt) => {
        $version(&mut $instance.handle).$operation $values
    };
}

impl Library {
    /// `fmi2Instantiate`, or the function of FMI 3.0 for the interface type; `None` if it returns NULL. `sink` receives the log messages of the instance, possibly on a thread that the FMU
    /// has started.
    ///
    /// # Errors
    /// The function is missing, or an argument contains a zero byte.
    pub fn instantiate(
        self: &Arc<Self>,
        arguments: &Instantiation<'_>,
        sink: impl Fn(LogMessage) + Send + Sync + 'static,
    ) -> Result<Option<Instance>> {
        let function = arguments.interface_type.instantiation(self.version);
        let is_scheduled = arguments.interface_type == InterfaceType::ScheduledExecution;
        if is_scheduled && self.version == FmiVersion::Fmi2 {
            return Err(Failure::new(function, Cause::NotScheduled));
        }
        let given = [arguments.name, arguments.guid, arguments.resources];
        let terminated = |text| CString::new(text).map(CString::into_bytes_with_nul);
        let strings: std::result::Result<Vec<_>, _> = given.into_iter().map(terminated).collect();
        let mut strings = strings.map_err(|_| Failure::new(function, Cause::ZeroByte))?;
        let [name, guid, resources] = [0, 1, 2].map(|i| strings[i].as_ptr().cast());
        let resources = match arguments.treatment {
            Treatment::NoResources => ptr::null(),
            _ => resources,
        };
        let has_logger = arguments.treatment != Treatment::NoLogger;
        let log = has_logger.then_some(log_3 as fmi3LogMessageCallback);
        let on_intermediate = arguments.on_intermediate.clone();
        let update = on_intermediate.is_some();
        let update = update.then_some(intermediate_update as fmi3IntermediateUpdateCallback);
        let registered = Registered::new(Arc::new(sink), on_intermediate);
        let environment = registered.environment();
        let mut instance = Instance::new(self, registered, has_logger.then(logger));
        instance.handle.observer = arguments.observer.clone().or_else(|| self.observer().cloned());
        let observer = instance.handle.observer.clone();
        let begin = || {
            observer.iter().for_each(|observer| {
                arguments.observe(function, self.version, |call| observer.begin(call))
            });
            Instant::now()
        };
        let end = |begun: Instant, is_instance: bool| {
            let duration = begun.elapsed();
            let status = Some(if is_instance { 0 } else { fmi3Error.0 });
            let end = |observer: &Arc<dyn CallObserver>| {
                arguments
                    .observe(function, self.version, |call| observer.end(call, status, duration));
            };
            observer.iter().for_each(end);
        };
        #[cfg(feature = "sandbox")]
        if let Binary::Component(component) = &self.binary {
            let begun = begin();
            instance.handle.component = component.instantiate(arguments, environment)?;
            end(begun, instance.handle.component.is_some());
            return Ok(instance.handle.component.is_some().then_some(instance));
        }
        let on = arguments.logging_on;
        let (fmi2, fmi3) = self.functions();
        let missing = || Failure::new(function, Cause::Missing);
        // SAFETY: the types follow the standard; the instance keeps the strings and the callbacks
        // until it is freed, and the FMU copies the value references.
        let pointer = unsafe {
            match (self.version, arguments.interface_type) {
                (FmiVersion::Fmi2, interface_type) => {
                    let instantiate = fmi2.fmi2Instantiate.ok_or_else(missing)?;
                    let (kind, callbacks) = (interface_type as c_int, instance.callbacks());
                    let begun = begin();
                    let pointer = instantiate(name, kind, guid, resources, callbacks, 0, on.into());
                    end(begun, !pointer.is_null());
                    pointer
                }
                (FmiVersion::Fmi3, InterfaceType::ModelExchange) => {
                    let instantiate = fmi3.fmi3InstantiateModelExchange.ok_or_else(missing)?;
                    let begun = begin();
                    let pointer =
                        instantiate(name, guid, resources, 0, on.into(), environment, log);
                    end(begun, !pointer.is_null());
                    pointer
                }
                (FmiVersion::Fmi3, InterfaceType::CoSimulation) => {
                    let instantiate = fmi3.fmi3InstantiateCoSimulation.ok_or_else(missing)?;
                    let begun = begin();
                    let pointer = instantiate(
                        name,
                        guid,
                        resources,
                        0,
                        on.into(),
                        arguments.event_mode_used.into(),
                        arguments.early_return_allowed.into(),
                        arguments.intermediate_variables.as_ptr(),
                        arguments.intermediate_variables.len(),
                        environment,
                        log,
                        update,
                    );
                    end(begun, !pointer.is_null());
                    pointer
                }
                (FmiVersion::Fmi3, InterfaceType::ScheduledExecution) => {
                    let instantiate = fmi3.fmi3InstantiateScheduledExecution.ok_or_else(missing)?;
                    let begun = begin();
                    let pointer = instantiate(
                        name,
                        guid,
                        resources,
                        0,
                        on.into(),
                        environment,
                        log,
                        Some(clock_update),
                        Some(lock_preemption),
                        Some(unlock_preemption),
                    );
                    end(begun, !pointer.is_null());
                    pointer
                }
            }
        };
        if arguments.treatment == Treatment::ShortLivedStrings {
            let bytes = strings.iter_mut().flatten();
            bytes.filter(|byte| **byte != 0).for_each(|byte| *byte = b'#');
        }
        instance.strings = strings;
        instance.handle.pointer = pointer;
        Ok((!pointer.is_null()).then_some(instance))
    }
}

impl Instantiation<'_> {
    /// Passes the call to an observer, with its arguments.
    fn observe(
        &self,
        function: &'static str,
        version: FmiVersion,
        receive: impl FnOnce(&ObservedCall<'_>),
    ) {
        let given = |name, element| Argument {
            name,
            direction: Direction::In,
            values: Values::One(element),
        };
        let resources = (self.treatment != Treatment::NoResources).then_some(self.resources);
        let (name, on) = (given("name", self.name.element()), self.logging_on.element());
        let (visible, on) = (given("visible", false.element()), given("logging_on", on));
        let resources = given("resources", resources.element());
        let token = |name| given(name, self.guid.element());
        let kind = given("kind", (self.interface_type as c_int).element());
        let intermediate_variables = Argument {
            name: "intermediate_variables",
            direction: Direction::In,
            values: Values::List(&self.intermediate_variables),
        };
        let arguments = match (version, self.interface_type) {
            (FmiVersion::Fmi2, _) => vec![name, kind, token("guid"), resources, visible, on],
            (
                FmiVersion::Fmi3,
                InterfaceType::ModelExchange | InterfaceType::ScheduledExecution,
            ) => {
                vec![name, token("token"), resources, visible, on]
            }
            (FmiVersion::Fmi3, InterfaceType::CoSimulation) => {
                let event_mode = given("event_mode_used", self.event_mode_used.element());
                let early = given("early_return_allowed", self.early_return_allowed.element());
                let token = token("token");
                vec![name, token, resources, visible, on, event_mode, early, intermediate_variables]
            }
        };
        receive(&ObservedCall { function, arguments: &arguments });
    }
}

/// An instance of an FMU, which is freed on drop. It keeps its library loaded.
pub struct Instance {
    pub(crate) handle: Handle,
    /// The FMU keeps a pointer to them. Allocated as a box, and freed with the instance. FMI 3.0 has none.
    callbacks: Option<*mut fmi2CallbackFunctions>,
    /// The arguments of [`Instance::setup_experiment`], which FMI 3.0 passes with the next call.
    experiment: Experiment,
    /// Whether a state was saved, so that a step must not say that none will be restored.
    pub(crate) is_saved: bool,
    pub(crate) quick: Quick,
    /// The strings of the instantiation, to which some FMUs keep pointers although they must not.
    strings: Vec<Vec<u8>>,
    pub(crate) registered: Registered,
}

// SAFETY: FMI allows any thread to call the functions of an instance, but not concurrently, which
// `&mut self` ensures.
unsafe impl Send for Instance {}

/// The relative tolerance, the start time and the stop time (s), optional ones with whether they are given.
type Experiment = ((bool, f64), f64, (bool, f64));

unsafe extern "C" {
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(memory: *mut c_void);
}

/// How often FMUs have called `allocateMemory`.
static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

unsafe extern "C" fn allocate(count: usize, size: usize) -> *mut c_void {
    ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
    // SAFETY: it may be called with any arguments.
    unsafe { calloc(count, size) }
}

/// How often FMUs have called `allocateMemory` in this process (FMI 2.0.5, section 2.1.5).
pub fn allocations() -> usize {
    ALLOCATIONS.load(Ordering::Relaxed)
}

/// A type of numbers with functions of its own.
pub trait Number: Copy + Default {
    /// Gets the values of all elements of variables.
    ///
    /// # Errors
    /// As for every call: the function is missing or returned a failure status.
    fn get(instance: &mut Instance, references: &[u32], values: &mut [Self]) -> Result;

    /// Sets the values of all elements of variables.
    ///
    /// # Errors
    /// As [`get`](Self::get).
    fn set(instance: &mut Instance, references: &[u32], values: &[Self]) -> Result;
}

/// Defines methods that get and set numbers, with the versions that have the type. In FMI 2.0, a variable has
/// one element, and if the slices differ in length, the rest of the longer one is ignored.
macro_rules! numbers {
    ($($type:ty: $get:ident $set:ident in $versions:ident;)*) => {
        $(
            impl Number for $type {
                #[inline(always)]
                fn get(instance: &mut Instance, references: &[u32], values: &mut [Self]) -> Result {
                    instance.$get(references, values)
                }

                #[inline(always)]
                fn set(instance: &mut Instance, references: &[u32], values: &[Self]) -> Result {
                    instance.$set(references, values)
                }
            }

            methods! {
                #[inline(always)]
                $versions $get(references: &[u32], values: &mut [$type]);
                #[inline(always)]
                $versions $set(references: &[u32], values: &[$type]);
            }
        )*
    };
}

/// Defines methods that only call the function of the instance's version, or fail if only the other version
/// has it.
macro_rules! methods {
    ($($(#[$attribute:meta])* $versions:ident $method:ident($($arg:ident: $type:ty),*);)*) => {
        impl Instance { $(
            #[doc = concat!("The function of the instance's version for `", stringify!($method), "`.")]
            ///
            /// # Errors
            /// The version has no such function, it is missing or returned a failure status.
            $(#[$attribute])*
            pub fn $method(&mut self, $($arg: $type),*) -> Result {
                call!($versions self.$method($($arg),*))
            }
        )* }
    };
}

numbers! {
    f64: get_float64 set_float64 in both;
    f32: get_float32 set_float32 in Fmi3;
    i8: get_int8 set_int8 in Fmi3;
    u8: get_uint8 set_uint8 in Fmi3;
    i16: get_int16 set_int16 in Fmi3;
    u16: get_uint16 set_uint16 in Fmi3;
    i32: get_int32 set_int32 in both;
    u32: get_uint32 set_uint32 in Fmi3;
    i64: get_int64 set_int64 in Fmi3;
    u64: get_uint64 set_uint64 in Fmi3;
}

methods! {
    both exit_initialization_mode();
    both enter_event_mode();
    both enter_continuous_time_mode();
    Fmi3 enter_step_mode();
    Fmi3 enter_configuration_mode();
    Fmi3 exit_configuration_mode();
    Fmi3 evaluate_discrete_states();
    Fmi3 get_clock(clocks: &[u32], values: &mut [fmi3Clock]);
    Fmi3 set_clock(clocks: &[u32], values: &[fmi3Clock]);
    Fmi3 get_interval_decimal(
        clocks: &[u32], intervals: &mut [f64], qualifiers: &mut [fmi3IntervalQualifier]
    );
    Fmi3 get_interval_fraction(
        clocks: &[u32], counters: &mut [u64], resolutions: &mut [u64],
        qualifiers: &mut [fmi3IntervalQualifier]
    );
    Fmi3 get_shift_decimal(clocks: &[u32], shifts: &mut [f64]);
    Fmi3 get_shift_fraction(clocks: &[u32], counters: &mut [u64], resolutions: &mut [u64]);
    Fmi3 set_interval_decimal(clocks: &[u32], intervals: &[f64]);
    Fmi3 set_interval_fraction(clocks: &[u32], counters: &[u64], resolutions: &[u64]);
    Fmi3 set_shift_decimal(clocks: &[u32], shifts: &[f64]);
    Fmi3 set_shift_fraction(clocks: &[u32], counters: &[u64], resolutions: &[u64]);
    both terminate();
    both reset();
    both set_time(time: f64);
    both set_continuous_states(states: &[f64]);
    both get_continuous_states(states: &mut [f64]);
    both get_continuous_state_derivatives(derivatives: &mut [f64]);
    both get_event_indicators(values: &mut [f64]);
    both get_nominals_of_continuous_states(values: &mut [f64]);
    both get_directional_derivative(
        unknowns: &[u32], knowns: &[u32], seed: &[f64], values: &mut [f64]
    );
    Fmi3 get_adjoint_derivative(unknowns: &[u32], knowns: &[u32], seed: &[f64], values: &mut [f64]);
    Fmi2 set_input_derivatives(references: &[u32], orders: &[i32], values: &[f64]);
    both get_output_derivatives(references: &[u32], orders: &[i32], values: &mut [f64]);
    both set_fmu_state(state: &FmuState);
    Fmi3 get_number_of_continuous_states(n: &mut usize);
    Fmi3 get_number_of_event_indicators(n: &mut usize);
    Fmi2 cancel_step();
    Fmi2 get_status(kind: fmi2StatusKind, value: &mut fmi2Status);
    Fmi2 get_real_status(kind: fmi2StatusKind, value: &mut f64);
    Fmi2 get_integer_status(kind: fmi2StatusKind, value: &mut i32);
    Fmi2 get_boolean_status(kind: fmi2StatusKind, value: &mut fmi2Boolean);
    Fmi2 get_string_status(kind: fmi2StatusKind, value: &mut fmi2String);
}

impl Instance {
    /// An instance before its instantiation, with the callbacks for it.
    pub(crate) fn new(
        library: &Arc<Library>,
        registered: Registered,
        logger: Option<fmi2CallbackLogger>,
    ) -> Self {
        let callbacks = || {
            Box::into_raw(Box::new(fmi2CallbackFunctions {
                logger,
                allocateMemory: Some(allocate),
                freeMemory: Some(free),
                stepFinished: None,
                componentEnvironment: registered.environment(),
            }))
        };
        Self {
            handle: Handle {
                library: Arc::clone(library),
                pointer: ptr::null_mut(),
                version: library.version(),
                observer: None,
                #[cfg(feature = "sandbox")]
                component: None,
            },
            callbacks: (library.version() == FmiVersion::Fmi2).then(callbacks),
            experiment: Experiment::default(),
            is_saved: false,
            quick: Quick::NOTHING,
            strings: Default::default(),
            registered,
        }
    }

    /// The callbacks of FMI 2.0.
    pub(crate) fn callbacks(&self) -> *const fmi2CallbackFunctions {
        self.callbacks.map_or(ptr::null(), |pointer| pointer)
    }

    /// Its library.
    pub fn library(&self) -> &Arc<Library> {
        &self.handle.library
    }

    /// Its version of FMI.
    pub fn version(&self) -> FmiVersion {
        self.handle.version
    }

    /// The failure of a function that returned success, by the operation that it performs.
    fn broke(&self, operation: &'static str, cause: Cause) -> Failure {
        Failure::new(self.handle.version.function(operation).unwrap_or(operation), cause)
    }

    /// Gets `n` numbers: `instance.read(n, Instance::get_event_indicators)`.
    ///
    /// # Errors
    /// As for every call: the function is missing or returned a failure status.
    pub fn read<T: Clone + Default>(
        &mut self,
        n: usize,
        get: impl FnOnce(&mut Self, &mut [T]) -> Result,
    ) -> Result<Vec<T>> {
        let mut values = vec![T::default(); n];
        get(self, &mut values)?;
        Ok(values)
    }

    /// `fmi2SetDebugLogging`, `fmi3SetDebugLogging`
    pub fn set_debug_logging(&mut self, on: bool, categories: &[CString]) -> Result {
        let names: Vec<fmi2String> = categories.iter().map(|name| name.as_ptr()).collect();
        call!(both self.set_debug_logging(on, &names))
    }

    /// `fmi2SetupExperiment`: start and stop time in s, and the relative tolerance. FMI 3.0 passes them
    /// when [`Instance::enter_initialization_mode`] is called.
    pub fn setup_experiment(
        &mut self,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Result {
        let flagged = |value: Option<f64>| (value.is_some(), value.unwrap_or_default());
        self.experiment = (flagged(tolerance), start, flagged(stop));
        let ((has_tolerance, tolerance), start, (has_stop, stop)) = self.experiment;
        match self.handle.version {
            FmiVersion::Fmi2 => Fmi2(&mut self.handle).setup_experiment(
                has_tolerance,
                tolerance,
                start,
                has_stop,
                stop,
            ),
            FmiVersion::Fmi3 => Ok(Success::Ok),
        }
    }

    /// `fmi2EnterInitializationMode`, `fmi3EnterInitializationMode`
    pub fn enter_initialization_mode(&mut self) -> Result {
        let ((has_tolerance, tolerance), start, (has_stop, stop)) = self.experiment;
        match self.handle.version {
            FmiVersion::Fmi2 => Fmi2(&mut self.handle).enter_initialization_mode(),
            FmiVersion::Fmi3 => Fmi3(&mut self.handle).enter_initialization_mode(
                has_tolerance,
                tolerance,
                start,
                has_stop,
                stop,
            ),
        }
    }

    /// `fmi2GetBoolean`, `fmi3GetBoolean`; as integers, since a foreign FMU may return values other than
    /// 0 and 1.
    pub fn get_boolean(&mut self, references: &[u32], values: &mut [fmi2Boolean]) -> Result {
        if self.handle.version == FmiVersion::Fmi2 {
            return Fmi2(&mut self.handle).get_boolean(references, values);
        }
        let mut bytes = vec![fmi3False; values.len()];
        let got = Fmi3(&mut self.handle).get_boolean(references, &mut bytes)?;
        for (value, byte) in values.iter_mut().zip(bytes) {
            *value = byte.into();
        }
        Ok(got)
    }

    /// `fmi2SetBoolean`, `fmi3SetBoolean`; in FMI 3.0 every value but 0 is true.
    pub fn set_boolean(&mut self, references: &[u32], values: &[fmi2Boolean]) -> Result {
        if self.handle.version == FmiVersion::Fmi2 {
            return Fmi2(&mut self.handle).set_boolean(references, values);
        }
        let bytes: Vec<_> = values.iter().map(|v| fmi3Boolean::from(*v != 0)).collect();
        Fmi3(&mut self.handle).set_boolean(references, &bytes)
    }

    /// `fmi2GetString`, `fmi3GetString` of variables with `n` elements in total.
    pub fn get_string(&mut self, references: &[u32], n: usize) -> Result<(Success, Vec<String>)> {
        let (got, texts) = self.get_string_late(references, n, || ())?;
        let cause = Cause::Broke("returned NULL for a string");
        let texts = texts.into_iter().collect::<Option<_>>();
        Ok((got, texts.ok_or_else(|| self.broke("get_string", cause))?))
    }

    /// As [`Instance::get_string`], but the strings, which may be NULL, are copied only after `between` was
    /// called, which is not to call functions of this instance.
    pub fn get_string_late(
        &mut self,
        references: &[u32],
        n: usize,
        between: impl FnOnce(),
    ) -> Result<(Success, Vec<Option<String>>)> {
        let mut values = vec![ptr::null(); n];
        let got = call!(both self.get_string(references, &mut values))?;
        between();
        // SAFETY: by the standard, the FMU's strings are valid until its next call.
        let texts = values.into_iter().map(|value| unsafe { text(value) });
        Ok((got, texts.collect()))
    }

    /// `fmi2SetString`, `fmi3SetString`
    pub fn set_string(&mut self, references: &[u32], values: &[CString]) -> Result {
        let values: Vec<fmi2String> = values.iter().map(|value| value.as_ptr()).collect();
        call!(both self.set_string(references, &values))
    }

    /// `fmi3GetBinary` of variables with `n` elements in total.
    pub fn get_binary(&mut self, references: &[u32], n: usize) -> Result<(Success, Vec<Vec<u8>>)> {
        let (mut sizes, mut values) = (vec![0; n], vec![ptr::null(); n]);
        let got = Fmi3(&mut self.handle).get_binary(references, &mut sizes, &mut values)?;
        let copied = values.iter().zip(sizes).map(|(value, size)| match size {
            0 => Some(Vec::new()),
            _ if value.is_null() => None,
            // SAFETY: not NULL by the check; by the standard, the bytes are valid until the next call.
            _ => Some(unsafe { std::slice::from_raw_parts(*value, size) }.to_vec()),
        });
        let cause = Cause::Broke("returned NULL for a binary that is not empty");
        let copied = copied.collect::<Option<_>>();
        Ok((got, copied.ok_or_else(|| Failure::new("fmi3GetBinary", cause))?))
    }

    /// `fmi3SetBinary`
    pub fn set_binary(&mut self, references: &[u32], values: &[&[u8]]) -> Result {
        let (sizes, values): (Vec<_>, Vec<_>) =
            values.iter().map(|value| (value.len(), value.as_ptr())).unzip();
        Fmi3(&mut self.handle).set_binary(references, &sizes, &values)
    }

    /// Gets and sets no variables of type Float64, with NULL for all arrays.
    pub fn get_and_set_nothing(&mut self) -> Result {
        #[cfg(feature = "sandbox")]
        if self.handle.component.is_some() {
            self.get_float64(&[], &mut [])?;
            return self.set_float64(&[], &[]);
        }
        let (library, i) = (&*self.handle.library, self.handle.pointer);
        let (none, out) = (ptr::null(), ptr::null_mut());
        let name = |get_2, get_3| match self.handle.version {
            FmiVersion::Fmi2 => get_2,
            FmiVersion::Fmi3 => get_3,
        };
        let get = name("fmi2GetReal", "fmi3GetFloat64");
        let set = name("fmi2SetReal", "fmi3SetFloat64");
        let (fmi2, fmi3) = library.functions();
        let missing = |name| move || Failure::new(name, Cause::Missing);
        // SAFETY: the types follow the standard, which allows NULL for arrays without elements.
        let (got, was_set) = unsafe {
            match self.handle.version {
                FmiVersion::Fmi2 => {
                    let get_real = fmi2.fmi2GetReal.ok_or_else(missing(get))?;
                    let set_real = fmi2.fmi2SetReal.ok_or_else(missing(set))?;
                    (
                        library.observe(get, || get_real(i, ptr::null(), 0, out).0),
                        library.observe(set, || set_real(i, ptr::null(), 0, none).0),
                    )
                }
                FmiVersion::Fmi3 => {
                    let get_float = fmi3.fmi3GetFloat64.ok_or_else(missing(get))?;
                    let set_float = fmi3.fmi3SetFloat64.ok_or_else(missing(set))?;
                    (
                        library.observe(get, || get_float(i, ptr::null(), 0, out, 0).0),
                        library.observe(set, || set_float(i, ptr::null(), 0, none, 0).0),
                    )
                }
            }
        };
        library.outcome(get, got)?;
        library.outcome(set, was_set)
    }

    /// `fmi2GetFMUstate`, `fmi3GetFMUState`
    pub fn get_fmu_state(&mut self) -> Result<FmuState> {
        let mut state = FmuState(ptr::null_mut());
        self.save_to(&mut state)?;
        let cause = Cause::Broke("returned success and no state");
        match state.0.is_null() {
            false => Ok(state),
            true => Err(self.broke("get_fmu_state", cause)),
        }
    }

    /// `fmi2GetFMUstate`, `fmi3GetFMUState` with a state that exists, which the FMU overwrites.
    pub fn save_to(&mut self, state: &mut FmuState) -> Result {
        self.is_saved = true;
        call!(both self.get_fmu_state(state))
    }

    /// `fmi2FreeFMUstate`, `fmi3FreeFMUState`
    pub fn free_fmu_state(&mut self, mut state: FmuState) -> Result {
        let freed = call!(both self.free_fmu_state(&mut state))?;
        let cause = Cause::Broke("did not set the state to NULL");
        if state.0.is_null() { Ok(freed) } else { Err(self.broke("free_fmu_state", cause)) }
    }

    /// `fmi2FreeFMUstate`, `fmi3FreeFMUState` with a pointer to NULL, which does nothing by the standard.
    pub fn free_null_state(&mut self) -> Result {
        self.free_fmu_state(FmuState(ptr::null_mut()))
    }

    /// `fmi2SerializedFMUstateSize` and `fmi2SerializeFMUstate`, `fmi3SerializedFMUStateSize` and
    /// `fmi3SerializeFMUState`; an error if there are more than `max` bytes.
    pub fn serialize_fmu_state(&mut self, state: &FmuState, max: usize) -> Result<Vec<u8>> {
        // An FMU that writes more than it announced damages these bytes only.
        const GUARD: [u8; 64] = [0xa5; 64];
        let mut n = 0;
        call!(both self.serialized_fmu_state_size(state, &mut n))?;
        if n > max {
            return Err(self.broke("serialized_fmu_state_size", Cause::TooLarge(n)));
        }
        let mut bytes = vec![0_u8; n];
        bytes.extend_from_slice(&GUARD);
        let to = &mut bytes[..n];
        call!(both self.serialize_fmu_state(state, to))?;
        if bytes.split_off(n) != GUARD {
            let cause = Cause::Broke("wrote more bytes than the size that it returned before");
            return Err(self.broke("serialize_fmu_state", cause));
        }
        Ok(bytes)
    }

    /// `fmi2DeSerializeFMUstate`, `fmi3DeserializeFMUState`
    pub fn deserialize_fmu_state(&mut self, bytes: &[u8]) -> Result<FmuState> {
        let mut state = FmuState(ptr::null_mut());
        call!(both self.deserialize_fmu_state(bytes, &mut state))?;
        Ok(state)
    }

    /// `fmi2GetBooleanStatus` of `fmi2Terminated`: whether the FMU has ended the simulation.
    pub fn is_terminated(&mut self) -> Result<bool> {
        let mut terminated = fmi2False;
        self.get_boolean_status(fmi2Terminated, &mut terminated)?;
        Ok(terminated != fmi2False)
    }

    /// `fmi2GetRealStatus` of `fmi2LastSuccessfulTime`: the time (s) that a discarded step has reached.
    pub fn last_successful_time(&mut self) -> Result<f64> {
        let mut time = f64::NAN;
        self.get_real_status(fmi2LastSuccessfulTime, &mut time)?;
        Ok(time)
    }

    /// `fmi2NewDiscreteStates`, `fmi3UpdateDiscreteStates`
    pub fn update_discrete_states(&mut self) -> Result<DiscreteStatesUpdate> {
        let ([again, terminate, nominals, states, is_defined], next) = match self.handle.version {
            FmiVersion::Fmi2 => {
                let mut info = fmi2EventInfo {
                    newDiscreteStatesNeeded: UNWRITTEN,
                    terminateSimulation: UNWRITTEN,
                    nominalsOfContinuousStatesChanged: UNWRITTEN,
                    valuesOfContinuousStatesChanged: UNWRITTEN,
                    nextEventTimeDefined: UNWRITTEN,
                    nextEventTime: 0.0,
                };
                Fmi2(&mut self.handle).update_discrete_states(&mut info)?;
                let flags = [
                    info.newDiscreteStatesNeeded,
                    info.terminateSimulation,
                    info.nominalsOfContinuousStatesChanged,
                    info.valuesOfContinuousStatesChanged,
                    info.nextEventTimeDefined,
                ];
                (flags.map(flag), info.nextEventTime)
            }
            FmiVersion::Fmi3 => {
                let (mut flags, mut next) = ([UNWRITTEN as fmi3Boolean; 5], 0.0);
                let [a, t, n, s, d] = &mut flags;
                Fmi3(&mut self.handle).update_discrete_states(a, t, n, s, d, &mut next)?;
                (flags.map(|value| flag(value.cast_signed())), next)
            }
        };
        let is_set = |flag: Option<bool>| flag == Some(true);
        Ok(DiscreteStatesUpdate {
            again: is_set(again),
            terminate: is_set(terminate),
            nominals_changed: is_set(nominals),
            states_changed: is_set(states),
            next_event: is_set(is_defined).then_some(next),
            is_written: ![again, terminate, states, is_defined].contains(&None),
        })
    }

    /// `fmi2CompletedIntegratorStep`, `fmi3CompletedIntegratorStep`
    pub fn completed_integrator_step(&mut self) -> Result<CompletedStep> {
        let flags = match self.handle.version {
            FmiVersion::Fmi2 => {
                let [mut event, mut terminate] = [UNWRITTEN; 2];
                Fmi2(&mut self.handle).completed_integrator_step(
                    true,
                    &mut event,
                    &mut terminate,
                )?;
                [event, terminate].map(flag)
            }
            FmiVersion::Fmi3 => {
                let [mut event, mut terminate] = [UNWRITTEN as fmi3Boolean; 2];
                Fmi3(&mut self.handle).completed_integrator_step(
                    true,
                    &mut event,
                    &mut terminate,
                )?;
                [event, terminate].map(|value| flag(value.cast_signed()))
            }
        };
        Ok(CompletedStep {
            enter_event_mode: flags[0] == Some(true),
            terminate: flags[1] == Some(true),
            is_written: !flags.contains(&None),
        })
    }
}

/// A result that the FMU has not written: all bits are set.
const UNWRITTEN: fmi2Boolean = -1;

/// A result, if the FMU has written it.
fn flag(value: impl Into<fmi2Boolean>) -> Option<bool> {
    let value = value.into();
    (value != UNWRITTEN).then_some(value != fmi2False)
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.handle.library.is_lost() {
            // No code of the FMU may run, including its destructors, so it is never unloaded.
            std::mem::forget(Arc::clone(&self.handle.library));
            return;
        }
        let free = match self.handle.pointer.is_null() {
            true => None,
            false => match self.handle.library.free_function() {
                Ok(free) => Some(free),
                Err(_) => return, // the callbacks are still in use
            },
        };
        // SAFETY: the instance is not used again; the callbacks are from a box, and the FMU does not use
        // them after this call.
        unsafe {
            if let Some((function, free)) = free {
                let pointer = self.handle.pointer;
                match &self.handle.observer {
                    None => free(pointer),
                    Some(observer) => {
                        let call = ObservedCall { function, arguments: &[] };
                        observer.begin(&call);
                        let begun = Instant::now();
                        free(pointer);
                        observer.end(&call, None, begun.elapsed());
                    }
                }
            }
            if let Some(callbacks) = self.callbacks {
                drop(Box::from_raw(callbacks));
            }
        }
    }
}
