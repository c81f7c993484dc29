//! Measures cycles of FMUs, native or WebAssembly, by the crate `fmu-host`, as the native master calls them: each cycle
//! sets an input, takes a step and gets an output. And samples of controllers by the crate `pendulum-control`, as in a
//! program without FMUs.
//!
//! usage: bench-host ROUNDS CYCLES [NAME FMI BINARY TOKEN INPUT OUTPUT AMPLITUDE]...
//!
//! An FMU has a name, the version of FMI, 2 or 3, its binary, its GUID or instantiation token, the value references of
//! input and output, and how far the input moves. Without FMUs, it measures the controllers. Each line of the result
//! has a name, a tab, and the time of a cycle or sample in each round (ns).

use std::array;
use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use fmu_host::{FmiVersion, Instance, Instantiation, Library, StepVariables};
use pendulum_control::closed_loop::{pid, pid_rbf};
use pendulum_control::pid::Integral;
use pendulum_control::{PidRbf, Rbf};

const STEP: f64 = 1e-3;

/// Takes a number of cycles.
type Subject = Box<dyn FnMut(u32) -> Result<(), Box<dyn Error>>>;

fn fmu(words: &[String]) -> Result<(String, Subject), Box<dyn Error>> {
    let [name, fmi, binary, token, input, output, amplitude] = words else {
        return Err("each FMU has seven arguments".into());
    };
    let version = if fmi == "3" { FmiVersion::Fmi3 } else { FmiVersion::Fmi2 };
    let library = Library::load(Path::new(binary), version)?;
    let arguments = Instantiation { name: "it", guid: token, ..Instantiation::default() };
    let instance = library.instantiate(&arguments, |logged| eprintln!("{}", logged.text))?;
    let mut instance: Instance = instance.ok_or("it cannot be instantiated")?;
    instance.enter_initialization_mode()?;
    instance.exit_initialization_mode()?;
    let [input, output] = [input, output].map(|reference| reference.parse());
    let [input, output] =
        [StepVariables::new(&[input?], 0..1), StepVariables::new(&[output?], 1..2)];
    instance.access_at_steps(input, output);
    let (amplitude, mut values, mut steps) = (amplitude.parse::<f64>()?, [0.0; 2], 0_u32);
    let cycles = move |count| {
        for _ in 0..count {
            values[0] = amplitude * f64::from(steps % 2);
            let time = STEP * f64::from(steps);
            match instance.cycle(None, time, STEP, &mut values, |_| ()) {
                (3, None) => {}
                (_, Some(outcome)) => _ = (*outcome)?,
                (made, None) => return Err(format!("{made} of 3 calls were made").into()),
            }
            steps += 1;
        }
        Ok(())
    };
    Ok((name.clone(), Box::new(cycles)))
}

/// A controller with constant inputs, and with changing inputs: set-point, measured value and disturbance.
fn samples<Sample: FnMut([f64; 3]) -> f64 + 'static>(
    name: &str,
    controller: impl Fn() -> Sample,
) -> [(String, Subject); 2] {
    // Values with mean zero, which always change and are large enough to avoid denormal numbers.
    let value = |k: usize| 0.1 * libm::sin(core::f64::consts::TAU * (k as f64 + 0.5) / 64.0);
    let changing: [[f64; 3]; 64] = array::from_fn(|k| array::from_fn(|i| value(k + i)));
    [("constant", [[1.0, 0.99, 0.0]; 64]), ("changing", changing)].map(|(kind, inputs)| {
        let mut sample = controller();
        let samples = move |count: u32| {
            for input in inputs.iter().cycle().take(count as usize) {
                black_box(sample(black_box(*input)));
            }
            Ok(())
        };
        (format!("{name} {kind}"), Box::new(samples) as Subject)
    })
}

/// `PidRbf` with some number of nodes.
fn network<const N: usize>() -> [(String, Subject); 2] {
    samples(&N.to_string(), || {
        // Nodes spread evenly over -2 to 2.
        let mut network = Rbf::<N>::default();
        network.centres = array::from_fn(|j| 4.0 * (j as f64 + 0.5) / N as f64 - 2.0);
        network.widths = [0.5; N];
        network.eta = 0.3 / N as f64; // the bound of section 3.2 shrinks with the number of nodes
        network.alpha = 0.05;
        network.reset();
        let mut c = PidRbf { pid: pid(Integral::Sum, false), network, ..PidRbf::default() };
        move |[r, y, d]| c.sample(r, y, d)
    })
}

fn controllers() -> Vec<(String, Subject)> {
    let pid = samples("Pid", || {
        let mut c = pid(Integral::Sum, false);
        move |[r, y, d]| c.sample(r, y, d)
    });
    let rbf = samples("PidRbf", || {
        let mut c = pid_rbf(false, [0.0; 4]);
        move |[r, y, d]| c.sample(r, y, d)
    });
    [pid, rbf, network::<128>(), network::<256>()].into_iter().flatten().collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [rounds, cycles, words @ ..] = &*words else {
        return Err("the number of rounds and cycles is missing".into());
    };
    let fmus = words.chunks(7).map(fmu).collect::<Result<Vec<_>, _>>()?;
    let mut subjects = if fmus.is_empty() { controllers() } else { fmus };
    let (rounds, cycles): (usize, u32) = (rounds.parse()?, cycles.parse()?);
    let mut times = vec![Vec::new(); subjects.len()];
    for _ in 0..rounds {
        for ((_, run), times) in subjects.iter_mut().zip(&mut times) {
            let begin = Instant::now();
            run(cycles)?;
            times.push((begin.elapsed().as_secs_f64() * 1e9 / f64::from(cycles)).to_string());
        }
    }
    for ((name, _), times) in subjects.iter().zip(times) {
        println!("{name}\t{}", times.join(" "));
    }
    Ok(())
}
