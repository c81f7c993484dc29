//! Takes a component apart, by the crate that wasmtime uses for it, and links its modules. A call of a
//! function of a module takes a fraction of the time of a call of a component.

use std::collections::HashMap;
use std::sync::Arc;

use wasmtime::{
    Error, Extern, ExternType, Func, FuncType, Global, Instance, Memory, Module, Result, Store,
    TypedFunc, Val,
};
use wasmtime_environ::component::{
    CanonicalOptionsDataModel, Component, ComponentTypes, ComponentTypesBuilder, CoreDef,
    CoreExport, Export, ExportItem, FLAG_MAY_ENTER, FLAG_MAY_LEAVE, FixedEncoding,
    GlobalInitializer, InstantiateModule, InterfaceType, OptionsIndex, ResourceIndex,
    StaticModuleIndex, StringEncoding, Trampoline, TrampolineIndex, Transcode, Translator, TypeDef,
    TypeFuncIndex, TypeResourceTableIndex, TypeResult, TypeTupleIndex,
};
use wasmtime_environ::wasmparser::Validator;
use wasmtime_environ::{EntityIndex, PrimaryMap, ScopeVec, Tunables};

use super::abi::{self, ComponentFunction};
use super::host_state::HostState;
use super::imports;

/// The interfaces of the draft.
pub(super) const PACKAGE: &str = "fmi:fmi3";

/// Makes the calls of a step: it gets what stands for the instance and the place of a record, and returns a status.
pub(super) type CycleFunction = TypedFunc<(u32, u32), u32>;

/// A component in parts.
pub(super) struct Parts {
    component: Component,
    types: ComponentTypes,
    trampolines: PrimaryMap<TrampolineIndex, Trampoline>,
    /// The modules, with the names of what they export.
    modules: Vec<(Module, HashMap<EntityIndex, String>)>,
    /// The functions of the component by their interfaces and names, and those that end its resources.
    exports: HashMap<(String, String), Exported>,
}

struct Exported {
    function: CoreDef,
    options: Option<OptionsIndex>,
    signature: Arc<str>,
}

impl Parts {
    /// Takes a component apart, and compiles its modules.
    pub(super) fn new(bytes: &[u8], compile: impl Fn(&[u8]) -> Result<Module>) -> Result<Self> {
        let (scope, tunables, mut validator) =
            (ScopeVec::new(), Tunables::default_host(), Validator::new());
        let mut types = ComponentTypesBuilder::new(&validator);
        let translator = Translator::new(&tunables, &mut validator, &mut types, &scope);
        let (translation, modules) = translator.translate(bytes)?;
        let (component, trampolines) = (translation.component, translation.trampolines);
        let (types, _) = types.finish(&component);
        for (_, (name, _)) in &component.import_types {
            if !name.starts_with("fmi:fmi3/") && !name.starts_with("wasi:") {
                return Err(Error::msg(format!(
                    "it imports {name}, expected imports of {PACKAGE} and of WASI only"
                )));
            }
        }
        let modules = modules.values().map(|module| {
            let names = module.module.exports.iter().map(|(name, index)| (*index, name.clone()));
            Ok((compile(module.wasm)?, names.collect()))
        });
        let modules = modules.collect::<Result<_>>()?;
        let mut exports = HashMap::new();
        for (interface, index) in component.exports.raw_iter() {
            let Export::Instance { exports: functions, .. } = &component.export_items[*index]
            else {
                continue;
            };
            for (name, index) in functions.raw_iter() {
                let (function, options, signature) = match &component.export_items[*index] {
                    Export::LiftedFunction { ty, func, options } => {
                        (Some(func), Some(*options), signature(&types, *ty))
                    }
                    Export::Type(TypeDef::Resource(table)) => {
                        (end(&component, types[*table].ty), None, String::new())
                    }
                    _ => continue,
                };
                if let Some(function) = function.cloned() {
                    let exported = Exported { function, options, signature: signature.into() };
                    exports.insert((interface.clone(), name.clone()), exported);
                }
            }
        }
        Ok(Self { component, types, trampolines, modules, exports })
    }
}

/// The function that ends a resource.
fn end(component: &Component, resource: ResourceIndex) -> Option<&CoreDef> {
    component.initializers.iter().find_map(|initializer| match initializer {
        GlobalInitializer::Resource(of) if component.resource_index(of.index) == resource => {
            of.dtor.as_ref()
        }
        _ => None,
    })
}

/// The types of a function, in the words of WIT, but records without their names.
fn signature(types: &ComponentTypes, function: TypeFuncIndex) -> String {
    let of = |tuple: TypeTupleIndex| join(types, types[tuple].types.iter());
    format!("{}->{}", of(types[function].params), of(types[function].results))
}

fn join<'a>(types: &ComponentTypes, all: impl Iterator<Item = &'a InterfaceType>) -> String {
    let all: Vec<_> = all.collect();
    Vec::from_iter(all.into_iter().map(|of| describe(types, *of))).join(",")
}

fn describe(types: &ComponentTypes, of: InterfaceType) -> String {
    match of {
        InterfaceType::Float32 => "f32".to_owned(),
        InterfaceType::Float64 => "f64".to_owned(),
        InterfaceType::List(list) => format!("list<{}>", describe(types, types[list].element)),
        InterfaceType::Option(option) => format!("option<{}>", describe(types, types[option].ty)),
        InterfaceType::Tuple(tuple) => format!("tuple<{}>", join(types, types[tuple].types.iter())),
        InterfaceType::Record(record) => {
            let fields = types[record].fields.iter().map(|field| &field.ty);
            format!("record<{}>", join(types, fields))
        }
        InterfaceType::Result(result) => {
            let TypeResult { ok, err, .. } = &types[result];
            format!("result<{},{}>", join(types, ok.iter()), join(types, err.iter()))
        }
        InterfaceType::Enum(cases) if types[cases].names.iter().eq(STATUS) => "status".to_owned(),
        InterfaceType::Enum(cases) if types[cases].names.iter().eq(QUALIFIER) => {
            "interval-qualifier".to_owned()
        }
        InterfaceType::Own(_) => "own".to_owned(),
        InterfaceType::Borrow(_) => "borrow".to_owned(),
        other => format!("{other:?}").to_lowercase(),
    }
}

const QUALIFIER: [&str; 3] = ["interval-not-yet-known", "interval-unchanged", "interval-changed"];

const STATUS: [&str; 5] = ["ok", "warning", "discard", "error", "fatal"];

/// The modules of a component in a store.
pub(super) struct Linked<'a> {
    parts: &'a Parts,
    instances: Vec<(StaticModuleIndex, Instance)>,
    memories: Vec<Memory>,
    reallocs: Vec<Func>,
    post_returns: Vec<Func>,
    /// The interfaces and names of what the host provides.
    imports: Vec<(&'a str, &'a str)>,
    /// Which of the instances has memory for arguments, and where.
    arguments: Option<(usize, u32)>,
    pub(super) cycle: Option<CycleFunction>,
}

impl<'a> Linked<'a> {
    /// Instantiates the modules.
    pub(super) fn new(parts: &'a Parts, store: &mut Store<HostState>) -> Result<Self> {
        let mut linked = Self {
            parts,
            instances: Vec::new(),
            memories: Vec::new(),
            reallocs: Vec::new(),
            post_returns: Vec::new(),
            imports: Vec::new(),
            arguments: None,
            cycle: None,
        };
        for initializer in &parts.component.initializers {
            match initializer {
                GlobalInitializer::InstantiateModule(InstantiateModule::Static(index, imports)) => {
                    let (module, _) = &parts.modules[index.as_u32() as usize];
                    let imports = imports
                        .iter()
                        .zip(module.imports())
                        .map(|(import, of)| linked.import(&mut *store, import, of.ty()));
                    let imports = imports.collect::<Result<Vec<_>>>()?;
                    linked.instances.push((*index, Instance::new(&mut *store, module, &imports)?));
                }
                GlobalInitializer::LowerImport { import, .. } => {
                    let (import, path) = &parts.component.imports[*import];
                    let interface = &parts.component.import_types[*import].0;
                    linked.imports.push((interface, path.first().map_or("", String::as_str)));
                }
                GlobalInitializer::ExtractMemory(memory) => {
                    let export = memory.export.clone().map_index(EntityIndex::Memory);
                    let export = linked.export(store, &export)?;
                    linked.memories.push(export.into_memory().ok_or_else(unsupported)?);
                }
                GlobalInitializer::ExtractRealloc(realloc) => {
                    let function = linked.function(&mut *store, &realloc.def)?;
                    linked.reallocs.push(function);
                }
                GlobalInitializer::ExtractPostReturn(post_return) => {
                    let function = linked.function(&mut *store, &post_return.def)?;
                    linked.post_returns.push(function);
                }
                GlobalInitializer::Resource(_) => {}
                _ => return Err(unsupported()),
            }
        }
        // Only components of `fmu-export` have these, for the functions of the same module.
        for (index, (_, instance)) in linked.instances.iter().enumerate() {
            let function = instance.get_typed_func::<(), u32>(&mut *store, "fmu_export_arguments");
            if let Ok(function) = function {
                linked.arguments = Some((index, function.call(&mut *store, ())?));
                linked.cycle = instance.get_typed_func(&mut *store, "fmu_export_cycle").ok();
            }
        }
        Ok(linked)
    }

    /// Finds a function that the component exports.
    pub(super) fn find(
        &self,
        store: &mut Store<HostState>,
        interface: &str,
        name: &str,
    ) -> Result<Option<ComponentFunction>> {
        let Some(exported) = self.parts.exports.get(&(interface.to_owned(), name.to_owned()))
        else {
            return Ok(None);
        };
        let (mut memory, mut realloc, mut post_return) = (None, None, None);
        if let Some(options) = exported.options {
            (memory, realloc) = self.passing(options)?;
            let index = self.parts.component.options[options].post_return;
            post_return = index.map(|index| self.post_returns[index.as_u32() as usize]);
        }
        let function = self.function(store, &exported.function)?;
        let signature = exported.signature.clone();
        let arguments = match (&exported.function, self.arguments) {
            (CoreDef::Export(of), Some((index, start)))
                if of.instance.as_u32() as usize == index =>
            {
                Some(start)
            }
            _ => None,
        };
        Ok(Some(ComponentFunction { signature, function, memory, realloc, arguments, post_return }))
    }

    /// How arguments and results are passed.
    fn passing(&self, options: OptionsIndex) -> Result<(Option<Memory>, Option<Func>)> {
        let options = &self.parts.component.options[options];
        match (options.data_model, options.string_encoding, options.async_) {
            (CanonicalOptionsDataModel::LinearMemory(of), StringEncoding::Utf8, false) => Ok((
                of.memory.map(|index| self.memories[index.as_u32() as usize]),
                of.realloc.map(|index| self.reallocs[index.as_u32() as usize]),
            )),
            _ => Err(unsupported()),
        }
    }

    fn function(&self, store: &mut Store<HostState>, from: &CoreDef) -> Result<Func> {
        match from {
            CoreDef::Export(export) => {
                self.export(store, export)?.into_func().ok_or_else(unsupported)
            }
            _ => Err(unsupported()),
        }
    }

    fn export(
        &self,
        store: &mut Store<HostState>,
        export: &CoreExport<EntityIndex>,
    ) -> Result<Extern> {
        let (module, instance) = self.instances[export.instance.as_u32() as usize];
        let name = match &export.item {
            ExportItem::Index(index) => self.parts.modules[module.as_u32() as usize].1.get(index),
            ExportItem::Name(name) => Some(name),
        };
        name.and_then(|name| instance.get_export(store, name)).ok_or_else(unsupported)
    }

    /// What a module imports.
    fn import(
        &self,
        store: &mut Store<HostState>,
        from: &CoreDef,
        of: ExternType,
    ) -> Result<Extern> {
        let function = match (from, of) {
            (CoreDef::Export(export), _) => return self.export(store, export),
            // The flags of a component say whether it may be called and may call others. Components that call each other in
            // circles do not exist, so each module that passes their calls has a copy of its own.
            (CoreDef::InstanceFlags(_), ExternType::Global(of)) => {
                let flags = Val::I32(FLAG_MAY_ENTER | FLAG_MAY_LEAVE);
                return Ok(Global::new(store, of, flags)?.into());
            }
            (CoreDef::Trampoline(index), ExternType::Func(of)) => {
                match &self.parts.trampolines[*index] {
                    Trampoline::LowerImport { index, options, .. } => {
                        let (memory, realloc) = self.passing(*options)?;
                        let (interface, name) = self.imports[index.as_u32() as usize];
                        imports::function(store, of, (interface, name), (memory, realloc))
                    }
                    // A handle is what it stands for.
                    Trampoline::ResourceNew(_)
                    | Trampoline::ResourceRep(_)
                    | Trampoline::ResourceTransferOwn => {
                        Func::new(store, of, |_, given, results| {
                            results.clone_from_slice(&given[..1]);
                            Ok(())
                        })
                    }
                    Trampoline::ResourceTransferBorrow => {
                        Func::new(store, of, |mut caller, given, results| {
                            let borrowed = (given[2].unwrap_i32(), given[0].unwrap_i32());
                            caller.data_mut().borrowed.push(Some(borrowed));
                            results.clone_from_slice(&given[..1]);
                            Ok(())
                        })
                    }
                    Trampoline::ResourceEnterCall => Func::new(store, of, |mut caller, _, _| {
                        caller.data_mut().borrowed.push(None);
                        Ok(())
                    }),
                    Trampoline::ResourceExitCall => Func::new(store, of, |mut caller, _, _| {
                        while let Some(Some(_)) = caller.data_mut().borrowed.pop() {}
                        Ok(())
                    }),
                    Trampoline::ResourceDrop(table) => self.drop_of(store, *table, of)?,
                    Trampoline::Transcoder {
                        op: Transcode::Copy(FixedEncoding::Utf8),
                        from,
                        to,
                        ..
                    } => {
                        let [from, to] = [from, to].map(|of| self.memories[of.as_u32() as usize]);
                        Func::new(store, of, move |caller, given, _| {
                            abi::copy_text(caller, given, from, to)
                        })
                    }
                    _ => return Err(unsupported()),
                }
            }
            _ => return Err(unsupported()),
        };
        Ok(function.into())
    }

    /// The function that drops a handle of a table. It ends the resource, unless the handle was borrowed.
    fn drop_of(
        &self,
        store: &mut Store<HostState>,
        table: TypeResourceTableIndex,
        of: FuncType,
    ) -> Result<Func> {
        let end = end(&self.parts.component, self.parts.types[table].ty);
        let end = end.map(|end| self.import(store, end, ExternType::Func(of.clone())));
        let end = end.transpose()?.and_then(Extern::into_func);
        let table = table.as_u32().cast_signed();
        Ok(Func::new(store, of, move |mut caller, given, results| {
            let borrowed = &mut caller.data_mut().borrowed;
            let handle = Some((table, given[0].unwrap_i32()));
            match (borrowed.iter().rposition(|borrowed| *borrowed == handle), end) {
                (Some(index), _) => {
                    borrowed.remove(index);
                }
                (None, Some(end)) => end.call(caller, given, results)?,
                (None, None) => {}
            }
            Ok(())
        }))
    }
}

fn unsupported() -> Error {
    Error::msg(
        "it uses a feature of the component model that is not supported, such as text other than \
         UTF-8 or asynchronous functions",
    )
}
