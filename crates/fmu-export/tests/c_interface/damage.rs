//! Damaged and forged serialized FMU states.

use std::ptr::null_mut;

use fmu_export::fmi2::{fmi2Error, fmi2Fatal, fmi2OK};
use proptest::prelude::*;
use proptest::sample::Index;

use crate::host::Slave;
use crate::models::*;

/// An instance of a model after a step, and its serialized state.
fn stepped(model: usize) -> (Slave, Vec<u8>) {
    let mut slave = Slave::of(model);
    assert_eq!(slave.start(0.0, Some(10.0)).step(0.0, 0.5), fmi2OK);
    let bytes = slave.snapshot();
    (slave, bytes)
}

/// Checks that bytes are rejected with a reason and no state is created.
fn assert_refused(slave: &mut Slave, bytes: &[u8]) {
    let mut state = null_mut();
    slave.forget_messages();
    assert_eq!(slave.deserialize(bytes, &mut state), fmi2Error, "{bytes:?}");
    assert!(state.is_null());
    assert_eq!(slave.messages().len(), 1);
    assert!(
        slave
            .last_message()
            .starts_with("fmi2DeSerializeFMUstate: ")
    );
}

#[test]
fn truncated_and_extended_bytes_are_rejected() {
    let (mut slave, bytes) = stepped(0);
    for place in 0..bytes.len() {
        let (head, tail) = bytes.split_at(place);
        assert_refused(&mut slave, head);
        assert_refused(&mut slave, &[head, &[0], tail].concat());
        if place > 0 {
            assert_refused(&mut slave, tail);
        }
    }
    for added in [&[0][..], &[0; 16], &bytes] {
        assert_refused(&mut slave, &[&bytes, added].concat());
    }
    assert_eq!(slave.snapshot(), bytes);
}

#[test]
fn a_single_flipped_bit_is_rejected() {
    let (mut slave, bytes) = stepped(0);
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert_refused(&mut slave, &damaged);
    }
}

#[test]
fn rejected_bytes_leave_an_existing_state_unchanged() {
    let (mut slave, bytes) = stepped(0);
    let mut state = slave.save();
    let address = state;
    assert_eq!(slave.deserialize(&bytes[1..], &mut state), fmi2Error);
    assert_eq!((state, slave.serialize(state)), (address, bytes));
    assert_eq!(slave.free_state(&mut state), fmi2OK);
}

/// The content followed by a valid checksum: 128-bit FNV-1a.
pub fn sealed(content: &[u8]) -> Vec<u8> {
    let sum = content.iter().fold(
        0x6c62_272e_07bb_0142_62b8_2175_6295_c58d,
        |sum: u128, &byte| (sum ^ u128::from(byte)).wrapping_mul(0x0100_0000_0000_0000_0000_013b),
    );
    [content, &sum.to_le_bytes()].concat()
}

/// A serialized state without its checksum.
pub fn content(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len() - 16]
}

#[test]
fn damage_with_a_valid_checksum_is_rejected() {
    let (mut slave, bytes) = stepped(0);
    assert_eq!(sealed(content(&bytes)), bytes);
    // Magic number, version, both ends of the GUID, an invalid mode, and phases that are fatal, of a
    // callback, of model exchange, or invalid.
    for (place, byte) in [
        (0, b'f'),
        (8, 1),
        (12, b'<'),
        (49, b'>'),
        (50, 3),
        (51, 6),
        (51, 12),
        (51, 8),
        (51, 13),
    ] {
        let mut forged = content(&bytes).to_vec();
        forged[place] = byte;
        assert_refused(&mut slave, &sealed(&forged));
    }
    assert_refused(&mut slave, &sealed(&[content(&bytes), &[0]].concat()));
    for end in 0..bytes.len() - 16 {
        assert_refused(&mut slave, &sealed(&bytes[..end]));
    }
}

/// An edit of the bytes at a position.
#[derive(Debug, Clone)]
enum Edit {
    Write(Index, Vec<u8>),
    Insert(Index, Vec<u8>),
    Remove(Index, usize),
}

fn edit() -> impl Strategy<Value = Edit> {
    let numbers = prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::MAX, -0.0, 5e-324]);
    let bytes = prop_oneof![
        prop::collection::vec(any::<u8>(), 1..4),
        numbers.prop_map(|number| number.to_le_bytes().to_vec()),
    ];
    prop_oneof![
        4 => (any::<Index>(), bytes.clone()).prop_map(|(place, bytes)| Edit::Write(place, bytes)),
        1 => (any::<Index>(), bytes).prop_map(|(place, bytes)| Edit::Insert(place, bytes)),
        1 => (any::<Index>(), 1..20usize).prop_map(|(place, n)| Edit::Remove(place, n)),
    ]
}

/// Length of the header: magic number, version and GUID.
const HEADER: usize = 8 + 4 + 38;

fn apply(bytes: &mut Vec<u8>, edit: &Edit) {
    let place = |index: &Index| HEADER + index.index(bytes.len() - HEADER + 1);
    match edit {
        Edit::Write(index, new) => {
            let place = place(index);
            bytes.splice(
                place..(place + new.len()).min(bytes.len()),
                new.iter().copied(),
            );
        }
        Edit::Insert(index, new) => {
            let place = place(index);
            bytes.splice(place..place, new.iter().copied());
        }
        Edit::Remove(index, n) => {
            let place = place(index);
            bytes.drain(place..(place + n).min(bytes.len()));
        }
    }
}

/// Makes the usual calls; each may be rejected, but none may panic unless the model is set to.
fn uses(slave: &mut Slave) {
    let (mut time, mut trouble) = (0.0, [PANIC]);
    let last = slave.get_reals(&[TROUBLE], &mut trouble);
    let mut statuses = vec![
        last,
        slave.get_all(Kind::Real, &[Y, 20, SUM]).0,
        slave.get_all(Kind::Integer, &[ORDER, LAW]).0,
        slave.get_all(Kind::String, &[LABEL, REPORT]).0,
        slave.set(U, 0.5),
        slave.exit_initialization_mode(),
        slave.real_status(2, &mut time),
    ];
    statuses.extend([
        slave.step(time, 0.1),
        slave.step(time + 0.1, 1e9),
        slave.terminate(),
    ]);
    if trouble[0] != PANIC {
        assert!(
            !statuses.contains(&fmi2Fatal),
            "{statuses:?} {}",
            slave.last_message()
        );
        assert_eq!(slave.reset(), fmi2OK);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn noise_is_rejected(noise in prop::collection::vec(any::<u8>(), 0..1000), keep in 0..70usize) {
        let (mut slave, bytes) = stepped(0);
        assert_refused(&mut slave, &noise);
        assert_refused(&mut slave, &sealed(&noise));
        assert_refused(&mut slave, &[&bytes[..keep], &noise].concat());
    }

    /// A forged state with a valid checksum may be accepted, but using it must not crash or hang.
    #[test]
    fn forged_states_do_not_crash_or_hang(
        model in PROBE..READER,
        fresh: bool,
        edits in prop::collection::vec(edit(), 1..4),
    ) {
        let (mut slave, bytes) = stepped(model);
        let genuine = if fresh { Slave::of(model).snapshot() } else { bytes };
        let mut forged = content(&genuine).to_vec();
        for edit in &edits {
            apply(&mut forged, edit);
        }
        let mut state = null_mut();
        if slave.deserialize(&sealed(&forged), &mut state) == fmi2OK {
            if slave.set_state(state) == fmi2Error {
                // It is that of an instance for model exchange.
                assert!(slave.last_message().contains("expected one for co-simulation"));
                assert_eq!(slave.free_state(&mut state), fmi2OK);
                return Ok(());
            }
            let mut again = null_mut();
            let bytes = slave.snapshot();
            assert_eq!(slave.deserialize(&bytes, &mut again), fmi2OK);
            assert_eq!(slave.serialize(again), bytes);
            for state in [&mut state, &mut again] {
                assert_eq!(slave.free_state(state), fmi2OK);
            }
            uses(&mut slave);
        }
    }
}
