//! Malformed operations are refused by name, and do not hide those after them.

use fmi_ls_bus::*;

fn messages(bytes: &[u8]) -> Vec<String> {
    let message = |operation: Result<Operation, ReadError>| match operation {
        Ok(operation) => format!("{operation:?}"),
        Err(error) => error.to_string(),
    };
    operations(bytes).map(message).collect()
}

#[test]
fn a_length_that_does_not_match_the_arguments_is_named() {
    let transmit = [0x10, 0, 0, 0, 17, 0, 0, 0, 0x23, 1, 0, 0, 0, 0, 2, 0, 5];
    let wakeup = [0x42, 0, 0, 0, 8, 0, 0, 0];
    assert_eq!(
        messages(&[&wakeup[..], &transmit, &wakeup].concat()),
        ["Wakeup", "CAN Transmit at byte 8: its length is 17, but 18 bytes are expected", "Wakeup"],
    );
    let status = [0x41, 0, 0, 0, 10, 0, 0, 0, 1, 1];
    assert_eq!(messages(&status), ["Status at byte 0: its length is 10, but 9 bytes are expected"]);
    let rate = [0x40, 0, 0, 0, 10, 0, 0, 0, 1, 0];
    assert_eq!(
        messages(&rate),
        ["Configuration at byte 0: its length is 10, but 13 bytes are expected"]
    );
}

#[test]
fn after_a_length_that_cannot_be_right_nothing_is_read() {
    let wakeup = [0x42, 0, 0, 0, 8, 0, 0, 0];
    for (bytes, message) in [
        (
            [0x20, 0, 0, 0, 0, 0, 0, 0],
            "Confirm at byte 0: its length is 0, but 8 bytes are expected",
        ),
        (
            [0x20, 0, 0, 0, 0xff, 0xff, 0xff, 0xff],
            "Confirm at byte 0: 16 bytes are left, but its length is 4294967295",
        ),
    ] {
        assert_eq!(messages(&[bytes, wakeup].concat()), [message]);
    }
    assert_eq!(
        messages(&wakeup[..5]),
        ["operation at byte 0: 5 bytes are left, but code and length have 8"]
    );
}

#[test]
fn arguments_that_the_tables_do_not_have_are_named() {
    let frame = |id: u16, ide, rtr, length: u8| {
        let [low, high] = id.to_le_bytes();
        let head = [0x10, 0, 0, 0, 16 + length, 0, 0, 0, low, high, 0, 0, ide, rtr, length, 0];
        [&head[..], &vec![0; length.into()]].concat()
    };
    let lin = [0x50, 0, 0, 0, 8, 0, 0, 0];
    for (bytes, message) in [
        (frame(0x800, 0, 0, 0), "CAN Transmit at byte 0: ID is 2048, expected at most 11 bits"),
        (frame(1, 2, 0, 0), "CAN Transmit at byte 0: Ide is 2, expected 0 or 1"),
        (frame(1, 0, 7, 0), "CAN Transmit at byte 0: Rtr is 7, expected 0 or 1"),
        (frame(1, 0, 0, 9), "CAN Transmit at byte 0: Data Length is 9, expected at most 8"),
        (lin.to_vec(), "operation with code 0x50 at byte 0: no such operation of CAN"),
    ] {
        assert_eq!(messages(&bytes), [message]);
    }
}

#[test]
fn what_the_tables_do_not_have_is_not_written() {
    let mut buffer = Vec::new();
    for (frame, message) in [
        (
            Frame::can(Id::Extended(1 << 29), &[]),
            "CAN Transmit of frame 0x20000000: ID is 536870912, expected at most 29 bits",
        ),
        (
            Frame::can_fd(Id::Standard(1), true, &[0; 9]),
            "CAN FD Transmit of frame 0x1: Data Length is 9, expected at most 8, or 12, 16, 20, 24, 32, 48 or 64",
        ),
    ] {
        let error = Operation::Transmit(frame).append(&mut buffer, 2048).unwrap_err();
        assert_eq!(error.to_string(), message);
    }
    let frame = Frame::can(Id::Standard(1), &[0; 8]);
    let error = Operation::Transmit(frame).append(&mut buffer, 20).unwrap_err();
    assert_eq!(
        error.to_string(),
        "CAN Transmit of frame 0x1 has 24 bytes, but its buffer has room for 20"
    );
    assert!(buffer.is_empty());
}
