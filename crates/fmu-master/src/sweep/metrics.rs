//! The metrics of a run: their definitions, which are columns of the table of a sweep, and how they are computed sample by
//! sample. A new metric is a field below, a line in [`MetricsAccumulator`], and a row in `docs/sweeps.md`.

use anyhow::ensure;
use fmu_description::{Type, Value};
use serde::{Deserialize, Deserializer};

use super::signals::LoopSample;
use crate::literal::read_checked;
use crate::table::{Cell, Column};

/// Defines the metrics: each is a field, and a column of the table of a sweep, in this order.
macro_rules! metrics {
    ($($(#[$attribute:meta])* $name:ident: $type:ty,)*) => {
        /// The metrics of a run, up to its divergence if it diverged.
        #[derive(Debug, Clone, Copy, PartialEq, Default)]
        pub struct Metrics {
            $($(#[$attribute])* pub $name: $type,)*
        }

        impl Metrics {
            const COUNT: usize = [$(stringify!($name)),*].len();
            const UNKNOWN: Self = Self { $($name: <$type as Metric>::UNKNOWN,)* };

            /// The columns of the metrics.
            pub fn columns() -> [Column; Self::COUNT] {
                [$(<$type as Metric>::column(stringify!($name)),)*]
            }

            /// The metrics in the order of [`Metrics::columns`].
            pub fn cells(&self) -> [Cell; Self::COUNT] {
                [$(self.$name.cell(),)*]
            }
        }
    };
}

metrics! {
    /// Integral of |e|. This and the next two are computed from the first to the last sample by the
    /// rectangle rule: a sample holds until the next one.
    iae: f64,
    /// Integral of e².
    ise: f64,
    /// Integral of |e|, weighted by the time since the first sample in seconds.
    itae: f64,
    /// The overshoot of y beyond the reference, at least 0:
    ///
    /// - If the reference is a step, that is, changes at most once, the maximum excess of y beyond its
    ///   last value, in the direction of the step, as a fraction of the step's height. The step starts
    ///   from the reference's first value if it changes, and from the first y if not.
    /// - If the reference changes more than once, like a sine or square wave, the maximum excess of
    ///   |y| beyond the reference's maximum absolute value, as a fraction of that value.
    ///
    /// `None` if there is no sample or the step has zero height.
    overshoot: Option<f64>,
    /// The time in seconds, not before the reference's last change, from which on |e| stays within
    /// [`Criteria::band`] times the absolute value of the reference. `None` if there is no such time,
    /// the reference still changes at the last sample, or the run diverged.
    settling_time: Option<f64>,
    /// Maximum |u|; 0 if there is no sample.
    largest_u: f64,
    /// The error at the last sample; `None` if there is no sample.
    final_e: Option<f64>,
    /// Whether the simulation failed, a number was not finite, or |e| exceeded [`Criteria::limit`].
    diverged: bool,
    /// The time of divergence in seconds.
    diverged_at: Option<f64>,
}

/// The type of a metric.
trait Metric: Sized {
    /// The metric of a run that has no samples because an FMU refused it or ended its process.
    const UNKNOWN: Self;

    fn column(name: &str) -> Column;
    fn cell(self) -> Cell;
}

impl Metric for f64 {
    const UNKNOWN: Self = Self::NAN;

    fn column(name: &str) -> Column {
        Column::new(name, "", Type::Float64)
    }

    fn cell(self) -> Cell {
        Some(Value::Float64(self))
    }
}

impl Metric for Option<f64> {
    const UNKNOWN: Self = None;

    fn column(name: &str) -> Column {
        f64::column(name).optional()
    }

    fn cell(self) -> Cell {
        self.map(Value::Float64)
    }
}

impl Metric for bool {
    const UNKNOWN: Self = false;

    fn column(name: &str) -> Column {
        Column::new(name, "", Type::Boolean)
    }

    fn cell(self) -> Cell {
        Some(Value::Boolean(self))
    }
}

impl Metrics {
    /// The metrics of a run without samples that counts as diverged at a time (s).
    pub(super) fn unknown(time: f64) -> Self {
        Self { diverged: true, diverged_at: Some(time), ..Self::UNKNOWN }
    }
}

/// When a loop counts as settled, and when as diverged.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Criteria {
    /// Maximum |e| of a settled loop, as a fraction of the absolute value of the reference; where the
    /// reference is 0, a loop has settled if e is 0.
    #[serde(deserialize_with = "band")]
    pub band: f64,
    /// Maximum |e| of a loop that has not diverged, in the unit of the error.
    #[serde(deserialize_with = "limit")]
    pub limit: f64,
}

fn band<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    read_checked(deserializer, |band: f64| {
        let is_valid = band >= 0.0 && band.is_finite();
        ensure!(is_valid, "band = {band:?}, expected a finite number of at least 0");
        Ok(band)
    })
}

fn limit<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    read_checked(deserializer, |limit: f64| {
        ensure!(limit > 0.0, "limit = {limit:?}, expected more than 0");
        Ok(limit)
    })
}

impl Default for Criteria {
    fn default() -> Self {
        Self { band: 0.003, limit: 1e3 }
    }
}

/// Accumulates the metrics of a run.
///
/// ```
/// use fmu_master::sweep::{Criteria, LoopSample, MetricsAccumulator};
///
/// let mut metrics = MetricsAccumulator::new(&Criteria::default());
/// for (time, y) in [(0.0, 0.0), (0.1, 1.2), (0.2, 1.0), (0.3, 1.0)] {
///     metrics.push(LoopSample { time, r: 1.0, y, e: 1.0 - y, u: 0.0 });
/// }
/// let summary = metrics.finish();
/// assert_eq!(summary.overshoot, Some(1.2 - 1.0));
/// assert_eq!(summary.settling_time, Some(0.2));
/// assert_eq!(summary.final_e, Some(0.0));
/// ```
#[derive(Debug, Clone)]
pub struct MetricsAccumulator {
    options: Criteria,
    /// The first and the last sample.
    ends: Option<(LoopSample, LoopSample)>,
    /// Changes of the reference.
    changes: u64,
    /// Whether the last sample changed the reference.
    changed: bool,
    /// The time from which on the loop has stayed within the band.
    settled: Option<f64>,
    lowest_y: f64,
    highest_y: f64,
    largest_r: f64,
    summary: Metrics,
}

impl MetricsAccumulator {
    /// The metrics of a run without samples.
    pub fn new(options: &Criteria) -> Self {
        Self {
            options: *options,
            ends: None,
            changes: 0,
            changed: false,
            settled: None,
            lowest_y: f64::INFINITY,
            highest_y: f64::NEG_INFINITY,
            largest_r: 0.0,
            summary: Metrics::default(),
        }
    }

    /// Adds the next sample, whose time must not be before the previous one's.
    ///
    /// Returns false once the run has diverged, that is, if a number of the sample is not finite or
    /// |e| exceeds the limit. Such a sample only sets the time of divergence; neither it nor later ones
    /// enter the metrics.
    #[inline]
    pub fn push(&mut self, sample: LoopSample) -> bool {
        if self.summary.diverged {
            return false;
        }
        let LoopSample { time, r, y, e, u } = sample;
        // One check for nearly all samples: a sum is not finite if one of its numbers is not.
        let is_finite = (time + r + y + e + u).is_finite()
            || [time, r, y, e, u].iter().all(|number| number.is_finite());
        if !is_finite || e.abs() > self.options.limit {
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

    /// Records that the run diverged at a time in seconds, such as the time of a failed step.
    #[cold]
    pub fn diverge(&mut self, time: f64) {
        if !self.summary.diverged {
            self.summary.diverged = true;
            self.summary.diverged_at = Some(time);
        }
    }

    /// Returns the metrics of all samples.
    pub fn finish(self) -> Metrics {
        let resting = !self.summary.diverged && !self.changed;
        Metrics {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(time: f64, r: f64, y: f64) -> LoopSample {
        let (e, u) = (r - y, 0.0);
        LoopSample { time, r, y, e, u }
    }

    fn summary(samples: impl IntoIterator<Item = LoopSample>) -> Metrics {
        let mut metrics = MetricsAccumulator::new(&Criteria::default());
        for sample in samples {
            metrics.push(sample);
        }
        metrics.finish()
    }

    /// A reference and an output sampled every 1 ms.
    fn sampled(count: u32, r: impl Fn(f64) -> f64, y: impl Fn(f64) -> f64) -> Vec<LoopSample> {
        let times = (0..count).map(|k| 0.001 * f64::from(k));
        times.map(|time| sample(time, r(time), y(time))).collect()
    }

    fn decay(constant: f64) -> Vec<LoopSample> {
        sampled(20_000, |_| 1.0, |time| 1.0 - libm::exp(-time / constant))
    }

    #[test]
    fn a_second_order_step_response_overshoots_by_its_damping() {
        for damping in [0.2f64, 0.5, 0.8] {
            let root = (1.0 - damping * damping).sqrt();
            let response = |time: f64| {
                let (sine, cosine) = libm::sincos(10.0 * root * time);
                1.0 - libm::exp(-10.0 * damping * time) * (cosine + damping / root * sine)
            };
            let expected = libm::exp(-std::f64::consts::PI * damping / root);
            for (start, end) in [(0.0, 1.0), (0.0, -0.5), (3.0, 1.0), (-1.0, 2.0)] {
                let height = end - start;
                for step in [0.0, 0.1] {
                    let r = |time| if time < step { start } else { end };
                    let y = |time: f64| start + height * response((time - step).max(0.0));
                    let overshoot = summary(sampled(5000, r, y)).overshoot.unwrap();
                    assert!((overshoot - expected).abs() < 5e-5, "{overshoot} {expected}");
                }
            }
        }
        let undershoot =
            [(0.0, 0.0), (0.1, -0.5), (0.2, 1.0)].map(|(time, y)| sample(time, 1.0, y));
        assert_eq!(summary(undershoot).overshoot, Some(0.0));
        let none = summary(sampled(9, |_| 1.0, |_| 1.0)).overshoot;
        assert_eq!(none, None, "a step of zero height");
    }

    #[test]
    fn a_wave_overshoots_its_amplitude() {
        let sine = |time: f64| 2.0 * libm::sin(5.0 * time);
        assert_eq!(summary(sampled(2000, sine, sine)).overshoot, Some(0.0));
        let more = summary(sampled(2000, sine, |time| -1.25 * sine(time)));
        assert!((more.overshoot.unwrap() - 0.25).abs() < 1e-15);
        assert_eq!(more.settling_time, None);
    }

    #[test]
    fn the_settling_time_restarts_when_the_reference_changes() {
        for (samples, settled) in [
            (&[(1.0, 1.0)][..], Some(0.0)),
            (&[(1.0, 1.0), (1.0, 1.0)], Some(0.0)),
            (&[(1.0, 1.0), (1.0, 1.1), (1.0, 1.0)], Some(0.2)),
            (&[(1.0, 1.0), (1.001, 1.0), (1.001, 1.0)], Some(0.1)),
            (&[(1.0, 1.0), (1.001, 1.0)], None),
            (&[(1.0, 1.0), (1.0, 0.9)], None),
        ] {
            let times = [0.0, 0.1, 0.2].into_iter().zip(samples);
            let found = summary(times.map(|(time, (r, y))| sample(time, *r, *y)));
            assert_eq!(found.settling_time, settled);
        }
    }

    #[test]
    fn metrics_stop_at_divergence() {
        let sound = decay(0.1);
        let until = summary(sound[..50].iter().copied());
        let (nan, infinity) = (f64::NAN, f64::INFINITY);
        for wrong in [
            [nan, 0.0, 0.0, 0.0],
            [0.0, infinity, 0.0, 0.0],
            [0.0, 0.0, nan, 0.0],
            [0.0, 0.0, -1000.1, 0.0],
            [0.0, 0.0, 0.0, -infinity],
        ] {
            let [r, y, e, u] = wrong;
            let mut metrics = MetricsAccumulator::new(&Criteria::default());
            assert!(sound[..50].iter().all(|&sample| metrics.push(sample)));
            let time = sound[50].time;
            assert!(!metrics.push(LoopSample { time, r, y, e, u }));
            assert!(!metrics.push(sound[51]));
            metrics.diverge(99.0);
            let expected =
                Metrics { diverged: true, diverged_at: Some(time), settling_time: None, ..until };
            assert_eq!(metrics.finish(), expected);
        }
        let mut metrics = MetricsAccumulator::new(&Criteria::default());
        metrics.diverge(0.5);
        let found = metrics.finish();
        assert_eq!((found.diverged_at, found.final_e), (Some(0.5), None));
    }

    #[test]
    fn options_are_checked() {
        for wrong in ["band = -0.1", "band = nan", "limit = 0.0", "limit = nan", "bnd = 0"] {
            assert!(toml::from_str::<Criteria>(wrong).is_err(), "{wrong}");
        }
        let partial: Criteria = toml::from_str("limit = inf").unwrap();
        assert_eq!(partial.band, 0.003);
    }
}
