//! Several instances, concurrently and in sequence.

use std::ffi::CString;
use std::sync::Barrier;

use allocation_counter::measure;
use fmu_export::fmi2::{fmi2Error, fmi2OK};

use crate::host::Slave;
use crate::models::*;

/// A whole simulation, with FMU states in between.
fn run(slave: &mut Slave, seed: u32) -> Vec<Vec<u8>> {
    let steps = 0..200;
    slave.start(0.0, None);
    steps
        .map(|k| {
            assert_eq!(slave.set(U, f64::from((seed + 1) * k % 17)), fmi2OK);
            assert_eq!(slave.step(0.01 * f64::from(k), 0.01), fmi2OK);
            let now = slave.snapshot();
            if k % 50 == seed {
                slave.resume(&now);
            }
            now
        })
        .collect()
}

#[test]
fn instances_in_threads_give_the_same_results_as_alone() {
    let alone: Vec<_> = (0..8).map(|seed| run(&mut Slave::new(), seed)).collect();
    assert_ne!(alone[1], alone[2], "the inputs matter");
    let gate = Barrier::new(8);
    let work = |seed| {
        gate.wait();
        run(&mut Slave::new(), seed)
    };
    let together: Vec<_> = std::thread::scope(|scope| {
        let work = &work;
        let threads: Vec<_> = (0..8).map(|seed| scope.spawn(move || work(seed))).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    assert_eq!(together, alone);
}

#[test]
fn instances_are_independent() {
    let mut slaves: Vec<_> = (0..50).map(|_| Slave::new()).collect();
    for (k, slave) in (0..).zip(&mut slaves) {
        assert_eq!(slave.set(GAIN, f64::from(k)), fmi2OK);
        slave.start(0.0, None);
    }
    for k in (0..25).rev() {
        slaves.remove(2 * k);
    }
    assert_eq!(slaves[0].step(7.0, 0.1), fmi2Error);
    for (k, slave) in (0..).zip(&mut slaves) {
        assert_eq!(slave.step(0.0, 0.1), fmi2OK);
        assert_eq!(slave.get([GAIN]), [f64::from(2 * k + 1)]);
        assert_eq!(slave.messages().len(), usize::from(k == 0));
    }
}

#[test]
fn the_name_of_an_instance_is_copied() {
    let name = CString::new("fleeting").unwrap();
    let mut slave = Slave::named(&name, 0, false);
    name.into_bytes().fill(b'x');
    assert_eq!(slave.step(0.0, 0.1), fmi2Error);
    assert_eq!(&*slave.messages()[0].instance, c"fleeting");
}

#[test]
fn freed_instances_do_not_leak_memory() {
    let life = || {
        let mut slave = Slave::new();
        let now = slave.start(0.0, None).snapshot();
        assert_eq!(slave.step(0.0, 0.1), fmi2OK);
        assert_eq!(slave.step(7.0, 0.1), fmi2Error);
        assert_eq!(slave.resume(&now).step(0.0, 0.1), fmi2OK);
        assert_eq!(
            slave.deserialize(b"nonsense", &mut std::ptr::null_mut()),
            fmi2Error
        );
        assert_eq!(slave.reset(), fmi2OK);
    };
    life();
    let allocations = measure(life);
    assert_eq!(
        (allocations.bytes_current, allocations.count_current),
        (0, 0)
    );
}

#[test]
fn a_panic_in_the_destructor_is_caught() {
    let mut wide = Slave::of(WIDE);
    assert_eq!(wide.start(0.0, None).set(68, Wide::LAST_BUG), fmi2OK);
    drop(wide);
    assert_eq!(Slave::of(WIDE).start(0.0, None).step(0.0, 0.1), fmi2OK);
}
