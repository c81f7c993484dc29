//! Simulations on several threads.

#[path = "../../../tests/fmus.rs"]
mod fmus;

use std::thread;

use fmu_cosim::{Description, Plan, Simulation};

fn plan() -> Plan {
    let file = fmus::root().join("examples/closed-loop/pid.toml");
    let mut description = Description::read(&file).unwrap();
    description.stop = 1.0;
    Plan::new(&description).unwrap()
}

#[test]
fn simulations_of_one_plan_run_on_several_threads() {
    let plan = plan();
    let run = |simulation: Simulation<'_>| {
        let mut rows = Vec::new();
        simulation.run(|_, row| rows.push(row.to_vec())).unwrap();
        rows
    };
    let expected = run(plan.simulate(&[]).unwrap());
    assert_eq!(expected.len(), 1000);
    thread::scope(|scope| {
        let runs: Vec<_> = (0..4)
            .map(|_| plan.simulate(&[]).unwrap())
            .map(|simulation| scope.spawn(|| run(simulation)))
            .collect();
        for rows in runs {
            assert!(rows.join().unwrap() == expected);
        }
    });
}
