//! Tables of typed columns, and their two formats. The same rows give the same bytes.
//!
//! - CSV: a header such as `time [s],plant.theta [rad]`, then a line for each row, with line feeds. Fields
//!   are quoted as RFC 4180 requires; an empty field is a missing value, and `""` an empty string. Numbers
//!   have the fewest digits that read back to the same bits, or are `inf`, `-inf` or `NaN`; Booleans are
//!   `true` or `false` (also read: `True` and `TRUE`), items of Enumerations have their names, and Binaries are
//!   hexadecimal.
//! - Parquet: uncompressed, with the same names, and the types of the variables; Enumerations are numbers, whose names are
//!   in the metadata of the file. Columns are required, or optional if a value may be missing. Units are also in the Arrow
//!   schema. Read are also files of other programs: compressed by Snappy, zstd, gzip or LZ4, with columns of plain values.

mod column;
mod compare;
mod csv;
mod parquet;
mod read;
mod rows;
mod write;

pub use column::{Cell, Column, Format, Series, excerpt};
pub(crate) use column::{boolean, expected};
pub use compare::{Difference, Tolerance, compare};
pub use csv::{fields, header, parse, push_line};
pub use parquet::{ParquetWriter, write_parquet};
pub(crate) use read::{open_texts, read_texts, texts_of};
pub use read::{read, rounding, times};
pub(crate) use rows::standard_input;
pub use rows::{Rows, TimedRow, TimedRows, is_standard_input};
pub use write::write;
