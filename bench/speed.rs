//! The cost of a step in process, and of opening an FMU. `bench/run.py` compares it with the C
//! interface for docs/speed.md. Needs the FMUs: `cargo fmu export`.

use std::array;
use std::hint::black_box;
use std::path::Path;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, criterion_group, criterion_main};
use fmu_master::{Description, Plan};
use pendulum_control::closed_loop::{TS, ipid_rbf, pid, pid_rbf};
use pendulum_control::pid::Integral;
use pendulum_control::plant::{Linear, Parameters, State, TransferFunction, nonlinear};
use pendulum_control::{PidRbf, Rbf, Target, signal};

type Group<'a> = BenchmarkGroup<'a, WallTime>;

const CONTROLLER: [f64; 4] = [1.0, 0.99, 0.0, 10.0];
/// So small that the plant stays upright until it is reset.
const FORCE: [f64; 4] = [1e-4; 4];
/// Steps after which the plant, which has no controller, is reset.
const UPRIGHT: u32 = 2048;

/// A model with constant inputs, and with changing inputs: r, y, d, `u_supervisor` of a controller, or u
/// of the plant.
fn both<Step: FnMut([f64; 4]) -> f64>(
    group: &mut Group<'_>,
    name: &str,
    standing: [f64; 4],
    model: impl Fn() -> Step,
) {
    // Values with mean zero, which always change and are large enough to avoid denormal numbers.
    let value = |k: usize| 0.1 * libm::sin(core::f64::consts::TAU * (k as f64 + 0.5) / 64.0);
    let moving = array::from_fn(|k| array::from_fn(|i| value(k + i)));
    for (kind, inputs) in [("constant", [standing; 64]), ("changing", moving)] {
        let mut step = model();
        let mut inputs = inputs.iter().cycle();
        group.bench_function(format!("{name} {kind}"), |b| {
            b.iter(|| inputs.next().map(|input| step(black_box(*input))));
        });
    }
}

/// Each model, called in process.
fn models(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("in process");
    both(&mut group, "Pid", CONTROLLER, || {
        let mut c = pid(Integral::Sum, false);
        move |[r, y, d, _]| c.sample(r, y, d)
    });
    both(&mut group, "PidRbf", CONTROLLER, || {
        let mut c = pid_rbf(false, [0.0; 4]);
        move |[r, y, d, _]| c.sample(r, y, d)
    });
    both(&mut group, "IpidRbf", CONTROLLER, || {
        let mut c = ipid_rbf(Target::Own, [0.0; 4]);
        move |[r, y, d, u_supervisor]| c.sample(r, y, d, u_supervisor)
    });
    both(&mut group, "Pendulum, linear", FORCE, || {
        let mut plant = Linear::new(&Parameters::PAPER);
        let advance = move |state: &mut State, u: f64| plant.advance(state, u, TS);
        from_upright(State::default(), advance, |state| state.theta)
    });
    both(&mut group, "Pendulum, nonlinear", FORCE, || {
        let advance = |state: &mut State, u: f64| {
            nonlinear::advance(&Parameters::PAPER, state, u, TS).unwrap();
        };
        from_upright(State::default(), advance, |state| state.theta)
    });
    both(&mut group, "Pendulum, transfer function", FORCE, || {
        let plant = TransferFunction::new(&Parameters::PAPER, TS, State::default());
        from_upright(plant, |plant, u| _ = plant.advance(u), |p| p.theta())
    });
    source(&mut group, "constant", |_| black_box(1.0));
    source(&mut group, "changing", |time| signal::sine(0.2, time));
    group.finish();
}

fn source(group: &mut Group<'_>, kind: &str, wave: impl Fn(f64) -> f64) {
    let mut time = 0.0;
    group.bench_function(format!("Source {kind}"), |b| {
        b.iter(|| {
            time += TS;
            wave(time) + signal::pulse(5.0, 0.5, time)
        });
    });
}

/// The steps of an unstable plant, which starts anew before it falls over.
fn from_upright<P: Clone>(
    upright: P,
    mut advance: impl FnMut(&mut P, f64),
    theta: impl Fn(&P) -> f64,
) -> impl FnMut([f64; 4]) -> f64 {
    let mut plant = upright.clone();
    let mut steps = 0;
    move |[u, ..]| {
        steps += 1;
        if steps % UPRIGHT == 0 {
            plant = upright.clone();
        }
        advance(&mut plant, u);
        theta(&plant)
    }
}

/// The cost of a sample as a function of the number of network nodes.
fn nodes(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("nodes");
    macro_rules! nodes {
        ($($count:literal)*) => { $(nodes_of::<$count>(&mut group);)* };
    }
    nodes!(1 2 4 8 16 32 64 128 256);
    group.finish();
}

fn nodes_of<const N: usize>(group: &mut Group<'_>) {
    both(group, &N.to_string(), CONTROLLER, || {
        let mut c =
            PidRbf { pid: pid(Integral::Sum, false), network: network::<N>(), ..PidRbf::default() };
        move |[r, y, d, _]| c.sample(r, y, d)
    });
}

/// Nodes spread evenly over -2 to 2.
fn network<const N: usize>() -> Rbf<N> {
    let mut network = Rbf::default();
    network.centres = array::from_fn(|j| 4.0 * (j as f64 + 0.5) / N as f64 - 2.0);
    network.widths = [0.5; N];
    network.eta = 0.3 / N as f64; // the bound of section 3.2 shrinks with the number of nodes
    network.alpha = 0.05;
    network.reset();
    network
}

/// Opening an FMU file, which includes unpacking.
fn loading(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("loading");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/fmu/PidRbf.fmu");
    let description = Description::read_fmu(&file).unwrap();
    group.bench_function("open", |b| b.iter(|| Plan::new(&description).unwrap()));
    group.finish();
}

criterion_group!(benches, models, nodes, loading);
criterion_main!(benches);
