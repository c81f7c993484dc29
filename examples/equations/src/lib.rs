//! Models with equations and events, three of them after the Reference FMUs:
//!
//! ```sh
//! cargo fmu export --package equations --fmi 2.0,3.0 --out target/examples
//! ```
//!
//! Each is written once, for model exchange and co-simulation in both versions of FMI.
#![forbid(unsafe_code)]

mod bouncing_ball;
mod cascade;
mod stair;
mod thermostat;
mod van_der_pol;

fmu_export::export!(
    bouncing_ball::BouncingBall,
    cascade::Cascade,
    stair::Stair,
    thermostat::Thermostat,
    van_der_pol::VanDerPol
);
