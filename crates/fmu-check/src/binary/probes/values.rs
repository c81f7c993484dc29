//! Reading and writing variables; derivatives, dependencies and events.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::hint::black_box;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value::whole;
use fmu_description::{
    Causality, FmiVersion, Initial, Type, Unknown, Value, Variability, XmlVariable,
};
use fmu_file::text::quote;
use fmu_host::{Instance, InterfaceType};

use super::regions::output_derivatives;
use crate::binary::Reply;
use crate::binary::run::{Run, SKIP, Subject, check, is_discrete};
use crate::binary::values::{
    MAX_ELEMENTS, Observed, Row, allows, element_name, is_near, is_readable, is_tested, other,
    others, real_range, references, shown, size, starts,
};
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
            report.find(rule!("readable"), format!("{error:#}"));
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
            run.subject.report.find(rule!("readable"), format!("{error:#}{when}"));
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
        run.subject.report.find(rule!("start-values"), text);
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
    guarded(subject, &mut run)?;
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
    unwritten(subject, &mut run)
}

/// Reads Reals into a buffer that is longer than needed. FMI 3.0 passes its length.
fn guarded(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
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
fn unwritten(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
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
        are_kept(Run::instantiate(subject, still)?, &[Parameter], when, together, |run| {
            run.enter_initialization()?;
            run.exit_initialization()
        })?;
        let when = "in initialization mode";
        let initializing = |causalities: &[Causality]| {
            let run = Run::initializing(subject, still)?;
            are_kept(run, causalities, when, together, Run::exit_initialization)
        };
        if together {
            initializing(&[Parameter, Input])?;
        }
        let is_refused = !initializing(&[Input])?;
        if is_refused || subject.interface_type == InterfaceType::ModelExchange {
            return Ok(());
        }
        let stepped = Run::stepped(subject, still)?;
        are_kept(stepped, &[Input], "between two steps", together, Run::advance)?;
    }
    Ok(())
}

/// Sets variables one by one, or those of a type together and to other values, and reads them once `settle` has made
/// the calls after which hosts read them; returns whether the FMU has accepted all values.
fn are_kept<'a>(
    mut run: Run<'a>,
    causalities: &[Causality],
    when: &str,
    together: bool,
    settle: impl FnOnce(&mut Run<'a>) -> Result<()>,
) -> Result<bool> {
    let subject = run.subject;
    let value = |variable: &XmlVariable<'_>| {
        let is_bounded = variable.min.is_some() || variable.max.is_some();
        let others = others(variable);
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
        subject.report.find(rule!("single-precision"), text());
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
        if let Some(size) = other(parameter).filter(|_| is_bounded) {
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
    let arrays = subject.readable().filter_map(|v| Some((v, count(v, parameter, size)?)));
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
fn count(variable: &XmlVariable<'_>, parameter: &XmlVariable<'_>, size: &Value) -> Option<usize> {
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

/// Maximum number of inputs whose effects are tested.
pub const MAX_INPUTS: usize = 100;
/// Steps before the inputs of a run are changed.
const WARM_UP: usize = 15;

/// What is allowed to depend directly on what, by the XML.
pub struct Dependencies<'a>(HashMap<&'a str, HashSet<&'a str>>);

impl<'a> Dependencies<'a> {
    fn of<'b>(subject: &Subject<'a>, unknowns: impl Iterator<Item = &'b Unknown<'a>>) -> Self
    where
        'a: 'b,
    {
        let model = subject.model;
        let name = |number: &u32| Some(model.variable(model.index(*number))?.name.as_str());
        let outputs = unknowns.filter_map(|unknown| {
            let inputs = unknown.dependencies.as_ref()?.iter();
            let output = model.variable(unknown.index)?;
            Some((output.name.as_str(), inputs.filter_map(name).collect()))
        });
        Self(outputs.collect())
    }

    /// Those of outputs and derivatives of states, after initialization.
    fn in_run(subject: &Subject<'a>) -> Self {
        Self::of(subject, subject.model.outputs.iter().chain(&subject.model.derivatives))
    }

    fn allow(&self, output: &XmlVariable<'_>, input: &XmlVariable<'_>) -> bool {
        let listed = self.0.get(output.name.as_str());
        listed.is_none_or(|listed| listed.contains(input.name.as_str()))
    }
}

/// The unknowns when a known is changed from its value by this much, which is then changed back; the test ends if the
/// FMU refuses that, which is no derivative. If the known is the state of this index, the derivatives are the first
/// unknowns.
fn moved(
    run: &mut Run<'_>,
    (known, state, value): (&XmlVariable<'_>, Option<usize>, f64),
    change: f64,
    unknowns: &[u32],
) -> Result<Vec<f64>> {
    let Some(k) = state else {
        let known = [known.reference];
        run.instance.set_float64(&known, &[value + change]).ok().context(SKIP)?;
        let after = run.reals(unknowns).ok().context(SKIP)?;
        run.instance.set_float64(&known, &[value]).ok().context(SKIP)?;
        return Ok(after);
    };
    let states = run.continuous_states()?;
    let mut moved = states.clone();
    moved[k] += change;
    run.instance.set_continuous_states(&moved)?;
    let mut after = run.derivatives().ok().context(SKIP)?;
    after.extend(run.reals(&unknowns[states.len()..]).ok().context(SKIP)?);
    run.instance.set_continuous_states(&states)?;
    Ok(after)
}

/// A directional derivative of scalars.
fn directional(
    run: &mut Run<'_>,
    unknowns: &[u32],
    knowns: &[u32],
    seed: &[f64],
) -> Result<Vec<f64>> {
    let get = |i: &mut Instance, values: &mut [f64]| {
        i.get_directional_derivative(unknowns, knowns, seed, values)
    };
    Ok(run.instance.read(unknowns.len(), get)?)
}

/// A known, and its index if it is a state.
pub type Known<'a> = (&'a XmlVariable<'a>, Option<usize>);

/// Compares the directional derivatives of all pairs that the XML lists with difference quotients, and those for a
/// seed with several elements with their sum; returns whether there is a pair.
pub fn compare_all(
    run: &mut Run<'_>,
    unknowns: &[&XmlVariable<'_>],
    knowns: &[Known<'_>],
    allowed: &Dependencies<'_>,
) -> Result<bool> {
    let mut rows: BTreeMap<u32, Vec<(u32, f64)>> = BTreeMap::new();
    // All at first, as hosts must not read between set and step.
    let value = |(known, _): &Known<'_>| run.setting(known)?.pop().context(SKIP);
    let values: Vec<Value> = knowns.iter().map(value).collect::<Result<_>>()?;
    for (known, value) in knowns.iter().zip(values.iter().filter_map(Value::as_real)) {
        // All derivatives belong to a state.
        let is_pair = |u: &&&XmlVariable<'_>| known.1.is_some() || allowed.allow(u, known.0);
        let unknowns: Vec<_> = unknowns.iter().filter(is_pair).copied().collect();
        if !unknowns.is_empty() {
            let given = compare(run, &unknowns, *known, value)?;
            for (unknown, given) in unknowns.iter().zip(given) {
                rows.entry(unknown.reference).or_default().push((known.0.reference, given));
            }
        }
    }
    for (unknown, row) in &rows {
        let (knowns, given): (Vec<u32>, Vec<f64>) = row.iter().copied().unzip();
        let seed: Vec<f64> = (2..).map(f64::from).take(row.len()).collect();
        let terms = given.iter().zip(&seed).map(|(given, seed)| given * seed);
        let (expected, scale) = terms.fold((0.0, 1e-9), |(sum, size), x| (sum + x, size + x.abs()));
        let value = directional(run, &[*unknown], &knowns, &seed)?[0];
        ensure!(
            (value - expected).abs() <= 2.0 * NUMERICAL * scale,
            "the directional derivative of value reference {unknown} for the seed {seed:?} is {value}, expected {expected}, the sum of those for unit vectors"
        );
    }
    Ok(!rows.is_empty())
}

/// The relative error of derivatives that is allowed, since FMUs may compute them by differences, too.
const NUMERICAL: f64 = 5e-2;

/// Compares a directional derivative with difference quotients to both sides of a value, within the bounds of the XML.
fn compare(
    run: &mut Run<'_>,
    unknowns: &[&XmlVariable<'_>],
    (known, state): Known<'_>,
    value: f64,
) -> Result<Vec<f64>> {
    const CHANGES: [f64; 2] = [1e-4, 1e-5];
    /// The relative error of values with many terms.
    const ROUNDING: f64 = 1e-13;
    /// Where the function is smooth, quotients differ less, relative to the largest.
    const SMOOTH: f64 = 1e-2;
    let (all, (min, max)) = (references(unknowns), real_range(known));
    let all_given = directional(run, &all, &[known.reference], &[1.0])?;
    let mut measure = |change: f64| moved(run, (known, state, value), change, &all);
    let before = measure(0.0)?;
    // For each size of the change, to both sides.
    let mut quotients = [Vec::new(), Vec::new()];
    for (size, measured) in CHANGES.iter().zip(&mut quotients) {
        for change in [*size, -size].map(|change| change * value.abs().max(1.0)) {
            if (min..=max).contains(&(value + change)) {
                measured.push((change, measure(change)?));
            }
        }
    }
    for (i, unknown) in unknowns.iter().enumerate() {
        let slope = |(change, after): &(f64, Vec<f64>)| (after[i] - before[i]) / change;
        let slopes = quotients.each_ref().map(|all| all.iter().map(slope).collect::<Vec<_>>());
        let [coarse, fine] = slopes.each_ref().map(|s| s.iter().sum::<f64>() / s.len() as f64);
        let (given, of, by) = (all_given[i], quote(&unknown.name), quote(&known.name));
        ensure!(
            given.is_finite(),
            "the directional derivative of {of} with respect to {by} is {given}, expected a finite number"
        );
        let mut both = slopes.iter().flatten();
        // In co-simulation, an output may follow an input only after the next step.
        if both.all(|slope| *slope == 0.0)
            && run.subject.interface_type == InterfaceType::CoSimulation
        {
            continue;
        }
        let scale = coarse.abs().max(fine.abs()).max(given.abs());
        // It is not at a kink, at a jump, nor where rounding prevails.
        let rounding = ROUNDING * before[i].abs() / (CHANGES[1] * value.abs().max(1.0));
        let is_smooth = (coarse - fine).abs() <= SMOOTH * scale
            && slopes[1].iter().all(|slope| (slope - fine).abs() <= SMOOTH * scale)
            && rounding <= SMOOTH * scale;
        ensure!(
            !is_smooth || scale < 1e-6 || (given - fine).abs() <= NUMERICAL * scale,
            "the directional derivative of {of} with respect to {by} is {given}, but {of} changes by {fine} per unit"
        );
    }
    Ok(all_given)
}

/// The unknowns and knowns of directional derivatives after initialization.
pub fn in_run<'a>(
    subject: &Subject<'a>,
) -> (Vec<&'a XmlVariable<'a>>, Vec<Known<'a>>, Dependencies<'a>) {
    let (mut unknowns, mut states) = state_pairs(subject).unwrap_or_default();
    unknowns.extend(subject.continuous(Causality::Output));
    if subject.interface_type == InterfaceType::CoSimulation {
        states.clear();
    }
    let states = (0..).zip(states).map(|(k, state)| (state, Some(k)));
    let inputs = subject.continuous(Causality::Input).into_iter().map(|input| (input, None));
    let knowns: Vec<Known<'_>> = states.chain(inputs.take(MAX_INPUTS)).collect();
    (unknowns, knowns, Dependencies::in_run(subject))
}

/// Compares directional derivatives of outputs, and of derivatives of states, with difference quotients: at two times,
/// and in event mode.
pub fn derivatives_in_run(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = in_run(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    let is_called = compare_all(&mut run, &unknowns, &knowns, &allowed)?;
    run.advance_by(subject.task.steps)?;
    if is_called && !run.ended {
        compare_all(&mut run, &unknowns, &knowns, &allowed)?;
    }
    if is_called && subject.claims("hasEventMode") {
        let setup = subject.setup().with(|s| s.event_mode = true);
        let mut run = Run::begin(subject, setup)?;
        run.advance_by(subject.task.steps.min(WARM_UP))?;
        run.instance.enter_event_mode()?;
        subject.report.stage("in event mode");
        compare_all(&mut run, &unknowns, &knowns, &allowed)?;
    }
    Ok(())
}

/// Compares directional derivatives in initialization mode with difference quotients, for the pairs that the XML lists.
pub fn derivatives_in_initialization(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = initial_pairs(subject);
    let mut run = Run::initializing(subject, subject.still())?;
    subject.report.stage("in initialization mode");
    compare_all(&mut run, &unknowns, &knowns, &allowed).map(drop)
}

/// The Float64 unknowns of the initialization whose dependencies the XML lists, and what a host may set then.
fn initial_pairs<'a>(
    subject: &Subject<'a>,
) -> (Vec<&'a XmlVariable<'a>>, Vec<Known<'a>>, Dependencies<'a>) {
    let model = subject.model;
    let is_real = |v: &&XmlVariable<'_>| v.of_type == Type::Float64 && is_tested(v);
    let listed = model.initial_unknowns.iter().filter(|unknown| unknown.dependencies.is_some());
    let unknowns = listed.filter_map(|unknown| model.variable(unknown.index).filter(is_real));
    let knowns = subject.settable().filter(is_real).map(|v| (v, None)).take(MAX_INPUTS);
    let allowed = Dependencies::of(subject, model.initial_unknowns.iter());
    (unknowns.collect(), knowns.collect(), allowed)
}

/// Asks for directional derivatives of pairs that the XML does not list: 0, or an error.
pub fn unlisted_derivatives(subject: &Subject<'_>) -> Result<()> {
    let allowed = Dependencies::in_run(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    for input in subject.continuous(Causality::Input).into_iter().take(MAX_INPUTS) {
        for output in subject.continuous(Causality::Output) {
            if allowed.allow(output, input) {
                continue;
            }
            let (of, by) = ([output.reference], [input.reference]);
            let given = directional(&mut run, &of, &by, &[1.0]).ok().context(SKIP)?[0];
            ensure!(
                given.abs() < 1e-12,
                "the directional derivative of {} with respect to {}, which its dependencies do not list, is {given}, expected 0",
                quote(&output.name),
                quote(&input.name)
            );
        }
    }
    Ok(())
}

/// The derivatives of the states, and the states, if all are scalars that are tested.
pub type Pairs<'a> = (Vec<&'a XmlVariable<'a>>, Vec<&'a XmlVariable<'a>>);

pub fn state_pairs<'a>(subject: &Subject<'a>) -> Option<Pairs<'a>> {
    let model = subject.model;
    let is_tested = |v: &&XmlVariable<'_>| v.of_type == Type::Float64 && is_tested(v);
    let pairs = model.derivatives.iter().map(|unknown| {
        let derivative = model.variable(unknown.index).filter(is_tested)?;
        let state = model.referred(derivative.value, "derivative").filter(is_tested)?;
        Some((derivative, state))
    });
    let pairs: Option<Pairs<'_>> = pairs.collect();
    pairs.filter(|(states, _)| (1..=MAX_INPUTS).contains(&states.len()))
}

/// Compares adjoint derivatives with directional ones.
pub fn adjoint_derivatives(subject: &Subject<'_>) -> Result<()> {
    ensure!(subject.claims("providesDirectionalDerivative"), SKIP);
    let mut run = Run::after(subject, WARM_UP)?;
    let allowed = Dependencies::in_run(subject);
    let mut inputs = subject.continuous(Causality::Input);
    inputs.truncate(MAX_INPUTS);
    let outputs = subject.continuous(Causality::Output);
    for output in outputs.iter().take(MAX_INPUTS) {
        let known = inputs.iter().copied().filter(|i| allowed.allow(output, i));
        compare_adjoint(&mut run, output, &known.collect::<Vec<_>>())?;
    }
    if let Some((derivatives, states)) = state_pairs(subject)
        && subject.interface_type == InterfaceType::ModelExchange
    {
        for derivative in derivatives {
            compare_adjoint(&mut run, derivative, &states)?;
        }
    }
    Ok(())
}

/// Compares the adjoint derivative of a variable with its directional derivatives.
fn compare_adjoint(
    run: &mut Run<'_>,
    of: &XmlVariable<'_>,
    knowns: &[&XmlVariable<'_>],
) -> Result<()> {
    const SEED: f64 = 2.0;
    if knowns.is_empty() {
        return Ok(());
    }
    let (unknowns, all) = ([of.reference], references(knowns));
    let get = |i: &mut Instance, values: &mut [f64]| {
        i.get_adjoint_derivative(&unknowns, &all, &[SEED], values)
    };
    let row = run.instance.read(knowns.len(), get)?;
    for (known, adjoint) in knowns.iter().zip(row.iter().map(|adjoint| adjoint / SEED)) {
        let directional = directional(run, &unknowns, &[known.reference], &[1.0])?[0];
        let scale = adjoint.abs().max(directional.abs()).max(1e-9);
        ensure!(
            (adjoint - directional).abs() <= 1e-6 * scale,
            "the adjoint derivative of {} by {} is {adjoint}, expected {directional} like the directional derivative",
            quote(&of.name),
            quote(&known.name)
        );
    }
    Ok(())
}

/// Changes each input, and looks for outputs that follow though the XML says that they do not, at two times.
pub fn dependencies(subject: &Subject<'_>) -> Result<()> {
    let has_events =
        subject.interface_type == InterfaceType::ModelExchange || subject.setup().event_mode;
    let is_known =
        |v: &&XmlVariable<'_>| v.of_type != Type::String && (!has_events || is_continuous(v));
    let mut inputs: Vec<_> = subject.variables(Causality::Input).filter(is_known).collect();
    // The first that the FMU refuses to change ends the test.
    inputs.sort_by_key(|v| !v.of_type.is_float());
    let outputs = subject.group(subject.variables(Causality::Output));
    let allowed = Dependencies::in_run(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    follow(&mut run, &outputs, &inputs, &allowed)?;
    run.advance_by(subject.task.steps)?;
    ensure!(!run.ended, SKIP);
    follow(&mut run, &outputs, &inputs, &allowed)
}

/// As [`dependencies`], in initialization mode, also with parameters.
pub fn initial_dependencies(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = initial_pairs(subject);
    let knowns: Vec<_> = knowns.into_iter().map(|(known, _)| known).collect();
    let mut run = Run::initializing(subject, subject.still())?;
    subject.report.stage("in initialization mode");
    follow(&mut run, &subject.group(unknowns.into_iter()), &knowns, &allowed)
}

/// Changes each known, and checks that only unknowns that may depend on it follow. An error, such as that of an
/// assertion, is no dependency, and ends the test.
fn follow(
    run: &mut Run<'_>,
    unknowns: &Observed<'_>,
    knowns: &[&XmlVariable<'_>],
    allowed: &Dependencies<'_>,
) -> Result<()> {
    let knowns = &knowns[..knowns.len().min(MAX_INPUTS)];
    // All at first, as hosts must not read between set and step.
    let values = |known: &&XmlVariable<'_>| run.setting(known);
    let values: Vec<_> = knowns.iter().map(values).collect::<Result<_>>()?;
    for (known, values) in knowns.iter().zip(values) {
        let moved = values.iter().map(|value| {
            let x = value.as_real()?;
            Value::real(known.of_type, x + 0.1 * x.abs().max(1.0))
        });
        let changed = moved.collect::<Option<Vec<Value>>>().or_else(|| {
            let mut all = others(known).into_iter().chain(starts(known));
            all.find(|others| others.iter().zip(&values).any(|(a, b)| !is_near(a, b, 0.0)))
        });
        let Some(changed) = changed else { continue };
        let mut row = |values: &[Value]| -> Result<Row> {
            run.set(known, values).ok().context(SKIP)?;
            unknowns.read(&mut run.instance).ok().context(SKIP)
        };
        let (before, after, again) = (row(&values)?, row(&changed)?, row(&values)?);
        for ((unknown, _), ((before, after), again)) in
            unknowns.elements().zip(before.iter().zip(&after).zip(&again))
        {
            ensure!(
                is_near(before, after, noise(before, again))
                    || unknown.reference == known.reference
                    || allowed.allow(unknown, known)
                    || before.as_real().is_none() && !is_near(before, again, 0.0),
                "{} changes from {} to {} with {}, which its dependencies do not list",
                quote(&unknown.name),
                shown(before),
                shown(after),
                quote(&known.name)
            );
        }
    }
    Ok(())
}

/// How much a value may change without a cause: by rounding, by the error of an iteration, and by itself, as the time
/// that the FMU has used, which another value for the same inputs shows.
fn noise(value: &Value, again: &Value) -> f64 {
    let by_itself = match (value.as_real(), again.as_real()) {
        (Some(value), Some(again)) => (value - again).abs(),
        _ => 0.0,
    };
    (1e-8 * size(value)).max(1e-12) + 10.0 * by_itself
}

/// Passes derivatives of inputs: an input that changes by 1 during a step must show where an input that is 1
/// higher does.
pub fn derivatives_of_inputs_in_time(subject: &Subject<'_>) -> Result<()> {
    let inputs = references(&subject.reals(Causality::Input));
    if inputs.is_empty() {
        return Ok(());
    }
    let orders = vec![1; inputs.len()];
    let stepped = |change: f64, derivative: f64| -> Result<_> {
        let mut run = Run::after(subject, WARM_UP)?;
        if change == 0.0 {
            let values = vec![derivative / subject.step; inputs.len()];
            run.instance.set_input_derivatives(&inputs, &orders, &values)?;
        } else {
            let values: Vec<f64> = run.reals(&inputs)?.iter().map(|u| u + change).collect();
            let set = run.instance.set_float64(&inputs, &values);
            set.ok().context(SKIP)?;
        }
        run.instance.do_step(run.time(), subject.step)?;
        Ok(vec![(run.time(), run.observe()?)])
    };
    let (still, rising) = (stepped(0.0, 0.0)?, stepped(0.0, 1.0)?);
    let higher = stepped(1.0, 0.0)?;
    let differs = |run: &[(f64, Row)]| {
        let same = (subject.observed).ensure_same(run, &still, subject.tolerance, [""; 2]);
        same.is_err()
    };
    ensure!(differs(&rising) || !differs(&higher), "derivatives of inputs have no effect");
    Ok(())
}

/// What the FMU declares, if derivatives of outputs are tested.
pub const OUTPUT_DERIVATIVES: &str = "maxOutputDerivativeOrder is not 0, but";

/// Compares derivatives of outputs with their changes, at the start and later, with inputs that do not change.
pub fn derivatives_of_outputs_in_time(subject: &Subject<'_>) -> Result<()> {
    let order = subject.element.attribute("maxOutputDerivativeOrder");
    let outputs = subject.continuous(Causality::Output);
    if order.and_then(whole::<i32>).is_none_or(|order| order <= 0) || outputs.is_empty() {
        return Ok(());
    }
    let mut run = Run::begin(subject, subject.still())?;
    for steps in [0, subject.task.steps] {
        run.advance_by(steps)?;
        ensure!(!run.ended, SKIP);
        compare_slopes(&mut run, &outputs).context(OUTPUT_DERIVATIVES)?;
    }
    output_derivatives(subject, &outputs)
}

/// Compares derivatives of outputs with their changes in a few steps.
pub fn compare_slopes(run: &mut Run<'_>, outputs: &[&XmlVariable<'_>]) -> Result<()> {
    let subject = run.subject;
    let (references, orders) = (references(outputs), vec![1; outputs.len()]);
    let (mut given, mut values) = (Vec::new(), Vec::new());
    for _ in 0..subject.task.steps.min(10) {
        let get = |i: &mut Instance, values: &mut [f64]| {
            i.get_output_derivatives(&references, &orders, values)
        };
        let now = run.instance.read(outputs.len(), get)?;
        ensure!(
            now.iter().all(|value| value.is_finite()),
            "fmi2GetRealOutputDerivatives gave numbers that are not finite"
        );
        given.push(now);
        values.push(run.reals(&references)?);
        run.advance()?;
        if run.ended {
            break;
        }
    }
    for (i, output) in outputs.iter().enumerate() {
        let slopes = values.windows(2).map(|row| (row[1][i] - row[0][i]) / subject.step);
        let judged = given.iter().skip(1).map(|given| given[i]).zip(slopes);
        let wrong = judged.clone().filter(|(given, slope)| {
            let scale = slope.abs().max(given.abs());
            (slope - given).abs() > 0.8 * scale && scale > 1e-6
        });
        // Outputs that jump have other slopes now and then.
        if let Some((given, slope)) = wrong.clone().last()
            && wrong.count() == judged.count().max(3)
        {
            let name = quote(&output.name);
            bail!(
                "the derivative of {name} is {given} while the output changes by {slope} per second"
            );
        }
    }
    Ok(())
}

/// What is read twice is the same, and derivatives belong to the states.
pub fn events(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    let [first, second] = [run.event_indicators()?, run.event_indicators()?];
    ensure!(
        first.iter().all(|z| z.is_finite()),
        "fmi2GetEventIndicators gave {first:?}, expected finite numbers"
    );
    ensure!(
        first == second,
        "fmi2GetEventIndicators gave {second:?} when called again, expected {first:?} as before"
    );
    if subject.states == 0 {
        return Ok(());
    }
    run.advance_by(subject.task.steps.min(WARM_UP))?;
    ensure!(!run.ended, SKIP);
    let states = run.continuous_states()?;
    let before = run.derivatives()?;
    let moved: Vec<f64> = states.iter().map(|x| x + 1e-6 * x.abs().max(1.0)).collect();
    run.instance.set_continuous_states(&moved)?;
    let read = run.continuous_states()?;
    ensure!(
        read == moved,
        "fmi2GetContinuousStates gave {read:?}, expected {moved:?} as they were set"
    );
    run.derivatives()?;
    run.instance.set_continuous_states(&states)?;
    let after = run.derivatives()?;
    ensure!(
        are_near(&before, &after),
        "fmi2GetDerivatives gave {after:?}, expected {before:?} as for the same states before"
    );
    continuous_time(subject, &mut run)
}

fn are_near(a: &[f64], b: &[f64]) -> bool {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9 * a.abs().max(1e-9) || a.is_nan();
    a.iter().zip(b).all(near)
}

/// Compares the numbers of states and event indicators with the XML, and, along a run, states and derivatives with their
/// variables.
pub fn states(subject: &Subject<'_>) -> Result<()> {
    let (n, indicators) = (subject.states, subject.indicators);
    let mut run = Run::after(subject, 1)?;
    if subject.model.version == FmiVersion::Fmi3 {
        let mut counted = [0; 2];
        run.instance.get_number_of_continuous_states(&mut counted[0])?;
        run.instance.get_number_of_event_indicators(&mut counted[1])?;
        check!(subject, "states-counted": counted == [n, indicators],
            "the binary has {} states and {} event indicators, expected {n} and {indicators}",
            counted[0], counted[1]);
    }
    written(&mut run, "fmi2GetContinuousStates", n, Instance::get_continuous_states)?;
    written(&mut run, "fmi2GetDerivatives", n, Instance::get_continuous_state_derivatives)?;
    written(&mut run, "fmi2GetEventIndicators", indicators, Instance::get_event_indicators)?;
    let Some((derivatives, states)) = state_pairs(subject) else { return Ok(()) };
    for (state, nominal) in states.iter().zip(run.solver.nominals.clone()) {
        let expected = state.value.real("nominal").unwrap_or(nominal);
        check!(subject, "nominals":
            run.solver.has_new_nominals || (nominal - expected).abs() <= 1e-6 * expected.abs(),
            "the nominal value of {} is {nominal}, expected {expected} as in the XML", quote(&state.name));
    }
    let (derivatives, states) = (references(&derivatives), references(&states));
    for _ in 0..subject.task.steps {
        for (function, given, expected) in [
            ("fmi2GetContinuousStates", run.continuous_states()?, run.reals(&states)?),
            ("fmi2GetDerivatives", run.derivatives()?, run.reals(&derivatives)?),
        ] {
            let time = run.time();
            ensure!(
                are_near(&given, &expected),
                "{function} gave {given:?} at t = {time} s, expected {expected:?} like the variables"
            );
        }
        run.advance()?;
        if run.ended {
            break;
        }
    }
    Ok(())
}

/// Checks that a function writes as many numbers as the XML lists.
fn written(
    run: &mut Run<'_>,
    function: &str,
    n: usize,
    get: impl FnOnce(&mut Instance, &mut [f64]) -> fmu_host::Result,
) -> Result<()> {
    const GUARD: f64 = 1.234_567_89e300;
    let mut values = vec![GUARD; n + 8];
    if n > 0 {
        get(&mut run.instance, &mut values[..n])?;
        let count = black_box(&values).iter().filter(|value| **value != GUARD).count();
        check!(run.subject, "states-counted": count == n, "{function} wrote {count} numbers, expected {n}");
    }
    Ok(())
}

/// What must hold in continuous-time mode: solvers go back in time, derivatives follow the inputs at
/// once, and discrete variables do not change.
fn continuous_time(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    let discrete = subject.group(subject.observed.variables().filter(|v| is_discrete(v)));
    let (time, step) = (run.time(), subject.step);
    let before = run.row(&discrete)?;
    let later = time + 0.1 * step;
    run.instance.set_time(later)?;
    for variable in subject.variables(Causality::Independent) {
        let read = run.value(variable).unwrap_or(Value::Float64(later));
        ensure!(
            is_near(&read, &Value::Float64(later), 1e-9 * later.abs().max(1.0)),
            "{} is {} after fmi2SetTime({later})",
            quote(&variable.name),
            shown(&read)
        );
    }
    let states = run.continuous_states()?;
    run.instance.set_continuous_states(&states)?;
    run.derivatives()?;
    let after = run.row(&discrete)?;
    let how = ["in continuous-time mode, not at an event", " as before"];
    discrete.ensure_same(&after, &before, 0.0, how)?;
    run.instance
        .set_time(time + 0.05 * step)
        .context("solvers go back in time when they reject a step, but")?;
    run.change(subject.continuous(Causality::Input).into_iter())?;
    let at_once = run.derivatives()?;
    if run.instance.completed_integrator_step()?.enter_event_mode {
        return Ok(());
    }
    let later = run.derivatives()?;
    ensure!(
        are_near(&at_once, &later),
        "fmi2GetDerivatives gave {at_once:?} after the inputs were set, expected {later:?} as after fmi2CompletedIntegratorStep"
    );
    Ok(())
}
