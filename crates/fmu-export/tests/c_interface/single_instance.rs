//! Models of which a process can have one instance only.

use std::ffi::CString;
use std::ptr::null_mut;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;

use fmu_export::prelude::*;
use fmu_export::testing::Driver;
use fmu_export::{Entry, interface};

use crate::driver::*;

/// Counts its steps in a global, as C code does
#[derive(Model)]
#[model(single_instance, sample_time = 1.0)]
struct Counter {
    /// number of steps
    #[output]
    count: f64,
    /// start of the count
    #[parameter]
    first: i32,
}

static COUNT: AtomicU32 = AtomicU32::new(0);

impl Simulate for Counter {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        COUNT.store(self.first as u32, Ordering::Relaxed);
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.count = f64::from(COUNT.fetch_add(1, Ordering::Relaxed) + 1);
        Ok(())
    }
}

/// Has an instance in each of several tests
#[derive(Model)]
#[model(single_instance)]
struct Alone {
    /// output
    #[output]
    y: f64,
}

static ALIVE: AtomicU32 = AtomicU32::new(0);

impl Simulate for Alone {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.y = f64::from(ALIVE.fetch_add(1, Ordering::SeqCst));
        thread::yield_now();
        ALIVE.fetch_sub(1, Ordering::SeqCst);
        Ok(())
    }
}

const N: usize = <Counter as Variables>::COUNT;
static COUNTERS: &[Entry] = &[Entry::new::<Counter, N>(interface::<Counter, N>(None), &[])];

fn counter(kind: Kind) -> Instance {
    let token = Some(CString::new(COUNTERS[0].guid()).unwrap());
    Arguments::new(kind, 0).make(|a| (a.models, a.token) = (COUNTERS, token))
}

#[test]
fn a_second_instance_is_refused_until_the_first_is_freed() {
    for kind in KINDS {
        let first = counter(kind).run(0.0);
        for _ in 0..2 {
            let second = counter(kind);
            assert!(second.c.is_null());
            second.says(
                "this process has an instance of Counter already, and can have one only: \
                 canBeInstantiatedOnlyOncePerProcess is true; free it first, or use another process",
            );
        }
        assert_eq!(first.reset(), OK);
        assert!(counter(kind).c.is_null(), "a reset instance is still there");
        let mut state = null_mut();
        let words = "the model has state outside its fields (single_instance) that cannot be saved";
        first.fails(ERROR, words, |f| f.get_state(&mut state));
        drop(first);
        // A wrong call does not take the place.
        let nobody = Arguments::new(kind, 0).make(|a| (a.models, a.token) = (COUNTERS, None));
        assert!(nobody.c.is_null());
        assert!(!counter(kind).c.is_null());
    }
}

#[test]
fn drivers_wait_for_those_of_other_threads() {
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let mut alone = Driver::<Alone>::new();
                for _ in 0..100 {
                    alone.step(0.1).unwrap();
                    assert_eq!(alone.y, 0.0, "another instance steps at the same time");
                }
            });
        }
    });
}

#[test]
#[should_panic(expected = "Mine is single_instance; drop its Driver before you make another one")]
fn a_second_driver_in_a_thread_panics() {
    /// Model of this test
    #[derive(Model)]
    #[model(single_instance)]
    struct Mine {
        /// output
        #[output]
        y: f64,
    }
    impl Simulate for Mine {
        fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
            Ok(())
        }
    }
    let _first = Driver::<Mine>::new();
    let _second = Driver::<Mine>::new();
}
