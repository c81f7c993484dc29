//! Values of inputs over time, from a CSV file.

use std::collections::HashSet;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, Type, Value, Variability};

use crate::plan::{Link, Planned, Port, port};
use crate::table::{self, Column};
use crate::wiring::{Store, number};
use crate::{Place, plan};

/// A table with a row for each time. Between rows, continuous inputs of the type Float64 or Float32 are
/// interpolated linearly, and others keep their value; before the first and after the last row, all keep it.
/// At a jump, which is two rows with the same time, the later row counts.
pub(crate) struct Input {
    /// Finite and not decreasing (s).
    times: Vec<f64>,
    columns: Vec<Fed>,
}

/// An input and its values.
struct Fed {
    port: Port,
    /// The type of its values if they are interpolated.
    interpolated: Option<Type>,
    values: Vec<Value>,
}

impl Input {
    /// Reads a file: a column `time` in s, and a column for each input, with or without a unit in brackets.
    ///
    /// # Errors
    /// The file cannot be read, a column is not an input that is free, or a row is invalid.
    pub(crate) fn read(file: &Path, components: &[Planned], links: &[Link]) -> Result<Self> {
        let name = file.display();
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        Self::parse(&text, components, links).with_context(|| name.to_string())
    }

    fn parse(text: &str, components: &[Planned], links: &[Link]) -> Result<Self> {
        let text = text.replace("\r\n", "\n");
        let (header, mut rest) = table::fields(&text).context("line 1, expected names in CSV")?;
        let titles = header.iter().map(|title| {
            let title = title.as_deref().unwrap_or_default().trim();
            title.split_once(" [").map_or(title, |(name, _)| name)
        });
        let mut names = titles.clone();
        let first = names.next().unwrap_or_default();
        ensure!(first == "time", "the first column is {first:?}, expected time");

        let mut taken: HashSet<Port> = links.iter().map(|link| link.to).collect();
        let mut inputs = Self { times: Vec::new(), columns: Vec::new() };
        let mut columns = vec![Column::new("time", "s", Type::Float64)];
        for name in names {
            let port = port(components, name)?;
            let fmu = &components[port.component].fmu;
            let variable = port.of(components);
            if let Some(reason) = fmu.unusable(port.scalar) {
                bail!("{name} cannot be set: {reason}");
            }
            let is_input = variable.causality == Causality::Input;
            ensure!(is_input, "{name} is {}, expected an input", plan::text(variable.causality));
            ensure!(taken.insert(port), "{name} is connected, or has two columns");
            let is_continuous = variable.variability == Variability::Continuous;
            let kind = variable.of_type;
            columns.push(Column::new(name, "", kind));
            inputs.columns.push(Fed {
                port,
                interpolated: (is_continuous && kind.is_float()).then_some(kind),
                values: Vec::new(),
            });
        }
        let mut line = 1;
        while !rest.is_empty() {
            line += 1;
            let cells;
            (cells, rest) = table::parse(&columns, rest).with_context(|| format!("line {line}"))?;
            let mut cells = cells.into_iter().flatten();
            let time = cells.next().as_ref().map_or(f64::NAN, number);
            let last = inputs.times.last().copied().unwrap_or(f64::MIN);
            ensure!(
                time.is_finite() && time >= last,
                "line {line}: time = {time:?}, expected a finite time that is not before {last:?}"
            );
            inputs.times.push(time);
            for (column, value) in inputs.columns.iter_mut().zip(cells) {
                ensure!(
                    value.as_real().is_none_or(f64::is_finite),
                    "line {line}: {} = {value}, expected a finite number",
                    column.port.name(components)
                );
                column.values.push(value);
            }
        }
        ensure!(!inputs.times.is_empty(), "it has no rows, expected at least one");
        Ok(inputs)
    }

    /// The inputs, in the order of the columns.
    pub(crate) fn ports(&self) -> impl Iterator<Item = Port> {
        self.columns.iter().map(|column| column.port)
    }

    /// Writes the values of a time (s) to the places of the inputs.
    pub(crate) fn apply(&self, time: f64, places: &[Place], to: &mut Store) {
        let (held, next) = self.rows(time);
        for (column, place) in self.columns.iter().zip(places) {
            let value = match (column.interpolated, next) {
                (Some(kind), Some(next)) => {
                    let [t0, t1] = [next - 1, next].map(|row| self.times[row]);
                    let [v0, v1] = [next - 1, next].map(|row| number(&column.values[row]));
                    // As FMPy calculates it.
                    let w0 = (t1 - time.max(t0)) / (t1 - t0);
                    let value = w0 * v0 + (1.0 - w0) * v1;
                    Value::real(kind, value).unwrap_or_else(|| column.values[held].clone())
                }
                _ => column.values[held].clone(),
            };
            to.set(*place, value);
        }
    }

    /// The row whose values hold at a time, and the row up to which they are interpolated, unless they are
    /// constant.
    fn rows(&self, time: f64) -> (usize, Option<usize>) {
        let is_close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.abs().max(b.abs());
        let times = &self.times;
        let mut next = times.partition_point(|t| *t <= time);
        let is_now = |row: usize| times.get(row).is_some_and(|t| is_close(*t, time));
        let after = (next..).find(|row| !is_now(*row)).unwrap_or(next);
        if after > next + 1 {
            next = after;
        }
        let is_between = next > 0 && next < times.len() && times[next - 1] < times[next];
        (after.saturating_sub(1), is_between.then_some(next))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_hold_jump_and_end() {
        let input = |times: &[f64]| Input { times: times.to_vec(), columns: Vec::new() };
        let jump = input(&[0.0, 0.1 + 0.2, 0.1 + 0.2, 0.5]);
        assert_eq!(jump.rows(-1.0), (0, None));
        assert_eq!(jump.rows(0.1), (0, Some(1)));
        // 0.3 is a little before the jump.
        assert_eq!(jump.rows(0.3), (2, Some(3)));
        assert_eq!(jump.rows(0.4), (2, Some(3)));
        assert_eq!(jump.rows(0.5), (3, None));
        let smooth = input(&[0.0, 0.1 + 0.2, 0.5]);
        assert_eq!(smooth.rows(0.3), (1, Some(1)));
        assert_eq!(smooth.rows(0.1 + 0.2), (1, Some(2)));
    }
}
