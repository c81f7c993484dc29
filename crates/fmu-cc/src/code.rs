//! What compiled code calls and contains, and whether its variables can be isolated.

use std::collections::HashSet;
use std::fmt::Display;
use std::path::Path;

use object::{File, Object, ObjectSection, ObjectSymbol, SectionKind};

/// Functions that return memory or files, which saved states would share with their instance.
const HEAP: [&str; 17] = [
    "malloc",
    "calloc",
    "realloc",
    "aligned_alloc",
    "posix_memalign",
    "strdup",
    "strndup",
    "_strdup",
    "asprintf",
    "fopen",
    "fopen64",
    "fdopen",
    "freopen",
    "tmpfile",
    "_wfopen",
    "mmap",
    "VirtualAlloc",
];
/// As mangled by C++: `new`, and strings, which allocate in their library.
const HEAP_IN_CPP: [&str; 4] = ["_Znw", "_Zna", "_ZNSs", "_ZNSt7__cxx11"];
/// Functions that start threads, which would run without the lock.
const THREADS: [&str; 5] =
    ["pthread_create", "thrd_create", "CreateThread", "_beginthread", "_beginthreadex"];
/// Functions of variables that each thread has.
const THREAD_LOCAL: [&str; 2] = ["__tls_get_addr", "__emutls_get_address"];

/// What compiled code may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Its variables are all its memory.
    Static,
    /// It allocates memory and opens files, too.
    Heap,
}

/// The object files of a library.
#[derive(Default)]
pub struct Code {
    defined: HashSet<String>,
    /// Each function or variable that a file uses and does not define.
    used: Vec<(String, String)>,
    hash: u64,
}

impl Code {
    /// Adds the object file of a source.
    ///
    /// # Errors
    /// It has variables that cannot be isolated, or cannot be read.
    pub fn add(&mut self, source: &Path, object: &[u8]) -> Result<(), String> {
        let file = File::parse(object)
            .map_err(|error| at(source, format!("{error}; compile it without -flto")))?;
        for section in file.sections() {
            let kind = section.kind();
            if matches!(kind, SectionKind::Tls | SectionKind::UninitializedTls) {
                return Err(at(source, "it has thread-local variables, which cannot be isolated"));
            }
            if section.name().is_ok_and(|name| name.starts_with(".gnu.lto_")) {
                return Err(at(source, "it is compiled with -flto; expected machine code"));
            }
        }
        for symbol in file.symbols() {
            let Ok(name) = symbol.name().map(str::to_owned) else { continue };
            match symbol.is_undefined() {
                true => self.used.push((source.display().to_string(), name)),
                false if symbol.is_global() => _ = self.defined.insert(name),
                false => {}
            }
        }
        // FNV-1a
        for byte in object {
            self.hash = (self.hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
        Ok(())
    }

    /// Checks that the code keeps its state in variables.
    ///
    /// # Errors
    /// It calls a function that contradicts this.
    pub fn check(&self, memory: Memory) -> Result<(), String> {
        for (source, name) in self.used.iter().filter(|(_, name)| !self.defined.contains(name)) {
            let is_one_of = |names: &[&str]| names.contains(&name.as_str());
            let is_heap = is_one_of(&HEAP) || HEAP_IN_CPP.iter().any(|new| name.starts_with(new));
            if is_heap && memory == Memory::Static {
                return Err(format!(
                    "{source} calls {name}, whose memory an instance would share with its saved states. Let the code keep \
                     its data in variables; or call fmu_cc::isolate_unsaved, and mark the field of the globals #[unsaved]"
                ));
            }
            if is_one_of(&THREADS) {
                return Err(format!(
                    "{source} calls {name}, and code that runs on threads of its own cannot be isolated; compile it by \
                     cc alone and declare #[model(single_instance)]"
                ));
            }
            if is_one_of(&THREAD_LOCAL) {
                return Err(format!(
                    "{source} has thread-local variables, which cannot be isolated"
                ));
            }
        }
        Ok(())
    }

    /// Whether the code needs the standard library of C++.
    pub fn needs_cpp(&self) -> bool {
        let is_missing = |name: &String| !self.defined.contains(name);
        let mut missing = self.used.iter().map(|(_, name)| name).filter(|name| is_missing(name));
        missing.any(|name| {
            ["_Z", "__cxa_", "__gxx_"].iter().any(|prefix| name.starts_with(prefix))
                && name != "__cxa_finalize"
        })
    }

    /// A hash of all files, which another version of the code does not have.
    pub fn hash(&self) -> u64 {
        self.hash
    }
}

/// An error message about a file.
pub fn at(file: &Path, error: impl Display) -> String {
    format!("{}: {error}", file.display())
}
