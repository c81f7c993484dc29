//! The layout of the operations is the one of the packed structs that the standard describes.

use std::process::Command;

use fmi_ls_bus::*;

/// The bytes that a program in C has for each operation.
fn operations_in_c() -> Vec<Vec<u8>> {
    let directory = tempfile::tempdir().unwrap();
    let program = directory.path().join("layout");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    let compiled = Command::new(compiler)
        .args(["-std=c11", "-Wall", "-Werror", "-o"])
        .arg(&program)
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/layout.c"))
        .status();
    assert!(compiled.unwrap().success());
    let output = Command::new(program).output().unwrap();
    let bytes = |line: &str| -> Vec<u8> {
        (0..line.len())
            .step_by(2)
            .map(|i| u8::from_str_radix(&line[i..i + 2], 16).unwrap())
            .collect()
    };
    String::from_utf8(output.stdout).unwrap().lines().map(bytes).collect()
}

#[test]
#[cfg(target_endian = "little")]
fn every_operation_has_the_bytes_of_a_packed_struct() {
    let data: Vec<u8> = (1..=2048).map(|byte| byte as u8).collect();
    let standard = Id::Standard;
    let xl = Format::CanXl {
        simple_extended_content: true,
        sdu_type: 5,
        virtual_network: 6,
        acceptance: 0x89abcdef,
    };
    let passive = Format::CanFd { bit_rate_switch: false, error_passive: true };
    let remote = Format::Remote { length: 4 };
    let lost = ArbitrationLostBehavior::DiscardAndNotify;
    let expected = [
        Operation::FormatError { data: &[7, 8, 9] },
        Operation::Transmit(Frame::can(standard(0x7ff), &data[..8])),
        Operation::Transmit(Frame::can(Id::Extended(0x1fff_fffe), &[])),
        Operation::Transmit(Frame { id: standard(0x123), format: remote, data: &[] }),
        Operation::Transmit(Frame::can_fd(standard(0x100), true, &data[..64])),
        Operation::Transmit(Frame {
            id: Id::Extended(0x1_0000),
            format: passive,
            data: &data[..12],
        }),
        Operation::Transmit(Frame { id: standard(0x345), format: xl, data: &data }),
        Operation::Confirm { id: 0x123 },
        Operation::ArbitrationLost { id: 0x1fff_ffff },
        Operation::BusError {
            id: 0x123,
            code: ErrorCode::Crc,
            flag: ErrorFlag::Primary,
            is_sender: true,
        },
        Operation::BusError {
            id: 0x123,
            code: ErrorCode::BrokenErrorFrame,
            flag: ErrorFlag::Secondary,
            is_sender: false,
        },
        Operation::Configuration(Configuration::BaudRate(500_000)),
        Operation::Configuration(Configuration::FdBaudRate(2_000_000)),
        Operation::Configuration(Configuration::XlBaudRate(10_000_000)),
        Operation::Configuration(Configuration::ArbitrationLost(Default::default())),
        Operation::Configuration(Configuration::ArbitrationLost(lost)),
        Operation::Status(Status::ErrorActive),
        Operation::Status(Status::BusOff),
        Operation::Wakeup,
    ];
    let in_c = operations_in_c();
    assert_eq!(in_c.len(), expected.len());
    for (bytes, operation) in in_c.iter().zip(expected) {
        let mut written = Vec::new();
        operation.append(&mut written, 4096).unwrap();
        assert_eq!(&written, bytes, "{operation:?}");
        assert_eq!(operations(bytes).collect::<Vec<_>>(), [Ok(operation)]);
    }
}

#[test]
fn a_remote_frame_of_version_1_0_may_have_data() {
    let bytes = [0x10, 0, 0, 0, 18, 0, 0, 0, 0x23, 1, 0, 0, 0, 1, 2, 0, 0xaa, 0xbb];
    let frame = Frame { id: Id::Standard(0x123), format: Format::Remote { length: 2 }, data: &[] };
    assert_eq!(operations(&bytes).next(), Some(Ok(Operation::Transmit(frame))));
}
