//! What is known of addresses in variables, so that each is checked once.

use std::collections::HashMap;

/// How many bytes from the address in a variable on are known to be in memory, at one place of a function.
#[derive(Clone, Default)]
pub struct Facts(HashMap<String, u64>);

impl Facts {
    pub fn inside(&self, name: &str) -> u64 {
        self.0.get(name).copied().unwrap_or(0)
    }

    pub fn set_inside(&mut self, name: &str, end: u64) {
        self.0.insert(name.to_owned(), end);
    }

    /// Makes one variable as well known as another.
    pub fn copy(&mut self, name: &str, from: &str) {
        if let Some(&end) = self.0.get(from) {
            self.0.insert(name.to_owned(), end);
        }
    }

    /// The variable has another value now.
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
