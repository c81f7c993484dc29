//! The complete state of an instance: taken, restored and serialized (FMI 2.0.5, section 2.1.8; FMI 3.0.2, section
//! 2.2.7.4).

use fmu_description::derive::state_layout;
use fmu_description::hash::checksum;
use fmu_description::{StateReader, StateWriter};

use crate::any_model::AnyModel;
use crate::clock::RateClocks;
use crate::error::{ModelError, ensure};
use crate::instance::{Guid, Instance, PresentInstant};
use crate::lifecycle::Lifecycle;
use crate::pointers::readable;
use crate::saved::Saved;

/// The first bytes of a serialized state.
pub(crate) const MAGIC: [u8; 8] = *b"FMUSTATE";
/// The format of the serialized states of a model whose fields have this layout. Bytes of another format are refused.
pub(crate) const fn format(model: u128) -> u32 {
    /// The version of the header and of the order of the parts, to be raised when [`Instance::serialize`] changes. The
    /// layouts of the parts follow from their fields.
    const VERSION: u128 = 13;
    state_layout(&[("", "", VERSION), ("", "", Lifecycle::LAYOUT), ("", "", model)]) as u32
}

const CHECKSUM: usize = size_of::<u128>();
const HEADER: usize = MAGIC.len() + size_of::<u32>() + size_of::<Guid>();

/// The complete state of an instance.
pub(crate) struct Snapshot {
    guid: Guid,
    pub(crate) lifecycle: Lifecycle,
    clocks: RateClocks,
    starts: Option<Box<dyn AnyModel>>,
    model: Box<dyn AnyModel>,
    /// Of a model with clocks.
    instant: PresentInstant,
}

impl Instance {
    /// The complete state of the instance.
    pub(crate) fn snapshot(&self) -> Result<Snapshot, ModelError> {
        self.check_saved()?;
        Ok(Snapshot {
            guid: *self.shared.guid,
            lifecycle: self.shared.lifecycle,
            clocks: self.shared.rate_clocks.clone(),
            starts: self.shared.starts.as_ref().map(|starts| starts.copy()),
            model: self.model.copy(),
            instant: match self.shared.clocks() {
                Some(clocks) => clocks.copy(&self.shared.instant),
                None => PresentInstant::default(),
            },
        })
    }

    fn check_saved(&self) -> Result<(), ModelError> {
        match self.model.info().why_unsaved {
            Some(why) => Err(ModelError::refuse(format_args!(
                "the model has {why} that cannot be saved: canGetAndSetFMUState is false"
            ))),
            None => Ok(()),
        }
    }

    fn check_serialized(&self) -> Result<(), ModelError> {
        self.check_saved()?;
        ensure!(
            !self.model.info().is_unserialized,
            "the model has fields that cannot be serialized: canSerializeFMUState is false"
        );
        Ok(())
    }

    /// Restores a snapshot of this or another instance of the model.
    pub(crate) fn restore(&mut self, snapshot: &Snapshot) -> Result<(), ModelError> {
        let shared = &mut self.shared;
        let (found, expected) = (snapshot.lifecycle.instance_type, shared.lifecycle.instance_type);
        ensure!(
            found == expected,
            "the state is from an instance for {}; expected one for {}",
            found.name(),
            expected.name()
        );
        ensure!(
            self.model.assign(snapshot.model.as_ref()),
            "the state belongs to the model {}, not to {}",
            readable(&snapshot.guid),
            readable(shared.guid)
        );
        shared.lifecycle = snapshot.lifecycle;
        shared.rate_clocks.clone_from(&snapshot.clocks);
        shared.starts = snapshot.starts.as_ref().map(|starts| starts.copy());
        if let Some(clocks) = shared.clocks() {
            clocks.assign(&mut shared.instant, &snapshot.instant);
        }
        Ok(())
    }

    /// Serializes a state: header, payload, and a checksum of both.
    pub(crate) fn serialize(&self, state: &Snapshot) -> Result<Vec<u8>, ModelError> {
        self.check_serialized()?;
        let mut payload = StateWriter::default();
        let format = self.model.info().state_format;
        let is_own = self.model.type_id() == (*state.model).type_id();
        let saved = state.lifecycle.save(&mut payload).is_ok()
            && state.clocks.save(&mut payload).is_ok()
            && payload.put(&state.starts.is_some()).is_ok()
            && state.model.save(&mut payload).is_ok()
            && state.starts.iter().all(|starts| starts.save(&mut payload).is_ok())
            && self
                .shared
                .clocks()
                .is_none_or(|clocks| clocks.save(&state.instant, &mut payload).is_ok());
        ensure!(is_own && saved, "the state belongs to another model");
        let mut bytes =
            [&MAGIC[..], &format.to_le_bytes(), &state.guid, &payload.into_bytes()].concat();
        bytes.extend_from_slice(&checksum(&bytes).to_le_bytes());
        Ok(bytes)
    }

    /// Deserializes a state of the model.
    pub(crate) fn deserialize(&self, bytes: &[u8]) -> Result<Snapshot, ModelError> {
        self.check_serialized()?;
        let damaged = || ModelError::refuse("the bytes are damaged or not a serialized FMU state");
        let end = bytes.len().checked_sub(CHECKSUM).ok_or_else(damaged)?;
        let (content, sum) = bytes.split_at(end);
        if sum != checksum(content).to_le_bytes() || content.len() < HEADER {
            return Err(damaged());
        }
        let (magic, rest) = content.split_at(MAGIC.len());
        let (format, rest) = rest.split_first_chunk().ok_or_else(damaged)?;
        let (guid, payload) = rest.split_at(size_of::<Guid>());
        if magic != MAGIC {
            return Err(damaged());
        }
        let (format, expected) = (u32::from_le_bytes(*format), self.shared.guid);
        let expected_format = self.model.info().state_format;
        ensure!(
            format == expected_format && guid == expected,
            "the bytes are a state of the model {}, format {format:08x}; expected {}, format {expected_format:08x}",
            readable(guid),
            readable(expected)
        );
        let mut loader = StateReader::new(payload);
        let lifecycle = Lifecycle::load(&mut loader).map_err(|_| damaged())?;
        let Lifecycle { instance_type, state, .. } = lifecycle;
        if !instance_type.has(state) || !self.shared.settings.edge.get_fmu_state.is_allowed(state) {
            return Err(damaged());
        }
        let rates = self.model.info().rates;
        let clocks = RateClocks::load(&mut loader, rates).map_err(|_| damaged())?;
        let has_starts: bool = loader.take().map_err(|_| damaged())?;
        let mut load = || {
            let mut model = self.model.copy();
            model.load(&mut loader).map(|()| model).map_err(|_| damaged())
        };
        let model = load()?;
        let starts = if has_starts { Some(load()?) } else { None };
        let instant = match self.shared.clocks() {
            Some(clocks) => clocks.load(&self.model, &mut loader).map_err(|_| damaged())?,
            None => PresentInstant::default(),
        };
        if !loader.is_empty() {
            return Err(damaged());
        }
        Ok(Snapshot { guid: *expected, lifecycle, clocks, starts, model, instant })
    }
}
