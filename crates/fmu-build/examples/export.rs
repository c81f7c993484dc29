//! Exports all models of the workspace of the current folder for FMI 2.0, as `cargo fmu export` does, but
//! is built much faster than the command line.

fn main() -> anyhow::Result<()> {
    let written = fmu_build::export(&fmu_build::ExportOptions::default(), &|_| ())?;
    for fmu in written {
        println!("{}", fmu.file.display());
    }
    Ok(())
}
