//! The signals of the control loop from which the metrics are computed: their names in the sweep file, their places in
//! a row of the system, and their values at one time.

use anyhow::{Result, bail, ensure};
use fmu_description::Type;
use serde::Deserialize;

use crate::{Place, Plan, Row};

/// The names of the signals, as `[signals]` in a sweep file has them.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SignalNames {
    reference: String,
    output: String,
    error: String,
    control: String,
}

impl SignalNames {
    /// The names in the order of [`SignalPlaces`].
    fn all(&self) -> [&String; 4] {
        [&self.reference, &self.output, &self.error, &self.control]
    }

    /// The names, once each, which a run records.
    pub(super) fn to_record(&self) -> Vec<String> {
        let mut names = Vec::new();
        for name in self.all() {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        names
    }

    /// The places of the signals in a row of the system.
    ///
    /// # Errors
    /// One is no number.
    pub(super) fn places(&self, plan: &Plan) -> Result<SignalPlaces> {
        for column in &plan.columns {
            if let kind @ (Type::String | Type::Binary) = column.kind {
                let (name, kind) = (&column.name, kind.as_str());
                bail!("{name} cannot be a signal: it is a {kind}");
            }
            let name = &column.name;
            ensure!(!column.optional, "{name} cannot be a signal: it is clocked");
        }
        let mut places = [Place::Real(0); 4];
        for (place, name) in places.iter_mut().zip(self.all()) {
            *place = plan.place(name)?;
        }
        Ok(SignalPlaces { places, are_first: places == [0, 1, 2, 3].map(Place::Real) })
    }
}

/// The places of reference, output, error and control in a row of the system.
#[derive(Debug, Clone, Copy)]
pub(super) struct SignalPlaces {
    places: [Place; 4],
    /// Whether they are the first columns of the row, in this order.
    are_first: bool,
}

impl SignalPlaces {
    /// The signals in a row.
    #[inline]
    pub(super) fn sample(&self, row: &Row) -> LoopSample {
        let [r, y, e, u] = match row.first() {
            Some(first) if self.are_first => *first,
            _ => self.numbers(row),
        };
        LoopSample { time: row.time, r, y, e, u }
    }

    #[cold]
    #[inline(never)]
    fn numbers(&self, row: &Row) -> [f64; 4] {
        self.places.map(|place| row.number(place))
    }
}

/// The signals of a control loop at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopSample {
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
