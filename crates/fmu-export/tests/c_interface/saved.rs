//! FMU states (FMI 2.0.5, section 2.1.8; FMI 3.0.2, section 2.2.7.4): contents, ownership, serialization, and
//! damaged or forged bytes.

use std::ffi::c_void;
use std::ptr::{null, null_mut};

use fmu_description::Type;
use fmu_export::Variables;
use fmu_export::fmi2::fmi2LastSuccessfulTime;
use proptest::prelude::*;
use proptest::sample::{Index, select};

use crate::driver::*;
use crate::models::*;

const H: f64 = 0.25;

/// Steps with inputs that change at every step; returns outputs after each.
fn drive(f: Fmu, first: u32, steps: u32) -> Vec<[f64; 2]> {
    let step = |k| {
        let k = f64::from(k);
        assert_eq!(f.set_f64(&[U, V], &[0.1 * k, -0.15 * k]), OK);
        assert!(f.kind.0 == Fmi3 || f.set_input_derivatives(&[U], &[1], &[0.7 - k]) == OK);
        f.steps(k * H, H);
        f.get([Y, SUM])
    };
    (first..first + steps).map(step).collect()
}

/// An instance after five steps, with values of all types.
fn moving(version: FmiVersion) -> Instance {
    let it = Instance::new((version, Stepped), EVERY);
    let settable =
        |fact: &&Fact| fact.is_settable(false) && ![U, V, TROUBLE].contains(&fact.reference);
    for fact in FACTS.iter().filter(settable) {
        let n = if version == Fmi2 { 1 } else { fact.start.len() };
        let is_missing = (version, fact.of) == (Fmi2, Type::Binary);
        let set = || it.set_all(fact.of, &[fact.reference], &vec![fact.other_value(); n]);
        assert!(is_missing || set() == OK, "{}", fact.name);
    }
    it.start(0.0, None);
    drive(*it, 0, 5);
    it
}

#[test]
fn restored_states_continue_bit_for_bit_in_any_instance() {
    for version in [Fmi2, Fmi3] {
        let it = moving(version);
        let kind = it.kind;
        let mut state = it.save();
        let bytes = it.serialize(state);
        // More values than the history of the model keeps.
        let expected = drive(*it, 5, 50);
        assert_eq!(it.set_state(state), OK);
        assert_eq!(it.snapshot(), bytes);
        assert_eq!(drive(*it, 5, 50), expected);
        drop(it);
        // A state outlives the instance it was taken from.
        let other = Instance::new(kind, EVERY);
        ok([other.set_state(state), other.free_state(&mut state)]);
        assert!(state.is_null());
        assert_eq!(drive(*other, 5, 50), expected);
        let other = Instance::new(kind, EVERY);
        assert_eq!(drive(other.resume(&bytes), 5, 50), expected);
        // States include the phase, the time and the stop time.
        let made = Instance::new(kind, EVERY).snapshot();
        other.reset();
        other.start(1.0, Some(2.0));
        other.steps(1.0, H);
        let running = other.snapshot();
        assert_eq!(other.terminate(), OK);
        let (ended, other) = (other.snapshot(), Instance::new(kind, EVERY));
        other.resume(&running);
        other.refuses("communication point", |f| f.step(0.5, H));
        other.refuses("stop time", |f| f.step(1.0 + H, 1.0));
        other.steps(1.0 + H, H);
        other.resume(&ended);
        other.refuses("terminated", |f| f.step(1.0 + H, H));
        other.resume(&made);
        other.refuses("instantiated", |f| f.step(1.0 + H, H));
        other.start(0.0, None);
        other.steps(0.0, 5.0);
    }
}

#[test]
fn states_can_be_overwritten_and_freed() {
    for version in [Fmi2, Fmi3] {
        let it = moving(version);
        let fresh = Instance::new(it.kind, EVERY).snapshot();
        let state = &mut it.save();
        let address = *state;
        drive(*it, 5, 1);
        assert_eq!(it.get_state(state), OK);
        assert_eq!((*state, it.serialize(*state)), (address, it.snapshot()));
        assert_eq!(it.deserialize(&fresh[1..], state), ERROR);
        assert_eq!((*state, it.serialize(*state)), (address, it.snapshot()));
        assert_eq!(it.deserialize(&fresh, state), OK);
        assert_eq!((*state, it.serialize(*state)), (address, fresh));
        ok([it.free_state(state)]);
        assert!(state.is_null());
        ok([it.free_state(state)]);
    }
}

#[test]
fn a_state_of_another_model_or_mode_is_refused() {
    for from in KINDS {
        let source = Instance::running(from, BALL);
        let (mut state, bytes) = (source.save(), source.snapshot());
        for to in KINDS.into_iter().filter(|to| to.0 == from.0) {
            let target = Instance::running(to, BALL);
            if from == to {
                ok([target.set_state(state)]);
                assert_eq!(target.snapshot(), bytes);
            } else {
                let words = "the state is from an instance for";
                target.refuses(words, |f| f.set_state(state));
                target.fails(ERROR, "; expected one for ", |f| f.set_state(state));
            }
            let other = Instance::running(to, SAMPLED);
            other.refuses("the state", |f| f.set_state(state));
            other.refuses("another model", |f| f.serialized_size(state, &mut 0));
            other.refuses("another model", |f| f.serialize_into(state, &mut [0; 999]));
            let mut none = null_mut();
            let words = "the bytes are a state of the model {";
            other.refuses(words, |f| f.deserialize(&bytes, &mut none));
            assert!(none.is_null());
        }
        assert_eq!(source.free_state(&mut state), OK);
    }
}

#[test]
fn buffers_and_pointers_are_checked() {
    for version in [Fmi2, Fmi3] {
        let it = moving(version);
        let (mut state, mut none) = (it.save(), null_mut::<c_void>());
        let bytes = it.serialize(state);
        let size = bytes.len();
        for room in [0, 1, 10, size / 2, size - 1] {
            let mut buffer = vec![0xaa; room];
            let words = format!("its size {room} is too small; expected {size} bytes");
            it.refuses(&words, |f| f.serialize_into(state, &mut buffer));
            assert_eq!(buffer, vec![0xaa; room]);
        }
        // A buffer may be larger, and the instance may have advanced.
        assert_eq!(it.reset(), OK);
        let mut buffer = vec![0xaa; size + 50];
        assert_eq!(it.serialize_into(state, &mut buffer), OK);
        assert_eq!(buffer, [&bytes[..], &[0xaa; 50]].concat());
        let words = "the FMU state is NULL";
        it.refuses(words, |f| f.set_state(null_mut()));
        it.refuses(words, |f| f.serialized_size(null_mut(), &mut 5));
        it.refuses(words, |f| f.serialize_into(null_mut(), &mut buffer));
        let words = "a pointer is NULL";
        it.refuses(words, |f| f.get_state(null_mut()));
        it.refuses(words, |f| f.serialized_size(state, null_mut()));
        it.refuses(words, |f| f.deserialize(&bytes, null_mut()));
        let words = "the buffer is NULL";
        let (nothing, state_of) = (Argument::memory(null::<u8>(), size), Argument::from(state));
        it.refuses(words, |f| f.call("serialize_fmu_state", &[state_of, nothing]));
        let words = "the bytes are NULL";
        let to = Argument::from(&mut none);
        it.refuses(words, |f| f.call("deserialize_fmu_state", &[nothing, to]));
        let nothing = Argument::memory(null::<u8>(), 0);
        it.refuses("damaged", |f| f.call("deserialize_fmu_state", &[nothing, to]));
        assert_eq!((none.is_null(), it.free_state(null_mut())), (true, OK));
        let mut memory = [0u128; 64];
        for offset in [0, 1] {
            let foreign = memory.as_mut_ptr().cast::<u8>().wrapping_add(offset).cast();
            let words = "the pointer does not point to an FMU state";
            it.refuses(words, |f| f.set_state(foreign));
            it.refuses(words, |f| f.free_state(&mut { foreign }));
            it.refuses(words, |f| f.get_state(&mut { foreign }));
            it.refuses(words, |f| f.serialized_size(foreign, &mut 0));
            it.refuses(words, |f| f.serialize_into(foreign, &mut [0; 8]));
        }
        assert_eq!(memory, [0; 64]);
        ok([it.free_state(&mut none), it.free_state(&mut state)]);
    }
}

// --- damaged and forged bytes -------------------------------------------------------------------

/// Checks that bytes are refused with a reason and no state is created.
fn assert_refused(it: &Instance, bytes: &[u8]) {
    let mut state = null_mut();
    it.forget_messages();
    assert_eq!(it.deserialize(bytes, &mut state), ERROR, "{bytes:?}");
    assert!(state.is_null());
    assert_eq!(it.messages().len(), 1);
    let (text, function) = (it.last_message(), it.name("deserialize_fmu_state"));
    assert!(text.starts_with(function), "{text}");
}

/// The content followed by a valid checksum: 128-bit FNV-1a.
fn sealed(content: &[u8]) -> Vec<u8> {
    let sum = content.iter().fold(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d, |sum: u128, &byte| {
        (sum ^ u128::from(byte)).wrapping_mul(0x0100_0000_0000_0000_0000_013b)
    });
    [content, &sum.to_le_bytes()].concat()
}

/// A serialized state without its checksum.
fn content(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len() - 16]
}

/// Length of the header: magic number, format and GUID.
const HEADER: usize = 8 + 4 + 38;

#[test]
fn damaged_bytes_are_refused() {
    let it = moving(Fmi2);
    let bytes = it.snapshot();
    for place in 0..bytes.len() {
        let (head, tail) = bytes.split_at(place);
        assert_refused(&it, head);
        assert_refused(&it, &[head, &[0], tail].concat());
        assert_refused(&it, &tail[1..]);
        let mut damaged = bytes.clone();
        damaged[place] ^= 1 << (place % 8);
        assert_refused(&it, &damaged);
    }
    for added in [&[0][..], &[0; 16], &bytes] {
        assert_refused(&it, &[&bytes, added].concat());
    }
    assert_eq!(it.snapshot(), bytes);
    // With a valid checksum: magic number, format, both ends of the GUID, an invalid mode, and phases that
    // are fatal, of a callback, of model exchange, or invalid.
    assert_eq!(sealed(content(&bytes)), bytes);
    let header = [(0, b'f'), (8, !bytes[8]), (12, b'<'), (49, b'>'), (50, 3)];
    let phases = [6, 12, 8, 13].map(|phase| (51, phase));
    for (place, byte) in header.into_iter().chain(phases) {
        let mut forged = content(&bytes).to_vec();
        forged[place] = byte;
        assert_refused(&it, &sealed(&forged));
    }
    assert_refused(&it, &sealed(&[content(&bytes), &[0]].concat()));
    for end in 0..bytes.len() - 16 {
        assert_refused(&it, &sealed(&bytes[..end]));
    }
}

/// Makes the usual calls; each may be refused, but none may panic unless the model is set to.
fn uses(f: Fmu, model: usize) {
    let mut time = [0.0];
    let mut statuses = vec![match f.kind {
        (Fmi3, _) => f.get_f64(&[[COUNT, Sampled::COUNT, Ball::TIME][model]], &mut time),
        (Fmi2, Stepped) => f.real_status(fmi2LastSuccessfulTime, &mut time[0]),
        _ => OK,
    }];
    for reference in [[TROUBLE; 2], [Sampled::FAILURE; 2], [Ball::TROUBLE, Ball::FAULT]][model] {
        let mut trouble = [0.0];
        f.get_f64(&[reference], &mut trouble);
        if trouble == [BUG] {
            return;
        }
    }
    statuses.push(f.exit_initialization_mode());
    statuses.push(f.get_f64(&[Y.min(Ball::V_DOT)], &mut [0.0]));
    if f.kind.1 != Stepped {
        statuses.extend([f.try_update().0, f.try_end_event_mode()]);
    }
    if f.kind.1 == Exchanged {
        statuses.push(f.get_derivatives(&mut [0.0; 2]));
    }
    statuses.extend([f.step(time[0], 0.1), f.step(time[0] + 0.1, 1e9), f.terminate()]);
    assert!(!statuses.contains(&FATAL), "{statuses:?}");
    assert_eq!(f.reset(), OK);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// A forged state with a valid checksum may be accepted, but using it must not crash or hang.
    #[test]
    fn forged_states_do_not_crash_or_hang(
        kind in select(KINDS.to_vec()),
        model in EVERY..=BALL,
        fresh: bool,
        edits in prop::collection::vec((any::<Index>(), 0..2usize, prop_oneof![
            4 => prop::collection::vec(any::<u8>(), 0..4),
            1 => select(vec![f64::NAN, f64::INFINITY, f64::MAX, -0.0, 5e-324])
                .prop_map(|number| number.to_le_bytes().to_vec()),
        ]), 1..4),
    ) {
        // With events, a step of 1e9 s would have very many samples.
        let model = if kind.1 == Stepped { model } else { BALL };
        let it = if fresh { Instance::new(kind, model) } else { Instance::running(kind, model) };
        let mut forged = content(&it.snapshot()).to_vec();
        for (place, change, new) in edits {
            // Written over others, or with a change of the length.
            let start = HEADER + place.index(forged.len() - HEADER + 1);
            let end = (start + (1 - change) * new.len()).min(forged.len());
            forged.splice(start..end, new);
        }
        let mut state = null_mut();
        if it.deserialize(&sealed(&forged), &mut state) == OK {
            if it.set_state(state) == OK {
                let (mut again, bytes) = (null_mut(), it.snapshot());
                assert_eq!(it.deserialize(&bytes, &mut again), OK);
                assert_eq!(it.serialize(again), bytes);
                assert_eq!(it.free_state(&mut again), OK);
                uses(*it, model);
            } else {
                it.says("the state is from an instance for");
            }
            assert_eq!(Instance::new(kind, model).free_state(&mut state), OK);
        }
    }
}

#[test]
fn a_model_with_a_field_that_cannot_be_saved_refuses_to_be() {
    for kind in PLAIN {
        let it = Instance::running(kind, DEVICE);
        let words = "the model has fields that cannot be saved: canGetAndSetFMUState is false";
        let mut state = null_mut();
        it.fails(ERROR, words, |f| f.get_state(&mut state));
        it.fails(ERROR, words, |f| f.deserialize(b"", &mut state));
        assert!(state.is_null());
        it.steps(0.0, 1.0);
    }
}

#[test]
fn a_field_of_a_type_without_traits_is_made_and_saved_by_functions() {
    for kind in PLAIN {
        let it = Instance::running(kind, FOREIGN);
        ok([it.set_f64(&[Foreign::U], &[4.0])]);
        it.steps(0.0, H);
        // 10 + 4 * 0.25, and 1 * (2 + 1)
        assert_eq!(it.get([Foreign::Y]), [14.0]);
        let (mut state, bytes) = (it.save(), it.snapshot());
        it.steps(H, H);
        assert_eq!(it.get([Foreign::Y]), [16.0]);
        ok([it.set_state(state), it.free_state(&mut state)]);
        it.steps(H, H);
        assert_eq!(it.get([Foreign::Y]), [16.0]);
        let other = Instance::new(kind, FOREIGN);
        other.resume(&bytes).steps(H, H);
        assert_eq!(other.get([Foreign::Y]), [16.0]);
        other.reset();
        other.start(0.0, None);
        other.steps(0.0, H);
        assert_eq!(other.get([Foreign::Y]), [13.0]);
    }
}

#[test]
fn a_model_with_a_field_that_is_only_copied_refuses_to_be_serialized() {
    for kind in PLAIN {
        let it = Instance::running(kind, NOISY);
        it.steps(0.0, 1.0);
        let mut state = it.save();
        it.steps(1.0, 1.0);
        ok([it.set_state(state)]);
        it.steps(1.0, 1.0);
        assert_eq!(it.get([Noisy::Y]), [2.0]);
        let words = "the model has fields that cannot be serialized: canSerializeFMUState is false";
        let (mut size, mut none) = (0, null_mut());
        it.fails(ERROR, words, |f| f.serialized_size(state, &mut size));
        it.fails(ERROR, words, |f| f.deserialize(b"", &mut none));
        ok([it.free_state(&mut state)]);
    }
}

/// The layout of a struct with these fields.
macro_rules! layout {
    ($($(#[$option:meta])* $field:ident: $type:ty),*) => {{
        #[derive(Variables)]
        #[allow(dead_code, reason = "only the names matter")]
        struct Fields {
            $($(#[$option])* $field: $type),*
        }
        Fields::STATE_LAYOUT
    }};
}

/// The layout of a struct in a struct.
macro_rules! nested {
    ($field:ident: $type:ty) => {{
        #[derive(Variables)]
        #[allow(dead_code, reason = "only the names matter")]
        struct Inner {
            $field: $type,
        }
        layout!(#[nested] inner: Inner)
    }};
}

#[test]
fn a_change_of_internal_fields_changes_the_layout_of_saved_states() {
    let layouts = [
        layout!(a: f64, b: f64),
        layout!(b: f64, a: f64),
        layout!(a: f64, c: f64),
        layout!(a: f64, b: f32),
        layout!(a: f64, b: [f64; 1]),
        layout!(a: f64),
        nested!(a: f64),
        nested!(b: f64),
        nested!(a: f32),
    ];
    for (i, layout) in layouts.iter().enumerate() {
        assert!(!layouts[..i].contains(layout), "{i}");
    }
    assert_eq!(layouts[0], layout!(a: f64, b: f64));
    assert_eq!(layouts[6], nested!(a: f64));
}
