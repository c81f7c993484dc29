//! The host with the FMU of `fmi3.c`, which does what a foreign FMU may do.
#![cfg(unix)]

use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fmu_description::{Type, Value};
use fmu_host::{
    CallObserver, Cause, Direction, Failure, FmiVersion, Instance, Instantiation, InterfaceType,
    Library, LogMessage, ObservedCall, Status, StepVariables, Success,
};
use tempfile::TempDir;

type Log = Arc<Mutex<Vec<LogMessage>>>;

/// Compiles a copy of the FMU for each test, since a fatal error makes it unusable.
fn compile() -> (TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fmi3.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fmi3.c");
    let compiled = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o"])
        .args([&file, &source])
        .status();
    assert!(compiled.unwrap().success());
    (folder, file)
}

fn library() -> Arc<Library> {
    let (_folder, file) = compile();
    Library::load(&file, FmiVersion::Fmi3).unwrap()
}

/// The arguments of an instance.
fn arguments() -> Instantiation<'static> {
    Instantiation {
        name: "a",
        guid: "{token}",
        resources: "/tmp/resources/",
        logging_on: true,
        ..Instantiation::default()
    }
}

fn instantiate(library: &Arc<Library>, arguments: &Instantiation<'_>) -> (Option<Instance>, Log) {
    let log = Log::default();
    let sink = Arc::clone(&log);
    let instance = library.instantiate(arguments, move |logged| sink.lock().unwrap().push(logged));
    (instance.unwrap(), log)
}

fn instance() -> (Instance, Log) {
    let (instance, log) = instantiate(&library(), &arguments());
    (instance.expect("the token is right"), log)
}

fn texts(log: &Log) -> Vec<String> {
    let log = log.lock().unwrap();
    log.iter().map(|logged| logged.text.clone()).collect()
}

#[test]
fn the_arguments_of_the_instantiation_reach_the_fmu() {
    let library = library();
    assert_eq!(library.location(Path::new("/tmp/resources")), "/tmp/resources/");
    let of_model = Instantiation { interface_type: InterfaceType::ModelExchange, ..arguments() };
    let used = Instantiation {
        event_mode_used: true,
        early_return_allowed: true,
        intermediate_variables: &[7, 8],
        ..arguments()
    };
    let all = [arguments(), of_model, used].map(|arguments| {
        let (instance, log) = instantiate(&library, &arguments);
        assert_eq!(instance.unwrap().version(), FmiVersion::Fmi3);
        texts(&log).concat()
    });
    let expected = [
        "a in /tmp/resources/, visible 0, logging 1, events 0, early 0, variables 0 of 0",
        "a in /tmp/resources/, model exchange",
        "a in /tmp/resources/, visible 0, logging 1, events 1, early 1, variables 7 of 2",
    ];
    assert_eq!(all, expected);
}

#[test]
fn a_wrong_token_gives_no_instance_and_a_message() {
    let wrong = Instantiation { guid: "{other}", ..arguments() };
    let (instance, log) = instantiate(&library(), &wrong);
    assert!(instance.is_none());
    let expected = LogMessage {
        instance: None,
        status: Status::Error,
        category: Some("logStatusError".into()),
        text: "the token is wrong".into(),
    };
    assert_eq!(*log.lock().unwrap(), [expected]);
}

#[test]
fn a_library_is_unloaded_after_its_last_instance() {
    let (_folder, file) = compile();
    let is_loaded = || {
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
        maps.contains(&*file.to_string_lossy())
    };
    let library = Library::load(&file, FmiVersion::Fmi3).unwrap();
    let (instance, _log) = instantiate(&library, &arguments());
    drop(library);
    assert_eq!(is_loaded(), cfg!(target_os = "linux"));
    drop(instance);
    assert!(!is_loaded());
}

/// Notes each call, as `name(in) -> status(out)`.
#[derive(Default)]
struct Noted(Mutex<Vec<String>>);

impl Noted {
    fn list(call: &ObservedCall<'_>, wanted: Direction) -> String {
        let mut all = Vec::new();
        for (index, (name, direction)) in call.arguments().enumerate() {
            if direction == wanted {
                let mut elements = Vec::new();
                let is_list = call.elements(index, &mut |element| elements.push(element));
                all.push(format!("{name}{}{elements:?}", if is_list { "=" } else { " " }));
            }
        }
        all.join(", ")
    }
}

impl CallObserver for Noted {
    fn begin(&self, call: &ObservedCall<'_>) {
        let line = format!("{}({})", call.function, Self::list(call, Direction::In));
        self.0.lock().unwrap().push(line);
    }

    fn end(&self, call: &ObservedCall<'_>, status: Option<i32>, _: Duration) {
        let line = format!(" -> {status:?}({})", Self::list(call, Direction::Out));
        self.0.lock().unwrap().last_mut().unwrap().push_str(&line);
    }
}

#[test]
fn an_observer_sees_each_call_with_its_arguments_before_and_after() {
    let (_folder, file) = compile();
    let noted = Arc::new(Noted::default());
    let library = Library::load_observed(&file, FmiVersion::Fmi3, noted.clone());
    let (instance, _log) = instantiate(&library.unwrap(), &arguments());
    let mut instance = instance.unwrap();
    instance.access_at_steps(StepVariables::new(&[0], 0..2), StepVariables::new(&[0], 0..2));
    assert!(instance.set_at_step(&[1.5, 2.0]).is_none());
    instance.get_float64(&[0], &mut [0.0; 2]).unwrap();
    instance.do_step(0.0, -1.0).unwrap_err();
    instance.reset().unwrap_err(); // it is missing
    drop(instance);
    let noted = noted.0.lock().unwrap();
    assert_eq!(noted[0], "load() -> None()");
    assert!(noted[1].starts_with("fmi3InstantiateCoSimulation(name "), "{}", noted[1]);
    assert!(noted[1].ends_with("-> Some(0)()"), "{}", noted[1]);
    let values = "values=[Float64(1.5), Float64(2.0)]";
    assert_eq!(noted[2], format!("fmi3SetFloat64(references=[Integer(0)], {values}) -> Some(0)()"));
    assert_eq!(noted[3], format!("fmi3GetFloat64(references=[Integer(0)]) -> Some(0)({values})"));
    assert!(noted[4].starts_with(
        "fmi3DoStep(time [Float64(0.0)], step [Float64(-1.0)], no_set_state [Integer(1)]) -> Some(3)"
    ), "{}", noted[4]);
    assert_eq!(noted[5..], ["fmi3FreeInstance() -> None()"]);
}

#[test]
fn steps_do_not_allocate_and_run_on_any_thread() {
    let (mut instance, _log) = self::instance();
    let work = move || {
        let mut values = [0.0; 2];
        let allocated = allocation_counter::measure(|| {
            for k in 0..9 {
                instance.set_float64(&[0], &[1.0, 2.0]).unwrap();
                assert_eq!(instance.do_step(f64::from(k), 1.0), Ok(Success::Ok));
                instance.get_float64(&[0], &mut values).unwrap();
            }
        });
        assert_eq!(allocated.count_total, 0);
    };
    std::thread::spawn(work).join().unwrap();
}

#[test]
fn the_experiment_is_passed_when_the_initialization_starts() {
    let (mut instance, log) = instance();
    instance.setup_experiment(1.5, Some(20.0), Some(1e-3)).unwrap();
    instance.enter_initialization_mode().unwrap();
    instance.exit_initialization_mode().unwrap();
    instance.setup_experiment(2.0, None, None).unwrap();
    instance.enter_initialization_mode().unwrap();
    instance.exit_initialization_mode().unwrap();
    assert_eq!(texts(&log)[1..], ["1 0.001 1.5 1 20", "0 0 2 0 0"]);
}

#[test]
fn values_of_every_type_come_back_and_arrays_as_a_whole() {
    let (mut instance, _log) = instance();
    macro_rules! comes_back {
        ($($get:ident $set:ident $zero:literal: $values:expr;)*) => {$(
            assert_eq!(instance.$set(&[1], &$values), Ok(Success::Ok));
            let mut read = [$zero; 3];
            assert_eq!(instance.$get(&[1], &mut read), Ok(Success::Ok));
            assert_eq!(read, $values, stringify!($get));
            // The second element, by the model of the FMU.
            let mut one = [$zero; 1];
            assert_eq!(instance.$get(&[2], &mut one), Ok(Success::Ok));
            assert_eq!(one, $values[1..2], stringify!($get));
        )*};
    }
    comes_back! {
        get_float64 set_float64 0.0: [1.0, -f64::MAX, f64::MIN_POSITIVE];
        get_float32 set_float32 0.0: [1.0, f32::MAX, f32::MIN_POSITIVE];
        get_int8 set_int8 0: [1, i8::MIN, i8::MAX];
        get_uint8 set_uint8 0: [1, 0, u8::MAX];
        get_int16 set_int16 0: [1, i16::MIN, i16::MAX];
        get_uint16 set_uint16 0: [1, 0, u16::MAX];
        get_int32 set_int32 0: [1, i32::MIN, i32::MAX];
        get_uint32 set_uint32 0: [1, 0, u32::MAX];
        get_int64 set_int64 0: [1, i64::MIN, i64::MAX];
        get_uint64 set_uint64 0: [1, 0, u64::MAX];
        get_boolean set_boolean 0: [1, 0, 1];
    }
    assert_eq!(instance.get_binary(&[0], 1).unwrap().1, [b"\x00\xff".to_vec()]);
    let mut empty = [Value::Boolean(true)];
    let warning = Ok(Success::Warning("fmi3GetBinary"));
    assert_eq!(instance.get_values(Type::Binary, &[1], &mut empty), warning);
    assert_eq!(empty, [Value::Binary(Vec::new())]);
    let null = instance.get_binary(&[2], 1).unwrap_err();
    assert!(matches!(null.cause, Cause::Broke(_)), "{null}");
    assert_eq!(instance.get_and_set_nothing(), Ok(Success::Ok));
    let large = instance.set_values(Type::Int32, &[1], &[Value::Int64(9_007_199_254_740_993)]);
    let expected = "fmi3SetInt32 cannot take the value 9007199254740993";
    assert_eq!(large.unwrap_err().to_string(), expected);
}

#[test]
fn texts_are_copied_and_null_is_not_one() {
    let (mut instance, _log) = instance();
    let null = instance.get_string(&[0], 1).unwrap_err().to_string();
    assert_eq!(null, "fmi3GetString returned NULL for a string");
    instance.set_string(&[0], &[c"ab".into(), c"cd".into()]).unwrap();
    assert_eq!(instance.get_string(&[0], 1).unwrap().1, ["abcd"]);
    let (_, elements) = instance.get_string_late(&[0], 2, || ()).unwrap();
    assert_eq!(elements, [Some("abcd".into()), Some("bcd".into())]);
    instance.set_string(&[0], &[c"".into()]).unwrap();
    let mut empty = [Value::Boolean(true)];
    let warning = Ok(Success::Warning("fmi3GetString"));
    assert_eq!(instance.get_values(Type::String, &[0], &mut empty), warning);
    assert_eq!(empty, [Value::String(String::new())]);
}

#[test]
fn steps_that_do_not_reach_their_end_have_failed() {
    let (mut instance, log) = instance();
    assert_eq!(instance.do_step(0.0, 0.5), Ok(Success::Ok));
    let ended = instance.do_step(10.0, 0.5).unwrap_err();
    assert_eq!(ended.to_string(), "fmi3DoStep asked to end the simulation");
    let (_, stepped) = instance.step(10.0, 0.5, false).unwrap();
    assert!(stepped.terminate && stepped.event_handling_needed && !stepped.early_return);
    assert_eq!(stepped.last_successful_time, 10.5);
    let refused = instance.do_step(0.0, -1.0).unwrap_err();
    assert_eq!(refused.to_string(), "fmi3DoStep returned fmi3Error, expected fmi3OK");
    let discarded = instance.do_step(0.0, 0.0).unwrap_err();
    assert_eq!(discarded.outcome(), "returned fmi3Discard");
    // The message is not a format.
    assert_eq!(texts(&log)[1..], ["100% %s wrong", "100% %s wrong"]);
}

#[test]
fn a_step_that_ends_early_in_an_intermediate_update_has_failed() {
    let updates = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&updates);
    let arguments = Instantiation {
        early_return_allowed: true,
        on_intermediate: Some(Arc::new(move || {
            counted.fetch_add(1, Relaxed);
        })),
        ..arguments()
    };
    let mut instance = instantiate(&library(), &arguments).0.unwrap();
    let (_, stepped) = instance.step(0.0, 1.0, true).unwrap();
    assert_eq!((stepped.early_return, stepped.last_successful_time), (false, 1.0));
    let early = instance.do_step(1.0, 1.0).unwrap_err();
    assert_eq!(early.cause, Cause::ReturnedEarly(1.5));
    assert_eq!(updates.load(Relaxed), 2);
}

#[test]
fn a_warning_is_a_success_and_5_is_not_a_status() {
    let (mut instance, _log) = instance();
    assert_eq!(instance.terminate(), Ok(Success::Warning("fmi3Terminate")));
    instance.set_time(200.0).unwrap();
    let failure = instance.terminate().unwrap_err();
    assert_eq!(failure.cause, Cause::Returned(Status::Unknown(5)));
    let expected = "fmi3Terminate returned 5, which is not an fmi3Status, expected fmi3OK";
    assert_eq!(failure.to_string(), expected);
    assert!(instance.library().is_lost());
}

#[test]
fn functions_of_the_other_version_and_missing_ones_fail_without_a_call() {
    let (mut instance, _log) = instance();
    let other = Failure { function: "fmi2CancelStep", cause: Cause::OtherVersion };
    assert_eq!(instance.cancel_step(), Err(other));
    let missing = Failure { function: "fmi3Reset", cause: Cause::Missing };
    assert_eq!(instance.reset(), Err(missing));
    let library = library();
    assert_eq!(library.texts().unwrap(), [("fmi3GetVersion", "3.0".into())]);
    let missing = library.missing(InterfaceType::CoSimulation);
    assert!(missing.contains(&"fmi3Reset") && !missing.contains(&"fmi3DoStep"));
    assert_eq!(library.free_null(), Ok(()));
}

#[test]
fn states_are_saved_restored_and_serialized_within_their_size() {
    let (mut instance, _log) = instance();
    instance.set_time(3.0).unwrap();
    let state = instance.get_fmu_state().unwrap();
    let bytes = instance.serialize_fmu_state(&state, 8).unwrap();
    assert_eq!(bytes, 3.0_f64.to_ne_bytes());
    let large = instance.serialize_fmu_state(&state, 7).unwrap_err();
    assert_eq!((large.function, large.cause), ("fmi3SerializedFMUStateSize", Cause::TooLarge(8)));
    instance.set_time(7.0).unwrap();
    assert!(matches!(instance.serialize_fmu_state(&state, 8).unwrap_err().cause, Cause::Broke(_)));
    let other = instance.deserialize_fmu_state(&5.0_f64.to_ne_bytes()).unwrap();
    instance.set_fmu_state(&other).unwrap();
    let mut saved = instance.get_fmu_state().unwrap();
    assert_eq!(instance.serialize_fmu_state(&saved, 8).unwrap(), 5.0_f64.to_ne_bytes());
    instance.set_fmu_state(&state).unwrap();
    instance.save_to(&mut saved).unwrap();
    assert_eq!(instance.serialize_fmu_state(&saved, 8).unwrap(), bytes);
    for state in [state, other, saved] {
        assert_eq!(instance.free_fmu_state(state), Ok(Success::Ok));
    }
    assert_eq!(instance.free_null_state(), Ok(Success::Ok));
}

#[test]
fn derivatives_are_those_of_all_elements() {
    let (mut instance, _log) = instance();
    // 1 unknown, 2 knowns, and the sum of the seed.
    let seed = [0.25, 1.5, 2.0];
    let values = instance.read(3, |i, v| i.get_directional_derivative(&[0], &[1, 2], &seed, v));
    assert_eq!(values.unwrap(), [213.75; 3]);
    let values = instance.read(4, |i, v| i.get_adjoint_derivative(&[0], &[1, 2, 3], &[0.5], v));
    assert_eq!(values.unwrap(), [310.5; 4]);
    let values = instance.read(2, |i, v| i.get_output_derivatives(&[4, 6], &[1, 2], v));
    assert_eq!(values.unwrap(), [4.5, 7.0]);
}

#[test]
fn results_that_the_fmu_has_not_written_are_known() {
    let of_model = Instantiation { interface_type: InterfaceType::ModelExchange, ..arguments() };
    let mut model = instantiate(&library(), &of_model).0.unwrap();
    let mut n = 0;
    model.get_number_of_continuous_states(&mut n).unwrap();
    model.set_continuous_states(&[1.0, -2.0]).unwrap();
    let derivatives = model.read(n, Instance::get_continuous_state_derivatives);
    assert_eq!(derivatives.unwrap(), [-1.0, 2.0]);
    model.set_time(1.0).unwrap();
    let update = model.update_discrete_states().unwrap();
    assert!(update.states_changed && !update.again && !update.terminate && update.is_written);
    assert_eq!(update.next_event, Some(2.0));
    model.set_time(1.5).unwrap();
    let update = model.update_discrete_states().unwrap();
    assert_eq!((update.next_event, update.is_written), (None, false));
    let completed = model.completed_integrator_step().unwrap();
    assert!(completed.enter_event_mode && completed.is_written);
}
