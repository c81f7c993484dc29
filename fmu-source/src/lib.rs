//! Set-point and disturbance of section 4 of the paper as an FMU.
#![forbid(unsafe_code)]

mod source;

pub use source::Source;

fmu_export::export!(Source);
