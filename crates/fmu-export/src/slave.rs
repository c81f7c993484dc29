//! The common interface of all models, with access to variables by value reference.

use std::any::Any;
use std::fmt;

use fmu_description::{Scalar as Row, ValueMut, Variability, Variable, guid};

use crate::ModelError;
use crate::model::Start;

/// A scalar variable of a slave.
pub(crate) struct Scalar<'a> {
    pub(crate) row: Row,
    pub(crate) value: ValueMut<'a>,
}

/// The name of a scalar variable, formatted on demand.
#[derive(Clone, Copy)]
pub(crate) struct Name(Row);

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.name())
    }
}

impl Scalar<'_> {
    pub(crate) fn name(&self) -> Name {
        Name(self.row)
    }

    pub(crate) fn variable(&self) -> &'static Variable {
        self.row.variable
    }
}

/// Numbers that a host integrates, or locates events with, in the order of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Numbers {
    States,
    Derivatives,
    Nominals,
    EventIndicators,
}

/// A model whose variables are accessed by value reference.
pub(crate) trait Slave {
    /// Resets all values to their start values.
    fn reset(&mut self);
    /// Initializes a fresh model with the values that were set; nothing changes if it fails.
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError>;
    /// Takes a step, see [`Simulate::step`](crate::Simulate::step), or the samples in it. Of a model that is
    /// integrated, time events in the step are handled if `handles_events`.
    fn step(&mut self, time: f64, step: f64, handles_events: bool) -> Result<(), ModelError>;
    /// The step size of the default experiment (s).
    fn default_step(&self) -> f64;
    /// Whether the model has a sample time.
    fn is_sampled(&self) -> bool;
    /// Whether the model has equations, see [`Continuous`](crate::Continuous).
    fn is_continuous(&self) -> bool;
    /// Computes derivatives, event indicators and outputs from states and inputs.
    fn evaluate(&mut self, time: f64) -> Result<(), ModelError>;
    /// Handles an event: takes the samples that are due. Returns whether states changed.
    fn event(&mut self, time: f64) -> Result<bool, ModelError>;
    /// The time of the next event, if it is known.
    fn next_event(&self, time: f64) -> Option<f64>;
    /// How many of these numbers there are.
    fn length(&self, of: Numbers) -> usize;
    /// Reads as many of these numbers as there are values.
    fn read(&mut self, which: Numbers, values: &mut [f64]);
    /// Sets the first states.
    fn set_states(&mut self, states: &[f64]);
    /// The value reference of the derivative of a state.
    fn derivative_of(&self, state: u32) -> Option<u32>;
    /// Number of scalar variables; their value references are 0 to `count() - 1`.
    fn count(&self) -> usize;
    /// Number of elements in use of the variable whose first element has the given value reference;
    /// `None` for other references.
    fn elements(&mut self, reference: u32) -> Option<usize>;
    /// Whether FMI 2.0 has the variable: it is no structural parameter, and an element in use of an array.
    fn is_in_fmi2(&mut self, reference: u32) -> bool;
    /// Whether there is a structural parameter that may be set in configuration mode, if `needed` is
    /// fixed, or in reconfiguration mode, if it is tunable.
    fn has_structural_parameter(&self, needed: Variability) -> bool;
    /// Called after structural parameters were set during the simulation.
    fn reconfigure(&mut self) -> Result<(), ModelError>;
    /// The variable with the given value reference.
    fn find(&mut self, reference: u32) -> Option<Scalar<'_>>;

    /// The time derivative of an input, if the host may set it.
    fn input_derivative(&mut self, reference: u32) -> Option<&mut f64>;
    /// Sets all input derivatives to zero.
    fn clear_input_derivatives(&mut self);
    /// Whether any derivatives of variables with respect to others are known.
    fn has_directional_derivatives(&self) -> bool;
    /// The derivative of a variable with respect to an input or a state, see
    /// [`Variables::directional_derivative`](crate::Variables::directional_derivative).
    fn derivative(&self, unknown: u32, known: u32) -> f64;

    /// The GUID of the model's interface.
    fn guid(&self) -> Guid;
    /// A copy of the model.
    fn save(&self) -> Box<dyn Any>;
    /// Restores a copy; false if it is a copy of another model.
    fn restore(&mut self, saved: &dyn Any) -> bool;
    /// Serializes a copy; `None` if it is a copy of another model, or cannot be serialized.
    fn serialize(&self, saved: &dyn Any) -> Option<Vec<u8>>;
    /// Deserializes a copy; `None` if the bytes are not exactly one copy.
    fn deserialize(&self, bytes: &[u8]) -> Option<Box<dyn Any>>;
}

/// A GUID as text.
pub(crate) type Guid = [u8; guid::LENGTH];
