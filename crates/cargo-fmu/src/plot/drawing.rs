//! The runs of a page: the rows of one as they arrive, those of others from files, and their differences.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Error, Result, ensure};
use fmu_description::{Type, Value as Cell};
use fmu_master::Column;
use fmu_master::curve::{self, Curve};
use fmu_master::table::{self, Rows, Series};
use serde_json::{Value, json};

use super::decimation::Decimation;
use super::difference::{Difference, Pair, Row};

/// About how many numbers of all runs a page has; each has about ten characters.
const NUMBERS: usize = 200_000;
/// About how many numbers of their differences it has.
const DIFFERENCES: usize = 50_000;
/// The most different texts of a signal that have names of their own.
const MOST_ITEMS: usize = 200;
/// The name of all further texts.
const OTHERS: &str = "(others)";

/// The runs of a page.
pub struct Drawing {
    run: Run,
    others: Vec<Other>,
    /// The row that arrives.
    row: Vec<f64>,
}

/// A complete run, whose rows are read as the page needs them.
pub struct CompleteRun {
    /// Its name in the legend, by what differs from the other runs.
    name: String,
    columns: Vec<Column>,
    rows: TimedRows,
}

type TimedRow = (f64, Vec<Option<Cell>>);
type TimedRows = Box<dyn Iterator<Item = Result<TimedRow>>>;

impl CompleteRun {
    /// The run of a file, which is read once to check it.
    ///
    /// # Errors
    /// The file is not a table with a column of times.
    pub fn read(name: String, file: &Path) -> Result<Self> {
        let cannot = || format!("{} cannot be plotted", file.display());
        let open = || Rows::open(file).with_context(cannot);
        if !file.is_file() {
            // A pipe is read once.
            let table = table::read(file).with_context(cannot)?;
            return Self::of(name, table).with_context(cannot);
        }
        let rows = open()?;
        let titles = rows.columns.clone();
        let rows = rows.timed().with_context(cannot)?;
        let columns = columns_of(titles, rows).with_context(cannot)?;
        Ok(Self { name, columns, rows: Box::new(open()?.timed()?) })
    }

    /// The run of a table.
    ///
    /// # Errors
    /// As [`CompleteRun::read`].
    pub fn of(name: String, table: Vec<Series>) -> Result<Self> {
        let titles =
            table.iter().map(|Series { name, unit, .. }| Series::new(name, unit, Vec::new()));
        let times = table::times(&table)?.into_iter().enumerate();
        let row = |row: usize| Vec::from_iter(table.iter().map(|series| series.cells[row].clone()));
        let columns =
            columns_of(titles.collect(), times.map(|(index, time)| Ok((time, row(index)))))?;
        Ok(Self { name, columns, rows: Box::new(Rows::of(table).timed()?) })
    }
}

/// Another run, and the difference of the first one to it.
struct Other {
    recorded: Recorded,
    difference: Difference,
}

/// The rows of a complete run, which are recorded when they are taken.
struct Recorded {
    run: Run,
    rows: TimedRows,
    error: Option<Error>,
}

impl Iterator for Recorded {
    type Item = Row;

    fn next(&mut self) -> Option<Row> {
        match self.rows.next()? {
            Ok((time, cells)) => {
                let mut row = Vec::with_capacity(cells.len());
                self.run.push(time, cells.into_iter().skip(1), &mut row);
                Some((time, row))
            }
            Err(error) => {
                self.error = Some(error);
                None
            }
        }
    }
}

/// The rows of a run.
struct Run {
    name: String,
    signals: Vec<Signal>,
    decimation: Decimation,
}

/// A signal, whose values are numbers: Booleans are 0 or 1, and texts and items of Enumerations the index of the text.
struct Signal {
    column: Column,
    curve: Curve,
    items: Vec<String>,
    index: HashMap<String, usize>,
    /// The last number; a clocked variable, which may be absent, keeps it until the next tick.
    last: f64,
    /// The number of values that are NaN, infinite, missing or no number.
    without: usize,
}

impl Drawing {
    /// A page of a run with these columns, whose rows will arrive, and of complete runs.
    pub fn new(
        name: String,
        columns: &[Column],
        curves: &[Curve],
        others: Vec<CompleteRun>,
    ) -> Self {
        let values = NUMBERS / (others.len() + 1);
        let differences = DIFFERENCES / others.len().max(1);
        let others = others.into_iter().map(|CompleteRun { name, columns: other, rows }| {
            let run = Run::new(name, &other, &curve::of_columns(&other), values);
            let pairs = columns.iter().enumerate().filter_map(|(first, column)| {
                let is_same =
                    |other: &Column| other.name == column.name && other.unit == column.unit;
                let second = other.iter().position(is_same)?;
                let is_number = is_number(column) && is_number(&other[second]);
                let (signals, is_held) = ([first, second], curves[first].is_held);
                is_number.then_some(Pair { signals, is_held, largest: None })
            });
            let difference = Difference::new(pairs.collect(), differences);
            Other { recorded: Recorded { run, rows, error: None }, difference }
        });
        let others = others.collect();
        Self { run: Run::new(name, columns, curves, values), others, row: Vec::new() }
    }

    /// A page of complete runs.
    ///
    /// # Errors
    /// A row cannot be read.
    pub fn of_runs(first: CompleteRun, others: Vec<CompleteRun>) -> Result<Self> {
        let CompleteRun { name, columns, rows } = first;
        let mut drawing = Self::new(name, &columns, &curve::of_columns(&columns), others);
        for row in rows {
            let (time, cells) = row?;
            drawing.push(time, cells.into_iter().skip(1));
        }
        Ok(drawing)
    }

    /// Adds a row of the run.
    pub fn push(&mut self, time: f64, cells: impl Iterator<Item = Option<Cell>>) {
        self.run.push(time, cells, &mut self.row);
        for Other { recorded, difference } in &mut self.others {
            difference.push(recorded, time, &self.row);
        }
    }

    /// The data of the page; see `page.html`.
    ///
    /// # Errors
    /// A row of another run cannot be read.
    pub fn finish(mut self) -> Result<Value> {
        let mut runs = vec![self.run.json()];
        for Other { recorded, difference } in &mut self.others {
            difference.finish(recorded);
            while recorded.next().is_some() {}
            if let Some(error) = recorded.error.take() {
                return Err(error.context(format!("{} cannot be plotted", recorded.run.name)));
            }
            let mut other = recorded.run.json();
            other["difference"] = self.run.difference(difference);
            runs.push(other);
        }
        Ok(runs.into())
    }
}

impl Run {
    fn new(name: String, columns: &[Column], curves: &[Curve], values: usize) -> Self {
        let signals = columns.iter().zip(curves).map(|(column, curve)| {
            let items = Vec::from_iter(column.items.values().cloned());
            let index = items.iter().cloned().zip(0..).collect();
            let (column, curve, last) = (column.clone(), curve.clone(), f64::NAN);
            Signal { column, curve, items, index, last, without: 0 }
        });
        let signals = Vec::from_iter(signals);
        Self { name, decimation: Decimation::new(signals.len(), values), signals }
    }

    /// Adds a row, and returns its numbers.
    fn push(&mut self, time: f64, cells: impl Iterator<Item = Option<Cell>>, row: &mut Vec<f64>) {
        let signals = self.signals.iter_mut().zip(cells);
        row.clear();
        row.extend(signals.map(|(signal, cell)| signal.number(cell)));
        self.decimation.push(time, row);
    }

    fn json(&self) -> Value {
        let columns = self.signals.iter().zip(self.decimation.signals());
        let columns = columns.map(|(signal, values)| signal.json(values, &self.signals));
        let Self { name, decimation, .. } = self;
        json!({
            "name": name,
            "rows": decimation.rows,
            "interval": decimation.width,
            "time": decimation.times(),
            "columns": Vec::from_iter(columns),
        })
    }

    /// The difference of this run to another one.
    fn difference(&self, difference: &Difference) -> Value {
        let columns = difference.pairs.iter().zip(difference.decimation.signals());
        let columns = columns.map(|(pair, values)| {
            let (largest, time) = pair.largest.unzip();
            let Column { name, unit, .. } = &self.signals[pair.signals[0]].column;
            let values = shortened(numbers(&values));
            json!({"name": name, "unit": unit, "values": values, "largest": largest, "at": time})
        });
        json!({"time": difference.decimation.times(), "columns": Vec::from_iter(columns)})
    }
}

impl Signal {
    /// A value as a number, NaN if it is none.
    fn number(&mut self, cell: Option<Cell>) -> f64 {
        let number = match cell {
            Some(cell) if is_text(&self.column) => Some(self.item(cell) as f64),
            Some(Cell::Boolean(value) | Cell::Clock(value)) => Some(f64::from(value)),
            None if self.column.optional => return self.last,
            Some(cell) => cell.as_real().or_else(|| cell.as_whole().map(|whole| whole as f64)),
            None => None,
        };
        let number = number.filter(|number| number.is_finite());
        self.without += usize::from(number.is_none());
        self.last = number.unwrap_or(f64::NAN);
        self.last
    }

    /// The index of a text or of the name of an item, which may be a new one.
    fn item(&mut self, cell: Cell) -> usize {
        let mut text = self.column.named(cell).to_string();
        if self.items.len() >= MOST_ITEMS && !self.index.contains_key(&text) {
            text = OTHERS.to_owned();
        }
        let items = &mut self.items;
        *self.index.entry(text).or_insert_with_key(|text| {
            items.push(text.clone());
            items.len() - 1
        })
    }

    fn json(&self, values: Vec<f64>, signals: &[Self]) -> Value {
        let Self { column, curve, items, .. } = self;
        let kind = match column.kind {
            _ if is_text(column) => "items",
            Type::Boolean | Type::Clock => "boolean",
            _ => "number",
        };
        json!({
            "name": column.name,
            "unit": column.unit,
            "kind": kind,
            "items": items,
            "held": curve.is_held,
            "set_point": curve.set_point.map(|index| &signals[index].column.name),
            "without": self.without,
            "values": shortened(numbers(&values)),
        })
    }
}

/// Whether the values have names rather than numbers.
fn is_text(column: &Column) -> bool {
    column.kind == Type::String || !column.items.is_empty()
}

fn is_number(column: &Column) -> bool {
    !is_text(column) && !matches!(column.kind, Type::Boolean | Type::Clock | Type::Binary)
}

/// The columns of a table after its first one, the time.
///
/// # Errors
/// A row cannot be read, or has no time, or there is none.
fn columns_of(
    titles: Vec<Series>,
    rows: impl Iterator<Item = Result<TimedRow>>,
) -> Result<Vec<Column>> {
    let columns = Vec::from_iter(titles.into_iter().skip(1));
    // Whether the values are texts, Booleans and whole numbers, and some are absent, as of clocked variables.
    let mut kinds = vec![[false, true, true, false]; columns.len()];
    let mut count = 0;
    for row in rows {
        let (_, cells) = row?;
        count += 1;
        for (kinds, cell) in kinds.iter_mut().zip(&cells[1..]) {
            let [has_text, are_booleans, are_whole, optional] = kinds;
            let Some(cell) = cell else {
                *optional = true;
                continue;
            };
            *has_text |= matches!(cell, Cell::String(_));
            *are_booleans &= matches!(cell, Cell::Boolean(_));
            *are_whole &= cell.as_whole().is_some();
        }
    }
    ensure!(count > 0, "there is no row, expected at least one");
    let columns = columns.into_iter().zip(kinds).map(|(Series { name, unit, .. }, kinds)| {
        let kind = match kinds {
            [true, ..] => Type::String,
            [_, true, true, _] => Type::Float64,
            [_, true, ..] => Type::Boolean,
            [_, _, true, _] => Type::Int64,
            _ => Type::Float64,
        };
        Column { optional: kinds[3], ..Column::new(name, unit, kind) }
    });
    Ok(columns.collect())
}

/// The digits by which a signal is more than a screen shows.
const DIGITS: f64 = 7.0;
/// The digits of an `f64`.
const MOST_DIGITS: f64 = 17.0;

/// Numbers with as many digits as a screen can show; null for NaN.
fn numbers(values: &[f64]) -> Vec<Value> {
    let known = || values.iter().copied().filter(|value| !value.is_nan());
    let (least, most) =
        (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max));
    // Far from zero, the first digits are the same. Half of the range is finite.
    let same = (least.abs().max(most.abs()) / 2.0).log10() - (most / 2.0 - least / 2.0).log10();
    let digits = match same.is_finite() {
        true => (DIGITS + same.max(0.0)).round().min(MOST_DIGITS),
        false => MOST_DIGITS,
    };
    let after_point = digits as usize - 1;
    let rounded = |value: &f64| match value.fract() == 0.0 && value.abs() < 1e7 {
        // Such as Booleans and items.
        true => json!(*value as i64),
        false => json!(format!("{value:.after_point$e}").parse::<f64>().ok()),
    };
    let number = |value: &f64| if value.is_nan() { Value::Null } else { rounded(value) };
    values.iter().map(number).collect()
}

/// One value if all are the same.
fn shortened(mut values: Vec<Value>) -> Vec<Value> {
    if values.windows(2).all(|pair| pair[0] == pair[1]) {
        values.truncate(1);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(name: &str, cells: &[Cell]) -> Series {
        let cells = cells.iter().cloned().map(Some).collect();
        Series::new(name, "", cells)
    }

    fn run(name: &str, table: Vec<Series>) -> CompleteRun {
        CompleteRun::of(name.into(), table).unwrap()
    }

    #[test]
    fn times_and_numbers_far_from_zero_keep_their_digits() {
        let reals = |values: [f64; 2]| values.map(Cell::Float64);
        let table = vec![
            series("time", &reals([100_000.001, 100_000.002])),
            series("far", &reals([1e5, 1e5 + 1e-6])),
            series("near", &reals([1.0 / 3.0, 0.0])),
            series("huge", &reals([1.5e308, -1.5e308])),
            series("tiny", &reals([5e-324, 1e-310])),
            series("none", &reals([f64::NAN, f64::NEG_INFINITY])),
        ];
        let page = Drawing::of_runs(run("a", table), Vec::new()).and_then(Drawing::finish).unwrap();
        let values = |index: usize| &page[0]["columns"][index]["values"];
        assert_eq!(page[0]["time"], json!([100_000.001, 100_000.002]));
        let far = values(0)[1].as_f64().unwrap() - 1e5;
        assert!((far - 1e-6).abs() < 1e-10, "{far}");
        assert_eq!(*values(1), json!([0.333_333_3, 0]));
        assert_eq!(*values(2), json!([1.5e308, -1.5e308]));
        assert_eq!(*values(3), json!([5e-324, 1e-310]));
        assert_eq!((values(4), &page[0]["columns"][4]["without"]), (&json!([null]), &json!(2)));
    }

    #[test]
    fn a_value_that_is_absent_between_ticks_is_held() {
        let cells = [None, Some(1.5), None, Some(2.5)].map(|cell| cell.map(Cell::Float64));
        let times = series("time", &[0, 1, 2, 3].map(Cell::Int64));
        let page = run("a", vec![times, Series::new("value", "", cells.into())]);
        let page = Drawing::of_runs(page, Vec::new()).and_then(Drawing::finish).unwrap();
        let column = &page[0]["columns"][0];
        assert_eq!(column["values"], json!([null, 1.5, 1.5, 2.5]));
        assert_eq!((&column["held"], &column["without"]), (&json!(true), &json!(0)));
    }

    #[test]
    fn items_have_indices_and_only_numbers_have_a_difference() {
        let table = |shift: i64| {
            let text = |text: &str| Cell::String(text.into());
            vec![
                series("time", &[0, 1].map(Cell::Int64)),
                series("mode", &[text("on"), text("off")]),
                series("flag", &[Cell::Boolean(false), Cell::Boolean(true)]),
                series("count", &[Cell::Int64(shift), Cell::Int64(2 * shift)]),
            ]
        };
        let page = Drawing::of_runs(run("a", table(3)), vec![run("b", table(1))]);
        let page = page.and_then(Drawing::finish).unwrap();
        let mode = &page[0]["columns"][0];
        assert_eq!((&mode["items"], &mode["values"]), (&json!(["on", "off"]), &json!([0, 1])));
        let [flag, count] = [1, 2].map(|index| &page[0]["columns"][index]);
        assert_eq!((&flag["kind"], &count["held"]), (&json!("boolean"), &json!(true)));
        let differences = &page[1]["difference"]["columns"];
        let expected = json!([
            {"name": "count", "unit": "", "values": [2, 4], "largest": 4.0, "at": 1.0}
        ]);
        assert_eq!(*differences, expected);
    }
}
