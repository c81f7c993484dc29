//! The table of a model's variables, whose rows are built at compile time.

use crate::unit::ONE;
use crate::{Causality, Unit, Variability};

/// One row of a model's table: a variable, and how to access its value in the model `M`.
#[derive(Debug, Clone, Copy)]
pub struct Variable<M: 'static> {
    /// The properties of the variable.
    pub info: Info,
    access: Access<M>,
    input_derivative: Option<fn(&mut M) -> &mut f64>,
    directional_derivatives: &'static [DirectionalDerivative<M>],
}

/// The name of an input, and the derivative of an output's current value with respect to the value
/// of that input, which was held over the last step.
pub type DirectionalDerivative<M> = (&'static str, fn(&M) -> f64);

/// The properties of a variable: a scalar, or an array of scalars `name[1]`, `name[2]`, ...
#[derive(Debug, Clone, Copy)]
pub struct Info {
    /// Unique name, structured (`pid.kp`).
    pub name: &'static str,
    /// A short description.
    pub description: &'static str,
    /// What determines its value.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// Names of the parameters that its value after initialization depends on; if both are arrays,
    /// each element depends on the element with the same index.
    pub initially_from: &'static [&'static str],
    /// Number of elements; `None` for a scalar.
    pub array: Option<usize>,
    /// Type, start and bounds.
    pub domain: Domain,
}

/// The type, start value and bounds of a variable.
#[derive(Debug, Clone, Copy)]
pub enum Domain {
    /// Real numbers.
    Real {
        /// Start values; none for an output.
        start: Start,
        /// Minimum; negative infinity if unbounded.
        min: f64,
        /// Maximum; infinity if unbounded.
        max: f64,
        /// Unit of the value, the start and the bounds.
        unit: Unit,
    },
    /// Whole numbers.
    Integer {
        /// Start value.
        start: i32,
        /// Minimum and maximum.
        range: (i32, i32),
    },
    /// True or false.
    Boolean {
        /// Start value.
        start: bool,
    },
    /// An item of an enumeration, stored as its index from 1.
    Enumeration {
        /// Index of the start item, from 1.
        start: i32,
        /// The items.
        items: &'static Enumeration,
    },
}

/// How a value is accessed in the model.
#[derive(Debug, Clone, Copy)]
enum Access<M: 'static> {
    Real(fn(&mut M) -> &mut f64),
    Reals(fn(&mut M) -> &mut [f64]),
    /// An Integer, or the index of an Enumeration.
    Integer(fn(&mut M) -> &mut i32),
    Boolean(fn(&mut M) -> &mut bool),
}

/// Mutable access to the value of a scalar variable in its model.
#[derive(Debug)]
pub enum ValueMut<'a> {
    /// A Real.
    Real(&'a mut f64),
    /// An Integer, or the index of an Enumeration.
    Integer(&'a mut i32),
    /// A Boolean.
    Boolean(&'a mut bool),
}

/// Start values of a real variable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start {
    /// Calculated by the model.
    None,
    /// The start value of a scalar.
    Scalar(f64),
    /// The start value of each element of an array.
    Array(&'static [f64]),
}

impl Start {
    /// The start value of the element `index`, from 0.
    pub const fn of(&self, index: usize) -> Option<f64> {
        match self {
            Self::None => None,
            Self::Scalar(value) => Some(*value),
            Self::Array(values) => Some(values[index]),
        }
    }
}

/// The items of an enumeration.
#[derive(Debug, PartialEq)]
pub struct Enumeration {
    /// Name of the type in the XML.
    pub name: &'static str,
    /// A short description.
    pub description: &'static str,
    /// Name and description of each item; the first has the index 1.
    pub items: &'static [(&'static str, &'static str)],
}

impl Info {
    /// Number of scalar variables it represents.
    pub const fn count(&self) -> usize {
        match self.array {
            Some(length) => length,
            None => 1,
        }
    }

    /// The name of the element `index`, from 0.
    pub fn element_name(&self, index: usize) -> String {
        match self.array {
            Some(_) => format!("{}[{}]", self.name, index + 1),
            None => self.name.to_owned(),
        }
    }
}

/// The rows of a table. Define an alias for the row type, so that the closures know their model:
/// `type Row = Variable<MyModel>;`.
impl<M> Variable<M> {
    /// A real input with the start value 0.
    pub const fn input(name: &'static str, access: fn(&mut M) -> &mut f64) -> Self {
        Self::new(
            name,
            (Causality::Input, Variability::Continuous),
            real(Start::Scalar(0.0)),
            Access::Real(access),
        )
    }

    /// A real output.
    pub const fn output(name: &'static str, access: fn(&mut M) -> &mut f64) -> Self {
        Self::new(
            name,
            (Causality::Output, Variability::Continuous),
            real(Start::None),
            Access::Real(access),
        )
    }

    /// `length` real outputs `name[1]`, `name[2]`, ...
    pub const fn output_array(
        name: &'static str,
        length: usize,
        access: fn(&mut M) -> &mut [f64],
    ) -> Self {
        Self::new(
            name,
            (Causality::Output, Variability::Continuous),
            real(Start::None),
            Access::Reals(access),
        )
        .array(length)
    }

    /// A real parameter that is fixed after initialization.
    pub const fn fixed(name: &'static str, start: f64, access: fn(&mut M) -> &mut f64) -> Self {
        Self::new(
            name,
            (Causality::Parameter, Variability::Fixed),
            real(Start::Scalar(start)),
            Access::Real(access),
        )
    }

    /// Real parameters `name[1]`, `name[2]`, ... that are fixed after initialization.
    pub const fn fixed_array(
        name: &'static str,
        start: &'static [f64],
        access: fn(&mut M) -> &mut [f64],
    ) -> Self {
        Self::new(
            name,
            (Causality::Parameter, Variability::Fixed),
            real(Start::Array(start)),
            Access::Reals(access),
        )
        .array(start.len())
    }

    /// A real parameter that may be changed during the simulation.
    pub const fn tunable(name: &'static str, start: f64, access: fn(&mut M) -> &mut f64) -> Self {
        Self::new(
            name,
            (Causality::Parameter, Variability::Tunable),
            real(Start::Scalar(start)),
            Access::Real(access),
        )
    }

    /// A fixed parameter that is a whole number within `range`, both ends included.
    pub const fn integer(
        name: &'static str,
        start: i32,
        range: (i32, i32),
        access: fn(&mut M) -> &mut i32,
    ) -> Self {
        Self::new(
            name,
            (Causality::Parameter, Variability::Fixed),
            Domain::Integer { start, range },
            Access::Integer(access),
        )
    }

    /// A fixed parameter that is true or false.
    pub const fn flag(name: &'static str, start: bool, access: fn(&mut M) -> &mut bool) -> Self {
        Self::new(
            name,
            (Causality::Parameter, Variability::Fixed),
            Domain::Boolean { start },
            Access::Boolean(access),
        )
    }

    /// A fixed parameter that is an item of an enumeration, stored as its index from 1.
    pub const fn choice(
        name: &'static str,
        items: &'static Enumeration,
        start: i32,
        access: fn(&mut M) -> &mut i32,
    ) -> Self {
        Self::new(
            name,
            (Causality::Parameter, Variability::Fixed),
            Domain::Enumeration { start, items },
            Access::Integer(access),
        )
    }

    const fn new(
        name: &'static str,
        (causality, variability): (Causality, Variability),
        domain: Domain,
        access: Access<M>,
    ) -> Self {
        Self {
            info: Info {
                name,
                description: "",
                causality,
                variability,
                initially_from: &[],
                array: None,
                domain,
            },
            access,
            input_derivative: None,
            directional_derivatives: &[],
        }
    }

    const fn array(mut self, length: usize) -> Self {
        self.info.array = Some(length);
        self
    }

    /// Sets the description.
    pub const fn about(mut self, description: &'static str) -> Self {
        self.info.description = description;
        self
    }

    /// Sets the unit of a real variable; the default is 1.
    pub const fn unit(mut self, new: Unit) -> Self {
        match &mut self.info.domain {
            Domain::Real { unit, .. } => *unit = new,
            _ => panic!("only a real variable has a unit"),
        }
        self
    }

    /// Sets the minimum of a real variable.
    pub const fn at_least(mut self, bound: f64) -> Self {
        match &mut self.info.domain {
            Domain::Real { min, .. } => *min = bound,
            _ => panic!("only a real variable has real bounds"),
        }
        self
    }

    /// Sets the maximum of a real variable.
    pub const fn at_most(mut self, bound: f64) -> Self {
        match &mut self.info.domain {
            Domain::Real { max, .. } => *max = bound,
            _ => panic!("only a real variable has real bounds"),
        }
        self
    }

    /// Declares that an output changes only at certain instants, such as sample instants.
    pub const fn discrete(mut self) -> Self {
        self.info.variability = Variability::Discrete;
        self
    }

    /// Names the parameters that an output's value after initialization depends on.
    pub const fn initially_from(mut self, parameters: &'static [&'static str]) -> Self {
        self.info.initially_from = parameters;
        self
    }

    /// Lets the host set an input's time derivative for the next step, and sets where it is stored.
    pub const fn input_derivative(mut self, access: fn(&mut M) -> &mut f64) -> Self {
        assert!(
            matches!(self.info.causality, Causality::Input),
            "only an input has an input derivative"
        );
        self.input_derivative = Some(access);
        self
    }

    /// Sets the derivatives of a scalar output with respect to inputs; those not listed are zero.
    pub const fn directional_derivatives(
        mut self,
        derivatives: &'static [DirectionalDerivative<M>],
    ) -> Self {
        assert!(
            matches!(self.info.causality, Causality::Output) && self.info.array.is_none(),
            "only a scalar output has directional derivatives"
        );
        self.directional_derivatives = derivatives;
        self
    }

    /// Whether the host may set the variable's time derivative.
    pub const fn has_input_derivative(&self) -> bool {
        self.input_derivative.is_some()
    }

    /// Whether the variable's derivatives with respect to inputs are known.
    pub const fn has_directional_derivatives(&self) -> bool {
        !self.directional_derivatives.is_empty()
    }

    /// The variable's time derivative in `model`, if the host may set it.
    pub fn input_derivative_mut<'a>(&self, model: &'a mut M) -> Option<&'a mut f64> {
        self.input_derivative.map(|access| access(model))
    }

    /// The derivative of the variable's current value with respect to an input, which was held over
    /// the last step.
    pub fn derivative_by(&self, model: &M, input: &str) -> f64 {
        self.directional_derivatives
            .iter()
            .find(|(name, _)| *name == input)
            .map_or(0.0, |(_, derivative)| derivative(model))
    }

    /// The value of the element `index` (from 0) in `model`; `None` if the model's array is shorter
    /// than declared in the table.
    pub fn value_mut<'a>(&self, model: &'a mut M, index: usize) -> Option<ValueMut<'a>> {
        Some(match self.access {
            Access::Real(access) => ValueMut::Real(access(model)),
            Access::Reals(access) => ValueMut::Real(access(model).get_mut(index)?),
            Access::Integer(access) => ValueMut::Integer(access(model)),
            Access::Boolean(access) => ValueMut::Boolean(access(model)),
        })
    }

    /// The element `index` (from 0) of a Real in `model`; `None` if the variable has another type or
    /// the model's array is shorter than declared in the table.
    #[inline(always)]
    pub fn real<'a>(&self, model: &'a mut M, index: usize) -> Option<&'a mut f64> {
        match self.access {
            Access::Real(access) => Some(access(model)),
            Access::Reals(access) => access(model).get_mut(index),
            Access::Integer(_) | Access::Boolean(_) => None,
        }
    }

    /// Sets the variable to its start values, if it has any.
    pub fn start(&self, model: &mut M) {
        for index in 0..self.info.count() {
            match (self.value_mut(model, index), &self.info.domain) {
                (Some(ValueMut::Real(value)), Domain::Real { start, .. }) => {
                    if let Some(start) = start.of(index) {
                        *value = start;
                    }
                }
                (
                    Some(ValueMut::Integer(value)),
                    Domain::Integer { start, .. } | Domain::Enumeration { start, .. },
                ) => *value = *start,
                (Some(ValueMut::Boolean(value)), Domain::Boolean { start }) => *value = *start,
                _ => {}
            }
        }
    }
}

const fn real(start: Start) -> Domain {
    Domain::Real {
        start,
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
        unit: ONE,
    }
}

/// Fails the compilation if a table is invalid: a duplicate name or one longer than 63 bytes, an empty
/// description, or a start value outside its bounds.
pub const fn check<M>(variables: &[Variable<M>]) {
    let mut i = 0;
    while i < variables.len() {
        let info = &variables[i].info;
        assert!(
            !info.name.is_empty() && info.name.len() <= 59,
            "a name must have 1 to 59 bytes (63 with the index of an array)"
        );
        assert!(!info.description.is_empty(), "a variable needs `about`");
        check_start(info);
        let mut j = 0;
        while j < i {
            assert!(
                !equal(info.name.as_bytes(), variables[j].info.name.as_bytes()),
                "two variables have the same name"
            );
            j += 1;
        }
        i += 1;
    }
}

const fn check_start(info: &Info) {
    match &info.domain {
        Domain::Real {
            start, min, max, ..
        } => {
            let mut i = 0;
            while i < info.count() {
                if let Some(start) = start.of(i) {
                    assert!(
                        *min <= start && start <= *max,
                        "a start value lies outside its bounds"
                    );
                }
                i += 1;
            }
        }
        Domain::Integer { start, range } => {
            assert!(
                range.0 <= *start && *start <= range.1,
                "a start value lies outside its range"
            );
        }
        Domain::Boolean { .. } => {}
        Domain::Enumeration { start, items } => {
            assert!(
                1 <= *start && *start as usize <= items.items.len(),
                "the start item does not exist"
            );
        }
    }
}

const fn equal(a: &[u8], b: &[u8]) -> bool {
    if a.len() != b.len() {
        return false;
    }
    let mut i = 0;
    while i < a.len() {
        if a[i] != b[i] {
            return false;
        }
        i += 1;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Model {
        k: f64,
        w: [f64; 3],
    }

    type Row = Variable<Model>;

    fn k() -> Row {
        Row::tunable("k", 2.0, |m| &mut m.k).about("gain")
    }

    #[test]
    fn rows_access_the_values_of_the_model() {
        let mut model = Model::default();
        k().start(&mut model);
        assert_eq!(model.k, 2.0);
        let w = Row::fixed_array("w", &[1.0, 2.0, 3.0], |m| &mut m.w);
        w.start(&mut model);
        let Some(ValueMut::Real(second)) = w.value_mut(&mut model, 1) else {
            panic!()
        };
        *second = 7.0;
        assert_eq!(model.w, [1.0, 7.0, 3.0]);
        assert!(w.value_mut(&mut model, 3).is_none());
    }

    #[test]
    fn arrays_count_and_name_their_elements() {
        let w = Row::output_array("rbf.w", 3, |m| &mut m.w).info;
        assert_eq!(w.count(), 3);
        assert_eq!(w.element_name(2), "rbf.w[3]");
        assert_eq!(k().info.element_name(0), "k");
    }

    #[test]
    fn directional_derivatives_are_found_by_the_name_of_the_input() {
        let row = Row::output("y", |m| &mut m.k).directional_derivatives(&[("u", |m| 2.0 * m.k)]);
        let model = Model {
            k: 3.0,
            w: [0.0; 3],
        };
        assert_eq!(row.derivative_by(&model, "u"), 6.0);
        assert_eq!(row.derivative_by(&model, "d"), 0.0);
    }

    #[test]
    #[should_panic(expected = "only an input has an input derivative")]
    fn outputs_have_no_input_derivative() {
        let _ = Row::output("y", |m| &mut m.k).input_derivative(|m| &mut m.k);
    }

    #[test]
    #[should_panic(expected = "same name")]
    fn duplicate_names_are_rejected() {
        check(&[k(), k()]);
    }

    #[test]
    #[should_panic(expected = "outside its bounds")]
    fn a_start_must_lie_within_its_bounds() {
        check(&[k().at_most(1.0)]);
    }

    #[test]
    #[should_panic(expected = "outside its bounds")]
    fn every_start_of_an_array_must_lie_within_its_bounds() {
        check(&[Row::fixed_array("w", &[1.0, 2.0, -3.0], |m| &mut m.w)
            .at_least(0.0)
            .about("weights")]);
    }

    #[test]
    #[should_panic(expected = "needs `about`")]
    fn every_variable_needs_a_description() {
        check(&[Row::input("u", |m| &mut m.k)]);
    }

    #[test]
    #[should_panic(expected = "only a real variable")]
    fn only_reals_have_units() {
        let _ = Row::integer("n", 1, (0, 2), |_| unreachable!()).unit(ONE);
    }
}
