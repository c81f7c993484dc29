//! What the caller of a simulation can rely on.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::thread;

use fmu_cosim::{Description, Plan};

fn plan() -> Plan {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut description = Description::read(&root.join("examples/closed-loop/pid.toml")).unwrap();
    description.stop = 1.0;
    Plan::new(&description).expect("`cargo fmu export` writes the FMUs")
}

/// The calls of FMUs are guarded against panics, the caller's own code is not.
#[test]
fn a_panic_of_the_observer_is_not_taken_for_one_of_an_fmu() {
    let plan = plan();
    let simulation = plan.simulate(&[]).unwrap();
    let run = AssertUnwindSafe(|| simulation.run(|_, _| panic!("mine")));
    let panic = catch_unwind(run).unwrap_err();
    assert_eq!(panic.downcast_ref(), Some(&"mine"));
}

#[test]
fn runs_of_one_plan_go_on_in_several_threads() {
    let plan = plan();
    let run = || {
        let mut rows = Vec::new();
        let simulation = plan.simulate(&[]).unwrap();
        simulation.run(|_, row| rows.push(row.to_vec())).unwrap();
        rows
    };
    let expected = run();
    assert_eq!(expected.len(), 1000);
    thread::scope(|scope| {
        let runs: Vec<_> = (0..4).map(|_| scope.spawn(run)).collect();
        for rows in runs {
            assert!(rows.join().unwrap() == expected);
        }
    });
}
