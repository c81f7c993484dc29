//! A program beside the library.

fn main() {}
