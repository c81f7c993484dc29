//! Reads and writes the values of a slave, and reports why an access is rejected.

use std::fmt;

use fmu_description::{Causality, Domain, Info, ValueMut, Variability};

use crate::reason::{Reason, reason};
use crate::slave::{Scalar, Slave};

/// A value type of the FMI functions.
pub(crate) trait Value: Copy + 'static {
    /// Name of the type.
    const TYPE: &'static str;
    /// The value of a variable if it has this type.
    fn read(from: &ValueMut<'_>) -> Option<Self>;
    /// Sets a variable of this type.
    fn write(self, to: ValueMut<'_>);
    /// The value as [`Given`], to check it.
    fn given(self) -> Given;
}

impl Value for f64 {
    const TYPE: &'static str = "Real";

    fn read(from: &ValueMut<'_>) -> Option<Self> {
        match from {
            ValueMut::Real(value) => Some(**value),
            _ => None,
        }
    }

    fn write(self, to: ValueMut<'_>) {
        if let ValueMut::Real(value) = to {
            *value = self;
        }
    }

    fn given(self) -> Given {
        Given::Real(self)
    }
}

impl Value for i32 {
    const TYPE: &'static str = "Integer";

    fn read(from: &ValueMut<'_>) -> Option<Self> {
        match from {
            ValueMut::Integer(value) => Some(**value),
            _ => None,
        }
    }

    fn write(self, to: ValueMut<'_>) {
        if let ValueMut::Integer(value) = to {
            *value = self;
        }
    }

    fn given(self) -> Given {
        Given::Integer(self)
    }
}

/// An `fmi2Boolean`: 0 or 1.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub(crate) struct Boolean(pub(crate) i32);

impl Value for Boolean {
    const TYPE: &'static str = "Boolean";

    fn read(from: &ValueMut<'_>) -> Option<Self> {
        match from {
            ValueMut::Boolean(value) => Some(Self(i32::from(**value))),
            _ => None,
        }
    }

    fn write(self, to: ValueMut<'_>) {
        if let ValueMut::Boolean(value) = to {
            *value = self.0 == 1;
        }
    }

    fn given(self) -> Given {
        Given::Boolean(self.0)
    }
}

/// A value of any type from the host.
#[derive(Clone, Copy)]
pub(crate) enum Given {
    Real(f64),
    Integer(i32),
    Boolean(i32),
}

impl fmt::Display for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Real(value) => value.fmt(f),
            Self::Integer(value) | Self::Boolean(value) => value.fmt(f),
        }
    }
}

impl Given {
    /// Whether a variable has the type of the value.
    fn fits(self, value: &ValueMut<'_>) -> bool {
        matches!(
            (self, value),
            (Self::Real(_), ValueMut::Real(_))
                | (Self::Integer(_), ValueMut::Integer(_))
                | (Self::Boolean(_), ValueMut::Boolean(_))
        )
    }

    fn type_name(self) -> &'static str {
        match self {
            Self::Real(_) => f64::TYPE,
            Self::Integer(_) => i32::TYPE,
            Self::Boolean(_) => Boolean::TYPE,
        }
    }

    /// Whether the value is within the bounds of a variable of its type.
    fn is_allowed(self, domain: &Domain) -> bool {
        match (self, domain) {
            (Self::Real(value), Domain::Real { min, max, .. }) => {
                value.is_finite() && *min <= value && value <= *max
            }
            (Self::Integer(value), Domain::Integer { range, .. }) => {
                range.0 <= value && value <= range.1
            }
            (Self::Integer(value), Domain::Enumeration { items, .. }) => {
                usize::try_from(value).is_ok_and(|index| (1..=items.items.len()).contains(&index))
            }
            (Self::Boolean(value), _) => value == 0 || value == 1,
            _ => true,
        }
    }
}

/// Describes the values that a variable may have.
fn expected(domain: &Domain) -> String {
    match domain {
        Domain::Real { min, max, unit, .. } => {
            let bounds = match (min.is_finite(), max.is_finite()) {
                (true, true) => format!(" from {min} to {max}"),
                (true, false) => format!(" of at least {min}"),
                (false, true) => format!(" of at most {max}"),
                (false, false) => String::new(),
            };
            format!("a finite number{bounds} [{}]", unit.name)
        }
        Domain::Integer { range, .. } => {
            format!("a whole number from {} to {}", range.0, range.1)
        }
        Domain::Enumeration { items, .. } => (1..)
            .zip(items.items)
            .map(|(index, (name, _)): (i32, _)| format!("{index} ({name})"))
            .collect::<Vec<_>>()
            .join(", "),
        Domain::Boolean { .. } => "0 (false) or 1 (true)".into(),
    }
}

/// Reads the values with the given references, all or none.
pub(crate) fn get<V: Value>(
    slave: &mut dyn Slave,
    references: &[u32],
    values: &mut [V],
) -> Result<(), Reason> {
    // Several are checked before the first value is written; a single one need not be.
    if references.len() > 1 {
        for &reference in references {
            read::<V>(slave, reference)?;
        }
    }
    for (&reference, value) in references.iter().zip(values) {
        *value = read(slave, reference)?;
    }
    Ok(())
}

fn read<V: Value>(slave: &mut dyn Slave, reference: u32) -> Result<V, Reason> {
    match slave.find(reference) {
        Some(scalar) => V::read(&scalar.value).ok_or_else(|| wrong_type(&scalar, V::TYPE)),
        None => Err(unknown(slave, reference)),
    }
}

/// Writes all values or none. `running` is true after initialization.
pub(crate) fn set<V: Value>(
    slave: &mut dyn Slave,
    references: &[u32],
    values: &[V],
    running: bool,
) -> Result<(), Reason> {
    for (&reference, &value) in references.iter().zip(values) {
        check(slave, reference, value.given(), running)?;
    }
    for (&reference, &value) in references.iter().zip(values) {
        if let Some(scalar) = slave.find(reference) {
            value.write(scalar.value);
        }
    }
    Ok(())
}

/// Checks that a value may be written.
fn check(slave: &mut dyn Slave, reference: u32, value: Given, running: bool) -> Result<(), Reason> {
    let Some(scalar) = slave.find(reference) else {
        return Err(unknown(slave, reference));
    };
    if !value.fits(&scalar.value) {
        return Err(wrong_type(&scalar, value.type_name()));
    }
    let (name, domain) = (scalar.name(), &scalar.info.domain);
    if let Some(why) = not_settable(scalar.info, running) {
        return Err(reason!("{name} is {why}"));
    }
    if !value.is_allowed(domain) {
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
            Some(scalar) if scalar.info.causality != causality => {
                let name = scalar.name();
                return Err(reason!("{name} is not {expected}"));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

/// Rejects all references, as no variable is a String.
pub(crate) fn no_string(slave: &mut dyn Slave, references: &[u32]) -> Result<(), Reason> {
    let Some(&reference) = references.first() else {
        return Ok(());
    };
    Err(match slave.find(reference).map(|scalar| scalar.name()) {
        Some(name) => reason!("{name} is not a String"),
        None => unknown(slave, reference),
    })
}

/// Why the host may not set the variable now; `None` if it may.
fn not_settable(info: &Info, running: bool) -> Option<&'static str> {
    match (info.causality, info.variability) {
        (Causality::Output, _) => Some("an output, which only the model sets"),
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
    let actual = match scalar.info.domain {
        Domain::Real { .. } => "Real",
        Domain::Integer { .. } => "Integer",
        Domain::Boolean { .. } => "Boolean",
        Domain::Enumeration { .. } => "Enumeration, which is accessed as Integer",
    };
    let name = scalar.name();
    reason!("{name} is of type {actual}, not {requested}")
}
