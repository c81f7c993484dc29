//! Libraries and their instances.

#[path = "../../../tests/fmus.rs"]
mod fmus;

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use fmu_file::archive::Archive;
use fmu_file::platform::Platform;
use fmu_host::{Instance, Instantiation, Kind, Library, Success};
use tempfile::TempDir;

/// The pendulum FMU with the GUID of its model description.
struct Pendulum {
    _folder: TempDir,
    binary: PathBuf,
    guid: String,
}

impl Pendulum {
    fn unpack() -> Self {
        let file = fmus::root().join("target/fmu/Pendulum.fmu");
        let mut archive = Archive::open(&file).unwrap();
        let folder = tempfile::tempdir().unwrap();
        archive.unpack("", folder.path()).unwrap();
        let text = archive.model_description().unwrap();
        let (_, guid) = text.split_once("guid=\"").unwrap();
        let platform = Platform::of_this_machine().unwrap();
        Self {
            binary: folder.path().join(platform.binary("Pendulum")),
            guid: guid.split('"').next().unwrap().into(),
            _folder: folder,
        }
    }

    fn instantiate(&self, library: &Arc<Library>) -> Instance {
        let arguments = Instantiation {
            name: "plant",
            kind: Kind::CoSimulation,
            guid: &self.guid,
            resources: "",
            logging_on: false,
        };
        let instance = library.instantiate(&arguments, |_| ()).unwrap();
        let mut instance = instance.expect("the GUID is right");
        instance.setup_experiment(0.0, None, None).unwrap();
        instance.enter_initialization_mode().unwrap();
        instance.exit_initialization_mode().unwrap();
        instance
    }
}

#[test]
fn steps_do_not_allocate_and_run_on_any_thread() {
    let pendulum = Pendulum::unpack();
    let library = Library::load(&pendulum.binary).unwrap();
    let mut instance = pendulum.instantiate(&library);
    let work = move || {
        let mut values = [0.0; 2];
        let allocated = allocation_counter::measure(|| {
            for k in 0..100 {
                instance.get_real(&[0, 1], &mut values).unwrap();
                assert_eq!(instance.do_step(f64::from(k), 1.0), Ok(Success::Ok));
            }
        });
        assert_eq!(allocated.count_total, 0);
    };
    std::thread::spawn(work).join().unwrap();
}

#[test]
fn a_library_has_all_functions_and_is_unloaded_after_its_last_instance() {
    let pendulum = Pendulum::unpack();
    let is_loaded = || {
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
        maps.contains(&*pendulum.binary.to_string_lossy())
    };
    let library = Library::load(&pendulum.binary).unwrap();
    assert_eq!(library.missing(Kind::CoSimulation), [""; 0]);
    let instance = pendulum.instantiate(&library);
    drop(library);
    assert_eq!(is_loaded(), cfg!(target_os = "linux"));
    drop(instance);
    assert!(!is_loaded());
}

#[test]
fn the_trace_receives_each_function_before_it_is_called() {
    let pendulum = Pendulum::unpack();
    let calls = Arc::new(Mutex::new(Vec::new()));
    let trace = Arc::clone(&calls);
    let library = Library::load_traced(&pendulum.binary, move |name| {
        trace.lock().unwrap().push(name);
    });
    let mut instance = pendulum.instantiate(&library.unwrap());
    let refused = instance.do_step(0.0, -1.0).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "fmi2DoStep returned fmi2Error, expected fmi2OK"
    );
    drop(instance);
    let expected = [
        "loading it",
        "fmi2Instantiate",
        "fmi2SetupExperiment",
        "fmi2EnterInitializationMode",
        "fmi2ExitInitializationMode",
        "fmi2DoStep",
        "fmi2FreeInstance",
    ];
    assert_eq!(*calls.lock().unwrap(), expected);
}
