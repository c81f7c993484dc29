//! Leaves the symbolizer of backtraces, a third of a library, out of binaries.
//!
//! The panic hook of `std` can print a backtrace, so every library contains what reads debug information. An
//! FMU never prints one (`log::silence_panics`). `std` gives the code that does so to `_Unwind_Backtrace` as a
//! callback. If that function is known to do nothing, the linker drops the callback and all that it needs.
//!
//! `cargo fmu export` sets `fmu_export_no_backtrace` for targets whose C library has this function in a
//! library of its own (`libgcc_s`).

use std::ffi::{c_int, c_void};

/// The end of the stack is reached (`_URC_END_OF_STACK`).
const END_OF_STACK: c_int = 5;

// Only this library's own copy of `std` calls it, so it is not exported.
std::arch::global_asm!(".hidden _Unwind_Backtrace");

/// A backtrace without frames.
#[unsafe(no_mangle)]
extern "C" fn _Unwind_Backtrace(_trace: *const c_void, _argument: *mut c_void) -> c_int {
    END_OF_STACK
}
