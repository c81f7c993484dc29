//! Chooses the inputs and parameters that a container exposes.

use std::collections::HashSet;

use anyhow::{Result, bail, ensure};
use fmu_description::{Causality, Type, Variability};

use crate::components::{Components, ScalarId};
use crate::connections::ResolvedConnection;
use crate::input_table::InputTable;
use crate::{Expose, Fmu};

/// The inputs that the host of a container sets.
///
/// # Errors
/// One is unknown, or is fed by something else.
pub(crate) fn inputs(
    expose: &Expose,
    components: &Components,
    connections: &[ResolvedConnection],
    input: Option<&InputTable>,
) -> Result<Vec<ScalarId>> {
    let connected: HashSet<_> = connections.iter().map(|connection| connection.to).collect();
    let of_table: HashSet<_> = input.iter().flat_map(|input| input.scalars()).collect();
    let refusal = |id: &ScalarId| {
        let variable = id.variable(components);
        match variable.causality {
            _ if connected.contains(id) => Some("it is connected"),
            _ if of_table.contains(id) => Some("the table of inputs has a column for it"),
            _ if variable.of_type == Type::Clock => Some("it is a clock"),
            Causality::Input => unsettable(id.fmu(components), id.scalar),
            _ => Some("it is not an input"),
        }
    };
    match &expose.inputs {
        None => Ok(components.scalars().filter(|id| refusal(id).is_none()).collect()),
        Some(names) => chosen("inputs", names, components, refusal),
    }
}

/// The parameters that the host of a container sets.
///
/// # Errors
/// One is unknown, or is not a parameter.
pub(super) fn parameters(
    expose: &Expose,
    components: &Components,
    input: Option<&InputTable>,
) -> Result<Vec<ScalarId>> {
    let of_table: HashSet<_> = input.iter().flat_map(|input| input.scalars()).collect();
    let refusal = |id: &ScalarId| {
        let (fmu, variable) = (id.fmu(components), id.variable(components));
        match variable.causality {
            _ if of_table.contains(id) => Some("the table of inputs has a column for it"),
            Causality::Parameter if variable.variability == Variability::Constant => {
                Some("it is constant")
            }
            Causality::Parameter => unsettable(fmu, id.scalar),
            Causality::StructuralParameter => {
                Some("it is the size of arrays, which a container cannot change")
            }
            _ => Some("it is not a parameter"),
        }
    };
    match &expose.parameters {
        None => Ok(components.scalars().filter(|id| refusal(id).is_none()).collect()),
        Some(names) => chosen("parameters", names, components, refusal),
    }
}

/// Why the host of a container cannot set a scalar, if so.
fn unsettable(fmu: &Fmu, scalar: usize) -> Option<&'static str> {
    match fmu.variable(scalar) {
        variable if variable.is_of_ticks() => Some("a container keeps its clocks to itself"),
        variable if variable.of_type == Type::Binary => Some("a container takes no Binary"),
        _ => fmu.unusable(scalar),
    }
}

/// The variables with these names, of arrays all elements.
fn chosen(
    key: &str,
    names: &[String],
    components: &Components,
    refusal: impl Fn(&ScalarId) -> Option<&'static str>,
) -> Result<Vec<ScalarId>> {
    let (mut ids, mut known) = (Vec::new(), HashSet::new());
    for name in names {
        let found = components.lookup(name, Fmu::scalars_of);
        let (component, scalars) = found.map_err(|error| error.context(format!("expose.{key}")))?;
        for scalar in scalars {
            let id = ScalarId { component, scalar };
            if let Some(reason) = refusal(&id) {
                bail!("expose.{key}: {name} cannot be exposed: {reason}");
            }
            ensure!(known.insert(id), "expose.{key}: {name} is exposed twice");
            ids.push(id);
        }
    }
    Ok(ids)
}
