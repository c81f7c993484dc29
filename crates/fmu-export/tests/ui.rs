//! Mistakes are compile errors that point at the place and say what was expected.
//!
//! Each file has the mistakes of one kind; a new one goes to the end of its file, or to a file of its own.
//! After a change, `TRYBUILD=overwrite cargo test -p fmu-export --test ui` writes the messages anew.

use std::process::Command;

/// The compiler whose messages are in `tests/ui/rustc`.
const RUSTC: &str = "rustc 1.95.";

#[test]
fn mistakes_are_compile_errors() {
    let tests = trybuild::TestCases::new();
    // Messages of the macros.
    tests.compile_fail("tests/ui/*.rs");
    // Messages that the compiler frames, in words that change between its versions.
    let version = Command::new("rustc").arg("--version").output().unwrap();
    if version.stdout.starts_with(RUSTC.as_bytes()) {
        tests.compile_fail("tests/ui/rustc/*.rs");
    }
}
