use std::cell::Cell as StdCell;
use std::rc::Rc;
use std::sync::atomic::AtomicUsize;
use std::time::Duration;

use super::*;
use crate::Value;

fn plan(count: u64) -> Plan {
    toml::from_str(&format!(
        "[[parameter]]
        variable = 'p'
        from = 0
        to = 1
        count = {count}"
    ))
    .unwrap()
}

fn square(run: &Run<'_>) -> Option<Cell> {
    match run.assignments[0].1 {
        Value::Number(p) => Some(Some(Value::Number(p * p))),
        _ => None,
    }
}

/// The rows of some runs, sorted by index.
fn rows(plan: &Plan, indices: impl Iterator<Item = u64> + Send, threads: usize) -> Vec<Row> {
    let rows = Mutex::new(Vec::new());
    let ended = execute(
        plan,
        indices,
        threads,
        &AtomicBool::new(false),
        || Ok::<_, Error>(()),
        |(), run| Ok(square(run)),
        |row| {
            rows.lock().unwrap().push(row);
            Ok(())
        },
    );
    assert_eq!(ended, Ok(Ended::Complete));
    let mut rows = rows.into_inner().unwrap();
    rows.sort_by_key(|row| row.index);
    rows
}

#[test]
fn rows_are_the_same_for_any_number_of_threads_and_any_shares() {
    let plan = plan(500);
    let expected = rows(&plan, 0..500, 1);
    assert_eq!(expected.len(), 500);
    assert_eq!(
        expected[499].cells,
        [1.0, 1.0].map(|x| Some(Value::Number(x)))
    );
    for threads in [0, 2, 7, 600] {
        assert_eq!(rows(&plan, 0..500, threads), expected);
    }
    let shares = [0..1, 1..77, 77..500].map(|share| rows(&plan, share, 3));
    assert_eq!(shares.concat(), expected);
    assert_eq!(rows(&plan, 0..0, 3), []);
}

#[test]
fn each_working_thread_creates_one_state() {
    for (plan, threads) in [(plan(2), 8), (plan(100), 3)] {
        let made = AtomicUsize::new(0);
        let kept = AtomicUsize::new(0);
        execute(
            &plan,
            0..plan.runs(),
            threads,
            &AtomicBool::new(false),
            || {
                made.fetch_add(1, Relaxed);
                Ok::<_, Error>(Rc::new(StdCell::new(0))) // neither Send nor Sync
            },
            |state, run| {
                state.set(state.get() + 1);
                std::thread::sleep(Duration::from_millis(1));
                Ok(square(run))
            },
            |_| {
                kept.fetch_add(1, Relaxed);
                Ok(())
            },
        )
        .unwrap();
        assert_eq!(kept.into_inner() as u64, plan.runs());
        let max_states = threads.min(plan.runs() as usize);
        assert!((1..=max_states).contains(&made.into_inner()));
    }
}

/// Executes 1000 runs on 4 threads; returns the outcome and the number of rows kept. The callbacks
/// fail at run 20; later runs are slow, so that they cannot all finish before the failure takes effect.
fn failing(
    init: impl Fn() -> Result<(), Error> + Sync,
    simulate: impl Fn(&Run<'_>) -> Result<(), Error> + Sync,
    keep: impl Fn(&Row) -> Result<(), Error> + Sync,
    cancel: &AtomicBool,
) -> (Result<Ended, Error>, usize) {
    let kept = AtomicUsize::new(0);
    let outcome = execute(
        &plan(1000),
        0..1000,
        4,
        cancel,
        init,
        |(), run| {
            std::thread::sleep(Duration::from_millis(if run.index > 20 { 5 } else { 0 }));
            simulate(run)?;
            Ok(square(run))
        },
        |row| {
            keep(&row)?;
            kept.fetch_add(1, Relaxed);
            Ok(())
        },
    );
    (outcome, kept.into_inner())
}

fn at_twenty(index: u64) -> Result<(), Error> {
    if index == 20 {
        return Err(Error::new("run 20 fails"));
    }
    Ok(())
}

#[test]
fn an_error_ends_the_sweep_and_keeps_finished_runs() {
    let not_cancelled = AtomicBool::new(false);
    let failed = Err(Error::new("run 20 fails"));
    let (outcome, kept) = failing(
        || Ok(()),
        |run| at_twenty(run.index),
        |_| Ok(()),
        &not_cancelled,
    );
    assert_eq!(outcome, failed);
    assert!((20..1000).contains(&kept), "{kept}");
    let (outcome, kept) = failing(
        || Ok(()),
        |_| Ok(()),
        |row| at_twenty(row.index),
        &not_cancelled,
    );
    assert_eq!(outcome, failed);
    assert!((20..1000).contains(&kept), "{kept}");
    let (outcome, kept) = failing(|| at_twenty(20), |_| Ok(()), |_| Ok(()), &not_cancelled);
    assert_eq!((outcome, kept), (failed, 0));
}

#[test]
fn a_run_outside_the_plan_is_an_error() {
    let outcome = execute(
        &plan(3),
        2..5,
        1,
        &AtomicBool::new(false),
        || Ok(()),
        |(), run| Ok(square(run)),
        |_| Ok::<_, Error>(()),
    );
    assert_eq!(
        outcome.unwrap_err().to_string(),
        "runs 3..4, expected a range within 0..3"
    );
}

#[test]
fn a_cancelled_sweep_finishes_its_running_simulations() {
    let cancel = AtomicBool::new(false);
    let cancelling = |row: &Row| {
        cancel.fetch_or(row.index == 20, Relaxed);
        Ok(())
    };
    let (outcome, kept) = failing(|| Ok(()), |_| Ok(()), cancelling, &cancel);
    assert_eq!(outcome, Ok(Ended::Cancelled));
    assert!((21..1000).contains(&kept), "{kept}");
    let (outcome, kept) = failing(|| Ok(()), |_| Ok(()), |_| Ok(()), &cancel);
    assert_eq!((outcome, kept), (Ok(Ended::Cancelled), 0));
}

#[test]
fn a_sweep_cancelled_in_its_last_run_is_complete() {
    let cancel = AtomicBool::new(false);
    let outcome = execute(
        &plan(3),
        0..3,
        1,
        &cancel,
        || Ok(()),
        |(), run| Ok(square(run)),
        |row| {
            cancel.fetch_or(row.index == 2, Relaxed);
            Ok::<_, Error>(())
        },
    );
    assert_eq!(outcome, Ok(Ended::Complete));
}

#[test]
fn a_panic_ends_the_sweep() {
    let kept = AtomicUsize::new(0);
    let outcome = std::panic::catch_unwind(|| {
        failing(
            || Ok(()),
            |run| {
                assert!(run.index != 20, "a panic that this test expects");
                Ok(())
            },
            |_| {
                kept.fetch_add(1, Relaxed);
                Ok(())
            },
            &AtomicBool::new(false),
        )
    });
    assert!(outcome.is_err());
    assert!((20..1000).contains(&kept.load(Relaxed)));
}
