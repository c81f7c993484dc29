//! Universal binaries for macOS.

use anyhow::{Context, Result, ensure};

/// The magic number of a universal binary, whose header is big-endian.
const FAT: u32 = 0xcafe_babe;
/// The first bytes of a 64-bit Mach-O file, which is little-endian.
const MACH_O: [u8; 4] = 0xfeed_facf_u32.to_le_bytes();
/// The alignment of each file as a power of two: the largest page size of any processor.
const ALIGNMENT: u32 = 14;

/// Joins Mach-O files, each for another processor, to a universal binary for macOS: a header followed by the
/// files.
///
/// # Errors
/// A file is not a 64-bit Mach-O file, or the total size exceeds 4 GB.
pub fn join_mach_o(files: &[Vec<u8>]) -> Result<Vec<u8>> {
    let mut header = vec![FAT, u32::try_from(files.len())?];
    let align = |length: usize| length.next_multiple_of(1 << ALIGNMENT);
    let mut end = 0;
    let mut joined = Vec::new();
    for file in files {
        let number = |at: usize| Some(u32::from_le_bytes(file.get(at..at + 4)?.try_into().ok()?));
        ensure!(file.starts_with(&MACH_O), "it is not a 64-bit Mach-O file");
        let (processor, model) = number(4).zip(number(8)).context("it is truncated")?;
        // The header is far smaller than the space before the first file.
        let start = align(end.max(1));
        end = start + file.len();
        let (offset, size) = (u32::try_from(start)?, u32::try_from(file.len())?);
        header.extend([processor, model, offset, size, ALIGNMENT]);
        joined.resize(start, 0);
        joined.extend_from_slice(file);
    }
    for (number, bytes) in header.iter().zip(joined.chunks_exact_mut(4)) {
        bytes.copy_from_slice(&number.to_be_bytes());
    }
    Ok(joined)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file for a processor, with only the start of its header.
    fn file(processor: u32, length: usize) -> Vec<u8> {
        let mut bytes = MACH_O.to_vec();
        bytes.extend(processor.to_le_bytes());
        bytes.extend(3_u32.to_le_bytes());
        bytes.resize(length, 7);
        bytes
    }

    #[test]
    fn each_file_is_at_its_offset_in_the_header() {
        let files = [file(0x0100_0007, 20_000), file(0x0100_000c, 99)];
        let joined = join_mach_o(&files).unwrap();
        let number = |at: usize| u32::from_be_bytes(joined[at..at + 4].try_into().unwrap());
        assert_eq!([number(0), number(4)], [0xcafe_babe, 2]);
        for (index, (file, processor)) in files.iter().zip([0x0100_0007, 0x0100_000c]).enumerate() {
            let [cpu, model, offset, size, align] =
                [0, 4, 8, 12, 16].map(|field| number(8 + 20 * index + field));
            assert_eq!([cpu, model, align], [processor, 3, 14]);
            assert_eq!(offset % (1 << 14), 0);
            let range = offset as usize..(offset + size) as usize;
            assert_eq!(&joined[range], file);
        }
        assert_eq!(joined.len(), 3 * (1 << 14) + 99);
    }

    #[test]
    fn other_file_formats_are_rejected() {
        for bytes in [&b"\x7fELF"[..], &MACH_O, b""] {
            assert!(join_mach_o(&[bytes.to_vec()]).is_err());
        }
    }
}
