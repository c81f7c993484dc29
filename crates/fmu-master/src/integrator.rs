//! Model exchange: the master integrates the equations of a component over each communication step, and
//! handles its events.
//!
//! Inputs keep their values during a step, unless they come from a table. A component with an input that is not
//! continuous enters event mode at each communication point, where such inputs may be set. An event at the end of a
//! step waits for the inputs of that communication point, if they come from other components.

use fmu_description::{FmiVersion, Value, Variability};
use fmu_host::Instance;
use ode_methods::solver::{
    self, Advanced, DormandPrince, Events, OdeSystem, Rodas5p, Step, Workspace,
};
use serde::{Deserialize, Serialize};

use crate::fmu::{Fmu, JacobianStructure};
use crate::recorded_instance::{IntegrationError, IntegrationResult, Operation, RecordedInstance};
use crate::solver::Solver;
use crate::store::Store;
use crate::table_inputs::TableInputs;
use crate::wiring::VariableGroup;

/// Maximum number of times that discrete states are updated in one event.
const MAX_UPDATES: u32 = 1000;
/// The relative tolerance, unless it is known.
const TOLERANCE: f64 = 1e-6;

/// A component of model exchange between two steps.
#[derive(Clone)]
pub(crate) struct Integrator<'a> {
    workspace: Workspace,
    solver: Solver,
    /// The value references of states and derivatives, if the FMU provides directional derivatives.
    directional: Option<[Vec<u32>; 2]>,
    tolerance: f64,
    /// The longest internal step of a component with event indicators (s).
    longest: f64,
    nominals: Vec<f64>,
    derivatives: Vec<f64>,
    indicators: Vec<f64>,
    inputs: Option<TableInputs<'a>>,
    /// Whether an input comes from another component, and whether one is not continuous.
    is_fed: bool,
    is_discrete: bool,
    is_in_event_mode: bool,
    /// The next time event, the time until which events are handled, and the time from which they are left to
    /// the next step (s).
    next: Option<f64>,
    handled: f64,
    left: f64,
    /// Whether the last event has left an event indicator close to zero, and nothing was integrated since.
    restarts: bool,
    /// What is recorded at the ends of internal steps, if anything is.
    internal: Option<InternalRecord<'a>>,
}

/// The outputs of a component at the ends of the internal steps between two communication points.
#[derive(Clone)]
struct InternalRecord<'a> {
    groups: &'a [VariableGroup],
    /// The store of the system, with the outputs that were read last.
    outputs: Store,
    /// The next communication point (s).
    end: f64,
    points: Vec<(f64, Store)>,
}

impl InternalRecord<'_> {
    /// Gets the outputs at the end of an internal step, unless it is a communication point.
    fn record(&mut self, recorded: &mut RecordedInstance, time: f64) -> IntegrationResult {
        if time >= self.end {
            return Ok(());
        }
        for VariableGroup { access_type, get, outputs, first_output, .. } in self.groups {
            if outputs.references.is_empty() {
                continue;
            }
            let mut values = vec![Value::Boolean(false); outputs.elements];
            recorded.calls.begin(*get);
            let got = recorded.instance.get_values(*access_type, &outputs.references, &mut values);
            recorded.warn(got.map_err(|failure| IntegrationError::Call(failure, String::new()))?);
            for (index, position) in outputs.positions.iter().enumerate() {
                self.outputs.set(first_output.plus(index), values[*position].clone());
            }
        }
        self.points.push((time, self.outputs.clone()));
        Ok(())
    }
}

/// What an integrator keeps between steps, which is saved in files. The rest is computed again at the start of a step.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct IntegratorState {
    nominals: Vec<f64>,
    /// The values at the end of the step before.
    indicators: Vec<f64>,
    is_in_event_mode: bool,
    next: Option<f64>,
    handled: f64,
    restarts: bool,
}

impl<'a> Integrator<'a> {
    /// Begins after the initialization, in event mode.
    pub(crate) fn begin(
        recorded: &mut RecordedInstance,
        fmu: &Fmu,
        groups: &[VariableGroup],
        inputs: Option<TableInputs<'a>>,
        (solver, tolerance): (Solver, Option<f64>),
        (start, step): (f64, f64),
    ) -> IntegrationResult<Self> {
        let [states, indicators] = match fmu.version {
            FmiVersion::Fmi2 => fmu.equations,
            FmiVersion::Fmi3 => {
                let [mut states, mut indicators] = [0; 2];
                recorded.call_with_warning(Operation::NumberOfStates, |instance| {
                    instance.get_number_of_continuous_states(&mut states)
                })?;
                recorded.call_with_warning(Operation::NumberOfIndicators, |instance| {
                    instance.get_number_of_event_indicators(&mut indicators)
                })?;
                [states, indicators]
            }
        };
        let mut scalars = groups.iter().flat_map(|group| group.inputs.scalars.iter());
        let is_discrete =
            |scalar: &usize| fmu.variable(*scalar).variability != Variability::Continuous;
        let JacobianStructure { dependencies, .. } = &fmu.jacobian;
        let dependencies = dependencies.as_deref().filter(|rows| rows.len() == states);
        let is_directional = fmu.is_directional && !fmu.jacobian.states.is_empty();
        let references = || [fmu.jacobian.states.clone(), fmu.jacobian.derivatives.clone()];
        let mut integrator = Self {
            workspace: match solver {
                Solver::Explicit => Workspace::new(states, indicators),
                Solver::Implicit => Workspace::implicit(states, indicators, dependencies),
            },
            solver,
            directional: is_directional.then(references),
            tolerance: tolerance.unwrap_or(TOLERANCE),
            longest: fmu.step.unwrap_or(step).min(step),
            nominals: vec![1.0; states],
            derivatives: vec![0.0; states],
            indicators: vec![0.0; indicators],
            inputs,
            is_fed: groups.iter().any(|g| g.sources.iter().any(|s| s.component.is_some())),
            is_discrete: scalars.any(is_discrete),
            is_in_event_mode: true,
            next: None,
            handled: start,
            left: f64::INFINITY,
            restarts: false,
            internal: None,
        };
        integrator.update(recorded, start)?;
        integrator.read_nominals(recorded)?;
        integrator.inputs.iter_mut().for_each(|inputs| inputs.begin(start));
        ComponentEquations { recorded, integrator: &mut integrator }.evaluate_here(start)?;
        if integrator.is_discrete {
            integrator.enter_event_mode(recorded)?;
        }
        Ok(integrator)
    }

    /// Returns whether it was not in event mode before.
    pub(crate) fn enter_event_mode(
        &mut self,
        recorded: &mut RecordedInstance,
    ) -> IntegrationResult<bool> {
        let enters = !self.is_in_event_mode;
        if enters {
            recorded.call_with_warning(Operation::EventMode, Instance::enter_event_mode)?;
            self.is_in_event_mode = true;
        }
        Ok(enters)
    }

    /// Sets something in event mode, and handles the event.
    pub(crate) fn at_event(
        &mut self,
        recorded: &mut RecordedInstance,
        time: f64,
        set: impl FnOnce(&mut Instance) -> fmu_host::Result,
    ) -> IntegrationResult {
        self.enter_event_mode(recorded)?;
        recorded.call_with_warning(Operation::Update, set)?;
        self.leave_event_mode(recorded, time)
    }

    /// Handles the event of what was set in event mode, which may change discrete states.
    pub(crate) fn leave_event_mode(
        &mut self,
        recorded: &mut RecordedInstance,
        time: f64,
    ) -> IntegrationResult {
        self.update(recorded, time)?;
        ComponentEquations { recorded, integrator: self }.evaluate_here(time)
    }

    /// Handles an event in event mode.
    fn update(&mut self, recorded: &mut RecordedInstance, time: f64) -> IntegrationResult {
        let mut nominals_changed = false;
        for _ in 0..MAX_UPDATES {
            let operation = Operation::Update;
            let update = recorded.call(operation, Instance::update_discrete_states)?;
            if update.terminate {
                return Err(recorded.terminated(operation, time));
            }
            nominals_changed |= update.nominals_changed;
            if !update.again {
                let operation = Operation::ContinuousMode;
                recorded.call_with_warning(operation, Instance::enter_continuous_time_mode)?;
                self.is_in_event_mode = false;
                self.next = update.next_event;
                self.handled = time;
                return if nominals_changed { self.read_nominals(recorded) } else { Ok(()) };
            }
        }
        Err(solver::SolverError::discard(format_args!(
            "the event at t = {time:?} s needs more than {MAX_UPDATES} updates of discrete states"
        )))
    }

    fn read_nominals(&mut self, recorded: &mut RecordedInstance) -> IntegrationResult {
        let nominals = &mut self.nominals;
        if !nominals.is_empty() {
            recorded.call_with_warning(Operation::Nominals, |instance| {
                instance.get_nominals_of_continuous_states(nominals)
            })?;
        }
        let is_unusable = |nominal: &&mut f64| **nominal == 0.0 || !nominal.is_finite();
        nominals.iter_mut().filter(is_unusable).for_each(|nominal| *nominal = 1.0);
        Ok(())
    }

    /// Takes the state of the same component at another time, in the memory that it has.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        // The memory of a step keeps nothing, and the others are the same at all times.
        let Self {
            workspace: _,
            solver: _,
            directional: _,
            tolerance: _,
            longest: _,
            nominals,
            derivatives,
            indicators,
            inputs,
            is_fed: _,
            is_discrete: _,
            is_in_event_mode,
            next,
            handled,
            left,
            restarts,
            internal: _,
        } = other;
        self.nominals.clone_from(nominals);
        self.derivatives.clone_from(derivatives);
        self.indicators.clone_from(indicators);
        if let (Some(to), Some(from)) = (&mut self.inputs, inputs) {
            to.go_to(from);
        }
        self.is_in_event_mode = *is_in_event_mode;
        self.next = *next;
        self.handled = *handled;
        self.left = *left;
        self.restarts = *restarts;
    }

    /// Records the outputs of these groups at the ends of internal steps from now on, in stores like this one.
    pub(crate) fn record_internal_steps(&mut self, groups: &'a [VariableGroup], outputs: Store) {
        self.internal =
            Some(InternalRecord { groups, outputs, end: f64::INFINITY, points: Vec::new() });
    }

    /// The times (s) and outputs that were recorded since the last call.
    pub(crate) fn take_internal_steps(&mut self) -> Vec<(f64, Store)> {
        let internal = self.internal.as_mut();
        internal.map(|internal| std::mem::take(&mut internal.points)).unwrap_or_default()
    }

    /// What it keeps between steps.
    pub(crate) fn state(&self) -> IntegratorState {
        let Self { nominals, indicators, is_in_event_mode, next, handled, restarts, .. } = self;
        IntegratorState {
            nominals: nominals.clone(),
            indicators: indicators.clone(),
            is_in_event_mode: *is_in_event_mode,
            next: *next,
            handled: *handled,
            restarts: *restarts,
        }
    }

    /// Takes what an integrator of the same component has kept.
    pub(crate) fn set_state(&mut self, state: &IntegratorState) {
        let IntegratorState { nominals, indicators, is_in_event_mode, next, handled, restarts } =
            state;
        self.nominals.iter_mut().zip(nominals).for_each(|(to, from)| *to = *from);
        self.indicators.iter_mut().zip(indicators).for_each(|(to, from)| *to = *from);
        self.is_in_event_mode = *is_in_event_mode;
        self.next = *next;
        self.handled = *handled;
        self.restarts = *restarts;
    }

    /// The number of continuous states.
    pub(crate) fn states(&self) -> usize {
        self.nominals.len()
    }

    /// Integrates from one communication point to the next.
    pub(crate) fn step(
        &mut self,
        recorded: &mut RecordedInstance,
        time: f64,
        size: f64,
    ) -> IntegrationResult {
        let rounding = 1e-6 * size + 8.0 * f64::EPSILON * time.abs();
        let is_due = self.next.is_some_and(|next| next > self.handled && next <= time + rounding);
        self.internal.iter_mut().for_each(|internal| internal.end = time + size);
        self.left = if self.is_fed { time + size - rounding } else { f64::INFINITY };
        self.inputs.iter_mut().for_each(|inputs| inputs.begin(time));
        let due = self.next.filter(|_| is_due).map(|next| next.max(time));
        let step = Step {
            time,
            size,
            tolerance: self.tolerance,
            longest: self.longest,
            events: Events::Here,
            handled: self.handled,
            event: due.or(self.is_discrete.then_some(time)),
            restarts: self.restarts,
        };
        let mut workspace = std::mem::take(&mut self.workspace);
        let advance = match self.solver {
            Solver::Explicit => solver::advance::<DormandPrince, _>,
            Solver::Implicit => solver::advance::<Rodas5p, _>,
        };
        let mut equations = ComponentEquations { recorded, integrator: self };
        let advanced = advance(&mut equations, &mut workspace, &step);
        self.workspace = workspace;
        let Advanced { restarts, .. } = advanced?;
        self.restarts = restarts;
        if self.is_discrete {
            self.enter_event_mode(recorded)?;
        }
        Ok(())
    }
}

/// The equations of a component, as the solver sees them.
struct ComponentEquations<'a, 'b> {
    recorded: &'a mut RecordedInstance,
    integrator: &'a mut Integrator<'b>,
}

impl ComponentEquations<'_, '_> {
    /// Evaluates the equations for the states that the FMU has.
    fn evaluate_here(&mut self, time: f64) -> IntegrationResult {
        let mut states = vec![0.0; self.integrator.nominals.len()];
        self.read_states(&mut states)?;
        self.evaluate(time, &states)?;
        Ok(())
    }

    fn read_states(&mut self, states: &mut [f64]) -> IntegrationResult {
        match states.is_empty() {
            true => Ok(()),
            false => (self.recorded).call_with_warning(Operation::States, |instance| {
                instance.get_continuous_states(states)
            }),
        }
    }
}

impl OdeSystem for ComponentEquations<'_, '_> {
    type Error = IntegrationError;

    fn nominal(&self, state: usize) -> f64 {
        self.integrator.nominals[state].abs()
    }

    fn states(&mut self, states: &mut [f64]) -> IntegrationResult {
        self.read_states(states)
    }

    fn evaluate(&mut self, time: f64, states: &[f64]) -> IntegrationResult<bool> {
        // The time of an event differs by rounding from that of the step in which it is.
        let time = time.max(self.integrator.handled);
        let Integrator { derivatives, indicators, inputs, .. } = &mut *self.integrator;
        self.recorded.call_with_warning(Operation::SetTime, |instance| instance.set_time(time))?;
        if let Some(inputs) = inputs {
            self.recorded.set_inputs(inputs, time, false)?;
        }
        if !states.is_empty() {
            self.recorded.call_with_warning(Operation::SetStates, |instance| {
                instance.set_continuous_states(states)
            })?;
            self.recorded.call_with_warning(Operation::Derivatives, |instance| {
                instance.get_continuous_state_derivatives(derivatives)
            })?;
        }
        if !indicators.is_empty() {
            self.recorded.call_with_warning(Operation::Indicators, |instance| {
                instance.get_event_indicators(indicators)
            })?;
        }
        Ok(derivatives.iter().chain(&*indicators).all(|value| value.is_finite()))
    }

    fn derivatives(&mut self, derivatives: &mut [f64]) {
        derivatives.copy_from_slice(&self.integrator.derivatives);
    }

    fn directional_derivative(
        &mut self,
        direction: &[f64],
        product: &mut [f64],
    ) -> IntegrationResult<bool> {
        let Some([states, derivatives]) = &self.integrator.directional else { return Ok(false) };
        self.recorded.call_with_warning(Operation::Directional, |instance| {
            instance.get_directional_derivative(derivatives, states, direction, product)
        })?;
        Ok(true)
    }

    fn event_indicator(&mut self, indicator: usize) -> f64 {
        self.integrator.indicators[indicator]
    }

    fn not_finite(&mut self) -> IntegrationError {
        let reason = "a derivative or an event indicator became NaN or infinite".to_owned();
        IntegrationError::Equations { reason, is_discarded: false, advice: None }
    }

    fn completed(&mut self, time: f64) -> IntegrationResult<bool> {
        let operation = Operation::Completed;
        let completed = self.recorded.call(operation, Instance::completed_integrator_step)?;
        if completed.terminate {
            return Err(self.recorded.terminated(operation, time));
        }
        if let Some(internal) = &mut self.integrator.internal {
            internal.record(self.recorded, time)?;
        }
        Ok(completed.enter_event_mode)
    }

    fn event(&mut self, time: f64) -> IntegrationResult {
        if !self.integrator.is_in_event_mode && time > self.integrator.handled {
            self.recorded
                .call_with_warning(Operation::SetTime, |instance| instance.set_time(time))?;
        }
        self.integrator.enter_event_mode(self.recorded)?;
        if let Some(inputs) = &mut self.integrator.inputs {
            self.recorded.set_inputs(inputs, time, true)?;
            inputs.begin(time);
        }
        self.integrator.update(self.recorded, time)
    }

    fn next_event(&self, time: f64) -> Option<f64> {
        let Integrator { next, inputs, left, .. } = &*self.integrator;
        let events =
            [next.filter(|next| *next > time), inputs.as_ref().and_then(TableInputs::next)]
                .into_iter()
                .flatten();
        events.reduce(f64::min).filter(|next| next < left)
    }
}
