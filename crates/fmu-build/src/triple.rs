//! Which target was meant by a name that is none.

use fmu_description::FmiVersion;
use fmu_file::platform::{Platform, TARGET_WASM, UNIVERSAL};

/// Common names of platforms, folders of FMI first, and the target for them.
const PLATFORMS: [(&[&str], &str); 11] = [
    (&["linux64", "x86_64-linux", "linux"], "x86_64-unknown-linux-gnu"),
    (&["linux32", "x86-linux"], "i686-unknown-linux-gnu"),
    (&["win64", "x86_64-windows", "windows", "windows64", "win"], "x86_64-pc-windows-gnu"),
    (&["win32", "x86-windows", "windows32"], "i686-pc-windows-gnu"),
    (&["aarch64-windows", "arm64-windows"], "aarch64-pc-windows-msvc"),
    (&["darwin64", "darwin", "macos", "mac", "osx"], UNIVERSAL),
    (&["x86_64-darwin", "x86_64-macos"], "x86_64-apple-darwin"),
    (&["aarch64-darwin", "arm64-darwin", "aarch64-macos", "arm64-macos"], "aarch64-apple-darwin"),
    (
        &["aarch64-linux", "arm64-linux", "aarch64", "arm64", "arm"],
        "aarch64-unknown-linux-gnu.2.17",
    ),
    (&["aarch32-linux"], "armv7-unknown-linux-gnueabihf"),
    (&["wasm32-wasip2", "wasm32", "wasm32-unknown-unknown"], TARGET_WASM),
];

/// How many letters of a target may be wrong.
const MISTAKES: usize = 2;

/// The target that was probably meant by the name of a platform or a misspelled target. `known` are the targets of the
/// toolchain, `host` is the target of this machine.
pub fn meant(name: &str, known: &str, host: &str) -> Option<String> {
    let name = name.split('.').next().unwrap_or_default().to_lowercase();
    if let Some((_, target)) = PLATFORMS.iter().find(|(names, _)| names.contains(&&*name)) {
        // On Windows, the usual toolchain is the one of Visual Studio.
        return Some(match host.ends_with("-msvc") {
            true => target.replace("-windows-gnu", "-windows-msvc"),
            false => (*target).to_owned(),
        });
    }
    let is_for_fmi = |target: &&str| Platform::of_target(target, FmiVersion::Fmi3).is_ok();
    let targets = known.lines().chain([UNIVERSAL]).filter(is_for_fmi);
    let mut targets = Vec::from_iter(targets);
    let is_part = |target: &&&str| {
        let mut parts = target.split('-');
        name.contains('-') && name.split('-').all(|part| parts.any(|other| other == part))
    };
    if let Some(target) = targets.iter().find(is_part) {
        return Some((*target).to_owned());
    }
    let distance = |target: &&str| strsim::osa_distance(&name, target);
    targets.sort_by_key(distance);
    let nearest = targets.first().filter(|target| distance(target) <= MISTAKES);
    nearest.map(|target| (*target).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: &str = "aarch64-apple-darwin\naarch64-apple-ios\naarch64-unknown-linux-gnu\n\
        aarch64-unknown-linux-musl\nwasm32-unknown-unknown\nx86_64-apple-darwin\nx86_64-pc-windows-gnu\n\
        x86_64-pc-windows-msvc\nx86_64-unknown-linux-gnu\nx86_64-unknown-linux-musl";

    #[test]
    fn a_platform_or_a_misspelled_target_means_a_target() {
        for (name, expected) in [
            ("win64", "x86_64-pc-windows-gnu"),
            ("Windows", "x86_64-pc-windows-gnu"),
            ("linux64", "x86_64-unknown-linux-gnu"),
            ("darwin64", UNIVERSAL),
            ("aarch64-linux", "aarch64-unknown-linux-gnu.2.17"),
            ("wasm32-wasip2", TARGET_WASM),
            ("x86_64-windows-gnu", "x86_64-pc-windows-gnu"),
            ("x86_64-linux-gnu", "x86_64-unknown-linux-gnu"),
            ("aarch64-apple", "aarch64-apple-darwin"),
            ("universal-apple-darwin", UNIVERSAL),
            ("x86_64-unknown-linux-gnux.2.17", "x86_64-unknown-linux-gnu"),
        ] {
            let found = meant(name, KNOWN, "x86_64-unknown-linux-gnu");
            assert_eq!(found.as_deref(), Some(expected), "{name}");
        }
        let on_windows = meant("win64", KNOWN, "x86_64-pc-windows-msvc");
        assert_eq!(on_windows.as_deref(), Some("x86_64-pc-windows-msvc"));
    }

    #[test]
    fn a_name_that_resembles_no_target_means_none() {
        for name in ["", "plc", "siemens-s7", "x86_64-nonsense-linux-gnu"] {
            assert_eq!(meant(name, KNOWN, ""), None, "{name}");
        }
    }
}
