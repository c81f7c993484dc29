//! Writes operations.

use alloc::vec::Vec;
use core::error::Error;
use core::fmt;

use crate::operation::{Configuration, Format, HEADER, InvalidArgument, Operation, operation_name};

/// The longest operation without its data: CAN XL Transmit.
const MAX_HEAD: usize = HEADER + 14;

/// The bytes of an operation before its data.
struct Head {
    bytes: [u8; MAX_HEAD],
    length: usize,
}

impl Head {
    fn of(operation: &Operation<'_>, data_length: usize) -> Self {
        let mut head = Self { bytes: [0; MAX_HEAD], length: HEADER };
        match *operation {
            Operation::FormatError { data } => head.u16(data.len() as u16),
            Operation::Transmit(frame) => {
                head.u32(frame.id.value());
                head.u8(frame.id.is_extended().into());
                match frame.format {
                    Format::Can => head.u8(0),
                    Format::Remote { .. } => head.u8(1),
                    Format::CanFd { bit_rate_switch, error_passive } => {
                        head.u8(bit_rate_switch.into());
                        head.u8(error_passive.into());
                    }
                    Format::CanXl {
                        simple_extended_content,
                        sdu_type,
                        virtual_network,
                        acceptance,
                    } => {
                        head.u8(simple_extended_content.into());
                        head.u8(sdu_type);
                        head.u8(virtual_network);
                        head.u32(acceptance);
                    }
                }
                head.u16(frame.data_length() as u16);
            }
            Operation::Confirm { id } | Operation::ArbitrationLost { id } => head.u32(id),
            Operation::BusError { id, code, flag, is_sender } => {
                head.u32(id);
                head.u8(code as u8);
                head.u8(flag as u8);
                head.u8(is_sender.into());
            }
            Operation::Configuration(configuration) => {
                head.u8(configuration.parameter());
                match configuration {
                    Configuration::BaudRate(rate)
                    | Configuration::FdBaudRate(rate)
                    | Configuration::XlBaudRate(rate) => head.u32(rate),
                    Configuration::ArbitrationLost(behavior) => head.u8(behavior as u8),
                }
            }
            Operation::Status(status) => head.u8(status as u8),
            Operation::Wakeup => {}
        }
        let length = (head.length + data_length) as u32;
        head.bytes[..4].copy_from_slice(&operation.code().to_le_bytes());
        head.bytes[4..HEADER].copy_from_slice(&length.to_le_bytes());
        head
    }

    fn push<const N: usize>(&mut self, bytes: [u8; N]) {
        self.bytes[self.length..][..N].copy_from_slice(&bytes);
        self.length += N;
    }

    fn u8(&mut self, value: u8) {
        self.push([value]);
    }

    fn u16(&mut self, value: u16) {
        self.push(value.to_le_bytes());
    }

    fn u32(&mut self, value: u32) {
        self.push(value.to_le_bytes());
    }
}

impl<'a> Operation<'a> {
    /// Append the operation to the value of a Binary variable of at most `max_size` bytes.
    ///
    /// The buffer grows as a `Vec` does; one that has room for `max_size` bytes is not allocated anew.
    ///
    /// # Errors
    ///
    /// If an argument is not allowed, or the operation does not fit, the buffer stays as it was.
    pub fn append(&self, buffer: &mut Vec<u8>, max_size: usize) -> Result<(), WriteError> {
        let (head, data) = self.parts(max_size.saturating_sub(buffer.len()))?;
        buffer.extend_from_slice(&head.bytes[..head.length]);
        buffer.extend_from_slice(data);
        Ok(())
    }

    /// Write the operation to the beginning of a buffer, and return its length in bytes.
    ///
    /// # Errors
    ///
    /// If an argument is not allowed, or the operation does not fit, the buffer stays as it was.
    pub fn write(&self, buffer: &mut [u8]) -> Result<usize, WriteError> {
        let (head, data) = self.parts(buffer.len())?;
        let length = head.length + data.len();
        buffer[..head.length].copy_from_slice(&head.bytes[..head.length]);
        buffer[head.length..length].copy_from_slice(data);
        Ok(length)
    }

    fn parts(&self, room: usize) -> Result<(Head, &'a [u8]), WriteError> {
        let error = |problem| WriteError { code: self.code(), id: self.id(), problem };
        let data =
            self.checked_data().map_err(|argument| error(WriteProblem::Argument(argument)))?;
        let head = Head::of(self, data.len());
        let length = head.length + data.len();
        if length > room {
            return Err(error(WriteProblem::TooLong { length, room }));
        }
        Ok((head, data))
    }

    fn checked_data(&self) -> Result<&'a [u8], InvalidArgument> {
        match *self {
            Self::FormatError { data } if data.len() > usize::from(u16::MAX) => {
                let found = data.len() as u64;
                Err(InvalidArgument { name: "Data Length", found, expected: "at most 65535" })
            }
            Self::FormatError { data } => Ok(data),
            Self::Transmit(frame) => {
                frame.check()?;
                Ok(if let Format::Remote { .. } = frame.format { &[] } else { frame.data })
            }
            _ => Ok(&[]),
        }
    }
}

/// An operation that was not written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WriteError {
    /// Its code.
    pub code: u32,
    /// The identifier of its frame, if it has one.
    pub id: Option<u32>,
    /// Why it was not written.
    pub problem: WriteProblem,
}

/// Why an operation was not written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WriteProblem {
    /// It does not fit.
    TooLong {
        /// Its length (bytes).
        length: usize,
        /// The free space in the buffer (bytes).
        room: usize,
    },
    /// An argument is not allowed.
    Argument(InvalidArgument),
}

impl fmt::Display for WriteError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", operation_name(self.code).unwrap_or_default())?;
        if let Some(id) = self.id {
            write!(f, " of frame {id:#x}")?;
        }
        match self.problem {
            WriteProblem::TooLong { length, room } => {
                write!(f, " has {length} bytes, but its buffer has room for {room}")
            }
            WriteProblem::Argument(argument) => write!(f, ": {argument}"),
        }
    }
}

impl Error for WriteError {}
