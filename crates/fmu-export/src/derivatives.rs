//! Derivatives of variables: with respect to other variables, and to time.

use fmu_description::table::Field;
use fmu_description::{Causality, Dynamics, Type};

use crate::component::Component;
use crate::lifecycle::Mode;
use crate::model::ModelError;
use crate::values::{check_type, unknown};

impl Component {
    /// The derivative of unknowns with respect to knowns in a direction of the knowns.
    pub(crate) fn get_directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivatives: &mut [f64],
    ) -> Result<(), ModelError> {
        let unknowns = self.elements(unknowns, derivatives.len())?;
        let knowns = self.elements(knowns, direction.len())?;
        self.prepare_jacobian(&unknowns, &knowns, direction)?;
        for (&unknown, derivative) in unknowns.iter().zip(derivatives) {
            *derivative = (knowns.iter().zip(direction))
                .map(|(&known, change)| self.derivative(unknown, known) * change)
                .sum();
        }
        Ok(())
    }

    /// The derivative of a direction of the unknowns with respect to knowns.
    pub(crate) fn get_adjoint_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivatives: &mut [f64],
    ) -> Result<(), ModelError> {
        let unknowns = self.elements(unknowns, direction.len())?;
        let knowns = self.elements(knowns, derivatives.len())?;
        self.prepare_jacobian(&unknowns, &knowns, direction)?;
        for (&known, derivative) in knowns.iter().zip(derivatives) {
            *derivative = (unknowns.iter().zip(direction))
                .map(|(&unknown, change)| self.derivative(unknown, known) * change)
                .sum();
        }
        Ok(())
    }

    /// Checks a product with the Jacobian: in co-simulation, of outputs with respect to inputs; in model
    /// exchange, of outputs and derivatives with respect to inputs and states.
    fn prepare_jacobian(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
    ) -> Result<(), ModelError> {
        let is_exchange = self.shared.lifecycle.mode == Mode::ModelExchange;
        if is_exchange {
            self.update()?;
        }
        if !self.model.facts().has_directional_derivatives {
            return Err(ModelError::refuse(
                "the model has no derivatives: providesDirectionalDerivative is false",
            ));
        }
        let (unknown, known) = match is_exchange {
            true => (
                "an output, a derivative or an event indicator",
                "an input or a state",
            ),
            false => ("an output", "an input"),
        };
        for &reference in unknowns {
            self.check_part(reference, unknown, &|variable| {
                let is_equation = matches!(
                    variable.dynamics,
                    Dynamics::Derivative { .. } | Dynamics::EventIndicator
                );
                variable.causality == Causality::Output || is_exchange && is_equation
            })?;
        }
        for &reference in knowns {
            self.check_part(reference, known, &|variable| {
                let is_state = matches!(variable.dynamics, Dynamics::State { .. });
                variable.causality == Causality::Input || is_exchange && is_state
            })?;
        }
        match direction.iter().find(|change| !change.is_finite()) {
            Some(change) => Err(ModelError::refuse(format_args!(
                "the direction contains {change}; expected finite numbers"
            ))),
            None => Ok(()),
        }
    }

    /// Checks that a variable is a Real with a part in the Jacobian.
    fn check_part(
        &mut self,
        reference: u32,
        expected: &str,
        has_part: &dyn Fn(&Field) -> bool,
    ) -> Result<(), ModelError> {
        let (count, version) = (self.model.facts().count, self.shared.settings.edge.version);
        match self.model.find(reference) {
            None => Err(unknown(count, reference)),
            Some(scalar) if !has_part(scalar.variable) => Err(ModelError::refuse(format_args!(
                "{} is not {expected}",
                scalar.name()
            ))),
            Some(scalar) => check_type(&scalar, Type::Float64, version),
        }
    }

    /// An element of the Jacobian. As an unknown in model exchange, a state depends on itself only.
    fn derivative(&mut self, unknown: u32, known: u32) -> f64 {
        let is_state = self.shared.lifecycle.mode == Mode::ModelExchange
            && self
                .model
                .find(unknown)
                .is_some_and(|scalar| matches!(scalar.variable.dynamics, Dynamics::State { .. }));
        match is_state {
            true => f64::from(u8::from(unknown == known)),
            false => self.model.derivative(unknown, known),
        }
    }

    /// Sets the first time derivatives of inputs for the next step, all or none.
    pub(crate) fn set_input_derivatives(
        &mut self,
        references: &[u32],
        orders: &[i32],
        values: &[f64],
    ) -> Result<(), ModelError> {
        for ((&reference, &order), &value) in references.iter().zip(orders).zip(values) {
            let count = self.model.facts().count;
            let scalar = self.model.find(reference);
            let name = scalar.ok_or_else(|| unknown(count, reference))?.name();
            if self.model.input_derivative(reference).is_none() {
                return Err(ModelError::refuse(format_args!(
                    "the host cannot set the input derivative of {name}"
                )));
            }
            check_order(&name, order)?;
            if !value.is_finite() {
                return Err(ModelError::refuse(format_args!(
                    "the derivative of {name} = {value} is refused; expected a finite number"
                )));
            }
        }
        for (&reference, &value) in references.iter().zip(values) {
            if let Some(derivative) = self.model.input_derivative(reference) {
                *derivative = value;
            }
        }
        self.shared.lifecycle.has_input_derivatives |= !references.is_empty();
        Ok(())
    }

    /// Time derivatives of outputs that are states, of first order. In FMI 3.0, each order is the same for all
    /// elements of a variable.
    pub(crate) fn get_output_derivatives(
        &mut self,
        references: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> Result<(), ModelError> {
        self.check_announced(references)?;
        let elements = self.elements(references, values.len())?;
        let mut derivatives = Vec::with_capacity(elements.len());
        let mut orders = references.iter().zip(orders).peekable();
        let mut order = 1;
        for &element in elements.iter() {
            if let Some((_, of_variable)) = orders.next_if(|(reference, _)| **reference == element)
            {
                order = *of_variable;
            }
            derivatives.push(self.derivative_of_output(element, order)?);
        }
        let saved = self.evaluate_aside()?;
        let got = self.get_elements(Type::Float64, &derivatives, &mut |i, value| {
            values[i] = value.as_real().unwrap_or_default();
        });
        self.model.assign(saved.as_ref());
        got
    }

    /// The value reference of the time derivative of an output.
    fn derivative_of_output(&mut self, reference: u32, order: i32) -> Result<u32, ModelError> {
        let facts = self.model.facts();
        let scalar = self.model.find(reference);
        let scalar = scalar.ok_or_else(|| unknown(facts.count, reference))?;
        let name = scalar.name();
        if scalar.variable.causality != Causality::Output {
            return Err(ModelError::refuse(format_args!("{name} is not an output")));
        }
        check_order(&name, order)?;
        let mut states = facts.states.iter();
        match states.find(|integrated| integrated.state == reference) {
            Some(integrated) => Ok(integrated.derivative),
            None => Err(ModelError::refuse(format_args!(
                "the derivative of {name} is not known"
            ))),
        }
    }
}

fn check_order(name: &str, order: i32) -> Result<(), ModelError> {
    match order {
        1 => Ok(()),
        _ => Err(ModelError::refuse(format_args!(
            "the derivative of {name} is of order {order}; expected 1"
        ))),
    }
}
