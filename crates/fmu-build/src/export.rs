//! Exports the models of a workspace to FMU files.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread::{self, ScopedJoinHandle};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::Description;
use fmu_file::archive::{self, Compression, Entry, MODEL_DESCRIPTION, Packed};
use fmu_file::platform::{Platform, Prebuilt};
use fmu_file::replace;

use crate::binary::{Binary, Method, PackedBinary};
use crate::contents;
use crate::library::{Library, Selection};
use crate::model::{Model, Variant};
use crate::profile;
use crate::toolchain::{self, Target};

/// What to export, and for which platforms.
#[derive(Debug, Default)]
pub struct Options {
    /// Which packages to build, and how.
    pub selection: Selection,
    /// Names of the models; all if empty.
    pub models: Vec<String>,
    /// Other name and start values for the only model.
    pub variant: Variant,
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

/// A built library: its binaries, one for each target.
struct Built<'a> {
    library: &'a Library,
    binaries: Vec<Binary>,
}

/// Builds the models and writes their FMUs.
///
/// # Errors
/// There is no model, or none with a given name; a target is not supported; the build fails; a file
/// cannot be read or written.
pub fn export(options: &Options) -> Result<Vec<Written>> {
    let metadata = options.selection.metadata()?;
    let out = match &options.out {
        Some(out) => out.clone(),
        None => metadata.target_directory.join("fmu").into(),
    };
    // Checks that are fast come before the long build.
    let libraries = options.selection.libraries(&metadata)?;
    fs::create_dir_all(&out)
        .with_context(|| format!("cannot create the folder {}", out.display()))?;
    replace::check_writable(&out)?;
    let targets = targets(options)?;
    let prebuilt = options
        .binaries
        .iter()
        .map(Binary::read)
        .collect::<Result<Vec<_>>>()?;

    let builder = Builder {
        method: Method {
            selection: &options.selection,
            metadata: &metadata,
            profile: profile::settings(&options.selection.profile, &metadata)?,
        },
        targets: &targets,
    };
    let mut built = builder.build(&libraries, &options.models)?;
    let mut models = choose(&built, &options.models)?;
    if options.variant.is_some() {
        (built, models) = builder.build_variant(&options.variant, &models, &built)?;
    }
    check_binaries(&models, &built, options, &prebuilt)?;
    let contents = models
        .iter()
        .map(|model| contents::files(model, &metadata))
        .collect::<Result<Vec<_>>>()?;

    let cache = metadata.target_directory.join("fmu-packed");
    fs::create_dir_all(&cache).with_context(|| format!("cannot make the folder {cache}"))?;
    let pack = |binary: &Binary| binary.pack(options.compression, cache.as_std_path());
    // This machine's binary is built to read the models, even if it is not packed.
    let is_packed = |binary: &Binary| !prebuilt.iter().any(|other| other.replaces(binary));
    let (built, prebuilt) = thread::scope(|scope| {
        let packing = |binary| scope.spawn(move || pack(binary));
        let built: Vec<_> = built
            .iter()
            .flat_map(|built| built.binaries.iter().map(|binary| (built.library, binary)))
            .filter(|(_, binary)| is_packed(binary))
            .map(|(library, binary)| (library, packing(binary)))
            .collect();
        let prebuilt: Vec<_> = prebuilt.iter().map(packing).collect();
        let built = built
            .into_iter()
            .map(|(library, packing)| Ok((library, join(packing)?)))
            .collect::<Result<Vec<_>>>()?;
        let prebuilt = prebuilt.into_iter().map(join).collect::<Result<Vec<_>>>()?;
        anyhow::Ok((built, prebuilt))
    })?;
    let write = |(model, contents): (&Model<'_>, &Vec<_>)| {
        let of_model = built
            .iter()
            .filter(|(library, _)| std::ptr::eq(*library, model.library))
            .map(|(_, binary)| binary);
        write(model, of_model.chain(&prebuilt), contents, &out)
    };
    models.iter().zip(&contents).map(write).collect()
}

/// Builds libraries for all targets.
struct Builder<'a> {
    method: Method<'a>,
    targets: &'a [Target],
}

impl Builder<'_> {
    /// Builds libraries until all models with the given names are found; all, without names.
    fn build<'a>(&self, libraries: &'a [Library], names: &[String]) -> Result<Vec<Built<'a>>> {
        let mut order: Vec<_> = libraries.iter().collect();
        if !names.is_empty() {
            order.sort_by_key(|library| !library.mentions(names));
        }
        let mut all: Vec<Built<'a>> = Vec::new();
        for library in order {
            let is_found = |name: &String| all.iter().any(|built| built.find(name).is_some());
            if !names.is_empty() && names.iter().all(is_found) {
                break;
            }
            all.push(self.build_library(library, None)?);
        }
        Ok(all)
    }

    fn build_library<'a>(&self, library: &'a Library, variant: Option<&str>) -> Result<Built<'a>> {
        let binaries = self.targets.iter();
        Ok(Built {
            library,
            binaries: binaries
                .map(|target| Binary::build(library, target, &self.method, variant))
                .collect::<Result<_>>()?,
        })
    }

    /// Builds a variant of the only model.
    fn build_variant<'a>(
        &self,
        variant: &Variant,
        models: &[Model<'a>],
        built: &[Built<'_>],
    ) -> Result<(Vec<Built<'a>>, Vec<Model<'a>>)> {
        let [model] = models else {
            bail!(
                "--name and --set need one model, but {} are exported",
                models.len()
            );
        };
        let text = variant.text(&model.description)?;
        let name = variant.name.as_deref().unwrap_or(model.name());
        let is_other = |built: &Built<'_>| built.find(name).is_some() && name != model.name();
        ensure!(
            !built.iter().any(is_other),
            "--name {name}: there is a model with this name; expected another name"
        );
        let built = self.build_library(model.library, Some(&text))?;
        let description = built
            .find(name)
            .with_context(|| format!("the variant {name} was not built"))?;
        let variant = Model::new(model.library, description.clone())?;
        let variant = Model {
            base: model.name().to_owned(),
            ..variant
        };
        Ok((vec![built], vec![variant]))
    }
}

impl Built<'_> {
    /// The model with the given name.
    fn find(&self, name: &str) -> Option<&Description> {
        let binary = self.binaries.first()?;
        binary.models().iter().find(|model| model.name == name)
    }
}

fn join<T>(thread: ScopedJoinHandle<'_, Result<T>>) -> Result<T> {
    thread
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// The targets to build for: the requested ones, else this machine.
fn targets(options: &Options) -> Result<Vec<Target>> {
    let mut names = options.targets.clone();
    if options.portable {
        names.insert(0, toolchain::portable()?);
    }
    check_platforms(options, &names)?;
    if names.is_empty() {
        return Ok(vec![Target::of_this_machine()?]);
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
fn choose<'a>(built: &[Built<'a>], names: &[String]) -> Result<Vec<Model<'a>>> {
    let mut all = Vec::new();
    for built in built {
        let models = built.binaries.iter().take(1).flat_map(Binary::models);
        all.extend(models.map(|model| (built.library, model)));
    }
    for (index, (library, model)) in all.iter().enumerate() {
        let name = &model.name;
        if let Some((other, _)) = all[..index].iter().find(|(_, other)| other.name == *name) {
            bail!(
                "two models have the name {name}, in the packages {} and {}; export one of them with --package",
                other.package,
                library.package
            );
        }
    }
    for name in names {
        if !all.iter().any(|(_, model)| model.name == *name) {
            let known: Vec<_> = all.iter().map(|(_, model)| model.name.as_str()).collect();
            bail!("model {name:?} is unknown; there are {}", known.join(", "));
        }
    }
    all.into_iter()
        .filter(|(_, model)| names.is_empty() || names.contains(&model.name))
        .map(|(library, model)| Model::new(library, model.clone()))
        .collect()
}

/// Checks that all binaries contain the same version of every model.
fn check_binaries(
    models: &[Model<'_>],
    built: &[Built<'_>],
    options: &Options,
    prebuilt: &[Binary],
) -> Result<()> {
    for model in models {
        let of_model = built
            .iter()
            .filter(|b| std::ptr::eq(b.library, model.library));
        for binary in of_model.flat_map(|built| &built.binaries) {
            binary.check_model(&model.description)?;
        }
        for (option, binary) in options.binaries.iter().zip(prebuilt) {
            binary
                .check_model(&model.description)
                .with_context(|| format!("{} cannot be used", option.file.display()))?;
        }
    }
    Ok(())
}

/// Writes the FMU of a model.
fn write<'a>(
    model: &Model<'_>,
    binaries: impl Iterator<Item = &'a PackedBinary>,
    contents: &[contents::File],
    out: &Path,
) -> Result<Written> {
    let name = model.name();
    let xml = Packed::text(model.xml.as_bytes())?;
    let contents = contents
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
        contents
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
