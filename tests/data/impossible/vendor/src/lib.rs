//! A library that needs an operating system for some of its functions.

use std::time::Instant;

/// A random number of the C library.
pub fn noise() -> f64 {
    unsafe extern "C" {
        safe fn rand() -> i32;
    }
    f64::from(rand())
}

/// The time that a calculation takes [s].
pub fn time(calculation: impl FnOnce() -> f64) -> f64 {
    let begin = Instant::now();
    calculation();
    begin.elapsed().as_secs_f64()
}

/// The double of a value, without any of this.
pub fn double(value: f64) -> f64 {
    2.0 * value
}
