//! Instances of FMI 3.0, with the FMU of `fmi3.c`.
#![cfg(unix)]

use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};

use fmu_host::{
    Cause, Dependency, Failure, Instance, Instantiation, Intermediate, Kind, Library, Logged,
    Options, Status, Success, Version, resource_path,
};

type Log = Arc<Mutex<Vec<Logged>>>;

/// A copy of the library for each test, since a fatal error makes it unusable.
fn library() -> Arc<Library> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fmi3.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fmi3.c");
    let compiled = Command::new("cc")
        .args([
            "-std=c11", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o",
        ])
        .args([&file, &source])
        .status();
    assert!(compiled.unwrap().success());
    Library::load(&file).unwrap()
}

fn instantiate(library: &Arc<Library>, kind: Kind, options: Options<'_>) -> (Instance, Log) {
    let log = Log::default();
    let sink = Arc::clone(&log);
    let arguments = Instantiation {
        name: "a",
        kind,
        guid: "{token}",
        resources: &resource_path(Path::new("/tmp/resources")),
        logging_on: true,
    };
    let instance = library.instantiate_3(&arguments, options, move |logged| {
        sink.lock().unwrap().push(logged);
    });
    (instance.unwrap().expect("the token is right"), log)
}

fn slave() -> (Instance, Log) {
    instantiate(&library(), Kind::CoSimulation, Options::default())
}

fn texts(log: &Log) -> Vec<String> {
    let log = log.lock().unwrap();
    log.iter().map(|logged| logged.text.clone()).collect()
}

#[test]
fn the_arguments_of_the_instantiation_reach_the_fmu() {
    let (instance, log) = slave();
    assert_eq!(instance.version(), Version::Fmi3);
    let (_model, of_model) = instantiate(&library(), Kind::ModelExchange, Options::default());
    let options = Options {
        event_mode_used: true,
        early_return_allowed: true,
        intermediate_variables: &[7, 8],
        ..Options::default()
    };
    let (_used, used) = instantiate(&library(), Kind::CoSimulation, options);
    let all = [log, of_model, used].map(|log| texts(&log).concat());
    let expected = [
        "a in /tmp/resources/, visible 0, logging 1, events 0, early 0, variables 0 of 0",
        "a in /tmp/resources/, model exchange",
        "a in /tmp/resources/, visible 0, logging 1, events 1, early 1, variables 7 of 2",
    ];
    assert_eq!(all, expected);
}

#[test]
fn a_wrong_token_gives_no_instance_and_a_message() {
    let log = Log::default();
    let sink = Arc::clone(&log);
    let arguments = Instantiation {
        name: "a",
        kind: Kind::CoSimulation,
        guid: "{other}",
        resources: "",
        logging_on: false,
    };
    let library = library();
    let instance = library.instantiate_3(&arguments, Options::default(), move |logged| {
        sink.lock().unwrap().push(logged);
    });
    assert!(instance.unwrap().is_none());
    let expected = Logged {
        instance: None,
        status: Status::Error,
        category: Some("logStatusError".into()),
        text: "the token is wrong".into(),
    };
    assert_eq!(*log.lock().unwrap(), [expected]);
}

#[test]
fn the_experiment_is_passed_when_the_initialization_starts() {
    let (mut instance, log) = slave();
    instance
        .setup_experiment(1.5, Some(20.0), Some(1e-3))
        .unwrap();
    instance.enter_initialization_mode().unwrap();
    instance.exit_initialization_mode().unwrap();
    instance.setup_experiment(2.0, None, None).unwrap();
    instance.enter_initialization_mode().unwrap();
    instance.exit_initialization_mode().unwrap();
    assert_eq!(texts(&log)[1..], ["1 0.001 1.5 1 20", "0 0 2 0 0"]);
}

#[test]
fn values_of_every_type_come_back_and_arrays_as_a_whole() {
    let (mut instance, _log) = slave();
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
        get_real set_real 0.0: [1.0, -f64::MAX, f64::MIN_POSITIVE];
        get_float32 set_float32 0.0: [1.0, f32::MAX, f32::MIN_POSITIVE];
        get_int8 set_int8 0: [1, i8::MIN, i8::MAX];
        get_uint8 set_uint8 0: [1, 0, u8::MAX];
        get_int16 set_int16 0: [1, i16::MIN, i16::MAX];
        get_uint16 set_uint16 0: [1, 0, u16::MAX];
        get_integer set_integer 0: [1, i32::MIN, i32::MAX];
        get_uint32 set_uint32 0: [1, 0, u32::MAX];
        get_int64 set_int64 0: [1, i64::MIN, i64::MAX];
        get_uint64 set_uint64 0: [1, 0, u64::MAX];
        get_boolean set_boolean 0: [1, 0, 1];
    }
    instance.set_binary(&[0], &[b"\x00\xff"]).unwrap();
    assert_eq!(
        instance.get_binary(&[0], 1).unwrap(),
        [b"\x00\xff".to_vec()]
    );
    instance.set_binary(&[0], &[b""]).unwrap();
    assert_eq!(instance.get_binary(&[0], 1).unwrap(), [b"".to_vec()]);
    instance.set_binary(&[0], &[&[1; 8]]).unwrap();
    let null = instance.get_binary(&[0], 1).unwrap_err();
    assert!(matches!(null.cause, Cause::Broke(_)), "{null}");
    instance.set_clock(&[1, 3], true).unwrap();
    assert_eq!(instance.get_clock(&[1, 2, 3]).unwrap(), [true, false, true]);
    assert_eq!(instance.get_and_set_nothing(), Ok(Success::Ok));
}

#[test]
fn texts_are_copied_and_null_is_not_one() {
    let (mut instance, _log) = slave();
    let null = instance.get_string(&[0]).unwrap_err().to_string();
    assert_eq!(null, "fmi3GetString returned NULL for a string");
    instance
        .set_string(&[0], &[c"ab".into(), c"cd".into()])
        .unwrap();
    assert_eq!(instance.get_string(&[0]).unwrap(), ["abcd"]);
    let elements = instance.get_strings(&[0], 2, || ()).unwrap();
    assert_eq!(elements, [Some("abcd".into()), Some("bcd".into())]);
}

#[test]
fn steps_that_do_not_reach_their_end_have_failed() {
    let (mut instance, log) = slave();
    assert_eq!(instance.do_step(0.0, 0.5), Ok(Success::Ok));
    let ended = instance.do_step(10.0, 0.5).unwrap_err();
    assert_eq!(ended.to_string(), "fmi3DoStep asked to end the simulation");
    let (_, stepped) = instance.step(10.0, 0.5, false).unwrap();
    assert!(stepped.terminate && stepped.event_handling_needed && !stepped.early_return);
    assert_eq!(stepped.last_successful_time, 10.5);
    let refused = instance.do_step(0.0, -1.0).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "fmi3DoStep returned fmi3Error, expected fmi3OK"
    );
    let discarded = instance.do_step(0.0, 0.0).unwrap_err();
    assert_eq!(discarded.outcome(), "returned fmi3Discard");
    // The message is not a format.
    assert_eq!(texts(&log)[1..], ["100% %s wrong", "100% %s wrong"]);
}

#[test]
fn the_host_may_end_a_step_in_an_intermediate_update() {
    let updates = Arc::new(Mutex::new(Vec::new()));
    let received = Arc::clone(&updates);
    let options = Options {
        early_return_allowed: true,
        on_intermediate: Some(Arc::new(move |update: Intermediate| {
            received.lock().unwrap().push(update);
            (update.time > 1.0).then_some(1.25)
        })),
        ..Options::default()
    };
    let (mut instance, _log) = instantiate(&library(), Kind::CoSimulation, options);
    let (_, stepped) = instance.step(0.0, 1.0, true).unwrap();
    assert_eq!(
        (stepped.early_return, stepped.last_successful_time),
        (false, 1.0)
    );
    let early = instance.do_step(1.0, 1.0).unwrap_err();
    assert_eq!(early.cause, Cause::ReturnedEarly(1.25));
    let update = |time| Intermediate {
        time,
        set_requested: false,
        get_allowed: true,
        step_finished: true,
        can_return_early: true,
    };
    assert_eq!(*updates.lock().unwrap(), [update(0.5), update(1.5)]);
}

#[test]
fn a_warning_is_a_success_and_5_is_not_a_status() {
    let library = library();
    let (mut instance, _log) = instantiate(&library, Kind::CoSimulation, Options::default());
    assert_eq!(instance.terminate(), Ok(Success::Warning("fmi3Terminate")));
    instance.set_time(200.0).unwrap();
    let failure = instance.terminate().unwrap_err();
    assert_eq!(failure.cause, Cause::Returned(Status::Unknown(5)));
    let expected = "fmi3Terminate returned 5, which is not an fmi3Status, expected fmi3OK";
    assert_eq!(failure.to_string(), expected);
    assert!(library.is_lost());
}

#[test]
fn functions_of_the_other_version_and_missing_ones_fail_without_a_call() {
    let (mut instance, _log) = slave();
    let other = Failure {
        function: "fmi2CancelStep",
        cause: Cause::OtherVersion,
    };
    assert_eq!(instance.cancel_step(), Err(other));
    let missing = Failure {
        function: "fmi3Reset",
        cause: Cause::Missing,
    };
    assert_eq!(instance.reset(), Err(missing));
    let library = library();
    assert_eq!(library.version_3().unwrap(), "3.0");
    let missing = library.missing_of(Version::Fmi3, Kind::CoSimulation);
    assert!(missing.contains(&"fmi3Reset") && !missing.contains(&"fmi3DoStep"));
    assert_eq!(library.free_null_of(Version::Fmi3), Ok(()));
    assert!(library.free_null_of(Version::Fmi2).is_err());
}

#[test]
fn states_are_saved_restored_and_serialized_within_their_size() {
    let (mut instance, _log) = slave();
    instance.set_time(3.0).unwrap();
    let state = instance.state().unwrap();
    let bytes = instance.serialize(&state, 8).unwrap();
    assert_eq!(bytes, 3.0_f64.to_ne_bytes());
    let large = instance.serialize(&state, 7).unwrap_err();
    assert_eq!(
        (large.function, large.cause),
        ("fmi3SerializedFMUStateSize", Cause::TooLarge(8))
    );
    instance.set_time(7.0).unwrap();
    assert!(matches!(
        instance.serialize(&state, 8).unwrap_err().cause,
        Cause::Broke(_)
    ));
    let other = instance.deserialize(&5.0_f64.to_ne_bytes()).unwrap();
    instance.set_state(&other).unwrap();
    let mut saved = instance.state().unwrap();
    assert_eq!(
        instance.serialize(&saved, 8).unwrap(),
        5.0_f64.to_ne_bytes()
    );
    instance.set_state(&state).unwrap();
    instance.save_to(&mut saved).unwrap();
    assert_eq!(instance.serialize(&saved, 8).unwrap(), bytes);
    for state in [state, other, saved] {
        assert_eq!(instance.free_state(state), Ok(Success::Ok));
    }
    assert_eq!(instance.free_null_state(), Ok(Success::Ok));
}

#[test]
fn derivatives_are_those_of_all_elements() {
    let (mut instance, _log) = slave();
    // 1 unknown, 2 knowns, and the sum of the seed.
    let values = instance.directional_derivatives(&[0], 3, &[1, 2], &[0.25, 1.5, 2.0]);
    assert_eq!(values.unwrap(), [213.75; 3]);
    let values = instance.directional_derivative(&[0, 1], &[2], &[0.5]);
    assert_eq!(values.unwrap(), [120.5; 2]);
    let values = instance.adjoint_derivatives(&[0], &[1, 2, 3], 4, &[0.5]);
    assert_eq!(values.unwrap(), [310.5; 4]);
    assert_eq!(instance.output_derivatives(&[4, 6]).unwrap(), [4.5, 6.5]);
    let dependency = |element| Dependency {
        element,
        independent: 3,
        element_of_independent: 2 * element,
        kind: 5,
    };
    let dependencies = instance.variable_dependencies(2).unwrap();
    assert_eq!(dependencies, [dependency(0), dependency(1)]);
}

#[test]
fn models_for_model_exchange_are_called_as_those_of_fmi_2() {
    let (mut model, _log) = instantiate(&library(), Kind::ModelExchange, Options::default());
    let n = model.number_of_continuous_states().unwrap();
    model.set_continuous_states(&[1.0, -2.0]).unwrap();
    assert_eq!(model.derivatives(n).unwrap(), [-1.0, 2.0]);
    model.set_time(1.0).unwrap();
    let update = model.new_discrete_states().unwrap();
    assert!(update.states_changed && !update.again && !update.terminate && update.is_written);
    assert_eq!(update.next_event, Some(2.0));
    model.set_time(1.5).unwrap();
    let update = model.new_discrete_states().unwrap();
    assert_eq!((update.next_event, update.is_written), (None, false));
    let completed = model.completed_integrator_step().unwrap();
    assert!(completed.enter_event_mode && completed.is_written);
}
