//! Documents of SSP, parsed and checked.

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::{self, Element};
use fmu_file::archive;

use super::vocabulary;
use crate::declarations::{Units, units};
use crate::package::STRUCTURE_FILE;

/// Maximum number of elements of a document; the documents of a package have the variables of all its FMUs.
const MAX_ELEMENTS: usize = 1 << 22;

/// Parses a document of SSP 1 or 2.0 with this root. Both have the same namespaces.
///
/// # Errors
/// It is another document.
pub fn document<'a>(text: &'a str, root: &str) -> Result<Element<'a>> {
    let mut element = xml::parse_up_to(MAX_ELEMENTS, text)?;
    let namespace = vocabulary::namespace(&element);
    vocabulary::normalize(&mut element)?;
    if element.name != root {
        let of = match namespace {
            _ if element.name.contains(':') => String::new(),
            Some(namespace) => format!(" of {namespace}"),
            None => " without a namespace".to_owned(),
        };
        bail!("the root is {}{of}, expected {root} of SSP 1.0 or 2.0", element.name);
    }
    let version = element.attribute("version").unwrap_or_default();
    let is_known = version.starts_with("1.") || version == "2.0";
    ensure!(is_known, "version {version:?} of SSP is not supported, expected 1.0 or 2.0");
    Ok(element)
}

/// Checks that a structure can be read again.
///
/// # Errors
/// It is larger than the limits.
pub fn check(structure: &str) -> Result<()> {
    let most = archive::MAX_SSP;
    ensure!(structure.len() as u64 <= most, "{STRUCTURE_FILE} is larger than {} MB", most >> 20);
    document(structure, vocabulary::STRUCTURE).map(drop).context(STRUCTURE_FILE)
}

/// The units that a structure defines.
pub fn defined_units(structure: &Element<'_>) -> Units {
    units(structure.list(vocabulary::UNITS, vocabulary::UNIT), vocabulary::BASE_UNIT)
}

/// The outermost system of a structure.
pub fn outermost_system<'a>(structure: &'a Element<'a>) -> Result<&'a Element<'a>> {
    structure.child(vocabulary::SYSTEM).context("it has no system")
}
