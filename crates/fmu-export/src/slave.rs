//! A model behind one interface for all: its values by reference, start values, steps.

use std::any::Any;
use std::fmt;

use fmu_description::{Info, ValueMut, guid};

use crate::ModelError;

/// A scalar variable of a slave.
pub(crate) struct Scalar<'a> {
    pub(crate) info: &'static Info,
    /// Index in the array, from 0.
    pub(crate) element: usize,
    pub(crate) value: ValueMut<'a>,
}

/// The name of a scalar variable, which is put together when it is shown.
#[derive(Clone, Copy)]
pub(crate) struct Name(&'static Info, usize);

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.element_name(self.1))
    }
}

impl Scalar<'_> {
    pub(crate) fn name(&self) -> Name {
        Name(self.info, self.element)
    }
}

/// A model whose values are reached by value reference.
pub(crate) trait Slave {
    /// Back to start values.
    fn reset(&mut self);
    /// See [`Model::initialize`].
    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError>;
    /// Number of scalar variables; their value references are 0 to one less.
    fn count(&self) -> usize;
    /// The variable of a value reference.
    fn find(&mut self, reference: u32) -> Option<Scalar<'_>>;

    /// The time derivative of an input, if the host may set it.
    fn input_derivative(&mut self, reference: u32) -> Option<&mut f64>;
    /// Sets all input derivatives to zero.
    fn clear_input_derivatives(&mut self);
    /// Whether derivatives of outputs with respect to inputs are known.
    fn has_directional_derivatives(&self) -> bool;
    /// The derivative of an output with respect to an input, as it was held over the last step.
    fn derivative(&self, output: u32, input: u32) -> f64;

    /// The GUID of the model's interface.
    fn guid(&self) -> Guid;
    /// A copy of the model.
    fn save(&self) -> Box<dyn Any>;
    /// Takes over a copy; false if it is one of another model.
    fn restore(&mut self, saved: &dyn Any) -> bool;
    /// The bytes of a copy; none if it is one of another model.
    fn serialize(&self, saved: &dyn Any) -> Option<Vec<u8>>;
    /// The copy that the bytes hold, if they hold one and nothing else.
    fn deserialize(&self, bytes: &[u8]) -> Option<Box<dyn Any>>;
}

/// A GUID as text.
pub(crate) type Guid = [u8; guid::LENGTH];
