//! The folder in which the sources of an FMU are compiled and linked.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result};
use fmu_description::FmiVersion;
use fmu_file::archive::Archive;
use object::Object;
use tempfile::TempDir;

use crate::compiler::{self, Call, CompileControl, Compiler, Compilers};
use crate::description::{Language, NeededLibrary, Recipe, SOURCES, SourceSet};
use crate::error::CompileError;
use crate::options::{CompilerFamily, CompilerOption};

/// The headers of the standard, which sources include.
const HEADERS: [(&str, &str); 6] = [
    ("fmi2FunctionTypes.h", include_str!("headers/fmi2FunctionTypes.h")),
    ("fmi2Functions.h", include_str!("headers/fmi2Functions.h")),
    ("fmi2TypesPlatform.h", include_str!("headers/fmi2TypesPlatform.h")),
    ("fmi3FunctionTypes.h", include_str!("headers/fmi3FunctionTypes.h")),
    ("fmi3Functions.h", include_str!("headers/fmi3Functions.h")),
    ("fmi3PlatformTypes.h", include_str!("headers/fmi3PlatformTypes.h")),
];

/// Makes functions have their plain names, without the prefix that sources define for static linking.
const NO_PREFIX: [&str; 2] = ["FMI2_OVERRIDE_FUNCTION_PREFIX", "FMI3_OVERRIDE_FUNCTION_PREFIX"];
/// What older copies of these headers do not have.
const KNOWS_NO_PREFIX: &str = "_OVERRIDE_FUNCTION_PREFIX";

/// The folders of a compilation, relative to the folder of the FMU.
const HEADER_FOLDER: &str = "../headers";
const OBJECT_FOLDER: &str = "../objects";

/// A folder in which an FMU is compiled.
pub struct Workshop<'a> {
    /// The unpacked FMU, in which the compiler runs.
    fmu: PathBuf,
    objects: PathBuf,
    compilers: Compilers,
    control: &'a CompileControl<'a>,
    deadline: Instant,
    /// What was left out of the build description.
    pub notes: Vec<String>,
    /// The commands, each with what the compiler printed.
    pub log: String,
    _folder: TempDir,
}

impl<'a> Workshop<'a> {
    /// Unpacks the sources and the libraries that they need to a temporary folder, and writes the headers of the standard.
    pub fn set_up(
        archive: &mut Archive,
        recipes: &[Recipe],
        control: &'a CompileControl<'a>,
    ) -> Result<Self> {
        let deadline = Instant::now() + control.time_limit;
        let folder = tempfile::Builder::new().prefix("fmu-").tempdir()?;
        let [fmu, objects, headers] =
            ["fmu", "objects", "headers"].map(|name| folder.path().join(name));
        for folder in [&headers, &objects, &fmu] {
            fs::create_dir_all(folder)?;
        }
        for (name, text) in HEADERS {
            fs::write(headers.join(name), text)?;
        }
        archive.unpack(SOURCES, &fmu)?;
        for library in recipes.iter().flat_map(|recipe| &recipe.libraries) {
            if let NeededLibrary::InFmu(path) = library {
                archive.unpack(path, &fmu)?;
            }
        }
        // Sources may come with headers that always add the prefix.
        for name in archive.names.iter().filter(|name| name.starts_with(SOURCES)) {
            let is_header = |(header, _): &&(&str, &str)| {
                header.ends_with("Functions.h") && name.rsplit('/').next() == Some(header)
            };
            if let Some((_, ours)) = HEADERS.iter().find(is_header) {
                let path = fmu.join(name);
                let theirs = fs::read(&path)?;
                if !String::from_utf8_lossy(&theirs).contains(KNOWS_NO_PREFIX) {
                    fs::write(&path, ours)?;
                }
            }
        }
        Ok(Self {
            fmu,
            objects,
            compilers: Compilers::default(),
            control,
            deadline,
            notes: Vec::new(),
            log: String::new(),
            _folder: folder,
        })
    }

    /// Compiles the sources of a library to object files, and returns their paths.
    pub fn compile(&mut self, recipe: &Recipe) -> Result<Vec<String>, CompileError> {
        let (mut calls, mut objects) = (Vec::new(), Vec::new());
        for set in &recipe.sets {
            for path in &set.files {
                let Some(by_name) = language(set, path)? else { continue };
                let language = set.language.unwrap_or(by_name);
                let compiler = self.compiler(language.is_cpp, set)?;
                let object = format!("{OBJECT_FOLDER}/{}.o", calls.len());
                let command =
                    compile_command(&compiler, set, language, path, &object, &mut self.notes);
                calls.push(self.call(command, path));
                objects.push(object);
            }
        }
        self.log += &compiler::run(calls, &self.objects, self.control, self.deadline)?;
        Ok(objects)
    }

    fn compiler(&mut self, is_cpp: bool, set: &SourceSet) -> Result<Compiler, CompileError> {
        let preferred = set.preferred.map(|compiler| compiler.program(is_cpp));
        self.compilers.find(is_cpp, preferred, self.control.warns, &self.objects)
    }

    fn call(&self, mut command: Command, file: &str) -> Call {
        command.current_dir(&self.fmu);
        // Of a compiler that is killed, its temporary files remain.
        for variable in ["TMPDIR", "TMP", "TEMP"] {
            command.env(variable, &self.objects);
        }
        Call { file: file.to_owned(), command }
    }

    /// Links object files to a library.
    pub fn link(
        &mut self,
        recipe: &Recipe,
        objects: &[String],
        binary: &str,
        file: &Path,
    ) -> Result<(), CompileError> {
        let is_cpp = recipe.sets.iter().try_fold(false, |found, set| {
            let of_files =
                set.files.iter().map(|path| Ok(language(set, path)?.is_some_and(|l| l.is_cpp)));
            let of_files = of_files.collect::<Result<Vec<_>, CompileError>>()?;
            Ok::<_, CompileError>(found || of_files.contains(&true))
        })?;
        let compiler = self.compiler(is_cpp, &recipe.sets[0])?;
        let mut command = compiler.command();
        match compiler.family {
            CompilerFamily::Gnu => {
                command.arg("-shared").args(objects);
                command.arg("-o").arg(file);
            }
            CompilerFamily::Msvc => {
                command.arg("-LD").args(objects);
                let mut out = OsString::from("-Fe:");
                out.push(file);
                command.arg(out);
            }
        }
        let mut has_shared = false;
        for library in &recipe.libraries {
            match (library, compiler.family) {
                (NeededLibrary::InFmu(path), _) => {
                    let is_shared = !path.ends_with(".a") && !path.ends_with(".lib");
                    has_shared |= is_shared;
                    match path.rsplit_once('/') {
                        // By its name, by which it is found beside the FMU's library later.
                        Some((folder, name)) if is_shared && cfg!(target_os = "linux") => {
                            command.arg(format!("-L{folder}")).arg(format!("-l:{name}"));
                        }
                        _ => {
                            command.arg(path);
                        }
                    }
                }
                (NeededLibrary::System(name), CompilerFamily::Gnu) => {
                    let is_file = [".a", ".so", ".dylib"].iter().any(|end| name.ends_with(end));
                    command.arg(format!("-l{}{name}", if is_file { ":" } else { "" }));
                }
                // The mathematics is in its C library.
                (NeededLibrary::System(name), CompilerFamily::Msvc) if name == "m" => {}
                (NeededLibrary::System(name), CompilerFamily::Msvc) => {
                    let end = if name.ends_with(".lib") { "" } else { ".lib" };
                    command.arg(format!("{name}{end}"));
                }
            }
        }
        if compiler.family == CompilerFamily::Gnu {
            if cfg!(windows) {
                command.arg("-static-libgcc");
            } else {
                command.arg("-lm");
            }
            if cfg!(target_os = "linux") && compiler.is_full() {
                // Older C libraries have these apart.
                command.args(["-Wl,--as-needed", "-lpthread", "-ldl", "-Wl,--no-undefined"]);
                if has_shared {
                    command.arg("-Wl,-rpath,$ORIGIN");
                }
            }
        }
        let call = self.call(command, binary);
        self.log += &compiler::run(vec![call], &self.objects, self.control, self.deadline)?;
        Ok(())
    }
}

/// The language of a source file; `None` for a header, which other files include.
fn language(set: &SourceSet, path: &str) -> Result<Option<Language>, CompileError> {
    match (Language::of_file(path), set.language) {
        (Ok(None), _) => Ok(None),
        (_, Some(language)) => Ok(Some(language)),
        (by_name, None) => by_name,
    }
}

/// The command that compiles a source file.
fn compile_command(
    compiler: &Compiler,
    set: &SourceSet,
    language: Language,
    path: &str,
    object: &str,
    notes: &mut Vec<String>,
) -> Command {
    let family = compiler.family;
    let mut command = compiler.command();
    match family {
        CompilerFamily::Gnu => {
            command.args(["-c", "-x", if language.is_cpp { "c++" } else { "c" }])
        }
        CompilerFamily::Msvc => command.args(["-c", if language.is_cpp { "-TP" } else { "-TC" }]),
    };
    command.args(language.option(family));
    for name in NO_PREFIX {
        command.arg(format!("-D{name}"));
    }
    for definition in &set.definitions {
        let name = &definition.name;
        command.arg(match &definition.value {
            Some(value) => format!("-D{name}={value}"),
            None => format!("-D{name}"),
        });
    }
    if set.options.is_empty() || set.family.is_none_or(|of| of == family) {
        let words = set.options.iter().filter_map(|option| match option {
            CompilerOption::Word(word) => Some(word),
            CompilerOption::Include(_) | CompilerOption::Library(_) => None,
        });
        command.args(words);
    } else if let Some(of) = set.family {
        notes.push(format!("its compilerOptions are for {}, and were left out", of.name()));
    }
    for folder in set.includes.iter().map(String::as_str).chain(["sources", HEADER_FOLDER]) {
        command.arg(format!("-I{folder}"));
    }
    match family {
        CompilerFamily::Gnu => command.args(["-o", object]),
        CompilerFamily::Msvc => command.arg(format!("-Fo{object}")),
    };
    command.arg(path);
    command
}

/// Checks that a library exports the functions by which it is instantiated.
pub fn check_functions(
    file: &Path,
    binary: &str,
    recipe: &Recipe,
    version: FmiVersion,
) -> Result<(), CompileError> {
    let bytes = fs::read(file).context("cannot read the compiled library")?;
    let Ok(library) = object::File::parse(&*bytes) else { return Ok(()) };
    let exports = library.exports().unwrap_or_default();
    let names = exports.iter().map(|export| String::from_utf8_lossy(export.name()));
    // Names of macOS have an underscore before them.
    let names = Vec::from_iter(names.map(|name| match cfg!(target_os = "macos") {
        true => name.trim_start_matches('_').to_owned(),
        false => name.into_owned(),
    }));
    for kind in &recipe.interfaces {
        let name = match (version, *kind) {
            (FmiVersion::Fmi2, _) => "fmi2Instantiate",
            (FmiVersion::Fmi3, "ModelExchange") => "fmi3InstantiateModelExchange",
            (FmiVersion::Fmi3, "CoSimulation") => "fmi3InstantiateCoSimulation",
            (FmiVersion::Fmi3, _) => "fmi3InstantiateScheduledExecution",
        };
        if !names.iter().any(|other| other == name) {
            let found = names.into_iter().find(|other| other.ends_with(name));
            return Err(CompileError::MissingFunction { binary: binary.to_owned(), name, found });
        }
    }
    Ok(())
}
