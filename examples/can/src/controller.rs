//! The controllers of the paper as nodes of a CAN bus.

use fmi_ls_bus::{CanNode, Frame, Id, WriteError};
use fmu_export::prelude::*;

use crate::number;

/// The connection of a controller: set-point and disturbance as signals, angle and force as frames.
#[derive(Variables)]
struct Link {
    /// Set-point of the angle
    #[input(unit = "rad")]
    r: f64,
    /// Disturbance, added to the measured angle
    #[input(unit = "rad")]
    d: f64,
    /// Measured angle that has arrived last
    #[output(unit = "rad", discrete, initially_from())]
    y: f64,
    /// Time when it has arrived
    #[output(unit = "s", discrete, initially_from())]
    arrival: f64,
    /// Identifier of the frames with the angle
    #[parameter(start = 0x100, max = 0x7ff)]
    angle_id: u16,
    /// Identifier of the frames with the force
    #[parameter(start = 0x101, max = 0x7ff)]
    force_id: u16,
    #[nested]
    can: CanNode,
}

impl Link {
    /// Whether an angle has arrived.
    fn receive(&mut self, time: f64) -> bool {
        let id = self.angle_id.into();
        let angles = self.can.receive().filter(|frame| frame.id.value() == id);
        let Some(y) = angles.filter_map(|frame| number(&frame)).last() else { return false };
        (self.y, self.arrival) = (y, time);
        true
    }

    fn transmit(&mut self, force: f64) -> Result<(), WriteError> {
        self.can.transmit(Frame::can(Id::Standard(self.force_id), &force.to_le_bytes()))
    }
}

/// PID controller on a CAN bus, which takes a sample when an angle arrives
#[derive(Model)]
#[model(clocked)]
pub struct CanPid {
    #[nested(flatten)]
    link: Link,
    #[nested(flatten)]
    law: pendulum_control::Pid,
}

impl Clocked for CanPid {
    fn tick(&mut self, time: f64) -> Result<(), ModelError> {
        if self.link.receive(time) {
            self.link.transmit(self.law.sample(self.link.r, self.link.y, self.link.d))?;
        }
        Ok(())
    }
}

/// PID controller on a CAN bus with an RBF network, which takes a sample when an angle arrives
#[derive(Model)]
#[model(clocked)]
pub struct CanPidRbf {
    #[nested(flatten)]
    link: Link,
    #[nested(flatten)]
    law: pendulum_control::PidRbf<16>,
}

impl Clocked for CanPidRbf {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.law.network.reset();
        Ok(())
    }

    fn reconfigure(&mut self) -> Result<(), ModelError> {
        self.law.network.resize();
        Ok(())
    }

    fn tick(&mut self, time: f64) -> Result<(), ModelError> {
        if self.link.receive(time) {
            self.link.transmit(self.law.sample(self.link.r, self.link.y, self.link.d))?;
        }
        Ok(())
    }
}

/// PID controller on a CAN bus with a leaking integral, and an RBF network that integrates for it
#[derive(Model)]
#[model(clocked)]
pub struct CanIpidRbf {
    #[nested(flatten)]
    link: Link,
    #[nested(flatten)]
    controller: pendulum_control::IpidRbf<16>,
}

impl Clocked for CanIpidRbf {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.controller.law.network.reset();
        Ok(())
    }

    fn reconfigure(&mut self) -> Result<(), ModelError> {
        self.controller.law.network.resize();
        Ok(())
    }

    fn tick(&mut self, time: f64) -> Result<(), ModelError> {
        if self.link.receive(time) {
            let Link { r, y, d, .. } = self.link;
            self.link.transmit(self.controller.sample(r, y, d, 0.0))?;
        }
        Ok(())
    }
}
