//! `cargo fmu export`: from models to FMU files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread::{self, ScopedJoinHandle};

use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::Metadata;
use clap::Args;
use fmu_file::archive::{self, Entry, MODEL_DESCRIPTION, Packed};
use fmu_file::platform::{Platform, Prebuilt};
use fmu_file::replace;

use crate::build::Build;
use crate::documentation;
use crate::library::{self, Library, Model};

/// What to export, and for whom.
#[derive(Args)]
pub struct Options {
    /// Names of models; all without any
    #[arg(value_name = "MODEL")]
    models: Vec<String>,
    /// Folder that the FMUs are written to [default: fmu in cargo's target folder]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Rust target to build for, once for each; this machine's without any. With a glibc version
    /// behind it (x86_64-unknown-linux-gnu.2.17), cargo-zigbuild builds it
    #[arg(long = "target", value_name = "TRIPLE")]
    targets: Vec<String>,
    /// Shared library that was built elsewhere, for a platform folder of FMI: linux64, win64, ...
    #[arg(long = "binary", value_name = "PLATFORM=FILE")]
    binaries: Vec<Prebuilt>,
}

/// Builds for a given version of glibc.
const ZIGBUILD: &str = "cargo-zigbuild";

/// A shared library for one platform.
struct Binary {
    platform: Platform,
    bytes: Vec<u8>,
}

/// The same, compressed.
struct PackedBinary {
    platform: Platform,
    file: Packed,
}

impl Binary {
    fn pack(&self) -> Result<PackedBinary> {
        Ok(PackedBinary {
            platform: self.platform,
            file: Packed::program(&self.bytes)?,
        })
    }
}

/// Builds the models and writes their FMUs.
pub fn export(options: &Options) -> Result<()> {
    let metadata = library::metadata()?;
    let out = match &options.out {
        Some(out) => out.clone(),
        None => metadata.target_directory.join("fmu").into(),
    };
    // What can fail at once does so before the long build.
    fs::create_dir_all(&out)
        .with_context(|| format!("cannot make the folder {}", out.display()))?;
    replace::check_writable(&out)?;
    let targets = targets(options)?;
    let prebuilt = options
        .binaries
        .iter()
        .map(read)
        .collect::<Result<Vec<_>>>()?;

    let libraries = library::libraries(&metadata);
    ensure!(
        !libraries.is_empty(),
        "no package of the workspace {} has models: a cdylib that depends on fmi-export, with a program that describes it",
        metadata.workspace_root
    );
    let models = library::describe(&libraries, &metadata)?;
    let chosen = choose(&models, &options.models)?;
    check_prebuilt(&chosen, options, &prebuilt)?;
    let licenses = licenses(&metadata)?;
    let documents = chosen
        .iter()
        .map(|model| documentation::files(model, &licenses))
        .collect::<Result<Vec<_>>>()?;

    // A binary takes a second to pack: each once, and beside the build of the next.
    let (built, prebuilt) = thread::scope(|scope| {
        let prebuilt: Vec<_> = prebuilt
            .iter()
            .map(|binary| scope.spawn(|| binary.pack()))
            .collect();
        let mut built = Vec::new();
        for library in &libraries {
            if of_library(library, &chosen).next().is_none() {
                continue;
            }
            for target in &targets {
                let binary = build(library, target.as_deref(), &metadata)?;
                for model in of_library(library, &chosen) {
                    check_guid(model, &binary.bytes)?;
                }
                built.push((library, scope.spawn(move || binary.pack())));
            }
        }
        let built = built
            .into_iter()
            .map(|(library, packing)| Ok((library, join(packing)?)))
            .collect::<Result<Vec<_>>>()?;
        let prebuilt = prebuilt.into_iter().map(join).collect::<Result<Vec<_>>>()?;
        anyhow::Ok((built, prebuilt))
    })?;
    for (model, documents) in chosen.iter().zip(&documents) {
        let of_model = built
            .iter()
            .filter(|(library, _)| std::ptr::eq(*library, model.library))
            .map(|(_, binary)| binary);
        write(model, of_model.chain(&prebuilt), documents, &out)?;
    }
    Ok(())
}

/// The models that are in a library.
fn of_library<'a, 'b>(
    library: &'a Library,
    models: &'b [&'b Model<'a>],
) -> impl Iterator<Item = &'b Model<'a>> {
    let models = models.iter().copied();
    models.filter(move |model| std::ptr::eq(model.library, library))
}

fn join<T>(thread: ScopedJoinHandle<'_, Result<T>>) -> Result<T> {
    thread
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// The targets to build for: those asked for, else this machine (`None`), unless its binary is given.
fn targets(options: &Options) -> Result<Vec<Option<String>>> {
    let host = Platform::of_target(&host()?)?;
    let mut platforms: Vec<Platform> = Vec::new();
    let mut add = |platform: Platform| {
        ensure!(
            !platforms.contains(&platform),
            "two binaries are asked for the platform {}",
            platform.folder
        );
        platforms.push(platform);
        Ok(())
    };
    for prebuilt in &options.binaries {
        add(prebuilt.platform)?;
    }
    if options.targets.is_empty() {
        let given = options.binaries.iter().any(|b| b.platform == host);
        return Ok(if given { vec![] } else { vec![None] });
    }
    for target in &options.targets {
        add(Platform::of_target(target)?)?;
        check_toolchain(target)?;
    }
    Ok(options.targets.iter().cloned().map(Some).collect())
}

/// The triple of a target without the glibc version that cargo-zigbuild reads, and whether it has one.
fn triple(target: &str) -> (&str, bool) {
    match target.split_once('.') {
        Some((triple, _)) => (triple, true),
        None => (target, false),
    }
}

fn rustc() -> Command {
    Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()))
}

fn host() -> Result<String> {
    let output = rustc()
        .arg("-vV")
        .output()
        .context("cannot run rustc; is a Rust toolchain installed?")?;
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .find_map(|line| line.strip_prefix("host: "))
        .map(str::to_owned)
        .context("rustc -vV does not name its host")
}

/// Checks that the toolchain can build for a target.
fn check_toolchain(target: &str) -> Result<()> {
    let (triple, zig) = triple(target);
    let output = rustc()
        .args(["--print", "target-libdir", "--target", triple])
        .output()?;
    ensure!(
        output.status.success(),
        "the Rust toolchain does not know the target {triple}; `rustc --print target-list` has all"
    );
    let folder = String::from_utf8_lossy(&output.stdout);
    ensure!(
        Path::new(folder.trim()).is_dir(),
        "the toolchain has no standard library for the target {triple}; `rustup target add {triple}` installs it"
    );
    if zig {
        let found = Command::new(ZIGBUILD).arg("--version").output();
        ensure!(
            found.is_ok_and(|output| output.status.success()),
            "the target {target} names a glibc version, for which cargo-zigbuild is needed; `pip install cargo-zigbuild ziglang` installs it"
        );
    }
    Ok(())
}

fn read(prebuilt: &Prebuilt) -> Result<Binary> {
    let file = prebuilt.file.display();
    let bytes = fs::read(&prebuilt.file).with_context(|| format!("cannot read {file}"))?;
    prebuilt
        .platform
        .check(&bytes)
        .with_context(|| format!("{file} cannot be used"))?;
    Ok(Binary {
        platform: prebuilt.platform,
        bytes,
    })
}

/// The models of the given names, or all.
fn choose<'a, 'b>(models: &'b [Model<'a>], names: &[String]) -> Result<Vec<&'b Model<'a>>> {
    for name in names {
        if !models.iter().any(|model| model.name() == name) {
            let known: Vec<_> = models.iter().map(Model::name).collect();
            bail!("model {name:?} is unknown; there are {}", known.join(", "));
        }
    }
    Ok(models
        .iter()
        .filter(|model| names.is_empty() || names.iter().any(|name| name == model.name()))
        .collect())
}

/// Checks that the given binaries hold every chosen model, in its present version.
fn check_prebuilt(chosen: &[&Model<'_>], options: &Options, prebuilt: &[Binary]) -> Result<()> {
    for model in chosen {
        for (option, binary) in options.binaries.iter().zip(prebuilt) {
            check_guid(model, &binary.bytes)
                .with_context(|| format!("{} cannot be used", option.file.display()))?;
        }
    }
    Ok(())
}

/// Checks that a binary holds the interface of the model: it keeps its GUID as text.
fn check_guid(model: &Model<'_>, binary: &[u8]) -> Result<()> {
    let guid = model.description.guid.as_bytes();
    ensure!(
        binary.windows(guid.len()).any(|window| window == guid),
        "it does not hold the model {} with the interface {}; was it built from another version?",
        model.name(),
        model.description.guid
    );
    Ok(())
}

/// Builds the shared library for a target, or for this machine.
fn build(library: &Library, target: Option<&str>, metadata: &Metadata) -> Result<Binary> {
    let title = format!("building {}", library.package);
    let mut build = match target {
        Some(target) if triple(target).1 => Build::by(ZIGBUILD, &title, "rustc"),
        _ => Build::new(&title, "rustc"),
    };
    // As `cdylib` alone it is optimized across its dependencies, which is not done beside an rlib.
    build
        .args(["--release", "--lib", "--crate-type", "cdylib"])
        .args(["--package", &library.package]);
    if let Some(target) = target {
        build.args(["--target", target]);
    }
    let platform = match target {
        Some(target) => Platform::of_target(target)?,
        None => Platform::of_target(&host()?)?,
    };
    let file = build
        .without_local_paths(metadata)
        .run(metadata.packages.len())?
        .shared_library(&library.target, platform.extension)
        .with_context(|| format!("cargo built no shared library of {}", library.package))?;
    let bytes = fs::read(&file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(Binary { platform, bytes })
}

/// Writes the FMU of a model and says so.
fn write<'a>(
    model: &Model<'_>,
    binaries: impl Iterator<Item = &'a PackedBinary>,
    documents: &[documentation::File],
    out: &Path,
) -> Result<()> {
    let name = model.name();
    let xml = Packed::text(model.xml.as_bytes())?;
    let documents = documents
        .iter()
        .map(|(path, content)| Ok((path, Packed::text(content)?)))
        .collect::<Result<Vec<_>>>()?;
    let mut entries = vec![Entry::new(MODEL_DESCRIPTION, &xml)];
    let mut platforms = Vec::new();
    for PackedBinary { platform, file } in binaries {
        entries.push(Entry::new(platform.binary(name), file));
        platforms.push(platform.folder);
    }
    entries.extend(
        documents
            .iter()
            .map(|(path, file)| Entry::new(path.as_str(), file)),
    );
    let file = out.join(format!("{name}.fmu"));
    let size = archive::write(&file, &entries)?;
    say_written(&file, size, &platforms);
    Ok(())
}

/// Says which FMU was written, its size, and for which platforms it is.
pub fn say_written(file: &Path, size: u64, platforms: &[&str]) {
    println!(
        "{}  {} KB  {}",
        relative(file).display(),
        size.div_ceil(1000),
        platforms.join(" ")
    );
}

/// The path as seen from the current folder, if it lies below it.
fn relative(file: &Path) -> &Path {
    std::env::current_dir()
        .ok()
        .and_then(|here| file.strip_prefix(here).ok())
        .unwrap_or(file)
}

/// The licence files at the top of the workspace, by their paths in the documentation.
fn licenses(metadata: &Metadata) -> Result<Vec<documentation::File>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(&metadata.workspace_root)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with("LICENSE") && entry.file_type()?.is_file() {
            found.push((format!("licenses/{name}"), fs::read(entry.path())?));
        }
    }
    found.sort();
    Ok(found)
}
