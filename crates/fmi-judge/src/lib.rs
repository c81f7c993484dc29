//! The closed loop of the paper with PID-RBF, coupled manually through the crate `fmi`, an independent judge: its
//! C interface is generated from the official headers, it parses the model descriptions itself, and it shares
//! no code with this repository.
#![forbid(unsafe_code)]

use std::path::Path;

use fmi::fmi2::import::Fmi2Import;
use fmi::fmi2::instance::{CoSimulation, Common, InstanceCS};
use fmi::traits::FmiImport;

/// The communication step, and the first communication point (s).
pub const STEP: f64 = 0.001;

/// The time of a communication point (s).
pub fn time(k: u32) -> f64 {
    STEP + f64::from(k) * STEP
}

/// The FMUs of the loop, unpacked and read by the crate `fmi`.
pub struct Fmus([Fmi2Import; 3]);

impl Fmus {
    /// Opens the FMUs that `cargo fmu export` writes to `target/fmu`.
    pub fn open() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/fmu");
        Self(["PidRbf", "Pendulum", "Source"].map(|model| {
            let file = root.join(model).with_extension("fmu");
            fmi::import::from_path(file).expect("`cargo fmu export` writes the FMUs")
        }))
    }

    fn references<const N: usize>(&self, fmu: usize, names: [&str; N]) -> [u32; N] {
        let model = self.0[fmu].model_description();
        names.map(|name| {
            let mut variables = model.model_variables.variables.iter();
            variables.find(|v| v.name == name).unwrap().value_reference
        })
    }
}

/// Source, controller and plant, with the value references that the loop sets and gets. For tests: a failed
/// call panics.
pub struct ClosedLoop {
    controller: InstanceCS,
    plant: InstanceCS,
    source: InstanceCS,
    /// r, d, y
    inputs: [u32; 3],
    /// e, u
    outputs: [u32; 2],
    force: [u32; 1],
    theta: [u32; 1],
    /// r, d
    signals: [u32; 2],
}

impl ClosedLoop {
    /// Instantiates and initializes the FMUs as specified in `examples/closed-loop/pid-rbf.toml`.
    pub fn new(fmus: &Fmus) -> Self {
        let instantiate = |fmu| InstanceCS::new(fmu, "judged", false, true).unwrap();
        let [controller, plant, source] = fmus.0.each_ref().map(instantiate);
        let mut new = Self {
            controller,
            plant,
            source,
            inputs: fmus.references(0, ["r", "d", "y"]),
            outputs: fmus.references(0, ["e", "u"]),
            force: fmus.references(1, ["u"]),
            theta: fmus.references(1, ["theta"]),
            signals: fmus.references(2, ["r", "d"]),
        };
        let terms = fmus.references(0, ["previous_sample_terms"]);
        new.controller.set_boolean(&terms, &[1]).unwrap();
        for fmu in [&mut new.controller, &mut new.plant, &mut new.source] {
            fmu.setup_experiment(None, time(0), None).unwrap();
            fmu.enter_initialization_mode().unwrap();
        }
        // A chain of direct dependencies of outputs on inputs is at most as long as the number of FMUs.
        for _ in 0..3 {
            new.feed_controller();
            new.feed_plant();
        }
        for fmu in [&mut new.controller, &mut new.plant, &mut new.source] {
            fmu.exit_initialization_mode().unwrap();
        }
        new
    }

    fn feed_controller(&mut self) {
        let mut values = [0.0; 3];
        let (signals, theta) = values.split_at_mut(2);
        self.source.get_real(&self.signals, signals).unwrap();
        self.plant.get_real(&self.theta, theta).unwrap();
        self.controller.set_real(&self.inputs, &values).unwrap();
    }

    /// Returns e and u.
    fn feed_plant(&mut self) -> [f64; 2] {
        let mut values = [0.0; 2];
        self.controller.get_real(&self.outputs, &mut values).unwrap();
        self.plant.set_real(&self.force, &values[1..]).unwrap();
        values
    }

    /// Steps in sequential order from a communication point; returns e and u.
    pub fn step(&mut self, time: f64) -> [f64; 2] {
        self.feed_controller();
        self.controller.do_step(time, STEP, true).unwrap();
        let values = self.feed_plant();
        self.plant.do_step(time, STEP, true).unwrap();
        self.source.do_step(time, STEP, true).unwrap();
        values
    }
}
