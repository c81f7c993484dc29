//! Times 20 000 steps of the closed loop in each host. Requires the FMUs of `cargo fmu export`.

use std::hint::black_box;
use std::path::Path;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use fmi_judge::{ClosedLoop, Fmus, time};
use fmu_master::{Description, Messages, Plan};

const STEPS: u32 = 20_000;

fn hosts(criterion: &mut Criterion) {
    let fmus = Fmus::open();
    let mut group = criterion.benchmark_group("20000 steps");
    // Loading and instantiating the FMUs is not timed.
    group.bench_function("fmi", |b| {
        b.iter_batched_ref(
            || ClosedLoop::new(&fmus),
            |closed_loop| {
                let steps = (0..STEPS).map(|k| closed_loop.step(time(k))[1]);
                steps.sum::<f64>()
            },
            BatchSize::PerIteration,
        );
    });

    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = root.join("examples/closed-loop/pid-rbf.toml");
    let mut description = Description::read(&file).unwrap();
    description.outputs = vec!["controller.e".into(), "controller.u".into()];
    let plan = Plan::new(&description).unwrap();
    group.bench_function("fmu-master", |b| {
        b.iter_batched(
            || plan.simulate(&[], &Messages::default()).unwrap(),
            |simulation| {
                let observe = |row: &_| {
                    black_box(row);
                    true
                };
                simulation.run(observe).unwrap()
            },
            BatchSize::PerIteration,
        );
    });
    group.finish();
}

criterion_group!(benches, hosts);
criterion_main!(benches);
