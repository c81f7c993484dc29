//! Turns a Rust model into an FMI 2.0.4 co-simulation slave.
//!
//! A model is a struct with a table of its variables and a step function ([`Model`]); [`export!`]
//! turns a `cdylib` with one or more models into an FMU binary. The author's crate needs no `unsafe`:
//!
//! ```
//! use fmu_export::{Model, ModelError, Variable, unit};
//! use serde::{Deserialize, Serialize};
//!
//! /// y = k u
//! #[derive(Default, Clone, Serialize, Deserialize)]
//! pub struct Gain { u: f64, y: f64, k: f64 }
//!
//! type Row = Variable<Gain>;
//!
//! impl Model for Gain {
//!     const NAME: &'static str = "Gain";
//!     const DESCRIPTION: &'static str = "An amplifier";
//!     const VARIABLES: &'static [Row] = &[
//!         Row::input("u", |m| &mut m.u).unit(unit::NEWTON).about("force"),
//!         Row::output("y", |m| &mut m.y).unit(unit::NEWTON).about("amplified force"),
//!         Row::tunable("k", 2.0, |m| &mut m.k).about("gain"),
//!     ];
//!
//!     fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
//!         self.y = self.k * self.u;
//!         Ok(())
//!     }
//! }
//!
//! fmu_export::export!(Gain);
//! # fn main() {}
//! ```
//!
//! A call passes through two layers. The entry points in [`fmi2`] convert pointers to slices and
//! forward them to the component, which implements what FMI requires of every slave: the state
//! machine, argument checks, the logger and the panic guard. The component accesses the model through
//! its table. Only the entry points use the C types of FMI 2.0 and `unsafe` code; the component knows
//! the names of the functions for its messages.
//!
//! The three calls that a host makes at every step (set Reals, step, get Reals) are generic over the
//! model. They have a fast path with a few checks, which never accepts a call that the component would
//! reject, and leave all other cases to the component.

mod bound;
mod component;
#[cfg(feature = "describe")]
mod description;
pub mod fmi2;
mod lifecycle;
mod log;
mod model;
mod phase;
mod reason;
mod slave;
mod snapshot;
mod values;

#[doc(hidden)]
pub use bound::scalars;
#[cfg(feature = "describe")]
pub use description::print_descriptions;
pub use fmi2::Entry;
pub use fmu_description::{Enumeration, Unit, Variable, unit};
pub use model::{Model, ModelError, finite};

/// Turns the library into an FMU binary with one or more [`Model`]s, which `fmi2Instantiate` selects
/// by GUID, and lists them in `MODELS`.
#[macro_export]
macro_rules! export {
    ($($model:ty),+ $(,)?) => {
        /// The models of this library.
        pub const MODELS: &[$crate::Entry] = &[
            $($crate::Entry::of::<$model, { $crate::scalars::<$model>() }>()),+
        ];

        /// `fmi2Instantiate` (FMI 2.0.4, section 2.1.5).
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
