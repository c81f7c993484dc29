//! Worker side of a run: makes the plan, runs it, and reports the rows and the end to the supervisor.

use std::borrow::{Borrow, Cow};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;
use fmu_description::Value;
use fmu_worker::Service;
use serde::Serialize;

use super::completed::simulate;
use super::report::{Ready, Report};
use crate::function::{Computed, FunctionCall};
use crate::{Messages, Observation, Plan, Row, RunError, StartValue, curve};

/// Does a run, and reports it to the supervisor. `plan` makes the plan and its start values, and may warn; the rows
/// are only sent if the run `records` them, and its calls are observed as `observation` says.
///
/// # Errors
/// The supervisor has sent something else than the permission to begin.
pub fn serve<P: Borrow<Plan>>(
    service: &mut Service,
    (records, observation): (bool, &Observation),
    plan: impl FnOnce(&mut dyn FnMut(&str)) -> Result<(P, Vec<StartValue>)>,
) -> Result<()> {
    let messages = Messages::recorded(service.record().clone());
    let planned = plan(&mut |text| service.reply(&Report::Warning(text.into())));
    let planned = planned.and_then(|(plan, starts)| {
        let messages = observation.begin(messages, &plan.borrow().components)?;
        Ok((plan, starts, messages))
    });
    let (plan, starts, messages) = match planned {
        Ok(planned) => planned,
        Err(error) => {
            service.reply(&Report::Failed(RunError::new(error, Vec::new())));
            return Ok(());
        }
    };
    let plan = plan.borrow();
    service.reply(&Report::Ready(Ready {
        components: plan.names(),
        is_paced: plan.execution.real_time.is_some(),
        experiment: plan.times(),
        columns: plan.columns.clone(),
        curves: curve::of_plan(plan),
        notes: plan.notes(&starts),
    }));
    // The file for the rows can be written.
    let Some(()) = service.task()? else { return Ok(()) };
    let completed = simulate(plan, &starts, &messages, |row| {
        if records {
            send_row(service, row);
        }
        true
    });
    service.reply(&completed.map(Box::new).map_or_else(Report::Failed, Report::Completed));
    // The binaries are unloaded when the plan is dropped, which no longer matters to the run.
    Ok(())
}

/// Sends a row. Not inlined, so that runs that record nothing skip it cheaply.
#[inline(never)]
fn send_row(service: &mut Service, row: &Row) {
    service.reply(&Report::Row(Cow::Borrowed(row)));
}

/// A closure that lets the supervisor of this process compute the outputs of a function, by its number; see
/// [`Function`](crate::Function). `report` makes what the supervisor receives.
///
/// # Errors
/// The memory that is shared with the supervisor cannot be opened.
pub fn compute_in_supervisor<R: Serialize>(
    service: &Service,
    report: impl Fn(FunctionCall) -> R + Clone + Send + Sync + 'static,
) -> Result<impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static> {
    let service = Arc::new(Mutex::new(service.another()?));
    Ok(move |function: usize, time: f64, inputs: &[Value]| {
        let mut service = service.lock().unwrap_or_else(PoisonError::into_inner);
        // Unlike a call of an FMU, a call of the supervisor has no time limit.
        service.record().end_call();
        service.reply(&report(FunctionCall { function, time, inputs: inputs.to_vec() }));
        match service.task() {
            Ok(Some(computed)) => computed,
            Ok(None) => Err("the run was ended".to_owned()),
            Err(error) => Err(error.to_string()),
        }
    })
}
