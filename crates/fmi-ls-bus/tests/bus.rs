//! The bus, by schedules that are worked out by hand.

use fmi_ls_bus::*;

/// A bus at 500 kbit/s, and what it has sent: the time (bits from 0 s), the node, and the operation.
struct Recorded {
    bus: Bus,
    sent: Vec<(f64, usize, String)>,
}

const BIT: f64 = 1.0 / 500e3;

/// Bits of a frame with 8 bytes 0x55 and this identifier.
fn length(id: u16) -> f64 {
    FrameBits::of(&Frame::can(Id::Standard(id), &[0x55; 8])).unwrap().nominal.into()
}

/// The short form of an operation.
fn word(operation: &Operation) -> String {
    match operation {
        Operation::Transmit(frame) => format!("frame {:#x}", frame.id.value()),
        Operation::Confirm { id } => format!("confirm {id:#x}"),
        Operation::ArbitrationLost { id } => format!("lost {id:#x}"),
        Operation::BusError { id, code, flag, is_sender } => {
            let sender = if *is_sender { ", sender" } else { "" };
            format!("error {id:#x}: {code:?}, {flag:?}{sender}")
        }
        Operation::FormatError { data } => format!("format error of {} bytes", data.len()),
        other => format!("{other:?}"),
    }
}

impl Recorded {
    fn new(nodes: usize) -> Self {
        Self { bus: Bus::new(nodes), sent: Vec::new() }
    }

    fn record(&mut self, now: f64, call: impl FnOnce(&mut Bus, &mut dyn FnMut(usize, Operation))) {
        let sent = &mut self.sent;
        call(&mut self.bus, &mut |node, operation| {
            sent.push(((now / BIT * 10.0).round() / 10.0, node, word(&operation)));
        });
    }

    /// Pass operations of a node to the bus at a time in bits.
    fn pass(&mut self, bits: f64, node: usize, all: &[Operation]) -> &mut Self {
        let now = bits * BIT;
        while let Some(next) = self.bus.next_event().filter(|next| *next < now) {
            self.record(next, |bus, send| bus.advance(next, send));
        }
        let mut bytes = Vec::new();
        all.iter().for_each(|operation| operation.append(&mut bytes, 4096).unwrap());
        self.record(now, |bus, send| bus.receive(now, node, &bytes, &mut *send));
        self.record(now, |bus, send| bus.advance(now, send));
        self
    }

    /// Pass a frame with 8 bytes 0x55.
    fn frame(&mut self, bits: f64, node: usize, id: u16) -> &mut Self {
        self.pass(bits, node, &[Operation::Transmit(Frame::can(Id::Standard(id), &[0x55; 8]))])
    }

    /// What the bus sends until everything is transmitted.
    fn finish(&mut self) -> Vec<(f64, usize, &str)> {
        self.pass(1e6, usize::MAX, &[]);
        self.sent.iter().map(|(time, node, word)| (*time, *node, &**word)).collect()
    }
}

#[test]
fn a_frame_on_the_idle_bus_arrives_after_its_bits() {
    let sent = [
        (10.0 + length(0x100), 0, "confirm 0x100"),
        (10.0 + length(0x100), 1, "frame 0x100"),
        (10.0 + length(0x100), 2, "frame 0x100"),
    ];
    assert_eq!(Recorded::new(3).frame(10.0, 0, 0x100).finish(), sent);
}

#[test]
fn a_frame_waits_for_the_one_on_the_bus_and_three_bits() {
    let mut bus = Recorded::new(2);
    let first = length(0x700);
    let second = first + 3.0 + length(0x100);
    let sent = [
        (first, 0, "confirm 0x700"),
        (first, 1, "frame 0x700"),
        (second, 0, "frame 0x100"),
        (second, 1, "confirm 0x100"),
    ];
    assert_eq!(bus.frame(0.0, 0, 0x700).frame(5.0, 1, 0x100).finish(), sent);
    let occupied = (second + 3.0) * BIT;
    assert!((bus.bus.busy - occupied).abs() < 1e-12);
}

#[test]
fn the_lower_identifier_wins_also_if_it_comes_later_at_the_same_instant() {
    for order in [[(0, 0x200), (1, 0x100)], [(1, 0x100), (0, 0x200)]] {
        let mut bus = Recorded::new(2);
        order.iter().for_each(|(node, id)| _ = bus.frame(0.0, *node, *id));
        let second = length(0x100) + 3.0 + length(0x200);
        let sent = [
            (length(0x100), 0, "frame 0x100"),
            (length(0x100), 1, "confirm 0x100"),
            (second, 0, "confirm 0x200"),
            (second, 1, "frame 0x200"),
        ];
        assert_eq!(bus.finish(), sent);
    }
}

#[test]
fn a_node_that_discards_is_told_that_it_has_lost() {
    let discard = Configuration::ArbitrationLost(ArbitrationLostBehavior::DiscardAndNotify);
    let mut bus = Recorded::new(2);
    bus.pass(0.0, 0, &[Operation::Configuration(discard)]);
    bus.frame(0.0, 0, 0x200).frame(0.0, 1, 0x100);
    let sent = [
        (0.0, 0, "lost 0x200"),
        (length(0x100), 0, "frame 0x100"),
        (length(0x100), 1, "confirm 0x100"),
    ];
    assert_eq!(bus.finish(), sent);
}

#[test]
fn the_frames_of_a_node_keep_their_order() {
    let mut bus = Recorded::new(2);
    bus.frame(0.0, 0, 0x300).frame(0.0, 0, 0x100).frame(0.0, 1, 0x200);
    let words: Vec<_> = bus.finish().into_iter().filter(|(_, node, _)| *node == 1).collect();
    let words: Vec<_> = words.into_iter().map(|(_, _, word)| word).collect();
    assert_eq!(words, ["confirm 0x200", "frame 0x300", "frame 0x100"]);
}

#[test]
fn identifiers_compete_bit_by_bit() {
    // From the highest priority to the lowest one.
    let remote = |id| Frame { id, format: Format::Remote { length: 0 }, data: &[] };
    let frames = [
        Frame::can(Id::Standard(0x0ff), &[]),
        Frame::can(Id::Standard(0x100), &[]),
        remote(Id::Standard(0x100)),
        Frame::can(Id::Extended(0x100 << 18), &[]),
        remote(Id::Extended(0x100 << 18)),
        Frame::can(Id::Extended(0x100 << 18 | 1), &[]),
        Frame::can(Id::Standard(0x101), &[]),
    ];
    let mut bus = Recorded::new(frames.len() + 1);
    for (node, frame) in frames.iter().enumerate().rev() {
        bus.pass(0.0, node, &[Operation::Transmit(*frame)]);
    }
    let confirmed: Vec<_> = bus
        .finish()
        .iter()
        .filter(|sent| sent.2.starts_with("confirm"))
        .map(|sent| sent.1)
        .collect();
    assert_eq!(confirmed, [0, 1, 2, 3, 4, 5, 6]);
}

#[test]
fn error_active_nodes_go_first() {
    let mut bus = Recorded::new(2);
    bus.pass(0.0, 0, &[Operation::Status(Status::ErrorPassive)]);
    bus.frame(0.0, 0, 0x100).frame(0.0, 1, 0x200);
    assert_eq!(bus.finish()[0].2, "frame 0x200");
}

#[test]
fn a_bus_off_node_neither_sends_nor_receives_nor_acknowledges() {
    let off = [Operation::Status(Status::BusOff)];
    let mut bus = Recorded::new(3);
    bus.pass(0.0, 2, &off).frame(0.0, 2, 0x100).frame(0.0, 0, 0x200);
    let arrived = length(0x200);
    let sent = [(arrived, 0, "confirm 0x200"), (arrived, 1, "frame 0x200")];
    assert_eq!(bus.finish(), sent);

    let mut bus = Recorded::new(2);
    bus.pass(0.0, 1, &off).frame(0.0, 0, 0x200);
    let failed = length(0x200) + 7.0;
    assert_eq!(bus.finish(), [(failed, 0, "error 0x200: Acknowledge, Primary, sender")]);
}

#[test]
fn nodes_set_the_baud_rate() {
    let rate = |rate| [Operation::Configuration(Configuration::BaudRate(rate))];
    let mut bus = Recorded::new(2);
    bus.pass(0.0, 0, &rate(250_000)).frame(0.0, 1, 0x200);
    assert_eq!(bus.finish()[0], (2.0 * length(0x200), 0, "frame 0x200"));
    assert_eq!(bus.bus.mismatch(), None);

    let mut bus = Recorded::new(2);
    bus.pass(0.0, 0, &rate(500_000)).pass(0.0, 1, &rate(100_000)).frame(0.0, 0, 0x200);
    let failed = length(0x200) + 7.0;
    let sent = [
        (failed, 0, "error 0x200: BitStuffing, Secondary, sender"),
        (failed, 1, "error 0x200: BitStuffing, Primary"),
    ];
    assert_eq!(bus.finish(), sent);
    let mismatch = BaudRateMismatch { nodes: [0, 1], rates: [500_000, 100_000] };
    assert_eq!(bus.bus.mismatch(), Some(mismatch));
}

#[test]
fn the_data_of_can_fd_has_its_own_baud_rate() {
    let frame = Frame::can_fd(Id::Standard(0x555), true, &[0x55; 64]);
    let mut bus = Recorded::new(2);
    bus.pass(0.0, 1, &[Operation::Configuration(Configuration::FdBaudRate(5_000_000))]);
    bus.pass(0.0, 0, &[Operation::Transmit(frame)]);
    // 26 bits at 500 kbit/s, 550 at 5 Mbit/s; tests/timing.rs has the fields.
    assert_eq!(bus.finish()[1], (26.0 + 550.0 / 10.0, 1, "frame 0x555"));
}

#[test]
fn lost_frames_depend_on_the_seed_only() {
    let lost = |seed| -> Vec<bool> {
        let mut bus = Recorded::new(2);
        bus.bus.loss = 0.25;
        bus.bus.seed = seed;
        (0..400).for_each(|i| _ = bus.frame(f64::from(i) * 200.0, 0, 0x100));
        bus.finish().iter().filter(|sent| sent.1 == 1).map(|sent| sent.2 != "frame 0x100").collect()
    };
    let first = lost(1);
    assert_eq!(first, lost(1));
    assert_ne!(first, lost(2));
    // 100 are expected, with a standard deviation of sqrt(400 * 0.25 * 0.75) = 8.7.
    let count = first.iter().filter(|lost| **lost).count();
    assert!(count.abs_diff(100) < 35, "{count}");
}

#[test]
fn a_lost_frame_is_transmitted_again_as_often_as_the_bus_says() {
    let mut bus = Recorded::new(2);
    bus.bus.loss = 1.0;
    bus.bus.retransmissions = 2;
    bus.frame(0.0, 0, 0x100);
    let attempt = length(0x100) + 7.0;
    let times: Vec<f64> =
        bus.finish().iter().filter(|sent| sent.1 == 0).map(|sent| sent.0).collect();
    assert_eq!(times, [attempt, 2.0 * attempt + 3.0, 3.0 * attempt + 6.0]);
}

#[test]
fn a_bus_without_notifications_only_passes_frames_on() {
    let mut bus = Recorded::new(2);
    bus.bus.notifications = false;
    bus.frame(0.0, 0, 0x100);
    assert_eq!(bus.finish(), [(length(0x100), 1, "frame 0x100")]);
}

#[test]
fn wake_up_reaches_all_others_at_once() {
    let mut bus = Recorded::new(3);
    bus.pass(7.0, 1, &[Operation::Wakeup]);
    assert_eq!(bus.finish(), [(7.0, 0, "Wakeup"), (7.0, 2, "Wakeup")]);
}

#[test]
fn what_is_malformed_goes_back_and_the_rest_is_transmitted() {
    let mut bus = Recorded::new(2);
    let mut bytes = vec![0x40, 0, 0, 0, 13, 0, 0, 0, 1, 0, 0, 0, 0];
    bytes.extend([0x99, 0, 0, 0, 9, 0, 0, 0, 0]);
    let frame = Frame::can(Id::Standard(0x100), &[0x55; 8]);
    Operation::Transmit(frame).append(&mut bytes, 100).unwrap();
    bus.record(0.0, |bus, send| bus.receive(0.0, 0, &bytes, send));
    bus.pass(0.0, 1, &[]);
    let sent = bus.finish();
    assert_eq!(sent[0], (0.0, 0, "format error of 13 bytes"));
    assert_eq!(sent[1], (0.0, 0, "format error of 9 bytes"));
    assert_eq!(sent[3], (length(0x100), 1, "frame 0x100"));
}

#[test]
fn a_full_queue_refuses_further_frames() {
    let mut bus = Recorded::new(2);
    (0..QUEUE).for_each(|_| _ = bus.frame(0.0, 0, 0x100));
    assert!(bus.sent.is_empty());
    bus.frame(0.0, 0, 0x101);
    assert_eq!(bus.sent, [(0.0, 0, "lost 0x101".to_owned())]);
}

#[test]
fn a_bus_that_is_called_late_has_the_same_schedule() {
    let schedule = |late: bool| {
        let mut bus = Recorded::new(2);
        bus.frame(0.0, 0, 0x700).frame(5.0, 1, 0x100);
        if late {
            bus.record(1.0, |bus, send| bus.advance(1.0, send));
        }
        bus.finish();
        bus.bus.busy
    };
    assert_eq!(schedule(true), schedule(false));
}
