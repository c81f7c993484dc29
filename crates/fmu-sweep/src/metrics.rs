//! Metrics of a run, computed sample by sample.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

use crate::{Cell, Column, Error, Kind, Value};

/// When a loop counts as settled, and when as diverged.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Maximum |e| of a settled loop, as a fraction of the absolute value of the reference; where the
    /// reference is 0, a loop has settled if e is 0.
    #[serde(deserialize_with = "band")]
    pub band: f64,
    /// Maximum |e| of a loop that has not diverged, in the unit of the error.
    #[serde(deserialize_with = "limit")]
    pub limit: f64,
}

/// Reads and checks a band, so that an error names its line.
fn band<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let band = f64::deserialize(deserializer)?;
    let options = Options {
        band,
        ..Options::default()
    };
    options.check().map_err(D::Error::custom)?;
    Ok(band)
}

/// Reads and checks a limit, so that an error names its line.
fn limit<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let limit = f64::deserialize(deserializer)?;
    let options = Options {
        limit,
        ..Options::default()
    };
    options.check().map_err(D::Error::custom)?;
    Ok(limit)
}

impl Default for Options {
    fn default() -> Self {
        Self {
            band: 0.003,
            limit: 1e3,
        }
    }
}

impl Options {
    /// Checks that the band is finite and not negative, and the limit positive.
    ///
    /// # Errors
    /// If one of them is not.
    pub fn check(&self) -> Result<(), Error> {
        if !(self.band >= 0.0 && self.band.is_finite()) {
            return Err(Error::new(format!(
                "band = {:?}, expected a finite number of at least 0",
                self.band
            )));
        }
        if self.limit > 0.0 {
            return Ok(());
        }
        Err(Error::new(format!(
            "limit = {:?}, expected more than 0",
            self.limit
        )))
    }
}

/// The signals of a control loop at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time in seconds.
    pub time: f64,
    /// Reference (set-point).
    pub r: f64,
    /// Output of the plant, in the unit of the reference.
    pub y: f64,
    /// Error, in the unit of the reference. It is passed in rather than computed, since the
    /// controller's error includes the disturbance of the measured output.
    pub e: f64,
    /// Control.
    pub u: f64,
}

/// Accumulates the metrics of a run.
///
/// ```
/// use fmu_sweep::{Metrics, Options, Sample};
///
/// let mut metrics = Metrics::new(&Options::default());
/// for (time, y) in [(0.0, 0.0), (0.1, 1.2), (0.2, 1.0), (0.3, 1.0)] {
///     metrics.push(Sample { time, r: 1.0, y, e: 1.0 - y, u: 0.0 });
/// }
/// let summary = metrics.finish();
/// assert_eq!(summary.overshoot, Some(1.2 - 1.0));
/// assert_eq!(summary.settling_time, Some(0.2));
/// assert_eq!(summary.final_e, Some(0.0));
/// ```
#[derive(Debug, Clone)]
pub struct Metrics {
    options: Options,
    /// The first and the last sample.
    ends: Option<(Sample, Sample)>,
    /// Changes of the reference.
    changes: u64,
    /// Whether the last sample changed the reference.
    changed: bool,
    /// The time from which on the loop has stayed within the band.
    settled: Option<f64>,
    lowest_y: f64,
    highest_y: f64,
    largest_r: f64,
    summary: Summary,
}

impl Metrics {
    /// The metrics of a run without samples.
    #[must_use]
    pub fn new(options: &Options) -> Self {
        Self {
            options: *options,
            ends: None,
            changes: 0,
            changed: false,
            settled: None,
            lowest_y: f64::INFINITY,
            highest_y: f64::NEG_INFINITY,
            largest_r: 0.0,
            summary: Summary::default(),
        }
    }

    /// Adds the next sample, whose time must not be before the previous one's.
    ///
    /// Returns false once the run has diverged, that is, if a number of the sample is not finite or
    /// |e| exceeds the limit. Such a sample only sets the time of divergence; neither it nor later ones
    /// enter the metrics.
    #[inline]
    pub fn push(&mut self, sample: Sample) -> bool {
        if self.summary.diverged {
            return false;
        }
        let Sample { time, r, y, e, u } = sample;
        // One check for all numbers: 0 times a number that is not finite is NaN.
        let zero: f64 = [time, r, y, e, u].iter().map(|x| 0.0 * x).sum();
        if zero.is_nan() || e.abs() > self.options.limit {
            self.diverge(time);
            return false;
        }
        let (first, last) = self.ends.get_or_insert((sample, sample));
        self.changed = r != last.r;
        self.changes += u64::from(self.changed);

        let step = time - last.time;
        debug_assert!(step >= 0.0, "{time} comes after {}", last.time);
        self.summary.iae += last.e.abs() * step;
        self.summary.ise += last.e * last.e * step;
        self.summary.itae += (last.time - first.time) * last.e.abs() * step;
        *last = sample;

        self.summary.largest_u = larger(self.summary.largest_u, u.abs());
        self.lowest_y = if y < self.lowest_y { y } else { self.lowest_y };
        self.highest_y = larger(self.highest_y, y);
        self.largest_r = larger(self.largest_r, r.abs());

        if e.abs() > self.options.band * r.abs() {
            self.settled = None;
        } else if self.changed || self.settled.is_none() {
            self.settled = Some(time);
        }
        true
    }

    /// Records that the run diverged at a time in seconds, such as that of a failed step.
    #[cold]
    pub fn diverge(&mut self, time: f64) {
        if !self.summary.diverged {
            self.summary.diverged = true;
            self.summary.diverged_at = Some(time);
        }
    }

    /// Returns the metrics of all samples.
    #[must_use]
    pub fn finish(self) -> Summary {
        let resting = !self.summary.diverged && !self.changed;
        Summary {
            overshoot: self.overshoot(),
            settling_time: self.settled.filter(|_| resting),
            final_e: self.ends.map(|(_, last)| last.e),
            ..self.summary
        }
    }

    fn overshoot(&self) -> Option<f64> {
        let (first, last) = self.ends?;
        let (excess, height) = if self.changes > 1 {
            let largest_y = self.highest_y.max(-self.lowest_y);
            (largest_y - self.largest_r, self.largest_r)
        } else {
            let start = if self.changes == 0 { first.y } else { first.r };
            let height = last.r - start;
            if height > 0.0 {
                (self.highest_y - last.r, height)
            } else {
                (last.r - self.lowest_y, -height)
            }
        };
        (height > 0.0).then(|| excess.max(0.0) / height)
    }
}

/// The larger of two numbers. Unlike [`f64::max`], it does not look for NaN, which makes it one
/// instruction.
#[inline]
fn larger(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}

/// The metrics of a run, up to its divergence if it diverged.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Summary {
    /// Integral of |e|. This and the next two are computed from the first to the last sample by the
    /// rectangle rule: a sample holds until the next one.
    pub iae: f64,
    /// Integral of e².
    pub ise: f64,
    /// Integral of |e|, weighted by the time since the first sample in seconds.
    pub itae: f64,
    /// The overshoot of y beyond the reference, at least 0:
    ///
    /// - If the reference is a step, that is, changes at most once, the maximum excess of y beyond its
    ///   last value, in the direction of the step, as a fraction of the step's height. The step starts
    ///   from the reference's first value if it changes, and from the first y if not.
    /// - If the reference changes more than once, like a sine or square wave, the maximum excess of
    ///   |y| beyond the reference's maximum absolute value, as a fraction of that value.
    ///
    /// `None` if there is no sample or the step has zero height.
    pub overshoot: Option<f64>,
    /// The time in seconds, not before the reference's last change, from which on |e| stays within
    /// [`Options::band`] times the absolute value of the reference. `None` if there is no such time,
    /// the reference still changes at the last sample, or the run diverged.
    pub settling_time: Option<f64>,
    /// Maximum |u|; 0 if there is no sample.
    pub largest_u: f64,
    /// The error at the last sample; `None` if there is no sample.
    pub final_e: Option<f64>,
    /// Whether the simulation failed, a number was not finite, or |e| exceeded [`Options::limit`].
    pub diverged: bool,
    /// The time of divergence in seconds.
    pub diverged_at: Option<f64>,
}

impl Summary {
    /// The columns of the metrics, named like the fields.
    #[must_use]
    pub fn columns() -> [Column; 9] {
        [
            ("iae", Kind::Number, false),
            ("ise", Kind::Number, false),
            ("itae", Kind::Number, false),
            ("overshoot", Kind::Number, true),
            ("settling_time", Kind::Number, true),
            ("largest_u", Kind::Number, false),
            ("final_e", Kind::Number, true),
            ("diverged", Kind::Boolean, false),
            ("diverged_at", Kind::Number, true),
        ]
        .map(|(name, kind, optional)| Column {
            name: name.to_owned(),
            kind,
            optional,
        })
    }

    /// The metrics in the order of their columns.
    #[must_use]
    pub fn cells(&self) -> [Cell; 9] {
        let number = |number| Some(Value::Number(number));
        [
            number(self.iae),
            number(self.ise),
            number(self.itae),
            self.overshoot.map(Value::Number),
            self.settling_time.map(Value::Number),
            number(self.largest_u),
            self.final_e.map(Value::Number),
            Some(Value::Boolean(self.diverged)),
            self.diverged_at.map(Value::Number),
        ]
    }
}

/// The settling time of a recorded response: the first time after the last sample with |e| > band, in
/// the unit of `time`. `None` if there is no sample or the last one is outside; NaN counts as outside.
///
/// ```
/// let settled = fmu_sweep::metrics::settling_time(&[0.0, 0.1, 0.2], &[1.0, -0.2, 0.01], 0.02);
/// assert_eq!(settled, Some(0.2));
/// ```
///
/// # Panics
/// If `time` and `error` differ in length.
#[must_use]
pub fn settling_time(time: &[f64], error: &[f64], band: f64) -> Option<f64> {
    assert_eq!(time.len(), error.len(), "a time for each error");
    let outside = |e: &f64| e.is_nan() || e.abs() > band;
    let settled = error.iter().rposition(outside).map_or(0, |last| last + 1);
    time.get(settled).copied()
}

#[cfg(test)]
mod tests;
