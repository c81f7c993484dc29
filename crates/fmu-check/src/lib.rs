//! Checks FMUs from any vendor as an importer would: the archive, the model description against the
//! schema and the rules of the standard, and the binaries by running them.
//!
//! A binary may crash, hang or exit, so each test of it runs in a child process: [`Probes`] defines the
//! program to start, which passes its arguments to [`probe`].
#![forbid(unsafe_code)]

mod binary;
mod bus;
mod compiled;
mod finding;
pub mod format;
mod package;
mod references;
mod rule;
mod rules;
mod schema;
mod sources;

use std::path::Path;
use std::time::Instant;

pub use binary::{Probes, probe};
pub use finding::{Finding, Findings, Group, Location};
use fmu_compile::CompileControl;
use fmu_description::xml;
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
pub use references::{Perform, ReferenceRun};
use rule::rule;
pub use rule::{RULES, Rule, Severity};

/// What to check of an FMU besides its files.
pub struct Scope<'a> {
    /// How the binaries are run; `None` if they are not.
    pub probes: Option<&'a Probes>,
    /// How experiments are performed that have reference results; `None` if they are not.
    pub perform: Option<&'a Perform<'a>>,
    /// How the sources are compiled; `None` if they are not. They are run if the binaries are.
    pub compile: Option<CompileControl<'a>>,
    /// What cannot be checked until then is a finding. The time of the compiler is added.
    pub deadline: Instant,
}

/// Checks an FMU and adds what it finds.
pub fn check(file: &Path, scope: &Scope<'_>, findings: &mut Findings) {
    let mut archive = match Archive::open(file) {
        Ok(archive) => archive,
        Err(error) => {
            let rule = if file.is_file() { rule!("archive-readable") } else { rule!("file") };
            return findings.add(rule, "archive", format!("{error:#}"));
        }
    };
    let decoded = match archive.model_description_bytes() {
        Ok(bytes) => xml::decode(&bytes),
        Err(error) => {
            package::check(&mut archive, findings);
            return findings.add(rule!("archive-readable"), "archive", format!("{error:#}"));
        }
    };
    let parsed = xml::parse(&decoded.text);
    let version =
        parsed.as_ref().ok().and_then(|root| FmiVersion::named(root.attribute("fmiVersion")));
    let version = version.unwrap_or_default();
    findings.set_version(version);
    package::check(&mut archive, findings);
    let root = match parsed {
        Ok(root) => root,
        Err(error) => {
            return findings.add(
                rule!("archive-readable"),
                MODEL_DESCRIPTION,
                format!("{error:#}"),
            );
        }
    };
    if let Some(text) = ModelDescription::other_version(&root) {
        // The rules of another version are different.
        return findings.add(rule!("fmi-version"), &root, text);
    }
    for fault in decoded.faults {
        findings.add(rule!("utf-8"), MODEL_DESCRIPTION, fault);
    }
    let schema = match version {
        FmiVersion::Fmi2 => &schema::MODEL_2,
        FmiVersion::Fmi3 => &schema::MODEL_3,
    };
    let part = |name: &str, findings: &mut Findings, check: &mut dyn FnMut(&mut Findings)| {
        if Instant::now() < scope.deadline {
            return check(findings);
        }
        findings.add(rule!("not-tested"), "archive", format!("there was no time for {name}"));
    };
    let model = ModelDescription::new(&root);
    part("the schema", findings, &mut |findings| {
        schema::check(MODEL_DESCRIPTION, &root, schema, findings);
    });
    part("the rules of the model description", findings, &mut |findings| {
        rules::check(&model, findings);
    });
    part("the files", findings, &mut |findings| {
        package::check_files(&model, &mut archive, findings);
    });
    if !archive.faults.is_empty() {
        return;
    }
    part("the reference results", findings, &mut |findings| {
        references::check(&model, &mut archive, scope, findings);
    });
    let (begin, mut compiled) = (Instant::now(), None);
    if let Some(control) = &scope.compile {
        part("the compiler", findings, &mut |findings| {
            compiled = compiled::compile(file, control, findings);
        });
    }
    let deadline = scope.deadline + begin.elapsed();
    // The test processes read the same model.
    if let (Some(probes), Ok(model)) = (scope.probes, ModelDescription::read(&root)) {
        part("the binaries", findings, &mut |findings| {
            let compiled = compiled.as_mut().map(|compiled| &mut compiled.archive);
            let text = &decoded.text;
            binary::check(text, &model, &mut archive, compiled, probes, deadline, findings);
        });
    }
}
