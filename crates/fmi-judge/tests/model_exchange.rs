//! The crate `fmi` integrates the pendulum of both versions of FMI, and steps the pendulum of FMI 3.0. Requires the
//! FMUs of `cargo fmu export`.

use std::path::{Path, PathBuf};

use fmi::EventFlags;
use fmi::fmi2::import::Fmi2Import;
use fmi::fmi2::instance::{CoSimulation as _, Common as _};
use fmi::fmi3::import::Fmi3Import;
use fmi::fmi3::{CoSimulation as _, Fmi3Model, GetSet as _};
use fmi::traits::{FmiImport, FmiInstance, FmiModelExchange};
use fmi_judge::STEP;
use fmu_file::archive::Archive;

const STEPS: u32 = 500;
/// The value references of the force and the angle, in both versions
const FORCE: [u32; 1] = [0];
const ANGLE: [u32; 1] = [1];

fn fmu(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/fmu").join(name)
}

fn fmi2() -> Fmi2Import {
    fmi::import::from_path(fmu("Pendulum.fmu")).unwrap()
}

/// Opens the FMU without the attributes of variables that `fmi-schema` 0.8 does not know.
fn fmi3() -> Fmi3Import {
    let folder = tempfile::tempdir().unwrap();
    let mut archive = Archive::open(&fmu("Pendulum_fmi3.fmu")).unwrap();
    archive.unpack("", folder.path()).unwrap();
    let mut xml = archive.model_description().unwrap();
    for attribute in [" unit=\"", " displayUnit=\"", " nominal=\""] {
        while let Some(start) = xml.find(attribute) {
            let value = start + attribute.len();
            let end = value + xml[value..].find('"').unwrap();
            xml.replace_range(start..=end, "");
        }
    }
    Fmi3Import::new(folder, &xml).unwrap()
}

fn initialize<M: FmiInstance>(model: &mut M) {
    assert!(model.enter_initialization_mode(None, 0.0, None).is_ok());
    assert!(model.exit_initialization_mode().is_ok());
}

/// Returns the states (angle, its velocity, position, velocity) by the classical Runge-Kutta method.
fn integrate(model: &mut impl FmiModelExchange) -> [f64; 4] {
    initialize(model);
    let mut event = EventFlags::default();
    assert!(model.update_discrete_states(&mut event).is_ok());
    assert!(!event.discrete_states_need_update && event.next_event_time.is_none());
    assert!(model.enter_continuous_time_mode().is_ok());
    let mut x = [0.0; 4];
    assert!(model.get_continuous_states(&mut x).is_ok());
    for k in 0..STEPS {
        let time = f64::from(k) * STEP;
        let mut slope = [0.0; 4];
        let mut next = x;
        for (late, weight) in [(0.0, 1.0), (STEP / 2.0, 2.0), (STEP / 2.0, 2.0), (STEP, 1.0)] {
            let stage: Vec<_> = x.iter().zip(slope).map(|(x, dx)| x + late * dx).collect();
            assert!(model.set_time(time + late).is_ok());
            assert!(model.set_continuous_states(&stage).is_ok());
            assert!(model.get_continuous_state_derivatives(&mut slope).is_ok());
            for (next, dx) in next.iter_mut().zip(slope) {
                *next += STEP / 6.0 * weight * dx;
            }
        }
        x = next;
    }
    x
}

#[test]
fn both_versions_give_the_same_bits_by_model_exchange_and_by_co_simulation() {
    let (fmi2, fmi3) = (fmi2(), fmi3());

    let mut stepped2 = fmi2.instantiate_cs("stepped", false, true).unwrap();
    stepped2.set_real(&FORCE, &[1.0]).unwrap();
    initialize(&mut stepped2);
    let mut stepped3 = fmi3.instantiate_cs("stepped", false, true, false, false, &[]).unwrap();
    stepped3.set_float64(&FORCE, &[1.0]).unwrap();
    initialize(&mut stepped3);
    let (mut angle2, mut angle3) = ([0.0], [0.0]);
    for k in 0..STEPS {
        let time = f64::from(k) * STEP;
        stepped2.do_step(time, STEP, true).unwrap();
        let (mut event, mut terminate, mut early, mut reached) = (false, false, false, 0.0);
        stepped3
            .do_step(time, STEP, true, &mut event, &mut terminate, &mut early, &mut reached)
            .unwrap();
        assert!(!event && !terminate && !early && reached > time);
        stepped2.get_real(&ANGLE, &mut angle2).unwrap();
        stepped3.get_float64(&ANGLE, &mut angle3).unwrap();
        assert_eq!(angle2[0].to_bits(), angle3[0].to_bits(), "step {k}");
    }

    let mut integrated2 = fmi2.instantiate_me("integrated", false, true).unwrap();
    integrated2.set_real(&FORCE, &[1.0]).unwrap();
    let states = integrate(&mut integrated2);
    let mut integrated3 = fmi3.instantiate_me("integrated", false, true).unwrap();
    integrated3.set_float64(&FORCE, &[1.0]).unwrap();
    assert_eq!(states.map(f64::to_bits), integrate(&mut integrated3).map(f64::to_bits));
    assert!(angle2[0] > 0.5);
    assert!((states[0] - angle2[0]).abs() < 1e-10, "{states:?} {angle2:?}");
}
