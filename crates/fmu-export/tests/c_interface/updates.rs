//! Intermediate updates of FMI 3.0: when the host is called in a step, and what it may do there.

use std::cell::RefCell;
use std::rc::Rc;

use crate::driver::*;
use crate::models::*;

const NAN: f64 = f64::NAN;
const INFINITE: f64 = f64::INFINITY;

/// A ball in step mode, with the callback for these variables; the step of its default experiment is 0.1 s.
pub fn updating(kind: Kind, early_return: bool, variables: &[u32]) -> Instance {
    let (intermediate, arguments) = (Some(variables), Arguments::new(kind, BALL));
    let it = arguments.make(|a| (a.early_return, a.intermediate) = (early_return, intermediate));
    it.run(0.0)
}

#[test]
fn the_host_is_called_at_equal_parts_of_the_step() {
    for kind in [PLAIN[1], EVENTS] {
        let it = updating(kind, true, &[Ball::H]);
        it.steps(0.0, 0.25);
        let expected = [1, 2, 3].map(|k| Intermediate {
            time: 0.25 * (f64::from(k) / 3.0),
            set_requested: k < 3,
            get_allowed: true,
            step_finished: true,
            can_return: k < 3,
        });
        assert_eq!(it.host.updates.take(), expected);
        it.steps(0.25, 0.1);
        assert_eq!(it.update_times(), [0.25 + 0.1]);
        // Without early return, an event changes nothing.
        let it = updating(kind, false, &[]);
        it.steps(0.0, 0.25);
        it.update_times();
        it.steps(0.25, 0.5);
        near(it.update_times()[..4].try_into().unwrap(), [0.35, 0.45, 0.55, 0.65], 1e-9);
    }
    let (intermediate, arguments) = (Some(&[][..]), Arguments::new(PLAIN[1], SAMPLED));
    let sampled = arguments.make(|a| a.intermediate = intermediate).run(0.0);
    sampled.steps(0.0, 2.0);
    let times = sampled.update_times();
    assert!(times.is_empty(), "providesIntermediateUpdate is false");
}

#[test]
fn the_host_reads_outputs_and_sets_inputs_at_internal_points() {
    let it = updating(PLAIN[1], false, &[Ball::DRIVE, Ball::H, Ball::V]);
    let rows = Rc::new(RefCell::new(Vec::new()));
    let found = rows.clone();
    it.on_update(move |f, _| {
        let [h, v] = f.get([Ball::H, Ball::V]);
        let slopes = f.two(|f, to| f.get_output_derivatives(&[Ball::H, Ball::V], &[1, 1], to));
        found.borrow_mut().push([h, v, slopes[0] - v, slopes[1]]);
        ok([f.set(Ball::DRIVE, 2.0 * Ball::G)]);
        None
    });
    it.steps(0.0, 0.2);
    // Falls for 0.1 s, and is then accelerated upwards for 0.1 s.
    let g = Ball::G;
    let (rows, height) = (rows.borrow(), 1.0 - g * 0.005);
    near(rows[0], [height, -g * 0.1, 0.0, -g], 1e-12);
    near(rows[1], [1.0 - g * 0.01, 0.0, 0.0, g], 1e-12);
    assert_eq!((rows.len(), it.get([Ball::DRIVE])), (2, [2.0 * g]));
}

/// The status of a call in the first update of a step.
fn in_update(variables: &[u32], call: impl Fn(Fmu) -> Status + 'static) -> (Status, Instance) {
    let it = updating(PLAIN[1], false, variables);
    let status = Rc::new(RefCell::new(None));
    let found = status.clone();
    it.on_update(move |f, _| {
        found.borrow_mut().get_or_insert_with(|| call(f));
        None
    });
    it.steps(0.0, 0.2);
    (status.take().unwrap(), it)
}

#[test]
fn only_announced_continuous_variables_are_accessible_in_an_update() {
    const DRIVE: u32 = Ball::DRIVE;
    const PART: u32 = Ball::RESTITUTION;
    let announced = [DRIVE, Ball::H, PART, Ball::SWITCH];
    const REQUIRED: &str = "only the required intermediate variables";
    type Call = fn(Fmu) -> Status;
    let calls: [(&str, Call); 5] = [
        (REQUIRED, |f| f.get_f64(&[Ball::H, Ball::V], &mut [0.0; 2])),
        (REQUIRED, |f| f.set_f64(&[DRIVE, Ball::TROUBLE], &[0.0; 2])),
        (REQUIRED, |f| f.slopes(&[(Ball::V, 1)])),
        ("restitution is not a continuous", |f| f.set(PART, 0.5)),
        ("drive = NaN is refused", |f| f.set(DRIVE, NAN)),
    ];
    let untouched = updating(PLAIN[1], false, &[]);
    untouched.steps(0.0, 0.2);
    for (words, call) in calls {
        let (status, it) = in_update(&announced, call);
        it.says(words);
        assert_eq!((status, it.snapshot()), (ERROR, untouched.snapshot()));
    }
    ok([
        in_update(&announced, |f| f.get_f64(&[Ball::H, PART], &mut [0.0; 2])).0,
        in_update(&announced, |f| f.get_i32(&[Ball::SWITCH], &mut [0])).0,
    ]);
    // After the callback, all variables are accessible again.
    assert_eq!(untouched.get([Ball::V]), [-Ball::G * 0.1 - Ball::G * 0.1]);
    // A discarded evaluation is refused, and the step goes on.
    let (status, it) = in_update(&[Ball::TROUBLE, Ball::V_DOT], |f| {
        ok([f.set(Ball::TROUBLE, DISCARD)]);
        let status = f.get_f64(&[Ball::V_DOT], &mut [0.0]);
        ok([f.set(Ball::TROUBLE, 0.0)]);
        status
    });
    assert_eq!((status, it.get([Ball::TIME])), (ERROR, [0.2]));
    it.says("discarded by the model");
}

#[test]
fn the_host_may_request_an_early_return() {
    for (kind, request, expected) in [
        (PLAIN[1], 0.0, 0.1),
        (PLAIN[1], 0.1, 0.1),
        (PLAIN[1], 0.13, 0.13),
        (EVENTS, 0.35, 0.35),
        (PLAIN[1], -INFINITE, 0.4),
        (PLAIN[1], NAN, 0.4),
        (EVENTS, 7.0, 0.4),
    ] {
        let it = updating(kind, true, &[]);
        it.on_update(move |_, update| update.can_return.then_some(request));
        let end = results(false, expected < 0.4, expected);
        assert_eq!(it.steps(0.0, 0.4), end, "{request}");
        assert_eq!(it.get([Ball::TIME]), [expected]);
        let last = it.update_times().pop();
        assert_eq!(last, Some(expected), "at the end");
        // It continues there, also from a saved state.
        let bytes = it.snapshot();
        it.on_update(|_, _| None);
        let after = [(); 2].map(|()| {
            it.resume(&bytes).steps(expected, 0.1);
            it.snapshot()
        });
        assert_eq!(after[0], after[1]);
        assert_eq!(it.get([Ball::TIME]), [expected + 0.1]);
    }
    let it = updating(PLAIN[1], false, &[]);
    it.on_update(|_, update| Some(0.1).filter(|_| !update.can_return));
    // It is not allowed.
    assert_eq!(it.steps(0.0, 0.4), results(false, false, 0.4));
    let it = updating(EVENTS, true, &[]);
    it.on_update(|_, update| update.can_return.then_some(Ball::KICK));
    let end = results(true, true, Ball::KICK);
    assert_eq!(it.steps(0.0, 1.0), end, "an event there");
}

#[test]
fn a_panic_or_an_error_in_a_callback_ends_the_step() {
    let cases = [(BUG, FATAL, FATAL), (BREAK, ERROR, OK)];
    for (kind, (trouble, status, next)) in pairs(&[PLAIN[1], EVENTS], &cases) {
        let it = updating(kind, false, &[Ball::TROUBLE, Ball::V_DOT]);
        it.on_update(move |f, update| {
            if update.time < 0.15 {
                ok([f.set(Ball::TROUBLE, trouble)]);
                assert_eq!(f.get_f64(&[Ball::V_DOT], &mut [0.0]), status);
            }
            None
        });
        let (found, results) = it.step_to(0.0, 0.4);
        assert_eq!((found, results.time), (status, 0.1));
        assert_eq!(it.update_times(), [0.1]);
        assert_eq!((it.step(0.1, 0.1), it.reset()), (status, next));
    }
}
