//! What holds for all operations and all bytes.

use fmi_ls_bus::*;
use proptest::prelude::*;

/// An operation that owns its data.
type Owned = (Operation<'static>, Vec<u8>);

fn id() -> impl Strategy<Value = Id> {
    prop_oneof![(0..1_u16 << 11).prop_map(Id::Standard), (0..1_u32 << 29).prop_map(Id::Extended)]
}

fn bytes(length: impl Strategy<Value = usize>) -> impl Strategy<Value = Vec<u8>> {
    length.prop_flat_map(|length| prop::collection::vec(any::<u8>(), length))
}

fn frame() -> impl Strategy<Value = Owned> {
    let remote = (0..=8_u16).prop_map(|length| (Format::Remote { length }, Vec::new()));
    let can = bytes(0..=8_usize).prop_map(|data| (Format::Can, data));
    let fd_length =
        prop_oneof![0..=8_usize, prop::sample::select(vec![12, 16, 20, 24, 32, 48, 64])];
    let can_fd = (any::<(bool, bool)>(), bytes(fd_length)).prop_map(
        |((bit_rate_switch, error_passive), data)| {
            (Format::CanFd { bit_rate_switch, error_passive }, data)
        },
    );
    let can_xl = (any::<(bool, u8, u8, u32)>(), bytes(1..=2048_usize)).prop_map(
        |((simple_extended_content, sdu_type, virtual_network, acceptance), data)| {
            let format =
                Format::CanXl { simple_extended_content, sdu_type, virtual_network, acceptance };
            (format, data)
        },
    );
    (id(), prop_oneof![remote, can, can_fd, can_xl]).prop_map(|(id, (format, data))| {
        (Operation::Transmit(Frame { id, format, data: &[] }), data)
    })
}

fn operation() -> impl Strategy<Value = Owned> {
    let code = prop::sample::select(vec![
        ErrorCode::Bit,
        ErrorCode::BitStuffing,
        ErrorCode::Form,
        ErrorCode::Crc,
        ErrorCode::Acknowledge,
        ErrorCode::BrokenErrorFrame,
    ]);
    let flag = prop::sample::select(vec![ErrorFlag::Primary, ErrorFlag::Secondary]);
    let others = prop_oneof![
        any::<u32>().prop_map(|id| Operation::Confirm { id }),
        any::<u32>().prop_map(|id| Operation::ArbitrationLost { id }),
        (any::<(u32, bool)>(), code, flag).prop_map(|((id, is_sender), code, flag)| {
            Operation::BusError { id, code, flag, is_sender }
        }),
        any::<u32>().prop_map(|rate| Operation::Configuration(Configuration::BaudRate(rate))),
        any::<u32>().prop_map(|rate| Operation::Configuration(Configuration::FdBaudRate(rate))),
        any::<u32>().prop_map(|rate| Operation::Configuration(Configuration::XlBaudRate(rate))),
        Just(Operation::Status(Status::ErrorPassive)),
        Just(Operation::Wakeup),
    ];
    prop_oneof![
        frame(),
        bytes(0..100_usize).prop_map(|data| (Operation::FormatError { data: &[] }, data)),
        others.prop_map(|operation| (operation, Vec::new())),
    ]
}

fn with_data<'a>((operation, data): &'a Owned) -> Operation<'a> {
    match *operation {
        Operation::Transmit(frame) => Operation::Transmit(Frame { data, ..frame }),
        Operation::FormatError { .. } => Operation::FormatError { data },
        operation => operation,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_written_is_read(written in prop::collection::vec(operation(), 0..5)) {
        let written: Vec<_> = written.iter().map(with_data).collect();
        let mut buffer = Vec::new();
        for operation in &written {
            operation.append(&mut buffer, 1 << 16).unwrap();
        }
        let read: Result<Vec<_>, _> = operations(&buffer).collect();
        prop_assert_eq!(read.unwrap(), written);
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name(written in operation(), room in 0..200_usize) {
        let operation = with_data(&written);
        let mut buffer = vec![0; room];
        match operation.write(&mut buffer) {
            Ok(length) => {
                prop_assert!(length <= room);
                prop_assert_eq!(operations(&buffer[..length]).next(), Some(Ok(operation)));
            }
            Err(error) => {
                let WriteProblem::TooLong { length, room: left } = error.problem else {
                    panic!("{error}")
                };
                prop_assert_eq!((error.code, error.id), (operation.code(), operation.id()));
                prop_assert!(length > room && left == room);
                prop_assert!(buffer.iter().all(|byte| *byte == 0));
                prop_assert_eq!(operation.append(&mut buffer, room + left), Err(error));
            }
        }
    }

    #[test]
    fn no_bytes_cause_a_panic_and_what_is_read_is_written_back(
        mut bytes in prop::collection::vec(any::<u8>(), 0..80),
        code in prop::sample::select(vec![0, 1, 0x10, 0x11, 0x12, 0x20, 0x30, 0x31, 0x40, 0x41, 0x42]),
        length in 0..90_u8,
    ) {
        if let Some(header) = bytes.first_chunk_mut() {
            *header = [code, 0, 0, 0, length, 0, 0, 0];
        }
        for operation in operations(&bytes) {
            match operation {
                Ok(operation) => {
                    let mut written = Vec::new();
                    operation.append(&mut written, 100).unwrap();
                    prop_assert_eq!(operations(&written).next(), Some(Ok(operation)));
                }
                Err(error) => prop_assert!(error.to_string().contains("at byte"), "{}", error),
            }
        }
    }

    #[test]
    fn a_changed_operation_is_read_or_refused(
        written in operation(), place in any::<prop::sample::Index>(), value in any::<u8>(),
    ) {
        let mut bytes = Vec::new();
        with_data(&written).append(&mut bytes, 4096).unwrap();
        let place = place.index(bytes.len());
        bytes[place] = value;
        for operation in operations(&bytes).flatten() {
            prop_assert!(operation.append(&mut Vec::new(), 4096).is_ok());
        }
    }
}
