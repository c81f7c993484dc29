//! Arrays of numbers and Booleans, and the structural parameters that size them (FMI 3.0).

use anyhow::{Context, Result, anyhow, ensure};
use fmu_description::value::{boolean, real, unsigned, whole};
use fmu_description::{Capability, Causality, Initial, ScalarVariable, Variability, VariableType};
use fmu_file::text::quote;
use fmu_host::Kind;

use crate::binary::record::{Class, elements};
use crate::binary::rules::{ARRAY_LENGTHS, INPUTS_KEPT, PURE_GET, READABLE, RESET, START, STATE};
use crate::binary::run::Run;
use crate::binary::subject::{Subject, is_real};

/// Maximum number of elements of an array that is tested.
const MAX_ELEMENTS: usize = 1 << 16;
/// Steps before arrays are read.
const STEPS: usize = 20;

/// An array and its number of elements.
type Array<'b, 'a> = (&'b ScalarVariable<'a>, usize);

/// The values of arrays, as bits.
type Values = Vec<Vec<u64>>;

/// The arrays that are tested, with structural parameters at their start values.
fn arrays<'b, 'a>(subject: &'b Subject<'a>) -> Vec<Array<'b, 'a>> {
    let variables = subject.model.variables().map(|(_, v)| v);
    let is_tested = |v: &&ScalarVariable<'_>| {
        !v.dimensions.is_empty()
            && v.count() <= MAX_ELEMENTS
            && !matches!(Class::of(v.kind), Class::String | Class::Other)
            && v.element.attribute("clocks").is_none()
    };
    let arrays = variables.filter(is_tested);
    arrays.map(|v| (v, v.count())).collect()
}

fn read(run: &mut Run<'_>, arrays: &[Array<'_, '_>]) -> Result<Values> {
    let values = arrays.iter().map(|(variable, n)| {
        elements(&mut run.instance, variable, *n)
            .with_context(|| format!("{} cannot be read", quote(variable.name)))
    });
    values.collect()
}

/// The name of the first element that differs by more than a relative tolerance, if it is a real number.
fn difference(arrays: &[Array<'_, '_>], a: &Values, b: &Values, tolerance: f64) -> Option<String> {
    let mut all = arrays.iter().zip(a.iter().zip(b));
    all.find_map(|((variable, _), (a, b))| {
        let differs = |(a, b): (&u64, &u64)| {
            let is_near = || {
                let (a, b) = (f64::from_bits(*a), f64::from_bits(*b));
                (a - b).abs() <= tolerance * a.abs().max(b.abs()).max(1e-9)
            };
            a != b && !(Class::of(variable.kind) == Class::Real && is_near())
        };
        let element = a.iter().zip(b).position(differs)?;
        Some(quote(&variable.element_name(variable.name, element)))
    })
}

/// Reads arrays, also a second time, after a restored state, and after a reset.
pub fn values(subject: &Subject<'_>) -> Result<()> {
    let arrays = arrays(subject);
    if arrays.is_empty() {
        return Ok(());
    }
    let tolerance = subject.tolerance();
    let first = match read(&mut Run::after(subject, STEPS)?, &arrays) {
        Ok(values) => values,
        Err(error) => {
            subject.report.find(&READABLE, format!("{error:#}"));
            return Ok(());
        }
    };
    let mut run = Run::after(subject, STEPS)?;
    let before = read(&mut run, &arrays)?;
    if let Some(name) = difference(&arrays, &read(&mut run, &arrays)?, &before, 0.0) {
        let text =
            format!("{name} has another value when it is read a second time, expected the same");
        subject.report.find(&PURE_GET, text);
    }
    if run.ended || difference(&arrays, &first, &before, tolerance).is_some() {
        return Ok(()); // such as random numbers
    }
    if subject.claims(Capability::CanGetAndSetFMUstate) {
        let state = run.instance.state()?;
        run.record(STEPS)?;
        run.instance.set_state(&state)?;
        run.instance.free_state(state)?;
        if let Some(name) = difference(&arrays, &read(&mut run, &arrays)?, &before, tolerance) {
            let text = format!(
                "{name} has another value after the state was restored, expected the one with which it was saved"
            );
            subject.report.find(&STATE, text);
        }
    }
    let mut run = run.reset(subject.setup())?;
    run.initialize()?;
    for _ in 0..subject.steps.min(STEPS) {
        run.advance()?;
    }
    if let Some(name) = difference(&arrays, &read(&mut run, &arrays)?, &before, tolerance) {
        let text = format!(
            "{name} has another value after fmi3Reset and the same steps, expected that of a new instance"
        );
        subject.report.find(&RESET, text);
    }
    Ok(())
}

/// Compares the start values of arrays, and sets those of parameters in another order.
pub fn starts(subject: &Subject<'_>) -> Result<()> {
    let all = arrays(subject);
    let given = all.into_iter().filter(|(v, n)| {
        let is_exact = v.initial == Some(Initial::Exact) || v.causality == Causality::Input;
        is_exact && v.starts().len() == *n
    });
    let arrays: Vec<_> = given.collect();
    if arrays.is_empty() {
        return Ok(());
    }
    let mut run = Run::instantiate(subject, &subject.still())?;
    run.enter_initialization()?;
    for ((variable, _), values) in arrays.iter().zip(read(&mut run, &arrays)?) {
        let starts = variable.starts();
        let mut pairs = starts.iter().zip(values).enumerate();
        if let Some((element, (start, _))) =
            pairs.find(|(_, (start, bits))| !is_start(variable, *bits, start))
        {
            let name = quote(&variable.element_name(variable.name, element));
            let text = format!(
                "the start value of {name} is different in the binary, expected {} as in the XML",
                quote(start)
            );
            subject.report.find(&START, text);
        }
    }
    let parameters = |(v, _): &&Array<'_, '_>| is_real(v) && v.causality == Causality::Parameter;
    let parameters: Vec<_> = arrays.iter().filter(parameters).copied().collect();
    let mut run = Run::instantiate(subject, &subject.still())?;
    let mut expected = Values::new();
    for (variable, _) in &parameters {
        let starts = variable.starts().into_iter().rev().filter_map(real);
        let starts: Vec<f64> = starts.collect();
        if run
            .instance
            .set_float64(&[variable.reference], &starts)
            .is_err()
        {
            return Ok(());
        }
        expected.push(starts.into_iter().map(f64::to_bits).collect());
    }
    if run.enter_initialization().is_err() {
        return Ok(()); // such as breakpoints, which have an order
    }
    if let Some(name) = difference(&parameters, &read(&mut run, &parameters)?, &expected, 1e-12) {
        let text = format!(
            "{name} has another value in initialization mode, expected the one that was set before"
        );
        subject.report.find(&INPUTS_KEPT, text);
    }
    Ok(())
}

/// Whether the bits of an element are those of a start value, apart from digits that were lost.
fn is_start(variable: &ScalarVariable<'_>, bits: u64, start: &str) -> bool {
    let signed = bits.cast_signed();
    match Class::of(variable.kind) {
        Class::Real => real(start).is_none_or(|start| {
            let value = f64::from_bits(bits);
            start == value || (start - value).abs() <= 1e-6 * start.abs() || start.is_nan()
        }),
        Class::Boolean => boolean(start).is_none_or(|start| i64::from(start) == signed),
        _ => (start.parse::<i128>())
            .is_ok_and(|start| start == i128::from(signed) || start == i128::from(bits)),
    }
}

/// Passes other numbers of values than arrays have.
pub fn lengths(subject: &Subject<'_>) -> Result<()> {
    let mut accepted = Vec::new();
    for (variable, n) in arrays(subject).into_iter().take(4) {
        for wrong in [n + 1, n.saturating_sub(1)] {
            let mut run = Run::begin(subject, &subject.setup())?;
            let name = quote(variable.name);
            subject
                .report
                .stage(format!("for {wrong} values of {name}"));
            if elements(&mut run.instance, variable, wrong).is_ok() {
                accepted.push(format!("{wrong} values of {name}, which has {n}"));
            }
        }
    }
    if !accepted.is_empty() {
        let text = format!(
            "these were read with fmi3OK, expected fmi3Error: {}",
            accepted.join("; ")
        );
        subject.report.find(&ARRAY_LENGTHS, text);
    }
    Ok(())
}

/// Runs with another value of each structural parameter that its bounds allow.
pub fn sizes(subject: &Subject<'_>) -> Result<()> {
    if subject.kind == Kind::ModelExchange {
        return Ok(()); // the number of states may follow
    }
    let parameters = subject.model.variables().map(|(_, v)| v);
    for parameter in parameters.filter(|v| v.is_structural && v.kind == VariableType::UInt64) {
        if let Some(size) = other_size(parameter) {
            let name = quote(parameter.name);
            resized(subject, parameter, size)
                .map_err(|error| anyhow!("with {name} = {size}, {error:#}"))?;
        }
    }
    Ok(())
}

/// Another value within the bounds of a structural parameter, which must be in the XML.
fn other_size(parameter: &ScalarVariable<'_>) -> Option<u64> {
    let bound = |name| parameter.inherited(name).and_then(whole::<u64>);
    let start: u64 = whole(parameter.start()?)?;
    match (bound("min"), bound("max")) {
        (_, Some(max)) if start < max => Some(start + 1),
        (Some(min), _) if start > min => Some(start - 1),
        _ => None,
    }
}

fn resized(subject: &Subject<'_>, parameter: &ScalarVariable<'_>, size: u64) -> Result<()> {
    let mut run = Run::instantiate(subject, &subject.still())?;
    run.instance.enter_configuration_mode()?;
    run.instance.set_uint64(&[parameter.reference], &[size])?;
    run.instance.exit_configuration_mode()?;
    run.initialize()?;
    for _ in 0..subject.steps.min(STEPS) {
        run.advance()?;
    }
    let arrays = arrays(subject).into_iter();
    let arrays: Vec<_> = (arrays.filter_map(|(v, _)| Some((v, count(v, parameter, size)?))))
        .filter(|(_, n)| *n <= MAX_ELEMENTS)
        .collect();
    let values = read(&mut run, &arrays)?;
    for ((variable, _), values) in arrays.iter().zip(values) {
        let is_output = variable.causality == Causality::Output;
        let continuous = is_output && variable.variability == Variability::Continuous;
        let mut values = values.into_iter().map(f64::from_bits);
        ensure!(
            !continuous || !is_real(variable) || values.all(f64::is_finite),
            "{} is not finite",
            quote(variable.name)
        );
    }
    Ok(())
}

/// The number of elements with another value of a structural parameter; `None` if it has no effect.
fn count(
    variable: &ScalarVariable<'_>,
    parameter: &ScalarVariable<'_>,
    size: u64,
) -> Option<usize> {
    let dimensions = variable
        .element
        .children("Dimension")
        .zip(&variable.dimensions);
    let mut is_changed = false;
    let mut product = 1_usize;
    for (dimension, n) in dimensions {
        let reference = dimension.attribute("valueReference").and_then(unsigned);
        let is_sized = reference == Some(parameter.reference);
        is_changed |= is_sized;
        let n = if is_sized {
            usize::try_from(size).ok()?
        } else {
            *n
        };
        product = product.checked_mul(n)?;
    }
    is_changed.then_some(product)
}
