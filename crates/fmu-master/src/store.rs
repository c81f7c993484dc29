//! The store of the values of signals: of outputs during a run, and of a row of results.

use fmu_description::{Type, Value};
use serde::{Deserialize, Serialize};

use crate::table::Cell;

/// A place among values of the type Float64, or among the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "see above")]
pub enum Place {
    Real(usize),
    Other(usize),
}

impl Place {
    pub(crate) fn plus(self, offset: usize) -> Self {
        match self {
            Self::Real(index) => Self::Real(index + offset),
            Self::Other(index) => Self::Other(index + offset),
        }
    }

    /// The next place of a type, which is counted.
    pub(crate) fn next(kind: Type, counts: &mut [usize; 2]) -> Self {
        Self::next_of(kind == Type::Float64, counts)
    }

    fn next_of(is_real: bool, [reals, others]: &mut [usize; 2]) -> Self {
        let (count, first) = match is_real {
            true => (reals, Self::Real(0)),
            false => (others, Self::Other(0)),
        };
        *count += 1;
        first.plus(*count - 1)
    }
}

/// The places in a row of columns; says of each whether it has a Float64 in every row.
pub(crate) fn places(are_real: impl Iterator<Item = bool>) -> impl Iterator<Item = Place> {
    let mut counts = [0; 2];
    are_real.map(move |is_real| Place::next_of(is_real, &mut counts))
}

/// Values: Float64 as `f64`, which is fast, and the others. Those of a row may be absent, a Float64 then is another one.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Store<T = Value> {
    pub(crate) reals: Vec<f64>,
    pub(crate) others: Vec<T>,
}

impl<T: Clone + From<Value>> Store<T> {
    /// This many values of each kind.
    pub(crate) fn new([reals, others]: [usize; 2]) -> Self {
        Self { reals: vec![0.0; reals], others: vec![Value::Boolean(false).into(); others] }
    }

    /// Copies all values of a store of the same size.
    pub(crate) fn copy_from(&mut self, from: &Self) {
        self.reals.clone_from(&from.reals);
        self.others.clone_from(&from.others);
    }
}

impl Store {
    /// A number, or a Boolean as 0 or 1; NaN for other values.
    #[inline(always)]
    pub(crate) fn number(&self, place: Place) -> f64 {
        match place {
            Place::Real(index) => self.reals[index],
            Place::Other(index) => self.other(index),
        }
    }

    /// A function of its own, which keeps the usual case short.
    #[cold]
    #[inline(never)]
    fn other(&self, index: usize) -> f64 {
        number(&self.others[index])
    }

    pub(crate) fn value(&self, place: Place) -> Value {
        match place {
            Place::Real(index) => Value::Float64(self.reals[index]),
            Place::Other(index) => self.others[index].clone(),
        }
    }

    pub(crate) fn set(&mut self, place: Place, value: Value) {
        match place {
            Place::Real(index) => self.reals[index] = number(&value),
            Place::Other(index) => self.others[index] = value,
        }
    }
}

impl Store<Cell> {
    /// A number, or a Boolean as 0 or 1; NaN for other values, and if it is absent.
    #[inline(always)]
    pub(crate) fn number(&self, place: Place) -> f64 {
        match place {
            Place::Real(index) => self.reals[index],
            Place::Other(index) => self.other(index),
        }
    }

    #[cold]
    #[inline(never)]
    fn other(&self, index: usize) -> f64 {
        self.others[index].as_ref().map_or(f64::NAN, number)
    }

    pub(crate) fn cell(&self, place: Place) -> Cell {
        match place {
            Place::Real(index) => Some(Value::Float64(self.reals[index])),
            Place::Other(index) => self.others[index].clone(),
        }
    }

    /// Copies recorded values of signals; if they are `PLAIN`, all are Float64.
    #[inline(always)]
    pub(crate) fn record<const PLAIN: bool>(&mut self, records: &RecordedSignals, from: &Store) {
        let (reals, sources) = (&mut *self.reals, &*from.reals);
        for &Transfer { from, to } in &records.reals {
            reals[to] = sources[from];
        }
        if !PLAIN {
            for &Transfer { from: source, to } in &records.others {
                self.others[to] = Some(from.others[source].clone());
            }
        }
    }
}

/// The recorded signals of some components. Values are stored in the same way among the outputs and in a row.
#[derive(Default)]
pub(crate) struct RecordedSignals {
    pub(crate) reals: Vec<Transfer>,
    pub(crate) others: Vec<Transfer>,
}

impl RecordedSignals {
    /// Adds an output at a place in the store, which is recorded in a column.
    pub(crate) fn add(&mut self, output: Place, column: Place) {
        match (output, column) {
            (Place::Real(from), Place::Real(to)) => self.reals.push(Transfer { from, to }),
            (Place::Real(from) | Place::Other(from), Place::Real(to) | Place::Other(to)) => {
                self.others.push(Transfer { from, to });
            }
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.reals.is_empty() && self.others.is_empty()
    }
}

/// A value that is copied, by its index among the values that it is copied from and to.
#[derive(Clone, Copy)]
pub(crate) struct Transfer {
    pub(crate) from: usize,
    pub(crate) to: usize,
}

/// A value as a number, a Boolean as 0 or 1; NaN for values that are no numbers.
pub(crate) fn number(value: &Value) -> f64 {
    match value {
        Value::Boolean(value) | Value::Clock(value) => (*value).into(),
        value => {
            let whole = value.as_whole().map(|whole| whole as f64);
            whole.or(value.as_real()).unwrap_or(f64::NAN)
        }
    }
}
