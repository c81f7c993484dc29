//! How long a frame occupies a bus (ISO 11898-1): its bits, with the stuff bits of its actual content.
//!
//! ```text
//! CAN      start 1, identifier 11, RTR 1, IDE 1, r0 1, DLC 4, data 8 n, CRC 15       | 1 + 2 + 7
//!          with 29 bits of identifier: SRR 1, 18 further bits, r1 1 (20 more)        | delimiter, ACK, end
//! CAN FD   start 1, identifier 11, RRS 1, IDE 1, FDF 1, res 1, BRS 1                 at the CAN baud rate
//!          with 29 bits of identifier: SRR 1, 18 further bits (19 more)
//!          ESI 1, DLC 4, data 8 n, stuff count 4, CRC 17 (n <= 16) or 21, delimiter 1  at the CAN FD baud rate, if BRS
//!          ACK 2, end 7                                                              at the CAN baud rate
//! ```
//!
//! After five equal bits, the sender inserts one of the other value: in CAN from the start to the end of the CRC, so a
//! frame has at most (34 + 8 n - 1) / 4 stuff bits, or (54 + 8 n - 1) / 4 with 29 bits of identifier; in CAN FD from the
//! start to the end of the data, followed by fixed stuff bits before each group of four bits of stuff count and CRC: 6
//! with a CRC of 17 bits, 7 with one of 21.

use crate::operation::{Format, Frame, Id};

/// Bits between two frames (intermission).
pub const INTERMISSION: u32 = 3;

/// The bits that an error adds to a frame: in place of the 7 bits of its end, there is an error flag of 6 bits and its
/// delimiter of 8.
pub const ERROR_FRAME: u32 = 7;

/// The number of bits of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameBits {
    /// Bits at the CAN baud rate.
    pub nominal: u32,
    /// Bits at the CAN FD baud rate.
    pub data: u32,
}

impl FrameBits {
    /// The bits of a frame of CAN or CAN FD, with stuff bits; `None` for CAN XL.
    pub fn of(frame: &Frame<'_>) -> Option<Self> {
        let mut bits = BitStream::default();
        bits.push(0, 1);
        match frame.format {
            Format::Can | Format::Remote { .. } => {
                let remote = u32::from(matches!(frame.format, Format::Remote { .. }));
                bits.identifier(frame.id, remote);
                // r0, and r1 before it; the bit IDE is part of the identifier.
                bits.push(0, if frame.id.is_extended() { 2 } else { 1 });
                bits.push(length_code(frame.data_length()), 4);
                if remote == 0 {
                    bits.bytes(frame.data);
                }
                bits.push(bits.crc.into(), 15);
                let stuffed = bits.stuffed + u32::from(bits.run == 5);
                Some(Self { nominal: bits.count + stuffed + 1 + 2 + 7, data: 0 })
            }
            Format::CanFd { bit_rate_switch, error_passive } => {
                bits.identifier(frame.id, 0);
                bits.push(0b10, 2);
                bits.push(bit_rate_switch.into(), 1);
                let arbitration = bits.count + bits.stuffed;
                bits.push(error_passive.into(), 1);
                bits.push(length_code(frame.data.len()), 4);
                bits.bytes(frame.data);
                let check = if frame.data.len() <= 16 { 4 + 17 + 6 } else { 4 + 21 + 7 };
                let data = bits.count + bits.stuffed - arbitration + check + 1;
                let nominal = arbitration + 2 + 7;
                Some(match bit_rate_switch {
                    true => Self { nominal, data },
                    false => Self { nominal: nominal + data, data: 0 },
                })
            }
            Format::CanXl { .. } => None,
        }
    }

    /// The duration at these baud rates (s).
    pub fn duration(self, baud_rate: u32, fd_baud_rate: u32) -> f64 {
        let data = match self.data {
            0 => 0.0,
            data => f64::from(data) / f64::from(fd_baud_rate),
        };
        f64::from(self.nominal) / f64::from(baud_rate) + data
    }
}

/// The argument DLC for a number of bytes.
const fn length_code(bytes: usize) -> u32 {
    match bytes {
        0..=8 => bytes as u32,
        9..=12 => 9,
        13..=16 => 10,
        17..=20 => 11,
        21..=24 => 12,
        25..=32 => 13,
        33..=48 => 14,
        _ => 15,
    }
}

/// Bits that are sent one after another.
#[derive(Default)]
struct BitStream {
    /// The number of bits, without stuff bits.
    count: u32,
    /// The number of stuff bits between them.
    stuffed: u32,
    last: u32,
    /// How many equal bits the last ones are; 5 before a stuff bit.
    run: u32,
    /// CRC of classical CAN.
    crc: u16,
}

impl BitStream {
    /// Send the lowest bits of a value, the highest of them first.
    fn push(&mut self, value: u32, bits: u32) {
        for place in (0..bits).rev() {
            let bit = value >> place & 1;
            if self.run == 5 {
                self.stuffed += 1;
                self.last ^= 1;
                self.run = 1;
            }
            self.run = if bit == self.last { self.run + 1 } else { 1 };
            self.last = bit;
            self.count += 1;
            let feedback = u32::from(self.crc >> 14) != bit;
            self.crc = self.crc << 1 & 0x7fff;
            if feedback {
                self.crc ^= 0x4599;
            }
        }
    }

    fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.push(u32::from(*byte), 8);
        }
    }

    /// The identifier, up to the bits IDE or RTR, whichever is last.
    fn identifier(&mut self, id: Id, remote: u32) {
        match id {
            Id::Standard(id) => {
                self.push(id.into(), 11);
                self.push(remote << 1, 2);
            }
            Id::Extended(id) => {
                self.push(id >> 18, 11);
                self.push(0b11, 2);
                self.push(id, 18);
                self.push(remote, 1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_crc_is_crc_15_can() {
        // The check value of the catalogue of parametrised CRC algorithms.
        let mut bits = BitStream::default();
        bits.bytes(b"123456789");
        assert_eq!(bits.crc, 0x059e);
    }
}
