//! The description of a system: components, connections, order, experiment, start values.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Error, Result, anyhow, ensure};
use clap::ValueEnum;
use fmu_description::Value;
use fmu_host::InterfaceType;
use serde::{Deserialize, Serialize};

use crate::expose::Expose;
use crate::fault::{Amount, Fault};
use crate::function::Computed;
use crate::given_inputs::GivenInputs;
use crate::package::SystemOrigin;
use crate::rate::{ComponentStep, Inputs};
use crate::{Compilation, Execution, Experiment, Function, Literal, Signature, Solver, Stimuli};

/// A system of coupled FMUs.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// The first communication point (s); 0 by default.
    #[serde(default)]
    pub start: f64,
    /// The last communication point that is recorded (s).
    pub stop: f64,
    /// The communication step (s).
    pub step: f64,
    /// The time between two recorded rows (s), a multiple of the communication step, which it is by default.
    pub output_step: Option<f64>,
    /// Order of stepping; sequential by default.
    #[serde(default)]
    pub order: Order,
    /// Whether sequential stepping is allowed although outputs depend directly on each other.
    #[serde(default)]
    pub allow_algebraic_loops: bool,
    /// How algebraic loops are handled, in sequential order; by default, they are refused.
    pub algebraic_loops: Option<AlgebraicLoops>,
    /// The relative tolerance of loops that are iterated; 1e-6 by default.
    pub loop_tolerance: Option<f64>,
    /// The largest number of iterations of a loop in one step; 50 by default.
    pub loop_iterations: Option<u32>,
    /// The relative error that is allowed in a communication step, which is then divided; by default, it is not.
    pub step_tolerance: Option<f64>,
    /// The smallest step into which it is divided (s); a millionth of it by default.
    pub min_step: Option<f64>,
    /// The relative tolerance of all components that have none of their own; by default, the tolerance of the
    /// default experiment of each FMU.
    pub tolerance: Option<f64>,
    /// The method by which the equations of components of model exchange are integrated, if they have none of their own;
    /// explicit by default.
    pub solver: Option<Solver>,
    /// The components, in the order in which sequential stepping takes them.
    #[serde(rename = "component")]
    pub components: Vec<Component>,
    /// Which output feeds which input.
    #[serde(default)]
    pub connections: Vec<Connection>,
    /// The seed of faults with random numbers.
    #[serde(default)]
    pub seed: u64,
    /// Variables to record, `component.variable`; by default all outputs except Strings
    /// and Binaries.
    #[serde(default)]
    pub outputs: Vec<String>,
    /// A CSV or Parquet file with values of inputs over time, relative to the folder of the system file.
    pub input: Option<PathBuf>,
    /// How a run is executed.
    #[serde(skip)]
    pub execution: Execution,
    /// What a container of the system exposes.
    #[serde(default)]
    pub expose: Expose,
    /// Whether it is in a container, whose host sets the inputs that nothing else feeds.
    #[serde(skip)]
    pub is_in_container: bool,
    /// Values of inputs over time, if there is no file.
    #[serde(skip)]
    pub given_inputs: Option<GivenInputs>,
    /// Whether the step follows from the stop time, because neither an FMU nor its user gives one.
    #[serde(skip)]
    pub is_step_derived: bool,
    /// The file to which the state of a run is saved at the stop time.
    #[serde(skip)]
    pub save_state: Option<PathBuf>,
    /// The file with the saved state from which a run begins.
    #[serde(skip)]
    pub load_state: Option<PathBuf>,
    /// Values of inputs over time in an FMU, if there are no others.
    #[serde(skip)]
    pub stimuli: Option<Stimuli>,
    /// Whether the only component is an FMU without a system file, whose variables have no prefix.
    #[serde(skip)]
    pub is_single: bool,
    /// Whether the master handles the events of all components with event mode in co-simulation, whatever they have.
    #[serde(skip)]
    pub event_mode: Option<bool>,
    /// Where the system comes from if not from a TOML file.
    #[serde(skip)]
    pub package: Option<Arc<SystemOrigin>>,
    /// How WebAssembly components run.
    #[serde(skip)]
    pub sandbox: Sandbox,
    /// Whether FMUs are compiled.
    #[serde(skip)]
    pub compilation: Compilation,
}

/// How WebAssembly components run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Sandbox {
    /// Whether native binaries are refused; by default, FMUs that have one do not run as components.
    pub is_required: bool,
    /// The time limit of each call.
    pub call: Option<Duration>,
    /// The maximum memory of each instance in bytes.
    pub memory: Option<u64>,
}

/// The order in which components step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// One component after the other, using the newest outputs (Gauss-Seidel).
    #[default]
    Sequential,
    /// All components at once, using the outputs before the step (Jacobi).
    Parallel,
    /// As sequential, but components that feed each other repeat their step until its inputs are the outputs after it
    /// (strong coupling).
    Implicit,
}

/// How algebraic loops are handled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum AlgebraicLoops {
    /// The system is refused.
    Refuse,
    /// One connection of each loop passes the output before the step.
    Delay,
    /// The loops are solved in each step.
    Iterate,
}

impl Order {
    /// Its name in a system file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sequential => "sequential",
            Self::Parallel => "parallel",
            Self::Implicit => "implicit",
        }
    }
}

/// An instance of an FMU.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Component {
    /// Its name in the system.
    pub name: String,
    /// The FMU file, relative to the folder of the system file.
    pub fmu: PathBuf,
    /// How it is run; by default by co-simulation, if the FMU supports it.
    pub interface: Option<InterfaceType>,
    /// Its own step, a multiple or a whole fraction of the communication step, which it is by default.
    pub step: Option<ComponentStep>,
    /// What its inputs are between communication points.
    #[serde(default)]
    pub inputs: Inputs,
    /// Whether the master handles its events in co-simulation, in event mode; by default, if it has
    /// clocks.
    pub event_mode: Option<bool>,
    /// Whether its outputs after a step belong to the sample taken at the start of the step; by
    /// default, true if all outputs are discrete.
    pub sampled: Option<bool>,
    /// Its relative tolerance.
    pub tolerance: Option<f64>,
    /// The method by which its equations are integrated.
    pub solver: Option<Solver>,
    /// A parameter set of its FMU by its name, or a file (.ssv), relative to the folder of the system file.
    pub parameters: Option<String>,
    /// Start values of parameters, inputs, and variables with initial exact or approx, which replace those of the
    /// parameter set.
    #[serde(default)]
    pub start: BTreeMap<String, Literal>,
    /// The function that it is, if it is no FMU; then the file name only stands for it in messages.
    #[serde(skip)]
    pub function: Option<Function>,
}

/// An output that feeds an input: `plant.theta -> controller.y`, or a table of these fields.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "Notation")]
pub struct Connection {
    /// The output, `component.variable`.
    pub from: String,
    /// The input, `component.variable`.
    pub to: String,
    /// How to convert the value to another unit.
    pub conversion: Option<Conversion>,
    /// Its faults, in the order in which they act; they act before the conversion.
    pub faults: Vec<Fault>,
}

/// The input is `factor` times the output plus `offset`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Conversion {
    /// The factor.
    pub factor: f64,
    /// The offset, in the unit of the input.
    pub offset: f64,
}

impl Conversion {
    /// The input for a value of the output.
    #[inline(always)]
    pub(crate) fn apply(self, value: f64) -> f64 {
        self.factor * value + self.offset
    }
}

/// A connection as the user writes it.
#[derive(Deserialize)]
#[serde(
    untagged,
    deny_unknown_fields,
    expecting = "expected \"component.output -> component.input\", or a table with from, to, factor, offset and faults"
)]
enum Notation {
    Arrow(String),
    Table {
        from: String,
        to: String,
        factor: Option<f64>,
        offset: Option<f64>,
        #[serde(default)]
        faults: Vec<BTreeMap<String, Amount>>,
    },
}

impl TryFrom<Notation> for Connection {
    type Error = Error;

    fn try_from(notation: Notation) -> Result<Self> {
        let (from, to, factor, offset, faults) = match notation {
            Notation::Arrow(text) => {
                let (from, to) = text.split_once("->").with_context(|| {
                    format!("the connection {text:?} is not of the form \"component.output -> component.input\"")
                })?;
                (from.trim().to_owned(), to.trim().to_owned(), None, None, Vec::new())
            }
            Notation::Table { from, to, factor, offset, faults } => {
                (from, to, factor, offset, faults)
            }
        };
        let is_scaled = factor.is_some() || offset.is_some();
        let (factor, offset) = (factor.unwrap_or(1.0), offset.unwrap_or(0.0));
        ensure!(
            factor.is_finite() && offset.is_finite(),
            "the factor and offset of {from} -> {to} are not finite, expected numbers"
        );
        let conversion = is_scaled.then_some(Conversion { factor, offset });
        let faults = faults.into_iter().map(Fault::new).collect::<Result<_>>();
        let faults = faults.with_context(|| format!("{from} -> {to}"));
        // The reader of TOML shows only the outermost error.
        let faults = faults.map_err(|error| anyhow!("{error:#}"))?;
        Ok(Self { from, to, conversion, faults })
    }
}

impl Description {
    /// The times of the simulation.
    pub fn experiment(&self) -> Experiment {
        Experiment { start: self.start, stop: self.stop, step: self.step }
    }

    /// How algebraic loops are handled.
    ///
    /// # Errors
    /// Two keys disagree.
    pub(crate) fn algebraic_loops(&self) -> Result<AlgebraicLoops> {
        use AlgebraicLoops::{Delay, Refuse};
        let allowed = if self.allow_algebraic_loops { Delay } else { Refuse };
        let loops = self.algebraic_loops.unwrap_or(allowed);
        ensure!(
            !self.allow_algebraic_loops || loops == Delay,
            "allow_algebraic_loops = true and algebraic_loops are given, expected one of them"
        );
        Ok(loops)
    }

    /// Makes components functions, by their names. `compute` computes the outputs of a function, by its number, at a time
    /// (s).
    ///
    /// # Errors
    /// There is no such component.
    pub fn set_functions(
        &mut self,
        functions: &[(String, Signature)],
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
    ) -> Result<()> {
        for (number, (name, signature)) in functions.iter().enumerate() {
            let compute = compute.clone();
            let compute = move |time, inputs: &[Value]| compute(number, time, inputs);
            let function = Function { signature: signature.clone(), compute: Arc::new(compute) };
            let mut components = self.components.iter_mut();
            let component = components.find(|component| component.name == *name);
            component.with_context(|| format!("there is no component {name}"))?.function =
                Some(function);
        }
        Ok(())
    }

    /// Uses the FMUs of the same file names from another folder.
    pub fn take_fmus_from(&mut self, folder: &Path) {
        for component in &mut self.components {
            if let Some(name) = component.fmu.file_name() {
                component.fmu = folder.join(name);
            }
        }
    }
}
