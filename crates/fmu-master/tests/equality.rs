//! The native master gives the same bits as the mathematics called in process, at every sample of the
//! 18 loops of Table 1. (`tests/test_native.py` compares it with FMPy.)

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use fmu_build::{ExportOptions, Selection};
use fmu_master::{Description, Literal, Messages, Plan};
use pendulum_control::Target;
use pendulum_control::closed_loop::{self, ClosedLoop, SetPoint, ipid_rbf, pid, pid_rbf};
use pendulum_control::pid::Integral;

const STEPS: usize = 20_000;

/// The root of the checkout, with the FMUs of the present sources in `target/fmu`.
static ROOT: LazyLock<PathBuf> = LazyLock::new(|| {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let selection =
        Selection { manifest_path: Some(root.join("Cargo.toml")), ..Selection::default() };
    let options = ExportOptions { selection, ..ExportOptions::default() };
    fmu_build::export(&options, &|_| ()).unwrap();
    root
});

fn plan(example: &str) -> Plan {
    let file = ROOT.join("examples/closed-loop").join(example);
    let mut description = Description::read(&file).unwrap();
    description.outputs = vec!["controller.e".into(), "controller.u".into()];
    Plan::new(&description).unwrap()
}

/// The bits of errors and forces of a loop in process.
fn in_process(
    signal: SetPoint,
    disturbance: f64,
    controller: impl FnMut(f64, f64, f64) -> f64,
) -> Vec<[u64; 2]> {
    let mut closed_loop = ClosedLoop::new(closed_loop::Order::Sequential);
    let samples = closed_loop.run(signal, disturbance, controller);
    let samples = samples.map(|sample| [sample.e, sample.u].map(f64::to_bits));
    samples.take(STEPS).collect()
}

/// The bits of errors and forces of a loop in the native master.
fn natively(plan: &Plan, signal: SetPoint, disturbance: f64) -> Vec<[u64; 2]> {
    let (name, frequency) = match signal {
        SetPoint::Step => ("step", 0.2),
        SetPoint::Sine => ("sine", 0.2),
        SetPoint::Square => ("square", 0.1),
    };
    let starts = [
        ("source.signal", Literal::Text(name.into())),
        ("source.frequency", Literal::Real(frequency)),
        ("source.disturbance.amplitude", Literal::Real(disturbance)),
    ]
    .map(|(variable, value)| plan.start(variable, &value).unwrap());
    let signals = ["controller.e", "controller.u"].map(|name| plan.place(name).unwrap());
    let mut samples = Vec::new();
    let simulation = plan.simulate(&starts, &Messages::default()).unwrap();
    let finished = simulation.run(|row| {
        samples.push(signals.map(|signal| row.number(signal).to_bits()));
        true
    });
    assert!(finished.unwrap().messages.iter().all(|m| !m.is_problem()));
    samples
}

#[test]
fn every_loop_of_table_1_has_the_bits_of_the_mathematics() {
    let [only_pid, rbf, supervised] = ["pid.toml", "pid-rbf.toml", "supervised.toml"].map(plan);
    for signal in [SetPoint::Step, SetPoint::Sine, SetPoint::Square] {
        for disturbance in [0.0, 1.0] {
            let check = |plan: &Plan, controller: &mut dyn FnMut(f64, f64, f64) -> f64| {
                let expected = in_process(signal, disturbance, controller);
                assert_eq!(expected.len(), STEPS);
                let found = natively(plan, signal, disturbance);
                assert!(found == expected, "{signal:?}, d = {disturbance}");
                expected
            };
            let mut c = pid(Integral::Sum, true);
            check(&only_pid, &mut |r, y, d| c.sample(r, y, d));
            let mut supervisor = pid_rbf(true, [0.0; 4]);
            let forces = check(&rbf, &mut |r, y, d| supervisor.sample(r, y, d));
            let mut forces = forces.into_iter().map(|[_, u]| f64::from_bits(u));
            let mut c = ipid_rbf(Target::Supervisor, [0.0; 4]);
            check(&supervised, &mut |r, y, d| c.sample(r, y, d, forces.next().unwrap()));
        }
    }
}
