//! Operators on numbers.

use wasmparser::{Operator, ValType};

use crate::expression::Expression;

/// What an operator does with one number or two.
#[derive(Clone, Copy)]
pub enum Operation {
    IsZero,
    Compare {
        operator: &'static str,
        signed: bool,
    },
    Binary(&'static str),
    Divide {
        operator: &'static str,
        signed: bool,
    },
    Shift {
        operator: &'static str,
        signed: bool,
    },
    Negative,
    Cast {
        casts: &'static str,
        value_type: ValType,
    },
    /// A conversion to an integer, which traps unless the value is in between.
    Truncate {
        casts: &'static str,
        value_type: ValType,
        above: &'static str,
        below: &'static str,
    },
    /// A pure function of one number, or of two.
    Function {
        name: &'static str,
        value_type: ValType,
        operands: usize,
    },
}

use Operation::{Binary, Cast, Compare, Divide, IsZero, Negative, Shift, Truncate};

impl Operation {
    pub fn is_binary(self) -> bool {
        match self {
            Compare { .. } | Binary(_) | Divide { .. } | Shift { .. } => true,
            Operation::Function { operands, .. } => operands == 2,
            IsZero | Negative | Cast { .. } | Truncate { .. } => false,
        }
    }

    /// The expression for its operands, of which there are two if it is binary.
    pub fn apply(self, first: Expression, second: Option<Expression>) -> Expression {
        match (self, second) {
            (Compare { operator, signed }, Some(second)) => first.compare(operator, signed, second),
            (Binary(operator), Some(second)) => first.binary(operator, second),
            (Divide { operator, signed }, Some(second)) => first.divide(operator, signed, second),
            (Shift { operator, signed }, Some(second)) => first.shift(operator, signed, second),
            (Operation::Function { name, value_type, .. }, Some(second)) => {
                Expression::call(name, value_type, &[&first, &second])
            }
            (Operation::Function { name, value_type, .. }, None) => {
                Expression::call(name, value_type, &[&first])
            }
            (Negative, _) => first.negative(),
            (Cast { casts, value_type } | Truncate { casts, value_type, .. }, _) => {
                first.cast(casts, value_type)
            }
            _ => first.equals_zero(),
        }
    }
}

/// The type and the bits of a constant.
pub fn constant(operator: &Operator) -> Option<(ValType, u64)> {
    match *operator {
        Operator::I32Const { value } => Some((ValType::I32, u64::from(value as u32))),
        Operator::I64Const { value } => Some((ValType::I64, value as u64)),
        Operator::F32Const { value } => Some((ValType::F32, u64::from(value.bits()))),
        Operator::F64Const { value } => Some((ValType::F64, value.bits())),
        _ => None,
    }
}

/// Whether an integer is the one by which the smallest number cannot be divided.
pub fn is_minus_one(value_type: ValType, bits: u64) -> bool {
    bits == if value_type == ValType::I32 { u64::from(u32::MAX) } else { u64::MAX }
}

/// The operation of an operator, if it has one.
pub fn operation(operator: &Operator) -> Option<Operation> {
    use Operator::*;
    use ValType::{F32, F64, I32, I64};
    let function = |name, value_type, operands| Operation::Function { name, value_type, operands };
    let cast = |casts, value_type| Cast { casts, value_type };
    let truncate = |casts, value_type, above, below| Truncate { casts, value_type, above, below };
    let compare = |operator| Compare { operator, signed: false };
    let signed = |operator| Compare { operator, signed: true };
    let divide = |operator, signed| Divide { operator, signed };
    let shift = |operator, signed| Shift { operator, signed };
    Some(match operator {
        I32Eqz | I64Eqz => IsZero,
        I32Eq | I64Eq | F32Eq | F64Eq => compare("=="),
        I32Ne | I64Ne | F32Ne | F64Ne => compare("!="),
        I32LtU | I64LtU | F32Lt | F64Lt => compare("<"),
        I32GtU | I64GtU | F32Gt | F64Gt => compare(">"),
        I32LeU | I64LeU | F32Le | F64Le => compare("<="),
        I32GeU | I64GeU | F32Ge | F64Ge => compare(">="),
        I32LtS | I64LtS => signed("<"),
        I32GtS | I64GtS => signed(">"),
        I32LeS | I64LeS => signed("<="),
        I32GeS | I64GeS => signed(">="),
        I32Add | I64Add | F32Add | F64Add => Binary("+"),
        I32Sub | I64Sub | F32Sub | F64Sub => Binary("-"),
        I32Mul | I64Mul | F32Mul | F64Mul => Binary("*"),
        F32Div | F64Div => Binary("/"),
        I32And | I64And => Binary("&"),
        I32Or | I64Or => Binary("|"),
        I32Xor | I64Xor => Binary("^"),
        I32DivS | I64DivS => divide("/", true),
        I32DivU | I64DivU => divide("/", false),
        I32RemS | I64RemS => divide("%", true),
        I32RemU | I64RemU => divide("%", false),
        I32Shl | I64Shl => shift("<<", false),
        I32ShrU | I64ShrU => shift(">>", false),
        I32ShrS | I64ShrS => shift(">>", true),
        I32Rotl => function("u32_rotate_left", I32, 2),
        I32Rotr => function("u32_rotate_right", I32, 2),
        I64Rotl => function("u64_rotate_left", I64, 2),
        I64Rotr => function("u64_rotate_right", I64, 2),
        I32Clz => function("u32_leading_zeros", I32, 1),
        I64Clz => function("u64_leading_zeros", I64, 1),
        I32Ctz => function("u32_trailing_zeros", I32, 1),
        I64Ctz => function("u64_trailing_zeros", I64, 1),
        I32Popcnt => function("u32_ones", I32, 1),
        I64Popcnt => function("u64_ones", I64, 1),
        I32WrapI64 => cast("(u32)", I32),
        I32Extend8S => cast("(u32)(i8)", I32),
        I32Extend16S => cast("(u32)(i16)", I32),
        I64ExtendI32U => cast("(u64)", I64),
        I64ExtendI32S | I64Extend32S => cast("(u64)(i32)", I64),
        I64Extend8S => cast("(u64)(i8)", I64),
        I64Extend16S => cast("(u64)(i16)", I64),
        F32ConvertI32S => cast("(f32)(i32)", F32),
        F32ConvertI64S => cast("(f32)(i64)", F32),
        F64ConvertI32S => cast("(f64)(i32)", F64),
        F64ConvertI64S => cast("(f64)(i64)", F64),
        F32ConvertI32U | F32ConvertI64U | F32DemoteF64 => cast("(f32)", F32),
        F64ConvertI32U | F64ConvertI64U | F64PromoteF32 => cast("(f64)", F64),
        I32ReinterpretF32 => function("f32_bits", I32, 1),
        I64ReinterpretF64 => function("f64_bits", I64, 1),
        F32ReinterpretI32 => function("f32_from_bits", F32, 1),
        F64ReinterpretI64 => function("f64_from_bits", F64, 1),
        I32TruncF32S | I32TruncF64S => {
            truncate("(u32)(i32)", I32, "> -2147483649.0", "< 2147483648.0")
        }
        I32TruncF32U | I32TruncF64U => truncate("(u32)", I32, "> -1.0", "< 4294967296.0"),
        I64TruncF32S | I64TruncF64S => {
            truncate("(u64)(i64)", I64, ">= -9223372036854775808.0", "< 9223372036854775808.0")
        }
        I64TruncF32U | I64TruncF64U => truncate("(u64)", I64, "> -1.0", "< 18446744073709551616.0"),
        I32TruncSatF32S | I32TruncSatF64S => function("i32_saturated", I32, 1),
        I32TruncSatF32U | I32TruncSatF64U => function("u32_saturated", I32, 1),
        I64TruncSatF32S | I64TruncSatF64S => function("i64_saturated", I64, 1),
        I64TruncSatF32U | I64TruncSatF64U => function("u64_saturated", I64, 1),
        F32Neg | F64Neg => Negative,
        F32Abs => function("fabsf", F32, 1),
        F64Abs => function("fabs", F64, 1),
        F32Sqrt => function("sqrtf", F32, 1),
        F64Sqrt => function("sqrt", F64, 1),
        F32Ceil => function("ceilf", F32, 1),
        F64Ceil => function("ceil", F64, 1),
        F32Floor => function("floorf", F32, 1),
        F64Floor => function("floor", F64, 1),
        F32Trunc => function("truncf", F32, 1),
        F64Trunc => function("trunc", F64, 1),
        // To the nearest, ties to even, as long as nobody changes the rounding mode.
        F32Nearest => function("rintf", F32, 1),
        F64Nearest => function("rint", F64, 1),
        F32Min => function("f32_min", F32, 2),
        F64Min => function("f64_min", F64, 2),
        F32Max => function("f32_max", F32, 2),
        F64Max => function("f64_max", F64, 2),
        F32Copysign => function("copysignf", F32, 2),
        F64Copysign => function("copysign", F64, 2),
        _ => return None,
    })
}
