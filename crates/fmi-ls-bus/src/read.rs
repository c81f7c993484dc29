//! Reads operations.

use core::error::Error;
use core::fmt;
use core::iter::FusedIterator;

use crate::operation::*;

/// Read all operations of the value of a Binary variable.
///
/// An operation with a wrong argument or an unknown code is an error between others. After an operation whose length
/// cannot be right, nothing more is read.
pub const fn operations(bytes: &[u8]) -> Operations<'_> {
    Operations { bytes, offset: 0 }
}

/// Iterator over the operations in a buffer, by [`operations`].
#[derive(Debug, Clone)]
pub struct Operations<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl Operations<'_> {
    /// Where the next operation begins in the buffer (bytes).
    pub const fn offset(&self) -> usize {
        self.offset
    }
}

impl<'a> Iterator for Operations<'a> {
    type Item = Result<Operation<'a>, ReadError<'a>>;

    fn next(&mut self) -> Option<Self::Item> {
        let bytes = self.bytes.get(self.offset..).filter(|rest| !rest.is_empty())?;
        let offset = self.offset;
        let end = |code, problem| Some(Err(ReadError { offset, code, bytes, problem }));
        self.offset = self.bytes.len();
        let Some(([a, b, c, d, e, f, g, h], _)) = bytes.split_first_chunk::<HEADER>() else {
            return end(None, Problem::Header { found: bytes.len() });
        };
        let code = u32::from_le_bytes([*a, *b, *c, *d]);
        let length = u32::from_le_bytes([*e, *f, *g, *h]);
        let Some((bytes, _)) = bytes.split_at_checked(length as usize) else {
            return end(Some(code), Problem::Truncated { found: bytes.len(), expected: length });
        };
        if bytes.len() < HEADER {
            let problem = Problem::Length { found: length, expected: HEADER as u32 };
            return end(Some(code), problem);
        }
        self.offset = offset + bytes.len();
        let read = Arguments { bytes, position: HEADER }.read(code);
        Some(read.map_err(|problem| ReadError { offset, code: Some(code), bytes, problem }))
    }
}

impl FusedIterator for Operations<'_> {}

/// The bytes of one operation, as long as its header says.
struct Arguments<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Arguments<'a> {
    fn read(mut self, code: u32) -> Result<Operation<'a>, Problem> {
        let fixed = HEADER
            + match code {
                WAKEUP => 0,
                // The shortest setting; the length of each is checked below.
                STATUS | CONFIGURATION => 1,
                FORMAT_ERROR => 2,
                CONFIRM | ARBITRATION_LOST => 4,
                BUS_ERROR => 7,
                CAN_TRANSMIT => 8,
                CAN_FD_TRANSMIT => 9,
                CAN_XL_TRANSMIT => 14,
                _ => return Err(Problem::UnknownCode),
            };
        if self.bytes.len() < fixed {
            return self.wrong_length(fixed);
        }
        let operation = match code {
            FORMAT_ERROR => {
                let length = self.u16();
                Operation::FormatError { data: self.data(length)? }
            }
            CAN_TRANSMIT | CAN_FD_TRANSMIT | CAN_XL_TRANSMIT => {
                Operation::Transmit(self.frame(code)?)
            }
            CONFIRM => Operation::Confirm { id: self.u32() },
            ARBITRATION_LOST => Operation::ArbitrationLost { id: self.u32() },
            BUS_ERROR => Operation::BusError {
                id: self.u32(),
                code: ErrorCode::of(self.u8())?,
                flag: ErrorFlag::of(self.u8())?,
                is_sender: self.boolean("Is Sender")?,
            },
            CONFIGURATION => Operation::Configuration(self.configuration()?),
            STATUS => Operation::Status(Status::of(self.u8())?),
            _ => Operation::Wakeup,
        };
        match self.bytes.len() == self.position {
            true => Ok(operation),
            false => self.wrong_length(self.position),
        }
    }

    fn frame(&mut self, code: u32) -> Result<Frame<'a>, Problem> {
        let id = self.u32();
        let id = match self.boolean("Ide")? {
            true => Id::Extended(id),
            false => Id::Standard(u16::try_from(id).map_err(|_| InvalidArgument {
                name: "ID",
                found: id.into(),
                expected: "at most 11 bits",
            })?),
        };
        let format = match code {
            CAN_TRANSMIT => match self.boolean("Rtr")? {
                true => Format::Remote { length: 0 },
                false => Format::Can,
            },
            CAN_FD_TRANSMIT => Format::CanFd {
                bit_rate_switch: self.boolean("Brs")?,
                error_passive: self.boolean("Esi")?,
            },
            _ => Format::CanXl {
                simple_extended_content: self.boolean("Sec")?,
                sdu_type: self.u8(),
                virtual_network: self.u8(),
                acceptance: self.u32(),
            },
        };
        let length = self.u16();
        let frame = match format {
            // Version 1.0 has data here, which means nothing; later ones have none.
            Format::Remote { .. } => {
                if self.position < self.bytes.len() {
                    self.data(length)?;
                }
                Frame { id, format: Format::Remote { length }, data: &[] }
            }
            _ => Frame { id, format, data: self.data(length)? },
        };
        frame.check()?;
        Ok(frame)
    }

    fn configuration(&mut self) -> Result<Configuration, Problem> {
        let parameter = self.u8();
        let length = self.position + if parameter == 4 { 1 } else { 4 };
        if self.bytes.len() != length && (1..=4).contains(&parameter) {
            return self.wrong_length(length);
        }
        Ok(match parameter {
            1 => Configuration::BaudRate(self.u32()),
            2 => Configuration::FdBaudRate(self.u32()),
            3 => Configuration::XlBaudRate(self.u32()),
            4 => Configuration::ArbitrationLost(ArbitrationLostBehavior::of(self.u8())?),
            _ => {
                let found = parameter.into();
                Err(InvalidArgument { name: "Parameter Type", found, expected: "1 to 4" })?
            }
        })
    }

    fn data(&mut self, length: u16) -> Result<&'a [u8], Problem> {
        let end = self.position + usize::from(length);
        let data = self.bytes.get(self.position..end);
        let Some(data) = data.filter(|_| end == self.bytes.len()) else {
            return self.wrong_length(end);
        };
        self.position = end;
        Ok(data)
    }

    fn wrong_length<T>(&self, expected: usize) -> Result<T, Problem> {
        Err(Problem::Length { found: self.bytes.len() as u32, expected: expected as u32 })
    }

    fn boolean(&mut self, name: &'static str) -> Result<bool, Problem> {
        match self.u8() {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(InvalidArgument { name, found: other.into(), expected: "0 or 1" })?,
        }
    }

    /// The next bytes, which are there: the length was checked.
    fn next<const N: usize>(&mut self) -> [u8; N] {
        let bytes = self.bytes.get(self.position..).and_then(|rest| rest.first_chunk());
        self.position += N;
        *bytes.unwrap_or(&[0; N])
    }

    fn u8(&mut self) -> u8 {
        let [byte] = self.next();
        byte
    }

    fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.next())
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.next())
    }
}

/// A malformed operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReadError<'a> {
    /// Where it begins in the buffer (bytes).
    pub offset: usize,
    /// Its code, if the buffer has it.
    pub code: Option<u32>,
    /// The operation, or the rest of the buffer if its length cannot be right; the data of a
    /// [`FormatError`](Operation::FormatError).
    pub bytes: &'a [u8],
    /// What is wrong.
    pub problem: Problem,
}

/// What is wrong with an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Problem {
    /// The buffer ends within code and length.
    Header {
        /// The rest of the buffer (bytes).
        found: usize,
    },
    /// The buffer ends within the operation.
    Truncated {
        /// The rest of the buffer (bytes).
        found: usize,
        /// Length of the operation, as it says (bytes).
        expected: u32,
    },
    /// The operation is not as long as its arguments.
    Length {
        /// Length of the operation, as it says (bytes).
        found: u32,
        /// Length of header and arguments (bytes).
        expected: u32,
    },
    /// The standard has no operation with this code for CAN.
    UnknownCode,
    /// An argument is not allowed.
    Argument(InvalidArgument),
}

impl From<InvalidArgument> for Problem {
    fn from(argument: InvalidArgument) -> Self {
        Self::Argument(argument)
    }
}

impl fmt::Display for ReadError<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.code.map(|code| (code, operation_name(code))) {
            Some((_, Some(name))) => write!(f, "{name}")?,
            Some((code, None)) => write!(f, "operation with code {code:#04x}")?,
            None => write!(f, "operation")?,
        }
        write!(f, " at byte {}: ", self.offset)?;
        match self.problem {
            Problem::Header { found } => {
                write!(f, "{found} bytes are left, but code and length have {HEADER}")
            }
            Problem::Truncated { found, expected } => {
                write!(f, "{found} bytes are left, but its length is {expected}")
            }
            Problem::Length { found, expected } => {
                write!(f, "its length is {found}, but {expected} bytes are expected")
            }
            Problem::UnknownCode => write!(f, "no such operation of CAN"),
            Problem::Argument(argument) => argument.fmt(f),
        }
    }
}

impl Error for ReadError<'_> {}
