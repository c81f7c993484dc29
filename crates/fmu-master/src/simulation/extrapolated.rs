//! Gets the derivatives of outputs, and sets the inputs that are extrapolated by them.

use crate::component_instance::{CallResult, ComponentInstance};
use crate::extrapolation::{ExtrapolatedInput, OutputDerivatives};
use crate::store::Store;

impl ComponentInstance<'_> {
    /// Gets the derivatives of its outputs at a time (s), if there are any, after the outputs.
    pub(super) fn read_derivatives(
        &mut self,
        derivatives: &OutputDerivatives,
        time: f64,
        store: &mut Store,
    ) -> CallResult {
        let OutputDerivatives { references, orders, place, time: place_of_time } = derivatives;
        if references.is_empty() {
            return Ok(());
        }
        store.reals[*place_of_time] = time;
        let values = &mut store.reals[place.clone()];
        self.call("get_output_derivatives", "derivatives of outputs", |instance| {
            instance.get_output_derivatives(references, orders, values)
        })
    }

    /// Sets its inputs for a step from a time (s), of which some are extrapolated.
    pub(super) fn write_at(
        &mut self,
        inputs: &[ExtrapolatedInput],
        time: f64,
        store: &mut Store,
    ) -> CallResult {
        for input in inputs {
            store.reals[input.to] = input.derivative(0, time, store);
        }
        self.write::<false>(store)?;
        if inputs.is_empty() || !self.fmu.interpolates_inputs {
            return Ok(());
        }
        // Many FMUs know the first derivative only.
        let orders = vec![1; inputs.len()];
        let references = Vec::from_iter(inputs.iter().map(|input| input.reference));
        let slopes = inputs.iter().map(|input| input.factor * input.derivative(1, time, store));
        let slopes = Vec::from_iter(slopes);
        self.call("set_input_derivatives", "derivatives of inputs", |instance| {
            instance.set_input_derivatives(&references, &orders, &slopes)
        })
    }
}
