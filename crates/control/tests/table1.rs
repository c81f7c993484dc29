//! Table 1 of the paper from the mathematics alone: the expected columns are those of `table1.csv`.

mod loops;

use control::Target;
use control::pid::Integral;
use loops::{SetPoint, ipid_rbf, pid, pid_rbf, run};

const SAMPLES: u32 = 20_000;
const TABLE: &str = include_str!("../../../python/pendulum_fmus/table1.csv");

/// The expected column of a row (from 1); `None` for the residue that is only bounded.
fn expected(row: usize, column: &str) -> Option<f64> {
    let cells = |line: usize| TABLE.lines().nth(line).unwrap().split(',');
    let index = cells(0).position(|name| name == column).unwrap();
    cells(row).nth(index).unwrap().parse().ok()
}

fn rows() -> impl Iterator<Item = (usize, SetPoint, f64)> {
    [SetPoint::Step, SetPoint::Sine, SetPoint::Square]
        .into_iter()
        .flat_map(|s| [(s, 0.0), (s, 1.0)])
        .enumerate()
        .map(|(row, (s, d))| (row + 1, s, d))
}

fn assert_last(row: usize, column: &str, errors: &[f64]) {
    let e = *errors.last().unwrap();
    match expected(row, column) {
        None => assert!(e.abs() < 1e-11, "row {row}, {column}: {e}"),
        Some(expected) => {
            // A decayed transient is that much more sensitive to rounding.
            let tolerance = if expected.abs() < 1e-9 { 1e-2 } else { 2e-5 };
            let miss = (e / expected - 1.0).abs();
            assert!(miss < tolerance, "row {row}, {column}: {e}, not {expected}");
        }
    }
}

#[test]
fn pid_column() {
    for (row, set_point, disturbance) in rows() {
        let mut c = pid(Integral::Sum, true);
        let errors = run(set_point, disturbance, SAMPLES, |r, y, d| c.sample(r, y, d));
        assert_last(row, "e_pid_expected", &errors);
    }
}

#[test]
fn pid_rbf_and_supervised_ipid_rbf_columns() {
    for (row, set_point, disturbance) in rows() {
        let mut supervisor = pid_rbf(true, [0.0; 4]);
        let mut forces = Vec::new();
        let errors = run(set_point, disturbance, SAMPLES, |r, y, d| {
            forces.push(supervisor.sample(r, y, d));
            supervisor.u
        });
        assert_last(row, "e_pid_rbf_expected", &errors);

        let mut c = ipid_rbf(Target::Supervisor, [0.0; 4]);
        let mut forces = forces.into_iter();
        let errors = run(set_point, disturbance, SAMPLES, |r, y, d| {
            c.sample(r, y, d, forces.next().unwrap())
        });
        assert_last(row, "e_ipid_rbf_expected", &errors);
    }
}

/// Holding theta = 1 needs a force that ramps by `-b m g l/(m l) = -0.98` N/s per rad; the network
/// of the own-target controller follows a ramp of `s` N a sample behind by `s/eta |h|^2` of force.
#[test]
fn ipid_rbf_with_its_own_target_keeps_the_static_error_of_a_ramp() {
    let mut c = ipid_rbf(Target::Own, [0.0; 4]);
    let e = *run(SetPoint::Step, 0.0, SAMPLES, |r, y, d| {
        c.sample(r, y, d, 0.0)
    })
    .last()
    .unwrap();
    // In steady state: u_p = kp e + ki e ts/(1-ts) + kd 0, and a sample adds eta |h|^2 u_p to u_n,
    // the momentum alpha of the last addition; together they follow the ramp.
    let h: f64 = c.law.network.activations.iter().map(|h| h * h).sum();
    let ramp = -0.98 * (1.0 - e) * 0.001;
    let u_p = ramp * (1.0 - 0.05) / (0.3 * h);
    let static_error = u_p / (300.0 + 500.0 * 0.001 / 0.999);
    assert!((e / static_error - 1.0).abs() < 1e-3, "{e} {static_error}");
}
