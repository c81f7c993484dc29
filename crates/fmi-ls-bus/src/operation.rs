//! The operations and their arguments, by the tables of the standard (section 4.4.1), and what they allow.

use core::error::Error;
use core::fmt;

/// Identifier of a frame; of two frames that begin at once, the lower one is transmitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Id {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

impl Id {
    /// The number, by which a bus also confirms the frame.
    pub const fn value(self) -> u32 {
        match self {
            Self::Standard(id) => id as u32,
            Self::Extended(id) => id,
        }
    }

    /// Whether the identifier has 29 bits.
    pub const fn is_extended(self) -> bool {
        matches!(self, Self::Extended(_))
    }
}

/// A frame on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Identifier.
    pub id: Id,
    /// Format, with the arguments that only it has.
    pub format: Format,
    /// Payload: at most 8 bytes in CAN, 64 in CAN FD, 2048 in CAN XL; none in a remote frame.
    pub data: &'a [u8],
}

/// Format of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Format {
    /// Data frame of classical CAN.
    Can,
    /// Remote frame of classical CAN, which asks for data.
    Remote {
        /// Number of bytes asked for, at most 8.
        length: u16,
    },
    /// CAN FD.
    CanFd {
        /// Whether the data is transmitted at the CAN FD baud rate (BRS).
        bit_rate_switch: bool,
        /// Whether the sender is error passive (ESI).
        error_passive: bool,
    },
    /// CAN XL.
    CanXl {
        /// Whether a further protocol header is in the data (SEC).
        simple_extended_content: bool,
        /// Type of the data (SDT).
        sdu_type: u8,
        /// Number of the virtual network (VCID).
        virtual_network: u8,
        /// Acceptance field (AF).
        acceptance: u32,
    },
}

impl<'a> Frame<'a> {
    /// A data frame of classical CAN.
    pub const fn can(id: Id, data: &'a [u8]) -> Self {
        Self { id, format: Format::Can, data }
    }

    /// A frame of CAN FD by an error active node.
    pub const fn can_fd(id: Id, bit_rate_switch: bool, data: &'a [u8]) -> Self {
        Self { id, format: Format::CanFd { bit_rate_switch, error_passive: false }, data }
    }

    /// The argument `Data Length`.
    pub(crate) const fn data_length(&self) -> usize {
        match self.format {
            Format::Remote { length } => length as usize,
            _ => self.data.len(),
        }
    }

    pub(crate) const fn check(&self) -> Result<(), InvalidArgument> {
        let (bits, expected) = match self.id {
            Id::Standard(_) => (11, "at most 11 bits"),
            Id::Extended(_) => (29, "at most 29 bits"),
        };
        if self.id.value() >> bits != 0 {
            return Err(InvalidArgument { name: "ID", found: self.id.value() as u64, expected });
        }
        let found = self.data_length();
        let (allowed, expected) = match self.format {
            Format::Can | Format::Remote { .. } => (found <= 8, "at most 8"),
            Format::CanFd { .. } => (
                found <= 8 || matches!(found, 12 | 16 | 20 | 24 | 32 | 48 | 64),
                "at most 8, or 12, 16, 20, 24, 32, 48 or 64",
            ),
            Format::CanXl { .. } => (found >= 1 && found <= 2048, "1 to 2048"),
        };
        if allowed {
            return Ok(());
        }
        Err(InvalidArgument { name: "Data Length", found: found as u64, expected })
    }
}

/// An enum whose variants have the numbers of a table.
macro_rules! numbered {
    ($(#[$of_enum:meta])* $name:ident, $argument:literal, $expected:literal {
        $($(#[$of_item:meta])* $item:ident = $number:literal,)*
    }) => {
        $(#[$of_enum])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[repr(u8)]
        pub enum $name {
            $($(#[$of_item])* $item = $number,)*
        }

        impl $name {
            pub(crate) const fn of(number: u8) -> Result<Self, InvalidArgument> {
                match number {
                    $($number => Ok(Self::$item),)*
                    _ => Err(InvalidArgument {
                        name: $argument, found: number as u64, expected: $expected,
                    }),
                }
            }
        }
    };
}

numbered! {
    /// What went wrong on the bus.
    ErrorCode, "Error Code", "1 to 6" {
        /// The sender reads back another bit than it sends.
        Bit = 1,
        /// Six equal bits in a row.
        BitStuffing = 2,
        /// A bit of fixed form, such as the end of the frame, has the other value.
        Form = 3,
        /// The checksum does not match.
        Crc = 4,
        /// No node has acknowledged the frame.
        Acknowledge = 5,
        /// An error frame is broken.
        BrokenErrorFrame = 6,
    }
}

numbered! {
    /// Role of a node when an error happens.
    ErrorFlag, "Error Flag", "1 or 2" {
        /// The node detects the error first.
        Primary = 1,
        /// The node reacts to the error flag of another one.
        Secondary = 2,
    }
}

numbered! {
    /// Error state of a node.
    #[derive(Default)]
    Status, "Status", "1 to 3" {
        /// It takes part in everything.
        #[default]
        ErrorActive = 1,
        /// It waits for error active nodes before it transmits.
        ErrorPassive = 2,
        /// It neither transmits nor acknowledges.
        BusOff = 3,
    }
}

numbered! {
    /// What becomes of a frame that has lost the arbitration.
    #[derive(Default)]
    #[cfg_attr(feature = "fmi", derive(fmu_derive::Choice), choice(crate = fmu_description))]
    ArbitrationLostBehavior, "Arbitration Lost Behavior", "1 or 2" {
        /// The bus keeps the frame, and transmits it as soon as it can.
        #[default]
        BufferAndRetransmit = 1,
        /// The bus discards the frame, and notifies the node by `ArbitrationLost`.
        DiscardAndNotify = 2,
    }
}

/// A setting of a node, for the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Configuration {
    /// Baud rate of CAN, and of the arbitration in CAN FD (bit/s).
    BaudRate(u32),
    /// Baud rate of the data in CAN FD (bit/s).
    FdBaudRate(u32),
    /// Baud rate of the data in CAN XL (bit/s).
    XlBaudRate(u32),
    /// What becomes of a frame that has lost the arbitration.
    ArbitrationLost(ArbitrationLostBehavior),
}

impl Configuration {
    /// The argument `Parameter Type`.
    pub(crate) const fn parameter(self) -> u8 {
        match self {
            Self::BaudRate(_) => 1,
            Self::FdBaudRate(_) => 2,
            Self::XlBaudRate(_) => 3,
            Self::ArbitrationLost(_) => 4,
        }
    }
}

/// What FMUs on a bus send each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation<'a> {
    /// A received operation is malformed.
    FormatError {
        /// Its bytes, at most 65535.
        data: &'a [u8],
    },
    /// Transmit this frame; from the bus: this frame was transmitted.
    Transmit(Frame<'a>),
    /// From the bus: the frame with this identifier was received by at least one node.
    Confirm {
        /// Identifier of the frame.
        id: u32,
    },
    /// From the bus: the frame with this identifier has lost the arbitration, and was discarded.
    ArbitrationLost {
        /// Identifier of the frame.
        id: u32,
    },
    /// From the bus: an error has happened during the frame with this identifier.
    BusError {
        /// Identifier of the frame.
        id: u32,
        /// What went wrong.
        code: ErrorCode,
        /// Whether this node is the first to detect it.
        flag: ErrorFlag,
        /// Whether this node has sent the frame.
        is_sender: bool,
    },
    /// To the bus: a setting of this node.
    Configuration(Configuration),
    /// To the bus: the error state of this node has changed.
    Status(Status),
    /// Wake up all other nodes.
    Wakeup,
}

pub(crate) const FORMAT_ERROR: u32 = 0x01;
pub(crate) const CAN_TRANSMIT: u32 = 0x10;
pub(crate) const CAN_FD_TRANSMIT: u32 = 0x11;
pub(crate) const CAN_XL_TRANSMIT: u32 = 0x12;
pub(crate) const CONFIRM: u32 = 0x20;
pub(crate) const ARBITRATION_LOST: u32 = 0x30;
pub(crate) const BUS_ERROR: u32 = 0x31;
pub(crate) const CONFIGURATION: u32 = 0x40;
pub(crate) const STATUS: u32 = 0x41;
pub(crate) const WAKEUP: u32 = 0x42;

/// Bytes of code and length.
pub(crate) const HEADER: usize = 8;

impl Operation<'_> {
    /// Its code (OP code).
    pub const fn code(&self) -> u32 {
        match self {
            Self::FormatError { .. } => FORMAT_ERROR,
            Self::Transmit(frame) => match frame.format {
                Format::Can | Format::Remote { .. } => CAN_TRANSMIT,
                Format::CanFd { .. } => CAN_FD_TRANSMIT,
                Format::CanXl { .. } => CAN_XL_TRANSMIT,
            },
            Self::Confirm { .. } => CONFIRM,
            Self::ArbitrationLost { .. } => ARBITRATION_LOST,
            Self::BusError { .. } => BUS_ERROR,
            Self::Configuration(_) => CONFIGURATION,
            Self::Status(_) => STATUS,
            Self::Wakeup => WAKEUP,
        }
    }

    /// The identifier of its frame, if it has one.
    pub const fn id(&self) -> Option<u32> {
        match self {
            Self::Transmit(frame) => Some(frame.id.value()),
            Self::Confirm { id } | Self::ArbitrationLost { id } | Self::BusError { id, .. } => {
                Some(*id)
            }
            _ => None,
        }
    }
}

/// The name that the standard gives the operation with a code.
pub const fn operation_name(code: u32) -> Option<&'static str> {
    Some(match code {
        FORMAT_ERROR => "Format Error",
        CAN_TRANSMIT => "CAN Transmit",
        CAN_FD_TRANSMIT => "CAN FD Transmit",
        CAN_XL_TRANSMIT => "CAN XL Transmit",
        CONFIRM => "Confirm",
        ARBITRATION_LOST => "Arbitration Lost",
        BUS_ERROR => "Bus Error",
        CONFIGURATION => "Configuration",
        STATUS => "Status",
        WAKEUP => "Wakeup",
        _ => return None,
    })
}

/// An argument with a value that the tables do not allow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InvalidArgument {
    /// Name of the argument in the standard.
    pub name: &'static str,
    /// Its value.
    pub found: u64,
    /// What is allowed.
    pub expected: &'static str,
}

impl fmt::Display for InvalidArgument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, found, expected } = self;
        write!(f, "{name} is {found}, expected {expected}")
    }
}

impl Error for InvalidArgument {}
