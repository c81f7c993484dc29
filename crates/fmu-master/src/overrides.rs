//! Overrides: the options of the command line and the arguments of Python that replace parts of a description.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use fmu_host::InterfaceType;
use serde::{Deserialize, Serialize};

use crate::given_inputs::GivenInputs;
use crate::{
    AlgebraicLoops, Compilation, Description, Execution, Experiment, Literal, Observation, Order,
    Sandbox, Solver,
};

/// What the user changes of a description, by default nothing; the options of `cargo fmu simulate`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, Args)]
pub struct Overrides {
    /// Set a start value (for an enumeration, the name of an item); may be repeated. An FMU without system file
    /// has no COMPONENT
    #[arg(long = "set", value_name = "COMPONENT.VARIABLE=VALUE", value_parser = assignment)]
    pub sets: Vec<(String, Literal)>,
    /// Use a parameter set that the FMU has, by its name, or that of a file
    #[arg(long, value_name = "NAME or FILE.ssv")]
    pub parameters: Option<String>,
    /// Perform an experiment that the FMU has, with its times, parameters and inputs
    #[arg(long, value_name = "NAME")]
    pub experiment: Option<String>,
    /// Start time in s
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub start: Option<f64>,
    /// Stop time, the last recorded communication point, in s
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub stop: Option<f64>,
    /// Communication step size in s
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    pub step: Option<f64>,
    /// Time between two recorded rows in s, a multiple of the communication step [default: the communication step]
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    pub output_step: Option<f64>,
    /// Relative tolerance of all components
    #[arg(long, value_name = "TOLERANCE")]
    pub tolerance: Option<f64>,
    /// Method by which the equations of model exchange are integrated [default: explicit]
    #[arg(long)]
    pub solver: Option<Solver>,
    /// How to run the FMUs [default: by co-simulation, if they support it]
    #[arg(long, value_parser = interface_type())]
    pub interface: Option<InterfaceType>,
    /// Handle the events of FMUs for FMI 3.0 in event mode, or have them do it themselves [default: if they have clocks]
    #[arg(long)]
    pub event_mode: Option<bool>,
    /// Record all components after each step, or before it [default: after it if all outputs are discrete, except
    /// one FMU without a system file]
    #[arg(long)]
    pub sampled: Option<bool>,
    /// Order of stepping
    #[arg(long)]
    pub order: Option<Order>,
    /// How algebraic loops are handled [default: refuse]
    #[arg(long, value_name = "HOW")]
    pub algebraic_loops: Option<AlgebraicLoops>,
    /// Relative tolerance of loops that are iterated [default: 1e-6]
    #[arg(long, value_name = "TOLERANCE")]
    pub loop_tolerance: Option<f64>,
    /// Maximum number of iterations of a loop in a step [default: 50]
    #[arg(long, value_name = "COUNT")]
    pub loop_iterations: Option<u32>,
    /// Divide each communication step so that its estimated relative error is at most this
    #[arg(long, value_name = "TOLERANCE")]
    pub step_tolerance: Option<f64>,
    /// Smallest step with --step-tolerance in s [default: a millionth of the communication step]
    #[arg(long, value_name = "H")]
    pub min_step: Option<f64>,
    /// Variable to record; may be repeated
    #[arg(long = "output", value_name = "COMPONENT.VARIABLE")]
    pub outputs: Vec<String>,
    /// CSV or Parquet file with values of inputs and tunable parameters: a column time in s, and one for each of them
    #[arg(long, value_name = "FILE")]
    pub input: Option<PathBuf>,
    /// Values of inputs, with which there is no file.
    #[arg(skip)]
    pub given_inputs: Option<GivenInputs>,
    /// Save the state of the run at the stop time to this file
    #[arg(long, value_name = "FILE")]
    pub save_state: Option<PathBuf>,
    /// Begin from the state in this file, at its time, instead of an initialization
    #[arg(long, value_name = "FILE", conflicts_with = "start")]
    pub load_state: Option<PathBuf>,
    /// Folder of the FMUs [default: as in the system file]
    #[arg(long, value_name = "DIR")]
    pub fmus: Option<PathBuf>,
    /// How the run is executed.
    #[command(flatten)]
    pub execution: Execution,
    /// What is observed of the calls.
    #[command(flatten)]
    pub observation: Observation,
    /// How WebAssembly components run.
    #[arg(skip)]
    pub sandbox: Sandbox,
    /// Whether FMUs are compiled.
    #[arg(skip)]
    pub compilation: Compilation,
}

impl Overrides {
    /// Applies the overrides to a description, except for the start values, which need the FMUs.
    ///
    /// # Errors
    /// The FMU has no such experiment, or the system more than one FMU.
    pub fn apply(&self, description: &mut Description) -> Result<()> {
        if let Some(experiment) = &self.experiment {
            description.take_experiment(experiment)?;
        }
        if let Some(parameters) = &self.parameters {
            ensure!(
                description.is_single,
                "the parameter set {parameters:?} belongs to one FMU, but this is a system; expected the key parameters of its components"
            );
            let components = description.components.iter_mut();
            components.for_each(|component| component.parameters = Some(parameters.clone()));
        }
        description.sandbox = self.sandbox;
        description.compilation = self.compilation.clone();
        description.execution = self.execution.clone();
        description.start = self.start.unwrap_or(description.start);
        description.stop = self.stop.unwrap_or(description.stop);
        description.is_step_derived &= self.step.is_none();
        description.step = self.step.unwrap_or(description.step);
        let (start, stop) = (description.start, description.stop);
        if description.is_step_derived && description.step > stop - start && stop > start {
            description.step = Experiment::derived_step(start, stop);
        }
        description.output_step = self.output_step.or(description.output_step);
        description.event_mode = self.event_mode.or(description.event_mode);
        description.order = self.order.unwrap_or(description.order);
        if self.algebraic_loops.is_some() {
            description.algebraic_loops = self.algebraic_loops;
            description.allow_algebraic_loops = false;
        }
        description.loop_tolerance = self.loop_tolerance.or(description.loop_tolerance);
        description.loop_iterations = self.loop_iterations.or(description.loop_iterations);
        description.step_tolerance = self.step_tolerance.or(description.step_tolerance);
        description.min_step = self.min_step.or(description.min_step);
        description.tolerance = self.tolerance.or(description.tolerance);
        description.solver = self.solver.or(description.solver);
        for component in &mut description.components {
            component.sampled = self.sampled.or(component.sampled);
            component.interface = self.interface.or(component.interface);
            component.tolerance = component.tolerance.filter(|_| self.tolerance.is_none());
            component.solver = component.solver.filter(|_| self.solver.is_none());
        }
        if !self.outputs.is_empty() {
            description.outputs.clone_from(&self.outputs);
        }
        if self.input.is_some() || self.given_inputs.is_some() {
            description.input.clone_from(&self.input);
            description.given_inputs.clone_from(&self.given_inputs);
        }
        description.save_state.clone_from(&self.save_state);
        description.load_state.clone_from(&self.load_state);
        if let Some(folder) = &self.fmus {
            description.take_fmus_from(folder);
        }
        Ok(())
    }
}

/// Reads an interface type from a command line.
fn interface_type() -> impl TypedValueParser<Value = InterfaceType> {
    let known = [
        PossibleValue::new("co-simulation").help("The FMU computes each step"),
        PossibleValue::new("model-exchange").help("The equations of the FMU are integrated"),
        PossibleValue::new("scheduled-execution")
            .help("The model partitions of the FMU are activated"),
    ];
    PossibleValuesParser::new(known).map(|name| InterfaceType::named(&name).unwrap_or_default())
}

/// Parses `COMPONENT.VARIABLE=VALUE`.
///
/// # Errors
/// There is no equals sign.
pub fn assignment(text: &str) -> Result<(String, Literal)> {
    let (mut is_quoted, mut last) = (false, '.');
    let end = text.find(|c| {
        // An apostrophe within a part of a name is no quote.
        is_quoted ^= c == '\'' && (is_quoted || last == '.');
        last = c;
        c == '=' && !is_quoted
    });
    let end = end
        .or_else(|| text.find('='))
        .context("expected COMPONENT.VARIABLE=VALUE, such as controller.pid.kp=250")?;
    Ok((text[..end].to_owned(), Literal::Text(text[end + 1..].to_owned())))
}

#[cfg(test)]
mod tests {
    use super::{Literal, assignment};

    #[test]
    fn a_value_follows_the_first_equals_sign_outside_a_quoted_name() {
        let pair = |name: &str, value: &str| (name.to_owned(), Literal::Text(value.to_owned()));
        assert_eq!(assignment("p.'a=b'=1").unwrap(), pair("p.'a=b'", "1"));
        assert_eq!(assignment("p.text=a=b").unwrap(), pair("p.text", "a=b"));
        assert_eq!(assignment("p.it's=1").unwrap(), pair("p.it's", "1"));
        assert_eq!(assignment("p.it's=a'b=c").unwrap(), pair("p.it's", "a'b=c"));
        assert!(assignment("p.'a'").is_err());
    }
}
