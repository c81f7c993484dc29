//! Reads traces, call by call.

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use fmi_abi::{ArgumentKind, FmiVersion, InterfaceType, Signature};
use fmu_description::Type;
use fmu_host::{Element, RepeatedCall};
use serde_json::{Map, Value};

use super::VERSION;
use super::element::from_json;

/// A trace, of which the calls are read one after the other.
pub struct Trace {
    path: PathBuf,
    lines: BufReader<File>,
    line: u64,
    /// The components of the run, in the order of the system.
    pub components: Vec<TracedComponent>,
    /// The calls that wait for the results of a call before them.
    waiting: VecDeque<TracedCall>,
    /// The time (s) that each component has reached.
    times: Vec<Option<f64>>,
    is_read: bool,
    /// Whether the file ends within a line that is not the beginning of a call.
    pub is_cut: bool,
    /// How the process ended, if an FMU ended it outside of a call.
    pub ended: Option<String>,
}

/// A component of a trace.
#[derive(Debug, Clone)]
pub struct TracedComponent {
    /// Its name in the system.
    pub name: String,
    /// Its FMU; `None` for a function.
    pub fmu: Option<TracedFmu>,
    /// Its variables.
    pub variables: Vec<TracedVariable>,
    /// The indices of the variables by the type of access and the value reference.
    by_reference: HashMap<(Option<Type>, u32), usize>,
}

/// The FMU of a component.
#[derive(Debug, Clone)]
pub struct TracedFmu {
    /// The file.
    pub path: PathBuf,
    /// The binary in it.
    pub binary: String,
    /// Its version of FMI.
    pub version: FmiVersion,
    /// How it was run.
    pub interface: InterfaceType,
}

/// A variable.
#[derive(Debug, Clone)]
pub struct TracedVariable {
    /// Its name.
    pub name: String,
    /// Its value reference.
    pub reference: u32,
    /// The number of its elements.
    pub elements: usize,
}

/// A call.
#[derive(Debug, Clone)]
pub struct TracedCall {
    /// Its number, from 1.
    pub number: u64,
    /// The index of the component.
    pub component: usize,
    /// The time (s) that the component had reached.
    pub time: Option<f64>,
    /// The function with its arguments.
    pub call: RepeatedCall,
    /// What the FMU wrote, as it is in the file.
    pub out: Map<String, Value>,
    /// The status, or whether there is an instance; null for a function that returns neither. `None` if the function has
    /// not returned.
    pub status: Option<Value>,
    /// The duration (ns).
    pub nanoseconds: u64,
    /// How the process ended in the call, if it did.
    pub ended: Option<String>,
    /// The number of the call of the component in which it was made, as the FMU called back.
    pub within: Option<u64>,
}

impl TracedComponent {
    fn read(line: &Map<String, Value>) -> Result<Self> {
        let text = |key: &str| {
            let text = line.get(key).and_then(Value::as_str);
            text.map(str::to_owned).with_context(|| format!("{key} is missing"))
        };
        let fmu = match line.get("fmu") {
            None => None,
            Some(_) => Some(TracedFmu {
                path: text("fmu")?.into(),
                binary: text("binary")?,
                version: FmiVersion::named(Some(&text("fmi")?))
                    .context("another version of FMI")?,
                interface: InterfaceType::named(&text("interface")?)
                    .context("another interface")?,
            }),
        };
        let (mut variables, mut by_reference) = (Vec::new(), HashMap::new());
        for variable in line.get("variables").and_then(Value::as_array).into_iter().flatten() {
            let name = variable[0].as_str().context("a variable without a name")?;
            let reference = variable[2].as_u64().and_then(|reference| reference.try_into().ok());
            let reference = reference.with_context(|| format!("{name} has no value reference"))?;
            let of_type = variable[1].as_str().and_then(Type::parse);
            let of_type = of_type.with_context(|| format!("{name} has no type"))?;
            let access = match &fmu {
                Some(TracedFmu { version: FmiVersion::Fmi2, .. }) => {
                    Some(of_type.accessed_as(FmiVersion::Fmi2))
                }
                _ => None,
            };
            by_reference.entry((access, reference)).or_insert(variables.len());
            let elements = variable[3].as_u64().unwrap_or(1) as usize;
            variables.push(TracedVariable { name: name.to_owned(), reference, elements });
        }
        Ok(Self { name: text("component")?, fmu, variables, by_reference })
    }

    /// The variable with a value reference in the calls of a function.
    pub fn variable(&self, function: &str, reference: u32) -> Option<&TracedVariable> {
        let access = function.starts_with("fmi2").then(|| accessed_by(function));
        let index = *self.by_reference.get(&(access, reference))?;
        self.variables.get(index)
    }

    /// The names of the elements of the variables that a call gets or sets.
    pub fn names<'a>(&'a self, call: &'a RepeatedCall) -> impl Iterator<Item = String> + 'a {
        let lists = ["references", "unknowns", "knowns"];
        let list = lists.iter().find_map(|name| call.given.iter().find(|(known, _)| known == name));
        let references = list.map_or(&[][..], |(_, references)| references);
        references.iter().flat_map(|reference| {
            let Element::Integer(reference) = reference else { return Vec::new() };
            let found = self.variable(&call.function, *reference as u32);
            match found {
                None => vec![format!("the variable {reference}")],
                Some(TracedVariable { name, elements: 1, .. }) => vec![name.clone()],
                Some(TracedVariable { name, elements, .. }) => {
                    (1..=*elements).map(|index| format!("{name}[{index}]")).collect()
                }
            }
        })
    }
}

/// The type of the variables that a function of FMI 2.0 accesses.
pub(crate) fn accessed_by(function: &str) -> Type {
    match function {
        "fmi2GetInteger" | "fmi2SetInteger" => Type::Int32,
        "fmi2GetBoolean" | "fmi2SetBoolean" => Type::Boolean,
        "fmi2GetString" | "fmi2SetString" => Type::String,
        _ => Type::Float64,
    }
}

/// The signature of a function of FMI.
pub(crate) fn signature(function: &str) -> Option<&'static Signature> {
    let mut all = FmiVersion::ALL.into_iter().flat_map(|version| version.signatures());
    all.find(|signature| signature.function.name == function)
}

impl Trace {
    /// Opens a trace, and reads what it says of the components.
    ///
    /// # Errors
    /// The file cannot be read, or is not a trace of this version.
    pub fn open(path: &Path) -> Result<Self> {
        let cannot = || format!("{} cannot be read", path.display());
        let file = File::open(path).with_context(cannot)?;
        let mut trace = Self {
            path: path.to_owned(),
            lines: BufReader::new(file),
            line: 0,
            components: Vec::new(),
            waiting: VecDeque::new(),
            times: Vec::new(),
            is_read: false,
            is_cut: false,
            ended: None,
        };
        let version = trace.next_line()?.and_then(|line| line.get("trace").cloned());
        let expected = "expected a file of `cargo fmu simulate --trace`";
        let version =
            version.with_context(|| format!("{} is no trace, {expected}", path.display()));
        let version = version?;
        ensure!(
            version == VERSION,
            "{} is a trace of version {version}, expected {VERSION}; the program that wrote it reads it",
            path.display()
        );
        // The lines of the components come before the first call.
        trace.advance()?;
        Ok(trace)
    }

    /// The index of the component of this name.
    ///
    /// # Errors
    /// There is none.
    pub fn component(&self, name: &str) -> Result<usize> {
        let found = self.components.iter().position(|component| component.name == name);
        found.with_context(|| {
            let names = self.components.iter().map(|component| component.name.as_str());
            let (names, path) = (Vec::from_iter(names).join(", "), self.path.display());
            format!("{path} has no component {name}; the components are {names}")
        })
    }

    fn next_line(&mut self) -> Result<Option<Map<String, Value>>> {
        let mut text = Vec::new();
        let path = self.path.display();
        let read = self.lines.read_until(b'\n', &mut text);
        if read.with_context(|| format!("{path} cannot be read"))? == 0 {
            self.is_read = true;
            return Ok(None);
        }
        self.line += 1;
        let is_whole = text.last() == Some(&b'\n');
        if let Ok(line) = serde_json::from_slice(&text) {
            return Ok(Some(line));
        }
        if !is_whole && self.line > 1 {
            self.is_read = true;
            // The process has ended in this call.
            text.push(b'}');
            self.is_cut = serde_json::from_slice::<Map<String, Value>>(&text).is_err();
            return Ok(serde_json::from_slice(&text).ok());
        }
        match self.line {
            1 => Ok(None),
            line => bail!("line {line} of {path} is damaged, expected an object of JSON"),
        }
    }

    /// Reads until the first call that waits has returned.
    fn advance(&mut self) -> Result<()> {
        while !self.is_read && self.waiting.front().is_none_or(|call| call.status.is_none()) {
            let Some(line) = self.next_line()? else { break };
            let read = self.add(line);
            read.with_context(|| format!("line {} of {}", self.line, self.path.display()))?;
        }
        Ok(())
    }

    fn add(&mut self, line: Map<String, Value>) -> Result<()> {
        if let Some(number) = line.get("return").and_then(Value::as_u64) {
            let mut waiting = self.waiting.iter_mut();
            let call = waiting.find(|call| call.number == number);
            let call = call.with_context(|| format!("call {number} has not begun"))?;
            return complete(call, &line);
        }
        if let Some(number) = line.get("call").and_then(Value::as_u64) {
            let name = line.get("component").and_then(Value::as_str).unwrap_or_default();
            let component = self.components.iter().position(|component| component.name == name);
            let component = component.with_context(|| format!("no component {name:?}"))?;
            let function = line.get("function").and_then(Value::as_str).context("no function")?;
            let is_open = |call: &&TracedCall| call.component == component && call.status.is_none();
            let open = self.waiting.iter().rfind(is_open);
            let mut call = TracedCall {
                within: open.map(|call| call.number),
                number,
                component,
                time: None,
                call: RepeatedCall { function: function.to_owned(), ..RepeatedCall::default() },
                out: Map::new(),
                status: None,
                nanoseconds: 0,
                ended: line.get("ended").and_then(Value::as_str).map(str::to_owned),
            };
            call.call.given = elements(function, line.get("in"))?;
            if line.contains_key("ns") {
                complete(&mut call, &line)?;
            }
            self.waiting.push_back(call);
        } else if line.contains_key("component") && !line.contains_key("log") {
            self.components.push(TracedComponent::read(&line)?);
            self.times.push(None);
        } else if let Some(ended) = line.get("ended").and_then(Value::as_str) {
            let mut waiting = self.waiting.iter_mut();
            match waiting.rfind(|call| call.status.is_none()) {
                Some(call) => call.ended = Some(ended.to_owned()),
                None => self.ended = Some(ended.to_owned()),
            }
        }
        Ok(())
    }

    /// The calls that were made in the call of this number, which was read last.
    pub(super) fn within(&self, number: u64) -> impl Iterator<Item = &TracedCall> {
        self.waiting.iter().filter(move |call| call.within == Some(number))
    }

    /// The next call, in the order in which they began; `None` at the end.
    ///
    /// # Errors
    /// A line is damaged.
    pub fn next_call(&mut self) -> Result<Option<TracedCall>> {
        self.advance()?;
        let Some(mut call) = self.waiting.pop_front() else { return Ok(None) };
        let time = &mut self.times[call.component];
        let given = |name: &str| {
            let given = call.call.given.iter().find(|(known, _)| known == name);
            match given.and_then(|(_, elements)| elements.first()) {
                Some(Element::Float64(value)) => Some(*value),
                Some(Element::Integer(value)) => Some(*value as f64),
                _ => None,
            }
        };
        let function = call.call.function.as_str();
        if function.ends_with("SetupExperiment") || function == "fmi3EnterInitializationMode" {
            *time = given("start");
        }
        call.time = given("time").or(*time);
        if let Some(begin) = given("time") {
            *time = Some(begin + given("step").unwrap_or(0.0));
        }
        Ok(Some(call))
    }
}

/// Adds the results of a call.
fn complete(call: &mut TracedCall, line: &Map<String, Value>) -> Result<()> {
    let status = line.get("status").or_else(|| line.get("instance"));
    call.status = Some(status.cloned().unwrap_or(Value::Null));
    call.nanoseconds = line.get("ns").and_then(Value::as_u64).unwrap_or(0);
    call.call.returned = elements(&call.call.function, line.get("out"))?;
    call.out = line.get("out").and_then(Value::as_object).cloned().unwrap_or_default();
    Ok(())
}

/// The arguments of a call as elements of their types.
fn elements(function: &str, object: Option<&Value>) -> Result<Vec<(String, Vec<Element>)>> {
    let Some(object) = object.and_then(Value::as_object) else { return Ok(Vec::new()) };
    let signature = signature(function);
    let mut all = Vec::new();
    for (name, value) in object {
        let arguments = signature.iter().flat_map(|signature| signature.arguments);
        let kind = arguments.into_iter().find(|argument| argument.name == name).map(|a| a.kind);
        let of_type = match kind {
            Some(
                ArgumentKind::InArray { element, .. } | ArgumentKind::OutArray { element, .. },
            ) => element,
            Some(ArgumentKind::Out(of_type) | ArgumentKind::Value(of_type)) => of_type,
            _ => "usize",
        };
        let list = match value {
            Value::Array(list) => list,
            one => std::slice::from_ref(one),
        };
        let element = |value| from_json(value, of_type);
        let list = list.iter().map(element).collect::<Option<Vec<_>>>();
        let wrong = || anyhow!("{function}: {name} = {value}, expected {of_type}");
        let place = signature.and_then(|s| s.arguments.iter().position(|a| a.name == name));
        all.push((place, (name.clone(), list.ok_or_else(wrong)?)));
    }
    // In the order of the standard.
    all.sort_by_key(|(place, _)| *place);
    Ok(all.into_iter().map(|(_, argument)| argument).collect())
}
