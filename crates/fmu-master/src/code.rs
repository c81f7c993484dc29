//! The code of an FMU: its binary, which is found, loaded and instantiated, or a function of this program.

use std::ffi::CString;
use std::path::Path;
use std::sync::{Arc, OnceLock};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::Element;
use fmu_description::{FmiVersion, LogCategory};
use fmu_file::platform::Platform;
use fmu_host::{Instance, Instantiation, InterfaceType, Library, Limits, LoadError};

use crate::fmu::files::FmuFolder;
use crate::{Function, Messages};

/// The code that the instances of an FMU run.
pub(crate) enum Code {
    Binary(UnpackedBinary),
    Function(Function),
}

/// A library and the location of its resources.
type Loaded = Result<(Arc<Library>, String), LoadError>;

/// An unpacked binary.
pub(crate) struct UnpackedBinary {
    pub(crate) version: FmiVersion,
    pub(crate) interface_type: InterfaceType,
    /// The file, relative to the folder.
    pub(crate) file: String,
    /// Loaded by the first instance, and the location of its resources. Must be dropped before the folder, which
    /// removes the file.
    pub(crate) library: OnceLock<Loaded>,
    /// The same, whose calls are observed.
    pub(crate) observed: OnceLock<Loaded>,
    pub(crate) folder: FmuFolder,
    pub(crate) token: String,
    pub(crate) limits: Limits,
    /// The log categories of warnings and errors, if it declares the categories of the standard.
    pub(crate) problems: Vec<CString>,
    /// If it was compiled from sources, what was left out of the build description.
    pub(crate) compiled: Option<Vec<String>>,
}

impl UnpackedBinary {
    /// Whether it is a WebAssembly component.
    pub(crate) fn is_component(&self) -> bool {
        self.file.ends_with(".wasm")
    }

    /// Whether it must not be called again in this process, because of a fatal error.
    pub(crate) fn is_lost(&self) -> bool {
        let loaded = [&self.library, &self.observed].into_iter().filter_map(OnceLock::get);
        loaded.flatten().any(|(library, _)| library.is_lost())
    }

    /// Creates an instance of the component with an index and a name, whose events the host handles in event mode or not;
    /// loads the binary before the first.
    ///
    /// # Errors
    /// The binary cannot be loaded or the FMU returns an error.
    pub(crate) fn instantiate(
        &self,
        (component, name): (usize, &str),
        event_mode: bool,
        messages: &Messages,
    ) -> Result<Instance> {
        let Self { file, folder, token, limits, problems, .. } = self;
        let observer = messages.observers().of_component(component);
        let mut calls = messages.record().calls(component);
        calls.begin(Some(fmu_worker::Function::LOADING));
        let load = || {
            let file = folder.path().join(file);
            let library = match observer.clone() {
                None => Library::load(&file, self.version)?,
                Some(observer) => Library::load_observed(&file, self.version, observer)?,
            };
            let resources = library.location(&folder.path().join("resources"));
            Ok((library, resources))
        };
        let library = if observer.is_some() { &self.observed } else { &self.library };
        let (library, resources) = library.get_or_init(load).as_ref().map_err(Clone::clone)?;
        ensure!(!library.is_lost(), "it is unusable after a fatal error");
        let arguments = Instantiation {
            name,
            interface_type: self.interface_type,
            guid: token,
            resources,
            logging_on: true,
            event_mode_used: event_mode,
            early_return_allowed: event_mode,
            limits: *limits,
            observer: observer.clone(),
            ..Instantiation::default()
        };
        let (instance, log) = (name.to_owned(), messages.clone());
        let sink = move |logged| {
            observer.iter().for_each(|observer| observer.log(&logged));
            log.log(&instance, &logged);
        };
        let function = self.interface_type.instantiation(self.version);
        calls.begin(fmu_worker::Function::named(function));
        let instance = library.instantiate(&arguments, sink)?;
        let mut instance = instance.with_context(|| {
            let reason = messages.reason(function);
            reason.unwrap_or_else(|| "the FMU logged no reason".into())
        })?;
        if messages.only_problems() && !problems.is_empty() {
            calls.begin(fmu_worker::Function::performing(self.version, "set_debug_logging"));
            // An FMU that cannot do so goes on logging everything.
            let _ = instance.set_debug_logging(true, problems);
        }
        Ok(instance)
    }
}

/// Finds the binary for this machine, or the WebAssembly component if there is none, or if it is `required`. `None` if
/// there is neither, but sources of which the binary that it would find can be compiled.
pub(crate) fn find_binary(
    names: &[String],
    identifier: &str,
    version: FmiVersion,
    required: bool,
) -> Result<Option<String>> {
    let native = Platform::of_this_machine(version);
    let component = Platform::component(version);
    for platform in [native.filter(|_| !required), component].into_iter().flatten() {
        let binary = platform.binary(identifier);
        // The names in an archive are safe, but the binary must also be in the folder of the platform.
        if names.contains(&binary) && !identifier.contains(['/', '\\']) {
            return Ok(Some(binary));
        }
    }
    ensure!(!required, "it has no WebAssembly component, and native binaries were refused");
    let platform = native
        .with_context(|| format!("FMI {} does not define this platform", version.as_str()))?;
    if has_sources(names) {
        return Ok(None);
    }
    let other = names.iter().find(|name| {
        let file = Path::new(name).file_stem().unwrap_or_default();
        file.to_str().is_some_and(|file| **name == platform.binary(file))
    });
    match other {
        Some(other) => bail!(
            "its binary {other} is not named after the model identifier {identifier:?}, expected {}",
            platform.binary(identifier)
        ),
        None => bail!("it has no binary for this machine ({})", platform.folder),
    }
}

fn has_sources(names: &[String]) -> bool {
    names.iter().any(|name| name.starts_with("sources/") && !name.ends_with('/'))
}

/// The log categories of warnings and errors that an FMU declares (FMI 2.0.5, section 2.2.4). None if it has no category
/// for errors, because it may then log them in any category.
pub(crate) fn problem_categories(root: &Element<'_>) -> Vec<CString> {
    let declared = root.list("LogCategories", "Category").filter_map(|c| c.attribute("name"));
    let of_statuses = declared.filter(|name| name.starts_with("logStatus"));
    let known = |name: &str| {
        let mut known = LogCategory::of_model(true).map(LogCategory::name);
        known.find(|known| known.to_bytes() == name.as_bytes())
    };
    let problems = Vec::from_iter(of_statuses.filter_map(known).map(ToOwned::to_owned));
    if problems.contains(&c"logStatusError".to_owned()) { problems } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_categories_of_problems_are_known_if_errors_have_one() {
        let found = |names: &[&'static str]| {
            let category = |name: &&'static str| Element::new("Category").with("name", *name);
            let categories = names.iter().map(category);
            problem_categories(&Element::new("root").listing("LogCategories", categories.collect()))
        };
        let standard = found(&["logStatusWarning", "logEvents", "logStatusError", "logAll"]);
        assert_eq!(standard, [c"logStatusWarning".to_owned(), c"logStatusError".to_owned()]);
        assert!(found(&["logStatusWarning", "error"]).is_empty());
        assert!(found(&[]).is_empty());
    }
}
