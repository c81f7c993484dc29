//! The profile of a run: the time that each function of each component has taken.

use std::ffi::c_int;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

/// Where the time of a run went, from the first instantiation to the end of the last instance.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// All calls, those that took longest first.
    pub functions: Vec<FunctionTime>,
    /// The time of the run.
    pub total: Duration,
}

/// The time of all calls of one function of one component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FunctionTime {
    /// The name of the component.
    pub component: String,
    /// The function of FMI.
    pub function: String,
    /// How often it was called.
    pub calls: u64,
    /// How many of the calls returned something else than success.
    pub failures: u64,
    /// The time of all calls.
    pub total: Duration,
    /// The time of the longest call.
    pub longest: Duration,
}

impl FunctionTime {
    /// The time of a call on average.
    pub fn mean(&self) -> Duration {
        Duration::from_secs_f64(self.total.as_secs_f64() / self.calls.max(1) as f64)
    }
}

impl Profile {
    /// The time outside of the calls: of the master, and of the measurement itself. Calls of several components that run
    /// at the same time may take longer than the run.
    pub fn master(&self) -> Duration {
        let calls = self.functions.iter().map(|function| function.total);
        self.total.saturating_sub(calls.sum())
    }
}

/// Measures the calls of all components. Runs in the worker process.
#[derive(Debug)]
pub(crate) struct Profiler {
    begun: Instant,
    /// The names of the components, and what they have called.
    components: Vec<(String, Mutex<Functions>)>,
}

/// The functions of a component, of which there are few.
type Functions = Vec<(&'static str, Times)>;

#[derive(Debug, Clone, Copy, Default)]
struct Times {
    calls: u64,
    failures: u64,
    total: Duration,
    longest: Duration,
}

impl Profiler {
    pub(crate) fn new(components: impl Iterator<Item = String>) -> Self {
        let components = components.map(|name| (name, Mutex::default()));
        Self { begun: Instant::now(), components: components.collect() }
    }

    /// Adds a call of the component with an index.
    pub(crate) fn add(
        &self,
        component: usize,
        function: &'static str,
        status: Option<c_int>,
        duration: Duration,
    ) {
        let functions = &self.components[component].1;
        let mut functions = functions.lock().unwrap_or_else(PoisonError::into_inner);
        let known = functions.iter().position(|(known, _)| std::ptr::eq(*known, function));
        let index = known.unwrap_or_else(|| {
            functions.push((function, Times::default()));
            functions.len() - 1
        });
        let times = &mut functions[index].1;
        times.calls += 1;
        times.failures += u64::from(status.is_some_and(|status| status != 0));
        times.total += duration;
        times.longest = times.longest.max(duration);
    }

    /// The profile up to now.
    pub(crate) fn profile(&self) -> Profile {
        let total = self.begun.elapsed();
        let mut all = Vec::new();
        for (component, functions) in &self.components {
            let functions = functions.lock().unwrap_or_else(PoisonError::into_inner);
            all.extend(functions.iter().map(|(function, times)| {
                let Times { calls, failures, total, longest } = *times;
                let (component, function) = (component.clone(), (*function).to_owned());
                FunctionTime { component, function, calls, failures, total, longest }
            }));
        }
        all.sort_by_key(|function| std::cmp::Reverse(function.total));
        Profile { functions: all, total }
    }
}
