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
        let mut indicator = [0.0];
        assert_eq!((it.get_indicators(&mut indicator), indicator), (OK, [2.0]));
        // States and derivatives are variables, too.
        let references = [Ball::H, Ball::V, Ball::H_DOT, Ball::V_DOT, Ball::CONTACT];
        assert_eq!(it.get(references), [2.0, -3.0, -3.0, -8.25, 2.0]);
        assert_eq!(it.get([Ball::ENERGY]), [19.5 + 4.5 + 0.1875]);
        // CasADi sets states one by one.
        assert_eq!(it.set(Ball::H, 5.0), OK);
        assert_eq!(it.two(Fmu::get_states), [5.0, -3.0]);
        assert_eq!((it.get_indicators(&mut indicator), indicator), (OK, [5.0]));
        it.refuses("is a local variable", |f| f.set(Ball::H_DOT, 0.0));
        let words = "restitution is not a continuous input";
        it.refuses(words, |f| f.set(Ball::RESTITUTION, 0.5));
        let mut flags = [7; 2];
        assert_eq!((it.completed_step(&mut flags), flags), (OK, [0; 2]));
        // A model without states has none.
        let s = Instance::running(kind, SAMPLED);
        ok([s.get_states(&mut []), s.get_derivatives(&mut [])]);
        ok([s.get_nominals(&mut []), s.get_indicators(&mut [])]);
    }
    let (it, mut states, mut indicators) = (moving(EXCHANGED[1]), 7, 7);
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
            assert_eq!(it.get_indicators(&mut [0.0]), OK);
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
        let words = "expected 1, the number of event indicators";
        it.refuses(words, |f| f.get_indicators(&mut [0.0; 2]));
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
            let it = Instance::of(kind, SAMPLED);
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
        let it = Instance::of(kind, BALL);
        it.start(0.0, None);
        if kind.0 == Fmi2 {
            assert_eq!(it.set_states(&[2.0, -1.0]), OK);
            it.says("states are set in event mode");
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

// --- derivatives --------------------------------------------------------------------------------

#[test]
fn directional_derivatives_are_those_of_the_equations() {
    for kind in EXCHANGED {
        let it = Instance::of(kind, BALL);
        assert_eq!(it.set(Ball::DRAG, 0.25), OK);
        let it = it.run(0.0);
        let unknowns: [u32; 6] = std::array::from_fn(|k| Ball::H + k as u32);
        let at = |[h, v, drive]: [f64; 3]| {
            ok([it.set_states(&[h, v]), it.set(Ball::DRIVE, drive)]);
            it.get(unknowns)
        };
        let point = [2.0, -3.0, 1.5];
        for (k, known) in [Ball::H, Ball::V, Ball::DRIVE].into_iter().enumerate() {
            // Central differences, which are exact for polynomials of degree 2.
            let ends = [0.125, -0.125].map(|change| {
                let mut end = point;
                end[k] += change;
                at(end)
            });
            ok([it.set_states(&point[..2]), it.set(Ball::DRIVE, point[2])]);
            let expected: [f64; 6] = std::array::from_fn(|i| (ends[0][i] - ends[1][i]) / 0.25);
            let mut found = [f64::NAN; 6];
            let status = it.directional(&unknowns, &[known], &[1.0], &mut found);
            assert_eq!((status, found), (OK, expected), "{known}");
        }
        let (knowns, mut sum) = ([Ball::H, Ball::V, Ball::DRIVE], [f64::NAN]);
        let status = it.directional(&[Ball::ENERGY], &knowns, &[2.0, 1.0, 8.0], &mut sum);
        assert_eq!((status, sum), (OK, [2.0 * Ball::G - 3.0 + 1.0]));
        let none = "drive is not an output, a state, a derivative or an event indicator";
        for (unknown, known, words) in [
            (Ball::DRIVE, Ball::H, none),
            (Ball::H_DOT, Ball::H_DOT, "der(h) is not an input or a"),
            (Ball::H_DOT, Ball::ENERGY, "is not an input or a state"),
            (Ball::EVENTS, Ball::H, "events is of type"),
        ] {
            it.refuses(words, |f| f.slope(unknown, known, 1.0));
        }
    }
}

#[test]
fn directional_derivatives_of_co_simulation_are_those_at_the_communication_point() {
    for kind in PLAIN {
        let it = Instance::of(kind, BALL);
        assert_eq!(it.set(Ball::DRAG, 0.25), OK);
        let it = it.run(0.0);
        it.steps(0.0, 0.125);
        assert_eq!(it.set(Ball::DRIVE, 2.0), OK);
        let before = it.snapshot();
        let v = -Ball::G / 8.0;
        let unknowns: [u32; 6] = std::array::from_fn(|k| Ball::H + k as u32);
        let expected = [
            (Ball::H, [1.0, 0.0, 0.0, 0.0, 1.0, Ball::G]),
            (Ball::V, [0.0, 1.0, 1.0, 0.5 * v, 0.0, v]),
            (Ball::DRIVE, [0.0, 0.0, 0.0, 1.0, 0.0, 0.125]),
        ];
        let check = |f: Fmu| {
            for (known, expected) in expected {
                let mut found = [f64::NAN; 6];
                let status = f.directional(&unknowns, &[known], &[1.0], &mut found);
                assert_eq!((status, found), (OK, expected), "{known}");
            }
        };
        check(*it);
        assert_eq!(it.snapshot(), before, "reading changes nothing");
        // An omitted known counts as zero.
        let mut none = [f64::NAN];
        ok([it.directional(&[Ball::ENERGY], &[], &[], &mut none)]);
        assert_eq!(none, [0.0]);
        assert_eq!(it.directional(&[], &[Ball::H], &[1.0], &mut []), OK);
        let mut result = [7.0; 2];
        for (unknown, known, seed, words) in [
            (Ball::DRIVE, Ball::H, 1.0, "drive is not an output"),
            (Ball::RESTITUTION, Ball::H, 1.0, "restitution is not an"),
            (u32::MAX, Ball::H, 1.0, "is unknown"),
            (Ball::H, Ball::ENERGY, 1.0, "energy is not an input"),
            (Ball::H, Ball::H0, 1.0, "h0 is not an input"),
            (Ball::H, u32::MAX, 1.0, "is unknown"),
            (Ball::H, Ball::DRIVE, f64::NAN, "the direction contains NaN"),
            (Ball::H, Ball::DRIVE, f64::INFINITY, "inf"),
        ] {
            let (of, by, seed) = ([Ball::V, unknown], [Ball::DRIVE, known], [1.0, seed]);
            it.refuses(words, |f| f.directional(&of, &by, &seed, &mut result));
        }
        assert_eq!(result, [7.0; 2]);
        assert_eq!(it.terminate(), OK);
        check(*it);
        for without in [LISTS, EVERY, SAMPLED] {
            let it = Instance::running(kind, without);
            it.refuses("the model has no derivatives", |f| f.slope(0, 0, 1.0));
        }
    }
}

#[test]
fn initial_values_have_derivatives_with_respect_to_start_values() {
    for kind in PLAIN.into_iter().chain(EXCHANGED) {
        let it = Instance::of(kind, BALL);
        ok([it.set(Ball::H0, 3.0), it.set(Ball::DRIVE, 0.7)]);
        assert_eq!(it.enter(0.0, None, None), OK);
        let unknowns: [u32; 6] = std::array::from_fn(|k| Ball::H + k as u32);
        it.get(unknowns); // computes them
        let before = it.snapshot();
        for (known, expected) in [
            (Ball::H0, [1.0, 0.0, 0.0, 0.0, 1.0, Ball::G]),
            (Ball::DRIVE, [0.0, 0.0, 0.0, 1.0, 0.0, 0.125]),
            (Ball::RESTITUTION, [0.0; 6]),
        ] {
            let mut found = [f64::NAN; 6];
            let status = it.directional(&unknowns, &[known], &[2.0], &mut found);
            assert_eq!(status, OK);
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - 2.0 * expected).abs() < 1e-9, "{known}: {found}");
            }
        }
        assert_eq!(it.snapshot(), before);
    }
}

#[test]
fn adjoint_and_directional_derivatives_are_those_of_one_matrix() {
    let exchange = Instance::of(EXCHANGED[1], BALL);
    assert_eq!(exchange.set(Ball::DRAG, 0.5), OK);
    let exchange = exchange.run(0.0);
    assert_eq!(exchange.set_states(&[1.0, -3.0]), OK);
    let stepped = Instance::running(PLAIN[1], BALL);
    stepped.steps(0.0, 0.25);
    let all: [u32; 6] = std::array::from_fn(|k| Ball::H + k as u32);
    for (it, unknowns, knowns) in [
        (exchange, &all[..], &[Ball::V, Ball::DRIVE, Ball::H][..]),
        (stepped, &[Ball::ENERGY, Ball::H], &[Ball::DRIVE]),
    ] {
        let unit = |n, k| (0..n).map(|i| f64::from(i == k)).collect::<Vec<f64>>();
        let (n, m) = (unknowns.len(), knowns.len());
        let mut sum = 0.0;
        for (row, column) in (0..n).flat_map(|row| (0..m).map(move |column| (row, column))) {
            let (mut forward, mut back) = (vec![f64::NAN; n], vec![f64::NAN; m]);
            let seed = unit(m, column);
            assert_eq!(it.directional(unknowns, knowns, &seed, &mut forward), OK);
            assert_eq!(it.adjoint(unknowns, knowns, &unit(n, row), &mut back), OK);
            assert_eq!(forward[row], back[column]);
            sum += forward[row].abs();
        }
        assert!(sum > 0.0);
        for (unknown, known, words) in [
            (Ball::DRIVE, Ball::DRIVE, "drive is not an output"),
            (Ball::ENERGY, Ball::ENERGY, "energy is not an input"),
            (Ball::TIME, Ball::DRIVE, "is unknown"),
            (Ball::ENERGY, Ball::TIME, "is unknown"),
        ] {
            it.refuses(words, |f| f.slope(unknown, known, 1.0));
            it.refuses(words, |f| f.adjoint_slope(unknown, known, 1.0));
        }
        let (energy, drive) = ([Ball::ENERGY], [Ball::DRIVE]);
        let words = "the direction contains NaN";
        let seed = f64::NAN;
        it.refuses(words, |f| f.adjoint(&energy, &drive, &[seed], &mut [0.0]));
        for n in [0, 2] {
            let words = format!("there are {n} values; expected 1");
            let seed = &mut [1.0; 2][..n];
            it.refuses(&words, |f| f.directional(&energy, &drive, seed, &mut [0.0]));
            it.refuses(&words, |f| f.adjoint(&energy, &drive, &[1.0], seed));
        }
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
    three.refuses("there are 2 values; expected 1", call);
}
