//! The native master gives the same bits as the mathematics called in process, at every sample of the
//! 18 loops of Table 1. (`tests/test_native.py` compares it with FMPy.)

#[path = "../../../tests/fmus.rs"]
mod fmus;

use fmu_cosim::{Description, Order, Plan, Value};
use pendulum_control::Target;
use pendulum_control::closed_loop::{self, ClosedLoop, SetPoint, ipid_rbf, pid, pid_rbf};
use pendulum_control::pid::Integral;

const STEPS: usize = 20_000;

/// The signals and disturbances of the table's rows.
fn rows() -> impl Iterator<Item = (SetPoint, f64)> {
    [SetPoint::Step, SetPoint::Sine, SetPoint::Square]
        .into_iter()
        .flat_map(|signal| [(signal, 0.0), (signal, 1.0)])
}

fn plan(example: &str) -> Plan {
    let file = fmus::root().join("examples/closed-loop").join(example);
    let mut description = Description::read(&file).unwrap();
    description.outputs = vec!["controller.e".into(), "controller.u".into()];
    Plan::new(&description).unwrap()
}

/// Errors and forces of a loop in process.
fn in_process(
    signal: SetPoint,
    disturbance: f64,
    controller: impl FnMut(f64, f64, f64) -> f64,
) -> (Vec<f64>, Vec<f64>) {
    let mut closed_loop = ClosedLoop::new(closed_loop::Order::Sequential);
    let samples = closed_loop.run(signal, disturbance, controller);
    samples
        .take(STEPS)
        .map(|sample| (sample.e, sample.u))
        .unzip()
}

/// Errors and forces of a loop in the native master.
fn natively(plan: &Plan, signal: SetPoint, disturbance: f64) -> (Vec<f64>, Vec<f64>) {
    let (name, frequency) = match signal {
        SetPoint::Step => ("step", 0.2),
        SetPoint::Sine => ("sine", 0.2),
        SetPoint::Square => ("square", 0.1),
    };
    let starts = [
        ("source.signal", Value::Text(name.into())),
        ("source.frequency", Value::Real(frequency)),
        ("source.disturbance.amplitude", Value::Real(disturbance)),
    ]
    .map(|(variable, value)| plan.start(variable, &value).unwrap());
    let (mut errors, mut forces) = (Vec::new(), Vec::new());
    let simulation = plan.simulate(&starts).unwrap();
    let messages = simulation.run(|_, row| {
        errors.push(row[0]);
        forces.push(row[1]);
    });
    assert!(messages.unwrap().iter().all(|message| !message.warning));
    (errors, forces)
}

/// Runs a loop in process and natively, and compares every bit of e and u.
fn assert_equal(
    plan: &Plan,
    signal: SetPoint,
    disturbance: f64,
    controller: impl FnMut(f64, f64, f64) -> f64,
) {
    let (errors, forces) = in_process(signal, disturbance, controller);
    let natively = natively(plan, signal, disturbance);
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(errors.len(), STEPS);
    assert!(
        bits(&errors) == bits(&natively.0),
        "e: {signal:?}, d = {disturbance}"
    );
    assert!(
        bits(&forces) == bits(&natively.1),
        "u: {signal:?}, d = {disturbance}"
    );
}

#[test]
fn pid_loops() {
    let plan = plan("pid.toml");
    for (signal, disturbance) in rows() {
        let mut c = pid(Integral::Sum, true);
        assert_equal(&plan, signal, disturbance, |r, y, d| c.sample(r, y, d));
    }
}

#[test]
fn pid_rbf_loops() {
    let plan = plan("pid-rbf.toml");
    for (signal, disturbance) in rows() {
        let mut c = pid_rbf(true, [0.0; 4]);
        assert_equal(&plan, signal, disturbance, |r, y, d| c.sample(r, y, d));
    }
}

#[test]
fn supervised_ipid_rbf_loops() {
    let plan = plan("supervised.toml");
    for (signal, disturbance) in rows() {
        let mut supervisor = pid_rbf(true, [0.0; 4]);
        let mut supervising = Vec::new();
        in_process(signal, disturbance, |r, y, d| {
            supervising.push(supervisor.sample(r, y, d));
            supervisor.pid.u
        });
        let mut supervising = supervising.into_iter();
        let mut c = ipid_rbf(Target::Supervisor, [0.0; 4]);
        assert_equal(&plan, signal, disturbance, |r, y, d| {
            c.sample(r, y, d, supervising.next().unwrap())
        });
    }
}

/// In parallel order the plant receives u one sample later, as in sequential order with the PID terms
/// of the previous sample.
#[test]
fn parallel_order_delays_by_one_sample() {
    let plan_of = |order| {
        let file = fmus::root().join("examples/closed-loop/pid.toml");
        let mut description = Description::read(&file).unwrap();
        description.outputs = vec!["plant.theta".into()];
        description.order = order;
        Plan::new(&description).unwrap()
    };
    let angles = |order, previous_sample_terms| {
        let plan = plan_of(order);
        let value = Value::Boolean(previous_sample_terms);
        let start = plan
            .start("controller.previous_sample_terms", &value)
            .unwrap();
        let mut angles = Vec::new();
        let simulation = plan.simulate(&[start]).unwrap();
        simulation.run(|_, row| angles.push(row[0])).unwrap();
        angles
    };
    let parallel = angles(Order::Parallel, false);
    assert_eq!(parallel, angles(Order::Sequential, true));
    assert_ne!(parallel, angles(Order::Sequential, false));
}
