//! Runs cargo.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;

use anyhow::{Context, Result, bail};
use cargo_metadata::{Artifact, CrateType, Message, Metadata};

const ENCODED_RUSTFLAGS: &str = "CARGO_ENCODED_RUSTFLAGS";
const SEPARATOR: &str = "\x1f";
/// The profile by default.
pub const RELEASE: &str = "release";

/// An FMU binary is small and fast, without the symbols of Rust. What a host calls at every step is
/// compiled with the model; the rest of its libraries is optimized for size. The values are for each [`Product`]: in a
/// component, a call costs more than inlining saves; C sources keep the names of functions, and the C compiler inlines
/// what pays.
const DEFAULTS: [(&str, [&str; 3]); 6] = [
    ("lto", ["'fat'"; 3]),
    ("codegen-units", ["1"; 3]),
    ("strip", ["'symbols'", "'symbols'", "'debuginfo'"]),
    ("opt-level", ["3", "'s'", "'s'"]),
    ("package.fmu-export.opt-level", ["'s'", "'z'", "'z'"]),
    ("package.fmu-description.opt-level", ["'s'", "'z'", "'z'"]),
];

/// Arguments of cargo's option `--config` for a release of each [`Product`]: what the workspace does not set itself.
///
/// # Errors
/// The manifest of the workspace cannot be read.
pub fn profile_settings(profile: &str, metadata: &Metadata) -> Result<[Vec<String>; 3]> {
    if profile != RELEASE {
        return Ok(Default::default());
    }
    let manifest = metadata.workspace_root.join("Cargo.toml");
    let cannot = || format!("cannot read {manifest}");
    let text = fs::read_to_string(&manifest).with_context(cannot)?;
    let table: toml::Table = text.parse().with_context(cannot)?;
    let profiles = table.get("profile");
    let own = profiles.and_then(|profiles| profiles.get(RELEASE));
    let is_set = |key: &str| own.and_then(|own| key.split('.').try_fold(own, toml::Value::get));
    let missing = DEFAULTS.into_iter().filter(|(key, _)| is_set(key).is_none());
    let settings = |i: usize| {
        let setting = |(key, values): (_, [_; 3])| format!("profile.{RELEASE}.{key}={}", values[i]);
        missing.clone().map(setting).collect()
    };
    Ok([0, 1, 2].map(settings))
}

/// What is made of a library.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Product {
    /// A shared library.
    Library,
    /// A WebAssembly component.
    Component,
    /// C sources.
    Sources,
}

/// What happens during an export, as text.
#[derive(Debug, Clone, Copy)]
pub enum BuildProgress<'a> {
    /// A library is being built.
    Building(&'a str),
    /// A crate that the library needs was built.
    Built(&'a str),
    /// Something that users should read, such as a warning of the compiler.
    Said(&'a str),
}

/// A cargo command that builds a library.
pub struct Build {
    title: String,
    command: Command,
    rustflags: Vec<String>,
}

impl Build {
    /// `cargo SUBCOMMAND` with cargo or a program that replaces it, shown to the user as `title`.
    pub fn new(program: impl AsRef<OsStr>, title: &str, subcommand: &str) -> Self {
        let mut build = Self::with_default_flags(program, title, subcommand);
        let command = &mut build.command;
        // Libraries of both versions of FMI have the same name. In its folder `deps`, cargo would take one
        // for the other, unless this variable makes it add a hash to the name.
        command.env("__CARGO_DEFAULT_LIB_METADATA", "fmu");
        build
    }

    /// `cargo rustc` with the flags of `cargo build`, but that a panic does not end the host.
    pub fn for_trial(program: impl AsRef<OsStr>, title: &str, profile: &str) -> Self {
        let mut build = Self::with_default_flags(program, title, "rustc");
        build.args(["--config", &format!("profile.{profile}.panic='unwind'")]);
        build
    }

    fn with_default_flags(program: impl AsRef<OsStr>, title: &str, subcommand: &str) -> Self {
        let mut command = Command::new(program);
        // Quiet, so that only diagnostics reach its standard error.
        command.args([subcommand, "--quiet", "--message-format=json-render-diagnostics"]);
        // A target that is named, even this machine, gives other bytes in another folder.
        command.env_remove("CARGO_BUILD_TARGET");
        Self { title: title.into(), command, rustflags: inherited_rustflags() }
    }

    /// Adds arguments.
    pub fn args(&mut self, args: impl IntoIterator<Item = impl AsRef<OsStr>>) -> &mut Self {
        self.command.args(args);
        self
    }

    /// Sets an environment variable.
    pub fn env(&mut self, name: &str, value: impl AsRef<OsStr>) -> &mut Self {
        self.command.env(name, value);
        self
    }

    /// Leaves out a variable that the environment happens to have.
    pub fn without_env(&mut self, name: &str) -> &mut Self {
        self.command.env_remove(name);
        self
    }

    /// Adds flags for the compiler, for every package.
    pub fn rustflags(&mut self, flags: impl IntoIterator<Item = String>) -> &mut Self {
        self.rustflags.extend(flags);
        self.env(ENCODED_RUSTFLAGS, self.rustflags.join(SEPARATOR))
    }

    /// Keeps local paths out of the locations of panics, for all packages outside of the workspace: in it,
    /// cargo passes relative paths. So the flags are the same for all workspaces that share a target folder,
    /// and dependencies are built once. The last folder that matches counts.
    pub fn without_local_paths(&mut self, metadata: &Metadata, std: Option<&Path>) -> &mut Self {
        let root = &metadata.workspace_root;
        let folders: BTreeSet<_> = metadata
            .packages
            .iter()
            .filter(|package| package.source.is_some() || !package.manifest_path.starts_with(root))
            .filter_map(|package| package.manifest_path.parent()?.parent())
            .map(|folder| (folder.as_std_path(), "crates"))
            .collect();
        let generated = (metadata.target_directory.as_std_path(), "target");
        let folders = folders.into_iter().chain([generated]);
        let folders = folders.chain(std.map(|folder| (folder, "rust")));
        self.rustflags(folders.map(|(path, name)| remap(path, name)))
    }

    /// Runs cargo to completion and returns the shared library of a library target.
    ///
    /// # Errors
    /// The diagnostics of cargo and the compiler if the build fails; it has no such library.
    pub fn shared_library(
        &mut self,
        target: &str,
        extension: &str,
        progress: &dyn Fn(BuildProgress<'_>),
    ) -> Result<PathBuf> {
        let mut child = self
            .command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .context("cannot run cargo; is a Rust toolchain installed?")?;
        let (stdout, stderr) = child
            .stdout
            .take()
            .zip(child.stderr.take())
            .context("cannot capture the output of cargo")?;
        // Read on another thread, as a full pipe would block cargo.
        let diagnostics = thread::spawn(move || {
            let mut text = String::new();
            let _ = BufReader::new(stderr).read_to_string(&mut text);
            text
        });
        progress(BuildProgress::Building(&self.title));
        let mut artifacts = Vec::new();
        for message in Message::parse_stream(BufReader::new(stdout)) {
            if let Message::CompilerArtifact(artifact) =
                message.context("cannot read the output of cargo")?
            {
                if !artifact.fresh {
                    let built = format!("{}: {}", self.title, artifact.target.name);
                    progress(BuildProgress::Built(&built));
                }
                artifacts.push(artifact);
            }
        }
        let status = child.wait()?;
        let diagnostics = diagnostics.join().unwrap_or_default();
        if !status.success() {
            bail!("{} failed:\n{}", self.title, diagnostics.trim_end());
        }
        if !diagnostics.trim().is_empty() {
            progress(BuildProgress::Said(diagnostics.trim_end()));
        }
        let is_library = |artifact: &&Artifact| {
            let built = &artifact.target;
            built.name == target && built.crate_types.contains(&CrateType::CDyLib)
        };
        let mut files = artifacts.iter().filter(is_library).flat_map(|a| &a.filenames);
        let file = files.find(|file| file.extension() == Some(extension));
        let file =
            file.with_context(|| format!("{}: cargo built no shared library", self.title))?;
        Ok(file.into())
    }
}

/// The compiler flag that replaces a folder in the locations of panics.
pub fn remap(path: &Path, name: &str) -> String {
    format!("--remap-path-prefix={}={name}", path.display())
}

/// The compiler flags from the user's environment. Cargo ignores those of its configuration, since the build sets flags
/// in the environment.
fn inherited_rustflags() -> Vec<String> {
    match std::env::var(ENCODED_RUSTFLAGS) {
        Ok(flags) if !flags.is_empty() => flags.split(SEPARATOR).map(str::to_owned).collect(),
        _ => std::env::var("RUSTFLAGS")
            .unwrap_or_default()
            .split_whitespace()
            .map(str::to_owned)
            .collect(),
    }
}

/// A warning of compiler flags in the environment that change the FMUs.
pub fn warning() -> Option<String> {
    warning_of(&inherited_rustflags())
}

fn warning_of(flags: &[String]) -> Option<String> {
    let mut changing = Vec::new();
    let mut flags = flags.iter().map(String::as_str);
    while let Some(flag) = flags.next() {
        // Lints, which change nothing, have a name that may follow.
        match flag {
            "-A" | "-W" | "-D" | "-F" | "--allow" | "--warn" | "--deny" | "--forbid"
            | "--cap-lints" => {
                flags.next();
            }
            flag if ["-A", "-W", "-D", "-F", "--cap-lints="]
                .iter()
                .any(|l| flag.starts_with(l)) => {}
            flag => changing.push(flag),
        }
    }
    let changing = changing.join(" ");
    let is_for_processor = ["target-cpu", "target-feature"].iter().any(|f| changing.contains(f));
    let consequence = match (changing.as_str(), is_for_processor) {
        ("", _) => return None,
        (_, true) => "other bytes, and may need a processor like this one",
        (_, false) => "other bytes",
    };
    Some(format!("warning: with {changing} in RUSTFLAGS, the FMUs have {consequence}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_that_change_the_fmus_are_warned_of() {
        for (flags, expected) in [
            ("", None),
            ("-D warnings -Wunused --cap-lints allow", None),
            ("-D warnings -g", Some("with -g in RUSTFLAGS, the FMUs have other bytes")),
            (
                "-C target-cpu=native",
                Some(
                    "with -C target-cpu=native in RUSTFLAGS, the FMUs have other bytes, and may need a processor like this one",
                ),
            ),
        ] {
            let flags = Vec::from_iter(flags.split_whitespace().map(str::to_owned));
            let expected = expected.map(|text| format!("warning: {text}"));
            assert_eq!(warning_of(&flags), expected);
        }
    }
}
