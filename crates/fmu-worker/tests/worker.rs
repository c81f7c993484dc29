//! Workers that reply, crash, exit, hang, fill the memory, or lose their supervisor. Each is this program,
//! started again to run the test [`worker`].
#![cfg(unix)]

use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use fmu_worker::{Event, Function, Limits, Service, Worker};
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
enum Task {
    Count(u32),
    Abort,
    Exit,
    Hang,
    Fill,
    /// Starts a worker of its own, reports it, and waits.
    Supervise,
}

/// Not a test, but the worker of the others.
#[test]
fn worker() {
    let Some(mut service) = Service::of_this_process().unwrap() else {
        return;
    };
    let mut calls = service.record().calls(3);
    while let Some(task) = service.task().unwrap() {
        service.record().at(0.5);
        calls.begin(Function::named("fmi2DoStep"));
        match task {
            Task::Count(n) => (0..n).for_each(|k| service.reply(&(k.to_string(), f64::from(k)))),
            Task::Abort => std::process::abort(),
            Task::Exit => std::process::exit(3),
            Task::Hang => thread::sleep(Duration::from_secs(600)),
            Task::Fill => loop {
                std::mem::forget(vec![1_u8; 1 << 20]);
                thread::sleep(Duration::from_millis(1));
            },
            Task::Supervise => {
                let session = std::env::var_os("SESSION").unwrap();
                let mut child = start(Path::new(&session), Limits::default());
                child.send(&Task::Hang);
                service.reply(&true);
                child.wait().unwrap();
            }
        }
        service.record().end_call();
    }
}

fn start(session: &Path, limits: Limits) -> Worker {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "worker", "--nocapture"]);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let inner = session.join("inner");
    Worker::start(command.env("SESSION", inner), session, limits).unwrap()
}

#[test]
fn replies_arrive_in_order_and_the_worker_ends_by_itself() {
    let session = tempfile::tempdir().unwrap();
    let mut worker = start(session.path(), Limits::default());
    for count in [2, 50_000] {
        worker.send(&Task::Count(count));
        for k in 0..count {
            assert!(matches!(worker.wait().unwrap(), Event::Replied));
            let expected = (k.to_string(), f64::from(k));
            assert_eq!(worker.reply::<(String, f64)>().unwrap(), expected);
        }
    }
    let ended = worker.end(Duration::from_secs(600)).unwrap().to_string();
    assert_eq!(ended, "exited with code 0 before it had finished");
    assert_eq!(session.path().read_dir().unwrap().count(), 0);
}

#[test]
fn the_end_of_a_worker_is_told_with_its_call_and_its_replies_until_then_arrive() {
    let unlimited = Limits::default();
    let limit = Some(Duration::from_secs(3));
    let call = Limits {
        call: limit,
        ..unlimited
    };
    let task = Limits {
        task: limit,
        ..unlimited
    };
    let memory = Limits {
        memory: Some(100_000_000),
        ..unlimited
    };
    for (task, limits, text) in [
        (Task::Abort, unlimited, "was ended by signal 6, abort"),
        (
            Task::Exit,
            unlimited,
            "exited with code 3 before it had finished",
        ),
        (Task::Hang, call, "did not return within 3 s and was killed"),
        (Task::Hang, task, "did not return within 3 s and was killed"),
        (
            Task::Fill,
            memory,
            "used more than 0.1 GB of memory and was killed",
        ),
    ] {
        if matches!(task, Task::Fill) && cfg!(not(target_os = "linux")) {
            continue;
        }
        let session = tempfile::tempdir().unwrap();
        let mut worker = start(session.path(), limits);
        worker.send(&Task::Count(2));
        worker.send(&task);
        let mut replies = 0;
        let ended = loop {
            match worker.wait().unwrap() {
                Event::Replied => replies += 1,
                Event::Ended(ended) => break ended.to_string(),
            }
        };
        let now = worker.record().now();
        let function = now.function.and_then(Function::name);
        assert_eq!((ended.as_str(), replies), (text, 2));
        assert_eq!(
            (function, now.component, now.time),
            (Some("fmi2DoStep"), 3, Some(0.5))
        );
    }
}

#[test]
fn a_worker_whose_supervisor_is_killed_ends_and_removes_the_session() {
    let session = tempfile::tempdir().unwrap();
    let inner = session.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    let mut worker = start(session.path(), Limits::default());
    worker.send(&Task::Supervise);
    assert!(matches!(worker.wait().unwrap(), Event::Replied));
    drop(worker);
    while inner.exists() {
        thread::sleep(Duration::from_millis(10));
    }
}
