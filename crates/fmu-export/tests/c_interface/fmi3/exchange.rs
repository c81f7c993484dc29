//! Model exchange of FMI 3.0; its equations are tested with FMI 2.0.

use std::ptr::null_mut;

use fmu_export::fmi3::*;
use fmu_export::fmi3::{fmi3Discard, fmi3Error, fmi3OK};

use super::host::{Fmu, Instance, Kind::*};
use crate::models::*;

/// A ball in continuous-time mode.
fn moving() -> Instance {
    let instance = Instance::new(ModelExchange).started(0.0);
    assert_eq!(instance.update(), (false, Some(Ball::KICK)));
    assert_eq!(instance.enter_continuous_time_mode(), fmi3OK);
    instance
}

#[test]
fn the_functions_are_those_of_the_equations() {
    let instance = moving();
    let (mut states, mut indicators) = (7, 7);
    assert_eq!(instance.count_states(&mut states), fmi3OK);
    assert_eq!(instance.count_indicators(&mut indicators), fmi3OK);
    assert_eq!((states, indicators), (2, 1));
    assert_eq!(instance.set_time(0.25), fmi3OK);
    assert_eq!(instance.set_states(&[-2.0, -3.0]), fmi3OK);
    assert_eq!(instance.set(Ball::DRIVE, 1.5), fmi3OK);
    assert_eq!(instance.two(Fmu::get_states), [-2.0, -3.0]);
    assert_eq!(instance.two(Fmu::get_derivatives), [-3.0, 1.5 - Ball::G]);
    assert_eq!(instance.two(Fmu::get_nominals), [10.0, 1.0]);
    let mut indicator = [0.0];
    assert_eq!(instance.get_indicators(&mut indicator), fmi3OK);
    assert_eq!(indicator, [-2.0]);
    let (mut event, mut terminate) = (7, 7);
    assert_eq!(
        instance.completed_integrator_step(&mut event, &mut terminate),
        fmi3OK
    );
    assert_eq!((event, terminate), (fmi3False, fmi3False));
    assert_eq!(instance.enter_event_mode(), fmi3OK);
    assert_eq!(instance.update(), (true, Some(Ball::KICK)));
    assert_eq!(instance.two(Fmu::get_states), [-2.0, 1.5]);
    assert_eq!(instance.two(Fmu::get_derivatives)[0], 1.5);
}

#[test]
fn invalid_arguments_are_refused() {
    let instance = moving();
    let i = instance.0;
    instance.refuses(&["expected a finite number"], |f| f.set_time(f64::NAN));
    instance.refuses(&["expected finite numbers"], |f| {
        f.set_states(&[1.0, f64::INFINITY])
    });
    instance.refuses(&["has 1 elements; expected 2"], |f| f.set_states(&[1.0]));
    instance.refuses(&["has 3 elements; expected 2"], |f| {
        f.get_derivatives(&mut [0.0; 3])
    });
    instance.refuses(&["restitution is not a continuous input"], |_| {
        assert_eq!(
            instance.set_i32(&[Ball::SWITCH], &[1]),
            fmi3Error,
            "not in this mode"
        );
        instance.forget_messages();
        instance.set(Ball::RESTITUTION, 0.25)
    });
    // SAFETY: the instance lives, and NULL is refused.
    unsafe {
        let n = null_mut();
        instance.refuses(&["a pointer to a result is NULL"], |_| {
            fmi3GetNumberOfContinuousStates(i, null_mut())
        });
        instance.refuses(&["a pointer to a result is NULL"], |_| {
            fmi3CompletedIntegratorStep(i, 1, &mut 0, n)
        });
        assert_eq!(instance.enter_event_mode(), fmi3OK);
        instance.refuses(&["a pointer to a result is NULL"], |_| {
            fmi3UpdateDiscreteStates(i, &mut 0, n, &mut 0, &mut 0, &mut 0, &mut 0.0)
        });
        instance.refuses(&["a pointer to a result is NULL"], |_| {
            fmi3UpdateDiscreteStates(i, &mut 0, &mut 0, &mut 0, &mut 0, &mut 0, null_mut())
        });
    }
}

#[test]
fn failed_evaluations_can_be_repeated() {
    let instance = moving();
    for trouble in [DISCARD, DIVERGE] {
        assert_eq!(instance.set(Ball::TROUBLE, trouble), fmi3OK);
        assert_eq!(instance.get_derivatives(&mut [0.0; 2]), fmi3Discard);
        assert_eq!(instance.get_f64(&[Ball::V_DOT], &mut [0.0]), fmi3Discard);
        assert_eq!(instance.set(Ball::TROUBLE, 0.0), fmi3OK);
        assert_eq!(instance.two(Fmu::get_derivatives), [0.0, -Ball::G]);
    }
    assert_eq!(instance.set(Ball::TROUBLE, BREAK), fmi3OK);
    assert_eq!(instance.get_derivatives(&mut [0.0; 2]), fmi3Error);
    assert_eq!(instance.set(Ball::TROUBLE, 0.0), fmi3Error);
    assert_eq!(instance.reset(), fmi3OK);
}

#[test]
fn a_sampled_model_acts_at_its_events() {
    let instance = Instance::of(ModelExchange, SAMPLED).started(0.0);
    for k in 0..10 {
        let time = f64::from(k) * 0.5;
        assert_eq!(instance.set_time(time), fmi3OK);
        assert_eq!(instance.update(), (false, Some(time + 0.5)));
        let mut times = [0.0; 3];
        assert_eq!(instance.get_f64(&[3], &mut times), fmi3OK);
        assert_eq!(times[2], time);
    }
}
