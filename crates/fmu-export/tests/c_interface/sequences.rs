//! Random valid and invalid calls, compared with a simple reference model of the standard.

use std::ptr::null_mut;

use fmu_export::Simulate;
use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Discard, fmi2Error, fmi2Fatal, fmi2OK};
use proptest::prelude::*;
use proptest::sample::{Index, select};

use crate::host::Slave;
use crate::models::*;

#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Instantiated,
    Initialization,
    Complete,
    Failed,
    Terminated,
    Error,
    Fatal,
}
use State::*;

const READABLE: [State; 5] = [Initialization, Complete, Failed, Terminated, Error];
const WRITABLE: [State; 3] = [Instantiated, Initialization, Complete];

/// The expected state of an instance.
#[derive(Debug, Clone)]
struct Expected {
    state: State,
    start: f64,
    stop: f64,
    time: Option<f64>,
    model: Probe,
}

impl Expected {
    fn new() -> Self {
        Self {
            state: Instantiated,
            start: 0.0,
            stop: f64::INFINITY,
            time: None,
            model: Probe::start(),
        }
    }

    fn now(&self) -> f64 {
        self.time.unwrap_or(self.start)
    }

    /// The expected status of a call that is allowed in `states`, if its arguments are valid.
    fn answer(&self, states: &[State], valid: bool) -> fmi2Status {
        match self.state {
            Fatal => fmi2Fatal,
            state if valid && states.contains(&state) => fmi2OK,
            _ => fmi2Error,
        }
    }

    /// A call that changes the state.
    fn change(&mut self, from: &[State], to: State) -> fmi2Status {
        let answer = self.answer(from, true);
        if answer == fmi2OK {
            self.state = to;
        }
        answer
    }

    /// Computes the outputs, in initialization mode when they are read or at its end.
    fn initialize(&mut self) -> fmi2Status {
        if self.model.trouble == PANIC {
            self.state = Fatal;
            return fmi2Fatal;
        }
        match self.model.initialized(self.start) {
            Some(model) => {
                self.model = model;
                fmi2OK
            }
            None => fmi2Error,
        }
    }

    /// Whether the start and the end of a step are valid.
    fn fits(&self, time: f64, step: f64) -> bool {
        let near = 1e-6 * step + 1e-9 * (1.0 + time.abs());
        let late = if self.time.is_none() { step } else { 0.0 };
        let gap = time - self.now();
        time.is_finite()
            && step.is_finite()
            && step >= 0.0
            && -near <= gap
            && gap <= late + near
            && time + step <= self.stop + near
    }

    fn step(&mut self, time: f64, step: f64) -> fmi2Status {
        let answer = self.answer(&[Complete], self.fits(time, step));
        if answer != fmi2OK || step == 0.0 {
            return answer;
        }
        let trouble = self.model.trouble;
        if trouble == PANIC {
            self.state = Fatal;
            return fmi2Fatal;
        }
        match self.model.step(time, step) {
            Ok(()) if self.model.is_finite() => {
                self.time = Some(time + step);
                self.model.u_rate = 0.0;
                fmi2OK
            }
            Err(_) if trouble == REFUSE => fmi2Error,
            Err(_) if trouble == DISCARD => {
                self.state = Failed;
                fmi2Discard
            }
            _ => {
                self.state = Error;
                fmi2Error
            }
        }
    }

    fn set(&mut self, kind: Kind, values: &[(u32, f64)]) -> fmi2Status {
        let running = self.state == Complete;
        let valid = values.iter().all(|&(reference, value)| {
            FACTS
                .get(reference as usize)
                .is_some_and(|f| f.kind == kind && f.settable(running) && f.allows(value))
        });
        let answer = self.answer(&WRITABLE, valid);
        if answer == fmi2OK {
            for &(reference, value) in values {
                self.model.set(reference, value);
            }
        }
        answer
    }

    fn get(&mut self, kind: Kind, references: &[u32]) -> fmi2Status {
        if self.state == Initialization {
            let answer = self.initialize();
            if answer != fmi2OK {
                return answer;
            }
        }
        let valid = |&r: &u32| FACTS.get(r as usize).is_some_and(|fact| fact.kind == kind);
        self.answer(&READABLE, references.iter().all(valid))
    }
}

/// A call.
#[derive(Debug, Clone)]
enum Call {
    Setup(f64, Option<f64>),
    Enter,
    Exit,
    Terminate,
    Reset,
    /// The gap to the end of the last step, and the size of the step.
    Step(f64, f64),
    Set(Kind, Vec<(u32, f64)>),
    Get(Kind, Vec<u32>),
    Slope(u32, i32, f64),
    Derivative(u32, u32, f64),
    Status,
    Save,
    Restore(Index),
    Unsupported,
}

fn call() -> impl Strategy<Value = Call> {
    use Call::*;
    let number = || {
        let special = vec![
            0.0,
            -0.0,
            1.0,
            2.0,
            3.0,
            4.0,
            1e300,
            f64::NAN,
            f64::INFINITY,
        ];
        prop_oneof![select(special), -12.0..12.0]
    };
    let kind = || {
        let reals = [Kind::Real; 2].into_iter();
        let others = [Kind::Integer, Kind::Boolean, Kind::String];
        select(reals.chain(others).collect::<Vec<_>>())
    };
    let start = select(vec![0.0, 2.0, -1.0, 1e6, f64::NAN]);
    let stop = prop::option::of(select(vec![0.0, 3.0, 2e6, f64::INFINITY]));
    let gap = select(vec![
        0.0,
        0.0,
        0.0,
        0.0,
        3e-10,
        -3e-10,
        1e-3,
        0.25,
        -1.0,
        f64::NAN,
    ]);
    let step = select(vec![0.25, 0.25, 0.25, 0.0, 1.0, 1e-9, -0.25, f64::INFINITY]);
    // Values of a kind, mostly for variables of that kind.
    let values = kind().prop_flat_map(move |kind| {
        let good: Vec<u32> = (0..COUNT)
            .filter(|&r| FACTS[r as usize].kind == kind)
            .collect();
        let reference = prop_oneof![9 => select(good), 1 => 0..COUNT + 2];
        let whole = (-1..4).prop_map(f64::from);
        let value = if kind == Kind::Real {
            number().boxed()
        } else {
            whole.boxed()
        };
        (Just(kind), prop::collection::vec((reference, value), 0..6))
    });
    prop_oneof![
        2 => (start, stop).prop_map(|(start, stop)| Setup(start, stop)),
        4 => Just(Enter),
        4 => Just(Exit),
        1 => Just(Terminate),
        1 => Just(Reset),
        8 => (gap, step).prop_map(|(gap, step)| Step(gap, step)),
        6 => values.clone().prop_map(|(kind, values)| Set(kind, values)),
        2 => select(vec![1u8, 2, 3, 3, 4, 5]).prop_map(|trouble| Set(Kind::Real, vec![(TROUBLE, trouble.into())])),
        4 => values.prop_map(|(kind, v)| Get(kind, v.into_iter().map(|(r, _)| r).collect())),
        2 => (0..COUNT, 0..3, number()).prop_map(|(r, order, value)| Slope(r % 2, order, value)),
        2 => (Y - 1..Y + 4, 0..3u32, number()).prop_map(|(y, u, seed)| Derivative(y, u, seed)),
        1 => Just(Status),
        2 => Just(Save),
        3 => any::<Index>().prop_map(Restore),
        1 => Just(Unsupported),
    ]
}

/// An FMU state, the expected state, and the serialized state.
type Saved = (fmi2FMUstate, Expected, Vec<u8>);

/// Makes a call and checks the status.
fn check(slave: &mut Slave, expected: &mut Expected, saved: &mut Vec<Saved>, call: &Call) {
    const ALIVE: [State; 6] = [
        Instantiated,
        Initialization,
        Complete,
        Failed,
        Terminated,
        State::Error,
    ];
    let alive = expected.answer(&ALIVE, true);
    match call {
        &Call::Setup(start, stop) => {
            let valid =
                start.is_finite() && stop.is_none_or(|stop| stop.is_finite() && stop >= start);
            let answer = expected.answer(&[Instantiated], valid);
            assert_eq!(slave.setup(start, stop), answer);
            if answer == fmi2OK {
                (expected.start, expected.stop) = (start, stop.unwrap_or(f64::INFINITY));
            }
        }
        Call::Enter => {
            let answer = expected.change(&[Instantiated], Initialization);
            assert_eq!(slave.enter_initialization_mode(), answer);
        }
        Call::Exit => {
            let mut answer = expected.answer(&[Initialization], true);
            if answer == fmi2OK {
                answer = expected.initialize();
            }
            if answer == fmi2OK {
                expected.state = Complete;
            }
            assert_eq!(slave.exit_initialization_mode(), answer);
        }
        Call::Terminate => {
            assert_eq!(
                slave.terminate(),
                expected.change(&[Complete, Failed], Terminated)
            );
        }
        Call::Reset => {
            assert_eq!(slave.reset(), alive);
            if alive == fmi2OK {
                *expected = Expected::new();
            }
        }
        &Call::Step(gap, step) => {
            let time = expected.now() + gap;
            assert_eq!(slave.step(time, step), expected.step(time, step));
        }
        Call::Set(kind, values) => {
            let answer = expected.set(*kind, values);
            let (references, reals): (Vec<u32>, Vec<f64>) = values.iter().copied().unzip();
            let given = slave.set_all(*kind, &references, &reals);
            assert_eq!(given, answer);
        }
        Call::Get(kind, references) => {
            let answer = expected.get(*kind, references);
            let (given, values) = slave.get_all(*kind, references);
            assert_eq!(given, answer);
            for (&reference, value) in references.iter().zip(values) {
                let expected_value = match answer {
                    fmi2OK => expected.model.value(reference),
                    _ => -7.0,
                };
                assert_eq!(
                    value.to_bits(),
                    expected_value.to_bits(),
                    "{reference}: {value} {expected_value}"
                );
            }
        }
        &Call::Slope(reference, order, value) => {
            let valid = reference == U && order == 1 && value.is_finite();
            let answer = expected.answer(&WRITABLE, valid);
            assert_eq!(
                slave.set_input_derivatives(&[reference], &[order], &[value]),
                answer
            );
            if answer == fmi2OK {
                expected.model.u_rate = value;
            }
        }
        &Call::Derivative(output, input, seed) => {
            let valid = FACTS[output as usize].role == Role::Output && seed.is_finite();
            let answer = expected.answer(&READABLE, valid);
            let mut value = [-7.0];
            let given = slave.directional_derivative(&[output], &[input], &[seed], &mut value);
            assert_eq!(given, answer);
            let known = (output, input) == (Y, U);
            let derivative = if known {
                expected.model.y_by_u * seed
            } else {
                0.0
            };
            assert_eq!(value[0], if answer == fmi2OK { derivative } else { -7.0 });
        }
        Call::Status => {
            let answer = expected.answer(&[Complete, Failed, Terminated], true);
            let mut time = -7.0;
            assert_eq!(slave.real_status(fmi2LastSuccessfulTime, &mut time), answer);
            assert_eq!(
                time,
                if answer == fmi2OK {
                    expected.now()
                } else {
                    -7.0
                }
            );
        }
        Call::Save => {
            let mut state = null_mut();
            assert_eq!(slave.get_state(&mut state), alive);
            if alive == fmi2OK {
                let bytes = slave.serialize(state);
                saved.push((state, expected.clone(), bytes));
            }
        }
        Call::Unsupported => {
            // SAFETY: the instance lives.
            assert_eq!(unsafe { fmi2CancelStep(slave.c) }, fmi2Error);
        }
        Call::Restore(index) => {
            let (state, held, bytes) = match saved.is_empty() {
                false => &saved[index.index(saved.len())],
                true => &(null_mut(), Expected::new(), Vec::new()),
            };
            let answer = expected.answer(&ALIVE, !state.is_null());
            assert_eq!(slave.set_state(*state), answer);
            if answer == fmi2OK {
                *expected = held.clone();
                assert_eq!(&slave.snapshot(), bytes);
            }
        }
    }
}

/// Makes the calls in sequence; returns the states in which they were made.
fn run(calls: &[Call]) -> Vec<State> {
    let (mut slave, mut expected, mut saved) = (Slave::new(), Expected::new(), Vec::new());
    let mut states = Vec::new();
    for call in calls {
        states.push(expected.state);
        check(&mut slave, &mut expected, &mut saved, call);
        if expected.state != Fatal {
            let bytes = slave.snapshot();
            assert_eq!(Slave::new().resume(&bytes).snapshot(), bytes);
        }
    }
    for (mut state, ..) in saved {
        assert_eq!(Slave::new().free_state(&mut state), fmi2OK);
    }
    states
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    prop::collection::vec(call(), 1..80)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_calls_return_the_expected_status(calls in calls()) {
        run(&calls);
    }
}

/// Ensures that the test above covers all states.
#[test]
fn the_calls_reach_every_state() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let mut count = [0; 7];
    for _ in 0..300 {
        for state in run(&calls().new_tree(&mut runner).unwrap().current()) {
            count[state as usize] += 1;
        }
    }
    assert!(count.iter().all(|&calls| calls > 50), "{count:?}");
}
