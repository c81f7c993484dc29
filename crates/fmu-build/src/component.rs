//! Turns a module of WebAssembly into a component with the interface of the draft FMI-LS-WASM.

use anyhow::{Context, Result};
use fmu_description::Description;
use wit_component::{ComponentEncoder, StringEncoding, embed_component_metadata};
use wit_parser::{Resolve, TypeDefKind, WorldId, WorldItem};

/// The interface; a test holds it against hosts of others.
const INTERFACE: &str = include_str!("component.wit");

/// Encodes the module of a library: for co-simulation, and for model exchange if one of its models is.
///
/// # Errors
/// The module does not have the functions of the interface.
pub fn encode(module: &[u8], models: &[Description]) -> Result<Vec<u8>> {
    let mut resolve = Resolve::default();
    let package = resolve.push_str("component.wit", INTERFACE)?;
    let world = match models.iter().any(Description::is_for_model_exchange) {
        true => "fmu",
        false => "co-simulation-fmu",
    };
    let world = resolve.select_world(&[package], Some(world))?;
    let mut module =
        with_names(module, &names(&resolve, world)).context("cannot name its functions")?;
    embed_component_metadata(&mut module, &resolve, world, StringEncoding::UTF8, false)?;
    ComponentEncoder::default().module(&module)?.validate(true).encode()
}

/// The functions of a world: the name of each operation, and its name as an export.
fn names(resolve: &Resolve, world: WorldId) -> Vec<(String, String)> {
    let mut names = Vec::new();
    for (key, item) in &resolve.worlds[world].exports {
        let WorldItem::Interface { id, .. } = item else {
            continue;
        };
        let (interface, prefix) = (&resolve.interfaces[*id], resolve.name_world_key(key));
        for name in interface.functions.keys() {
            let operation = name.rsplit('.').next().unwrap_or(name).replace('-', "_");
            names.push((operation, format!("{prefix}#{name}")));
        }
        for (name, id) in &interface.types {
            if matches!(resolve.types[*id].kind, TypeDefKind::Resource) {
                names.push(("free_instance".to_owned(), format!("{prefix}#[dtor]{name}")));
            }
        }
    }
    names
}

/// The module with its functions exported under other names.
fn with_names(module: &[u8], names: &[(String, String)]) -> Result<Vec<u8>> {
    use wasm_encoder::{ExportSection, Module, RawSection};
    use wasmparser::{Parser, Payload};

    let mut renamed = Module::new();
    for payload in Parser::new(0).parse_all(module) {
        let payload = payload?;
        if let Payload::ExportSection(exports) = &payload {
            let mut section = ExportSection::new();
            for export in exports.clone() {
                let export = export?;
                let own = (export.name.to_owned(), export.name.to_owned());
                let is_kept = matches!(export.name, "memory" | "cabi_realloc");
                let all = names.iter().filter(|(operation, _)| operation == export.name);
                for (_, name) in all.chain(is_kept.then_some(&own)) {
                    section.export(name, export.kind.into(), export.index);
                }
            }
            renamed.section(&section);
        } else if let Some((id, range)) = payload.as_section() {
            renamed.section(&RawSection {
                id,
                data: &module[range.start as usize..range.end as usize],
            });
        }
    }
    Ok(renamed.finish())
}
