//! FMUs as C sources.

mod interface;

pub use interface::Interface;
