//! `cargo fmu table1`: the 18 numbers of the paper's Table 1.

use std::collections::HashMap;
use std::io::Write;
use std::path::PathBuf;
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result, anyhow, ensure};
use clap::Args;
use fmu_cosim::{Description, Plan, Value};

use crate::table;

/// Where the FMUs are.
#[derive(Debug, Args)]
pub struct Table1Args {
    /// Folder of the FMUs
    #[arg(long, value_name = "DIR", default_value = "target/fmu")]
    pub fmus: PathBuf,
}

/// The numbers: printed, and those of a correct implementation with zero initial weights.
const TABLE: &str = include_str!("../../../../python/pendulum_fmus/table1.csv");
/// The columns of the table, their names in the data, and the loops that compute them.
const CONTROLLERS: [(&str, &str, &str); 3] = [
    (
        "Pid",
        "e_pid",
        include_str!("../../../../examples/closed-loop/pid.toml"),
    ),
    (
        "PidRbf",
        "e_pid_rbf",
        include_str!("../../../../examples/closed-loop/pid-rbf.toml"),
    ),
    (
        "IpidRbf",
        "e_ipid_rbf",
        include_str!("../../../../examples/closed-loop/supervised.toml"),
    ),
];
const ERROR: &str = "controller.e";

/// Relative: the last bit of a coefficient of (41) moves the errors by up to 6e-6.
const TOLERANCE: f64 = 2e-5;
/// Relative, for a decayed transient: the last bits move it by up to half of this.
const TRANSIENT_TOLERANCE: f64 = 1e-2;
/// Errors below this (rad) are decayed transients.
const TRANSIENT: f64 = 1e-9;
/// |e| (rad) of a loop that has converged, where the paper prints the residue of its rounding.
const ZERO: f64 = 1e-11;

/// A row of the data, by the names of its columns.
type Row<'a> = HashMap<&'a str, &'a str>;

/// Computes the table and prints it; false if a number is missed.
///
/// # Errors
/// The FMUs are not there, or fail.
pub fn run(args: &Table1Args, out: &mut impl Write) -> Result<bool> {
    ensure!(
        args.fmus.is_dir(),
        "there is no folder {}; `cargo fmu export` writes the FMUs to target/fmu",
        args.fmus.display()
    );
    let rows = rows();
    let begin = Instant::now();
    let columns = thread::scope(|scope| {
        let workers = CONTROLLERS.map(|(_, _, system)| {
            let rows = &rows;
            scope.spawn(move || column(system, rows, args))
        });
        let join = |worker: thread::ScopedJoinHandle<'_, Result<Vec<f64>>>| {
            worker.join().map_err(|_| anyhow!("a run panicked"))?
        };
        workers.into_iter().map(join).collect::<Result<Vec<_>>>()
    })?;
    let elapsed = begin.elapsed();

    writeln!(out, "Table 1: e(k) [rad] at k = 20000\n")?;
    let mut all_hold = true;
    let head = [
        "row",
        "disturbance",
        "signal",
        "controller",
        "printed",
        "expected",
        "computed",
        "",
    ];
    let mut cells = vec![head.map(str::to_owned)];
    for (index, row) in rows.iter().enumerate() {
        for ((controller, name, _), column) in CONTROLLERS.iter().zip(&columns) {
            let expected = row[format!("{name}_expected").as_str()];
            let computed = column[index];
            let holds = holds(computed, expected);
            all_hold &= holds;
            cells.push([
                row["row"].into(),
                row["disturbance"].into(),
                row["signal"].into(),
                (*controller).into(),
                row[format!("{name}_printed").as_str()].into(),
                expected.into(),
                format!("{computed:.9e}"),
                if holds { "ok" } else { "MISSED" }.into(),
            ]);
        }
    }
    table::print(&cells, out)?;
    writeln!(
        out,
        "\n18 loops of 20000 steps in {:.3} s",
        elapsed.as_secs_f64()
    )?;
    Ok(all_hold)
}

fn rows() -> Vec<Row<'static>> {
    let mut lines = TABLE.lines().map(|line| line.split(','));
    let names: Vec<_> = lines.next().into_iter().flatten().collect();
    lines
        .map(|cells| names.iter().copied().zip(cells).collect())
        .collect()
}

/// The last error of every row.
fn column(system: &str, rows: &[Row<'_>], args: &Table1Args) -> Result<Vec<f64>> {
    let mut description = Description::parse(system)?;
    description.take_fmus_from(&args.fmus);
    description.outputs = vec![ERROR.into()];
    let plan = Plan::new(&description)?;
    rows.iter().map(|row| last_error(&plan, row)).collect()
}

fn last_error(plan: &Plan, row: &Row<'_>) -> Result<f64> {
    let mut starts = Vec::new();
    for (variable, column) in [
        ("source.signal", "signal"),
        ("source.frequency", "frequency_hz"),
        ("source.disturbance.amplitude", "disturbance_amplitude"),
    ] {
        if !row[column].is_empty() {
            starts.push(plan.start(variable, &Value::Text(row[column].into()))?);
        }
    }
    let mut last = f64::NAN;
    plan.simulate(&starts)
        .and_then(|simulation| simulation.run(|_, row| last = row[0]))
        .with_context(|| format!("row {}", row["row"]))?;
    Ok(last)
}

fn holds(computed: f64, expected: &str) -> bool {
    let Ok(expected) = expected.parse::<f64>() else {
        return computed.abs() < ZERO; // the data bound it only
    };
    let tolerance = match expected.abs() < TRANSIENT {
        true => TRANSIENT_TOLERANCE,
        false => TOLERANCE,
    };
    (computed / expected - 1.0).abs() < tolerance
}
