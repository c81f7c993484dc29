//! A model with bugs and with texts and bytes, as an FMU.

use fmu_export::prelude::*;

/// y = u, but panics if u is negative, never returns if it is 2, and allocates gigabytes if it is 3
#[derive(Model)]
pub struct Panicking {
    /// what must not be negative
    #[input(max = 9)]
    u: f64,
    /// the same
    #[output]
    y: f64,
    /// a text
    #[input]
    text: String,
    /// the same
    #[output]
    echo: String,
    /// bytes
    #[input]
    data: Vec<u8>,
    /// the same
    #[output]
    copy: Vec<u8>,
}

impl Simulate for Panicking {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        assert!(self.u >= 0.0, "u is {:?}", self.u);
        while self.u == 2.0 {
            std::hint::black_box(&self.u);
        }
        if self.u == 3.0 {
            self.copy = vec![1; 3 << 29];
        }
        self.y = self.u;
        self.echo.clone_from(&self.text);
        self.copy.clone_from(&self.data);
        Ok(())
    }
}

export!(Panicking);
