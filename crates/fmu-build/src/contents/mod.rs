//! The files of an FMU other than the model description and the binaries: an HTML page generated from
//! the model description and the package's folder `documentation/<MODEL>/`, an icon, the licences, and
//! the package's folder `resources/`.

mod documentation;
mod folder;
mod licenses;
mod page;

use anyhow::{Context, Result};
use cargo_metadata::Metadata;
use fmu_description::{ModelDescription, xml};
use fmu_file::archive::{DOCUMENTATION, ICON};

use crate::model::Model;
use documentation::Documentation;

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
    let licenses = licenses::read(model.library, metadata)?;
    let root = xml::parse(&model.xml)?;
    let page = page::html(
        &ModelDescription::new(&root),
        documentation.about.as_deref(),
        documentation.icon.is_some(),
        &licenses,
    );
    let beside = |(name, content): File| (format!("documentation/{name}"), content);
    let mut files = vec![(DOCUMENTATION.to_owned(), page.into_bytes())];
    files.extend(documentation.others.into_iter().map(beside));
    files.extend(licenses.into_iter().map(beside));
    files.extend(documentation.icon.map(|icon| (ICON.to_owned(), icon)));
    let resources =
        folder::read(&folder.join("resources")).context("the resources cannot be used")?;
    files.extend(
        resources
            .into_iter()
            .map(|(name, content)| (format!("resources/{name}"), content)),
    );
    Ok(files)
}
