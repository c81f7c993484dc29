//! What is known of addresses in variables, so that each is checked once.

use std::collections::HashMap;

/// What is known of an address.
#[derive(Clone, Copy, Default)]
struct Fact {
    /// How many bytes from the address on are in memory.
    inside: u64,
    /// How many bytes the stack frame has to which it points.
    frame: u64,
}

/// What is known at one place of a function, by the name of a variable.
#[derive(Clone, Default)]
pub struct Facts(HashMap<String, Fact>);

impl Facts {
    /// How many bytes from the address on are known to be in memory.
    pub fn inside(&self, name: &str) -> u64 {
        self.0.get(name).map_or(0, |fact| fact.inside)
    }

    /// The end to check for an access that ends at `end`: in a stack frame, that of the frame.
    pub fn end_to_check(&self, name: &str, end: u64) -> u64 {
        self.0.get(name).map_or(end, |fact| fact.frame.max(end))
    }

    pub fn set_inside(&mut self, name: &str, end: u64) {
        self.0.entry(name.to_owned()).or_default().inside = end;
    }

    pub fn set_frame(&mut self, name: &str, size: u64) {
        self.0.entry(name.to_owned()).or_default().frame = size;
    }

    /// Makes one variable as well known as another.
    pub fn copy(&mut self, name: &str, from: &str) {
        if let Some(&fact) = self.0.get(from) {
            self.0.insert(name.to_owned(), fact);
        }
    }

    /// The variable has another value now.
    pub fn forget(&mut self, name: &str) {
        self.0.remove(name);
    }

    /// Keeps what is known here and there.
    pub fn meet(&mut self, other: &Facts) {
        self.0.retain(|name, fact| {
            let Some(other) = other.0.get(name) else { return false };
            fact.inside = fact.inside.min(other.inside);
            fact.frame = fact.frame.min(other.frame);
            true
        });
    }
}
