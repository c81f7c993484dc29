//! Warns a host that sets deprecated variables.

use fmu_description::{LogCategory, ScalarVariable};

use crate::log::Log;

/// Warns of a variable with this value reference, unless that has been done.
pub(crate) type Warn = fn(&Log, warned: &mut Vec<u32>, &ScalarVariable, u32);

/// As [`Warn`] says. Binaries without deprecated variables need not contain it.
pub(crate) fn warn(log: &Log, warned: &mut Vec<u32>, scalar: &ScalarVariable, reference: u32) {
    let first = reference - scalar.element as u32;
    if !warned.contains(&first) {
        warned.push(first);
        let (name, instead) = (scalar.name(), scalar.variable.deprecated());
        log.send(LogCategory::Warning, format_args!("{name} is deprecated: {instead}"));
    }
}
