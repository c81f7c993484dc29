//! A sweep whose process is killed repeatedly produces the same table, byte for byte.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use fmu_sweep::{Cell, Columns, Journal, Metrics, Options, Plan, Run, Sample, Summary, Value};

const PLAN: &str = "
    seed = 7
    draws = 20

    [[parameter]]
    variable = 'controller.kp'
    from = 1
    to = 100
    count = 5
    scale = 'log'

    [[parameter]]
    variable = 'plant.model'
    values = ['linear', 'nonlinear']

    [[parameter]]
    variables = ['plant.T', 'observer.T']
    normal = [0.1, 0.02]
";

/// Number of runs of [`PLAN`].
const RUNS: u64 = 200;

fn plan() -> Plan {
    toml::from_str(PLAN).unwrap()
}

fn columns() -> Columns {
    Columns::new(plan().columns().into_iter().chain(Summary::columns())).unwrap()
}

/// A proportional controller of a first-order plant, which diverges for large gains.
fn simulate(run: &Run<'_>) -> [Cell; 9] {
    let (kp, constant) = match (&run.assignments[0].1, &run.assignments[2].1) {
        (Value::Number(kp), Value::Number(constant)) => (*kp, *constant),
        other => panic!("{other:?}"),
    };
    let mut metrics = Metrics::new(&Options::default());
    let mut y = 0.0;
    for k in 0..500 {
        let e = 1.0 - y;
        let u = kp * e;
        let time = 0.005 * f64::from(k);
        if !metrics.push(Sample {
            time,
            r: 1.0,
            y,
            e,
            u,
        }) {
            break;
        }
        y += 0.005 * (u - y) / constant;
    }
    metrics.finish().cells()
}

/// Executes the pending runs, pausing before each.
fn sweep(journal: &Journal, pause: Duration) {
    let plan = plan();
    for index in journal.pending(0..RUNS) {
        std::thread::sleep(pause);
        let run = plan.run(index).unwrap();
        journal.append(&run.row(simulate(&run))).unwrap();
    }
}

fn open(output: &Path) -> Journal {
    Journal::open(output, "c0ffee", columns(), RUNS).unwrap()
}

/// The bytes of the table of an uninterrupted sweep.
fn uninterrupted(folder: &Path) -> Vec<u8> {
    let output = folder.join("uninterrupted/a.csv");
    fs::create_dir_all(output.parent().unwrap()).unwrap();
    let journal = open(&output);
    sweep(&journal, Duration::ZERO);
    journal.finish().unwrap();
    fs::read(output).unwrap()
}

const OUTPUT: &str = "SWEEP_TEST_OUTPUT";

/// Not an actual test, but the process that is killed.
#[test]
fn process() {
    let Some(output) = std::env::var_os(OUTPUT) else {
        return;
    };
    let journal = open(Path::new(&output));
    sweep(&journal, Duration::from_millis(8));
    journal.finish().unwrap();
}

fn start(output: &Path) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "process"])
        .env(OUTPUT, output)
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

fn journal_of(output: &Path) -> PathBuf {
    output.with_extension("csv.part")
}

/// The indices of the runs in the whole lines of a journal.
fn runs_in(journal: &Path) -> Vec<u64> {
    let text = fs::read_to_string(journal).unwrap_or_default();
    let whole = text.rfind('\n').map_or("", |last| &text[..last]);
    let index = |line: &str| line.split(',').next().unwrap().parse().unwrap();
    whole.lines().skip(2).map(index).collect()
}

#[test]
fn a_killed_sweep_neither_loses_nor_repeats_runs() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("killed.csv");
    let journal = journal_of(&output);
    let mut before = Vec::new();
    for kill in 0..5 {
        let mut process = start(&output);
        let deadline = Instant::now() + Duration::from_secs(60);
        while runs_in(&journal).len() < before.len() + 10 {
            assert!(Instant::now() < deadline, "no progress");
            assert_eq!(
                process.try_wait().unwrap(),
                None,
                "ended before it was killed"
            );
            std::thread::sleep(Duration::from_millis(1));
        }
        process.kill().unwrap();
        process.wait().unwrap();
        let after = runs_in(&journal);
        assert_eq!(after[..before.len()], before, "lost after kill {kill}");
        let mut different = after.clone();
        different.sort_unstable();
        different.dedup();
        assert_eq!(different.len(), after.len(), "done twice after kill {kill}");
        assert!(!output.exists());
        before = after;
        // Simulate a kill during a write.
        if kill % 2 == 0 {
            let mut file = fs::OpenOptions::new().append(true).open(&journal).unwrap();
            file.write_all(b"199,1.0,lin").unwrap();
        }
    }
    assert!(start(&output).wait().unwrap().success());
    assert!(!journal.exists());
    let expected = uninterrupted(folder.path());
    assert!(fs::read(&output).unwrap() == expected);
}

/// Imitates a program that distributes ranges of runs to workers and collects their lines.
#[test]
fn lines_from_workers_produce_the_same_table() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("collected.csv");
    let mut text = fmu_sweep::journal::header("c0ffee", &columns()).unwrap();
    for range in [150..200, 0..80, 70..150] {
        for index in range {
            let plan = plan();
            let run = plan.run(index).unwrap();
            text += &columns().line(&run.row(simulate(&run))).unwrap();
        }
    }
    fs::write(journal_of(&output), text).unwrap();
    open(&output).finish().unwrap();
    assert!(fs::read(&output).unwrap() == uninterrupted(folder.path()));
}

/// A worker whose numbers differ because of its program or machine is detected.
#[test]
fn workers_that_disagree_are_detected() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("collected.csv");
    let plan = plan();
    let run = plan.run(0).unwrap();
    let mut row = run.row(simulate(&run));
    let line = columns().line(&row).unwrap();
    row.cells[4] = Some(Value::Number(0.0));
    let other = columns().line(&row).unwrap();
    let header = fmu_sweep::journal::header("c0ffee", &columns()).unwrap();
    fs::write(journal_of(&output), header + &line + &other).unwrap();
    let error = Journal::open(&output, "c0ffee", columns(), RUNS)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains(":4: another row of run 0, expected the same one"),
        "{error}"
    );
}
