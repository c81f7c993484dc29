//! A CAN bus: queues, arbitration, baud rates, errors.

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::fmt;

use crate::operation::*;
use crate::read::operations;
use crate::timing::{ERROR_FRAME, FrameBits, INTERMISSION};

/// The number of frames that a node can have in its queue.
pub const QUEUE: usize = 256;

/// Times that differ by less are equal (s).
const INSTANT: f64 = 1e-9;

/// A CAN bus with nodes, which exchange frames of CAN and CAN FD.
///
/// Each node has a queue, whose first frame competes for the bus. When the bus is free, it transmits the frame with the
/// lowest identifier, of error active nodes before error passive ones. The frame occupies the bus for its
/// [bits](FrameBits) at the baud rate that the nodes have configured, and arrives at all other nodes at its end; the
/// sender gets a confirmation. Three bits later, the bus is free again.
///
/// A frame fails with the probability [`loss`](Self::loss), if two nodes have configured different baud rates, or if no
/// other node takes part. It then occupies the bus for 7 bits more, nobody receives it, and all nodes get `BusError`.
///
/// The owner passes the operations of nodes to [`receive`](Self::receive), and calls [`advance`](Self::advance) at each
/// instant at which it did so, and at the [next one](Self::next_event). What the bus sends, it passes to a function
/// `send` with the number of the node.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Bus {
    /// Baud rate in bit/s if no node configures one.
    #[cfg_attr(feature = "fmi", parameter(start = 500_000, min = 1))]
    pub baud_rate: u32,
    /// Baud rate of the data of CAN FD in bit/s if no node configures one.
    #[cfg_attr(feature = "fmi", parameter(start = 2_000_000, min = 1))]
    pub fd_baud_rate: u32,
    /// Probability that a frame fails.
    #[cfg_attr(feature = "fmi", parameter(tunable, min = 0, max = 1, unit = "1"))]
    pub loss: f64,
    /// Seed of the failures.
    #[cfg_attr(feature = "fmi", parameter)]
    pub seed: u64,
    /// How often the bus transmits a frame again that has failed.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub retransmissions: u32,
    /// Whether nodes get confirmations, and notice of errors and lost arbitrations.
    #[cfg_attr(feature = "fmi", parameter(start = true))]
    pub notifications: bool,
    /// Number of frames that were transmitted, also of those that have failed.
    #[cfg_attr(feature = "fmi", output(discrete, initially_from()))]
    pub transmitted: u64,
    /// Number of frames that have failed.
    #[cfg_attr(feature = "fmi", output(discrete, initially_from()))]
    pub failed: u64,
    /// How long frames have occupied the bus, with the bits between them (s).
    #[cfg_attr(feature = "fmi", output(discrete, initially_from(), unit = "s"))]
    pub busy: f64,
    nodes: Vec<Node>,
    transmission: Option<Transmission>,
    /// When the bus is free for the next frame (s).
    free_at: f64,
}

#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Node {
    queue: VecDeque<QueuedFrame>,
    status: Status,
    baud_rate: Option<u32>,
    fd_baud_rate: Option<u32>,
    arbitration_lost: ArbitrationLostBehavior,
}

/// A frame that waits for its transmission.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct QueuedFrame {
    id: Id,
    format: Format,
    data: Vec<u8>,
    /// When the node has passed it on (s).
    arrival: f64,
    /// How often it has failed.
    failures: u32,
}

impl QueuedFrame {
    fn frame(&self) -> Frame<'_> {
        Frame { id: self.id, format: self.format, data: &self.data }
    }
}

/// The transmission of the first frame of a node.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Transmission {
    sender: usize,
    start: f64,
    end: f64,
    /// When the next frame can begin (s).
    free_at: f64,
    error: Option<ErrorCode>,
}

impl Default for Bus {
    fn default() -> Self {
        Self::new(0)
    }
}

impl Bus {
    /// A bus at 500 kbit/s and 2 Mbit/s without losses.
    pub fn new(nodes: usize) -> Self {
        Self {
            baud_rate: 500_000,
            fd_baud_rate: 2_000_000,
            loss: 0.0,
            seed: 0,
            retransmissions: 0,
            notifications: true,
            transmitted: 0,
            failed: 0,
            busy: 0.0,
            nodes: (0..nodes).map(|_| Node::default()).collect(),
            transmission: None,
            free_at: f64::NEG_INFINITY,
        }
    }

    /// Begin anew with so many nodes, at the same settings.
    pub fn reset(&mut self, nodes: usize) {
        let Self { baud_rate, fd_baud_rate, loss, seed, retransmissions, notifications, .. } =
            *self;
        *self = Self {
            baud_rate,
            fd_baud_rate,
            loss,
            seed,
            retransmissions,
            notifications,
            ..Self::new(nodes)
        };
    }

    /// Take the operations that a node, by its number from 0, has sent at the time `now` (s).
    ///
    /// The bus ignores operations that only a bus sends, and all frames of a node that is bus off. It answers malformed
    /// operations, a baud rate of 0 and frames of CAN XL, which it does not simulate, by `FormatError`, and a frame for
    /// which the [queue](QUEUE) of the node is full by `ArbitrationLost`.
    pub fn receive(
        &mut self,
        now: f64,
        node: usize,
        rx_data: &[u8],
        mut send: impl FnMut(usize, Operation<'_>),
    ) {
        let nodes = self.nodes.len();
        let sends = self.transmission.as_ref().is_some_and(|present| present.sender == node);
        let Some(this) = self.nodes.get_mut(node) else { return };
        let mut all = operations(rx_data);
        let mut begin = 0;
        while let Some(operation) = all.next() {
            let bytes = &rx_data[begin..all.offset()];
            begin = all.offset();
            match operation {
                Err(error) => send(node, Operation::FormatError { data: shortened(error.bytes) }),
                Ok(Operation::Transmit(frame)) => match FrameBits::of(&frame) {
                    None => send(node, Operation::FormatError { data: shortened(bytes) }),
                    Some(_) if this.status == Status::BusOff => {}
                    Some(_) if this.queue.len() >= QUEUE => {
                        if self.notifications {
                            send(node, Operation::ArbitrationLost { id: frame.id.value() });
                        }
                    }
                    Some(_) => this.queue.push_back(QueuedFrame {
                        id: frame.id,
                        format: frame.format,
                        data: frame.data.to_vec(),
                        arrival: now,
                        failures: 0,
                    }),
                },
                Ok(Operation::Configuration(configuration)) => match configuration {
                    Configuration::BaudRate(0) | Configuration::FdBaudRate(0) => {
                        send(node, Operation::FormatError { data: shortened(bytes) });
                    }
                    Configuration::BaudRate(rate) => this.baud_rate = Some(rate),
                    Configuration::FdBaudRate(rate) => this.fd_baud_rate = Some(rate),
                    Configuration::XlBaudRate(_) => {}
                    Configuration::ArbitrationLost(behavior) => this.arbitration_lost = behavior,
                },
                Ok(Operation::Status(status)) => {
                    this.status = status;
                    if status == Status::BusOff {
                        // The frame on the bus is transmitted to its end.
                        this.queue.truncate(sends.into());
                    }
                }
                Ok(Operation::Wakeup) => {
                    (0..nodes)
                        .filter(|other| *other != node)
                        .for_each(|other| send(other, Operation::Wakeup));
                }
                Ok(_) => {}
            }
        }
    }

    /// Go on to the time `now` (s): finish what has ended, and begin what can begin.
    ///
    /// Frames that arrive at one instant compete, also if the bus is called several times at it.
    pub fn advance(&mut self, now: f64, mut send: impl FnMut(usize, Operation<'_>)) {
        while let Some(ended) = self.transmission.take_if(|present| present.end <= now + INSTANT) {
            self.finish(&ended, &mut send);
            self.arbitrate(&mut send);
        }
        if self.transmission.as_ref().is_none_or(|present| now <= present.start + INSTANT) {
            self.arbitrate(&mut send);
        }
    }

    /// When the present transmission ends (s), and the bus is to be called again.
    pub fn next_event(&self) -> Option<f64> {
        self.transmission.as_ref().map(|present| present.end)
    }

    /// Two nodes that have configured different baud rates.
    pub fn mismatch(&self) -> Option<BaudRateMismatch> {
        self.rates(|node| node.baud_rate).err().or(self.rates(|node| node.fd_baud_rate).err())
    }

    /// The baud rate that all nodes that configure one agree on.
    fn rates(&self, rate: impl Fn(&Node) -> Option<u32>) -> Result<Option<u32>, BaudRateMismatch> {
        let mut rates = (0..).zip(&self.nodes).filter_map(|(node, of)| Some((node, rate(of)?)));
        let Some(first) = rates.next() else { return Ok(None) };
        match rates.find(|other| other.1 != first.1) {
            Some(other) => {
                Err(BaudRateMismatch { nodes: [first.0, other.0], rates: [first.1, other.1] })
            }
            None => Ok(Some(first.1)),
        }
    }

    /// Choose the frame to transmit next among those that have arrived when the bus is free.
    fn arbitrate(&mut self, mut send: impl FnMut(usize, Operation<'_>)) {
        let heads =
            || (0..).zip(&self.nodes).filter_map(|(i, node)| Some((i, node.queue.front()?)));
        let Some(first) = heads().map(|(_, head)| head.arrival).reduce(f64::min) else { return };
        let start = self.free_at.max(first);
        let competes = |head: &QueuedFrame| head.arrival <= start + INSTANT;
        let competitors = heads().filter(|(_, head)| competes(head));
        let priority = |(i, head): &(usize, &QueuedFrame)| {
            (self.nodes[*i].status == Status::ErrorPassive, arbitration_field(head), *i)
        };
        let Some((sender, head)) = competitors.min_by_key(priority) else { return };
        let frame = head.frame();
        let Some(bits) = FrameBits::of(&frame) else { return };

        let own = &self.nodes[sender];
        let baud_rate = own.baud_rate.or(self.rates(|node| node.baud_rate).unwrap_or(None));
        let baud_rate = baud_rate.unwrap_or(self.baud_rate);
        let fd_baud_rate =
            own.fd_baud_rate.or(self.rates(|node| node.fd_baud_rate).unwrap_or(None));
        let fd_baud_rate = fd_baud_rate.unwrap_or(self.fd_baud_rate);
        let error = self.error(sender, bits);
        let bit = 1.0 / f64::from(baud_rate);
        let error_bits = if error.is_some() { f64::from(ERROR_FRAME) } else { 0.0 };
        let end = start + bits.duration(baud_rate, fd_baud_rate) + error_bits * bit;
        let free_at = end + f64::from(INTERMISSION) * bit;
        self.transmission = Some(Transmission { sender, start, end, free_at, error });

        for (i, node) in self.nodes.iter_mut().enumerate() {
            let discards = node.arbitration_lost == ArbitrationLostBehavior::DiscardAndNotify;
            if i != sender && discards && node.queue.front().is_some_and(competes) {
                let Some(lost) = node.queue.pop_front() else { continue };
                if self.notifications {
                    send(i, Operation::ArbitrationLost { id: lost.id.value() });
                }
            }
        }
    }

    /// What goes wrong with the next frame.
    fn error(&self, sender: usize, bits: FrameBits) -> Option<ErrorCode> {
        let takes_part = |(i, node): (usize, &Node)| i != sender && node.status != Status::BusOff;
        let mismatch = self.rates(|node| node.baud_rate).is_err()
            || bits.data > 0 && self.rates(|node| node.fd_baud_rate).is_err();
        if !self.nodes.iter().enumerate().any(takes_part) {
            Some(ErrorCode::Acknowledge)
        } else if mismatch {
            Some(ErrorCode::BitStuffing)
        } else {
            (uniform(self.seed, self.transmitted) < self.loss).then_some(ErrorCode::Crc)
        }
    }

    fn finish(&mut self, ended: &Transmission, mut send: impl FnMut(usize, Operation<'_>)) {
        self.free_at = ended.free_at;
        self.busy += ended.free_at - ended.start;
        self.transmitted += 1;
        self.failed += u64::from(ended.error.is_some());
        let sender = ended.sender;
        let Some(mut queued) = self.nodes[sender].queue.pop_front() else { return };
        let id = queued.id.value();
        for (i, node) in self.nodes.iter().enumerate() {
            let is_sender = i == sender;
            match ended.error {
                _ if node.status == Status::BusOff => {}
                None if !is_sender => send(i, Operation::Transmit(queued.frame())),
                None if self.notifications => send(i, Operation::Confirm { id }),
                Some(code) if self.notifications => {
                    // The sender sees that nobody acknowledges; the others see everything else first.
                    let first = is_sender == (code == ErrorCode::Acknowledge);
                    let flag = if first { ErrorFlag::Primary } else { ErrorFlag::Secondary };
                    send(i, Operation::BusError { id, code, flag, is_sender });
                }
                _ => {}
            }
        }
        if ended.error.is_some() && queued.failures < self.retransmissions {
            queued.failures += 1;
            self.nodes[sender].queue.push_front(queued);
        }
    }
}

/// Two nodes that have configured different baud rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BaudRateMismatch {
    /// Their numbers, from 0.
    pub nodes: [usize; 2],
    /// Their baud rates (bit/s).
    pub rates: [u32; 2],
}

impl fmt::Display for BaudRateMismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { nodes: [first, other], rates: [rate, different] } = self;
        let (first, other) = (first + 1, other + 1);
        write!(f, "node {first} is configured for {rate} bit/s, node {other} for {different} bit/s")
    }
}

/// The bits from the identifier to the second RTR, as a number: the lower one wins.
fn arbitration_field(frame: &QueuedFrame) -> u32 {
    let remote = u32::from(matches!(frame.format, Format::Remote { .. }));
    match frame.id {
        Id::Standard(id) => u32::from(id) << 21 | remote << 20,
        Id::Extended(id) => (id >> 18) << 21 | 0b11 << 19 | (id & 0x3_ffff) << 1 | remote,
    }
}

/// What fits into `FormatError`.
fn shortened(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(u16::MAX.into())]
}

/// Number `index` of random numbers from 0 to 1, by the hash of SplitMix64.
fn uniform(seed: u64, index: u64) -> f64 {
    let mixed = |key: u64| {
        let mut x = key.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    };
    (mixed(mixed(seed).wrapping_add(index)) >> 11) as f64 / (1_u64 << 53) as f64
}
