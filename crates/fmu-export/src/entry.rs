//! The models of a library, from which a host selects one by its GUID.

use std::ffi::{CStr, c_void};

use fmu_description::guid::guid;
use fmu_description::table::check;
use fmu_description::{Interface, Overrides};

use crate::Model;
use crate::bound::Bound;
use crate::component::Component;
#[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
use crate::fmi2;
#[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
use crate::fmi3;
use crate::lifecycle::Mode;
use crate::log::Log;
use crate::resources::Folder;
use crate::slave::Guid;

/// A model of a library, before it is instantiated.
pub struct Entry {
    name: &'static str,
    /// Start values of a variant.
    overrides: Overrides,
    pub(crate) guid: Guid,
    /// Whether the host may integrate the model, which therefore has events.
    is_for_model_exchange: bool,
    #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
    create_fmi2: fn(&'static Self, Mode, Log, Folder) -> *mut c_void,
    #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
    create_fmi3: fn(&'static Self, Mode, fmi3::Options, Log, Folder) -> *mut c_void,
    /// The copy of the interface for the exporter, which must not be removed by the linker.
    _embedded: &'static [u8],
}

/// The interface of the model `M` with `N` scalar variables, or of a variant of it; see
/// [`Overrides::of`]. An invalid table fails the compilation here.
pub const fn interface<M: Model, const N: usize>(variant: Option<&'static str>) -> Interface {
    let scalars = Bound::<M, N>::ROWS;
    check(scalars);
    assert!(
        !(M::IS_INTEGRATED && Bound::<M, N>::HAS_INPUT_DERIVATIVES),
        "an input with the option `derivative` needs a step that uses it: #[model(continuous, step = Self::step)]"
    );
    let variant = match variant {
        Some(text) => Overrides::of(M::NAME, text),
        None => None,
    };
    let (name, overrides) = match variant {
        Some((name, overrides)) => (name, overrides),
        None => (M::NAME, Overrides::NONE),
    };
    Interface {
        name,
        description: M::DESCRIPTION,
        is_sampled: M::IS_SAMPLED,
        is_continuous: M::IS_CONTINUOUS,
        default_experiment: M::DEFAULT_EXPERIMENT,
        tolerance: M::TOLERANCE,
        scalars,
        overrides,
    }
}

impl Entry {
    /// The entry of the model `M` with `N` scalar variables.
    ///
    /// An array of this length can be declared only where `M` is known, which is where
    /// [`export!`](crate::export) is used.
    pub const fn of<M: Model, const N: usize>(
        interface: Interface,
        embedded: &'static [u8],
    ) -> Self {
        Self {
            name: interface.name,
            overrides: interface.overrides,
            guid: guid(&interface),
            is_for_model_exchange: M::IS_SAMPLED || M::IS_CONTINUOUS,
            #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
            create_fmi2: |entry, mode, log, resources| {
                let model = Bound::<M, N>::new(entry);
                fmi2::create(Component::new(mode, log, resources, model))
            },
            #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
            create_fmi3: |entry, mode, options, log, resources| {
                let model = Bound::<M, N>::new(entry);
                fmi3::create(options, Component::new(mode, log, resources, model))
            },
            _embedded: embedded,
        }
    }

    /// Name of the model.
    pub fn name(&self) -> &str {
        self.name
    }

    /// The GUID of the model's interface.
    pub fn guid(&self) -> &str {
        std::str::from_utf8(&self.guid).unwrap_or_default()
    }

    pub(crate) fn overrides(&self) -> Overrides {
        self.overrides
    }

    /// Finds the model that a host instantiates.
    ///
    /// # Errors
    /// The arguments of the host are invalid, or the model is not for this mode.
    pub(crate) fn choose(
        models: &'static [Self],
        name: Option<&CStr>,
        mode: Mode,
        guid: Option<&CStr>,
    ) -> Result<&'static Self, String> {
        if name.is_none_or(CStr::is_empty) {
            return Err("the instance name is missing".into());
        }
        if name.is_some_and(|name| name.to_str().is_err()) {
            return Err("the instance name is not UTF-8".into());
        }
        let guid = guid.ok_or("the GUID is missing")?.to_string_lossy();
        let model = models.iter().find(|m| m.guid() == guid).ok_or_else(|| {
            let known: Vec<String> = models
                .iter()
                .map(|m| format!("{} {}", m.name(), m.guid()))
                .collect();
            format!(
                "the GUID {guid} is that of another FMU or version; this binary has: {}",
                known.join(", ")
            )
        })?;
        match mode {
            Mode::ModelExchange if !model.is_for_model_exchange => Err(format!(
                "{} is for co-simulation, not for model exchange",
                model.name()
            )),
            Mode::CoSimulationWithEvents if !model.is_for_model_exchange => Err(format!(
                "eventModeUsed is true, but {} has no event mode: hasEventMode is false",
                model.name()
            )),
            _ => Ok(model),
        }
    }

    #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
    pub(crate) fn create_fmi2(
        &'static self,
        mode: Mode,
        log: Log,
        resources: Folder,
    ) -> *mut c_void {
        (self.create_fmi2)(self, mode, log, resources)
    }

    #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
    pub(crate) fn create_fmi3(
        &'static self,
        mode: Mode,
        options: fmi3::Options,
        log: Log,
        resources: Folder,
    ) -> *mut c_void {
        (self.create_fmi3)(self, mode, options, log, resources)
    }
}
