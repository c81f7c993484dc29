//! One function: from the operators of a stack machine to statements and expressions.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use wasmparser::{BlockType, FuncType, Operator, ValType};

use crate::Error;
use crate::calls::Calls;
use crate::expression::{Expression, Level, c_type, signature};
use crate::facts::{Arguments, Facts};
use crate::locals::Locals;
use crate::memory::{Access, access};
use crate::module::{Module, number};
use crate::names::{mentions, sanitized};
use crate::numeric;
use crate::simplify::simplify;
use crate::statement::{Condition, Statement, Writer};

/// A block, a loop, an `if` or the body of the function, while it is translated.
struct Frame {
    kind: Kind,
    label: u32,
    /// Where the values of its type go.
    parameters: Vec<Expression>,
    results: Vec<Expression>,
    /// How many values were on the stack before it.
    height: usize,
    /// What was known of addresses before it, and what is known at every jump to its end.
    facts: Facts,
    facts_behind: Option<Facts>,
    /// The statements before it.
    before: Vec<Statement>,
    set_in: Vec<String>,
}

enum Kind {
    Body,
    Block,
    Loop,
    If(Condition),
    Else(Condition, Vec<Statement>),
}

pub struct Function<'a> {
    module: &'a Module<'a>,
    calls: &'a Calls,
    names: &'a BTreeMap<u32, String>,
    index: u32,
    function_type: &'a FuncType,
    /// The types of all locals, and what is known of their use.
    types: Vec<ValType>,
    locals: Locals,
    stack: Vec<Expression>,
    frames: Vec<Frame>,
    statements: Vec<Statement>,
    facts: Facts,
    /// What is known of the arguments of the functions that are called.
    passed: &'a mut Arguments,
    /// The checks since the last label or jump, which a later check extends: a trap may be found earlier than in
    /// WebAssembly, but in no other case.
    checks: HashMap<String, usize>,
    /// The variables for the values of blocks.
    variables: Vec<(ValType, String)>,
    labels: u32,
    temporaries: u32,
    /// Traps that end the function at a label.
    traps: BTreeSet<&'static str>,
}

/// Linkers make the first global the stack pointer.
const STACK_POINTER: u32 = 0;

/// The macros at the end of functions that set a trap. Each has a label, its name in lower case.
const OUT_OF_BOUNDS: &str = "OUT_OF_BOUNDS";
const UNREACHABLE: &str = "UNREACHABLE";
const BAD_DIVISION: &str = "BAD_DIVISION";
const BAD_CONVERSION: &str = "BAD_CONVERSION";
const TOO_DEEP: &str = "TOO_DEEP";

impl<'a> Function<'a> {
    /// The definition of a function in C, given what is known of arguments. Adds to what is passed to other functions.
    pub fn translate(
        module: &'a Module<'a>,
        calls: &'a Calls,
        names: &'a BTreeMap<u32, String>,
        arguments: &Arguments,
        passed: &'a mut Arguments,
        index: u32,
    ) -> Result<String, Error> {
        let body = &module.bodies[index as usize - module.imports.len()];
        let operators = body.get_operators_reader()?.into_iter().collect::<Result<Vec<_>, _>>()?;
        let function_type = module.function_type(index);
        let mut types = function_type.params().to_vec();
        for local in body.get_locals_reader()? {
            let (count, value_type) = local?;
            types.extend(std::iter::repeat_n(value_type, count as usize));
        }
        types.iter().try_for_each(number)?;
        let mut function = Function {
            module,
            calls,
            names,
            index,
            function_type,
            locals: Locals::new(&operators, function_type.params().len() as u32),
            types,
            stack: Vec::new(),
            frames: Vec::new(),
            statements: Vec::new(),
            facts: Facts::default(),
            passed,
            checks: HashMap::new(),
            variables: Vec::new(),
            labels: 0,
            temporaries: 0,
            traps: BTreeSet::new(),
        };
        for (parameter, end) in (0..).zip(arguments.of(index)).filter(|&(_, end)| end > 0) {
            let name = function.local_name(parameter);
            function.facts.set_inside(&name, end);
        }
        function.body(&operators)?;
        Ok(function.definition())
    }

    fn body(&mut self, operators: &[Operator]) -> Result<(), Error> {
        self.enter(Kind::Body, &[], self.function_type.results(), None);
        // How many blocks began since the code became unreachable.
        let mut unreachable: Option<u32> = None;
        for (place, operator) in operators.iter().enumerate() {
            match (&mut unreachable, operator) {
                (
                    Some(depth),
                    Operator::Block { .. } | Operator::Loop { .. } | Operator::If { .. },
                ) => *depth += 1,
                (Some(0), Operator::Else) | (Some(0), Operator::End) => {
                    let reached = self.leave(matches!(operator, Operator::Else), false);
                    unreachable = (!reached).then_some(0);
                }
                (Some(depth), Operator::End) => *depth -= 1,
                (Some(_), _) => {}
                (None, Operator::Else | Operator::End) => {
                    let reached = self.leave(matches!(operator, Operator::Else), true);
                    unreachable = (!reached).then_some(0);
                }
                (None, operator) => {
                    if !self.operator(place, operator)? {
                        unreachable = Some(0);
                    }
                }
            }
        }
        Ok(())
    }

    /// The text of the whole function.
    fn definition(mut self) -> String {
        let own_traits = &self.calls.traits[&self.index];
        let parameters: Vec<ValType> = self.function_type.params().to_vec();
        let head = signature(&self.names[&self.index], own_traits.needs_model, self.function_type);
        let body = Writer::function(simplify(std::mem::take(&mut self.statements)));
        let mut text = format!("static {head} {{\n");
        for (value_type, mut names) in self.declarations() {
            // Some are only for code that is not reached.
            names.retain(|name| mentions(&body, name));
            if names.is_empty() {
                continue;
            }
            text.push_str(&format!(
                "\t{} {};\n",
                c_type(value_type),
                names.join(" = 0, ") + " = 0"
            ));
        }
        if own_traits.counts_depth {
            text.push_str("\tCOUNT_DEPTH;\n");
            self.traps.insert(TOO_DEEP);
        }
        for parameter in (0..parameters.len()).map(|parameter| format!("a{parameter}")) {
            if !mentions(&body, &parameter) {
                text.push_str(&format!("\t(void){parameter};\n"));
            }
        }
        text.push_str(&body);
        let zero = if self.function_type.results().is_empty() { "" } else { " 0" };
        for trap in &self.traps {
            text.push_str(&format!("{trap}{zero};\n"));
        }
        text.push_str("}\n");
        text
    }

    fn declarations(&self) -> BTreeMap<ValType, Vec<String>> {
        let mut declarations: BTreeMap<ValType, Vec<String>> = BTreeMap::new();
        let mut add = |value_type, name| declarations.entry(value_type).or_default().push(name);
        for &local in
            self.locals.declared_before.iter().filter(|local| self.locals.read.contains(local))
        {
            add(self.types[local as usize], self.local_name(local));
        }
        for (value_type, name) in &self.variables {
            add(*value_type, name.clone());
        }
        declarations
    }

    fn local_name(&self, local: u32) -> String {
        if (local as usize) < self.function_type.params().len() {
            return format!("a{local}");
        }
        let letter = match self.types[local as usize] {
            ValType::I32 => 'n',
            ValType::I64 => 'w',
            ValType::F32 => 's',
            _ => 'x',
        };
        format!("{letter}{local}")
    }

    fn pop(&mut self) -> Expression {
        self.stack.pop().expect("validated: the stack has a value")
    }

    fn line(&mut self, line: String) {
        self.statements.push(Statement::Line(line));
    }

    /// Puts a value into a variable of its own.
    fn temporary(&mut self, expression: Expression) -> Expression {
        if expression.is_simple() {
            return expression;
        }
        let name = format!("t{}", self.temporaries);
        self.temporaries += 1;
        self.line(format!("{} {name} = {};", c_type(expression.value_type), expression.text));
        Expression::variable(name, expression.value_type)
    }

    /// Computes now what is on the stack and would have another value later.
    fn settle(&mut self, changes: impl Fn(&Expression) -> bool) {
        for i in 0..self.stack.len() {
            if changes(&self.stack[i]) {
                let expression = self.stack[i].clone();
                let name = format!("t{}", self.temporaries);
                self.temporaries += 1;
                self.line(format!(
                    "{} {name} = {};",
                    c_type(expression.value_type),
                    expression.text
                ));
                self.stack[i] = Expression::variable(name, expression.value_type);
            }
        }
    }

    fn assign(&mut self, name: &str, declares: Option<ValType>, value: Expression) {
        let name_owned = name.to_owned();
        self.settle(|expression| expression.variables.contains(&name_owned));
        self.facts.set(name, &value.text);
        self.checks.remove(name);
        // The result of a call goes to the variable at once.
        if let Some(Statement::Call { declares: own, result: Some(result), .. }) =
            self.statements.last_mut()
            && *result == value.text
            && self.stack.iter().all(|other| !other.variables.contains(result))
        {
            *result = name.to_owned();
            *own = declares.map(c_type);
            return;
        }
        self.line(match (declares, value.change_of(name)) {
            (Some(value_type), _) => format!("{} {name} = {};", c_type(value_type), value.text),
            (None, Some((operator, operand))) => format!("{name} {operator}= {operand};"),
            (None, None) => format!("{name} = {};", value.text),
        });
        // This is the stack frame of the function.
        if self.module.heap_base.is_some()
            && let Some(size) =
                value.text.strip_prefix("m->g0 - ").and_then(|size| size.parse().ok())
            && size <= self.module.memory_size
        {
            self.check(name, size);
        }
    }

    /// Makes the last statements one with the one that sets the stack pointer, if they declare and check the frame.
    fn takes_frame(&mut self, name: &str) -> bool {
        let [.., Statement::Line(line), Statement::Check { address, end }] =
            self.statements.as_slice()
        else {
            return false;
        };
        if address != name || *line != format!("u32 {name} = m->g0 - {end};") {
            return false;
        }
        let frame = format!("FRAME({name}, {end});");
        self.statements.truncate(self.statements.len() - 2);
        self.checks.remove(name);
        self.line(frame);
        true
    }

    fn set_local(&mut self, place: usize, local: u32) {
        let value = self.pop();
        if !self.locals.read.contains(&local) {
            return self.discard(&value);
        }
        let name = self.local_name(local);
        let declares = self.locals.declared_at.get(&place).map(|&local| self.types[local as usize]);
        self.assign(&name, declares, value);
    }

    /// A value that is not needed; compilers warn of variables that are only set.
    fn discard(&mut self, value: &Expression) {
        if let Some(Statement::Call { declares: declares @ Some(_), result, .. }) =
            self.statements.last_mut()
            && result.as_ref() == Some(&value.text)
        {
            (*declares, *result) = (None, None);
            return;
        }
        if value.constant.is_none() && value.is_simple() {
            self.line(format!("(void){};", value.text));
        }
    }

    /// Ends the function with a trap if the condition holds.
    fn trap_if(&mut self, condition: String, trap: &'static str) {
        self.traps.insert(trap);
        self.line(format!("if ({condition}) goto {};", trap.to_lowercase()));
    }

    /// Checks that so many bytes from the address in a variable are in memory, if that is not known.
    fn check(&mut self, name: &str, end: u64) {
        self.traps.insert(OUT_OF_BOUNDS);
        self.facts.set_inside(name, end);
        match self.checks.get(name).and_then(|&check| self.statements.get_mut(check)) {
            Some(Statement::Check { end: known, .. }) if end <= self.module.memory_size => {
                *known = end
            }
            _ => {
                self.checks.insert(name.to_owned(), self.statements.len());
                self.statements.push(Statement::Check { address: name.to_owned(), end });
            }
        }
    }

    /// The address of an access and the offset from it, after a check that it is in memory.
    fn address(&mut self, base: Expression, offset: u64, width: u64) -> (Expression, u64) {
        let end = offset + width;
        let size = self.module.memory_size;
        if let Some(address) = base.constant
            && address + end <= size
        {
            return (Expression::constant(ValType::I32, address + offset), 0);
        }
        let (base, offset, end) = match self.facts.sum(&base.text) {
            Some((name, more)) if end + more <= size => {
                let variable = Expression::variable(name.to_owned(), ValType::I32);
                (variable, offset + more, end + more)
            }
            _ => (base, offset, end),
        };
        if self.facts.inside(&base.text) >= end {
            return (base, offset);
        }
        let base = if base.constant.is_some() {
            // The compiler would see that the check always fails.
            let name = format!("t{}", self.temporaries);
            self.temporaries += 1;
            self.line(format!("u32 {name} = {};", base.text));
            Expression::variable(name, ValType::I32)
        } else {
            self.temporary(base)
        };
        if end > size {
            self.trap_if(format!("MODEL_MEMORY_SIZE < {end}u"), OUT_OF_BOUNDS);
        }
        self.check(&base.text, end);
        (base, offset)
    }

    fn access(&mut self, operation: Access) {
        let value = operation.is_store.then(|| self.pop());
        let base = self.pop();
        let (base, offset) = self.address(base, operation.argument.offset, operation.width);
        let Some(value) = value else {
            self.stack.push(Expression::load(
                operation.function,
                &base,
                offset,
                operation.value_type,
            ));
            return;
        };
        self.settle(|expression| expression.reads_memory);
        let narrow = operation.value_type == ValType::I64 && operation.width < 8;
        let value = if narrow { value.cast("(u32)", ValType::I32) } else { value };
        self.line(format!("{}({}, {offset}, {});", operation.function, base.text, value.text));
    }

    /// Begins a block of the type.
    fn enter(
        &mut self,
        kind: Kind,
        parameters: &[ValType],
        results: &[ValType],
        place: Option<usize>,
    ) {
        let label = self.labels;
        self.labels += 1;
        let set =
            place.and_then(|place| self.locals.set_in.get(&place)).cloned().unwrap_or_default();
        let set_in: Vec<String> = set.iter().map(|&local| self.local_name(local)).collect();
        // What is on the stack is needed after the block, or in it.
        self.settle(|expression| {
            expression.reads_memory
                || expression.reads_globals
                || expression.variables.iter().any(|variable| set_in.contains(variable))
        });
        let arguments = self.stack.split_off(self.stack.len() - parameters.len());
        let parameters = match kind {
            Kind::Loop => {
                let variables = self.block_variables('p', label, parameters);
                self.assign_all(&variables, arguments);
                variables
            }
            _ => arguments,
        };
        let is_body = matches!(kind, Kind::Body);
        let results = if is_body { Vec::new() } else { self.block_variables('r', label, results) };
        let repeats = matches!(kind, Kind::Loop);
        self.frames.push(Frame {
            kind,
            label,
            parameters: parameters.clone(),
            results,
            height: self.stack.len(),
            facts: self.facts.clone(),
            facts_behind: None,
            before: std::mem::take(&mut self.statements),
            set_in,
        });
        self.stack.extend(parameters);
        self.checks.clear();
        if repeats {
            // Another turn may have set them.
            for name in &self.frames.last().expect("it was pushed").set_in {
                self.facts.forget(name);
            }
        }
    }

    fn block_variables(&mut self, letter: char, label: u32, types: &[ValType]) -> Vec<Expression> {
        let mut variables = Vec::new();
        for (i, &value_type) in types.iter().enumerate() {
            let name =
                if i == 0 { format!("{letter}{label}") } else { format!("{letter}{label}_{i}") };
            self.variables.push((value_type, name.clone()));
            variables.push(Expression::variable(name, value_type));
        }
        variables
    }

    /// Remembers what is known at a jump to the end of a block.
    fn join(&mut self, frame: usize) {
        match &mut self.frames[frame].facts_behind {
            Some(facts) => facts.meet(&self.facts),
            none => *none = Some(self.facts.clone()),
        }
    }

    fn assign_all(&mut self, variables: &[Expression], values: Vec<Expression>) {
        // A variable may be needed for the value of another.
        let several = values.len() > 1;
        let values: Vec<Expression> = values
            .into_iter()
            .map(|value| if several && value.constant.is_none() { self.copy(value) } else { value })
            .collect();
        for (variable, value) in variables.iter().zip(values) {
            if variable.text != value.text {
                self.line(format!("{} = {};", variable.text, value.text));
            }
        }
    }

    /// A value in a variable that nothing changes.
    fn copy(&mut self, value: Expression) -> Expression {
        let name = format!("t{}", self.temporaries);
        self.temporaries += 1;
        self.line(format!("{} {name} = {};", c_type(value.value_type), value.text));
        Expression::variable(name, value.value_type)
    }

    /// Ends a block, or the first branch of an `if`. Returns whether what follows is reached.
    fn leave(&mut self, is_else: bool, reachable: bool) -> bool {
        if self.frames.len() == 1 {
            if reachable {
                self.return_values();
            }
            return false;
        }
        let innermost = self.frames.len() - 1;
        let results = self.frames[innermost].results.clone();
        if reachable {
            let values = self.stack.split_off(self.stack.len() - results.len());
            self.assign_all(&results, values);
            self.join(innermost);
        }
        self.checks.clear();
        let frame = &mut self.frames[innermost];
        self.stack.truncate(frame.height);
        if is_else {
            self.facts = frame.facts.clone();
            let then = std::mem::take(&mut self.statements);
            let kind = std::mem::replace(&mut frame.kind, Kind::Block);
            let Kind::If(condition) = kind else { unreachable!("validated: else is in an if") };
            frame.kind = Kind::Else(condition, then);
            self.stack.extend(frame.parameters.clone());
            return true;
        }
        if matches!(frame.kind, Kind::If(_)) {
            self.facts = frame.facts.clone();
            self.join(innermost);
        }
        let mut frame = self.frames.pop().expect("there is a block");
        let facts_behind = frame.facts_behind.take();
        let reached = facts_behind.is_some();
        self.facts = facts_behind.unwrap_or_default();
        // Without an else, the parameters are the results.
        let mut otherwise = Vec::new();
        if matches!(frame.kind, Kind::If(_)) && !frame.results.is_empty() {
            let then = std::mem::take(&mut self.statements);
            self.assign_all(&frame.results, frame.parameters.clone());
            otherwise = std::mem::replace(&mut self.statements, then);
        }
        let body = std::mem::replace(&mut self.statements, std::mem::take(&mut frame.before));
        let label = frame.label;
        self.statements.push(match frame.kind {
            Kind::Loop => Statement::Loop { label, body },
            Kind::If(condition) => {
                let branches = Statement::If { condition, then: body, otherwise };
                Statement::Block { label, body: vec![branches] }
            }
            Kind::Else(condition, then) => {
                let branches = Statement::If { condition, then, otherwise: body };
                Statement::Block { label, body: vec![branches] }
            }
            Kind::Block | Kind::Body => Statement::Block { label, body },
        });
        self.stack.extend(frame.results);
        reached
    }

    fn return_values(&mut self) {
        let counts_depth = self.calls.traits[&self.index].counts_depth;
        if counts_depth {
            // Nothing on the stack reads the depth.
            self.line("m->depth--;".into());
        }
        let value = self.function_type.results().first().map(|_| self.pop());
        // The caller checks the trap of a call that is the last.
        if let Some(Statement::Call { declares, result, call, checked }) =
            self.statements.last_mut()
        {
            match &value {
                Some(value) if result.as_ref() == Some(&value.text) && declares.is_some() => {
                    let line = format!("return {call};");
                    self.statements.pop();
                    return self.statements.push(Statement::Exit(line));
                }
                Some(_) => {}
                None => *checked = None,
            }
        }
        self.statements.push(Statement::Exit(match value {
            Some(value) => format!("return {};", value.text),
            None if self.frames.len() == 1 && self.traps.is_empty() && !counts_depth => return,
            None => "return;".into(),
        }));
    }

    /// Goes to a block with the values on the stack, which stay there.
    fn branch(&mut self, depth: u32) {
        let target = self.frames.len() - 1 - depth as usize;
        let frame = &self.frames[target];
        if matches!(frame.kind, Kind::Body) {
            let stack = self.stack.clone();
            self.return_values();
            if !matches!(self.statements.last(), Some(Statement::Exit(_))) {
                self.statements.push(Statement::Exit("return;".into()));
            }
            self.stack = stack;
            return;
        }
        if !matches!(frame.kind, Kind::Loop) {
            self.join(target);
        }
        let frame = &self.frames[target];
        let label = frame.label;
        let variables = if matches!(frame.kind, Kind::Loop) {
            frame.parameters.clone()
        } else {
            frame.results.clone()
        };
        let values = self.stack[self.stack.len() - variables.len()..].to_vec();
        self.assign_all(&variables, values);
        self.statements.push(Statement::Goto { condition: None, label });
    }

    /// How many values a branch takes along.
    fn arity(&self, depth: u32) -> usize {
        let frame = &self.frames[self.frames.len() - 1 - depth as usize];
        match frame.kind {
            Kind::Body => self.function_type.results().len(),
            Kind::Loop => frame.parameters.len(),
            _ => frame.results.len(),
        }
    }

    /// The statements of a branch, which is not yet taken.
    fn branch_aside(&mut self, depth: u32) -> Vec<Statement> {
        let before = std::mem::take(&mut self.statements);
        self.branch(depth);
        std::mem::replace(&mut self.statements, before)
    }

    fn branch_if(&mut self, depth: u32, condition: Expression) {
        // The values are needed twice.
        let arity = self.arity(depth);
        let begin = self.stack.len() - arity;
        for i in begin..self.stack.len() {
            let value = self.stack[i].clone();
            self.stack[i] = self.temporary(value);
        }
        let (holds, fails) = condition.condition();
        let condition = Condition { holds, fails };
        let mut then = self.branch_aside(depth);
        self.checks.clear();
        let statement = match then.as_slice() {
            [Statement::Goto { condition: None, label }] => {
                Statement::Goto { condition: Some(condition), label: *label }
            }
            _ => {
                Statement::If { condition, then: std::mem::take(&mut then), otherwise: Vec::new() }
            }
        };
        self.statements.push(statement);
    }

    fn branch_table(&mut self, targets: &wasmparser::BrTable) -> Result<(), Error> {
        let value = self.pop();
        let mut depths = targets.targets().collect::<Result<Vec<_>, _>>()?;
        depths.push(targets.default());
        let arity = self.arity(targets.default());
        for i in self.stack.len() - arity..self.stack.len() {
            let value = self.stack[i].clone();
            self.stack[i] = self.temporary(value);
        }
        // Branches that do more than go to a label are blocks behind the switch.
        let mut labels: HashMap<u32, u32> = HashMap::new();
        let mut more = Vec::new();
        for &depth in &depths {
            if labels.contains_key(&depth) {
                continue;
            }
            let statements = self.branch_aside(depth);
            let label = match statements.as_slice() {
                [Statement::Goto { condition: None, label }] => *label,
                _ => {
                    self.labels += 1;
                    more.push((self.labels - 1, statements));
                    self.labels - 1
                }
            };
            labels.insert(depth, label);
        }
        let labels = depths.iter().map(|depth| labels[depth]).collect();
        let mut inner = vec![Statement::Switch { value: value.text, labels }];
        for (label, statements) in more {
            inner = vec![Statement::Block { label, body: inner }];
            inner.extend(statements);
        }
        self.statements.extend(inner);
        Ok(())
    }

    /// Calls a function, with the instance if it needs it.
    fn call(
        &mut self,
        name: &str,
        function_type: &FuncType,
        needs_model: bool,
        traps: bool,
        pointer: Option<Expression>,
    ) {
        let values = self.stack.split_off(self.stack.len() - function_type.params().len());
        let model = needs_model.then(|| "m".to_owned());
        let arguments = model
            .into_iter()
            .chain(pointer.map(|pointer| pointer.text))
            .chain(values.iter().map(|value| value.text.clone()));
        let call = format!("{name}({})", arguments.collect::<Vec<_>>().join(", "));
        let result = function_type.results().first().copied();
        // A pure function is an expression.
        if let (false, Some(result)) = (needs_model, result) {
            let operands: Vec<&Expression> = values.iter().collect();
            let value = Expression::new(call, Level::Primary, result, &operands);
            let value = self.temporary(value);
            return self.stack.push(value);
        }
        self.settle(|expression| expression.reads_memory || expression.reads_globals);
        let checked =
            traps.then_some(if self.function_type.results().is_empty() { "TRY" } else { "TRY0" });
        let name = result.map(|_| format!("t{}", self.temporaries));
        self.temporaries += 1;
        self.statements.push(Statement::Call {
            declares: result.map(c_type),
            result: name.clone(),
            call,
            checked,
        });
        if let (Some(name), Some(value_type)) = (name, result) {
            self.stack.push(Expression::variable(name, value_type));
        }
    }

    /// How many bytes from an address on are known to be in memory.
    fn inside(&self, address: &Expression) -> u64 {
        match (address.constant, self.facts.sum(&address.text)) {
            (Some(address), _) => self.module.memory_size.saturating_sub(address),
            (None, Some((name, offset))) => self.facts.inside(name).saturating_sub(offset),
            (None, None) => 0,
        }
    }

    /// The parameters and the results of a block.
    fn block_type(&self, block_type: BlockType) -> Result<(Vec<ValType>, Vec<ValType>), Error> {
        let types = match block_type {
            BlockType::Empty => (Vec::new(), Vec::new()),
            BlockType::Type(value_type) => (Vec::new(), vec![value_type]),
            BlockType::FuncType(index) => {
                let function_type = &self.module.types[index as usize];
                (function_type.params().to_vec(), function_type.results().to_vec())
            }
        };
        types.0.iter().chain(&types.1).try_for_each(number)?;
        Ok(types)
    }

    /// Translates an operator. Returns whether the next one is reached.
    fn operator(&mut self, place: usize, operator: &Operator) -> Result<bool, Error> {
        if let Some(operation) = access(operator) {
            self.access(operation);
            return Ok(true);
        }
        match operator {
            Operator::Nop => {}
            Operator::Unreachable => {
                self.traps.insert(UNREACHABLE);
                // A function that never returns has set the trap.
                let last = self.statements.pop_if(|last| matches!(last, Statement::Call { .. }));
                self.statements.push(Statement::Exit(match last {
                    Some(Statement::Call { call, .. }) => format!("NEVER_RETURNS({call});"),
                    _ => "goto unreachable;".into(),
                }));
                return Ok(false);
            }
            Operator::Block { blockty } | Operator::Loop { blockty } => {
                let (parameters, results) = self.block_type(*blockty)?;
                let kind = if matches!(operator, Operator::Block { .. }) {
                    Kind::Block
                } else {
                    Kind::Loop
                };
                self.enter(kind, &parameters, &results, Some(place));
            }
            Operator::If { blockty } => {
                let (holds, fails) = self.pop().condition();
                let (parameters, results) = self.block_type(*blockty)?;
                self.enter(
                    Kind::If(Condition { holds, fails }),
                    &parameters,
                    &results,
                    Some(place),
                );
            }
            Operator::Br { relative_depth } => {
                self.branch(*relative_depth);
                return Ok(false);
            }
            Operator::BrIf { relative_depth } => {
                let condition = self.pop();
                self.branch_if(*relative_depth, condition);
            }
            Operator::BrTable { targets } => {
                self.branch_table(targets)?;
                return Ok(false);
            }
            Operator::Return => {
                self.branch(self.frames.len() as u32 - 1);
                return Ok(false);
            }
            Operator::Call { function_index } => {
                let traits = &self.calls.traits[function_index];
                let function_type = self.module.function_type(*function_index);
                let name = &self.names[function_index];
                let first = self.stack.len() - function_type.params().len();
                let inside = self.stack[first..].iter().map(|argument| self.inside(argument));
                self.passed.add(*function_index, inside.collect());
                self.call(name, function_type, traits.needs_model, traits.traps, None);
            }
            Operator::CallIndirect { type_index, table_index: 0 } => {
                let pointer = self.pop();
                let function_type = &self.module.types[*type_index as usize];
                let first = self.module.types.iter().position(|other| other == function_type);
                let name = format!("call_pointer_{}", first.expect("a type equals itself"));
                self.call(&name, function_type, true, true, Some(pointer));
            }
            Operator::Drop => {
                let value = self.pop();
                self.discard(&value);
            }
            Operator::Select => {
                let (condition, other, value) = (self.pop(), self.pop(), self.pop());
                self.stack.push(value.select(&condition, other));
            }
            Operator::LocalGet { local_index } => {
                let value_type = self.types[*local_index as usize];
                self.stack.push(Expression::variable(self.local_name(*local_index), value_type));
            }
            Operator::LocalSet { local_index } => self.set_local(place, *local_index),
            Operator::LocalTee { local_index } if self.locals.read.contains(local_index) => {
                self.set_local(place, *local_index);
                let value_type = self.types[*local_index as usize];
                self.stack.push(Expression::variable(self.local_name(*local_index), value_type));
            }
            Operator::LocalTee { .. } => {}
            Operator::GlobalGet { global_index } => {
                let value_type = self.module.globals[*global_index as usize].value_type;
                let value =
                    Expression::new(format!("m->g{global_index}"), Level::Primary, value_type, &[]);
                self.stack.push(Expression { reads_globals: true, ..value });
            }
            Operator::GlobalSet { global_index } => {
                let value = self.pop();
                self.settle(|expression| expression.reads_globals);
                if !(*global_index == STACK_POINTER && self.takes_frame(&value.text)) {
                    self.line(format!("m->g{global_index} = {};", value.text));
                }
            }
            Operator::MemorySize { .. } => {
                let value = Expression::new("m->pages".into(), Level::Primary, ValType::I32, &[]);
                self.stack.push(Expression { reads_globals: true, ..value });
            }
            Operator::MemoryGrow { .. } => {
                let pages = self.pop();
                self.settle(|expression| expression.reads_globals);
                let value = Expression::call(
                    "memory_grow",
                    ValType::I32,
                    &[&Expression::variable("m".into(), ValType::I32), &pages],
                );
                let value = self.copy(value);
                self.stack.push(value);
            }
            Operator::MemoryCopy { .. } | Operator::MemoryFill { .. } => {
                let (size, from, to) = (self.pop(), self.pop(), self.pop());
                self.settle(|expression| expression.reads_memory);
                let is_fill = matches!(operator, Operator::MemoryFill { .. });
                let name = if is_fill { "FILL" } else { "COPY" };
                self.traps.insert(OUT_OF_BOUNDS);
                self.line(format!("{name}({}, {}, {});", to.text, from.text, size.text));
            }
            operator => return self.numeric(operator),
        }
        Ok(true)
    }

    fn numeric(&mut self, operator: &Operator) -> Result<bool, Error> {
        use numeric::Operation;
        if let Some((value_type, bits)) = numeric::constant(operator) {
            self.stack.push(Expression::constant(value_type, bits));
            return Ok(true);
        }
        let Some(operation) = numeric::operation(operator) else {
            let name = format!("{operator:?}");
            let name = sanitized(name.split([' ', '{']).next().unwrap_or(&name));
            return Err(Error(format!(
                "{}: the instruction {name} is not translated",
                self.names[&self.index]
            )));
        };
        let second = operation.is_binary().then(|| self.pop());
        let first = self.pop();
        let (first, second) = match (&operation, second) {
            (Operation::Divide { operator, signed }, Some(divisor)) => {
                let signed_division = *signed && *operator == "/";
                let (first, divisor) = match divisor.constant {
                    Some(bits)
                        if bits != 0
                            && !(signed_division
                                && numeric::is_minus_one(first.value_type, bits)) =>
                    {
                        (first, divisor)
                    }
                    // In variables, so that the compiler does not see a division by zero.
                    Some(_) => (self.copy(first), self.copy(divisor)),
                    None if signed_division => (self.temporary(first), self.temporary(divisor)),
                    None => (first, self.temporary(divisor)),
                };
                if divisor.constant.is_none() {
                    self.trap_if(format!("{} == 0", divisor.text), BAD_DIVISION);
                    if signed_division {
                        let (min, one) = match first.value_type {
                            ValType::I32 => ("0x80000000u", "UINT32_MAX"),
                            _ => ("0x8000000000000000u", "UINT64_MAX"),
                        };
                        let overflows =
                            format!("{} == {min} && {} == {one}", first.text, divisor.text);
                        self.trap_if(overflows, BAD_DIVISION);
                    }
                }
                (first, Some(divisor))
            }
            (Operation::Truncate { above, below, .. }, _) => {
                let first = self.temporary(first);
                self.trap_if(format!("!({0} {above} && {0} {below})", first.text), BAD_CONVERSION);
                (first, None)
            }
            (_, second) => (first, second),
        };
        self.stack.push(operation.apply(first, second));
        Ok(true)
    }
}
