//! Random calls of all functions in any order. The table of states tells which are allowed, and the log tells
//! the state.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ffi::c_void;
use std::ptr::null_mut;

use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

use crate::driver::*;
use crate::models::*;
use crate::states::{call, lacks, letter, row, states};

/// What is known of an instance.
#[derive(Debug, Clone, Copy)]
struct Known {
    /// A letter of the table of states.
    state: char,
    /// The end of the last step.
    time: f64,
    /// `trouble` and `fault` of [`Ball`].
    troubles: [f64; 2],
}

const FRESH: Known = Known { state: 'I', time: 0.0, troubles: [0.0; 2] };

#[derive(Debug, Clone)]
enum Call {
    /// A function of the version, by its index.
    Any(Index),
    /// The function of an operation.
    Named(&'static str),
    /// Sets `trouble` or `fault`.
    Trouble(u32, f64),
    Save,
    Restore(Index),
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    const START: [&str; 6] = [
        "enter_initialization_mode",
        "exit_initialization_mode",
        "update_discrete_states",
        "enter_step_mode",
        "enter_continuous_time_mode",
        "do_step",
    ];
    let others = ["enter_event_mode", "enter_configuration_mode", "exit_configuration_mode"];
    let named = select([&START[..], &others].concat());
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
        let start = START.into_iter().filter(|_| is_started).map(Call::Named);
        start.chain(calls).collect()
    })
}

/// The status of a call with valid arguments; `None` if it depends on the trouble of the model.
fn expected(kind: Kind, model: usize, known: &Known, operation: &str) -> Option<Status> {
    let row = row(kind.0, operation).ok();
    let (_, letters, _) = match row.filter(|(only, ..)| lacks(*only, kind.1).is_none()) {
        Some(_) if known.state == '!' => return Some(FATAL),
        Some(row) => row,
        None => return Some(ERROR),
    };
    let is_able = match operation {
        "enter_configuration_mode" => model == SAMPLED,
        "get_directional_derivative" | "get_adjoint_derivative" => model == BALL,
        _ => true,
    };
    match letters.contains(known.state) && is_able {
        true => (known.troubles == [0.0; 2]).then_some(OK),
        false => Some(ERROR),
    }
}

/// Makes a call and checks its status; calls that are not allowed change nothing.
fn check(
    it: &Instance,
    model: usize,
    known: &mut Known,
    saved: &mut Vec<(*mut c_void, Known)>,
    made: &Call,
) {
    let (f, all) = (**it, functions(it.kind.0));
    let operation = match made {
        Call::Any(index) => index.get(all).operation,
        Call::Named(operation) => operation,
        Call::Trouble(..) => "set_float64",
        Call::Save => "get_fmu_state",
        Call::Restore(_) => "set_fmu_state",
    };
    let function = all.iter().find(|function| function.operation == operation);
    // The log is needed here.
    let Some(function) = function.filter(|_| operation != "set_debug_logging") else { return };
    let expected = expected(f.kind, model, known, operation);
    let before = (expected == Some(ERROR) && known.state != '!').then(|| f.snapshot());
    let mut next = *known;
    let status = match *made {
        _ if operation == "do_step" => {
            let (status, results) = f.step_to(known.time, 0.25);
            next.time = results.time;
            status
        }
        Call::Trouble(reference, how) if model == BALL => {
            next.troubles[(reference - Ball::TROUBLE) as usize] = how;
            f.set(reference, how)
        }
        Call::Save => {
            let mut state = null_mut();
            let status = f.get_state(&mut state);
            saved.extend((status == OK).then_some((state, *known)));
            status
        }
        Call::Restore(index) if !saved.is_empty() => {
            let (state, then) = *index.get(saved);
            next = then;
            f.set_state(state)
        }
        _ => {
            let n = row(f.kind.0, operation).map_or(0, |(_, _, n)| n);
            call(f, function, if model == BALL { n } else { 0 })
        }
    };
    assert!(expected.is_none_or(|expected| status == expected), "{operation}: {status:?}");
    assert!(before.is_none_or(|before| f.snapshot() == before), "{operation}");
    *known = match status {
        OK if operation == "reset" => FRESH,
        OK => next,
        FATAL => Known { state: '!', ..*known },
        DISCARDED if operation == "do_step" => next,
        _ => *known,
    };
    for message in it.messages() {
        if let Some(name) = message.text.strip_prefix("state: ") {
            known.state = letter(name);
        }
    }
    it.forget_messages();
}

/// Makes the calls in sequence; notes the states in which they were made.
fn run(kind: Kind, model: usize, calls: &[Call], reached: &mut BTreeSet<char>) {
    let it = Arguments::of(kind, model).make(|a| (a.early_return, a.debug) = (true, true));
    let (mut known, mut saved) = (FRESH, Vec::new());
    for call in calls {
        reached.insert(known.state);
        check(&it, model, &mut known, &mut saved, call);
    }
    let other = Instance::of(kind, model);
    for (mut state, _) in saved {
        ok([other.free_state(&mut state)]);
    }
}

#[test]
fn random_calls_are_allowed_according_to_the_table_in_every_state() {
    let config = ProptestConfig { cases: 100, failure_persistence: None, ..Default::default() };
    for kind in KINDS {
        let reached = RefCell::new(BTreeSet::new());
        for model in [BALL, SAMPLED] {
            let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
            let tried = TestRunner::new_with_rng(config.clone(), rng).run(&calls(), |calls| {
                run(kind, model, &calls, &mut reached.borrow_mut());
                Ok(())
            });
            tried.unwrap_or_else(|error| panic!("{kind:?}: {error}"));
        }
        // The two states of reconfiguration have one name.
        assert_eq!(reached.take(), states(kind).replace('V', "R").chars().collect(), "{kind:?}");
    }
}
