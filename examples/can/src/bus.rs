//! The bus.

use fmi_ls_bus::{Bus, Operation, Port};
use fmu_export::prelude::*;

/// The number of ports.
const PORTS: usize = 8;

/// CAN bus with 8 ports, for CAN and CAN FD
#[derive(Model)]
#[model(clocked, bus_simulation)]
pub struct CanBus {
    #[nested]
    node: [Port; 8],
    /// Number of ports that are connected, from the first
    #[parameter(start = 8, min = 1, max = 8)]
    nodes: u8,
    #[nested(flatten)]
    bus: Bus,
    #[log]
    log: Log,
}

impl Clocked for CanBus {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.bus.reset(self.nodes.into());
        Ok(())
    }

    fn tick(&mut self, time: f64) -> Result<(), ModelError> {
        let before = self.bus.mismatch();
        let (bus, log) = (&mut self.bus, &self.log);
        for i in 0..self.nodes.into() {
            self.node[i].begin();
            let received = std::mem::take(&mut self.node[i].rx_data);
            if self.node[i].rx_clock.is_active() {
                bus.receive(time, i, &received, |to, sent| send(&mut self.node, log, to, &sent));
            }
            self.node[i].rx_data = received;
        }
        bus.advance(time, |to, sent| send(&mut self.node, log, to, &sent));
        if let Some(mismatch) = bus.mismatch().filter(|_| before.is_none()) {
            log.warning(format_args!("{mismatch}: no frame arrives"));
        }
        let Some(next) = bus.next_event() else { return Ok(()) };
        self.node[..self.nodes.into()].iter_mut().for_each(|port| port.tick_after(next - time));
        Ok(())
    }
}

/// Send an operation to a node.
fn send(ports: &mut [Port; PORTS], log: &Log, to: usize, operation: &Operation) {
    if let Err(error) = ports[to].send(operation) {
        log.error(format_args!("node {}: {error}, so it is lost", to + 1));
    }
}
