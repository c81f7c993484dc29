//! Compiles C and C++ code in a build script, so that each instance of an FMU has its own copy of the global variables.
//!
//! Generated and older controllers keep their state in global variables, which all instances in a process would share.
//! [`isolate`] compiles such code like [`cc::Build::compile`], and moves its variables to a section of their own;
//! `fmu_export::c::Globals` then swaps the contents of this section.
//!
//! ```no_run
//! // build.rs
//! let mut c = fmu_cc::cc::Build::new();
//! c.files(["c/heater.c", "c/heater_data.c"]).include("c");
//! fmu_cc::isolate(&c, "heater");
//! ```
//!
//! It works for Linux on x86-64 and ARM by gcc and clang, and for `x86_64-pc-windows-gnu`. Elsewhere, the build fails
//! and says what to do instead.

mod code;
mod section;

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process;

pub use cc;

use crate::code::{Code, Memory, at};
use crate::section::{Format, Section};

/// Compiles the files of a build to the static library `name`, which is linked to the package, and moves its global
/// variables to a section of their own. `name` is a C identifier, to which `fmu_export::c_library!` refers.
///
/// The build fails if the code calls functions such as `malloc` or `fopen`: what they return would be shared by an
/// instance and its saved states. See [`isolate_unsaved`].
pub fn isolate(build: &cc::Build, name: &str) {
    finish(compile(build, name, Memory::Static));
}

/// As [`isolate`], for code that allocates memory. Its `Globals` must be a field with `#[unsaved]`, so that the state of
/// the FMU cannot be saved.
pub fn isolate_unsaved(build: &cc::Build, name: &str) {
    finish(compile(build, name, Memory::Heap));
}

/// Ends the build script with the error, which cargo shows.
fn finish(result: Result<(), String>) {
    if let Err(error) = result {
        println!("cargo::error={}", error.replace('\n', " "));
        process::exit(1);
    }
}

fn compile(build: &cc::Build, name: &str, memory: Memory) -> Result<(), String> {
    let is_identifier = name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !is_identifier {
        return Err(format!("the name {name:?} of a C library is not a C identifier"));
    }
    let section = Section::new(format_of_target()?, name);
    let mut build = build.clone();
    // Variables without a value in one place, where they can be moved.
    build.flag_if_supported("-fno-common");
    let sources: Vec<PathBuf> = build.get_files().map(Path::to_owned).collect();
    for folder in sources.iter().filter_map(|source| source.parent()) {
        println!("cargo::rerun-if-changed={}", folder.display());
    }
    let mut objects = build.try_compile_intermediates().map_err(|error| error.to_string())?;
    let mut code = Code::default();
    for (object, source) in objects.iter().zip(&sources) {
        code.add(source, &read(object)?)?;
    }
    code.check(memory)?;
    let accessor = in_out_dir(&format!("fmu_c_{name}.c"))?;
    write(&accessor, section.accessor(code.hash()).as_bytes())?;
    let mut own = cc::Build::new();
    own.warnings(false).flag_if_supported("-fno-common").file(&accessor);
    objects.extend(own.try_compile_intermediates().map_err(|error| error.to_string())?);
    for object in &objects {
        let moved = section.moved(read(object)?);
        write(object, &moved.map_err(|error| format!("{}: {error}", object.display()))?)?;
    }
    let mut archive = cc::Build::new();
    archive.objects(&objects).cpp(code.needs_cpp()).try_compile(name).map_err(|e| e.to_string())
}

/// The format of object files for the target.
fn format_of_target() -> Result<Format, String> {
    let [target, os, environment, processor] =
        ["TARGET", "CARGO_CFG_TARGET_OS", "CARGO_CFG_TARGET_ENV", "CARGO_CFG_TARGET_ARCH"]
            .map(|name| env::var(name).unwrap_or_default());
    match (os.as_str(), environment.as_str(), processor.as_str()) {
        ("linux", _, "x86_64" | "aarch64") => Ok(Format::Elf),
        ("windows", "gnu", "x86_64") => Ok(Format::Coff),
        _ => Err(format!(
            "global variables of C code cannot be isolated for {target}, only for Linux on x86-64 and ARM and for \
             x86_64-pc-windows-gnu; for other targets, compile it by cc alone and declare #[model(single_instance)]"
        )),
    }
}

fn in_out_dir(file: &str) -> Result<PathBuf, String> {
    let folder = env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: call this in build.rs")?;
    Ok(Path::new(&folder).join(file))
}

fn read(file: &Path) -> Result<Vec<u8>, String> {
    fs::read(file).map_err(|error| at(file, error))
}

fn write(file: &Path, contents: &[u8]) -> Result<(), String> {
    fs::write(file, contents).map_err(|error| at(file, error))
}
