//! Reads and writes the values of a slave, and reports why an access is rejected.

use std::ffi::CStr;
use std::fmt;

use fmu_description::{Causality, Domain, Value, ValueMut, Variability, Variable, words};

use crate::reason::{Reason, reason};
use crate::slave::{Scalar, Slave};

/// A type of the FMI functions.
pub(crate) trait FmiType: Sized {
    /// Its name.
    const NAME: &'static str;
    /// The value of a variable if it has this type.
    fn read(from: &ValueMut<'_>) -> Option<Self>;
}

impl FmiType for f64 {
    const NAME: &'static str = "Real";

    fn read(from: &ValueMut<'_>) -> Option<Self> {
        match from {
            ValueMut::Real(value) => Some(**value),
            _ => None,
        }
    }
}

impl FmiType for i32 {
    const NAME: &'static str = "Integer";

    fn read(from: &ValueMut<'_>) -> Option<Self> {
        match from {
            ValueMut::Integer(value) => Some(**value),
            ValueMut::Choice(choice) => Some(choice.get()),
            _ => None,
        }
    }
}

/// An `fmi2Boolean`: 0 or 1.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub(crate) struct Boolean(pub(crate) i32);

impl FmiType for Boolean {
    const NAME: &'static str = "Boolean";

    fn read(from: &ValueMut<'_>) -> Option<Self> {
        match from {
            ValueMut::Boolean(value) => Some(Self(i32::from(**value))),
            _ => None,
        }
    }
}

impl FmiType for String {
    const NAME: &'static str = "String";

    fn read(from: &ValueMut<'_>) -> Option<Self> {
        match from {
            ValueMut::String(value) => Some((*value).clone()),
            _ => None,
        }
    }
}

/// A value from the host.
#[derive(Clone, Copy)]
pub(crate) enum Given<'a> {
    Real(f64),
    Integer(i32),
    Boolean(i32),
    /// A text, `None` for NULL.
    String(Option<&'a CStr>),
}

impl From<f64> for Given<'_> {
    fn from(value: f64) -> Self {
        Self::Real(value)
    }
}

impl From<i32> for Given<'_> {
    fn from(value: i32) -> Self {
        Self::Integer(value)
    }
}

impl From<Boolean> for Given<'_> {
    fn from(value: Boolean) -> Self {
        Self::Boolean(value.0)
    }
}

impl<'a> From<Option<&'a CStr>> for Given<'a> {
    fn from(value: Option<&'a CStr>) -> Self {
        Self::String(value)
    }
}

impl fmt::Display for Given<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Real(value) => value.fmt(f),
            Self::Integer(value) | Self::Boolean(value) => value.fmt(f),
            Self::String(Some(text)) => fmt::Debug::fmt(text, f),
            Self::String(None) => f.write_str("NULL"),
        }
    }
}

impl Given<'_> {
    /// Whether a variable has the type of the value.
    fn fits(self, value: &ValueMut<'_>) -> bool {
        matches!(
            (self, value),
            (Self::Real(_), ValueMut::Real(_))
                | (Self::Integer(_), ValueMut::Integer(_) | ValueMut::Choice(_))
                | (Self::Boolean(_), ValueMut::Boolean(_))
                | (Self::String(_), ValueMut::String(_))
        )
    }

    fn type_name(self) -> &'static str {
        match self {
            Self::Real(_) => f64::NAME,
            Self::Integer(_) => i32::NAME,
            Self::Boolean(_) => Boolean::NAME,
            Self::String(_) => String::NAME,
        }
    }

    /// The value, if it is within the bounds of a variable of its type.
    fn within(self, domain: &Domain) -> Option<Value> {
        let is_allowed = match (self, domain) {
            (Self::Real(value), Domain::Real { min, max, .. }) => {
                value.is_finite() && *min <= value && value <= *max
            }
            (Self::Integer(value), Domain::Integer { min, max, .. }) => {
                *min <= value && value <= *max
            }
            (Self::Integer(value), Domain::Enumeration { items, .. }) => {
                items.items.iter().any(|item| item.value == value)
            }
            (Self::Boolean(value), _) => value == 0 || value == 1,
            _ => true,
        };
        if !is_allowed {
            return None;
        }
        Some(match self {
            Self::Real(value) => Value::Real(value),
            Self::Integer(value) => Value::Integer(value),
            Self::Boolean(value) => Value::Boolean(value == 1),
            Self::String(text) => Value::String(text?.to_str().ok()?.to_owned()),
        })
    }

    /// The value as text that is independent of the host's memory.
    fn text(self) -> String {
        self.to_string()
    }
}

/// Describes the values that a variable may have.
fn expected(domain: &Domain) -> String {
    match domain {
        Domain::Real { min, max, unit, .. } => {
            format!(
                "a finite number{}{}",
                words::bounds(*min, *max),
                words::in_unit(unit)
            )
        }
        Domain::Integer { min, max, .. } => format!("a whole number from {min} to {max}"),
        Domain::Enumeration { items, .. } => {
            let items = items.items.iter();
            let texts: Vec<_> = items
                .map(|item| format!("{} ({})", item.value, item.name))
                .collect();
            texts.join(", ")
        }
        Domain::Boolean { .. } => "0 (false) or 1 (true)".into(),
        Domain::String { .. } => "a text in UTF-8".into(),
    }
}

/// Reads the values with the given references, all or none.
pub(crate) fn get<T: FmiType>(
    slave: &mut dyn Slave,
    references: &[u32],
    values: &mut [T],
) -> Result<(), Reason> {
    // Several are checked before the first value is written; a single one need not be.
    if references.len() > 1 {
        for &reference in references {
            read::<T>(slave, reference)?;
        }
    }
    for (&reference, value) in references.iter().zip(values) {
        *value = read(slave, reference)?;
    }
    Ok(())
}

fn read<T: FmiType>(slave: &mut dyn Slave, reference: u32) -> Result<T, Reason> {
    match slave.find(reference) {
        Some(scalar) => T::read(&scalar.value).ok_or_else(|| wrong_type(&scalar, T::NAME)),
        None => Err(unknown(slave, reference)),
    }
}

/// Writes all values or none. `running` is true after initialization.
pub(crate) fn set<'a, T: Into<Given<'a>> + Copy>(
    slave: &mut dyn Slave,
    references: &[u32],
    values: &[T],
    running: bool,
) -> Result<(), Reason> {
    for (&reference, &value) in references.iter().zip(values) {
        check(slave, reference, value.into(), running)?;
    }
    for (&reference, &value) in references.iter().zip(values) {
        if let Some(scalar) = slave.find(reference)
            && let Some(value) = value.into().within(&scalar.variable().domain)
        {
            scalar.value.set(value);
        }
    }
    Ok(())
}

/// Checks that a value may be written.
fn check(
    slave: &mut dyn Slave,
    reference: u32,
    value: Given<'_>,
    running: bool,
) -> Result<(), Reason> {
    let Some(scalar) = slave.find(reference) else {
        return Err(unknown(slave, reference));
    };
    if !value.fits(&scalar.value) {
        return Err(wrong_type(&scalar, value.type_name()));
    }
    let (name, domain) = (scalar.name(), &scalar.variable().domain);
    if let Some(why) = not_settable(scalar.variable(), running) {
        return Err(reason!("{name} is {why}"));
    }
    if value.within(domain).is_none() {
        let value = value.text();
        return Err(reason!(
            "{name} = {value} is refused; expected {}",
            expected(domain)
        ));
    }
    Ok(())
}

/// Sets the first time derivatives of inputs, all or none.
pub(crate) fn set_input_derivatives(
    slave: &mut dyn Slave,
    references: &[u32],
    orders: &[i32],
    values: &[f64],
) -> Result<(), Reason> {
    for ((&reference, &order), &value) in references.iter().zip(orders).zip(values) {
        let Some(scalar) = slave.find(reference) else {
            return Err(unknown(slave, reference));
        };
        let name = scalar.name();
        if slave.input_derivative(reference).is_none() {
            return Err(reason!(
                "the host cannot set the input derivative of {name}"
            ));
        }
        if order != 1 {
            return Err(reason!(
                "the derivative of {name} is of order {order}; expected 1"
            ));
        }
        if !value.is_finite() {
            return Err(reason!(
                "the derivative of {name} = {value} is refused; expected a finite number"
            ));
        }
    }
    for (&reference, &value) in references.iter().zip(values) {
        if let Some(derivative) = slave.input_derivative(reference) {
            *derivative = value;
        }
    }
    Ok(())
}

/// Computes directional derivatives of outputs with respect to inputs, all or none.
pub(crate) fn directional_derivative(
    slave: &mut dyn Slave,
    unknowns: &[u32],
    knowns: &[u32],
    direction: &[f64],
    derivatives: &mut [f64],
) -> Result<(), Reason> {
    if !slave.has_directional_derivatives() {
        return Err("the model has no derivatives: providesDirectionalDerivative is false".into());
    }
    check_causality(slave, unknowns, Causality::Output, "an output")?;
    check_causality(slave, knowns, Causality::Input, "an input")?;
    if let Some(&change) = direction.iter().find(|change| !change.is_finite()) {
        return Err(reason!(
            "the direction contains {change}; expected finite numbers"
        ));
    }
    for (&unknown, derivative) in unknowns.iter().zip(derivatives) {
        *derivative = knowns
            .iter()
            .zip(direction)
            .map(|(&known, change)| slave.derivative(unknown, known) * change)
            .sum();
    }
    Ok(())
}

fn check_causality(
    slave: &mut dyn Slave,
    references: &[u32],
    causality: Causality,
    expected: &'static str,
) -> Result<(), Reason> {
    for &reference in references {
        match slave.find(reference) {
            None => return Err(unknown(slave, reference)),
            Some(scalar) if scalar.variable().causality != causality => {
                let name = scalar.name();
                return Err(reason!("{name} is not {expected}"));
            }
            Some(scalar) if !matches!(scalar.value, ValueMut::Real(_)) => {
                return Err(wrong_type(&scalar, f64::NAME));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

/// Why the host may not set the variable now; `None` if it may.
fn not_settable(variable: &Variable, running: bool) -> Option<&'static str> {
    match (variable.causality, variable.variability) {
        (_, Variability::Constant) => Some("a constant"),
        (Causality::Output, _) => Some("an output, which only the model sets"),
        (Causality::Local, _) => Some("a local variable, which only the model sets"),
        (_, Variability::Fixed) if running => {
            Some("a fixed parameter, which cannot be set after the initialization")
        }
        _ => None,
    }
}

#[cold]
fn unknown(slave: &dyn Slave, reference: u32) -> Reason {
    let last = slave.count().saturating_sub(1);
    reason!("value reference {reference} is unknown; expected 0 to {last}")
}

#[cold]
fn wrong_type(scalar: &Scalar<'_>, requested: &'static str) -> Reason {
    let actual = match scalar.variable().domain {
        Domain::Real { .. } => "Real",
        Domain::Integer { .. } => "Integer",
        Domain::Boolean { .. } => "Boolean",
        Domain::String { .. } => "String",
        Domain::Enumeration { .. } => "Enumeration, which is accessed as Integer",
    };
    let name = scalar.name();
    reason!("{name} is of type {actual}, not {requested}")
}
