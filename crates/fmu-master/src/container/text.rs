//! The text of the system file of a system that comes from an SSP package.

use std::fmt::Write;

use anyhow::{Result, ensure};
use fmu_description::Value;

use crate::{Component, Connection, Description, Literal, Order};

impl Description {
    /// The system in TOML, with what a package of SSP can have.
    ///
    /// # Errors
    /// It has what the text would lack: faults, or values of inputs that a program gives.
    pub fn to_toml(&self) -> Result<String> {
        let has_faults = self.connections.iter().any(|connection| !connection.faults.is_empty());
        ensure!(
            !has_faults && self.given_inputs.is_none(),
            "a package has neither faults nor values of inputs"
        );
        let Self { start, stop, step, .. } = self;
        let mut text = format!("start = {start:?}\nstop = {stop:?}\nstep = {step:?}\n");
        match self.order {
            Order::Sequential => {}
            Order::Parallel => text += "order = \"parallel\"\n",
            Order::Implicit => text += "order = \"implicit\"\n",
        }
        if self.allow_algebraic_loops {
            text += "allow_algebraic_loops = true\n";
        }
        if let Some(tolerance) = self.tolerance {
            writeln!(text, "tolerance = {tolerance:?}")?;
        }
        let list = |names: Vec<String>| format!("[{}]", names.join(", "));
        if !self.outputs.is_empty() {
            let names = self.outputs.iter().map(|name| quoted(name));
            writeln!(text, "outputs = {}", list(names.collect()))?;
        }
        writeln!(text, "connections = [")?;
        for Connection { from, to, conversion, .. } in &self.connections {
            let conversion = conversion.map_or(String::new(), |c| {
                format!(", factor = {:?}, offset = {:?}", c.factor, c.offset)
            });
            writeln!(text, "    {{ from = {}, to = {}{conversion} }},", quoted(from), quoted(to))?;
        }
        writeln!(text, "]")?;
        for Component { name, fmu, interface, sampled, tolerance, start, .. } in &self.components {
            let fmu = quoted(&fmu.to_string_lossy());
            writeln!(text, "\n[[component]]\nname = {}\nfmu = {fmu}", quoted(name))?;
            if let Some(interface) = interface {
                writeln!(text, "interface = {}", quoted(interface.option_name()))?;
            }
            for (key, value) in [
                ("sampled", sampled.map(|sampled| sampled.to_string())),
                ("tolerance", tolerance.map(|tolerance| format!("{tolerance:?}"))),
            ] {
                value.map_or(Ok(()), |value| writeln!(text, "{key} = {value}"))?;
            }
            if !start.is_empty() {
                writeln!(text, "[component.start]")?;
            }
            for (name, value) in start {
                writeln!(text, "{} = {}", quoted(name), literal(value))?;
            }
        }
        Ok(text)
    }
}

/// A literal as a value of TOML.
fn literal(value: &Literal) -> String {
    match value {
        Literal::Boolean(value) => value.to_string(),
        Literal::Integer(value) if i64::try_from(*value).is_ok() => value.to_string(),
        Literal::Integer(value) => quoted(&value.to_string()),
        Literal::Real(value) => format!("{value:?}").to_lowercase(),
        Literal::Text(text) => quoted(text),
        Literal::Bytes(bytes) => quoted(&Value::Binary(bytes.clone()).to_string()),
        Literal::Array(all) => {
            format!("[{}]", Vec::from_iter(all.iter().map(literal)).join(", "))
        }
    }
}

/// A text as a string of TOML.
pub(super) fn quoted(text: &str) -> String {
    let escaped = text.chars().map(|c| match c {
        '"' | '\\' => format!("\\{c}"),
        c if c.is_control() => format!("\\u{:04X}", u32::from(c)),
        c => c.to_string(),
    });
    format!("\"{}\"", escaped.collect::<String>())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn the_text_is_that_of_the_same_system() {
        let text = "start = 1.0\nstop = 2.0\nstep = 0.5\norder = \"parallel\"\noutputs = [\"a.y\"]\nconnections = [\n    \
            { from = \"a.y\", to = \"b.u\", factor = 2.0, offset = -0.0 },\n]\n\n[[component]]\nname = \"a\"\nfmu = \"a b.fmu\"\n\
            interface = \"model-exchange\"\nsampled = true\ntolerance = 1e-5\n\n[[component]]\nname = \"b \\\\ \\u0007\\\"\"\n\
            fmu = \"c.fmu\"\n[component.start]\n\"m\" = [[1, 2.5], [inf, true]]\n\"s\" = \"é\\u000A\"\n";
        let description = Description::parse(text, Path::new("system.toml")).unwrap();
        assert_eq!(description.to_toml().unwrap(), text);
    }
}
