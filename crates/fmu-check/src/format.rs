//! Findings for other programs: as JSON, and as SARIF 2.1.0, the format of code scanning in continuous
//! integration.

use std::collections::HashMap;
use std::path::PathBuf;

use fmu_description::FmiVersion;
use serde_json::{Value, json};

use crate::finding::{Finding, Findings, Group};
use crate::rule::{Rule, Severity};
use crate::rules::rules;

/// The name of the program that other programs show.
const TOOL: &str = "cargo-fmu";

/// The findings on some FMUs as a JSON document, which `docs/validate.md` describes.
pub fn json(files: &[(PathBuf, Findings)]) -> Value {
    let of = |(file, findings): &(PathBuf, Findings)| {
        let groups = findings.groups().iter();
        json!({
            "file": file.to_string_lossy(),
            "errors": findings.errors(),
            "warnings": findings.warnings(),
            "rules": groups.map(|group| json_of(group, findings.version())).collect::<Vec<_>>(),
        })
    };
    json!({
        "tool": TOOL,
        "version": env!("CARGO_PKG_VERSION"),
        "files": files.iter().map(of).collect::<Vec<_>>(),
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

/// The findings on some FMUs as a SARIF log with one run.
///
/// An FMU is an artifact, and the files in it are artifacts that it contains (SARIF 2.1.0, section
/// 3.24.5).
pub fn sarif(files: &[(PathBuf, Findings)]) -> Value {
    let mut artifacts = Artifacts::default();
    let (mut results, mut notes) = (Vec::new(), Vec::new());
    for (file, findings) in files {
        let file = file.to_string_lossy();
        let fmu = artifacts.push(uri(&file), None);
        for group in findings.groups() {
            let kept = group.kept.iter();
            results.extend(kept.map(|finding| result(finding, fmu, &mut artifacts)));
            if group.left_out() > 0 {
                let (number, id) = (group.left_out(), group.rule.id);
                let text = format!("{file}: and {number} more of this kind: {id}");
                notes.push(json!({ "level": "note", "message": { "text": text } }));
            }
        }
    }
    json!({
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [{
            "tool": { "driver": {
                "name": TOOL,
                "version": env!("CARGO_PKG_VERSION"),
                "rules": rules().map(descriptor).collect::<Vec<_>>(),
            } },
            "invocations": [{
                "executionSuccessful": true,
                "toolExecutionNotifications": notes,
            }],
            "artifacts": artifacts.list,
            "results": results,
        }],
    })
}

/// The files that results refer to.
#[derive(Default)]
struct Artifacts {
    list: Vec<Value>,
    /// Indices by the containing FMU and the name.
    inside: HashMap<(usize, String), usize>,
}

impl Artifacts {
    fn push(&mut self, uri: String, parent: Option<usize>) -> usize {
        let mut artifact = json!({ "location": { "uri": uri } });
        if let Some(parent) = parent {
            artifact["parentIndex"] = parent.into();
        }
        self.list.push(artifact);
        self.list.len() - 1
    }

    /// The index of a file in an FMU.
    fn of(&mut self, fmu: usize, file: &str) -> usize {
        let key = (fmu, file.to_owned());
        if let Some(&index) = self.inside.get(&key) {
            return index;
        }
        let index = self.push(format!("/{}", uri(file)), Some(fmu));
        self.inside.insert(key, index);
        index
    }
}

fn descriptor(rule: &Rule) -> Value {
    json!({
        "id": rule.id,
        "shortDescription": { "text": rule.text },
        "help": { "text": format!("Source: {}.", rule.source) },
        "defaultConfiguration": { "level": level(rule.severity) },
    })
}

fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
    }
}

fn result(finding: &Finding, fmu: usize, artifacts: &mut Artifacts) -> Value {
    let (rule, place) = (finding.rule, &finding.location);
    let index = match place.file.as_str() {
        "archive" => fmu,
        file => artifacts.of(fmu, file),
    };
    let mut location = json!({
        "physicalLocation": { "artifactLocation": {
            "uri": artifacts.list[index]["location"]["uri"],
            "index": index,
        } },
    });
    if let Some(line) = place.line {
        location["physicalLocation"]["region"] = json!({ "startLine": line });
    }
    if let Some(variable) = &place.variable {
        location["logicalLocations"] = json!([{ "name": variable, "kind": "variable" }]);
    }
    json!({
        "ruleId": rule.id,
        "ruleIndex": rules().position(|other| other.id == rule.id),
        "level": level(rule.severity),
        "message": { "text": format!("{} ({})", finding.text, finding.source) },
        "locations": [location],
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::package::READABLE;
    use crate::rules::definitions::UTC;

    #[test]
    fn results_refer_to_the_rules_and_to_the_files_in_the_fmu() {
        let mut findings = Findings::default();
        findings.add(&READABLE, "archive", "a");
        for _ in 0..5 {
            findings.add(&UTC, "modelDescription.xml", "b");
        }
        let log = sarif(&[(PathBuf::from("my models/a.fmu"), findings)]);
        let run = &log["runs"][0];
        let artifacts = json!([
            { "location": { "uri": "my%20models/a.fmu" } },
            { "location": { "uri": "/modelDescription.xml" }, "parentIndex": 0 },
        ]);
        assert_eq!(run["artifacts"], artifacts);
        let results = run["results"].as_array().unwrap();
        assert_eq!(results.len(), 4);
        for (result, (rule, artifact)) in results.iter().zip([(&READABLE, 0), (&UTC, 1)]) {
            let index = result["ruleIndex"].as_u64().unwrap() as usize;
            assert_eq!(run["tool"]["driver"]["rules"][index]["id"], rule.id);
            let location = &result["locations"][0]["physicalLocation"]["artifactLocation"];
            assert_eq!(location["index"], artifact);
        }
        let notes = &run["invocations"][0]["toolExecutionNotifications"];
        let text = notes[0]["message"]["text"].as_str().unwrap();
        assert!(
            text.contains("2 more of this kind: generation-utc"),
            "{text}"
        );
    }
}
