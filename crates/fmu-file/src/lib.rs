//! FMU files from any vendor: writes archives, and reads them with care, for nobody vouches for what a
//! file from elsewhere holds.
//!
//! | module | holds |
//! |---|---|
//! | [`archive`] | the zip archive: written the same for the same content, read within bounds |
//! | [`xml`] | XML as a tree, within bounds |
//! | [`model`] | the model description: variables, units, model structure |
//! | [`merge`] | FMUs of one model from several machines, as one |
//! | [`platform`] | the platform folders of FMI 2.0 |
//! | [`replace`] | files that are written whole or not at all |
//! | [`value`] | the forms of values in a model description |
//! | [`text`] | text of others in messages |
#![forbid(unsafe_code)]

pub mod archive;
pub mod merge;
pub mod model;
pub mod platform;
pub mod replace;
pub mod text;
pub mod value;
pub mod xml;
