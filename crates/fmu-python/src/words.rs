//! The words of Python for notes and advice, and names in place of numbers.

use std::collections::HashMap;

use fmu_master::curve::Curve;
use fmu_master::{Advice, Column, Note, NoteOptions};

/// A note of a run.
pub fn note(note: &Note) -> String {
    const OPTIONS: NoteOptions = NoteOptions {
        record_before: "use `sampled=False` of a component",
        record: "`output` can name",
    };
    note.text(&OPTIONS)
}

/// The end of an error with this advice.
pub fn advice(advice: &Advice) -> String {
    match advice {
        Advice::ListVariables(fmu) => format!("`Instance(\"{fmu}\").variables` has its variables"),
        Advice::Compile => "`compile=True` compiles them".to_owned(),
        Advice::Simulate => "`simulate`".to_owned(),
        Advice::Sweep => "`sweep`".to_owned(),
        Advice::AnotherTable => "another `out`".to_owned(),
    }
}

/// The names of set-points by the names of what follows them.
pub fn set_points<'a>(columns: &'a [Column], curves: &[Curve]) -> HashMap<&'a str, &'a str> {
    let pairs = columns
        .iter()
        .zip(curves)
        .filter_map(|(column, curve)| Some((&*column.name, &*columns.get(curve.set_point?)?.name)));
    pairs.collect()
}
