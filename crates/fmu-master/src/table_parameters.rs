//! The tunable parameters of a component that have values from a table. The first values are start values; later ones are
//! set when they change, at the communication points of the component.

use fmu_description::{Type, Value};

use crate::Fmu;
use crate::access_list::AccessList;
use crate::input_table::{InputColumn, InputTable};
use crate::start::ComponentStarts;

/// A tunable parameter, or elements of one that is an array, with the values of all elements.
pub(crate) struct TableParameter<'a> {
    pub(crate) access_type: Type,
    pub(crate) scalars: AccessList,
    /// The columns of the scalars.
    columns: Vec<&'a InputColumn>,
    values: Vec<Value>,
}

/// The tunable parameters of a component that have values from a table, during a run.
pub(crate) struct TableParameters<'a> {
    table: &'a InputTable,
    all: Vec<TableParameter<'a>>,
    /// The row whose values the FMU has.
    pub(crate) row: usize,
}

impl<'a> TableParameters<'a> {
    /// The parameters of a component, by its index, if there are any; elements without a column have these start values.
    /// At the time (s), the run starts.
    pub(crate) fn new(
        table: &'a InputTable,
        component: usize,
        fmu: &Fmu,
        starts: &ComponentStarts<'_>,
        time: f64,
    ) -> Option<Self> {
        let columns = table.parameters.iter().filter(|column| column.to.component == component);
        let mut columns = Vec::from_iter(columns);
        columns.sort_by_key(|column| column.to.scalar);
        let arrays = columns.chunk_by(|a, b| fmu.array(a.to.scalar) == fmu.array(b.to.scalar));
        let all = arrays.map(|columns| {
            let scalars = AccessList::new(fmu, columns.iter().map(|column| column.to.scalar));
            TableParameter {
                access_type: fmu.access_type(columns[0].to.scalar),
                values: starts.initial(&scalars, fmu),
                scalars,
                columns: columns.to_vec(),
            }
        });
        let all = Vec::from_iter(all);
        (!all.is_empty()).then(|| Self { row: table.rows(time).held, table, all })
    }

    /// The parameters that change at a time (s), and their new values, which the FMU is expected to get.
    pub(crate) fn change(&mut self, time: f64) -> Vec<(&TableParameter<'a>, Vec<Value>)> {
        let row = self.table.rows(time).held;
        let last = std::mem::replace(&mut self.row, row);
        let changes = |column: &&InputColumn| column.values[row] != column.values[last];
        let changed = self.all.iter().filter(|parameter| parameter.columns.iter().any(changes));
        let changed = changed.map(|parameter| {
            let mut values = parameter.values.clone();
            for (column, position) in parameter.columns.iter().zip(&parameter.scalars.positions) {
                values[*position] = column.values[row].clone();
            }
            (parameter, values)
        });
        changed.collect()
    }
}
