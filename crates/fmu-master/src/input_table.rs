//! The input table: values of inputs and tunable parameters over time, from a file or from Python.

use std::collections::HashSet;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use fmu_description::{Causality, Type, Value, Variability, Variable};

use crate::components::{Components, ScalarId};
use crate::connections::{ResolvedConnection, with_article};
use crate::given_inputs::GivenInputs;
use crate::literal::expected_item;
use crate::store::{Place, Store, number};
use crate::table::{self, Cell, Column, Series};
use crate::{Fmu, Stimuli};

/// A table with a row for each time. Between rows, continuous inputs of the type Float64 or Float32 are
/// interpolated linearly, and others keep their value; before the first and after the last row, all keep it.
/// At a jump, which is two rows with the same time, the later row counts.
pub(crate) struct InputTable {
    /// Finite and not decreasing (s).
    pub(crate) times: Vec<f64>,
    /// The columns of inputs, and of tunable parameters.
    pub(crate) inputs: Vec<InputColumn>,
    pub(crate) parameters: Vec<InputColumn>,
    /// The columns of triggered clocks, which tick in the rows where they are true.
    clocks: Vec<InputColumn>,
}

/// An input or a tunable parameter, and its values.
pub(crate) struct InputColumn {
    pub(crate) to: ScalarId,
    /// The type of its values if they are interpolated.
    pub(crate) interpolated: Option<Type>,
    pub(crate) values: Vec<Value>,
}

/// The rows of an input table that give the values at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RowsAtTime {
    /// The row whose values hold.
    pub(crate) held: usize,
    /// The row up to which values are interpolated from the one before, unless they are constant.
    pub(crate) next: Option<usize>,
}

impl InputTable {
    /// Reads a table: a column `time` in s, and a column for each input or tunable parameter, with or without a unit in
    /// brackets.
    ///
    /// # Errors
    /// The file cannot be read, a column is neither an input that is free nor a tunable parameter, or a row is invalid.
    pub(crate) fn read(
        file: &Path,
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let table = table::read_texts(file);
        let table = table.with_context(|| format!("cannot read {}", file.display()))?;
        Self::of_texts(&table, components, connections).with_context(|| file.display().to_string())
    }

    /// Reads a table in an FMU.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub(crate) fn of_stimuli(
        stimuli: &Stimuli,
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let table = stimuli.read();
        let table = table.and_then(|table| Self::of_texts(&table, components, connections));
        table.with_context(|| format!("{} in {}", stimuli.file, stimuli.fmu.display()))
    }

    fn of_texts(
        table: &[Series],
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let times = table::times(table)?;
        let columns = table[1..].iter();
        let columns = columns.map(|series| Ok((components.settable(&series.name)?, series)));
        Self::new(times, columns, components, connections)
    }

    /// The inputs of columns whose rows come later.
    ///
    /// # Errors
    /// A column is not an input that is free, or it is a clock.
    pub(crate) fn without_rows(
        columns: &[Series],
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let columns = columns.iter().map(|series| Ok((components.settable(&series.name)?, series)));
        let table = Self::new(Vec::new(), columns, components, connections)?;
        if let Some(clock) = table.clocks.first() {
            let name = clock.to.name(components);
            bail!("{name} is a clock, which can only tick at times that are known before the run");
        }
        Ok(table)
    }

    /// Checks inputs that a program gives.
    ///
    /// # Errors
    /// As for [`Self::read`], or values do not have the shape of their input.
    pub(crate) fn of_values(
        given: &GivenInputs,
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let times = table::times(std::slice::from_ref(&given.time)).context("input")?;
        let found = given.inputs.iter().map(|input| {
            let found = components.lookup(&input.series.name, Fmu::elements);
            // Also before the error of an unknown name, as all names need a column of times.
            let is_constant = match &found {
                Ok((_, (_, dimensions))) => input.is_constant(times.len(), dimensions, given)?,
                Err(_) => false,
            };
            Ok((input, found, is_constant))
        });
        let found: Vec<_> = found.collect::<Result<_>>()?;
        let mut columns = Vec::new();
        for (input, found, is_constant) in found {
            let (component, (scalars, dimensions)) = found.context("input")?;
            let name = &input.series.name;
            for (element, scalar) in scalars.iter().enumerate() {
                let id = ScalarId { component, scalar: *scalar };
                let name = if dimensions.is_empty() { name.clone() } else { id.name(components) };
                let cells = &input.series.cells;
                let cells = match is_constant {
                    true => vec![cells[element].clone(); times.len()],
                    false => cells.iter().skip(element).step_by(scalars.len()).cloned().collect(),
                };
                columns.push((id, Series::new(name, &input.series.unit, cells)));
            }
        }
        let columns = columns.iter().map(|(id, series)| Ok((*id, series)));
        Self::new(times, columns, components, connections).context("input")
    }

    /// Checks the values of inputs and tunable parameters, which have a row for each time (s).
    fn new<'a>(
        times: Vec<f64>,
        columns: impl Iterator<Item = Result<(ScalarId, &'a Series)>>,
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let mut taken: HashSet<ScalarId> =
            connections.iter().map(|connection| connection.to).collect();
        let columns = columns.map(|column| {
            let (to, series) = column?;
            let name = &series.name;
            let variable = to.variable(components);
            if let Some(kind) = variable.clock.map(|clock| clock.interval_variability)
                && kind.is_time_based()
            {
                let kind = kind.as_str();
                bail!("{name} is a {kind} clock, which ticks at its intervals, expected a triggered one");
            }
            if let Some(reason) = to.fmu(components).unusable(to.scalar) {
                bail!("{name} cannot be set: {reason}");
            }
            check_changes(name, variable)?;
            ensure!(taken.insert(to), "{name} is connected, or has two columns");
            let (found, unit) = (&series.unit, variable.unit.as_deref().unwrap_or_default());
            let is_same = found == unit || found.is_empty() || unit.is_empty();
            ensure!(is_same, "{name} is in {found}, expected {unit}");
            let is_continuous = variable.variability == Variability::Continuous;
            let kind = variable.of_type;
            Ok(InputColumn {
                to,
                interpolated: (is_continuous && kind.is_float()).then_some(kind),
                values: values(series, variable, 1)?,
            })
        });
        let columns = columns.collect::<Result<Vec<_>>>()?;
        let is_parameter =
            |column: &InputColumn| column.to.variable(components).causality != Causality::Input;
        let (clocks, others) =
            columns.into_iter().partition(|c| c.to.variable(components).of_type == Type::Clock);
        let (parameters, inputs) = Vec::into_iter(others).partition(is_parameter);
        Ok(Self { times, inputs, parameters, clocks })
    }

    /// The inputs and parameters.
    pub(crate) fn scalars(&self) -> impl Iterator<Item = ScalarId> {
        let all = self.inputs.iter().chain(&self.parameters).chain(&self.clocks);
        all.map(|column| column.to)
    }

    /// The times at which it ticks a clock (s).
    pub(crate) fn ticks(&self, clock: ScalarId) -> Vec<f64> {
        let column = self.clocks.iter().find(|column| column.to == clock);
        let rows = column.iter().flat_map(|column| self.times.iter().zip(&column.values));
        rows.filter(|(_, value)| **value == Value::Clock(true)).map(|(time, _)| *time).collect()
    }

    /// The tunable parameters of a component, by its index, with their values at a time (s).
    pub(crate) fn parameters_at(
        &self,
        component: usize,
        time: f64,
    ) -> impl Iterator<Item = (usize, &Value)> {
        let row = self.rows(time).held;
        let own = self.parameters.iter().filter(move |column| column.to.component == component);
        own.map(move |column| (column.to.scalar, &column.values[row]))
    }

    /// Writes the values of a time (s) to the places of the inputs.
    pub(crate) fn apply(&self, time: f64, places: &[Place], to: &mut Store) {
        let rows = self.rows(time);
        for (column, place) in self.inputs.iter().zip(places) {
            to.set(*place, self.value(column, time, rows));
        }
    }

    /// Whether it has inputs of a component.
    pub(crate) fn feeds(&self, component: usize) -> bool {
        self.inputs.iter().any(|column| column.to.component == component)
    }

    /// As [`Self::apply`], for the inputs of a component.
    pub(crate) fn apply_to(&self, component: usize, time: f64, places: &[Place], to: &mut Store) {
        let rows = self.rows(time);
        for (column, place) in self.inputs.iter().zip(places) {
            if column.to.component == component {
                to.set(*place, self.value(column, time, rows));
            }
        }
    }

    /// The value of an input at a time (s) from these rows.
    pub(crate) fn value(&self, column: &InputColumn, time: f64, rows: RowsAtTime) -> Value {
        if let (Some(kind), Some(next)) = (column.interpolated, rows.next) {
            let [t0, t1] = [next - 1, next].map(|row| self.times[row]);
            let [v0, v1] = [next - 1, next].map(|row| number(&column.values[row]));
            // As FMPy calculates it.
            let w0 = (t1 - time.max(t0)) / (t1 - t0);
            if let Some(value) = Value::real(kind, w0 * v0 + (1.0 - w0) * v1) {
                return value;
            }
        }
        column.values[rows.held].clone()
    }

    /// The rows that give the values at a time (s).
    pub(crate) fn rows(&self, time: f64) -> RowsAtTime {
        let times = &self.times;
        let same = table::rounding(time, times[0]);
        let mut next = times.partition_point(|t| *t <= time);
        let is_now = |row: usize| times.get(row).is_some_and(|t| (t - time).abs() <= same);
        let after = (next..).find(|row| !is_now(*row)).unwrap_or(next);
        if after > next + 1 {
            next = after;
        }
        let is_between = next > 0 && next < times.len() && times[next - 1] < times[next];
        RowsAtTime { held: after.saturating_sub(1), next: is_between.then_some(next) }
    }
}

/// Checks that a variable may change during a run: that it is an input or a tunable parameter.
fn check_changes(name: &str, variable: &Variable) -> Result<()> {
    let is_tunable = variable.variability == Variability::Tunable;
    match variable.causality {
        Causality::Input => Ok(()),
        Causality::Parameter if is_tunable => Ok(()),
        Causality::Parameter => {
            bail!("{name} is a fixed parameter, expected an input or a tunable parameter")
        }
        causality => {
            let found = with_article(causality);
            bail!("{name} is {found}, expected an input or a tunable parameter")
        }
    }
}

/// A value in the type of an input, if it is finite and of the same kind; others are read as text, which may fail.
fn converted(value: &Value, kind: Type) -> Option<Value> {
    match value {
        Value::Boolean(_) | Value::String(_) | Value::Binary(_) => {
            (value.of_type() == kind).then(|| value.clone())
        }
        _ if kind.is_float() => {
            let real = value.as_real().or_else(|| value.as_whole().map(|whole| whole as f64))?;
            Value::real(kind, real).filter(|_| real.is_finite())
        }
        _ => Value::whole(kind, value.as_whole()?),
    }
}

/// A whole number that other programs write as `1.0`, such as pandas in a column with a missing value, as `1`.
fn without_fraction(text: String) -> String {
    match text.trim().strip_suffix(".0") {
        Some(number) if number.parse::<i64>().is_ok() => number.to_owned(),
        _ => text,
    }
}

/// The values of a column in the type of an input; the first is in this row.
pub(crate) fn values(series: &Series, input: &Variable, first: usize) -> Result<Vec<Value>> {
    let (name, kind) = (&series.name, input.of_type);
    let column = Column::new(name, "", kind);
    let typed = |cell: &Cell, row: usize| {
        match cell {
            // Most programs write an empty string as an empty field.
            None if kind == Type::String => return Ok(Value::String(String::new())),
            // As clocked results are written where nothing ticks.
            None if kind == Type::Clock => return Ok(Value::Clock(false)),
            Some(value) if kind != Type::Enumeration => {
                if let Some(value) = converted(value, kind) {
                    return Ok(value);
                }
            }
            _ => {}
        }
        let text = cell.as_ref().map(|value| match value.as_real() {
            Some(real) => format!("{real:?}"), // of a Float32, too, all digits
            None => value.to_string(),
        });
        let text = text.map(|text| if kind.is_float() { text } else { without_fraction(text) });
        if kind == Type::Enumeration {
            let text = text.as_deref().map_or("empty", str::trim);
            let value = input.value(text);
            return value.with_context(|| {
                format!("row {row}: {name} is {text}, expected {}", expected_item(input, text))
            });
        }
        let value = column.parse(text.as_deref()).with_context(|| format!("row {row}"))?;
        match value {
            Some(value) if value.as_real().is_none_or(f64::is_finite) => Ok(value),
            _ => {
                bail!("row {row}: {name} is {}, expected a finite number", text.unwrap_or_default())
            }
        }
    };
    let cells = series.cells.iter().zip(first..).map(|(cell, row)| {
        let value = typed(cell, row)?;
        let sized = input.check_size(&value);
        sized.map_err(|found| anyhow!("row {row}: {name} has {found}"))?;
        Ok(value)
    });
    cells.collect()
}

#[cfg(test)]
mod tests {
    use fmu_description::{DeclaredType, EnumerationItem};

    use super::*;

    fn rows(table: &InputTable, time: f64) -> (usize, Option<usize>) {
        let RowsAtTime { held, next } = table.rows(time);
        (held, next)
    }

    #[test]
    fn rows_hold_jump_and_end() {
        let input = |times: &[f64]| InputTable {
            times: times.to_vec(),
            inputs: Vec::new(),
            parameters: Vec::new(),
            clocks: Vec::new(),
        };
        let jump = input(&[0.0, 0.1 + 0.2, 0.1 + 0.2, 0.5]);
        assert_eq!(rows(&jump, -1.0), (0, None));
        assert_eq!(rows(&jump, 0.1), (0, Some(1)));
        // 0.3 is a little before the jump.
        assert_eq!(rows(&jump, 0.3), (2, Some(3)));
        assert_eq!(rows(&jump, 0.4), (2, Some(3)));
        assert_eq!(rows(&jump, 0.5), (3, None));
        let smooth = input(&[0.0, 0.1 + 0.2, 0.5]);
        assert_eq!(rows(&smooth, 0.3), (1, Some(1)));
        assert_eq!(rows(&smooth, 0.1 + 0.2), (1, Some(2)));
        let since_1970 = input(&[1.7e9, 1.7e9 + 1.0]);
        assert_eq!(rows(&since_1970, 1.7e9 + 0.5), (0, Some(1)));
    }

    fn column(of_type: Type, cells: &[Option<Value>]) -> Result<Vec<Value>, String> {
        let items = [("off", 0), ("linear", 7)].map(|(name, value)| EnumerationItem {
            name: name.into(),
            value,
            description: String::new(),
        });
        let declared = DeclaredType { items: items.to_vec(), ..DeclaredType::default() };
        let input =
            Variable { of_type, declared_type: Some(declared.into()), ..Variable::default() };
        let series = Series::new("a", "", cells.to_vec());
        values(&series, &input, 1).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn items_are_names_or_numbers_also_as_other_programs_write_them() {
        let text = |text: &str| Some(Value::String(text.into()));
        let cells =
            [text("linear"), text(" OFF"), text("7"), text("7.0"), Some(Value::Float64(7.0))];
        let cells = [&cells[..], &[Some(Value::UInt8(0))]].concat();
        let items = [7, 0, 7, 7, 7, 0].map(Value::Enumeration);
        assert_eq!(column(Type::Enumeration, &cells).unwrap(), items);
        let counts = column(Type::Int8, &[text("2.0"), Some(Value::Float32(3.0))]).unwrap();
        assert_eq!(counts, [2, 3].map(Value::Int8));
        let texts = column(Type::String, &[text("2.0"), None, text(" a,\n\"b\"")]).unwrap();
        assert_eq!(texts, ["2.0", "", " a,\n\"b\""].map(|text| Value::String(text.into())));
        for (of_type, cell, reason) in [
            (
                Type::Enumeration,
                text("line"),
                "line, expected one of off, linear; did you mean linear?",
            ),
            (Type::Enumeration, Some(Value::Int64(1)), "1, expected one of off, linear"),
            (Type::Enumeration, Some(Value::Float64(0.5)), "0.5, expected one of off, linear"),
            (Type::Enumeration, None, "empty, expected one of off, linear"),
            (Type::Int8, text("2.5"), "2.5, expected a whole number from -128 to 127"),
        ] {
            assert_eq!(column(of_type, &[cell]).unwrap_err(), format!("row 1: a is {reason}"));
        }
    }
}
