//! Random valid and invalid calls, compared with a simple reference model of the standard.

use fmu_export::fmi3::fmi3FMUState;
use fmu_export::fmi3::{fmi3Discard, fmi3Error, fmi3Fatal, fmi3OK, fmi3Status};
use proptest::prelude::*;
use proptest::sample::{Index, select};

use super::host::{Arguments, Fmu, Instance, Kind, Kind::*};
use crate::host::guid;
use crate::models::*;

#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Instantiated,
    Initialization,
    Event,
    Continuous,
    Step,
    Failed,
    Terminated,
    Error,
    Fatal,
}
use State::*;

const ALIVE: [State; 8] = [
    Instantiated,
    Initialization,
    Event,
    Continuous,
    Step,
    Failed,
    Terminated,
    State::Error,
];

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
    kicked: bool,
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
            kicked: false,
        }
    }

    /// The status of a call that is allowed in `states`, if its arguments are valid.
    fn answer(&self, states: &[State], valid: bool) -> fmi3Status {
        match self.state {
            Fatal => fmi3Fatal,
            state if valid && states.contains(&state) => fmi3OK,
            _ => fmi3Error,
        }
    }

    fn change(&mut self, from: &[State], to: State) -> fmi3Status {
        let answer = self.answer(from, true);
        if answer == fmi3OK {
            self.state = to;
        }
        answer
    }

    /// The status of a call of one kind only.
    fn of_kind(&mut self, is_mine: bool, from: &[State], to: State) -> fmi3Status {
        match is_mine {
            true => self.change(from, to),
            false => fmi3Error,
        }
    }

    /// What follows when equations or events are computed while there is trouble.
    fn compute(&mut self) -> fmi3Status {
        match self.trouble {
            PANIC => {
                self.state = Fatal;
                fmi3Fatal
            }
            DISCARD | DIVERGE => fmi3Discard,
            REFUSE => fmi3Error,
            BREAK => {
                self.state = State::Error;
                fmi3Error
            }
            _ => fmi3OK,
        }
    }

    /// Computes the start, when values are read in initialization mode or at its end. Any error is one of
    /// the initialization, which may be repeated.
    fn initialize(&mut self) -> fmi3Status {
        match self.trouble {
            PANIC => self.compute(),
            0.0 => {
                (self.h, self.v, self.events, self.kicked) = (1.0, 0.0, 0, false);
                fmi3OK
            }
            _ => fmi3Error,
        }
    }

    fn event(&mut self) -> fmi3Status {
        // Only equations diverge.
        let answer = match self.trouble {
            DIVERGE => fmi3OK,
            _ => self.compute(),
        };
        if answer == fmi3OK {
            self.events += 1;
            if self.h <= 0.0 && self.v < 0.0 {
                self.v *= -0.5;
            }
            if self.time >= Ball::KICK && !self.kicked {
                self.v += 1.0;
                self.kicked = true;
            }
        }
        answer
    }

    fn fall(&mut self, step: f64) {
        let acceleration = self.drive - Ball::G;
        self.h += (self.v + acceleration * step / 2.0) * step;
        self.v += acceleration * step;
    }

    /// A step from the current time, which returns early at the kick.
    fn step(&mut self, gap: f64, step: f64) -> fmi3Status {
        if self.kind == ModelExchange {
            return fmi3Error;
        }
        let answer = self.answer(&[Step], gap == 0.0 && step >= 0.0 && step.is_finite());
        if answer != fmi3OK || step == 0.0 {
            return answer;
        }
        // Event mode asks for the next event first.
        if self.kind == Events && self.trouble == PANIC {
            return self.compute();
        }
        let mut end = self.time + step;
        if self.kind == Events && !self.kicked && self.time < Ball::KICK {
            end = end.min(Ball::KICK);
        }
        if self.time > 0.15 {
            match self.fault {
                PANIC => self.state = Fatal,
                DISCARD => self.state = Failed,
                BREAK => self.state = State::Error,
                _ => {}
            }
            match self.fault {
                PANIC => return fmi3Fatal,
                DISCARD => return fmi3Discard,
                BREAK | REFUSE => return fmi3Error,
                _ => {}
            }
        }
        self.fall(end - self.time);
        self.time = end;
        fmi3OK
    }

    fn set(&mut self, reference: u32, value: f64) -> fmi3Status {
        let valid = match reference {
            Ball::DRIVE => value.is_finite(),
            Ball::TROUBLE | Ball::FAULT => (0.0..=PANIC).contains(&value),
            _ => false,
        };
        let states = [Instantiated, Initialization, Event, Continuous, Step];
        let answer = self.answer(&states, valid);
        if answer == fmi3OK {
            match reference {
                Ball::DRIVE => self.drive = value,
                Ball::TROUBLE => self.trouble = value,
                _ => self.fault = value,
            }
        }
        answer
    }

    /// What is computed when values are read in some states.
    fn update(&mut self) -> fmi3Status {
        match self.state {
            Fatal => fmi3Fatal,
            Initialization => self.initialize(),
            Event | Continuous => self.compute(),
            Terminated if self.kind == ModelExchange => self.compute(),
            _ => fmi3OK,
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
    Configure,
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
        3 => Just(Set(Ball::TROUBLE, 0.0)),
        5 => Just(Get),
        3 => select(vec![0.25, 0.5, 0.75, 2.0, f64::NAN]).prop_map(SetTime),
        3 => (number(), number()).prop_map(|(h, v)| SetStates(h, v)),
        3 => Just(Derivatives),
        2 => Just(Save),
        3 => any::<Index>().prop_map(Restore),
        1 => Just(Configure),
    ]
}

/// An FMU state, the expected state, and the serialized state.
type Saved = (fmi3FMUState, Expected, Vec<u8>);

/// Makes a call and checks the status and the values.
fn check(fmu: Fmu, expected: &mut Expected, saved: &mut Vec<Saved>, call: &Call) {
    let (kind, is_exchange) = (expected.kind, expected.kind == ModelExchange);
    let alive = expected.answer(&ALIVE, true);
    match call {
        Call::Enter => {
            let answer = expected.change(&[Instantiated], Initialization);
            assert_eq!(fmu.enter_initialization_mode(0.0, None), answer);
        }
        Call::Exit => {
            let mut answer = expected.answer(&[Initialization], true);
            if answer == fmi3OK {
                answer = expected.initialize();
            }
            if answer == fmi3OK {
                expected.state = if kind == CoSimulation { Step } else { Event };
            }
            assert_eq!(fmu.exit_initialization_mode(), answer);
        }
        Call::EnterEvent => {
            let answer = expected.of_kind(kind != CoSimulation, &[Step, Continuous], Event);
            assert_eq!(fmu.enter_event_mode(), answer);
        }
        Call::Update => {
            let mut answer = expected.answer(&[Event], true);
            let v = expected.v;
            if answer == fmi3OK {
                answer = expected.event();
            }
            let mut result = (false, None);
            assert_eq!(fmu.try_update(&mut result), answer);
            if answer == fmi3OK {
                let next = (!expected.kicked).then_some(Ball::KICK);
                let changed = v != expected.v;
                assert_eq!(result, (changed, next.filter(|next| *next > expected.time)));
            }
        }
        Call::EnterStep => {
            let mut answer = match is_exchange {
                true => fmi3Error,
                false => expected.answer(&[Event], true),
            };
            if answer == fmi3OK {
                // Nothing is discarded here.
                answer = match expected.compute() {
                    fmi3Discard => fmi3Error,
                    other => other,
                };
            }
            if answer == fmi3OK {
                expected.state = Step;
            }
            assert_eq!(fmu.enter_step_mode(), answer);
        }
        Call::EnterContinuous => {
            let answer = expected.of_kind(is_exchange, &[Event], Continuous);
            assert_eq!(fmu.enter_continuous_time_mode(), answer);
        }
        Call::Terminate => {
            let running = [Event, Continuous, Step, Failed];
            assert_eq!(fmu.terminate(), expected.change(&running, Terminated));
        }
        Call::Reset => {
            assert_eq!(fmu.reset(), alive);
            if alive == fmi3OK {
                *expected = Expected::new(kind);
            }
        }
        &Call::Step(gap, step) => {
            let time = expected.time + gap;
            let answer = expected.step(gap, step);
            let (status, results) = fmu.step(time, step);
            assert_eq!(status, answer);
            if !is_exchange {
                assert_eq!(results.time, expected.time);
                let is_at_kick = answer == fmi3OK
                    && step > 0.0
                    && kind == Events
                    && !expected.kicked
                    && expected.time == Ball::KICK
                    && time < Ball::KICK;
                assert_eq!(results.event, is_at_kick);
                assert_eq!(results.early, is_at_kick && time + step > Ball::KICK);
            }
        }
        &Call::Set(reference, value) => {
            assert_eq!(fmu.set(reference, value), expected.set(reference, value));
        }
        Call::Get => {
            let answer = expected.update();
            let mut values = [-7.0; 4];
            let references = [Ball::TIME, Ball::DRIVE, Ball::H, Ball::V];
            assert_eq!(fmu.get_f64(&references, &mut values), answer);
            if answer == fmi3OK {
                let Expected {
                    time, drive, h, v, ..
                } = *expected;
                assert_eq!(values, [time, drive, h, v]);
                let mut events = [-7];
                assert_eq!(fmu.get_i32(&[Ball::EVENTS], &mut events), fmi3OK);
                assert_eq!(events, [expected.events]);
            } else {
                assert_eq!(values, [-7.0; 4]);
            }
        }
        &Call::SetTime(time) => {
            let answer = match is_exchange {
                true => expected.answer(&[Event, Continuous], time.is_finite()),
                false => fmi3Error,
            };
            assert_eq!(fmu.set_time(time), answer);
            if answer == fmi3OK {
                expected.time = time;
            }
        }
        &Call::SetStates(h, v) => {
            let answer = match is_exchange {
                true => expected.answer(&[Continuous], h.is_finite() && v.is_finite()),
                false => fmi3Error,
            };
            assert_eq!(fmu.set_states(&[h, v]), answer);
            if answer == fmi3OK {
                (expected.h, expected.v) = (h, v);
            }
        }
        Call::Derivatives => {
            let states = [Initialization, Event, Continuous, Terminated, State::Error];
            let mut answer = match is_exchange {
                true => expected.answer(&states, true),
                false => fmi3Error,
            };
            if answer == fmi3OK {
                answer = expected.update();
            }
            let mut values = [-7.0; 2];
            assert_eq!(fmu.get_derivatives(&mut values), answer);
            if answer == fmi3OK && expected.state != State::Error {
                assert_eq!(values, [expected.v, expected.drive - Ball::G]);
            }
        }
        Call::Save => {
            let mut state = std::ptr::null_mut();
            assert_eq!(fmu.get_state(&mut state), alive);
            if alive == fmi3OK {
                let bytes = fmu.serialize(state);
                saved.push((state, expected.clone(), bytes));
            }
        }
        Call::Restore(index) => {
            if let Some((state, held, bytes)) =
                (!saved.is_empty()).then(|| &saved[index.index(saved.len())])
            {
                assert_eq!(fmu.set_state(*state), alive);
                if alive == fmi3OK {
                    *expected = held.clone();
                    assert_eq!(&fmu.snapshot(), bytes);
                }
            }
        }
        Call::Configure => {
            let answer = expected.answer(&[], true);
            assert_eq!(fmu.enter_configuration_mode(), answer);
            assert_eq!(fmu.exit_configuration_mode(), answer);
        }
    }
}

/// Makes the calls in sequence; returns the states in which they were made.
fn run(kind: Kind, calls: &[Call]) -> Vec<State> {
    let token = guid(BALL);
    let instance = Instance::with(&Arguments {
        token: Some(&token),
        early_return: true,
        ..Arguments::of(kind)
    });
    let (mut expected, mut saved, mut states) = (Expected::new(kind), Vec::new(), Vec::new());
    for call in calls {
        states.push(expected.state);
        check(*instance, &mut expected, &mut saved, call);
    }
    let other = Instance::new(kind);
    for (mut state, ..) in saved {
        assert_eq!(other.free_state(&mut state), fmi3OK);
    }
    states
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    use Call::*;
    // Half of the sequences start with those that lead to steps or to continuous time.
    let start = [
        Enter,
        Exit,
        Update,
        EnterStep,
        EnterContinuous,
        Step(0.0, 0.25),
    ];
    let calls = prop::collection::vec(call(), 1..80);
    (any::<bool>(), calls).prop_map(move |(is_started, calls)| match is_started {
        true => [start.to_vec(), calls].concat(),
        false => calls,
    })
}

const KINDS: [Kind; 3] = [CoSimulation, Events, ModelExchange];

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_calls_return_the_expected_status(kind in select(KINDS.to_vec()), calls in calls()) {
        run(kind, &calls);
    }
}

/// Ensures that the test above covers all states.
#[test]
fn the_calls_reach_every_state() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    for kind in KINDS {
        let mut count = [0; 9];
        for _ in 0..100 {
            for state in run(kind, &calls().new_tree(&mut runner).unwrap().current()) {
                count[state as usize] += 1;
            }
        }
        let is_mine = |state: State| match state {
            Event => kind != CoSimulation,
            Continuous => kind == ModelExchange,
            Step | Failed => kind != ModelExchange,
            _ => true,
        };
        for state in ALIVE
            .into_iter()
            .chain([Fatal])
            .filter(|state| is_mine(*state))
        {
            assert!(
                count[state as usize] > 5,
                "{state:?} of {kind:?}: {count:?}"
            );
        }
    }
}
