//! A run of a plan in this process, which is a worker or, for Python, the process of the user.

use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use fmu_file::replace::Replacement;
use serde::{Deserialize, Serialize};

use crate::saved_run::SavedRun;
use crate::simulation::Finished;
use crate::step_control::AdaptiveSteps;
use crate::summary::{Summarizer, Summary};
use crate::{Message, Messages, Plan, Profile, Punctuality, Row, RunError, StartValue};

/// A run that has reached its end, or that an FMU has ended.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Completed {
    /// The messages of the FMUs.
    pub messages: Vec<Message>,
    /// The last row.
    pub last: Row,
    /// The summary of all rows.
    pub summary: Summary,
    /// The time that the simulation took, without loading and initializing the FMUs.
    pub duration: Duration,
    /// Where the time went, if that was measured.
    pub profile: Option<Profile>,
    /// Which FMU has ended the simulation before the stop time, when and why.
    pub ended: Option<String>,
    /// How well the run has kept the time, if it was paced by the clock.
    pub punctuality: Option<Punctuality>,
    /// Its adaptive steps, if it has taken such.
    pub adaptive_steps: Option<AdaptiveSteps>,
    /// Why its state was not saved, if it was to be.
    pub unsaved: Option<String>,
}

/// Runs a plan in this process. `observe` receives the rows, and returns false to end the run. The summary has all
/// communication points, also those between two rows.
///
/// # Errors
/// A call of an FMU has failed, or the run cannot begin.
pub fn simulate(
    plan: &Plan,
    starts: &[StartValue],
    messages: &Messages,
    mut observe: impl FnMut(&Row) -> bool,
) -> Result<Completed, Box<RunError>> {
    // Loading the binaries and initializing the FMUs do not count as simulating.
    let mut begin = Instant::now();
    let mut summarizer = Summarizer::new(plan);
    // Communication points until the next row, which the first one of a run is.
    let mut left = (plan.output_every - plan.first() % plan.output_every) % plan.output_every;
    let file = plan.save.as_ref().map(|(file, _)| Replacement::new(file)).transpose();
    let file = file.map_err(|error| RunError::new(error, Vec::new()))?;
    let finished = plan.simulate(starts, messages).and_then(|simulation| {
        begin = Instant::now();
        simulation.run(|row| {
            summarizer.add(row);
            if left > 0 {
                left -= 1;
                return true;
            }
            left = plan.output_every - 1;
            observe(row)
        })
    });
    let duration = begin.elapsed();
    let observed = messages.observers().finish();
    match finished.and_then(|finished| Ok((finished, observed?))) {
        Ok((Finished { messages, last, ended, punctuality, adaptive_steps, state }, profile)) => {
            // The row of a run that an FMU has ended between two rows.
            if ended.is_some() && left + 1 < plan.output_every {
                observe(&last);
            }
            let ended = ended.and_then(|ended| ended.early_end());
            let summary = summarizer.summarize();
            let unsaved = match (file, state) {
                (Some(file), Some(state)) => {
                    save(file, &state).err().map(|error| format!("{error:#}"))
                }
                (Some(_), None) => {
                    Some("the state was not saved, as the run has ended early".to_owned())
                }
                (None, _) => None,
            };
            Ok(Completed {
                messages,
                last,
                summary,
                duration,
                profile,
                ended,
                punctuality,
                adaptive_steps,
                unsaved,
            })
        }
        Err(error) => Err(RunError::new(error, messages.take())),
    }
}

fn save(mut file: Replacement, state: &SavedRun) -> Result<()> {
    file.write_all(&state.encode()?).context("the state was not saved")?;
    file.finish()
}
