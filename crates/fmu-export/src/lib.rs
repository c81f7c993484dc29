//! Turns a Rust struct into an FMU of FMI 2.0.5 or 3.0.2, for co-simulation and model exchange.
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
//! A call passes through two layers. The entry points in [`fmi2`] and [`fmi3`] convert pointers to slices
//! and forward them to the component, which implements what FMI requires of every FMU: the state
//! machine, argument checks, the logger and the panic guard. The component accesses the model through
//! the derived access functions. Only the entry points use the C types of FMI; the component knows
//! the names of the functions for its messages.
//!
//! The three calls that a host makes at every step (set Reals, step, get Reals) are generic over the
//! model. They have a fast path with a few checks, which never accepts a call that the component would
//! reject, and leave all other cases to the component.

#![cfg_attr(
    any(
        all(feature = "fmi2", not(feature = "fmi3")),
        all(feature = "fmi3", not(feature = "fmi2"))
    ),
    allow(dead_code, reason = "what only the other version of FMI uses")
)]

mod bound;
mod clock;
mod component;
mod entry;
#[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
pub mod fmi2;
#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
pub mod fmi3;
mod instance;
mod lifecycle;
mod log;
mod model;
mod panics;
mod phase;
mod pointers;
mod reason;
mod resources;
mod slave;
mod snapshot;
mod solver;
mod state;
mod values;

pub use clock::SampleClock;
#[doc(hidden)]
pub use entry::{Entry, interface};
#[doc(inline)]
pub use fmu_derive::{Choice, Model, Variables};
pub use fmu_description::{Choice, Variables};
#[doc(hidden)]
pub use fmu_description::{derive, embedded};
#[doc(hidden)]
pub use model::Stepped;
pub use model::{Continuous, Model, ModelError, Simulate, Start};

/// What a model needs: `use fmu_export::prelude::*;`.
pub mod prelude {
    pub use crate::{Choice, Continuous, Model, ModelError, Simulate, Start, Variables, export};
}

/// Turns the library into an FMU binary with one or more [`Model`]s, which the host selects by GUID,
/// and lists them in `MODELS`.
///
/// The binary exports the functions of FMI 2.0 and 3.0, or those of one version, if only its feature
/// `fmi2` or `fmi3` of this crate is on, as `cargo fmu export` sets it.
#[macro_export]
macro_rules! export {
    ($($model:ty),+ $(,)?) => {
        /// The models of this library.
        #[allow(long_running_const_eval, reason = "a table may be large")]
        pub static MODELS: &[$crate::Entry] = &[$({
            const COUNT: usize = <$model as $crate::Variables>::COUNT;
            const INTERFACE: $crate::derive::Interface =
                $crate::interface::<$model, COUNT>(option_env!("FMU_EXPORT_VARIANT"));
            #[used]
            static EMBEDDED: [u8; $crate::embedded::size(&INTERFACE)] =
                $crate::embedded::write(&INTERFACE);
            $crate::Entry::of::<$model, COUNT>(INTERFACE, &EMBEDDED)
        }),+];

        $crate::instantiate_fmi2!();
        $crate::instantiate_fmi3!();
    };
}

/// Defines `fmi2Instantiate` for `MODELS`.
#[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
#[doc(hidden)]
#[macro_export]
macro_rules! instantiate_fmi2 {
    () => {
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

/// The binary is not for FMI 2.0.
#[cfg(all(feature = "fmi3", not(feature = "fmi2")))]
#[doc(hidden)]
#[macro_export]
macro_rules! instantiate_fmi2 {
    () => {};
}

/// Defines `fmi3InstantiateModelExchange` and `fmi3InstantiateCoSimulation` for `MODELS`.
#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
#[doc(hidden)]
#[macro_export]
macro_rules! instantiate_fmi3 {
    () => {
        /// `fmi3InstantiateModelExchange` (FMI 3.0.2, section 2.3.1).
        ///
        /// # Safety
        /// As required by the standard: every pointer is NULL or valid, strings are zero-terminated,
        /// and the callbacks live as long as the instance.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn fmi3InstantiateModelExchange(
            instance_name: $crate::fmi3::fmi3String,
            instantiation_token: $crate::fmi3::fmi3String,
            resource_path: $crate::fmi3::fmi3String,
            visible: $crate::fmi3::fmi3Boolean,
            logging_on: $crate::fmi3::fmi3Boolean,
            environment: $crate::fmi3::fmi3InstanceEnvironment,
            log_message: ::core::option::Option<$crate::fmi3::fmi3LogMessageCallback>,
        ) -> $crate::fmi3::fmi3Instance {
            // SAFETY: the caller's promise, passed on.
            unsafe {
                $crate::fmi3::instantiate_model_exchange(
                    MODELS,
                    instance_name,
                    instantiation_token,
                    resource_path,
                    visible,
                    logging_on,
                    environment,
                    log_message,
                )
            }
        }

        /// `fmi3InstantiateCoSimulation` (FMI 3.0.2, section 2.3.1).
        ///
        /// # Safety
        /// As required by the standard: every pointer is NULL or valid, strings are zero-terminated,
        /// and the callbacks live as long as the instance.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn fmi3InstantiateCoSimulation(
            instance_name: $crate::fmi3::fmi3String,
            instantiation_token: $crate::fmi3::fmi3String,
            resource_path: $crate::fmi3::fmi3String,
            visible: $crate::fmi3::fmi3Boolean,
            logging_on: $crate::fmi3::fmi3Boolean,
            event_mode_used: $crate::fmi3::fmi3Boolean,
            early_return_allowed: $crate::fmi3::fmi3Boolean,
            required_intermediate_variables: *const $crate::fmi3::fmi3ValueReference,
            n_required_intermediate_variables: usize,
            environment: $crate::fmi3::fmi3InstanceEnvironment,
            log_message: ::core::option::Option<$crate::fmi3::fmi3LogMessageCallback>,
            intermediate_update: ::core::option::Option<
                $crate::fmi3::fmi3IntermediateUpdateCallback,
            >,
        ) -> $crate::fmi3::fmi3Instance {
            // SAFETY: the caller's promise, passed on.
            unsafe {
                $crate::fmi3::instantiate_co_simulation(
                    MODELS,
                    instance_name,
                    instantiation_token,
                    resource_path,
                    visible,
                    logging_on,
                    event_mode_used,
                    early_return_allowed,
                    required_intermediate_variables,
                    n_required_intermediate_variables,
                    environment,
                    log_message,
                    intermediate_update,
                )
            }
        }
    };
}

/// The binary is not for FMI 3.0.
#[cfg(all(feature = "fmi2", not(feature = "fmi3")))]
#[doc(hidden)]
#[macro_export]
macro_rules! instantiate_fmi3 {
    () => {};
}
