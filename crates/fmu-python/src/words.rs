//! The words of Python for notes and advice.

use fmu_master::{Advice, Note};

/// A note of a run.
pub fn note(note: &Note) -> String {
    match note {
        Note::RecordedAfterStep(components) => {
            let verb = if components.len() == 1 { "is" } else { "are" };
            let names = components.join(", ");
            format!(
                "{names} {verb} recorded after each step; use `sampled=False` of a component for before"
            )
        }
        Note::RunInSandbox(components) => {
            format!("run as WebAssembly components: {}", components.join(", "))
        }
        Note::NothingRecorded { recordable, .. } if recordable.is_empty() => {
            "nothing is recorded, because no variable can be recorded".to_owned()
        }
        Note::NothingRecorded { recordable, more } => {
            let names = recordable.join(", ");
            let more = if *more > 0 { format!(", and {more} more") } else { String::new() };
            format!(
                "nothing is recorded, because no output is a number or Boolean; `output` can name {names}{more}"
            )
        }
        Note::EndsBeforeStop { last, stop } => {
            format!(
                "the step size does not divide the run: it ends at t = {last} s, not at {stop} s"
            )
        }
    }
}

/// The end of an error with this advice.
pub fn advice(advice: &Advice) -> String {
    match advice {
        Advice::ListVariables(fmu) => format!("`Instance(\"{fmu}\").variables` has its variables"),
        Advice::Simulate => "`simulate`".to_owned(),
        Advice::Sweep => "`sweep`".to_owned(),
        Advice::AnotherTable => "another `out`".to_owned(),
    }
}
