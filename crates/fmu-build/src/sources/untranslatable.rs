//! What a model needs that C sources do not have: functions that are not written in Rust, and the parts of the
//! standard library that need an operating system. On WebAssembly these parts are there, but fail or do nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::Path;

use anyhow::{Error, Result, anyhow, bail};
use rustc_demangle::demangle;
use wasmparser::{
    KnownCustom, Name, NameSectionReader, Naming, Operator, Parser, Payload, TypeRef,
};

/// Compiler arguments for a library in which every call can be seen. An optimized one has no calls of functions that
/// only fail, and nothing that follows a call which never returns.
pub const EVERY_CALL: [&str; 3] = ["-Copt-level=0", "-Cstrip=none", "-Clink-arg=--allow-undefined"];

/// The module of the functions that C sources do have.
const HOST: &str = "fmu";

/// Functions of the standard library: the beginning of their paths, their names if not all, and what to do instead.
const UNAVAILABLE: [(&str, &[&str], &str); 8] = [
    ("std::time::", &["now", "elapsed"], "time: the arguments of `step`, or an input"),
    ("std::thread::", &THREADS, "threads: the work in `step` itself"),
    ("std::fs::", &[], FILES),
    ("std::path::Path::", &PATHS, FILES),
    ("std::io::stdio::", &["stdin"], FILES),
    ("std::net::", &[], "network: an input"),
    ("std::process::", &["exit", "id", "new"], "processes: a `ModelError`, which ends the run"),
    ("std::env::", &[], "environment: a parameter"),
];
const FILES: &str = "files: a resource of the FMU, by `read_resource` in `initialize`";
const FOREIGN: &str = "other languages: a function in Rust, or in C that the build script compiles";
/// What the optimizer leaves of a function that starts a thread.
const SPAWN_HOOKS: &str = "run_spawn_hooks";
const THREADS: [&str; 9] = [
    SPAWN_HOOKS,
    "available_parallelism",
    "park",
    "park_timeout",
    "scope",
    "sleep",
    "sleep_until",
    "spawn",
    "spawn_scoped",
];
const PATHS: [&str; 10] = [
    "canonicalize",
    "exists",
    "is_dir",
    "is_file",
    "is_symlink",
    "metadata",
    "read_dir",
    "read_link",
    "symlink_metadata",
    "try_exists",
];
/// How many callers in a crate are named.
const NAMED: usize = 3;

/// Checks that a model needs nothing that C sources do not have. The module is its library, built with [`EVERY_CALL`].
///
/// # Errors
/// It does. The message has all of it, the crates and functions that call it, and what to use instead.
pub fn check(module: &[u8]) -> Result<()> {
    let functions = Functions::read(module)?;
    // What is needed, with its callers by their crates.
    let mut needed: BTreeMap<String, BTreeMap<&str, BTreeSet<String>>> = BTreeMap::new();
    let mut instead = BTreeSet::new();
    for (index, name) in functions.names.iter().enumerate() {
        let (title, advice) = match (functions.foreign.contains(&index), instead_of(name)) {
            (true, _) => (format!("{name} of another language"), FOREIGN),
            (false, Some(advice)) if functions.is_called_by_others(index) => (public(name), advice),
            _ => continue,
        };
        instead.insert(advice);
        let callers = needed.entry(title).or_default();
        for caller in functions.authors_that_call(index) {
            callers.entry(crate_of(caller)).or_default().insert(short(caller));
        }
    }
    if needed.is_empty() {
        return Ok(());
    }
    let mut text = String::new();
    for (title, callers) in needed {
        if callers.is_empty() {
            let _ = write!(text, "\n  {title}");
        }
        for (name, callers) in callers {
            let named = Vec::from_iter(callers.iter().take(NAMED).cloned()).join(" and ");
            let more = if callers.len() > NAMED { " and others" } else { "" };
            let _ = match name == named {
                true => write!(text, "\n  {title}, which {name} calls"),
                false => write!(text, "\n  {title}, which the crate {name} calls in {named}{more}"),
            };
        }
    }
    let instead = Vec::from_iter(instead).join("\n  ");
    bail!(
        "the model needs what C sources do not have:{text}\nUse instead of\n  {instead}\nor export binaries"
    )
}

/// Puts an empty library into a folder for each one that the linker did not find. With these, the build shows which of
/// their functions the model needs. Returns whether there is any.
///
/// # Errors
/// The folder cannot be written.
pub fn stand_in_for_libraries(error: &Error, folder: &Path) -> Result<bool> {
    let text = error.to_string();
    let names = text.split("unable to find library -l").skip(1);
    let names = Vec::from_iter(names.filter_map(|rest| rest.split_whitespace().next()));
    for name in &names {
        fs::write(folder.join(format!("lib{name}.a")), "!<arch>\n")?;
    }
    Ok(!names.is_empty())
}

/// Says in short why the C code of a build script does not compile for C sources.
pub fn explain(error: Error) -> Error {
    let text = error.to_string();
    let package = text.split_once("custom build command for `").map_or("", |(_, rest)| rest);
    let package = package.split([' ', '`']).next().unwrap_or(package);
    let header = text.split_once("fatal error: '").and_then(|(_, rest)| rest.split_once("' file"));
    match header {
        _ if text.contains("failed to find tool \"clang") => anyhow!(
            "the build script of the package {package} compiles C code; for C sources, it needs clang:
  apt-get install clang    # Debian, Ubuntu
  dnf install clang    # Fedora
  brew install llvm    # macOS"
        ),
        Some((header, _)) => anyhow!(
            "the C code of the package {package} includes {header}, but C sources have no C library; write it in Rust, or export binaries"
        ),
        None => error,
    }
}

/// The functions of a module, by their indices.
struct Functions {
    /// Their paths in Rust.
    names: Vec<String>,
    /// Those that the host would have to provide.
    foreign: BTreeSet<usize>,
    callers: Vec<BTreeSet<usize>>,
}

impl Functions {
    fn read(module: &[u8]) -> Result<Self> {
        let mut names = Vec::new();
        let mut foreign = BTreeSet::new();
        let mut calls = Vec::new();
        let mut imported = 0;
        for payload in Parser::new(0).parse_all(module) {
            match payload? {
                Payload::ImportSection(imports) => {
                    for import in imports {
                        let import = import?;
                        if matches!(import.ty, TypeRef::Func(_)) {
                            if import.module != HOST {
                                foreign.insert(names.len());
                            }
                            names.push(import.name.to_owned());
                        }
                    }
                    imported = names.len();
                }
                Payload::CodeSectionEntry(body) => {
                    for operator in body.get_operators_reader()? {
                        if let Operator::Call { function_index } = operator? {
                            calls.push((names.len(), function_index as usize));
                        }
                    }
                    names.push(String::new());
                }
                Payload::CustomSection(section) => {
                    if let KnownCustom::Name(kinds) = section.as_known() {
                        for naming in function_names(kinds)? {
                            let index = naming.index as usize;
                            if let Some(name) = names.get_mut(index).filter(|_| index >= imported) {
                                *name = plain(&format!("{:#}", demangle(naming.name)));
                            }
                        }
                    }
                }
                _ => {}
            }
        }
        let mut callers = vec![BTreeSet::new(); names.len()];
        for (caller, callee) in calls {
            if let Some(callers) = callers.get_mut(callee) {
                callers.insert(caller);
            }
        }
        Ok(Self { names, foreign, callers })
    }

    /// Whether a function of the standard library is called from outside of it.
    fn is_called_by_others(&self, function: usize) -> bool {
        self.callers[function].iter().any(|&caller| crate_of(&self.names[caller]) != "std")
    }

    /// The functions that call a function, directly or through generic ones of `core`.
    fn authors_that_call(&self, function: usize) -> BTreeSet<&str> {
        let (mut found, mut seen, mut next) = (BTreeSet::new(), BTreeSet::new(), vec![function]);
        while let Some(function) = next.pop() {
            for &caller in &self.callers[function] {
                let name = self.names[caller].as_str();
                match crate_of(name) {
                    "std" => {}
                    "core" | "alloc" if seen.insert(caller) => next.push(caller),
                    "core" | "alloc" => {}
                    _ => {
                        found.insert(name);
                    }
                }
            }
        }
        found
    }
}

fn function_names(kinds: NameSectionReader<'_>) -> Result<Vec<Naming<'_>>> {
    let mut names = Vec::new();
    for kind in kinds {
        if let Name::Function(map) = kind? {
            names.extend(map.into_iter().collect::<Result<Vec<_>, _>>()?);
        }
    }
    Ok(names)
}

/// What to do instead of calling a function that is not available.
fn instead_of(name: &str) -> Option<&'static str> {
    let last = name.rsplit("::").next()?;
    let is_meant = |names: &[&str]| names.is_empty() || names.contains(&last);
    let known =
        UNAVAILABLE.iter().find(|(path, names, _)| name.starts_with(path) && is_meant(names));
    known.filter(|_| !name.contains("{closure")).map(|(.., instead)| *instead)
}

/// The path of a function without its own type arguments, and `Type::f` instead of `<Type>::f`.
fn plain(name: &str) -> String {
    let name = name.split("::<").next().unwrap_or(name);
    match name.strip_prefix('<').filter(|name| !name.contains(" as ")) {
        Some(name) => name.replacen(">::", "::", 1),
        None => name.to_owned(),
    }
}

/// The path of an author's function: `Type::f` instead of `<Type as Trait>::f`, and without a closure in it.
fn short(name: &str) -> String {
    let name = name.split("::{").next().unwrap_or(name);
    match name.strip_prefix('<').and_then(|name| name.split_once(" as ")) {
        Some((kind, rest)) => format!("{kind}::{}", rest.rsplit("::").next().unwrap_or(rest)),
        None => name.to_owned(),
    }
}

/// The path by which users call a function of the standard library, without private modules.
fn public(name: &str) -> String {
    let name = name.strip_suffix("::inner").unwrap_or(name);
    let parts = Vec::from_iter(name.split("::"));
    let is_public = |(at, part): &(usize, &str)| {
        *at < 2 || at + 1 == parts.len() || part.starts_with(char::is_uppercase)
    };
    let kept = parts.iter().copied().enumerate().filter(is_public);
    let kept = kept.map(|(_, part)| part.trim_start_matches('_'));
    Vec::from_iter(kept.map(|part| if part == SPAWN_HOOKS { "spawn" } else { part })).join("::")
}

/// The crate of a path such as `a::b`, `<a::B as c::D>::e` or `<&mut a::B>::c`; the name of a function in C.
fn crate_of(name: &str) -> &str {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let name = name.trim_start_matches(|c| !is_word(c));
    name.split(|c| !is_word(c)).next().unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use wasm_encoder::{
        CodeSection, EntityType, Function, FunctionSection, ImportSection, Module, NameMap,
        NameSection, TypeSection,
    };

    use super::*;

    /// Checks a module of functions: an import of its module, and functions with the indices of those that they call.
    fn error(import: (&str, &str), functions: &[(&str, &[u32])]) -> Option<String> {
        let (mut types, mut imports) = (TypeSection::new(), ImportSection::new());
        types.ty().function([], []);
        imports.import(import.0, import.1, EntityType::Function(0));
        let (mut declared, mut code) = (FunctionSection::new(), CodeSection::new());
        let (mut names, mut section) = (NameMap::new(), NameSection::new());
        for ((name, calls), index) in functions.iter().zip(1..) {
            declared.function(0);
            names.append(index, name);
            let mut function = Function::new([]);
            calls.iter().for_each(|call| {
                function.instructions().call(*call);
            });
            function.instructions().end();
            code.function(&function);
        }
        section.functions(&names);
        let mut module = Module::new();
        module
            .section(&types)
            .section(&imports)
            .section(&declared)
            .section(&code)
            .section(&section);
        check(&module.finish()).err().map(|error| error.to_string())
    }

    const LOG: (&str, &str) = ("fmu", "log");
    /// Names as the compiler mangles them in its two ways.
    const STEP: &str =
        "_ZN49_$LT$own..Own$u20$as$u20$fmu_export..Simulate$GT$4step17h0123456789abcdefE";
    const CALL_ONCE: &str = "_ZN4core3ops8function6FnOnce9call_once17h0123456789abcdefE";
    const NOW: &str = "_RNvMNtCsebHcaeoSrxy_3std4timeNtB2_7Instant3now";
    const READ: &str = "_ZN3std2fs4read17h0123456789abcdefE";
    const PANIC: &str = "_ZN3std9panicking13panic_handler17h0123456789abcdefE";

    #[test]
    fn a_model_may_log_and_call_its_own_functions() {
        assert_eq!(error(LOG, &[(STEP, &[0, 2]), ("_ZN3own3now17h0123456789abcdefE", &[])]), None);
    }

    #[test]
    fn functions_of_other_languages_are_named_with_their_callers() {
        let message = error(("env", "pi_step"), &[(STEP, &[0])]).unwrap();
        let expected =
            "\n  pi_step of another language, which the crate own calls in own::Own::step\n";
        assert!(message.contains(expected), "{message}");
        let message = error(("env", "malloc"), &[("pi_new", &[0])]).unwrap();
        assert!(message.contains("malloc of another language, which pi_new calls\n"), "{message}");
    }

    #[test]
    fn what_needs_an_operating_system_is_found_through_generic_functions() {
        let message =
            error(LOG, &[(STEP, &[2, 4]), (CALL_ONCE, &[3]), (NOW, &[]), (READ, &[])]).unwrap();
        let by = "which the crate own calls in own::Own::step";
        for part in [
            format!("\n  std::fs::read, {by}\n  std::time::Instant::now, {by}\n"),
            "files: a resource of the FMU".to_owned(),
            "time: the arguments of `step`".to_owned(),
        ] {
            assert!(message.contains(&part), "{message}");
        }
        assert!(!message.contains("threads"), "{message}");
    }

    #[test]
    fn libraries_that_are_missing_are_replaced_by_empty_ones() {
        let folder = tempfile::tempdir().unwrap();
        let stand_in =
            |text: &str| stand_in_for_libraries(&anyhow!("{text}"), folder.path()).unwrap();
        assert!(!stand_in("error: cannot find type `Modl`"));
        let linker = "building own failed:\n  = note: rust-lld: error: unable to find library -lm\n          rust-lld: error: unable to find library -lgsl\n";
        assert!(stand_in(linker));
        for name in ["libm.a", "libgsl.a"] {
            assert!(folder.path().join(name).is_file(), "{name}");
        }
    }

    #[test]
    fn a_missing_compiler_or_header_for_c_code_is_named_with_the_package() {
        let text = "building own failed:\nerror: failed to run custom build command for `pump v0.1.0 (/pump)`\n  error occurred in cc-rs: failed to find tool \"clang\": No such file";
        let message = explain(anyhow!(text)).to_string();
        assert!(
            message.starts_with("the build script of the package pump compiles C code"),
            "{message}"
        );
        assert!(message.contains("apt-get install clang"), "{message}");
        let text = "failed to run custom build command for `pump v0.1.0 (/pump)`\n  cargo:warning=c/pump.c:1:10: fatal error: 'math.h' file not found\n";
        let message = explain(anyhow!(text)).to_string();
        assert!(message.starts_with("the C code of the package pump includes math.h"), "{message}");
        assert_eq!(explain(anyhow!("other")).to_string(), "other");
    }

    #[test]
    fn what_the_standard_library_needs_for_itself_is_no_error() {
        assert_eq!(error(LOG, &[(STEP, &[2]), (PANIC, &[3]), (READ, &[])]), None);
    }

    #[test]
    fn functions_of_the_standard_library_have_the_names_of_its_documentation() {
        for (name, expected) in [
            ("std::thread::functions::spawn", "std::thread::spawn"),
            ("std::thread::spawnhook::run_spawn_hooks", "std::thread::spawn"),
            ("std::net::tcp::TcpStream::connect", "std::net::TcpStream::connect"),
            ("std::fs::read::inner", "std::fs::read"),
            ("std::env::_var", "std::env::var"),
        ] {
            assert!(instead_of(name).is_some() || name.ends_with("inner"));
            assert_eq!(public(name), expected);
        }
        for available in [
            "std::thread::local::LocalKey::with",
            "std::thread::spawn::{{closure}}",
            "std::time::Duration::new",
        ] {
            assert_eq!(instead_of(available), None);
        }
    }
}
