//! What is known of addresses in variables, so that each is checked once.

use std::collections::{BTreeMap, HashMap};

/// How many bytes from the address in a variable on are known to be in memory, at one place of a function.
#[derive(Clone, Default)]
pub struct Facts(HashMap<String, u64>);

impl Facts {
    pub fn inside(&self, name: &str) -> u64 {
        self.0.get(name).copied().unwrap_or(0)
    }

    /// The variable and the offset of an address such as `n3` or `n3 + 8`, if the variable is known to be inside, so
    /// that the sum does not overflow.
    pub fn sum<'a>(&self, address: &'a str) -> Option<(&'a str, u64)> {
        let (name, offset) = match address.split_once(" + ") {
            Some((name, offset)) => (name, offset.parse().ok()?),
            None => (address, 0),
        };
        (self.inside(name) > 0).then_some((name, offset))
    }

    pub fn set_inside(&mut self, name: &str, end: u64) {
        self.0.insert(name.to_owned(), end);
    }

    /// The variable has another value now.
    pub fn set(&mut self, name: &str, value: &str) {
        let end =
            self.sum(value).map_or(0, |(from, offset)| self.inside(from).saturating_sub(offset));
        self.forget(name);
        if end > 0 {
            self.set_inside(name, end);
        }
    }

    /// The variable has a value that is not known.
    pub fn forget(&mut self, name: &str) {
        self.0.remove(name);
    }

    /// Keeps what is known here and there.
    pub fn meet(&mut self, other: &Facts) {
        self.0.retain(|name, end| {
            *end = (*end).min(other.inside(name));
            *end > 0
        });
    }
}

/// How many bytes from each argument on are in memory wherever functions are called, by the index of a function.
#[derive(Clone, Default, PartialEq)]
pub struct Arguments(BTreeMap<u32, Vec<u64>>);

impl Arguments {
    pub fn of(&self, function: u32) -> impl Iterator<Item = u64> {
        self.0.get(&function).into_iter().flatten().copied()
    }

    /// Another call of the function.
    pub fn add(&mut self, function: u32, call: Vec<u64>) {
        let known = self.0.entry(function).or_insert_with(|| call.clone());
        for (known, end) in known.iter_mut().zip(call) {
            *known = (*known).min(end);
        }
    }

    /// The function is called from elsewhere, too.
    pub fn forget(&mut self, function: u32) {
        self.0.remove(&function);
    }
}
