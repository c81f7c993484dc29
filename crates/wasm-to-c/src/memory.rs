//! Operators that load from memory and store to it.

use wasmparser::{MemArg, Operator, ValType};

/// An operator that accesses memory.
pub struct Access {
    pub argument: MemArg,
    /// How many bytes it accesses.
    pub width: u64,
    pub value_type: ValType,
    /// The function in C, with what is around it: `(u64)load_u8` is a cast of the result.
    pub function: &'static str,
    pub is_store: bool,
}

/// The access of an operator, if it is one.
pub fn access(operator: &Operator) -> Option<Access> {
    use Operator::*;
    use ValType::{F32, F64, I32, I64};
    let (argument, width, value_type, function) = match *operator {
        I32Load { memarg } => (memarg, 4, I32, "load_u32"),
        I32Load8U { memarg } => (memarg, 1, I32, "load_u8"),
        I32Load8S { memarg } => (memarg, 1, I32, "(u32)(i8)load_u8"),
        I32Load16U { memarg } => (memarg, 2, I32, "load_u16"),
        I32Load16S { memarg } => (memarg, 2, I32, "(u32)(i16)load_u16"),
        I64Load { memarg } => (memarg, 8, I64, "load_u64"),
        I64Load8U { memarg } => (memarg, 1, I64, "(u64)load_u8"),
        I64Load8S { memarg } => (memarg, 1, I64, "(u64)(i8)load_u8"),
        I64Load16U { memarg } => (memarg, 2, I64, "(u64)load_u16"),
        I64Load16S { memarg } => (memarg, 2, I64, "(u64)(i16)load_u16"),
        I64Load32U { memarg } => (memarg, 4, I64, "(u64)load_u32"),
        I64Load32S { memarg } => (memarg, 4, I64, "(u64)(i32)load_u32"),
        F32Load { memarg } => (memarg, 4, F32, "load_f32"),
        F64Load { memarg } => (memarg, 8, F64, "load_f64"),
        I32Store { memarg } => (memarg, 4, I32, "store_u32"),
        I32Store8 { memarg } => (memarg, 1, I32, "store_u8"),
        I32Store16 { memarg } => (memarg, 2, I32, "store_u16"),
        I64Store { memarg } => (memarg, 8, I64, "store_u64"),
        I64Store8 { memarg } => (memarg, 1, I64, "store_u8"),
        I64Store16 { memarg } => (memarg, 2, I64, "store_u16"),
        I64Store32 { memarg } => (memarg, 4, I64, "store_u32"),
        F32Store { memarg } => (memarg, 4, F32, "store_f32"),
        F64Store { memarg } => (memarg, 8, F64, "store_f64"),
        _ => return None,
    };
    Some(Access { argument, width, value_type, function, is_store: function.starts_with("store") })
}
