//! Random valid and invalid calls, compared with a simple reference model of the standard.

use std::collections::HashSet;
use std::ffi::c_void;

use fmu_description::Type;
use proptest::prelude::*;
use proptest::sample::{Index, select};

use fmu_export::abi::state::State::{self, *};

use crate::driver::*;
use crate::models::*;
use crate::states::{name, states};

/// The expected state of an instance of [`Ball`] without drag.
#[derive(Debug, Clone)]
struct Expected {
    kind: Kind,
    state: State,
    time: f64,
    drive: f64,
    trouble: f64,
    fault: f64,
    h: f64,
    v: f64,
    events: i32,
    is_kicked: bool,
}

impl Expected {
    fn new(kind: Kind) -> Self {
        Self {
            kind,
            state: Instantiated,
            time: 0.0,
            drive: 0.0,
            trouble: 0.0,
            fault: 0.0,
            h: 0.0,
            v: 0.0,
            events: 0,
            is_kicked: false,
        }
    }

    /// The status of a call that is allowed in `states`, if the arguments are valid and the kind has it.
    fn answer(&self, has: bool, states: &[State], valid: bool) -> Status {
        match self.state {
            _ if !has => ERROR,
            Fatal => FATAL,
            state if valid && states.contains(&state) => OK,
            _ => ERROR,
        }
    }

    fn change(&mut self, has: bool, from: &[State], to: State) -> Status {
        let answer = self.answer(has, from, true);
        if answer == OK {
            self.state = to;
        }
        answer
    }

    /// What follows when equations or events are computed while there is trouble.
    fn compute(&mut self, trouble: f64) -> Status {
        let (state, status) = match trouble {
            BUG => (Fatal, FATAL),
            DISCARD | DIVERGE => (self.state, DISCARDED),
            REFUSE => (self.state, ERROR),
            BREAK => (State::Error, ERROR),
            _ => (self.state, OK),
        };
        self.state = state;
        status
    }

    /// Computes the start, when values are read in initialization mode or at its end. Any error is one of
    /// the initialization, which may be repeated.
    fn initialize(&mut self) -> Status {
        match self.trouble {
            BUG => self.compute(BUG),
            0.0 => {
                (self.h, self.v, self.events, self.is_kicked) = (1.0, 0.0, 0, false);
                OK
            }
            _ => ERROR,
        }
    }

    fn event(&mut self) -> Status {
        // Only equations diverge.
        let answer = self.compute(self.trouble * f64::from(self.trouble != DIVERGE));
        if answer == OK {
            self.events += 1;
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
        let is_valid = gap == 0.0 && step >= 0.0 && step.is_finite();
        let answer = self.answer(self.kind.1 != Exchanged, &[StepMode], is_valid);
        if answer != OK || step == 0.0 {
            return answer;
        }
        // Event mode asks for the next event first.
        if self.kind == EVENTS && self.trouble == BUG {
            return self.compute(BUG);
        }
        let mut end = self.time + step;
        if self.kind == EVENTS && !self.is_kicked && self.time < Ball::KICK {
            end = end.min(Ball::KICK);
        }
        if self.time > 0.15 {
            match self.fault {
                DIVERGE => {}
                DISCARD => {
                    self.state = StepFailed;
                    return DISCARDED;
                }
                fault if fault != 0.0 => return self.compute(fault),
                _ => {}
            }
        }
        let (acceleration, step) = (self.drive - Ball::G, end - self.time);
        self.h += (self.v + acceleration * step / 2.0) * step;
        self.v += acceleration * step;
        self.time = end;
        OK
    }

    fn set(&mut self, reference: u32, value: f64) -> Status {
        let is_valid = match reference {
            Ball::DRIVE => value.is_finite(),
            Ball::TROUBLE | Ball::FAULT => (0.0..=BUG).contains(&value),
            _ => false,
        };
        let states = [Instantiated, Initialization, Event, ContinuousTime, StepMode];
        let answer = self.answer(true, &states, is_valid);
        match reference {
            _ if answer != OK => {}
            Ball::DRIVE => self.drive = value,
            Ball::TROUBLE => self.trouble = value,
            _ => self.fault = value,
        }
        answer
    }

    /// What is computed when values are read in some states.
    fn update(&mut self) -> Status {
        match self.state {
            Fatal => FATAL,
            Initialization => self.initialize(),
            Event | ContinuousTime => self.compute(self.trouble),
            Terminated if self.kind.1 == Exchanged => self.compute(self.trouble),
            Instantiated if self.kind.0 == Fmi2 => ERROR,
            _ => OK,
        }
    }
}

/// A call.
#[derive(Debug, Clone)]
enum Call {
    Enter,
    Exit,
    EnterEvent,
    Update,
    EnterStep,
    EnterContinuous,
    Terminate,
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

fn call() -> impl Strategy<Value = Call> {
    use Call::*;
    let step = (
        select(vec![0.0, 0.0, 0.0, 0.0, 0.0, 2.0, f64::NAN]),
        select(vec![0.25, 0.125, 0.25, 0.0, 1.0, -0.25, f64::INFINITY]),
    );
    let number = || select(vec![0.0, 1.0, -3.5, 9.75, 20.0, f64::NAN, f64::INFINITY]);
    let trouble = (select(vec![Ball::TROUBLE, Ball::FAULT]), 0..6u8);
    prop_oneof![
        4 => Just(Enter),
        5 => Just(Exit),
        4 => Just(EnterEvent),
        5 => Just(Update),
        6 => Just(EnterStep),
        5 => Just(EnterContinuous),
        1 => Just(Terminate),
        1 => Just(Reset),
        10 => step.prop_map(|(gap, step)| Step(gap, step)),
        3 => number().prop_map(|value| Set(Ball::DRIVE, value)),
        1 => (0..20u32).prop_map(|reference| Set(reference, f64::NAN)),
        2 => trouble.prop_map(|(reference, value)| Set(reference, value.into())),
        1 => Just(Set(Ball::FAULT, DISCARD)),
        1 => Just(Set(Ball::FAULT, BREAK)),
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
    let (kind, is_exchange) = (e.kind, e.kind.1 == Exchanged);
    let alive = e.answer(true, &[e.state], e.state != Fatal);
    let (has_step_mode, has_events) = (kind == EVENTS, kind.1 != Stepped);
    match call {
        Call::Enter => {
            let answer = e.change(true, &[Instantiated], Initialization);
            assert_eq!(f.enter(0.0, None, None), answer);
        }
        Call::Exit => {
            let mut answer = e.answer(true, &[Initialization], true);
            if answer == OK {
                answer = e.initialize();
            }
            if answer == OK {
                e.state = if has_events { Event } else { StepMode };
            }
            assert_eq!(f.exit_initialization_mode(), answer);
        }
        Call::EnterEvent => {
            let first = if kind.0 == Fmi2 { Event } else { StepMode };
            let answer = e.change(has_events, &[first, ContinuousTime], Event);
            assert_eq!(f.enter_event_mode(), answer);
        }
        Call::Update => {
            let mut answer = e.answer(has_events || kind.0 == Fmi3, &[Event], true);
            let v = e.v;
            if answer == OK {
                answer = e.event();
            }
            let mut result = (false, None);
            assert_eq!(f.try_update(&mut result), answer);
            if answer == OK {
                let next = (!e.is_kicked).then_some(Ball::KICK);
                let next = next.filter(|next| *next > e.time);
                assert_eq!(result, (v != e.v, next));
            }
        }
        Call::EnterStep if kind.0 == Fmi2 => {}
        Call::EnterStep => {
            let mut answer = e.answer(!is_exchange, &[Event], true);
            if answer == OK {
                // Nothing is discarded here.
                answer = match e.compute(e.trouble) {
                    DISCARDED => ERROR,
                    other => other,
                };
            }
            if answer == OK {
                assert!(has_step_mode);
                e.state = StepMode;
            }
            assert_eq!(f.enter_step_mode(), answer);
        }
        Call::EnterContinuous => {
            let answer = e.change(is_exchange, &[Event], ContinuousTime);
            assert_eq!(f.enter_continuous_time_mode(), answer);
        }
        Call::Terminate => {
            let answer = e.change(true, &[Event, ContinuousTime, StepMode, StepFailed], Terminated);
            assert_eq!(f.terminate(), answer);
        }
        Call::Reset => {
            assert_eq!(f.reset(), alive);
            if alive == OK {
                *e = Expected::new(kind);
            }
        }
        &Call::Step(gap, step) => {
            let time = e.time + gap;
            let answer = e.step(gap, step);
            let (status, results) = f.step_to(time, step);
            assert_eq!(status, answer);
            if kind.0 == Fmi3 && !is_exchange {
                assert_eq!(results.time, e.time);
                let is_at_kick = answer == OK
                    && step > 0.0
                    && kind == EVENTS
                    && !e.is_kicked
                    && e.time == Ball::KICK
                    && time < Ball::KICK;
                assert_eq!(results.event, is_at_kick);
                assert_eq!(results.early, is_at_kick && time + step > Ball::KICK);
            }
        }
        &Call::Set(reference, value) => {
            assert_eq!(f.set(reference, value), e.set(reference, value));
        }
        Call::Get => {
            let answer = e.update();
            let mut values = [-7.0; 3];
            let status = f.get_f64(&[Ball::DRIVE, Ball::H, Ball::V], &mut values);
            assert_eq!(status, answer);
            if answer == OK {
                assert_eq!(values, [e.drive, e.h, e.v]);
                let [events] = f.read(Type::Int32, [Ball::EVENTS]);
                assert_eq!(events, f64::from(e.events));
                assert!(kind.0 == Fmi2 || f.get([Ball::TIME]) == [e.time]);
            } else {
                assert_eq!(values, [-7.0; 3]);
            }
        }
        &Call::SetTime(time) => {
            let answer = e.answer(is_exchange, &[Event, ContinuousTime], time.is_finite());
            assert_eq!(f.set_time(time), answer);
            if answer == OK {
                e.time = time;
            }
        }
        &Call::SetStates(h, v) => {
            let are_finite = h.is_finite() && v.is_finite();
            let allowed = match kind.0 {
                Fmi2 => &[Event, ContinuousTime][..],
                Fmi3 => &[ContinuousTime],
            };
            let answer = e.answer(is_exchange, allowed, are_finite);
            assert_eq!(f.set_states(&[h, v]), answer);
            if answer == OK {
                (e.h, e.v) = (h, v);
            }
        }
        Call::Derivatives => {
            let states = [Initialization, Event, ContinuousTime, Terminated, State::Error];
            let mut answer = e.answer(is_exchange, &states, true);
            if answer == OK {
                answer = e.update();
            }
            let mut values = [-7.0; 2];
            assert_eq!(f.get_derivatives(&mut values), answer);
            if answer == OK && e.state != State::Error {
                assert_eq!(values, [e.v, e.drive - Ball::G]);
            }
        }
        Call::Save => {
            let mut state = std::ptr::null_mut();
            assert_eq!(f.get_state(&mut state), alive);
            if alive == OK {
                saved.push((state, e.clone(), f.serialize(state)));
            }
        }
        Call::Restore(index) => {
            if !saved.is_empty() {
                let (state, held, bytes) = &saved[index.index(saved.len())];
                assert_eq!(f.set_state(*state), alive);
                if alive == OK {
                    *e = held.clone();
                    assert_eq!(&f.snapshot(), bytes);
                }
            }
        }
    }
}

/// Makes the calls in sequence; returns the states in which they were made.
fn run(kind: Kind, calls: &[Call]) -> Vec<State> {
    let it = Arguments::of(kind, BALL).make(|a| a.early_return = true);
    let (mut expected, mut saved, mut states) = (Expected::new(kind), Vec::new(), Vec::new());
    for call in calls {
        states.push(expected.state);
        check(*it, &mut expected, &mut saved, call);
    }
    let other = Instance::of(kind, BALL);
    for (mut state, ..) in saved {
        assert_eq!(other.free_state(&mut state), OK);
    }
    states
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    use Call::*;
    // Half of the sequences start with those that lead to steps or to continuous time.
    let modes = [Enter, Exit, Update, EnterStep, EnterContinuous];
    let step = [Step(0.0, 0.25)];
    let calls = prop::collection::vec(call(), 1..80);
    (any::<bool>(), calls).prop_map(move |(is_started, calls)| match is_started {
        true => [&modes[..], &step, &calls].concat(),
        false => calls,
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_calls_return_the_expected_status(kind in select(KINDS.to_vec()), calls in calls()) {
        run(kind, &calls);
    }
}

/// Ensures that the test above covers all states but those of configuration and of callbacks.
#[test]
fn the_calls_reach_every_state() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    for kind in KINDS {
        let reached: HashSet<&str> = (0..100)
            .flat_map(|_| run(kind, &calls().new_tree(&mut runner).unwrap().current()))
            .map(State::name)
            .collect();
        for letter in states(kind).chars().filter(|letter| !"GRV".contains(*letter)) {
            assert!(reached.contains(name(letter)), "{letter} of {kind:?}: {reached:?}");
        }
    }
}
