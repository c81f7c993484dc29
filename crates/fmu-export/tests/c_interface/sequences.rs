//! Random valid and invalid calls, compared with a simple reference model of the standard.

use std::collections::HashSet;
use std::ffi::c_void;

use fmu_description::Type;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

use crate::driver::*;
use crate::models::*;
use crate::states::{lacks, row, states};

/// The expected state of an instance of [`Ball`] without drag.
#[derive(Debug, Clone)]
struct Expected {
    kind: Kind,
    /// A letter of the table of states.
    state: char,
    time: f64,
    /// By value reference: `drive`, `trouble` and `fault`.
    inputs: [f64; 3],
    h: f64,
    v: f64,
    events: f64,
    is_kicked: bool,
}

impl Expected {
    fn new(kind: Kind) -> Self {
        let (inputs, is_kicked) = ([0.0; 3], false);
        Self { kind, state: 'I', time: 0.0, inputs, h: 0.0, v: 0.0, events: 0.0, is_kicked }
    }

    /// The status of an operation by the table of states, before it computes anything.
    fn answer(&self, operation: &str, is_valid: bool) -> Status {
        let (only, letters, _) = row(self.kind.0, operation).unwrap();
        match self.state {
            _ if lacks(only, self.kind.1).is_some() => ERROR,
            '!' => FATAL,
            state if is_valid && letters.contains(state) => OK,
            _ => ERROR,
        }
    }

    /// What follows when equations or events are computed while there is trouble.
    fn compute(&mut self, trouble: f64) -> Status {
        let (state, status) = match trouble {
            BUG => ('!', FATAL),
            DISCARD | DIVERGE => (self.state, DISCARDED),
            REFUSE => (self.state, ERROR),
            BREAK => ('X', ERROR),
            _ => (self.state, OK),
        };
        self.state = state;
        status
    }

    /// Computes the start, when values are read in initialization mode or at its end. Any error is one of
    /// the initialization, which may be repeated.
    fn initialize(&mut self) -> Status {
        match self.inputs[1] {
            BUG => self.compute(BUG),
            0.0 => {
                (self.h, self.v, self.events, self.is_kicked) = (1.0, 0.0, 0.0, false);
                OK
            }
            _ => ERROR,
        }
    }

    /// Enters the state to which an operation leads.
    fn change(&mut self, operation: &str) -> Status {
        let mut answer = self.answer(operation, true);
        let has_events = self.kind.1 != Stepped;
        let next = match operation {
            "enter_initialization_mode" => 'N',
            "exit_initialization_mode" if has_events => 'E',
            "enter_event_mode" => 'E',
            "enter_continuous_time_mode" => 'C',
            "terminate" => 'T',
            _ => 'S',
        };
        if answer == OK {
            answer = match operation {
                "exit_initialization_mode" => self.initialize(),
                // Nothing is discarded here.
                "enter_step_mode" => match self.compute(self.inputs[1]) {
                    DISCARDED => ERROR,
                    other => other,
                },
                _ => OK,
            };
        }
        if answer == OK {
            self.state = next;
        }
        answer
    }

    fn event(&mut self) -> Status {
        // Only equations diverge.
        let [_, trouble, _] = self.inputs;
        let answer = self.compute(trouble * f64::from(trouble != DIVERGE));
        if answer == OK {
            self.events += 1.0;
            if self.h <= 0.0 && self.v < 0.0 {
                self.v *= -0.5;
            }
            if self.time >= Ball::KICK && !self.is_kicked {
                self.v += 1.0;
                self.is_kicked = true;
            }
        }
        answer
    }

    /// A step from the current time, which returns early at the kick.
    fn step(&mut self, gap: f64, step: f64) -> Status {
        let [drive, trouble, fault] = self.inputs;
        let answer = self.answer("do_step", gap == 0.0 && step >= 0.0 && step.is_finite());
        if answer != OK || step == 0.0 {
            return answer;
        }
        // Event mode asks for the next event first.
        if self.kind == EVENTS && trouble == BUG {
            return self.compute(BUG);
        }
        let mut end = self.time + step;
        if self.kind == EVENTS && !self.is_kicked {
            end = end.min(Ball::KICK);
        }
        if self.time > 0.15 && end > self.time && fault != DIVERGE {
            let answer = self.compute(fault);
            if answer == DISCARDED {
                self.state = 'F';
            }
            if answer != OK {
                return answer;
            }
        }
        let (acceleration, step) = (drive - Ball::G, end - self.time);
        self.h += (self.v + acceleration * step / 2.0) * step;
        self.v += acceleration * step;
        self.time = end;
        OK
    }

    /// What is computed when values are read in some states.
    fn update(&mut self, operation: &str) -> Status {
        let answer = self.answer(operation, true);
        match self.state {
            _ if answer != OK => answer,
            'N' => self.initialize(),
            'E' | 'C' => self.compute(self.inputs[1]),
            'T' if self.kind.1 == Exchanged => self.compute(self.inputs[1]),
            _ => OK,
        }
    }
}

/// A call.
#[derive(Debug, Clone)]
enum Call {
    /// An operation without other results than a new state.
    Change(&'static str),
    Update,
    Reset,
    Step(f64, f64),
    Set(u32, f64),
    Get,
    SetTime(f64),
    SetStates(f64, f64),
    Derivatives,
    Save,
    Restore(Index),
}
use Call::*;

fn call() -> impl Strategy<Value = Call> {
    let step = (
        select(vec![0.0, 0.0, 0.0, 0.0, 0.0, 2.0, f64::NAN]),
        select(vec![0.25, 0.125, 0.25, 0.0, 1.0, -0.25, f64::INFINITY]),
    );
    let number = || select(vec![0.0, 1.0, -3.5, 9.75, 20.0, f64::NAN, f64::INFINITY]);
    let trouble = (select(vec![Ball::TROUBLE, Ball::FAULT]), 0..6u8);
    prop_oneof![
        4 => Just(Change("enter_initialization_mode")),
        5 => Just(Change("exit_initialization_mode")),
        4 => Just(Change("enter_event_mode")),
        6 => Just(Change("enter_step_mode")),
        5 => Just(Change("enter_continuous_time_mode")),
        1 => Just(Change("terminate")),
        5 => Just(Update),
        1 => Just(Reset),
        10 => step.prop_map(|(gap, step)| Step(gap, step)),
        3 => number().prop_map(|value| Set(Ball::DRIVE, value)),
        1 => (0..20u32).prop_map(|reference| Set(reference, f64::NAN)),
        2 => trouble.prop_map(|(reference, value)| Set(reference, value.into())),
        1 => Just(Set(Ball::FAULT, DISCARD)),
        1 => Just(Set(Ball::FAULT, BREAK)),
        1 => Just(Set(Ball::TROUBLE, BUG)),
        2 => Just(Set(Ball::TROUBLE, BREAK)),
        3 => Just(Set(Ball::TROUBLE, 0.0)),
        5 => Just(Get),
        3 => select(vec![0.25, 0.5, 0.75, 2.0, f64::NAN]).prop_map(SetTime),
        3 => (number(), number()).prop_map(|(h, v)| SetStates(h, v)),
        3 => Just(Derivatives),
        2 => Just(Save),
        3 => any::<Index>().prop_map(Restore),
    ]
}

/// An FMU state, the expected state, and the serialized state.
type Saved = (*mut c_void, Expected, Vec<u8>);

/// Makes a call and checks the status and the values.
fn check(f: Fmu, e: &mut Expected, saved: &mut Vec<Saved>, call: &Call) {
    let kind = e.kind;
    match *call {
        Change("enter_step_mode") if kind.0 == Fmi2 => {}
        Change("enter_initialization_mode") => {
            assert_eq!(f.enter(0.0, None, None), e.change("enter_initialization_mode"));
        }
        Change(operation) => assert_eq!(f.call(operation, &[]), e.change(operation)),
        Update => {
            let (mut answer, v) = (e.answer("update_discrete_states", true), e.v);
            if answer == OK {
                answer = e.event();
            }
            let (status, result) = f.try_update();
            assert_eq!(status, answer);
            if answer == OK {
                let next = (!e.is_kicked).then_some(Ball::KICK);
                assert_eq!(result, (v != e.v, next.filter(|next| *next > e.time)));
            }
        }
        Reset => {
            let answer = e.answer("reset", true);
            assert_eq!(f.reset(), answer);
            if answer == OK {
                *e = Expected::new(kind);
            }
        }
        Step(gap, step) => {
            let time = e.time + gap;
            let answer = e.step(gap, step);
            let (status, found) = f.step_to(time, step);
            assert_eq!(status, answer);
            if kind.0 == Fmi3 && kind.1 != Exchanged {
                let is_at_kick = kind == EVENTS
                    && (answer == OK && step > 0.0)
                    && (!e.is_kicked && e.time == Ball::KICK);
                let is_early = is_at_kick && time + step > Ball::KICK;
                assert_eq!(found, results(is_at_kick, is_early, e.time));
            }
        }
        Set(reference, value) => {
            let is_valid = match reference {
                Ball::DRIVE => value.is_finite(),
                Ball::TROUBLE | Ball::FAULT => (0.0..=BUG).contains(&value),
                _ => false,
            };
            let answer = e.answer("set_float64", is_valid);
            assert_eq!(f.set(reference, value), answer);
            if answer == OK {
                e.inputs[reference as usize] = value;
            }
        }
        Get => {
            let (answer, mut values) = (e.update("get_float64"), [-7.0; 3]);
            let status = f.get_f64(&[Ball::DRIVE, Ball::H, Ball::V], &mut values);
            assert_eq!(status, answer);
            if answer == OK {
                assert_eq!(values, [e.inputs[0], e.h, e.v]);
                assert_eq!(f.read(Type::Int32, [Ball::EVENTS]), [e.events]);
                assert!(kind.0 == Fmi2 || f.get([Ball::TIME]) == [e.time]);
            } else {
                assert_eq!(values, [-7.0; 3]);
            }
        }
        SetTime(time) => {
            let answer = e.answer("set_time", time.is_finite());
            assert_eq!(f.set_time(time), answer);
            if answer == OK {
                e.time = time;
            }
        }
        SetStates(h, v) => {
            let answer = e.answer("set_continuous_states", h.is_finite() && v.is_finite());
            assert_eq!(f.set_states(&[h, v]), answer);
            if answer == OK {
                (e.h, e.v) = (h, v);
            }
        }
        Derivatives => {
            let answer = e.update("get_continuous_state_derivatives");
            let mut values = [-7.0; 2];
            assert_eq!(f.get_derivatives(&mut values), answer);
            if answer == OK && e.state != 'X' {
                assert_eq!(values, [e.v, e.inputs[0] - Ball::G]);
            }
        }
        Save => {
            let mut state = std::ptr::null_mut();
            let answer = e.answer("get_fmu_state", true);
            assert_eq!(f.get_state(&mut state), answer);
            if answer == OK {
                saved.push((state, e.clone(), f.serialize(state)));
            }
        }
        Restore(index) if !saved.is_empty() => {
            let (state, held, bytes) = &saved[index.index(saved.len())];
            let answer = e.answer("set_fmu_state", true);
            assert_eq!(f.set_state(*state), answer);
            if answer == OK {
                *e = held.clone();
                assert_eq!(&f.snapshot(), bytes);
            }
        }
        Restore(_) => {}
    }
}

/// Makes the calls in sequence; notes the states in which they were made.
fn run(kind: Kind, calls: &[Call], states: &mut HashSet<char>) {
    let it = Arguments::of(kind, BALL).make(|a| a.early_return = true);
    let (mut expected, mut saved) = (Expected::new(kind), Vec::new());
    for call in calls {
        states.insert(expected.state);
        check(*it, &mut expected, &mut saved, call);
    }
    let other = Instance::of(kind, BALL);
    for (mut state, ..) in saved {
        assert_eq!(other.free_state(&mut state), OK);
    }
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    // Half of the sequences start with those that lead to steps or to continuous time.
    let modes = ["enter_initialization_mode", "exit_initialization_mode"].map(Change);
    let modes =
        [&modes[..], &[Update], &["enter_step_mode", "enter_continuous_time_mode"].map(Change)];
    let start = [&modes.concat()[..], &[Step(0.0, 0.25)]].concat();
    let calls = prop::collection::vec(call(), 1..80);
    (any::<bool>(), calls).prop_map(move |(is_started, calls)| match is_started {
        true => [&start[..], &calls].concat(),
        false => calls,
    })
}

/// In all states but those of configuration and of callbacks.
#[test]
fn random_calls_return_the_expected_status() {
    let config = ProptestConfig { cases: 100, failure_persistence: None, ..Default::default() };
    for kind in KINDS {
        let reached = std::cell::RefCell::new(HashSet::new());
        let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
        let mut runner = TestRunner::new_with_rng(config.clone(), rng);
        let tried = runner.run(&calls(), |calls| {
            run(kind, &calls, &mut reached.borrow_mut());
            Ok(())
        });
        tried.unwrap_or_else(|error| panic!("{kind:?}: {error}"));
        let meant = states(kind).chars().filter(|state| !"GRV".contains(*state)).collect();
        assert_eq!(reached.take(), meant, "{kind:?}");
    }
}
