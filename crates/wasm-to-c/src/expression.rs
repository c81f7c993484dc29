//! Expressions in C: pure, and without any trap, since what may trap was checked by a statement before.

use wasmparser::{FuncType, ValType};

use crate::data::literal;

/// How tightly an expression holds together.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// A name, a number or a call.
    Primary,
    /// A cast, or a sign.
    Unary,
    Product,
    Sum,
    Comparison,
    /// Everything else, which compilers want in parentheses within another expression.
    Other,
}

/// A value on the stack of WebAssembly.
#[derive(Clone)]
pub struct Expression {
    pub text: String,
    pub level: Level,
    pub value_type: ValType,
    /// The bits of a constant.
    pub constant: Option<u64>,
    /// The opposite of a condition, which has the type int in C.
    pub negation: Option<(String, Level)>,
    /// The variables that it reads.
    pub variables: Vec<String>,
    pub reads_memory: bool,
    pub reads_globals: bool,
}

/// The type of a value in C.
pub fn c_type(value_type: ValType) -> &'static str {
    match value_type {
        ValType::I32 => "u32",
        ValType::I64 => "u64",
        ValType::F32 => "f32",
        ValType::F64 => "f64",
        _ => unreachable!("references are refused"),
    }
}

/// The head of a function in C.
pub fn signature(name: &str, needs_model: bool, function_type: &FuncType) -> String {
    let result = function_type.results().first().map_or("void", |&result| c_type(result));
    let parameters = function_type.params().iter().enumerate();
    let mut parameters: Vec<String> =
        parameters.map(|(i, &parameter)| format!("{} a{i}", c_type(parameter))).collect();
    if needs_model {
        parameters.insert(0, "Model *m".into());
    } else if parameters.is_empty() {
        parameters.push("void".into());
    }
    format!("{result} {name}({})", parameters.join(", "))
}

fn signed_type(value_type: ValType) -> &'static str {
    if value_type == ValType::I32 { "i32" } else { "i64" }
}

impl Expression {
    /// A variable in C.
    pub fn variable(name: String, value_type: ValType) -> Self {
        let variables = vec![name.clone()];
        Expression { variables, ..Self::new(name, Level::Primary, value_type, &[]) }
    }

    pub fn constant(value_type: ValType, bits: u64) -> Self {
        let (text, negative) = literal(value_type, bits);
        let level = if negative { Level::Unary } else { Level::Primary };
        Expression { constant: Some(bits), ..Self::new(text, level, value_type, &[]) }
    }

    /// An expression with operands.
    pub fn new(text: String, level: Level, value_type: ValType, operands: &[&Expression]) -> Self {
        let mut variables: Vec<String> =
            operands.iter().flat_map(|operand| operand.variables.clone()).collect();
        variables.sort();
        variables.dedup();
        Expression {
            text,
            level,
            value_type,
            constant: None,
            negation: None,
            variables,
            reads_memory: operands.iter().any(|operand| operand.reads_memory),
            reads_globals: operands.iter().any(|operand| operand.reads_globals),
        }
    }

    /// The call of a pure function.
    pub fn call(function: &str, value_type: ValType, operands: &[&Expression]) -> Self {
        let arguments: Vec<String> = operands.iter().map(|operand| operand.value()).collect();
        // What is before the name is a cast.
        let level = if function.starts_with('(') { Level::Unary } else { Level::Primary };
        Self::new(format!("{function}({})", arguments.join(", ")), level, value_type, operands)
    }

    /// Whether it is a name, or a number.
    pub fn is_simple(&self) -> bool {
        self.constant.is_some() || self.variables.first().is_some_and(|name| *name == self.text)
    }

    /// The text as a whole value: of a function's argument, or on the right of an assignment.
    pub fn value(&self) -> String {
        self.text.clone()
    }

    /// The text as an operand that holds together at least as `loosest` does. Conditions become unsigned.
    fn operand(&self, loosest: Level) -> String {
        if self.negation.is_some() {
            let cast = if self.value_type == ValType::I32 { "(u32)" } else { "(u64)" };
            return format!("{cast}({})", self.text);
        }
        parenthesized(&self.text, self.level, loosest)
    }

    /// As an operand, with its type, also where it is a number that would be an int.
    fn typed(&self, loosest: Level) -> String {
        match self.constant {
            Some(_) if self.value_type == ValType::I32 && !self.text.ends_with('u') => {
                format!("{}u", self.text)
            }
            Some(_) if self.value_type == ValType::I64 => format!("(u64){}", self.text),
            _ => self.operand(loosest),
        }
    }

    /// As a signed operand.
    fn signed(&self, loosest: Level) -> String {
        match (self.value_type, self.constant) {
            (ValType::I32, Some(bits)) if bits as i32 == i32::MIN => "INT32_MIN".into(),
            (ValType::I32, Some(bits)) => (bits as i32).to_string(),
            (_, Some(bits)) if bits as i64 == i64::MIN => "INT64_MIN".into(),
            (_, Some(bits)) => (bits as i64).to_string(),
            _ => format!(
                "({}){}",
                signed_type(self.value_type),
                self.operand(loosest.min(Level::Unary))
            ),
        }
    }

    /// The operator and the operand that change a variable to this value, such as `+` and `2` for `n1 + 2`.
    pub fn change_of(&self, variable: &str) -> Option<(&str, &str)> {
        let (operator, operand) =
            self.text.strip_prefix(variable)?.strip_prefix(' ')?.split_once(' ')?;
        let mut depth = 0;
        let is_one = operand.chars().all(|character| {
            match character {
                '(' => depth += 1,
                ')' => depth -= 1,
                _ => {}
            }
            depth > 0 || character != ' '
        });
        let is_sum = operator == "+" && self.level == Level::Sum && !is_float(self.value_type);
        let changes = ["+", "-", "*", "/", "&", "|", "^", "<<", ">>"].contains(&operator);
        (changes && (is_one || is_sum)).then_some((operator, operand))
    }

    /// As a condition, and its opposite.
    pub fn condition(&self) -> (String, String) {
        let name = self.variables.first().filter(|_| self.variables.len() == 1);
        match (name, &self.negation) {
            (Some(name), Some(_)) if self.text == format!("{name} != 0") => {
                return (name.clone(), format!("!{name}"));
            }
            (Some(name), Some(_)) if self.text == format!("{name} == 0") => {
                return (format!("!{name}"), name.clone());
            }
            _ => {}
        }
        match &self.negation {
            Some((negation, _)) => (self.text.clone(), negation.clone()),
            None if self.level <= Level::Unary => (self.text.clone(), format!("!{}", self.text)),
            None => (self.text.clone(), format!("!({})", self.text)),
        }
    }

    /// `self == 0`
    pub fn equals_zero(self) -> Self {
        let (text, level, negation) = match &self.negation {
            Some((negation, level)) => (negation.clone(), *level, (self.text.clone(), self.level)),
            None => {
                let operand = self.operand(Level::Sum);
                (
                    format!("{operand} == 0"),
                    Level::Comparison,
                    (format!("{operand} != 0"), Level::Comparison),
                )
            }
        };
        Expression { negation: Some(negation), ..Self::new(text, level, ValType::I32, &[&self]) }
    }

    /// The number of which this is the magnitude, as bits, if a comparison tells finite numbers from others.
    fn compared_as_finite(&self, operator: &str, other: &Self) -> Option<(&str, bool)> {
        const INFINITY: u64 = f64::INFINITY.to_bits();
        const LARGEST: u64 = f64::MAX.to_bits();
        let is_finite = match (operator, other.constant?) {
            ("<", INFINITY) | ("<=", LARGEST) => true,
            (">=", INFINITY) | (">", LARGEST) => false,
            _ => return None,
        };
        let [name] = self.variables.as_slice() else { return None };
        let text = format!("f64_bits({name}) & 0x7fffffffffffffffu");
        (self.text == text).then_some((name, is_finite))
    }

    /// A comparison, such as `"<"`.
    pub fn compare(self, operator: &str, signed: bool, other: Self) -> Self {
        if let Some((name, is_finite)) = self.compared_as_finite(operator, &other) {
            let finite = (format!("f64_is_finite({name})"), Level::Primary);
            let not = (format!("!{}", finite.0), Level::Unary);
            let ((text, level), negation) = if is_finite { (finite, not) } else { (not, finite) };
            let value = Self::new(text, level, ValType::I32, &[&self, &other]);
            return Expression { negation: Some(negation), ..value };
        }
        let side = |side: &Expression| {
            if signed { side.signed(Level::Sum) } else { side.operand(Level::Sum) }
        };
        // Two numbers would be compared as int.
        let left =
            if self.constant.is_some() && !signed { self.typed(Level::Sum) } else { side(&self) };
        let right = side(&other);
        let text = format!("{left} {operator} {right}");
        let negation = match operator {
            "==" => Some("!="),
            "!=" => Some("=="),
            _ if is_float(self.value_type) => None,
            "<" => Some(">="),
            ">" => Some("<="),
            "<=" => Some(">"),
            _ => Some("<"),
        };
        let negation = match negation {
            Some(opposite) => (format!("{left} {opposite} {right}"), Level::Comparison),
            None => (format!("!({text})"), Level::Unary),
        };
        Expression {
            negation: Some(negation),
            ..Self::new(text, Level::Comparison, ValType::I32, &[&self, &other])
        }
    }

    /// An operation with two operands of one type.
    pub fn binary(self, operator: &str, other: Self) -> Self {
        let value_type = self.value_type;
        if let ("&" | "|", Some((not_left, left_level)), Some((not_right, right_level))) =
            (operator, &self.negation, &other.negation)
        {
            let opposite = if operator == "&" { "||" } else { "&&" };
            let side = |text: &str, level| parenthesized(text, level, Level::Comparison);
            let (left, right) = (side(&self.text, self.level), side(&other.text, other.level));
            let text = format!("{left} {operator}{operator} {right}");
            let negation = format!(
                "{} {opposite} {}",
                side(not_left, *left_level),
                side(not_right, *right_level)
            );
            let expression = Self::new(text, Level::Other, value_type, &[&self, &other]);
            return Expression { negation: Some((negation, Level::Other)), ..expression };
        }
        if let ("^", Some(bits)) = (operator, other.constant)
            && bits == all_ones(value_type)
        {
            let text = format!("~{}", self.typed(Level::Unary));
            return Self::new(text, Level::Unary, value_type, &[&self]);
        }
        // The sum of a variable and two numbers.
        if let ("+", ValType::I32, Some(more)) = (operator, value_type, other.constant)
            && let (Level::Sum, [name]) = (self.level, self.variables.as_slice())
            && let Some(number) =
                self.text.strip_prefix(name).and_then(|text| text.strip_prefix(" + "))
            && let Ok(number) = number.parse::<u32>()
        {
            let sum = u64::from(number.wrapping_add(more as u32));
            let variable = Self::variable(name.clone(), value_type);
            return variable.binary("+", Self::constant(value_type, sum));
        }
        let (level, left, right) = match operator {
            "+" | "-" => (Level::Sum, Level::Sum, Level::Product),
            "*" | "/" => (Level::Product, Level::Product, Level::Unary),
            _ => (Level::Other, Level::Unary, Level::Unary),
        };
        let both = self.constant.is_some() && other.constant.is_some() && !is_float(value_type);
        let left = if both { self.typed(left) } else { self.operand(left) };
        let text = match (operator, other.constant) {
            ("&", Some(255)) if self.text.starts_with("U8(") && self.level == Level::Primary => {
                return self;
            }
            ("+", Some(bits)) if negative(value_type, bits) => {
                format!("{left} - {}", bits.wrapping_neg() & all_ones(value_type))
            }
            _ => format!("{left} {operator} {}", other.operand(right)),
        };
        // Compilers may compute in a wider type until there is a cast.
        if value_type == ValType::F32 {
            return Self::new(format!("(f32)({text})"), Level::Unary, value_type, &[&self, &other]);
        }
        Self::new(text, level, value_type, &[&self, &other])
    }

    /// A division of integers, which cannot trap.
    pub fn divide(self, operator: &str, signed: bool, other: Self) -> Self {
        let value_type = self.value_type;
        if !signed {
            let text =
                format!("{} {operator} {}", self.typed(Level::Unary), other.operand(Level::Unary));
            return Self::new(text, Level::Product, value_type, &[&self, &other]);
        }
        if operator == "%" {
            let function =
                if value_type == ValType::I32 { "i32_remainder" } else { "i64_remainder" };
            return Self::call(function, value_type, &[&self, &other]);
        }
        let (left, right) = (self.signed(Level::Unary), other.signed(Level::Unary));
        let text = format!("({})({left} / {right})", c_type(value_type));
        Self::new(text, Level::Unary, value_type, &[&self, &other])
    }

    /// A shift to the left, or to the right, with copies of the sign if `signed`.
    pub fn shift(self, operator: &str, signed: bool, other: Self) -> Self {
        let value_type = self.value_type;
        let mask = if value_type == ValType::I32 { 31 } else { 63 };
        let by = match other.constant {
            Some(bits) => (bits & mask).to_string(),
            None => format!("({} & {mask})", other.operand(Level::Unary)),
        };
        let (text, level) = if signed {
            let left = self.signed(Level::Unary);
            (format!("({})({left} {operator} {by})", c_type(value_type)), Level::Unary)
        } else {
            (format!("{} {operator} {by}", self.typed(Level::Unary)), Level::Other)
        };
        Self::new(text, level, value_type, &[&self, &other])
    }

    /// `-self`
    pub fn negative(self) -> Self {
        let text = format!("-{}", parenthesized(&self.text, self.level, Level::Primary));
        Self::new(text, Level::Unary, self.value_type, &[&self])
    }

    /// A cast, or several, such as `"(u64)(i32)"`.
    pub fn cast(self, casts: &str, value_type: ValType) -> Self {
        let operand = parenthesized(&self.text, self.level, Level::Unary);
        Self::new(format!("{casts}{operand}"), Level::Unary, value_type, &[&self])
    }

    /// `condition ? self : other`
    pub fn select(self, condition: &Self, other: Self) -> Self {
        let both =
            self.constant.is_some() && other.constant.is_some() && !is_float(self.value_type);
        let left = if both { self.typed(Level::Unary) } else { self.operand(Level::Sum) };
        let question = parenthesized(&condition.condition().0, condition.level, Level::Comparison);
        let text = format!("{question} ? {left} : {}", other.operand(Level::Sum));
        Self::new(text, Level::Other, self.value_type, &[condition, &self, &other])
    }

    /// A load from memory, whose address was checked.
    pub fn load(function: &str, base: &Self, offset: u64, value_type: ValType) -> Self {
        let level = if function.starts_with('(') { Level::Unary } else { Level::Primary };
        let text = format!("{function}({}, {offset})", base.text);
        Expression { reads_memory: true, ..Self::new(text, level, value_type, &[base]) }
    }
}

fn parenthesized(text: &str, level: Level, loosest: Level) -> String {
    if level > loosest { format!("({text})") } else { text.to_owned() }
}

fn is_float(value_type: ValType) -> bool {
    matches!(value_type, ValType::F32 | ValType::F64)
}

fn all_ones(value_type: ValType) -> u64 {
    match value_type {
        ValType::I32 => u64::from(u32::MAX),
        _ => u64::MAX,
    }
}

/// Whether an integer is negative, and not far from zero.
fn negative(value_type: ValType, bits: u64) -> bool {
    match value_type {
        ValType::I32 => (-65536..0).contains(&(bits as i32)),
        ValType::I64 => (-65536..0).contains(&(bits as i64)),
        _ => false,
    }
}
