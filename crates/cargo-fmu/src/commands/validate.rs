//! `cargo fmu validate`: checks FMUs as an importer would.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use fmu_check::{Findings, Probes, Severity};

use super::probe;
use crate::style::{ERROR, OK, WARNING};

/// The FMUs to check, and how.
#[derive(Debug, Args)]
pub struct ValidateArgs {
    /// The FMUs, from any vendor
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// Do not run the binaries
    #[arg(long)]
    no_run: bool,
    /// Time limit for each test of a binary
    #[arg(long, value_name = "SECONDS", default_value_t = 20)]
    time_limit: u64,
}

/// Checks the files and prints the findings; returns whether there are no errors.
///
/// # Errors
/// `out` cannot be written.
pub fn run(args: &ValidateArgs, out: &mut impl Write) -> Result<bool> {
    let probes = match args.no_run {
        true => None,
        false => Some(Probes {
            program: std::env::current_exe()?,
            arguments: vec![probe::NAME.into()],
            time_limit: Duration::from_secs(args.time_limit),
        }),
    };
    let mut is_valid = true;
    for file in &args.files {
        let findings = fmu_check::check(file, probes.as_ref());
        print(file, &findings, out)?;
        is_valid &= findings.errors() == 0;
    }
    Ok(is_valid)
}

fn print(file: &Path, findings: &Findings, out: &mut impl Write) -> Result<()> {
    let file = file.display();
    for finding in findings.kept() {
        let style = match finding.severity {
            Severity::Error => ERROR,
            Severity::Warning => WARNING,
        };
        let (severity, location) = (finding.severity, &finding.location);
        writeln!(
            out,
            "{file}: {style}{severity}{style:#}: {location}: {}",
            finding.text
        )?;
    }
    if findings.left_out() > 0 {
        writeln!(out, "{file}: and {} more findings", findings.left_out())?;
    }
    let count = |number: usize, what: &str| match number {
        0 => format!("no {what}"),
        1 => format!("1 {what}"),
        _ => format!("{number} {what}s"),
    };
    let errors = count(findings.errors(), "error");
    let warnings = count(findings.warnings(), "warning");
    let style = match (findings.errors(), findings.warnings()) {
        (0, 0) => OK,
        (0, _) => WARNING,
        _ => ERROR,
    };
    writeln!(out, "{file}: {style}{errors}, {warnings}{style:#}")?;
    Ok(())
}
