//! Findings for other programs: as JSON, and as SARIF 2.1.0, the format of code scanning in continuous
//! integration.

use std::collections::HashMap;
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::finding::{Finding, Findings};
use crate::rule::RULES;

/// The name of the program that other programs show.
const TOOL: &str = "cargo-fmu";

/// The findings on some FMUs as a JSON document, which `docs/validate.md` describes.
pub fn json(files: &[(PathBuf, Findings)]) -> Value {
    let of = |(file, findings): &(PathBuf, Findings)| {
        let rules = findings.groups().iter().map(|group| {
            json!({
                "id": group.rule.id,
                "severity": group.rule.severity.to_string(),
                "text": group.rule.text,
                "source": group.source,
                "count": group.count,
                "findings": group.kept,
            })
        });
        json!({
            "file": file.to_string_lossy(),
            "errors": findings.errors(),
            "warnings": findings.warnings(),
            "rules": rules.collect::<Vec<_>>(),
            "hints": findings.hints(),
        })
    };
    json!({
        "tool": TOOL,
        "version": env!("CARGO_PKG_VERSION"),
        "files": files.iter().map(of).collect::<Vec<_>>(),
    })
}

/// The findings on some FMUs as a SARIF log with one run.
///
/// An FMU is an artifact, and the files in it are artifacts that it contains (SARIF 2.1.0, section
/// 3.24.5).
pub fn sarif(files: &[(PathBuf, Findings)]) -> Value {
    let (mut artifacts, mut results, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    for (file, findings) in files {
        let (file, fmu) = (file.to_string_lossy(), artifacts.len());
        artifacts.push(json!({ "location": { "uri": uri(&file) } }));
        for hint in findings.hints() {
            notes
                .push(json!({ "level": "note", "message": { "text": format!("{file}: {hint}") } }));
        }
        let mut inside = HashMap::from([("archive", fmu)]);
        for group in findings.groups() {
            for finding in &group.kept {
                let place = inside.entry(&finding.location.file);
                let index = *place.or_insert_with_key(|file| {
                    let location = json!({ "uri": format!("/{}", uri(file)) });
                    artifacts.push(json!({ "location": location, "parentIndex": fmu }));
                    artifacts.len() - 1
                });
                let artifact = json!({
                    "uri": artifacts[index]["location"]["uri"],
                    "index": index,
                });
                results.push(json!({
                    "ruleId": group.rule.id,
                    "ruleIndex": RULES.iter().position(|other| other.id == group.rule.id),
                    "level": group.rule.severity.to_string(),
                    "message": { "text": format!("{} ({})", finding.text, group.source) },
                    "locations": [location(finding, &artifact)],
                }));
            }
            if group.left_out() > 0 {
                let (number, id) = (group.left_out(), group.rule.id);
                let text = format!("{file}: and {number} more of this kind: {id}");
                notes.push(json!({ "level": "note", "message": { "text": text } }));
            }
        }
    }
    let rules = RULES.iter().map(|rule| {
        json!({
            "id": rule.id,
            "shortDescription": { "text": rule.text },
            "help": { "text": format!("Source: {}.", rule.source) },
            "defaultConfiguration": { "level": rule.severity.to_string() },
        })
    });
    json!({
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [{
            "tool": { "driver": {
                "name": TOOL,
                "version": env!("CARGO_PKG_VERSION"),
                "rules": rules.collect::<Vec<_>>(),
            } },
            "invocations": [{
                "executionSuccessful": true,
                "toolExecutionNotifications": notes,
            }],
            "artifacts": artifacts,
            "results": results,
        }],
    })
}

fn location(finding: &Finding, artifact: &Value) -> Value {
    let mut location = json!({ "physicalLocation": { "artifactLocation": artifact } });
    if let Some(line) = finding.location.line {
        location["physicalLocation"]["region"] = json!({ "startLine": line });
    }
    if let Some(variable) = &finding.location.variable {
        location["logicalLocations"] = json!([{ "name": variable, "kind": "variable" }]);
    }
    location
}

/// A path as a URI reference.
fn uri(path: &str) -> String {
    let path = path.replace(std::path::MAIN_SEPARATOR, "/");
    path.bytes()
        .map(|byte| match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'-' | b'.' | b'_' | b'~' => {
                char::from(byte).to_string()
            }
            _ => format!("%{byte:02X}"),
        })
        .collect()
}
