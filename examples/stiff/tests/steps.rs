//! Steps of stiff models by the code of their FMUs.

use fmu_export::testing::Driver;
use stiff::{Contact, Robertson};

#[test]
fn steps_of_the_implicit_method_allocate_nothing() {
    let mut reaction = Driver::<Robertson>::new();
    let mut mass = Driver::<Contact>::new();
    reaction.initialize(0.0).unwrap();
    mass.initialize(0.0).unwrap();
    // The first step has the memory in which a failed step is undone.
    reaction.step(0.4).unwrap();
    mass.step(0.1).unwrap();
    let steps = || {
        for _ in 0..9 {
            reaction.step(4.4).unwrap();
            mass.step(0.1).unwrap();
        }
    };
    assert_eq!(allocation_counter::measure(steps).count_total, 0);
    assert!((reaction.get("a").unwrap().as_real().unwrap() - 0.7158).abs() < 1e-4);
    assert!((mass.get("x").unwrap().as_real().unwrap() + 9.81e-8).abs() < 1e-12);
}
