//! The error state of a node (fault confinement of ISO 11898-1).

use crate::operation::*;

/// Error counters of a node, and its status, which follows from them.
///
/// | what the node gets | transmit errors | receive errors |
/// |---|---|---|
/// | `BusError` as sender | + 8 | |
/// | `BusError` with the primary error flag | | + 8 |
/// | `BusError` with the secondary error flag | | + 1 |
/// | `Confirm` | - 1 | |
/// | a frame | | - 1 |
///
/// A node is error passive if one of them is above 127, and bus off if it has more than 255 transmit errors. If nobody
/// acknowledges, the errors of an error passive sender stay as they are, so that a lonely node does not become bus off.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ErrorState {
    transmit_errors: u16,
    receive_errors: u16,
    status: Status,
}

impl ErrorState {
    /// The status, which is error active at first.
    pub const fn status(&self) -> Status {
        self.status
    }

    /// Count an operation that the node has received, and return the status if it has changed.
    ///
    /// A node that is bus off stays so.
    pub fn count(&mut self, operation: &Operation<'_>) -> Option<Status> {
        let lonely = self.status == Status::ErrorPassive;
        match *operation {
            _ if self.status == Status::BusOff => {}
            Operation::BusError { code: ErrorCode::Acknowledge, is_sender: true, .. } if lonely => {
            }
            Operation::BusError { is_sender: true, .. } => self.transmit_errors += 8,
            Operation::BusError { flag, .. } => {
                let errors = if flag == ErrorFlag::Primary { 8 } else { 1 };
                // One frame less than error passive is enough to recover.
                self.receive_errors = (self.receive_errors + errors).min(128);
            }
            Operation::Confirm { .. } => {
                self.transmit_errors = self.transmit_errors.saturating_sub(1);
            }
            Operation::Transmit(_) => self.receive_errors = self.receive_errors.saturating_sub(1),
            _ => {}
        }
        let status = match (self.transmit_errors, self.receive_errors) {
            (256.., _) => Status::BusOff,
            (128.., _) | (_, 128..) => Status::ErrorPassive,
            _ => Status::ErrorActive,
        };
        (status != core::mem::replace(&mut self.status, status)).then_some(status)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn error(is_sender: bool, flag: ErrorFlag) -> Operation<'static> {
        Operation::BusError { id: 1, code: ErrorCode::Crc, flag, is_sender }
    }

    fn count(state: &mut ErrorState, operation: Operation<'_>, times: usize) -> Vec<Status> {
        (0..times).filter_map(|_| state.count(&operation)).collect()
    }

    extern crate std;
    use std::vec::Vec;

    #[test]
    fn a_sender_becomes_passive_after_16_errors_and_bus_off_after_32() {
        let mut state = ErrorState::default();
        let failed = error(true, ErrorFlag::Secondary);
        assert_eq!(count(&mut state, failed, 15), []);
        assert_eq!(count(&mut state, failed, 1), [Status::ErrorPassive]);
        assert_eq!(count(&mut state, Operation::Confirm { id: 1 }, 1), [Status::ErrorActive]);
        assert_eq!(count(&mut state, failed, 17), [Status::ErrorPassive, Status::BusOff]);
        assert_eq!(count(&mut state, Operation::Confirm { id: 1 }, 300), []);
    }

    #[test]
    fn a_receiver_becomes_passive_and_recovers() {
        let mut state = ErrorState::default();
        assert_eq!(count(&mut state, error(false, ErrorFlag::Secondary), 127), []);
        let primary = error(false, ErrorFlag::Primary);
        assert_eq!(count(&mut state, primary, 300), [Status::ErrorPassive]);
        let frame = Operation::Transmit(Frame::can(Id::Standard(1), &[]));
        assert_eq!(count(&mut state, frame, 1), [Status::ErrorActive]);
    }

    #[test]
    fn a_lonely_sender_does_not_become_bus_off() {
        let mut state = ErrorState::default();
        let alone = Operation::BusError {
            id: 1,
            code: ErrorCode::Acknowledge,
            flag: ErrorFlag::Primary,
            is_sender: true,
        };
        assert_eq!(count(&mut state, alone, 1000), [Status::ErrorPassive]);
    }
}
