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
