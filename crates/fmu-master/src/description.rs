//! The description of a system in a TOML file: components, connections, order, experiment, start values; and
//! the line that an error is about.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Error, Result, anyhow, ensure};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use fmu_description::{Type, Value, Variable};
use fmu_host::InterfaceType;
use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use toml::de::{DeTable, DeValue, ValueDeserializer};

use crate::fault::{Amount, Fault};
use crate::fmu::Declared;
use crate::ssp::{self, SystemOrigin};
use crate::{Function, table};

/// A system of coupled FMUs.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// The first communication point (s); 0 by default.
    #[serde(default)]
    pub start: f64,
    /// The last communication point that is recorded (s).
    pub stop: f64,
    /// The communication step (s).
    pub step: f64,
    /// Order of stepping; sequential by default.
    #[serde(default)]
    pub order: Order,
    /// Whether sequential stepping is allowed although outputs depend directly on each other.
    #[serde(default)]
    pub allow_algebraic_loops: bool,
    /// The relative tolerance of all components that have none of their own; by default, the tolerance of the
    /// default experiment of each FMU.
    pub tolerance: Option<f64>,
    /// The components, in the order in which sequential stepping takes them.
    #[serde(rename = "component")]
    pub components: Vec<Component>,
    /// Which output feeds which input.
    #[serde(default)]
    pub connections: Vec<Connection>,
    /// The seed of faults with random numbers.
    #[serde(default)]
    pub seed: u64,
    /// Variables to record, `component.variable`; by default all outputs except Strings
    /// and Binaries.
    #[serde(default)]
    pub outputs: Vec<String>,
    /// A CSV or Parquet file with values of inputs over time, relative to the folder of the system file.
    pub input: Option<PathBuf>,
    /// Whether the only component is an FMU without a system file, whose variables have no prefix.
    #[serde(skip)]
    pub is_single: bool,
    /// Where the system comes from if not from a TOML file.
    #[serde(skip)]
    pub package: Option<Arc<SystemOrigin>>,
    /// How WebAssembly components run.
    #[serde(skip)]
    pub sandbox: Sandbox,
}

/// How WebAssembly components run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Sandbox {
    /// Whether native binaries are refused; by default, FMUs that have one do not run as components.
    pub is_required: bool,
    /// The time limit of each call.
    pub call: Option<Duration>,
    /// The maximum memory of each instance in bytes.
    pub memory: Option<u64>,
}

/// The times of a simulation (s).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Experiment {
    /// The first communication point.
    pub start: f64,
    /// The last communication point that is recorded.
    pub stop: f64,
    /// The communication step.
    pub step: f64,
}

/// The order in which components step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// One component after the other, using the newest outputs (Gauss-Seidel).
    #[default]
    Sequential,
    /// All components at once, using the outputs before the step (Jacobi).
    Parallel,
}

/// Reads an interface type from a command line.
fn interface_type() -> impl TypedValueParser<Value = InterfaceType> {
    let known = [
        PossibleValue::new("co-simulation").help("The FMU computes each step"),
        PossibleValue::new("model-exchange").help("The equations of the FMU are integrated"),
    ];
    PossibleValuesParser::new(known).map(|name| match &*name {
        "model-exchange" => InterfaceType::ModelExchange,
        _ => InterfaceType::CoSimulation,
    })
}

/// An instance of an FMU.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Component {
    /// Its name in the system.
    pub name: String,
    /// The FMU file, relative to the folder of the system file.
    pub fmu: PathBuf,
    /// How it is run; by default by co-simulation, if the FMU supports it.
    pub interface: Option<InterfaceType>,
    /// Whether its outputs after a step belong to the sample taken at the start of the step; by
    /// default, true if all outputs are discrete.
    pub sampled: Option<bool>,
    /// Its relative tolerance.
    pub tolerance: Option<f64>,
    /// Start values of parameters, inputs, and variables with initial exact or approx.
    #[serde(default)]
    pub start: BTreeMap<String, Literal>,
    /// The function that it is, if it is no FMU; then the file name only stands for it in messages.
    #[serde(skip)]
    pub function: Option<Function>,
}

/// An output that feeds an input: `plant.theta -> controller.y`, or a table of these fields.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "Notation")]
pub struct Connection {
    /// The output, `component.variable`.
    pub from: String,
    /// The input, `component.variable`.
    pub to: String,
    /// How to convert the value to another unit.
    pub conversion: Option<Conversion>,
    /// Its faults, in the order in which they act; they act before the conversion.
    pub faults: Vec<Fault>,
}

/// The input is `factor` times the output plus `offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conversion {
    /// The factor.
    pub factor: f64,
    /// The offset, in the unit of the input.
    pub offset: f64,
}

/// A connection as the user writes it.
#[derive(Deserialize)]
#[serde(
    untagged,
    deny_unknown_fields,
    expecting = "expected \"component.output -> component.input\", or a table with from, to, factor, offset and faults"
)]
enum Notation {
    Arrow(String),
    Table {
        from: String,
        to: String,
        factor: Option<f64>,
        offset: Option<f64>,
        #[serde(default)]
        faults: Vec<BTreeMap<String, Amount>>,
    },
}

impl TryFrom<Notation> for Connection {
    type Error = Error;

    fn try_from(notation: Notation) -> Result<Self> {
        let (from, to, factor, offset, faults) = match notation {
            Notation::Arrow(text) => {
                let (from, to) = text.split_once("->").with_context(|| {
                    format!("the connection {text:?} is not of the form \"component.output -> component.input\"")
                })?;
                (from.trim().to_owned(), to.trim().to_owned(), None, None, Vec::new())
            }
            Notation::Table { from, to, factor, offset, faults } => {
                (from, to, factor, offset, faults)
            }
        };
        let is_scaled = factor.is_some() || offset.is_some();
        let (factor, offset) = (factor.unwrap_or(1.0), offset.unwrap_or(0.0));
        ensure!(
            factor.is_finite() && offset.is_finite(),
            "the factor and offset of {from} -> {to} are not finite, expected numbers"
        );
        let conversion = is_scaled.then_some(Conversion { factor, offset });
        let faults = faults.into_iter().map(Fault::new).collect::<Result<_>>();
        let faults = faults.with_context(|| format!("{from} -> {to}"));
        // The reader of TOML shows only the outermost error.
        let faults = faults.map_err(|error| anyhow!("{error:#}"))?;
        Ok(Self { from, to, conversion, faults })
    }
}

/// A value as the user writes it.
#[derive(Debug, Clone, PartialEq)]
pub enum Literal {
    /// `true` or `false`.
    Boolean(bool),
    /// A whole number of any type.
    Integer(i128),
    /// A number.
    Real(f64),
    /// The name of an enumeration item, a string, or any other value as text.
    Text(String),
    /// The values of an array, row by row.
    Array(Vec<Self>),
}

impl<'de> Deserialize<'de> for Literal {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(LiteralVisitor)
    }
}

struct LiteralVisitor;

impl<'de> Visitor<'de> for LiteralVisitor {
    type Value = Literal;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, true, false, a quoted string or an array of these")
    }

    fn visit_bool<E>(self, value: bool) -> Result<Literal, E> {
        Ok(Literal::Boolean(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Literal, E> {
        Ok(Literal::Integer(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Literal, E> {
        Ok(Literal::Integer(value.into()))
    }

    fn visit_i128<E>(self, value: i128) -> Result<Literal, E> {
        Ok(Literal::Integer(value))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Literal, E> {
        Ok(Literal::Real(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<Literal, E> {
        Ok(Literal::Text(value.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Literal, A::Error> {
        let values = std::iter::from_fn(|| values.next_element().transpose());
        values.collect::<Result<_, _>>().map(Literal::Array)
    }
}

impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Boolean(value) => value.fmt(f),
            Self::Integer(value) => value.fmt(f),
            Self::Real(value) => write!(f, "{value:?}"),
            Self::Text(value) => write!(f, "{value:?}"),
            Self::Array(values) => {
                let mut list = f.debug_list();
                for value in values.iter().take(SHOWN) {
                    list.entry(&format_args!("{value}"));
                }
                if values.len() > SHOWN { list.finish_non_exhaustive() } else { list.finish() }
            }
        }
    }
}

/// The number of values of an array that a message shows.
const SHOWN: usize = 8;

impl Literal {
    /// Whether it is an array, maybe as text.
    pub(crate) fn is_array(&self) -> bool {
        match self {
            Self::Array(_) => true,
            Self::Text(text) => text.trim_start().starts_with('['),
            _ => false,
        }
    }

    /// The values of an array with these dimensions, row by row.
    ///
    /// # Errors
    /// It has another shape; the error has both.
    pub(crate) fn elements(&self, dimensions: &[usize], name: &str) -> Result<Vec<Self>> {
        let shape =
            |lengths: &[usize]| Vec::from_iter(lengths.iter().map(usize::to_string)).join(" x ");
        let expected = shape(dimensions);
        if let Self::Text(text) = self {
            let array = ValueDeserializer::parse(text).and_then(Self::deserialize).ok();
            let array = array.with_context(|| {
                format!("{name} = {self} is invalid; expected an array of {expected} values")
            })?;
            return array.elements(dimensions, name);
        }
        let given = self.shape();
        let values = match &given {
            Some(given) => shape(given),
            None => "lists of different lengths".to_owned(),
        };
        let is_same = given.as_deref() == Some(dimensions);
        ensure!(is_same, "{name} = {self}: values: {values}, expected {expected}");
        let mut values = vec![self.clone()];
        for _ in dimensions {
            let lists = values.into_iter();
            values = lists.flat_map(|v| if let Self::Array(v) = v { v } else { vec![v] }).collect();
        }
        Ok(values)
    }

    /// The lengths of nested arrays; `None` if those of one level differ.
    fn shape(&self) -> Option<Vec<usize>> {
        let Self::Array(values) = self else { return Some(Vec::new()) };
        let mut shapes = values.iter().map(Self::shape);
        let first = shapes.next().unwrap_or_else(|| Some(Vec::new()))?;
        let are_same = shapes.all(|shape| shape.as_ref() == Some(&first));
        are_same.then(|| [vec![values.len()], first].concat())
    }

    /// The value in the type of a variable, which is shown to the user as `name`.
    ///
    /// # Errors
    /// The value does not fit the type.
    pub(crate) fn typed(&self, variable: &Variable, name: &str) -> Result<Value> {
        let typed = match (variable.of_type, self) {
            (Type::Boolean, Self::Boolean(value)) => Some(Value::Boolean(*value)),
            (Type::Boolean, Self::Text(text)) => table::boolean(text).map(Value::Boolean),
            (Type::String, Self::Text(text)) => {
                (!text.contains('\0')).then(|| Value::String(text.clone()))
            }
            (Type::Enumeration, Self::Text(text)) => variable.value(text),
            (Type::Enumeration, Self::Integer(number)) => variable.value(&number.to_string()),
            (kind, _) if kind.is_float() => self.real().and_then(|real| Value::real(kind, real)),
            (kind, Self::Integer(number)) => Value::whole(kind, *number),
            (kind, Self::Text(text)) => text.parse().ok().and_then(|n| Value::whole(kind, n)),
            _ => None,
        };
        typed.with_context(|| {
            let expected = match variable.of_type {
                Type::Int32 => "a 32-bit integer".into(),
                Type::String => "a quoted string without null bytes".into(),
                Type::Binary => "nothing, as a Binary cannot be set".into(),
                _ => variable.expected(),
            };
            format!("{name} = {self} is invalid; expected {expected}")
        })
    }

    fn real(&self) -> Option<f64> {
        match self {
            Self::Real(value) => Some(*value),
            Self::Integer(value) => Some(*value as f64),
            Self::Text(text) => text.parse().ok(),
            Self::Boolean(_) | Self::Array(_) => None,
        }
    }
}

/// What the user changes of a description, by default nothing; the options of `cargo fmu simulate`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, Args)]
#[serde(default)]
pub struct Overrides {
    /// Set a start value (for an enumeration, the name of an item); may be repeated. An FMU without system file
    /// has no COMPONENT
    #[arg(long = "set", value_name = "COMPONENT.VARIABLE=VALUE", value_parser = assignment)]
    pub sets: Vec<(String, String)>,
    /// Start time in s
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub start: Option<f64>,
    /// Stop time, the last recorded communication point, in s
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub stop: Option<f64>,
    /// Communication step size in s
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    pub step: Option<f64>,
    /// Relative tolerance of all components
    #[arg(long, value_name = "TOLERANCE")]
    pub tolerance: Option<f64>,
    /// How to run the FMUs [default: by co-simulation, if they support it]
    #[arg(long, value_parser = interface_type())]
    pub interface: Option<InterfaceType>,
    /// Record all components after each step, or before it [default: after it if all outputs are discrete, except
    /// one FMU without a system file]
    #[arg(long)]
    pub sampled: Option<bool>,
    /// Order of stepping
    #[arg(long)]
    pub order: Option<Order>,
    /// Variable to record; may be repeated
    #[arg(long = "output", value_name = "COMPONENT.VARIABLE")]
    pub outputs: Vec<String>,
    /// CSV or Parquet file with values of inputs: a column time in s, and one for each input
    #[arg(long, value_name = "FILE")]
    pub input: Option<PathBuf>,
    /// Folder of the FMUs [default: as in the system file]
    #[arg(long, value_name = "DIR")]
    pub fmus: Option<PathBuf>,
    /// How WebAssembly components run.
    #[arg(skip)]
    pub sandbox: Sandbox,
}

/// Parses `COMPONENT.VARIABLE=VALUE`.
fn assignment(text: &str) -> Result<(String, String)> {
    let (mut is_quoted, mut last) = (false, '.');
    let end = text.find(|c| {
        // An apostrophe within a part of a name is no quote.
        is_quoted ^= c == '\'' && (is_quoted || last == '.');
        last = c;
        c == '=' && !is_quoted
    });
    let end = end
        .or_else(|| text.find('='))
        .context("expected COMPONENT.VARIABLE=VALUE, such as controller.pid.kp=250")?;
    Ok((text[..end].to_owned(), text[end + 1..].to_owned()))
}

impl Description {
    /// Reads a file: an FMU, or a system as [`Description::read`] does.
    ///
    /// # Errors
    /// As for both.
    pub fn open(file: &Path) -> Result<Self> {
        if is_fmu(file) { Self::of_fmu(file) } else { Self::read(file) }
    }

    /// Reads a TOML file, or a package (.ssp) or system (.ssd) of SSP; resolves the paths of the FMUs against
    /// its folder.
    ///
    /// # Errors
    /// The file cannot be read or is not a valid description.
    pub fn read(file: &Path) -> Result<Self> {
        if ssp::is_package(file) {
            return ssp::read(file);
        }
        let name = file.display();
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        Self::parse(&text, file).with_context(|| name.to_string())
    }

    /// Parses the text of a TOML file with this path.
    ///
    /// # Errors
    /// It is not a valid description.
    pub fn parse(text: &str, file: &Path) -> Result<Self> {
        let parsed = toml::from_str(text);
        let mut description: Self = parsed.map_err(|error| {
            let text = error.to_string();
            let is_sweep = text.contains("unknown field `parameter`");
            let hint = if is_sweep { "\nit is a sweep, expected `cargo fmu sweep`" } else { "" };
            anyhow!("{}{hint}", text.trim_end())
        })?;
        for component in &mut description.components {
            component.fmu = file.with_file_name(&component.fmu);
        }
        description.input = description.input.map(|input| file.with_file_name(input));
        Ok(description)
    }

    /// One FMU, with the times of its default experiment: by default from 0 s for 1 s, in 500 steps. Its rows
    /// are those of `fmpy.simulate_fmu` with this step, so that also a sampled FMU has the outputs before each step.
    ///
    /// # Errors
    /// The file cannot be read or is not an FMU.
    pub fn of_fmu(file: &Path) -> Result<Self> {
        let declared = Declared::read(file);
        let declared = declared.with_context(|| format!("{} cannot be used", file.display()))?;
        let [start, stop, step] = declared.experiment;
        let start = start.unwrap_or(0.0);
        let stop = stop.unwrap_or(start + 1.0);
        Ok(Self {
            start,
            stop,
            step: step.unwrap_or((stop - start) / 500.0),
            allow_algebraic_loops: true,
            components: vec![Component {
                name: file.file_stem().unwrap_or_default().to_string_lossy().replace('.', "_"),
                fmu: file.to_owned(),
                sampled: Some(false),
                ..Component::default()
            }],
            is_single: true,
            ..Self::default()
        })
    }

    /// Applies changes, but for the start values.
    pub fn change(&mut self, changes: &Overrides) {
        self.sandbox = changes.sandbox;
        let of = |changed: Option<f64>, own: f64| changed.unwrap_or(own);
        self.start = of(changes.start, self.start);
        self.stop = of(changes.stop, self.stop);
        self.step = of(changes.step, self.step);
        self.order = changes.order.unwrap_or(self.order);
        self.tolerance = changes.tolerance.or(self.tolerance);
        for component in &mut self.components {
            component.sampled = changes.sampled.or(component.sampled);
            component.interface = changes.interface.or(component.interface);
            component.tolerance = component.tolerance.filter(|_| changes.tolerance.is_none());
        }
        if !changes.outputs.is_empty() {
            self.outputs.clone_from(&changes.outputs);
        }
        self.input = changes.input.clone().or(self.input.take());
        if let Some(folder) = &changes.fmus {
            self.take_fmus_from(folder);
        }
    }

    /// The times of the simulation.
    pub fn experiment(&self) -> Experiment {
        Experiment { start: self.start, stop: self.stop, step: self.step }
    }

    /// Replaces the start value of `component.variable`, if there is such a component.
    pub fn set_start(&mut self, name: &str, value: Literal) {
        if self.is_single {
            self.components[0].start.insert(name.to_owned(), value);
            return;
        }
        let owns = |c: &&mut Component| {
            name.strip_prefix(&c.name).is_some_and(|rest| rest.starts_with('.'))
        };
        let owners = self.components.iter_mut().filter(owns);
        if let Some(component) = owners.max_by_key(|c| c.name.len()) {
            component.start.insert(name[component.name.len() + 1..].to_owned(), value);
        }
    }

    /// Uses the FMUs of the same file names from another folder.
    pub fn take_fmus_from(&mut self, folder: &Path) {
        for component in &mut self.components {
            if let Some(name) = component.fmu.file_name() {
                component.fmu = folder.join(name);
            }
        }
    }
}

/// Whether the name of a file is that of an FMU.
pub fn is_fmu(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("fmu"))
}

/// Maximum number of steps; more are assumed to be a mistake in `step` or `stop`.
const MAX_STEPS: f64 = 1e9;

impl Experiment {
    /// The number of communication points `start + k step` up to `stop`.
    ///
    /// # Errors
    /// The times are inconsistent.
    pub fn steps(&self) -> Result<u64> {
        let Self { start, stop, step } = *self;
        for (key, time) in [("start", start), ("stop", stop)] {
            ensure!(time.is_finite(), "{key} = {time:?}, expected a finite time in s");
        }
        ensure!(stop >= start, "stop = {stop:?}, expected at least start = {start:?}");
        ensure!(step.is_finite() && step > 0.0, "step = {step:?}, expected a positive number of s");
        let steps = (stop - start) / step;
        ensure!(
            steps <= MAX_STEPS,
            "step = {step:?}, which makes {steps:.3e} steps; expected at most {MAX_STEPS:.0e}"
        );
        let largest = start.abs().max(stop.abs());
        ensure!(
            steps < 1.0 || step > largest * f64::EPSILON,
            "step = {step:?} is too short to tell times near {largest:?} s apart"
        );
        // Rounding may put the last point just past the stop time.
        let rounding = (largest * f64::EPSILON / step).max(1e-6);
        Ok((steps + rounding).floor() as u64 + 1)
    }

    /// The last communication point.
    pub(crate) fn last(&self) -> Result<f64> {
        Ok(self.time(self.steps()? - 1))
    }

    /// Says so if the last communication point is before the stop time.
    pub(crate) fn note(&self) -> Result<Option<String>> {
        let (last, stop) = (self.last()?, self.stop);
        let is_short = stop - last > 1e-3 * self.step;
        Ok(is_short.then(|| {
            format!(
                "the step size does not divide the run: it ends at t = {last} s, not at {stop} s"
            )
        }))
    }

    /// The communication point of step `k`, computed directly so that rounding errors do not add up.
    #[inline]
    pub fn time(&self, k: u64) -> f64 {
        // Processors convert signed numbers in one instruction; no run has 2^63 steps.
        self.start + k as i64 as f64 * self.step
    }
}

/// Adds the file to an error that was found after parsing it, and the line if the message starts with
/// something in the file: a key, or a name such as `plant.theta`.
pub fn locate(error: Error, file: &Path, text: &str) -> Error {
    let message = format!("{error:#}");
    let message = message.strip_prefix("component ").unwrap_or(&message);
    let name = message.split([' ', ':', ',']).next().unwrap_or_default();
    let file = file.display();
    match line(text, name) {
        Some(line) => error.context(format!("{file}:{line}")),
        None => error.context(file.to_string()),
    }
}

/// The line of the first key or string that has this word.
fn line(text: &str, word: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let offset = in_table(document.get_ref(), word)?;
    Some(1 + text.get(..offset)?.matches('\n').count())
}

fn in_table(table: &DeTable<'_>, word: &str) -> Option<usize> {
    let offsets = table.iter().filter_map(|(key, value)| match key.get_ref() {
        key_text if key_text == word => Some(key.span().start),
        _ => in_value(value.get_ref(), value.span().start, word),
    });
    offsets.min()
}

fn in_value(value: &DeValue<'_>, start: usize, word: &str) -> Option<usize> {
    match value {
        DeValue::String(text) => text.split_whitespace().any(|part| part == word).then_some(start),
        DeValue::Table(table) => in_table(table, word),
        DeValue::Array(values) => {
            values.iter().find_map(|value| in_value(value.get_ref(), value.span().start, word))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::{Literal, assignment};

    #[test]
    fn a_value_follows_the_first_equals_sign_outside_a_quoted_name() {
        let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        assert_eq!(assignment("p.'a=b'=1").unwrap(), pair("p.'a=b'", "1"));
        assert_eq!(assignment("p.text=a=b").unwrap(), pair("p.text", "a=b"));
        assert_eq!(assignment("p.it's=1").unwrap(), pair("p.it's", "1"));
        assert_eq!(assignment("p.it's=a'b=c").unwrap(), pair("p.it's", "a'b=c"));
        assert!(assignment("p.'a'").is_err());
    }

    #[test]
    fn an_array_is_written_as_a_list_or_its_text_and_must_have_the_shape() {
        let integer = |n: i128| Literal::Integer(n);
        let text = |text: &str| Literal::Text(text.to_owned());
        let list = Literal::Array(vec![
            Literal::Array(vec![integer(1), integer(2), integer(u64::MAX.into())]),
            Literal::Array(vec![Literal::Real(4.5), Literal::Boolean(true), text("a")]),
        ]);
        let all = Vec::from_iter([1, 2, u64::MAX.into()].map(integer));
        let all = [all, vec![Literal::Real(4.5), Literal::Boolean(true), text("a")]].concat();
        let written = text("[[1, 2, 18446744073709551615], [4.5, true, 'a']]");
        for array in [&list, &written] {
            assert_eq!(array.elements(&[2, 3], "m").unwrap(), all);
        }
        let refused = |value: &Literal| value.elements(&[3, 2], "m").unwrap_err().to_string();
        assert!(refused(&list).ends_with(", \"a\"]]: values: 2 x 3, expected 3 x 2"));
        assert!(refused(&written).ends_with(", \"a\"]]: values: 2 x 3, expected 3 x 2"));
        for (value, reason) in [
            ("[1, 2, 3, 4, 5, 6]", "m = [1, 2, 3, 4, 5, 6]: values: 6, expected 3 x 2"),
            ("[]", "m = []: values: 0, expected 3 x 2"),
            ("[[1], [2, 3], 4]", "values: lists of different lengths, expected 3 x 2"),
            ("[1, 2, 3, 4, 5, 6, 7, 8, 9]", "m = [1, 2, 3, 4, 5, 6, 7, 8, ..]: values: 9,"),
            ("[1", "m = \"[1\" is invalid; expected an array of 3 x 2 values"),
        ] {
            assert!(refused(&text(value)).contains(reason), "{}", refused(&text(value)));
        }
    }
}
