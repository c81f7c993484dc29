//! Compiles the sources of an FMU, as an importer without a binary for its platform does.

use std::path::Path;

use anyhow::Result;
use fmu_compile::{CompileControl, CompileError};
use fmu_file::archive::Archive;
use tempfile::TempDir;

use crate::finding::{Findings, find};

/// The FMU with the libraries that were compiled.
pub struct CompiledFmu {
    pub archive: Archive,
    /// The folder that it is in.
    _folder: TempDir,
}

/// Compiles the sources of an FMU; `None` if it has none, or they cannot be compiled, which is a finding.
pub fn compile(
    file: &Path,
    control: &CompileControl<'_>,
    findings: &mut Findings,
) -> Option<CompiledFmu> {
    match with_libraries(file, control, findings) {
        Ok(compiled) => Some(compiled),
        Err(error) => {
            report(&error, findings);
            None
        }
    }
}

fn with_libraries(
    file: &Path,
    control: &CompileControl<'_>,
    findings: &mut Findings,
) -> Result<CompiledFmu, CompileError> {
    let folder = tempfile::Builder::new().prefix("fmu-validate-").tempdir();
    let folder = folder.map_err(anyhow::Error::from)?;
    let compiled = fmu_compile::compile(file, folder.path(), control)?;
    for note in &compiled.notes {
        findings.add_hint(note);
    }
    let path = folder.path().join("compiled.fmu");
    fmu_compile::write_with(file, &compiled.libraries, &path)?;
    Ok(CompiledFmu { archive: Archive::open(&path)?, _folder: folder })
}

/// Reports why the sources were not compiled. What depends on this machine, or on what this program compiles, is no
/// error of the FMU.
fn report(error: &CompileError, findings: &mut Findings) {
    let is_known = |rule| findings.groups().iter().any(|group| group.rule.id == rule);
    match error {
        CompileError::NoSources => {}
        CompileError::MissingFile { .. } if is_known("sources-exist") => {}
        CompileError::Unusable(_)
        | CompileError::Platform { .. }
        | CompileError::Language(_)
        | CompileError::MissingCompiler { .. }
        | CompileError::TimedOut(_)
        | CompileError::Cancelled => {
            find!(findings, "not-tested" at "sources", "they were not compiled: {error}");
        }
        CompileError::Failed { file, message, .. } => {
            let reasons = reasons(message);
            find!(findings, "sources-compile" at file.as_str(), "it does not compile: {reasons}");
        }
        _ => find!(findings, "sources-compile" at "sources", "they do not compile: {error}"),
    }
}

/// The first errors that a compiler has printed.
fn reasons(message: &str) -> String {
    const MAX_ERRORS: usize = 3;
    let is_error = |line: &&str| line.contains("error") || line.contains("undefined reference");
    let errors = Vec::from_iter(message.lines().filter(is_error).take(MAX_ERRORS));
    match errors.as_slice() {
        [] => message.lines().take(MAX_ERRORS).collect::<Vec<_>>().join("; "),
        errors => errors.join("; "),
    }
}

#[test]
fn the_errors_of_a_compiler_are_quoted() {
    let message =
        "a.c: In function 'f':\na.c:1:2: error: 'x' undeclared\n  1 | x;\na.c:2:2: error: e";
    assert_eq!(reasons(message), "a.c:1:2: error: 'x' undeclared; a.c:2:2: error: e");
    assert_eq!(reasons("cannot read a.c"), "cannot read a.c");
}
