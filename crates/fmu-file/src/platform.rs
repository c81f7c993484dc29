//! The platform folders of FMI 2.0 (section 2.3) and 3.0 (section 2.5.1.4), and the binaries in them.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, ensure};
use fmu_description::FmiVersion;

/// A platform folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Platform {
    /// Name of the folder under `binaries/`.
    pub folder: &'static str,
    /// File extension of the binary.
    pub extension: &'static str,
    /// Possible first bytes of a binary for the platform.
    magic: &'static [&'static [u8]],
}

/// The extension of a binary, and its possible first bytes.
type Format = (&'static str, &'static [&'static [u8]]);

const ELF_64: Format = ("so", &[b"\x7fELF\x02"]);
const ELF_32: Format = ("so", &[b"\x7fELF\x01"]);
const PE: Format = ("dll", &[b"MZ"]);
/// A component: layer 1 of the format, in version 13.
const WASM: Format = ("wasm", &[b"\0asm\x0d\0\x01\0"]);
const MACH_O: Format = ("dylib", &[b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe"]);

/// The folders of FMI 2.0 and of FMI 3.0; empty if a version has none for the platform.
const FOLDERS: [([&str; 2], Format); 10] = [
    (["linux64", "x86_64-linux"], ELF_64),
    (["linux32", "x86-linux"], ELF_32),
    (["win64", "x86_64-windows"], PE),
    (["win32", "x86-windows"], PE),
    (["darwin64", "x86_64-darwin"], MACH_O),
    (["aarch64-linux", "aarch64-linux"], ELF_64),
    (["aarch64-windows", "aarch64-windows"], PE),
    (["aarch64-darwin", "aarch64-darwin"], MACH_O),
    (["", "aarch32-linux"], ELF_32),
    (["", "wasm32-wasip2"], WASM),
];

/// The target name of universal binaries for macOS: x86-64 and ARM in one file.
pub const UNIVERSAL: &str = "universal2-apple-darwin";

/// The target name of WebAssembly components.
pub const TARGET_WASM: &str = "wasm";

impl Platform {
    /// The platform of a folder.
    ///
    /// # Errors
    /// The version of FMI has no such folder.
    pub fn named(folder: &str, version: FmiVersion) -> Result<Self> {
        let found = platforms(version).find(|platform| platform.folder == folder);
        found.with_context(|| {
            let known: Vec<_> = platforms(version).map(|platform| platform.folder).collect();
            format!("platform {folder:?} is unknown; there are {}", known.join(", "))
        })
    }

    /// All platforms of a version of FMI.
    pub fn all(version: FmiVersion) -> impl Iterator<Item = Self> {
        platforms(version)
    }

    /// Whether a version of FMI has the folder.
    pub fn is_of(&self, version: FmiVersion) -> bool {
        platforms(version).any(|platform| platform == *self)
    }

    /// The platforms of a Rust target triple; a suffix with a glibc version is allowed.
    ///
    /// In FMI 2.0, ARM has two: since 2.0.4 the standard uses the names of FMI 3.0 for it, but importers
    /// such as FMPy look in the folder for the system's other 64-bit binaries.
    pub fn of_target(triple: &str, version: FmiVersion) -> Result<Vec<Self>> {
        if triple == TARGET_WASM {
            let none = "WebAssembly components are for FMI 3.0; write --fmi 3.0";
            return Ok(vec![Self::component(version).context(none)?]);
        }
        let processor = triple.split('-').next().unwrap_or_default();
        let (processor, bits) = match processor {
            "x86" | "i586" | "i686" => ("x86", "32"),
            "arm" | "armv7" => ("aarch32", "32"),
            other => (other, "64"),
        };
        let number = version.as_str();
        let none = || format!("FMI {number} has no platform folder for the target {triple}");
        let (_, short, system) = [
            ("-linux-", "linux", "linux"),
            ("-windows-", "win", "windows"),
            ("-apple-darwin", "darwin", "darwin"),
        ]
        .into_iter()
        .find(|(part, ..)| triple.contains(part))
        .with_context(none)?;
        let is_universal = triple == UNIVERSAL;
        let mut folders = Vec::new();
        match version {
            FmiVersion::Fmi2 => folders.push(format!("{short}{bits}")),
            FmiVersion::Fmi3 if is_universal => folders.push(format!("x86_64-{system}")),
            FmiVersion::Fmi3 if processor == "aarch64" => {}
            FmiVersion::Fmi3 => folders.push(format!("{processor}-{system}")),
        }
        if processor == "aarch64" || is_universal {
            folders.push(format!("aarch64-{system}"));
        }
        folders
            .iter()
            .map(|folder| Self::named(folder, version))
            .collect::<Result<_>>()
            .with_context(none)
    }

    /// The platform of WebAssembly components, if this version of FMI has it.
    pub fn component(version: FmiVersion) -> Option<Self> {
        platforms(version).find(Self::is_wasm)
    }

    /// The platform of this machine, if this version of FMI has a folder for it.
    pub fn of_this_machine(version: FmiVersion) -> Option<Self> {
        let system = match std::env::consts::OS {
            "macos" => "apple-darwin",
            other => other,
        };
        let triple = format!("{}-{system}-", std::env::consts::ARCH);
        let platforms = Self::of_target(&triple, version).ok()?;
        platforms.first().copied()
    }

    /// Whether a version of FMI gives it this name.
    pub fn is_named(&self, name: &str) -> bool {
        let mut rows = FOLDERS.iter().map(|(folders, _)| folders);
        !name.is_empty()
            && rows.any(|folders| folders.contains(&self.folder) && folders.contains(&name))
    }

    /// Path of a model's binary in an FMU.
    pub fn binary(&self, identifier: &str) -> String {
        format!("binaries/{}/{identifier}.{}", self.folder, self.extension)
    }

    /// Whether its binaries are WebAssembly components.
    pub fn is_wasm(&self) -> bool {
        self.extension == WASM.0
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

/// The platforms of a version of FMI.
fn platforms(version: FmiVersion) -> impl Iterator<Item = Platform> {
    let index = match version {
        FmiVersion::Fmi2 => 0,
        FmiVersion::Fmi3 => 1,
    };
    let platform = move |(folders, (extension, magic)): ([&'static str; 2], Format)| Platform {
        folder: folders[index],
        extension,
        magic,
    };
    let platforms = FOLDERS.into_iter().map(platform);
    platforms.filter(|platform| !platform.folder.is_empty())
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
    let field = binary.get(MACHINE).filter(|_| binary.starts_with(b"\x7fELF"));
    field.is_none_or(|field| field == machine.to_le_bytes())
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
        let version = if platform.contains('-') { FmiVersion::Fmi3 } else { FmiVersion::Fmi2 };
        let platform = Platform::named(platform, version)?;
        ensure!(
            !platform.is_wasm(),
            "{file} is a WebAssembly component, which does not describe its model; expected a native binary, or merge FMUs with `cargo fmu merge`"
        );
        Ok(Self { platform, file: file.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_map_to_the_folders_of_the_standard() {
        for (triple, in_fmi_2, in_fmi_3) in [
            ("x86_64-unknown-linux-gnu.2.17", "linux64", "x86_64-linux"),
            ("armv7-unknown-linux-gnueabihf", "linux32", "aarch32-linux"),
            ("i686-unknown-linux-gnu", "linux32", "x86-linux"),
            ("x86_64-pc-windows-msvc", "win64", "x86_64-windows"),
            ("i686-pc-windows-gnu", "win32", "x86-windows"),
            ("x86_64-apple-darwin", "darwin64", "x86_64-darwin"),
            ("aarch64-unknown-linux-gnu", "linux64 aarch64-linux", "aarch64-linux"),
            (UNIVERSAL, "darwin64 aarch64-darwin", "x86_64-darwin aarch64-darwin"),
        ] {
            for (version, expected) in FmiVersion::ALL.into_iter().zip([in_fmi_2, in_fmi_3]) {
                let folders = Platform::of_target(triple, version).unwrap();
                let folders: Vec<_> = folders.iter().map(|platform| platform.folder).collect();
                assert_eq!(folders.join(" "), expected);
            }
        }
        assert!(Platform::of_target("thumbv7em-none-eabihf", FmiVersion::Fmi3).is_err());
        let component = Platform::of_target(TARGET_WASM, FmiVersion::Fmi3).unwrap();
        assert_eq!(component[0].binary("Pid"), "binaries/wasm32-wasip2/Pid.wasm");
        let error = Platform::of_target(TARGET_WASM, FmiVersion::Fmi2).unwrap_err();
        assert_eq!(error.to_string(), "WebAssembly components are for FMI 3.0; write --fmi 3.0");
        let error = "wasm32-wasip2=Pid.wasm".parse::<Prebuilt>().unwrap_err().to_string();
        assert!(error.contains("expected a native binary"), "{error}");
    }

    #[test]
    fn folders_are_listed_once() {
        let names = "binaries/ binaries/win64/a.dll binaries/linux64/ binaries/linux64/a.so \
            binaries/readme sources/linux64/a.c";
        let names: Vec<_> = names.split(' ').map(String::from).collect();
        assert!(folders(&names).into_iter().eq(["linux64", "win64"]));
    }

    #[test]
    fn a_binary_must_match_its_platform_and_the_processor() {
        let linux = Platform::named("linux64", FmiVersion::Fmi2).unwrap();
        assert!(linux.check(b"\x7fELF\x02 rest").is_ok());
        for other in [&b"\x7fELF\x01 rest"[..], b"MZ", b""] {
            assert!(linux.check(other).is_err());
        }
        let elf =
            |machine: u8| [b"\x7fELF\x02\x01\x01".as_slice(), &[0; 11], &[machine, 0]].concat();
        let (intel, arm) = (cfg!(target_arch = "x86_64"), cfg!(target_arch = "aarch64"));
        assert_eq!(is_for_this_processor(&elf(62)), intel || !arm);
        assert_eq!(is_for_this_processor(&elf(183)), arm || !intel);
        assert!(is_for_this_processor(b"MZ"));
    }
}
