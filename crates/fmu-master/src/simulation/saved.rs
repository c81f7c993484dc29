//! Snapshots of a run in memory, or of some of its components: saved between steps, and restored any number of times.

use anyhow::Result;

use super::{Row, Simulation};
use crate::RunError;
use crate::component_state::ComponentState;
use crate::fault::FaultyConnection;
use crate::store::Store;

/// What a run keeps of a point between two steps. Its memory is reused.
pub(super) struct Saved<'a> {
    components: Vec<SavedComponent<'a>>,
    /// The outputs that were read last and the row, of the whole run.
    signals: Option<(Store, Row)>,
}

/// A component, by its index, and what the connections that lead to it remember.
struct SavedComponent<'a> {
    index: usize,
    state: Option<ComponentState<'a>>,
    faulty_connections: Vec<FaultyConnection>,
}

/// A snapshot of a simulation, by its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Snapshot(usize);

impl<'a> Simulation<'a> {
    /// Makes room for a snapshot of the whole run.
    ///
    /// # Errors
    /// A component cannot restore its state; the error names it, its file and the reason.
    pub fn snapshot(&mut self) -> Result<Snapshot> {
        let all = Vec::from_iter(0..self.components.len());
        let snapshot = self.snapshot_of(&all)?;
        self.saved[snapshot.0].signals = Some((self.outputs.clone(), self.row.clone()));
        Ok(snapshot)
    }

    /// Makes room for a snapshot of components, by their indices, and of what the connections that lead to them remember.
    /// It leaves out the outputs that were read last.
    ///
    /// # Errors
    /// As [`Self::snapshot`].
    pub fn snapshot_of(&mut self, components: &[usize]) -> Result<Snapshot> {
        let components = components.iter().map(|&index| {
            let component = &self.plan.components[index];
            component.check_savable(false)?;
            let faulty_connections = self.faulty_connections[index].clone();
            Ok(SavedComponent { index, state: None, faulty_connections })
        });
        let components = components.collect::<Result<_>>()?;
        self.saved.push(Saved { components, signals: None });
        Ok(Snapshot(self.saved.len() - 1))
    }

    /// Saves a snapshot, over the one that was saved before.
    ///
    /// # Errors
    /// An FMU returns an error.
    pub fn save(&mut self, snapshot: Snapshot) -> Result<(), Box<RunError>> {
        let Saved { components, signals } = &mut self.saved[snapshot.0];
        for SavedComponent { index, state, faulty_connections } in components {
            self.components[*index].save(state)?;
            remember(faulty_connections, &self.faulty_connections[*index]);
        }
        if let Some((outputs, row)) = signals {
            outputs.copy_from(&self.outputs);
            row.time = self.row.time;
            row.store.copy_from(&self.row.store);
        }
        Ok(())
    }

    /// Returns to a snapshot, if it was saved.
    ///
    /// # Errors
    /// An FMU returns an error.
    pub fn restore(&mut self, snapshot: Snapshot) -> Result<(), Box<RunError>> {
        let Saved { components, signals } = &self.saved[snapshot.0];
        for SavedComponent { index, state, faulty_connections } in components {
            if let Some(state) = state {
                self.components[*index].restore(state)?;
                remember(&mut self.faulty_connections[*index], faulty_connections);
            }
        }
        if let Some((outputs, row)) = signals {
            self.outputs.copy_from(outputs);
            self.row.time = row.time;
            self.row.store.copy_from(&row.store);
        }
        Ok(())
    }

    /// Frees all snapshots.
    pub(super) fn forget_all(&mut self) {
        let saved = self.saved.drain(..).flat_map(|saved| saved.components);
        for SavedComponent { index, state, .. } in saved {
            // The instances are freed in any case.
            let _ = state.map(|state| self.components[index].forget(state));
        }
    }
}

fn remember(to: &mut [FaultyConnection], from: &[FaultyConnection]) {
    to.iter_mut().zip(from).for_each(|(to, from)| to.remember_as(from));
}
