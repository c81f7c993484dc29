//! The control loop of the paper over a CAN bus: sensor, controllers, actuator, other traffic, and the bus.
//!
//! ```sh
//! cargo fmu export --fmi 3.0 --package can --out target/examples
//! cargo fmu simulate examples/can/pid.toml --csv target/can.csv
//! ```
#![forbid(unsafe_code)]

mod actuator;
mod bus;
mod controller;
mod sensor;
mod traffic;

pub use actuator::ForceActuator;
pub use bus::CanBus;
pub use controller::{CanIpidRbf, CanPid, CanPidRbf};
pub use sensor::AngleSensor;
pub use traffic::CanTraffic;

fmu_export::export!(AngleSensor, CanPid, CanPidRbf, CanIpidRbf, ForceActuator, CanTraffic, CanBus);

/// The number in a frame, unless it has another length.
fn number(frame: &fmi_ls_bus::Frame) -> Option<f64> {
    frame.data.try_into().ok().map(f64::from_le_bytes)
}
