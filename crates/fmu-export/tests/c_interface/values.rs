//! Getting and setting variables: start values, bounds, roles, types, arrays, and the fast path between steps,
//! which behaves like the slow one.

use std::ffi::{CString, c_char};
use std::ptr::null;

use fmu_description::Type;
use proptest::prelude::*;
use proptest::sample::select;

use crate::driver::*;
use crate::models::*;

/// The phases in which values can be set: before, during and after the initialization.
const PHASES: [usize; 3] = [0, 1, 2];

fn in_phase(version: FmiVersion, phase: usize) -> Instance {
    let it = Instance::new((version, Stepped), EVERY);
    if phase > 0 {
        assert_eq!(it.enter(0.0, None, None), OK);
        it.get_f64(&[Y], &mut [0.0]);
    }
    if phase > 1 {
        assert_eq!(it.exit_initialization_mode(), OK);
        it.steps(0.0, 0.001);
    }
    it
}

/// The parts of a variable that a version accesses at once, with the name of the first element: each
/// element in FMI 2.0, and all elements in FMI 3.0.
fn parts(version: FmiVersion, fact: &Fact) -> Vec<(u32, String, &'static [f64])> {
    let name = |k: usize| match (fact.name, fact.start.len()) {
        (name, 1) => name.to_owned(),
        ("matrix", _) => format!("matrix[{},{}]", k / 2 + 1, k % 2 + 1),
        (name, _) => format!("{name}[{}]", k + 1),
    };
    match version {
        Fmi3 => vec![(fact.reference, name(0), fact.start)],
        Fmi2 if fact.of == Type::Binary => vec![],
        Fmi2 => (0..fact.start.len())
            .map(|k| (fact.reference + k as u32, name(k), &fact.start[k..k + 1]))
            .collect(),
    }
}

/// Runs a test for each phase and each part of a variable that can, or cannot, be set in it.
fn each(can: bool, test: impl Fn(usize, &Instance, &Fact, (u32, String, &'static [f64]))) {
    for (version, phase) in pairs(&[Fmi2, Fmi3], &PHASES) {
        let it = in_phase(version, phase);
        let fresh = it.snapshot();
        let is_meant = |fact: &&Fact| fact.is_settable(phase == 2) == can;
        for fact in FACTS.iter().filter(is_meant) {
            for part in parts(version, fact) {
                test(phase, &it, fact, part);
                it.resume(&fresh);
            }
        }
    }
}

#[test]
fn start_values_are_those_of_the_table() {
    for (version, fact) in [Fmi2, Fmi3].into_iter().flat_map(|v| FACTS.iter().map(move |f| (v, f)))
    {
        let it = in_phase(version, 1);
        for (reference, name, start) in parts(version, fact) {
            let found = it.get_all(fact.of, &[reference], start.len());
            if (version, fact.of, start[0]) == (Fmi2, Type::UInt64, 4294967295.0) {
                let words = "u64 = 4294967295 does not fit into an Integer";
                it.refuses(words, |f| f.get_all(fact.of, &[reference], 1).0);
                continue;
            }
            assert_eq!(found, (OK, start.to_vec()), "{name}");
        }
    }
}

#[test]
fn values_are_returned_as_set_and_bounds_are_inclusive() {
    each(true, |phase, it, fact, (reference, name, start)| {
        let (min, max) = fact.bounds;
        let (min, max) = match (it.kind.0, fact.of) {
            (Fmi2, Type::UInt32 | Type::UInt64) => (min, i32::MAX.into()),
            _ => (min, max),
        };
        let values = [min, fact.other_value(), max];
        // BUG and other troubles make the initialization fail.
        let count = if reference == TROUBLE { 1 } else { 3 };
        let before = it.snapshot();
        for &value in values[..count].iter().filter(|value| value.is_finite()) {
            let all = vec![value; start.len()];
            let status = it.set_all(fact.of, &[reference], &all);
            assert_eq!(status, OK, "{name} = {value}: {:?}", it.messages());
            if phase == 0 {
                assert_eq!(it.enter(0.0, None, None), OK);
            }
            let found = it.get_all(fact.of, &[reference], all.len());
            assert_eq!(found, (OK, all), "{name}");
            it.resume(&before);
        }
    });
}

#[test]
fn values_out_of_bounds_are_refused_with_the_name() {
    each(true, |_, it, fact, (reference, name, start)| {
        let (min, max) = fact.bounds;
        let mut outside = match fact.of {
            Type::String | Type::Binary => vec![],
            Type::Float64 => {
                let (below, above) = (min.next_down(), max.next_up());
                let infinite = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
                [&[below, min - 1.0, above, max + 1.0], &infinite[..]].concat()
            }
            Type::Float32 => vec![0.0999, 16_777_218.0, 1e39, f64::NAN],
            // Others are of types that cannot have other values in FMI 3.0.
            _ if it.kind.0 == Fmi2 || matches!(fact.of, Type::Int32 | Type::Enumeration) => {
                vec![min - 1.0, max + 1.0, -7.0]
            }
            Type::Boolean => vec![2.0, 255.0],
            Type::Int16 => vec![-3.0],
            _ => vec![],
        };
        let range = |value: &f64| (min..=max).contains(value) || *value as i32 as f64 != *value;
        let is_float = matches!(fact.of, Type::Float64 | Type::Float32);
        outside.retain(|value| is_float || !range(value));
        for value in outside {
            let all = vec![value; start.len()];
            let shown = match it.kind.0 {
                Fmi3 if fact.of == Type::Float32 => f64::from(value as f32),
                _ => value,
            };
            let words = format!("{name} = {shown} is refused; expected ");
            it.refuses(&words, |f| f.set_all(fact.of, &[reference], &all));
        }
    });
}

#[test]
fn refusals_state_the_expected_value() {
    for (reference, expected) in [
        (U, "u = NaN is refused; expected a finite number"),
        (V, "a finite number from -10 to 10"),
        (VECTOR, "a finite number from -10 to 10 [kg]"),
        (GAIN, "a finite number of at least 0"),
        (F32, "expected a finite number from 0.1"),
        (I32, "i32 = 9 is refused; expected a whole number from -5"),
        (I32, "a whole number from -5 to 5"),
        (ORDER, "a whole number from 1 to 4"),
        (LIMITED, "0 (false) or 1 (true)"),
        (LAW, "1 (added), 2 (ignored)"),
        (LAWS, "laws[1] = 9 is refused; expected 1 (added), 2"),
    ] {
        let fact = FACTS.iter().find(|f| f.reference == reference).unwrap();
        let is_float = matches!(fact.of, Type::Float64 | Type::Float32);
        for version in [Fmi2, Fmi3] {
            let n = parts(version, fact)[0].2.len();
            let values = vec![if is_float { f64::NAN } else { 9.0 }; n];
            let set = |f: Fmu| f.set_all(fact.of, &[reference], &values);
            in_phase(version, 0).refuses(expected, set);
        }
    }
}

#[test]
fn only_inputs_and_tunable_parameters_can_be_set_at_any_time() {
    each(false, |_, it, fact, (reference, name, start)| {
        let why = match fact.role {
            Role::Always => unreachable!(),
            Role::BeforeSteps => {
                // Its own value changes nothing.
                return assert_eq!(it.set_all(fact.of, &[reference], start), OK, "{name}");
            }
            Role::Output => "an output",
            Role::Local => "a local variable",
            Role::Constant => "a constant",
        };
        let words = format!("{name} is {why}");
        it.refuses(&words, |f| f.set_all(fact.of, &[reference], start));
    });
}

#[test]
fn what_can_be_set_depends_on_the_state() {
    for kind in EXCHANGED {
        let it = Instance::new(kind, BALL);
        let refuses = |words: &str, of, reference, value| {
            it.refuses(words, |f| f.set_all(of, &[reference], &[value]));
        };
        refuses("h is an output", Type::Float64, Ball::H, 0.0);
        it.start(0.0, None);
        ok([it.set(Ball::H, 1.0), it.set(Ball::RESTITUTION, 0.5), it.set(Ball::H0, 1.0)]);
        it.update();
        it.end_event_mode();
        ok([it.set(Ball::H, 1.0), it.set(Ball::H0, 1.0)]);
        refuses("restitution is not a continuous input", Type::Float64, Ball::RESTITUTION, 0.5);
    }
    let plain = Instance::running(PLAIN[0], BALL);
    plain.refuses("h is an output", |f| f.set(Ball::H, 1.0));
}

#[test]
fn unknown_references_and_wrong_types_are_refused() {
    use Type::*;
    // In FMI 2.0, the other numbers are accessed by the functions of the first.
    let types = [
        Float64, Int32, Boolean, String, Float32, Int8, UInt8, Int16, UInt16, UInt32, Int64,
        UInt64, Binary,
    ];
    for version in [Fmi2, Fmi3] {
        let it = in_phase(version, 1);
        for &of in &types[..if version == Fmi2 { 4 } else { types.len() }] {
            let refuses = |words: &str, reference, n| {
                it.refuses(words, |f| f.get_all(of, &[reference], n).0);
                it.refuses(words, |f| f.set_all(of, &[reference], &vec![0.0; n]));
            };
            for unknown in [COUNT + 1, 1_000_000, 1 << 31, u32::MAX] {
                refuses(&format!("value reference {unknown} is unknown"), unknown, 1);
            }
            for fact in FACTS.iter().filter(|fact| it.accessed_as(fact.of) != of) {
                let n = if version == Fmi3 { fact.start.len() } else { 1 };
                refuses(fact.name, fact.reference, n);
                it.says(" is of type ");
            }
        }
    }
    let two = in_phase(Fmi2, 1);
    two.refuses("unknown", |f| f.get_f64(&[COUNT], &mut [0.0]));
    let words = "bytes is of type Binary, which is not available in FMI 2.0";
    two.refuses(words, |f| f.get_strings(&[BYTES], &mut [null()]));
    let three = in_phase(Fmi3, 1);
    let words = "law is of type Enumeration, which is accessed as Int64, not Int32";
    three.refuses(words, |f| f.get_i32(&[LAW], &mut [0]));
    let words = "u is of type Float64, not Float32";
    three.refuses(words, |f| f.get_f32(&[U], &mut [0.0]));
}

#[test]
fn one_invalid_element_prevents_all_access() {
    for (version, phase) in pairs(&[Fmi2, Fmi3], &PHASES) {
        let it = in_phase(version, phase);
        let function = it.name("set_float64");
        for (bad, value) in [
            (Y, 0.0),
            (LAW, 1.0),
            (V, f64::NAN),
            (V, 11.0),
            (LIMIT, -1.0),
            (LIMIT, f64::INFINITY),
            (COUNT, 0.0),
            (u32::MAX, 0.0),
        ] {
            it.refuses(function, |f| f.set(bad, value));
            for references in [[U, BIAS, bad], [U, bad, BIAS], [bad, U, BIAS]] {
                let values = references.map(|r| if r == bad { value } else { 5.0 });
                it.refuses(function, |f| f.set_f64(&references, &values));
            }
            let five = [U, BIAS, TROUBLE, V, bad];
            it.refuses(function, |f| f.set_f64(&five, &[1.0, 1.0, 1.0, 1.0, value]));
        }
        let mut values = [-7.0; 3];
        if phase > 0 {
            for bad in [LAW, COUNT + 1, u32::MAX] {
                let function = it.name("get_float64");
                it.refuses(function, |f| f.get_f64(&[bad], &mut values[..1]));
                // In FMI 3.0, values are undefined after an error of the fast path.
                let is_undefined = version == Fmi3 && phase == 2;
                for references in [[U, Y, bad], [bad, U, Y]] {
                    it.refuses(function, |f| f.get_f64(&references, &mut values));
                    assert!(is_undefined || values == [-7.0; 3]);
                    values = [-7.0; 3];
                }
            }
            let (order, mut integers) = ([I32, ORDER, U], [77; 3]);
            it.refuses("u is of type", |f| f.get_i32(&order, &mut integers));
            let mut texts = [null(); 2];
            it.refuses("u is of type", |f| f.get_strings(&[LABEL, U], &mut texts));
            assert_eq!((integers, texts), ([77; 3], [null(); 2]));
        }
        it.refuses("i32 = 9", |f| f.set_i32(&[I32, I32], &[2, 9]));
        // The last of several values for one variable wins.
        assert_eq!(it.set_f64(&[U, V, U], &[1.0, 2.0, 3.0]), OK);
        if phase == 0 {
            assert_eq!(it.enter(0.0, None, None), OK);
        }
        assert_eq!(it.get([U, U, V]), [3.0, 3.0, 2.0]);
    }
}

#[test]
fn arrays_are_accessed_with_all_their_elements_in_row_major_order() {
    // In step mode by the fast path, and before by the slow one.
    for phase in PHASES {
        let it = in_phase(Fmi3, phase);
        let references = [MATRIX, U, VECTOR];
        let values = [1.0, -2.0, 3.0, -4.0, 5.0, 6.0, 7.0, -8.0];
        assert_eq!(it.set_f64(&references, &values), OK);
        let mut read = [0.0; 8];
        assert_eq!(it.get_f64(&references, &mut read), OK);
        assert_eq!(read, values);
        let (status, parts) = it.get_all(Type::Float64, &[VECTOR, U], 4);
        assert_eq!((status, parts), (OK, vec![6.0, 7.0, -8.0, 5.0]));
        for (n, (of, expected)) in pairs(&[0, 2, 4], &[(VECTOR, 3), (U, 1)]) {
            let words = format!("values passed: {n}; expected {expected}");
            let values = &mut [9.0; 4][..n];
            it.refuses(&words, |f| f.set_f64(&[of], values));
            it.refuses(&words, |f| f.get_f64(&[of], values));
        }
        // Elements have no references of their own.
        for inner in [VECTOR + 1, MATRIX + 3, FLAGS + 1] {
            let words = format!("value reference {inner} is unknown");
            it.refuses(&words, |f| f.set(inner, 1.0));
            it.refuses(&words, |f| f.get_f64(&[inner], &mut [0.0]));
        }
        let mut bad = values;
        for (place, value) in [(0, f64::NAN), (4, f64::NAN), (7, 10.5), (5, f64::INFINITY)] {
            bad[place] = value;
            it.refuses("is refused", |f| f.set_f64(&references, &bad));
            bad[place] = values[place];
        }
    }
    for (reference, k) in [(VECTOR, 3), (MATRIX, 4)] {
        let it = in_phase(Fmi2, 2);
        let references: Vec<u32> = (reference..reference + k).collect();
        let values: Vec<f64> = references.iter().map(|&r| 0.25 * f64::from(r)).collect();
        assert_eq!(it.set_f64(&references, &values), OK);
        let found = it.get_all(Type::Float64, &references, values.len());
        assert_eq!(found, (OK, values));
    }
}

#[test]
fn numbers_keep_their_extreme_values_or_do_not_fit() {
    let three = in_phase(Fmi3, 2);
    macro_rules! keeps {
        ($($name:literal($reference:expr): $type:ty;)*) => {
            $(for value in [<$type>::MIN, <$type>::MAX] {
                let (references, mut read) = (Argument::from(&[$reference][..]), [7 as $type]);
                ok([three.call(concat!("set_", $name), &[references, (&[value][..]).into()])]);
                ok([three.call(concat!("get_", $name), &[references, (&mut read[..]).into()])]);
                assert_eq!(read, [value]);
            })*
        };
    }
    keeps! {
        "int64"(I64): i64;
        "uint64"(U64): u64;
        "float64"(U): f64;
    }
    let two = in_phase(Fmi2, 2);
    // The bound is 0.1 as an f32, which is larger than 0.1; then, rounded to 2^24.
    for (value, rounded) in [(0.1, f64::from(0.1f32)), (16_777_216.5, 16_777_216.0)] {
        ok([two.set(F32, value)]);
        assert_eq!(two.get([F32]), [rounded]);
    }
    ok([two.set_i32(&[I8, U64], &[-128, 5])]);
    two.steps(0.001, 0.5);
    let mut values = [-7; 2];
    // 128 shifted by 24 bits is 2^31.
    two.refuses("long = 2147483648 does not fit", |f| f.get_i32(&[U64, LONG], &mut values));
    assert_eq!((values, two.read(Type::UInt64, [U64])), ([-7; 2], [5.0]));
}

#[test]
fn texts_and_bytes_are_copied_and_live_until_the_next_call_on_their_instance() {
    for version in [Fmi2, Fmi3] {
        let (it, other) = (in_phase(version, 2), in_phase(version, 2));
        let text = CString::from(c"r\xc3\xbcckw\xc3\xa4rts");
        assert_eq!(it.set_strings(&[LABEL], &[text.as_ptr()]), OK);
        text.into_bytes().fill(b'x');
        let mut given = [null::<c_char>(); 3];
        assert_eq!(it.get_strings(&[LABEL, REPORT, TEXT_OF], &mut given), OK);
        other.steps(0.001, 1.0);
        other.texts(&[LABEL, REPORT], 2);
        // SAFETY: no call on this instance was made since.
        let given = given.map(|text| unsafe { std::ffi::CStr::from_ptr(text) }.to_owned());
        let expected = [c"r\xc3\xbcckw\xc3\xa4rts", c"3", c"9"];
        assert_eq!(given.each_ref().map(|text| &**text), expected);
        it.steps(0.001, 1.0);
        assert_eq!(it.read(Type::Int32, [LENGTH]), [11.0]);
        for (bad, shown) in
            [(null(), "NULL"), (c"\xc3".as_ptr(), r#""\xc3""#), (c"a\xff".as_ptr(), r#""a\xff""#)]
        {
            let words = format!("label = {shown} is refused; expected a text in UTF-8");
            let texts = [c"1".as_ptr(), bad];
            it.refuses(&words, |f| f.set_strings(&[LABEL, LABEL], &texts));
        }
    }
    let three = in_phase(Fmi3, 0);
    let texts = [c"x".as_ptr(), c"".as_ptr(), c"y".as_ptr()];
    assert_eq!(three.set_strings(&[NAMES, LABEL], &texts), OK);
    let texts = three.texts(&[LABEL, NAMES], 3);
    assert_eq!(texts, [c"y".into(), c"x".into(), CString::default()]);
    let bytes = vec![0, 255, 0];
    assert_eq!(three.set_binaries(&[BYTES], &[3], &[bytes.as_ptr()]), OK);
    drop(bytes);
    let (mut sizes, mut values) = ([7], [null()]);
    assert_eq!(three.get_binaries(&[BYTES], &mut sizes, &mut values), OK);
    // SAFETY: no call on this instance was made since.
    let read = unsafe { std::slice::from_raw_parts(values[0], sizes[0]) };
    assert_eq!(read, [0, 255, 0]);
    // An empty value needs no pointer.
    assert_eq!(three.set_binaries(&[BYTES], &[0], &[null()]), OK);
    assert_eq!(three.read(Type::Binary, [BYTES]), [0.0]);
    let words = "bytes = NULL is refused";
    three.refuses(words, |f| f.set_binaries(&[BYTES], &[2], &[null()]));
}

#[test]
fn time_is_a_variable_of_fmi_3_that_the_host_never_sets() {
    let time = |f: &Instance| f.get([Ball::TIME])[0];
    let it = Instance::new((Fmi3, Stepped), BALL);
    assert_eq!(time(&it), 0.0);
    assert_eq!(it.enter(1.5, None, None), OK);
    assert_eq!(time(&it), 1.5);
    let reason = "time is the independent variable, which the host does not set";
    it.refuses(reason, |f| f.set(Ball::TIME, 1.0));
    assert_eq!(it.exit_initialization_mode(), OK);
    it.steps(1.5, 0.25);
    assert_eq!(it.get([Ball::TIME, Ball::DRIVE]), [1.75, 0.0]);
    let both = [Ball::DRIVE, Ball::TIME];
    it.refuses(reason, |f| f.set_f64(&both, &[1.0, 1.0]));
    let words = "time is of type Float64, not Float32";
    it.refuses(words, |f| f.get_f32(&[Ball::TIME], &mut [0.0]));
    assert_eq!(it.terminate(), OK);
    assert_eq!(time(&it), 1.75);
    let exchange = Instance::new(EXCHANGED[1], BALL).run(1.0);
    assert_eq!(time(&exchange), 1.0);
    assert_eq!(exchange.set_time(1.25), OK);
    assert_eq!(time(&exchange), 1.25);
}

#[test]
fn sizes_of_arrays_are_set_in_configuration_mode() {
    for kind in [(Fmi3, Stepped), EVENTS, (Fmi3, Exchanged)] {
        let it = Instance::new(kind, SAMPLED);
        let sizes = |n: u64, m: u64| move |f: Fmu| f.set_u64(&[Sampled::N, Sampled::M], &[n, m]);
        let gains = |n| it.get_all(Type::Float64, &[Sampled::GAINS], n).1;
        it.refuses("n is a structural parameter", sizes(3, 2));
        assert_eq!(it.enter_configuration_mode(), OK);
        let words = "n = 4 is refused; expected a whole number from 1 to 3";
        it.refuses(words, sizes(4, 2));
        assert_eq!(sizes(3, 2)(*it), OK);
        let saved = it.snapshot();
        assert_eq!(it.exit_configuration_mode(), OK);
        let names = it.texts(&[Sampled::NAMES], 2);
        assert_eq!(names, [c"a".to_owned(), c"b".to_owned()]);
        it.start(0.0, None);
        assert_eq!(gains(3), [1.0, 2.0, 4.0]);
        assert_eq!(it.get([Sampled::GAIN]), [7.0]);
        let words = "values passed: 2; expected 3";
        it.refuses(words, |f| f.set_f64(&[Sampled::GAINS], &[1.0; 2]));

        // While the simulation runs, those that are tunable.
        assert_eq!(it.enter_configuration_mode(), OK);
        it.refuses("m is a fixed structural parameter", sizes(2, 1));
        assert_eq!(it.set_u64(&[Sampled::N], &[Sampled::BAD]), OK);
        it.refuses("one gain is not enough", Fmu::exit_configuration_mode);
        assert_eq!(it.set_u64(&[Sampled::N], &[2]), OK);
        assert_eq!(it.exit_configuration_mode(), OK);
        let words = "values passed: 3; expected 2";
        it.refuses(words, |f| f.get_f64(&[Sampled::GAINS], &mut [0.0; 3]));
        assert_eq!(it.read(Type::Int32, [Sampled::CHANGES]), [1.0]);
        match kind.1 {
            Stepped => assert_eq!(it.steps(0.0, 0.5).time, 0.5),
            _ => assert_eq!(it.update(), (false, Some(0.5))),
        }
        assert_eq!(it.get([Sampled::GAIN]), [3.0]);

        // An FMU state includes the sizes, and the mode.
        it.resume(&saved);
        assert_eq!(sizes(3, 1)(*it), OK);
    }
}

#[test]
fn a_simulation_cycle_does_not_allocate() {
    // Inputs and an output of models without and with a sample time, and an array.
    let [two, three] = PLAIN;
    for (kind, model, inputs, n, output) in [
        (two, BALL, &[Ball::DRIVE, Ball::FAULT][..], 2, Ball::H),
        (three, BALL, &[Ball::DRIVE, Ball::FAULT], 2, Ball::H),
        (two, SAMPLED, &[Sampled::U], 1, Sampled::Y),
        (three, SAMPLED, &[Sampled::U], 1, Sampled::Y),
        (three, SAMPLED, &[Sampled::GAINS], 2, Sampled::GAIN),
    ] {
        let (it, mut last) = (Instance::running(kind, model), [0.0]);
        let allocations = allocation_counter::measure(|| {
            for k in 0..1000 {
                assert_eq!(it.set_f64(inputs, &[1.0, 0.0][..n]), OK);
                it.steps(f64::from(k) * 0.001, 0.001);
                assert_eq!(it.get_f64(&[output], &mut last), OK);
            }
        });
        assert_eq!(allocations.count_total, 0);
    }
}

/// Sets and gets in step mode, where the fast path decides, and in initialization mode, where it does not.
fn compare(version: FmiVersion, references: &[u32], values: &[f64]) {
    let (stepping, slow) = (in_phase(version, 2), in_phase(version, 1));
    let statuses = [&stepping, &slow].map(|f| f.set_f64(references, values));
    assert_eq!(statuses[0], statuses[1]);
    if statuses[0] == OK {
        let [fast, slow] =
            [stepping, slow].map(|f| f.get_all(Type::Float64, references, values.len()));
        assert_eq!((fast.0, slow.0), (OK, OK));
        let bits = |values: Vec<f64>| values.into_iter().map(f64::to_bits).collect::<Vec<_>>();
        assert_eq!(bits(fast.1), bits(slow.1));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_fast_path_equals_the_slow_one(
        version in select(vec![Fmi2, Fmi3]),
        references in prop::collection::vec(
            prop_oneof![8 => select(vec![VECTOR, MATRIX, U, V, BIAS]), 1 => 0..COUNT + 2], 0..5),
        noise in prop::collection::vec(
            prop_oneof![8 => -11.0..11.0, 1 => select(vec![f64::NAN, f64::INFINITY, -0.0, 1e300])], 20),
        extra in select(vec![0, 0, 0, 0, -1, 1]),
    ) {
        let fixed = FACTS.iter().filter(|fact| fact.role == Role::BeforeSteps);
        let fixed: Vec<u32> = fixed.flat_map(|f| (f.reference..).take(f.start.len())).collect();
        prop_assume!(!references.iter().any(|reference| fixed.contains(reference) || *reference == TROUBLE));
        let count = |reference: &u32| match *reference {
            VECTOR => 3,
            MATRIX => 4,
            _ => 1,
        };
        let n = match version {
            Fmi2 => references.len(),
            Fmi3 => references.iter().map(count).sum::<usize>().saturating_add_signed(extra),
        };
        compare(version, &references, &noise[..n]);
    }
}
