//! Reads the interfaces of models from the copies in a binary, which [`interface`](crate::interface) writes.

use std::collections::HashMap;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use serde::Deserialize;

use crate::hash::checksum;
use crate::interface::{CHECKSUM, MAGIC, Override, VERSION};
use crate::table::{Bounds, Dynamics, MAX_DEPTH, full_name};
use crate::variable::{DeclaredType, Exported, Item, Variable};
use crate::{Causality, Description, Initial, Type, Value, Variability};

/// Reads the interfaces of all models in a binary, without duplicates: a universal binary has several
/// copies of each.
///
/// # Errors
/// A copy is damaged, or of another version of the format.
pub fn read_interfaces(binary: &[u8]) -> Result<Vec<Description>> {
    const DAMAGED: &str = "the description of a model in the binary is damaged";
    const HEADER: usize = MAGIC.len() + 2 * size_of::<u32>();
    let mut models = Vec::new();
    let mut rest = binary;
    while let Some(at) = rest.windows(MAGIC.len()).position(|bytes| bytes == MAGIC) {
        let (header, _) = rest[at..].split_first_chunk::<HEADER>().context(DAMAGED)?;
        let [.., a, b, c, d, e, f, g, h] = *header;
        let version = u32::from_le_bytes([a, b, c, d]);
        ensure!(
            version == VERSION,
            "the library was built with another version of fmu-export: its format is {version}, expected {VERSION}"
        );
        let length = u32::from_le_bytes([e, f, g, h]) as usize;
        let copy = rest[at..].split_at_checked(length.max(HEADER));
        let (copy, after) = copy.context(DAMAGED)?;
        let model = description(copy, HEADER).context(DAMAGED)?;
        if !models.contains(&model) {
            models.push(model);
        }
        rest = after;
    }
    Ok(models)
}

/// A copy, after its header.
#[derive(Deserialize)]
struct Copied {
    name: String,
    description: String,
    is_sampled: bool,
    is_continuous: bool,
    default_experiment: (f64, f64),
    tolerance: f64,
    fields: Vec<Field>,
    /// Value reference, type and text of each start value of a variant.
    overrides: Vec<(usize, u8, String)>,
    guid: String,
}

/// A [`Field`](crate::table::Field) with the prefixes of its groups.
#[derive(Deserialize)]
struct Field {
    prefixes: [String; MAX_DEPTH],
    name: String,
    description: String,
    causality: Causality,
    variability: Variability,
    dimensions: Vec<usize>,
    size: String,
    dynamics: Dynamics<String>,
    has_input_derivative: bool,
    initially_from: Vec<String>,
    depends_on: Vec<String>,
    terminal: String,
    of_type: Type,
    unit: String,
    mime_type: String,
    bounds: Bounds,
    start: Start,
    /// The name and the description of an enumeration, and its items.
    enumeration: (String, String, Vec<Item>),
}

/// Start values of the types with the same format.
#[derive(Deserialize)]
enum Start {
    Real(Vec<f64>),
    Whole(Vec<i128>),
    Boolean(Vec<bool>),
    String(Vec<String>),
    Binary(Vec<Vec<u8>>),
}

fn description(copy: &[u8], header: usize) -> Result<Description> {
    let copy = copy.split_last_chunk::<CHECKSUM>();
    let (content, sum) = copy.context("it ends too early")?;
    let is_whole = checksum(content).to_le_bytes() == *sum;
    ensure!(is_whole, "its checksum is wrong");
    let content = content.get(header..).context("it ends too early")?;
    let copied: Copied = postcard::from_bytes(content)?;
    let mut description = Description {
        name: copied.name,
        description: copied.description,
        guid: copied.guid,
        is_sampled: copied.is_sampled,
        is_continuous: copied.is_continuous,
        default_experiment: copied.default_experiment,
        tolerance: copied.tolerance,
        variables: Vec::new(),
    };
    let mut references = HashMap::new();
    let mut reference = 0_u32;
    for field in &copied.fields {
        references.insert(field.path(&field.name), reference as usize);
        let count = field
            .dimensions
            .iter()
            .try_fold(1, |n, size| size.checked_mul(n));
        let count = count.and_then(|count| u32::try_from(count).ok());
        let next = count.and_then(|count| reference.checked_add(count));
        description.variables.push(Variable {
            reference,
            ..Variable::default()
        });
        reference = next.context("there are too many variables")?;
    }
    let is_sampled = description.is_sampled;
    for (field, variable) in copied.fields.into_iter().zip(&mut description.variables) {
        *variable = field.variable(variable.reference, is_sampled, &references)?;
    }
    for (reference, kind, text) in &copied.overrides {
        let text = text.as_str();
        let start = Override {
            reference: *reference,
            kind: *kind,
            text,
        };
        let variable = description.variable_mut(*reference);
        let (variable, element) = variable.context("an override of no variable")?;
        let value = start.value(variable.of_type);
        let start = variable.start.get_mut(element);
        let start = start.context("an override of a variable without a start value")?;
        *start = value.context("an override does not fit its variable")?;
    }
    Ok(description)
}

impl Field {
    /// A name in the group of the field, with the prefixes.
    fn path(&self, name: &str) -> String {
        let prefixes = self.prefixes.iter().filter(|prefix| !prefix.is_empty());
        prefixes
            .map(|prefix| format!("{prefix}."))
            .collect::<String>()
            + name
    }

    fn variable(
        self,
        reference: u32,
        is_sampled: bool,
        references: &HashMap<String, usize>,
    ) -> Result<Variable> {
        let find = |name: &String| {
            let reference = references.get(&self.path(name)).copied();
            reference.with_context(|| format!("there is no variable {name}"))
        };
        let find_all = |names: &[String]| names.iter().map(find).collect::<Result<Vec<_>>>();
        let size = (!self.size.is_empty())
            .then(|| find(&self.size))
            .transpose()?;
        let (initially_from, depends_on) =
            (find_all(&self.initially_from)?, find_all(&self.depends_on)?);
        let dynamics = match &self.dynamics {
            Dynamics::Algebraic => Dynamics::Algebraic,
            Dynamics::State { nominal } => Dynamics::State { nominal: *nominal },
            Dynamics::Derivative { of } => Dynamics::Derivative { of: find(of)? },
            Dynamics::EventIndicator => Dynamics::EventIndicator,
        };
        // Outputs of a model with a sample time change at its sample instants only.
        let is_held = is_sampled && matches!(self.causality, Causality::Output | Causality::Local);
        let variability = match self.variability {
            Variability::Continuous if is_held => Variability::Discrete,
            variability => variability,
        };
        let of_type = self.of_type;
        let start: Option<Vec<Value>> = match self.start {
            Start::Real(all) => all.iter().map(|v| Value::real(of_type, *v)).collect(),
            Start::Whole(all) => all.iter().map(|v| Value::whole(of_type, *v)).collect(),
            Start::Boolean(all) => Some(all.into_iter().map(Value::Boolean).collect()),
            Start::String(all) => Some(all.into_iter().map(Value::String).collect()),
            Start::Binary(all) => Some(all.into_iter().map(Value::Binary).collect()),
        };
        let start = start.filter(|all| all.iter().all(|value| value.of_type() == of_type));
        let start = start.context("a start value does not fit its type")?;
        let initial = match Initial::default_for(self.causality, variability) {
            Some(Initial::Calculated) if !start.is_empty() => Some(Initial::Exact),
            initial => initial,
        };
        let (name, description, items) = self.enumeration;
        let numbers = || items.iter().map(|item| item.value);
        let (low, high) = of_type.range();
        let (min, max) = match self.bounds {
            Bounds::Real(min, max) => [min, max]
                .map(|bound| Value::real(of_type, bound).filter(|_| bound.is_finite()))
                .into(),
            Bounds::Whole(min, max) => [(min, low), (max, high)]
                .map(|(bound, of_all)| Value::whole(of_type, bound).filter(|_| bound != of_all))
                .into(),
            Bounds::None => [numbers().min(), numbers().max()]
                .map(|number| number.map(Value::Enumeration))
                .into(),
        };
        let declared_type = DeclaredType {
            name,
            description,
            items,
        };
        let is_enumeration = of_type == Type::Enumeration;
        let some = |text: String| (!text.is_empty()).then_some(text);
        Ok(Variable {
            name: full_name(&self.prefixes, &self.name),
            reference,
            description: self.description,
            of_type,
            causality: self.causality,
            variability,
            initial,
            dimensions: self.dimensions,
            start,
            min,
            max,
            unit: some(self.unit),
            mime_type: some(self.mime_type),
            declared_type: is_enumeration.then(|| Arc::new(declared_type)),
            exported: Exported {
                has_input_derivative: self.has_input_derivative,
                dynamics,
                size,
                initially_from,
                depends_on,
                terminal: self.terminal,
            },
        })
    }
}
