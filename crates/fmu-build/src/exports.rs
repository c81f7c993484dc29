//! The record of what was exported: in the target folder of a workspace, each FMU with the package and the sources that
//! it was built from. By it, FMUs that are older than their sources are found, and those whose models are gone.

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use cargo_metadata::Metadata;
use fmu_description::FmiVersion;
use fmu_description::hash::checksum;
use fmu_file::replace;
use serde::{Deserialize, Serialize};

use crate::library::ModelLibrary;

/// The file in the target folder.
const RECORD: &str = ".cargo-fmu-exports.json";
/// The command by default.
const EXPORT: &str = "cargo fmu export";

/// All FMUs in the record of a target folder.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Record {
    exports: Vec<Export>,
}

/// FMUs that were built from a package for one version of FMI.
#[derive(Debug, Serialize, Deserialize)]
pub struct Export {
    package: String,
    /// The manifest of the package.
    manifest: PathBuf,
    /// The version of FMI.
    version: String,
    /// Whether they are variants of models.
    is_variant: bool,
    /// The command that exported them, and the folder that it was run in.
    command: String,
    folder: PathBuf,
    fmus: Vec<State>,
    sources: Vec<State>,
}

/// A file or a folder, as it was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct State {
    path: PathBuf,
    /// The time of its last change (ns).
    modified: u64,
    size: u64,
    /// Hash of the content, or of the names in a folder.
    hash: String,
}

impl State {
    fn of(path: PathBuf) -> Option<Self> {
        let (modified, size) = modified_and_size(&path)?;
        let hash = hash(&path)?;
        Some(Self { path, modified, size, hash })
    }

    /// Whether the content is the same. It is read only if the time or the size differ, since tools such as git set the
    /// time of a file whose content they leave.
    fn is_unchanged(&self) -> bool {
        modified_and_size(&self.path) == Some((self.modified, self.size))
            || hash(&self.path).as_deref() == Some(&self.hash)
    }
}

fn modified_and_size(path: &Path) -> Option<(u64, u64)> {
    let data = fs::metadata(path).ok()?;
    let since = data.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    let size = if data.is_dir() { 0 } else { data.len() };
    Some((since.as_nanos().try_into().ok()?, size))
}

fn hash(path: &Path) -> Option<String> {
    let content = match path.is_dir() {
        true => Vec::from_iter(names(path)).join("/").into_bytes(),
        false => fs::read(path).ok()?,
    };
    Some(format!("{:032x}", checksum(&content)))
}

/// The names in a folder that are not hidden.
fn names(folder: &Path) -> BTreeSet<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| !name.starts_with('.')).collect()
}

/// The sources in the file that cargo writes beside a library for `make`: of the package, and of all packages in other
/// folders that it depends on.
pub fn sources(library: &Path) -> Vec<PathBuf> {
    let text = fs::read_to_string(library.with_extension("d")).unwrap_or_default();
    let mut lines = text.lines().filter_map(|line| line.split_once(": "));
    // A space in a path follows a backslash.
    let paths = lines.next().map(|(_, paths)| paths.replace("\\ ", "\0")).unwrap_or_default();
    paths.split_whitespace().map(|path| path.replace('\0', " ").into()).collect()
}

/// What was exported from a library for one version of FMI.
pub struct Exported<'a> {
    pub library: &'a ModelLibrary,
    pub version: FmiVersion,
    pub fmus: Vec<PathBuf>,
    /// The sources of its binaries.
    pub sources: BTreeSet<PathBuf>,
}

/// How it was exported.
pub struct Settings<'a> {
    pub metadata: &'a Metadata,
    /// The arguments after `cargo fmu export`.
    pub arguments: &'a [String],
    /// Whether all models of the libraries were exported.
    pub has_all_models: bool,
    pub is_variant: bool,
    /// When the export began.
    pub begin: SystemTime,
}

/// Adds exports to the record. Returns the FMUs in their folders that earlier exports of the same packages have written,
/// but whose models are gone, with the names of the packages; unless they were changed since.
///
/// # Errors
/// The record cannot be written.
pub fn record(new: Vec<Exported<'_>>, settings: &Settings<'_>) -> Result<Vec<(PathBuf, String)>> {
    let target = settings.metadata.target_directory.as_std_path();
    let mut record = Record::read(target).unwrap_or_default();
    let mut gone = Vec::new();
    for exported in new {
        gone.extend(record.add(Export::new(exported, settings), settings.has_all_models));
    }
    let text = serde_json::to_vec(&record)?;
    let file = target.join(RECORD);
    replace::write(&file, &text).with_context(|| format!("cannot write {}", file.display()))?;
    Ok(gone)
}

impl Export {
    fn new(exported: Exported<'_>, settings: &Settings<'_>) -> Self {
        let Exported { library, version, fmus, sources } = exported;
        let manifest = library.folder.join("Cargo.toml");
        let target = settings.metadata.target_directory.as_std_path();
        let mut paths = sources;
        // What a build script has generated is no source.
        paths.retain(|path| !path.starts_with(target));
        paths
            .extend([manifest.clone(), settings.metadata.workspace_root.join("Cargo.toml").into()]);
        for folder in ["documentation", "references", "resources"] {
            add_with_contents(library.folder.join(folder), &mut paths);
        }
        let state = |path: PathBuf| State::of(canonical(&path)?);
        let mut sources = Vec::from_iter(paths.into_iter().filter_map(state));
        for source in &mut sources {
            // It may have been built from another content.
            let at = UNIX_EPOCH + Duration::from_nanos(source.modified);
            if at > settings.begin {
                (source.modified, source.hash) = (0, String::new());
            }
        }
        let words = settings.arguments.iter().map(|argument| quoted(argument));
        Self {
            package: library.package.clone(),
            manifest,
            version: version.as_str().to_owned(),
            is_variant: settings.is_variant,
            command: [EXPORT.to_owned()].into_iter().chain(words).collect::<Vec<_>>().join(" "),
            folder: env::current_dir().unwrap_or_default(),
            fmus: fmus.into_iter().filter_map(state).collect(),
            sources,
        }
    }

    /// The source that was changed last, if one was.
    fn changed(&self) -> Option<&Path> {
        let changed = self.sources.iter().filter(|source| !source.is_unchanged());
        let newest = changed.max_by_key(|source| modified_and_size(&source.path));
        newest.map(|source| source.path.as_path())
    }
}

fn canonical(path: &Path) -> Option<PathBuf> {
    path.canonicalize().ok()
}

/// Adds a file or folder, and all files and folders in it.
fn add_with_contents(path: PathBuf, paths: &mut BTreeSet<PathBuf>) {
    if path.is_dir() {
        for name in names(&path) {
            add_with_contents(path.join(name), paths);
        }
    }
    if path.exists() {
        paths.insert(path);
    }
}

/// An argument in a shell.
fn quoted(argument: &str) -> String {
    match argument.chars().all(|c| c.is_alphanumeric() || "-_./=,:+@%".contains(c)) {
        true => argument.to_owned(),
        false => format!("'{}'", argument.replace('\'', "'\\''")),
    }
}

impl Record {
    fn read(target: &Path) -> Option<Self> {
        serde_json::from_slice(&fs::read(target.join(RECORD)).ok()?).ok()
    }

    /// Adds an export, which replaces FMUs of earlier ones. If it has all models of its package, returns the FMUs in the
    /// same folders that earlier exports of the package have written, unless they were changed since.
    fn add(&mut self, export: Export, has_all_models: bool) -> Vec<(PathBuf, String)> {
        let mut gone = Vec::new();
        let folders = BTreeSet::from_iter(export.fmus.iter().filter_map(|fmu| fmu.path.parent()));
        for earlier in &mut self.exports {
            let is_same = has_all_models
                && !earlier.is_variant
                && (&earlier.manifest, &earlier.version) == (&export.manifest, &export.version);
            earlier.fmus.retain(|fmu| {
                let is_replaced = export.fmus.iter().any(|new| new.path == fmu.path);
                let is_beside = fmu.path.parent().is_some_and(|folder| folders.contains(folder));
                let is_gone = is_same && is_beside && !is_replaced;
                if is_gone && fmu.is_unchanged() {
                    gone.push((fmu.path.clone(), earlier.package.clone()));
                }
                !is_replaced && !is_gone
            });
        }
        self.exports.push(export);
        self.exports.retain(|export| export.fmus.iter().any(|fmu| fmu.path.exists()));
        gone
    }
}

/// Warnings of FMUs that are older than their sources, as far as the record of the target folder above them knows.
pub fn stale(fmus: &[PathBuf]) -> Vec<String> {
    let mut records: Vec<(PathBuf, Record)> = Vec::new();
    // FMUs with the same reason, which is reported once.
    let mut stale: Vec<(Vec<String>, PathBuf, String)> = Vec::new();
    for fmu in BTreeSet::from_iter(fmus.iter().filter_map(|fmu| canonical(fmu))) {
        let folders = fmu.ancestors().skip(1);
        for target in folders.flat_map(|folder| [folder.to_owned(), folder.join("target")]) {
            if !records.iter().any(|(known, _)| *known == target)
                && let Some(record) = Record::read(&target)
            {
                records.push((target.clone(), record));
            }
            let record = records.iter().find(|(known, _)| *known == target);
            let exports = record.into_iter().flat_map(|(_, record)| &record.exports);
            let is_of = |export: &&Export| export.fmus.iter().any(|known| known.path == fmu);
            let Some(export) = exports.into_iter().find(is_of) else { continue };
            let is_own = export.fmus.iter().any(|known| known.path == fmu && known.is_unchanged());
            // A package that is gone or was moved says nothing.
            if is_own
                && export.manifest.is_file()
                && let Some(source) = export.changed()
            {
                let command = in_folder(&export.command, &export.folder);
                match stale.iter_mut().find(|(_, s, c)| s == source && *c == command) {
                    Some((names, ..)) => names.push(shown(&fmu)),
                    None => stale.push((vec![shown(&fmu)], source.to_owned(), command)),
                }
            }
            break;
        }
    }
    let text = |(fmus, source, command): (Vec<String>, PathBuf, String)| {
        let (is, them) = if fmus.len() == 1 { ("is", "it") } else { ("are", "them") };
        let how = if source.exists() { "has changed" } else { "is gone" };
        let (fmus, source) = (fmus.join(" and "), shown(&source));
        format!(
            "{fmus} {is} older than the sources: {source} {how}; `{command}` builds {them} again"
        )
    };
    stale.into_iter().map(text).collect()
}

/// The command that exports an FMU that does not exist, if its path is in the target folder of a package.
pub fn export_command(missing: &Path) -> Option<String> {
    let missing = std::path::absolute(missing).ok()?;
    let mut folders = missing.ancestors().skip(1);
    let target = folders.find(|folder| folder.file_name().is_some_and(|name| name == "target"))?;
    let package = target.parent().filter(|folder| folder.join("Cargo.toml").is_file())?;
    let is_fmi_3 = missing.to_string_lossy().ends_with("_fmi3.fmu");
    let command = format!("{EXPORT}{}", if is_fmi_3 { " --fmi 3.0" } else { "" });
    let is_below = env::current_dir().is_ok_and(|here| here.starts_with(package));
    Some(if is_below { command } else { in_folder(&command, package) })
}

/// A command with the folder that it must be run in.
fn in_folder(command: &str, folder: &Path) -> String {
    match env::current_dir().is_ok_and(|here| here == folder) {
        true => command.to_owned(),
        false => format!("cd {} && {command}", quoted(&folder.to_string_lossy())),
    }
}

/// A path relative to the current folder, if it is below.
fn shown(path: &Path) -> String {
    let here = env::current_dir().ok().and_then(|here| canonical(&here));
    let relative = here.as_ref().and_then(|here| path.strip_prefix(here).ok());
    relative.unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use super::*;

    /// A package with one source, and what was exported from it.
    struct Package(tempfile::TempDir);

    impl Package {
        fn new() -> Self {
            let package = Self(tempfile::tempdir().unwrap());
            fs::create_dir_all(package.path("target/fmu")).unwrap();
            package.write("Cargo.toml", "");
            package.write("lib.rs", "old");
            package
        }

        fn path(&self, name: &str) -> PathBuf {
            self.0.path().canonicalize().unwrap().join(name)
        }

        fn write(&self, name: &str, content: &str) {
            fs::write(self.path(name), content).unwrap();
        }

        fn export(&self, models: &[&str]) -> Export {
            let fmus = models.iter().map(|model| {
                let name = format!("target/fmu/{model}.fmu");
                self.write(&name, model);
                State::of(self.path(&name)).unwrap()
            });
            Export {
                package: "own".into(),
                manifest: self.path("Cargo.toml"),
                version: "2.0".into(),
                is_variant: false,
                command: EXPORT.into(),
                folder: self.path(""),
                fmus: fmus.collect(),
                sources: vec![State::of(self.path("lib.rs")).unwrap()],
            }
        }

        fn touch(&self, name: &str) {
            let later = SystemTime::now() + Duration::from_secs(5);
            File::options()
                .append(true)
                .open(self.path(name))
                .unwrap()
                .set_modified(later)
                .unwrap();
        }

        fn stale(&self) -> Vec<String> {
            stale(&[self.path("target/fmu/A.fmu"), self.path("target/fmu/B.fmu")])
        }
    }

    #[test]
    fn an_fmu_is_stale_if_the_content_of_a_source_has_changed() {
        let package = Package::new();
        let record = Record { exports: vec![package.export(&["A", "B"])] };
        package.write(&format!("target/{RECORD}"), &serde_json::to_string(&record).unwrap());
        assert!(package.stale().is_empty());
        package.touch("lib.rs");
        assert!(package.stale().is_empty(), "only its time has changed");
        package.write("lib.rs", "new");
        let [warning] = &package.stale()[..] else { panic!("one warning for both") };
        for part in ["A.fmu and ", "B.fmu are older", "lib.rs has changed", "&& cargo fmu export`"]
        {
            assert!(warning.contains(part), "{warning}");
        }
        package.write("target/fmu/B.fmu", "of another vendor");
        assert!(package.stale()[0].contains("A.fmu is older"));
        fs::remove_file(package.path("lib.rs")).unwrap();
        assert!(package.stale()[0].contains("lib.rs is gone"));
        fs::remove_file(package.path("Cargo.toml")).unwrap();
        assert!(package.stale().is_empty(), "the package was moved");
    }

    #[test]
    fn only_untouched_fmus_of_the_same_package_are_gone() {
        let package = Package::new();
        let mut record = Record::default();
        assert!(record.add(package.export(&["A", "B", "C"]), true).is_empty());
        let variant = Export { is_variant: true, ..package.export(&["Fast"]) };
        assert!(record.add(variant, false).is_empty());
        let other = Export { manifest: package.path("other"), ..package.export(&["Other"]) };
        assert!(record.add(other, true).is_empty());
        assert!(record.add(package.export(&["A"]), false).is_empty(), "only A was asked for");
        package.write("target/fmu/C.fmu", "of another vendor");
        let gone = record.add(package.export(&["A"]), true);
        assert_eq!(gone, [(package.path("target/fmu/B.fmu"), "own".to_owned())]);
        assert!(record.add(package.export(&["A"]), true).is_empty(), "the reason is reported once");
    }

    #[test]
    fn sources_are_read_from_the_file_beside_the_library() {
        let folder = tempfile::tempdir().unwrap();
        let text = "/target/libown.so: /own/src/lib.rs /own/a\\ b.rs\n";
        fs::write(folder.path().join("libown.d"), text).unwrap();
        let expected = ["/own/src/lib.rs", "/own/a b.rs"].map(PathBuf::from);
        assert_eq!(sources(&folder.path().join("libown.so")), expected);
        assert!(sources(&folder.path().join("libother.so")).is_empty());
    }

    #[test]
    fn a_missing_fmu_of_a_package_is_exported_by_a_command() {
        let package = Package::new();
        let command = export_command(&package.path("target/fmu/A_fmi3.fmu")).unwrap();
        assert!(command.ends_with("&& cargo fmu export --fmi 3.0"), "{command}");
        assert_eq!(export_command(&package.path("other/A.fmu")), None);
    }
}
