//! The documentation of a model in its FMU: an HTML page generated from the model description and
//! the package's folder `documentation/<MODEL>/`, an icon, and the licences.

mod folder;
mod page;

use anyhow::{Context, Result};
use fmu_description::{ModelDescription, xml};
use fmu_file::archive::{DOCUMENTATION, ICON};

use crate::library::Model;
use folder::Folder;

/// A file: its path in the FMU, and its content.
pub type File = (String, Vec<u8>);

/// All files of a model's documentation; `licenses` are the licence files of its workspace.
///
/// # Errors
/// A file of the model cannot be used.
pub fn files(model: &Model<'_>, licenses: &[File]) -> Result<Vec<File>> {
    let path = model.library.folder.join("documentation").join(&model.name);
    let folder = Folder::read(&path)
        .with_context(|| format!("the documentation of {} cannot be used", model.name))?;
    let root = xml::parse(&model.xml)?;
    let page = page::html(
        &ModelDescription::new(&root),
        folder.about.as_deref(),
        folder.icon.is_some(),
        licenses,
    );
    let beside = |(name, content): File| (format!("documentation/{name}"), content);
    let mut files = vec![(DOCUMENTATION.to_owned(), page.into_bytes())];
    files.extend(folder.others.into_iter().map(beside));
    files.extend(licenses.iter().cloned().map(beside));
    files.extend(folder.icon.map(|icon| (ICON.to_owned(), icon)));
    Ok(files)
}
