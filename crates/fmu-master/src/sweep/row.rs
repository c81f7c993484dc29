//! The row that a sweep records of a run, and the columns of its table.
//!
//! | columns | from |
//! |---|---|
//! | `index` | the number of the run |
//! | one for each variable | [`Parameters`] |
//! | the metrics | [`Metrics`], whose fields are the columns |
//! | `failure` | why the run failed, if it did |
//!
//! A worker process makes the row of a run (`worker.rs`), and sends it as a line of CSV. The supervisor appends the
//! line to the journal (`supervisor.rs`, `journal.rs`). When all runs are done, it writes the rows as a table, and looks
//! for failures and the best run (`progress.rs`).

use anyhow::Result;
use fmu_description::{Type, Value};
use serde::{Deserialize, Serialize};

use super::metrics::Metrics;
use super::parameters::Parameters;
use crate::RunError;
use crate::table::{self, Column};

pub(super) const INDEX: &str = "index";
pub(super) const FAILURE: &str = "failure";

/// The columns of the table of a sweep.
pub(super) fn columns(parameters: &Parameters) -> Vec<Column> {
    let index = [Column::new(INDEX, "", Type::Int64)].into_iter();
    let columns = index.chain(parameters.columns()).chain(Metrics::columns());
    columns.chain([Column::new(FAILURE, "", Type::String).optional()]).collect()
}

/// The row of a finished run.
#[derive(Serialize, Deserialize)]
pub(super) struct RunRow {
    /// The row as a line of CSV, with its line feed.
    pub(super) line: String,
    /// Why the run failed, with the words of the FMU, which are not in the line as they may differ from run to run.
    pub(super) failure: Option<String>,
}

impl RunRow {
    /// The row of the run with an index.
    ///
    /// # Errors
    /// There is no such run.
    pub(super) fn new(
        index: u64,
        parameters: &Parameters,
        metrics: &Metrics,
        error: Option<&RunError>,
    ) -> Result<Self> {
        let failure = error.map(|error| match error.is_of_function() {
            // What a function says is the same in every run of the same sweep.
            true => error.to_string(),
            false => error.event(),
        });
        let failure = failure.map(|text| text.replace(char::is_control, " "));
        let values = parameters.run(index)?.into_iter().map(|(_, value)| Some(value));
        let cells = [Some(Value::UInt64(index))].into_iter().chain(values).chain(metrics.cells());
        let mut line = String::new();
        table::push_line(&mut line, cells.chain([failure.map(Value::String)]));
        Ok(Self { line, failure: error.map(RunError::to_string) })
    }
}
