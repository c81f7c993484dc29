//! What the layer does for authors: non-finite outputs, strings, and initialization.

use std::ffi::CStr;
use std::ptr::{null, null_mut};

use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Error, fmi2Fatal, fmi2OK};

use crate::host::Slave;
use crate::models::*;

#[test]
fn a_non_finite_output_of_a_step_is_an_error_that_names_it() {
    for (trouble, reason) in [
        (BREAK, "y became NaN"),
        (DIVERGE, "parts[2] became inf: the simulation diverges"),
    ] {
        let mut slave = Slave::new();
        assert_eq!(slave.start(0.0, None).set(TROUBLE, trouble), fmi2OK);
        assert_eq!(slave.step(0.0, 0.25), fmi2Error);
        let words = ["fmi2DoStep", "from t = 0.0 s by 0.25 s", reason];
        for word in words {
            let message = slave.last_message();
            assert!(message.contains(word), "{word}: {message}");
        }
    }
}

#[test]
fn a_non_finite_output_of_a_sample_is_an_error_that_names_it() {
    let mut slave = Slave::of(SAMPLED);
    assert_eq!(slave.start(0.0, None).set(7, 0.0), fmi2OK);
    assert_eq!(slave.step(0.0, 0.5), fmi2Error);
    assert!(slave.last_message().contains("y became inf"));
}

#[test]
fn a_non_finite_output_of_the_initialization_is_refused() {
    let mut slave = Slave::new();
    assert_eq!(slave.set(TROUBLE, DIVERGE), fmi2OK);
    assert_eq!(slave.enter_initialization_mode(), fmi2OK);
    let words = ["at t = 0.0 s: parts[2] became inf"];
    slave.refuses(&words, Slave::exit_initialization_mode);
    slave.refuses(&words, |s| s.get_reals(&[Y], &mut [0.0]));
    assert_eq!(slave.set(TROUBLE, 0.0), fmi2OK);
    assert_eq!(slave.exit_initialization_mode(), fmi2OK);
}

#[test]
fn large_outputs_whose_sum_overflows_are_accepted() {
    let mut slave = Slave::new();
    assert_eq!(slave.set_reals(&[LIMIT, 5], &[1.5e308, 1.0]), fmi2OK);
    assert_eq!(slave.start(0.0, None).set(U, 1.5e308), fmi2OK);
    assert_eq!(slave.step(0.0, 1.0), fmi2OK, "{:?}", slave.messages());
    assert_eq!(slave.get([Y, 12]), [1.5e308; 2]);
}

/// Reads Strings.
fn texts<const N: usize>(slave: &mut Slave, references: [u32; N]) -> [fmi2String; N] {
    let mut texts = [null(); N];
    assert_eq!(slave.get_strings(&references, &mut texts), fmi2OK);
    texts
}

#[test]
fn strings_live_until_the_next_call_on_their_instance() {
    let (mut slave, mut other) = (Slave::new(), Slave::new());
    slave.start(0.0, None);
    let given = texts(&mut slave, [LABEL, NAMES + 1, REPORT, VERSION]);
    other.start(0.0, None);
    assert_eq!(other.step(0.0, 0.1), fmi2OK);
    texts(&mut other, [LABEL, NAMES, REPORT]);
    // SAFETY: no call on this instance was made since.
    let given = given.map(|text| unsafe { CStr::from_ptr(text) }.to_owned());
    assert_eq!(given.each_ref().map(|t| &**t), [c"12", c"8", c"4", c"9"]);
}

#[test]
fn strings_are_copied_when_they_are_set() {
    let mut slave = Slave::new();
    let text = c"r\xc3\xbcckw\xc3\xa4rts".to_owned();
    assert_eq!(slave.set_strings(&[LABEL], &[text.as_ptr()]), fmi2OK);
    text.into_bytes().fill(b'x');
    let [given] = texts(slave.start(0.0, None), [LABEL]);
    // SAFETY: no call was made since.
    assert_eq!(unsafe { CStr::from_ptr(given) }, c"r\xc3\xbcckw\xc3\xa4rts");
    assert_eq!(slave.get_all(Kind::Integer, &[42]), (fmi2OK, vec![11.0]));
}

#[test]
fn strings_that_are_null_or_not_utf8_are_refused_with_the_name() {
    for (bad, shown) in [
        (null(), "NULL"),
        (c"\xc3".as_ptr(), r#""\xc3""#),
        (c"a\xff".as_ptr(), r#""a\xff""#),
    ] {
        let reason = format!("names[2] = {shown} is refused; expected a text in UTF-8");
        let texts = [c"1".as_ptr(), bad];
        Slave::new().refuses(&["fmi2SetString", &reason], |s| {
            s.set_strings(&[LABEL, NAMES + 1], &texts)
        });
    }
}

#[test]
fn a_rejected_get_returns_no_string() {
    let mut slave = Slave::new();
    slave.start(0.0, None);
    let mut texts = [null(); 2];
    assert_eq!(slave.get_strings(&[LABEL, U], &mut texts), fmi2Error);
    assert_eq!(texts, [null(); 2]);
}

#[test]
fn every_initialization_starts_from_fresh_fields() {
    let set = |slave: &mut Slave, mode: i32, y: f64| {
        assert_eq!(slave.set_integers(&[14], &[mode]), fmi2OK);
        assert_eq!(slave.set_reals(&[U, 6], &[y, y]), fmi2OK);
    };
    let mut slave = Slave::new();
    assert_eq!(slave.setup(1.0, None), fmi2OK);
    assert_eq!(slave.enter_initialization_mode(), fmi2OK);
    for mode in [-5, 2, 5] {
        set(&mut slave, mode, 0.5);
        let steps = slave.get_all(Kind::Integer, &[STEPS]);
        assert_eq!(steps, (fmi2OK, vec![f64::from(mode + 1)]), "one tick");
        assert_eq!(slave.get([SUM]), [1.0], "one value in the history");
    }
    assert_eq!(slave.exit_initialization_mode(), fmi2OK);
    let mut new = Slave::new();
    set(&mut new, 5, 0.5);
    assert_eq!(slave.snapshot(), new.start(1.0, None).snapshot());
}

#[test]
fn states_include_the_internal_fields() {
    let mut slave = Slave::new();
    assert_eq!(slave.set(U, 1.0), fmi2OK);
    slave.start(0.0, None);
    for k in 0..50 {
        assert_eq!(slave.step(f64::from(k), 1.0), fmi2OK);
    }
    // y = 2 k, of which 40 values are kept.
    let sum = |first: i32| f64::from((first..first + 40).map(|k| 2 * k).sum::<i32>());
    assert_eq!(slave.get([SUM]), [sum(11)]);
    let bytes = slave.snapshot();
    let mut other = Slave::new();
    assert_eq!(other.resume(&bytes).step(50.0, 1.0), fmi2OK);
    assert_eq!(other.get([SUM]), [sum(12)]);
    let steps = other.get_all(Kind::Integer, &[STEPS]);
    assert_eq!(steps, (fmi2OK, vec![55.0]), "52 ticks, mode 3");
}

#[test]
fn a_panic_in_an_expression_of_an_attribute_is_caught() {
    let mut slave = Slave::of(SAMPLED);
    assert_eq!(slave.start(0.0, None).set(7, 0.0), fmi2OK);
    let mut derivative = [7.0];
    let status = slave.directional_derivative(&[8], &[7], &[1.0], &mut derivative);
    assert_eq!((status, derivative), (fmi2Fatal, [7.0]));
    assert!(
        slave
            .last_message()
            .contains("the bug shows in a derivative")
    );
    assert_eq!(slave.get_state(&mut null_mut()), fmi2Fatal);
}
