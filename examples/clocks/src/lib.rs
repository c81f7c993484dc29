//! Models that act at the ticks of clocks, which are of all kinds:
//!
//! ```sh
//! cargo fmu export --package clocks --fmi 3.0 --out target/examples
//! ```
//!
//! They are FMUs for co-simulation with event mode, model exchange and scheduled execution.
#![forbid(unsafe_code)]

use fmu_export::prelude::*;

fmu_export::export!(Counter, Sampler);

/// Counts the ticks of three clocks
///
/// | time (s) | 0 | 1 | 2 | 3 | 4 | 5 | 6 | 7 | 8 | 9 |
/// |---|---|---|---|---|---|---|---|---|---|---|
/// | `second` | + | + | + | + | + | + | + | + | + | + |
/// | `twice` | + | + | | | | | | | + | + |
/// | `late` | | | | | + | | | | | |
/// | `total` | 2 | 4 | 5 | 6 | 8 | 9 | 10 | 11 | 13 | 15 |
/// | `fifth` | | | + | | | | + | | | + |
#[derive(Model)]
#[model(clocked, stop_time = 10, step_size = 1)]
pub struct Counter {
    /// ticks every second
    #[input(constant, interval = 1, priority = 0)]
    second: Clock,
    /// ticks twice in eight seconds, a second apart
    #[input(changing, priority = 1)]
    twice: Clock,
    /// ticks once, at the fifth tick of `second`
    #[input(countdown, priority = 2)]
    late: Clock,
    /// ticks when the number of all ticks is a multiple of 5
    #[output(clocks(second, twice, late))]
    fifth: Clock,
    /// ticks of `second`
    #[output(clocks(second))]
    seconds: i32,
    /// ticks of `twice`
    #[output(clocks(twice))]
    pairs: i32,
    /// ticks of `late`
    #[output(clocks(late))]
    delays: i32,
    /// ticks of all three clocks
    #[output(clocks(second, twice, late))]
    total: i32,
    /// a number to add
    #[input(clocks(twice))]
    added: i32,
    /// sum of the numbers
    #[output(clocks(twice))]
    sum: i32,
    /// 1000 after the tick of `late`
    #[output(clocks(late))]
    code: i32,
}

impl Clocked for Counter {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.twice = Clock::after(0.0);
        Ok(())
    }

    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        let before = self.total;
        if self.second.is_active() {
            self.seconds += 1;
            self.total += 1;
            if self.seconds == 5 {
                self.late = Clock::after(0.0);
            }
        }
        if self.twice.is_active() {
            self.pairs += 1;
            self.total += 1;
            self.sum += self.added;
            self.twice = Clock::after(if self.pairs % 2 == 1 { 1.0 } else { 7.0 });
        }
        if self.late.is_active() {
            self.delays += 1;
            self.total += 1;
            self.code = 1000;
        }
        if self.total / 5 > before / 5 {
            self.fifth = Clock::TICK;
        }
        Ok(())
    }
}

/// Samples a signal at the ticks of clocks whose interval is not constant
#[derive(Model)]
#[model(clocked, step_size = 0.01)]
pub struct Sampler {
    /// ticks at an interval that the host may set before the simulation
    #[input(fixed, interval = 0.25, shift = 0.125, resolution = 1000)]
    fixed: Clock,
    /// ticks every sample time
    #[input(calculated, interval = self.ts)]
    sample: Clock,
    /// ticks at an interval that changes with a parameter
    #[input(tunable, interval = self.period)]
    tuned: Clock,
    /// ticks at an interval that the host may change during the simulation
    #[input(tunable, interval = 0.5)]
    set: Clock,
    /// ticks when the host wants the last samples
    #[input]
    request: Clock,
    /// ticks with the answer to each request
    #[output(clocks(request))]
    answer: Clock,
    /// a signal
    #[input(clocks(fixed, sample, tuned, set))]
    u: f64,
    /// last sample at a tick of `fixed`
    #[output(clocks(fixed))]
    at_fixed: f64,
    /// last sample at a tick of `sample`
    #[output(clocks(sample))]
    at_sample: f64,
    /// last sample at a tick of `tuned`
    #[output(clocks(tuned))]
    at_tuned: f64,
    /// last sample at a tick of `set`
    #[output(clocks(set))]
    at_set: f64,
    /// sum of the last samples
    #[output(clocks(request))]
    sum: f64,
    /// interval of `set`
    #[output(clocks(request), unit = "s")]
    interval: f64,
    /// sample time
    #[parameter(start = 0.1, min = 1e-6, unit = "s")]
    ts: f64,
    /// interval of `tuned`
    #[parameter(tunable, start = 0.2, min = 0, unit = "s")]
    period: f64,
}

impl Clocked for Sampler {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        for (clock, sample) in [
            (self.fixed, &mut self.at_fixed),
            (self.sample, &mut self.at_sample),
            (self.tuned, &mut self.at_tuned),
            (self.set, &mut self.at_set),
        ] {
            if clock.is_active() {
                *sample = self.u;
            }
        }
        if self.request.is_active() {
            self.sum = self.at_fixed + self.at_sample + self.at_tuned + self.at_set;
            self.interval = self.set.interval().unwrap_or_default();
            self.answer = Clock::TICK;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use fmu_export::testing::Driver;

    use super::*;

    #[test]
    fn ticks_are_counted_as_in_the_table() -> Result<(), ModelError> {
        let mut counter = Driver::<Counter>::new();
        let (mut twice, mut fifths) = (0.0, Vec::new());
        for second in 0..10 {
            let mut clocks = vec!["second"];
            if f64::from(second) == twice {
                clocks.push("twice");
            }
            counter.tick(&clocks)?;
            if clocks.len() == 2 {
                twice += counter.twice.interval().unwrap();
            }
            let ticked = counter.fifth.is_active();
            if counter.late.interval() == Some(0.0) {
                counter.tick(&["late"])?;
            }
            fifths.extend((ticked || counter.fifth.is_active()).then_some(second));
            counter.step(1.0)?;
        }
        assert_eq!([counter.seconds, counter.pairs, counter.delays, counter.total], [10, 4, 1, 15]);
        assert_eq!(fifths, [2, 6, 9]);
        assert_eq!(counter.code, 1000);
        Ok(())
    }

    #[test]
    fn a_request_is_answered_with_the_sum_of_the_samples() -> Result<(), ModelError> {
        let mut sampler = Driver::<Sampler>::new();
        sampler.u = 2.0;
        sampler.tick(&["fixed", "sample"])?;
        assert!(!sampler.answer.is_active());
        sampler.u = 0.5;
        sampler.tick(&["tuned", "set", "request"])?;
        assert!(sampler.answer.is_active());
        assert_eq!([sampler.sum, sampler.interval], [5.0, 0.5]);
        Ok(())
    }
}
