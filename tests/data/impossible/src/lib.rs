//! A model that C sources cannot have, beside one that they can.

use std::fs;
use std::thread;

use fmu_export::prelude::*;

/// Reads files, starts threads, and lets a library use the clock and the C library
#[derive(Model)]
#[model(sample_time = 0.1)]
pub struct Impossible {
    /// input
    #[input]
    u: f64,
    /// output
    #[output]
    y: f64,
}

impl Simulate for Impossible {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        // The optimizer leaves nothing of it where there are no files.
        self.y = fs::read("offset").unwrap_or_default().len() as f64;
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        let u = self.u;
        let square = thread::spawn(move || u * u).join().unwrap_or_default();
        self.y = vendor::time(|| square) + vendor::noise();
        Ok(())
    }
}

/// Uses the harmless part of the same library
#[derive(Model)]
#[model(sample_time = 0.1)]
pub struct Possible {
    /// input
    #[input]
    u: f64,
    /// output
    #[output]
    y: f64,
}

impl Simulate for Possible {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.y = vendor::double(self.u);
        println!("prints are lost where there is no system");
        Ok(())
    }
}

export!(Impossible, Possible);
