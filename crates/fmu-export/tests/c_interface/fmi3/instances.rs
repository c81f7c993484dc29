//! The arguments of the functions that create instances (FMI 3.0.2, section 2.3.1).

use std::ffi::CStr;
use std::ptr::{null, null_mut};

use fmu_export::fmi3::*;
use fmu_export::fmi3::{fmi3Fatal, fmi3OK};

use super::host::{Arguments, Instance, Kind, Kind::*};
use crate::host::guid;
use crate::models::*;

/// Checks that no instance is created, for a reason with the words.
#[track_caller]
fn assert_none(arguments: &Arguments, words: &[&str]) {
    let instance = Instance::with(arguments);
    assert!(instance.0.is_null());
    let messages = instance.messages();
    assert_eq!(messages.len(), 1, "{messages:?}");
    assert_eq!(messages[0].category, "logStatusError");
    for word in words {
        assert!(messages[0].text.contains(word), "{word}: {messages:?}");
    }
    let silent = Instance::with(&Arguments {
        has_logger: false,
        ..*arguments
    });
    assert!(silent.0.is_null());
}

fn with<'a>(kind: Kind, token: &'a CStr) -> Arguments<'a> {
    Arguments {
        token: Some(token),
        ..Arguments::of(kind)
    }
}

#[test]
fn wrong_arguments_are_reported() {
    let (ball, wide) = (guid(BALL), guid(WIDE));
    for (kind, function) in [
        (CoSimulation, "fmi3InstantiateCoSimulation: "),
        (Events, "fmi3InstantiateCoSimulation: "),
        (ModelExchange, "fmi3InstantiateModelExchange: "),
    ] {
        let wrong = with(kind, c"{another}");
        assert_none(&wrong, &[function, "{another} is that of another FMU"]);
        assert_none(&Arguments::of(kind), &[function, "is missing"]);
        for name in [None, Some(c"")] {
            let arguments = Arguments {
                name,
                ..with(kind, &ball)
            };
            assert_none(&arguments, &[function, "the instance name is missing"]);
        }
    }
    let reason = "Wide is for co-simulation, not for model exchange";
    assert_none(&with(ModelExchange, &wide), &[reason]);
    let reason = "eventModeUsed is true, but Wide has no event mode: hasEventMode is false";
    assert_none(&with(Events, &wide), &[reason]);
    assert_eq!(
        Instance::of(CoSimulation, WIDE).enter_initialization_mode(0.0, None),
        fmi3OK
    );
}

#[test]
fn intermediate_variables_must_not_be_null() {
    let token = guid(BALL);
    // SAFETY: NULL is allowed or refused.
    let instance = unsafe {
        fmi3InstantiateCoSimulation(
            c"name".as_ptr(),
            token.as_ptr(),
            null(),
            0,
            0,
            0,
            0,
            null(),
            1,
            null_mut(),
            None,
            None,
        )
    };
    assert!(instance.is_null());
}

#[test]
fn an_instance_works_without_logger() {
    let token = guid(BALL);
    let instance = Instance::with(&Arguments {
        has_logger: false,
        debug: true,
        ..with(CoSimulation, &token)
    });
    instance.start(0.0, None);
    assert_eq!(instance.set(Ball::FAULT, PANIC), fmi3OK);
    instance.steps(0.0, 0.25);
    assert_eq!(instance.step(0.25, 0.25).0, fmi3Fatal);
}

#[test]
fn the_resource_path_is_a_path() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("weights.txt"), "1.5\n2").unwrap();
    let path = std::ffi::CString::new(folder.path().to_str().unwrap()).unwrap();
    let token = guid(READER);
    let read = |resources: Option<&CStr>| {
        let instance = Instance::with(&Arguments {
            resources,
            ..with(CoSimulation, &token)
        });
        assert_eq!(instance.enter_initialization_mode(0.0, None), fmi3OK);
        instance
    };
    let instance = read(Some(&path));
    assert_eq!(instance.exit_initialization_mode(), fmi3OK);
    assert_eq!(instance.get([1]), [3.5]);
    for missing in [None, Some(c"")] {
        let words = ["weights.txt cannot be found: the host passed no resource path"];
        read(missing).refuses(&words, |f| f.exit_initialization_mode());
    }
    read(Some(c"/\xff")).refuses(&["is not UTF-8"], |f| f.exit_initialization_mode());
}

#[test]
fn events_are_logged_on_demand_and_a_hash_is_escaped() {
    let token = guid(BALL);
    let instance = Instance::with(&Arguments {
        debug: true,
        ..with(Events, &token)
    });
    instance.start(0.0, None);
    let texts: Vec<_> = instance
        .messages()
        .into_iter()
        .map(|m| (m.category, m.text))
        .collect();
    let event = |text: &str| ("logEvents".to_owned(), text.to_owned());
    assert_eq!(
        texts,
        [
            event("state: initialization mode"),
            event("state: event mode")
        ]
    );
    instance.refuses(&["\"##1##\" is unknown"], |f| f.switch_log(true, &[c"#1#"]));
}

#[test]
fn scheduled_execution_is_refused_with_a_reason() {
    let host = Instance::new(CoSimulation);
    let environment = (&raw const *host.host).cast_mut().cast();
    // SAFETY: the arguments are valid.
    let instance = unsafe {
        fmi3InstantiateScheduledExecution(
            c"name".as_ptr(),
            guid(BALL).as_ptr(),
            null(),
            0,
            0,
            environment,
            Some(super::host::receive),
            None,
            None,
            None,
        )
    };
    assert!(instance.is_null());
    assert!(
        host.last_message()
            .contains("the FMU is not for scheduled execution")
    );
}

#[test]
fn the_version_is_3_0() {
    // SAFETY: a string of the FMU.
    assert_eq!(unsafe { CStr::from_ptr(fmi3GetVersion()) }, c"3.0");
}
