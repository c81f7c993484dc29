//! Translates a WebAssembly module to C99 that any compiler turns into the same bits.
//!
//! [`translate`] returns two files. `model.h` declares the struct `Model`, which is an instance with its whole
//! state and its linear memory, and the functions; `model.c` defines them:
//!
//! | in C | is |
//! |---|---|
//! | `MODEL(name)` | the symbol `PREFIX_name`, where [`Options::prefix`] is `PREFIX_`; all other functions are static |
//! | `Model` | a struct of constant size: `host` for the caller, `trap`, the globals and `memory[MODEL_MEMORY_SIZE]` |
//! | `void MODEL(init)(Model *m)` | initializes an instance in memory of the caller, without touching `host` |
//! | `uint32_t MODEL(f)(Model *m, double a0)` | the export `f` of the module; i32 and i64 are `uint32_t` and `uint64_t` |
//! | `uint32_t MODEL(import_f)(Model *m, uint32_t a0)` | the import `f`, which the user of the files defines |
//! | `model_load_f64(m, address)`, `model_store_u32(m, address, value)`, … | access to the memory by checked addresses |
//! | `model_bytes(m, address, size)`, `model_string(m, address)` | pointers into the memory, or NULL |
//! | `model_trap_message(m->trap)` | what a trap means |
//!
//! A trap ends the instance, never the process: it sets `m->trap` to one of `MODEL_TRAP_…`, and all functions
//! return zero, up to the caller. A call of an instance with a trap returns zero at once. Functions that call each
//! other in a circle count their depth and trap at `MODEL_CALL_DEPTH`.
//!
//! # Why not wasm2c
//!
//! The module of the FMU `Pid` for FMI 3.0 (219 KB, a cycle of set, step and get), translated by this crate and by wabt's
//! `wasm2c` 1.0.32 with checks of all addresses:
//!
//! | | this crate | wasm2c |
//! |---|---|---|
//! | C | 0.67 MB | 2.2 MB |
//! | `gcc -O2`, on a busy machine | 6.7 s | 9.1 s |
//! | time of a cycle | 27 ns | 40 ns |
//! | a trap | sets a field of the instance | `longjmp` to a global, or a signal |
//! | memory of an instance | in one struct of constant size | allocated at run time |
#![forbid(unsafe_code)]
mod calls;
mod data;
mod expression;
mod facts;
mod function;
mod locals;
mod memory;
mod module;
mod names;
mod numeric;
mod simplify;
mod source;
mod statement;

use std::fmt;

pub use source::{CSource, Options, translate};

/// Why a module cannot be translated.
#[derive(Debug)]
pub struct Error(String);

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

impl From<wasmparser::BinaryReaderError> for Error {
    fn from(error: wasmparser::BinaryReaderError) -> Self {
        Error(format!(
            "the WebAssembly module is invalid, or needs an extension that is not translated: {error}"
        ))
    }
}
