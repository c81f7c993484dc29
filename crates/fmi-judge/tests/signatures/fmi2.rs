//! The 44 functions of FMI 2.0.

use std::mem::{align_of, offset_of, size_of};

use fmi::fmi2::binding as headers;
use fmi_abi::fmi2 as ours;
use ours::*;

use crate::{Like, proofs};

impl Like<headers::fmi2Status> for fmi2Status {}
impl Like<*mut headers::fmi2Status> for *mut fmi2Status {}
impl Like<*const headers::fmi2CallbackFunctions> for *const ours::fmi2CallbackFunctions {}
impl Like<*mut headers::fmi2EventInfo> for *mut ours::fmi2EventInfo {}

fmi_abi::fmi2_functions!(proofs! Functions headers);

/// The logger has a variable number of arguments.
const fn alike_loggers(
    _: unsafe extern "C" fn(
        ours::fmi2ComponentEnvironment,
        ours::fmi2String,
        ours::fmi2Status,
        ours::fmi2String,
        ours::fmi2String,
        ...
    ),
    _: Option<
        unsafe extern "C" fn(
            ours::fmi2ComponentEnvironment,
            ours::fmi2String,
            headers::fmi2Status,
            ours::fmi2String,
            ours::fmi2String,
            ...
        ),
    >,
) {
}

const _: fn(ours::fmi2CallbackLogger, headers::fmi2CallbackLogger) = |mine, official| {
    alike_loggers(mine, official);
};

macro_rules! same_layout {
    ($structure:ident: $($field:ident),*) => {
        const _: () = {
            type Mine = ours::$structure;
            type Official = headers::$structure;
            assert!(size_of::<Mine>() == size_of::<Official>());
            assert!(align_of::<Mine>() == align_of::<Official>());
            $(assert!(offset_of!(Mine, $field) == offset_of!(Official, $field));)*
        };
    };
}

same_layout!(fmi2CallbackFunctions:
    logger, allocateMemory, freeMemory, stepFinished, componentEnvironment);
same_layout!(fmi2EventInfo:
    newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged,
    valuesOfContinuousStatesChanged, nextEventTimeDefined, nextEventTime);

const _: () = {
    assert!(size_of::<ours::fmi2Status>() == size_of::<headers::fmi2Status>());
    assert!(fmi2OK.0 as u32 == headers::fmi2Status_fmi2OK);
    assert!(fmi2Warning.0 as u32 == headers::fmi2Status_fmi2Warning);
    assert!(fmi2Discard.0 as u32 == headers::fmi2Status_fmi2Discard);
    assert!(fmi2Error.0 as u32 == headers::fmi2Status_fmi2Error);
    assert!(fmi2Fatal.0 as u32 == headers::fmi2Status_fmi2Fatal);
    assert!(fmi2Pending.0 as u32 == headers::fmi2Status_fmi2Pending);
    assert!(ours::fmi2CoSimulation as u32 == headers::fmi2Type_fmi2CoSimulation);
    assert!(ours::fmi2LastSuccessfulTime as u32 == headers::fmi2StatusKind_fmi2LastSuccessfulTime);
    assert!(ours::fmi2Terminated as u32 == headers::fmi2StatusKind_fmi2Terminated);
    assert!(ours::fmi2False as u32 == headers::fmi2False);
};
