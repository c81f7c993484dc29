//! Numbers and bytes as C writes them.

use wasmparser::ValType;

/// A part of the memory at the start, without the zeros around it.
pub struct Row<'a> {
    pub address: u32,
    pub bytes: &'a [u8],
}

/// The longest string that every compiler reads has 4095 bytes; this one is easier to read.
const ROW: usize = 1024;
/// A gap of so many zeros begins another row.
const GAP: usize = 16;

/// Splits a segment into rows, without long gaps of zeros.
pub fn rows(address: u32, bytes: &[u8]) -> Vec<Row<'_>> {
    let mut rows = Vec::new();
    let (mut begin, mut end) = (0, 0);
    for i in (0..bytes.len()).filter(|&i| bytes[i] != 0) {
        if end > begin && (i >= end + GAP || i - begin >= ROW) {
            rows.push(Row { address: address + begin as u32, bytes: &bytes[begin..end] });
            begin = end;
        }
        if begin == end {
            begin = i;
        }
        end = i + 1;
    }
    if end > begin {
        rows.push(Row { address: address + begin as u32, bytes: &bytes[begin..end] });
    }
    rows
}

/// Bytes as the inside of a string in C.
pub fn string(bytes: &[u8]) -> String {
    let mut text = String::new();
    for (i, &byte) in bytes.iter().enumerate() {
        match byte {
            b'\n' => text.push_str("\\n"),
            // Two question marks may begin a trigraph.
            b'"' | b'\\' | b'?' => text.extend(['\\', char::from(byte)]),
            0x20..0x7f => text.push(char::from(byte)),
            _ if bytes.get(i + 1).is_some_and(|next| (b'0'..=b'7').contains(next)) => {
                text.push_str(&format!("\\{byte:03o}"));
            }
            _ => text.push_str(&format!("\\{byte:o}")),
        }
    }
    text
}

/// The literal of a value, given as bits, and whether it begins with a sign.
pub fn literal(value_type: ValType, bits: u64) -> (String, bool) {
    match value_type {
        ValType::F32 => float(f64::from(f32::from_bits(bits as u32)), "f", || {
            format!("f32_from_bits(0x{bits:x}u)")
        }),
        ValType::F64 => float(f64::from_bits(bits), "", || format!("f64_from_bits(0x{bits:x}u)")),
        _ if bits > i32::MAX as u64 => (format!("0x{bits:x}u"), false),
        _ => (bits.to_string(), false),
    }
}

fn float(value: f64, suffix: &str, from_bits: impl Fn() -> String) -> (String, bool) {
    if !value.is_finite() {
        return (from_bits(), false);
    }
    let decimal = format!("{value:?}");
    // Compilers may round a decimal number up or down, but not one that is exact.
    let exact = value == 0.0
        || (value.abs() >= 1e-3 && value.abs() < 1e15 && (value * 1024.0).fract() == 0.0);
    let text = if exact {
        format!("{decimal}{suffix}")
    } else {
        format!("{}{suffix} /* {decimal} */", hexadecimal(value))
    };
    (text, value.is_sign_negative())
}

/// A finite number as C99 writes it exactly.
fn hexadecimal(value: f64) -> String {
    let bits = value.to_bits();
    let sign = if value.is_sign_negative() { "-" } else { "" };
    let (exponent, fraction) = ((bits >> 52 & 0x7ff) as i32, bits & ((1 << 52) - 1));
    let digits = format!("{fraction:013x}");
    let digits = digits.trim_end_matches('0');
    let point = if digits.is_empty() { "" } else { "." };
    match exponent {
        0 => format!("{sign}0x0{point}{digits}p-1022"),
        _ => format!("{sign}0x1{point}{digits}p{}", exponent - 1023),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_exactly() {
        let number = |value: f64| literal(ValType::F64, value.to_bits()).0;
        assert_eq!(number(0.5), "0.5");
        assert_eq!(number(-0.0), "-0.0");
        assert_eq!(number(1e3), "1000.0");
        assert_eq!(number(0.1), "0x1.999999999999ap-4 /* 0.1 */");
        assert_eq!(number(-1e300), "-0x1.7e43c8800759cp996 /* -1e300 */");
        assert_eq!(number(f64::from_bits(1)), "0x0.0000000000001p-1022 /* 5e-324 */");
        assert_eq!(number(f64::INFINITY), "f64_from_bits(0x7ff0000000000000u)");
        assert_eq!(
            literal(ValType::F32, u64::from(0.1f32.to_bits())).0,
            "0x1.99999ap-4f /* 0.10000000149011612 */"
        );
        assert_eq!(literal(ValType::I32, 0xffff_ffff).0, "0xffffffffu");
    }

    #[test]
    fn strings_have_no_escape_that_goes_on_in_the_next_character() {
        assert_eq!(string(b"\x017\0a??=\n\"\xff"), "\\0017\\0a\\?\\?=\\n\\\"\\377");
    }

    #[test]
    fn rows_leave_out_long_gaps_of_zeros() {
        let bytes = [&[0; 5][..], b"ab", &[0; 3], b"c", &[0; 100], b"d", &[0; 9]].concat();
        let rows: Vec<_> =
            rows(1000, &bytes).iter().map(|row| (row.address, row.bytes.to_vec())).collect();
        assert_eq!(rows, [(1005, b"ab\0\0\0c".to_vec()), (1111, b"d".to_vec())]);
    }
}
