//! Exports the models of a workspace to FMU files.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread::{self, ScopedJoinHandle};

use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::Metadata;
use fmu_file::archive::{self, Compression, Entry, MODEL_DESCRIPTION, Packed};
use fmu_file::platform::{Platform, Prebuilt};
use fmu_file::replace;

use crate::binary::{Binary, PackedBinary};
use crate::documentation;
use crate::library::{self, Library, Model};
use crate::toolchain::{self, Target};

/// What to export, and for which platforms.
#[derive(Debug, Default)]
pub struct Options {
    /// Names of the models; all if empty.
    pub models: Vec<String>,
    /// Output folder; by default `fmu` in cargo's target folder.
    pub out: Option<PathBuf>,
    /// Whether to build for any Linux with glibc 2.17 or newer, for this machine's processor.
    pub portable: bool,
    /// Rust targets to build for; this machine's target if empty.
    pub targets: Vec<String>,
    /// Prebuilt shared libraries.
    pub binaries: Vec<Prebuilt>,
    /// Compression of the binaries.
    pub compression: Compression,
}

/// An FMU that was written.
#[derive(Debug)]
pub struct Written {
    /// Path of the FMU.
    pub file: PathBuf,
    /// Its size in bytes.
    pub size: u64,
    /// The platform folders that it has binaries in.
    pub platforms: Vec<&'static str>,
}

/// Builds the models and writes their FMUs.
///
/// # Errors
/// There is no model, or none with a given name; a target is not supported; the build fails; a file
/// cannot be read or written.
pub fn export(options: &Options) -> Result<Vec<Written>> {
    let metadata = library::metadata()?;
    let out = match &options.out {
        Some(out) => out.clone(),
        None => metadata.target_directory.join("fmu").into(),
    };
    // Checks that are fast come before the long build.
    fs::create_dir_all(&out)
        .with_context(|| format!("cannot create the folder {}", out.display()))?;
    replace::check_writable(&out)?;
    let targets = targets(options)?;
    let prebuilt = options
        .binaries
        .iter()
        .map(Binary::read)
        .collect::<Result<Vec<_>>>()?;

    let libraries = library::libraries(&metadata);
    ensure!(
        !libraries.is_empty(),
        "no package of the workspace {} has models; expected a cdylib that depends on fmu-export, and a program that describes it",
        metadata.workspace_root
    );
    // Each of the two builds compiles most of its dependencies serially, so both run at once,
    // unless the libraries to build depend on the chosen models.
    let all = options.models.is_empty() && options.binaries.is_empty();
    let (models, built) = thread::scope(|scope| {
        let describing = scope.spawn(|| library::describe(&libraries, &metadata));
        let built = all.then(|| build(libraries.iter(), &targets, &metadata));
        anyhow::Ok((join(describing)?, built.transpose()?))
    })?;
    let chosen = choose(&models, &options.models)?;
    check_prebuilt(&chosen, options, &prebuilt)?;
    let licenses = licenses(&metadata)?;
    let documents = chosen
        .iter()
        .map(|model| documentation::files(model, &licenses))
        .collect::<Result<Vec<_>>>()?;
    let has_chosen = |library: &&Library| of_library(library, &chosen).next().is_some();
    let built = match built {
        Some(built) => built,
        None => build(libraries.iter().filter(has_chosen), &targets, &metadata)?,
    };
    for (library, binary) in &built {
        for model in of_library(library, &chosen) {
            binary.check_guid(model)?;
        }
    }

    let cache = metadata.target_directory.join("fmu-packed");
    fs::create_dir_all(&cache).with_context(|| format!("cannot make the folder {cache}"))?;
    let pack = |binary: &Binary| binary.pack(options.compression, cache.as_std_path());
    let (built, prebuilt) = thread::scope(|scope| {
        let packing = |binary| scope.spawn(move || pack(binary));
        let built: Vec<_> = built
            .iter()
            .map(|(library, binary)| (*library, packing(binary)))
            .collect();
        let prebuilt: Vec<_> = prebuilt.iter().map(packing).collect();
        let built = built
            .into_iter()
            .map(|(library, packing)| Ok((library, join(packing)?)))
            .collect::<Result<Vec<_>>>()?;
        let prebuilt = prebuilt.into_iter().map(join).collect::<Result<Vec<_>>>()?;
        anyhow::Ok((built, prebuilt))
    })?;
    let write = |(model, documents): (&&Model<'_>, &Vec<_>)| {
        let of_model = built
            .iter()
            .filter(|(library, _)| std::ptr::eq(*library, model.library))
            .map(|(_, binary)| binary);
        write(model, of_model.chain(&prebuilt), documents, &out)
    };
    chosen.iter().zip(&documents).map(write).collect()
}

/// Builds libraries for all targets.
fn build<'a>(
    libraries: impl Iterator<Item = &'a Library>,
    targets: &[Target],
    metadata: &Metadata,
) -> Result<Vec<(&'a Library, Binary)>> {
    libraries
        .flat_map(|library| targets.iter().map(move |target| (library, target)))
        .map(|(library, target)| Ok((library, Binary::build(library, target, metadata)?)))
        .collect()
}

/// The models of a library.
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

/// The targets to build for: the requested ones, else this machine unless its binary is prebuilt.
fn targets(options: &Options) -> Result<Vec<Target>> {
    let mut names = options.targets.clone();
    if options.portable {
        names.insert(0, toolchain::portable()?);
    }
    check_platforms(options, &names)?;
    if names.is_empty() {
        let host = Target::of_this_machine()?;
        let given = |b: &Prebuilt| host.platforms.contains(&b.platform);
        let is_given = options.binaries.iter().any(given);
        return Ok(if is_given { vec![] } else { vec![host] });
    }
    let targets = names.iter().map(|name| Target::named(name));
    let targets = targets.collect::<Result<Vec<_>>>()?;
    for recipe in targets.iter().flat_map(|target| &target.recipes) {
        eprintln!("{recipe}");
    }
    Ok(targets)
}

/// Checks that no two binaries, prebuilt or built, are for the same platform.
fn check_platforms(options: &Options, names: &[String]) -> Result<()> {
    let mut platforms: Vec<Platform> = options.binaries.iter().map(|b| b.platform).collect();
    for name in names {
        platforms.extend(Platform::of_target(name)?);
    }
    for (index, platform) in platforms.iter().enumerate() {
        ensure!(
            !platforms[..index].contains(platform),
            "two binaries are requested for the platform {}; export one of them to a separate FMU, \
             in another folder with --out",
            platform.folder
        );
    }
    Ok(())
}

/// The models with the given names, or all.
fn choose<'a, 'b>(models: &'b [Model<'a>], names: &[String]) -> Result<Vec<&'b Model<'a>>> {
    for name in names {
        if !models.iter().any(|model| model.name == *name) {
            let known: Vec<_> = models.iter().map(|model| model.name.as_str()).collect();
            bail!("model {name:?} is unknown; there are {}", known.join(", "));
        }
    }
    Ok(models
        .iter()
        .filter(|model| names.is_empty() || names.contains(&model.name))
        .collect())
}

/// Checks that the prebuilt binaries contain the current version of every chosen model.
fn check_prebuilt(chosen: &[&Model<'_>], options: &Options, prebuilt: &[Binary]) -> Result<()> {
    for model in chosen {
        for (option, binary) in options.binaries.iter().zip(prebuilt) {
            binary
                .check_guid(model)
                .with_context(|| format!("{} cannot be used", option.file.display()))?;
        }
    }
    Ok(())
}

/// Writes the FMU of a model.
fn write<'a>(
    model: &Model<'_>,
    binaries: impl Iterator<Item = &'a PackedBinary>,
    documents: &[documentation::File],
    out: &Path,
) -> Result<Written> {
    let name = model.name.as_str();
    let xml = Packed::text(model.xml.as_bytes())?;
    let documents = documents
        .iter()
        .map(|(path, content)| Ok((path, Packed::text(content)?)))
        .collect::<Result<Vec<_>>>()?;
    let mut entries = vec![Entry::new(MODEL_DESCRIPTION, &xml)];
    let mut platforms = Vec::new();
    for binary in binaries {
        for platform in &binary.platforms {
            entries.push(Entry::new(platform.binary(name), &binary.file));
            platforms.push(platform.folder);
        }
    }
    entries.extend(
        documents
            .iter()
            .map(|(path, file)| Entry::new(path.as_str(), file)),
    );
    let file = out.join(format!("{name}.fmu"));
    let size = archive::write(&file, &entries)?;
    Ok(Written {
        file,
        size,
        platforms,
    })
}

/// The licence files in the workspace root, with their paths in the documentation.
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
