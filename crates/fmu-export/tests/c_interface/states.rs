//! The states in which calls are allowed: each function in each state, and random calls in any order; and how an
//! instance gets from failures to other states.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ptr::null_mut;
use std::rc::Rc;

use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

use crate::driver::*;
use crate::models::*;
use crate::standard::*;
use crate::walk::{Call, Walk, call};

/// Checks that results are never NULL, and arrays only if they are empty.
fn check_null(it: &Instance, function: &Function, n: usize) {
    let refusals = function.refusals.iter().flatten().enumerate();
    for (null, words) in refusals.filter(|(_, words)| !words.is_empty()) {
        let call = |f, n| function.call_with_zeros(f, n, Some(null));
        it.refuses(words, |f| call(f, 1));
        assert!(n > 0 || words.contains("result") || call(**it, 0) == OK);
    }
}

#[test]
fn calls_are_allowed_according_to_the_table() {
    for kind in KINDS {
        for (state, function) in
            states(kind).chars().flat_map(|state| functions(kind.0).iter().map(move |f| (state, f)))
        {
            let (mut walk, operation) = (Walk::to(kind, state), function.operation);
            println!("{operation} in {} of {kind:?}", name(state));
            let is_allowed = matches!(walk.verdict(operation), Verdict::Allowed);
            if is_allowed {
                check_null(&walk.it, function, length(operation));
            }
            assert!(walk.call(operation) == OK || !is_allowed);
        }
    }
}

/// Calls of functions that a version has, in any order.
fn calls(version: FmiVersion) -> impl Strategy<Value = Vec<Call>> {
    const START: [&str; 6] = [
        "enter_initialization_mode",
        "exit_initialization_mode",
        "update_discrete_states",
        "enter_step_mode",
        "enter_continuous_time_mode",
        "do_step",
    ];
    let others = ["enter_event_mode", "enter_configuration_mode", "exit_configuration_mode"];
    let is_there = move |operation: &&str| version.function(operation).is_some();
    let named = select(Vec::from_iter(START.into_iter().chain(others).filter(is_there)));
    let trouble = (select(vec![Ball::TROUBLE, Ball::FAULT]), 0..6u8);
    let one = prop_oneof![
        10 => any::<Index>().prop_map(Call::Any),
        20 => named.prop_map(Call::Named),
        4 => Just(Call::Named("do_step")),
        2 => trouble.prop_map(|(reference, how)| Call::Trouble(reference, how.into())),
        4 => Just(Call::Trouble(Ball::TROUBLE, 0.0)),
        2 => Just(Call::Save),
        3 => any::<Index>().prop_map(Call::Restore),
    ];
    // Half of the sequences start with those that lead to steps or to continuous time.
    (any::<bool>(), prop::collection::vec(one, 1..80)).prop_map(move |(is_started, calls)| {
        let start = START.into_iter().filter(is_there).filter(|_| is_started).map(Call::Named);
        start.chain(calls).collect()
    })
}

#[test]
fn random_calls_are_allowed_according_to_the_table_in_every_state() {
    let config = ProptestConfig { failure_persistence: None, ..Default::default() };
    for kind in KINDS {
        let reached = RefCell::new(BTreeSet::new());
        for model in [BALL, SAMPLED] {
            let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
            let tried =
                TestRunner::new_with_rng(config.clone(), rng).run(&calls(kind.0), |calls| {
                    let mut walk = Walk::new(kind, model);
                    for call in &calls {
                        reached.borrow_mut().insert(walk.state());
                        walk.make(call);
                    }
                    Ok(())
                });
            tried.unwrap_or_else(|error| panic!("{kind:?}: {error}"));
        }
        assert_eq!(reached.take(), states(kind).chars().collect(), "{kind:?}");
    }
}

#[test]
fn calls_in_an_intermediate_update_are_allowed_according_to_the_table() {
    for kind in [(Fmi3, Stepped), EVENTS] {
        let new = || {
            let variables = &[Ball::DRIVE, Ball::H];
            let it = Arguments::new(kind, BALL).make(|a| a.intermediate = Some(variables));
            it.run(0.0)
        };
        let plain = new();
        plain.steps(0.0, 0.25);
        for function in functions(Fmi3) {
            let operation = function.operation;
            let Some(is_allowed) = is_allowed_in_update(operation) else { continue };
            println!("{operation} in an intermediate update of {kind:?}");
            let (it, statuses) = (new(), Rc::new(RefCell::new(Vec::new())));
            let answers = statuses.clone();
            it.on_update(move |fmu, _| {
                answers.borrow_mut().push(call(fmu, function, length(operation)));
                None
            });
            assert_eq!(it.steps(0.0, 0.25), results(false, false, 0.25));
            let expected = if is_allowed { OK } else { ERROR };
            assert_eq!(*statuses.borrow(), [expected; 3]);
            assert_eq!(it.snapshot(), plain.snapshot(), "nothing changed");
        }
    }
}

#[test]
fn the_tests_know_all_functions() {
    for (version, count) in [(Fmi2, 44), (Fmi3, 75)] {
        let all = version.functions().iter();
        let is_free = |(_, operation): &&(_, &str)| has(FREE, operation);
        let (free, others): (Vec<_>, Vec<_>) = all.partition(is_free);
        assert_eq!(free.len() + others.len(), count);
        let others = others.iter().map(|(_, operation)| *operation);
        let known = functions(version).iter().map(|function| function.operation);
        assert!(known.eq(others));
    }
}

#[test]
fn a_null_instance_is_an_error_and_can_be_freed() {
    for version in [Fmi2, Fmi3] {
        let (kind, c) = ((version, Stepped), null_mut());
        let null = Fmu { kind, c };
        let mut functions = functions(version).iter();
        assert!(functions.all(|function| call(null, function, 0) == ERROR));
        null.free();
    }
}

/// A call of a function that runs code of the model.
type ModelCall = fn(Fmu) -> Status;

/// Every call that runs code of the model.
#[test]
fn a_panic_is_caught_and_affects_its_instance_only() {
    let other = Instance::running(PLAIN[0], BALL);
    let calls: [(char, &[Kind], ModelCall); 12] = [
        ('N', &KINDS, Fmu::exit_initialization_mode),
        ('N', &KINDS, |f| f.get_f64(&[Ball::H], &mut [0.0])),
        ('S', &PLAIN, |f| f.get_f64(&[Ball::V_DOT], &mut [0.0])),
        ('S', &PLAIN, |f| f.slope(Ball::V_DOT, Ball::DRIVE, 1.0)),
        ('S', &PLAIN, |f| f.slopes(&[(Ball::H, 1)])),
        ('S', &[EVENTS], |f| f.step(0.25, 0.5)),
        ('E', &KINDS[2..], |f| f.try_update().0),
        ('E', &KINDS[2..], |f| f.get_i32(&[Ball::EVENTS], &mut [0])),
        ('C', &EXCHANGED, |f| f.get_derivatives(&mut [0.0; 2])),
        ('C', &EXCHANGED, |f| f.get_indicators(&mut [])),
        ('C', &EXCHANGED, |f| f.get_states(&mut [0.0; 2])),
        ('C', &EXCHANGED, |f| f.slope(Ball::ENERGY, Ball::H, 1.0)),
    ];
    for (state, kinds, call) in calls {
        for &kind in kinds {
            let Walk { it, .. } = &Walk::to(kind, state);
            assert_eq!(it.set(Ball::TROUBLE, BUG), OK);
            assert_eq!(call(**it), FATAL);
            it.says("the model panicked; the instance can only be freed: the bug");
            let message = it.messages().pop().unwrap();
            assert_eq!(message.kind(), ("logStatusFatal", FATAL));
            assert_eq!(it.reset(), FATAL);
            let mut value = [7.0];
            assert_eq!(it.get_f64(&[Ball::DRIVE], &mut value), FATAL);
            assert_eq!((value, other.set(Ball::DRIVE, 1.0)), ([7.0], OK));
        }
    }
}
