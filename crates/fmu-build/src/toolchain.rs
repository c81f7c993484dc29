//! How a target is built: toolchain, standard library and linker.

use std::env::{self, consts::EXE_SUFFIX};
use std::ffi::OsString;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use fmu_description::FmiVersion;
use fmu_file::platform::{Platform, TARGET_WASM, UNIVERSAL};

use crate::cargo::{Build, Product};
use crate::missing::Missing;
use crate::triple;

/// Links for a given glibc version, and for macOS from other systems.
const ZIGBUILD: &str = "cargo-zigbuild";
/// The glibc version that portable Linux binaries require, as in CentOS 7.
const GLIBC: &str = "2.17";
/// A component has the imports of its interface only, so none of a system.
const WASM: &str = "wasm32-unknown-unknown";
/// The linker of components, where the toolchain has none.
const WASM_LD: &str = "wasm-ld";
/// The first macOS for ARM.
const MACOS: &str = "11.0";

/// How a WebAssembly component gets resources: the draft FMI-LS-WASM at one of its commits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum WasmDraft {
    /// By a path, although a component cannot open files.
    #[default]
    #[value(name = "c1aac17")]
    WithPath,
    /// By a function of the host.
    #[value(name = "77277f4")]
    WithFunction,
}

/// A build target, for one or more platforms of an FMU.
pub struct BuildTarget {
    /// The platforms of its binary.
    pub platforms: Vec<Platform>,
    /// How its binary is built: one recipe, or two whose binaries are joined.
    pub recipes: Vec<Recipe>,
}

/// How a binary for one processor and system is built.
pub struct Recipe {
    /// What its binary becomes.
    product: Product,
    /// The target name for cargo or cargo-zigbuild.
    target: String,
    /// Whether it is passed to cargo as `--target`; otherwise cargo builds for this machine.
    is_named: bool,
    toolchain: Toolchain,
    std_from_source: bool,
    by_zig: bool,
}

impl BuildTarget {
    /// The target of this machine, which only needs a Rust toolchain.
    ///
    /// # Errors
    /// There is no toolchain, or FMI has no platform folder for this machine.
    pub fn of_this_machine(version: FmiVersion) -> Result<Self> {
        let host = host()?;
        Ok(Self {
            platforms: Platform::of_target(&host, version)?,
            recipes: vec![Recipe {
                product: Product::Library,
                target: host,
                is_named: false,
                toolchain: Toolchain::active(),
                std_from_source: false,
                by_zig: false,
            }],
        })
    }

    /// The target with the given name: a Rust triple, optionally with a glibc version, [`UNIVERSAL`], or
    /// [`TARGET_WASM`].
    ///
    /// # Errors
    /// There is no such target, or the version of FMI has no platform folder for it. What this machine lacks is added
    /// to `missing`.
    pub fn named(name: &str, version: FmiVersion, missing: &mut Missing) -> Result<Self> {
        let parts = match name {
            UNIVERSAL => vec!["x86_64-apple-darwin", "aarch64-apple-darwin"],
            TARGET_WASM => vec![WASM],
            _ => vec![name],
        };
        Ok(Self {
            platforms: Platform::of_target(name, version)?,
            recipes: parts.into_iter().map(|part| Recipe::new(part, missing)).collect(),
        })
    }
}

impl Recipe {
    /// The recipe for a target that rustc knows. What this machine lacks for it is added to `missing`.
    fn new(target: &str, missing: &mut Missing) -> Self {
        let (triple, glibc) = match target.split_once('.') {
            Some((triple, version)) => (triple, Some(version)),
            None => (target, None),
        };
        let by_zig = glibc.is_some() || is_apple(triple) && !cfg!(target_os = "macos");
        let found = Toolchain::all().find_map(|toolchain| {
            let folder = toolchain.folder_of_std(triple)?;
            let from_source = !folder.is_dir();
            (!from_source || toolchain.has_sources()).then_some((toolchain, from_source))
        });
        if found.is_none() {
            missing.std(triple);
        }
        let (toolchain, std_from_source) = found.unwrap_or((Toolchain::active(), false));
        add_missing_linker(target, triple, by_zig, missing);
        if triple == WASM && !toolchain.has_lld() && !runs(WASM_LD) {
            missing.program(WASM_LD, TARGET_WASM, "apt-get install lld    # LLD, of LLVM".into());
        }
        let product = if triple == WASM { Product::Component } else { Product::Library };
        let target = target.to_owned();
        Self { product, target, is_named: true, toolchain, std_from_source, by_zig }
    }

    /// The recipe for the module that is translated to C. What this machine lacks for it is added to `missing`.
    pub fn for_sources(missing: &mut Missing) -> Self {
        Self { product: Product::Sources, ..Self::new(WASM, missing) }
    }

    /// Whether the target was asked for by name.
    pub fn is_named(&self) -> bool {
        self.is_named
    }

    /// `cargo rustc` for the target.
    pub fn cargo_rustc(&self, title: &str) -> Build {
        let mut build = if self.by_zig {
            Build::new(ZIGBUILD, title, "rustc")
        } else {
            Build::new(self.toolchain.program("cargo"), title, "rustc")
        };
        if self.toolchain.folder.is_some() {
            for (variable, program) in [("CARGO", "cargo"), ("RUSTC", "rustc")] {
                build.env(variable, self.toolchain.program(program));
            }
        }
        if self.is_named {
            build.args(["--target", &self.target]);
        }
        if is_apple(&self.target) {
            build.env("MACOSX_DEPLOYMENT_TARGET", MACOS);
        }
        // Whatever the profile says: an abort would end the host, but not that of a component or of C sources.
        build.rustflags([format!("-Cpanic={}", self.panic())]);
        if self.has_unwinder_in_library() {
            build.rustflags(["--cfg=fmu_export_no_backtrace".to_owned()]);
        }
        if self.is_for_wasm() && !self.toolchain.has_lld() {
            build.rustflags([format!("-Clinker={WASM_LD}")]);
        }
        if self.std_from_source {
            // Smaller without the backtrace symbolizer, which is not needed to catch panics.
            build
                .args([format!("-Zbuild-std=std,panic_{}", self.panic())])
                .args(["-Zbuild-std-features=panic-unwind"])
                .env("RUSTC_BOOTSTRAP", "1");
            if is_apple(&self.target) {
                // zig's linker exports everything that is not hidden.
                build.rustflags(["-Zdefault-visibility=hidden".to_owned()]);
            }
        }
        build
    }

    /// `cargo rustc` with the flags of `cargo build`.
    pub fn cargo_rustc_for_trial(&self, title: &str, profile: &str) -> Build {
        Build::for_trial(self.toolchain.program("cargo"), title, profile)
    }

    /// What its binary becomes.
    pub fn product(&self) -> Product {
        self.product
    }

    fn is_for_wasm(&self) -> bool {
        self.target == WASM
    }

    /// What a panic does. WebAssembly has no unwinder.
    fn panic(&self) -> &'static str {
        if self.is_for_wasm() { "abort" } else { "unwind" }
    }

    /// Whether the functions that unwind the stack are in a library of the system, and not linked into the
    /// FMU. Then `fmu-export` replaces one of them, and leaves the symbolizer of backtraces out.
    fn has_unwinder_in_library(&self) -> bool {
        self.target.ends_with("-linux-gnu") && !self.by_zig && !self.std_from_source
    }

    /// Compiler arguments for the shared library `name`.
    pub fn compiler_args(&self, name: &str) -> Vec<String> {
        let mut args = Vec::new();
        if self.target.ends_with("-windows-gnu") {
            // For reproducible builds.
            args.push("-Clink-arg=-Wl,--no-insert-timestamp".to_owned());
        }
        if self.target.ends_with("-windows-msvc") {
            // Links the C runtime statically, as it is not installed on every Windows.
            args.push("-Ctarget-feature=+crt-static".to_owned());
        }
        if is_apple(&self.target) {
            // One library contains several models, so it has its own name.
            args.push(format!("-Clink-arg=-Wl,-install_name,@rpath/{name}.dylib"));
        }
        if is_apple(&self.target) && self.by_zig {
            // Stripping the linked library would break its signature, which ARM requires.
            args.extend(["-Cstrip=none", "-Clink-args=-Wl,-s -Wl,-x"].map(str::to_owned));
        }
        args
    }

    /// The folder of the standard library's sources, which may not exist.
    pub fn sources(&self) -> Option<PathBuf> {
        self.toolchain.sources()
    }
}

impl Display for Recipe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let toolchain = &self.toolchain;
        write!(f, "{}: {}", self.target, toolchain.version())?;
        if let Some(folder) = &toolchain.folder {
            write!(f, " of {}", folder.display())?;
        }
        f.write_str(match self.std_from_source {
            true => ", standard library built from source, which takes minutes the first time",
            false => ", standard library of the toolchain",
        })?;
        if self.by_zig { write!(f, ", {ZIGBUILD}") } else { Ok(()) }
    }
}

/// A compiler and its cargo.
struct Toolchain {
    /// Their folder; `None` for the toolchain that runs this program.
    folder: Option<PathBuf>,
}

impl Toolchain {
    fn active() -> Self {
        Self { folder: None }
    }

    /// The active toolchain and all toolchains in PATH, such as the system's in addition to rustup's.
    fn all() -> impl Iterator<Item = Self> {
        let path = env::var_os("PATH").unwrap_or_default();
        let folders: Vec<_> = env::split_paths(&path).collect();
        let installed = folders.into_iter().map(|folder| Self { folder: Some(folder) });
        [Self::active()].into_iter().chain(installed.filter(|toolchain| {
            ["cargo", "rustc"]
                .into_iter()
                .all(|program| Path::new(&toolchain.program(program)).is_file())
        }))
    }

    /// The path of `cargo` or `rustc`.
    fn program(&self, name: &str) -> OsString {
        match &self.folder {
            Some(folder) => folder.join(format!("{name}{EXE_SUFFIX}")).into(),
            None => env::var_os(name.to_uppercase()).unwrap_or_else(|| name.into()),
        }
    }

    /// The output of the compiler, if it succeeds.
    fn rustc(&self, args: &[&str]) -> Option<String> {
        let output = Command::new(self.program("rustc")).args(args).output().ok()?;
        let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        output.status.success().then_some(text)
    }

    /// Name and version number.
    fn version(&self) -> String {
        let text = self.rustc(&["--version"]).unwrap_or_default();
        text.split(" (").next().unwrap_or_default().to_owned()
    }

    /// The folder of the standard library for a target, which may not exist; `None` if the target is
    /// unknown.
    fn folder_of_std(&self, triple: &str) -> Option<PathBuf> {
        self.rustc(&["--print", "target-libdir", "--target", triple]).map(Into::into)
    }

    fn sources(&self) -> Option<PathBuf> {
        let sysroot: PathBuf = self.rustc(&["--print", "sysroot"])?.into();
        Some(sysroot.join("lib/rustlib/src/rust"))
    }

    /// Whether it has LLD, which toolchains of Linux distributions take from another package.
    fn has_lld(&self) -> bool {
        let lld = host().map(|host| format!("lib/rustlib/{host}/bin/rust-lld{EXE_SUFFIX}"));
        let sysroot = self.rustc(&["--print", "sysroot"]);
        sysroot.zip(lld.ok()).is_some_and(|(sysroot, lld)| Path::new(&sysroot).join(lld).is_file())
    }

    fn has_sources(&self) -> bool {
        self.sources().is_some_and(|sources| sources.join("library/Cargo.lock").is_file())
    }
}

fn is_apple(target: &str) -> bool {
    target.contains("-apple-")
}

/// The name of this machine's target with an old glibc version.
///
/// # Errors
/// This machine is not Linux with glibc.
pub fn portable() -> Result<String> {
    let host = host()?;
    ensure!(
        host.ends_with("-linux-gnu"),
        "--portable builds for Linux with glibc, but this machine's target is {host}"
    );
    Ok(format!("{host}.{GLIBC}"))
}

/// Checks the names of targets.
///
/// # Errors
/// There is no toolchain, or no such target. The message has the one that was meant, if that is clear.
pub fn check_names(names: &[String]) -> Result<()> {
    let toolchain = Toolchain::active();
    let is_unknown = |name: &&String| {
        let triple = name.split_once('.').map_or(name.as_str(), |(triple, _)| triple);
        ![UNIVERSAL, TARGET_WASM].contains(&triple) && toolchain.folder_of_std(triple).is_none()
    };
    let Some(name) = names.iter().find(is_unknown) else { return Ok(()) };
    let (host, known) = (host()?, toolchain.rustc(&["--print", "target-list"]));
    let end = match triple::meant(name, &known.unwrap_or_default(), &host) {
        Some(meant) => format!("did you mean {meant}?"),
        None => "`rustc --print target-list` lists all targets".to_owned(),
    };
    bail!("the Rust toolchain does not know the target {name}; {end}")
}

/// The triple of this machine.
fn host() -> Result<String> {
    Toolchain::active()
        .rustc(&["-vV"])
        .context("cannot run rustc; is a Rust toolchain installed?")?
        .lines()
        .find_map(|line| line.strip_prefix("host: "))
        .map(str::to_owned)
        .context("rustc -vV does not print its host")
}

/// Adds the linker of a target if it is missing, unless it comes with the system or with Rust.
fn add_missing_linker(target: &str, triple: &str, by_zig: bool, missing: &mut Missing) {
    if by_zig {
        if !runs(ZIGBUILD) {
            missing.program(ZIGBUILD, target, "pip install cargo-zigbuild ziglang".into());
        } else if !has_zig() {
            missing.program("zig", target, "pip install ziglang".into());
        }
    } else if let Some(processor) = triple.strip_suffix("-pc-windows-gnu")
        && !cfg!(windows)
    {
        let linker = format!("{processor}-w64-mingw32-gcc");
        if !runs(&linker) {
            let (package, bits) = match processor {
                "x86_64" => ("x86-64", 64),
                other => (other, 32),
            };
            let install = format!(
                "apt-get install gcc-mingw-w64-{package}    # Debian, Ubuntu
dnf install mingw{bits}-gcc    # Fedora
brew install mingw-w64    # macOS"
            );
            missing.program(&linker, target, install);
        }
    }
}

/// Whether cargo-zigbuild finds zig: by its variable, in PATH, or as the Python package ziglang.
fn has_zig() -> bool {
    let of_python = ["-m", "ziglang", "version"];
    env::var_os("CARGO_ZIGBUILD_ZIG_PATH").is_some()
        || succeeds("zig", &["version"])
        || ["python3", "python"].iter().any(|python| succeeds(python, &of_python))
}

fn runs(program: &str) -> bool {
    succeeds(program, &["--version"])
}

fn succeeds(program: &str, args: &[&str]) -> bool {
    let output = Command::new(program).args(args).output();
    output.is_ok_and(|output| output.status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(target: &str, by_zig: bool) -> Recipe {
        Recipe {
            product: Product::Library,
            target: target.into(),
            is_named: true,
            toolchain: Toolchain::active(),
            std_from_source: false,
            by_zig,
        }
    }

    #[test]
    fn libraries_for_macos_are_named_and_stripped_by_the_linker() {
        let args = recipe("aarch64-apple-darwin", true).compiler_args("models");
        assert!(args[0].ends_with("-install_name,@rpath/models.dylib"));
        assert!(args.contains(&"-Cstrip=none".to_owned()));
        let by_apple = recipe("aarch64-apple-darwin", false).compiler_args("models");
        assert_eq!(by_apple, args[..1]);
        assert!(recipe("x86_64-unknown-linux-gnu", true).compiler_args("models").is_empty());
    }

    #[test]
    fn this_machine_can_build_for_itself() {
        let host = host().unwrap();
        let mut missing = Missing::default();
        let recipe = Recipe::new(&host, &mut missing);
        missing.check().unwrap();
        assert!(!recipe.std_from_source && !recipe.by_zig);
        assert!(recipe.to_string().starts_with(&format!("{host}: rustc 1.")), "{recipe}");
    }

    #[test]
    fn unknown_targets_are_named_in_the_error() {
        let name = "x86_64-nonsense-linux-gnu";
        let error = check_names(&[name.to_owned()]).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
}
