//! Prints the model descriptions of a library for `cargo fmu export`.

use std::io::{self, Write};

use fmu_description::xml::Element;
use fmu_description::{Capability, Subject, describe as describe_table};

use crate::{Entry, Model, Variable, log};

/// The capabilities of this crate's C interface, some of which depend on the model's table.
fn capabilities<M: Model>() -> Vec<Capability> {
    let has = |feature: fn(&Variable<M>) -> bool| M::VARIABLES.iter().any(feature);
    let always = [
        Capability::CanHandleVariableCommunicationStepSize,
        // Memory comes from Rust's allocator, not from the host's callbacks.
        Capability::CanNotUseMemoryManagementFunctions,
        Capability::CanGetAndSetFMUstate,
        Capability::CanSerializeFMUstate,
    ];
    let interpolate =
        has(Variable::has_input_derivative).then_some(Capability::CanInterpolateInputs);
    let derivative = has(Variable::has_directional_derivatives)
        .then_some(Capability::ProvidesDirectionalDerivative);
    always
        .into_iter()
        .chain(interpolate)
        .chain(derivative)
        .collect()
}

/// The model description of the model `M`.
pub(crate) fn describe<M: Model>() -> Element<'static> {
    let subject = Subject {
        name: M::NAME,
        description: M::DESCRIPTION,
        version: env!("CARGO_PKG_VERSION"),
        license: env!("CARGO_PKG_LICENSE"),
        generation_tool: concat!("fmu-export ", env!("CARGO_PKG_VERSION")),
        capabilities: &capabilities::<M>(),
        default_experiment: M::DEFAULT_EXPERIMENT,
        log_categories: &log::categories(),
    };
    describe_table(&subject, M::VARIABLES)
}

/// Prints the `modelDescription.xml` of every model to standard output. This is all that `main` of a
/// library's `describe` program does.
///
/// # Errors
/// A description cannot be written.
pub fn print_descriptions(models: &[Entry]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    for model in models {
        let xml = (model.describe)().document().map_err(io::Error::other)?;
        out.write_all(xml.as_bytes())?;
    }
    out.flush()
}
