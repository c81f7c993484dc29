//! The common interface of all models, with access to variables by value reference.

use std::any::Any;
use std::fmt;

use fmu_description::{Scalar as Row, ValueMut, Variable, guid};

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

/// A model whose variables are accessed by value reference.
pub(crate) trait Slave {
    /// Resets all values to their start values.
    fn reset(&mut self);
    /// Initializes a fresh model with the values that were set; nothing changes if it fails.
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError>;
    /// Number of scalar variables; their value references are 0 to `count() - 1`.
    fn count(&self) -> usize;
    /// The variable with the given value reference.
    fn find(&mut self, reference: u32) -> Option<Scalar<'_>>;

    /// The time derivative of an input, if the host may set it.
    fn input_derivative(&mut self, reference: u32) -> Option<&mut f64>;
    /// Sets all input derivatives to zero.
    fn clear_input_derivatives(&mut self);
    /// Whether derivatives of outputs with respect to inputs are known.
    fn has_directional_derivatives(&self) -> bool;
    /// The derivative of an output with respect to an input, which was held over the last step.
    fn derivative(&self, output: u32, input: u32) -> f64;

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
