//! The parts of a WebAssembly module that become C.

use std::collections::{BTreeMap, HashMap};

use wasmparser::{
    ConstExpr, DataKind, ElementItems, ElementKind, ExternalKind, FuncType, FunctionBody,
    KnownCustom, Name, Operator, Parser, Payload, TypeRef, ValType, Validator, WasmFeatures,
};

use crate::Error;

/// The size in bytes of a page of memory.
pub const PAGE: u64 = 65536;

/// What rustc emits by default, but for the tables that change and the segments that are copied at run time.
fn features() -> WasmFeatures {
    WasmFeatures::FLOATS
        | WasmFeatures::MUTABLE_GLOBAL
        | WasmFeatures::SATURATING_FLOAT_TO_INT
        | WasmFeatures::SIGN_EXTENSION
        | WasmFeatures::MULTI_VALUE
        | WasmFeatures::BULK_MEMORY
        | WasmFeatures::REFERENCE_TYPES
        | WasmFeatures::GC_TYPES
}

/// A function that the module calls and does not define.
pub struct Import<'a> {
    pub module: &'a str,
    pub name: &'a str,
}

/// A global variable with its value at the start, as bits.
pub struct Global {
    pub value_type: ValType,
    pub value: u64,
}

/// Bytes that are in memory at the start.
pub struct Segment<'a> {
    pub address: u32,
    pub bytes: &'a [u8],
}

/// A valid module. Functions are counted with the imports first.
#[derive(Default)]
pub struct Module<'a> {
    pub types: Vec<FuncType>,
    pub imports: Vec<Import<'a>>,
    /// The index of the type of each function.
    pub functions: Vec<u32>,
    pub bodies: Vec<FunctionBody<'a>>,
    pub globals: Vec<Global>,
    /// The functions in the table, by their place.
    pub table: BTreeMap<u32, u32>,
    /// The size of the memory at the start, in pages.
    pub pages: u32,
    /// The size in bytes that the memory has in C.
    pub memory_size: u64,
    pub segments: Vec<Segment<'a>>,
    /// Names and indices of exported functions.
    pub exports: Vec<(&'a str, u32)>,
    /// The end of stack, static data and nothing else, which linkers export as `__heap_base`.
    pub heap_base: Option<u32>,
    pub start: Option<u32>,
    /// The names of functions from the name section, as in the symbol table.
    pub names: HashMap<u32, &'a str>,
}

impl<'a> Module<'a> {
    pub fn parse(bytes: &'a [u8]) -> Result<Self, Error> {
        Validator::new_with_features(features()).validate_all(bytes)?;
        let mut module = Module::default();
        let mut exported_globals = Vec::new();
        for payload in Parser::new(0).parse_all(bytes) {
            match payload? {
                Payload::TypeSection(section) => {
                    for function_type in section.into_iter_err_on_gc_types() {
                        module.types.push(function_type?);
                    }
                }
                Payload::ImportSection(section) => {
                    for import in section {
                        let import = import?;
                        let TypeRef::Func(index) = import.ty else {
                            return Err(Error(format!(
                                "the module imports {:?} from {:?}, which is not a function",
                                import.name, import.module
                            )));
                        };
                        module.imports.push(Import { module: import.module, name: import.name });
                        module.functions.push(index);
                    }
                }
                Payload::FunctionSection(section) => {
                    for index in section {
                        module.functions.push(index?);
                    }
                }
                Payload::MemorySection(section) => {
                    for memory in section {
                        module.pages =
                            u32::try_from(memory?.initial).expect("validated: at most 65536");
                        if module.pages > 32767 {
                            return Err(Error(format!(
                                "the memory of {} pages is too large",
                                module.pages
                            )));
                        }
                    }
                }
                Payload::GlobalSection(section) => {
                    for global in section {
                        let global = global?;
                        let value = constant(&global.init_expr)?;
                        module.globals.push(Global { value_type: global.ty.content_type, value });
                    }
                }
                Payload::ExportSection(section) => {
                    for export in section {
                        let export = export?;
                        match export.kind {
                            ExternalKind::Func => module.exports.push((export.name, export.index)),
                            ExternalKind::Global => {
                                exported_globals.push((export.name, export.index))
                            }
                            _ => {}
                        }
                    }
                }
                Payload::StartSection { func, .. } => module.start = Some(func),
                Payload::ElementSection(section) => {
                    for element in section {
                        module.add_elements(element?)?;
                    }
                }
                Payload::DataSection(section) => {
                    for data in section {
                        let data = data?;
                        let DataKind::Active { offset_expr, .. } = data.kind else {
                            return Err(Error(
                                "the module has passive data, which is not translated".into(),
                            ));
                        };
                        let address = constant(&offset_expr)? as u32;
                        if u64::from(address) + data.data.len() as u64
                            > u64::from(module.pages) * PAGE
                        {
                            return Err(Error(format!(
                                "the data at address {address} are beyond the memory"
                            )));
                        }
                        module.segments.push(Segment { address, bytes: data.data });
                    }
                }
                Payload::CodeSectionEntry(body) => module.bodies.push(body),
                Payload::CustomSection(section) => {
                    if let KnownCustom::Name(names) = section.as_known() {
                        for name in names.into_iter().flatten() {
                            if let Name::Function(functions) = name {
                                module.names.extend(
                                    functions.into_iter().flatten().map(|f| (f.index, f.name)),
                                );
                            }
                        }
                    }
                }
                _ => {}
            }
        }
        module.memory_size = (u64::from(module.pages) * PAGE).max(16);
        module.heap_base = exported_globals
            .iter()
            .find(|(name, _)| *name == "__heap_base")
            .map(|&(_, index)| module.globals[index as usize].value as u32);
        for &index in &module.functions {
            let function = &module.types[index as usize];
            if function.results().len() > 1 {
                return Err(Error(
                    "the module has a function with several results, which is not translated"
                        .into(),
                ));
            }
            function.params().iter().chain(function.results()).try_for_each(number)?;
        }
        module.globals.iter().map(|global| &global.value_type).try_for_each(number)?;
        Ok(module)
    }

    fn add_elements(&mut self, element: wasmparser::Element<'a>) -> Result<(), Error> {
        let offset_expr = match element.kind {
            ElementKind::Active { table_index: None | Some(0), offset_expr } => offset_expr,
            ElementKind::Declared => return Ok(()),
            _ => return Err(Error("the module has several tables, or one that changes".into())),
        };
        let ElementItems::Functions(functions) = element.items else {
            return Err(Error("the module has a table with more than functions".into()));
        };
        for (place, function) in (constant(&offset_expr)? as u32..).zip(functions) {
            self.table.insert(place, function?);
        }
        Ok(())
    }

    /// The type of a function.
    pub fn function_type(&self, function: u32) -> &FuncType {
        &self.types[self.functions[function as usize] as usize]
    }
}

/// Refuses references and vectors.
pub fn number(value_type: &ValType) -> Result<(), Error> {
    match value_type {
        ValType::I32 | ValType::I64 | ValType::F32 | ValType::F64 => Ok(()),
        other => Err(Error(format!(
            "the module has values of the type {other}, which are not translated"
        ))),
    }
}

/// The value of a constant expression, as bits.
fn constant(expression: &ConstExpr) -> Result<u64, Error> {
    match expression.get_operators_reader().read()? {
        Operator::I32Const { value } => Ok(u64::from(value as u32)),
        Operator::I64Const { value } => Ok(value as u64),
        Operator::F32Const { value } => Ok(u64::from(value.bits())),
        Operator::F64Const { value } => Ok(value.bits()),
        operator => {
            Err(Error(format!("the module has a start value that is not a number: {operator:?}")))
        }
    }
}
