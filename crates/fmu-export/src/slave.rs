//! A model behind one interface for all: its values by reference, start values, steps.

use std::any::Any;
use std::fmt;

use fmu_description::{Info, Place, check, guid};

use crate::bound::Bound;
use crate::component::Component;
use crate::fmi2::Instance;
use crate::log::Log;
use crate::{Model, ModelError};

/// A model of a library, before it is instantiated.
#[derive(Clone, Copy)]
pub struct Entry {
    /// Its name.
    pub name: &'static str,
    guid: Guid,
    create: fn(Log) -> Box<dyn Instance>,
    #[cfg(feature = "describe")]
    pub(crate) describe: fn() -> fmu_description::schema::ModelDescription,
}

impl Entry {
    /// The entry of the model `M`. A wrong table stops the compilation here.
    ///
    /// `N` is [`scalars`] of `M`: a table of this length can be made only where `M` is known, which
    /// is where [`export!`](crate::export) is used.
    #[doc(hidden)]
    pub const fn of<M: Model, const N: usize>() -> Self {
        check(M::VARIABLES);
        Self {
            name: M::NAME,
            guid: Bound::<M, N>::GUID,
            create: |log| Box::new(Component::new(log, Bound::<M, N>::new())),
            #[cfg(feature = "describe")]
            describe: crate::description::describe::<M>,
        }
    }

    /// The GUID of the model's interface.
    pub fn guid(&self) -> &str {
        std::str::from_utf8(&self.guid).unwrap_or_default()
    }

    pub(crate) fn create(&self, log: Log) -> Box<dyn Instance> {
        (self.create)(log)
    }
}

/// A scalar variable of a slave.
pub(crate) struct Scalar<'a> {
    pub(crate) info: &'static Info,
    /// Index in the array, from 0.
    pub(crate) element: usize,
    pub(crate) place: Place<'a>,
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

    /// Where the time derivative of an input lives, if the host may give it.
    fn slope(&mut self, reference: u32) -> Option<&mut f64>;
    /// Sets all time derivatives of inputs to zero.
    fn clear_slopes(&mut self);
    /// Whether derivatives of outputs by inputs are known.
    fn has_sensitivities(&self) -> bool;
    /// The derivative of an output by an input, as it was held over the last step.
    fn sensitivity(&self, output: u32, input: u32) -> f64;

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
