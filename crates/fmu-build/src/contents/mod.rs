//! The files of an FMU other than the model description and the binaries: an HTML page generated from
//! the model description and the package's folder `documentation/<MODEL>/`, an icon, the licences, and
//! the package's folder `resources/`.

mod documentation;
mod folder;
mod licenses;
mod page;

use anyhow::{Context, Result};
use cargo_metadata::Metadata;
use fmu_description::{FmiVersion, ModelDescription, xml};
use fmu_file::archive::{DOCUMENTATION, ICON};

use crate::model::Model;
use documentation::Documentation;

/// The icon and the terminals of an FMU of FMI 3.0.
const ICON_OF_FMI_3: &str = "terminalsAndIcons/icon.png";
const TERMINALS: &str = "terminalsAndIcons/terminalsAndIcons.xml";

/// A file: its path in the FMU, and its content.
pub type File = (String, Vec<u8>);

/// All files of a model.
///
/// # Errors
/// A file of the model cannot be used.
pub fn files(model: &Model<'_>, metadata: &Metadata) -> Result<Vec<File>> {
    let folder = &model.library.folder;
    let path = folder.join("documentation").join(&model.base);
    let documentation = Documentation::read(&path)
        .with_context(|| format!("the documentation of {} cannot be used", model.base))?;
    let mut licenses = licenses::read(model.library, metadata)?;
    if model.version == FmiVersion::Fmi3 {
        licenses::add_entry_point(&mut licenses, model.library.origin.license.as_deref());
    }
    let root = xml::parse(&model.xml)?;
    let icon_path = match model.version {
        FmiVersion::Fmi2 => ICON,
        FmiVersion::Fmi3 => ICON_OF_FMI_3,
    };
    let icon = documentation.icon.map(|icon| (icon_path.to_owned(), icon));
    let page = page::html(
        &ModelDescription::new(&root),
        &model.file_name(),
        documentation.about.as_deref(),
        icon.as_ref().map(|_| icon_path),
        &licenses,
    );
    let beside = |(name, content): File| (format!("documentation/{name}"), content);
    let mut files = vec![(DOCUMENTATION.to_owned(), page.into_bytes())];
    files.extend(documentation.others.into_iter().map(beside));
    files.extend(licenses.into_iter().map(beside));
    if model.version == FmiVersion::Fmi3
        && let Some(xml) = model.description.terminals(icon.is_some())?
    {
        files.push((TERMINALS.to_owned(), xml.document()?.into_bytes()));
    }
    files.extend(icon);
    let resources =
        folder::read(&folder.join("resources")).context("the resources cannot be used")?;
    files.extend(
        resources
            .into_iter()
            .map(|(name, content)| (format!("resources/{name}"), content)),
    );
    Ok(files)
}
