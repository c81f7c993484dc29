//! Plain-text tables.

use std::io::Write;

/// Prints rows, each column as wide as its widest cell; the first is left-aligned, the others right.
pub fn print<const N: usize>(rows: &[[String; N]], out: &mut impl Write) -> std::io::Result<()> {
    let width = |column: usize| {
        let widths = rows
            .iter()
            .map(|row: &[String; N]| row[column].chars().count());
        widths.max().unwrap_or(0)
    };
    let widths: [usize; N] = std::array::from_fn(width);
    for row in rows {
        let mut line = String::new();
        for (column, (cell, width)) in row.iter().zip(widths).enumerate() {
            line += &if column == 0 {
                format!("{cell:width$}")
            } else {
                format!("  {cell:>width$}")
            };
        }
        writeln!(out, "{}", line.trim_end())?;
    }
    Ok(())
}
