//! An example beside the library.

fn main() {}
