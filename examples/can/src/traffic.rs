//! Other traffic.

use fmi_ls_bus::{CanNode, Frame, Id};
use fmu_export::prelude::*;

/// Node that sends frames of 8 bytes at a constant rate over a CAN bus
#[derive(Model)]
#[model(clocked)]
pub struct CanTraffic {
    /// Ticks when a frame is sent
    #[input(calculated, interval = self.period, shift = self.offset)]
    sample: Clock,
    /// Time between two frames
    #[parameter(start = 0.001, min = 1e-6, unit = "s")]
    period: f64,
    /// Time of the first frame
    #[parameter(min = 0, unit = "s")]
    offset: f64,
    /// Identifier of the frames
    #[parameter(start = 0x80, max = 0x7ff)]
    id: u16,
    #[nested]
    can: CanNode,
    /// The number of frames, which is in the next one.
    sent: u64,
}

impl Clocked for CanTraffic {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        self.can.receive();
        if self.sample.is_active() {
            self.can.transmit(Frame::can(Id::Standard(self.id), &self.sent.to_le_bytes()))?;
            self.sent += 1;
        }
        Ok(())
    }
}
