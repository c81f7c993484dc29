//! The packages of a workspace whose libraries contain models.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::{CrateType, Metadata, MetadataCommand, Package, Target};
use clap::{Args, ValueEnum};
use fmu_description::{FmiVersion, InterfaceType, Naming, Origin};

use crate::cargo::{Product, RELEASE};
use crate::dependency::{Dependency, FMU_EXPORT, VERSION};
use crate::guid::GuidBasis;

/// Which packages to build, and how; the options mean the same as cargo's.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Options of cargo")]
pub struct Selection {
    /// Manifest of the package or workspace [default: the one in the current folder]
    #[arg(long, value_name = "PATH")]
    pub manifest_path: Option<PathBuf>,
    /// Package with the models; may be repeated [default: as cargo build, else all with models]
    #[arg(short, long = "package", value_name = "NAME")]
    pub packages: Vec<String>,
    /// Features of the package
    #[arg(short = 'F', long, value_name = "FEATURES", value_delimiter = ',')]
    pub features: Vec<String>,
    /// Activate all features
    #[arg(long)]
    pub all_features: bool,
    /// Do not activate the default features
    #[arg(long)]
    pub no_default_features: bool,
    /// Profile to build with
    #[arg(long, value_name = "NAME", default_value = RELEASE)]
    pub profile: Option<String>,
}

/// A package with a `cdylib` of models.
#[derive(Debug)]
pub struct ModelLibrary {
    /// Name of the package.
    pub package: String,
    /// Name of its library target.
    pub target: String,
    /// Folder of the package.
    pub folder: PathBuf,
    /// Version, author and licence for the XML.
    pub origin: Origin,
    /// How the names of variables are written, if the package says so.
    pub naming: Option<Naming>,
    /// The only interface type to export, if the package says so.
    pub interface_type: Option<InterfaceType>,
    /// What the GUID follows from.
    pub guid: GuidBasis,
    /// The file of `license-file`.
    pub license_file: Option<PathBuf>,
    /// The name of the crate `fmu-export` in its manifest.
    dependency: String,
}

impl Selection {
    /// The metadata of the workspace.
    ///
    /// # Errors
    /// There is no workspace.
    pub fn metadata(&self) -> Result<Metadata> {
        let mut command = MetadataCommand::new();
        if let Some(path) = &self.manifest_path {
            command.manifest_path(path);
        }
        command.exec().with_context(|| match &self.manifest_path {
            Some(path) => format!("cannot read the cargo package {}", path.display()),
            None => "cannot read the cargo package of the current folder".into(),
        })
    }

    /// The profile to build with.
    pub fn profile(&self) -> &str {
        self.profile.as_deref().unwrap_or(RELEASE)
    }

    /// The options for cargo.
    pub fn cargo_arguments(&self) -> Vec<String> {
        let mut arguments = vec!["--profile".to_owned(), self.profile().to_owned()];
        if let Some(path) = &self.manifest_path {
            arguments.extend(["--manifest-path".to_owned(), path.display().to_string()]);
        }
        if !self.features.is_empty() {
            arguments.extend(["--features".to_owned(), self.features.join(",")]);
        }
        if self.all_features {
            arguments.push("--all-features".to_owned());
        }
        if self.no_default_features {
            arguments.push("--no-default-features".to_owned());
        }
        arguments
    }

    /// The libraries with models: of the given packages, else of the package of the current folder, else
    /// of the default members of the workspace, else of all its packages.
    ///
    /// # Errors
    /// A given package cannot have models, or no package has. The message says what to write.
    pub fn libraries(&self, metadata: &Metadata) -> Result<Vec<ModelLibrary>> {
        let members = metadata.workspace_packages();
        if !self.packages.is_empty() {
            return self
                .packages
                .iter()
                .map(|name| {
                    let package = members.iter().find(|package| *package.name == *name);
                    let package = package.with_context(|| unknown_package(name, &members))?;
                    library(package, metadata)
                })
                .collect();
        }
        if let Some(root) = metadata.root_package()
            && uses_fmu_export(root)
        {
            return Ok(vec![library(root, metadata)?]);
        }
        let default = metadata.workspace_default_packages();
        let chosen =
            if default.iter().any(|package| uses_fmu_export(package)) { default } else { members };
        let users: Vec<_> = chosen.into_iter().filter(|p| uses_fmu_export(p)).collect();
        let found: Vec<_> = users
            .iter()
            .filter(|package| cdylib(package).is_some())
            .map(|package| library(package, metadata))
            .collect::<Result<_>>()?;
        match (found.is_empty(), users.first()) {
            (false, _) => Ok(found),
            (true, Some(package)) => Err(no_cdylib(package)),
            (true, None) => bail!(
                "no package of {} depends on {FMU_EXPORT}; run `cargo fmu new NAME` for a new package, or write in Cargo.toml:\n\n{}",
                metadata.workspace_root,
                dependency()
            ),
        }
    }
}

fn library(package: &Package, metadata: &Metadata) -> Result<ModelLibrary> {
    ensure!(
        uses_fmu_export(package),
        "the package {} does not depend on {FMU_EXPORT}; write in {}:\n\n{}",
        package.name,
        package.manifest_path,
        dependency()
    );
    let target = cdylib(package).ok_or_else(|| no_cdylib(package))?;
    check_version(package, metadata)?;
    let folder = package.manifest_path.parent();
    let declared = package.dependencies.iter().find(|d| d.name == FMU_EXPORT);
    let renamed = declared.and_then(|dependency| dependency.rename.clone());
    Ok(ModelLibrary {
        package: package.name.to_string(),
        target: target.name.clone(),
        folder: folder.context("a manifest has a folder")?.into(),
        origin: origin(package),
        naming: setting(package, "naming", Naming::parse, "\"flat\" or \"structured\"")?,
        interface_type: setting(
            package,
            "interface",
            InterfaceType::named,
            "\"co-simulation\", \"model-exchange\" or \"scheduled-execution\"",
        )?,
        guid: setting(
            package,
            "guid",
            |name| GuidBasis::from_str(name, false).ok(),
            "\"interface\", \"version\" or \"code\"",
        )?
        .unwrap_or_default(),
        license_file: package.license_file().map(Into::into),
        dependency: renamed.unwrap_or_else(|| FMU_EXPORT.to_owned()),
    })
}

fn uses_fmu_export(package: &Package) -> bool {
    package.dependencies.iter().any(|d| d.name == FMU_EXPORT)
}

fn cdylib(package: &Package) -> Option<&Target> {
    let mut targets = package.targets.iter();
    targets.find(|target| target.crate_types.contains(&CrateType::CDyLib))
}

/// The lines of a manifest with the dependency.
fn dependency() -> String {
    format!("[dependencies]\n{}", Dependency::default())
}

fn no_cdylib(package: &Package) -> anyhow::Error {
    anyhow::anyhow!(
        "the package {} has no library of the type cdylib; write in {}:\n\n[lib]\ncrate-type = [\"cdylib\", \"rlib\"]",
        package.name,
        package.manifest_path
    )
}

fn unknown_package(name: &str, members: &[&Package]) -> String {
    let known: Vec<_> = members.iter().map(|package| package.name.as_str()).collect();
    format!("the workspace has no package {name:?}; there are {}", known.join(", "))
}

/// Checks that a package uses the version of `fmu-export` that this program knows.
fn check_version(package: &Package, metadata: &Metadata) -> Result<()> {
    let nodes = metadata.resolve.iter().flat_map(|resolve| &resolve.nodes);
    let node = nodes.into_iter().find(|node| node.id == package.id);
    let used = node
        .iter()
        .flat_map(|node| &node.dependencies)
        .map(|id| &metadata[id])
        .find(|dependency| *dependency.name == FMU_EXPORT)
        .with_context(|| {
            let name = &package.name;
            format!("cargo does not build {FMU_EXPORT} for the package {name}; is it optional?")
        })?;
    let version = &used.version;
    ensure!(
        format!("{}.{}", version.major, version.minor) == VERSION,
        "the package {} uses {FMU_EXPORT} {version}, but this is cargo-fmu {VERSION}; write in {}:\n\n{}\n\nor install the other version with `cargo install cargo-fmu@{version}`",
        package.name,
        package.manifest_path,
        dependency()
    );
    Ok(())
}

/// Version, author and licence of a package. Cargo has no field for a copyright notice, which is
/// `copyright` in `[package.metadata.fmu]`.
fn origin(package: &Package) -> Origin {
    let copyright = &package.metadata["fmu"]["copyright"];
    let license_file = package.license_file.as_ref();
    Origin {
        version: package.version.to_string(),
        author: (!package.authors.is_empty()).then(|| package.authors.join(", ")),
        copyright: copyright.as_str().map(str::to_owned),
        license: package.license.clone().or_else(|| Some(license_file?.file_name()?.to_owned())),
        generation_tool: concat!("cargo-fmu ", env!("CARGO_PKG_VERSION")).into(),
    }
}

/// A setting in `[package.metadata.fmu]`; `expected` are its values, as a message has them.
///
/// # Errors
/// It has another value.
fn setting<T>(
    package: &Package,
    key: &str,
    parse: fn(&str) -> Option<T>,
    expected: &str,
) -> Result<Option<T>> {
    let found = &package.metadata["fmu"][key];
    let known = found.as_str().and_then(parse);
    ensure!(
        found.is_null() || known.is_some(),
        "{}: {key} = {found} in [package.metadata.fmu]; expected {expected}",
        package.manifest_path
    );
    Ok(known)
}

impl ModelLibrary {
    /// The features for a product with the functions of one version of FMI only.
    pub fn features(&self, version: FmiVersion, product: Product) -> String {
        let dependency = &self.dependency;
        let version = match version {
            FmiVersion::Fmi2 => "fmi2",
            FmiVersion::Fmi3 => "fmi3",
        };
        match product {
            Product::Library | Product::Component => format!("{dependency}/{version}"),
            Product::Sources => format!("{dependency}/{version},{dependency}/sources"),
        }
    }

    /// The feature for a library with instances of one interface type only.
    pub fn feature_of_interface(&self, interface_type: InterfaceType) -> String {
        format!("{}/{}", self.dependency, interface_type.option_name())
    }

    /// Whether a source file mentions one of the names as a word: a library that does is likely to have
    /// the model.
    pub fn mentions(&self, names: &[String]) -> bool {
        let is_named = |(file, content): &NamedFile| {
            let text = String::from_utf8_lossy(content);
            let mut words = text.split(|c: char| !c.is_alphanumeric() && c != '_');
            file.ends_with(".rs") && words.any(|word| names.iter().any(|name| name == word))
        };
        let files = read(&self.folder.join("src"));
        files.map_or(true, |files| files.iter().any(is_named))
    }
}

/// A file: its path in a folder or in an FMU, and its content.
pub type NamedFile = (String, Vec<u8>);

/// All files below a folder except hidden ones, sorted by their names; none if there is no such folder.
pub fn read(folder: &Path) -> Result<Vec<NamedFile>> {
    let mut files = Vec::new();
    if fs::symlink_metadata(folder).is_ok() {
        add(folder, "", &mut files)?;
        files.sort();
    }
    Ok(files)
}

/// Adds all files below a folder; `prefix` is added to their names.
fn add(folder: &Path, prefix: &str, files: &mut Vec<NamedFile>) -> Result<()> {
    let cannot = || format!("cannot read {}", folder.display());
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let entry = entry.with_context(cannot)?;
        let path = entry.path();
        let Ok(name) = entry.file_name().into_string() else {
            bail!("the file name {} is not UTF-8", path.display());
        };
        if name.starts_with('.') {
            continue;
        }
        let kind = entry.file_type().with_context(cannot)?;
        if kind.is_dir() {
            add(&path, &format!("{prefix}{name}/"), files)?;
            continue;
        }
        // A link could include any file of this machine in the FMU.
        ensure!(
            kind.is_file(),
            "{} is a symbolic link or a device, expected a file",
            path.display()
        );
        let content = fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        files.push((format!("{prefix}{name}"), content));
    }
    Ok(())
}
