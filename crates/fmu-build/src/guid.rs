//! What the GUID of an FMU follows from: its interface, and on demand the version or the code of its package.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};
use cargo_metadata::{DependencyKind, Metadata, Package, PackageId};
use clap::ValueEnum;
use fmu_description::hash::Hash;

/// What the GUID follows from besides the interface of the model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum GuidBasis {
    /// Nothing else
    #[default]
    Interface,
    /// The version of the package
    Version,
    /// The files of the package and its local dependencies, and the versions of the others
    Code,
}

/// Folders of a package that do not belong to its library.
const OTHERS: [&str; 4] = ["benches", "examples", "target", "tests"];

impl GuidBasis {
    /// The text that `export!` adds to the identity of the models of a package, if it adds any: the same on every machine.
    ///
    /// # Errors
    /// A file of the package cannot be read.
    pub(crate) fn revision(self, package: &str, metadata: &Metadata) -> Result<Option<String>> {
        let members = metadata.workspace_packages();
        let package = members.into_iter().find(|member| *member.name == *package);
        match (self, package) {
            (Self::Version, Some(package)) => Ok(Some(package.version.to_string())),
            (Self::Code, Some(package)) => Ok(Some(format!("{:032x}", code(package, metadata)?))),
            _ => Ok(None),
        }
    }
}

/// A hash of all that a library is built from.
fn code(package: &Package, metadata: &Metadata) -> Result<u128> {
    let mut parts = BTreeMap::new();
    for id in dependencies(&package.id, metadata) {
        let package = &metadata[id];
        let name = format!("{} {}", package.name, package.version);
        match (&package.source, package.manifest_path.parent()) {
            (None, Some(folder)) => {
                let mut files = BTreeMap::new();
                read(folder.as_std_path(), "", &mut files)
                    .with_context(|| format!("the code of {name} cannot be read"))?;
                parts
                    .extend(files.into_iter().map(|(file, hash)| (format!("{name}/{file}"), hash)));
            }
            (source, _) => {
                let source = source.as_ref().map(ToString::to_string).unwrap_or_default();
                parts.insert(name, Hash::new().bytes(source.as_bytes()).0);
            }
        }
    }
    let add = |hash: Hash, (name, content): (&String, &u128)| {
        hash.bytes(name.as_bytes()).bytes(&[0]).bytes(&content.to_le_bytes())
    };
    Ok(parts.iter().fold(Hash::new(), add).0)
}

/// A package, and all packages on which it depends, except in its tests.
fn dependencies<'a>(package: &'a PackageId, metadata: &'a Metadata) -> BTreeSet<&'a PackageId> {
    let nodes = metadata.resolve.iter().flat_map(|resolve| &resolve.nodes);
    let nodes: BTreeMap<_, _> = nodes.map(|node| (&node.id, node)).collect();
    let (mut found, mut next) = (BTreeSet::new(), vec![package]);
    while let Some(id) = next.pop() {
        if found.insert(id) {
            let of_node = nodes.get(id).into_iter().flat_map(|node| &node.deps);
            let is_built = |kinds: &[cargo_metadata::DepKindInfo]| {
                kinds.is_empty() || kinds.iter().any(|k| k.kind != DependencyKind::Development)
            };
            next.extend(of_node.filter(|d| is_built(&d.dep_kinds)).map(|d| &d.pkg));
        }
    }
    found
}

/// Adds the hashes of the files in a folder by their paths, in which `prefix` comes first, without hidden ones and those
/// of other packages. Line endings do not count, which depend on the checkout.
fn read(folder: &Path, prefix: &str, files: &mut BTreeMap<String, u128>) -> Result<()> {
    let cannot = || format!("cannot read {}", folder.display());
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let entry = entry.with_context(cannot)?;
        let (path, name) = (entry.path(), entry.file_name());
        let Some(name) = name.to_str() else { bail!("{} is not UTF-8", path.display()) };
        let is_folder = entry.file_type().with_context(cannot)?.is_dir();
        let is_other = name.starts_with('.')
            || prefix.is_empty() && OTHERS.contains(&name)
            // Another package, or a link, which may lead back.
            || is_folder && path.join("Cargo.toml").exists()
            || !is_folder && path.is_dir();
        if is_other {
            continue;
        }
        if is_folder {
            read(&path, &format!("{prefix}{name}/"), files)?;
        } else {
            let content =
                fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
            let lines = content.split(|byte| *byte == b'\n');
            let lines = lines.map(|line| line.strip_suffix(b"\r").unwrap_or(line));
            let hash = lines.fold(Hash::new(), |hash, line| hash.bytes(line).bytes(b"\n"));
            files.insert(format!("{prefix}{name}"), hash.0);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_is_all_that_the_library_is_built_from() {
        let folder = tempfile::tempdir().unwrap();
        let write = |file: &str, text: &str| {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        let found = || {
            let mut files = BTreeMap::new();
            read(folder.path(), "", &mut files).unwrap();
            files
        };
        write("src/lib.rs", "a\nb\n");
        write("Cargo.toml", "");
        write("c/plant.c", "int x;");
        let files = found();
        assert_eq!(Vec::from_iter(files.keys()), ["Cargo.toml", "c/plant.c", "src/lib.rs"]);
        for other in ["tests/a.rs", "target/a", ".git/a", "own/Cargo.toml", "own/src/lib.rs"] {
            write(other, "");
            assert_eq!(found(), files, "{other}");
        }
        write("src/lib.rs", "a\r\nb\r\n");
        assert_eq!(found(), files, "line endings");
        for (file, text) in [("src/lib.rs", "a\nc\n"), ("src/tests/a.rs", ""), ("c/plant.c", "")] {
            let before = found();
            write(file, text);
            assert_ne!(found(), before, "{file}");
        }
    }
}
