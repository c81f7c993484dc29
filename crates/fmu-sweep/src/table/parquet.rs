//! Writes rows as Parquet columns.

use std::path::Path;
use std::sync::Arc;

use fmu_file::replace::Replacement;
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use crate::row::INDEX;
use crate::{Columns, Error, Kind, Row, Value};

/// Number of rows that are buffered and written column by column.
const ROWS_PER_GROUP: usize = 1 << 16;

pub fn write(
    output: &mut Replacement,
    file: &Path,
    columns: &Columns,
    mut rows: impl Iterator<Item = Result<Row, Error>>,
) -> Result<(), Error> {
    let failed = |error: ParquetError| Error::file("write", file)(error);
    let schema = schema(columns).map_err(failed)?;
    let properties = Arc::new(WriterProperties::builder().build());
    let mut writer = SerializedFileWriter::new(output, schema, properties).map_err(failed)?;
    loop {
        let group: Vec<Row> = rows
            .by_ref()
            .take(ROWS_PER_GROUP)
            .collect::<Result<_, _>>()?;
        if group.is_empty() {
            break;
        }
        for row in &group {
            columns.check(row)?;
        }
        writer
            .next_row_group()
            .and_then(|writer| write_group(writer, columns, &group))
            .map_err(failed)?;
    }
    writer.close().map(drop).map_err(failed)
}

fn schema(columns: &Columns) -> Result<TypePtr, ParquetError> {
    let index = Type::primitive_type_builder(INDEX, Physical::INT64)
        .with_repetition(Repetition::REQUIRED)
        .build();
    let others = columns.iter().map(|column| {
        let (physical, logical) = match column.kind {
            Kind::Number => (Physical::DOUBLE, None),
            Kind::Boolean => (Physical::BOOLEAN, None),
            Kind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let repetition = match column.optional {
            true => Repetition::OPTIONAL,
            false => Repetition::REQUIRED,
        };
        Type::primitive_type_builder(&column.name, physical)
            .with_repetition(repetition)
            .with_logical_type(logical)
            .build()
    });
    let fields = std::iter::once(index).chain(others);
    Type::group_type_builder("sweep")
        .with_fields(
            fields
                .map(|field| field.map(Arc::new))
                .collect::<Result<_, _>>()?,
        )
        .build()
        .map(Arc::new)
}

/// Writes a row group.
fn write_group(
    mut group: SerializedRowGroupWriter<'_, &mut Replacement>,
    columns: &Columns,
    rows: &[Row],
) -> Result<(), ParquetError> {
    let indices: Vec<_> = rows.iter().map(|row| row.index as i64).collect();
    write_column::<Int64Type>(&mut group, &indices, None)?;
    for (number, column) in columns.iter().enumerate() {
        let cells = || rows.iter().map(|row| &row.cells[number]);
        let present: Option<Vec<i16>> = column
            .optional
            .then(|| cells().map(|cell| i16::from(cell.is_some())).collect());
        let present = present.as_deref();
        let values = cells().flatten();
        match column.kind {
            Kind::Number => {
                let numbers = values.filter_map(|value| match value {
                    Value::Number(number) => Some(*number),
                    _ => None,
                });
                write_column::<DoubleType>(&mut group, &Vec::from_iter(numbers), present)?;
            }
            Kind::Boolean => {
                let booleans = values.filter_map(|value| match value {
                    Value::Boolean(boolean) => Some(*boolean),
                    _ => None,
                });
                write_column::<BoolType>(&mut group, &Vec::from_iter(booleans), present)?;
            }
            Kind::Text => {
                let texts = values.filter_map(|value| match value {
                    Value::Text(text) => Some(ByteArray::from(text.as_str())),
                    _ => None,
                });
                write_column::<ByteArrayType>(&mut group, &Vec::from_iter(texts), present)?;
            }
        }
    }
    group.close().map(drop)
}

/// Writes the next column: its values, and for an optional column which rows have one.
fn write_column<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, &mut Replacement>,
    values: &[T::T],
    present: Option<&[i16]>,
) -> Result<(), ParquetError> {
    let mut column = group.next_column()?.expect("a column of the schema");
    column.typed::<T>().write_batch(values, present, None)?;
    column.close()
}
