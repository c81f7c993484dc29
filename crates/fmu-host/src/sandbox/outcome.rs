//! What the host returns for calls that a component does not returned as the draft demands.

use std::ffi::c_int;

use fmi_abi::fmi3::fmi3Status;

use crate::outcome::Cause;

/// Returned besides the statuses of the standard.
pub(super) const TRAPPED: fmi3Status = fmi3Status(-1);
pub(super) const LENGTH: fmi3Status = fmi3Status(-2);
pub(super) const TYPE: fmi3Status = fmi3Status(-3);
pub(super) const ZERO_BYTE: fmi3Status = fmi3Status(-4);

/// What one of these statuses means.
pub(crate) fn cause(status: c_int) -> Option<Cause> {
    match fmi3Status(status) {
        TRAPPED => Some(Cause::Trapped),
        LENGTH => Some(Cause::Broke("returned another number of values than expected")),
        TYPE => Some(Cause::Broke("is missing from the component, or is not of its type")),
        ZERO_BYTE => Some(Cause::Broke("returned a string that contains a zero byte")),
        _ => None,
    }
}
