//! The export: builds the models of a workspace for the requested platforms, and writes their FMUs.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::panic;
use std::path::{Path, PathBuf};
use std::ptr;
use std::thread;
use std::time::SystemTime;

use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::Metadata;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use fmu_description::{ExportedModel, FmiVersion, InterfaceType, Naming, read_interfaces};
use fmu_file::archive::{self, MODEL_DESCRIPTION, Packed};
#[cfg(not(feature = "wasm"))]
use fmu_file::platform::TARGET_WASM;
use fmu_file::platform::{Platform, Prebuilt};
use fmu_file::replace;

use crate::binary::{BinarySource, PlatformBinary, check_functions, drop_replaced};
use crate::cargo::{self, BuildProgress, profile_settings, remap};
use crate::contents;
use crate::exports::{self, Exported};
use crate::guid::GuidBasis;
use crate::library::{ModelLibrary, Selection};
use crate::missing::Missing;
use crate::model::{self, BuiltModel, Variant};
use crate::sources::{self, Sources};
use crate::toolchain::{self, BuildTarget, Recipe, WasmDraft};
use crate::universal::join_mach_o;

/// What to export, and for which platforms; the options of `cargo fmu export`.
#[derive(Debug, Default, Args)]
pub struct ExportOptions {
    /// Models to export [default: all]
    #[arg(value_name = "MODEL")]
    pub models: Vec<String>,
    /// Other name and start values for the only model.
    #[command(flatten)]
    pub variant: Variant,
    /// Version of FMI; may be repeated. Files for FMI 3.0 are named MODEL_fmi3.fmu
    #[arg(long = "fmi", value_name = "VERSION", value_delimiter = ',', default_value = "2.0", value_parser = version())]
    pub versions: Vec<FmiVersion>,
    /// Interface type, co-simulation, model-exchange, or scheduled-execution with --fmi 3.0; may be repeated. The FMU has
    /// nothing of the other types [default: as the package says, or all that the model has]
    #[arg(long = "interface", value_name = "TYPE", value_delimiter = ',', value_parser = interface_type(), hide_possible_values = true)]
    pub interface_types: Vec<InterfaceType>,
    /// Names of variables: structured as pid.kp, or flat as pid_kp for tools such as Simulink
    /// [default: as the package says, or structured]
    #[arg(long, value_name = "CONVENTION", value_parser = naming())]
    pub naming: Option<Naming>,
    /// What the GUID follows from, for tools that cache by it: only the interface of the model, also the version of
    /// the package, or also its code [default: as the package says, or interface]
    #[arg(long, value_name = "interface|version|code", value_enum, hide_possible_values = true)]
    pub guid: Option<GuidBasis>,
    /// Leave out variables of types that FMI 2.0 lacks, instead of refusing the model
    #[arg(long)]
    pub omit_unsupported: bool,
    /// Output folder for the FMUs [default: fmu in cargo's target folder]
    #[arg(long, value_name = "DIR", value_parser = replace::folder)]
    pub out: Option<PathBuf>,
    /// Build for any Linux with glibc 2.17 or newer, using cargo-zigbuild
    #[arg(long)]
    pub portable: bool,
    /// Rust target to build for; may be repeated [default: this machine]. universal2-apple-darwin
    /// builds for both macOS architectures, x86_64-unknown-linux-gnu.2.28 for Linux with glibc 2.28, wasm
    /// (with --fmi 3.0) a WebAssembly component
    #[arg(long = "target", value_name = "TRIPLE")]
    pub targets: Vec<String>,
    /// Commit of the draft for WebAssembly components: c1aac17, or the later 77277f4, with which they can read
    /// resources
    #[arg(long, value_name = "COMMIT", value_enum, default_value_t, hide_possible_values = true)]
    pub wasm_draft: WasmDraft,
    /// Add C sources, which importers compile for their own targets; `only` leaves out binaries
    #[arg(long, value_name = "only", num_args = 0..=1, require_equals = true, default_missing_value = "beside", hide_possible_values = true)]
    pub sources: Option<SourcesOption>,
    /// Bytes of memory in C sources for what the model allocates besides its variables
    #[arg(long, value_name = "BYTES", requires = "sources", value_parser = clap::value_parser!(u32).range(..1 << 30))]
    pub heap: Option<u32>,
    /// Add a shared library built elsewhere, for linux64, win64, ...
    #[arg(long = "binary", value_name = "PLATFORM=FILE")]
    pub binaries: Vec<Prebuilt>,
    /// Which packages to build, and how.
    #[command(flatten)]
    pub selection: Selection,
    /// Build for this machine with the same flags as `cargo build` and `cargo test`, so that all three use the same
    /// dependencies: soon, but the binaries have the functions of all versions of FMI, and paths of this machine.
    #[arg(skip)]
    pub is_for_trial: bool,
    /// The arguments on the command line, by which a message tells how to export again.
    #[arg(skip)]
    pub arguments: Vec<String>,
}

/// Where C sources are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SourcesOption {
    /// Beside binaries.
    Beside,
    /// In FMUs without binaries.
    Only,
}

/// Reads a version of FMI from its number.
pub fn version() -> impl TypedValueParser<Value = FmiVersion> {
    let numbers = PossibleValuesParser::new(FmiVersion::ALL.map(FmiVersion::as_str));
    numbers.map(|number| FmiVersion::named(Some(&number)).unwrap_or_default())
}

fn interface_type() -> impl TypedValueParser<Value = InterfaceType> {
    let names = PossibleValuesParser::new(InterfaceType::ALL.map(InterfaceType::option_name));
    names.map(|name| InterfaceType::named(&name).unwrap_or_default())
}

fn naming() -> impl TypedValueParser<Value = Naming> {
    let names = PossibleValuesParser::new([Naming::Structured, Naming::Flat].map(Naming::as_str));
    names.map(|name| Naming::parse(&name).unwrap_or_default())
}

/// An FMU that was written.
#[derive(Debug)]
pub struct ExportedFmu {
    /// Path of the FMU.
    pub file: PathBuf,
    /// Its size in bytes.
    pub size: u64,
    /// The platform folders that it has binaries in, and `sources` if it has C sources.
    pub platforms: Vec<&'static str>,
}

/// Builds the models and writes their FMUs. `progress` receives each step of the build.
///
/// # Errors
/// There is no model, or none with a given name; a target is not supported; the build fails; a file
/// cannot be read or written.
pub fn export(
    options: &ExportOptions,
    progress: &dyn Fn(BuildProgress<'_>),
) -> Result<Vec<ExportedFmu>> {
    let begin = SystemTime::now();
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
    check_versions(options, &versions)?;
    check_sources(options)?;
    let profile = profile_settings(options.selection.profile(), &metadata)?;
    let mut missing = Missing::default();
    let recipe_in_c = options.sources.map(|_| Recipe::for_sources(&mut missing));
    let builders = versions.into_iter().map(|version| {
        Ok(Builder {
            options,
            metadata: &metadata,
            out: &out,
            profile: &profile,
            version,
            targets: targets(options, version, &mut missing)?,
            prebuilt: prebuilt(options, version)?,
            recipe_in_c: recipe_in_c.as_ref(),
            sources: RefCell::default(),
            progress,
        })
    });
    let builders = builders.collect::<Result<Vec<_>>>()?;
    missing.check()?;
    cargo::warning().iter().for_each(|warning| progress(BuildProgress::Said(warning)));
    let targets = builders.iter().take(1).flat_map(|b| &b.targets);
    let recipes = targets.flat_map(|target| &target.recipes);
    for recipe in recipes.filter(|recipe| recipe.is_named()) {
        progress(BuildProgress::Said(&recipe.to_string()));
    }
    // No FMU is written before all are complete.
    let mut built = Vec::new();
    for builder in &builders {
        built.push((builder.build_fmus(&libraries)?, builder));
    }
    let (mut written, mut exported) = (Vec::new(), Vec::new());
    for (fmus, builder) in built {
        let first = exported.len();
        for NewFmu { fmu, content, library } in fmus {
            replace::write(&fmu.file, &content)?;
            let is_of = |export: &Exported<'_>| ptr::eq(export.library, library);
            let at = exported[first..].iter().position(is_of).unwrap_or(exported.len() - first);
            if first + at == exported.len() {
                let sources = builder.sources_of(library);
                let version = builder.version;
                exported.push(Exported { library, version, fmus: Vec::new(), sources });
            }
            exported[first + at].fmus.push(fmu.file.clone());
            written.push(fmu);
        }
    }
    if !options.is_for_trial {
        let settings = exports::Settings {
            metadata: &metadata,
            arguments: &options.arguments,
            has_all_models: options.models.is_empty() && !options.variant.is_some(),
            is_variant: options.variant.is_some(),
            begin,
        };
        let _lock = lock(metadata.target_directory.as_std_path())?;
        for (file, package) in exports::record(exported, &settings)? {
            let (file, is_default) = (file.display(), options.out.is_none());
            let what = match is_default && fs::remove_file(file.to_string()).is_ok() {
                true => format!("removed {file}: the package {package} no longer has its model"),
                false => format!(
                    "warning: {file} is of an earlier export: the package {package} no longer has its model"
                ),
            };
            progress(BuildProgress::Said(&what));
        }
    }
    Ok(written)
}

/// An FMU that is to be written, and the library that it was built from.
struct NewFmu<'a> {
    fmu: ExportedFmu,
    content: Vec<u8>,
    library: &'a ModelLibrary,
}

/// What is built of a library.
#[derive(Default)]
struct What<'a> {
    /// The text of a [`Variant`].
    variant: Option<&'a str>,
    /// The only model, by its name in the library; all models if there is none.
    model: Option<&'a str>,
    /// The interface types that are asked for, if not those of the library.
    interface_types: Vec<InterfaceType>,
    /// What its instance has for the model to allocate (bytes).
    heap: Option<u64>,
    /// Arguments for the compiler of this library.
    compiler_args: &'a [String],
}

/// Builds FMUs of one version of FMI.
struct Builder<'a> {
    options: &'a ExportOptions,
    metadata: &'a Metadata,
    /// The output folder.
    out: &'a Path,
    /// Settings of the profile that the workspace does not make itself, for each [`Product`](cargo::Product).
    profile: &'a [Vec<String>; 3],
    version: FmiVersion,
    targets: Vec<BuildTarget>,
    prebuilt: Vec<PlatformBinary<'a>>,
    /// How C sources are made, if they are asked for.
    recipe_in_c: Option<&'a Recipe>,
    /// The sources of each package, as far as it was built.
    sources: RefCell<BTreeSet<(String, PathBuf)>>,
    /// Receives each step of the build.
    progress: &'a dyn Fn(BuildProgress<'_>),
}

/// The folder of the draft of a layered standard that defines WebAssembly FMUs.
const EXTRA_WASM: &str = "extra/org.modelica.fmi-ls-wasm";
const MANIFEST: &str = include_str!("manifest.xml");

/// Keeps the compiler from joining neighbouring values in vectors. A step touches each value once, and a
/// vector cannot be loaded before the stores of its parts have left the processor's store buffer.
const NO_SLP: &str = "-Cno-vectorize-slp";

impl<'a> Builder<'a> {
    /// Builds the requested models and packs their FMUs.
    fn build_fmus(&self, libraries: &'a [ModelLibrary]) -> Result<Vec<NewFmu<'a>>> {
        let mut built = self.build(libraries)?;
        let mut models = self.requested_models(&built)?;
        let mut variant = None;
        if self.options.variant.is_some() {
            let text = self.variant_text(&models)?;
            (built, models) = self.build_variant(&models, &built, &text)?;
            variant = Some(text);
        }
        for model in &models {
            let (variant, may_omit) = (&self.options.variant, self.options.omit_unsupported);
            let omitted = model::omitted(&model.description, self.version, variant, may_omit)?;
            if let Some(names) = omitted {
                let said = format!("{} leaves out {names}", model.file_name());
                (self.progress)(BuildProgress::Said(&said));
            }
            for reason in &model.warnings {
                let said =
                    format!("warning: {}: {reason}, expected another name", model.file_name());
                (self.progress)(BuildProgress::Said(&said));
            }
            for binary in built.iter().chain(&self.prebuilt) {
                binary.check_model(model)?;
            }
        }
        if let Some(recipe) = self.recipe_in_c {
            for model in &mut models {
                let sources = self.build_sources(model, recipe, variant.as_deref())?;
                model.add_sources(sources)?;
            }
        }
        // This machine's binary is built to read the models, even if it is not packed.
        drop_replaced(&mut built, &self.prebuilt);
        if self.options.sources == Some(SourcesOption::Only) {
            built.clear();
        }
        let packed = thread::scope(|scope| {
            let packing = built.iter().chain(&self.prebuilt);
            let packing =
                packing.map(|binary| (binary, scope.spawn(|| Packed::program(&binary.bytes))));
            let packed = Vec::from_iter(packing).into_iter().map(|(binary, thread)| {
                let packed = thread.join().unwrap_or_else(|p| panic::resume_unwind(p));
                Ok((binary, packed?))
            });
            packed.collect::<Result<Vec<_>>>()
        })?;
        models.iter().map(|model| self.pack(model, &packed)).collect()
    }

    /// The sources of a library that was built.
    fn sources_of(&self, library: &ModelLibrary) -> BTreeSet<PathBuf> {
        let sources = self.sources.borrow();
        let sources = sources.iter().filter(|(package, _)| *package == library.package);
        sources.map(|(_, source)| source.clone()).collect()
    }

    /// Builds libraries until all requested models are found; all libraries, if none is named.
    fn build(&self, libraries: &'a [ModelLibrary]) -> Result<Vec<PlatformBinary<'a>>> {
        let names = &self.options.models;
        let mut order: Vec<_> = libraries.iter().collect();
        if !names.is_empty() {
            order.sort_by_key(|library| !library.mentions(names));
        }
        let mut built: Vec<PlatformBinary<'a>> = Vec::new();
        for library in order {
            let is_found = |name: &String| built.iter().any(|b| b.model(name).is_some());
            if !names.is_empty() && names.iter().all(is_found) {
                break;
            }
            built.extend(self.build_library(library, None)?);
        }
        Ok(built)
    }

    /// The interface types that the FMUs of a library are for; none if they are for all.
    ///
    /// # Errors
    /// The version of FMI does not have the only one.
    fn interface_types(&self, library: &ModelLibrary) -> Result<Vec<InterfaceType>> {
        let types = match self.options.interface_types.as_slice() {
            [] => Vec::from_iter(library.interface_type),
            chosen => chosen.to_vec(),
        };
        ensure!(
            self.version == FmiVersion::Fmi3 || !types.contains(&InterfaceType::ScheduledExecution),
            "FMI 2.0 has no scheduled execution, for which the package {} is to be exported; expected --fmi 3.0",
            library.package
        );
        Ok(types)
    }

    /// Builds the binaries of a library for all targets; `variant` is the text of a [`Variant`].
    fn build_library(
        &self,
        library: &'a ModelLibrary,
        variant: Option<&str>,
    ) -> Result<Vec<PlatformBinary<'a>>> {
        let unusable = || format!("the library of {} cannot be used", library.package);
        let interface_types = self.interface_types(library)?;
        self.targets
            .iter()
            .map(|target| {
                let read = |bytes: &[u8]| read_models(bytes, &interface_types).with_context(unusable);
                let what = What { variant, ..What::default() };
                let mut bytes = self.build_binary(library, target, &what)?;
                let mut models = read(&bytes)?;
                // Only components with scheduled execution have its functions.
                let is_scheduled = models.iter().any(ExportedModel::is_for_scheduled_execution);
                let is_asked_for = interface_types.contains(&InterfaceType::ScheduledExecution);
                if target.platforms[0].is_wasm() && is_scheduled && !is_asked_for {
                    let what = What { interface_types: InterfaceType::ALL.to_vec(), ..what };
                    bytes = self.build_binary(library, target, &what)?;
                    models = read(&bytes)?;
                }
                let bytes = match target.platforms[0].is_wasm() {
                    true => encode_component(bytes, &models, self.options.wasm_draft)
                        .with_context(unusable)?,
                    false => bytes,
                };
                ensure!(
                    !models.is_empty(),
                    "the library of {} has no model; write in {}, with the name of the struct of your model:\n\nfmu_export::export!(MyModel);",
                    library.package,
                    library.folder.join("src/lib.rs").display()
                );
                check_functions(&bytes, self.version).with_context(unusable)?;
                Ok(PlatformBinary {
                    source: BinarySource::Library(library),
                    platforms: target.platforms.clone(),
                    bytes,
                    models,
                })
            })
            .collect()
    }

    /// Builds the binary of a library for a target.
    fn build_binary(
        &self,
        library: &ModelLibrary,
        target: &BuildTarget,
        what: &What<'_>,
    ) -> Result<Vec<u8>> {
        let extension = target.platforms[0].extension;
        let recipes = target.recipes.iter();
        let parts = recipes.map(|recipe| self.build_part(library, recipe, extension, what));
        let mut parts = parts.collect::<Result<Vec<_>>>()?;
        match parts.len() {
            1 => Ok(parts.remove(0)),
            _ => join_mach_o(&parts).context("cannot join the parts of a universal binary"),
        }
    }

    /// Builds a library with one recipe, and reads it.
    fn build_part(
        &self,
        library: &ModelLibrary,
        recipe: &Recipe,
        extension: &str,
        what: &What<'_>,
    ) -> Result<Vec<u8>> {
        let title = match what.model {
            Some(model) => format!("building {model} in C"),
            None => format!("building {}", library.package),
        };
        let profile = self.options.selection.profile();
        let mut build = match self.options.is_for_trial {
            true => recipe.cargo_rustc_for_trial(&title, profile),
            false => recipe.cargo_rustc(&title),
        };
        // As the only crate type, a `cdylib` gets LTO, which is not possible together with an rlib.
        build
            .args(["--lib", "--crate-type", "cdylib"])
            .args(["--package", &library.package])
            .args(self.options.selection.cargo_arguments());
        let interface_types = match what.interface_types.is_empty() {
            true => self.interface_types(library)?,
            false => what.interface_types.clone(),
        };
        let features = interface_types
            .into_iter()
            .filter(|of_type| {
                // The samples become model partitions only in such a library.
                !self.options.is_for_trial || *of_type == InterfaceType::ScheduledExecution
            })
            .flat_map(|of_type| ["--features".to_owned(), library.feature_of_interface(of_type)]);
        build.args(features);
        if !self.options.is_for_trial {
            let settings = &self.profile[recipe.product() as usize];
            build
                .args(["--features", &library.features(self.version, recipe.product())])
                .args(settings.iter().flat_map(|setting| ["--config", setting]))
                .without_local_paths(self.metadata, recipe.sources().as_deref());
        }
        // What `export!` reads at compile time; of the naming, see `Naming::chosen`.
        let naming = match (self.options.naming, library.naming) {
            (Some(chosen), _) => Some(chosen.as_str().to_owned()),
            (None, of_package) => of_package.map(|naming| format!("package:{}", naming.as_str())),
        };
        let basis = self.options.guid.unwrap_or(library.guid);
        let revision = basis.revision(&library.package, self.metadata)?;
        for (name, value) in [
            ("FMU_EXPORT_VARIANT", what.variant.map(str::to_owned)),
            ("FMU_EXPORT_MODEL", what.model.map(str::to_owned)),
            ("FMU_EXPORT_HEAP", what.heap.map(|bytes| bytes.to_string())),
            ("FMU_EXPORT_NAMING", naming),
            ("FMU_EXPORT_REVISION", revision),
        ] {
            match value {
                Some(value) => build.env(name, &value),
                None => build.without_env(name),
            };
        }
        if profile != "dev" {
            build.env("CARGO_INCREMENTAL", "0");
        }
        build
            .args(["--", NO_SLP])
            .args([remap(self.metadata.workspace_root.as_std_path(), "workspace")])
            .args(recipe.compiler_args(&library.target))
            .args(what.compiler_args);
        // Cargo copies the library to the same place for both versions of FMI and for variants, so another export
        // must not build before it is read.
        let _lock = lock(self.metadata.target_directory.as_std_path())?;
        let file = build.shared_library(&library.target, extension, self.progress)?;
        let sources = exports::sources(&file).into_iter();
        let sources = sources.map(|source| (library.package.clone(), source));
        self.sources.borrow_mut().extend(sources);
        fs::read(&file).with_context(|| format!("cannot read {}", file.display()))
    }

    /// Makes the C sources of a model; `variant` is the text of a [`Variant`].
    fn build_sources(
        &self,
        model: &BuiltModel<'a>,
        recipe: &Recipe,
        variant: Option<&str>,
    ) -> Result<Sources> {
        let library = model.library;
        // Only sources with scheduled execution have its function.
        let all = InterfaceType::ALL;
        let interface_types = match model.description.is_for_scheduled_execution() {
            true => all.into_iter().filter(|of| model.description.is_for(*of)).collect(),
            false => Vec::new(),
        };
        let build = |compiler_args: &[String], heap| {
            let (model, heap) = (Some(&*model.base), Some(heap));
            let interface_types = interface_types.clone();
            let what = What { variant, model, interface_types, heap, compiler_args };
            self.build_part(library, recipe, "wasm", &what)
        };
        let heap = u64::from(self.options.heap.unwrap_or_default());
        // With empty libraries in place of those that WebAssembly does not have.
        let scratch = self.metadata.target_directory.join("cargo-fmu-libraries");
        sources::build(model, heap, scratch.as_std_path(), &build)
            .with_context(|| format!("{} cannot be exported as C sources", model.name()))
    }

    /// The models with the requested names, or all.
    fn requested_models(&self, built: &[PlatformBinary<'a>]) -> Result<Vec<BuiltModel<'a>>> {
        let mut all: Vec<(&ModelLibrary, &ExportedModel)> = Vec::new();
        for binary in built {
            let BinarySource::Library(library) = binary.source else { continue };
            // The binary for another target has the same models.
            if all.last().is_some_and(|(last, _)| ptr::eq(*last, library)) {
                continue;
            }
            for model in &binary.models {
                let name = &model.name;
                if let Some((other, _)) = all.iter().find(|(_, other)| other.name == *name) {
                    bail!(
                        "two models have the name {name}, in the packages {} and {}; export one of them with --package",
                        other.package,
                        library.package
                    );
                }
                all.push((library, model));
            }
        }
        let names = &self.options.models;
        for name in names {
            if !all.iter().any(|(_, model)| model.name == *name) {
                let known: Vec<_> = all.iter().map(|(_, model)| model.name.as_str()).collect();
                bail!("model {name:?} is unknown; there are {}", known.join(", "));
            }
        }
        all.into_iter()
            .filter(|(_, model)| names.is_empty() || names.contains(&model.name))
            .map(|(library, model)| BuiltModel::new(library, model.clone(), self.version))
            .collect()
    }

    /// The text of the variant of the only model.
    fn variant_text(&self, models: &[BuiltModel<'a>]) -> Result<String> {
        match models {
            [model] => self.options.variant.text(&model.description),
            _ => bail!("--name and --set need one model, but {} are exported", models.len()),
        }
    }

    /// Builds a variant of the only model.
    fn build_variant(
        &self,
        models: &[BuiltModel<'a>],
        built: &[PlatformBinary<'_>],
        text: &str,
    ) -> Result<(Vec<PlatformBinary<'a>>, Vec<BuiltModel<'a>>)> {
        let model = &models[0];
        let name = self.options.variant.name.as_deref().unwrap_or(model.name());
        let is_other = built.iter().any(|binary| binary.model(name).is_some());
        ensure!(
            !is_other || name == model.name(),
            "--name {name}: there is a model with this name; expected another name"
        );
        let built = self.build_library(model.library, Some(text))?;
        let description = built.iter().find_map(|binary| binary.model(name));
        let description = description.context("the variant was not built")?;
        let variant = BuiltModel {
            base: model.name().to_owned(),
            ..BuiltModel::new(model.library, description.clone(), self.version)?
        };
        Ok((built, vec![variant]))
    }

    /// Packs the FMU of a model.
    fn pack(
        &self,
        model: &BuiltModel<'a>,
        packed: &[(&PlatformBinary<'_>, Packed)],
    ) -> Result<NewFmu<'a>> {
        let xml = Packed::text(model.xml.as_bytes())?;
        let contents = contents::files(model, self.metadata)?;
        let contents = contents
            .into_iter()
            .map(|(path, content)| Ok((path, Packed::text(&content)?)))
            .collect::<Result<Vec<_>>>()?;
        let manifest = Packed::text(MANIFEST.as_bytes())?;
        let mut entries = vec![(MODEL_DESCRIPTION.to_owned(), &xml)];
        let mut platforms = Vec::new();
        for (binary, file) in packed.iter().filter(|(binary, _)| binary.may_have(model)) {
            for platform in &binary.platforms {
                entries.push((platform.binary(model.name()), file));
                platforms.push(platform.folder);
            }
        }
        if model.sources.is_some() {
            platforms.push("sources");
        }
        if packed.iter().any(|(binary, _)| binary.platforms[0].is_wasm()) {
            entries.push((format!("{EXTRA_WASM}/manifest.xml"), &manifest));
        }
        entries.extend(contents.iter().map(|(path, file)| (path.clone(), file)));
        let name = model.file_name();
        let content = archive::zip(&entries).with_context(|| format!("cannot pack {name}"))?;
        let fmu = ExportedFmu { file: self.out.join(name), size: content.len() as u64, platforms };
        Ok(NewFmu { fmu, content, library: model.library })
    }
}

/// Reads the interfaces of models in a library that was built for some interface types, or for all.
fn read_models(library: &[u8], types: &[InterfaceType]) -> Result<Vec<ExportedModel>> {
    let models = read_interfaces(library)?.into_iter();
    let models = models.map(|model| ExportedModel { interface_types: types.to_vec(), ..model });
    Ok(models.collect())
}

#[cfg(feature = "wasm")]
use crate::component::encode as encode_component;

/// Stands in for the encoder in builds without the feature `wasm`.
#[cfg(not(feature = "wasm"))]
fn encode_component(_: Vec<u8>, _: &[ExportedModel], _: WasmDraft) -> Result<Vec<u8>> {
    bail!("this program was built without its feature `wasm`, which the target {TARGET_WASM} needs")
}

/// Locks a target folder against other exports until the file is closed. File systems without locks are used
/// without, as by cargo.
fn lock(target: &Path) -> Result<File> {
    let path = target.join(".cargo-fmu-lock");
    let file = fs::create_dir_all(target).and_then(|()| File::create(&path));
    let file = file.with_context(|| format!("cannot create {}", path.display()))?;
    let _ = file.lock();
    Ok(file)
}

/// Checks that no binary is asked for if there shall be none.
fn check_sources(options: &ExportOptions) -> Result<()> {
    let has_targets = !options.targets.is_empty() || options.portable;
    ensure!(
        options.sources != Some(SourcesOption::Only) || !has_targets && options.binaries.is_empty(),
        "--sources=only leaves out binaries; expected no --target, --portable or --binary, or --sources"
    );
    Ok(())
}

/// The targets to build for: the requested ones, else this machine.
fn targets(
    options: &ExportOptions,
    version: FmiVersion,
    missing: &mut Missing,
) -> Result<Vec<BuildTarget>> {
    let mut names = options.targets.clone();
    if options.portable {
        names.insert(0, toolchain::portable()?);
    }
    toolchain::check_names(&names)?;
    check_platforms(options, &names, version)?;
    if names.is_empty() {
        return Ok(vec![BuildTarget::of_this_machine(version)?]);
    }
    let targets = names.iter().map(|name| BuildTarget::named(name, version, missing));
    targets.collect()
}

/// The prebuilt binaries in the folders of a version of FMI.
fn prebuilt(options: &ExportOptions, version: FmiVersion) -> Result<Vec<PlatformBinary<'_>>> {
    let binaries = options.binaries.iter();
    binaries
        .filter(|prebuilt| prebuilt.platform.is_of(version))
        .map(|prebuilt| PlatformBinary::read(prebuilt, version))
        .collect()
}

/// Checks that each prebuilt binary is for a platform of one of the versions of FMI.
fn check_versions(options: &ExportOptions, versions: &[FmiVersion]) -> Result<()> {
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
fn check_platforms(options: &ExportOptions, names: &[String], version: FmiVersion) -> Result<()> {
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
