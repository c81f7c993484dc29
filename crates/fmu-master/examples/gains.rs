//! Simulates a closed loop with three gains, in this process, and prints the largest angle of each.

use std::path::Path;

use anyhow::Result;
use fmu_master::{Description, Literal, Messages, Plan};

fn main() -> Result<()> {
    let description = Description::read(Path::new("examples/closed-loop/pid.toml"))?;
    let plan = Plan::new(&description)?; // loads the FMUs and checks the system
    let angle = plan.place("plant.theta")?;
    for gain in [200.0, 300.0, 400.0] {
        let start = plan.start("controller.pid.kp", &Literal::Real(gain))?;
        let mut largest: f64 = 0.0;
        plan.simulate(&[start], &Messages::default())?.run(|row| {
            largest = largest.max(row.number(angle));
            true // go on
        })?;
        println!("kp = {gain} N/rad: largest angle {largest:.3} rad");
    }
    Ok(())
}
