//! The state of a component between two steps, in memory: saved, restored any number of times, and forgotten.

use fmu_host::{FmuState, Instance, Success};

use crate::Fmu;
use crate::component_instance::{CallResult, ComponentInstance};
use crate::integrator::Integrator;

/// The state of a component, to be forgotten with [`ComponentInstance::forget`].
pub(crate) struct ComponentState<'a> {
    fmu: FmuState,
    integrator: Option<Box<Integrator<'a>>>,
    /// The row of the table whose values its tunable parameters have.
    table_row: Option<usize>,
}

impl Fmu {
    /// Why the state of an instance cannot be saved and restored, if so.
    pub(crate) fn unsavable(&self) -> Option<&'static str> {
        if self.is_function() {
            return Some("it is a function, which has no state that can be saved");
        }
        (!self.can_restore).then_some(match self.version {
            fmu_description::FmiVersion::Fmi2 => {
                "its model description does not declare canGetAndSetFMUstate"
            }
            fmu_description::FmiVersion::Fmi3 => {
                "its model description does not declare canGetAndSetFMUState"
            }
        })
    }
}

impl<'a> ComponentInstance<'a> {
    /// Saves its state, in the memory of one that was saved before, if there is one.
    pub(crate) fn save(&mut self, state: &mut Option<ComponentState<'a>>) -> CallResult {
        let what = "saving the state";
        let table_row = self.parameters.as_ref().map(|parameters| parameters.row);
        match state {
            Some(state) => {
                state.table_row = table_row;
                self.call("get_fmu_state", what, |instance| instance.save_to(&mut state.fmu))?;
                match (&mut state.integrator, &self.integrator) {
                    (Some(saved), Some(integrator)) => saved.copy_from(integrator),
                    (saved, integrator) => saved.clone_from(integrator),
                }
            }
            None => {
                let mut fmu = None;
                self.call("get_fmu_state", what, |instance| {
                    fmu = Some(instance.get_fmu_state()?);
                    Ok(Success::Ok)
                })?;
                let integrator = self.integrator.clone();
                *state = fmu.map(|fmu| ComponentState { fmu, integrator, table_row });
            }
        }
        Ok(())
    }

    /// Returns to a state that was saved by this instance.
    pub(crate) fn restore(&mut self, state: &ComponentState<'a>) -> CallResult {
        self.call("set_fmu_state", "restoring a state", |i| i.set_fmu_state(&state.fmu))?;
        if let (Some(parameters), Some(row)) = (&mut self.parameters, state.table_row) {
            parameters.row = row;
        }
        match (&mut self.integrator, &state.integrator) {
            (Some(integrator), Some(saved)) => integrator.copy_from(saved),
            (integrator, saved) => integrator.clone_from(saved),
        }
        Ok(())
    }

    /// Frees a state, unless the FMU must not be called any more.
    pub(crate) fn forget(&mut self, state: ComponentState<'a>) -> CallResult {
        if self.fmu.is_lost() {
            return Ok(());
        }
        self.call("free_fmu_state", "end of a state", |instance: &mut Instance| {
            instance.free_fmu_state(state.fmu)
        })
    }
}
