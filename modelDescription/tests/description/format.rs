//! The format of the copies of interfaces in binaries, which must not change without a new version.

use fmu_description::Interface;
use fmu_description::hash::checksum;
use fmu_description::interface::{GUID_LENGTH, size, write};
use fmu_export::prelude::*;

use super::clocks::CLOCKS_COPY;

/// The version of the format, and a hash of a copy in it.
const FORMAT: (u32, u128) = (9, 0xc11d79da32a313864824d2e67164fdd2);

/// The same of a copy with a supplement, of the model with clocks of all kinds.
const SUPPLEMENTED: (u32, u128) = (10, 0xdd4566f36a0b25dc1ab5ea4c74792a3d);

/// A model with everything that a copy can have; it never changes.
#[derive(Model)]
#[model(name = "Format", continuous, step = Self::step, stop_time = 3, step_size = 0.5, tolerance = 1e-4)]
struct Everything {
    /// input
    #[input(unit = "N", start = 0.25, min = -1, max = 2, derivative = self.slope, terminal = "loop.u")]
    u: f64,
    slope: f64,
    /// state
    #[output(state, nominal = 10, unit = "m", start = -0.5)]
    x: f64,
    #[derivative(of = x, unit = "m/s", derivative_by(u = 1.0, x = 2.0))]
    x_dot: f64,
    /// zero at an event
    #[event_indicator]
    level: f64,
    /// number of nodes
    #[structural_parameter(start = 2, max = 3)]
    nodes: u64,
    /// positions of the nodes
    #[parameter(tunable, size = "nodes", start = [1, 2, 3])]
    positions: [f32; 3],
    /// a matrix
    #[constant(start = [[1, -2], [300, 4]])]
    matrix: [[i16; 2]; 2],
    /// text of any length
    #[parameter(start = "text")]
    text: String,
    /// bytes
    #[parameter(start = b"\x01\x02", mime_type = "image/png")]
    bytes: Vec<u8>,
    /// whether it is on
    #[local(initially_from("text", "positions"))]
    is_on: bool,
    /// how it is controlled
    #[parameter(start = Law::Closed)]
    law: Law,
    #[log]
    log: Log,
    /// messages on limits
    #[log(category = "limits")]
    limits: Log,
}

/// Form of the control law
#[derive(Clone, Copy, Choice)]
enum Law {
    /// without feedback
    Open,
    /// with feedback
    Closed,
}

impl Everything {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.x += self.slope;
        Ok(())
    }
}

impl Continuous for Everything {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        self.x_dot = self.u;
        Ok(())
    }
}

const INTERFACE: Interface =
    fmu_export::interface::<Everything, { <Everything as Variables>::COUNT }>(None);
static COPY: [u8; size(&INTERFACE)] = write(&INTERFACE);

/// The version of the format of a copy, and a hash of the copy.
fn format(copy: &[u8]) -> (u32, u128) {
    let (header, content) = copy.split_at(24);
    let version = u32::from_le_bytes(header[16..20].try_into().unwrap());
    // Without the GUID and the checksum, which follow from the interface.
    let content = &content[..content.len() - GUID_LENGTH - 16];
    (version, checksum(content))
}

#[test]
fn another_format_has_another_version() {
    assert_eq!(
        (format(&COPY), format(&CLOCKS_COPY)),
        (FORMAT, SUPPLEMENTED),
        "the format of the copies changed: raise VERSION, or SUPPLEMENTED, in modelDescription/src/interface.rs, so that libraries and \
         programs of different versions notice it, and write what was found here"
    );
}
