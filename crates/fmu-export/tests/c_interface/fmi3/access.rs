//! Reading and writing variables with all their elements (FMI 3.0.2, section 2.2.6).

use std::ffi::CString;
use std::ptr::{null, null_mut};

use fmu_export::fmi3::*;
use fmu_export::fmi3::{fmi3Error, fmi3OK};
use proptest::prelude::*;
use proptest::sample::select;

use super::host::{Fmu, Instance, Kind::*};
use crate::models::*;

fn every() -> Instance {
    Instance::of(CoSimulation, EVERY).started(0.0)
}

#[test]
fn numbers_of_each_type_keep_their_extreme_values() {
    let instance = every();
    macro_rules! round_trips {
        ($($get:ident $set:ident($reference:expr): $type:ty = $name:literal;)*) => {
            $(
                for value in [<$type>::MIN, <$type>::MAX, 7 as $type] {
                    assert_eq!(instance.$set(&[$reference], &[value]), fmi3OK);
                    let mut read = [1 as $type];
                    assert_eq!(instance.$get(&[$reference], &mut read), fmi3OK);
                    assert_eq!(read, [value]);
                }
                let reason = concat!("scalar is of type Float64, not ", $name);
                instance.refuses(&[reason], |f| f.$get(&[Every::SCALAR], &mut [7 as $type]));
                instance.refuses(&[reason], |f| f.$set(&[Every::SCALAR], &[7 as $type]));
            )*
        };
    }
    round_trips! {
        get_i8 set_i8(4): i8 = "Int8";
        get_u8 set_u8(5): u8 = "UInt8";
        get_i16 set_i16(6): i16 = "Int16";
        get_u16 set_u16(7): u16 = "UInt16";
        get_i32 set_i32(8): i32 = "Int32";
        get_u32 set_u32(9): u32 = "UInt32";
        get_i64 set_i64(10): i64 = "Int64";
        get_u64 set_u64(11): u64 = "UInt64";
    }
    assert_eq!(instance.set(Every::SCALAR, f64::MIN), fmi3OK);
    assert_eq!(instance.get([Every::SCALAR]), [f64::MIN]);
    assert_eq!(instance.set_f32(&[Every::F32], &[-0.1]), fmi3OK);
    let mut single = [0.0];
    assert_eq!(instance.get_f32(&[Every::F32], &mut single), fmi3OK);
    assert_eq!(single, [-0.1f32]);
    instance.refuses(&["f32 = 10.5 is refused"], |f| {
        f.set_f32(&[Every::F32], &[10.5])
    });
    instance.refuses(&["f32 = NaN is refused"], |f| {
        f.set_f32(&[Every::F32], &[f32::NAN])
    });
    instance.refuses(&["f32 is of type Float32, not Float64"], |f| {
        f.set(Every::F32, 1.0)
    });
    let reason = "law is of type Enumeration, which is accessed as Int64, not Int32";
    instance.refuses(&[reason], |f| f.get_i32(&[Every::LAW], &mut [0]));
    assert_eq!(instance.set_i64(&[Every::LAW], &[2]), fmi3OK);
    instance.refuses(&["law = 3 is refused"], |f| f.set_i64(&[Every::LAW], &[3]));
}

#[test]
fn booleans_are_0_or_1() {
    let instance = every();
    assert_eq!(
        instance.set_booleans(&[Every::FLAGS, Every::BOOL], &[1, 0, 1]),
        fmi3OK
    );
    let mut flags = [7; 3];
    assert_eq!(
        instance.get_booleans(&[Every::BOOL, Every::FLAGS], &mut flags),
        fmi3OK
    );
    assert_eq!(flags, [1, 1, 0]);
    for bad in [2, 255] {
        let reason = format!("flags[2] = {bad} is refused; expected 0 (false) or 1 (true)");
        instance.refuses(&[&reason], |f| f.set_booleans(&[Every::FLAGS], &[0, bad]));
    }
}

#[test]
fn arrays_are_accessed_with_all_their_elements_in_row_major_order() {
    for instance in [every(), Instance::of(CoSimulation, EVERY)] {
        // In step mode by the fast path, and before by the slow one.
        let references = [Every::MATRIX, Every::SCALAR, Every::VECTOR];
        let values = [1.0, -2.0, 3.0, -4.0, 5.0, 6.0, 7.0, -8.0];
        assert_eq!(instance.set_f64(&references, &values), fmi3OK);
        let mut read = [0.0; 8];
        assert_eq!(instance.get_f64(&references, &mut read), fmi3OK);
        assert_eq!(read, values);
        let mut parts = [0.0; 4];
        let order = [Every::VECTOR, Every::SCALAR];
        assert_eq!(instance.get_f64(&order, &mut parts), fmi3OK);
        assert_eq!(parts, [6.0, 7.0, -8.0, 5.0]);
        for n in [0, 2, 4] {
            let words = [&*format!("there are {n} values; expected 3")];
            let values = &mut [9.0; 4][..n];
            instance.refuses(&words, |f| f.set_f64(&[Every::VECTOR], values));
            instance.refuses(&words, |f| f.get_f64(&[Every::VECTOR], values));
        }
        // Elements have no references of their own.
        for inner in [1, 2, 16, 18, 28, u32::MAX] {
            let words = [&*format!("value reference {inner} is unknown")];
            instance.refuses(&words, |f| f.set(inner, 1.0));
            instance.refuses(&words, |f| f.get_f64(&[inner], &mut [0.0]));
        }
        // All or nothing.
        let mut bad = values;
        for (place, value) in [(4, f64::NAN), (7, 10.5), (5, f64::INFINITY)] {
            bad[place] = value;
            instance.refuses(&["is refused"], |f| f.set_f64(&references, &bad));
            bad[place] = values[place];
        }
        assert_eq!(instance.get_f64(&references, &mut read), fmi3OK);
        assert_eq!(read, values);
    }
}

#[test]
fn a_fixed_parameter_or_an_output_is_not_set_between_steps() {
    let instance = every();
    instance.refuses(&["fixed is a fixed parameter"], |f| {
        f.set(Every::FIXED, 1.0)
    });
    let both = [Every::SCALAR, Every::SUM];
    instance.refuses(&["sum is an output"], |f| f.set_f64(&both, &[1.0, 2.0]));
    let new = Instance::of(CoSimulation, EVERY);
    assert_eq!(new.set(Every::FIXED, 1.0), fmi3OK);
}

#[test]
fn texts_and_bytes_are_copied_and_live_until_the_next_call() {
    let (instance, other) = (every(), every());
    let text = CString::from(c"r\xc3\xbcckw\xc3\xa4rts");
    let texts = [c"x".as_ptr(), c"".as_ptr(), text.as_ptr()];
    assert_eq!(
        instance.set_strings(&[Every::TEXTS, Every::TEXT], &texts),
        fmi3OK
    );
    text.into_bytes().fill(b'x');
    let bytes = vec![0, 255, 0];
    let status = instance.set_binaries(&[Every::BYTES], &[3], &[bytes.as_ptr()]);
    assert_eq!(status, fmi3OK);
    drop(bytes);
    let (mut sizes, mut values) = ([7], [null()]);
    assert_eq!(
        instance.get_binaries(&[Every::BYTES], &mut sizes, &mut values),
        fmi3OK
    );
    other.steps(0.0, 1.0);
    assert_eq!(other.texts(&[Every::TEXT], 1), [c"text".to_owned()]);
    // SAFETY: no call on this instance was made since.
    let read = unsafe { std::slice::from_raw_parts(values[0], sizes[0]) };
    assert_eq!(read, [0, 255, 0]);
    assert_eq!(
        instance.texts(&[Every::TEXT, Every::TEXTS], 3),
        [
            c"r\xc3\xbcckw\xc3\xa4rts".to_owned(),
            c"x".to_owned(),
            c"".to_owned()
        ]
    );
    // An empty value needs no pointer.
    assert_eq!(
        instance.set_binaries(&[Every::BYTES], &[0], &[null()]),
        fmi3OK
    );
    assert_eq!(
        instance.get_binaries(&[Every::BYTES], &mut sizes, &mut values),
        fmi3OK
    );
    assert_eq!(sizes, [0]);
    instance.refuses(&["bytes = NULL is refused"], |f| {
        f.set_binaries(&[Every::BYTES], &[2], &[null()])
    });
    instance.refuses(&["texts[2] = NULL is refused"], |f| {
        f.set_strings(&[Every::TEXTS], &[c"".as_ptr(), null()])
    });
    instance.refuses(&["text = \"\\xff\" is refused"], |f| {
        f.set_strings(&[Every::TEXT], &[c"\xff".as_ptr()])
    });
    let mut texts = [null(); 2];
    instance.refuses(&["scalar is of type Float64, not String"], |f| {
        f.get_strings(&[Every::TEXT, Every::SCALAR], &mut texts)
    });
    instance.refuses(&["text is of type String, not Binary"], |f| {
        f.get_binaries(&[Every::TEXT], &mut [0], &mut [null()])
    });
    assert_eq!(texts, [null(); 2]);
}

#[test]
fn time_is_read_in_every_state_and_never_set() {
    let time = |f: Fmu| f.get([Ball::TIME])[0];
    let instance = Instance::new(CoSimulation);
    assert_eq!(time(*instance), 0.0);
    assert_eq!(instance.enter_initialization_mode(1.5, None), fmi3OK);
    assert_eq!(time(*instance), 1.5);
    let reason = "time is the independent variable, which the host does not set";
    instance.refuses(&[reason], |f| f.set(Ball::TIME, 1.0));
    assert_eq!(instance.exit_initialization_mode(), fmi3OK);
    assert_eq!(time(*instance), 1.5);
    instance.steps(1.5, 0.25);
    assert_eq!(instance.get([Ball::TIME, Ball::DRIVE]), [1.75, 0.0]);
    instance.refuses(&[reason], |f| {
        f.set_f64(&[Ball::DRIVE, Ball::TIME], &[1.0, 1.0])
    });
    instance.refuses(&["time is of type Float64, not Float32"], |f| {
        f.get_f32(&[Ball::TIME], &mut [0.0])
    });
    assert_eq!(instance.terminate(), fmi3OK);
    assert_eq!(time(*instance), 1.75);
    let exchange = Instance::new(ModelExchange).started(1.0);
    assert_eq!(time(*exchange), 1.0);
    assert_eq!(exchange.enter_continuous_time_mode(), fmi3OK);
    assert_eq!(exchange.set_time(1.25), fmi3OK);
    assert_eq!(time(*exchange), 1.25);
}

#[test]
fn arrays_may_be_null_only_if_they_are_empty() {
    let instance = every();
    let (i, r, v) = (instance.0, [Every::SCALAR], 0.0);
    let mut value = 0.0;
    // SAFETY: the instance lives, and arrays are NULL or have these lengths.
    unsafe {
        assert_eq!(fmi3GetFloat64(i, null(), 0, null_mut(), 0), fmi3OK);
        assert_eq!(fmi3SetFloat64(i, null(), 0, null(), 0), fmi3OK);
        assert_eq!(
            fmi3GetBinary(i, null(), 0, null_mut(), null_mut(), 0),
            fmi3OK
        );
        let null_is_refused = |call: &dyn Fn() -> fmi3Status| {
            instance.refuses(&["an array is NULL though its length is not 0"], |_| call());
        };
        null_is_refused(&|| fmi3GetFloat64(i, null(), 1, &raw const value as *mut f64, 1));
        null_is_refused(&|| fmi3GetFloat64(i, r.as_ptr(), 1, null_mut(), 1));
        null_is_refused(&|| fmi3SetFloat64(i, null(), 1, &v, 1));
        null_is_refused(&|| fmi3SetFloat64(i, r.as_ptr(), 1, null(), 1));
        null_is_refused(&|| fmi3GetString(i, r.as_ptr(), 1, null_mut(), 1));
        null_is_refused(&|| fmi3SetString(i, r.as_ptr(), 1, null(), 1));
        null_is_refused(&|| fmi3SetBinary(i, r.as_ptr(), 1, null(), [null()].as_ptr(), 1));
        null_is_refused(&|| fmi3GetBinary(i, r.as_ptr(), 1, null_mut(), null_mut(), 1));
        // No values for a variable.
        instance.refuses(&["there are 0 values; expected 1"], |_| {
            fmi3GetFloat64(i, r.as_ptr(), 1, &mut value, 0)
        });
    }
}

/// Sets and gets in step mode, where the fast path decides, and in event mode, where it does not.
fn compare(references: &[u32], values: &[f64], n_read: usize) {
    let stepping = every();
    // Zero steps and events do not change the values of this model.
    let slow = Instance::of(CoSimulation, EVERY);
    assert_eq!(slow.enter_initialization_mode(0.0, None), fmi3OK);
    let is_fixed = |reference: &u32| *reference == Every::FIXED;
    if references.iter().any(is_fixed) {
        return; // may be set before the first step
    }
    assert_eq!(
        stepping.set_f64(references, values),
        slow.set_f64(references, values)
    );
    let (mut fast, mut expected) = (vec![-7.0; n_read], vec![-7.0; n_read]);
    let status = stepping.get_f64(references, &mut fast);
    assert_eq!(status, slow.get_f64(references, &mut expected));
    if status != fmi3OK {
        return; // values are undefined after an error
    }
    let bits = |values: &[f64]| -> Vec<u64> { values.iter().map(|v| v.to_bits()).collect() };
    assert_eq!(bits(&fast), bits(&expected));
}

fn references() -> impl Strategy<Value = Vec<u32>> {
    let good = [Every::VECTOR, Every::MATRIX, Every::SCALAR, Every::SUM];
    prop::collection::vec(prop_oneof![8 => select(good.to_vec()), 1 => 0..30u32], 0..5)
}

fn count(references: &[u32]) -> usize {
    let elements = |reference: &u32| match *reference {
        Every::VECTOR => 3,
        Every::MATRIX => 4,
        _ => 1,
    };
    references.iter().map(elements).sum()
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_fast_path_equals_the_slow_one(
        references in references(),
        noise in prop::collection::vec(
            prop_oneof![8 => -11.0..11.0, 1 => select(vec![f64::NAN, f64::INFINITY, -0.0, 1e300])],
            20,
        ),
        extra in select(vec![0, 0, 0, 0, -1, 1]),
    ) {
        let n = count(&references).saturating_add_signed(extra);
        compare(&references, &noise[..n], n);
    }
}

#[test]
fn a_simulation_cycle_does_not_allocate() {
    let instance = every();
    let mut sum = [0.0];
    let allocations = allocation_counter::measure(|| {
        for k in 0..1000 {
            let vector = [f64::from(k % 10), 1.0, 2.0];
            assert_eq!(instance.set_f64(&[Every::VECTOR], &vector), fmi3OK);
            instance.steps(f64::from(k), 1.0);
            assert_eq!(instance.get_f64(&[Every::SUM], &mut sum), fmi3OK);
        }
    });
    assert_eq!(allocations.count_total, 0);
    assert_eq!(sum, [22.0]);
}

#[test]
fn a_derivative_between_steps_changes_nothing_and_is_never_discarded() {
    let instance = Instance::new(CoSimulation).started(0.0);
    instance.steps(0.0, 0.125);
    assert_eq!(instance.set(Ball::DRIVE, 2.0), fmi3OK);
    let before = instance.snapshot();
    assert_eq!(
        instance.get([Ball::V_DOT, Ball::CONTACT]),
        [2.0 - Ball::G, 1.0 - Ball::G / 128.0]
    );
    let mut derivatives = [f64::NAN; 2];
    let status = instance.get_output_derivatives(&[Ball::V, Ball::H], &[1, 1], &mut derivatives);
    assert_eq!(
        (status, derivatives),
        (fmi3OK, [2.0 - Ball::G, -Ball::G / 8.0])
    );
    assert_eq!(instance.snapshot(), before);
    for (trouble, word) in [
        (DIVERGE, "der(v) became NaN"),
        (DISCARD, "discarded by the ball"),
    ] {
        assert_eq!(instance.set(Ball::TROUBLE, trouble), fmi3OK);
        instance.refuses(&[word], |f| f.get_f64(&[Ball::V_DOT], &mut [0.0]));
        instance.refuses(&[word], |f| {
            f.get_output_derivatives(&[Ball::V], &[1], &mut [0.0])
        });
        assert_eq!(instance.get([Ball::V]), [-Ball::G / 8.0]);
    }
    assert_eq!(instance.set(Ball::TROUBLE, 0.0), fmi3OK);
    instance.steps(0.125, 0.125);
    assert_eq!(instance.terminate(), fmi3OK);
    assert_eq!(instance.get([Ball::H_DOT]), instance.get([Ball::V]));
}

#[test]
fn invalid_output_derivatives_are_refused() {
    let instance = Instance::new(CoSimulation).started(0.0);
    for (reference, order, word) in [
        (Ball::H, 0, "the derivative of h is of order 0; expected 1"),
        (Ball::H, 2, "of order 2"),
        (Ball::DRIVE, 1, "drive is not an output"),
        (Ball::ENERGY, 1, "the derivative of energy is not known"),
        (Ball::TIME, 1, "is unknown"),
    ] {
        instance.refuses(&[word], |f| {
            f.get_output_derivatives(&[Ball::V, reference], &[1, order], &mut [0.0; 2])
        });
    }
    instance.refuses(&["there are 2 values; expected 1"], |f| {
        f.get_output_derivatives(&[Ball::V], &[1], &mut [0.0; 2])
    });
}

#[test]
fn sizes_of_arrays_are_set_in_configuration_mode() {
    for kind in [CoSimulation, Events, ModelExchange] {
        let instance = Instance::of(kind, LISTS);
        let sizes = |n: u64, m: u64| move |f: Fmu| f.set_u64(&[Lists::N, Lists::M], &[n, m]);
        let sum = || {
            let mut gains = [0.0; 3];
            assert_eq!(instance.get_f64(&[Lists::GAINS], &mut gains), fmi3OK);
            (gains, instance.get([Lists::SUM]))
        };
        instance.refuses(&["n is a structural parameter"], sizes(3, 2));
        assert_eq!(instance.enter_configuration_mode(), fmi3OK);
        instance.refuses(
            &["n = 4 is refused; expected a whole number from 1 to 3"],
            sizes(4, 2),
        );
        instance.refuses(
            &["is not allowed in the state \"configuration mode\""],
            |f| f.enter_initialization_mode(0.0, None),
        );
        instance.refuses(&["\"configuration mode\""], |f| {
            f.set_f64(&[Lists::GAINS], &[1.0; 2])
        });
        assert_eq!(sizes(3, 2)(*instance), fmi3OK);
        let saved = instance.snapshot();
        assert_eq!(instance.exit_configuration_mode(), fmi3OK);
        assert_eq!(
            instance.texts(&[Lists::NAMES], 2),
            [c"a".to_owned(), c"b".to_owned()]
        );
        instance.start(0.0, None);
        assert_eq!(sum(), ([1.0, 2.0, 4.0], [7.0]));
        instance.refuses(&["there are 2 values; expected 3"], |f| {
            f.set_f64(&[Lists::GAINS], &[1.0; 2])
        });

        // While the simulation runs, those that are tunable.
        assert_eq!(instance.enter_configuration_mode(), fmi3OK);
        instance.refuses(&["m is a fixed structural parameter"], sizes(2, 1));
        assert_eq!(instance.set_u64(&[Lists::N], &[Lists::BAD]), fmi3OK);
        instance.refuses(&["one gain is not enough"], Fmu::exit_configuration_mode);
        assert_eq!(instance.set_u64(&[Lists::N], &[2]), fmi3OK);
        assert_eq!(instance.exit_configuration_mode(), fmi3OK);
        instance.refuses(&["there are 3 values; expected 2"], |f| {
            f.get_f64(&[Lists::GAINS], &mut [0.0; 3])
        });
        let mut changes = [0];
        assert_eq!(instance.get_i32(&[Lists::CHANGES], &mut changes), fmi3OK);
        assert_eq!(changes, [1]);
        match kind {
            CoSimulation => assert_eq!(instance.steps(0.0, 0.5).time, 0.5),
            _ => assert_eq!(instance.update(), (false, Some(0.5))),
        }
        assert_eq!(instance.get([Lists::SUM]), [3.0]);

        // An FMU state includes the sizes, and the mode.
        instance.resume(&saved);
        assert_eq!(sizes(3, 1)(*instance), fmi3OK);
        assert_eq!(instance.reset(), fmi3OK);
        assert_eq!(instance.snapshot(), Instance::of(kind, LISTS).snapshot());
    }
}

#[test]
fn errors_of_arguments_do_not_depend_on_the_state() {
    let instance = every();
    assert_eq!(instance.terminate(), fmi3OK);
    assert_eq!(instance.set(Every::SCALAR, 1.0), fmi3Error);
    assert_eq!(instance.get_f64(&[Every::VECTOR], &mut [0.0]), fmi3Error);
}
