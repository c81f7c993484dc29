//! Walks through the states of an instance: every call is checked against the standard.

use std::ffi::c_void;
use std::ptr::null_mut;

use fmu_export::fmi2::{fmi2LastSuccessfulTime, fmi2Terminated};
use proptest::sample::Index;

use crate::driver::*;
use crate::models::*;
use crate::standard::*;

/// A call of a walk.
#[derive(Debug, Clone)]
pub enum Call {
    /// A function of the version, by its index.
    Any(Index),
    /// The function of an operation.
    Named(&'static str),
    /// Sets `trouble` or `fault` of [`Ball`].
    Trouble(u32, f64),
    Save,
    Restore(Index),
}

impl Call {
    fn operation(&self, version: FmiVersion) -> &'static str {
        match self {
            Self::Any(index) => index.get(functions(version)).operation,
            Self::Named(operation) => operation,
            Self::Trouble(..) => "set_float64",
            Self::Save => "get_fmu_state",
            Self::Restore(_) => "set_fmu_state",
        }
    }
}

/// What the calls so far have led to.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// A letter of the table of states.
    state: char,
    /// The end of the last step.
    time: f64,
    /// `trouble` and `fault` of [`Ball`].
    troubles: [f64; 2],
}

const START: Place = Place { state: 'I', time: 0.0, troubles: [0.0; 2] };

/// An instance of [`Ball`] or [`Sampled`], and where it is.
pub struct Walk {
    pub it: Instance,
    model: usize,
    place: Place,
    /// The bytes of the new instance.
    fresh: Vec<u8>,
    saved: Vec<(*mut c_void, Place)>,
}

impl Drop for Walk {
    fn drop(&mut self) {
        let other = Instance::new(self.it.kind, self.model);
        for (mut state, _) in self.saved.drain(..) {
            other.free_state(&mut state);
        }
    }
}

impl Walk {
    pub fn new(kind: Kind, model: usize) -> Self {
        // The log tells the state.
        let it = Arguments::new(kind, model).make(|a| (a.early_return, a.debug) = (true, true));
        let fresh = it.snapshot();
        Self { it, model, place: START, fresh, saved: Vec::new() }
    }

    /// A walk to a state: of a ball, or of a list in a state of configuration.
    pub fn to(kind: Kind, state: char) -> Self {
        let mut walk = Self::new(kind, if "GRV".contains(state) { SAMPLED } else { BALL });
        for call in path(kind.1, state) {
            walk.make(&call);
        }
        assert_eq!(walk.place.state, state);
        walk
    }

    pub fn state(&self) -> char {
        self.place.state
    }

    /// Whether the standard allows an operation here.
    pub fn verdict(&self, operation: &str) -> Verdict {
        let of_state = verdict(self.it.kind, self.place.state, operation);
        match (&of_state, self.model, operation) {
            (Verdict::Allowed, BALL, "enter_configuration_mode") => {
                Verdict::Unsupported("structural parameters")
            }
            (
                Verdict::Allowed,
                SAMPLED,
                "get_directional_derivative" | "get_adjoint_derivative",
            ) => Verdict::Unsupported("the model has no derivatives"),
            _ => of_state,
        }
    }

    /// Calls the function of an operation.
    #[track_caller]
    pub fn call(&mut self, operation: &'static str) -> Status {
        self.make(&Call::Named(operation))
    }

    /// Makes a call. It succeeds if the standard allows it and the model has no trouble; else it changes nothing, and
    /// one message says why.
    #[track_caller]
    pub fn make(&mut self, call: &Call) -> Status {
        let operation = call.operation(self.it.kind.0);
        let (mut next, is_over) = (self.place, self.place.state == '!');
        let verdict = self.verdict(operation);
        let (model, saved) = (self.model, &mut self.saved);
        let mut perform = |f: Fmu| perform(f, model, call, &mut next, saved);
        let status = match verdict {
            Verdict::Allowed => {
                let status = perform(*self.it);
                let may_fail = self.place.troubles != [0.0; 2];
                assert!(may_fail || status == OK, "{operation}: {:?}", self.it.messages());
                status
            }
            Verdict::Unsupported(_) if is_over => {
                assert_eq!(perform(*self.it), ERROR);
                ERROR
            }
            Verdict::Forbidden(words) if is_over => {
                assert_eq!(perform(*self.it), FATAL);
                assert_eq!(self.it.last_message(), words);
                FATAL
            }
            Verdict::Unsupported(words) => {
                self.it.refuses(words, perform);
                let text = self.it.last_message();
                assert!(text.starts_with(&format!("{}: ", self.it.name(operation))), "{text}");
                ERROR
            }
            Verdict::Forbidden(words) => {
                self.it.refuses(&words, perform);
                ERROR
            }
        };
        let messages = self.it.messages();
        let mut logged = messages.iter().rev().filter_map(|m| m.text.strip_prefix("state: "));
        let (logged, before) = (logged.next(), self.place.state);
        self.place = match status {
            OK if operation == "reset" => {
                assert_eq!(self.it.snapshot(), self.fresh);
                START
            }
            OK => next,
            FATAL => Place { state: '!', ..self.place },
            DISCARDED if operation == "do_step" => next,
            _ => self.place,
        };
        if status == OK && !matches!(call, Call::Restore(_)) {
            self.place.state = state_after(self.it.kind, before, operation);
            let found = logged.unwrap_or(name(before));
            assert_eq!(found, name(self.place.state), "after {operation}");
        } else if let Some(name) = logged {
            self.place.state = letter(name);
        }
        self.it.forget_messages();
        status
    }
}

/// The calls that lead to a state. The model fails the last one in a state after a failure.
fn path(mode: Mode, state: char) -> Vec<Call> {
    let run: &[&str] = match mode {
        Stepped => &["do_step"],
        Events => &["enter_step_mode", "do_step"],
        Exchanged => &["enter_continuous_time_mode"],
        Scheduled => &[],
    };
    let (trouble, fails) = match mode {
        Exchanged => (Ball::TROUBLE, "get_continuous_state_derivatives"),
        _ => (Ball::FAULT, "do_step"),
    };
    let n = match state {
        'I' | 'G' => 0,
        'N' => 1,
        'E' | 'V' => 2,
        _ => 2 + run.len(),
    };
    let all = ["enter_initialization_mode", "exit_initialization_mode"].iter().chain(run).take(n);
    let mut all = Vec::from_iter(all.map(|operation| Call::Named(operation)));
    match state {
        'G' | 'R' | 'V' => all.push(Call::Named("enter_configuration_mode")),
        'T' => all.push(Call::Named("terminate")),
        'F' => all.extend([Call::Trouble(trouble, DISCARD), Call::Named(fails)]),
        'X' => all.extend([Call::Trouble(trouble, BREAK), Call::Named(fails)]),
        '!' => all.extend([Call::Trouble(trouble, BUG), Call::Named(fails)]),
        _ => {}
    }
    all
}

fn perform(
    f: Fmu,
    model: usize,
    made: &Call,
    place: &mut Place,
    saved: &mut Vec<(*mut c_void, Place)>,
) -> Status {
    let operation = made.operation(f.kind.0);
    match *made {
        _ if operation == "do_step" => {
            let (status, results) = f.step_to(place.time, 0.25);
            place.time = results.time;
            status
        }
        Call::Trouble(reference, how) if model == BALL => {
            place.troubles[(reference - Ball::TROUBLE) as usize] = how;
            f.set(reference, how)
        }
        Call::Save => {
            let mut state = null_mut();
            let status = f.get_state(&mut state);
            saved.extend((status == OK).then_some((state, *place)));
            status
        }
        Call::Restore(index) if !saved.is_empty() => {
            let (state, then) = *index.get(saved);
            *place = then;
            f.set_state(state)
        }
        _ => {
            let function = functions(f.kind.0).iter().find(|one| one.operation == operation);
            let n = if model == BALL { length(operation) } else { 0 };
            call(f, function.expect(operation), n)
        }
    }
}

/// Calls a function with valid arguments: with an FMU state of the instance, or with NULL if there is none.
pub fn call(f: Fmu, function: &Function, n: usize) -> Status {
    let has_state = function.operation.contains("fmu_state");
    let mut state = if has_state { f.save() } else { null_mut() };
    let status = match function.operation {
        // All that is logged.
        "set_debug_logging" => f.switch_log(true, &[]),
        "get_fmu_state" => f.get_state(&mut state),
        "set_fmu_state" => f.set_state(state),
        "serialized_fmu_state_size" => f.serialized_size(state, &mut 0),
        "serialize_fmu_state" => f.serialize_into(state, &mut [0; 999]),
        "deserialize_fmu_state" if state.is_null() => f.deserialize(&[], &mut state),
        "deserialize_fmu_state" => f.deserialize(&f.serialize(state), &mut state),
        "do_step" => f.step(0.25, 0.125),
        "get_real_status" => f.real_status(fmi2LastSuccessfulTime, &mut 0.0),
        "get_boolean_status" => f.boolean_status(fmi2Terminated, &mut 0),
        // The others are of asynchronous steps.
        status if status.ends_with("_status") => match function.call_with_zeros(f, n, None) {
            DISCARDED => OK,
            other => other,
        },
        _ => function.call_with_zeros(f, n, None),
    };
    if !state.is_null() {
        ok([f.free_state(&mut state)]);
    }
    status
}
