//! A row of results.

use fmu_description::Value;
use serde::{Deserialize, Serialize};

use crate::Place;
use crate::store::{Store, places};
use crate::table::{Cell, Column};

/// A row of results: the values of the recorded variables at a communication point. Its columns are those
/// of [`Plan::columns`](crate::Plan::columns).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Row {
    /// The communication point (s).
    pub time: f64,
    pub(crate) store: Store<Cell>,
}

impl Row {
    pub(super) fn new(columns: &[Column]) -> Self {
        Self { time: f64::NAN, store: Store::new(counts(columns)) }
    }

    /// Whether it has the values of these columns.
    pub(crate) fn fits(&self, columns: &[Column]) -> bool {
        let Store { reals, others } = &self.store;
        [reals.len(), others.len()] == counts(columns)
    }

    /// The number at a place, which [`Plan::place`](crate::Plan::place) finds, or a Boolean as 0 or 1; NaN for other values.
    #[inline]
    pub fn number(&self, place: Place) -> f64 {
        self.store.number(place)
    }

    /// The values of the first columns of the type Float64, if there are as many.
    #[inline]
    pub(crate) fn first<const N: usize>(&self) -> Option<&[f64; N]> {
        self.store.reals.first_chunk()
    }

    /// The values of the columns of [`Plan::columns`](crate::Plan::columns); `None` where one is absent.
    pub fn values(&self, columns: &[Column]) -> impl Iterator<Item = Cell> {
        Self::places(columns).map(|place| self.store.cell(place))
    }

    /// The time and the values of the columns as people read them.
    pub fn cells(&self, columns: &[Column]) -> impl Iterator<Item = Cell> {
        let values = columns.iter().zip(self.values(columns));
        let values = values.map(|(column, value)| value.map(|value| column.named(value)));
        [Some(Value::Float64(self.time))].into_iter().chain(values)
    }

    /// The places of the columns.
    pub(crate) fn places(columns: &[Column]) -> impl Iterator<Item = Place> {
        places(columns.iter().map(Column::is_real))
    }
}

/// The number of columns with a Float64 in every row, and of the others.
fn counts(columns: &[Column]) -> [usize; 2] {
    let reals = columns.iter().filter(|column| column.is_real()).count();
    [reals, columns.len() - reals]
}
