//! Getting and setting variables of all types, and why an access is refused.

use std::borrow::Cow;
use std::fmt::Display;

use fmi_abi::FmiVersion;
use fmi_abi::state::{RECONFIGURATION, RUNNING, State};
use fmu_description::ScalarVariable;
use fmu_description::table::{Bounds, Declaration};
use fmu_description::value::Whole;
use fmu_description::{Causality, Dynamics, Number, Type, Value, Variability};

use crate::error::{ModelError, ensure, refused};
use crate::instance::{Instance, Shared};
use crate::layout::has_own_start;
use crate::lifecycle::{InstanceType, Lifecycle};

/// A value from the host, which a number of another type may stand for.
pub(crate) enum HostValue {
    Real(f64),
    Whole(i128),
    /// Anything else, or how to show what is no value.
    Other(Result<Value, String>),
}

impl HostValue {
    /// The value, if a variable may have it; otherwise, how to show what was given.
    fn within(self, field: &Declaration) -> Result<Value, String> {
        let of_type = field.start.of_type();
        let (number, whole);
        let (value, shown): (_, &dyn Display) = match self {
            Self::Real(value) => {
                number = Number(value);
                (Value::real(of_type, value), &number)
            }
            Self::Whole(value) => {
                whole = Whole(value);
                (Value::whole(of_type, value), &whole)
            }
            Self::Other(Ok(Value::Binary(bytes))) => {
                let (size, value) = (bytes.len(), Value::Binary(bytes));
                return match field.bounds.contain(&value) {
                    true => Ok(value),
                    false => Err(format!("{size} bytes")),
                };
            }
            Self::Other(value) => return value,
        };
        let mut items = field.start.items().iter();
        let is_allowed = |value: &Value| match value {
            Value::Enumeration(number) => items.any(|item| i64::from(item.value) == *number),
            _ => field.bounds.contain(value),
        };
        value.filter(is_allowed).ok_or_else(|| shown.to_string())
    }
}

/// Describes the values that a variable may have.
fn expected(field: &Declaration) -> String {
    if let Some(numbers) = field.bounds.expected("a finite number", field.unit) {
        return numbers;
    }
    match field.start.of_type() {
        Type::Boolean => "0 (false) or 1 (true)".into(),
        Type::String => "a text in UTF-8".into(),
        Type::Binary => "bytes".into(),
        _ => {
            let items = field.start.items().iter();
            let texts: Vec<_> =
                items.map(|item| format!("{} ({})", item.value, item.name)).collect();
            texts.join(", ")
        }
    }
}

impl Instance {
    /// Gets variables by the functions of a type, which have `n` elements together. All are checked before
    /// `put` receives the first element with its value, which is of this type.
    pub(crate) fn get_of_type(
        &mut self,
        of_type: Type,
        references: &[u32],
        n: usize,
        put: &mut dyn FnMut(usize, Value),
    ) -> Result<(), ModelError> {
        self.check_announced(references)?;
        if let Some(clocks) = self.shared.clocks() {
            clocks.before_get(self, references)?;
        }
        let elements = self.element_references(references, n)?;
        let needs_evaluation = self.model.has_derivatives(references);
        let saved = self.prepare_values(needs_evaluation)?;
        let got = self.get_elements(of_type, &elements, put);
        if let Some(saved) = saved {
            self.model.assign(saved.as_ref());
        }
        got
    }

    /// Gets scalars and elements of arrays that are up to date.
    pub(crate) fn get_elements(
        &mut self,
        of_type: Type,
        elements: &[u32],
        put: &mut dyn FnMut(usize, Value),
    ) -> Result<(), ModelError> {
        // Several are checked before the first value is written; a single one need not be.
        if elements.len() > 1 {
            for &element in elements {
                self.value(of_type, element)?;
            }
        }
        for (i, &element) in elements.iter().enumerate() {
            put(i, self.value(of_type, element)?);
        }
        Ok(())
    }

    /// The value of an element, in the type of the functions that access it.
    fn value(&mut self, of_type: Type, element: u32) -> Result<Value, ModelError> {
        if self.is_time(element) {
            return match of_type {
                Type::Float64 => Ok(Value::Float64(self.shared.lifecycle.now())),
                other => refused!("time is of type Float64, not {}", other.as_str()),
            };
        }
        let scalar = self.scalar_of_type(of_type, element)?;
        let value = self.model.get(&scalar);
        if let (Value::Binary(bytes), Bounds::Size(max)) = (&value, scalar.variable.bounds) {
            let (name, size) = (scalar.name(), bytes.len());
            ensure!(size <= max, "{name} has {size} bytes, more than its maximum size of {max}");
        }
        let fitting = match of_type {
            same if same == value.of_type() => return Ok(value),
            Type::Float64 => value.as_real().map(Value::Float64),
            whole => value.as_whole().and_then(|value| Value::whole(whole, value)),
        };
        fitting.ok_or_else(|| does_not_fit(&scalar, value.as_whole()))
    }

    /// Whether a value reference belongs to the independent variable. FMI
    /// 2.0 has none.
    pub(crate) fn is_time(&self, reference: u32) -> bool {
        self.shared.settings.edge.version == FmiVersion::Fmi3 && reference == self.model.info().time
    }

    /// The scalar or element with a value reference, if the functions of a type access it.
    fn scalar_of_type(
        &mut self,
        of_type: Type,
        reference: u32,
    ) -> Result<ScalarVariable, ModelError> {
        let (version, end) = (self.shared.settings.edge.version, self.model.info().end);
        let scalar = self.model.scalar_at(reference).ok_or_else(|| unknown(end, reference))?;
        ensure!(
            version == FmiVersion::Fmi3 || self.model.is_element(&scalar),
            "{} is not available in FMI 2.0, where the sizes of arrays are fixed",
            scalar.name()
        );
        check_type(&scalar, of_type, version)?;
        Ok(scalar)
    }

    /// The number of elements that are accessed by a value reference; `None` if it is unknown.
    pub(crate) fn elements_accessed(&mut self, reference: u32) -> Option<usize> {
        match self.shared.settings.edge.version {
            FmiVersion::Fmi3 if !self.is_time(reference) => self.model.elements_in_use(reference),
            _ => Some(1),
        }
    }

    /// The value references of all elements of variables, which are accessed with `n` values.
    pub(crate) fn element_references<'a>(
        &mut self,
        references: &'a [u32],
        n: usize,
    ) -> Result<Cow<'a, [u32]>, ModelError> {
        let are_scalars = references.len() == n
            && references.iter().all(|reference| self.elements_accessed(*reference) == Some(1));
        if are_scalars || self.shared.settings.edge.version == FmiVersion::Fmi2 {
            return Ok(references.into());
        }
        let mut elements = Vec::new();
        for &reference in references {
            let Some(count) = self.elements_accessed(reference) else {
                return refused!("value reference {reference} is unknown");
            };
            elements.extend(reference..reference + count as u32);
        }
        let count = elements.len();
        ensure!(
            count == n,
            "values passed: {n}; expected {count}, the number of elements of the variables"
        );
        Ok(elements.into())
    }

    /// Checks that a host accesses the variables that it has announced, in an intermediate update.
    pub(crate) fn check_announced(&self, references: &[u32]) -> Result<(), ModelError> {
        let announced = &self.shared.settings.intermediate_variables;
        let is_announced = |reference: &u32| announced.contains(reference);
        ensure!(
            self.shared.lifecycle.state != State::IntermediateUpdate
                || references.iter().all(is_announced),
            "in an intermediate update, only the required intermediate variables can be accessed"
        );
        Ok(())
    }

    /// Sets variables by the functions of a type, all or none.
    pub(crate) fn set_of_type(
        &mut self,
        of_type: Type,
        references: &[u32],
        n: usize,
        given: &dyn Fn(usize) -> HostValue,
    ) -> Result<(), ModelError> {
        self.check_announced(references)?;
        ensure!(
            !references.iter().any(|&reference| self.is_time(reference)),
            "time is the independent variable, which the host does not set"
        );
        if let Some(clocks) = self.shared.clocks() {
            clocks.before_set(self, references)?;
        }
        let elements = self.element_references(references, n)?;
        for (i, &element) in elements.iter().enumerate() {
            self.check(of_type, element, given(i))?;
        }
        for (i, &element) in elements.iter().enumerate() {
            if let Some(scalar) = self.model.scalar_at(element)
                && let Ok(value) = given(i).within(scalar.variable)
            {
                if has_own_start(scalar.variable) && is_start(self.shared.lifecycle.state) {
                    let starts = self.shared.starts.get_or_insert_with(|| {
                        let mut fresh = self.model.copy();
                        fresh.renew();
                        fresh
                    });
                    starts.set(&scalar, value.clone());
                }
                self.warn_if_deprecated(&scalar, element, &value);
                self.model.set(&scalar, value);
            }
        }
        let lifecycle = &mut self.shared.lifecycle;
        let is_in_steps = matches!(
            lifecycle.state,
            State::StepMode | State::IntermediateUpdate | State::ClockActivation
        );
        lifecycle.stale |= !is_in_steps;
        Ok(())
    }

    /// Warns of a deprecated variable, if the host gives it another value: some hosts set all to their start values.
    fn warn_if_deprecated(&mut self, scalar: &ScalarVariable, reference: u32, value: &Value) {
        if let Some(warn) = self.model.info().warn_of_deprecated
            && !scalar.variable.deprecated().is_empty()
            && *value != self.model.get(scalar)
        {
            let Shared { settings, deprecated, .. } = &mut self.shared;
            warn(&settings.log, deprecated, scalar, reference);
        }
    }

    /// Checks that a value may be set.
    fn check(&mut self, of_type: Type, element: u32, value: HostValue) -> Result<(), ModelError> {
        let Lifecycle { state, instance_type, .. } = self.shared.lifecycle;
        let scalar = self.scalar_of_type(of_type, element)?;
        let value = value.within(scalar.variable);
        // Some hosts set values again that stay the same: OpenModelica all parameters after the initialization, FMPy
        // all inputs when it locates events.
        let is_same = |instance: &mut Self| {
            let is_set_again = match (scalar.variable.causality, scalar.variable.variability) {
                (Causality::Parameter, Variability::Fixed) => is_in(RUNNING, state),
                (Causality::Input, _) => state == State::ContinuousTime,
                _ => false,
            };
            is_set_again && value.as_ref().is_ok_and(|value| *value == instance.model.get(&scalar))
        };
        if let Some(why) = not_settable(scalar.variable, state, instance_type)
            && !is_same(self)
        {
            return refused!("{} is {why}", scalar.name());
        }
        let Err(value) = value else { return Ok(()) };
        let expected = expected(scalar.variable);
        refused!("{} = {value} is refused; expected {expected}", scalar.name())
    }
}

/// Defines methods that get and set numbers of a type.
macro_rules! numbers {
    ($($get:ident $set:ident: $type:ty as $name:ident, $given:ident;)*) => {
        impl Instance {
            $(
                pub(crate) fn $get(
                    &mut self,
                    references: &[u32],
                    values: &mut [$type],
                ) -> Result<(), ModelError> {
                    self.get_of_type(Type::$name, references, values.len(), &mut |i, value| {
                        if let Value::$name(value) = value {
                            values[i] = value;
                        }
                    })
                }

                pub(crate) fn $set(
                    &mut self,
                    references: &[u32],
                    values: &[$type],
                ) -> Result<(), ModelError> {
                    let given = |i: usize| HostValue::$given(values[i].into());
                    self.set_of_type(Type::$name, references, values.len(), &given)
                }
            )*
        }
    };
}

numbers! {
    get_float32 set_float32: f32 as Float32, Real;
    get_float64 set_float64: f64 as Float64, Real;
    get_int8 set_int8: i8 as Int8, Whole;
    get_uint8 set_uint8: u8 as UInt8, Whole;
    get_int16 set_int16: i16 as Int16, Whole;
    get_uint16 set_uint16: u16 as UInt16, Whole;
    get_int32 set_int32: i32 as Int32, Whole;
    get_uint32 set_uint32: u32 as UInt32, Whole;
    get_int64 set_int64: i64 as Int64, Whole;
    get_uint64 set_uint64: u64 as UInt64, Whole;
}

/// Whether a state is in a set.
fn is_in(states: u16, state: State) -> bool {
    states & state as u16 != 0
}

/// Whether start values may be set.
fn is_start(state: State) -> bool {
    matches!(state, State::Instantiated | State::Initialization)
}

/// Why the host may not set the variable now; `None` if it may.
fn not_settable(
    variable: &Declaration,
    state: State,
    instance_type: InstanceType,
) -> Option<&'static str> {
    use State::{ContinuousTime, Event, IntermediateUpdate};
    let is_reconfiguration = is_in(RECONFIGURATION, state);
    let is_configuration = is_reconfiguration || state == State::Configuration;
    let is_exchange = instance_type.is_model_exchange() && matches!(state, Event | ContinuousTime);
    match (variable.causality, variable.variability) {
        (_, Variability::Constant) => Some("a constant"),
        // The standard has a function for all states; some hosts, such as CasADi, set them one by one.
        _ if matches!(variable.dynamics, Dynamics::State) && is_exchange => None,
        _ if has_own_start(variable) && is_start(state) => None,
        (Causality::Output, _) => Some("an output, which only the model sets"),
        (Causality::Local, _) => Some("a local variable, which only the model sets"),
        (Causality::StructuralParameter, _) if !is_configuration => {
            Some("a structural parameter, which is set in configuration mode")
        }
        (Causality::StructuralParameter, variability) => {
            (is_reconfiguration && variability != Variability::Tunable).then_some(
                "a fixed structural parameter, which cannot be set after the initialization",
            )
        }
        _ if is_configuration => {
            Some("not a structural parameter; only those can be set in configuration mode")
        }
        (_, Variability::Fixed) if !is_start(state) => {
            Some("a fixed parameter, which cannot be set after the initialization")
        }
        (Causality::Input, Variability::Continuous) => None,
        _ if matches!(state, ContinuousTime | IntermediateUpdate) => {
            Some("not a continuous input; only those can be set between events")
        }
        _ => None,
    }
}

#[cold]
pub(crate) fn unknown(end: u32, reference: u32) -> ModelError {
    let last = end.saturating_sub(1);
    ModelError::refuse(format_args!("value reference {reference} is unknown; expected 0 to {last}"))
}

/// Why a value of a variable of the right type cannot be got: only FMI 2.0 has too few types.
#[cold]
fn does_not_fit(scalar: &ScalarVariable, value: Option<i128>) -> ModelError {
    let value = Whole(value.unwrap_or_default());
    ModelError::refuse(format_args!(
        "{} = {value} does not fit into an Integer of FMI 2.0; expected a value from {} to {}",
        scalar.name(),
        i32::MIN,
        i32::MAX
    ))
}

/// Checks that the functions of a type access the variable in a version of FMI.
pub(crate) fn check_type(
    scalar: &ScalarVariable,
    of_type: Type,
    version: FmiVersion,
) -> Result<(), ModelError> {
    let own = scalar.variable.start.of_type();
    let accessed = own.accessed_as(version).name(version);
    let found = of_type.name(version);
    if accessed == found {
        return Ok(());
    }
    let name = scalar.name();
    match own {
        Type::Binary if version == FmiVersion::Fmi2 => {
            refused!("{name} is of type Binary, which is not available in FMI 2.0")
        }
        Type::Enumeration => {
            refused!("{name} is of type Enumeration, which is accessed as {accessed}, not {found}")
        }
        _ => refused!("{name} is of type {accessed}, not {found}"),
    }
}
