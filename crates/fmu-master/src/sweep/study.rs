//! A study: a sweep file applied to its system. Worker processes and the supervisor open the same study; the worker
//! processes simulate its runs (`worker.rs`), and the supervisor hands them out (`supervisor.rs`).

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use fmu_description::Value;
use fmu_description::hash::checksum;

use super::file::{SweepFile, SweepSource};
use super::metrics::{Criteria, Metrics};
use super::parameters::Parameters;
use super::row::{self, RunRow};
use super::signals::SignalPlaces;
use crate::function::Computed;
use crate::table::Column;
use crate::{Description, Literal, Plan, RunError, StartValue, SystemOrigin, locate};

/// A sweep that is ready to run.
pub struct Study {
    /// The sweep file.
    pub(super) sweep: PathBuf,
    pub(super) plan: Plan,
    /// The files that it depends on, and their places for a worker elsewhere.
    pub(super) files: Vec<(PathBuf, PathBuf)>,
    pub(super) input: Option<PathBuf>,
    /// Unpacked packages, from which a worker elsewhere gets the FMUs.
    _package: Option<Arc<SystemOrigin>>,
    pub(super) parameters: Parameters,
    /// The index of the run, its parameters and metrics, and why it failed.
    pub(super) columns: Vec<Column>,
    pub(super) fingerprint: String,
    /// Start values of all runs.
    set: Vec<StartValue>,
    pub(super) signals: SignalPlaces,
    pub(super) criteria: Criteria,
    /// Whether the system has functions, of which nobody knows whether they are those of an earlier sweep.
    pub(super) has_functions: bool,
}

impl Study {
    /// Reads a sweep and loads the FMUs of its system, in the supervisor, which simulates no run.
    ///
    /// # Errors
    /// A file cannot be read, or its contents do not fit.
    pub fn open(source: &SweepSource) -> Result<Self> {
        let never = |_: usize, _: f64, _: &[Value]| Err(String::new());
        Self::open_with(source, &never)
    }

    /// As [`Self::open`]; `compute` computes the outputs of a function, by its number, at a time (s).
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(super) fn open_with(
        source: &SweepSource,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
    ) -> Result<Self> {
        let (file, text) = SweepFile::read(source)?;
        Self::load(source, &text, file, compute).map_err(|error| match &source.text {
            None => locate(error, &source.file, &text),
            Some(_) => error.context(source.name().display().to_string()),
        })
    }

    fn load(
        source: &SweepSource,
        text: &str,
        file: SweepFile,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
    ) -> Result<Self> {
        let beside = || source.file.with_file_name("").join(&file.system);
        let system = source.system.clone().unwrap_or_else(beside);
        let mut description = match &source.system_text {
            Some(text) => Description::parse_unsaved(text, &system).context("system")?,
            None => Description::open(&system)?,
        };
        file.overrides(&source.overrides).apply(&mut description)?;
        let state = file.load_state.as_ref();
        description.load_state = state.map(|state| source.file.with_file_name("").join(state));
        description.set_functions(&source.functions, compute)?;
        let mut files = files(&system, &description);
        files.extend(file.load_state.clone().zip(description.load_state.clone()));
        let system_text = source.system_text.as_deref();
        let fingerprint = fingerprint(text, system_text, files.iter().map(|(_, file)| &**file))?;
        let plan = Plan::new(&description)?;
        let parameters = Parameters::new(file.seed, file.draws, file.parameter)?;
        let signals = file.signals.places(&plan)?;
        let set = file.set.iter().map(|(name, literal)| plan.start(name, literal));
        let study = Self {
            set: set.collect::<Result<_>>()?,
            columns: row::columns(&parameters),
            criteria: file.metrics,
            has_functions: !source.functions.is_empty(),
            sweep: source.name(),
            signals,
            plan,
            files,
            input: description.input.as_deref().map(name),
            _package: description.package,
            parameters,
            fingerprint,
        };
        for index in study.parameters.corners() {
            study.starts(index)?;
        }
        Ok(study)
    }

    /// The row of a run without samples, because an FMU has refused it or ended its process.
    pub(super) fn row_without_samples(&self, index: u64, error: &RunError) -> Result<RunRow> {
        let metrics = Metrics::unknown(error.time.unwrap_or(self.plan.times().start));
        RunRow::new(index, &self.parameters, &metrics, Some(error))
    }

    /// The start values of a run.
    ///
    /// # Errors
    /// The value of a parameter does not fit its variable.
    pub(super) fn starts(&self, index: u64) -> Result<Vec<StartValue>> {
        let mut starts = self.set.clone();
        for (name, value) in self.parameters.run(index)? {
            starts.push(self.plan.start(name, &Literal::from(&value))?);
        }
        Ok(starts)
    }
}

/// The name of a file.
fn name(file: &Path) -> PathBuf {
    file.file_name().unwrap_or_default().into()
}

/// All files that a system reads, its own first. Their places in a single folder are their names, except that
/// structures of SSP refer to other files by their paths.
fn files(system: &Path, description: &Description) -> Vec<(PathBuf, PathBuf)> {
    let folder = system.parent().unwrap_or(Path::new(""));
    let parts = description.package.iter().flat_map(|package| &package.files);
    let parts = parts.map(|file| (file.strip_prefix(folder).unwrap_or(file).into(), file));
    let components = description.components.iter().filter(|part| part.function.is_none());
    let fmus = components.map(|component| &component.fmu);
    let named = fmus.chain(&description.input).map(|file| (name(file), file));
    let own = Path::new("system").with_extension(system.extension().unwrap_or_default());
    let others = named.chain(parts).map(|(place, file)| (place, file.clone()));
    [(own, system.to_owned())].into_iter().chain(others).collect()
}

/// A digest of everything that the rows depend on: the sweep, and the files of the system.
fn fingerprint<'a>(
    sweep: &str,
    system: Option<&str>,
    files: impl Iterator<Item = &'a Path>,
) -> Result<String> {
    let mut content = checksum(sweep.as_bytes()).to_le_bytes().to_vec();
    content.extend(system.iter().flat_map(|text| checksum(text.as_bytes()).to_le_bytes()));
    // The file of the system is the first.
    for file in files.skip(system.is_some().into()) {
        let bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        content.extend_from_slice(&checksum(&bytes).to_le_bytes());
    }
    Ok(format!("{:032x}", checksum(&content)))
}
