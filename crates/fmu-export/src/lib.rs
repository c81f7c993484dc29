//! Turns a Rust struct into an FMI 2.0.5 co-simulation FMU.
//!
//! The fields of a struct are the variables of the model ([`derive@Model`]), and a function steps it
//! ([`Simulate`]). [`export!`] turns a `cdylib` with one or more models into an FMU binary:
//!
//! ```
//! use fmu_export::prelude::*;
//!
//! /// Proportional controller
//! #[derive(Model)]
//! pub struct P {
//!     /// set-point
//!     #[input(unit = "rad")]
//!     r: f64,
//!     /// measured angle
//!     #[input(unit = "rad")]
//!     y: f64,
//!     /// force
//!     #[output(unit = "N")]
//!     u: f64,
//!     /// gain
//!     #[parameter(tunable, start = 300.0, min = 0.0, unit = "N/rad")]
//!     kp: f64,
//! }
//!
//! impl Simulate for P {
//!     fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
//!         self.u = self.kp * (self.r - self.y);
//!         Ok(())
//!     }
//! }
//!
//! export!(P);
//! # fn main() {}
//! ```
//!
//! `cargo fmu export` builds it and writes the FMU. The author's crate needs no `unsafe` and no other
//! dependency.
//!
//! # How it works
//!
//! A call passes through two layers. The entry points in [`fmi2`] convert pointers to slices and
//! forward them to the component, which implements what FMI requires of every slave: the state
//! machine, argument checks, the logger and the panic guard. The component accesses the model through
//! the derived access functions. Only the entry points use the C types of FMI 2.0; the component knows
//! the names of the functions for its messages.
//!
//! The three calls that a host makes at every step (set Reals, step, get Reals) are generic over the
//! model. They have a fast path with a few checks, which never accepts a call that the component would
//! reject, and leave all other cases to the component.

mod bound;
mod clock;
mod component;
pub mod fmi2;
mod lifecycle;
mod log;
mod model;
mod panics;
mod phase;
mod reason;
mod resources;
mod slave;
mod snapshot;
mod values;

pub use clock::SampleClock;
#[doc(inline)]
pub use fmu_derive::{Choice, Model, Variables};
pub use fmu_description::{Choice, Variables};
#[doc(hidden)]
pub use fmu_description::{derive, embedded};
pub use model::{Model, ModelError, Simulate, Start};

/// What a model needs: `use fmu_export::prelude::*;`.
pub mod prelude {
    pub use crate::{Choice, Model, ModelError, Simulate, Start, Variables, export};
}

/// Turns the library into an FMU binary with one or more [`Model`]s, which `fmi2Instantiate` selects
/// by GUID, and lists them in `MODELS`.
#[macro_export]
macro_rules! export {
    ($($model:ty),+ $(,)?) => {
        /// The models of this library.
        #[allow(long_running_const_eval, reason = "a table may be large")]
        pub static MODELS: &[$crate::fmi2::Entry] = &[$({
            const COUNT: usize = <$model as $crate::Variables>::COUNT;
            const INTERFACE: $crate::derive::Interface =
                $crate::fmi2::interface::<$model, COUNT>(option_env!("FMU_EXPORT_VARIANT"));
            #[used]
            static EMBEDDED: [u8; $crate::embedded::size(&INTERFACE)] =
                $crate::embedded::write(&INTERFACE);
            $crate::fmi2::Entry::of::<$model, COUNT>(INTERFACE, &EMBEDDED)
        }),+];

        /// `fmi2Instantiate` (FMI 2.0.5, section 2.1.5).
        ///
        /// # Safety
        /// As required by the standard: every pointer is NULL or valid, strings are zero-terminated,
        /// and the callbacks live as long as the instance.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn fmi2Instantiate(
            instance_name: $crate::fmi2::fmi2String,
            fmu_type: $crate::fmi2::fmi2Type,
            guid: $crate::fmi2::fmi2String,
            resource_location: $crate::fmi2::fmi2String,
            functions: *const $crate::fmi2::fmi2CallbackFunctions,
            visible: $crate::fmi2::fmi2Boolean,
            logging_on: $crate::fmi2::fmi2Boolean,
        ) -> $crate::fmi2::fmi2Component {
            // SAFETY: the caller's promise, passed on.
            unsafe {
                $crate::fmi2::instantiate(
                    MODELS,
                    instance_name,
                    fmu_type,
                    guid,
                    resource_location,
                    functions,
                    visible,
                    logging_on,
                )
            }
        }
    };
}
