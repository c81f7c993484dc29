//! The calls of a step in one: the host enters and leaves a component of `fmu-export` once instead of three times.

use std::ops::Range;

use fmi_abi::fmi3::{fmi3False, fmi3Status};
use wasmtime::{Error, Memory, Result, Store, TypedFunc};

use super::abi::{self, ARGUMENTS};
use super::link::Function;
use super::{Data, Instance};
use crate::quick::StepVariables;
use crate::types::StepResult;

/// Gets what stands for the instance and the place of a [`Cycle`]'s record, and returns a status.
pub(super) type Cycling = TypedFunc<(u32, u32), u32>;

/// The function, with a record of arguments and results in the component's memory. Values and value references follow it.
pub(super) struct Cycle {
    function: Cycling,
    memory: Memory,
    start: u32,
    /// The places of what is set and got in the lists of the host; `None` if there is no room for it in the component.
    places: Option<[Range<usize>; 2]>,
}

/// The size of the record, and the places in it: of the number of calls, the results of a step, and the lists.
const RECORD: usize = 72;
const CALLS: usize = 17;
const STEPPED: usize = 24;
const LISTS: [usize; 2] = [40, 56];

/// How many of the calls were made, the status of the last one, and what a step has returned.
pub(crate) type Cycled = (usize, fmi3Status, StepResult);

impl Cycle {
    /// `set` is a function that gets lists.
    pub(super) fn new(function: Cycling, set: &Function) -> Option<Self> {
        let start = set.arguments?.checked_add(ARGUMENTS as u32)?;
        Some(Self { function, memory: set.memory?, start, places: None })
    }

    fn bytes<'a>(&self, store: &'a mut Store<Data>) -> Result<&'a mut [u8; ARGUMENTS]> {
        let rest = self.memory.data_mut(store).get_mut(self.start as usize..);
        let bytes = rest.and_then(|rest| rest.first_chunk_mut());
        bytes.ok_or_else(|| Error::msg("its record of the calls of a step is out of bounds"))
    }

    /// Writes the lists of what is accessed; `None` if they do not fit.
    fn write_lists(
        &self,
        store: &mut Store<Data>,
        listed: [&StepVariables; 2],
    ) -> Option<[Range<usize>; 2]> {
        let memory = self.bytes(store).ok()?;
        let places = listed.map(StepVariables::place);
        let lengths = places.each_ref().map(Range::len);
        let (mut values, size) = (RECORD, size_of::<f64>());
        let mut references = values + size * lengths.iter().sum::<usize>();
        for ((listed, length), list) in listed.iter().zip(lengths).zip(LISTS) {
            let of = Vec::from_iter(listed.references().iter().flat_map(|r| r.to_le_bytes()));
            memory.get_mut(references..references + of.len())?.copy_from_slice(&of);
            let n = listed.references().len() as u32;
            let [first, to] = [references, values].map(|place| self.start + place as u32);
            let (words, _) = memory[list..].as_chunks_mut();
            words[..4].copy_from_slice(&[first, n, to, length as u32].map(u32::to_le_bytes));
            (references, values) = (references + of.len(), values + size * length);
        }
        Some(places)
    }
}

impl Instance {
    /// Says which variables every step sets and gets.
    pub(crate) fn access_at_steps(&mut self, set: &StepVariables, get: &StepVariables) {
        if let Some(cycle) = &mut self.cycle {
            cycle.places = cycle.write_lists(&mut self.store, [set, get]);
        }
    }

    /// Whether [`Instance::cycle`] is possible.
    pub(crate) fn has_cycle(&self) -> bool {
        self.cycle.as_ref().is_some_and(|cycle| cycle.places.is_some())
    }

    /// Sets variables, takes a step and gets variables, until a call is not plainly successful. Their limit of time is
    /// that of one call. `None` if nothing was called.
    pub(crate) fn cycle(
        &mut self,
        inputs: Option<&[f64]>,
        (time, step, no_set_state): (f64, f64, bool),
        outputs: &mut [f64],
    ) -> Option<Cycled> {
        let cycle = self.cycle.as_ref().filter(|_| !self.is_over)?;
        let [set, get] = cycle.places.clone()?;
        let given = inputs.unwrap_or(outputs).get(set)?;
        let memory = cycle.bytes(&mut self.store).ok()?;
        memory[..8].copy_from_slice(&time.to_le_bytes());
        memory[8..16].copy_from_slice(&step.to_le_bytes());
        memory[16] = no_set_state.into();
        let (values, _) = memory[RECORD..].as_chunks_mut();
        for (to, value) in values.iter_mut().zip(given) {
            *to = value.to_le_bytes();
        }
        let given = given.len();
        self.store.set_epoch_deadline(self.ticks);
        let called = cycle.function.call(&mut self.store, (self.handle, cycle.start));
        let memory = cycle.bytes(&mut self.store).ok()?;
        let calls = usize::from(memory[CALLS]).clamp(1, 3);
        if calls == 3 && matches!(called, Ok(0)) {
            let (values, _) = memory[RECORD..].as_chunks();
            for (to, value) in outputs.get_mut(get)?.iter_mut().zip(&values[given..]) {
                *to = f64::from_le_bytes(*value);
            }
        }
        let [last @ .., event, terminate, early] =
            memory[STEPPED..].first_chunk::<11>().copied().unwrap_or_default();
        let stepped = StepResult {
            event_handling_needed: event != fmi3False,
            terminate: terminate != fmi3False,
            early_return: early != fmi3False,
            last_successful_time: f64::from_le_bytes(last),
        };
        let status = called.and_then(abi::status).unwrap_or_else(|error| self.trapped(&error));
        Some((calls, status, stepped))
    }
}
