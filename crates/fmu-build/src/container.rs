//! The binary of container FMUs: the crate `fmu-container`, built once for each target in a folder that all containers
//! share, or given as a file; and the page of a container.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use fmu_description::hash::checksum;
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::platform::{Platform, Prebuilt};

use crate::binary::check_functions;
use crate::cargo::{BuildProgress, remap};
use crate::dependency::{Dependency, quoted};
use crate::missing::Missing;
use crate::page;
use crate::toolchain::{self, BuildTarget};
use crate::universal::join_mach_o;

/// The crate that is built, and the package that is written for it.
const CRATE: &str = "fmu-container";
const PACKAGE: &str = "fmu-container-binary";
/// Its optimization is that of the command line.
const PROFILE: &str =
    "[profile.release]\nlto = \"thin\"\nopt-level = 3\npanic = \"unwind\"\nstrip = \"symbols\"\n";

/// For which platforms a container has a binary.
#[derive(Debug, Default)]
pub struct ContainerTargets {
    /// Rust targets; this machine, if there is neither a target nor a binary.
    pub targets: Vec<String>,
    /// Binaries that were built elsewhere.
    pub binaries: Vec<Prebuilt>,
}

/// A binary of containers.
pub struct ContainerBinary {
    /// Its platforms.
    pub platforms: Vec<Platform>,
    /// The shared library.
    pub bytes: Vec<u8>,
}

/// The platforms, each with how its binary is made.
enum Source<'a> {
    File(&'a Path),
    Build(BuildTarget),
}

impl ContainerTargets {
    /// The binaries for a version of FMI, which are built if they are not up to date. `check` may refuse a platform before
    /// anything is built.
    ///
    /// # Errors
    /// A target is not supported, the build fails, or a file is not a binary of containers.
    pub fn binaries(
        &self,
        version: FmiVersion,
        check: impl Fn(&Platform) -> Result<()>,
        progress: &dyn Fn(BuildProgress<'_>),
    ) -> Result<Vec<ContainerBinary>> {
        let mut sources = Vec::new();
        for Prebuilt { platform, file } in &self.binaries {
            // A binary is for both versions of FMI, which name its platform differently.
            let platform = Platform::all(version).find(|other| other.is_named(platform.folder));
            let platform = platform.with_context(|| {
                format!("FMI {} has no platform folder for {}", version.as_str(), file.display())
            })?;
            sources.push((vec![platform], Source::File(file)));
        }
        let mut missing = Missing::default();
        toolchain::check_names(&self.targets)?;
        for name in &self.targets {
            let target = BuildTarget::named(name, version, &mut missing)?;
            sources.push((target.platforms.clone(), Source::Build(target)));
        }
        if sources.is_empty() {
            let target = BuildTarget::of_this_machine(version)?;
            sources.push((target.platforms.clone(), Source::Build(target)));
        }
        let mut all: Vec<Platform> = Vec::new();
        for (platforms, _) in &mut sources {
            // One binary serves several folders, of which the FMUs in the container may lack some.
            let refused = platforms.iter().try_for_each(&check);
            platforms.retain(|platform| check(platform).is_ok());
            if platforms.is_empty() {
                refused?;
            }
            for platform in platforms {
                let folder = platform.folder;
                ensure!(!all.contains(platform), "two binaries are for the platform {folder}");
                all.push(*platform);
            }
        }
        missing.check()?;
        let binary = |(platforms, source): (Vec<Platform>, Source<'_>)| {
            let bytes = match source {
                Source::File(file) => read(file, &platforms, version)?,
                Source::Build(target) => build(&target, progress)?,
            };
            Ok(ContainerBinary { platforms, bytes })
        };
        sources.into_iter().map(binary).collect()
    }
}

fn read(file: &Path, platforms: &[Platform], version: FmiVersion) -> Result<Vec<u8>> {
    let name = file.display();
    let bytes = fs::read(file).with_context(|| format!("cannot read {name}"))?;
    let checked = platforms.iter().try_for_each(|platform| platform.check(&bytes));
    checked
        .and_then(|()| check_functions(&bytes, version))
        .with_context(|| format!("{name} cannot be used"))?;
    Ok(bytes)
}

/// Builds the crate for a target, in a package of its own, in cargo's home folder.
fn build(target: &BuildTarget, progress: &dyn Fn(BuildProgress<'_>)) -> Result<Vec<u8>> {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(env::home_dir()?.join(".cargo")));
    let home = home.context("the home folder is unknown; set CARGO_HOME")?;
    let dependency = Dependency::default();
    let line = match &dependency {
        Dependency::Version(version) => format!("{CRATE} = {}", quoted(version)),
        Dependency::Git(url) => format!("{CRATE} = {{ git = {} }}", quoted(url)),
        Dependency::Folder(neighbour) => {
            let folder = neighbour.with_file_name(CRATE);
            format!("{CRATE} = {{ path = {} }}", quoted(&folder.to_string_lossy()))
        }
    };
    let source = format!("{line}\n{}", env!("CARGO_PKG_VERSION"));
    let folder = home.join("fmu-container").join(format!("{:032x}", checksum(source.as_bytes())));
    let cannot = || format!("cannot write to the folder {}", folder.display());
    fs::create_dir_all(folder.join("src")).with_context(cannot)?;
    let manifest = folder.join("Cargo.toml");
    let text = format!(
        "[package]\nname = \"{PACKAGE}\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n[lib]\ncrate-type = [\"cdylib\"]\n\n\
        [dependencies]\n{line}\n\n{PROFILE}\n[workspace]\n"
    );
    write_new(&manifest, text.as_bytes()).with_context(cannot)?;
    write_new(&folder.join("src/lib.rs"), b"pub use fmu_container::*;\n").with_context(cannot)?;
    let mut remapped = vec![remap(&home, "cargo")];
    if let Dependency::Folder(crates) = &dependency {
        let checkout = crates.ancestors().nth(2).unwrap_or(crates);
        remapped.push(remap(checkout, "fmu-container"));
        // The tested versions of other crates.
        if let Ok(lock) = fs::read(checkout.join("Cargo.lock"))
            && !folder.join("Cargo.lock").exists()
        {
            fs::write(folder.join("Cargo.lock"), lock).with_context(cannot)?;
        }
    }
    let extension = target.platforms[0].extension;
    let parts = target.recipes.iter().map(|recipe| {
        let mut build = recipe.cargo_rustc("building the binary of containers");
        build
            .args(["--release", "--lib", "--manifest-path"])
            .args([&manifest])
            .rustflags(remapped.iter().cloned())
            .args(["--"])
            .args(recipe.compiler_args(PACKAGE));
        let file = build.shared_library(&PACKAGE.replace('-', "_"), extension, progress)?;
        fs::read(&file).with_context(|| format!("cannot read {}", file.display()))
    });
    let mut parts = parts.collect::<Result<Vec<_>>>()?;
    match parts.len() {
        1 => Ok(parts.remove(0)),
        _ => join_mach_o(&parts).context("cannot join the parts of a universal binary"),
    }
}

/// Writes a file if its content differs, so that cargo does not build again.
fn write_new(file: &Path, content: &[u8]) -> Result<()> {
    if fs::read(file).ok().as_deref() != Some(content) {
        fs::write(file, content)?;
    }
    Ok(())
}

/// The HTML page of the container `file`; `about` is an HTML fragment for its middle.
pub fn container_page(model: &ModelDescription<'_>, file: &str, about: &str) -> String {
    page::html(model, file, Some(about), None, &[], None)
}
