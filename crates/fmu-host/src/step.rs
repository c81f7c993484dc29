//! The three calls of every step, without a [`Result`] in the usual case: the compiler keeps nothing of it but a
//! comparison.

use std::ffi::c_int;
use std::ops::Range;

use fmi_abi::FmiVersion;
use fmi_abi::fmi3::fmi3False;

use crate::functions::{Fmi2, Fmi3};
use crate::instance::Instance;
use crate::library::Library;
use crate::outcome::{Result, Success};
use crate::quick::{Access, NotOk, Quick, StepVariables};
use crate::types::{StepResult, at_the_end};

/// The result of a call that is not quick, as of a WebAssembly component.
fn slowly(result: Result) -> NotOk {
    match result {
        Ok(Success::Ok) => None,
        other => Some(Box::new(other)),
    }
}

/// The names of a function in both versions.
type Functions = [&'static str; 2];

const SET: &Functions = &["fmi2SetReal", "fmi3SetFloat64"];
const GET: &Functions = &["fmi2GetReal", "fmi3GetFloat64"];

/// Defines the access at steps.
macro_rules! access {
    ($($name:ident(&$($mut:ident)? [f64] as $pointer:ident) = $access:ident by $slow:ident, $functions:expr;)*) => { $(
        #[doc = concat!("[`Instance::", stringify!($slow), "`] of the variables of [`Instance::access_at_steps`].")]
        ///
        /// # Panics
        /// The list of values is too short.
        #[inline(always)]
        pub fn $name(&mut self, values: &$($mut)? [f64]) -> NotOk {
            #[cold]
            #[inline(never)]
            fn slow(instance: &mut Instance, values: &$($mut)? [f64]) -> NotOk {
                let StepVariables { references, place, .. } = instance.quick.$access.listed.clone();
                let values = &$($mut)? values[place];
                if references.is_empty() { None } else { slowly(instance.$slow(&references, values)) }
            }
            let access = &self.quick.$access;
            let Range { start, end } = access.listed.place;
            if end > values.len() {
                return slow(self, values);
            }
            // SAFETY: the function is one of this instance, and the values are there, by the check.
            match unsafe { access.call(self.handle.pointer, values.$pointer().add(start)) } {
                Some(status) => self.not_ok($functions, status),
                None => slow(self, values),
            }
        }
    )* };
}

impl Instance {
    /// Says which variables every step sets and gets.
    pub fn access_at_steps(&mut self, set: StepVariables, get: StepVariables) {
        #[cfg(feature = "sandbox")]
        if let Some(component) = &mut self.handle.component {
            component.access_at_steps(&set, &get);
        }
        let Library { fmi2, fmi3, .. } = &*self.handle.library;
        let set = Access::new(set, fmi2.fmi2SetReal, fmi3.fmi3SetFloat64);
        let get = Access::new(get, fmi2.fmi2GetReal, fmi3.fmi3GetFloat64);
        let values = set.end().max(get.end());
        self.quick = Quick { set, get, values };
    }

    access! {
        set_at_step(&[f64] as as_ptr) = set by set_float64, SET;
        get_at_step(&mut [f64] as as_mut_ptr) = get by get_float64, GET;
    }

    /// [`Instance::do_step`] for steps.
    #[inline(always)]
    pub fn do_step_quickly(&mut self, time: f64, step: f64) -> NotOk {
        match (self.handle.library.fmi2.fmi2DoStep, self.handle.version) {
            (Some(do_step), _) => {
                // SAFETY: the function is one of the library of this instance, which is not freed.
                let status =
                    unsafe { do_step(self.handle.pointer, time, step, (!self.is_saved).into()).0 };
                self.not_ok(&["fmi2DoStep"; 2], status)
            }
            (_, FmiVersion::Fmi3) => self.step_to_the_end(time, step),
            _ => {
                let no_set_state = !self.is_saved;
                slowly(Fmi2(&mut self.handle).do_step(time, step, no_set_state))
            }
        }
    }

    /// Makes the calls of a step, with inputs in a list of their own or in the list of the outputs: sets variables, takes the
    /// step and gets variables, until one is not plainly successful. Calls `begin` with the number of each, from 0,
    /// before it. Returns how many were made, and the result of the last one: none if the lists are too short or a
    /// function must be looked up.
    #[inline(always)]
    pub fn cycle(
        &mut self,
        inputs: Option<&[f64]>,
        time: f64,
        step: f64,
        outputs: &mut [f64],
        begin: impl Fn(usize),
    ) -> (usize, NotOk) {
        let Quick { set, get, values } = &self.quick;
        let is_long = match inputs {
            None => outputs.len() >= *values,
            Some(inputs) => inputs.len() >= set.end() && outputs.len() >= get.end(),
        };
        if !is_long {
            #[cfg(feature = "sandbox")]
            {
                begin(1);
                return self.cycle_of_component(inputs, time, step, outputs);
            }
            #[cfg(not(feature = "sandbox"))]
            return (0, None);
        }
        if !set.is_nothing() {
            let values = inputs.unwrap_or(outputs).as_ptr();
            begin(0);
            // SAFETY: the function is one of this instance, and the values are there, by the check.
            let status =
                unsafe { set.call(self.handle.pointer, values.add(set.listed.place.start)) };
            if let Some(not_ok) = self.not_ok(SET, status.unwrap_or_default()) {
                return (1, Some(not_ok));
            }
        }
        begin(1);
        if let Some(not_ok) = self.do_step_quickly(time, step) {
            return (2, Some(not_ok));
        }
        let Quick { get, .. } = &self.quick;
        if get.is_nothing() {
            return (3, None);
        }
        begin(2);
        // SAFETY: as above.
        let status = unsafe {
            get.call(self.handle.pointer, outputs.as_mut_ptr().add(get.listed.place.start))
        };
        (3, self.not_ok(GET, status.unwrap_or_default()))
    }

    /// [`Instance::cycle`] of a component of `fmu-export`, in one call, unless calls are observed.
    #[cfg(feature = "sandbox")]
    #[inline(never)]
    fn cycle_of_component(
        &mut self,
        inputs: Option<&[f64]>,
        time: f64,
        step: f64,
        outputs: &mut [f64],
    ) -> (usize, NotOk) {
        let is_observed = self.handle.observer.is_some();
        let how = (time, step, !self.is_saved);
        let component = self.handle.component.as_mut().filter(|c| !is_observed && c.has_cycle());
        let Some((calls, status, stepped)) = component.and_then(|c| c.cycle(inputs, how, outputs))
        else {
            return (0, None);
        };
        let function = ["fmi3SetFloat64", "fmi3DoStep", "fmi3GetFloat64"][calls - 1];
        let not_ok = match self.handle.library.outcome(function, status.0) {
            Ok(done) if calls == 2 => at_the_end(done, stepped),
            other => slowly(other),
        };
        (calls, not_ok)
    }

    /// `fmi2DoStep`, `fmi3DoStep`, with `noSetFMUStatePriorToCurrentPoint` true unless a state was saved. A step
    /// that ends early or asks to end the simulation has failed.
    pub fn do_step(&mut self, time: f64, step: f64) -> Result {
        self.do_step_quickly(time, step).map_or(Ok(Success::Ok), |other| *other)
    }

    /// As [`Instance::do_step`], of a step that may end early.
    ///
    /// # Errors
    /// As for every call: the function is missing or returned a failure status.
    pub fn do_step_to_event(&mut self, time: f64, step: f64) -> Result<(Success, StepResult)> {
        self.step(time, step, !self.is_saved)
    }

    #[inline(never)]
    fn step_to_the_end(&mut self, time: f64, step: f64) -> NotOk {
        let (done, stepped) = match self.step(time, step, !self.is_saved) {
            Ok(done) => done,
            Err(failure) => return Some(Box::new(Err(failure))),
        };
        at_the_end(done, stepped)
    }

    /// `fmi2DoStep`, `fmi3DoStep`; the flag is `noSetFMUStatePriorToCurrentPoint`.
    #[inline]
    pub fn step(
        &mut self,
        time: f64,
        step: f64,
        no_set_state: bool,
    ) -> Result<(Success, StepResult)> {
        let [mut event, mut terminate, mut early] = [fmi3False; 3];
        let mut last = match self.handle.version {
            FmiVersion::Fmi2 => time + step,
            FmiVersion::Fmi3 => time,
        };
        let (of_event, of_end, of_early) = (&mut event, &mut terminate, &mut early);
        let done = match self.handle.version {
            FmiVersion::Fmi2 => Fmi2(&mut self.handle).do_step(time, step, no_set_state),
            FmiVersion::Fmi3 => {
                let (flag, last) = (no_set_state, &mut last);
                Fmi3(&mut self.handle).do_step(time, step, flag, of_event, of_end, of_early, last)
            }
        }?;
        let stepped = StepResult {
            event_handling_needed: event != fmi3False,
            terminate: terminate != fmi3False,
            early_return: early != fmi3False,
            last_successful_time: last,
        };
        Ok((done, stepped))
    }

    /// The names are passed as one static reference, so that nothing must be kept across the call.
    #[inline(always)]
    fn not_ok(&self, functions: &'static Functions, status: c_int) -> NotOk {
        match status {
            0 => None,
            _ => Some(self.boxed(functions, status)),
        }
    }

    #[cold]
    fn boxed(&self, functions: &'static Functions, status: c_int) -> Box<Result> {
        Box::new(self.handle.library.outcome(functions[self.handle.version as usize], status))
    }
}
