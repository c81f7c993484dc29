//! Table 1 of the paper from the control library alone, compared with the expected columns of
//! `table1.csv`.

use pendulum_control::Target;
use pendulum_control::closed_loop::{ClosedLoop, Order, SetPoint, ipid_rbf, pid, pid_rbf};
use pendulum_control::pid::Integral;

const SAMPLES: usize = 20_000;
const TABLE: &str = include_str!("../../../python/pendulum_fmus/table1.csv");

/// The expected value in a row (from 1); `None` where only a bound is known.
fn expected(row: usize, column: &str) -> Option<f64> {
    let cells = |line: usize| TABLE.lines().nth(line).unwrap().split(',');
    let index = cells(0).position(|name| name == column).unwrap();
    cells(row).nth(index).unwrap().parse().ok()
}

/// The last error of a loop under `controller`.
fn last_error(
    set_point: SetPoint,
    disturbance: f64,
    controller: impl FnMut(f64, f64, f64) -> f64,
) -> f64 {
    let mut closed_loop = ClosedLoop::new(Order::Sequential);
    let mut samples = closed_loop.run(set_point, disturbance, controller);
    samples.nth(SAMPLES - 1).unwrap().e
}

fn assert_error(row: usize, column: &str, e: f64) {
    match expected(row, column) {
        None => assert!(e.abs() < 1e-11, "row {row}, {column}: {e}"),
        Some(expected) => {
            // Decayed transients are more sensitive to rounding.
            let tolerance = if expected.abs() < 1e-9 { 1e-2 } else { 2e-5 };
            let error = (e / expected - 1.0).abs();
            assert!(error < tolerance, "row {row}, {column}: {e}, not {expected}");
        }
    }
}

/// PID, PID-RBF, and IPID-RBF that PID-RBF supervises.
#[test]
fn all_columns() {
    let set_points = [SetPoint::Step, SetPoint::Sine, SetPoint::Square];
    let rows = set_points.into_iter().flat_map(|s| [(s, 0.0), (s, 1.0)]);
    for (row, (set_point, disturbance)) in (1..).zip(rows) {
        let mut c = pid(Integral::Sum, true);
        let e = last_error(set_point, disturbance, |r, y, d| c.sample(r, y, d));
        assert_error(row, "e_pid_expected", e);

        let mut supervisor = pid_rbf(true, [0.0; 4]);
        let mut forces = Vec::new();
        let e = last_error(set_point, disturbance, |r, y, d| {
            forces.push(supervisor.sample(r, y, d));
            supervisor.pid.u
        });
        assert_error(row, "e_pid_rbf_expected", e);

        let mut c = ipid_rbf(Target::Supervisor, [0.0; 4]);
        let mut forces = forces.into_iter();
        let e =
            last_error(set_point, disturbance, |r, y, d| c.sample(r, y, d, forces.next().unwrap()));
        assert_error(row, "e_ipid_rbf_expected", e);
    }
}

/// Holding theta = 1 requires a force that ramps by `-b m g l/(m l) = -0.98` N/s per rad. The network
/// of the own-target controller lags a ramp of `s` N per sample by a force of `s/(eta |h|^2)`.
#[test]
fn ipid_rbf_with_its_own_target_has_the_static_error_of_a_ramp() {
    let mut c = ipid_rbf(Target::Own, [0.0; 4]);
    let e = last_error(SetPoint::Step, 0.0, |r, y, d| c.sample(r, y, d, 0.0));
    // In steady state, u_p = kp e + ki e ts/(1-ts), and each sample adds eta |h|^2 u_p to u_n, plus
    // the momentum alpha times the last increment; together they follow the ramp.
    let h: f64 = c.law.network.activations.iter().map(|h| h * h).sum();
    let ramp = -0.98 * (1.0 - e) * 0.001;
    let u_p = ramp * (1.0 - 0.05) / (0.3 * h);
    let static_error = u_p / (300.0 + 500.0 * 0.001 / 0.999);
    assert!((e / static_error - 1.0).abs() < 1e-3, "{e} {static_error}");
}
