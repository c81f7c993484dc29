//! What an author implements.

use std::any::Any;
#[cfg(not(target_arch = "wasm32"))]
use std::fs;
use std::path::{Component, Path, PathBuf};

use fmu_description::references::FixedReference;
use fmu_description::{Naming, OwnCategory, Variables};

use crate::error::ModelError;
use crate::layout::set_start_values;
use crate::log::Log;
use crate::resources::Folder;
use crate::single_instance::SingleInstance;

/// A model: a struct with variables, a name and a description, implemented by `#[derive(Model)]`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a model",
    label = "expected a struct with #[derive(Model)]"
)]
pub trait Model: Variables + Behavior {
    /// Name of the model, of the FMU and of its binary: a C identifier.
    const NAME: &'static str;
    /// Description of the model in one sentence.
    const DESCRIPTION: &'static str;
    /// The value references that its author has fixed.
    #[doc(hidden)]
    const REFERENCES: &'static [FixedReference] = &[];
    /// Whether it has a sample time, or several.
    const IS_SAMPLED: bool;
    /// The names of its rates; none if it has no sample time, or one.
    const RATES: &'static [&'static str] = &[];
    /// Whether it is [`Continuous`].
    const IS_CONTINUOUS: bool = false;
    /// Whether it is [`Clocked`].
    const IS_CLOCKED: bool = false;
    /// Whether it simulates a bus, for the manifest of FMI-LS-BUS.
    const IS_BUS_SIMULATION: bool = false;
    /// Whether its equations are integrated in co-simulation: it has no step of its own.
    const IS_INTEGRATED: bool = false;
    /// Whether they are integrated by the implicit method.
    const IS_IMPLICIT: bool = false;
    /// Whether a process can have one instance only.
    const IS_SINGLE_INSTANCE: bool = false;
    /// Whether it has a [`Log`] without a category of its own.
    const HAS_LOG: bool = false;
    /// How the names of its variables are written, if the model says so.
    const NAMING: Option<Naming> = None;
    /// The categories of its other logs.
    const LOG_CATEGORIES: &'static [OwnCategory] = &[];
    /// Stop time and communication step size (s) of the default experiment.
    const DEFAULT_EXPERIMENT: (f64, f64);
    /// Relative tolerance of its integrator; 0 if it has none.
    const TOLERANCE: f64 = 0.0;

    /// The model with its start values.
    #[inline(never)] // inlined, it would be repeated in every caller
    fn new() -> Self {
        let mut model = Self::unset();
        // SAFETY: the rows belong to the model.
        unsafe { set_start_values((&raw mut model).cast(), Self::ROWS) };
        model
    }
}

/// What a model does, whether its author implements [`Simulate`], [`MultiRate`], [`Clocked`] or [`Continuous`]; implemented by
/// `#[derive(Model)]`. Functions that the model does not have do nothing.
#[doc(hidden)]
#[allow(unused_variables, reason = "the names document the arguments")]
pub trait Behavior: Any {
    /// The sample time (s); 0 if it has none, or several.
    fn sample_time(&self) -> f64;

    /// The names and the sample times (s) of its rates.
    fn rates(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Takes the sample of a rate at an instant `time`; `step` is its sample time.
    fn on_tick(&mut self, rate: usize, time: f64, step: f64) -> Result<(), ModelError> {
        Ok(())
    }

    /// Acts at the ticks of all clocks that are active at `time`.
    fn on_clocks(&mut self, time: f64) -> Result<(), ModelError> {
        Ok(())
    }

    fn on_initialize(&mut self, start: &Start) -> Result<(), ModelError>;

    fn on_reconfigure(&mut self) -> Result<(), ModelError>;

    /// Not called if the model is integrated, has several rates, or is clocked.
    fn on_step(&mut self, time: f64, step: f64) -> Result<(), ModelError>;

    fn on_evaluate(&mut self, time: f64) -> Result<(), ModelError> {
        Ok(())
    }

    fn on_event(&mut self, time: f64) -> Result<(), ModelError> {
        Ok(())
    }

    fn on_next_event(&self, time: f64) -> Option<f64> {
        None
    }

    /// A log by its index, and the index of its category, if it has one of its own.
    fn log(&mut self, index: usize) -> Option<(&mut Log, Option<usize>)> {
        None
    }

    /// The place of the only instance that a process can have; `None` if it can have several.
    fn single_instance() -> Option<&'static SingleInstance>
    where
        Self: Sized,
    {
        None
    }
}

/// A model without `#[model(clocked)]` and `#[model(continuous)]`, implemented by `#[derive(Model)]`.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` cannot implement `Simulate`",
    label = "expected a struct with #[derive(Model)], and without `clocked` and `continuous`",
    note = "with `#[model(clocked)]`, write `impl Clocked` instead, with `#[model(continuous)]`, `impl Continuous`; a function that takes steps better than the integrator is named by `#[model(continuous, step = Self::step)]`"
)]
pub trait Stepped: Model {}

/// What a model does, implemented by its author; of a model with equations, [`Continuous`] is instead.
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not say what it does",
    note = "write `impl Simulate` for it, with a function `step`"
)]
#[allow(unused_variables, reason = "the names document the arguments")]
pub trait Simulate: Stepped {
    /// Computes the outputs at the start time from the start values of parameters and inputs. All other
    /// fields have their default values. If the host changes a value afterwards, it is called again,
    /// on a fresh copy.
    ///
    /// # Errors
    /// The parameters are inconsistent, or a resource cannot be read.
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        Ok(())
    }

    /// Called after structural parameters have changed while the simulation runs. Of an array with the
    /// option `size`, elements in use may be more or fewer than before; those that join have the values
    /// that they last had.
    ///
    /// # Errors
    /// The model cannot continue with these sizes.
    fn reconfigure(&mut self) -> Result<(), ModelError> {
        Ok(())
    }

    /// Advances from `time` to `time + step` (s) with constant inputs. `step` is positive.
    ///
    /// A model with a sample time is called once for every sample instant `time`, and `step` is the
    /// sample time; its outputs hold until the next instant.
    ///
    /// The outputs need not be checked: NaN and infinity are reported as an error.
    ///
    /// # Errors
    /// The step cannot be computed. The instance can then only be restored, reset or freed, unless
    /// the error leaves the model unchanged: [`ModelError::refuse`] or [`ModelError::discard`].
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError>;
}

/// A model with `#[model(rates(...))]`, implemented by `#[derive(Model)]`.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` has no rates",
    label = "expected a struct with #[derive(Model)] and `rates`",
    note = "name them and their sample times: `#[model(rates(slow = 0.1, fast = 0.001))]`"
)]
pub trait Rated: Model {}

/// How a model with several sample times starts, instead of [`Simulate`].
///
/// `#[model(rates(slow = 0.1, fast = 0.001))]` calls a method of the model for each rate, `fn slow(&mut self, time:
/// f64, step: f64) -> Result<(), ModelError>`, at its instants `time` = start time + k `step`, where `step` is its
/// sample time; the outputs hold in between. The instants are taken in the order of time, whatever the communication
/// steps, and at the same time in the order in which the rates are declared.
///
/// ```
/// use fmu_export::prelude::*;
///
/// /// Cascade of a slow and a fast controller
/// #[derive(Model)]
/// #[model(rates(slow = 0.1, fast = self.ts))]
/// pub struct Cascade {
///     /// set-point
///     #[input]
///     r: f64,
///     /// force
///     #[output]
///     u: f64,
///     /// sample time of the fast controller
///     #[parameter(start = 0.001, min = 1e-6, unit = "s")]
///     ts: f64,
///     inner_set_point: f64,
/// }
///
/// impl Cascade {
///     fn slow(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
///         self.inner_set_point = 0.5 * self.r;
///         Ok(())
///     }
///
///     fn fast(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
///         self.u += 10.0 * step * (self.inner_set_point - self.u);
///         Ok(())
///     }
/// }
///
/// impl MultiRate for Cascade {}
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not say how it starts",
    note = "with `#[model(rates(...))]`, write `impl MultiRate` for it; it may be empty"
)]
#[allow(unused_variables, reason = "the names document the arguments")]
pub trait MultiRate: Rated {
    /// As [`Simulate::initialize`].
    ///
    /// # Errors
    /// The parameters are inconsistent, or a resource cannot be read.
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        Ok(())
    }

    /// As [`Simulate::reconfigure`].
    ///
    /// # Errors
    /// The model cannot continue with these sizes.
    fn reconfigure(&mut self) -> Result<(), ModelError> {
        Ok(())
    }
}

/// A model with `#[model(clocked)]`, implemented by `#[derive(Model)]`.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not clocked",
    label = "expected a struct with #[derive(Model)] and `clocked`",
    note = "write `#[model(clocked)]`, and a field of the type `Clock`"
)]
pub trait Ticked: Model {}

/// What a model does that acts only at the ticks of its clocks, instead of [`Simulate`].
///
/// Its clocks are fields of the type [`Clock`](crate::Clock), of the model and of its nested structs. Clocks, and the
/// variables that change at their ticks, exist in FMI 3.0 only.
///
/// ```
/// use fmu_export::prelude::*;
///
/// /// Controller that receives the angle as a message
/// #[derive(Model)]
/// #[model(clocked)]
/// pub struct Node {
///     /// ticks when an angle has arrived
///     #[input]
///     received: Clock,
///     /// measured angle
///     #[input(clocks(received), unit = "rad")]
///     angle: f64,
///     /// ticks every sample time
///     #[input(calculated, interval = self.ts)]
///     sample: Clock,
///     /// ticks when the force is to be sent
///     #[output]
///     sent: Clock,
///     /// force
///     #[output(clocks(sent), unit = "N")]
///     force: f64,
///     /// sample time
///     #[parameter(start = 0.001, min = 1e-6, unit = "s")]
///     ts: f64,
///     last: f64,
/// }
///
/// impl Clocked for Node {
///     fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
///         if self.received.is_active() {
///             self.last = self.angle;
///         }
///         if self.sample.is_active() {
///             self.force = -300.0 * self.last;
///             self.sent = Clock::TICK;
///         }
///         Ok(())
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not say what it does at ticks",
    note = "with `#[model(clocked)]`, write `impl Clocked` for it, with a function `tick`"
)]
#[allow(unused_variables, reason = "the names document the arguments")]
pub trait Clocked: Ticked {
    /// As [`Simulate::initialize`]. It assigns [`Clock::after`](crate::Clock::after) to clocks of kind `changing`, and may
    /// to those of kind `countdown`; no clock is active.
    ///
    /// # Errors
    /// The parameters are inconsistent, or a resource cannot be read.
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        Ok(())
    }

    /// As [`Simulate::reconfigure`].
    ///
    /// # Errors
    /// The model cannot continue with these sizes.
    fn reconfigure(&mut self) -> Result<(), ModelError> {
        Ok(())
    }

    /// Acts at the ticks of all input clocks that are active at `time` (s), and assigns
    /// [`Clock::TICK`](crate::Clock::TICK) to the output clocks that tick then, too. It is called once for an instant,
    /// and may be called again at the same time, for ticks that follow from those of its outputs. In scheduled
    /// execution, one input clock is active, whose model partition the host activates.
    ///
    /// Afterwards, all clocks are inactive. Variables keep their values.
    ///
    /// # Errors
    /// As those of [`Simulate::step`].
    fn tick(&mut self, time: f64) -> Result<(), ModelError>;
}

/// The equations of a model with `#[model(continuous)]`: what it does, instead of [`Simulate`].
///
/// Its states are the variables with the option `state`, their derivatives the fields with
/// `#[derivative(of = ...)]`. In model exchange, the host integrates the states. In co-simulation, the
/// layer does, by an explicit or implicit method of order 5 with error control, which finds events within a step and
/// keeps inputs constant; or the function in `#[model(continuous, step = Self::step)]`, which also handles
/// the events within a step, and at its beginning those that inputs cause.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is continuous but has no equations",
    note = "write `impl Continuous` for it, with a function `evaluate`"
)]
#[allow(unused_variables, reason = "the names document the arguments")]
pub trait Continuous: Model {
    /// As [`Simulate::initialize`]: computes states and outputs at the start time. Afterwards,
    /// [`evaluate`](Self::evaluate) is called.
    ///
    /// # Errors
    /// The parameters are inconsistent, or a resource cannot be read.
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        Ok(())
    }

    /// As [`Simulate::reconfigure`].
    ///
    /// # Errors
    /// The model cannot continue with these sizes.
    fn reconfigure(&mut self) -> Result<(), ModelError> {
        Ok(())
    }

    /// Computes derivatives, event indicators and outputs at `time` (s) from states, inputs and
    /// parameters.
    ///
    /// # Errors
    /// They cannot be computed. Other states may be tried if the error is a
    /// [`discard`](ModelError::discard), or if a result is NaN or infinite.
    fn evaluate(&mut self, time: f64) -> Result<(), ModelError>;

    /// Handles an event at `time` (s): the start, a [`next_event`](Self::next_event), a sign change of an event
    /// indicator, a new value of a discrete input or a tunable parameter, or ticks of its clocks, which are then active.
    /// It may change states, and assign [`Clock::TICK`](crate::Clock::TICK) to output clocks.
    ///
    /// [`evaluate`](Self::evaluate) was called for this time and these inputs before; it may have failed.
    ///
    /// # Errors
    /// The event cannot be handled.
    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        Ok(())
    }

    /// The time of the first event after `time` that is known in advance (s).
    fn next_event(&self, time: f64) -> Option<f64> {
        None
    }
}

/// The start of a simulation.
#[derive(Debug, Clone)]
pub struct Start {
    /// The start time (s).
    pub time: f64,
    /// Whether the host integrates the states: model exchange.
    pub is_model_exchange: bool,
    pub(crate) resources: Folder,
}

impl Start {
    /// A start at `time` (s) with the folder of the resources, for tests.
    pub fn new(time: f64, resources: impl Into<PathBuf>) -> Self {
        Self { time, is_model_exchange: false, resources: Folder::Known(Ok(resources.into())) }
    }

    /// The path of a file in the FMU's `resources`, which `cargo fmu export` packs from the folder of
    /// this name in the package.
    ///
    /// # Errors
    /// The host did not say where the resources are, or the path leaves them.
    pub fn resource(&self, file: impl AsRef<Path>) -> Result<PathBuf, ModelError> {
        let file = name_of_resource(file.as_ref())?;
        match self.resources.path() {
            Ok(folder) => Ok(folder.join(file)),
            Err(error) => Err(ModelError::new(format_args!(
                "the resource {} cannot be found: {error}",
                file.display()
            ))),
        }
    }

    /// Reads a text file in the FMU's `resources`, also in a WebAssembly component, where they are no folder.
    ///
    /// # Errors
    /// It cannot be read, or is not UTF-8.
    pub fn read_resource(&self, file: impl AsRef<Path>) -> Result<String, ModelError> {
        #[cfg(not(target_arch = "wasm32"))]
        let (path, text) = {
            let path = self.resource(file)?;
            let text = fs::read_to_string(&path);
            (path, text)
        };
        #[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
        let (path, text) = {
            let path = name_of_resource(file.as_ref())?;
            (path, crate::resources::read_resource(path))
        };
        #[cfg(all(target_arch = "wasm32", feature = "sources"))]
        let (path, text) = {
            let path = name_of_resource(file.as_ref())?;
            (path, crate::resources::read_resource(&self.resources, path))
        };
        text.map_err(|error| {
            ModelError::new(format_args!("cannot read the resource {}: {error}", path.display()))
        })
    }
}

/// Checks that a file is in the folder of the resources.
fn name_of_resource(file: &Path) -> Result<&Path, ModelError> {
    let mut parts = file.components();
    let stays = parts.all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    match stays && !file.as_os_str().is_empty() {
        true => Ok(file),
        false => Err(ModelError::new(format_args!(
            "{file:?} is not a resource; expected the name of a file in the FMU's resources"
        ))),
    }
}
