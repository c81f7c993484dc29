//! The bits of frames, compared with frames that are written out as text, and with bounds of the literature.

use fmi_ls_bus::*;
use proptest::prelude::*;

/// The lowest bits of a number, as text.
fn bits(value: u32, width: usize) -> String {
    format!("{value:032b}")[32 - width..].to_owned()
}

fn bytes(data: &[u8]) -> String {
    data.iter().map(|byte| format!("{byte:08b}")).collect()
}

/// The remainder of a polynomial division, as in a textbook: the divisor is subtracted wherever there is a 1.
fn remainder(message: &str, divisor: &str) -> String {
    let width = divisor.len() - 1;
    let mut digits: Vec<u8> = (message.to_owned() + &"0".repeat(width)).into_bytes();
    for i in 0..message.len() {
        if digits[i] == b'1' {
            for (digit, subtrahend) in digits[i..].iter_mut().zip(divisor.bytes()) {
                *digit = if *digit == subtrahend { b'0' } else { b'1' };
            }
        }
    }
    String::from_utf8(digits[message.len()..].to_vec()).unwrap()
}

/// The bits with stuff bits.
fn stuffed(bits: &str) -> String {
    let mut sent = String::new();
    for bit in bits.chars() {
        sent.push(bit);
        if sent.ends_with("00000") {
            sent.push('1');
        } else if sent.ends_with("11111") {
            sent.push('0');
        }
    }
    sent
}

/// The number of bits of a frame of classical CAN.
fn can_bits(frame: &Frame) -> usize {
    let (rtr, length) = match frame.format {
        Format::Remote { length } => ("1", u32::from(length)),
        _ => ("0", frame.data.len() as u32),
    };
    let identifier = match frame.id {
        Id::Standard(id) => bits(id.into(), 11) + rtr + "00",
        Id::Extended(id) => bits(id >> 18, 11) + "11" + &bits(id, 18) + rtr + "00",
    };
    let before = "0".to_owned() + &identifier + &bits(length, 4) + &bytes(frame.data);
    // x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1
    let crc = remainder(&before, "1100010110011001");
    stuffed(&(before + &crc)).len() + "1".len() + "01".len() + "1111111".len()
}

#[test]
fn frames_without_stuff_bits_have_the_length_of_their_fields() {
    // Neither identifiers nor data nor CRC have five equal bits in a row.
    let shortest =
        |extended| {
            (0..1_u32 << 11)
                .map(|id| {
                    if extended {
                        Id::Extended(id << 18 | 0x1_5555)
                    } else {
                        Id::Standard(id as u16)
                    }
                })
                .map(|id| FrameBits::of(&Frame::can(id, &[0x55; 8])).unwrap().nominal)
                .min()
        };
    assert_eq!(shortest(false), Some(44 + 64));
    assert_eq!(shortest(true), Some(64 + 64));
}

#[test]
fn a_frame_of_can_fd_without_stuff_bits_has_the_length_of_its_fields() {
    let data = [0x55; 64];
    for (length, data_bits) in
        [(8, 1 + 4 + 64 + 4 + 17 + 6 + 1), (64, 1 + 4 + 512 + 4 + 21 + 7 + 1)]
    {
        let standard = Frame::can_fd(Id::Standard(0x555), true, &data[..length]);
        let extended = Frame::can_fd(Id::Extended(0x1555_5555), true, &data[..length]);
        // Start, identifier, RRS, IDE, FDF, res, BRS; ACK, its delimiter, end.
        let expected = FrameBits { nominal: 1 + 11 + 5 + 9, data: data_bits };
        assert_eq!(FrameBits::of(&standard), Some(expected));
        let expected = FrameBits { nominal: 1 + 11 + 2 + 18 + 5 - 1 + 9, ..expected };
        assert_eq!(FrameBits::of(&extended), Some(expected));
        let slow = Frame::can_fd(Id::Standard(0x555), false, &data[..length]);
        let expected = FrameBits { nominal: 26 + data_bits, data: 0 };
        assert_eq!(FrameBits::of(&slow), Some(expected));
    }
}

#[test]
fn a_duration_is_bits_by_baud_rate() {
    let bits = FrameBits { nominal: 26, data: 97 };
    assert_eq!(bits.duration(500_000, 2_000_000), 26.0 / 500e3 + 97.0 / 2e6);
    assert_eq!(FrameBits { nominal: 120, data: 0 }.duration(500_000, 0), 240e-6);
}

fn frame() -> impl Strategy<Value = (Id, Option<u16>, Vec<u8>)> {
    let id = prop_oneof![
        (0..1_u16 << 11).prop_map(Id::Standard),
        (0..1_u32 << 29).prop_map(Id::Extended)
    ];
    // Many equal bits.
    let byte = prop_oneof![Just(0), Just(0xff), Just(0x0f), any::<u8>()];
    (id, prop::option::of(0..=8_u16), prop::collection::vec(byte, 0..=8))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_frame_has_as_many_bits_as_when_it_is_written_out((id, remote, data) in frame()) {
        let frame = match remote {
            Some(length) => Frame { id, format: Format::Remote { length }, data: &[] },
            None => Frame::can(id, &data),
        };
        let bits = FrameBits::of(&frame).unwrap();
        prop_assert_eq!(bits.nominal as usize, can_bits(&frame));
        // Davis, Burns, Bril, Lukkien, Controller Area Network (CAN) schedulability analysis, 2007, equation 1,
        // without the three bits between frames.
        let (g, bytes) = (if id.is_extended() { 54 } else { 34 }, frame.data.len());
        let longest = g + 8 * bytes + 10 + (g + 8 * bytes - 1) / 4;
        prop_assert!(bits.nominal as usize <= longest, "{} > {}", bits.nominal, longest);
    }

    #[test]
    fn stuff_bits_of_can_fd_end_with_the_data(
        id in 0..1_u16 << 11, length in prop::sample::select(vec![0, 1, 7, 8, 12, 16, 20, 64]), byte: u8,
    ) {
        let data = vec![byte; length];
        let bits = FrameBits::of(&Frame::can_fd(Id::Standard(id), true, &data)).unwrap();
        let code = match length { 0..=8 => length, 12 => 9, 16 => 10, 20 => 11, _ => 15 };
        // Start, identifier, RRS, IDE, FDF, res, BRS, ESI, DLC, data.
        let arbitration = "0".to_owned() + &self::bits(id.into(), 11) + "00101";
        let all = arbitration.clone() + "0" + &self::bits(code as u32, 4) + &bytes(&data);
        // The fixed stuff bit stands in for one after the last bit.
        let dynamic = stuffed(&all[..all.len() - 1]).len() + 1;
        let check = if length <= 16 { 4 + 17 + 6 } else { 4 + 21 + 7 };
        let total = dynamic + check + 1 + 2 + 7;
        prop_assert_eq!((bits.nominal + bits.data) as usize, total);
        prop_assert_eq!(bits.nominal as usize, stuffed(&arbitration).len() + 9);
    }
}
