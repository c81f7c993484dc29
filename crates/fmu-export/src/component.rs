//! What FMI requires of every slave: the state machine, checks and the panic guard.

use std::any::Any;
use std::ffi::{CStr, CString};
use std::panic::{AssertUnwindSafe, catch_unwind};

use fmu_description::Variability;

use crate::lifecycle::{Lifecycle, Mode};
use crate::log::{Category, Log};
use crate::model::{Kind, ModelError, Start};
use crate::panics;
use crate::phase::{Call, Phase};
use crate::reason::{Reason, reason};
use crate::resources::Folder;
use crate::slave::{Numbers, Slave};
use crate::snapshot::Snapshot;
use crate::values::{self, Access, FmiType, Given, Jacobian, Moment};

/// The outcome of a call, numbered like `fmi2Status`, so that converting it is free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub(crate) enum Outcome {
    Ok = 0,
    Discard = 2,
    Error = 3,
    Fatal = 4,
}

/// Why a call failed.
pub(crate) enum Failure {
    /// The call was invalid and changed nothing.
    Refused(Reason),
    /// The step was not taken, and the model is unchanged.
    Discarded(Reason),
    /// The model cannot continue.
    Broken(Reason),
}

impl Failure {
    fn new(kind: Kind, reason: Reason) -> Self {
        match kind {
            Kind::Refused => Self::Refused(reason),
            Kind::Discarded => Self::Discarded(reason),
            Kind::Broken => Self::Broken(reason),
        }
    }

    /// The same failure of a call that cannot be discarded.
    fn refused(self) -> Self {
        match self {
            Self::Discarded(reason) => Self::Refused(reason),
            other => other,
        }
    }
}

impl From<ModelError> for Failure {
    fn from(error: ModelError) -> Self {
        let kind = error.kind();
        Self::new(kind, Reason::new(move || error.reason().to_owned()))
    }
}

impl From<Reason> for Failure {
    fn from(reason: Reason) -> Self {
        Self::Refused(reason)
    }
}

/// What an event has changed, and when the next one is due.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Update {
    /// Whether the values of states changed.
    pub(crate) states_changed: bool,
    /// The time of the next event, if it is known.
    pub(crate) next_event: Option<f64>,
}

/// A product with the Jacobian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Product {
    /// With a direction of the knowns.
    Directional,
    /// With a direction of the unknowns.
    Adjoint,
}

/// An instance of a model; `S` is its [`Slave`].
pub(crate) struct Component<S: ?Sized = dyn Slave> {
    log: Log,
    resources: Folder,
    /// The texts that the last call returned, which live until the next one.
    pub(crate) texts: Vec<CString>,
    /// The binary values that the last call returned, which live until the next one.
    binaries: Vec<Vec<u8>>,
    pub(crate) lifecycle: Lifecycle,
    pub(crate) slave: S,
}

impl<S> Component<S> {
    pub(crate) fn new(mode: Mode, log: Log, resources: Folder, slave: S) -> Self {
        Self {
            log,
            resources,
            texts: Vec::new(),
            binaries: Vec::new(),
            lifecycle: Lifecycle::new(mode),
            slave,
        }
    }
}

impl Component {
    /// Runs `work` if the call is allowed in the current state, and logs failures.
    pub(crate) fn call(
        &mut self,
        call: &Call,
        work: impl FnOnce(&mut Self) -> Result<(), Failure>,
    ) -> Outcome {
        let mut work = Some(work);
        self.guard(call, &mut |c| work.take().map_or(Ok(()), |work| work(c)))
    }

    /// The code of [`call`](Self::call) that all calls share.
    #[inline(never)]
    fn guard(
        &mut self,
        call: &Call,
        work: &mut dyn FnMut(&mut Self) -> Result<(), Failure>,
    ) -> Outcome {
        if let Some(why) = call.wrong_mode(self.lifecycle.mode) {
            return self.refuse(call.name, why);
        }
        if !call.is_allowed(self.lifecycle.phase) {
            return self.refuse_in_phase(call);
        }
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(Ok(())) => Outcome::Ok,
            Ok(Err(failure)) => self.fail(call.name, failure),
            Err(panic) => self.fail_by_panic(call.name, panic),
        }
    }

    /// Logs why a call failed and returns [`Outcome::Error`].
    pub(crate) fn refuse(&self, name: &str, reason: impl Into<Reason>) -> Outcome {
        self.log.send(Category::Error, || {
            format!("{name}: {}", reason.into().text())
        });
        Outcome::Error
    }

    #[cold]
    fn refuse_in_phase(&self, call: &Call) -> Outcome {
        self.log.send(Category::Error, || {
            format!(
                "{} is not allowed in the state \"{}\"; it is allowed in: {}",
                call.name,
                self.lifecycle.phase.name(),
                call.allowed_names()
            )
        });
        match self.lifecycle.phase {
            Phase::Fatal => Outcome::Fatal,
            _ => Outcome::Error,
        }
    }

    /// Logs why a step failed, and enters the state that follows.
    #[cold]
    #[inline(never)]
    pub(crate) fn fail_step(
        &mut self,
        call: &Call,
        error: ModelError,
        time: f64,
        step: f64,
    ) -> Outcome {
        let kind = error.kind();
        let reason = reason!("from t = {time:?} s by {step:?} s: {}", error.reason());
        self.fail(call.name, Failure::new(kind, reason))
    }

    #[cold]
    #[inline(never)]
    fn fail(&mut self, name: &str, failure: Failure) -> Outcome {
        match failure {
            Failure::Refused(reason) => self.refuse(name, reason),
            Failure::Discarded(reason) => {
                // In other states, the host may repeat the call with other values.
                if self.lifecycle.phase == Phase::StepComplete {
                    self.enter(Phase::StepFailed);
                }
                self.log
                    .send(Category::Discard, || format!("{name}: {}", reason.text()));
                Outcome::Discard
            }
            Failure::Broken(reason) => {
                self.enter(Phase::Error);
                self.refuse(name, reason)
            }
        }
    }

    #[cold]
    #[inline(never)]
    pub(crate) fn fail_by_panic(&mut self, name: &str, panic: Box<dyn Any + Send>) -> Outcome {
        self.lifecycle.phase = Phase::Fatal;
        let text = panic
            .downcast_ref::<&str>()
            .copied()
            .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
            .unwrap_or("no message");
        let place = panics::take_place();
        self.log.send(Category::Fatal, || {
            format!("{name}: {place}the model panicked and is dead: {text}")
        });
        Outcome::Fatal
    }

    pub(crate) fn enter(&mut self, phase: Phase) {
        self.lifecycle.phase = phase;
        self.log
            .send(Category::Events, || format!("state: {}", phase.name()));
    }

    pub(crate) fn set_debug_logging(
        &mut self,
        call: &Call,
        on: bool,
        categories: &[&CStr],
    ) -> Outcome {
        self.call(call, |c| Ok(c.log.switch(on, categories)?))
    }

    pub(crate) fn setup_experiment(
        &mut self,
        call: &Call,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Outcome {
        self.call(call, |c| c.set_experiment(start, stop, tolerance))
    }

    /// Sets the times of the experiment, and the relative tolerance.
    pub(crate) fn set_experiment(
        &mut self,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Result<(), Failure> {
        if !start.is_finite() {
            return Err(reason!("the start time is {start}; expected a finite number").into());
        }
        if let Some(stop) = stop
            && !(stop.is_finite() && stop >= start)
        {
            return Err(reason!(
                "the stop time is {stop}; expected a finite number, at least the start time {start}"
            )
            .into());
        }
        self.lifecycle.start_time = start;
        self.lifecycle.stop_time = stop.unwrap_or(f64::MAX);
        self.lifecycle.tolerance = tolerance;
        self.lifecycle.stale = true;
        Ok(())
    }

    pub(crate) fn enter_initialization_mode(&mut self, call: &Call) -> Outcome {
        self.call(call, |c| {
            c.enter(Phase::Initialization);
            Ok(())
        })
    }

    pub(crate) fn exit_initialization_mode(&mut self, call: &Call) -> Outcome {
        self.call(call, |c| {
            c.refresh()?;
            match c.lifecycle.mode {
                Mode::CoSimulation => c.enter(Phase::StepComplete),
                Mode::CoSimulationWithEvents | Mode::ModelExchange => {
                    c.lifecycle.time = c.lifecycle.start_time;
                    c.enter(Phase::Event);
                }
            }
            Ok(())
        })
    }

    /// Enters a state in which the call leaves the instance.
    pub(crate) fn change_to(&mut self, call: &Call, phase: Phase) -> Outcome {
        self.call(call, |c| {
            c.enter(phase);
            Ok(())
        })
    }

    /// Enters step mode with the outputs of event mode.
    pub(crate) fn enter_step_mode(&mut self, call: &Call) -> Outcome {
        self.call(call, |c| {
            c.update().map_err(Failure::refused)?;
            c.enter(Phase::StepComplete);
            Ok(())
        })
    }

    pub(crate) fn reset(&mut self, call: &Call) -> Outcome {
        self.call(call, |c| {
            c.slave.reset();
            c.lifecycle = Lifecycle::new(c.lifecycle.mode);
            c.enter(Phase::Instantiated);
            Ok(())
        })
    }

    /// Checks a step. Returns the outcome of the call if no step is to be taken.
    #[cold]
    #[inline(never)]
    pub(crate) fn refuse_step(&mut self, call: &Call, time: f64, step: f64) -> Option<Outcome> {
        let mut due = false;
        let outcome = self.call(call, |c| {
            c.lifecycle.check_step(call.name, time, step, &c.log)?;
            due = step != 0.0; // some hosts iterate events with steps of 0
            Ok(())
        });
        (!due).then_some(outcome)
    }

    /// Reads the values with the given references.
    pub(crate) fn get<T: FmiType>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &mut [T],
    ) -> Outcome {
        self.call(call, |c| {
            c.read_updated(references, |c| {
                values::get(&mut c.slave, references, values)
            })
        })
    }

    /// Reads Strings to [`texts`](Self::texts); `T` is the type of the FMI version.
    pub(crate) fn get_texts<T: FmiType + Into<String> + Default + Clone>(
        &mut self,
        call: &Call,
        references: &[u32],
    ) -> Outcome {
        let mut values = vec![T::default(); references.len()];
        let outcome = self.get(call, references, &mut values);
        // C strings end at a zero byte.
        let texts = values
            .into_iter()
            .map(|text| text.into().replace('\0', " "));
        self.texts = texts.filter_map(|text| CString::new(text).ok()).collect();
        outcome
    }

    /// Writes all values or none.
    pub(crate) fn set<'a, T: Into<Given<'a>> + Copy>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &[T],
    ) -> Outcome {
        self.call(call, |c| {
            let Lifecycle { phase, mode, .. } = c.lifecycle;
            values::set(&mut c.slave, references, values, Moment::of(phase, mode))?;
            c.lifecycle.stale |= phase != Phase::StepComplete;
            Ok(())
        })
    }

    /// Reads variables of FMI 3.0 with all their elements. In an intermediate update, they are among the
    /// `intermediate` ones.
    pub(crate) fn get_arrays<T: FmiType>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &mut [T],
        intermediate: &[u32],
    ) -> Outcome {
        self.call(call, |c| {
            c.check_intermediate(references, intermediate)?;
            let elements = values::elements(&mut c.slave, references, values.len())?;
            c.read_updated(references, |c| {
                let now = c.lifecycle.now();
                values::get_elements(&mut c.slave, now, &elements, values)
            })
        })
    }

    /// Writes all elements of variables of FMI 3.0, or none.
    pub(crate) fn set_arrays<'a, T: Into<Given<'a>> + Copy>(
        &mut self,
        call: &Call,
        references: &[u32],
        values: &[T],
        intermediate: &[u32],
    ) -> Outcome {
        self.call(call, |c| {
            c.check_intermediate(references, intermediate)?;
            if references.iter().any(|&r| r as usize == c.slave.count()) {
                return Err(Failure::Refused(
                    "time is the independent variable, which the host does not set".into(),
                ));
            }
            let elements = values::elements(&mut c.slave, references, values.len())?;
            let Lifecycle { phase, mode, .. } = c.lifecycle;
            values::set(&mut c.slave, &elements, values, Moment::of(phase, mode))?;
            let is_held = matches!(phase, Phase::StepComplete | Phase::IntermediateUpdate);
            c.lifecycle.stale |= !is_held;
            Ok(())
        })
    }

    /// Checks that a host accesses the variables that it has announced.
    fn check_intermediate(&self, references: &[u32], announced: &[u32]) -> Result<(), Reason> {
        let is_announced = |reference: &u32| announced.contains(reference);
        if self.lifecycle.phase != Phase::IntermediateUpdate || references.iter().all(is_announced)
        {
            return Ok(());
        }
        Err(
            "in an intermediate update, only the required intermediate variables can be accessed"
                .into(),
        )
    }

    /// Keeps texts until the next call.
    pub(crate) fn keep_texts(&mut self, texts: Vec<String>) -> &[CString] {
        // C strings end at a zero byte.
        let texts = texts.into_iter().map(|text| text.replace('\0', " "));
        self.texts = texts.filter_map(|text| CString::new(text).ok()).collect();
        &self.texts
    }

    /// Keeps bytes until the next call.
    pub(crate) fn keep_binaries(&mut self, binaries: Vec<Vec<u8>>) -> &[Vec<u8>] {
        self.binaries = binaries;
        &self.binaries
    }

    /// Sets the first time derivatives of inputs for the next step, all or none.
    pub(crate) fn set_input_derivatives(
        &mut self,
        call: &Call,
        references: &[u32],
        orders: &[i32],
        values: &[f64],
    ) -> Outcome {
        self.call(call, |c| {
            let slave = &mut c.slave;
            values::set_input_derivatives(slave, references, orders, values)?;
            c.lifecycle.has_input_derivatives |= !references.is_empty();
            Ok(())
        })
    }

    /// Computes directional derivatives.
    pub(crate) fn directional_derivative(
        &mut self,
        call: &Call,
        access: Access,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivative: &mut [f64],
    ) -> Outcome {
        self.call(call, |c| {
            let variables = (unknowns, knowns);
            c.multiply(
                Product::Directional,
                access,
                variables,
                direction,
                derivative,
            )
        })
    }

    /// Computes directional or adjoint derivatives of variables of FMI 3.0 with all their elements.
    pub(crate) fn derivative_product(
        &mut self,
        call: &Call,
        product: Product,
        (unknowns, knowns): (&[u32], &[u32]),
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Outcome {
        self.call(call, |c| {
            let (n_unknowns, n_knowns) = match product {
                Product::Directional => (sensitivity.len(), seed.len()),
                Product::Adjoint => (seed.len(), sensitivity.len()),
            };
            let unknowns = values::elements(&mut c.slave, unknowns, n_unknowns)?;
            let knowns = values::elements(&mut c.slave, knowns, n_knowns)?;
            let access = <f64 as FmiType>::ACCESS;
            c.multiply(product, access, (&unknowns, &knowns), seed, sensitivity)
        })
    }

    /// Multiplies the Jacobian of some scalars.
    fn multiply(
        &mut self,
        product: Product,
        access: Access,
        (unknowns, knowns): (&[u32], &[u32]),
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<(), Failure> {
        let mode = self.lifecycle.mode;
        if mode == Mode::ModelExchange {
            self.update()?;
        }
        let mut jacobian = Jacobian::new(&mut self.slave, mode, access, unknowns, knowns)?;
        match product {
            Product::Directional => jacobian.times(seed, sensitivity)?,
            Product::Adjoint => jacobian.adjoint(seed, sensitivity)?,
        }
        Ok(())
    }

    /// Takes a part of a step. With events, samples are not taken here, and time events not handled.
    pub(crate) fn take_part(
        &mut self,
        call: &Call,
        time: f64,
        step: f64,
        has_events: bool,
    ) -> Outcome {
        self.call(call, |c| {
            let holds = has_events && c.slave.is_sampled();
            if step > 0.0 && !holds {
                c.slave.step(time, step, !has_events).map_err(|error| {
                    let kind = error.kind();
                    let reason = reason!("from t = {time:?} s by {step:?} s: {}", error.reason());
                    Failure::new(kind, reason)
                })?;
            }
            c.lifecycle.time = time + step;
            Ok(())
        })
    }

    /// The time of the next event after `time` in a step, if there is one.
    pub(crate) fn next_event(&mut self, call: &Call, time: f64) -> Result<Option<f64>, Outcome> {
        let mut event = None;
        let outcome = self.call(call, |c| {
            if c.lifecycle.mode == Mode::CoSimulationWithEvents {
                event = c.slave.next_event(time);
            }
            Ok(())
        });
        match outcome {
            Outcome::Ok => Ok(event),
            other => Err(other),
        }
    }

    /// The outcome of a step of which a part was not taken, though others were: what the model refuses
    /// is discarded, as the instance is no longer where the step began.
    pub(crate) fn fail_part(&mut self, outcome: Outcome) -> Outcome {
        if outcome == Outcome::Error && self.lifecycle.phase == Phase::StepComplete {
            self.enter(Phase::StepFailed);
            return Outcome::Discard;
        }
        outcome
    }

    /// Handles an event within a step.
    pub(crate) fn handle_event(&mut self, call: &Call, time: f64) -> Outcome {
        self.call(call, |c| {
            c.slave.event(time)?;
            Ok(())
        })
    }

    /// Enters configuration or reconfiguration mode.
    pub(crate) fn enter_configuration_mode(&mut self, call: &Call) -> Outcome {
        self.call(call, |c| {
            let (next, needed) = match c.lifecycle.phase {
                Phase::Instantiated => (Phase::Configuration, Variability::Fixed),
                Phase::Event => (Phase::EventReconfiguration, Variability::Tunable),
                _ => (Phase::StepReconfiguration, Variability::Tunable),
            };
            if !c.slave.has_structural_parameter(needed) {
                return Err(match needed {
                    Variability::Fixed => {
                        Failure::Refused("the model has no structural parameters".into())
                    }
                    _ => Failure::Refused("the model has no tunable structural parameters".into()),
                });
            }
            c.enter(next);
            Ok(())
        })
    }

    /// Returns from configuration or reconfiguration mode.
    pub(crate) fn exit_configuration_mode(&mut self, call: &Call) -> Outcome {
        self.call(call, |c| {
            let next = match c.lifecycle.phase {
                Phase::StepReconfiguration => Phase::StepComplete,
                Phase::EventReconfiguration => Phase::Event,
                _ => Phase::Instantiated,
            };
            if next != Phase::Instantiated {
                c.slave.reconfigure()?;
            }
            c.enter(next);
            Ok(())
        })
    }

    /// Sets the time of model exchange.
    pub(crate) fn set_time(&mut self, call: &Call, time: f64) -> Outcome {
        self.call(call, |c| {
            if !time.is_finite() {
                return Err(reason!("the time is {time:?}; expected a finite number").into());
            }
            c.lifecycle.stale |= time != c.lifecycle.time;
            c.lifecycle.time = time;
            Ok(())
        })
    }

    /// Sets the states.
    pub(crate) fn set_states(&mut self, call: &Call, states: &[f64]) -> Outcome {
        self.call(call, |c| {
            c.check_length(Numbers::States, states.len())?;
            if let Some(&value) = states.iter().find(|value| !value.is_finite()) {
                return Err(reason!("a state is {value}; expected finite numbers").into());
            }
            c.slave.set_states(states);
            c.lifecycle.stale = true;
            Ok(())
        })
    }

    /// Reads states, derivatives, nominal values or event indicators.
    pub(crate) fn read(&mut self, call: &Call, which: Numbers, values: &mut [f64]) -> Outcome {
        self.call(call, |c| {
            c.check_length(which, values.len())?;
            if which != Numbers::Nominals {
                c.update()?;
            }
            c.slave.read(which, values);
            Ok(())
        })
    }

    fn check_length(&self, of: Numbers, found: usize) -> Result<(), Failure> {
        let expected = self.slave.length(of);
        let what = match of {
            Numbers::EventIndicators => "event indicators",
            _ => "continuous states",
        };
        match found == expected {
            true => Ok(()),
            false => Err(reason!(
                "the array has {found} elements; expected {expected}, the number of {what}"
            )
            .into()),
        }
    }

    /// Handles the event in event mode.
    pub(crate) fn update_discrete_states(&mut self, call: &Call) -> Result<Update, Outcome> {
        let mut update = Update::default();
        let outcome = self.call(call, |c| {
            let time = c.event_time();
            update.states_changed = c.slave.event(time).map_err(Failure::from)?;
            update.next_event = c.slave.next_event(time);
            c.lifecycle.stale = true;
            Ok(())
        });
        match outcome {
            Outcome::Ok => Ok(update),
            other => Err(other),
        }
    }

    /// The time of the event to handle: the current time, or that of a time event which the end of a step
    /// has reached but for rounding errors.
    fn event_time(&self) -> f64 {
        let now = self.lifecycle.time;
        let tolerance = 1e-6 * self.slave.default_step() + 8.0 * f64::EPSILON * now.abs();
        match self.lifecycle.mode {
            Mode::CoSimulationWithEvents if !self.slave.is_sampled() => self
                .slave
                .next_event(now)
                .filter(|event| *event <= now + tolerance)
                .unwrap_or(now),
            _ => now,
        }
    }

    /// Time derivatives of outputs that are states, of first order.
    pub(crate) fn output_derivatives(
        &mut self,
        call: &Call,
        references: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> Outcome {
        self.call(call, |c| {
            c.read_output_derivatives(references, orders, values)
        })
    }

    /// As [`output_derivatives`](Self::output_derivatives) of variables of FMI 3.0 with all their
    /// elements; in an intermediate update, of the `intermediate` ones.
    pub(crate) fn output_array_derivatives(
        &mut self,
        call: &Call,
        references: &[u32],
        orders: &[i32],
        values: &mut [f64],
        intermediate: &[u32],
    ) -> Outcome {
        self.call(call, |c| {
            c.check_intermediate(references, intermediate)?;
            let elements = values::elements(&mut c.slave, references, values.len())?;
            let mut of_elements = Vec::with_capacity(elements.len());
            for (&reference, &order) in references.iter().zip(orders) {
                let count = c.slave.elements(reference).unwrap_or(1);
                of_elements.extend(std::iter::repeat_n(order, count));
            }
            c.read_output_derivatives(&elements, &of_elements, values)
        })
    }

    fn read_output_derivatives(
        &mut self,
        references: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> Result<(), Failure> {
        let derivatives = values::output_derivatives(&mut self.slave, references, orders)?;
        self.read_evaluated(|c| values::get(&mut c.slave, &derivatives, values))
    }

    /// The complete state of the instance.
    pub(crate) fn snapshot(&self) -> Snapshot {
        Snapshot::new(self.lifecycle, &self.slave)
    }

    /// Restores a snapshot of this or another instance of the model.
    pub(crate) fn restore(&mut self, snapshot: &Snapshot) -> Result<(), Reason> {
        let (found, expected) = (snapshot.mode(), self.lifecycle.mode);
        if found != expected {
            return Err(reason!(
                "the state is that of an instance for {}; expected one for {}",
                found.name(),
                expected.name()
            ));
        }
        self.lifecycle = snapshot.restore(&mut self.slave)?;
        Ok(())
    }

    pub(crate) fn slave(&self) -> &dyn Slave {
        &self.slave
    }

    /// Reads the variables with the given references when they are up to date. Between steps, derivatives
    /// and event indicators are not.
    fn read_updated(
        &mut self,
        references: &[u32],
        read: impl FnOnce(&mut Self) -> Result<(), Reason>,
    ) -> Result<(), Failure> {
        let is_stepped = self.lifecycle.mode != Mode::ModelExchange
            && matches!(
                self.lifecycle.phase,
                Phase::StepComplete
                    | Phase::StepFailed
                    | Phase::IntermediateUpdate
                    | Phase::Terminated
            );
        if is_stepped
            && self.slave.is_continuous()
            && values::has_derivatives(&mut self.slave, references)
        {
            return self.read_evaluated(read);
        }
        self.update()?;
        Ok(read(self)?)
    }

    /// Evaluates the equations between steps and reads values. It changes nothing, as outputs are those of
    /// the last step, and discards nothing, as only steps are discarded.
    fn read_evaluated(
        &mut self,
        read: impl FnOnce(&mut Self) -> Result<(), Reason>,
    ) -> Result<(), Failure> {
        let saved = self.slave.save();
        let evaluated = self.slave.evaluate(self.lifecycle.now());
        let outcome = match evaluated {
            Ok(()) => read(self).map_err(Failure::from),
            Err(error) => Err(Failure::from(error).refused()),
        };
        self.slave.restore(saved.as_ref());
        outcome
    }

    /// Computes what a host may read and is not up to date, before the end of the initialization, in event
    /// mode and in model exchange.
    fn update(&mut self) -> Result<(), Failure> {
        let is_exchange = self.lifecycle.mode == Mode::ModelExchange;
        match self.lifecycle.phase {
            _ if !self.lifecycle.stale => Ok(()),
            Phase::Initialization => self.refresh(),
            Phase::Event | Phase::ContinuousTime => self.evaluate(),
            Phase::Terminated if is_exchange => self.evaluate(),
            _ => Ok(()),
        }
    }

    fn evaluate(&mut self) -> Result<(), Failure> {
        self.slave.evaluate(self.lifecycle.now())?;
        self.lifecycle.stale = false;
        Ok(())
    }

    /// Computes the outputs from the start values and inputs.
    fn refresh(&mut self) -> Result<(), Failure> {
        let start = Start {
            time: self.lifecycle.start_time,
            is_model_exchange: self.lifecycle.mode == Mode::ModelExchange,
            handles_events: self.lifecycle.mode == Mode::CoSimulation,
            tolerance: self.lifecycle.tolerance,
            resources: self.resources.clone(),
        };
        self.slave
            .initialize(&start)
            .map_err(|error: ModelError| Reason::new(move || error.reason().to_owned()))?;
        self.lifecycle.stale = false;
        Ok(())
    }
}
