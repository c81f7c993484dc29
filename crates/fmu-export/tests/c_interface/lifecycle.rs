//! Instances: how they are made, their logs, resources and variants, and many of them.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::ffi::{CStr, CString, c_char};
use std::ptr::{null, null_mut};
use std::sync::Barrier;

use fmu_description::{Interface, Type};
use fmu_export::{Entry, Variables, fmi2::*, fmi3::*, interface};

use crate::driver::*;
use crate::models::*;

// --- instantiation ------------------------------------------------------------------------------

/// Text that crashes a logger that uses it as a format.
const HOSTILE: &CStr = c"%s%n%d%*d %%";

#[test]
fn wrong_arguments_are_reported() {
    for kind in KINDS {
        let function = match kind {
            (Fmi2, _) => "fmi2Instantiate: ",
            (Fmi3, Exchanged) => "fmi3InstantiateModelExchange: ",
            (Fmi3, _) => "fmi3InstantiateCoSimulation: ",
        };
        let (name, guid) = (Some(c"instance"), token(BALL));
        let (guid, every) = (Some(&*guid), token(EVERY));
        let unsuitable = match kind.1 {
            Stepped => (None, guid, "the instance name is missing"),
            Events => (name, Some(&*every), "but Every has no event mode: hasEventMode is false"),
            Exchanged => {
                (name, Some(&*every), "Every is for co-simulation, not for model exchange")
            }
        };
        let missing = match kind.0 {
            Fmi2 => "the GUID is missing",
            Fmi3 => "the instantiation token is missing",
        };
        for (name, token, reason) in [
            (Some(c""), guid, "the instance name is missing"),
            (Some(c"pend\xff"), guid, "the instance name is not UTF-8"),
            (name, None, missing),
            (name, Some(c""), "belongs to another FMU"),
            (name, Some(c"{another}"), "this binary has: Every {"),
            (name, Some(c"\xff\xfe"), "belongs to another FMU"),
            (name, Some(HOSTILE), HOSTILE.to_str().unwrap()),
            unsuitable,
        ] {
            let [it, silent] = [true, false].map(|has_logger| {
                Arguments::of(kind, BALL).make(|a| {
                    (a.name, a.token, a.has_logger) = (name, token.map(CStr::to_owned), has_logger)
                })
            });
            assert!(it.c.is_null() && silent.c.is_null(), "{reason}");
            let messages = it.messages();
            assert_eq!(messages.len(), 1, "{reason}");
            assert_eq!(messages[0].kind(), ("logStatusError", ERROR));
            assert!(messages[0].text.starts_with(function), "{messages:?}");
            it.says(reason);
        }
        // A resource location may be anything; without logger, all works.
        let long = CString::new(vec![b'x'; 100_000]).unwrap();
        for resources in [None, Some(c""), Some(c"not a URI \xff%s%n"), Some(&*long)] {
            let it = Arguments::of(kind, BALL)
                .make(|a| (a.resources, a.debug, a.has_logger) = (resources, true, false));
            assert_eq!(it.run(0.0).set(Ball::COUNT, 0.0), ERROR);
        }
    }
    let (token, name, none) = (token(BALL), c"name".as_ptr(), null());
    // SAFETY: the strings outlive the calls, and NULL is allowed or refused.
    unsafe {
        let c = fmi2Instantiate(name, 1, token.as_ptr(), null(), null(), 1, 1);
        assert!(!c.is_null(), "without callbacks");
        fmi2FreeInstance(c);
        assert!(fmi2Instantiate(name, 7, token.as_ptr(), null(), null(), 0, 0).is_null());
        #[rustfmt::skip]
        let c = fmi3InstantiateCoSimulation(
            name, token.as_ptr(), null(), 0, 0, 0, 0, none, 1, null_mut(), None, None,
        );
        assert!(c.is_null(), "the intermediate variables are NULL");
        let host = Instance::of(PLAIN[1], BALL);
        let environment = (&raw const *host.host).cast_mut().cast();
        let (token, log) = (token.as_ptr(), Some(receive_3 as _));
        #[rustfmt::skip]
        let c = fmi3InstantiateScheduledExecution(
            name, token, null(), 0, 0, environment, log, None, None, None,
        );
        assert!(c.is_null());
        host.says("fmi3InstantiateScheduledExecution: the FMU is not for scheduled execution");
        let texts = [fmi2GetVersion(), fmi2GetTypesPlatform(), fmi3GetVersion()];
        let texts = texts.map(|text| CStr::from_ptr(text));
        assert_eq!(texts, [c"2.0", c"default", c"3.0"]);
    }
}

// --- logging ------------------------------------------------------------------------------------

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
        let it = Instance::of(kind, DEVICE);
        IS_BROKEN.set(false);
        assert!(it.c.is_null());
        it.says("the model panicked: the bug shows at the start");
    }
}

fn debugged(kind: Kind, name: &CStr) -> Instance {
    Arguments::of(kind, BALL).make(|a| (a.name, a.debug) = (Some(name), true))
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
        let it = Arguments::of(kind, DEVICE).make(|arguments| arguments.debug = true).run(7.0);
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
        let others = Instance::of(kind, EVERY);
        others.refuses("\"logModel\" is unknown", |f| f.switch_log(true, &[c"logModel"]));
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
        let it = Instance::of(kind, BALL);
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
        let it = Instance::of(kind, BALL);
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
fn every_change_of_the_state_is_an_event_and_states_do_not_include_log_settings() {
    for kind in KINDS {
        let it = debugged(kind, c"x").run(0.0);
        assert_eq!((it.terminate(), it.reset()), (OK, OK));
        let states = match kind.1 {
            Stepped => "initialization mode, step complete",
            Events => "initialization mode, event mode, step complete",
            Exchanged => "initialization mode, event mode, continuous-time mode",
        };
        let events: Vec<_> = it.messages().into_iter().map(|m| m.text).collect();
        let states = format!("{states}, terminated, instantiated").replace(", ", ", state: ");
        assert_eq!(events.join(", "), format!("state: {states}"));
        let silent = Instance::of(kind, BALL);
        assert_eq!(silent.switch_log(false, &[]), OK);
        let bytes = it.snapshot();
        assert_eq!(bytes, silent.snapshot());
        assert_eq!(silent.resume(&bytes).terminate(), ERROR);
        assert_eq!(silent.messages(), []);
    }
}

// --- resources and variants ---------------------------------------------------------------------

#[test]
fn a_model_reads_the_resource_that_a_parameter_names() {
    let folder = tempfile::Builder::new().prefix("a b").tempdir().unwrap();
    for (name, text) in [("weights.txt", "1\n2.5\n"), ("other.txt", "-1"), ("bad", "x")] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let path = folder.path().to_str().unwrap().replace('\\', "/");
    let uri = format!("file:///{}", path.trim_start_matches('/')).replace(' ', "%20");
    for (kind, location) in PLAIN.into_iter().zip([uri, path]) {
        let name = |f: &Instance, name: &CStr| {
            assert_eq!(f.set_strings(&[Sampled::FILE], &[name.as_ptr()]), OK);
        };
        let initializing = |resources: Option<&CStr>| {
            let it = Arguments::of(kind, SAMPLED).make(|a| a.resources = resources);
            name(&it, c"weights.txt");
            assert_eq!(it.enter(0.0, None, None), OK);
            it
        };
        let it = initializing(Some(&CString::new(location).unwrap()));
        assert_eq!(it.get([Sampled::SUM]), [3.5]);
        name(&it, c"other.txt");
        assert_eq!(it.get([Sampled::SUM]), [-1.0]);
        for (file, words) in [(c"missing", "missing: "), (c"bad", "invalid float")] {
            name(&it, file);
            it.refuses(words, Fmu::exit_initialization_mode);
        }
        name(&it, c"weights.txt");
        assert_eq!(it.exit_initialization_mode(), OK);
        assert_eq!(it.get([Sampled::SUM]), [3.5]);
        let place = if kind.0 == Fmi2 { "location" } else { "path" };
        let none = format!("weights.txt cannot be found: the host passed no resource {place}");
        for (resources, reason) in
            [(None, &*none), (Some(c""), &none), (Some(c"/a\xff"), "is not UTF-8")]
        {
            initializing(resources).refuses(reason, Fmu::exit_initialization_mode);
        }
    }
}

const N: usize = <Every as Variables>::COUNT;
/// gain = 3, order = 4, law = ignored, label = "slow", matrix[2,1] = -0.5, flags[1] = true
const FAST: Interface = interface::<Every, N>(Some(
    "Every=Fast;3:19:461393781824107315210:20:1382605085602742272024:1:425:1:128:1:231:4:slow",
));
/// n = 1
const SMALL: Interface =
    interface::<Sampled, { Sampled::COUNT as usize }>(Some("Sampled=Small;11:1:1"));
static VARIANTS: &[Entry] = &[
    Entry::new::<Every, N>(FAST, &[]),
    Entry::new::<Sampled, { Sampled::COUNT as usize }>(SMALL, &[]),
];

#[test]
fn a_variant_is_another_model_that_starts_with_its_own_values() {
    for kind in PLAIN {
        let variant = |guid: &str| {
            let token = Some(CString::new(guid).unwrap());
            Arguments::of(kind, EVERY).make(|a| (a.models, a.token) = (VARIANTS, token))
        };
        let it = variant(VARIANTS[0].guid());
        for _ in 0..2 {
            it.start(0.0, None);
            assert_eq!(it.get([GAIN, LIMIT]), [3.0, 1e6]);
            assert_eq!(it.read(Type::Int32, [ORDER, I32]), [4.0, 3.0]);
            assert_eq!(it.read(Type::Enumeration, [LAW]), [2.0]);
            assert_eq!(it.texts(&[LABEL], 1), [c"slow".to_owned()]);
            if kind.0 == Fmi2 {
                assert_eq!(it.get([MATRIX + 1, MATRIX + 2]), [2.0, -0.5]);
                assert_eq!(it.read(Type::Boolean, [FLAGS, FLAGS + 1]), [1.0, 1.0]);
            }
            assert_eq!((it.set(LIMIT, 7.0), it.reset()), (OK, OK));
        }
        let own = variant(MODELS[EVERY].guid());
        assert!(own.c.is_null());
        own.says("this binary has: Fast {");
        let bytes = Instance::of(kind, EVERY).snapshot();
        let restore = |f: Fmu| f.deserialize(&bytes, &mut null_mut());
        it.refuses("are a state of the model {", restore);
    }
}

#[test]
fn elements_that_are_in_use_can_be_addressed() {
    for (models, entry, n) in [(MODELS, SAMPLED, 2), (VARIANTS, 1, 1)] {
        for phase in 0..2 {
            let token = Some(CString::new(models[entry].guid()).unwrap());
            let it =
                Arguments::of(PLAIN[0], SAMPLED).make(|a| (a.models, a.token) = (models, token));
            ok([it.enter(0.0, None, None)]);
            assert!(phase == 0 || it.exit_initialization_mode() == OK);
            for k in 0..3 {
                let (element, value) = (Sampled::GAINS + k, f64::from(1 << k));
                if k < n {
                    ok([it.set(element, value)]);
                    assert_eq!(it.get([Sampled::GAINS, element]), [1.0, value]);
                } else {
                    let words = format!("gains[{}] is not available in FMI 2.0", k + 1);
                    it.refuses(&words, |f| f.set(element, 0.5));
                    it.refuses(&words, |f| f.get_f64(&[element], &mut [0.0]));
                }
            }
        }
    }
}

// --- several instances --------------------------------------------------------------------------

#[test]
fn instances_in_threads_give_the_same_results_as_alone() {
    /// A whole simulation, with FMU states in between.
    fn run(kind: Kind, seed: u32) -> Vec<Vec<u8>> {
        let it = Instance::running(kind, EVERY);
        let step = |k| {
            ok([it.set(U, f64::from((seed + 1) * k % 17))]);
            it.steps(0.01 * f64::from(k), 0.01);
            let now = it.snapshot();
            if k % 50 == seed {
                it.resume(&now);
            }
            now
        };
        (0..200).map(step).collect()
    }
    for kind in PLAIN {
        let alone = [0, 1, 2, 3].map(|seed| run(kind, seed));
        assert_ne!(alone[1], alone[2], "the inputs matter");
        let gate = &Barrier::new(4);
        let together = std::thread::scope(|scope| {
            let work = |seed| {
                gate.wait();
                run(kind, seed)
            };
            [0, 1, 2, 3].map(|seed| scope.spawn(move || work(seed))).map(|t| t.join().unwrap())
        });
        assert_eq!(together, alone);
    }
}

#[test]
fn instances_are_independent_and_leave_nothing_behind() {
    for kind in PLAIN {
        let mut instances: Vec<_> = (0..50).map(|_| Instance::of(kind, EVERY)).collect();
        for (k, it) in (0..).zip(&instances) {
            assert_eq!(it.set(GAIN, f64::from(k)), OK);
            it.start(0.0, None);
        }
        for k in (0..25).rev() {
            instances.remove(2 * k);
        }
        assert_eq!(instances[0].step(7.0, 0.1), ERROR);
        for (k, it) in (0..).zip(&instances) {
            it.steps(0.0, 0.1);
            assert_eq!(it.get([GAIN]), [f64::from(2 * k + 1)]);
            assert_eq!(it.messages().len(), usize::from(k == 0));
        }
        let life = || {
            let it = Instance::running(kind, EVERY);
            let now = it.snapshot();
            it.steps(0.0, 0.1);
            assert_eq!(it.step(7.0, 0.1), ERROR);
            it.resume(&now).steps(0.0, 0.1);
            assert_eq!(it.deserialize(b"nonsense", &mut null_mut()), ERROR);
            assert_eq!(it.reset(), OK);
        };
        life();
        let left = allocation_counter::measure(life);
        assert_eq!((left.bytes_current, left.count_current), (0, 0));
        // A panic in the destructor is caught.
        let it = Instance::running(kind, EVERY);
        assert_eq!(it.set(LIMIT, Every::LAST_BUG), OK);
        drop(it);
        Instance::running(kind, EVERY).steps(0.0, 0.1);
    }
}
