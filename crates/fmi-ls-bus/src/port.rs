//! The connection of an FMU to a CAN bus: variables to nest in a model.

use alloc::vec::Vec;

use fmu_derive::Variables;
use fmu_description::Clock;

use crate::error_state::ErrorState;
use crate::operation::*;
use crate::read::{Operations, operations};
use crate::write::WriteError;

/// Maximum size of the Binary variables of a [`Port`] (bytes).
pub const MAX_SIZE: usize = 2048;

/// The four variables of a network terminal.
///
/// Operations go out when the clock `Tx_Clock` ticks: [`send`](Self::send) asks the host to let it tick at once, that is
/// at the same time, but after the present instant. A model that is a node of a bus nests a [`CanNode`], which has one.
#[derive(Debug, Clone, Default, PartialEq, Variables)]
#[variables(crate = fmu_description)]
pub struct Port {
    /// Operations from the bus
    #[input(
        name = "Rx_Data",
        network = "Rx_Data",
        clocks(Rx_Clock),
        max_size = MAX_SIZE,
        mime_type = "application/org.fmi-standard.fmi-ls-bus.can; version=\"1.0.0\""
    )]
    pub rx_data: Vec<u8>,
    /// Operations to the bus
    #[output(
        name = "Tx_Data",
        network = "Tx_Data",
        clocks(Tx_Clock),
        max_size = MAX_SIZE,
        mime_type = "application/org.fmi-standard.fmi-ls-bus.can; version=\"1.0.0\""
    )]
    pub tx_data: Vec<u8>,
    /// Ticks when operations come from the bus
    #[input(name = "Rx_Clock", network = "Rx_Clock")]
    pub rx_clock: Clock,
    /// Ticks when operations go to the bus
    #[input(name = "Tx_Clock", network = "Tx_Clock", countdown)]
    pub tx_clock: Clock,
}

impl Port {
    /// Whether operations wait for the tick of `Tx_Clock` that [`send`](Self::send) has asked for. After the tick, the clock
    /// has no interval.
    fn is_sending(&self) -> bool {
        self.tx_clock.interval() == Some(0.0)
    }

    /// Begin an instant: what is sent at a tick that [`tick_after`](Self::tick_after) has asked for does not contain what
    /// was sent before.
    pub fn begin(&mut self) {
        if self.tx_clock.is_active() && !self.is_sending() {
            self.tx_data.clear();
        }
    }

    /// What has arrived at this instant; nothing unless `Rx_Clock` ticks.
    pub fn received(&self) -> &[u8] {
        if self.rx_clock.is_active() { &self.rx_data } else { &[] }
    }

    /// Send an operation.
    ///
    /// # Errors
    ///
    /// If an argument is not allowed, or the operation does not fit into the [maximum size](MAX_SIZE) with those that
    /// are sent at the same instant, nothing is sent.
    pub fn send(&mut self, operation: &Operation<'_>) -> Result<(), WriteError> {
        if self.tx_clock.is_active() {
            return operation.append(&mut self.tx_data, MAX_SIZE);
        }
        if !self.is_sending() {
            self.tx_data.clear();
        }
        operation.append(&mut self.tx_data, MAX_SIZE)?;
        self.tx_clock = Clock::after(0.0);
        Ok(())
    }

    /// Let `Tx_Clock` tick after this time (s), unless operations go out before; the last call of an instant.
    pub fn tick_after(&mut self, seconds: f64) {
        if self.tx_clock.is_active() || !self.is_sending() {
            self.tx_clock = Clock::after(seconds.max(f64::MIN_POSITIVE));
        }
    }
}

/// A node of a CAN bus.
///
/// ```ignore
/// /// Sensor on a CAN bus
/// #[derive(Model)]
/// #[model(clocked)]
/// pub struct Sensor {
///     /// angle
///     #[input(unit = "rad")]
///     theta: f64,
///     /// ticks every millisecond
///     #[input(constant, interval = 0.001)]
///     sample: Clock,
///     #[nested]
///     can: CanNode,
/// }
///
/// impl Clocked for Sensor {
///     fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
///         if self.sample.is_active() {
///             self.can.transmit(Frame::can(Id::Standard(0x100), &self.theta.to_le_bytes()))?;
///         }
///         Ok(())
///     }
/// }
/// ```
///
/// It tells the bus its baud rate and what becomes of frames that lose the arbitration before its first frame, and
/// again when they have changed. It counts errors as [`ErrorState`] does, and reports its status.
///
/// Two nodes can also be connected with each other, without a bus. Frames then arrive at once.
#[derive(Debug, Clone, PartialEq, Variables)]
#[variables(crate = fmu_description, default)]
pub struct CanNode {
    /// The variables of the terminal.
    #[nested(flatten)]
    pub port: Port,
    /// Whether the bus confirms frames
    #[parameter(name = "BusNotifications", network = "Configuration.BusNotifications")]
    pub notifications: bool,
    /// Baud rate in bit/s; 0 for the one of the bus
    #[parameter(start = 500_000)]
    pub baud_rate: u32,
    /// Baud rate of the data of CAN FD in bit/s; 0 for the one of the bus
    #[parameter]
    pub fd_baud_rate: u32,
    /// What becomes of a frame that loses the arbitration
    #[parameter]
    pub arbitration_lost: ArbitrationLostBehavior,
    /// The last three, as the bus was told.
    configured: [u32; 3],
    errors: ErrorState,
    unconfirmed: u32,
}

impl Default for CanNode {
    fn default() -> Self {
        Self {
            port: Port::default(),
            notifications: false,
            baud_rate: 500_000,
            fd_baud_rate: 0,
            arbitration_lost: ArbitrationLostBehavior::default(),
            configured: [0; 3],
            errors: ErrorState::default(),
            unconfirmed: 0,
        }
    }
}

impl CanNode {
    /// The frames that have arrived at this instant.
    ///
    /// It counts errors and confirmations, and answers malformed operations by `FormatError`, so call it once in each
    /// tick.
    pub fn receive(&mut self) -> Frames<'_> {
        self.port.begin();
        let (mut changed, rx_data) = (None, core::mem::take(&mut self.port.rx_data));
        let received = if self.port.rx_clock.is_active() { &rx_data[..] } else { &[] };
        for operation in operations(received) {
            match operation {
                Ok(operation) => {
                    changed = self.errors.count(&operation).or(changed);
                    self.unconfirmed -= u32::from(self.unconfirmed > 0 && answers(&operation));
                }
                Err(error) => {
                    let data = &error.bytes[..error.bytes.len().min(MAX_SIZE / 2)];
                    // A bus that sends more errors than fit into an answer learns of the first ones.
                    _ = self.port.send(&Operation::FormatError { data });
                }
            }
        }
        self.port.rx_data = rx_data;
        if let Some(status) = changed {
            _ = self.port.send(&Operation::Status(status));
        }
        Frames(operations(self.port.received()))
    }

    /// All operations that have arrived at this instant, without malformed ones.
    pub fn operations(&self) -> impl Iterator<Item = Operation<'_>> {
        operations(self.port.received()).flatten()
    }

    /// Transmit a frame, unless the node is bus off.
    ///
    /// # Errors
    ///
    /// If the format does not allow the identifier or the length of the data, or if the frame does not fit into the
    /// [maximum size](MAX_SIZE) with those that go out at the same instant, it is not transmitted.
    pub fn transmit(&mut self, frame: Frame<'_>) -> Result<(), WriteError> {
        if self.status() == Status::BusOff {
            return Ok(());
        }
        self.configure()?;
        self.port.send(&Operation::Transmit(frame))?;
        self.unconfirmed += u32::from(self.notifications);
        Ok(())
    }

    /// Send any other operation, such as `Wakeup`.
    ///
    /// # Errors
    ///
    /// As [`transmit`](Self::transmit).
    pub fn send(&mut self, operation: &Operation<'_>) -> Result<(), WriteError> {
        self.port.send(operation)
    }

    /// The number of frames that the bus has not yet confirmed; 0 if it does not confirm frames.
    pub fn unconfirmed(&self) -> u32 {
        self.unconfirmed
    }

    /// The error state.
    pub fn status(&self) -> Status {
        self.errors.status()
    }

    /// Take part again after the node was bus off.
    ///
    /// # Errors
    ///
    /// As [`transmit`](Self::transmit).
    pub fn recover(&mut self) -> Result<(), WriteError> {
        self.errors = ErrorState::default();
        self.unconfirmed = 0;
        self.port.send(&Operation::Status(self.status()))
    }

    /// Tell the bus what it does not know yet.
    fn configure(&mut self) -> Result<(), WriteError> {
        let wanted = [self.baud_rate, self.fd_baud_rate, self.arbitration_lost as u32];
        let settings = [
            Configuration::BaudRate(self.baud_rate),
            Configuration::FdBaudRate(self.fd_baud_rate),
            Configuration::ArbitrationLost(self.arbitration_lost),
        ];
        for (i, setting) in settings.into_iter().enumerate() {
            if wanted[i] != 0 && wanted[i] != self.configured[i] {
                self.port.send(&Operation::Configuration(setting))?;
                self.configured[i] = wanted[i];
            }
        }
        Ok(())
    }
}

/// Iterator over the frames that have arrived, by [`CanNode::receive`].
#[derive(Debug, Clone)]
pub struct Frames<'a>(Operations<'a>);

impl<'a> Iterator for Frames<'a> {
    type Item = Frame<'a>;

    fn next(&mut self) -> Option<Self::Item> {
        self.0.find_map(|operation| match operation {
            Ok(Operation::Transmit(frame)) => Some(frame),
            _ => None,
        })
    }
}

/// Whether an operation says what has become of a frame of the node.
fn answers(operation: &Operation<'_>) -> bool {
    matches!(
        operation,
        Operation::Confirm { .. }
            | Operation::ArbitrationLost { .. }
            | Operation::BusError { is_sender: true, .. }
    )
}
