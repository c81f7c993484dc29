//! Files that are related to an FMU by the layered standard FMI-LS-REF 1.0.0-beta.1: parameter sets, experiments and
//! results; and the experiments themselves, in the format MA-HS-Experiments.
//!
//! The manifest lists the files. An experiments file has the times of each experiment as attributes of `Experiment`, as
//! the specification says, or of `TransientSimulation` in it, as the newer schema says; both are read. Manifests of drafts
//! before 1.0.0-alpha.1 hold the experiments themselves.

use std::cell::RefCell;
use std::collections::HashSet;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::{self, Element};

use crate::archive::{Archive, relative};
use crate::text::quote;

/// The folder of the files.
pub const FOLDER: &str = "extra/org.fmi-standard.fmi-ls-ref";
/// The file that lists them.
pub const MANIFEST: &str = "extra/org.fmi-standard.fmi-ls-ref/fmi-ls-manifest.xml";
/// The root of the manifest, and the attributes that it must have, with their values.
pub const MANIFEST_ROOT: &str = "fmiReferences";
/// The namespace of these attributes.
pub const NAMESPACE: &str = "http://fmi-standard.org/fmi-ls-manifest";
/// The attributes that every manifest must have; the version is the one that is written.
pub const ATTRIBUTES: [(&str, &str); 3] = [
    ("fmi-ls-name", "org.fmi-standard.fmi-ls-ref"),
    ("fmi-ls-version", "1.0.0-beta.1"),
    (
        "fmi-ls-description",
        "Layered Standard providing information on related files included in an FMU.",
    ),
];
/// The type of a parameter set of SSP.
pub const PARAMETER_SET: &str = "application/x-ssp-parameter-set";
/// The type of a file of experiments.
pub const EXPERIMENTS: &str = "application/x-ma-hs-experiments";
/// The type of a table.
pub const TABLE: &str = "text/csv";
/// The root of a file of experiments.
pub const EXPERIMENTS_ROOT: &str = "Experiments";
/// The element of an experiment that is a simulation over time.
pub const SIMULATION: &str = "TransientSimulation";

/// The roles that the standard defines, without sub-roles.
pub const ROLES: [&str; 19] = [
    "document",
    "requirement",
    "specification",
    "model",
    "parameter",
    "system",
    "testcase",
    "experiment",
    "result",
    "method",
    "rationale",
    "report",
    "request",
    "delivery",
    "configuration",
    "signature",
    "serialized-state",
    "meta-data",
    "other",
];

/// What an FMU has by the layered standard.
#[derive(Debug, Default)]
pub struct References {
    /// The files that the manifest lists.
    pub files: Vec<RelatedFile>,
    /// The parameter sets among them that can be read.
    pub parameter_sets: Vec<ParameterSet>,
    /// The experiments in these files.
    pub experiments: Vec<Experiment>,
    /// What is wrong with the files.
    pub faults: Vec<Fault>,
}

/// A file that is related to the FMU.
#[derive(Debug, Clone)]
pub struct RelatedFile {
    /// Its path in the FMU, or its address if it is elsewhere.
    pub file: String,
    /// Whether it is not in the FMU by its address.
    pub is_elsewhere: bool,
    /// Its MIME type.
    pub of_type: String,
    /// Its role, maybe with a sub-role.
    pub role: String,
    /// Its description; may be empty.
    pub description: String,
    /// Its line in the manifest.
    pub line: u32,
}

/// Values of parameters under a name.
#[derive(Debug, Clone)]
pub struct ParameterSet {
    /// The name in the file, else the name of the file without its ending.
    pub name: String,
    /// Its description; may be empty.
    pub description: String,
    /// The file in the FMU.
    pub file: String,
    /// The names of the parameters.
    pub parameters: Vec<String>,
}

/// An experiment with the FMU.
#[derive(Debug, Clone, Default)]
pub struct Experiment {
    /// Its name.
    pub name: String,
    /// Its description; may be empty.
    pub description: String,
    /// The kind of its analysis, if it is no simulation over time.
    pub other_analysis: Option<String>,
    /// The start time (s).
    pub start: Option<f64>,
    /// The stop time (s).
    pub stop: Option<f64>,
    /// The step size (s).
    pub step: Option<f64>,
    /// The relative tolerance.
    pub tolerance: Option<f64>,
    /// The file of its parameters.
    pub parameters: Option<Source>,
    /// The table of its inputs.
    pub stimuli: Option<Source>,
    /// The table of its results.
    pub references: Option<Source>,
    /// The file that has it, and its line there.
    pub file: String,
    /// The line of the element.
    pub line: u32,
}

/// A file that an experiment uses.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// Its path in the FMU, or its address if it is elsewhere.
    pub file: String,
    /// Its MIME type.
    pub of_type: String,
}

/// What is wrong with a file.
#[derive(Debug, Clone)]
pub struct Fault {
    /// Of which kind it is.
    pub kind: FaultKind,
    /// The file.
    pub file: String,
    /// The line, if it is known.
    pub line: Option<u32>,
    /// What was found and what was expected.
    pub text: String,
}

/// The kind of a [`Fault`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultKind {
    /// A file cannot be read.
    Unreadable,
    /// A file is not as its schema says.
    Form,
    /// A file is missing.
    Missing,
}

/// Reads what an archive has, each file once.
struct Reader<'a> {
    archive: &'a mut Archive,
    /// The names of the files in the archive.
    names: HashSet<String>,
    /// The files that were read, and as what; and the names of the experiments in them.
    read: HashSet<(String, &'static str)>,
    experiments: HashSet<String>,
    found: References,
}

impl Reader<'_> {
    /// Reads a document unless it was read before, or notes why it cannot be read.
    fn document(
        &mut self,
        file: &str,
        what: &'static str,
        read: fn(&mut Self, &str, &Element<'_>),
    ) {
        if !self.read.insert((file.to_owned(), what)) {
            return;
        }
        let text = self.archive.text(file).and_then(|text| text.context("there is no such file"));
        let read = text.and_then(|text| {
            read(self, file, &xml::parse(&text)?);
            Ok(())
        });
        if let Err(error) = read {
            let (kind, text) = (FaultKind::Unreadable, format!("{error:#}"));
            self.found.faults.push(Fault { kind, file: file.to_owned(), line: None, text });
        }
    }

    fn fault(&mut self, kind: FaultKind, file: &str, element: &Element<'_>, text: String) {
        let line = Some(element.line);
        self.found.faults.push(Fault { kind, file: file.to_owned(), line, text });
    }

    fn manifest(&mut self, file: &str, root: &Element<'_>) {
        if root.name != MANIFEST_ROOT {
            let text = format!("the root is {}, expected {MANIFEST_ROOT}", quote(root.name));
            return self.fault(FaultKind::Form, file, root, text);
        }
        for (name, expected) in ATTRIBUTES {
            let mut attributes = root.attributes.iter();
            let found = attributes.find(|(key, _)| key.rsplit(':').next() == Some(name));
            match found {
                None => {
                    let text = format!("{MANIFEST_ROOT} has no {name}, expected {expected:?}");
                    self.fault(FaultKind::Form, file, root, text);
                }
                Some((_, value)) if name == "fmi-ls-name" && value != expected => {
                    let text = format!("{name} is {}, expected {expected:?}", quote(value));
                    self.fault(FaultKind::Form, file, root, text);
                }
                Some(_) => {}
            }
        }
        for element in &root.children {
            match element.name {
                "Related" => self.related(element),
                "Experiment" => self.experiment(file, element),
                "Annotations" => {}
                other => {
                    let text =
                        format!("the element {} is not known, expected Related", quote(other));
                    self.fault(FaultKind::Form, file, element, text);
                }
            }
        }
    }

    fn related(&mut self, element: &Element<'_>) {
        let attribute = |name| element.attribute(name).unwrap_or_default().to_owned();
        let (role, source) = (attribute("role"), attribute("source"));
        let main = role.split('/').next().unwrap_or_default();
        if !ROLES.contains(&main) {
            let text = format!("role is {}, expected one of {}", quote(&role), ROLES.join(", "));
            self.fault(FaultKind::Form, MANIFEST, element, text);
        }
        let Some(found) = self.find(MANIFEST, element, &source) else { return };
        let of_type = element.attribute("type").unwrap_or("application/octet-stream").to_owned();
        let related = RelatedFile {
            file: found.file.clone(),
            is_elsewhere: found.is_elsewhere,
            of_type,
            description: attribute("description"),
            line: element.line,
            role: role.clone(),
        };
        self.found.files.push(related);
        if !found.is_there {
            return;
        }
        match main {
            "parameter" => self.document(&found.file, "parameter set", Self::parameter_set),
            "experiment" => self.document(&found.file, "experiments", Self::experiments),
            _ => {}
        }
    }

    /// Finds the file of a source, which is relative to the file that has it.
    fn find(&mut self, base: &str, element: &Element<'_>, source: &str) -> Option<Found> {
        match resolve(base, source) {
            Ok(None) => {
                Some(Found { file: source.to_owned(), is_elsewhere: true, is_there: false })
            }
            Ok(Some(file)) => {
                let is_there = self.names.contains(&file);
                if !is_there {
                    let text = format!("source is {}, but the FMU has no {file}", quote(source));
                    self.fault(FaultKind::Missing, base, element, text);
                }
                Some(Found { file, is_elsewhere: false, is_there })
            }
            Err(error) => {
                let text = format!("source is {}: {error}", quote(source));
                self.fault(FaultKind::Form, base, element, text);
                None
            }
        }
    }

    fn parameter_set(&mut self, file: &str, root: &Element<'_>) {
        if local(root.name) != "ParameterSet" {
            let text = format!("the root is {}, expected a ParameterSet", quote(root.name));
            return self.fault(FaultKind::Form, file, root, text);
        }
        let lists = root.children.iter().filter(|list| local(list.name) == "Parameters");
        let parameters = lists.flat_map(|list| &list.children);
        let parameters =
            parameters.filter_map(|parameter| Some(parameter.attribute("name")?.to_owned()));
        let name = root.attribute("name").filter(|name| !name.is_empty());
        self.found.parameter_sets.push(ParameterSet {
            name: name.unwrap_or_else(|| stem(file)).to_owned(),
            description: root.attribute("description").unwrap_or_default().to_owned(),
            file: file.to_owned(),
            parameters: parameters.collect(),
        });
    }

    fn experiments(&mut self, file: &str, root: &Element<'_>) {
        if root.name != EXPERIMENTS_ROOT {
            let text = format!("the root is {}, expected {EXPERIMENTS_ROOT}", quote(root.name));
            return self.fault(FaultKind::Form, file, root, text);
        }
        let mut elements = root.children("Experiment").peekable();
        if elements.peek().is_none() {
            self.fault(FaultKind::Form, file, root, "it has no Experiment".to_owned());
        }
        elements.for_each(|element| self.experiment(file, element));
    }

    fn experiment(&mut self, file: &str, element: &Element<'_>) {
        const PARTS: [&str; 5] = ["Parameters", "Stimuli", "References", "Annotations", SIMULATION];
        let kind = element.children.iter().find(|child| !PARTS.contains(&child.name));
        let simulation = element.child(SIMULATION);
        let faults = RefCell::new(Vec::new());
        let number = |of: &Element<'_>, name: &str| {
            let text = of.attribute(name)?;
            let number = of.real(name).filter(|number| number.is_finite());
            if number.is_none() {
                let text = format!("{name} is {}, expected a number", quote(text));
                faults.borrow_mut().push(text);
            }
            number
        };
        let time =
            |name: &str| simulation.and_then(|of| number(of, name)).or(number(element, name));
        let name = element.attribute("name").unwrap_or_default().to_owned();
        let mut experiment = Experiment {
            description: element.attribute("description").unwrap_or_default().to_owned(),
            other_analysis: kind.map(|kind| kind.name.to_owned()),
            start: time("startTime"),
            stop: time("stopTime"),
            step: time("stepSize"),
            tolerance: number(element, "tolerance"),
            file: file.to_owned(),
            line: element.line,
            ..Experiment::default()
        };
        if name.is_empty() || !self.experiments.insert(name.clone()) {
            let text = format!("the name of the experiment is {}, expected its own", quote(&name));
            faults.borrow_mut().push(text);
        }
        experiment.name = name;
        for text in faults.into_inner() {
            self.fault(FaultKind::Form, file, element, text);
        }
        let mut source = |part: &str, default: &str| {
            let element = element.child(part)?;
            let source = element.attribute("source").unwrap_or_default();
            let of_type = element.attribute("type").unwrap_or(default).to_owned();
            let found = self.find(file, element, source)?;
            Some(Source { file: found.file, of_type })
        };
        experiment.parameters = source("Parameters", PARAMETER_SET);
        experiment.stimuli = source("Stimuli", TABLE);
        experiment.references = source("References", TABLE);
        if let Some(Source { file, .. }) = &experiment.parameters
            && self.names.contains(file)
        {
            self.document(file, "parameter set", Self::parameter_set);
        }
        self.found.experiments.push(experiment);
    }
}

impl References {
    /// What an archive has, if it has a manifest.
    pub fn read(archive: &mut Archive) -> Option<Self> {
        let names: HashSet<String> = archive.names.iter().cloned().collect();
        names.contains(MANIFEST).then(|| {
            let (read, experiments) = (HashSet::new(), HashSet::new());
            let found = Self::default();
            let mut reader = Reader { archive, names, read, experiments, found };
            reader.document(MANIFEST, "manifest", Reader::manifest);
            reader.found
        })
    }

    /// The parameter set of a name: the one in its file, or the name or path of the file.
    ///
    /// # Errors
    /// There is none, or more than one; the error names those that there are.
    pub fn parameter_set_named(&self, name: &str) -> Result<&ParameterSet> {
        let sets = &self.parameter_sets;
        let names = Vec::from_iter(sets.iter().map(|set| set.name.as_str()));
        let is_file = |set: &&ParameterSet| {
            set.file == name || stem(&set.file) == name || set.file.rsplit('/').next() == Some(name)
        };
        one(sets.iter().filter(|set| set.name == name), "parameter set", name, &names).or_else(
            |error| match sets.iter().find(is_file) {
                Some(set) if !names.contains(&name) => Ok(set),
                _ => Err(error),
            },
        )
    }

    /// The experiment of a name.
    ///
    /// # Errors
    /// There is none, or more than one; the error names those that there are.
    pub fn experiment_named(&self, name: &str) -> Result<&Experiment> {
        let names = Vec::from_iter(self.experiments.iter().map(|own| own.name.as_str()));
        one(self.experiments.iter().filter(|own| own.name == name), "experiment", name, &names)
    }
}

/// The only one of a name.
fn one<T>(mut found: impl Iterator<Item = T>, what: &str, name: &str, names: &[&str]) -> Result<T> {
    match (found.next(), found.next()) {
        (Some(only), None) => Ok(only),
        (Some(_), Some(_)) => bail!("two of its {what}s have the name {name:?}"),
        _ if names.is_empty() => bail!("there is no {what} {name:?}, as the FMU has none"),
        _ => bail!("there is no {what} {name:?}, expected one of {}", names.join(", ")),
    }
}

/// Where the file of a source is.
struct Found {
    file: String,
    is_elsewhere: bool,
    is_there: bool,
}

/// The name of an element without its prefix.
fn local(name: &str) -> &str {
    name.rsplit(':').next().unwrap_or(name)
}

/// The name of a file without folders and ending.
fn stem(file: &str) -> &str {
    let name = file.rsplit('/').next().unwrap_or(file);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// The path in the archive of a source, which is relative to a file there; `None` if it is elsewhere.
fn resolve(base: &str, source: &str) -> Result<Option<String>> {
    let (scheme, _) = source.split_once(':').unwrap_or_default();
    let is_scheme = |c: char| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.');
    if !scheme.is_empty() && scheme.chars().all(is_scheme) {
        return Ok(None);
    }
    let source = decoded(source)?;
    ensure!(!source.starts_with('/'), "it is an absolute path, expected a relative one");
    let mut parts = Vec::from_iter(base.split('/'));
    parts.pop();
    for part in source.split('/') {
        match part {
            ".." => ensure!(parts.pop().is_some(), "it leaves the FMU"),
            part => parts.push(part),
        }
    }
    let path = relative(&parts.join("/")).map_err(anyhow::Error::msg)?;
    ensure!(!path.is_empty() && !path.ends_with('/'), "expected the path of a file");
    Ok(Some(path))
}

/// A text of a URI with its percent-encoded characters.
fn decoded(text: &str) -> Result<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let [first, after @ ..] = rest {
        rest = after;
        if *first != b'%' {
            bytes.push(*first);
            continue;
        }
        let digits = after.get(..2).and_then(|digits| str::from_utf8(digits).ok());
        let byte = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(byte.context("% is not followed by two hexadecimal digits")?);
        rest = &after[2..];
    }
    String::from_utf8(bytes).context("it is not UTF-8")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::archive::{Packed, write};

    /// What an FMU with these files has.
    fn references(folder: &Path, files: &[(&str, &str)]) -> References {
        let files = files.iter().map(|(name, text)| {
            let name =
                if name.contains('/') { (*name).to_owned() } else { format!("{FOLDER}/{name}") };
            (name, Packed::text(text.as_bytes()).unwrap())
        });
        let files = Vec::from_iter(files);
        let entries = Vec::from_iter(files.iter().map(|(name, packed)| (name, packed)));
        let file = folder.join("a.fmu");
        write(&file, &entries).unwrap();
        References::read(&mut Archive::open(&file).unwrap()).unwrap()
    }

    fn manifest(related: &str) -> String {
        format!(
            r#"<fmiReferences xmlns:f="{NAMESPACE}" f:fmi-ls-name="{}" f:fmi-ls-version="1.0.0-alpha.1"
            f:fmi-ls-description="{}">{related}</fmiReferences>"#,
            ATTRIBUTES[0].1, ATTRIBUTES[2].1
        )
    }

    #[test]
    fn experiments_of_the_specification_of_its_schema_and_of_older_manifests_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let experiment = r#"name="a" startTime="1" stopTime="2.5" stepSize="0.5" tolerance="1e-3">
            <Parameters source="../../resources/my%20set.ssv"/><Stimuli source="in.csv"/>
            <References source="out.h5" type="application/hdf5"/></Experiment>"#;
        let newer = r#"name="a" tolerance="1e-3"><TransientSimulation startTime="1" stopTime="2.5"
            stepSize="0.5"/><Parameters source="../../resources/my%20set.ssv"/><Stimuli source="in.csv"/>
            <References source="out.h5" type="application/hdf5"/></Experiment>"#;
        let related = r#"<Related role="experiment" source="all.exp" description="tests"/>"#;
        let file = |experiment: &str| {
            format!("<Experiments name='all'><Experiment {experiment}</Experiments>")
        };
        for (manifest, all) in [
            (manifest(related), file(experiment)),
            (manifest(related), file(newer)),
            (manifest(&format!("<Experiment {experiment}")), String::new()),
        ] {
            let set = r#"<ssv:ParameterSet name="soft" description="d"><ssv:Parameters>
                <ssv:Parameter name="k"/></ssv:Parameters></ssv:ParameterSet>"#;
            let found = references(
                folder.path(),
                &[
                    ("fmi-ls-manifest.xml", &manifest),
                    ("all.exp", &all),
                    ("in.csv", ""),
                    ("out.h5", ""),
                    ("resources/my set.ssv", set),
                ],
            );
            assert!(found.faults.is_empty(), "{:?}", found.faults);
            let a = found.experiment_named("a").unwrap();
            assert_eq!((a.start, a.stop), (Some(1.0), Some(2.5)));
            assert_eq!((a.step, a.tolerance), (Some(0.5), Some(1e-3)));
            let out =
                Source { file: format!("{FOLDER}/out.h5"), of_type: "application/hdf5".into() };
            assert_eq!(a.references, Some(out));
            assert_eq!(a.parameters.as_ref().unwrap().file, "resources/my set.ssv");
            for name in ["soft", "my set", "my set.ssv", "resources/my set.ssv"] {
                assert_eq!(found.parameter_set_named(name).unwrap().parameters, ["k"]);
            }
            let error = found.experiment_named("b").unwrap_err().to_string();
            assert_eq!(error, "there is no experiment \"b\", expected one of a");
        }
    }

    #[test]
    fn what_is_wrong_is_named_and_the_rest_is_read() {
        let folder = tempfile::tempdir().unwrap();
        for (related, kind, reason) in [
            (r#"<Related role="parameter" source="no.ssv"/>"#, FaultKind::Missing, "has no extra"),
            (r#"<Related role="x" source="a.csv"/>"#, FaultKind::Form, "role is \"x\""),
            (r#"<Related role="other" source="../../../a"/>"#, FaultKind::Form, "leaves the FMU"),
            (r#"<Related role="other" source="%zz"/>"#, FaultKind::Form, "hexadecimal"),
            (r#"<Related role="parameter" source="a.csv"/>"#, FaultKind::Unreadable, ""),
            (r#"<Related role="experiment" source="set.ssv"/>"#, FaultKind::Form, "the root is"),
            ("<Other/>", FaultKind::Form, "is not known"),
            (r#"<Experiment name=""/>"#, FaultKind::Form, "expected its own"),
            (r#"<Experiment name="a" stopTime="x"/>"#, FaultKind::Form, "expected a number"),
        ] {
            let text =
                manifest(&format!(r#"{related}<Related role="parameter" source="set.ssv"/>"#));
            let found = references(
                folder.path(),
                &[
                    ("fmi-ls-manifest.xml", &text),
                    ("a.csv", "time\n0\n"),
                    ("set.ssv", "<ParameterSet/>"),
                ],
            );
            let [fault] = &found.faults[..] else { panic!("{related}: {:?}", found.faults) };
            assert!(fault.kind == kind && fault.text.contains(reason), "{fault:?}");
            assert_eq!(found.parameter_sets[0].name, "set");
        }
        for text in ["<fmiReferences", "<Other/>"] {
            let found = references(folder.path(), &[("fmi-ls-manifest.xml", text)]);
            assert_eq!(found.faults.len(), 1);
        }
        let found = references(folder.path(), &[("fmi-ls-manifest.xml", "<fmiReferences/>")]);
        assert_eq!(found.faults.len(), 3);
        let elsewhere = r#"<Related role="document" source="https://example.com/a"/>"#;
        let found = references(folder.path(), &[("fmi-ls-manifest.xml", &manifest(elsewhere))]);
        assert!(found.faults.is_empty() && found.files[0].is_elsewhere);
    }
}
