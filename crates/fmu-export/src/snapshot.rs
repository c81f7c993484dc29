//! The saved state of an instance (FMI 2.0.5, section 2.1.8) and its serialization.

use std::any::Any;

use fmu_description::guid::checksum;

use crate::lifecycle::{Lifecycle, Mode};
use crate::phase::Call;
use crate::reason::{Reason, reason};
use crate::slave::{Guid, Slave};

/// The first bytes of a state in memory and of a serialized state.
pub(crate) const MAGIC: [u8; 8] = *b"FMUSTATE";
/// Version of the serialization format; increase it when the format changes.
const VERSION: [u8; 4] = 5u32.to_le_bytes();
const CHECKSUM: usize = size_of::<u128>();
const HEADER: usize = MAGIC.len() + VERSION.len() + size_of::<Guid>();

/// The complete state of an instance.
#[repr(C)]
pub(crate) struct Snapshot {
    /// Distinguishes our states from other memory.
    magic: [u8; 8],
    guid: Guid,
    lifecycle: Lifecycle,
    model: Box<dyn Any>,
}

impl Snapshot {
    pub(crate) fn new(lifecycle: Lifecycle, slave: &dyn Slave) -> Self {
        Self {
            magic: MAGIC,
            guid: slave.guid(),
            lifecycle,
            model: slave.save(),
        }
    }

    /// What the instance was for.
    pub(crate) fn mode(&self) -> Mode {
        self.lifecycle.mode
    }

    /// Whether an instance can be in this state and save it, for which the same is allowed as for the call.
    pub(crate) fn can_be_saved(&self, call: &Call) -> bool {
        let Lifecycle { mode, phase, .. } = self.lifecycle;
        phase.is_of(mode) && call.is_allowed(phase)
    }

    /// Restores the state of a slave of the same model, and returns the lifecycle for its component.
    pub(crate) fn restore(&self, slave: &mut dyn Slave) -> Result<Lifecycle, Reason> {
        if slave.restore(self.model.as_ref()) {
            Ok(self.lifecycle)
        } else {
            let (found, expected) = (self.guid, slave.guid());
            Err(reason!(
                "the state belongs to the model {}, not to {}",
                text(&found),
                text(&expected)
            ))
        }
    }

    /// Serializes the state: header, payload, and a checksum of both.
    pub(crate) fn to_bytes(&self, slave: &dyn Slave) -> Result<Vec<u8>, Reason> {
        let payload = postcard::to_allocvec(&self.lifecycle)
            .ok()
            .zip(slave.serialize(self.model.as_ref()));
        let Some((lifecycle, model)) = payload else {
            return Err("the state belongs to another model".into());
        };
        let mut bytes = [&MAGIC[..], &VERSION, &self.guid, &lifecycle, &model].concat();
        bytes.extend_from_slice(&checksum(&bytes).to_le_bytes());
        Ok(bytes)
    }

    /// Deserializes a state of the slave's model.
    pub(crate) fn from_bytes(bytes: &[u8], slave: &dyn Slave) -> Result<Self, Reason> {
        let damaged = || Reason::from("the bytes are damaged or not a serialized FMU state");
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
        if version != VERSION || guid != slave.guid() {
            let (version, found, expected) = (version.to_owned(), guid.to_owned(), slave.guid());
            return Err(reason!(
                "the bytes are a state of the model {}, format {version:?}; expected {}, format {VERSION:?}",
                text(&found),
                text(&expected)
            ));
        }
        let (lifecycle, model): (Lifecycle, _) =
            postcard::take_from_bytes(payload).map_err(|_| damaged())?;
        if !lifecycle.can_be_saved() {
            return Err(damaged());
        }
        Ok(Self {
            magic: MAGIC,
            guid: slave.guid(),
            lifecycle,
            model: slave.deserialize(model).ok_or_else(damaged)?,
        })
    }
}

impl Drop for Snapshot {
    fn drop(&mut self) {
        // Helps to detect a pointer that the host uses after freeing it.
        self.magic = [0; 8];
        std::hint::black_box(&self.magic); // keeps the compiler from removing the write
    }
}

fn text(guid: &[u8]) -> String {
    String::from_utf8_lossy(guid).into_owned()
}
