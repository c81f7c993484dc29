//! Variables of the types of FMI 3.0, accessed by the functions of FMI 2.0.

use fmu_export::fmi2::{fmi2Error, fmi2OK};

use crate::host::Slave;
use crate::models::SIZES;

// References of variables of the model `Sizes`.
const SINGLE: u32 = 0;
const SIGNED: u32 = 1;
const BYTES: u32 = 2;
const LARGE: u32 = 4;
const LONG: u32 = 5;
const MESSAGE: u32 = 6;
const HALF: u32 = 7;

/// An instance between steps.
fn slave() -> Slave {
    let mut slave = Slave::of(SIZES);
    slave.start(0.0, None);
    slave
}

#[test]
fn a_float32_is_a_real_that_is_rounded() {
    let mut slave = slave();
    assert_eq!(slave.get([SINGLE]), [f64::from(0.3f32)]);
    // The bound is 0.1 as an f32, which is larger than 0.1.
    assert_eq!(slave.set(SINGLE, 0.1), fmi2OK);
    assert_eq!(slave.get([SINGLE, HALF]), [f64::from(0.1f32), 0.0]);
    // Rounded to 2^24.
    assert_eq!(slave.set(SINGLE, 16_777_216.5), fmi2OK);
    for bad in [0.0999, 16_777_218.0, 1e39, f64::NAN] {
        slave.refuses(&["fmi2SetReal", "single", "from 0.1"], |s| {
            s.set(SINGLE, bad)
        });
    }
    assert_eq!(slave.get([SINGLE]), [16_777_216.0]);
}

#[test]
fn an_output_of_single_precision_must_be_finite() {
    let mut slave = slave();
    slave.set(SINGLE, 0.5);
    assert_eq!(slave.set_integers(&[BYTES], &[3]), fmi2OK);
    assert_eq!(slave.step(0.0, 0.5), fmi2OK);
    assert_eq!(slave.get([HALF]), [6.0]);
}

#[test]
fn whole_numbers_are_integers_within_the_range_of_their_type() {
    let mut slave = slave();
    assert_eq!(
        slave.set_integers(&[SIGNED, BYTES, BYTES + 1], &[-128, 255, 7]),
        fmi2OK
    );
    slave.refuses(&["signed = 128", "from -128 to 127"], |s| {
        s.set_integers(&[SIGNED], &[128])
    });
    slave.refuses(&["bytes[2] = -1", "from 0 to 255"], |s| {
        s.set_integers(&[BYTES, BYTES + 1], &[1, -1])
    });
    let mut values = [0; 3];
    slave.get_integers(&[SIGNED, BYTES, BYTES + 1], &mut values);
    assert_eq!(values, [-128, 255, 7]);
}

#[test]
fn a_value_that_an_integer_cannot_have_is_refused_and_none_is_read() {
    let mut slave = slave();
    slave.refuses(&["fmi2GetInteger", "large = 4294967295"], |s| {
        s.get_integers(&[LARGE], &mut [0])
    });
    assert_eq!(slave.set_integers(&[SIGNED, LARGE], &[-128, 5]), fmi2OK);
    assert_eq!(slave.step(0.0, 0.5), fmi2OK);
    let mut values = [-7; 2];
    // 128 shifted by 24 bits is 2^31.
    slave.refuses(&["long = 2147483648"], |s| {
        s.get_integers(&[LARGE, LONG], &mut values)
    });
    assert_eq!(values, [-7; 2]);
    assert_eq!(slave.get_integers(&[LARGE], &mut values[..1]), fmi2OK);
    assert_eq!(values, [5, -7]);
}

#[test]
fn a_binary_is_not_available() {
    let mut slave = slave();
    let words = ["message", "Binary", "FMI 2.0"];
    slave.refuses(&words, |s| {
        s.get_strings(&[MESSAGE], &mut [std::ptr::null()])
    });
    slave.refuses(&words, |s| s.get_integers(&[MESSAGE], &mut [0]));
    slave.refuses(&words, |s| s.get_reals(&[MESSAGE], &mut [0.0]));
    assert_eq!(slave.set_booleans(&[MESSAGE], &[0]), fmi2Error);
}
