//! The crate `fmi` and `fmu-cosim` get bit-identical results from our FMUs. Requires the FMUs of
//! `cargo fmu export`.

use std::path::Path;

use fmi::fmi2::instance::InstanceCS;
use fmi_judge::{ClosedLoop, Fmus, time};
use fmu_cosim::{Description, Plan};

#[test]
fn fmi_and_fmu_cosim_give_bit_identical_results() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = root.join("examples/closed-loop/pid-rbf.toml");
    let mut description = Description::read(&file).unwrap();
    description.outputs = vec!["controller.e".into(), "controller.u".into()];
    let plan = Plan::new(&description).unwrap();
    let mut ours = Vec::new();
    let simulation = plan.simulate(&[]).unwrap();
    simulation
        .run(|_, row| ours.push([row[0].to_bits(), row[1].to_bits()]))
        .unwrap();

    let mut judge = ClosedLoop::<InstanceCS>::new(&Fmus::open());
    assert_eq!(ours.len(), 20_000);
    for (k, ours) in (0..).zip(ours) {
        assert_eq!(ours, judge.step(time(k)).map(f64::to_bits), "step {k}");
    }
}
