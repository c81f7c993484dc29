//! Reads Parquet, also of other programs, if its columns have plain values.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
use fmu_description::Value;
use parquet::basic::{Compression, LogicalType};
use parquet::file::metadata::{ColumnChunkMetaData, RowGroupMetaData};
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::record::Field;
use parquet::schema::types::Type;

use super::super::column::{Cell, Series, named};
use super::zstd::Group;
use super::{ITEMS, items_of};

/// Reads a file with columns of plain values.
pub(in crate::table) fn read(file: &Path) -> Result<Vec<Series>> {
    let file = Arc::new(File::open(file)?);
    let reader = SerializedFileReader::new(file.try_clone()?)?;
    let mut columns = reader.metadata().row_groups().iter().flat_map(RowGroupMetaData::columns);
    columns.try_for_each(check_column)?;
    let about = reader.metadata().file_metadata();
    let mut table = Vec::new();
    for field in about.schema().get_fields() {
        let series = Series::titled(field.name());
        check_type(&series.name, field)?;
        table.push(series);
    }
    for group in 0..reader.num_row_groups() {
        let group = Group::new(file.clone(), reader.get_row_group(group)?);
        for row in group.get_row_iter(None)? {
            for (series, (_, field)) in table.iter_mut().zip(row?.get_column_iter()) {
                series.cells.push(cell(&series.name, field)?);
            }
        }
    }
    let known = about.key_value_metadata().into_iter().flatten().find(|known| known.key == ITEMS);
    let known = known.and_then(|known| known.value.as_deref()).unwrap_or_default();
    for series in &mut table {
        series.items = items_of(&series.name, known);
        if !series.items.is_empty() {
            let cells = std::mem::take(&mut series.cells).into_iter();
            let name = |value| named(&series.items, value);
            series.cells = cells.map(|cell| cell.map(name)).collect();
        }
    }
    Ok(table)
}

fn check_column(column: &ColumnChunkMetaData) -> Result<()> {
    use Compression::{GZIP, LZ4, LZ4_RAW, SNAPPY, UNCOMPRESSED, ZSTD};
    // The crate asserts it.
    let start = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
    ensure!(start >= 0 && column.compressed_size() >= 0, "it is damaged");
    let compression = column.compression();
    let name = compression.to_string();
    let name = name.split('(').next().unwrap_or_default();
    let is_known = matches!(compression, UNCOMPRESSED | SNAPPY | ZSTD(_) | GZIP(_) | LZ4 | LZ4_RAW);
    ensure!(is_known, "its compression is {name}, expected SNAPPY, ZSTD, GZIP, LZ4 or none");
    Ok(())
}

/// Refuses columns of which a part would be lost, such as the unit of a time.
fn check_type(name: &str, field: &Type) -> Result<()> {
    let is_plain = field.is_primitive();
    ensure!(is_plain, "{name} has lists or structures, expected numbers, Booleans or strings");
    let is_date = matches!(
        field.get_basic_info().logical_type_ref(),
        Some(LogicalType::Timestamp(_) | LogicalType::Date | LogicalType::Time(_))
    );
    ensure!(!is_date, "{name} has dates or times of day, expected numbers, a time in s");
    Ok(())
}

fn cell(name: &str, field: &Field) -> Result<Cell> {
    Ok(Some(match field {
        Field::Null => return Ok(None),
        Field::Bool(value) => Value::Boolean(*value),
        Field::Byte(value) => Value::Int8(*value),
        Field::UByte(value) => Value::UInt8(*value),
        Field::Short(value) => Value::Int16(*value),
        Field::UShort(value) => Value::UInt16(*value),
        Field::Int(value) => Value::Int32(*value),
        Field::UInt(value) => Value::UInt32(*value),
        Field::Long(value) => Value::Int64(*value),
        Field::ULong(value) => Value::UInt64(*value),
        Field::Float16(value) => Value::Float32(value.to_f32()),
        Field::Float(value) => Value::Float32(*value),
        Field::Double(value) => Value::Float64(*value),
        Field::Str(value) => Value::String(value.clone()),
        Field::Bytes(value) => Value::Binary(value.data().to_vec()),
        _ => bail!("{name} is not a column of numbers, Booleans or strings"),
    }))
}
