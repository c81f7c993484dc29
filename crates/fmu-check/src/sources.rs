//! Checks of the sources: which files are listed, and `sources/buildDescription.xml` (FMI 3.0.2, section 2.4.10).

use std::collections::{BTreeSet, HashMap, HashSet};

use fmu_description::FmiVersion;
use fmu_description::xml::Element;
use fmu_file::archive;
use fmu_file::text::quote;

use crate::finding::{Location, find, require};
use crate::package::{Files, INTERFACES, interfaces};
use crate::rule::rule;
use crate::schema;

/// How to build the sources.
const BUILD_FILE: &str = "sources/buildDescription.xml";
/// The folder of the sources.
const FOLDER: &str = "sources/";
/// The extensions of files that are compiled.
const COMPILED: [&str; 7] = ["c", "C", "cc", "cpp", "cxx", "c++", "CPP"];
/// Maximum number of bytes that are read of a source file, and of all.
const MAX_SOURCE: u64 = 8 << 20;
const MAX_SOURCES: u64 = 64 << 20;

impl Files<'_> {
    /// Checks the sources; returns whether the FMU has any.
    pub fn sources(&mut self) -> bool {
        let is_file = |name: &&String| name.starts_with(FOLDER) && !name.ends_with('/');
        let is_empty = !self.names.iter().any(|name| is_file(&name));
        let mut listed = match self.model.version {
            FmiVersion::Fmi2 => self.source_files(),
            FmiVersion::Fmi3 => BTreeSet::new(),
        };
        let mut is_described = false;
        if !is_empty || self.model.version == FmiVersion::Fmi2 {
            let build =
                |files: &mut Self, root: &Element<'_>| listed.append(&mut files.build(root));
            is_described = self.document(BUILD_FILE, &schema::BUILD, rule!("build-given"), build);
        }
        if !is_empty && !is_described && self.model.version == FmiVersion::Fmi3 {
            let has_binaries = self.names.iter().any(|name| name.starts_with("binaries/"));
            let rule = if has_binaries { rule!("sources-left") } else { rule!("build-given") };
            let text = format!("it has no {BUILD_FILE}, expected it beside the sources");
            self.findings.add(rule, "sources", text);
        }
        self.unlisted(listed);
        is_described
            || self.model.version == FmiVersion::Fmi2
                && interfaces(self.model.root).any(|kind| kind.child("SourceFiles").is_some())
    }

    /// Checks the lists of FMI 2.0; returns the paths of the files.
    fn source_files(&mut self) -> BTreeSet<String> {
        let root = self.model.root;
        let mut all = BTreeSet::new();
        for kind in INTERFACES {
            let mut listed = BTreeSet::new();
            let interfaces = root.children(kind);
            for file in interfaces.flat_map(|kind| kind.list("SourceFiles", "File")) {
                if let Some(name) = file.attribute("name") {
                    let path = self.source(name, file.into());
                    require!(self.findings, "sources-unique" at file, listed.insert(path),
                        "the source file {} is listed twice, expected once", quote(name));
                }
            }
            all.append(&mut listed);
        }
        all
    }

    /// Checks that all files that could be compiled are listed, or included by others. Where nothing is listed, there is
    /// another finding, or FMI 2.0 leaves it to the importer.
    fn unlisted(&mut self, listed: BTreeSet<String>) {
        if listed.is_empty() {
            return;
        }
        let is_compiled = |name: &&String| {
            let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension);
            name.starts_with(FOLDER) && COMPILED.contains(&extension)
        };
        let compiled: BTreeSet<String> = self.names.iter().filter(is_compiled).cloned().collect();
        if compiled.is_subset(&listed) {
            return;
        }
        let Some(used) = self.with_included(listed) else { return };
        for name in compiled.difference(&used) {
            find!(self.findings, "sources-listed" at name.as_str(),
                "it is neither listed nor included by a file that is, expected one of the two");
        }
    }

    /// Source files with all files that they may include, from any folder; `None` if a macro says which.
    fn with_included(&mut self, files: BTreeSet<String>) -> Option<BTreeSet<String>> {
        let mut named: HashMap<&str, Vec<&String>> = HashMap::new();
        for path in self.names.iter().filter(|name| name.starts_with(FOLDER)) {
            named.entry(file_name(path)).or_default().push(path);
        }
        let (mut next, mut left) = (Vec::from_iter(files), MAX_SOURCES);
        let mut found: BTreeSet<String> = next.iter().cloned().collect();
        while let Some(file) = next.pop() {
            let content = self.archive.head(&file, MAX_SOURCE.min(left)).unwrap_or_default();
            left -= content.len() as u64;
            for name in included(&String::from_utf8_lossy(&content)) {
                for &path in named.get(file_name(name?)).into_iter().flatten() {
                    if found.insert(path.clone()) {
                        next.push(path.clone());
                    }
                }
            }
        }
        Some(found)
    }

    /// Checks that a source file exists; returns its path, or else its name.
    fn source(&mut self, name: &str, at: Location) -> String {
        let path = archive::relative(&format!("{FOLDER}{name}"));
        let exists = path.as_ref().is_ok_and(|path| self.names.contains(path));
        require!(self.findings, "sources-exist" at at.clone(), !name.contains('\\'),
            "the name {} of a source file has a backslash, expected forward slashes", quote(name));
        require!(self.findings, "sources-exist" at at, exists,
            "the source file {} is missing, expected it in sources", quote(name));
        path.unwrap_or_else(|_| name.to_owned())
    }

    /// Checks `buildDescription.xml`; returns the paths of the files that it lists.
    fn build(&mut self, document: &Element<'_>) -> BTreeSet<String> {
        let at = |element| Location::in_file(BUILD_FILE, element);
        let identifiers = self.identifiers();
        let (mut platforms, mut listed) = (HashSet::new(), BTreeSet::new());
        for configuration in document.children("BuildConfiguration") {
            let identifier = configuration.attribute("modelIdentifier");
            let identifier = identifier.unwrap_or_default();
            require!(self.findings, "build-identifier" at at(configuration),
                identifiers.contains(identifier),
                "modelIdentifier is {}, expected the modelIdentifier of an interface type", quote(identifier));
            let platform = configuration.attribute("platform");
            require!(self.findings, "build-platform" at at(configuration),
                platforms.insert((identifier, platform)),
                "two configurations have {}, expected one", platform.map_or("no platform".into(), quote));
            require!(self.findings, "build-sources" at at(configuration),
                configuration.child("SourceFileSet").is_some(),
                "it has no SourceFileSet, expected one");
            for set in configuration.children("SourceFileSet") {
                listed.extend(self.source_set(set));
            }
        }
        for identifier in identifiers {
            let mut described = platforms.iter().map(|(described, _)| *described);
            require!(self.findings, "build-complete" at at(document),
                described.any(|described| described == identifier),
                "it has no BuildConfiguration with the modelIdentifier {}, expected one for each", quote(identifier));
        }
        listed
    }

    /// Checks a set of source files, and what it is compiled with; returns the paths of the files.
    fn source_set(&mut self, set: &Element<'_>) -> Vec<String> {
        let at = |element| Location::in_file(BUILD_FILE, element);
        for kind in ["SourceFile", "PreprocessorDefinition", "IncludeDirectory"] {
            let mut names = HashSet::new();
            for element in set.children(kind) {
                let name = element.attribute("name").unwrap_or_default();
                require!(self.findings, "build-once" at at(element), names.insert(name),
                    "the {kind} {} appears twice, expected once", quote(name));
            }
        }
        require!(self.findings, "build-compiler" at at(set),
            set.has("compiler") || !set.has("compilerOptions"),
            "it has compilerOptions and no compiler, expected both");
        for definition in set.children("PreprocessorDefinition") {
            if let Some(value) = definition.attribute("value") {
                let mut options = definition.children("Option").peekable();
                let is_free = options.peek().is_none();
                require!(self.findings, "build-option" at at(definition),
                    is_free || options.any(|option| option.attribute("value") == Some(value)),
                    "value is {}, expected the value of an Option", quote(value));
            }
        }
        let files = set.children("SourceFile");
        let path = |file: &Element<'_>| {
            let place = Location::in_file(BUILD_FILE, file);
            self.source(file.attribute("name").unwrap_or_default(), place)
        };
        files.map(path).collect()
    }
}

/// The last part of a path.
fn file_name(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or_default()
}

/// The names of files that a source file includes, whatever the conditions; `None` for a macro in place of a name.
fn included(text: &str) -> impl Iterator<Item = Option<&str>> {
    text.lines().filter_map(|line| {
        let line = line.trim_start().strip_prefix('#')?.trim_start().strip_prefix("include")?;
        match line.trim_start().split_at_checked(1)? {
            ("\"", rest) => Some(rest.split_once('"').map(|(name, _)| name)),
            ("<", rest) => Some(rest.split_once('>').map(|(name, _)| name)),
            (first, _) => {
                first.starts_with(|c: char| c == '_' || c.is_alphabetic()).then_some(None)
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn included_files_are_found_in_all_forms() {
        for (line, expected) in [
            ("#include \"a.c\"", Some(Some("a.c"))),
            ("  #\tinclude<b/a.h> // b", Some(Some("b/a.h"))),
            ("# include \"../a.h\"", Some(Some("../a.h"))),
            ("#include MODEL_FILE", Some(None)),
            ("#include \"a.c", Some(None)),
            ("#include", None),
            ("#define include \"a.c\"", None),
            ("// see #include \"a.c\"", None),
        ] {
            assert_eq!(included(line).next(), expected, "{line}");
        }
    }
}
