//! Where the local variables of a function are used.

use std::collections::{BTreeSet, HashMap};

use wasmparser::Operator;

/// What one pass over the operators finds.
pub struct Locals {
    /// The locals that are set within a block, a loop or an `if`, by the place of its operator.
    pub set_in: HashMap<usize, BTreeSet<u32>>,
    /// The locals that are read.
    pub read: BTreeSet<u32>,
    /// The locals that are declared where they are set, by the place of the operator: they are used only within the
    /// block that is the innermost there, and not before.
    pub declared_at: HashMap<usize, u32>,
    /// All other locals that are used.
    pub declared_before: BTreeSet<u32>,
}

struct Use {
    /// The place of the first use, whether it sets the local, and the place of the block where it is.
    first: usize,
    sets: bool,
    block: usize,
    last: usize,
}

impl Locals {
    pub fn new(operators: &[Operator], parameters: u32) -> Self {
        let mut set_in: HashMap<usize, BTreeSet<u32>> = HashMap::new();
        let mut read = BTreeSet::new();
        let mut uses: HashMap<u32, Use> = HashMap::new();
        let mut ends: HashMap<usize, usize> = HashMap::new();
        // The places of the operators that begin the blocks around, and of the whole `if` where that is `else`.
        const BODY: usize = usize::MAX;
        let mut blocks = vec![(BODY, BODY)];
        for (place, operator) in operators.iter().enumerate() {
            match operator {
                Operator::Block { .. } | Operator::Loop { .. } | Operator::If { .. } => {
                    set_in.entry(place).or_default();
                    blocks.push((place, place));
                }
                Operator::Else | Operator::End => {
                    let (block, whole) = blocks.pop().expect("validated: blocks are balanced");
                    ends.insert(block, place);
                    if matches!(operator, Operator::Else) {
                        blocks.push((place, whole));
                    }
                }
                Operator::LocalGet { local_index }
                | Operator::LocalSet { local_index }
                | Operator::LocalTee { local_index } => {
                    let sets = !matches!(operator, Operator::LocalGet { .. });
                    if sets {
                        for (_, whole) in &blocks {
                            set_in.entry(*whole).or_default().insert(*local_index);
                        }
                    } else {
                        read.insert(*local_index);
                    }
                    let (block, _) = *blocks.last().expect("the body is a block");
                    uses.entry(*local_index)
                        .and_modify(|known| known.last = place)
                        .or_insert(Use { first: place, sets, block, last: place });
                }
                _ => {}
            }
        }
        let mut locals =
            Locals { set_in, read, declared_at: HashMap::new(), declared_before: BTreeSet::new() };
        for (&local, used) in uses.iter().filter(|(local, _)| **local >= parameters) {
            if used.sets && used.last < ends[&used.block] {
                locals.declared_at.insert(used.first, local);
            } else {
                locals.declared_before.insert(local);
            }
        }
        locals
    }
}
