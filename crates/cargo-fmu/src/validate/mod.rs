//! `cargo fmu validate`: the checks that an importer would make of an FMU of any maker.

mod binary;
mod finding;
mod package;
mod rules;
mod schema;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use clap::Args;

pub use binary::probe;
use finding::Findings;
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::model::Model;
use fmu_file::xml;

/// What to check.
#[derive(Args)]
pub struct Options {
    /// The FMUs, of any maker
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// Only read the FMUs, and do not run their binaries
    #[arg(long)]
    no_run: bool,
    /// How long each test of a binary may take
    #[arg(long, value_name = "SECONDS", default_value_t = 20)]
    time_limit: u64,
}

/// Checks the files, writes what it finds, and tells whether all are free of errors.
///
/// # Errors
/// `out` cannot be written.
pub fn validate(options: &Options, out: &mut impl Write) -> Result<bool> {
    let limit = Duration::from_secs(options.time_limit);
    let mut sound = true;
    for file in &options.files {
        let mut findings = Findings::default();
        check(file, (!options.no_run).then_some(limit), &mut findings);
        report(file, &findings, out)?;
        sound &= findings.errors() == 0;
    }
    Ok(sound)
}

fn report(file: &Path, findings: &Findings, out: &mut impl Write) -> Result<()> {
    let file = file.display();
    for finding in findings.kept() {
        writeln!(out, "{file}: {finding}")?;
    }
    if findings.left_out() > 0 {
        writeln!(out, "{file}: and {} findings more", findings.left_out())?;
    }
    let count = |number: usize, what: &str| match number {
        0 => format!("no {what}"),
        1 => format!("1 {what}"),
        _ => format!("{number} {what}s"),
    };
    writeln!(
        out,
        "{file}: {}, {}",
        count(findings.errors(), "error"),
        count(findings.warnings(), "warning")
    )?;
    Ok(())
}

/// Makes all checks of a file; those of running its binaries only with a time limit for each.
fn check(file: &Path, run: Option<Duration>, findings: &mut Findings) {
    let mut archive = match Archive::open(file) {
        Ok(archive) => archive,
        Err(error) => return findings.error("archive", format!("{error:#}")),
    };
    package::check(&mut archive, findings);
    let text = match archive.model_description() {
        Ok(text) => text,
        Err(error) => return findings.error("archive", format!("{error:#}")),
    };
    let root = match xml::parse(&text) {
        Ok(root) => root,
        Err(error) => return findings.error(MODEL_DESCRIPTION, format!("{error:#}")),
    };
    schema::check(&root, findings);
    let model = Model::new(&root);
    rules::check(&model, findings);
    package::check_binaries(&model, &mut archive, findings);
    if let Some(limit) = run
        && archive.faults.is_empty()
    {
        binary::check(&model, &mut archive, limit, findings);
    }
}

#[cfg(test)]
pub fn messages(file: &Path) -> Vec<String> {
    let mut findings = Findings::default();
    check(file, None, &mut findings);
    findings.kept().iter().map(ToString::to_string).collect()
}
