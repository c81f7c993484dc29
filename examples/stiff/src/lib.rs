//! Stiff models, which are integrated by the implicit method:
//!
//! ```sh
//! cargo fmu export --package stiff --fmi 2.0,3.0 --out target/examples
//! ```
#![forbid(unsafe_code)]

mod contact;
mod robertson;

pub use contact::Contact;
pub use robertson::Robertson;

fmu_export::export!(Contact, Robertson);
