//! FMU files from any vendor: writes archives, and reads them as untrusted input.
//!
//! | module | contents |
//! |---|---|
//! | [`archive`] | the zip archive: reproducible when written, size limits when read |
//! | [`merge`] | merging FMUs of one model that were built on several machines |
//! | [`platform`] | the platform folders of FMI 2.0 and 3.0 |
//! | [`references`] | files that FMI-LS-REF relates to an FMU: parameter sets, experiments, results |
//! | [`replace`] | atomic writing of files |
//! | [`text`] | untrusted text in messages |
#![forbid(unsafe_code)]

pub mod archive;
pub mod merge;
pub mod platform;
pub mod references;
pub mod replace;
pub mod text;
