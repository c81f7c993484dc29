//! The sensor.

use fmi_ls_bus::{CanNode, Frame, Id};
use fmu_export::prelude::*;

/// Sensor that sends the angle over a CAN bus
#[derive(Model)]
#[model(clocked)]
pub struct AngleSensor {
    /// Angle
    #[input(unit = "rad")]
    theta: f64,
    /// Time when the last angle was sent
    #[output(unit = "s", discrete, initially_from())]
    sent: f64,
    /// Ticks every sample time
    #[input(calculated, interval = self.ts)]
    sample: Clock,
    /// Sample time
    #[parameter(start = 0.001, min = 1e-6, unit = "s")]
    ts: f64,
    /// Identifier of the frames, which have the angle as their 8 bytes
    #[parameter(start = 0x100, max = 0x7ff)]
    id: u16,
    #[nested]
    can: CanNode,
}

impl Clocked for AngleSensor {
    fn tick(&mut self, time: f64) -> Result<(), ModelError> {
        self.can.receive();
        if self.sample.is_active() {
            self.can.transmit(Frame::can(Id::Standard(self.id), &self.theta.to_le_bytes()))?;
            self.sent = time;
        }
        Ok(())
    }
}
