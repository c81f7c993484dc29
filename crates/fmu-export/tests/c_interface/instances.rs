//! Instances: how they are made, their resources and variants, and many of them.

use std::ffi::{CStr, CString};
use std::ptr::{null, null_mut};
use std::sync::Barrier;

use fmu_description::{Interface, Type};
use fmu_export::{Entry, Variables, fmi2::*, fmi3::*, interface};

use crate::driver::*;
use crate::models::*;

// --- instantiation ------------------------------------------------------------------------------

/// Text that crashes a logger that uses it as a format.
pub const HOSTILE: &CStr = c"%s%n%d%*d %%";

#[test]
fn wrong_arguments_are_reported() {
    for kind in KINDS.into_iter().chain([SCHEDULED]) {
        let function = match kind {
            (Fmi2, _) => "fmi2Instantiate: ",
            (Fmi3, Exchanged) => "fmi3InstantiateModelExchange: ",
            (Fmi3, Scheduled) => "fmi3InstantiateScheduledExecution: ",
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
            Scheduled => (name, Some(&*every), "the FMU is not for scheduled execution"),
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
                Arguments::new(kind, BALL).make(|a| {
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
            if kind == SCHEDULED {
                continue;
            }
            let it = Arguments::new(kind, BALL)
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
        let texts = [fmi2GetVersion(), fmi2GetTypesPlatform(), fmi3GetVersion()];
        let texts = texts.map(|text| CStr::from_ptr(text));
        assert_eq!(texts, [c"2.0", c"default", c"3.0"]);
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
            let it = Arguments::new(kind, SAMPLED).make(|a| a.resources = resources);
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
    Entry::new::<Every, N>(FLAT, &[]),
];
/// With flat names.
const FLAT: Interface = interface::<Every, N>(None).named(Some("package:flat"), None);

#[test]
fn messages_have_the_names_that_the_host_knows() {
    for kind in PLAIN {
        for (models, entry, bias) in [(MODELS, EVERY, "part.bias"), (VARIANTS, 2, "part_bias")] {
            let token = Some(CString::new(models[entry].guid()).unwrap());
            let it = Arguments::new(kind, EVERY).make(|a| (a.models, a.token) = (models, token));
            for _ in 0..2 {
                it.start(0.0, None);
                it.refuses(&format!("{bias} = NaN is refused"), |f| f.set(BIAS, f64::NAN));
                if kind.0 == Fmi2 {
                    let element = if entry == EVERY { "vector[3]" } else { "vector_3" };
                    let words = format!("{element} = 11 is refused");
                    it.refuses(&words, |f| f.set(VECTOR + 2, 11.0));
                }
                ok([it.reset()]);
            }
        }
    }
}

#[test]
fn a_variant_is_another_model_that_starts_with_its_own_values() {
    for kind in PLAIN {
        let variant = |guid: &str| {
            let token = Some(CString::new(guid).unwrap());
            Arguments::new(kind, EVERY).make(|a| (a.models, a.token) = (VARIANTS, token))
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
        let bytes = Instance::new(kind, EVERY).snapshot();
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
                Arguments::new(PLAIN[0], SAMPLED).make(|a| (a.models, a.token) = (models, token));
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
        let mut instances: Vec<_> = (0..50).map(|_| Instance::new(kind, EVERY)).collect();
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
