//! The ticks of clocks in event mode (FMI 3.0.2, sections 2.2.8 and 2.3.5).

use anyhow::{Context, Result, ensure};
use fmu_description::{IntervalVariability, Type, Value, XmlVariable};
use fmu_file::text::quote;
use fmu_host::{Cause, Failure, InterfaceType, IntervalQualifier};

use crate::binary::excitation::EXCITATIONS;
use crate::binary::observed::get;
use crate::binary::run::Run;
use crate::binary::schedule::{Schedule, clock_type, is_active, is_triggered, kind};
use crate::binary::subject::SKIP;
use crate::bus;
use crate::rule::rule;

/// Every how many communication points the clocks tick that the host triggers.
const TRIGGER_EVERY: usize = 3;

impl Run<'_> {
    /// Asks for the intervals of the clocks in initialization mode, which gives their first ticks.
    pub fn schedule(&mut self) -> Result<()> {
        let (subject, start) = (self.subject, self.subject.start);
        let n = subject.clocks.inputs.len();
        let held = subject.observed.neutral();
        self.position.schedule =
            Schedule { next: vec![None; n], intervals: vec![0.0; n], held, ..Schedule::default() };
        for (k, clock) in subject.clocks.inputs.iter().enumerate() {
            let of = clock_type(clock);
            let kind = of.interval_variability;
            if !kind.is_time_based() {
                continue;
            }
            let asked = of.is_asked_for();
            let interval = if asked { self.ask(clock)? } else { of.interval };
            let first = match kind.is_periodic() {
                true if asked => Some(self.ask_for_shift(clock)?),
                true => Some(of.shift),
                false => interval,
            };
            let schedule = &mut self.position.schedule;
            schedule.intervals[k] = interval.unwrap_or_default();
            let is_known = interval.is_some_and(|interval| interval > 0.0) || !kind.is_periodic();
            schedule.next[k] = first.filter(|_| is_known).map(|first| start + first);
        }
        Ok(())
    }

    fn ask_for_shift(&mut self, clock: &XmlVariable<'_>) -> Result<f64> {
        let mut shift = [f64::NAN];
        let got = self.instance.get_shift_decimal(&[clock.reference], &mut shift);
        let name = quote(&clock.name);
        self.expect(rule!("interval-given"), got.is_ok(), || {
            format!("fmi3GetShiftDecimal refuses the shift of {name}, which the XML does not give")
        });
        got.ok().context(SKIP)?;
        let fits = shift[0].is_finite() && shift[0] >= 0.0;
        self.expect(rule!("interval-positive"), fits, || {
            format!("the shift of {name} is {} s, expected 0 or more", shift[0])
        });
        ensure!(fits, SKIP);
        Ok(shift[0])
    }

    /// Asks for the interval (s) of a clock; `None` if it is not known, or as before. The test ends if the FMU
    /// refuses.
    fn ask(&mut self, clock: &XmlVariable<'_>) -> Result<Option<f64>> {
        let (mut interval, mut qualifier) = ([f64::NAN], [-1]);
        let clocks = [clock.reference];
        let got = self.instance.get_interval_decimal(&clocks, &mut interval, &mut qualifier);
        self.answered(clock, got.map(|_| (interval[0], qualifier[0])))
    }

    /// Judges the answer to [`Run::ask`].
    pub fn answered(
        &mut self,
        clock: &XmlVariable<'_>,
        answer: fmu_host::Result<(f64, i32)>,
    ) -> Result<Option<f64>> {
        use IntervalQualifier::{Changed, NotYetKnown, Unchanged};
        let (name, kind) = (quote(&clock.name), kind(clock));
        let word = kind.keyword();
        if let Err(Failure { cause: Cause::Broke(what), .. }) = &answer {
            self.expect(rule!("interval-qualifier"), false, || {
                format!("fmi3GetIntervalDecimal of {name} {what}, expected 0, 1 or 2")
            });
            return Ok(None);
        }
        self.expect(rule!("interval-given"), answer.is_ok(), || {
            format!("fmi3GetIntervalDecimal refuses the interval of {name}, a {word} clock")
        });
        let (interval, number) = answer.ok().context(SKIP)?;
        let qualifier = IntervalQualifier::of(number);
        let is_countdown = kind == IntervalVariability::Countdown;
        let fits = qualifier.is_some() && (is_countdown || qualifier != Some(NotYetKnown));
        self.expect(rule!("interval-qualifier"), fits, || match qualifier {
            None => {
                format!("the qualifier of the interval of {name} is {number}, expected 0, 1 or 2")
            }
            _ => format!(
                "the interval of {name} is not yet known, expected this only for countdown clocks"
            ),
        });
        let is_first = !self.position.schedule.told.contains(&clock.reference);
        let new = match qualifier {
            Some(Changed) => interval,
            Some(Unchanged) if is_first && !is_countdown => interval,
            _ => return Ok(None),
        };
        self.position.schedule.told.insert(clock.reference);
        let fits = new.is_finite() && (new > 0.0 || new == 0.0 && !kind.is_periodic());
        let (time, least) =
            (self.position.now, if kind.is_periodic() { "more than 0" } else { "0 or more" });
        self.expect(rule!("interval-positive"), fits, || {
            format!("the interval of {name} is {new} s at t = {time} s, expected {least}")
        });
        Ok(Some(new).filter(|_| fits))
    }

    /// The difference up to which two times are the same (s).
    pub fn slack(&self) -> f64 {
        1e-6 * self.subject.step.min(1e-3) + 1e-12 * self.position.now.abs()
    }

    /// The first tick before a time (s), in the future.
    pub fn tick_before(&self, end: f64) -> Option<f64> {
        let (now, slack) = (self.position.now, self.slack());
        let all = self.position.schedule.next.iter().flatten().copied();
        all.filter(|next| *next > now + slack && *next < end - slack).min_by(f64::total_cmp)
    }

    /// The input clocks that tick up to a time (s), and when.
    pub fn due_until(&self, end: f64) -> Vec<(usize, f64)> {
        let until = end + self.slack();
        let all = self.position.schedule.next.iter().enumerate();
        all.filter_map(|(k, next)| Some((k, next.filter(|next| *next <= until)?))).collect()
    }

    /// The input clocks that tick now; those that the host may trigger only with other clocks tick with these.
    pub fn due(&self) -> Vec<usize> {
        let clocks = &self.subject.clocks.inputs;
        let timed: Vec<usize> =
            self.due_until(self.position.now).into_iter().map(|(k, _)| k).collect();
        let active: Vec<u32> = timed.iter().map(|k| clocks[*k].reference).collect();
        let with = clocks.iter().enumerate().filter(|(k, clock)| {
            self.is_excited()
                && is_triggered(clock)
                && is_active(clock, &active)
                && !timed.contains(k)
        });
        timed.iter().copied().chain(with.map(|(k, _)| k)).collect()
    }

    /// Has the clocks tick at a time (s) that the host triggers; returns whether there are any.
    pub fn trigger(&mut self, time: f64) -> bool {
        if !self.is_excited() || self.position.point % TRIGGER_EVERY != 1 {
            return false;
        }
        let clocks = self.subject.clocks.inputs.iter().enumerate();
        let mut triggered =
            clocks.filter(|(_, v)| is_triggered(v) && v.clocks.is_empty()).peekable();
        let is_any = triggered.peek().is_some();
        for (k, _) in triggered {
            self.position.schedule.next[k] = Some(time);
        }
        is_any
    }

    fn is_excited(&self) -> bool {
        self.setup.excitation == EXCITATIONS[0]
    }

    /// In event mode, lets the clocks tick that are due, and reads what the FMU computes then.
    pub fn tick(&mut self) -> Result<Vec<usize>> {
        let subject = self.subject;
        if subject.clocks.is_empty() {
            return Ok(Vec::new());
        }
        let due = self.due();
        let mut active: Vec<u32> =
            due.iter().map(|k| subject.clocks.inputs[*k].reference).collect();
        if !active.is_empty() {
            self.instance.set_clock(&active, &vec![1; active.len()])?;
            self.set_clocked(&active)?;
        }
        if self.setup.evaluates {
            self.instance.evaluate_discrete_states()?;
            self.instance.evaluate_discrete_states()?;
        }
        let ticking = self.output_clocks()?;
        let again = self.output_clocks()?;
        let time = self.position.now;
        self.expect(rule!("clock-read"), ticking == again, || {
            format!("an output clock is active when it is read once at t = {time} s, but not when it is read again, or the reverse")
        });
        self.position.schedule.ticked.extend(&ticking);
        active.extend(ticking);
        self.read_clocked(&active)?;
        for k in &due {
            self.ticked(*k);
        }
        Ok(due)
    }

    /// The next tick of an input clock that has ticked; the FMU tells those of aperiodic clocks.
    pub fn ticked(&mut self, k: usize) {
        let is_periodic = kind(self.subject.clocks.inputs[k]).is_periodic();
        if is_periodic && self.position.schedule.intervals[k] <= self.slack() {
            self.end_as_ticks_are_too_many();
        }
        let schedule = &mut self.position.schedule;
        schedule.next[k] =
            schedule.next[k].filter(|_| is_periodic).map(|next| next + schedule.intervals[k]);
    }

    /// The output clocks that are active.
    pub fn output_clocks(&mut self) -> Result<Vec<u32>> {
        let clocks: Vec<u32> = self.subject.clocks.outputs.iter().map(|v| v.reference).collect();
        if clocks.is_empty() {
            return Ok(clocks);
        }
        let mut values = vec![0; clocks.len()];
        self.instance.get_clock(&clocks, &mut values)?;
        Ok(clocks
            .into_iter()
            .zip(values)
            .filter(|(_, value)| *value != 0)
            .map(|(clock, _)| clock)
            .collect())
    }

    /// Sets the inputs of active clocks.
    pub fn set_clocked(&mut self, active: &[u32]) -> Result<()> {
        let (subject, point) = (self.subject, self.position.point);
        for input in subject.clocks.clocked.iter().filter(|input| is_active(input.variable, active))
        {
            let variable = input.variable;
            if variable.of_type == Type::Binary {
                let frame = bus::frame(variable, point);
                if let Some(frame) = frame.filter(|_| self.is_excited()) {
                    self.instance.set_binary(&[variable.reference], &[&frame])?;
                }
            } else if let Some(values) = input.values(self.setup.excitation, self.setup.seed, point)
            {
                self.set(variable, &values)?;
            }
        }
        Ok(())
    }

    /// Reads the variables of active clocks.
    pub fn read_clocked(&mut self, active: &[u32]) -> Result<()> {
        let subject = self.subject;
        let mut at = 0;
        for variable in subject.observed.held() {
            let n = variable.element_count();
            if is_active(variable, active) {
                let values = get(&mut self.instance, variable.of_type, &[variable.reference], n);
                let values = values.with_context(|| {
                    format!("{} cannot be read at a tick", quote(&variable.name))
                })?;
                self.check_binary(variable, &values)?;
                self.position.schedule.held.splice(at..at + n, values);
                self.position.schedule.read.insert(variable.reference);
            }
            at += n;
        }
        Ok(())
    }

    /// Checks the size of a Binary, that it is the same when it is read again, and its operations on a network.
    fn check_binary(&mut self, variable: &XmlVariable<'_>, values: &[Value]) -> Result<()> {
        let [Value::Binary(bytes)] = values else { return Ok(()) };
        let (name, size, time) = (quote(&variable.name), bytes.len(), self.position.now);
        let max = variable.max_size.unwrap_or(usize::MAX);
        self.expect(rule!("binary-size"), size <= max, || {
            format!("{name} has {size} bytes at t = {time} s, expected at most maxSize = {max}")
        });
        let again = get(&mut self.instance, variable.of_type, &[variable.reference], 1)?;
        let text = |values: &[Value]| match values {
            [Value::Binary(bytes)] => bytes.len(),
            _ => 0,
        };
        self.expect(rule!("binary-kept"), again == values, || {
            format!(
                "{name} has {} bytes when it is read once more at t = {time} s, expected the same {size} bytes",
                text(&again)
            )
        });
        if let Some(fault) = bus::malformed(variable, bytes) {
            self.expect(rule!("bus-operations"), false, || {
                format!("{name} at t = {time} s: {fault}")
            });
        }
        Ok(())
    }

    /// After `fmi3UpdateDiscreteStates`, asks for new intervals, and checks that output clocks are inactive again. Returns
    /// whether a clock ticks once more at this time.
    pub fn reschedule(&mut self, due: &[usize], is_last: bool) -> Result<bool> {
        use IntervalVariability::{Changing, Countdown, Tunable};
        let (subject, now) = (self.subject, self.position.now);
        if subject.clocks.is_empty() {
            return Ok(false);
        }
        if is_last {
            let active = self.output_clocks()?;
            let name = |reference: &u32| {
                subject
                    .clocks
                    .outputs
                    .iter()
                    .find(|v| v.reference == *reference)
                    .map(|v| quote(&v.name))
            };
            self.expect(rule!("clock-deactivated"), active.is_empty(), || {
                format!(
                    "{} is still active at t = {now} s after fmi3UpdateDiscreteStates, expected it to be inactive",
                    active.first().and_then(name).unwrap_or_default()
                )
            });
        }
        for (k, clock) in subject.clocks.inputs.iter().enumerate() {
            let of = clock_type(clock);
            match of.interval_variability {
                Changing if due.contains(&k) => self.tell_next(k)?,
                Countdown | Tunable if of.is_asked_for() => {
                    let interval = self.ask(clock)?;
                    self.next_after(k, interval);
                }
                _ => {}
            }
        }
        let until = now + self.slack();
        Ok(self.position.schedule.next.iter().flatten().any(|next| *next <= until))
    }

    /// Asks for the interval to the next tick of a changing clock that has ticked.
    pub fn tell_next(&mut self, k: usize) -> Result<()> {
        let (clock, now) = (self.subject.clocks.inputs[k], self.position.now);
        let interval = self.ask(clock)?;
        self.expect(rule!("interval-given"), interval.is_some(), || {
            let name = quote(&clock.name);
            format!("{name} has ticked at t = {now} s and gives no interval to its next tick, expected one")
        });
        self.next_after(k, interval);
        Ok(())
    }

    /// Schedules a clock that has told a new interval (s).
    pub fn next_after(&mut self, k: usize, interval: Option<f64>) {
        if let Some(interval) = interval {
            let schedule = &mut self.position.schedule;
            (schedule.next[k], schedule.intervals[k]) =
                (Some(self.position.now + interval), interval);
        }
    }

    /// Ends a run in which clocks tick too often to be tested.
    pub fn end_as_ticks_are_too_many(&mut self) {
        self.ended = true;
        self.stuck = Some("its clocks tick too often in a communication step".into());
    }

    /// What a run to the end of the default experiment has not seen, which may be right.
    pub fn unseen(&self) -> Vec<String> {
        let (clocks, schedule) = (&self.subject.clocks, &self.position.schedule);
        let is_stepped = self.subject.interface_type == InterfaceType::CoSimulation;
        if is_stepped && !self.setup.event_mode {
            return Vec::new();
        }
        let silent = clocks.outputs.iter().filter(|v| !schedule.ticked.contains(&v.reference));
        let silent = silent.map(|v| format!("the output clock {} does not tick", quote(&v.name)));
        let is_countdown = |v: &&&XmlVariable<'_>| kind(v) == IntervalVariability::Countdown;
        let unknown = clocks.inputs.iter().filter(is_countdown);
        let unknown = unknown.filter(|v| !schedule.told.contains(&v.reference));
        let unknown =
            unknown.map(|v| format!("the countdown clock {} has no interval", quote(&v.name)));
        silent.chain(unknown).map(|text| format!("{text} in the default experiment")).collect()
    }
}
