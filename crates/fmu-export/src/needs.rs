//! The functions of a host that only some models need.

use crate::instance::IntermediateUpdate;
use crate::lifecycle::InstanceType;
use crate::model::Model;
use crate::pointers::Pointer;

#[link(wasm_import_module = "fmi:fmi3/intermediate-update-callbacks@3.0.0")]
unsafe extern "C" {
    #[link_name = "intermediate-update"]
    fn intermediate_update(
        time: f64,
        set_requested: bool,
        get_allowed: bool,
        step_finished: bool,
        can_return_early: bool,
        requested: *mut EarlyReturn,
    );
}

#[link(wasm_import_module = "[export]fmi:fmi3/co-simulation@3.0.0")]
unsafe extern "C" {
    #[link_name = "[resource-new]co-simulation-instance"]
    pub(crate) safe fn new_co_simulation(instance: Pointer) -> u32;
}

#[cfg(feature = "scheduled-execution")]
#[link(wasm_import_module = "[export]fmi:fmi3/scheduled-execution@3.0.0")]
unsafe extern "C" {
    #[link_name = "[resource-new]scheduled-execution-instance"]
    pub(crate) safe fn new_scheduled_execution(instance: Pointer) -> u32;
}

#[cfg(feature = "scheduled-execution")]
#[link(wasm_import_module = "fmi:fmi3/callbacks@3.0.0")]
unsafe extern "C" {
    #[link_name = "clock-update"]
    safe fn clock_update();
}

#[link(wasm_import_module = "[export]fmi:fmi3/model-exchange@3.0.0")]
unsafe extern "C" {
    #[link_name = "[resource-new]model-exchange-instance"]
    safe fn new_model_exchange(instance: Pointer) -> u32;
}

/// The functions of the host that a model needs. A component imports only functions that one of its models needs,
/// since the linker drops the rest.
#[derive(Clone, Copy)]
pub(crate) struct Needs {
    pub(crate) new_model_exchange: Option<extern "C" fn(Pointer) -> u32>,
    pub(crate) intermediate_update: Option<fn(IntermediateUpdate) -> Option<f64>>,
    /// Of a model whose clocks tick or get intervals in an activation.
    #[cfg(feature = "scheduled-execution")]
    pub(crate) clock_update: Option<fn()>,
}

impl Needs {
    pub(crate) const fn of<M: Model, const N: usize>() -> Self {
        extern "C" fn new(instance: Pointer) -> u32 {
            new_model_exchange(instance)
        }
        Self {
            new_model_exchange: match InstanceType::HAS_MODEL_EXCHANGE
                && (M::IS_SAMPLED || M::IS_CONTINUOUS)
            {
                true => Some(new),
                false => None,
            },
            intermediate_update: match InstanceType::HAS_CO_SIMULATION && M::IS_CONTINUOUS {
                true => Some(call_back),
                false => None,
            },
            #[cfg(feature = "scheduled-execution")]
            clock_update: match M::IS_CLOCKED {
                true => Some(|| clock_update()),
                false => None,
            },
        }
    }
}

/// What a host answers in an intermediate update.
#[repr(C)]
struct EarlyReturn {
    is_requested: bool,
    time: f64,
}

/// Calls the host in an intermediate update. Returns the time of an early return that it requests.
fn call_back(update: IntermediateUpdate) -> Option<f64> {
    let mut answer = EarlyReturn { is_requested: false, time: update.time };
    let IntermediateUpdate { time, set_requested, can_return_early } = update;
    // SAFETY: the host provides this function with these arguments; the pointer is valid during the call.
    unsafe { intermediate_update(time, set_requested, true, true, can_return_early, &mut answer) };
    answer.is_requested.then_some(answer.time)
}
