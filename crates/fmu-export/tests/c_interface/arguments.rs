//! Arguments of every call: an invalid one is rejected with a message and changes nothing.

use std::ffi::{CStr, CString, c_char};
use std::ptr::{null, null_mut};

use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Error, fmi2OK};

use crate::host::{Arguments, MODEL_EXCHANGE, Slave, guid};
use crate::models::*;

/// The states in which values can be set.
const PHASES: [fn() -> Slave; 3] = [Slave::new, initializing, running];

/// An instance in initialization mode with computed outputs.
fn initializing() -> Slave {
    let mut slave = Slave::new();
    assert_eq!(slave.enter_initialization_mode(), fmi2OK);
    slave.get([Y]);
    slave
}

/// An instance that has taken a step.
fn running() -> Slave {
    let mut slave = Slave::new();
    assert_eq!(slave.start(0.0, None).step(0.0, 0.001), fmi2OK);
    slave
}

/// The variables that can be set in each of the phases.
fn settable() -> impl Iterator<Item = (usize, Slave, &'static Fact)> {
    let phases = PHASES.iter().enumerate();
    phases.flat_map(|(phase, make)| {
        let facts = FACTS.iter().filter(move |fact| fact.settable(phase == 2));
        facts.map(move |fact| (phase, make(), fact))
    })
}

/// Sets a variable of any kind.
fn set(slave: &mut Slave, fact: &Fact, value: f64) -> fmi2Status {
    slave.set_all(fact.kind, &[fact.reference], &[value])
}

/// Gets a variable of any kind.
fn get(slave: &mut Slave, fact: &Fact) -> f64 {
    let (status, values) = slave.get_all(fact.kind, &[fact.reference]);
    assert_eq!(status, fmi2OK);
    values[0]
}

#[test]
fn start_values_match_the_table() {
    let mut slave = initializing();
    let has_start = |role| !matches!(role, Role::Output | Role::Local);
    for fact in FACTS.iter().filter(|fact| has_start(fact.role)) {
        assert_eq!(get(&mut slave, fact), fact.start, "{}", fact.name);
    }
}

#[test]
fn values_are_returned_as_set() {
    for (phase, mut slave, fact) in settable() {
        assert_eq!(
            set(&mut slave, fact, fact.other_value()),
            fmi2OK,
            "{}",
            fact.name
        );
        if phase == 0 {
            slave.start(0.0, None);
        }
        assert_eq!(get(&mut slave, fact), fact.other_value(), "{}", fact.name);
    }
}

#[test]
fn bounds_are_inclusive_and_rejections_name_the_variable() {
    for (_, mut slave, fact) in settable() {
        let (min, max) = fact.bounds;
        for bound in [min, max].into_iter().filter(|bound| bound.is_finite()) {
            assert_eq!(
                set(&mut slave, fact, bound),
                fmi2OK,
                "{} = {bound}",
                fact.name
            );
        }
        let outside = match fact.kind {
            Kind::String => vec![],
            Kind::Real => vec![
                min.next_down(),
                min - 1.0,
                max.next_up(),
                max + 1.0,
                f64::NAN,
                f64::INFINITY,
                f64::NEG_INFINITY,
            ],
            _ => vec![min - 1.0, -7.0, i32::MAX.into(), i32::MIN.into()],
        };
        for value in outside.into_iter().filter(|value| !fact.allows(*value)) {
            let reason = format!("{} = {value} is refused; expected ", fact.name);
            slave.refuses(&[&reason], |s| set(s, fact, value));
        }
    }
}

#[test]
fn rejections_state_the_expected_value() {
    for (reference, expected) in [
        (U, "a finite number"),
        (18, "a finite number [kg]"),
        (V, "a finite number from -10 to 10"),
        (GAIN, "a finite number of at least 0"),
        (ORDER, "a whole number from 1 to 4"),
        (LIMITED, "0 (false) or 1 (true)"),
        (LAW, "1 (added), 2 (ignored)"),
        (
            28,
            "laws[1,1] = 9 is refused; expected 1 (added), 2 (ignored)",
        ),
    ] {
        let fact = &FACTS[reference as usize];
        let value = if fact.kind == Kind::Real {
            f64::NAN
        } else {
            9.0
        };
        Slave::new().refuses(&[expected], |s| set(s, fact, value));
    }
}

#[test]
fn only_inputs_and_tunable_parameters_can_be_set_at_any_time() {
    for (phase, make) in PHASES.iter().enumerate() {
        for fact in FACTS.iter().filter(|fact| !fact.settable(phase == 2)) {
            let why = match fact.role {
                Role::Always => unreachable!(),
                Role::BeforeSteps => "a fixed parameter",
                Role::Output => "an output",
                Role::Local => "a local variable",
                Role::Constant => "a constant",
            };
            let reason = format!("{} is {why}", fact.name);
            make().refuses(&[&reason], |s| set(s, fact, fact.other_value()));
        }
    }
}

#[test]
fn a_tunable_parameter_takes_effect_in_the_next_step() {
    let mut slave = Slave::new();
    slave.start(0.0, None);
    assert_eq!(slave.set_reals(&[U, LIMIT], &[100.0, 50.0]), fmi2OK);
    assert_eq!(slave.step(0.0, 1.0), fmi2OK);
    assert_eq!(slave.set(LIMIT, 30.0), fmi2OK);
    assert_eq!(slave.get([Y]), [50.0]);
    assert_eq!(slave.step(1.0, 1.0), fmi2OK);
    assert_eq!(slave.get([Y]), [30.0]);
}

type Access = fn(&mut Slave, Kind, u32) -> fmi2Status;

/// Getters and setters, each called with one reference and an arbitrary value.
const ACCESS: [(&str, Access); 2] = [
    ("fmi2Get", |s, kind, r| s.get_all(kind, &[r]).0),
    ("fmi2Set", |s, kind, r| s.set_all(kind, &[r], &[0.0])),
];

#[test]
fn unknown_references_and_wrong_types_are_rejected() {
    let mut slave = initializing();
    let kinds = [Kind::Real, Kind::Integer, Kind::Boolean, Kind::String];
    for ((name, access), kind) in ACCESS.iter().flat_map(|a| kinds.map(|kind| (a, kind))) {
        let name = format!("{name}{kind:?}");
        for reference in [COUNT, 1_000_000, 1 << 31, u32::MAX] {
            let words = [&name, &*format!("value reference {reference} is unknown")];
            slave.refuses(&words, |s| access(s, kind, reference));
        }
        for fact in FACTS.iter().filter(|fact| fact.kind != kind) {
            let (reason, asked) = (format!("{} is ", fact.name), format!("{kind:?}"));
            slave.refuses(&[&name, &reason, &asked], |s| {
                access(s, kind, fact.reference)
            });
        }
    }
}

#[test]
fn null_arrays_are_rejected_unless_empty() {
    let mut slave = initializing();
    macro_rules! check {
        ($($function:ident($value:expr);)*) => {
            $(for (references, values) in [(true, false), (false, true), (false, false)] {
                let (reference, mut value) = (U, $value);
                let references = if references { &raw const reference } else { null() };
                let values = if values { &raw mut value } else { null_mut() };
                // SAFETY: the instance lives, and arrays are NULL or have one element.
                let call = |s: &mut Slave, n| unsafe { $function(s.c, references, n, values) };
                slave.refuses(&[stringify!($function)], |s| call(s, 1));
                assert_eq!(call(&mut slave, 0), fmi2OK);
            })*
        };
    }
    check! {
        fmi2GetReal(0.0);
        fmi2GetInteger(0);
        fmi2GetBoolean(0);
        fmi2GetString(null());
        fmi2SetReal(0.0);
        fmi2SetInteger(0);
        fmi2SetBoolean(0);
        fmi2SetString(null());
    }
}

#[test]
fn one_invalid_value_prevents_setting_any() {
    for make in PHASES {
        let mut slave = make();
        for (bad, value) in [(Y, 0.0), (LAW, 1.0), (V, f64::NAN), (V, 11.0), (COUNT, 0.0)] {
            for references in [[U, LIMIT, bad], [U, bad, LIMIT], [bad, U, LIMIT]] {
                let values = references.map(|r| if r == bad { value } else { 5.0 });
                slave.refuses(&["fmi2SetReal"], |s| s.set_reals(&references, &values));
            }
        }
    }
    Slave::new().refuses(&["order = 5"], |s| s.set_integers(&[LAW, ORDER], &[2, 5]));
}

#[test]
fn one_invalid_reference_prevents_reading_any() {
    let (mut reals, mut integers) = ([-7.0; 3], [-7; 2]);
    initializing().refuses(&["fmi2GetReal"], |s| {
        s.get_reals(&[U, Y, COUNT], &mut reals)
    });
    initializing().refuses(&["fmi2GetInteger"], |s| {
        s.get_integers(&[LAW, U], &mut integers)
    });
    assert_eq!((reals, integers), ([-7.0; 3], [-7; 2]));
}

#[test]
fn the_last_of_several_values_for_one_variable_wins() {
    for make in PHASES {
        let mut slave = make();
        assert_eq!(slave.set_reals(&[U, V, U], &[1.0, 2.0, 3.0]), fmi2OK);
        if slave.get_reals(&[U], &mut [0.0]) == fmi2Error {
            slave.start(0.0, None);
        }
        assert_eq!(slave.get([U, U, V]), [3.0, 3.0, 2.0]);
    }
}

#[test]
fn a_null_log_category_is_rejected() {
    let names: [*const c_char; 2] = [c"logAll".as_ptr(), null()];
    let mut slave = Slave::new();
    for (n, names) in [(1, null()), (2, names.as_ptr())] {
        // SAFETY: the instance lives, and the array is NULL or has two elements.
        slave.refuses(&["NULL"], |s| unsafe {
            fmi2SetDebugLogging(s.c, 1, n, names)
        });
    }
}

// --- instantiation ------------------------------------------------------------------------------

#[test]
fn invalid_instantiations_are_rejected_with_a_reason() {
    let right = guid(0);
    let good = || Arguments {
        guid: Some(&right),
        ..Arguments::default()
    };
    let name = |name: Option<&'static CStr>| Arguments { name, ..good() };
    let guid = |guid: Option<&'static CStr>| Arguments { guid, ..good() };
    for (arguments, reason) in [
        (name(None), "the instance name is missing"),
        (name(Some(c"")), "the instance name is missing"),
        (
            name(Some(c"pend\xfful\xc3")),
            "the instance name is not UTF-8",
        ),
        (guid(None), "the GUID is missing"),
        (guid(Some(c"")), "is that of another FMU"),
        (
            guid(Some(c"{00000000-0000-0000-0000-000000000000}")),
            "this binary has: Probe {",
        ),
        (guid(Some(c"\xff\xfe")), "is that of another FMU"),
        (
            Arguments {
                kind: MODEL_EXCHANGE,
                ..good()
            },
            "is for co-simulation",
        ),
        (Arguments { kind: 7, ..good() }, "the type is 7"),
    ] {
        let slave = Slave::with(&arguments);
        assert!(slave.c.is_null(), "{reason}");
        let messages = slave.messages();
        assert_eq!(messages.len(), 1, "{reason}");
        assert_eq!(
            (messages[0].category.as_str(), messages[0].status),
            ("logStatusError", fmi2Error)
        );
        assert!(
            messages[0].text.starts_with("fmi2Instantiate: "),
            "{messages:?}"
        );
        assert!(messages[0].text.contains(reason), "{messages:?}");
    }
}

#[test]
fn the_guid_selects_the_model_and_any_resource_location_is_accepted() {
    let long = CString::new(vec![b'x'; 100_000]).unwrap();
    for resources in [None, Some(c""), Some(c"not a URI \xff%s%n"), Some(&*long)] {
        for (model, last) in [(PROBE, TAU), (WIDE, 68)] {
            let guid = guid(model);
            let mut slave = Slave::with(&Arguments {
                guid: Some(&guid),
                resources,
                ..Arguments::default()
            });
            slave.start(0.0, None).get([last]);
            assert_eq!(slave.get_reals(&[last + 2], &mut [0.0]), fmi2Error);
        }
    }
}

#[test]
fn hosts_without_callbacks_are_supported() {
    let (guid, mut slave) = (guid(0), Slave::null());
    // SAFETY: the strings outlive the call, and the rest may be NULL.
    slave.c = unsafe { fmi2Instantiate(c"x".as_ptr(), 1, guid.as_ptr(), null(), null(), 1, 1) };
    assert!(!slave.c.is_null());
    assert_eq!(slave.step(0.0, 0.1), fmi2Error);
    assert_eq!(slave.start(0.0, None).step(0.0, 0.1), fmi2OK);
}

#[test]
fn version_and_platform_do_not_need_an_instance() {
    // SAFETY: the functions return static strings.
    let texts = unsafe { [fmi2GetVersion(), fmi2GetTypesPlatform()].map(|t| CStr::from_ptr(t)) };
    assert_eq!(texts, [c"2.0", c"default"]);
}
