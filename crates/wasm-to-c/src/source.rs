//! The two files, `model.h` and `model.c`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use wasmparser::{FuncType, ValType};

use crate::Error;
use crate::calls::Calls;
use crate::data::{literal, rows, string};
use crate::expression::signature;
use crate::facts::Arguments;
use crate::function::Function;
use crate::module::Module;
use crate::names::{Identifiers, mentions, rust_path, sanitized};

const HEADER: &str = include_str!("model.h");
const HEAD: &str = include_str!("head.c");
const RUNTIME: &str = include_str!("runtime.c");

/// How often functions are translated at most, to know more of their arguments.
const TURNS: usize = 4;

/// How a module is translated.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// What the symbols for the linker begin with, such as `Pid_model_`.
    pub prefix: String,
    /// What the model is, for the comments at the top, such as `Pid, a PID controller`.
    pub description: String,
}

/// A module in C.
#[derive(Clone, Debug)]
pub struct CSource {
    /// The text of `model.h`.
    pub header: String,
    /// The text of `model.c`.
    pub source: String,
    /// The size in bytes of the memory of an instance.
    pub memory_size: u64,
    /// The names of the functions that the module imports and calls, with the names of their modules before.
    pub imports: Vec<(String, String)>,
}

/// Translates a module.
///
/// # Errors
///
/// Returns an error if the module is invalid, or needs what is not translated: memory that is imported or shared,
/// tables that change, passive data, several results, vectors, exceptions, garbage collection.
pub fn translate(module: &[u8], options: &Options) -> Result<CSource, Error> {
    let mut module = Module::parse(module)?;
    let calls = Calls::new(&module)?;
    // Without a heap of its own, a model has no use for the rest of the last page.
    if let (Some(end), false) = (module.heap_base, calls.uses_pages) {
        module.memory_size = module.memory_size.min(u64::from(end).next_multiple_of(16));
    }
    let module = module;
    let (names, paths) = name_functions(&module, &calls);
    let exports = name_exports(&module)?;

    // Each turn knows more of the arguments than the one before.
    let (mut arguments, mut functions) = (Arguments::default(), Vec::new());
    for _ in 0..TURNS {
        let mut passed = Arguments::default();
        functions.clear();
        for &index in &calls.order {
            functions.push(Function::translate(
                &module,
                &calls,
                &names,
                &arguments,
                &mut passed,
                index,
            )?);
        }
        for &index in module.exports.iter().map(|(_, index)| index).chain(&module.start) {
            passed.forget(index);
        }
        for &index in calls.pointers.values().flat_map(BTreeMap::keys) {
            passed.forget(index);
        }
        if arguments == passed {
            break;
        }
        arguments = passed;
    }

    let mut body = String::new();
    let (mut defined, mut described) = (BTreeSet::new(), BTreeSet::new());
    let mut definitions = String::new();
    let mut early = BTreeSet::new();
    for (&index, definition) in calls.order.iter().zip(&functions) {
        // The names of functions with the same path differ only in their numbers.
        if let Some(path) = paths.get(&index).filter(|path| described.insert(*path)) {
            let _ = writeln!(definitions, "/* {} */", path.replace("*/", "* /"));
        }
        let _ = writeln!(definitions, "{definition}");
        defined.insert(index);
        early.extend(calls.callees(index).filter(|callee| !defined.contains(callee)));
    }
    for index in early {
        let signature = signature(
            &names[&index],
            calls.traits[&index].needs_model,
            module.function_type(index),
        );
        let _ = writeln!(body, "static {signature};");
    }
    let (prototypes, dispatchers) = dispatchers(&module, &calls, &names);
    let _ = write!(body, "{prototypes}\n{definitions}{dispatchers}");

    let mut declarations = String::new();
    for (name, index) in &exports {
        let function_type = module.function_type(*index);
        let signature = signature(&format!("MODEL({name})"), true, function_type);
        let _ = writeln!(declarations, "{signature};");
        let traits = &calls.traits[index];
        let mut arguments: Vec<String> =
            (0..function_type.params().len()).map(|i| format!("a{i}")).collect();
        if traits.needs_model {
            arguments.insert(0, "m".into());
        }
        let call = format!("{}({});", names[index], arguments.join(", "));
        let (zero, call) = match function_type.results() {
            [] => ("return;", call),
            _ => ("return 0;", format!("return {call}")),
        };
        let _ = write!(body, "{signature} {{\n\tif (m->trap) {zero}\n\t{call}\n}}\n\n");
    }
    body.push_str(&initialization(&module, &calls, &names));

    let imports = (0..).zip(&module.imports).filter(|(index, _)| calls.traits.contains_key(index));
    let imports: Vec<_> = imports.collect();
    let mut imported = String::new();
    for &(index, _) in &imports {
        let _ =
            writeln!(imported, "{};", signature(&names[&index], true, module.function_type(index)));
    }
    let mut globals = String::new();
    for (index, global) in module.globals.iter().enumerate() {
        let _ = writeln!(globals, "    {} g{index};", header_type(global.value_type));
    }
    let header = HEADER
        .replace("@DESCRIPTION@", &options.description.replace("*/", "* /"))
        .replace("@PREFIX@", &options.prefix)
        .replace("@MEMORY_SIZE@", &format!("{}u", module.memory_size))
        .replace("@GLOBALS@", &globals)
        .replace("@EXPORTS@", &header_types(&declarations))
        .replace("@IMPORTS@", &header_types(&imported));
    let head = HEAD.replace("@DESCRIPTION@", &options.description.replace("*/", "* /"));
    Ok(CSource {
        header,
        source: format!("{head}\n{}{body}", runtime(&body)),
        memory_size: module.memory_size,
        imports: imports
            .iter()
            .map(|(_, import)| (import.module.to_owned(), import.name.to_owned()))
            .collect(),
    })
}

fn header_type(value_type: ValType) -> &'static str {
    match value_type {
        ValType::I32 => "uint32_t",
        ValType::I64 => "uint64_t",
        ValType::F32 => "float",
        _ => "double",
    }
}

/// Declarations with the types of C, since the header defines no short names.
fn header_types(declarations: &str) -> String {
    let types =
        [("u32 ", "uint32_t "), ("u64 ", "uint64_t "), ("f32 ", "float "), ("f64 ", "double ")];
    types.iter().fold(declarations.to_owned(), |text, (short, long)| {
        text.lines().map(|line| replace_types(line, short, long) + "\n").collect()
    })
}

fn replace_types(line: &str, short: &str, long: &str) -> String {
    let line =
        line.strip_prefix(short).map_or_else(|| line.to_owned(), |rest| format!("{long}{rest}"));
    line.replace(&format!("({short}"), &format!("({long}"))
        .replace(&format!(", {short}"), &format!(", {long}"))
}

/// The identifiers of all functions that are used, and the paths of those that have a name.
fn name_functions(
    module: &Module,
    calls: &Calls,
) -> (BTreeMap<u32, String>, BTreeMap<u32, String>) {
    let reserved = [HEAD, RUNTIME]
        .into_iter()
        .flat_map(|text| text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_'));
    let mut identifiers = Identifiers::new(reserved);
    let (mut names, mut paths) = (BTreeMap::new(), BTreeMap::new());
    for (index, import) in (0..).zip(&module.imports) {
        let name = identifiers.unique(format!("import_{}", sanitized(import.name)));
        names.insert(index, format!("MODEL({name})"));
    }
    for &index in &calls.order {
        let path = module.names.get(&index).map(|symbol| rust_path(symbol));
        names.insert(index, identifiers.of_path(path.as_deref().unwrap_or_default()));
        paths.extend(path.map(|path| (index, path)));
    }
    (names, paths)
}

/// The exported functions with their names in C.
fn name_exports(module: &Module) -> Result<Vec<(String, u32)>, Error> {
    let mut exports = BTreeMap::new();
    for &(name, index) in &module.exports {
        let identifier = sanitized(name);
        if identifier == "init"
            || identifier.starts_with("import_")
            || exports.insert(identifier, index).is_some()
        {
            return Err(Error(format!(
                "the module exports {name:?}, and another function has the same name in C"
            )));
        }
    }
    Ok(exports.into_iter().collect())
}

/// The prototypes and the definitions of a function for each type by which the module calls function pointers.
fn dispatchers(module: &Module, calls: &Calls, names: &BTreeMap<u32, String>) -> (String, String) {
    let (mut prototypes, mut text) = (String::new(), String::new());
    for (&type_index, functions) in &calls.pointers {
        let function_type = &module.types[type_index as usize];
        let returns = !function_type.results().is_empty();
        let types = [&[ValType::I32], function_type.params()].concat();
        let pointer_type = FuncType::new(types, function_type.results().to_vec());
        let head = format!(
            "static {}",
            signature(&format!("call_pointer_{type_index}"), true, &pointer_type)
        );
        let _ = writeln!(prototypes, "{head};");
        let _ = writeln!(
            text,
            "/* Calls the function to which a0 points. */\n{head} {{\n\tswitch (a0) {{"
        );
        for (function, places) in functions {
            let mut arguments: Vec<String> =
                (1..=function_type.params().len()).map(|i| format!("a{i}")).collect();
            if calls.traits[function].needs_model {
                arguments.insert(0, "m".into());
            }
            let labels: Vec<String> = places.iter().map(|place| format!("case {place}:")).collect();
            let call = format!("{}({});", names[function], arguments.join(", "));
            let call = if returns { format!("return {call}") } else { format!("{call} return;") };
            let _ = writeln!(text, "\t{} {call}", labels.join(" "));
        }
        text.push_str("\t}\n");
        for i in (1..=function_type.params().len()).filter(|_| functions.is_empty()) {
            let _ = writeln!(text, "\t(void)a{i};");
        }
        let _ = writeln!(text, "\tTRAP(CALL);{}\n}}\n", if returns { " return 0;" } else { "" });
    }
    (prototypes, text)
}

/// The function that initializes an instance.
fn initialization(module: &Module, calls: &Calls, names: &BTreeMap<u32, String>) -> String {
    let mut lines = String::new();
    for (index, global) in module.globals.iter().enumerate() {
        let _ = writeln!(lines, "\tm->g{index} = {};", literal(global.value_type, global.value).0);
    }
    let rows = module.segments.iter().flat_map(|segment| rows(segment.address, segment.bytes));
    for row in rows {
        let pieces = row.bytes.chunks(64).map(|piece| format!("\"{}\"", string(piece)));
        let bytes = pieces.collect::<Vec<_>>().join("\n\t\t");
        let size = row.bytes.len();
        let _ = writeln!(lines, "\tmemcpy(m->memory + {}, {bytes}, {size});", row.address);
    }
    if let Some(start) = module.start {
        let model = if calls.traits[&start].needs_model { "m" } else { "" };
        let _ = writeln!(lines, "\t{}({model});", names[&start]);
    }
    format!(
        "void MODEL(init)(Model *m) {{\n\tm->trap = MODEL_TRAP_NONE;\n\tm->depth = 0;\n\t\
         m->pages = {};\n\tmemset(m->memory, 0, MODEL_MEMORY_SIZE);\n{lines}}}\n",
        module.pages
    )
}

/// The parts of the runtime that the text needs, in their order.
fn runtime(text: &str) -> String {
    let chunks: Vec<&str> = RUNTIME.split("\n\n").collect();
    let mut needed = BTreeSet::from([0]);
    let mut texts = vec![text];
    while let Some(text) = texts.pop() {
        for (index, chunk) in chunks.iter().enumerate().skip(1) {
            if !needed.contains(&index) && definitions(chunk).any(|name| mentions(text, name)) {
                needed.insert(index);
                texts.push(chunk);
            }
        }
    }
    needed.iter().fold(String::new(), |all, &index| all + chunks[index].trim_end() + "\n\n")
}

/// The functions and macros that a part of the runtime defines.
fn definitions(chunk: &str) -> impl Iterator<Item = &str> {
    let heads = chunk
        .lines()
        .filter(|line| line.starts_with("static inline") || line.starts_with("#define"));
    heads.filter_map(|line| line.split('(').next()?.rsplit([' ', '*']).next())
}
