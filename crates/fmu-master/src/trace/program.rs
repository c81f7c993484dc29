//! Writes a C program that repeats the calls of one component of a trace without anything of ours.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use fmi_abi::{Argument, ArgumentKind, FmiVersion, Signature};
use fmu_file::replace::Replacement;
use fmu_host::Element;
use serde_json::Value;

use super::read::{Trace, TracedCall, TracedComponent, signature};

/// The number of calls in a function of C, so that compilers take time in proportion to the calls.
const CALLS_PER_FUNCTION: u64 = 200;

/// Writes the program, and returns the number of calls in it. `component` is the name of the component, which may be left
/// out if there is only one.
///
/// # Errors
/// The trace cannot be read, has no such component, or several; or the program cannot be written.
pub fn write_program(trace: &Path, component: Option<&str>, program: &Path) -> Result<u64> {
    // A first time for the functions that are called, a second time for the calls, which may be many.
    let (mut first, mut second) = (Trace::open(trace)?, Trace::open(trace)?);
    let chosen = choose(&first, component)?;
    let about = first.components[chosen].clone();
    let of = about.fmu.as_ref();
    let of = of.with_context(|| format!("{} is a function, not an FMU", about.name))?;
    let (mut functions, mut states, mut calls) = (BTreeSet::new(), 0, 0);
    while let Some(call) = first.next_call()? {
        if call.component == chosen && signature(&call.call.function).is_some() {
            functions.insert(call.call.function.clone());
            states = states.max(state(&call));
            calls += 1;
        }
    }
    ensure!(calls > 0, "{} was not called", about.name);
    let mut out = Replacement::new(program)?;
    let is_fmi2 = of.version == FmiVersion::Fmi2;
    let cannot = || format!("cannot write {}", program.display());
    let fmu = of.path.file_name().unwrap_or_default().to_string_lossy();
    let mut text = include_str!("program/head.c").to_owned();
    text += if is_fmi2 { include_str!("program/fmi2.c") } else { include_str!("program/fmi3.c") };
    for (from, to) in [
        ("@COMPONENT@", comment(&about.name)),
        ("@CALLS@", calls.to_string()),
        ("@FMU@", comment(&fmu)),
        ("@FMI@", of.version.as_str().to_owned()),
        ("@INTERFACE@", of.interface.as_str().to_owned()),
        ("@BINARY@", of.binary.escape_default().to_string()),
        ("@STATES@", (states + 1).to_string()),
    ] {
        text = text.replace(from, &to);
    }
    let signatures = Vec::from_iter(functions.iter().filter_map(|name| signature(name)));
    for signature in &signatures {
        writeln!(text, "static {};", declaration(signature))?;
    }
    out.write_all(text.as_bytes()).with_context(cannot)?;
    let mut written = 0;
    while let Some(call) = second.next_call()? {
        let Some(signature) = signature(&call.call.function) else { continue };
        if call.component != chosen {
            continue;
        }
        if written % CALLS_PER_FUNCTION == 0 {
            let end = if written == 0 { "" } else { "}\n" };
            let number = written / CALLS_PER_FUNCTION;
            writeln!(out, "{end}\nstatic void calls_{number}(void) {{").with_context(cannot)?;
        }
        written += 1;
        out.write_all(statement(&call, &about, signature).as_bytes()).with_context(cannot)?;
    }
    let mut end = String::from("}\n\nstatic void load_functions(void) {\n");
    for signature in &signatures {
        let name = signature.function.name;
        writeln!(end, "    {name} = ({}) function(\"{name}\");", pointer(signature, ""))?;
    }
    end += "}\n\nstatic void (*const calls[])(void) = {";
    for number in 0..written.div_ceil(CALLS_PER_FUNCTION) {
        write!(end, "{}calls_{number}", if number == 0 { "" } else { ", " })?;
    }
    end += "};\n";
    end += include_str!("program/main.c");
    out.write_all(end.as_bytes()).with_context(cannot)?;
    out.finish().with_context(cannot)?;
    Ok(calls)
}

fn choose(trace: &Trace, component: Option<&str>) -> Result<usize> {
    if let Some(name) = component {
        return trace.component(name);
    }
    let all = trace.components.iter().enumerate().filter(|(_, c)| c.fmu.is_some());
    let all = Vec::from_iter(all);
    let names = Vec::from_iter(all.iter().map(|(_, component)| component.name.as_str())).join(", ");
    match all[..] {
        [(index, _)] => Ok(index),
        _ => anyhow::bail!(
            "the trace has the components {names}, expected one of them as --component"
        ),
    }
}

/// Text for a comment.
fn comment(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).collect::<String>().replace("*/", "* /")
}

/// The type in C of a type in a row.
fn c_type(in_row: &str) -> &str {
    match in_row {
        "f64" => "double",
        "f32" => "float",
        "i8" => "int8_t",
        "u8" => "uint8_t",
        "i16" => "int16_t",
        "u16" => "uint16_t",
        "i32" => "int32_t",
        "u32" => "uint32_t",
        "i64" => "int64_t",
        "u64" => "uint64_t",
        "usize" => "size_t",
        "fmi2Byte" => "char",
        "fmi2String" | "fmi3String" => "const char *",
        "fmi3Binary" => "const uint8_t *",
        "fmi3Boolean" | "fmi3Clock" => "bool",
        "fmi2EventInfo" | "fmi2CallbackFunctions" | "fmi3LogMessageCallback" => in_row,
        other if other.ends_with("Callback") => "fmi3Callback",
        other if other.to_lowercase().ends_with("state") || is_handle(other) => "void *",
        // Booleans of FMI 2.0, and enumerations.
        _ => "int",
    }
}

fn is_handle(in_row: &str) -> bool {
    ["Component", "Instance", "Environment"].iter().any(|end| in_row.ends_with(end))
}

/// The type of a function, with a name or as a type.
fn pointer(signature: &Signature, name: &str) -> String {
    let argument = |argument: &Argument| match argument.kind {
        ArgumentKind::InArray { element, .. } => format!("const {}{}", constant(element), "*"),
        ArgumentKind::OutArray { element, .. } => format!("{} *", c_type(element)),
        ArgumentKind::Length => "size_t".to_owned(),
        ArgumentKind::Out(of) => format!("{} *", c_type(of)),
        ArgumentKind::Pointer(to) => format!("const {} *", c_type(to)),
        ArgumentKind::Callback(of) | ArgumentKind::Value(of) => c_type(of).to_owned(),
    };
    let instance = signature.has_instance.then(|| "void *".to_owned());
    let arguments = instance.into_iter().chain(signature.arguments.iter().map(argument));
    let arguments = Vec::from_iter(arguments).join(", ");
    let arguments = if arguments.is_empty() { "void" } else { &arguments };
    let name_of = signature.function.name;
    let result = match signature.has_instance {
        true => "int ",
        false if name_of.ends_with("FreeInstance") => "void ",
        false if name_of.contains("Instantiate") => "void *",
        false => "const char *",
    };
    format!("{result}(*{name})({arguments})")
}

/// The element of a constant list: a pointer is constant itself.
fn constant(element: &str) -> String {
    let of = c_type(element);
    if of.ends_with('*') { format!("{of}const ") } else { format!("{of} ") }
}

fn declaration(signature: &Signature) -> String {
    pointer(signature, signature.function.name)
}

/// The number of the state that a call gives or returns.
fn state(call: &TracedCall) -> usize {
    let number = |lists: &[(String, Vec<Element>)]| {
        let state = lists.iter().find(|(name, _)| name == "state");
        match state.and_then(|(_, elements)| elements.first()) {
            Some(Element::State(number)) => *number,
            _ => 0,
        }
    };
    match number(&call.call.given) {
        0 => number(&call.call.returned),
        given => given,
    }
}

/// A value in C.
fn literal(element: &Element) -> String {
    match element {
        Element::Integer(value) => match i32::try_from(*value) {
            Ok(value) => value.to_string(),
            Err(_) if *value == i64::MIN.into() => "(-9223372036854775807LL - 1)".to_owned(),
            Err(_) if i64::try_from(*value).is_ok() => format!("{value}LL"),
            Err(_) => format!("{value}ULL"),
        },
        Element::Float32(value) => real((*value).into()),
        Element::Float64(value) => real(*value),
        Element::Text(None) | Element::Bytes(None) | Element::State(0) => "NULL".to_owned(),
        Element::Text(Some(text)) => text_literal(text),
        Element::Bytes(Some(bytes)) => {
            let bytes = bytes.iter().map(|byte| format!("\\{byte:03o}"));
            format!("(const uint8_t *) \"{}\"", bytes.collect::<String>())
        }
        Element::State(number) => format!("states[{number}]"),
    }
}

fn text_literal(text: &str) -> String {
    let escaped = text.bytes().map(|byte| match byte {
        b'"' | b'\\' => format!("\\{}", byte as char),
        b' '..=b'~' if byte != b'?' => (byte as char).to_string(),
        _ => format!("\\{byte:03o}"),
    });
    format!("\"{}\"", escaped.collect::<String>())
}

fn real(value: f64) -> String {
    match value {
        _ if value.is_nan() => "NAN".to_owned(),
        f64::INFINITY => "INFINITY".to_owned(),
        f64::NEG_INFINITY => "-INFINITY".to_owned(),
        value => format!("{value:?}"),
    }
}

fn list(elements: &[Element]) -> String {
    Vec::from_iter(elements.iter().map(literal)).join(", ")
}

/// The block of a call: its constants, the call, and the checks of its results.
fn statement(call: &TracedCall, component: &TracedComponent, signature: &Signature) -> String {
    let find = |lists: &[(String, Vec<Element>)], name: &str| {
        let found = lists.iter().find(|(known, _)| known == name);
        found.map(|(_, elements)| elements.clone()).unwrap_or_default()
    };
    let function = signature.function.name;
    let names = Vec::from_iter(component.names(&call.call));
    let time = call.time.map(|time| format!("t = {time:?} s: ")).unwrap_or_default();
    let values = find(&call.call.given, "values");
    let named = names.iter().enumerate().map(|(index, name)| match values.get(index) {
        Some(value) => format!("{name} = {}", literal(value)),
        None => name.clone(),
    });
    let named = Vec::from_iter(named).join(", ");
    let named = if named.is_empty() { named } else { format!(" {named}") };
    let about = text_literal(&format!("{time}{function}{named}"));
    let (mut before, mut arguments, mut after) = (String::new(), Vec::new(), String::new());
    if signature.has_instance {
        arguments.push("instance".to_owned());
    }
    for Argument { name, kind } in signature.arguments {
        let given = find(&call.call.given, name);
        let returned = find(&call.call.returned, name);
        match *kind {
            ArgumentKind::InArray { .. } if *name == "bytes" => {
                let bytes = given.first().map_or_else(|| "NULL".to_owned(), literal);
                arguments.push(format!("(const void *) {bytes}"));
            }
            ArgumentKind::InArray { element, .. } => {
                if given.is_empty() {
                    arguments.push("NULL".to_owned());
                    continue;
                }
                let _ = write!(
                    before,
                    "static const {}{name}[] = {{{}}}; ",
                    constant(element),
                    list(&given)
                );
                arguments.push((*name).to_owned());
            }
            ArgumentKind::OutArray { element, length } => {
                let length = find(&call.call.given, length);
                let length = length.first().map_or_else(|| "1".to_owned(), literal);
                let length = if length == "0" { "1".to_owned() } else { length };
                let _ = write!(before, "static {}{name}[{length}]; ", spaced(element));
                arguments.push((*name).to_owned());
                check(&mut after, element, name, &returned);
            }
            ArgumentKind::Length => arguments.push(given.first().map_or("0".into(), literal)),
            ArgumentKind::Out(of) if *name == "state" && c_type(of) == "void *" => {
                arguments.push(format!("&states[{}]", state(call)));
            }
            ArgumentKind::Out("fmi2EventInfo") => {
                before += "fmi2EventInfo info; memset(&info, 0, sizeof info); ";
                arguments.push("&info".to_owned());
                if let [flags @ .., time] = &returned[..] {
                    let _ =
                        write!(after, " CHECK_INFO(info, {}, {{{}}});", literal(time), list(flags));
                }
            }
            ArgumentKind::Out(of) => {
                let _ = write!(before, "static {}{name}[1]; ", spaced(of));
                arguments.push((*name).to_owned());
                check(&mut after, of, name, &returned);
            }
            ArgumentKind::Value(_) if *name == "resources" => {
                arguments.push("resources".to_owned());
            }
            ArgumentKind::Pointer("fmi2CallbackFunctions") => arguments.push("&callbacks".into()),
            ArgumentKind::Callback("fmi3LogMessageCallback") => {
                arguments.push("log_message".into())
            }
            ArgumentKind::Pointer(_) | ArgumentKind::Callback(_) => arguments.push("NULL".into()),
            ArgumentKind::Value(of) if is_handle(of) => {
                let is_instance = function.ends_with("FreeInstance");
                arguments.push(if is_instance { "instance" } else { "NULL" }.to_owned());
            }
            ArgumentKind::Value(_) => arguments.push(given.first().map_or("0".into(), literal)),
        }
    }
    let invoked = format!("{function}({})", arguments.join(", "));
    let expected = match &call.status {
        None => {
            let how = call.ended.as_deref().unwrap_or("the process ended");
            format!("-1, {}", text_literal(how))
        }
        Some(status) => format!("{}, NULL", status_number(status)),
    };
    let invoked = match (function, signature.has_instance) {
        (_, true) => format!("returned({invoked}, {expected});"),
        (name, _) if name.contains("Instantiate") => {
            format!("instance = {invoked}; returned(instance ? 0 : 3, {expected});")
        }
        (name, _) if name.ends_with("FreeInstance") => format!("{invoked}; instance = NULL;"),
        _ => format!("(void) {invoked};"),
    };
    format!("    {{ {before}begin({}, {about}); {invoked}{after} }}\n", call.number)
}

fn spaced(element: &str) -> String {
    let of = c_type(element);
    if of.ends_with('*') { of.to_owned() } else { format!("{of} ") }
}

/// Adds the check of a list that the FMU has written.
fn check(after: &mut String, of: &str, name: &str, returned: &[Element]) {
    if returned.is_empty() || name == "bytes" || of == "fmi3Binary" {
        return;
    }
    let check = if c_type(of) == "const char *" { "CHECK_TEXT" } else { "CHECK" };
    let _ = write!(after, " {check}({}, {name}, {{{}}});", c_type(of), list(returned));
}

/// The integer of a status in a trace.
fn status_number(status: &Value) -> i64 {
    const NAMES: [&str; 6] = ["OK", "Warning", "Discard", "Error", "Fatal", "Pending"];
    match status {
        Value::String(name) => {
            let place = NAMES.iter().position(|known| name.get(4..) == Some(known));
            place.map_or(-1, |place| place as i64)
        }
        Value::Bool(true) | Value::Null => 0,
        Value::Bool(false) => 3,
        other => other.as_i64().unwrap_or(-1),
    }
}
