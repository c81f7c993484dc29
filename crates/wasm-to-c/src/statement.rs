//! Statements, and how they are written: blocks of WebAssembly become `if`, `for`, `break` and `continue` where the
//! way is the same, and labels with `goto` elsewhere.

use std::collections::BTreeSet;
use std::fmt::Write;

use crate::names::mentions;

/// A condition and its opposite.
pub struct Condition {
    pub holds: String,
    pub fails: String,
}

pub enum Statement {
    /// Ends with a semicolon.
    Line(String),
    /// The same, but nothing after it is reached.
    Exit(String),
    /// A call, whose result goes to a variable; `declares` is its type if this is its declaration. `checked` is the macro
    /// that leaves the function if the call had a trap.
    Call {
        declares: Option<&'static str>,
        result: Option<String>,
        call: String,
        checked: Option<&'static str>,
    },
    /// Leaves the function unless `end` bytes are in memory from the address on.
    Check {
        address: String,
        end: u64,
    },
    Goto {
        condition: Option<Condition>,
        label: u32,
    },
    /// The label is at the end.
    Block {
        label: u32,
        body: Vec<Statement>,
    },
    /// The label is at the beginning.
    Loop {
        label: u32,
        body: Vec<Statement>,
    },
    If {
        condition: Condition,
        then: Vec<Statement>,
        otherwise: Vec<Statement>,
    },
    /// Goes to one of the labels, or to the last.
    Switch {
        value: String,
        labels: Vec<u32>,
    },
}

use Statement::{Block, Call, Check, Exit, Goto, If, Line, Loop, Switch};

/// Deeper statements are not indented any more; compilers allow 127 levels.
const DEEPEST: usize = 16;

/// What follows a jump under a condition becomes an `if` up to here; deeper it stays behind the jump.
const DEEPEST_REST: usize = 6;

/// Where a statement is.
#[derive(Clone, Copy)]
struct Place<'a> {
    depth: usize,
    /// The labels that are behind the statement.
    next: &'a [u32],
    /// The label of the innermost loop, where `continue` goes.
    next_turn: Option<u32>,
    /// The labels behind the innermost loop or switch, where `break` goes.
    behind: &'a [u32],
}

/// Writes statements, and remembers which labels they need.
#[derive(Default)]
pub struct Writer {
    pub text: String,
    /// Checks, which go to the line of the access behind them.
    checks: String,
    labels: BTreeSet<u32>,
}

impl Writer {
    /// Writes the body of a function.
    pub fn function(body: Vec<Statement>) -> String {
        let mut writer = Writer::default();
        writer.list(body, Place { depth: 1, next: &[], next_turn: None, behind: &[] });
        writer.text
    }

    fn line(&mut self, depth: usize, line: &str) {
        let line = std::mem::take(&mut self.checks) + line;
        let _ =
            writeln!(self.text, "{:\t<width$}{}", "", line.trim_end(), width = depth.min(DEEPEST));
    }

    fn list(&mut self, statements: Vec<Statement>, place: Place) {
        self.statements(statements, place);
        self.end_checks(place.depth);
    }

    /// Writes the checks that no access follows.
    fn end_checks(&mut self, depth: usize) {
        if !self.checks.is_empty() {
            self.line(depth, "");
        }
    }

    fn statements(&mut self, statements: Vec<Statement>, place: Place) {
        let mut statements = statements.into_iter();
        while let Some(statement) = statements.next() {
            let last = statements.len() == 0;
            let next = if last { place.next } else { &[] };
            match statement {
                // What follows a jump to the end is what happens if the condition fails.
                Goto { condition: Some(condition), label }
                    if !last && place.next.contains(&label) && place.depth < DEEPEST_REST =>
                {
                    let condition = Condition { holds: condition.fails, fails: condition.holds };
                    let rest = If { condition, then: statements.collect(), otherwise: Vec::new() };
                    return self.statement(rest, place);
                }
                If { condition, mut then, otherwise }
                    if !last
                        && otherwise.is_empty()
                        && place.depth < DEEPEST_REST
                        && matches!(then.last(), Some(Goto { condition: None, label }) if place.next.contains(label)) =>
                {
                    then.pop();
                    let rest = If { condition, then, otherwise: statements.collect() };
                    return self.statement(rest, place);
                }
                statement => self.statement(statement, Place { next, ..place }),
            }
        }
    }

    fn statement(&mut self, statement: Statement, place: Place) {
        let depth = place.depth;
        if !matches!(statement, Line(_) | Exit(_) | Call { .. } | Check { .. }) {
            self.end_checks(depth);
        }
        match statement {
            Line(line) | Exit(line) => self.line(depth, &line),
            Check { address, end } => {
                let _ = write!(self.checks, "CHECK({address}, {end}); ");
            }
            Call { declares, result, call, checked } => {
                let declares = declares.map(|name| format!("{name} ")).unwrap_or_default();
                let result = result.map(|name| format!("{name} = ")).unwrap_or_default();
                let call = format!("{declares}{result}{call}");
                let line =
                    checked.map(|check| format!("{check}({call});")).unwrap_or(format!("{call};"));
                self.line(depth, &line);
            }
            Goto { condition, label } => {
                if place.next.contains(&label) {
                    return;
                }
                let jump = self.jump(label, &place);
                match condition {
                    Some(condition) => {
                        self.line(depth, &format!("if ({}) {jump}", condition.holds))
                    }
                    None => self.line(depth, &jump),
                }
            }
            Block { label, body } => {
                let mut next = place.next.to_vec();
                next.push(label);
                self.list(body, Place { next: &next, ..place });
                if self.labels.contains(&label) {
                    self.line(depth - 1, &format!("L{label}:;"));
                }
            }
            Loop { label, body } => self.repeat(label, body, place),
            If { condition, then, otherwise } => {
                let inner = Place { depth: depth + 1, ..place };
                let otherwise = self.aside(otherwise, inner);
                let then = self.aside(then, inner);
                match (then.is_empty(), otherwise.is_empty()) {
                    (true, true) => {}
                    (true, false) => {
                        self.line(depth, &format!("if ({}) {{", condition.fails));
                        self.text.push_str(&otherwise);
                        self.line(depth, "}");
                    }
                    (false, no_else) => {
                        self.line(depth, &format!("if ({}) {{", condition.holds));
                        self.text.push_str(&then);
                        if !no_else {
                            self.line(depth, "} else {");
                            self.text.push_str(&otherwise);
                        }
                        self.line(depth, "}");
                    }
                }
            }
            Switch { value, labels } => {
                self.line(depth, &format!("switch ({value}) {{"));
                let inner = Place { behind: place.next, next: &[], ..place };
                let (default, labels) = labels.split_last().expect("a switch has a default");
                let targets: BTreeSet<u32> =
                    labels.iter().copied().filter(|label| label != default).collect();
                for target in targets {
                    let cases = labels.iter().enumerate().filter(|&(_, label)| *label == target);
                    let cases: Vec<String> =
                        cases.map(|(value, _)| format!("case {value}:")).collect();
                    let jump = self.jump(target, &inner);
                    self.line(depth, &format!("{} {jump}", cases.join(" ")));
                }
                let jump = self.jump(*default, &inner);
                self.line(depth, &format!("default: {jump}"));
                self.line(depth, "}");
            }
        }
    }

    /// The text of statements, which is not yet written.
    fn aside(&mut self, statements: Vec<Statement>, place: Place) -> String {
        let before = std::mem::take(&mut self.text);
        self.list(statements, place);
        std::mem::replace(&mut self.text, before)
    }

    fn jump(&mut self, label: u32, place: &Place) -> String {
        if place.next_turn == Some(label) {
            return "continue;".into();
        }
        if place.behind.contains(&label) {
            return "break;".into();
        }
        self.labels.insert(label);
        format!("goto L{label};")
    }

    fn repeat(&mut self, label: u32, mut body: Vec<Statement>, place: Place) {
        let depth = place.depth;
        let inner =
            Place { depth: depth + 1, next: &[], next_turn: Some(label), behind: place.next };
        // What begins with a jump behind the loop is done while its condition fails.
        let mut head = "for (;;) {".to_owned();
        if let Some(Goto { condition: Some(condition), label }) = body.first()
            && place.next.contains(label)
        {
            head = format!("while ({}) {{", condition.fails);
            body.remove(0);
        }
        // What ends with a jump back only under a condition is left if the condition fails.
        let mut back = None;
        let mut end = String::new();
        match body.pop() {
            Some(Goto { condition, label: to }) if to == label => back = condition,
            Some(last) => {
                if !matches!(last, Exit(_) | Switch { .. } | Goto { condition: None, .. }) {
                    end = "break;".into();
                }
                body.push(last);
            }
            None => end = "break;".into(),
        }
        let text = self.aside(body, inner);
        let mut tail = "}".to_owned();
        if let Some(Condition { holds, fails }) = back {
            let is_plain = head.starts_with("for") && !text.contains("continue;");
            if is_plain && !declares(&text, &holds) {
                head = "do {".into();
                tail = format!("}} while ({holds});");
            } else {
                end = format!("if ({fails}) break;");
            }
        }
        if self.labels.contains(&label) {
            self.line(depth - 1, &format!("L{label}:;"));
        }
        self.line(depth, &head);
        self.text.push_str(&text);
        if !end.is_empty() {
            self.line(depth + 1, &end);
        }
        self.line(depth, &tail);
    }
}

/// Whether statements declare a variable that an expression mentions.
fn declares(statements: &str, expression: &str) -> bool {
    statements.match_indices(" = ").any(|(end, _)| {
        let mut words = statements[..end].rsplit([' ', '\t', '(']);
        let (name, before) = (words.next(), words.next());
        matches!(before, Some("u32" | "u64" | "f32" | "f64"))
            && name.is_some_and(|name| mentions(expression, name))
    })
}
