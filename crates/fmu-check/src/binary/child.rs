//! The child process, which runs one test of a binary.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use fmu_description::xml;
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_host::{Cause, Failure, Library, Status};

use super::excitation::{Level, inputs};
use super::record::names;
use super::report::Report;
use super::subject::Subject;
use super::tests::{self, Test};

// These folders are next to each other.

/// The folder of the unpacked FMU.
pub const FMU: &str = "fmu";
/// The folder of the reports.
pub const REPORT: &str = "report";
/// The working directory of the child process.
pub const WORK: &str = "work";
/// A file in [`REPORT`]: names of variables that are not observed.
pub const IGNORED: &str = "ignored";

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

/// The arguments of the child process.
#[derive(Debug, Clone)]
pub struct Options {
    /// The test.
    pub test: &'static Test,
    /// The interface type.
    pub kind: Kind,
    /// The binary, relative to the folder of the unpacked FMU.
    pub binary: String,
    /// How strongly inputs are excited.
    pub level: Level,
    /// Number of steps of a short run.
    pub steps: usize,
    /// Time limit in seconds.
    pub seconds: u64,
    /// Whether the FMU logs more than problems.
    pub logging: bool,
    /// Whether wrong calls crash it.
    pub is_fragile: bool,
}

impl Options {
    /// The arguments.
    pub fn arguments(&self) -> [String; 8] {
        [
            self.test.name.into(),
            self.kind.name().into(),
            self.binary.clone(),
            self.level.name().into(),
            self.steps.to_string(),
            self.seconds.to_string(),
            self.logging.to_string(),
            self.is_fragile.to_string(),
        ]
    }

    fn parse(arguments: &[OsString]) -> Option<Self> {
        let [
            test,
            kind,
            binary,
            level,
            steps,
            seconds,
            logging,
            is_fragile,
        ] = arguments
        else {
            return None;
        };
        let (test, kind) = (test.to_str()?, kind.to_str()?);
        Some(Self {
            test: tests::find(test)?,
            kind: Kind::ALL.into_iter().find(|known| known.name() == kind)?,
            binary: binary.to_str()?.to_owned(),
            level: level.to_str()?.parse().ok()?,
            steps: steps.to_str()?.parse().ok()?,
            seconds: seconds.to_str()?.parse().ok()?,
            logging: logging.to_str()?.parse().ok()?,
            is_fragile: is_fragile.to_str()?.parse().ok()?,
        })
    }
}

/// Runs one test of a binary in this process, which [`crate::Probes`] has started.
///
/// # Errors
/// The arguments do not describe a test, or the unpacked FMU cannot be read.
pub fn run(arguments: &[OsString]) -> Result<()> {
    let options = Options::parse(arguments)
        .context("expected TEST KIND BINARY LEVEL STEPS SECONDS LOGGING FRAGILE of a check")?;
    end_after(Duration::from_secs(options.seconds.saturating_add(5)));
    let here = std::env::current_dir()?;
    let beside = |name: &str| here.with_file_name(name);
    let folder = beside(FMU);
    let text = std::fs::read_to_string(beside(REPORT).join(MODEL_DESCRIPTION))?;
    let root = xml::parse(&text)?;
    let model = ModelDescription::new(&root);
    let report = Arc::new(Report::open(&beside(REPORT), model.version)?);
    if let Err(error) = test(&options, &model, &folder, &report) {
        // The folder no longer exists when the message is read.
        let text = format!("{error:#}").replace(&format!("{}/", folder.display()), "");
        report.find(options.test.rule, report.explained(&text));
    }
    report.end();
    Ok(())
}

/// Whether an error is a refusal of the FMU: it returned fmi2Error or fmi2Discard.
pub fn is_refusal(error: &anyhow::Error) -> bool {
    error.downcast_ref::<Failure>().is_some_and(|failure| {
        matches!(
            failure.cause,
            Cause::Returned(Status::Error | Status::Discard | Status::Fatal)
        )
    })
}

/// Aborts this process after a while, or when its parent is gone, which cannot kill it then.
fn end_after(limit: Duration) {
    let (begin, parent) = (Instant::now(), parent());
    std::thread::spawn(move || {
        while begin.elapsed() < limit && self::parent() == parent {
            std::thread::sleep(Duration::from_millis(200));
        }
        std::process::abort();
    });
}

/// The number of the process that has started this one, where the system tells.
fn parent() -> Option<u32> {
    #[cfg(unix)]
    return Some(std::os::unix::process::parent_id());
    #[cfg(not(unix))]
    None
}

fn test(
    options: &Options,
    model: &ModelDescription<'_>,
    folder: &Path,
    report: &Arc<Report>,
) -> Result<()> {
    let trace = Arc::clone(report);
    let binary: PathBuf = folder.join(&options.binary);
    let library = Library::load_traced(&binary, move |name| trace.call(name))?;
    let element = model
        .root
        .child(options.kind.element())
        .context("it is not of this kind")?;
    let ignored = names(&folder.with_file_name(REPORT).join(IGNORED));
    let subject = Subject {
        model,
        library: &library,
        kind: options.kind.of_host(),
        element,
        resources: match model.version {
            FmiVersion::Fmi2 => fmu_host::uri(&folder.join("resources")),
            FmiVersion::Fmi3 => fmu_host::resource_path(&folder.join("resources")),
        },
        report,
        level: options.level,
        steps: options.steps,
        logging: options.logging,
        is_fragile: options.is_fragile,
        time_limit: Duration::from_secs(options.seconds),
        observed: Subject::observed_of(model, &ignored),
        ignored,
        inputs: inputs(model),
        logged: Arc::default(),
    };
    (options.test.run)(&subject)
}
