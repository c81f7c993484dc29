//! The Arrow schema in the metadata of a Parquet file, where pyarrow and others find the units of columns.
//!
//! It is a message of [`Schema.fbs` and `Message.fbs`](https://github.com/apache/arrow/tree/main/format), whose numbers
//! are here.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flatbuffers::{FlatBufferBuilder, TableFinishedWIPOffset, VOffsetT, WIPOffset};
use fmu_description::Type;

use super::super::column::Column;

/// Its key in the metadata of the file.
pub(super) const KEY: &str = "ARROW:schema";
/// The metadata of a column that has its unit.
const UNIT: &str = "unit";

const VERSION_5: i16 = 4;
const HEADER_SCHEMA: u8 = 1;

type Builder<'a> = FlatBufferBuilder<'a>;
type Table = WIPOffset<TableFinishedWIPOffset>;

/// The place of a field in a table, by its number.
const fn slot(field: VOffsetT) -> VOffsetT {
    4 + 2 * field
}

fn table<'a>(builder: &mut Builder<'a>, fill: impl FnOnce(&mut Builder<'a>)) -> Table {
    let start = builder.start_table();
    fill(builder);
    builder.end_table(start)
}

/// The schema of a table.
pub(super) fn schema(columns: &[Column]) -> String {
    let mut b = Builder::new();
    let fields = Vec::from_iter(columns.iter().map(|column| field(&mut b, column)));
    let fields = b.create_vector(&fields);
    let schema = table(&mut b, |b| b.push_slot_always(slot(1), fields));
    let message = table(&mut b, |b| {
        b.push_slot_always(slot(0), VERSION_5);
        b.push_slot_always(slot(1), HEADER_SCHEMA);
        b.push_slot_always(slot(2), schema);
    });
    b.finish_minimal(message);
    let mut bytes = b.finished_data().to_vec();
    // With its length before it, at a place of 8 bytes.
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    let length = (bytes.len() as u32).to_le_bytes();
    BASE64_STANDARD.encode([&[0xff; 4], &length, &*bytes].concat())
}

fn field(b: &mut Builder<'_>, column: &Column) -> Table {
    let name = b.create_string(&column.title());
    let (kind, of_type) = of_type(b, column.kind);
    let children = b.create_vector::<Table>(&[]);
    let unit = (!column.unit.is_empty()).then(|| {
        let (key, value) = (b.create_string(UNIT), b.create_string(&column.unit));
        let pair = table(b, |b| {
            b.push_slot_always(slot(0), key);
            b.push_slot_always(slot(1), value);
        });
        b.create_vector(&[pair])
    });
    table(b, |b| {
        b.push_slot_always(slot(0), name);
        b.push_slot(slot(1), column.optional, false);
        b.push_slot_always(slot(2), kind);
        b.push_slot_always(slot(3), of_type);
        b.push_slot_always(slot(5), children);
        if let Some(unit) = unit {
            b.push_slot_always(slot(6), unit);
        }
    })
}

/// The number and the table of a type.
fn of_type(b: &mut Builder<'_>, kind: Type) -> (u8, Table) {
    const INT: u8 = 2;
    const FLOATING_POINT: u8 = 3;
    const BINARY: u8 = 4;
    const UTF_8: u8 = 5;
    const BOOL: u8 = 6;
    let float = |b: &mut Builder<'_>, precision: i16| {
        (FLOATING_POINT, table(b, |b| b.push_slot_always(slot(0), precision)))
    };
    let int = |b: &mut Builder<'_>, bits: i32, is_signed: bool| {
        let of_type = table(b, |b| {
            b.push_slot_always(slot(0), bits);
            b.push_slot(slot(1), is_signed, false);
        });
        (INT, of_type)
    };
    match kind {
        Type::Float32 => float(b, 1),
        Type::Float64 => float(b, 2),
        Type::Int8 => int(b, 8, true),
        Type::UInt8 => int(b, 8, false),
        Type::Int16 => int(b, 16, true),
        Type::UInt16 => int(b, 16, false),
        Type::Int32 => int(b, 32, true),
        Type::UInt32 => int(b, 32, false),
        Type::UInt64 => int(b, 64, false),
        Type::Int64 | Type::Enumeration => int(b, 64, true),
        Type::Boolean | Type::Clock => (BOOL, table(b, |_| ())),
        Type::String => (UTF_8, table(b, |_| ())),
        Type::Binary => (BINARY, table(b, |_| ())),
    }
}
