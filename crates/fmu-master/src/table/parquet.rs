//! Writes rows as Parquet columns.

mod arrow;
mod read;
mod zstd;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use fmu_description::{Type as Kind, Value};
use fmu_file::replace::Replacement;
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

pub(super) use self::read::read;
use super::column::{Cell, Column, Items};
use super::csv::{fields, push_line};

/// Number of rows that are buffered and written column by column.
const ROWS_PER_GROUP: usize = 1 << 16;

/// Writes rows as Parquet, in order and atomically; an existing file is replaced.
///
/// # Errors
/// The file cannot be written, or a row is an error.
pub fn write_parquet(
    file: &Path,
    columns: &[Column],
    rows: impl Iterator<Item = Result<Vec<Cell>>>,
) -> Result<()> {
    let mut writer = ParquetWriter::new(file, columns);
    for row in rows {
        writer.push(row?)?;
    }
    writer.finish()
}

/// Writes rows as Parquet, in order and atomically; an existing file is replaced. Nothing is written before there are
/// many rows, or all.
pub struct ParquetWriter {
    file: PathBuf,
    columns: Vec<Column>,
    rows: Vec<Vec<Cell>>,
    output: Option<SerializedFileWriter<Replacement>>,
}

impl ParquetWriter {
    /// A table of these columns.
    pub fn new(file: &Path, columns: &[Column]) -> Self {
        let (file, columns) = (file.to_owned(), columns.to_vec());
        Self { file, columns, rows: Vec::new(), output: None }
    }

    /// Adds a row.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn push(&mut self, row: Vec<Cell>) -> Result<()> {
        self.rows.push(row);
        if self.rows.len() == ROWS_PER_GROUP { self.write_group() } else { Ok(()) }
    }

    /// Writes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(&mut self) -> Result<()> {
        self.write_group()?;
        let output = self.output.take().context("the table is already finished")?;
        let output = output.into_inner().with_context(|| self.cannot())?;
        output.finish()
    }

    /// Writes the rows that were added column by column, if there are any, and begins the file.
    fn write_group(&mut self) -> Result<()> {
        let output = match &mut self.output {
            Some(output) => output,
            none => none.insert(begin(&self.file, &self.columns)?),
        };
        let rows = std::mem::take(&mut self.rows);
        if !rows.is_empty() {
            let written = write_group(output, &self.columns, &rows);
            written.with_context(|| self.cannot())?;
        }
        Ok(())
    }

    fn cannot(&self) -> String {
        format!("cannot write {}", self.file.display())
    }
}

/// The key of the items of Enumerations in the metadata of a file: CSV with the column, the number and the name of each.
const ITEMS: &str = "items";

fn items(columns: &[Column]) -> String {
    let mut lines = String::new();
    for column in columns {
        for (number, name) in &column.items {
            let texts = [column.name.clone(), number.to_string(), name.clone()];
            push_line(&mut lines, texts.into_iter().map(|text| Some(Value::String(text))));
        }
    }
    lines
}

/// The items of a column.
fn items_of(column: &str, mut lines: &str) -> Items {
    let mut items = Items::new();
    while let Some((row, rest)) = fields(lines).filter(|_| !lines.is_empty()) {
        if let [Some(of), Some(number), Some(name)] = row.as_slice()
            && *of == column
            && let Ok(number) = number.parse()
        {
            items.insert(number, name.clone().into_owned());
        }
        lines = rest;
    }
    items
}

fn begin(file: &Path, columns: &[Column]) -> Result<SerializedFileWriter<Replacement>> {
    let output = Replacement::new(file)?;
    let items = (!items(columns).is_empty()).then(|| KeyValue::new(ITEMS.into(), items(columns)));
    let units = KeyValue::new(arrow::KEY.into(), arrow::schema(columns));
    let known = Vec::from_iter(items.into_iter().chain([units]));
    let properties = WriterProperties::builder().set_key_value_metadata(Some(known)).build();
    let writer = SerializedFileWriter::new(output, schema(columns)?, Arc::new(properties));
    writer.with_context(|| format!("cannot write {}", file.display()))
}

fn write_group(
    output: &mut SerializedFileWriter<Replacement>,
    columns: &[Column],
    rows: &[Vec<Cell>],
) -> Result<(), ParquetError> {
    let mut group = output.next_row_group()?;
    for (index, column) in columns.iter().enumerate() {
        let cells = Vec::from_iter(rows.iter().map(|row| &row[index]));
        write_column(&mut group, column, &cells)?;
    }
    group.close().map(drop)
}

fn types(kind: Kind) -> (Physical, Option<LogicalType>) {
    let whole = |bits, is_signed| Some(LogicalType::integer(bits, is_signed));
    match kind {
        Kind::Int8 => (Physical::INT32, whole(8, true)),
        Kind::UInt8 => (Physical::INT32, whole(8, false)),
        Kind::Int16 => (Physical::INT32, whole(16, true)),
        Kind::UInt16 => (Physical::INT32, whole(16, false)),
        Kind::Int32 => (Physical::INT32, None),
        Kind::UInt32 => (Physical::INT32, whole(32, false)),
        Kind::UInt64 => (Physical::INT64, whole(64, false)),
        Kind::Int64 | Kind::Enumeration => (Physical::INT64, None),
        Kind::Boolean | Kind::Clock => (Physical::BOOLEAN, None),
        Kind::String => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        Kind::Binary => (Physical::BYTE_ARRAY, None),
        Kind::Float32 => (Physical::FLOAT, None),
        Kind::Float64 => (Physical::DOUBLE, None),
    }
}

fn schema(columns: &[Column]) -> Result<TypePtr, ParquetError> {
    let field = |column: &Column| {
        let (physical, logical) = types(column.kind);
        let repetition = if column.optional { Repetition::OPTIONAL } else { Repetition::REQUIRED };
        let built = Type::primitive_type_builder(&column.title(), physical)
            .with_repetition(repetition)
            .with_logical_type(logical)
            .build();
        built.map(Arc::new)
    };
    let fields: Result<_, _> = columns.iter().map(field).collect();
    let schema = Type::group_type_builder("table").with_fields(fields?);
    schema.build().map(Arc::new)
}

type Group<'a> = SerializedRowGroupWriter<'a, Replacement>;

/// Writes the next column.
fn write_column(
    group: &mut Group<'_>,
    column: &Column,
    cells: &[&Cell],
) -> Result<(), ParquetError> {
    // Numbers without a sign are stored as their bits.
    let whole = |value: &Value| value.as_whole().unwrap_or_default();
    let real = |value: &Value| value.as_real().unwrap_or_default();
    match types(column.kind).0 {
        Physical::INT32 => typed::<Int32Type>(group, column, cells, |v| whole(v) as i32),
        Physical::INT64 => typed::<Int64Type>(group, column, cells, |v| whole(v) as i64),
        Physical::FLOAT => typed::<FloatType>(group, column, cells, |v| real(v) as f32),
        Physical::DOUBLE => typed::<DoubleType>(group, column, cells, real),
        Physical::BOOLEAN => {
            let is_true = |v: &Value| matches!(v, Value::Boolean(true) | Value::Clock(true));
            typed::<BoolType>(group, column, cells, is_true)
        }
        _ => typed::<ByteArrayType>(group, column, cells, |value| match value {
            Value::String(text) => text.as_bytes().to_vec().into(),
            Value::Binary(bytes) => bytes.clone().into(),
            _ => ByteArray::new(),
        }),
    }
}

/// Writes the values of a column, and of an optional column which rows have one.
fn typed<T: DataType>(
    group: &mut Group<'_>,
    column: &Column,
    cells: &[&Cell],
    value: impl Fn(&Value) -> T::T,
) -> Result<(), ParquetError> {
    let missing = || ParquetError::General("there are more columns than in the schema".into());
    let mut writer = group.next_column()?.ok_or_else(missing)?;
    let values = Vec::from_iter(cells.iter().copied().flatten().map(value));
    let present = Vec::from_iter(cells.iter().map(|cell| cell.is_some().into()));
    let present = column.optional.then_some(present.as_slice());
    writer.typed::<T>().write_batch(&values, present, None)?;
    writer.close()
}

#[cfg(test)]
mod tests {
    use super::super::column::Series;
    use super::*;

    #[test]
    fn parquet_reads_back_with_types_and_missing_values() {
        let values = [
            Value::Float64(0.1 + 0.2),
            Value::Float32(0.1),
            Value::Int8(-1),
            Value::UInt8(u8::MAX),
            Value::Int16(-2),
            Value::UInt16(u16::MAX),
            Value::Int32(i32::MIN),
            Value::UInt32(u32::MAX),
            Value::Int64(i64::MIN),
            Value::UInt64(u64::MAX),
            Value::Boolean(true),
            Value::String("π".into()),
            Value::Binary(vec![0, 255]),
        ];
        let names = Vec::from_iter(values.iter().map(|value| format!("a.{:?}", value.of_type())));
        let columns = names.iter().zip(&values);
        let columns = columns.map(|(name, v)| Column::new(name, "m/s", v.of_type()).optional());
        let columns = Vec::from_iter(columns);
        let rows = [values.clone().map(Some).to_vec(), vec![None; values.len()]];
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.parquet");
        write_parquet(&file, &columns, rows.into_iter().map(Ok)).unwrap();
        let expected = names.into_iter().zip(values).map(|(name, value)| {
            let (unit, cells) = ("m/s", vec![Some(value), None]);
            Series::new(name, unit, cells)
        });
        assert_eq!(read(&file).unwrap(), Vec::from_iter(expected));
        let items = Items::from([(-5, "a, \"b\"".into()), (2, "".into())]);
        let columns = [Column { items, ..Column::new("a.e", "", Kind::Enumeration) }];
        let rows = [-5, 2, 3].map(|number| Ok(vec![Some(Value::Enumeration(number))]));
        write_parquet(&file, &columns, rows.into_iter()).unwrap();
        let text = |text: &str| Some(Value::String(text.into()));
        let cells = [text("a, \"b\""), text(""), Some(Value::Int64(3))];
        assert_eq!(read(&file).unwrap()[0].cells, cells);
        std::fs::write(&file, "PAR1").unwrap();
        read(&file).unwrap_err();
    }
}
