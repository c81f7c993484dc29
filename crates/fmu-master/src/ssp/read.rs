//! Reads packages (.ssp) and system structures (.ssd) as descriptions of systems.

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use fmu_description::xml::Element;

use super::document::{defined_units, document, outermost_system};
use super::system::FlatSystem;
use super::vocabulary::{self, EXPERIMENT, OMS_INFORMATION, OMS_MASTER, OSP_FIXED_STEP};
use crate::package::{StructureFile, SystemOrigin, with_package_names};
use crate::{Description, Order};

/// Reads a package or a system structure. The components step in parallel, as in most tools. SSP has no step:
/// it is taken from the annotations for libcosim and OMSimulator, or is the smallest step of the FMUs, or
/// divides the time into 500 steps.
///
/// # Errors
/// The file cannot be read, is invalid, or has a part that is not supported.
pub fn read(file: &Path) -> Result<Description> {
    let read = || {
        let mut opened = vec![StructureFile::open(file)?];
        let mut description =
            describe(&mut opened).map_err(|error| with_package_names(&opened, &error))?;
        if let Some(source) = description.package.as_mut().and_then(Arc::get_mut) {
            source.opened = opened;
        }
        anyhow::Ok(description)
    };
    read().with_context(|| file.display().to_string())
}

fn describe(opened: &mut Vec<StructureFile>) -> Result<Description> {
    let text = opened[0].structure()?;
    let root = document(&text, vocabulary::STRUCTURE)?;
    let mut system = FlatSystem::new(opened, defined_units(&root));
    system.add(outermost_system(&root)?, "")?;
    let connections = system.connections()?;
    let experiment = root.child(EXPERIMENT);
    let time =
        |name, default| match experiment.and_then(|e| Some((e.attribute(name)?, e.real(name)))) {
            None => Ok(default),
            Some((text, time)) => {
                time.with_context(|| format!("{name} is {text:?}, expected a time in s"))
            }
        };
    let start = time("startTime", 0.0)?;
    let stop = time("stopTime", start + 1.0)?;
    let of_fmus =
        || system.models.iter().flatten().filter_map(|m| m.experiment[2]).reduce(f64::min);
    let step = step(&root).or_else(of_fmus).unwrap_or((stop - start) / 500.0);
    system.warnings.extend(system.undefined.take());
    let mut seen = HashSet::new();
    system.warnings.retain(|warning| seen.insert(warning.clone()));
    Ok(Description {
        start,
        stop,
        step,
        order: Order::Parallel,
        components: system.components,
        connections,
        package: Some(Arc::new(SystemOrigin {
            warnings: system.warnings,
            files: system.sources,
            opened: Vec::new(),
        })),
        ..Description::default()
    })
}

/// The communication step in the annotations of other tools.
fn step(element: &Element<'_>) -> Option<f64> {
    let own = match element.name {
        OSP_FIXED_STEP => element.real("baseStepSize"),
        OMS_INFORMATION => element.real("fixedStepSize"),
        OMS_MASTER => element.real("stepSize"),
        _ => None,
    };
    own.or_else(|| element.children.iter().find_map(step))
}
