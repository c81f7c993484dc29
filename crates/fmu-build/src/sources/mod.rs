//! FMUs as C sources.

mod interface;
#[cfg(all(test, feature = "wasm"))]
#[expect(dead_code, reason = "the export of C sources will use the rest")]
mod untranslatable;

pub use interface::Interface;
