//! The translation of a model to C: compiler options, the memory of an instance, and the files.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use fmu_description::{FmiVersion, erase_interfaces, read_interfaces};

use super::interface::{self, Interface};
use super::needs::{needs_function, stack_of_all_functions};
use super::{BuildLibrary, Memory, Sources, build_description, untranslatable};
use crate::library::{NamedFile, read};
use crate::model::BuiltModel;

/// The bytes of stack that an instance has at least.
const STACK: u64 = 32 << 10;
/// What functions that call each other in a circle may need besides.
const STACK_FOR_CIRCLES: u64 = 4 << 10;
/// How much of the heap a model may need for a byte of a resource: as a text, and as what the model makes of it.
const HEAP_FOR_RESOURCES: u64 = 3;

/// Makes the sources of a model. `build` builds the library with arguments for the compiler and a size of the heap, to
/// which `heap` is added; `scratch` is a folder for files of the build.
///
/// # Errors
/// The build fails, or the model needs what C sources do not have.
pub fn build(
    model: &BuiltModel<'_>,
    mut heap: u64,
    scratch: &Path,
    build: &BuildLibrary<'_>,
) -> Result<Sources> {
    let module = build_every_call(scratch, &|compiler_args| build(compiler_args, heap))?;
    untranslatable::check(&module)?;
    let resources = match needs_function(&module, "read_resource")? {
        true => Some(read(&model.library.folder.join("resources"))?),
        false => None,
    };
    let sizes = resources.iter().flatten().map(|(_, content)| content.len() as u64);
    heap += HEAP_FOR_RESOURCES * sizes.sum::<u64>();
    let resources = resources.as_deref();
    let with_stack = |stack| {
        let stack = format!("-Clink-arg=-zstack-size={stack}");
        build(&["-Cstrip=debuginfo".to_owned(), stack], heap)
    };
    let module = with_stack(STACK)?;
    let needed = stack_of_all_functions(&module)? + STACK_FOR_CIRCLES;
    match needed <= STACK {
        true => translate(model, &module, STACK, resources),
        false => {
            let stack = needed.next_multiple_of(1 << 10);
            translate(model, &with_stack(stack)?, stack, resources)
        }
    }
}

/// Builds a library in which every call can be seen, also those of libraries that WebAssembly does not have.
fn build_every_call(
    scratch: &Path,
    build: &dyn Fn(&[String]) -> Result<Vec<u8>>,
) -> Result<Vec<u8>> {
    let mut compiler_args = untranslatable::EVERY_CALL.map(str::to_owned).to_vec();
    let error = match build(&compiler_args) {
        Ok(module) => return Ok(module),
        Err(error) => untranslatable::explain(error),
    };
    fs::create_dir_all(scratch)
        .with_context(|| format!("cannot create the folder {}", scratch.display()))?;
    if !untranslatable::stand_in_for_libraries(&error, scratch)? {
        return Err(error);
    }
    compiler_args.push(format!("-Lnative={}", scratch.display()));
    build(&compiler_args)
}

/// Translates a model. The module is its library, with this number of bytes for the stack. The resources are those
/// of a model that reads them.
///
/// # Errors
/// The module does not have the model, or cannot be translated.
fn translate(
    model: &BuiltModel<'_>,
    module: &[u8],
    stack: u64,
    resources: Option<&[NamedFile]>,
) -> Result<Sources> {
    let (name, version) = (model.name(), model.version);
    ensure!(
        read_interfaces(module)?.iter().any(|found| found.guid == model.description.guid),
        "the module does not contain the model {name}"
    );
    let mut module = module.to_vec();
    erase_interfaces(&mut module)?;
    let description = match model.description.description.as_str() {
        "" => name.to_owned(),
        about => format!("{name}: {about}"),
    };
    // Both versions of an FMU may be in one program.
    let prefix = match version {
        FmiVersion::Fmi2 => format!("{name}_model2_"),
        FmiVersion::Fmi3 => format!("{name}_model3_"),
    };
    let translated = wasm_to_c::translate(&module, &wasm_to_c::Options { prefix, description });
    let translated = translated.context("the library cannot be translated to C")?;
    let imports = Vec::from_iter(translated.imports.iter().map(|(_, import)| import.as_str()));
    let functions = Interface {
        version,
        identifier: name,
        interface_types: &model.description.interface_types,
        has_clocks: model.description.has_clocks(),
        is_scheduled: model.description.is_for_scheduled_execution(),
        is_serialized: !model.description.is_unserialized,
        imports: &imports,
    };
    let compiled = vec!["model.c".to_owned(), functions.file_name().to_owned()];
    let uses_math = translated.source.contains("#include <math.h>");
    let memory = Memory { total: translated.memory_size, stack };
    let texts = [
        ("sources/buildDescription.xml", build_description::document(name, &compiled, uses_math)?),
        (&*format!("sources/{}", functions.file_name()), functions.text()),
        ("sources/model.c", translated.source),
        ("sources/model.h", translated.header),
        ("documentation/staticLinking.txt", static_linking(model, &compiled, uses_math, memory)),
    ];
    let files = texts.map(|(path, text)| (path.to_owned(), text.into_bytes()));
    let resources = resources.map(|files| interface::resources(files).into_bytes());
    let resources = resources.map(|text| ("sources/resources.h".to_owned(), text));
    Ok(Sources { compiled, files: files.into_iter().chain(resources).collect(), memory })
}

/// The text about compiling and linking.
fn static_linking(
    model: &BuiltModel<'_>,
    compiled: &[String],
    uses_math: bool,
    Memory { total, stack }: Memory,
) -> String {
    let version = model.version;
    let of_version = |fmi2, fmi3| if version == FmiVersion::Fmi2 { fmi2 } else { fmi3 };
    let function = |operation| version.function(operation).unwrap_or_default();
    let math = match uses_math {
        true => "Link with the mathematical functions of C, -lm, where they\nhave a library.",
        false => "The mathematical functions of C are not needed.",
    };
    let replacements = [
        ("@MODEL@", model.name()),
        ("@VERSION@", version.as_str()),
        ("@FILES@", &compiled.join(" ")),
        ("@INTERFACE@", &compiled[compiled.len() - 1]),
        ("@MATH@", math),
        ("@FUNCTION@", function("do_step")),
        ("@GET_STATE@", function("get_fmu_state")),
        ("@FMI@", of_version("FMI2", "FMI3")),
        ("@FMIX@", of_version("fmi2", "fmi3")),
        (
            "@ALLOCATION@",
            of_version(
                "comes from the\nallocateMemory of the host, or else from malloc",
                "comes from malloc",
            ),
        ),
        ("@MEMORY@", &total.to_string()),
        ("@STACK@", &stack.to_string()),
        ("@DATA@", &(total - stack).to_string()),
    ];
    let fill = |text: String, (open, value): (&str, &str)| text.replace(open, value);
    replacements.into_iter().fold(include_str!("static_linking.txt").to_owned(), fill)
}
