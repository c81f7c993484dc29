//! The calls of a step in one: the host enters and leaves a component of `fmu-export` once instead of three times.

use std::ops::Range;

use fmi_abi::fmi3::{fmi3False, fmi3Status};
use wasmtime::{Error, Memory, Result, Store};

use super::abi::{self, ARGUMENTS, ComponentFunction};
use super::host_state::HostState;
use super::link::CycleFunction;
use crate::quick::StepVariables;
use crate::types::StepResult;

/// The function, with a record of arguments and results in the component's memory. Values and value references follow it.
pub(super) struct Cycle {
    function: CycleFunction,
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

impl Cycle {
    /// `set` is a function that gets lists.
    pub(super) fn new(function: CycleFunction, set: &ComponentFunction) -> Option<Self> {
        let start = set.arguments?.checked_add(ARGUMENTS as u32)?;
        Some(Self { function, memory: set.memory?, start, places: None })
    }

    fn bytes<'a>(&self, store: &'a mut Store<HostState>) -> Result<&'a mut [u8; ARGUMENTS]> {
        let rest = self.memory.data_mut(store).get_mut(self.start as usize..);
        let bytes = rest.and_then(|rest| rest.first_chunk_mut());
        bytes.ok_or_else(|| Error::msg("its record of the calls of a step is out of bounds"))
    }

    /// Writes the lists of what is accessed; `None` if they do not fit.
    fn write_lists(
        &self,
        store: &mut Store<HostState>,
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

    /// Says which variables every step sets and gets.
    pub(super) fn set_lists(&mut self, store: &mut Store<HostState>, listed: [&StepVariables; 2]) {
        self.places = self.write_lists(store, listed);
    }

    /// Whether the component has room for the lists of the host.
    pub(super) fn is_ready(&self) -> bool {
        self.places.is_some()
    }

    /// Sets variables, takes a step and gets variables, until a call is not plainly successful. Returns how many of the
    /// calls were made, the status of the last one, and the results of the step; `None` if nothing was called.
    #[inline]
    pub(super) fn call(
        &self,
        store: &mut Store<HostState>,
        handle: u32,
        inputs: Option<&[f64]>,
        (time, step, no_set_state): (f64, f64, bool),
        outputs: &mut [f64],
    ) -> Option<(usize, Result<fmi3Status>, StepResult)> {
        let [set, get] = self.places.clone()?;
        let values_to_set = inputs.unwrap_or(outputs).get(set)?;
        let memory = self.bytes(store).ok()?;
        memory[..8].copy_from_slice(&time.to_le_bytes());
        memory[8..16].copy_from_slice(&step.to_le_bytes());
        memory[16] = no_set_state.into();
        let (values, _) = memory[RECORD..].as_chunks_mut();
        for (to, value) in values.iter_mut().zip(values_to_set) {
            *to = value.to_le_bytes();
        }
        let n_set = values_to_set.len();
        let called = self.function.call(&mut *store, (handle, self.start));
        let memory = self.bytes(store).ok()?;
        let calls = usize::from(memory[CALLS]).clamp(1, 3);
        if calls == 3 && matches!(called, Ok(0)) {
            let (values, _) = memory[RECORD..].as_chunks();
            for (to, value) in outputs.get_mut(get)?.iter_mut().zip(&values[n_set..]) {
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
        Some((calls, called.and_then(abi::status), stepped))
    }
}
