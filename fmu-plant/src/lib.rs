//! The cart with the inverted pendulum as an FMU.
#![forbid(unsafe_code)]

mod pendulum;

pub use pendulum::Pendulum;

fmu_export::export!(Pendulum);
