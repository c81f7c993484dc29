//! The state of a component between two steps: saved in memory, restored any number of times, and forgotten; or serialized
//! for a file.

use fmu_host::{FmuState, Instance, Success};

use crate::component_clocks::ComponentClocks;
use crate::component_instance::{CallResult, ComponentInstance};
use crate::event_mode::EventMode;
use crate::integrator::Integrator;
use crate::saved_run::{MAX_STATE, SavedComponent};

/// The state of a component, to be forgotten with [`ComponentInstance::forget`].
pub(crate) struct ComponentState<'a> {
    fmu: FmuState,
    integrator: Option<Box<Integrator<'a>>>,
    event_mode: Option<Box<EventMode>>,
    clocks: Option<Box<ComponentClocks>>,
    /// The row of the table whose values its tunable parameters have.
    table_row: Option<usize>,
}

impl<'a> ComponentInstance<'a> {
    /// Saves its state, in the memory of one that was saved before, if there is one.
    pub(crate) fn save(&mut self, state: &mut Option<ComponentState<'a>>) -> CallResult {
        let what = "saving the state";
        let table_row = self.parameters.as_ref().map(|parameters| parameters.row);
        match state {
            Some(state) => {
                state.table_row = table_row;
                state.event_mode.clone_from(&self.event_mode);
                state.clocks.clone_from(&self.clocks);
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
                let (event_mode, clocks) = (self.event_mode.clone(), self.clocks.clone());
                *state = fmu.map(|fmu| ComponentState {
                    fmu,
                    integrator,
                    event_mode,
                    clocks,
                    table_row,
                });
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
        self.event_mode.clone_from(&state.event_mode);
        self.clocks.clone_from(&state.clocks);
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

    /// Its state as bytes; the state of its integration is separate.
    pub(crate) fn serialize(&mut self) -> CallResult<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut saved = None;
        self.save(&mut saved)?;
        let Some(state) = saved else { return Ok(bytes) };
        let serialized = self.call("serialize_fmu_state", "saving the state", |instance| {
            bytes = instance.serialize_fmu_state(&state.fmu, MAX_STATE)?;
            Ok(Success::Ok)
        });
        self.forget(state)?;
        serialized.map(|()| bytes)
    }

    /// Returns to a state that was serialized, possibly by another process.
    pub(crate) fn deserialize(&mut self, saved: &SavedComponent) -> CallResult {
        let what = "loading the state";
        let mut state = None;
        self.call("deserialize_fmu_state", what, |instance| {
            state = Some(instance.deserialize_fmu_state(&saved.state)?);
            Ok(Success::Ok)
        })?;
        let Some(fmu) = state else { return Ok(()) };
        // Systems with clocks are not saved in files.
        let (event_mode, clocks) = (None, None);
        let state = ComponentState { fmu, integrator: None, event_mode, clocks, table_row: None };
        let set = self.call("set_fmu_state", what, |i| i.set_fmu_state(&state.fmu));
        let forgotten = self.forget(state);
        set.and(forgotten)?;
        if let (Some(integrator), Some(saved)) = (&mut self.integrator, &saved.integrator) {
            integrator.set_state(saved);
        }
        self.event_mode = saved.event_mode.clone().map(Box::new);
        Ok(())
    }
}
