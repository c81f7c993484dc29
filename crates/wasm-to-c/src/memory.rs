//! Operators that load from memory and store to it.

use wasmparser::{MemArg, Operator, ValType};

/// An operator that accesses memory.
pub struct Access {
    pub argument: MemArg,
    /// How many bytes it accesses.
    pub width: u64,
    pub value_type: ValType,
    /// The function in C, with what is around it: `(u64)U8` is a cast of the result.
    pub function: &'static str,
    pub is_store: bool,
}

/// The access of an operator, if it is one.
pub fn access(operator: &Operator) -> Option<Access> {
    use Operator::*;
    use ValType::{F32, F64, I32, I64};
    let (argument, width, value_type, function) = match *operator {
        I32Load { memarg } => (memarg, 4, I32, "U32"),
        I32Load8U { memarg } => (memarg, 1, I32, "U8"),
        I32Load8S { memarg } => (memarg, 1, I32, "(u32)(i8)U8"),
        I32Load16U { memarg } => (memarg, 2, I32, "U16"),
        I32Load16S { memarg } => (memarg, 2, I32, "(u32)(i16)U16"),
        I64Load { memarg } => (memarg, 8, I64, "U64"),
        I64Load8U { memarg } => (memarg, 1, I64, "(u64)U8"),
        I64Load8S { memarg } => (memarg, 1, I64, "(u64)(i8)U8"),
        I64Load16U { memarg } => (memarg, 2, I64, "(u64)U16"),
        I64Load16S { memarg } => (memarg, 2, I64, "(u64)(i16)U16"),
        I64Load32U { memarg } => (memarg, 4, I64, "(u64)U32"),
        I64Load32S { memarg } => (memarg, 4, I64, "(u64)(i32)U32"),
        F32Load { memarg } => (memarg, 4, F32, "F32"),
        F64Load { memarg } => (memarg, 8, F64, "F64"),
        I32Store { memarg } => (memarg, 4, I32, "SET_U32"),
        I32Store8 { memarg } => (memarg, 1, I32, "SET_U8"),
        I32Store16 { memarg } => (memarg, 2, I32, "SET_U16"),
        I64Store { memarg } => (memarg, 8, I64, "SET_U64"),
        I64Store8 { memarg } => (memarg, 1, I64, "SET_U8"),
        I64Store16 { memarg } => (memarg, 2, I64, "SET_U16"),
        I64Store32 { memarg } => (memarg, 4, I64, "SET_U32"),
        F32Store { memarg } => (memarg, 4, F32, "SET_F32"),
        F64Store { memarg } => (memarg, 8, F64, "SET_F64"),
        _ => return None,
    };
    Some(Access { argument, width, value_type, function, is_store: function.starts_with("SET") })
}
