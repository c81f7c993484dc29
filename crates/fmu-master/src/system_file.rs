//! Reads the description of a system from a file: TOML, a package of SSP, or one FMU. Finds the line of an error in
//! such a file.

use std::fs;
use std::path::Path;

use anyhow::{Context, Error, Result, anyhow, ensure};
use toml::de::{DeTable, DeValue};

use crate::declarations::Declarations;
use crate::note::Advice;
use crate::package::is_package;
use crate::references::is_parameter_file;
use crate::similar::with_similar_file;
use crate::table::Format;
use crate::{Component, Description, Experiment, ssp};

impl Description {
    /// Reads a file: an FMU, or a system as [`Description::read`] does.
    ///
    /// # Errors
    /// As for both.
    pub fn open(file: &Path) -> Result<Self> {
        if is_fmu(file) { Self::read_fmu(file) } else { Self::read(file) }
    }

    /// Reads a TOML file, or a package (.ssp) or system (.ssd) of SSP; resolves the paths of the FMUs against
    /// its folder.
    ///
    /// # Errors
    /// The file cannot be read or is not a valid description.
    pub fn read(file: &Path) -> Result<Self> {
        if is_package(file) {
            return ssp::read(file);
        }
        let name = file.display();
        let is_table = Format::from_name(file).is_some();
        ensure!(!is_table, "{name} is a table, expected an FMU, a system file or an SSP package");
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {name}"));
        let text = text.map_err(|error| with_similar_file(error, file))?;
        Self::parse(&text, file).with_context(|| name.to_string())
    }

    /// Parses the text of a TOML file with this path.
    ///
    /// # Errors
    /// It is not a valid description.
    pub fn parse(text: &str, file: &Path) -> Result<Self> {
        let parsed = toml::from_str(text);
        let mut description: Self = parsed.map_err(|error| {
            let text = error.to_string();
            let text = text.trim_end();
            match text.contains("unknown field `parameter`") {
                true => Advice::Sweep.after(format!("{text}\nit is a sweep, expected ")),
                false => anyhow!("{text}"),
            }
        })?;
        for component in &mut description.components {
            component.fmu = file.with_file_name(&component.fmu);
            let parameters = component.parameters.take_if(|name| is_parameter_file(name));
            let in_folder = parameters.map(|name| file.with_file_name(name));
            let in_folder = in_folder.map(|file| file.to_string_lossy().into_owned());
            component.parameters = in_folder.or(component.parameters.take());
        }
        description.input = description.input.map(|input| file.with_file_name(input));
        Ok(description)
    }

    /// As [`Description::parse`], for a text that is not on the disk, whose lines are not the user's.
    ///
    /// # Errors
    /// It is not a valid description.
    pub fn parse_unsaved(text: &str, file: &Path) -> Result<Self> {
        Self::parse(text, file).map_err(|error| {
            let text = error.to_string();
            anyhow!("{}", text.rsplit_once("^\n").map_or(&*text, |(_, reason)| reason))
        })
    }

    /// One FMU, with the times of its default experiment: by default from 0 s for 1 s, in 500 steps. Its rows
    /// are those of `fmpy.simulate_fmu` with this step, so that also a sampled FMU has the outputs before each step.
    ///
    /// # Errors
    /// The file cannot be read or is not an FMU.
    pub fn read_fmu(file: &Path) -> Result<Self> {
        let declared = Declarations::read(file).map_err(|error| with_similar_file(error, file));
        let declared = declared.with_context(|| format!("{} cannot be used", file.display()))?;
        let [start, stop, step] = declared.experiment;
        let start = start.unwrap_or(0.0);
        let stop = stop.unwrap_or(start + 1.0);
        Ok(Self {
            start,
            stop,
            step: step.unwrap_or_else(|| Experiment::derived_step(start, stop)),
            is_step_derived: step.is_none(),
            allow_algebraic_loops: true,
            components: vec![Component {
                name: file.file_stem().unwrap_or_default().to_string_lossy().replace('.', "_"),
                fmu: file.to_owned(),
                sampled: Some(false),
                ..Component::default()
            }],
            is_single: true,
            ..Self::default()
        })
    }
}

/// Whether the name of a file is that of an FMU.
pub fn is_fmu(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("fmu"))
}

/// Adds the file to an error that was found after parsing it, and the line if the message starts with
/// something in the file: a key, or a name such as `plant.theta`.
pub fn locate(error: Error, file: &Path, text: &str) -> Error {
    let message = format!("{error:#}");
    let message = message.strip_prefix("component ").unwrap_or(&message);
    let name = message.split([' ', ':', ',']).next().unwrap_or_default();
    let file = file.display();
    match line(text, name) {
        Some(line) => error.context(format!("{file}:{line}")),
        None => error.context(file.to_string()),
    }
}

/// The line of the first key or string that has this word.
fn line(text: &str, word: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let offset = in_table(document.get_ref(), word)?;
    Some(1 + text.get(..offset)?.matches('\n').count())
}

fn in_table(table: &DeTable<'_>, word: &str) -> Option<usize> {
    let offsets = table.iter().filter_map(|(key, value)| match key.get_ref() {
        key_text if key_text == word => Some(key.span().start),
        _ => in_value(value.get_ref(), value.span().start, word),
    });
    offsets.min()
}

fn in_value(value: &DeValue<'_>, start: usize, word: &str) -> Option<usize> {
    match value {
        DeValue::String(text) => text.split_whitespace().any(|part| part == word).then_some(start),
        DeValue::Table(table) => in_table(table, word),
        DeValue::Array(values) => {
            values.iter().find_map(|value| in_value(value.get_ref(), value.span().start, word))
        }
        _ => None,
    }
}
