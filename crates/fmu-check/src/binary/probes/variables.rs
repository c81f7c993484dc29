//! Reading and writing variables.

use std::collections::HashMap;
use std::hint::black_box;

use anyhow::{Context, Result, ensure};
use fmu_description::value::whole;
use fmu_description::{Causality, FmiVersion, Initial, Type, Value, Variability, XmlVariable};
use fmu_file::text::quote;
use fmu_host::InterfaceType;

use crate::binary::excitation::{allows, other_value, other_values};
use crate::binary::observed::{
    MAX_ELEMENTS, Row, element_name, is_near, is_readable, is_tested, references, shown, size,
};
use crate::binary::report::check;
use crate::binary::run::Run;
use crate::binary::subject::{SKIP, Subject};
use crate::binary::task::Reply;
use crate::rule::rule;
use crate::rules::is_continuous;

/// Maximum number of variables that are reported as unreadable.
const MAX_UNREADABLE: usize = 20;
/// Steps before variables are read.
const STEPS: usize = 20;

/// Reads each variable alone after initialization. After a refusal, a new instance is used.
pub fn readable(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.still())?;
    let mut refused = 0;
    let is_dependent = |v: &&XmlVariable<'_>| v.causality != Causality::Independent;
    for variable in subject.readable().filter(is_dependent) {
        if let Err(error) = run.read(variable) {
            let report = subject.report;
            report.add_finding(rule!("readable"), format!("{error:#}"));
            report.reply(&Reply::Unreadable(variable.name.clone()));
            refused += 1;
            if refused == MAX_UNREADABLE {
                break;
            }
            run = Run::begin(subject, subject.still())?;
        }
    }
    Ok(())
}

/// Compares the start values of the XML with the values of the binary, in initialization mode and, of what the host
/// sets and of constants, after it.
pub fn start(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::initializing(subject, subject.still())?;
    let has_start = |v: &&XmlVariable<'_>| {
        let is_exact = v.initial == Some(Initial::Exact) || v.causality == Causality::Input;
        is_exact && !v.start.is_empty()
    };
    let known = subject.known_initially();
    let (initial, later): (Vec<_>, Vec<_>) = (subject.readable().filter(has_start))
        .partition(|variable| known.contains(variable.name.as_str()));
    for variable in initial {
        compare_start(&mut run, variable)?;
    }
    run.exit_initialization()?;
    // A discrete local variable may have changed at once.
    let is_kept = |v: &&XmlVariable<'_>| {
        use Variability::{Constant, Fixed, Tunable};
        v.causality == Causality::Input || matches!(v.variability, Constant | Fixed | Tunable)
    };
    for variable in later.into_iter().filter(is_kept) {
        compare_start(&mut run, variable)?;
    }
    Ok(())
}

fn compare_start(run: &mut Run<'_>, variable: &XmlVariable<'_>) -> Result<()> {
    let values = match run.read(variable) {
        Ok(values) => values,
        Err(error) => {
            let when = if run.is_initialized { "" } else { " in initialization mode" };
            run.subject.report.add_finding(rule!("readable"), format!("{error:#}{when}"));
            return Ok(());
        }
    };
    let starts = (0..).map_while(|element| variable.start_of(element));
    // A tool may have lost digits when it wrote the XML.
    let allowed = |start: &Value| (1e-6 * size(start)).max(1e-12);
    let differs = |(value, start): (&Value, &Value)| !is_near(value, start, allowed(start));
    if let Some(element) = values.iter().zip(starts).position(differs) {
        let (name, value) = (element_name(variable, element), shown(&values[element]));
        let written = variable.starts();
        let expected = quote(written.get(element).or(written.last()).unwrap_or(&""));
        let is = match variable.dimensions.is_empty() {
            true => format!("{value} in the binary"),
            false => "different in the binary".into(),
        };
        let text = format!("the start value of {name} is {is}, expected {expected} as in the XML");
        run.subject.report.add_finding(rule!("start-values"), text);
    }
    Ok(())
}

/// Reads all variables together, a second time, one by one in the opposite order, and, of Float64, together
/// in the opposite order.
pub fn get(subject: &Subject<'_>) -> Result<()> {
    let all = subject.group(subject.observed.variables().chain(subject.settable()));
    let mut run = Run::after(subject, STEPS)?;
    let time = run.time();
    let together = run.row(&all)?;
    let same = |row: Row, when: &str, like: &str| {
        all.ensure_same(&[(time, row)], &together, 0.0, [when, like])
    };
    same(all.read(&mut run.instance)?, "when it is read a second time", "")?;
    let mut alone = Vec::new();
    for variable in all.variables().rev() {
        alone.extend(run.read(variable)?.into_iter().rev());
    }
    alone.reverse();
    let like = " as when it is read with all others";
    same(alone, "when it is read alone", like)?;
    check_end_of_buffer(subject, &mut run)?;
    let mut backwards = together[0].1.clone();
    let is_real = |v: &XmlVariable<'_>| v.of_type == Type::Float64 && is_tested(v);
    let reals = all.elements().enumerate();
    let reals = reals.filter(|(_, (v, _))| is_real(v));
    let mut reals: Vec<_> = reals.map(|(at, (v, _))| (at, v.reference)).collect();
    reals.reverse();
    let references: Vec<u32> = reals.iter().map(|(_, reference)| *reference).collect();
    if !references.is_empty() {
        for ((at, _), value) in reals.into_iter().zip(run.reals(&references)?) {
            backwards[at] = Value::Float64(value);
        }
    }
    same(backwards, "when it is read together in another order", "")?;
    // Last, since values must not be read between set and step.
    check_inputs_are_not_written(subject, &mut run)
}

/// Reads Reals into a buffer that is longer than needed. FMI 3.0 passes its length.
fn check_end_of_buffer(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    const GUARD: f64 = 1.234_567_89e300;
    let variables = subject.observed.variables();
    let reals: Vec<_> = variables.filter(|v| v.of_type == Type::Float64).collect();
    let references = references(&reals);
    let n = references.len();
    if n > 0 && subject.model.version == FmiVersion::Fmi2 {
        let mut values = vec![GUARD; n + 8];
        run.instance.get_float64(&references, &mut values)?;
        check!(subject, "writes-inside": values[n..].iter().all(|value| *value == GUARD),
            "fmi2GetReal wrote more than {n} values, expected {n}");
    }
    Ok(())
}

/// Sets inputs to the values that they have, from an array that must not be written.
fn check_inputs_are_not_written(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    let references = references(&subject.reals(Causality::Input));
    if references.is_empty() || subject.interface_type == InterfaceType::ModelExchange {
        return Ok(());
    }
    let values = run.reals(&references)?;
    let expected = values.clone();
    let set = run.instance.set_float64(&references, black_box(&values));
    check!(subject, "writes-inside": set.is_err() || *black_box(&values) == expected,
        "fmi2SetReal has changed the values that were passed, expected it to read them only");
    Ok(())
}

pub fn nothing(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    ensure!(!run.ended, SKIP);
    subject.report.stage("with 0 value references and NULL");
    run.instance.get_and_set_nothing()?;
    run.advance()
}

/// Variables with the same value reference have the same value.
pub fn aliases(subject: &Subject<'_>) -> Result<()> {
    let mut first: HashMap<(Type, u32), (&XmlVariable<'_>, Vec<Value>)> = HashMap::new();
    let mut run = Run::after(subject, STEPS)?;
    for variable in subject.observed.variables() {
        let values = run.read(variable)?;
        let key = (variable.of_type, variable.reference);
        let (of, expected) = first.entry(key).or_insert((variable, values.clone()));
        for (element, (value, expected)) in values.iter().zip(expected).enumerate() {
            ensure!(
                is_near(value, expected, 0.0),
                "{} is {}, expected {} like its alias {}",
                element_name(variable, element),
                shown(value),
                shown(expected),
                element_name(of, element)
            );
        }
    }
    Ok(())
}

/// Sets parameters before initialization, and inputs in initialization mode and between steps, and reads them after the
/// initialization or the next step. Before that, hosts must not read them (FMI 2.0.5, sections 3.2.3 and 4.2.4).
pub fn kept(subject: &Subject<'_>) -> Result<()> {
    use Causality::{Input, Parameter};
    let still = subject.still();
    for together in [false, true] {
        let when = "before initialization";
        check_kept(Run::instantiate(subject, still)?, &[Parameter], when, together, |run| {
            run.enter_initialization()?;
            run.exit_initialization()
        })?;
        let when = "in initialization mode";
        let initializing = |causalities: &[Causality]| {
            let run = Run::initializing(subject, still)?;
            check_kept(run, causalities, when, together, Run::exit_initialization)
        };
        if together {
            initializing(&[Parameter, Input])?;
        }
        let is_refused = !initializing(&[Input])?;
        if is_refused || subject.interface_type == InterfaceType::ModelExchange {
            return Ok(());
        }
        let stepped = Run::stepped(subject, still)?;
        check_kept(stepped, &[Input], "between two steps", together, Run::advance)?;
    }
    Ok(())
}

/// Sets variables one by one, or all variables of a type together and to other values, and reads them once `settle` has made
/// the calls after which hosts read them; returns whether the FMU has accepted all values.
fn check_kept<'a>(
    mut run: Run<'a>,
    causalities: &[Causality],
    when: &str,
    together: bool,
    settle: impl FnOnce(&mut Run<'a>) -> Result<()>,
) -> Result<bool> {
    let subject = run.subject;
    let value = |variable: &XmlVariable<'_>| {
        let is_bounded = variable.min.is_some() || variable.max.is_some();
        let others = other_values(variable);
        let large =
            |bits: u32| Value::whole(variable.of_type, (1 << bits) + 1 + i128::from(together));
        match variable.of_type {
            // More than 16 bits, and more than the digits of a Float64.
            Type::Int32 | Type::UInt32 if !is_bounded => large(20),
            Type::Int64 | Type::UInt64 if !is_bounded => large(53),
            _ if together => others.into_iter().next_back()?.pop(),
            _ => others.into_iter().next()?.pop(),
        }
    };
    let is_set = |v: &&XmlVariable<'_>| {
        is_tested(v) && causalities.contains(&v.causality) && value(v).is_some()
    };
    let variables = subject.group(subject.settable().filter(is_set));
    let values: Row = variables.variables().filter_map(value).collect();
    let set = |run: &mut Run<'a>| -> Result<()> {
        if together {
            variables.write(&mut run.instance, &values)?;
            return Ok(());
        }
        for (variable, value) in variables.variables().zip(&values) {
            run.set(variable, std::slice::from_ref(value))?;
        }
        Ok(())
    };
    // The model may not be able to go on with this combination of values.
    if run.at_event(set).is_err() || settle(&mut run).is_err() || run.ended {
        return Ok(false);
    }
    let read = match variables.read(&mut run.instance) {
        Err(_) if causalities.contains(&Causality::Parameter) => return Ok(false),
        read => read?,
    };
    for ((variable, value), read) in variables.variables().zip(&values).zip(&read) {
        let text = || {
            let name = quote(&variable.name);
            let [read, value] = [read, value].map(shown);
            let how = if together { " with others" } else { "" };
            format!(
                "{name} is {read} after it was set to {value}{how} {when}, expected the value that was set"
            )
        };
        // A Real of FMI 2.0 may be a Float32 in the model.
        let is_rounded = |value: f64| *read == Value::Float64((value as f32).into());
        if is_near(read, value, 1e-12 * size(value)) {
            continue;
        }
        ensure!(value.as_real().is_some_and(is_rounded), "{}", text());
        subject.report.add_finding(rule!("single-precision"), text());
        return Ok(true);
    }
    Ok(true)
}

/// Sets arrays of parameters and inputs to values that differ from each other, or, if the model cannot begin with
/// those, to their start values in another order, and reads them in initialization mode.
pub fn kept_arrays(subject: &Subject<'_>) -> Result<()> {
    use Causality::{Input, Parameter};
    let is_set = |v: &&XmlVariable<'_>| {
        let is_number = v.start.iter().all(|x| x.as_real().is_some() || x.as_whole().is_some());
        let is_given = v.start.len() == 1 || v.start.len() == v.element_count();
        matches!(v.causality, Input | Parameter) && is_number && is_given
    };
    let arrays = subject.readable().filter(|v| !v.dimensions.is_empty());
    let arrays = subject.group(arrays.filter(is_set));
    let starts = |v: &XmlVariable<'_>| {
        (0..v.element_count()).filter_map(|k| v.start_of(k).cloned()).collect()
    };
    let distinct = |v: &XmlVariable<'_>| -> Vec<Value> {
        let starts: Vec<Value> = starts(v);
        let changed = |(k, start): (usize, &Value)| {
            let other = match start.as_real() {
                Some(x) => Value::real(v.of_type, x + 0.01 * (k + 1) as f64),
                None => Value::whole(v.of_type, start.as_whole()? + 1 + k as i128 % 7),
            };
            other.filter(|other| allows(v, other))
        };
        let changed = |(k, start)| changed((k, start)).unwrap_or_else(|| start.clone());
        starts.iter().enumerate().map(changed).collect()
    };
    let reversed = |v: &XmlVariable<'_>| -> Vec<Value> {
        let mut starts: Vec<Value> = starts(v);
        starts.reverse();
        starts
    };
    let rows: [Row; 2] = [
        arrays.variables().flat_map(distinct).collect(),
        arrays.variables().flat_map(reversed).collect(),
    ];
    for row in rows {
        let mut run = Run::instantiate(subject, subject.still())?;
        // Such as breakpoints, which have an order.
        if arrays.write(&mut run.instance, &row).is_ok() && run.enter_initialization().is_ok() {
            let (read, how) =
                (run.row(&arrays)?, ["in initialization mode", " as it was set before"]);
            return arrays.ensure_same(&read, &[(run.time(), row)], 1e-12, how);
        }
    }
    Ok(())
}

/// Compares outputs in initialization mode with those after it, at the same time.
pub fn initial_outputs(subject: &Subject<'_>) -> Result<()> {
    let listed = subject.model.initial_unknowns.iter();
    let listed = listed.filter_map(|unknown| subject.model.variable(unknown.index));
    let listed = listed.filter(|v| {
        let is_output = v.causality == Causality::Output && is_readable(v);
        is_output && v.of_type == Type::Float64 && is_continuous(v)
    });
    let listed = subject.group(listed);
    let mut run = Run::initializing(subject, subject.still())?;
    run.change(subject.reals(Causality::Input).into_iter())?;
    let before = run.row(&listed)?;
    run.instance.exit_initialization_mode()?;
    let (after, how) = (run.row(&listed)?, ["in initialization mode", " as after it"]);
    listed.ensure_same(&before, &after, subject.tolerance, how)
}

/// Sets tunable parameters between two steps, to the values that they have.
pub fn tunable(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::stepped(subject, subject.setup())?;
    let parameters = subject.variables(Causality::Parameter);
    let tunable: Vec<_> = parameters.filter(|v| v.variability == Variability::Tunable).collect();
    let values: Vec<_> =
        tunable.iter().map(|variable| run.read(variable)).collect::<Result<_>>()?;
    run.at_event(|run| {
        for (variable, values) in tunable.iter().zip(values) {
            let set = run.set(variable, &values);
            let name = quote(&variable.name);
            set.with_context(|| format!("{name} is tunable, but between two steps"))?;
        }
        Ok(())
    })?;
    run.advance()
}

/// The strings of an instance stay when another instance sets and gets its own.
pub fn strings_of_instances(subject: &Subject<'_>) -> Result<()> {
    let is_string = |v: &&XmlVariable<'_>| v.of_type == Type::String;
    let readable = subject.observed.variables().filter(is_string);
    let references: Vec<u32> = readable.map(|v| v.reference).collect();
    if references.is_empty() {
        return Ok(());
    }
    let n = references.len();
    let mut one = Run::begin(subject, subject.setup())?;
    let mut two = Run::instantiate(subject, subject.other())?;
    two.change(subject.variables(Causality::Parameter).filter(is_string))?;
    // A String may have a meaning, such as a file name, and other values may be refused.
    two.initialize().ok().context(SKIP)?;
    one.advance()?;
    let (_, expected) = one.instance.get_string(&references, n)?;
    let stage = "after strings of another instance were read";
    subject.report.stage(stage);
    let (_, late) = one.instance.get_string_late(&references, n, || {
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
    let is_size = |v: &&XmlVariable<'_>| {
        v.causality == Causality::StructuralParameter && v.of_type == Type::UInt64
    };
    let parameters = subject.model.variables().map(|(_, v)| v);
    for parameter in parameters.filter(is_size) {
        let bounds = [&parameter.min, &parameter.max];
        let is_bounded = bounds.iter().any(|bound| bound.is_some());
        if let Some(size) = other_value(parameter).filter(|_| is_bounded) {
            let name = quote(&parameter.name);
            let run = resized(subject, parameter, &size);
            run.map_err(|error| anyhow::anyhow!("with {name} = {size}, {error:#}"))?;
        }
    }
    Ok(())
}

fn resized(subject: &Subject<'_>, parameter: &XmlVariable<'_>, size: &Value) -> Result<()> {
    let mut run = Run::instantiate(subject, subject.still())?;
    run.instance.enter_configuration_mode()?;
    run.set(parameter, std::slice::from_ref(size))?;
    run.instance.exit_configuration_mode()?;
    run.initialize()?;
    run.advance_by(subject.task.steps.min(STEPS))?;
    let arrays = subject.readable().filter_map(|v| Some((v, resized_count(v, parameter, size)?)));
    for (variable, n) in arrays.filter(|(_, n)| *n <= MAX_ELEMENTS) {
        let values = run.read_elements(variable, n)?;
        let is_output = variable.causality == Causality::Output;
        let continuous = is_output && is_continuous(variable);
        let is_finite = |value: &Value| value.as_real().is_none_or(f64::is_finite);
        ensure!(
            !continuous || values.iter().all(is_finite),
            "{} is not finite",
            quote(&variable.name)
        );
    }
    let mut run = run.reset()?;
    run.enter_initialization()?;
    let (value, start) = (run.value(parameter)?, parameter.start_of(0));
    check!(subject, "reset": start.is_none_or(|start| value == *start),
        "after fmi3Reset, {} is {value}, expected its start value", quote(&parameter.name));
    Ok(())
}

/// The number of elements with another value of a structural parameter; `None` if it has no effect.
fn resized_count(
    variable: &XmlVariable<'_>,
    parameter: &XmlVariable<'_>,
    size: &Value,
) -> Option<usize> {
    let mut dimensions = variable.dimensions.clone();
    for (dimension, n) in variable.element.children("Dimension").zip(&mut dimensions) {
        let reference = dimension.attribute("valueReference").and_then(whole);
        if reference == Some(parameter.reference) {
            *n = usize::try_from(size.as_whole()?).ok()?;
        }
    }
    let is_changed = dimensions != variable.dimensions;
    let product = dimensions.iter().try_fold(1_usize, |product, n| product.checked_mul(*n));
    product.filter(|_| is_changed)
}
