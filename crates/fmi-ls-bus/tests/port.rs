//! Nodes and ports, by hosts that let their clocks tick.
#![cfg(feature = "fmi")]

use fmi_ls_bus::*;

/// Let `Tx_Clock` tick, as a host does when the port has asked for it; return what goes out.
fn transmitted(port: &mut Port) -> Vec<u8> {
    assert!(port.tx_clock.interval().is_some(), "the port has not asked for a tick");
    port.tx_clock.set_active(true);
    port.begin();
    let sent = port.tx_data.clone();
    port.tx_clock = Default::default();
    sent
}

/// Let `Rx_Clock` tick with these operations; return the frames.
fn received(node: &mut CanNode, operations: &[u8]) -> Vec<(u32, Vec<u8>)> {
    node.port.rx_data = operations.to_vec();
    node.port.rx_clock.set_active(true);
    let frames = node.receive().map(|frame| (frame.id.value(), frame.data.to_vec())).collect();
    node.port.rx_clock.set_active(false);
    frames
}

fn encoded(all: &[Operation]) -> Vec<u8> {
    let mut bytes = Vec::new();
    all.iter().for_each(|operation| operation.append(&mut bytes, 4096).unwrap());
    bytes
}

const FRAME: Frame = Frame::can(Id::Standard(0x123), &[1, 2]);

#[test]
fn two_nodes_need_no_bus() {
    let (mut sender, mut receiver) = (CanNode::default(), CanNode::default());
    sender.transmit(FRAME).unwrap();
    sender.transmit(Frame::can(Id::Standard(0x124), &[3])).unwrap();
    let sent = transmitted(&mut sender.port);
    assert_eq!(received(&mut receiver, &sent), [(0x123, vec![1, 2]), (0x124, vec![3])]);
    assert_eq!(receiver.receive().count(), 0, "the clock does not tick any more");
    assert_eq!(sender.unconfirmed(), 0);

    receiver.transmit(FRAME).unwrap();
    let sent = transmitted(&mut receiver.port);
    assert_eq!(received(&mut sender, &sent).len(), 1);
}

#[test]
fn a_node_tells_the_bus_its_settings_once_and_when_they_change() {
    let mut node = CanNode::default();
    node.transmit(FRAME).unwrap();
    let rate = Operation::Configuration(Configuration::BaudRate(500_000));
    let lost = Operation::Configuration(Configuration::ArbitrationLost(
        ArbitrationLostBehavior::BufferAndRetransmit,
    ));
    let frame = Operation::Transmit(FRAME);
    assert_eq!(transmitted(&mut node.port), encoded(&[rate, lost, frame]));
    node.transmit(FRAME).unwrap();
    assert_eq!(transmitted(&mut node.port), encoded(&[frame]), "what was sent before is gone");
    node.fd_baud_rate = 2_000_000;
    node.transmit(FRAME).unwrap();
    let rate = Operation::Configuration(Configuration::FdBaudRate(2_000_000));
    assert_eq!(transmitted(&mut node.port), encoded(&[rate, frame]));
}

#[test]
fn a_node_knows_which_frames_are_not_confirmed() {
    let mut node = CanNode::default();
    node.notifications = true;
    node.transmit(FRAME).unwrap();
    node.transmit(FRAME).unwrap();
    assert_eq!(node.unconfirmed(), 2);
    received(&mut node, &encoded(&[Operation::Confirm { id: 0x123 }]));
    assert_eq!(node.unconfirmed(), 1);
    received(&mut node, &encoded(&[Operation::ArbitrationLost { id: 0x123 }]));
    assert_eq!(node.unconfirmed(), 0);
}

#[test]
fn a_bus_off_node_says_so_and_transmits_nothing_until_it_recovers() {
    let mut node = CanNode::default();
    let error = Operation::BusError {
        id: 0x123,
        code: ErrorCode::Crc,
        flag: ErrorFlag::Secondary,
        is_sender: true,
    };
    received(&mut node, &encoded(&[error; 40]));
    assert_eq!(node.status(), Status::BusOff);
    assert_eq!(transmitted(&mut node.port), encoded(&[Operation::Status(Status::BusOff)]));
    node.transmit(FRAME).unwrap();
    assert_eq!(node.port.tx_clock.interval(), None);
    node.recover().unwrap();
    assert_eq!(transmitted(&mut node.port), encoded(&[Operation::Status(Status::ErrorActive)]));
}

#[test]
fn what_is_malformed_is_answered_and_the_rest_is_received() {
    let mut node = CanNode::default();
    let malformed = [0x41, 0, 0, 0, 9, 0, 0, 0, 7];
    let bytes = [&malformed[..], &encoded(&[Operation::Transmit(FRAME)])].concat();
    assert_eq!(received(&mut node, &bytes), [(0x123, vec![1, 2])]);
    let answer = Operation::FormatError { data: &malformed };
    assert_eq!(transmitted(&mut node.port), encoded(&[answer]));
}

#[test]
fn more_frames_than_fit_are_refused_and_those_before_go_out() {
    let mut node = CanNode::default();
    let full = (0..).map(|_| node.transmit(FRAME)).find_map(Result::err).unwrap();
    assert!(full.to_string().starts_with("CAN Transmit of frame 0x123 has 18 bytes"), "{full}");
    let sent = operations(&transmitted(&mut node.port)).flatten().count();
    // 13 and 10 bytes for the settings.
    assert_eq!(sent, 2 + (MAX_SIZE - 23) / 18);
}

#[test]
fn a_tick_that_was_asked_for_in_advance_sends_only_what_is_new() {
    let mut port = Port::default();
    port.send(&Operation::Wakeup).unwrap();
    port.tick_after(1.0);
    assert_eq!(port.tx_clock.interval(), Some(0.0), "operations go out first");
    assert_eq!(transmitted(&mut port), encoded(&[Operation::Wakeup]));
    port.tick_after(1.0);
    assert_eq!(port.tx_clock.interval(), Some(1.0));
    assert_eq!(transmitted(&mut port), []);
}
