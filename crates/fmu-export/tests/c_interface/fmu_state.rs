//! FMU states: contents, ownership, and serialization buffers.

use std::ptr::null_mut;

use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Error, fmi2OK};

use crate::host::Slave;
use crate::models::*;

const H: f64 = 0.25;

/// Steps with inputs that change at every step; returns the outputs after each step.
fn drive(slave: &mut Slave, first: u32, steps: u32) -> Vec<[f64; 3]> {
    let step = |k| {
        let k = f64::from(k);
        assert_eq!(slave.set_reals(&[U, V], &[0.1 * k, -0.3 * k]), fmi2OK);
        assert_eq!(slave.set_input_derivatives(&[U], &[1], &[0.7 - k]), fmi2OK);
        assert_eq!(slave.step(k * H, H), fmi2OK, "{}", slave.last_message());
        slave.get([Y, 12, 13])
    };
    (first..first + steps).map(step).collect()
}

/// An instance after five steps.
fn moving() -> Slave {
    let mut slave = Slave::new();
    assert_eq!(slave.set_reals(&[GAIN, 5], &[3.0, 0.5]), fmi2OK);
    assert_eq!(slave.set_integers(&[LAW, ORDER], &[2, 3]), fmi2OK);
    assert_eq!(slave.set_booleans(&[LIMITED], &[0]), fmi2OK);
    drive(slave.start(0.0, None), 0, 5);
    slave
}

#[test]
fn restored_states_continue_bit_for_bit_in_any_instance() {
    let mut slave = moving();
    let mut state = slave.save();
    let bytes = slave.serialize(state);
    let expected = drive(&mut slave, 5, 5);
    assert_eq!(slave.set_state(state), fmi2OK);
    assert_eq!(slave.snapshot(), bytes);
    assert_eq!(drive(&mut slave, 5, 5), expected);
    drop(slave);
    // A state outlives the instance it was taken from.
    let mut other = Slave::new();
    assert_eq!(other.set_state(state), fmi2OK);
    assert_eq!(other.free_state(&mut state), fmi2OK);
    assert_eq!(drive(&mut other, 5, 5), expected);
    assert_eq!(drive(Slave::new().resume(&bytes), 5, 5), expected);
}

#[test]
fn states_are_independent_copies() {
    let mut slave = moving();
    let mut states: Vec<_> = (5..10)
        .map(|k| {
            drive(&mut slave, k, 1);
            (slave.save(), slave.snapshot())
        })
        .collect();
    for k in [3, 0, 3, 4, 2, 1] {
        let (state, expected) = &states[k];
        assert_eq!(slave.set_state(*state), fmi2OK);
        assert_eq!(&slave.snapshot(), expected);
    }
    for (state, _) in &mut states {
        assert_eq!(slave.free_state(state), fmi2OK);
        assert!(state.is_null());
    }
}

#[test]
fn states_can_be_overwritten_and_reused() {
    let (mut slave, fresh) = (moving(), Slave::new().snapshot());
    let mut state = slave.save();
    let address = state;
    drive(&mut slave, 5, 5);
    assert_eq!(slave.get_state(&mut state), fmi2OK);
    assert_eq!(state, address);
    let expected = slave.snapshot();
    for _ in 0..2 {
        drive(&mut slave, 10, 1);
        assert_eq!(slave.set_state(state), fmi2OK);
        assert_eq!(slave.snapshot(), expected);
    }
    assert_eq!(slave.deserialize(&fresh, &mut state), fmi2OK);
    assert_eq!((state, slave.serialize(state)), (address, fresh));
    assert_eq!(slave.free_state(&mut state), fmi2OK);
}

#[test]
fn states_include_phase_time_and_stop_time() {
    let mut slave = Slave::new();
    let made = slave.snapshot();
    assert_eq!(slave.start(1.0, Some(2.0)).step(1.0, H), fmi2OK);
    let running = slave.snapshot();
    assert_eq!(slave.terminate(), fmi2OK);
    let ended = slave.snapshot();
    slave
        .resume(&running)
        .refuses(&["communication point"], |s| s.step(0.5, H));
    slave.refuses(&["stop time"], |s| s.step(1.0 + H, 1.0));
    assert_eq!(slave.step(1.0 + H, H), fmi2OK);
    slave
        .resume(&ended)
        .refuses(&["terminated"], |s| s.step(1.0 + H, H));
    slave
        .resume(&made)
        .refuses(&["instantiated"], |s| s.step(1.0 + H, H));
    assert_eq!(
        slave.start(0.0, None).step(0.0, 5.0),
        fmi2OK,
        "without a stop time"
    );
}

#[test]
fn states_of_another_model_are_rejected() {
    let (mut slave, mut wide) = (moving(), Slave::of(WIDE));
    let (mut state, bytes) = (wide.save(), wide.snapshot());
    slave.refuses(&["fmi2SetFMUstate", "not to {"], |s| s.set_state(state));
    slave.refuses(&["another model"], |s| s.serialized_size(state, &mut 0));
    slave.refuses(&["another model"], |s| {
        s.serialize_into(state, &mut [0; 1000])
    });
    let mut none = null_mut();
    slave.refuses(&["are a state of the model {"], |s| {
        s.deserialize(&bytes, &mut none)
    });
    assert!(none.is_null());
    assert_eq!(slave.free_state(&mut state), fmi2OK);
}

#[test]
fn a_buffer_that_is_too_small_is_not_written() {
    let mut slave = moving();
    let mut state = slave.save();
    let size = slave.serialize(state).len();
    let expected = format!("expected {size} bytes");
    for room in [0, 1, size / 2, size - 1] {
        let mut buffer = vec![0xaa; room];
        slave.refuses(&["fmi2SerializeFMUstate", &expected], |s| {
            s.serialize_into(state, &mut buffer)
        });
        assert_eq!(buffer, vec![0xaa; room]);
    }
    assert_eq!(slave.free_state(&mut state), fmi2OK);
}

#[test]
fn a_buffer_may_be_larger_and_the_instance_may_have_advanced() {
    let mut slave = moving();
    let mut state = slave.save();
    let bytes = slave.serialize(state);
    assert_eq!(slave.reset(), fmi2OK);
    let mut buffer = vec![0xaa; bytes.len() + 50];
    assert_eq!(slave.serialize_into(state, &mut buffer), fmi2OK);
    assert_eq!(buffer, [&bytes[..], &[0xaa; 50]].concat());
    assert_eq!(slave.free_state(&mut state), fmi2OK);
}

#[test]
fn null_is_rejected_except_when_freeing_a_state() {
    let mut slave = moving();
    let (mut state, bytes) = (slave.save(), slave.snapshot());
    let (mut size, mut room, n) = (5, vec![0u8; 1000], bytes.len());
    let (c, buffer) = (slave.c, room.as_mut_ptr().cast());
    let (null_place, mut none) = (null_mut(), null_mut());
    // SAFETY: the instance lives; pointers are NULL or valid for what the call uses.
    unsafe {
        slave.refuses(&["a pointer is NULL"], |_| fmi2GetFMUstate(c, null_mut()));
        slave.refuses(&["the FMU state is NULL"], |s| s.set_state(null_mut()));
        slave.refuses(&["the FMU state is NULL"], |s| {
            s.serialized_size(null_mut(), &mut size)
        });
        slave.refuses(&["a pointer is NULL"], |_| {
            fmi2SerializedFMUstateSize(c, state, null_mut())
        });
        slave.refuses(&["the FMU state is NULL"], |s| {
            s.serialize_into(null_mut(), &mut room)
        });
        slave.refuses(&["the buffer is NULL"], |_| {
            fmi2SerializeFMUstate(c, state, null_mut(), n)
        });
        slave.refuses(&["the bytes are NULL"], |_| {
            fmi2DeSerializeFMUstate(c, null_mut(), n, &mut none)
        });
        slave.refuses(&["a pointer is NULL"], |_| {
            fmi2DeSerializeFMUstate(c, buffer, n, null_place)
        });
        slave.refuses(&["damaged"], |_| {
            fmi2DeSerializeFMUstate(c, null_mut(), 0, &mut none)
        });
        assert_eq!(fmi2FreeFMUstate(c, null_mut()), fmi2OK);
    }
    assert_eq!((size, room, none), (5, vec![0; 1000], null_mut()));
    assert_eq!(slave.free_state(&mut none), fmi2OK);
    assert_eq!(slave.free_state(&mut state), fmi2OK);
    assert_eq!(slave.free_state(&mut state), fmi2OK, "it is NULL now");
}

#[test]
fn a_pointer_to_something_else_is_rejected() {
    let mut slave = moving();
    let mut memory = [0u128; 64];
    for offset in [0, 1] {
        let foreign: fmi2FMUstate = memory.as_mut_ptr().cast::<u8>().wrapping_add(offset).cast();
        let words = ["the pointer does not point to an FMU state"];
        slave.refuses(&words, |s| s.set_state(foreign));
        slave.refuses(&words, |s| s.free_state(&mut foreign.clone()));
        slave.refuses(&words, |s| s.get_state(&mut foreign.clone()));
        slave.refuses(&words, |s| s.serialized_size(foreign, &mut 0));
        slave.refuses(&words, |s| s.serialize_into(foreign, &mut [0; 8]));
    }
    assert_eq!(memory, [0; 64]);
    assert_eq!(slave.set_state(null_mut()), fmi2Error);
}
