//! The options that a build description may pass to a compiler. All others are refused: they could read and write files
//! outside of the FMU, or run programs.

use fmu_file::text::quote;

use crate::error::{CompileError, invalid};

/// Compilers with the same options.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CompilerFamily {
    /// GCC, Clang and what understands their options.
    Gnu,
    /// The compiler of Visual Studio.
    Msvc,
}

impl CompilerFamily {
    /// The family of the compiler that the attribute `compiler` names, such as `gcc`, `clang++` or `VisualC`.
    pub fn named(compiler: &str) -> Option<Self> {
        let lower = compiler.to_lowercase();
        let has = |parts: &[&str]| parts.iter().any(|part| lower.contains(part));
        if has(&["visual", "msvc", "clang-cl"]) || matches!(lower.as_str(), "cl" | "cl.exe") {
            Some(Self::Msvc)
        } else if has(&["gcc", "g++", "clang", "gnu", "mingw"])
            || matches!(lower.as_str(), "cc" | "c++")
        {
            Some(Self::Gnu)
        } else {
            None
        }
    }

    /// How the messages call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gnu => "GCC or Clang",
            Self::Msvc => "Visual C",
        }
    }
}

/// A compiler that many machines have, and that options may be written for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KnownCompiler {
    Gcc,
    Clang,
}

impl KnownCompiler {
    /// The compiler that the attribute `compiler` names.
    pub fn named(compiler: &str) -> Option<Self> {
        match compiler.to_lowercase().as_str() {
            "gcc" | "g++" => Some(Self::Gcc),
            "clang" | "clang++" => Some(Self::Clang),
            _ => None,
        }
    }

    /// Its program for a language.
    pub fn program(self, is_cpp: bool) -> &'static str {
        match (self, is_cpp) {
            (Self::Gcc, false) => "gcc",
            (Self::Gcc, true) => "g++",
            (Self::Clang, false) => "clang",
            (Self::Clang, true) => "clang++",
        }
    }
}

/// An option.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CompilerOption {
    /// A word that is passed on.
    Word(String),
    /// A folder for includes, relative to the sources.
    Include(String),
    /// A library of the system to link.
    Library(String),
}

/// Options of GCC and Clang that take no value.
const GNU_WORDS: [&str; 9] =
    ["-ansi", "-c", "-shared", "-g", "-pedantic", "-pedantic-errors", "-pthread", "-pipe", "-w"];
/// Options of GCC and Clang that need a value behind this part, which is not a file.
const GNU_PREFIXES: [&str; 17] = [
    "-O",
    "-g",
    "-W",
    "-D",
    "-U",
    "-std=",
    "-march=",
    "-mtune=",
    "-mcpu=",
    "-mfpmath=",
    "-mabi=",
    "-mfloat-abi=",
    "-mfpu=",
    "-ffp-contract=",
    "-fexcess-precision=",
    "-ffp-model=",
    "-fvisibility=",
];
/// Options that begin as allowed ones, and load programs or write files.
const GNU_REFUSED: [&str; 15] = [
    "-Wl,",
    "-Wa,",
    "-Wp,",
    "-fplugin",
    "-fpass-plugin",
    "-fdump",
    "-fprofile",
    "-ftest-coverage",
    "-fcallgraph",
    "-fmodule",
    "-fsave-optimization",
    "-fcrash",
    "-fstack-usage",
    "-gsplit-dwarf",
    "-mllvm",
];
/// Options of Visual C, without the slash or hyphen before them.
const MSVC_WORDS: [&str; 16] = [
    "nologo",
    "GR",
    "GR-",
    "MT",
    "MTd",
    "MD",
    "MDd",
    "TC",
    "TP",
    "utf-8",
    "permissive-",
    "bigobj",
    "Z7",
    "Gy",
    "GS",
    "GS-",
];
const MSVC_PREFIXES: [&str; 9] = ["O", "W", "w", "D", "U", "std:", "fp:", "arch:", "EH"];

/// Reads the options of a family; of GCC and Clang by default.
///
/// # Errors
/// An option is not allowed.
pub fn read(
    text: &str,
    family: Option<CompilerFamily>,
) -> Result<Vec<CompilerOption>, CompileError> {
    let mut words = words(text)?.into_iter();
    let mut options = Vec::new();
    while let Some(mut word) = words.next() {
        // `-I folder` and `-D NAME`.
        if matches!(word.as_str(), "-I" | "-D" | "-U" | "/I" | "/D" | "/U") {
            word += &words.next().unwrap_or_default();
        }
        let option = match family {
            Some(CompilerFamily::Msvc) => of_msvc(&word),
            _ => of_gnu(&word),
        };
        match option {
            Some(option) => options.push(option),
            None => {
                return invalid(format!(
                    "its compilerOptions have {}, expected options for optimization, the language, warnings, \
                     the processor and definitions only",
                    quote(&word)
                ));
            }
        }
    }
    Ok(options)
}

fn of_gnu(word: &str) -> Option<CompilerOption> {
    if let Some(folder) = word.strip_prefix("-I").filter(|folder| !folder.is_empty()) {
        return Some(CompilerOption::Include(folder.to_owned()));
    }
    if let Some(library) = word.strip_prefix("-l").filter(|library| is_library_name(library)) {
        return Some(CompilerOption::Library(library.to_owned()));
    }
    let is_refused = GNU_REFUSED.iter().any(|start| word.starts_with(start));
    // Of `-f` and `-m`, those without a value, which would be a file or a program.
    let is_switch = ["-f", "-m"].iter().any(|start| {
        let name = word.strip_prefix(start);
        name.is_some_and(|name| {
            !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || "-.".contains(c))
        })
    });
    let has_prefix = || {
        GNU_PREFIXES.iter().any(|start| {
            let value = word.strip_prefix(start);
            // Only a definition may have what could be a path.
            value.is_some_and(|value| {
                matches!(*start, "-D" | "-U") && !value.is_empty()
                    || !value.contains(['/', '\\', '@', ','])
            })
        })
    };
    let is_allowed = !is_refused && (GNU_WORDS.contains(&word) || is_switch || has_prefix());
    is_allowed.then(|| CompilerOption::Word(word.to_owned()))
}

fn of_msvc(word: &str) -> Option<CompilerOption> {
    let name = word.strip_prefix(['/', '-'])?;
    if let Some(folder) = name.strip_prefix('I').filter(|folder| !folder.is_empty()) {
        return Some(CompilerOption::Include(folder.to_owned()));
    }
    let has_prefix = MSVC_PREFIXES.iter().any(|start| {
        let value = name.strip_prefix(start);
        value.is_some_and(|value| {
            matches!(*start, "D" | "U") && !value.is_empty()
                || value.chars().all(|c| c.is_ascii_alphanumeric() || "+-:".contains(c))
        })
    });
    (has_prefix || MSVC_WORDS.contains(&name)).then(|| CompilerOption::Word(word.to_owned()))
}

/// Whether it can be passed to a linker as the name of a library.
pub fn is_library_name(name: &str) -> bool {
    !name.is_empty()
        && !name.starts_with('-')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || "_-.+".contains(c))
}

/// The words of a text, in which quotes hold words together.
fn words(text: &str) -> Result<Vec<String>, CompileError> {
    let mut words = Vec::new();
    let (mut word, mut quote_mark) = (None::<String>, None);
    for c in text.chars() {
        match (quote_mark, c) {
            (Some(mark), c) if c == mark => quote_mark = None,
            (None, '"' | '\'') => {
                quote_mark = Some(c);
                word.get_or_insert_default();
            }
            (None, c) if c.is_whitespace() => words.extend(word.take()),
            (_, c) => word.get_or_insert_default().push(c),
        }
    }
    if quote_mark.is_some() {
        return invalid(format!("its compilerOptions {} have an open quotation mark", quote(text)));
    }
    words.extend(word);
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_gnu(text: &str) -> Result<Vec<CompilerOption>, String> {
        read(text, None).map_err(|error| error.to_string())
    }

    #[test]
    fn options_of_compilers_are_passed_on() {
        let text = "-O3 -fno-rtti -Wall -Wextra -std=c++11 -march=native -mavx2 -ffp-contract=off -g -DA='b c' -D B -pthread";
        let words = read_gnu(text).unwrap().into_iter().map(|option| match option {
            CompilerOption::Word(word) => word,
            other => panic!("{other:?}"),
        });
        let expected = [
            "-O3",
            "-fno-rtti",
            "-Wall",
            "-Wextra",
            "-std=c++11",
            "-march=native",
            "-mavx2",
            "-ffp-contract=off",
            "-g",
            "-DA=b c",
            "-DB",
            "-pthread",
        ];
        assert_eq!(Vec::from_iter(words), expected);
        let found = read("/O2 /fp:precise /EHsc -DX=1 /W4", Some(CompilerFamily::Msvc)).unwrap();
        assert_eq!(found.len(), 5);
        let folder = CompilerOption::Include("include".into());
        assert_eq!(read_gnu("-I include").unwrap(), [folder]);
        assert_eq!(read_gnu("-lm").unwrap(), [CompilerOption::Library("m".into())]);
    }

    #[test]
    fn options_that_run_programs_or_write_files_are_refused() {
        for option in [
            "-o",
            "-o/tmp/x",
            "@file",
            "-fplugin=a.so",
            "-fplugin-arg-a-b=c",
            "-wrapper",
            "-B/tmp",
            "-B.",
            "-specs=x",
            "-Wl,-plugin,x",
            "-Wp,-MD,x",
            "-Wa,-o,x",
            "-fuse-ld=/tmp/x",
            "-include",
            "-imacros",
            "-isystem/usr",
            "-x",
            "-MD",
            "-MFx",
            "-save-temps",
            "-dumpdir",
            "-fdump-tree-all",
            "-fprofile-use=x",
            "-fmodule-mapper=x",
            "-Xclang",
            "-mllvm",
            "--sysroot=/",
            "-L/tmp",
            "-l/tmp/a",
            "-fdiagnostics-add-output=x",
            "a.c",
            "/etc/passwd",
            "-fauto-profile=x",
            "-fpass-plugin=x",
            "-gsplit-dwarf",
            "-run",
            "-",
        ] {
            let error = read_gnu(option).unwrap_err();
            assert!(error.contains(option), "{error}");
        }
        for option in ["/Fo", "/FeX", "/link", "@x", "/FI", "/Yu", "/P", "a.c", "/analyze:plugin"] {
            assert!(read(option, Some(CompilerFamily::Msvc)).is_err(), "{option}");
        }
        assert!(read_gnu("-DA='b").is_err());
    }

    #[test]
    fn compilers_are_known_by_their_names() {
        for (name, family) in [
            ("gcc", Some(CompilerFamily::Gnu)),
            ("clang++", Some(CompilerFamily::Gnu)),
            ("x86_64-w64-mingw32-gcc", Some(CompilerFamily::Gnu)),
            ("VisualC", Some(CompilerFamily::Msvc)),
            ("MSVC", Some(CompilerFamily::Msvc)),
            ("icx", None),
        ] {
            assert_eq!(CompilerFamily::named(name), family, "{name}");
        }
    }
}
