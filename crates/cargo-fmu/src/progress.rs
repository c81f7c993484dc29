//! How far a run or a sweep is, in the words of a person: what is done, how fast, and the time that is left.

use std::cell::Cell;
use std::time::Instant;

use fmu_master::Experiment;
use fmu_master::sweep::SweepProgress;

/// The progress at a time: the part that is done, 0 to 1, and the words.
pub type Progress = (f64, String);

/// Measures the time since its first use.
#[derive(Default)]
pub struct Clock(Cell<Option<Instant>>);

impl Clock {
    /// The progress of a run that has reached a time (s), such as "t = 1.250 of 2 s, 350 times real time, 3 s left".
    pub fn run(&self, Experiment { start, stop, .. }: Experiment, time: f64) -> Progress {
        let seconds = self.seconds();
        let part = ((time - start) / (stop - start)).clamp(0.0, 1.0);
        let speed = speed((time - start) / seconds.max(1e-9));
        // Three digits after those of the stop time.
        let digits = (3.0 - stop.abs().max(1e-9).log10().floor()).clamp(0.0, 9.0) as usize;
        (part, format!("t = {time:.digits$} of {stop} s, {speed}{}", left(part, seconds)))
    }

    /// The progress of a sweep, such as "120 of 500 runs, 3 failed, 80 a second, 5 s left".
    pub fn sweep(&self, progress: &SweepProgress) -> Progress {
        let seconds = self.seconds();
        let SweepProgress { runs, before, done, failed, .. } = *progress;
        let all = before + done;
        let part = if runs == 0 { 1.0 } else { all as f64 / runs as f64 };
        let failures = if failed > 0 { format!(", {failed} failed") } else { String::new() };
        let rate = match done as f64 / seconds.max(1e-9) {
            _ if done == 0 => String::new(),
            rate if rate < 10.0 => format!(", {rate:.1} a second"),
            rate => format!(", {rate:.0} a second"),
        };
        let left = left(done as f64 / (runs - before).max(1) as f64, seconds);
        (part, format!("{all} of {runs} runs{failures}{rate}{left}"))
    }

    fn seconds(&self) -> f64 {
        let begin = self.0.get().unwrap_or_else(Instant::now);
        self.0.set(Some(begin));
        begin.elapsed().as_secs_f64()
    }
}

/// The speed relative to real time, which may be below 1.
pub fn speed(factor: f64) -> String {
    let digits = if factor < 10.0 { 2 } else { 0 };
    format!("{factor:.digits$} times real time")
}

/// The time that is left after some seconds, once it can be estimated.
fn left(part: f64, seconds: f64) -> String {
    if part <= 0.0 || seconds < 0.2 {
        return String::new();
    }
    match seconds * (1.0 - part) / part {
        left if left < 100.0 => format!(", {:.0} s left", left.ceil()),
        left if left < 6000.0 => format!(", {:.0} min left", (left / 60.0).ceil()),
        left => format!(", {:.1} h left", left / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_that_is_left_is_in_the_unit_of_its_size() {
        for (part, seconds, expected) in [
            (0.0, 9.0, ""),
            (0.5, 0.1, ""),
            (0.25, 1.0, ", 3 s left"),
            (0.5, 0.3, ", 1 s left"),
            (0.1, 60.0, ", 9 min left"),
            (0.01, 360.0, ", 9.9 h left"),
        ] {
            assert_eq!(left(part, seconds), expected);
        }
    }

    #[test]
    fn a_sweep_counts_its_failures_and_those_of_before() {
        let progress =
            SweepProgress { runs: 8, before: 2, done: 2, failed: 1, ..SweepProgress::default() };
        let (part, text) = Clock::default().sweep(&progress);
        assert_eq!(part, 0.5);
        assert!(text.starts_with("4 of 8 runs, 1 failed, "), "{text}");
    }
}
