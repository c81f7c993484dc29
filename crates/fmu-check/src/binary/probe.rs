//! The tests of a binary, which run in the child process.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use fmu_description::value::{boolean, integer, real};
use fmu_description::xml;
use fmu_description::{Capability, Causality, Initial, ModelDescription};
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_file::text::quote;
use fmu_host::{self, Library};

use super::report::Report;
use super::run::{Run, Subject, Value, get};

/// A test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Probe {
    /// The binary loads, exports its functions and creates an instance.
    Identity,
    /// It rejects the GUID of another FMU.
    Guid,
    /// Its start values are those of the XML.
    Start,
    /// It can be simulated and reset.
    Simulation,
    /// It can save and restore its state, if it declares that.
    State,
    /// It provides derivatives, if it declares them.
    Derivatives,
    /// Two instances do not affect each other, unless only one is allowed.
    Instances,
}

impl Probe {
    /// All tests, in the order in which they run.
    pub const ALL: [Self; 7] = [
        Self::Identity,
        Self::Guid,
        Self::Start,
        Self::Simulation,
        Self::State,
        Self::Derivatives,
        Self::Instances,
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Identity => "identity",
            Self::Guid => "guid",
            Self::Start => "start",
            Self::Simulation => "simulation",
            Self::State => "state",
            Self::Derivatives => "derivatives",
            Self::Instances => "instances",
        }
    }

    /// Whether later tests only make sense if this one passes.
    pub fn is_basic(self) -> bool {
        matches!(self, Self::Identity | Self::Simulation)
    }
}

/// The interface type under test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Co-simulation.
    Cs,
    /// Model exchange.
    Me,
}

impl Kind {
    /// Both interface types.
    pub const ALL: [Self; 2] = [Self::Cs, Self::Me];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cs => "cs",
            Self::Me => "me",
        }
    }

    /// Its element in the model description.
    pub fn element(self) -> &'static str {
        match self {
            Self::Cs => "CoSimulation",
            Self::Me => "ModelExchange",
        }
    }

    fn of_host(self) -> fmu_host::Kind {
        match self {
            Self::Cs => fmu_host::Kind::CoSimulation,
            Self::Me => fmu_host::Kind::ModelExchange,
        }
    }
}

/// The arguments of the child process, which runs in the folder of the unpacked FMU.
struct Options {
    probe: Probe,
    kind: Kind,
    binary: PathBuf,
    time_limit: u64,
}

impl Options {
    fn parse(arguments: &[OsString]) -> Option<Self> {
        let [probe, kind, binary, time_limit] = arguments else {
            return None;
        };
        let (probe, kind) = (probe.to_str()?, kind.to_str()?);
        Some(Self {
            probe: Probe::ALL.into_iter().find(|p| p.name() == probe)?,
            kind: Kind::ALL.into_iter().find(|k| k.name() == kind)?,
            binary: binary.into(),
            time_limit: time_limit.to_str()?.parse().ok()?,
        })
    }
}

/// Runs one test of a binary in this process, which [`crate::Probes`] has started.
///
/// # Errors
/// The arguments do not describe a test, or the unpacked FMU cannot be read.
pub fn run(arguments: &[OsString]) -> Result<()> {
    let options =
        &Options::parse(arguments).context("expected PROBE KIND BINARY SECONDS of a check")?;
    end_after(Duration::from_secs(options.time_limit.saturating_add(5)));
    let text = xml::decode(&std::fs::read(MODEL_DESCRIPTION)?).text;
    let root = xml::parse(&text)?;
    let model = ModelDescription::new(&root);
    let report = Arc::new(Report::open(Path::new("log"))?);
    let here = std::env::current_dir()?;
    if let Err(error) = test(options, &model, &here, &report) {
        // The folder no longer exists when the message is read.
        let folder = format!("{}/", here.display());
        report.error(&format!("{error:#}").replace(&folder, ""));
    }
    report.end();
    Ok(())
}

/// Aborts this process after a while, in case the parent was killed and cannot do it.
fn end_after(limit: Duration) {
    std::thread::spawn(move || {
        std::thread::sleep(limit);
        std::process::abort();
    });
}

fn test(
    options: &Options,
    model: &ModelDescription<'_>,
    here: &Path,
    report: &Arc<Report>,
) -> Result<()> {
    let trace = Arc::clone(report);
    let binary = here.join(&options.binary);
    let library = Library::load_traced(&binary, move |name| trace.call(name))?;
    let element = model
        .root
        .child(options.kind.element())
        .context("it is not of this kind")?;
    let subject = Subject {
        model,
        library: &library,
        kind: options.kind.of_host(),
        element,
        resources: fmu_host::uri(&here.join("resources")),
    };
    match options.probe {
        Probe::Identity => identity(&subject, report),
        Probe::Guid => guid(&subject, report),
        Probe::Start => start(&subject, report),
        Probe::Simulation => simulation(&subject, report),
        Probe::State => state(&subject),
        Probe::Derivatives => derivatives(&subject),
        Probe::Instances => instances(&subject),
    }
}

fn identity(subject: &Subject<'_>, report: &Report) -> Result<()> {
    let missing = subject.library.missing(subject.kind);
    for name in &missing {
        report.error(&format!(
            "the function {name} is missing, expected it in the library"
        ));
    }
    if !missing.is_empty() {
        return Ok(());
    }
    let version = subject.library.version()?;
    if version != "2.0" {
        report.error(&format!(
            "fmi2GetVersion gave {}, expected \"2.0\"",
            quote(&version)
        ));
    }
    let platform = subject.library.types_platform()?;
    if platform != "default" {
        report.error(&format!(
            "fmi2GetTypesPlatform gave {}, expected \"default\"",
            quote(&platform)
        ));
    }
    subject.instantiate()?;
    Ok(())
}

fn guid(subject: &Subject<'_>, report: &Report) -> Result<()> {
    let wrong = "{00000000-0000-0000-0000-000000000000}";
    if subject.try_instantiate(wrong)?.is_some() {
        report.warning(
            "fmi2Instantiate accepted the GUID of another FMU, expected NULL: a mismatch of XML and binary would go unnoticed",
        );
    }
    Ok(())
}

/// Compares the start values of the XML with those of the binary in initialization mode.
fn start(subject: &Subject<'_>, report: &Report) -> Result<()> {
    let mut instance = subject.instantiate()?;
    subject.enter_initialization(&mut instance)?;
    for (_, variable) in subject.model.variables() {
        let exact =
            variable.initial == Some(Initial::Exact) || variable.causality == Causality::Input;
        let Some(expected) = variable.start().filter(|_| exact) else {
            continue;
        };
        match get(&mut instance, variable) {
            Ok(value) if !is_start(&value, expected) => report.error(&format!(
                "the start value of {} is {value} in the binary, expected {} as in the XML",
                quote(variable.name),
                quote(expected)
            )),
            Err(error) => report.error(&format!("{error:#}")),
            Ok(_) => {}
        }
    }
    Ok(())
}

/// Whether a value equals a start value, apart from digits lost when a tool wrote the XML.
fn is_start(value: &Value, start: &str) -> bool {
    match value {
        Value::Real(value) => real(start).is_none_or(|start| {
            start == *value
                || (start.is_nan() && value.is_nan())
                || (start - value).abs() <= 1e-12 * start.abs()
        }),
        Value::Integer(value) => integer(start).is_none_or(|start| start == *value),
        Value::Boolean(value) => boolean(start).is_none_or(|start| i32::from(start) == *value),
        Value::String(value) => start == value,
    }
}

/// Takes some steps, terminates, resets, and takes the first step again.
fn simulation(subject: &Subject<'_>, report: &Report) -> Result<()> {
    let step = subject.step();
    let mut run = Run::begin(subject)?;
    run.advance(step)?;
    let first = run.observe()?;
    if subject.claims(Capability::CanHandleVariableCommunicationStepSize) {
        for other in [step / 2.0, step / 4.0, step] {
            run.advance(other).context(
                "canHandleVariableCommunicationStepSize is true, but with another step size",
            )?;
        }
    }
    for (name, value) in run.observe()? {
        match value {
            Value::Real(value) if !value.is_finite() => report.warning(&format!(
                "{} is {value} after a few steps, expected a finite number",
                quote(name)
            )),
            Value::Boolean(number) if number != 0 && number != 1 => {
                report.error(&format!("{} is {value}, expected 0 or 1", quote(name)));
            }
            _ => {}
        }
    }
    run.instance.terminate()?;
    run.instance.reset()?;
    run.initialize().context("after fmi2Reset")?;
    run.advance(step).context("after fmi2Reset")?;
    if let Some(text) = difference(&run.observe()?, &first) {
        report.warning(&format!("after fmi2Reset, {text} as in a new instance"));
    }
    run.instance.terminate()?;
    Ok(())
}

/// Describes the first value that differs from the expected one.
fn difference(values: &[(&str, Value)], expected: &[(&str, Value)]) -> Option<String> {
    let ((name, value), (_, expected)) = values.iter().zip(expected).find(|(a, b)| a.1 != b.1)?;
    Some(format!("{} is {value}, expected {expected}", quote(name)))
}

fn state(subject: &Subject<'_>) -> Result<()> {
    if !subject.claims(Capability::CanGetAndSetFMUstate) {
        return Ok(());
    }
    let mut run = Run::begin(subject)?;
    save_and_restore(&mut run, subject, false).context("canGetAndSetFMUstate is true, but")?;
    if subject.claims(Capability::CanSerializeFMUstate) {
        save_and_restore(&mut run, subject, true).context("canSerializeFMUstate is true, but")?;
    }
    Ok(())
}

/// Takes a step from a state, restores the state, and takes the step again.
fn save_and_restore(run: &mut Run<'_>, subject: &Subject<'_>, as_bytes: bool) -> Result<()> {
    const MAX_BYTES: usize = 1 << 30;
    let step = subject.step();
    let time = run.time;
    let mut saved = run.instance.state()?;
    run.advance(step)?;
    let expected = run.observe()?;
    if as_bytes {
        let bytes = run.instance.serialize(&saved, MAX_BYTES)?;
        run.instance.free_state(saved)?;
        saved = run.instance.deserialize(&bytes)?;
    }
    run.instance.set_state(&saved)?;
    run.time = time;
    run.advance(step)?;
    let difference = difference(&run.observe()?, &expected);
    run.instance.free_state(saved)?;
    ensure!(
        difference.is_none(),
        "after a step from the restored state, {} as before",
        difference.unwrap_or_default()
    );
    Ok(())
}

fn derivatives(subject: &Subject<'_>) -> Result<()> {
    let inputs = subject.reals(Causality::Input);
    let outputs = subject.reals(Causality::Output);
    let mut run = Run::begin(subject)?;
    run.advance(subject.step())?;
    if subject.claims(Capability::ProvidesDirectionalDerivative) {
        for input in &inputs {
            let values = run
                .instance
                .directional_derivative(&outputs, &[*input], &[1.0]);
            let values = values.context("providesDirectionalDerivative is true, but")?;
            ensure!(
                values.iter().all(|value| value.is_finite()),
                "fmi2GetDirectionalDerivative gave numbers that are not finite, expected finite ones"
            );
        }
    }
    if subject.claims(Capability::CanInterpolateInputs) && !inputs.is_empty() {
        let zeros = vec![0.0; inputs.len()];
        run.instance
            .set_input_derivatives(&inputs, &zeros)
            .context("canInterpolateInputs is true, but")?;
    }
    let order = subject
        .element
        .attribute("maxOutputDerivativeOrder")
        .and_then(integer);
    if order.is_some_and(|order| order > 0) && !outputs.is_empty() {
        run.instance
            .output_derivatives(&outputs)
            .context("maxOutputDerivativeOrder is not 0, but")?;
    }
    Ok(())
}

/// Runs an instance alone, and again next to a second instance with other inputs.
fn instances(subject: &Subject<'_>) -> Result<()> {
    const ONLY_ONCE: Capability = Capability::CanBeInstantiatedOnlyOncePerProcess;
    const FLAG: &str = ONLY_ONCE.as_str();
    if subject.claims(ONLY_ONCE) {
        return Ok(());
    }
    let step = subject.step();
    let mut alone = Run::begin(subject)?;
    alone.advance(step)?;
    alone.advance(step)?;
    let expected = alone.observe()?;
    drop(alone);
    let beside = || -> Result<_> {
        let mut one = Run::begin(subject)?;
        let mut other = Run::begin(subject)?;
        for reference in subject.reals(Causality::Input) {
            let mut value = [0.0];
            other.instance.get_real(&[reference], &mut value)?;
            // An input may have bounds; the other instance then keeps its value.
            let _ = other.instance.set_real(&[reference], &[value[0] + 1.0]);
        }
        for _ in 0..2 {
            other.advance(step)?;
            one.advance(step)?;
        }
        one.observe()
    };
    let values =
        beside().with_context(|| format!("{FLAG} is false, but with a second instance"))?;
    let difference = difference(&values, &expected);
    ensure!(
        difference.is_none(),
        "{FLAG} is false, but with a second instance, {} as alone",
        difference.unwrap_or_default()
    );
    Ok(())
}
