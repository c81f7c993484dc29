//! The driver with which authors test their models: it does what the FMU does.

use fmu_export::prelude::*;
use fmu_export::testing::Driver;

use crate::driver::*;
use crate::models::*;

const NAN: f64 = f64::NAN;
const INFINITE: f64 = f64::INFINITY;

#[test]
fn a_driver_computes_the_bits_of_the_fmu_and_refuses_what_it_refuses() {
    // Steps that samples and events do not divide.
    let (mut sampled, mut hopper) = (Driver::<Sampled>::new(), Driver::<Hopper>::new());
    let (other, its) = (Instance::running(PLAIN[0], SAMPLED), Instance::new(PLAIN[0], HOPPER));
    ok([its.set(Hopper::DRIVE, 1.5)]);
    its.start(0.0, None);
    assert_eq!(hopper.set("drive", 1.5), Ok(()));
    let bits = |values: [f64; 4]| values.map(f64::to_bits);
    for k in 0..40 {
        for (driven, it) in [(sampled.step(0.3), &other), (hopper.step(0.3), &its)] {
            assert_eq!(driven, Ok(()));
            it.steps(f64::from(k) * 0.3, 0.3);
        }
        // Three times, count, y; h, v, rests, bounces, bounced.
        let (found, its_found) = (sampled.outputs(), hopper.outputs());
        let times = [Sampled::TIMES, Sampled::TIMES + 1, Sampled::TIMES + 2, Sampled::Y];
        assert_eq!(
            [found[0], found[1], found[2], found[4]].map(f64::to_bits),
            bits(other.get(times))
        );
        let reals = [Hopper::H, Hopper::V, Hopper::BOUNCED, Hopper::CHANGED];
        let found = [its_found[0], its_found[1], its_found[4], its_found[6]];
        assert_eq!(bits(found), bits(its.get(reals)));
    }
    let (rests, count) = (hopper.get("rests"), sampled.get("count"));
    assert_eq!((rests, count, hopper.time()), (Ok(true.into()), Ok(24.into()), 12.0));

    assert_eq!(sampled.set("failure", REFUSE).and(sampled.set("fails_at", 26)), Ok(()));
    assert_eq!(sampled.step(0.5), Ok(()));
    let words = "step: from t = 12.5 s by 0.5 s: refused by the model";
    assert_eq!(sampled.step(0.5), Err(ModelError::refuse(words)));
    for (name, words) in [
        ("h", "set: h is an output, which only the model sets"),
        ("drag", "set: drag is a fixed parameter, which cannot be set after the initialization"),
        ("trouble", "set: trouble = -1 is refused; expected a finite number from 0 to 5"),
        ("hight", "there is no variable \"hight\"; expected one of drive, trouble, "),
    ] {
        let refused = hopper.set(name, -1).unwrap_err();
        assert!(refused.reason().starts_with(words), "{refused:?}");
    }
}

#[test]
fn a_driver_returns_the_outputs_at_communication_points_from_any_start() {
    let mut sampled = Driver::<Sampled>::new().with_resources(std::env::temp_dir());
    assert!(sampled.set("ts", -1.0).is_ok() && sampled.initialize(2.0).is_err());
    assert_eq!(sampled.set("ts", 0.25).and(sampled.initialize(2.0)), Ok(()));
    let rows = sampled.run(3.0, 0.5).unwrap();
    // Three times, count, y, sum, gain and changes.
    assert_eq!(rows[0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
    assert_eq!(rows[2], [2.25, 2.5, 2.75, 4.0, 1.0, 0.0, 3.0, 0.0]);
    assert_eq!((rows.len(), sampled.time()), (3, 3.0));
    assert!(sampled.initialize(5.0).is_err(), "it is running");
    for (stop, size) in [(4.0, 0.0), (4.0, -1.0), (4.0, NAN), (4.0, INFINITE), (INFINITE, 1.0)] {
        assert!(sampled.run(stop, size).unwrap_err().reason().starts_with("the run is to "));
    }
    assert!(sampled.step(NAN).is_err() && sampled.step(INFINITE).is_err());
    assert_eq!(sampled.time(), 3.0);
    let refused = sampled.set("n", 2).unwrap_err();
    let words = "set: n is not available in FMI 2.0, where the sizes of arrays are fixed";
    assert_eq!(refused.reason(), words);
}
