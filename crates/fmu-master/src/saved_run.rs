//! The state of a run at a communication point as a file, which another run of the same system takes up.
//!
//! A file begins with [`MAGIC`] and the version of the format (`u32`, little endian). A checksum follows
//! ([`checksum`], 16 bytes, little endian), and then a [`SavedRun`] by postcard.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::hash::checksum;
use fmu_description::{FmiVersion, Value};
use fmu_host::InterfaceType;
use serde::{Deserialize, Serialize};

use crate::components::{Components, LoadedComponent, ScalarId};
use crate::connections::ResolvedConnection;
use crate::event_mode::EventMode;
use crate::integrator::IntegratorState;
use crate::rate::Inputs;
use crate::solver::Solver;
use crate::{Conversion, Fault, Fmu, Order};

const MAGIC: [u8; 8] = *b"FMU-RUN\0";
/// To be raised when [`SavedRun`] changes, or what its numbers mean.
const VERSION: u32 = 1;
const HEADER: usize = MAGIC.len() + size_of::<u32>() + size_of::<u128>();
/// The largest state of a component (bytes); a larger one is assumed to be a mistake of the FMU.
pub(crate) const MAX_STATE: usize = 1 << 30;

/// The state of a run at a communication point.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct SavedRun {
    pub(crate) system: SystemIdentity,
    /// The start time of the first run (s), from which the communication points are counted.
    pub(crate) start: f64,
    /// The communication point.
    pub(crate) k: u64,
    pub(crate) components: Vec<SavedComponent>,
    /// What the faults of connections remember, in the order of the connections.
    pub(crate) faults: Vec<Vec<f64>>,
}

/// The state of a component.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct SavedComponent {
    pub(crate) state: Vec<u8>,
    pub(crate) integrator: Option<IntegratorState>,
    pub(crate) event_mode: Option<EventMode>,
    /// The start values with which the run began, by the names of scalars.
    pub(crate) starts: BTreeMap<String, Value>,
}

/// What a system must have in common with the one whose state was saved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SystemIdentity {
    /// The communication step (s).
    pub(crate) step: f64,
    order: Order,
    /// The seed of faults.
    seed: u64,
    components: Vec<ComponentIdentity>,
    connections: Vec<ConnectionIdentity>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct ComponentIdentity {
    name: String,
    /// The name of the file, its GUID or instantiation token, and the checksum of its bytes.
    file: String,
    token: String,
    checksum: u128,
    interface: InterfaceType,
    tolerance: Option<f64>,
    solver: Solver,
    inputs: Inputs,
    event_mode: bool,
    /// Its step (s).
    step: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct ConnectionIdentity {
    from: String,
    to: String,
    conversion: Option<Conversion>,
    faults: Vec<Fault>,
}

impl SystemIdentity {
    /// The identity of a system.
    ///
    /// # Errors
    /// The file of an FMU cannot be read.
    pub(crate) fn new(
        (step, order, seed): (f64, Order, u64),
        components: &Components,
        connections: &[ResolvedConnection],
    ) -> Result<Self> {
        let mut checksums = HashMap::new();
        let component = |component: &LoadedComponent| {
            let LoadedComponent { name, fmu, tolerance, solver, inputs, event_mode, rate, .. } =
                component;
            let checksum = match checksums.get(&fmu.path) {
                Some(known) => *known,
                None if fmu.is_function() => 0,
                None => {
                    let bytes = fs::read(&fmu.path)
                        .with_context(|| format!("cannot read {}", fmu.path.display()))?;
                    *checksums.entry(fmu.path.clone()).or_insert(checksum(&bytes))
                }
            };
            Ok(ComponentIdentity {
                name: name.clone(),
                file: fmu.file_name(),
                token: fmu.token().to_owned(),
                checksum,
                interface: fmu.interface_type,
                tolerance: *tolerance,
                solver: *solver,
                inputs: *inputs,
                event_mode: *event_mode,
                step: rate.step,
            })
        };
        let connection = |connection: &ResolvedConnection| {
            let ResolvedConnection { from, to, conversion, faults } = connection;
            let [from, to] = [from, to].map(|id: &ScalarId| id.name(components));
            ConnectionIdentity { from, to, conversion: *conversion, faults: faults.clone() }
        };
        Ok(Self {
            step,
            order,
            seed,
            components: components.iter().map(component).collect::<Result<_>>()?,
            connections: connections.iter().map(connection).collect(),
        })
    }

    /// Checks that a system is the one whose state was saved.
    ///
    /// # Errors
    /// They differ; the error names the first difference.
    fn check(&self, now: &Self) -> Result<()> {
        let names = |system: &Self| {
            Vec::from_iter(system.components.iter().map(|c| c.name.clone())).join(", ")
        };
        ensure!(
            names(self) == names(now),
            "it is of a system with the components {}, and this one has {}",
            names(self),
            names(now)
        );
        let keys = [
            ("step", format!("{:?}", self.step), format!("{:?}", now.step)),
            ("order", self.order.name().to_owned(), now.order.name().to_owned()),
        ];
        for (key, saved, now) in keys {
            ensure!(
                saved == now,
                "it was saved with {key} = {saved}, expected the same; got {now}"
            );
        }
        for (saved, now) in self.components.iter().zip(&now.components) {
            saved.check(now)?;
        }
        let key = |c: &ConnectionIdentity| (c.to.clone(), c.from.clone());
        let [was, is] = [self, now]
            .map(|system| BTreeMap::from_iter(system.connections.iter().map(|c| (key(c), c))));
        let shown = |((to, from), _): (&(String, String), _)| format!("{from} -> {to}");
        if let Some(missing) = was.iter().find(|(key, _)| !is.contains_key(*key)).map(shown) {
            bail!("it was saved with the connection {missing}, which the system does not have");
        }
        if let Some(new) = is.iter().find(|(key, _)| !was.contains_key(*key)).map(shown) {
            bail!("it was saved without the connection {new}");
        }
        let changed = was.iter().find(|(key, connection)| is[*key] != **connection);
        if let Some(changed) = changed.map(|(key, connection)| shown((key, connection))) {
            bail!("it was saved with another factor, offset or other faults of {changed}");
        }
        let has_faults = self.connections.iter().any(|c| !c.faults.is_empty());
        ensure!(
            self.seed == now.seed || !has_faults,
            "it was saved with seed = {}, expected the same; got {}",
            self.seed,
            now.seed
        );
        ensure!(
            self.connections == now.connections,
            "it was saved with another order of the connections"
        );
        Ok(())
    }
}

impl ComponentIdentity {
    fn check(&self, now: &Self) -> Result<()> {
        let name = &self.name;
        ensure!(
            self.token == now.token,
            "{name} was {} {}, and is {} {}: the state of another FMU or version cannot be loaded",
            self.file,
            self.token,
            now.file,
            now.token
        );
        ensure!(
            self.checksum == now.checksum,
            "{name} was another version of {}: the bytes of the file {} differ",
            self.file,
            now.file
        );
        let interface = |of: &Self| of.interface.as_str();
        ensure!(
            self.interface == now.interface,
            "{name} was run by {}, expected the same; got {}",
            interface(self),
            interface(now)
        );
        ensure!(
            self.solver == now.solver,
            "{name} was integrated by another solver, expected the same"
        );
        ensure!(
            self.inputs == now.inputs,
            "{name} was run with other inputs, held or extrapolated, expected the same"
        );
        ensure!(
            self.event_mode == now.event_mode,
            "{name} was run with or without event mode, expected the same"
        );
        ensure!(
            self.step == now.step,
            "{name} was run with step = {:?}, expected the same; got {:?}",
            self.step,
            now.step
        );
        let tolerance =
            |of: &Self| of.tolerance.map_or_else(|| "none".to_owned(), |t| format!("{t:?}"));
        ensure!(
            self.tolerance == now.tolerance,
            "{name} was run with the tolerance {}, expected the same; got {}",
            tolerance(self),
            tolerance(now)
        );
        Ok(())
    }
}

impl SavedRun {
    /// Reads a file, which may be hostile.
    ///
    /// # Errors
    /// It is no file of a saved run, damaged, or of another version of the format.
    pub(crate) fn read(file: &Path) -> Result<Self> {
        let cannot = || format!("cannot read {}", file.display());
        let mut opened = File::open(file).with_context(cannot)?;
        let mut bytes = Vec::new();
        // A device may have no end.
        (&mut opened).take(HEADER as u64).read_to_end(&mut bytes).with_context(cannot)?;
        if bytes.starts_with(&MAGIC) {
            opened.read_to_end(&mut bytes).with_context(cannot)?;
        }
        Self::decode(&bytes).with_context(|| file.display().to_string())
    }

    fn decode(bytes: &[u8]) -> Result<Self> {
        ensure!(bytes.starts_with(&MAGIC), "it is not the saved state of a run");
        let Some((header, content)) = bytes.split_at_checked(HEADER) else {
            bail!("the saved state is truncated");
        };
        let (version, digest) = header[MAGIC.len()..].split_at(size_of::<u32>());
        let version = version.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte));
        ensure!(
            version == VERSION,
            "the saved state has the format {version}, expected {VERSION}: it was saved by another version of this program"
        );
        ensure!(
            checksum(content).to_le_bytes() == digest,
            "the saved state is damaged or truncated: its checksum differs"
        );
        match postcard::take_from_bytes(content) {
            Ok((saved, [])) => Ok(saved),
            _ => bail!("the saved state is damaged"),
        }
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// There is not enough memory.
    pub(crate) fn encode(&self) -> Result<Vec<u8>> {
        let content = postcard::to_allocvec(self)?;
        let mut bytes = Vec::with_capacity(HEADER + content.len());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&checksum(&content).to_le_bytes());
        bytes.extend(content);
        Ok(bytes)
    }

    /// Checks that the state is of this system.
    ///
    /// # Errors
    /// It is of another one; the error names the first difference.
    pub(crate) fn check(&self, system: &SystemIdentity) -> Result<()> {
        self.system.check(system)?;
        ensure!(
            self.components.len() == system.components.len(),
            "the saved state is damaged: it has {} components",
            self.components.len()
        );
        Ok(())
    }
}

impl Fmu {
    /// Why the state of an instance cannot be saved and restored, if so.
    pub(crate) fn unsavable(&self) -> Option<&'static str> {
        match (self.is_function(), self.saves.in_memory, self.version) {
            (true, ..) => Some("it is a function, whose state is not known"),
            (_, true, _) => None,
            (_, _, FmiVersion::Fmi2) => {
                Some("its model description does not declare canGetAndSetFMUstate")
            }
            (_, _, FmiVersion::Fmi3) => {
                Some("its model description does not declare canGetAndSetFMUState")
            }
        }
    }

    /// Why the state of an instance cannot be saved as bytes, if so.
    pub(crate) fn unserializable(&self) -> Option<&'static str> {
        let reason = match self.version {
            _ if self.saves.in_file => None,
            FmiVersion::Fmi2 => Some("its model description does not declare canSerializeFMUstate"),
            FmiVersion::Fmi3 => Some("its model description does not declare canSerializeFMUState"),
        };
        self.unsavable().or(reason)
    }
}

impl LoadedComponent {
    /// Checks that the state of an instance can be saved in memory, or in a file.
    ///
    /// # Errors
    /// It cannot; the error names the component, its file and the reason.
    pub(crate) fn check_savable(&self, in_file: bool) -> Result<()> {
        let Self { name, fmu, .. } = self;
        let reason = if in_file { fmu.unserializable() } else { fmu.unsavable() };
        match reason {
            None => Ok(()),
            Some(reason) => {
                bail!("the state of {name} ({}) cannot be saved: {reason}", fmu.file_name())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn saved() -> SavedRun {
        let system = SystemIdentity {
            step: 0.001,
            order: Order::Sequential,
            seed: 0,
            components: Vec::new(),
            connections: Vec::new(),
        };
        let component = SavedComponent {
            state: vec![7; 100],
            integrator: None,
            event_mode: None,
            starts: BTreeMap::new(),
        };
        SavedRun { system, start: 0.0, k: 5, components: vec![component], faults: Vec::new() }
    }

    #[test]
    fn every_truncated_and_every_changed_file_is_refused() {
        let bytes = saved().encode().unwrap();
        assert_eq!(SavedRun::decode(&bytes).unwrap().components[0].state, [7; 100]);
        for length in 0..bytes.len() {
            assert!(SavedRun::decode(&bytes[..length]).is_err(), "{length}");
        }
        for place in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[place] ^= 1;
            assert!(SavedRun::decode(&changed).is_err(), "{place}");
        }
        let longer = [&*bytes, &[0]].concat();
        assert!(SavedRun::decode(&longer).is_err());
    }

    #[test]
    fn a_content_with_a_right_checksum_is_not_trusted() {
        let mut bytes = saved().encode().unwrap();
        // The length of a list that does not follow.
        for content in [&[0xff; 9][..], &[], &[0; 8]] {
            bytes.truncate(MAGIC.len() + size_of::<u32>());
            bytes.extend(checksum(content).to_le_bytes());
            bytes.extend_from_slice(content);
            let error = SavedRun::decode(&bytes).unwrap_err().to_string();
            assert_eq!(error, "the saved state is damaged");
        }
    }

    #[test]
    fn another_version_of_the_format_is_named() {
        let mut bytes = saved().encode().unwrap();
        bytes[MAGIC.len()] = 9;
        let error = SavedRun::decode(&bytes).unwrap_err().to_string();
        assert!(error.starts_with("the saved state has the format 9, expected 1"), "{error}");
    }
}
