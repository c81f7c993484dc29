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
//! # Where to look
//!
//! | To | See |
//! |---|---|
//! | choose sample time, name, tolerance, equations | the options of [`derive@Model`] |
//! | declare inputs, outputs, parameters, states, units and arrays | the attributes and options of [`derive@Variables`] |
//! | use an enum | [`derive@Choice`] |
//! | compute steps or samples, or solve equations | [`Simulate`], [`Continuous`] |
//! | read files in the initialization | [`Start`] |
//! | refuse, discard or end a step | [`ModelError`] |
//! | write messages to the host's logger | [`Log`] |
//! | test a model without a host | [`testing::Driver`] |
//! | have several sample times | [`MultiRate`] |
//! | act at the ticks of clocks | [`Clocked`], [`Clock`] |
//!
//! # How it works
//!
//! A call passes through two layers. The entry points in [`fmi2`] and [`fmi3`] convert pointers to slices and
//! call the instance, which implements what FMI requires of every FMU: the state machine, argument checks,
//! the logger and the panic guard. The instance accesses the model through its table. Only the entry points
//! use the C types of FMI.
//!
//! The three calls that a host makes at every step (set Float64, step, get Float64) are compiled for each
//! model. They have a fast path with a few checks, which never accepts a call that the instance would
//! refuse, and leave all other cases to the instance.

#![cfg_attr(
    any(
        all(feature = "fmi2", not(feature = "fmi3")),
        all(feature = "fmi3", not(feature = "fmi2")),
        feature = "co-simulation",
        feature = "model-exchange",
        feature = "scheduled-execution"
    ),
    allow(
        dead_code,
        unused_imports,
        unused_macros,
        reason = "what only the other version of FMI or the other interface type uses"
    )
)]

mod any_model;
#[cfg(all(fmu_export_no_backtrace, not(target_feature = "crt-static")))]
mod backtrace;
pub mod c;
#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
mod canonical;
mod clock;
mod clock_functions;
mod clocks;
mod deprecated;
mod derivatives;
mod edge;
mod entry;
mod equations;
mod error;
mod events;
#[doc(hidden)]
pub mod exported;
mod fast;
mod initialization;
mod instance;
mod laid_out;
mod large;
mod layout;
mod lifecycle;
mod log;
mod model;
mod model_clocks;
#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
mod needs;
mod pointers;
mod preemption;
mod resources;
mod sample_clocks;
mod saved;
mod single_instance;
mod snapshot;
#[cfg(all(target_arch = "wasm32", feature = "sources"))]
mod source_host;
#[cfg(all(target_arch = "wasm32", feature = "sources"))]
mod source_needs;
mod step;
pub mod testing;
mod values;

#[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
pub use edge::fmi2;
#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
pub use edge::fmi3;
#[doc(hidden)]
#[cfg(all(target_arch = "wasm32", feature = "sources"))]
pub use edge::sources;
#[doc(hidden)]
pub use entry::{Entry, interface};
pub use error::{Context, ModelError};
#[doc(hidden)]
pub use fmi_abi as abi;
#[doc(hidden)]
#[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
pub use fmi_abi::fmi2_functions as functions_of_fmi2;
#[doc(hidden)]
#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
pub use fmi_abi::fmi3_functions as functions_of_fmi3;
#[doc(inline)]
pub use fmu_derive::{Choice, Model, Variables};
pub use fmu_description::{Choice, Clock, Variables};
#[doc(hidden)]
pub use fmu_description::{derive, interface as embedded};
#[doc(hidden)]
pub use laid_out::table_size;
pub use log::Log;
#[doc(hidden)]
pub use model::{Behavior, Rated, Stepped, Ticked};
pub use model::{Clocked, Continuous, Model, MultiRate, Simulate, Start};
#[doc(hidden)]
#[cfg(all(feature = "fmi3", not(feature = "fmi2")))]
pub use no_functions as functions_of_fmi2;
#[doc(hidden)]
#[cfg(all(feature = "fmi2", not(feature = "fmi3")))]
pub use no_functions as functions_of_fmi3;
#[doc(hidden)]
pub use single_instance::SingleInstance;

/// What a model needs: `use fmu_export::prelude::*;`.
pub mod prelude {
    pub use crate::{
        Choice, Clock, Clocked, Context, Continuous, Log, Model, ModelError, MultiRate, Simulate,
        Start, Variables, export,
    };
}

/// Turns the library into an FMU binary with one or more [`Model`]s, which the host selects by GUID,
/// and lists them in `MODELS`. A library has one `export!`, with all its models.
///
/// The binary exports the functions of FMI 2.0 and 3.0, or of one version, if only its feature
/// `fmi2` or `fmi3` of this crate is on, as `cargo fmu export` sets it. It has instances of the interface types that the
/// models support, or of one type, if only its feature `co-simulation`, `model-exchange` or `scheduled-execution` is on.
#[macro_export]
macro_rules! export {
    ($($model:ty),+ $(,)?) => {
        /// The models of this library.
        #[allow(long_running_const_eval, reason = "a table may be large")]
        pub static MODELS: &[$crate::Entry] = &$crate::Entry::all([$({
            struct Exported;
            impl $crate::exported::Exported for Exported {
                type Model = $model;
            }
            const SIZE: usize = $crate::exported::table_size::<Exported>();
            const INTERFACE: $crate::derive::Interface = $crate::exported::interface::<Exported, SIZE>(
                option_env!("FMU_EXPORT_VARIANT"),
                option_env!("FMU_EXPORT_NAMING"),
            )
            .revised(option_env!("FMU_EXPORT_REVISION"));
            // C sources have that of their model only.
            #[cfg_attr(not(target_arch = "wasm32"), used)]
            static EMBEDDED: [u8; $crate::embedded::size(&INTERFACE)] =
                $crate::embedded::write(&INTERFACE);
            $crate::exported::entry::<Exported, SIZE>(INTERFACE, &EMBEDDED)
                .asked_for(option_env!("FMU_EXPORT_MODEL"))
        }),+]);

        #[cfg(target_arch = "wasm32")]
        $crate::export_to_wasm!();

        // Its name is the message of the compiler for a second `export!`.
        #[cfg(not(target_arch = "wasm32"))]
        mod export_takes_all_models_at_once {
            use super::MODELS;

            $crate::functions_of_fmi2!($crate::instantiate! fmi2);
            $crate::functions_of_fmi3!($crate::instantiate! fmi3);
        }
        #[cfg(not(target_arch = "wasm32"))]
        pub use export_takes_all_models_at_once::*;
    };
}

/// Lets the edge of components find `MODELS`.
#[doc(hidden)]
#[cfg(not(feature = "sources"))]
#[macro_export]
macro_rules! export_to_wasm {
    () => {
        #[unsafe(no_mangle)]
        fn fmu_export_models() -> &'static [$crate::Entry] {
            MODELS
        }
    };
}

/// Defines the function of C sources that instantiates the model, and its memory.
#[doc(hidden)]
#[cfg(feature = "sources")]
#[macro_export]
macro_rules! export_to_wasm {
    () => {
        const _: () = {
            use ::core::ffi::{c_char, c_int, c_void};
            use ::core::mem::MaybeUninit;

            const SIZE: usize = $crate::sources::heap(MODELS, option_env!("FMU_EXPORT_HEAP"));
            static mut BLOCK: [MaybeUninit<u8>; SIZE] = [MaybeUninit::uninit(); SIZE];
            #[global_allocator]
            // SAFETY: nothing else uses the block.
            static ALLOCATOR: $crate::sources::Allocator =
                unsafe { $crate::sources::Allocator::new(&raw mut BLOCK) };

            #[unsafe(no_mangle)]
            unsafe extern "C" fn fmu_instantiate(
                name: *const c_char,
                token: *const c_char,
                resources: *const c_char,
                instance_type: c_int,
                logging_on: c_int,
                event_mode_used: c_int,
                early_return_allowed: c_int,
                intermediate_variables: *const u32,
                n: usize,
                has_update: c_int,
            ) -> *mut c_void {
                // SAFETY: the caller's promise, passed on.
                unsafe {
                    $crate::sources::instantiate(
                        MODELS,
                        name,
                        token,
                        resources,
                        instance_type,
                        logging_on,
                        event_mode_used,
                        early_return_allowed,
                        intermediate_variables,
                        n,
                        has_update,
                    )
                }
            }
        };
    };
}

/// Defines the functions that instantiate `MODELS`, from the rows of `fmi-abi`.
#[doc(hidden)]
#[macro_export]
macro_rules! instantiate {
    ($version:ident Free { $($name:ident $args:tt $(-> $result:ty)? => $operation:ident;)* } $($_0:tt)*) => {
        #[allow(unused_imports, reason = "types of arguments")]
        use $crate::$version::*;
        $($crate::instantiate!(@ $version $name $args $operation);)*
    };
    (@ $version:ident $name:ident $args:tt get_version) => {};
    (@ $version:ident $name:ident $args:tt get_types_platform) => {};
    (@ $version:ident $name:ident $args:tt free_instance) => {};
    (@ fmi3 $name:ident $args:tt instantiate_scheduled_execution) => {
        const HAS_PARTITIONS: bool = $crate::Entry::have_partitions(MODELS);
        $crate::instantiate!(@ fmi3 $name $args instantiate_scheduled_execution::<HAS_PARTITIONS>);
    };
    (@ $version:ident $name:ident($($arg:ident: $kind:tt),*) $($operation:tt)+) => {
        #[doc = concat!("`", stringify!($name), "`")]
        ///
        /// # Safety
        /// As required by the standard: every pointer is NULL or valid, strings are zero-terminated, and the
        /// callbacks live as long as the instance.
        #[unsafe(no_mangle)]
        #[allow(non_snake_case, clippy::too_many_arguments, reason = "as in the standard")]
        pub unsafe extern "C" fn $name($($arg: $crate::abi::c_type!($kind)),*) -> *mut ::core::ffi::c_void {
            // SAFETY: the caller's promise, passed on.
            unsafe { $crate::$version::$($operation)+(MODELS, $($arg),*) }
        }
    };
}

/// Ignores the rows of a version that the binary is not for.
#[doc(hidden)]
#[macro_export]
macro_rules! no_functions {
    ($($_0:tt)*) => {};
}
