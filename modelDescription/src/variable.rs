//! A variable of a model, whatever its version of FMI, in the vocabulary of FMI 3.0.

use std::sync::Arc;

use serde::Deserialize;

use crate::scalar::element_name;
use crate::table::Bounds;
use crate::{Causality, ClockType, Dynamics, Initial, Naming, Type, Value, Variability, value};

/// A variable: a scalar, or an array. The copy in a binary has its fields in this order. The default is a
/// continuous local Float64 without a name.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// Other names of it; in FMI 2.0, an alias is a variable of its own with the same value reference.
    pub aliases: Vec<String>,
    /// Its value reference.
    pub reference: u32,
    /// A short description.
    pub description: String,
    /// What determines its value.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// How it is initialized: as given, or the default of the standard; `None` for clocks, and for inputs and
    /// the independent variable of FMI 2.0.
    pub initial: Option<Initial>,
    /// Numbers of elements of an array, with structural parameters at their start values; empty for a
    /// scalar.
    pub dimensions: Vec<usize>,
    /// What the exporter knows of the variable; empty for a variable of a model description.
    pub exported: ExportInfo,
    /// Its type.
    pub of_type: Type,
    /// Its unit, if it has one.
    pub unit: Option<String>,
    /// Unit in which tools show the values, if it is another.
    pub display_unit: Option<String>,
    /// MIME type of a Binary, if it is given.
    pub mime_type: Option<String>,
    /// The smallest value, if there is one.
    pub min: Option<Value>,
    /// The largest value, if there is one.
    pub max: Option<Value>,
    /// The start values: of an array one for each element in row-major order, or one for all; none if the
    /// model calculates them.
    pub start: Vec<Value>,
    /// Its declared type, if it has one; an Enumeration does.
    pub declared_type: Option<Arc<DeclaredType>>,
    /// Value references of the clocks at whose ticks it changes; none if it is not clocked. In a copy, it is part of the
    /// supplement, as those below.
    #[serde(skip)]
    pub clocks: Vec<u32>,
    /// The largest number of bytes of a Binary, if there is one.
    #[serde(skip)]
    pub max_size: Option<usize>,
    /// When a Clock ticks.
    #[serde(skip)]
    pub clock: Option<ClockType>,
}

/// What an exporter knows of a variable, and a model description has elsewhere. Of an array, value references
/// are those of the first element.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct ExportInfo {
    /// Whether the host may set its time derivative.
    pub has_input_derivative: bool,
    /// Its part in the differential equations; a derivative has the value reference of its state.
    pub dynamics: Dynamics<usize>,
    /// Its nominal value; 1 if none is given.
    pub nominal: f64,
    /// Value reference of the structural parameter that is the number of elements in use, the first ones
    /// of an array; `None` if all are. The dimensions and start values cover all elements.
    pub size: Option<usize>,
    /// Value references of the variables that its value after initialization depends on, if that is known.
    pub initially_from: Option<Vec<usize>>,
    /// Value references of the inputs and states on which the variable depends, with known derivatives.
    pub depends_on: Vec<usize>,
    /// Its terminal, and its name there, as `terminal.member`; empty if it is in none.
    pub terminal: String,
    /// The terminal of a network that it belongs to, and its name there, or `Configuration.` and its name in the
    /// configuration. In a copy, it is part of the supplement.
    #[serde(skip)]
    pub network: Option<(String, String)>,
    /// How the names of its elements are written; known of the model, and not copied for each variable.
    #[serde(skip)]
    pub naming: Naming,
}

/// A type that a model description defines.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct DeclaredType {
    /// Its name.
    pub name: String,
    /// A short description.
    pub description: String,
    /// The items of an enumeration; none for other types.
    pub items: Vec<EnumerationItem>,
}

/// An item of an enumeration.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct EnumerationItem {
    /// Its name.
    pub name: String,
    /// Its number.
    pub value: i64,
    /// A short description.
    pub description: String,
}

impl Variable {
    /// Its name and its aliases.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        [&self.name].into_iter().chain(&self.aliases).map(String::as_str)
    }

    /// Number of elements; 1 for a scalar.
    pub fn element_count(&self) -> usize {
        let sizes = self.dimensions.iter().copied();
        sizes.fold(1, usize::saturating_mul)
    }

    /// The name of an element of an array, such as `w[1,2]`, from its name or an alias.
    pub fn element_name(&self, name: &str, element: usize) -> String {
        self.exported.naming.write(element_name(name, &self.dimensions, element))
    }

    /// The start value of an element.
    pub fn start_of(&self, element: usize) -> Option<&Value> {
        match self.start.as_slice() {
            [all] => Some(all),
            each => each.get(element),
        }
    }

    /// Whether it is a clock, or a variable with clocks, which has a value only at their ticks.
    pub fn is_of_ticks(&self) -> bool {
        self.of_type == Type::Clock || !self.clocks.is_empty()
    }

    /// Whether it is a parameter that the host sets, structural ones included.
    pub fn is_parameter(&self) -> bool {
        matches!(self.causality, Causality::Parameter | Causality::StructuralParameter)
    }

    /// What to do instead of using it, if its description says that it is deprecated; may be empty.
    pub fn deprecated(&self) -> Option<&str> {
        const WORD: &str = "deprecated";
        let at = self.description.to_ascii_lowercase().find(WORD)? + WORD.len();
        let text = self.description[at..].trim_start_matches([':', ',', '.', ' ']);
        let mut open = 0;
        let end = text.find(|c| {
            open += i32::from(matches!(c, '(' | '[')) - i32::from(matches!(c, ')' | ']'));
            open < 0
        });
        Some(text[..end.unwrap_or(text.len())].trim_end())
    }

    /// The items of an Enumeration.
    pub fn items(&self) -> &[EnumerationItem] {
        let declared = self.declared_type.as_ref();
        declared.map(|of_type| &*of_type.items).unwrap_or_default()
    }

    /// The values that its type and its bounds allow.
    fn bounds(&self) -> Bounds {
        let real = |bound: &Option<Value>| bound.as_ref().and_then(Value::as_real);
        let whole = |bound: &Option<Value>| bound.as_ref().and_then(Value::as_whole);
        match self.of_type {
            of_type if of_type.is_float() => Bounds::Real(
                real(&self.min).unwrap_or(f64::NEG_INFINITY),
                real(&self.max).unwrap_or(f64::INFINITY),
            ),
            of_type if of_type.is_integer() || of_type == Type::Enumeration => {
                let (low, high) = of_type.range();
                Bounds::Whole(whole(&self.min).unwrap_or(low), whole(&self.max).unwrap_or(high))
            }
            Type::Binary => self.max_size.map_or(Bounds::None, Bounds::Size),
            _ => Bounds::None,
        }
    }

    /// Whether a value of its type is within its bounds; real numbers are finite.
    pub fn allows(&self, value: &Value) -> bool {
        self.bounds().contain(value)
    }

    /// Checks that a value of a Binary has at most the largest size.
    ///
    /// # Errors
    /// It is larger; both sizes.
    pub fn check_size(&self, value: &Value) -> Result<(), String> {
        match (value, self.max_size) {
            (Value::Binary(bytes), Some(max)) if bytes.len() > max => {
                Err(format!("{} bytes, expected at most {max}", bytes.len()))
            }
            _ => Ok(()),
        }
    }

    /// Describes the values that the variable may have, for error messages.
    pub fn expected(&self) -> String {
        match self.of_type {
            Type::Boolean => "true or false".into(),
            Type::String => "a text without null bytes".into(),
            Type::Binary => match self.max_size {
                None => "two hexadecimal digits for each byte".into(),
                Some(max) => format!("two hexadecimal digits for each byte, at most {max} bytes"),
            },
            Type::Clock => "no value, since a clock ticks".into(),
            Type::Enumeration => {
                let names: Vec<_> = self.items().iter().map(|item| &*item.name).collect();
                format!("one of {}", names.join(", "))
            }
            _ => {
                let unit = self.unit.as_deref().unwrap_or_default();
                self.bounds().expected("a number", unit).unwrap_or_default()
            }
        }
    }

    /// The value that a text stands for: as [`Value::parse`], and an item also by its name, in any case unless that
    /// means several items.
    pub fn value(&self, text: &str) -> Option<Value> {
        if self.of_type != Type::Enumeration {
            return Value::parse(self.of_type, text);
        }
        let number: Option<i64> = value::whole(text);
        let item = |is_meant: &dyn Fn(&EnumerationItem) -> bool| {
            let mut meant = self.items().iter().filter(|item| is_meant(item));
            meant.next().filter(|_| meant.next().is_none())
        };
        let item = item(&|item| item.name == text)
            .or_else(|| item(&|item| Some(item.value) == number))
            .or_else(|| item(&|item| item.name.to_lowercase() == text.to_lowercase()))?;
        Some(Value::Enumeration(item.value))
    }
}

/// What is known of the variables of exported models.
impl Variable {
    /// Whether it is an output.
    pub(crate) fn is_output(&self) -> bool {
        self.causality == Causality::Output
    }

    /// Whether it is a continuous state. Events may change every state, as the attribute `reinit` says.
    pub(crate) fn is_state(&self) -> bool {
        matches!(self.exported.dynamics, Dynamics::State)
    }

    /// Whether it is the derivative of a state.
    pub(crate) fn is_derivative(&self) -> bool {
        matches!(self.exported.dynamics, Dynamics::Derivative { .. })
    }

    /// Whether it is an event indicator.
    pub(crate) fn is_event_indicator(&self) -> bool {
        self.exported.dynamics == Dynamics::EventIndicator
    }

    /// Whether it is an output that may change at any time.
    pub(crate) fn is_continuous_output(&self) -> bool {
        self.is_output() && self.variability == Variability::Continuous
    }

    /// Whether variables that are computed at any time may depend on it.
    pub(crate) fn is_known(&self) -> bool {
        matches!(self.causality, Causality::Input | Causality::Independent) || self.is_state()
    }

    /// Whether variables that are computed during initialization may depend on it.
    pub(crate) fn is_initially_known(&self) -> bool {
        use Causality::{Independent, Input, Local, Output, Parameter};
        match self.causality {
            Output | Local if self.variability != Variability::Constant => {
                self.initial == Some(Initial::Exact)
            }
            // No clock is active before the simulation.
            causality => {
                matches!(causality, Input | Parameter | Independent) && self.of_type != Type::Clock
            }
        }
    }

    /// Whether it is computed during initialization and listed as an initial unknown. One with clocks need not be (FMI
    /// 3.0.2, section 2.4.8), and FMPy demands that it is not.
    pub(crate) fn is_initial_unknown(&self) -> bool {
        let is_listed = self.is_output() || self.is_state() || self.is_derivative();
        self.initial == Some(Initial::Calculated)
            && self.clocks.is_empty()
            && (is_listed || self.causality == Causality::CalculatedParameter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_may_say_that_the_variable_is_deprecated() {
        for (description, expected) in [
            ("gain", None),
            ("gain (deprecated: use pid.kp)", Some("use pid.kp")),
            ("gain (deprecated: use f(x) [m]) (former name of k)", Some("use f(x) [m]")),
            ("Deprecated. Has no effect", Some("Has no effect")),
            ("gain [DEPRECATED]", Some("")),
        ] {
            let variable = Variable { description: description.into(), ..Variable::default() };
            assert_eq!(variable.deprecated(), expected, "{description}");
        }
    }
}
