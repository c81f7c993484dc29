//! The inputs of a component of model exchange that have values from a table: they change within a step, and jumps are
//! events.

use std::collections::{BTreeMap, HashSet};

use fmu_description::{Type, Value};

use crate::Fmu;
use crate::access_list::AccessList;
use crate::input_table::{InputColumn, InputTable, RowsAtTime};
use crate::start::ComponentStarts;
use crate::wiring::VariableGroup;

/// An input, or elements of one that is an array, with the values of all elements.
#[derive(Clone)]
struct TableInput<'a> {
    access_type: Type,
    reference: u32,
    values: Vec<Value>,
    /// The columns of the table, and the elements that they give.
    columns: Vec<(&'a InputColumn, usize)>,
}

/// The inputs of a component of model exchange that have values from a table, during a step.
#[derive(Clone)]
pub(crate) struct TableInputs<'a> {
    table: &'a InputTable,
    all: Vec<TableInput<'a>>,
    /// The row that holds since the last event, and the one of the next event: a jump, or a new value of an
    /// input that is not interpolated.
    held: usize,
    next: usize,
}

impl<'a> TableInputs<'a> {
    /// The inputs of a component, by its index, if there are any; elements without a column have these start values.
    /// An array that is partly fed by another component is left out.
    pub(crate) fn new(
        table: &'a InputTable,
        component: usize,
        fmu: &Fmu,
        groups: &[VariableGroup],
        starts: &ComponentStarts<'_>,
    ) -> Option<Self> {
        let fed = groups.iter().flat_map(|g| g.inputs.scalars.iter().zip(&g.sources));
        let fed = fed.filter(|(_, source)| source.component.is_some());
        let fed: HashSet<_> = fed.map(|(scalar, _)| fmu.array(*scalar)).collect();
        let mut columns: BTreeMap<usize, Vec<_>> = BTreeMap::new();
        for column in table.inputs.iter().filter(|column| column.to.component == component) {
            let array = fmu.array(column.to.scalar);
            if !fed.contains(&array) {
                let element = fmu.scalars[column.to.scalar].element;
                columns.entry(array.start).or_default().push((column, element));
            }
        }
        let all = columns.into_iter().map(|(first, columns)| {
            let variable = AccessList::new(fmu, [first]);
            TableInput {
                access_type: fmu.access_type(first),
                reference: fmu.variable(first).reference,
                values: starts.initial(&variable, fmu),
                columns,
            }
        });
        let all = Vec::from_iter(all);
        (!all.is_empty()).then_some(Self { table, all, held: 0, next: 0 })
    }

    fn columns(&self) -> impl Iterator<Item = &'a InputColumn> {
        self.all.iter().flat_map(|input| input.columns.iter().map(|(column, _)| *column))
    }

    /// Goes to the place where the same inputs were at another time.
    pub(crate) fn go_to(&mut self, other: &Self) {
        (self.held, self.next) = (other.held, other.next);
    }

    /// Goes on from a communication point or an event (s).
    pub(crate) fn begin(&mut self, time: f64) {
        let times = &self.table.times;
        self.held = self.table.rows(time).held;
        let is_event = |row: &usize| {
            let mut held = self.columns().filter(|column| column.interpolated.is_none());
            times.get(row + 1) == Some(&times[*row])
                || (*row > 0 && held.any(|column| column.values[*row] != column.values[row - 1]))
        };
        let first = if time < times[0] { 0 } else { self.held + 1 };
        self.next = (first..times.len()).find(is_event).unwrap_or(times.len());
    }

    /// The time of the next event (s).
    pub(crate) fn next(&self) -> Option<f64> {
        self.table.times.get(self.next).copied()
    }

    /// The types, value references and values at a time (s) before the next event, of the inputs that are
    /// interpolated, or just after it, of all.
    pub(crate) fn values(
        &self,
        time: f64,
        after: bool,
    ) -> impl Iterator<Item = (Type, u32, Vec<Value>)> {
        let times = &self.table.times;
        let next = times.partition_point(|t| *t <= time).max(self.held + 1).min(self.next);
        let rows = match after {
            true => self.table.rows(time),
            false => RowsAtTime {
                held: next.saturating_sub(1),
                next: (1..times.len()).contains(&next).then_some(next),
            },
        };
        let is_set = move |input: &&TableInput<'_>| {
            after || input.columns.iter().any(|(column, _)| column.interpolated.is_some())
        };
        self.all.iter().filter(is_set).map(move |input| {
            let mut values = input.values.clone();
            for (column, element) in &input.columns {
                values[*element] = self.table.value(column, time, rows);
            }
            (input.access_type, input.reference, values)
        })
    }
}
