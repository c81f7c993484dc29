//! One FMU that its user steps by hand: in this process, or on the worker side, where [`serve`] receives the requests.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Display;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, Type, Value, Variability, Variable};
use fmu_host::{Instance, InterfaceType, Success};
use fmu_worker::{Function, Record, Service};
use serde::{Deserialize, Serialize};

use crate::access_list::{AccessList, accessor};
use crate::component_instance::{CallResult, ComponentInstance};
use crate::component_state::ComponentState;
use crate::components::LoadedComponent;
use crate::cycle::Cycle;
use crate::literal::refusal;
use crate::start::{ComponentStarts, ScalarLiteral, scalar_literals};
use crate::{
    Compilation, Description, Fmu, Literal, Messages, Observation, Plan, RunError, Solver,
};

/// Which FMU to step, and how.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Setup {
    /// The file.
    pub file: PathBuf,
    /// The name of the instance; by default from the name of the file.
    pub name: Option<String>,
    /// How it is run; by default by co-simulation, if it supports that.
    pub interface: Option<InterfaceType>,
    /// The start time (s).
    pub start: f64,
    /// The relative tolerance.
    pub tolerance: Option<f64>,
    /// The method by which its equations are integrated.
    pub solver: Option<Solver>,
    /// Values of structural parameters, which are sizes of arrays.
    pub sizes: Vec<(String, Literal)>,
    /// Whether it is compiled, if it has no binary for this machine.
    pub compilation: Compilation,
    /// What is observed of its calls.
    pub observation: Observation,
}

/// A request to an FMU. Variables are scalars or elements, by their numbers in [`Names`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Request {
    /// To initialize itself, with these start values.
    Initialize(Vec<(usize, Value)>),
    /// To step by this time (s).
    Step(f64),
    /// To get values.
    Get(Vec<usize>),
    /// To set values.
    Set(Vec<(usize, Value)>),
    /// To save its state.
    Save,
    /// To restore a state.
    Restore(u64),
    /// To return to what it was before the initialization. Saved states stay valid.
    Reset,
    /// To free a state.
    Forget(u64),
    /// To get the continuous states, in model exchange.
    States,
    /// To set them.
    SetStates(Vec<f64>),
    /// To get their derivatives.
    Derivatives,
    /// To get the directional derivative of unknowns with respect to knowns, for a seed.
    Directional(Vec<usize>, Vec<usize>, Vec<f64>),
}

/// The response of an FMU to a request.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Response {
    /// The request was fulfilled, and the FMU has reached this time (s).
    Time(f64),
    /// The values of variables.
    Values(Vec<Value>),
    /// Numbers of the type Float64.
    Numbers(Vec<f64>),
    /// The number of a saved state.
    Saved(u64),
}

/// The reply to a list of requests, which are fulfilled in their order.
#[derive(Debug, Serialize, Deserialize)]
pub struct Reply {
    /// The responses to the requests that were fulfilled.
    pub responses: Vec<Response>,
    /// Why the request after them was not fulfilled. Those that follow it are left out.
    pub failure: Option<Box<RunError>>,
}

/// The variables of an FMU. It is read, but not loaded.
pub struct Names(LoadedComponent);

impl Names {
    /// Reads an FMU.
    ///
    /// # Errors
    /// The file is not a valid FMU with this interface and a binary for this machine.
    pub fn open(setup: &Setup) -> Result<Self> {
        let mut description = Description::read_fmu(&setup.file)?;
        description.tolerance = setup.tolerance;
        description.solver = setup.solver;
        description.compilation = setup.compilation.clone();
        let component = &mut description.components[0];
        component.interface = setup.interface;
        // A user who steps by hand does not handle events.
        component.event_mode = Some(false);
        component.name = setup.name.clone().unwrap_or(std::mem::take(&mut component.name));
        component.start.extend(setup.sizes.iter().cloned());
        let mut plan = Plan::new(&description)?;
        Ok(Self(plan.components.all.swap_remove(0)))
    }

    /// The component whose variables they are.
    pub(crate) fn component(&self) -> &LoadedComponent {
        &self.0
    }

    /// Its file.
    pub fn file(&self) -> &Path {
        &self.0.fmu.path
    }

    /// The names of the continuous states and their derivatives.
    pub fn states(&self) -> &[[String; 2]] {
        &self.0.fmu.states
    }

    /// Whether it provides directional derivatives.
    pub fn is_directional(&self) -> bool {
        self.0.fmu.is_directional
    }

    /// Its name, and the name of its file.
    pub fn names(&self) -> (String, String) {
        (self.0.name.clone(), self.0.fmu.file_name())
    }

    /// The scalar of this name, if it is a Float64 and no element of an array. Such variables are got and set by one
    /// call without a list.
    #[inline]
    pub fn float64(&self, name: &str) -> Option<usize> {
        let fmu = &self.0.fmu;
        fmu.get_scalar(name).filter(|scalar| float64_reference(fmu, *scalar).is_some())
    }

    /// Its variables.
    pub fn variables(&self) -> &[Variable] {
        &self.0.fmu.variables
    }

    /// The variable of a scalar or an element, by its number.
    pub fn variable(&self, scalar: usize) -> &Variable {
        self.0.fmu.variable(scalar)
    }

    /// Whether a process can have only one instance.
    pub fn is_single(&self) -> bool {
        self.0.fmu.only_once
    }

    /// The numbers of a scalar or an element, or of all elements of an array.
    ///
    /// # Errors
    /// There is no such variable; the error names similar ones.
    pub fn find(&self, name: &str) -> Result<Range<usize>> {
        self.0.fmu.scalars_of(name)
    }

    /// The shape of the array of this name; `None` if there is no such array.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        let elements = self.0.fmu.array_of(name)?;
        Some(&self.0.fmu.variable(elements.start).dimensions)
    }

    /// The values of a scalar, or of all elements of an array, in their types. A text is no number, as the value comes
    /// from a language that has both.
    ///
    /// # Errors
    /// There is no such variable, or the value does not fit.
    pub fn typed(&self, name: &str, value: &Literal) -> Result<Vec<(usize, Value)>> {
        let fmu = &self.0.fmu;
        // The usual case.
        if let Some(scalar) = fmu.get_scalar(name) {
            return Ok(vec![(scalar, value.typed_strictly(fmu.variable(scalar), name)?)]);
        }
        let list;
        let value = match value {
            Literal::Array(_) => value,
            single => {
                list = Literal::Array(vec![single.clone()]);
                &list
            }
        };
        let literals = scalar_literals(fmu, name, name, value)?.into_iter();
        let typed = literals.map(|ScalarLiteral { scalar, name, literal }| {
            Ok((scalar, literal.typed_strictly(fmu.variable(scalar), &name)?))
        });
        typed.collect()
    }

    /// Whether the FMU, by its description, accepts this value of a scalar at any time between steps.
    pub fn is_accepted(&self, scalar: usize, value: &Value) -> bool {
        let Variable { causality, variability, min, max, .. } = self.variable(scalar);
        let is_settable = *causality == Causality::Input || *variability == Variability::Tunable;
        is_settable
            && value.as_real().is_none_or(f64::is_finite)
            && min.as_ref().is_none_or(|min| value >= min)
            && max.as_ref().is_none_or(|max| value <= max)
    }

    /// The error of a value, shown in this way, whose type no variable has.
    ///
    /// # Errors
    /// There is no such variable.
    pub fn refusal(&self, name: &str, shown: &str) -> Result<anyhow::Error> {
        let variable = self.variable(self.find(name)?.start);
        Ok(refusal(variable, name, shown, ""))
    }
}

/// The value reference of a scalar, if it is a Float64 and no element of an array.
#[inline]
fn float64_reference(fmu: &Fmu, scalar: usize) -> Option<u32> {
    let Variable { of_type, reference, dimensions, .. } = fmu.variable(scalar);
    (*of_type == Type::Float64 && dimensions.is_empty()).then_some(*reference)
}

/// Scalars of one type that follow each other in a list, and the function that gets them.
struct Reading {
    kind: Type,
    get: Option<Function>,
    wired: AccessList,
}

/// The number of lists of scalars whose access is kept.
const LISTS: usize = 64;

/// A saved state, and its time (s).
struct Saved {
    state: ComponentState<'static>,
    time: f64,
}

/// An instance of an FMU.
pub struct SteppedFmu {
    component: ComponentInstance<'static>,
    planned: LoadedComponent,
    messages: Messages,
    start: f64,
    time: f64,
    /// Whether it is initialized, and whether no call has failed.
    runs: bool,
    is_sound: bool,
    saved: BTreeMap<u64, Saved>,
    next: u64,
    /// The functions that get and set a Float64, which are found by their names.
    get_float64: Option<Function>,
    set_float64: Option<Function>,
    /// How lists of scalars are got, by the lists.
    readings: HashMap<Vec<usize>, Vec<Reading>>,
}

impl SteppedFmu {
    /// Instantiates an FMU, whose calls are recorded.
    ///
    /// # Errors
    /// The binary cannot be loaded, or the FMU returns an error.
    pub fn new(setup: &Setup, record: &Record) -> Result<Self> {
        let Names(planned) = Names::open(setup)?;
        let messages = Messages::recorded(record.clone());
        let messages = setup.observation.begin(messages, std::slice::from_ref(&planned))?;
        Self::instantiate(planned, 0, setup.start, messages)
    }

    /// Instantiates a component, which has this number among those that are recorded.
    pub(crate) fn instantiate(
        planned: LoadedComponent,
        number: usize,
        start: f64,
        messages: Messages,
    ) -> Result<Self> {
        let starts = ComponentStarts::default();
        Ok(Self {
            component: ComponentInstance::new(number, &planned, &[], &starts, &messages)?,
            get_float64: accessor("get", planned.fmu.version, Type::Float64),
            set_float64: accessor("set", planned.fmu.version, Type::Float64),
            readings: HashMap::new(),
            planned,
            messages,
            start,
            time: start,
            runs: false,
            is_sound: true,
            saved: BTreeMap::new(),
            next: 0,
        })
    }

    /// Fulfils a request.
    ///
    /// # Errors
    /// The FMU returns an error, or cannot do this.
    pub fn fulfil(&mut self, request: &Request) -> Result<Response> {
        let response = self.try_to_fulfil(request);
        self.is_sound &= response.is_ok();
        response
    }

    /// Whether it is initialized.
    pub fn runs(&self) -> bool {
        self.runs
    }

    /// Steps by a time (s), and returns the time that it has reached (s).
    ///
    /// # Errors
    /// The FMU returns an error.
    #[inline]
    pub fn step(&mut self, step: f64) -> Result<f64> {
        let stepped = self.try_to_step(step);
        self.is_sound &= stepped.is_ok();
        stepped?;
        Ok(self.time)
    }

    /// Gets the scalar that [`Names::float64`] has found.
    ///
    /// # Errors
    /// The FMU returns an error.
    #[inline]
    pub fn get_float64(&mut self, scalar: usize) -> Result<f64> {
        let Some(reference) = self.float64_reference(scalar) else {
            bail!("{} is not a scalar of type Float64", self.planned.fmu.name(scalar))
        };
        self.component.recorded.calls.begin(self.get_float64);
        let mut value = [0.0];
        match self.component.recorded.instance.get_float64(&[reference], &mut value) {
            Ok(Success::Ok) => Ok(value[0]),
            outcome => {
                let name = self.planned.fmu.name(scalar);
                let checked = self.component.check(outcome, || name);
                self.is_sound &= checked.is_ok();
                self.with_time(checked)?;
                Ok(value[0])
            }
        }
    }

    /// Sets the scalar that [`Names::float64`] has found.
    ///
    /// # Errors
    /// The FMU returns an error.
    #[inline]
    pub fn set_float64(&mut self, scalar: usize, value: f64) -> Result<()> {
        let reference = self.float64_reference(scalar);
        let (Some(reference), None) = (reference, &self.component.integrator) else {
            return self.fulfil(&Request::Set(vec![(scalar, Value::Float64(value))])).map(drop);
        };
        self.component.recorded.calls.begin(self.set_float64);
        match self.component.recorded.instance.set_float64(&[reference], &[value]) {
            Ok(Success::Ok) => Ok(()),
            outcome => {
                let what = format!("{} = {}", self.planned.fmu.name(scalar), Value::Float64(value));
                let checked = self.component.check(outcome, || what);
                self.is_sound &= checked.is_ok();
                self.with_time(checked)
            }
        }
    }

    /// [`float64_reference`] of an FMU that is initialized.
    #[inline]
    fn float64_reference(&self, scalar: usize) -> Option<u32> {
        float64_reference(&self.planned.fmu, scalar).filter(|_| self.runs)
    }

    fn try_to_step(&mut self, step: f64) -> Result<()> {
        ensure!(self.runs, "{} is not initialized", self.planned.name);
        let is_usable = step > 0.0 && step.is_finite();
        // In co-simulation, the FMU decides.
        ensure!(
            is_usable || self.component.integrator.is_none(),
            "step = {step:?} s is invalid, expected a positive number"
        );
        self.messages.record().step(step);
        let stepped = self.component.step::<false>(self.time, step);
        self.with_time(stepped)?;
        self.time += step;
        self.messages.record().at(self.time);
        Ok(())
    }

    fn try_to_fulfil(&mut self, request: &Request) -> Result<Response> {
        let needs_run = !matches!(
            request,
            Request::Initialize(_) | Request::Restore(_) | Request::Forget(_) | Request::Reset
        );
        if needs_run && !self.runs {
            bail!("{} is not initialized", self.planned.name);
        }
        match request {
            Request::Initialize(starts) => {
                let called = self.initialize(starts);
                self.with_time(called)?;
            }
            Request::Step(step) => self.try_to_step(*step)?,
            Request::Get(scalars) => return self.get(scalars).map(Response::Values),
            Request::Set(values) => self.set(values)?,
            Request::Save => return self.save().map(Response::Saved),
            Request::Restore(number) => self.restore(*number)?,
            Request::Reset => self.reset()?,
            Request::Forget(number) => {
                if let Some(Saved { state, .. }) = self.saved.remove(number) {
                    let forgotten = self.component.forget(state);
                    self.with_time(forgotten)?;
                }
            }
            Request::States => {
                return self.numbers("get_continuous_states", Instance::get_continuous_states);
            }
            Request::Derivatives => {
                return self.numbers(
                    "get_continuous_state_derivatives",
                    Instance::get_continuous_state_derivatives,
                );
            }
            Request::SetStates(states) => {
                let count = self.states()?;
                ensure!(states.len() == count, "{} states, expected {count}", states.len());
                self.call("set_continuous_states", "continuous states", |instance| {
                    instance.set_continuous_states(states)
                })?;
            }
            Request::Directional(unknowns, knowns, seed) => {
                let (unknowns, knowns) = (self.references(unknowns)?, self.references(knowns)?);
                let (given, expected) = (seed.len(), knowns.len());
                ensure!(given == expected, "the seed has {given} numbers, expected {expected}");
                let mut values = vec![0.0; unknowns.len()];
                self.call("get_directional_derivative", "directional derivative", |instance| {
                    instance.get_directional_derivative(&unknowns, &knowns, seed, &mut values)
                })?;
                return Ok(Response::Numbers(values));
            }
        }
        Ok(Response::Time(self.time))
    }

    fn call(
        &mut self,
        operation: &str,
        what: impl Display,
        call: impl FnOnce(&mut Instance) -> fmu_host::Result,
    ) -> Result<()> {
        let called = self.component.call(operation, what, call);
        self.with_time(called)
    }

    /// Adds the time to a failure.
    fn with_time<T>(&self, called: CallResult<T>) -> Result<T> {
        let at = |failure: Box<RunError>| if self.runs { failure.at(self.time) } else { failure };
        called.map_err(|failure| anyhow::Error::new(*at(failure)))
    }

    fn initialize(&mut self, starts: &[(usize, Value)]) -> CallResult {
        let LoadedComponent { tolerance, .. } = self.planned;
        let starts = ComponentStarts::new(self.planned.starts.iter().chain(starts));
        self.component.set_up((self.time, None), tolerance, &starts)?;
        self.component.enter_initialization()?;
        self.component.exit_initialization()?;
        self.component.begin(None, &self.planned, (self.time, f64::INFINITY))?;
        self.runs = true;
        self.messages.record().at(self.time);
        Ok(())
    }

    /// Says which variables [`SteppedFmu::perform`] sets and gets.
    pub(crate) fn prepare(&mut self, cycle: &Cycle) {
        self.component.prepare(cycle);
    }

    /// Sets values, steps and gets values, as it is prepared for.
    pub(crate) fn perform(
        &mut self,
        cycle: &Cycle,
        inputs: &[f64],
        step: f64,
        outputs: &mut [f64],
    ) -> Result<()> {
        let record = self.messages.record();
        record.step(step);
        record.at(self.time);
        let called = self.component.perform(cycle, inputs, (self.time, step), outputs);
        self.with_time(called)?;
        self.time += step;
        Ok(())
    }

    fn get(&mut self, scalars: &[usize]) -> Result<Vec<Value>> {
        if let [scalar] = *scalars
            && self.float64_reference(scalar).is_some()
        {
            return Ok(vec![Value::Float64(self.get_float64(scalar)?)]);
        }
        let fmu = &self.planned.fmu;
        if !self.readings.contains_key(scalars) {
            if self.readings.len() == LISTS {
                self.readings.clear();
            }
            let same = scalars.chunk_by(|a, b| fmu.access_type(*a) == fmu.access_type(*b));
            let readings = same.map(|same| {
                let kind = fmu.access_type(same[0]);
                let get = accessor("get", fmu.version, kind);
                Reading { kind, get, wired: AccessList::new(fmu, same.iter().copied()) }
            });
            self.readings.insert(scalars.to_vec(), readings.collect());
        }
        let mut values = Vec::with_capacity(scalars.len());
        for Reading { kind, get, wired } in &self.readings[scalars] {
            match self.component.get(*kind, *get, wired) {
                Ok(got) => values.extend(got),
                failed => return self.with_time(failed),
            }
        }
        Ok(values)
    }

    /// Sets values; of an array of which some elements are given, the others stay.
    fn set(&mut self, values: &[(usize, Value)]) -> Result<()> {
        let fmu = self.planned.fmu.clone();
        for given in values.chunk_by(|(a, _), (b, _)| fmu.array(*a) == fmu.array(*b)) {
            let scalar = given[0].0;
            if let [(_, Value::Float64(value))] = *given
                && self.component.integrator.is_none()
                && self.float64_reference(scalar).is_some()
            {
                self.set_float64(scalar, value)?;
                continue;
            }
            let (variable, kind) = (fmu.variable(scalar), fmu.access_type(scalar));
            let mut array = match variable.element_count() == given.len() {
                true => vec![Value::Boolean(false); given.len()],
                false => self.get(&Vec::from_iter(fmu.array(scalar)))?,
            };
            for (scalar, value) in given {
                array[fmu.scalars[*scalar].element] = value.clone();
            }
            let wired = AccessList::new(&fmu, given.iter().map(|(scalar, _)| *scalar));
            let waits = variable.causality == Causality::Input
                && variable.variability != Variability::Continuous;
            match &mut self.component.integrator {
                Some(integrator) if waits || variable.is_parameter() => {
                    let set = |instance: &mut Instance| {
                        instance.set_values(kind, &wired.references, &array)
                    };
                    let event = integrator.at_event(&mut self.component.recorded, self.time, set);
                    let what = variable.name.clone();
                    let event =
                        event.map_err(|error| self.component.integration_error(error, what));
                    self.with_time(event)?;
                }
                _ => {
                    let set = accessor("set", fmu.version, kind);
                    let called = self.component.set(kind, set, &wired, &array);
                    self.with_time(called)?;
                }
            }
        }
        Ok(())
    }

    fn save(&mut self) -> Result<u64> {
        let mut state = None;
        let saved = self.component.save(&mut state);
        self.with_time(saved)?;
        let state = state.context("the FMU has no state")?;
        self.next += 1;
        self.saved.insert(self.next, Saved { state, time: self.time });
        Ok(self.next)
    }

    fn restore(&mut self, number: u64) -> Result<()> {
        let saved = self.saved.get(&number).context("there is no such state")?;
        let (restored, time) = (self.component.restore(&saved.state), saved.time);
        self.with_time(restored)?;
        self.time = time;
        self.runs = true;
        self.messages.record().at(self.time);
        Ok(())
    }

    fn reset(&mut self) -> Result<()> {
        self.call("reset", "reset", Instance::reset)?;
        (self.time, self.runs, self.is_sound) = (self.start, false, true);
        self.component.integrator = None;
        self.messages.record().at(f64::NAN);
        Ok(())
    }

    /// The number of continuous states.
    fn states(&self) -> Result<usize> {
        let integrator = self.component.integrator.as_ref();
        let name = &self.planned.name;
        let expected = "run it by model exchange for continuous states and derivatives";
        integrator
            .map(|integrator| integrator.states())
            .with_context(|| format!("{name}: {expected}"))
    }

    fn numbers(
        &mut self,
        operation: &str,
        get: impl FnOnce(&mut Instance, &mut [f64]) -> fmu_host::Result,
    ) -> Result<Response> {
        let mut numbers = vec![0.0; self.states()?];
        if !numbers.is_empty() {
            self.call(operation, "", |i| get(i, &mut numbers))?;
        }
        Ok(Response::Numbers(numbers))
    }

    /// The value references of scalars.
    fn references(&self, scalars: &[usize]) -> Result<Vec<u32>> {
        let fmu = &self.planned.fmu;
        let references = scalars.iter().map(|scalar| {
            let variable = fmu.variable(*scalar);
            let name = &variable.name;
            ensure!(variable.element_count() == 1, "{name} is an array, expected a scalar");
            Ok(variable.reference)
        });
        references.collect()
    }
}

impl Drop for SteppedFmu {
    /// Frees the saved states.
    fn drop(&mut self) {
        for Saved { state, .. } in std::mem::take(&mut self.saved).into_values() {
            // The instance is freed in any case.
            let _ = self.component.forget(state);
        }
        if self.runs && self.is_sound {
            let _ = self.call("terminate", "end", Instance::terminate);
        }
    }
}

/// Fulfils the requests of the supervisor of this worker process, until there are no more.
///
/// # Errors
/// A request is damaged.
pub fn serve(service: &mut Service, setup: &Setup) -> Result<()> {
    let failed = |error| RunError::new(error, Vec::new());
    let mut fmu = match SteppedFmu::new(setup, service.record()) {
        Ok(fmu) => fmu,
        Err(error) => {
            service.reply(&Reply { responses: Vec::new(), failure: Some(failed(error)) });
            return Ok(());
        }
    };
    service.reply(&Reply { responses: vec![Response::Time(fmu.time)], failure: None });
    while let Some(requests) = service.task::<Vec<Request>>()? {
        let mut reply = Reply { responses: Vec::with_capacity(requests.len()), failure: None };
        for request in &requests {
            match fmu.fulfil(request) {
                Ok(response) => reply.responses.push(response),
                Err(error) => {
                    reply.failure = Some(failed(error));
                    break;
                }
            }
        }
        fmu.messages.record().end_call();
        service.reply(&reply);
    }
    Ok(())
}
