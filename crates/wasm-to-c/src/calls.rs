//! Which functions are called by which, which of them can trap, and which count their depth.

use std::collections::{BTreeMap, BTreeSet};

use wasmparser::Operator;

use crate::Error;
use crate::module::Module;

/// What is known of a function.
#[derive(Default)]
pub struct Traits {
    /// It may set the trap.
    pub traps: bool,
    /// It needs the instance: its memory, its globals or its trap.
    pub needs_model: bool,
    /// It is called in a circle, and counts how deep it is.
    pub counts_depth: bool,
}

/// The functions that a module uses.
pub struct Calls {
    /// Every function that is called, after those that it calls, except in circles.
    pub order: Vec<u32>,
    pub traits: BTreeMap<u32, Traits>,
    /// The functions in the table by the index of their type, for the types by which they are called.
    pub pointers: BTreeMap<u32, BTreeMap<u32, Vec<u32>>>,
    /// Whether any of them asks for the size of the memory, or for more.
    pub uses_pages: bool,
    direct: BTreeMap<u32, BTreeSet<u32>>,
}

#[derive(Default)]
struct Callees {
    direct: BTreeSet<u32>,
    types: BTreeSet<u32>,
    traps: bool,
    needs_model: bool,
    uses_pages: bool,
}

impl Calls {
    pub fn new(module: &Module) -> Result<Self, Error> {
        let imports = module.imports.len() as u32;
        let mut callees = Vec::new();
        for body in &module.bodies {
            callees.push(scan(module, body)?);
        }
        let mut calls = Calls {
            order: Vec::new(),
            traits: BTreeMap::new(),
            pointers: BTreeMap::new(),
            uses_pages: false,
            direct: BTreeMap::new(),
        };
        let roots: Vec<u32> =
            module.exports.iter().map(|&(_, index)| index).chain(module.start).collect();
        for root in roots {
            calls.visit(module, &callees, root, &mut BTreeSet::new());
        }
        calls.spread(&callees, imports);
        Ok(calls)
    }

    /// Visits a function and what it calls. `callers` are on the way to it.
    fn visit(
        &mut self,
        module: &Module,
        callees: &[Callees],
        function: u32,
        callers: &mut BTreeSet<u32>,
    ) {
        let Some(index) = function.checked_sub(module.imports.len() as u32) else {
            self.traits
                .insert(function, Traits { traps: true, needs_model: true, counts_depth: false });
            return;
        };
        if callers.contains(&function) {
            self.traits.entry(function).or_default().counts_depth = true;
        }
        if self.traits.contains_key(&function) {
            return;
        }
        let own = &callees[index as usize];
        self.traits.insert(
            function,
            Traits { traps: own.traps, needs_model: own.needs_model, counts_depth: false },
        );
        callers.insert(function);
        for &callee in &own.direct {
            self.visit(module, callees, callee, callers);
        }
        for &type_index in &own.types {
            for callee in self.of_type(module, type_index) {
                self.visit(module, callees, callee, callers);
            }
        }
        callers.remove(&function);
        self.order.push(function);
        self.uses_pages |= own.uses_pages;
        self.direct.insert(function, own.direct.clone());
    }

    /// The functions in the module that a function calls, but for those to which pointers point.
    pub fn callees(&self, function: u32) -> impl Iterator<Item = u32> {
        self.direct[&function].iter().copied().filter(|callee| self.direct.contains_key(callee))
    }

    /// The functions in the table that have a type.
    fn of_type(&mut self, module: &Module, type_index: u32) -> Vec<u32> {
        let places = self.pointers.entry(type_index).or_insert_with(|| {
            let mut places = BTreeMap::<u32, Vec<u32>>::new();
            for (&place, &function) in &module.table {
                if module.function_type(function) == &module.types[type_index as usize] {
                    places.entry(function).or_default().push(place);
                }
            }
            places
        });
        places.keys().copied().collect()
    }

    /// What calls a function that traps traps, too, and so on, until nothing changes.
    fn spread(&mut self, callees: &[Callees], imports: u32) {
        loop {
            let mut changed = false;
            for &function in &self.order {
                let own = &callees[(function - imports) as usize];
                let called = own.direct.iter().map(|callee| &self.traits[callee]);
                let (traps, needs_model) =
                    called.fold((false, false), |(traps, needs_model), callee| {
                        (
                            traps || callee.traps || callee.counts_depth,
                            needs_model || callee.needs_model || callee.counts_depth,
                        )
                    });
                let traits =
                    self.traits.get_mut(&function).expect("every function in the order has traits");
                let before = (traits.traps, traits.needs_model);
                traits.traps |= traps || traits.counts_depth;
                traits.needs_model |= needs_model || traits.counts_depth;
                changed |= before != (traits.traps, traits.needs_model);
            }
            if !changed {
                return;
            }
        }
    }
}

fn scan(module: &Module, body: &wasmparser::FunctionBody) -> Result<Callees, Error> {
    let mut callees = Callees::default();
    let mut divisor = None;
    for operator in body.get_operators_reader()? {
        let operator = operator?;
        match &operator {
            Operator::Call { function_index } => {
                callees.direct.insert(*function_index);
            }
            Operator::CallIndirect { type_index, table_index: 0 } => {
                // Types that are equal are one.
                let own = &module.types[*type_index as usize];
                let first = module
                    .types
                    .iter()
                    .position(|other| other == own)
                    .expect("a type equals itself");
                callees.types.insert(first as u32);
                callees.traps = true;
            }
            Operator::GlobalGet { .. } | Operator::GlobalSet { .. } => callees.needs_model = true,
            Operator::MemorySize { .. } | Operator::MemoryGrow { .. } => {
                (callees.needs_model, callees.uses_pages) = (true, true);
            }
            operator if may_trap(operator, divisor) => callees.traps = true,
            _ => {}
        }
        divisor = match operator {
            Operator::I32Const { value } => Some(i64::from(value)),
            Operator::I64Const { value } => Some(value),
            _ => None,
        };
    }
    callees.needs_model |= callees.traps;
    Ok(callees)
}

/// Whether an operator may trap; `divisor` is the constant before it.
fn may_trap(operator: &Operator, divisor: Option<i64>) -> bool {
    use Operator::*;
    match operator {
        I32DivS | I64DivS => !matches!(divisor, Some(divisor) if divisor != 0 && divisor != -1),
        I32DivU | I64DivU | I32RemS | I64RemS | I32RemU | I64RemU => {
            !matches!(divisor, Some(divisor) if divisor != 0)
        }
        Unreachable | MemoryCopy { .. } | MemoryFill { .. } => true,
        I32TruncF32S | I32TruncF32U | I32TruncF64S | I32TruncF64U => true,
        I64TruncF32S | I64TruncF32U | I64TruncF64S | I64TruncF64U => true,
        operator => crate::memory::access(operator).is_some(),
    }
}
