//! Drives a model in a test as the FMU does, without a host.

use std::any::Any;
use std::cell::RefCell;
use std::ops::{Deref, DerefMut};
use std::path::PathBuf;
use std::rc::Rc;

use fmi_abi::fmi2::calls;
use fmi_abi::state::State;
use fmi_abi::{FmiFunction, FmiVersion};
use fmu_description::interface::GUID_LENGTH;
use fmu_description::{Causality, LogCategory, Naming, ScalarVariable};

pub use fmu_description::Value;

use crate::error::{ModelError, Severity, ensure};
use crate::fast::HostedInstance;
use crate::instance::{Edge, Identity, Instance, Settings, Status};
use crate::laid_out::LaidOut;
use crate::log::{Heading, Log};
use crate::model::Model;
use crate::model_clocks::{self, ModelClocks};
use crate::pointers::Pointer;
use crate::resources::Folder;
use crate::single_instance::Place;
use crate::values::HostValue;

static EDGE: Edge = Edge {
    version: FmiVersion::Fmi2,
    get_float64: FmiFunction { name: "get", ..calls::fmi2GetReal },
    set_float64: FmiFunction { name: "set", ..calls::fmi2SetReal },
    do_step: FmiFunction { name: "step", ..calls::fmi2DoStep },
    get_fmu_state: calls::fmi2GetFMUstate,
    has_clocks: true,
};
const TICK: FmiFunction = FmiFunction { name: "tick", ..calls::fmi2GetReal };
const INITIALIZE: FmiFunction = FmiFunction { name: "initialize", ..calls::fmi2SetupExperiment };

/// A model that a [`Driver`] drives, implemented by `#[derive(Model)]` for structs without type parameters.
#[doc(hidden)]
pub trait Drive: Model {
    /// Creates an instance.
    const INSTANCE: fn(Self) -> DrivenInstance;
}

/// An instance of a model.
#[doc(hidden)]
pub struct DrivenInstance(Box<HostedInstance>);

/// Creates an instance of the model `M` with tables of size `N`.
#[doc(hidden)]
pub fn instance<M: Model, const N: usize>(model: M) -> DrivenInstance {
    let resources = Err("the test has set no folder of resources".to_owned());
    let settings = Settings::new(&EDGE, Log::new(None, false), Folder::Known(resources));
    let naming = Naming::chosen(None, M::NAMING);
    let identity = Identity {
        guid: &[0; GUID_LENGTH],
        variant: None,
        naming,
        clocks: model_clocks::of::<M>(),
        clock_functions: None,
    };
    let model = LaidOut::<M, N>::with_model(model, naming);
    DrivenInstance(HostedInstance::new(settings, identity, model))
}

/// An instance of a model in co-simulation, for tests: it takes samples at their instants, integrates equations,
/// handles events and checks values by the code of the FMU, and computes the same numbers.
///
/// The fields of the model are fields of the driver.
///
/// ```
/// use fmu_export::prelude::*;
/// use fmu_export::testing::Driver;
///
/// /// Integrator
/// #[derive(Model)]
/// #[model(sample_time = 0.1)]
/// pub struct Integrator {
///     /// rate
///     #[input]
///     u: f64,
///     /// integral
///     #[output]
///     y: f64,
///     /// gain
///     #[parameter(start = 2, min = 0)]
///     gain: f64,
/// }
///
/// impl Simulate for Integrator {
///     fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
///         self.y += self.gain * self.u * step;
///         Ok(())
///     }
/// }
///
/// let mut integrator = Driver::<Integrator>::new();
/// assert!(integrator.set("gain", -1).is_err()); // out of bounds, as for a host
/// integrator.u = 1.0;
/// integrator.step(0.05)?; // the sample at 0 s
/// integrator.step(0.05)?; // none
/// assert_eq!(integrator.y, 0.2);
/// # Ok::<(), ModelError>(())
/// ```
pub struct Driver<M> {
    hosted: Box<HostedInstance>,
    /// Given back when the model is dropped.
    _place: Option<Place>,
    log: Rc<RefCell<Vec<Message>>>,
    /// The next communication point is `origin` and `count` times `size` (s).
    origin: f64,
    count: f64,
    size: f64,
    _model: std::marker::PhantomData<M>,
}

/// A message that a host would have got.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// The log category, such as `logStatusWarning`.
    pub category: String,
    /// The text.
    pub text: String,
}

impl<M: Drive> Default for Driver<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: Drive> Driver<M> {
    /// An instance with the start values.
    pub fn new() -> Self {
        let place = Self::wait_for_place();
        Self::at(place, M::new())
    }

    /// An instance with the parameters and inputs of a model; all other fields get their values in the
    /// initialization.
    pub fn of(model: M) -> Self {
        Self::at(Self::wait_for_place(), model)
    }

    /// The place of the only instance, if the process can have one only: tests run on several threads.
    fn wait_for_place() -> Option<Place> {
        M::single_instance().map(|single| single.wait_for(M::NAME))
    }

    fn at(place: Option<Place>, model: M) -> Self {
        let DrivenInstance(mut hosted) = M::INSTANCE(model);
        let log = Rc::<RefCell<Vec<Message>>>::default();
        let messages = Rc::clone(&log);
        let sink = move |heading: Heading, text: &str| {
            if heading.category != LogCategory::Events.name() {
                let category = heading.category.to_string_lossy().into_owned();
                messages.borrow_mut().push(Message { category, text: text.to_owned() });
            }
        };
        let instance = &mut hosted.instance;
        instance.shared.settings.log = Log::new(Some(Box::new(sink)), true);
        instance.model.connect_logs(&instance.shared.settings.log);
        let (origin, count, size, model) = (0.0, 0.0, 0.0, std::marker::PhantomData);
        Self { hosted, _place: place, log, origin, count, size, _model: model }
    }

    /// The same with the folder in which the model finds its resources.
    #[must_use]
    pub fn with_resources(mut self, folder: impl Into<PathBuf>) -> Self {
        self.hosted.instance.shared.settings.resources = Folder::Known(Ok(folder.into()));
        self
    }

    /// Initializes the model at a time (s). Without, the first step does at 0 s.
    ///
    /// # Errors
    /// The model cannot be initialized with its values, or is so already.
    pub fn initialize(&mut self, time: f64) -> Result<(), ModelError> {
        let status = self.hosted.instance.call(&INITIALIZE, |instance| {
            instance.set_experiment(time, None, None)?;
            instance.enter(State::Initialization);
            instance.exit_initialization_mode()
        });
        let lifecycle = &mut self.hosted.instance.shared.lifecycle;
        if lifecycle.state == State::Initialization {
            lifecycle.state = State::Instantiated;
        }
        self.result(status)?;
        self.origin = time;
        Ok(())
    }

    /// Takes a communication step (s), with constant inputs.
    ///
    /// # Errors
    /// The step is invalid, the model refuses or discards it, or it panicked.
    pub fn step(&mut self, size: f64) -> Result<(), ModelError> {
        if self.hosted.instance.shared.lifecycle.state == State::Instantiated {
            self.initialize(0.0)?;
        }
        let (time, step) = (self.time(), self.hosted.head.vtable.step);
        let instance: Pointer = (&raw mut *self.hosted).cast();
        // SAFETY: the function belongs to the instance, which is borrowed for the call.
        let status = unsafe { step(instance, time, size, None) };
        self.result(status)?;
        // Multiplied, not added up, as by most hosts.
        if size != self.size {
            (self.origin, self.count, self.size) = (time, 0.0, size);
        }
        self.count += 1.0;
        Ok(())
    }

    /// Lets input clocks tick, which are given by their names as in [`set`](Self::set), at the current time. Output clocks
    /// that tick then are active until the next tick.
    ///
    /// ```
    /// use fmu_export::prelude::*;
    /// use fmu_export::testing::Driver;
    ///
    /// /// Answers a second after a request
    /// #[derive(Model)]
    /// #[model(clocked)]
    /// pub struct Server {
    ///     /// ticks when a request arrives
    ///     #[input]
    ///     request: Clock,
    ///     /// ticks when the answer is ready
    ///     #[input(countdown)]
    ///     ready: Clock,
    ///     /// ticks with the answer
    ///     #[output]
    ///     answer: Clock,
    /// }
    ///
    /// impl Clocked for Server {
    ///     fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
    ///         if self.request.is_active() {
    ///             self.ready = Clock::after(1.0);
    ///         }
    ///         if self.ready.is_active() {
    ///             self.answer = Clock::TICK;
    ///         }
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut server = Driver::<Server>::new();
    /// server.tick(&["request"])?;
    /// assert_eq!(server.ready.interval(), Some(1.0));
    /// server.step(1.0)?;
    /// server.tick(&["ready"])?;
    /// assert!(server.answer.is_active());
    /// # Ok::<(), ModelError>(())
    /// ```
    ///
    /// # Errors
    /// There is no such input clock, or the model cannot act at the tick.
    pub fn tick(&mut self, clocks: &[&str]) -> Result<(), ModelError> {
        if self.hosted.instance.shared.lifecycle.state == State::Instantiated {
            self.initialize(0.0)?;
        }
        let named = clocks.iter().map(|name| self.variable_named(name));
        let references = named.map(|found| found.map(|(reference, _)| reference));
        let references: Vec<u32> = references.collect::<Result<_, _>>()?;
        let time = self.time();
        let instance = &mut self.hosted.instance;
        let status =
            instance.call(&TICK, |instance| ModelClocks::tick(instance, &references, time));
        self.result(status)
    }

    /// Steps to a time (s), and returns the [`outputs`](Self::outputs) at the communication points, the first of
    /// which is the current one.
    ///
    /// # Errors
    /// The time or the size is not finite, or the size not positive, and as [`step`](Self::step).
    pub fn run(&mut self, stop: f64, size: f64) -> Result<Vec<Vec<f64>>, ModelError> {
        if self.hosted.instance.shared.lifecycle.state == State::Instantiated {
            self.initialize(0.0)?;
        }
        let steps = libm::round((stop - self.time()) / size);
        ensure!(
            size > 0.0 && size.is_finite() && steps.is_finite(),
            "the run is to {stop:?} s by {size:?} s; expected finite numbers, the second positive"
        );
        let mut rows = vec![self.outputs()];
        for _ in 0..steps as usize {
            self.step(size)?;
            rows.push(self.outputs());
        }
        Ok(rows)
    }

    /// The current time (s).
    pub fn time(&self) -> f64 {
        self.origin + self.count * self.size
    }

    /// Sets a variable by its structured or flat name, as a host does by its name in the FMU. Numbers of any type stand for others.
    ///
    /// # Errors
    /// There is no such variable, it cannot be set now, or not to this value.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) -> Result<(), ModelError> {
        let (reference, scalar) = self.variable_named(name)?;
        let of_type = scalar.variable.start.of_type().accessed_as(EDGE.version);
        let value = value.into();
        let given = |_| match (value.as_real(), value.as_whole()) {
            (Some(value), _) => HostValue::Real(value),
            (None, Some(value)) if of_type.is_float() => HostValue::Real(value as f64),
            (None, Some(value)) => HostValue::Whole(value),
            (None, None) if value.of_type() == of_type => HostValue::Other(Ok(value.clone())),
            (None, None) => HostValue::Other(Err(value.to_string())),
        };
        let set = |instance: &mut Instance| instance.set_of_type(of_type, &[reference], 1, &given);
        let status = self.hosted.instance.call(&EDGE.set_float64, set);
        self.result(status)
    }

    /// The value of a variable with a structured or flat name; of an enumeration, the number of the item.
    ///
    /// # Errors
    /// There is no such variable, or its value cannot be computed.
    pub fn get(&mut self, name: &str) -> Result<Value, ModelError> {
        let (reference, scalar) = self.variable_named(name)?;
        let of_type = scalar.variable.start.of_type().accessed_as(EDGE.version);
        let mut found = Value::Boolean(false);
        let get = |instance: &mut Instance| {
            instance.get_of_type(of_type, &[reference], 1, &mut |_, value| found = value)
        };
        let status = self.hosted.instance.call(&EDGE.get_float64, get);
        self.result(status)?;
        Ok(found)
    }

    /// The outputs that are numbers, in the order of the fields: each element of an array, a Boolean as 0 or 1, and
    /// the number of an item.
    pub fn outputs(&mut self) -> Vec<f64> {
        let mut outputs = Vec::new();
        let model = &mut self.hosted.instance.model;
        for scalar in model.scalars() {
            let is_output =
                scalar.variable.causality == Causality::Output && model.is_element(&scalar);
            let value = is_output.then(|| model.get(&scalar));
            outputs.extend(value.and_then(|value| match value {
                Value::Boolean(value) => Some(f64::from(u8::from(value))),
                value => value.as_real().or(value.as_whole().map(|value| value as f64)),
            }));
        }
        outputs
    }

    /// The messages since the last call.
    pub fn messages(&mut self) -> Vec<Message> {
        self.log.take()
    }

    fn variable_named(&self, name: &str) -> Result<(u32, ScalarVariable), ModelError> {
        let all = self.hosted.instance.model.scalars().map(|s| (s.reference as u32, s));
        let flat = Naming::Flat.write(name.to_owned());
        let exact = all.clone().find(|(_, scalar)| scalar.name() == name);
        let found = exact.or_else(|| {
            let mut all = all.clone();
            all.find(|(_, scalar)| Naming::Flat.write(scalar.name()) == flat)
        });
        found.ok_or_else(|| {
            let names: Vec<String> = all.map(|(_, scalar)| scalar.name()).collect();
            let names = names.join(", ");
            ModelError::refuse(format_args!(
                "there is no variable {name:?}; expected one of {names}"
            ))
        })
    }

    /// The status of a call, with the message that the host would have got.
    fn result(&mut self, status: Status) -> Result<(), ModelError> {
        let is_broken =
            matches!(self.hosted.instance.shared.lifecycle.state, State::Error | State::Fatal);
        let severity = match status {
            Status::Ok => return Ok(()),
            Status::Discard => Severity::Discarded,
            Status::Error if !is_broken => Severity::Refused,
            _ => Severity::Broken,
        };
        let message = self.log.borrow_mut().pop();
        let text = message.map(|message| message.text).unwrap_or_default();
        Err(ModelError::new(text).with_severity(severity))
    }
}

impl<M: Drive> Deref for Driver<M> {
    type Target = M;

    fn deref(&self) -> &M {
        let model: &dyn Any = self.hosted.instance.model.behavior();
        model.downcast_ref().unwrap_or_else(|| unreachable!("the model of the driver"))
    }
}

impl<M: Drive> DerefMut for Driver<M> {
    fn deref_mut(&mut self) -> &mut M {
        let model: &mut dyn Any = self.hosted.instance.model.behavior_mut();
        model.downcast_mut().unwrap_or_else(|| unreachable!("the model of the driver"))
    }
}
