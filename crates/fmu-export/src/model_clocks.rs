//! The clocks of a model, which are fields of its struct: what acts at their ticks, when, and which intervals the host
//! learns (FMI 3.0.2, sections 2.2.9, 2.3.5 and 5.2).
//!
//! Whether a clock is active and what is known of its interval is in the field itself, and saved with the model.
//!
//! In event mode, the host sets clocks and values in any order. The instant is evaluated when the host first asks for a
//! result. If the host sets something afterwards, the model returns to what it was before the evaluation, so that the
//! next one is of the new values.

use std::ops::{Deref, DerefMut};

use fmi_abi::fmi3::fmi3Clock;
use fmi_abi::state::State;
use fmu_description::derive::{ClockType, Timing};
use fmu_description::scalar::variable_named;
use fmu_description::table::have_clocks;
use fmu_description::{
    Causality, Clock, IntervalVariability, Number, ScalarVariable, StateError, StateReader,
    StateWriter,
};

use crate::any_model::AnyModel;
use crate::error::{ModelError, Severity, ensure, refused};
use crate::instance::{Clocks, EventUpdate, Instance, Interval, PresentInstant};
use crate::lifecycle::{InstanceType, IntegrationState};
use crate::model::Model;
use crate::saved::Saved;
use crate::values::unknown;

/// The clocks of a model that has fields of the type [`Clock`].
pub(crate) struct ModelClocks;

/// The clocks of a model, if it has such fields.
pub(crate) const fn of<M: Model>() -> Option<&'static dyn Clocks> {
    match have_clocks(M::ROWS) {
        true => Some(&ModelClocks),
        false => None,
    }
}

/// The present instant of super-dense time.
#[derive(Default)]
pub(crate) struct Instant {
    /// The clocks of the model, once a function has needed them.
    clocks: Vec<ScalarVariable>,
    /// Their values before the model has acted.
    previous: Vec<Clock>,
    stage: Stage,
    /// The model and its integration before the evaluation. The memory is used again.
    before: Option<(Box<dyn AnyModel>, IntegrationState)>,
    /// When each model partition was last activated (s), in scheduled execution.
    activated: Vec<f64>,
    /// Whether the model has acted with news for the host: an output has ticked, or a countdown has begun.
    has_news: bool,
}

/// What has happened in an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
enum Stage {
    /// The host may still set clocks and values.
    #[default]
    Begun,
    Evaluated {
        states_changed: bool,
    },
    /// The discrete states are updated, and nothing was set since.
    Ended,
}

impl Instant {
    /// What is saved of it.
    fn copy(&self) -> Self {
        let is_evaluated = matches!(self.stage, Stage::Evaluated { .. });
        let before = self.before.as_ref().filter(|_| is_evaluated);
        Self {
            stage: self.stage,
            before: before.map(|(model, integration)| (model.copy(), *integration)),
            activated: self.activated.clone(),
            ..Self::default()
        }
    }

    /// Becomes a copy of another one.
    fn assign(&mut self, from: &Self) {
        let copy = from.copy();
        self.stage = copy.stage;
        self.before = copy.before.or(self.before.take());
        self.activated = copy.activated;
    }
}

impl Deref for PresentInstant {
    type Target = Instant;

    fn deref(&self) -> &Instant {
        const BEGUN: &Instant = &Instant {
            clocks: Vec::new(),
            previous: Vec::new(),
            stage: Stage::Begun,
            before: None,
            activated: Vec::new(),
            has_news: false,
        };
        self.0.as_ref().and_then(|instant| instant.downcast_ref()).unwrap_or(BEGUN)
    }
}

impl DerefMut for PresentInstant {
    fn deref_mut(&mut self) -> &mut Instant {
        let instant = self.0.get_or_insert_with(|| Box::new(Instant::default()));
        instant.downcast_mut().unwrap_or_else(|| unreachable!("an instant"))
    }
}

impl From<Instant> for PresentInstant {
    fn from(instant: Instant) -> Self {
        Self(Some(Box::new(instant)))
    }
}

/// A clock in the memory of its model.
fn clock_of<'a>(model: &'a mut dyn AnyModel, scalar: &ScalarVariable) -> &'a mut Clock {
    // SAFETY: `Variables` promises a clock at the place of a row of this type.
    unsafe { &mut *model.memory().byte_add(scalar.absolute_offset()).cast() }
}

/// The type of a clock.
fn type_of(scalar: &ScalarVariable) -> ClockType {
    scalar.variable.start.clock().copied().unwrap_or_default()
}

fn is_input(scalar: &ScalarVariable) -> bool {
    scalar.variable.causality == Causality::Input
}

/// A message that begins with a clock.
macro_rules! of_clock {
    ($severity:ident, $scalar:expr, $($reason:tt)*) => {
        Err(ModelError::$severity(format_args!("clock {}: {}", $scalar.name(), format_args!($($reason)*))))
    };
}

/// Checks an interval (s) of a clock, which may be 0 for a clock that ticks again in the next instant.
fn check_interval(scalar: &ScalarVariable, interval: f64) -> Result<(), ModelError> {
    let is_periodic = type_of(scalar).interval_variability.is_periodic();
    let (is_valid, expected) = match is_periodic {
        true => (interval > 0.0, "a positive number"),
        false => (interval >= 0.0, "a number of at least 0"),
    };
    if is_valid && interval.is_finite() {
        return Ok(());
    }
    of_clock!(refuse, scalar, "the interval is {} s; expected {expected}", Number(interval))
}

fn check_shift(scalar: &ScalarVariable, shift: f64) -> Result<(), ModelError> {
    if shift >= 0.0 && shift.is_finite() {
        return Ok(());
    }
    of_clock!(refuse, scalar, "the shift is {} s; expected a number of at least 0", Number(shift))
}

/// Looking up.
impl ModelClocks {
    /// The model, and its clocks.
    fn parts(instance: &mut Instance) -> (&mut dyn AnyModel, &[ScalarVariable]) {
        let Instance { shared, model } = instance;
        let clocks = &mut shared.instant.clocks;
        if clocks.is_empty() {
            clocks.extend(model.scalars().filter(|scalar| scalar.variable.start.clock().is_some()));
        }
        (model, clocks)
    }

    /// The clock with a value reference.
    fn find(instance: &mut Instance, reference: u32) -> Result<ScalarVariable, ModelError> {
        let (model, clocks) = Self::parts(instance);
        let found = clocks.iter().find(|scalar| scalar.reference == reference as usize);
        found.copied().ok_or_else(|| match model.scalar_at(reference) {
            Some(scalar) => ModelError::refuse(format_args!(
                "{} is of type {}, not Clock",
                scalar.name(),
                scalar.variable.start.of_type().as_str()
            )),
            None => unknown(model.info().end, reference),
        })
    }

    /// Whether an input clock is active.
    fn has_ticks(instance: &mut Instance) -> bool {
        let (model, clocks) = Self::parts(instance);
        let mut inputs = clocks.iter().filter(|scalar| is_input(scalar));
        inputs.any(|scalar| clock_of(model, scalar).is_active())
    }

    /// Makes clocks inactive.
    fn deactivate(instance: &mut Instance, which: fn(&ScalarVariable) -> bool) {
        let (model, clocks) = Self::parts(instance);
        for scalar in clocks.iter().filter(|scalar| which(scalar)) {
            clock_of(model, scalar).set_active(false);
        }
    }

    /// The clocks of a clocked variable.
    fn of_variable(
        model: &mut dyn AnyModel,
        scalar: &ScalarVariable,
    ) -> impl Iterator<Item = ScalarVariable> + use<> {
        let (rows, scalar) = (model.info().rows, *scalar);
        let clocks = scalar.variable.clocks.iter();
        let named = clocks.filter_map(move |name| variable_named(rows, &scalar, name));
        named.map(move |mut clock| {
            clock.naming = scalar.naming;
            clock
        })
    }
}

/// The evaluation of an instant in event mode.
impl ModelClocks {
    /// Evaluates the instant, if something ticks or happens that has not been evaluated.
    fn evaluate(instance: &mut Instance) -> Result<(), ModelError> {
        let is_begun = instance.shared.instant.stage == Stage::Begun;
        if instance.shared.lifecycle.state != State::Event || !is_begun {
            return Ok(());
        }
        match instance.model.info().is_continuous || Self::has_ticks(instance) {
            true => Self::act(instance),
            false => Ok(()),
        }
    }

    /// Has the model act at the present instant.
    fn act(instance: &mut Instance) -> Result<(), ModelError> {
        let Instance { shared, model } = instance;
        let integration = shared.lifecycle.integration;
        match &mut shared.instant.before {
            Some(before) => {
                before.0.assign(model);
                before.1 = integration;
            }
            none => *none = Some((model.copy(), integration)),
        }
        let now = shared.lifecycle.now();
        match Self::act_once(instance, now) {
            Ok(states_changed) => {
                instance.shared.instant.stage = Stage::Evaluated { states_changed };
                Ok(())
            }
            Err(error) => {
                if error.severity() != Severity::Broken {
                    Self::take_back(instance);
                }
                Err(error)
            }
        }
    }

    /// Lets input clocks tick in a test, at a time (s).
    pub(crate) fn tick(
        instance: &mut Instance,
        references: &[u32],
        time: f64,
    ) -> Result<(), ModelError> {
        for &reference in references {
            let scalar = Self::find(instance, reference)?;
            if !is_input(&scalar) {
                return of_clock!(
                    refuse,
                    scalar,
                    "it is an output, which only the model activates"
                );
            }
        }
        ensure!(!references.is_empty(), "no clock ticks; expected the name of an input clock");
        Self::deactivate(instance, |_| true);
        for &reference in references {
            let scalar = Self::find(instance, reference)?;
            clock_of(&mut instance.model, &scalar).set_active(true);
        }
        instance.shared.lifecycle.time = time;
        let acted = Self::act(instance);
        Self::deactivate(instance, is_input);
        instance.shared.instant.stage = Stage::Begun;
        acted
    }

    /// Returns to the model before the evaluation.
    fn take_back(instance: &mut Instance) {
        let Instance { shared, model } = instance;
        if let Some((before, integration)) = &shared.instant.before {
            model.assign(before.as_ref());
            shared.lifecycle.integration = *integration;
        }
        shared.instant.stage = Stage::Begun;
    }

    /// Prepares a change of clocks or values in event mode.
    fn begin_change(instance: &mut Instance) -> Result<(), ModelError> {
        match instance.shared.instant.stage {
            Stage::Begun => {}
            Stage::Ended => instance.shared.instant.stage = Stage::Begun,
            Stage::Evaluated { .. } => match instance.model.info().why_unsaved {
                Some(why) => {
                    return refused!(
                        "the model has {why} that cannot be saved, so that a tick cannot be repeated; expected \
                         clocks and values to be set before results are asked for"
                    );
                }
                None => Self::take_back(instance),
            },
        }
        Ok(())
    }

    /// Has the model act at the ticks of active clocks, or at an event. Returns whether states changed.
    fn act_once(instance: &mut Instance, time: f64) -> Result<bool, ModelError> {
        let Instance { shared, model } = &mut *instance;
        let Instant { clocks, previous, .. } = &mut *shared.instant;
        previous.clear();
        for scalar in &*clocks {
            let clock = clock_of(model, scalar);
            previous.push(*clock);
            // What is new afterwards is from the model.
            if is_aperiodic(scalar) {
                clock.set_interval(clock.interval(), false);
            } else if !is_input(scalar) {
                clock.set_active(false);
            }
        }
        let states_changed = match model.info().is_continuous {
            true => instance.take_events()?,
            false => {
                model.behavior_mut().on_clocks(time)?;
                model.check_outputs()?;
                false
            }
        };
        let Instance { shared, model } = instance;
        let Instant { clocks, previous, has_news, .. } = &mut *shared.instant;
        *has_news = false;
        for (scalar, previous) in clocks.iter().zip(previous) {
            let clock = clock_of(model, scalar);
            settle(scalar, clock, previous)?;
            *has_news |= is_news(scalar, clock);
            keep_unasked(scalar, clock, previous);
        }
        Ok(states_changed)
    }
}

/// Whether `clockUpdate` reports what the model has assigned to a clock.
fn is_news(scalar: &ScalarVariable, clock: &Clock) -> bool {
    match is_input(scalar) {
        true => {
            let variability = type_of(scalar).interval_variability;
            variability == IntervalVariability::Countdown && clock.is_new()
        }
        false => clock.is_active(),
    }
}

/// Keeps what a clock had before, if the host has not asked for it and it still holds.
fn keep_unasked(scalar: &ScalarVariable, clock: &mut Clock, previous: &Clock) {
    if !is_input(scalar) {
        clock.set_active(clock.is_active() || previous.is_active());
    } else if previous.is_new() && !previous.is_active() && clock.interval() == previous.interval()
    {
        clock.set_interval(clock.interval(), true);
    }
}

/// Whether the model says when the clock ticks next.
fn is_aperiodic(scalar: &ScalarVariable) -> bool {
    use IntervalVariability::{Changing, Countdown};
    is_input(scalar) && matches!(type_of(scalar).interval_variability, Changing | Countdown)
}

/// Settles what the model has assigned to a clock, by its value before.
fn settle(scalar: &ScalarVariable, clock: &mut Clock, previous: &Clock) -> Result<(), ModelError> {
    if !is_input(scalar) {
        return match clock.is_new() {
            true => of_clock!(
                new,
                scalar,
                "the model has assigned an interval to an output; expected `Clock::TICK`"
            ),
            false => Ok(()),
        };
    }
    if !is_aperiodic(scalar) {
        return match clock == previous {
            true => Ok(()),
            false => of_clock!(
                new,
                scalar,
                "the model has assigned a value to it; only inputs of kind changing or countdown take one, an interval"
            ),
        };
    }
    if clock.is_active() && !previous.is_active() {
        return of_clock!(
            new,
            scalar,
            "the model has activated it, but an input ticks when the host says so; expected `Clock::after`"
        );
    }
    clock.set_active(previous.is_active());
    if clock.is_new() {
        let interval = clock.interval().unwrap_or(f64::NAN);
        return check_interval(scalar, interval)
            .map_err(|error| error.with_severity(Severity::Broken));
    }
    if previous.is_active() {
        // A changing clock ticks at the same interval again, a countdown clock when the model says so.
        let is_changing = type_of(scalar).interval_variability == IntervalVariability::Changing;
        clock.set_interval(clock.interval().filter(|_| is_changing), is_changing);
    }
    Ok(())
}

/// Intervals.
impl ModelClocks {
    /// The interval and the shift that the model calculates for a clock.
    fn timing(
        model: &mut dyn AnyModel,
        scalar: &ScalarVariable,
    ) -> Result<Option<Timing>, ModelError> {
        let Some(timing) = model.clock_timing(scalar.number as u32) else { return Ok(None) };
        check_interval(scalar, timing.interval)?;
        check_shift(scalar, timing.shift)?;
        Ok(Some(timing))
    }

    /// Takes the interval that the model calculates for a clock, if it is new.
    fn take_timing(model: &mut dyn AnyModel, scalar: &ScalarVariable) -> Result<(), ModelError> {
        if let Some(Timing { interval, .. }) = Self::timing(model, scalar)? {
            let clock = clock_of(model, scalar);
            if clock.interval() != Some(interval) {
                clock.set_interval(Some(interval), true);
            }
        }
        Ok(())
    }

    /// A clock whose interval and shift the host may set now.
    fn settable(instance: &mut Instance, reference: u32) -> Result<ScalarVariable, ModelError> {
        use IntervalVariability::{Fixed, Tunable};
        let scalar = Self::find(instance, reference)?;
        let of_type = type_of(&scalar);
        let is_initial = instance.shared.lifecycle.state == State::Initialization;
        match (of_type.interval_variability, of_type.interval) {
            (Fixed, Some(_)) if !is_initial => {
                of_clock!(
                    refuse,
                    scalar,
                    "it is fixed, so that its interval is set in initialization mode"
                )
            }
            (Fixed | Tunable, Some(_)) => Ok(scalar),
            (variability, _) => of_clock!(
                refuse,
                scalar,
                "it is {}, so that the host does not set when it ticks",
                variability.as_str()
            ),
        }
    }
}

impl Clocks for ModelClocks {
    fn activate(
        &self,
        instance: &mut Instance,
        reference: u32,
        time: f64,
    ) -> Result<(), ModelError> {
        let scalar = Self::find(instance, reference)?;
        if !is_input(&scalar) {
            return of_clock!(refuse, scalar, "it is an output, which has no model partition");
        }
        let (_, clocks) = Self::parts(instance);
        let number = clocks.iter().position(|clock| clock.reference == scalar.reference);
        let number = number.unwrap_or_default();
        let last = instance.shared.instant.activated[number];
        if time <= last {
            return of_clock!(
                refuse,
                scalar,
                "its model partition is activated at {} s; expected a time after the last one, {} s",
                Number(time),
                Number(last)
            );
        }
        let (model, clocks) = Self::parts(instance);
        for scalar in clocks.iter().filter(|scalar| is_input(scalar)) {
            clock_of(model, scalar).set_active(scalar.reference == reference as usize);
        }
        let acted = Self::act_once(instance, time);
        if acted.as_ref().is_err_and(|error| error.severity() != Severity::Broken) {
            let Instance { shared, model } = &mut *instance;
            let Instant { clocks, previous, .. } = &*shared.instant;
            for (scalar, previous) in clocks.iter().zip(previous) {
                *clock_of(model, scalar) = *previous;
            }
        }
        Self::deactivate(instance, is_input);
        acted.map_err(|error| error.with_prefix(format_args!("at t = {:?} s", Number(time))))?;
        let shared = &mut instance.shared;
        shared.instant.activated[number] = time;
        shared.lifecycle.time = shared.lifecycle.time.max(time);
        Ok(())
    }

    fn interval(&self, instance: &mut Instance, reference: u32) -> Result<Interval, ModelError> {
        use IntervalVariability::{Calculated, Changing, Constant, Tunable};
        let scalar = Self::find(instance, reference)?;
        let of_type = type_of(&scalar);
        if !of_type.interval_variability.is_time_based() {
            return of_clock!(refuse, scalar, "it is triggered, and has no interval");
        }
        let is_initial = instance.shared.lifecycle.state == State::Initialization;
        match is_initial {
            true => instance.bring_up_to_date()?,
            false => Self::evaluate(instance)?,
        }
        let model = &mut instance.model;
        if of_type.interval_variability == Tunable {
            Self::take_timing(model, &scalar)?;
        }
        let clock = clock_of(model, &scalar);
        let known = of_type.interval.filter(|_| of_type.interval_variability == Constant);
        let Some(interval) = clock.interval().or(known) else {
            return match of_type.interval_variability {
                Changing => of_clock!(
                    refuse,
                    scalar,
                    "the model has assigned no interval; expected `Clock::after` in `initialize`"
                ),
                _ => Ok(Interval::NotYetKnown),
            };
        };
        let is_new = clock.is_new();
        clock.set_interval(clock.interval(), false);
        // A calculated interval cannot change after the initialization.
        let is_fixed = of_type.interval_variability == Calculated && !is_initial;
        Ok(match is_new && !is_fixed {
            true => Interval::Changed(interval),
            false => Interval::Unchanged(interval),
        })
    }

    fn shift(&self, instance: &mut Instance, reference: u32) -> Result<f64, ModelError> {
        let scalar = Self::find(instance, reference)?;
        let of_type = type_of(&scalar);
        if !of_type.interval_variability.is_periodic() {
            let kind = of_type.interval_variability.as_str();
            return of_clock!(refuse, scalar, "it is {kind}, and has no shift");
        }
        instance.bring_up_to_date()?;
        let model = &mut instance.model;
        let timing = Self::timing(model, &scalar)?;
        let set = clock_of(model, &scalar).shift();
        Ok(timing.map(|timing| timing.shift).or(set).unwrap_or(of_type.shift))
    }

    fn fraction(
        &self,
        instance: &mut Instance,
        reference: u32,
        time: f64,
    ) -> Result<(u64, u64), ModelError> {
        let scalar = Self::find(instance, reference)?;
        let of_type = type_of(&scalar);
        match of_type.resolution.filter(|_| of_type.supports_fraction) {
            Some(resolution) => Ok((of_type.counter(time).unwrap_or_default(), resolution)),
            None => of_clock!(
                refuse,
                scalar,
                "supportsFraction is false; expected a function for decimals"
            ),
        }
    }

    fn set_interval(
        &self,
        instance: &mut Instance,
        reference: u32,
        interval: f64,
    ) -> Result<(), ModelError> {
        let scalar = Self::settable(instance, reference)?;
        check_interval(&scalar, interval)?;
        if instance.shared.lifecycle.state == State::Event {
            Self::begin_change(instance)?;
        }
        clock_of(&mut instance.model, &scalar).set_interval(Some(interval), false);
        instance.shared.lifecycle.stale = true;
        Ok(())
    }

    fn set_shift(
        &self,
        instance: &mut Instance,
        reference: u32,
        shift: f64,
    ) -> Result<(), ModelError> {
        let scalar = Self::settable(instance, reference)?;
        check_shift(&scalar, shift)?;
        clock_of(&mut instance.model, &scalar).set_shift(shift);
        instance.shared.lifecycle.stale = true;
        Ok(())
    }

    fn get(
        &self,
        instance: &mut Instance,
        references: &[u32],
        values: &mut [fmi3Clock],
    ) -> Result<(), ModelError> {
        for &reference in references {
            Self::find(instance, reference)?;
        }
        Self::evaluate(instance)?;
        // In scheduled execution, a tick is reported once.
        let is_reported =
            instance.shared.lifecycle.instance_type == InstanceType::ScheduledExecution;
        for (&reference, value) in references.iter().zip(values) {
            let scalar = Self::find(instance, reference)?;
            let clock = clock_of(&mut instance.model, &scalar);
            *value = clock.is_active().into();
            if is_reported {
                clock.set_active(false);
            }
        }
        Ok(())
    }

    fn set(
        &self,
        instance: &mut Instance,
        references: &[u32],
        values: &[fmi3Clock],
    ) -> Result<(), ModelError> {
        let mut is_changed = false;
        for (&reference, &value) in references.iter().zip(values) {
            let scalar = Self::find(instance, reference)?;
            if !is_input(&scalar) {
                return of_clock!(
                    refuse,
                    scalar,
                    "it is an output, which only the model activates"
                );
            }
            if value > 1 {
                return of_clock!(
                    refuse,
                    scalar,
                    "the value is {value}; expected 0 (inactive) or 1 (active)"
                );
            }
            let is_active = clock_of(&mut instance.model, &scalar).is_active();
            is_changed |= is_active != (value == 1);
        }
        if !is_changed {
            return Ok(());
        }
        Self::begin_change(instance)?;
        for (&reference, &value) in references.iter().zip(values) {
            let scalar = Self::find(instance, reference)?;
            clock_of(&mut instance.model, &scalar).set_active(value == 1);
        }
        Ok(())
    }

    fn evaluate(&self, instance: &mut Instance) -> Result<(), ModelError> {
        Self::evaluate(instance)
    }

    fn update(&self, instance: &mut Instance) -> Result<EventUpdate, ModelError> {
        let is_evaluated =
            |instance: &Instance| matches!(instance.shared.instant.stage, Stage::Evaluated { .. });
        let is_continuous = instance.model.info().is_continuous;
        if !is_evaluated(instance) && (is_continuous || Self::has_ticks(instance)) {
            Self::act(instance)?;
        }
        let states_changed =
            instance.shared.instant.stage == Stage::Evaluated { states_changed: true };
        Self::deactivate(instance, |_| true);
        instance.shared.instant.stage = Stage::Ended;
        Ok(EventUpdate { states_changed, next_event: instance.next_event() })
    }

    fn check_ended(&self, instance: &mut Instance) -> Result<(), ModelError> {
        let (model, clocks) = Self::parts(instance);
        let active = clocks.iter().find(|scalar| clock_of(model, scalar).is_active());
        match active {
            Some(scalar) => of_clock!(
                refuse,
                scalar,
                "it is active; expected fmi3UpdateDiscreteStates before event mode is left"
            ),
            None => Ok(()),
        }
    }

    fn before_get(&self, instance: &mut Instance, references: &[u32]) -> Result<(), ModelError> {
        if instance.shared.lifecycle.state != State::Event {
            return Ok(());
        }
        let is_continuous = instance.model.info().is_continuous;
        let is_result = |reference: &u32| {
            instance.model.scalar_at(*reference).is_some_and(|scalar| match is_continuous {
                true => !scalar.variable.clocks.is_empty(),
                false => matches!(scalar.variable.causality, Causality::Output | Causality::Local),
            })
        };
        match references.iter().any(is_result) {
            true => Self::evaluate(instance),
            false => Ok(()),
        }
    }

    fn before_set(&self, instance: &mut Instance, references: &[u32]) -> Result<(), ModelError> {
        let Instance { shared, model } = &mut *instance;
        let (state, instance_type) = (shared.lifecycle.state, shared.lifecycle.instance_type);
        for &reference in references {
            let scalar = model.scalar_at(reference);
            let Some(scalar) = scalar.filter(|scalar| !scalar.variable.clocks.is_empty()) else {
                continue; // an unknown reference is refused afterwards
            };
            let mut clocks = Self::of_variable(model, &scalar);
            let why = match state {
                State::Event if !clocks.any(|clock| clock_of(model, &clock).is_active()) => {
                    "none of its clocks is active"
                }
                // Without event mode, a test drives the model.
                State::StepMode if instance_type == InstanceType::CoSimulation => continue,
                State::StepMode | State::ContinuousTime | State::IntermediateUpdate => {
                    "it is set in event mode, when one of its clocks is active"
                }
                _ => continue,
            };
            let clocks = Self::of_variable(model, &scalar).map(|clock| clock.name());
            let clocks = Vec::from_iter(clocks).join(", ");
            return refused!("{} is a clocked variable: {why} ({clocks})", scalar.name());
        }
        match state {
            State::Event | State::EventReconfiguration => Self::begin_change(instance),
            _ => Ok(()),
        }
    }

    fn prepare(&self, instance: &mut Instance) {
        let (model, clocks) = Self::parts(instance);
        for scalar in clocks {
            let of_type = type_of(scalar);
            let clock = clock_of(model, scalar);
            match of_type.interval_variability.is_periodic() {
                true if clock.interval().is_none() => {
                    let is_set_by_host =
                        of_type.interval_variability != IntervalVariability::Constant;
                    clock.set_interval(of_type.interval.filter(|_| is_set_by_host), false);
                }
                true => {}
                false => *clock = Clock::default(),
            }
        }
    }

    fn initialize(&self, instance: &mut Instance) -> Result<(), ModelError> {
        let (model, clocks) = Self::parts(instance);
        for scalar in clocks {
            Self::take_timing(model, scalar)?;
            let clock = clock_of(model, scalar);
            if type_of(scalar).interval_variability.is_periodic() {
                continue;
            }
            settle(scalar, clock, &Clock::default())?;
            let is_changing = type_of(scalar).interval_variability == IntervalVariability::Changing;
            if is_changing && clock.interval().is_none() {
                return of_clock!(
                    refuse,
                    scalar,
                    "the model has assigned no interval; expected `Clock::after` in `initialize`"
                );
            }
            if clock.is_active() {
                return of_clock!(
                    refuse,
                    scalar,
                    "the model has activated it in `initialize`; expected ticks later"
                );
            }
        }
        let count = clocks.len();
        // So that a tick allocates nothing.
        let Instance { shared, model } = instance;
        shared.instant.before.get_or_insert_with(|| (model.copy(), IntegrationState::NONE));
        shared.instant.previous.reserve(count);
        shared.instant.activated = vec![f64::NEG_INFINITY; count];
        Ok(())
    }

    fn has_update(&self, instance: &mut Instance) -> bool {
        instance.shared.instant.has_news
    }

    fn begin(&self, instance: &mut Instance) {
        instance.shared.instant.stage = Stage::Begun;
    }

    fn copy(&self, instant: &PresentInstant) -> PresentInstant {
        Instant::copy(instant).into()
    }

    fn assign(&self, to: &mut PresentInstant, from: &PresentInstant) {
        Instant::assign(to, from);
    }

    fn save(&self, instant: &PresentInstant, to: &mut StateWriter) -> Result<(), StateError> {
        let (stage, states_changed): (u8, bool) = match instant.stage {
            Stage::Begun => (0, false),
            Stage::Ended => (1, false),
            Stage::Evaluated { states_changed } => (2, states_changed),
        };
        to.put(&(stage, states_changed))?;
        to.put(&instant.activated)?;
        match (&instant.before, instant.stage) {
            (Some((before, integration)), Stage::Evaluated { .. }) => {
                before.save(to)?;
                integration.save(to)
            }
            _ => Ok(()),
        }
    }

    fn load(
        &self,
        model: &dyn AnyModel,
        from: &mut StateReader<'_>,
    ) -> Result<PresentInstant, StateError> {
        let (stage, states_changed): (u8, bool) = from.take()?;
        let activated = from.take()?;
        let stage = match stage {
            0 => Stage::Begun,
            1 => Stage::Ended,
            2 => Stage::Evaluated { states_changed },
            _ => return Err(StateError),
        };
        let before = match stage {
            Stage::Evaluated { .. } => {
                let mut before = model.copy();
                before.load(from)?;
                Some((before, IntegrationState::load(from)?))
            }
            _ => None,
        };
        Ok(Instant { stage, before, activated, ..Instant::default() }.into())
    }
}
