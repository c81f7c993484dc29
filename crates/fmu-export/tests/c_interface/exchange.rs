//! Model exchange of FMI 2.0.

use fmu_export::fmi2::*;
use fmu_export::fmi2::{fmi2Discard, fmi2Error, fmi2Fatal, fmi2OK, fmi2Status};

use crate::host::{Arguments, MODEL_EXCHANGE, Slave, guid};
use crate::models::*;

const STATES: [&str; 7] = [
    "instantiated",
    "initialization mode",
    "event mode",
    "continuous-time mode",
    "terminated",
    "error",
    "fatal",
];

/// A new instance for model exchange.
fn exchanged(model: usize) -> Slave {
    let guid = guid(model);
    Slave::with(&Arguments {
        kind: MODEL_EXCHANGE,
        guid: Some(&guid),
        ..Arguments::default()
    })
}

/// An instance in continuous-time mode at the start.
fn moving() -> Slave {
    let mut slave = exchanged(BALL);
    slave.start(0.0, None);
    update(&mut slave);
    assert_eq!(slave.enter_continuous_time_mode(), fmi2OK);
    slave
}

/// Brings a ball to a state.
fn bring(state: &str) -> Slave {
    let fail_by = |trouble, status| {
        let mut slave = moving();
        assert_eq!(slave.set(Ball::TROUBLE, trouble), fmi2OK);
        assert_eq!(slave.get_derivatives(&mut [0.0; 2]), status);
        slave
    };
    let mut slave = exchanged(BALL);
    match state {
        "instantiated" => {}
        "initialization mode" => assert_eq!(slave.enter_initialization_mode(), fmi2OK),
        "event mode" => drop(slave.start(0.0, None)),
        "continuous-time mode" => return moving(),
        "terminated" => assert_eq!(slave.start(0.0, None).terminate(), fmi2OK),
        "error" => return fail_by(BREAK, fmi2Error),
        _ => return fail_by(PANIC, fmi2Fatal),
    }
    slave
}

fn new_info() -> fmi2EventInfo {
    fmi2EventInfo {
        newDiscreteStatesNeeded: -7,
        terminateSimulation: -7,
        nominalsOfContinuousStatesChanged: -7,
        valuesOfContinuousStatesChanged: -7,
        nextEventTimeDefined: -7,
        nextEventTime: f64::NAN,
    }
}

/// Handles an event; returns whether states changed, and the time of the next event.
#[track_caller]
fn update(slave: &mut Slave) -> (bool, Option<f64>) {
    let mut info = new_info();
    assert_eq!(slave.new_discrete_states(&mut info), fmi2OK);
    let never = [
        info.newDiscreteStatesNeeded,
        info.terminateSimulation,
        info.nominalsOfContinuousStatesChanged,
    ];
    assert_eq!(never, [fmi2False; 3]);
    (
        info.valuesOfContinuousStatesChanged == 1,
        (info.nextEventTimeDefined == 1).then_some(info.nextEventTime),
    )
}

/// Reads two numbers by one of the functions of model exchange.
#[track_caller]
fn two(slave: &mut Slave, read: fn(&mut Slave, &mut [f64]) -> fmi2Status) -> [f64; 2] {
    let mut values = [f64::NAN; 2];
    assert_eq!(read(slave, &mut values), fmi2OK);
    values
}

/// A call with valid arguments.
type Call = fn(&mut Slave) -> fmi2Status;

/// The calls of model exchange (FMI 2.0.5, section 3.2.3), and whether they are allowed (x) or not (.) in
/// each state except the last, which allows none.
#[rustfmt::skip]
const TABLE: &[(&str, &str, Call)] = &[
    ("fmi2SetDebugLogging", "xxxxxx", |s| s.switch_log(true, &[c"logAll"])),
    ("fmi2SetupExperiment", "x.....", |s| s.setup(0.0, None)),
    ("fmi2EnterInitializationMode", "x.....", Slave::enter_initialization_mode),
    ("fmi2ExitInitializationMode", ".x....", Slave::exit_initialization_mode),
    ("fmi2Terminate", "..xx..", Slave::terminate),
    ("fmi2Reset", "xxxxxx", Slave::reset),
    ("fmi2GetReal", ".xxxxx", |s| s.get_reals(&[Ball::H], &mut [0.0])),
    ("fmi2GetInteger", ".xxxxx", |s| s.get_integers(&[Ball::EVENTS], &mut [0])),
    ("fmi2SetReal", "xxxx..", |s| s.set(Ball::DRIVE, 1.0)),
    ("fmi2SetInteger", "xxx...", |s| s.set_integers(&[Ball::SWITCH], &[1])),
    ("fmi2SetBoolean", "xxx...", |s| s.set_booleans(&[], &[])),
    ("fmi2GetDirectionalDerivative", ".xxxxx",
        |s| s.directional_derivative(&[Ball::ENERGY], &[Ball::H], &[1.0], &mut [0.0])),
    ("fmi2EnterEventMode", "..xx..", Slave::enter_event_mode),
    ("fmi2NewDiscreteStates", "..x...", |s| s.new_discrete_states(&mut new_info())),
    ("fmi2EnterContinuousTimeMode", "..x...", Slave::enter_continuous_time_mode),
    ("fmi2CompletedIntegratorStep", "...x..", |s| s.completed_integrator_step(&mut 0, &mut 0)),
    ("fmi2SetTime", "..xx..", |s| s.set_time(0.25)),
    ("fmi2SetContinuousStates", "...x..", |s| s.set_states(&[1.0, 2.0])),
    ("fmi2GetDerivatives", ".xxxxx", |s| s.get_derivatives(&mut [0.0; 2])),
    ("fmi2GetEventIndicators", ".xxxxx", |s| s.get_indicators(&mut [0.0])),
    ("fmi2GetContinuousStates", ".xxxxx", |s| s.get_states(&mut [0.0; 2])),
    ("fmi2GetNominalsOfContinuousStates", "xxxxxx", |s| s.get_nominals(&mut [0.0; 2])),
];

/// The functions of co-simulation.
const FOREIGN: &[(&str, Call)] = &[
    ("fmi2SetRealInputDerivatives", |s| {
        s.set_input_derivatives(&[], &[], &[])
    }),
    ("fmi2GetRealOutputDerivatives", |s| {
        s.get_output_derivatives(&[], &[], &mut [])
    }),
    ("fmi2DoStep", |s| s.step(0.0, 0.5)),
    ("fmi2GetRealStatus", |s| {
        s.real_status(fmi2LastSuccessfulTime, &mut 0.0)
    }),
    ("fmi2GetBooleanStatus", |s| {
        s.boolean_status(fmi2Terminated, &mut 0)
    }),
];

#[test]
fn calls_are_allowed_according_to_the_table() {
    for &(name, allowed, call) in TABLE {
        for (state, allowed) in STATES.into_iter().zip(allowed.bytes().chain([b'.'])) {
            println!("{name} in {state}");
            let mut slave = bring(state);
            match (state, allowed) {
                ("fatal", _) => assert_eq!(call(&mut slave), fmi2Fatal),
                (_, b'x') => assert_eq!(call(&mut slave), fmi2OK, "{:?}", slave.messages()),
                _ => slave.refuses(&[name, state], call),
            }
        }
    }
}

#[test]
fn functions_of_the_other_kind_are_refused() {
    for (name, call) in FOREIGN {
        for state in &STATES[..6] {
            let words = [name, "it is a function of co-simulation"];
            bring(state).refuses(&words, call);
        }
    }
    for &(name, _, call) in &TABLE[12..] {
        let mut slave = Slave::of(BALL);
        let words = [name, "it is a function of model exchange"];
        slave.start(0.0, None).refuses(&words, call);
    }
}

#[test]
fn a_model_without_equations_and_samples_is_not_for_model_exchange() {
    let slave = exchanged(WIDE);
    assert!(slave.c.is_null());
    assert!(
        slave
            .last_message()
            .contains("Wide is for co-simulation, not for model exchange")
    );
}

#[test]
fn the_equations_hold_at_any_time_state_and_input() {
    let mut slave = moving();
    assert_eq!(two(&mut slave, Slave::get_states), [1.0, 0.0]);
    assert_eq!(two(&mut slave, Slave::get_nominals), [10.0, 1.0]);
    assert_eq!(slave.set_time(0.25), fmi2OK);
    assert_eq!(slave.set_states(&[2.0, -3.0]), fmi2OK);
    assert_eq!(slave.set(Ball::DRIVE, 1.5), fmi2OK);
    assert_eq!(two(&mut slave, Slave::get_states), [2.0, -3.0]);
    assert_eq!(two(&mut slave, Slave::get_derivatives), [-3.0, -8.25]);
    let mut indicator = [0.0];
    assert_eq!(slave.get_indicators(&mut indicator), fmi2OK);
    assert_eq!(indicator, [2.0]);
    // States and derivatives are variables, too.
    assert_eq!(
        slave.get([Ball::H, Ball::V, Ball::H_DOT, Ball::V_DOT, Ball::CONTACT]),
        [2.0, -3.0, -3.0, -8.25, 2.0]
    );
    assert_eq!(slave.get([Ball::ENERGY]), [19.5 + 4.5 + 0.1875]);
    // CasADi sets states one by one.
    assert_eq!(slave.set(Ball::H, 5.0), fmi2OK);
    assert_eq!(two(&mut slave, Slave::get_states), [5.0, -3.0]);
    assert_eq!(slave.get_indicators(&mut indicator), fmi2OK);
    assert_eq!(indicator, [5.0]);
    slave.refuses(&["is a local variable"], |s| s.set(Ball::H_DOT, 0.0));
}

#[test]
fn the_equations_are_evaluated_only_if_something_changed() {
    let mut slave = moving();
    let read = |slave: &mut Slave| {
        let before = EVALUATIONS.get();
        two(slave, Slave::get_derivatives);
        slave.get([Ball::ENERGY, Ball::V_DOT]);
        assert_eq!(slave.get_indicators(&mut [0.0]), fmi2OK);
        EVALUATIONS.get() - before
    };
    assert_eq!(read(&mut slave), 1);
    assert_eq!(read(&mut slave), 0);
    let changes: [Call; 4] = [
        |s| s.set_time(0.125),
        |s| s.set_states(&[1.0, 0.0]),
        |s| s.set(Ball::DRIVE, 0.0),
        |s| {
            assert_eq!(s.enter_event_mode(), fmi2OK);
            update(s);
            s.enter_continuous_time_mode()
        },
    ];
    for change in changes {
        assert_eq!(change(&mut slave), fmi2OK);
        assert_eq!(read(&mut slave), 1);
    }
    assert_eq!(slave.set_time(0.125), fmi2OK, "the same time");
    assert_eq!(read(&mut slave), 0);
    assert_eq!(slave.set_states(&[5.0, 2.0]), fmi2OK);
    assert_eq!(slave.terminate(), fmi2OK);
    assert_eq!(read(&mut slave), 1);
    assert_eq!(
        slave.get([Ball::H_DOT]),
        [2.0],
        "the final values are those of the final states"
    );
}

#[test]
fn events_change_states_and_announce_the_next() {
    let mut slave = exchanged(BALL);
    slave.start(0.0, None);
    assert_eq!(update(&mut slave), (false, Some(Ball::KICK)));
    assert_eq!(slave.enter_continuous_time_mode(), fmi2OK);
    assert_eq!(slave.set_time(0.25), fmi2OK);
    assert_eq!(slave.set_states(&[-0.125, -4.0]), fmi2OK);
    let (mut event, mut terminate) = (-7, -7);
    let status = slave.completed_integrator_step(&mut event, &mut terminate);
    assert_eq!((status, event, terminate), (fmi2OK, fmi2False, fmi2False));
    assert_eq!(slave.enter_event_mode(), fmi2OK);
    assert_eq!(update(&mut slave), (true, Some(Ball::KICK)));
    assert_eq!(two(&mut slave, Slave::get_states), [-0.125, 2.0]);
    assert_eq!(two(&mut slave, Slave::get_derivatives)[0], 2.0);
    assert_eq!(update(&mut slave), (false, Some(Ball::KICK)), "once");
    assert_eq!(slave.set_time(Ball::KICK), fmi2OK);
    assert_eq!(update(&mut slave), (true, None), "infinity is no time");
    assert_eq!(two(&mut slave, Slave::get_states), [-0.125, 3.0]);
}

#[test]
fn invalid_times_states_and_lengths_are_refused() {
    let mut slave = moving();
    for time in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        slave.refuses(&["fmi2SetTime", "expected a finite number"], |s| {
            s.set_time(time)
        });
        slave.refuses(&["a state is", "expected finite numbers"], |s| {
            s.set_states(&[1.0, time])
        });
    }
    for n in [0, 1, 3] {
        let values = &mut [7.0; 3][..n];
        let words = [&*format!(
            "has {n} elements; expected 2, the number of continuous states"
        )];
        slave.refuses(&words, |s| s.set_states(values));
        slave.refuses(&words, |s| s.get_states(values));
        slave.refuses(&words, |s| s.get_derivatives(values));
        slave.refuses(&words, |s| s.get_nominals(values));
        assert_eq!(values, &[7.0; 3][..n]);
    }
    slave.refuses(&["expected 1, the number of event indicators"], |s| {
        s.get_indicators(&mut [0.0; 2])
    });
    let c = slave.c;
    // SAFETY: the instance lives, and NULL is refused.
    unsafe {
        use std::ptr::{null, null_mut};
        slave.refuses(&["an array is NULL"], |_| {
            fmi2SetContinuousStates(c, null(), 2)
        });
        slave.refuses(&["an array is NULL"], |_| {
            fmi2GetDerivatives(c, null_mut(), 2)
        });
        slave.refuses(&["NULL"], |_| {
            fmi2CompletedIntegratorStep(c, 1, null_mut(), &mut 0)
        });
        slave.refuses(&["NULL"], |_| fmi2NewDiscreteStates(c, null_mut()));
    }
    slave.refuses(&["restitution is not a continuous input"], |s| {
        s.set(Ball::RESTITUTION, 0.5)
    });
}

#[test]
fn a_model_without_states_has_none() {
    let mut slave = exchanged(SAMPLED);
    slave.start(0.0, None);
    for read in [
        Slave::get_states,
        Slave::get_derivatives,
        Slave::get_nominals,
        Slave::get_indicators,
    ] {
        assert_eq!(read(&mut slave, &mut []), fmi2OK);
    }
}

#[test]
fn a_discarded_or_refused_evaluation_can_be_repeated_with_other_values() {
    let mut slave = moving();
    for (trouble, status, word) in [
        (DISCARD, fmi2Discard, "discarded by the ball"),
        (DIVERGE, fmi2Discard, "der(v) became NaN"),
        (REFUSE, fmi2Error, "refused by the ball"),
    ] {
        assert_eq!(slave.set(Ball::TROUBLE, trouble), fmi2OK);
        assert_eq!(slave.get_derivatives(&mut [0.0; 2]), status);
        assert!(
            slave.last_message().contains(word),
            "{}",
            slave.last_message()
        );
        let mut values = [7.0; 2];
        assert_eq!(
            slave.get_reals(&[Ball::ENERGY, Ball::V_DOT], &mut values),
            status
        );
        assert_eq!(values, [7.0; 2]);
        assert_eq!(slave.set(Ball::TROUBLE, 0.0), fmi2OK);
        assert_eq!(two(&mut slave, Slave::get_derivatives), [0.0, -Ball::G]);
    }
}

#[test]
fn a_discarded_event_can_be_repeated() {
    let mut slave = bring("event mode");
    assert_eq!(slave.set(Ball::TROUBLE, DISCARD), fmi2OK);
    let mut info = new_info();
    assert_eq!(slave.new_discrete_states(&mut info), fmi2Discard);
    assert_eq!(info.newDiscreteStatesNeeded, -7, "nothing is returned");
    assert_eq!(slave.set(Ball::TROUBLE, 0.0), fmi2OK);
    update(&mut slave);
}

#[test]
fn derivatives_that_are_not_finite_at_the_start_are_refused() {
    let mut slave = exchanged(BALL);
    assert_eq!(slave.set(Ball::TROUBLE, DIVERGE), fmi2OK);
    assert_eq!(slave.enter_initialization_mode(), fmi2OK);
    let words = ["at t = 0.0 s: der(v) became NaN"];
    slave.refuses(&words, |s| s.get_derivatives(&mut [0.0; 2]));
    slave.refuses(&words, Slave::exit_initialization_mode);
    assert_eq!(slave.set(Ball::TROUBLE, 0.0), fmi2OK);
    assert_eq!(slave.exit_initialization_mode(), fmi2OK);
}

#[test]
fn a_panic_of_equations_or_events_is_caught() {
    let calls: [Call; 6] = [
        |s| s.get_derivatives(&mut [0.0; 2]),
        |s| s.get_reals(&[Ball::ENERGY], &mut [0.0]),
        |s| s.get_indicators(&mut [0.0]),
        |s| s.get_states(&mut [0.0; 2]),
        |s| s.directional_derivative(&[Ball::ENERGY], &[Ball::H], &[1.0], &mut [0.0]),
        |s| {
            s.enter_event_mode();
            s.new_discrete_states(&mut new_info())
        },
    ];
    for call in calls {
        let mut slave = moving();
        assert_eq!(slave.set(Ball::TROUBLE, PANIC), fmi2OK);
        assert_eq!(call(&mut slave), fmi2Fatal);
        assert!(slave.last_message().ends_with("the bug shows in the ball"));
        assert_eq!(slave.reset(), fmi2Fatal);
    }
}

#[test]
fn directional_derivatives_are_those_of_the_equations() {
    let mut slave = exchanged(BALL);
    assert_eq!(slave.set(Ball::DRAG, 0.25), fmi2OK);
    slave.start(0.0, None);
    assert_eq!(slave.enter_continuous_time_mode(), fmi2OK);
    let unknowns = [
        Ball::H_DOT,
        Ball::V_DOT,
        Ball::CONTACT,
        Ball::ENERGY,
        Ball::H,
        Ball::V,
    ];
    let (point, drive) = ([2.0, -3.0], 1.5);
    let mut at = |point: [f64; 2], drive: f64| {
        assert_eq!(slave.set_states(&point), fmi2OK);
        assert_eq!(slave.set(Ball::DRIVE, drive), fmi2OK);
        slave.get(unknowns)
    };
    // Central differences, which are exact for polynomials of degree 2.
    let e = 0.125;
    let differences = [
        (
            Ball::H,
            at([2.0 + e, -3.0], drive),
            at([2.0 - e, -3.0], drive),
        ),
        (
            Ball::V,
            at([2.0, -3.0 + e], drive),
            at([2.0, -3.0 - e], drive),
        ),
        (Ball::DRIVE, at(point, drive + e), at(point, drive - e)),
    ];
    at(point, drive);
    for (known, above, below) in differences {
        let expected: [f64; 6] = std::array::from_fn(|k| (above[k] - below[k]) / (2.0 * e));
        let mut derivatives = [f64::NAN; 6];
        let status = slave.directional_derivative(&unknowns, &[known], &[1.0], &mut derivatives);
        assert_eq!((status, derivatives), (fmi2OK, expected), "{known}");
    }
    let mut sum = [f64::NAN];
    let knowns = [Ball::H, Ball::V, Ball::DRIVE];
    let status = slave.directional_derivative(&[Ball::ENERGY], &knowns, &[2.0, 1.0, 8.0], &mut sum);
    assert_eq!((status, sum), (fmi2OK, [2.0 * Ball::G - 3.0 + 1.0]));
    for (unknown, known, word) in [
        (
            Ball::DRIVE,
            Ball::H,
            "drive is not an output, a derivative or an event indicator",
        ),
        (
            Ball::H_DOT,
            Ball::H_DOT,
            "der(h) is not an input or a state",
        ),
        (
            Ball::H_DOT,
            Ball::ENERGY,
            "energy is not an input or a state",
        ),
        (Ball::EVENTS, Ball::H, "events is of type Integer, not Real"),
    ] {
        slave.refuses(&[word], |s| {
            s.directional_derivative(&[unknown], &[known], &[1.0], &mut [0.0])
        });
    }
}

#[test]
fn saved_states_continue_bit_for_bit_in_model_exchange_only() {
    let run = |slave: &mut Slave| {
        let mut rows = Vec::new();
        for k in 0..5 {
            let time = 0.25 + f64::from(k) * 0.1;
            let [h, v] = two(slave, Slave::get_states);
            let [h_dot, v_dot] = two(slave, Slave::get_derivatives);
            assert_eq!(slave.set_time(time), fmi2OK);
            assert_eq!(
                slave.set_states(&[h + 0.1 * h_dot, v + 0.1 * v_dot]),
                fmi2OK
            );
            assert_eq!(slave.enter_event_mode(), fmi2OK);
            rows.push((
                update(slave),
                two(slave, Slave::get_states),
                slave.snapshot(),
            ));
            assert_eq!(slave.enter_continuous_time_mode(), fmi2OK);
        }
        rows
    };
    let mut slave = moving();
    assert_eq!(slave.set_states(&[0.25, -1.0]), fmi2OK);
    let bytes = slave.snapshot();
    let expected = run(&mut slave);
    assert_eq!(run(slave.resume(&bytes)), expected);
    let mut other = exchanged(BALL);
    assert_eq!(other.resume(&bytes).snapshot(), bytes);
    assert_eq!(run(&mut other), expected);
    let fresh = exchanged(BALL).snapshot();
    assert_eq!(other.reset(), fmi2OK);
    assert_eq!(other.snapshot(), fresh);

    let mut stepped = Slave::of(BALL);
    let mut state = stepped.start(0.0, None).save();
    let words =
        ["the state is that of an instance for co-simulation; expected one for model exchange"];
    other.refuses(&words, |s| s.set_state(state));
    let mut exchange = other.save();
    stepped.refuses(&["expected one for co-simulation"], |s| {
        s.set_state(exchange)
    });
    assert_eq!(stepped.free_state(&mut exchange), fmi2OK);
    assert_eq!(other.free_state(&mut state), fmi2OK);
}

/// The time of the last sample, and the number of samples.
fn samples(slave: &mut Slave) -> (f64, f64) {
    let [last] = slave.get([5]);
    (last, slave.get_all(Kind::Integer, &[6]).1[0])
}

#[test]
fn samples_are_taken_at_their_instants_and_not_between() {
    let mut slave = exchanged(SAMPLED);
    // 0.1 is no binary fraction.
    assert_eq!(slave.set(0, 0.1), fmi2OK);
    slave.start(0.0, None);
    assert_eq!(samples(&mut slave).1, 0.0, "none at the initialization");
    let (_, mut next) = update(&mut slave);
    assert_eq!(samples(&mut slave), (0.0, 1.0));
    for k in 1..1000 {
        let instant = f64::from(k) * 0.1;
        assert_eq!(next, Some(instant));
        assert_eq!(slave.enter_continuous_time_mode(), fmi2OK);
        assert_eq!(slave.set_time(instant - 0.05), fmi2OK);
        assert_eq!(slave.enter_event_mode(), fmi2OK);
        assert_eq!(update(&mut slave), (false, Some(instant)), "not due");
        // Hosts compute times with different rounding errors.
        let jitter = if k % 2 == 0 { 1e-9 } else { -1e-9 };
        assert_eq!(slave.set_time(instant + jitter), fmi2OK);
        next = update(&mut slave).1;
        assert_eq!(samples(&mut slave), (instant, f64::from(k + 1)));
        assert_eq!(update(&mut slave).1, next, "once");
    }
}

#[test]
fn samples_that_a_host_missed_are_taken_at_the_next_event() {
    let mut slave = exchanged(SAMPLED);
    slave.start(1.0, None);
    update(&mut slave);
    assert_eq!(slave.set_time(2.25), fmi2OK);
    assert_eq!(update(&mut slave), (false, Some(2.5)));
    assert_eq!(slave.get([3, 4, 5]), [1.0, 1.5, 2.0]);
}

#[test]
fn a_late_start_has_as_many_samples_though_their_instants_are_rounded() {
    let mut slave = exchanged(SAMPLED);
    assert_eq!(slave.set(0, 0.001), fmi2OK);
    slave.start(1e9, None);
    let (_, mut next) = update(&mut slave);
    for k in 1..100 {
        let time = next.unwrap();
        assert_eq!(slave.set_time(time), fmi2OK);
        next = update(&mut slave).1;
        assert_eq!(samples(&mut slave), (time, f64::from(k + 1)));
    }
}
