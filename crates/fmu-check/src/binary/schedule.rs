//! The clocks of the FMU under test, and when they tick in a run.

use std::collections::{HashMap, HashSet};

use fmu_description::{
    Causality, ClockType, IntervalVariability, ModelDescription, Type, XmlVariable,
};

use crate::binary::excitation::{Input, clocked_inputs};
use crate::binary::observed::Row;

/// The clocks of a model, and the variables that the host sets when they tick.
pub struct Clocks<'a> {
    /// Input clocks, each of which has a model partition in scheduled execution.
    pub inputs: Vec<&'a XmlVariable<'a>>,
    /// Output clocks.
    pub outputs: Vec<&'a XmlVariable<'a>>,
    /// Clocked inputs.
    pub clocked: Vec<Input<'a>>,
}

/// When the clocks of a run tick, and what was read when they did.
#[derive(Debug, Clone, Default)]
pub struct Schedule {
    /// When each input clock ticks next (s), if that is known.
    pub next: Vec<Option<f64>>,
    /// The interval of each periodic input clock (s).
    pub intervals: Vec<f64>,
    /// In scheduled execution, when partitions were activated last (s), by the indices of their clocks.
    pub activated: HashMap<usize, f64>,
    /// The values of the clocked variables, each as it was read at the last tick of one of its clocks.
    pub held: Row,
    /// The output clocks that have ticked, by their value references.
    pub ticked: HashSet<u32>,
    /// The clocked variables that were read at a tick, by their value references.
    pub read: HashSet<u32>,
    /// The clocks that have told an interval, by their value references.
    pub told: HashSet<u32>,
}

impl<'a> Clocks<'a> {
    pub fn new(model: &'a ModelDescription<'a>) -> Self {
        let of = |causality| {
            let clocks = model.variables().map(|(_, v)| v);
            clocks.filter(move |v| v.of_type == Type::Clock && v.causality == causality).collect()
        };
        Self {
            inputs: of(Causality::Input),
            outputs: of(Causality::Output),
            clocked: clocked_inputs(model),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty() && self.outputs.is_empty()
    }
}

/// The type of a clock.
pub fn clock_type(clock: &XmlVariable<'_>) -> ClockType {
    clock.clock.unwrap_or_default()
}

/// Whether the host triggers a clock.
pub fn is_triggered(clock: &XmlVariable<'_>) -> bool {
    !kind(clock).is_time_based()
}

/// The kind of a clock.
pub fn kind(clock: &XmlVariable<'_>) -> IntervalVariability {
    clock_type(clock).interval_variability
}

/// Whether a variable may be accessed while some clocks are active.
pub fn is_active(variable: &XmlVariable<'_>, active: &[u32]) -> bool {
    variable.clocks.iter().any(|clock| active.contains(clock))
}
