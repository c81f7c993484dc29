//! Parameter sets and experiments of the layered standard FMI-LS-REF, which an FMU brings along.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fmu_file::archive::Archive;
use fmu_file::references::{MANIFEST, PARAMETER_SET, References, Source, TABLE};

use crate::declarations::Declarations;
use crate::ssp::{SetParameter, parameter_set};
use crate::{Component, Description, Stimuli};

/// Whether a name is that of a file with a parameter set.
pub(crate) fn is_parameter_file(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ssv"))
}

impl Component {
    /// The parameters of its parameter set, if it has one: of a file, or of its FMU.
    ///
    /// # Errors
    /// There is no such set, or it is invalid.
    pub(crate) fn parameter_set(&self) -> Result<Vec<SetParameter>> {
        let Some(name) = &self.parameters else { return Ok(Vec::new()) };
        ensure!(self.function.is_none(), "a function has no parameters, but parameters = {name:?}");
        let file = Path::new(name);
        if is_parameter_file(name) && file.is_file() {
            let text = fs::read_to_string(file);
            let set = text.map_err(Into::into).and_then(|text| parameter_set(&text));
            return set.with_context(|| name.clone());
        }
        let (mut archive, references) = open(&self.fmu)?;
        let set = references.parameter_set_named(name);
        let set = set.with_context(|| self.fmu.display().to_string())?;
        let text = archive.text(&set.file)?.unwrap_or_default();
        parameter_set(&text).with_context(|| set.file.clone())
    }
}

impl Description {
    /// Takes times, tolerance, parameters and inputs from an experiment of the only FMU.
    ///
    /// # Errors
    /// It is a system, or has no such experiment, or the experiment cannot be performed.
    pub(crate) fn take_experiment(&mut self, name: &str) -> Result<()> {
        let [component] = &mut self.components[..] else {
            bail!("the experiment {name:?} belongs to one FMU, but this is a system")
        };
        ensure!(self.is_single, "the experiment {name:?} belongs to one FMU, but this is a system");
        let (archive, references) = open(&component.fmu)?;
        let fmu = component.fmu.display().to_string();
        let experiment = references.experiment_named(name).with_context(|| fmu.clone())?;
        let named = || format!("{fmu}: experiment {name}");
        if let Some(other) = &experiment.other_analysis {
            bail!("{}: it is of the kind {other}, expected a simulation over time", named());
        }
        let check = |source: &Source, of_type: &str| {
            let Source { file, of_type: found } = source;
            ensure!(
                found == of_type,
                "{file} is of the type {found:?}, expected {of_type}, as no other is supported"
            );
            ensure!(archive.names.contains(file), "the FMU has no {file}");
            Ok(file.clone())
        };
        let file = |source: &Option<Source>, of_type: &str| {
            source.as_ref().map(|source| check(source, of_type)).transpose().with_context(named)
        };
        let own_step = Declarations::read(&component.fmu)?.experiment[2];
        self.start = experiment.start.unwrap_or(self.start);
        let is_longer = experiment.start.is_some() && experiment.stop.is_none();
        if is_longer && self.stop <= self.start {
            self.stop = self.start + 1.0;
        }
        self.stop = experiment.stop.unwrap_or(self.stop);
        let step = experiment.step.or(own_step);
        self.step = step.unwrap_or((self.stop - self.start) / 500.0);
        self.is_step_derived = step.is_none();
        self.tolerance = experiment.tolerance.or(self.tolerance);
        component.parameters = file(&experiment.parameters, PARAMETER_SET)?;
        let stimuli = file(&experiment.stimuli, TABLE)?;
        self.stimuli = stimuli.map(|file| Stimuli { fmu: component.fmu.clone(), file });
        Ok(())
    }
}

/// An FMU, and what it has by the layered standard.
fn open(fmu: &Path) -> Result<(Archive, References)> {
    let read = || {
        let mut archive = Archive::open_sound(fmu)?;
        let references = References::read(&mut archive);
        let references = references.with_context(|| {
            format!("it has no parameter sets and experiments, as it has no {MANIFEST}")
        })?;
        anyhow::Ok((archive, references))
    };
    read().with_context(|| fmu.display().to_string())
}
