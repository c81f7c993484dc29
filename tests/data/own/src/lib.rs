//! A model with a resource, a feature and a bug.

use exporter::prelude::*;

/// Adds a length from a file
#[derive(Model)]
#[model(crate = exporter)]
pub struct Own {
    /// a length, which must not be negative
    #[input(unit = "m")]
    u: f64,
    /// the sum
    #[output(unit = "m")]
    y: f64,
    #[cfg_attr(feature = "doubled", local(name = "model", description = "from the file"))]
    offset: f64,
}

impl Simulate for Own {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        self.offset = start.read_resource("data/offset.txt")?.trim().parse()?;
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        assert!(self.u >= 0.0, "u is negative");
        self.y = self.u + self.offset;
        if cfg!(feature = "doubled") {
            self.y *= 2.0;
        }
        Ok(())
    }
}

exporter::export!(Own);
