//! The functions of `export!`, for a type that stands for its model: the compiler then checks once whether that is a
//! model, and reports it once if it is none.

use fmu_description::Interface;

use crate::entry::{self, Entry};
use crate::model::Model;

/// A type that stands for a model.
pub trait Exported {
    /// The model.
    type Model: Model;
}

/// The size of its tables.
pub const fn table_size<E: Exported>() -> usize {
    crate::table_size::<E::Model>()
}

/// Its interface, with the variant and the naming that the exporter passes.
pub const fn interface<E: Exported, const N: usize>(
    variant: Option<&'static str>,
    naming: Option<&str>,
) -> Interface {
    entry::interface::<E::Model, N>(variant).named(naming, E::Model::NAMING)
}

/// Its entry.
pub const fn entry<E: Exported, const N: usize>(
    interface: Interface,
    embedded: &'static [u8],
) -> Entry {
    Entry::new::<E::Model, N>(interface, embedded)
}
