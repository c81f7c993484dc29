//! Reads and writes the values of a slave, and reports why an access is rejected.

use std::ffi::CStr;
use std::fmt;

use fmu_description::{Causality, Domain, Dynamics, Value, Variability, Variable, words};

use crate::lifecycle::Mode;
use crate::phase::Phase;
use crate::reason::{Reason, reason};
use crate::slave::{Scalar, Slave};

/// Versions of the standard, whose functions have different types.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Version {
    /// Real, Integer (of 32 bits), Boolean and String.
    Fmi2,
    /// A type for each size of numbers, and Binary.
    Fmi3,
}

/// The functions that access one type, such as `fmi2GetReal` and `fmi2SetReal`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Access {
    version: Version,
    /// Name of the type.
    name: &'static str,
}

impl Access {
    /// The functions for variables of a domain; `None` if this version has none.
    fn of(domain: &Domain, version: Version) -> Option<Self> {
        let is_old = version == Version::Fmi2;
        let name = match domain {
            Domain::Real { .. } if is_old => "Real",
            Domain::Integer { .. } | Domain::Enumeration { .. } if is_old => "Integer",
            Domain::Binary { .. } if is_old => return None,
            Domain::Real { start, .. } if start.are_single() => "Float32",
            Domain::Real { .. } => "Float64",
            Domain::Integer { start, .. } => start.kind().as_str(),
            Domain::Enumeration { .. } => "Int64",
            Domain::Boolean { .. } => "Boolean",
            Domain::String { .. } => "String",
            Domain::Binary { .. } => "Binary",
        };
        Some(Self { version, name })
    }

    /// Checks that these functions access a variable.
    fn check(self, scalar: &Scalar<'_>) -> Result<(), Reason> {
        match Self::of(&scalar.variable().domain, self.version) == Some(self) {
            true => Ok(()),
            false => Err(wrong_type(scalar, self)),
        }
    }
}

/// A type of the FMI functions that read values.
pub(crate) trait FmiType: Sized {
    const ACCESS: Access;

    /// The value of a variable with this access; `None` if it is beyond the range of the type.
    fn of(value: Value) -> Option<Self>;
}

/// Implements [`FmiType`], and the conversion of what the host passes to [`Given`].
macro_rules! types {
    ($($version:ident $name:ident
        $read:ty: $variant:ident($value:pat) => $of:expr,
        $given:ty: $passed:pat => $raw:expr;)*) => {
        $(
            impl FmiType for $read {
                const ACCESS: Access = Access {
                    version: Version::$version,
                    name: stringify!($name),
                };

                fn of(value: Value) -> Option<Self> {
                    match value {
                        Value::$variant($value) => $of,
                        _ => None,
                    }
                }
            }

            impl<'a> From<$given> for Given<'a> {
                fn from($passed: $given) -> Self {
                    Self {
                        access: <$read>::ACCESS,
                        raw: $raw,
                    }
                }
            }
        )*
    };
}

types! {
    Fmi3 Float64 f64: Real(v) => Some(v), f64: v => Raw::Real(v);
    Fmi3 Float32 f32: Real(v) => Some(v as Self), f32: v => Raw::Real(v.into());
    Fmi3 Int8 i8: Integer(v) => v.try_into().ok(), i8: v => Raw::Integer(v.into());
    Fmi3 UInt8 u8: Integer(v) => v.try_into().ok(), u8: v => Raw::Integer(v.into());
    Fmi3 Int16 i16: Integer(v) => v.try_into().ok(), i16: v => Raw::Integer(v.into());
    Fmi3 UInt16 u16: Integer(v) => v.try_into().ok(), u16: v => Raw::Integer(v.into());
    Fmi3 Int32 i32: Integer(v) => v.try_into().ok(), i32: v => Raw::Integer(v.into());
    Fmi3 UInt32 u32: Integer(v) => v.try_into().ok(), u32: v => Raw::Integer(v.into());
    Fmi3 Int64 i64: Integer(v) => v.try_into().ok(), i64: v => Raw::Integer(v.into());
    Fmi3 UInt64 u64: Integer(v) => v.try_into().ok(), u64: v => Raw::Integer(v.into());
    Fmi3 Boolean fmi3::Boolean: Boolean(v) => Some(Self(v.into())),
        fmi3::Boolean: fmi3::Boolean(v) => Raw::Boolean(v.into());
    Fmi3 String String: String(v) => Some(v), Option<&'a CStr>: v => Raw::String(v);
    Fmi3 Binary Vec<u8>: Binary(v) => Some(v), Option<&'a [u8]>: v => Raw::Binary(v);
    Fmi2 Real fmi2::Real: Real(v) => Some(Self(v)), fmi2::Real: fmi2::Real(v) => Raw::Real(v);
    Fmi2 Integer fmi2::Integer: Integer(v) => v.try_into().ok().map(Self),
        fmi2::Integer: fmi2::Integer(v) => Raw::Integer(v.into());
    Fmi2 Boolean fmi2::Boolean: Boolean(v) => Some(Self(v.into())),
        fmi2::Boolean: fmi2::Boolean(v) => Raw::Boolean(v);
    Fmi2 String fmi2::Text<String>: String(v) => Some(Self(v)),
        fmi2::Text<Option<&'a CStr>>: fmi2::Text(v) => Raw::String(v);
}

/// The types of FMI 2.0.
pub(crate) mod fmi2 {
    /// An `fmi2Real`.
    #[derive(Clone, Copy)]
    #[repr(transparent)]
    pub(crate) struct Real(pub(crate) f64);

    /// An `fmi2Integer`.
    #[derive(Clone, Copy)]
    #[repr(transparent)]
    pub(crate) struct Integer(pub(crate) i32);

    /// An `fmi2Boolean`: 0 or 1.
    #[derive(Clone, Copy)]
    #[repr(transparent)]
    pub(crate) struct Boolean(pub(crate) i32);

    /// An `fmi2String`.
    #[derive(Clone, Copy, Default)]
    pub(crate) struct Text<T>(pub(crate) T);

    impl From<Text<Self>> for String {
        fn from(text: Text<Self>) -> Self {
            text.0
        }
    }
}

/// The types of FMI 3.0 that are not those of Rust.
pub(crate) mod fmi3 {
    /// An `fmi3Boolean`: 0 or 1.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    #[repr(transparent)]
    pub(crate) struct Boolean(pub(crate) u8);
}

/// A value from the host.
#[derive(Clone, Copy)]
pub(crate) struct Given<'a> {
    access: Access,
    raw: Raw<'a>,
}

#[derive(Clone, Copy)]
enum Raw<'a> {
    Real(f64),
    Integer(i128),
    Boolean(i32),
    /// A text, `None` for NULL.
    String(Option<&'a CStr>),
    /// Bytes, `None` for NULL.
    Binary(Option<&'a [u8]>),
}

impl fmt::Display for Given<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.raw {
            Raw::Real(value) => value.fmt(f),
            Raw::Integer(value) => value.fmt(f),
            Raw::Boolean(value) => value.fmt(f),
            Raw::String(Some(text)) => fmt::Debug::fmt(text, f),
            Raw::String(None) => f.write_str("NULL"),
            Raw::Binary(Some(bytes)) => write!(f, "{} bytes", bytes.len()),
            Raw::Binary(None) => f.write_str("NULL"),
        }
    }
}

impl Given<'_> {
    /// The value, if it is within the bounds of a variable of its type.
    fn within(self, domain: &Domain) -> Option<Value> {
        let value = match self.raw {
            Raw::Real(value) => Value::Real(match domain {
                // What will be stored.
                Domain::Real { start, .. } if start.are_single() => f64::from(value as f32),
                _ => value,
            }),
            Raw::Integer(value) => Value::Integer(value),
            Raw::Boolean(value @ (0 | 1)) => Value::Boolean(value == 1),
            Raw::Boolean(_) => return None,
            Raw::String(text) => Value::String(text?.to_str().ok()?.to_owned()),
            Raw::Binary(bytes) => Value::Binary(bytes?.to_owned()),
        };
        let is_allowed = match (&value, domain) {
            (Value::Real(value), Domain::Real { min, max, .. }) => {
                value.is_finite() && min <= value && value <= max
            }
            (Value::Integer(value), Domain::Integer { min, max, .. }) => {
                min <= value && value <= max
            }
            (Value::Integer(value), Domain::Enumeration { items, .. }) => {
                let mut items = items.items.iter();
                items.any(|item| i128::from(item.value) == *value)
            }
            _ => true,
        };
        is_allowed.then_some(value)
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
        Domain::Binary { .. } => "bytes".into(),
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
    let scalar = find(slave, reference, T::ACCESS)?;
    let value = scalar.value.get();
    T::of(value).ok_or_else(|| does_not_fit(&scalar))
}

/// The variable with the given reference, if the functions access it.
fn find(slave: &mut dyn Slave, reference: u32, access: Access) -> Result<Scalar<'_>, Reason> {
    let count = slave.count();
    let is_known = access.version == Version::Fmi3 || slave.is_in_fmi2(reference);
    let scalar = slave.find(reference).filter(|_| is_known);
    let scalar = scalar.ok_or_else(|| unknown_of(count, reference))?;
    access.check(&scalar)?;
    Ok(scalar)
}

/// When a host sets values, which decides about what it may set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Moment {
    /// Before the end of the initialization.
    Start,
    /// Between steps, or in event mode of co-simulation.
    Running,
    /// In event mode of model exchange.
    Event,
    /// Between events of model exchange.
    ContinuousTime,
    /// Within a step.
    IntermediateUpdate,
    /// In configuration mode.
    Configuration,
    /// In reconfiguration mode.
    Reconfiguration,
}

impl Moment {
    pub(crate) fn of(phase: Phase, mode: Mode) -> Self {
        match phase {
            Phase::Instantiated | Phase::Initialization => Self::Start,
            Phase::Event if mode == Mode::ModelExchange => Self::Event,
            Phase::ContinuousTime => Self::ContinuousTime,
            Phase::IntermediateUpdate => Self::IntermediateUpdate,
            Phase::Configuration => Self::Configuration,
            Phase::StepReconfiguration | Phase::EventReconfiguration => Self::Reconfiguration,
            _ => Self::Running,
        }
    }
}

/// Writes all values or none.
pub(crate) fn set<'a, T: Into<Given<'a>> + Copy>(
    slave: &mut dyn Slave,
    references: &[u32],
    values: &[T],
    moment: Moment,
) -> Result<(), Reason> {
    for (&reference, &value) in references.iter().zip(values) {
        check(slave, reference, value.into(), moment)?;
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
    moment: Moment,
) -> Result<(), Reason> {
    let scalar = find(slave, reference, value.access)?;
    let (name, domain) = (scalar.name(), &scalar.variable().domain);
    if let Some(why) = not_settable(scalar.variable(), moment) {
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

/// The value references of all elements of variables of FMI 3.0, which are accessed with `n_values`
/// values. That of the independent variable follows those of all others.
pub(crate) fn elements(
    slave: &mut dyn Slave,
    references: &[u32],
    n_values: usize,
) -> Result<Vec<u32>, Reason> {
    let mut elements = Vec::with_capacity(n_values);
    for &reference in references {
        let count = match slave.elements(reference) {
            _ if reference as usize == slave.count() => 1,
            Some(count) => count as u32,
            None => return Err(reason!("value reference {reference} is unknown")),
        };
        elements.extend(reference..reference + count);
    }
    let count = elements.len();
    match count == n_values {
        true => Ok(elements),
        false => Err(reason!(
            "there are {n_values} values; expected {count}, the number of elements of the variables"
        )),
    }
}

/// Reads scalars and the independent variable, all or none.
pub(crate) fn get_elements<T: FmiType>(
    slave: &mut dyn Slave,
    time: f64,
    references: &[u32],
    values: &mut [T],
) -> Result<(), Reason> {
    let independent = slave.count() as u32;
    let mut element = |reference| match reference == independent {
        true => match T::ACCESS == f64::ACCESS {
            true => T::of(Value::Real(time)).ok_or_else(|| "time is of type Float64".into()),
            false => Err(reason!("time is of type Float64, not {}", T::ACCESS.name)),
        },
        false => read(slave, reference),
    };
    if references.len() > 1 {
        for &reference in references {
            element(reference)?;
        }
    }
    for (&reference, value) in references.iter().zip(values) {
        *value = element(reference)?;
    }
    Ok(())
}

/// Whether any of the variables is computed only when a host asks for it.
pub(crate) fn has_derivatives(slave: &mut dyn Slave, references: &[u32]) -> bool {
    references.iter().any(|&reference| {
        slave.find(reference).is_some_and(|scalar| {
            let dynamics = scalar.variable().dynamics;
            matches!(
                dynamics,
                Dynamics::Derivative { .. } | Dynamics::EventIndicator
            )
        })
    })
}

/// The value references of the first time derivatives of outputs.
pub(crate) fn output_derivatives(
    slave: &mut dyn Slave,
    references: &[u32],
    orders: &[i32],
) -> Result<Vec<u32>, Reason> {
    let mut derivatives = Vec::with_capacity(references.len());
    for (&reference, &order) in references.iter().zip(orders) {
        let Some(scalar) = slave.find(reference) else {
            return Err(unknown(slave, reference));
        };
        let (name, causality) = (scalar.name(), scalar.variable().causality);
        if causality != Causality::Output {
            return Err(reason!("{name} is not an output"));
        }
        if order != 1 {
            return Err(reason!(
                "the derivative of {name} is of order {order}; expected 1"
            ));
        }
        let derivative = slave.derivative_of(reference);
        derivatives
            .push(derivative.ok_or_else(|| reason!("the derivative of {name} is not known"))?);
    }
    Ok(derivatives)
}

/// The derivatives of unknowns with respect to knowns: in co-simulation, of outputs with respect to
/// inputs; in model exchange, of outputs and derivatives with respect to inputs and states.
pub(crate) struct Jacobian<'a> {
    slave: &'a mut dyn Slave,
    mode: Mode,
    unknowns: &'a [u32],
    knowns: &'a [u32],
}

impl<'a> Jacobian<'a> {
    /// Checks the variables.
    pub(crate) fn new(
        slave: &'a mut dyn Slave,
        mode: Mode,
        access: Access,
        unknowns: &'a [u32],
        knowns: &'a [u32],
    ) -> Result<Self, Reason> {
        if !slave.has_directional_derivatives() {
            return Err(
                "the model has no derivatives: providesDirectionalDerivative is false".into(),
            );
        }
        let is_exchange = mode == Mode::ModelExchange;
        for &reference in unknowns {
            check_part(
                slave,
                reference,
                access,
                match is_exchange {
                    true => "an output, a derivative or an event indicator",
                    false => "an output",
                },
                |variable| {
                    let is_equation = !matches!(
                        variable.dynamics,
                        Dynamics::Algebraic | Dynamics::State { .. }
                    );
                    variable.causality == Causality::Output || is_exchange && is_equation
                },
            )?;
        }
        for &reference in knowns {
            check_part(
                slave,
                reference,
                access,
                match is_exchange {
                    true => "an input or a state",
                    false => "an input",
                },
                |variable| {
                    let is_state = matches!(variable.dynamics, Dynamics::State { .. });
                    variable.causality == Causality::Input || is_exchange && is_state
                },
            )?;
        }
        Ok(Self {
            slave,
            mode,
            unknowns,
            knowns,
        })
    }

    /// One derivative.
    fn element(&mut self, unknown: u32, known: u32) -> f64 {
        let is_state = self.mode == Mode::ModelExchange
            && self
                .slave
                .find(unknown)
                .is_some_and(|scalar| matches!(scalar.variable().dynamics, Dynamics::State { .. }));
        match is_state {
            true => f64::from(u8::from(unknown == known)),
            false => self.slave.derivative(unknown, known),
        }
    }

    /// The directional derivative: the product with a direction of the knowns.
    pub(crate) fn times(
        &mut self,
        direction: &[f64],
        derivatives: &mut [f64],
    ) -> Result<(), Reason> {
        check_direction(direction)?;
        let (unknowns, knowns) = (self.unknowns, self.knowns);
        for (&unknown, derivative) in unknowns.iter().zip(derivatives) {
            *derivative = (knowns.iter().zip(direction))
                .map(|(&known, change)| self.element(unknown, known) * change)
                .sum();
        }
        Ok(())
    }

    /// The adjoint derivative: the product of a direction of the unknowns with it.
    pub(crate) fn adjoint(
        &mut self,
        direction: &[f64],
        derivatives: &mut [f64],
    ) -> Result<(), Reason> {
        check_direction(direction)?;
        let (unknowns, knowns) = (self.unknowns, self.knowns);
        for (&known, derivative) in knowns.iter().zip(derivatives) {
            *derivative = (unknowns.iter().zip(direction))
                .map(|(&unknown, change)| self.element(unknown, known) * change)
                .sum();
        }
        Ok(())
    }
}

fn check_direction(direction: &[f64]) -> Result<(), Reason> {
    match direction.iter().find(|change| !change.is_finite()) {
        Some(&change) => Err(reason!(
            "the direction contains {change}; expected finite numbers"
        )),
        None => Ok(()),
    }
}

/// Checks that a variable is a Real with a part in the Jacobian.
fn check_part(
    slave: &mut dyn Slave,
    reference: u32,
    access: Access,
    expected: &'static str,
    has_part: impl FnOnce(&Variable) -> bool,
) -> Result<(), Reason> {
    match slave.find(reference) {
        None => Err(unknown(slave, reference)),
        Some(scalar) if !has_part(scalar.variable()) => {
            let name = scalar.name();
            Err(reason!("{name} is not {expected}"))
        }
        Some(scalar) => access.check(&scalar),
    }
}

/// Why the host may not set the variable now; `None` if it may.
fn not_settable(variable: &Variable, moment: Moment) -> Option<&'static str> {
    match (variable.causality, variable.variability) {
        (_, Variability::Constant) => Some("a constant"),
        // The standard has a function for all states; some hosts, such as CasADi, set them one by one.
        _ if matches!(variable.dynamics, Dynamics::State { .. })
            && matches!(moment, Moment::Event | Moment::ContinuousTime) =>
        {
            None
        }
        (Causality::Output, _) => Some("an output, which only the model sets"),
        (Causality::Local, _) => Some("a local variable, which only the model sets"),
        (Causality::StructuralParameter, variability) => match moment {
            Moment::Configuration => None,
            Moment::Reconfiguration if variability == Variability::Tunable => None,
            Moment::Reconfiguration => {
                Some("a fixed structural parameter, which cannot be set after the initialization")
            }
            _ => Some("a structural parameter, which is set in configuration mode"),
        },
        _ if matches!(moment, Moment::Configuration | Moment::Reconfiguration) => {
            Some("no structural parameter, which is all that can be set in configuration mode")
        }
        (_, Variability::Fixed) if moment != Moment::Start => {
            Some("a fixed parameter, which cannot be set after the initialization")
        }
        (causality, variability)
            if matches!(moment, Moment::ContinuousTime | Moment::IntermediateUpdate)
                && (causality, variability) != (Causality::Input, Variability::Continuous) =>
        {
            Some("not a continuous input, which is all that can be set between events")
        }
        _ => None,
    }
}

#[cold]
fn unknown(slave: &dyn Slave, reference: u32) -> Reason {
    unknown_of(slave.count(), reference)
}

#[cold]
fn unknown_of(count: usize, reference: u32) -> Reason {
    let last = count.saturating_sub(1);
    reason!("value reference {reference} is unknown; expected 0 to {last}")
}

/// Why a value of a variable of the right type cannot be read: only FMI 2.0 has too few types.
#[cold]
fn does_not_fit(scalar: &Scalar<'_>) -> Reason {
    let name = scalar.name();
    match scalar.value.get() {
        Value::Integer(value) => reason!(
            "{name} = {value} does not fit into an Integer of FMI 2.0; expected a value from {} to {}",
            i32::MIN,
            i32::MAX
        ),
        _ => reason!("{name} has a value that does not fit into its type"),
    }
}

#[cold]
fn wrong_type(scalar: &Scalar<'_>, requested: Access) -> Reason {
    let domain = &scalar.variable().domain;
    let name = scalar.name();
    let requested_name = requested.name;
    match (Access::of(domain, requested.version), domain) {
        (None, _) => reason!("{name} is of type Binary, which is not available in FMI 2.0"),
        (Some(access), Domain::Enumeration { .. }) => reason!(
            "{name} is of type Enumeration, which is accessed as {}, not {requested_name}",
            access.name
        ),
        (Some(access), _) => {
            reason!("{name} is of type {}, not {requested_name}", access.name)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bound::Bound;
    use crate::prelude::*;
    use crate::{Entry, interface};

    /// A variable of each type
    #[derive(Model)]
    #[model(crate = crate)]
    struct Types {
        /// double precision
        #[input]
        double: f64,
        /// single precision
        #[input(max = 10)]
        single: f32,
        /// eight bits
        #[input(min = -3)]
        small: i8,
        /// sixty-four bits
        #[input]
        large: u64,
        /// an item
        #[parameter]
        way: Way,
        /// a flag
        #[input]
        flag: bool,
        /// a text
        #[parameter]
        text: String,
        /// bytes
        #[input(start = b"\x00\xff")]
        bytes: Vec<u8>,
    }

    /// Which way
    #[derive(Clone, Copy, Choice)]
    #[choice(crate = crate)]
    enum Way {
        /// left
        Left,
        /// right
        Right = 300,
    }

    impl Simulate for Types {
        fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
            Ok(())
        }
    }

    const COUNT: usize = <Types as Variables>::COUNT;
    static ENTRY: Entry = Entry::of::<Types, COUNT>(interface::<Types, COUNT>(None), &[]);

    fn slave() -> Bound<Types, COUNT> {
        Bound::new(&ENTRY)
    }

    fn refused(outcome: Result<(), Reason>) -> String {
        outcome
            .err()
            .map(|reason| reason.text())
            .unwrap_or_default()
    }

    #[track_caller]
    fn assert_round_trip<'a, T>(reference: u32, given: impl Into<Given<'a>> + Copy, expected: T)
    where
        T: FmiType + Default + PartialEq + fmt::Debug,
    {
        let mut slave = slave();
        assert_eq!(
            refused(set(&mut slave, &[reference], &[given], Moment::Running)),
            ""
        );
        let mut read = [T::default()];
        assert_eq!(refused(get(&mut slave, &[reference], &mut read)), "");
        assert_eq!(read, [expected]);
    }

    #[test]
    fn fmi_3_accesses_each_variable_by_its_own_type() {
        assert_round_trip(0, 0.1f64, 0.1f64);
        assert_round_trip(1, 0.1f32, 0.1f32);
        assert_round_trip(2, -3i8, -3i8);
        assert_round_trip(3, u64::MAX, u64::MAX);
        assert_round_trip(5, fmi3::Boolean(1), fmi3::Boolean(1));
        assert_round_trip(7, Some(&b"\x01\x00"[..]), b"\x01\x00".to_vec());
        let mut slave = slave();
        assert_eq!(refused(set(&mut slave, &[4], &[300i64], Moment::Start)), "");
        let mut item = [0i64];
        assert_eq!(refused(get(&mut slave, &[4], &mut item)), "");
        assert_eq!(item, [300]);
        let mut bytes = [vec![]];
        assert_eq!(refused(get(&mut slave, &[7], &mut bytes)), "");
        assert_eq!(bytes, [b"\x00\xff"]);
    }

    #[test]
    fn other_types_are_refused_in_the_words_of_the_version() {
        let mut slave = slave();
        for (outcome, expected) in [
            (
                get(&mut slave, &[0], &mut [0f32]),
                "double is of type Float64, not Float32",
            ),
            (
                get(&mut slave, &[1], &mut [0f64]),
                "single is of type Float32, not Float64",
            ),
            (
                get(&mut slave, &[2], &mut [0i32]),
                "small is of type Int8, not Int32",
            ),
            (
                get(&mut slave, &[3], &mut [0i64]),
                "large is of type UInt64, not Int64",
            ),
            (
                get(&mut slave, &[4], &mut [0i32]),
                "way is of type Enumeration, which is accessed as Int64, not Int32",
            ),
            (
                get(&mut slave, &[6], &mut [vec![]]),
                "text is of type String, not Binary",
            ),
            (
                get(&mut slave, &[1], &mut [fmi2::Integer(0)]),
                "single is of type Real, not Integer",
            ),
        ] {
            assert_eq!(refused(outcome), expected);
        }
    }

    #[test]
    fn values_outside_the_bounds_are_refused() {
        let mut slave = slave();
        for (outcome, expected) in [
            (
                set(&mut slave, &[1], &[10.5f32], Moment::Running),
                "single = 10.5 is refused",
            ),
            (
                set(&mut slave, &[1], &[f32::NAN], Moment::Running),
                "single = NaN is refused",
            ),
            (
                set(&mut slave, &[2], &[-4i8], Moment::Running),
                "small = -4 is refused; expected a whole number from -3 to 127",
            ),
            (
                set(&mut slave, &[4], &[2i64], Moment::Start),
                "way = 2 is refused",
            ),
        ] {
            let refused = refused(outcome);
            assert!(refused.starts_with(expected), "{refused}");
        }
    }

    /// Arrays of variable size
    #[derive(Model)]
    #[model(crate = crate)]
    struct Lists {
        /// number of gains
        #[structural_parameter(start = 2, min = 1, max = 3, tunable)]
        n: u64,
        /// number of names
        #[structural_parameter(start = 1, max = 2)]
        m: u64,
        /// gains
        #[input(size = "n", start = [1, 2, 3])]
        gains: [f64; 3],
        /// names
        #[parameter(size = "m")]
        names: [String; 2],
        /// sum
        #[output]
        sum: f64,
        changes: u64,
    }

    impl Simulate for Lists {
        fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
            self.sum = self.gains[..self.n as usize].iter().sum();
            Ok(())
        }

        fn reconfigure(&mut self) -> Result<(), ModelError> {
            self.changes += 1;
            Ok(())
        }
    }

    const N_LISTS: usize = <Lists as Variables>::COUNT;
    static LISTS: Entry = Entry::of::<Lists, N_LISTS>(interface::<Lists, N_LISTS>(None), &[]);

    #[test]
    fn structural_parameters_are_set_in_their_modes_only() {
        let mut slave: Bound<Lists, N_LISTS> = Bound::new(&LISTS);
        let [n, m, gain] = [0, 1, 2];
        for (reference, moment, expected) in [
            (
                n,
                Moment::Start,
                "n is a structural parameter, which is set in configuration mode",
            ),
            (
                n,
                Moment::Running,
                "n is a structural parameter, which is set in configuration mode",
            ),
            (n, Moment::Configuration, ""),
            (n, Moment::Reconfiguration, ""),
            (m, Moment::Configuration, ""),
            (
                m,
                Moment::Reconfiguration,
                "m is a fixed structural parameter, which cannot be set after the initialization",
            ),
        ] {
            assert_eq!(
                refused(set(&mut slave, &[reference], &[1u64], moment)),
                expected
            );
        }
        let outcome = set(&mut slave, &[n], &[4u64], Moment::Configuration);
        assert_eq!(
            refused(outcome),
            "n = 4 is refused; expected a whole number from 1 to 3"
        );
        let outcome = set(&mut slave, &[gain], &[1.0], Moment::Configuration);
        assert!(refused(outcome).starts_with("gains[1] is no structural parameter"));
    }

    #[test]
    fn arrays_have_as_many_elements_as_their_structural_parameters_say() {
        let mut slave: Bound<Lists, N_LISTS> = Bound::new(&LISTS);
        let sizes = |slave: &mut Bound<Lists, N_LISTS>| -> Vec<_> {
            (0..N_LISTS as u32).map(|r| slave.elements(r)).collect()
        };
        let one = Some(1);
        let expected = [one, one, Some(2), None, None, one, None, one];
        assert_eq!(sizes(&mut slave), expected);
        assert!(!slave.get_arrays(&[2], &mut [0.0; 3]));
        set(&mut slave, &[0, 1], &[3u64, 2], Moment::Configuration)
            .ok()
            .unwrap();
        let expected = [one, one, Some(3), None, None, Some(2), None, one];
        assert_eq!(sizes(&mut slave), expected);
        let mut gains = [0.0; 3];
        assert!(slave.get_arrays(&[2], &mut gains));
        assert_eq!(gains, [1.0, 2.0, 3.0]);
        assert!(slave.set_arrays(&[2], &[5.0, 6.0, 7.0]));
        assert!(!slave.set_arrays(&[2], &[5.0, 6.0]));
        slave.step(0.0, 1.0).unwrap();
        let mut sum = [0.0];
        assert!(slave.get_arrays(&[7], &mut sum));
        assert_eq!(sum, [18.0]);
    }

    #[test]
    fn fmi_2_has_the_elements_that_are_in_use() {
        let mut slave: Bound<Lists, N_LISTS> = Bound::new(&LISTS);
        let known: Vec<_> = (0..9).filter(|&r| slave.is_in_fmi2(r)).collect();
        assert_eq!(known, [2, 3, 5, 7]);
        assert!(slave.get_reals(&[3, 7], &mut [0.0; 2]));
        assert!(!slave.get_reals(&[4], &mut [0.0]));
        assert!(slave.set_reals(&[3], &[0.5]));
        assert!(!slave.set_reals(&[4], &[0.5]));
        let unknown = "value reference 4 is unknown; expected 0 to 7";
        let outcome = get(&mut slave, &[4], &mut [fmi2::Real(0.0)]);
        assert_eq!(refused(outcome), unknown);
        let outcome = set(&mut slave, &[4], &[fmi2::Real(0.0)], Moment::Running);
        assert_eq!(refused(outcome), unknown);
        let outcome = get(&mut slave, &[0], &mut [fmi2::Integer(0)]);
        assert!(refused(outcome).contains("is unknown"));
    }

    #[test]
    fn a_variant_may_use_fewer_elements() {
        static SMALL: Entry = Entry::of::<Lists, N_LISTS>(
            interface::<Lists, N_LISTS>(Some("Lists=Small;0:i1:1")),
            &[],
        );
        let mut slave: Bound<Lists, N_LISTS> = Bound::new(&SMALL);
        assert_eq!(slave.elements(2), Some(1));
        assert!(!slave.get_reals(&[3], &mut [0.0]));
        assert!(!slave.set_reals(&[3], &[0.0]));
        let outcome = get(&mut slave, &[3], &mut [fmi2::Real(0.0)]);
        assert!(refused(outcome).contains("is unknown"));
        let mut gain = [fmi2::Real(0.0)];
        assert_eq!(refused(get(&mut slave, &[2], &mut gain)), "");
        assert_eq!(gain[0].0, 1.0);
    }

    #[test]
    fn the_model_is_told_of_new_sizes() {
        let mut slave: Bound<Lists, N_LISTS> = Bound::new(&LISTS);
        assert!(slave.has_structural_parameter(Variability::Fixed));
        assert!(slave.has_structural_parameter(Variability::Tunable));
        slave.reconfigure().unwrap();
        let saved = slave.save();
        let saved = slave.serialize(&*saved).unwrap();
        // The last field.
        assert_eq!(saved.last(), Some(&1));
        let slave = Bound::<Types, COUNT>::new(&ENTRY);
        assert!(!slave.has_structural_parameter(Variability::Fixed));
    }
}
