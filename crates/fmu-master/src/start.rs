//! Start values: from the literal of the user to the FMU.
//!
//! 1. A [`Literal`] comes from a system file or package ([`Component::start`](crate::Component)), from `--set` or Python
//!    ([`Overrides::sets`](crate::Overrides)), or from a sweep. The component is known, or
//!    [`Components::split`](crate::Components::split) finds it by the name `component.variable`.
//! 2. [`scalar_literals`] finds the variable in the model description: a scalar, or all elements of an array, each with
//!    its literal.
//! 3. [`ScalarLiteral::start_value`] checks that the scalar has a start value, and makes the literal a [`Value`] of its
//!    type. A start value of the description stays in its [`LoadedComponent`](crate::LoadedComponent); one of a run is a
//!    [`StartValue`], which [`Plan::start`](crate::Plan::start) makes.
//! 4. [`ComponentStarts`] joins both, and the first values of tunable parameters from a table, for one component in one
//!    run, and
//!    [`ComponentInstance::set_up`](crate::component_instance::ComponentInstance::set_up) sets them on the FMU.
//!
//! Structural parameters come first, as they change the variables that there are: [`sizes`] resolves them when the FMU is
//! opened.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};

use anyhow::{Error, Result, bail, ensure};
use fmu_description::{Causality, Initial, Value, Variability, Variable};

use crate::access_list::AccessList;
use crate::fmu::Sizes;
use crate::similar::similar;
use crate::{Fmu, Literal};

/// A start value that fits its variable: of a scalar, or of all elements of an array.
#[derive(Debug, Clone)]
pub struct StartValue {
    pub(crate) component: usize,
    /// The values by the indices of the scalars.
    pub(crate) values: Vec<(usize, Value)>,
}

/// The literal of a scalar, and the name of the scalar in messages.
pub(crate) struct ScalarLiteral<'a> {
    pub(crate) scalar: usize,
    pub(crate) name: Cow<'a, str>,
    pub(crate) literal: Cow<'a, Literal>,
}

/// The literal of a variable of an FMU for its scalar, or for each element of an array. `full_name` is the name of the
/// variable in messages.
///
/// # Errors
/// There is no such variable, or the shapes differ.
pub(crate) fn scalar_literals<'a>(
    fmu: &Fmu,
    variable: &str,
    full_name: &'a str,
    literal: &'a Literal,
) -> Result<Vec<ScalarLiteral<'a>>> {
    let named = |error: Error| match variable == full_name {
        true => error,
        false => error.context(full_name.to_owned()),
    };
    if fmu.get_scalar(variable).is_some() || !literal.is_array() {
        let scalar = fmu.settable(variable).map_err(named)?;
        let literal = Cow::Borrowed(literal);
        return Ok(vec![ScalarLiteral { scalar, name: full_name.into(), literal }]);
    }
    let (scalars, dimensions) = fmu.elements(variable).map_err(named)?;
    let literals = literal.elements(&dimensions, full_name)?;
    let element = |(scalar, literal)| {
        let name = format!("{full_name}{}", &fmu.name(scalar)[variable.len()..]);
        ScalarLiteral { scalar, name: name.into(), literal: Cow::Owned(literal) }
    };
    Ok(scalars.into_iter().zip(literals).map(element).collect())
}

impl ScalarLiteral<'_> {
    /// The literal as a value of the type of the scalar.
    ///
    /// # Errors
    /// The literal does not fit the type.
    pub(crate) fn value(&self, fmu: &Fmu) -> Result<Value> {
        self.literal.typed(fmu.variable(self.scalar), &self.name)
    }

    /// The literal as the start value of the scalar.
    ///
    /// # Errors
    /// The scalar has no start value that can be set, or the literal does not fit its type.
    pub(crate) fn start_value(&self, fmu: &Fmu) -> Result<Value> {
        let Self { scalar, name, literal } = self;
        if let Some(reason) = fmu.unusable(*scalar) {
            bail!("{name} = {literal} cannot be set: {reason}");
        }
        let variable = fmu.variable(*scalar);
        ensure!(
            has_start_value(variable),
            "{name} = {literal} cannot be set: only inputs, parameters, and variables with initial exact or approx have start values{}",
            self.alternative(fmu)
        );
        self.value(fmu)
    }

    /// What may be meant instead of a variable without start value, such as `theta0` instead of `theta`.
    fn alternative(&self, fmu: &Fmu) -> String {
        const INITIAL: [&str; 5] = ["0", "start", "init", "initial", "ic"];
        let own = fmu.name(self.scalar);
        let known = (0..fmu.scalars.len()).filter(|&scalar| {
            fmu.unusable(scalar).is_none() && has_start_value(fmu.variable(scalar))
        });
        let known = Vec::from_iter(known.map(|scalar| fmu.name(scalar)));
        let is_initial = |name: &&str| {
            let rest = name.strip_prefix(own.as_str()).unwrap_or_default();
            INITIAL.contains(&rest.trim_start_matches(['_', '.']).to_lowercase().as_str())
        };
        let known = Vec::from_iter(known.iter().map(String::as_str));
        let initial = Vec::from_iter(known.iter().copied().filter(is_initial));
        let meant = if initial.is_empty() { similar(&own, known.into_iter()) } else { initial };
        let prefix = self.name.strip_suffix(own.as_str()).unwrap_or_default();
        let meant = Vec::from_iter(meant.into_iter().map(|name| format!("{prefix}{name}")));
        match meant.is_empty() {
            true => String::new(),
            false => format!("; did you mean {}?", meant.join(" or ")),
        }
    }
}

/// Whether a variable has a start value that can be set.
fn has_start_value(variable: &Variable) -> bool {
    let has_start = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
    variable.causality == Causality::Input
        || variable.is_parameter()
        || (has_start && variable.variability != Variability::Constant)
}

/// The values of the structural parameters among the literals of a component, which are the sizes of its arrays.
///
/// # Errors
/// A literal does not fit.
pub(crate) fn sizes(
    fmu: &Fmu,
    literals: &BTreeMap<String, Literal>,
    full_name: impl Fn(&str) -> String,
) -> Result<Sizes> {
    let mut sizes = Sizes::new();
    for (name, literal) in literals {
        // Names of other elements may exist only with these sizes.
        let Some(scalar) = fmu.get_scalar(name) else { continue };
        if fmu.variable(scalar).causality == Causality::StructuralParameter {
            let (full_name, literal) = (full_name(name).into(), Cow::Borrowed(literal));
            let value = ScalarLiteral { scalar, name: full_name, literal }.start_value(fmu)?;
            sizes.extend(value.as_whole().map(|size| (name.clone(), size)));
        }
    }
    Ok(sizes)
}

/// The start values of a component in one run, by the indices of its scalars.
#[derive(Default)]
pub(crate) struct ComponentStarts<'a>(BTreeMap<usize, &'a Value>);

impl<'a> ComponentStarts<'a> {
    /// Start values in their order; a later one replaces an earlier one.
    pub(crate) fn new(values: impl Iterator<Item = &'a (usize, Value)>) -> Self {
        Self(values.map(|(scalar, value)| (*scalar, value)).collect())
    }

    /// Replaces the values of some scalars.
    pub(crate) fn replace(&mut self, values: impl Iterator<Item = (usize, &'a Value)>) {
        self.0.extend(values);
    }

    /// The scalars that have a start value, in the order of the FMU.
    pub(crate) fn scalars(&self) -> impl Iterator<Item = usize> {
        self.0.keys().copied()
    }

    /// The start value of a scalar.
    pub(crate) fn get(&self, scalar: usize) -> Option<&'a Value> {
        self.0.get(&scalar).copied()
    }

    /// Checks that arrays of which elements are set can be set as a whole; `name_of` names a scalar in a message.
    ///
    /// # Errors
    /// An element is not set, and the FMU has no start value for it, as its description belongs to a smaller array.
    pub(crate) fn check_arrays(&self, fmu: &Fmu, name_of: impl Fn(usize) -> String) -> Result<()> {
        let is_missing =
            |scalar: &usize| fmu.start(*scalar).is_none() && !self.0.contains_key(scalar);
        let mut checked = None;
        for scalar in self.scalars() {
            let mut array = fmu.array(scalar);
            if array.len() > 1
                && checked.replace(array.start) != Some(array.start)
                && let Some(missing) = array.find(is_missing)
            {
                bail!(
                    "{} cannot be set without {}, for which the FMU has no start value",
                    name_of(scalar),
                    name_of(missing)
                );
            }
        }
        Ok(())
    }

    /// The value of a scalar before it is connected.
    pub(crate) fn value(&self, scalar: usize, fmu: &Fmu) -> Value {
        let start = self.0.get(&scalar).copied().or(fmu.start(scalar));
        start.cloned().unwrap_or(Value::Boolean(false))
    }

    /// The values of a list before any scalar is connected. An array is set as a whole, so that elements without a start
    /// value of the user have the one of the model description.
    pub(crate) fn initial(&self, list: &AccessList, fmu: &Fmu) -> Vec<Value> {
        let mut values = vec![Value::Boolean(false); list.elements];
        let mut known = HashSet::new();
        for (scalar, position) in list.scalars.iter().zip(&list.positions) {
            let first = position - fmu.scalars[*scalar].element;
            if !known.insert(first) {
                continue;
            }
            for (value, scalar) in values[first..].iter_mut().zip(fmu.array(*scalar)) {
                *value = self.value(scalar, fmu);
            }
        }
        values
    }
}
