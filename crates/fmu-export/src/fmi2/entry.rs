//! The models of a library, from which `fmi2Instantiate` selects one.

use fmu_description::guid::guid;
use fmu_description::table::check;
use fmu_description::{Interface, Overrides};

use super::{fmi2Component, instance};
use crate::Simulate;
use crate::bound::Bound;
use crate::component::Component;
use crate::log::Log;
use crate::resources::Folder;
use crate::slave::Guid;

/// A model of a library, before it is instantiated.
pub struct Entry {
    name: &'static str,
    /// Start values of a variant.
    overrides: Overrides,
    pub(crate) guid: Guid,
    create: fn(&'static Self, Log, Folder) -> fmi2Component,
    /// The copy of the interface for the exporter, which must not be removed by the linker.
    _embedded: &'static [u8],
}

/// The interface of the model `M` with `N` scalar variables, or of a variant of it; see
/// [`Overrides::of`]. An invalid table fails the compilation here.
pub const fn interface<M: Simulate, const N: usize>(variant: Option<&'static str>) -> Interface {
    let scalars = Bound::<M, N>::ROWS;
    check(scalars);
    let variant = match variant {
        Some(text) => Overrides::of(M::NAME, text),
        None => None,
    };
    let (name, overrides) = match variant {
        Some((name, overrides)) => (name, overrides),
        None => (M::NAME, Overrides::NONE),
    };
    Interface {
        name,
        description: M::DESCRIPTION,
        is_sampled: M::IS_SAMPLED,
        default_experiment: M::DEFAULT_EXPERIMENT,
        tolerance: M::TOLERANCE,
        scalars,
        overrides,
    }
}

impl Entry {
    /// The entry of the model `M` with `N` scalar variables.
    ///
    /// An array of this length can be declared only where `M` is known, which is where
    /// [`export!`](crate::export) is used.
    pub const fn of<M: Simulate, const N: usize>(
        interface: Interface,
        embedded: &'static [u8],
    ) -> Self {
        Self {
            name: interface.name,
            overrides: interface.overrides,
            guid: guid(&interface),
            create: |entry, log, resources| {
                instance::create(Component::new(log, resources, Bound::<M, N>::new(entry)))
            },
            _embedded: embedded,
        }
    }

    /// Name of the model.
    pub fn name(&self) -> &str {
        self.name
    }

    /// The GUID of the model's interface.
    pub fn guid(&self) -> &str {
        std::str::from_utf8(&self.guid).unwrap_or_default()
    }

    pub(crate) fn overrides(&self) -> Overrides {
        self.overrides
    }

    pub(super) fn create(&'static self, log: Log, resources: Folder) -> fmi2Component {
        (self.create)(self, log, resources)
    }
}
