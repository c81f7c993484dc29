//! Runs of the experiments of an FMU, in worker processes, whose results are compared with its reference results.

use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use fmu_check::ReferenceRun;
use fmu_master::job::{Job, SystemSource};
use fmu_master::table::{self, Tolerance};
use fmu_master::{Overrides, Sandbox};
use fmu_worker::Limits;

use super::super::simulate::run_to_file;
use crate::session::Session;

/// The relative tolerance of an experiment that has none.
const RELATIVE: f64 = 1e-3;
/// The absolute tolerance, as a part of the relative one.
const ABSOLUTE: f64 = 1e-6;

/// Performs a run, and returns the first difference of each variable.
///
/// # Errors
/// The run fails, or the results cannot be compared.
pub fn perform(
    fmu: &Path,
    run: &ReferenceRun<'_>,
    (call, total): (Duration, Duration),
    is_sandboxed: bool,
    session: &Session,
) -> Result<Vec<String>> {
    let [expected, found] = ["expected.csv", "found.csv"].map(|file| session.folder().join(file));
    fs::write(&expected, run.results)?;
    let reference = table::read(&expected).context("the reference results")?;
    ensure!(reference.len() > 1, "the reference results have no variables");
    let overrides = Overrides {
        experiment: run.experiment.map(str::to_owned),
        outputs: reference[1..].iter().map(|series| series.name.clone()).collect(),
        sandbox: Sandbox { is_required: is_sandboxed, ..Sandbox::default() },
        ..Overrides::default()
    };
    let system = SystemSource { file: fmu.to_owned(), overrides, ..SystemSource::default() };
    let limits = Limits { call: Some(call), task: Some(total), ..Limits::default() };
    run_to_file(&Job::Run { system, records: true }, limits, true, &found, session)?;
    let results = table::read(&found).context("the results")?;
    let relative = run.tolerance.unwrap_or(RELATIVE);
    let tolerance = Tolerance { absolute: ABSOLUTE * relative, relative };
    let differences = table::compare([&reference, &results], tolerance, |_| false)?;
    let names = ["the reference".to_owned(), "the run".to_owned()];
    Ok(differences.iter().map(|difference| difference.describe(&names)).collect())
}
