//! Exports the models of a workspace to FMU files.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread::{self, ScopedJoinHandle};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Description, FmiVersion};
use fmu_file::archive::{self, Compression, Entry, MODEL_DESCRIPTION, Packed};
use fmu_file::platform::{Platform, Prebuilt};
use fmu_file::replace;

use crate::binary::{Binary, Method, PackedBinary};
use crate::contents;
use crate::library::{Library, Selection};
use crate::model::{Model, Variant};
use crate::profile;
use crate::toolchain::{self, Recipe, Target};

/// What to export, and for which platforms.
#[derive(Debug, Default)]
pub struct Options {
    /// Which packages to build, and how.
    pub selection: Selection,
    /// Names of the models; all if empty.
    pub models: Vec<String>,
    /// Other name and start values for the only model.
    pub variant: Variant,
    /// Versions of FMI, each with its own FMUs; FMI 2.0 if empty.
    pub versions: Vec<FmiVersion>,
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
    let mut versions = options.versions.clone();
    if versions.is_empty() {
        versions.push(FmiVersion::default());
    }
    versions.sort_unstable();
    versions.dedup();
    for library in &libraries {
        for version in &versions {
            library.feature(*version)?;
        }
    }
    check_versions(options, &versions)?;
    let profile = profile::settings(&options.selection.profile, &metadata)?;
    let builders = versions.into_iter().map(|version| {
        Ok(Builder {
            method: Method {
                selection: &options.selection,
                metadata: &metadata,
                profile: &profile,
                version,
            },
            targets: targets(options, version)?,
            prebuilt: prebuilt(options, version)?,
        })
    });
    let builders = builders.collect::<Result<Vec<_>>>()?;
    for recipe in builders.iter().take(1).flat_map(Builder::named_recipes) {
        eprintln!("{recipe}");
    }
    let packages = builders
        .iter()
        .map(|builder| builder.packages(&libraries, options))
        .collect::<Result<Vec<_>>>()?;
    packages
        .iter()
        .flat_map(|packages| packages.write(&out))
        .collect()
}

/// The FMUs of one version of FMI, ready to be written.
struct Packages<'a> {
    /// The models, and the files of their FMUs other than the binaries.
    models: Vec<(Model<'a>, Vec<contents::File>)>,
    /// The binaries that were built from libraries.
    built: Vec<(&'a Library, PackedBinary)>,
    /// The binaries that were built before.
    prebuilt: Vec<PackedBinary>,
}

impl Packages<'_> {
    fn write(&self, out: &Path) -> impl Iterator<Item = Result<Written>> {
        self.models.iter().map(move |(model, contents)| {
            let of_model = self
                .built
                .iter()
                .filter(|(library, _)| std::ptr::eq(*library, model.library))
                .map(|(_, binary)| binary);
            write(model, of_model.chain(&self.prebuilt), contents, out)
        })
    }
}

/// Builds libraries for all targets.
struct Builder<'a> {
    method: Method<'a>,
    targets: Vec<Target>,
    /// Binaries that were built before, and their files.
    prebuilt: Vec<(&'a Path, Binary)>,
}

impl Builder<'_> {
    /// How the targets that were asked for by name are built.
    fn named_recipes(&self) -> impl Iterator<Item = &Recipe> {
        let recipes = self.targets.iter().flat_map(|target| &target.recipes);
        recipes.filter(|recipe| recipe.is_named())
    }

    /// Builds the requested models, describes them and compresses their binaries.
    fn packages<'a>(&self, libraries: &'a [Library], options: &Options) -> Result<Packages<'a>> {
        let metadata = self.method.metadata;
        let mut built = self.build(libraries, &options.models)?;
        let mut models = choose(&built, &options.models, self.method.version)?;
        if options.variant.is_some() {
            (built, models) = self.build_variant(&options.variant, &models, &built)?;
        }
        check_binaries(&models, &built, &self.prebuilt)?;
        let models = models
            .into_iter()
            .map(|model| {
                let contents = contents::files(&model, metadata)?;
                Ok((model, contents))
            })
            .collect::<Result<Vec<_>>>()?;
        let cache = metadata.target_directory.join("fmu-packed");
        fs::create_dir_all(&cache).with_context(|| format!("cannot make the folder {cache}"))?;
        let pack = |binary: &Binary| binary.pack(options.compression, cache.as_std_path());
        // This machine's binary is built to read the models, even if it is not packed.
        let is_packed = |binary: &Binary| {
            !self
                .prebuilt
                .iter()
                .any(|(_, other)| other.replaces(binary))
        };
        let (built, prebuilt) = thread::scope(|scope| {
            let packing = |binary| scope.spawn(move || pack(binary));
            let built: Vec<_> = built
                .iter()
                .flat_map(|built| built.binaries.iter().map(|binary| (built.library, binary)))
                .filter(|(_, binary)| is_packed(binary))
                .map(|(library, binary)| (library, packing(binary)))
                .collect();
            let prebuilt: Vec<_> = self
                .prebuilt
                .iter()
                .map(|(_, binary)| packing(binary))
                .collect();
            let built = built
                .into_iter()
                .map(|(library, packing)| Ok((library, join(packing)?)))
                .collect::<Result<Vec<_>>>()?;
            let prebuilt = prebuilt.into_iter().map(join).collect::<Result<Vec<_>>>()?;
            anyhow::Ok((built, prebuilt))
        })?;
        Ok(Packages {
            models,
            built,
            prebuilt,
        })
    }

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
        let variant = Model::new(model.library, description.clone(), self.method.version)?;
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
fn targets(options: &Options, version: FmiVersion) -> Result<Vec<Target>> {
    let mut names = options.targets.clone();
    if options.portable {
        names.insert(0, toolchain::portable()?);
    }
    check_platforms(options, &names, version)?;
    if names.is_empty() {
        return Ok(vec![Target::of_this_machine(version)?]);
    }
    let targets = names.iter().map(|name| Target::named(name, version));
    targets.collect()
}

/// The prebuilt binaries in the folders of a version of FMI.
fn prebuilt(options: &Options, version: FmiVersion) -> Result<Vec<(&Path, Binary)>> {
    let binaries = options.binaries.iter();
    binaries
        .filter(|prebuilt| prebuilt.platform.is_of(version))
        .map(|prebuilt| Ok((&*prebuilt.file, Binary::read(prebuilt, version)?)))
        .collect()
}

/// Checks that each prebuilt binary is for a platform of one of the versions of FMI.
fn check_versions(options: &Options, versions: &[FmiVersion]) -> Result<()> {
    for Prebuilt { platform, file } in &options.binaries {
        if !versions.iter().any(|version| platform.is_of(*version)) {
            for version in versions {
                let (file, number) = (file.display(), version.as_str());
                Platform::named(platform.folder, *version)
                    .with_context(|| format!("{file} cannot be used for FMI {number}"))?;
            }
        }
    }
    Ok(())
}

/// Checks that no two binaries, prebuilt or built, are for the same platform.
fn check_platforms(options: &Options, names: &[String], version: FmiVersion) -> Result<()> {
    let mut platforms: Vec<Platform> = options.binaries.iter().map(|b| b.platform).collect();
    for name in names {
        platforms.extend(Platform::of_target(name, version)?);
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
fn choose<'a>(
    built: &[Built<'a>],
    names: &[String],
    version: FmiVersion,
) -> Result<Vec<Model<'a>>> {
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
        .map(|(library, model)| Model::new(library, model.clone(), version))
        .collect()
}

/// Checks that all binaries contain the same version of every model.
fn check_binaries(
    models: &[Model<'_>],
    built: &[Built<'_>],
    prebuilt: &[(&Path, Binary)],
) -> Result<()> {
    for model in models {
        let of_model = built
            .iter()
            .filter(|b| std::ptr::eq(b.library, model.library));
        for binary in of_model.flat_map(|built| &built.binaries) {
            binary.check_model(&model.description)?;
        }
        for (file, binary) in prebuilt {
            binary
                .check_model(&model.description)
                .with_context(|| format!("{} cannot be used", file.display()))?;
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
    let file = out.join(model.file_name());
    let size = archive::write(&file, &entries)?;
    Ok(Written {
        file,
        size,
        platforms,
    })
}
