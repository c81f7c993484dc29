//! `cargo fmu validate`: checks FMUs as an importer would.

mod references;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::{Args, ValueEnum};
use fmu_check::{Findings, Probes, ReferenceRun, Scope, Severity, format};
use fmu_compile::CompileControl;

use super::files;
use super::stale;
use crate::session::{self, Session};
use crate::ui::{self, ERROR, OK, WARNING};

/// The FMUs to check, and how.
#[derive(Debug, Args)]
pub struct ValidateArgs {
    /// The FMUs, from any vendor
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// Show all findings instead of the first few of each kind
    #[arg(long)]
    all: bool,
    /// Run only a few tests of the binaries, for a few steps and with inputs at their start values
    #[arg(long)]
    quick: bool,
    /// Format of the findings
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Compile the sources, too, with the system's compiler, and run them: if there is no binary for this machine,
    /// in all tests; otherwise to compare their results with those of the binary
    #[arg(long, conflicts_with = "sandbox")]
    compile: bool,
    /// Do not run the binaries
    #[arg(long)]
    no_run: bool,
    /// Refuse native binaries; run WebAssembly components only
    #[arg(long)]
    sandbox: bool,
    /// Time limit for each call of a binary
    #[arg(long, value_name = "SECONDS", default_value_t = 20)]
    time_limit: u32,
    /// Time limit for each FMU; what is not tested by then is a warning
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    total_time: u32,
}

/// Format of the findings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Lines of text
    Text,
    /// A JSON document
    Json,
    /// SARIF 2.1.0, for code scanning
    Sarif,
}

/// Checks the files and prints the findings; returns whether there are no errors.
///
/// # Errors
/// No file matches a pattern, or `out` cannot be written.
pub fn run(args: &ValidateArgs, session: &Session, out: &mut impl Write) -> Result<bool> {
    let probes = match args.no_run {
        true => None,
        false => {
            let mut words = session::program()?;
            words.extend(session::VALIDATOR.map(Into::into));
            Some(Probes {
                program: words.remove(0).into(),
                arguments: words,
                time_limit: Duration::from_secs(args.time_limit.into()),
                is_quick: args.quick,
                sandbox: args.sandbox,
            })
        }
    };
    let files = files::expanded(&args.files)?;
    stale::warn(&files);
    let (mut is_valid, mut checked) = (true, Vec::new());
    for file in &files {
        let mut findings = Findings::keeping(if args.all { Findings::ALL } else { Findings::FEW });
        let time_limit = Duration::from_secs(args.total_time.into());
        let is_cancelled = &|| session.signal().is_some();
        let control = CompileControl { time_limit, is_cancelled, ..CompileControl::default() };
        let call = Duration::from_secs(args.time_limit.into());
        let perform = |run: &ReferenceRun<'_>| {
            references::perform(file, run, (call, time_limit), args.sandbox, session)
        };
        let scope = Scope {
            perform: probes.is_some().then_some(&perform),
            probes: probes.as_ref(),
            compile: args.compile.then_some(control),
            deadline: Instant::now() + time_limit,
        };
        fmu_check::check(file, &scope, &mut findings);
        is_valid &= findings.errors() == 0;
        match args.format {
            Format::Text => print(file, &findings, out)?,
            Format::Json | Format::Sarif => checked.push((file.clone(), findings)),
        }
    }
    match args.format {
        Format::Text => {}
        Format::Json => writeln!(out, "{:#}", format::json(&checked))?,
        Format::Sarif => writeln!(out, "{:#}", format::sarif(&checked))?,
    }
    Ok(is_valid)
}

fn print(file: &Path, findings: &Findings, out: &mut impl Write) -> Result<()> {
    let file = file.display();
    for group in findings.groups() {
        let (severity, source) = (group.rule.severity, group.source);
        let style = match severity {
            Severity::Error => ERROR,
            Severity::Warning => WARNING,
        };
        for finding in &group.kept {
            let (location, text) = (&finding.location, &finding.text);
            let line = format!("{file}: {style}{severity}{style:#}: {location}: {text} ({source})");
            writeln!(out, "{}", ui::wrapped(&line))?;
        }
        if group.left_out() > 0 {
            let (number, id) = (group.left_out(), group.rule.id);
            writeln!(out, "{file}: and {number} more of this kind: {id}")?;
        }
    }
    for hint in findings.hints() {
        writeln!(out, "{}", ui::wrapped(&format!("{file}: hint: {hint}")))?;
    }
    let count = |number: usize, what: &str| match number {
        0 => format!("no {what}"),
        _ => ui::count(number, what),
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
