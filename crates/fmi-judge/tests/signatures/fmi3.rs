//! The 75 functions of FMI 3.0.

use std::ffi::c_uint;

use fmi::fmi3::binding as headers;
use fmi_abi::fmi3 as ours;
use ours::*;

use crate::{Like, alike, proofs};

impl Like<c_uint> for ours::fmi3Status {}
// A `bool`, which is declared here as an integer to accept any value.
impl Like<bool> for ours::fmi3Boolean {}
impl Like<*mut bool> for *mut ours::fmi3Boolean {}
impl Like<*const bool> for *const ours::fmi3Boolean {}
// The callbacks are compared below.
impl Like<headers::fmi3LogMessageCallback> for Option<ours::fmi3LogMessageCallback> {}
impl Like<headers::fmi3IntermediateUpdateCallback>
    for Option<ours::fmi3IntermediateUpdateCallback>
{
}

fmi_abi::fmi3_functions!(proofs! Functions headers);

const _: fn(
    ours::fmi3LogMessageCallback,
    ours::fmi3IntermediateUpdateCallback,
    ours::fmi3ClockUpdateCallback,
    ours::fmi3PreemptionCallback,
) = |log, update, clock, preemption| {
    alike(Some(log), None as headers::fmi3LogMessageCallback);
    alike(Some(update), None as headers::fmi3IntermediateUpdateCallback);
    alike(Some(clock), None as headers::fmi3ClockUpdateCallback);
    alike(Some(preemption), None as headers::fmi3LockPreemptionCallback);
    alike(Some(preemption), None as headers::fmi3UnlockPreemptionCallback);
};

const _: () = {
    assert!(size_of::<ours::fmi3Status>() == size_of::<headers::fmi3Status>());
    assert!(size_of::<ours::fmi3Boolean>() == size_of::<headers::fmi3Boolean>());
    assert!(fmi3OK.0 as u32 == headers::fmi3Status_fmi3OK);
    assert!(fmi3Warning.0 as u32 == headers::fmi3Status_fmi3Warning);
    assert!(fmi3Discard.0 as u32 == headers::fmi3Status_fmi3Discard);
    assert!(fmi3Error.0 as u32 == headers::fmi3Status_fmi3Error);
    assert!(fmi3Fatal.0 as u32 == headers::fmi3Status_fmi3Fatal);
    assert!(ours::fmi3Independent as u32 == headers::fmi3DependencyKind_fmi3Independent);
    assert!(ours::fmi3Constant as u32 == headers::fmi3DependencyKind_fmi3Constant);
    assert!(ours::fmi3Fixed as u32 == headers::fmi3DependencyKind_fmi3Fixed);
    assert!(ours::fmi3Tunable as u32 == headers::fmi3DependencyKind_fmi3Tunable);
    assert!(ours::fmi3Discrete as u32 == headers::fmi3DependencyKind_fmi3Discrete);
    assert!(ours::fmi3Dependent as u32 == headers::fmi3DependencyKind_fmi3Dependent);
};
