//! What an instance logs: categories, and text from the host.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::ffi::{CStr, CString, c_char};
use std::ptr::null;

use fmu_description::Type;

use crate::driver::*;
use crate::instances::HOSTILE;
use crate::models::*;

const ERRORS: &CStr = c"logStatusError";
const WARNINGS: &CStr = c"logStatusWarning";
const DISCARDS: &CStr = c"logStatusDiscard";
const FATALS: &CStr = c"logStatusFatal";
const EVENT: &CStr = c"logEvents";
const ALL: &CStr = c"logAll";

#[test]
fn a_panic_in_the_instantiation_is_logged() {
    for kind in PLAIN {
        IS_BROKEN.set(true);
        let it = Instance::new(kind, DEVICE);
        IS_BROKEN.set(false);
        assert!(it.c.is_null());
        it.says("the model panicked: the bug shows at the start");
    }
}

fn debugged(kind: Kind, name: &CStr) -> Instance {
    Arguments::new(kind, BALL).make(|a| (a.name, a.debug) = (Some(name), true))
}

/// Causes an event, a warning, an error, a discarded step and a panic; returns the logged categories.
fn provoke(f: &Instance) -> BTreeSet<CString> {
    f.forget_messages();
    f.start(0.0, None);
    f.step(0.2, 0.2);
    let now = f.snapshot();
    for trouble in [DISCARD, BREAK, BUG] {
        f.resume(&now).set(Ball::FAULT, trouble);
        f.step(0.4, 0.1);
    }
    f.messages().into_iter().map(|message| CString::new(message.category).unwrap()).collect()
}

#[test]
fn a_model_logs_in_the_categories_that_the_host_wants() {
    for kind in PLAIN {
        let it = Arguments::new(kind, DEVICE).make(|arguments| arguments.debug = true).run(7.0);
        ok([it.set(Device::U_1, 3.0), it.set(Device::U_2, 5.0)]);
        let time = Cell::new(7.0);
        let step = || {
            it.steps(time.get(), 1.0);
            time.set(time.get() + 1.0);
        };
        let said = |level: u8| {
            it.forget_messages();
            assert_eq!(it.set_all(Type::Int32, &[Device::LEVEL], &[level.into()]), OK);
            step();
            let own = it.messages().into_iter().filter(|m| !m.text.starts_with("state: "));
            own.map(|m| (m.category, m.status, m.text)).collect::<Vec<_>>()
        };
        let message = |category: &str, status, text: &str| {
            vec![(category.to_owned(), status, text.to_owned())]
        };
        assert_eq!(said(0), []);
        assert_eq!(said(1), message("logModel", OK, "opened at 7"));
        assert_eq!(said(2), message("logStatusWarning", WARNING, "read at 9"));
        assert_eq!(said(3), message("logStatusError", ERROR, "lost"));
        ok([it.switch_log(false, &[c"logModel"])]);
        assert_eq!((said(1), said(3).len()), (vec![], 1));
        ok([it.switch_log(true, &[c"logModel"])]);
        assert_eq!((said(1).len(), said(3)), (1, vec![]));
        let silent = allocation_counter::measure(step);
        assert_eq!((silent.count_total, it.get([Device::Y])), (0, [16.0]));
        // The log is still connected.
        ok([it.reset(), it.switch_log(true, &[])]);
        it.start(1.0, None);
        time.set(1.0);
        assert_eq!(said(1), message("logModel", OK, "opened at 1"));
        let others = Instance::new(kind, EVERY);
        others.refuses("\"logModel\" is unknown", |f| f.switch_log(true, &[c"logModel"]));
    }
}

#[test]
fn a_host_that_changes_a_deprecated_variable_is_warned_once() {
    for kind in PLAIN {
        let it = Instance::new(kind, HEIR);
        let warnings = || {
            let messages = it.messages();
            it.forget_messages();
            assert!(messages.iter().all(|m| m.kind() == ("logStatusWarning", WARNING)));
            messages.into_iter().map(|m| m.text).collect::<Vec<_>>()
        };
        // Some hosts set all variables to their start values.
        ok([it.set(Heir::OLD, 0.0), it.set_all(Type::Int32, &[Heir::ORDER], &[4.0])]);
        assert_eq!(warnings(), [""; 0]);
        for _ in 0..2 {
            ok([it.set_all(Type::Int32, &[Heir::ORDER], &[5.0])]);
            ok([it.set_all(Type::Int32, &[Heir::ORDER], &[4.0])]);
        }
        assert_eq!(warnings(), ["order is deprecated: it has no effect"]);
        it.start(0.0, None);
        it.steps(0.0, 1.0);
        for (step, old) in [(1.0, 0.0), (2.0, 1.0), (3.0, 2.0)] {
            ok([it.set(Heir::KEPT, step), it.set(Heir::OLD, old)]);
            let expected = if old == 1.0 { &["old is deprecated: use kept"][..] } else { &[] };
            assert_eq!(warnings(), expected);
            it.steps(step, 1.0);
            assert_eq!(it.get([Heir::Y]), [step + old + 5.0 + 4.0]);
        }
        let gains = [Heir::GAINS, Heir::GAINS + 1];
        let gains = if kind.0 == Fmi2 { &gains[..] } else { &gains[..1] };
        ok([it.set_all(Type::Float64, gains, &[2.0, 4.0])]);
        assert_eq!(warnings(), ["gains[2] is deprecated: use kept"]);
    }
}

#[test]
fn a_model_logs_in_categories_of_its_own() {
    const LIMITS: &CStr = c"limits";
    type Case<'a> = (bool, &'a [(bool, &'a [&'a CStr])], &'a [&'a str]);
    // Of the messages `limits: close`, `limits: exceeded` (a warning) and `logStatusWarning: read`.
    const CASES: &[Case<'_>] = &[
        (false, &[], &["limits exceeded", "logStatusWarning read at 2"]),
        (true, &[], &["limits close", "limits exceeded", "logStatusWarning read at 2"]),
        (false, &[(true, &[LIMITS])], &["limits close", "limits exceeded"]),
        (true, &[(false, &[LIMITS])], &["limits exceeded", "logStatusWarning read at 2"]),
        (true, &[(false, &[LIMITS, WARNINGS])], &[]),
        (
            false,
            &[(true, &[ALL])],
            &["limits close", "limits exceeded", "logStatusWarning read at 2"],
        ),
        (true, &[(false, &[])], &[]),
    ];
    for kind in PLAIN {
        for (debug, switches, expected) in CASES {
            let it = Arguments::new(kind, DEVICE).make(|arguments| arguments.debug = *debug);
            switches.iter().for_each(|(on, categories)| ok([it.switch_log(*on, categories)]));
            it.start(0.0, None);
            it.forget_messages();
            for (time, level) in [4, 5, 2].into_iter().enumerate() {
                ok([it.set_all(Type::Int32, &[Device::LEVEL], &[level.into()])]);
                it.steps(time as f64, 1.0);
            }
            let own = it.messages().into_iter().filter(|m| m.category != "logEvents");
            let said = |m: Message| format!("{} {}", m.category, m.text);
            assert_eq!(own.map(said).collect::<Vec<_>>(), *expected, "{debug} {switches:?}");
        }
        let it = Instance::new(kind, DEVICE);
        let words = "\"sensor\" is unknown; expected one of logStatusError, logStatusWarning, logStatusDiscard, \
            logStatusFatal, logEvents, logModel, logAll, limits";
        it.fails(ERROR, words, |f| f.switch_log(true, &[c"sensor"]));
    }
}

#[test]
fn categories_are_switched_by_name() {
    const EVERY: &[&CStr] = &[ERRORS, WARNINGS, DISCARDS, FATALS, EVENT];
    const TROUBLES: &[&CStr] = EVERY.split_at(4).0;
    type Switch<'a> = (bool, &'a [&'a CStr]);
    const CASES: &[(&[Switch], &[&CStr])] = &[
        (&[], TROUBLES),
        (&[(false, &[])], &[]),
        (&[(true, &[])], EVERY),
        (&[(false, &[]), (true, &[])], EVERY),
        (&[(true, &[EVENT])], &[EVENT]),
        (&[(true, &[ERRORS])], &[ERRORS]),
        (&[(true, &[WARNINGS])], &[WARNINGS]),
        (&[(true, &[DISCARDS])], &[DISCARDS]),
        (&[(true, &[FATALS])], &[FATALS]),
        (&[(true, &[ALL])], EVERY),
        (&[(true, &[ERRORS, EVENT, ERRORS])], &[ERRORS, EVENT]),
        (&[(true, &[ERRORS]), (true, &[EVENT])], &[EVENT]),
        (&[(false, &[EVENT])], TROUBLES),
        (&[(true, &[]), (false, &[EVENT])], TROUBLES),
        (&[(true, &[]), (false, &[ERRORS, WARNINGS])], &[DISCARDS, FATALS, EVENT]),
        (&[(true, &[]), (false, &[ALL])], &[]),
        (&[(true, &[]), (false, &[]), (false, &[EVENT])], &[]),
    ];
    for (kind, (switches, expected)) in pairs(&PLAIN, CASES) {
        let it = Instance::new(kind, BALL);
        for (on, names) in switches {
            ok([it.switch_log(*on, names)]);
        }
        let expected = expected.iter().map(|&name| name.to_owned()).collect();
        assert_eq!(provoke(&it), expected, "{switches:?}");
    }
}

#[test]
fn unknown_categories_are_refused_and_change_nothing() {
    for kind in PLAIN {
        let names = [c"", c"logall", c" logAll", c"logStatusPending"];
        for name in names.into_iter().chain([HOSTILE, c"logAll\xc3"]) {
            let it = debugged(kind, c"x");
            let words = "is unknown; expected one of logStatusError, ";
            it.refuses(words, |f| f.switch_log(true, &[EVENT, name]));
            it.refuses(words, |f| f.switch_log(false, &[EVENT, name]));
            assert_eq!(provoke(&it).len(), 5);
        }
        let it = Instance::new(kind, BALL);
        it.refuses("NULL", |f| f.switch(true, &[ALL.as_ptr(), null()]));
        let names = Argument::memory(null::<*const c_char>(), 1);
        it.refuses("NULL", |f| f.call("set_debug_logging", &[true.into(), names]));
    }
}

#[test]
fn messages_are_well_formed_and_text_from_the_host_is_escaped() {
    for kind in PLAIN {
        let name = CString::from(c"Pendel ϑ %n");
        let it = debugged(kind, &name);
        name.into_bytes().fill(b'x');
        assert_eq!(provoke(&it).len(), 5);
        for message in it.messages() {
            let status = match &*message.category {
                "logStatusError" => ERROR,
                "logStatusWarning" => WARNING,
                "logStatusDiscard" => DISCARDED,
                "logStatusFatal" => FATAL,
                _ => OK,
            };
            assert_eq!(message.status, status);
            if kind.0 == Fmi2 {
                let host = (&*message.instance, &*message.format);
                assert_eq!(host, (c"Pendel ϑ %n", c"%s"));
            }
            assert!(!message.text.contains('\n') && message.text.trim() == message.text);
        }
        let it = debugged(kind, c"x");
        let words = HOSTILE.to_str().unwrap();
        it.refuses(words, |f| f.switch_log(true, &[HOSTILE]));
        // `#` introduces a value reference.
        it.refuses("\"##1##\" is unknown", |f| f.switch_log(true, &[c"#1#"]));
    }
}

#[test]
fn saved_states_do_not_include_log_settings() {
    for kind in KINDS {
        let (it, silent) = (debugged(kind, c"x"), Instance::new(kind, BALL));
        ok([silent.switch_log(false, &[])]);
        let bytes = it.snapshot();
        assert_eq!(bytes, silent.snapshot());
        assert_eq!(silent.resume(&bytes).terminate(), ERROR);
        assert_eq!(silent.messages(), []);
    }
}
