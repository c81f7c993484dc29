//! A short simulation of an FMU, for the tests.

use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value::unsigned;
use fmu_description::xml::Element;
use fmu_description::{Capability, Causality, ModelDescription, ScalarVariable, VariableType};
use fmu_host::{Instance, Instantiation, Kind, Library};

use crate::finding::Location;

/// Maximum number of calls of `fmi2NewDiscreteStates` in one event iteration.
const MAX_ROUNDS: usize = 1000;

/// The FMU under test.
pub struct Subject<'a> {
    /// Its model description.
    pub model: &'a ModelDescription<'a>,
    /// Its binary.
    pub library: &'a Arc<Library>,
    /// The interface type under test.
    pub kind: Kind,
    /// The XML element of that type.
    pub element: &'a Element<'a>,
    /// URI of the folder `resources`.
    pub resources: String,
}

impl<'a> Subject<'a> {
    /// Whether the FMU declares a capability.
    pub fn claims(&self, capability: Capability) -> bool {
        capability.is_claimed_by(self.element)
    }

    /// Creates an instance.
    pub fn instantiate(&self) -> Result<Instance> {
        let guid = self.model.root.attribute("guid").unwrap_or_default();
        self.try_instantiate(guid)?.with_context(|| {
            let tool = match self.claims(Capability::NeedsExecutionTool) {
                true => "; needsExecutionTool is true: is its tool installed?",
                false => "",
            };
            format!(
                "fmi2Instantiate returned NULL for the GUID of the XML, expected an instance{tool}"
            )
        })
    }

    /// Creates an instance with this GUID; `None` if the FMU rejects it.
    pub fn try_instantiate(&self, guid: &str) -> Result<Option<Instance>> {
        let arguments = Instantiation {
            name: "instance",
            kind: self.kind,
            guid,
            resources: &self.resources,
            logging_on: false,
        };
        Ok(self.library.instantiate(&arguments, |_| ())?)
    }

    /// Start time of the default experiment.
    pub fn start(&self) -> f64 {
        self.model
            .experiment("startTime")
            .filter(|t| t.is_finite())
            .unwrap_or(0.0)
    }

    fn stop(&self) -> Option<f64> {
        self.model
            .experiment("stopTime")
            .filter(|stop| stop.is_finite() && *stop > self.start())
    }

    /// Step size of the default experiment.
    pub fn step(&self) -> f64 {
        let span = self.stop().map_or(1.0, |stop| stop - self.start());
        self.model
            .experiment("stepSize")
            .filter(|step| *step > 0.0 && *step <= span)
            .unwrap_or(span / 1000.0)
    }

    /// Puts an instance into initialization mode.
    pub fn enter_initialization(&self, instance: &mut Instance) -> Result<()> {
        instance.setup_experiment(self.start(), self.stop(), None)?;
        instance.enter_initialization_mode()?;
        Ok(())
    }

    /// The value references of the Real variables with a causality.
    pub fn reals(&self, causality: Causality) -> Vec<u32> {
        self.model
            .variables()
            .filter(|(_, v)| v.kind == VariableType::Real && v.causality == causality)
            .map(|(_, v)| v.reference)
            .collect()
    }

    fn states(&self) -> usize {
        self.model.derivatives.len()
    }
}

/// A running simulation.
pub struct Run<'a> {
    subject: &'a Subject<'a>,
    /// The instance.
    pub instance: Instance,
    /// Simulation time.
    pub time: f64,
}

impl<'a> Run<'a> {
    /// Instantiates and initializes.
    pub fn begin(subject: &'a Subject<'a>) -> Result<Self> {
        let mut run = Self {
            subject,
            instance: subject.instantiate()?,
            time: 0.0,
        };
        run.initialize()?;
        Ok(run)
    }

    /// Initializes an instance that is new or was reset.
    pub fn initialize(&mut self) -> Result<()> {
        self.time = self.subject.start();
        self.subject.enter_initialization(&mut self.instance)?;
        self.instance.exit_initialization_mode()?;
        if self.subject.kind == Kind::ModelExchange {
            self.iterate()?;
            let nominals = self.instance.nominals(self.subject.states())?;
            ensure!(
                nominals.iter().all(|nominal| *nominal != 0.0),
                "fmi2GetNominalsOfContinuousStates gave 0, expected other numbers"
            );
        }
        Ok(())
    }

    /// Iterates in event mode until no new discrete states are needed.
    fn iterate(&mut self) -> Result<()> {
        for _ in 0..MAX_ROUNDS {
            if !self.instance.new_discrete_states()?.again {
                self.instance.enter_continuous_time_mode()?;
                return Ok(());
            }
        }
        bail!(
            "fmi2NewDiscreteStates still needs new discrete states after {MAX_ROUNDS} calls, expected the event iteration to end"
        )
    }

    /// Advances by one step.
    pub fn advance(&mut self, step: f64) -> Result<()> {
        match self.subject.kind {
            Kind::CoSimulation => {
                self.instance.do_step(self.time, step)?;
            }
            Kind::ModelExchange => self.integrate(step)?,
        }
        self.time += step;
        Ok(())
    }

    /// An explicit Euler step.
    fn integrate(&mut self, step: f64) -> Result<()> {
        let n = self.subject.states();
        let mut states = self.instance.continuous_states(n)?;
        let derivatives = self.instance.derivatives(n)?;
        for (state, derivative) in states.iter_mut().zip(derivatives) {
            *state += step * derivative;
        }
        self.instance.set_time(self.time + step)?;
        self.instance.set_continuous_states(&states)?;
        let indicators = self.subject.model.root.attribute("numberOfEventIndicators");
        let indicators = indicators.and_then(unsigned).unwrap_or(0) as usize;
        ensure!(
            indicators <= 1 << 20,
            "numberOfEventIndicators is {indicators}, which is more than can be tested"
        );
        self.instance.event_indicators(indicators)?;
        if self.instance.completed_integrator_step()? {
            self.instance.enter_event_mode()?;
            self.iterate()?;
        }
        Ok(())
    }

    /// The values of all variables that the FMU computes.
    pub fn observe(&mut self) -> Result<Vec<(&'a str, Value)>> {
        self.subject
            .model
            .variables()
            .filter(|(_, v)| matches!(v.causality, Causality::Output | Causality::Local))
            .map(|(_, v)| Ok((v.name, get(&mut self.instance, v)?)))
            .collect()
    }
}

/// The value of a variable, which compares bit by bit.
#[derive(Debug, Clone)]
pub enum Value {
    /// Of a Real.
    Real(f64),
    /// Of an Integer or Enumeration.
    Integer(i32),
    /// Of a Boolean.
    Boolean(i32),
    /// Of a String.
    String(String),
}

impl PartialEq for Value {
    /// Compares bits, so that NaN equals itself.
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Real(a), Self::Real(b)) => a.to_bits() == b.to_bits(),
            (Self::Integer(a), Self::Integer(b)) | (Self::Boolean(a), Self::Boolean(b)) => a == b,
            (Self::String(a), Self::String(b)) => a == b,
            _ => false,
        }
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Real(value) => write!(f, "{value}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Boolean(0) => write!(f, "false"),
            Self::Boolean(1) => write!(f, "true"),
            Self::Boolean(value) => write!(f, "{value}, which is not a Boolean"),
            Self::String(value) => f.write_str(&fmu_file::text::quote(value)),
        }
    }
}

/// Gets the value of a variable.
pub fn get(instance: &mut Instance, variable: &ScalarVariable<'_>) -> Result<Value> {
    value(instance, variable.kind, &[variable.reference])
        .with_context(|| format!("the value of {} cannot be read", Location::from(variable)))
}

fn value(instance: &mut Instance, kind: VariableType, reference: &[u32; 1]) -> Result<Value> {
    let (mut real, mut number) = ([0.0], [0]);
    Ok(match kind {
        VariableType::Real => {
            instance.get_real(reference, &mut real)?;
            Value::Real(real[0])
        }
        VariableType::Integer | VariableType::Enumeration => {
            instance.get_integer(reference, &mut number)?;
            Value::Integer(number[0])
        }
        VariableType::Boolean => {
            instance.get_boolean(reference, &mut number)?;
            Value::Boolean(number[0])
        }
        VariableType::String => Value::String(instance.get_string(reference)?.concat()),
    })
}
