//! Samples and steps do not allocate memory, so they can run without a heap.

use pendulum_control::closed_loop::{TS, ipid_rbf, pid, pid_rbf};
use pendulum_control::pid::Integral;
use pendulum_control::plant::{Linear, Parameters, State, TransferFunction, nonlinear};
use pendulum_control::{Target, signal};

fn allocations(work: impl FnOnce()) -> u64 {
    allocation_counter::measure(work).count_total
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(Box::new(1)))), 1);
}

#[test]
fn controllers_do_not_allocate() {
    let mut pid = pid(Integral::Sum, true);
    let mut pid_rbf = pid_rbf(true, [0.0; 4]);
    let mut ipid_rbf = ipid_rbf(Target::Supervisor, [0.0; 4]);
    let counted = allocations(|| {
        for k in 0..100 {
            let time = f64::from(k) * TS;
            let r = signal::sine(0.2, time) + signal::square(0.1, time);
            pid.sample(r, 0.1, 0.0);
            pid_rbf.sample(r, 0.1, 0.0);
            ipid_rbf.sample(r, 0.1, 0.0, pid_rbf.pid.u);
        }
    });
    assert_eq!(counted, 0);
}

#[test]
fn plants_do_not_allocate_even_when_the_step_changes() {
    let p = Parameters::PAPER;
    let counted = allocations(|| {
        let mut state = State::default();
        let mut linear = Linear::new(&p);
        let mut difference = TransferFunction::new(&p, TS, state);
        for k in 1..100 {
            linear.advance(&mut state, 1.0, f64::from(k) * 1e-4);
            nonlinear::advance(&p, &mut state, 1.0, 1e-3).unwrap();
            difference.advance(1.0);
        }
    });
    assert_eq!(counted, 0);
}
