//! Prints the `modelDescription.xml` of every model of this library, for `cargo fmu export`.
#![forbid(unsafe_code)]

fn main() -> std::io::Result<()> {
    fmu_export::print_descriptions(fmu_controller::MODELS)
}
