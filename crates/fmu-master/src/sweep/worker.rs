//! Worker side of a sweep: simulates runs and makes their rows.

use anyhow::{Context, Result};
use fmu_worker::{Record, Service};
use serde::{Deserialize, Serialize};

use super::file::SweepSource;
use super::metrics::MetricsAccumulator;
use super::pool::WorkerReply;
use super::row::RunRow;
use super::study::Study;
use crate::run::compute_in_supervisor;
use crate::{Messages, RunError, Simulation};

/// A task of a worker.
#[derive(Clone, Copy, Serialize, Deserialize)]
pub(super) enum SweepTask {
    /// To initialize a run without simulating it.
    Try(u64),
    /// To simulate a run.
    Simulate(u64),
}

/// Does the tasks of the supervisor, which computes the outputs of functions.
///
/// # Errors
/// The files of the sweep have changed, or a task is damaged.
pub fn serve(service: &mut Service, source: &SweepSource) -> Result<()> {
    let compute = compute_in_supervisor(service, WorkerReply::<SweepReply>::Call)?;
    Study::open_with(source, &compute)?.serve(service)
}

/// The reply of a worker: the row of a run unless it was only tried, or why it cannot be started.
pub(super) type SweepReply = Result<Option<RunRow>, String>;

impl Study {
    /// Does the tasks of the supervisor, until an FMU must not be called again.
    ///
    /// # Errors
    /// A task is damaged.
    fn serve(&self, service: &mut Service) -> Result<()> {
        while let Some(task) = service.task()? {
            let record = service.record();
            let reply = match task {
                SweepTask::Try(index) => match self.initialize(index, record) {
                    Err(error) if error.downcast_ref::<RunError>().is_none() => Err(error),
                    _ => Ok(None),
                },
                SweepTask::Simulate(index) => self.simulate(index, record).map(Some),
            };
            let is_lost = self.plan.components.iter().any(|component| component.fmu.is_lost());
            let reply: SweepReply = reply.map_err(|error| format!("{error:#}"));
            service.reply(&WorkerReply::Done { reply, is_lost });
            if is_lost {
                break;
            }
        }
        Ok(())
    }

    fn initialize(&self, index: u64, record: &Record) -> Result<Simulation<'_>> {
        let messages = Messages::of_problems(record.clone());
        let starts = self.starts(index);
        let simulation = starts.and_then(|starts| self.plan.simulate(&starts, &messages));
        simulation.with_context(|| format!("run {index}"))
    }

    /// Simulates a run. One that an FMU ends early counts as diverged.
    fn simulate(&self, index: u64, record: &Record) -> Result<RunRow> {
        let simulation = match self.initialize(index, record) {
            Ok(simulation) => simulation,
            // An FMU may refuse some of the values.
            Err(error) => return self.row_without_samples(index, &error.downcast()?),
        };
        let mut metrics = MetricsAccumulator::new(&self.criteria);
        let (signals, gathered) = (self.signals, &mut metrics);
        let ended = simulation.run(move |row| gathered.push(signals.sample(row)));
        // A run that an FMU has ended cannot be compared with others either.
        let error = match ended {
            Ok(finished) => finished.ended,
            Err(error) => Some(error.downcast::<RunError>()?),
        };
        if let Some(error) = &error {
            metrics.diverge(error.time.unwrap_or(self.plan.times().start));
        }
        RunRow::new(index, &self.parameters, &metrics.finish(), error.as_ref())
    }
}
