//! Runs cargo with a progress bar.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use cargo_metadata::{Artifact, CrateType, Message, Metadata};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

const ENCODED_RUSTFLAGS: &str = "CARGO_ENCODED_RUSTFLAGS";
const SEPARATOR: &str = "\x1f";

/// A cargo command that builds something.
pub struct Build {
    title: String,
    command: Command,
    rustflags: Vec<String>,
}

/// The artifacts of a build.
pub struct Artifacts(Vec<Artifact>);

impl Build {
    /// `cargo SUBCOMMAND` with cargo or a program that replaces it, shown to the user as `title`.
    pub fn new(program: impl AsRef<OsStr>, title: &str, subcommand: &str) -> Self {
        let mut command = Command::new(program);
        command.args([subcommand, "--message-format=json-render-diagnostics"]);
        Self {
            title: title.into(),
            command,
            rustflags: inherited_rustflags(),
        }
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

    /// Adds flags for the compiler, for every package.
    pub fn rustflags(&mut self, flags: impl IntoIterator<Item = String>) -> &mut Self {
        self.rustflags.extend(flags);
        self.env(ENCODED_RUSTFLAGS, self.rustflags.join(SEPARATOR))
    }

    /// Keeps local paths out of the binary: removes the folders of packages, the workspace and the
    /// standard library's sources from the locations of panics. The last folder that matches counts.
    pub fn without_local_paths(&mut self, metadata: &Metadata, std: Option<&Path>) -> &mut Self {
        let folders: BTreeSet<_> = metadata
            .packages
            .iter()
            .filter_map(|package| package.manifest_path.parent()?.parent())
            .map(|folder| (folder.as_std_path(), "crates"))
            .collect();
        let workspace = (metadata.workspace_root.as_std_path(), "workspace");
        let folders = folders.into_iter().chain([workspace]);
        let folders = folders.chain(std.map(|folder| (folder, "rust")));
        self.rustflags(
            folders.map(|(path, name)| format!("--remap-path-prefix={}={name}", path.display())),
        )
    }

    /// Runs cargo to completion; `packages` is the approximate number of packages to build.
    ///
    /// # Errors
    /// The diagnostics of cargo and the compiler if the build fails.
    pub fn run(&mut self, packages: usize) -> Result<Artifacts> {
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
        let bar = progress_bar(&self.title, packages);
        let mut artifacts = Vec::new();
        for message in Message::parse_stream(BufReader::new(stdout)) {
            if let Message::CompilerArtifact(artifact) =
                message.context("cannot read the output of cargo")?
            {
                bar.set_message(artifact.target.name.clone());
                bar.inc(1);
                artifacts.push(artifact);
            }
        }
        let status = child.wait()?;
        bar.finish_and_clear();
        let diagnostics = diagnostics.join().unwrap_or_default();
        if !status.success() {
            bail!("{} failed:\n{}", self.title, diagnostics.trim_end());
        }
        Ok(Artifacts(artifacts))
    }
}

/// The compiler flags from the user's environment.
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

fn progress_bar(title: &str, packages: usize) -> ProgressBar {
    // Two builds may run at the same time.
    static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);
    let bar = BARS.add(ProgressBar::new(packages as u64).with_prefix(title.to_owned()));
    if let Ok(style) = ProgressStyle::with_template("{spinner} {prefix} [{bar:24}] {msg} {elapsed}")
    {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

impl Artifacts {
    /// The shared library of a library target.
    pub fn shared_library(&self, target: &str, extension: &str) -> Option<PathBuf> {
        self.0
            .iter()
            .filter(|artifact| {
                artifact.target.name == target
                    && artifact.target.crate_types.contains(&CrateType::CDyLib)
            })
            .flat_map(|artifact| &artifact.filenames)
            .find(|file| file.extension() == Some(extension))
            .map(Into::into)
    }
}
