//! The cost of a step in process, and of opening an FMU. `bench/run.py` compares it with the C
//! interface and prints the table of docs/speed.md. Needs the FMUs: `cargo fmu export`.

use std::hint::black_box;
use std::path::{Path, PathBuf};

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, criterion_group, criterion_main};
use fmu_cosim::Fmu;
use pendulum_control::closed_loop::{TS, pid};
use pendulum_control::pid::Integral;
use pendulum_control::plant::{Linear, Parameters, State};
use pendulum_control::{IpidRbf, PidRbf, Rbf};

/// A signal that always changes and is large enough to avoid denormal numbers.
struct Signal {
    values: [f64; 64],
    next: usize,
}

impl Signal {
    fn new(offset: f64) -> Self {
        let value = |k: usize| offset + 0.01 * libm::sin(0.7 * k as f64);
        Self {
            values: std::array::from_fn(value),
            next: 0,
        }
    }

    fn next(&mut self) -> f64 {
        self.next = (self.next + 1) % self.values.len();
        self.values[self.next]
    }
}

/// Nodes spread evenly over -2 to 2.
fn network<const N: usize>() -> Rbf<N> {
    let mut network = Rbf::default();
    network.centres = std::array::from_fn(|j| 4.0 * (j as f64 + 0.5) / N as f64 - 2.0);
    network.widths = [0.5; N];
    network.eta = 0.3 / N as f64; // the bound of section 3.2 shrinks with the number of nodes
    network.alpha = 0.05;
    network.reset();
    network
}

fn pid_rbf<const N: usize>() -> PidRbf<N> {
    PidRbf {
        pid: pid(Integral::Sum, false),
        network: network(),
        ..PidRbf::default()
    }
}

fn fmu_file(model: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../target/fmu")
        .join(format!("{model}.fmu"))
}

type Group<'a> = BenchmarkGroup<'a, WallTime>;

/// Each controller and the plant, called in process.
fn steps(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("Pid");
    let (mut c, mut y) = (pid(Integral::Sum, false), Signal::new(0.99));
    group.bench_function("in process", |b| {
        b.iter(|| c.sample(black_box(1.0), y.next(), black_box(0.0)));
    });
    group.finish();

    let mut group = criterion.benchmark_group("PidRbf");
    let (mut c, mut y) = (pid_rbf::<4>(), Signal::new(0.99));
    group.bench_function("in process", |b| {
        b.iter(|| c.sample(black_box(1.0), y.next(), black_box(0.0)));
    });
    group.finish();

    let mut group = criterion.benchmark_group("IpidRbf");
    let (mut c, mut y) = (IpidRbf::default(), Signal::new(0.99));
    c.law = PidRbf {
        pid: pid(Integral::Leaky, false),
        network: network::<4>(),
        ..c.law
    };
    group.bench_function("in process", |b| {
        b.iter(|| c.sample(black_box(1.0), y.next(), black_box(0.0), black_box(10.0)));
    });
    group.finish();

    let mut group = criterion.benchmark_group("Pendulum");
    let mut plant = Linear::new(&Parameters::PAPER);
    let (mut state, mut balance) = (State::default(), Balance::default());
    group.bench_function("in process", |b| {
        b.iter(|| {
            let force = balance.force(state.theta);
            plant.advance(&mut state, black_box(force), TS);
            state.theta
        });
    });
    group.finish();
}

/// A force that balances the unstable pendulum and keeps it moving.
#[derive(Default)]
struct Balance {
    before: f64,
    samples: u32,
}

impl Balance {
    fn force(&mut self, theta: f64) -> f64 {
        self.samples = self.samples.wrapping_add(1);
        let target = if self.samples & 1024 == 0 {
            0.01
        } else {
            -0.01
        };
        let force = 300.0 * (target - theta) - 1e5 * (theta - self.before);
        self.before = theta;
        force
    }
}

/// The cost of a sample as a function of the number of network nodes.
fn nodes(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("nodes");
    nodes_of::<1>(&mut group);
    nodes_of::<4>(&mut group);
    nodes_of::<16>(&mut group);
    nodes_of::<64>(&mut group);
    nodes_of::<256>(&mut group);
    group.finish();
}

fn nodes_of<const N: usize>(group: &mut Group<'_>) {
    let (mut c, mut y) = (pid_rbf::<N>(), Signal::new(0.99));
    group.bench_function(format!("{N} constant"), |b| {
        b.iter(|| c.sample(black_box(1.0), y.next(), black_box(0.0)));
    });
    let (mut c, mut r) = (pid_rbf::<N>(), Signal::new(1.0));
    group.bench_function(format!("{N} moving"), |b| {
        b.iter(|| {
            let r = r.next();
            c.sample(r, black_box(0.99), black_box(0.0))
        });
    });
}

/// Opening an FMU file, which includes unpacking.
fn loading(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("loading");
    let file = fmu_file("PidRbf");
    group.bench_function("open", |b| b.iter(|| Fmu::open(&file).unwrap()));
    group.finish();
}

criterion_group!(benches, steps, nodes, loading);
criterion_main!(benches);
