//! A discriminant of which only the lowest 32 bits would be left.

use fmu_export::prelude::*;

/// State of the plant
#[derive(Clone, Copy, Choice)]
#[repr(u32)]
enum Code {
    /** negative in FMI */ Failed = 0x8000_0000,
}

#[derive(Variables)]
struct Codes {
    /** code */ #[output] code: Code,
}

fn main() {}
