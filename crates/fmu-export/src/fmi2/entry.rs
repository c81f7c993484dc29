//! The models of a library, from which `fmi2Instantiate` selects one.

use fmu_description::check;

use super::Instance;
use crate::Model;
use crate::bound::Bound;
use crate::component::Component;
use crate::log::Log;
use crate::slave::Guid;

/// A model of a library, before it is instantiated.
#[derive(Clone, Copy)]
pub struct Entry {
    /// Its name.
    pub name: &'static str,
    guid: Guid,
    create: fn(Log) -> Box<dyn Instance>,
    #[cfg(feature = "describe")]
    pub(crate) describe: fn() -> fmu_description::xml::Element<'static>,
}

impl Entry {
    /// The entry of the model `M`. An invalid table fails the compilation here.
    ///
    /// `N` is [`scalars`](crate::scalars) of `M`. An array of this length can be declared only where
    /// `M` is known, which is where [`export!`](crate::export) is used.
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

    pub(super) fn create(&self, log: Log) -> Box<dyn Instance> {
        (self.create)(log)
    }
}
