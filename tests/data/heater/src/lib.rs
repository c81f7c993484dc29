//! A controller in C with global variables, in the style of Embedded Coder.

use fmu_export::c::Globals;
use fmu_export::prelude::*;

fmu_export::c_library!(HeaterCode = "heater");

#[repr(C)]
struct ExtU {
    r: f64,
    y: f64,
}

#[repr(C)]
struct ExtY {
    u: f64,
}

#[repr(C)]
struct P {
    kp: f64,
    ki: f64,
}

unsafe extern "C" {
    static mut rtU: ExtU;
    static rtY: ExtY;
    static mut rtP: P;
    fn heater_initialize();
    fn heater_step();
}

/// Heater control
#[derive(Model)]
#[model(sample_time = 0.01, stop_time = 2, step_size = 0.01)]
pub struct Heater {
    /// set-point
    #[input(unit = "K")]
    r: f64,
    /// measured temperature
    #[input(unit = "K")]
    y: f64,
    /// power
    #[output(unit = "W")]
    u: f64,
    /// proportional gain
    #[parameter(tunable, start = 2, unit = "W/K")]
    kp: f64,
    code: Globals<HeaterCode>,
}

impl Simulate for Heater {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        // SAFETY: as declared in heater.h, and used in `run` only.
        self.code.run(|| unsafe { heater_initialize() });
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        // SAFETY: as above.
        self.u = self.code.run(|| unsafe {
            rtU = ExtU { r: self.r, y: self.y };
            rtP.kp = self.kp;
            heater_step();
            rtY.u
        });
        Ok(())
    }
}

export!(Heater);

#[cfg(test)]
mod tests {
    use std::thread;

    use fmu_export::testing::Driver;

    use super::*;

    fn run(r: f64) -> Vec<f64> {
        let mut heater = Driver::<Heater>::new();
        heater.r = r;
        let step = |_| heater.step(0.01).map(|()| heater.u);
        (0..150).map(step).collect::<Result<_, _>>().unwrap()
    }

    #[test]
    fn interleaved_instances_have_their_own_variables() {
        let [alone, other] = [1.0, 3.0].map(run);
        let mut both = [1.0, 3.0].map(|r| {
            let mut heater = Driver::<Heater>::new();
            heater.r = r;
            heater
        });
        for expected in alone.iter().zip(&other) {
            both.iter_mut().for_each(|heater| heater.step(0.01).unwrap());
            assert_eq!((&both[0].u, &both[1].u), expected);
        }
        assert_ne!(alone, other);
    }

    #[test]
    fn instances_on_several_threads_do_not_disturb_each_other() {
        let alone = run(1.0);
        thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| assert_eq!(run(1.0), alone));
            }
        });
    }

    #[test]
    fn a_copy_has_the_values_of_its_original_and_goes_its_own_way() {
        let mut original = Globals::<HeaterCode>::default();
        let set = |globals: &mut Globals<HeaterCode>, u| {
            globals.run(|| unsafe { rtU.r = u });
        };
        let get = |globals: &mut Globals<HeaterCode>| globals.run(|| unsafe { rtU.r });
        set(&mut original, 1.0);
        let mut copy = original.clone();
        set(&mut copy, 2.0);
        assert_eq!((get(&mut original), get(&mut copy)), (1.0, 2.0));
        original.clone_from(&copy);
        assert_eq!(get(&mut original), 2.0);
        assert_eq!(get(&mut Globals::default()), 0.0);
    }
}
