//! Blocks that are left in one way only become `if`.

use std::collections::HashMap;

use crate::statement::{Condition, Statement};

/// Takes away the blocks whose label is not needed: what nothing leaves is not a block, and what one condition leaves is
/// an `if`.
pub fn simplify(statements: Vec<Statement>) -> Vec<Statement> {
    let mut uses = HashMap::new();
    count(&statements, &mut uses);
    list(statements, &uses)
}

fn count(statements: &[Statement], uses: &mut HashMap<u32, usize>) {
    for statement in statements {
        match statement {
            Statement::Goto { label, .. } => *uses.entry(*label).or_default() += 1,
            Statement::Switch { labels, .. } => {
                for label in labels {
                    *uses.entry(*label).or_default() += 1;
                }
            }
            Statement::Block { body, .. } | Statement::Loop { body, .. } => count(body, uses),
            Statement::If { then, otherwise, .. } => {
                count(then, uses);
                count(otherwise, uses);
            }
            _ => {}
        }
    }
}

fn list(statements: Vec<Statement>, uses: &HashMap<u32, usize>) -> Vec<Statement> {
    let mut simple = Vec::new();
    for statement in statements {
        match statement {
            Statement::Block { label, body } => block(label, list(body, uses), uses, &mut simple),
            Statement::Loop { label, body } => {
                simple.push(Statement::Loop { label, body: list(body, uses) })
            }
            Statement::If { condition, then, otherwise } => {
                let (then, otherwise) = (list(then, uses), list(otherwise, uses));
                simple.push(Statement::If { condition, then, otherwise });
            }
            other => simple.push(other),
        }
    }
    simple
}

fn block(
    label: u32,
    mut body: Vec<Statement>,
    uses: &HashMap<u32, usize>,
    simple: &mut Vec<Statement>,
) {
    let leaves = |statement: &Statement| matches!(statement, Statement::Goto { label: to, .. } if *to == label);
    match (uses.get(&label).unwrap_or(&0), body.iter().position(leaves)) {
        (0, _) => simple.extend(body),
        (1, Some(place)) => {
            let rest = body.split_off(place + 1);
            let leave = body.pop();
            simple.extend(body);
            if let Some(Statement::Goto { condition: Some(condition), .. }) = leave {
                let condition = Condition { holds: condition.fails, fails: condition.holds };
                simple.push(Statement::If { condition, then: rest, otherwise: Vec::new() });
            }
        }
        _ => simple.push(Statement::Block { label, body }),
    }
}
