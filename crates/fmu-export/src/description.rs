//! The model descriptions of a library, printed for the exporter.

use std::io::{self, Write};

use fmu_description::xml::Element;
use fmu_description::{Capability, Subject, describe as describe_table};

use crate::{Entry, Model, Variable, log};

/// What the C interface of this crate can do, for every model or as its table says.
fn capabilities<M: Model>() -> Vec<Capability> {
    let has = |feature: fn(&Variable<M>) -> bool| M::VARIABLES.iter().any(feature);
    let always = [
        Capability::CanHandleVariableCommunicationStepSize,
        // Memory is Rust's; the host's callbacks are not used.
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

/// Prints the `modelDescription.xml` of every model to standard output, one after the other: the
/// whole `main` of the program by which a library describes itself to the exporter.
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
