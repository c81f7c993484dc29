//! Faults of connections, which show how a system copes with bad signals.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};

use crate::random::Draw;
use crate::store::Store;
use crate::{Experiment, Place};

/// A fault of a connection: its effect on the value of the output, and when it acts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    effect: Effect,
    /// It acts from `start` until shortly before `stop` (s).
    start: f64,
    stop: f64,
}

/// The effect of a fault. Amounts are in the unit of the output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
enum Effect {
    /// Adds normally distributed numbers with this deviation.
    Noise(f64),
    Offset(f64),
    /// Adds this per second.
    Drift(f64),
    Gain(f64),
    /// Loses values with this probability; the input keeps the last one that has arrived.
    Dropout(f64),
    /// Passes the value of this time ago (s).
    Delay(f64),
    /// The smallest and the largest value.
    Saturation([f64; 2]),
}

/// A number or a range of a fault, as the user writes it.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged)]
pub(crate) enum Amount {
    Number(f64),
    Range([f64; 2]),
}

/// The kinds of faults, and what each expects.
const KINDS: [(&str, &str); 7] = [
    ("noise", "a standard deviation of at least 0"),
    ("offset", "a finite number"),
    ("drift", "a finite number per second"),
    ("gain", "a finite number"),
    ("dropout", "a probability from 0 to 1"),
    ("delay", "a time in s of at least 0"),
    ("saturation", "two numbers, the smaller one first"),
];

/// The longest delay, in steps.
const LONGEST: f64 = 1e6;

impl Fault {
    /// A fault as the user writes it: the amount of its kind, and the times.
    ///
    /// # Errors
    /// A key is unknown, or a value does not fit it.
    pub(crate) fn new(mut keys: BTreeMap<String, Amount>) -> Result<Self> {
        let mut time = |key: &str, default| match keys.remove(key) {
            None => Ok(default),
            Some(Amount::Number(time)) if time.is_finite() => Ok(time),
            Some(other) => bail!("{key} = {other}, expected a time in s"),
        };
        let (start, stop) = (time("start", f64::NEG_INFINITY)?, time("stop", f64::INFINITY)?);
        ensure!(start < stop, "stop = {stop:?}, expected more than start = {start:?}");
        let names = || KINDS.map(|(name, _)| name).join(", ");
        let mut keys = keys.into_iter();
        let (Some((key, amount)), None) = (keys.next(), keys.next()) else {
            bail!(
                "a fault is one of {}, with its start and stop if it is not always there",
                names()
            );
        };
        let expected = KINDS.iter().find_map(|(name, expected)| (*name == key).then_some(expected));
        let expected = expected
            .with_context(|| format!("unknown fault {key}, expected one of {}", names()))?;
        let effect = match (key.as_str(), amount) {
            ("noise", Amount::Number(x)) if x >= 0.0 && x.is_finite() => Effect::Noise(x),
            ("offset", Amount::Number(x)) if x.is_finite() => Effect::Offset(x),
            ("drift", Amount::Number(x)) if x.is_finite() => Effect::Drift(x),
            ("gain", Amount::Number(x)) if x.is_finite() => Effect::Gain(x),
            ("dropout", Amount::Number(x)) if (0.0..=1.0).contains(&x) => Effect::Dropout(x),
            ("delay", Amount::Number(x)) if x >= 0.0 && x.is_finite() => Effect::Delay(x),
            ("saturation", Amount::Range([min, max])) if min <= max => {
                Effect::Saturation([min, max])
            }
            _ => bail!("{key} = {amount}, expected {expected}"),
        };
        Ok(Self { effect, start, stop })
    }

    /// Checks that a delay is a number of steps.
    pub(crate) fn check(&self, step: f64) -> Result<()> {
        if let Effect::Delay(delay) = self.effect {
            let steps = delay / step;
            ensure!(
                (steps - steps.round()).abs() < 1e-6 && steps <= LONGEST,
                "delay = {delay:?}, expected a multiple of the step, {step:?} s, and at most {LONGEST:.0e} steps"
            );
        }
        Ok(())
    }
}

impl std::fmt::Display for Amount {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number:?}"),
            Self::Range(range) => write!(f, "{range:?}"),
        }
    }
}

/// A connection with faults, in one run.
#[derive(Debug, Clone)]
pub(crate) struct FaultyConnection {
    /// The place of the output in the store, and the index of the number there that the input takes.
    pub(crate) from: Place,
    pub(crate) to: usize,
    pub(crate) faults: Vec<FaultState>,
}

/// A fault in one run.
#[derive(Debug, Clone)]
pub(crate) struct FaultState {
    fault: Fault,
    seed: u64,
    /// Its rank among all faults of the system, so that each has random numbers of its own.
    rank: u64,
    /// The values on their way through a delay, or the last one that has arrived.
    pub(crate) memory: Vec<f64>,
}

/// The first rank of faults among random numbers; parameters of sweeps have those below.
const FIRST_RANK: u64 = 1 << 32;

impl FaultState {
    pub(crate) fn new(fault: &Fault, seed: u64, rank: usize, experiment: &Experiment) -> Self {
        let Experiment { start, step, .. } = *experiment;
        let length = match fault.effect {
            Effect::Delay(delay) => (delay / step).round() as usize,
            Effect::Dropout(_) => 1,
            _ => 0,
        };
        Self {
            fault: Fault { start: fault.start.max(start), ..fault.clone() },
            seed,
            rank: FIRST_RANK + rank as u64,
            memory: vec![0.0; length],
        }
    }

    /// The value that arrives in step `k` at a time. `rounding` is how far times may be apart.
    fn pass(&mut self, value: f64, k: u64, time: f64, rounding: f64) -> f64 {
        if k == 0 {
            self.memory.fill(value);
        }
        let Fault { effect, start, stop } = self.fault;
        let acts = time >= start - rounding && time < stop - rounding;
        let draw = Draw { seed: self.seed, rank: self.rank, draw: k };
        match effect {
            Effect::Delay(_) if !self.memory.is_empty() => {
                let place = (k % self.memory.len() as u64) as usize;
                let delayed = std::mem::replace(&mut self.memory[place], value);
                if acts { delayed } else { value }
            }
            Effect::Dropout(probability) => {
                let is_lost = acts && k > 0 && draw.fraction() < probability;
                if !is_lost {
                    self.memory[0] = value;
                }
                self.memory[0]
            }
            _ if !acts => value,
            Effect::Noise(deviation) => value + deviation * draw.normal(),
            Effect::Offset(offset) => value + offset,
            Effect::Drift(rate) => value + rate * (time - start),
            Effect::Gain(gain) => value * gain,
            Effect::Delay(_) => value,
            Effect::Saturation([min, max]) => value.clamp(min, max),
        }
    }
}

impl FaultyConnection {
    /// Remembers what the same connection has remembered at another time.
    pub(crate) fn remember_as(&mut self, other: &Self) {
        for (fault, other) in self.faults.iter_mut().zip(&other.faults) {
            fault.memory.clone_from(&other.memory);
        }
    }

    /// Passes the value of step `k` from the output to the input.
    pub(crate) fn carry(&mut self, k: u64, time: f64, step: f64, values: &mut Store) {
        let value = values.number(self.from);
        let pass = |value, fault: &mut FaultState| fault.pass(value, k, time, 1e-6 * step);
        values.reals[self.to] = self.faults.iter_mut().fold(value, pass);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> Result<Fault> {
        let mut table: BTreeMap<String, _> = toml::from_str(&format!("fault = {{ {text} }}"))?;
        Fault::new(table.remove("fault").unwrap())
    }

    #[test]
    fn wrong_faults_are_rejected_with_the_expectation() {
        for (text, reason) in [
            ("noise = -1", "noise = -1.0, expected a standard deviation of at least 0"),
            ("noise = [0, 1]", "noise = [0.0, 1.0], expected a standard deviation of at least 0"),
            ("dropout = 2", "dropout = 2.0, expected a probability from 0 to 1"),
            ("saturation = [1, 0]", "expected two numbers, the smaller one first"),
            ("drift = nan", "drift = NaN, expected a finite number per second"),
            ("noize = 1", "unknown fault noize, expected one of noise, offset, drift, gain,"),
            ("noise = 1, offset = 1", "a fault is one of noise, offset,"),
            ("start = 1", "a fault is one of noise, offset,"),
            ("noise = 1, start = 1, stop = 1", "stop = 1.0, expected more than start = 1.0"),
            ("noise = 1, start = inf", "start = inf, expected a time in s"),
        ] {
            let error = fault(text).unwrap_err().to_string();
            assert!(error.contains(reason), "{text}: {error}");
        }
        let error = fault("delay = 0.15").unwrap().check(0.1).unwrap_err().to_string();
        assert!(
            error.starts_with("delay = 0.15, expected a multiple of the step, 0.1 s"),
            "{error}"
        );
        assert!(fault("delay = 0.3").unwrap().check(0.1).is_ok());
    }
}
