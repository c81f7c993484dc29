//! A run whose inputs, parameters and steps a host decides, as that of a container.

use fmu_description::Value;

use super::Simulation;
use crate::Place;
use crate::access_list::{AccessList, accessor};
use crate::component_instance::CallResult;
use crate::components::ScalarId;
use crate::start::ComponentStarts;
use crate::wiring::ClockedColumn;

impl Simulation<'_> {
    /// Initializes until values can be read, with the stop time of the experiment if it `has_stop`.
    pub(crate) fn begin_initialization(
        &mut self,
        starts: &[ComponentStarts<'_>],
        has_stop: bool,
    ) -> CallResult {
        self.enter_initialization(starts, has_stop)?;
        self.take_row(self.plan.experiment.start)
    }

    /// Passes changed inputs and outputs on, during the initialization.
    pub(crate) fn initialize_again(&mut self) -> CallResult {
        self.propagate()?;
        self.take_row(self.plan.experiment.start)
    }

    /// Ends the initialization.
    pub(crate) fn end_initialization(&mut self, starts: &[ComponentStarts<'_>]) -> CallResult {
        self.exit_initialization(starts)?;
        let start = self.plan.experiment.start;
        self.take_row(start).map_err(|failure| failure.at(start))
    }

    /// Reads all outputs, into the row, too.
    fn take_row(&mut self, time: f64) -> CallResult {
        self.read_all::<false>()?;
        self.record(time);
        Ok(())
    }

    fn record(&mut self, time: f64) {
        let wiring = &self.plan.wiring;
        self.row.time = time;
        self.row.store.record::<false>(&wiring.recorded_before, &self.outputs);
        self.row.store.record::<false>(&wiring.recorded_after, &self.outputs);
        self.row.store.record::<false>(&wiring.recorded_at_ticks, &self.outputs);
        // A host sees what has ticked last.
        for ClockedColumn { from, to, .. } in &wiring.clocked_columns {
            self.row.store.others[*to] = Some(self.outputs.value(*from));
        }
    }

    /// Takes the step from communication point `k`.
    pub(crate) fn step_from(&mut self, k: u64) -> CallResult {
        let (plan, step) = (self.plan, self.plan.experiment.step);
        let time = plan.experiment.time(k);
        self.messages.record().at(time);
        self.feed(time).map_err(|failure| failure.at(time))?;
        let stepped = match self.is_plain() {
            true => self.step_plainly(time, step),
            false => self.advance(k, time, step),
        };
        stepped.map_err(|failure| failure.at(time))?;
        self.record(plan.experiment.time(k + 1));
        Ok(())
    }

    /// Ends the run.
    pub(crate) fn terminate(&mut self) -> CallResult {
        self.call_all("terminate", "end", fmu_host::Instance::terminate)
    }

    /// The value of an input that the host sets.
    pub(crate) fn input(&self, place: Place) -> Value {
        self.outputs.value(place)
    }

    /// Sets an input, for the next step.
    pub(crate) fn set_input(&mut self, place: Place, value: Value) {
        self.outputs.set(place, value);
    }

    /// Sets a parameter to the value that `starts` have for it, with all elements of its array.
    pub(crate) fn set_parameter(
        &mut self,
        id: ScalarId,
        starts: &ComponentStarts<'_>,
    ) -> CallResult {
        let fmu = self.components[id.component].fmu.clone();
        let access_type = fmu.access_type(id.scalar);
        let list = AccessList::new(&fmu, [id.scalar]);
        let values = starts.initial(&list, &fmu);
        let set = accessor("set", fmu.version, access_type);
        self.components[id.component].set(access_type, set, &list, &values)
    }

    /// The values that were recorded last.
    pub(crate) fn row(&self) -> &super::Row {
        &self.row
    }

    /// Whether an FMU must not be called any more, because of a fatal error.
    pub(crate) fn is_lost(&self) -> bool {
        self.plan.components.iter().any(|component| component.fmu.is_lost())
    }
}
