//! `cargo fmu`.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    cargo_fmu::main(Vec::new(), std::env::args_os())
}
