//! Model exchange, and derivatives with respect to other variables and to time.

use fmu_description::Type;

use crate::driver::*;
use crate::models::*;

/// A ball in continuous-time mode.
fn moving(kind: Kind) -> Instance {
    Instance::running(kind, BALL)
}

/// A call with valid arguments.
type Call = fn(Fmu) -> Status;

#[test]
fn the_equations_hold_at_any_time_state_and_input() {
    for kind in EXCHANGED {
        let it = moving(kind);
        assert_eq!(it.two(Fmu::get_states), [1.0, 0.0]);
        assert_eq!(it.two(Fmu::get_nominals), [10.0, 1.0]);
        ok([it.set_time(0.25), it.set_states(&[2.0, -3.0])]);
        assert_eq!(it.set(Ball::DRIVE, 1.5), OK);
        assert_eq!(it.two(Fmu::get_states), [2.0, -3.0]);
        assert_eq!(it.two(Fmu::get_derivatives), [-3.0, -8.25]);
        // States and derivatives are variables, too.
        let references = [Ball::H, Ball::V, Ball::H_DOT, Ball::V_DOT, Ball::CONTACT];
        assert_eq!(it.get(references), [2.0, -3.0, -3.0, -8.25, 2.0]);
        assert_eq!(it.get([Ball::ENERGY]), [19.5 + 4.5 + 0.1875]);
        // CasADi sets states one by one.
        assert_eq!(it.set(Ball::H, 5.0), OK);
        assert_eq!(it.two(Fmu::get_states), [5.0, -3.0]);
        it.refuses("is a local variable", |f| f.set(Ball::H_DOT, 0.0));
        let words = "restitution is not a continuous input";
        it.refuses(words, |f| f.set(Ball::RESTITUTION, 0.5));
        let mut flags = [7_i32; 2];
        let [event, end] = flags.each_mut().map(Argument::from);
        ok([it.call("completed_integrator_step", &[true.into(), event, end])]);
        // In FMI 3.0, flags are bytes.
        assert_eq!(flags.map(|flag| flag.to_ne_bytes()[0]), [0; 2]);
        // A model without states has none.
        let s = Instance::running(kind, SAMPLED);
        ok([s.get_states(&mut []), s.get_derivatives(&mut [])]);
        ok([s.get_nominals(&mut []), s.get_indicators(&mut [])]);
        let hopper = Instance::running(kind, HOPPER);
        let mut indicator = [0.0];
        ok([hopper.set_states(&[2.0, -3.0]), hopper.get_indicators(&mut indicator)]);
        assert_eq!((indicator, hopper.get([Hopper::GAP])), ([2.0], [2.0]));
        let words = "expected 1, the number of event indicators";
        hopper.refuses(words, |f| f.get_indicators(&mut [0.0; 2]));
    }
    let (mut states, mut indicators) = (7, 7);
    let it = Instance::running(EXCHANGED[1], HOPPER);
    assert_eq!(it.count_states(&mut states), OK);
    assert_eq!(it.count_indicators(&mut indicators), OK);
    assert_eq!((states, indicators), (2, 1));
}

#[test]
fn the_equations_are_evaluated_only_if_something_changed() {
    for kind in EXCHANGED {
        let it = moving(kind);
        let read = || {
            let before = EVALUATIONS.get();
            it.two(Fmu::get_derivatives);
            it.get([Ball::ENERGY, Ball::V_DOT]);
            assert_eq!(it.get_indicators(&mut []), OK);
            EVALUATIONS.get() - before
        };
        assert_eq!([read(), read()], [1, 0]);
        let changes: [Call; 4] = [
            |f| f.set_time(0.125),
            |f| f.set_states(&[1.0, 0.0]),
            |f| f.set(Ball::DRIVE, 0.0),
            |f| {
                assert_eq!(f.enter_event_mode(), OK);
                f.update();
                f.enter_continuous_time_mode()
            },
        ];
        for change in changes {
            assert_eq!((change(*it), read()), (OK, 1));
        }
        assert_eq!((it.set_time(0.125), read()), (OK, 0), "the same time");
        assert_eq!(it.set_states(&[5.0, 2.0]), OK);
        assert_eq!((it.terminate(), read()), (OK, 1));
        assert_eq!(it.get([Ball::H_DOT]), [2.0], "that of the final states");
    }
}

#[test]
fn invalid_times_states_and_lengths_are_refused() {
    for kind in EXCHANGED {
        let it = moving(kind);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            it.refuses("expected a finite number", |f| f.set_time(bad));
            it.refuses("expected finite numbers", |f| f.set_states(&[1.0, bad]));
        }
        for n in [0, 1, 3] {
            let values = &mut [7.0; 3][..n];
            let words = format!("has {n} elements; expected 2, the number of continuous states");
            it.refuses(&words, |f| f.set_states(values));
            for read in [Fmu::get_states, Fmu::get_derivatives, Fmu::get_nominals] {
                it.refuses(&words, |f| read(f, values));
            }
            assert_eq!(values, &[7.0; 3][..n]);
        }
    }
}

#[test]
fn samples_are_taken_at_their_instants_and_not_between() {
    for kind in EXCHANGED {
        let last = match kind.0 {
            Fmi2 => |f: &Instance| f.get([Sampled::TIMES + 2])[0],
            Fmi3 => |f: &Instance| f.get_all(Type::Float64, &[Sampled::TIMES], 3).1[2],
        };
        let samples = |f: &Instance| (last(f), f.read(Type::Int32, [Sampled::SAMPLES])[0]);
        let new = |ts, start| {
            let it = Instance::new(kind, SAMPLED);
            assert_eq!(it.set(Sampled::TS, ts), OK);
            it.start(start, None);
            it
        };
        let it = new(0.1, 0.0);
        assert_eq!(samples(&it).1, 0.0, "none at the initialization");
        for k in 0..500 {
            // 0.1 is no binary fraction, and hosts compute times with different rounding errors.
            let [now, next] = [0, 1].map(|n| f64::from(k + n) * 0.1);
            let jitter = if k % 2 == 0 { 1e-9 } else { -1e-9 };
            assert_eq!(it.set_time((now + jitter).max(0.0)), OK);
            assert_eq!([it.update(), it.update()], [(false, Some(next)); 2]);
            assert_eq!(samples(&it), (now, f64::from(k + 1)), "once");
            ok([it.set_time(now + 0.05)]);
            assert_eq!(it.update(), (false, Some(next)), "not due");
        }
        let missed = new(0.5, 1.0);
        missed.update();
        assert_eq!(missed.set_time(2.25), OK);
        assert_eq!(missed.update(), (false, Some(2.5)));
        assert_eq!(samples(&missed), (2.0, 3.0), "taken at the next event");
    }
}

#[test]
fn what_openmodelica_does_after_the_initialization_is_accepted() {
    for kind in EXCHANGED {
        let it = Instance::new(kind, BALL);
        it.start(0.0, None);
        for _ in 0..2 {
            ok([it.enter_event_mode(), it.enter_event_mode()]);
            it.says("event mode is entered in event mode");
            it.update();
            it.end_event_mode();
        }
        ok([it.enter_event_mode()]);
        assert_eq!(it.messages().len(), 1, "once");
        if kind.0 == Fmi2 {
            for _ in 0..2 {
                assert_eq!(it.set_states(&[2.0, -1.0]), OK);
                it.says("states are set in event mode");
            }
            assert_eq!(it.messages().len(), 2, "once");
            assert_eq!(it.get([Ball::H, Ball::V, Ball::H_DOT]), [2.0, -1.0, -1.0]);
        } else {
            it.refuses("is not allowed in the state", |f| f.set_states(&[2.0, -1.0]));
        }
    }
    for kind in KINDS {
        let it = Instance::running(kind, SAMPLED);
        if kind.1 != Exchanged {
            assert_eq!(it.set(Sampled::TS, 0.5), OK, "its value");
        }
        it.refuses("ts is a fixed parameter", |f| f.set(Sampled::TS, 0.25));
        assert_eq!(it.get([Sampled::TS]), [0.5]);
    }
}

#[test]
fn discrete_inputs_may_be_set_again_between_events_as_fmpy_does() {
    for kind in EXCHANGED {
        let it = Instance::running(kind, SWITCHES);
        let set = |value: f64| {
            let gear = (Type::Int32, Switches::GEAR);
            [(Type::Boolean, Switches::ON), gear, (Type::Float64, Switches::W)]
                .map(|(of, reference)| it.set_all(of, &[reference], &[value]))
        };
        ok(set(0.0));
        assert_eq!(set(1.0), [ERROR; 3]);
        it.says("w is not a continuous input; only those can be set between events");
        ok([it.enter_event_mode()]);
        ok(set(1.0));
        it.update();
        it.end_event_mode();
        ok(set(1.0));
    }
}

// --- derivatives --------------------------------------------------------------------------------

/// The outputs, states, derivatives and indicator of [`Ball`].
const UNKNOWNS: [u32; 6] =
    [Ball::H, Ball::V, Ball::H_DOT, Ball::V_DOT, Ball::CONTACT, Ball::ENERGY];

/// The derivatives of all unknowns with respect to a known, which the transposed matrix has, too.
#[track_caller]
fn column(f: Fmu, known: u32) -> [f64; 6] {
    let mut column = [f64::NAN; 6];
    ok([f.directional(&UNKNOWNS, &[known], &[1.0], &mut column)]);
    for (unknown, expected) in UNKNOWNS.into_iter().zip(column).filter(|_| f.kind.0 == Fmi3) {
        let mut found = [f64::NAN; 2];
        ok([f.adjoint(&[Ball::V, unknown], &[known, known], &[0.0, 1.0], &mut found)]);
        assert_eq!(found, [expected; 2]);
    }
    column
}

/// A ball with drag and drive, after its initialization.
fn dragged(kind: Kind) -> Instance {
    let it = Instance::new(kind, BALL);
    ok([it.set(Ball::DRAG, 0.25)]);
    it.run(0.0)
}

#[test]
fn directional_derivatives_are_those_at_the_states_or_at_the_communication_point() {
    for kind in PLAIN.into_iter().chain(EXCHANGED) {
        let (it, v) = (dragged(kind), -Ball::G / 8.0);
        match kind.1 {
            Exchanged => ok([it.set_time(0.125), it.set_states(&[0.5, v])]),
            _ => _ = it.steps(0.0, 0.125),
        }
        ok([it.set(Ball::DRIVE, 2.0)]);
        it.get(UNKNOWNS); // computes them in model exchange
        let before = it.snapshot();
        let check = || {
            assert_eq!(column(*it, Ball::H), [1.0, 0.0, 0.0, 0.0, 1.0, Ball::G]);
            assert_eq!(column(*it, Ball::V), [0.0, 1.0, 1.0, 0.5 * v, 0.0, v]);
            assert_eq!(column(*it, Ball::DRIVE), [0.0, 0.0, 0.0, 1.0, 0.0, 0.125]);
        };
        check();
        assert_eq!(it.snapshot(), before, "reading changes nothing");
        let (knowns, mut sum) = ([Ball::H, Ball::V, Ball::DRIVE], [f64::NAN]);
        ok([it.directional(&[Ball::ENERGY], &knowns, &[2.0, 1.0, 8.0], &mut sum)]);
        assert_eq!(sum, [2.0 * Ball::G + v + 1.0]);
        // An omitted known counts as zero.
        let mut none = [f64::NAN];
        ok([it.directional(&[Ball::ENERGY], &[], &[], &mut none)]);
        ok([it.directional(&[], &[Ball::H], &[1.0], &mut [])]);
        assert_eq!(none, [0.0]);
        ok([it.terminate()]);
        check();
    }
}

#[test]
fn the_start_value_of_an_output_is_kept_until_a_reset() {
    for kind in KINDS {
        let it = Instance::new(kind, HOPPER);
        let found = || it.get([Hopper::H, Hopper::V_DOT]);
        ok([it.set(Hopper::H, 2.0), it.enter(0.0, None, None)]);
        assert_eq!(found(), [2.0, -Hopper::G]);
        it.refuses("v is an output, which only the model sets", |f| f.set(Hopper::V, 1.0));
        let before = it.snapshot();
        ok([it.set(Hopper::H, 4.0), it.reset(), it.enter(0.0, None, None)]);
        assert_eq!(found(), [1.0, -Hopper::G]);
        it.resume(&before);
        ok([it.set(Hopper::DRIVE, 1.0)]);
        assert_eq!(found(), [2.0, 1.0 - Hopper::G]);
        ok([it.set(Hopper::H, 3.0), it.exit_initialization_mode()]);
        assert_eq!(it.get([Hopper::H]), [3.0]);
        if kind.1 != Exchanged {
            it.refuses("h is an output, which only the model sets", |f| f.set(Hopper::H, 2.0));
        }
    }
}

#[test]
fn initial_values_have_derivatives_with_respect_to_start_values() {
    for kind in PLAIN.into_iter().chain(EXCHANGED) {
        let it = Instance::new(kind, BALL);
        ok([it.set(Ball::H0, 3.0), it.set(Ball::DRIVE, 0.7), it.enter(0.0, None, None)]);
        it.get(UNKNOWNS); // computes them
        let before = it.snapshot();
        near(column(*it, Ball::H0), [1.0, 0.0, 0.0, 0.0, 1.0, Ball::G], 1e-9);
        near(column(*it, Ball::DRIVE), [0.0, 0.0, 0.0, 1.0, 0.0, 0.125], 1e-9);
        near(column(*it, Ball::RESTITUTION), [0.0; 6], 1e-9);
        assert_eq!(it.snapshot(), before);
    }
}

#[test]
fn invalid_directions_and_what_has_no_derivatives_are_refused() {
    let none = "drive is not an output, a state, a derivative or an event indicator";
    for (kind, is_initial) in pairs(&KINDS, &[false, true]) {
        let it = if is_initial { Instance::new(kind, BALL) } else { moving(kind) };
        if is_initial {
            ok([it.enter(0.0, None, None)]);
        }
        let mut result = [7.0; 2];
        for (unknown, known, seed, words) in [
            (Ball::DRIVE, Ball::H, 1.0, none),
            (Ball::RESTITUTION, Ball::H, 1.0, "restitution is not an"),
            (u32::MAX, Ball::H, 1.0, "is unknown"),
            (Ball::EVENTS, Ball::H, 1.0, "events is of type"),
            (Ball::H, Ball::ENERGY, 1.0, "energy is not an input"),
            (Ball::H, Ball::H_DOT, 1.0, "der(h) is not an input"),
            (Ball::H, Ball::EVENTS, 1.0, "events is not an input"),
            (Ball::H, Ball::SWITCH, 1.0, "switch is of type"),
            (Ball::H, Ball::H0, 1.0, "h0 is not an input or a state"),
            (Ball::H, Ball::RESTITUTION, 1.0, "restitution is not an input or a state"),
            (Ball::H, u32::MAX, 1.0, "is unknown"),
            (Ball::TIME, Ball::H, 1.0, "is unknown"),
            (Ball::H, Ball::TIME, 1.0, "is unknown"),
            (Ball::H, Ball::DRIVE, f64::NAN, "the direction contains NaN"),
            (Ball::H, Ball::DRIVE, f64::INFINITY, "inf"),
        ] {
            // Initial values depend on parameters and on the start time.
            if is_initial && [Ball::H0, Ball::RESTITUTION, Ball::TIME].contains(&known) {
                continue;
            }
            let (of, by, seed) = ([Ball::V, unknown], [Ball::DRIVE, known], [1.0, seed]);
            it.refuses(words, |f| f.directional(&of, &by, &seed, &mut result));
            if kind.0 == Fmi3 {
                it.refuses(words, |f| f.adjoint(&of, &by, &seed, &mut result));
            }
        }
        assert_eq!(result, [7.0; 2]);
        for n in [0, 2].into_iter().filter(|_| kind.0 == Fmi3) {
            let (of, by, seed) = ([Ball::ENERGY], [Ball::DRIVE], &mut [1.0; 2][..n]);
            let words = format!("values passed: {n}; expected 1");
            it.refuses(&words, |f| f.directional(&of, &by, seed, &mut [0.0]));
            it.refuses(&words, |f| f.directional(&of, &by, &[1.0], seed));
            it.refuses(&words, |f| f.adjoint(&of, &by, &[1.0], seed));
            it.refuses(&words, |f| f.adjoint(&of, &by, seed, &mut [0.0]));
        }
    }
    for (kind, model) in pairs(&PLAIN, &[EVERY, SAMPLED]) {
        let it = Instance::running(kind, model);
        it.refuses("the model has no derivatives", |f| {
            f.directional(&[0], &[0], &[1.0], &mut [0.0])
        });
    }
}

#[test]
fn a_derivative_between_steps_changes_nothing_and_is_never_discarded() {
    for kind in PLAIN {
        let it = Instance::running(kind, BALL);
        it.steps(0.0, 0.125);
        assert_eq!(it.set(Ball::DRIVE, 2.0), OK);
        let before = it.snapshot();
        let expected = [2.0 - Ball::G, 1.0 - Ball::G / 128.0];
        assert_eq!(it.get([Ball::V_DOT, Ball::CONTACT]), expected);
        let slopes =
            |f: Fmu, to: &mut [f64]| f.get_output_derivatives(&[Ball::V, Ball::H], &[1, 1], to);
        assert_eq!(it.two(slopes), [2.0 - Ball::G, -Ball::G / 8.0]);
        assert_eq!(it.snapshot(), before);
        for (trouble, words) in [(DIVERGE, "der(v) became NaN"), (DISCARD, "discarded")] {
            assert_eq!(it.set(Ball::TROUBLE, trouble), OK);
            it.refuses(words, |f| f.get_f64(&[Ball::V_DOT], &mut [0.0]));
            it.refuses(words, |f| slopes(f, &mut [0.0; 2]));
            assert_eq!(it.get([Ball::V]), [-Ball::G / 8.0]);
        }
        assert_eq!(it.set(Ball::TROUBLE, 0.0), OK);
        for (reference, order, words) in [
            (Ball::H, 0, "the derivative of h is of order 0; expected 1"),
            (Ball::H, 2, "of order 2"),
            (Ball::DRIVE, 1, "drive is not an output"),
            (Ball::ENERGY, 1, "the derivative of energy is not known"),
            (Ball::TIME, 1, "is unknown"),
        ] {
            it.refuses(words, |f| f.slopes(&[(Ball::V, 1), (reference, order)]));
        }
        it.steps(0.125, 0.125);
        assert_eq!(it.terminate(), OK);
        assert_eq!(it.get([Ball::H_DOT]), it.get([Ball::V]));
    }
    let three = Instance::running(PLAIN[1], BALL);
    let call = |f: Fmu| f.get_output_derivatives(&[Ball::V], &[1], &mut [0.0; 2]);
    three.refuses("values passed: 2; expected 1", call);
    let without_names = Instance::new(PLAIN[1], SAMPLED);
    ok([without_names.enter_configuration_mode(), without_names.set_u64(&[Sampled::M], &[0])]);
    ok([without_names.exit_configuration_mode()]);
    let of = [Sampled::NAMES, Sampled::Y];
    let call = |f: Fmu| f.get_output_derivatives(&of, &[2, 2], &mut [0.0]);
    without_names.run(0.0).refuses("the derivative of y is of order 2", call);
}
