//! Writes rows as Parquet columns, and reads them.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
use fmu_description::{Type as Kind, Value};
use fmu_file::replace::Replacement;
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::metadata::{ColumnChunkMetaData, RowGroupMetaData};
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::record::Field;
use parquet::schema::types::{Type, TypePtr};

use super::{Cell, Column, Series};

/// Number of rows that are buffered and written column by column.
const ROWS_PER_GROUP: usize = 1 << 16;

pub(super) fn write(
    output: &mut Replacement,
    columns: &[Column],
    mut rows: impl Iterator<Item = Result<Vec<Cell>>>,
) -> Result<()> {
    let properties = Arc::new(WriterProperties::builder().build());
    let mut writer = SerializedFileWriter::new(output, schema(columns)?, properties)?;
    loop {
        let group = rows.by_ref().take(ROWS_PER_GROUP);
        let group = group.collect::<Result<Vec<Vec<Cell>>>>()?;
        if group.is_empty() {
            writer.close()?;
            return Ok(());
        }
        let mut to = writer.next_row_group()?;
        for (index, column) in columns.iter().enumerate() {
            let cells = Vec::from_iter(group.iter().map(|row| &row[index]));
            write_column(&mut to, column, &cells)?;
        }
        to.close()?;
    }
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

type Group<'a, 'b> = SerializedRowGroupWriter<'a, &'b mut Replacement>;

/// Writes the next column.
fn write_column(
    group: &mut Group<'_, '_>,
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
            typed::<BoolType>(group, column, cells, |v| *v == Value::Boolean(true))
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
    group: &mut Group<'_, '_>,
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

/// Reads a file with columns of plain values.
pub(super) fn read(file: &Path) -> Result<Vec<Series>> {
    let reader = SerializedFileReader::new(File::open(file)?)?;
    let columns = reader.metadata().row_groups().iter().flat_map(RowGroupMetaData::columns);
    for compression in columns.map(ColumnChunkMetaData::compression) {
        let is_known = matches!(compression, Compression::UNCOMPRESSED | Compression::SNAPPY);
        let name = compression.to_string();
        let name = name.split('(').next().unwrap_or_default();
        ensure!(is_known, "its compression is {name}, expected SNAPPY or none");
    }
    let fields = reader.metadata().file_metadata().schema().get_fields();
    let mut table = Vec::from_iter(fields.iter().map(|field| Series::titled(field.name())));
    for row in reader.get_row_iter(None)? {
        for (series, (_, field)) in table.iter_mut().zip(row?.get_column_iter()) {
            series.cells.push(match field {
                Field::Null => None,
                Field::Bool(value) => Some(Value::Boolean(*value)),
                Field::Byte(value) => Some(Value::Int8(*value)),
                Field::UByte(value) => Some(Value::UInt8(*value)),
                Field::Short(value) => Some(Value::Int16(*value)),
                Field::UShort(value) => Some(Value::UInt16(*value)),
                Field::Int(value) => Some(Value::Int32(*value)),
                Field::UInt(value) => Some(Value::UInt32(*value)),
                Field::Long(value) => Some(Value::Int64(*value)),
                Field::ULong(value) => Some(Value::UInt64(*value)),
                Field::Float(value) => Some(Value::Float32(*value)),
                Field::Double(value) => Some(Value::Float64(*value)),
                Field::Str(value) => Some(Value::String(value.clone())),
                Field::Bytes(value) => Some(Value::Binary(value.data().to_vec())),
                _ => bail!("{} is not a column of numbers, Booleans or strings", series.name),
            });
        }
    }
    Ok(table)
}
