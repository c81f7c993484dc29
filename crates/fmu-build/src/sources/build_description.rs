//! `sources/buildDescription.xml`, which tells an importer how to compile the sources (FMI 3.0.2, section 2.4.10; since
//! FMI 2.0.4, section 2.3, FMUs of FMI 2.0 may have one, too).

use anyhow::Result;
use fmu_description::xml::Element;

/// Keeps the compiler from rounding a product and a sum once instead of twice, as GCC does where the processor can. It
/// does not know the pragma of the standard.
const OPTIONS: &str = "-ffp-contract=off";
const COMPILER: &str = "gcc";

/// The build description of a model, from files in the folder `sources`. `uses_math` says whether they need the
/// mathematical functions of C. It defines no macros: importers define all macros that it has, also optional ones.
pub fn document(identifier: &str, files: &[String], uses_math: bool) -> Result<String> {
    let files = files.iter().map(|name| Element::new("SourceFile").with("name", name));
    let set = Element::new("SourceFileSet")
        .with("language", "C99")
        .with("compiler", COMPILER)
        .with("compilerOptions", OPTIONS)
        .holding_all(files);
    let math = Element::new("Library").with("name", "m").with("external", true);
    let math = math.with("description", "Mathematical functions of C, where they have a library");
    let configuration = Element::new("BuildConfiguration")
        .with("modelIdentifier", identifier)
        .with("description", "Any C99 compiler, without -ffast-math")
        .holding(set)
        .holding_all(uses_math.then_some(math));
    let root = Element::new("fmiBuildDescription").with("fmiVersion", "3.0");
    root.holding(configuration).document()
}

#[cfg(test)]
mod tests {
    use fmu_description::xml::parse;

    use super::*;

    #[test]
    fn an_importer_finds_the_files_and_libraries() {
        let files = ["model.c".to_owned(), "fmi3.c".to_owned()];
        for (uses_math, libraries) in [(true, 1), (false, 0)] {
            let text = document("Pid", &files, uses_math).unwrap();
            let root = parse(&text).unwrap();
            assert_eq!(
                (root.name, root.attribute("fmiVersion")),
                ("fmiBuildDescription", Some("3.0"))
            );
            let configuration = root.child("BuildConfiguration").unwrap();
            assert_eq!(configuration.attribute("modelIdentifier"), Some("Pid"));
            assert_eq!(configuration.children("Library").count(), libraries);
            let set = configuration.child("SourceFileSet").unwrap();
            assert_eq!(set.attribute("language"), Some("C99"));
            let names = set.children("SourceFile").filter_map(|file| file.attribute("name"));
            assert!(names.eq(["model.c", "fmi3.c"]), "{text}");
            // FMPy and others define every macro, whether it is optional or not.
            assert!(set.child("PreprocessorDefinition").is_none());
        }
    }
}
