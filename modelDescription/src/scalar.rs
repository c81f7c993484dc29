//! The scalar variables of a table: by their value references, and by their names.

use crate::hash::Hash;
use crate::table::{
    Bounds, Constant, Declaration, Dynamics, MAX_DEPTH, TableRow, TypedStart, each,
};
use crate::{Causality, Naming, Variability};

/// A scalar variable of a model: a variable, or an element of an array.
#[derive(Debug, Clone, Copy)]
pub struct ScalarVariable {
    /// The variable.
    pub variable: &'static Declaration,
    /// Prefixes of the groups that contain it, from the outermost.
    pub prefixes: [&'static str; MAX_DEPTH],
    /// Index of the element in row-major order, from 0.
    pub element: usize,
    /// Its number in the table, from 0.
    pub number: usize,
    /// Its value reference: its number, unless the model fixes value references.
    pub reference: usize,
    /// Offset of the innermost struct that contains the variable, in the outermost one, in bytes.
    pub offset: usize,
    /// How its name is written.
    pub naming: Naming,
    /// Its part in the index of a list of all variables by their names.
    index: IndexEntry,
}

/// A hash table of names that is part of the list of variables: a variable is a slot for the variables whose hashes
/// are its position modulo the length of the list, and a link in the chain of such variables.
#[derive(Debug, Clone, Copy)]
struct IndexEntry {
    /// Hash of the full name of the variable.
    hash: u128,
    /// The first variable in this slot.
    first: u32,
    /// The next variable in the slot of the variable.
    next: u32,
}

impl IndexEntry {
    /// The end of a chain.
    const END: u32 = u32::MAX;
    /// Of a variable that is in no list.
    const NONE: Self = Self { hash: 0, first: Self::END, next: Self::END };
}

impl ScalarVariable {
    /// Offset in the outermost struct in bytes.
    pub const fn absolute_offset(&self) -> usize {
        self.offset + self.variable.offset + self.element * self.variable.start.element_size()
    }

    /// Offset of an `f64` in the outermost struct in bytes; `None` if it has another type.
    pub const fn offset_of_real(&self) -> Option<usize> {
        match self.variable.start {
            TypedStart::Float64(_) => Some(self.absolute_offset()),
            _ => None,
        }
    }

    /// Offset of a structural parameter, a `u64`, in the outermost struct in bytes.
    pub const fn offset_of_size(&self) -> Option<usize> {
        match (self.variable.causality, self.variable.start) {
            (Causality::StructuralParameter, TypedStart::UInt64(_)) => Some(self.absolute_offset()),
            _ => None,
        }
    }

    /// The full name, such as `rbf.w[2]`.
    pub fn name(&self) -> String {
        let name = self.name_parts().concat();
        self.naming.write(element_name(&name, self.variable.dimensions, self.element))
    }

    /// Hash of a name in the group of the variable.
    pub(crate) const fn name_hash(&self, name: &str) -> u128 {
        let mut hash = Hash::new();
        each!(prefix in self.prefixes => { hash = hash.prefix(prefix); });
        hash.bytes(name.as_bytes()).0
    }

    /// Index of the variable with another name in the same group, in all variables; their number if there is none.
    pub(crate) const fn position(&self, name: &str, all: &[Self]) -> usize {
        first_named(self.name_hash(name), all)
    }

    /// Index of the first variable of the same name, in all variables.
    pub(crate) const fn first_of_name(&self, all: &[Self]) -> usize {
        first_named(self.index.hash, all)
    }

    /// The state of which it is the derivative, in all variables; `None` if it is no derivative.
    pub const fn state<'a>(&self, all: &'a [Self]) -> Option<&'a Self> {
        match self.variable.dynamics {
            Dynamics::Derivative { of } => Some(&all[self.position(of, all)]),
            _ => None,
        }
    }

    /// Index of the structural parameter that is its number of elements in use, in all variables; `None` if all are.
    pub const fn size_parameter(&self, all: &[Self]) -> Option<usize> {
        match self.variable.size.is_empty() {
            true => None,
            false => Some(self.position(self.variable.size, all)),
        }
    }

    /// The number of elements of its variable that are in use if no structural parameter is changed.
    pub const fn elements_in_use(&self, scalars: &[Self]) -> usize {
        let count = self.variable.element_count();
        if let Some(size) = self.size_parameter(scalars)
            && let start = scalars[size].variable.start
            && !start.is_empty()
            && let Constant::Whole(size) = start.get(0)
            && size < count as i128
        {
            return size as usize;
        }
        count
    }

    /// The parts of the name of the variable with the prefixes of its groups: `pid.kp`, `der(pid.x)`.
    pub(crate) const fn name_parts(&self) -> NameParts {
        self.parts_of(self.variable.name)
    }

    /// The parts of a name in the group of the variable.
    pub(crate) const fn parts_of(&self, name: &'static str) -> NameParts {
        let mut parts = [""; 2 * MAX_DEPTH + 2];
        let (start, name) = match (name.as_bytes(), name.split_at_checked(4)) {
            ([b'd', b'e', b'r', b'(', ..], Some(parts)) => parts,
            _ => ("", name),
        };
        (parts[0], parts[2 * MAX_DEPTH + 1]) = (start, name);
        each!(i, prefix in self.prefixes => {
            if !prefix.is_empty() {
                (parts[2 * i + 1], parts[2 * i + 2]) = (prefix, ".");
            }
        });
        parts
    }

    /// The parts of the name of the group of the variable, without periods at its end.
    pub(crate) const fn group_parts(&self) -> NameParts {
        let mut parts = [""; 2 * MAX_DEPTH + 2];
        let mut is_first = true;
        each!(i, prefix in self.prefixes => {
            if !prefix.is_empty() {
                parts[2 * i] = if is_first { "" } else { "." };
                parts[2 * i + 1] = prefix;
                is_first = false;
            }
        });
        parts
    }

    /// Length of the name of the last element, from the name of the variable or an alias.
    pub(crate) const fn last_name_length(&self, name: &'static str) -> usize {
        let mut length = length(&self.parts_of(name));
        each!(size in self.variable.dimensions => { length += 2 + size.ilog10() as usize; });
        length + !self.variable.dimensions.is_empty() as usize
    }
}

/// Index of the first variable whose full name has a hash, in all variables; their number if there is none.
pub(crate) const fn first_named(hash: u128, all: &[ScalarVariable]) -> usize {
    if all.is_empty() {
        return 0;
    }
    let mut i = all[(hash % all.len() as u128) as usize].index.first;
    while i != IndexEntry::END {
        if all[i as usize].index.hash == hash {
            return i as usize;
        }
        i = all[i as usize].index.next;
    }
    all.len()
}

/// The parts of a full name, some of which are empty.
pub(crate) type NameParts = [&'static str; 2 * MAX_DEPTH + 2];

/// Length of a text in parts, in bytes.
pub(crate) const fn length(parts: &[&str]) -> usize {
    let mut length = 0;
    each!(part in parts => { length += part.len(); });
    length
}

/// The name of an element, with an index as FMI writes it: `w[1,2]`, `der(x[2])`; a scalar has no index.
pub(crate) fn element_name(name: &str, dimensions: &[usize], element: usize) -> String {
    if dimensions.is_empty() {
        return name.to_owned();
    }
    let (array, end) = match name.strip_suffix(')') {
        Some(array) if array.starts_with("der(") => (array, ")"),
        _ => (name, ""),
    };
    let mut text = array.to_owned();
    let (mut separator, mut count) = ("[", dimensions.iter().product::<usize>());
    for length in dimensions {
        count /= length;
        text = format!("{text}{separator}{}", element / count % length + 1);
        separator = ",";
    }
    text + "]" + end
}

/// Number of scalar variables in a table.
pub const fn scalar_count(rows: &[TableRow]) -> usize {
    let mut sum = 0;
    each!(row in rows => {
        sum += match row {
            TableRow::Variable(field) => field.element_count(),
            TableRow::Group { rows, .. } => scalar_count(rows),
        };
    });
    sum
}

/// Number of variables in a table, of which an array is one.
pub const fn variable_count(rows: &[TableRow]) -> usize {
    let mut sum = 0;
    each!(row in rows => {
        sum += match row {
            TableRow::Variable(_) => 1,
            TableRow::Group { rows, .. } => variable_count(rows),
        };
    });
    sum
}

/// Calls a function with all variables of some rows and their offsets in the outermost struct, in which that of
/// the rows is `base`.
pub fn each_declaration(
    rows: &'static [TableRow],
    base: usize,
    call: &mut dyn FnMut(&'static Declaration, usize),
) {
    for row in rows {
        match row {
            TableRow::Variable(field) => call(field, base + field.offset),
            TableRow::Group { offset, rows, .. } => each_declaration(rows, base + offset, call),
        }
    }
}

/// The first scalars of all variables of a table, in its order, and how many there are, at most `N`. Their value references
/// are their numbers.
pub const fn scalars<const N: usize>(rows: &'static [TableRow]) -> ([ScalarVariable; N], usize) {
    const NONE: &Declaration = &Declaration {
        name: "",
        description: "",
        history: None,
        offset: 0,
        causality: Causality::Local,
        variability: Variability::Continuous,
        dimensions: &[],
        size: "",
        start: TypedStart::Boolean(&[]),
        bounds: Bounds::None,
        unit: "",
        display_unit: "",
        mime_type: "",
        clocks: &[],
        initially_from: None,
        dynamics: Dynamics::Algebraic,
        nominal: 1.0,
        depends_on: &[],
        has_input_derivative: false,
        terminal: "",
        network: "",
    };
    const EMPTY: ScalarVariable = ScalarVariable {
        variable: NONE,
        prefixes: [""; MAX_DEPTH],
        element: 0,
        number: 0,
        reference: 0,
        offset: 0,
        naming: Naming::Structured,
        index: IndexEntry::NONE,
    };
    let (mut all, mut length, mut number) = ([EMPTY; N], 0, 0);
    list(rows, (EMPTY.prefixes, 0, 0, Hash::new()), &mut number, &mut all, &mut length);
    // The first of several variables of a name is found, since it comes last in the index.
    let mut i = length;
    while i > 0 {
        i -= 1;
        let slot = (all[i].index.hash % length as u128) as usize;
        all[i].index.next = all[slot].index.first;
        all[slot].index.first = i as u32;
    }
    (all, length)
}

/// Adds the variables of a group with these prefixes, their number, this offset, and the hash of the prefixes.
const fn list(
    rows: &'static [TableRow],
    (prefixes, depth, offset, hash): ([&'static str; MAX_DEPTH], usize, usize, Hash),
    number: &mut usize,
    all: &mut [ScalarVariable],
    length: &mut usize,
) {
    each!(row in rows => {
        match row {
            TableRow::Variable(variable) => {
                all[*length] = ScalarVariable {
                    variable,
                    prefixes,
                    element: 0,
                    number: *number,
                    reference: *number,
                    offset,
                    naming: Naming::Structured,
                    index: IndexEntry { hash: hash.bytes(variable.name.as_bytes()).0, ..IndexEntry::NONE },
                };
                *length += 1;
                *number += variable.element_count();
            }
            TableRow::Group { prefix, offset: inner, rows } => {
                let prefixes = nested(prefixes, depth, prefix);
                let group = (prefixes, depth + 1, offset + *inner, hash.prefix(prefix));
                list(rows, group, number, all, length);
            }
        }
    });
}

/// The prefixes of a group.
const fn nested(
    mut prefixes: [&'static str; MAX_DEPTH],
    depth: usize,
    prefix: &'static str,
) -> [&'static str; MAX_DEPTH] {
    assert!(depth < MAX_DEPTH, "structs are nested more than 4 deep");
    prefixes[depth] = prefix;
    prefixes
}

/// The scalar variable with the given number, which is its value reference, too.
pub const fn scalar_at(rows: &'static [TableRow], number: usize) -> Option<ScalarVariable> {
    let mut index = number;
    let found = scalar_in_group(rows, ([""; MAX_DEPTH], 0, 0), &mut index);
    match found {
        Some(scalar) => Some(ScalarVariable { number, reference: number, ..scalar }),
        None => None,
    }
}

/// As [`scalar_at`], in a group with these prefixes, their number, and this offset. Subtracts the variables that come
/// before from the index.
const fn scalar_in_group(
    rows: &'static [TableRow],
    (prefixes, depth, base): ([&'static str; MAX_DEPTH], usize, usize),
    index: &mut usize,
) -> Option<ScalarVariable> {
    each!(row in rows => {
        match row {
            TableRow::Variable(variable) if *index < variable.element_count() => {
                return Some(ScalarVariable {
                    variable,
                    prefixes,
                    element: *index,
                    number: 0,
                    reference: 0,
                    offset: base,
                    naming: Naming::Structured,
                    index: IndexEntry::NONE,
                });
            }
            TableRow::Variable(variable) => *index -= variable.element_count(),
            TableRow::Group { prefix, offset, rows } => {
                let group = (nested(prefixes, depth, prefix), depth + 1, base + *offset);
                let found = scalar_in_group(rows, group, index);
                if found.is_some() {
                    return found;
                }
            }
        }
    });
    None
}

/// The variable with another name in the same group as a variable of a table.
pub fn variable_named(
    rows: &'static [TableRow],
    scalar: &ScalarVariable,
    name: &str,
) -> Option<ScalarVariable> {
    variable_with_hash(rows, scalar.name_hash(name))
}

/// A variable of some rows with a full name of this hash, if there is one.
pub(crate) const fn variable_with_hash(
    rows: &'static [TableRow],
    hash: u128,
) -> Option<ScalarVariable> {
    let mut number = 0;
    match has_hash(rows, Hash::new(), hash, &mut number) {
        true => scalar_at(rows, number),
        false => None,
    }
}

/// Whether a variable of a group, whose prefixes have the hash `group`, has a full name of this hash. Adds the scalars
/// that come before it to the number.
const fn has_hash(rows: &[TableRow], group: Hash, hash: u128, number: &mut usize) -> bool {
    each!(row in rows => {
        match row {
            TableRow::Variable(variable) => {
                if group.bytes(variable.name.as_bytes()).0 == hash {
                    return true;
                }
                *number += variable.element_count();
            }
            TableRow::Group { prefix, rows, .. } => {
                if has_hash(rows, group.prefix(prefix), hash, number) {
                    return true;
                }
            }
        }
    });
    false
}
