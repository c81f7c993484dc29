//! An instance of a container.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Error, Result, ensure};
use fmu_description::{Causality, FmiVersion, Type, Value, Variability, Variable};
use self_cell::self_cell;

use super::interface::{Exposed, Interface, Source, start};
use crate::component_instance::CallResult;
use crate::simulation::{Simulation, Snapshot};
use crate::{Description, Message, Messages, Plan, RunError, StartValue};

self_cell!(
    /// A simulation with its plan.
    struct Run {
        owner: Plan,
        #[not_covariant]
        dependent: Simulation,
    }
);

/// An instance of a container: a system whose host sets inputs and parameters, steps it and gets outputs.
pub struct Container {
    /// As it is in the container, with the times of the host.
    description: Description,
    interface: Interface,
    version: FmiVersion,
    system: System,
    /// The stop time of the host (s), if there is one.
    stop: Option<f64>,
    /// The values of inputs and parameters that the host has set, by value reference.
    given: BTreeMap<u32, Value>,
    /// The next communication point.
    k: u64,
    /// When an FMU has ended the simulation (s).
    ended: Option<f64>,
    /// Whether the host has set values since outputs were computed in the initialization.
    is_outdated: bool,
    messages: Messages,
    /// The snapshots that no saved state uses.
    free: Vec<Snapshot>,
    /// The number of this run, which saved states remember.
    run_number: u64,
}

/// The system, before and after the initialization has begun.
enum System {
    Planned(Box<Plan>),
    Initializing(Run),
    Running(Run),
    /// Lost by a failure.
    None,
}

/// What a call of a container has done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stepped {
    /// The whole step.
    Done,
    /// An FMU has ended the simulation, at a time (s).
    Ended(f64),
}

/// How grave a failure is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// The call has changed nothing.
    Refused,
    /// The instance can only be reset, restored or freed.
    Error,
    /// The instance can only be freed.
    Fatal,
}

/// Why a call of a container has failed.
#[derive(Debug)]
pub struct Failure {
    /// How grave it is.
    pub severity: Severity,
    /// The reason, which names the component.
    pub reason: String,
}

/// A saved state of a container, which [`Container::forget`] frees.
pub struct SavedContainer {
    snapshot: Option<Snapshot>,
    run_number: u64,
    is_initializing: bool,
    given: BTreeMap<u32, Value>,
    k: u64,
    ended: Option<f64>,
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self { severity: Severity::Error, reason: format!("{error:#}") }
    }
}

impl From<String> for Failure {
    fn from(reason: String) -> Self {
        Self { severity: Severity::Refused, reason }
    }
}

impl Container {
    /// Loads the system in the resources of a container, and checks that its interface has this GUID.
    ///
    /// # Errors
    /// The system cannot be loaded, or the GUID is that of another interface.
    pub fn new(resources: &Path, guid: &str, version: FmiVersion) -> Result<Self> {
        let (description, plan) = super::read(resources)?;
        let interface = Interface::new(&description, &plan)?;
        ensure!(
            interface.guid() == guid,
            "the GUID is {guid:?}, expected {:?}; does the model description belong to another container?",
            interface.guid()
        );
        Ok(Self {
            description,
            interface,
            version,
            stop: None,
            system: System::Planned(Box::new(plan)),
            given: BTreeMap::new(),
            k: 0,
            ended: None,
            is_outdated: false,
            messages: Messages::default(),
            free: Vec::new(),
            run_number: 0,
        })
    }

    /// Takes the messages that the FMUs have logged.
    pub fn take_messages(&mut self) -> Vec<Message> {
        self.messages.take()
    }

    /// The next communication point (s).
    pub fn time(&self) -> f64 {
        self.description.experiment().time(self.k)
    }

    /// When an FMU has ended the simulation (s).
    pub fn ended(&self) -> Option<f64> {
        self.ended
    }

    /// Begins the initialization at a start time up to a stop time (s), if there is one.
    ///
    /// # Errors
    /// A time does not fit, or an FMU returns an error.
    pub fn enter_initialization(&mut self, start: f64, stop: Option<f64>) -> Result<(), Failure> {
        let stop_or_start = stop.unwrap_or(start);
        if !start.is_finite() || stop_or_start < start {
            let stop = stop.map_or("none".to_owned(), |stop| format!("{stop:?}"));
            return Err(format!(
                "start time = {start:?}, stop time = {stop}, expected finite times in their order"
            )
            .into());
        }
        self.stop = stop;
        let times = &mut self.description;
        (times.start, times.stop) = (start, stop.unwrap_or(start + ENDLESS * times.step));
        let plan = match std::mem::replace(&mut self.system, System::None) {
            System::Planned(plan) => Some(*plan),
            System::Initializing(run) | System::Running(run) => Some(run.into_owner()),
            System::None => None,
        };
        // Steps and faults follow the times.
        let plan = plan.filter(|plan| plan.experiment == self.description.experiment());
        let plan = plan.map_or_else(|| Plan::new(&self.description), Ok)?;
        let given = self.starts();
        let run = Run::try_new(plan, |plan| {
            let starts = plan.all_starts(&given)?;
            let mut simulation = plan.instantiate(&starts, &self.messages)?;
            for (reference, exposed) in self.interface.exposed.iter().enumerate() {
                if let Source::Input(place) = exposed.source {
                    let given = self.given.get(&(reference as u32)).cloned();
                    let value = given.or_else(|| start_of(plan, exposed));
                    value.into_iter().for_each(|value| simulation.set_input(place, value));
                }
            }
            simulation
                .begin_initialization(&starts, stop.is_some())
                .map_err(|failure| Error::new(*failure))?;
            Ok::<_, Error>(simulation)
        })?;
        self.system = System::Initializing(run);
        self.begin_run();
        Ok(())
    }

    /// Ends the initialization.
    ///
    /// # Errors
    /// An FMU returns an error.
    pub fn exit_initialization(&mut self) -> Result<(), Failure> {
        self.compute()?;
        let given = self.starts();
        let System::Initializing(mut run) = std::mem::replace(&mut self.system, System::None)
        else {
            return Err("the initialization has not begun".to_owned().into());
        };
        let exited = run.with_dependent_mut(|plan, simulation| {
            let starts = plan.all_starts(&given).map_err(|error| (error.into(), None))?;
            let ended = simulation.end_initialization(&starts);
            ended.map_err(|failure| (Self::failure(&failure, simulation), failure.ended))
        });
        self.system = System::Running(run);
        match exited {
            // An FMU has ended the simulation in its first event: the first step says so.
            Err((_, Some(time))) => self.ended = Some(time),
            Err((failure, None)) => return Err(failure),
            Ok(()) => {}
        }
        Ok(())
    }

    /// The values that the host has set, by component.
    fn starts(&self) -> Vec<StartValue> {
        let given = self.given.iter().map(|(reference, value)| {
            let id = self.interface.exposed[*reference as usize].id;
            StartValue { component: id.component, values: vec![(id.scalar, value.clone())] }
        });
        given.collect()
    }

    /// Computes outputs in the initialization for the newest inputs and parameters.
    fn compute(&mut self) -> Result<(), Failure> {
        if std::mem::take(&mut self.is_outdated)
            && let System::Initializing(run) = &mut self.system
        {
            call(run, |simulation| simulation.initialize_again())?;
        }
        Ok(())
    }

    /// Takes a step of the host, which has one or more steps of the system.
    ///
    /// # Errors
    /// The times do not fit, or an FMU returns an error.
    pub fn do_step(&mut self, time: f64, step: f64) -> Result<Stepped, Failure> {
        let own = self.description.step;
        let steps = (step / own).round();
        let rounding = (time.abs() * f64::EPSILON / own).max(1e-6);
        let is_multiple = (step / own - steps).abs() <= rounding * steps;
        if !is_multiple || !(1.0..1e9).contains(&steps) {
            return Err(format!(
                "the communication step is {step:?} s, expected the step of the system, {own:?} s, or a multiple"
            )
            .into());
        }
        let expected = self.time();
        let is_reached = (time - expected).abs() <= 2.0 * rounding * own;
        if !is_reached {
            return Err(format!(
                "the step begins at t = {time:?} s, expected {expected:?} s, which the container has reached"
            )
            .into());
        }
        if let Some(stop) = self.stop
            && time + step > stop + rounding * own
        {
            return Err(format!(
                "the step ends at t = {:?} s, expected at most the stop time, {stop:?} s",
                time + step
            )
            .into());
        }
        let System::Running(run) = &mut self.system else {
            return Err("it is not initialized".to_owned().into());
        };
        for _ in 0..steps as u64 {
            if let Some(ended) = self.ended {
                return Ok(Stepped::Ended(ended));
            }
            let k = self.k;
            let stepped = run.with_dependent_mut(|_, simulation| {
                simulation.step_from(k).map_err(|failure| match failure.ended {
                    Some(time) => Ok(time),
                    None => Err(Self::failure(&failure, simulation)),
                })
            });
            match stepped {
                Ok(()) => self.k += 1,
                Err(Ok(time)) => self.ended = Some(time),
                Err(Err(failure)) => return Err(failure),
            }
        }
        Ok(self.ended.map_or(Stepped::Done, Stepped::Ended))
    }

    /// Ends the run.
    ///
    /// # Errors
    /// An FMU returns an error.
    pub fn terminate(&mut self) -> Result<(), Failure> {
        match &mut self.system {
            System::Initializing(run) | System::Running(run) => {
                call(run, |simulation| simulation.terminate())
            }
            System::Planned(_) | System::None => Ok(()),
        }
    }

    /// Returns to the state after the instantiation.
    pub fn reset(&mut self) {
        self.system = match std::mem::replace(&mut self.system, System::None) {
            System::Initializing(run) | System::Running(run) => {
                System::Planned(Box::new(run.into_owner()))
            }
            other => other,
        };
        self.given.clear();
        self.begin_run();
    }

    fn begin_run(&mut self) {
        self.free.clear();
        self.run_number += 1;
        (self.k, self.ended, self.is_outdated) = (0, None, false);
    }

    /// The variable with a value reference, if the function of a type gets and sets it.
    fn exposed(&self, function: Type, reference: u32) -> Result<&Exposed, Failure> {
        let exposed = self.interface.exposed.get(reference as usize);
        let exposed = exposed.ok_or_else(|| format!("value reference {reference} is unknown"))?;
        let of_type = exposed.variable.of_type;
        let fits = match (self.version, function) {
            (FmiVersion::Fmi2, Type::Float64) => of_type.is_float(),
            (FmiVersion::Fmi2, Type::Int32) => of_type.is_integer() || of_type == Type::Enumeration,
            (version, function) => of_type.accessed_as(version) == function,
        };
        if fits {
            return Ok(exposed);
        }
        let (name, of_type) = (&exposed.variable.name, of_type.name(self.version));
        Err(format!("{name} is of the type {of_type}").into())
    }

    /// Gets variables by the function of a type.
    ///
    /// # Errors
    /// A variable is unknown or of another type, or an FMU returns an error in the initialization.
    pub fn get(
        &mut self,
        function: Type,
        references: &[u32],
        mut take: impl FnMut(usize, Value) -> Result<(), String>,
    ) -> Result<(), Failure> {
        self.compute()?;
        for (index, reference) in references.iter().enumerate() {
            // The independent variable of FMI 3.0.
            if *reference as usize == self.interface.exposed.len() && function == Type::Float64 {
                take(index, Value::Float64(self.time()))?;
                continue;
            }
            let exposed = self.exposed(function, *reference)?;
            let value = self.value(*reference, exposed);
            let name = &exposed.variable.name;
            take(index, value).map_err(|reason| format!("{name} {reason}"))?;
        }
        Ok(())
    }

    fn value(&self, reference: u32, exposed: &Exposed) -> Value {
        let run = match &self.system {
            System::Initializing(run) | System::Running(run) => Some(run),
            System::Planned(_) | System::None => None,
        };
        match (exposed.source, run) {
            (Source::Output(place), Some(run)) => {
                let cell = run.with_dependent(|_, simulation| simulation.row().store.cell(place));
                cell.unwrap_or_else(|| Value::zero(exposed.variable.of_type))
            }
            (Source::Input(place), Some(run)) => {
                run.with_dependent(|_, simulation| simulation.input(place))
            }
            _ => {
                let given = self.given.get(&reference).cloned();
                let start = || exposed.variable.start.first().cloned();
                given.or_else(start).unwrap_or_else(|| Value::zero(exposed.variable.of_type))
            }
        }
    }

    /// Sets variables by the function of a type.
    ///
    /// # Errors
    /// A variable is unknown, of another type, or cannot be set now; then none is set. An FMU returns an error.
    pub fn set(
        &mut self,
        function: Type,
        references: &[u32],
        given: impl Fn(usize) -> Result<Value, String>,
    ) -> Result<(), Failure> {
        for (index, reference) in references.iter().enumerate() {
            self.settable(function, *reference, given(index))?;
        }
        for (index, reference) in references.iter().enumerate() {
            let value = self.settable(function, *reference, given(index))?;
            self.set_one(*reference, value)?;
        }
        Ok(())
    }

    /// The value of the host in the type of a variable, if it can be set now.
    fn settable(
        &self,
        function: Type,
        reference: u32,
        given: Result<Value, String>,
    ) -> Result<Value, Failure> {
        let exposed = self.exposed(function, reference)?;
        let Variable { name, causality, variability, of_type, .. } = &exposed.variable;
        let is_running = matches!(self.system, System::Running(_));
        let reason = match causality {
            Causality::Input => None,
            Causality::Parameter if !is_running || *variability == Variability::Tunable => None,
            Causality::Parameter => {
                Some("a fixed parameter, which is set before the end of the initialization")
            }
            _ => Some("neither an input nor a parameter"),
        };
        if let Some(reason) = reason {
            return Err(format!("{name} cannot be set: it is {reason}").into());
        }
        let value = given.map_err(|found| format!("{name} = {found}"))?;
        let converted = converted(&value, *of_type);
        let is_item = |value: &Value| {
            let items = exposed.variable.items();
            let number = value.as_whole();
            let mut known = items.iter().map(|item| Some(i128::from(item.value)));
            *of_type != Type::Enumeration || items.is_empty() || known.any(|known| known == number)
        };
        converted.filter(is_item).ok_or_else(|| {
            let expected = match of_type {
                Type::Enumeration => exposed.variable.expected(),
                of_type => format!("a value of the type {}", of_type.as_str()),
            };
            format!("{name} = {value}, expected {expected}").into()
        })
    }

    fn set_one(&mut self, reference: u32, value: Value) -> Result<(), Failure> {
        let Exposed { id, source, .. } = self.interface.exposed[reference as usize];
        self.given.insert(reference, value.clone());
        let starts = if matches!(source, Source::Parameter) { self.starts() } else { Vec::new() };
        let (System::Initializing(run) | System::Running(run)) = &mut self.system else {
            return Ok(());
        };
        match source {
            Source::Input(place) => {
                run.with_dependent_mut(|_, simulation| simulation.set_input(place, value));
            }
            _ => run.with_dependent_mut(|plan, simulation| {
                let starts = plan.starts(id.component, &starts)?;
                let set = simulation.set_parameter(id, &starts);
                set.map_err(|failure| Self::failure(&failure, simulation))
            })?,
        }
        self.is_outdated = matches!(self.system, System::Initializing(_));
        Ok(())
    }

    /// Saves the state of all FMUs.
    ///
    /// # Errors
    /// An FMU cannot, or returns an error.
    pub fn save(&mut self) -> Result<SavedContainer, Failure> {
        if let Some(reason) = &self.interface.unsavable {
            return Err(format!("the state cannot be saved: {reason}").into());
        }
        self.compute()?;
        let is_initializing = matches!(self.system, System::Initializing(_));
        let free = self.free.pop();
        let snapshot = match &mut self.system {
            System::Initializing(run) | System::Running(run) => {
                Some(run.with_dependent_mut(|_, simulation| {
                    let snapshot = free.map_or_else(|| simulation.snapshot(), Ok)?;
                    let saved = simulation.save(snapshot);
                    saved.map_err(|failure| Self::failure(&failure, simulation))?;
                    Ok::<_, Failure>(snapshot)
                })?)
            }
            System::Planned(_) | System::None => None,
        };
        let Self { k, ended, run_number, .. } = *self;
        let given = self.given.clone();
        Ok(SavedContainer { snapshot, run_number, is_initializing, given, k, ended })
    }

    /// Returns to a saved state.
    ///
    /// # Errors
    /// It belongs to a run before a reset, or an FMU returns an error.
    pub fn restore(&mut self, saved: &SavedContainer) -> Result<(), Failure> {
        match (saved.snapshot, &mut self.system) {
            (Some(snapshot), System::Initializing(run) | System::Running(run))
                if saved.run_number == self.run_number =>
            {
                call(run, |simulation| simulation.restore(snapshot))?;
            }
            (Some(_), _) => {
                return Err("the state belongs to a run that was reset".to_owned().into());
            }
            (None, _) => self.reset(),
        }
        self.system = match std::mem::replace(&mut self.system, System::None) {
            System::Initializing(run) | System::Running(run) if saved.is_initializing => {
                System::Initializing(run)
            }
            System::Initializing(run) => System::Running(run),
            other => other,
        };
        (self.k, self.ended, self.is_outdated) = (saved.k, saved.ended, false);
        self.given.clone_from(&saved.given);
        Ok(())
    }

    /// Frees a saved state.
    pub fn forget(&mut self, saved: SavedContainer) {
        if saved.run_number == self.run_number {
            self.free.extend(saved.snapshot);
        }
    }

    fn failure(failure: &RunError, simulation: &Simulation<'_>) -> Failure {
        let severity = if simulation.is_lost() { Severity::Fatal } else { Severity::Error };
        Failure { severity, reason: failure.to_string() }
    }
}

/// The number of steps of a run without a stop time, in which slow components know no end.
const ENDLESS: f64 = 5e8;

/// Calls the FMUs of a run.
fn call(
    run: &mut Run,
    call: impl FnOnce(&mut Simulation<'_>) -> CallResult,
) -> Result<(), Failure> {
    run.with_dependent_mut(|_, simulation| {
        call(simulation).map_err(|failure| Container::failure(&failure, simulation))
    })
}

fn start_of(plan: &Plan, exposed: &Exposed) -> Option<Value> {
    start(plan, exposed.id)
}

/// A value of the host in the type of a variable.
fn converted(value: &Value, of_type: Type) -> Option<Value> {
    if value.of_type() == of_type {
        return Some(value.clone());
    }
    match value.as_real() {
        Some(real) => Value::real(of_type, real),
        None => Value::whole(of_type, value.as_whole()?),
    }
}
