//! Where a package gets the crate `fmu-export` from.

use std::fmt::{self, Display, Formatter};
use std::fs;
use std::path::{self, Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result, bail};

/// The crate that models are written with.
pub const FMU_EXPORT: &str = "fmu-export";

/// The versions of `fmu-export` that are compatible with this program.
pub const VERSION: &str =
    concat!(env!("CARGO_PKG_VERSION_MAJOR"), ".", env!("CARGO_PKG_VERSION_MINOR"));

/// The source of `fmu-export`, shown as a line of a manifest.
#[derive(Debug, Clone, PartialEq)]
pub enum Dependency {
    /// A version in the registry.
    Version(String),
    /// A folder with the sources.
    Folder(PathBuf),
    /// A git repository.
    Git(String),
}

/// The checkout that this program was built in, else the registry.
impl Default for Dependency {
    fn default() -> Self {
        // A package of the registry has no such neighbour.
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name(FMU_EXPORT);
        match folder.join("Cargo.toml").is_file() {
            true => Self::Folder(folder),
            false => Self::Version(VERSION.into()),
        }
    }
}

impl FromStr for Dependency {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        const EXPECTED: &str = "expected a version such as 0.1, a folder with fmu-export, or the URL of a git repository";
        if text.contains("://") || text.starts_with("git@") {
            return Ok(Self::Git(text.into()));
        }
        let folder = path::absolute(text).context(EXPECTED)?;
        for folder in [folder.join("crates").join(FMU_EXPORT), folder] {
            let manifest = fs::read_to_string(folder.join("Cargo.toml")).unwrap_or_default();
            if manifest.contains("name = \"fmu-export\"") {
                return Ok(Self::Folder(folder));
            }
        }
        if text.starts_with(|c: char| c.is_ascii_digit() || "^~=<>*".contains(c)) {
            return Ok(Self::Version(text.into()));
        }
        bail!(EXPECTED)
    }
}

impl Dependency {
    /// The command of a workflow that installs this program where the dependency comes from; for a folder, which
    /// no workflow has, it fails and says what to fill in.
    pub fn install(&self) -> String {
        match self {
            Self::Git(url) => format!("cargo install --locked --git {url} cargo-fmu"),
            // The wheel has the command line, too.
            Self::Version(_) => format!("pip install \"fmu-master=={VERSION}.*\""),
            Self::Folder(_) => {
                "echo '::error::fmu-export comes from a folder that this runner lacks. \
                Write git = URL instead of path = FOLDER in Cargo.toml, and here \
                cargo install --locked --git URL cargo-fmu'; exit 1"
                    .into()
            }
        }
    }

    /// What users should know of a dependency that others may not find.
    pub fn caution(&self) -> Option<&'static str> {
        match self {
            Self::Version(_) => Some(
                "fmu-export comes from crates.io. If it is not published there yet, use --fmu-export with the \
                 folder of its sources or the URL of their git repository.",
            ),
            Self::Folder(_) => Some(
                "fmu-export comes from a folder of this machine. The workflow in .github fails until Cargo.toml and the \
                 workflow name a source that GitHub can read, too: use --fmu-export with the URL of a git \
                 repository.",
            ),
            Self::Git(_) => None,
        }
    }
}

impl Display for Dependency {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{FMU_EXPORT} = ")?;
        match self {
            Self::Version(version) => f.write_str(&quoted(version)),
            Self::Folder(path) => write!(f, "{{ path = {} }}", quoted(&path.to_string_lossy())),
            Self::Git(url) => write!(f, "{{ git = {} }}", quoted(url)),
        }
    }
}

/// A string of TOML.
pub fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_recognized() {
        let shown = |text: &str| text.parse::<Dependency>().map(|d| d.to_string()).ok();
        let folder = Dependency::default().to_string();
        assert!(folder.contains(" = { path = "), "{folder}");
        for (text, line) in [
            ("0.1", Some("fmu-export = \"0.1\"")),
            (">=0.1, <0.3", Some("fmu-export = \">=0.1, <0.3\"")),
            ("https://a/b.git", Some("fmu-export = { git = \"https://a/b.git\" }")),
            (concat!(env!("CARGO_MANIFEST_DIR"), "/../fmu-build"), None),
            ("nowhere", None),
            ("", None),
        ] {
            assert_eq!(shown(text).as_deref(), line, "{text}");
        }
        let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap();
        assert_eq!(shown(checkout.to_str().unwrap()), Some(folder));
        let version = format!("pip install \"fmu-master=={VERSION}.*\"");
        let git = "cargo install --locked --git https://a/b.git cargo-fmu";
        for (text, expected) in [("0.1", version.as_str()), ("https://a/b.git", git)] {
            assert_eq!(text.parse::<Dependency>().unwrap().install(), expected);
        }
        let folder = Dependency::default().install();
        assert!(
            folder.ends_with("--git URL cargo-fmu'; exit 1") && !folder.contains(": "),
            "{folder}"
        );
        assert_eq!(quoted(r#"C:\a "b""#), r#""C:\\a \"b\"""#);
    }
}
