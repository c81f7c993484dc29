//! What 20 000 steps of the closed loop cost through each host. Needs the FMUs: `cargo fmu export`.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use fmi::fmi2::instance::InstanceCS;
use fmi_judge::{ClosedLoop, Fmus, Slave, time};
use fmu_cosim::{Description, Plan};

const STEPS: u32 = 20_000;

fn coupled<S: Slave>(fmus: &Fmus) -> f64 {
    let mut closed_loop = ClosedLoop::<S>::new(fmus);
    (0..STEPS).map(|k| closed_loop.step(time(k))[1]).sum()
}

fn hosts(criterion: &mut Criterion) {
    let fmus = Fmus::open();
    let mut group = criterion.benchmark_group("20000 steps");
    group.sample_size(20);
    group.bench_function("fmi", |b| b.iter(|| coupled::<InstanceCS>(&fmus)));
    group.bench_function("fmu-host", |b| {
        b.iter(|| coupled::<fmu_host::Instance>(&fmus));
    });

    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = root.join("examples/closed-loop/pid-rbf.toml");
    let mut description = Description::read(&file).unwrap();
    description.outputs = vec!["controller.e".into(), "controller.u".into()];
    let plan = Plan::new(&description).unwrap();
    group.bench_function("fmu-cosim", |b| {
        b.iter(|| {
            let simulation = plan.simulate(&[]).unwrap();
            simulation.run(|_, row| _ = black_box(row)).unwrap()
        });
    });
    group.finish();
}

criterion_group!(benches, hosts);
criterion_main!(benches);
