//! What this machine lacks to build for its targets: one message, with how to install each of it.

use std::fmt::{self, Display, Formatter};

use anyhow::{Result, bail};

/// What is missing, and for which targets.
#[derive(Debug, Default)]
pub struct Missing {
    /// Targets without standard library.
    std: Vec<String>,
    programs: Vec<Program>,
}

/// A program that is missing.
#[derive(Debug)]
struct Program {
    name: String,
    targets: Vec<String>,
    install: String,
}

impl Missing {
    /// Adds the standard library for a target.
    pub fn std(&mut self, triple: &str) {
        add(&mut self.std, triple);
    }

    /// Adds a program that a target needs. `install` are the commands that install it, one on each line.
    pub fn program(&mut self, name: &str, target: &str, install: String) {
        match self.programs.iter_mut().find(|program| program.name == name) {
            Some(known) => add(&mut known.targets, target),
            None => self.programs.push(Program {
                name: name.to_owned(),
                targets: vec![target.to_owned()],
                install,
            }),
        }
    }

    /// Checks that nothing is missing.
    ///
    /// # Errors
    /// Something is; the message has all of it.
    pub fn check(&self) -> Result<()> {
        if !self.std.is_empty() || !self.programs.is_empty() {
            bail!("{self}");
        }
        Ok(())
    }
}

fn add(targets: &mut Vec<String>, target: &str) {
    if !targets.iter().any(|known| known == target) {
        targets.push(target.to_owned());
    }
}

impl Display for Missing {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(
            "this machine cannot build for all of the targets; install what is missing:\n",
        )?;
        if !self.std.is_empty() {
            write!(
                f,
                "\nthe standard library of Rust for {}:
  rustup target add {}
or its sources, from which the export builds it:
  rustup component add rust-src
  apt-get install rustc-web cargo-web rust-web-src    # Debian\n",
                self.std.join(", "),
                self.std.join(" ")
            )?;
        }
        for Program { name, targets, install } in &self.programs {
            write!(f, "\n{name}, which links for {}:\n", targets.join(", "))?;
            install.lines().try_for_each(|line| writeln!(f, "  {line}"))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_missing_at_first() {
        Missing::default().check().unwrap();
    }

    #[test]
    fn one_message_lists_all_that_is_missing_and_each_once() {
        let mut missing = Missing::default();
        for target in ["x86_64-apple-darwin", "aarch64-apple-darwin", "x86_64-apple-darwin"] {
            missing.std(target);
            missing.program("cargo-zigbuild", target, "pip install cargo-zigbuild".into());
        }
        missing.program("wasm-ld", "wasm", "apt-get install lld\nbrew install lld".into());
        let message = missing.check().unwrap_err().to_string();
        let (_, list) = message.split_once("missing:\n").unwrap();
        assert_eq!(
            list,
            "
the standard library of Rust for x86_64-apple-darwin, aarch64-apple-darwin:
  rustup target add x86_64-apple-darwin aarch64-apple-darwin
or its sources, from which the export builds it:
  rustup component add rust-src
  apt-get install rustc-web cargo-web rust-web-src    # Debian

cargo-zigbuild, which links for x86_64-apple-darwin, aarch64-apple-darwin:
  pip install cargo-zigbuild

wasm-ld, which links for wasm:
  apt-get install lld
  brew install lld
"
        );
    }
}
