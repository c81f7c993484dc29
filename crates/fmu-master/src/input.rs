//! Values of inputs over time, from a table.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, Type, Value, Variability};

use crate::access_list::AccessList;
use crate::components::{Components, ScalarId};
use crate::connections::{ResolvedConnection, with_article};
use crate::start::StartValues;
use crate::store::{Store, number};
use crate::table::{self, Column, Series};
use crate::wiring::VariableGroup;
use crate::{Fmu, Place};

/// A table with a row for each time. Between rows, continuous inputs of the type Float64 or Float32 are
/// interpolated linearly, and others keep their value; before the first and after the last row, all keep it.
/// At a jump, which is two rows with the same time, the later row counts.
pub(crate) struct InputTable {
    /// Finite and not decreasing (s).
    times: Vec<f64>,
    columns: Vec<InputColumn>,
}

/// An input and its values.
struct InputColumn {
    port: ScalarId,
    /// The type of its values if they are interpolated.
    interpolated: Option<Type>,
    values: Vec<Value>,
}

impl InputTable {
    /// Reads a table: a column `time` in s, and a column for each input, with or without a unit in brackets.
    ///
    /// # Errors
    /// The file cannot be read, a column is not an input that is free, or a row is invalid.
    pub(crate) fn read(
        file: &Path,
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let table = table::read_texts(file);
        let table = table.with_context(|| format!("cannot read {}", file.display()))?;
        Self::new(&table, components, connections).with_context(|| file.display().to_string())
    }

    fn new(
        table: &[Series],
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let times = table::times(table)?;
        let mut taken: HashSet<ScalarId> =
            connections.iter().map(|connection| connection.to).collect();
        let columns = table[1..].iter().map(|series| {
            let name = &series.name;
            let port = components.scalar(name)?;
            let fmu = port.fmu(components);
            let variable = port.variable(components);
            if let Some(reason) = fmu.unusable(port.scalar) {
                bail!("{name} cannot be set: {reason}");
            }
            let is_input = variable.causality == Causality::Input;
            ensure!(is_input, "{name} is {}, expected an input", with_article(variable.causality));
            ensure!(taken.insert(port), "{name} is connected, or has two columns");
            let (found, unit) = (&series.unit, variable.unit.as_deref().unwrap_or_default());
            let is_same = found == unit || found.is_empty() || unit.is_empty();
            ensure!(is_same, "{name} is in {found}, expected {unit}");
            let is_continuous = variable.variability == Variability::Continuous;
            let kind = variable.of_type;
            Ok(InputColumn {
                port,
                interpolated: (is_continuous && kind.is_float()).then_some(kind),
                values: values(series, kind)?,
            })
        });
        Ok(Self { columns: columns.collect::<Result<_>>()?, times })
    }

    /// The inputs, in the order of the columns.
    pub(crate) fn scalars(&self) -> impl Iterator<Item = ScalarId> {
        self.columns.iter().map(|column| column.port)
    }

    /// Writes the values of a time (s) to the places of the inputs.
    pub(crate) fn apply(&self, time: f64, places: &[Place], to: &mut Store) {
        let rows = self.rows(time);
        for (column, place) in self.columns.iter().zip(places) {
            to.set(*place, self.value(column, time, rows));
        }
    }

    /// The value of an input at a time (s) by [`Input::rows`].
    fn value(
        &self,
        column: &InputColumn,
        time: f64,
        (held, next): (usize, Option<usize>),
    ) -> Value {
        if let (Some(kind), Some(next)) = (column.interpolated, next) {
            let [t0, t1] = [next - 1, next].map(|row| self.times[row]);
            let [v0, v1] = [next - 1, next].map(|row| number(&column.values[row]));
            // As FMPy calculates it.
            let w0 = (t1 - time.max(t0)) / (t1 - t0);
            if let Some(value) = Value::real(kind, w0 * v0 + (1.0 - w0) * v1) {
                return value;
            }
        }
        column.values[held].clone()
    }

    /// The row whose values hold at a time, and the row up to which they are interpolated, unless they are
    /// constant.
    fn rows(&self, time: f64) -> (usize, Option<usize>) {
        let times = &self.times;
        let same = table::rounding(time, times[0]);
        let mut next = times.partition_point(|t| *t <= time);
        let is_now = |row: usize| times.get(row).is_some_and(|t| (t - time).abs() <= same);
        let after = (next..).find(|row| !is_now(*row)).unwrap_or(next);
        if after > next + 1 {
            next = after;
        }
        let is_between = next > 0 && next < times.len() && times[next - 1] < times[next];
        (after.saturating_sub(1), is_between.then_some(next))
    }
}

/// The values of a column in the type of an input.
fn values(series: &Series, kind: Type) -> Result<Vec<Value>> {
    let column = Column::new(&series.name, "", kind);
    let cells = series.cells.iter().zip(1..).map(|(cell, row)| {
        let text = cell.as_ref().map(|value| match value.as_real() {
            Some(real) => format!("{real:?}"), // of a Float32, too, all digits
            None => value.to_string(),
        });
        let value = column.parse(text.as_deref()).with_context(|| format!("row {row}"))?;
        match value {
            Some(value) if value.as_real().is_none_or(f64::is_finite) => Ok(value),
            _ => bail!(
                "row {row}: {} is {}, expected a finite number",
                series.name,
                text.unwrap_or_default()
            ),
        }
    });
    cells.collect()
}

/// An input, or elements of one that is an array, with the values of all elements.
#[derive(Clone)]
struct TableInput<'a> {
    kind: Type,
    reference: u32,
    values: Vec<Value>,
    /// The columns of the table, and the elements that they give.
    columns: Vec<(&'a InputColumn, usize)>,
}

/// The inputs of a component of model exchange that have values from a table, during a step.
#[derive(Clone)]
pub(crate) struct TableInputs<'a> {
    input: &'a InputTable,
    all: Vec<TableInput<'a>>,
    /// The row that holds since the last event, and the one of the next event: a jump, or a new value of an
    /// input that is not interpolated.
    held: usize,
    next: usize,
}

impl<'a> TableInputs<'a> {
    /// Those of a component, by its index, if there are any; elements without a column have these start values.
    /// An array that is partly fed by another component is left out.
    pub(crate) fn new(
        input: &'a InputTable,
        component: usize,
        fmu: &Fmu,
        ports: &[VariableGroup],
        starts: &StartValues<'_>,
    ) -> Option<Self> {
        let fed = ports.iter().flat_map(|ports| ports.inputs.scalars.iter().zip(&ports.sources));
        let fed = fed.filter(|(_, source)| source.component.is_some());
        let fed: HashSet<_> = fed.map(|(scalar, _)| fmu.array(*scalar)).collect();
        let mut columns: BTreeMap<usize, Vec<_>> = BTreeMap::new();
        for column in input.columns.iter().filter(|column| column.port.component == component) {
            let array = fmu.array(column.port.scalar);
            if !fed.contains(&array) {
                let element = fmu.scalars[column.port.scalar].element;
                columns.entry(array.start).or_default().push((column, element));
            }
        }
        let all = columns.into_iter().map(|(first, columns)| {
            let mut variable = AccessList::default();
            variable.push(fmu, first);
            TableInput {
                kind: fmu.access_type(first),
                reference: fmu.variable(first).reference,
                values: starts.initial(&variable, fmu),
                columns,
            }
        });
        let all = Vec::from_iter(all);
        (!all.is_empty()).then_some(Self { input, all, held: 0, next: 0 })
    }

    fn columns(&self) -> impl Iterator<Item = &'a InputColumn> {
        self.all.iter().flat_map(|signal| signal.columns.iter().map(|(fed, _)| *fed))
    }

    /// Goes on from a communication point or an event (s).
    pub(crate) fn begin(&mut self, time: f64) {
        let times = &self.input.times;
        self.held = self.input.rows(time).0;
        let is_event = |row: &usize| {
            let mut held = self.columns().filter(|fed| fed.interpolated.is_none());
            times.get(row + 1) == Some(&times[*row])
                || (*row > 0 && held.any(|fed| fed.values[*row] != fed.values[row - 1]))
        };
        let first = if time < times[0] { 0 } else { self.held + 1 };
        self.next = (first..times.len()).find(is_event).unwrap_or(times.len());
    }

    /// The time of the next event (s).
    pub(crate) fn next(&self) -> Option<f64> {
        self.input.times.get(self.next).copied()
    }

    /// The types, value references and values at a time (s) before the next event, of the inputs that are
    /// interpolated, or just after it, of all.
    pub(crate) fn values(
        &self,
        time: f64,
        after: bool,
    ) -> impl Iterator<Item = (Type, u32, Vec<Value>)> {
        let times = &self.input.times;
        let next = times.partition_point(|t| *t <= time).max(self.held + 1).min(self.next);
        let rows = match after {
            true => self.input.rows(time),
            false => (next.saturating_sub(1), (1..times.len()).contains(&next).then_some(next)),
        };
        let is_set = move |signal: &&TableInput<'_>| {
            after || signal.columns.iter().any(|(fed, _)| fed.interpolated.is_some())
        };
        self.all.iter().filter(is_set).map(move |signal| {
            let mut values = signal.values.clone();
            for (fed, element) in &signal.columns {
                values[*element] = self.input.value(fed, time, rows);
            }
            (signal.kind, signal.reference, values)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_hold_jump_and_end() {
        let input = |times: &[f64]| InputTable { times: times.to_vec(), columns: Vec::new() };
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
        let since_1970 = input(&[1.7e9, 1.7e9 + 1.0]);
        assert_eq!(since_1970.rows(1.7e9 + 0.5), (0, Some(1)));
    }
}
