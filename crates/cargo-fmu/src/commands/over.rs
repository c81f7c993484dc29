//! The other runs on the page of a run: those of files, and runs of the same system with other start values. Runs are
//! named by what differs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fmu_description::{ModelDescription, xml};
use fmu_file::archive::Archive;
use fmu_master::{Description, Literal, Overrides, assignment};

use super::files::stem;

/// Another run.
#[derive(Debug, Clone)]
pub enum OtherRun {
    /// Its rows are in a file.
    Recorded(PathBuf),
    /// It has these start values.
    Changed(Vec<(String, Literal)>),
}

/// Reads another run from the command line: a file, or `NAME=VALUE`, several of them separated by commas.
pub fn other_run(text: &str) -> Result<OtherRun> {
    let file = PathBuf::from(text);
    if file.exists() || !text.contains('=') {
        return Ok(OtherRun::Recorded(file));
    }
    // A list in brackets is one value.
    let parts = text.split(',');
    let are_several = parts.clone().all(|part| part.contains('='));
    let changes = match are_several {
        true => parts.map(assignment).collect(),
        false => assignment(text).map(|change| vec![change]),
    };
    changes.map(OtherRun::Changed)
}

impl OtherRun {
    fn changes(&self) -> &[(String, Literal)] {
        match self {
            Self::Recorded(_) => &[],
            Self::Changed(changes) => changes,
        }
    }
}

/// The names of a run with these overrides and of others; `results` is the file of the first one.
pub fn names(
    system: &Path,
    overrides: &Overrides,
    results: Option<&Path>,
    others: &[OtherRun],
) -> (String, Vec<String>) {
    let all = overrides.sets.iter().chain(others.iter().flat_map(OtherRun::changes));
    let all = Vec::from_iter(all.map(|(name, _)| name.as_str()));
    let short = |name: &str| {
        let last = |name: &str| name.rsplit('.').next().unwrap_or_default().to_owned();
        let is_clear = all.iter().all(|other| *other == name || last(other) != last(name));
        if is_clear { last(name) } else { name.to_owned() }
    };
    let named = |(name, value): &(String, Literal)| format!("{}={}", short(name), text(value));
    let changed =
        |changes: &[(String, Literal)]| Vec::from_iter(changes.iter().map(named)).join(", ");

    let mut own = overrides.sets.clone();
    for (name, _) in others.iter().flat_map(OtherRun::changes) {
        if !own.iter().any(|(set, _)| set == name) {
            let value = start_value(system, overrides, name);
            own.extend(value.map(|value| (name.clone(), Literal::Text(value))));
        }
    }
    let Overrides { step, tolerance, solver, order, interface, input, .. } = overrides;
    let options = [
        step.map(|step| format!("step={step}")),
        tolerance.map(|tolerance| format!("tolerance={tolerance}")),
        solver.map(|solver| format!("{solver:?}").to_lowercase()),
        order.map(|order| format!("{order:?}").to_lowercase()),
        interface.map(|interface| interface.as_str().to_owned()),
        input.as_ref().map(|file| format!("input={}", stem(file))),
    ];
    let parts = own.iter().map(named).chain(options.into_iter().flatten());
    let own = Vec::from_iter(parts).join(", ");
    let own = match results.filter(|_| own.is_empty()) {
        Some(file) if file.extension().is_some() => stem(file),
        _ if own.is_empty() => "this run".to_owned(),
        _ => own,
    };
    let mut taken = vec![own.clone()];
    let others = others.iter().map(|other| {
        let (short, long) = match other {
            OtherRun::Recorded(file) => (stem(file), file.display().to_string()),
            OtherRun::Changed(changes) => (changed(changes), changed(changes)),
        };
        let name = if taken.contains(&short) { long } else { short };
        taken.push(name.clone());
        name
    });
    let others = others.collect();
    (own, others)
}

/// A value as a person writes it.
fn text(value: &Literal) -> String {
    let text = match value {
        Literal::Text(text) => text.clone(),
        value => value.to_string(),
    };
    text.parse::<f64>().map_or(text, |number| number.to_string())
}

/// The start value of a variable: of the system file, else of the FMU; `None` if it has none.
fn start_value(system: &Path, overrides: &Overrides, name: &str) -> Option<String> {
    let mut description = Description::open(system).ok()?;
    overrides.apply(&mut description).ok()?;
    let is_single = description.is_single;
    let mut owners = description.components.iter().filter_map(|component| {
        let within = || name.strip_prefix(&*component.name)?.strip_prefix('.');
        let variable = if is_single { Some(name) } else { within() };
        Some((component, variable?))
    });
    let (component, variable) = owners.next()?;
    if let Some(value) = component.start.get(variable) {
        return Some(text(value));
    }
    let text =
        Archive::open_sound(&component.fmu).and_then(|mut archive| archive.model_description());
    let text = text.context("no model description").ok()?;
    let root = xml::parse(&text).ok()?;
    let model = ModelDescription::read(&root).ok()?;
    let mut variables = model.variables().map(|(_, listed)| listed);
    let listed = variables.find(|listed| listed.names().any(|known| known == variable))?;
    listed.start().map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_named_by_their_values_and_files_by_their_stems() {
        let others = ["kp=1,kd=2", "b.x=[1,2]", "runs/first.csv"];
        let others = others.map(|text| other_run(text).unwrap());
        let sets = ["a.x=3.0", "c.mode=FAST"].map(|text| assignment(text).unwrap()).to_vec();
        let overrides = Overrides { sets, step: Some(0.5), ..Overrides::default() };
        let (own, others) = names(Path::new("none.toml"), &overrides, None, &others);
        assert_eq!(own, "a.x=3, mode=FAST, step=0.5");
        assert_eq!(others, ["kp=1, kd=2", "b.x=[1,2]", "first"]);
    }

    #[test]
    fn a_run_without_changes_has_the_name_of_its_file() {
        let names = |results: Option<&str>, other: &str| {
            let others = [OtherRun::Recorded(other.into())];
            let overrides = Overrides::default();
            names(Path::new("none.toml"), &overrides, results.map(Path::new), &others)
        };
        assert_eq!(names(Some("a.csv"), "b/a.csv"), ("a".into(), vec!["b/a.csv".into()]));
        assert_eq!(names(None, "a.csv"), ("this run".into(), vec!["a".into()]));
        assert_eq!(names(Some("/dev/stdout"), "a.csv").0, "this run");
    }
}
