//! How a run is executed, which does not change its results: paced by the clock, or in several threads.

use std::num::NonZeroUsize;

use clap::Args;
use serde::{Deserialize, Serialize};

/// How a run is executed; the options of `cargo fmu simulate`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, Args)]
pub struct Execution {
    /// Pace the steps by the clock: FACTOR 1 is real time, 2 twice as fast. Rows are written at once, and rows of
    /// --input that come through a pipe take effect when they arrive
    #[arg(
        long,
        value_name = "FACTOR",
        num_args = 0..=1,
        default_missing_value = "1",
        value_parser = factor,
        allow_negative_numbers = true
    )]
    pub real_time: Option<f64>,
    /// Number of threads in which components step at the same time, where the order allows it, with the same results
    #[arg(long, value_name = "N")]
    pub threads: Option<NonZeroUsize>,
}

/// Reads a factor from a command line.
fn factor(text: &str) -> Result<f64, String> {
    let factor = text.parse().map_err(|_| "expected a number, such as 1".to_owned())?;
    check_factor(factor).map(|()| factor)
}

/// Checks a factor of real time.
///
/// # Errors
/// It is not a finite number above 0.
pub fn check_factor(factor: f64) -> Result<(), String> {
    match factor > 0.0 && factor.is_finite() {
        true => Ok(()),
        false => Err("expected a finite number above 0".to_owned()),
    }
}
