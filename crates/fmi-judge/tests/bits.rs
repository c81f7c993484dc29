//! The crate `fmi` and `fmu-master` get bit-identical results from our FMUs. Requires the FMUs of
//! `cargo fmu export`.

use std::path::Path;

use fmi_judge::{ClosedLoop, Fmus, time};
use fmu_master::{Description, Messages, Plan};

#[test]
fn fmi_and_fmu_master_give_bit_identical_results() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = root.join("examples/closed-loop/pid-rbf.toml");
    let mut description = Description::read(&file).unwrap();
    description.outputs = vec!["controller.e".into(), "controller.u".into()];
    let plan = Plan::new(&description).unwrap();
    let columns = ["controller.e", "controller.u"].map(|name| plan.place(name).unwrap());
    let mut ours = Vec::new();
    let simulation = plan.simulate(&[], &Messages::default()).unwrap();
    let finished = simulation.run(|row| {
        ours.push(columns.map(|column| row.number(column).to_bits()));
        true
    });
    finished.unwrap();

    let mut judge = ClosedLoop::new(&Fmus::open());
    assert_eq!(ours.len(), 20_000);
    for (k, ours) in (0..).zip(ours) {
        assert_eq!(ours, judge.step(time(k)).map(f64::to_bits), "step {k}");
    }
}
