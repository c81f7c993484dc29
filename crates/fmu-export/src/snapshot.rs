//! The saved state of an instance (FMI 2.0.5, section 2.1.8; FMI 3.0.2, section 2.2.10) and its serialization.

use std::any::Any;

use fmu_description::hash::checksum;
use fmu_description::interface::GUID_LENGTH;
use fmu_description::{Loader, Saver};

use crate::ModelError;
use crate::bound::AnyModel;
use crate::clock::SampleClock;
use crate::component::{Component, Integration, Shared};
use crate::lifecycle::Lifecycle;

/// A GUID as text.
pub(crate) type Guid = [u8; GUID_LENGTH];

/// The first bytes of a serialized state.
pub(crate) const MAGIC: [u8; 8] = *b"FMUSTATE";
/// Version of the serialization format; increase it when the format changes.
const VERSION: [u8; 4] = 5u32.to_le_bytes();
const CHECKSUM: usize = size_of::<u128>();
const HEADER: usize = MAGIC.len() + VERSION.len() + size_of::<Guid>();

/// The complete state of an instance.
pub(crate) struct Snapshot {
    guid: Guid,
    pub(crate) lifecycle: Lifecycle,
    clock: SampleClock,
    integration: Integration,
    model: Box<dyn Any>,
}

impl Snapshot {
    pub(crate) fn new(shared: &Shared, model: Box<dyn Any>) -> Self {
        Self {
            guid: *shared.guid,
            lifecycle: shared.lifecycle,
            clock: shared.clock,
            integration: shared.integration,
            model,
        }
    }

    /// Restores the state of an instance of the same model.
    pub(crate) fn restore(
        &self,
        shared: &mut Shared,
        model: &mut dyn AnyModel,
    ) -> Result<(), ModelError> {
        if !model.restore(self.model.as_ref()) {
            return Err(ModelError::refuse(format_args!(
                "the state belongs to the model {}, not to {}",
                text(&self.guid),
                text(shared.guid)
            )));
        }
        (shared.clock, shared.integration) = (self.clock, self.integration);
        shared.lifecycle = self.lifecycle;
        Ok(())
    }
}

impl Component {
    /// Serializes a state: header, payload, and a checksum of both.
    pub(crate) fn serialize(&self, state: &Snapshot) -> Result<Vec<u8>, ModelError> {
        let mut payload = Saver::default();
        let saved = payload.put(&state.lifecycle).ok();
        let saved = saved.and_then(|()| payload.put(&(state.clock, state.integration)).ok());
        let saved = saved.and_then(|()| self.model.serialize(state.model.as_ref(), &mut payload));
        if saved.is_none() {
            return Err(ModelError::refuse("the state belongs to another model"));
        }
        let mut bytes = [&MAGIC[..], &VERSION, &state.guid, &payload.into_bytes()].concat();
        bytes.extend_from_slice(&checksum(&bytes).to_le_bytes());
        Ok(bytes)
    }

    /// Deserializes a state of the model.
    pub(crate) fn deserialize(&self, bytes: &[u8]) -> Result<Snapshot, ModelError> {
        let damaged = || ModelError::refuse("the bytes are damaged or not a serialized FMU state");
        let end = bytes.len().checked_sub(CHECKSUM).ok_or_else(damaged)?;
        let (content, sum) = bytes.split_at(end);
        if sum != checksum(content).to_le_bytes() || content.len() < HEADER {
            return Err(damaged());
        }
        let (magic, rest) = content.split_at(MAGIC.len());
        let (version, rest) = rest.split_at(VERSION.len());
        let (guid, payload) = rest.split_at(size_of::<Guid>());
        if magic != MAGIC {
            return Err(damaged());
        }
        let expected = self.shared.guid;
        if version != VERSION || guid != expected {
            return Err(ModelError::refuse(format_args!(
                "the bytes are a state of the model {}, format {version:?}; expected {}, format {VERSION:?}",
                text(guid),
                text(expected)
            )));
        }
        let mut loader = Loader::new(payload);
        let lifecycle: Lifecycle = loader.take().map_err(|_| damaged())?;
        if !lifecycle.can_be_saved() {
            return Err(damaged());
        }
        let (clock, integration) = loader.take().map_err(|_| damaged())?;
        let model = self.model.deserialize(&mut loader);
        let model = model.filter(|_| loader.is_empty()).ok_or_else(damaged)?;
        if !self.shared.edge.get_fmu_state.is_allowed(lifecycle.state) {
            return Err(ModelError::refuse("the bytes are damaged"));
        }
        Ok(Snapshot {
            guid: *expected,
            lifecycle,
            clock,
            integration,
            model,
        })
    }
}

fn text(guid: &[u8]) -> String {
    String::from_utf8_lossy(guid).into_owned()
}
