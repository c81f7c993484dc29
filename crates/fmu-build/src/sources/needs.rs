//! What a module of WebAssembly needs: its stack, and functions of the host.

use anyhow::Result;
use wasmparser::{Operator, Parser, Payload};

/// The bytes of stack that a call can need at most, if no functions call each other in a circle: what all functions
/// reserve, since each is then at most once in a chain of calls.
pub fn stack_of_all_functions(module: &[u8]) -> Result<u64> {
    let mut sum = 0;
    for payload in Parser::new(0).parse_all(module) {
        if let Payload::CodeSectionEntry(body) = payload? {
            // The largest constant that a function subtracts before it sets the stack pointer, which is global 0.
            let (mut reserved, mut last, mut before) = (0, None, None);
            for operator in body.get_operators_reader()? {
                match operator? {
                    Operator::I32Const { value } => last = Some(value.unsigned_abs()),
                    Operator::I32Sub => before = last.take(),
                    Operator::LocalTee { .. } | Operator::LocalGet { .. } => {}
                    Operator::GlobalSet { global_index: 0 } => {
                        reserved = reserved.max(before.take().unwrap_or_default());
                    }
                    _ => (last, before) = (None, None),
                }
            }
            sum += u64::from(reserved);
        }
    }
    Ok(sum)
}

/// Whether a module calls a function of the host.
pub fn needs_function(module: &[u8], name: &str) -> Result<bool> {
    for payload in Parser::new(0).parse_all(module) {
        if let Payload::ImportSection(imports) = payload? {
            for import in imports {
                if import?.name == name {
                    return Ok(true);
                }
            }
        }
    }
    Ok(false)
}

#[cfg(test)]
mod tests {
    use wasm_encoder::{
        CodeSection, EntityType, Function, FunctionSection, GlobalSection, GlobalType,
        ImportSection, Module, TypeSection, ValType,
    };

    use super::*;

    /// A module that imports a function, and has functions that reserve so many bytes of stack.
    fn module(reserved: &[i32]) -> Vec<u8> {
        let (mut types, mut imports) = (TypeSection::new(), ImportSection::new());
        types.ty().function([], []);
        imports.import("fmu", "log", EntityType::Function(0));
        let mut globals = GlobalSection::new();
        let stack_pointer = GlobalType { val_type: ValType::I32, mutable: true, shared: false };
        globals.global(stack_pointer, &wasm_encoder::ConstExpr::i32_const(1 << 10));
        let (mut functions, mut code) = (FunctionSection::new(), CodeSection::new());
        for &bytes in reserved {
            functions.function(0);
            let mut function = Function::new([(1, ValType::I32)]);
            let mut body = function.instructions();
            body.i32_const(7000).drop();
            body.global_get(0).i32_const(bytes).i32_sub().local_tee(0).global_set(0);
            body.local_get(0).i32_const(bytes).i32_add().global_set(0).end();
            code.function(&function);
        }
        let mut module = Module::new();
        module.section(&types).section(&imports).section(&functions).section(&globals);
        module.section(&code);
        module.finish()
    }

    #[test]
    fn the_stack_is_what_all_functions_reserve() {
        assert_eq!(stack_of_all_functions(&module(&[])).unwrap(), 0);
        assert_eq!(stack_of_all_functions(&module(&[48, 4000, 16])).unwrap(), 4064);
    }

    #[test]
    fn functions_of_the_host_are_found() {
        assert!(needs_function(&module(&[16]), "log").unwrap());
        assert!(!needs_function(&module(&[16]), "read_resource").unwrap());
    }

    #[test]
    fn what_is_no_module_is_an_error() {
        assert!(stack_of_all_functions(b"none").is_err() && needs_function(b"none", "").is_err());
    }
}
