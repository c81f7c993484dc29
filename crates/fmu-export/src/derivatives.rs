//! Derivatives of variables: with respect to other variables, and to time.

use fmi_abi::state::State;
use fmu_description::table::{Bounds, Declaration};
use fmu_description::{Causality, Dynamics, Number, Type, Value};

use crate::any_model::AnyModel;
use crate::error::{ModelError, ensure, refused};
use crate::instance::Instance;
use crate::layout::ContinuousState;
use crate::values::{check_type, unknown};

impl Instance {
    /// The derivative of unknowns with respect to knowns in a direction of the knowns.
    pub(crate) fn get_directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivatives: &mut [f64],
    ) -> Result<(), ModelError> {
        let unknowns = self.element_references(unknowns, derivatives.len())?;
        let knowns = self.element_references(knowns, direction.len())?;
        self.multiply(&unknowns, &knowns, direction, derivatives, false)
    }

    /// The derivative of a direction of the unknowns with respect to knowns.
    pub(crate) fn get_adjoint_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        derivatives: &mut [f64],
    ) -> Result<(), ModelError> {
        let unknowns = self.element_references(unknowns, direction.len())?;
        let knowns = self.element_references(knowns, derivatives.len())?;
        self.multiply(&unknowns, &knowns, direction, derivatives, true)
    }

    /// Multiplies the Jacobian, or its transpose, by a direction.
    fn multiply(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        products: &mut [f64],
        is_transposed: bool,
    ) -> Result<(), ModelError> {
        let saved = self.prepare_jacobian(unknowns, knowns, direction)?;
        let (rows, columns) = match is_transposed {
            false => (unknowns, knowns),
            true => (knowns, unknowns),
        };
        let mut multiplied = Ok(());
        for (&row, product) in rows.iter().zip(products) {
            let element = |(&column, change): (&u32, &f64)| {
                let (unknown, known) = match is_transposed {
                    false => (row, column),
                    true => (column, row),
                };
                Ok(self.derivative(unknown, known)? * change)
            };
            let sum: Result<f64, ModelError> = columns.iter().zip(direction).map(element).sum();
            match sum {
                Ok(sum) => *product = sum,
                Err(error) => multiplied = Err(error),
            }
        }
        if let Some(saved) = saved {
            self.model.assign(saved.as_ref());
        }
        multiplied
    }

    /// Evaluates the equations, of which the Jacobian may be a function, and checks a product with it: of outputs,
    /// derivatives, event indicators and states with respect to inputs and states; in initialization mode, of
    /// outputs, derivatives and states with respect to all that the host may set as well. Returns the model
    /// before an evaluation, to which it is to return.
    fn prepare_jacobian(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
    ) -> Result<Option<Box<dyn AnyModel>>, ModelError> {
        ensure!(
            self.model.info().has_directional_derivatives,
            "the model has no derivatives with respect to inputs and states"
        );
        let is_initial = self.shared.lifecycle.state == State::Initialization;
        for &reference in unknowns {
            let expected = "an output, a state, a derivative or an event indicator";
            self.check_part(reference, expected, &|variable| {
                variable.causality == Causality::Output || variable.dynamics != Dynamics::Algebraic
            })?;
        }
        let expected = match is_initial {
            true => "an input, a state or a parameter",
            false => "an input or a state",
        };
        for &reference in knowns {
            // Initial values may depend on the start time.
            if is_initial && self.is_time(reference) {
                continue;
            }
            self.check_part(reference, expected, &|variable| {
                let is_state = matches!(variable.dynamics, Dynamics::State);
                let is_parameter = variable.causality == Causality::Parameter;
                is_state || variable.causality == Causality::Input || is_initial && is_parameter
            })?;
        }
        if let Some(change) = direction.iter().find(|change| !change.is_finite()) {
            return refused!("the direction contains {}; expected finite numbers", Number(*change));
        }
        self.prepare_values(true)
    }

    /// Checks that a variable is a Real with a part in the Jacobian.
    fn check_part(
        &mut self,
        reference: u32,
        expected: &str,
        has_part: &dyn Fn(&Declaration) -> bool,
    ) -> Result<(), ModelError> {
        let (end, version) = (self.model.info().end, self.shared.settings.edge.version);
        match self.model.scalar_at(reference) {
            None => Err(unknown(end, reference)),
            Some(scalar) if !has_part(scalar.variable) => {
                refused!("{} is not {expected}", scalar.name())
            }
            Some(scalar) => check_type(&scalar, Type::Float64, version),
        }
    }

    /// An element of the Jacobian. As an unknown, a state depends on itself only, but for its initial value.
    fn derivative(&mut self, unknown: u32, known: u32) -> Result<f64, ModelError> {
        let is_state = |reference| {
            (self.model.scalar_at(reference))
                .is_some_and(|scalar| matches!(scalar.variable.dynamics, Dynamics::State))
        };
        let (is_state, by_state) = (is_state(unknown), is_state(known));
        if self.shared.lifecycle.state == State::Initialization && !by_state {
            return self.initial_derivative(unknown, known);
        }
        Ok(match is_state {
            true => f64::from(u8::from(unknown == known)),
            false => {
                let number = |reference| self.model.info().number(reference);
                let numbers = number(unknown).zip(number(known));
                numbers.map_or(0.0, |(unknown, known)| self.model.derivative(unknown, known))
            }
        })
    }

    /// The derivative of an initial value with respect to a start value: the quotient of differences between
    /// initializations, central unless the start value is at a bound.
    fn initial_derivative(&mut self, unknown: u32, known: u32) -> Result<f64, ModelError> {
        let Some(of) = self.model.scalar_at(unknown) else {
            return Ok(0.0);
        };
        // Without it, the known is the time.
        let by = self.model.scalar_at(known);
        let start = match &by {
            Some(by) => self.model.get(by).as_real().unwrap_or_default(),
            None => self.shared.lifecycle.start_time,
        };
        // A power of two near the cube root of the rounding error, so that a linear function has its exact slope.
        let magnitude = start.abs().max(1e-3);
        let power_of_two = f64::from_bits(magnitude.to_bits() & f64::INFINITY.to_bits());
        let step = power_of_two * 2f64.powi(-17);
        let bounds = by.map_or(Bounds::None, |by| by.variable.bounds);
        let [low, high] = [start - step, start + step].map(|value| {
            let allowed = bounds.contain(&Value::Float64(value));
            if allowed { value } else { start }
        });
        let saved = self.model.copy();
        let lifecycle = self.shared.lifecycle;
        let mut at = |value| {
            match &by {
                Some(by) => self.model.set(by, Value::Float64(value)),
                None => self.shared.lifecycle.start_time = value,
            }
            let result = self.initialize();
            let result = result.map(|()| self.model.get(&of).as_real().unwrap_or_default());
            self.model.assign(saved.as_ref());
            self.shared.lifecycle = lifecycle;
            result
        };
        let (before, after) = (at(low), at(high));
        match high > low {
            true => Ok((after? - before?) / (high - low)),
            false => Ok(0.0),
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
            let end = self.model.info().end;
            let scalar = self.model.scalar_at(reference);
            let scalar = scalar.ok_or_else(|| unknown(end, reference))?;
            let name = scalar.name();
            ensure!(
                self.model.input_derivative(scalar.number as u32).is_some(),
                "the host cannot set the input derivative of {name}"
            );
            check_order(&name, order)?;
            ensure!(
                value.is_finite(),
                "the derivative of {name} = {} is refused; expected a finite number",
                Number(value)
            );
        }
        for (&reference, &value) in references.iter().zip(values) {
            if let Some(number) = self.model.info().number(reference)
                && let Some(derivative) = self.model.input_derivative(number)
            {
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
        let elements = self.element_references(references, values.len())?;
        let mut derivatives = Vec::with_capacity(elements.len());
        let mut rest = elements.iter();
        for (&reference, &order) in references.iter().zip(orders) {
            let count = self.elements_accessed(reference).unwrap_or_default();
            for &element in rest.by_ref().take(count) {
                derivatives.push(self.derivative_of_output(element, order)?);
            }
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
        let info = self.model.info();
        let scalar = self.model.scalar_at(reference);
        let scalar = scalar.ok_or_else(|| unknown(info.end, reference))?;
        let name = scalar.name();
        ensure!(scalar.variable.causality == Causality::Output, "{name} is not an output");
        check_order(&name, order)?;
        let mut states = info.states.iter();
        let is_of =
            |state: &&ContinuousState| (reference.wrapping_sub(state.state) as usize) < state.count;
        match states.find(is_of) {
            Some(state) => Ok(state.derivative + (reference - state.state)),
            None => refused!("the derivative of {name} is not known"),
        }
    }
}

fn check_order(name: &str, order: i32) -> Result<(), ModelError> {
    ensure!(order == 1, "the derivative of {name} is of order {order}; expected 1");
    Ok(())
}
