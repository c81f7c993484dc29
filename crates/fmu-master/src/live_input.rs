//! Inputs whose rows arrive through a pipe or socket while a run in real time goes. A row takes effect at the first
//! communication point that is not before its time, or at once if its time has passed; it holds until the next one does.

use std::fs;
use std::path::Path;
use std::sync::mpsc::{self, Receiver, Sender, TryRecvError};
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::{Context, Error, Result, bail};
use fmu_description::{Value, Variable};

use crate::components::Components;
use crate::connections::ResolvedConnection;
use crate::input_table::{self, InputTable};
use crate::store::{Place, Store};
use crate::table::{self, Series, TimedRow, is_standard_input, standard_input};

/// The rows of inputs that arrive while the run goes, after a line of names.
pub(crate) struct LiveInput(Mutex<Arrivals>);

struct Arrivals {
    rows: Receiver<Result<Row>>,
    /// The row that has arrived and is not due.
    next: Option<Row>,
}

/// A time (s) and the values from then on.
type Row = (f64, Vec<Value>);

/// Whether what a file has arrives little by little, as in a pipe, a socket or a device.
pub(crate) fn is_stream(file: &Path) -> bool {
    let metadata = match is_standard_input(file) {
        true => standard_input().and_then(|file| file.metadata()),
        false => fs::metadata(file),
    };
    // The error of a missing file comes when it is opened.
    match metadata {
        Ok(metadata) => !metadata.is_file(),
        Err(_) => is_standard_input(file),
    }
}

impl LiveInput {
    /// Waits for the line of names. Returns also the inputs, as a table without rows.
    ///
    /// # Errors
    /// The file cannot be read, or a column is not an input that is free.
    pub(crate) fn open(
        file: &Path,
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<(InputTable, Self)> {
        let name = match is_standard_input(file) {
            true => "standard input".to_owned(),
            false => file.display().to_string(),
        };
        let opened = table::open_texts(file);
        let rows = opened.with_context(|| format!("cannot read {name}"))?;
        let table = rows.columns.get(1..).unwrap_or_default();
        let table = InputTable::without_rows(table, components, connections);
        let table = table.with_context(|| name.clone())?;
        if let Some(parameter) = table.parameters.first() {
            let parameter = parameter.to.name(components);
            bail!(
                "{name}: {parameter} is a parameter, expected inputs in a table that arrives while the run goes"
            );
        }
        let columns = table.inputs.iter().zip(&rows.columns[1..]);
        let columns =
            columns.map(|(c, series)| (series.clone(), c.to.variable(components).clone()));
        let columns = Vec::from_iter(columns);
        let mut rows = rows.timed().with_context(|| name.clone())?;
        let (sender, receiver) = mpsc::channel();
        let row = move |number, row| convert(number, row, &columns).with_context(|| name.clone());
        // Rows that came together with the names count from the beginning.
        let mut number = 1;
        while rows.has_line()
            && let Some(next) = rows.next()
        {
            // The receiver is there.
            let _ = sender.send(row(number, next));
            number += 1;
        }
        thread::spawn(move || {
            pass(rows.zip(number..).map(|(next, number)| row(number, next)), &sender)
        });
        Ok((table, Self(Mutex::new(Arrivals { rows: receiver, next: None }))))
    }

    /// Writes the values of the newest row that is due at a time (s) to the places of the inputs, if one has arrived.
    ///
    /// # Errors
    /// A row that has arrived is invalid.
    pub(crate) fn apply(&self, time: f64, places: &[Place], to: &mut Store) -> Result<()> {
        let mut arrivals = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let latest = time + table::rounding(time, 0.0);
        loop {
            if arrivals.next.is_none() {
                arrivals.next = match arrivals.rows.try_recv() {
                    Ok(row) => Some(row?),
                    Err(TryRecvError::Empty | TryRecvError::Disconnected) => return Ok(()),
                };
            }
            let Some((_, values)) = arrivals.next.take_if(|(time, _)| *time <= latest) else {
                return Ok(());
            };
            places.iter().zip(values).for_each(|(place, value)| to.set(*place, value));
        }
    }
}

/// Passes rows on until the last one, an invalid one, or the end of the run.
fn pass(rows: impl Iterator<Item = Result<Row>>, to: &Sender<Result<Row>>) {
    for row in rows {
        let is_last = row.is_err();
        if to.send(row).is_err() || is_last {
            return;
        }
    }
}

/// The values of a row, by its number, in the types of the inputs.
fn convert(number: usize, row: Result<TimedRow>, columns: &[(Series, Variable)]) -> Result<Row> {
    let (time, cells) = row?;
    let values = columns.iter().zip(cells.into_iter().skip(1)).map(|((series, variable), cell)| {
        let series = Series { cells: vec![cell], ..series.clone() };
        let mut values = input_table::values(&series, variable, number)?;
        values.pop().ok_or_else(|| Error::msg("there is no value"))
    });
    Ok((time, values.collect::<Result<_>>()?))
}
