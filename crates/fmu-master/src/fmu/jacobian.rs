//! The structure of the Jacobian of an FMU's equations, by which an implicit method computes it with few calls.

use std::collections::HashMap;

use fmu_description::{Causality, ModelDescription, Variability};

/// The continuous states, their derivatives, and which of them depend on which.
#[derive(Default)]
pub(crate) struct JacobianStructure {
    /// The value references of the states and of their derivatives, whose elements are in the order of the FMU.
    pub(crate) states: Vec<u32>,
    pub(crate) derivatives: Vec<u32>,
    /// The states on which each derivative depends; `None` if the FMU does not declare it.
    pub(crate) dependencies: Option<Vec<Vec<usize>>>,
}

impl JacobianStructure {
    pub(super) fn of(model: &ModelDescription<'_>) -> Self {
        let pairs = model.derivatives.iter().map(|unknown| {
            let derivative = model.variable(unknown.index)?;
            Some((unknown, derivative, model.referred(derivative.value, "derivative")?))
        });
        // A derivative of an unknown state leaves the order of the others unknown.
        let Some(pairs) = pairs.collect::<Option<Vec<_>>>() else {
            return Self::default();
        };
        let mut count = 0;
        let mut elements = HashMap::new();
        for (_, _, state) in &pairs {
            elements.insert(state.reference, count..count + state.element_count());
            count += state.element_count();
        }
        let rows = pairs.iter().map(|(unknown, derivative, _)| {
            let mut row = Vec::new();
            for number in unknown.dependencies.as_ref()? {
                let known = model.variable(model.index(*number))?;
                match elements.get(&known.reference) {
                    Some(states) => row.extend(states.clone()),
                    // It may depend on states itself.
                    None if known.variability == Variability::Continuous
                        && !matches!(
                            known.causality,
                            Causality::Input | Causality::Independent
                        ) =>
                    {
                        return None;
                    }
                    None => {}
                }
            }
            Some(vec![row; derivative.element_count()])
        });
        let rows = Vec::from_iter(rows);
        let is_declared = rows.iter().any(Option::is_some);
        let dependencies = is_declared.then(|| {
            let rows = rows.into_iter().zip(&pairs);
            let rows = rows.flat_map(|(row, (_, derivative, _))| {
                row.unwrap_or_else(|| vec![Vec::from_iter(0..count); derivative.element_count()])
            });
            rows.collect()
        });
        Self {
            states: pairs.iter().map(|(_, _, state)| state.reference).collect(),
            derivatives: pairs.iter().map(|(_, derivative, _)| derivative.reference).collect(),
            dependencies,
        }
    }
}
