//! Operations of [FMI-LS-BUS](https://modelica.github.io/fmi-ls-bus/main/), the layered standard of FMI 3.0 for buses:
//! network abstraction (low cut) for CAN, CAN FD and CAN XL.
//!
//! FMUs on a bus exchange Binary variables, which hold any number of operations one after another: frames to transmit,
//! and what the bus answers. [`Operation`] is one of them; [`operations`] reads all of a variable, and
//! [`append`](Operation::append) adds one:
//!
//! ```
//! use fmi_ls_bus::{Frame, Id, Operation, operations};
//!
//! let mut tx_data = Vec::new();
//! let frame = Frame::can(Id::Standard(0x123), &[1, 2, 3]);
//! Operation::Transmit(frame).append(&mut tx_data, 2048)?;
//! Operation::Status(fmi_ls_bus::Status::ErrorActive).append(&mut tx_data, 2048)?;
//!
//! let mut received = operations(&tx_data);
//! assert_eq!(received.next(), Some(Ok(Operation::Transmit(frame))));
//! assert_eq!(received.count(), 1);
//! # Ok::<(), fmi_ls_bus::WriteError>(())
//! ```
//!
//! [`Bus`] is the bus between them: arbitration, baud rates, the bits of frames, losses.
//!
//! The layout of operations is that of version 1 of the standard: each begins with its code and its length, 4 bytes
//! each, and all numbers are little endian. To read and to write operations allocates nothing but in the buffer of the
//! caller, and no bytes cause a panic.
//!
//! # Features
//!
//! - `fmi`: `CanNode` and `Port` derive `Variables`, so that a model becomes a node of a bus, or a bus, by `#[nested]`.
//! - `serde`: the state of a [`Bus`] can be saved, so that it can be a field of a model.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod bus;
mod error_state;
mod operation;
#[cfg(feature = "fmi")]
mod port;
mod read;
mod timing;
mod write;

pub use bus::*;
pub use error_state::*;
pub use operation::*;
#[cfg(feature = "fmi")]
pub use port::*;
pub use read::*;
pub use timing::*;
pub use write::*;

/// MIME type of the Binary variables of CAN, CAN FD and CAN XL.
pub const CAN_MIME_TYPE: &str = "application/org.fmi-standard.fmi-ls-bus.can; version=\"1.0.0\"";
