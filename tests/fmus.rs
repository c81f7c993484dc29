//! The FMUs that tests of the crates load.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Once;

/// The root of the checkout, with the FMUs of the present sources in `target/fmu`, for both versions of
/// FMI.
pub fn root() -> PathBuf {
    static EXPORT: Once = Once::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    EXPORT.call_once(|| {
        let mut export = Command::new(env!("CARGO"));
        export.args(["fmu", "export", "--fmi", "2.0,3.0", "--out", "target/fmu"]);
        let output = export.current_dir(&root).output().expect("cargo runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
    });
    root
}
