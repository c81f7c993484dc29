//! The closed loop of the paper with PID-RBF, coupled manually through the crate `fmi`, and through
//! `fmu-host` in the same way. The crate `fmi` serves as an independent judge: its C interface is
//! generated from the official headers, it parses the model descriptions itself, and it shares no code
//! with this repository.
#![forbid(unsafe_code)]

use std::path::Path;

use fmi::fmi2::import::Fmi2Import;
use fmi::fmi2::instance::{CoSimulation, Common, InstanceCS};
use fmi::traits::FmiImport;
use fmu_host::{Instance, Instantiation, Library, Version};

/// The communication step, and the first communication point (s).
pub const STEP: f64 = 0.001;

/// The time of a communication point (s).
pub fn time(k: u32) -> f64 {
    STEP + f64::from(k) * STEP
}

/// A co-simulation slave loaded by one of the hosts. For tests: a failed call panics.
pub trait Slave: Sized {
    /// Instantiates an FMU.
    fn new(import: &Fmi2Import) -> Self;
    /// `fmi2SetupExperiment` and `fmi2EnterInitializationMode`
    fn enter_initialization(&mut self);
    /// `fmi2ExitInitializationMode`
    fn exit_initialization(&mut self);
    /// `fmi2SetBoolean`
    fn set_boolean(&mut self, reference: u32, value: bool);
    /// `fmi2SetReal`
    fn set_real(&mut self, references: &[u32], values: &[f64]);
    /// `fmi2GetReal`
    fn get_real(&mut self, references: &[u32], values: &mut [f64]);
    /// `fmi2DoStep`
    fn step(&mut self, time: f64);
}

impl Slave for InstanceCS {
    fn new(import: &Fmi2Import) -> Self {
        InstanceCS::new(import, "judged", false, true).unwrap()
    }

    fn enter_initialization(&mut self) {
        self.setup_experiment(None, time(0), None).unwrap();
        self.enter_initialization_mode().unwrap();
    }

    fn exit_initialization(&mut self) {
        self.exit_initialization_mode().unwrap();
    }

    fn set_boolean(&mut self, reference: u32, value: bool) {
        Common::set_boolean(self, &[reference], &[value.into()]).unwrap();
    }

    #[inline]
    fn set_real(&mut self, references: &[u32], values: &[f64]) {
        Common::set_real(self, references, values).unwrap();
    }

    #[inline]
    fn get_real(&mut self, references: &[u32], values: &mut [f64]) {
        Common::get_real(self, references, values).unwrap();
    }

    #[inline]
    fn step(&mut self, time: f64) {
        self.do_step(time, STEP, true).unwrap();
    }
}

impl Slave for Instance {
    fn new(import: &Fmi2Import) -> Self {
        let model = import.model_description();
        let identifier = &model.co_simulation.as_ref().unwrap().model_identifier;
        let binary = import.shared_lib_path(identifier).unwrap();
        let library = Library::load(&import.archive_path().join(binary), Version::Fmi2).unwrap();
        let arguments = Instantiation {
            name: "ours",
            guid: &model.guid,
            resources: &library.location(&import.resource_path()),
            logging_on: true,
            ..Instantiation::default()
        };
        library.instantiate(&arguments, |_| ()).unwrap().unwrap()
    }

    fn enter_initialization(&mut self) {
        self.setup_experiment(time(0), None, None).unwrap();
        self.enter_initialization_mode().unwrap();
    }

    fn exit_initialization(&mut self) {
        self.exit_initialization_mode().unwrap();
    }

    fn set_boolean(&mut self, reference: u32, value: bool) {
        Instance::set_boolean(self, &[reference], &[value.into()]).unwrap();
    }

    #[inline]
    fn set_real(&mut self, references: &[u32], values: &[f64]) {
        Instance::set_float64(self, references, values).unwrap();
    }

    #[inline]
    fn get_real(&mut self, references: &[u32], values: &mut [f64]) {
        Instance::get_float64(self, references, values).unwrap();
    }

    #[inline]
    fn step(&mut self, time: f64) {
        self.do_step(time, STEP).unwrap();
    }
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

/// Source, controller and plant, with the value references that the loop sets and gets.
pub struct ClosedLoop<S> {
    controller: S,
    plant: S,
    source: S,
    /// r, d, y
    inputs: [u32; 3],
    /// e, u
    outputs: [u32; 2],
    force: [u32; 1],
    theta: [u32; 1],
    /// r, d
    signals: [u32; 2],
}

impl<S: Slave> ClosedLoop<S> {
    /// Instantiates and initializes the FMUs as specified in `examples/closed-loop/pid-rbf.toml`.
    pub fn new(fmus: &Fmus) -> Self {
        let [controller, plant, source] = fmus.0.each_ref().map(S::new);
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
        let [terms] = fmus.references(0, ["previous_sample_terms"]);
        new.controller.set_boolean(terms, true);
        let slaves = [&mut new.controller, &mut new.plant, &mut new.source];
        slaves.into_iter().for_each(S::enter_initialization);
        // A chain of direct dependencies of outputs on inputs is at most as long as the number of FMUs.
        for _ in 0..3 {
            new.feed_controller();
            new.feed_plant();
        }
        let slaves = [&mut new.controller, &mut new.plant, &mut new.source];
        slaves.into_iter().for_each(S::exit_initialization);
        new
    }

    #[inline]
    fn feed_controller(&mut self) {
        let mut values = [0.0; 3];
        self.source.get_real(&self.signals, &mut values[..2]);
        self.plant.get_real(&self.theta, &mut values[2..]);
        self.controller.set_real(&self.inputs, &values);
    }

    /// Returns e and u.
    #[inline]
    fn feed_plant(&mut self) -> [f64; 2] {
        let mut values = [0.0; 2];
        self.controller.get_real(&self.outputs, &mut values);
        self.plant.set_real(&self.force, &values[1..]);
        values
    }

    /// Steps in sequential order from a communication point; returns e and u.
    #[inline]
    pub fn step(&mut self, time: f64) -> [f64; 2] {
        self.feed_controller();
        self.controller.step(time);
        let values = self.feed_plant();
        self.plant.step(time);
        self.source.step(time);
        values
    }
}
