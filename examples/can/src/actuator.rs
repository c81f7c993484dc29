//! The actuator.

use fmi_ls_bus::CanNode;
use fmu_export::prelude::*;

use crate::number;

/// Actuator that applies the force it gets over a CAN bus, until the next one arrives
#[derive(Model)]
#[model(clocked)]
pub struct ForceActuator {
    /// Force
    #[output(unit = "N", discrete, initially_from())]
    u: f64,
    /// Time when the last force has arrived
    #[output(unit = "s", discrete, initially_from())]
    arrival: f64,
    /// Identifier of the frames with the force
    #[parameter(start = 0x101, max = 0x7ff)]
    id: u16,
    #[nested]
    can: CanNode,
}

impl Clocked for ForceActuator {
    fn tick(&mut self, time: f64) -> Result<(), ModelError> {
        for frame in self.can.receive() {
            if let (true, Some(u)) = (frame.id.value() == self.id.into(), number(&frame)) {
                self.u = u;
                self.arrival = time;
            }
        }
        Ok(())
    }
}
