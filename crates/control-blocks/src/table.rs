//! Lookup tables with linear interpolation.
//!
//! W. H. Press, S. A. Teukolsky, W. T. Vetterling and B. P. Flannery, *Numerical Recipes* (3rd ed., Cambridge, 2007),
//! chapter 3. The values are those of `numpy.interp` and `scipy.interpolate.RegularGridInterpolator`.

use core::cmp::Ordering;
use core::error::Error;
use core::fmt;

/// What a table says outside its axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "fmi", derive(fmu_derive::Choice), choice(crate = fmu_description))]
pub enum Extrapolation {
    /// The value at the end of the axis.
    #[default]
    Hold,
    /// The line through the last two points goes on.
    Linear,
}

/// Table of `N` points, with straight lines between them.
///
/// The axis `x` increases strictly, which [`check`](Self::check) verifies; if it does not, values have no meaning, but
/// are still finite.
///
/// ```
/// use control_blocks::Table1;
///
/// let torque = Table1 { x: [0.0, 100.0, 300.0], y: [5.0, 9.0, 1.0], ..Table1::default() };
/// assert_eq!([50.0, 200.0, 400.0].map(|speed| torque.value(speed)), [7.0, 5.0, 1.0]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Table1<const N: usize> {
    /// Axis of the table, strictly increasing.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable, start = count()))]
    pub x: [f64; N],
    /// Value at the point of the axis.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub y: [f64; N],
    /// What the table says outside its axis.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub extrapolation: Extrapolation,
}

/// Table of `R` times `C` points, bilinear between them.
///
/// The axes `x` of the rows and `y` of the columns increase strictly, as in [`Table1`].
///
/// ```
/// use control_blocks::Table2;
///
/// let table = Table2 { x: [0.0, 1.0], y: [0.0, 10.0], z: [[0.0, 4.0], [2.0, 8.0]], ..Table2::default() };
/// assert_eq!(table.value(0.5, 5.0), 3.5);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Table2<const R: usize, const C: usize> {
    /// Axis of the rows, strictly increasing.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable, start = count()))]
    pub x: [f64; R],
    /// Axis of the columns, strictly increasing.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable, start = count()))]
    pub y: [f64; C],
    /// Value at the points of both axes.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub z: [[f64; C]; R],
    /// What the table says outside its axes.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub extrapolation: Extrapolation,
}

/// The numbers from 0 on.
const fn count<const N: usize>() -> [f64; N] {
    let (mut numbers, mut i) = ([0.0; N], 0);
    while i < N {
        numbers[i] = i as f64;
        i += 1;
    }
    numbers
}

impl<const N: usize> Default for Table1<N> {
    fn default() -> Self {
        Self { x: count(), y: [0.0; N], extrapolation: Extrapolation::default() }
    }
}

impl<const R: usize, const C: usize> Default for Table2<R, C> {
    fn default() -> Self {
        let extrapolation = Extrapolation::default();
        Self { x: count(), y: count(), z: [[0.0; C]; R], extrapolation }
    }
}

impl<const N: usize> Table1<N> {
    /// The value at `x`.
    pub fn value(&self, x: f64) -> f64 {
        const { assert!(N > 0, "a table has at least one point") };
        let place = Place::of(x, &self.x, self.extrapolation);
        place.between(self.y[place.before], self.y[place.after])
    }

    /// Checks that the axis increases strictly.
    ///
    /// # Errors
    /// It does not.
    pub fn check(&self) -> Result<(), AxisError> {
        check("x", &self.x)
    }
}

impl<const R: usize, const C: usize> Table2<R, C> {
    /// The value at `x`, on the axis of the rows, and `y`, on the axis of the columns.
    pub fn value(&self, x: f64, y: f64) -> f64 {
        const { assert!(R > 0 && C > 0, "a table has at least one point") };
        let row = Place::of(x, &self.x, self.extrapolation);
        let column = Place::of(y, &self.y, self.extrapolation);
        let in_row =
            |row: usize| column.between(self.z[row][column.before], self.z[row][column.after]);
        row.between(in_row(row.before), in_row(row.after))
    }

    /// Checks that both axes increase strictly.
    ///
    /// # Errors
    /// One does not.
    pub fn check(&self) -> Result<(), AxisError> {
        check("x", &self.x)?;
        check("y", &self.y)
    }
}

/// A place on an axis: two points, and the part of the way from the first to the second.
struct Place {
    before: usize,
    after: usize,
    part: f64,
}

impl Place {
    fn of(x: f64, axis: &[f64], extrapolation: Extrapolation) -> Self {
        let last = axis.len() - 1;
        let after = axis.partition_point(|point| *point <= x).clamp(last.min(1), last);
        let before = after.saturating_sub(1);
        let (start, width) = (axis[before], axis[after] - axis[before]);
        let part = if width > 0.0 { (x - start) / width } else { 0.0 };
        let part = match extrapolation {
            Extrapolation::Hold => crate::clip(part, 0.0, 1.0),
            Extrapolation::Linear => part,
        };
        Self { before, after, part }
    }

    /// Exact at both points.
    fn between(&self, before: f64, after: f64) -> f64 {
        (1.0 - self.part) * before + self.part * after
    }
}

fn check(axis: &'static str, points: &[f64]) -> Result<(), AxisError> {
    // Not `is_sorted_by`, since the message has the place; NaN is no greater number.
    let mut pairs = points.windows(2).enumerate();
    match pairs.find(|(_, pair)| pair[0].partial_cmp(&pair[1]) != Some(Ordering::Less)) {
        Some((i, pair)) => Err(AxisError { axis, index: i + 2, value: pair[1], before: pair[0] }),
        None => Ok(()),
    }
}

/// An axis of a table does not increase strictly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisError {
    /// Name of the axis.
    pub axis: &'static str,
    /// Number of the wrong point, from 1.
    pub index: usize,
    /// The wrong point.
    pub value: f64,
    /// The point before it.
    pub before: f64,
}

impl fmt::Display for AxisError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { axis, index, value, before } = self;
        write!(
            f,
            "table: {axis}[{index}] = {value}; expected more than {before}, the point before it"
        )
    }
}

impl Error for AxisError {}
