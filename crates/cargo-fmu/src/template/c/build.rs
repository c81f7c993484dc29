//! Compiles the C code.

fn main() {
    println!("cargo::rerun-if-changed=c");
    cc::Build::new()
        .file("c/pi.c")
        .include("c")
        // The same bits on all processors: no fused multiplications and additions.
        .flag_if_supported("-ffp-contract=off")
        .compile("pi");
}
