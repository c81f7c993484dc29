//! Components that are functions of this program instead of FMUs.

use std::collections::HashSet;
use std::fmt;
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
use fmu_description::{Causality, Initial, Type, Value, Variability, Variable};
use fmu_host::Instance;
use serde::{Deserialize, Serialize};

use crate::Messages;

/// The variables of a function, and how often it is called.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Signature {
    /// Its inputs, in the order of its arguments.
    pub inputs: Vec<Argument>,
    /// Its outputs, in the order of its results.
    pub outputs: Vec<Argument>,
    /// Time between two calls (s); by default the communication step.
    pub sample_time: Option<f64>,
}

/// An input or output of a function.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Argument {
    /// Its name.
    pub name: String,
    /// Its type: `Float64`, `Int64`, `Boolean`, `String` or `Binary`.
    pub of_type: String,
    /// Its unit; empty if it has none.
    pub unit: String,
}

/// A call of a function of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FunctionCall {
    /// The number of the function.
    pub function: usize,
    /// The time (s).
    pub time: f64,
    /// The values of its inputs.
    pub inputs: Vec<Value>,
}

/// The outputs of a function, or what went wrong.
pub type Computed = Result<Vec<Value>, String>;

/// What computes the outputs at a time (s) from the inputs. An error says what went wrong, and ends the run.
pub type Compute = Arc<dyn Fn(f64, &[Value]) -> Computed + Send + Sync>;

/// A sampled component that is a function.
#[derive(Clone)]
pub struct Function {
    /// Its variables.
    pub signature: Signature,
    /// What is called at each sample.
    pub compute: Compute,
}

impl fmt::Debug for Function {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.signature.fmt(f)
    }
}

impl Function {
    /// Its variables, of a component with this name, in a system with this communication step (s).
    ///
    /// # Errors
    /// A name, type or sample time is invalid.
    pub(crate) fn variables(&self, component: &str, step: f64) -> Result<Vec<Variable>> {
        let Signature { inputs, outputs, sample_time } = &self.signature;
        if let Some(time) = sample_time {
            ensure!(
                time.is_finite() && *time >= step * (1.0 - 1e-6),
                "sample_time = {time:?} of {component}, expected at least the communication step of {step:?} s"
            );
        }
        let inputs = inputs.iter().map(|argument| (argument, Causality::Input));
        let outputs = outputs.iter().map(|argument| (argument, Causality::Output));
        let mut names = HashSet::new();
        let variables =
            (0..).zip(inputs.chain(outputs)).map(|(reference, (argument, causality))| {
                let Argument { name, of_type, unit } = argument;
                ensure!(names.insert(name), "{component} has two variables {name}");
                let start = match of_type.as_str() {
                    "Float64" => Value::Float64(0.0),
                    "Int64" => Value::Int64(0),
                    "Boolean" => Value::Boolean(false),
                    "String" => Value::String(String::new()),
                    "Binary" => Value::Binary(Vec::new()),
                    other => bail!(
                        "type of {component}.{name}: {other:?}, expected \"Float64\", \"Int64\", \"Boolean\", \"String\" or \"Binary\""
                    ),
                };
                let of_type = start.of_type();
                let is_continuous = causality == Causality::Input && of_type == Type::Float64;
                Ok(Variable {
                    name: name.clone(),
                    reference,
                    causality,
                    variability: match is_continuous {
                        true => Variability::Continuous,
                        false => Variability::Discrete,
                    },
                    initial: Some(Initial::Exact),
                    of_type,
                    unit: Some(unit.clone()).filter(|unit| !unit.is_empty()),
                    start: vec![start],
                    ..Variable::default()
                })
            });
        variables.collect()
    }

    /// An instance with these variables; each has samples of its own.
    pub(crate) fn instantiate(
        &self,
        (component, name): (usize, &str),
        variables: &[Variable],
        messages: &Messages,
    ) -> Instance {
        let Self { signature, compute } = self.clone();
        let (mut start, mut samples) = (None, 0_u64);
        let step = move |time: f64, step: f64, values: &mut [Value]| {
            let period = signature.sample_time.unwrap_or(step);
            let due = *start.get_or_insert(time) + samples as f64 * period;
            if time < due - 1e-6 * step {
                return Ok(());
            }
            samples += 1;
            let (inputs, outputs) = values.split_at_mut(signature.inputs.len());
            let computed = compute(time, inputs)?;
            let (given, expected) = (computed.len(), outputs.len());
            if given != expected {
                return Err(format!("values returned: {given}, expected {expected}"));
            }
            let known = signature.outputs.iter().zip(outputs);
            known.zip(computed).try_for_each(|((argument, output), value)| {
                let Argument { name, of_type, .. } = argument;
                let wrong = || format!("it returned {value} for {name}, expected a {of_type}");
                *output = fitting(output.of_type(), &value).ok_or_else(wrong)?;
                Ok(())
            })
        };
        let start = variables.iter().flat_map(|variable| variable.start.iter().cloned());
        let (instance, log) = (name.to_owned(), messages.clone());
        let observer = messages.observers().of_component(component);
        let watching = observer.clone();
        let sink = move |logged| {
            watching.iter().for_each(|observer| observer.log(&logged));
            log.log(&instance, &logged);
        };
        Instance::of_function(start.collect(), Box::new(step), sink, observer)
    }
}

/// A value in the type of an output; `None` if it is of another kind.
fn fitting(of_type: Type, value: &Value) -> Option<Value> {
    match of_type {
        Type::Boolean | Type::String | Type::Binary => {
            let has_null = matches!(value, Value::String(text) if text.contains('\0'));
            (value.of_type() == of_type && !has_null).then(|| value.clone())
        }
        Type::Float64 => {
            let real = value.as_real().or_else(|| value.as_whole().map(|whole| whole as f64));
            real.map(Value::Float64)
        }
        other => Value::whole(other, value.as_whole()?),
    }
}
