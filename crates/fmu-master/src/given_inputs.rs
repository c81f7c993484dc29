//! Inputs that a program gives as values, which may be constant or change over time, for scalars and for whole arrays.

use anyhow::{Result, bail};
use serde::{Deserialize, Serialize};

use crate::table::Series;

/// Inputs that a program gives: values over time and constants, of scalars and of whole arrays.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GivenInputs {
    /// The times (s) of values over time.
    pub time: Series,
    /// The inputs.
    pub inputs: Vec<GivenInput>,
}

/// The values of an input that a program gives, in any shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GivenInput {
    /// The values, row by row.
    pub series: Series,
    /// The lengths of their dimensions.
    pub shape: Vec<usize>,
    /// Whether the first dimension is the time; else the values are constant. `None` if that follows from the shape.
    pub is_over_time: Option<bool>,
}

impl GivenInput {
    /// Whether the values are constant for an input with these dimensions, else there is a row for each of the times.
    ///
    /// # Errors
    /// They have neither shape.
    pub(crate) fn is_constant(
        &self,
        times: usize,
        dimensions: &[usize],
        all: &GivenInputs,
    ) -> Result<bool> {
        let count: usize = dimensions.iter().product();
        let Self { series: Series { name, .. }, shape, is_over_time } = self;
        if *is_over_time != Some(true) && shape == dimensions {
            return Ok(true);
        }
        // A recorded matrix has its elements in one row, too.
        let is_row = |row: &[usize]| row == dimensions || row == [count];
        if *is_over_time != Some(false)
            && shape.split_first().is_some_and(|(rows, row)| *rows == times && is_row(row))
        {
            return Ok(false);
        }
        let words = |shape: &[usize]| match shape {
            [] => "1".to_owned(),
            shape => Vec::from_iter(shape.iter().map(usize::to_string)).join(" x "),
        };
        let (found, constant) = (words(shape), words(dimensions));
        let over_time = words(&[&[times], dimensions].concat());
        match (is_over_time, dimensions) {
            (Some(false), []) => {
                let names = Vec::from_iter(all.inputs.iter().map(|input| &*input.series.name));
                bail!("input = {}, expected also a column time [s]", names.join(", "))
            }
            (_, []) if shape.len() == 1 => bail!("input {name}: {found} values, expected {times}"),
            (_, []) => bail!("input {name}: values: {found}, expected one, or {times} over time"),
            (Some(false), _) => bail!(
                "input {name}: values: {found}, expected {constant}, or also a column time [s]"
            ),
            (Some(true), _) => bail!("input {name}: values: {found}, expected {over_time}"),
            (None, _) => bail!(
                "input {name}: values: {found}, expected {over_time} over time, or {constant}"
            ),
        }
    }
}
