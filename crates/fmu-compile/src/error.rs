//! Why an FMU cannot be compiled.

use std::error::Error;
use std::fmt::{self, Display, Formatter};

use fmu_file::text::quote;

/// Why an FMU cannot be compiled. The texts do not name the FMU.
#[derive(Debug)]
pub enum CompileError {
    /// The FMU or the folder cannot be read or written.
    Unusable(anyhow::Error),
    /// The FMU has no sources.
    NoSources,
    /// The build description, or the list of source files of FMI 2.0, is missing or invalid.
    Description(String),
    /// No build configuration is for this platform.
    Platform {
        /// The name of this platform in FMI 3.0.
        here: &'static str,
        /// The platforms that have one.
        described: Vec<String>,
    },
    /// The sources are in a language that is not compiled: the language or a file of it, with its name.
    Language(String),
    /// A file that the description names is not in the FMU.
    MissingFile {
        /// What it is, such as `source file`.
        kind: &'static str,
        /// Its path in the FMU.
        path: String,
    },
    /// There is no compiler on this machine.
    MissingCompiler {
        /// Whether a compiler for C++ is needed.
        is_cpp: bool,
        /// The program that was looked for.
        program: String,
    },
    /// The compiler reports an error.
    Failed {
        /// The source file that it compiled, or the binary that it linked.
        file: String,
        /// How it was called, with paths relative to the FMU.
        command: String,
        /// What it printed, at most [`MESSAGE_LINES`] lines.
        message: String,
    },
    /// The compiled library does not export a function that loads the FMU.
    MissingFunction {
        /// The path of the library in the FMU.
        binary: String,
        /// The name of the function.
        name: &'static str,
        /// A function that is exported under a name with a prefix instead.
        found: Option<String>,
    },
    /// The compiler did not end within the time limit (s).
    TimedOut(u64),
    /// The caller has cancelled it.
    Cancelled,
}

/// How many lines of the compiler's output an error has.
pub const MESSAGE_LINES: usize = 20;

impl Display for CompileError {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unusable(error) => write!(f, "{error:#}"),
            Self::NoSources => f.write_str("it has no sources to compile"),
            Self::Description(text) => f.write_str(text),
            Self::Platform { here, described } => write!(
                f,
                "sources/buildDescription.xml has no BuildConfiguration for {here}, only for {}",
                described.join(", ")
            ),
            Self::Language(name) => {
                write!(f, "its sources have {name}, expected C or C++, such as C99 or C++11")
            }
            Self::MissingFile { kind, path } => {
                write!(f, "the {kind} {} is missing", quote(path))
            }
            Self::MissingCompiler { is_cpp, program } => {
                let (language, debian, fedora) = match is_cpp {
                    false => ("C", "gcc libc6-dev", "gcc"),
                    true => ("C++", "g++", "gcc-c++"),
                };
                write!(
                    f,
                    "there is no {language} compiler on this machine ({program}); install one:
  apt-get install {debian}    # Debian, Ubuntu
  dnf install {fedora}    # Fedora
  xcode-select --install    # macOS
  winget install Microsoft.VisualStudio.2022.BuildTools    # Windows, with the workload for C++"
                )
            }
            Self::Failed { file, command, message } => {
                let verb = if file.starts_with("binaries/") { "linked" } else { "compiled" };
                write!(f, "{file} cannot be {verb}: {command}")?;
                message.lines().try_for_each(|line| write!(f, "\n  {line}"))
            }
            Self::MissingFunction { binary, name, found: None } => {
                write!(f, "its sources do not define {name}, which {binary} must export")
            }
            Self::MissingFunction { binary, name, found: Some(found) } => write!(
                f,
                "its sources define {found} instead of {name}, which {binary} must export: they do \
                 not use the prefix of the standard's headers"
            ),
            Self::TimedOut(seconds) => {
                write!(f, "the compiler did not end within {seconds} s")
            }
            Self::Cancelled => f.write_str("interrupted"),
        }
    }
}

impl Error for CompileError {}

impl From<anyhow::Error> for CompileError {
    fn from(error: anyhow::Error) -> Self {
        Self::Unusable(error)
    }
}

/// A description that is invalid.
pub(crate) fn invalid<T>(text: impl Into<String>) -> Result<T, CompileError> {
    Err(CompileError::Description(text.into()))
}
