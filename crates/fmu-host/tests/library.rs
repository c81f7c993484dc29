//! Libraries and their instances.

#[path = "../../../tests/fmus.rs"]
mod fmus;

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use fmu_description::FmiVersion;
use fmu_file::archive::Archive;
use fmu_file::platform::Platform;
use fmu_host::{Instance, Instantiation, Kind, Library, Options, Success, Version};
use tempfile::TempDir;

/// The pendulum FMU with the GUID or token of its model description.
struct Pendulum {
    version: Version,
    _folder: TempDir,
    binary: PathBuf,
    guid: String,
}

impl Pendulum {
    fn unpack(version: Version) -> Self {
        let (name, token, of_platform) = match version {
            Version::Fmi2 => ("Pendulum.fmu", "guid=\"", FmiVersion::Fmi2),
            Version::Fmi3 => (
                "Pendulum_fmi3.fmu",
                "instantiationToken=\"",
                FmiVersion::Fmi3,
            ),
        };
        let file = fmus::root().join("target/fmu").join(name);
        let mut archive = Archive::open(&file).unwrap();
        let folder = tempfile::tempdir().unwrap();
        archive.unpack("", folder.path()).unwrap();
        let text = archive.model_description().unwrap();
        let (_, guid) = text.split_once(token).unwrap();
        let platform = Platform::of_this_machine(of_platform).unwrap();
        Self {
            version,
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
        let instance = match self.version {
            Version::Fmi2 => library.instantiate(&arguments, |_| ()),
            Version::Fmi3 => library.instantiate_3(&arguments, Options::default(), |_| ()),
        };
        let mut instance = instance.unwrap().expect("the GUID is right");
        instance.setup_experiment(0.0, None, None).unwrap();
        instance.enter_initialization_mode().unwrap();
        instance.exit_initialization_mode().unwrap();
        instance
    }
}

const VERSIONS: [Version; 2] = [Version::Fmi2, Version::Fmi3];

#[test]
fn steps_do_not_allocate_and_run_on_any_thread() {
    for version in VERSIONS {
        let pendulum = Pendulum::unpack(version);
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
}

#[test]
fn a_library_has_all_functions_and_is_unloaded_after_its_last_instance() {
    for version in VERSIONS {
        let pendulum = Pendulum::unpack(version);
        let is_loaded = || {
            let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
            maps.contains(&*pendulum.binary.to_string_lossy())
        };
        let library = Library::load(&pendulum.binary).unwrap();
        assert_eq!(library.missing_of(version, Kind::CoSimulation), [""; 0]);
        let instance = pendulum.instantiate(&library);
        drop(library);
        assert_eq!(is_loaded(), cfg!(target_os = "linux"));
        drop(instance);
        assert!(!is_loaded());
    }
}

#[test]
fn the_trace_receives_each_function_before_it_is_called() {
    for (version, names) in [
        (
            Version::Fmi2,
            ["fmi2Instantiate", "fmi2SetupExperiment"].as_slice(),
        ),
        (Version::Fmi3, ["fmi3InstantiateCoSimulation"].as_slice()),
    ] {
        let pendulum = Pendulum::unpack(version);
        let calls = Arc::new(Mutex::new(Vec::new()));
        let trace = Arc::clone(&calls);
        let library = Library::load_traced(&pendulum.binary, move |name| {
            trace.lock().unwrap().push(name);
        });
        let mut instance = pendulum.instantiate(&library.unwrap());
        let refused = instance.do_step(0.0, -1.0).unwrap_err();
        drop(instance);
        let prefix = &names[0][..4];
        assert_eq!(
            refused.to_string(),
            format!("{prefix}DoStep returned {prefix}Error, expected {prefix}OK")
        );
        let rest = [
            "EnterInitializationMode",
            "ExitInitializationMode",
            "DoStep",
            "FreeInstance",
        ];
        let mut expected = vec!["loading it".to_owned()];
        expected.extend(names.iter().map(ToString::to_string));
        expected.extend(rest.map(|name| format!("{prefix}{name}")));
        assert_eq!(*calls.lock().unwrap(), expected);
    }
}
