//! The models of this package. `cargo fmu export` makes an FMU of each.

@plant
mod plant;

@end
use fmu_export::prelude::*;

@c
/// `struct pi` of `c/pi.h`: the same fields in the same order. Each instance of the FMU has its own, which is saved and
/// restored with its state.
#[repr(C)]
#[derive(Variables)]
struct PiState {
    /// proportional gain
    #[parameter(tunable, start = 0.2, min = 0, unit = "V.s/rad")]
    kp: f64,
    /// integral gain
    #[parameter(tunable, start = 0.4, min = 0, unit = "V/rad")]
    ki: f64,
    /// limit of the voltage, both ways
    #[parameter(tunable, start = 24, min = 0, unit = "V")]
    u_max: f64,
    // A field without an attribute is not a variable of the FMU, but part of its state.
    integral: f64,
}

// SAFETY: the function is the one of `c/pi.h`, and uses nothing but its arguments.
unsafe extern "C" {
    safe fn pi_step(pi: &mut PiState, r: f64, y: f64, ts: f64) -> f64;
}

@end
/// Sampled PI controller for the speed of a motor
#[derive(Model)]
#[model(sample_time = self.ts, stop_time = 2, step_size = 0.01)]
pub struct MyController {
    /// set-point of the speed
    #[input(unit = "rad/s")]
    r: f64,
    /// measured speed
    #[input(unit = "rad/s")]
    y: f64,
    /// voltage of the motor
    #[output(unit = "V")]
    u: f64,
@no c
    /// proportional gain
    #[parameter(tunable, start = 0.2, min = 0, unit = "V.s/rad")]
    kp: f64,
    /// integral gain
    #[parameter(tunable, start = 0.4, min = 0, unit = "V/rad")]
    ki: f64,
    /// limit of the voltage, both ways
    #[parameter(tunable, start = 24, min = 0, unit = "V")]
    u_max: f64,
@end
    /// sample time
    #[parameter(start = 0.01, min = 1e-6, unit = "s")]
    ts: f64,
@c
    #[nested(flatten)]
    pi: PiState,
@no c
    // A field without an attribute is not a variable of the FMU, but part of its state.
    integral: f64,
@end
}

impl Simulate for MyController {
    /// Takes a sample: computes the outputs from the inputs.
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
@c
        self.u = pi_step(&mut self.pi, self.r, self.y, self.ts);
@no c
        let error = self.r - self.y;
        let integral = self.integral + self.ki * self.ts * error;
        let u = self.kp * error + integral;
        self.u = u.clamp(-self.u_max, self.u_max);
        // Anti-windup: the integrator is held while the output saturates.
        if self.u == u {
            self.integral = integral;
        }
@end
        Ok(())
    }
}

@plant
export!(MyController, plant::Plant);
@no plant
export!(MyController);
@end

#[cfg(test)]
mod tests {
    use fmu_export::testing::Driver;

    use super::*;

@plant
    #[test]
    fn the_motor_reaches_the_set_point() -> Result<(), ModelError> {
        let mut controller = Driver::<MyController>::new();
        let mut plant = Driver::<plant::Plant>::new();
        controller.r = 100.0;
        for _ in 0..200 {
            controller.y = plant.y;
            controller.step(0.01)?;
            plant.u = controller.u;
            plant.step(0.01)?;
        }
        assert!((plant.y - 100.0).abs() < 1.0, "{}", plant.y);
        Ok(())
    }
@no plant
    #[test]
    fn a_small_error_is_controlled_by_both_gains() -> Result<(), ModelError> {
        let mut controller = Driver::<MyController>::new();
        controller.r = 10.0;
        controller.step(0.01)?;
        let expected = (0.2 + 0.4 * 0.01) * 10.0; // (kp + ki ts) e
        assert!((controller.u - expected).abs() < 1e-12, "{}", controller.u);
        Ok(())
    }
@end
}
