//! Plain-text tables.

/// The lines of rows, each column as wide as its widest cell; the first is left-aligned, and the others too if
/// `left`.
pub fn lines<const N: usize>(rows: &[[String; N]], left: bool) -> impl Iterator<Item = String> {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max();
    let widths: [usize; N] = std::array::from_fn(|column| width(column).unwrap_or(0));
    rows.iter().map(move |row| {
        let cells = row.iter().zip(widths).enumerate();
        let cells = cells.map(|(column, (cell, width))| {
            if left || column == 0 { format!("{cell:width$}") } else { format!("{cell:>width$}") }
        });
        Vec::from_iter(cells).join("  ").trim_end().to_owned()
    })
}
