//! Paces a run by the monotonic clock, and measures how well it keeps the time.
//!
//! A communication point is due at an absolute time of the clock, so that delays do not add up. After a step that ends late,
//! the next ones begin at once until the run has caught up; none is left out.

use std::time::Duration;

use fmu_host::real_time::{self, RealTimeThread, Refused};
use serde::{Deserialize, Serialize};

use crate::histogram::Histogram;

/// The pace of a run, from its first communication point on. The thread has the priority of real time.
pub(crate) struct Pace {
    /// Simulated seconds per second.
    factor: f64,
    /// When the first communication point was due, and its time (s).
    origin: Option<(Duration, f64)>,
    wake_ups: Histogram,
    latest_wake_up: Option<Moment>,
    steps: u64,
    overruns: u64,
    largest_overrun: Option<Moment>,
    longest: Option<Longest>,
    refused: Vec<Refused>,
    _thread: RealTimeThread,
}

/// The longest step, and the index of the component that has taken the longest in it.
struct Longest {
    step: Moment,
    component: usize,
    part: Duration,
}

/// A duration at a communication point.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
pub struct Moment {
    /// The duration.
    pub duration: Duration,
    /// The communication point (s).
    pub time: f64,
}

/// How well a run has kept the time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Punctuality {
    /// Simulated seconds per second.
    pub factor: f64,
    /// The number of steps.
    pub steps: u64,
    /// The number of steps that ended after the next communication point was due, and by how much the latest did.
    pub overruns: u64,
    /// The largest one, and the communication point from which that step began.
    pub largest_overrun: Option<Moment>,
    /// How late the run woke up for communication points, at 50, 99 and 99.9 % of them, and the latest; `None` if it never
    /// had to wait.
    pub jitter: Option<([Duration; 3], Moment)>,
    /// The longest step.
    pub longest: Option<LongestStep>,
    /// What the system did not allow, such as `SCHED_FIFO`, and why.
    pub refused: Vec<(String, String)>,
}

/// The longest step of a run in real time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LongestStep {
    /// Its duration, and the communication point from which it began.
    pub step: Moment,
    /// The component that has taken the longest in it, and how long.
    pub component: String,
    /// How long it has taken.
    pub part: Duration,
}

impl Pace {
    /// A pace with this factor, for this thread.
    pub(crate) fn new(factor: f64) -> Self {
        let (thread, refused) = RealTimeThread::enter();
        Self {
            factor,
            origin: None,
            wake_ups: Histogram::new(),
            latest_wake_up: None,
            steps: 0,
            overruns: 0,
            largest_overrun: None,
            longest: None,
            refused,
            _thread: thread,
        }
    }

    /// When a communication point (s) is due; the first one is now.
    fn due(&mut self, time: f64) -> Duration {
        let (begin, first) = *self.origin.get_or_insert_with(|| (real_time::now(), time));
        let after = Duration::try_from_secs_f64((time - first).max(0.0) / self.factor);
        begin.saturating_add(after.unwrap_or(Duration::MAX))
    }

    /// Waits until a communication point (s).
    pub(crate) fn wait(&mut self, time: f64) {
        let due = self.due(time);
        if real_time::now() < due {
            real_time::sleep_until(due);
            let late = real_time::now().saturating_sub(due);
            self.wake_ups.add(late);
            let late = Moment { duration: late, time };
            if self.latest_wake_up.is_none_or(|latest| late.duration > latest.duration) {
                self.latest_wake_up = Some(late);
            }
        }
    }

    /// Takes note of a step that began at a communication point (s) and at a time of the clock, and has just ended; of how
    /// long each component has taken; and of the next communication point (s).
    pub(crate) fn end_step(
        &mut self,
        (time, begin): (f64, Duration),
        parts: impl Iterator<Item = Duration>,
        next: f64,
    ) {
        let (end, due) = (real_time::now(), self.due(next));
        self.steps += 1;
        if end > due {
            self.overruns += 1;
            let overrun = Moment { duration: end - due, time };
            if self.largest_overrun.is_none_or(|largest| overrun.duration > largest.duration) {
                self.largest_overrun = Some(overrun);
            }
        }
        let step = Moment { duration: end.saturating_sub(begin), time };
        if self.longest.as_ref().is_none_or(|longest| step.duration > longest.step.duration)
            && let Some((part, component)) = parts.zip(0..).max()
        {
            self.longest = Some(Longest { step, component, part });
        }
    }

    /// How well the run has kept the time, with the names of the components.
    pub(crate) fn punctuality(&self, name: impl Fn(usize) -> String) -> Punctuality {
        let percentiles = [0.5, 0.99, 0.999].map(|part| self.wake_ups.percentile(part));
        let jitter = self.latest_wake_up.map(|latest| {
            (percentiles.map(|late| late.unwrap_or_default().min(latest.duration)), latest)
        });
        let longest = self.longest.as_ref().map(|longest| LongestStep {
            step: longest.step,
            component: name(longest.component),
            part: longest.part,
        });
        let refused = self.refused.iter();
        Punctuality {
            factor: self.factor,
            steps: self.steps,
            overruns: self.overruns,
            largest_overrun: self.largest_overrun,
            jitter,
            longest,
            refused: refused.map(|r| (r.means.to_owned(), r.reason.to_string())).collect(),
        }
    }
}

impl Punctuality {
    /// Lines that tell it to people.
    pub fn lines(&self) -> Vec<String> {
        let at = |moment: &Moment| format!("{} at t = {:?} s", shown(moment.duration), moment.time);
        let Self { factor, steps, overruns, .. } = self;
        let worst =
            self.largest_overrun.iter().map(|overrun| format!(", by at most {}", at(overrun)));
        let worst: String = worst.collect();
        let mut lines = vec![format!(
            "real time x {factor}: {overruns} of {steps} steps ended too late{worst}"
        )];
        if let Some(([half, most, nearly_all], latest)) = &self.jitter {
            lines.push(format!(
                "jitter: 50 % {}, 99 % {}, 99.9 % {}, maximum {}",
                shown(*half),
                shown(*most),
                shown(*nearly_all),
                at(latest)
            ));
        }
        if let Some(LongestStep { step, component, part }) = &self.longest {
            let part = shown(*part);
            lines.push(format!("longest step: {}, of which {component} took {part}", at(step)));
        }
        let refused = self.refused.iter().map(|(means, reason)| format!("{means} ({reason})"));
        let refused = Vec::from_iter(refused).join(", ");
        if !refused.is_empty() {
            lines.push(format!("not allowed: {refused}"));
        }
        lines
    }
}

/// A duration with three digits.
fn shown(duration: Duration) -> String {
    let seconds = duration.as_secs_f64();
    let (value, unit) = match seconds {
        1.0.. => (seconds, "s"),
        1e-3.. => (seconds * 1e3, "ms"),
        _ => (seconds * 1e6, "us"),
    };
    let decimals = match value {
        100.0.. => 0,
        10.0.. => 1,
        _ => 2,
    };
    format!("{value:.decimals$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> Duration = Duration::from_millis;

    #[test]
    fn communication_points_are_due_at_absolute_times_from_the_first_one_on() {
        let mut pace = Pace::new(2.0);
        let first = pace.due(10.0);
        assert_eq!(pace.due(10.5), first + MS(250));
        assert_eq!(pace.due(10.0), first);
        assert_eq!(pace.due(f64::MAX), Duration::MAX);
        pace.wait(10.01);
        assert!(real_time::now() >= first + MS(5));
        let Punctuality { jitter, .. } = pace.punctuality(|_| String::new());
        assert_eq!(jitter.map(|(_, latest)| latest.time), Some(10.01));
    }

    #[test]
    fn an_overrun_ends_after_the_next_communication_point_was_due() {
        let mut pace = Pace::new(1.0);
        let begin = real_time::now();
        // The first communication point was due so long ago that all steps end too late but the last.
        pace.origin = Some((begin.saturating_sub(MS(3_600_000)), 0.0));
        pace.end_step((0.0, begin), [MS(1), MS(3), MS(2)].into_iter(), 1.0);
        pace.end_step((1.0, begin), [MS(5)].into_iter(), 2.0);
        pace.end_step((2.0, real_time::now()), [MS(5)].into_iter(), 1e6);
        pace.wait(2.0);
        let found = pace.punctuality(|index| format!("component {index}"));
        assert_eq!((found.steps, found.overruns, &found.jitter), (3, 2, &None));
        assert_eq!(found.largest_overrun.unwrap().time, 0.0);
        assert!(found.largest_overrun.unwrap().duration >= MS(3_598_999));
        assert!(found.longest.unwrap().component.starts_with("component "));
    }

    #[test]
    fn the_lines_tell_everything() {
        let moment = |duration, time| Moment { duration, time };
        let told = Punctuality {
            factor: 2.0,
            steps: 1000,
            overruns: 3,
            largest_overrun: Some(moment(MS(3001), 1.5)),
            jitter: Some(([MS(1) / 20, MS(1), MS(12)], moment(MS(120), 0.5))),
            longest: Some(LongestStep {
                step: moment(MS(5), 0.25),
                component: "plant".into(),
                part: MS(4),
            }),
            refused: vec![
                ("SCHED_FIFO".into(), "no".into()),
                ("locked memory".into(), "too much".into()),
            ],
        };
        assert_eq!(
            told.lines(),
            [
                "real time x 2: 3 of 1000 steps ended too late, by at most 3.00 s at t = 1.5 s",
                "jitter: 50 % 50.0 us, 99 % 1.00 ms, 99.9 % 12.0 ms, maximum 120 ms at t = 0.5 s",
                "longest step: 5.00 ms at t = 0.25 s, of which plant took 4.00 ms",
                "not allowed: SCHED_FIFO (no), locked memory (too much)",
            ]
        );
        let quiet = Punctuality {
            overruns: 0,
            largest_overrun: None,
            jitter: None,
            longest: None,
            refused: Vec::new(),
            ..told
        };
        assert_eq!(quiet.lines(), ["real time x 2: 0 of 1000 steps ended too late"]);
    }
}
