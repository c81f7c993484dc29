//! Reading and writing variables.

use std::collections::HashMap;
use std::hint::black_box;

use anyhow::{Context, Result, ensure};
use fmu_description::value::{boolean, real};
use fmu_description::{Causality, FmiVersion, Initial, ScalarVariable, Variability, VariableType};
use fmu_file::text::quote;
use fmu_host::Kind;

use crate::binary::excitation::other;
use crate::binary::record::{Row, Trajectory, Value, read, references, set};
use crate::binary::rules::{READABLE, START, WRITES_INSIDE};
use crate::binary::run::Run;
use crate::binary::subject::{Subject, is_real, is_tested};

/// Maximum number of variables that are reported as unreadable.
const MAX_UNREADABLE: usize = 20;

/// Reads each variable alone after initialization. After a refusal, a new instance is used.
pub fn readable(subject: &Subject<'_>) -> Result<()> {
    let all: Vec<_> = subject
        .all()
        .filter(|v| v.causality != Causality::Independent)
        .collect();
    let (mut next, mut refused) = (0, 0);
    while next < all.len() && refused < MAX_UNREADABLE {
        let mut run = Run::begin(subject, &subject.still())?;
        for variable in &all[next..] {
            next += 1;
            if let Err(error) = read(&mut run.instance, variable) {
                subject.report.find(&READABLE, format!("{error:#}"));
                subject.report.value(variable.name);
                refused += 1;
                break;
            }
        }
    }
    Ok(())
}

/// Compares the start values of the XML with those of the binary in initialization mode.
pub fn start(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::instantiate(subject, &subject.still())?;
    run.enter_initialization()?;
    for variable in subject.all() {
        let exact =
            variable.initial == Some(Initial::Exact) || variable.causality == Causality::Input;
        let Some(expected) = variable.start().filter(|_| exact) else {
            continue;
        };
        let value = match read(&mut run.instance, variable) {
            Ok(value) => value,
            Err(error) => {
                subject
                    .report
                    .find(&READABLE, format!("{error:#} in initialization mode"));
                return Ok(());
            }
        };
        if !is_start(&value, expected) {
            let (name, expected) = (quote(variable.name), quote(expected));
            let text = format!(
                "the start value of {name} is {value} in the binary, expected {expected} as in the XML"
            );
            subject.report.find(&START, text);
        }
    }
    Ok(())
}

/// Whether a value equals a start value, apart from digits lost when a tool wrote the XML.
fn is_start(value: &Value, start: &str) -> bool {
    match value {
        Value::Real(value) => real(start).is_none_or(|start| {
            start == *value
                || (start.is_nan() && value.is_nan())
                || (start - value).abs() <= 1e-6 * start.abs()
        }),
        Value::Integer(value) => {
            let start = start.trim().parse::<i128>();
            // Those of a UInt64 are read as those of an Int64.
            start.is_ok_and(|start| {
                start == i128::from(*value) || start == i128::from(value.cast_unsigned())
            })
        }
        Value::Boolean(value) => boolean(start).is_none_or(|start| i32::from(start) == *value),
        Value::String(value) => start == value,
    }
}

/// Reads all variables together, one by one in the opposite order, and together again.
pub fn get(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::after(subject, 20)?;
    let together = run.observe()?;
    let again = run.observe()?;
    let at = |row| vec![(run.time(), row)];
    let (together, again) = (at(together), at(again));
    subject.ensure_same(&again, &together, 0.0, "read a second time", "")?;
    let alone = one_by_one(subject, &mut run)?;
    let like = " as when it is read with all others";
    subject.ensure_same(&alone, &together, 0.0, "read alone", like)?;
    guarded(subject, &mut run)?;
    unwritten(subject, &mut run)?;
    backwards(subject, &mut run, &together)
}

/// Sets inputs to the values that they have, from an array that must not be written.
fn unwritten(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    let references = references(&subject.reals(Causality::Input));
    if references.is_empty() || subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let mut values = vec![0.0; references.len()];
    run.instance.get_real(&references, &mut values)?;
    let expected = values.clone();
    if run
        .instance
        .set_real(&references, black_box(&values))
        .is_err()
    {
        return Ok(());
    }
    if *black_box(&values) != expected {
        let text =
            "fmi2SetReal has changed the values that were passed, expected it to read them only";
        subject.report.find(&WRITES_INSIDE, text);
    }
    Ok(())
}

/// Reads the Reals together in the opposite order, in FMI 3.0 the Float64.
fn backwards(subject: &Subject<'_>, run: &mut Run<'_>, expected: &Trajectory) -> Result<()> {
    let variables: Vec<_> = (subject.observed.reals().iter().copied().enumerate())
        .filter(|(_, v)| is_real(v))
        .collect();
    let references: Vec<u32> = variables.iter().rev().map(|(_, v)| v.reference).collect();
    if references.is_empty() {
        return Ok(());
    }
    let (time, mut row) = expected[0].clone();
    let mut values = vec![0.0; references.len()];
    run.instance.get_real(&references, &mut values)?;
    for ((place, _), value) in variables.iter().rev().zip(values) {
        row.reals[*place] = value;
    }
    let when = "read together in another order";
    subject.ensure_same(&[(time, row)], expected, 0.0, when, "")
}

fn one_by_one(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<Trajectory> {
    let mut values = Vec::new();
    let all: Vec<_> = subject.observed.variables().collect();
    for variable in all.iter().rev() {
        values.push(read(&mut run.instance, variable)?);
    }
    let mut row = Row::default();
    for value in values.into_iter().rev() {
        match value {
            Value::Real(value) => row.reals.push(value),
            Value::Integer(value) => row.integers.push(value),
            Value::Boolean(value) => row.booleans.push(value),
            Value::String(value) => row.strings.push(value),
        }
    }
    Ok(vec![(run.time(), row)])
}

/// Reads the Reals into a buffer that is longer than needed. FMI 3.0 passes its length.
fn guarded(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    const GUARD: f64 = 1.234_567_89e300;
    let references = references(subject.observed.reals());
    let n = references.len();
    if n > 0 && subject.model.version == FmiVersion::Fmi2 {
        let mut values = vec![GUARD; n + 8];
        run.instance.get_real(&references, &mut values)?;
        if values[n..].iter().any(|value| *value != GUARD) {
            let text = format!("fmi2GetReal wrote more than {n} values, expected {n}");
            subject.report.find(&WRITES_INSIDE, text);
        }
    }
    Ok(())
}

/// Gets and sets no variables.
pub fn nothing(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, &subject.setup())?;
    subject.report.stage("with 0 value references and NULL");
    run.instance.get_and_set_nothing()?;
    run.advance()?;
    Ok(())
}

/// Variables with the same value reference have the same value.
pub fn aliases(subject: &Subject<'_>) -> Result<()> {
    let mut sets: HashMap<(VariableType, u32), Vec<&ScalarVariable<'_>>> = HashMap::new();
    for variable in subject.observed.variables() {
        let key = (variable.kind, variable.reference);
        sets.entry(key).or_default().push(variable);
    }
    let mut run = Run::after(subject, 20)?;
    for set in sets.values().filter(|set| set.len() > 1) {
        let first = read(&mut run.instance, set[0])?;
        for other in &set[1..] {
            let value = read(&mut run.instance, other)?;
            let (a, b) = (quote(set[0].name), quote(other.name));
            ensure!(
                value == first,
                "{b} is {value}, expected {first} like its alias {a}"
            );
        }
    }
    Ok(())
}

/// Sets inputs and parameters before initialization, inputs in initialization mode, and inputs between
/// steps, and reads them back.
pub fn kept(subject: &Subject<'_>) -> Result<()> {
    let setup = subject.still();
    let mut run = Run::instantiate(subject, &setup)?;
    for variable in subject.variables(Causality::Parameter) {
        // Before initialization, FMUs need not let values be read.
        if !set_and_read(&mut run, variable, "before initialization", true)? {
            break;
        }
    }
    drop(run);
    let mut run = Run::instantiate(subject, &setup)?;
    run.enter_initialization()?;
    for variable in subject.variables(Causality::Input) {
        if !set_and_read(&mut run, variable, "in initialization mode", false)? {
            return Ok(());
        }
    }
    drop(run);
    if subject.kind == Kind::CoSimulation {
        let mut run = Run::begin(subject, &setup)?;
        run.advance()?;
        for variable in subject.variables(Causality::Input) {
            if !set_and_read(&mut run, variable, "between two steps", false)? {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Returns whether the FMU has accepted the value.
fn set_and_read(
    run: &mut Run<'_>,
    variable: &ScalarVariable<'_>,
    when: &str,
    may_be_unreadable: bool,
) -> Result<bool> {
    let is_free = matches!(variable.kind, VariableType::Integer | VariableType::Int32)
        && variable.inherited("min").is_none()
        && variable.inherited("max").is_none();
    let value = match is_free {
        // More than 16 bits.
        true => Some(Value::Integer(1_234_567)),
        false => other(variable),
    };
    let Some(value) = value else {
        return Ok(true);
    };
    if set(&mut run.instance, variable, &value).is_err() {
        return Ok(false);
    }
    let read = match read(&mut run.instance, variable) {
        Err(_) if may_be_unreadable => return Ok(false),
        read => read?,
    };
    let same = match (&read, &value) {
        (Value::Real(read), Value::Real(value)) => (read - value).abs() <= 1e-12 * value.abs(),
        _ => read == value,
    };
    ensure!(
        same,
        "{} is {read} after it was set to {value} {when}, expected the value that was set",
        quote(variable.name)
    );
    Ok(true)
}

/// Compares outputs in initialization mode with those after it, at the same time.
pub fn initial_outputs(subject: &Subject<'_>) -> Result<()> {
    if subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let listed: Vec<_> = (subject.model.initial_unknowns.iter())
        .filter_map(|unknown| subject.model.variable(unknown.index))
        .filter(|v| {
            let continuous = v.variability == Variability::Continuous && is_real(v) && is_tested(v);
            continuous && v.causality == Causality::Output
        })
        .collect();
    let mut run = Run::instantiate(subject, &subject.still())?;
    run.enter_initialization()?;
    for variable in subject.reals(Causality::Input) {
        if let Some(value) = other(variable)
            && set(&mut run.instance, variable, &value).is_err()
        {
            return Ok(());
        }
    }
    let mut before = Vec::new();
    for variable in &listed {
        before.push(read(&mut run.instance, variable)?);
    }
    run.instance.exit_initialization_mode()?;
    for (variable, before) in listed.iter().zip(before) {
        let after = read(&mut run.instance, variable)?;
        let (Value::Real(a), Value::Real(b)) = (&before, &after) else {
            continue;
        };
        ensure!(
            (a - b).abs() <= subject.tolerance() * a.abs().max(b.abs()).max(1e-9) || b.is_nan(),
            "{} is {before} in initialization mode, expected {after} as after it",
            quote(variable.name)
        );
    }
    Ok(())
}

/// Sets tunable parameters between two steps, to the values that they have.
pub fn tunable(subject: &Subject<'_>) -> Result<()> {
    if subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let mut run = Run::begin(subject, &subject.setup())?;
    run.advance()?;
    let parameters = subject.variables(Causality::Parameter);
    for variable in parameters.filter(|v| v.variability == Variability::Tunable) {
        let value = read(&mut run.instance, variable)?;
        let set = set(&mut run.instance, variable, &value);
        set.with_context(|| format!("{} is tunable, but between two steps", quote(variable.name)))?;
    }
    run.advance()?;
    Ok(())
}
