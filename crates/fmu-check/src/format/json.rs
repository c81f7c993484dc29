//! The findings as JSON.

use std::path::PathBuf;

use fmu_description::FmiVersion;
use serde_json::{Value, json};

use super::TOOL;
use crate::{Finding, Findings, Group};

/// The findings on some FMUs as a JSON document, which `docs/validate.md` describes.
pub fn json(files: &[(PathBuf, Findings)]) -> Value {
    let files: Vec<Value> = files
        .iter()
        .map(|(file, findings)| {
            json!({
                "file": file.to_string_lossy(),
                "errors": findings.errors(),
                "warnings": findings.warnings(),
                "rules": findings.groups().iter().map(|group| json_of(group, findings.version())).collect::<Vec<_>>(),
            })
        })
        .collect();
    json!({
        "tool": TOOL,
        "version": env!("CARGO_PKG_VERSION"),
        "files": files,
    })
}

fn json_of(group: &Group, version: FmiVersion) -> Value {
    let rule = group.rule;
    json!({
        "id": rule.id,
        "severity": rule.severity.to_string(),
        "text": rule.text,
        "source": rule.source.of(version).to_string(),
        "count": group.count,
        "findings": group.kept.iter().map(finding).collect::<Vec<_>>(),
    })
}

fn finding(finding: &Finding) -> Value {
    let location = &finding.location;
    json!({
        "file": location.file,
        "line": location.line,
        "variable": location.variable,
        "text": finding.text,
    })
}
