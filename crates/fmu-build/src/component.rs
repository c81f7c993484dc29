//! Turns a module of WebAssembly into a component with the interface of the draft FMI-LS-WASM.

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::ops::Range;

use anyhow::{Context, Result, ensure};
use fmu_description::{ExportedModel, erase_interfaces};
use wasm_encoder::reencode::{Error, Reencode, ReencodeComponent, component_utils, utils};
use wasm_encoder::{
    Alias, Component, ComponentAliasSection, ComponentImportSection, ComponentInstanceSection,
    ConstExpr, DataSection, ExportSection, Module,
};
use wasmparser::{
    ComponentAliasSectionReader, ComponentImportSectionReader, ComponentInstance,
    CustomSectionReader, Data, DataKind, Operator, Parser, Validator,
};
use wit_component::{ComponentEncoder, StringEncoding, embed_component_metadata};
use wit_parser::{Resolve, TypeDefKind, WorldId, WorldItem};

use crate::toolchain::WasmDraft;

/// The interface; a test runs it in other vendors' hosts.
const INTERFACE: &str = include_str!("component.wit");
/// What an instance gets at [`WasmDraft::WithPath`] alone.
const PATH: &str = " resource-path: string,";
/// Suffix of the exports of a library that take no `resource-path`.
const WITHOUT_PATH: &str = "_without_path";
/// What a library imports that reads resources, which [`WasmDraft::WithPath`] does not have.
const READS: &str = "fmi:fmi3/resource-dir-callbacks@3.0.0";
/// Prefix of the names that the encoder gives to the imports of nested components.
const INNER: &str = "import-";

/// Encodes the module of a library: for the interface types of its models.
///
/// # Errors
/// The module does not have the functions of the interface, or reads resources, which the draft does not provide.
pub fn encode(mut module: Vec<u8>, models: &[ExportedModel], draft: WasmDraft) -> Result<Vec<u8>> {
    let mut resolve = Resolve::default();
    let interface = match draft {
        WasmDraft::WithPath => {
            ensure!(
                !module.windows(READS.len()).any(|name| name == READS.as_bytes()),
                "a model reads a resource, for which commit c1aac17 of the draft has no function; export it with `--wasm-draft 77277f4`"
            );
            INTERFACE.to_owned()
        }
        WasmDraft::WithFunction => INTERFACE.replace(PATH, ""),
    };
    let package = resolve.push_str("component.wit", &interface)?;
    let is_for_model_exchange = models.iter().any(ExportedModel::is_for_model_exchange);
    let is_for_co_simulation = models.iter().any(ExportedModel::is_for_co_simulation);
    let is_scheduled = models.iter().any(ExportedModel::is_for_scheduled_execution);
    let world = match (is_for_co_simulation, is_for_model_exchange, is_scheduled) {
        (false, false, true) => "scheduled-execution-fmu",
        (_, _, true) => "complete-fmu",
        (true, true, _) => "fmu",
        (false, true, _) => "model-exchange-fmu",
        (_, false, _) => "co-simulation-fmu",
    };
    let world = resolve.select_world(package, Some(world))?;
    let names = names(&resolve, world);
    erase_interfaces(&mut module)?;
    let mut named = Module::new();
    Named { names: &names, draft }
        .parse_core_module(&mut named, Parser::new(0), &module)
        .context("cannot name its functions")?;
    let mut module = named.finish();
    embed_component_metadata(&mut module, &resolve, world, StringEncoding::UTF8)?;
    let encoded = ComponentEncoder::default().module(&module)?.encode()?;
    let mut short = Component::new();
    Short { names: &names, exported: BTreeSet::new(), inner: BTreeMap::new() }
        .parse_component(&mut short, Parser::new(0), &encoded)
        .context("cannot shorten its names")?;
    let component = short.finish();
    Validator::new().validate_all(&component)?;
    Ok(component)
}

/// The functions of a world: their names as exports, and the operation that each performs.
fn names(resolve: &Resolve, world: WorldId) -> BTreeMap<String, String> {
    let mut names = BTreeMap::new();
    for (key, item) in &resolve.worlds[world].exports {
        let WorldItem::Interface { id, .. } = item else {
            continue;
        };
        let (interface, prefix) = (&resolve.interfaces[*id], resolve.name_world_key(key));
        for name in interface.functions.keys() {
            let operation = name.rsplit('.').next().unwrap_or(name).replace('-', "_");
            names.insert(format!("{prefix}#{name}"), operation);
        }
        for (name, id) in &interface.types {
            if matches!(resolve.types[*id].kind, TypeDefKind::Resource) {
                names.insert(format!("{prefix}#[dtor]{name}"), "free_instance".to_owned());
            }
        }
    }
    names
}

/// Exports the functions of a module under their names in the interfaces, as the encoder expects them, and leaves
/// out zeros, which memory has from the start.
struct Named<'a> {
    names: &'a BTreeMap<String, String>,
    draft: WasmDraft,
}

impl Reencode for Named<'_> {
    type Error = Infallible;

    fn parse_export(
        &mut self,
        exports: &mut ExportSection,
        export: wasmparser::Export<'_>,
    ) -> Result<(), Error> {
        let is_kept = matches!(
            export.name,
            "memory" | "cabi_realloc" | "fmu_export_arguments" | "fmu_export_cycle"
        );
        let performs = |operation: &str| match self.draft {
            WasmDraft::WithFunction if operation.starts_with("instantiate_") => {
                export.name.strip_suffix(WITHOUT_PATH) == Some(operation)
            }
            _ => export.name == operation,
        };
        let all = self.names.iter().filter(|(_, operation)| performs(operation));
        let names = all.map(|(name, _)| name.as_str()).chain(is_kept.then_some(export.name));
        for name in names {
            exports.export(name, export.kind.into(), export.index);
        }
        Ok(())
    }

    fn parse_data(&mut self, section: &mut DataSection, data: Data<'_>) -> Result<(), Error> {
        if let DataKind::Active { memory_index, offset_expr } = &data.kind
            && let Operator::I32Const { value } = offset_expr.get_operators_reader().read()?
        {
            for part in parts(data.data) {
                let offset = ConstExpr::i32_const(value.wrapping_add_unsigned(part.start as u32));
                section.active(*memory_index, &offset, data.data[part].iter().copied());
            }
            return Ok(());
        }
        utils::parse_data(self, section, data)
    }
}

/// The parts of data between long runs of zeros.
fn parts(data: &[u8]) -> Vec<Range<usize>> {
    // The bytes that another part costs.
    const LONG: usize = 10;
    let mut parts: Vec<Range<usize>> = Vec::new();
    let mut end = 0;
    for run in data.chunk_by(|a, b| (*a == 0) == (*b == 0)) {
        let start = end;
        end += run.len();
        match parts.last_mut() {
            _ if run[0] == 0 => {}
            Some(last) if start - last.end < LONG => last.end = end,
            _ => parts.push(start..end),
        }
    }
    parts
}

/// Gives the functions inside a component short names, which no host sees, and drops what only debuggers
/// read.
struct Short<'a> {
    names: &'a BTreeMap<String, String>,
    exported: BTreeSet<&'a str>,
    /// What components inside the component import.
    inner: BTreeMap<String, usize>,
}

impl Reencode for Short<'_> {
    type Error = Infallible;

    fn parse_export(
        &mut self,
        exports: &mut ExportSection,
        export: wasmparser::Export<'_>,
    ) -> Result<(), Error> {
        match self.names.get(export.name) {
            // Both interfaces share most operations.
            Some(operation) if self.exported.insert(operation) => {
                exports.export(operation, export.kind.into(), export.index);
                Ok(())
            }
            Some(_) => Ok(()),
            None => utils::parse_export(self, exports, export),
        }
    }

    fn parse_custom_section(
        &mut self,
        _: &mut Module,
        _: CustomSectionReader<'_>,
    ) -> Result<(), Error> {
        Ok(())
    }
}

impl Short<'_> {
    /// A short name for an import of a component inside the component.
    fn inner(&mut self, name: &str) -> String {
        let next = self.inner.len();
        format!("i{}", self.inner.entry(name.to_owned()).or_insert(next))
    }
}

impl ReencodeComponent for Short<'_> {
    fn parse_component_alias_section(
        &mut self,
        aliases: &mut ComponentAliasSection,
        section: ComponentAliasSectionReader<'_>,
    ) -> Result<(), Error> {
        for alias in section {
            let alias = match self.component_alias(alias?)? {
                Alias::CoreInstanceExport { instance, kind, name } => {
                    let name = self.names.get(name).map_or(name, String::as_str);
                    Alias::CoreInstanceExport { instance, kind, name }
                }
                alias => alias,
            };
            aliases.alias(alias);
        }
        Ok(())
    }

    fn parse_component_import_section(
        &mut self,
        imports: &mut ComponentImportSection,
        section: ComponentImportSectionReader<'_>,
    ) -> Result<(), Error> {
        for import in section {
            let import = import?;
            let kind = self.component_type_ref(import.ty)?;
            match import.name.0.strip_prefix(INNER) {
                Some(name) => imports.import(&self.inner(name), kind),
                None => imports.import(import.name.0, kind),
            };
        }
        Ok(())
    }

    fn parse_component_instance(
        &mut self,
        instances: &mut ComponentInstanceSection,
        instance: ComponentInstance<'_>,
    ) -> Result<(), Error> {
        let ComponentInstance::Instantiate { component_index, args } = instance else {
            return component_utils::parse_component_instance(self, instances, instance);
        };
        let args = args.iter().map(|arg| {
            let name = arg.name.strip_prefix(INNER).map(|name| self.inner(name));
            (name.unwrap_or_else(|| arg.name.to_owned()), arg.kind.into(), arg.index)
        });
        instances.instantiate(component_index, args.collect::<Vec<_>>());
        Ok(())
    }

    fn parse_component_custom_section(
        &mut self,
        _: &mut Component,
        _: CustomSectionReader<'_>,
    ) -> Result<(), Error> {
        Ok(())
    }
}
