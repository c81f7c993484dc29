//! Steps that the host sees into: with event mode, early return or intermediate updates (FMI 3.0.2,
//! section 4.2).

use super::calls::DO_STEP;
use super::instance::Functions;
use super::{Callback, fmi3Boolean, fmi3False, fmi3Float64, fmi3Instance, fmi3Status, fmi3True};
use crate::component::{Component, Outcome};
use crate::instance::{component, functions};
use crate::lifecycle::Mode;
use crate::phase::Phase;

/// What `fmi3DoStep` returns besides its status.
#[derive(Debug, Clone, Copy)]
pub(super) struct Results {
    event_handling_needed: bool,
    early_return: bool,
    last_successful_time: f64,
}

impl Results {
    /// Those of a step without events that ended at the given time.
    #[inline(always)]
    pub(super) fn plain(last_successful_time: f64) -> Self {
        Self {
            event_handling_needed: false,
            early_return: false,
            last_successful_time,
        }
    }

    /// Writes the results to where the host wants them; some hosts pass NULL.
    ///
    /// # Safety
    /// The pointers are NULL or writable.
    #[inline(always)]
    pub(super) unsafe fn write(
        self,
        event_handling_needed: *mut fmi3Boolean,
        terminate_simulation: *mut fmi3Boolean,
        early_return: *mut fmi3Boolean,
        last_successful_time: *mut fmi3Float64,
    ) {
        // SAFETY: the caller's promise.
        unsafe {
            put(event_handling_needed, self.event_handling_needed.into());
            put(terminate_simulation, fmi3False);
            put(early_return, self.early_return.into());
            put(last_successful_time, self.last_successful_time);
        }
    }
}

/// # Safety
/// The pointer is NULL or writable.
#[inline(always)]
unsafe fn put<T>(pointer: *mut T, value: T) {
    if !pointer.is_null() {
        // SAFETY: not NULL, and writable by the caller's promise.
        unsafe { pointer.write(value) };
    }
}

/// `fmi3DoStep`
///
/// # Safety
/// As for all [`Functions`]. The host's callback may call functions of the instance, therefore no
/// reference to it is held meanwhile.
pub(super) unsafe extern "C" fn do_step(
    instance: fmi3Instance,
    time: fmi3Float64,
    step: fmi3Float64,
    _no_set_fmu_state_prior_to_current_point: fmi3Boolean,
    event_handling_needed: *mut fmi3Boolean,
    terminate_simulation: *mut fmi3Boolean,
    early_return: *mut fmi3Boolean,
    last_successful_time: *mut fmi3Float64,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    let (outcome, results) = unsafe { advance(instance, time, step) };
    // SAFETY: the caller's promise.
    unsafe {
        results.write(
            event_handling_needed,
            terminate_simulation,
            early_return,
            last_successful_time,
        );
    }
    outcome.into()
}

/// Where a part of a step ends.
#[derive(Debug, Clone, Copy, PartialEq)]
enum End {
    /// At an event.
    Event,
    /// At an internal point, where the host is called back.
    Internal,
    /// At the end of the communication step.
    Step,
}

/// # Safety
/// As [`do_step`].
unsafe fn advance(instance: fmi3Instance, time: f64, step: f64) -> (Outcome, Results) {
    // SAFETY: the caller's promise.
    let Some(options) = (unsafe { functions::<Functions>(instance) })
        .map(|functions| unsafe { &*(functions.options)(instance) })
    else {
        return (Outcome::Error, Results::plain(time));
    };
    // Copied, as the options belong to the instance.
    let (callback, may_return) = (options.intermediate_update, options.early_return_allowed);
    // SAFETY: the caller's promise, here and below; each reference ends before the callback.
    let borrow = || unsafe { component::<Functions>(instance) };
    let Some(c) = borrow() else {
        return (Outcome::Error, Results::plain(time));
    };
    if let Some(outcome) = c.refuse_step(&DO_STEP, time, step) {
        return (outcome, Results::plain(c.lifecycle.now()));
    }
    let has_events = c.lifecycle.mode == Mode::CoSimulationWithEvents;
    // Times that differ less are equal: their rounding errors differ, and those of hosts add up.
    let tolerance = 1e-6 * step + 8.0 * f64::EPSILON * time.abs();
    let (full, mut end) = (time + step, time + step);
    let is_early = |now| now < full - tolerance;
    let mut now = time;
    let parts = Parts::new(c, callback, time, step);
    let mut k = 1;
    loop {
        let Some(c) = borrow() else {
            return (Outcome::Error, Results::plain(now));
        };
        let (mut to, mut reason) = (end, End::Step);
        let internal = parts.point(k);
        if internal < end - tolerance {
            (to, reason) = (internal, End::Internal);
        }
        let event = match c.next_event(&DO_STEP, now) {
            Ok(event) => event,
            Err(outcome) => return (outcome, Results::plain(now)),
        };
        if let Some(event) = event
            && event <= to + tolerance
        {
            // A step that ends at an event ends exactly where the host wants it.
            let is_end = event >= end - tolerance;
            (to, reason) = (if is_end { end } else { event.max(now) }, End::Event);
        }
        let outcome = c.take_part(&DO_STEP, now, to - now, has_events);
        if outcome != Outcome::Ok {
            return failed(c, outcome, time);
        }
        now = to;
        let is_end = now >= end - tolerance;
        if reason == End::Event {
            // Without early return, events within the step are handled here.
            if is_end || may_return {
                let results = Results {
                    event_handling_needed: true,
                    early_return: is_early(now),
                    last_successful_time: now,
                };
                return (Outcome::Ok, results);
            }
            let outcome = c.handle_event(&DO_STEP, now);
            if outcome != Outcome::Ok {
                return failed(c, outcome, time);
            }
            if internal > now + tolerance {
                continue;
            }
        }
        k += 1;
        let mut requested_end = None;
        if let Some(callback) = callback {
            let can_return = may_return && !is_end;
            // SAFETY: the caller's promise; no reference to the instance is alive.
            requested_end = match unsafe { call_back(instance, callback, now, is_end, can_return) }
            {
                Ok(requested) => requested,
                Err(outcome) => return (outcome, Results::plain(now)),
            };
        }
        if let Some(requested) = requested_end {
            end = requested.clamp(now, end);
        }
        if is_end || end <= now + tolerance {
            let results = Results {
                early_return: is_early(now),
                ..Results::plain(now)
            };
            return (Outcome::Ok, results);
        }
    }
}

/// What a step from `start` returns when a part of it failed.
fn failed(component: &mut Component, outcome: Outcome, start: f64) -> (Outcome, Results) {
    let now = component.lifecycle.now();
    let outcome = match now > start {
        true => component.fail_part(outcome),
        false => outcome,
    };
    (outcome, Results::plain(now))
}

/// The internal points of a step, where the host is called back: equal parts, at most as long as the
/// step of the model's default experiment.
struct Parts {
    start: f64,
    step: f64,
    count: f64,
}

impl Parts {
    fn new(component: &Component, callback: Option<Callback>, start: f64, step: f64) -> Self {
        const MAX: f64 = 1e6;
        let longest = component.slave.default_step();
        let count = match callback {
            Some(_) if component.slave.is_continuous() => libm::ceil(step / longest - 1e-6),
            _ => 1.0,
        };
        Self {
            start,
            step,
            count: count.clamp(1.0, MAX),
        }
    }

    /// The `k`-th point, from 1.
    fn point(&self, k: u32) -> f64 {
        self.start + self.step * (f64::from(k) / self.count)
    }
}

/// Calls the host in intermediate update mode. Returns the time of an early return that it requests, or
/// the outcome of the step if a call of the host broke the instance.
///
/// # Safety
/// As [`do_step`]; no reference to the instance is alive.
unsafe fn call_back(
    instance: fmi3Instance,
    callback: Callback,
    time: f64,
    is_end: bool,
    can_return_early: bool,
) -> Result<Option<f64>, Outcome> {
    // SAFETY: the caller's promise; each reference ends before the callback.
    let borrow = || unsafe { component::<Functions>(instance) }.ok_or(Outcome::Error);
    borrow()?.enter(Phase::IntermediateUpdate);
    let (mut requested, mut return_time) = (fmi3False, time);
    // SAFETY: the host provides this function to be called with these C types (FMI 3.0.2, section
    // 4.2.2); the pointers are valid during the call.
    unsafe {
        (callback.function)(
            callback.environment,
            time,
            if is_end { fmi3False } else { fmi3True },
            fmi3True,
            fmi3True,
            can_return_early.into(),
            &raw mut requested,
            &raw mut return_time,
        );
    }
    let c = borrow()?;
    match c.lifecycle.phase {
        Phase::IntermediateUpdate => c.enter(Phase::StepComplete),
        Phase::Fatal => return Err(Outcome::Fatal),
        _ => return Err(Outcome::Error),
    }
    let is_requested = can_return_early && requested != fmi3False && return_time.is_finite();
    Ok(is_requested.then_some(return_time))
}
