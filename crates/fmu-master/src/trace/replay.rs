//! Repeats the calls of a trace with an FMU, and finds what differs. [`serve`] runs in the worker process, [`supervise`] in
//! the supervisor.

use std::collections::{BTreeMap, VecDeque};
use std::ffi::c_int;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use fmu_host::{
    CallObserver, Direction, Element, Instance, Instantiation, Library, LogMessage, ObservedCall,
    RepeatedCall, RepeatedStates,
};
use fmu_worker::{Event, Function, Service, Worker};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::element::{States, to_json};
use super::read::{Trace, TracedCall, TracedComponent, accessed_by};
use super::recorder::of_status;
use crate::fmu::Sizes;
use crate::table::Tolerance;
use crate::{Compilation, Fmu, Sandbox};

/// What to repeat, and how.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ReplaySource {
    /// The trace.
    pub trace: PathBuf,
    /// The FMU that replaces the one of the component.
    pub fmu: Option<PathBuf>,
    /// The only component whose calls are repeated.
    pub component: Option<String>,
    /// How far numbers may be apart: `absolute + relative * VALUE`.
    pub tolerance: Tolerance,
    /// How WebAssembly components run.
    pub sandbox: Sandbox,
    /// Whether FMUs are compiled.
    pub compilation: Compilation,
}

/// A call that differs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// The call, such as `call 17 at t = 0.1 s, plant: fmi2GetReal`.
    pub place: String,
    /// What differs, such as `theta = 0.2, in the trace 0.1`.
    pub text: String,
}

/// What was found.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Replayed {
    /// The number of calls that were repeated.
    pub calls: u64,
    /// The first call that differs.
    pub first: Option<Difference>,
    /// How many calls differ, by component and function.
    pub differing: BTreeMap<String, u64>,
    /// What the user may want to know.
    pub notes: Vec<String>,
}

/// How a replay has ended.
#[derive(Debug)]
pub enum ReplayEnd {
    /// All calls were repeated.
    Done(Replayed),
    /// The process has ended in a call.
    Crashed {
        /// The call.
        place: String,
        /// How.
        how: String,
        /// How the process ended in this call of the trace, if it did.
        in_trace: Option<String>,
        /// The first difference before.
        first: Option<Difference>,
    },
    /// It was cancelled.
    Cancelled,
}

/// A message of the worker.
#[derive(Serialize, Deserialize)]
enum Report {
    /// A call is about to be repeated that has not returned in the trace.
    Open(String),
    /// The first difference.
    First(Difference),
    Done(Replayed),
    Failed(String),
}

/// What an FMU returned in the call in progress.
#[derive(Default)]
struct Observed {
    status: Option<Value>,
    out: Map<String, Value>,
    message: Option<String>,
}

#[derive(Default)]
struct Observer(Mutex<Observed>);

impl Observer {
    fn observed(&self) -> MutexGuard<'_, Observed> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CallObserver for Observer {
    fn begin(&self, _: &ObservedCall<'_>) {
        *self.observed() = Observed::default();
    }

    fn end(&self, call: &ObservedCall<'_>, status: Option<c_int>, _: Duration) {
        let mut observed = self.observed();
        let is_instance = call.function.contains("Instantiate");
        observed.status = Some(match status {
            Some(status) if is_instance => (status == 0).into(),
            Some(status) => of_status(call.function, status),
            None => Value::Null,
        });
        if !status.is_none_or(|status| matches!(status, 0..=2)) {
            return;
        }
        let is_ok = status.is_none_or(|status| status < 2);
        let mut states = States::default();
        for (index, (name, direction)) in call.arguments().enumerate() {
            if direction != Direction::Out {
                continue;
            }
            let mut all = Vec::new();
            let is_list =
                call.elements(index, &mut |element| all.push(to_json(element, &mut states)));
            let value = match is_list {
                true if !is_ok => continue,
                true => Value::Array(all),
                false => all.pop().unwrap_or_default(),
            };
            observed.out.insert(name.to_owned(), value);
        }
    }

    fn log(&self, message: &LogMessage) {
        self.observed().message = Some(message.text.clone());
    }
}

/// The calls that are made when the FMU calls back in the call in progress, and what it returned in them.
#[derive(Default)]
struct InnerCalls {
    waiting: VecDeque<RepeatedCall>,
    observed: VecDeque<Observed>,
}

/// An FMU that takes the place of a component.
struct Replica {
    fmu: Arc<Fmu>,
    library: Option<Arc<Library>>,
    observer: Arc<Observer>,
    /// Dropped before the library.
    instance: Option<Instance>,
    states: RepeatedStates,
    inner: Arc<Mutex<InnerCalls>>,
}

impl ReplaySource {
    /// The indices of the components whose calls are repeated.
    fn chosen(&self, trace: &Trace) -> Result<Vec<usize>> {
        let chosen = match &self.component {
            Some(name) => vec![trace.component(name)?],
            None => {
                let all = 0..trace.components.len();
                all.filter(|index| trace.components[*index].fmu.is_some()).collect()
            }
        };
        let names = chosen.iter().map(|index| trace.components[*index].name.as_str());
        let names = Vec::from_iter(names).join(", ");
        ensure!(
            self.fmu.is_none() || chosen.len() == 1,
            "the trace has the components {names}, expected the one that the FMU replaces, as --component"
        );
        Ok(chosen)
    }
}

/// Repeats the calls of a trace in this process, and reports to the supervisor.
///
/// # Errors
/// The record of the calls cannot be written.
pub fn serve(service: &mut Service, source: &ReplaySource) -> Result<()> {
    let report = match replay(service, source) {
        Ok(replayed) => Report::Done(replayed),
        Err(error) => Report::Failed(format!("{error:#}")),
    };
    service.record().end_call();
    service.reply(&report);
    Ok(())
}

fn replay(service: &mut Service, source: &ReplaySource) -> Result<Replayed> {
    let mut trace = Trace::open(&source.trace)?;
    let mut replicas: BTreeMap<usize, Replica> = BTreeMap::new();
    for index in source.chosen(&trace)? {
        let component = &trace.components[index];
        let of = component.fmu.as_ref();
        let of = of.with_context(|| format!("{} is a function, not an FMU", component.name))?;
        let path = source.fmu.as_ref().unwrap_or(&of.path);
        let (interface, sizes) = (Some(of.interface), Sizes::new());
        let fmu = Fmu::open(path, interface, &sizes, source.sandbox, &source.compilation);
        let fmu = fmu.with_context(|| format!("component {}", component.name))?;
        ensure!(
            fmu.version == of.version,
            "{} is of FMI {}, expected FMI {} as in the trace",
            path.display(),
            fmu.version.as_str(),
            of.version.as_str()
        );
        let (fmu, observer) = (Arc::new(fmu), Arc::default());
        let states = RepeatedStates::default();
        let (library, instance, inner) = (None, None, Arc::default());
        replicas.insert(index, Replica { fmu, library, observer, instance, states, inner });
    }
    let mut replayed = Replayed::default();
    while let Some(traced) = trace.next_call()? {
        let Some(replica) = replicas.get_mut(&traced.component) else { continue };
        if replica.library.as_ref().is_some_and(|library| library.is_lost()) {
            let text = "an FMU must not be called after a fatal error; the rest was left out";
            replayed.notes.push(text.to_owned());
            break;
        }
        let component = &trace.components[traced.component];
        let place = place(&traced, component);
        service.record().at(traced.time.unwrap_or(f64::NAN));
        service.record().stage(&place);
        let function = Function::named(&traced.call.function).or(Some(Function::LOADING));
        service.record().calls(traced.component).begin(function);
        if traced.status.is_none() {
            let how = traced.ended.as_deref().unwrap_or("has ended");
            service.reply(&Report::Open(how.to_owned()));
        }
        replica.prepare(trace.within(traced.number), component);
        let text = match replica.repeat(&traced, component)? {
            Repeated::Skipped => continue,
            Repeated::Missing(text) => Some(text),
            Repeated::Called => replica.difference(&traced, component, source.tolerance),
        };
        service.record().end_call();
        replayed.calls += 1;
        if let Some(text) = text {
            let key = format!("{}: {}", component.name, traced.call.function);
            *replayed.differing.entry(key).or_default() += 1;
            if replayed.first.is_none() {
                let first = Difference { place, text };
                service.reply(&Report::First(first.clone()));
                replayed.first = Some(first);
            }
        }
    }
    if trace.is_cut {
        replayed.notes.push("the trace ends within a line, which was left out".to_owned());
    }
    if let Some(ended) = &trace.ended {
        replayed.notes.push(format!("the process of the trace {ended}, outside of a call"));
    }
    ensure!(replayed.calls > 0, "the trace has no calls to repeat");
    Ok(replayed)
}

/// A call as people read it.
pub(crate) fn place(traced: &TracedCall, component: &TracedComponent) -> String {
    let time = traced.time.map(|time| format!(" at t = {time:?} s")).unwrap_or_default();
    format!("call {}{time}, {}: {}", traced.number, component.name, traced.call.function)
}

/// What became of a call.
enum Repeated {
    Called,
    /// It is of no instance, or of one that does not exist.
    Skipped,
    /// The FMU lacks what it needs.
    Missing(String),
}

impl Replica {
    fn repeat(&mut self, traced: &TracedCall, component: &TracedComponent) -> Result<Repeated> {
        let function = traced.call.function.as_str();
        if function.contains("Instantiate") {
            self.instance = self.instantiate(traced)?;
            return Ok(Repeated::Called);
        }
        if function.ends_with("FreeInstance") {
            let is_instance = self.instance.take().is_some();
            return Ok(if is_instance { Repeated::Called } else { Repeated::Skipped });
        }
        if traced.within.is_some() {
            let observed = self.inner().observed.pop_front();
            let not_made = "it was not called, as the FMU has not updated its clocks".to_owned();
            let Some(observed) = observed else { return Ok(Repeated::Missing(not_made)) };
            *self.observer.observed() = observed;
            return Ok(Repeated::Called);
        }
        let call = match self.resolved(traced, component) {
            Ok(call) => call,
            Err(missing) => return Ok(Repeated::Missing(missing)),
        };
        let Some(instance) = &mut self.instance else { return Ok(Repeated::Skipped) };
        // What the function returned is known to the observer.
        let called = instance.repeat(&call, &mut self.states);
        match called {
            None => Ok(Repeated::Skipped),
            Some(Err(failure)) if failure.cause == fmu_host::Cause::Missing => {
                Ok(Repeated::Missing(failure.to_string()))
            }
            Some(_) => Ok(Repeated::Called),
        }
    }

    fn inner(&self) -> MutexGuard<'_, InnerCalls> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Prepares the calls that are made within the next one.
    fn prepare<'a>(
        &self,
        calls: impl Iterator<Item = &'a TracedCall>,
        component: &TracedComponent,
    ) {
        let resolved = calls.filter_map(|call| self.resolved(call, component).ok());
        let resolved = VecDeque::from_iter(resolved);
        if !resolved.is_empty() {
            *self.inner() = InnerCalls { waiting: resolved, observed: VecDeque::new() };
        }
    }

    /// A call with the value references of this FMU, or what it lacks.
    fn resolved(
        &self,
        traced: &TracedCall,
        component: &TracedComponent,
    ) -> std::result::Result<RepeatedCall, String> {
        let (mut call, function) = (traced.call.clone(), traced.call.function.as_str());
        for (name, references) in &mut call.given {
            if !matches!(name.as_str(), "references" | "unknowns" | "knowns" | "clock") {
                continue;
            }
            for reference in references {
                let Element::Integer(number) = reference else { continue };
                let Some(variable) = component.variable(function, *number as u32) else { continue };
                let new = self.fmu.reference(&variable.name, access(function));
                let missing =
                    || format!("{} has no such variable {}", self.fmu.file_name(), variable.name);
                *number = new.ok_or_else(missing)?.into();
            }
        }
        Ok(call)
    }

    fn instantiate(&mut self, traced: &TracedCall) -> Result<Option<Instance>> {
        let fmu = Arc::clone(&self.fmu);
        let binary = fmu.binary().context("it is a function")?;
        let folder = binary.folder.path();
        let library = match &self.library {
            Some(library) => Arc::clone(library),
            None => {
                let observer = self.observer.clone();
                let file = folder.join(&binary.file);
                Library::load_observed(&file, fmu.version, observer)?
            }
        };
        self.library = Some(Arc::clone(&library));
        let given = |name: &str| {
            let given = traced.call.given.iter().find(|(known, _)| known == name);
            given.and_then(|(_, elements)| elements.first())
        };
        let is = |name: &str| matches!(given(name), Some(Element::Integer(value)) if *value != 0);
        let name = match given("name") {
            Some(Element::Text(Some(name))) => name.as_str(),
            _ => "",
        };
        let resources = library.location(&folder.join("resources"));
        let arguments = Instantiation {
            name,
            interface_type: binary.interface_type,
            guid: &binary.token,
            resources: &resources,
            logging_on: is("logging_on"),
            event_mode_used: is("event_mode_used"),
            early_return_allowed: is("early_return_allowed"),
            limits: binary.limits,
            observer: Some(self.observer.clone()),
            ..Instantiation::default()
        };
        let observer = self.observer.clone();
        let mut instance =
            library.instantiate(&arguments, move |message| observer.log(&message))?;
        let (observer, inner) = (self.observer.clone(), self.inner.clone());
        if let Some(instance) = &mut instance {
            instance.on_clock_update(move |mode| {
                let mut inner = inner.lock().unwrap_or_else(PoisonError::into_inner);
                while let Some(call) = inner.waiting.pop_front() {
                    mode.repeat(&call);
                    inner.observed.push_back(std::mem::take(&mut *observer.observed()));
                }
            });
        }
        Ok(instance)
    }

    /// What the FMU did other than in the trace.
    fn difference(
        &self,
        traced: &TracedCall,
        component: &TracedComponent,
        tolerance: Tolerance,
    ) -> Option<String> {
        let observed = self.observer.observed();
        let message = observed.message.as_ref();
        let logged = message.map(|text| format!("; it logged {text:?}")).unwrap_or_default();
        let (now, then) = (observed.status.clone().unwrap_or_default(), traced.status.as_ref());
        let Some(then) = then else {
            let how = traced.ended.as_deref().unwrap_or("has ended");
            let now = shown(&now);
            return Some(format!("it returned {now}, in the trace the process {how}{logged}"));
        };
        if now != *then {
            return Some(format!(
                "it returned {}, in the trace {}{logged}",
                shown(&now),
                shown(then)
            ));
        }
        let names = Vec::from_iter(component.names(&traced.call));
        let mut texts = Vec::new();
        let mut compare = |name: &str, now: &Value, then: &Value| {
            if differs(now, then, tolerance) {
                texts.push(format!("{name} = {}, in the trace {}", shown(now), shown(then)));
            }
        };
        // A serialized state may have any bytes, and a state any address.
        let compared = traced.out.iter().filter(|(name, _)| *name != "bytes" && *name != "state");
        for (name, then) in compared {
            match (observed.out.get(name), then) {
                (Some(Value::Array(now)), Value::Array(then)) if now.len() == then.len() => {
                    let is_of_variables = then.len() == names.len();
                    for (index, (now, then)) in now.iter().zip(then).enumerate() {
                        match is_of_variables {
                            true => compare(&names[index], now, then),
                            false => compare(&format!("{name}[{}]", index + 1), now, then),
                        }
                    }
                }
                (now, then) => compare(name, now.unwrap_or(&Value::Null), then),
            }
        }
        (!texts.is_empty()).then(|| texts.join("; ") + &logged)
    }
}

fn differs(now: &Value, then: &Value, tolerance: Tolerance) -> bool {
    let (Some(x), Some(y)) = (number(now), number(then)) else { return now != then };
    let Tolerance { absolute, relative } = tolerance;
    let is_near = (x - y).abs() <= absolute + relative * y.abs();
    !is_near && x != y && !(x.is_nan() && y.is_nan())
}

/// The type of access in FMI 2.0; in FMI 3.0, all value references differ.
fn access(function: &str) -> Option<fmu_description::Type> {
    function.starts_with("fmi2").then(|| accessed_by(function))
}

/// A number, of which those that are not finite are strings.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) if number.is_f64() => number.as_f64(),
        Value::String(text) if matches!(text.as_str(), "NaN" | "inf" | "-inf") => text.parse().ok(),
        _ => None,
    }
}

/// A value in a sentence.
pub(crate) fn shown(value: &Value) -> String {
    match value {
        Value::String(text) if text.starts_with("fmi") => text.clone(),
        Value::Bool(true) => "an instance".to_owned(),
        Value::Bool(false) => "NULL".to_owned(),
        value => value.to_string(),
    }
}

/// Waits for a worker that repeats calls.
///
/// # Errors
/// The trace or the FMU cannot be used, or the system does not tell the state of the worker.
pub fn supervise(worker: &mut Worker, is_cancelled: &dyn Fn() -> bool) -> Result<ReplayEnd> {
    let (mut open, mut first) = (None, None);
    loop {
        match worker.poll()? {
            Some(Event::Replied) => match worker.reply()? {
                Report::Open(how) => open = Some(how),
                Report::First(difference) => first = Some(difference),
                Report::Done(replayed) => return Ok(ReplayEnd::Done(replayed)),
                Report::Failed(text) => bail!(text),
            },
            Some(Event::Ended(ended)) => {
                let place = worker.record().snapshot().stage;
                ensure!(!place.is_empty(), "the worker process {ended}, before the first call");
                let how = ended.to_string();
                return Ok(ReplayEnd::Crashed { place, how, in_trace: open, first });
            }
            None if is_cancelled() => {
                worker.kill()?;
                return Ok(ReplayEnd::Cancelled);
            }
            None => worker.pause(),
        }
    }
}
