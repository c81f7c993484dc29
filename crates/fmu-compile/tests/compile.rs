//! FMUs with sources in the styles of several vendors, and descriptions that are wrong or hostile.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use fmu_compile::{CompileControl, CompileError, Compiled, compile, write_with};
use fmu_file::archive::{self, Archive, Packed};
use tempfile::TempDir;

const XML_2: &str = r#"<fmiModelDescription fmiVersion="2.0"><CoSimulation modelIdentifier="A"><SourceFiles><File name="a.c"/></SourceFiles></CoSimulation></fmiModelDescription>"#;
const XML_3: &str = r#"<fmiModelDescription fmiVersion="3.0"><CoSimulation modelIdentifier="A"/></fmiModelDescription>"#;
const BUILD: &str = "sources/buildDescription.xml";

/// The function by which an FMU of FMI 2.0 is instantiated, with a prefix for static linking.
const SOURCE_2: &str = r#"
#define FMI2_FUNCTION_PREFIX A_
#include "fmi2Functions.h"
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f, fmi2Boolean v, fmi2Boolean l) {
    (void)n; (void)t; (void)g; (void)r; (void)f; (void)v; (void)l;
    return 0;
}
"#;
const SOURCE_3: &str = r#"
#define FMI3_FUNCTION_PREFIX A_
#include "fmi3Functions.h"
fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String t, fmi3String p, fmi3Boolean v, fmi3Boolean l, fmi3Boolean e, fmi3Boolean r, const fmi3ValueReference i[], size_t c, fmi3InstanceEnvironment s, fmi3LogMessageCallback m, fmi3IntermediateUpdateCallback u) {
    (void)n; (void)t; (void)p; (void)v; (void)l; (void)e; (void)r; (void)i; (void)c; (void)s; (void)m; (void)u;
    return 0;
}
"#;

/// The build description of a configuration.
fn build(configuration: &str) -> String {
    format!(
        r#"<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="A">{configuration}</BuildConfiguration></fmiBuildDescription>"#
    )
}

/// Writes an FMU, and compiles it.
fn compiled(folder: &Path, files: &[(&str, &str)]) -> Result<Compiled, CompileError> {
    let packed = files.iter().map(|(name, text)| (*name, Packed::text(text.as_bytes()).unwrap()));
    let packed = Vec::from_iter(packed);
    let entries = Vec::from_iter(packed.iter().map(|(name, file)| (*name, file)));
    let fmu = folder.join("A.fmu");
    archive::write(&fmu, &entries).unwrap();
    compile(&fmu, &folder.join("out"), &CompileControl::default())
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

/// Compiles an FMU of FMI 3.0 with this configuration and a correct source `a.c`.
fn configured(configuration: &str, others: &[(&str, &str)]) -> Result<Compiled, CompileError> {
    let (folder, text) = (folder(), build(configuration));
    let files = [("modelDescription.xml", XML_3), ("sources/a.c", SOURCE_3), (BUILD, &text)];
    compiled(folder.path(), &[&files, others].concat())
}

/// The error of [`configured`].
fn refused(configuration: &str, others: &[(&str, &str)]) -> String {
    configured(configuration, others).unwrap_err().to_string()
}

const A: &str = r#"<SourceFile name="a.c"/>"#;

/// A set with the source file `a.c`.
fn set(attributes: &str, children: &str) -> String {
    format!("<SourceFileSet {attributes}>{A}{children}</SourceFileSet>")
}

#[test]
fn both_versions_are_compiled_without_the_prefix_of_static_linking() {
    let folder = folder();
    let files = [("modelDescription.xml", XML_2), ("sources/a.c", SOURCE_2)];
    let compiled = compiled(folder.path(), &files).unwrap();
    assert_eq!(compiled.libraries.len(), 1);
    let library = &compiled.libraries[0];
    assert!(library.file.is_file() && library.file.ends_with(&library.binary));
    assert_eq!(library.identifier, "A");
    assert_eq!(compiled.notes, Vec::<String>::new());
    assert!(compiled.log.contains(" sources/a.c\n"), "{}", compiled.log);
    configured(&set("language='C99'", ""), &[]).unwrap();
}

#[test]
fn older_headers_beside_the_sources_do_not_bring_the_prefix_back() {
    let folder = folder();
    let old = "#include \"fmi2FunctionTypes.h\"\n#define Paste(a, b) a ## b\n#define Full(a, b) Paste(a, b)\n\
        #define fmi2Instantiate Full(FMI2_FUNCTION_PREFIX, fmi2Instantiate)\n";
    let files = [
        ("modelDescription.xml", XML_2),
        ("sources/a.c", SOURCE_2),
        ("sources/fmi2Functions.h", old),
    ];
    compiled(folder.path(), &files).unwrap();
}

#[test]
fn sets_have_their_own_languages_definitions_and_folders() {
    let other = "#include \"deep.h\"\n#if !defined(LEVEL) || defined(FLAG) || FIRST != 1\n#error\n#endif\n\
        _Static_assert(sizeof TEXT == 6, \"C11\");\nconst char *text(void) { return TEXT; }\n";
    let sets = set("language='C99' compiler='gcc' compilerOptions='-O1 -fno-strict-aliasing'", "")
        + r#"<SourceFileSet language="C11"><SourceFile name="b/b.c"/>
            <PreprocessorDefinition name="FIRST"/>
            <PreprocessorDefinition name="TEXT" value="&quot;a b's&quot;"/>
            <PreprocessorDefinition name="FLAG" optional="true"/>
            <PreprocessorDefinition name="LEVEL" optional="true" value="0"><Option value="0"/></PreprocessorDefinition>
            <IncludeDirectory name="include/deep"/></SourceFileSet>
            <Library name="m" external="true"/>"#;
    let others = [("sources/b/b.c", other), ("sources/include/deep/deep.h", "")];
    let compiled = configured(&sets, &others).unwrap();
    assert!(compiled.log.contains("-fno-strict-aliasing"), "{}", compiled.log);
}

#[test]
fn cpp_is_compiled_by_its_compiler_which_is_named_if_it_is_missing() {
    let cpp = "extern \"C\" const char *text() { auto t = \"C++11\"; return t; }\n";
    let set = set("language='C99'", "")
        + r#"<SourceFileSet language="C++11"><SourceFile name="b.c"/></SourceFileSet>"#;
    match configured(&set, &[("sources/b.c", cpp)]) {
        Ok(compiled) => assert!(compiled.log.contains("++"), "{}", compiled.log),
        Err(error) => assert!(error.to_string().contains("c++, g++"), "{error}"),
    }
}

#[test]
fn options_for_other_compilers_are_left_out_with_a_note() {
    for (compiler, expected) in [("VisualC", "are for Visual C"), ("icx", "compiler \"icx\"")] {
        let attributes = format!("language='C99' compiler='{compiler}' compilerOptions='/Od'");
        let notes = configured(&set(&attributes, ""), &[]).unwrap().notes;
        assert!(notes.len() == 1 && notes[0].contains(expected), "{notes:?}");
    }
}

#[test]
fn each_model_identifier_has_its_own_library() {
    let folder = folder();
    let xml = r#"<fmiModelDescription fmiVersion="2.0">
        <ModelExchange modelIdentifier="B"><SourceFiles><File name="b.c"/></SourceFiles></ModelExchange>
        <CoSimulation modelIdentifier="A"><SourceFiles><File name="a.h"/><File name="a.c"/></SourceFiles></CoSimulation>
        </fmiModelDescription>"#;
    let files = [
        ("modelDescription.xml", xml),
        ("sources/a.c", SOURCE_2),
        ("sources/a.h", ""),
        ("sources/b.c", "#include \"a.c\"\n"),
    ];
    let libraries = compiled(folder.path(), &files).unwrap().libraries;
    let names = libraries.iter().map(|library| library.identifier.as_str());
    assert_eq!(Vec::from_iter(names), ["A", "B"]);
}

#[test]
fn without_a_list_all_sources_are_compiled_or_the_one_that_includes_them() {
    let xml = r#"<fmiModelDescription fmiVersion="2.0"><CoSimulation modelIdentifier="A"/></fmiModelDescription>"#;
    let files = [("modelDescription.xml", xml), ("sources/a.c", SOURCE_2)];
    let all = [&files[..], &[("sources/all.c", "#include \"a.c\"\n")]].concat();
    for files in [&files[..], &all] {
        let folder = folder();
        let notes = compiled(folder.path(), files).unwrap().notes;
        assert!(notes[0].starts_with("it lists no source files"), "{notes:?}");
    }
}

#[test]
fn the_configuration_for_this_platform_is_chosen() {
    let here = if cfg!(windows) {
        "windows"
    } else if cfg!(target_os = "macos") {
        "darwin"
    } else {
        "linux"
    };
    let here = format!("{}-{here}", std::env::consts::ARCH);
    let of = |platform: &str, source: &str| {
        format!(
            "<BuildConfiguration modelIdentifier='A' {platform}><SourceFileSet><SourceFile name='{source}'/></SourceFileSet></BuildConfiguration>"
        )
    };
    let try_all = |configurations: &[String]| {
        let folder = folder();
        let text =
            format!("<fmiBuildDescription>{}</fmiBuildDescription>", configurations.concat());
        let files = [("modelDescription.xml", XML_3), ("sources/a.c", SOURCE_3), (BUILD, &text)];
        compiled(folder.path(), &files)
    };
    let (own, other) =
        (of(&format!("platform='{here}'"), "a.c"), of("platform='riscv64-linux'", "no.c"));
    try_all(&[other.clone(), of("", "no.c"), own]).unwrap();
    try_all(&[other.clone(), of("", "a.c")]).unwrap();
    let error = try_all(&[other]).unwrap_err().to_string();
    assert!(error.contains(&here) && error.contains("riscv64-linux"), "{error}");
    let error = try_all(&[]).unwrap_err().to_string();
    assert!(error.contains("no BuildConfiguration for the modelIdentifier \"A\""), "{error}");
}

#[test]
fn a_compile_error_has_the_file_the_command_and_the_message() {
    let error = refused(
        &format!("<SourceFileSet>{A}<SourceFile name='bad.c'/></SourceFileSet>"),
        &[("sources/bad.c", "int a = b;\n")],
    );
    assert!(error.starts_with("sources/bad.c cannot be compiled: "), "{error}");
    let (command, message) = error.split_once('\n').unwrap();
    assert!(command.ends_with(" sources/bad.c"), "{error}");
    assert!(message.contains("bad.c:1") && message.contains("error"), "{error}");
    let many = "int a = b;\n".repeat(1000);
    let error = refused(
        &format!("<SourceFileSet>{A}<SourceFile name='bad.c'/></SourceFileSet>"),
        &[("sources/bad.c", &many)],
    );
    assert!(error.lines().count() < 30, "{error}");
}

#[test]
fn what_the_fmu_lacks_is_named() {
    assert_eq!(
        refused("<SourceFileSet><SourceFile name='b.c'/></SourceFileSet>", &[]),
        "the source file \"sources/b.c\" is missing"
    );
    let error = refused(&(set("", "") + "<Library name='solver'/>"), &[]);
    assert!(
        error.starts_with("the library \"binaries/") && error.ends_with("/solver\" is missing"),
        "{error}"
    );
    let error = refused(
        "<SourceFileSet><SourceFile name='b.c'/></SourceFileSet>",
        &[("sources/b.c", "int b;\n")],
    );
    assert!(error.contains("do not define fmi3InstantiateCoSimulation"), "{error}");
    let error = refused(
        "<SourceFileSet><SourceFile name='b.c'/></SourceFileSet>",
        &[("sources/b.c", "void A_fmi3InstantiateCoSimulation(void) {}\n")],
    );
    assert!(error.contains("define A_fmi3InstantiateCoSimulation instead"), "{error}");
    assert!(refused("", &[]).contains("has no SourceFile"));
    let folder = folder();
    let files = [("modelDescription.xml", XML_3)];
    assert_eq!(
        compiled(folder.path(), &files).unwrap_err().to_string(),
        "it has no sources to compile"
    );
    let files = [("modelDescription.xml", XML_3), ("sources/a.c", SOURCE_3)];
    let error = compiled(folder.path(), &files).unwrap_err().to_string();
    assert!(error.contains("it has no sources/buildDescription.xml"), "{error}");
    let files = [("modelDescription.xml", XML_3), ("sources/a.c", SOURCE_3), (BUILD, "<a")];
    let error = compiled(folder.path(), &files).unwrap_err().to_string();
    assert!(error.starts_with("sources/buildDescription.xml cannot be read"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_function_that_nothing_defines_is_an_error_of_the_linker() {
    let source = SOURCE_3.replace("return 0;", "extern void nowhere(void); nowhere(); return 0;");
    let error = refused(
        "<SourceFileSet><SourceFile name='b.c'/></SourceFileSet>",
        &[("sources/b.c", &source)],
    );
    assert!(error.contains("A.so cannot be linked") && error.contains("nowhere"), "{error}");
}

#[test]
fn other_languages_are_refused_by_name() {
    for language in ["Fortran90", "Ada", "Rust", "C#", "C42", "Objective-C"] {
        let error = refused(&set(&format!("language='{language}'"), ""), &[]);
        assert!(error.contains(&format!("have the language \"{language}\"")), "{error}");
    }
    let error = refused(
        "<SourceFileSet><SourceFile name='b.f90'/></SourceFileSet>",
        &[("sources/b.f90", "")],
    );
    assert!(error.contains("have the file \"b.f90\""), "{error}");
}

#[test]
fn a_hostile_description_reaches_nothing_outside_of_the_fmu() {
    for path in ["../b.c", "/etc/passwd", "C:/b.c", "a/../../b.c", r"..\b.c"] {
        for element in ["SourceFile", "IncludeDirectory"] {
            let error = refused(&set("", &format!("<{element} name='{path}'/>")), &[]);
            assert!(
                error.contains(&path.replace('\\', r"\\")) && error.contains("expected"),
                "{error}"
            );
        }
    }
    for options in [
        "-o /tmp/x",
        "@/tmp/x",
        "-fplugin=x.so",
        "-wrapper sh,-c",
        "-B.",
        "-I/usr/include",
        "-I ../..",
    ] {
        refused(&set(&format!("compilerOptions='{options}'"), ""), &[]);
    }
    for name in ["", "A=1", "-o", "A B", "1A"] {
        let error = refused(&set("", &format!("<PreprocessorDefinition name='{name}'/>")), &[]);
        assert!(error.contains("is not a name in C"), "{error}");
    }
    for name in ["", "-o", "/tmp/x.a", "a b", "../x", "m,-plugin"] {
        for external in ["", "external='true'"] {
            let error =
                refused(&(set("", "") + &format!("<Library name='{name}' {external}/>")), &[]);
            assert!(error.contains("is not the name of a library"), "{error}");
        }
    }
    let folder = folder();
    for identifier in ["../A", "a/b", "", "/A"] {
        let xml = XML_2.replace(r#""A""#, &format!("{identifier:?}"));
        let error =
            compiled(folder.path(), &[("modelDescription.xml", &xml), ("sources/a.c", SOURCE_2)]);
        let error = error.unwrap_err().to_string();
        assert!(error.contains("expected the name of a file"), "{error}");
    }
}

#[test]
fn a_compiler_that_does_not_end_is_stopped() {
    let folder = folder();
    // Each macro is twice as long as the one before it.
    let twice = |n| format!("#define M{} M{n} M{n}\n", n + 1);
    let endless = (0..60).map(twice).collect::<String>() + "int a = M60;\n";
    let fmu = folder.path().join("A.fmu");
    let files = [("modelDescription.xml", XML_2), ("sources/a.c", &*endless)];
    let packed = files.map(|(name, text)| (name, Packed::text(text.as_bytes()).unwrap()));
    archive::write(&fmu, &packed.each_ref().map(|(name, file)| (*name, file))).unwrap();
    let begin = Instant::now();
    let cancelled = CompileControl {
        is_cancelled: &|| begin.elapsed() > Duration::from_millis(100),
        ..CompileControl::default()
    };
    let error = compile(&fmu, folder.path(), &cancelled).unwrap_err();
    assert!(matches!(error, CompileError::Cancelled), "{error}");
    let limited =
        CompileControl { time_limit: Duration::from_millis(100), ..CompileControl::default() };
    let error = compile(&fmu, folder.path(), &limited).unwrap_err();
    assert!(matches!(error, CompileError::TimedOut(_)), "{error}");
}

#[test]
fn only_the_library_is_added() {
    let folder = folder();
    let files = [
        ("modelDescription.xml", XML_2),
        ("binaries/other/A.so", "other"),
        ("sources/a.c", SOURCE_2),
        ("resources/r.txt", "r"),
    ];
    let libraries = compiled(folder.path(), &files).unwrap().libraries;
    let (fmu, out) = (folder.path().join("A.fmu"), folder.path().join("B.fmu"));
    write_with(&fmu, &libraries, &out).unwrap();
    write_with(&out, &libraries, &out).unwrap();
    let mut archive = Archive::open_sound(&out).unwrap();
    let mut expected = Vec::from_iter(files.map(|(name, _)| name.to_owned()));
    expected.insert(1, libraries[0].binary.clone());
    assert_eq!(archive.names, expected);
    for (name, text) in files {
        let index = archive.names.iter().position(|other| other == name).unwrap();
        assert_eq!(archive.content(index).unwrap(), text.as_bytes());
    }
    assert_eq!(archive.content(1).unwrap(), fs::read(&libraries[0].file).unwrap());
    assert_eq!(fmu_compile::binaries(&out).unwrap(), [libraries[0].binary.clone()]);
}
