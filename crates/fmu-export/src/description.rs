//! The model descriptions of a library, printed for the exporter.

use std::io::{self, Write};

use fmu_description::schema::{CoSimulation, ModelDescription};
use fmu_description::{Subject, describe as describe_table};

use crate::{Entry, Model, Variable, log};

/// What the C interface of this crate can do, for every model or as its table says.
fn capabilities<M: Model>() -> CoSimulation {
    CoSimulation {
        can_handle_variable_communication_step_size: true,
        can_interpolate_inputs: M::VARIABLES.iter().any(Variable::has_slope),
        // Memory is Rust's; the host's callbacks are not used.
        can_not_use_memory_management_functions: true,
        can_get_and_set_fmu_state: true,
        can_serialize_fmu_state: true,
        provides_directional_derivative: M::VARIABLES.iter().any(Variable::has_sensitivities),
        ..CoSimulation::default()
    }
}

/// The model description of the model `M`.
pub(crate) fn describe<M: Model>() -> ModelDescription {
    let subject = Subject {
        name: M::NAME,
        description: M::DESCRIPTION,
        version: env!("CARGO_PKG_VERSION"),
        license: env!("CARGO_PKG_LICENSE"),
        generation_tool: concat!("fmu-export ", env!("CARGO_PKG_VERSION")),
        default_experiment: M::DEFAULT_EXPERIMENT,
        log_categories: &log::categories(),
    };
    describe_table(&subject, capabilities::<M>(), M::VARIABLES)
}

/// Prints the `modelDescription.xml` of every model to standard output, one after the other: the
/// whole `main` of the program by which a library describes itself to the exporter.
///
/// # Errors
/// A description cannot be written.
pub fn print_descriptions(models: &[Entry]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    for model in models {
        let xml = (model.describe)().to_xml().map_err(io::Error::other)?;
        out.write_all(xml.as_bytes())?;
    }
    out.flush()
}
