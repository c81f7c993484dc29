//! Measures cycles of FMUs of FMI 3.0, native or WebAssembly, by the crate `fmu-host`, as the native master calls them:
//! each cycle sets an input, takes a step and gets an output. The arguments are the number of rounds, of cycles in a
//! round, and for each FMU its binary, its instantiation token, the value references of input and output, and how far
//! the input moves. Each line of the result has the time of a cycle (ns) of each FMU in a round.

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use fmu_host::{FmiVersion, Instance, Instantiation, Library, StepVariables};

const STEP: f64 = 1e-3;

struct MeasuredFmu {
    instance: Instance,
    amplitude: f64,
    steps: u32,
}

impl MeasuredFmu {
    fn new(words: &[String]) -> Result<Self, Box<dyn Error>> {
        let [binary, token, input, output, amplitude] = words else {
            return Err("each FMU has five arguments".into());
        };
        let library = Library::load(Path::new(binary), FmiVersion::Fmi3)?;
        let arguments = Instantiation { name: "it", guid: token, ..Instantiation::default() };
        let instance = library.instantiate(&arguments, |logged| eprintln!("{}", logged.text))?;
        let mut instance = instance.ok_or("it cannot be instantiated")?;
        instance.enter_initialization_mode()?;
        instance.exit_initialization_mode()?;
        let [input, output] = [input, output].map(|reference| reference.parse());
        instance.access_at_steps(
            StepVariables::new(&[input?], 0..1),
            StepVariables::new(&[output?], 1..2),
        );
        Ok(Self { instance, amplitude: amplitude.parse()?, steps: 0 })
    }

    /// The time of a cycle in a round (ns).
    fn round(&mut self, cycles: u32) -> Result<f64, Box<dyn Error>> {
        let (mut values, begin) = ([0.0; 2], Instant::now());
        for _ in 0..cycles {
            values[0] = self.amplitude * f64::from(self.steps % 2);
            let time = STEP * f64::from(self.steps);
            match self.instance.cycle(None, time, STEP, &mut values, |_| ()) {
                (3, None) => {}
                (_, Some(outcome)) => _ = (*outcome)?,
                (made, None) => return Err(format!("{made} of 3 calls were made").into()),
            }
            self.steps += 1;
        }
        Ok(begin.elapsed().as_secs_f64() * 1e9 / f64::from(cycles))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [rounds, cycles, words @ ..] = &*words else {
        return Err("the number of rounds and cycles is missing".into());
    };
    let mut fmus = words.chunks(5).map(MeasuredFmu::new).collect::<Result<Vec<_>, _>>()?;
    for _ in 0..rounds.parse()? {
        for fmu in &mut fmus {
            print!("{} ", fmu.round(cycles.parse()?)?);
        }
        println!();
    }
    Ok(())
}
