//! Controllers of the blocks of `control-blocks`:
//!
//! ```sh
//! cargo fmu export --package blocks --out target/examples
//! ```
//!
//! - [`Servo`]: the cascade of a drive, as one would write it.
//! - [`Bench`]: each block by itself, which the tests compare with SciPy.
#![forbid(unsafe_code)]

mod bench;
mod servo;

pub use bench::Bench;
pub use servo::Servo;

fmu_export::export!(Servo, Bench);
