//! The interface of an FMU in C sources: a file with the functions of the standard, which call the translated model.
//!
//! The functions of an instance are generated from the rows of `fmi-abi`. What needs no rows is C text in the folder
//! `c`, where `fmiX` and `FMIX` stand for the version.

use std::fmt::Write;

use fmi_abi::{Argument, ArgumentKind, FunctionGroup, Signature};
use fmu_description::{FmiVersion, InterfaceType};

use crate::library::NamedFile;

/// What the file depends on.
pub struct Interface<'a> {
    /// The version of FMI.
    pub version: FmiVersion,
    /// The model identifier, which is the prefix of functions if several FMUs are linked.
    pub identifier: &'a str,
    /// The interface types that were asked for, whose functions are enough; if there are none, all functions are there,
    /// as in a binary.
    pub interface_types: &'a [InterfaceType],
    /// Whether the model has clocks.
    pub has_clocks: bool,
    /// Whether it is for scheduled execution.
    pub is_scheduled: bool,
    /// Whether states of the model can be serialized.
    pub is_serialized: bool,
    /// The names of the functions that the model imports.
    pub imports: &'a [&'a str],
}

/// Memory for the arguments of a call (bytes) that an instance has at hand: enough for twenty numbers.
const ARGUMENTS: usize = 256;

/// Text of both versions, or of one.
macro_rules! text {
    ($name:literal) => {
        include_str!(concat!("c/", $name, ".c"))
    };
}

impl Interface<'_> {
    /// The name of the file.
    pub fn file_name(&self) -> &'static str {
        match self.version {
            FmiVersion::Fmi2 => "fmi2.c",
            FmiVersion::Fmi3 => "fmi3.c",
        }
    }

    /// The text of the file.
    pub fn text(&self) -> String {
        let is_fmi2 = self.version == FmiVersion::Fmi2;
        let of_version = |fmi2, fmi3| if is_fmi2 { fmi2 } else { fmi3 };
        let imports = |name| self.imports.contains(&name);
        let mut parts = vec![text!("head"), of_version(text!("fmi2_types"), text!("fmi3_types"))];
        let names = self.names();
        parts.extend([names.as_str(), of_version(text!("fmi2_host"), text!("fmi3_host"))]);
        parts.extend([text!("runtime"), of_version("", text!("fmi3_arguments"))]);
        if is_fmi2 && self.has(FunctionGroup::ModelExchange) {
            parts.push(text!("fmi2_events"));
        }
        parts.push(text!("states"));
        if !is_fmi2 && imports("intermediate_update") {
            parts.push(text!("fmi3_update"));
        }
        if self.is_scheduled {
            parts.push(text!("fmi3_scheduled"));
        }
        if self.is_scheduled && imports("clock_update") {
            parts.push(text!("fmi3_clock_update"));
        }
        if imports("read_resource") {
            parts.push(text!("resources"));
        }
        parts.push(text!("instantiate"));
        let scheduled = match self.is_scheduled {
            true => text!("fmi3_instantiate_scheduled"),
            false => text!("fmi3_unscheduled"),
        };
        match self.version {
            FmiVersion::Fmi2 => parts.push(text!("fmi2_instantiate")),
            FmiVersion::Fmi3 => {
                parts.extend([text!("fmi3_instantiate"), scheduled, text!("fmi3_free")]);
            }
        }
        self.fill_in(&parts.concat()) + &self.functions()
    }

    /// Replaces what the text leaves open.
    fn fill_in(&self, text: &str) -> String {
        let of_version = |fmi2, fmi3| if self.version == FmiVersion::Fmi2 { fmi2 } else { fmi3 };
        let operation = |name| self.version.function(name).unwrap_or_default();
        let replacements = [
            ("@VERSION@", self.version.as_str()),
            ("@MODEL@", self.identifier),
            ("@PREFIX@", &format!("{}_", self.identifier)),
            ("@ARGUMENTS@", &ARGUMENTS.to_string()),
            ("@SCHEDULED@", if self.is_scheduled { SCHEDULED_HOST } else { "" }),
            ("@NOT_SCHEDULED@", if self.is_scheduled { ", NULL, NULL, NULL, 0" } else { "" }),
            ("@IS_SERIALIZED@", if self.is_serialized { "1" } else { "0" }),
            ("@FREE_STATE@", operation("free_fmu_state")),
            ("@DESERIALIZE_STATE@", operation("deserialize_fmu_state")),
            ("@SIZE_OF_STATE@", operation("serialized_fmu_state_size")),
            ("@SERIALIZE_STATE@", operation("serialize_fmu_state")),
            ("FMIX", of_version("FMI2", "FMI3")),
            ("fmiX", of_version("fmi2", "fmi3")),
        ];
        let fill = |text: String, (open, value): (&str, &str)| text.replace(open, value);
        replacements.into_iter().fold(text.to_owned(), fill)
    }

    /// The functions in the file.
    fn signatures(&self) -> impl Iterator<Item = &'static Signature> {
        let all = self.version.signatures().iter();
        all.filter(|signature| self.has(signature.function.group))
    }

    /// Whether the functions of a group are in the file. Importers bind the function of scheduled execution anyway, and
    /// FMPy all functions for scheduled execution alone.
    fn has(&self, group: FunctionGroup) -> bool {
        let interface_type = match group {
            FunctionGroup::ModelExchange => InterfaceType::ModelExchange,
            FunctionGroup::CoSimulation => InterfaceType::CoSimulation,
            FunctionGroup::All | FunctionGroup::Clocks | FunctionGroup::ScheduledExecution => {
                return true;
            }
        };
        matches!(self.interface_types, [] | [InterfaceType::ScheduledExecution])
            || self.interface_types.contains(&interface_type)
    }

    /// The macros that give functions their names with the prefix.
    fn names(&self) -> String {
        let mut text = String::new();
        for Signature { function, .. } in self.signatures() {
            let name = function.name;
            let _ = writeln!(text, "#define {name} fmiXFullName({name})");
        }
        text + "\n#endif\n\n"
    }

    /// The functions that have an instance.
    fn functions(&self) -> String {
        let mut text = String::new();
        let mut group = None;
        for signature in self.signatures().filter(|signature| signature.has_instance) {
            if group.replace(signature.function.group) != Some(signature.function.group) {
                let what = match signature.function.group {
                    FunctionGroup::All => "all types of FMUs",
                    FunctionGroup::Clocks => "clocks",
                    FunctionGroup::ModelExchange => "model exchange",
                    FunctionGroup::CoSimulation => "co-simulation",
                    FunctionGroup::ScheduledExecution => "scheduled execution",
                };
                let title = format!("/* --- Functions of {what} ");
                let _ = writeln!(text, "{title:-<103} */\n");
            }
            text += &Function { of: self, version: self.version, signature }.text();
        }
        text
    }
}

/// What an instance of scheduled execution keeps of the host.
const SCHEDULED_HOST: &str = "    fmi3ClockUpdateCallback clock_update;
    fmi3LockPreemptionCallback lock_preemption;
    fmi3UnlockPreemptionCallback unlock_preemption;
    int is_in_use; /* whether a call uses the instance */
";

/// Resources (bytes) that are put into the program at most.
const MOST_RESOURCES: usize = 256 << 10;

/// The text of `resources.h`: the files for programs without a file system.
pub fn resources(files: &[NamedFile]) -> String {
    let mut text =
        "/* The resources, for programs that are compiled with FMU_NO_FILES. */\n\n".to_owned();
    if files.iter().map(|(_, content)| content.len()).sum::<usize>() > MOST_RESOURCES {
        return text + "#error \"the resources are too large for a program: more than 256 KiB\"\n";
    }
    let mut rows = String::new();
    for (i, (name, content)) in files.iter().enumerate() {
        let _ = writeln!(text, "static const uint8_t resource_{i}[] = {{");
        // C has no empty arrays.
        for line in if content.is_empty() { &[0][..] } else { content }.chunks(24) {
            let numbers: Vec<String> = line.iter().map(u8::to_string).collect();
            let _ = writeln!(text, "    {},", numbers.join(", "));
        }
        text += "};\n\n";
        let name: String = name
            .bytes()
            .map(|byte| match byte {
                b' '..=b'~' if !b"\"\\?".contains(&byte) => char::from(byte).to_string(),
                byte => format!("\\{byte:03o}"),
            })
            .collect();
        let _ = writeln!(rows, "    {{\"{name}\", resource_{i}, {}}},", content.len());
    }
    text + "static const Resource resources[] = {\n" + &rows + "    {\"\", NULL, 0},\n};\n"
}

/// A function of an instance.
struct Function<'a> {
    of: &'a Interface<'a>,
    version: FmiVersion,
    signature: &'static Signature,
}

impl Function<'_> {
    fn text(&self) -> String {
        let FmiFunctionNames { prefix, export, instance } = FmiFunctionNames::of(self.version);
        let name = self.signature.function.name;
        let mut parameters = vec![format!("{instance} instance")];
        parameters.extend(self.arguments().map(|argument| self.parameter(argument)));
        let head = match self.of.is_scheduled {
            true => format!("static {prefix}Status {name}_in_lock("),
            false => format!("{export} {prefix}Status {name}("),
        };
        let body = match self.is_unsupported() {
            true => self.refusal(),
            false => self.call(),
        };
        let call = format!("    Call call = {{instance, \"{name}\", {prefix}Error, 0}};\n");
        let text = format!(
            "{}\n{{\n{call}{body}    return call.status;\n}}\n\n",
            wrapped(&head, &parameters, ")")
        );
        if !self.of.is_scheduled {
            return text;
        }
        let head = wrapped(&format!("{export} {prefix}Status {name}("), &parameters, ")");
        let mut passed = vec!["instance".to_owned()];
        passed.extend(self.arguments().map(|argument| argument.name.to_owned()));
        let inner = wrapped(&format!("        call.status = {name}_in_lock("), &passed, ");");
        format!(
            "{text}{head}\n{{\n{call}    if (lock(&call)) {{\n{inner}\n        unlock(instance);\n    }}\n    return call.status;\n}}\n\n"
        )
    }

    fn arguments(&self) -> impl Iterator<Item = &'static Argument> {
        self.signature.arguments.iter()
    }

    /// Whether the models have no such ability.
    fn is_unsupported(&self) -> bool {
        match self.signature.function.group {
            FunctionGroup::Clocks => !self.of.has_clocks,
            FunctionGroup::ScheduledExecution => !self.of.is_scheduled,
            _ => self.signature.function.states == 0,
        }
    }

    /// The declaration of an argument.
    fn parameter(&self, Argument { name, kind }: &Argument) -> String {
        match *kind {
            ArgumentKind::InArray { element, .. } => {
                format!("const {} {name}[]", self.c_type(name, element))
            }
            ArgumentKind::OutArray { element, .. } => {
                format!("{} {name}[]", self.c_type(name, element))
            }
            ArgumentKind::Length => format!("size_t {name}"),
            ArgumentKind::Out(of) => format!("{} *{name}", self.c_type(name, of)),
            ArgumentKind::Pointer(to) => format!("const {} *{name}", self.c_type(name, to)),
            ArgumentKind::Callback(of) | ArgumentKind::Value(of) => {
                format!("{} {name}", self.c_type(name, of))
            }
        }
    }

    /// The type in C, by the name that the standard has for it.
    fn c_type(&self, argument: &str, in_row: &str) -> String {
        let prefix = FmiFunctionNames::of(self.version).prefix;
        let name = match (self.version, in_row) {
            (_, "usize") => return "size_t".into(),
            (_, "u32") if argument != "values" => "ValueReference",
            (FmiVersion::Fmi2, "f64") => "Real",
            (FmiVersion::Fmi2, "i32") => "Integer",
            (_, "f32") => "Float32",
            (_, "f64") => "Float64",
            (_, "i8") => "Int8",
            (_, "u8") if argument == "bytes" => "Byte",
            (_, "u8") => "UInt8",
            (_, "i16") => "Int16",
            (_, "u16") => "UInt16",
            (_, "i32") => "Int32",
            (_, "u32") => "UInt32",
            (_, "i64") => "Int64",
            (_, "u64") => "UInt64",
            (_, named) => return named.into(),
        };
        format!("{prefix}{name}")
    }

    /// The body of a function that no model has.
    fn refusal(&self) -> String {
        let mut text: String =
            self.arguments().map(|argument| format!("    (void){};\n", argument.name)).collect();
        let zeros = vec!["0".to_owned(); self.signature.arguments.len()];
        text += "    if (enter(&call, 0))\n";
        text += &match self.signature.function.group {
            FunctionGroup::ScheduledExecution => {
                "        refuse(&call, NO_SCHEDULED_EXECUTION);\n".to_owned()
            }
            _ => format!("{};\n", self.call_of_model(8, zeros)),
        };
        text
    }

    /// The body of a function that calls the model.
    fn call(&self) -> String {
        let passed: Vec<Passed> = self.arguments().map(|argument| self.passed(argument)).collect();
        let mut text = String::new();
        let states: Vec<_> = passed.iter().filter_map(|passed| passed.state).collect();
        for state in &states {
            let _ = writeln!(text, "    uint32_t {state}_at;");
            let _ = writeln!(text, "    if (!in_state(&call, {state}, &{state}_at))");
            let _ = writeln!(text, "        return call.status;");
        }
        // A host may have more room than the state needs.
        for bytes in self.arguments().filter(|argument| is_room_for_state(argument)) {
            let ArgumentKind::OutArray { length, .. } = bytes.kind else { continue };
            let size = "size_of_state(&call, state, state_at)";
            let _ = writeln!(text, "    if ({length} > {size})");
            let _ = writeln!(text, "        {length} = {size};");
        }
        let space: Vec<&str> = passed.iter().filter_map(|passed| passed.space.as_deref()).collect();
        let sum = if space.is_empty() { "0".to_owned() } else { space.join(" + ") };
        let mut body = String::new();
        for Passed { before, .. } in &passed {
            body.extend(before.iter().map(|line| format!("        {line}\n")));
        }
        let values = passed.iter().map(|passed| passed.value.clone()).collect();
        let call = self.call_of_model(8, values);
        let (alive, ok): (Vec<_>, Vec<_>) =
            passed.iter().filter_map(|passed| passed.after.as_ref()).partition(|a| a.is_always);
        match alive.is_empty() {
            true => body += &format!("{call};\n"),
            false => {
                let _ = writeln!(body, "        if ({}) {{", call.trim_start());
                body.extend(alive.iter().map(|after| format!("            {}\n", after.line)));
                body += "        }\n";
            }
        }
        if !ok.is_empty() {
            let prefix = FmiFunctionNames::of(self.version).prefix;
            let lines: String =
                ok.iter().map(|after| format!("            {}\n", after.line)).collect();
            match ok.len() {
                1 => {
                    let _ = write!(body, "        if (call.status == {prefix}OK)\n{lines}");
                }
                _ => {
                    let _ = write!(
                        body,
                        "        if (call.status == {prefix}OK) {{\n{lines}        }}\n"
                    );
                }
            }
        }
        text += &match body.lines().count() {
            1 => format!("    if (enter(&call, {sum}))\n{body}"),
            _ => format!("    if (enter(&call, {sum})) {{\n{body}    }}\n"),
        };
        for state in states {
            let _ = writeln!(text, "    end_state(&call, {state}_at);");
        }
        text
    }

    /// The call of the model's function, which ends the call of the host.
    fn call_of_model(&self, indent: usize, values: Vec<String>) -> String {
        let mut all = vec!["&call.instance->model".to_owned(), "call.instance->handle".to_owned()];
        all.extend(values);
        let head =
            format!("{}leave(&call, MODEL({})(", " ".repeat(indent), self.signature.function.name);
        wrapped(&head, &all, "))")
    }

    /// How an argument is passed to the model.
    fn passed(&self, Argument { name, kind }: &Argument) -> Passed {
        let size = format!("sizeof *{name}");
        let at = format!("{name}_at");
        let declare = |how: String| vec![format!("const uint32_t {at} = {how};")];
        let always = |line: String| Some(After { line, is_always: true });
        let if_ok = |line: String| Some(After { line, is_always: false });
        let sizes = self.arguments().find(|argument| argument.name == "sizes").map(|_| "sizes");
        let (space, before, after) = match *kind {
            ArgumentKind::Length | ArgumentKind::Value("fmi2StatusKind") => {
                return Passed::value(format!("(uint32_t){name}"));
            }
            ArgumentKind::Value("fmi2FMUstate" | "fmi3FMUState") => {
                return Passed { state: Some(name), ..Passed::value(at) };
            }
            ArgumentKind::Value("fmi2Boolean" | "fmi3Boolean") => {
                return Passed::value(format!("{name} != 0"));
            }
            ArgumentKind::Value(_) | ArgumentKind::Pointer(_) | ArgumentKind::Callback(_) => {
                return Passed::value((*name).to_owned());
            }
            ArgumentKind::InArray { element: "fmi2String" | "fmi3String", length } => (
                format!("space_of_strings({name}, {length})"),
                format!("in_strings(&call, {name}, {length})"),
                None,
            ),
            ArgumentKind::OutArray { element: "fmi2String" | "fmi3String", length } => (
                format!("space({length}, 4)"),
                format!("out_array(&call, {name}, {length}, 4)"),
                if_ok(format!("get_strings(&call, {at}, {name}, {length});")),
            ),
            ArgumentKind::InArray { element: "fmi3Binary", length } => {
                let sizes = sizes.unwrap_or("NULL");
                (
                    format!("space_of_binaries({sizes}, {name}, {length})"),
                    format!("in_binaries(&call, {sizes}, {name}, {length})"),
                    None,
                )
            }
            ArgumentKind::OutArray { element: "fmi3Binary", length } => (
                format!("space({length}, 4)"),
                format!("out_array(&call, {name}, {length}, 4)"),
                if_ok(format!("get_binaries(&call, {at}, {name}, {length});")),
            ),
            ArgumentKind::InArray { element: "usize", length } => {
                (format!("space({length}, 4)"), format!("in_sizes(&call, {name}, {length})"), None)
            }
            ArgumentKind::OutArray { element: "usize", length } => (
                format!("space({length}, 4)"),
                format!("out_array(&call, {name}, {length}, 4)"),
                if_ok(format!("get_sizes(&call, {at}, {name}, {length});")),
            ),
            ArgumentKind::InArray { length: length @ "n_values", .. } => (
                format!("space({length}, {size})"),
                format!("in_values(&call, references_at, n, {name}, {length}, {size})"),
                None,
            ),
            ArgumentKind::InArray { length, .. } => (
                format!("space({length}, {size})"),
                format!("in_array(&call, {name}, {length}, {size})"),
                None,
            ),
            ArgumentKind::OutArray { length, .. } => (
                format!("space({length}, {size})"),
                format!("out_array(&call, {name}, {length}, {size})"),
                if_ok(format!("get_array(&call, {at}, {name}, {length}, {size});")),
            ),
            ArgumentKind::Out("usize") => (
                "space(1, 4)".into(),
                format!("out_array(&call, {name}, 1, 4)"),
                if_ok(format!("get_sizes(&call, {at}, {name}, 1);")),
            ),
            ArgumentKind::Out("fmi2String") => (
                "space(1, 4)".into(),
                format!("out_array(&call, {name}, 1, 4)"),
                if_ok(format!("get_strings(&call, {at}, {name}, 1);")),
            ),
            ArgumentKind::Out("fmi2Status") => (
                "space(1, 4)".into(),
                format!("out_array(&call, {name}, 1, 4)"),
                if_ok(format!(
                    "*{name} = (fmi2Status)model_load_u32(&call.instance->model, {at});"
                )),
            ),
            ArgumentKind::Out("fmi2EventInfo") => (
                "space(4, 8)".into(),
                format!("in_event_info(&call, {name})"),
                if_ok(format!("get_event_info(&call, {at}, {name});")),
            ),
            ArgumentKind::Out("fmi2FMUstate" | "fmi3FMUState") => (
                "space(1, 4)".into(),
                format!("in_state_variable(&call, {name})"),
                if_ok(format!("get_state_variable(&call, {at}, {name});")),
            ),
            // A function may set its results though it fails.
            ArgumentKind::Out(_) => (
                format!("space(1, {size})"),
                format!("in_array(&call, {name}, 1, {size})"),
                always(format!("get_array(&call, {at}, {name}, 1, {size});")),
            ),
        };
        Passed { space: Some(space), before: declare(before), after, ..Passed::value(at) }
    }
}

/// Whether an argument is where a state is serialized.
fn is_room_for_state(argument: &Argument) -> bool {
    argument.name == "bytes" && matches!(argument.kind, ArgumentKind::OutArray { .. })
}

/// How an argument is passed.
struct Passed {
    /// What it is for the model.
    value: String,
    /// The room that it takes in the memory of the model.
    space: Option<String>,
    /// Lines before the call.
    before: Vec<String>,
    after: Option<After>,
    /// The name of an argument that is a state, which is passed first.
    state: Option<&'static str>,
}

impl Passed {
    fn value(value: String) -> Self {
        Self { value, space: None, before: Vec::new(), after: None, state: None }
    }
}

/// What returns a result to the host.
struct After {
    line: String,
    /// Whether also after an error.
    is_always: bool,
}

/// Names that depend on the version.
struct FmiFunctionNames {
    prefix: &'static str,
    export: &'static str,
    instance: &'static str,
}

impl FmiFunctionNames {
    fn of(version: FmiVersion) -> Self {
        match version {
            FmiVersion::Fmi2 => {
                Self { prefix: "fmi2", export: "FMI2_Export", instance: "fmi2Component" }
            }
            FmiVersion::Fmi3 => {
                Self { prefix: "fmi3", export: "FMI3_Export", instance: "fmi3Instance" }
            }
        }
    }
}

/// A list with commas, in lines of the usual width.
fn wrapped(head: &str, items: &[String], end: &str) -> String {
    const WIDTH: usize = 115;
    let indent = head.len();
    let (mut text, mut column) = (head.to_owned(), head.len());
    for (i, item) in items.iter().enumerate() {
        let last = i + 1 == items.len();
        let piece = if last { format!("{item}{end}") } else { format!("{item},") };
        if i > 0 && column + 1 + piece.len() > WIDTH {
            let _ = write!(text, "\n{}", " ".repeat(indent));
            column = indent;
        } else if i > 0 {
            text.push(' ');
            column += 1;
        }
        text += &piece;
        column += piece.len();
    }
    text
}

#[cfg(test)]
mod tests;
