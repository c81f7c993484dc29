//! Reading and writing variables.

use std::collections::HashMap;
use std::hint::black_box;

use anyhow::{Context, Result, ensure};
use fmu_description::value::{unsigned, whole};
use fmu_description::{Causality, FmiVersion, Initial, Listed, Type, Value, Variability};
use fmu_file::text::quote;
use fmu_host::Kind;

use crate::binary::run::{OrSkip, Run, Subject, check, report};
use crate::binary::task::Reply;
use crate::binary::values::{
    MAX_ELEMENTS, Row, element_name, is_near, is_tested, other, references, shown, size,
};

/// Maximum number of variables that are reported as unreadable.
const MAX_UNREADABLE: usize = 20;
/// Steps before variables are read.
const STEPS: usize = 20;

/// Reads each variable alone after initialization. After a refusal, a new instance is used.
pub fn readable(subject: &Subject<'_>) -> Result<()> {
    let all: Vec<_> = subject
        .readable()
        .filter(|v| v.causality != Causality::Independent)
        .collect();
    let (mut next, mut refused) = (0, 0);
    while next < all.len() && refused < MAX_UNREADABLE {
        let mut run = Run::begin(subject, subject.still())?;
        for variable in &all[next..] {
            next += 1;
            if let Err(error) = run.read(variable) {
                report!(subject, READABLE, "{error:#}");
                let name = variable.name.clone();
                subject.report.reply(&Reply::Unreadable(name));
                refused += 1;
                break;
            }
        }
    }
    Ok(())
}

/// Compares the start values of the XML with the values of the binary in initialization mode.
pub fn start(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::initializing(subject, subject.still())?;
    let has_start = |v: &&Listed<'_>| {
        let is_exact = v.initial == Some(Initial::Exact) || v.causality == Causality::Input;
        is_exact && !v.start.is_empty()
    };
    for variable in subject.readable().filter(has_start) {
        let values = match run.read(variable) {
            Ok(values) => values,
            Err(error) => {
                report!(subject, READABLE, "{error:#} in initialization mode");
                return Ok(());
            }
        };
        let starts = (0..).map_while(|element| variable.start_of(element));
        // A tool may have lost digits when it wrote the XML.
        let differs = |(value, start): (&Value, &Value)| !is_near(value, start, 1e-6 * size(start));
        if let Some(element) = values.iter().zip(starts).position(differs) {
            let (name, value) = (element_name(variable, element), shown(&values[element]));
            let written = variable.starts();
            let expected = quote(written.get(element).or(written.last()).unwrap_or(&""));
            let is = match variable.dimensions.is_empty() {
                true => format!("{value} in the binary"),
                false => "different in the binary".into(),
            };
            report!(
                subject,
                START,
                "the start value of {name} is {is}, expected {expected} as in the XML"
            );
        }
    }
    Ok(())
}

/// Reads all variables together, a second time, one by one in the opposite order, and, of Float64, together
/// in the opposite order.
pub fn get(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::after(subject, STEPS)?;
    let time = run.time();
    let together = run.row(&subject.observed)?;
    let same = |row: Row, when: &str, like: &str| {
        (subject.observed).ensure_same(&[(time, row)], &together, 0.0, when, like)
    };
    same(run.observe()?, "when it is read a second time", "")?;
    let mut alone = Vec::new();
    for variable in subject.observed.variables().rev() {
        alone.extend(run.read(variable)?.into_iter().rev());
    }
    alone.reverse();
    let like = " as when it is read with all others";
    same(alone, "when it is read alone", like)?;
    guarded(subject, &mut run)?;
    unwritten(subject, &mut run)?;
    let mut backwards = together[0].1.clone();
    let reals = subject.observed.elements().enumerate();
    let is_real = |v: &Listed<'_>| v.of_type == Type::Float64 && is_tested(v);
    let reals = reals
        .filter(|(_, (v, _))| is_real(v))
        .map(|(at, (v, _))| (at, v.reference));
    let (mut places, mut references): (Vec<usize>, Vec<u32>) = reals.unzip();
    places.reverse();
    references.reverse();
    if !references.is_empty() {
        for (at, value) in places.into_iter().zip(run.reals(&references)?) {
            backwards[at] = Value::Float64(value);
        }
    }
    same(backwards, "when it is read together in another order", "")
}

/// Reads Reals into a buffer that is longer than needed. FMI 3.0 passes its length.
fn guarded(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    const GUARD: f64 = 1.234_567_89e300;
    let reals = subject
        .observed
        .variables()
        .filter(|v| v.of_type == Type::Float64);
    let references = references(&reals.collect::<Vec<_>>());
    let n = references.len();
    if n > 0 && subject.model.version == FmiVersion::Fmi2 {
        let mut values = vec![GUARD; n + 8];
        run.instance.get_float64(&references, &mut values)?;
        check!(subject, WRITES_INSIDE: values[n..].iter().all(|value| *value == GUARD),
            "fmi2GetReal wrote more than {n} values, expected {n}");
    }
    Ok(())
}

/// Sets inputs to the values that they have, from an array that must not be written.
fn unwritten(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    let references = references(&subject.reals(Causality::Input));
    if references.is_empty() || subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let values = run.reals(&references)?;
    let expected = values.clone();
    let set = run.instance.set_float64(&references, black_box(&values));
    check!(subject, WRITES_INSIDE: set.is_err() || *black_box(&values) == expected,
        "fmi2SetReal has changed the values that were passed, expected it to read them only");
    Ok(())
}

pub fn nothing(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    subject.report.stage("with 0 value references and NULL");
    run.instance.get_and_set_nothing()?;
    run.advance()
}

/// Variables with the same value reference have the same value.
pub fn aliases(subject: &Subject<'_>) -> Result<()> {
    let mut first: HashMap<(Type, u32), (&Listed<'_>, Value)> = HashMap::new();
    let mut run = Run::after(subject, STEPS)?;
    for variable in subject.observed.variables().filter(|v| is_tested(v)) {
        let value = run.value(variable)?;
        let key = (variable.of_type, variable.reference);
        let (of, expected) = first.entry(key).or_insert((variable, value.clone()));
        ensure!(
            is_near(&value, expected, 0.0),
            "{} is {}, expected {} like its alias {}",
            quote(&variable.name),
            shown(&value),
            shown(expected),
            quote(&of.name)
        );
    }
    Ok(())
}

/// Sets inputs and parameters before initialization, inputs in initialization mode, and inputs between
/// steps, and reads them back. Before initialization, FMUs need not let values be read.
pub fn kept(subject: &Subject<'_>) -> Result<()> {
    use Causality::{Input, Parameter};
    let still = subject.still();
    let run = Run::instantiate(subject, still)?;
    are_kept(subject, run, Parameter, "before initialization")?;
    let run = Run::initializing(subject, still)?;
    let is_refused = !are_kept(subject, run, Input, "in initialization mode")?;
    if is_refused || subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let mut run = Run::begin(subject, still)?;
    run.advance()?;
    are_kept(subject, run, Input, "between two steps").map(drop)
}

/// Sets variables and reads them; returns whether the FMU has accepted all values.
fn are_kept(
    subject: &Subject<'_>,
    mut run: Run<'_>,
    causality: Causality,
    when: &str,
) -> Result<bool> {
    for variable in subject.variables(causality) {
        let is_bounded = variable.min.is_some() || variable.max.is_some();
        let value = match variable.of_type {
            // More than 16 bits.
            Type::Int32 if !is_bounded => Some(Value::Int32(1_234_567)),
            _ => other(variable),
        };
        let Some(value) = value else {
            continue;
        };
        if run.set(variable, std::slice::from_ref(&value)).is_err() {
            return Ok(false);
        }
        let read = match run.value(variable) {
            Err(_) if causality == Causality::Parameter => return Ok(false),
            read => read?,
        };
        ensure!(
            is_near(&read, &value, 1e-12 * size(&value)),
            "{} is {} after it was set to {} {when}, expected the value that was set",
            quote(&variable.name),
            shown(&read),
            shown(&value)
        );
    }
    Ok(true)
}

/// Sets arrays of parameters to their start values in another order, and reads them in initialization mode.
pub fn kept_arrays(subject: &Subject<'_>) -> Result<()> {
    let is_array = |v: &&Listed<'_>| {
        let is_parameter = v.causality == Causality::Parameter && v.of_type == Type::Float64;
        is_parameter && !v.dimensions.is_empty() && v.start.len() == v.count()
    };
    let arrays: Vec<_> = subject.readable().filter(is_array).collect();
    let reversed = |v: &Listed<'_>| -> Vec<Value> { v.start.iter().rev().cloned().collect() };
    let mut run = Run::instantiate(subject, subject.still())?;
    for array in &arrays {
        run.set(array, &reversed(array)).or_skip()?;
    }
    // Such as breakpoints, which have an order.
    run.enter_initialization().or_skip()?;
    for array in arrays {
        let pairs = run.read(array)?.into_iter().zip(reversed(array));
        let mut pairs = pairs.map(|(value, set)| is_near(&value, &set, 1e-12 * size(&set)));
        let changed = pairs.position(|is_kept| !is_kept);
        ensure!(
            changed.is_none(),
            "{} has another value in initialization mode, expected the one that was set before",
            element_name(array, changed.unwrap_or_default())
        );
    }
    Ok(())
}

/// Compares outputs in initialization mode with those after it, at the same time.
pub fn initial_outputs(subject: &Subject<'_>) -> Result<()> {
    let listed = subject.model.initial_unknowns.iter();
    let listed = listed.filter_map(|unknown| subject.model.variable(unknown.index));
    let listed = listed.filter(|v| {
        let is_output = v.causality == Causality::Output && is_tested(v);
        is_output && v.of_type == Type::Float64 && v.variability == Variability::Continuous
    });
    let listed = subject.group(listed);
    let mut run = Run::initializing(subject, subject.still())?;
    for variable in subject.reals(Causality::Input) {
        if let Some(value) = other(variable) {
            run.set(variable, &[value]).or_skip()?;
        }
    }
    let before = run.row(&listed)?;
    run.instance.exit_initialization_mode()?;
    let (after, when) = (run.row(&listed)?, "in initialization mode");
    listed.ensure_same(&before, &after, subject.tolerance(), when, " as after it")
}

/// Sets tunable parameters between two steps, to the values that they have.
pub fn tunable(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    run.advance()?;
    let parameters = subject.variables(Causality::Parameter);
    for variable in parameters.filter(|v| v.variability == Variability::Tunable) {
        let value = run.value(variable)?;
        let set = run.set(variable, &[value]);
        let name = quote(&variable.name);
        set.with_context(|| format!("{name} is tunable, but between two steps"))?;
    }
    run.advance()
}

/// The strings of an instance stay when another instance sets and gets its own.
pub fn strings_of_instances(subject: &Subject<'_>) -> Result<()> {
    let is_string = |v: &&Listed<'_>| v.of_type == Type::String;
    let readable = subject.observed.variables().filter(is_string);
    let references: Vec<u32> = readable.map(|v| v.reference).collect();
    if references.is_empty() {
        return Ok(());
    }
    let n = references.len();
    let mut one = Run::begin(subject, subject.setup())?;
    let mut two = Run::instantiate(subject, subject.other())?;
    for variable in subject.variables(Causality::Parameter).filter(is_string) {
        let text = [Value::String("another text".into())];
        two.set(variable, &text).or_skip()?;
    }
    // A text may be more than a text, such as the name of a file.
    two.initialize().or_skip()?;
    one.advance()?;
    let expected = one.instance.get_string(&references, n)?;
    let stage = "after strings of another instance were read";
    subject.report.stage(stage);
    let late = one.instance.get_string_late(&references, n, || {
        let _ = two.advance();
        let _ = two.instance.get_string(&references, n);
    })?;
    for (late, expected) in late.into_iter().zip(expected) {
        ensure!(
            late.as_ref() == Some(&expected),
            "a string changed from {expected:?} to {late:?} when strings of another instance were read"
        );
    }
    Ok(())
}

/// Runs with another value of each structural parameter that its bounds allow.
pub fn sizes(subject: &Subject<'_>) -> Result<()> {
    let is_size = |v: &&Listed<'_>| {
        v.causality == Causality::StructuralParameter && v.of_type == Type::UInt64
    };
    let parameters = subject.model.variables().map(|(_, v)| v);
    for parameter in parameters.filter(is_size) {
        if let Some(size) = other_size(parameter) {
            let name = quote(&parameter.name);
            let run = resized(subject, parameter, size);
            run.map_err(|error| anyhow::anyhow!("with {name} = {size}, {error:#}"))?;
        }
    }
    Ok(())
}

/// Another value within the bounds of a structural parameter, which must be in the XML.
fn other_size(parameter: &Listed<'_>) -> Option<u64> {
    let bound = |name| parameter.inherited(name).and_then(whole::<u64>);
    let start: u64 = whole(parameter.start()?)?;
    match (bound("min"), bound("max")) {
        (_, Some(max)) if start < max => Some(start + 1),
        (Some(min), _) if start > min => Some(start - 1),
        _ => None,
    }
}

fn resized(subject: &Subject<'_>, parameter: &Listed<'_>, size: u64) -> Result<()> {
    let mut run = Run::instantiate(subject, subject.still())?;
    run.instance.enter_configuration_mode()?;
    run.instance.set_uint64(&[parameter.reference], &[size])?;
    run.instance.exit_configuration_mode()?;
    run.initialize()?;
    run.advance_by(subject.task.steps.min(STEPS))?;
    let arrays = subject
        .readable()
        .filter_map(|v| Some((v, count(v, parameter, size)?)));
    for (variable, n) in arrays.filter(|(_, n)| *n <= MAX_ELEMENTS) {
        let values = run.read_elements(variable, n)?;
        let is_output = variable.causality == Causality::Output;
        let continuous = is_output && variable.variability == Variability::Continuous;
        let is_finite = |value: &Value| value.as_real().is_none_or(f64::is_finite);
        ensure!(
            !continuous || values.iter().all(is_finite),
            "{} is not finite",
            quote(&variable.name)
        );
    }
    Ok(())
}

/// The number of elements with another value of a structural parameter; `None` if it has no effect.
fn count(variable: &Listed<'_>, parameter: &Listed<'_>, size: u64) -> Option<usize> {
    let mut dimensions = variable.dimensions.clone();
    for (dimension, n) in variable.element.children("Dimension").zip(&mut dimensions) {
        let reference = dimension.attribute("valueReference").and_then(unsigned);
        if reference == Some(parameter.reference) {
            *n = usize::try_from(size).ok()?;
        }
    }
    let is_changed = dimensions != variable.dimensions;
    let product = dimensions
        .iter()
        .try_fold(1_usize, |product, n| product.checked_mul(*n));
    product.filter(|_| is_changed)
}
