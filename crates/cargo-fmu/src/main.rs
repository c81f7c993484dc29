//! `cargo fmu`.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    cargo_fmu::main(std::env::args_os())
}
