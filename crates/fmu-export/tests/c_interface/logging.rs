//! Calls of the logger.

use std::collections::BTreeSet;
use std::ffi::CStr;

use fmu_export::fmi2::{fmi2Error, fmi2OK, fmi2Warning};

use crate::host::{Arguments, Slave};
use crate::models::{PANIC, TROUBLE};

/// Text that crashes a logger that uses it as a format.
const HOSTILE: &CStr = c"%s%n%d%*d %%";

const ERRORS: &CStr = c"logStatusError";
const WARNINGS: &CStr = c"logStatusWarning";
const DISCARDS: &CStr = c"logStatusDiscard";
const FATAL: &CStr = c"logStatusFatal";
const EVENTS: &CStr = c"logEvents";
const ALL: &CStr = c"logAll";

fn named(name: &CStr, debug: bool) -> Slave {
    Slave::named(name, 0, debug)
}

/// Causes an event, a warning, an error, a discarded step and a panic; returns the logged categories.
fn provoke(slave: &mut Slave) -> BTreeSet<String> {
    slave.forget_messages();
    slave.start(0.0, None).step(0.001, 0.001);
    let now = slave.snapshot();
    for trouble in [2.0, 3.0, PANIC] {
        slave.resume(&now).set(TROUBLE, trouble);
        slave.step(0.002, 0.001);
    }
    slave
        .messages()
        .into_iter()
        .map(|message| message.category)
        .collect()
}

fn set(categories: &[&CStr]) -> BTreeSet<String> {
    categories
        .iter()
        .map(|name| name.to_str().unwrap().to_owned())
        .collect()
}

#[test]
fn categories_are_switched_by_name() {
    const TROUBLES: [&CStr; 4] = [ERRORS, WARNINGS, DISCARDS, FATAL];
    const EVERY: [&CStr; 5] = [ERRORS, WARNINGS, DISCARDS, FATAL, EVENTS];
    assert_eq!(provoke(&mut named(c"x", false)), set(&TROUBLES));
    assert_eq!(provoke(&mut named(c"x", true)), set(&EVERY));
    type Switch<'a> = (bool, &'a [&'a CStr]);
    let cases: [(&[Switch], &[&CStr]); 16] = [
        (&[(false, &[])], &[]),
        (&[(true, &[])], &EVERY),
        (&[(false, &[]), (true, &[])], &EVERY),
        (&[(true, &[EVENTS])], &[EVENTS]),
        (&[(true, &[ERRORS])], &[ERRORS]),
        (&[(true, &[WARNINGS])], &[WARNINGS]),
        (&[(true, &[DISCARDS])], &[DISCARDS]),
        (&[(true, &[FATAL])], &[FATAL]),
        (&[(true, &[ALL])], &EVERY),
        (&[(true, &[ERRORS, EVENTS, ERRORS])], &[ERRORS, EVENTS]),
        (&[(true, &[ERRORS]), (true, &[EVENTS])], &[EVENTS]),
        (&[(false, &[EVENTS])], &TROUBLES),
        (&[(true, &[]), (false, &[EVENTS])], &TROUBLES),
        (
            &[(true, &[]), (false, &[ERRORS, WARNINGS])],
            &[DISCARDS, FATAL, EVENTS],
        ),
        (&[(true, &[]), (false, &[ALL])], &[]),
        (&[(true, &[]), (false, &[]), (false, &[EVENTS])], &[]),
    ];
    for (switches, expected) in cases {
        let mut slave = Slave::new();
        for (on, names) in switches {
            assert_eq!(slave.switch_log(*on, names), fmi2OK);
        }
        assert_eq!(provoke(&mut slave), set(expected), "{switches:?}");
    }
}

#[test]
fn unknown_categories_are_rejected_and_change_nothing() {
    for name in [
        c"nonsense",
        c"",
        c"logall",
        c"logStatusPending",
        c" logAll",
        HOSTILE,
        c"logAll\xc3",
    ] {
        let mut slave = named(c"x", true);
        let words = [
            "fmi2SetDebugLogging",
            "is unknown; expected one of logStatusError, ",
        ];
        slave.refuses(&words, |s| s.switch_log(true, &[EVENTS, name]));
        slave.refuses(&words, |s| s.switch_log(false, &[EVENTS, name]));
        assert_eq!(provoke(&mut slave).len(), 5);
    }
}

#[test]
fn text_from_the_host_is_forwarded_unchanged() {
    let mut slave = named(HOSTILE, true);
    let hostile = HOSTILE.to_str().unwrap();
    slave.refuses(&[hostile], |s| s.switch_log(true, &[HOSTILE]));
    let refused = Slave::with(&Arguments {
        name: Some(HOSTILE),
        guid: Some(HOSTILE),
        ..Arguments::default()
    });
    assert!(refused.last_message().contains(hostile));
    for message in slave.messages().into_iter().chain(refused.messages()) {
        assert_eq!(&*message.instance, HOSTILE);
    }
}

#[test]
fn every_message_is_well_formed() {
    let mut slave = named(c"Pendel ϑ", true);
    assert_eq!(provoke(&mut slave).len(), 5);
    for message in slave.messages() {
        let status = match message.category.as_str() {
            "logStatusError" => fmi2Error,
            "logStatusWarning" => fmi2Warning,
            "logEvents" => fmi2OK,
            _ => continue, // tested with failing steps
        };
        assert_eq!(message.status, status);
        assert_eq!(&*message.instance, c"Pendel ϑ");
        assert_eq!(message.format, "%s");
        assert!(!message.text.contains('\n') && message.text.trim() == message.text);
    }
}

#[test]
fn every_state_change_is_an_event() {
    let mut slave = named(c"x", true);
    slave.start(0.0, None);
    assert_eq!((slave.terminate(), slave.reset()), (fmi2OK, fmi2OK));
    let events: Vec<String> = slave
        .messages()
        .into_iter()
        .map(|message| message.text)
        .collect();
    let states = [
        "initialization mode",
        "step complete",
        "terminated",
        "instantiated",
    ];
    assert_eq!(events, states.map(|state| format!("state: {state}")));
}

#[test]
fn states_do_not_include_log_settings() {
    let (mut loud, mut silent) = (named(c"x", true), Slave::new());
    assert_eq!(silent.switch_log(false, &[]), fmi2OK);
    let bytes = loud.snapshot();
    assert_eq!(bytes, silent.snapshot());
    assert_eq!(silent.resume(&bytes).terminate(), fmi2Error);
    assert_eq!(silent.messages(), []);
}
