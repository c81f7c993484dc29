//! Literals that overflow, which only the compiler finds in expressions, and only if there is no other mistake.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Literals {
    /** the largest is 255 */ #[input(start = 300 / 2)] byte: u8,
    /** 128 before the sign */ #[input(start = [-(129), 0])] signed: [i8; 2],
    /** beyond its type */ #[parameter(start = 256)] large: u8,
    /** an element beyond its type */ #[parameter(start = [-129, 0])] small: [i8; 2],
    /** a bound */ #[input(max = 4_294_967_296 / 2)] bounded: i32,
}

fn main() {}
