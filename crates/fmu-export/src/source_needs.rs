//! What a model needs of the C sources that have no other model.

#[cfg(all(not(feature = "fmi2"), feature = "scheduled-execution"))]
use fmi_abi::fmi3::fmi3ClockUpdateCallback;
#[cfg(not(feature = "fmi2"))]
use fmi_abi::fmi3::fmi3IntermediateUpdateCallback;

use ode_methods::solver::Workspace;

use crate::fast::HostedInstance;
use crate::laid_out::LaidOut;
use crate::layout::ContinuousState;
#[cfg(not(feature = "fmi2"))]
use crate::lifecycle::InstanceType;
use crate::model::Model;
#[cfg(not(feature = "fmi2"))]
use crate::source_host::call_back;
#[cfg(all(not(feature = "fmi2"), feature = "scheduled-execution"))]
use crate::source_host::update_clocks;

/// What a model needs of the module that has no other model.
#[derive(Clone, Copy)]
pub(crate) struct Needs {
    /// The name of the model, also if the entry is of a variant.
    name: &'static str,
    /// Whether the exporter asks for this model.
    pub(crate) is_asked_for: bool,
    /// Bytes that an instance allocates.
    pub(crate) heap: usize,
    /// Bytes of references and values of all variables in one call.
    pub(crate) arguments: usize,
    /// The callback of models that have intermediate updates. Only their modules import it.
    #[cfg(not(feature = "fmi2"))]
    pub(crate) intermediate_update: Option<fmi3IntermediateUpdateCallback>,
    /// The callback of models whose clocks tick or get intervals in an activation.
    #[cfg(all(not(feature = "fmi2"), feature = "scheduled-execution"))]
    pub(crate) clock_update: Option<fmi3ClockUpdateCallback>,
}

impl Needs {
    pub(crate) const fn of<M: Model, const N: usize>() -> Self {
        /// Messages, texts, other arguments, and what the allocator adds.
        const SMALL: usize = 8 << 10;
        /// The instance, its start values, the state before a step, and two states that the host saves.
        const COPIES: usize = 5;
        /// What the interface in C uses for short calls without asking for it.
        const AT_HAND: usize = 128;
        /// The vectors of a solver.
        const VECTORS: usize = 16;
        let info = &LaidOut::<M, N>::INFO;
        let solved = info.states.len() + info.event_indicators.len();
        let implicit = match M::IS_IMPLICIT {
            true => Workspace::implicit_size(scalars_in(info.states)),
            false => 0,
        };
        let arguments = AT_HAND + info.end as usize * (size_of::<u32>() + size_of::<f64>());
        Self {
            name: M::NAME,
            is_asked_for: false,
            arguments,
            heap: SMALL
                + arguments
                + COPIES * size_of::<HostedInstance<LaidOut<M, N>>>()
                + VECTORS * solved * size_of::<f64>()
                + implicit,
            #[cfg(not(feature = "fmi2"))]
            intermediate_update: match InstanceType::HAS_CO_SIMULATION && M::IS_CONTINUOUS {
                true => Some(call_back),
                false => None,
            },
            #[cfg(all(not(feature = "fmi2"), feature = "scheduled-execution"))]
            clock_update: match M::IS_CLOCKED {
                true => Some(update_clocks),
                false => None,
            },
        }
    }

    /// Takes note of the model that the exporter asks for by its name.
    pub(crate) const fn ask_for(&mut self, model: Option<&str>) {
        if let Some(model) = model {
            self.is_asked_for = is_same(self.name.as_bytes(), model.as_bytes());
        }
    }
}

/// The number of continuous states.
const fn scalars_in(states: &[ContinuousState]) -> usize {
    match states {
        [] => 0,
        [first, rest @ ..] => first.count + scalars_in(rest),
    }
}

const fn is_same(a: &[u8], b: &[u8]) -> bool {
    match (a, b) {
        ([], []) => true,
        ([a, rest @ ..], [b, others @ ..]) => *a == *b && is_same(rest, others),
        _ => false,
    }
}
