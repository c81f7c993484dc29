//! A model with the tables of its variables, which the compiler computes.

use std::any::Any;

use fmu_description::derive::Timing;
use fmu_description::table::Declaration;
use fmu_description::{
    Causality, Naming, StateError, StateReader, StateWriter, references, scalar,
};
use ode_methods::solver::{self, Advanced, DormandPrince, Rodas5p, Step, Workspace};

use crate::any_model::{AnyModel, SolverVector, VariantStarts};
use crate::deprecated;
use crate::equations::ModelEquations;
use crate::error::ModelError;
use crate::large;
use crate::layout::{self, Extent, Float64Place, ModelInfo, Tables, VariableList, copy_fields};
use crate::lifecycle::InstanceType;
use crate::model::{Behavior, Model};
use crate::snapshot;

/// The number of value references up to which a model has tables of places by value reference. A larger model finds
/// places by its rows, which is slower, but takes neither time of the compiler nor space in the binary.
const MAX_PLACES: usize = 10_000;

/// Whether a model has no tables of places.
const fn is_large<M: Model>() -> bool {
    references::bound(M::COUNT, M::REFERENCES) > MAX_PLACES
}

/// The size of the tables of a model: the number of its value references, or of the variables of a large one.
pub const fn table_size<M: Model>() -> usize {
    match is_large::<M>() {
        true => scalar::variable_count(M::ROWS),
        false => references::bound(M::COUNT, M::REFERENCES),
    }
}

/// A model with tables of size `N`, its [`table_size`].
pub(crate) struct LaidOut<M, const N: usize> {
    pub(crate) model: M,
    /// Whether a variant uses fewer elements of an array than the table.
    pub(crate) has_fewer_elements: bool,
    /// How the names of variables are written.
    naming: Naming,
}

impl<M: Model, const N: usize> LaidOut<M, N> {
    /// The variables, for constants only: the binary does not need them.
    pub(crate) const LISTED: &'static VariableList<N> = &VariableList::new(M::ROWS, M::REFERENCES);
    const TABLES: Tables<N> = Tables::new(Self::LISTED.all(), !Self::IS_LARGE);
    pub(crate) const INFO: ModelInfo = ModelInfo {
        rows: M::ROWS,
        count: M::COUNT as u32,
        numbers: const { &const { Self::TABLES.numbers } }.as_slice(),
        end: Self::LISTED.references.end as u32,
        time: Self::LISTED.references.time as u32,
        states: const { &const { Self::TABLES.states } }.as_slice(),
        event_indicators: const { &const { Self::TABLES.event_indicators } }.as_slice(),
        is_sampled: M::IS_SAMPLED,
        rates: M::RATES.len(),
        is_continuous: M::IS_CONTINUOUS,
        is_integrated: M::IS_INTEGRATED,
        step: M::DEFAULT_EXPERIMENT.1,
        tolerance: M::TOLERANCE,
        has_directional_derivatives: M::IS_CONTINUOUS
            && Self::TABLES.has_unknowns
            && !Self::TABLES.lacks_derivatives,
        has_structural_parameters: Self::TABLES.has_structural_parameters,
        has_tunable_structural_parameters: Self::TABLES.has_tunable_structural_parameters,
        has_log: M::HAS_LOG,
        log_categories: M::LOG_CATEGORIES,
        why_unsaved: match (M::IS_SINGLE_INSTANCE, M::IS_UNSAVED) {
            (true, _) => Some("state outside its fields (single_instance)"),
            (_, true) => Some("fields"),
            _ => None,
        },
        is_unserialized: M::IS_UNSERIALIZED,
        warn_of_deprecated: if Self::TABLES.has_deprecated { Some(deprecated::warn) } else { None },
        state_format: snapshot::format(M::STATE_LAYOUT),
    };
    pub(crate) const HAS_INPUT_DERIVATIVES: bool = Self::TABLES.has_input_derivatives;
    pub(crate) const HAS_STRUCTURAL_PARAMETERS: bool = Self::TABLES.has_structural_parameters;
    /// Whether the tables of places are empty.
    pub(crate) const IS_LARGE: bool = is_large::<M>();
    pub(crate) const ELEMENTS: &'static [Float64Place; N] = &const { Self::TABLES.elements };
    pub(crate) const SCALARS: &'static [Float64Place; N] = &const { Self::TABLES.scalars };
    pub(crate) const VARIABLES: &'static [Float64Place; N] = &const { Self::TABLES.variables };
    pub(crate) const ARRAYS: &'static [Extent; N] = &const { Self::TABLES.arrays };

    pub(crate) fn with_model(model: M, naming: Naming) -> Self {
        Self { model, has_fewer_elements: false, naming }
    }

    pub(crate) fn new(variant: Option<VariantStarts>, naming: Naming) -> Self {
        let mut new = Self::with_model(M::new(), naming);
        new.has_fewer_elements = variant.is_some_and(|variant| variant.set(&mut new));
        new
    }
}

impl<M: Model, const N: usize> AnyModel for LaidOut<M, N> {
    fn info(&self) -> &'static ModelInfo {
        &const { Self::INFO }
    }

    fn naming(&self) -> Naming {
        self.naming
    }

    #[inline(always)]
    fn memory(&mut self) -> *mut u8 {
        (&raw mut self.model).cast()
    }

    fn extent(&self, reference: u32) -> Option<Extent> {
        match Self::IS_LARGE {
            true => large::extent(self, reference),
            false => Self::ARRAYS.get(reference as usize).copied().filter(|array| array.count > 0),
        }
    }

    fn reset(&mut self, variant: Option<VariantStarts>) {
        *self = Self::new(variant, self.naming);
    }

    fn renew(&mut self) {
        use Causality::{Input, Parameter, StructuralParameter};
        let mut fresh = M::new();
        let to = (&raw mut fresh).cast();
        let is_settable = |field: &Declaration| {
            matches!(field.causality, Input | Parameter | StructuralParameter)
        };
        // SAFETY: both are models with these rows.
        unsafe { copy_fields(to, self.memory(), M::ROWS, is_settable) };
        if Self::HAS_INPUT_DERIVATIVES {
            for number in 0..M::COUNT {
                if let Some(derivative) = fresh.input_derivative(number) {
                    let set = self.model.input_derivative(number);
                    *derivative = set.map_or(0.0, |value| *value);
                }
            }
        }
        let mut index = 0;
        while let (Some(log), Some(own)) = (fresh.log(index), self.model.log(index)) {
            std::mem::swap(log.0, own.0);
            index += 1;
        }
        self.model = fresh;
    }

    fn input_derivative(&mut self, number: u32) -> Option<&mut f64> {
        self.model.input_derivative(number as usize)
    }

    fn derivative(&self, unknown: u32, known: u32) -> f64 {
        let model = &self.model;
        model.directional_derivative(unknown as usize, known as usize)
    }

    fn clock_timing(&self, number: u32) -> Option<Timing> {
        self.model.clock_timing(number as usize)
    }

    fn check_outputs(&mut self) -> Result<(), ModelError> {
        match self.model.has_finite_outputs() {
            true => Ok(()),
            false => (self as &mut dyn AnyModel).find_not_finite(),
        }
    }

    fn hash_of_switches(&mut self) -> u128 {
        match M::IS_INTEGRATED && Self::TABLES.has_switches {
            // SAFETY: the rows belong to the model.
            true => unsafe { layout::hash_of_switches(self.memory(), M::ROWS) },
            false => 0,
        }
    }

    fn workspace(&self) -> Workspace {
        let length = |vector| (self as &dyn AnyModel).vector_length(vector);
        let counts = (length(SolverVector::States), length(SolverVector::EventIndicators));
        match M::IS_IMPLICIT {
            true => Workspace::implicit(counts.0, counts.1, None),
            false => Workspace::new(counts.0, counts.1),
        }
    }

    fn integrate(&mut self, with: &mut Workspace, step: &Step) -> Result<Advanced, ModelError> {
        // The solver takes the steps of models without steps of their own. In event mode, which FMI 3.0 has, it takes the
        // steps of all models with equations. Other libraries do not contain the solver.
        const HAS_EVENT_MODE: bool = cfg!(any(feature = "fmi3", not(feature = "fmi2")));
        const HAS_STEPS: bool = InstanceType::HAS_CO_SIMULATION;
        match HAS_STEPS && (M::IS_INTEGRATED || M::IS_CONTINUOUS && HAS_EVENT_MODE) {
            true if M::IS_IMPLICIT => {
                solver::advance::<Rodas5p, _>(&mut ModelEquations::<true>(self), with, step)
            }
            true => {
                solver::advance::<DormandPrince, _>(&mut ModelEquations::<false>(self), with, step)
            }
            false => Err(ModelError::refuse("the model has no equations")),
        }
    }

    fn behavior(&self) -> &dyn Behavior {
        &self.model
    }

    fn behavior_mut(&mut self) -> &mut dyn Behavior {
        &mut self.model
    }

    fn copy(&self) -> Box<dyn AnyModel> {
        Box::new(Self { model: self.model.copy(), ..*self })
    }

    fn assign(&mut self, from: &dyn AnyModel) -> bool {
        let from = (from as &dyn Any).downcast_ref::<Self>();
        from.map(|from| self.model.copy_from(&from.model)).is_some()
    }

    fn save(&self, to: &mut StateWriter) -> Result<(), StateError> {
        self.model.save(to)
    }

    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.model.load(from)
    }
}
