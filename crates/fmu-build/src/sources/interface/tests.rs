//! Tests of the interface: its text, and its functions with a stand-in for a model.

use std::fs;
use std::path::Path;
use std::process::Command;

use tempfile::TempDir;

use super::*;

/// The headers of the standard.
const HEADERS: &str = concat!("-I", env!("CARGO_MANIFEST_DIR"), "/../fmu-compile/src/headers");

fn interface(version: FmiVersion, interface_types: &[InterfaceType]) -> Interface<'_> {
    Interface {
        version,
        identifier: "Pid",
        interface_types,
        has_clocks: false,
        is_scheduled: false,
        is_serialized: true,
        imports: &["log", "intermediate_update", "resource_size", "read_resource"],
    }
}

#[test]
fn every_row_is_a_function() {
    for version in FmiVersion::ALL {
        let all = interface(version, &[]).text();
        let some = [InterfaceType::CoSimulation, InterfaceType::ModelExchange];
        let some = some.map(|only| interface(version, &[only]).text());
        for Signature { function, .. } in version.signatures() {
            let definition = format!(" {}(", function.name);
            let is_defined = |text: &str| {
                text.contains(&definition) || text.contains(&definition.replace(' ', " *"))
            };
            assert!(is_defined(&all), "{}", function.name);
            let groups = [FunctionGroup::ModelExchange, FunctionGroup::CoSimulation];
            let is_there = groups.map(|left_out| function.group != left_out);
            let found = some.each_ref().map(|text| is_defined(text));
            assert_eq!(found, is_there, "{}", function.name);
        }
    }
}

/// A function of the model that the interface calls: its declaration without a semicolon.
fn declarations(version: FmiVersion) -> Vec<String> {
    let declared = version.signatures().iter().filter(|signature| signature.has_instance);
    let rows = declared.map(|Signature { function, arguments, .. }| {
        let types = arguments.iter().map(|argument| match argument.kind {
            ArgumentKind::Value("f64") => ", double",
            _ => ", uint32_t",
        });
        let types: String = types.collect();
        format!("uint32_t MODEL({})(Model *m, uint32_t{types})", function.name)
    });
    let others = [
        ("uint32_t MODEL(fmu_arguments)", 1),
        ("uint32_t MODEL(fmu_count_elements)", 3),
        ("uint32_t MODEL(fmu_instantiate)", 10),
        ("void MODEL(fmu_free)", 1),
    ];
    let others = others.map(|(head, n)| format!("{head}(Model *m{})", ", uint32_t".repeat(n)));
    rows.chain(others).collect()
}

/// The header of a translated model.
fn header(version: FmiVersion, prefix: &str) -> String {
    let imports = [
        ("void MODEL(import_log)(Model *m", 3),
        ("uint32_t MODEL(import_resource_size)(Model *m", 2),
        ("uint32_t MODEL(import_read_resource)(Model *m", 4),
        ("uint32_t MODEL(import_intermediate_update)(Model *m, double", 5),
        ("void MODEL(import_clock_update)(Model *m", 0),
    ];
    let imports = imports.map(|(head, n)| format!("{head}{});\n", ", uint32_t".repeat(n)));
    let exports: String =
        declarations(version).iter().map(|declaration| format!("{declaration};\n")).collect();
    include_str!("../../../../wasm-to-c/src/model.h")
        .replace("@PREFIX@", prefix)
        .replace("@MEMORY_SIZE@", "16384")
        .replace("@GLOBALS@", "")
        .replace("@IMPORTS@", &imports.concat())
        .replace("@EXPORTS@", &exports)
}

/// Runs the C compiler, which must have no warnings.
fn compile(folder: &Path, arguments: &[&str]) {
    let mut command = Command::new("cc");
    command.args(["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]).args(arguments);
    let done = command.current_dir(folder).output().unwrap();
    assert!(done.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&done.stderr));
}

#[test]
fn a_compiler_has_no_warnings_and_the_functions_are_those_of_the_standard() {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, text: String| fs::write(folder.path().join(name), text).unwrap();
    write("resources.h", resources(&[("a \"b\".txt".into(), b"x".into()), ("c".into(), vec![])]));
    for version in FmiVersion::ALL {
        write("model.h", header(version, "Pid_model_"));
        for interface_types in
            [&[][..], &[InterfaceType::CoSimulation], &[InterfaceType::ModelExchange]]
        {
            let interface = interface(version, interface_types);
            let file = interface.file_name();
            let mut texts = vec![interface.text()];
            if version == FmiVersion::Fmi3 {
                let imports = &["log", "clock_update"];
                texts.push(
                    Interface { has_clocks: true, is_scheduled: true, imports, ..interface }.text(),
                );
            }
            for text in texts {
                write(file, text);
                let options = ["-DFMU_STATIC_INSTANCES=2", "-DFMU_NO_FILES", HEADERS];
                for more in [&[][..], &options[..1], &options[1..2], &options[2..], &options] {
                    compile(folder.path(), &[&["-fsyntax-only", file], more].concat());
                }
            }
        }
    }
}

#[test]
fn a_host_calls_the_functions_of_two_fmus() {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let model = include_str!("../c/test/model.c");
    let others = declarations(FmiVersion::Fmi3).into_iter();
    let others = others
        .filter(|declaration| !model.contains(&declaration[..declaration.find(")(").unwrap()]));
    let others = others.map(|declaration| {
        let mut names = 0;
        let parts = declaration.split(", ").map(|part| match part.contains("Model *m") {
            true => part.to_owned(),
            false => {
                names += 1;
                let (of, end) = part.split_at(part.len() - usize::from(part.ends_with(')')));
                format!("{of} a{names}{end}")
            }
        });
        let head = parts.collect::<Vec<_>>().join(", ");
        let unused: String = (1..=names).map(|i| format!("(void)a{i}; ")).collect();
        format!("{head} {{ (void)m; {unused}return 3; }}\n")
    });
    write("model.c", &(model.to_owned() + &others.collect::<String>()));
    write("fmi3.c", &interface(FmiVersion::Fmi3, &[]).text());
    write("host.c", include_str!("../c/test/host.c"));
    for (options, argument) in [(&[][..], "heap"), (&["-DFMU_STATIC_INSTANCES=2"], "static")] {
        for name in ["first", "second"] {
            write("model.h", &header(FmiVersion::Fmi3, &format!("{name}_model_")));
            let prefix = format!("-DFMI3_FUNCTION_PREFIX={name}_");
            for file in ["model.c", "fmi3.c"] {
                let object = format!("{name}_{file}.o");
                let mut arguments = vec!["-g", "-c", file, "-o", &object, &prefix];
                arguments.extend(options);
                compile(folder.path(), &arguments);
            }
        }
        let objects = ["first", "second"]
            .map(|name| [format!("{name}_model.c.o"), format!("{name}_fmi3.c.o")]);
        let objects = objects.as_flattened().iter().map(String::as_str);
        let arguments = ["-g", HEADERS, "-Wno-strict-prototypes", "host.c", "-o", "host"];
        compile(folder.path(), &arguments.into_iter().chain(objects).collect::<Vec<_>>());
        let done = Command::new(folder.path().join("host")).arg(argument).output().unwrap();
        assert!(done.status.success(), "{argument}: {}", String::from_utf8_lossy(&done.stderr));
    }
}
