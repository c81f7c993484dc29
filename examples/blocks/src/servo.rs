use control_blocks::{FirstOrder, Pid, RateLimiter, Saturation, Table1};
use fmu_export::prelude::*;

/// Cascade of a position and a speed controller for a drive, with friction compensation from a calibration file
#[derive(Model)]
#[model(sample_time = 0.001, stop_time = 5)]
pub struct Servo {
    /// Set-point of the angle
    #[input(unit = "rad")]
    r: f64,
    /// Measured angle
    #[input(unit = "rad")]
    angle: f64,
    /// Measured speed
    #[input(unit = "rad/s")]
    speed: f64,
    /// Whether the controller drives, otherwise `manual_torque`
    #[input(start = true)]
    automatic: bool,
    /// Torque by hand
    #[input(unit = "N.m")]
    manual_torque: f64,
    /// Torque of the motor
    #[output(unit = "N.m")]
    torque: f64,
    /// Set-point of the speed
    #[output(unit = "rad/s")]
    speed_set_point: f64,
    #[nested(rising(start = 2, unit = "rad/s"), falling(start = 2, unit = "rad/s"))]
    ramp: RateLimiter,
    #[nested(time_constant(start = 0.002))]
    speed_filter: FirstOrder,
    #[nested(
        kp(start = 8, unit = "1/s"),
        u_min(start = -20, unit = "rad/s"),
        u_max(start = 20, unit = "rad/s")
    )]
    position: Pid,
    #[nested(
        kp(start = 0.5, min = 0, unit = "N.m.s/rad"),
        ki(start = 5, min = 0, unit = "N.m/rad"),
        u_min(start = -10, unit = "N.m"),
        u_max(start = 10, unit = "N.m")
    )]
    velocity: Pid,
    #[nested(lower(start = -5, unit = "N.m"), upper(start = 5, unit = "N.m"))]
    motor: Saturation,
    /// Torque of friction (N.m) by speed (rad/s), from the file; no variable of the FMU.
    friction: Table1<4>,
}

impl Simulate for Servo {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        let file = "friction.csv";
        self.friction.read_csv(file, &start.read_resource(file)?)?;
        self.ramp.settle(self.angle);
        self.speed_filter.settle(self.speed);
        Ok(())
    }

    fn step(&mut self, _time: f64, ts: f64) -> Result<(), ModelError> {
        let speed = self.speed_filter.update(self.speed, ts);
        let r = self.ramp.update(self.r, ts);
        self.speed_set_point = self.position.update(r, self.angle, ts);
        let friction = self.friction.value(self.speed_set_point);
        if self.automatic {
            let u = self.velocity.update(self.speed_set_point, speed, ts);
            self.torque = self.motor.value(u + friction);
            self.velocity.back_calculate(self.torque - friction, ts);
        } else {
            self.torque = self.motor.value(self.manual_torque);
            self.velocity.track(self.torque - friction, self.speed_set_point, speed, ts);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use fmu_export::testing::Driver;

    use super::*;

    fn servo() -> Driver<Servo> {
        Driver::<Servo>::new().with_resources(concat!(env!("CARGO_MANIFEST_DIR"), "/resources"))
    }

    /// Runs a drive with an inertia of 0.01 kg.m2 and the friction of the file up to a time (s).
    fn run(servo: &mut Driver<Servo>, time: f64) -> Result<(), ModelError> {
        let friction = |speed: f64| servo_friction().value(speed);
        let steps = (time * 1000.0) as usize;
        for _ in 0..steps {
            servo.step(0.001)?;
            servo.speed += 0.001 / 0.01 * (servo.torque - friction(servo.speed));
            servo.angle += 0.001 * servo.speed;
        }
        Ok(())
    }

    fn servo_friction() -> Table1<4> {
        Table1 { x: [-100.0, -1.0, 1.0, 100.0], y: [-1.2, -0.4, 0.4, 1.2], ..Table1::default() }
    }

    #[test]
    fn the_angle_follows_the_ramp_and_reaches_its_set_point() -> Result<(), ModelError> {
        let mut servo = servo();
        servo.r = 4.0;
        run(&mut servo, 1.0)?;
        assert!((servo.speed - 2.0).abs() < 0.01, "{}", servo.speed);
        run(&mut servo, 3.0)?;
        assert!((servo.angle - 4.0).abs() < 1e-3, "{}", servo.angle);
        Ok(())
    }

    #[test]
    fn the_torque_does_not_jump_when_the_controller_takes_over() -> Result<(), ModelError> {
        let mut servo = servo();
        servo.automatic = false;
        servo.manual_torque = 0.6;
        (servo.r, servo.angle) = (1.0, 1.0);
        for _ in 0..100 {
            servo.step(0.001)?;
        }
        servo.automatic = true;
        servo.step(0.001)?;
        assert!((servo.torque - 0.6).abs() < 1e-9, "{}", servo.torque);
        Ok(())
    }

    #[test]
    fn start_values_of_blocks_are_those_of_the_attribute() -> Result<(), ModelError> {
        let mut servo = servo();
        servo.step(0.001)?;
        assert_eq!((servo.velocity.ki, servo.velocity.b, servo.position.u_max), (5.0, 1.0, 20.0));
        servo.set("velocity.kp", 0.75)?;
        assert_eq!(servo.velocity.kp, 0.75);
        Ok(())
    }
}
