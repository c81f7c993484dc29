//! Writes rows as Parquet columns.

use std::sync::Arc;

use anyhow::Result;
use fmu_description::Type as Kind;
use fmu_file::replace::Replacement;
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use super::{Cell, Column, Values};

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
        let empty = |column: &Column| (Values::of(column.kind), Vec::new());
        let mut group: Vec<(Values, Vec<i16>)> = columns.iter().map(empty).collect();
        let mut count = 0;
        for row in rows.by_ref().take(ROWS_PER_GROUP) {
            count += 1;
            for ((values, present), cell) in group.iter_mut().zip(row?) {
                present.push(cell.is_some().into());
                cell.into_iter().for_each(|value| values.push(value));
            }
        }
        if count == 0 {
            writer.close()?;
            return Ok(());
        }
        let mut writer = writer.next_row_group()?;
        for (column, (values, present)) in columns.iter().zip(group) {
            write_column(&mut writer, values, column.optional.then_some(&present))?;
        }
        writer.close()?;
    }
}

fn schema(columns: &[Column]) -> Result<TypePtr, ParquetError> {
    let whole = |bits, is_signed| Some(LogicalType::integer(bits, is_signed));
    let field = |column: &Column| {
        let (physical, logical) = match column.kind {
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
        };
        let repetition = match column.optional {
            true => Repetition::OPTIONAL,
            false => Repetition::REQUIRED,
        };
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

/// Writes the next column: its values, and for an optional column which rows have one.
fn write_column(
    group: &mut Group<'_, '_>,
    values: Values,
    present: Option<&Vec<i16>>,
) -> Result<(), ParquetError> {
    // Numbers without a sign are stored as their bits.
    match values {
        Values::Float64(all) => typed::<DoubleType, _>(group, all, |v| v, present),
        Values::Float32(all) => typed::<FloatType, _>(group, all, |v| v, present),
        Values::Boolean(all) => typed::<BoolType, _>(group, all, |v| v, present),
        Values::Int64(all) => typed::<Int64Type, _>(group, all, |v| v, present),
        Values::UInt64(all) => typed::<Int64Type, _>(group, all, |v| v as i64, present),
        Values::Int32(all) => typed::<Int32Type, _>(group, all, |v| v, present),
        Values::UInt32(all) => typed::<Int32Type, _>(group, all, |v| v as i32, present),
        Values::Int8(all) => typed::<Int32Type, _>(group, all, i32::from, present),
        Values::UInt8(all) => typed::<Int32Type, _>(group, all, i32::from, present),
        Values::Int16(all) => typed::<Int32Type, _>(group, all, i32::from, present),
        Values::UInt16(all) => typed::<Int32Type, _>(group, all, i32::from, present),
        Values::String(all) => {
            let bytes = |text: String| ByteArray::from(text.into_bytes());
            typed::<ByteArrayType, _>(group, all, bytes, present)
        }
        Values::Binary(all) => typed::<ByteArrayType, _>(group, all, ByteArray::from, present),
    }
}

fn typed<T: DataType, V>(
    group: &mut Group<'_, '_>,
    all: Vec<V>,
    value: fn(V) -> T::T,
    present: Option<&Vec<i16>>,
) -> Result<(), ParquetError> {
    let missing = || ParquetError::General("there are more columns than in the schema".into());
    let mut column = group.next_column()?.ok_or_else(missing)?;
    let values = Vec::from_iter(all.into_iter().map(value));
    let present = present.map(Vec::as_slice);
    column.typed::<T>().write_batch(&values, present, None)?;
    column.close()
}
