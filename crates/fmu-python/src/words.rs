//! The words of Python for notes, advice and real time, and names in place of numbers.

use std::collections::HashMap;

use fmu_master::curve::Curve;
use fmu_master::{
    Advice, Column, FunctionTime, LongestStep, Moment, Note, NoteOptions, Profile, Punctuality,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

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
        Advice::SolveImplicitly => {
            "; if the equations are stiff, `solver=\"implicit\"` needs fewer".to_owned()
        }
        Advice::Simulate => "`simulate`".to_owned(),
        Advice::Sweep => "`sweep`".to_owned(),
        Advice::AnotherTable => "another `out`".to_owned(),
    }
}

/// The component and the function, the numbers of calls and of failed ones, and the total, mean and longest time (s).
type Times = (String, String, [u64; 2], [f64; 3]);

/// The times of each function; then the time of the master, as a component without functions.
pub fn profile(profile: &Profile) -> Vec<Times> {
    let functions = profile.functions.iter().map(|times| {
        let FunctionTime { component, function, calls, failures, total, longest } = times.clone();
        let [total, mean, longest] = [total, times.mean(), longest].map(|t| t.as_secs_f64());
        (component, function, [calls, failures], [total, mean, longest])
    });
    let (none, master) = (String::new, profile.master().as_secs_f64());
    functions.chain([(none(), none(), [0; 2], [master, 0.0, 0.0])]).collect()
}

/// The names of set-points by the names of what follows them.
pub fn set_points<'a>(columns: &'a [Column], curves: &[Curve]) -> HashMap<&'a str, &'a str> {
    let pairs = columns
        .iter()
        .zip(curves)
        .filter_map(|(column, curve)| Some((&*column.name, &*columns.get(curve.set_point?)?.name)));
    pairs.collect()
}

/// How well a run has kept the time, as the arguments of `RealTime`; durations and times in s.
pub fn punctuality<'py>(
    py: Python<'py>,
    punctuality: &Punctuality,
) -> PyResult<Bound<'py, PyDict>> {
    let Punctuality { factor, steps, overruns, largest_overrun, jitter, longest, refused } =
        punctuality;
    let moment = |moment: &Moment| (moment.duration.as_secs_f64(), moment.time);
    let dict = PyDict::new(py);
    dict.set_item("factor", factor)?;
    dict.set_item("steps", steps)?;
    dict.set_item("overruns", overruns)?;
    dict.set_item("largest_overrun", largest_overrun.as_ref().map(moment))?;
    let late = PyDict::new(py);
    if let Some((percentiles, latest)) = jitter {
        for (percentage, duration) in [50.0, 99.0, 99.9].into_iter().zip(percentiles) {
            late.set_item(percentage, duration.as_secs_f64())?;
        }
        late.set_item(100.0, latest.duration.as_secs_f64())?;
    }
    dict.set_item("jitter", late)?;
    dict.set_item("latest_wake_up", jitter.as_ref().map(|(_, latest)| moment(latest)))?;
    let longest = longest.as_ref().map(|LongestStep { step, component, part }| {
        (step.duration.as_secs_f64(), step.time, component, part.as_secs_f64())
    });
    dict.set_item("longest_step", longest)?;
    let refused = refused.iter().map(|(means, reason)| format!("{means}: {reason}"));
    dict.set_item("not_allowed", Vec::from_iter(refused))?;
    Ok(dict)
}
