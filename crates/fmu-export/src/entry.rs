//! The models of a library, from which a host selects one by its GUID.

use std::ffi::CStr;

use fmi_abi::FmiVersion;
use fmu_description::checks::{check, fail};
use fmu_description::hash::checksum;
use fmu_description::interface::guid_of_copy;
use fmu_description::table::have_clocks;
use fmu_description::{Interface, Naming, StartOverrides};

use crate::any_model::VariantStarts;
use crate::clock_functions::ClockFunctions;
#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
use crate::edge::clocks::CLOCK_FUNCTIONS;
use crate::fast;
use crate::instance::{Clocks, Guid, HAS_CLOCKS, Identity, Settings};
use crate::laid_out::LaidOut;
use crate::lifecycle::{InstanceType, NOT_SCHEDULED};
use crate::model::Model;
use crate::model_clocks;
#[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
use crate::needs::Needs;
use crate::pointers::{Pointer, readable};
use crate::sample_clocks::SampleClocks;
#[cfg(all(target_arch = "wasm32", feature = "sources"))]
use crate::source_needs::Needs;

/// A model of a library, before it is instantiated.
#[derive(Clone, Copy)]
pub struct Entry {
    name: &'static str,
    variant: Option<VariantStarts>,
    guid: Guid,
    naming: Naming,
    /// Its clocks, if it has some.
    clocks: Option<&'static dyn Clocks>,
    /// The C functions of clocks, if it has some.
    clock_functions: Option<&'static ClockFunctions>,
    /// Whether the clocks are those of model partitions.
    has_partitions: bool,
    /// Whether the host activates its samples, so that it has scheduled execution only.
    has_sample_clocks: bool,
    /// Whether it has events: samples, ticks of clocks, or those of its equations. Hosts can then solve it in model exchange.
    has_events: bool,
    create: fn(Settings, Identity) -> Option<Pointer>,
    #[cfg(target_arch = "wasm32")]
    pub(crate) needs: Needs,
    /// The copy of the interface for the exporter, which must not be removed by the linker.
    _embedded: &'static [u8],
}

/// The interface of the model `M` with tables of size `N`, its [`table_size`](crate::table_size), or of a variant of it; see
/// [`StartOverrides::parse`]. An invalid table fails the compilation here.
pub const fn interface<M: Model, const N: usize>(variant: Option<&'static str>) -> Interface {
    let listed = LaidOut::<M, N>::LISTED;
    let scalars = listed.all();
    check(scalars, M::IS_INTEGRATED);
    let variant = match variant {
        Some(text) => StartOverrides::parse(M::NAME, text),
        None => None,
    };
    let (name, overrides) = match variant {
        Some((name, overrides)) => (name, overrides),
        None => (M::NAME, StartOverrides::NONE),
    };
    Interface {
        name,
        description: M::DESCRIPTION,
        is_sampled: M::IS_SAMPLED,
        is_continuous: M::IS_CONTINUOUS,
        is_clocked: M::IS_CLOCKED,
        is_bus_simulation: M::IS_BUS_SIMULATION,
        has_log: M::HAS_LOG,
        log_categories: M::LOG_CATEGORIES,
        is_unsaved: M::IS_UNSAVED || M::IS_SINGLE_INSTANCE,
        is_single_instance: M::IS_SINGLE_INSTANCE,
        is_unserialized: M::IS_UNSERIALIZED || M::IS_SINGLE_INSTANCE,
        naming: Naming::chosen(None, M::NAMING),
        revision: "",
        default_experiment: M::DEFAULT_EXPERIMENT,
        tolerance: M::TOLERANCE,
        sample_clocks: match InstanceType::HAS_ONLY_SCHEDULED_EXECUTION {
            true => sample_clocks::<M>(),
            false => &[],
        },
        scalars,
        time: listed.references.time,
        overrides,
    }
}

/// The names of the clocks of a model with sample times: of its rates, or of its only sample time.
const fn sample_clocks<M: Model>() -> &'static [&'static str] {
    match (M::IS_SAMPLED, M::RATES) {
        (true, []) => &["sample"],
        (_, rates) => rates,
    }
}

/// The entries of a library with `N` models.
#[cfg(not(all(target_arch = "wasm32", feature = "sources")))]
type Exported<const N: usize> = [Entry; N];
/// The entry of the only model that C sources have, the first one unless the exporter asks for another.
#[cfg(all(target_arch = "wasm32", feature = "sources"))]
type Exported<const N: usize> = [Entry; 1];

impl Entry {
    /// The entry of the model `M` with tables of size `N`.
    ///
    /// An array of this length can be declared only where `M` is known, which is where
    /// [`export!`](crate::export) is used.
    pub const fn new<M: Model, const N: usize>(
        interface: Interface,
        embedded: &'static [u8],
    ) -> Self {
        Self {
            name: interface.name,
            variant: VariantStarts::new(interface.overrides),
            guid: guid_of_copy(embedded, &interface),
            naming: interface.naming,
            has_events: M::IS_SAMPLED || M::IS_CONTINUOUS || M::IS_CLOCKED,
            clocks: match interface.sample_clocks {
                [] => model_clocks::of::<M>(),
                _ => Some(&SampleClocks),
            },
            clock_functions: match interface.sample_clocks.is_empty() && !have_clocks(M::ROWS) {
                true => None,
                #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
                false => Some(&CLOCK_FUNCTIONS),
                #[cfg(not(any(feature = "fmi3", not(feature = "fmi2"))))]
                false => None,
            },
            has_partitions: M::IS_CLOCKED || !interface.sample_clocks.is_empty(),
            has_sample_clocks: !interface.sample_clocks.is_empty(),
            create: match interface.sample_clocks.is_empty() && !M::IS_CLOCKED {
                true => fast::create::<M, N>,
                false => fast::create_preemptible::<M, N>,
            },
            #[cfg(target_arch = "wasm32")]
            needs: Needs::of::<M, N>(),
            _embedded: embedded,
        }
    }

    /// The entry, if the exporter asks for one model by its name: only C sources have less than all.
    #[cfg_attr(
        not(all(target_arch = "wasm32", feature = "sources")),
        expect(unused_mut, reason = "for C sources")
    )]
    pub const fn asked_for(mut self, model: Option<&str>) -> Self {
        #[cfg(all(target_arch = "wasm32", feature = "sources"))]
        self.needs.ask_for(model);
        let _ = model;
        self
    }

    /// All entries of a library. Two models with one name fail the compilation; it is empty if the derive failed.
    #[track_caller]
    pub const fn all<const N: usize>(entries: [Self; N]) -> Exported<N> {
        let mut pair = 0;
        while pair < N * N {
            let (one, other) = (entries[pair / N].name, entries[pair % N].name);
            let is_same = checksum(one.as_bytes()) == checksum(other.as_bytes());
            let is_other = pair / N != pair % N && !one.is_empty();
            if is_same && is_other {
                fail("two models have the name ", one);
            }
            pair += 1;
        }
        #[cfg(all(target_arch = "wasm32", feature = "sources"))]
        let entries = {
            let mut index = N - 1;
            while index > 0 && !entries[index].needs.is_asked_for {
                index -= 1;
            }
            [entries[index]]
        };
        entries
    }

    /// Name of the model.
    pub fn name(&self) -> &str {
        self.name
    }

    /// The GUID of the model's interface.
    pub fn guid(&self) -> &str {
        std::str::from_utf8(&self.guid).unwrap_or_default()
    }

    /// Whether the model has clocks in a version of FMI.
    fn has_clocks(&self, version: FmiVersion) -> bool {
        HAS_CLOCKS && version == FmiVersion::Fmi3 && self.clocks.is_some()
    }

    /// Whether one of the models has model partitions.
    #[doc(hidden)]
    pub const fn have_partitions(mut models: &[Self]) -> bool {
        while let [model, rest @ ..] = models {
            if model.has_partitions {
                return true;
            }
            models = rest;
        }
        false
    }

    /// Creates an instance, to be freed with [`fast::free`].
    ///
    /// # Errors
    /// The process has an instance, and can have one only.
    pub(crate) fn create(&'static self, settings: Settings) -> Result<Pointer, String> {
        let Self { guid, variant, naming, clocks, clock_functions, .. } = self;
        let identity = Identity {
            guid,
            variant: *variant,
            naming: *naming,
            clocks: *clocks,
            clock_functions: *clock_functions,
        };
        let created = (self.create)(settings, identity);
        created.ok_or_else(|| {
            format!(
                "this process has an instance of {} already, and can have one only: \
                 canBeInstantiatedOnlyOncePerProcess is true; free it first, or use another process",
                self.name
            )
        })
    }

    /// Finds the model that a host instantiates.
    ///
    /// # Errors
    /// The arguments of the host are invalid, or the model has no instances of this type.
    pub(crate) fn choose(
        models: &'static [Self],
        name: Option<&CStr>,
        instance_type: InstanceType,
        guid: Option<&CStr>,
        version: FmiVersion,
    ) -> Result<&'static Self, String> {
        if name.is_none_or(CStr::is_empty) {
            return Err("the instance name is missing".into());
        }
        if name.is_some_and(|name| name.to_str().is_err()) {
            return Err("the instance name is not UTF-8".into());
        }
        let what = match version {
            FmiVersion::Fmi2 => "GUID",
            FmiVersion::Fmi3 => "instantiation token",
        };
        let guid = guid.ok_or_else(|| format!("the {what} is missing"))?.to_bytes();
        let model = models.iter().find(|m| m.guid == guid).ok_or_else(|| {
            let known: Vec<String> =
                models.iter().map(|m| format!("{} {}", m.name(), m.guid())).collect();
            format!(
                "the {what} {} belongs to another FMU or version; this binary has: {}",
                readable(guid),
                known.join(", ")
            )
        })?;
        let (is_for, is_not_for) = match instance_type {
            InstanceType::ScheduledExecution
                if !model.has_partitions || !InstanceType::HAS_SCHEDULED_EXECUTION =>
            {
                return Err(NOT_SCHEDULED.into());
            }
            InstanceType::CoSimulation
            | InstanceType::CoSimulationWithEvents
            | InstanceType::ModelExchange
                if InstanceType::HAS_ONLY_SCHEDULED_EXECUTION
                    || InstanceType::HAS_SCHEDULED_EXECUTION && model.has_sample_clocks =>
            {
                ("scheduled execution", instance_type.name())
            }
            InstanceType::ModelExchange
                if !model.has_events || !InstanceType::HAS_MODEL_EXCHANGE =>
            {
                ("co-simulation", "model exchange")
            }
            InstanceType::CoSimulation | InstanceType::CoSimulationWithEvents
                if !InstanceType::HAS_CO_SIMULATION =>
            {
                ("model exchange", "co-simulation")
            }
            InstanceType::CoSimulation if model.has_clocks(version) => {
                return Err(format!(
                    "eventModeUsed is false, but {} has clocks, which tick in event mode; expected a host with event mode",
                    model.name()
                ));
            }
            InstanceType::CoSimulationWithEvents if !model.has_events => {
                return Err(format!(
                    "eventModeUsed is true, but {} has no event mode: hasEventMode is false",
                    model.name()
                ));
            }
            _ => return Ok(model),
        };
        Err(format!("{} is for {is_for}, not for {is_not_for}", model.name()))
    }
}
