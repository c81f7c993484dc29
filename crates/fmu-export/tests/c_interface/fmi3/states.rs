//! FMU states of FMI 3.0 (section 2.2.10): round trips, modes, and damaged bytes.

use std::ptr::{null, null_mut};

use fmu_export::fmi3::*;
use fmu_export::fmi3::{fmi3Error, fmi3Fatal, fmi3OK};
use proptest::prelude::*;
use proptest::sample::Index;

use super::host::{Instance, Kind, Kind::*};
use crate::damage::{content, sealed};
use crate::models::*;

const KINDS: [Kind; 3] = [CoSimulation, Events, ModelExchange];

/// An instance of a model that runs.
fn running(kind: Kind, model: usize) -> Instance {
    let instance = Instance::of(kind, model).started(0.0);
    match kind {
        CoSimulation => drop(instance.steps(0.0, 0.5)),
        Events => {
            instance.update();
            assert_eq!(instance.enter_step_mode(), fmi3OK);
            instance.steps(0.0, 0.25);
        }
        ModelExchange => {
            instance.update();
            assert_eq!(instance.enter_continuous_time_mode(), fmi3OK);
            assert_eq!(instance.set_time(0.25), fmi3OK);
        }
    }
    instance
}

#[test]
fn states_of_all_variables_are_restored_bit_for_bit() {
    let instance = Instance::of(CoSimulation, EVERY).started(0.0);
    let texts = [c"\xc3\xbc".as_ptr(), c"".as_ptr(), c"z".as_ptr()];
    assert_eq!(
        instance.set_strings(&[Every::TEXT, Every::TEXTS], &texts),
        fmi3OK
    );
    let bytes = [9u8, 0];
    let status = instance.set_binaries(&[Every::BYTES], &[2], &[bytes.as_ptr()]);
    assert_eq!(status, fmi3OK);
    assert_eq!(instance.set_f32(&[Every::F32], &[0.1]), fmi3OK);
    assert_eq!(instance.set_u64(&[11], &[u64::MAX]), fmi3OK);
    assert_eq!(
        instance.set_f64(&[Every::VECTOR], &[-0.0, 5e-324, 0.1]),
        fmi3OK
    );
    instance.steps(0.0, 1.0);
    let saved = instance.snapshot();
    let other = Instance::of(CoSimulation, EVERY);
    assert_eq!(other.resume(&saved).snapshot(), saved);
    assert_eq!(
        other.texts(&[Every::TEXT, Every::TEXTS], 3),
        instance.texts(&[Every::TEXT, Every::TEXTS], 3)
    );
    let mut vector = [1.0; 3];
    assert_eq!(other.get_f64(&[Every::VECTOR], &mut vector), fmi3OK);
    assert_eq!(
        vector.map(f64::to_bits),
        [-0.0f64, 5e-324, 0.1].map(f64::to_bits)
    );
    other.steps(1.0, 1.0);
    instance.steps(1.0, 1.0);
    assert_eq!(other.snapshot(), instance.snapshot());
}

#[test]
fn a_state_of_another_mode_or_model_is_refused() {
    for from in KINDS {
        for to in KINDS {
            let (source, target) = (running(from, BALL), running(to, BALL));
            let mut state = source.save();
            if from == to {
                assert_eq!(target.set_state(state), fmi3OK);
                assert_eq!(target.snapshot(), source.snapshot());
            } else {
                let words = ["the state is that of an instance for", "; expected one for"];
                target.refuses(&words, |f| f.set_state(state));
            }
            let other = running(to, SAMPLED);
            other.refuses(&["the state"], |f| f.set_state(state));
            let bytes = source.snapshot();
            other.refuses(&["the bytes are a state of the model"], |f| {
                f.deserialize(&bytes, &mut null_mut())
            });
            assert_eq!(source.free_state(&mut state), fmi3OK);
            assert!(state.is_null());
        }
    }
}

#[test]
fn null_and_foreign_pointers_are_refused() {
    let instance = running(Events, BALL);
    let mut noise = [7u64; 8];
    let foreign: fmi3FMUState = noise.as_mut_ptr().cast();
    instance.refuses(&["the FMU state is NULL"], |f| f.set_state(null_mut()));
    instance.refuses(&["does not point to an FMU state"], |f| {
        f.set_state(foreign)
    });
    let (i, mut state, mut bytes) = (instance.0, instance.save(), [0; 10]);
    instance.refuses(&["its size 10 is too small"], |f| {
        f.serialize_into(state, &mut bytes)
    });
    // SAFETY: the instance lives, and NULL is refused.
    unsafe {
        instance.refuses(&["a pointer is NULL"], |_| fmi3GetFMUState(i, null_mut()));
        instance.refuses(&["a pointer is NULL"], |_| {
            fmi3SerializedFMUStateSize(i, state, null_mut())
        });
        instance.refuses(&["the bytes are NULL"], |_| {
            fmi3DeserializeFMUState(i, null(), 5, &mut null_mut())
        });
        assert_eq!(fmi3FreeFMUState(i, null_mut()), fmi3OK);
    }
    assert_eq!(instance.free_state(&mut state), fmi3OK);
}

/// Makes the usual calls; each may be refused, but none may panic.
fn uses(instance: &Instance, kind: Kind) {
    let mut time = [0.0];
    let mut statuses = vec![
        instance.get_f64(&[Ball::TIME], &mut time),
        instance.set(Ball::DRIVE, 0.5),
        instance.get_f64(&[Ball::V_DOT], &mut [0.0]),
        instance.exit_initialization_mode(),
        instance.try_update(&mut (false, None)),
    ];
    statuses.extend(match kind {
        ModelExchange => [
            instance.enter_continuous_time_mode(),
            instance.get_derivatives(&mut [0.0; 2]),
            instance.set_time(1.0),
        ],
        _ => [
            instance.enter_step_mode(),
            instance.step(time[0], 0.1).0,
            instance.step(time[0] + 0.1, 1e9).0,
        ],
    });
    statuses.push(instance.terminate());
    assert!(
        !statuses.contains(&fmi3Fatal),
        "{statuses:?} {:?}",
        instance.messages()
    );
    assert_eq!(instance.reset(), fmi3OK);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_bytes_are_refused(
        kind in prop::sample::select(KINDS.to_vec()),
        bit in any::<Index>(),
        end in any::<Index>(),
    ) {
        let instance = running(kind, BALL);
        let bytes = instance.snapshot();
        let mut damaged = bytes.clone();
        let bit = bit.index(8 * bytes.len());
        damaged[bit / 8] ^= 1 << (bit % 8);
        for damaged in [&damaged[..], &bytes[..end.index(bytes.len())]] {
            let mut state = null_mut();
            assert_eq!(instance.deserialize(damaged, &mut state), fmi3Error);
            assert!(state.is_null());
        }
        assert_eq!(instance.snapshot(), bytes);
    }

    /// Bytes after the header, with a valid checksum, may be accepted, but using the state must not crash
    /// or hang.
    #[test]
    fn forged_states_do_not_crash_or_hang(
        kind in prop::sample::select(KINDS.to_vec()),
        edits in prop::collection::vec((any::<Index>(), any::<u8>()), 1..5),
    ) {
        let instance = running(kind, BALL);
        let mut forged = content(&instance.snapshot()).to_vec();
        for (place, byte) in edits {
            let place = 50 + place.index(forged.len() - 50);
            forged[place] = byte;
        }
        let mut state = null_mut();
        if instance.deserialize(&sealed(&forged), &mut state) == fmi3OK {
            if instance.set_state(state) == fmi3OK {
                let mut trouble = [0.0; 2];
                instance.get_f64(&[Ball::TROUBLE, Ball::FAULT], &mut trouble);
                if !trouble.contains(&PANIC) {
                    uses(&instance, kind);
                }
            }
            assert_eq!(instance.free_state(&mut state), fmi3OK);
        }
    }
}
