//! Directional and adjoint derivatives (FMI 3.0.2, section 2.2.11).

use super::{
    NULL_ARRAY, calls, fmi3Float64, fmi3Instance, fmi3Status, fmi3ValueReference, slice, slice_mut,
    with,
};
use crate::component::Product;

macro_rules! products {
    ($($function:ident = $product:ident($call:ident);)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(
                instance: fmi3Instance,
                unknowns: *const fmi3ValueReference,
                n_unknowns: usize,
                knowns: *const fmi3ValueReference,
                n_knowns: usize,
                seed: *const fmi3Float64,
                n_seed: usize,
                sensitivity: *mut fmi3Float64,
                n_sensitivity: usize,
            ) -> fmi3Status {
                let call = &calls::$call;
                // SAFETY: the caller's promise: arrays of these lengths, or NULL.
                unsafe {
                    let variables = slice(unknowns, n_unknowns).zip(slice(knowns, n_knowns));
                    let values = slice(seed, n_seed).zip(slice_mut(sensitivity, n_sensitivity));
                    with(instance, |component| match variables.zip(values) {
                        Some(((unknowns, knowns), (seed, sensitivity))) => {
                            let variables = (unknowns, knowns);
                            component.derivative_product(call, Product::$product, variables, seed, sensitivity)
                        }
                        None => component.refuse(call.name, NULL_ARRAY),
                    })
                }
            }
        )*
    };
}

products! {
    fmi3GetDirectionalDerivative = Directional(DIRECTIONAL_DERIVATIVE);
    fmi3GetAdjointDerivative = Adjoint(ADJOINT_DERIVATIVE);
}
