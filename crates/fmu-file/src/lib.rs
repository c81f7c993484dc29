//! FMU files from any vendor: writes archives, and reads them as untrusted input.
//!
//! | module | holds |
//! |---|---|
//! | [`archive`] | the zip archive: written the same for the same content, read within bounds |
//! | [`merge`] | FMUs of one model from several machines, as one |
//! | [`platform`] | the platform folders of FMI 2.0 |
//! | [`replace`] | files that are written whole or not at all |
//! | [`text`] | untrusted text in messages |
#![forbid(unsafe_code)]

pub mod archive;
pub mod merge;
pub mod platform;
pub mod replace;
pub mod text;
