//! The platform folders of FMI 2.0 (section 2.3) and the binaries in them.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, bail, ensure};

/// A platform folder of FMI 2.0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Platform {
    /// Name of the folder under `binaries/`.
    pub folder: &'static str,
    /// File extension of the binary.
    pub extension: &'static str,
    /// Possible first bytes of a binary for the platform.
    magic: &'static [&'static [u8]],
}

const ELF_64: &[&[u8]] = &[b"\x7fELF\x02"];
const ELF_32: &[&[u8]] = &[b"\x7fELF\x01"];
const PE: &[&[u8]] = &[b"MZ"];
const MACH_O: &[&[u8]] = &[b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe"];

const PLATFORMS: [Platform; 8] = [
    platform("linux64", "so", ELF_64),
    platform("linux32", "so", ELF_32),
    platform("win64", "dll", PE),
    platform("win32", "dll", PE),
    platform("darwin64", "dylib", MACH_O),
    platform("aarch64-linux", "so", ELF_64),
    platform("aarch64-windows", "dll", PE),
    platform("aarch64-darwin", "dylib", MACH_O),
];

/// The target name of universal binaries for macOS: x86-64 and ARM in one file.
pub const UNIVERSAL: &str = "universal2-apple-darwin";

const fn platform(
    folder: &'static str,
    extension: &'static str,
    magic: &'static [&'static [u8]],
) -> Platform {
    Platform {
        folder,
        extension,
        magic,
    }
}

impl Platform {
    /// The platforms of a Rust target triple; a suffix with a glibc version is allowed.
    ///
    /// ARM has two: since 2.0.4 the standard uses the names of FMI 3.0 for it, but importers such as
    /// FMPy look in the folder for the system's other 64-bit binaries.
    pub fn of_target(triple: &str) -> Result<Vec<Self>> {
        let processor = triple.split('-').next().unwrap_or_default();
        let bits = match processor {
            "i586" | "i686" | "arm" | "armv7" => "32",
            _ => "64",
        };
        let (short, system) = if triple.contains("-linux-") {
            ("linux", "linux")
        } else if triple.contains("-windows-") {
            ("win", "windows")
        } else if triple.contains("-apple-darwin") {
            ("darwin", "darwin")
        } else {
            bail!("FMI 2.0 has no platform folder for the target {triple}");
        };
        let mut folders = vec![format!("{short}{bits}")];
        if processor == "aarch64" || triple == UNIVERSAL {
            folders.push(format!("aarch64-{system}"));
        }
        folders
            .iter()
            .map(|folder| folder.parse())
            .collect::<Result<_>>()
            .with_context(|| format!("FMI 2.0 has no platform folder for the target {triple}"))
    }

    /// The platform of this machine, if FMI 2.0 has a folder for it.
    pub fn of_this_machine() -> Option<Self> {
        let system = match std::env::consts::OS {
            "windows" => "win",
            "macos" => "darwin",
            other => other,
        };
        Self::from_str(&format!("{system}{}", usize::BITS)).ok()
    }

    /// Path of a model's binary in an FMU.
    pub fn binary(&self, identifier: &str) -> String {
        format!("binaries/{}/{identifier}.{}", self.folder, self.extension)
    }

    /// Number of bytes that [`Platform::check`] and [`is_for_this_processor`] need.
    pub const HEAD: u64 = 20;

    /// Checks that the bytes are a binary in the platform's format.
    pub fn check(&self, binary: &[u8]) -> Result<()> {
        ensure!(
            self.magic.iter().any(|magic| binary.starts_with(magic)),
            "it is not a shared library of the platform {}",
            self.folder
        );
        Ok(())
    }
}

/// Whether a binary for this machine's platform is also for its processor: the folder `linux64` is used
/// for both ARM and x86-64. Only ELF headers are checked.
pub fn is_for_this_processor(binary: &[u8]) -> bool {
    const MACHINE: Range<usize> = 18..20;
    let machine: u16 = match std::env::consts::ARCH {
        "x86_64" => 62,
        "aarch64" => 183,
        _ => return true,
    };
    let field = binary
        .get(MACHINE)
        .filter(|_| binary.starts_with(b"\x7fELF"));
    field.is_none_or(|field| field == machine.to_le_bytes())
}

impl FromStr for Platform {
    type Err = anyhow::Error;

    fn from_str(folder: &str) -> Result<Self> {
        PLATFORMS
            .into_iter()
            .find(|platform| platform.folder == folder)
            .with_context(|| {
                let known = PLATFORMS.map(|p| p.folder).join(", ");
                format!("platform {folder:?} is unknown; there are {known}")
            })
    }
}

/// The folders in `binaries/`, standard or not, from the file names of an archive.
pub fn folders<'a>(names: impl IntoIterator<Item = &'a String>) -> BTreeSet<&'a str> {
    names
        .into_iter()
        .filter_map(|name| name.strip_prefix("binaries/")?.split_once('/'))
        .map(|(folder, _)| folder)
        .collect()
}

/// A prebuilt binary, given as `PLATFORM=FILE`.
#[derive(Debug, Clone)]
pub struct Prebuilt {
    /// Its platform.
    pub platform: Platform,
    /// Its path.
    pub file: PathBuf,
}

impl FromStr for Prebuilt {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let (platform, file) = text
            .split_once('=')
            .context("expected PLATFORM=FILE, such as win64=fmu_controller.dll")?;
        Ok(Self {
            platform: platform.parse()?,
            file: file.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_map_to_the_folders_of_the_standard() {
        for (triple, expected) in [
            ("x86_64-unknown-linux-gnu", "linux64"),
            ("x86_64-unknown-linux-gnu.2.17", "linux64"),
            ("aarch64-unknown-linux-gnu.2.17", "linux64 aarch64-linux"),
            ("i686-unknown-linux-gnu", "linux32"),
            ("x86_64-pc-windows-msvc", "win64"),
            ("i686-pc-windows-gnu", "win32"),
            ("x86_64-apple-darwin", "darwin64"),
            ("aarch64-apple-darwin", "darwin64 aarch64-darwin"),
            (UNIVERSAL, "darwin64 aarch64-darwin"),
        ] {
            let folders = Platform::of_target(triple).unwrap();
            let folders: Vec<_> = folders.iter().map(|platform| platform.folder).collect();
            assert_eq!(folders.join(" "), expected);
        }
        assert!(Platform::of_target("thumbv7em-none-eabihf").is_err());
    }

    #[test]
    fn a_binary_must_match_its_platform() {
        let linux: Platform = "linux64".parse().unwrap();
        assert!(linux.check(b"\x7fELF\x02 rest").is_ok());
        assert!(linux.check(b"\x7fELF\x01 rest").is_err());
        assert!(linux.check(b"MZ").is_err());
        assert!(linux.check(b"").is_err());
    }

    #[test]
    fn folders_are_listed_once() {
        let names = [
            "binaries/",
            "binaries/win64/a.dll",
            "binaries/linux64/",
            "binaries/linux64/a.so",
            "binaries/readme",
            "sources/linux64/a.c",
        ];
        let names = names.map(String::from);
        assert!(folders(&names).into_iter().eq(["linux64", "win64"]));
    }

    #[test]
    fn the_processor_is_read_from_elf() {
        let elf =
            |machine: u8| [b"\x7fELF\x02\x01\x01".as_slice(), &[0; 11], &[machine, 0]].concat();
        let (intel, arm) = (cfg!(target_arch = "x86_64"), cfg!(target_arch = "aarch64"));
        assert_eq!(is_for_this_processor(&elf(62)), intel || !arm);
        assert_eq!(is_for_this_processor(&elf(183)), arm || !intel);
        assert!(is_for_this_processor(b"MZ"));
    }

    #[test]
    fn prebuilt_binaries_have_a_platform_and_a_file() {
        let prebuilt: Prebuilt = "win64=a/b.dll".parse().unwrap();
        assert_eq!(prebuilt.platform.folder, "win64");
        assert_eq!(prebuilt.file, PathBuf::from("a/b.dll"));
        assert!("win64".parse::<Prebuilt>().is_err());
        let error = "amiga=x".parse::<Prebuilt>().unwrap_err().to_string();
        assert!(error.contains("linux64"), "{error}");
    }
}
