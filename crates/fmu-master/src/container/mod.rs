//! A system as one FMU: a container, with the master inside, whose resources have the system file and its FMUs.
//!
//! [`Interface`] chooses the variables of the container from a [`Plan`], when it is packed and again when it
//! is instantiated, so that model description and binary cannot drift apart: the GUID is a hash of the interface.
//! [`Contents`] has the files that are packed. A [`Container`] is an instance; the crate `fmu-container` exports it through
//! the functions of FMI.

pub(crate) mod choice;
mod contents;
mod instance;
mod interface;
mod text;

pub use contents::Contents;
pub use instance::{Container, Failure, SavedContainer, Severity, Stepped};
pub use interface::Interface;

use std::path::Path;
use std::sync::Arc;

use crate::package::SystemOrigin;
use crate::{Description, Plan};

/// The system file of a container, in its resources.
pub const SYSTEM_FILE: &str = "system.toml";

/// The description of a system as it is in a container.
pub(crate) fn in_container(mut description: Description) -> Description {
    description.is_in_container = true;
    if !description.expose.outputs.is_empty() {
        description.outputs.clone_from(&description.expose.outputs);
    }
    // The names of components have dots if the system comes from a package of nested systems.
    description.package.get_or_insert_with(|| Arc::new(SystemOrigin::default()));
    description
}

/// The system in the resources of a container.
fn read(resources: &Path) -> anyhow::Result<(Description, Plan)> {
    let description = in_container(Description::read(&resources.join(SYSTEM_FILE))?);
    let plan = Plan::new(&description)?;
    Ok((description, plan))
}
